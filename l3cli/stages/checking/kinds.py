"""The kinds of recipes, which of them a file is, and their schemas."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from l3cli.artifacts.camera_recipe import CameraRecipe, PhaseRecipe
from l3cli.classes import chroma, contrast, level, saturation
from l3cli.io.measurement_recipe import CorrectionRecipe, MeasurementRecipe
from l3cli.recipes.builtin import known_recipes
from l3cli.recipes.schema import output_schema, schema_of
from l3cli.recipes.toml import TELLING, Recipe
from l3cli.simulation.lab import LabRecipe
from l3cli.simulation.recipe import SceneRecipe
from l3cli.training.recipe import TrainingRecipe


class Kind(NamedTuple):
    """Kind of a recipe."""

    name: str
    recipes: tuple[type[Recipe], ...]  # the structures that it may have
    folder: str | None  # of configs/

    @property
    def title(self) -> str:
        return self.recipes[0].title

    def structure(self, content: Mapping[str, Any]) -> type[Recipe]:
        """Return the structure of a file of this kind."""
        return self.recipes[-1] if "base" in content else self.recipes[0]


CAMERA = "camera"
BASED = {"a camera recipe": ("base", "phase"), "a measurement file": ("dark", "white")}  # that tell a file with a base
KINDS = {
    kind.name: kind
    for kind in (
        Kind(CAMERA, (CameraRecipe, PhaseRecipe), "cameras"),
        Kind("lab", (LabRecipe,), "lab"),
        Kind("scenes", (SceneRecipe,), "scenes"),
        Kind("classes", (TrainingRecipe,), "classes"),
        Kind("measurements", (MeasurementRecipe, CorrectionRecipe), None),
    )
}
FEATURES = {"ClassRecipe": tuple(feature.Options for feature in (level, contrast, saturation, chroma))}
OUTPUT = "output"


def kind_of(content: Mapping[str, Any]) -> Kind | None:
    """Return the kind that has most of a file's keys and tables, those counting most that no other kind has; None where two
    have equally many."""
    ranked = sorted(KINDS.values(), key=lambda kind: _likeness(content, kind), reverse=True)
    best, second = (_likeness(content, kind) for kind in ranked[:2])
    return ranked[0] if best > second else None


def _likeness(content: Mapping[str, Any], kind: Kind) -> tuple[int, int]:
    based = BASED.get(kind.title, ()) if "base" in content or kind.name == CAMERA else ()
    telling = sum(key in content for key in (*TELLING[kind.title], *based))
    fields = {field.encode_name: field for field in msgspec.structs.fields(kind.structure(content))}
    return telling, sum(_fits(fields[key], value) for key, value in content.items() if key in fields)


def _fits(field: msgspec.structs.FieldInfo, value: Any) -> bool:
    """Return whether a table is where one belongs, and a list where one does."""
    try:
        msgspec.convert(value, field.type)
    except msgspec.ValidationError as error:
        return " - at " in str(error) or "missing" in str(error) or "unknown" in str(error)
    return True


def names() -> dict[str, list[tuple[Kind, Path]]]:
    """Return every recipe that comes with l3, by name: its kind and file; several kinds may have one of a name."""
    known: dict[str, list[tuple[Kind, Path]]] = {}
    for kind in KINDS.values():
        for name, path in (known_recipes(kind.folder) if kind.folder else {}).items():
            known.setdefault(name, []).append((kind, path))
    return known


def schema(kind: str) -> dict[str, Any]:
    """Return the JSON schema of a kind of recipe, or of the JSON that commands print (OUTPUT)."""
    return output_schema() if kind == OUTPUT else schema_of(KINDS[kind].recipes, KINDS[kind].title, FEATURES)
