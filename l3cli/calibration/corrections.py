"""Defect map and flat field of a camera, from its dark and white frames (docs/method.md#corrections)."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel, FlatField
from l3cli.artifacts.fit import Fit
from l3cli.calibration import defects as defective
from l3cli.calibration import noise
from l3cli.calibration.captures import Sensor
from l3cli.calibration.statistics import by_site, mean_frame
from l3cli.errors import InputFileError
from l3cli.frames.measurement import Body, Capture, Measurements

DEGREE = 4  # of the surface: the fourth power of the distance from the middle
CELLS = (36, 54)  # rows and columns of means that it is fitted to, at most
GRID = (33, 49)  # rows and columns of the grid: between its lines cos⁴ of a wide lens is linear within 0.1 %
UNEVEN = 0.05  # RMS of the means about the surface, relative: no lens is as rough
LEAST_SIGNAL = 0.02  # of full scale: a white that is darker says little of a pixel's response
MOST_DEFECTIVE = 0.05  # share of the pixels: of more no frame can be corrected
Array = NDArray[np.float64]


def flat_field(response: Array, body: Body) -> FlatField:
    """Return the gains that even out the response (row, col) to an even white, its defects patched.

    Fitted is the square root of the gain, of which cos⁴ is a polynomial of second degree. InputFileError if the white is
    no smooth surface, or falls off as no lens does.
    """
    gains = []
    for channel, name in enumerate(body.channels):
        y, x, mean = _means(response, body, channel)
        if mean.min() <= 0:
            raise InputFileError(f"channel {name}: parts of the white frames are dark; give frames of an even white")
        terms = np.linalg.lstsq(_surface(y, x), mean**-0.5, rcond=None)[0]
        rough = float(np.sqrt(np.mean((mean * (_surface(y, x) @ terms) ** 2 - 1.0) ** 2)))
        if rough > UNEVEN:
            raise InputFileError(
                f"channel {name}: the white frames differ by {rough:.0%} RMS from a smooth surface; give an even white"
            )
        lines = np.meshgrid(np.linspace(-1, 1, GRID[0]), np.linspace(-1, 1, GRID[1]), indexing="ij")
        root = (_surface(*map(np.ravel, lines)) @ terms).reshape(GRID)
        gains.append((root / terms[0]) ** 2)
    try:
        return FlatField(np.linspace(0, body.rows - 1, GRID[0]), np.linspace(0, body.cols - 1, GRID[1]), np.array(gains))
    except ValueError as error:
        raise InputFileError(f"the white frames make no flat field: {error}") from error


def corner_falloff(field: FlatField) -> Array:
    """Return the share (channel) of the light that is lost in the corner that loses most."""
    corners = field.shading_gain[:, [0, 0, -1, -1], [0, -1, 0, -1]]
    return np.asarray(1.0 - 1.0 / corners.max(axis=1))


def _surface(y: Array, x: Array) -> Array:
    """Return the terms (place, term) of the polynomial at y, x from −1 to 1, the first term being 1."""
    powers = [(down, across) for down in range(DEGREE + 1) for across in range(DEGREE + 1 - down)]
    return np.stack([y**down * x**across for down, across in powers], axis=1)


def _means(response: Array, body: Body, channel: int) -> tuple[Array, Array, Array]:
    """Return the place from −1 to 1, and value, of means over cells of all pixels of a channel."""
    places: list[tuple[Array, Array, Array]] = []
    y, x = (np.linspace(-1.0, 1.0, length) for length in response.shape)
    down = np.broadcast_to(y[:, None], response.shape)
    across = np.broadcast_to(x, response.shape)
    for parts in zip(*(by_site(each, body.cfa) for each in (response, down, across)), strict=True):
        if parts[0][0] == channel:
            value, row, col = (_by_cell(site) for _, site in parts)
            places.append((row, col, value))
    row, col, value = (np.concatenate(each) for each in zip(*places, strict=True))
    return row, col, value


def _by_cell(site: Array) -> Array:
    """Return the means of a picture over at most CELLS equal parts."""
    starts = [
        np.linspace(0, length, min(length, most) + 1).astype(int) for length, most in zip(site.shape, CELLS, strict=True)
    ]
    sums = np.add.reduceat(np.add.reduceat(site, starts[0][:-1], axis=0), starts[1][:-1], axis=1)
    return (sums / np.outer(*map(np.diff, starts))).ravel()


def with_corrections(camera: CameraModel, sensor: Sensor, body: Body) -> CameraModel:
    """Return the camera with the defects of its dark and white frames, and with a flat field if the whites are even: for
    noise they need not be."""
    shape = (body.rows, body.cols)
    defects = defective.as_map(sensor.defects, sensor.dark.hot, shape)
    try:
        return replace(camera, defects=defects, flat_field=flat_field(sensor.response, body))
    except InputFileError:
        return replace(camera, defects=defects)


def correct_by_frames(camera: CameraModel, measurements: Measurements) -> CameraModel:
    """Return the camera with the defects and the flat field of dark and white frames, of one exposure or several; all else
    stays.

    InputFileError if the whites are too dark, clipped or uneven, or if too many pixels are defective.
    """
    body, darks = measurements.body, measurements.darks
    means = [mean_frame(capture).astype(np.float64) for capture in darks]
    hot = defective.join(defective.none(), *(defective.outliers(mean, body.cfa) for mean in means))
    response = np.zeros((body.rows, body.cols))
    for capture in measurements.whites:
        both = mean_frame(capture).astype(np.float64), means[_nearest(darks, capture.exposure)]
        mean, dark = (defective.patched(each, body.cfa, hot) for each in both)
        _check_level(mean, camera, capture.name)
        response += mean - dark
    dead, response = noise.dead_pixels(response, body.cfa)
    every = defective.join(hot, dead)
    if len(every) > MOST_DEFECTIVE * response.size:
        raise InputFileError(
            f"{len(every) / response.size:.0%} of the pixels would be defective; are the dark frames without light, "
            "the white ones of an even white?"
        )
    found = defective.as_map(every, hot, (body.rows, body.cols))
    return replace(camera, defects=found, flat_field=flat_field(response, body), fit=camera.fit or Fit())


def _nearest(darks: Sequence[Capture], exposure: float) -> int:
    """Return the dark capture whose exposure time is nearest, by ratio."""
    return int(np.argmin([abs(np.log(dark.exposure / exposure)) for dark in darks]))


def _check_level(mean: NDArray[np.floating], camera: CameraModel, name: str) -> None:
    span = camera.white_level - camera.black_level
    for channel, label in enumerate(camera.channels):
        rows, cols = camera.cfa.shape
        sites = np.argwhere(camera.cfa == channel)
        values = np.concatenate([mean[row::rows, col::cols].ravel() for row, col in sites])
        if np.quantile(values, 0.999) >= camera.black_level + noise.SATURATED * span:
            raise InputFileError(f"{name}: channel {label} is clipped; expose the white frames shorter")
        if np.median(values) < camera.black_level + LEAST_SIGNAL * span:
            raise InputFileError(f"{name}: channel {label} is dark; expose the white frames longer")
