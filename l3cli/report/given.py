"""Artifacts that a report is given, and how they belong together."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.design import Design
from l3cli.artifacts.schema import Artifact, equal
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingSet
from l3cli.report.sequence import summary as sequence_summary
from l3cli.system.text import counted

A = TypeVar("A", bound=Artifact)


@dataclass(frozen=True)
class Entry:
    """A file of a report: how the page calls it, and what it holds; of a training set its head."""

    name: str
    path: Path
    sha256: str
    artifact: Artifact

    @property
    def array(self) -> tuple[Any, ...]:
        """Return the key that distinguishes colour filter arrays; empty of a design, which holds many."""
        if isinstance(self.artifact, Design):
            return ()
        of: Any = self.artifact.camera if isinstance(self.artifact, TrainingSet) else self.artifact
        return of.channels, of.cfa.shape, of.cfa.tobytes()


class Pair(NamedTuple):
    """A table and frames of its array that it was not trained on: what is evaluated."""

    table: Entry
    transforms: TransformTable
    frames: Entry
    head: TrainingSet


@dataclass(frozen=True)
class Given:
    """The artifacts of a report in the order in which they were given, and evaluations of sequences."""

    entries: list[Entry]
    sequences: dict[str, dict[str, Any]]  # by name what `l3 evaluate --sequence` printed as JSON
    sequence_sums: dict[str, str]  # their SHA-256

    def of(self, kind: type[A]) -> list[tuple[Entry, A]]:
        """Return the artifacts of a kind."""
        return [(entry, entry.artifact) for entry in self.entries if isinstance(entry.artifact, kind)]

    @property
    def pairs(self) -> list[Pair]:
        """Return each table with each training set of its array that it was not trained on."""
        return [
            Pair(table, transforms, frames, head)
            for table, transforms in self.of(TransformTable)
            for frames, head in self.of(TrainingSet)
            if table.array == frames.array and not trained_on(transforms, frames)
        ]

    @property
    def arrays(self) -> list["Given"]:
        """Return the artifacts of each colour filter array, without sequences."""
        keys = dict.fromkeys(entry.array for entry in self.entries)
        return [Given([entry for entry in self.entries if entry.array == key], {}, {}) for key in keys if key]


def trained_on(table: TransformTable, frames: Entry) -> bool:
    """Return whether the table's history names the training set's file."""
    return any(frames.sha256 in digests for stage in table.history for digests in stage.inputs.values())


def role_of(given: Given, frames: Entry) -> str:
    """Return the relation of the report's tables to a training set."""
    roles = []
    for text, wanted in (("Trained on it", True), ("Evaluated on it", False)):
        names = [entry.name for entry, table in given.of(TransformTable) if trained_on(table, frames) is wanted]
        roles += [f"{text}: {', '.join(names)}."] if names else []
    return " ".join(roles)


def cameras_within(given: Given) -> list[tuple[str, CameraModel]]:
    """Return the different cameras of the training sets."""
    cameras: list[tuple[str, CameraModel]] = []
    for entry, head in given.of(TrainingSet):
        if not any(equal(head.camera, camera) for _, camera in cameras):
            cameras.append((entry.name, head.camera))
    return cameras


def lead_without_evaluation(given: Given) -> str:
    if given.sequences:
        return sequence_summary(given.sequences)
    if not given.of(TransformTable):
        return f"{counted(len(given.entries), 'artifact')}, without a transform table: nothing is evaluated."
    if len(given.arrays) > 1:
        return "Add, for each table, frames of its colour filter array that it has not seen to have it evaluated."
    if given.of(TrainingSet):
        return "The table was trained on every training set given: add frames that it has not seen to have it evaluated."
    return "Add a training set that the table was not trained on to have it evaluated."
