"""Make the pictures of polarisation cameras in the gallery: intensity, degree and angle of linear polarisation."""

import re
import shutil
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pictures import Picture

import l3cli
from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingPair, TrainingSet, open_training_set
from l3cli.evaluation.demosaic import bilinear as interpolated
from l3cli.evaluation.evaluation import Evaluation
from l3cli.evaluation.quality import judge_stokes
from l3cli.frames.super_pixels import SIDE
from l3cli.physics.stokes import STOKES, stokes_of
from l3cli.report.polarisation import polarisation_maps
from l3cli.stages.evaluation import FrameRenderers, evaluate_frame
from l3cli.system.console import Silent

OUTPUTS = {"polarised": "Stokes", "polarised_colour": "CIE 1931 + Stokes"}  # target outputs of each camera recipe
# A noise of 1 % of full scale in the dark, as in docs/polarisation.md#accuracy
NOISE = {
    "well_capacity_e": 2000.0, "read_noise_e": 20.0, "black_level_dn": 600.0, "gain_dn_per_e": 1.7475, "prnu": 0.0,
    "dsnu_e": 0.0, "dark_current_e_per_s": 0.0,
}  # fmt: skip
FIGURES = {"psnr_s0": 2, "psnr_dolp": 2, "aolp_rmse": 1, "dolp_bias": 4}  # metrics in the page, and their decimal places
MAPS, PIPELINES = ("S0", "DoLP", "AoLP"), ("ideal", "ours", "bilinear")  # rows and columns of the pictures
Array = NDArray[np.floating]


class Judged(NamedTuple):
    """A rendered frame of a polarisation camera."""

    head: TrainingSet
    pictures: list[list[Picture]]  # by map and pipeline
    figures: dict[str, dict[str, float]]  # metrics of each pipeline
    scale: float  # upper end of the scale of DoLP


def noisy_camera(recipe: Path, folder: Path) -> Path:
    """Write the recipe of a camera with a noise of 1 % of full scale, for the pixels of `recipe`. Return its path."""
    text = recipe.read_text(encoding="utf-8")
    for key, value in NOISE.items():
        text = re.sub(rf"(?m)^{key} = .*", f"{key} = {value}", text)
    (folder / "camera.toml").write_text(text, encoding="utf-8")
    shutil.copy(recipe.parent / "polarised_extinction.csv", folder)
    return folder / "camera.toml"


def with_outputs(recipe: Path, outputs: str, path: Path, lens: bool = True) -> Path:
    """Write a scene recipe with the outputs of a polarisation camera to `path`. Without `lens`, scenes are not blurred."""
    text = re.sub(r"(?m)^\[target\]\noutputs = .*\n", "", recipe.read_text(encoding="utf-8"))
    head, first, scenes = text.partition("[[scene]]")
    head += "" if lens else "[lens]\ndiffraction = false\n"
    path.write_text(f'{head}[target]\noutputs = "{outputs}"\n{first}{scenes}', encoding="utf-8")
    return path


def judged(table: Path, unseen: Path) -> Judged:
    """Render the only frame of a set with a table and with bilinear interpolation."""
    transforms = l3cli.load(table)
    assert isinstance(transforms, TransformTable)
    with open_training_set(unseen) as reader:
        head, outputs = reader.head, transforms.outputs
        frame, planes = evaluate_frame(
            Evaluation(transforms, head), FrameRenderers("opencl", transforms, Silent()), reader, 0
        )
        white = np.zeros(3)
        white[STOKES.index("S0")] = stokes_of(frame.white, outputs)[0]
        target = _in_order(stokes_of(frame.target, outputs))
        made = {"ours": _in_order(stokes_of(planes["ours"], outputs)), "bilinear": bilinear(frame, head.camera, target)}
        maps, scale = polarisation_maps(target, made, STOKES)
        qualities = {name: judge_stokes(of, target, white, STOKES)[0] for name, of in made.items()}
    figures = {
        name: {key: round(getattr(of, key), places) for key, places in FIGURES.items()} for name, of in qualities.items()
    }
    return Judged(head, [[maps[kind][pipeline] for pipeline in PIPELINES] for kind in MAPS], figures, scale)


def _in_order(stokes: Array) -> Array:
    """Return S1, S0 and S2 from S0, S1 and S2."""
    return stokes[[1, 0, 2]].astype(np.float64)


def bilinear(frame: TrainingPair, camera: CameraModel, target: Array) -> Array:
    """Compute S1, S0 and S2 of the luminance by bilinear interpolation of all channels.

    The Stokes parameters of each colour are the least-squares solution for its four polarisers. The luminance is the sum of
    the colours that is most similar to the target.
    """
    span = camera.white_level - camera.black_level
    planes = interpolated((frame.raw - camera.black_level) / span, camera.cfa)
    blocks = camera.cfa.reshape(camera.cfa.shape[0] // SIDE, SIDE, -1, SIDE).swapaxes(1, 2).reshape(-1, SIDE**2)
    colours = np.unique(np.sort(blocks, axis=1), axis=0)
    response = camera.relative_stokes_response
    parts = np.stack([_in_order(np.tensordot(np.linalg.pinv(response[own]), planes[own], 1)) for own in colours])
    share = np.linalg.lstsq(parts.reshape(len(parts), -1).T, target.ravel())[0]
    return np.tensordot(share, parts, 1)
