"""A chart behind filters at several exposures: what is proportional comes back, what saturates stays out."""

import dataclasses

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel, Noise
from l3cli.calibration.model import from_data_sheet
from l3cli.calibration.series import fit_series
from l3cli.errors import InputFileError
from l3cli.frames.measurement import CHART_COLS, CHART_ROWS, BandCapture, Body, Capture, Measurements, SensorFigures

WHITE, BLACK = 3800.0, 100.0
RESPONSE = np.array([[0.05, 0.2, 1.0], [0.1, 0.8, 0.1]])  # (band, channel)
REFLECTANCE = np.linspace(0.05, 0.9, 24)
CORNERS = np.array([[0.0, 0.0], [256.0, 0.0], [256.0, 192.0], [0.0, 192.0]])
WAVELENGTH = np.arange(400.0, 601.0)


@pytest.fixture
def body(bayer: CameraModel) -> Body:
    b = bayer
    return Body(b.name, b.rows, b.cols, b.pixel_pitch, b.bits, b.channels, b.cfa, b.optics)


def capture(band: int, exposure: float, body: Body, monitor: float = 1.0) -> BandCapture:
    """Light falls off by a third from left to right; the dark value grows by 40 DN a second."""
    shape = np.exp(-0.5 * ((WAVELENGTH - (450.0, 550.0)[band]) / 5.0) ** 2)
    patch = (np.arange(192)[:, None] * CHART_ROWS // 192) * CHART_COLS + np.arange(256) * CHART_COLS // 256
    light = REFLECTANCE[patch] * (1.0 - (patch % CHART_COLS) / 15.0)
    channel = body.cfa[np.ix_(np.arange(192) % 2, np.arange(256) % 2)]
    signal = 20000.0 * RESPONSE[band][channel] * light * exposure * monitor
    frame = np.rint(np.minimum(BLACK + 40.0 * exposure + signal, WHITE)).astype(np.uint16)
    radiance = REFLECTANCE[:, None] * shape
    name, light_name = f"{band}_{exposure}.tif", f"band {band}"
    return BandCapture(name, exposure, [frame], light_name, CORNERS, WAVELENGTH, radiance, monitor=monitor)


def darks(exposures: list[float]) -> list[Capture]:
    frames = [np.full((192, 256), BLACK + 40.0 * t, dtype=np.uint16) for t in exposures]
    return [Capture(f"dark {t}", t, [frame]) for t, frame in zip(exposures, frames, strict=True)]


def test_responses_come_back_and_exposures_predict_each_other(body: Body) -> None:
    captures = [capture(band, t, body) for t in (0.05, 0.1, 0.5) for band in (1, 0)]
    captures.append(capture(0, 0.2, body, monitor=0.9))
    curves, fit = fit_series(captures, darks([0.5, 0.05]), body, BLACK, WHITE)
    assert fit.lights == ("band 0", "band 1")
    np.testing.assert_allclose(curves.wavelength, [450.0, 550.0], atol=0.1)
    np.testing.assert_allclose(fit.response, RESPONSE, rtol=0.005)
    np.testing.assert_allclose(curves.relative, RESPONSE.T, rtol=0.005)
    assert fit.spread.max() < 0.02  # rounding of small values; the uneven light is taken out
    assert fit.r_squared.min() > 0.9999
    assert fit.relative_rmse.max() < 0.01  # frames are rounded
    assert fit.linearity_error.max() < 0.001
    assert any("0_0.5.tif: patches saturated" in line and "in b" in line for line in fit.left_out)
    assert not any("0_0.05.tif" in line for line in fit.left_out)
    longest = next(i for i, c in enumerate(captures) if c.name == "0_0.5.tif")
    assert not fit.used[longest, 12:, 2].any()
    assert fit.used[longest, :, 0].all()
    figures = SensorFigures(1.0, BLACK, WHITE, Noise(4.0, 0.0, 0.0, 0.0, 4000.0))
    measured = Measurements(body, bands=tuple(captures), darks=tuple(darks([0.5, 0.05])), datasheet=figures)
    stated = dataclasses.replace(measured, lamp_drift=0.01)
    known, more = (from_data_sheet(each, figures).responsivity_band for each in (measured, stated))
    np.testing.assert_allclose(known, curves.band)
    np.testing.assert_allclose(more, np.hypot(curves.band, 0.0196 * curves.relative))  # [uncertainty] widens it


def test_a_capture_has_no_part_in_its_prediction(body: Body) -> None:
    """One lamp 10 % brighter than its monitor says: predicted from the others, the capture stands out by that much."""
    captures = [capture(0, t, body) for t in (0.03, 0.06, 0.1)]
    captures[2] = dataclasses.replace(capture(0, 0.1, body, monitor=1.1), monitor=1.0)
    _, fit = fit_series([*captures, capture(1, 0.05, body), capture(1, 0.1, body)], darks([0.03, 0.1]), body, BLACK, WHITE)
    np.testing.assert_allclose(fit.measured[2, :, 2] / fit.predicted[2, :, 2], 1.1, rtol=0.01)


def test_a_nonlinear_channel_shows(body: Body) -> None:
    bent = []
    for t in (0.03, 0.06, 0.1, 0.15):
        taken = capture(0, t, body)
        frame = next(iter(taken.frames)).astype(float)
        blue = frame[1::2, 1::2] - BLACK
        frame[1::2, 1::2] = BLACK + blue * (1.0 - 3e-5 * blue)
        bent.append(dataclasses.replace(taken, frames=[np.rint(frame).astype(np.uint16)]))
    other = [capture(1, t, body) for t in (0.05, 0.1, 0.2)]
    _, fit = fit_series([*bent, *other], darks([0.03, 0.2]), body, BLACK, WHITE)
    assert fit.relative_rmse[2] > 0.01
    assert fit.linearity_error[2] > 5 * fit.linearity_error[1]


def test_a_band_without_two_usable_exposures_is_named(body: Body) -> None:
    captures = [capture(band, t, body) for band in (0, 1) for t in (0.05, 0.1)]
    with pytest.raises(InputFileError, match="band band 1: a channel has fewer than two exposures"):
        fit_series(captures[:3], [], body, BLACK, WHITE)
    full = [dataclasses.replace(c, frames=[np.full((192, 256), 3800, dtype=np.uint16)]) for c in captures]
    with pytest.raises(InputFileError, match="fewer than two exposures below saturation"):
        fit_series(full, [], body, BLACK, WHITE)
