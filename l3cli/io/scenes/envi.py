"""ENVI cubes: a header in text, the data beside it."""

import math
from pathlib import Path

import numpy as np

from l3cli.errors import InputFileError
from l3cli.frames.scene import SpectralCube
from l3cli.system.limits import read_bounded, require_picture

TYPES = {1: "u1", 2: "i2", 3: "i4", 4: "f4", 5: "f8", 12: "u2", 13: "u4", 14: "i8", 15: "u8"}
AXES = {"bsq": ("bands", "lines", "samples"), "bil": ("lines", "bands", "samples"), "bip": ("lines", "samples", "bands")}
UNITS = {"nanometers": 1.0, "nm": 1.0, "micrometers": 1e3, "um": 1e3, "µm": 1e3, "microns": 1e3}
DATA = ("", ".img", ".dat", ".raw", ".bsq", ".bil", ".bip", ".bin", ".cube")


def read(path: Path) -> SpectralCube:
    """Return the cube of an ENVI header (.hdr); the data lie beside it. InputFileError if the two do not fit each other."""
    header = _header(path)
    try:
        sizes = {key: int(header[key]) for key in ("lines", "samples", "bands")}
        axes = AXES[header["interleave"].lower()]
        order = ">" if int(header.get("byte order", "0")) else "<"
        dtype = np.dtype(order + TYPES[int(header["data type"])])
        offset = int(header.get("header offset", "0"))
        listed = [float(value) for value in header["wavelength"].split(",")] if "wavelength" in header else None
        white = float(header["reflectance scale factor"]) if "reflectance scale factor" in header else None
    except KeyError as error:
        raise InputFileError(f"{path}: {error.args[0]} is missing or of no known kind; give a whole ENVI header") from error
    except ValueError as error:
        raise InputFileError(f"{path}: {error}; give a whole ENVI header") from error
    data = _data(path)
    shape = tuple(sizes[axis] for axis in axes)
    wanted = offset + math.prod(shape) * dtype.itemsize
    require_picture(str(path), sizes["lines"], sizes["samples"], sizes["bands"])
    if min(shape) < 1 or offset < 0 or data.stat().st_size < wanted:
        raise InputFileError(f"{data} has {data.stat().st_size} bytes, its header wants {wanted}; give the whole file")
    stored = np.memmap(data, dtype, "r", offset, shape)
    values = stored.transpose([axes.index(axis) for axis in ("lines", "samples", "bands")])
    wavelength = None if listed is None else np.array(listed) * _unit(header, listed)
    return SpectralCube(values, wavelength, white)


def _header(path: Path) -> dict[str, str]:
    """Return the keys in lower case and values, braces taken off."""
    text = read_bounded(path).decode("latin-1")
    if not text.lstrip().startswith("ENVI"):
        raise InputFileError(f"{path} is not an ENVI header; give the .hdr file")
    header, lines = {}, iter(text.splitlines())
    for line in lines:
        key, equals, value = line.partition("=")
        if not equals or line.lstrip().startswith(";"):  # a comment
            continue
        values = [value]
        while values[0].lstrip().startswith("{") and "}" not in values[-1]:
            values.append(next(lines, "}"))
        header[key.strip().lower()] = " ".join(values).partition("}")[0].replace("{", "").strip()
    return header


def size(path: Path) -> tuple[int, int]:
    """Return (rows, cols); the data are only mapped for it."""
    rows, cols, _ = read(path).values.shape
    return rows, cols


def files(path: Path) -> list[Path]:
    """Return an ENVI header and its data; InputFileError unless both are there."""
    _header(path)
    return [path, _data(path)]


def _data(path: Path) -> Path:
    stem = path.with_suffix("")
    for suffix in DATA:
        for data in (stem.with_name(stem.name + suffix), stem.with_name(stem.name + suffix.upper())):
            if data.is_file() and data != path:
                return data
    raise InputFileError(f"{path}: its data file is missing; put {stem.name} or {stem.name}.img beside the header")


def _unit(header: dict[str, str], listed: list[float]) -> float:
    """Return how many nm a unit has of the listed wavelengths; by the header or else by their size."""
    named = header.get("wavelength units", "").lower()
    return UNITS.get(named, 1e3 if max(listed) < 100 else 1.0)
