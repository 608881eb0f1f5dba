"""A small mosaic and what the reference renderer makes of it, beside an exported table."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.classes.windows import Integers
from l3cli.frames.frame import RawFrame
from l3cli.rendering.reference import ReferenceRenderer

SHAPE = (40, 150)  # rows, columns: more than a block, no multiple of any array's period
SEED = 3


@dataclass(frozen=True)
class Vector:
    """A mosaic with its classes in every layer and its outputs."""

    raw: NDArray[np.uint16]  # (row, col) DN at the table's levels
    phase: tuple[int, int]  # CFA row and column of its first pixel
    labels: Integers  # (layer, row, col)
    outputs: NDArray[np.float32]  # (output, row, col)

    def files(self) -> dict[str, bytes]:
        """Little-endian, row by row."""
        return {
            "test_raw.bin": self.raw.astype("<u2").tobytes(),
            "test_labels.bin": self.labels.astype("<u4").tobytes(),
            "test_outputs.bin": self.outputs.astype("<f4").tobytes(),
        }


def drawn_mosaic(table: TransformTable, shape: tuple[int, int], seed: int) -> NDArray[np.uint16]:
    """Return a mosaic (row, col) at the table's levels, dark on the left and saturated on the right, of plain areas and
    texture."""
    rng = np.random.default_rng(seed)
    level = np.geomspace(0.002, 1.5, shape[1]) * (table.white_level - table.black_level)
    blocks = rng.normal(size=(shape[0] // 8 + 1, shape[1] // 8 + 1)).repeat(8, 0).repeat(8, 1)[: shape[0], : shape[1]]
    values = table.black_level + level * (1 + 0.3 * blocks + 0.2 * rng.normal(size=shape) * (blocks > 0))
    return np.clip(np.rint(values), 0, 2**table.bits - 1).astype(np.uint16)


def make_vector(table: TransformTable) -> Vector:
    """Return the test vector of a table: its second site first, so that phases count."""
    phase = (1 % table.cfa.shape[0], 1 % table.cfa.shape[1])
    raw = drawn_mosaic(table, SHAPE, SEED)
    frame = RawFrame("test vector", raw, table.black_level, table.white_level, phase)
    reference = ReferenceRenderer(table)
    labels = np.stack([reference.labels(frame, layer) for layer in range(len(table.layers))])
    return Vector(raw, phase, labels, reference.outputs(frame))
