"""Arrays as they are sold, beside what can be built for them without learning (docs/arrays.md#figures).

python -m pytest -m slow -s tests/studies/test_arrays_study.py -k NAME      three minutes on a core

Each learns from the scenes of configs/scenes/default.toml and renders the 1280×720 picture of demo_unseen.toml; mean ΔE00 as
"l3 evaluate" has it.

"differences": a pixel, less what its channel differs by from the mean of all channels about it,
is a sample of that mean; what the samples of a channel differ by from it varies slowly and is interpolated, as in methods of
pseudo-panchromatic differences (Mihoubi, Losson, Mathon and Macaire, 2017).
"""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from l3cli.artifacts.training_set import open_training_set
from l3cli.evaluation.basic import develop, fit_colour, light_of
from l3cli.evaluation.demosaic import interpolate, tiled
from l3cli.evaluation.quality import quality
from tests.helpers.paths import CONFIGS

Array = NDArray[np.floating]
SIGMA, SHARP = 0.9, 0.5  # of differences, in distances between a channel's samples; of the mean, pixels: best on quad_rgbw
ROUNDS = 2
CASES = {"quad_rgbw": ("D65", 5.0), "rgbir4x4": ("3200K", 4.5)}  # light, and what mean ΔE00 stays below
pytestmark = pytest.mark.slow


@pytest.mark.parametrize("camera", CASES)
def test_an_array(camera: str, tmp_path: Path, l3: Callable, capsys: pytest.CaptureFixture[str]) -> None:
    light, below = CASES[camera]
    for made, scenes in (("training", "default"), ("unseen", "demo_unseen")):
        recipe = tmp_path / f"{made}.toml"
        recipe.write_text((CONFIGS / f"scenes/{scenes}.toml").read_text().replace('["D65"]', f'["{light}"]'))
        assert l3("simulate", recipe, "--camera", camera, "-o", tmp_path / f"{made}.h5", "--quiet")[0] == 0
    table = tmp_path / "table.h5"
    assert l3("train", tmp_path / "training.h5", "--classes", "default", "-o", table, "--quiet")[0] == 0
    code, out, _ = l3("evaluate", table, tmp_path / "unseen.h5", "--json", "--quiet")
    assert code == 0
    document = json.loads(out)
    found = {name: document["mean"][name]["mean_delta_e"] for name in document["pipelines"]}
    found["differences"] = of_differences(tmp_path / "unseen.h5", document["border"])
    with capsys.disabled():
        print(f"\n{camera}, {light}: " + ", ".join(f"{name} {error:.2f}" for name, error in found.items()), flush=True)
    assert found["ours"] < below
    assert found["ours"] < 0.8 * min(found["basic"], found["differences"])


def of_differences(unseen: Path, border: int) -> float:
    """Mean ΔE00 of the frame by `differences`."""
    with open_training_set(unseen) as reader:
        frame, camera = reader.frame(0), reader.head.camera
        made = develop(frame, camera, fit_colour(camera, light_of(frame, camera)), differences)
        return quality(made, frame.target, frame.white, border).mean_delta_e


def differences(mosaic: Array, cfa: NDArray[np.uint8]) -> Array:
    """Channels (channel, row, col) of a balanced mosaic (row, col), of any CFA."""
    channel, planes = tiled(cfa, mosaic.shape), interpolate(mosaic, cfa)
    for _ in range(ROUNDS):
        own = np.take_along_axis(planes, channel[None].astype(np.intp), axis=0)[0]
        mean = gaussian_filter(mosaic - own + planes.mean(axis=0), SHARP, mode="mirror")
        planes = np.array([mean + spread(mosaic - mean, cfa, index) for index in range(len(planes))])
    return planes


def spread(values: Array, cfa: NDArray[np.uint8], index: int) -> Array:
    """Values (row, col) at a channel's samples, interpolated (row, col)."""
    here = (tiled(cfa, values.shape) == index).astype(np.float64)
    sigma, reach = SIGMA * np.sqrt(cfa.size / (cfa == index).sum()), 2 * max(cfa.shape)
    above, below = (gaussian_filter(each, sigma, mode="mirror", radius=reach) for each in (values * here, here))
    return np.asarray(above / below)
