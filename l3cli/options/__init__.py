"""Options of each command, as frozen dataclasses from which the command line and the Python functions are derived."""
