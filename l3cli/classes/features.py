"""The features of a class rule, and the interface of their modules.

Every rule has the basic features level, contrast, saturation and chroma. Training and kernels treat them individually: a
level borrows from neighbouring levels, chromas have common parents, saturated classes are trained on greys, and a single
loop compares levels and selects contrast edges. Any number of other features can be added. A recipe activates such a feature
with a table of its name (`ClassRecipe`).

An additional feature is implemented by a module with the functions of `FeatureModule`. A table of transforms stores it as a
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
    """Common interface of the modules of all features."""

    SNIPPET: str  # file with the formula, below opencl/

    def entry(self, table: TransformTable, index: int) -> dict[str, Any]:
        """Return a description of the value with number `index`, for reports and JSON."""

    def heading(self, entry: dict[str, Any]) -> str:
        """Return a result of `entry` as the first cell of a table row."""

    def name(self, table: TransformTable, index: int) -> str:
        """Return the name of the value with number `index`."""


class BasicFeatureModule(DescribedFeature, Protocol):
    """Interface of the modules of level, contrast, saturation and chroma."""

    def macros(self, rule: ClassRule) -> dict[str, int]:
        """Return the macros that the snippet is compiled with."""

    def kernel_array(self, rule: ClassRule) -> NDArray[Any]:
        """Return the constants that the snippet reads."""


class FeatureModule(DescribedFeature, Protocol):
    """Interface of the module of an additional feature, which a recipe activates.

    The value of the feature depends on integer sums over windows of the patch, on the level, and on constants that are
    computed when the rule is made. The snippet defines the function

        INLINE uints NAME_of(const ints *sum, uints level, __global const int *constants)

    which returns the same as `values`. Window sums are sums of v = DN >> shift. Their absolute values are below 2²⁰.
    """

    def fits(self, camera: CameraModel, patch: int) -> bool:
        """Return whether patches with side `patch` are large enough for the feature on a camera's CFA.

        If they are not, rules are made without the feature.
        """

    def make_feature(
        self, keys: Any, camera: CameraModel, rule: ClassRule, dark: float, observed: NDArray[np.float64] | None
    ) -> Feature:
        """Return the feature as stored in a table of transforms.

        Parameters
        ----------
        keys
            Keys of the feature in the recipe.
        camera : CameraModel
            The camera.
        rule : ClassRule
            The rule without this feature.
        dark : float
            Dark signal, in DN, that was subtracted from frames.
        observed : ndarray, (patch, …), or None
            Statistics from the pilot, or None before the pilot.

        Raises
        ------
        RecipeError
            If the keys are impossible.
        """

    def check(self, feature: Feature, rule: ClassRule) -> None:
        """Raise ValueError if the number or range of the stored constants does not suit the formula."""

    def observe(self, feature: Feature, rule: ClassRule, sums: Integers, level: Integers) -> NDArray[np.float64]:
        """Return the statistics (patch, …) of the pilot's patches that `make_feature` needs. They may have no columns."""

    def values(self, feature: Feature, rule: ClassRule, sums: Integers, level: Integers) -> Integers:
        """Return the value (…) of the feature, given window sums (…, sum) and `level` (…)."""

    def with_less_noise(self, feature: Feature, noise_fraction: float | NDArray[np.float64]) -> Feature:
        """Return the feature for frames in which only the given fraction of the noise variance is left.

        `noise_fraction` is one number, or one number for each signal level of the class rule.
        """

    def turned(self, feature: Feature, transposed: bool, turns: int) -> Integers:
        """Return the new value for each value if a patch is replaced by rot90(patch.T if transposed else patch, turns)."""

    def macros(self, feature: Feature, rule: ClassRule) -> dict[str, int]:
        """Return the macros that the snippet is compiled with."""


# The order in which snippets are joined and arrays are passed to kernels.
BASIC: tuple[BasicFeatureModule, ...] = (level, contrast, saturation, chroma)
FEATURES: Mapping[str, FeatureModule] = {  # name of the recipe table that activates a feature → its module
    "direction": direction,
}


class ClassRecipe(BasicKeys):
    """Recipe of the classes into which pixels are sorted (configs/classes). A table activates the feature of its name."""

    direction: DirectionKeys | None = None


def module_of(feature: Feature, rule: ClassRule) -> FeatureModule:
    """Return the module of one of a rule's additional features.

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
    """Return the additional features of a rule with their modules. Raises InputFileError like `module_of`."""
    return tuple((module_of(feature, rule), feature) for feature in rule.feature_list)
