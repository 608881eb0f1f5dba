"""Paths of the project."""

import os
from pathlib import Path

ROOT = Path(__file__).parents[2]
CONFIGS = ROOT / "configs"
HIDDEN = Path(__file__).parent / "hidden"  # contains a module that cannot be imported
PYTHONPATH = os.pathsep.join(map(str, (ROOT, HIDDEN)))  # for processes that tests start


def contents(folder: Path) -> dict[str, bytes]:
    """Return the bytes of each file below a folder, by its path relative to the folder."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}
