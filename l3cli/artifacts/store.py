"""Reads and writes artifacts, which are HDF5 files with the structure that their dataclasses declare
(docs/artifacts.md).

A file is either written completely or not at all. It contains the history of the stages that produced it.
"""

import contextlib
import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar

import h5py
import msgspec
import numpy as np

from l3cli.artifacts import container
from l3cli.artifacts.container import ENCODING, KNOWN_FILTERS, Stored, encoded, require_readable
from l3cli.artifacts.scales import name_axes
from l3cli.artifacts.schema import Artifact, Group, Spec, Stage, check, declared, instances, is_stored
from l3cli.errors import InputFileError, raised_as
from l3cli.system.files import require_regular
from l3cli.system.text import a

FORMAT_VERSION = 1  # version of all artifacts; new fields are optional, so the version stays (docs/architecture.md)
GZIP_LEVEL = 4
MAX_LISTED_GROUPS = 64  # a damaged file could otherwise claim to contain millions of groups
HDF5_ERRORS = (OSError, RuntimeError, KeyError, TypeError, ValueError, OverflowError)  # errors of h5py for damaged files
HISTORY = Spec("str", (), "1", "JSON: the stages that led here, oldest first")
A = TypeVar("A", bound=Artifact)


# ------------------------------------------------------------------------------------------------------ writing


def write_fields(group: h5py.Group, instance: Any, compressed: bool = True) -> None:
    """Write the declared fields of a dataclass instance to a group, without dimension scales.

    Optional fields that have their default are not written.

    Parameters
    ----------
    group : h5py.Group
        An empty group that is open for writing.
    instance : dataclass
        Instance with fields that `data` and `group` declare.
    compressed : bool
        Whether to compress datasets. Frames are not compressed, because noise hardly compresses, and compression would
        take longer than the simulation.
    """
    for name, spec in declared(type(instance)):
        value = getattr(instance, name)
        if isinstance(spec, Group):
            for place, each in instances(name, value).items():
                write_fields(group.create_group(place), each, compressed)
        elif is_stored(instance, name, spec):
            _write_dataset(group, name, spec, value, compressed)


def _write_dataset(group: h5py.Group, name: str, spec: Spec, value: Any, compressed: bool = True) -> None:
    """Write a dataset, with its axes, unit and meaning as attributes.

    Arrays get a checksum and, if `compressed` is set, are compressed. Texts are stored as bytes.
    """
    is_text = spec.dtype == "str"
    array = encoded(value) if is_text else np.asarray(value, dtype=spec.dtype, order="C")
    storage: dict[str, Any] = {}
    if array.ndim and array.size:
        storage = {"chunks": _chunk(array.shape, array.dtype.itemsize), "fletcher32": True}
        if compressed:
            storage |= {"shuffle": True, "compression": "gzip", "compression_opts": GZIP_LEVEL}
    dataset = group.create_dataset(name, data=array, track_times=False, **storage)
    dataset.attrs["axes"] = ", ".join(spec.axes)
    dataset.attrs["units"] = spec.unit
    dataset.attrs["doc"] = spec.doc
    if is_text:
        dataset.attrs["_Encoding"] = ENCODING  # lets xarray decode the bytes as text


def _chunk(shape: tuple[int, ...], itemsize: int) -> tuple[int, ...]:
    """Return the shape of a chunk of about 1 MiB. It contains the last axes completely, and as much of the first axes as
    fits.
    """
    chunk = list(shape)
    for axis in range(len(shape)):
        others = itemsize * int(np.prod(chunk)) // chunk[axis]
        chunk[axis] = max(1, min(shape[axis], (1 << 20) // max(others, 1)))
    return tuple(chunk)


@contextlib.contextmanager
def new_artifact(path: Path, kind: str, history: tuple[Stage, ...]) -> Iterator[h5py.File]:
    """Yield a new HDF5 file whose root contains kind, version and history.

    The file gets the name `path` when the block ends without an error.
    """
    stages = json.dumps([dataclasses.asdict(stage) for stage in history], sort_keys=True, ensure_ascii=False)
    with container.new_file(path) as root:
        root.attrs["kind"] = kind
        root.attrs["version"] = np.int64(FORMAT_VERSION)
        _write_dataset(root, "history", HISTORY, stages)
        yield root


def save(artifact: Artifact, path: Path) -> None:
    """Write an artifact to `path`. If this fails, no file is left behind."""
    with new_artifact(path, artifact.kind, artifact.history) as root:
        write_fields(root, artifact)
        name_axes(root, type(artifact), {}, artifact)


# ------------------------------------------------------------------------------------------------------ reading


@contextlib.contextmanager
def open_artifact(path: Path, *expected: type[Artifact], unchanged: bool = False) -> Iterator[h5py.File]:
    """Open the file of an artifact for reading.

    Parameters
    ----------
    path : Path
        The file.
    *expected : type
        The accepted kinds of artifacts. If there are none, all kinds are accepted.
    unchanged : bool
        Whether the checksum was already compared in this run, so that the comparison can be skipped.

    Raises
    ------
    InputFileError
        If the file has changed since it was written, if it is not an artifact of an accepted kind, or if it has a
        different format version.
    """
    made_by = expected[0].made_by if expected else "an l3 command"
    if not path.exists() and not path.is_symlink():
        raise InputFileError(f"{path} does not exist; create it with {made_by}")
    require_regular(path, f"use a file written by {made_by}")
    if not unchanged:
        container.check(path, made_by)
    try:
        root = container.open_file(path)
    except OSError as error:
        raise InputFileError(f"{path} is truncated or damaged; create it again with {made_by}") from error
    with root:
        try:
            kind, version = str(root.attrs["kind"]), int(root.attrs["version"])
        except HDF5_ERRORS as error:
            raise InputFileError(
                f"{path} is an HDF5 file but not an l3 artifact; use a file written by {made_by}"
            ) from error
        makers = {each.kind: each.made_by for each in expected}
        if expected and kind not in makers:
            raise InputFileError(f"{path} contains {a(kind)}; use a file written by {made_by}")
        if version != FORMAT_VERSION:
            again = f"create the file again with {makers.get(kind, 'the l3 command that wrote it')}"
            raise InputFileError(
                f"{path} has format version {version}, but this version of l3 reads only version {FORMAT_VERSION}; {again}"
            )
        yield root


def load(cls: type[A], path: Path) -> A:
    """Read an artifact.

    Parameters
    ----------
    cls : type
        The kind of artifact, such as CameraModel or TransformTable.
    path : Path
        The file.

    Returns
    -------
    instance of `cls`
        The artifact. Its arrays are read-only.

    Raises
    ------
    InputFileError
        If the file is missing, damaged or of another kind. The message contains the file, the dataset and a remedy.
    """
    with open_artifact(path, cls) as root:
        return read_fields(root, cls, path, history=read_history(root, path))


def read_history(root: h5py.File, path: Path) -> tuple[Stage, ...]:
    """Return the stages that produced an artifact, oldest first. Raises InputFileError if the history is damaged."""
    text = _read_dataset(root, "history", HISTORY, path)
    try:
        return tuple(msgspec.json.decode(text, type=list[Stage]))
    except (msgspec.MsgspecError, UnicodeEncodeError, RecursionError) as error:
        raise InputFileError(f"{path}: dataset history is not valid JSON; create the file again") from error


def read_fields(group: h5py.Group, cls: type, path: Path, **extra: Any) -> Any:
    """Read an instance of a dataclass from the datasets in a group.

    Parameters
    ----------
    group : h5py.Group
        The group.
    cls : type
        Dataclass with fields that `data` and `group` declare.
    path : Path
        Name of the file, for messages.
    **extra
        Values of fields that are not stored in the group, such as the history.

    Raises
    ------
    InputFileError
        If a dataset that is not optional is missing, or if a dataset does not agree with its declaration.
    """
    values = dict(extra)
    held = members(group, path)
    with raised_as(InputFileError, path, cure="; create the file again"):
        for name, spec in declared(cls):
            if name not in held and spec.optional:
                continue
            if isinstance(spec, Spec):
                values[name] = _read_dataset(group, name, spec, path)
            else:
                values[name] = _read_group(group, name, spec, path)
        instance = cls(**values)
        if not isinstance(instance, Artifact):  # artifacts check themselves
            check(instance)
    return instance


def _read_group(group: h5py.Group, name: str, spec: Group, path: Path) -> Any:
    """Read the instance, or the tuple of instances, in a declared group.

    Raises InputFileError if the group is missing, damaged, or contains too many groups.
    """
    below = hard_group(group, name, path)
    if not spec.several:
        return read_fields(below, spec.kind, path)
    count = len(members(below, path))
    if count > MAX_LISTED_GROUPS:
        raise InputFileError(
            f"{path}: {_inside(group, name)} contains more than {MAX_LISTED_GROUPS} groups; create the file again"
        )
    return tuple(read_fields(hard_group(below, str(index), path), spec.kind, path) for index in range(count))


def _inside(group: h5py.Group, name: str) -> str:
    """Return the path of a member within its file."""
    return f"{group.name.rstrip('/')}/{name}".lstrip("/")


@contextlib.contextmanager
def reading(path: Path, what: str) -> Iterator[None]:
    """Convert the errors that h5py raises for damaged files to InputFileError."""
    try:
        yield
    except (*HDF5_ERRORS, UnicodeDecodeError) as error:
        raise InputFileError(f"{path}: {what} is damaged (checksum); create the file again") from error


def members(group: h5py.Group, path: Path) -> list[str]:
    """Return the names of the members of a group, sorted."""
    with reading(path, f"the group {group.name}"):
        return sorted(group)


def hard_group(group: h5py.Group, name: str, path: Path) -> h5py.Group:
    """Return a group in the same file below `group`. Raises InputFileError if there is none."""
    with reading(path, f"the group {_inside(group, name)}"):
        return _member(group, name, h5py.Group, "group", path)


def _member(group: h5py.Group, name: str, kind: type, what: str, path: Path) -> Any:
    """Return a member of a group that is stored in this file. Soft and external links raise InputFileError."""
    link = group.get(name, getlink=True)
    if not isinstance(link, h5py.HardLink):
        fault = "is missing" if link is None else "is a link to another place"
        raise InputFileError(f"{path}: the {what} {_inside(group, name)} {fault}; create the file again")
    member = group[name]
    if not isinstance(member, kind):
        raise InputFileError(f"{path}: {_inside(group, name)} is not a {what}; create the file again")
    return member


def require_plain(dataset: h5py.h5d.DatasetID, path: Path) -> Stored:
    """Return how a dataset is stored.

    Raises InputFileError if it is too large, or stored with a filter that l3 never uses.
    """
    stored = require_readable(path, dataset)
    if not stored.filters <= KNOWN_FILTERS:
        raise InputFileError(f"{path}: dataset {stored.where} uses an HDF5 filter that l3 never uses; create the file again")
    return stored


def _read_dataset(group: h5py.Group, name: str, spec: Spec, path: Path) -> Any:
    """Read a dataset: as a string, a tuple of strings, a number, or an array that cannot be changed.

    Raises InputFileError if the dataset is missing or damaged, or if its type or its number of axes differs from the
    declaration.
    """
    is_text = spec.dtype == "str"
    expected_kind = "S" if is_text else np.dtype(spec.dtype).kind
    with reading(path, f"dataset {_inside(group, name)}"):
        dataset = _member(group, name, h5py.Dataset, "dataset", path)
        stored = require_plain(dataset.id, path)
        is_empty = not (stored.shape or stored.size)
        if stored.dtype.kind != expected_kind or len(stored.shape) != len(spec.axes) or is_empty:
            raise InputFileError(
                f"{path}: dataset {stored.where} has the type {stored.dtype} and {len(stored.shape)} axes, but must have "
                f"the type {spec.dtype} and the axes ({', '.join(spec.axes)}); create the file again"
            )
        array = dataset[()]
        if is_text:
            decoded = np.char.decode(array, ENCODING)
            return tuple(str(item) for item in decoded) if spec.axes else str(decoded)
    if not spec.axes:
        return np.asarray(array, dtype=spec.dtype).item()
    array = np.asarray(array, dtype=spec.dtype)
    array.flags.writeable = False
    return array
