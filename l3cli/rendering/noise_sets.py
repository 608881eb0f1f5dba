"""The sets of transforms that pixels are rendered by: a table's usual one and its quiet one, for pixels of which a filter in
time has left little noise (docs/method.md#noise-sets).

Classes of the quiet set follow those of the usual one, as if they were of an array of twice as many sites: whatever is
chosen by class, by kernels or by the reference, lies in arrays of both sets, one behind the other.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.layers import MosaicLayer, PlaneLayer, PlaneRule
from l3cli.artifacts.table import TransformTable
from l3cli.classes.kernel import kernel_macros
from l3cli.classes.planes import FixedPoint, fixed_point
from l3cli.errors import InputFileError
from l3cli.frames.frame import RawFrame

Sets = tuple[TransformTable, ...]  # one, or the usual and the quiet


def sets_of(table: TransformTable, by_noise: bool) -> Sets:
    """The table's usual set alone or, `by_noise`, and its quiet one, which must be there. InputFileError if both do not read
    alike."""
    if not by_noise:
        return (table,)
    assert table.quiet is not None
    usual = replace(table, quiet=None)
    quiet = replace(usual, first=table.quiet.first, later=table.quiet.later)
    if kernel_macros(quiet.first.rule) != kernel_macros(usual.first.rule):
        raise InputFileError("the quiet set decides classes by another formula than the table; train the table again")
    return usual, quiet


def quiet_pixels(frame: RawFrame, table: TransformTable) -> NDArray[np.uint8]:
    """1 where a pixel (row, col) of a frame is rendered by the quiet set of a table, else 0."""
    assert table.quiet is not None
    if frame.noise_left is None:
        return np.zeros(frame.values.shape, np.uint8)
    return frame.noise_left.quiet(table.quiet.limit, frame.values.shape)


def first_layer(sets: Sets) -> MosaicLayer:
    """The first layers, one behind the other; the rule is that of the usual one."""
    if len(sets) == 1:
        return sets[0].first
    names = ("weights", "intercept", "samples", "condition")
    return replace(sets[0].first, **_arrays(names, [table.first for table in sets]))


def later_layers(sets: Sets) -> tuple[PlaneLayer, ...]:
    """Each later layer of all sets, one behind the other; the rule is that of the usual one."""
    if len(sets) == 1:
        return sets[0].later
    names = ("weights", "intercept", "samples")
    layers = zip(*(table.later for table in sets), strict=True)
    return tuple(replace(parts[0], **_arrays(names, parts)) for parts in layers)


def later_rules(sets: Sets, number: int) -> tuple[PlaneRule, ...]:
    """The rule of later layer `number`, from 0, in each set."""
    return tuple(table.later[number].rule for table in sets)


def first_fixed_point(sets: Sets) -> FixedPoint:
    """The first layers as integers."""
    parts = [fixed_point(table) for table in sets]
    if len(parts) == 1:
        return parts[0]
    return FixedPoint(**_arrays(("weights", "intercept", "fraction"), parts))


def _arrays(names: tuple[str, ...], parts: Sequence[Any]) -> dict[str, Any]:
    """The arrays of all parts, one behind the other."""
    return {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
