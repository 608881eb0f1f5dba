"""Correction of lens distortion and of lateral chromatic aberration, which moves pixels (docs/raw-files.md#lens-warps).

The formula is that of the opcode WarpRectilinear (Adobe DNG 1.7, chapter 7). For each pixel of the corrected picture, a warp
states the place in the uncorrected picture from which the pixel comes. Let (y, x) be the distance of the pixel from the
optical centre, in units of the distance of the farthest corner, and r² = y² + x². The distance of the place is then

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
STRIP_PIXELS = 1 << 20  # pixels that are resampled at once, which limits the memory
INVERSE_STEPS = 12  # fixed-point iterations of `corrected_places`; each reduces the error at least by half


@dataclass(frozen=True)
class LensWarp:
    """A warp of the pictures of one lens."""

    terms: tuple[Terms, Terms, Terms]  # of red, green and blue
    centre: tuple[float, float]  # optical centre, down and across, in heights and widths of the active area
    area: tuple[int, int]  # rows and columns of the active area, to whose farthest corner the terms refer
    origin: tuple[int, int] = (0, 0)  # first row and column of the frame within the active area

    @property
    def separates_colours(self) -> bool:
        """Whether red, green and blue move differently."""
        return len(set(self.terms)) > 1

    def source(self, rows: Floats, cols: Floats, colour: int) -> tuple[Floats, Floats]:
        """Return the rows and columns in the uncorrected frame from which pixels of the corrected frame come.

        Rows and columns count from the centre of the first pixel of the frame. `colour` is RED, GREEN or BLUE.
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
    """Return the places in the uncorrected frame, as `LensWarp.source` does, for warps that are applied in succession."""
    for warp in reversed(warps):
        rows, cols = warp.source(rows, cols, colour)
    return rows, cols


def corrected_places(warps: Sequence[LensWarp], rows: Floats, cols: Floats) -> tuple[Floats, Floats]:
    """Return the rows and columns in the corrected frame to which green pixels of the uncorrected frame move."""
    there = rows, cols
    for _ in range(INVERSE_STEPS):
        back = source_places(warps, *there, GREEN)
        there = there[0] + rows - back[0], there[1] + cols - back[1]
    return there


def warped(outputs: NDArray[np.float32], names: Sequence[str], warps: Sequence[LensWarp]) -> NDArray[np.float32]:
    """Apply warps to rendered outputs, by interpolation with cubic splines.

    Parameters
    ----------
    outputs : ndarray, (output, row, col)
        Linear outputs of a table, in the orientation of the sensor.
    names : sequence of str
        Names of the outputs. If they are X, Y, Z, and a warp moves red, green and blue differently, the warps are applied to
        linear sRGB components, and the result is converted back. Otherwise all outputs move as green.
    warps : sequence of LensWarp
        The warps in the order of their application.

    Returns
    -------
    ndarray, (output, row, col)
        Places beyond the border of the frame have the value at the border.
    """
    if not warps:
        return outputs
    if tuple(names) == ("X", "Y", "Z") and any(warp.separates_colours for warp in warps):
        matrix = SRGB.from_xyz
        mixed = np.einsum("po,orc->prc", matrix.astype(np.float32), outputs)
        moved = np.stack([_resampled(mixed[each][None], warps, each)[0] for each in (RED, GREEN, BLUE)])
        return np.einsum("op,prc->orc", np.linalg.inv(matrix).astype(np.float32), moved)
    return _resampled(outputs, warps, GREEN)


def _resampled(planes: NDArray[np.float32], warps: Sequence[LensWarp], colour: int) -> NDArray[np.float32]:
    """Return planes (plane, row, col) at the places from which the pixels of a colour come, interpolated by cubic splines.

    Places outside the planes are replaced by the nearest places at the edge.
    """
    from scipy import ndimage  # imported here to save start-up time, because few files contain a warp

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
