"""TOML recipes: the base class of their structures, the types of their keys, and TOML text.

Every key is declared and has its unit in its name. Unknown keys are refused.
"""

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

MAX_NUMBER = 1e24  # largest number in a recipe: above any photon flux, and far below overflow
DEEPEST = 100  # largest depth of nested tables and lists
MAX_COUNT = 1_000_000  # largest count in a recipe
Count = Annotated[int, msgspec.Meta(ge=1, le=MAX_COUNT)]
CountOrNone = Annotated[int, msgspec.Meta(ge=0, le=MAX_COUNT)]
Seed = Annotated[int, msgspec.Meta(ge=0, le=LARGEST_WHOLE)]
Positive = Annotated[float, msgspec.Meta(gt=0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0)]
Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
KeyPath = tuple[str | int, ...]  # keys, and indices of list entries from 0, such as ("scene", 1, "size")


class Recipe(msgspec.Struct, forbid_unknown_fields=True):
    """Base class of all recipe structures. A field without a default is a required key."""

    title: ClassVar[str] = "a recipe"  # name of this kind of file in messages


KIND_KEYS = {  # top-level keys that only one kind of file has, which identify the kind
    "a measurement file": ("common", "sweep", "curves", "band", "photo", "prior", "datasheet", "uncertainty"),
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
    """Return the text of a recipe file, without a byte order mark and carriage returns.

    Raises
    ------
    InputFileError
        If the file cannot be read as UTF-8. The message asks for `title`.
    """
    try:
        return read_bounded(path, f"give {title} (TOML)").decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise InputFileError(f"{path} is not a text file; give {title} (TOML, UTF-8)") from error


def parse_toml(text: str, name: str) -> dict[str, Any]:
    """Parse TOML. Raises RecipeError, whose message begins with `name`, if the text is not valid TOML."""
    try:
        return tomllib.loads(text)
    except ValueError as error:  # a syntax error, or a number with too many digits
        raise RecipeError(f"{name} is not valid TOML: {error}") from error
    except RecursionError as error:
        raise RecipeError(f"{name} is not valid TOML: its lists or tables are too deep") from error


def toml_value(value: Any) -> str:
    """Return a number, string, list or table as TOML. Bytes of file names that are not UTF-8 become "?"."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{toml_key(name)} = {toml_value(each)}" for name, each in value.items()) + "}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    return re.sub("[\ud800-\udfff]", "?", json.dumps(value, ensure_ascii=False)).replace("\x7f", "\\u007f")


def toml_key(name: str) -> str:
    """Return a key as TOML, quoted if needed."""
    return name if re.fullmatch("[A-Za-z0-9_-]+", name) else toml_value(name)


def refusals(value: Any, key: KeyPath = ()) -> Iterator[tuple[KeyPath, str]]:
    """Yield the faults of values that no recipe may contain, with their keys.

    These are numbers that are huge or not finite, strings with null characters, and values that are nested too deeply.
    """
    if len(key) > DEEPEST:
        yield key, f"tables and lists are nested more than {DEEPEST} deep; remove some levels"
    elif isinstance(value, dict):
        for inner, item in value.items():
            yield from refusals(item, (*key, inner))
    elif isinstance(value, list):
        for number, item in enumerate(value):
            yield from refusals(item, (*key, number))
    elif isinstance(value, int) and not -LARGEST_WHOLE <= value <= LARGEST_WHOLE:
        written = (
            str(value) if abs(value) < 10**MOST_SHOWN else hex(value)
        )  # Python refuses to print long integers in decimal
        yield key, f"{_named(key)} is {shortened(written)}; a whole number has at most 64 bits"
    elif isinstance(value, float) and not abs(value) <= MAX_NUMBER:
        yield key, f"{_named(key)} is {value:g}; give a number within ±{MAX_NUMBER:g}"
    elif isinstance(value, str) and "\0" in value:
        yield key, f"{_named(key)} contains a null character; remove it"


def _named(key: KeyPath) -> str:
    return ".".join(part for part in key if isinstance(part, str))


def tables_in(kind: Any) -> list[type[Recipe]]:
    """Return all recipe structures that occur in a type."""
    return [each for each in member_types(kind) if isinstance(each, type) and issubclass(each, Recipe)]


def member_types(kind: Any) -> Iterator[Any]:
    """Yield a type and all types that it contains, such as the entries of lists and the alternatives of unions."""
    yield kind
    if get_origin(kind) is not Literal:
        for part in get_args(kind):
            yield from member_types(part)
