"""Test charts with known reflectances, by name."""

import functools
import re

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import RecipeError, suggestion
from l3cli.physics import spectra

CLASSIC = (4, 6)  # rows and columns of patches
AVERAGE, STANDARD = "BabelColor Average", "ISO 17321-1"
SINCE_2014 = "ColorChecker24 - After November 2014"
CHARTS = {  # name: (measured spectra, colours that the manufacturer states for newer charts)
    "classic": (AVERAGE, None),
    "classic ISO 17321": (STANDARD, None),
    "classic 2014": (AVERAGE, SINCE_2014),
    "passport": (AVERAGE, None),
    "passport 2": (AVERAGE, SINCE_2014),
}
NO_SPECTRA = (
    "only its colours are published, not its reflectances; give these as a CSV file with the wavelength and one column per "
    'patch, row by row: chart = "sg.csv", layout = [10, 14]'
)
CORRECTION_NM = 60.0  # nm; correlation length of the correction for the dyes of newer charts
Array = NDArray[np.floating]


def chart(name: str, wavelength: Array) -> tuple[tuple[str, ...], Array]:
    """Return the patches of a chart with CLASSIC rows and columns, row by row.

    "classic" and "passport" are ColorCheckers made before November 2014: the average of thirty charts (BabelColor) and the
    single chart in ISO 17321-1. Later charts have other dyes, whose spectra are not published. For "classic 2014" and
    "passport 2", the older spectra are multiplied by the smoothest factors that give the colours stated by the manufacturer.

    Parameters
    ----------
    name : str
        A key of CHARTS.
    wavelength : ndarray, (wavelength)
        Wavelengths in nm.

    Returns
    -------
    names : tuple of str
        Names of the patches.
    reflectance : ndarray, (patch, wavelength)
        Reflectances.

    Raises
    ------
    RecipeError
        If the name is unknown.
    """
    if name not in CHARTS:
        if re.search(r"\bsg\b|semi.?gloss", name.casefold()):
            raise RecipeError(f'chart "{name}": {NO_SPECTRA}')
        raise RecipeError(f'chart "{name}" is unknown; {suggestion(name, CHARTS)} (and CSV files of reflectances)')
    measured, stated = CHARTS[name]
    patches = spectra.colour_science().SDS_COLOURCHECKERS[measured]
    reflectance = np.array([np.interp(wavelength, patch.wavelengths, patch.values) for patch in patches.values()])
    return tuple(patches), reflectance if stated is None else _corrected(reflectance, wavelength, stated)


def _corrected(reflectance: Array, wavelength: Array, stated: str) -> Array:
    """Multiply reflectances by the smoothest factors that give the stated colours."""
    target = _stated_xyz(stated)
    light = spectra.illuminant("D50", wavelength)
    weights = spectra.xyz_weights(wavelength) * light
    weights = weights / weights[1].sum()
    distance = (wavelength[:, None] - wavelength) / CORRECTION_NM
    kernel = np.exp(-0.5 * distance**2)
    rows = []
    for patch, xyz in zip(reflectance, target, strict=True):
        design = weights * patch
        factor = kernel @ design.T @ np.linalg.solve(design @ kernel @ design.T, xyz - design.sum(axis=1))
        rows.append(patch * (1.0 + factor))
    return np.clip(np.array(rows), 0.001, 1.0)


@functools.cache
def _stated_xyz(stated: str) -> Array:
    """Return the colours (patch, 3) that the manufacturer states, as XYZ under D50. A perfect white has Y = 1."""
    colour = spectra.colour_science()
    table = colour.CCS_COLOURCHECKERS[stated]
    assert np.allclose(table.illuminant, colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D50"], atol=2e-3)
    return np.array([colour.xyY_to_XYZ(patch) for patch in table.data.values()])
