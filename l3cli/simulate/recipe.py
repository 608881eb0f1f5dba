"""SCENES.toml: what is simulated, under which light, how long exposed: frames = scenes × lights × luminances × exposures."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from l3cli import spectra
from l3cli.artifacts.camera import CameraModel
from l3cli.config import Recipe
from l3cli.errors import RecipeError
from l3cli.simulate.light import OWN

SMALLEST = 16  # pixels of a scene's shorter side


class DeadLeaves(Recipe, tag_field="source", tag="dead leaves"):
    size: tuple[int, int]  # rows, cols
    count: int = 1  # pictures
    seed: int = 0  # beside --seed: recipes with different seeds share no picture


class Composition(Recipe, tag_field="source", tag="composition"):
    size: tuple[int, int]
    count: int = 1
    seed: int = 0


class ColorChecker(Recipe, tag_field="source", tag="colorchecker"):
    size: tuple[int, int]


class IsetScenes(Recipe, tag_field="source", tag="iset"):
    file: str  # a name or a glob such as "faces/*.mat", relative to the recipe


class RgbPictures(Recipe, tag_field="source", tag="rgb"):
    file: str
    shrink: int = 1  # each shrink × shrink pixels are averaged to one, which also removes JPEG's and demosaicking's traces


Source = DeadLeaves | Composition | ColorChecker | IsetScenes | RgbPictures


class Lens(Recipe):
    """Which imperfections of the lens are simulated (METHOD 1.3)."""

    diffraction: bool = True
    off_axis: bool = False  # darker corners; a table does not know where in the frame it is applied


class SceneRecipe(Recipe):
    scene: list[Source]
    illuminants: list[str] = msgspec.field(default_factory=lambda: ["D65"])  # CIE names, "3200K", or "scene": its own
    luminances_cd_m2: list[float] = msgspec.field(default_factory=lambda: [100.0])  # of a perfect white
    exposure_share: list[float] | None = None  # automatic: share of full scale that white reaches in its brightest channel
    exposure_s: list[float] | None = None  # fixed
    lens: Lens = msgspec.field(default_factory=Lens)


def check(recipe: SceneRecipe, camera: CameraModel, name: str) -> None:
    """RecipeError if the recipe asks for what cannot be; `name` is the file that holds it."""
    if (recipe.exposure_share is None) == (recipe.exposure_s is None):
        raise RecipeError(f"{name}: give either exposure_share (automatic) or exposure_s (fixed)")
    exposures = recipe.exposure_share or recipe.exposure_s
    if not (recipe.scene and recipe.illuminants and recipe.luminances_cd_m2 and exposures):
        raise RecipeError(f"{name}: scene, illuminants, luminances_cd_m2 and the exposures must each have an entry")
    if not all(0 < value < float("inf") for value in (*recipe.luminances_cd_m2, *exposures)):
        raise RecipeError(f"{name}: luminances and exposures must be above zero")
    if recipe.exposure_s is not None and not camera.absolute:
        raise RecipeError(f"{name}: {camera.name} has only a relative responsivity; use exposure_share, not exposure_s")
    for illuminant in recipe.illuminants:
        _check_illuminant(illuminant, camera)
    for number, source in enumerate(recipe.scene, 1):
        _check_source(source, camera, f"{name}: scene {number}")
        if OWN in recipe.illuminants and not isinstance(source, IsetScenes):
            raise RecipeError(f'{name}: scene {number} has no light of its own; leave "{OWN}" out of illuminants')


def _check_illuminant(name: str, camera: CameraModel) -> None:
    if name != OWN:
        with np.errstate(all="ignore"):  # a black body of a few kelvin shines with 0
            if not np.isfinite(spectra.illuminant(name, camera.wavelength)).all():
                raise RecipeError(f'illuminant "{name}" gives no light that {camera.name} could see')


def _check_source(source: Source, camera: CameraModel, name: str) -> None:
    if isinstance(source, DeadLeaves | Composition | ColorChecker):
        check_size(source.size, camera, RecipeError, name)
    if isinstance(source, DeadLeaves | Composition) and (source.count < 1 or source.seed < 0):
        raise RecipeError(f"{name}: count is at least 1 and seed at least 0")
    if isinstance(source, RgbPictures) and source.shrink < 1:
        raise RecipeError(f"{name}: shrink is at least 1")


def check_size(size: tuple[int, ...], camera: CameraModel, error: type[Exception], name: str) -> None:
    """Raise `error` if a scene of `size` (rows, cols) is too small to learn from or does not fit the sensor."""
    rows, cols = size
    if min(size) < SMALLEST:
        raise error(f"{name} is {rows}×{cols}; a scene has at least {SMALLEST}×{SMALLEST} pixels")
    if rows > camera.rows or cols > camera.cols:
        raise error(f"{name} is {rows}×{cols}, larger than the sensor of {camera.rows}×{camera.cols}; make it smaller")


@dataclass(frozen=True)
class DrawnScene:
    """A built-in scene: what it shows, and what is beside --seed in its own."""

    kind: str
    size: tuple[int, int]  # rows, cols
    seed: tuple[int, int]  # of the recipe, number

    @property
    def name(self) -> str:
        return f"{self.kind} {self.seed[0]}.{self.seed[1]}"


@dataclass(frozen=True)
class FileScene:
    """A scene in a file."""

    kind: str
    path: Path
    shrink: int = 1


@dataclass(frozen=True)
class Shot:
    """One frame to be simulated: a scene, a light, an exposure."""

    scene: DrawnScene | FileScene
    illuminant: str
    luminance: float  # cd/m²
    exposure: float  # seconds or, where it is automatic, white's share of full scale
    automatic: bool


def patterns(recipe: SceneRecipe) -> list[str | None]:
    """The file or glob of each source; None for built-in scenes."""
    return [source.file if isinstance(source, IsetScenes | RgbPictures) else None for source in recipe.scene]


def shots(recipe: SceneRecipe, files: list[list[Path]]) -> Iterator[Shot]:
    """Every frame of the recipe, scene by scene; `files` are those of each of its sources, none where it has none."""
    automatic = recipe.exposure_share is not None
    exposures = recipe.exposure_share or recipe.exposure_s or []
    for source, found in zip(recipe.scene, files, strict=True):
        settings = itertools.product(recipe.illuminants, recipe.luminances_cd_m2, exposures)
        for scene, (illuminant, luminance, exposure) in itertools.product(_scenes(source, found), settings):
            yield Shot(scene, illuminant, luminance, exposure, automatic)


def _scenes(source: Source, files: list[Path]) -> list[DrawnScene | FileScene]:
    match source:
        case IsetScenes():
            return [FileScene("iset", path) for path in files]
        case RgbPictures():
            return [FileScene("rgb", path, source.shrink) for path in files]
        case ColorChecker():
            return [DrawnScene("colorchecker", source.size, (0, 0))]
        case DeadLeaves():
            return [DrawnScene("dead leaves", source.size, (source.seed, number)) for number in range(source.count)]
        case Composition():
            return [DrawnScene("composition", source.size, (source.seed, number)) for number in range(source.count)]
