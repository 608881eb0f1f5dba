"""Artifacts: frozen dataclasses whose field declarations are the HDF5 schema.

A field declared with `data(dtype, axes, unit, doc)` is one dataset; a field declared with `group()`,
whose type is another such dataclass, is a group; `tuple[X, ...]` is a list of groups called 0, 1… Saving, loading, checking
and `l3 info` all read these declarations.
"""

import dataclasses
import types
import typing
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from l3cli import __version__

MOST = 1e27  # of any number: its square, summed up, is still one


@dataclass(frozen=True)
class Spec:
    """Type, named axes, unit and meaning of one dataset."""

    dtype: str
    axes: tuple[str, ...]
    unit: str
    doc: str
    coordinate: bool = False  # the coordinate of its one axis: text does, and numbers that are declared so
    formerly: str = ""  # its name in older files


def data(
    dtype: str,
    *axes: str,
    unit: str = "1",
    doc: str = "",
    default: Any = dataclasses.MISSING,
    coordinate: bool = False,
    formerly: str = "",
) -> Any:
    """Declare one dataset: `dtype` ("float64", "uint16", "str"…), axis names (none: a scalar), unit and meaning; with a
    default it may be absent, as it is from files of older versions. `coordinate`: numbers along an axis of another name.
    `formerly`: the dataset's name in older files, which is read where there is none of the field's name."""
    spec = Spec(dtype, axes, unit, doc, coordinate or (dtype == "str" and len(axes) == 1), formerly)
    return field(metadata={"spec": spec}, default=default)


@dataclass(frozen=True)
class Group:
    """Content of a group: one instance of a dataclass, or a list of them."""

    kind: type
    several: bool
    since: int
    older: Callable[[Any, Any], Any] | None  # reads from a file's group what older versions hold instead


def group(
    default: Any = dataclasses.MISSING, kw_only: bool = False, since: int = 0, older: Callable[[Any, Any], Any] | None = None
) -> Any:
    """Declare a group: the field's type is a dataclass of declared fields, or tuple[X, ...] of one; with a default, None or
    (), it may be absent. In files of format versions before `since` its fields lie a level higher, where the group would.
    `older` makes it of what a file's group (group, path) holds instead."""
    return field(metadata={"since": since, "older": older}, default=default, kw_only=kw_only)


@dataclass(frozen=True)
class Stage:
    """One step of an artifact's history: what was run, on what, with which recipe. No clock, host or path."""

    command: str
    options: dict[str, Any]
    recipe: str = ""
    inputs: dict[str, list[str]] = field(default_factory=dict)  # role → SHA-256 of the files
    version: str = __version__


@dataclass(frozen=True)
class Artifact:
    """Base of what the stages hand on. Subclasses set `kind`, `version`, `made_by`."""

    kind: ClassVar[str]
    version: ClassVar[int]
    made_by: ClassVar[str]
    history: tuple[Stage, ...] = field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        check(self)


# ------------------------------------------------------------------------------------------------ declarations


_DECLARED: dict[type, tuple[tuple[str, Spec | Group, bool], ...]] = {}  # of each dataclass that has been asked for


def declared(cls: type) -> tuple[tuple[str, Spec | Group, bool], ...]:
    """Return (name, dataset or group, optional) of each stored field of a dataclass."""
    if cls not in _DECLARED:
        _DECLARED[cls] = tuple(_declared(cls))
    return _DECLARED[cls]


def _declared(cls: type) -> Iterator[tuple[str, Spec | Group, bool]]:
    hints = typing.get_type_hints(cls)
    for item in dataclasses.fields(cls):
        spec = item.metadata.get("spec")
        if spec is not None:
            yield item.name, spec, item.default is not dataclasses.MISSING
            continue
        if "since" not in item.metadata:
            continue
        hint = hints[item.name]
        several = typing.get_origin(hint) is tuple
        members = typing.get_args(hint) if several or isinstance(hint, types.UnionType) else (hint,)
        kind = next(typing.cast(type, member) for member in members if dataclasses.is_dataclass(member))
        yield item.name, Group(kind, several, **item.metadata), item.default is not dataclasses.MISSING


def instances(name: str, value: Any) -> dict[str, Any]:
    """Return the dataclasses that a field holds, by the name of the group of each: one, none or several."""
    if isinstance(value, tuple):
        return {f"{name}/{index}": each for index, each in enumerate(value)}
    return {} if value is None else {name: value}


def check(instance: Any) -> None:
    """Check dtypes, number of axes, equal length of equally named axes, finite numbers; ValueError names the field.

    An axis whose values a group gives, in a dataset of its name, is an axis of that group and those below it alone; axes
    that only the members of a list have may differ in length between them.
    """
    _check(instance, {}, {}, "")


def _check(instance: Any, lengths: dict[str, tuple[int, str]], scopes: dict[str, str], prefix: str) -> None:
    fields = declared(type(instance))
    scopes = scopes | {name: prefix for name, spec, _ in fields if isinstance(spec, Spec) and spec.axes == (name,)}
    for name, spec, _ in fields:
        value = getattr(instance, name)
        if not isinstance(spec, Spec):
            for place, each in instances(name, value).items():
                _check(each, dict(lengths) if spec.several else lengths, scopes, f"{prefix}{place}/")
            continue
        array = np.asarray(value)
        label = f"{prefix}{name} ({', '.join(spec.axes)})"
        if array.ndim != len(spec.axes):
            raise ValueError(f"{label} has {array.ndim} axes")
        if spec.dtype != "str":
            if not np.can_cast(array.dtype, spec.dtype, "same_kind"):
                raise ValueError(f"{label} holds {array.dtype}, not {spec.dtype}")
            if array.size and array.dtype.kind == "u" and int(array.max()) > np.iinfo(np.int64).max:
                raise ValueError(f"{label} holds {array.max()}, more than 63 bits")
            if array.dtype.kind == "f" and array.size and not (array.min() >= -MOST and array.max() <= MOST):
                fault = f"beyond ±{MOST:g}" if np.isfinite(array).all() else "that are not finite"
                raise ValueError(f"{label} holds values {fault}")
        for axis, length in zip(spec.axes, array.shape, strict=True):
            known, where = lengths.setdefault(scopes.get(axis, "") + axis, (length, prefix + name))
            if known != length:
                raise ValueError(f"{label} has {length} along {axis}, but {where} has {known}")


def equal(one: Any, other: Any) -> bool:
    """Return whether every declared field of two instances of a dataclass holds the same values."""
    for name, spec, _ in declared(type(one)):
        a, b = getattr(one, name), getattr(other, name)
        if isinstance(spec, Spec):
            if not np.array_equal(np.asarray(a), np.asarray(b)):
                return False
        else:
            ours, theirs = instances(name, a), instances(name, b)
            if ours.keys() != theirs.keys() or not all(equal(ours[place], theirs[place]) for place in ours):
                return False
    return True
