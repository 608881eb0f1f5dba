"""Content of an artifact, and whether it is intact and made of the files at hand."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from l3cli.artifacts.store import describe, load
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.verify import Intact, Link, chain, verify
from l3cli.system.files import sha256
from l3cli.system.ledger import note_inputs


def content(file: Path) -> dict[str, Any]:
    """The document of `l3 info --json`: kind, version, history and datasets of an artifact; under "insight" what a transform
    table has learned. InputFileError if the file is no artifact."""
    note_inputs({"artifact": [file]})
    described = describe(file)
    if described["kind"] == TransformTable.kind:
        from l3cli.training.insight import insight

        described["insight"] = insight(load(TransformTable, file))
    return described


@dataclass(frozen=True)
class Verification:
    """Verification of an artifact, and the files it was made of."""

    intact: Intact
    links: tuple[Link, ...]  # a link for each role of a file in its history
    strangers: tuple[Path, ...]  # files given that the history does not name

    def document(self) -> dict[str, Any]:
        """All of it, ready for JSON."""
        return {
            "kind": self.intact.kind,
            "version": self.intact.version,
            "digest": self.intact.digest,
            "datasets": self.intact.datasets,
            "history": [asdict(link) for link in self.links],
            "different": [str(path) for path in self.strangers],
        }


def verification(file: Path, inputs: tuple[Path, ...]) -> Verification:
    """Compare every byte of an artifact with its digest, and `inputs` with the files that its history names; InputFileError
    if a byte is not as it was written."""
    note_inputs({"artifact": [file], "inputs": inputs})
    intact = verify(file)
    return Verification(intact, *chain(intact.history, {path: sha256(path) for path in inputs}))
