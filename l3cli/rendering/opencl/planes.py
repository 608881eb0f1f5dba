"""Buffers of a table on an OpenCL device."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.classes.planes import later_fixed_point, opponent_basis
from l3cli.rendering.noise_sets import Sets, first_fixed_point, later_layers, later_rules
from l3cli.rendering.opencl import layout
from l3cli.rendering.opencl.quiet import last_weights


@dataclass(frozen=True)
class PlaneStep:
    """Step to the planes and classes of a layer that reads planes."""

    weights: Any  # of the layer before
    rule: tuple[Any, ...]
    nothing: Any  # where other transforms have a display's matrix


def table_buffers(
    sets: Sets, variant: str, lanes: int, constant: Callable[..., Any]
) -> tuple[list[Any], Any, list[PlaneStep]]:
    """Return the buffers of the first layer's class rule, the last layer's transforms, and the step to each later layer.
    `constant` makes buffers of arrays."""
    steps = []
    for number in range(len(sets[0].later)):
        before, *rule = map(constant, _arrays(sets, number, variant, lanes))
        steps.append(PlaneStep(before, tuple(rule), constant(np.zeros(9, np.float32))))
    weights = constant(layout.VARIANTS[variant].pack(last_weights(sets), lanes))
    return [*map(constant, layout.class_arrays(*sets))], weights, steps


def _arrays(sets: Sets, number: int, variant: str, lanes: int) -> tuple[NDArray, ...]:
    """Weights of the layer before, and what later layer `number` decides its classes by."""
    table, later = sets[0], later_layers(sets)
    if number:
        weights = layout.later_plane_weights(later_fixed_point(later[number - 1], opponent_basis(table.white_point)))
    else:
        weights = layout.first_plane_weights(first_fixed_point(sets), table.bits)
    rules = layout.rule_arrays(table, variant, *later_rules(sets, number))
    return layout.VARIANTS[variant].pack_whole(weights, lanes), *rules
