"""Collect the faults in a recipe, each with the keys that cause it.

This module finds values that have a wrong type or are out of range. Other modules check the meaning of the values, for
example whether two of them contradict each other. Commands stop at the first fault (`refuse_first`). `l3 check` lists all
faults.
"""

import functools
import types
from collections.abc import Iterable, Iterator
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin

import msgspec

from l3cli.errors import RecipeError
from l3cli.recipes.messages import place, plain
from l3cli.recipes.toml import KeyPath, Recipe, refusals

R = TypeVar("R", bound=Recipe)
LISTED_FAULTS = 100  # maximum number of faults that are listed; further faults are only counted
_fields = functools.cache(msgspec.structs.fields)
UNIONS = (Union, types.UnionType)


class Fault(NamedTuple):
    """A fault in a recipe, and the keys that cause it.

    The fault is reported at the line of its first key. A fault with an empty message is counted but not listed.
    """

    message: str
    keys: tuple[KeyPath, ...]


def fault(message: str, *keys: str | KeyPath) -> Fault:
    """Create a fault. Keys are KeyPaths, or text such as "scene.1.size" with list indices counted from 0."""
    return Fault(message, tuple(_path(key) for key in keys))


def _path(key: str | KeyPath) -> KeyPath:
    return tuple(int(part) if part.isdigit() else part for part in key.split(".")) if isinstance(key, str) else key


def inside(faults: Iterable[Fault], *table: str | int) -> Iterator[Fault]:
    """Convert faults in a table to faults in the whole recipe, by prepending the table's path to each key."""
    return (Fault(message, tuple((*table, *key) for key in keys)) for message, keys in faults)


def refuse_first(faults: Iterable[Fault], name: object = None) -> None:
    """Raise a RecipeError for the first fault, if there is any. If `name` is not None, the message starts with it."""
    for message, _ in faults:
        raise RecipeError(message if name is None else f"{name}: {message}")


def about_others(faults: Iterable[Fault], known: Iterable[Fault]) -> Iterator[Fault]:
    """Yield the faults that are not consequences of earlier faults.

    A fault is omitted if an earlier fault concerns the same key, a table around this key, or a value inside it. Earlier
    faults are those in `known` and those already yielded.
    """
    broken: set[KeyPath] = set()
    above: set[KeyPath] = set()  # broken keys, and the tables and lists around them

    def add(key: KeyPath) -> None:
        broken.add(key)
        above.update(key[:length] for length in range(len(key) + 1))

    for each in known:
        for key in each.keys:
            add(key)
    for each in faults:
        if not any(key in above or any(key[:length] in broken for length in range(len(key))) for key in each.keys):
            for key in each.keys[:1]:
                add(key)
            yield each


def typed(content: dict[str, Any], recipe: type[R]) -> tuple[R | None, list[Fault]]:
    """Convert the content of a TOML file to a recipe, and collect all values that violate the declared types.

    Parameters
    ----------
    content : dict
        Content of the file, as parsed by tomllib.
    recipe : type
        Class of the recipe.

    Returns
    -------
    recipe : Recipe or None
        The recipe. Valid placeholders replace invalid values, so that the caller can check the remaining values. None if
        msgspec rejects the content even with placeholders.
    faults : list of Fault
        The faults, in the order in which they were found. Empty if the recipe is valid.
    """
    faults = list(refusals(content))
    judge = _Judge(recipe, content, [Fault(message, (key,)) for key, message in faults])
    try:
        return msgspec.convert(judge.table(recipe, content, ()), recipe), judge.faults
    except msgspec.ValidationError as error:
        left = plain(str(error), recipe, content) if not judge.faults else ""
        return None, judge.faults or [Fault(left, ((),))]


class _Judge:
    """Compares the content of a recipe with the declared types, and replaces invalid values with valid examples."""

    def __init__(self, recipe: type[Recipe], content: dict[str, Any], faults: list[Fault]) -> None:
        self.recipe, self.content, self.faults = recipe, content, faults
        self._faulty = {key for fault in faults for key in fault.keys}

    def table(self, kind: type[Recipe], given: dict[str, Any], path: KeyPath) -> dict[str, Any]:
        """Check a table, and return a copy with valid examples in place of invalid and missing values."""
        fields = {field.encode_name: field for field in _fields(kind)}
        tag = kind.__struct_config__.tag_field
        repaired: dict[str, Any] = {tag: kind.__struct_config__.tag} if tag else {}
        for key, value in given.items():
            if key in fields:
                repaired[key] = self.value(fields[key].type, value, (*path, key))
            elif key != tag:
                self._add(f"Object contains unknown field `{key}`", path, (*path, key))
        for key, field in fields.items():
            if field.required and key not in given:
                self._add(f"Object missing required field `{key}`", path, (*path, key))
                repaired[key] = example(field.type)
        return repaired

    def value(self, kind: Any, value: Any, path: KeyPath) -> Any:
        """Check a value, including the entries of a list or table, and return it with valid examples for invalid parts."""
        if path in self._faulty:
            return example(kind)
        table, entries = _table(kind, value), _entries(kind, value)
        if table is not None:
            return self.table(table, value, path)
        if isinstance(entries, dict):
            return {key: self.value(entries[key], inner, (*path, key)) for key, inner in value.items()}
        before = len(self.faults)
        if entries is not None:
            parts = enumerate(zip(entries, value, strict=True))
            value = [self.value(part, inner, (*path, number)) for number, (part, inner) in parts]
        if len(self.faults) > before:
            return value
        try:
            msgspec.convert(value, kind)
        except msgspec.ValidationError as error:
            what, where = str(error).partition(" - at ")[0], (*path, *place(str(error)))
            self._add(what, where, where)
            return example(kind)
        return value

    def _add(self, what: str, where: KeyPath, key: KeyPath) -> None:
        """Add a fault with a msgspec message, unless the key already has a fault."""
        if key in self._faulty:
            return
        self._faulty.add(key)
        if len(self.faults) >= LISTED_FAULTS:
            self.faults.append(Fault("", (key,)))
            return
        written = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in where)
        message = f"{what} - at `${written}`" if written else what
        self.faults.append(Fault(plain(message, self.recipe, self.content), (key,)))


def _plain_types(kind: Any) -> list[Any]:
    """Return the members of a union, or `[kind]` if `kind` is not a union. Declared ranges (Annotated) are removed."""
    if get_origin(kind) is Annotated:
        return _plain_types(get_args(kind)[0])
    if get_origin(kind) in UNIONS:
        return [inner for part in get_args(kind) for inner in _plain_types(part)]
    return [kind]


def _table(kind: Any, value: Any) -> type[Recipe] | None:
    """Return the class that describes a table. If several classes are permitted, the table's tag selects one of them.

    Returns None if `value` is not a table, if no class is declared, or if the tag is unknown.
    """
    tables = [each for each in _plain_types(kind) if isinstance(each, type) and issubclass(each, Recipe)]
    if not isinstance(value, dict) or not tables:
        return None
    tag = tables[0].__struct_config__.tag_field
    return next((each for each in tables if tag is None or each.__struct_config__.tag == value.get(tag)), None)


def _entries(kind: Any, value: Any) -> dict[str, Any] | list[Any] | None:
    """Return the declared type of each entry in a list, or in a table with arbitrary keys.

    Returns None if `value` is neither, if the declared type `kind` does not permit it, or if the list has the wrong length.
    """
    for each in _plain_types(kind):
        origin, arguments = get_origin(each), get_args(each)
        if origin is dict and isinstance(value, dict):
            return dict.fromkeys(value, arguments[1])
        if isinstance(value, list) and (origin is list or (origin is tuple and arguments[1:] == (Ellipsis,))):
            return [arguments[0]] * len(value)
        if isinstance(value, list) and origin is tuple and len(arguments) == len(value):
            return list(arguments)
    return None


def example(kind: Any) -> Any:
    """Return a valid value for a declared type, as tomllib would parse it."""
    if get_origin(kind) is Annotated:
        kind, *marks = get_args(kind)
        (meta,) = (mark for mark in marks if isinstance(mark, msgspec.Meta))
        if meta.min_length and get_origin(kind) is not dict:
            return [example(get_args(kind)[0])] * meta.min_length
        ends = [end for end in (meta.ge, meta.le) if end is not None]
        if ends:
            return ends[0]
        if meta.lt is not None:
            return (meta.gt or 0.0) + meta.lt / 1000
        return example(kind) if meta.gt is None else meta.gt + 1
    if get_origin(kind) in UNIONS:
        return example(get_args(kind)[0])
    if get_origin(kind) is Literal:
        return get_args(kind)[0]
    if get_origin(kind) is tuple and get_args(kind)[1:] != (Ellipsis,):
        return [example(part) for part in get_args(kind)]
    if isinstance(kind, type) and issubclass(kind, Recipe):
        tag = kind.__struct_config__.tag_field
        filled = {field.encode_name: example(field.type) for field in _fields(kind) if field.required}
        return filled | ({tag: kind.__struct_config__.tag} if tag else {})
    plain_values: dict[Any, Any] = {int: 1, float: 1.0, str: "", bool: False, dict: {}}
    return plain_values.get(get_origin(kind) or kind, [])
