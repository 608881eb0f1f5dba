"""Spectral cubes: folders of band pictures, ENVI, MATLAB, HDF5, .npy, EXR and TIFF of many channels."""

import math
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.io.apart import apart
from l3cli.io.arrays import map_array
from l3cli.io.images import read_image
from l3cli.io.matlab import Content, array_shapes, look_up, read_hdf5, read_matlab
from l3cli.limits import read_bounded, require_picture, require_values
from l3cli.scene import SpectralCube

WAVELENGTH_NAMES = ("wave", "wavelength", "wavelengths", "wavelength_nm", "wavelengths_nm", "lambda", "wl", "bands", "wlens")
BAND_PICTURES = (".png", ".tif", ".tiff", ".pgm", ".exr")


def read_band_folder(path: Path) -> SpectralCube:
    """The pictures of a folder, one a band in the order of their names' numbers (CAVE: 16-bit PNG); of a picture with
    several channels the first. InputFileError if there are none or they differ in size."""
    folder = path if path.is_dir() else path.parent
    pictures = band_pictures(folder)
    if not pictures:
        raise InputFileError(f"{folder} holds no pictures ({', '.join(BAND_PICTURES)}); give a folder with one a band")
    cube: NDArray | None = None
    for band, picture in enumerate(pictures):
        pixels = read_image(picture)[0][..., 0]
        if cube is None:
            cube = np.empty((*pixels.shape, len(pictures)), pixels.dtype)
        if pixels.shape != cube.shape[:2] or pixels.dtype != cube.dtype:
            raise InputFileError(
                f"{picture} differs in size or depth from {pictures[0].name}; keep only bands in the folder"
            )
        cube[..., band] = pixels
    assert cube is not None
    return SpectralCube(cube, None)


def band_pictures(folder: Path) -> list[Path]:
    """The pictures in `folder`, those with numbers in their names by the last of these numbers."""

    def order(path: Path) -> tuple[str, int]:
        numbers = re.findall(r"\d+", path.stem)
        return (re.sub(r"\d+$", "", path.stem), int(numbers[-1])) if numbers else (path.stem, 0)

    return sorted((path for path in folder.iterdir() if path.suffix.lower() in BAND_PICTURES), key=order)


# ------------------------------------------------------------------------------------------------------- ENVI

ENVI_TYPES = {1: "u1", 2: "i2", 3: "i4", 4: "f4", 5: "f8", 12: "u2", 13: "u4", 14: "i8", 15: "u8"}
ENVI_AXES = {
    "bsq": ("bands", "lines", "samples"),
    "bil": ("lines", "bands", "samples"),
    "bip": ("lines", "samples", "bands"),
}
ENVI_UNITS = {"nanometers": 1.0, "nm": 1.0, "micrometers": 1e3, "um": 1e3, "µm": 1e3, "microns": 1e3}
ENVI_DATA = ("", ".img", ".dat", ".raw", ".bsq", ".bil", ".bip", ".bin", ".cube")


def read_envi(path: Path) -> SpectralCube:
    """The cube of an ENVI header (.hdr); the data lie beside it. InputFileError if the two do not fit each other."""
    header = _envi_header(path)
    try:
        sizes = {key: int(header[key]) for key in ("lines", "samples", "bands")}
        axes = ENVI_AXES[header["interleave"].lower()]
        order = ">" if int(header.get("byte order", "0")) else "<"
        dtype = np.dtype(order + ENVI_TYPES[int(header["data type"])])
        offset = int(header.get("header offset", "0"))
        listed = [float(value) for value in header["wavelength"].split(",")] if "wavelength" in header else None
        white = float(header["reflectance scale factor"]) if "reflectance scale factor" in header else None
    except KeyError as error:
        raise InputFileError(f"{path}: {error.args[0]} is missing or of no known kind; give a whole ENVI header") from error
    except ValueError as error:
        raise InputFileError(f"{path}: {error}; give a whole ENVI header") from error
    data = _envi_data(path)
    shape = tuple(sizes[axis] for axis in axes)
    wanted = offset + math.prod(shape) * dtype.itemsize
    require_picture(str(path), sizes["lines"], sizes["samples"], sizes["bands"])
    if min(shape) < 1 or offset < 0 or data.stat().st_size < wanted:
        raise InputFileError(f"{data} has {data.stat().st_size} bytes, its header wants {wanted}; give the whole file")
    stored = np.memmap(data, dtype, "r", offset, shape)
    values = stored.transpose([axes.index(axis) for axis in ("lines", "samples", "bands")])
    wavelength = None if listed is None else np.array(listed) * _envi_unit(header, listed)
    return SpectralCube(values, wavelength, white)


def _envi_header(path: Path) -> dict[str, str]:
    """Keys in lower case and values, braces taken off."""
    try:
        text = read_bounded(path).decode("latin-1")
    except OSError as error:
        raise InputFileError(f"{path}: {error.strerror}") from error
    if not text.lstrip().startswith("ENVI"):
        raise InputFileError(f"{path} is no ENVI header; give the .hdr file")
    header, lines = {}, iter(text.splitlines())
    for line in lines:
        key, equals, value = line.partition("=")
        if not equals:
            continue
        values = [value]
        while values[0].lstrip().startswith("{") and "}" not in values[-1]:
            values.append(next(lines, "}"))
        header[key.strip().lower()] = " ".join(values).partition("}")[0].replace("{", "").strip()
    return header


def envi_files(path: Path) -> list[Path]:
    """An ENVI header and its data; InputFileError unless both are there."""
    _envi_header(path)
    return [path, _envi_data(path)]


def _envi_data(path: Path) -> Path:
    stem = path.with_suffix("")
    for suffix in ENVI_DATA:
        for data in (stem.with_name(stem.name + suffix), stem.with_name(stem.name + suffix.upper())):
            if data.is_file() and data != path:
                return data
    raise InputFileError(f"{path}: its data file is missing; put {stem.name} or {stem.name}.img beside the header")


def _envi_unit(header: dict[str, str], listed: list[float]) -> float:
    """nm a unit of the listed wavelengths; where the header does not tell, their size does."""
    named = header.get("wavelength units", "").lower()
    return ENVI_UNITS.get(named, 1e3 if max(listed) < 100 else 1.0)


# ----------------------------------------------------------------------------------------- MATLAB, HDF5, numpy


def read_cube(path: Path, variable: str | None, axes: str) -> SpectralCube:
    """The cube `variable` (None: the only one) of a .mat, HDF5 or .npy file whose axes are those named by `axes`."""
    if path.suffix == ".npy":
        content = {"values": map_array(path)}
    else:
        content = read_matlab(path) if path.suffix == ".mat" else read_hdf5(path)
    if variable is None:
        cubes = _cubes(content)
        if len(cubes) != 1:
            names = ", ".join(cubes) or "none"
            raise InputFileError(f"{path} must hold one cube of three axes or variable name it (there: {names})")
        values = next(iter(cubes.values()))
    else:
        values = look_up(content, variable)
    if not isinstance(values, np.ndarray) or values.ndim != 3 or values.dtype.kind not in "fiu":
        raise InputFileError(f'{path} holds no cube "{variable}" of three axes; name another variable')
    order = axes.split()
    values = values.transpose([order.index(axis) for axis in ("row", "col", "band")])
    return SpectralCube(values, _wavelengths(content))


def cube_size(path: Path, variable: str | None, axes: str) -> tuple[int, int]:
    """(rows, cols) of what `read_cube` reads, from headers where they tell it; InputFileError as there."""
    shapes = {"values": map_array(path).shape} if path.suffix == ".npy" else array_shapes(path)
    wanted = (variable or "").replace(".", "/").strip("/")
    found = [shape for name, shape in shapes.items() if len(shape) == 3 and (variable is None or name == wanted)]
    if len(found) != 1:
        rows, cols, _ = read_cube(path, variable, axes).values.shape  # which says what is wrong
        return rows, cols
    order = axes.split()
    return found[0][order.index("row")], found[0][order.index("col")]


def _cubes(content: Content, prefix: str = "") -> dict[str, NDArray]:
    found: dict[str, NDArray] = {}
    for name, value in content.items():
        if isinstance(value, dict):
            found |= _cubes(value, f"{prefix}{name}/")
        elif isinstance(value, np.ndarray) and value.ndim == 3 and value.dtype.kind in "fiu":
            found[prefix + name] = value
    return found


def _wavelengths(content: Content) -> NDArray[np.float64] | None:
    """The first list of numbers under one of the usual names."""
    for name, value in content.items():
        if name.lower() in WAVELENGTH_NAMES and np.size(value) > 1 and np.asarray(value).dtype.kind in "fiu":
            return np.asarray(value, float).ravel()
    return None


# ------------------------------------------------------------------------------------------------ EXR and TIFF


def read_channels(path: Path) -> SpectralCube:
    """All channels of an EXR or TIFF as bands in increasing wavelength, which their names may tell ("450nm", "S0.450,5nm");
    of a TIFF with several pages each page is a band."""
    if path.suffix.lower() in (".tif", ".tiff") and (pages := _read_pages(path)) is not None:
        return SpectralCube(pages, None)
    pixels, names = read_image(path)
    told = [re.search(r"(\d+(?:[.,]\d+)?)\s*nm", name) for name in names]
    keep = [index for index, match in enumerate(told) if match]
    if not keep:
        return SpectralCube(pixels, None)
    nanometres = np.array([float(match[1].replace(",", ".")) for match in told if match])
    order = np.argsort(nanometres, kind="stable")
    return SpectralCube(pixels[..., np.array(keep)[order]], nanometres[order])


@apart
def _read_pages(path: Path) -> NDArray | None:
    """(row, col, page) of a TIFF of one channel; None of one of several."""
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            if file.pages[0].samplesperpixel > 1:
                return None
            first = file.series[0]
            require_values(str(path), first.shape, first.dtype.itemsize if first.dtype else 1)
            pages = first.asarray()
    except (tifffile.TiffFileError, OSError, ValueError, IndexError) as error:
        raise InputFileError(f"{path} is truncated or damaged; give a whole TIFF") from error
    return np.moveaxis(pages, 0, 2) if pages.ndim == 3 else pages[..., None]
