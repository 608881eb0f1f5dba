"""Colour codes of colour filter arrays in raw files (TIFF/EP), and the phase of a file, which is its first CFA site."""

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.physics.mosaic import shifted_cfa, tiled

if TYPE_CHECKING:  # not imported at run time, so that the decoding process starts faster
    from l3cli.artifacts.camera import CameraModel
    from l3cli.artifacts.table import TransformTable

Sensor: TypeAlias = "TransformTable | CameraModel"  # states size, levels and CFA if a raw file does not


class FilterArray(Protocol):
    """An object with a colour filter array: the channel of each site (cfa_row, cfa_col), and the name of each channel."""

    @property
    def cfa(self) -> NDArray[np.uint8]: ...
    @property
    def channels(self) -> tuple[str, ...]: ...


LETTERS = "RGBCMYW"  # letters of the codes 0…6 of CFAPattern: red, green, blue, cyan, magenta, yellow, white
NAMES = ("red", "green", "blue", "cyan", "magenta", "yellow", "white")
FREE_CODE = len(LETTERS)  # smallest code to which TIFF/EP assigns no colour
LARGEST = 16  # maximum number of rows and columns of a pattern in a file
CURE = "use the table of this camera, or set ‹phase› ROW,COL to the position of the first pixel in the table's array"


def code_of(name: str) -> int | None:
    """Return the TIFF/EP code for the name of a channel, such as "r" or "red", or None."""
    known = [*LETTERS.lower(), *NAMES]
    return known.index(name.lower()) % FREE_CODE if name.lower() in known else None


def codes_of(letters: str) -> NDArray[np.int64]:
    """Return the code of each letter. A letter that is not in TIFF/EP gets a code that depends on its position."""
    return np.array(
        [LETTERS.index(each) if each in LETTERS else FREE_CODE + index for index, each in enumerate(letters.upper())]
    )


def channel_codes(channels: Sequence[str]) -> NDArray[np.uint8]:
    """Return a different code for each channel: the TIFF/EP code of its name, or a free code for any other name."""
    codes: list[int] = []
    for index, name in enumerate(channels):
        code = code_of(name)
        codes.append(FREE_CODE + index if code is None or code in codes else code)
    return np.array(codes, np.uint8)


def find_phase(name: str, pattern: NDArray[np.integer], sensor: FilterArray) -> tuple[int, int]:
    """Return the site of the sensor's array at the first pixel of a file.

    Parameters
    ----------
    name : str
        Name of the file in messages.
    pattern : ndarray, (row, col)
        Colour codes in the file.
    sensor : FilterArray
        The sensor's array. A channel with a TIFF/EP name must have the code of that name. Other channels match any code.

    Raises
    ------
    InputFileError
        If the pattern fits no site, or fits several sites that are not equivalent.
    """
    if max(pattern.shape) > LARGEST:
        raise InputFileError(
            f"{name} has a colour filter array of {pattern.shape[0]}×{pattern.shape[1]} sites, more than "
            f"{LARGEST}×{LARGEST}; copy the file again"
        )
    size = tuple(np.lcm(pattern.shape, sensor.cfa.shape).tolist())
    theirs = tiled(pattern, size)
    phases = list(itertools.product(range(sensor.cfa.shape[0]), range(sensor.cfa.shape[1])))
    ours = {phase: tiled(shifted_cfa(sensor.cfa, phase), size) for phase in phases}
    codes = channel_codes(sensor.channels)
    exact = [phase for phase in phases if np.array_equal(codes[ours[phase]], theirs)]
    fitting = exact or [phase for phase in phases if _fits(ours[phase], theirs, sensor.channels)]
    if not fitting:
        raise InputFileError(
            f"{name} has the colour filter array {_written(pattern)}, but the table has "
            f"{_written(codes[sensor.cfa])}; {CURE}"
        )
    if any((ours[phase] != ours[fitting[0]]).any() for phase in fitting):
        raise InputFileError(
            f"{name}: the colour filter array {_written(pattern)} fits the table's array at several positions; "
            "set ‹phase› ROW,COL to the position of the first pixel in the table's array"
        )
    return fitting[0]


def neutral_of_channels(
    neutral: NDArray[np.float64] | None, pattern: NDArray[np.integer] | None, phase: tuple[int, int], sensor: FilterArray
) -> tuple[float, ...] | None:
    """Return the signal of a grey object in each channel of a sensor, or None if a channel has no signal.

    Parameters
    ----------
    neutral : ndarray, (colour, 2), or None
        Code and signal of each colour, as stated in a file.
    pattern : ndarray, (row, col), or None
        Colour codes of the file's CFA. If given, colours are matched by position instead of by name.
    phase : tuple of int
        Site of the sensor's array at which the file begins.
    sensor : FilterArray
        The sensor.
    """
    if neutral is None:
        return None
    of_code = {int(code): float(signal) for code, signal in neutral}
    codes = dict(enumerate(channel_codes(sensor.channels).tolist()))
    if pattern is not None:
        size = tuple(np.lcm(pattern.shape, sensor.cfa.shape).tolist())
        ours, theirs = tiled(shifted_cfa(sensor.cfa, phase), size), tiled(pattern, size)
        codes |= dict(zip(ours.ravel().tolist(), theirs.ravel().tolist(), strict=True))
    signals = [of_code.get(codes[channel]) for channel in range(len(sensor.channels))]
    return None if None in signals else tuple(signals)  # type: ignore[arg-type]


def _fits(ours: NDArray[np.uint8], theirs: NDArray[np.integer], channels: Sequence[str]) -> bool:
    pairs = set(zip(ours.ravel().tolist(), theirs.ravel().tolist(), strict=True))
    one_to_one = len(pairs) == len({channel for channel, _ in pairs}) == len({code for _, code in pairs})
    return one_to_one and all(code_of(channels[channel]) in (None, code) for channel, code in pairs)


def _written(pattern: NDArray[np.integer]) -> str:
    """Format a pattern like rg/gb. Codes without a letter are written as numbers in parentheses."""
    rows = [[LETTERS[code].lower() if code < FREE_CODE else f"({code})" for code in row] for row in pattern.tolist()]
    return "/".join("".join(row) for row in rows)
