"""All that is wrong with a recipe at once: what its declared types refuse, each fault with the key that it is about.

Checks of what a recipe means are generators of faults, too. Whoever only wants to know whether a recipe can be used takes
their first one (`refuse_first`); `l3 check` takes all of them.
"""

import functools
import types
from collections.abc import Iterable, Iterator
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin

import msgspec

from l3cli.errors import RecipeError
from l3cli.recipes.toml import KeyPath, Recipe, place, plain, refusals

R = TypeVar("R", bound=Recipe)
LISTED = 100  # faults of a recipe with a message; what is beyond is counted
_fields = functools.cache(msgspec.structs.fields)
UNIONS = (Union, types.UnionType)


class Fault(NamedTuple):
    """A fault, and the keys that it depends on; it stands at the first of them.

    One without a message is only counted.
    """

    message: str
    keys: tuple[KeyPath, ...]


def fault(message: str, *keys: str | KeyPath) -> Fault:
    """Return a fault; keys may be written with points, and those of entries of lists with their number from 0,
    "scene.1.size"."""
    return Fault(message, tuple(_path(key) for key in keys))


def _path(key: str | KeyPath) -> KeyPath:
    return tuple(int(part) if part.isdigit() else part for part in key.split(".")) if isinstance(key, str) else key


def inside(faults: Iterable[Fault], *table: str | int) -> Iterator[Fault]:
    """Yield the faults of a table on its own, as those of the recipe that holds it."""
    return (Fault(message, tuple((*table, *key) for key in keys)) for message, keys in faults)


def refuse_first(faults: Iterable[Fault], name: object = None) -> None:
    """Raise RecipeError that calls the recipe `name`, or leaves that to whoever catches it, if there is a fault."""
    for message, _ in faults:
        raise RecipeError(message if name is None else f"{name}: {message}")


def about_others(faults: Iterable[Fault], known: Iterable[Fault]) -> Iterator[Fault]:
    """Yield those faults that depend on no key that is faulty already, by what is known or by a fault before them."""
    broken: set[KeyPath] = set()
    above: set[KeyPath] = set()  # what broken keys lie in

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
    """Return `content` as `recipe`, with something of the declared type in the place of what is wrong, and all that is
    wrong; None where nothing can be put in its place."""
    faults = list(refusals(content))
    judge = _Judge(recipe, content, [Fault(message, (key,)) for key, message in faults])
    try:
        return msgspec.convert(judge.table(recipe, content, ()), recipe), judge.faults
    except msgspec.ValidationError as error:
        left = plain(str(error), recipe, content) if not judge.faults else ""
        return None, judge.faults or [Fault(left, ((),))]


class _Judge:
    """Comparison of a recipe's content with the declared types, key by key."""

    def __init__(self, recipe: type[Recipe], content: dict[str, Any], faults: list[Fault]) -> None:
        self.recipe, self.content, self.faults = recipe, content, faults
        self._faulty = {key for fault in faults for key in fault.keys}

    def table(self, kind: type[Recipe], given: dict[str, Any], path: KeyPath) -> dict[str, Any]:
        """Return a table as it is or, where it is wrong, as it could be."""
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
        """Return a value as it is or, where it is wrong, one of its type."""
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
        """Add a fault in msgspec's words, unless the key has one already."""
        if key in self._faulty:
            return
        self._faulty.add(key)
        if len(self.faults) >= LISTED:
            self.faults.append(Fault("", (key,)))
            return
        written = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in where)
        message = f"{what} - at `${written}`" if written else what
        self.faults.append(Fault(plain(message, self.recipe, self.content), (key,)))


def _plain_types(kind: Any) -> list[Any]:
    """Return the types that a value may have, without their ranges."""
    if get_origin(kind) is Annotated:
        return _plain_types(get_args(kind)[0])
    if get_origin(kind) in UNIONS:
        return [inner for part in get_args(kind) for inner in _plain_types(part)]
    return [kind]


def _table(kind: Any, value: Any) -> type[Recipe] | None:
    """Return the structure that a table is meant to be, if it can be known: by its tag where there are several."""
    tables = [each for each in _plain_types(kind) if isinstance(each, type) and issubclass(each, Recipe)]
    if not isinstance(value, dict) or not tables:
        return None
    tag = tables[0].__struct_config__.tag_field
    return next((each for each in tables if tag is None or each.__struct_config__.tag == value.get(tag)), None)


def _entries(kind: Any, value: Any) -> dict[str, Any] | list[Any] | None:
    """Return the type of each entry of a list or of a table with free keys; None of another value or too many."""
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
    """Return some value of a declared type, in its range."""
    if get_origin(kind) is Annotated:
        kind, *marks = get_args(kind)
        (meta,) = (mark for mark in marks if isinstance(mark, msgspec.Meta))
        if meta.min_length and get_origin(kind) is not dict:
            return [example(get_args(kind)[0])] * meta.min_length
        ends = [end for end in (meta.ge, meta.le) if end is not None]
        if ends:
            return ends[0]
        return example(kind) if meta.lt is None else (meta.gt or 0.0) + meta.lt / 1000
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
