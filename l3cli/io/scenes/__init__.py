"""Scene file formats. The key `source` in a recipe and the file suffix determine which module reads a file.

To add a format, write a module in this folder and add an entry to FORMATS. For a new source, also add its keys to
simulation/sources.py. The module must define the functions `read` and `size`. If the entry sets `has_files`, the
module must also define `files`. If it sets `names_unknown`, the module must define `unknown`. l3 imports the module when it
reads the first scene in this format.
"""

import importlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.frames.scene import PolarisedPictures, Scene, SpectralCube


@dataclass(frozen=True)
class SceneFormat:
    """A file format for scenes."""

    source: str  # value of the key `source` in a recipe
    module: str  # module in this folder that reads the format
    suffixes: tuple[str, ...] = ()  # in lower case; empty: every suffix that no earlier entry for this source lists
    keys: tuple[str, ...] = ()  # recipe keys that are passed to `read` and `size`
    is_folder: bool | None = False  # whether a scene is a folder instead of a file; None if it can be either
    has_files: bool = False  # whether a scene consists of several files
    names_unknown: bool = False  # whether the module defines `unknown`, which lists unknown header fields
    holds: str = ""  # contents, for the documentation
    states: str = ""  # metadata that l3 reads, for the documentation

    def read(self, path: Path, **keys: Any) -> Scene | SpectralCube | PolarisedPictures | NDArray[np.float32]:
        """Read a scene.

        Returns
        -------
        Scene, SpectralCube, PolarisedPictures or ndarray
            Depending on the format: a scene with its illuminant, a cube of bands, pictures of polarised light, or a linear
            picture, (row, col, 3).

        Raises
        ------
        InputFileError
            If the file cannot be read or does not have this format.
        """
        content: Scene | SpectralCube | PolarisedPictures | NDArray[np.float32] = self._reader.read(path, **keys)
        return content

    def size(self, path: Path, **keys: Any) -> tuple[int, int]:
        """Return a scene's number of rows and columns. Pixel values are read only if no header contains the size."""
        rows, cols = self._reader.size(path, **keys)
        return rows, cols

    def files(self, path: Path) -> list[Path]:
        """Return all files that belong to a scene."""
        return self._reader.files(path) if self.has_files else [path]

    def unknown(self, path: Path) -> list[str]:
        """Return the names of unknown header fields that may affect the values of the scene."""
        fields: list[str] = self._reader.unknown(path) if self.names_unknown else []
        return fields

    @property
    def _reader(self) -> Any:
        return importlib.import_module(f"l3cli.io.scenes.{self.module}")


FORMATS = (
    SceneFormat("iset", "iset", keys=("light",), holds="ISET scene (.mat)", states="photons, wavelengths, illuminant"),
    SceneFormat("rgb", "rgb", keys=("holds",), holds="picture with three channels", states="nothing"),
    SceneFormat(
        "bands", "bands", is_folder=True, has_files=True, holds="folder of one picture per band (.png, .tif, .pgm, .exr)",
        states='wavelengths in the names of the files: "450nm.png", "face_450.5nm.tif", "450.png"',
    ),
    SceneFormat(
        "envi", "envi", keys=("holds",), has_files=True, names_unknown=True,
        holds="ENVI header (.hdr) and its data file in the same folder",
        states="[all header fields that affect the values of pixels](#fields-of-envi-headers)",
    ),
    SceneFormat(
        "cube", "cube", keys=("variable", "axes"), holds="array of MATLAB (any version), HDF5, netCDF-4 or .npy",
        states="wavelengths, their unit and bad bands: from arrays near the cube, or from attributes, groups or structs; "
        "attributes `scale_factor`, `add_offset`, `_FillValue`, `missing_value` (CF), `Scale_Factor`, "
        "`Data_Ignore_Value` (NEON)",
    ),
    SceneFormat(
        "channels", "bands", has_files=True, holds="OpenEXR or TIFF with one channel per band; TIFF with one page per band",
        states="wavelengths in the names of channels and pages, in ImageJ labels, in OME channels, and in the metadata of "
        "tifffile and GDAL; scale, offset and nodata value of GDAL",
    ),
    SceneFormat(
        "polariser", "polariser", keys=("pictures", "angles_deg"), is_folder=None, has_files=True,
        holds="folder of one picture per angle of a polariser, or a stack: TIFF with one page per angle, .npy",
        states='angles in the names of the files: "scene_045.png", "45deg.tif"',
    ),
    SceneFormat(
        "stokes", "stokes", holds="Stokes parameters S0, S1 and S2 (OpenEXR, TIFF, .npy)",
        states="names of the channels of OpenEXR files",
    ),
)  # fmt: skip


def format_of(source: str, path: Path) -> SceneFormat:
    """Return a scene file's format, given the value of the recipe key `source`."""
    suffix = path.suffix.lower()
    return next(each for each in FORMATS if each.source == source and (not each.suffixes or suffix in each.suffixes))


def is_folder(source: str) -> bool | None:
    """Return whether scenes with this `source` are folders (True), files (False), or either (None)."""
    return next((each.is_folder for each in FORMATS if each.source == source), False)
