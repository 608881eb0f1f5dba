"""Horizontal bands of a frame: which rows every layer reads for them, and which row and column each padded one is."""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.classes.structure import REACH
from l3cli.frames.frame import mirrored_indices
from l3cli.rendering.opencl.work import Band, PlaneSource, Source

BAND_PIXELS = 1 << 22  # of a band, margins aside


def bands(table: TransformTable, shape: tuple[int, ...], constant: Callable[[NDArray], Source]) -> Iterator[Band]:
    """The bands of frames of a shape (row, col); `constant` puts indices (int32) on the device."""
    (rows, columns), radius, cfa = shape, table.first.rule.radius, table.cfa
    row_source = mirrored_indices(rows, radius, cfa.shape[0])
    column_source = constant(_int32(mirrored_indices(columns, radius, cfa.shape[1])))
    height = max(1, BAND_PIXELS // columns)

    def columns_beside(margin: int) -> Source:
        return constant(_int32(mirrored_indices(columns, margin, 1)))

    across = {margin: columns_beside(margin) for margin in {REACH, *(layer.radius for layer in table.later)}}

    def beside(seen: slice, margin: int, there: slice) -> Source:
        """Rows of `there` for the rows `seen` and `margin` more."""
        return constant(_int32(mirrored_indices(rows, margin, 1)[seen.start : seen.stop + 2 * margin] - there.start))

    for first in range(0, rows, height):
        reads = [slice(first, min(first + height, rows))]
        margins = [max(REACH, layer.radius) for layer in table.later] + ([table.spectra.radius] if table.spectra else [])
        for margin in reversed(margins):
            reads.insert(0, slice(max(0, reads[0].start - margin), min(rows, reads[0].stop + margin)))
        seen = row_source[reads[0].start : reads[0].stop + 2 * radius]
        raw_rows = slice(int(seen.min()), int(seen.max()) + 1)
        later = tuple(
            PlaneSource(
                (beside(made, REACH, read), beside(made, REACH, reads[0]), across[REACH]),
                (beside(made, layer.radius, read), across[layer.radius]),
            )
            for layer, read, made in zip(table.later, reads, reads[1:], strict=False)
        )
        yield Band(tuple(reads), raw_rows, columns, (constant(_int32(seen - raw_rows.start)), column_source), later)


def _int32(indices: NDArray) -> NDArray[np.int32]:
    return indices.astype(np.int32)
