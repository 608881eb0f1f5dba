"""Determine which axes of an array are frames, rows and columns. Pictures with several channels are rejected.

If the file contains axis names, they determine the order. Otherwise, the order is (frame, row, col). Arrays with a
suspiciously short last axis are then rejected. If its length is at most 4, the axis probably contains channels. If it is
much shorter than the other two axes, it probably contains frames.
"""

import re
from collections.abc import Sequence
from typing import NamedTuple

from l3cli.errors import InputFileError
from l3cli.system.text import counted

MOST_CHANNELS = 4  # maximum number of channels in a picture; frames have far more columns
FRAMES_LAST = 16  # the last axis probably contains frames if both other axes are at least this many times longer
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
    """Positions of an array's axes. `frame` is None if the array contains a single frame."""

    frame: int | None
    row: int
    col: int


STACK, FRAME = Axes(0, 1, 2), Axes(None, 0, 1)


def frame_axes(name: str, shape: Sequence[int], names: Sequence[str] = (), usual: Axes | None = None) -> Axes:
    """Determine which axes of an array are the rows, the columns and the frames.

    Parameters
    ----------
    name : str
        Name of the array, for messages.
    shape : sequence of int
        Lengths of the two or three axes of the array.
    names : sequence of str
        Axis names in the file, in the order of `shape`. Empty if the file contains no names.
    usual : Axes, optional
        Axes to assume if the names do not determine them. [default: (frame, row, col) or (row, col)]

    Returns
    -------
    Axes
        Positions of the frame, row and column axes in `shape`.

    Raises
    ------
    InputFileError
        If an axis contains the channels of a picture, or if an unnamed last axis probably contains channels or frames.
    """
    array = f"the array {name} ({'×'.join(map(str, shape))} values)"
    meanings = [MEANING.get(re.sub("[^a-z]", "", each.lower()), "") for each in names]
    if "channel" in meanings:
        channel = names[meanings.index("channel")]
        raise InputFileError(f'{array} has an axis "{channel}", which contains the channels of a picture; {GIVE}')
    wanted = ("frame", "row", "col")[3 - len(shape) :]
    if sorted(meanings) == sorted(wanted):
        return Axes(meanings.index("frame") if len(shape) == 3 else None, meanings.index("row"), meanings.index("col"))
    if len(shape) < 3:
        return usual or FRAME
    if meanings[:1] == ["frame"]:
        return STACK
    if shape[2] <= MOST_CHANNELS and usual is None:
        raise InputFileError(f"{array} looks like a picture with {counted(shape[2], 'channel')}; {GIVE}")
    if usual is None and FRAMES_LAST * shape[2] <= min(shape[:2]):
        raise InputFileError(f"the last axis of {array} probably contains frames; save the array as {COUNTED}")
    return usual or STACK
