"""The class rule of a layer that reads planes: the structure of the luminance that the layer before has made
(docs/method.md#structure). What the numbers mean is written out in l3cli/classes/structure.py."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.plane_classes import PlaneClasses
from l3cli.artifacts.schema import check, data

GRADIENT = 4095  # largest gradient, in units of SIGMA per standard deviation of noise: sums of 81 squares stay below 2^31
FACTORS, MOST_SHIFT = (64, 127), 24  # of gradients
DIRECTIONS = 8  # of edges, half a turn in all


@dataclass(frozen=True)
class StructureRule(PlaneClasses):
    """Classes by level, and by strength and direction of edges."""

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

    def level_of(self, first: Any) -> Any:
        return first // self.level_step

    @property
    def strengths(self) -> int:
        return len(self.strength_edges)

    @property
    def structures(self) -> int:
        """Flat, then for each strength no direction and every direction."""
        return 1 + self.strengths * (1 + DIRECTIONS)
