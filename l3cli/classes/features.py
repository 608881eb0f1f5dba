"""The features of a class rule, and the interface of their modules.

Every rule has the basic features level, contrast, saturation and chroma, on which training and kernels rely: levels borrow
from neighbouring levels, chromas have common parents, saturated classes are trained on greys, and a single loop compares
levels and selects contrast edges. Any number of other features may follow. A recipe switches such a feature on by a table
with its name (`ClassRecipe`).

A module with the functions of `FeatureModule` says how such a feature is decided. What a table stores of the feature is a
`class_rule.Feature`, which the functions receive as `feature`.
"""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule, Feature
from l3cli.artifacts.table import TransformTable
from l3cli.classes import chroma, contrast, direction, level, saturation
from l3cli.classes.direction import DirectionKeys
from l3cli.classes.keys import BasicKeys
from l3cli.classes.windows import Integers
from l3cli.errors import InputFileError


class DescribedFeature(Protocol):
    """What the module of every feature has."""

    SNIPPET: str  # file with the formula, below opencl/

    def entry(self, table: TransformTable, index: int) -> dict[str, Any]:
        """Return a description of value `index` for reports and JSON."""

    def heading(self, entry: dict[str, Any]) -> str:
        """Return such an entry as the first cell of a table row."""

    def name(self, table: TransformTable, index: int) -> str:
        """Return the name of value `index`."""


class BasicFeatureModule(DescribedFeature, Protocol):
    """Interface of the modules of level, contrast, saturation and chroma."""

    def macros(self, rule: ClassRule) -> dict[str, int]:
        """Return the macros that the snippet is compiled with."""

    def kernel_array(self, rule: ClassRule) -> NDArray[Any]:
        """Return the constants that the snippet reads."""


class FeatureModule(DescribedFeature, Protocol):
    """Interface of the module of a feature that a recipe switches on.

    The feature is decided by integer sums over windows of the patch, by the level, and by constants that are chosen when
    the rule is made. Its snippet defines the function

        INLINE uints NAME_of(const ints *sum, uints level, __global const int *constants)

    which returns the same as `values`. Window sums are of v = DN >> shift, and their size is below 2²⁰.
    """

    def fits(self, camera: CameraModel, patch: int) -> bool:
        """Return whether patches of side `patch` are large enough for the feature on a camera's array.

        If they are not, rules leave the feature out.
        """

    def make_feature(
        self, keys: Any, camera: CameraModel, rule: ClassRule, dark: float, observed: NDArray[np.float64] | None
    ) -> Feature:
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

    def check(self, feature: Feature, rule: ClassRule) -> None:
        """Raise ValueError if the stored constants do not fit the formula, which could then read beyond their end."""

    def observe(self, feature: Feature, rule: ClassRule, sums: Integers, level: Integers) -> NDArray[np.float64]:
        """Return the statistics (patch, …) that the feature takes from the patches of the pilot, without columns if it takes
        none.
        """

    def values(self, feature: Feature, rule: ClassRule, sums: Integers, level: Integers) -> Integers:
        """Return the value (…) of the feature from window sums (…, sum) at `level` (…)."""

    def with_less_noise(self, feature: Feature, noise_fraction: float | NDArray[np.float64]) -> Feature:
        """Return the feature for frames with this fraction of the noise variance, in all or per level."""

    def turned(self, feature: Feature, transposed: bool, turns: int) -> Integers:
        """Return what each value becomes if a patch is replaced by rot90(patch.T if transposed else patch, turns)."""

    def macros(self, feature: Feature, rule: ClassRule) -> dict[str, int]:
        """Return the macros that the snippet is compiled with."""


# The order in which snippets are joined and arrays are passed to kernels.
BASIC: tuple[BasicFeatureModule, ...] = (level, contrast, saturation, chroma)
FEATURES: Mapping[str, FeatureModule] = {  # by the name of the recipe table that switches it on
    "direction": direction,
}


class ClassRecipe(BasicKeys):
    """Recipe of the classes that pixels are sorted into (configs/classes). A table switches the feature of its name on."""

    direction: DirectionKeys | None = None


def module_of(feature: Feature, rule: ClassRule) -> FeatureModule:
    """Return the module of a feature of a rule.

    Raises
    ------
    InputFileError
        If this version of l3 does not know the feature, or its constants do not fit.
    """
    module = FEATURES.get(feature.name)
    if module is None:
        raise InputFileError(f'the class rule has the feature "{feature.name}", which this l3 does not know; upgrade l3cli')
    try:
        module.check(feature, rule)
    except ValueError as error:
        raise InputFileError(f"the class rule's {feature.name} is damaged: {error}; train the table again") from error
    return module


def features_of(rule: ClassRule) -> tuple[tuple[FeatureModule, Feature], ...]:
    """Return each feature that the recipe added to a rule, with its module; InputFileError as in `module_of`."""
    return tuple((module_of(feature, rule), feature) for feature in rule.feature_list)
