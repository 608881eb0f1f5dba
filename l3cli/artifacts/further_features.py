"""Further features of a class rule as they are stored: windows, sizes and constants of each (docs/method.md#classes)."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.schema import data

MAX_FURTHER = 4096  # values of all further features together
MAX_WINDOW_TAPS = 4096  # of all their windows: sums of 12-bit values are then exact in float32


class Window(NamedTuple):
    """A rectangle of a patch whose values are added, or taken off, in one of the sums that a further feature reads."""

    sum: int
    top: int
    left: int
    rows: int
    columns: int
    sign: int  # 1 or −1


class Axis(NamedTuple):
    """A further feature as a rule holds it."""

    name: str  # as the recipe's key and its module are called
    size: int  # values that it takes
    windows: tuple[Window, ...]  # of the sums that it reads, numbered from 0
    constants: NDArray[np.int32]  # what its formula reads beside the sums and the level

    @property
    def sums(self) -> int:
        return 1 + max((window.sum for window in self.windows), default=-1)


@dataclass(frozen=True)
class FurtherFeatures:
    """Features that a recipe has switched on beside level, contrast, saturation and chroma, in order."""

    names: tuple[str, ...] = data("str", "feature", doc="as in the recipe; what each decides stands in its module")
    sizes: NDArray[np.int64] = data("int64", "feature", doc="values that each takes")
    window_counts: NDArray[np.int64] = data("int64", "feature", doc="windows of each")
    windows: NDArray[np.int64] = data(
        "int64",
        "window",
        "window_field",
        unit="pixel",
        doc="sum that a rectangle of the patch counts in, its top, left, rows, columns and sign",
    )
    constant_counts: NDArray[np.int64] = data("int64", "feature", doc="constants of each")
    constants: NDArray[np.int32] = data("int32", "constant", doc="what the formula of each reads")

    @classmethod
    def of(cls, axes: tuple[Axis, ...]) -> "FurtherFeatures":
        """Return `axes` as they are stored."""
        windows = np.array([window for axis in axes for window in axis.windows], np.int64)
        return cls(
            tuple(axis.name for axis in axes),
            np.array([axis.size for axis in axes]),
            np.array([len(axis.windows) for axis in axes]),
            windows.reshape(-1, len(Window._fields)),
            np.array([len(axis.constants) for axis in axes]),
            np.concatenate([axis.constants for axis in axes]).astype(np.int32),
        )

    @cached_property
    def axes(self) -> tuple[Axis, ...]:
        rows = [Window(*row) for row in self.windows.tolist()]
        window_end, constant_end = np.cumsum(self.window_counts), np.cumsum(self.constant_counts)
        return tuple(
            Axis(
                name,
                int(self.sizes[index]),
                tuple(rows[window_end[index] - self.window_counts[index] : window_end[index]]),
                self.constants[constant_end[index] - self.constant_counts[index] : constant_end[index]],
            )
            for index, name in enumerate(self.names)
        )

    def check(self, patch: int) -> None:
        """Raise ValueError if these cannot be features of patches of side `patch`."""
        if not self.names or len(set(self.names)) != len(self.names):
            raise ValueError("names of further features must be there, each once")
        if (self.sizes < 1).any() or math.prod(self.sizes.tolist()) > MAX_FURTHER:
            raise ValueError(f"sizes of further features must be positive, and at most {MAX_FURTHER} together")
        counts = ((self.window_counts, len(self.windows)), (self.constant_counts, len(self.constants)))
        if any((count < 0).any() or count.sum() != length for count, length in counts):
            raise ValueError("further features have other numbers of windows or constants than are counted")
        if self.windows.shape[1] != len(Window._fields):
            raise ValueError(f"windows has {self.windows.shape[1]} fields, not {len(Window._fields)}")
        number, top, left, rows, columns, sign = self.windows.T
        inside = (top >= 0) & (left >= 0) & (rows >= 1) & (columns >= 1) & (np.abs(sign) == 1)
        inside &= (top <= patch - rows) & (left <= patch - columns) & (number >= 0) & (number < len(number))
        if not inside.all():
            raise ValueError("windows must lie within the patch, with the sign 1 or −1")
        if (rows * columns).sum() > MAX_WINDOW_TAPS:
            raise ValueError(f"windows hold more than {MAX_WINDOW_TAPS} taps")
