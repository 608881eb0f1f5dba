"""The [[scene]] tables of a scene recipe, which specify the source of a scene and its position on the sensor.

Scenes can be cropped, mirrored, rotated and scaled. This module also converts spectral cubes to scenes.
"""

import itertools
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.frames.marks import missing
from l3cli.frames.scene import NO_ILLUMINANT, Polarisation, Scene, SpectralCube
from l3cli.physics import spectra
from l3cli.recipes.faults import Fault, fault
from l3cli.recipes.toml import Count, CountOrNone, Positive, Recipe, Seed, Share
from l3cli.simulation.light import Light
from l3cli.simulation.motion import Motion, motion_faults, room
from l3cli.spectra.file import other_unit

CODED = ("r", "g", "b")  # order of the channels in a picture with holds = "codes"
GLOB_TEXT = re.compile(r"[^\W_]+")  # letters and digits in a glob
MIN_SIDE_PIXELS = 16  # smallest permitted number of rows or columns


class Framing(Recipe, kw_only=True):
    """Crop, flip, rotation and scale of a scene, which are applied in this order."""

    # first row, first column, number of rows and number of columns, in samples of the scene
    crop: tuple[CountOrNone, CountOrNone, CountOrNone, CountOrNone] | None = None
    flip: Literal["rows", "cols"] | None = None
    rotate: Literal[0, 90, 180, 270] = 0  # degrees counter-clockwise
    scale: Positive | None = None  # pixels per sample; if the result is larger than the sensor, only the centre is used
    # horizontal angle of view of the scene, as an alternative to scale
    field_of_view_deg: Annotated[float, msgspec.Meta(gt=0, lt=179)] | None = None
    motion: Motion | None = None  # if set, l3 simulates a clip whose frames show parts of the scene


class Synthetic(Framing, kw_only=True):
    """A scene that l3 generates without a file."""

    size: tuple[Count, Count]  # rows and columns


class Random(Synthetic, kw_only=True):
    count: Count = 1  # number of scenes
    seed: Seed = 0  # combined with --seed; different seeds result in different scenes


class DeadLeaves(Random, tag_field="source", tag="dead leaves", kw_only=True):
    patterned: Share = 0.0  # fraction of the leaves that show gratings, lattices or letters


class Composition(Random, tag_field="source", tag="composition", kw_only=True):
    pass


class Skin(Random, tag_field="source", tag="skin", kw_only=True):
    patches: tuple[Count, Count] = (6, 9)  # rows and columns of patches


class Foliage(Random, tag_field="source", tag="foliage", kw_only=True):
    patches: tuple[Count, Count] = (6, 9)


class Surfaces(Random, tag_field="source", tag="surfaces", kw_only=True):
    """A chart of paints, plastics and textiles for training colours, without patches of the ColorChecker."""

    patches: tuple[Count, Count] = (6, 9)


class ColorChecker(Synthetic, tag_field="source", tag="colorchecker", kw_only=True):
    pass


class Munsell(Synthetic, tag_field="source", tag="munsell", kw_only=True):
    """A grid of colours with smooth reflectances. Hue varies along rows, lightness and chroma along columns."""


class SlantedEdge(Synthetic, tag_field="source", tag="slanted edge", kw_only=True):
    angle_deg: float = 5.0  # angle from the vertical
    dark: float = 0.05  # reflectance to the left of the edge
    bright: float = 0.8  # reflectance to the right of the edge


class ZonePlate(Synthetic, tag_field="source", tag="zone plate", kw_only=True):
    highest: float = 0.5  # frequency at the nearest sides of the frame, in cycles per pixel


class Frequencies(Synthetic, tag_field="source", tag="frequencies", kw_only=True):
    """A row of gratings. The frequency doubles from grating to grating, and the contrast decreases from top to bottom."""

    orders: Count = 6  # number of gratings; the last grating has 0.5 cycles per pixel


class GreyRamp(Synthetic, tag_field="source", tag="grey ramp", kw_only=True):
    octaves: float = 14.0  # the reflectance of the darkest grey is 2^-octaves


class FileSource(Framing, kw_only=True):
    file: str  # path relative to the recipe, or a pattern such as "faces/*.mat"


class IsetScenes(FileSource, tag_field="source", tag="iset", kw_only=True):
    light: str | None = None  # name or CSV file of the illuminant, for scene files without an illuminant


class Pictures(FileSource, kw_only=True):
    # side of the blocks of pixels that are averaged, which also reduces JPEG and demosaicking artifacts
    shrink: Count = 1


class RgbPictures(Pictures, tag_field="source", tag="rgb", kw_only=True):
    # "sRGB": the values are sRGB colours. "codes": the values are linear signals of the camera channels r, g and b.
    holds: Literal["sRGB", "codes"] = "sRGB"


class PolarisedPictures(Pictures, kw_only=True):
    # Stored value of a perfect, unpolarised white, seen through the polariser if there is one. The default is 1 for floats,
    # 255 for 8-bit integers, and 65535 for 16-bit integers that use the whole range. For all other integers, this key is
    # required.
    white: Positive | None = None


class BehindPolariser(PolarisedPictures, tag_field="source", tag="polariser", kw_only=True):
    """Pictures through a polariser at three or more angles: a folder with one picture per angle, or a stack in one file."""

    pictures: str = "*"  # glob that selects the pictures in the folder, such as "*_1.png"
    # Angle of the polariser of each picture, in the order of the file names or of the stack; default: read from the names.
    # Angles are counter-clockwise from the horizontal axis of the picture.
    angles_deg: list[float] | None = None
    # "linear": the values are proportional to the light. "sRGB": the values are encoded, as usual for 8-bit pictures.
    holds: Literal["linear", "sRGB"] = "linear"


class StokesPictures(PolarisedPictures, tag_field="source", tag="stokes", kw_only=True):
    """An EXR, TIFF or .npy file with the Stokes parameters S0, S1 and S2."""


class Spectral(FileSource, kw_only=True):
    """A spectral cube. The keys add or override information in its file."""

    wavelengths_nm: list[float] | None = None  # wavelengths of the bands; default: read from the file
    wavelength_range_nm: tuple[float, float, float] | None = None  # first, last and step; an alternative to wavelengths_nm
    # "radiance": the values are power per nm. "photons": the values are numbers of photons per nm.
    holds: Literal["reflectance", "radiance", "photons"] = "reflectance"
    # Stored value of a perfect white. By default, this value is read from the file. If the file does not specify it, the
    # default is 1 for floats, 255 for 8-bit integers, and 65535 for 16-bit integers that use the whole range. For all other
    # integers, this key is then required.
    white: Positive | None = None
    # Value that marks pixels without data, which training ignores. By default, it is read from the file.
    ignored: float | Literal["nan"] | None = None
    light: str | None = None  # name or CSV file of the illuminant under which radiance was measured


class BandFolder(Spectral, tag_field="source", tag="bands", kw_only=True):
    """A folder with one picture per band, in the order of the file names."""


class Envi(Spectral, tag_field="source", tag="envi", kw_only=True):
    pass


class Cube(Spectral, tag_field="source", tag="cube", kw_only=True):
    """A MATLAB file (any version), HDF5 file or .npy file."""

    variable: str | None = None  # name of the variable; default: the only cube in the file
    axes: str = "row col band"  # order of the axes, as MATLAB or numpy displays them


class ImageChannels(Spectral, tag_field="source", tag="channels", kw_only=True):
    """An EXR or TIFF file with one channel or page per band."""


Source = (
    DeadLeaves | Composition | ColorChecker | Munsell | Skin | Foliage | Surfaces
    | SlantedEdge | ZonePlate | Frequencies | GreyRamp
    | IsetScenes | RgbPictures | BandFolder | Envi | Cube | ImageChannels | BehindPolariser | StokesPictures
)  # fmt: skip


@dataclass(frozen=True)
class WantedScene:
    """One scene of a recipe: a file, or scene number `number` of a synthetic source."""

    source: Source
    path: Path | None = None
    number: int = 0

    @property
    def name(self) -> str:
        if self.path is not None:
            # If a folder contains the pictures of several scenes, the glob distinguishes them, as in "colour 1" for *_1.png.
            glob = Path(self.source.pictures).stem if isinstance(self.source, BehindPolariser) else ""
            return " ".join([self.path.stem, *GLOB_TEXT.findall(glob)])
        return f"{name_of(self.source)} {getattr(self.source, 'seed', 0)}.{self.number}"

    @property
    def error(self) -> type[L3Error]:
        """Exception class for faults in this scene: InputFileError if the scene is a file, otherwise RecipeError."""
        return RecipeError if self.path is None else InputFileError


def name_of(source: Source) -> str:
    """Return the type of a source, as written in recipes, such as "dead leaves"."""
    return str(source.__struct_config__.tag)


def wanted_scenes(source: Source, files: list[Path]) -> list[WantedScene]:
    """List the scenes of a source. `files` lists its scene files. It is ignored for a source without files."""
    if isinstance(source, FileSource):
        return [WantedScene(source, path) for path in files]
    return [WantedScene(source, number=number) for number in range(getattr(source, "count", 1))]


def source_faults(source: Source, camera: CameraModel | None, name: str) -> Iterator[Fault]:
    """Find the faults in the settings of a source, including conflicts with `camera` if it is known.

    For example, a synthetic scene must not be larger than the sensor, unless it is cropped, scaled or moved. Each message
    begins with `name`, the name of the source.
    """
    whole = source.scale is None and source.field_of_view_deg is None
    if not whole and source.scale is not None and source.field_of_view_deg is not None:
        message = f"{name}: scale and field_of_view_deg exclude each other; remove one of them"
        yield fault(message, "field_of_view_deg", "scale")
    if source.crop and min(source.crop[2:]) < 1:
        message = (
            f"{name}: crop {list(source.crop)} is empty; write [first row, first column, number of rows, number of columns] "
            "with at least one row and one column"
        )
        yield fault(message, "crop")
    if isinstance(source, Synthetic):
        try:
            fits = camera if whole and not source.crop and source.motion is None else None
            check_size(source.size, fits, RecipeError, name)
        except RecipeError as error:
            yield fault(str(error), "size")
    if source.motion is not None:
        yield from _motion_faults(source.motion, camera, name)
        if camera is not None and camera.polarisers is not None:
            yield fault(f"{name}: clips cannot be simulated for cameras with polarisers; remove motion", "motion")
    if isinstance(source, Cube) and sorted(source.axes.split()) != ["band", "col", "row"]:
        message = f'{name}: axes "{source.axes}" must contain row, col and band once each; set, for example, "row col band"'
        yield fault(message, "axes")
    if isinstance(source, Spectral):
        yield from _spectral_faults(source, name)
    if camera is not None and holds_codes(source) and sorted(camera.channels) != sorted(CODED):
        what = f'holds = "codes" needs the channels r, g and b, but {camera.name} has {", ".join(camera.channels)}'
        yield fault(f"{name}: {what}; remove holds", "holds")


def _motion_faults(motion: Motion, camera: CameraModel | None, name: str) -> Iterator[Fault]:
    try:
        check_size(motion.size, camera, RecipeError, f"{name}: motion.size")
    except RecipeError as error:
        yield fault(str(error), "motion.size")
    yield from motion_faults(motion, name)


def _spectral_faults(source: Spectral, name: str) -> Iterator[Fault]:
    if source.wavelengths_nm is not None and source.wavelength_range_nm is not None:
        message = f"{name}: wavelengths_nm and wavelength_range_nm exclude each other; remove one of them"
        yield fault(message, "wavelength_range_nm", "wavelengths_nm")
    listed = source.wavelengths_nm or []
    steps = [later - earlier for earlier, later in itertools.pairwise(listed)]
    if not (all(step > 0 for step in steps) or all(step < 0 for step in steps)):
        message = f"{name}: wavelengths_nm neither increases nor decreases; list the wavelengths in the order of the bands"
        yield fault(message, "wavelengths_nm")
    given = {"wavelengths_nm": (listed, -1), "wavelength_range_nm": (source.wavelength_range_nm or (), 1)}
    for key, (each, end) in given.items():
        if each and (other := other_unit(min(each[0], each[end]), max(each[0], each[end]))):
            yield fault(f"{name}: {other[0]}; convert {key} to nm", key)
    if source.wavelength_range_nm is not None:
        first, last, step = source.wavelength_range_nm
        if not (0 < first < last and step > 0):
            message = (
                f"{name}: wavelength_range_nm is {[first, last, step]}; write [first, last, step] with 0 < first < last and "
                "step > 0"
            )
            yield fault(message, "wavelength_range_nm")
    if source.light is not None and source.holds == "reflectance":
        message = f'{name}: light has no effect on reflectances; remove light, or set holds to "radiance" or "photons"'
        yield fault(message, "light")


def has_light(source: Source) -> bool:
    """Return whether a source's scenes contain an illuminant, as a separate spectrum or as a factor in their radiance."""
    return isinstance(source, IsetScenes) or (isinstance(source, Spectral) and source.holds != "reflectance")


def of_measured_surfaces(source: Source) -> bool:
    """Return whether a source's scenes are based on the measured reflectances that l3 includes."""
    if isinstance(source, Synthetic):
        return not isinstance(source, SlantedEdge | ZonePlate | Frequencies | GreyRamp)
    return isinstance(source, Pictures) and not holds_codes(source)


def holds_codes(source: Source) -> bool:
    """Return whether a source's scenes contain camera signals instead of spectra."""
    return isinstance(source, RgbPictures) and source.holds == "codes"


def can_be_relit(source: Source) -> bool:
    """Return whether a source's scenes can be simulated under any illuminant.

    This requires reflectances, or radiances under a known illuminant.
    """
    return not (isinstance(source, Spectral) and source.holds != "reflectance" and source.light is None)


def check_size(size: tuple[int, ...], camera: CameraModel | None, error: type[L3Error], name: str) -> None:
    """Raise `error` if a scene is too small for training, or larger than the sensor.

    Parameters
    ----------
    size : tuple of int
        Rows and columns of the scene.
    camera : CameraModel or None
        The camera, or None to check only the minimum size.
    error : type
        Exception class.
    name : str
        Name of the scene, for the message.
    """
    rows, cols = size
    if min(size) < MIN_SIDE_PIXELS:
        larger = "set a larger scale" if error is InputFileError else "set a larger size"
        raise error(
            f"{name} has {rows}×{cols} pixels, but a scene needs at least {MIN_SIDE_PIXELS}×{MIN_SIDE_PIXELS}; {larger}"
        )
    if camera and (rows > camera.rows or cols > camera.cols):
        smaller = "set scale, crop or (pictures only) shrink" if error is InputFileError else "set a smaller size"
        raise error(
            f"{name} has {rows}×{cols} pixels, which is larger than the sensor ({camera.rows}×{camera.cols}); {smaller}"
        )


def framed(cube: NDArray[np.float32], framing: Framing, camera: CameraModel) -> NDArray[np.float32]:
    """Crop, mirror, rotate and scale a scene for the sensor.

    Parameters
    ----------
    cube : ndarray, (row, col, band)
        Samples of the scene.
    framing : Framing
        Crop, orientation and scale.
    camera : CameraModel
        The camera. A scaled scene that is larger than the sensor is cropped.

    Returns
    -------
    ndarray, (row, col, band)
        One sample per pixel.

    Raises
    ------
    ValueError
        If the crop extends beyond the scene.
    """
    cube = turned(cube, framing)
    scale = scale_of(framing, camera, cube.shape[1])
    if scale is not None:
        cube = _scaled(cube, scale, (camera.rows, camera.cols))
    return np.ascontiguousarray(cube)


def on_sensor(scene: Scene, framing: Framing, camera: CameraModel) -> Scene:
    """Crop, mirror, rotate and scale a scene, including its polarisation and its mask of ignored samples.

    A pixel is ignored if any ignored sample contributes to it.
    """
    ignored = scene.ignored
    if ignored is not None:
        ignored = framed(ignored[..., None].astype(np.float32), framing, camera)[..., 0] > 0
        ignored = ignored if ignored.any() else None
    reflectance = framed(scene.reflectance, framing, camera)
    polarisation = scene.polarisation and _polarisation_on_sensor(scene.polarisation, scene.reflectance, framing, camera)
    return replace(scene, reflectance=reflectance, ignored=ignored, polarisation=polarisation)


def _polarisation_on_sensor(
    polarisation: Polarisation, reflectance: NDArray[np.float32], framing: Framing, camera: CameraModel
) -> Polarisation:
    """Apply `framed` to the polarisation of a scene.

    Samples are weighted with their brightness, the mean of `reflectance` over the bands. Mirroring changes the sign of S2. A
    quarter turn changes the signs of S1 and S2.
    """
    bright = np.maximum(reflectance.mean(axis=2, dtype=np.float32), np.float32(1e-6))[..., None]
    rows, cols, _, nodes = polarisation.ratio.shape
    stokes = framed(polarisation.ratio.reshape(rows, cols, -1) * bright, framing, camera)
    ratio = (stokes / framed(bright, framing, camera)).reshape(*stokes.shape[:2], 2, nodes)
    quarter = -1 if framing.rotate % 180 else 1
    mirror = 1 if framing.flip is None else -1
    return replace(polarisation, ratio=ratio * np.array([[quarter], [quarter * mirror]], np.float32))


def turned(cube: NDArray[np.float32], framing: Framing) -> NDArray[np.float32]:
    """Crop, mirror and rotate the samples of a scene.

    Raises
    ------
    ValueError
        If the crop extends beyond the scene.
    """
    top, left, rows, cols = _cropped(cube.shape, framing)
    cube = cube[top : top + rows, left : left + cols]
    if framing.flip is not None:
        cube = np.flip(cube, axis=("rows", "cols").index(framing.flip))
    return np.rot90(cube, framing.rotate // 90)


def framed_size(size: tuple[int, int], framing: Framing, camera: CameraModel) -> tuple[int, int]:
    """Return the size (rows, columns) of a scene after `framed`. For a clip, return the size of its frames.

    Raises
    ------
    ValueError
        If the crop extends beyond the scene, or if the camera moves beyond the scene.
    """
    _, _, rows, cols = _cropped(size, framing)
    if framing.rotate % 180:
        rows, cols = cols, rows
    scale = scale_of(framing, camera, cols)
    if framing.motion is not None:
        _require_room(framing.motion, (rows, cols), scale or 1.0)
        return framing.motion.size
    if scale is not None:
        rows, cols = min(_pixels(rows, scale), camera.rows), min(_pixels(cols, scale), camera.cols)
    return rows, cols


def _cropped(size: tuple[int, ...], framing: Framing) -> tuple[int, int, int, int]:
    """Return the crop of a scene (first row, first column, rows, columns), or the whole scene if the recipe has no crop.

    Raises ValueError if the crop extends beyond the scene.
    """
    if framing.crop is None:
        return 0, 0, size[0], size[1]
    top, left, rows, cols = framing.crop
    if top + rows > size[0] or left + cols > size[1]:
        extent = f"{size[0]}×{size[1]} samples"
        raise ValueError(f"crop {list(framing.crop)} extends beyond the scene with {extent}; set a smaller crop")
    return framing.crop


def _require_room(motion: Motion, size: tuple[int, int], scale: float) -> None:
    """Raise ValueError if the camera would move beyond a scene of `size` (rows, columns) with `scale` pixels per sample."""
    rows, cols = (math.ceil(min(length / scale - 1e-6, 1e9)) for length in room(motion))
    if rows > size[0] or cols > size[1]:
        raise ValueError(
            f"the {motion.frames} frames of the clip need an area of up to {rows}×{cols} samples, but the scene has only "
            f"{size[0]}×{size[1]}; use a larger scene, or reduce motion.size or the motion"
        )


def scale_of(framing: Framing, camera: CameraModel, cols: int) -> float | None:
    """Return the scale of a scene with `cols` columns in pixels per sample, or None if the scene is not resampled."""
    if framing.field_of_view_deg is None:
        return framing.scale
    width = 2.0 * camera.optics.image_distance * np.tan(np.radians(framing.field_of_view_deg) / 2.0)
    return float(width / camera.pixel_pitch / cols)


def _pixels(length: int, scale: float) -> int:
    return max(1, round(length * scale))


def _scaled(cube: NDArray[np.float32], scale: float, most: tuple[int, int]) -> NDArray[np.float32]:
    """Resample a cube to `scale` pixels per sample, and crop the result to at most `most` (rows, columns)."""
    down, across = (_resampling(length, scale, limit) for length, limit in zip(cube.shape, most, strict=False))
    return resampled(cube, down, across)


def resampled(cube: NDArray[np.float32], down: Any, across: Any) -> NDArray[np.float32]:
    """Resample a cube (row, col, band) vertically with the sparse matrix `down` and horizontally with `across`.

    The horizontal step works row by row, which limits memory use.
    """
    rows, cols, bands = cube.shape
    tall = (down @ cube.reshape(rows, cols * bands)).reshape(-1, cols, bands)
    made = np.empty((tall.shape[0], across.shape[0], bands), np.float32)
    for row, line in enumerate(tall):
        made[row] = across @ line
    return made


def _resampling(length: int, scale: float, most: int) -> Any:
    """Return the sparse matrix (pixel, sample) that resamples a line of samples.

    The samples are interpolated if pixels are smaller than samples, and averaged if pixels are larger.
    """
    from scipy.sparse import csr_array

    whole = _pixels(length, scale)
    pixels, step = min(whole, most), length / whole
    points = max(1, round(4 * step)) if step > 1 else 1
    inside = (np.arange(points) + 0.5) / points
    position = (np.arange(pixels)[:, None] + (whole - pixels) / 2 + inside) * step - 0.5  # in samples
    first = np.floor(position).astype(int)
    either = np.clip(np.stack([first, first + 1]), 0, length - 1)
    weight = np.stack([1 - (position - first), position - first]).astype(np.float32) / points
    row = np.broadcast_to(np.arange(pixels)[:, None], either.shape)
    return csr_array((weight.ravel(), (row.ravel(), either.ravel())), shape=(pixels, length))


AXES = ("row", "col", "band")
BRIGHT_QUANTILE = 0.999  # quantile of the pixel values that counts as white if the value of white is unknown
MAX_MEDIAN_REFLECTANCE = 2.0  # if the median is larger, the values are probably percent, counts or radiance
FULL_RANGE = 0.75  # if the brightest pixels reach this fraction of 65535, l3 assumes that 65535 is white
MEDIAN_STEP = 8  # the median is computed from every eighth row and column
STRIP_ROWS = 128  # rows that are converted together, which limits memory use


def scene_of(cube: SpectralCube, source: Spectral, name: str, light: Light | None) -> Scene:
    """Convert a stored spectral cube to a scene.

    Parameters
    ----------
    cube : SpectralCube
        The cube as stored in its file.
    source : Spectral
        The recipe entry of the cube.
    name : str
        Name of the scene.
    light : Light or None
        Illuminant under which radiance was measured, or None if the illuminant is unknown.

    Raises
    ------
    ValueError
        If the cube contradicts the recipe, or if its wavelengths or its value of white are unknown.

    Notes
    -----
    Reflectances are divided by the stored value of a perfect white, and radiances by the radiance of a perfect white under
    `light`. If the illuminant is unknown, equal photon radiance at all wavelengths is assumed. If the recipe does not
    contain the key `white`, the brightest pixels of a radiance scene are assumed to be white.

    Small negative values become zero (docs/method.md#simulation). Bad bands are removed. Pixels without data are filled with
    the nearest pixel that has data, and are marked as ignored.
    """
    wavelength, values, ignored = _bands(cube, source)
    white = source.white or cube.white or usual_white(values, source.holds == "reflectance", ignored)
    per_white = np.full(wavelength.size, 1.0 / white)
    illuminant = NO_ILLUMINANT
    if source.holds != "reflectance":
        per_white *= _photons(wavelength, source)
        illuminant = np.ones(wavelength.size)
        if light is not None:
            stored = light.radiance / _photons(light.wavelength, source)
            illuminant = spectra.average(stored, light.wavelength, wavelength) * _photons(wavelength, source)
            if not (illuminant > 0).all():
                dark = wavelength[illuminant <= 0][0]
                raise ValueError(f"light has no power at {dark:g} nm; use an illuminant that covers all bands of the cube")
        illuminant = illuminant / illuminant.max()
        per_white /= illuminant
    reflectance = np.empty(values.shape, np.float32)
    for top in range(0, len(values), STRIP_ROWS):
        reflectance[top : top + STRIP_ROWS] = values[top : top + STRIP_ROWS] * per_white.astype(np.float32)
    if ignored is not None:
        _fill(reflectance, ignored)
    if not np.isfinite(reflectance).all():
        raise ValueError('the cube contains values that are not finite (NaN or Inf); correct them, or set ignored = "nan"')
    _require_no_mark(values, ignored)
    np.maximum(reflectance, 0.0, out=reflectance)
    if source.holds != "reflectance" and source.white is None:
        _normalise(reflectance)
    usual = float(np.median(reflectance[::MEDIAN_STEP, ::MEDIAN_STEP]))
    if source.holds == "reflectance" and usual > MAX_MEDIAN_REFLECTANCE:
        raise ValueError(
            f"the median reflectance of the cube is {usual:.3g}, which is above white (1); set white to the stored value of "
            'white (100 for percent), or correct the key "holds"'
        )
    return Scene(name, wavelength, reflectance, illuminant, ignored)


def usual_white(values: NDArray, is_reflectance: bool = True, ignored: NDArray[np.bool_] | None = None) -> float:
    """Guess the stored value of a perfect white from the data type. Raises ValueError if this is impossible.

    `values` is a spectral cube (row, col, band) or a stack of pictures (picture, row, col, colour).
    """
    if values.dtype.kind not in "iu":
        return 1.0
    top = float(np.iinfo(values.dtype).max)
    if not is_reflectance or values.dtype.itemsize == 1:
        return top  # radiance is scaled by its brightest pixels later, and 8-bit reflectances use the full range
    brightest = np.max(values, axis=-1, where=True if ignored is None else ~ignored[..., None], initial=0)
    reached = float(np.quantile(brightest, BRIGHT_QUANTILE))
    if values.dtype.kind == "u" and values.dtype.itemsize == 2 and reached >= FULL_RANGE * top:
        return top
    raise ValueError(
        f"the file contains {8 * values.dtype.itemsize}-bit integers up to {reached:g}, but no scale; set white to the "
        f"stored value of a perfect white, such as 10000 or {top:g}"
    )


def _fill(reflectance: NDArray[np.float32], ignored: NDArray[np.bool_]) -> None:
    """Fill pixels without data from the nearest pixel with data. Raises ValueError if no pixel has data."""
    from scipy.ndimage import distance_transform_edt

    if ignored.all():
        raise ValueError('all pixels of the cube are marked as missing; use a cube with data, or correct the key "ignored"')
    rows, cols = distance_transform_edt(ignored, return_distances=False, return_indices=True)
    reflectance[ignored] = reflectance[rows[ignored], cols[ignored]]


def _require_no_mark(values: NDArray, ignored: NDArray[np.bool_] | None) -> None:
    """Raise ValueError if a pixel has the same negative value in all bands, which probably marks missing data."""
    if values.shape[2] < 2 or values.dtype.kind == "u":
        return
    for row, line in enumerate(values):
        marked = (line[:, 0] < 0) & (line == line[:, :1]).all(axis=1)
        if ignored is not None:
            marked &= ~ignored[row]
        if marked.any():
            mark = float(line[marked.argmax(), 0])
            raise ValueError(
                f"the cube contains pixels with the value {mark:g} in all bands; if this value marks missing data, set "
                f"ignored = {mark:g}"
            )


def _photons(wavelength: np.ndarray, source: Spectral) -> np.ndarray:
    """Return the factor (wavelength,) that converts the stored values of a cube to photons, in relative units."""
    one = np.ones(wavelength.size)
    return spectra.photons_from_energy(wavelength, one) if source.holds == "radiance" else one


def _normalise(reflectance: np.ndarray) -> None:
    """Scale a scene in place so that the reflectances of nearly all pixels are at most 1.

    Raises ValueError if the scene is black.
    """
    peak = float(np.quantile(reflectance.max(axis=2), BRIGHT_QUANTILE))
    if peak <= 0:
        raise ValueError("the scene is black everywhere; use another scene")
    reflectance /= np.float32(peak)


def _bands(cube: SpectralCube, source: Spectral) -> tuple[np.ndarray, np.ndarray, NDArray[np.bool_] | None]:
    """Select the good bands of a cube, in order of increasing wavelength.

    Wavelengths in the recipe take precedence over wavelengths in the file.

    Returns
    -------
    ndarray, (band,)
        Wavelengths in nm.
    ndarray, (row, col, band)
        Stored values.
    ndarray, (row, col), or None
        Mask of the pixels without data.

    Raises
    ------
    ValueError
        If there are no wavelengths, if a wavelength is not finite or occurs twice, or if the number of wavelengths differs
        from the number of bands.
    """
    if source.wavelengths_nm is not None:
        wavelength = np.array(source.wavelengths_nm)
    elif source.wavelength_range_nm is not None:
        first, last, step = source.wavelength_range_nm
        wavelength = np.arange(first, last + step / 2, step)
    elif cube.wavelength is not None:
        wavelength = cube.wavelength
    else:
        raise ValueError("the cube contains no wavelengths; set wavelengths_nm or wavelength_range_nm in the recipe")
    values, shape = cube.values, cube.values.shape
    if shape[2] != wavelength.size:
        sizes = " × ".join(map(str, shape))
        described = f"the cube has {sizes} values (row × col × band), but {wavelength.size} wavelengths"
        if wavelength.size in shape[:2]:
            raise ValueError(
                f"{described}, so the bands are probably along the {AXES[shape.index(wavelength.size)]} axis; correct the "
                'key "axes"'
            )
        raise ValueError(f"{described}; correct wavelengths_nm")
    if not np.isfinite(wavelength).all():
        raise ValueError("the cube contains wavelengths that are not finite; set wavelengths_nm in the recipe")
    good = np.ones(wavelength.size, bool) if cube.good is None else cube.good
    ignored = cube.ignored
    if source.ignored is not None:
        ignored = missing(values, float(source.ignored), good)
    order = np.argsort(wavelength, kind="stable")
    order = order[good[order]]
    if (twice := np.diff(wavelength[order]) <= 0).any():
        raise ValueError(
            f"the cube contains {wavelength[order][twice.argmax()]:g} nm twice; set wavelengths_nm in the recipe"
        )
    steps = np.unique(np.diff(order)) if order.size > 1 else np.ones(1, int)
    if steps.size == 1 and abs(steps[0]) == 1:  # the bands are adjacent, so a view suffices and saves memory
        start, step = int(order[0]), int(steps[0])
        values = values[..., start : start + step * order.size if start + step * order.size >= 0 else None : step]
    else:
        values = values[..., order]
    return wavelength[order], values, ignored
