"""Illuminants, the electrons that a camera collects under them, and the target outputs (docs/method.md#simulation)."""

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
from l3cli.spectra.file import names_file, read_table
from l3cli.spectra.table import NOISE, gaps

Array = NDArray[np.floating]
Curve = tuple[Array, Array]  # wavelength (sample) nm, values (curve, sample)

SCENE_LIGHT = "scene"  # in a recipe, the illuminant under which the scene was measured
WIDEST_GAP = 20.0  # nm; largest permitted distance between samples of a measured illuminant
INCOMPLETE_FRACTION = 0.01  # fraction of the peak; a measured spectrum that ends above this value is incomplete

OUTPUTS = {
    "CIE 1931": ("X", "Y", "Z"),
    "CIE 1964": ("X10", "Y10", "Z10"),
    "luminance": ("Y",),
    "CIE 1931 + IR": ("X", "Y", "Z", "IR"),
    "reflectance 31": spectra.REFLECTANCES,
    "radiance 31": spectra.RADIANCES,
}
UNLIT = "reflectance 31"  # outputs that do not depend on the illuminant
NOTICEABLE = 0.01  # l3 warns if a larger fraction of a channel's electrons comes from wavelengths without data
CAMERA = "camera"  # the camera's own bands at full resolution


@dataclass(frozen=True)
class Light:
    """An illuminant, as the spectral radiance of a perfect white under it."""

    name: str
    luminance: float  # cd/m² of a perfect white
    wavelength: Array  # (sample) nm
    radiance: Array  # (sample) photons/s/sr/m²/nm
    measured: str = ""  # digest of the measured spectra in the illuminant

    def at(self, luminance: float) -> "Light":
        """Return the same illuminant at another luminance, in cd/m²."""
        return replace(self, luminance=luminance, radiance=self.radiance * (luminance / self.luminance))

    @property
    def spectrum(self) -> LightSpectrum:
        """The spectrum as a training set stores it, for a luminance of 1 cd/m²."""
        return LightSpectrum(self.wavelength.astype(np.float64), (self.radiance / self.luminance).astype(np.float32))


def mixture(text: str) -> list[tuple[float, str]]:
    """Parse the text that names an illuminant in a recipe, such as "0.7 D65 + 0.3 lamp.csv".

    Returns
    -------
    list of (float, str)
        For each component, its share of the luminance and its name.

    Raises
    ------
    RecipeError
        If a share is not above 0.
    """
    weighted_parts = []
    for term in re.split(r"\s+\+\s+", text.strip()):
        weighted = re.fullmatch(r"(\d*\.?\d+)\s+(?!K$)(.+)", term)
        weighted_parts.append((float(weighted[1]), weighted[2]) if weighted else (1.0, term))
    if min(share for share, _ in weighted_parts) <= 0:
        raise RecipeError(f'illuminant "{text}": shares must be above zero')
    return weighted_parts


def make_light(text: str, measured: Mapping[str, Curve], seen: Array) -> Light:
    """Return the illuminant that a recipe names, at 1 cd/m².

    Parameters
    ----------
    text : str
        A name that `spectra.illuminant` knows, a key of `measured`, or a mixture of these.
    measured : mapping of str to Curve
        Measured illuminants: wavelength in nm and power per nm.
    seen : ndarray, (wavelength)
        Wavelengths at which the camera is sensitive, in nm.

    Raises
    ------
    RecipeError
        If a name is unknown or the illuminant is invisible.

    Notes
    -----
    The illuminant is tabulated at every nanometre that the observer or the camera sees. Power between two of these
    wavelengths is divided between them, so that no spectral line is lost. If the illuminant was measured on the camera's
    wavelength grid, it keeps this grid. All sums then run over the same grid, as in ISETCam.
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
        raise RecipeError(f'illuminant "{text}" gives no visible light')
    digest = _digest(*itertools.chain(*(measured[name] for _, name in names if name in measured)))
    return Light(text, 1.0, wavelength, radiance / sum(share for share, _ in names), digest)


class Sees(Protocol):
    """Anything that turns light into electrons: a camera, or colour filters on a pixel."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels or filters."""

    @property
    def wavelength(self) -> NDArray[np.float64]:
        """Wavelengths (wavelength) in nm."""

    @property
    def electron_weights(self) -> NDArray[np.float64]:
        """Electrons (channel, wavelength) for unit photon radiance, up to a common factor."""


class Filters(NamedTuple):
    """Colour filters on a pixel, as an implementation of `Sees`."""

    channels: tuple[str, ...]
    wavelength: NDArray[np.float64]
    electron_weights: NDArray[np.float64]

    @classmethod
    def of(cls, curves: Mapping[str, Array], wavelength: Array) -> "Filters":
        """Make filters from their names and quantum efficiencies (wavelength)."""
        return cls(tuple(curves), np.asarray(wavelength), np.array(list(curves.values())) * spectra.bin_widths(wavelength))


def named_beyond_known(names: Iterable[str], camera: Sees) -> list[str]:
    """Collect the warnings of `beyond_known` for standard illuminants.

    Measured illuminants, scene illuminants and unknown names are skipped, because their spectra are not available here. An
    artifact may contain any name.

    Parameters
    ----------
    names : iterable of str
        Names of illuminants.
    camera : CameraModel or Filters
        The camera.

    Returns
    -------
    list of str
        The warnings.
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


def beyond_known(light: Light, measured: Mapping[str, Curve], camera: Sees) -> str:
    """Warn if a channel collects 1 % or more of its electrons where the spectrum of an illuminant is unknown.

    Beyond the ends of its table, a standard illuminant is continued with its last value, and a measured one with zero. For
    the warning, the missing part of a measured illuminant is estimated as if it kept its last value.

    Parameters
    ----------
    light : Light
        The illuminant.
    measured : mapping of str to Curve
        Measured illuminants: wavelength in nm and power per nm.
    camera : CameraModel
        The camera.

    Returns
    -------
    str
        The warning, or "" if none is needed.
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
            what = "and counts as dark beyond; if it kept its last value, channel {} would collect {:.0%} of its electrons "
            what += "there"
        else:
            ends, held = spectra.known_range(name), spectra.illuminant(name, light.wavelength)
            what = "and is held constant beyond, where channel {} collects {:.0%} of its electrons"
        one = spectra.at_luminance(held, light.wavelength, light.luminance * share / total)
        taken, channel = share_beyond(camera, replace(light, radiance=one), light, ends)
        if taken > max(found[0], NOTICEABLE):
            where = f"{ends[0]:g}…{ends[1]:g} nm"
            text = f"light {name} is known at {where} {what.format(channel, taken)}"
            found = taken, f"{text}; give a light that is measured at {span_of(camera)}"
    return found[1]


def lens_beyond_known(name: str, transmittance: Curve, light: Light, camera: CameraModel) -> str:
    """Warn if a lens transmittance file does not cover wavelengths at which a channel could collect electrons.

    The transmittance is zero beyond the ends of the file. The fraction of missing electrons is estimated as if the
    transmittance kept its last value.

    Parameters
    ----------
    name : str
        Name of the file.
    transmittance : Curve
        Contents of the file.
    light : Light
        The illuminant.
    camera : CameraModel
        The camera without this lens.

    Returns
    -------
    str
        The warning if the fraction is 1 % or more, otherwise "".
    """
    grid, held = transmittance[0], _held(transmittance, camera.wavelength)[0]
    passing = Filters(camera.channels, camera.wavelength, camera.electron_weights * held)
    taken, channel = share_beyond(passing, light, light, (grid.min(), grid.max()))
    return _file_ends(name, grid, f"channel {channel} would collect {taken:.0%} of its electrons", taken, span_of(camera))


def functions_beyond_known(name: str, functions: Curve, names: Sequence[str], light: Light) -> str:
    """Warn if a file of matching functions does not cover wavelengths that contribute to an output.

    The functions are zero beyond the ends of the file. The missing fraction of an output is estimated for a white surface,
    as if the functions kept their last values.

    Parameters
    ----------
    name : str
        Name of the file.
    functions : Curve
        Contents of the file.
    names : sequence of str
        Names of the outputs.
    light : Light
        The illuminant.

    Returns
    -------
    str
        The warning if the fraction is 1 % or more, otherwise "".
    """
    grid, wavelength = functions[0], light.wavelength
    weights = np.abs(spectra.matching_weights(_held(functions, wavelength), wavelength) * light.radiance)
    outside = (wavelength < grid.min()) | (wavelength > grid.max())
    every = weights.sum(axis=1)
    shares = weights[:, outside].sum(axis=1) / np.where(every > 0, every, np.inf)
    output, taken = int(shares.argmax()), float(shares.max())
    wanted = f"{wavelength[0]:g}…{wavelength[-1]:g} nm"
    return _file_ends(name, grid, f"output {names[output]} would have {taken:.0%} of its value for a white", taken, wanted)


def curves_beyond_known(recipe: Path, light: Light, camera: CameraModel) -> str:
    """Warn if a camera recipe's responsivity file does not cover wavelengths at which a channel could collect electrons.

    The responsivity is zero beyond the ends of the file. The fraction of missing electrons is estimated as if the curves
    kept their last values.

    Parameters
    ----------
    recipe : Path
        The camera recipe.
    light : Light
        The illuminant.
    camera : CameraModel
        The camera that the recipe describes.

    Returns
    -------
    str
        The warning if the fraction is 1 % or more, otherwise "".
    """
    curves = curves_in_file(recipe)
    if curves is None:
        return ""
    grid, wavelength = curves.wavelength, camera.wavelength
    inside = (wavelength >= grid.min()) & (wavelength <= grid.max())
    held = _held((wavelength[inside], camera.responsivity[:, inside]), wavelength)
    seen = Filters.of(dict(zip(camera.channels, held, strict=True)), wavelength)
    taken, channel = share_beyond(seen, light, light, (grid.min(), grid.max()))
    there = f"channel {channel} would collect {taken:.0%} of its electrons"
    return _file_ends(str(curves.path), grid, there, taken, span_of(camera))


def camera_unknown(path: Path, camera: CameraModel, lights: Sequence[str]) -> list[str]:
    """Warn if channels collect electrons at wavelengths where the camera's curves or an illuminant are unknown.

    Parameters
    ----------
    path : Path
        The camera recipe.
    camera : CameraModel
        The camera that the recipe describes.
    lights : sequence of str
        Illuminants under which the camera is used.

    Returns
    -------
    list of str
        At most one warning per standard illuminant, and at most one for the file of curves.
    """
    ends = (curves_beyond_known(path, make_light(name, {}, camera.wavelength), camera) for name in lights)
    return [*named_beyond_known(lights, camera), *itertools.islice(filter(None, ends), 1)]


def _held(curves: Curve, wavelength: Array) -> Array:
    """Resample curves to `wavelength` (curve, wavelength). They keep their last values beyond their ends."""
    order = np.argsort(curves[0])
    return np.array([np.interp(wavelength, curves[0][order], each[order]) for each in curves[1]])


def _file_ends(name: str, grid: Array, there: str, taken: float, wanted: str) -> str:
    """Return the warning about a file of curves, or "" if the missing fraction `taken` is at most 1 %."""
    if taken <= NOTICEABLE:
        return ""
    known = f"{name} is known at {grid.min():g}…{grid.max():g} nm and counts as zero beyond"
    return f"{known}; if it kept its last value, {there} there; give values at {wanted}"


def surfaces_beyond_known(light: Light, camera: CameraModel) -> str:
    """Warn if a channel collects 1 % or more of its electrons at wavelengths where the reflectances are not measured.

    Beyond the measured range the reflectances keep their last values.

    Returns
    -------
    str
        The warning, or "" if none is needed.
    """
    taken, channel = share_beyond(camera, light, light, spectra.SURFACES_MEASURED)
    if taken <= NOTICEABLE:
        return ""
    first, last = spectra.SURFACES_MEASURED
    return (
        f"surfaces of the scenes are measured at {first:g}…{last:g} nm and held constant beyond, where channel {channel} "
        f"collects {taken:.0%} of its electrons under {light.name}; give scenes that are measured at {span_of(camera)}"
    )


def share_beyond(camera: Sees, part: Light, whole: Light, ends: tuple[float, float]) -> tuple[float, str]:
    """Find the channel to which one component of an illuminant contributes most outside a range of wavelengths.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    part, whole : Light
        The component, and the whole illuminant.
    ends : tuple of float
        Ends of the range, in nm.

    Returns
    -------
    fraction : float
        Electrons that `part` contributes outside the range, divided by all electrons from a white under `whole`.
    channel : str
        The channel in which this fraction is largest.
    """
    outside = (part.wavelength < ends[0]) | (part.wavelength > ends[1])
    given = electron_weights(camera, part, part.wavelength)[:, outside].sum(axis=1)
    every = white_rates(camera, whole)
    shares = given / np.where(every > 0, every, np.inf)
    channel = int(shares.argmax())
    return float(shares[channel]), camera.channels[channel]


def span_of(camera: Sees) -> str:
    """Return the wavelength range of a camera as text."""
    return f"{camera.wavelength[0]:g}…{camera.wavelength[-1]:g} nm"


def recorded_under(text: str, measured: Mapping[str, Curve], seen: Array) -> Light:
    """Return the illuminant under which a scene was recorded.

    This does the same as `make_light`, except that a single measured illuminant keeps its own wavelength grid. The scene
    often has the same bands.
    """
    return make_light(text, measured, measured[text][0] if text in measured else seen)


def check_measured(curve: Curve, name: str) -> None:
    """Check the spectrum of a measured illuminant.

    Raises
    ------
    InputFileError
        If the spectrum has gaps, is more negative than noise explains, or ends at a visible wavelength with high power.
    """
    wavelength, power = curve[0], curve[1][0]
    if len(curve[1]) != 1:
        raise InputFileError(f"{name} contains {len(curve[1])} curves; give wavelength and power of one light")
    if power.max() <= 0:
        raise InputFileError(f"{name} is zero at all wavelengths; give the power of the light at each wavelength")
    missing = gaps(wavelength, curve[1], WIDEST_GAP)
    if wavelength.size < 2 or missing:
        where = " between {:g} and {:g} nm".format(*missing[0]) if missing else ""
        raise InputFileError(
            f"{name} has a gap{where}; sample the spectrum at least every {WIDEST_GAP:g} nm where it has power"
        )
    if power.min() < 0:
        raise InputFileError(
            f"{name} is negative at {wavelength[power.argmin()]:g} nm by more than {NOISE:.0%} of its peak; subtract the "
            "dark spectrum again, and give the power at each wavelength"
        )
    for end, visible in ((0, wavelength[0] > 420), (-1, wavelength[-1] < 680)):
        if visible and power[end] > INCOMPLETE_FRACTION * power.max():
            raise InputFileError(
                f"{name} ends at {wavelength[end]:g} nm, where the light still has power; measure 400–700 nm"
            )


def read_curve(path: Path, role: str) -> Curve:
    """Read a file of spectra that a scene recipe names.

    Parameters
    ----------
    path : Path
        The file.
    role : {"light", "transmittance", "functions"}
        Use of the file in the recipe.

    Returns
    -------
    wavelength : ndarray, (sample)
        Wavelengths in nm.
    values : ndarray, (curve, sample)
        Power of one illuminant, transmittance of one filter (0 to 1), or matching functions.

    Raises
    ------
    InputFileError
        If the contents of the file do not fit its role.
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
    """Return the illuminant under which a scene was recorded, scaled to a luminance in cd/m².

    Its spectrum is known only at the wavelengths of the scene.

    Raises
    ------
    RecipeError
        If the scene has no illuminant of its own, or its illuminant is invisible.
    """
    if scene.illuminant is NO_ILLUMINANT or spectra.xyz_weights(scene.wavelength)[1] @ scene.illuminant <= 0:
        raise RecipeError(f'scene {scene.name} has no visible light of its own; leave "{SCENE_LIGHT}" out of illuminants')
    radiance = spectra.at_luminance(scene.illuminant, scene.wavelength, luminance)
    return Light(SCENE_LIGHT, luminance, scene.wavelength, radiance, _digest(scene.wavelength, scene.illuminant))


def _digest(*arrays: Array) -> str:
    return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()


def electron_weights(camera: Sees, light: Light, bands: Array) -> Array:
    """Return the photo-electrons per second that each band contributes to each channel.

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
    ndarray, (channel, band)
        Photo-electrons in e-/s for a reflectance of 1 in the band.

    Notes
    -----
    The responsivity is interpolated linearly, so each of its samples weights the illuminant with a triangle around its
    wavelength.
    """
    seen = camera.electron_weights @ spectra.sampling_matrix(light.wavelength, camera.wavelength)
    return (seen * light.radiance) @ spectra.held_interpolation(bands, light.wavelength)


def photon_weights(camera: CameraModel, light: Light, bands: Array) -> Array:
    """Return the photons per second that each band contributes to a pixel, at each sample of the camera's wavelength grid.

    `electron_weights` equals the product of the responsivities and these values.

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
    """Return the contribution of each band to the outputs of matching functions.

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


def white_rates(camera: Sees, light: Light) -> Array:
    """Return the photo-electrons per second (channel) that a pixel collects from a perfect white."""
    return electron_weights(camera, light, light.wavelength).sum(axis=1)


def colour_matrix(camera: CameraModel, light: Light) -> Array:
    """Fit the matrix that converts XYZ to camera channels for surfaces under an illuminant.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    light : Light
        The illuminant.

    Returns
    -------
    ndarray, (channel, 3)
        Matrix M with channels = M @ XYZ. White has Y = 1, and 1 in its brightest channel. The matrix is fitted to measured
        reflectances by least squares. It is exact for white, because raw converters derive the white balance from it.
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
    """Return the signal (channel) of a grey surface under `light`, relative to the brightest channel."""
    rates = white_rates(camera, light)
    return rates / rates.max()


def automatic_exposure(camera: CameraModel, light: Light, share: float) -> float:
    """Return the exposure time, in s, at which a white fills its brightest channel to the fraction `share` of full scale."""
    return float(share * camera.full_scale / (white_rates(camera, light) * camera.channel_gains).max())


def uncovered_share(camera: CameraModel, bands: Array) -> float:
    """Return the fraction of a channel's electrons that comes from wavelengths outside the bands of a scene.

    It is computed for a white under an equal-photon illuminant. The result is for the channel in which it is largest.
    """
    weights = camera.electron_weights
    outside = (camera.wavelength < bands[0]) | (camera.wavelength > bands[-1])
    every = weights.sum(axis=1)
    return float((weights[:, outside].sum(axis=1) / np.where(every > 0, every, 1.0)).max())


@dataclass(frozen=True)
class Target:
    """The outputs that a table should compute, and the illuminant to which they refer."""

    outputs: tuple[str, ...]
    description: str
    kind: str  # a key of OUTPUTS, CAMERA, or the name of a file of matching functions
    functions: Curve | None = None  # matching functions from the file: wavelength in nm, (output, wavelength) per watt
    light: Light | None = None  # None means the illuminant of the frame


XYZ = Target(OUTPUTS["CIE 1931"], "CIE 1931 XYZ of the scene under its own light, without lens or noise", "CIE 1931")


def make_target(
    kind: str, functions: Curve | None, names: tuple[str, ...], light: Light | None, camera: CameraModel
) -> Target:
    """Make the target of a recipe.

    Parameters
    ----------
    kind : str
        A key of OUTPUTS, CAMERA, or the name of a file of matching functions.
    functions : Curve or None
        Matching functions from the file.
    names : tuple of str
        Names of the outputs, if a file defines them.
    light : Light or None
        Illuminant to which the outputs refer. None means the illuminant of each frame.
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
        "radiance 31": "radiance at 400…700 nm by 10 nm (cd/m² of a light of equal power as strong at all wavelengths)",
        CAMERA: "all bands of the camera (cd/m² of D65 that would saturate its brightest channel as fast)",
    }.get(kind, f"the matching functions of {kind}")
    under = f"under {light.name}" if light else "under its own light"
    return Target(outputs, f"{what} of the scene {under}, without lens or noise", kind, functions, light)


def output_weights(target: Target, camera: CameraModel, light: Light, bands: Array) -> Array:
    """Return the contribution of each band to the target outputs.

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
        Outputs for a reflectance of 1 in the band, in cd/m². If the outputs are the camera's bands, they are the fraction of
        full scale per second, times the camera's saturation exposure.
    """
    if target.light:
        light = target.light.at(light.luminance)
    if target.kind == CAMERA:
        weights = electron_weights(camera, light, bands) * (camera.saturation_exposure / camera.full_scale)
        return weights if camera.readout is None else weights * camera.channel_gains[:, None]
    if target.kind == UNLIT:
        return light.luminance * spectra.held_interpolation(bands, spectra.SAMPLED)
    if target.functions:
        grid, values = target.functions
        functions: Array = spectra.average(values, grid, light.wavelength)
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


LEAST_SEEN = 0.1  # the bands of a scene must contain at least this fraction of a target's spectral weight


def require_seen(bands: Array, target: Target, camera: CameraModel) -> None:
    """Check that the bands of a scene cover the wavelengths that a target needs.

    The required wavelengths are those of luminance for a colour target, and 400 to 700 nm for a spectral target. If the
    outputs are the camera's bands or come from a file, it is enough to cover one channel or function.

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
        If the bands contain less than a tenth of the target's spectral weight.
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
            f"its bands of {bands[0]:g}…{bands[-1]:g} nm cover only {seen.max():.1%} of the target "
            f"({', '.join(target.outputs[:3])}); check the unit of its wavelengths, or leave the scene out"
        )


def column_names(path: Path) -> tuple[str, ...]:
    """Return the column names of a file of matching functions. Columns without names get numbers."""
    table = read_table(path)
    unnamed = tuple(f"output {number}" for number in range(1, len(table.values) + 1))
    names = table.names or ()
    named = len(set(names)) == len(names) and not any(re.fullmatch(r"[-+.\deE]*", name) for name in names)
    return names if names and named else unnamed
