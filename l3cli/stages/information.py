"""What an artifact holds and whether it is intact, and what this l3 is made of."""

import platform
import re
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from l3cli import __version__
from l3cli.artifacts.store import describe, load
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.verify import Intact, Link, chain, verify
from l3cli.errors import DeviceError
from l3cli.files import sha256


def content(file: Path) -> dict[str, Any]:
    """The document of `l3 info --json`: kind, version, history and datasets of an artifact; under "insight" what a transform
    table has learned. InputFileError if the file is no artifact."""
    described = describe(file)
    if described["kind"] == TransformTable.kind:
        from l3cli.training.insight import insight

        described["insight"] = insight(load(TransformTable, file))
    return described


@dataclass(frozen=True)
class Verification:
    """What is right with an artifact, and which files it was made of."""

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
    intact = verify(file)
    return Verification(intact, *chain(intact.history, {path: sha256(path) for path in inputs}))


def versions() -> dict[str, Any]:
    """What a report of a fault should tell: l3, Python, libraries (None: an extra not installed), OpenCL devices."""
    from l3cli.rendering.opencl_devices import survey

    try:
        required = metadata.requires("l3cli") or []
    except metadata.PackageNotFoundError:  # sources on a path, not installed
        required = []
    names = sorted(
        {re.split(r"[^\w.-]", each)[0] for each in required if "'dev'" not in each.replace('"', "'")}, key=str.lower
    )
    try:
        devices = survey()
    except DeviceError as error:
        devices = [str(error)]
    return {
        "l3": __version__,
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        "libraries": {name: _version(name) for name in names},
        "devices": devices,
    }


def _version(library: str) -> str | None:
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return None
