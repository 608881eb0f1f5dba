"""Greys and plain surfaces as a table shows them: from given signals of the channels, or from a square of a frame.

A table shows a grey under another light than it was trained under in a colour that is not quite that light's, since
cameras do not see as eyes do. A picture in which that grey is to be neutral is adapted from what the table makes of it
(docs/method.md#scene-white).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.classes.tree import REACH
from l3cli.errors import InputFileError
from l3cli.frames.frame import RawFrame, shifted_cfa, tiled
from l3cli.rendering.reference import ReferenceRenderer

Array = NDArray[np.floating]
MOST_CLIPPED = 0.01  # share of a square's pixels that may be clipped
FLAT = 0.5  # share of the pixels of two channels that have the frame's highest value, all of them, where the sensor clips
DARK = 0.01  # of full scale: a mean below which noise may hide it, above which its spread is that of what is seen
LEAST_CERTAINTY = 50.0  # mean signal of a channel in a square over the standard deviation of that mean


@dataclass(frozen=True)
class Grey:
    """A part of a frame that shows something grey."""

    name: str  # for messages
    where: tuple[slice, slice]  # rows and columns on the sensor


@dataclass(frozen=True)
class Square:
    """A square of the upright picture."""

    row: int  # of its centre
    col: int  # of its centre
    size: int  # pixels

    def within(self, frame: RawFrame) -> Grey:
        """Return the grey at this place of a frame; InputFileError if it is not inside the sensor."""
        rows, cols = frame.values.shape
        turned = bool(frame.orientation & 4)
        height, width = (cols, rows) if turned else (rows, cols)
        top, left = self.row - self.size // 2, self.col - self.size // 2
        if min(top, left) < 0 or top + self.size > height or left + self.size > width:
            raise InputFileError(
                f"{frame.name}: a square of {self.size} pixels about row {self.row}, column {self.col} is not inside its "
                f"{height}×{width} pixels; give a grey in the picture"
            )
        top, left = (left, top) if turned else (top, left)
        top = rows - top - self.size if frame.orientation & 2 else top
        left = cols - left - self.size if frame.orientation & 1 else left
        where = slice(top, top + self.size), slice(left, left + self.size)
        return Grey(f"{frame.name}: the grey at {self.row},{self.col}", where)


class GreyRenderer:
    """Renderer of plain areas on the processor, in float64, so that all devices agree about white."""

    def __init__(self, table: TransformTable) -> None:
        self.table = table
        self._renderer = ReferenceRenderer(table)
        self._reach = table.first.rule.radius + sum(max(REACH, layer.radius) for layer in table.later)

    def outputs_of(self, shares: Array) -> NDArray[np.float64]:
        """Return outputs (area, output) of plain areas with signals `shares` (area, channel) of full scale."""
        table, (rows, cols) = self.table, self.table.cfa.shape
        down, across = (1 + 2 * -(-self._reach // period) for period in (rows, cols))  # periods of an area
        tile = np.tile(table.cfa, (down, across))
        values = table.black_level + np.hstack([share[tile] for share in shares]) * (table.white_level - table.black_level)
        plain = RawFrame("plain areas", np.rint(values).astype(np.uint16), table.black_level, table.white_level)
        middle = self._renderer.exact_outputs(plain)[:, down // 2 * rows :][:, :rows]
        areas = middle.reshape(len(table.outputs), rows, len(shares), across, cols)[:, :, :, across // 2]
        return np.asarray(areas.mean(axis=(1, 3)).T, np.float64)

    def signals(self, frame: RawFrame, grey: Grey) -> NDArray[np.float64]:
        """Return mean signal (channel), in DN above black and dark current, of a grey in a frame; InputFileError if it is
        clipped, too dark or not plain, or holds too little of a channel."""
        means, why = _measured(frame, self.table, grey.where)
        if why:
            raise InputFileError(f"{grey.name} {why}")
        return means

    def usable(self, frame: RawFrame, grey: Grey) -> bool:
        """Return whether the signals of a grey can be taken."""
        return not _measured(frame, self.table, grey.where)[1]

    def of_part(self, frame: RawFrame, where: tuple[slice, slice]) -> NDArray[np.float64]:
        """Return mean outputs of rows and columns of a frame as the sensor lies."""
        rows, cols = where
        margin = self._reach + max(self.table.cfa.shape)
        top, left = max(rows.start - margin, 0), max(cols.start - margin, 0)
        cut = _shading_corrected(frame, (slice(top, rows.stop + margin), slice(left, cols.stop + margin)))
        phase = ((frame.phase[0] + top) % self.table.cfa.shape[0], (frame.phase[1] + left) % self.table.cfa.shape[1])
        planes = self._renderer.exact_outputs(replace(cut, phase=phase))
        inside = planes[:, rows.start - top : rows.stop - top, cols.start - left : cols.stop - left]
        return np.asarray(inside.mean(axis=(1, 2)))


def _shading_corrected(frame: RawFrame, where: tuple[slice, slice]) -> RawFrame:
    """Return a part of a frame, its phase still that of the whole, without what channels differ by in their shading; what
    all of them lose is about the same there, and stays."""
    shading = frame.shading
    cut = None if shading is None else replace(shading, colour=None if shading.colour is None else shading.colour[where])
    return replace(replace(frame, values=frame.values[where], shading=cut).shading_corrected(), shading=None)


def _measured(frame: RawFrame, table: TransformTable, where: tuple[slice, slice]) -> tuple[NDArray[np.float64], str]:
    """Return mean signal (channel) in DN above black and dark current of a part of a frame, and why it is no grey, or ""."""
    values, means = _shading_corrected(frame, where).values, np.zeros(len(table.channels))
    clipped = float((values >= frame.white_level).mean())
    if clipped > MOST_CLIPPED:
        return means, f"is clipped in {clipped:.0%} of its pixels; give a darker grey"
    cfa = shifted_cfa(table.cfa, (frame.phase[0] + where[0].start, frame.phase[1] + where[1].start))
    channel = tiled(cfa, values.shape)
    top, reached = int(frame.values.max()), 0  # of how many channels the part has the frame's highest value
    for index, letter in enumerate(table.channels):
        seen = values[channel == index] - (frame.black_level + frame.dark)
        if seen.size < 2:
            return means, f"has too few pixels of channel {letter}; give a larger size"
        means[index] = seen.mean()
        if not means[index] > LEAST_CERTAINTY * seen.std() / np.sqrt(seen.size):
            if means[index] > DARK * (frame.white_level - frame.black_level):
                varies = seen.std() / means[index]
                return means, f"is not plain: channel {letter} varies by {varies:.0%}; give something of one colour"
            return means, f"is too dark: channel {letter} has {means[index]:.3g} DN; give a brighter grey"
        reached += bool((values[channel == index] == top).mean() > FLAT)
    if reached > 1:
        return means, f"is clipped at {top} DN, below the white level of {frame.white_level:g}; correct ‹white_level›"
    return means, ""
