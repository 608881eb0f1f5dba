"""The class rule of a layer that reads planes: the structure of the luminance that the layer before has made
(docs/method.md#structure). What the numbers mean is written out in l3cli/classes/structure.py."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.schema import check, data

GRADIENT = 4095  # largest gradient, in units of SIGMA per standard deviation of noise: sums of 81 squares stay below 2^31
FACTORS, MOST_SHIFT = (64, 127), 24  # of gradients
DIRECTIONS = 8  # of edges, half a turn in all


class StructurePlace(NamedTuple):
    """Where classes lie along the axes of their rule: integers, or integer arrays of equal shape."""

    site: Any  # CFA row · CFA columns + CFA column
    level: Any
    kind: Any  # structure of an unsaturated pixel, or structures − 1 + saturation case of one near saturation


@dataclass(frozen=True)
class StructureRule:
    """class = (site · levels + level) · kinds + kind. Level and saturation case are those of the first layer."""

    level_step: int = data("int64", doc="levels of the first layer that make one here")
    gradient_factor: NDArray[np.uint8] = data(
        "uint8", "mosaic_level", doc="what luminance differences are multiplied by, at each level of the first layer …"
    )
    gradient_shift: NDArray[np.uint8] = data("uint8", "mosaic_level", unit="bit", doc="… and then shifted right by")
    strength_edges: NDArray[np.uint32] = data(
        "uint32", "strength_edge", doc="trace of the structure tensor above which the next strength begins"
    )
    coherence: int = data("int64", unit="1/64", doc="share of the trace along one direction from which an edge has one")
    turns: NDArray[np.int8] = data(
        "int8", "site", "component", doc="signs of the tensor's components in the orientation that a site is learned in"
    )
    cases: int = data("int64", doc="saturation cases of the first layer, the unsaturated one included")

    def __post_init__(self) -> None:
        check(self)
        if self.level_step < 1 or self.cases < 1 or not 0 <= self.coherence <= 64:
            raise ValueError("level_step and cases must be at least 1, coherence within 0…64")
        if self.turns.shape[1:] != (2,) or (np.abs(self.turns) != 1).any():
            raise ValueError("turns must be two signs a site")
        if (np.diff(self.strength_edges.astype(np.int64)) <= 0).any():
            raise ValueError("strength_edges do not increase")
        if self.gradient_factor.max(initial=0) > FACTORS[1] or self.gradient_shift.max(initial=0) > MOST_SHIFT:
            raise ValueError(f"gradient_factor exceeds {FACTORS[1]}, or gradient_shift {MOST_SHIFT}")

    @property
    def levels(self) -> int:
        return -(-len(self.gradient_factor) // self.level_step)

    @property
    def strengths(self) -> int:
        return len(self.strength_edges)

    @property
    def structures(self) -> int:
        """Flat, then for each strength no direction and every direction."""
        return 1 + self.strengths * (1 + DIRECTIONS)

    @property
    def kinds(self) -> int:
        return self.structures + self.cases - 1

    @property
    def classes_per_site(self) -> int:
        return self.levels * self.kinds

    def join(self, level: Any, kind: Any, site: Any = 0) -> Any:
        """Indices of classes from their places; `level` is one of this rule."""
        return (site * self.levels + level) * self.kinds + kind

    def split(self, index: Any) -> StructurePlace:
        """Places of the classes `index`, an integer or an array."""
        rest, kind = divmod(index, self.kinds)
        site, level = divmod(rest, self.levels)
        return StructurePlace(site, level, kind)

    def within_site(self, index: Any) -> tuple[Any, Any]:
        """Sites of the classes `index` of all sites, and their indices within them."""
        site, within = divmod(index, self.classes_per_site)
        return site, within

    def kind(self, structure: Any, case: Any) -> Any:
        """Kinds of pixels of a structure and a saturation case, which decides where it is not 0."""
        return np.where(np.greater(case, 0), self.structures - 1 + case, structure)

    def case(self, kind: Any) -> Any:
        """Saturation cases of kinds: 0 where nothing is saturated and the kind is a structure."""
        return np.maximum(kind - self.structures + 1, 0)
