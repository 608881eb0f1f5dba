"""The flat field: what light the lens loses towards the corners, channel by channel, from an even white
(docs/method.md#corrections)."""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import FlatField
from l3cli.calibration.statistics import by_site
from l3cli.errors import InputFileError
from l3cli.frames.measurement import Body

DEGREE = 4  # of the surface: the fourth power of the distance from the middle
CELLS = (36, 54)  # rows and columns of means that it is fitted to, at most
GRID = (33, 49)  # rows and columns of the grid: between its lines cos⁴ of a wide lens is linear within 0.1 %
UNEVEN = 0.05  # RMS of the means about the surface, relative: no lens is as rough
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
