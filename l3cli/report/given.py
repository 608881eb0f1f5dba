"""The artifacts in a report, and the choice of frames on which each table is evaluated."""

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
    """A file in a report, with its name on the page and its contents. For a training set, only its metadata are loaded."""

    name: str
    path: Path
    sha256: str
    artifact: Artifact

    @property
    def array(self) -> tuple[Any, ...]:
        """Key that identifies the colour filter array. Empty for a design, which contains many arrays."""
        if isinstance(self.artifact, Design):
            return ()
        of: Any = self.artifact.camera if isinstance(self.artifact, TrainingSet) else self.artifact
        return of.channels, of.cfa.shape, of.cfa.tobytes()


class Pair(NamedTuple):
    """A table and a training set with the same CFA that was not used to train the table. Each pair is evaluated."""

    table: Entry
    transforms: TransformTable
    frames: Entry
    head: TrainingSet


@dataclass(frozen=True)
class Given:
    """The artifacts of a report, in the order of the command line, and the evaluations of sequences."""

    entries: list[Entry]
    sequences: dict[str, dict[str, Any]]  # file name → document printed by `l3 evaluate --sequence --json`
    sequence_sums: dict[str, str]  # file name → SHA-256

    def of(self, kind: type[A]) -> list[tuple[Entry, A]]:
        """Return the entries whose artifact is of a given type, each with its artifact."""
        return [(entry, entry.artifact) for entry in self.entries if isinstance(entry.artifact, kind)]

    @property
    def pairs(self) -> list[Pair]:
        """Each table with each training set that has the same CFA and was not used to train the table."""
        return [
            Pair(table, transforms, frames, head)
            for table, transforms in self.of(TransformTable)
            for frames, head in self.of(TrainingSet)
            if table.array == frames.array and not trained_on(transforms, frames)
        ]

    @property
    def arrays(self) -> list["Given"]:
        """The artifacts grouped by colour filter array, without the sequences."""
        keys = dict.fromkeys(entry.array for entry in self.entries)
        return [Given([entry for entry in self.entries if entry.array == key], {}, {}) for key in keys if key]


def trained_on(table: TransformTable, frames: Entry) -> bool:
    """Whether the table's history lists the file of this training set."""
    return any(frames.sha256 in digests for stage in table.history for digests in stage.inputs.values())


def role_of(given: Given, frames: Entry) -> str:
    """Say in words which tables were trained on a training set and which were evaluated on it."""
    roles = []
    for text, wanted in (("Trained on it", True), ("Evaluated on it", False)):
        names = [entry.name for entry, table in given.of(TransformTable) if trained_on(table, frames) is wanted]
        roles += [f"{text}: {', '.join(names)}."] if names else []
    return " ".join(roles)


def cameras_within(given: Given) -> list[tuple[str, CameraModel]]:
    """Return the distinct cameras stored in the training sets, each with the name of the first file that contains it."""
    cameras: list[tuple[str, CameraModel]] = []
    for entry, head in given.of(TrainingSet):
        if not any(equal(head.camera, camera) for _, camera in cameras):
            cameras.append((entry.name, head.camera))
    return cameras


def lead_without_evaluation(given: Given) -> str:
    """Return the lead of a report in which no table could be evaluated. It says which file to add."""
    if given.sequences:
        return sequence_summary(given.sequences)
    if not given.of(TransformTable):
        return f"{counted(len(given.entries), 'artifact')}, without a transform table: nothing is evaluated."
    if len(given.arrays) > 1:
        return "To have each table evaluated, add frames of its colour filter array that it was not trained on."
    if given.of(TrainingSet):
        return (
            "The table was trained on every training set given. To have it evaluated, add frames that it was not trained on."
        )
    return "To have the table evaluated, add a training set that it was not trained on."
