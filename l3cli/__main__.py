"""`l3`, and `python -m l3cli`: the command line, ready for signals before it is imported."""

import os
import signal


def main() -> None:
    """Run the command line."""
    words = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}

    def end(number: int, frame: object) -> None:  # nothing has begun: there is nothing to clean up
        os.write(2, f"l3: {words[signal.Signals(number)]}\n".encode())
        os._exit(128 + number)

    for each in words:
        if signal.getsignal(each) is not signal.SIG_IGN:  # as a job in the background ignores Ctrl-C
            signal.signal(each, end)
    from l3cli import cli

    cli.main()


if __name__ == "__main__":
    main()
