"""Types for the contents of raw files: a single frame, or a file with several frames."""

from collections.abc import Callable, Container, Iterable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NotRequired, TypedDict

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.io.video import Stated


class RawContent(TypedDict):
    """One raw frame as stored in a file. Keys are missing if the file does not state the value."""

    values: NDArray[Any]  # (row, col) DN without masked borders; types other than 16-bit integers may have another scale
    black_level: NotRequired[float]  # DN
    white_level: NotRequired[float]  # DN
    pattern: NotRequired[NDArray[np.int64]]  # (row, col) colour codes of the CFA, beginning at pixel (0, 0)
    orientation: NotRequired[int]  # LibRaw's flip code
    exposure: NotRequired[float | None]  # s
    baseline_exposure: NotRequired[float]  # EV by which pictures should be brightened relative to the white level
    neutral: NotRequired[NDArray[np.float64] | None]  # (colour, 2) CFA code, and signal of a grey object at any scale
    camera: NotRequired[list[str]]  # make, model and other names of the camera
    shot: NotRequired[dict[str, str | float]]  # fields of Shot that the file states
    gain: NotRequired[NDArray[np.float32]]  # (row, col) factor by which readers should multiply values above black
    warps: NotRequired[tuple[dict[str, Any], ...]]  # fields of each LensWarp, in the order of their application
    notes: NotRequired[tuple[str, ...]]  # warnings about properties of the file that l3 ignores
    # faults and unsupported requests: parameter that resolves the fault → message
    faults: NotRequired[dict[str, str]]
    exchangeable: NotRequired[bool]  # whether the file would also fit if the given numbers of rows and columns were swapped
    # possible interpretations of the frame's bytes, the selected one first: (option that selects it, values, bits)
    readings: NotRequired[Callable[[], Iterable[tuple[str, NDArray[np.uint16], int]]]]


def refuse_faults(name: str, content: RawContent, answered: Container[str]) -> None:
    """Raise InputFileError for the first fault in a file.

    Faults that the user has resolved by setting a parameter listed in `answered` are ignored.
    """
    for parameter, text in content.get("faults", {}).items():
        if parameter not in answered:
            raise InputFileError(f"{name} {text}")


@dataclass(frozen=True)
class MultiFrameFile:
    """The frames of a file. Each frame is read when it is needed."""

    count: int | None  # None for a stream, whose length is unknown until it ends
    read: Callable[[int], RawContent | None]  # reads a frame by its number from 0; returns None after the end of a stream
    unit: str = "frame"  # word for a frame in messages, such as "page"
    first: int = 0  # number of the first frame in messages
    rate: Fraction | None = None  # frames per second, if the file states it
    times: Stated | None = None  # times of the frames, if the file states them
    numbered: bool = True  # whether output names contain a frame number even if there is only one frame

    def name(self, number: int) -> str:
        """Return the name of a frame for messages."""
        return f"{self.unit} {self.first + number}"


class InOrder:
    """Reads a stream in order. Frames that are not requested are skipped."""

    def __init__(self, following: Callable[[], RawContent | None]) -> None:
        self._following = following  # returns the next frame, or None at the end
        self._next = 0

    def read(self, number: int) -> RawContent | None:
        content: RawContent | None = None
        while self._next <= number:
            self._next += 1  # before reading, because a damaged frame also counts
            try:
                content = self._following()
            except InputFileError as error:
                if self._next <= number:
                    continue  # the damaged frame was not requested
                raise InputFileError(f"frame {number}: {error}") from error
            if content is None:
                return None
        return content
