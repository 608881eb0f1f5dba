"""Read pictures that were taken through a polariser at several angles.

The pictures are in a folder, with one picture per angle, or in a stack in a single file. The angles are specified in the
recipe or in the file names.
"""

import re
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError, listed
from l3cli.frames.scene import PolarisedPictures
from l3cli.io.file_names import natural_order
from l3cli.io.images import picture_size, read_image
from l3cli.io.raw.npy import map_array
from l3cli.io.scenes import bands
from l3cli.physics.stokes import malus_matrix

PICTURES = (".png", ".tif", ".tiff", ".pgm", ".ppm", ".exr", ".jpg", ".jpeg")
NUMBER = re.compile(r"[0-9]+(?:\.[0-9]+)?")
DEGREES = re.compile(r"([0-9]+(?:\.[0-9]+)?) ?(?:deg|°)", re.IGNORECASE)
FEWEST_PICTURES = 3
# Maximum condition number of the Malus matrix. It is 1.4 for the angles 0°, 45°, 90° and 135°, and 6 for 0°, 30° and 60°.
MAX_CONDITION = 10.0


def read(path: Path, pictures: str, angles_deg: Sequence[float] | None) -> PolarisedPictures:
    """Read the pictures in a folder or in a stack.

    Parameters
    ----------
    path : Path
        A folder with one picture per angle, a TIFF file with one page per angle, or a .npy file with the axes (angle, row,
        col) or (angle, row, col, colour).
    pictures : str
        Glob that selects the pictures in the folder.
    angles_deg : sequence of float, optional
        Polariser angle of each picture in degrees, in the natural order of the file names or in page order. Required for a
        stack. [default for a folder: angles from the file names]

    Raises
    ------
    InputFileError
        If the pictures differ in size or type, or if their angles are ambiguous or do not determine the polarisation.
    """
    if path.is_dir():
        paths = _selected(path, pictures)
        angles = _angles(path, paths, angles_deg)
        values = _stacked(paths)
    else:
        values = _stack(path)
        if angles_deg is None:
            raise InputFileError(f"{path} contains no angles; set angles_deg to the polariser angle of each picture")
        angles = tuple(angles_deg)
        if len(values) != len(angles):
            raise InputFileError(
                f"{path} has {len(values)} pictures, but angles_deg lists {len(angles)} angles; "
                "list one angle for each picture"
            )
    _require_determined(path, angles)
    return PolarisedPictures(values, angles)


def size(path: Path, pictures: str, angles_deg: Sequence[float] | None) -> tuple[int, int]:
    """Return the pictures' number of rows and columns. Raises InputFileError if the angles are invalid."""
    if not path.is_dir():
        rows, cols = read(path, pictures, angles_deg).values.shape[1:3]
        return rows, cols
    paths = _selected(path, pictures)
    _require_determined(path, _angles(path, paths, angles_deg))
    return picture_size(paths[0])


def files(path: Path) -> list[Path]:
    """Return all pictures in a folder in natural order, even if the recipe does not select them.

    If `path` is a file, return only this file.
    """
    if not path.is_dir():
        return [path]
    return sorted((each for each in path.iterdir() if _is_picture(each)), key=natural_order)


def _is_picture(path: Path) -> bool:
    return path.suffix.lower() in PICTURES and path.name[0] != "." and path.is_file()


def _selected(folder: Path, pattern: str) -> list[Path]:
    """Return the pictures in a folder that match the glob `pattern`.

    Raises InputFileError if there are fewer than FEWEST_PICTURES.
    """
    found = [each for each in files(folder) if each.match(pattern)]
    if len(found) < FEWEST_PICTURES:
        names = f" ({listed(each.name for each in found)})" if found else ""
        raise InputFileError(
            f"{folder} contains {len(found)} pictures{names} that match {pattern}; use pictures at {FEWEST_PICTURES} or "
            "more polariser angles"
        )
    return found


def _angles(folder: Path, paths: list[Path], stated: Sequence[float] | None) -> tuple[float, ...]:
    """Return each picture's angle in degrees.

    Raises InputFileError if the angles in the recipe contradict the file names, or if the recipe contains no angles and the
    file names are ambiguous.
    """
    named = _named_angles([path.stem for path in paths])
    names = listed(path.name for path in paths)
    if stated is None:
        if named is None:
            raise InputFileError(
                f"{folder}: cannot read one angle from each file name ({names}); rename the pictures, for example to "
                'scene_045.png, select the pictures of one scene with the key "pictures", or set "angles_deg"'
            )
        if len(set(named)) < len(named):
            twice = next(path.name for path, angle in zip(paths, named, strict=True) if named.count(angle) > 1)
            raise InputFileError(
                f"{folder} contains several pictures with the angle of {twice}; select the pictures of one scene with the "
                'key "pictures"'
            )
        return named
    if len(stated) != len(paths):
        raise InputFileError(
            f"{folder} contains {len(paths)} pictures ({names}), but angles_deg lists {len(stated)} angles; list one "
            "angle for each picture"
        )
    if named is not None and sorted(named) == sorted(stated) and list(named) != list(stated):
        raise InputFileError(
            f"{folder}: the order of the angles in angles_deg differs from the order of the pictures ({names}); list the "
            "angles in the order of the pictures, or remove angles_deg"
        )
    return tuple(stated)


def _named_angles(names: list[str]) -> tuple[float, ...] | None:
    """Return the angle in degrees in each file name, or None if the angles cannot be identified.

    The first of these rules that applies to all names is used:

    1. If each name contains exactly one number with a unit (45deg, 45°), this number is the angle.
    2. If each name contains exactly one number, this number is the angle.
    3. If the names differ in exactly one number, and in nothing else, this number is the angle.
    """
    with_unit = [DEGREES.findall(name) for name in names]
    if all(len(each) == 1 for each in with_unit):
        return tuple(float(angle) for (angle,) in with_unit)
    numbers = [NUMBER.findall(name) for name in names]
    if all(len(each) == 1 for each in numbers):
        return tuple(float(angle) for (angle,) in numbers)
    if len({NUMBER.sub("#", name) for name in names}) > 1:
        return None
    varying = [column for column in zip(*numbers, strict=True) if len(set(column)) > 1]
    return tuple(map(float, varying[0])) if len(varying) == 1 else None


def _require_determined(path: Path, angles: Sequence[float]) -> None:
    """Raise InputFileError if the angles do not determine the Stokes parameters accurately."""
    if np.linalg.cond(malus_matrix(angles)) <= MAX_CONDITION:
        return
    shown = ", ".join(f"{angle:g}" for angle in angles)
    widest = max(abs(one - other) for one, other in combinations(angles, 2)) if len(angles) > 1 else 0.0
    radians = 1.5 < widest < 2 * np.pi and any(angle % 1 for angle in angles)
    reason = "they look like radians; convert angles_deg to degrees" if radians else "use angles such as 0, 45, 90, 135"
    raise InputFileError(f"{path}: pictures at the angles {shown} (degrees) do not determine the polarisation; {reason}")


def _stacked(paths: list[Path]) -> NDArray:
    """Read pictures as an array, (picture, row, col, colour).

    Raises InputFileError if the pictures differ in size or type.
    """
    values: NDArray | None = None
    for index, path in enumerate(paths):
        pixels = _colours(path, read_image(path)[0])
        if values is None:
            values = np.empty((len(paths), *pixels.shape), pixels.dtype)
        if pixels.shape != values.shape[1:] or pixels.dtype != values.dtype:
            shape, first = ("×".join(map(str, each)) for each in (pixels.shape, values.shape[1:]))
            raise InputFileError(
                f"{path} has {shape} {pixels.dtype} values, but {paths[0].name} has {first} {values.dtype} values; use "
                "pictures of one size and type"
            )
        values[index] = pixels
    assert values is not None
    return values


def _colours(path: Path, pixels: NDArray) -> NDArray:
    """Remove the alpha channel, so that 1 or 3 channels remain. Raises InputFileError for more than 4 channels."""
    channels = pixels.shape[2]
    if channels > 4:
        raise InputFileError(f"{path} has {channels} channels; use grey or RGB pictures")
    return pixels[..., : 3 if channels >= 3 else 1]


def _stack(path: Path) -> NDArray:
    """Read a stack as an array, (picture, row, col, colour), with one colour for grey pictures.

    Raises InputFileError if the file is not a stack.
    """
    suffix = path.suffix.lower()
    if suffix in bands.TIFF:
        return np.moveaxis(bands.read_tiff(path)[0], 2, 0)[..., None]
    if suffix != ".npy":
        raise InputFileError(
            f"{path} is not a stack of pictures; use a folder of pictures, a TIFF file with one page per angle, or a .npy "
            "file"
        )
    values = map_array(path)
    if values.dtype.kind not in "fiu" or values.ndim not in (3, 4) or (values.ndim == 4 and values.shape[3] not in (1, 3)):
        shape = "×".join(map(str, values.shape))
        raise InputFileError(
            f"{path} has {shape} values of type {values.dtype}; save numbers with the axes (angle, row, col) or "
            "(angle, row, col, 3)"
        )
    return np.array(values if values.ndim == 4 else values[..., None])
