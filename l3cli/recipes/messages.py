"""Rewrite msgspec's error messages in terms of TOML, with suggestions for misspelled words."""

import re
from collections.abc import Sequence
from typing import Any, Literal, get_args, get_origin

import msgspec

from l3cli.errors import shortened, suggestion
from l3cli.recipes.toml import KeyPath, Recipe, member_types, tables_in
from l3cli.system.text import counted

PATH_PART = r"\.([^.[\]`]+)|\[(\d+)\]"  # a key or an index in a msgspec path such as `$.scene[1].size`
BOUNDS = {">=": "use at least", "<=": "use at most", ">": "use more than", "<": "use less than"}


def plain(message: str, recipe: type[Recipe], content: Any) -> str:
    """Rewrite a msgspec error message in terms of TOML keys and tables.

    Parameters
    ----------
    message : str
        The msgspec message.
    recipe : type
        Class of the recipe.
    content : dict
        Content of the TOML file.

    Returns
    -------
    str
        Message that names the key and its table, and suggests a correction for a misspelled word.
    """
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
    # The path of a list entry ends with its index, which is not a key.
    *outer, key = path if isinstance(path[-1], str) else path[:-1]
    tables = _tables(recipe, content, tuple(outer))
    known = _keys(tables) if wrong[1] == "unknown key" else _values(tables, str(key))
    tag = tables[0].__struct_config__ if len(tables) == 1 else None
    kind = f' with {tag.tag_field} = "{tag.tag}"' if tag and tag.tag_field else ""
    line = f"{wrong[1]} {wrong[2]}{name}{wrong[2]} {where}{kind}"
    return f"{line}; {suggestion(name, known)}" if known else line


def place(message: str) -> KeyPath:
    """Return the path of the key in a msgspec message or, for a missing key, the path of its table."""
    what, _, where = message.partition(" - at ")
    unknown = re.findall("unknown field `(.*)`", what, re.DOTALL)
    return (*(int(number) if number else key for key, number in re.findall(PATH_PART, where)), *unknown)


def _written(where: str) -> str:
    """Convert a msgspec path such as `$.scene[1].size` to text in which list entries are counted from 1."""
    inner = re.sub(r"^`\$\.?|`$", "", where)
    return re.sub(r"\[(\d+)\]", lambda number: f"[{int(number[1]) + 1}]", inner)


def _value_at(content: Any, where: str) -> Any:
    """Return the value at a msgspec path. Keys that contain a period are not supported."""
    for key, number in re.findall(PATH_PART, where):
        content = content[int(number)] if number else content.get(key, {})
    return content


def _keys(tables: Sequence[type[Recipe]]) -> tuple[str, ...]:
    """Return all keys that are permitted in a table described by one of the classes `tables`."""
    tags = [each.__struct_config__.tag_field for each in tables if each.__struct_config__.tag_field]
    return tuple(dict.fromkeys(tags + [field.encode_name for each in tables for field in msgspec.structs.fields(each)]))


def _values(tables: Sequence[type[Recipe]], name: str) -> tuple[str, ...]:
    """Return all words that are permitted as the value of a key in a table described by one of the classes `tables`."""
    words = [str(each.__struct_config__.tag) for each in tables if each.__struct_config__.tag_field == name]
    for each in tables:
        for field in msgspec.structs.fields(each):
            if field.encode_name == name:
                words += [
                    str(word) for kind in member_types(field.type) if get_origin(kind) is Literal for word in get_args(kind)
                ]
    return tuple(dict.fromkeys(words))


def _tables(recipe: type[Recipe], content: Any, path: KeyPath) -> list[type[Recipe]]:
    """Return the subclasses of Recipe that can describe the table at `path` in a recipe.

    If a tag such as `source` selects one of several subclasses, only this subclass is returned. If the tag is missing or
    unknown, all of them are returned.
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
