"""Record the origin of a result: the date, the computer, and a digest of the source."""

import datetime
import hashlib
import json
import os
from pathlib import Path

from l3cli.system.files import write_whole

Origin = dict[str, str]  # date, source, machine
ROOT = Path(__file__).parents[2]
SOURCES = ("l3cli", "opencl", "configs")  # folders whose files determine the results of l3
SUFFIXES = (".py", ".cl", ".c", ".toml", ".csv")
DIGITS = 12  # displayed digits of a digest


def origin() -> Origin:
    """Return the origin of a run that begins now."""
    return {"date": datetime.datetime.now(datetime.UTC).date().isoformat(), "source": source(ROOT), "machine": machine()}


def source(root: Path) -> str:
    """Return the digest of the source files in a checkout, including uncommitted changes."""
    whole = hashlib.sha256()
    files = (path for folder in SOURCES for path in (root / folder).rglob("*") if path.suffix in SUFFIXES)
    for path in sorted(files, key=lambda path: path.relative_to(root).as_posix()):
        whole.update(f"{path.relative_to(root).as_posix()} {hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
    return whole.hexdigest()[:DIGITS]


def machine() -> str:
    """Return the processor and the number of cores, as Linux reports them."""
    described = Path("/proc/cpuinfo").read_text(encoding="utf-8") if Path("/proc/cpuinfo").exists() else ""
    names = [line.partition(":")[2].strip() for line in described.splitlines() if line.startswith("model name")]
    return f"{names[0] if names else 'unknown processor'}, {os.cpu_count()} cores"


def stamp(made: Path) -> None:
    """Store the origin of a file next to the file, for later runs that reuse the file."""
    write_whole(_stamp_of(made), (json.dumps(origin()) + "\n").encode())


def stamped(made: Path) -> Origin | None:
    """Return the origin of a file, or None if no origin was stored."""
    if not _stamp_of(made).exists():
        return None
    noted: Origin = json.loads(_stamp_of(made).read_text(encoding="utf-8"))
    return noted


def _stamp_of(made: Path) -> Path:
    return made.with_suffix(".origin.json")
