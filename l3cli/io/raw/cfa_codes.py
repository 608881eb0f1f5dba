"""Compare the colour filter array in a raw file (TIFF/EP colour codes) with the sensor's, to find the file's phase.

The phase is the CFA site of the file's first pixel.
"""

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.physics.mosaic import shifted_cfa, tiled

if TYPE_CHECKING:  # imported only by type checkers, so that the decoding process starts faster
    from l3cli.artifacts.camera import CameraModel
    from l3cli.artifacts.table import TransformTable

Sensor: TypeAlias = "TransformTable | CameraModel"  # source of the size, levels and CFA that a raw file does not contain


class FilterArray(Protocol):
    """An object with a CFA (channel index of each site) and channel names."""

    @property
    def cfa(self) -> NDArray[np.uint8]: ...
    @property
    def channels(self) -> tuple[str, ...]: ...


LETTERS = "RGBCMYW"  # letters for the codes 0…6 of CFAPattern
NAMES = ("red", "green", "blue", "cyan", "magenta", "yellow", "white")
FREE_CODE = len(LETTERS)  # smallest code to which TIFF/EP assigns no colour
LARGEST = 16  # maximum number of rows or columns in a pattern
CURE = "use the table of this camera, or set ‹phase› ROW,COL to the position of the first pixel in the table's array"


def code_of(name: str) -> int | None:
    """Return the TIFF/EP code for a channel name such as "r" or "Red", or None if TIFF/EP has no such colour."""
    known = [*LETTERS.lower(), *NAMES]
    return known.index(name.lower()) % FREE_CODE if name.lower() in known else None


def codes_of(letters: str) -> NDArray[np.int64]:
    """Convert letters such as "RGGB" to colour codes, (letter,). Unknown letters become unassigned codes."""
    return np.array(
        [LETTERS.index(each) if each in LETTERS else FREE_CODE + index for index, each in enumerate(letters.upper())]
    )


def channel_codes(channels: Sequence[str]) -> NDArray[np.uint8]:
    """Return an array with a unique colour code for each channel.

    This is the TIFF/EP code for the channel name if there is one and no earlier channel has it. Otherwise it is a code that
    TIFF/EP does not assign.
    """
    codes: list[int] = []
    for index, name in enumerate(channels):
        code = code_of(name)
        codes.append(FREE_CODE + index if code is None or code in codes else code)
    return np.array(codes, np.uint8)


def find_phase(name: str, pattern: NDArray[np.integer], sensor: FilterArray) -> tuple[int, int]:
    """Determine the phase of a file: the CFA row and column of its first pixel.

    Parameters
    ----------
    name : str
        Name of the file, for messages.
    pattern : ndarray, (row, col)
        Colour codes in the file, starting at its first pixel.
    sensor : FilterArray
        The sensor. A channel with a TIFF/EP colour name matches only this colour's code. Other channels match any code.

    Returns
    -------
    tuple of int
        CFA row and column.

    Raises
    ------
    InputFileError
        If the pattern matches the sensor's CFA in no phase, or in several phases that are not equivalent.
    """
    if max(pattern.shape) > LARGEST:
        raise InputFileError(
            f"{name} contains a colour filter array of {pattern.shape[0]}×{pattern.shape[1]} sites, but the limit is "
            f"{LARGEST}×{LARGEST}; the file is probably damaged, so copy the file again"
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
            f"{name} has the colour filter array {written(pattern)}, but the table has {written(codes[sensor.cfa])}; {CURE}"
        )
    if any((ours[phase] != ours[fitting[0]]).any() for phase in fitting):
        raise InputFileError(
            f"{name}: the colour filter array {written(pattern)} fits the table's array at several positions; "
            "set ‹phase› ROW,COL to the position of the first pixel in the table's array"
        )
    return fitting[0]


def neutral_of_channels(
    neutral: NDArray[np.float64] | None, pattern: NDArray[np.integer] | None, phase: tuple[int, int], sensor: FilterArray
) -> tuple[float, ...] | None:
    """Return the signal of a grey surface in each of the sensor's channels.

    Parameters
    ----------
    neutral : ndarray, (colour, 2), or None
        Colour codes and signals in the file.
    pattern : ndarray, (row, col), or None
        CFA in the file, from which the colour code of each channel is determined. If it is None, the channel names are used
        instead.
    phase : tuple of int
        CFA row and column of the file's first pixel.
    sensor : FilterArray
        The sensor.

    Returns
    -------
    tuple of float, or None
        One signal per channel, in any common unit. None if `neutral` is None or lacks the colour of a channel.
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


def letter_of(code: int) -> str:
    """Return the letter of a colour code, such as "r". Codes without a letter are written as (7), (8), …"""
    return LETTERS[code].lower() if code < FREE_CODE else f"({code})"


def written(pattern: NDArray[np.integer]) -> str:
    """Format a pattern of colour codes, for example as rg/gb."""
    return "/".join("".join(map(letter_of, row)) for row in pattern.tolist())
