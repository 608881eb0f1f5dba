"""Arrays of a design trained and judged on the same unseen scenes, so that nobody has to believe the closed form."""

import hashlib
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingFrame, open_training_set
from l3cli.design.error import Level
from l3cli.evaluation.evaluation import raw_of
from l3cli.evaluation.quality import Target
from l3cli.options.commands import SimulateOptions, TrainOptions
from l3cli.physics.display import displayed, srgb_codes, white_luminance
from l3cli.recipes.builtin import find_recipe
from l3cli.recipes.toml import toml_value
from l3cli.stages.evaluation import FrameRenderers
from l3cli.stages.simulation.simulate import simulate
from l3cli.stages.training.whole import train
from l3cli.system.console import Silent

CLASSES = "single"
CROP = 72  # pixels of the first scene that are shown
FIGURES = ("mean_delta_e", "scielab", "output_psnr")
LEARNED = """illuminants = {lights}
exposure_share = [0.9]
[[scene]]
source = "dead leaves"
size = [160, 160]
count = 24
[[scene]]
source = "surfaces"
size = [160, 160]
count = 2
patches = [4, 4]
"""
UNSEEN = """illuminants = ["{light}"]
luminances_cd_m2 = [{luminance}]
{exposure}
[[scene]]
source = "composition"
size = [180, 320]
seed = 7
[[scene]]
source = "dead leaves"
size = [160, 160]
seed = 8
count = 2
"""


@dataclass(frozen=True)
class Trial:
    """An array that is to be trained, and where it is judged."""

    camera: CameraModel
    levels: Sequence[tuple[str, Level]]  # illuminant, and exposure
    seed: int


def trained(trial: Trial) -> dict[str, NDArray]:
    """Return FIGURES (level, scene, figure) of an array that is trained and judged on unseen scenes, crops of the first as
    sRGB codes (level, row, col, 3), ours and ideal, and the SHA-256 of what the scenes show."""
    with tempfile.TemporaryDirectory(prefix="l3-") as name:
        folder, shown, ends = Path(name), hashlib.sha256(), []
        save(trial.camera, folder / "camera.h5")
        lights = toml_value(list(dict.fromkeys(light for light, _ in trial.levels)))
        training = _simulated(LEARNED.format(lights=lights), folder, "training", trial.seed)
        train((training,), folder / "table.h5", TrainOptions(classes=find_recipe(CLASSES, "classes"), seed=trial.seed))
        table = load(TransformTable, folder / "table.h5")
        for number, (light, level) in enumerate(trial.levels):
            exposure = f"exposure_share = [{level.share}]" if level.share is not None else f"exposure_s = [{level.seconds}]"
            text = UNSEEN.format(light=light, luminance=level.luminance, exposure=exposure)
            ends.append(_judged(table, _simulated(text, folder, f"unseen{number}", trial.seed + 1), shown))
        figures, crops, ideals = map(np.array, zip(*ends, strict=True))
        digest = np.frombuffer(shown.digest(), np.uint8)
        return {"figures": figures, "crops": crops, "ideals": ideals, "digest": digest}


def _simulated(text: str, folder: Path, name: str, seed: int) -> Path:
    recipe, frames = folder / f"{name}.toml", folder / f"{name}.h5"
    recipe.write_text(text)
    simulate(recipe, folder / "camera.h5", frames, SimulateOptions(seed=seed))
    return frames


def _judged(table: TransformTable, frames: Path, shown: "hashlib._Hash") -> tuple[NDArray, NDArray, NDArray]:
    """Return FIGURES (frame, figure) of a training set, and the crops of the first, ours and ideal; `shown` takes in what
    they show."""
    rows, crops = [], list[NDArray]()
    renderers = FrameRenderers("reference", table, Silent())
    with open_training_set(frames) as reader:
        for index in range(len(reader)):
            frame = reader.frame(index)
            assert isinstance(frame, TrainingFrame)
            assert frame.shown is not None
            shown.update(f"{np.round(frame.shown.scene, 3).tolist()} {frame.luminance} {frame.illuminant}".encode())
            outputs = renderers.of(frame).outputs(raw_of(frame, index, reader.head.camera))
            outputs = outputs * (table.output_unit / frame.exposure)
            quality = Target(frame.target, frame.white, table.first.rule.radius).judge(outputs)[0]
            rows.append([getattr(quality, name) for name in FIGURES])
            if not crops:
                scale = white_luminance(frame.target[1])
                inside = tuple(slice((size - CROP) // 2, (size + CROP) // 2) for size in frame.target.shape[1:])
                cut = [planes[:, *inside] for planes in (outputs, frame.target)]
                crops = [srgb_codes(displayed(planes, frame.white, scale)) for planes in cut]
    ours, ideal = crops
    return np.array(rows), ours, ideal
