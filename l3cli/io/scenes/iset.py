"""Read ISET scene files (.mat)."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError, raised_as
from l3cli.frames.scene import Scene
from l3cli.io.scenes.cube import Content, array_shapes, read_matlab
from l3cli.physics import spectra

Curve = tuple[NDArray[np.floating], NDArray[np.floating]]  # wavelengths in nm, values


def read(path: Path, light: Curve | None = None) -> Scene:
    """Read the reflectances and the illuminant of an ISET scene.

    ISET stores scenes in three forms: as a struct `scene`, as variables `photons` and `wave`, or as coefficients `mcCOEF` of
    basis functions with an optional mean spectrum `imgMean`. Photon counts are floating-point numbers, or integers that
    represent the range from `dmin` to `dmax`. l3 divides them by the illuminant to obtain reflectances. Negative
    reflectances are noise and are set to zero. Reflectances above 1 are specular highlights and are preserved
    (docs/method.md#simulation).

    Parameters
    ----------
    path : Path
        The scene file.
    light : tuple of ndarray, optional
        Illuminant for a file that contains none: wavelengths in nm, and photons at each wavelength.

    Raises
    ------
    InputFileError
        If the file is not a complete ISET scene, or if the illuminant is unknown.
    """
    content = read_matlab(path)
    content = content["scene"] if isinstance(content.get("scene"), dict) else content
    try:
        wavelength, photons = _photons(content)
        illuminant = _illuminant(content.get("illuminant"), wavelength, light)
    except KeyError as error:
        name, cure = (*error.args, "save the scene from ISET again")[:2]
        raise InputFileError(f"{path} is not a complete ISET scene because it contains no {name}; {cure}") from error
    except (ValueError, TypeError) as error:
        raise InputFileError(
            f"{path}: wavelengths or photons are not numbers, or a wavelength occurs twice; save the scene from ISET again"
        ) from error
    if wavelength.size == 1 and photons.ndim == 2:
        photons = photons[..., None]  # MATLAB drops trailing axes of length 1
    if photons.ndim != 3 or photons.shape[2] != wavelength.size:
        raise InputFileError(
            f"{path}: the photons of shape {photons.shape} do not match the {wavelength.size} wavelengths; "
            "save the scene from ISET again"
        )
    if illuminant.size != wavelength.size or not (illuminant > 0).all():
        raise InputFileError(
            f"{path}: the illuminant must have a positive value at each of the {wavelength.size} wavelengths; "
            "save the scene with a complete illuminant"
        )
    with raised_as(InputFileError, path):
        photons /= illuminant.astype(np.float32)
        _, illuminant = spectra.ascending(wavelength, illuminant)
        wavelength, photons = spectra.ascending(wavelength, photons)
        return Scene(path.stem, wavelength, np.maximum(photons, 0.0, out=photons), illuminant)


def size(path: Path, light: Curve | None = None) -> tuple[int, int]:
    """Return the number of rows and columns of the scene that `read` returns.

    The photons are read only if the header does not contain the size. Raises the same errors as `read`.
    """
    shapes = array_shapes(path)
    for name in (f"{scene}{array}" for scene in ("scene/", "") for array in ("mcCOEF", "photons", "data/photons")):
        if len(shapes.get(name, ())) in (2, 3):
            return shapes[name][0], shapes[name][1]
    rows, cols, _ = read(path, light).reflectance.shape  # raises InputFileError if the scene is invalid
    return rows, cols


def _photons(content: Content) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Return wavelengths in nm and photon radiance, (row, col, wavelength), or (row, col) for a single wavelength.

    Raises KeyError with the name of a missing variable.
    """
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
        raise KeyError("scene, photons or mcCOEF")
    return _numbers(content["spectrum"]["wave"]), _decoded(content["data"]["photons"], content["data"], "dmin", "dmax")


def _illuminant(stored: Any, wavelength: NDArray[np.float64], light: Curve | None) -> NDArray[np.float64]:
    """Return the photon radiance of a perfect white under the illuminant, at each wavelength.

    `stored` is the illuminant struct in the file. If it is not a struct, the file contains no illuminant, and `light` is
    used instead. New versions of ISET store photons, and old versions store energy, which l3 converts to photons. Raises
    KeyError if the illuminant is missing or incomplete.
    """
    if not isinstance(stored, dict):
        if light is None:
            raise KeyError("illuminant", 'set "light" in the recipe')
        return spectra.average(light[1].ravel(), light[0], wavelength)
    if isinstance(stored.get("data"), dict):
        data = stored["data"]
        photons = np.asarray(_decoded(data["photons"], data, "min", "max"), float).ravel()
        grid = _numbers(stored["spectrum"]["wave"]) if isinstance(stored.get("spectrum"), dict) else wavelength
    elif "data" not in stored:
        raise KeyError("data of the illuminant")
    else:
        grid = _numbers(stored["wavelength"])
        photons = spectra.photons_from_energy(grid, np.asarray(stored["data"], float).ravel())
    return spectra.average(photons, grid, wavelength) if grid.size == photons.size else photons


def _numbers(values: Any) -> NDArray[np.float64]:
    return np.atleast_1d(np.asarray(values, float)).ravel()


def _decoded(values: Any, holder: Content, low: str, high: str) -> NDArray[np.float32]:
    """Convert stored values to float32.

    Integers are scaled linearly: 0 becomes the field `low` of the struct `holder`, and the largest integer of the data type
    becomes its field `high`.
    """
    array = np.asarray(values)
    decoded = array.astype(np.float32)
    if array.dtype.kind in "iu":
        bottom, top = float(holder[low]), float(holder[high])
        decoded *= np.float32((top - bottom) / np.iinfo(array.dtype).max)
        decoded += np.float32(bottom)
    return decoded
