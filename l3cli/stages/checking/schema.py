"""The JSON schema of each kind of recipe, and of what commands print."""

from typing import Any

from l3cli.classes import chroma, contrast, level, saturation
from l3cli.recipe_schema import schema_of
from l3cli.stages.checking.kinds import KINDS
from l3cli.stages.checking.output_schema import output_schema

OUTPUT = "output"
OF_FEATURES = {"ClassRecipe": tuple(feature.Keys for feature in (level, contrast, saturation, chroma))}


def schema(kind: str) -> dict[str, Any]:
    """The schema of a kind (KINDS) of recipe, or of what commands print ("output")."""
    if kind == OUTPUT:
        return output_schema()
    return schema_of(KINDS[kind].recipes, KINDS[kind].title, OF_FEATURES)
