"""Determine which axes of an array of pixels are frames, rows and columns. Pictures with several channels are rejected.

Names of axes in the file decide. Without names, the order is (frame, row, col), unless the lengths contradict it: a last
axis of 4 or less contains channels, and a last axis far shorter than both others probably counts frames.
"""

import re
from collections.abc import Sequence
from typing import NamedTuple

from l3cli.errors import InputFileError

MOST_CHANNELS = 4  # largest number of channels of a picture; no frame is this narrow
FRAMES_LAST = 16  # the last axis counts frames if both others are at least this many times longer
MEANINGS = {
    "frame": ("f", "frame", "frames", "t", "time", "n", "number", "index", "i", "z", "page", "pages", "image", "images"),
    "row": ("r", "row", "rows", "y", "height", "line", "lines"),
    "col": ("col", "cols", "column", "columns", "x", "width", "sample", "samples"),
    "channel": ("c", "channel", "channels", "rgb", "rgba", "colour", "colours", "color", "colors", "s", "band", "bands",
                "wavelength", "wavelengths", "spectral", "lambda"),
}  # fmt: skip
MEANING = {name: meaning for meaning, names in MEANINGS.items() for name in names}
GIVE = "give a mosaic, rows × columns, or frames × rows × columns"
COUNTED = "frames × rows × columns"


class Axes(NamedTuple):
    """Positions of the axes of an array. `frame` is None if there is a single frame."""

    frame: int | None
    row: int
    col: int


STACK, FRAME = Axes(0, 1, 2), Axes(None, 0, 1)


def frame_axes(name: str, shape: Sequence[int], names: Sequence[str] = (), usual: Axes | None = None) -> Axes:
    """Return the axes of a frame or of a stack of frames.

    Parameters
    ----------
    name : str
        Name of the array in messages.
    shape : sequence of int
        Lengths of its two or three axes.
    names : sequence of str
        Names of the axes in the file, in the order of `shape`; empty if there are none.
    usual : Axes, optional
        Axes of arrays without names in this kind of file. [default: (frame, row, col) or (row, col)]

    Raises
    ------
    InputFileError
        If an axis contains the channels of a picture, or if the last axis probably counts frames and has no name.
    """
    held = f"{name} holds {'×'.join(map(str, shape))} values"
    meanings = [MEANING.get(re.sub("[^a-z]", "", each.lower()), "") for each in names]
    if "channel" in meanings:
        channel = names[meanings.index("channel")]
        raise InputFileError(f'{held}, a picture whose axis "{channel}" holds its channels; {GIVE}')
    wanted = ("frame", "row", "col")[3 - len(shape) :]
    if sorted(meanings) == sorted(wanted):
        return Axes(meanings.index("frame") if len(shape) == 3 else None, meanings.index("row"), meanings.index("col"))
    if len(shape) < 3:
        return usual or FRAME
    if meanings[:1] == ["frame"]:
        return STACK
    if shape[2] <= MOST_CHANNELS and usual is None:
        raise InputFileError(f"{held}, as a picture of {shape[2]} channels; {GIVE}")
    if usual is None and FRAMES_LAST * shape[2] <= min(shape[:2]):
        raise InputFileError(f"{held}, whose last axis seems to count frames; save it as {COUNTED}")
    return usual or STACK
