"""Reads TOML recipes into typed structures, and finds the line of each key, which tomllib does not report.

Every key is declared and has its unit in its name. Unknown keys are refused.
"""

import copy
import json
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar, get_args, get_origin

import msgspec

from l3cli.errors import MOST_SHOWN, InputFileError, RecipeError, shortened, suggestion
from l3cli.system.limits import read_bounded
from l3cli.system.text import LARGEST_WHOLE, counted

MAX_NUMBER = 1e24  # largest number in a recipe: above any photon flux, and far below overflow
DEEPEST = 100  # largest depth of nested tables and lists
STRING = (
    r'"""[^"\\]*(?:(?:\\.|"{1,2}(?!"))[^"\\]*)*"{3,5}'  # up to two quotation marks may stand before the three that end it
    r"|'''[^']*(?:'{1,2}(?!')[^']*)*'{3,5}"
    r'|"[^"\\\n]*(?:\\.[^"\\\n]*)*"'
    r"|'[^'\n]*'"
)
TOKEN = re.compile(rf"{STRING}|#[^\n]*|[^\"'#.,\[\]{{}}=\n]+|.", re.DOTALL)  # TOML token; words include adjacent blanks
PATH_PART = r"\.([^.[\]`]+)|\[(\d+)\]"  # one key or index of a path in a message of msgspec, such as `$.scene[1].size`
MAX_COUNT = 1_000_000  # largest count in a recipe
Count = Annotated[int, msgspec.Meta(ge=1, le=MAX_COUNT)]
CountOrNone = Annotated[int, msgspec.Meta(ge=0, le=MAX_COUNT)]
Seed = Annotated[int, msgspec.Meta(ge=0, le=LARGEST_WHOLE)]
Positive = Annotated[float, msgspec.Meta(gt=0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0)]
Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
KeyPath = tuple[str | int, ...]  # keys, and indices of list entries from 0, such as ("scene", 1, "size")
BOUNDS = {">=": "the least is", "<=": "the most is", ">": "give more than", "<": "give less than"}


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


R = TypeVar("R", bound=Recipe)


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


def load_recipe(path: Path, recipe: type[R]) -> R:
    """Read a TOML file as a structure of type `recipe`. Raises RecipeError with the file, the key and the fault."""
    return parse_recipe(read_text(path, recipe.title), recipe, str(path))


def parse_recipe(text: str, recipe: type[R], name: str) -> R:
    """Convert TOML text to a structure of type `recipe`. Error messages begin with `name`."""
    content = parse_toml(text, name)
    given = {kind for kind, keys in KIND_KEYS.items() if any(key in content for key in keys)}
    if given and recipe.title in KIND_KEYS and recipe.title not in given:
        raise RecipeError(f"{name} is {' and '.join(sorted(given))}; give {recipe.title}")
    for key, message in refusals(content):
        raise RecipeError(f"{name}:{line_of(key, key_lines(text))}: {message}")
    try:
        return msgspec.convert(content, recipe)
    except msgspec.ValidationError as error:
        message = _with_free_keys(str(error), recipe, content)
        line = line_of(place(message), key_lines(text))
        raise RecipeError(f"{name}:{line}: {plain(message, recipe, content)}") from error


def parse_toml(text: str, name: str) -> dict[str, Any]:
    """Parse TOML. Raises RecipeError, whose message begins with `name`, if the text is not valid TOML."""
    if any(line.count(".") > DEEPEST for line in text.splitlines()):
        _refuse_deep_keys(text, name)
    try:
        return tomllib.loads(text)
    except ValueError as error:  # a syntax error, or a number with too many digits
        raise RecipeError(f"{name} is not valid TOML: {error}") from error
    except RecursionError as error:
        raise RecipeError(f"{name} is not valid TOML: its lists or tables are too deep") from error


def _refuse_deep_keys(text: str, name: str) -> None:
    """Raise RecipeError for keys with more than DEEPEST parts, which take quadratic time to parse."""
    parts = 0
    for token in TOKEN.finditer(text):
        found = token.group()
        if found == ".":
            parts += 1
        elif found in ("=", ",", "\n", "[", "]", "{", "}"):
            parts = 0
        if parts > DEEPEST:
            line, column = text.count("\n", 0, token.start()) + 1, token.start() - text.rfind("\n", 0, token.start())
            message = f"a key has more than {DEEPEST} parts (at line {line}, column {column}); recipes are not that deep"
            raise RecipeError(f"{name}: {message}")


def line_of(path: KeyPath, lines: Mapping[KeyPath, int]) -> int:
    """Return the line of a key. If it is missing, return the line of its table, or 1 at the top level."""
    return next((lines[path[:length]] for length in range(len(path), 0, -1) if path[:length] in lines), 1)


def key_lines(text: str) -> dict[KeyPath, int]:
    """Return the line, from 1, of every key, table and list entry in a valid TOML text."""
    return _Scanner(text.replace("\r\n", "\n")).document()


class _Scanner:
    """Finds the lines of keys in one pass over the tokens. Each method reads the element that its name says."""

    def __init__(self, text: str) -> None:
        self.text, self.tokens = text, TOKEN.finditer(text)
        self.token, self.start, self.line = "", 0, 1
        self.lines: dict[KeyPath, int] = {}
        self.entries: dict[KeyPath, int] = {}  # index of the latest table in each list of tables
        self._next()

    def _next(self) -> str:
        """Return the current token and advance to the next one, which is "" at the end."""
        before, self.token = self.token, ""
        for found in self.tokens:
            token = found.group().strip(" \t")
            if token and token[0] != "#":
                self.line += self.text.count("\n", self.start, found.start())
                self.token, self.start = token, found.start()
                break
        return before

    def document(self) -> dict[KeyPath, int]:
        table: KeyPath = ()
        while self.token:
            if self.token == "\n":
                self._next()
            elif self.token == "[":
                table = self._heading()
            else:
                self._pair(table)
        return self.lines

    def _heading(self) -> KeyPath:
        several, line = self.text.startswith("[[", self.start), self.line
        table: KeyPath = ()
        *outer, last = self._key()
        for name in outer if several else (*outer, last):
            table = (*table, name)
            self.lines.setdefault(table, line)
            if table in self.entries:  # a list of tables: the key belongs to its latest table
                table = (*table, self.entries[table])
        if several:
            table = (*table, last)
            self.lines.setdefault(table, line)
            self.entries[table] = self.entries.get(table, -1) + 1
            table = (*table, self.entries[table])
            self.lines[table] = line
        while self.token == "]":
            self._next()
        return table

    def _key(self) -> list[str]:
        names = []
        while self.token not in ("=", "]"):
            written = self._next()
            if written[0] in "\"'":
                names.append(tomllib.loads(f"key = {written}")["key"])
            elif written not in ".[":
                names.append(written)
        return names

    def _pair(self, table: KeyPath) -> None:
        line = self.line
        for name in self._key():
            table = (*table, name)
            self.lines.setdefault(table, line)
        self._next()  # the equals sign
        self._value(table)

    def _value(self, path: KeyPath) -> None:
        if self.token in ("[", "{"):
            self._entries(path, "]" if self._next() == "[" else "}")
        while self.token not in (",", "]", "}", "\n", ""):
            self._next()

    def _entries(self, path: KeyPath, end: str) -> None:
        """Read a list or an inline table, whose opening bracket has been read."""
        number = 0
        while self.token != end:
            if self.token in (",", "\n"):
                self._next()
            elif end == "]":
                self.lines[*path, number] = self.line
                self._value((*path, number))
                number += 1
            else:
                self._pair(path)
        self._next()


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


def plain(message: str, recipe: type[Recipe], content: Any) -> str:
    """Rewrite a message of msgspec in TOML terms, with keys and tables, and add a suggestion."""
    what, _, where = message.partition(" - at ")
    if bound := re.fullmatch(r"Expected `(?:int|float|array|object)` (of length )?(<=|>=|<|>) (\S+)", what):
        value = _value_at(content, where)
        held = f"has {counted(len(value), 'value')}" if bound[1] else f"is {value}"
        return f"{_written(where)} {held}; {BOUNDS[bound[2]]} {bound[3].removesuffix('.0')}"
    table = _written(where)
    what = what.replace("Object missing required field", "missing key").replace(
        "Object contains unknown field", "unknown key"
    )
    where = f"in [{table}]" if table else "at the top level"
    wrong = re.fullmatch(r"(unknown key|Invalid(?: enum)? value) ([`'])(.*)\2", what, re.DOTALL)
    if wrong is None:
        return f"{what} {where}"
    name, path = shortened(wrong[3]), place(message)
    # The path of an entry in a list of words ends with the index of the entry.
    *outer, key = path if isinstance(path[-1], str) else path[:-1]
    tables = _tables(recipe, content, tuple(outer))
    known = _keys(tables) if wrong[1] == "unknown key" else _values(tables, str(key))
    tag = tables[0].__struct_config__ if len(tables) == 1 else None
    kind = f' with {tag.tag_field} = "{tag.tag}"' if tag and tag.tag_field else ""
    line = f"{wrong[1]} {wrong[2]}{name}{wrong[2]} {where}{kind}"
    return f"{line}; {suggestion(name, known)}" if known else line


def place(message: str) -> KeyPath:
    """Return the key to which a message of msgspec refers, even if it is unknown. For a missing key, return its table."""
    what, _, where = message.partition(" - at ")
    unknown = re.findall("unknown field `(.*)`", what, re.DOTALL)
    return (*(int(number) if number else key for key, number in re.findall(PATH_PART, where)), *unknown)


def _written(where: str) -> str:
    """Return a path from a message of msgspec with list indices that start at 1."""
    inner = re.sub(r"^`\$\.?|`$", "", where)
    return re.sub(r"\[(\d+)\]", lambda number: f"[{int(number[1]) + 1}]", inner)


def _value_at(content: Any, where: str) -> Any:
    """Return the value at a path from a message of msgspec, or None if a key contains a period."""
    for key, number in re.findall(PATH_PART, where):
        content = content[int(number)] if number else content.get(key, {})
    return content


def _with_free_keys(message: str, recipe: type[Recipe], content: Any) -> str:
    """Replace each "[...]", which is msgspec's placeholder for a free key of a table, by the key with the invalid value."""
    while "[...]" in message:
        content = copy.deepcopy(content)
        before = message.partition(" - at ")[2].partition("[...]")[0]
        table, wrong = _value_at(content, before), ""
        entries = dict(table)
        for key, value in entries.items():
            table.clear()
            table[key] = value
            try:
                msgspec.convert(content, recipe)
            except msgspec.ValidationError as error:
                wrong = wrong or key * (str(error) == message)
        message = message.replace("[...]", f".{wrong}", 1)
        table.clear()
        table.update(entries)
    return message


def _keys(tables: Sequence[type[Recipe]]) -> tuple[str, ...]:
    """Return the keys that a table of one of these structures may have."""
    tags = [each.__struct_config__.tag_field for each in tables if each.__struct_config__.tag_field]
    return tuple(dict.fromkeys(tags + [field.encode_name for each in tables for field in msgspec.structs.fields(each)]))


def _values(tables: Sequence[type[Recipe]], name: str) -> tuple[str, ...]:
    """Return the words that are permitted for the key `name` in a table of one of these structures."""
    words = [str(each.__struct_config__.tag) for each in tables if each.__struct_config__.tag_field == name]
    for each in tables:
        for field in msgspec.structs.fields(each):
            if field.encode_name == name:
                words += [
                    str(word) for kind in _member_types(field.type) if get_origin(kind) is Literal for word in get_args(kind)
                ]
    return tuple(dict.fromkeys(words))


def _tables(recipe: type[Recipe], content: Any, path: KeyPath) -> list[type[Recipe]]:
    """Return the possible structures of the table at `path` of a recipe.

    If a tag such as `source` selects one of several structures, only this one is returned. If the tag is missing or unknown,
    all are returned.
    """
    tables = [recipe]
    for part in path:
        if isinstance(part, str):
            fields = [field for each in tables for field in msgspec.structs.fields(each) if field.encode_name == part]
            tables = [table for field in fields for table in tables_in(field.type)]
            content = content.get(part) if isinstance(content, dict) else None
        else:
            content = content[part] if isinstance(content, list) else None
        if isinstance(content, dict):
            configs = [(each, each.__struct_config__) for each in tables]
            named = [each for each, config in configs if config.tag_field and content.get(config.tag_field) == config.tag]
            tables = named or tables
    return tables


def tables_in(kind: Any) -> list[type[Recipe]]:
    """Return all recipe structures that occur in a type."""
    return [each for each in _member_types(kind) if isinstance(each, type) and issubclass(each, Recipe)]


def _member_types(kind: Any) -> Iterator[Any]:
    """Yield a type and all types that it contains, such as the entries of lists and the alternatives of unions."""
    yield kind
    if get_origin(kind) is not Literal:
        for part in get_args(kind):
            yield from _member_types(part)
