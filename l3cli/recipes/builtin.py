"""The recipes that come with l3, by name: configs/ of a checkout or of an installed wheel."""

import os
from pathlib import Path

from l3cli.errors import InputFileError, RecipeError, suggestion

KINDS = {
    "cameras": "camera",
    "lab": "lab",
    "scenes": "scene",
    "classes": "class",
}  # folders of configs/: what they hold


def recipe_folder() -> Path:
    """Return the folder of the recipes that come with l3: inside the installed package, or beside it in a checkout."""
    package = Path(__file__).parents[1]
    inside = package / "configs"
    return inside if inside.is_dir() else package.parent / "configs"


def known_benchmarks() -> dict[str, Path]:
    """Return the folders of recipes of a whole benchmark that come with l3, by name."""
    return {f"benchmark-{path.name}": path for path in sorted((recipe_folder() / "benchmarks").iterdir()) if path.is_dir()}


def known_recipes(kind: str) -> dict[str, Path]:
    """Return the recipes of a kind (KINDS) that come with l3, by name."""
    return {path.stem: path for path in sorted((recipe_folder() / kind).glob("*.toml"))}


def find_recipe(text: str, kind: str) -> Path:
    """Return the file that `text` names or, where there is none, the recipe of that name that comes with l3.

    RecipeError for a name that is neither's, InputFileError for a missing file that is called like such a recipe; a path to
    anything else is left to whoever opens it.
    """
    if os.path.isfile(text):
        return Path(text)
    known, path = known_recipes(kind), Path(text)
    if text in known:
        return known[text]
    if os.path.exists(text):
        return path
    if os.sep not in text and not path.suffix:
        raise RecipeError(f'there is no file and no {KINDS[kind]} recipe "{text}"; {suggestion(text, known)}')
    if path.suffix == ".toml" and path.stem in known:
        raise InputFileError(f'{text} does not exist; without a path "{path.stem}" is the recipe that comes with l3')
    return path
