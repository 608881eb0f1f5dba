"""Nothing lost, nothing half-written: every stage killed at random moments, on full and read-only disks, without its inputs, cut
short, twice at a time. A few of each here; `make soak` has forty kills a stage."""

import os
import random
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import pytest

from l3cli.cli import run
from l3cli.io.images import write_mosaic
from tests.conftest import bayer_camera
from tests.forkserver import Ended, ForkServer

SCENES = """
exposure_share = [0.9]
[[scene]]
source = "dead leaves"
size = [64, 64]
count = 4
"""
QUICK = """
[mono]
step_nm = 60
bandwidth_nm = 20
overexposed = 1
[white]
levels = [0.2, 1.5]
trials = 2
[dark]
exposures_s = [0.01, 0.02]
trials = 2
[chart]
illuminants = ["A"]
"""
LAB = """
[mono]
first_nm = 400
last_nm = 700
step_nm = 20
trials = 1
[white]
levels = [0.02, 0.1, 0.2, 0.4, 0.6, 0.8, 1.3]
trials = 2
[dark]
exposures_s = [0.001, 0.5, 1.0]
trials = 2
[chart]
illuminants = ["D65", "A"]
"""
CLASSES = "[classes]\npatch = 3\nlevels = 4\n[learning]\npatches = 3000\n"
FRAMES = 8
ENDED = {signal.SIGINT: (130, "l3: interrupted\n"), signal.SIGTERM: (143, "l3: terminated\n"), signal.SIGKILL: (-9, "")}
REMAINS = {"training.h5.parts", ".l3-render"}  # what --resume goes on from


@dataclass(frozen=True)
class Stage:
    """One command as it is run for the faults; its outputs lie in "out"."""

    name: str
    line: str
    resumes: bool = False

    @property
    def arguments(self) -> list[str]:
        return self.line.split()

    @property
    def again(self) -> list[str]:
        """What goes on after a run that was stopped."""
        return [*self.arguments, "--resume" if self.resumes else "--force"]


SIMULATE = "simulate in/scenes.toml --camera in/camera.h5 -o out/training.h5 --quiet"
RENDER = "render in/table.h5 in/frames --backend reference --exposure 0.8 --quiet"
STAGES = [
    Stage("lab", "lab in/camera.toml --recipe in/quick.toml -o out/lab --quiet"),
    Stage("calibrate", "calibrate in/lab/MEASUREMENTS.toml -o out/camera.h5 --export out/curves --accept --quiet"),
    Stage("simulate", SIMULATE, resumes=True),
    Stage("simulate, pictures", f"{SIMULATE} --pictures out/pictures"),
    Stage("train", "train in/training.h5 --classes in/classes.toml -o out/table.h5 --quiet"),
    Stage("train, shard", "train in/training.h5 --classes in/classes.toml --shard 1/2 -o out/sums.h5 --quiet"),
    Stage("still", "render in/table.h5 in/frames/f_0.tif -o out/still.png --backend reference --quiet"),
    Stage("sequence", f"{RENDER} -o out/pictures --bits 16", resumes=True),
    Stage("pattern", f"{RENDER} -o out/p_####.exr".replace("--exposure 0.8 ", ""), resumes=True),
    Stage("video", f"{RENDER} -o out/clip.mkv"),
    Stage("evaluate", "evaluate in/table.h5 in/unseen.h5 --json --pictures out/pictures --backend reference --quiet"),
    Stage("report", "report in/camera.h5 in/table.h5 in/unseen.h5 -o out/report.html --backend reference --quiet"),
    Stage("compare", "compare in/a.json in/b.json -o out/curves.html"),
]
every_stage = pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.name)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder "in" of every stage's inputs, made by the stages before."""
    folder = tmp_path_factory.mktemp("faults") / "in"
    folder.mkdir()
    for name, text in {"camera": bayer_camera(), "scenes": SCENES, "lab": LAB, "quick": QUICK, "classes": CLASSES}.items():
        (folder / f"{name}.toml").write_text(text)

    def l3(*arguments: object) -> None:
        assert run([str(argument) for argument in arguments]) == 0

    camera, training, table = folder / "camera.h5", folder / "training.h5", folder / "table.h5"
    l3("lab", folder / "camera.toml", "--recipe", folder / "lab.toml", "-o", folder / "lab", "--quiet")
    l3("calibrate", folder / "lab/MEASUREMENTS.toml", "-o", camera, "--accept", "--quiet")
    l3("simulate", folder / "scenes.toml", "--camera", camera, "-o", training, "--quiet")
    l3("train", training, "--classes", folder / "classes.toml", "-o", table, "--quiet")
    (folder / "unseen.toml").write_text(SCENES.replace("count = 4", "count = 2"))
    l3("simulate", folder / "unseen.toml", "--camera", camera, "-o", folder / "unseen.h5", "--seed", 1, "--quiet")
    for number in range(FRAMES):
        values = np.random.default_rng(number).integers(64, 4000, (192, 256)).astype(np.uint16)
        write_mosaic(folder / f"frames/f_{number}.tif", values)
    return folder


@pytest.fixture(scope="module")
def compared(inputs: Path) -> None:
    """The two evaluations that l3 compare takes."""
    from l3cli.cli import l3

    for name in ("a", "b"):
        from click.testing import CliRunner

        arguments = ["evaluate", str(inputs / "table.h5"), str(inputs / "unseen.h5"), "--json", "--backend", "reference"]
        result = CliRunner().invoke(l3, arguments)
        assert result.exit_code == 0
        (inputs / f"{name}.json").write_text(result.stdout)


@pytest.fixture(scope="module")
def server(inputs: Path, compared: None) -> Iterator[ForkServer]:
    server = ForkServer(inputs.parent)
    yield server
    server.close()


@pytest.fixture(scope="module")
def truth(server: ForkServer) -> Callable[[Stage], tuple[dict[str, bytes], str, float]]:
    """What an undisturbed run of a stage leaves and says, and how many seconds it takes."""
    found: dict[str, tuple[dict[str, bytes], str, float]] = {}

    def ask(stage: Stage) -> tuple[dict[str, bytes], str, float]:
        if stage.name not in found:
            clear(server)
            start = time.monotonic()
            ended = server.run(*stage.arguments)
            seconds = time.monotonic() - start
            assert (ended.code, ended.err) == (0, "")
            found[stage.name] = contents(server.folder), ended.out, seconds
        return found[stage.name]

    return ask


def clear(server: ForkServer) -> None:
    shutil.rmtree(server.folder / "out", ignore_errors=True)


def contents(folder: Path) -> dict[str, bytes]:
    """Everything in the output folder, hidden files too."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in (folder / "out").rglob("*") if path.is_file()}


def is_remnant(name: str) -> bool:
    return any(part in REMAINS for part in Path(name).parts)


def is_hidden(name: str) -> bool:
    return any(part.startswith(".") for part in Path(name).parts)


# ---------------------------------------------------------------------------------------------------------- killed


def kill_once(stage: Stage, number: int, seed: int, server: ForkServer, truth: Callable) -> bool:
    """Kill a run at a random moment; whether it was still running. What must hold is asserted here."""
    whole, said, seconds = truth(stage)
    clear(server)
    moment = random.Random(f"{stage.name} {seed}").uniform(0, seconds)
    ended = server.run(*stage.arguments, kill=(moment, number))
    left = contents(server.folder)
    finished = {name: content for name, content in left.items() if not is_hidden(name) and not is_remnant(name)}
    assert all(whole[name] == content for name, content in finished.items())  # nothing half-written
    if ended.code != 0:
        assert (ended.code, ended.err.lstrip("\n")) == ENDED[signal.Signals(number)]
        if number != signal.SIGKILL:
            assert [name for name in left if is_hidden(name) and not is_remnant(name)] == []
            assert [name for name in left if ".l3tmp" in name] == []
    again = server.run(*stage.arguments) if finished == whole and whole else server.run(*stage.again)
    assert again.err.count("\n") <= 1
    assert again.code == 0 or (again.code == 1 and "--force" in again.err and finished == whole)
    if again.code == 0:
        assert again.out == said
    assert contents(server.folder) == whole
    return ended.code != 0


@every_stage
def test_a_killed_run_leaves_nothing_that_the_next_does_not_mend(stage: Stage, server: ForkServer, truth: Callable) -> None:
    kill_once(stage, signal.SIGKILL, 0, server, truth)


@pytest.mark.soak
@every_stage
def test_forty_killed_runs(stage: Stage, server: ForkServer, truth: Callable) -> None:
    signals = [signal.SIGKILL, signal.SIGTERM, signal.SIGKILL, signal.SIGINT]
    hit = sum(kill_once(stage, signals[seed % 4], seed, server, truth) for seed in range(100, 140))
    print(f"{stage.name}: 40 kills, {hit} while it ran, all mended")
    assert hit >= 20
