"""Types of the fixtures in conftest.py that run commands."""

from collections.abc import Callable

L3 = Callable[..., tuple[int, str, str]]  # `l3 ARGUMENTS`: exit code, stdout, stderr
Refused = Callable[..., str]  # `l3 ARGUMENTS` that must fail with a code: its line on stderr
