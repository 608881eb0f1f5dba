"""Scenes from outside: ISET scene files (.mat) and RGB pictures."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError, L3Error
from l3cli.files import atomic_output
from l3cli.io.images import read_image
from l3cli.scene import Scene


def find(pattern: str, folder: Path) -> list[Path]:
    """The files of a name or glob relative to `folder`, sorted; InputFileError if there is none."""
    single = folder / pattern
    if single.is_file():
        return [single]
    root = Path(single.anchor)  # "" for a relative folder
    found = sorted(path for path in root.glob(str(single.relative_to(root))) if path.is_file())
    if not found:
        raise InputFileError(f"{single} does not exist; name a scene file or a glob relative to the recipe")
    return found


# ------------------------------------------------------------------------------------------------------ ISET


def read_iset_scene(path: Path) -> Scene:
    """An ISET scene: photons (row, col, wave) in photons/s/sr/m²/nm, as floats or coded as integers between dmin and
    dmax, with its illuminant. Small negatives are noise and become zero, speculars stay (METHOD 2).

    InputFileError if the file is no such scene.
    """
    scene = _matlab_struct(path, "scene")
    try:
        wavelength = np.atleast_1d(np.asarray(scene.spectrum.wave, float))
        photons = _decoded(scene.data.photons, scene.data, "dmin", "dmax")
        light = scene.illuminant
        illuminant = _decoded(light.data.photons, light.data, "min", "max").ravel()
    except AttributeError as error:
        missing = str(error).rsplit("'", 2)[-2]
        raise InputFileError(f"{path} is no complete ISET scene: it lacks {missing}; save it from ISET again") from error
    except (ValueError, TypeError) as error:
        raise InputFileError(f"{path}: wavelengths or photons are no numbers; save the scene from ISET again") from error
    if wavelength.size == 1:
        photons = photons[..., None]  # loadmat dropped the axis
    if photons.ndim != 3 or photons.shape[2] != wavelength.size:
        raise InputFileError(
            f"{path}: {photons.shape} photons do not fit {wavelength.size} wavelengths; save the scene again"
        )
    if illuminant.size != wavelength.size or not (illuminant > 0).all():
        raise InputFileError(f"{path}: its illuminant is not one positive value for each of {wavelength.size} wavelengths")
    try:
        reflectance = np.maximum(photons / illuminant, 0.0).astype(np.float32)
        return Scene(path.stem, wavelength, reflectance, illuminant)
    except ValueError as error:
        raise InputFileError(f"{path}: {error}") from error


def _matlab_struct(path: Path, name: str) -> Any:
    from scipy.io import loadmat

    try:
        content = loadmat(path, struct_as_record=False, squeeze_me=True)
    except OSError as error:
        raise InputFileError(f"{path}: {error.strerror or error}") from error
    except NotImplementedError as error:
        raise InputFileError(f"{path} is a MATLAB 7.3 file; save it with -v7") from error
    except Exception as error:  # scipy raises whatever it stumbles over
        raise InputFileError(f"{path} is not a MATLAB file; give an ISET scene") from error
    if not hasattr(content.get(name), "_fieldnames"):
        raise InputFileError(f'{path} holds no struct "{name}"; give an ISET scene')
    return content[name]


def _decoded(values: Any, holder: Any, low: str, high: str) -> NDArray[np.float64]:
    """Floats as they are; integers as ISET codes them: the type's range from `low` to `high`."""
    array = np.asarray(values)
    if array.dtype.kind == "f":
        return array.astype(np.float64)
    bottom, top = float(getattr(holder, low)), float(getattr(holder, high))
    return bottom + (top - bottom) * (array / np.iinfo(array.dtype).max)


# -------------------------------------------------------------------------------------------------- pictures


def read_rgb_picture(path: Path) -> NDArray[np.float32]:
    """Linear sRGB (row, col, 3) of a picture, 1 being white: integers are decoded from sRGB, floats are linear already.

    InputFileError if the file is no colour picture.
    """
    pixels, names = read_image(path)
    if len(names) < 3:
        raise InputFileError(f"{path} has no red, green and blue; give a colour picture")
    if pixels.dtype.kind == "f":
        return np.maximum(np.nan_to_num(pixels[..., :3]), 0.0).astype(np.float32)
    levels = np.arange(np.iinfo(pixels.dtype).max + 1) / np.iinfo(pixels.dtype).max
    linear = np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4).astype(np.float32)
    return linear[pixels[..., :3]]


def write_mosaic(path: Path, values: NDArray[np.uint16]) -> None:
    """A raw mosaic (row, col) in DN as a 16-bit mono TIFF. It belongs beside the other writers in io/images.py."""
    import OpenImageIO as oiio

    with atomic_output(path) as temporary:
        sink = oiio.ImageOutput.create(str(temporary))
        if sink is None:
            raise L3Error(f"{path} cannot be written: {oiio.geterror()}")
        spec = oiio.ImageSpec(values.shape[1], values.shape[0], 1, "uint16")
        spec.attribute("compression", "zip")
        written = sink.open(str(temporary), spec) and sink.write_image(np.ascontiguousarray(values[..., None]))
        if not (sink.close() and written):
            raise L3Error(f"{path} cannot be written: {sink.geterror()}")
