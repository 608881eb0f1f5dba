"""Verification of an artifact: whether it is as it was written, and was made of the files at hand."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py

from l3cli.artifacts import container
from l3cli.artifacts.container import is_scale
from l3cli.artifacts.schema import Stage
from l3cli.artifacts.store import open_artifact, read_history, reading, require_plain
from l3cli.errors import InputFileError
from l3cli.system.limits import read_bounded

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
            if scale and not stored:
                continue  # it is a length alone
            require_plain(dataset, name, path)
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
            stages += [other for other in _history_of(path) if other not in stages]
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


def _history_of(path: Path) -> tuple[Stage, ...]:
    """Return an artifact's history; nothing for another file."""
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
