"""Artifacts as frozen dataclasses whose field declarations define the HDF5 schema.

`data(dtype, axes, unit, doc)` declares a dataset. `group()` declares a group with the fields of a second dataclass. A field
with the type `tuple[X, ...]` is stored as groups with the names 0, 1, 2…. Saving, loading, checking and `l3 info` all use
these declarations, so a new field must be declared in only one place.
"""

import dataclasses
import functools
import types
import typing
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from l3cli import __version__

LARGEST_VALUE = 1e27  # largest absolute value of a stored number; sums of squares then stay finite


@dataclass(frozen=True)
class Spec:
    """Declaration of a dataset: its type, the names of its axes, its unit and its meaning."""

    dtype: str
    axes: tuple[str, ...]
    unit: str
    doc: str
    coordinate: bool = False  # whether the dataset contains the coordinates of its axis, such as wavelengths or names
    optional: bool = False  # whether the dataset is stored only if its value differs from the default


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
        Names of the axes. Without axes, the dataset is a scalar.
    unit, doc : str
        Unit and meaning, which are stored as attributes of the dataset. `l3 info` prints both.
    default : optional
        Default of the dataclass field. The dataset is stored even if it has this value.
    optional : optional
        Default of a field that is stored only if its value differs from the default. Use this for every field that you
        add to an existing format, so that files that do not need the field stay identical. For arrays, use None.
    coordinate : bool
        Whether the dataset contains the coordinates of its axis, although dataset and axis have different names. A text
        dataset with one axis always contains coordinates.
    """
    is_optional = optional is not dataclasses.MISSING
    spec = Spec(dtype, axes, unit, doc, coordinate or (dtype == "str" and len(axes) == 1), is_optional)
    # The repr contains no arrays, because they would fill pages.
    return field(metadata={"spec": spec}, default=optional if is_optional else default, repr=not axes)


@dataclass(frozen=True)
class Group:
    """Declaration of a group that contains one instance of a dataclass, or several instances in numbered groups."""

    kind: type  # the dataclass
    several: bool  # whether the field is a tuple of instances
    optional: bool  # whether the group may be absent


def group(default: Any = dataclasses.MISSING, kw_only: bool = False) -> Any:
    """Declare a dataclass field that is stored as a group, or as several numbered groups.

    The type of the field is a dataclass X with declared fields, `X | None` or `tuple[X, ...]`.

    Parameters
    ----------
    default : optional
        None or () for a group that may be absent. The group is stored only if the field has a different value.
    kw_only : bool
        As in `dataclasses.field`.
    """
    return field(metadata={"group": True}, default=default, kw_only=kw_only)


@dataclass(frozen=True)
class Stage:
    """One stage in the history of an artifact: the command, its options, its recipe and the digests of its inputs.

    The record contains no time, host name or path. Equal inputs therefore produce artifacts with equal bytes.
    """

    command: str
    options: dict[str, Any]
    recipe: str = ""
    inputs: dict[str, list[str]] = field(default_factory=dict)  # SHA-256 of each input file, by role, such as "camera"
    version: str = __version__


@dataclass(frozen=True, repr=False)
class Artifact:
    """Base class of artifacts, the files that stages exchange. Subclasses set `kind` and `made_by`."""

    kind: ClassVar[str]  # type of the artifact, such as "camera model"
    made_by: ClassVar[str]  # command that writes such artifacts, for messages
    history: tuple[Stage, ...] = field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        check(self)

    @property
    def summary(self) -> str:
        """One line that describes the content of the artifact."""
        return self.kind

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.summary}>"

    def _repr_html_(self) -> str:
        from l3cli.artifacts.notebook import html  # imported here, because notebook imports this module

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
    """Return whether a dataset of an instance is stored.

    Optional datasets are stored only if they differ from the default.
    """
    return not spec.optional or not np.array_equal(getattr(instance, name), getattr(type(instance), name))


def instances(name: str, value: Any) -> dict[str, Any]:
    """Return the dataclass instances in a group field. The keys are the paths of their groups, such as "later/0"."""
    if isinstance(value, tuple):
        return {f"{name}/{index}": each for index, each in enumerate(value)}
    return {} if value is None else {name: value}


def check(instance: Any) -> None:
    """Check that the fields of an instance match their declarations.

    Each field must have the declared dtype and number of axes. Numbers must not exceed LARGEST_VALUE. Axes with the same
    name must have the same length, with two exceptions:

    1. An axis that has the same name as a dataset with only this axis is valid only in the group that contains the dataset
       and in the subgroups of that group. Elsewhere, an axis with the same name may have a different length.
    2. An axis that occurs only in numbered groups may have a different length in each of these groups.

    Raises
    ------
    ValueError
        If a field does not match its declaration. The message contains the name of the field.
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
            raise ValueError(f"{label} has {array.ndim} axes, but must have {len(spec.axes)}")
        if spec.dtype != "str":
            if not np.can_cast(array.dtype, spec.dtype, "same_kind"):
                raise ValueError(f"{label} has the type {array.dtype}, but must have the type {spec.dtype}")
            if array.size and array.dtype.kind == "u" and int(array.max()) > np.iinfo(np.int64).max:
                raise ValueError(f"{label} contains {array.max()}, which does not fit into 63 bits")
            if (
                array.dtype.kind == "f"
                and array.size
                and not (array.min() >= -LARGEST_VALUE and array.max() <= LARGEST_VALUE)
            ):
                fault = f"larger than {LARGEST_VALUE:g}" if np.isfinite(array).all() else "that are not finite"
                raise ValueError(f"{label} contains values {fault}")
        for axis, length in zip(spec.axes, array.shape, strict=True):
            known, where = lengths.setdefault(scopes.get(axis, "") + axis, (length, prefix + name))
            if known != length:
                raise ValueError(
                    f"the axis {axis} of {label} has the length {length}, but in {where} it has the length {known}"
                )


def equal(one: Any, other: Any) -> bool:
    """Return whether all declared fields of two instances of a dataclass have equal values."""
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
