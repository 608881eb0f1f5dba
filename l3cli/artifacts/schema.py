"""What an artifact is: a frozen dataclass whose field declarations are the HDF5 schema.

A field declared with `data(dtype, axes, unit, doc)` is one dataset; a field declared with `group()`,
whose type is another such dataclass, is a group. Saving, loading, checking and `l3 info` all read these declarations.
"""

import dataclasses
import types
import typing
from collections.abc import Iterator
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
    coordinate: bool = False  # tells what stands where along its one axis: text does, and numbers that are declared so


def data(
    dtype: str,
    *axes: str,
    unit: str = "1",
    doc: str = "",
    default: Any = dataclasses.MISSING,
    coordinate: bool = False,
) -> Any:
    """Declare one dataset: `dtype` ("float64", "uint16", "str"…), axis names (none: a scalar), unit and meaning; with a
    default it may be absent, as it is from files of older versions. `coordinate`: numbers along an axis of another name."""
    spec = Spec(dtype, axes, unit, doc, coordinate or (dtype == "str" and len(axes) == 1))
    return field(metadata={"spec": spec}, default=default)


def group(default: Any = dataclasses.MISSING, kw_only: bool = False) -> Any:
    """Declare a group: the field's type is a dataclass of declared fields; with default None it may be absent."""
    return field(default=default, kw_only=kw_only)


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


def declared(cls: type) -> Iterator[tuple[str, Spec | type, bool]]:
    """(name, Spec or dataclass of the group, optional) of each stored field of a dataclass."""
    hints = typing.get_type_hints(cls)
    for item in dataclasses.fields(cls):
        spec = item.metadata.get("spec")
        if spec is not None:
            yield item.name, spec, item.default is not dataclasses.MISSING
            continue
        hint = hints[item.name]
        members = typing.get_args(hint) if isinstance(hint, types.UnionType) else (hint,)
        groups = [member for member in members if dataclasses.is_dataclass(member)]
        if groups:
            yield item.name, typing.cast(type, groups[0]), type(None) in members


def check(instance: Any) -> None:
    """Dtypes, number of axes, equal length of equally named axes, finite numbers; ValueError names the field.

    An axis whose values a group gives, in a dataset of its name, is an axis of that group and those below it alone.
    """
    _check(instance, {}, {}, "")


def _check(instance: Any, lengths: dict[str, tuple[int, str]], scopes: dict[str, str], prefix: str) -> None:
    fields = list(declared(type(instance)))
    scopes = scopes | {name: prefix for name, spec, _ in fields if isinstance(spec, Spec) and spec.axes == (name,)}
    for name, spec, optional in fields:
        value = getattr(instance, name)
        if not isinstance(spec, Spec):
            if not (optional and value is None):
                _check(value, lengths, scopes, f"{prefix}{name}/")
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
                told = f"beyond ±{MOST:g}" if np.isfinite(array).all() else "that are not finite"
                raise ValueError(f"{label} holds values {told}")
        for axis, length in zip(spec.axes, array.shape, strict=True):
            known, where = lengths.setdefault(scopes.get(axis, "") + axis, (length, prefix + name))
            if known != length:
                raise ValueError(f"{label} has {length} along {axis}, but {where} has {known}")


def equal(one: Any, other: Any) -> bool:
    """Whether every declared field of two instances of a dataclass holds the same values."""
    for name, spec, _ in declared(type(one)):
        a, b = getattr(one, name), getattr(other, name)
        if isinstance(spec, Spec):
            if not np.array_equal(np.asarray(a), np.asarray(b)):
                return False
        elif (a is None) != (b is None) or (a is not None and not equal(a, b)):
            return False
    return True
