"""What makes a picture of a raw frame's outputs: white, exposure, bits; or the outputs as they are."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from l3cli.frame import RawFrame, upright
from l3cli.io import images
from l3cli.io.sequences import Pending
from l3cli.physics.display import exposure_scale
from l3cli.rendering.balance import WhiteBalance, balanced
from l3cli.rendering.display import Display, adapted_display

if TYPE_CHECKING:
    from l3cli.rendering.renderer import Renderer


@dataclass(frozen=True)
class Rendition:
    """What makes pictures of outputs."""

    balance: WhiteBalance | None  # of frames that have none of their own; None: outputs are written as they are
    exposure: float | None  # None: automatic
    bits: int

    @property
    def measures_exposure(self) -> bool:
        """Whether pictures are made whose exposure is automatic."""
        return self.balance is not None and self.exposure is None


@dataclass(frozen=True)
class Unread:
    """A frame that whoever renders it is to read."""

    path: Path
    digest: str  # SHA-256 of the file


@dataclass(frozen=True)
class Exposed:
    """A frame to be rendered, and how it is shown."""

    pending: Pending
    frame: RawFrame | Unread
    scale: float  # of its exposure, 0: automatic
    balance: WhiteBalance | None  # its own; None: the rendition's


def pixels_of(
    renderer: "Renderer", frame: RawFrame, rendition: Rendition, scale: float, balance: WhiteBalance | None = None
) -> Any:
    """The picture of a frame, or its linear outputs where there is no white, upright: (row, col, value).

    `balance`: the frame's own, None: the rendition's.
    """
    if rendition.balance is None:
        return linear_of(renderer, frame)
    frame, display = shown(renderer, frame, balance or rendition.balance, scale, rendition.bits)
    return upright(renderer.picture(frame, display), frame.orientation)


def linear_of(renderer: "Renderer", frame: RawFrame) -> Any:
    """The outputs of a frame as they are, upright: (row, col, output)."""
    return upright(np.moveaxis(renderer.outputs(frame), 0, -1), frame.orientation)


def shown(renderer: "Renderer", frame: RawFrame, balance: WhiteBalance, scale: float, bits: int) -> tuple[RawFrame, Display]:
    """A frame with the gains of its white balance, and how its outputs are shown; `scale`: of its exposure, 0: automatic."""
    frame = balanced(frame, renderer.table, balance.gains)
    # The exposure of one frame alone needs the whole frame's luminance before the first value is encoded: two runs.
    scale = scale * balance.luminance or exposure_scale(renderer.outputs(frame)[1])
    return frame, adapted_display(balance.adaptation, scale, bits)


def file_of(path: Path, made: Any, outputs: tuple[str, ...]) -> bytes:
    """The content of a picture's file, or of one of linear outputs if its name asks for them."""
    return images.linear_file(path, made, outputs) if images.is_linear(path) else images.picture_file(path, made)
