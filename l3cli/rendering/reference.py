"""The plain truth of rendering in float64: what every other backend is held against (docs/method.md#rendering)."""

import functools
import itertools
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.classes.decide import label_mosaic
from l3cli.classes.later import label_planes
from l3cli.classes.planes import FixedPoint, fixed_point, later_fixed_point, opponent_basis
from l3cli.classes.windows import Integers
from l3cli.frame import RawFrame, pad_mosaic
from l3cli.rendering.display import Display, encode, require_known_layers, require_xyz
from l3cli.rendering.later import first_planes, later_outputs, later_planes


class ReferenceRenderer:
    """Renderer in numpy: slow, exact, without a device."""

    def __init__(self, table: TransformTable) -> None:
        require_known_layers(table)
        self.table = table

    def labels(self, frame: RawFrame, layer: int = 0) -> Integers:
        """Class (row, col) of every pixel in a layer of the table."""
        levelled = at_table_levels(frame, self.table)
        labels = table_labels(levelled, self.table)
        return self._later(levelled, labels, layer)[1] if layer else labels

    def outputs(self, frame: RawFrame) -> NDArray[np.float32]:
        """Outputs of the table, (output, row, col)."""
        return self.exact_outputs(frame).astype(np.float32)

    def picture(self, frame: RawFrame, display: Display) -> NDArray:
        """The frame as sRGB (row, col, 3); RecipeError unless the table's outputs are X, Y, Z."""
        require_xyz(self.table.outputs)
        return encode(self.exact_outputs(frame), display)

    def pictures(self, frames: Iterable[tuple[RawFrame, Display]]) -> Iterator[NDArray]:
        """The picture of each frame, in order."""
        return (self.picture(frame, display) for frame, display in frames)

    def exact_outputs(self, frame: RawFrame) -> NDArray[np.float64]:
        """`outputs` before rounding to float32."""
        levelled = at_table_levels(frame, self.table)
        labels = table_labels(levelled, self.table)
        share = frame.light_share * (1.0 if frame.shading is None else frame.shading.gain_map(frame.values.shape[1]))
        if not self.table.later:
            return share * output_planes(levelled, labels, self.table)
        planes, later_labels = self._later(levelled, labels, len(self.table.later))
        return share * later_outputs(planes, later_labels, self.table.later[-1])

    def planes(self, frame: RawFrame) -> NDArray[np.int32]:
        """What the last layer of a table of several reads of a frame, (plane, row, col)."""
        levelled = at_table_levels(frame, self.table)
        return self._later(levelled, table_labels(levelled, self.table), len(self.table.later))[0]

    @functools.cached_property
    def _fixed_points(self) -> list[FixedPoint]:
        """Of all layers but the last."""
        basis = opponent_basis(self.table.white_point)
        return [fixed_point(self.table), *(later_fixed_point(layer, basis) for layer in self.table.later[:-1])]

    def _later(self, levelled: RawFrame, first_labels: Integers, number: int) -> tuple[NDArray[np.int32], Integers]:
        """What layer `number` after the first reads of a frame at the table's levels, and the classes it sorts it into."""
        table = self.table
        planes = first_planes(levelled, first_labels, table, self._fixed_points[0])
        labels = label_planes(planes, first_labels, table.later[0].rule, table.first.rule)
        for (before, layer), fixed in zip(itertools.pairwise(table.later[:number]), self._fixed_points[1:], strict=False):
            planes = later_planes(planes, labels, before, fixed)
            labels = label_planes(planes, first_labels, layer.rule, table.first.rule)
        return planes, labels


def at_table_levels(frame: RawFrame, table: TransformTable) -> RawFrame:
    """The frame on the black level, white level and depth that the table was trained for, its channels shaded alike."""
    return frame.at_levels(table.black_level, table.white_level, table.bits).evened()


def table_labels(frame: RawFrame, table: TransformTable) -> Integers:
    """Class (row, col) of every pixel of a frame at the table's levels."""
    return label_mosaic(frame.values, table.first.rule, table.cfa, len(table.channels), frame.phase)


def output_planes(frame: RawFrame, labels: Integers, table: TransformTable) -> NDArray[np.float64]:
    """Each pixel's transform applied to its neighbourhood: (output, row, col) from a frame at the table's levels and its
    classes (row, col)."""
    rows, cols = frame.values.shape
    patch, outputs = table.first.rule.patch, len(table.outputs)
    signal = (frame.values - frame.black_level) / (table.white_level - table.black_level)
    padded = pad_mosaic(signal, table.first.rule.radius, (table.cfa.shape[0], table.cfa.shape[1]))
    windows = np.lib.stride_tricks.sliding_window_view(padded, (patch, patch))
    planes = np.empty((outputs, rows, cols))
    for row in range(rows):  # a row at a time: the chosen transforms of a whole frame would fill gigabytes
        patches = windows[row].reshape(cols, patch**2, 1)
        weighted = table.first.weights[labels[row]].astype(np.float64) @ patches
        planes[:, row] = (weighted[..., 0] + table.first.intercept[labels[row]]).T
    return planes
