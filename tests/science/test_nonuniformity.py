"""Spectra, profiles and histograms of DSNU and PRNU, against fixed patterns that are known."""

import dataclasses

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.fit import NoiseFit, Nonuniformity
from l3cli.calibration.captures import measure_sensor
from l3cli.calibration.model import describe_noise
from l3cli.calibration.nonuniformity import NoiseLeft, describe, power_spectrum
from l3cli.frames.measurement import Body, Capture, Measurements
from l3cli.simulation.sensor import FixedPattern, read_out
from tests.helpers.paths import CONFIGS

ROWS, COLS = 256, 512
PERIOD, WAVE, RIPPLE = 16, 6.0, 0.02  # period of a sine along rows in pixels, its amplitude in e-, and in the response
HOT = (40, 60)


@pytest.fixture(scope="module")
def measured() -> tuple[CameraModel, NoiseFit]:
    """A sensor with white noise of pixels, rows and columns, a sine along rows in offset and response, and a hot pixel."""
    camera = load_camera(CONFIGS / "cameras/bayer.toml")
    noise = dataclasses.replace(
        camera.noise, row_temporal_noise=2.0, row_noise=3.0, column_noise=2.0, dsnu=2.0, prnu=0.01, row_prnu=0.01
    )
    camera = dataclasses.replace(camera, rows=ROWS, cols=COLS, noise=noise)
    rng = np.random.default_rng(7)
    wave = np.sin(2 * np.pi * np.arange(COLS) / PERIOD)

    def drawn(deviation: float, *shape: int) -> np.ndarray:
        """Random numbers that have exactly this standard deviation."""
        values = rng.normal(0, 1, shape)
        return values * (deviation / values.std())

    def pattern(pixels: float, rows: float, columns: float, amplitude: float) -> np.ndarray:
        values = drawn(pixels, ROWS, COLS) + drawn(rows, ROWS, 1) + drawn(columns, COLS)
        return (values + amplitude * wave).astype(np.float32)

    fixed = FixedPattern(pattern(0.01, 0.01, 0.0, RIPPLE), pattern(2.0, 3.0, 2.0, WAVE))
    fixed.dsnu[HOT] += 400.0

    def captures(times: tuple[float, ...], rate: float) -> tuple[Capture, ...]:
        return tuple(
            Capture(f"{t} s", t, [read_out(camera, fixed, np.full((ROWS, COLS), rate * t), t, rng) for _ in range(8)])
            for t in times
        )

    c = camera
    body = Body(c.name, c.rows, c.cols, c.pixel_pitch, c.bits, c.channels, c.cfa, c.optics)
    frames = Measurements(body, darks=captures((0.01, 0.5, 1.0, 2.0), 0.0), whites=captures((0.1, 0.3, 0.5, 0.7), 6000.0))
    return camera, describe_noise(measure_sensor(frames), body)


@pytest.mark.parametrize(
    ("which", "white", "rows", "columns", "amplitude"),
    [("dark_pattern", 2.0, 3.0, 2.0, WAVE), ("response_pattern", 0.01, 0.01, 0.0, RIPPLE)],
)
def test_spectra_are_those_of_the_fixed_pattern(
    measured: tuple[CameraModel, NoiseFit], which: str, white: float, rows: float, columns: float, amplitude: float
) -> None:
    """Temporal noise is left out: along rows, white noise of pixels and columns; along columns, of pixels and rows."""
    found: Nonuniformity = getattr(measured[1], which)
    count = len(found.frequency)
    sine = int(np.argmax(found.horizontal_spectrum))
    assert abs(found.frequency[sine] - 1 / PERIOD) <= 0.5 / count
    along = found.horizontal_spectrum**2
    power = amplitude**2 / 4 * COLS / (COLS / 2 / count)  # shared by all coefficients in the range of frequencies
    assert along[sine] == pytest.approx(power + white**2 + columns**2, rel=0.05)
    assert np.delete(along, sine).mean() == pytest.approx(white**2 + columns**2, rel=0.05)
    assert (found.vertical_spectrum**2).mean() == pytest.approx(white**2 + rows**2, rel=0.05)


def test_white_noise_has_its_variance_at_every_frequency() -> None:
    picture = np.random.default_rng(1).normal(0, 3.0, (500, 301))
    for axis in (0, 1):
        assert power_spectrum(picture, axis, 20) == pytest.approx(9.0, rel=0.06)
        assert power_spectrum(picture, axis, 1).item() == pytest.approx(9.0, rel=0.01)


def test_profiles_show_offsets_and_defects(measured: tuple[CameraModel, NoiseFit]) -> None:
    camera, fit = measured
    found = fit.dark_pattern
    assert found is not None
    mean, low, high, _ = found.horizontal_profile
    wave = WAVE * np.sin(2 * np.pi * found.column / PERIOD)
    assert np.corrcoef(mean, wave)[0, 1] > 0.85
    assert (low < mean).all()
    assert (mean < high).all()
    assert high[np.abs(found.column - HOT[1]).argmin()] == pytest.approx(400, rel=0.1)
    assert np.sort(high)[-2] < 60
    assert found.vertical_profile[2].max() == high.max()
    assert found.row[-1] < camera.rows


def test_histograms_count_all_pixels(measured: tuple[CameraModel, NoiseFit]) -> None:
    for found in (measured[1].dark_pattern, measured[1].response_pattern):
        assert found is not None
        assert found.histogram_count.sum() == ROWS * COLS
        assert (np.diff(found.exceeding) <= 0).all()
        assert found.exceeding[0] > 0.8 * ROWS * COLS
        assert found.exceeding[-1] == 1
    dark = measured[1].dark_pattern
    assert dark is not None
    assert dark.threshold[-1] == pytest.approx(400, rel=0.1)
    assert dark.exceeding[np.searchsorted(dark.threshold, 100.0)] == 1  # the hot pixel


def test_a_normal_pattern_has_the_histogram_of_a_normal_distribution() -> None:
    picture = np.random.default_rng(2).normal(0, 2.0, (400, 400))
    found = describe(picture, picture, picture, NoiseLeft(0.0, 0.0, 0.0))
    assert found.spread == pytest.approx(2.0, rel=0.01)
    within = np.interp(2.0, found.threshold, found.exceeding) / picture.size
    assert within == pytest.approx(0.3173, rel=0.02)


def test_dark_current_follows_from_the_variance_too(measured: tuple[CameraModel, NoiseFit]) -> None:
    camera, fit = measured
    assert fit.dark_current_variance is not None
    assert fit.dark_current_variance_error is not None
    errors = np.abs(fit.dark_current_variance - camera.noise.dark_current) / fit.dark_current_variance_error
    assert errors.max() < 4
    assert (fit.dark_current_variance_error < 0.1 * camera.noise.dark_current).all()
