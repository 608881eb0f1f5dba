"""Illuminants, the electrons that a camera collects under them, and target outputs (docs/method.md#simulation)."""

import hashlib
import itertools
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import curves_in_file
from l3cli.artifacts.training_set import LightSpectrum
from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.frames.scene import NO_ILLUMINANT, Scene
from l3cli.physics import spectra
from l3cli.physics.display import fit_through
from l3cli.physics.stokes import COLOUR_STOKES, STOKES, has_stokes, luminance_name
from l3cli.spectra.file import names_file, read_table
from l3cli.spectra.table import NOISE, gaps

Array = NDArray[np.floating]
Curve = tuple[Array, Array]  # (sample,), wavelengths in nm; (curve, sample), values

SCENE_LIGHT = "scene"  # in recipes, this name selects the illuminant that is stored with a scene
WIDEST_GAP = 20.0  # largest permitted distance between samples of a measured illuminant, in nm
INCOMPLETE_FRACTION = 0.01  # a measured spectrum is incomplete if its first or last value exceeds this fraction of the peak

OUTPUTS = {
    "CIE 1931": ("X", "Y", "Z"),
    "CIE 1964": ("X10", "Y10", "Z10"),
    "luminance": ("Y",),
    "CIE 1931 + IR": ("X", "Y", "Z", "IR"),
    "reflectance 31": spectra.REFLECTANCES,
    "radiance 31": spectra.RADIANCES,
    "Stokes": STOKES,
    "CIE 1931 + Stokes": COLOUR_STOKES,
}
UNLIT = "reflectance 31"  # key of the target that does not depend on the illuminant
NOTICEABLE = 0.01  # l3 warns if wavelengths without data produce more than this fraction of a channel's electrons
# The same for responsivities that are extended with their last value. The limit is higher, because measured curves end with
# small errors: for the 52 built-in cameras, whose curves end at 720 nm, the fraction is at most 0.049.
NOTICEABLE_CURVES = 0.05
CAMERA = "camera"  # in recipes, this value of target.outputs selects all camera bands at full resolution


@dataclass(frozen=True)
class Light:
    """An illuminant, described by the spectral radiance of a perfect white."""

    name: str
    luminance: float  # cd/m², luminance of a perfect white
    wavelength: Array  # (sample,), nm
    radiance: Array  # (sample,), photons/s/sr/m²/nm
    measured: str = ""  # digest of the measured spectra; "" for a standard illuminant

    def at(self, luminance: float) -> "Light":
        """Scale the illuminant to a luminance in cd/m²."""
        return replace(self, luminance=luminance, radiance=self.radiance * (luminance / self.luminance))

    @property
    def spectrum(self) -> LightSpectrum:
        """Spectrum at 1 cd/m², in the format of training sets."""
        return LightSpectrum(self.wavelength.astype(np.float64), (self.radiance / self.luminance).astype(np.float32))


def mixture(text: str) -> list[tuple[float, str]]:
    """Parse an illuminant in a recipe, such as "0.7 D65 + 0.3 lamp.csv".

    Returns
    -------
    list of (float, str)
        Each component's proportion of the luminance, and its name.

    Raises
    ------
    RecipeError
        If a proportion is 0.
    """
    weighted_parts = []
    for term in re.split(r"\s+\+\s+", text.strip()):
        weighted = re.fullmatch(r"(\d*\.?\d+)\s+(?!K$)(.+)", term)
        weighted_parts.append((float(weighted[1]), weighted[2]) if weighted else (1.0, term))
    if min(share for share, _ in weighted_parts) <= 0:
        raise RecipeError(f'illuminant "{text}" contains a proportion of 0; use only proportions greater than 0')
    return weighted_parts


def make_light(text: str, measured: Mapping[str, Curve], seen: Array) -> Light:
    """Compute the spectrum of an illuminant at a luminance of 1 cd/m².

    Parameters
    ----------
    text : str
        Name of a standard illuminant (see `spectra.illuminant`), key of `measured`, or mixture such as "0.7 D65 + 0.3 A".
    measured : mapping of str to Curve
        Measured illuminants: wavelengths in nm and power per nm.
    seen : ndarray, (wavelength,)
        Wavelengths at which the camera is sensitive, in nm.

    Raises
    ------
    RecipeError
        If a name is unknown, or if the illuminant contains no visible light.

    Notes
    -----
    The illuminant is tabulated in steps of 1 nm over the range in which the observer or the camera is sensitive. Power
    between two grid points is divided between them, so that no spectral line is lost. If all components were measured at the
    camera's own wavelengths, the illuminant keeps these wavelengths, and all sums are computed on this grid as in ISETCam.
    """
    names = mixture(text)
    wavelength = spectra.light_grid(seen)
    if all(name in measured and np.array_equal(measured[name][0], seen) for _, name in names):
        wavelength = np.asarray(seen)
    radiance = np.zeros(wavelength.size)
    with np.errstate(all="ignore"):  # the radiance of a black body of a few kelvin underflows to 0
        for share, name in names:
            if name in measured:
                grid, power = measured[name]
                one = spectra.photons_from_energy(wavelength, spectra.resample(power[0], grid, wavelength))
            else:
                one = spectra.illuminant(name, wavelength)
            radiance += share * spectra.at_luminance(one, wavelength, 1.0)
    if not (np.isfinite(radiance).all() and radiance.any()):
        raise RecipeError(f'illuminant "{text}" contains no visible light; choose another illuminant')
    digest = _digest(*itertools.chain(*(measured[name] for _, name in names if name in measured)))
    return Light(text, 1.0, wavelength, radiance / sum(share for share, _ in names), digest)


class Detector(Protocol):
    """Camera, or colour filters on a pixel, with the electrons that light generates in each channel."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Channel or filter names."""

    @property
    def wavelength(self) -> NDArray[np.float64]:
        """Wavelengths in nm."""

    @property
    def electron_weights(self) -> NDArray[np.float64]:
        """Electrons per unit photon radiance, up to a common factor: (channel, wavelength)."""


class Filters(NamedTuple):
    """Colour filters on a pixel, for functions that accept any `Detector`."""

    channels: tuple[str, ...]
    wavelength: NDArray[np.float64]
    electron_weights: NDArray[np.float64]

    @classmethod
    def of(cls, curves: Mapping[str, Array], wavelength: Array) -> "Filters":
        """Create filters from their names and quantum efficiencies in `curves`, sampled at `wavelength` in nm."""
        return cls(tuple(curves), np.asarray(wavelength), np.array(list(curves.values())) * spectra.bin_widths(wavelength))


def named_beyond_known(names: Iterable[str], camera: Detector) -> list[str]:
    """Return the warnings of `beyond_known` for all standard illuminants in `names`.

    Measured illuminants, scene illuminants and unknown names are skipped, because their spectra are not available here.
    """
    warnings = []
    for name in dict.fromkeys(names):
        try:
            if name == SCENE_LIGHT or any(names_file(part) for _, part in mixture(name)):
                continue
            light = make_light(name, {}, camera.wavelength)
        except L3Error:
            continue
        warnings.append(beyond_known(light, {}, camera))
    return list(filter(None, warnings))


def beyond_known(light: Light, measured: Mapping[str, Curve], camera: Detector) -> str:
    """Return a warning if a channel collects more than 1 % of its electrons where the illuminant is unknown.

    Outside its tabulated range, l3 extends a standard illuminant with its last value and a measured illuminant with zero. To
    estimate the fraction, both kinds are extended with their last value.

    Parameters
    ----------
    light : Light
        The illuminant.
    measured : mapping of str to Curve
        Measured illuminants: wavelengths in nm and power per nm.
    camera : CameraModel or Filters
        The camera.

    Returns
    -------
    str
        The warning, or "" if the fraction is at most 1 %.
    """
    found = (0.0, "")
    parts = mixture(light.name)
    total = sum(share for share, _ in parts)
    for share, name in parts:
        if name in measured:
            grid, power = measured[name]
            ends, wavelength = (grid.min(), grid.max()), light.wavelength
            order = np.argsort(grid)
            held = spectra.photons_from_energy(wavelength, np.interp(wavelength, grid[order], power[0][order]))
            what = "; l3 assumes no light at other wavelengths, but if the last value continued there, channel {} would "
            what += "collect {:.0%} of its electrons there"
        else:
            ends, held = spectra.known_range(name), spectra.illuminant(name, light.wavelength)
            what = "; l3 assumes the last value at other wavelengths, where channel {} collects {:.0%} of its electrons"
        one = spectra.at_luminance(held, light.wavelength, light.luminance * share / total)
        taken, channel = share_beyond(camera, replace(light, radiance=one), light, ends)
        if taken > max(found[0], NOTICEABLE):
            where = f"{ends[0]:g}…{ends[1]:g} nm"
            text = f"illuminant {name} is known only at {where}{what.format(channel, taken)}"
            found = taken, f"{text}; use an illuminant that was measured at {span_of(camera)}"
    return found[1]


def lens_beyond_known(name: str, transmittance: Curve, light: Light, camera: CameraModel) -> str:
    """Return a warning if a channel could collect more than 1 % of its electrons where the lens transmittance is unknown.

    Outside the wavelength range of the file, l3 assumes zero transmittance. The fraction is estimated from a transmittance
    that is extended with its last value.

    Parameters
    ----------
    name : str
        Name of the transmittance file.
    transmittance : Curve
        Wavelengths in nm and transmittance in the file.
    light : Light
        The illuminant.
    camera : CameraModel
        The camera without this lens.

    Returns
    -------
    str
        The warning, or "" if the fraction is at most 1 %.
    """
    grid, held = transmittance[0], _held(transmittance, camera.wavelength)[0]
    passing = Filters(camera.channels, camera.wavelength, camera.electron_weights * held)
    taken, channel = share_beyond(passing, light, light, (grid.min(), grid.max()))
    return _file_ends(name, grid, f"channel {channel} would collect {taken:.0%} of its electrons", taken, span_of(camera))


def functions_beyond_known(name: str, functions: Curve, names: Sequence[str], light: Light) -> str:
    """Return a warning if an output could lose more than 1 % of its value where its matching function is unknown.

    Outside the wavelength range of the file, l3 assumes zero. The missing fraction is estimated for a white surface, with
    matching functions that are extended with their last values.

    Parameters
    ----------
    name : str
        Name of the file with the matching functions.
    functions : Curve
        Wavelengths in nm and matching functions in the file.
    names : sequence of str
        Names of the outputs.
    light : Light
        The illuminant.

    Returns
    -------
    str
        The warning, or "" if the fraction is at most 1 %.
    """
    grid, wavelength = functions[0], light.wavelength
    weights = np.abs(spectra.matching_weights(_held(functions, wavelength), wavelength) * light.radiance)
    outside = (wavelength < grid.min()) | (wavelength > grid.max())
    every = weights.sum(axis=1)
    shares = weights[:, outside].sum(axis=1) / np.where(every > 0, every, np.inf)
    output, taken = int(shares.argmax()), float(shares.max())
    wanted = f"{wavelength[0]:g}…{wavelength[-1]:g} nm"
    effect = f"output {names[output]} would have {taken:.0%} of its value for a perfect white"
    return _file_ends(name, grid, effect, taken, wanted)


def curves_beyond_known(recipe: Path, light: Light, camera: CameraModel) -> str:
    """Return a warning if a channel could collect more than 5 % of its electrons where its responsivity is unknown.

    Outside the wavelength range of the file, l3 assumes zero responsivity. The fraction is estimated from responsivities
    that are extended with their last values to all wavelengths of the illuminant.

    Parameters
    ----------
    recipe : Path
        The camera recipe.
    light : Light
        The illuminant.
    camera : CameraModel
        The camera from this recipe.

    Returns
    -------
    str
        The warning, or "" if the fraction is at most 5 % or the recipe uses no responsivity file.
    """
    curves = curves_in_file(recipe)
    if curves is None:
        return ""
    grid, wavelength = curves.wavelength, camera.wavelength
    inside = (wavelength >= grid.min()) & (wavelength <= grid.max())
    # The wavelengths of the light extend beyond those of the camera, which are often those of the file.
    held = _held((wavelength[inside], camera.responsivity[:, inside]), light.wavelength)
    # Where the file covers more than the camera, the recipe limits the wavelengths, and the file lacks nothing.
    held[:, (light.wavelength < wavelength.min()) & (grid.min() < wavelength.min())] = 0
    held[:, (light.wavelength > wavelength.max()) & (grid.max() > wavelength.max())] = 0
    seen = Filters.of(dict(zip(camera.channels, held, strict=True)), light.wavelength)
    taken, channel = share_beyond(seen, light, light, (grid.min(), grid.max()))
    if taken <= NOTICEABLE_CURVES:
        return ""
    there = f"channel {channel} would collect {taken:.0%} of its electrons"
    return _file_ends(str(curves.path), grid, there, taken, "all wavelengths at which the curves are not zero")


def camera_unknown(path: Path, camera: CameraModel, lights: Sequence[str]) -> list[str]:
    """Return warnings about wavelengths that a camera's responsivity file or a standard illuminant does not cover.

    Parameters
    ----------
    path : Path
        The camera recipe.
    camera : CameraModel
        The camera from this recipe.
    lights : sequence of str
        Illuminants under which the camera is used.

    Returns
    -------
    list of str
        At most one warning for each standard illuminant, and at most one for the responsivity file.
    """
    ends = (curves_beyond_known(path, make_light(name, {}, camera.wavelength), camera) for name in lights)
    return [*named_beyond_known(lights, camera), *itertools.islice(filter(None, ends), 1)]


def _held(curves: Curve, wavelength: Array) -> Array:
    """Resample curves to `wavelength` (nm), and extend them with their end values: (curve, wavelength)."""
    order = np.argsort(curves[0])
    return np.array([np.interp(wavelength, curves[0][order], each[order]) for each in curves[1]])


def _file_ends(name: str, grid: Array, there: str, taken: float, wanted: str) -> str:
    """Compose a warning about a file of curves that does not cover all wavelengths, or return "" if at most 1 % is missing.

    Parameters
    ----------
    name : str
        Name of the file.
    grid : ndarray
        Wavelengths in the file, in nm.
    there : str
        Part of the message that states how much is missing.
    taken : float
        Missing fraction.
    wanted : str
        Part of the message that says which wavelengths the file should cover.
    """
    if taken <= NOTICEABLE:
        return ""
    known = f"{name} contains values at {grid.min():g}…{grid.max():g} nm, and l3 assumes zero at other wavelengths"
    return f"{known}; if the last value continued there, {there}; use a file with values at {wanted}"


def surfaces_beyond_known(light: Light, camera: CameraModel) -> str:
    """Return a warning if a channel collects more than 1 % of its electrons at wavelengths without measured reflectances.

    Outside the measured range, reflectances are extended with their last values. Returns "" if the fraction is at most 1 %.
    """
    taken, channel = share_beyond(camera, light, light, spectra.SURFACES_MEASURED)
    if taken <= NOTICEABLE:
        return ""
    first, last = spectra.SURFACES_MEASURED
    return (
        f"the reflectances of the scenes were measured at {first:g}…{last:g} nm; l3 assumes the last value at other "
        f"wavelengths, where channel {channel} collects {taken:.0%} of its electrons under {light.name}; use scenes that "
        f"were measured at {span_of(camera)}"
    )


def share_beyond(camera: Detector, part: Light, whole: Light, ends: tuple[float, float]) -> tuple[float, str]:
    """Find the channel that collects the largest fraction of its electrons outside a range of wavelengths.

    Parameters
    ----------
    camera : CameraModel or Filters
        The camera.
    part : Light
        The component of the illuminant that is examined.
    whole : Light
        The complete illuminant.
    ends : tuple of float
        Ends of the range, in nm.

    Returns
    -------
    fraction : float
        Electrons from `part` outside the range, divided by all electrons from a perfect white under `whole`.
    channel : str
        The channel with the largest fraction.
    """
    outside = (part.wavelength < ends[0]) | (part.wavelength > ends[1])
    given = electron_weights(camera, part, part.wavelength)[:, outside].sum(axis=1)
    every = white_rates(camera, whole)
    shares = given / np.where(every > 0, every, np.inf)
    channel = int(shares.argmax())
    return float(shares[channel]), camera.channels[channel]


def span_of(camera: Detector) -> str:
    """Format a camera's wavelength range, such as "380…780 nm"."""
    return f"{camera.wavelength[0]:g}…{camera.wavelength[-1]:g} nm"


def recorded_under(text: str, measured: Mapping[str, Curve], seen: Array) -> Light:
    """Compute the spectrum of the illuminant under which a scene was recorded.

    If `text` is the name of a measured illuminant, the spectrum is sampled at the wavelengths of the measurement, which are
    often the bands of the scene. Otherwise, it is sampled at the wavelengths `seen`, as in `make_light`.
    """
    return make_light(text, measured, measured[text][0] if text in measured else seen)


def check_measured(curve: Curve, name: str) -> None:
    """Check the spectrum of a measured illuminant.

    Raises
    ------
    InputFileError
        If the file contains several curves, or if the spectrum is zero, has gaps, contains large negative values or does not
        cover the visible range.
    """
    wavelength, power = curve[0], curve[1][0]
    if len(curve[1]) != 1:
        raise InputFileError(f"{name} contains {len(curve[1])} curves; use a file with the power of one light")
    if power.max() <= 0:
        raise InputFileError(f"{name} is zero at all wavelengths; use a file with the power of the light at each wavelength")
    missing = gaps(wavelength, curve[1], WIDEST_GAP)
    if wavelength.size < 2 or missing:
        where = " between {:g} and {:g} nm".format(*missing[0]) if missing else ""
        raise InputFileError(
            f"{name} has a gap{where}; sample the spectrum at least every {WIDEST_GAP:g} nm where it has power"
        )
    if power.min() < 0:
        raise InputFileError(
            f"{name} is negative at {wavelength[power.argmin()]:g} nm, by more than {NOISE:.0%} of its peak; correct the "
            "dark subtraction"
        )
    for end, visible in ((0, wavelength[0] > 420), (-1, wavelength[-1] < 680)):
        if visible and power[end] > INCOMPLETE_FRACTION * power.max():
            raise InputFileError(
                f"{name} ends at {wavelength[end]:g} nm, where the light still has power; measure the light at 400–700 nm"
            )


def read_curve(path: Path, role: str) -> Curve:
    """Read a file of spectra for a scene recipe.

    Parameters
    ----------
    path : Path
        The file.
    role : {"light", "transmittance", "functions"}
        Purpose of the file in the recipe.

    Returns
    -------
    wavelength : ndarray, (sample,)
        Wavelengths in nm.
    values : ndarray, (curve, sample)
        Power of an illuminant, transmittance of a lens (0 to 1), or matching functions.

    Raises
    ------
    InputFileError
        If the content of the file does not fit its role.
    """
    table = read_table(path)
    if role == "transmittance":
        return table.wavelength, table.counted(1).shares()
    if role == "functions":
        return table.wavelength, table.values
    curve = table.wavelength, table.powers()
    check_measured(curve, str(path))
    return curve


def scene_light(scene: Scene, luminance: float) -> Light:
    """Return the illuminant that is stored with a scene, scaled to a luminance in cd/m².

    Its spectrum is known only at the wavelengths of the scene.

    Raises
    ------
    RecipeError
        If no illuminant is stored with the scene, or if the illuminant contains no visible light.
    """
    if scene.illuminant is NO_ILLUMINANT or spectra.xyz_weights(scene.wavelength)[1] @ scene.illuminant <= 0:
        raise RecipeError(
            f'scene {scene.name} contains no illuminant with visible light; remove "{SCENE_LIGHT}" from illuminants'
        )
    radiance = spectra.at_luminance(scene.illuminant, scene.wavelength, luminance)
    return Light(SCENE_LIGHT, luminance, scene.wavelength, radiance, _digest(scene.wavelength, scene.illuminant))


def _digest(*arrays: Array) -> str:
    return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()


def electron_weights(camera: Detector, light: Light, bands: Array) -> Array:
    """Return the photo-electrons per second that each band contributes to each channel.

    Parameters
    ----------
    camera : CameraModel or Filters
        The camera.
    light : Light
        Illuminant of the scene.
    bands : ndarray, (band)
        Wavelengths of the scene, in nm.

    Returns
    -------
    ndarray, (channel, band)
        Photo-electrons in e-/s for a reflectance of 1 in the band.

    Notes
    -----
    The responsivity is interpolated linearly between its samples.
    """
    return _of_bands(camera.electron_weights, camera, light, bands)


def stokes_weights(camera: CameraModel, light: Light, bands: Array) -> Array:
    """Return the `electron_weights` of each Stokes parameter, S0, S1 and S2, as an array (stokes, channel, band)."""
    return _of_bands(camera.stokes_weights, camera, light, bands)


def _of_bands(weights: Array, camera: Detector, light: Light, bands: Array) -> Array:
    """Convert electron weights at the camera's wavelengths, (…, wavelength), to weights of scene bands, (…, band)."""
    seen = weights @ spectra.sampling_matrix(light.wavelength, camera.wavelength)
    return (seen * light.radiance) @ spectra.held_interpolation(bands, light.wavelength)


def photon_weights(camera: CameraModel, light: Light, bands: Array) -> Array:
    """Return the photons per second that each band contributes to a pixel, at each wavelength of the camera.

    For a camera with neither polarisers nor per-channel readout, `electron_weights` is the matrix product responsivity @
    photon_weights.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    light : Light
        Illuminant of the scene.
    bands : ndarray, (band)
        Wavelengths of the scene, in nm.

    Returns
    -------
    ndarray, (wavelength, band)
        Photons per second for a reflectance of 1 in the band.
    """
    photons = camera.optics.irradiance_per_radiance * camera.pixel_pitch**2 * spectra.bin_widths(camera.wavelength)
    seen = photons[:, None] * spectra.sampling_matrix(light.wavelength, camera.wavelength)
    return (seen * light.radiance) @ spectra.held_interpolation(bands, light.wavelength)


def matching_weights(functions: Array, light: Light, bands: Array) -> Array:
    """Return each band's contribution to the outputs that matching functions define.

    Parameters
    ----------
    functions : ndarray, (output, wavelength)
        Matching functions per watt, at the wavelengths of the illuminant.
    light : Light
        Illuminant of the scene.
    bands : ndarray, (band)
        Wavelengths of the scene, in nm.

    Returns
    -------
    ndarray, (output, band)
        Outputs for a reflectance of 1 in the band.
    """
    weights = spectra.matching_weights(functions, light.wavelength) * light.radiance
    return weights @ spectra.held_interpolation(bands, light.wavelength)


def white_rates(camera: Detector, light: Light) -> Array:
    """Return the photo-electrons per second that each channel collects from a perfect white."""
    return electron_weights(camera, light, light.wavelength).sum(axis=1)


def colour_matrix(camera: CameraModel, light: Light) -> Array:
    """Fit the matrix that converts the XYZ of surfaces under an illuminant to camera signals.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    light : Light
        The illuminant.

    Returns
    -------
    ndarray, (channel, 3)
        Matrix M with signals = M @ XYZ. White has Y = 1, and its signal in the brightest channel is 1. M is a least-squares
        fit to measured reflectances. It is exact for white, because raw converters derive the white balance from M.
    """
    library = spectra.reflectance_library(light.wavelength)
    weights = electron_weights(camera, light, light.wavelength)
    white = weights.sum(axis=1)
    channels = library @ weights.T / white.max()
    to_xyz = spectra.xyz_weights(light.wavelength) * light.radiance
    xyz_white = to_xyz.sum(axis=1)
    xyz = library @ to_xyz.T / xyz_white[1]
    return fit_through(xyz, channels, xyz_white / xyz_white[1], white / white.max())


def neutral(camera: CameraModel, light: Light) -> Array:
    """Return the signal of a grey surface in each channel, relative to the brightest channel."""
    rates = white_rates(camera, light)
    return rates / rates.max()


def automatic_exposure(camera: CameraModel, light: Light, share: float) -> float:
    """Return the exposure time in s at which a perfect white reaches the fraction `share` of full scale.

    The fraction applies to the brightest channel.
    """
    return float(share * camera.full_scale / (white_rates(camera, light) * camera.channel_gains).max())


def uncovered_share(camera: CameraModel, bands: Array) -> float:
    """Return the fraction of electrons from wavelengths outside a scene's bands, for the most affected channel.

    The fraction applies to a perfect white under an illuminant with equal photon radiance at all wavelengths.
    """
    weights = camera.electron_weights
    outside = (camera.wavelength < bands[0]) | (camera.wavelength > bands[-1])
    every = weights.sum(axis=1)
    return float((weights[:, outside].sum(axis=1) / np.where(every > 0, every, 1.0)).max())


@dataclass(frozen=True)
class Target:
    """The outputs that a table computes, and their illuminant."""

    outputs: tuple[str, ...]
    description: str
    kind: str  # key of OUTPUTS, the constant CAMERA, or the name of a file of matching functions
    functions: Curve | None = None  # matching functions from the file: wavelengths in nm; (output, wavelength), per watt
    light: Light | None = None  # None for the illuminant of each frame

    @property
    def luminance(self) -> int:
        """Index of the luminance output, for targets with Stokes parameters."""
        return self.outputs.index(luminance_name(self.outputs))


XYZ = Target(OUTPUTS["CIE 1931"], "CIE 1931 XYZ of the scene under its own light, without lens or noise", "CIE 1931")


def make_target(
    kind: str, functions: Curve | None, names: tuple[str, ...], light: Light | None, camera: CameraModel
) -> Target:
    """Create the target of a scene recipe.

    Parameters
    ----------
    kind : str
        Key of OUTPUTS, the constant CAMERA, or the name of a file of matching functions.
    functions : Curve or None
        Matching functions, if `kind` is a file.
    names : tuple of str
        Names of the outputs, if `kind` is a file.
    light : Light or None
        Illuminant of the outputs. None for the illuminant of each frame.
    camera : CameraModel
        The camera.
    """
    outputs = OUTPUTS.get(kind, camera.channels if kind == CAMERA else names)
    what = {
        "CIE 1931": "CIE 1931 XYZ",
        "CIE 1964": "CIE 1964 XYZ",
        "luminance": "luminance",
        "CIE 1931 + IR": "CIE 1931 XYZ and near infrared",
        UNLIT: "reflectance at 400…700 nm by 10 nm, times the luminance of a perfect white,",
        "radiance 31": "radiance at 400…700 nm by 10 nm (cd/m² of an equal-energy light of the same spectral radiance)",
        CAMERA: "all bands of the camera (cd/m² of a D65 white that saturates them equally fast)",
        "Stokes": "Stokes parameters (luminance; S1 and S2 are differences of luminances behind polarisers)",
        "CIE 1931 + Stokes": "CIE 1931 XYZ and Stokes parameters (differences of luminances behind polarisers)",
    }.get(kind, f"the matching functions of {kind}")
    under = f"under {light.name}" if light else "under its own light"
    return Target(outputs, f"{what} of the scene {under}, without lens or noise", kind, functions, light)


def output_weights(target: Target, camera: CameraModel, light: Light, bands: Array) -> Array:
    """Return each band's contribution to the target outputs.

    Parameters
    ----------
    target : Target
        The target outputs.
    camera : CameraModel
        The camera.
    light : Light
        Illuminant of the scene.
    bands : ndarray, (band)
        Wavelengths of the scene, in nm.

    Returns
    -------
    ndarray, (output, band)
        Outputs in cd/m² for a reflectance of 1 in the band. Outputs that are camera bands are fractions of full scale per
        second, times the camera's saturation exposure. S1 and S2 are 0, because the light is unpolarised.
    """
    if target.light:
        light = target.light.at(light.luminance)
    if target.kind == CAMERA:
        return electron_weights(camera, light, bands) * _band_unit(camera)
    if target.kind == UNLIT:
        return light.luminance * spectra.held_interpolation(bands, spectra.SAMPLED)
    if target.functions:
        grid, values = target.functions
        functions: Array = spectra.average(values, grid, light.wavelength)
    elif target.kind == "Stokes":
        luminance = spectra.colour_matching_functions(light.wavelength)[1]
        functions = np.stack([np.zeros_like(luminance), luminance, np.zeros_like(luminance)])
    elif target.kind == "CIE 1931 + Stokes":
        functions = np.pad(spectra.colour_matching_functions(light.wavelength), ((0, 2), (0, 0)))
    elif target.kind == "luminance":
        functions = spectra.colour_matching_functions(light.wavelength)[1:2]
    elif target.kind == "CIE 1931 + IR":
        visible = spectra.colour_matching_functions(light.wavelength)
        functions = np.vstack([visible, spectra.near_infrared(light.wavelength)])
    elif target.kind == "radiance 31":
        functions = spectra.sampled_radiance(light.wavelength)
    else:
        functions = spectra.colour_matching_functions(light.wavelength, target.kind)
    return matching_weights(functions, light, bands)


def polarised_weights(target: Target, camera: CameraModel, light: Light, bands: Array) -> Array:
    """Return the contribution of each band's S1 and S2 to the target outputs, (2, output, band).

    S1 and S2 contribute to Stokes outputs and, through the polarisers, to camera bands.
    """
    if target.kind == CAMERA:
        seen = target.light.at(light.luminance) if target.light else light
        return stokes_weights(camera, seen, bands)[1:] * _band_unit(camera)
    weights = np.zeros((2, len(target.outputs), len(bands)))
    if has_stokes(target.outputs):
        for each, name in zip(weights, ("S1", "S2"), strict=True):
            each[target.outputs.index(name)] = output_weights(target, camera, light, bands)[target.luminance]
    return weights


def _band_unit(camera: CameraModel) -> Array:
    """Return the factors, (channel, 1), from electrons per second to the outputs of a camera-band target."""
    unit = np.full((len(camera.channels), 1), camera.saturation_exposure / camera.full_scale)
    return unit if camera.readout is None else unit * camera.channel_gains[:, None]


LEAST_SEEN = 0.1  # smallest permitted fraction of a target's spectral weight within the bands of a scene


def require_seen(bands: Array, target: Target, camera: CameraModel) -> None:
    """Check that the bands of a scene cover the wavelengths that a target needs.

    Colour targets need the wavelengths that contribute to luminance, and spectral targets need 400 to 700 nm. If the outputs
    are camera bands or are defined by matching functions from a file, the scene must cover at least one output.

    Parameters
    ----------
    bands : ndarray, (band)
        Wavelengths of the scene, in nm.
    target : Target
        The target.
    camera : CameraModel
        The camera.

    Raises
    ------
    ValueError
        If the bands cover less than the fraction LEAST_SEEN of the target's spectral weight.
    """
    grid: Array = np.arange(300.0, 1101.0)
    wanted: Array
    if target.kind == CAMERA:
        grid, wanted = camera.wavelength, camera.electron_weights
    elif target.functions:
        grid, wanted = target.functions
    elif target.outputs in (spectra.REFLECTANCES, spectra.RADIANCES):
        wanted = ((grid >= spectra.SAMPLED[0]) & (grid <= spectra.SAMPLED[-1])).astype(float)[None]
    else:
        wanted = spectra.colour_matching_functions(grid)[1:2]
    ends = spectra.bin_edges(bands)[[0, -1]]
    inside = (grid >= ends[0]) & (grid <= ends[1])
    weight = np.abs(wanted)
    seen = weight[:, inside].sum(axis=1) / np.maximum(weight.sum(axis=1), np.finfo(float).tiny)
    if seen.max() < LEAST_SEEN:
        raise ValueError(
            f"the bands at {bands[0]:g}…{bands[-1]:g} nm cover only {seen.max():.1%} of the target's spectral weight "
            f"({', '.join(target.outputs[:3])}); check the unit of the wavelengths, or remove the scene from the recipe"
        )


def column_names(path: Path) -> tuple[str, ...]:
    """Return the column names in a file of matching functions, or numbered names if they are missing or ambiguous."""
    table = read_table(path)
    unnamed = tuple(f"output {number}" for number in range(1, len(table.values) + 1))
    names = table.names or ()
    named = len(set(names)) == len(names) and not any(re.fullmatch(r"[-+.\deE]*", name) for name in names)
    return names if names and named else unnamed
