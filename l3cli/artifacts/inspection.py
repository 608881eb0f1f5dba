"""Functions for `l3 info`: list an artifact's content, verify its checksums, and find its input files."""

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from l3cli.artifacts.container import ENCODING, datasets, is_scale, require_readable
from l3cli.artifacts.schema import Stage
from l3cli.artifacts.store import open_artifact, read_history, reading, require_plain
from l3cli.errors import InputFileError
from l3cli.system.limits import read_bounded

SLAB_BYTES = 1 << 26  # amount of data that is read at a time, to limit memory use


def describe(path: Path) -> dict[str, Any]:
    """Describe an artifact of any type: its type, version, history and datasets.

    Returns
    -------
    dict
        The entries are "kind" (type of the artifact), "version", "history" (list of stages) and "datasets". Each dataset
        has the entries "name", "dtype", "shape", "axes", "unit", "doc" and "value". The value of an array is None if the
        array has more than one axis or more than 16 elements. Dimension scales are not included.

    Raises
    ------
    InputFileError
        If the file is damaged or not an artifact.
    """
    with open_artifact(path) as root:
        with reading(path, "a dataset"):
            fields = [(name, dataset) for name, dataset in datasets(root) if name != "history" and not is_scale(dataset)]
            described = [_describe_dataset(path, name, dataset) for name, dataset in fields]
        return {
            "kind": str(root.attrs["kind"]),
            "version": int(root.attrs["version"]),
            "history": [dataclasses.asdict(stage) for stage in read_history(root, path)],
            "datasets": described,
        }


def _refuse_null(path: Path, name: str, dataset: h5py.Dataset) -> None:
    """Raise InputFileError if a dataset has a null dataspace, which l3 never writes."""
    if dataset.shape is None:
        raise InputFileError(f"{path}: dataset {name} is empty; create the file again")


def _describe_dataset(path: Path, name: str, dataset: h5py.Dataset) -> dict[str, Any]:
    _refuse_null(path, name, dataset)
    value: Any = None
    if dataset.ndim <= 1 and (dataset.size or 0) <= 16 and dataset.dtype.kind in "biufS":
        require_readable(path, dataset.id)
        raw = dataset[()]
        value = np.char.decode(raw, ENCODING).tolist() if dataset.dtype.kind == "S" else raw.tolist()
    axes, unit, doc = (str(dataset.attrs.get(key, "")) for key in ("axes", "units", "doc"))
    dtype = "str" if dataset.dtype.kind == "S" else str(dataset.dtype)
    shape = dataset.shape or ()
    return {"name": name, "dtype": dtype, "shape": shape, "axes": axes, "unit": unit, "doc": doc, "value": value}


@dataclass(frozen=True)
class Intact:
    """Result of `verify` for an undamaged artifact."""

    kind: str
    version: int
    datasets: int  # number of datasets with correct checksums, excluding dimension scales
    history: tuple[Stage, ...]


def verify(path: Path) -> Intact:
    """Verify an artifact: the digest of the file and the checksums of every dataset.

    Raises
    ------
    InputFileError
        If the digest or a checksum is wrong. The message names the dataset with the wrong checksum.
    """
    with open_artifact(path) as root:
        count = 0
        with reading(path, "a group"):
            every = list(datasets(root))
        for name, dataset in every:
            with reading(path, f"dataset {name}"):
                scale, stored = is_scale(dataset), dataset.id.get_storage_size()
            _refuse_null(path, name, dataset)
            if scale and not stored:
                continue  # a dimension scale without values has no checksum
            require_plain(dataset.id, path)
            try:
                for _ in _slabs(dataset):
                    pass
            except OSError as error:
                raise InputFileError(
                    f"{path}: dataset {name} is damaged, because its checksum is wrong; create the file again"
                ) from error
            count += not scale
        return Intact(str(root.attrs["kind"]), int(root.attrs["version"]), count, read_history(root, path))


def _slabs(dataset: h5py.Dataset) -> Iterator[Any]:
    """Read a dataset in parts of at most SLAB_BYTES bytes, but at least one row."""
    if not dataset.ndim or not dataset.size:
        yield dataset[()]
        return
    rows = max(1, SLAB_BYTES * len(dataset) // dataset.nbytes)
    for start in range(0, len(dataset), rows):
        yield dataset[start : start + rows]


@dataclass(frozen=True)
class Link:
    """One type of input of a stage, such as its camera, and the user's files that match it."""

    stage: str  # command of the stage, such as "simulate"
    role: str  # type of input, such as "camera"
    named: int  # number of input files that the history lists
    given: tuple[str, ...]  # paths of the user's files that match


def chain(history: tuple[Stage, ...], inputs: Mapping[Path, str]) -> tuple[tuple[Link, ...], tuple[Path, ...]]:
    """Find out which of the user's files a history lists as inputs. Files are compared by their SHA-256.

    The histories of matching files are searched too, because an artifact that was computed from several training sets
    contains only the history of the first one.

    Parameters
    ----------
    history : tuple of Stage
        History of an artifact.
    inputs : mapping of Path to str
        The user's files, with the SHA-256 of each file.

    Returns
    -------
    links : tuple of Link
        The matching files, for each stage and role.
    others : tuple of Path
        The files that match no input of any stage.
    """
    stages = list(history)
    for stage in stages:  # the loop also visits the stages that it appends
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
    """Return the history of an artifact, or () if the file does not exist or is not an artifact."""
    try:
        with open_artifact(path) as root:
            return read_history(root, path)
    except InputFileError:
        return ()


def _is_recipe_of(path: Path, stage: Stage) -> bool:
    """Return whether a TOML file contains the recipe of a stage, or one of two recipes that the stage joined."""
    if path.suffix != ".toml":
        return False
    content = read_bounded(path).decode("utf-8-sig", "replace")
    text, recipe = (each.replace("\r\n", "\n") for each in (content, stage.recipe))
    return text == recipe or recipe.startswith(f"{text}\n") or recipe.endswith(f"\n{text}")
