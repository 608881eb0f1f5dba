"""What makes a picture of a raw frame's outputs: white, exposure, bits; or the outputs as they are."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from l3cli.frame import RawFrame, upright
from l3cli.io import images
from l3cli.io.sequences import Pending
from l3cli.physics.display import exposure_scale
from l3cli.rendering.display import Display, make_display

if TYPE_CHECKING:
    from l3cli.rendering.renderer import Renderer


@dataclass(frozen=True)
class Rendition:
    """What makes pictures of outputs."""

    white: Any  # XYZ of the scene's white; None: outputs are written as they are
    exposure: float | None  # None: automatic
    bits: int


@dataclass(frozen=True)
class Unread:
    """A frame that whoever renders it is to read."""

    path: Path
    digest: str  # SHA-256 of the file


Exposed = tuple[Pending, Any, float]  # with the frame (RawFrame or Unread) and the scale of its exposure, 0: automatic


def pixels_of(renderer: "Renderer", frame: RawFrame, rendition: Rendition, scale: float) -> Any:
    """The picture of a frame, or its linear outputs where there is no white, upright: (row, col, value)."""
    if rendition.white is None:
        return linear_of(renderer, frame)
    return upright(renderer.picture(frame, display_of(renderer, frame, rendition, scale)), frame.orientation)


def linear_of(renderer: "Renderer", frame: RawFrame) -> Any:
    """The outputs of a frame as they are, upright: (row, col, output)."""
    return upright(np.moveaxis(renderer.outputs(frame), 0, -1), frame.orientation)


def display_of(renderer: "Renderer", frame: RawFrame, rendition: Rendition, scale: float) -> Display:
    """How the outputs of a frame are shown; `scale`: of its exposure, 0: automatic."""
    # The exposure of one frame alone needs the whole frame's luminance before the first value is encoded: two runs.
    return make_display(rendition.white, scale or exposure_scale(renderer.outputs(frame)[1]), rendition.bits)


def file_of(path: Path, made: Any, outputs: tuple[str, ...]) -> bytes:
    """The content of a picture's file, or of one of linear outputs if its name asks for them."""
    return images.linear_file(path, made, outputs) if images.is_linear(path) else images.picture_file(path, made)
