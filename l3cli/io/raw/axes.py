"""Determine which axes of an array are frames, rows and columns. Pictures with several channels are rejected.

If the file contains the names of the axes, the names determine their order. Otherwise the order is (frame, row, col). Two
lengths contradict this order and cause an error: a last axis of at most 4 probably contains channels, and a last axis that
is far shorter than both others probably counts frames.
"""

import re
from collections.abc import Sequence
from typing import NamedTuple

from l3cli.errors import InputFileError
from l3cli.system.text import counted

MOST_CHANNELS = 4  # maximum number of channels of a picture; no frame has so few columns
FRAMES_LAST = 16  # the last axis counts frames if both other axes are at least this many times longer
MEANINGS = {
    "frame": ("f", "frame", "frames", "t", "time", "n", "number", "index", "i", "z", "page", "pages", "image", "images"),
    "row": ("r", "row", "rows", "y", "height", "line", "lines"),
    "col": ("col", "cols", "column", "columns", "x", "width", "sample", "samples"),
    "channel": ("c", "channel", "channels", "rgb", "rgba", "colour", "colours", "color", "colors", "s", "band", "bands",
                "wavelength", "wavelengths", "spectral", "lambda"),
}  # fmt: skip
MEANING = {name: meaning for meaning, names in MEANINGS.items() for name in names}
GIVE = "use a raw mosaic (rows × columns) or a stack (frames × rows × columns)"
COUNTED = "frames × rows × columns"


class Axes(NamedTuple):
    """Positions of the axes of an array. `frame` is None if there is a single frame."""

    frame: int | None
    row: int
    col: int


STACK, FRAME = Axes(0, 1, 2), Axes(None, 0, 1)


def frame_axes(name: str, shape: Sequence[int], names: Sequence[str] = (), usual: Axes | None = None) -> Axes:
    """Return the axes of an array that contains a frame or a stack of frames.

    Parameters
    ----------
    name : str
        Name of the array in messages.
    shape : sequence of int
        Lengths of the two or three axes of the array.
    names : sequence of str
        Names of the axes in the file, in the order of `shape`. Empty if the file names none.
    usual : Axes, optional
        Axes to use if there are no names. [default: (frame, row, col) or (row, col)]

    Raises
    ------
    InputFileError
        If an axis contains the channels of a picture, or if the last axis probably counts frames and is not named.
    """
    array = f"{name} is an array of {'×'.join(map(str, shape))} values"
    meanings = [MEANING.get(re.sub("[^a-z]", "", each.lower()), "") for each in names]
    if "channel" in meanings:
        channel = names[meanings.index("channel")]
        raise InputFileError(f'{array} with the channels of a picture along the axis "{channel}"; {GIVE}')
    wanted = ("frame", "row", "col")[3 - len(shape) :]
    if sorted(meanings) == sorted(wanted):
        return Axes(meanings.index("frame") if len(shape) == 3 else None, meanings.index("row"), meanings.index("col"))
    if len(shape) < 3:
        return usual or FRAME
    if meanings[:1] == ["frame"]:
        return STACK
    if shape[2] <= MOST_CHANNELS and usual is None:
        raise InputFileError(f"{array}, which looks like a picture with {counted(shape[2], 'channel')}; {GIVE}")
    if usual is None and FRAMES_LAST * shape[2] <= min(shape[:2]):
        raise InputFileError(f"{array} whose last axis seems to count frames; save it as {COUNTED}")
    return usual or STACK
