"""Options of all commands, as frozen dataclasses. The command line and the Python functions are derived from them."""
