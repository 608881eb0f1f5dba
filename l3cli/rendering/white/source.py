"""Find the white point of a scene (docs/method.md#scene-white).

The white point is read from the file, measured on a grey object or a ColorChecker in the frame, or estimated from the whole
frame. To estimate it, l3 averages the results of the grey-edge and white-patch methods, and then selects the most probable
illuminant on a grid around daylight and black bodies.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.errors import InputFileError, RecipeError, shortened
from l3cli.frames.chart import Located, corner_cells, locate, through
from l3cli.frames.frame import RawFrame
from l3cli.physics import charts, correlated_lights, spectra
from l3cli.physics.display import scene_white
from l3cli.physics.mosaic import shifted_cfa
from l3cli.physics.spaces import BRADFORD
from l3cli.physics.stokes import STOKES
from l3cli.rendering.exposure import SpreadSamples
from l3cli.rendering.white.scene_white import GREY_LEVEL, Grey, SceneWhite, Square, WhiteBalance, Whites, plain_balance
from l3cli.system.text import NoSuchNumber, Quantity

Array = NDArray[np.floating]
EDGE_NORM = 6  # order of the Minkowski norm over the edges; a high order emphasises strong edges
PATCH_PERCENTILE = 99  # percentile of each cone response that counts as the response to white
MIN_SAMPLES = 24  # an estimate needs at least this many samples that are neither clipped nor dark
MIREDS = np.arange(80.0, 521.0, 20.0)  # reciprocal colour temperatures in mired (10^-6/K), 12 500 K to 1920 K
GREENS = np.linspace(-0.2, 0.4, 7)  # green (positive) or magenta (negative) tints, in the unit of correlated_lights.GREENS
SEARCH_POINTS = (111, 31)  # size of the search grid along MIREDS and GREENS
LIKELY_ERROR = 0.1  # assumed standard deviation of the error in the estimated log cone ratios
LIKELY_GREEN = 0.1  # assumed standard deviation of an illuminant's tint


class AutoWhite:
    """Estimates the white point of a frame from about 1500 pixels.

    The pixels are rendered on the CPU, so that the estimate does not depend on the OpenCL device.

    Parameters
    ----------
    whites : Whites
        White points of the table that renders these pixels.
    balanced_by : Whites, optional
        White points of the table that renders the picture. It determines the white balance. [default: `whites`]
    """

    about, held = "estimated from the frame", False

    def __init__(self, whites: Whites, balanced_by: Whites | None = None) -> None:
        self._whites, self._table, self._balances = whites, whites.table, balanced_by or whites
        self._spread = SpreadSamples(self._table)
        self._neutrals = _neutrals(self._table)  # (mired, green, channel)
        self._places = self._log_ratios()  # (fine mired, fine green, 2)
        self._made: dict[tuple[int, int], SceneWhite] = {}

    def white(self, frame: RawFrame) -> SceneWhite | None:
        """Return the estimated white point, or None if too many pixels are clipped or dark."""
        estimate = estimated(*self._samples(frame))
        if estimate is None:
            return None
        place = self._nearest(estimate)
        if place not in self._made:
            neutral, whites = self._neutral(*place), self._balances
            self._made[place] = whites.of_neutral(neutral) if self._table.camera else whites.of_xyz(neutral)
        return self._made[place]

    def _nearest(self, estimate: Array) -> tuple[int, int]:
        """Return the grid indices of the most probable illuminant for the estimate (log L/M, log S/M)."""
        green = np.linspace(GREENS[0], GREENS[-1], SEARCH_POINTS[1])
        error = ((self._places - estimate) ** 2).sum(axis=-1) / LIKELY_ERROR**2 + (green / LIKELY_GREEN) ** 2
        row, col = np.unravel_index(int(error.argmin()), error.shape)
        return int(row), int(col)

    def _neutral(self, row: int, col: int) -> Array:
        """Return the channel signals of a grey object under the illuminant at these grid indices."""
        places = (
            np.array([place * (count - 1) / (fine - 1)])
            for place, count, fine in zip((row, col), self._neutrals.shape[:2], SEARCH_POINTS, strict=True)
        )
        return np.asarray(_between(self._neutrals, *places)[0, 0])

    def _samples(self, frame: RawFrame) -> tuple[Array, NDArray[np.bool_]]:
        """Return the cone responses (row, col, 3) of a grid of pixels, and a mask of pixels neither clipped nor dark."""
        table, rule = self._table, self._table.first.rule
        patches, site, labels = self._spread.of(frame)
        classes, signal = rule.on_site(labels, site), self._spread.signal(patches)
        first = table.first.weights[classes, :3], table.first.intercept[classes, :3]  # X, Y and Z
        xyz = np.einsum("nct,nt->nc", first[0], signal) + first[1]
        cones = xyz.astype(np.float64) @ BRADFORD.T
        usable = (rule.lost(rule.split(labels).kind) == 0) & (cones.min(axis=1) > 0)
        shape = self._spread.shape(frame)
        return cones.reshape(*shape, 3), usable.reshape(shape)

    def _log_ratios(self) -> Array:
        """Return log L/M and log S/M of a grey object under each illuminant of the search grid, (mired, green, 2)."""
        shown = self._neutrals.reshape(-1, self._neutrals.shape[-1])
        if self._table.camera:
            shown = self._whites.grey.outputs_of(GREY_LEVEL * shown)
        cones = np.maximum(shown @ BRADFORD.T, 1e-9).reshape(len(MIREDS), len(GREENS), 3)
        rows, cols = (np.linspace(0, count - 1, fine) for count, fine in zip(cones.shape[:2], SEARCH_POINTS, strict=True))
        return _between(_ratios(cones), rows, cols)


def estimated(cones: Array, usable: NDArray[np.bool_]) -> Array | None:
    """Estimate the white point of a scene by the grey-edge and white-patch methods.

    The result is the mean of both methods. The grey-edge method assumes that large differences between neighbouring pixels
    are grey on average (van de Weijer, Gevers and Gijsenij, 2007). The white-patch method assumes that white produces the
    largest response of each cone (Land, 1977).

    Parameters
    ----------
    cones : ndarray, (row, col, 3)
        Cone responses L, M and S on a grid of pixels.
    usable : ndarray of bool, (row, col)
        Mask of the pixels to use.

    Returns
    -------
    ndarray, (2,), or None
        Natural logarithms of L/M and S/M for white, or None if too few pixels are usable.
    """
    if int(usable.sum()) < MIN_SAMPLES:
        return None
    down, across = usable[1:] & usable[:-1], usable[:, 1:] & usable[:, :-1]
    steps = np.concatenate([np.diff(cones, axis=0)[down], np.diff(cones, axis=1)[across]])
    patch = _ratios(np.percentile(cones[usable], PATCH_PERCENTILE, axis=0))
    largest = np.abs(steps).max(axis=0) if len(steps) else np.zeros(3)
    if not largest.min() > 0:
        return patch
    edges = _ratios(largest * ((np.abs(steps) / largest) ** EDGE_NORM).mean(axis=0) ** (1 / EDGE_NORM))
    return (edges + patch) / 2


def _neutrals(table: TransformTable) -> Array:
    """Return a grey object's channel signals for a grid of illuminants around daylight and black bodies.

    The result has the axes (mired, green, channel). If the table does not contain its camera, the result is the XYZ of each
    illuminant. This assumes that the table renders every white point correctly.
    """
    camera = table.camera
    grid = camera.wavelength if camera else correlated_lights.WAVELENGTH
    weights = camera.signal_weights if camera else spectra.xyz_weights(grid)
    lights = [[correlated_lights.radiance(mired, green, grid) for green in GREENS] for mired in MIREDS]
    neutrals = np.array(lights) @ weights.T
    return np.asarray(neutrals / neutrals.max(axis=-1, keepdims=True))


def _ratios(cones: Array) -> Array:
    """Return the natural logarithms of L/M and S/M for cone responses (…, 3)."""
    return np.log(cones[..., [0, 2]] / cones[..., 1:2])


def _between(values: Array, rows: Array, cols: Array) -> Array:
    """Interpolate `values` bilinearly along its first two axes, at fractional indices `rows` and `cols`."""
    low_row = np.clip(rows.astype(int), 0, values.shape[0] - 2)
    low_col = np.clip(cols.astype(int), 0, values.shape[1] - 2)
    down, across = (rows - low_row)[:, None, None], (cols - low_col)[None, :, None]
    upper, lower = values[low_row], values[low_row + 1]
    along = upper[:, low_col] * (1 - down) + lower[:, low_col] * down
    beyond = upper[:, low_col + 1] * (1 - down) + lower[:, low_col + 1] * down
    return np.asarray(along * (1 - across) + beyond * across)


NEUTRALS = range(18, 24)  # indices of the neutral patches, from white to black
CORE = 0.25  # half the side of the measured square in a patch, as a fraction of the patch side
WAVELENGTH = np.arange(400.0, 701.0, 10.0)  # nm
# A chart counts as found if R² of the fit is at least this value. In tests, R² was at most 0.83 in 48 pictures without a
# chart, and 0.998 in two pictures with a chart.
MIN_R_SQUARED = 0.95


@dataclass(frozen=True)
class ChartSceneWhite(SceneWhite):
    """White point measured on a ColorChecker."""

    place: str  # position of the chart in the upright picture, for messages
    stated: SceneWhite | None  # white point recorded in the file, if any

    def __str__(self) -> str:
        return f"{super().__str__()}; {self.place}"


class ChartWhite:
    """Measures the white point on the grey patches of a ColorChecker in the frame."""

    about, held = "measured on a ColorChecker", True

    def __init__(self, table: TransformTable) -> None:
        self._whites, self._table = Whites(table), table
        self._reflectance = charts.chart("classic", WAVELENGTH)[1]

    def white(self, frame: RawFrame) -> ChartSceneWhite:
        """Find the chart in a frame, and measure the white point on its grey patches.

        Raises
        ------
        InputFileError
            If no chart is found, or if no grey patch can be measured.
        """
        table, (rows, cols) = self._table, charts.CLASSIC
        mosaic = frame.shading_corrected().values - (frame.black_level + frame.dark)
        located = locate(mosaic, shifted_cfa(table.cfa, frame.phase), self._reflectance, charts.CLASSIC)
        if located is None or located.fit < MIN_R_SQUARED:
            raise InputFileError(
                f"{frame.name}: no ColorChecker with {rows}×{cols} patches found; set ‹white› to the ROW,COL of a grey "
                "area, or take a photo in which the chart is larger, in focus and evenly lit"
            )
        greys = list(_greys(frame, located))
        usable = [grey for grey in greys if self._whites.grey.usable(frame, grey)]
        made = self._whites.of_greys(frame, usable or greys)
        stated = None if frame.neutral is None else self._whites.of_neutral(np.array(frame.neutral))
        return ChartSceneWhite(made.balance, made.light, made.modelled, _place(frame, located), stated)


def _greys(frame: RawFrame, located: Located) -> Iterator[Grey]:
    """Yield the central square of each neutral patch."""
    for patch in NEUTRALS:
        row, col = divmod(patch, charts.CLASSIC[1])
        middle = np.array([col + 0.5, row + 0.5])
        around = through(located.to_pixels, middle + CORE * np.array([[0, 0], [1, 0], [0, 1], [-1, 0], [0, -1]]))
        half = int(np.hypot(*(around[1:] - around[0]).T).min())
        left, top = (int(place) - half for place in np.rint(around[0]))
        where = slice(max(top, 0), max(top, 0) + 2 * half), slice(max(left, 0), max(left, 0) + 2 * half)
        yield Grey(f"{frame.name}: patch {patch + 1} of the ColorChecker", where)


def _place(frame: RawFrame, located: Located) -> str:
    """Describe where a chart is in the upright picture, for example "rows 10–90, columns 20–140"."""
    corners = through(located.to_pixels, corner_cells(*charts.CLASSIC))
    cols, rows = (_turned(corners[:, axis], frame, axis) for axis in (0, 1))
    if frame.orientation & 4:
        rows, cols = cols, rows
    return f"rows {rows.min():.0f}–{rows.max():.0f}, columns {cols.min():.0f}–{cols.max():.0f}"


def _turned(places: NDArray[np.floating], frame: RawFrame, axis: int) -> NDArray[np.floating]:
    """Mirror column numbers (axis 0) or row numbers (axis 1) if the frame's orientation requires it."""
    return frame.values.shape[1 - axis] - 1 - places if frame.orientation & (1, 2)[axis] else places


TABLE, CAMERA, AUTO, CHART = "table", "camera", "auto", "chart"
DEFAULT_SIZE = 32  # side of the measured square, in pixels
PLACE, SIZE = Quantity(0, 1_000_000, "pixels", whole=True), Quantity(2, 1000, "pixels", whole=True)
MULTIPLIER = Quantity(0.05, 20)  # allowed range of a channel multiplier


class WhiteSource(Protocol):
    """A way to find the white point of each frame."""

    @property
    def about(self) -> str:
        """How the white point was determined, for messages: for example "measured on a ColorChecker"."""
        ...

    @property
    def held(self) -> bool:
        """Whether all frames of a sequence use the white point of the first frame, instead of their own."""
        ...

    def white(self, frame: RawFrame) -> SceneWhite | None:
        """Find the white point of a frame. The result is None if it is unknown.

        Raises
        ------
        InputFileError
            If the white point cannot be measured.
        """
        ...


class CameraWhite:
    """Reads the white balance that the camera recorded in the file.

    If the file contains no white balance, `white` returns None. If the user has requested this method (`asked`), it instead
    raises an InputFileError.
    """

    about, held = "from the file", False

    def __init__(self, table: TransformTable, asked: bool = True) -> None:
        self._whites, self._asked = Whites(table), asked
        self._made: dict[tuple[float, ...], SceneWhite] = {}

    def white(self, frame: RawFrame) -> SceneWhite | None:
        if frame.neutral is None:
            if not self._asked:
                return None
            raise InputFileError(
                f"{frame.name} contains no white balance; set ‹white› to auto, chart, the ROW,COL of a grey area, or the "
                "name of an illuminant"
            )
        if frame.neutral not in self._made:
            self._made[frame.neutral] = self._whites.of_neutral(np.array(frame.neutral))
        return self._made[frame.neutral]


class SquareWhite:
    """Measures the white point on a grey object, in a square of the picture."""

    held = True

    def __init__(self, table: TransformTable, square: Square) -> None:
        self.about = f"measured on {square.size}×{square.size} pixels around row {square.row}, column {square.col}"
        self._whites, self._square = Whites(table), square

    def white(self, frame: RawFrame) -> SceneWhite:
        return self._whites.of_greys(frame, [self._square.within(frame)])


def white_source(
    text: str | None, table: TransformTable, photos: bool = False, estimated_by: TransformTable | None = None
) -> WhiteSource | None:
    """Parse the option ‹white› as a way to find the white point of each frame.

    Parameters
    ----------
    text : str or None
        Value of the option. "camera", "auto", "chart" and "ROW,COL[,SIZE]" are ways to find the white point. Any other value
        is a fixed white point, which `given_white` parses.
    table : TransformTable
        Table that renders the frames.
    photos : bool
        Whether to use the white balance recorded in the files if `text` is None.
    estimated_by : TransformTable, optional
        Table that renders the sampled pixels for "auto" (docs/method.md#several-illuminants). [default: `table`]

    Returns
    -------
    WhiteSource or None
        None if all frames have the same white point.

    Raises
    ------
    RecipeError
        If the table renders monochrome pictures, which need no white point, but `text` specifies how to find one.
    """
    if table.shows_grey:
        if text in (CAMERA, AUTO, CHART) or _square(text) is not None:
            raise RecipeError(f"‹white› {text} has no effect, because the table renders grey pictures; omit ‹white›")
        return None
    if text is None:
        return CameraWhite(table, asked=False) if photos else None
    if text == CAMERA:
        return CameraWhite(table)
    if text == AUTO:
        return AutoWhite(Whites(estimated_by or table), Whites(table))
    if text == CHART:
        return ChartWhite(table)
    square = _square(text)
    return None if square is None else SquareWhite(table, square)


def _square(text: str | None) -> Square | None:
    """Parse "ROW,COL[,SIZE]" as a square, or return None if `text` has another form.

    Raises
    ------
    RecipeError
        If a number is out of range.
    """
    text = text or ""
    parts = text.split(",")
    if not _is_place(parts):
        return None
    try:
        row, col = (int(PLACE.read(part)) for part in parts[:2])
        size = int(SIZE.read(parts[2])) if len(parts) == 3 else DEFAULT_SIZE
    except NoSuchNumber as error:
        raise RecipeError(
            f'white "{shortened(text)}" is not a valid grey area: {error}; use ROW,COL or ROW,COL,SIZE in pixels'
        ) from None
    return Square(row, col, size)


def _is_place(parts: list[str]) -> bool:
    """Whether `parts` are ROW,COL or ROW,COL,SIZE in whole numbers.

    A size of 1 is excluded, because "1,1,1" means three multipliers.
    """
    return 2 <= len(parts) <= 3 and all(re.fullmatch(r"[+-]?\d+", part) for part in parts) and parts[2:] != ["1"]


def given_white(text: str | None, table: TransformTable) -> SceneWhite | None:
    """Parse the option ‹white› as a fixed white point for all frames.

    Parameters
    ----------
    text : str or None
        The name of an illuminant, a chromaticity "x,y", or one multiplier per channel, such as "2.1,1,1.4". "table" and
        None mean the table's own white point.
    table : TransformTable
        Table that renders the frames.

    Returns
    -------
    SceneWhite or None
        None for the table's own white point.

    Raises
    ------
    RecipeError
        If `text` has none of these forms.
    """
    if text is None or text == TABLE:
        return None
    if text.count(",") > 1:
        return Whites(table).of_neutral(1 / _multipliers(text, table.channels))
    return Whites(table).of_chromaticity(scene_white(text)) if "," in text else Whites(table).of_light(text)


def _multipliers(text: str, channels: Sequence[str]) -> Array:
    """Parse one multiplier per channel.

    Raises
    ------
    RecipeError
        If there is not one multiplier per channel, or if a multiplier is out of range.
    """
    parts, names = text.split(","), ", ".join(channels)
    if len(parts) != len(channels):
        raise RecipeError(
            f'white "{shortened(text)}" has {len(parts)} multipliers; set one for each of the channels {names}'
        )
    try:
        return np.array([MULTIPLIER.read(part) for part in parts])
    except NoSuchNumber as error:
        raise RecipeError(
            f'white "{shortened(text)}" is invalid: {error}; set one multiplier per channel ({names}), or ROW,COL,SIZE of a '
            "grey area in whole pixels"
        ) from None


def usual_balance(table: TransformTable) -> WhiteBalance:
    """Return the white balance for scenes under the training illuminant."""
    white = np.ones(3) if table.outputs == STOKES else table.white_point[:3]  # pictures of S0 are grey
    return plain_balance(white, len(table.channels))
