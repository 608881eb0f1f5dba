"""Artifacts as frozen dataclasses: the declarations of their fields define the HDF5 schema.

`data(dtype, axes, unit, doc)` declares a dataset. `group()` declares a group with the fields of a second dataclass. A field
of type `tuple[X, ...]` is stored as groups named 0, 1, 2…. Saving, loading, validation and `l3 info` all use these
declarations, so a new field needs to be declared in only one place.
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
    """Declaration of a dataset: type, axis names, unit and meaning."""

    dtype: str
    axes: tuple[str, ...]
    unit: str
    doc: str
    coordinate: bool = False  # whether the dataset contains axis coordinates, such as wavelengths or channel names
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
        Unit and meaning, which are stored as attributes of the dataset and printed by `l3 info`.
    default : optional
        Default of the dataclass field. The dataset is stored even if it has this value.
    optional : optional
        Default of a field that is stored only if its value differs from the default. Use this instead of `default` for
        each field that you add to an existing format, so that files without the field stay identical. For arrays, use
        None.
    coordinate : bool
        Whether the dataset contains the coordinates of its axis even though it is not named after the axis. A text dataset
        with one axis always contains coordinates.
    """
    is_optional = optional is not dataclasses.MISSING
    spec = Spec(dtype, axes, unit, doc, coordinate or (dtype == "str" and len(axes) == 1), is_optional)
    # Arrays would fill pages, so the repr omits them.
    return field(metadata={"spec": spec}, default=optional if is_optional else default, repr=not axes)


@dataclass(frozen=True)
class Group:
    """Declaration of a group that stores a dataclass instance, or a tuple of instances in numbered subgroups."""

    kind: type  # the dataclass
    several: bool  # whether the field is a tuple of instances
    optional: bool  # whether the group may be absent


def group(default: Any = dataclasses.MISSING, kw_only: bool = False) -> Any:
    """Declare a dataclass field that is stored as a group, or as several numbered groups.

    The field must have the type `X`, `X | None` or `tuple[X, ...]`, where X is a dataclass with declared fields.

    Parameters
    ----------
    default : optional
        None or () for an optional group, which is stored only if the field has a different value.
    kw_only : bool
        As in `dataclasses.field`.
    """
    return field(metadata={"group": True}, default=default, kw_only=kw_only)


@dataclass(frozen=True)
class Stage:
    """One stage in the history of an artifact: the command, its options, its recipe and the digests of its inputs.

    Times, host names and paths are not recorded, so that equal inputs produce identical artifacts.
    """

    command: str
    options: dict[str, Any]
    recipe: str = ""
    inputs: dict[str, list[str]] = field(default_factory=dict)  # SHA-256 of each input file, by role, such as "camera"
    version: str = __version__


@dataclass(frozen=True, repr=False)
class Artifact:
    """Base class of artifacts, the files through which stages exchange data. Subclasses set `kind` and `made_by`."""

    kind: ClassVar[str]  # type of the artifact, such as "camera model"
    made_by: ClassVar[str]  # command that writes such artifacts, for error messages
    history: tuple[Stage, ...] = field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        check(self)

    @property
    def summary(self) -> str:
        """One-line description of the artifact's content."""
        return self.kind

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.summary}>"

    def _repr_html_(self) -> str:
        from l3cli.artifacts.notebook import html  # avoids a circular import

        return html(repr(self), self)


# ------------------------------------------------------------------------------------------------ declarations


def declared(cls: type) -> tuple[tuple[str, Spec | Group], ...]:
    """Return the name and the declaration of each field that a dataclass declares with `data` or `group`."""
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
    """Return whether a dataset is written to the file. Only an optional dataset with its default value is omitted."""
    return not spec.optional or not np.array_equal(getattr(instance, name), getattr(type(instance), name))


def instances(name: str, value: Any) -> dict[str, Any]:
    """Return the dataclass instances in a group field, by the path of their group, such as "later/0"."""
    if isinstance(value, tuple):
        return {f"{name}/{index}": each for index, each in enumerate(value)}
    return {} if value is None else {name: value}


def check(instance: Any) -> None:
    """Check that the fields of an instance match their declarations.

    Each field must have the declared dtype and number of axes. Numbers must not exceed LARGEST_VALUE. Axes with the same
    name must have the same length, with two exceptions:

    1. If a group contains a coordinate dataset named after an axis, such as `wavelength`, the axis is local to this group
       and its subgroups. In other groups, its length may differ.
    2. An axis that occurs only in numbered groups may have a different length in each of them.

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
            raise ValueError(f"{label} has {array.ndim} axes, but must have {len(spec.axes)}")
        if spec.dtype != "str":
            if not np.can_cast(array.dtype, spec.dtype, "same_kind"):
                raise ValueError(f"{label} has type {array.dtype}, but must have type {spec.dtype}")
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
                raise ValueError(f"the axis {axis} has length {length} in {label}, but length {known} in {where}")


def equal(one: Any, other: Any) -> bool:
    """Return whether two instances of a dataclass have equal values in all declared fields."""
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
