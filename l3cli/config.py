"""TOML recipes → typed structures: every key is declared, units stand in the keys' names, unknown keys are refused."""

import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec

from l3cli.errors import InputFileError, RecipeError
from l3cli.limits import read_bounded

LARGEST = 1e24  # of any number in a recipe: beyond lies what no lamp gives and floats run over at
MOST = 1_000_000  # of anything that can be counted
Count = Annotated[int, msgspec.Meta(le=MOST)]


class Recipe(msgspec.Struct, forbid_unknown_fields=True):
    """Base of all recipe structures; a field without a default is a required key."""


R = TypeVar("R", bound=Recipe)


def read_text(path: Path) -> str:
    """The text of a recipe file; InputFileError if it cannot be read as UTF-8."""
    try:
        return read_bounded(path).decode("utf-8")
    except OSError as error:
        raise InputFileError(f"{path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputFileError(f"{path} is not a text file; give a TOML recipe") from error


def load_recipe(path: Path, recipe: type[R]) -> R:
    """Read a TOML file as `recipe`; RecipeError names the file, the key and what is wrong with it."""
    return parse_recipe(read_text(path), recipe, str(path))


def parse_recipe(text: str, recipe: type[R], name: str) -> R:
    """`text` as `recipe`; `name` stands in the error messages."""
    try:
        content = tomllib.loads(text)
    except ValueError as error:  # of its own kind, or of a number too long to be one
        raise RecipeError(f"{name} is not valid TOML: {error}") from error
    except RecursionError as error:
        raise RecipeError(f"{name} is not valid TOML: its lists or tables are too deep") from error
    _require_sane(content, name)
    try:
        return msgspec.convert(content, recipe)
    except msgspec.ValidationError as error:
        raise RecipeError(f"{name}: {_plain(str(error))}") from error


def _require_sane(value: Any, name: str, key: str = "") -> None:
    """RecipeError if a number is not finite, or if a text holds the character that no file name can."""
    if isinstance(value, dict):
        for inner, item in value.items():
            _require_sane(item, name, f"{key}.{inner}".lstrip("."))
    elif isinstance(value, list):
        for item in value:
            _require_sane(item, name, key)
    elif isinstance(value, int | float) and not abs(value) <= LARGEST:
        raise RecipeError(f"{name}: {key} is {str(value)[:40]}; give a number within ±{LARGEST:g}")
    elif isinstance(value, str) and "\0" in value:
        raise RecipeError(f"{name}: {key} holds a null character; leave it out")


def _plain(message: str) -> str:
    """msgspec's message in the words of a recipe: keys and tables instead of fields and objects."""
    what, _, where = message.partition(" - at ")
    table = re.sub(r"^`\$\.?|`$", "", where)
    what = what.replace("Object missing required field", "missing key").replace(
        "Object contains unknown field", "unknown key"
    )
    return f"{what} in [{table}]" if table else f"{what} at the top level"
