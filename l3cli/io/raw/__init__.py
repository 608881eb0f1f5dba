"""Types for the content of raw files with one or several frames."""

from collections.abc import Callable, Container, Iterable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NotRequired, TypedDict

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.io.video import Stated


class RawContent(TypedDict):
    """Content of a raw file with one frame. Values that are missing in the file have no key."""

    # (row, col) DN, without masked borders; values that are not 16-bit integers may have a different scale
    values: NDArray[Any]
    black_level: NotRequired[float]  # DN
    white_level: NotRequired[float]  # DN
    pattern: NotRequired[NDArray[np.int64]]  # (row, col) colour codes of the CFA, starting at pixel (0, 0)
    orientation: NotRequired[int]  # LibRaw flip code
    exposure: NotRequired[float | None]  # exposure time in s
    baseline_exposure: NotRequired[float]  # exposure compensation in EV that the file requests for pictures
    neutral: NotRequired[NDArray[np.float64] | None]  # (colour, 2) CFA code, and signal of a grey surface in any unit
    camera: NotRequired[list[str]]  # make, model and other names of the camera
    shot: NotRequired[dict[str, str | float]]  # fields of Shot that the file states
    gain: NotRequired[NDArray[np.float32]]  # (row, col) factor that the file requests for signals above the black level
    warps: NotRequired[tuple[dict[str, Any], ...]]  # fields of each LensWarp, in the order of application
    # DN of the masked pixels beside the rows, (row, masked pixel), and above and below the columns, (masked pixel, col)
    masked: NotRequired[tuple[NDArray[Any], NDArray[Any]]]
    notes: NotRequired[tuple[str, ...]]  # warnings about properties of the file that l3 ignores
    # user parameter that resolves a fault or an unsupported request in the file → message
    faults: NotRequired[dict[str, str]]
    exchangeable: NotRequired[bool]  # whether the size of a headerless file also fits cols×rows pixels
    # possible interpretations of the bytes, of which the first is used: (option that selects it, values, bits)
    readings: NotRequired[Callable[[], Iterable[tuple[str, NDArray[np.uint16], int]]]]


def refuse_faults(name: str, content: RawContent, answered: Container[str]) -> None:
    """Raise InputFileError for the first fault in a file that the user has not resolved.

    `answered` contains the names of the parameters that the user has set. `name` is the file name for the message.
    """
    for parameter, text in content.get("faults", {}).items():
        if parameter not in answered:
            raise InputFileError(f"{name} {text}")


@dataclass(frozen=True)
class MultiFrameFile:
    """A file or stream of raw frames, each of which is read when it is needed."""

    count: int | None  # number of frames; None for a stream, because it is unknown until the stream ends
    read: Callable[[int], RawContent | None]  # returns the frame with the given number; None after the end of a stream
    unit: str = "frame"  # word for a frame in messages, such as "page"
    first: int = 0  # number of the first frame in messages
    rate: Fraction | None = None  # frame rate in frames/s; None if the file does not contain it
    times: Stated | None = None  # function that reads the frame times; None if the file does not contain them
    numbered: bool = True  # whether output names contain the frame number even if there is only one frame

    def name(self, number: int) -> str:
        """Return the name of frame `number`, counted from 0, in messages, such as "page 3"."""
        return f"{self.unit} {self.first + number}"


class InOrder:
    """Reads frames with increasing numbers from a stream. Frames that are not requested are skipped."""

    def __init__(self, following: Callable[[], RawContent | None]) -> None:
        self._following = following  # function that returns the next frame, or None at the end
        self._next = 0

    def read(self, number: int) -> RawContent | None:
        content: RawContent | None = None
        while self._next <= number:
            self._next += 1  # count the frame even if reading it fails
            try:
                content = self._following()
            except InputFileError as error:
                if self._next <= number:
                    continue  # the damaged frame was not requested
                raise InputFileError(f"frame {number}: {error}") from error
            if content is None:
                return None
        return content
