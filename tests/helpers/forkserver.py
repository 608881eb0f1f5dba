"""Runs l3 without its start-up time: a server process imports all modules once and forks for each run.

This module, run as a program, is the server process. It reads one JSON object per line, prints the process ID of the fork,
and then prints the result of the run.
"""

import atexit
import json
import os
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

IMPORTS = (
    "numpy colour colour_demosaicing h5py OpenImageIO rawpy scipy.optimize scipy.ndimage scipy.interpolate tifffile jinja2 "
    "l3cli.cli.render l3cli.stages.rendering.render l3cli.stages.report l3cli.cli.train l3cli.cli.lab l3cli.cli.calibrate "
    "l3cli.stages.training.train l3cli.stages.simulation.simulate "
    "l3cli.cli.evaluate l3cli.cli.report l3cli.cli.compare l3cli.cli.info l3cli.cli.simulate l3cli.cli.init "
    "l3cli.calibration.model l3cli.training.table l3cli.simulation.frame l3cli.simulation.procedural "
    "l3cli.rendering.reference l3cli.evaluation.evaluation l3cli.io.measurements l3cli.io.curves l3cli.simulation.lab "
    "l3cli.calibration.figures l3cli.stages.calibration l3cli.stages.lab tests.helpers.charts"
)

ENDING = (signal.SIGINT, signal.SIGTERM)


@dataclass(frozen=True)
class Ended:
    """Result of a run: exit code (or minus the signal), output, and the files in its output folder by name."""

    code: int
    out: str
    err: str
    left: dict[str, int]


class ForkServer:
    """Starts runs of l3 in `folder`, one at a time.

    With `private_disks` the server has its own mount namespace, in which small disks can be mounted.
    """

    def __init__(self, folder: Path, private_disks: bool = False) -> None:
        self.folder, self._child = folder, 0
        prefix = ["unshare", "-rm"] if private_disks else []
        self._server = subprocess.Popen(
            [*prefix, sys.executable, "-m", "tests.helpers.forkserver"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def start(self, *arguments: object, disk: str = "", kill: tuple[float, int] = (0.0, 0)) -> int:
        """Start `l3 ARGUMENTS` and return its process ID.

        `disk` gives mount options of a tmpfs over the folder "out". `kill` is a time in seconds after the start, and the
        signal that is sent then.
        """
        assert self._server.stdin is not None
        if self._child:  # a failed test left its run
            os.kill(self._child, signal.SIGKILL)
            self.wait()
        given = [str(each) for each in arguments]
        asked = {"folder": str(self.folder), "arguments": given, "disk": disk, "kill": kill}
        self._server.stdin.write(json.dumps(asked) + "\n")
        self._server.stdin.flush()
        self._child = int(self._answer())
        return self._child

    def wait(self) -> Ended:
        """Wait for the run that was started last and return its result."""
        answer = self._answer()
        self._child = 0
        return Ended(**answer)

    def run(self, *arguments: object, disk: str = "", kill: tuple[float, int] = (0.0, 0)) -> Ended:
        self.start(*arguments, disk=disk, kill=kill)
        return self.wait()

    def close(self) -> None:
        assert self._server.stdin is not None
        self._server.stdin.close()
        self._server.wait()

    def _answer(self) -> Any:
        assert self._server.stdout is not None
        return json.loads(self._server.stdout.readline())


def serve() -> None:
    from l3cli.parallel import one_blas_thread
    from l3cli.system.limits import without_plots

    one_blas_thread()
    without_plots()
    for name in IMPORTS.split():
        __import__(name)
    vars(sys.modules["l3cli.evaluation.standards"]).update(sys.modules["tests.helpers.charts"].SMALL)
    sys.modules["l3cli.physics.spectra"].reflectance_library(sys.modules["numpy"].arange(400.0, 701.0, 10.0))  # read once
    for line in sys.stdin:
        asked = json.loads(line)
        os.chdir(asked["folder"])
        if asked["disk"]:
            os.makedirs("out", exist_ok=True)
            subprocess.run(["mount", "-t", "tmpfs", "-o", asked["disk"], "tmpfs", "out"], check=True)
        signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)  # until the run has set its handlers
        child = os.fork()
        if child == 0:
            _become(asked["arguments"])
        _send(child)
        seconds, number = asked["kill"]
        if number:
            time.sleep(seconds)
            os.kill(child, number)  # the process ID is valid until waitpid, even if the run has ended
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        left = {str(each): each.stat().st_size for each in sorted(Path("out").rglob("*")) if each.is_file()}
        if asked["disk"]:
            subprocess.run(["umount", "out"], check=True)
        words = {name: Path(f"{os.getpid()}.{name}") for name in ("out", "err")}
        reported = {
            name: file.read_text() if file.exists() else "" for name, file in words.items()
        }  # no file: killed before its first output
        _send({"code": code, **reported, "left": left})


def _send(answer: Any) -> None:
    print(json.dumps(answer), flush=True)


def _become(arguments: list[str]) -> None:
    """Run l3 in the forked process and exit. Its output goes to files named after the server's process ID."""
    from l3cli import cli
    from l3cli.system import signals

    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    for number, name in ((1, "out"), (2, "err")):
        stream = f"{os.getppid()}.{name}"
        if os.path.exists(stream):
            os.unlink(stream)  # a new file, because workers of a killed run may still write to the old file
        os.dup2(os.open(stream, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666), number)
    sys.argv = ["l3", *arguments]
    for each in ENDING:
        signal.signal(each, signals.end)
    group = cli.l3.main

    def begin(*arguments: Any, **options: Any) -> Any:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)  # the handlers are set
        return group(*arguments, **options)

    cli.l3.main = begin  # type: ignore[method-assign]
    _end(_code_of(cli.main))


def _code_of(main: Callable[[], None]) -> int:
    """Return the exit code of a program. Unexpected exceptions are printed."""
    try:
        main()
    except SystemExit as end:
        return int(end.code or 0)
    except BaseException:
        traceback.print_exc()
        return 1
    return 0


def _end(code: int) -> None:
    """End the process as Python does, but without freeing memory.

    Unloading all modules that `serve` imported would take longer than most runs.
    """
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os._exit(code)


if __name__ == "__main__":
    serve()
