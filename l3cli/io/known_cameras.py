"""The 52 built-in cameras: measured responsivities (configs/priors/cameras.csv) and published properties (cameras.toml)."""

import functools
from typing import ClassVar, Literal

import msgspec
import numpy as np

from l3cli.artifacts.camera import Optics
from l3cli.artifacts.camera_recipe import F_NUMBER, FOCAL_MM, PITCH_UM
from l3cli.frames.measurement import Body, FinishedCurves, Stated
from l3cli.recipes.builtin import recipe_folder, slug_of
from l3cli.recipes.load import load_recipe
from l3cli.recipes.toml import Count, Positive, Recipe
from l3cli.spectra.file import read_table

ROLES = ("r", "g", "b")
USUAL_ROWS, USUAL_COLS, USUAL_BITS = 1080, 1920, 14  # assumed if these properties have not been published
FULL_SCALE_PER_BLACK = 32  # assumed ratio of full scale to black level
ARRAYS = {  # colour filter arrays in an arbitrary phase; raw files may start at a different site
    "bayer": ("r g", "g b"),
    "xtrans": ("g b g g r g", "r g r b g b", "g b g g r g", "g r g g b g", "b g b r g r", "g r g g b g"),
}
# Words that are ignored in the names of manufacturers.
COMPANY = {"corporation", "corp", "company", "co", "ltd", "inc", "imaging"}


class KnownCamera(Recipe):
    """Published properties of a camera."""

    name: str  # make and model
    also: list[str] = msgspec.field(default_factory=list)  # other names, and cameras with the same sensor and filters
    array: Literal["bayer", "xtrans"] = "bayer"
    rows: Count | None = None
    cols: Count | None = None
    pixel_pitch_um: Positive | None = None
    bits: Count | None = None
    iso: Positive | None = None  # lowest ISO speed

    @property
    def body(self) -> Body:
        """Sensor, colour filter array and optics, with typical values for unpublished properties."""
        cfa = np.array([[ROLES.index(site) for site in row.split()] for row in ARRAYS[self.array]], np.uint8)
        pitch, optics = (self.pixel_pitch_um or PITCH_UM) * 1e-6, Optics(FOCAL_MM / 1000, F_NUMBER, 0.0)
        size = self.rows or USUAL_ROWS, self.cols or USUAL_COLS
        return Body(self.name, *size, pitch, self.bits or USUAL_BITS, ROLES, cfa, optics)

    @property
    def levels(self) -> tuple[float, float]:
        """Typical black level and white level in DN, for raw files that do not contain these levels."""
        values = 2.0 ** (self.bits or USUAL_BITS)
        return values / FULL_SCALE_PER_BLACK, values - 1

    @property
    def stated(self) -> Stated:
        """The published properties, in the same form as the metadata of raw files."""
        return Stated(self.name, (), None, self.iso, self.pixel_pitch_um, None, None)


class KnownCameras(Recipe):
    """The built-in cameras. `camera` maps short names, such as "nikon_d810", to published properties."""

    title: ClassVar[str] = "a table of cameras"

    source: str  # source of the curves
    camera: dict[str, KnownCamera]


@functools.cache
def known_cameras() -> KnownCameras:
    """Return the published properties of the built-in cameras."""
    return load_recipe(recipe_folder() / "priors" / "cameras.toml", KnownCameras)


def known_curves(slug: str) -> FinishedCurves:
    """Return the measured r, g and b responsivities of a built-in camera. `slug` is its key in cameras.toml."""
    table = read_table(recipe_folder() / "priors" / "cameras.csv")
    chosen = table.channel_columns(ROLES, {role: f"{slug} {role}" for role in ROLES})
    return FinishedCurves(chosen.wavelength, chosen.values)


def known_as(stated: str) -> str | None:
    """Find a camera in cameras.toml by the make and model in a raw file. Return its key, or None if it is not listed."""
    words = [word for word in slug_of(stated).split("_") if word not in COMPANY]
    model = "_".join(dict.fromkeys(words))  # drops repeated words, as in "NIKON CORPORATION NIKON D810"
    return next(
        (slug for slug, each in known_cameras().camera.items() if model in map(slug_of, (each.name, *each.also))), None
    )
