"""Which run a figure is of: its day, its machine, and a digest of the source that made it."""

import datetime
import hashlib
import json
import os
from pathlib import Path

from l3cli.system.files import write_whole

Origin = dict[str, str]  # date, source, machine
ROOT = Path(__file__).parents[2]
SOURCES = ("l3cli", "opencl", "configs")  # whose files decide what ours is
SUFFIXES = (".py", ".cl", ".c", ".toml", ".csv")
DIGITS = 12  # of a digest that are shown


def origin() -> Origin:
    """That of a run that begins now."""
    return {"date": datetime.datetime.now(datetime.UTC).date().isoformat(), "source": source(ROOT), "machine": machine()}


def source(root: Path) -> str:
    """The digest of a checkout's source, whatever its history; also of one that has been changed, or has none."""
    whole = hashlib.sha256()
    files = (path for folder in SOURCES for path in (root / folder).rglob("*") if path.suffix in SUFFIXES)
    for path in sorted(files, key=lambda path: path.relative_to(root).as_posix()):
        whole.update(f"{path.relative_to(root).as_posix()} {hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
    return whole.hexdigest()[:DIGITS]


def machine() -> str:
    """Processor and cores, as Linux names them."""
    described = Path("/proc/cpuinfo").read_text(encoding="utf-8") if Path("/proc/cpuinfo").exists() else ""
    names = [line.partition(":")[2].strip() for line in described.splitlines() if line.startswith("model name")]
    return f"{names[0] if names else 'unknown processor'}, {os.cpu_count()} cores"


def stamp(made: Path) -> None:
    """Note beside a file which run has made it, for later runs that take it."""
    write_whole(_stamp_of(made), (json.dumps(origin()) + "\n").encode())


def stamped(made: Path) -> Origin | None:
    """Which run has made a file; None: that was not noted."""
    if not _stamp_of(made).exists():
        return None
    noted: Origin = json.loads(_stamp_of(made).read_text(encoding="utf-8"))
    return noted


def _stamp_of(made: Path) -> Path:
    return made.with_suffix(".origin.json")
