"""Class recipes: what they refuse, and how many classes and bytes their tables have."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from l3cli.artifacts.class_rule import MAX_PATCH
from l3cli.artifacts.layers import RATIO_TAPS
from l3cli.artifacts.plane_rules import DIRECTIONS
from l3cli.classes import contrast, level
from l3cli.classes.rule import make_rule
from l3cli.recipes.faults import Fault, fault
from l3cli.stages.checking.source import Source
from l3cli.training.recipe import LayerRecipe, TrainingRecipe, layer_faults, learning_faults

OUTPUTS = 3  # of pictures, and planes that later layers read
WEIGHT, OTHERS = 4, 12  # bytes of a weight or intercept; of the number of samples and the condition of a class


def faults(recipe: TrainingRecipe, source: Source) -> Iterator[Fault]:
    """Yield all that is wrong with a recipe, for its camera if one is given."""
    yield from learning_faults(recipe.learning)
    yield from layer_faults(recipe.layer)
    classes = recipe.classes
    if classes.patch % 2 == 0 or not 1 <= classes.patch <= MAX_PATCH:
        yield fault(f"classes.patch is {classes.patch}, not an odd number up to {MAX_PATCH}", "classes.patch")
    yield from source.attempt(None, contrast.check_edges, classes)
    yield from source.attempt(None, level.edge_shares, classes)


def meaning(recipe: TrainingRecipe, source: Source) -> tuple[dict[str, Any], list[Fault]]:
    """Return the classes of each layer, those near saturation at their most, and the bytes of the table for a camera."""
    classes, camera = recipe.classes, source.camera
    levels, contrasts = level.edge_shares(classes).size + 1, len(classes.contrasts) + 1
    cases = classes.max_cases if camera is None else min(classes.max_cases, 2 ** len(camera.channels))
    further: dict[str, int] = {}
    if camera is not None:
        rule = make_rule(classes, camera, np.zeros(2 ** len(camera.channels), np.uint16))  # as the pilot has it
        further = {axis.name: axis.size for axis in rule.axes}
    chromas = max(1, classes.chromas)
    first = levels * contrasts * int(np.prod(list(further.values()), initial=1)) * (chromas + cases - 1)
    layers = [{"classes_per_site": first, "taps": classes.patch**2}]
    for each in recipe.layer:
        taps = OUTPUTS * each.side**2 + RATIO_TAPS * each.colour_ratios
        layers.append({"classes_per_site": _later(each, levels, cases), "taps": taps})
    document = {
        "levels": levels, "contrasts": contrasts, "further": further, "chromas": chromas, "saturation_cases": cases,
        "patch": classes.patch, "layers": layers, "patches": recipe.learning.patches,
        "per_light": recipe.learning.per_light,
    }  # fmt: skip
    if camera is not None:
        sites = camera.cfa.size
        size = sum(each["classes_per_site"] * (OUTPUTS * (each["taps"] + 1) * WEIGHT + OTHERS) for each in layers)
        sets = 2 if recipe.learning.noise_left else 1
        document |= {"camera": camera.name, "sites": sites, "table_bytes": sets * sites * size}
    return document, []


def _later(layer: LayerRecipe, levels: int, cases: int) -> int:
    """Return the classes a site of a later layer: leaves of a tree, or structures at every level."""
    if layer.leaves:
        return layer.leaves + cases - 1
    structures = 1 + len(layer.strengths) * (1 + DIRECTIONS)
    return -(-levels // layer.level_step) * (structures + cases - 1)
