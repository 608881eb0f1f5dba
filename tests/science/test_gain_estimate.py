"""Estimates of the analog gain from the noise of uniform areas. tests/studies/test_gain_study.py tests more arrays."""

from dataclasses import replace

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.frames.frame import RawFrame
from l3cli.frames.gain_estimate import estimate_gain
from tests.helpers.paths import CONFIGS
from tests.helpers.plain_scenes import SHAPE, cells, taken


def camera_of(name: str) -> CameraModel:
    """The camera of a recipe, with as many pixels as the frames."""
    return replace(load_camera(CONFIGS / f"cameras/{name}.toml"), rows=SHAPE[0], cols=SHAPE[1])


BAYER = camera_of("bayer")


def frame_of(camera: CameraModel, values: np.ndarray) -> RawFrame:
    return RawFrame("frame", values, camera.black_level, camera.white_level)


@pytest.mark.parametrize(("name", "gains"), [("bayer", (1.0, 20.0)), ("snapshot16", (20.0,)), ("xtrans", (20.0,))])
def test_the_gain_of_a_frame_is_that_of_its_plain_areas(name: str, gains: tuple[float, ...]) -> None:
    """A third of which are textured; also of a frame cut so that it begins with another site, of other levels."""
    camera = camera_of(name)
    share = cells(camera, np.random.default_rng(1), 1 / 3)
    for gain in gains:
        values = taken(camera, share, gain)
        estimate = estimate_gain(frame_of(camera, values), camera)
        assert estimate.gain == pytest.approx(gain, rel=0.1)
        assert estimate.bounds[0] < gain < estimate.bounds[1]
        assert 0.04 < estimate.error < 0.08
    cut = RawFrame("cut", 4 * values[3:, 1:], 4 * camera.black_level, 4 * camera.white_level, phase=(3, 1))
    assert estimate_gain(cut, camera).gain == pytest.approx(gain, rel=0.1)


@pytest.mark.parametrize("lines", ["row_temporal_noise", "column_temporal_noise", "row_noise", "column_noise"])
@pytest.mark.parametrize("gain", [1.0, 16.0])
def test_noise_of_rows_and_columns_is_not_taken_for_pixel_noise(lines: str, gain: float) -> None:
    """Such noise is among the strong components, even if it is twice as strong as the read noise."""
    camera = replace(BAYER, noise=replace(BAYER.noise, **{lines: 2 * BAYER.noise.read_noise}))
    values = taken(camera, 0.2 * cells(camera, np.random.default_rng(1), 1 / 3), gain)
    assert estimate_gain(frame_of(camera, values), camera).gain == pytest.approx(gain, rel=0.15)


def test_noise_alone_tells_the_gain() -> None:
    """Of an even grey, unless the camera's pixels differ by as much as their noise: then nothing tells which it is."""
    grey = np.full(SHAPE, 0.3)
    assert estimate_gain(frame_of(BAYER, taken(BAYER, grey, 16.0)), BAYER).gain == pytest.approx(16, rel=0.1)
    uneven = replace(BAYER, noise=replace(BAYER.noise, prnu=0.03))
    with pytest.raises(ValueError, match="too few areas are uniform"):
        estimate_gain(frame_of(uneven, taken(uneven, grey, 1.0)), uneven)


def test_a_frame_without_plain_areas_is_refused() -> None:
    rng = np.random.default_rng(2)
    for share, reason in (
        (cells(BAYER, rng, 1.0), "no uniform area was found"),
        (np.full(SHAPE, 1.0), "clipped"),
        (np.zeros((4, 40)), "smaller than 8×8"),
    ):
        with pytest.raises(ValueError, match=reason):
            estimate_gain(frame_of(BAYER, taken(BAYER, share, 1.0)), BAYER)
    with pytest.raises(ValueError, match="no uniform area was found"):  # without noise
        estimate_gain(frame_of(BAYER, np.full(SHAPE, 1000, np.uint16)), BAYER)
    silent = replace(BAYER, noise=replace(BAYER.noise, read_noise=0.0, dsnu=0.0))
    # The noise of 0.289 DN is the noise of rounding.
    for noise, reason in ((5.0, "no uniform area was found"), (0.289, "all pixels are black")):
        below = np.rint(16 * rng.normal(BAYER.black_level - 40, noise, SHAPE)).astype(np.uint16)
        with pytest.raises(ValueError, match=reason):
            estimate_gain(RawFrame("dark", below, 16 * BAYER.black_level, 16 * BAYER.white_level), silent)
