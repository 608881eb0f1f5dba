"""The class rule of a layer that reads planes, as a tree of threshold tests that has been grown (docs/method.md#trees). What
the numbers mean is written out in l3cli/classes/tree.py."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.plane_classes import PlaneClasses
from l3cli.artifacts.schema import check, data
from l3cli.artifacts.structure_rule import FACTORS, MOST_SHIFT

MOST_LEAVES = 2048
DEEPEST = 24  # tests from the root to a leaf: kernels take as many steps as the deepest leaf lies below the root
TESTS = 21
ORIENTATIONS = 8  # of a square
SMALLEST, LARGEST = 1e-30, 2.0**31  # of thresholds but zero: what lies below float32's normal range is zero on some devices


@dataclass(frozen=True)
class TreeRule(PlaneClasses):
    """Classes by the leaves of one tree for all sites, each of which sees its neighbourhood in the orientation that it is
    learned in."""

    gradient_factor: NDArray[np.uint8] = data(
        "uint8", "mosaic_level", doc="what differences of planes are multiplied by, at each level of the first layer …"
    )
    gradient_shift: NDArray[np.uint8] = data("uint8", "mosaic_level", unit="bit", doc="… and then shifted right by")
    test: NDArray[np.uint8] = data("uint8", "node", doc="which quotient of evidence a node compares")
    threshold: NDArray[np.float32] = data("float32", "node", doc="above which the second of its branches is taken")
    branch: NDArray[np.int32] = data(
        "int32", "node", doc="the first of a node's two branches, which follow one another; 0: a leaf"
    )
    turns: NDArray[np.uint8] = data("uint8", "site", doc="orientation in which a site is learned, of the eight of a square")
    cases: int = data("int64", doc="saturation cases of the first layer, the unsaturated one included")

    def __post_init__(self) -> None:
        check(self)
        if self.cases < 1 or self.turns.max(initial=0) >= ORIENTATIONS or self.test.max(initial=0) >= TESTS:
            raise ValueError(f"cases must be at least 1, turns below {ORIENTATIONS}, tests below {TESTS}")
        if self.gradient_factor.max(initial=0) > FACTORS[1] or self.gradient_shift.max(initial=0) > MOST_SHIFT:
            raise ValueError(f"gradient_factor exceeds {FACTORS[1]}, or gradient_shift {MOST_SHIFT}")
        size = np.abs(self.threshold[self.threshold != 0])
        if size.size and not SMALLEST <= size.min() <= size.max() <= LARGEST:
            raise ValueError(f"thresholds must be zero, or of a size within {SMALLEST:g}…{LARGEST:g}")
        inner = np.flatnonzero(self.branch)
        every = np.concatenate([[0], self.branch[inner], self.branch[inner] + 1])
        if (self.branch[inner] <= inner).any() or not np.array_equal(np.sort(every), np.arange(len(self.branch))):
            raise ValueError("branch is no tree: every node but the first must be a branch of one before it")
        if self.structures > MOST_LEAVES:
            raise ValueError(f"the tree has {self.structures} leaves, more than {MOST_LEAVES}")
        if self.depth > DEEPEST:
            raise ValueError(f"the tree is {self.depth} tests deep, more than {DEEPEST}")

    @property
    def levels(self) -> int:
        return 1

    def level_of(self, first: Any) -> Any:
        return first * 0

    @property
    def structures(self) -> int:
        """Leaves."""
        return len(self.branch) - int(np.count_nonzero(self.branch))

    @property
    def leaf(self) -> NDArray[np.int64]:
        """Number (node) of the first leaf below each node, or of the leaf that it is itself; leaves are numbered as they are
        met when first branches are taken first."""
        below = np.ones(len(self.branch), np.int64)  # leaves
        inner = np.flatnonzero(self.branch).tolist()
        for node in reversed(inner):  # branches lie behind their node
            below[node] = below[self.branch[node]] + below[self.branch[node] + 1]
        first = np.zeros(len(self.branch), np.int64)
        for node in inner:
            left = self.branch[node]
            first[left], first[left + 1] = first[node], first[node] + below[left]
        return first

    @property
    def depth(self) -> int:
        """Tests from the root to the deepest leaf."""
        depth = np.zeros(len(self.branch), np.int64)
        for node in np.flatnonzero(self.branch).tolist():  # branches lie behind their node
            depth[self.branch[node] : self.branch[node] + 2] = depth[node] + 1
        return int(depth.max())
