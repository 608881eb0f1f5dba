"""A stored cube and what the recipe says about it → a scene."""

import numpy as np

from l3cli.frames.scene import NO_ILLUMINANT, Scene, SpectralCube
from l3cli.physics import spectra
from l3cli.simulation.light import Light
from l3cli.simulation.sources import Spectral

AXES = ("row", "col", "band")
BRIGHT = 0.999  # share of the pixels that are at most a perfect white, where radiance came without its light
BRIGHTEST_USUAL = 2.0  # median reflectance of a scene: more is percent, counts or radiance
SPARSE = 8  # samples apart that tell the median
STRIP = 128  # rows converted at once


def scene_of(cube: SpectralCube, source: Spectral, name: str, light: Light | None) -> Scene:
    """Return the scene of a cube under `light` (None: not known, for radiance).

    Reflectance is stored value / white. Radiance is divided by that of a perfect white under `light`, whose level, like the
    cube's own, only `white` can tell; without a light the brightest pixels are taken as a white under equal photons, and
    the scene keeps only that. Small negatives become zero (docs/method.md#simulation). ValueError says what does not fit.
    """
    wavelength, values = _bands(cube, source)
    white = source.white or cube.white or (np.iinfo(values.dtype).max if values.dtype.kind in "iu" else 1.0)
    per_white = np.full(wavelength.size, 1.0 / white)
    illuminant = NO_ILLUMINANT
    if source.holds != "reflectance":
        per_white *= _photons(wavelength, source)
        illuminant = np.ones(wavelength.size)
        if light is not None:
            stored = light.radiance / _photons(light.wavelength, source)
            illuminant = spectra.average(stored, light.wavelength, wavelength) * _photons(wavelength, source)
            if not (illuminant > 0).all():
                dark = wavelength[illuminant <= 0][0]
                raise ValueError(f"its light has no power at {dark:g} nm; give a light that covers all bands")
        illuminant = illuminant / illuminant.max()
        per_white /= illuminant
    reflectance = np.empty(values.shape, np.float32)
    for top in range(0, len(values), STRIP):
        reflectance[top : top + STRIP] = values[top : top + STRIP] * per_white.astype(np.float32)
    if not np.isfinite(reflectance).all():
        raise ValueError("holds values that are not finite (NaN or Inf); repair the cube")
    np.maximum(reflectance, 0.0, out=reflectance)
    if source.holds != "reflectance" and source.white is None:
        _normalise(reflectance)
    usual = float(np.median(reflectance[::SPARSE, ::SPARSE]))
    if source.holds == "reflectance" and usual > BRIGHTEST_USUAL:
        raise ValueError(
            f"its reflectances are {usual:.3g} in the median, and 1 is white; give white, 100 for percent, or holds"
        )
    return Scene(name, wavelength, reflectance, illuminant)


def _photons(wavelength: np.ndarray, source: Spectral) -> np.ndarray:
    """Return the photons of one unit of what the cube holds, (wavelength), up to a factor that is the same for all."""
    one = np.ones(wavelength.size)
    return spectra.photons_from_energy(wavelength, one) if source.holds == "radiance" else one


def _normalise(reflectance: np.ndarray) -> None:
    """Scale so that nearly all pixels are at most a perfect white."""
    peak = float(np.quantile(reflectance.max(axis=2), BRIGHT))
    if peak <= 0:
        raise ValueError("is black everywhere")
    reflectance /= np.float32(peak)


def _bands(cube: SpectralCube, source: Spectral) -> tuple[np.ndarray, np.ndarray]:
    """Return the bands' wavelengths in nm, increasing, and values (row, col, band): the wavelengths are the recipe's, else
    the file's."""
    if source.wavelengths_nm is not None:
        wavelength = np.array(source.wavelengths_nm)
    elif source.wavelength_range_nm is not None:
        first, last, step = source.wavelength_range_nm
        wavelength = np.arange(first, last + step / 2, step)
    elif cube.wavelength is not None:
        wavelength = cube.wavelength
    else:
        raise ValueError("holds no wavelengths; give wavelengths_nm or wavelength_range_nm in the recipe")
    shape = cube.values.shape
    if shape[2] != wavelength.size:
        described = f"its {' × '.join(map(str, shape))} values (row × col × band) do not fit {wavelength.size} wavelengths"
        if wavelength.size in shape[:2]:
            raise ValueError(
                f"{described}: the bands lie along its {AXES[shape.index(wavelength.size)]} axis; turn the cube (axes)"
            )
        raise ValueError(f"{described}; correct wavelengths_nm")
    wavelength, values = spectra.ascending(wavelength, cube.values)
    if not np.isfinite(wavelength).all() or (np.diff(wavelength) <= 0).any():
        raise ValueError("its wavelengths do not increase; sort the bands or give wavelengths_nm in the recipe")
    return wavelength, values
