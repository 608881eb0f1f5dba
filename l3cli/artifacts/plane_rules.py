"""Class rules of refinement layers, as stored in tables, and the conversion between feature values and class indices.

Classes are structures (docs/method.md#structure) or the leaves of a decision tree (docs/method.md#trees). The modules in
l3cli/classes compute these features and explain their values.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.schema import check, data

# Scaled gradients are clipped to this value, so that sums of 81 squares stay below 2³¹. The scale sets their noise to a
# standard deviation of SIGMA = 16.
GRADIENT = 4095
# gradients are multiplied by a factor in this range, then shifted right by at most this number of bits
FACTORS, MAX_SHIFT = (64, 127), 24
DIRECTIONS = 8  # number of edge directions within 180°
MAX_LEAVES = 2048
MAX_DEPTH = 24  # maximum number of tests from the root to a leaf, which bounds the kernels' run time
TESTS = 23  # number of different tests that a tree can use
ORIENTATIONS = 8  # orientations of a square: four rotations, with and without reflection
# Range of the absolute values of nonzero thresholds. The lower limit is far above the denormal numbers (below 1.2e-38),
# which some devices flush to zero.
SMALLEST, LARGEST = 1e-30, 2.0**31


@dataclass(frozen=True)
class GradientScale:
    """Factors that normalise gradients by their noise. The factor at each level is gradient_factor / 2^gradient_shift."""

    gradient_factor: NDArray[np.uint8] = data(
        "uint8",
        "mosaic_level",
        doc="factor by which differences of planes are multiplied, for each level of the first layer",
    )
    gradient_shift: NDArray[np.uint8] = data(
        "uint8", "mosaic_level", unit="bit", doc="number of bits by which the product is then shifted right"
    )

    def __post_init__(self) -> None:
        check(self)
        if self.gradient_factor.max(initial=0) > FACTORS[1] or self.gradient_shift.max(initial=0) > MAX_SHIFT:
            raise ValueError(f"gradient_factor must be at most {FACTORS[1]}, and gradient_shift at most {MAX_SHIFT}")

    @staticmethod
    def of(scale: NDArray[np.float64]) -> "GradientScale":
        """Convert positive scale factors, one per level, to 7-bit factors and shifts."""
        shift = np.clip(np.ceil(np.log2(FACTORS[0] / scale)), 0, MAX_SHIFT)
        factor = np.clip(np.rint(scale * 2**shift), 1, FACTORS[1])
        return GradientScale(factor.astype(np.uint8), shift.astype(np.uint8))

    @property
    def scale(self) -> "GradientScale":
        """The part of the class rule that normalises gradients by their noise."""
        return GradientScale(self.gradient_factor, self.gradient_shift)

    def scaled_as(self, scale: "GradientScale") -> Self:
        """Return the class rule with a different gradient scale."""
        return replace(self, gradient_factor=scale.gradient_factor, gradient_shift=scale.gradient_shift)


class PlanePlace(NamedTuple):
    """The feature values that identify a class of a refinement layer: integers, or integer arrays for several classes."""

    site: Any  # CFA row · (number of CFA columns) + CFA column
    level: Any
    kind: Any  # structure if no channel is saturated, otherwise (number of structures) − 1 + saturation case


class PlaneClasses(GradientScale):
    """Base class of the class rules of refinement layers.

    A class has the index (site · levels + level) · kinds + kind. The level and the saturation case are derived from the
    pixel's class in the first layer. The kind is a structure if no channel is saturated, otherwise a saturation case.
    """

    cases: int  # number of the first layer's saturation cases, including the unsaturated case
    turns: NDArray[Any]  # (site, …): orientation to which each site's windows are turned for training

    @property
    def levels(self) -> int:
        """Number of levels."""
        raise NotImplementedError

    @property
    def structures(self) -> int:
        """Number of structures or tree leaves. They distinguish only pixels without clipped channels nearby."""
        raise NotImplementedError

    @property
    def kinds(self) -> int:
        """Number of structures, plus the number of saturation cases in which a channel clips."""
        return self.structures + self.cases - 1

    @property
    def classes_per_site(self) -> int:
        """Number of classes at each CFA site."""
        return self.levels * self.kinds

    def check_fits(self, sites: int, first: ClassRule) -> None:
        """Raise ValueError unless the rule fits a CFA with `sites` sites and the class rule of the first layer."""
        if len(self.turns) != sites:
            raise ValueError(f"turns has {len(self.turns)} sites, but the CFA has {sites}")
        if (len(self.gradient_factor), self.cases) != (first.levels, first.lost_cases):
            raise ValueError(
                f"a refinement layer has {len(self.gradient_factor)} levels and {self.cases} saturation cases, but the "
                f"first layer has {first.levels} levels and {first.lost_cases} saturation cases"
            )

    def level_of(self, first: Any) -> Any:
        """Convert a level of the first layer to a level of this layer."""
        raise NotImplementedError

    def join(self, level: Any, kind: Any, site: Any = 0) -> Any:
        """Combine feature values, which are integers or integer arrays, into a class index."""
        return (site * self.levels + level) * self.kinds + kind

    def split(self, index: Any) -> PlanePlace:
        """Split class indices into feature values: the inverse of `join`."""
        rest, kind = divmod(index, self.kinds)
        site, level = divmod(rest, self.levels)
        return PlanePlace(site, level, kind)

    def within_site(self, index: Any) -> tuple[Any, Any]:
        """Split class indices of the whole layer into the site and the class index within the site."""
        site, within = divmod(index, self.classes_per_site)
        return site, within

    def kind(self, structure: Any, case: Any) -> Any:
        """Combine structure and saturation case into one index, the kind. The structure is ignored unless the case is 0."""
        return np.where(np.greater(case, 0), self.structures - 1 + case, structure)

    def case(self, kind: Any) -> Any:
        """Return the saturation case that each index `kind` stands for, or 0 if it stands for a structure."""
        return np.maximum(kind - self.structures + 1, 0)


@dataclass(frozen=True)
class StructureRule(PlaneClasses):
    """Class rule that distinguishes levels, edge strengths and edge directions."""

    level_step: int = data("int64", doc="number of levels of the first layer that form one level of this layer")
    strength_edges: NDArray[np.uint32] = data(
        "uint32", "strength_edge", doc="trace of the structure tensor above which each strength begins"
    )
    coherence: int = data(
        "int64",
        unit="1/64",
        doc="fraction of the trace that the component along a direction must exceed in directed edges",
    )
    turns: NDArray[np.int8] = data(
        "int8",
        "site",
        "component",
        doc="signs of xx − yy and xy that turn the tensor to the orientation in which each site is trained",
    )
    cases: int = data("int64", doc="number of saturation cases of the first layer, including the unsaturated one")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.level_step < 1 or self.cases < 1 or not 0 <= self.coherence <= 64:
            raise ValueError("level_step and cases must be at least 1, and coherence must be between 0 and 64")
        if self.turns.shape[1:] != (2,) or (np.abs(self.turns) != 1).any():
            raise ValueError("turns must contain two signs (+1 or -1) per site")
        if (np.diff(self.strength_edges.astype(np.int64)) <= 0).any():
            raise ValueError("strength_edges must increase")

    @property
    def levels(self) -> int:
        return -(-len(self.gradient_factor) // self.level_step)

    def level_of(self, first: Any) -> Any:
        return first // self.level_step

    @property
    def strengths(self) -> int:
        return len(self.strength_edges)

    @property
    def structures(self) -> int:
        """Number of structures: one for flat areas and, per strength, one without and DIRECTIONS with a direction."""
        return 1 + self.strengths * (1 + DIRECTIONS)

    def next_strengths(self, structure: int) -> list[int]:
        """Return the structures with the next lower and the next higher strength and the same direction.

        Flat areas and structures of the lowest strength have no neighbours and are never returned.
        """
        step, least = 1 + DIRECTIONS, 2 + DIRECTIONS
        others = (structure - step, structure + step)
        return [other for other in others if least <= min(other, structure) and other < self.structures]


@dataclass(frozen=True)
class TreeRule(PlaneClasses):
    """Class rule in the form of a decision tree, with one class per leaf.

    All sites use the same tree. Before the tests, a pixel's window is turned to the orientation in which its site was
    trained.
    """

    test: NDArray[np.uint8] = data("uint8", "node", doc="index of the quotient that the node compares with its threshold")
    threshold: NDArray[np.float32] = data(
        "float32", "node", doc="threshold of the node; larger quotients lead to the second branch"
    )
    branch: NDArray[np.int32] = data(
        "int32",
        "node",
        doc="index of the first of the two branches of the node, which are consecutive nodes; 0: the node is a leaf",
    )
    turns: NDArray[np.uint8] = data(
        "uint8",
        "site",
        doc="orientation in which each site is trained: one of the eight rotations and reflections of a square",
    )
    cases: int = data("int64", doc="number of saturation cases of the first layer, including the unsaturated one")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.cases < 1 or self.turns.max(initial=0) >= ORIENTATIONS or self.test.max(initial=0) >= TESTS:
            raise ValueError(
                f"cases must be at least 1, turns must be less than {ORIENTATIONS}, and test must be less than {TESTS}"
            )
        size = np.abs(self.threshold[self.threshold != 0])
        if size.size and not SMALLEST <= size.min() <= size.max() <= LARGEST:
            raise ValueError(f"every threshold must be 0 or have an absolute value between {SMALLEST:g} and {LARGEST:g}")
        inner = np.flatnonzero(self.branch)
        every = np.concatenate([[0], self.branch[inner], self.branch[inner] + 1])
        if (self.branch[inner] <= inner).any() or not np.array_equal(np.sort(every), np.arange(len(self.branch))):
            raise ValueError(
                "branch is not a tree: every node except the first must be a branch of exactly one earlier node"
            )
        if self.structures > MAX_LEAVES:
            raise ValueError(f"the tree has {self.structures} leaves, but may have at most {MAX_LEAVES}")
        if self.depth > MAX_DEPTH:
            raise ValueError(f"the tree has a depth of {self.depth} tests, but the depth may be at most {MAX_DEPTH}")

    @property
    def levels(self) -> int:
        return 1

    def level_of(self, first: Any) -> Any:
        return first * 0

    @property
    def structures(self) -> int:
        """Number of leaves."""
        return len(self.branch) - int(np.count_nonzero(self.branch))

    @property
    def leaf(self) -> NDArray[np.int64]:
        """Index of the leaf at each node: (node). For an inner node, it is the index of the first leaf below the node.

        Leaves are numbered in depth-first order, and the first branch of a node comes before the second.
        """
        below = np.ones(len(self.branch), np.int64)  # number of leaves below each node
        inner = np.flatnonzero(self.branch).tolist()
        for node in reversed(inner):  # in reverse order, both branches are counted before their parent
            below[node] = below[self.branch[node]] + below[self.branch[node] + 1]
        first = np.zeros(len(self.branch), np.int64)
        for node in inner:
            left = self.branch[node]
            first[left], first[left + 1] = first[node], first[node] + below[left]
        return first

    @property
    def depth(self) -> int:
        """Number of tests from the root to the deepest leaf."""
        depth = np.zeros(len(self.branch), np.int64)
        for node in np.flatnonzero(self.branch).tolist():  # branches come after their parent
            depth[self.branch[node] : self.branch[node] + 2] = depth[node] + 1
        return int(depth.max())
