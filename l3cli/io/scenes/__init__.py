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
    names_unknown: bool = False  # headers may hold fields that l3 does not know, which the module's `unknown` names
    holds: str = ""  # what the files are and where they state wavelengths, for the documentation
    states: str = ""  # what else the files state that l3 reads

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

    def unknown(self, path: Path) -> list[str]:
        """Return the fields of a file's header that l3 does not know and that may change values."""
        fields: list[str] = self._reader.unknown(path) if self.names_unknown else []
        return fields

    @property
    def _reader(self) -> Any:
        return importlib.import_module(f"l3cli.io.scenes.{self.module}")


FORMATS = (
    SceneFormat("iset", "iset", keys=("light",), holds="ISET scene (.mat)", states="photons, wavelengths, illuminant"),
    SceneFormat("rgb", "rgb", keys=("holds",), holds="picture of three channels", states="—"),
    SceneFormat(
        "bands", "bands", is_folder=True, has_files=True, holds="folder of one picture per band (.png, .tif, .pgm, .exr)",
        states='wavelengths in the names of the files: "450nm.png", "face_450.5nm.tif", "450.png"',
    ),
    SceneFormat(
        "envi", "envi", keys=("holds",), has_files=True, names_unknown=True,
        holds="ENVI header (.hdr) with its data beside it",
        states="[all fields of the header that change values](#fields-of-envi-headers)",
    ),
    SceneFormat(
        "cube", "cube", keys=("variable", "axes"), holds="array of MATLAB (any version), HDF5, netCDF-4 or .npy",
        states="wavelengths, their unit and bad bands beside the cube, in its attributes, groups or structs; attributes "
        "`scale_factor`, `add_offset`, `_FillValue`, `missing_value` (CF), `Scale_Factor`, `Data_Ignore_Value` (NEON)",
    ),
    SceneFormat(
        "channels", "bands", has_files=True, holds="OpenEXR or TIFF with one channel per band; TIFF with one page per band",
        states="wavelengths in the names of channels and pages, in labels of ImageJ, channels of OME, metadata of tifffile "
        "and GDAL; scale, offset and nodata value of GDAL",
    ),
)  # fmt: skip


def format_of(source: str, path: Path) -> SceneFormat:
    """Return the format of a file of a source."""
    suffix = path.suffix.lower()
    return next(each for each in FORMATS if each.source == source and (not each.suffixes or suffix in each.suffixes))


def is_folder(source: str) -> bool:
    """Return whether scenes of a source are folders."""
    return any(each.is_folder for each in FORMATS if each.source == source)
