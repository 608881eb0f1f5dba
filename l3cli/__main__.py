"""`l3`, and `python -m l3cli`: the command line, ready for signals and for closed streams before it is imported."""

import os
import signal
import sys


def main() -> None:
    """Run the command line."""
    _open_streams()
    words = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}

    def end(number: int, frame: object) -> None:  # no work has begun, so there is nothing to clean up
        os.write(2, f"l3: {words[signal.Signals(number)]}\n".encode())
        os._exit(128 + number)

    for each in words:
        if signal.getsignal(each) is not signal.SIG_IGN:  # as a job in the background ignores Ctrl-C
            signal.signal(each, end)
    from l3cli import cli

    cli.main()


def _open_streams() -> None:
    """Open on nothing what is closed of stdin, stdout and stderr, as daemons leave them: a file that is opened later would
    take its number, and be read, written or closed for the stream."""
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the least number that is free, which is this one
            os.set_inheritable(number, True)
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115


if __name__ == "__main__":
    main()
