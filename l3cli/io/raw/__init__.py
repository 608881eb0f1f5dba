"""Content of raw files as their readers return it: one frame, or the frames of one file."""

from collections.abc import Callable, Container, Iterable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NotRequired, TypedDict

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.io.video import Stated


class RawContent(TypedDict):
    """One frame; the table says what its file does not."""

    values: NDArray[Any]  # (row, col) DN, without masked borders; no whole numbers of 16 bits: of a scale not stated
    black_level: NotRequired[float]  # DN
    white_level: NotRequired[float]  # DN
    pattern: NotRequired[NDArray[np.int64]]  # (row, col) colour codes of the CFA, from pixel (0, 0) on
    orientation: NotRequired[int]  # LibRaw's flip code
    exposure: NotRequired[float | None]  # s
    baseline_exposure: NotRequired[float]  # EV by which pictures are to be brighter than the white level is
    neutral: NotRequired[NDArray[np.float64] | None]  # (colour, 2) code of the CFA and what it gives of a grey, of any scale
    camera: NotRequired[list[str]]  # make and model, and other names of the camera that took it
    shot: NotRequired[dict[str, str | float]]  # fields of Shot, as far as they are stated
    gain: NotRequired[NDArray[np.float32]]  # (row, col) that the file wants its values above black to be multiplied by
    notes: NotRequired[tuple[str, ...]]  # what of the file's wishes is not carried out
    # what is wrong with the file, or what it demands and l3 does not do, by the parameter that answers it
    faults: NotRequired[dict[str, str]]
    exchangeable: NotRequired[bool]  # whether rows and columns, which the caller says, would fit the file exchanged, too
    # ways to read the bytes of the frame, first as it was read: option that asks for each, its values, their bits
    readings: NotRequired[Callable[[], Iterable[tuple[str, NDArray[np.uint16], int]]]]


def refuse_faults(name: str, content: RawContent, answered: Container[str]) -> None:
    """Raise InputFileError for the first fault of a file, called `name`, that none of the `answered` parameters answers."""
    for parameter, text in content.get("faults", {}).items():
        if parameter not in answered:
            raise InputFileError(f"{name} {text}")


@dataclass(frozen=True)
class MultiFrameFile:
    """The frames of one file, each read when it is wanted."""

    count: int | None  # None: a stream, read in order until there is no more
    read: Callable[[int], RawContent | None]  # by number, from 0; None: the stream ended before
    unit: str = "frame"  # what messages call one frame
    first: int = 0  # the number that messages give the first frame
    rate: Fraction | None = None  # frames a second, where the file states them
    times: Stated | None = None  # when its frames are shown, where the file states that of each
    numbered: bool = True  # whether a picture's name has the frame's number even where there is one alone

    def name(self, number: int) -> str:
        """Return the name of a frame for messages."""
        return f"{self.unit} {self.first + number}"


class InOrder:
    """Reader of a stream frame by frame, each number after the one before it; frames between are passed over."""

    def __init__(self, following: Callable[[], RawContent | None]) -> None:
        self._following = following  # the next frame; None at the end
        self._next = 0

    def read(self, number: int) -> RawContent | None:
        content: RawContent | None = None
        while self._next <= number:
            self._next += 1  # before reading: a frame that fails has been passed
            try:
                content = self._following()
            except InputFileError as error:
                if self._next <= number:
                    continue  # nobody wants it
                raise InputFileError(f"frame {number}: {error}") from error
            if content is None:
                return None
        return content
