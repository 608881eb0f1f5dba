"""From a recipe to a camera's class rule: the ordered product of the features."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import CLASS_BITS, MAX_PATCH, ClassRule
from l3cli.artifacts.table import TransformTable
from l3cli.classes import chroma, contrast, level, saturation
from l3cli.classes.recipe import ClassRecipe
from l3cli.classes.windows import neighbourhoods
from l3cli.errors import RecipeError


class Feature(Protocol):
    """What the module of a feature has, beside its formula."""

    SNIPPET: str  # file of opencl/ with its formula; rule.cl joins them

    def macros(self, rule: ClassRule) -> dict[str, int]:
        """What the snippet is compiled with."""

    def kernel_array(self, rule: ClassRule) -> NDArray[Any]:
        """The constants that the snippet reads."""

    def entry(self, table: TransformTable, index: int) -> dict[str, Any]:
        """Its value number `index` in documents."""

    def heading(self, entry: dict[str, Any]) -> str:
        """Such an entry as a row of a table begins."""

    def name(self, table: TransformTable, index: int) -> str:
        """Its value number `index` in text."""


FEATURES: tuple[Feature, ...] = (
    level,
    contrast,
    saturation,
    chroma,
)  # in this order their snippets are joined and their arrays handed on


def make_rule(
    recipe: ClassRecipe,
    camera: CameraModel,
    case_of_code: NDArray[np.uint16],
    chroma_centres: NDArray[np.float64] | None = None,
    dark: float = 0.0,
) -> ClassRule:
    """The integer rule for a camera: edges in DN, contrast edges from its noise model (docs/method.md#classes).
    It is for frames of which `dark` DN of dark current have been taken off.

    `chroma_centres` (chroma, channel) are shares of the channel means in their sum; without them there is one chroma.
    RecipeError if the recipe asks for what the camera cannot give, such as more levels than values.
    """
    if recipe.patch % 2 == 0 or not 1 <= recipe.patch <= MAX_PATCH:
        raise RecipeError(f"classes.patch is {recipe.patch}, not an odd number up to {MAX_PATCH}")
    channels = len(camera.channels)
    neighbourhoods(camera.cfa, recipe.patch, channels)
    contrast.check_edges(recipe)
    shares = level.edge_shares(recipe)
    shift = max(0, camera.bits - CLASS_BITS)
    level_edges = level.stored_edges(shares, camera, shift)
    contrast_edges = contrast.stored_edges(recipe, level.centres(shares), camera, shift, dark)
    try:
        return ClassRule(
            patch=recipe.patch,
            shift=shift,
            level_edges=level_edges,
            contrast_edges=contrast_edges,
            saturation=saturation.stored_threshold(recipe, camera),
            saturation_radius=min(recipe.saturation_radius, recipe.patch // 2),
            case_of_code=case_of_code,
            chroma_black=chroma.stored_black(camera, shift),
            chroma_weights=chroma.chroma_weights(
                np.full((1, channels), 1 / channels) if chroma_centres is None else chroma_centres
            ),
        )
    except ValueError as error:
        raise RecipeError(f"classes: {error}") from error


def kernel_macros(rule: ClassRule) -> dict[str, int]:
    """What the snippets of the features, and rule.cl which joins them, are compiled with."""
    return {key: value for feature in FEATURES for key, value in feature.macros(rule).items()} | {"KINDS": rule.kinds}


def kernel_arrays(rule: ClassRule) -> tuple[NDArray, ...]:
    """The constants of the features, in the order in which kernels take them."""
    return tuple(feature.kernel_array(rule) for feature in FEATURES)
