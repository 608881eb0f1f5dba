"""Wavelengths, illuminants, observers and reflectances: the one door to colour-science.

Spectra are arrays over a wavelength grid in nm. Radiance is in photons/s/sr/m²/nm unless a name says otherwise.
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
BLACK_BODY = Quantity(500, 100_000, "K")  # below, nothing is seen by it
DAYLIGHT = Quantity(4000, 25_000, "K")  # as far as CIE daylight goes
# Correlated colour temperatures of the CIE's daylights in K, by the second radiation constant of today (CIE 15)
DAYLIGHT_KELVIN = {f"D{hundreds}": hundreds * 100 * 1.4388 / 1.4380 for hundreds in (50, 55, 65, 75)}
UNSEEN = 1e-9  # luminous efficiency below which light is taken for invisible: less than rounding leaves beyond 830 nm
SPRAGUE_STEP = 20.0  # nm between bands up to which a reflectance is taken as smooth
Array = NDArray[np.floating]


def colour_science() -> Any:
    """Return colour-science, imported when first needed (it takes two seconds) and without its import-time warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import colour
    return colour


def photons_from_energy(wavelength: Array, energy: Array) -> Array:
    """Return photon count per joule-based spectrum: energy (…, wavelength) W… → photons/s…"""
    return energy * (wavelength * 1e-9) / (PLANCK * LIGHT_SPEED)


def bin_edges(wavelength: Array) -> Array:
    """Return edges (wavelength + 1) in nm of the steps that the samples of an increasing grid stand for: midway between
    them; the outermost as far beyond the ends as the next lie inside. One sample alone stands for 1 nm."""
    if wavelength.size == 1:
        return wavelength[0] + np.array([-0.5, 0.5])
    inner = (wavelength[1:] + wavelength[:-1]) / 2
    return np.concatenate([[2 * wavelength[0] - inner[0]], inner, [2 * wavelength[-1] - inner[-1]]])


def bin_widths(wavelength: Array) -> Array:
    """Return the width (wavelength) in nm of the step that each sample stands for: Σ f·Δλ is the integral of f."""
    return np.abs(np.gradient(wavelength)) if wavelength.size > 1 else np.ones(1)


def ascending(wavelength: NDArray[np.float64], values: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[Any]]:
    """Return a grid that falls, with its values (…, wavelength), turned round; any other as it is."""
    falls = wavelength.size > 1 and (np.diff(wavelength) < 0).all()
    return (wavelength[::-1], values[..., ::-1]) if falls else (wavelength, values)


def _neighbours(grid: Array, at: Array) -> tuple[NDArray[np.intp], Array]:
    """Return the two samples of an increasing grid about each wavelength, and their weights in a linear interpolation that
    is held beyond the ends, both (2, at)."""
    if grid.size == 1:
        return np.zeros((2, at.size), np.intp), np.array([[1.0], [0.0]]) * np.ones(at.size)
    right = np.clip(np.searchsorted(grid, at), 1, grid.size - 1)
    share = np.clip((at - grid[right - 1]) / (grid[right] - grid[right - 1]), 0.0, 1.0)
    return np.stack([right - 1, right]), np.stack([1.0 - share, share])


def light_grid(seen: Array) -> Array:
    """Return every nm of what the observer sees, and a camera with wavelengths `seen`."""
    return np.arange(np.floor(min(360.0, seen[0])), max(830.0, seen[-1]) + 1.0)


def interpolation_matrix(source: Array, grid: Array) -> Array:
    """Return M (grid, source): a smooth function at points, linear between its samples and zero outside their range."""
    matrix = np.zeros((grid.size, source.size))
    samples, shares = _neighbours(source, grid)
    inside = (grid >= source[0]) & (grid <= source[-1])
    np.add.at(matrix, (np.arange(grid.size), samples), shares * inside)
    return matrix


def _step_matrix(source: Array, grid: Array, extended: bool) -> Array:
    """Return M (grid, source): the mean over each step of `grid`, for `sampling_matrix` and, `held`, `average`.

    The source is linear between its samples and constant in the outer half of its outermost steps; beyond, it is zero or
    held. Its integral over every piece between samples of either grid is shared between the two samples of `grid`
    about them by their distances, as a function that is linear between those samples weighs it: so power and the
    power's mean wavelength are kept, and equal grids give the unit matrix. ValueError if a wavelength occurs twice.
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
    """Return M (grid, source): a density (power or photons per nm) as means over the steps of another `grid`, so that the
    sum of value × bin width stays what it was, wherever spectral lines lie between the samples. Zero beyond its steps.

    Grids are in any order. On a finer grid this is linear interpolation, on the same grid it changes nothing.
    """
    return _step_matrix(source, grid, extended=False)


def resample(spectrum: Array, source: Array, grid: Array) -> Array:
    """Return a density (…, source) by `sampling_matrix`."""
    return spectrum @ sampling_matrix(source, grid).T


def average(curve: Array, source: Array, grid: Array) -> NDArray[np.float64]:
    """Return a ratio (…, source) such as a transmittance or a responsivity, averaged over the steps of another grid like a
    density in `sampling_matrix`; at its ends over what is known of it, and zero at wavelengths outside its range."""
    inside = (grid >= source.min()) & (grid <= source.max())
    return np.asarray(curve @ (_step_matrix(source, grid, extended=True) * inside[:, None]).T, dtype=np.float64)


def held_interpolation(bands: Array, wavelength: Array) -> Array:
    """Return M (wavelength, band): a reflectance's mean over each step of a grid; constant beyond the ends (CIE 15).

    Evenly spaced bands of 20 nm at most are interpolated by Sprague's polynomials as CIE 167 recommends and colour-science
    does, all others linearly.
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


INFRARED = 740.0, 780.0, 1000.0  # nm, of near_infrared: where it begins, is whole, and ends
LUMINOUS_WIDTH = 106.86  # nm, integral of ȳ of CIE 1931
SAMPLED = np.arange(400.0, 701.0, 10.0)  # nm, of spectra as outputs
# Called as OpenEXR files call them (Fichet, Pacanowski and Wilkie, "An OpenEXR Layout for Spectral Images", JCGT 10, 2021)
REFLECTANCES, RADIANCES = (tuple(f"{kind}.{each:g}nm" for each in SAMPLED) for kind in ("T", "S0"))


def colour_matching_functions(wavelength: Array, observer: str = "CIE 1931") -> Array:
    """Return x̄ ȳ z̄, (3, wavelength), of a key of OBSERVERS, linearly interpolated from the tabulated 1 nm observer."""
    if observer not in OBSERVERS:
        raise RecipeError(f'observer "{observer}" is unknown; {suggestion(observer, OBSERVERS)}')
    cmfs = colour_science().MSDS_CMFS[OBSERVERS[observer]]
    return cmfs.values.T @ interpolation_matrix(cmfs.wavelengths, wavelength).T


def near_infrared(wavelength: Array) -> Array:
    """Return (wavelength) of a band of near infrared, scaled as ȳ is, so that a light of equal power up to 830 nm gives as
    much of it as of Y: from 740 nm, where eyes end, rising to 780 nm, where CIE's IR-A begins; zero beyond 1000 nm."""
    band = np.clip((wavelength - INFRARED[0]) / (INFRARED[1] - INFRARED[0]), 0.0, 1.0) * (wavelength <= INFRARED[2])
    return np.asarray(band * (LUMINOUS_WIDTH / (830.0 - (INFRARED[0] + INFRARED[1]) / 2)))


def sampled_radiance(wavelength: Array) -> Array:
    """Return functions (output, wavelength) of RADIANCES: the mean of each step of SAMPLED, scaled as ȳ is, so that a light
    of equal power gives as much of each as of Y."""
    return np.asarray(LUMINOUS_WIDTH * sampling_matrix(wavelength, SAMPLED) / bin_widths(wavelength))


def is_spectrum(outputs: tuple[str, ...], channels: tuple[str, ...]) -> bool:
    """Return whether the outputs are a spectrum: reflectances, radiances, or the bands of a camera of these channels."""
    return outputs in (channels, REFLECTANCES, RADIANCES)


def matching_weights(functions: Array, wavelength: Array) -> Array:
    """Return W (output, wavelength) of matching functions (output, wavelength) per watt: output = W @ radiance
    (photons/s/sr/m²/nm), in cd/m² for x̄ ȳ z̄."""
    energy_per_photon = PLANCK * LIGHT_SPEED / (wavelength * 1e-9)
    return LUMINOUS_EFFICACY * functions * energy_per_photon * bin_widths(wavelength)


def xyz_weights(wavelength: Array) -> Array:
    """Return W (3, wavelength): CIE 1931 XYZ with Y in cd/m² = W @ radiance (photons/s/sr/m²/nm)."""
    return matching_weights(colour_matching_functions(wavelength), wavelength)


USUAL_LIGHTS = 'A, D50, D65, F2, F11, LED-B3, "3200K" (a black body) and "D6000K" (daylight)'


@functools.cache
def illuminant_names() -> tuple[str, ...]:
    """Return the tabulated illuminants; beside them "F1"…"F12" are FL1…FL12, "3200K" is a black body, "D6000K" daylight."""
    return tuple(sorted(colour_science().SDS_ILLUMINANTS))


def illuminant(name: str, wavelength: Array) -> Array:
    """Return relative photon radiance (wavelength), mean 1, of a named CIE illuminant, a black body such as "3200K" or
    daylight of a correlated colour temperature such as "D6000K"; RecipeError if the name is unknown."""
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
    """Return the wavelengths in nm between which a named light is known: all of a light that a formula defines.

    Beyond them `illuminant` holds the ends of the light's table.
    """
    if name in ("A", "E") or re.fullmatch(r"\d+(?:\.\d+)? ?K", name, re.ASCII):
        return 0.0, np.inf
    daylight = re.fullmatch(r"D(\d+(?:\.\d+)?) ?K", name, re.ASCII)
    wavelengths, _ = _daylight_table(float(daylight[1])) if daylight else _illuminant_table(name)
    return float(wavelengths[0]), float(wavelengths[-1])


@functools.lru_cache(1000)
def require_illuminant(name: str) -> None:
    """Raise RecipeError unless a light has that name."""
    illuminant(name, SAMPLED)


def _illuminant_a(wavelength: Array) -> Array:
    """Return energy (wavelength) of CIE illuminant A, by the formula that defines it (ISO/CIE 11664-2)."""
    return 100.0 * (560.0 / wavelength) ** 5 * np.expm1(1.435e7 / (2848 * 560)) / np.expm1(1.435e7 / (2848 * wavelength))


def _tabulated(name: str, wavelength: Array) -> Array:
    """Return energy (wavelength) of a CIE illuminant, linear between its samples and held beyond them."""
    source, values = _illuminant_table(name)
    return np.asarray(values @ _step_matrix(source, wavelength, extended=True).T)


def _illuminant_table(name: str) -> tuple[Array, Array]:
    """Return wavelengths and energy of a CIE illuminant; RecipeError if it has no table.

    Tables of colour-science end at 780 nm, those of the CIE's daylights at 830 nm: the rest is from the components of
    daylight.
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
    """Return energy (wavelength) of CIE daylight of a correlated colour temperature in K, one of DAYLIGHT (CIE 15)."""
    source, values = _daylight_table(temperature)
    return np.asarray(values @ _step_matrix(source, wavelength, extended=True).T)


def _daylight_table(temperature: float) -> tuple[Array, Array]:
    """Return wavelengths and energy of CIE daylight of a correlated colour temperature in K."""
    colour = colour_science()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        table = colour.sd_CIE_illuminant_D_series(colour.temperature.CCT_to_xy_CIE_D(temperature))
    return np.asarray(table.wavelengths), np.asarray(table.values)


def at_luminance(radiance: Array, wavelength: Array, luminance: float) -> Array:
    """Return `radiance` (wavelength) scaled to a luminance of `luminance` cd/m²; InputFileError if none of it is visible."""
    seen = xyz_weights(wavelength)[1] @ radiance
    if not seen > UNSEEN * (matching_weights(np.ones_like(wavelength), wavelength) @ radiance):
        ends = f"{wavelength.min():g}…{wavelength.max():g} nm"
        raise InputFileError(f"light of {ends} has no luminance, which exposures go by; include some of 380…780 nm")
    return radiance * (luminance / seen)


def white_point(name: str) -> NDArray[np.float64]:
    """Return XYZ (3), Y = 1, of a perfect reflector under a named illuminant or black body."""
    wavelength = np.arange(380.0, 781.0, 5.0)
    xyz = xyz_weights(wavelength) @ illuminant(name, wavelength)
    return xyz / xyz[1]


COLORCHECKER_WAVELENGTH = np.arange(380.0, 781.0, 5.0)  # nm: where the chart was measured


def colorchecker(wavelength: Array) -> tuple[tuple[str, ...], Array]:
    """Return the names and reflectances (24, wavelength) of the classic ColorChecker, row by row from dark skin to black."""
    chart = colour_science().SDS_COLOURCHECKERS["ISO 17321-1"]
    reflectance = [np.interp(wavelength, patch.wavelengths, patch.values) for patch in chart.values()]
    return tuple(chart), np.array(reflectance)


@functools.cache
def _reflectance_tables() -> tuple[tuple[Array, Array], ...]:
    """Return the measured reflectances in colour-science as (wavelength, (sample, wavelength)), no ColorChecker."""
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


SURFACES_MEASURED = 380.0, 780.0  # nm, between which all reflectances of the library are measured; held beyond


def reflectance_library(wavelength: Array) -> Array:
    """Return measured reflectances of surfaces, (sample, wavelength), within 0.003–0.999 (docs/method.md#procedural-scenes).

    They are smooth: taken at points, for that is where `held_interpolation` leads a curve through; means would be flatter.
    """
    library = np.concatenate(
        [[np.interp(wavelength, grid, sample) for sample in samples] for grid, samples in _reflectance_tables()]
    )
    return np.clip(library[np.isfinite(library).all(axis=1)], 0.003, 0.999)


WHITEST, BLACKEST = 1.0, 0.002  # reflectances


def with_saturation(reflectance: Array, saturation: float, drawn: NDArray[np.bool_] | slice = slice(None)) -> Array:
    """Return reflectance (…, band) drawn towards its geometric mean: 0 is grey, 1 leaves it. The mean is that of the bands
    `drawn`, of all without."""
    grey = np.exp(np.log(reflectance[..., drawn]).mean(axis=-1, keepdims=True))
    return np.asarray(grey * (reflectance / grey) ** saturation)


def with_titanium_white(reflectance: Array, wavelength: Array, edge: float, width: float) -> Array:
    """Return reflectance (…, band) in [BLACKEST, WHITEST] with the absorption edge of rutile (3.0 eV, 413 nm) added:
    whatever is scattered by titanium white turns dark within some 20 nm of it. `edge` is the K/S it adds at 405 nm (about
    0.2), `width` how fast that falls, in nm (5 to 11): Kubelka–Munk; the tail falls exponentially, as Urbach's rule says.

    Cameras and eyes weigh this edge differently; without it a table takes white paint for yellow.
    """
    pigment = (1.0 - reflectance) ** 2 / (2.0 * reflectance)
    return np.clip(kubelka_munk(pigment + edge * np.exp(-(wavelength - 405.0) / width)), BLACKEST, WHITEST)


def kubelka_munk(absorption_per_scattering: Array) -> Array:
    """Return the reflectance of an opaque layer of given K/S (Kubelka–Munk)."""
    ratio = absorption_per_scattering
    return 1.0 + ratio - np.sqrt(ratio**2 + 2.0 * ratio)
