"""The console of a stage (system/console.py)."""

from l3cli.system.console import Console, Gathering, Silent

__all__ = ["Console", "Gathering", "Silent"]
