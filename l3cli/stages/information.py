"""The `l3 info` and `l3 bench` stages.

`l3 info` describes raw files, describes and verifies artifacts, and lists library versions. `l3 bench` measures the time per
frame.
"""

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
from l3cli.io.frames import raw_content
from l3cli.io.raw.cfa_codes import letter_of, written
from l3cli.io.raw.files import BY_SUFFIX, format_of
from l3cli.options.commands import BenchOptions
from l3cli.rendering import benchmark
from l3cli.rendering.opencl.devices import cache_warning, survey
from l3cli.system.files import sha256
from l3cli.system.limits import trusted

# types of artifacts that are small enough to be read as a whole
WHOLE: tuple[type[Artifact], ...] = (CameraModel, TransformTable, SceneMoments, Design)


def content(file: Path) -> dict[str, Any]:
    """Describe an artifact or a raw file as JSON data, for `l3 info --json`.

    Parameters
    ----------
    file : Path
        An artifact, or a raw file with one frame.

    Returns
    -------
    dict
        For an artifact: type, version, history and datasets, as from `describe`. For a transform table, the entry "insight"
        summarises the training. For a raw file: see `raw_frame`.

    Raises
    ------
    InputFileError
        If the file is neither an artifact nor a raw file with one frame.
    """
    if file.suffix.lower() in BY_SUFFIX and (reader := format_of(file)).holds_frame and not reader.wants_geometry:
        return raw_frame(file)
    described = describe(file)
    if described["kind"] == TransformTable.kind:
        from l3cli.training.summary import insight

        described["insight"] = insight(load(TransformTable, file))
    return described


def raw_frame(file: Path) -> dict[str, Any]:
    """Describe a raw file as l3 reads it without a table.

    Parameters
    ----------
    file : Path
        The raw file. It must contain a single frame and its size.

    Returns
    -------
    dict
        Size in pixels, levels and values in DN, filter array, signals of a grey surface, exposure time in s, other camera
        settings, and the file's instructions for raw converters. Missing properties are None.

    Raises
    ------
    InputFileError
        If the file cannot be read.
    """
    content = raw_content(file)
    values, shot = content["values"], content.get("shot", {})
    pattern, neutral, masked = content.get("pattern"), content.get("neutral"), content.get("masked")
    white = content.get("white_level")
    return {
        "kind": "raw frame",
        "size": list(values.shape),
        "values": {"lowest": int(values.min()), "mean": float(values.mean()), "highest": int(values.max())},
        "black_level": content.get("black_level"),
        "white_level": white,
        "saturated": None if white is None else float((values >= white).mean()),
        "filter_array": None if pattern is None else written(pattern),
        "neutral": None if neutral is None else {letter_of(int(code)): signal for code, signal in neutral.tolist()},
        "exposure_time": content.get("exposure") or None,
        "baseline_exposure": content.get("baseline_exposure") or None,
        "camera": _camera_name(content.get("camera", [])),
        **{key: shot.get(key) or None for key in ("lens", "date", "f_number", "focal_length", "iso")},
        "orientation": content.get("orientation"),
        "masked_pixels": None if masked is None else [part.size for part in masked],
        "gain_map": "gain" in content,
        "lens_corrections": len(content.get("warps", ())),
        "notes": list(content.get("notes", ())),
    }


def _camera_name(names: list[str]) -> str | None:
    """Join the names of a camera, such as maker and model, and omit names that are part of another name."""
    return (
        " ".join(name for name in dict.fromkeys(names) if not any(name != other and name in other for other in names))
        or None
    )


@dataclass(frozen=True)
class Verification:
    """Result of verifying an artifact and comparing its history with other files."""

    intact: Intact
    links: tuple[Link, ...]  # one entry per role of input files in the history, such as "training set"
    strangers: tuple[Path, ...]  # the user's files that do not occur in the history

    def document(self) -> dict[str, Any]:
        """Return the result as JSON data."""
        return {
            "kind": self.intact.kind,
            "version": self.intact.version,
            "datasets": self.intact.datasets,
            "history": [asdict(link) for link in self.links],
            "different": [str(path) for path in self.strangers],
        }


def verification(file: Path, inputs: tuple[Path, ...]) -> Verification:
    """Verify the digest and the content of an artifact, and compare its history with the digests of `inputs`.

    An input that does not match the history is not an error, but part of the result.

    Parameters
    ----------
    file : Path
        The artifact.
    inputs : tuple of Path
        Files from which the artifact may have been computed.

    Raises
    ------
    InputFileError
        If a byte has changed, or if the artifact is incomplete or contains invalid values.
    """
    intact = verify(file)
    _read_whole(file)
    return Verification(intact, *chain(intact.history, {path: sha256(path) for path in inputs}))


def _read_whole(file: Path) -> None:
    """Read the whole content of an artifact, in parts if it is large.

    Raises InputFileError if values are missing or invalid.
    """
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
    """Collect the versions for a bug report: l3, Python, system, libraries and OpenCL devices.

    The version of a missing library is None. If OpenCL is unavailable, the list of devices contains the reason. The entry
    "decoding" describes how untrusted files are decoded.
    """
    try:
        required = metadata.requires("l3cli") or []
    except metadata.PackageNotFoundError:  # l3 runs from its source folder without being installed
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
    """Describe how the decoding of untrusted files is isolated on this machine."""
    from l3cli.io.decoder_process import SECCOMP, measures  # imported here, because the import searches for libseccomp

    try:
        if trusted():
            return "in the main process, without isolation, because L3_TRUST is set"
        holds = measures(Path(sys.executable))
    except L3Error as error:
        return str(error)
    landlock = next((each for each in holds if each != SECCOMP), "no Landlock in this kernel")
    install = 'no seccomp (run pip install "l3cli[seccomp]", and install libseccomp 2 on the system)'
    seccomp = "seccomp" if SECCOMP in holds else install
    return f"in an isolated process with limits on time and memory, {landlock}, {seccomp}"


def _version(library: str) -> str | None:
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return None


def measure(options: BenchOptions) -> dict[str, Any]:
    """Measure frame times for `l3 bench`.

    If `options.variant` is set, only this kernel variant is measured. A warning is printed on the console if compiled
    kernels cannot be cached.

    Returns
    -------
    dict
        JSON data with the OpenCL devices ("devices") and the frame times of each measured case ("results").

    Raises
    ------
    DeviceError
        If the device does not exist.
    """
    devices = survey()
    jobs = benchmark.jobs(options.device, options.variant)
    results = [job() for job in options.console.progress(jobs, len(jobs), "cases")]
    if reason := cache_warning():
        options.console.warn(reason)
    return {"devices": devices, "results": results}
