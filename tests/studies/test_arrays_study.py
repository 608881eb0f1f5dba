"""Commercial arrays, compared with methods without training (docs/results.md#quality-of-other-arrays).

python -m pytest -m slow -s tests/studies/test_arrays_study.py -k NAME      three minutes on a core

A table for each array is trained on the scenes of configs/scenes/default.toml and renders the 1280×720 picture of
demo_unseen.toml. The metric is the mean ΔE00 of `l3 evaluate`. Arrays whose channels have different exposures or gains are
also evaluated at an exposure at which the more sensitive channels clip.

The method "differences" resembles methods of pseudo-panchromatic differences (Mihoubi, Losson, Mathon and Macaire, 2017).
The difference between a channel and the mean of all channels varies slowly. A pixel minus this difference is therefore a
sample of the mean. The difference between the samples of a channel and the mean is interpolated. Samples with the same
filter form one channel at any exposure, and are weighted by their noise. Clipped samples have no weight.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import TrainingPair, open_training_set
from l3cli.evaluation.basic import CLIPPED, develop, fit_colour, light_of
from l3cli.evaluation.demosaic import SIGMA_SAMPLES as PLAIN_SIGMA
from l3cli.evaluation.quality import quality
from l3cli.physics.mosaic import tiled
from l3cli.recipes.builtin import CLASSES
from tests.helpers.calls import L3
from tests.helpers.paths import CONFIGS

Array = NDArray[np.floating]
SIGMA, SHARP = 0.9, 0.5  # of differences, in distances between a channel's samples; of the mean, pixels: best on quad_rgbw
ROUNDS = 2
DETAIL = 0.05  # what samples differ from their neighbours by beside noise, relative
LOST, LAST = 1e-9, 1e-6  # weights of clipped samples: nothing; of the least sensitive, where there are no others
pytestmark = pytest.mark.slow


class Case(NamedTuple):
    light: str
    below: tuple[float, ...]  # of mean ΔE00, for each of `shares`
    shares: tuple[float, ...] = (0.9,)  # of full scale, that a white fills in the brightest channel


APART = (0.9, 14.4)  # 24 dB
CASES = {
    "quad_bayer_hdr": Case("D65", (5.0, 5.0), APART),
    "nona_bayer_hdr": Case("D65", (5.0, 5.0), APART),
    "dual_iso": Case("D65", (5.0, 5.0), APART),
    "rgbir4x4": Case("3200K", (4.5,)),
    "quad_rgbw": Case("D65", (5.0,)),
    "rccb": Case("D65", (4.7,)),
    "rccg": Case("D65", (5.0,)),
}


@pytest.mark.parametrize("camera", CASES)
def test_an_array(camera: str, tmp_path: Path, l3: L3, capsys: pytest.CaptureFixture[str]) -> None:
    light, below, shares = CASES[camera]
    for made, scenes in (("training", "default"), ("unseen", "demo_unseen")):
        text = (CONFIGS / f"scenes/{scenes}.toml").read_text().replace('["D65"]', f'["{light}"]')
        if made == "unseen":
            text = text.replace("exposure_share = [0.9]", f"exposure_share = {list(shares)}")
        recipe = tmp_path / f"{made}.toml"
        recipe.write_text(text)
        assert l3("simulate", recipe, "--camera", camera, "-o", tmp_path / f"{made}.h5", "--quiet")[0] == 0
    table = tmp_path / "table.h5"
    classes = CLASSES.get(camera, "default")  # as "l3 init" gives them
    assert l3("train", tmp_path / "training.h5", "--classes", classes, "-o", table, "--quiet")[0] == 0
    code, out, _ = l3("evaluate", table, tmp_path / "unseen.h5", "--json", "--quiet")
    assert code == 0
    document = json.loads(out)
    for index, share in enumerate(shares):
        found = {name: document["frames"][index][name]["mean_delta_e"] for name in document["pipelines"]}
        found["differences"] = of_differences(tmp_path / "unseen.h5", document["border"], index)
        with capsys.disabled():
            listed = ", ".join(f"{name} {error:.2f}" for name, error in found.items())
            print(f"\n{camera}, {light}, white {share}: {listed}", flush=True)
        ours = found.pop("ours")
        assert ours < below[index]
        assert ours < 0.8 * min(found.values())


def of_differences(unseen: Path, border: int, index: int = 0) -> float:
    """Mean ΔE00 of a frame by `differences`."""
    with open_training_set(unseen) as reader:
        frame, camera = reader.frame(index), reader.head.camera
        made = develop(frame, camera, fit_colour(camera, light_of(frame, camera)), demosaic_of(frame, camera))
        return quality(made, frame.target, frame.white, border).mean_delta_e


def demosaic_of(frame: TrainingPair, camera: CameraModel) -> Callable[[Array, NDArray[np.uint8]], Array]:
    """`differences` for a frame."""
    readout = camera.readout
    filters = np.arange(len(camera.channels)) if readout is None else np.unique(readout.same_filter, return_inverse=True)[1]

    def demosaic(mosaic: Array, cfa: NDArray[np.uint8]) -> Array:
        weight = np.ones(mosaic.shape) if readout is None else weights(frame, camera)
        return differences(mosaic, filters[cfa].astype(np.uint8), weight)[filters]

    return demosaic


def weights(frame: TrainingPair, camera: CameraModel) -> Array:
    """Of the samples (row, col): what they differ by for noise and detail, inverse squared, relative to their value."""
    channel, span = camera.channel_map(frame.raw.shape), camera.white_level - camera.black_level
    signal = np.clip(frame.raw - camera.black_level, 1.0, span)
    relative = camera.noise_variance(signal, channel=channel) / signal**2
    clipped = frame.raw >= camera.black_level + CLIPPED * span
    last = camera.sensitivity[channel] == camera.sensitivity.min()
    return np.where(clipped, np.where(last, LAST, LOST), DETAIL**2 / (DETAIL**2 + relative))


def differences(mosaic: Array, cfa: NDArray[np.uint8], weight: Array) -> Array:
    """Channels (channel, row, col) of a balanced mosaic (row, col), of any CFA, whose samples have a `weight` (row, col)."""
    channel = tiled(cfa, mosaic.shape)
    count = int(cfa.max()) + 1
    planes = np.array([spread(mosaic, weight, cfa, index, PLAIN_SIGMA) for index in range(count)])
    for _ in range(ROUNDS):
        own = np.take_along_axis(planes, channel[None].astype(np.intp), axis=0)[0]
        smooth, close = (gaussian_filter(each, SHARP, mode="mirror") for each in (weight * (mosaic - own), weight))
        mean = smooth / close + gaussian_filter(planes.mean(axis=0), SHARP, mode="mirror")
        planes = np.array([mean + spread(mosaic - mean, weight, cfa, index, SIGMA) for index in range(count)])
    return planes


def spread(values: Array, weight: Array, cfa: NDArray[np.uint8], index: int, wide: float) -> Array:
    """Values (row, col) at a channel's samples, interpolated (row, col)."""
    place = np.where(tiled(cfa, values.shape) == index, weight, 0.0)
    sigma, reach = wide * np.sqrt(cfa.size / (cfa == index).sum()), 2 * max(cfa.shape)
    above, below = (gaussian_filter(each, sigma, mode="mirror", radius=reach) for each in (values * place, place))
    return np.asarray(above / below)
