"""Correct row and column offsets with optically black (masked) pixels (docs/method.md#masked-pixels).

1. The fixed offset of each masked column is subtracted: the median over the rows with the same CFA phase, after the median
   of each row has been subtracted.
2. Values that deviate from their row's median by more than `OUTLIER` standard deviations, such as hot pixels, are left out.
3. A row's offset is estimated as the mean of its remaining values, minus the mean over all rows. The estimate is multiplied
   by its reliability, so that the row noise after the correction is as small as possible.
4. The offset is subtracted from all pixels in the row. Because pixel values are whole DN, a fractional offset is rounded up
   in some pixels and down in others, so that the mean over the row is correct.

Columns are corrected in the same way, with masked rows above and below the frame.
"""

import functools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import QUANTISATION, CameraModel
from l3cli.frames.frame import RawFrame
from l3cli.frames.shading import CLIPPED

OUTLIER = 4.0  # standard deviations; masked pixels that deviate by more are left out
GOLDEN = (np.sqrt(5) - 1) / 2  # the multiples of this number, modulo 1, are evenly distributed
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class MaskedValues:
    """Values of the masked pixels to the left and right of a frame, and above and below it."""

    of_rows: NDArray[np.number]  # (row, masked pixel) DN; may have no masked pixels
    of_columns: NDArray[np.number]  # (masked pixel, col) DN; may have no masked pixels

    @property
    def present(self) -> bool:
        """Whether there are any masked pixels."""
        return bool(self.of_rows.size or self.of_columns.size)


def split_masked(values: NDArray, camera: CameraModel) -> tuple[NDArray, MaskedValues] | None:
    """Split a frame into its light-sensitive pixels and its masked pixels.

    Returns
    -------
    tuple or None
        Light-sensitive pixels, (row, col), and masked pixels. None if the camera has no masked pixels, or if the frame does
        not have the size of the sensor including its masked pixels.
    """
    masked, rows, cols = camera.masked, camera.rows, camera.cols
    if masked is None or values.shape != masked.around(rows, cols):
        return None
    lit_rows, lit_cols = slice(masked.top, masked.top + rows), slice(masked.left, masked.left + cols)
    beside, above = values[lit_rows], values[:, lit_cols]
    of_rows = np.concatenate([beside[:, : masked.left], beside[:, masked.left + cols :]], axis=1)
    of_columns = np.concatenate([above[: masked.top], above[masked.top + rows :]])
    return values[lit_rows, lit_cols], MaskedValues(of_rows, of_columns)


def without_line_offsets(frame: RawFrame, masked: MaskedValues, camera: CameraModel) -> RawFrame:
    """Subtract the row and column offsets that are measured in the masked pixels. Clipped pixels are unchanged.

    Rows are corrected only if the camera has row noise, and columns only if it has column noise. The variances of this
    noise, at the frame's gain, determine the reliability of the estimated offsets.

    Parameters
    ----------
    frame : RawFrame
        Frame with its gain and its dark signal.
    masked : MaskedValues
        The frame's masked pixels, in DN on the scale of the frame.
    camera : CameraModel
        Camera of the frame.
    """
    there = camera.at_gain(frame.gain)
    span = frame.white_level - frame.black_level
    unit = there.gain * span / (there.white_level - there.black_level)  # DN per electron in this frame
    noise = there.noise
    pixel = unit**2 * (noise.read_noise**2 + noise.dsnu**2) + unit * frame.dark + QUANTISATION
    variances = noise.row_temporal_noise**2 + noise.row_noise**2, noise.column_temporal_noise**2 + noise.column_noise**2
    by_row, by_column = (
        line_offsets(values, period, unit**2 * variance, pixel)
        for values, period, variance in zip((masked.of_rows, masked.of_columns.T), camera.cfa.shape, variances, strict=True)
    )
    if not (by_row.any() or by_column.any()):
        return frame
    return without_offsets(frame, by_row[:, None] + by_column)


def without_offsets(frame: RawFrame, offset: Floats) -> RawFrame:
    """Subtract an offset in DN from each pixel. Clipped pixels are unchanged.

    A fractional offset is rounded up in some pixels and down in others. `offset` has the shape of the frame.
    """
    whole = np.floor(offset + _thresholds(*frame.values.shape))
    clipped = frame.values >= frame.black_level + CLIPPED * (frame.white_level - frame.black_level)
    values = np.clip(frame.values - whole, 0, np.iinfo(np.uint16).max).astype(np.uint16)
    return replace(frame, values=np.where(clipped, frame.values, values))


def line_offsets(values: NDArray[np.number], period: int, variance: float, pixel: float) -> Floats:
    """Estimate the offset of each line, in DN, from its masked pixels.

    Parameters
    ----------
    values : ndarray, (line, masked pixel)
        Masked pixels of each line.
    period : int
        Number of lines in a CFA period. Lines at different positions may have different fixed offsets.
    variance : float
        Variance of the line offsets in DN². If it is 0, the offsets are 0.
    pixel : float
        Noise variance of a masked pixel in DN², excluding its line's offset.

    Returns
    -------
    ndarray, (line,)
        Estimated offsets, multiplied by their reliability. All 0 if there are no masked pixels.
    """
    if not (variance and values.shape[1]):
        return np.zeros(len(values))
    deviation = values - np.median(values, axis=1, keepdims=True)
    fixed = np.zeros(values.shape)
    for phase in range(min(period, len(values))):
        fixed[phase::period] = np.median(deviation[phase::period], axis=0)
    levelled = values - fixed
    middle = np.median(levelled, axis=1, keepdims=True) if values.shape[1] > 2 else np.median(levelled)
    usual = np.abs(levelled - middle) <= OUTLIER * np.sqrt(pixel if values.shape[1] > 2 else pixel + variance)
    count = usual.sum(axis=1)
    mean = (levelled * usual).sum(axis=1) / np.maximum(count, 1)
    centre = mean[count > 0].mean() if count.any() else 0.0
    return np.asarray(np.where(count, variance * count / (variance * count + pixel) * (mean - centre), 0.0))


@functools.lru_cache(maxsize=2)
def _thresholds(rows: int, cols: int) -> Floats:
    """Return numbers from 0 to 1 that are evenly distributed in every row and every column: (row, col)."""
    steps = np.arange(cols) * GOLDEN + np.arange(rows)[:, None] * GOLDEN**2
    return np.asarray(steps % 1.0)
