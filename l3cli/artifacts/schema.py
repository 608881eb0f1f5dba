"""Artifacts as frozen dataclasses whose field declarations define the HDF5 schema.

`data(dtype, axes, unit, doc)` declares a dataset. `group()` declares a group, whose content is another dataclass of such
fields; a field of type `tuple[X, ...]` is stored as numbered groups 0, 1, 2… Saving, loading, checking and `l3 info` all
read these declarations, so that a new field is declared in one place.
"""

import dataclasses
import functools
import types
import typing
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from l3cli import __version__

LARGEST_VALUE = 1e27  # of any stored number, so that sums of squares stay finite


@dataclass(frozen=True)
class Spec:
    """Declaration of a dataset: its type, named axes, unit and meaning."""

    dtype: str
    axes: tuple[str, ...]
    unit: str
    doc: str
    coordinate: bool = False  # whether it labels its axis, as wavelengths do; text with one axis always does
    optional: bool = False  # whether it is stored only if it differs from the field's default


def data(
    dtype: str,
    *axes: str,
    unit: str = "1",
    doc: str = "",
    default: Any = dataclasses.MISSING,
    optional: Any = dataclasses.MISSING,
    coordinate: bool = False,
) -> Any:
    """Declare a dataclass field that is stored as one dataset.

    Parameters
    ----------
    dtype : str
        A numpy type such as "float64" or "uint16", or "str".
    *axes : str
        Names of the axes. Without axes the dataset is a scalar.
    unit, doc : str
        Unit and meaning, which are stored as attributes and shown by `l3 info`.
    default : optional
        Default of the dataclass field. Files hold the dataset whatever its value.
    optional : optional
        Default of a field that is stored only if its value differs. An instance that has the default is written with the
        same bytes as before the field was declared, so every field that is added to the format is optional. Give None for
        arrays.
    coordinate : bool
        Whether the numbers label an axis whose name differs from the field's.
    """
    is_optional = optional is not dataclasses.MISSING
    spec = Spec(dtype, axes, unit, doc, coordinate or (dtype == "str" and len(axes) == 1), is_optional)
    # repr: arrays would fill pages
    return field(metadata={"spec": spec}, default=optional if is_optional else default, repr=not axes)


@dataclass(frozen=True)
class Group:
    """Declaration of a group that holds one instance of a dataclass, or a list of instances."""

    kind: type
    several: bool
    optional: bool


def group(default: Any = dataclasses.MISSING, kw_only: bool = False) -> Any:
    """Declare a dataclass field that is stored as a group, or as a list of groups.

    The type of the field is a dataclass of declared fields, or `tuple[X, ...]` of such a dataclass X.

    Parameters
    ----------
    default : optional
        None or (), if the group may be absent. It is stored only if the field is set.
    kw_only : bool
        As in `dataclasses.field`.
    """
    return field(metadata={"group": True}, default=default, kw_only=kw_only)


@dataclass(frozen=True)
class Stage:
    """One step of an artifact's history: the command, its options, its recipe and the digests of its inputs.

    A stage holds no time, host or path, so that equal inputs give equal bytes.
    """

    command: str
    options: dict[str, Any]
    recipe: str = ""
    inputs: dict[str, list[str]] = field(default_factory=dict)  # role → SHA-256 of the files
    version: str = __version__


@dataclass(frozen=True, repr=False)
class Artifact:
    """Base class of the files that stages hand on. Subclasses set `kind` and `made_by`."""

    kind: ClassVar[str]
    made_by: ClassVar[str]
    history: tuple[Stage, ...] = field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        check(self)

    @property
    def summary(self) -> str:
        """What the artifact holds, in one line."""
        return self.kind

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.summary}>"

    def _repr_html_(self) -> str:
        from l3cli.artifacts.notebook import html  # which imports this module; only notebooks ask for it

        return html(repr(self), self)


# ------------------------------------------------------------------------------------------------ declarations


def declared(cls: type) -> tuple[tuple[str, Spec | Group], ...]:
    """Return the name and the declaration of each stored field of a dataclass."""
    return _declared(cls)


@functools.cache
def _declared(cls: type) -> tuple[tuple[str, Spec | Group], ...]:
    hints = typing.get_type_hints(cls)
    found: list[tuple[str, Spec | Group]] = []
    for item in dataclasses.fields(cls):
        if spec := item.metadata.get("spec"):
            found.append((item.name, spec))
        elif "group" in item.metadata:
            hint = hints[item.name]
            several = typing.get_origin(hint) is tuple
            members = typing.get_args(hint) if several or isinstance(hint, types.UnionType) else (hint,)
            kind = next(typing.cast(type, member) for member in members if dataclasses.is_dataclass(member))
            found.append((item.name, Group(kind, several, item.default is not dataclasses.MISSING)))
    return tuple(found)


def is_stored(instance: Any, name: str, spec: Spec) -> bool:
    """Return whether a file of an instance holds a dataset: always, unless it is optional and has its default."""
    return not spec.optional or not np.array_equal(getattr(instance, name), getattr(type(instance), name))


def instances(name: str, value: Any) -> dict[str, Any]:
    """Return the dataclass instances that a field holds, each under the name of its group."""
    if isinstance(value, tuple):
        return {f"{name}/{index}": each for index, each in enumerate(value)}
    return {} if value is None else {name: value}


def check(instance: Any) -> None:
    """Check the declared fields of an instance against their declarations.

    Dtypes and numbers of axes must be as declared, axes of the same name must have the same length, and numbers must be
    finite.

    An axis that a group labels itself, by a dataset of the axis's name, belongs to that group and the groups below it. Axes
    that only the members of a list have may differ in length from member to member.

    Raises
    ------
    ValueError
        If a field does not match its declaration. The message names the field.
    """
    _check(instance, {}, {}, "")


def _check(instance: Any, lengths: dict[str, tuple[int, str]], scopes: dict[str, str], prefix: str) -> None:
    fields = declared(type(instance))
    scopes = scopes | {name: prefix for name, spec in fields if isinstance(spec, Spec) and spec.axes == (name,)}
    for name, spec in fields:
        value = getattr(instance, name)
        if not isinstance(spec, Spec):
            for place, each in instances(name, value).items():
                _check(each, dict(lengths) if spec.several else lengths, scopes, f"{prefix}{place}/")
            continue
        if not is_stored(instance, name, spec):
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
            if (
                array.dtype.kind == "f"
                and array.size
                and not (array.min() >= -LARGEST_VALUE and array.max() <= LARGEST_VALUE)
            ):
                fault = f"beyond ±{LARGEST_VALUE:g}" if np.isfinite(array).all() else "that are not finite"
                raise ValueError(f"{label} holds values {fault}")
        for axis, length in zip(spec.axes, array.shape, strict=True):
            known, where = lengths.setdefault(scopes.get(axis, "") + axis, (length, prefix + name))
            if known != length:
                raise ValueError(f"{label} has {length} along {axis}, but {where} has {known}")


def equal(one: Any, other: Any) -> bool:
    """Return whether all declared fields of two instances of a dataclass hold equal values."""
    for name, spec in declared(type(one)):
        a, b = getattr(one, name), getattr(other, name)
        if isinstance(spec, Spec):
            if not np.array_equal(np.asarray(a), np.asarray(b)):
                return False
        else:
            ours, theirs = instances(name, a), instances(name, b)
            if ours.keys() != theirs.keys() or not all(equal(ours[place], theirs[place]) for place in ours):
                return False
    return True
