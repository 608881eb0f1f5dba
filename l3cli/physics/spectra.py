"""Wavelength grids, illuminants, observers and reflectances.

A spectrum is an array of values on a wavelength grid. Wavelengths are in nm. Radiance is in photons/s/sr/m²/nm unless stated
otherwise. All other modules use colour-science through this module.
"""

import functools
import re
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError, RecipeError, nearest, shortened, suggestion
from l3cli.system.text import NoSuchNumber, Quantity

PLANCK = 6.62607015e-34  # J s
LIGHT_SPEED = 299792458.0  # m/s
LUMINOUS_EFFICACY = 683.0  # lm/W
BLACK_BODY = Quantity(500, 100_000, "K")  # permitted colour temperatures of black bodies
DAYLIGHT = Quantity(4000, 25_000, "K")  # colour temperatures for which CIE daylight is defined
# Correlated colour temperatures of CIE daylight in K, corrected to the present value of the second radiation constant (CIE
# 15).
DAYLIGHT_KELVIN = {f"D{hundreds}": hundreds * 100 * 1.4388 / 1.4380 for hundreds in (50, 55, 65, 75)}
UNSEEN = 1e-9  # luminance, relative to 555 nm light of equal power, below which light is invisible
LONGEST_NM = 20_000  # maximum wavelength of a spectrum
SPRAGUE_STEP = 20.0  # maximum band spacing, in nm, at which reflectances are interpolated with Sprague polynomials
Array = NDArray[np.floating]


def colour_science() -> Any:
    """Import colour-science without warnings, and return the module.

    The import takes two seconds, so it is postponed until the module is needed.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import colour
    return colour


def photons_from_energy(wavelength: Array, energy: Array) -> Array:
    """Convert a power spectrum (…, wavelength) to photons/s, by division by the photon energy at each wavelength."""
    return energy * (wavelength * 1e-9) / (PLANCK * LIGHT_SPEED)


def bin_edges(wavelength: Array) -> Array:
    """Return the bin edges of an increasing wavelength grid, in nm.

    The edges are midway between the samples. The first and the last bin are symmetric about their samples. The bin of a
    single sample is 1 nm wide.

    Returns
    -------
    ndarray, (wavelength + 1,)
    """
    if wavelength.size == 1:
        return wavelength[0] + np.array([-0.5, 0.5])
    inner = (wavelength[1:] + wavelength[:-1]) / 2
    return np.concatenate([[2 * wavelength[0] - inner[0]], inner, [2 * wavelength[-1] - inner[-1]]])


def bin_widths(wavelength: Array) -> Array:
    """Return the bin widths Δλ of a wavelength grid in nm, for integrals Σ f·Δλ. A single sample has a width of 1 nm."""
    return np.abs(np.gradient(wavelength)) if wavelength.size > 1 else np.ones(1)


def ascending(wavelength: NDArray[np.float64], values: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[Any]]:
    """Return a wavelength grid and its values (…, wavelength), reversed if the grid is decreasing."""
    falls = wavelength.size > 1 and (np.diff(wavelength) < 0).all()
    return (wavelength[::-1], values[..., ::-1]) if falls else (wavelength, values)


def _neighbours(grid: Array, at: Array) -> tuple[NDArray[np.intp], Array]:
    """Return each wavelength's two neighbours in an increasing grid, and their weights for linear interpolation.

    Both results have the shape (2, at). Beyond the ends of the grid, the nearest sample has the weight 1.
    """
    if grid.size == 1:
        return np.zeros((2, at.size), np.intp), np.array([[1.0], [0.0]]) * np.ones(at.size)
    right = np.clip(np.searchsorted(grid, at), 1, grid.size - 1)
    share = np.clip((at - grid[right - 1]) / (grid[right] - grid[right - 1]), 0.0, 1.0)
    return np.stack([right - 1, right]), np.stack([1.0 - share, share])


def light_grid(seen: Array) -> Array:
    """Return a wavelength grid in steps of 1 nm for an illuminant.

    The grid covers the range of the CIE observer (360…830 nm), and the range of a camera's increasing wavelengths `seen`.
    """
    return np.arange(np.floor(min(360.0, seen[0])), max(830.0, seen[-1]) + 1.0)


def interpolation_matrix(source: Array, grid: Array) -> Array:
    """Return the matrix (grid, source) that interpolates linearly from the increasing wavelengths `source` to `grid`.

    Outside the range of `source`, the interpolated values are zero.
    """
    matrix = np.zeros((grid.size, source.size))
    samples, shares = _neighbours(source, grid)
    inside = (grid >= source[0]) & (grid <= source[-1])
    np.add.at(matrix, (np.arange(grid.size), samples), shares * inside)
    return matrix


def _step_matrix(source: Array, grid: Array, extended: bool) -> Array:
    """Return the matrix (grid, source) that averages a spectrum over the bins of `grid`.

    Raises a ValueError if a wavelength occurs twice in a grid.

    Notes
    -----
    The spectrum is assumed to be linear between its samples, and constant in the outer halves of its first and last bins.
    Beyond these bins, it is constant if `extended` is true, and zero otherwise. The samples of both grids divide the range
    into intervals. The integral over each interval is distributed to the two nearest samples of `grid` with the weights of
    linear interpolation, which preserves the total power and the mean wavelength. If both grids are equal, the matrix is the
    identity.
    """
    rising, aim = np.argsort(source), np.argsort(grid)
    low, high = source[rising], grid[aim]
    if min(np.diff(low, prepend=-np.inf).min(), np.diff(high, prepend=-np.inf).min()) <= 0:
        raise ValueError("a wavelength occurs twice; remove duplicate wavelengths")
    ends, known = bin_edges(high)[[0, -1]], bin_edges(low)[[0, -1]]
    first, last = ends if extended else (max(ends[0], known[0]), min(ends[1], known[1]))
    knots = np.unique(np.concatenate([[first, last], low, high]))
    knots = knots[(knots >= first) & (knots <= last)]
    pieces = np.diff(knots) / 2
    widths = np.append(pieces, 0.0) + np.append(0.0, pieces)
    (rows, taken), (columns, given) = _neighbours(high, knots), _neighbours(low, knots)
    matrix = np.zeros((grid.size, source.size))
    np.add.at(matrix, (aim[rows][:, None], rising[columns][None]), taken[:, None] * given[None] * widths)
    return matrix / bin_widths(high)[np.argsort(aim), None]


def sampling_matrix(source: Array, grid: Array) -> Array:
    """Return the matrix (grid, source) that resamples a spectral density, such as power per nm or photons per nm.

    Each resampled value is a mean over a bin of `grid`, so the integral is preserved even if a spectral line is between two
    samples of `grid`. If `grid` is finer than `source`, the matrix interpolates linearly. If both grids are equal, it is the
    identity. Beyond the bins of `source`, the density is assumed to be zero. The wavelengths in each grid may have any
    order. Raises ValueError if a wavelength occurs twice.
    """
    return _step_matrix(source, grid, extended=False)


def resample(spectrum: Array, source: Array, grid: Array) -> Array:
    """Resample a spectral density (…, source) from the wavelengths `source` to `grid` (see `sampling_matrix`)."""
    return spectrum @ sampling_matrix(source, grid).T


def average(curve: Array, source: Array, grid: Array) -> NDArray[np.float64]:
    """Average a ratio, such as a transmittance or a responsivity, over the bins of a wavelength grid.

    Parameters
    ----------
    curve : ndarray, (…, source)
        Values of the ratio.
    source, grid : ndarray
        Distinct wavelengths of the curve and of the result, in nm.

    Returns
    -------
    ndarray, (…, grid)
        Mean over each bin, or zero at wavelengths outside the range of `source`. Where a bin extends beyond this range, the
        curve is assumed to be constant.
    """
    inside = (grid >= source.min()) & (grid <= source.max())
    return np.asarray(curve @ (_step_matrix(source, grid, extended=True) * inside[:, None]).T, dtype=np.float64)


def held_interpolation(bands: Array, wavelength: Array) -> Array:
    """Return the matrix (wavelength, band) that interpolates a reflectance and averages it over wavelength bins.

    At least six bands with an even spacing of at most 20 nm are interpolated with Sprague polynomials, as in CIE 167 and
    colour-science. Other bands are interpolated linearly. Beyond the first and the last band, the reflectance is constant
    (CIE 15).
    """
    return _held_interpolation(tuple(bands), tuple(wavelength))


@functools.lru_cache(maxsize=8)
def _held_interpolation(bands: tuple[float, ...], wavelength: tuple[float, ...]) -> Array:
    source, grid = np.array(bands), np.array(wavelength)
    steps = np.diff(source)
    even = source.size >= 6 and np.ptp(steps) < 1e-6 * steps[0] and steps[0] <= SPRAGUE_STEP
    if not even or np.array_equal(source, grid):
        return _step_matrix(source, grid, extended=True)
    sprague = colour_science().SpragueInterpolator
    fine = np.union1d(source, grid)
    inside = np.clip(fine, source[0], source[-1])
    smooth = np.stack([sprague(source, unit)(inside) for unit in np.eye(source.size)], axis=1)
    return _step_matrix(fine, grid, extended=True) @ smooth


OBSERVERS = {"CIE 1931": "CIE 1931 2 Degree Standard Observer", "CIE 1964": "CIE 1964 10 Degree Standard Observer"}


INFRARED = 740.0, 780.0, 1000.0  # wavelengths, in nm, where `near_infrared` starts, reaches its maximum, and ends
LUMINOUS_WIDTH = 106.86  # integral of the CIE 1931 function ȳ, in nm
SAMPLED = np.arange(400.0, 701.0, 10.0)  # wavelengths of spectral outputs, in nm
# Names of spectral outputs, as in OpenEXR (Fichet, Pacanowski and Wilkie, "An OpenEXR Layout for Spectral Images", JCGT 10,
# 2021).
REFLECTANCES, RADIANCES = (tuple(f"{kind}.{each:g}nm" for each in SAMPLED) for kind in ("T", "S0"))


def colour_matching_functions(wavelength: Array, observer: str = "CIE 1931") -> Array:
    """Return the colour-matching functions x̄, ȳ and z̄ of an observer.

    Parameters
    ----------
    wavelength : ndarray, (wavelength,)
        Wavelengths in nm.
    observer : str
        A key of OBSERVERS.

    Returns
    -------
    ndarray, (3, wavelength)
        The functions, interpolated linearly from tables in steps of 1 nm, and zero outside the tables.

    Raises
    ------
    RecipeError
        If the observer is unknown.
    """
    if observer not in OBSERVERS:
        raise RecipeError(f'observer "{observer}" is unknown; {suggestion(observer, OBSERVERS)}')
    cmfs = colour_science().MSDS_CMFS[OBSERVERS[observer]]
    return cmfs.values.T @ interpolation_matrix(cmfs.wavelengths, wavelength).T


def near_infrared(wavelength: Array) -> Array:
    """Return the sensitivity of the near-infrared output at each wavelength, on the same scale as ȳ.

    It rises from zero at 740 nm, the end of the visible range, to its maximum at 780 nm, the beginning of CIE IR-A. Beyond
    1000 nm, it is zero. Light with equal power at all wavelengths up to 830 nm has the same value in this output as in Y.
    """
    band = np.clip((wavelength - INFRARED[0]) / (INFRARED[1] - INFRARED[0]), 0.0, 1.0) * (wavelength <= INFRARED[2])
    return np.asarray(band * (LUMINOUS_WIDTH / (830.0 - (INFRARED[0] + INFRARED[1]) / 2)))


def sampled_radiance(wavelength: Array) -> Array:
    """Return the matching functions (output, wavelength) of the spectral outputs RADIANCES.

    Each output is the mean radiance in a bin of SAMPLED, scaled so that light with equal power at all wavelengths has the
    same value in each output as in Y.
    """
    return np.asarray(LUMINOUS_WIDTH * sampling_matrix(wavelength, SAMPLED) / bin_widths(wavelength))


def is_spectrum(outputs: tuple[str, ...], channels: tuple[str, ...]) -> bool:
    """Whether the outputs of a table are spectral: reflectances, radiances, or the camera's own channels."""
    return outputs in (channels, REFLECTANCES, RADIANCES)


def matching_weights(functions: Array, wavelength: Array) -> Array:
    """Convert matching functions to weights (output, wavelength) for photon radiance: outputs = weights @ radiance.

    The radiance is in photons/s/sr/m²/nm. For the functions x̄, ȳ and z̄, the outputs are XYZ in cd/m².
    """
    energy_per_photon = PLANCK * LIGHT_SPEED / (wavelength * 1e-9)
    return LUMINOUS_EFFICACY * functions * energy_per_photon * bin_widths(wavelength)


def xyz_weights(wavelength: Array) -> Array:
    """Return weights (3, wavelength) that convert radiance in photons/s/sr/m²/nm to CIE 1931 XYZ in cd/m².

    XYZ = weights @ radiance.
    """
    return matching_weights(colour_matching_functions(wavelength), wavelength)


USUAL_LIGHTS = 'A, D50, D65, F2, F11, LED-B3, "3200K" (a black body) and "D6000K" (daylight)'


@functools.cache
def illuminant_names() -> tuple[str, ...]:
    """Return the names of all illuminants with tabulated spectra, in alphabetical order.

    They do not include the aliases "F1" to "F12" for FL1 to FL12, black bodies such as "3200K", and daylight such as
    "D6000K".
    """
    return tuple(sorted(colour_science().SDS_ILLUMINANTS))


def illuminant(name: str, wavelength: Array) -> Array:
    """Return the relative photon radiance of an illuminant.

    Parameters
    ----------
    name : str
        A CIE illuminant, a black body such as "3200K", or daylight with a colour temperature such as "D6000K".
    wavelength : ndarray, (wavelength,)
        Wavelengths in nm.

    Returns
    -------
    ndarray, (wavelength,)
        Radiance, with a mean of 1 over the wavelengths. Beyond the ends of a tabulated spectrum, the power is constant.

    Raises
    ------
    RecipeError
        If the name is unknown, or if the colour temperature is out of range.
    """
    temperature = re.fullmatch(r"(D?)(\d+(?:\.\d+)?) ?K", name, re.ASCII)
    if temperature:
        kind, what = (DAYLIGHT, "CIE daylight") if temperature[1] else (BLACK_BODY, "a black body")
        try:
            kelvin = kind.read(temperature[2])
        except NoSuchNumber as error:
            raise RecipeError(f'illuminant "{shortened(name)}" cannot be computed as {what}: {error}') from None
    if temperature and temperature[1]:
        photons = photons_from_energy(wavelength, _daylight(kelvin, wavelength))
    elif temperature:
        metres = wavelength * 1e-9
        exponent = PLANCK * LIGHT_SPEED / (metres * 1.380649e-23 * kelvin)
        photons = 1.0 / (metres**4 * np.expm1(exponent))
    elif name == "A":
        photons = photons_from_energy(wavelength, _illuminant_a(wavelength))
    else:
        photons = photons_from_energy(wavelength, _tabulated(name, wavelength))
    return photons / photons.mean()


def known_range(name: str) -> tuple[float, float]:
    """Return the wavelength range, in nm, in which the spectrum of an illuminant is known.

    The range of an illuminant that is defined by a formula is 0 to infinity. Raises RecipeError if the name is unknown.
    """
    if name in ("A", "E") or re.fullmatch(r"\d+(?:\.\d+)? ?K", name, re.ASCII):
        return 0.0, np.inf
    daylight = re.fullmatch(r"D(\d+(?:\.\d+)?) ?K", name, re.ASCII)
    wavelengths, _ = _daylight_table(float(daylight[1])) if daylight else _illuminant_table(name)
    return float(wavelengths[0]), float(wavelengths[-1])


@functools.lru_cache(1000)
def require_illuminant(name: str) -> None:
    """Raise RecipeError if the name of an illuminant is invalid."""
    illuminant(name, SAMPLED)


def _illuminant_a(wavelength: Array) -> Array:
    """Compute the power spectrum of CIE illuminant A at each wavelength from its definition (ISO/CIE 11664-2)."""
    return 100.0 * (560.0 / wavelength) ** 5 * np.expm1(1.435e7 / (2848 * 560)) / np.expm1(1.435e7 / (2848 * wavelength))


def _tabulated(name: str, wavelength: Array) -> Array:
    """Average a tabulated power spectrum over the bin of each wavelength. Beyond its table, the spectrum is constant."""
    source, values = _illuminant_table(name)
    return np.asarray(values @ _step_matrix(source, wavelength, extended=True).T)


def _illuminant_table(name: str) -> tuple[Array, Array]:
    """Return the wavelengths and the power spectrum of a CIE illuminant. Raises RecipeError if the name is unknown.

    All tables in colour-science end at 780 nm, but CIE tabulates daylight up to 830 nm. Daylight tables are therefore
    extended with the CIE formula.
    """
    key = f"FL{name[1:]}" if re.fullmatch(r"F\d+", name) else name
    if key not in illuminant_names():
        close = nearest(name, illuminant_names()) or f"common illuminants are {USUAL_LIGHTS};"
        every = f'the documentation lists all {len(illuminant_names())} ("Illuminants")'
        raise RecipeError(f'illuminant "{shortened(name)}" is unknown; {close} {every}')
    table = colour_science().SDS_ILLUMINANTS[key]
    wavelengths, values = np.asarray(table.wavelengths), np.asarray(table.values)
    if key in DAYLIGHT_KELVIN:
        grid, energy = _daylight_table(DAYLIGHT_KELVIN[key])
        infrared = grid > wavelengths[-1]
        joined = values[-1] / np.interp(wavelengths[-1], grid, energy)
        wavelengths, values = np.append(wavelengths, grid[infrared]), np.append(values, energy[infrared] * joined)
    return wavelengths, values


def _daylight(temperature: float, wavelength: Array) -> Array:
    """Return the power spectrum of CIE daylight (CIE 15) at each wavelength, for a temperature in the range DAYLIGHT."""
    source, values = _daylight_table(temperature)
    return np.asarray(values @ _step_matrix(source, wavelength, extended=True).T)


def _daylight_table(temperature: float) -> tuple[Array, Array]:
    """Return the wavelengths and the power spectrum of CIE daylight with a correlated colour temperature in K."""
    colour = colour_science()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        table = colour.sd_CIE_illuminant_D_series(colour.temperature.CCT_to_xy_CIE_D(temperature))
    return np.asarray(table.wavelengths), np.asarray(table.values)


def at_luminance(radiance: Array, wavelength: Array, luminance: float) -> Array:
    """Scale a relative photon radiance (wavelength,) to a luminance in cd/m². Raises InputFileError for invisible light."""
    seen = xyz_weights(wavelength)[1] @ radiance
    if not seen > UNSEEN * (matching_weights(np.ones_like(wavelength), wavelength) @ radiance):
        ends = f"{wavelength.min():g}…{wavelength.max():g} nm"
        raise InputFileError(
            f"the light at {ends} has no luminance, so l3 cannot compute an exposure; use a spectrum from 380 to 780 nm"
        )
    return radiance * (luminance / seen)


def white_point(name: str) -> NDArray[np.float64]:
    """Return the white point of a named illuminant, as tristimulus values (3,) with Y = 1.

    Raises RecipeError if the name is invalid.
    """
    wavelength = np.arange(380.0, 781.0, 5.0)
    xyz = xyz_weights(wavelength) @ illuminant(name, wavelength)
    return xyz / xyz[1]


COLORCHECKER_WAVELENGTH = np.arange(380.0, 781.0, 5.0)  # wavelengths at which the ColorChecker was measured, in nm


def colorchecker(wavelength: Array) -> tuple[tuple[str, ...], Array]:
    """Return the names and reflectances (24, wavelength) of the ColorChecker patches in ISO 17321-1, row by row.

    The reflectances are interpolated linearly and constant outside 380…780 nm.
    """
    chart = colour_science().SDS_COLOURCHECKERS["ISO 17321-1"]
    reflectance = [np.interp(wavelength, patch.wavelengths, patch.values) for patch in chart.values()]
    return tuple(chart), np.array(reflectance)


@functools.cache
def _reflectance_tables() -> tuple[tuple[Array, Array], ...]:
    """Return the sets of measured reflectances in colour-science, except the ColorChecker.

    Each set consists of its wavelengths and its reflectances (sample, wavelength).
    """
    colour = colour_science()
    from colour.quality.cfi2017 import load_TCS_CIE2017
    from colour.quality.datasets.tcs import SDS_TCS
    from colour.quality.datasets.vs import SDS_VS

    training = colour.characterisation.read_training_data_rawtoaces_v1()
    evaluation = load_TCS_CIE2017(colour.SpectralShape(380, 780, 5))
    tables = [(training.wavelengths, training.values.T), (evaluation.wavelengths, evaluation.values.T)]
    for sets in (SDS_TCS["CIE 2024"], SDS_VS["NIST CQS 9.0"]):
        tables += [(sample.wavelengths, sample.values[None]) for sample in sets.values()]
    return tuple(tables)


SURFACES_MEASURED = 380.0, 780.0  # range of the measured reflectances in nm, outside which they are assumed to be constant


def reflectance_library(wavelength: Array) -> Array:
    """Return measured surface reflectances (sample, wavelength), clipped to 0.003…0.999.

    They are interpolated linearly, as `held_interpolation` expects. Averages over wavelength bins would flatten the curves
    (docs/method.md#procedural-scenes).
    """
    library = np.concatenate(
        [[np.interp(wavelength, grid, sample) for sample in samples] for grid, samples in _reflectance_tables()]
    )
    return np.clip(library[np.isfinite(library).all(axis=1)], 0.003, 0.999)


WHITEST, BLACKEST = 1.0, 0.002  # highest and lowest reflectance of a surface


def with_saturation(reflectance: Array, saturation: float, drawn: NDArray[np.bool_] | slice = slice(None)) -> Array:
    """Change the saturation of reflectances.

    Parameters
    ----------
    reflectance : ndarray, (…, band)
        Reflectances.
    saturation : float
        Exponent of the ratio between each reflectance and the geometric mean of the bands. With 0, reflectances become grey.
        With 1, they are unchanged.
    drawn : ndarray of bool, (band,), or slice
        Bands for the geometric mean. [default: all bands]

    Returns
    -------
    ndarray, (…, band)
    """
    grey = np.exp(np.log(reflectance[..., drawn]).mean(axis=-1, keepdims=True))
    return np.asarray(grey * (reflectance / grey) ** saturation)


def with_titanium_white(reflectance: Array, wavelength: Array, edge: float, width: float) -> Array:
    """Add the absorption edge of titanium white (rutile, 3.0 eV, 413 nm) to reflectances.

    Below this edge, the reflectance of materials with titanium white drops within about 20 nm. In this range, cameras and
    the eye differ in sensitivity. Without such materials in the training scenes, a table would render white paint as yellow.

    Parameters
    ----------
    reflectance : ndarray, (…, band)
        Reflectances between BLACKEST and WHITEST.
    wavelength : ndarray, (band,)
        Wavelengths in nm.
    edge : float
        Increase in K/S (Kubelka–Munk) at 405 nm, typically 0.2.
    width : float
        Decay length of the exponential tail (Urbach's rule) in nm, typically 5 to 11.

    Returns
    -------
    ndarray, (…, band)
    """
    pigment = (1.0 - reflectance) ** 2 / (2.0 * reflectance)
    return np.clip(kubelka_munk(pigment + edge * np.exp(-(wavelength - 405.0) / width)), BLACKEST, WHITEST)


def kubelka_munk(absorption_per_scattering: Array) -> Array:
    """Return the reflectance of an opaque layer of paint from its ratio K/S of absorption to scattering (Kubelka–Munk)."""
    ratio = absorption_per_scattering
    return 1.0 + ratio - np.sqrt(ratio**2 + 2.0 * ratio)
