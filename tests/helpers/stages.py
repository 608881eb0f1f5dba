"""The command of every stage, with its inputs and outputs, for tests that interrupt it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from l3cli.cli import run
from l3cli.io.pictures.openimageio import write_mosaic
from l3cli.system.files import FINISHED, UNFINISHED
from tests.helpers.cameras import bayer_camera

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
CLASSES = "[classes]\npatch = 3\nlevels = 4\nchromas = 2\n[learning]\npatches = 3000\nfirst_draws = 1\ndraws = 3\n"
LAYERS = f"{CLASSES}[[layer]]\nside = 3\nmosaics = 8\nrows = 300\n"
FRAMES = 8
REMAINS = (".parts", UNFINISHED, FINISHED)  # files that an interrupted run leaves


@dataclass(frozen=True)
class Stage:
    """A command that tests interrupt. Its outputs are in the folder "out"."""

    name: str
    line: str
    resumes: bool = False
    goes_on: bool = False  # continues without an option

    @property
    def arguments(self) -> list[str]:
        return self.line.split()

    @property
    def again(self) -> list[str]:
        """Return the arguments that continue an interrupted run."""
        return [*self.arguments, *([] if self.goes_on else ["--resume" if self.resumes else "--force"])]


SIMULATE = "simulate in/scenes.toml --camera in/camera.h5 -o out/training.h5 --quiet"
RENDER = "render in/table.h5 in/frames --backend reference --exposure 0.8 --quiet"
STAGES = [
    Stage("lab", "lab in/camera.toml --recipe in/quick.toml -o out/lab --quiet"),
    Stage("calibrate", "calibrate in/lab/MEASUREMENTS.toml -o out/camera.h5 --accept --quiet"),
    Stage("simulate", SIMULATE, resumes=True),
    Stage("simulate, pictures", f"{SIMULATE} --pictures out/pictures --dng out/dng", resumes=True),
    Stage("train", "train in/training.h5 --classes in/classes.toml -o out/table.h5 --quiet"),
    Stage("train, shard", "train in/training.h5 --classes in/classes.toml --shard 1/2 -o out/sums.h5 --quiet"),
    Stage("train, two layers", "train in/training.h5 --classes in/layers.toml -o out/table.h5 --quiet"),
    Stage("still", "render in/table.h5 in/frames/f_0.tif -o out/still.png --backend reference --quiet"),
    Stage("sequence", f"{RENDER} -o out/pictures --bits 16", resumes=True),
    Stage("pattern", f"{RENDER} -o out/p_####.exr".replace("--exposure 0.8 ", ""), resumes=True),
    Stage("video", f"{RENDER} -o out/clip.mkv", resumes=True),
    Stage(
        "evaluate",
        "evaluate in/table.h5 in/unseen.h5 --pictures out/pictures --backend reference --quiet",
        goes_on=True,
    ),
    Stage("report", "report in/camera.h5 in/table.h5 in/unseen.h5 -o out/report.html --backend reference --quiet"),
    Stage("compare", "compare in/a.json in/b.json -o out/curves.html"),
    Stage("init", "init bayer out/demo --quiet"),
]
PARALLEL = [
    Stage("lab, workers", f"{STAGES[0].line} --jobs 2"),
    Stage("calibrate, workers", f"{STAGES[1].line} --jobs 2"),
    Stage("simulate, workers", f"{SIMULATE} --jobs 2", resumes=True),
    Stage("train, workers", f"{STAGES[4].line} --jobs 2"),
]


def make_inputs(folder: Path) -> Path:
    """Make the inputs of every stage by running the earlier stages, and return their folder."""
    folder.mkdir()
    recipes = {"camera": bayer_camera(), "scenes": SCENES, "lab": LAB, "quick": QUICK, "classes": CLASSES, "layers": LAYERS}
    for name, text in recipes.items():
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


def contents(folder: Path) -> dict[str, bytes]:
    """Return all files in the output folder, including hidden files.

    Lists of finished pictures are left out, because they contain times.
    """
    files = (path for path in (folder / "out").rglob("*") if path.is_file() and not path.name.endswith(FINISHED))
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def is_remnant(name: str) -> bool:
    return any(part.endswith(REMAINS) for part in Path(name).parts)


def is_hidden(name: str) -> bool:
    return any(part.startswith(".") for part in Path(name).parts)
