"""Conditions of a transform table: additional transforms for single illuminants and for noise sets.

See docs/method.md#several-illuminants and docs/method.md#noise-sets. All conditions share the table's class rules, apart
from class edges that depend on the noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import NoiseScale
from l3cli.artifacts.layers import Clipping, CoarseChroma, MosaicLayer, PlaneLayer
from l3cli.artifacts.plane_rules import GradientScale
from l3cli.artifacts.schema import check, data, group
from l3cli.artifacts.training_set import LightSpectrum


@dataclass(frozen=True)
class SceneLight:
    """An illuminant with its own transforms in a table."""

    name: str = data("str", doc="name of the illuminant")
    white_point: NDArray[np.float64] = data(
        "float64", "output", doc="outputs of a perfect white under this illuminant, scaled to Y = 1"
    )
    spectrum: LightSpectrum | None = group(default=None)

    def __post_init__(self) -> None:
        if not self.white_point[:3].min() > 0:
            raise ValueError(f"the white_point of {self.name} contains {self.white_point[:3].min():g}, but must be positive")


@dataclass(frozen=True)
class NoiseEdges:
    """Class rule values that depend on the noise: class edges, gradient scales and the coarse chroma's noise model."""

    contrast_edges: NDArray[np.uint32] = data(
        "uint32", "contrast_edge", "level", doc="contrast edges for this noise, as in first/rule"
    )
    constants: NDArray[np.int32] = data(
        "int32",
        "constant",
        doc="constants of the features for this noise, as in first/rule/features; empty without features",
    )
    gradients: tuple[GradientScale, ...] = group(default=())  # one scale per refinement layer
    coarse_chroma: CoarseChroma | None = group(default=None)  # for the last layer; None: use the table's noise model

    @classmethod
    def of(cls, first: MosaicLayer, later: Sequence[PlaneLayer]) -> "NoiseEdges":
        """Collect the noise-dependent values from the class rules of all layers."""
        constants = first.rule.features.constants if first.rule.features else np.zeros(0, np.int32)
        coarse = later[-1].coarse_chroma if later else None
        return cls(first.rule.contrast_edges, constants, tuple(layer.rule.scale for layer in later), coarse)


@dataclass(frozen=True)
class MosaicTransforms:
    """Transforms of the first layer for one condition."""

    weights: NDArray[np.float32] = data("float32", "class", "output", "tap", doc="weights for this condition, as in first")
    intercept: NDArray[np.float32] = data(
        "float32", "class", "output", doc="constant that is added to the weighted sum of the taps"
    )
    samples: NDArray[np.float64] = data(
        "float64", "class", doc="number of training patches; 0: the class uses the transform of a similar class"
    )


@dataclass(frozen=True)
class PlaneTransforms:
    """Transforms of a refinement layer for one condition."""

    weights: NDArray[np.float32] = data(
        "float32", "plane_class", "output", "plane_tap", doc="weights for this condition, as in later"
    )
    intercept: NDArray[np.float32] = data(
        "float32", "plane_class", "output", doc="constant that is added to the weighted sum of the taps"
    )
    samples: NDArray[np.float64] = data(
        "float64", "plane_class", doc="number of training patches; 0: the class uses the transform of a similar class"
    )
    clipping: Clipping | None = group(default=None)  # response of clipped areas, as in PlaneLayer


@dataclass(frozen=True)
class Condition:
    """Transforms of all layers for one illuminant, one noise set, or a combination of both."""

    first: MosaicTransforms = group()
    later: tuple[PlaneTransforms, ...] = group(default=())
    light: SceneLight | None = group(default=None)  # None: the transforms are for all training illuminants together
    noise: NoiseScale | None = group(default=None)  # None: the transforms are for the camera's own noise
    edges: NoiseEdges | None = group(default=None)  # None: the class edges of the table apply

    def __post_init__(self) -> None:
        check(self)
        if (self.noise is None) != (self.edges is None) or not (self.light or self.noise):
            raise ValueError(
                "a condition must have an illuminant (light), or a noise scale with class edges (noise and edges)"
            )

    @classmethod
    def of(
        cls, first: MosaicLayer, later: Sequence[PlaneLayer], light: SceneLight | None, noise: NoiseScale | None
    ) -> "Condition":
        """Create a condition from layers that were trained for it.

        Parameters
        ----------
        first : MosaicLayer
            First layer.
        later : sequence of PlaneLayer
            Refinement layers.
        light : SceneLight or None
            The illuminant, or None for all illuminants of the training set.
        noise : NoiseScale or None
            The noise of a noise set, or None for the camera's noise. With a noise set, the noise-dependent class edges of
            the layers become part of the condition.
        """
        return cls(
            MosaicTransforms(first.weights, first.intercept, first.samples),
            tuple(PlaneTransforms(layer.weights, layer.intercept, layer.samples, layer.clipping) for layer in later),
            light,
            noise,
            NoiseEdges.of(first, later) if noise else None,
        )

    def check_fits(self, place: str, later: Sequence[PlaneLayer], levels: int) -> None:
        """Raise ValueError unless the condition fits a table with the refinement layers `later` and `levels` levels.

        The error message begins with `place`, the path of the condition in the file.
        """
        if len(self.later) != len(later) or (self.edges and len(self.edges.gradients) != len(later)):
            raise ValueError(f"{place} has {1 + len(self.later)} layers, but the table has {1 + len(later)}")
        for number, (ours, layer) in enumerate(zip(self.later, later, strict=True)):
            if ours.weights.shape != layer.weights.shape:
                raise ValueError(
                    f"the weights in {place}/later/{number} have the shape {ours.weights.shape}, but the weights in "
                    f"later/{number} have {layer.weights.shape}"
                )
        if self.edges and any(len(scale.gradient_factor) != levels for scale in self.edges.gradients):
            raise ValueError(f"{place}/edges must have as many levels as the table, {levels}")

    def pictured(self, taken: list[int]) -> "Condition":
        """Return the condition with a part of the first layer's outputs: those with the indices `taken`.

        Refinement layers stay unchanged.
        """
        first = replace(self.first, weights=self.first.weights[:, taken], intercept=self.first.intercept[:, taken])
        light = self.light and replace(self.light, white_point=self.light.white_point[taken])
        return replace(self, first=first, light=light)
