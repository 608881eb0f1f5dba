"""Conversion of frames to pictures: colour space, bit depth, exposure and white balance, either given or measured."""

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
from l3cli.physics.display import FLOAT_BITS, Tone
from l3cli.physics.spaces import SPACES, SRGB, XYZ, Space, chromaticity_of
from l3cli.rendering.display import Display, adapted_display, linear_matrix, require_xyz, shown_adaptation
from l3cli.rendering.exposure import LightMeter, SteadyExposure, still_scale
from l3cli.rendering.renderer import Renderer
from l3cli.rendering.temporal.chunks import Chunks
from l3cli.rendering.white.scene_white import SceneWhite, SteadyWhite, WhiteBalance, balanced
from l3cli.rendering.white.source import WhiteSource, given_white, usual_balance, white_source
from l3cli.system.locks import ThreadLock

DEPTHS = (8, 16, FLOAT_BITS)
MIN_EXPOSURE, MAX_EXPOSURE = 1e-9, 1e9  # range of the factor on Y
ANY_RATE = Fraction(30)  # frames/s; has no effect if only the first frame is measured


@dataclass(frozen=True)
class Rendition:
    """Settings for the conversion of outputs to pictures."""

    balance: WhiteBalance | None  # for frames without their own balance; None if outputs are written unchanged
    exposure: float | None  # factor on Y; None means automatic exposure
    bits: int
    space: Space | None = SRGB  # values are linear and floating point if it has no transfer curve; None for no colours
    raw: bool = False  # the picture is for a raw converter: the exposure is recorded but not applied
    mosaic: str | None = None  # if `raw`, the name of the CFA in the file format
    stops: float = 0.0  # additional exposure in EV
    stated_exposure: bool = False  # whether the exposure in each frame's file is an additional factor
    tone: Tone | None = None  # tone curve

    @property
    def is_linear(self) -> bool:
        """Whether values are linear and floating point."""
        return self.space is None or self.space.curve is None

    @property
    def measures_exposure(self) -> bool:
        """Whether the exposure is automatic."""
        return self.balance is not None and self.exposure is None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the three values of a pixel."""
        return ("X", "Y", "Z") if self.space and self.space.name == XYZ.name else ("R", "G", "B")


OUTPUTS = Rendition(None, None, FLOAT_BITS, None)  # writes the table's outputs unchanged


def chosen_space(name: str | None, linear: bool) -> Space:
    """Return the colour space of pictures.

    Parameters
    ----------
    name : str or None
        None for sRGB.
    linear : bool
        Whether values are linear, without the transfer curve.

    Raises
    ------
    RecipeError
        If the space is unknown, or if it is linear but codes are requested.
    """
    if name is not None and name not in SPACES:
        raise RecipeError(f'space "{name}" is unknown; {suggestion(name, SPACES)}')
    space = SPACES[name or SRGB.name]
    if linear:
        return replace(space, title=f"{space.title}, linear", curve=None) if space.curve else space
    if space.curve is None:
        raise RecipeError(f"{name} is linear and has no codes; name an .exr, or a .tif with ‹bits› 32")
    return space


def outputs_as_they_are(table: TransformTable) -> Rendition:
    """Return the rendition that writes a table's outputs unchanged. X, Y, Z are labelled as colours."""
    if table.outputs != ("X", "Y", "Z"):
        return OUTPUTS
    return replace(OUTPUTS, space=replace(XYZ, title="CIE XYZ", neutral=chromaticity_of(table.white_point)))


def shown_as(
    table: TransformTable, exposure: float | None, white: str | None, space: str, bits: int,
    estimated_by: TransformTable | None = None,
) -> tuple[Rendition, WhiteSource | None]:  # fmt: skip
    """Return the rendition for pictures, and the source of the white of each frame.

    The source is None if all frames have the white of the rendition.

    Parameters
    ----------
    table : TransformTable
        The table.
    exposure : float or None
        Factor on Y, or None for automatic exposure.
    white : str or None
        White, as in `white_source` and `given_white`.
    space : str
        Name of the colour space.
    bits : int
        8, 16 or FLOAT_BITS.
    estimated_by : TransformTable, optional
        Table for the estimation of the white, as in `white_source`.

    Raises
    ------
    RecipeError
        If an argument is invalid, or if the table's outputs are not X, Y, Z or Y.
    """
    if exposure is not None and not (isinstance(exposure, Real) and MIN_EXPOSURE <= exposure <= MAX_EXPOSURE):
        given_as = f"{exposure:g}" if isinstance(exposure, Real) else f'"{exposure}"'
        raise RecipeError(
            f"exposure {given_as} is not within {MIN_EXPOSURE:g}…{MAX_EXPOSURE:g} times Y; omit it for automatic exposure"
        )
    if bits not in DEPTHS:
        raise RecipeError(f"{bits} bits is not a depth of pictures; ask for 8, 16 or {FLOAT_BITS}")
    require_xyz(table.outputs)
    source = white_source(white, table, photos=True, estimated_by=estimated_by)
    given = None if source else given_white(white, table)
    balance = given.balance if given else usual_balance(table)
    return Rendition(balance, exposure, bits, chosen_space(space, bits == FLOAT_BITS)), source


def rendered(
    renderer: Renderer, frame: RawFrame, rendition: Rendition, scale: float, balance: WhiteBalance | None = None
) -> tuple[NDArray[Any], float]:
    """Render a frame.

    Parameters
    ----------
    renderer : Renderer
        The renderer.
    frame : RawFrame
        The frame.
    rendition : Rendition
        Settings of the picture.
    scale : float
        Exposure scale, or 0 for automatic exposure.
    balance : WhiteBalance, optional
        White balance of this frame. [default: the white balance of the rendition]

    Returns
    -------
    pixels : ndarray, (row, col, value)
        The picture in upright orientation.
    scale : float
        Exposure scale of the picture. It is not applied to pictures for raw converters.
    """
    balance = balance or rendition.balance
    if balance is not None and not rendition.is_linear:
        balanced_frame, display = frame_and_display(renderer, frame, rendition, balance, scale)
        return upright(renderer.picture(balanced_frame, display), frame.orientation), scale
    frame = frame if balance is None else balanced(frame, renderer.table, balance.gains)
    planes = renderer.outputs(frame)
    if balance is not None and rendition.space is not None:
        scale = (scale * balance.luminance or still_scale(planes[1], frame, renderer.table)) * 2**rendition.stops
        adaptation = shown_adaptation(renderer.table, balance.adaptation)
        matrix = linear_matrix(adaptation, 1.0 if rendition.raw else scale, rendition.space)
        planes = np.einsum("po,orc->prc", matrix.astype(np.float32), planes)
    return upright(np.moveaxis(planes, 0, -1), frame.orientation), scale


def frame_and_display(
    renderer: Renderer, frame: RawFrame, rendition: Rendition, balance: WhiteBalance, scale: float
) -> tuple[RawFrame, Display]:
    """Apply the gains of the white balance to a frame, and return it with its display.

    A `scale` of 0 means automatic exposure.
    """
    frame = balanced(frame, renderer.table, balance.gains)
    # Automatic exposure of a single frame needs the luminance of all pixels before encoding, so the frame is rendered twice.
    scale = scale * balance.luminance or still_scale(renderer.outputs(frame)[1], frame, renderer.table)
    scale *= 2**rendition.stops
    adaptation = shown_adaptation(renderer.table, balance.adaptation)
    return frame, adapted_display(adaptation, scale, rendition.bits, rendition.space or SRGB, rendition.tone)


class FrameMeter:
    """Determines the exposure scale and the white balance of each frame, in order.

    Parameters
    ----------
    table : TransformTable
        The table.
    rendition : Rendition
        Settings of the pictures.
    source : WhiteSource or None
        Source of the white of each frame, or None for the white of the rendition.
    rate : Fraction or None
        Frames per second of a sequence, in which exposure and white follow the measurements smoothly. (Some sources keep the
        white of the first frame.) None for stills: each frame has its own white, and the renderer determines an automatic
        exposure.
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
        """Return the scale, the balance and the measured white of the next frame.

        Returns
        -------
        scale : float
            Exposure scale, or 0 for automatic exposure.
        balance : WhiteBalance or None
            White balance, or None for that of the rendition.
        white : SceneWhite or None
            Measured white, or None if the frame contains nothing from which to estimate it.

        Raises
        ------
        InputFileError
            If the white cannot be measured in the frame.
        """
        brightness, balance, white = self.looked_at(frame)
        return self.scale(frame, brightness), balance, white

    def looked_at(self, frame: RawFrame) -> tuple[float, WhiteBalance | None, SceneWhite | None]:
        """Return the brightness (0 if not measured), the balance and the white of the next frame.

        The exposure is not updated.
        """
        white = self._measured_white(frame) if self._source else None
        return self._light.brightness(frame, self._balance) if self._light else 0.0, self._balance, white

    def scale(self, frame: RawFrame, brightness: float, flicker: float = 0.0) -> float:
        """Return the exposure scale of the next frame, given its brightness. The result 0 means automatic exposure.

        Parameters
        ----------
        frame : RawFrame
            The frame.
        brightness : float
            Brightness of the frame, as returned by `looked_at`.
        flicker : float
            Logarithm of the factor by which flicker brightens the frame. The scale compensates it.
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
    """Determines exposure scale and white balance of frames in order, and filters them.

    The parameters are the same as for FrameMeter. If `rate` is None, all frames have the scale and balance of the first
    frame. `temporal` is the temporal filter, if there is one.
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
        """Return the next frame after filtering, with its scale and its balance (None means that of the rendition).

        Raises InputFileError if the white of the frame cannot be measured.
        """
        with self._alone:
            measured = self._first if self._held and self._first is not None else self._meter.measured(frame)[:2]
            self._first = measured
            return (self._temporal.filtered(next(self._places), frame) if self._temporal else frame), *measured
