"""Measured and predicted noise of rendered outputs, by level, chroma, direction and structure.

python -m pytest -m slow -s tests/studies/test_uncertainty_study.py      (twenty minutes of processor time)

Three scenes are simulated at mean signals of 1/4 and 1/30 of full scale, with 200 frames each. Every frame has a new fixed
pattern and new noise. The study uses two cameras, and tables with one layer (`fast`) and two layers (`default`). The
measured σ is the mean over the pixels of a class (without noise) of the standard deviation over the frames. The predicted σ
is the mean of four predicted maps. Classes with fewer than 10⁴ pixels are ignored.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingFrame, open_training_set
from l3cli.cli import run
from l3cli.frames.frame import RawFrame
from l3cli.rendering.renderer import make_renderer
from l3cli.rendering.uncertainty import uncertainty
from l3cli.simulation.sensor import expose, mosaic
from tests.helpers.paths import CONFIGS
from tests.helpers.recipes import THREE_SCENES

FRAMES, MAPS, BORDER, LEAST = 200, 4, 12, 10_000
SHARES = (0.25, 0.03)
SCENES = f"exposure_share = [0.9]\n{THREE_SCENES}"
Ratios = dict[tuple[str, int], NDArray[np.floating]]  # (output) of each class by axis and number


def noisy(camera: CameraModel, electrons: NDArray[np.float32], seconds: float, seed: int, noises: str = "all") -> RawFrame:
    values = expose(replace(camera, fixed_pattern_seed=seed), electrons, seconds, np.random.default_rng([seed, 1]), noises)
    return RawFrame("frame", values, camera.black_level, camera.white_level, dark=camera.dark_signal(seconds))


def ratios(table: TransformTable, camera: CameraModel, frame: TrainingFrame, share: float) -> Ratios:
    electrons = mosaic(frame.electrons, camera.cfa)
    electrons = electrons * np.float32(share * camera.full_scale / electrons.mean())
    renderer, seconds = make_renderer("opencl", table), 0.01
    clean = noisy(camera, electrons, seconds, 0, "none")
    base = renderer.outputs(clean).astype(np.float64)
    total, squares = np.zeros_like(base), np.zeros_like(base)
    for seed in range(FRAMES):
        difference = renderer.outputs(noisy(camera, electrons, seconds, seed)) - base
        total, squares = total + difference, squares + difference**2
    measured = np.sqrt((squares - total**2 / FRAMES) / (FRAMES - 1))
    maps = [uncertainty(renderer, noisy(camera, electrons, seconds, seed)) for seed in range(MAPS)]
    predicted = np.moveaxis(np.mean([each.sigma for each in maps], axis=0), -1, 0)
    usual = np.all([each.mask == 0 for each in maps], axis=0)
    usual[:BORDER] = usual[-BORDER:] = usual[:, :BORDER] = usual[:, -BORDER:] = False
    place = table.first.rule.split(renderer.labels(clean))
    axes = {"level": place.level, "chroma": place.kind, "direction": place.combination}
    if table.later:
        axes["structure"] = table.later[0].rule.split(renderer.labels(clean, 1)).kind
    found: Ratios = {}
    for axis, values in axes.items():
        for value in np.unique(values).tolist():
            inside = usual & (values == value)
            if inside.sum() >= LEAST:
                found[axis, value] = measured[:, inside].mean(axis=1) / predicted[:, inside].mean(axis=1)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("recipe", ["fast", "default"])
@pytest.mark.parametrize("name", ["bayer", "fiveband"])
def test_measured_over_predicted(name: str, recipe: str, tmp_path: Path) -> None:
    camera = load_camera(CONFIGS / f"cameras/{name}.toml")
    (tmp_path / "scenes.toml").write_text(SCENES)
    at = ("--camera", name, "--quiet", "-o")
    assert run(["simulate", "default", *at, str(tmp_path / "training.h5")]) == 0
    assert run(["simulate", str(tmp_path / "scenes.toml"), *at, str(tmp_path / "unseen.h5"), "--seed", "9"]) == 0
    learn = ["train", str(tmp_path / "training.h5"), "--classes", recipe, "--quiet", "-o", str(tmp_path / "table.h5")]
    assert run(learn) == 0
    table = load(TransformTable, tmp_path / "table.h5")
    every: list[NDArray[np.floating]] = []
    with open_training_set(tmp_path / "unseen.h5") as reader:
        for frame in reader:
            assert isinstance(frame, TrainingFrame)
            for share in SHARES:
                found = ratios(table, camera, frame, share)
                every += found.values()
                for (axis, value), of in found.items():
                    print(
                        f"{name} {recipe} {frame.scene} {share:g} {axis} {value}: {' '.join(f'{each:.3f}' for each in of)}"
                    )
    quantiles = np.quantile(np.array(every), [0, 0.1, 0.5, 0.9, 1], axis=0)
    print(f"{name} {recipe}: {len(every)} classes, least, 10 %, median, 90 %, most by output\n{quantiles.T.round(3)}")
    assert np.abs(quantiles[2] - 1).max() < 0.02
    assert 0.94 < quantiles[1].min() <= quantiles[3].max() < 1.06
