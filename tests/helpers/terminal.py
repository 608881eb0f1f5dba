"""Runs commands in a terminal of a given size."""

import contextlib
import os

TERMINAL = ("TERM", "COLUMNS", "LINES", "NO_COLOR", "FORCE_COLOR")  # variables that tests of terminals set


def in_terminal(command: list[str], environment: dict[str, str], columns: int = 80) -> str:
    """Return stdout and stderr of a command, as shown in a terminal with 24 rows."""
    import fcntl
    import pty
    import struct
    import subprocess
    import termios

    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    known = {"TERM": "xterm-256color", **{key: value for key, value in os.environ.items() if key not in TERMINAL}}
    known |= environment
    run = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=theirs, stderr=theirs, env=known)
    os.close(theirs)
    shown = b""
    with contextlib.suppress(OSError):  # raised when the other end is closed
        while part := os.read(ours, 65536):
            shown += part
    os.close(ours)
    assert run.wait(timeout=600) == 0, shown
    return shown.decode()
