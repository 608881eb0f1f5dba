"""Ctrl-C and SIGTERM: one line, exit code 130 or 143, no remaining process, and no incomplete output."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.hostile import HANGS
from tests.helpers.stages import CLASSES, SCENES, is_remnant, make_inputs

ENDS = {signal.SIGINT: (130, "interrupted"), signal.SIGTERM: (143, "terminated")}
CALLS = {  # that take more than a second, and the files in "out" that show that they are at work
    "simulate in/many.toml --camera in/camera.h5 -o out/set.h5 --jobs 2": "set.h5.parts/0*.h5",
    "train in/training.h5 --classes in/patches.toml -o out/table.h5 --jobs 2": ".table.h5.l3lock",
    "render in/table.h5 in/frames.npy -o out/pictures --backend reference": "pictures/*.png",
    "evaluate in/table.h5 in/unseen.h5 --pictures out/pictures --backend reference": "pictures/*.png",
}


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = make_inputs(tmp_path_factory.mktemp("signals") / "in")
    (folder / "many.toml").write_text(SCENES.replace("count = 4", "count = 40"))
    (folder / "patches.toml").write_text(CLASSES.replace("patches = 3000", "patches = 3000000"))
    np.save(folder / "frames.npy", np.random.default_rng(0).integers(64, 4000, (200, 192, 256)).astype(np.uint16))
    return folder


@pytest.mark.parametrize(  # each signal ends a command with workers and one without; make soak has every stage with both
    ("line", "number"), [*zip(CALLS, [signal.SIGTERM, signal.SIGINT, signal.SIGTERM, signal.SIGINT], strict=True)]
)
def test_a_signal_ends_a_command(line: str, number: signal.Signals, inputs: Path, tmp_path: Path) -> None:
    code, word = ENDS[number]
    (tmp_path / "in").symlink_to(inputs)
    run = subprocess.Popen(
        [sys.executable, "-m", "l3cli", *line.split(), "--quiet"],
        cwd=tmp_path,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a background job ignores it, and so do children
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        wait_until(lambda: any((tmp_path / "out").glob(CALLS[line])) and ("--jobs" not in line or others(run.pid)))
        (os.killpg if number == signal.SIGINT else os.kill)(run.pid, number)  # a terminal sends Ctrl-C to the whole group
        out, err = run.communicate(timeout=HANGS)
        assert (run.returncode, out, err.lstrip("\n")) == (code, "", f"l3: {word}\n")  # click ends the line of ^C
        wait_until(lambda: not others(run.pid))
    finally:
        run.kill()
    left = [str(path.relative_to(tmp_path / "out")) for path in (tmp_path / "out").rglob("*") if path.is_file()]
    assert not [name for name in left if name.endswith(".h5") and not is_remnant(name)]
    assert not [name for name in left if ".l3tmp" in name or ".l3lock" in name]


def others(group: int) -> set[int]:
    """Return the processes of a group that run, except its first one."""
    found = set()
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal() and int(entry.name) != group:
            try:
                state, _, of, *_ = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:  # it has ended meanwhile
                continue
            if int(of) == group and state != "Z":
                found.add(int(entry.name))
    return found


def wait_until(done: Callable[[], object]) -> None:
    end = time.monotonic() + HANGS
    while not done():
        assert time.monotonic() < end
        time.sleep(0.01)
