"""Read and write artifacts as HDF5 files (docs/artifacts.md). The dataclass of an artifact declares the file's structure.

Each file contains the history of the stages that produced it. If writing fails, no incomplete file remains.
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

FORMAT_VERSION = 1  # version of all artifacts; new fields are optional and do not change it (docs/architecture.md)
GZIP_LEVEL = 4
MAX_LISTED_GROUPS = 64  # limit for numbered groups, because a damaged file could contain millions
HDF5_ERRORS = (OSError, RuntimeError, KeyError, TypeError, ValueError, OverflowError)  # raised by h5py for damaged files
HISTORY = Spec("str", (), "1", "JSON: the stages that led to this artifact, oldest first")
A = TypeVar("A", bound=Artifact)


# ------------------------------------------------------------------------------------------------------ writing


def write_fields(group: h5py.Group, instance: Any, compressed: bool = True) -> None:
    """Write the declared fields of a dataclass instance to a group, without dimension scales.

    Optional fields are written only if they differ from their default.

    Parameters
    ----------
    group : h5py.Group
        An empty group that is open for writing.
    instance : dataclass
        Instance with fields declared by `data` and `group`.
    compressed : bool
        Whether to compress arrays. Use False for frames: noise hardly compresses, and the compression would take longer than
        the simulation.
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

    Arrays get a checksum, and text is stored as fixed-length UTF-8.
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
    """Return a chunk shape of at most about 1 MiB. Leading axes are shortened first."""
    chunk = list(shape)
    for axis in range(len(shape)):
        others = itemsize * int(np.prod(chunk)) // chunk[axis]
        chunk[axis] = max(1, min(shape[axis], (1 << 20) // max(others, 1)))
    return tuple(chunk)


@contextlib.contextmanager
def new_artifact(path: Path, kind: str, history: tuple[Stage, ...]) -> Iterator[h5py.File]:
    """Create an artifact file in a `with` block. Its type, version and history are written first.

    The file is written under a temporary name, and renamed to `path` if the block ends without an error. Otherwise no file
    remains.
    """
    stages = json.dumps([dataclasses.asdict(stage) for stage in history], sort_keys=True, ensure_ascii=False)
    with container.new_file(path) as root:
        root.attrs["kind"] = kind
        root.attrs["version"] = np.int64(FORMAT_VERSION)
        _write_dataset(root, "history", HISTORY, stages)
        yield root


def save(artifact: Artifact, path: Path) -> None:
    """Write an artifact to `path`, replacing an existing file. After an error, no incomplete file remains."""
    with new_artifact(path, artifact.kind, artifact.history) as root:
        write_fields(root, artifact)
        name_axes(root, type(artifact), {}, artifact)


# ------------------------------------------------------------------------------------------------------ reading


@contextlib.contextmanager
def open_artifact(path: Path, *expected: type[Artifact], unchanged: bool = False) -> Iterator[h5py.File]:
    """Open an artifact for reading in a `with` block.

    Parameters
    ----------
    path : Path
        The file.
    *expected : type
        The accepted types of artifacts, such as CameraModel. By default, all types are accepted.
    unchanged : bool
        Skip the verification of the digest, for a file that the current run has already verified.

    Raises
    ------
    InputFileError
        If the file does not exist, has changed since it was written, is not an artifact of an accepted type, or has a
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
        The type of the artifact, such as CameraModel or TransformTable.
    path : Path
        The file.

    Returns
    -------
    instance of `cls`
        The artifact. Its arrays are read-only.

    Raises
    ------
    InputFileError
        If the file does not exist, is damaged, or contains a different type of artifact.
    """
    with open_artifact(path, cls) as root:
        return read_fields(root, cls, path, history=read_history(root, path))


def read_history(root: h5py.File, path: Path) -> tuple[Stage, ...]:
    """Read the stages that produced an artifact, oldest first. Raises InputFileError if the history is damaged."""
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
        Dataclass with fields declared by `data` and `group`.
    path : Path
        Name of the file, for error messages.
    **extra
        Values of fields that are not stored in the group, such as the history.

    Raises
    ------
    InputFileError
        If a required dataset or group is missing, or if a dataset does not match its declaration.
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
        if not isinstance(instance, Artifact):  # the constructor of an artifact calls `check`
            check(instance)
    return instance


def _read_group(group: h5py.Group, name: str, spec: Group, path: Path) -> Any:
    """Read the dataclass instance, or the tuple of instances, in a group.

    Raises InputFileError if the group is missing or damaged, or contains more than MAX_LISTED_GROUPS groups.
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
    return f"{group.name.rstrip('/')}/{name}".lstrip("/")


@contextlib.contextmanager
def reading(path: Path, what: str) -> Iterator[None]:
    """Convert the errors that h5py raises for damaged files to InputFileError, in a `with` block.

    `what` describes the part of the file that is being read, for the error message.
    """
    try:
        yield
    except (*HDF5_ERRORS, UnicodeDecodeError) as error:
        raise InputFileError(f"{path}: {what} is damaged; create the file again") from error


def members(group: h5py.Group, path: Path) -> list[str]:
    """Return the sorted names of a group's members."""
    with reading(path, f"the group {group.name}"):
        return sorted(group)


def hard_group(group: h5py.Group, name: str, path: Path) -> h5py.Group:
    """Open the subgroup `name` of a group. Raises InputFileError if it is missing, or is a soft or external link."""
    with reading(path, f"the group {_inside(group, name)}"):
        return h5py.Group(_member(group, name, h5py.h5g.GroupID, "group", path))


def _member(group: h5py.Group, name: str, kind: type, what: str, path: Path) -> Any:
    """Open a member of a group with h5py's low-level interface, which needs half the time of `group[name]`.

    Raises InputFileError if the member is missing, is not an instance of `kind`, or is a soft or external link.
    """
    encoded_name, links = name.encode(), group.id.links
    exists = links.exists(encoded_name)
    if not exists or links.get_info(encoded_name).type != h5py.h5l.TYPE_HARD:
        fault = "is a link to a different place" if exists else "is missing"
        raise InputFileError(f"{path}: the {what} {_inside(group, name)} {fault}; create the file again")
    member = h5py.h5o.open(group.id, encoded_name)
    if not isinstance(member, kind):
        raise InputFileError(f"{path}: {_inside(group, name)} is not a {what}; create the file again")
    return member


def require_plain(dataset: h5py.h5d.DatasetID, path: Path) -> Stored:
    """Check that a dataset is readable and uses only l3's own HDF5 filters, and return its type and size.

    Raises InputFileError otherwise.
    """
    stored = require_readable(path, dataset)
    if not stored.filters <= KNOWN_FILTERS:
        raise InputFileError(f"{path}: dataset {stored.where} uses an HDF5 filter that l3 never uses; create the file again")
    return stored


def _read_dataset(group: h5py.Group, name: str, spec: Spec, path: Path) -> Any:
    """Read a dataset as a string, a tuple of strings, a number or a read-only array, depending on its declaration.

    Raises InputFileError if the dataset is missing or damaged, or does not have the declared type and number of axes.
    """
    is_text = spec.dtype == "str"
    expected_kind = "S" if is_text else np.dtype(spec.dtype).kind
    with reading(path, f"dataset {_inside(group, name)}"):
        dataset = _member(group, name, h5py.h5d.DatasetID, "dataset", path)
        stored = require_plain(dataset, path)
        is_empty = not (stored.shape or stored.size)
        if stored.dtype.kind != expected_kind or len(stored.shape) != len(spec.axes) or is_empty:
            raise InputFileError(
                f"{path}: dataset {stored.where} has the type {stored.dtype} and {len(stored.shape)} axes, but must have "
                f"the type {spec.dtype} and the axes ({', '.join(spec.axes)}); create the file again"
            )
        array = np.zeros(stored.shape, stored.dtype)
        if array.size:
            dataset.read(h5py.h5s.ALL, h5py.h5s.ALL, array)
        if is_text:
            decoded = np.char.decode(array, ENCODING)
            return tuple(str(item) for item in decoded) if spec.axes else str(decoded)
    if not spec.axes:
        return np.asarray(array, dtype=spec.dtype).item()
    array = np.asarray(array, dtype=spec.dtype)
    array.flags.writeable = False
    return array
