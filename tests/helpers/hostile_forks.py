"""Checks processes that are forked from a process in which l3 was used.

A child must give the same results as its parent, or stop with one error that states a remedy. A child must not hang. Usage:
`python -m tests.helpers.hostile_forks FOLDER CASE…`.
"""

import contextlib
import gc
import io
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from l3cli.api import Renderer, read_raw
from l3cli.artifacts.store import load, open_artifact, save
from l3cli.artifacts.table import TransformTable
from l3cli.errors import DeviceError
from l3cli.io.pictures.openimageio import write_mosaic
from l3cli.parallel import ordered_map
from l3cli.rendering.opencl import devices
from l3cli.rendering.reference import ReferenceRenderer
from l3cli.system.locks import ThreadLock
from tests.helpers.cameras import BAYER
from tests.helpers.hostile_spoiling import Choices, one_of
from tests.helpers.tables import random_table
from tests.helpers.tasks import PATIENCE, squared

Case = tuple[list[str], str]  # actions of the parent before the fork, and the action of the child
CURE = '"spawn"'


class Scene:
    """A table, a frame, and the state of a parent before it forks."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.table = folder, load(TransformTable, folder / "table.h5")
        self.frame = read_raw(folder / "raw.tif", self.table)
        self.expected = ReferenceRenderer(self.table).outputs(self.frame).transpose(1, 2, 0)
        self.reference = Renderer(self.table, backend="reference")
        self.following = self.reference.sequence(None, exposure=1.0)
        self.shown = self.reference.picture(self.frame, exposure=1.0)
        self.renderer: Renderer | None = None
        self.left = contextlib.ExitStack()
        self.root: Any = None

    def use(self) -> None:
        """Render with OpenCL. An existing renderer is used again."""
        self.renderer = self.renderer or Renderer(self.table)
        made = self.renderer.outputs(self.frame)
        assert np.allclose(made, self.expected, rtol=1e-3, atol=1e-3 * np.abs(self.expected).max())

    def hold(self) -> None:
        """Let threads hold the locks of the reference renderer and its sequence."""
        cells = [cell.cell_contents for cell in self.following.__closure__ or ()]
        (following,) = (each for each in cells if isinstance(each, ThreadLock))
        for lock in (self.reference._alone, following):
            thread = threading.Thread(target=lock.__enter__)
            thread.start()
            thread.join()

    def open(self) -> None:
        """Keep the table's file open."""
        self.root = self.root or self.left.enter_context(open_artifact(self.folder / "table.h5", TransformTable))

    def decode(self) -> None:
        """Decode a foreign file."""
        assert np.array_equal(read_raw(self.folder / "raw.png", self.table).values, self.frame.values)

    def by_reference(self) -> None:
        assert np.array_equal(self.reference.outputs(self.frame), self.expected.astype(np.float32))
        assert np.array_equal(self.following(self.frame), self.shown)

    def read(self) -> None:
        self.open()
        assert np.array_equal(self.root["first/weights"][()], self.table.first.weights)

    def command(self) -> None:
        from l3cli.cli import run

        errors, output = io.StringIO(), str(self.folder / f"{os.getpid()}.png")
        call = ["render", str(self.folder / "table.h5"), str(self.folder / "raw.tif"), "-o", output, "--quiet"]
        with contextlib.redirect_stderr(errors):
            if (code := run(call)) == 0:
                return
        assert code == 4, errors.getvalue()
        raise DeviceError(errors.getvalue())

    def by_processes(self) -> None:
        assert list(ordered_map(squared, range(4), 2)) == [0, 1, 4, 9]

    def leave(self) -> None:
        self.renderer = None
        gc.collect()
        sys.exit()


BEFORE: dict[str, Callable[[Scene], object]] = {
    "devices": lambda scene: devices.devices(),
    "use": Scene.use,
    "hold": Scene.hold,
    "open": Scene.open,
    "decode": Scene.decode,
}
AFTER: dict[str, Callable[[Scene], object]] = {
    "use": Scene.use,
    "decode": Scene.decode,
    "by reference": Scene.by_reference,
    "read": Scene.read,
    "command": Scene.command,
    "by processes": Scene.by_processes,
    "leave": Scene.leave,
}


def drawn(choices: Choices) -> Case:
    """Draw a random case."""
    return [name for name in BEFORE if choices.integer(0, 1)], one_of(choices, [*AFTER])


def judge(folder: Path, case: Case) -> str | None:
    """Return what went wrong in a child, or None. The caller must never have used OpenCL."""
    before, after = case
    opencl_used = bool({"devices", "use"} & set(before))

    def child(scene: Scene) -> None:
        refused = False
        try:
            AFTER[after](scene)
        except DeviceError as error:
            if not (opencl_used and CURE in str(error)):
                raise
            refused = True
        assert refused == (opencl_used and after in ("use", "command")), "no error that names the cure"

    def parent() -> None:
        scene = Scene(folder)
        for name in before:
            BEFORE[name](scene)
        if (words := _ended(lambda: child(scene), PATIENCE / 2)) is not None:
            raise AssertionError(words)

    words = _ended(parent, PATIENCE)
    return None if words is None else f"{', '.join(before) or 'nothing'}, fork, {after}: {words}"


def _ended(function: Callable[[], object], patience: float) -> str | None:
    """Fork a process that calls a function and exits normally. Return what went wrong, or None."""
    out, into = os.pipe()
    sys.stdout.flush()
    process = os.fork()
    if not process:
        os.dup2(into, 1)
        try:
            function()
        except SystemExit:
            pass
        except BaseException:
            os.write(1, traceback.format_exc().encode())
            os._exit(1)
        finally:
            sys.stdout.flush()
        os._exit(0)
    os.close(into)
    deadline = time.monotonic() + patience
    code: int | str | None = None
    while code is None:
        ended, status = os.waitpid(process, os.WNOHANG)
        code = os.waitstatus_to_exitcode(status) if ended else None
        if code is None and time.monotonic() > deadline:
            os.kill(process, signal.SIGKILL)
            os.waitpid(process, 0)
            code = "it hangs"
        time.sleep(0.01)
    with open(out, errors="replace") as stream:
        words = stream.read() if code != "it hangs" else ""
    return None if code == 0 else f"{words}{code}"


def judge_cases(cases: Iterable[Case]) -> Iterator[str]:
    """Yield what went wrong in each case, with the name of the case. The last item says if the judging process died."""
    with tempfile.TemporaryDirectory(prefix="l3-forks-") as name:
        save(random_table(BAYER, bits=12, black_level=64.0), Path(name) / "table.h5")
        values = np.random.default_rng(0).integers(100, 900, (20, 24)).astype(np.uint16)
        for suffix in ("tif", "png"):
            write_mosaic(Path(name) / f"raw.{suffix}", values)
        call = [sys.executable, "-m", "tests.helpers.hostile_forks", name, *map(json.dumps, cases)]
        known = dict(os.environ)
        ended = subprocess.run(call, env=known, capture_output=True, text=True, check=False)
        yield from map(json.loads, ended.stdout.splitlines())
        if ended.returncode:
            yield ended.stderr


def main() -> None:
    folder, *cases = sys.argv[1:]
    for case in map(json.loads, cases):
        if (verdict := judge(Path(folder), case)) is not None:
            print(json.dumps(verdict), flush=True)


if __name__ == "__main__":
    main()
