"""Types for the content of raw files, with one frame or with several frames."""

from collections.abc import Callable, Container, Iterable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NotRequired, TypedDict

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.io.video import Stated


class RawContent(TypedDict):
    """The content of a raw file with one frame. A key is missing if the file does not state the value."""

    # (row, col) DN without masked borders; values of other types than 16-bit integers may have a different scale
    values: NDArray[Any]
    black_level: NotRequired[float]  # DN
    white_level: NotRequired[float]  # DN
    pattern: NotRequired[NDArray[np.int64]]  # (row, col) colour codes of the CFA, starting at pixel (0, 0)
    orientation: NotRequired[int]  # LibRaw flip code
    exposure: NotRequired[float | None]  # exposure time in s
    baseline_exposure: NotRequired[float]  # exposure compensation for pictures in EV, as the file requests
    neutral: NotRequired[NDArray[np.float64] | None]  # (colour, 2) CFA code, and signal of a grey surface in any unit
    camera: NotRequired[list[str]]  # make, model and other names of the camera
    shot: NotRequired[dict[str, str | float]]  # fields of Shot that the file states
    gain: NotRequired[NDArray[np.float32]]  # (row, col) factor that the file requests for the values above the black level
    warps: NotRequired[tuple[dict[str, Any], ...]]  # fields of each LensWarp, in the order in which the warps are applied
    # masked pixels beside the rows (row, masked pixel), and above and below the columns (masked pixel, col), in DN
    masked: NotRequired[tuple[NDArray[Any], NDArray[Any]]]
    notes: NotRequired[tuple[str, ...]]  # warnings about properties of the file that l3 ignores
    # parameter that resolves a fault of the file, or a request that l3 does not support → message
    faults: NotRequired[dict[str, str]]
    exchangeable: NotRequired[bool]  # whether the file would have the same size if rows and columns were swapped
    # possible interpretations of the bytes: (option that selects the interpretation, values, bits); the first one is used
    readings: NotRequired[Callable[[], Iterable[tuple[str, NDArray[np.uint16], int]]]]


def refuse_faults(name: str, content: RawContent, answered: Container[str]) -> None:
    """Raise InputFileError for the first fault of a file, unless the user has resolved the fault.

    `answered` contains the names of the parameters that the user has set. `name` is the name of the file for the message.
    """
    for parameter, text in content.get("faults", {}).items():
        if parameter not in answered:
            raise InputFileError(f"{name} {text}")


@dataclass(frozen=True)
class MultiFrameFile:
    """A file or stream with several raw frames. Each frame is read when it is needed."""

    count: int | None  # number of frames; None for a stream, whose length is unknown until it ends
    read: Callable[[int], RawContent | None]  # returns the frame with the given number; None after the end of a stream
    unit: str = "frame"  # word for a frame in messages, such as "page"
    first: int = 0  # number of the first frame in messages
    rate: Fraction | None = None  # frame rate in frames/s; None if the file does not state it
    times: Stated | None = None  # times of the frames; None if the file does not state them
    numbered: bool = True  # whether output names contain the frame number even if the file has only one frame

    def name(self, number: int) -> str:
        """Return the name of frame `number`, counted from 0, for messages, such as "page 3"."""
        return f"{self.unit} {self.first + number}"


class InOrder:
    """Reads the frames of a stream by number, in increasing order. Frames that are not requested are skipped."""

    def __init__(self, following: Callable[[], RawContent | None]) -> None:
        self._following = following  # function that returns the next frame, or None at the end
        self._next = 0

    def read(self, number: int) -> RawContent | None:
        content: RawContent | None = None
        while self._next <= number:
            self._next += 1  # before the frame is read, because a damaged frame also counts
            try:
                content = self._following()
            except InputFileError as error:
                if self._next <= number:
                    continue  # the damaged frame was not requested
                raise InputFileError(f"frame {number}: {error}") from error
            if content is None:
                return None
        return content
