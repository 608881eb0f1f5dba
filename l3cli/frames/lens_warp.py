"""Correct lens distortion and lateral chromatic aberration (docs/raw-files.md#lens-warps).

A warp maps each pixel of the corrected picture to a position in the uncorrected picture, as defined by the opcode
WarpRectilinear (Adobe DNG 1.7, chapter 7). Positions are relative to the optical centre, in units of the distance to the
farthest corner. Let (y, x) be the position of a pixel in the corrected picture, and r² = y² + x². Its position in the
uncorrected picture is then

    y' = f·y + t0·(r² + 2y²) + 2·t1·x·y
    x' = f·x + t1·(r² + 2x²) + 2·t0·x·y        f = k0 + k1·r² + k2·r⁴ + k3·r⁶
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.physics.spaces import SRGB

Floats = NDArray[np.float64]
Terms = tuple[float, float, float, float, float, float]  # k0, k1, k2, k3, t0, t1
UNCHANGED: Terms = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
RED, GREEN, BLUE = range(3)
STRIP_PIXELS = 1 << 20  # number of pixels resampled at a time, to limit memory use
INVERSE_STEPS = 12  # number of fixed-point iterations in `corrected_places`; each iteration at least halves the error


@dataclass(frozen=True)
class LensWarp:
    """The warp that corrects one lens.

    Lengths are in units of the distance from the optical centre to the farthest corner of the sensor's active area, which
    may be larger than the frame.
    """

    terms: tuple[Terms, Terms, Terms]  # coefficients for red, green and blue
    # row and column of the optical centre in the active area, as fractions of its height and width
    centre: tuple[float, float]
    area: tuple[int, int]  # rows and columns of the active area
    origin: tuple[int, int] = (0, 0)  # row and column of the frame's first pixel in the active area

    @property
    def separates_colours(self) -> bool:
        """Whether the warp differs between red, green and blue."""
        return len(set(self.terms)) > 1

    def source(self, rows: Floats, cols: Floats, colour: int) -> tuple[Floats, Floats]:
        """Map positions in the corrected frame to rows and columns in the uncorrected frame.

        Positions are measured in pixels from the centre of the frame's first pixel. `colour` is RED, GREEN or BLUE.
        """
        k0, k1, k2, k3, t0, t1 = self.terms[colour]
        down, across = (
            middle * length - 0.5 - first for middle, length, first in zip(self.centre, self.area, self.origin, strict=True)
        )
        unit = math.hypot(*(max(at, 1 - at) * length for at, length in zip(self.centre, self.area, strict=True)))
        y, x = (rows - down) / unit, (cols - across) / unit
        squared = y**2 + x**2
        within = np.minimum(squared, 1.0)
        factor = k0 + within * (k1 + within * (k2 + within * k3))
        mixed = 2 * x * y
        return (
            down + unit * (factor * y + t0 * (squared + 2 * y**2) + t1 * mixed),
            across + unit * (factor * x + t1 * (squared + 2 * x**2) + t0 * mixed),
        )


def source_places(warps: Sequence[LensWarp], rows: Floats, cols: Floats, colour: int) -> tuple[Floats, Floats]:
    """Map positions like `LensWarp.source`, for several warps that are applied in succession."""
    for warp in reversed(warps):
        rows, cols = warp.source(rows, cols, colour)
    return rows, cols


def corrected_places(warps: Sequence[LensWarp], rows: Floats, cols: Floats) -> tuple[Floats, Floats]:
    """Map positions in the uncorrected frame to the corrected frame. This is the inverse of `source_places` for green."""
    there = rows, cols
    for _ in range(INVERSE_STEPS):
        back = source_places(warps, *there, GREEN)
        there = there[0] + rows - back[0], there[1] + cols - back[1]
    return there


def warped(outputs: NDArray[np.float32], names: Sequence[str], warps: Sequence[LensWarp]) -> NDArray[np.float32]:
    """Apply warps to rendered outputs. Values between pixels are interpolated with cubic splines.

    Parameters
    ----------
    outputs : ndarray, (output, row, col)
        Linear outputs of a table, in sensor orientation.
    names : sequence of str
        Names of the outputs. If the first outputs are X, Y and Z and a warp differs between red, green and blue, these
        outputs are warped in linear sRGB. The warp for green is applied to all other outputs.
    warps : sequence of LensWarp
        Warps in order of application. Without warps, `outputs` is returned unchanged.

    Returns
    -------
    ndarray, (output, row, col)
        Corrected outputs. Positions outside the uncorrected frame have the value at the nearest edge.
    """
    if not warps:
        return outputs
    if tuple(names[:3]) == ("X", "Y", "Z") and any(warp.separates_colours for warp in warps):
        matrix = SRGB.from_xyz
        mixed = np.einsum("po,orc->prc", matrix.astype(np.float32), outputs[:3])
        moved = np.stack([_resampled(mixed[each][None], warps, each)[0] for each in (RED, GREEN, BLUE)])
        xyz = np.einsum("op,prc->orc", np.linalg.inv(matrix).astype(np.float32), moved)
        return np.concatenate([xyz, _resampled(outputs[3:], warps, GREEN)])
    return _resampled(outputs, warps, GREEN)


def _resampled(planes: NDArray[np.float32], warps: Sequence[LensWarp], colour: int) -> NDArray[np.float32]:
    """Apply the warps for one colour to all `planes`, (plane, row, col), as described in `warped`."""
    from scipy import ndimage  # slow import that few files need

    moved = np.empty_like(planes)
    splines = [ndimage.spline_filter(plane, 3, mode="mirror") for plane in planes]
    rows, cols = planes.shape[1:]
    for first in range(0, rows, step := max(STRIP_PIXELS // cols, 1)):
        strip = np.arange(first, min(first + step, rows))
        places = source_places(warps, strip[:, None].astype(float), np.arange(cols, dtype=float), colour)
        within = np.stack([np.clip(place, 0, length - 1) for place, length in zip(places, (rows, cols), strict=True)])
        for spline, result in zip(splines, moved, strict=True):
            ndimage.map_coordinates(spline, within, result[strip[0] : strip[-1] + 1], 3, mode="mirror", prefilter=False)
    return moved
