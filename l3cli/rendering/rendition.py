"""Render frames to pictures with a given colour space, bit depth, exposure and white balance.

Exposure and white balance are either set by the user or measured in the frames.
"""

import itertools
import math
from dataclasses import dataclass, replace
from fractions import Fraction
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.errors import RecipeError, suggestion
from l3cli.frames.frame import RawFrame, upright
from l3cli.frames.lens_warp import warped
from l3cli.physics.display import FLOAT_BITS, Tone
from l3cli.physics.spaces import SPACES, SRGB, XYZ, Space, chromaticity_of
from l3cli.rendering.display import Display, adapted_display, linear_matrix, require_xyz, shown_adaptation
from l3cli.rendering.exposure import LightMeter, SteadyExposure, still_scale
from l3cli.rendering.polarisation import in_upright_frame, picture_of, planes_in_files
from l3cli.rendering.renderer import Renderer
from l3cli.rendering.temporal.chunks import Chunks
from l3cli.rendering.white.scene_white import SceneWhite, SteadyWhite, WhiteBalance, balanced
from l3cli.rendering.white.source import WhiteSource, given_white, usual_balance, white_source
from l3cli.system.locks import ThreadLock

DEPTHS = (8, 16, FLOAT_BITS)
MIN_EXPOSURE, MAX_EXPOSURE = 1e-9, 1e9  # allowed range of the exposure, by which Y is multiplied
ANY_RATE = Fraction(30)  # frame rate if only the first frame is measured; its value then has no effect


@dataclass(frozen=True)
class Rendition:
    """Settings for converting a table's outputs to pictures."""

    balance: WhiteBalance | None  # fixed white balance, unless one is measured per frame; None: write the outputs unchanged
    exposure: float | None  # factor by which Y is multiplied; None: automatic exposure
    bits: int  # bits per value: 8, 16 or FLOAT_BITS
    space: Space | None = SRGB  # None: the outputs are not colours
    raw: bool = False  # whether the file is for a raw converter; the exposure is then recorded but not applied
    mosaic: str | None = None  # CFA name in the file format, if `raw` is true and the picture is a mosaic
    stops: float = 0.0  # additional exposure in EV
    stated_exposure: bool = False  # whether to apply the baseline exposure recorded in each raw file
    tone: Tone | None = None
    polarisation: str | None = None  # one of `polarisation.SHOWN`; None: the picture does not show polarisation

    @property
    def is_linear(self) -> bool:
        """Whether the picture stores linear floating-point values."""
        return self.space is None or self.space.curve is None

    @property
    def measures_exposure(self) -> bool:
        """Whether the exposure is automatic."""
        return self.balance is not None and self.exposure is None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of a pixel's three values, as in an OpenEXR file."""
        return ("X", "Y", "Z") if self.space and self.space.name == XYZ.name else ("R", "G", "B")


OUTPUTS = Rendition(None, None, FLOAT_BITS, None)  # writes the outputs of the table unchanged


def chosen_space(name: str | None, linear: bool) -> Space:
    """Look up a colour space by name.

    Parameters
    ----------
    name : str or None
        Name of the colour space. None means sRGB.
    linear : bool
        Whether to omit the transfer curve, for linear floating-point values.

    Returns
    -------
    Space

    Raises
    ------
    RecipeError
        If the name is unknown, or if `linear` is false but the colour space has no transfer curve.
    """
    if name is not None and name not in SPACES:
        raise RecipeError(f'space "{name}" is unknown; {suggestion(name, SPACES)}')
    space = SPACES[name or SRGB.name]
    if linear:
        return replace(space, title=f"{space.title}, linear", curve=None) if space.curve else space
    if space.curve is None:
        raise RecipeError(
            f"{name} is a linear colour space and cannot be stored as integers; write an .exr file, or a .tif file with "
            "‹bits› 32"
        )
    return space


def outputs_as_they_are(table: TransformTable) -> Rendition:
    """Return the settings for writing a table's outputs unchanged. X, Y and Z are tagged as CIE XYZ."""
    if table.outputs != ("X", "Y", "Z"):
        return OUTPUTS
    return replace(OUTPUTS, space=replace(XYZ, title="CIE XYZ", neutral=chromaticity_of(table.white_point)))


def shown_as(
    table: TransformTable, exposure: float | None, white: str | None, space: str, bits: int,
    estimated_by: TransformTable | None = None,
) -> tuple[Rendition, WhiteSource | None]:  # fmt: skip
    """Validate picture settings from a user, and convert them to a rendition.

    Parameters
    ----------
    table : TransformTable
        Table that renders the frames.
    exposure : float or None
        Factor by which Y is multiplied, or None for automatic exposure.
    white : str or None
        White point, as in `white_source` and `given_white`.
    space : str
        Name of the colour space.
    bits : int
        Bits per value: 8, 16 or FLOAT_BITS.
    estimated_by : TransformTable, optional
        Table with which "auto" estimates the white, as in `white_source`.

    Returns
    -------
    rendition : Rendition
        Settings of the pictures.
    source : WhiteSource or None
        Finds the white of each frame. None if all frames use the white balance of the rendition.

    Raises
    ------
    RecipeError
        If an argument is invalid, or if the table has neither the outputs X, Y and Z, nor Y alone, nor Stokes parameters.
    """
    if exposure is not None and not (isinstance(exposure, Real) and MIN_EXPOSURE <= exposure <= MAX_EXPOSURE):
        given_as = f"{exposure:g}" if isinstance(exposure, Real) else f'"{exposure}"'
        raise RecipeError(
            f"exposure {given_as} is not within {MIN_EXPOSURE:g}…{MAX_EXPOSURE:g}; set a factor for Y in this range, or "
            "omit exposure for automatic exposure"
        )
    if bits not in DEPTHS:
        raise RecipeError(f"pictures cannot have {bits} bits; use 8, 16 or {FLOAT_BITS}")
    require_xyz(table.outputs)
    source = white_source(white, table, photos=True, estimated_by=estimated_by)
    given = None if source else given_white(white, table)
    balance = given.balance if given else usual_balance(table)
    return Rendition(balance, exposure, bits, chosen_space(space, bits == FLOAT_BITS)), source


def rendered(
    renderer: Renderer, frame: RawFrame, rendition: Rendition, scale: float, balance: WhiteBalance | None = None
) -> tuple[NDArray[Any], float]:
    """Render a frame to a picture.

    Parameters
    ----------
    renderer : Renderer
        Renderer for the table.
    frame : RawFrame
        Frame to render.
    rendition : Rendition
        Settings of the picture.
    scale : float
        Exposure scale, or 0 for automatic exposure.
    balance : WhiteBalance, optional
        White balance of the frame. [default: the white balance of the rendition]

    Returns
    -------
    pixels : ndarray, (row, col, value)
        The picture, turned upright.
    scale : float
        Exposure scale. It is not applied to pictures for raw converters.
    """
    balance = balance or rendition.balance
    if balance is not None and not rendition.is_linear:
        balanced_frame, display = frame_and_display(renderer, frame, rendition, balance, scale)
        if frame.warps:
            moved = warped(renderer.outputs(balanced_frame), renderer.table.outputs, frame.warps)
            return upright(renderer.encoded(moved, display), frame.orientation), scale
        return upright(renderer.picture(balanced_frame, display), frame.orientation), scale
    frame = frame if balance is None else balanced(frame, renderer.table, balance.gains)
    outputs, names = renderer.outputs(frame), renderer.table.outputs
    planes = warped(outputs, names, frame.warps)
    if balance is None:
        planes = in_upright_frame(planes, names, frame.orientation)
        if rendition.polarisation is not None:
            return picture_of(planes, names, rendition.polarisation, rendition.bits), scale
        return np.moveaxis(planes_in_files(planes, names), 0, -1), scale
    if balance is not None and rendition.space is not None:
        scale = (scale * balance.luminance or still_scale(outputs[1], frame, renderer.table)) * 2**rendition.stops
        adaptation = shown_adaptation(renderer.table, balance.adaptation)
        matrix = linear_matrix(adaptation, 1.0 if rendition.raw else scale, rendition.space)
        planes = np.einsum("po,orc->prc", matrix.astype(np.float32), planes[:3])
    return upright(np.moveaxis(planes, 0, -1), frame.orientation), scale


def frame_and_display(
    renderer: Renderer, frame: RawFrame, rendition: Rendition, balance: WhiteBalance, scale: float
) -> tuple[RawFrame, Display]:
    """Apply white-balance gains to a frame, and determine the display settings for its picture.

    A `scale` of 0 means automatic exposure.
    """
    frame = balanced(frame, renderer.table, balance.gains)
    # The automatic exposure of a still requires the luminance of all pixels before encoding. If the renderer processes the
    # frame in one piece, the outputs remain on the device for encoding. Larger frames are rendered twice.
    scale = scale * balance.luminance or still_scale(renderer.outputs(frame)[1], frame, renderer.table)
    scale *= 2**rendition.stops
    adaptation = shown_adaptation(renderer.table, balance.adaptation)
    return frame, adapted_display(adaptation, scale, rendition.bits, rendition.space or SRGB, rendition.tone)


class FrameMeter:
    """Determines the exposure scale and the white balance, frame by frame.

    In a sequence, both follow the measurements smoothly. If the white is measured on a grey object or a chart, it is
    measured only in the first frame. Each still has its own white, and its automatic exposure is determined after rendering.

    Parameters
    ----------
    table : TransformTable
        Table that renders the frames.
    rendition : Rendition
        Settings of the pictures.
    source : WhiteSource or None
        Finds the white of each frame. None for the white of the rendition.
    rate : Fraction or None
        Frames per second of a sequence, or None for stills.
    """

    def __init__(
        self, table: TransformTable, rendition: Rendition, source: WhiteSource | None, rate: Fraction | None
    ) -> None:
        self._source, self._fixed, self._stated = source, rendition.exposure or 0.0, rendition.stated_exposure
        self._light = LightMeter(table) if rate is not None and rendition.measures_exposure else None
        self._exposure = None if rate is None else SteadyExposure(rate)
        self._white = None if rate is None else SteadyWhite(rate)
        self._first: SceneWhite | None = None
        self._balance: WhiteBalance | None = None

    def __bool__(self) -> bool:
        return bool(self._light or self._source or self._stated)

    def measured(self, frame: RawFrame) -> tuple[float, WhiteBalance | None, SceneWhite | None]:
        """Measure the exposure and the white balance of the next frame.

        Returns
        -------
        scale : float
            Exposure scale, or 0 if it must be determined after rendering.
        balance : WhiteBalance or None
            White balance, or None for the white balance of the rendition.
        white : SceneWhite or None
            Measured white. None if it is not measured, or if the frame has no usable pixels.

        Raises
        ------
        InputFileError
            If the white cannot be measured in the frame.
        """
        brightness, balance, white = self.looked_at(frame)
        return self.scale(frame, brightness), balance, white

    def looked_at(self, frame: RawFrame) -> tuple[float, WhiteBalance | None, SceneWhite | None]:
        """Measure the brightness and the white balance of the next frame, without updating the exposure.

        Returns
        -------
        brightness : float
            Luminance to display as white, or 0 if the brightness is not measured.
        balance, white
            As in `measured`.
        """
        white = self._measured_white(frame) if self._source else None
        return self._light.brightness(frame, self._balance) if self._light else 0.0, self._balance, white

    def scale(self, frame: RawFrame, brightness: float, flicker: float = 0.0) -> float:
        """Return the exposure scale for the next frame, or 0 if it must be determined after rendering.

        Parameters
        ----------
        frame : RawFrame
            The next frame.
        brightness : float
            Brightness of the frame, from `looked_at`.
        flicker : float
            Natural logarithm of the factor by which flicker brightens the frame. The scale compensates for it.
        """
        steady = math.exp(-flicker)
        if self._light and self._exposure:
            return self._exposure.scale(brightness * steady, frame.gain) * steady
        stated = 2**frame.baseline_exposure if self._stated else 1.0
        return self._fixed * stated * steady

    def _measured_white(self, frame: RawFrame) -> SceneWhite | None:
        assert self._source is not None
        if self._white is not None and self._first is not None and self._source.held:
            return self._first
        white = self._source.white(frame)
        self._first = self._first or white
        wanted = white.balance if white else None
        self._balance = self._white.balance(wanted) if self._white else wanted
        return white


class Following:
    """Measures exposure and white balance frame by frame, and applies the temporal filter.

    Parameters
    ----------
    table, rendition, source
        As in `FrameMeter`.
    rate : Fraction or None
        Frames per second. If None, all frames use the exposure scale and the white balance of the first frame.
    temporal : Chunks, optional
        Temporal filter. [default: frames are not filtered]
    """

    def __init__(
        self, table: TransformTable, rendition: Rendition, source: WhiteSource | None, rate: Fraction | None,
        temporal: Chunks | None = None,
    ) -> None:  # fmt: skip
        self._held, self._temporal = rate is None, temporal
        self._meter = FrameMeter(table, rendition, source, rate or ANY_RATE)
        self._alone = ThreadLock()
        self._places = itertools.count()
        self._first: tuple[float, WhiteBalance | None] | None = None

    def shown(self, frame: RawFrame) -> tuple[RawFrame, float, WhiteBalance | None]:
        """Return the filtered frame, its exposure scale and its white balance.

        A white balance of None stands for the white balance of the rendition. Raises InputFileError if the white cannot be
        measured.
        """
        with self._alone:
            measured = self._first if self._held and self._first is not None else self._meter.measured(frame)[:2]
            self._first = measured
            return (self._temporal.filtered(next(self._places), frame) if self._temporal else frame), *measured
