"""Photographs → the patches that the model is fitted to: black taken off, chart found, light of a white shot taken out
(docs/method.md#charts-in-photographs)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.calibration import noise
from l3cli.calibration.photo.estimate import WAVELENGTH, Shot
from l3cli.charts import locate, patches
from l3cli.charts.patches import PatchValues, corner_cells, homography, through
from l3cli.errors import InputFileError
from l3cli.frames.frame import RawFrame, shifted_cfa
from l3cli.frames.measurement import Body, PhotoCapture
from l3cli.physics import spectra

UNEVEN, UNEVEN_LEFT = 0.2, 0.01  # spread of the illumination over the chart: without a white shot, after one
LEAST_SHARE = 0.5  # of the patches that every channel must have
LEAST_SIGNAL = 20.0  # DN of the brightest patch
Array = NDArray[np.floating]


@dataclass(frozen=True)
class Photograph:
    """A photo's patches."""

    capture: PhotoCapture
    corners: Array  # (4, 2) col, row
    values: PatchValues
    black_level: float  # DN
    white_level: float  # DN
    shot: Shot
    left_out: tuple[str, ...]


def measure(capture: PhotoCapture, body: Body) -> Photograph:
    """Return the patches of a photo; InputFileError if there is no chart, or if too few of its patches can be used."""
    frame = capture.frames[0]
    black = frame.black_level if not capture.darks else float(np.mean([dark.values.mean() for dark in capture.darks]))
    if not black < frame.white_level:
        raise InputFileError(f"{capture.name}: its dark frames are as bright as its white level; give frames without light")
    cfa = shifted_cfa(body.cfa, frame.phase)
    chart = capture.chart
    reflectance = spectra.average(chart.reflectance, chart.wavelength, WAVELENGTH)
    mosaics = [each.values.astype(np.float64) - black for each in capture.frames]
    to_pixels = _geometry(capture, np.mean(mosaics, axis=0), cfa, reflectance)
    saturation = noise.SATURATED * (frame.white_level - black)
    try:
        values = patches.patch_values(mosaics, cfa, to_pixels, chart.grid, saturation)
    except ValueError as error:
        raise InputFileError(f"{capture.name}: {error}; the chart is too small or its corners are wrong") from error
    _check(capture, values, body, reflectance)
    light = _over_white(capture.whites, black, cfa, to_pixels, chart.grid, saturation) if capture.whites else 1.0
    rows, cols = chart.grid
    row, col = np.divmod(np.arange(rows * cols), cols)
    place = np.stack([2 * (col + 0.5) / cols - 1, 2 * (row + 0.5) / rows - 1], axis=1)
    shot = Shot(
        light_of(capture),
        reflectance,
        place,
        values.mean / light,
        values.deviation / light,
        values.used,
        UNEVEN_LEFT if capture.whites else UNEVEN,
    )
    corners = through(to_pixels, corner_cells(rows, cols))
    left_out = [
        f"{capture.name}: patch {patch + 1} in {body.channels[channel]}: {why}" for patch, channel, why in values.left_out
    ]
    return Photograph(capture, corners, values, black, frame.white_level, shot, tuple(left_out))


def light_of(capture: PhotoCapture) -> Array:
    """(wavelength) relative photon radiance of a photo's light, mean 1."""
    light = np.maximum(spectra.resample(capture.radiance, capture.wavelength, WAVELENGTH), 0.0)
    return np.asarray(light / light.mean())


def _geometry(capture: PhotoCapture, mosaic: Array, cfa: NDArray[np.uint8], reflectance: Array) -> Array:
    """Return the homography (3, 3) from the chart's cells to pixels."""
    rows, cols = capture.chart.grid
    if capture.corners is None:
        located = locate.locate(mosaic, cfa, reflectance, capture.chart.grid)
        if located is None:
            raise InputFileError(
                f"{capture.name}: no chart of {rows}×{cols} patches is found in it; give its corners, in a measurement "
                "file, or photograph it sharp, larger and evenly lit"
            )
        return located.to_pixels
    height, width = mosaic.shape
    if (capture.corners < 0).any() or (capture.corners > (width, height)).any():
        raise InputFileError(f"{capture.name}: a corner lies outside the photo of {width}×{height}; give col, row of four")
    try:
        matrix = homography(corner_cells(rows, cols), capture.corners)
        np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        raise InputFileError(f"{capture.name}: the corners lie on a line; give them clockwise from patch 1") from None
    return matrix


def _check(capture: PhotoCapture, values: PatchValues, body: Body, reflectance: Array) -> None:
    """Raise InputFileError if too few patches can be used, or if they are not the chart's."""
    count = len(values.mean)
    for channel, name in enumerate(body.channels):
        used = values.used[:, channel]
        if used.sum() < LEAST_SHARE * count:
            reasons = [why for _, each, why in values.left_out if each == channel]
            most = max(set(reasons), key=reasons.count)
            cure = "shorten the exposure" if most == "clipped" else "check chart and corners"
            raise InputFileError(
                f"{capture.name}: only {used.sum()} of {count} patches are usable in channel {name}, most others are {most}"
                f"; {cure}"
            )
        if values.mean[used, channel].max() < LEAST_SIGNAL:
            raise InputFileError(
                f"{capture.name}: channel {name} sees nothing of the chart; expose longer, or check black level"
            )
    if capture.corners is not None and locate.fit(values.mean, locate.components(reflectance)) < locate.LEAST_FIT / 2:
        raise InputFileError(
            f"{capture.name}: the patches at the given corners are not those of the chart; give col, row of the outer "
            "corners of patches 1, 6, 24 and 19 in this order"
        )


def _over_white(
    whites: Sequence[RawFrame],
    black: float,
    cfa: NDArray[np.uint8],
    to_pixels: Array,
    grid: tuple[int, int],
    saturation: float,
) -> Array:
    """Return the light (patch, channel) at each patch over its mean, from an even white in the chart's place."""
    mosaics = [white.values.astype(np.float64) - black for white in whites]
    values = patches.patch_values(mosaics, cfa, to_pixels, grid, saturation)
    if not values.used.all() or values.mean.min() <= 0:
        raise InputFileError(
            f"{whites[0].name}: the white shot is clipped, dark or not plain where the chart lies; take it again"
        )
    return np.asarray(values.mean / values.mean.mean(axis=0))
