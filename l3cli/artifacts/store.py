"""Artifacts in files: HDF5 after the declarations of their dataclasses, whole or not at all, with their history; and whether
one is as it was written, and was made of the files at hand.

docs/artifacts.md says what the files promise.
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

COMPRESSION = 4  # of gzip
MOST_GROUPS = 64  # in a list of them
SEALED = 2  # format version from which every file carries its digest
LENGTH_ALONE = "This is a netCDF dimension but not a netCDF variable.%10d"  # NAME of such a scale in netCDF-4
TEXT = h5py.string_dtype()
TEXT_TYPE, SCALAR = h5t.py_create(TEXT, logical=True), h5s.create(h5s.SCALAR)
REFERENCES = np.dtype([("dataset", h5py.ref_dtype), ("dimension", "<i4")])


HDF5_ERRORS = (OSError, RuntimeError, KeyError, TypeError, ValueError, OverflowError)  # what h5py makes of damage
A = TypeVar("A", bound=Artifact)


# ------------------------------------------------------------------------------------------------------ writing


def write_fields(group: h5py.Group, instance: Any, compressed: bool = True) -> None:
    """Write every declared field of `instance` below `group`; their axes get no scales. Pictures are not `compressed`: noise
    hardly shrinks, and shrinking it takes longer than simulating it."""
    for name, spec, _ in declared(type(instance)):
        value = getattr(instance, name)
        if isinstance(spec, Spec):
            _write_dataset(group, name, spec, value, compressed)
        else:
            for place, each in instances(name, value).items():
                write_fields(group.create_group(place), each, compressed)


def _write_dataset(group: h5py.Group, name: str, spec: Spec, value: Any, compressed: bool = True) -> None:
    """Write a dataset and its attributes, as `create_dataset` and `attrs` would in twice the time."""
    is_text = spec.dtype == "str"
    array = encoded(value) if is_text else np.asarray(value, dtype=spec.dtype, order="C")
    created = h5p.create(h5p.DATASET_CREATE)
    created.set_obj_track_times(False)
    if array.ndim and array.size:
        created.set_chunk(_chunk(array.shape, array.dtype.itemsize))
        if compressed:
            created.set_shuffle()
            created.set_deflate(COMPRESSION)
        created.set_fletcher32()
    kind = h5t.py_create(array.dtype, logical=True)
    dataset = h5d.create(group.id, name.encode(), kind, h5s.create_simple(array.shape), created)
    dataset.write(h5s.ALL, h5s.ALL, array)
    texts = {"axes": ", ".join(spec.axes), "units": spec.unit, "doc": spec.doc}
    if is_text:
        texts["_Encoding"] = ENCODING  # by which xarray knows it from bytes
    for key, text in texts.items():
        h5a.create(dataset, key.encode(), TEXT_TYPE, SCALAR).write(np.array(text, TEXT))


def _chunk(shape: tuple[int, ...], itemsize: int) -> tuple[int, ...]:
    """Return the shape of a chunk: whole trailing axes, as many leading ones as make about a mebibyte."""
    chunk = list(shape)
    for axis in range(len(shape)):
        others = itemsize * int(np.prod(chunk)) // chunk[axis]
        chunk[axis] = max(1, min(shape[axis], (1 << 20) // max(others, 1)))
    return tuple(chunk)


@contextlib.contextmanager
def new_artifact(path: Path, kind: str, version: int, history: tuple[Stage, ...]) -> Iterator[h5py.File]:
    """Yield an HDF5 file open for writing with kind, version and history on the root; it gets the name `path` at the end."""
    stages = json.dumps([dataclasses.asdict(stage) for stage in history], sort_keys=True, ensure_ascii=False)
    with container.new_file(path) as root:
        root.attrs["kind"] = kind
        root.attrs["version"] = np.int64(version)
        _write_dataset(root, "history", Spec("str", (), "1", "JSON: the stages that led here, oldest first"), stages)
        yield root


def save(artifact: Artifact, path: Path) -> None:
    """Write `artifact` to `path` whole or not at all."""
    with new_artifact(path, artifact.kind, artifact.version, artifact.history) as root:
        write_fields(root, artifact)
        name_axes(root, type(artifact), {}, artifact)


# ------------------------------------------------------------------------------------------------------- scales
#
# Named axes as HDF5 dimension scales, by which xarray, netCDF tools and `dims` of h5py know them. Every axis of a group's
# datasets has one dataset of its name in that group: the declared one that gives the values along it (wavelength); a copy
# of one of another name that does (channels of the axis channel), or, as in netCDF, a length alone. What reads artifacts
# needs no scale, and follows none of their references.


Coordinates = Mapping[str, tuple[Any, Spec]]  # axis → what stands along it, and how that is declared


def coordinates_of(content: Any) -> Coordinates:
    """Return the coordinates along the axes of an instance of a dataclass, where its fields give them."""
    kind: type = type(content)
    fields = {name: spec for name, spec in _layout(kind)[0].items() if spec.coordinate}
    return {spec.axes[0]: (getattr(content, name), spec) for name, spec in fields.items()}


def name_axes(group: h5py.Group, kind: type, above: Coordinates, content: Any = None) -> None:
    """Write the scales of what is stored of dataclass `kind` in `group` and in the groups below.

    `above` are the coordinates that groups above give; `content`, the stored instance, gives those of its group and below.
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
    """Return the datasets with axes and the groups that a dataclass declares."""
    members = [(name, member) for name, member, _ in declared(kind)]
    return (
        {name: member for name, member in members if isinstance(member, Spec) and member.axes},
        {name: member for name, member in members if not isinstance(member, Spec)},
    )


def _write_scales(group: h5py.Group, kind: type, known: Coordinates) -> None:
    """Write one scale for each axis in a group, and the references between scales and datasets.

    The lists of references are written whole, which attach_scale of h5py would write anew for every dataset.
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
    """Return a scale that is no declared dataset: with values if they are known, else a length alone."""
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
    """Yield the file's root, after checking that not a byte has changed since it was written, that it is an artifact, of one
    of the kinds `expected`, and of a version this l3 reads. `unchanged`: this run has compared the bytes before."""
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
    """Read an artifact of type `cls`; InputFileError names file, dataset and cure."""
    with open_artifact(path, cls) as root:
        return read_fields(root, cls, path, history=read_history(root, path))


def read_history(root: h5py.File, path: Path) -> tuple[Stage, ...]:
    text = _read_dataset(root, "history", Spec("str", (), "1", ""), path)
    try:
        return tuple(msgspec.json.decode(text, type=list[Stage]))
    except (msgspec.MsgspecError, UnicodeEncodeError, RecursionError) as error:
        raise InputFileError(f"{path}: dataset history is not the JSON that l3 writes; make the file again") from error


def read_fields(group: h5py.Group, cls: type, path: Path, **extra: Any) -> Any:
    """Return an instance of dataclass `cls` from the datasets below `group`."""
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
    """Return the instance, or the tuple of instances, of a declared group."""
    if spec.since and group.name == "/" and int(group.file.attrs["version"]) < spec.since:
        return read_fields(group, spec.kind, path)
    if not group.id.links.exists(name.encode()):
        raise InputFileError(f"{path} lacks the group {_inside(group, name)}; make the file again")
    below = hard_group(group, name, path)
    if not spec.several:
        return read_fields(below, spec.kind, path)
    count = len(members(below, path))
    if count > MOST_GROUPS:
        raise InputFileError(f"{path}: {_inside(group, name)} holds more than {MOST_GROUPS} groups; make the file again")
    return tuple(read_fields(hard_group(below, str(index), path), spec.kind, path) for index in range(count))


def _inside(group: h5py.Group, name: str) -> str:
    return f"{group.name.rstrip('/')}/{name}".lstrip("/")


@contextlib.contextmanager
def reading(path: Path, what: str) -> Iterator[None]:
    """Raise InputFileError for errors of HDF5."""
    try:
        yield
    except (*HDF5_ERRORS, UnicodeDecodeError) as error:
        raise InputFileError(f"{path}: {what} is damaged (checksum); make the file again") from error


def members(group: h5py.Group, path: Path) -> list[str]:
    """Return the names of what a group holds, in order."""
    with reading(path, f"the group {group.name}"):
        return sorted(group)


def hard_group(group: h5py.Group, name: str, path: Path) -> h5py.Group:
    """Return a group below `group` that lies in this file; InputFileError if there is none."""
    with reading(path, f"the group {_inside(group, name)}"):
        return h5py.Group(_hard(group, name, h5g.GroupID, path))


def _hard(group: h5py.Group, name: str, kind: type, path: Path) -> Any:
    """Return the identifier of a member that really lies in this file: no soft or external link is followed."""
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
    """Return how a dataset is stored; InputFileError if that is as l3 never stores one, or it would be larger in memory than
    can be."""
    stored = require_readable(path, dataset)
    if not stored.filters <= KNOWN_FILTERS:
        raise InputFileError(f"{path}: dataset {stored.where} is stored as l3 never stores one; make the file again")
    return stored


def _read_dataset(group: h5py.Group, name: str, spec: Spec, path: Path) -> Any:
    with reading(path, f"dataset {_inside(group, name)}"):
        return _as_declared(group, name, spec, path)


def _as_declared(group: h5py.Group, name: str, spec: Spec, path: Path) -> Any:
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
    """One dataset as `l3 info` shows it; `value` is given for scalars, text and short lists."""

    name: str
    dtype: str
    shape: tuple[int, ...]
    axes: str
    unit: str
    doc: str
    value: Any


def describe(path: Path) -> dict[str, Any]:
    """Return kind, version, history and every dataset with axes and unit of any artifact, without the scales of its axes."""
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
    """Raise InputFileError for a dataset of HDF5's null dataspace, which l3 never writes."""
    if dataset.shape is None:
        raise InputFileError(f"{path}: dataset {name} holds nothing; make the file again")


def _described(path: Path, name: str, dataset: h5py.Dataset) -> Described:
    value: Any = None
    _refuse_null(path, name, dataset)
    if dataset.ndim <= 1 and (dataset.size or 0) <= 16 and dataset.dtype.kind in "biufS":
        require_readable(path, dataset.id)
        raw = dataset[()]
        value = np.char.decode(raw, "utf-8").tolist() if dataset.dtype.kind == "S" else raw.tolist()
    unit = "units" if "units" in dataset.attrs else "unit"  # as older files call it
    axes, unit, doc = (str(dataset.attrs.get(key, "")) for key in ("axes", unit, "doc"))
    dtype = "str" if dataset.dtype.kind == "S" else str(dataset.dtype)
    return Described(name, dtype, dataset.shape or (), axes, unit, doc, value)


SLAB = 1 << 26  # bytes of a dataset that are read at a time


@dataclass(frozen=True)
class Intact:
    """Intact parts of a file."""

    kind: str
    version: int
    digest: bool  # carries the SHA-256 of its bytes, which is right; false: format version 1
    datasets: int  # whose checksums are right, without scales of axes
    history: tuple[Stage, ...]


def verify(path: Path) -> Intact:
    """Compare every byte with the digest and every dataset with its checksums; InputFileError if anything is wrong."""
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
                continue  # it is a length alone
            require_plain(dataset.id, path)
            try:
                for _ in _slabs(dataset):
                    pass
            except OSError as error:
                raise InputFileError(f"{path}: dataset {name} is damaged (checksum); make the file again") from error
            count += not scale
        return Intact(str(root.attrs["kind"]), int(root.attrs["version"]), digest, count, read_history(root, path))


def _slabs(dataset: h5py.Dataset) -> Iterator[Any]:
    if not dataset.ndim or not dataset.size:
        yield dataset[()]
        return
    rows = max(1, SLAB * len(dataset) // dataset.nbytes)
    for start in range(0, len(dataset), rows):
        yield dataset[start : start + rows]


# ---------------------------------------------------------------------------------------------------------- chain


@dataclass(frozen=True)
class Link:
    """The files of one role, or the recipe, that a stage of a history names, and which of them were given."""

    stage: str
    role: str
    named: int
    given: tuple[str, ...]


def chain(history: tuple[Stage, ...], inputs: Mapping[Path, str]) -> tuple[tuple[Link, ...], tuple[Path, ...]]:
    """Return the files that a history names, compared with files by their SHA-256, and those files that it does not name.

    The history of a file that is named is followed, too: of several training sets, an artifact names only the first.
    """
    stages = list(history)
    for stage in stages:  # which grows
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
    """Return an artifact's history; nothing for another file, or none."""
    try:
        with open_artifact(path) as root:
            return read_history(root, path)
    except InputFileError:
        return ()


def _is_recipe_of(path: Path, stage: Stage) -> bool:
    """Return whether a file's text is the stage's recipe, or one of two that it was joined from."""
    if path.suffix != ".toml":
        return False
    content = read_bounded(path).decode("utf-8-sig", "replace")
    text, recipe = (each.replace("\r\n", "\n") for each in (content, stage.recipe))
    return text == recipe or recipe.startswith(f"{text}\n") or recipe.endswith(f"\n{text}")
