"""Blinking pixels: how many of the drawn ones are found, and that other noise is not mistaken for them."""

import dataclasses
from collections.abc import Iterator

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.fit import Fit
from l3cli.calibration.blinking import FALSE_ALARMS, MIN_FRAMES, SHARE_OF_COUNT, find_blinking, two_levels
from l3cli.calibration.captures import correct_by_frames, measure_sensor, with_corrections
from l3cli.calibration.figures import blinking_figures, figures
from l3cli.calibration.model import describe_noise
from l3cli.calibration.statistics import defect_counts
from l3cli.frames.measurement import Body, Capture, Measurements
from l3cli.report.camera import operation_point
from l3cli.simulation.sensor import DefectRecipe, FixedPattern, defects_of, fixed_pattern, read_out

SHAPE = (128, 160)


@dataclasses.dataclass(frozen=True)
class Drawn:
    """Frames that are drawn again in each iteration."""

    camera: CameraModel
    steps: np.ndarray  # (row, col) difference of the two levels in e-
    light: np.ndarray  # (row, col) e-
    share: float
    count: int

    def __iter__(self) -> Iterator[np.ndarray]:
        pattern = fixed_pattern(self.camera)
        for number in range(self.count):
            rng = np.random.default_rng([number, 8])
            up = rng.random(self.steps.shape) < self.share
            yield read_out(self.camera, FixedPattern(pattern.prnu, pattern.dsnu + self.steps * up), self.light, 0.0, rng)


def small(camera: CameraModel, **noise: float) -> CameraModel:
    rows, cols = SHAPE
    return dataclasses.replace(camera, rows=rows, cols=cols, noise=dataclasses.replace(camera.noise, **noise))


def body_of(camera: CameraModel) -> Body:
    geometry = camera.name, camera.rows, camera.cols, camera.pixel_pitch, camera.bits, camera.channels, camera.cfa
    return Body(*geometry, camera.optics)


def found_in(drawn: Drawn) -> np.ndarray:
    """A mask of the pixels that are found."""
    result = find_blinking([Capture("dark", 0.1, drawn)], [drawn.count], body_of(drawn.camera))
    assert result is not None
    mask = np.zeros(SHAPE, bool)
    mask[tuple(result.position.T)] = True
    return mask


@pytest.mark.parametrize(
    ("count", "sigmas", "share", "recall"),
    [(32, 8, 0.5, 0.95), (32, 10, 0.2, 0.88), (64, 6, 0.5, 0.95), (128, 5, 0.5, 0.95), (128, 6, 0.2, 0.9)],
)
def test_drawn_blinking_pixels_are_found(bayer: CameraModel, count: int, sigmas: float, share: float, recall: float) -> None:
    """The steps are multiples of the noise of a pixel, of which 2.3 % blink. None of the others is found."""
    camera = small(bayer, row_temporal_noise=2.0)
    noise = np.sqrt(camera.noise.read_noise**2 + 1 / 12 / camera.gain**2)
    steps = np.zeros(SHAPE, np.float32)
    steps[::6, ::7] = sigmas * noise
    found = found_in(Drawn(camera, steps, np.zeros(SHAPE, np.float32), share, count))
    assert found[steps > 0].mean() >= recall
    assert not found[steps == 0].any()


@pytest.mark.parametrize("kind", ["read", "hot", "shot", "fine", "lines"])
def test_other_noise_does_not_blink(bayer: CameraModel, kind: str) -> None:
    """Hot pixels have shot noise of up to 20 times the read noise. With little noise, values jump by 1 DN."""
    camera = small(bayer)
    light = np.zeros(SHAPE, np.float32)
    if kind == "hot":
        light[::3, ::3] = np.geomspace(100, 6000, light[::3, ::3].size).reshape(light[::3, ::3].shape)
    elif kind == "shot":
        light[:] = 2000.0
    elif kind == "fine":
        camera = small(bayer, read_noise=1.0, dsnu=2.0)
    elif kind == "lines":
        camera = small(bayer, row_temporal_noise=20.0, column_temporal_noise=20.0)
    assert not found_in(Drawn(camera, np.zeros(SHAPE, np.float32), light, 0.0, 48)).any()


def test_a_particle_does_not_make_a_pixel_blink(bayer: CameraModel) -> None:
    camera = small(bayer)
    frames = list(Drawn(camera, np.zeros(SHAPE, np.float32), np.zeros(SHAPE, np.float32), 0.0, 40))
    frames[7][20, 30] += 800
    frames[21][20, 30] += 700
    result = find_blinking([Capture("dark", 0.1, frames)], [40], body_of(camera))
    assert result is not None
    assert not len(result.position)


@pytest.mark.parametrize("count", [32, 64])
def test_the_false_alarm_rate_is_what_is_stated(count: int) -> None:
    """At a rate of 100 in a million, which is counted faster: the tail is exponential in −n ln(1 − share)."""
    assert FALSE_ALARMS == 1e-6
    values = np.random.default_rng(2).standard_normal((count, 60_000))
    tail = -count * np.log1p(-two_levels(values)[0])
    first = np.quantile(tail, 0.999)
    slope = (tail[tail > first] - first).mean()
    predicted = 1 - np.exp(-(first + slope * np.log(1e-3 / FALSE_ALARMS)) / count)
    assert predicted == pytest.approx(SHARE_OF_COUNT[count], abs=0.02)


def test_few_frames_are_not_searched(bayer: CameraModel) -> None:
    camera = small(bayer)
    frames = Drawn(camera, np.full(SHAPE, 400, np.float32), np.zeros(SHAPE, np.float32), 0.5, MIN_FRAMES - 1)
    assert find_blinking([Capture("dark", 0.1, frames)], [MIN_FRAMES - 1], body_of(camera)) is None


def measurements_of(camera: CameraModel, steps: np.ndarray, **further: object) -> Measurements:
    dark = np.zeros(SHAPE, np.float32)
    darks = tuple(
        Capture(f"dark {seconds}", seconds, Drawn(camera, steps, dark, 0.5, count))
        for seconds, count in ((0.1, 40), (0.2, 4))
    )
    whites = tuple(
        Capture(f"white {seconds}", seconds, Drawn(camera, 0 * steps, dark + 20000 * np.float32(seconds), 0.5, 4))
        for seconds in (0.1, 0.2, 0.3, 0.4)
    )
    return Measurements(body_of(camera), darks=darks, whites=whites, **further)  # type: ignore[arg-type]


@pytest.mark.parametrize("listed", [False, True])
def test_calibration_counts_blinking_pixels_and_lists_them_on_request(bayer: CameraModel, listed: bool) -> None:
    camera, steps = small(bayer, dark_current=0.0), np.zeros(SHAPE, np.float32)
    steps[::16, ::16] = 60.0
    measurements = measurements_of(camera, steps, blinking_defects=listed)
    measured = measure_sensor(measurements)
    fit = describe_noise(measured, measurements.body)
    assert fit.blinking_frames == 40
    assert fit.blinking is not None
    assert fit.blinking_step is not None
    assert {*map(tuple, np.argwhere(steps > 0).tolist())} == {*map(tuple, fit.blinking.tolist())}
    assert np.median(fit.blinking_step) == pytest.approx(60, rel=0.1)
    model = with_corrections(dataclasses.replace(camera, fit=Fit(noise=fit)), measured, measurements.body)
    assert model.defects is not None
    assert defect_counts(model.defects, SHAPE).get("blinking", 0) == (80 if listed else 0)
    assert blinking_figures(model)["blinking pixels"] == (pytest.approx(1e6 / 256), "per million")
    assert figures(model)["camera"]["blinking pixels"]["unit"] == "per million"
    assert any("80" in row[1] for row in operation_point(model, fit).rows if row[0] == "Blinking pixels")


def test_corrections_of_a_known_camera_list_blinking_pixels_on_request(bayer: CameraModel) -> None:
    camera, steps = small(bayer, dark_current=0.0), np.zeros(SHAPE, np.float32)
    steps[::16, ::16] = 60.0
    for listed in (False, True):
        corrected = correct_by_frames(camera, measurements_of(camera, steps, base=camera, blinking_defects=listed))
        assert corrected.defects is not None
        assert defect_counts(corrected.defects, SHAPE).get("blinking", 0) == (80 if listed else 0)


def test_the_lab_draws_blinking_pixels_last(bayer: CameraModel) -> None:
    plain, blinking = DefectRecipe(), DefectRecipe(blinking_pixels_per_million=1000.0)
    without, found = (defects_of(bayer, each) for each in (plain, blinking))
    assert not len(without.blinking)
    assert len(found.blinking) == len(found.steps) == 49
    for name in ("hot", "dead", "shade"):
        np.testing.assert_array_equal(getattr(without, name), getattr(found, name))
    drawn = np.array([found.blinks(np.random.default_rng(seed)) for seed in range(400)])
    np.testing.assert_allclose((drawn > 0).mean(axis=0), 0.5, atol=0.15)
    assert found.steps.mean() == pytest.approx(50, rel=0.5)
