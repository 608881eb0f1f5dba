"""Options of the commands: a frozen dataclass each, of which the command line, Python and the keys of runs are made."""
