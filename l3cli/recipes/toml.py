"""The base class of all recipes, common types for their keys, and functions that read and write TOML.

Every key is declared in a class, and unknown keys are errors. The name of a key includes the unit of its value.
"""

import gc
import json
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_args, get_origin

import msgspec

from l3cli.errors import MOST_SHOWN, InputFileError, RecipeError, shortened
from l3cli.system.limits import read_bounded
from l3cli.system.text import LARGEST_WHOLE

MAX_NUMBER = 1e24  # largest number in a recipe: above any photon flux, but too small to cause overflows in calculations
DEEPEST = 100  # maximum depth of nested tables and lists
MAX_COUNT = 1_000_000  # largest value of a count, such as a number of scenes
Count = Annotated[int, msgspec.Meta(ge=1, le=MAX_COUNT)]
CountOrNone = Annotated[int, msgspec.Meta(ge=0, le=MAX_COUNT)]
Seed = Annotated[int, msgspec.Meta(ge=0, le=LARGEST_WHOLE)]
Positive = Annotated[float, msgspec.Meta(gt=0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0)]
Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
KeyPath = tuple[str | int, ...]  # path of a value: keys and list indices from 0, such as ("scene", 1, "size")


class Recipe(msgspec.Struct, forbid_unknown_fields=True):
    """Base class of recipes and of the tables in recipes. A field without a default is a required key."""

    title: ClassVar[str] = "a recipe"  # name of such a file in messages


KIND_KEYS = {  # type of file → top-level keys that no other type of file has
    "a measurement file": ("common", "sweep", "curves", "band", "photo", "prior", "datasheet", "rotator", "uncertainty"),
    "a camera recipe": ("responsivity", "noise"),
    "a lab recipe": ("defects", "spectrometer_step_nm", "wavelength_error_nm", "lamp_drift", "monitor_error", "falloff"),
    "a scene recipe": (
        "scene", "pair", "illuminants", "luminances_cd_m2", "lux", "exposure_share", "exposure_saturated", "exposure_mean",
        "exposure_s", "lens", "target",
    ),
    "a class recipe": ("classes", "learning", "layer"),
    "a design recipe": ("filters", "pattern", "level", "pixel", "optimise"),
}  # fmt: skip


def read_text(path: Path, title: str = Recipe.title) -> str:
    """Read the text of a recipe file. A byte order mark is removed, and line ends are converted to Unix line ends.

    Parameters
    ----------
    path : Path
        The file.
    title : str
        The expected type of file, such as "a camera recipe", for messages.

    Raises
    ------
    InputFileError
        If the file does not exist or is not UTF-8 text.
    """
    try:
        return read_bounded(path, f"use {title} (TOML)").decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise InputFileError(f"{path} is not a text file; use {title} (TOML, UTF-8)") from error


def parse_toml(text: str, name: str) -> dict[str, Any]:
    """Parse the text of a TOML file.

    Raises RecipeError if the text is not valid TOML. The message contains the file name `name`.
    """
    # Garbage collection is off because finalizers would fail and print errors when nested lists exhaust the stack.
    collecting = gc.isenabled()
    gc.disable()
    try:
        return tomllib.loads(text)
    except ValueError as error:  # raised by a syntax error, or by a number with too many digits
        raise RecipeError(f"{name} is not valid TOML: {error}") from error
    except RecursionError as error:
        raise RecipeError(
            f"{name} cannot be read: its arrays or tables are nested too deeply; use fewer nested arrays or tables"
        ) from error
    finally:
        if collecting:
            gc.enable()


def toml_value(value: Any) -> str:
    """Format a number, string, list or table as TOML. Surrogates, which occur in non-UTF-8 file names, become "?"."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{toml_key(name)} = {toml_value(each)}" for name, each in value.items()) + "}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    return re.sub("[\ud800-\udfff]", "?", json.dumps(value, ensure_ascii=False)).replace("\x7f", "\\u007f")


def toml_key(name: str) -> str:
    """Format a key as TOML, with quotation marks if necessary."""
    return name if re.fullmatch("[A-Za-z0-9_-]+", name) else toml_value(name)


def refusals(value: Any, key: KeyPath = ()) -> Iterator[tuple[KeyPath, str]]:
    """Yield (key, message) for each value that is not allowed in any recipe.

    Such values are integers beyond 64 bits, floats that are not finite or beyond ±MAX_NUMBER, strings with a null character,
    and tables or lists nested more than DEEPEST levels deep.
    """
    if len(key) > DEEPEST:
        yield key, f"tables and lists are nested more than {DEEPEST} levels deep; use fewer levels"
    elif isinstance(value, dict):
        for inner, item in value.items():
            yield from refusals(item, (*key, inner))
    elif isinstance(value, list):
        for number, item in enumerate(value):
            yield from refusals(item, (*key, number))
    elif isinstance(value, int) and not -LARGEST_WHOLE <= value <= LARGEST_WHOLE:
        # Python refuses to convert very long integers to decimal text.
        written = str(value) if abs(value) < 10**MOST_SHOWN else hex(value)
        yield key, f"{_named(key)} is {shortened(written)}; use a whole number with at most 64 bits"
    elif isinstance(value, float) and not abs(value) <= MAX_NUMBER:
        yield key, f"{_named(key)} is {value:g}; use a number within ±{MAX_NUMBER:g}"
    elif isinstance(value, str) and "\0" in value:
        yield key, f"{_named(key)} contains a null character; remove it"


def _named(key: KeyPath) -> str:
    return ".".join(part for part in key if isinstance(part, str))


def tables_in(kind: Any) -> list[type[Recipe]]:
    """Return all subclasses of Recipe in a declared type, for example the members of a union."""
    return [each for each in member_types(kind) if isinstance(each, type) and issubclass(each, Recipe)]


def member_types(kind: Any) -> Iterator[Any]:
    """Yield a declared type and all types inside it, such as the types of list entries and the members of unions."""
    yield kind
    if get_origin(kind) is not Literal:
        for part in get_args(kind):
            yield from member_types(part)
