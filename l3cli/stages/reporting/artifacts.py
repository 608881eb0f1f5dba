"""The artifacts of a report by kind, and evaluations of sequences."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.schema import Artifact
from l3cli.artifacts.store import load, open_artifact
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingSet, open_training_set
from l3cli.errors import InputFileError
from l3cli.stages.sequence_evaluation import document, read_sequence_figures
from l3cli.system.files import sha256
from l3cli.system.text import short_names

KINDS: dict[str, type[Artifact]] = {kind.kind: kind for kind in (CameraModel, TrainingSet, TransformTable)}

SEQUENCE = ".json"  # suffix of an evaluation of a sequence


@dataclass(frozen=True)
class Entry:
    """A file of a report: how the page calls it, and what it holds; of a training set its head."""

    name: str
    path: Path
    sha256: str
    artifact: Artifact


@dataclass(frozen=True)
class Given:
    """The artifacts of a report by kind, and evaluations of sequences."""

    cameras: list[tuple[Entry, CameraModel]]
    training: list[tuple[Entry, TrainingSet]]
    tables: list[tuple[Entry, TransformTable]]
    entries: list[Entry]
    sequences: dict[str, dict[str, Any]]  # by name what `l3 evaluate --sequence` printed as JSON
    sequence_sums: dict[str, str]  # their SHA-256

    @property
    def pairs(self) -> list[tuple[tuple[Entry, TransformTable], tuple[Entry, TrainingSet]]]:
        """Return each table with each training set of its array that it was not trained on: what is evaluated."""
        return [
            (table, frames)
            for table in self.tables
            for frames in self.training
            if _array_of(table[1]) == _array_of(frames[1]) and not trained_on(table[1], frames[0])
        ]

    @property
    def arrays(self) -> list["Given"]:
        """The artifacts of each colour filter array, in the order in which they were given, without sequences."""
        groups: dict[Any, list[Entry]] = {}
        for entry in self.entries:
            groups.setdefault(_array_of(entry.artifact), []).append(entry)
        return [_sorted(entries, {}, {}) for entries in groups.values()]


def trained_on(table: TransformTable, frames: Entry) -> bool:
    """Return whether the table's history names the training set's file."""
    return any(frames.sha256 in digests for stage in table.history for digests in stage.inputs.values())


def by_kind(paths: tuple[Path, ...]) -> Given:
    """Return artifacts by kind, each once; InputFileError if one is none, is damaged, or does not fit the others."""
    entries_by_digest: dict[str, Entry] = {}
    sequences: dict[str, dict[str, Any]] = {}
    sums: dict[str, str] = {}
    for path, name in zip(paths, short_names(paths), strict=True):
        if path.suffix.lower() == SEQUENCE:
            sequences[name], sums[name] = document(read_sequence_figures(path)), sha256(path)
            continue
        artifact, digest = _artifact(path), sha256(path)
        entries_by_digest.setdefault(digest, Entry(name, path, digest, artifact))
    entries = list(entries_by_digest.values())
    given = _sorted(entries, sequences, sums)
    for (table, transforms), (frames, head) in given.pairs:
        if transforms.outputs != head.outputs:
            raise InputFileError(f"{table.path} and {frames.path} have different outputs; report on a matching pair")
    return given


def _sorted(entries: list[Entry], sequences: dict[str, dict[str, Any]], sums: dict[str, str]) -> Given:
    return Given(
        [(entry, entry.artifact) for entry in entries if isinstance(entry.artifact, CameraModel)],
        [(entry, entry.artifact) for entry in entries if isinstance(entry.artifact, TrainingSet)],
        [(entry, entry.artifact) for entry in entries if isinstance(entry.artifact, TransformTable)],
        entries,
        sequences,
        sums,
    )


def _artifact(path: Path) -> Artifact:
    with open_artifact(path) as root:
        kind = str(root.attrs["kind"])
    if kind not in KINDS:
        raise InputFileError(f"{path} holds {kind}; give camera models, training sets or transform tables")
    if KINDS[kind] is not TrainingSet:
        return load(KINDS[kind], path)
    with open_training_set(path, unchanged=True) as reader:
        return reader.head


def _array_of(artifact: Artifact) -> tuple[Any, ...]:
    """Return the key that distinguishes colour filter arrays."""
    of: Any = artifact.camera if isinstance(artifact, TrainingSet) else artifact
    return of.channels, of.cfa.shape, of.cfa.tobytes()
