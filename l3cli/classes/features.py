"""The features of a class rule, and the interface of their modules.

Every class rule has the basic features level, contrast, saturation and chroma. Training and the kernels contain special
code for these four. For example, a level with few patches also uses the patches of neighbouring levels, and saturated
classes are trained on greys.

A recipe can add any number of other features. To add a feature, the recipe contains a table with the name of the feature
(`ClassRecipe`). A module with the functions of `FeatureModule` implements the feature. A transform table stores it as a
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
    """Functions that the modules of all features have."""

    SNIPPET: str  # file with the formula, below opencl/

    def entry(self, table: TransformTable, index: int) -> dict[str, Any]:
        """Describe one value of the feature for reports and JSON. `index` is the number of the value."""

    def heading(self, entry: dict[str, Any]) -> str:
        """Return the label of a value in the first column of a table. `entry` is a result of the function `entry`."""

    def name(self, table: TransformTable, index: int) -> str:
        """Return the name of one value of the feature. `index` is the number of the value."""


class BasicFeatureModule(DescribedFeature, Protocol):
    """Interface of the modules level, contrast, saturation and chroma."""

    def macros(self, rule: ClassRule) -> dict[str, int]:
        """Return the macros for compiling the OpenCL snippet of the feature."""

    def kernel_array(self, rule: ClassRule) -> NDArray[Any]:
        """Return the constants that the OpenCL snippet of the feature reads."""


class FeatureModule(DescribedFeature, Protocol):
    """Interface of the module of an additional feature, which a class recipe enables.

    The value of the feature depends on integer sums over windows of the patch, on the level, and on constants. The
    constants are computed when the class rule is made. Window sums are sums of DN >> shift, and their absolute values
    are below 2²⁰. The OpenCL snippet defines the function

        INLINE uints NAME_of(const ints *sum, uints level, __global const int *constants)

    which must return the same results as `values`.
    """

    def fits(self, camera: CameraModel, patch: int) -> bool:
        """Return whether patches of this size are large enough for the feature on the CFA of the camera.

        If they are too small, the class rule does not contain the feature. `patch` is the side of the patches in pixels.
        """

    def make_feature(
        self, keys: Any, camera: CameraModel, rule: ClassRule, dark: float, observed: NDArray[np.float64] | None
    ) -> Feature:
        """Compute the windows and constants of the feature for a camera.

        Parameters
        ----------
        keys
            Keys of the feature in the recipe.
        camera : CameraModel
            The camera.
        rule : ClassRule
            The class rule without this feature.
        dark : float
            Dark signal, in DN, that was subtracted from the frames.
        observed : ndarray, (patch, …), or None
            Statistics of the pilot patches, or None if there are no pilot patches yet.

        Raises
        ------
        RecipeError
            If the keys are impossible.
        """

    def check(self, feature: Feature, rule: ClassRule) -> None:
        """Raise ValueError if the number or the range of the stored constants does not fit the formula of the feature."""

    def observe(self, feature: Feature, rule: ClassRule, sums: Integers, level: Integers) -> NDArray[np.float64]:
        """Return the statistics of the pilot patches that `make_feature` needs, with one row per patch.

        If the feature needs no statistics, the result has no columns.
        """

    def values(self, feature: Feature, rule: ClassRule, sums: Integers, level: Integers) -> Integers:
        """Return the value of the feature for each pixel.

        Parameters
        ----------
        feature : Feature
            The stored feature.
        rule : ClassRule
            The class rule.
        sums : ndarray, (…, sum)
            Window sums of the feature.
        level : ndarray, (…)
            Level of each pixel.
        """

    def with_less_noise(self, feature: Feature, noise_fraction: float | NDArray[np.float64]) -> Feature:
        """Adapt the feature to frames with less noise than the camera.

        `noise_fraction` is the remaining fraction of the noise variance. It is a single number or one number per level.
        """

    def turned(self, feature: Feature, transposed: bool, turns: int) -> Integers:
        """Return what each value of the feature becomes if the patch is turned.

        The turned patch is rot90(patch.T if transposed else patch, turns).
        """

    def macros(self, feature: Feature, rule: ClassRule) -> dict[str, int]:
        """Return the macros for compiling the OpenCL snippet of the feature."""


# Snippets are joined, and arrays are passed to kernels, in this order.
BASIC: tuple[BasicFeatureModule, ...] = (level, contrast, saturation, chroma)
# The module of each additional feature, by the name of the recipe table that enables the feature.
FEATURES: Mapping[str, FeatureModule] = {
    "direction": direction,
}


class ClassRecipe(BasicKeys):
    """The section [classes] of a class recipe. Each table below it enables the additional feature of the same name."""

    direction: DirectionKeys | None = None


def module_of(feature: Feature, rule: ClassRule) -> FeatureModule:
    """Return the module of an additional feature of a class rule.

    Raises
    ------
    InputFileError
        If this version of l3 does not support the feature, or if the stored constants do not fit its formula.
    """
    module = FEATURES.get(feature.name)
    if module is None:
        raise InputFileError(
            f'the class rule contains the feature "{feature.name}", which this version of l3 does not support; upgrade l3cli'
        )
    try:
        module.check(feature, rule)
    except ValueError as error:
        raise InputFileError(
            f'the feature "{feature.name}" of the class rule is damaged ({error}); train the table again'
        ) from error
    return module


def features_of(rule: ClassRule) -> tuple[tuple[FeatureModule, Feature], ...]:
    """Return the additional features of a class rule with their modules. Raises InputFileError like `module_of`."""
    return tuple((module_of(feature, rule), feature) for feature in rule.feature_list)
