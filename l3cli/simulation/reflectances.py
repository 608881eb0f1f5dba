"""Reflectance spectra: random materials for procedural scenes, and spectra for RGB pictures.

Random materials are varied, smooth and physically valid (docs/method.md#procedural-scenes). They come from four sources:

1. measured surfaces, unchanged or mixed,
2. a Gaussian distribution fitted to the measured surfaces in logit space,
3. models of materials that are common in pictures: skin, leaves and hair,
4. paints from artists' pigments.

Saturation is mostly low and varies between scenes. RGB pictures are converted to smooth reflectances with the colours of the
pixels (docs/method.md#pictures-converted-to-spectra).
"""

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from l3cli.frames.scene import NO_ILLUMINANT, SHOWN, Scene
from l3cli.physics import spectra
from l3cli.physics.display import SRGB_FROM_XYZ
from l3cli.physics.spectra import BLACKEST, WHITEST, kubelka_munk, with_saturation, with_titanium_white
from l3cli.simulation.light import make_light, matching_weights
from l3cli.simulation.paints import draw_paint

Array = NDArray[np.floating]

COMPONENTS = 8  # number of principal components of the Gaussian in logit space
# Wavelengths in nm at which materials are drawn. They do not depend on the camera, so that a material always has the same
# colour.
DRAWN = np.arange(SHOWN[0], SHOWN[1] + 1.0, 10.0)

# relative frequencies of materials (docs/method.md#procedural-scenes)
KIND_FREQUENCIES = {"library": 0.25, "mixture": 0.2, "gaussian": 0.35, "skin": 0.12, "leaf": 0.04, "hair": 0.04}
# types of material with random saturation; all other types have their natural saturation
DYED = ("library", "mixture", "gaussian")
VIVID = (0.0, 1.2)  # range of the saturation in charts of dyed materials; 0 is grey, 1 is the measured saturation
VESSEL = 0.007  # radius of the blood vessels of the skin, in cm
PAINTED = 0.75  # fraction of the dyed materials that contain titanium white, as paint, plastic and paper do

# Molar extinction of oxygenated and deoxygenated haemoglobin in cm-1/M, 390…780 nm in steps of 10 nm (S. Prahl, omlc.org).
HAEMOGLOBIN_WAVELENGTH = np.arange(390.0, 781.0, 10.0)
OXYGENATED = np.array(
    [167748, 266232, 466840, 480360, 246072, 102580, 62816, 44480, 33209, 26629, 23684, 20932, 20035, 24202, 39956, 53236]
    + [43016, 32613, 44496, 50104, 14400, 3200, 1506, 942, 610, 442, 368, 319, 294, 277, 276, 290, 314, 348, 390, 446]
    + [518, 586, 650, 710]
)
DEOXYGENATED = np.array(
    [167748, 223296, 303956, 407560, 528600, 413280, 103292, 23388, 16156, 14550, 16684, 20862, 25773, 31589, 39036, 46592]
    + [53412, 53788, 45072, 37020, 28324, 14677, 9443, 6509, 5148, 4345, 3750, 3226, 2795, 2407, 2052, 1794, 1540, 1326]
    + [1102, 1116, 1405, 1549, 1312, 1075]
)

EXACTNESS = 1e4  # weight of the colour equations relative to smoothness


@dataclass(frozen=True)
class Surfaces:
    """Measured reflectances, and a Gaussian distribution fitted to their logits."""

    wavelength: Array  # (band,), nm
    measured: Array  # (sample, band), reflectance
    mean: Array  # (band,), mean logit
    components: Array  # (component, band), principal components of the logit, each scaled to one standard deviation
    drawn: NDArray[np.bool_]  # (band,), True at the wavelengths at which materials are drawn (DRAWN)


@functools.lru_cache(maxsize=2)
def surfaces(wavelength: tuple[float, ...]) -> Surfaces:
    """Load measured reflectances from colour-science, without the ColorChecker, and fit a Gaussian to their logits.

    The Gaussian is fitted at the wavelengths in DRAWN. At other wavelengths, its components are computed by linear
    regression, so that a random material has the same colour on any wavelength grid.

    Parameters
    ----------
    wavelength : tuple of float
        Wavelength grid in nm.
    """
    grid = np.array(wavelength)
    every = np.union1d(DRAWN, grid)
    library = spectra.reflectance_library(every)
    drawn = _logit(np.compress(drawn_bands(every), library, axis=1))
    scores, spread, directions = np.linalg.svd(drawn - drawn.mean(axis=0), full_matrices=False)
    measured = np.compress(np.isin(every, grid), library, axis=1)
    logit = _logit(measured)
    mean = logit.mean(axis=0)
    components = scores.T[:COMPONENTS] @ (logit - mean) / np.sqrt(len(logit))
    own = (spread[:, None] * directions)[:COMPONENTS] / np.sqrt(len(logit))
    components[:, drawn_bands(grid)] = own[:, np.isin(DRAWN, grid)]
    return Surfaces(grid, measured, mean, components, drawn_bands(grid))


def _logit(reflectance: Array) -> Array:
    return np.asarray(np.log(reflectance / (1.0 - reflectance)))


def drawn_bands(wavelength: Array) -> NDArray[np.bool_]:
    """Return a mask of the wavelengths (nm) that are in DRAWN."""
    return np.isin(wavelength, DRAWN)


def palette(rng: np.random.Generator, of: Surfaces, paints: float = 0.0) -> Array:
    """Draw 6 to 60 materials for one scene, as reflectances (material, band).

    In half of the scenes, one type of material is dominant. A fraction `paints` of the materials is replaced by paints.
    """
    count = int(np.exp(rng.uniform(np.log(6), np.log(60))))
    shares = np.array(list(KIND_FREQUENCIES.values()))
    if rng.random() < 0.5:
        shares[rng.choice(len(shares), p=shares / shares.sum())] += 1.0
    kinds = rng.choice(list(KIND_FREQUENCIES), size=count, p=shares / shares.sum())
    saturation = rng.uniform(0.3, 1.2)
    drawn = np.array([_material(rng, of, kind, saturation) for kind in kinds])
    if not paints:
        return drawn
    # The paints have their own random numbers, so that the other materials are the same with any fraction of paints.
    own = rng.spawn(1)[0]
    painted = [draw_paint(own, of.wavelength) for _ in kinds]
    return np.where(own.random((count, 1)) < paints, painted, drawn)


def materials(kind: str, rng: np.random.Generator, of: Surfaces, count: int) -> Array:
    """Draw reflectances, (count, band), of one type of material, which is a key of KIND_FREQUENCIES."""
    return np.array([_material(rng, of, kind, 1.0) for _ in range(count)])


def dyed(rng: np.random.Generator, of: Surfaces, count: int) -> Array:
    """Draw reflectances, (count, band), of dyed surfaces, from grey to slightly more saturated than measured surfaces."""
    shares = np.array([KIND_FREQUENCIES[kind] for kind in DYED])
    kinds = rng.choice(DYED, size=count, p=shares / shares.sum())
    return np.array([_dye(rng, of, kind, rng.uniform(*VIVID)) for kind in kinds])


def _material(rng: np.random.Generator, of: Surfaces, kind: str, saturation: float) -> Array:
    if kind in DYED:
        return _dye(rng, of, kind, rng.random() * saturation)
    return np.clip(_DRAW[kind](rng, of), BLACKEST, WHITEST)


def _dye(rng: np.random.Generator, of: Surfaces, kind: str, saturation: float) -> Array:
    reflectance = np.clip(with_saturation(_DRAW[kind](rng, of), saturation, of.drawn), BLACKEST, WHITEST)
    return _painted(rng, reflectance, of.wavelength) if rng.random() < PAINTED else reflectance


def _painted(rng: np.random.Generator, reflectance: Array, wavelength: Array) -> Array:
    """Add the absorption edge of titanium white, which is common in paints, plastics and papers."""
    edge = np.exp(rng.normal(np.log(0.2), 0.7))
    return with_titanium_white(reflectance, wavelength, edge, rng.uniform(5.0, 11.0))


def _library(rng: np.random.Generator, of: Surfaces) -> Array:
    return of.measured[rng.integers(len(of.measured))]


def _mixture(rng: np.random.Generator, of: Surfaces) -> Array:
    """Mix two measured surfaces: next to each other (arithmetic mean) or one on top of the other (geometric mean)."""
    one, other = of.measured[rng.integers(0, len(of.measured), 2)]
    share = rng.random()
    return one * share + other * (1 - share) if rng.random() < 0.5 else one**share * other ** (1 - share)


def _gaussian(rng: np.random.Generator, of: Surfaces) -> Array:
    scores = rng.standard_normal(COMPONENTS)
    logit = of.mean + scores @ of.components
    # A separate product for the bands in DRAWN keeps their rounding independent of the grid.
    logit[of.drawn] = of.mean[of.drawn] + scores @ np.compress(of.drawn, of.components, axis=1)
    return 1.0 / (1.0 + np.exp(-logit))


def _skin(rng: np.random.Generator, of: Surfaces) -> Array:
    """Draw the reflectance of skin: a dermis with blood under an epidermis with melanin.

    Notes
    -----
    The absorption coefficient, in cm⁻¹, has three parts: the absorption of whole blood with 150 g/l haemoglobin (64 500
    g/mol), the baseline of blood-free skin [1]_, and the absorption of melanin [1]_, which is proportional to λ^−3.33. The
    reduced scattering coefficient is 46 (λ/500)^−b cm⁻¹. The absorption of blood is reduced, because hardly any light
    reaches the middle of a vessel [2]_. VESSEL and the mean contents of blood and melanin are chosen so that the mean
    reflectance agrees within 2 % with the mean of 41 measured skin samples (Vrhel and others 1994; University of Utah). The
    mean of 71 other samples differs by at most 5 %.

    References
    ----------
    .. [1] S. Jacques, "Skin optics", omlc.org, 1998.
    .. [2] van Veen and others, 2002.
    """
    wavelength = of.wavelength
    melanin = min(np.exp(rng.normal(np.log(0.09), 0.6)), 0.5)  # volume fraction in the epidermis
    blood = np.exp(rng.normal(np.log(0.11), 0.5))  # volume fraction in the dermis
    oxygen = rng.uniform(0.5, 0.95)
    haemoglobin = np.interp(wavelength, HAEMOGLOBIN_WAVELENGTH, oxygen * OXYGENATED + (1 - oxygen) * DEOXYGENATED)
    whole_blood = 2.303 * 150.0 / 64500.0 * haemoglobin
    seen = (1 - np.exp(-2 * VESSEL * whole_blood)) / (2 * VESSEL)
    absorption = blood * seen + 0.244 + 85.3 * np.exp(-(wavelength - 154.0) / 66.2)
    scattering = 46.0 * (wavelength / 500.0) ** -rng.uniform(1.1, 1.6)
    dermis = kubelka_munk(8 / 3 * absorption / (scattering * rng.uniform(0.7, 1.3)))  # K = 2 μ_a, S = 3/4 μ_s'
    epidermis = np.exp(-2 * 0.006 * melanin * 6.6e11 * wavelength**-3.33)  # 60 µm thick; the light passes through twice
    return 0.025 + 0.95 * dermis * epidermis * rng.uniform(0.8, 1.1)


def _leaf(rng: np.random.Generator, of: Surfaces) -> Array:
    """Draw the reflectance of a plant leaf, from Gaussian absorption bands of chlorophyll and carotenoids.

    A quarter of the leaves also contain anthocyanin.
    """

    def band(centre: float, width: float) -> Array:
        return np.exp(-0.5 * ((of.wavelength - centre) / width) ** 2)

    chlorophyll, carotenoid = np.exp(rng.normal(np.log((1.5, 0.8)), 0.9))
    anthocyanin = (rng.random() < 0.25) * np.exp(rng.normal())
    green = 1.3 * band(435, 22) + band(460, 20) + 0.12 * band(550, 60)
    green += 0.45 * band(620, 25) + 0.4 * band(650, 14) + band(676, 10)
    yellow = band(450, 28) + 0.8 * band(482, 18)
    ratio = chlorophyll * green + carotenoid * yellow + anthocyanin * band(540, 35) + 0.08
    return rng.uniform(0.4, 0.9) * kubelka_munk(ratio)


def _hair(rng: np.random.Generator, of: Surfaces) -> Array:
    """Draw the reflectance of hair or fur, from dark brown to blond: grey gloss plus the spectral slope of melanin."""
    slope = (of.wavelength / 680.0) ** rng.uniform(0.3, 5.0)
    return rng.uniform(0.01, 0.04) + np.exp(rng.normal(np.log(0.06), 0.8)) * slope


_DRAW = {"library": _library, "mixture": _mixture, "gaussian": _gaussian, "skin": _skin, "leaf": _leaf, "hair": _hair}


def raise_to_spectra(linear: NDArray[np.float32], wavelength: NDArray[np.float64], name: str) -> Scene:
    """Convert a linear sRGB picture to a spectral scene with the reflectances red · R + green · G + blue · B.

    The spectra red, green and blue come from `primaries`. They are not negative and add up to 1 at each wavelength, so
    values from 0 to 1 become reflectances from 0 to 1.

    Parameters
    ----------
    linear : ndarray, (row, col, 3)
        Linear sRGB; 1 is white.
    wavelength : ndarray, (band,)
        Wavelengths in nm, either in DRAWN or outside its range, where spectra are constant.
    name : str
        Name of the scene.

    Returns
    -------
    Scene
        The scene, without an illuminant.
    """
    cube = np.maximum(linear, np.float32(0.0)) @ primaries().astype(np.float32)
    if not np.array_equal(wavelength, DRAWN):  # selected after the product, so that all cameras get identical values
        cube = cube[..., abs(np.subtract.outer(wavelength, DRAWN)).argmin(axis=1)]
    return Scene(name, wavelength, cube, NO_ILLUMINANT)


def shrunk(linear: NDArray[np.float32], by: int) -> NDArray[np.float32]:
    """Average each block of `by` × `by` pixels of a linear picture.

    Parameters
    ----------
    linear : ndarray, (row, col, colour)
        The picture.
    by : int
        Side of a block in pixels. Incomplete blocks at the right and at the bottom are ignored.

    Returns
    -------
    ndarray, (row, col, colour)
        The smaller picture.
    """
    rows, cols = (length // by * by for length in linear.shape[:2])
    return linear[:rows, :cols].reshape(rows // by, by, cols // by, by, -1).mean(axis=(1, 3))


@functools.cache
def primaries() -> Array:
    """Return the smoothest reflectances (3, band) whose colours under D65 are the sRGB primaries.

    The bands are the wavelengths DRAWN. The reflectances are not negative, and their sum is 1 at each wavelength (after
    Mallett and Yuksel, "Spectral primary decomposition", 2019).
    """
    count = DRAWN.size
    rough = np.diff(np.eye(count), axis=0)
    light = make_light("D65", {}, DRAWN)
    observer = spectra.colour_matching_functions(light.wavelength)
    to_rgb = SRGB_FROM_XYZ @ matching_weights(observer, light, DRAWN)
    rows = [
        np.kron(np.eye(3), rough),
        EXACTNESS * np.kron(np.eye(3), to_rgb),
        EXACTNESS * np.kron(np.ones(3), np.eye(count)),
    ]
    colours = np.eye(3) * to_rgb.sum(axis=1)  # a perfect white is (1, 1, 1), except for the sampling error of the grid
    wanted = np.concatenate([np.zeros(3 * (count - 1)), EXACTNESS * colours.ravel(), EXACTNESS * np.ones(count)])
    solution = lsq_linear(np.concatenate(rows), wanted, bounds=(0.0, 1.0), tol=1e-12).x.reshape(3, count)
    return solution / solution.sum(axis=0)
