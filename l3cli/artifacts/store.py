"""Reading and writing of artifacts: HDF5 files laid out as their dataclasses declare (docs/artifacts.md).

A file is written completely or not at all, and carries the history of the stages that led to it. `verify` checks that it
has not changed since, and `chain` which of the files at hand it was made from.
"""

import contextlib
import dataclasses
import functools
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import h5py
import msgspec
import numpy as np
from h5py import h5a, h5d, h5g, h5l, h5o, h5p, h5s, h5t

from l3cli.artifacts import container
from l3cli.artifacts.container import ENCODING, KNOWN_FILTERS, Stored, datasets, encoded, is_scale, require_readable
from l3cli.artifacts.schema import Artifact, Group, Spec, Stage, check, declared, instances
from l3cli.errors import InputFileError, raised_as
from l3cli.system.files import require_regular
from l3cli.system.limits import read_bounded
from l3cli.system.text import a

GZIP_LEVEL = 4
MAX_LISTED_GROUPS = 64  # refuses damaged files that claim millions
SEALED = 2  # format version from which every file carries its digest
LENGTH_ALONE = "This is a netCDF dimension but not a netCDF variable.%10d"  # NAME that netCDF-4 gives to axes without values
TEXT = h5py.string_dtype()
TEXT_TYPE, SCALAR = h5t.py_create(TEXT, logical=True), h5s.create(h5s.SCALAR)
REFERENCES = np.dtype([("dataset", h5py.ref_dtype), ("dimension", "<i4")])


HDF5_ERRORS = (OSError, RuntimeError, KeyError, TypeError, ValueError, OverflowError)  # h5py raises any of these on damage
A = TypeVar("A", bound=Artifact)


# ------------------------------------------------------------------------------------------------------ writing


def write_fields(group: h5py.Group, instance: Any, compressed: bool = True) -> None:
    """Write every declared field of a dataclass instance below a group, without dimension scales.

    Parameters
    ----------
    group : h5py.Group
        An empty group open for writing.
    instance : dataclass
        Instance with fields declared by `data` and `group`.
    compressed : bool
        False for frames: noise hardly compresses, and compressing it takes longer than simulating it.
    """
    for name, spec, _ in declared(type(instance)):
        value = getattr(instance, name)
        if isinstance(spec, Spec):
            _write_dataset(group, name, spec, value, compressed)
        else:
            for place, each in instances(name, value).items():
                write_fields(group.create_group(place), each, compressed)


def _write_dataset(group: h5py.Group, name: str, spec: Spec, value: Any, compressed: bool = True) -> None:
    """Write a dataset and its attributes. The low-level calls take half the time of `create_dataset` and `attrs`."""
    is_text = spec.dtype == "str"
    array = encoded(value) if is_text else np.asarray(value, dtype=spec.dtype, order="C")
    created = h5p.create(h5p.DATASET_CREATE)
    created.set_obj_track_times(False)
    if array.ndim and array.size:
        created.set_chunk(_chunk(array.shape, array.dtype.itemsize))
        if compressed:
            created.set_shuffle()
            created.set_deflate(GZIP_LEVEL)
        created.set_fletcher32()
    kind = h5t.py_create(array.dtype, logical=True)
    dataset = h5d.create(group.id, name.encode(), kind, h5s.create_simple(array.shape), created)
    dataset.write(h5s.ALL, h5s.ALL, array)
    texts = {"axes": ", ".join(spec.axes), "units": spec.unit, "doc": spec.doc}
    if is_text:
        texts["_Encoding"] = ENCODING  # tells xarray that the bytes are text
    for key, text in texts.items():
        h5a.create(dataset, key.encode(), TEXT_TYPE, SCALAR).write(np.array(text, TEXT))


def _chunk(shape: tuple[int, ...], itemsize: int) -> tuple[int, ...]:
    """Return the shape of a chunk of about one mebibyte: whole trailing axes, and as many leading ones as fit."""
    chunk = list(shape)
    for axis in range(len(shape)):
        others = itemsize * int(np.prod(chunk)) // chunk[axis]
        chunk[axis] = max(1, min(shape[axis], (1 << 20) // max(others, 1)))
    return tuple(chunk)


@contextlib.contextmanager
def new_artifact(path: Path, kind: str, version: int, history: tuple[Stage, ...]) -> Iterator[h5py.File]:
    """Yield a new HDF5 file whose root holds kind, version and history.

    The file appears at `path` when the block ends without an error.
    """
    stages = json.dumps([dataclasses.asdict(stage) for stage in history], sort_keys=True, ensure_ascii=False)
    with container.new_file(path) as root:
        root.attrs["kind"] = kind
        root.attrs["version"] = np.int64(version)
        _write_dataset(root, "history", Spec("str", (), "1", "JSON: the stages that led here, oldest first"), stages)
        yield root


def save(artifact: Artifact, path: Path) -> None:
    """Write an artifact to `path`, completely or not at all."""
    with new_artifact(path, artifact.kind, artifact.version, artifact.history) as root:
        write_fields(root, artifact)
        name_axes(root, type(artifact), {}, artifact)


# ------------------------------------------------------------------------------------------------------- scales
#
# Axes are named by HDF5 dimension scales, which xarray, netCDF tools and `dims` of h5py understand. Each axis of a group's
# datasets has one scale with its name in that group. The scale is one of:
#   1. the declared dataset of the same name, which holds the values along the axis (wavelength),
#   2. a copy of a declared dataset of another name (`channels` for the axis channel),
#   3. a dataset without values, as in netCDF, which states only the length.
# l3 itself reads no scale and follows no reference of one.


Coordinates = Mapping[str, tuple[Any, Spec]]  # axis → the values along it, and their declaration


def coordinates_of(content: Any) -> Coordinates:
    """Return the values that an instance's fields give along its axes, by axis."""
    kind: type = type(content)
    fields = {name: spec for name, spec in _layout(kind)[0].items() if spec.coordinate}
    return {spec.axes[0]: (getattr(content, name), spec) for name, spec in fields.items()}


def name_axes(group: h5py.Group, kind: type, above: Coordinates, content: Any = None) -> None:
    """Write the dimension scales of a group and of the groups below it.

    Parameters
    ----------
    group : h5py.Group
        A group in which an instance of `kind` is stored.
    kind : type
        The dataclass that declares the group.
    above : mapping
        Coordinates that the groups above provide.
    content : dataclass, optional
        The stored instance, which provides the coordinates of its group and those below.
    """
    known = above if content is None else {**above, **coordinates_of(content)}
    _write_scales(group, kind, known)
    for name, below in _layout(kind)[1].items():
        held = (
            {place: None for place in [name] if place in group}
            if content is None
            else instances(name, getattr(content, name))
        )
        for place, each in held.items():
            name_axes(group[place], below.kind, known, each)


@functools.cache
def _layout(kind: type) -> tuple[dict[str, Spec], dict[str, Group]]:
    """Return the datasets with axes, and the groups, that a dataclass declares."""
    members = [(name, member) for name, member, _ in declared(kind)]
    return (
        {name: member for name, member in members if isinstance(member, Spec) and member.axes},
        {name: member for name, member in members if not isinstance(member, Spec)},
    )


def _write_scales(group: h5py.Group, kind: type, known: Coordinates) -> None:
    """Write one scale per axis of a group, and the references between scales and datasets.

    Each list of references is written once. h5py's `attach_scale` would rewrite it for every dataset.
    """
    held = {name: spec for name, spec in _layout(kind)[0].items() if group.id.links.exists(name.encode())}
    fields = {name: (spec, h5py.Dataset(h5d.open(group.id, name.encode()))) for name, spec in held.items()}
    scales: dict[str, h5py.Dataset] = {}
    attached: dict[str, list[tuple[h5py.Reference, int]]] = {}
    for spec, dataset in fields.values():
        for axis, length in zip(spec.axes, dataset.shape, strict=True):
            if axis in fields and axis not in scales:
                scales[axis] = fields[axis][1]
                scales[axis].make_scale(axis)
            elif axis not in scales:
                scales[axis] = _new_scale(group, axis, length, known.get(axis))
    for name, (spec, dataset) in fields.items():
        if spec.axes != (name,):
            for index, axis in enumerate(spec.axes):
                attached.setdefault(axis, []).append((dataset.ref, index))
            lists = np.empty(len(spec.axes), object)
            lists[:] = [np.array([scales[axis].ref], h5py.ref_dtype) for axis in spec.axes]
            dataset.attrs.create("DIMENSION_LIST", lists, dtype=h5py.vlen_dtype(h5py.ref_dtype))
    for axis, references in attached.items():
        scales[axis].attrs.create("REFERENCE_LIST", np.array(references, REFERENCES), dtype=REFERENCES)


def _new_scale(group: h5py.Group, axis: str, length: int, known: tuple[Any, Spec] | None) -> h5py.Dataset:
    """Return a scale that is no declared dataset: with values if they are known, otherwise with a length only."""
    if known is None or len(known[0]) != length or not length:
        scale = group.create_dataset(axis, (length,), ">f4", track_times=False)
        scale.make_scale(LENGTH_ALONE % length)
        return scale
    values, spec = known
    is_text = spec.dtype == "str"
    values = encoded(values) if is_text else np.asarray(values, spec.dtype)
    scale = group.create_dataset(axis, data=values, track_times=False)
    scale.make_scale(axis)
    scale.attrs["_Encoding" if is_text else "units"] = ENCODING if is_text else spec.unit
    return scale


# ------------------------------------------------------------------------------------------------------ reading


@contextlib.contextmanager
def open_artifact(path: Path, *expected: type[Artifact], unchanged: bool = False) -> Iterator[h5py.File]:
    """Yield the root of an artifact's file, open for reading.

    Parameters
    ----------
    path : Path
    *expected : type
        The kinds of artifact that are accepted; all kinds if none is given.
    unchanged : bool
        Skip the comparison of the bytes with their digest, because this run has already made it.

    Raises
    ------
    InputFileError
        If the file has changed since it was written, is no artifact of an expected kind, or has a newer format version.
    """
    made_by = expected[0].made_by if expected else "an l3 command"
    if not path.exists() and not path.is_symlink():
        raise InputFileError(f"{path} does not exist; make it with {made_by}")
    require_regular(path, f"give the file written by {made_by}")
    sealed = unchanged or container.check(path, made_by)
    try:
        root = container.open_file(path)
    except OSError as error:
        raise InputFileError(f"{path} is truncated or damaged; make it again with {made_by}") from error
    with root:
        try:
            kind, version = str(root.attrs["kind"]), int(root.attrs["version"])
        except HDF5_ERRORS as error:
            raise InputFileError(f"{path} is an HDF5 file but no l3 artifact; give the file written by {made_by}") from error
        if version >= SEALED and not sealed:
            raise InputFileError(f"{path} lacks the digest of its bytes; make it again with {made_by}")
        if expected:
            newest = {each.kind: each.version for each in expected}
            if kind not in newest:
                raise InputFileError(f"{path} holds {a(kind)}; give the file written by {made_by}")
            if version > newest[kind]:
                raise InputFileError(
                    f"{path} has version {version} of the {kind} format, this l3 reads up to {newest[kind]}; upgrade l3cli"
                )
        yield root


def load(cls: type[A], path: Path) -> A:
    """Read an artifact.

    Parameters
    ----------
    cls : type
        The kind of artifact: CameraModel, TransformTable…
    path : Path

    Returns
    -------
    instance of `cls`
        Its arrays are read-only.

    Raises
    ------
    InputFileError
        If the file is missing, damaged or of another kind. The message names the file, the dataset and the remedy.
    """
    with open_artifact(path, cls) as root:
        return read_fields(root, cls, path, history=read_history(root, path))


def read_history(root: h5py.File, path: Path) -> tuple[Stage, ...]:
    """Return the stages that led to an artifact, oldest first."""
    text = _read_dataset(root, "history", Spec("str", (), "1", ""), path)
    try:
        return tuple(msgspec.json.decode(text, type=list[Stage]))
    except (msgspec.MsgspecError, UnicodeEncodeError, RecursionError) as error:
        raise InputFileError(f"{path}: dataset history is not the JSON that l3 writes; make the file again") from error


def read_fields(group: h5py.Group, cls: type, path: Path, **extra: Any) -> Any:
    """Return an instance of a dataclass from the datasets below a group.

    Parameters
    ----------
    group : h5py.Group
    cls : type
        Dataclass with fields declared by `data` and `group`.
    path : Path
        Name of the file in messages.
    **extra
        Values of fields that are not stored in the group, such as the history.

    Raises
    ------
    InputFileError
        If a required dataset is missing, or a dataset does not match its declaration.
    """
    values = dict(extra)
    held = members(group, path)
    with raised_as(InputFileError, path, cure="; make the file again"):
        for name, spec, optional in declared(cls):
            if isinstance(spec, Spec) and (name in held or spec.formerly in held or not optional):
                values[name] = _read_dataset(
                    group, spec.formerly if name not in held and spec.formerly else name, spec, path
                )
            elif isinstance(spec, Group) and (name in held or not optional):
                values[name] = _read_group(group, name, spec, path)
            elif isinstance(spec, Group) and spec.older:
                values[name] = spec.older(group, path)
        instance = cls(**values)
        if not isinstance(instance, Artifact):  # which checks itself
            check(instance)
    return instance


def _read_group(group: h5py.Group, name: str, spec: Group, path: Path) -> Any:
    """Return the instance, or the tuple of instances, that a declared group holds."""
    if spec.since and group.name == "/" and int(group.file.attrs["version"]) < spec.since:
        return read_fields(group, spec.kind, path)
    if not group.id.links.exists(name.encode()):
        raise InputFileError(f"{path} lacks the group {_inside(group, name)}; make the file again")
    below = hard_group(group, name, path)
    if not spec.several:
        return read_fields(below, spec.kind, path)
    count = len(members(below, path))
    if count > MAX_LISTED_GROUPS:
        raise InputFileError(
            f"{path}: {_inside(group, name)} holds more than {MAX_LISTED_GROUPS} groups; make the file again"
        )
    return tuple(read_fields(hard_group(below, str(index), path), spec.kind, path) for index in range(count))


def _inside(group: h5py.Group, name: str) -> str:
    """Return the path of a member within its file."""
    return f"{group.name.rstrip('/')}/{name}".lstrip("/")


@contextlib.contextmanager
def reading(path: Path, what: str) -> Iterator[None]:
    """Within the block, raise InputFileError instead of the errors that h5py raises on damaged files."""
    try:
        yield
    except (*HDF5_ERRORS, UnicodeDecodeError) as error:
        raise InputFileError(f"{path}: {what} is damaged (checksum); make the file again") from error


def members(group: h5py.Group, path: Path) -> list[str]:
    """Return the names of a group's members, sorted."""
    with reading(path, f"the group {group.name}"):
        return sorted(group)


def hard_group(group: h5py.Group, name: str, path: Path) -> h5py.Group:
    """Return a group stored below `group` in the same file; InputFileError if there is none."""
    with reading(path, f"the group {_inside(group, name)}"):
        return h5py.Group(_hard(group, name, h5g.GroupID, path))


def _hard(group: h5py.Group, name: str, kind: type, path: Path) -> Any:
    """Return the identifier of a member that is stored in this file. Soft and external links are refused."""
    key = name.encode()
    if not group.id.links.exists(key) or group.id.links.get_info(key).type != h5l.TYPE_HARD:
        what = "lacks" if name not in group else "links away"
        raise InputFileError(f"{path} {what} the dataset {_inside(group, name)}; make the file again")
    member = h5o.open(group.id, key)
    if not isinstance(member, kind):
        what = "dataset" if kind is h5d.DatasetID else "group"
        raise InputFileError(f"{path}: {_inside(group, name)} is not a {what}; make the file again")
    return member


def require_plain(dataset: h5d.DatasetID, path: Path) -> Stored:
    """Return how a dataset is stored; InputFileError if it is too large, or stored in a way that l3 never uses."""
    stored = require_readable(path, dataset)
    if not stored.filters <= KNOWN_FILTERS:
        raise InputFileError(f"{path}: dataset {stored.where} is stored as l3 never stores one; make the file again")
    return stored


def _read_dataset(group: h5py.Group, name: str, spec: Spec, path: Path) -> Any:
    with reading(path, f"dataset {_inside(group, name)}"):
        return _read_validated(group, name, spec, path)


def _read_validated(group: h5py.Group, name: str, spec: Spec, path: Path) -> Any:
    """Read a dataset, after checking that its type and number of axes match its declaration."""
    dataset = _hard(group, name, h5d.DatasetID, path)
    stored = require_plain(dataset, path)
    is_text, nothing = spec.dtype == "str", not (stored.shape or stored.size)
    expected_kind = "S" if is_text else np.dtype(spec.dtype).kind
    if stored.dtype.kind != expected_kind or len(stored.shape) != len(spec.axes) or nothing:
        raise InputFileError(
            f"{path}: dataset {stored.where} is {stored.dtype} with {len(stored.shape)} axes, "
            f"not {spec.dtype} ({', '.join(spec.axes)}); make the file again"
        )
    array = np.empty(stored.shape, stored.dtype)
    if array.size:
        dataset.read(h5s.ALL, h5s.ALL, array)
    if is_text:
        decoded = np.char.decode(array, "utf-8")
        return tuple(str(item) for item in decoded) if spec.axes else str(decoded)
    if not spec.axes:
        return np.asarray(array, dtype=spec.dtype).item()
    array = np.asarray(array, dtype=spec.dtype)
    array.flags.writeable = False
    return array


# --------------------------------------------------------------------------------------------------------- info


@dataclass(frozen=True)
class Described:
    """One dataset as `l3 info` shows it. `value` is given for scalars, text and short lists."""

    name: str
    dtype: str
    shape: tuple[int, ...]
    axes: str
    unit: str
    doc: str
    value: Any


def describe(path: Path) -> dict[str, Any]:
    """Return the kind, version, history and datasets of any artifact.

    Returns
    -------
    dict
        "kind", "version", "history" (list of stages) and "datasets": one dict per dataset with "name", "dtype", "shape",
        "axes", "unit", "doc" and, for scalars, text and short lists, "value". Dimension scales are left out.
    """
    with open_artifact(path) as root:
        with reading(path, "a dataset"):
            fields = [(name, dataset) for name, dataset in datasets(root) if name != "history" and not is_scale(dataset)]
            described = [_described(path, name, dataset) for name, dataset in fields]
        return {
            "kind": str(root.attrs["kind"]),
            "version": int(root.attrs["version"]),
            "history": [dataclasses.asdict(stage) for stage in read_history(root, path)],
            "datasets": [dataclasses.asdict(item) for item in described],
        }


def _refuse_null(path: Path, name: str, dataset: h5py.Dataset) -> None:
    """Raise InputFileError if a dataset has HDF5's null dataspace, which l3 never writes."""
    if dataset.shape is None:
        raise InputFileError(f"{path}: dataset {name} holds nothing; make the file again")


def _described(path: Path, name: str, dataset: h5py.Dataset) -> Described:
    value: Any = None
    _refuse_null(path, name, dataset)
    if dataset.ndim <= 1 and (dataset.size or 0) <= 16 and dataset.dtype.kind in "biufS":
        require_readable(path, dataset.id)
        raw = dataset[()]
        value = np.char.decode(raw, "utf-8").tolist() if dataset.dtype.kind == "S" else raw.tolist()
    unit = "units" if "units" in dataset.attrs else "unit"  # the attribute's name in older files
    axes, unit, doc = (str(dataset.attrs.get(key, "")) for key in ("axes", unit, "doc"))
    dtype = "str" if dataset.dtype.kind == "S" else str(dataset.dtype)
    return Described(name, dtype, dataset.shape or (), axes, unit, doc, value)


SLAB_BYTES = 1 << 26  # of a dataset are read at a time, to bound memory


@dataclass(frozen=True)
class Intact:
    """Result of `verify` for an undamaged file."""

    kind: str
    version: int
    digest: bool  # whether the file carries the SHA-256 of its bytes; files of format version 1 do not
    datasets: int  # number of datasets whose checksums were compared, without dimension scales
    history: tuple[Stage, ...]


def verify(path: Path) -> Intact:
    """Compare every byte of an artifact with its digest, and every dataset with its checksums.

    Raises
    ------
    InputFileError
        If anything differs. The message names the dataset.
    """
    digest = container.check(path, "an l3 command")
    with open_artifact(path, unchanged=digest) as root:
        count = 0
        with reading(path, "a group"):
            every = list(container.datasets(root))
        for name, dataset in every:
            with reading(path, f"dataset {name}"):
                scale, stored = is_scale(dataset), dataset.id.get_storage_size()
            _refuse_null(path, name, dataset)
            if scale and not stored:
                continue  # a scale without values has no checksum
            require_plain(dataset.id, path)
            try:
                for _ in _slabs(dataset):
                    pass
            except OSError as error:
                raise InputFileError(f"{path}: dataset {name} is damaged (checksum); make the file again") from error
            count += not scale
        return Intact(str(root.attrs["kind"]), int(root.attrs["version"]), digest, count, read_history(root, path))


def _slabs(dataset: h5py.Dataset) -> Iterator[Any]:
    """Yield a dataset in parts of at most SLAB_BYTES."""
    if not dataset.ndim or not dataset.size:
        yield dataset[()]
        return
    rows = max(1, SLAB_BYTES * len(dataset) // dataset.nbytes)
    for start in range(0, len(dataset), rows):
        yield dataset[start : start + rows]


# ---------------------------------------------------------------------------------------------------------- chain


@dataclass(frozen=True)
class Link:
    """The files, or the recipe, that one stage of a history names in one role, and the given files that match."""

    stage: str
    role: str
    named: int  # number of files in the history
    given: tuple[str, ...]  # paths of the matching files


def chain(history: tuple[Stage, ...], inputs: Mapping[Path, str]) -> tuple[tuple[Link, ...], tuple[Path, ...]]:
    """Compare the files that a history names with files at hand, by their SHA-256.

    The history of a matching file is followed, too: an artifact that was made from several training sets records only the
    history of the first.

    Parameters
    ----------
    history : tuple of Stage
    inputs : mapping
        Path → SHA-256 of each file at hand.

    Returns
    -------
    links : tuple of Link
        One per stage and role, with the matching files.
    others : tuple of Path
        The files at hand that the history does not name.
    """
    stages = list(history)
    for stage in stages:  # the list grows while it is read
        named = {digest for digests in stage.inputs.values() for digest in digests}
        for path in (path for path, digest in inputs.items() if digest in named):
            stages += [other for other in history_of(path) if other not in stages]
    links, named_inputs = [], set()
    for stage in stages:
        for role, digests in sorted(stage.inputs.items()):
            given = [path for path, digest in inputs.items() if digest in digests]
            links.append(Link(stage.command, role, len(set(digests)), tuple(str(path) for path in given)))
            named_inputs.update(given)
        if stage.recipe:
            given = [path for path in inputs if _is_recipe_of(path, stage)]
            links.append(Link(stage.command, "recipe", max(1, len(given)), tuple(str(path) for path in given)))
            named_inputs.update(given)
    return tuple(links), tuple(path for path in inputs if path not in named_inputs)


def history_of(path: Path) -> tuple[Stage, ...]:
    """Return an artifact's history, or () if the file is missing or no artifact."""
    try:
        with open_artifact(path) as root:
            return read_history(root, path)
    except InputFileError:
        return ()


def _is_recipe_of(path: Path, stage: Stage) -> bool:
    """Return whether a file holds the stage's recipe, or one of the two texts that the recipe was joined from."""
    if path.suffix != ".toml":
        return False
    content = read_bounded(path).decode("utf-8-sig", "replace")
    text, recipe = (each.replace("\r\n", "\n") for each in (content, stage.recipe))
    return text == recipe or recipe.startswith(f"{text}\n") or recipe.endswith(f"\n{text}")
