"""The formats of scene files: what reads the files of which `source` of a recipe, and of which suffix. A new one is a module
of this folder and a line here; a new source also has its keys in simulation/sources.py.

A format's module has `read` and `size`, and `files` where its line says so; it is imported when the first scene is read.
"""

import importlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.frames.scene import Scene, SpectralCube


@dataclass(frozen=True)
class SceneFormat:
    """Reader of a source's files."""

    source: str  # of a recipe
    module: str  # of this folder
    suffixes: tuple[str, ...] = ()  # in lower case; none: all that no line above has
    keys: tuple[str, ...] = ()  # of the recipe, that the reader takes
    is_folder: bool = False  # a scene is a folder, not a file
    has_files: bool = False  # a scene is in several files

    def read(self, path: Path, **keys: Any) -> Scene | SpectralCube | NDArray[np.float32]:
        """Return a scene, a cube of bands, or a linear picture (row, col, 3); InputFileError if the file is none."""
        content: Scene | SpectralCube | NDArray[np.float32] = self._reader.read(path, **keys)
        return content

    def size(self, path: Path, **keys: Any) -> tuple[int, int]:
        """Return (rows, cols) of what `read` reads, from headers where they hold it."""
        rows, cols = self._reader.size(path, **keys)
        return rows, cols

    def files(self, path: Path) -> list[Path]:
        """Return all that is read of a scene."""
        return self._reader.files(path) if self.has_files else [path]

    @property
    def _reader(self) -> Any:
        return importlib.import_module(f"l3cli.io.scenes.{self.module}")


FORMATS = (
    SceneFormat("iset", "iset", keys=("light",)),
    SceneFormat("rgb", "rgb", keys=("holds",)),
    SceneFormat("bands", "bands", is_folder=True, has_files=True),
    SceneFormat("envi", "envi", has_files=True),
    SceneFormat("cube", "cube", keys=("variable", "axes")),
    SceneFormat("channels", "bands", has_files=True),
)


def format_of(source: str, path: Path) -> SceneFormat:
    """Return the format of a file of a source."""
    suffix = path.suffix.lower()
    return next(each for each in FORMATS if each.source == source and (not each.suffixes or suffix in each.suffixes))


def is_folder(source: str) -> bool:
    """Return whether scenes of a source are folders."""
    return any(each.is_folder for each in FORMATS if each.source == source)
