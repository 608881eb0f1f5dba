"""Correct lens shading, the loss of light towards the corners of a frame (docs/method.md#corrections).

The mean loss of all channels is corrected by a gain on the rendered outputs. Transforms are linear, so this has the same
effect as a gain on the raw values. The classes, however, are determined from uncorrected raw values, to which the noise
model applies. Only colour shading, the difference between a channel's loss and the mean loss, is corrected in the raw
values. This changes their noise only slightly.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:  # not imported at run time, which saves 80 ms when the decoding process starts
    from l3cli.artifacts.camera import FlatField

CLIPPED = 0.985  # pixels at or above this fraction of full scale count as clipped, and are not corrected
NODE_SPACING_COLUMNS = 16  # distance, in columns, between the nodes at which the output gain is stored
FRACTION = 15  # number of fractional bits in the colour shading
MIN_COLOUR_SHADING = 8  # in units of 2^-FRACTION, or about 0.02 %; smaller colour shading is not corrected


@dataclass(frozen=True, eq=False)
class Shading:
    """The correction of lens shading for a sensor's frames."""

    gain: NDArray[np.float32]  # (row, node) output gain at every node; interpolated linearly between the nodes
    # (row, col) gain of the raw values minus 1, in units of 2^-FRACTION; None if colour shading is not corrected
    colour: NDArray[np.int16] | None

    def gain_map(self, cols: int) -> NDArray[np.float64]:
        """Return the output gain of each pixel, (row, col), in a frame with `cols` columns."""
        return self.gain_at(np.arange(len(self.gain)), np.arange(cols))

    def gain_at(self, rows: NDArray[np.integer], cols: NDArray[np.integer]) -> NDArray[np.float64]:
        """Return the output gains at all combinations of these rows and columns: (row, col)."""
        node, part = cols // NODE_SPACING_COLUMNS, (cols % NODE_SPACING_COLUMNS) / NODE_SPACING_COLUMNS
        gain = self.gain[rows].astype(np.float64)
        return np.asarray(gain[:, node] + (gain[:, node + 1] - gain[:, node]) * part)

    def of_patches(
        self, taken: tuple[NDArray[np.integer], ...], rows: NDArray[np.integer], cols: NDArray[np.integer]
    ) -> "Shading":
        """Return the shading correction for a list of patches of the frame.

        Parameters
        ----------
        taken : tuple of ndarray
            Index arrays that select the pixels of all patches.
        rows, cols : ndarray
            Rows and columns of the patch centres. Each combination of a row and a column is a centre.

        Returns
        -------
        Shading
            Correction with the gain at each patch centre, (patch, 1), and the colour shading of each pixel (tap) in each
            patch, (patch, tap).
        """
        colour = None if self.colour is None else self.colour[taken].reshape(rows.size * cols.size, -1)
        return Shading(self.gain_at(rows, cols).reshape(-1, 1).astype(np.float32), colour)


def shading_of(field: "FlatField", shape: tuple[int, int], cfa: NDArray[np.uint8]) -> Shading:
    """Return the shading correction for a flat field.

    Parameters
    ----------
    field : FlatField
        Gains of each channel on a grid of points.
    shape : tuple of int
        Number of rows and columns in the frames, which start at CFA site (0, 0).
    cfa : ndarray, (cfa_row, cfa_col)
        Channel of each site.
    """
    rows, cols = shape
    mean = field.shading_gain.mean(axis=0)
    down = interpolation(field.grid_row, np.arange(rows))
    nodes = down @ mean @ interpolation(field.grid_col, np.arange(0, cols + NODE_SPACING_COLUMNS, NODE_SPACING_COLUMNS)).T
    colour = np.zeros(shape, np.int16)
    across = interpolation(field.grid_col, np.arange(cols))
    for row, col in np.ndindex(cfa.shape):
        own = field.shading_gain[cfa[row, col]] / mean - 1.0
        colour[row :: cfa.shape[0], col :: cfa.shape[1]] = np.rint(
            (down[row :: cfa.shape[0]] @ own @ across[col :: cfa.shape[1]].T) * 2**FRACTION
        )
    return Shading(nodes.astype(np.float32), colour if np.abs(colour).max() >= MIN_COLOUR_SHADING else None)


def shading_of_gain(gain: NDArray[np.floating], period: tuple[int, ...]) -> Shading:
    """Return the shading correction that multiplies each pixel by a gain.

    The output gain of a pixel is the mean gain in the surrounding CFA period. The ratio of the pixel's gain to this output
    gain is corrected as colour shading.

    Parameters
    ----------
    gain : ndarray, (row, col)
        Gain of each pixel.
    period : tuple of int
        Number of rows and columns in the CFA.
    """
    (rows, cols), (down, across) = gain.shape, period
    first = np.clip(np.arange(0, cols + NODE_SPACING_COLUMNS, NODE_SPACING_COLUMNS) - across // 2, 0, max(cols - across, 0))
    columns = np.minimum(first[:, None] + np.arange(across), cols - 1)
    means = gain[:, columns].mean(axis=2, dtype=np.float64)  # (row, node) mean over one period of columns
    first = np.clip(np.arange(rows) - down // 2, 0, max(rows - down, 0))
    nodes = np.mean([means[np.minimum(first + row, rows - 1)] for row in range(down)], axis=0).astype(np.float32)
    colour = gain / Shading(nodes, None).gain_map(cols) - 1.0
    limit = 2**FRACTION - 1
    whole = np.clip(np.rint(colour * 2**FRACTION), -limit, limit).astype(np.int16)
    return Shading(nodes, whole if np.abs(whole).max() >= MIN_COLOUR_SHADING else None)


def interpolation(lines: NDArray[np.floating], places: NDArray[Any]) -> NDArray[Any]:
    """Return the weights, (place, line), for linear interpolation between grid lines at increasing positions `lines`.

    There must be at least two lines. Beyond them, values are extrapolated linearly.
    """
    above = np.clip(np.searchsorted(lines, places, side="right"), 1, lines.size - 1)
    part = (places - lines[above - 1]) / (lines[above] - lines[above - 1])
    weights = np.zeros((places.size, lines.size))
    weights[np.arange(places.size), above - 1] = 1.0 - part
    weights[np.arange(places.size), above] = part
    return weights


def clipped_from(black_level: float, white_level: float) -> int:
    """Return the lowest DN at which a pixel counts as clipped."""
    return int(np.ceil(black_level + CLIPPED * (white_level - black_level)))


def colour_corrected(
    values: NDArray[np.uint16], colour: NDArray[np.int16], black_level: float, white_level: float
) -> NDArray[np.uint16]:
    """Multiply raw signals above black by 1 + `colour` · 2^-FRACTION.

    `values` and `colour` have the same shape. Clipped pixels are unchanged, and no other pixel becomes clipped. The results
    are identical to the results of opencl/common/shading.cl.
    """
    black, clipped = round(black_level), clipped_from(black_level, white_level)
    wide = values.astype(np.int32)
    gained = wide + (((wide - black) * colour.astype(np.int32) + (1 << FRACTION >> 1)) >> FRACTION)
    return np.where(values < clipped, np.clip(gained, 0, clipped - 1), wide).astype(np.uint16)
