"""Lab recipes: what they refuse, and how many frames they ask for."""

from collections import Counter
from collections.abc import Iterator
from typing import Any

from l3cli.recipes.faults import Fault
from l3cli.recipes.toml import KeyPath
from l3cli.simulation.lab import plan
from l3cli.simulation.lab_recipe import LabRecipe, lab_faults
from l3cli.stages.checking.scenes import named_light
from l3cli.stages.checking.source import Source


def faults(recipe: LabRecipe, source: Source) -> Iterator[Fault]:
    """Yield all that is wrong with a recipe, for its camera if one is given."""
    yield from lab_faults(recipe, source.camera)
    lights: list[tuple[KeyPath, str]] = [(("white", "illuminant"), recipe.white.illuminant)]
    lights += [(("chart", "illuminants", number), name) for number, name in enumerate(recipe.chart.illuminants)]
    for key, name in lights:
        yield from source.attempt(key, named_light, name)


def meaning(recipe: LabRecipe, source: Source) -> tuple[dict[str, Any], list[Fault]]:
    """Return captures and frames of each kind."""
    if source.camera is None:
        return {}, []
    captures = plan(source.camera, recipe, 0)
    frames = sum(capture.trials for capture in captures)
    return {
        "camera": source.camera.name,
        "captures": dict(Counter(capture.kind for capture in captures)),
        "frames": frames,
        "bytes": frames * source.camera.rows * source.camera.cols * 2,
    }, []
