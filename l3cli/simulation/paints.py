"""Reflectances of artists' paints: mixtures of pigments with titanium white, after Kubelka and Munk.

The ratio of absorption to scattering (K/S) of a pigment consists of Gaussian absorption bands, an absorption edge, and a
constant. Positions and widths of the bands and edges approximate the published spectra of the pigments [1]_ [2]_ [3]_. K/S
of a mixture is the mean of K/S over its parts, because white, which scatters most light, scatters alike in all mixtures.

References
----------
.. [1] A. Cosentino, "FORS spectral database of historical pigments in different binders", e-conservation Journal 2, 2014.
.. [2] Y. Okumura, "Developing a spectral and colorimetric database of artist paint materials", Rochester Institute of
   Technology, 2005.
.. [3] R. L. Feller, A. Roy, E. West FitzHugh and B. H. Berrie (editors), "Artists' Pigments", volumes 1 to 4.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.physics.spectra import BLACKEST, WHITEST, kubelka_munk, with_titanium_white

Array = NDArray[np.floating]

UNMIXED = 0.25  # fraction of the paints without white
WHITE_PARTS = 0.3, 60.0  # range of the amount of white in the other paints, relative to the amount of pigment
WHITE_RATIO = 0.003  # K/S of titanium white above its absorption edge
SURFACE_GLOSS, INSIDE = 0.01, 0.96  # reflectance of the surface, and fraction of the light that enters the paint
TITANIUM_EDGE, TITANIUM_SPREAD = 0.2, 0.7  # K/S of titanium white at 405 nm, and standard deviation of its logarithm
TITANIUM_WIDTHS = 5.0, 11.0  # range of the width of titanium white's absorption edge, in nm


@dataclass(frozen=True)
class Pigment:
    """K/S of a pigment."""

    bands: tuple[tuple[float, float, float], ...] = ()  # K/S, wavelength in nm and standard deviation in nm of each band
    edge: tuple[float, float, float] = (0.0, 400.0, 10.0)  # K/S below the edge, wavelength in nm and width in nm
    rest: float = 0.0  # K/S at all wavelengths

    def ratio(self, wavelength: Array) -> Array:
        """Return K/S at each wavelength (nm)."""
        below, at, width = self.edge
        ratio = self.rest + below / (1.0 + np.exp((wavelength - at) / width))
        for height, centre, deviation in self.bands:
            ratio = ratio + height * np.exp(-0.5 * ((wavelength - centre) / deviation) ** 2)
        return np.asarray(ratio)


# Blue pigments are absent. The spectra of cobalt blue, ultramarine and phthalocyanine blue are unlike those of other blue
# materials, and make a Bayer camera render blue skies with too little red.
PIGMENTS = {
    "yellow ochre": Pigment(((1.2, 480, 40), (0.25, 650, 55)), (3.0, 525, 18), 0.10),
    "raw sienna": Pigment(((2.0, 490, 45), (0.8, 650, 60)), (6.0, 535, 20), 0.4),
    "burnt sienna": Pigment(((3.0, 530, 40), (0.9, 680, 60)), (9.0, 575, 15), 0.5),
    "red ochre": Pigment(((2.0, 530, 40), (0.5, 680, 60)), (7.0, 580, 12), 0.25),
    "phthalocyanine green": Pigment(((12.0, 640, 35), (9.0, 715, 40), (4.0, 585, 30), (2.0, 395, 45)), rest=0.12),
    "cadmium yellow": Pigment(edge=(12.0, 495, 6), rest=0.02),
    "cadmium orange": Pigment(edge=(12.0, 550, 7), rest=0.03),
    "cadmium red": Pigment(edge=(12.0, 597, 7), rest=0.06),
    "quinacridone": Pigment(((6.0, 530, 28), (7.0, 568, 16), (3.0, 490, 30), (0.5, 400, 40)), rest=0.05),
    "carbon black": Pigment(rest=20.0),
}


def draw_paint(rng: np.random.Generator, wavelength: Array) -> Array:
    """Draw the reflectance of a paint from one or two pigments, mostly mixed with titanium white.

    Parameters
    ----------
    rng : Generator
        Source of random numbers. The numbers that are drawn do not depend on the wavelengths.
    wavelength : ndarray, (band,)
        Wavelengths in nm.

    Returns
    -------
    ndarray, (band,)
    """
    count = rng.integers(1, 3)
    chosen = rng.choice(list(PIGMENTS), size=count)
    ratio = np.sum(
        [part * PIGMENTS[name].ratio(wavelength) for name, part in zip(chosen, rng.dirichlet(np.ones(count)), strict=True)],
        0,
    )
    white = 0.0 if rng.random() < UNMIXED else np.exp(rng.uniform(*np.log(WHITE_PARTS)))
    edge, width = np.exp(rng.normal(np.log(TITANIUM_EDGE), TITANIUM_SPREAD)), rng.uniform(*TITANIUM_WIDTHS)
    inside = kubelka_munk((ratio + white * WHITE_RATIO) / (1.0 + white))
    reflectance = np.clip(SURFACE_GLOSS + INSIDE * inside, BLACKEST, WHITEST)
    return with_titanium_white(reflectance, wavelength, edge, width) if white else reflectance
