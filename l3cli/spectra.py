"""Wavelengths, illuminants, observers and reflectances: the one door to colour-science.

Spectra are arrays over a wavelength grid in nm. Radiance is in photons/s/sr/m²/nm unless a name says otherwise.
"""

import functools
import re
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import RecipeError

PLANCK = 6.62607015e-34  # J s
LIGHT_SPEED = 299792458.0  # m/s
LUMINOUS_EFFICACY = 683.0  # lm/W
Array = NDArray[np.floating]


def _colour() -> Any:
    """colour-science, imported when first needed (it takes two seconds) and without its import-time warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import colour
    return colour


def photons_from_energy(wavelength: Array, energy: Array) -> Array:
    """Photon count per joule-based spectrum: energy (…, wavelength) W… → photons/s…"""
    return energy * (wavelength * 1e-9) / (PLANCK * LIGHT_SPEED)


def bin_widths(wavelength: Array) -> Array:
    """Width in nm that each sample of a grid stands for, (wavelength): Σ f·Δλ approximates the integral."""
    return np.gradient(wavelength) if wavelength.size > 1 else np.ones(1)


def interpolation_matrix(source: Array, target: Array) -> Array:
    """M (target, source): linear interpolation, zero outside the source's range."""
    matrix = np.zeros((target.size, source.size))
    for column in range(source.size):
        unit = np.zeros(source.size)
        unit[column] = 1.0
        matrix[:, column] = np.interp(target, source, unit, left=0.0, right=0.0)
    return matrix


def resample(spectrum: Array, source: Array, target: Array) -> Array:
    """spectrum (…, source) linearly interpolated onto `target`, zero outside the source's range."""
    return spectrum @ interpolation_matrix(source, target).T


def sampling_matrix(source: Array, target: Array) -> Array:
    """M (target, source): a spectrum as its samples at `target` see it. On a grid finer than the target's, the mean under
    the hat about each sample, so that spectral lines between samples count; otherwise linear interpolation."""
    if source.size <= target.size:
        return interpolation_matrix(source, target)
    hats = interpolation_matrix(target, source).T * bin_widths(source)
    return hats / hats.sum(axis=1, keepdims=True)


def colour_matching_functions(wavelength: Array, observer: str = "CIE 1931 2 Degree Standard Observer") -> Array:
    """x̄ ȳ z̄, (3, wavelength), linearly interpolated from the tabulated 1 nm observer."""
    observers = _colour().MSDS_CMFS
    if observer not in observers:
        raise RecipeError(f'observer "{observer}" is unknown; use "CIE 1931 2 Degree Standard Observer"')
    cmfs = observers[observer]
    return resample(cmfs.values.T, cmfs.wavelengths, wavelength)


def xyz_weights(wavelength: Array) -> Array:
    """W (3, wavelength): CIE 1931 XYZ with Y in cd/m² = W @ radiance (photons/s/sr/m²/nm)."""
    energy_per_photon = PLANCK * LIGHT_SPEED / (wavelength * 1e-9)
    return LUMINOUS_EFFICACY * colour_matching_functions(wavelength) * energy_per_photon * bin_widths(wavelength)


@functools.cache
def illuminant_names() -> tuple[str, ...]:
    """The named illuminants; beside them any "<temperature>K" is a black body."""
    return tuple(sorted(_colour().SDS_ILLUMINANTS))


def illuminant(name: str, wavelength: Array) -> Array:
    """Relative photon radiance (wavelength), mean 1, of a named CIE illuminant or a black body such as "3200K"."""
    blackbody = re.fullmatch(r"(\d+(?:\.\d+)?) ?K", name)
    if blackbody:
        metres = wavelength * 1e-9
        exponent = PLANCK * LIGHT_SPEED / (metres * 1.380649e-23 * float(blackbody[1]))
        photons = 1.0 / (metres**4 * np.expm1(exponent))
    else:
        if name not in illuminant_names():
            known = ", ".join(illuminant_names())
            raise RecipeError(f'illuminant "{name}" is unknown; use a black body such as "3200K" or one of {known}')
        table = _colour().SDS_ILLUMINANTS[name]
        energy = np.interp(wavelength, table.wavelengths, table.values)
        photons = photons_from_energy(wavelength, energy)
    return photons / photons.mean()


def at_luminance(radiance: Array, wavelength: Array, luminance: float) -> Array:
    """`radiance` (wavelength) scaled so that its luminance is `luminance` cd/m²."""
    return radiance * (luminance / (xyz_weights(wavelength)[1] @ radiance))


def white_point(name: str) -> NDArray[np.float64]:
    """XYZ (3), Y = 1, of a perfect reflector under a named illuminant or black body."""
    wavelength = np.arange(380.0, 781.0, 5.0)
    xyz = xyz_weights(wavelength) @ illuminant(name, wavelength)
    return xyz / xyz[1]


def colorchecker(wavelength: Array) -> tuple[tuple[str, ...], Array]:
    """Names and reflectances (24, wavelength) of the classic ColorChecker, row by row from dark skin to black."""
    chart = _colour().SDS_COLOURCHECKERS["ISO 17321-1"]
    reflectance = [np.interp(wavelength, patch.wavelengths, patch.values) for patch in chart.values()]
    return tuple(chart), np.array(reflectance)


@functools.cache
def _reflectance_tables() -> tuple[tuple[Array, Array], ...]:
    """Every measured reflectance set inside colour-science as (wavelength, (sample, wavelength)), but no ColorChecker."""
    colour = _colour()
    from colour.quality.cfi2017 import load_TCS_CIE2017
    from colour.quality.datasets.tcs import SDS_TCS
    from colour.quality.datasets.vs import SDS_VS

    training = colour.characterisation.read_training_data_rawtoaces_v1()
    evaluation = load_TCS_CIE2017(colour.SpectralShape(380, 780, 5))
    tables = [(training.wavelengths, training.values.T), (evaluation.wavelengths, evaluation.values.T)]
    for sets in (SDS_TCS["CIE 2024"], SDS_VS["NIST CQS 9.0"]):
        tables += [(sample.wavelengths, sample.values[None]) for sample in sets.values()]
    return tuple(tables)


def reflectance_library(wavelength: Array) -> Array:
    """Measured reflectances of natural and man-made surfaces, (sample, wavelength), within 0.003–0.999 (METHOD 2.1)."""
    library = np.concatenate(
        [[np.interp(wavelength, grid, sample) for sample in samples] for grid, samples in _reflectance_tables()]
    )
    return np.clip(library[np.isfinite(library).all(axis=1)], 0.003, 0.999)


def lab(xyz: Array, white: Array) -> Array:
    """CIE L*a*b* of xyz (…, 3) relative to `white` (3), in the same scale."""
    x, y = white[0] / white.sum(), white[1] / white.sum()
    return _colour().XYZ_to_Lab(np.asarray(xyz) / white[1], np.array([x, y]))


def delta_e_2000(lab_a: Array, lab_b: Array) -> Array:
    """CIEDE2000 colour difference of two L*a*b* arrays (…, 3)."""
    return _colour().delta_E(lab_a, lab_b, method="CIE 2000")


def adaptation_matrix(white: Array, to: Array) -> Array:
    """Bradford chromatic adaptation (3, 3) of XYZ from `white` to `to`, each (3) with any Y."""
    matrix_vk = _colour().adaptation.matrix_chromatic_adaptation_VonKries
    return matrix_vk(white / white[1], to / to[1], transform="Bradford")


def srgb_from_xyz_matrix() -> Array:
    """Linear sRGB = M (3, 3) @ XYZ with the D65 white at Y = 1."""
    return np.asarray(_colour().RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB)


def srgb_curve(linear: Array) -> Array:
    """Non-linear sRGB of linear values, both clipped to 0…1 (IEC 61966-2-1)."""
    clipped = np.clip(linear, 0.0, 1.0)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * np.maximum(clipped, 1e-9) ** (1 / 2.4) - 0.055)
