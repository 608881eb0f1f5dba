"""Rendition of a raw frame's outputs as a picture: white, exposure, colour space, bits; or the outputs as they are."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from l3cli.artifacts.table import TransformTable
from l3cli.errors import RecipeError, suggestion
from l3cli.frames.frame import RawFrame, upright
from l3cli.io.pictures.dng import MOSAICS, raw_values
from l3cli.io.pictures.registry import FLOAT_BITS, NOTHING, Label, Picture, picture_file
from l3cli.io.sequences import FrameReference
from l3cli.physics.display import exposure_scale
from l3cli.physics.spaces import REC2020, SPACES, SRGB, XYZ, Space, chromaticity_of
from l3cli.rendering.display import Display, adapted_display, linear_matrix
from l3cli.rendering.white.balance import WhiteBalance, balanced

if TYPE_CHECKING:
    from l3cli.rendering.renderer import Renderer


@dataclass(frozen=True)
class Rendition:
    """Rendition of outputs as pictures."""

    balance: WhiteBalance | None  # of frames that have none of their own; None: outputs are written as they are
    exposure: float | None  # None: automatic
    bits: int
    space: Space | None = SRGB  # of the values; without a curve they are linear, in floating point. None: no colours
    raw: bool = False  # for raw developers: the exposure is stated, not carried out
    mosaic: str | None = None  # … a mosaic of the pixels, one of MOSAICS
    stops: float = 0.0  # EV by which pictures are brighter than their exposure says

    @property
    def is_linear(self) -> bool:
        """Return whether values are linear, in floating point."""
        return self.space is None or self.space.curve is None

    @property
    def measures_exposure(self) -> bool:
        """Return whether pictures are made whose exposure is automatic."""
        return self.balance is not None and self.exposure is None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the values of a picture."""
        return ("X", "Y", "Z") if self.space and self.space.name == XYZ.name else ("R", "G", "B")


OUTPUTS = Rendition(None, None, FLOAT_BITS, None)  # as they are


def chosen_space(name: str | None, linear: bool) -> Space:
    """The space of pictures, None: sRGB, without its curve where values are `linear`; RecipeError if there is none of this
    name, or it has no codes and they are asked for."""
    if name is not None and name not in SPACES:
        raise RecipeError(f'space "{name}" is unknown; {suggestion(name, SPACES)}')
    space = SPACES[name or SRGB.name]
    if linear:
        return replace(space, title=f"{space.title}, linear", curve=None) if space.curve else space
    if space.curve is None:
        raise RecipeError(f"{name} is linear and has no codes; name an .exr, or a .tif with ‹bits› 32")
    return space


def for_developers(rendition: Rendition, mosaic: str | None) -> Rendition:
    """The rendition that leaves exposure to raw developers; RecipeError if there is no such mosaic."""
    if mosaic is not None and mosaic not in MOSAICS:
        raise RecipeError(f'mosaic "{mosaic}" is unknown; {suggestion(mosaic, MOSAICS)}')
    return replace(rendition, space=replace(REC2020, curve=None), raw=True, mosaic=mosaic)


def outputs_as_they_are(table: TransformTable) -> Rendition:
    """The rendition that leaves a table's outputs as they are; X, Y, Z are colours."""
    if table.outputs != ("X", "Y", "Z"):
        return OUTPUTS
    return replace(OUTPUTS, space=replace(XYZ, title="CIE XYZ", neutral=chromaticity_of(table.white_point)))


@dataclass(frozen=True)
class Unread:
    """A frame that whoever renders it is to read."""

    path: Path
    digest: str  # SHA-256 of the file


@dataclass(frozen=True)
class Exposed:
    """A frame to be rendered, and how it is shown."""

    pending: FrameReference
    frame: RawFrame | Unread
    scale: float  # of its exposure, 0: automatic
    balance: WhiteBalance | None  # its own; None: the rendition's


@dataclass(frozen=True)
class Rendered:
    """A frame that has been rendered, and what its file says of it."""

    pixels: Any  # (row, col, value), of a mosaic (row, col)
    label: Label
    scale: float = 0.0  # of its exposure, which the pixels of a raw file do not have


def rendered(
    renderer: "Renderer", frame: RawFrame, rendition: Rendition, scale: float, label: Label = NOTHING,
    balance: WhiteBalance | None = None,
) -> Rendered:  # fmt: skip
    """A frame as the rendition wants it, upright; `scale`: of its exposure, 0: automatic; `balance`: the frame's own, None:
    the rendition's."""
    balance = balance or rendition.balance
    if balance is not None and not rendition.is_linear:
        balanced_frame, display = shown(renderer, frame, rendition, balance, scale)
        return Rendered(upright(renderer.picture(balanced_frame, display), frame.orientation), label)
    planes = renderer.outputs(frame if balance is None else balanced(frame, renderer.table, balance.gains))
    if balance is not None and rendition.space is not None:
        scale = (scale * balance.luminance or exposure_scale(planes[1])) * 2**rendition.stops
        matrix = linear_matrix(balance.adaptation, 1.0 if rendition.raw else scale, rendition.space)
        planes = np.einsum("po,orc->prc", matrix.astype(np.float32), planes)
    pixels = upright(np.moveaxis(planes, 0, -1), frame.orientation)
    return Rendered(raw_values(pixels, rendition.mosaic) if rendition.raw else pixels, label, scale)


def shown(
    renderer: "Renderer", frame: RawFrame, rendition: Rendition, balance: WhiteBalance, scale: float
) -> tuple[RawFrame, Display]:
    """A frame with the gains of its white balance, and how its outputs are shown; `scale`: of its exposure, 0: automatic."""
    frame = balanced(frame, renderer.table, balance.gains)
    # The exposure of one frame alone needs the whole frame's luminance before the first value is encoded: two runs.
    scale = (scale * balance.luminance or exposure_scale(renderer.outputs(frame)[1])) * 2**rendition.stops
    return frame, adapted_display(balance.adaptation, scale, rendition.bits, rendition.space or SRGB)


def file_of(path: Path, made: Rendered, rendition: Rendition, outputs: tuple[str, ...]) -> bytes:
    """The content of a frame's file: a picture, or linear values; `outputs`: names of the table's."""
    names = outputs if rendition.balance is None else rendition.names
    return picture_file(path, Picture(made.pixels, rendition.space, made.label, names, made.scale))
