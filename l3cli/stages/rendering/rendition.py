"""What makes a picture of a raw frame's outputs: white, exposure, colour space, bits; or the outputs as they are."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from l3cli.artifacts.table import TransformTable
from l3cli.errors import RecipeError, suggestion
from l3cli.frame import RawFrame, upright
from l3cli.io import images
from l3cli.io.label import Label
from l3cli.io.sequences import Pending
from l3cli.physics.display import exposure_scale
from l3cli.physics.spaces import SPACES, SRGB, XYZ, Space, chromaticity_of
from l3cli.rendering.display import Display, linear_matrix, make_display

if TYPE_CHECKING:
    from l3cli.rendering.renderer import Renderer


@dataclass(frozen=True)
class Rendition:
    """What makes pictures of outputs."""

    white: Any  # XYZ of the scene's white; None: outputs are written as they are
    exposure: float | None  # None: automatic
    bits: int
    space: Space | None = SRGB  # of the values; without a curve they are linear, in floating point. None: no colours

    @property
    def is_linear(self) -> bool:
        """Whether values are linear, in floating point."""
        return self.space is None or self.space.curve is None

    @property
    def names(self) -> tuple[str, ...]:
        """Of the values of a picture."""
        return ("X", "Y", "Z") if self.space and self.space.name == XYZ.name else ("R", "G", "B")


OUTPUTS = Rendition(None, None, images.FLOAT_BITS, None)  # as they are


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
class Rendered:
    """A frame that has been rendered, and what its file says of it."""

    pixels: Any  # (row, col, value)
    label: Label


Exposed = tuple[Pending, Any, float]  # with the frame (RawFrame or Unread) and the scale of its exposure, 0: automatic


def pixels_of(renderer: "Renderer", frame: RawFrame, rendition: Rendition, scale: float) -> Any:
    """The picture of a frame, or its linear outputs where there is no white, upright: (row, col, value)."""
    if rendition.is_linear:
        return linear_of(renderer, frame, rendition, scale)
    return upright(renderer.picture(frame, display_of(renderer, frame, rendition, scale)), frame.orientation)


def linear_of(renderer: "Renderer", frame: RawFrame, rendition: Rendition = OUTPUTS, scale: float = 0.0) -> Any:
    """Linear values of a frame, or its outputs as they are where there is no white, upright: (row, col, value) float32."""
    planes = renderer.outputs(frame)
    if rendition.white is not None and rendition.space is not None:
        matrix = linear_matrix(rendition.white, scale or exposure_scale(planes[1]), rendition.space)
        planes = np.einsum("po,orc->prc", matrix.astype(np.float32), planes)
    return upright(np.moveaxis(planes, 0, -1), frame.orientation)


def display_of(renderer: "Renderer", frame: RawFrame, rendition: Rendition, scale: float) -> Display:
    """How the outputs of a frame are shown; `scale`: of its exposure, 0: automatic."""
    # The exposure of one frame alone needs the whole frame's luminance before the first value is encoded: two runs.
    scale = scale or exposure_scale(renderer.outputs(frame)[1])
    return make_display(rendition.white, scale, rendition.bits, rendition.space or SRGB)


def file_of(path: Path, made: Rendered, rendition: Rendition, outputs: tuple[str, ...]) -> bytes:
    """The content of a frame's file: a picture, or linear values; `outputs`: names of the table's."""
    if not rendition.is_linear:
        return images.picture_file(path, made.pixels, rendition.space or SRGB, made.label)
    names = outputs if rendition.white is None else rendition.names
    return images.linear_file(path, made.pixels, names, rendition.space, made.label)
