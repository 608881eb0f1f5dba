"""Raw frames in memory, and what renders them: one by one, or the mosaics of one size that a video program hands on."""

import functools
import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from l3cli.api.stages import Name
from l3cli.artifacts import store
from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.table import TransformTable
from l3cli.errors import InputFileError, RecipeError, shortened
from l3cli.frames.correction import CameraFile, correction_in, correction_of
from l3cli.frames.frame import RawFrame
from l3cli.io.raw.cfa_codes import LETTERS, codes_of
from l3cli.io.raw.files import RawOverrides, frame_of
from l3cli.io.raw.files import read_raw as read_raw_file
from l3cli.rendering.conditions import Mix, mixed, nearest_for
from l3cli.rendering.raw_checks import beyond_converter
from l3cli.rendering.renderer import NoiseRenderer
from l3cli.rendering.rendition import OUTPUTS, Following, Rendition, rendered, shown_as
from l3cli.rendering.temporal.chunks import AnyOrder, Chunks, filters
from l3cli.rendering.uncertainty import Uncertainty, uncertainty
from l3cli.rendering.white.scene_white import WhiteBalance
from l3cli.rendering.white.source import WhiteSource, given_white
from l3cli.system.files import sha256
from l3cli.system.locks import ThreadLock
from l3cli.system.text import NoSuchNumber, Quantity


def read_raw(
    path: Name, sensor: TransformTable | CameraModel, *, black_level: float | None = None, white_level: float | None = None,
    phase: tuple[int, int] | None = None, size: tuple[int, int] | None = None, packing: str | None = None,
    stride: int | None = None, exposure: float | None = None, gain: float | None = None, camera: CameraModel | None = None,
    skip: int = 0, byte_order: str | None = None, opcodes: Literal["leave"] | None = None,
) -> RawFrame:  # fmt: skip
    """Return the raw frame in a file of any format that `l3 render` reads, `values` (row, col) in DN.

    `black_level`, `white_level` (DN), `phase` (CFA row and column of the first pixel), `exposure` (s), `gain` (analog, over
    the camera's): in place of what the file states; `size` (rows, columns), `packing`, `stride` (bytes), `skip` (bytes
    before the frame), `byte_order` ("little", "big"): of headerless files. `camera`: model whose defects and flat field are
    corrected. `opcodes`: "leave" reads a DNG without the opcodes, such as a lens warp, that it demands and l3 does not carry
    out. InputFileError if it cannot be read, or has another CFA than the `sensor`.
    """
    correction = None if camera is None else correction_of(camera)
    known = RawOverrides(
        black_level, white_level, phase, size, packing, stride, exposure, gain, correction=correction, skip=skip,
        byte_order=byte_order, opcodes=opcodes,
    )  # fmt: skip
    return read_raw_file(Path(path), sensor, known)


def raw_frame(
    values: NDArray[np.integer], sensor: TransformTable | CameraModel, *, pattern: ArrayLike | None = None,
    black_level: float | None = None, white_level: float | None = None, phase: tuple[int, int] | None = None,
    neutral: Mapping[str, float] | None = None, exposure: float | None = None, gain: float | None = None,
    camera: CameraModel | None = None,
) -> RawFrame:  # fmt: skip
    """Return the raw frame of an array `values` (row, col) in DN, uint8 or uint16, that another program has read.

    `pattern`: letters of R G B C M Y W, (row, col) from the first pixel on or, of a square, in one word, "rggb"; None: the
    sensor's from its first site on, or from `phase`. `neutral`: signal of a grey by letter, as the camera took it. Others as
    in `read_raw`. InputFileError if this is no frame, or has another CFA than the `sensor`.
    """
    known = RawOverrides(
        black_level, white_level, phase, exposure=exposure, gain=gain,
        correction=None if camera is None else correction_of(camera),
    )  # fmt: skip
    content = {} if pattern is None else {"pattern": _codes(pattern)}
    if neutral is not None:
        content["neutral"] = np.array([[*codes_of(letter), signal] for letter, signal in neutral.items()])
    return _of_array(values, sensor, known, content)


def _codes(pattern: ArrayLike) -> NDArray[np.int64]:
    """Return the codes (row, col) of letters; RecipeError if they are none, or no square."""
    letters = np.array(list(pattern) if isinstance(pattern, str) else pattern)
    side = math.isqrt(letters.size)
    if letters.ndim == 1 and side * side == letters.size:
        letters = letters.reshape(side, side)
    if letters.ndim != 2 or not set(text := "".join(letters.ravel()).upper()) <= set(LETTERS) or len(text) != letters.size:
        given = shortened(" ".join(str(pattern).split()))
        raise RecipeError(f"pattern {given} is none; give letters of {LETTERS} (row, col), or as rggb")
    return codes_of(text).reshape(letters.shape)


def _of_array(
    values: NDArray[Any], sensor: TransformTable | CameraModel, known: RawOverrides, content: dict[str, NDArray],
    name: str = "the array", level: int = 3,
) -> RawFrame:  # fmt: skip
    """Return the frame of an array, which is checked; values beyond a table's converter bring a warning `level` calls up."""
    array = np.asarray(values)
    if array.dtype not in (np.uint8, np.uint16) or array.ndim != 2 or not array.size:
        raise InputFileError(
            f"an array of shape {array.shape} and dtype {array.dtype} is not a raw frame; give DN (row, col) as uint16"
        )
    frame = frame_of(name, {"values": array, **content}, sensor, known)  # type: ignore[typeddict-item]
    if isinstance(sensor, TransformTable) and (text := beyond_converter(frame, sensor)):
        warnings.warn(f"{frame.name}: {text}", stacklevel=level)
    return frame


class Renderer:
    """Renderer of frames through a table, one or thousands, from any number of threads (one at a time is at work).

    A frame is what `read_raw` gives, or an array (row, col) of uint16 at the table's black and white level whose first pixel
    has CFA site (0, 0). `backend`: "opencl" or "reference"; `device`, `variant`: of "opencl", as the command's options.
    """

    def __init__(
        self, table: Name | TransformTable, *, backend: str = "opencl", device: str | None = None, variant: str | None = None
    ) -> None:
        self.table = table if isinstance(table, TransformTable) else store.load(TransformTable, Path(table))
        chosen = {name: value for name, value in {"device": device, "variant": variant}.items() if value is not None}
        self._renderer, self._backend, self._chosen = NoiseRenderer(backend, self.table, **chosen), backend, chosen
        self._pictured = self.table.pictured()  # what pictures are made by
        shows_all = self._pictured.outputs == self.table.outputs
        self._pictures = self._renderer if shows_all else NoiseRenderer(backend, self._pictured, **chosen)
        self._renderers: dict[Mix | None, NoiseRenderer] = {None: self._pictures}  # of its lights
        self._alone = ThreadLock()

    def picture(
        self, frame: RawFrame | NDArray[np.uint16], *, exposure: float | None = None, white: str | None = None,
        space: str = "srgb", bits: int = 8,
    ) -> NDArray[Any]:  # fmt: skip
        """Return the picture, upright, (row, col, 3): what `l3 render` writes of the frame. uint8 or uint16 by `bits`; with
        32 float32, linear and not clipped.

        `exposure`: factor of Y, None: the frame's 99th percentile is shown white. `white`: name ("D50", "3200K") or "x,y" of
        the scene's white, a multiplier for each channel ("2.1,1,1.4"), "camera" as the file states it, "auto" estimated on
        the frame, "chart" of a ColorChecker in it, "ROW,COL" or "ROW,COL,SIZE" of a grey in the picture, "table" that of
        training, None: the file's where it states one, else the table's. `space`: "srgb", "display-p3", "rec2020" or,
        linear, "acescg", "xyz".
        RecipeError unless the table's outputs begin with X, Y, Z or are Y alone, InputFileError if the white cannot be
        taken from the frame.
        """
        return next(self.pictures([frame], exposure=exposure, white=white, space=space, bits=bits))

    def pictures(
        self, frames: Iterable[RawFrame | NDArray[np.uint16]], *, exposure: float | None = None, white: str | None = None,
        space: str = "srgb", bits: int = 8,
    ) -> Iterator[NDArray[Any]]:  # fmt: skip
        """Yield `picture` of each frame, in order, as they are asked for; each has its automatic exposure. Of a table of
        several lights they have the transforms of that nearest to the white of the first."""
        renderer, shown = self._pictures, shown_as(self._pictured, exposure, white, space, bits)
        for place, each in enumerate(frames):
            frame = self._frame(each)
            if self.table.lights and place == 0:
                renderer = self._lit(white, shown[1], frame)
                shown = shown_as(renderer.table, exposure, white, space, bits, self._pictured)
            rendition, source = shown
            measured = source.white(frame) if source else None
            yield self._pixels(renderer, frame, rendition, exposure or 0.0, measured.balance if measured else None)

    def sequence(
        self, rate: Fraction | None, *, exposure: float | None = None, white: str | None = None, space: str = "srgb",
        bits: int = 8, temporal: bool = False,
    ) -> Callable[[RawFrame | NDArray[np.uint16]], NDArray[Any]]:  # fmt: skip
        """Return a function that makes the `picture` of each frame of a sequence, called with one after the other.
        Exposure and white that are measured follow at `rate` (frames/s), as in `l3 render` of a sequence; None: they stay
        those of the first frame that it is called with, and the others may come in any order, from any thread.
        `temporal`: frames come in their order and are filtered in time, as in `l3 render --temporal`; RecipeError if the
        table does not know its camera's noise."""
        how = (exposure, white, space, bits)
        shown, starting = shown_as(self._pictured, *how), ThreadLock()
        temporal_filter = Chunks(filters(self._backend, self.table, **self._chosen)) if temporal else None

        def begin(renderer: NoiseRenderer) -> tuple[NoiseRenderer, Rendition, Following]:
            rendition, source = shown if renderer is self._pictures else shown_as(renderer.table, *how, self._pictured)
            return renderer, rendition, Following(renderer.table, rendition, source, rate, temporal_filter)

        begun = None if self.table.lights else begin(self._pictures)

        def picture(given: RawFrame | NDArray[np.uint16]) -> NDArray[Any]:
            nonlocal begun
            frame = self._frame(given)
            with starting:
                begun = begun or begin(self._lit(white, shown[1], frame))
            renderer, rendition, following = begun
            filtered, scale, balance = following.shown(frame)
            return self._pixels(renderer, filtered, rendition, scale, balance)

        return picture

    def outputs(self, frame: RawFrame | NDArray[np.uint16]) -> NDArray[np.float32]:
        """Return the table's outputs, upright, (row, col, output); 1 is `table.output_unit` cd s/m²."""
        return self._pixels(self._renderer, self._frame(frame), OUTPUTS, 0.0, None)

    def uncertainty(self, frame: RawFrame | NDArray[np.uint16], *, like: Uncertainty | None = None) -> Uncertainty:
        """Return the standard deviation (row, col, output) that the camera's noise leaves in `outputs`, upright, and a mask
        of pixels that are clipped or of classes without training patches (docs/measurement.md#uncertainty). `like`: that of
        another frame of the same scene, with which it takes a tenth of the time. RecipeError if the table does not hold its
        camera."""
        given = self._frame(frame)
        with self._alone:
            return uncertainty(self._renderer.of_frame(given), given, like)

    def labels(self, frame: RawFrame | NDArray[np.uint16]) -> NDArray[np.integer]:
        """Return the class (row, col) of every pixel, as the sensor lies."""
        with self._alone:
            return self._renderer.labels(self._frame(frame))

    def _lit(self, white: str | None, source: WhiteSource | None, frame: RawFrame) -> NoiseRenderer:
        """Return the renderer by the table's transforms for the light nearest to a given white, or to that of a frame."""
        found = source.white(frame) if source else given_white(white, self._pictured)
        mix = None if found is None else nearest_for(self._pictured, found.light.xyz)
        with self._alone:
            if mix not in self._renderers:
                made = NoiseRenderer(self._backend, mixed(self._pictured, mix), **self._chosen)
                self._renderers = {None: self._pictures, mix: made}
            return self._renderers[mix]

    def _pixels(
        self, renderer: NoiseRenderer, frame: RawFrame, rendition: Rendition, scale: float, balance: WhiteBalance | None
    ) -> NDArray[Any]:
        with self._alone:
            return rendered(renderer, frame, rendition, scale, balance)[0]

    def _frame(self, given: RawFrame | NDArray[np.uint16]) -> RawFrame:
        if isinstance(given, RawFrame):
            return given
        return _of_array(given, self.table, RawOverrides(), {}, level=4)


PIXELS = Quantity(0, 1_000_000, "pixels", whole=True)


class Mosaics:
    """A table that is open for a host's frames of one size (rows, columns; None: the table's)."""

    def __init__(
        self, table: Name, *, black_level: float | None, white_level: float | None, phase: tuple[int, int] | None,
        size: tuple[int, int] | None, camera: Name | None, backend: str, device: str | None,
    ) -> None:  # fmt: skip
        """Take the options of `l3 render`. RecipeError, InputFileError or DeviceError if they or the table cannot be."""
        self.renderer = Renderer(table, backend=backend, device=device)
        self._filters = functools.partial(filters, backend, self.renderer.table, **({"device": device} if device else {}))
        sensor = self.renderer.table
        self._size = size or (sensor.rows, sensor.cols)
        model = None if camera is None else CameraFile(Path(camera).absolute(), sha256(Path(camera)))
        correction = None if model is None else correction_in(model, sensor)
        self._known = RawOverrides(black_level, white_level, phase, correction=correction)

    def require_size(self, rows: int, cols: int) -> None:
        """Raise RecipeError unless frames have the size that is expected: others may begin at another site of the array."""
        if (rows, cols) != self._size:
            raise RecipeError(
                f"frames of {rows}×{cols} pixels (rows × columns) are not of the {self._size[0]}×{self._size[1]} "
                f"expected; if they are meant, give ‹size› {rows}x{cols}, and ‹phase› if they begin at another CFA site"
            )

    def in_time(self, read: Callable[[int], RawFrame], cache: int) -> AnyOrder:
        """Return a temporal filter of frames that are asked for in any order; `read`: gives the raw frame of a number.
        RecipeError if the table does not know its camera's noise."""
        return AnyOrder(self._filters(), read, cache)

    def frame(self, values: NDArray[Any], order: str | None = None) -> RawFrame:
        """Return the raw frame of values (row, col) in DN. `order`: colours of a Bayer array from its first pixel on,
        "rggb", as the host states them, None: the table's. InputFileError if they do not fit."""
        pattern = {} if order is None else {"pattern": _codes(order)}
        return _of_array(values, self.renderer.table, self._known, pattern, "the frame")


def pair(text: str, separator: str, name: str) -> tuple[int, int] | None:
    """Return two whole numbers, "720x1280" or "0,1"; None where there is no text. RecipeError if it is something else."""
    if not text:
        return None
    try:
        first, second = (int(PIXELS.read(part)) for part in text.split(separator))
    except (NoSuchNumber, ValueError):
        raise RecipeError(f'{name} "{text}" is not two whole numbers with "{separator}" between them') from None
    return first, second
