"""What an OpenCL device keeps of a table's later layers."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from l3cli.classes.planes import later_fixed_point, opponent_basis
from l3cli.rendering import layout
from l3cli.rendering.noise_sets import Sets, first_fixed_point, later_layers, later_rules


@dataclass(frozen=True)
class PlaneStep:
    """How a layer that reads planes comes to them and to its classes."""

    weights: Any  # of the layer before
    rule: tuple[Any, ...]
    nothing: Any  # where other transforms have a display's matrix


def plane_steps(sets: Sets, variant: str, lanes: int, constant: Callable[..., Any]) -> list[PlaneStep]:
    """The step to each later layer; `constant` makes buffers of arrays."""
    return [_plane_step(sets, number, variant, lanes, constant) for number in range(len(sets[0].later))]


def _plane_step(sets: Sets, number: int, variant: str, lanes: int, constant: Callable[..., Any]) -> PlaneStep:
    table, later = sets[0], later_layers(sets)
    if number:
        weights = layout.later_plane_weights(later_fixed_point(later[number - 1], opponent_basis(table.white_point)))
    else:
        weights = layout.first_plane_weights(first_fixed_point(sets), table.bits)
    rule = tuple(constant(array) for array in layout.rule_arrays(table, variant, *later_rules(sets, number)))
    return PlaneStep(constant(layout.VARIANTS[variant].pack_whole(weights, lanes)), rule, constant(np.zeros(9, np.float32)))
