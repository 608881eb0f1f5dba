"""The input files of a report, and the training sets on which each table is evaluated."""

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
    """An input file of a report."""

    name: str  # file name shown on the page
    path: Path
    sha256: str
    artifact: Artifact  # content of the file; for a training set, only the description without frames

    @property
    def array(self) -> tuple[Any, ...]:
        """Key that identifies the artifact's channels and CFA. It is empty for a design, which compares many CFAs."""
        if isinstance(self.artifact, Design):
            return ()
        of: Any = self.artifact.camera if isinstance(self.artifact, TrainingSet) else self.artifact
        return of.channels, of.cfa.shape, of.cfa.tobytes()


class Pair(NamedTuple):
    """A table and a training set on which it is evaluated. They have the same CFA. The table was not trained on the set."""

    table: Entry
    transforms: TransformTable  # the artifact of `table`
    frames: Entry
    head: TrainingSet  # the artifact of `frames`


@dataclass(frozen=True)
class Given:
    """The input files of a report, in the order of the command line."""

    entries: list[Entry]
    sequences: dict[str, dict[str, Any]]  # file name → output of `l3 evaluate --sequence --json`
    sequence_sums: dict[str, str]  # file name in `sequences` → SHA-256 of the file

    def of(self, kind: type[A]) -> list[tuple[Entry, A]]:
        """Return the entries with artifacts of type `kind`, together with these artifacts."""
        return [(entry, entry.artifact) for entry in self.entries if isinstance(entry.artifact, kind)]

    @property
    def pairs(self) -> list[Pair]:
        """All pairs of a table and a training set on which the table can be evaluated."""
        return [
            Pair(table, transforms, frames, head)
            for table, transforms in self.of(TransformTable)
            for frames, head in self.of(TrainingSet)
            if table.array == frames.array and not trained_on(transforms, frames)
        ]

    @property
    def arrays(self) -> list["Given"]:
        """The artifacts, grouped by colour filter array. Designs and sequences are omitted."""
        keys = dict.fromkeys(entry.array for entry in self.entries)
        return [Given([entry for entry in self.entries if entry.array == key], {}, {}) for key in keys if key]


def trained_on(table: TransformTable, frames: Entry) -> bool:
    """Whether a table was trained on a training set, according to the SHA-256 digests in its history."""
    return any(frames.sha256 in digests for stage in table.history for digests in stage.inputs.values())


def role_of(given: Given, frames: Entry) -> str:
    """Return sentences that list the tables trained on a training set, and the tables evaluated on it."""
    roles = []
    for text, wanted in (("Tables trained on this set", True), ("Tables evaluated on this set", False)):
        names = [entry.name for entry, table in given.of(TransformTable) if trained_on(table, frames) is wanted]
        roles += [f"{text}: {', '.join(names)}."] if names else []
    return " ".join(roles)


def cameras_within(given: Given) -> list[tuple[str, CameraModel]]:
    """Return each distinct camera in the training sets, with the name of the first file that contains it."""
    cameras: list[tuple[str, CameraModel]] = []
    for entry, head in given.of(TrainingSet):
        if not any(equal(head.camera, camera) for _, camera in cameras):
            cameras.append((entry.name, head.camera))
    return cameras


def lead_without_evaluation(given: Given) -> str:
    """Return the introduction of a report without evaluated tables. It explains which files to add."""
    if given.sequences:
        return sequence_summary(given.sequences)
    if not given.of(TransformTable):
        return f"{counted(len(given.entries), 'artifact')}. Without a transform table, nothing can be evaluated."
    if len(given.arrays) > 1:
        return "No table is evaluated. For each table, add a training set of its camera on which it was not trained."
    if given.of(TrainingSet):
        return (
            "The table is not evaluated, because it was trained on every training set of this report. Add a training set on "
            "which it was not trained."
        )
    return "The table is not evaluated. Add a training set on which it was not trained."
