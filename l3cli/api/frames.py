"""Load and render raw frames in memory.

`read_raw` reads a raw frame from a file, and `raw_frame` creates one from an array. `Renderer` renders raw frames. `Mosaics`
creates raw frames from the frames of video software, for the plugins in l3cli/video_hosts.
"""

import functools
import math
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
from l3cli.system.console import PythonWarnings, warn_caller
from l3cli.system.files import sha256
from l3cli.system.locks import ThreadLock
from l3cli.system.text import NoSuchNumber, Quantity


def read_raw(
    path: Name, sensor: TransformTable | CameraModel, *, black_level: float | None = None, white_level: float | None = None,
    phase: tuple[int, int] | None = None, size: tuple[int, int] | None = None, packing: str | None = None,
    stride: int | None = None, exposure: float | None = None, gain: float | None = None, camera: CameraModel | None = None,
    skip: int = 0, byte_order: str | None = None, opcodes: Literal["leave"] | None = None,
) -> RawFrame:  # fmt: skip
    """Read a raw frame from a file of any format that `l3 render` supports.

    Parameters
    ----------
    path : str or path
        Raw file.
    sensor : TransformTable or CameraModel
        Transform table or model of the camera that took the frame. Its filter array must match the file's filter array.
    black_level, white_level : float, optional
        Black and white level in DN. [default: the levels in the file, otherwise the levels of `sensor`]
    phase : (int, int), optional
        CFA row and column of the first pixel, counted from 0. [default: the phase in the file, otherwise (0, 0)]
    size : (int, int), optional
        Headerless files only: number of rows and columns. [default: the size of `sensor`]
    packing : str, optional
        Headerless files only: pixel format, such as "u16", "raw10" or "Mono12Packed". [default: MIPI for .raw10 and .raw12
        files, otherwise "u16"]
    stride : int, optional
        Headerless files only: number of bytes from the start of one row to the next. [default: rows without padding]
    exposure : float, optional
        Exposure time in s, for which l3 subtracts the dark signal. [default: the exposure time in the file, otherwise the
        training exposure if `sensor` is a table]
    gain : float, optional
        Analog gain relative to the gain in the camera model. [default: the gain that l3 derives from the file]
    camera : CameraModel, optional
        Camera model with the defect map and the flat field that are used to correct the frame. [default: no correction]
    skip : int, default 0
        Headerless files only: number of bytes before the first pixel.
    byte_order : {"little", "big"}, optional
        Headerless files only: byte order of 16-bit values. [default: "little"]
    opcodes : {"leave"}, optional
        DNG files only: "leave" ignores lens-distortion opcodes, and also required opcodes that l3 does not support.
        [default: correct lens distortion, and reject files with unsupported required opcodes]

    Returns
    -------
    RawFrame
        The frame. The attribute `values`, (row, col), contains the raw values in DN. Other attributes contain the black
        and white level, the CFA phase and the file's metadata.

    Raises
    ------
    InputFileError
        If the file cannot be read, or if its filter array does not match the filter array of `sensor`.
    RecipeError
        If an argument is invalid.

    Examples
    --------
    >>> import l3cli as l3
    >>> frame = l3.read_raw("unseen/00000_composition-5-0_raw.tif", l3.load_table("table.h5"))
    >>> frame.values.shape, frame.values.dtype
    ((160, 240), dtype('uint16'))
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
    """Create a raw frame from an array of raw values.

    Use this function if another library has read the raw values. For files that l3 can read, use `read_raw`.

    Parameters
    ----------
    values : ndarray of uint8 or uint16, (row, col)
        Mosaic in DN.
    sensor : TransformTable or CameraModel
        Transform table or model of the camera that took the frame.
    pattern : array_like of str, optional
        CFA pattern, (row, col): one letter (R, G, B, C, M, Y or W) per filter, starting at the first pixel. A square
        pattern can also be one word, such as "rggb". [default: the filter array of `sensor`, starting at `phase`]
    black_level, white_level : float, optional
        Black and white level in DN. [default: the levels of `sensor`]
    phase : (int, int), optional
        CFA row and column of the first pixel, counted from 0. [default: (0, 0)]
    neutral : mapping of str to float, optional
        Camera white balance: the signal above black of a grey object for each letter of the pattern, in any common unit.
        [default: no white balance]
    exposure : float, optional
        Exposure time in s, for which l3 subtracts the dark signal. [default: the training exposure if `sensor` is a table,
        otherwise no dark signal is subtracted]
    gain : float, optional
        Analog gain relative to the gain in the camera model. [default: 1]
    camera : CameraModel, optional
        Camera model with the defect map and the flat field that are used to correct the frame. [default: no correction]

    Returns
    -------
    RawFrame
        The frame, which you can pass to `Renderer`.

    Raises
    ------
    InputFileError
        If `values` is not a mosaic of uint8 or uint16, or if `pattern` does not match the filter array of `sensor`.
    RecipeError
        If `pattern` contains an unknown letter or is not rectangular.

    Warns
    -----
    UserWarning
        If `sensor` is a table and a value exceeds the bit depth of its camera.

    Examples
    --------
    >>> import numpy as np
    >>> import l3cli as l3
    >>> frame = l3.raw_frame(np.full((48, 64), 500, np.uint16), l3.load_camera("bayer"), phase=(0, 1))
    >>> frame.values.shape, frame.phase
    ((48, 64), (0, 1))
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
    """Convert a CFA pattern of letters, such as "rggb", to an array of colour codes, (row, col).

    The number of letters in a word must be a perfect square. The letters fill the array row by row.
    """
    letters = np.array(list(pattern) if isinstance(pattern, str) else pattern)
    side = math.isqrt(letters.size)
    if letters.ndim == 1 and side * side == letters.size:
        letters = letters.reshape(side, side)
    if letters.ndim != 2 or not set(text := "".join(letters.ravel()).upper()) <= set(LETTERS) or len(text) != letters.size:
        excerpt = shortened(" ".join(str(pattern).split()))
        raise RecipeError(
            f'the pattern {excerpt} is not a filter array; pass rows of the letters {LETTERS}, or a word such as "rggb"'
        )
    return codes_of(text).reshape(letters.shape)


def _of_array(
    values: NDArray[Any], sensor: TransformTable | CameraModel, known: RawOverrides, content: dict[str, NDArray],
    name: str = "the array",
) -> RawFrame:  # fmt: skip
    """Check an array of raw values, and create a raw frame from it."""
    array = np.asarray(values)
    if array.dtype not in (np.uint8, np.uint16) or array.ndim != 2 or not array.size:
        raise InputFileError(
            f"an array with shape {array.shape} and dtype {array.dtype} is not a raw frame; pass raw values (row, col) as "
            "uint8 or uint16"
        )
    frame = frame_of(name, {"values": array, **content}, sensor, known)  # type: ignore[typeddict-item]
    if isinstance(sensor, TransformTable) and (text := beyond_converter(frame, sensor)):
        warn_caller(f"{frame.name}: {text}")
    return frame


class Renderer:
    """Renders raw frames with a transform table, either to pictures or to the table's linear outputs.

    Several threads can share a renderer. It renders one frame at a time.

    Parameters
    ----------
    table : str, path or TransformTable
        Transform table of the camera.
    backend : {"opencl", "reference"}, default "opencl"
        "opencl" runs the OpenCL kernels. "reference" computes in float64 with numpy, which is slow.
    device : str, optional
        OpenCL device: part of its name, or its number in the output of `l3 bench --list`. [default: the environment
        variable L3_DEVICE]
    variant : {"processor", "graphics"}, optional
        Kernels for CPUs ("processor") or for GPUs ("graphics"). [default: depends on the device type]

    Attributes
    ----------
    table : TransformTable
        The transform table.

    Raises
    ------
    InputFileError
        If `table` is the path of a file that is not a transform table.
    DeviceError
        If the OpenCL device does not work.

    Notes
    -----
    All methods accept frames as `RawFrame` (from `read_raw` or `raw_frame`) or as arrays of uint8 or uint16 with the
    shape (row, col). For an array, l3 uses the table's black and white level, and assumes that the first pixel is at CFA
    site (0, 0).

    Examples
    --------
    >>> import l3cli as l3
    >>> renderer = l3.Renderer("table.h5")
    >>> frame = l3.read_raw("unseen/00000_composition-5-0_raw.tif", renderer.table)
    >>> picture = renderer.picture(frame)
    >>> picture.shape, picture.dtype
    ((160, 240, 3), dtype('uint8'))
    """

    def __init__(
        self, table: Name | TransformTable, *, backend: str = "opencl", device: str | None = None, variant: str | None = None
    ) -> None:
        self.table = table if isinstance(table, TransformTable) else store.load(TransformTable, Path(table))
        chosen = {name: value for name, value in {"device": device, "variant": variant}.items() if value is not None}
        self._renderer, self._backend, self._chosen = NoiseRenderer(backend, self.table, **chosen), backend, chosen
        self._pictured = self.table.pictured()  # the table, reduced to the outputs that pictures need
        shows_all = self._pictured.outputs == self.table.outputs
        self._pictures = self._renderer if shows_all else NoiseRenderer(backend, self._pictured, **chosen)
        # One renderer per mixture of training illuminants. The key None stands for the transforms common to all illuminants.
        self._renderers: dict[Mix | None, NoiseRenderer] = {None: self._pictures}
        self._alone = ThreadLock()

    def picture(
        self, frame: RawFrame | NDArray[np.uint16], *, exposure: float | None = None, white: str | None = None,
        space: str = "srgb", bits: int = 8,
    ) -> NDArray[Any]:  # fmt: skip
        """Render one frame to a picture, with the same pixel values as in a picture from `l3 render`.

        Parameters
        ----------
        frame : RawFrame or ndarray, (row, col)
            Raw frame.
        exposure : float, optional
            Factor by which X, Y and Z are multiplied. After the multiplication, Y = 1 is display white. [default: the
            factor that makes the 99th percentile of Y white]
        white : str, optional
            White of the scene, which becomes neutral in the picture:

            * an illuminant ("D50", "3200K") or a chromaticity "x,y";
            * one multiplier for each channel ("2.1,1,1.4");
            * "camera" (the white balance in the file) or "table" (the white used in training);
            * "auto" (estimated from the frame) or "chart" (measured on a ColorChecker in the frame);
            * "ROW,COL" or "ROW,COL,SIZE" (position and size of a grey area in the picture, in pixels).

            [default: "camera" if the frame contains a white balance, otherwise "table"]
        space : {"srgb", "display-p3", "rec2020", "acescg", "xyz"}, default "srgb"
            Colour space. "acescg" and "xyz" are linear.
        bits : {8, 16, 32}, default 8
            Bits per value. 32 returns float32 values that are linear and not clipped.

        Returns
        -------
        ndarray of uint8, uint16 or float32, (row, col, 3)
            The picture, rotated upright.

        Raises
        ------
        RecipeError
            If an argument is invalid, or if the table's outputs are neither Y alone nor begin with X, Y and Z.
        InputFileError
            If the frame does not fit the table, or if the white cannot be measured in the frame.

        Warns
        -----
        UserWarning
            If `white` is far from the training illuminants, or if a camera channel collects more than 1 % of its electrons
            at wavelengths for which the illuminant's spectrum is unknown.

        Examples
        --------
        >>> import numpy as np
        >>> import l3cli as l3
        >>> renderer = l3.Renderer("table.h5")
        >>> frame = l3.raw_frame(np.full((48, 64), 500, np.uint16), renderer.table)
        >>> picture = renderer.picture(frame, white="D65", bits=16)
        >>> picture.shape, picture.dtype
        ((48, 64, 3), dtype('uint16'))
        """
        return next(self.pictures([frame], exposure=exposure, white=white, space=space, bits=bits))

    def pictures(
        self, frames: Iterable[RawFrame | NDArray[np.uint16]], *, exposure: float | None = None, white: str | None = None,
        space: str = "srgb", bits: int = 8,
    ) -> Iterator[NDArray[Any]]:  # fmt: skip
        """Render frames lazily, one after the other, and determine automatic exposure separately for each frame.

        If the table has transforms for several illuminants, the white of the first frame determines the transforms for
        all frames.

        Parameters
        ----------
        frames : iterable of RawFrame or ndarray, (row, col)
            Raw frames, for example a list or a generator.
        exposure : float, optional
            Factor by which X, Y and Z are multiplied. After the multiplication, Y = 1 is display white. [default: the
            factor that makes the 99th percentile of Y white, separately for each frame]
        white : str, optional
            White of the scene, in any form that `picture` accepts. [default: "camera" for frames that contain a white
            balance, otherwise "table"]
        space : {"srgb", "display-p3", "rec2020", "acescg", "xyz"}, default "srgb"
            Colour space. "acescg" and "xyz" are linear.
        bits : {8, 16, 32}, default 8
            Bits per value. 32 returns float32 values that are linear and not clipped.

        Returns
        -------
        iterator of ndarray of uint8, uint16 or float32, (row, col, 3)
            The picture of each frame, rotated upright.

        Raises
        ------
        RecipeError, InputFileError
            As in `picture`, when the iterator is advanced.

        Examples
        --------
        >>> import numpy as np
        >>> import l3cli as l3
        >>> renderer = l3.Renderer("table.h5")
        >>> dark, bright = np.full((48, 64), 300, np.uint16), np.full((48, 64), 500, np.uint16)
        >>> [picture.shape for picture in renderer.pictures([dark, bright])]
        [(48, 64, 3), (48, 64, 3)]
        """
        renderer, shown = self._pictures, self._shown_as(exposure, white, space, bits)
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
        """Return a function that renders a sequence frame by frame.

        If `rate` is set, automatic exposure and measured white change smoothly over time, as in `l3 render`, and you must
        pass the frames in order. If `rate` is None, all frames get the exposure and the white of the first frame that you
        pass. You can then pass the other frames in any order and from any thread, unless `temporal` is set.

        Parameters
        ----------
        rate : Fraction or None
            Frame rate in frames/s.
        exposure : float, optional
            Factor by which X, Y and Z are multiplied. After the multiplication, Y = 1 is display white. [default: the
            factor that makes the 99th percentile of Y white]
        white : str, optional
            White of the scene, in any form that `picture` accepts. [default: "camera" if the frame contains a white
            balance, otherwise "table"]
        space : {"srgb", "display-p3", "rec2020", "acescg", "xyz"}, default "srgb"
            Colour space. "acescg" and "xyz" are linear.
        bits : {8, 16, 32}, default 8
            Bits per value. 32 returns float32 values that are linear and not clipped.
        temporal : bool, default False
            Whether to filter the frames over time, as `l3 render --temporal` does. You must then pass the frames in order.

        Returns
        -------
        callable
            Function that takes a raw frame and returns its picture, (row, col, 3), as `picture` does.

        Raises
        ------
        RecipeError
            If an argument is invalid, or if `temporal` is set and the table does not contain its camera's noise model.

        Examples
        --------
        >>> from fractions import Fraction
        >>> import numpy as np
        >>> import l3cli as l3
        >>> render_next = l3.Renderer("table.h5").sequence(Fraction(25), bits=16)
        >>> render_next(np.full((48, 64), 500, np.uint16)).shape
        (48, 64, 3)
        """
        how = (exposure, white, space, bits)
        shown, starting = self._shown_as(*how), ThreadLock()
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
        """Render one frame to the table's linear outputs, without exposure, white balance or encoding.

        Parameters
        ----------
        frame : RawFrame or ndarray, (row, col)
            Raw frame.

        Returns
        -------
        ndarray of float32, (row, col, output)
            Outputs in the order of `table.outputs`, rotated upright. Y = 1 corresponds to a luminance × exposure time of
            `table.output_unit` cd s/m².

        Examples
        --------
        >>> import numpy as np
        >>> import l3cli as l3
        >>> renderer = l3.Renderer("table.h5")
        >>> renderer.table.outputs, renderer.outputs(np.full((48, 64), 500, np.uint16)).shape
        (('X', 'Y', 'Z'), (48, 64, 3))
        """
        return self._pixels(self._renderer, self._frame(frame), OUTPUTS, 0.0, None)

    def uncertainty(self, frame: RawFrame | NDArray[np.uint16], *, like: Uncertainty | None = None) -> Uncertainty:
        """Estimate the uncertainty of the outputs due to camera noise (docs/measurement.md#uncertainty).

        Parameters
        ----------
        frame : RawFrame or ndarray, (row, col)
            Raw frame with at least 32 × 32 pixels.
        like : Uncertainty, optional
            Uncertainty of a previous frame of the same scene. l3 reuses that frame's noise gains, which reduces the
            computing time to a tenth.

        Returns
        -------
        Uncertainty
            The attribute `sigma`, (row, col, output), contains the standard deviation of each output. The attribute
            `mask`, (row, col), is 1 for pixels affected by clipping, 2 for pixels in classes without training patches, 3
            for pixels with both problems, and 0 for all other pixels. Both arrays are rotated upright.

        Raises
        ------
        RecipeError
            If the table does not contain its camera model, or if the frame is smaller than 32 × 32 pixels.

        Examples
        --------
        >>> import numpy as np
        >>> import l3cli as l3
        >>> found = l3.Renderer("table.h5").uncertainty(np.full((48, 64), 500, np.uint16))
        >>> found.sigma.shape, found.mask.shape
        ((48, 64, 3), (48, 64))
        """
        given = self._frame(frame)
        with self._alone:
            return uncertainty(self._renderer.of_frame(given), given, like)

    def labels(self, frame: RawFrame | NDArray[np.uint16]) -> NDArray[np.integer]:
        """Determine which class, and therefore which transform, the renderer uses for each pixel.

        Parameters
        ----------
        frame : RawFrame or ndarray, (row, col)
            Raw frame.

        Returns
        -------
        ndarray of int, (row, col)
            Class numbers in sensor orientation. Unlike pictures, they are not rotated upright.

        Examples
        --------
        >>> import numpy as np
        >>> import l3cli as l3
        >>> l3.Renderer("table.h5").labels(np.full((48, 64), 500, np.uint16)).shape
        (48, 64)
        """
        with self._alone:
            return self._renderer.labels(self._frame(frame))

    def _shown_as(
        self, exposure: float | None, white: str | None, space: str, bits: int
    ) -> tuple[Rendition, WhiteSource | None]:
        """Return the picture settings, and the method that determines each frame's white.

        The method is None for an explicit white, such as "D50". l3 warns if that white is far from the training illuminants.
        """
        rendition, source = shown_as(self._pictured, exposure, white, space, bits)
        if white is not None and source is None and (given := given_white(white, self._pictured)) is not None:
            from l3cli.stages.rendering.job import warn_of_white  # slow import that few callers need

            warn_of_white(white, given, self._pictured, PythonWarnings())
        return rendition, source

    def _lit(self, white: str | None, source: WhiteSource | None, frame: RawFrame) -> NoiseRenderer:
        """Return the renderer with the transforms for the frame's white (from `source`), or for `white` if `source` is None.

        Only the latest renderer is cached, in addition to the renderer with the common transforms.
        """
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
        return _of_array(given, self.table, RawOverrides(), {})


PIXELS = Quantity(0, 1_000_000, "pixels", whole=True)


class Mosaics:
    """Creates raw frames from the frames of video software. All frames must have the same size.

    The plugins in l3cli/video_hosts convert their frames with this class, and render them with the attribute `renderer`.

    Parameters
    ----------
    table : str or path
        Transform table of the camera (.h5).
    black_level, white_level : float or None
        Black and white level in DN, or None for the table's levels.
    phase : (int, int) or None
        CFA row and column of each frame's first pixel, counted from 0, or None for (0, 0).
    size : (int, int) or None
        Number of rows and columns, or None for the size of the table's camera.
    camera : str, path or None
        Camera model with the defect map and the flat field that are used to correct the frames, or None for no correction.
    backend : {"opencl", "reference"}
        Backend, as in `Renderer`.
    device : str or None
        OpenCL device, as in `Renderer`.

    Attributes
    ----------
    renderer : Renderer
        Renderer for the converted frames.

    Raises
    ------
    RecipeError, InputFileError, DeviceError
        If an option or the table cannot be used.
    """

    def __init__(
        self, table: Name, *, black_level: float | None, white_level: float | None, phase: tuple[int, int] | None,
        size: tuple[int, int] | None, camera: Name | None, backend: str, device: str | None,
    ) -> None:  # fmt: skip
        self.renderer = Renderer(table, backend=backend, device=device)
        self._filters = functools.partial(filters, backend, self.renderer.table, **({"device": device} if device else {}))
        sensor = self.renderer.table
        self._size = size or (sensor.rows, sensor.cols)
        model = None if camera is None else CameraFile(Path(camera).absolute(), sha256(Path(camera)))
        correction = None if model is None else correction_in(model, sensor)
        self._known = RawOverrides(black_level, white_level, phase, correction=correction)

    def require_size(self, rows: int, cols: int) -> None:
        """Raise RecipeError if a frame size differs from the expected size.

        A frame with another size may have been cropped, and may therefore start at a different CFA site.
        """
        if (rows, cols) != self._size:
            raise RecipeError(
                f"the frames have {rows}×{cols} pixels (rows × columns) instead of {self._size[0]}×{self._size[1]}; if this "
                f"is correct, set ‹size› {rows}x{cols}, and set ‹phase› if the frames start at a different CFA site"
            )

    def in_time(self, read: Callable[[int], RawFrame], cache: int) -> AnyOrder:
        """Create a temporal filter from which filtered frames can be requested in any order.

        Parameters
        ----------
        read : callable
            Function that takes a frame number and returns the raw frame.
        cache : int
            Number of filtered frames that are kept in memory.

        Raises
        ------
        RecipeError
            If the table does not contain its camera's noise model.
        """
        return AnyOrder(self._filters(), read, cache)

    def frame(self, values: NDArray[Any], order: str | None = None) -> RawFrame:
        """Create a raw frame from an array of raw values.

        Parameters
        ----------
        values : ndarray of uint8 or uint16, (row, col)
            Mosaic in DN.
        order : str, optional
            Bayer pattern that the video software reports for the first 2 × 2 pixels, such as "rggb". [default: the table's
            filter array]

        Raises
        ------
        InputFileError
            If the array is not a mosaic, or if `order` does not match the table's filter array.
        """
        pattern = {} if order is None else {"pattern": _codes(order)}
        return _of_array(values, self.renderer.table, self._known, pattern, "the frame")


def pair(text: str, separator: str, name: str) -> tuple[int, int] | None:
    """Parse two whole numbers from text such as "720x1280" or "0,1".

    Parameters
    ----------
    text : str
        The text. It is empty if the option is not set.
    separator : str
        Text between the two numbers, such as "x".
    name : str
        Name of the option, for the error message.

    Returns
    -------
    (int, int) or None
        The two numbers, or None if `text` is empty.

    Raises
    ------
    RecipeError
        If the text does not consist of two numbers from 0 to 1,000,000.
    """
    if not text:
        return None
    try:
        first, second = (int(PIXELS.read(part)) for part in text.split(separator))
    except (NoSuchNumber, ValueError):
        raise RecipeError(f'{name} is "{text}"; write two whole numbers with "{separator}" between them') from None
    return first, second
