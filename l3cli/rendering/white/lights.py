"""A table's transforms for the light of a scene, mixed of those for the lights about it (docs/method.md#several-lights)."""

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.layers import MosaicLayer, PlaneLayer
from l3cli.artifacts.light_set import MosaicTransforms, PlaneTransforms
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import LightSpectrum
from l3cli.physics.correlated_lights import mired_of

Transforms = MosaicTransforms | PlaneTransforms
Layer = TypeVar("Layer", MosaicLayer, PlaneLayer)
Float = TypeVar("Float", np.float32, np.float64)


@dataclass(frozen=True)
class Mix:
    """Two of a table's lights, by their indices, and the share of the cooler one."""

    warm: int
    cool: int
    share: float


def mix_for(table: TransformTable, white: NDArray[np.floating]) -> Mix | None:
    """The mix for a scene whose white has the XYZ (3): linear in reciprocal colour temperature between the lights next to
    it, the outermost light beyond. None: the table has one set of transforms."""
    if not table.lights:
        return None
    mireds = [mired_of(light.white_point[:3]) for light in table.lights]
    order = sorted(range(len(mireds)), key=lambda index: -mireds[index])
    wanted = mired_of(white)
    cooler = next((place for place, index in enumerate(order) if mireds[index] <= wanted), len(order) - 1)
    warm, cool = order[max(cooler - 1, 0)], order[cooler]
    span = mireds[warm] - mireds[cool]
    return Mix(warm, cool, float(np.clip((mireds[warm] - wanted) / span, 0.0, 1.0)) if span > 0 else 1.0)


def nearest_for(table: TransformTable, white: NDArray[np.floating]) -> Mix | None:
    """The one of those two lights that is nearer to a white (3), alone: for frames that are balanced for their white."""
    mix = mix_for(table, white)
    return None if mix is None else replace(mix, share=float(mix.share >= 0.5))


def mixed(table: TransformTable, mix: Mix | None) -> TransformTable:
    """The table of one set of transforms that a mix of its lights makes; None: its transforms for all lights in common."""
    if mix is None:
        return replace(table, lights=()) if table.lights else table
    warm, cool, share = table.lights[mix.warm], table.lights[mix.cool], mix.share
    light = None
    if warm.light and cool.light and np.array_equal(warm.light.wavelength, cool.light.wavelength):
        light = LightSpectrum(warm.light.wavelength, _between(warm.light.radiance, cool.light.radiance, share))
    return replace(
        table,
        first=_layer(table.first, warm.first, cool.first, share),
        later=tuple(_layer(*layers, share) for layers in zip(table.later, warm.later, cool.later, strict=True)),
        white_point=_between(warm.white_point, cool.white_point, share),
        light=light,
        lights=(),
    )


def described(table: TransformTable, mix: Mix) -> str:
    """The mix in words, such as "62 % A, 38 % D65", or "A"."""
    warm, cool, percent = table.lights[mix.warm].name, table.lights[mix.cool].name, round(100 * mix.share)
    if percent in (0, 100):
        return cool if percent else warm
    return f"{100 - percent} % {warm}, {percent} % {cool}"


def _layer(common: Layer, warm: Transforms, cool: Transforms, share: float) -> Layer:
    weights, intercept = _between(warm.weights, cool.weights, share), _between(warm.intercept, cool.intercept, share)
    return replace(common, weights=weights, intercept=intercept)


def _between(warm: NDArray[Float], cool: NDArray[Float], share: float) -> NDArray[Float]:
    """Equal ones stay what they are; shares of 0 and 1 give one of the two."""
    one, other = warm.astype(np.float64), cool.astype(np.float64)
    return np.where(one == other, one, (1 - share) * one + share * other).astype(warm.dtype)
