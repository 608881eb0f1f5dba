"""The scene recipe, which lists the scenes, illuminants, luminances and exposures to simulate, in all combinations."""

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import msgspec
import numpy as np

from l3cli.artifacts.camera import CameraModel, Optics
from l3cli.artifacts.recipe_source import RecipeSource
from l3cli.errors import RecipeError, suggestion
from l3cli.physics import spectra
from l3cli.physics.stokes import has_stokes
from l3cli.recipes.faults import Fault, fault, inside
from l3cli.recipes.toml import CountOrNone, KeyPath, NotNegative, Positive, Recipe
from l3cli.simulation import sources
from l3cli.simulation.light import CAMERA, OUTPUTS, SCENE_LIGHT, UNLIT, Curve, mixture, read_curve
from l3cli.simulation.sensor import noise_plugin, with_analog_gain
from l3cli.spectra.file import SUFFIXES, names_file

Several = Annotated[list[Positive], msgspec.Meta(min_length=1)]
EXPOSURES = {"exposure_share": "share", "exposure_saturated": "saturated", "exposure_mean": "mean", "exposure_s": "seconds"}


class Lens(Recipe):
    """Lens effects to simulate, and settings that replace those of the camera's lens (docs/method.md#optics)."""

    diffraction: bool = True
    off_axis: bool = False  # whether to simulate vignetting, which tables cannot correct
    defocus_um: NotNegative = 0.0  # standard deviation of a Gaussian blur on the sensor
    # Transmittance as a number or as the name of a CSV file. It multiplies the responsivities of the camera.
    transmittance: Annotated[float, msgspec.Meta(gt=0, le=1)] | str | None = None
    focal_length_mm: Positive | None = None
    f_number: Positive | None = None
    magnification: NotNegative | None = None  # |image size / object size|; 0 for an object at infinity


class SensorSetting(Recipe):
    """Noise and gain of the sensor."""

    # "shot": only the shot noise of light and dark current. "none": only quantisation.
    noise: Literal["all", "shot", "none"] = "all"
    noise_model: str | None = None  # name of a noise model from an installed package (docs/python.md#a-noise-model)
    analog_gain: Annotated[float, msgspec.Meta(ge=1e-3, le=1e3)] = 1.0  # multiplies the gain of the camera


class TargetRecipe(Recipe):
    """The target: the outputs that a table should compute from raw frames."""

    # "CIE 1931", "CIE 1964", "luminance", "CIE 1931 + IR", "reflectance 31" or "radiance 31" (both at 400…700 nm), "Stokes"
    # or "CIE 1931 + Stokes" (docs/polarisation.md), "camera" (the bands of the camera), or the name of a CSV file of
    # matching functions.
    outputs: str = "CIE 1931"
    illuminant: str | None = None  # illuminant of the target, for illuminant correction; default: the frame's illuminant


class Pair(Recipe):
    """A raw file and the picture that a table should compute from it, registered pixel by pixel."""

    raw: str  # path relative to the recipe
    picture: str  # encoded sRGB, or an EXR file whose channels have the names of the target outputs
    offset: tuple[CountOrNone, CountOrNone] = (0, 0)  # row and column of the picture's first pixel in the raw frame
    phase: tuple[int, int] | None = None  # row and column of the CFA at the first raw pixel; default: read from the file
    # Raw signal of a surface, as a fraction of full scale, divided by its value in the picture. Default: fitted.
    scale: Positive | None = None


class SceneRecipe(Recipe):
    """A complete scene recipe."""

    title: ClassVar[str] = "a scene recipe"

    scene: list[sources.Source] = msgspec.field(default_factory=list)
    pair: list[Pair] = msgspec.field(default_factory=list)
    # CIE names, "3200K", "D6000K", files of spectra, mixtures such as "0.7 D65 + 0.3 lamp.csv", or "scene" for the
    # illuminant that is stored with a scene
    illuminants: Annotated[list[str], msgspec.Meta(min_length=1)] = msgspec.field(default_factory=lambda: ["D65"])
    luminances_cd_m2: Several | None = None  # luminances of a perfect white; default: 100
    lux: Several | None = None  # illuminances, as an alternative to luminances_cd_m2; π times the luminance of white
    # Automatic exposure: fraction of full scale that a perfect white reaches in the brightest channel.
    exposure_share: Several | None = None
    # Automatic exposure: fraction of the pixels that reach full scale.
    exposure_saturated: Annotated[list[Annotated[float, msgspec.Meta(gt=0, lt=1)]], msgspec.Meta(min_length=1)] | None = None
    # Automatic exposure: mean of the mosaic before clipping, as a fraction of full scale.
    exposure_mean: Several | None = None
    exposure_s: Several | None = None  # fixed exposure time
    lens: Lens = msgspec.field(default_factory=Lens)
    sensor: SensorSetting = msgspec.field(default_factory=SensorSetting)
    target: TargetRecipe = msgspec.field(default_factory=TargetRecipe)

    def luminances(self) -> list[float]:
        """Return the luminances of a perfect white, in cd/m²."""
        if self.lux is not None:
            return [each / np.pi for each in self.lux]
        return self.luminances_cd_m2 or [100.0]

    def exposures(self) -> tuple[str, list[float]]:
        """Return the type of exposure, which is a value of EXPOSURES, and the settings in the recipe.

        Raises
        ------
        RecipeError
            If the recipe does not contain exactly one of the keys of EXPOSURES.
        """
        given = {kind: values for key, kind in EXPOSURES.items() if (values := getattr(self, key)) is not None}
        if len(given) != 1:
            found = " and ".join(key for key in EXPOSURES if getattr(self, key) is not None)
            what = f"the keys {found} exclude each other" if given else "the recipe contains no exposure"
            automatic = "exposure_share, exposure_saturated, exposure_mean (automatic)"
            raise RecipeError(f"{what}; set exactly one of {automatic} and exposure_s (fixed)")
        return next(iter(given.items()))


def recorded_lights(recipe: SceneRecipe) -> list[str]:
    """Return the illuminants under which the recipe's scene files were recorded."""
    return [
        source.light for source in recipe.scene if isinstance(source, sources.Spectral | sources.IsetScenes) and source.light
    ]


def curve_files(recipe: SceneRecipe) -> dict[str, str]:
    """Return the role of each file of spectra in a recipe: "light", "transmittance" or "functions"."""
    lights = [*recipe.illuminants, *filter(None, [recipe.target.illuminant])]
    lights += recorded_lights(recipe)
    curves = {name: "light" for text in lights for _, name in mixture(text) if names_file(name)}
    if isinstance(recipe.lens.transmittance, str):
        curves[recipe.lens.transmittance] = "transmittance"
    if names_file(recipe.target.outputs):
        curves[recipe.target.outputs] = "functions"
    return curves


def set_up(camera: CameraModel, recipe: SceneRecipe, curves: Mapping[str, Curve]) -> CameraModel:
    """Apply the lens and the analog gain of a recipe to a camera.

    Parameters
    ----------
    camera : CameraModel
        The calibrated camera.
    recipe : SceneRecipe
        The recipe.
    curves : mapping of str to Curve
        Content of each file of spectra.

    Returns
    -------
    CameraModel
        The camera to simulate, which is also stored in the training set.

    Raises
    ------
    RecipeError
        If the lens settings are physically impossible.
    """
    lens, optics = recipe.lens, camera.optics
    focal = optics.focal_length if lens.focal_length_mm is None else lens.focal_length_mm * 1e-3
    f_number = optics.f_number if lens.f_number is None else lens.f_number
    distance = optics.object_distance
    if lens.magnification is not None:
        distance = focal * (1.0 + 1.0 / lens.magnification) if lens.magnification > 0 else 0.0
    if 0 < distance <= focal:
        raise RecipeError("lens: the object is closer than the focal length; set a smaller focal_length_mm")
    if isinstance(lens.transmittance, str):
        grid, values = curves[lens.transmittance]
        passed = spectra.average(values[0], grid, camera.wavelength)
    else:
        passed = np.full(camera.wavelength.size, 1.0 if lens.transmittance is None else lens.transmittance)
    if not (passed.min() >= 0 and 0 < passed.max() <= 1):
        raise RecipeError(
            f"lens.transmittance contains values from {passed.min():g} to {passed.max():g}; use values between 0 and 1 that "
            "are not all 0"
        )
    fitted = replace(camera, responsivity=camera.responsivity * passed, optics=Optics(focal, f_number, distance))
    return with_analog_gain(fitted, recipe.sensor.analog_gain)


def scene_faults(recipe: SceneRecipe, camera: CameraModel | None) -> Iterator[Fault]:
    """Find the faults in a scene recipe, including conflicts with `camera` if it is known."""
    if not (recipe.scene or recipe.pair):
        yield fault("the recipe contains no scenes; add [[scene]] or [[pair]]", "scene", "pair")
    if recipe.luminances_cd_m2 is not None and recipe.lux is not None:
        yield fault("luminances_cd_m2 and lux exclude each other; remove one of them", "lux", "luminances_cd_m2")
    if recipe.scene:
        yield from _exposure_faults(recipe, camera)
    for number, source in enumerate(recipe.scene):
        name, key = f"scene {number + 1}", ("scene", number)
        yield from inside(sources.source_faults(source, camera, name), *key)
        if SCENE_LIGHT in recipe.illuminants and not sources.has_light(source):
            message = f'{name} has no illuminant of its own; remove "{SCENE_LIGHT}" from illuminants'
            yield fault(message, "illuminants", key)
        if recipe.illuminants != [SCENE_LIGHT] and not sources.can_be_relit(source):
            message = f'{name} contains radiance under an unknown illuminant; set light, or illuminants = ["{SCENE_LIGHT}"]'
            yield fault(message, (*key, "light"), "illuminants")
        elif recipe.target.outputs == UNLIT and not sources.can_be_relit(source):
            message = f"{name} contains radiance under an unknown illuminant, so its reflectances are unknown; set light"
            yield fault(message, (*key, "light"), "target.outputs")
    if recipe.sensor.noise_model is not None:
        yield from _noise_faults(recipe.sensor, recipe.sensor.noise_model)
    outputs = recipe.target.outputs
    if any(map(sources.holds_codes, recipe.scene)) and (outputs != CAMERA or recipe.target.illuminant is not None):
        message = (
            f'a scene with holds = "codes" has no spectra; set target.outputs = "{CAMERA}", and remove target.illuminant'
        )
        yield fault(message, "target.outputs", "target.illuminant")
    if outputs not in (*OUTPUTS, CAMERA) and not names_file(outputs):
        known = suggestion(outputs, (*OUTPUTS, CAMERA))
        yield fault(f'target.outputs "{outputs}" is unknown; {known} (or a file of spectra)', "target.outputs")
    if has_stokes(OUTPUTS.get(outputs, ())) and camera is not None and camera.polarisers is None:
        message = (
            f'target.outputs "{outputs}" needs a camera with polarisers, which {camera.name} does not have; set other '
            "outputs, or add polarisers to the camera recipe (polariser_deg)"
        )
        yield fault(message, "target.outputs")
    if outputs == UNLIT and recipe.target.illuminant is not None:
        message = f'target.outputs "{UNLIT}" does not depend on the illuminant; remove target.illuminant'
        yield fault(message, "target.illuminant")
    if recipe.target.illuminant == SCENE_LIGHT:
        message = f'target.illuminant cannot be "{SCENE_LIGHT}"; remove target.illuminant, or set the name of an illuminant'
        yield fault(message, "target.illuminant")
    if recipe.pair and outputs == CAMERA:
        message = f'target.outputs "{CAMERA}" cannot be used with [[pair]], whose target is a picture; set other outputs'
        yield fault(message, "target.outputs", "pair")


def _noise_faults(setting: SensorSetting, model: str) -> Iterator[Fault]:
    if setting.noise != "all":
        yield fault(
            f'sensor.noise "{setting.noise}" has no effect with sensor.noise_model; remove one of these keys',
            "sensor.noise",
        )
    try:
        noise_plugin(model)
    except RecipeError as error:
        yield fault(str(error), "sensor.noise_model")


def _exposure_faults(recipe: SceneRecipe, camera: CameraModel | None) -> Iterator[Fault]:
    try:
        unit, _ = recipe.exposures()
    except RecipeError as error:
        given = [key for key in EXPOSURES if getattr(recipe, key) is not None]
        yield fault(str(error), *given, *(key for key in EXPOSURES if key not in given))
        return
    if unit == "seconds" and camera is not None and not camera.absolute:
        message = f"exposure_s needs absolute responsivities, which {camera.name} does not have; use exposure_share"
        yield fault(message, "exposure_s")


@dataclass(frozen=True)
class Shot:
    """Illuminant, luminance and exposure of one frame."""

    index: int  # index of the frame in the training set
    illuminant: str
    luminance: float  # cd/m²
    # exposure time in s, or target fraction of an automatic exposure, depending on `SceneRecipe.exposures`
    exposure: float
    moment: int = 0  # index of the frame in its clip


def shots(recipe: SceneRecipe, files: list[list[Path]]) -> Iterator[tuple[sources.WantedScene, list[Shot]]]:
    """List the scenes of a recipe, each with its frames, which are numbered consecutively over the whole recipe.

    Parameters
    ----------
    recipe : SceneRecipe
        The recipe.
    files : list of list of Path
        Files of each source. The list is empty for a source without files.

    Yields
    ------
    scene : WantedScene
    frames : list of Shot
    """
    index = itertools.count()
    for source, paths in zip(recipe.scene, files, strict=True):
        for scene in sources.wanted_scenes(source, paths):
            moments = range(source.motion.frames if source.motion else 1)
            settings = itertools.product(recipe.illuminants, recipe.luminances(), recipe.exposures()[1], moments)
            yield scene, [Shot(next(index), *setting) for setting in settings]


def curve_faults(recipe: SceneRecipe, source: RecipeSource) -> Iterator[Fault]:
    """Find unknown illuminants and unusable files of spectra in a scene recipe."""
    lens, target = recipe.lens, recipe.target
    for text, key in _lights(recipe):
        yield from _light_faults(text, key, source)
    if isinstance(lens.transmittance, str):
        yield from source.attempt(("lens", "transmittance"), read_curve, source.file(lens.transmittance), "transmittance")
    if names_file(target.outputs):
        yield from source.attempt(("target", "outputs"), read_curve, source.file(target.outputs), "functions")


def _lights(recipe: SceneRecipe) -> Iterator[tuple[str, KeyPath]]:
    """List the illuminants in a recipe, each with its key."""
    yield from ((text, ("illuminants", number)) for number, text in enumerate(recipe.illuminants))
    if recipe.target.illuminant is not None:
        yield recipe.target.illuminant, ("target", "illuminant")
    for number, scene in enumerate(recipe.scene):
        if text := getattr(scene, "light", None):
            yield text, ("scene", number, "light")


def _light_faults(text: str, key: KeyPath, source: RecipeSource) -> Iterator[Fault]:
    if text == SCENE_LIGHT:
        return
    wrong = list(source.attempt(key, mixture, text))
    yield from wrong
    for _, name in [] if wrong else mixture(text):
        if names_file(name):
            yield from source.attempt(key, read_curve, source.file(name), "light")
        else:
            yield from source.attempt(key, _require_named, name, source.file(name))


def _require_named(name: str, path: Path) -> None:
    """Raise RecipeError if `name` is not a known illuminant."""
    if path.is_file():
        raise RecipeError(f"{path} has an unsupported suffix for a file of spectra; use one of {' '.join(SUFFIXES)}")
    spectra.require_illuminant(name)
