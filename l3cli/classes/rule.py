"""Compute a camera's class rule from a class recipe. Each combination of feature values is a class."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import CLASS_BITS, MAX_PATCH, ClassRule, StoredFeatures
from l3cli.classes import chroma, contrast, level, saturation
from l3cli.classes.features import FEATURES, ClassRecipe
from l3cli.classes.windows import neighbourhoods, window_channels
from l3cli.errors import RecipeError


def switched_on(recipe: ClassRecipe) -> dict[str, Any]:
    """Return the recipe tables of the additional features that a class recipe enables, by feature name."""
    return {name: keys for name in FEATURES if (keys := getattr(recipe, name)) is not None}


def left_out(recipe: ClassRecipe, camera: CameraModel) -> list[str]:
    """Return the names of enabled features for which the patches are too small on this camera's CFA."""
    return [name for name in switched_on(recipe) if not FEATURES[name].fits(camera, recipe.patch)]


def make_rule(
    recipe: ClassRecipe,
    camera: CameraModel,
    case_of_code: NDArray[np.uint16],
    chroma_centres: NDArray[np.float64] | None = None,
    dark: float = 0.0,
    observed: Mapping[str, NDArray[np.float64]] | None = None,
    spared_cases: int = 0,
) -> ClassRule:
    """Compute a camera's class rule from a class recipe (docs/method.md#classes).

    Parameters
    ----------
    recipe : ClassRecipe
        Class recipe.
    camera : CameraModel
        The camera. Its black level, white level and noise determine the edges.
    case_of_code : ndarray, (code,)
        Saturation case of each saturation code. Bit c of a code is set if channel c clips.
    chroma_centres : ndarray, (chroma, channel), optional
        Channel fractions of each chroma centre. [default: the rule has only one chroma]
    dark : float
        Dark signal, in DN, that was subtracted from the frames.
    observed : mapping of str to ndarray, optional
        Statistics of the pilot patches from `decide.observe_patches`. None if there are no pilot patches yet.
    spared_cases : int
        Number of saturation cases from `saturation.spared_cases`.

    Raises
    ------
    RecipeError
        If the recipe does not suit this camera, for example because it has more levels than there are raw values.
    """
    if recipe.patch % 2 == 0 or not 1 <= recipe.patch <= MAX_PATCH:
        raise RecipeError(f"classes.patch is {recipe.patch}; write an odd number from 1 to {MAX_PATCH}")
    channels = len(camera.channels)
    neighbourhoods(camera.cfa, recipe.patch, channels)
    contrast.check_edges(recipe)
    reach = float(1 / camera.sensitivity.min())
    shares = level.edge_shares(recipe, reach)
    shift = max(0, camera.bits - CLASS_BITS)
    level_edges = level.stored_edges(shares, camera, shift)
    contrast_edges = contrast.stored_edges(recipe, level.centres(shares, reach), camera, shift, dark)
    try:
        rule = ClassRule(
            patch=recipe.patch,
            shift=shift,
            level_edges=level_edges,
            contrast_edges=contrast_edges,
            saturation=saturation.stored_threshold(recipe, camera),
            saturation_radius=_saturation_radius(recipe, camera),
            case_of_code=case_of_code,
            chroma_black_level=chroma.stored_black_level(camera, shift),
            chroma_weights=chroma.chroma_weights(
                np.full((1, channels), 1 / channels) if chroma_centres is None else chroma_centres
            ),
            chroma_dither=int(recipe.chroma_dither),
            spared_cases=spared_cases,
        )
        features = tuple(
            FEATURES[name].make_feature(keys, camera, rule, dark, None if observed is None else observed[name])
            for name, keys in switched_on(recipe).items()
            if FEATURES[name].fits(camera, recipe.patch)
        )
        return replace(rule, features=StoredFeatures.of(features)) if features else rule
    except ValueError as error:
        raise RecipeError(f"classes: {error}") from error


def _saturation_radius(recipe: ClassRecipe, camera: CameraModel) -> int:
    """Return the recipe's saturation radius, increased until the neighbourhood of every site contains every channel.

    With a smaller radius, the sites of a clipped area would have different saturation cases, and most of these cases would
    never be trained on clipped greys (docs/method.md#saturation-cases). The result is at most the radius of the patch. A
    radius of 0 is not increased.
    """
    most, least = recipe.patch // 2, min(recipe.saturation_radius, recipe.patch // 2)
    for radius in range(least, most if least else 0):
        seen = window_channels(camera.cfa, 2 * radius + 1)
        if all(np.unique(window).size == len(camera.channels) for window in seen):
            return radius
    return most if least else 0
