"""Entry point of `l3` and `python -m l3cli`.

Before the command line is imported, closed standard streams are replaced by the null device, and signal handlers are
installed. A signal during the import therefore ends the program with a single line.
"""

import os
import signal
import sys


def main() -> None:
    """Run the command line."""
    _open_streams()
    words = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}

    def end(number: int, frame: object) -> None:  # nothing must be cleaned up, because no work has begun
        os.write(2, f"l3: {words[signal.Signals(number)]}\n".encode())
        os._exit(128 + number)

    for each in words:
        if signal.getsignal(each) is not signal.SIG_IGN:  # background jobs ignore Ctrl-C, and must continue to do so
            signal.signal(each, end)
    from l3cli import cli

    cli.main()


def _open_streams() -> None:
    """Open the null device in place of each standard stream that is closed.

    A daemon may start a program with stdin, stdout or stderr closed. The next file that the program opens would then get the
    descriptor of the closed stream. Code that uses the stream would read, write or close this file.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free descriptor, which is `number`
            os.set_inheritable(number, True)
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115


if __name__ == "__main__":
    main()
