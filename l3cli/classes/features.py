"""The features of a class rule, and the interface of their modules.

Every rule has level, contrast, saturation and chroma, on which training and kernels rely: levels borrow from neighbouring
levels, chromas have common parents, saturated classes are trained on greys, and a single loop compares levels and selects
contrast edges. Any number of further features may follow. A recipe switches a further feature on by a table with its
name.
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

    SNIPPET: str  # file with the formula, below opencl/

    @property
    def Options(self) -> type[Recipe]:
        """The type of the feature's recipe keys."""

    def entry(self, table: TransformTable, index: int) -> dict[str, Any]:
        """Return a description of value `index` for reports and JSON."""

    def heading(self, entry: dict[str, Any]) -> str:
        """Return such an entry as the first cell of a table row."""

    def name(self, table: TransformTable, index: int) -> str:
        """Return the name of value `index`."""


class BasicFeature(Feature, Protocol):
    """Interface of level, contrast, saturation and chroma."""

    def macros(self, rule: ClassRule) -> dict[str, int]:
        """Return the macros that the snippet is compiled with."""

    def kernel_array(self, rule: ClassRule) -> NDArray[Any]:
        """Return the constants that the snippet reads."""


class FurtherFeature(Feature, Protocol):
    """Interface of a feature that a recipe switches on.

    The feature is decided by integer sums over windows of the patch, by the level, and by constants that are chosen when
    the rule is made. Its snippet defines the function

        INLINE uints NAME_of(const ints *sum, uints level, __global const int *constants)

    which returns the same as `values`. Window sums are of v = DN >> shift, and their size is below 2²⁰.
    """

    def fits(self, camera: CameraModel, patch: int) -> bool:
        """Return whether patches of side `patch` are large enough for the feature on a camera's array.

        If they are not, rules leave the feature out.
        """

    def axis(
        self, keys: Any, camera: CameraModel, rule: ClassRule, dark: float, observed: NDArray[np.float64] | None
    ) -> Axis:
        """Return what a table stores of the feature.

        Parameters
        ----------
        keys
            The feature's table in the recipe.
        camera : CameraModel
        rule : ClassRule
            The rule so far, without this feature.
        dark : float
            Dark signal in DN that has been subtracted from frames.
        observed : ndarray, (patch, …), or None
            Statistics from the pilot; None before the pilot.

        Raises
        ------
        RecipeError
            If the keys are impossible.
        """

    def check(self, axis: Axis, rule: ClassRule) -> None:
        """Raise ValueError if the stored constants do not fit the formula, which could then read beyond their end."""

    def observe(self, axis: Axis, rule: ClassRule, sums: Integers, level: Integers) -> NDArray[np.float64]:
        """Return the statistics (patch, …) that `axis` takes from the patches of the pilot, without columns if it takes
        none.
        """

    def values(self, axis: Axis, rule: ClassRule, sums: Integers, level: Integers) -> Integers:
        """Return the value (…) of the feature from window sums (…, sum) at `level` (…)."""

    def with_less_noise(self, axis: Axis, share: float | NDArray[np.float64]) -> Axis:
        """Return the feature for frames with this fraction of the noise variance, in all or per level."""

    def turned(self, axis: Axis, transposed: bool, turns: int) -> Integers:
        """Return what each value becomes if a patch is replaced by rot90(patch.T if transposed else patch, turns)."""

    def macros(self, axis: Axis, rule: ClassRule) -> dict[str, int]:
        """Return the macros that the snippet is compiled with."""


# The order in which snippets are joined and arrays are passed to kernels.
BASIC: tuple[BasicFeature, ...] = (level, contrast, saturation, chroma)
FURTHER: Mapping[str, FurtherFeature] = {  # by the name of the recipe table that switches it on
    "direction": direction,
}


def feature_of(axis: Axis, rule: ClassRule) -> FurtherFeature:
    """Return the module of a further feature of a rule.

    Raises
    ------
    InputFileError
        If this version of l3 does not know the feature, or its constants do not fit.
    """
    feature = FURTHER.get(axis.name)
    if feature is None:
        raise InputFileError(f'the class rule has the feature "{axis.name}", which this l3 does not know; upgrade l3cli')
    try:
        feature.check(axis, rule)
    except ValueError as error:
        raise InputFileError(f"the class rule's {axis.name} is damaged: {error}; train the table again") from error
    return feature


def further_features(rule: ClassRule) -> tuple[tuple[FurtherFeature, Axis], ...]:
    """Return the module and the stored form of each further feature of a rule; InputFileError as in `feature_of`."""
    return tuple((feature_of(axis, rule), axis) for axis in rule.axes)
