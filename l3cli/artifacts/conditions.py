"""Conditions for which a table has transforms of their own: lights (docs/method.md#several-lights), and other noise than the
camera's (docs/method.md#noise-sets). Class rules are shared, but for edges that follow the noise."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import NoiseScale
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.layers import MosaicLayer, PlaneLayer
from l3cli.artifacts.plane_rules import GradientScale
from l3cli.artifacts.schema import check, data, group
from l3cli.artifacts.store import read_fields
from l3cli.artifacts.training_set import LightSpectrum


@dataclass(frozen=True)
class SceneLight:
    """Light of a condition."""

    name: str = data("str", doc="the light")
    white_point: NDArray[np.float64] = data("float64", "output", doc="output of a perfect white under it, Y = 1")
    spectrum: LightSpectrum | None = group(default=None)

    def __post_init__(self) -> None:
        if not self.white_point[:3].min() > 0:
            raise ValueError(f"white_point of {self.name} is that of no light")


@dataclass(frozen=True)
class NoiseEdges:
    """Edges of classes that follow the noise."""

    contrast_edges: NDArray[np.uint32] = data("uint32", "contrast_edge", "level", doc="as in first/rule/")
    constants: NDArray[np.int32] = data("int32", "constant", doc="as in first/rule/features/; none without features")
    gradients: tuple[GradientScale, ...] = group(default=())  # of each later layer

    @classmethod
    def of(cls, rule: ClassRule, gradients: Sequence[GradientScale]) -> "NoiseEdges":
        """Return the edges of a rule of the first layer, and the scales of gradients of the layers after it."""
        constants = rule.features.constants if rule.features else np.zeros(0, np.int32)
        return cls(rule.contrast_edges, constants, tuple(gradients))

    def rule(self, usual: ClassRule) -> ClassRule:
        """Return the rule of a first layer with these edges."""
        features = usual.features and replace(usual.features, constants=self.constants)
        return replace(usual, contrast_edges=self.contrast_edges, features=features)


@dataclass(frozen=True)
class MosaicTransforms:
    """Transforms of the layer that reads the mosaic."""

    weights: NDArray[np.float32] = data("float32", "class", "output", "tap", doc="as in first/")
    intercept: NDArray[np.float32] = data("float32", "class", "output", doc="added to the weighted sum")
    samples: NDArray[np.float64] = data("float64", "class", doc="training patches; 0: filled from a neighbour")


@dataclass(frozen=True)
class PlaneTransforms:
    """Transforms of a later layer."""

    weights: NDArray[np.float32] = data("float32", "plane_class", "output", "plane_tap", doc="as in later/")
    intercept: NDArray[np.float32] = data("float32", "plane_class", "output", doc="added to the weighted sum")
    samples: NDArray[np.float64] = data("float64", "plane_class", doc="training patches; 0: filled from a neighbour")


@dataclass(frozen=True)
class Condition:
    """Transforms of all layers, learned for frames under one light, with other noise than the camera's, or both."""

    first: MosaicTransforms = group()
    later: tuple[PlaneTransforms, ...] = group(default=())
    light: SceneLight | None = group(default=None)  # None: all lights of the training
    noise: NoiseScale | None = group(default=None)  # None: the camera's
    edges: NoiseEdges | None = group(default=None)  # None: those of the table's rules

    def __post_init__(self) -> None:
        check(self)
        if (self.noise is None) != (self.edges is None) or not (self.light or self.noise):
            raise ValueError("a condition must have a light, or a scale of the noise and its edges")

    @classmethod
    def of(
        cls, first: MosaicLayer, later: Sequence[PlaneLayer], light: SceneLight | None, noise: NoiseScale | None
    ) -> "Condition":
        """Return the transforms, and for other noise the edges, of layers that were learned for a condition."""
        return cls(
            MosaicTransforms(first.weights, first.intercept, first.samples),
            tuple(PlaneTransforms(layer.weights, layer.intercept, layer.samples) for layer in later),
            light,
            noise,
            NoiseEdges.of(first.rule, [layer.rule.scale for layer in later]) if noise else None,
        )

    def check_fits(self, place: str, later: Sequence[PlaneLayer], levels: int) -> None:
        """Raise ValueError, which names `place`, unless it is for a table of so many levels with these later layers."""
        if len(self.later) != len(later) or (self.edges and len(self.edges.gradients) != len(later)):
            raise ValueError(f"{place} holds {1 + len(self.later)} layers, the table {1 + len(later)}")
        for number, (ours, layer) in enumerate(zip(self.later, later, strict=True)):
            if ours.weights.shape != layer.weights.shape:
                raise ValueError(f"{place}/later/{number} has transforms of other shapes than later/{number}")
        if self.edges and any(len(scale.gradient_factor) != levels for scale in self.edges.gradients):
            raise ValueError(f"{place}/edges has gradients of other levels than the table")

    def pictured(self) -> "Condition":
        """Return the transforms of the first three outputs alone."""
        first = replace(self.first, weights=self.first.weights[:, :3], intercept=self.first.intercept[:, :3])
        light = self.light and replace(self.light, white_point=self.light.white_point[:3])
        return replace(self, first=first, light=light)


# Format version 4 and before.
@dataclass(frozen=True)
class _LowNoise(NoiseScale):
    first: MosaicLayer = group(kw_only=True)
    later: tuple[PlaneLayer, ...] = group(default=())


@dataclass(frozen=True)
class _OneLight:
    name: str = data("str")
    white_point: NDArray[np.float64] = data("float64", "output")
    first: MosaicTransforms = group()
    later: tuple[PlaneTransforms, ...] = group(default=())
    light: LightSpectrum | None = group(default=None)


@dataclass(frozen=True)
class _Older:
    quiet: _LowNoise | None = group(default=None)
    lights: tuple[_OneLight, ...] = group(default=())


def older_conditions(table: h5py.Group, path: Path) -> tuple[Condition, ...]:
    """Read the conditions of a table of format version 4 or before: low-noise transforms, and those of lights."""
    older: _Older = read_fields(table, _Older, path)
    low = older.quiet
    noise = () if low is None else (Condition.of(low.first, low.later, None, NoiseScale(low.shot, low.read)),)
    lights = (
        Condition(each.first, each.later, SceneLight(each.name, each.white_point, each.light)) for each in older.lights
    )
    return (*noise, *lights)
