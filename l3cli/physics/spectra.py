"""Wavelengths, illuminants, observers and reflectances. Only this module uses colour-science.

Spectra are arrays on a wavelength grid in nm. Radiance is in photons/s/sr/m²/nm unless a name says otherwise.
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
BLACK_BODY = Quantity(500, 100_000, "K")  # cooler black bodies emit no visible light
DAYLIGHT = Quantity(4000, 25_000, "K")  # range in which CIE daylight is defined
# Correlated colour temperatures of CIE daylight in K, for the present value of the second radiation constant (CIE 15).
DAYLIGHT_KELVIN = {f"D{hundreds}": hundreds * 100 * 1.4388 / 1.4380 for hundreds in (50, 55, 65, 75)}
UNSEEN = 1e-9  # light counts as invisible below this luminance, relative to light of equal power
LONGEST_NM = 20_000  # wavelength, of any spectrum
SPRAGUE_STEP = 20.0  # nm; largest band spacing at which reflectances are interpolated as smooth curves
Array = NDArray[np.floating]


def colour_science() -> Any:
    """Import colour-science on first use, because this takes two seconds, and suppress its warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import colour
    return colour


def photons_from_energy(wavelength: Array, energy: Array) -> Array:
    """Convert a spectrum (…, wavelength) from energy (W…) to photons (photons/s…)."""
    return energy * (wavelength * 1e-9) / (PLANCK * LIGHT_SPEED)


def bin_edges(wavelength: Array) -> Array:
    """Return the edges (wavelength + 1), in nm, of the bins around the samples of an increasing grid.

    Edges lie midway between samples. Each outermost bin is symmetric about its sample. A single sample has a bin of 1 nm.
    """
    if wavelength.size == 1:
        return wavelength[0] + np.array([-0.5, 0.5])
    inner = (wavelength[1:] + wavelength[:-1]) / 2
    return np.concatenate([[2 * wavelength[0] - inner[0]], inner, [2 * wavelength[-1] - inner[-1]]])


def bin_widths(wavelength: Array) -> Array:
    """Return the width (wavelength), in nm, of the bin around each sample, so that Σ f·Δλ is the integral of f."""
    return np.abs(np.gradient(wavelength)) if wavelength.size > 1 else np.ones(1)


def ascending(wavelength: NDArray[np.float64], values: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[Any]]:
    """Reverse a decreasing wavelength grid and its values (…, wavelength). Other grids are returned unchanged."""
    falls = wavelength.size > 1 and (np.diff(wavelength) < 0).all()
    return (wavelength[::-1], values[..., ::-1]) if falls else (wavelength, values)


def _neighbours(grid: Array, at: Array) -> tuple[NDArray[np.intp], Array]:
    """Return the two samples of an increasing grid around each wavelength, and their linear weights, both (2, at).

    Values are held constant beyond the ends.
    """
    if grid.size == 1:
        return np.zeros((2, at.size), np.intp), np.array([[1.0], [0.0]]) * np.ones(at.size)
    right = np.clip(np.searchsorted(grid, at), 1, grid.size - 1)
    share = np.clip((at - grid[right - 1]) / (grid[right] - grid[right - 1]), 0.0, 1.0)
    return np.stack([right - 1, right]), np.stack([1.0 - share, share])


def light_grid(seen: Array) -> Array:
    """Return a grid with steps of 1 nm that covers the observer and a camera with the wavelengths `seen`."""
    return np.arange(np.floor(min(360.0, seen[0])), max(830.0, seen[-1]) + 1.0)


def interpolation_matrix(source: Array, grid: Array) -> Array:
    """Return the matrix (grid, source) for linear interpolation. It is zero outside the range of `source`."""
    matrix = np.zeros((grid.size, source.size))
    samples, shares = _neighbours(source, grid)
    inside = (grid >= source[0]) & (grid <= source[-1])
    np.add.at(matrix, (np.arange(grid.size), samples), shares * inside)
    return matrix


def _step_matrix(source: Array, grid: Array, extended: bool) -> Array:
    """Return the matrix (grid, source) that averages a spectrum over the bins of `grid`.

    Raises ValueError if a wavelength occurs twice.

    Notes
    -----
    The source is linear between its samples and constant in the outer half of its outermost bins. Farther outside it is
    zero, or constant if `extended` is true. The samples of both grids divide the range into pieces. The integral over each
    piece is split between the two nearest samples of `grid`, with the weights of linear interpolation. This preserves the
    power and its mean wavelength. For equal grids the matrix is the identity.
    """
    rising, aim = np.argsort(source), np.argsort(grid)
    low, high = source[rising], grid[aim]
    if min(np.diff(low, prepend=-np.inf).min(), np.diff(high, prepend=-np.inf).min()) <= 0:
        raise ValueError("a wavelength occurs twice")
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
    """Return the matrix (grid, source) that resamples a spectral density, such as power or photons per nm.

    The results are means over the bins of `grid`, so that the sum of value × bin width is preserved even if spectral lines
    lie between the samples. On a finer grid, this is linear interpolation. On the same grid, it is the identity. The result
    is zero beyond the bins of `source`. Both grids may be in any order.
    """
    return _step_matrix(source, grid, extended=False)


def resample(spectrum: Array, source: Array, grid: Array) -> Array:
    """Resample a density (…, source) with `sampling_matrix`."""
    return spectrum @ sampling_matrix(source, grid).T


def average(curve: Array, source: Array, grid: Array) -> NDArray[np.float64]:
    """Average a ratio (…, source), such as a transmittance or responsivity, over the bins of another grid.

    In the bins at the ends of its range, the average is taken over the part where the ratio is known. It is zero at
    wavelengths outside the range.
    """
    inside = (grid >= source.min()) & (grid <= source.max())
    return np.asarray(curve @ (_step_matrix(source, grid, extended=True) * inside[:, None]).T, dtype=np.float64)


def held_interpolation(bands: Array, wavelength: Array) -> Array:
    """Return the matrix (wavelength, band) that interpolates a reflectance and averages it over bins.

    Beyond its ends, the reflectance is constant (CIE 15). Evenly spaced bands up to 20 nm apart are interpolated with
    Sprague polynomials, as in CIE 167 and colour-science. All others are interpolated linearly.
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


INFRARED = 740.0, 780.0, 1000.0  # nm; start of near_infrared, start of its full sensitivity, and its end
LUMINOUS_WIDTH = 106.86  # nm; integral of ȳ of CIE 1931
SAMPLED = np.arange(400.0, 701.0, 10.0)  # nm; bands of spectral outputs
# Names as in OpenEXR files (Fichet, Pacanowski and Wilkie, "An OpenEXR Layout for Spectral Images", JCGT 10, 2021)
REFLECTANCES, RADIANCES = (tuple(f"{kind}.{each:g}nm" for each in SAMPLED) for kind in ("T", "S0"))


def colour_matching_functions(wavelength: Array, observer: str = "CIE 1931") -> Array:
    """Return x̄ ȳ z̄ (3, wavelength) of an observer, which is a key of OBSERVERS.

    They are interpolated linearly in a table with steps of 1 nm.
    """
    if observer not in OBSERVERS:
        raise RecipeError(f'observer "{observer}" is unknown; {suggestion(observer, OBSERVERS)}')
    cmfs = colour_science().MSDS_CMFS[OBSERVERS[observer]]
    return cmfs.values.T @ interpolation_matrix(cmfs.wavelengths, wavelength).T


def near_infrared(wavelength: Array) -> Array:
    """Return a sensitivity (wavelength) for the near infrared.

    It rises from 740 nm, where the eye's range ends, to 780 nm, where CIE IR-A begins, and is zero beyond 1000 nm. Its scale
    is such that light with equal power at all wavelengths up to 830 nm gives the same value as Y.
    """
    band = np.clip((wavelength - INFRARED[0]) / (INFRARED[1] - INFRARED[0]), 0.0, 1.0) * (wavelength <= INFRARED[2])
    return np.asarray(band * (LUMINOUS_WIDTH / (830.0 - (INFRARED[0] + INFRARED[1]) / 2)))


def sampled_radiance(wavelength: Array) -> Array:
    """Return the functions (output, wavelength) of the outputs RADIANCES: the mean over each bin of SAMPLED.

    Their scale is such that light with equal power at all wavelengths gives the same value as Y in each output.
    """
    return np.asarray(LUMINOUS_WIDTH * sampling_matrix(wavelength, SAMPLED) / bin_widths(wavelength))


def is_spectrum(outputs: tuple[str, ...], channels: tuple[str, ...]) -> bool:
    """Whether the outputs are a spectrum: reflectances, radiances, or the bands of a camera with the given channels."""
    return outputs in (channels, REFLECTANCES, RADIANCES)


def matching_weights(functions: Array, wavelength: Array) -> Array:
    """Return weights (output, wavelength) for photon radiance from matching functions (output, wavelength).

    Outputs are weights @ radiance, with radiance in photons/s/sr/m²/nm. For x̄ ȳ z̄ they are in cd/m².
    """
    energy_per_photon = PLANCK * LIGHT_SPEED / (wavelength * 1e-9)
    return LUMINOUS_EFFICACY * functions * energy_per_photon * bin_widths(wavelength)


def xyz_weights(wavelength: Array) -> Array:
    """Return the weights (3, wavelength) for CIE 1931 XYZ: XYZ (cd/m²) = weights @ radiance (photons/s/sr/m²/nm)."""
    return matching_weights(colour_matching_functions(wavelength), wavelength)


USUAL_LIGHTS = 'A, D50, D65, F2, F11, LED-B3, "3200K" (a black body) and "D6000K" (daylight)'


@functools.cache
def illuminant_names() -> tuple[str, ...]:
    """Return the names of the tabulated illuminants.

    "F1" to "F12" are aliases of FL1 to FL12. Black bodies ("3200K") and daylight ("D6000K") are computed and not listed.
    """
    return tuple(sorted(colour_science().SDS_ILLUMINANTS))


def illuminant(name: str, wavelength: Array) -> Array:
    """Return the relative photon radiance (wavelength) of a standard illuminant, with mean 1.

    Parameters
    ----------
    name : str
        A CIE illuminant, a black body such as "3200K", or daylight of a given colour temperature such as "D6000K".
    wavelength : ndarray, (wavelength)
        Wavelengths in nm.

    Raises
    ------
    RecipeError
        If the name is unknown.
    """
    temperature = re.fullmatch(r"(D?)(\d+(?:\.\d+)?) ?K", name, re.ASCII)
    if temperature:
        kind, what = (DAYLIGHT, "CIE daylight") if temperature[1] else (BLACK_BODY, "a black body")
        try:
            kelvin = kind.read(temperature[2])
        except NoSuchNumber as error:
            raise RecipeError(f'illuminant "{shortened(name)}" is not a light of {what}: {error}') from None
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
    """Return the range, in nm, in which the spectrum of a standard illuminant is known.

    Illuminants that are defined by a formula are known everywhere. Beyond the ends of the other tables, `illuminant` returns
    the last value.
    """
    if name in ("A", "E") or re.fullmatch(r"\d+(?:\.\d+)? ?K", name, re.ASCII):
        return 0.0, np.inf
    daylight = re.fullmatch(r"D(\d+(?:\.\d+)?) ?K", name, re.ASCII)
    wavelengths, _ = _daylight_table(float(daylight[1])) if daylight else _illuminant_table(name)
    return float(wavelengths[0]), float(wavelengths[-1])


@functools.lru_cache(1000)
def require_illuminant(name: str) -> None:
    """Raise RecipeError if no illuminant has this name."""
    illuminant(name, SAMPLED)


def _illuminant_a(wavelength: Array) -> Array:
    """Return the energy spectrum (wavelength) of CIE illuminant A, from its defining formula (ISO/CIE 11664-2)."""
    return 100.0 * (560.0 / wavelength) ** 5 * np.expm1(1.435e7 / (2848 * 560)) / np.expm1(1.435e7 / (2848 * wavelength))


def _tabulated(name: str, wavelength: Array) -> Array:
    """Return the energy spectrum (wavelength) of a tabulated CIE illuminant.

    It is interpolated linearly. Beyond the ends of the table, it keeps the last value.
    """
    source, values = _illuminant_table(name)
    return np.asarray(values @ _step_matrix(source, wavelength, extended=True).T)


def _illuminant_table(name: str) -> tuple[Array, Array]:
    """Return the wavelengths and energy spectrum of a CIE illuminant. Raises RecipeError if it has no table.

    The tables in colour-science end at 780 nm, but the CIE tables for daylight at 830 nm. Daylight is therefore extended
    with the components of CIE daylight.
    """
    key = f"FL{name[1:]}" if re.fullmatch(r"F\d+", name) else name
    if key not in illuminant_names():
        close = nearest(name, illuminant_names()) or f"usual ones are {USUAL_LIGHTS};"
        every = f'documentation, "Lights", lists all {len(illuminant_names())}'
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
    """Return the energy spectrum (wavelength) of CIE daylight for a colour temperature in the range DAYLIGHT (CIE 15)."""
    source, values = _daylight_table(temperature)
    return np.asarray(values @ _step_matrix(source, wavelength, extended=True).T)


def _daylight_table(temperature: float) -> tuple[Array, Array]:
    """Return the wavelengths and energy spectrum of CIE daylight for a correlated colour temperature in K."""
    colour = colour_science()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        table = colour.sd_CIE_illuminant_D_series(colour.temperature.CCT_to_xy_CIE_D(temperature))
    return np.asarray(table.wavelengths), np.asarray(table.values)


def at_luminance(radiance: Array, wavelength: Array, luminance: float) -> Array:
    """Scale `radiance` (wavelength) to a luminance in cd/m². Raises InputFileError if the light is invisible."""
    seen = xyz_weights(wavelength)[1] @ radiance
    if not seen > UNSEEN * (matching_weights(np.ones_like(wavelength), wavelength) @ radiance):
        ends = f"{wavelength.min():g}…{wavelength.max():g} nm"
        raise InputFileError(f"light of {ends} has no luminance, which exposures require; include some of 380…780 nm")
    return radiance * (luminance / seen)


def white_point(name: str) -> NDArray[np.float64]:
    """Return XYZ (3), with Y = 1, of a perfect reflector under a standard illuminant."""
    wavelength = np.arange(380.0, 781.0, 5.0)
    xyz = xyz_weights(wavelength) @ illuminant(name, wavelength)
    return xyz / xyz[1]


COLORCHECKER_WAVELENGTH = np.arange(380.0, 781.0, 5.0)  # nm; wavelengths at which the chart was measured


def colorchecker(wavelength: Array) -> tuple[tuple[str, ...], Array]:
    """Return the names and reflectances (24, wavelength) of the classic ColorChecker, row by row from dark skin to black."""
    chart = colour_science().SDS_COLOURCHECKERS["ISO 17321-1"]
    reflectance = [np.interp(wavelength, patch.wavelengths, patch.values) for patch in chart.values()]
    return tuple(chart), np.array(reflectance)


@functools.cache
def _reflectance_tables() -> tuple[tuple[Array, Array], ...]:
    """Return the sets of measured reflectances in colour-science, without the ColorChecker.

    Each set is a pair of wavelengths and reflectances (sample, wavelength).
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


SURFACES_MEASURED = 380.0, 780.0  # nm; range that all measurements cover; beyond it, reflectances keep their last values


def reflectance_library(wavelength: Array) -> Array:
    """Return measured reflectances (sample, wavelength) of surfaces, clipped to 0.003–0.999.

    They are values at the given wavelengths, as `held_interpolation` expects. Means over bins would flatten the curves
    (docs/method.md#procedural-scenes).
    """
    library = np.concatenate(
        [[np.interp(wavelength, grid, sample) for sample in samples] for grid, samples in _reflectance_tables()]
    )
    return np.clip(library[np.isfinite(library).all(axis=1)], 0.003, 0.999)


WHITEST, BLACKEST = 1.0, 0.002  # highest and lowest reflectance


def with_saturation(reflectance: Array, saturation: float, drawn: NDArray[np.bool_] | slice = slice(None)) -> Array:
    """Change the saturation of reflectances.

    Parameters
    ----------
    reflectance : ndarray, (…, band)
        Reflectances.
    saturation : float
        0 gives grey with the geometric mean over the bands. 1 changes nothing.
    drawn : ndarray of bool, (band), or slice
        Bands over which the mean is computed.
    """
    grey = np.exp(np.log(reflectance[..., drawn]).mean(axis=-1, keepdims=True))
    return np.asarray(grey * (reflectance / grey) ** saturation)


def with_titanium_white(reflectance: Array, wavelength: Array, edge: float, width: float) -> Array:
    """Apply the absorption edge of titanium white (rutile, 3.0 eV, 413 nm) to reflectances.

    Materials with titanium white become dark within about 20 nm of the edge. Cameras and the eye weight this range
    differently. If the edge is missing in training, a table renders white paint yellow.

    Parameters
    ----------
    reflectance : ndarray, (…, band)
        Reflectances between BLACKEST and WHITEST.
    wavelength : ndarray, (band)
        Wavelengths in nm.
    edge : float
        Addition to K/S (Kubelka–Munk) at 405 nm, about 0.2.
    width : float
        Decay length of the exponential tail in nm, 5 to 11 (Urbach's rule).
    """
    pigment = (1.0 - reflectance) ** 2 / (2.0 * reflectance)
    return np.clip(kubelka_munk(pigment + edge * np.exp(-(wavelength - 405.0) / width)), BLACKEST, WHITEST)


def kubelka_munk(absorption_per_scattering: Array) -> Array:
    """Return the reflectance of an opaque layer, given its ratio K/S of absorption to scattering (Kubelka–Munk)."""
    ratio = absorption_per_scattering
    return 1.0 + ratio - np.sqrt(ratio**2 + 2.0 * ratio)
