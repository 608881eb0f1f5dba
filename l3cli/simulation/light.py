"""The light on a scene, what a camera makes of it in each band, and what is wanted of it (docs/method.md#simulation)."""

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
from l3cli.errors import InputFileError, RecipeError
from l3cli.frames.scene import NO_ILLUMINANT, Scene
from l3cli.physics import spectra
from l3cli.physics.display import fit_through
from l3cli.spectra.file import names_file, read_table
from l3cli.spectra.table import NOISE, gaps

Array = NDArray[np.floating]
Curve = tuple[Array, Array]  # wavelength (sample) nm, values (curve, sample)

SCENE_LIGHT = "scene"  # the name of the light that a scene was measured under
WIDEST_GAP = 20.0  # nm between samples of a measured light
DARK = 0.01  # of a measured light's peak: a light that ends brighter was cut off

OUTPUTS = {
    "CIE 1931": ("X", "Y", "Z"),
    "CIE 1964": ("X10", "Y10", "Z10"),
    "luminance": ("Y",),
    "CIE 1931 + IR": ("X", "Y", "Z", "IR"),
    "reflectance 31": spectra.REFLECTANCES,
    "radiance 31": spectra.RADIANCES,
}
UNLIT = "reflectance 31"  # the same under every light
NOTICEABLE = 0.01  # share of a channel's electrons from wavelengths at which a light or surfaces are not known
CAMERA = "camera"  # the camera's own bands at full resolution


@dataclass(frozen=True)
class Light:
    """Radiance of a perfect white on the grid where light and reflectance are multiplied."""

    name: str
    luminance: float  # cd/m² of a perfect white
    wavelength: Array  # (sample) nm
    radiance: Array  # (sample) photons/s/sr/m²/nm
    measured: str = ""  # digest of the spectra it is made of, beside those that its name says

    def at(self, luminance: float) -> "Light":
        """Return the same light at another luminance."""
        return replace(self, luminance=luminance, radiance=self.radiance * (luminance / self.luminance))

    @property
    def spectrum(self) -> LightSpectrum:
        """Return the light as a training set stores it."""
        return LightSpectrum(self.wavelength.astype(np.float64), (self.radiance / self.luminance).astype(np.float32))


def mixture(text: str) -> list[tuple[float, str]]:
    """Return a recipe's light "0.7 D65 + 0.3 lamp.csv" as shares of luminance and names; RecipeError if not above 0."""
    weighted_parts = []
    for term in re.split(r"\s+\+\s+", text.strip()):
        weighted = re.fullmatch(r"(\d*\.?\d+)\s+(?!K$)(.+)", term)
        weighted_parts.append((float(weighted[1]), weighted[2]) if weighted else (1.0, term))
    if min(share for share, _ in weighted_parts) <= 0:
        raise RecipeError(f'illuminant "{text}": shares must be above zero')
    return weighted_parts


def make_light(text: str, measured: Mapping[str, Curve], seen: Array) -> Light:
    """Return the light a recipe calls `text`, at 1 cd/m²: a name that spectra.illuminant knows, a measured light (a key of
    `measured`, power per nm), or a mixture of several by their shares of luminance.

    It is tabulated every nm over what the observer and a camera with wavelengths `seen` see; what a measured light holds
    in between goes to the two nanometres about it, so that no spectral line is lost. A light measured on the camera's own
    grid stays on it: all sums then run over that grid, as in ISETCam.
    RecipeError if a name is unknown or the light cannot be seen.
    """
    names = mixture(text)
    wavelength = spectra.light_grid(seen)
    if all(name in measured and np.array_equal(measured[name][0], seen) for _, name in names):
        wavelength = np.asarray(seen)
    radiance = np.zeros(wavelength.size)
    with np.errstate(all="ignore"):  # a black body of a few kelvin shines with 0
        for share, name in names:
            if name in measured:
                grid, power = measured[name]
                one = spectra.photons_from_energy(wavelength, spectra.resample(power[0], grid, wavelength))
            else:
                one = spectra.illuminant(name, wavelength)
            radiance += share * spectra.at_luminance(one, wavelength, 1.0)
    if not (np.isfinite(radiance).all() and radiance.any()):
        raise RecipeError(f'illuminant "{text}" gives no light that can be seen')
    digest = _digest(*itertools.chain(*(measured[name] for _, name in names if name in measured)))
    return Light(text, 1.0, wavelength, radiance / sum(share for share, _ in names), digest)


class Sees(Protocol):
    """What collects electrons of a light: a camera, or filters on a pixel."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels or filters."""

    @property
    def wavelength(self) -> NDArray[np.float64]:
        """Wavelengths (wavelength) in nm."""

    @property
    def electron_weights(self) -> NDArray[np.float64]:
        """Electrons (channel, wavelength) of unit radiance in photons, of any scale."""


class Filters(NamedTuple):
    """Filters on a pixel, as `Sees` has them."""

    channels: tuple[str, ...]
    wavelength: NDArray[np.float64]
    electron_weights: NDArray[np.float64]

    @classmethod
    def of(cls, curves: Mapping[str, Array], wavelength: Array) -> "Filters":
        """Return the filters of these quantum efficiencies (wavelength), by name."""
        return cls(tuple(curves), np.asarray(wavelength), np.array(list(curves.values())) * spectra.bin_widths(wavelength))


def named_beyond_known(names: Iterable[str], camera: Sees) -> list[str]:
    """Return a warning for each light that `beyond_known` warns of, of those that have a name.

    Measured lights and the light of a scene are left out: their spectra are not at hand where only names are.
    """
    named = [
        name
        for name in dict.fromkeys(names)
        if name != SCENE_LIGHT and not any(names_file(part) for _, part in mixture(name))
    ]
    warnings = (beyond_known(make_light(name, {}, camera.wavelength), {}, camera) for name in named)
    return list(filter(None, warnings))


def beyond_known(light: Light, measured: Mapping[str, Curve], camera: Sees) -> str:
    """Say which light is not known at wavelengths that a channel collects a hundredth or more of its electrons at.

    A named light is held constant beyond its table. A measured light counts as dark there; what it would give if it went on
    as it ends is compared with what the channel collects.

    Returns
    -------
    str
        A warning; "" if no light needs one.
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
            what = "and counts as dark beyond; as bright as at its ends"
        else:
            ends, held = spectra.known_range(name), spectra.illuminant(name, light.wavelength)
            what = "and is held constant beyond"
        one = spectra.at_luminance(held, light.wavelength, light.luminance * share / total)
        taken, channel = share_beyond(camera, replace(light, radiance=one), light, ends)
        if taken > max(found[0], NOTICEABLE):
            where = f"{ends[0]:g}…{ends[1]:g} nm"
            text = f"light {name} is known at {where} {what}, where channel {channel} collects {taken:.0%} of its electrons"
            found = taken, f"{text}; give a light that is measured at {span_of(camera)}"
    return found[1]


def lens_beyond_known(name: str, transmittance: Curve, light: Light, camera: CameraModel) -> str:
    """Return a warning if a lens of a measured transmittance, which passes nothing beyond it, would let a channel collect a
    hundredth or more of its electrons there if it went on as it ends; else "". `camera` is that without the lens."""
    grid, held = transmittance[0], _held(transmittance, camera.wavelength)[0]
    passing = Filters(camera.channels, camera.wavelength, camera.electron_weights * held)
    taken, channel = share_beyond(passing, light, light, (grid.min(), grid.max()))
    return _file_ends(name, grid, f"channel {channel} would collect {taken:.0%} of its electrons", taken, span_of(camera))


def functions_beyond_known(name: str, functions: Curve, names: Sequence[str], light: Light) -> str:
    """Return a warning if an output of measured matching functions, which are zero beyond them, would have a hundredth or
    more of its value for a white from there if they went on as they end; else ""."""
    grid, wavelength = functions[0], light.wavelength
    weights = np.abs(spectra.matching_weights(_held(functions, wavelength), wavelength) * light.radiance)
    outside = (wavelength < grid.min()) | (wavelength > grid.max())
    every = weights.sum(axis=1)
    shares = weights[:, outside].sum(axis=1) / np.where(every > 0, every, np.inf)
    output, taken = int(shares.argmax()), float(shares.max())
    wanted = f"{wavelength[0]:g}…{wavelength[-1]:g} nm"
    return _file_ends(name, grid, f"output {names[output]} would have {taken:.0%} of its value for a white", taken, wanted)


def curves_beyond_known(recipe: Path, light: Light, camera: CameraModel) -> str:
    """Return a warning if the responsivities of a camera recipe come from a file that ends within the recipe's wavelengths,
    where a channel would collect a hundredth or more of its electrons if its curve went on as it ends; else "".

    The model of the camera has zeros there.
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
    """Return warnings of what is not known of a camera of that file, and of the light it is used under, where its channels
    collect electrons: one for each named light, and one for the file of curves of a recipe."""
    ends = (curves_beyond_known(path, make_light(name, {}, camera.wavelength), camera) for name in lights)
    return [*named_beyond_known(lights, camera), *itertools.islice(filter(None, ends), 1)]


def _held(curves: Curve, wavelength: Array) -> Array:
    """Return curves (curve, wavelength) that go on as they end."""
    order = np.argsort(curves[0])
    return np.array([np.interp(wavelength, curves[0][order], each[order]) for each in curves[1]])


def _file_ends(name: str, grid: Array, there: str, taken: float, wanted: str) -> str:
    """Return the warning on a file of curves; "" if the share `taken` is not noticeable."""
    if taken <= NOTICEABLE:
        return ""
    known = f"{name} is known at {grid.min():g}…{grid.max():g} nm and counts as zero beyond"
    return f"{known}; if it went on as it ends, {there} there; give values at {wanted}"


def surfaces_beyond_known(light: Light, camera: CameraModel) -> str:
    """Return a warning if a channel collects a hundredth or more of its electrons where measured surfaces are held constant,
    else ""."""
    taken, channel = share_beyond(camera, light, light, spectra.SURFACES_MEASURED)
    if taken <= NOTICEABLE:
        return ""
    first, last = spectra.SURFACES_MEASURED
    return (
        f"surfaces of the scenes are measured at {first:g}…{last:g} nm and held constant beyond, where channel {channel} "
        f"collects {taken:.0%} of its electrons under {light.name}; give scenes that are measured at {span_of(camera)}"
    )


def share_beyond(camera: Sees, part: Light, whole: Light, ends: tuple[float, float]) -> tuple[float, str]:
    """Return the largest share of a channel's electrons from white under a light, that a part of it gives beyond two
    wavelengths in nm, and the channel."""
    outside = (part.wavelength < ends[0]) | (part.wavelength > ends[1])
    given = electron_weights(camera, part, part.wavelength)[:, outside].sum(axis=1)
    every = white_rates(camera, whole)
    shares = given / np.where(every > 0, every, np.inf)
    channel = int(shares.argmax())
    return float(shares[channel]), camera.channels[channel]


def span_of(camera: Sees) -> str:
    """Return the wavelengths that a camera sees."""
    return f"{camera.wavelength[0]:g}…{camera.wavelength[-1]:g} nm"


def recorded_under(text: str, measured: Mapping[str, Curve], seen: Array) -> Light:
    """Make a light as make_light does, for the light that a scene was recorded under: one measured light stays on its own
    grid, for the bands of the scene are often the same."""
    return make_light(text, measured, measured[text][0] if text in measured else seen)


def check_measured(curve: Curve, name: str) -> None:
    """Raise InputFileError if a measured light has gaps, is negative by more than noise, or ends while it still shines in
    the visible."""
    wavelength, power = curve[0], curve[1][0]
    if len(curve[1]) != 1:
        raise InputFileError(f"{name} holds {len(curve[1])} curves; give wavelength and power of one light")
    if power.max() <= 0:
        raise InputFileError(f"{name} holds no light at all; give its power at each wavelength")
    missing = gaps(wavelength, curve[1], WIDEST_GAP)
    if wavelength.size < 2 or missing:
        where = " between {:g} and {:g} nm".format(*missing[0]) if missing else ""
        raise InputFileError(f"{name} has a gap{where}; measure the light at least every {WIDEST_GAP:g} nm where it shines")
    if power.min() < 0:
        raise InputFileError(
            f"{name} is negative at {wavelength[power.argmin()]:g} nm by more than {NOISE:.0%} of its peak; subtract the "
            "dark spectrum again, and give the power at each wavelength"
        )
    for end, visible in ((0, wavelength[0] > 420), (-1, wavelength[-1] < 680)):
        if visible and power[end] > DARK * power.max():
            raise InputFileError(f"{name} ends at {wavelength[end]:g} nm where the light still shines; measure 400–700 nm")


def read_curve(path: Path, role: str) -> Curve:
    """Read a file of spectra that a scene recipe names.

    Parameters
    ----------
    path : Path
        The file.
    role : {"light", "transmittance", "functions"}
        What the recipe names it for.

    Returns
    -------
    wavelength : ndarray, (sample)
        In nm.
    values : ndarray, (curve, sample)
        Power of one light; transmittance, 0 to 1, of one filter; or matching functions.

    Raises
    ------
    InputFileError
        If the file does not hold this.
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
    """Return the light the scene came with, at another luminance; nothing is known of it outside the scene's wavelengths.

    RecipeError if it has no light of its own, or none that an eye can see.
    """
    if scene.illuminant is NO_ILLUMINANT or spectra.xyz_weights(scene.wavelength)[1] @ scene.illuminant <= 0:
        raise RecipeError(f'scene {scene.name} has no visible light of its own; leave "{SCENE_LIGHT}" out of illuminants')
    radiance = spectra.at_luminance(scene.illuminant, scene.wavelength, luminance)
    return Light(SCENE_LIGHT, luminance, scene.wavelength, radiance, _digest(scene.wavelength, scene.illuminant))


def _digest(*arrays: Array) -> str:
    return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()


def electron_weights(camera: Sees, light: Light, bands: Array) -> Array:
    """Return the photo-electrons a second (channel, band) of unit reflectance in each band.

    The responsivity is taken as linear between its samples, so each sample sees the light's mean under its own hat.
    """
    seen = camera.electron_weights @ spectra.sampling_matrix(light.wavelength, camera.wavelength)
    return (seen * light.radiance) @ spectra.held_interpolation(bands, light.wavelength)


def photon_weights(camera: CameraModel, light: Light, bands: Array) -> Array:
    """Return the photons a second (wavelength, band) that a pixel gets in each step of the camera's grid, of unit
    reflectance in each band; `electron_weights` are responsivities times these."""
    photons = camera.optics.irradiance_per_radiance * camera.pixel_pitch**2 * spectra.bin_widths(camera.wavelength)
    seen = photons[:, None] * spectra.sampling_matrix(light.wavelength, camera.wavelength)
    return (seen * light.radiance) @ spectra.held_interpolation(bands, light.wavelength)


def matching_weights(functions: Array, light: Light, bands: Array) -> Array:
    """Return W (output, band) of unit reflectance in each band, for matching functions (output, light) per watt."""
    weights = spectra.matching_weights(functions, light.wavelength) * light.radiance
    return weights @ spectra.held_interpolation(bands, light.wavelength)


def white_rates(camera: Sees, light: Light) -> Array:
    """Return the photo-electrons a second (channel) of a perfect white."""
    return electron_weights(camera, light, light.wavelength).sum(axis=1)


def colour_matrix(camera: CameraModel, light: Light) -> Array:
    """Return M (channel, 3): channels = M @ XYZ of surfaces under `light`, whose white has Y = 1 and 1 in its brightest
    channel.

    Least squares over measured reflectances, with the white met exactly: developers find the white balance by it.
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
    """Return the channels (channel) of a grey surface under `light`, 1 in the brightest."""
    rates = white_rates(camera, light)
    return rates / rates.max()


def automatic_exposure(camera: CameraModel, light: Light, share: float) -> float:
    """Return the seconds until a perfect white fills its brightest channel to `share` of full scale."""
    return float(share * camera.full_scale / (white_rates(camera, light) * camera.channel_gains).max())


def uncovered_share(camera: CameraModel, bands: Array) -> float:
    """Return the share of a white of equal photons's electrons from outside the scene's bands, in the channel where it is
    largest."""
    weights = camera.electron_weights
    outside = (camera.wavelength < bands[0]) | (camera.wavelength > bands[-1])
    every = weights.sum(axis=1)
    return float((weights[:, outside].sum(axis=1) / np.where(every > 0, every, 1.0)).max())


@dataclass(frozen=True)
class Target:
    """The wanted outputs, and the light they are wanted under."""

    outputs: tuple[str, ...]
    description: str
    kind: str  # a key of OUTPUTS, CAMERA, or the name of a file of matching functions
    functions: Curve | None = None  # of the file: wavelength nm, (output, wavelength) per watt
    light: Light | None = None  # None: that of the frame


XYZ = Target(OUTPUTS["CIE 1931"], "CIE 1931 XYZ of the scene under its own light, without lens or noise", "CIE 1931")


def make_target(
    kind: str, functions: Curve | None, names: tuple[str, ...], light: Light | None, camera: CameraModel
) -> Target:
    """Return the target of a recipe: `kind` as in Target, with `functions` and their `names` if it is a file."""
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
    """Return W (output, band): outputs of unit reflectance in each band when `light` falls on the frame, in cd/m².

    The camera's bands come in the same unit: the share of full scale a second, times the camera's saturation exposure.
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


LEAST_SEEN = 0.1  # of the weight of what is wanted that lies within a scene's bands


def require_seen(bands: Array, target: Target, camera: CameraModel) -> None:
    """Raise ValueError if nearly all that a target wants of a scene lies beyond its `bands` (band) in nm: luminance for
    colours, 400…700 nm for spectra, every channel for a camera's bands, every function of a file."""
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
            f"its bands of {bands[0]:g}…{bands[-1]:g} nm hold {seen.max():.1%} of what is wanted of it "
            f"({', '.join(target.outputs[:3])}); check the unit of its wavelengths, or leave it out"
        )


def column_names(path: Path) -> tuple[str, ...]:
    """Return the names of the columns of a file of matching functions, or numbers where it has none."""
    table = read_table(path)
    unnamed = tuple(f"output {number}" for number in range(1, len(table.values) + 1))
    names = table.names or ()
    named = len(set(names)) == len(names) and not any(re.fullmatch(r"[-+.\deE]*", name) for name in names)
    return names if names and named else unnamed
