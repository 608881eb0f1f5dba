"""Options of each command, as frozen dataclasses: the source of the command line, the Python API and keys of runs."""
