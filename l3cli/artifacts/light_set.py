"""A table's transforms for one of the lights that it was trained under (docs/method.md#several-lights)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.layers import MosaicLayer, PlaneLayer
from l3cli.artifacts.schema import check, data, group
from l3cli.artifacts.training_set import LightSpectrum


@dataclass(frozen=True)
class MosaicTransforms:
    """Transforms of the layer that reads the mosaic, for the classes of the table's."""

    weights: NDArray[np.float32] = data("float32", "class", "output", "tap", doc="as in first/")
    intercept: NDArray[np.float32] = data("float32", "class", "output", doc="added to the weighted sum")
    samples: NDArray[np.float64] = data("float64", "class", doc="training patches; 0: filled from a neighbour")

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True)
class PlaneTransforms:
    """Transforms of a later layer, for the classes of the table's."""

    weights: NDArray[np.float32] = data("float32", "plane_class", "output", "plane_tap", doc="as in later/")
    intercept: NDArray[np.float32] = data("float32", "plane_class", "output", doc="added to the weighted sum")
    samples: NDArray[np.float64] = data("float64", "plane_class", doc="training patches; 0: filled from a neighbour")

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True)
class LightSet:
    """Transforms that a table has learned from the frames under one light alone; its classes are those of the table."""

    name: str = data("str", doc="the light")
    white_point: NDArray[np.float64] = data("float64", "output", doc="output of a perfect white under it, Y = 1")
    first: MosaicTransforms = group()
    later: tuple[PlaneTransforms, ...] = group(default=())
    light: LightSpectrum | None = group(default=None)

    def __post_init__(self) -> None:
        check(self)
        if not self.white_point[:3].min() > 0:
            raise ValueError(f"white_point of {self.name} is that of no light")

    @classmethod
    def of(
        cls, name: str, white_point: NDArray[np.float64], light: LightSpectrum | None, first: MosaicLayer,
        later: Sequence[PlaneLayer],
    ) -> "LightSet":  # fmt: skip
        """Return the transforms of layers that were learned under the light."""
        planes = tuple(PlaneTransforms(layer.weights, layer.intercept, layer.samples) for layer in later)
        return cls(name, white_point, MosaicTransforms(first.weights, first.intercept, first.samples), planes, light)

    def check_fits(self, place: str, first: MosaicLayer, later: Sequence[PlaneLayer]) -> None:
        """Raise ValueError, which names the set's `place`, if its transforms are not for the classes and taps of a
        table's."""
        if len(self.later) != len(later):
            raise ValueError(f"{place} holds {1 + len(self.later)} layers, the table {1 + len(later)}")
        ours = [each.shape for each in (self.first.weights, *(layer.weights for layer in self.later))]
        theirs = [each.shape for each in (first.weights, *(layer.weights for layer in later))]
        for number, (shape, wanted) in enumerate(zip(ours, theirs, strict=True)):
            if shape != wanted:
                name = f"later/{number - 1}" if number else "first"
                raise ValueError(f"{place}/{name} has transforms of other shapes than {name}")

    def pictured(self) -> "LightSet":
        """Return the set of the first three outputs alone."""
        first = replace(self.first, weights=self.first.weights[:, :3], intercept=self.first.intercept[:, :3])
        return replace(self, white_point=self.white_point[:3], first=first)
