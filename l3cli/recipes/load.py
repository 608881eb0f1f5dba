"""Read TOML recipes into instances of their classes."""

from pathlib import Path
from typing import TypeVar

from l3cli.errors import RecipeError
from l3cli.recipes.faults import typed
from l3cli.recipes.key_lines import key_lines, line_of
from l3cli.recipes.toml import KIND_KEYS, Recipe, parse_toml, read_text

R = TypeVar("R", bound=Recipe)


def load_recipe(path: Path, recipe: type[R]) -> R:
    """Read a recipe from a TOML file.

    Parameters
    ----------
    path : Path
        The file.
    recipe : type
        Class of the recipe.

    Returns
    -------
    Recipe
        An instance of `recipe`.

    Raises
    ------
    RecipeError
        If the file has a fault. The message contains the file, the line and the first fault.
    InputFileError
        If the file does not exist or is not UTF-8 text.
    """
    return parse_recipe(read_text(path, recipe.title), recipe, str(path))


def parse_recipe(text: str, recipe: type[R], name: str) -> R:
    """Convert the text of a TOML file to a recipe.

    Parameters
    ----------
    text : str
        Text of the file.
    recipe : type
        Class of the recipe.
    name : str
        Name of the file, for messages.

    Returns
    -------
    Recipe
        An instance of `recipe`.

    Raises
    ------
    RecipeError
        If the text has a fault, or if its keys belong to a different type of recipe.
    """
    content = parse_toml(text, name)
    given = {kind for kind, keys in KIND_KEYS.items() if any(key in content for key in keys)}
    if given and recipe.title in KIND_KEYS and recipe.title not in given:
        kinds = sorted(given)
        fault = f"is {kinds[0]}" if len(kinds) == 1 else f"contains keys of {' and of '.join(kinds)}"
        raise RecipeError(f"{name} {fault}; use {recipe.title}")
    found, faults = typed(content, recipe)
    if found is None or faults:
        message, (key, *_) = faults[0]
        raise RecipeError(f"{name}:{line_of(key, key_lines(text))}: {message}")
    return found
