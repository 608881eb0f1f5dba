"""Spectra of IES TM-27-14, through colour-science (Illuminating Engineering Society, Standard Format for the Electronic
Transfer of Spectral Data)."""

import warnings
from pathlib import Path
from xml.etree.ElementTree import ParseError

import numpy as np
from numpy.typing import NDArray

from l3cli.limits import MOST_TEXT
from l3cli.physics.spectra import colour_science

UNITS = {  # of each quantity that the standard has
    "radiance": "W/(sr m² nm)",
    "irradiance": "W/(m² nm)",
    "exitance": "W/(m² nm)",
    "intensity": "W/(sr nm)",
    "flux": "W/nm",
    "relative": "relative power",
    "other": None,
}


def read_spdx(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64], str | None]:
    """Wavelengths (nm), values, and the unit of their quantity, None where it has none; ValueError if the file holds no
    spectrum."""
    if path.stat().st_size > MOST_TEXT:
        raise ValueError(f"larger than {MOST_TEXT >> 20} MB")
    colour = colour_science()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            spectrum = colour.SpectralDistribution_IESTM2714(str(path)).read()
    except (ParseError, OSError, TypeError, KeyError, AttributeError) as error:
        raise ValueError(str(error).splitlines()[0] if str(error) else type(error).__name__) from error
    quantity = (spectrum.spectral_quantity or "other").lower()
    wavelength, values = np.asarray(spectrum.wavelengths, np.float64), np.asarray(spectrum.values, np.float64)
    return wavelength, values, UNITS.get(quantity)
