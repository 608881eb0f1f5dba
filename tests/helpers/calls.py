"""Types of the fixtures in conftest.py that run commands."""

from collections.abc import Callable

L3 = Callable[..., tuple[int, str, str]]  # runs `l3 ARGUMENTS` and returns exit code, stdout and stderr
Refused = Callable[..., str]  # runs `l3 ARGUMENTS`, which must fail with a given code, and returns the line on stderr
