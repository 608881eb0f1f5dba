"""The stages of `l3 info` and `l3 bench`: content and verification of an artifact, versions, and frame times."""

import itertools
import platform
import re
import sys
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from l3cli import __version__
from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.design import Design, SceneMoments
from l3cli.artifacts.inspection import Intact, Link, chain, describe, verify
from l3cli.artifacts.partial_sums import SUMS, PartialSumsReader
from l3cli.artifacts.schema import Artifact
from l3cli.artifacts.store import load, open_artifact, read_fields
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingSet, TrainingSetReader
from l3cli.errors import DeviceError, L3Error
from l3cli.options.commands import BenchOptions
from l3cli.rendering import benchmark
from l3cli.rendering.opencl.devices import cache_warning, survey
from l3cli.system.files import sha256
from l3cli.system.limits import trusted

WHOLE: tuple[type[Artifact], ...] = (CameraModel, TransformTable, SceneMoments, Design)  # small enough to be read at once


def content(file: Path) -> dict[str, Any]:
    """Return the document of `l3 info --json`.

    Returns
    -------
    dict
        Kind, version, history and data sets of an artifact. For a transform table, "insight" says what it has learned.

    Raises
    ------
    InputFileError
        If the file is not an artifact.
    """
    described = describe(file)
    if described["kind"] == TransformTable.kind:
        from l3cli.training.summary import insight

        described["insight"] = insight(load(TransformTable, file))
    return described


@dataclass(frozen=True)
class Verification:
    """Result of verifying an artifact and the files it was made from."""

    intact: Intact
    links: tuple[Link, ...]  # one for each role of files in the history
    strangers: tuple[Path, ...]  # given files that do not occur in the history

    def document(self) -> dict[str, Any]:
        """Return the result in a form that JSON can hold."""
        return {
            "kind": self.intact.kind,
            "version": self.intact.version,
            "datasets": self.intact.datasets,
            "history": [asdict(link) for link in self.links],
            "different": [str(path) for path in self.strangers],
        }


def verification(file: Path, inputs: tuple[Path, ...]) -> Verification:
    """Verify an artifact: its bytes against the digest, its content as other commands read it, and `inputs` against its
    history.

    Raises
    ------
    InputFileError
        If a byte has changed, or if the artifact is incomplete or holds invalid values.
    """
    intact = verify(file)
    _read_whole(file)
    return Verification(intact, *chain(intact.history, {path: sha256(path) for path in inputs}))


def _read_whole(file: Path) -> None:
    """Read everything that an artifact declares. Training sets and partial sums are read one frame or site at a time."""
    with open_artifact(file, *WHOLE, TrainingSet, *SUMS, unchanged=True) as root:
        kind = str(root.attrs["kind"])
        if kind == TrainingSet.kind:
            for _ in TrainingSetReader(root, file):
                pass
        elif whole := next((each for each in WHOLE if each.kind == kind), None):
            read_fields(root, whole, file)
        else:
            sums = PartialSumsReader(root, file)
            for condition, index in itertools.product(range(sums.conditions + 1), range(len(sums.head.sites))):
                sums.site(index, condition)


def versions() -> dict[str, Any]:
    """Return the versions for a bug report: l3, Python, OpenCL devices, and libraries (None if not installed)."""
    try:
        required = metadata.requires("l3cli") or []
    except metadata.PackageNotFoundError:  # sources on a path, not installed
        required = []
    used = [each for each in required if not re.search(r"""extra == ['"](dev|docs|fuzz|peers)['"]""", each)]
    names = sorted({re.split(r"[^\w.-]", each)[0] for each in used}, key=str.lower)
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
        "decoding": _decoding(),
    }


def _decoding() -> str:
    """Describe how files from elsewhere are decoded on this machine, and what confines the decoding process."""
    from l3cli.io.decoder_process import SECCOMP, measures  # imported late: searches for libseccomp

    try:
        if trusted():
            return "in the process of l3 itself, without limits (L3_TRUST)"
        holds = measures(Path(sys.executable))
    except L3Error as error:
        return str(error)
    landlock = next((each for each in holds if each != SECCOMP), "no Landlock in this kernel")
    seccomp = "seccomp" if SECCOMP in holds else 'no seccomp (pip install "l3cli[seccomp]", and libseccomp 2 of the system)'
    return f"isolated process with limits of time and memory, {landlock}, {seccomp}"


def _version(library: str) -> str | None:
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return None


def measure(options: BenchOptions) -> dict[str, Any]:
    """Return the document of `l3 bench --json`: the OpenCL devices, and frame times for each case under "results".

    If the options name a `variant`, only that one is timed. Raise DeviceError if the device does not exist.
    """
    devices = survey()
    jobs = benchmark.jobs(options.device, options.variant)
    results = [job() for job in options.console.progress(jobs, len(jobs), "cases")]
    if reason := cache_warning():
        options.console.warn(reason)
    return {"devices": devices, "results": results}
