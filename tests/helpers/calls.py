"""The types of the fixtures that run commands (conftest.py)."""

from collections.abc import Callable

L3 = Callable[..., tuple[int, str, str]]  # `l3 ARGUMENTS`: exit code, stdout, stderr
Refused = Callable[..., str]  # `l3 ARGUMENTS` that must fail with a code: its line on stderr
