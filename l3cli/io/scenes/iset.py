"""Reads ISET scene files (.mat)."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError, raised_as
from l3cli.frames.scene import Scene
from l3cli.io.scenes.cube import Content, array_shapes, read_matlab
from l3cli.physics import spectra

Curve = tuple[NDArray[np.floating], NDArray[np.floating]]


def read(path: Path, light: Curve | None = None) -> Scene:
    """Read an ISET scene and its illuminant.

    l3 reads all storage forms of ISET: a scene struct with floats or with integers between dmin and dmax, the variables
    photons and wave, and coefficients (mcCOEF) of a basis about a mean (imgMean). Small negative values are noise and become
    zero. Specular highlights are preserved (docs/method.md#simulation).

    Parameters
    ----------
    path : Path
        The file.
    light : tuple of ndarray, optional
        Wavelengths in nm and photons of an illuminant, for files without an illuminant.

    Raises
    ------
    InputFileError
        If the file is not an ISET scene.
    """
    content = read_matlab(path)
    content = content["scene"] if isinstance(content.get("scene"), dict) else content
    try:
        wavelength, photons = _photons(content)
        illuminant = _illuminant(content.get("illuminant"), wavelength, light)
    except KeyError as error:
        raise InputFileError(
            f"{path} is not a complete ISET scene: it lacks {error.args[0]}; save it from ISET again"
        ) from error
    except (ValueError, TypeError) as error:
        raise InputFileError(
            f"{path}: wavelengths or photons are not numbers, or a wavelength occurs twice; save it again"
        ) from error
    if wavelength.size == 1 and photons.ndim == 2:
        photons = photons[..., None]  # MATLAB drops a last axis of length 1
    if photons.ndim != 3 or photons.shape[2] != wavelength.size:
        raise InputFileError(
            f"{path}: {photons.shape} photons do not fit {wavelength.size} wavelengths; save the scene again"
        )
    if illuminant.size != wavelength.size or not (illuminant > 0).all():
        raise InputFileError(f"{path}: its illuminant is not one positive value for each of {wavelength.size} wavelengths")
    with raised_as(InputFileError, path):
        photons /= illuminant.astype(np.float32)
        _, illuminant = spectra.ascending(wavelength, illuminant)
        wavelength, photons = spectra.ascending(wavelength, photons)
        return Scene(path.stem, wavelength, np.maximum(photons, 0.0, out=photons), illuminant)


def size(path: Path, light: Curve | None = None) -> tuple[int, int]:
    """Return the rows and columns of an ISET scene. They are read from the header if it states them."""
    shapes = array_shapes(path)
    for name in (f"{scene}{array}" for scene in ("scene/", "") for array in ("mcCOEF", "photons", "data/photons")):
        if len(shapes.get(name, ())) in (2, 3):
            return shapes[name][0], shapes[name][1]
    rows, cols, _ = read(path, light).reflectance.shape  # also raises if something is wrong
    return rows, cols


def _photons(content: Content) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Return wavelengths in nm and photons (row, col, wave). Raises KeyError, with its name, if a variable is missing."""
    if "mcCOEF" in content:
        basis = content["basis"]
        functions = np.asarray(basis["basis"], np.float32).reshape(np.size(basis["wave"]), -1)
        coefficients = np.asarray(content["mcCOEF"], np.float32)
        coefficients = coefficients.reshape(*coefficients.shape[:2], -1)
        photons = coefficients @ functions.T
        mean = np.asarray(content.get("imgMean", ()), np.float32)
        return _numbers(basis["wave"]), photons + mean.ravel() if mean.size else photons
    if "photons" in content:
        return _numbers(content["wave"]), _decoded(content["photons"], content, "dmin", "dmax")
    if "data" not in content:
        raise KeyError("a scene, photons or mcCOEF")
    return _numbers(content["spectrum"]["wave"]), _decoded(content["data"]["photons"], content["data"], "dmin", "dmax")


def _illuminant(stored: Any, wavelength: NDArray[np.float64], light: Curve | None) -> NDArray[np.float64]:
    """Return the photons (wavelength) from a perfect white.

    They come from ISET's new illuminant struct (photons), from its old struct (energy), or from `light`.
    """
    if not isinstance(stored, dict):
        if light is None:
            raise KeyError('illuminant (or give "light" in the recipe)')
        return spectra.average(light[1].ravel(), light[0], wavelength)
    if isinstance(stored.get("data"), dict):
        data = stored["data"]
        photons = np.asarray(_decoded(data["photons"], data, "min", "max"), float).ravel()
        grid = _numbers(stored["spectrum"]["wave"]) if isinstance(stored.get("spectrum"), dict) else wavelength
    elif "data" not in stored:
        raise KeyError("data in its illuminant")
    else:
        grid = _numbers(stored["wavelength"])
        photons = spectra.photons_from_energy(grid, np.asarray(stored["data"], float).ravel())
    return spectra.average(photons, grid, wavelength) if grid.size == photons.size else photons


def _numbers(values: Any) -> NDArray[np.float64]:
    return np.atleast_1d(np.asarray(values, float)).ravel()


def _decoded(values: Any, holder: Content, low: str, high: str) -> NDArray[np.float32]:
    """Return floats unchanged, and decode integers. In ISET, the range of integers is mapped to `low`…`high`."""
    array = np.asarray(values)
    decoded = array.astype(np.float32)
    if array.dtype.kind in "iu":
        bottom, top = float(holder[low]), float(holder[high])
        decoded *= np.float32((top - bottom) / np.iinfo(array.dtype).max)
        decoded += np.float32(bottom)
    return decoded
