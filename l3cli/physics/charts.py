"""Reflectances of ColorChecker patches."""

import functools
import re

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import RecipeError, suggestion
from l3cli.physics import spectra

CLASSIC = (4, 6)  # rows and columns of patches on the classic ColorChecker
# Data sets in colour-science: two sets of spectra, and the manufacturer's colours for charts since 2014.
AVERAGE, STANDARD = "BabelColor Average", "ISO 17321-1"
SINCE_2014 = "ColorChecker24 - After November 2014"
CHARTS = {  # data sets of each chart: spectra, and the manufacturer's colours if the spectra must be adapted to them
    "classic": (AVERAGE, None),
    "classic ISO 17321": (STANDARD, None),
    "classic 2014": (AVERAGE, SINCE_2014),
    "passport": (AVERAGE, None),
    "passport 2": (AVERAGE, SINCE_2014),
}
NO_SPECTRA = (
    "the reflectances of this chart are not published; set chart to a CSV file with a column of wavelengths and one column "
    'of reflectances per patch, in row order: chart = "sg.csv", layout = [10, 14]'
)
CORRECTION_NM = 60.0  # correlation length, in nm, of the factors that adapt spectra to the manufacturer's colours
Array = NDArray[np.floating]


def chart(name: str, wavelength: Array) -> tuple[tuple[str, ...], Array]:
    """Return the names and reflectances of ColorChecker patches, row by row.

    "classic" and "passport" are charts from before November 2014, with the average spectra of thirty charts (BabelColor).
    The spectra of "classic ISO 17321" are from ISO 17321-1. Later charts ("classic 2014", "passport 2") have different
    pigments with unpublished spectra. For these charts, each average spectrum of the older charts is multiplied by a smooth
    function of wavelength, so that the patch has the manufacturer's colour.

    Parameters
    ----------
    name : str
        A key of CHARTS.
    wavelength : ndarray, (wavelength,)
        Wavelengths in nm.

    Returns
    -------
    names : tuple of str
        Names of the patches.
    reflectance : ndarray, (patch, wavelength)
        Reflectances, interpolated linearly and constant outside the measured range.

    Raises
    ------
    RecipeError
        If the name is unknown.
    """
    if name not in CHARTS:
        if re.search(r"\bsg\b|semi.?gloss", name.casefold()):
            raise RecipeError(f'chart "{name}": {NO_SPECTRA}')
        raise RecipeError(f'chart "{name}" is unknown; {suggestion(name, CHARTS)} (or a CSV file of reflectances)')
    measured, stated = CHARTS[name]
    patches = spectra.colour_science().SDS_COLOURCHECKERS[measured]
    reflectance = np.array([np.interp(wavelength, patch.wavelengths, patch.values) for patch in patches.values()])
    return tuple(patches), reflectance if stated is None else _corrected(reflectance, wavelength, stated)


def _corrected(reflectance: Array, wavelength: Array, stated: str) -> Array:
    """Multiply each reflectance by the smoothest function of wavelength that results in the stated colour."""
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
    """Return the manufacturer's colours as XYZ (patch, 3) under D50, relative to a perfect white with Y = 1."""
    colour = spectra.colour_science()
    table = colour.CCS_COLOURCHECKERS[stated]
    assert np.allclose(table.illuminant, colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D50"], atol=2e-3)
    return np.array([colour.xyY_to_XYZ(patch) for patch in table.data.values()])
