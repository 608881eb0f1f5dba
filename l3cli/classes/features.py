"""The features of a class rule, and what the module of each has to have.

Every rule has level, contrast, saturation and chroma, in which training and kernels are steeped: levels help one another,
chromas share parents, saturated classes learn greys, and one loop compares levels and picks contrast edges. Any number of
further features may follow, each of them switched on by a table of its name in a recipe.
"""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import Axis, ClassRule
from l3cli.artifacts.table import TransformTable
from l3cli.classes import chroma, contrast, direction, level, saturation
from l3cli.classes.windows import Integers
from l3cli.errors import InputFileError
from l3cli.recipes.toml import Recipe


class Feature(Protocol):
    """Interface of a feature's module."""

    SNIPPET: str  # file of opencl/ with its formula

    @property
    def Options(self) -> type[Recipe]:
        """Return the type of the feature's keys in a recipe."""

    def entry(self, table: TransformTable, index: int) -> dict[str, Any]:
        """Return its value number `index` in documents."""

    def heading(self, entry: dict[str, Any]) -> str:
        """Return such an entry as a row of a table begins."""

    def name(self, table: TransformTable, index: int) -> str:
        """Return its value number `index` in text."""


class BasicFeature(Feature, Protocol):
    """Level, contrast, saturation and chroma."""

    def macros(self, rule: ClassRule) -> dict[str, int]:
        """Return the macros that the snippet is compiled with."""

    def kernel_array(self, rule: ClassRule) -> NDArray[Any]:
        """Return the constants that the snippet reads."""


class FurtherFeature(Feature, Protocol):
    """A feature that a recipe switches on.

    It decides by integer sums over windows of the patch, by the level, and by constants that it has chosen when the rule was
    made. Its snippet has the function

        INLINE uints NAME_of(const ints *sum, uints level, __global const int *constants)

    which gives what `values` gives. Window sums are of v = DN >> shift, below 2²⁰ in size.
    """

    def fits(self, camera: CameraModel, patch: int) -> bool:
        """Return whether patches of side `patch` are large enough to see the feature on a camera's array; else rules do
        without it."""

    def axis(
        self, keys: Any, camera: CameraModel, rule: ClassRule, dark: float, observed: NDArray[np.float64] | None
    ) -> Axis:
        """Return what a table stores of the feature, from its `keys` in the recipe, next to the features of `rule`, for
        frames from which `dark` DN of dark current have been subtracted. `observed` (patch, …) comes from the pilot; None
        before it. Raise RecipeError if the keys are impossible."""

    def check(self, axis: Axis, rule: ClassRule) -> None:
        """Raise ValueError if an axis that has been read does not fit its formula, which could then read past its
        constants."""

    def observe(self, axis: Axis, rule: ClassRule, sums: Integers, level: Integers) -> NDArray[np.float64]:
        """Return the statistics (patch, …) that `axis` takes from the patches of the pilot; no columns if it takes none."""

    def values(self, axis: Axis, rule: ClassRule, sums: Integers, level: Integers) -> Integers:
        """Return its value (…) from window sums (…, sum) at `level` (…)."""

    def with_less_noise(self, axis: Axis, share: float | NDArray[np.float64]) -> Axis:
        """Return the same for frames with this share of the camera's noise variance, or that of each level."""

    def turned(self, axis: Axis, transposed: bool, turns: int) -> Integers:
        """Return the value that each value (value) becomes when a patch is replaced by rot90(patch.T if transposed else
        patch, turns)."""

    def macros(self, axis: Axis, rule: ClassRule) -> dict[str, int]:
        """Return the macros that the snippet is compiled with."""


# In this order their snippets are joined and their arrays handed on.
BASIC: tuple[BasicFeature, ...] = (level, contrast, saturation, chroma)
FURTHER: Mapping[str, FurtherFeature] = {  # by the table of a recipe that switches it on
    "direction": direction,
}


def feature_of(axis: Axis, rule: ClassRule) -> FurtherFeature:
    """Return the module of a further feature of a rule. InputFileError if this l3 does not know it, or its constants do not
    fit."""
    feature = FURTHER.get(axis.name)
    if feature is None:
        raise InputFileError(f'the class rule has the feature "{axis.name}", which this l3 does not know; upgrade l3cli')
    try:
        feature.check(axis, rule)
    except ValueError as error:
        raise InputFileError(f"the class rule's {axis.name} is damaged: {error}; train the table again") from error
    return feature


def further_features(rule: ClassRule) -> tuple[tuple[FurtherFeature, Axis], ...]:
    """Return the further features of a rule in order; InputFileError as `feature_of`."""
    return tuple((feature_of(axis, rule), axis) for axis in rule.axes)
