"""The features of a class rule, and the interface of the modules that implement them.

Every class rule has the basic features level, contrast, saturation and chroma. Training and the kernels contain special code
for these four. For example, a level with few patches also uses the patches of neighbouring levels, and classes with clipped
channels are trained on greys.

A class recipe enables an additional feature with a table that has the name of the feature (`ClassRecipe`). The module of the
feature contains the functions of `FeatureModule`. The windows and constants of the feature are stored as a
`class_rule.Feature`, which these functions receive as the parameter `feature`.
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
    """The functions that the module of every feature contains."""

    SNIPPET: str  # OpenCL file with the formula of the feature, relative to opencl/

    def entry(self, table: TransformTable, index: int) -> dict[str, Any]:
        """Describe the value `index` of the feature for reports and JSON."""

    def heading(self, entry: dict[str, Any]) -> str:
        """Return the label of a value for the first column of a report. `entry` is the result of the function `entry`."""

    def name(self, table: TransformTable, index: int) -> str:
        """Return the name of the value `index` of the feature."""


class BasicFeatureModule(DescribedFeature, Protocol):
    """Additional functions of the modules level, contrast, saturation and chroma."""

    def macros(self, rule: ClassRule) -> dict[str, int]:
        """Return the compiler macros for the OpenCL snippet of the feature."""

    def kernel_array(self, rule: ClassRule) -> NDArray[Any]:
        """Return the constants that the OpenCL snippet of the feature reads."""


class FeatureModule(DescribedFeature, Protocol):
    """The functions in the module of an additional feature, which a class recipe can enable.

    The value of the feature is computed from three inputs: integer sums over windows of the patch, the level of the pixel,
    and constants. The constants are computed together with the class rule. Window sums are sums of DN >> shift, and their
    absolute values are below 2²⁰. The OpenCL snippet defines the function

        INLINE uints NAME_of(const ints *sum, uints level, __global const int *constants)

    which must return the same results as `values`.
    """

    def fits(self, camera: CameraModel, patch: int) -> bool:
        """Return whether patches of `patch` × `patch` pixels are large enough for the feature on the camera's CFA.

        If the patches are too small, the class rule does not contain the feature, although the recipe enables it.
        """

    def make_feature(
        self, keys: Any, camera: CameraModel, rule: ClassRule, dark: float, observed: NDArray[np.float64] | None
    ) -> Feature:
        """Compute the windows and constants of the feature for a camera.

        Parameters
        ----------
        keys
            Keys of the feature in the class recipe.
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
        """Return statistics of pilot patches, one row per patch, from which `make_feature` computes the constants.

        The parameters are the same as in `values`. If the feature needs no statistics, the result has no columns.
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
        """Return the feature for frames with less noise than single frames of the camera.

        `noise_fraction` is the fraction of the noise variance that remains: one number, or one number per level.
        """

    def turned(self, feature: Feature, transposed: bool, turns: int) -> Integers:
        """Map each feature value of a patch to the value of the turned patch, rot90(patch.T if transposed else patch,
        turns)."""

    def macros(self, feature: Feature, rule: ClassRule) -> dict[str, int]:
        """Return the compiler macros for the OpenCL snippet of the feature."""


# Kernels include the snippets in this order, and receive the arrays in this order.
BASIC: tuple[BasicFeatureModule, ...] = (level, contrast, saturation, chroma)
# module of each additional feature, by the name of the recipe table that enables the feature
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
        If this version of l3 does not support the feature, or if the stored constants do not fit its formula.
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
