"""Rankings of arrays by the closed-form error and by training: thirty arrays of one pixel, and the arrays of l3.

python -m pytest -m slow -s tests/studies/test_design_study.py      an hour on a core per design
"""

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.design import TIE, SceneMoments, shown
from l3cli.artifacts.store import load
from l3cli.design.error import Level, noise_of, seen_by, spectra_of
from l3cli.design.search import Problem
from l3cli.design.task import Task, designed
from l3cli.options.commands import MomentsOptions
from l3cli.recipes.builtin import find_recipe
from l3cli.stages import design as stage
from l3cli.stages.design import gather_moments
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.slow
DESIGN = """
name = "arrays of one pixel"
[pixel]
camera = "bayer"
bare = 0.61
[filters]
r = { channel = "r" }
g = { channel = "g" }
b = { channel = "b" }
w = {}
c = { centre_nm = 500, sigma_nm = 55 }
y = { centre_nm = 590, sigma_nm = 75 }
o = { centre_nm = 590, sigma_nm = 40 }
k = { centre_nm = 500, sigma_nm = 28 }
"""
SHARE = "[[level]]\nshare = 0.9\n"
DARKER = "[[level]]\nluminance_cd_m2 = {}\nexposure_s = 0.0333\n"
SIXTEEN = [
    "g r/b g", "r b/b g", "r g/r b", "w r/b g", "w r/b w", "c y/y r", "c y/g r", "k o/b k", "g b/o g", "r k/b g",
    "w w w r/w g w w/w w w b/g w w w", "r r g g/r r g g/g g b b/g g b b", "r g b", "w y/c w", "r w/b w",
    "g b r b/g g g g/r g b g/g g g g",
]  # fmt: skip
FOURTEEN = [
    "w g/b r", "c y/y b", "g y/b g", "w o/c w", "g r/b c", "k r/b k", "c r/b y",
    "g b g g r g/r g r b g b/g b g g r g/g r g g b g/b g b r g r/g r g g b g", "w g w r/g w r w/w b w g/b w g w",
    "g r g b", "y r/b y", "o g/b o", "w w r r/w w r r/b b g g/b b g g", "w k/o b",
]  # fmt: skip


def ranks(expected: NDArray[np.floating], measured: NDArray[np.floating]) -> tuple[float, float]:
    """Rank correlation, and the share in order of pairs that differ by more than TIE in both."""
    one, other = np.triu_indices(len(expected), 1)
    pairs = np.log([expected[one] / expected[other], measured[one] / measured[other]])
    far = (np.abs(pairs) > TIE).all(axis=0)
    orders = [np.argsort(np.argsort(each)) for each in (expected, measured)]
    return float(np.asarray(np.corrcoef(orders))[0, 1]), float((pairs.prod(axis=0) > 0)[far].mean())


@pytest.mark.parametrize(
    ("arrays", "lights", "least", "fewest"),
    [
        (SIXTEEN, (20, 2), (0.9, 0.8, 0.8), (0.92, 0.92, 0.92)),
        (FOURTEEN, (50, 8, 4), (0.87, 0.78, 0.82, 0.82), (0.92, 0.9, 0.94, 0.9)),
    ],
)
def test_arrays_of_one_pixel_are_ranked_as_training_ranks_them(
    arrays: list[str],
    lights: tuple[float, ...],
    least: tuple[float, ...],
    fewest: tuple[float, ...],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """By the ΔE00 of unseen leaves, which the moments are of, and less strictly of compositions, of which one alone ranks
    arrays of like error otherwise than another does."""
    unseen = stage.EVALUATION_SCENES.replace("seed = 7\n", "seed = 7\ncount = 3\n").replace("count = 2\n", "count = 4\n")
    monkeypatch.setattr(stage, "EVALUATION_SCENES", unseen)
    recipe, scenes = tmp_path / "design.toml", tmp_path / "scenes.h5"
    pattern = f"[[pattern]]\narrays = {[each.split('/') for each in arrays]}\n"
    recipe.write_text(DESIGN + pattern + SHARE + "".join(map(DARKER.format, lights)))
    gather_moments(find_recipe("default", "scenes"), find_recipe("bayer", "cameras"), scenes, MomentsOptions())
    task = Task(recipe, scenes)
    cfas = [task.numbered(each.split("/")) for each in arrays]
    every = [*cfas, *task.bayer(range(len(task.names)))]  # a design knows Bayer's arrays
    errors = np.array([task.problem.errors(cfa) for cfa in every])
    design = designed(task, every, errors)
    levels = [("D65", level) for level in task.levels]
    figures = np.array(
        [
            stage.trained(stage.Trial(design.camera(shown(cfa, task.names), task.curves), levels, 0))["figures"]
            for cfa in cfas
        ]
    )  # (array, level, scene, figure)
    expected = (errors[: len(cfas)] * task.problem.share).sum(axis=2)
    for place, level in enumerate(task.levels):
        kinds = {
            "leaves": figures[:, place, 3:, 0],
            "compositions": figures[:, place, :3, 0],
            "all": figures[:, place, :, 0],
        }
        found = {name: ranks(expected[:, place], measured.mean(axis=1)) for name, measured in kinds.items()}
        with capsys.disabled():
            for name, measured in kinds.items():
                others = [np.delete(measured, n, axis=1).mean(axis=1) for n in range(measured.shape[1])]
                agree = np.mean([ranks(*pair)[0] for pair in zip(others, measured.T, strict=True)])
                rank, in_order = found[name]
                print(f"{level.name}, {name}: {rank:.2f}, {in_order:.0%}; one scene with the others {agree:.2f}")
        assert found["leaves"][0] > least[place]
        assert found["leaves"][1] > fewest[place]
        assert found["compositions"][1] > 0.6


def test_arrays_of_shipped_cameras_are_ranked_as_the_gallery_measured_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each with its own pixel and lens, all channels read alike, white at 0.9, by the one picture of docs/gallery.md."""
    rows = re.findall(r"^\| \[(\w+)\]\S+ \| \w+ \| ([\d.]+) ", (ROOT / "docs/gallery.md").read_text(), re.MULTILINE)
    expected, measured, named, gathered = [], [], [], {}
    for name, figure in rows:
        path = find_recipe(name, "cameras")
        camera = load_camera(path)
        if camera.readout is not None:
            continue
        lens = camera.pixel_pitch, camera.optics, camera.wavelength.tobytes()
        if lens not in gathered:
            gathered[lens] = tmp_path / f"{name}.h5"
            gather_moments(find_recipe("default", "scenes"), path, gathered[lens], MomentsOptions())
        expected.append(predicted(camera, gathered[lens]))
        measured.append(float(figure))
        with capsys.disabled():
            print(f"{name:12} {expected[-1]:.2f} {measured[-1]:.2f}")
        named.append(name)
    rank, in_order = ranks(np.array(expected), np.array(measured))
    wide = np.array(named) != "snapshot16"  # narrow bands, whose fine neutral patterns leaves lack
    without, _ = ranks(np.array(expected)[wide], np.array(measured)[wide])
    with capsys.disabled():
        print(f"{len(named)} cameras: {rank:.2f}, {in_order:.0%} of the pairs; {without:.2f} without snapshot16")
    assert (len(named), rank > 0.75, without > 0.9, in_order > 0.8) == (15, True, True, True)


def predicted(camera: CameraModel, moments: Path) -> float:
    """Error of a camera's own array, white at 0.9."""
    light = load(SceneMoments, moments).light[0]
    curves = camera.responsivity
    seen = seen_by(curves, light, spectra_of(light, "XYZ", "lab", curves))
    return Problem((seen,), (Level("", 0, 0.9, 100.0),), noise_of(camera)).score(camera.cfa)
