"""The features of a class rule, and the interfaces of the modules that implement them.

Every class rule has the basic features level, contrast, saturation and chroma. Training and the kernels contain special code
for these four. For example, a class with few patches also uses the sums of neighbouring levels, and classes with clipped
channels are trained on greys.

A class recipe enables an additional feature with a table of the same name (`ClassRecipe`). The feature's module contains the
functions of `FeatureModule`. A `class_rule.Feature` stores the feature's windows and constants. The functions receive it as
the parameter `feature`.
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
    """Interface of every feature's module."""

    SNIPPET: str  # OpenCL file with the feature's formula, relative to opencl/

    def entry(self, table: TransformTable, index: int) -> dict[str, Any]:
        """Describe the feature value `index` for reports and JSON."""

    def heading(self, entry: dict[str, Any]) -> str:
        """Return a row label for a feature value, given the result of the function `entry`."""

    def name(self, table: TransformTable, index: int) -> str:
        """Return the name of the feature value `index`."""


class BasicFeatureModule(DescribedFeature, Protocol):
    """Interface of a basic feature's module."""

    def macros(self, rule: ClassRule) -> dict[str, int]:
        """Return the compiler macros for the feature's OpenCL snippet."""

    def kernel_array(self, rule: ClassRule) -> NDArray[Any]:
        """Return the constants for the feature's OpenCL snippet."""


class FeatureModule(DescribedFeature, Protocol):
    """Interface of an additional feature's module. A class recipe can enable the feature.

    A feature value is computed from integer sums over windows of the patch, the pixel's level, and constants. The constants
    are computed together with the class rule. Window sums are sums of DN >> shift. Their absolute values are below 2²⁰.
    The OpenCL snippet defines the function

        INLINE uints NAME_of(const ints *sum, uints level, __global const int *constants)

    which must return the same results as `values`.
    """

    def fits(self, camera: CameraModel, patch: int) -> bool:
        """Whether patches of `patch` × `patch` pixels are large enough for the feature on the camera's CFA.

        If they are too small, the class rule omits the feature even if the recipe enables it.
        """

    def make_feature(
        self, keys: Any, camera: CameraModel, rule: ClassRule, dark: float, observed: NDArray[np.float64] | None
    ) -> Feature:
        """Compute the feature's windows and constants for a camera.

        Parameters
        ----------
        keys
            The feature's table in the class recipe.
        camera : CameraModel
            The camera.
        rule : ClassRule
            The class rule without this feature.
        dark : float
            Dark signal, in DN, that was subtracted from the frames.
        observed : ndarray, (patch, …), or None
            Result of `observe` for the pilot patches, or None if there are no pilot patches yet.

        Raises
        ------
        RecipeError
            If a key has an impossible value.
        """

    def check(self, feature: Feature, rule: ClassRule) -> None:
        """Raise ValueError if the number of stored constants is wrong, or if a constant is out of range."""

    def observe(self, feature: Feature, rule: ClassRule, sums: Integers, level: Integers) -> NDArray[np.float64]:
        """Measure the statistics of pilot patches from which `make_feature` computes the constants: (patch, …).

        The parameters are the same as for `values`. If the feature needs no statistics, the result has no columns.
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
        """Adapt the feature's constants to frames with less noise than single frames of the camera.

        `noise_fraction` is the remaining fraction of the noise variance: one number, or one number per level.
        """

    def turned(self, feature: Feature, transposed: bool, turns: int) -> Integers:
        """Return each value's equivalent in the turned patch, rot90(patch.T if transposed else patch, turns)."""

    def macros(self, feature: Feature, rule: ClassRule) -> dict[str, int]:
        """Return the compiler macros for the feature's OpenCL snippet."""


# Kernels include the snippets, and receive the arrays, in this order.
BASIC: tuple[BasicFeatureModule, ...] = (level, contrast, saturation, chroma)
# Modules of additional features, by the name of the recipe table that enables the feature.
FEATURES: Mapping[str, FeatureModule] = {
    "direction": direction,
}


class ClassRecipe(BasicKeys):
    """Section [classes] of a class recipe. Each table [classes.NAME] enables the additional feature NAME."""

    direction: DirectionKeys | None = None


def module_of(feature: Feature, rule: ClassRule) -> FeatureModule:
    """Return the module of an additional feature of a class rule.

    Raises
    ------
    InputFileError
        If this version of l3 does not support the feature, or if its stored constants are invalid.
    """
    module = FEATURES.get(feature.name)
    if module is None:
        raise InputFileError(
            f'the table uses the feature "{feature.name}", which this version of l3 does not support; upgrade l3cli'
        )
    try:
        module.check(feature, rule)
    except ValueError as error:
        raise InputFileError(
            f'the stored feature "{feature.name}" is invalid, because {error}; train the table again'
        ) from error
    return module


def features_of(rule: ClassRule) -> tuple[tuple[FeatureModule, Feature], ...]:
    """Return the module and the stored definition of each additional feature.

    Raises InputFileError under the same conditions as `module_of`.
    """
    return tuple((module_of(feature, rule), feature) for feature in rule.feature_list)
