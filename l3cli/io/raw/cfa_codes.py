"""The colours of a colour filter array as raw files code them (TIFF/EP), and which site of a table's array they begin at."""

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.frames.frame import shifted_cfa, tiled

if TYPE_CHECKING:  # the process that decodes starts without them
    from l3cli.artifacts.camera import CameraModel
    from l3cli.artifacts.table import TransformTable

Sensor: TypeAlias = "TransformTable | CameraModel"  # whose size, levels and colour filter array raw files have


class FilterArray(Protocol):
    """Whatever has a colour filter array: (cfa_row, cfa_col) channel of each site, and the channels' names."""

    @property
    def cfa(self) -> NDArray[np.uint8]: ...
    @property
    def channels(self) -> tuple[str, ...]: ...


LETTERS = "RGBCMYW"  # codes 0…6 of CFAPattern: red, green, blue, cyan, magenta, yellow, white
NAMES = ("red", "green", "blue", "cyan", "magenta", "yellow", "white")
FREE_CODE = len(LETTERS)  # the first code of what TIFF/EP has no name for
LARGEST = 16  # rows and columns of a file's pattern
CURE = "give the table of this camera, or the site of the first pixel with ‹phase› ROW,COL"


def code_of(name: str) -> int | None:
    """Return the TIFF/EP code of a channel's name, "r" or "red"; None where it has none."""
    known = [*LETTERS.lower(), *NAMES]
    return known.index(name.lower()) % FREE_CODE if name.lower() in known else None


def codes_of(letters: str) -> NDArray[np.int64]:
    """Return the code of each of the letters of a decoder; one that TIFF/EP has not is coded by its place."""
    return np.array(
        [LETTERS.index(each) if each in LETTERS else FREE_CODE + index for index, each in enumerate(letters.upper())]
    )


def channel_codes(channels: Sequence[str]) -> NDArray[np.uint8]:
    """Return a code for each channel, all different: TIFF/EP's, or a free one for names that it does not know."""
    codes: list[int] = []
    for index, name in enumerate(channels):
        code = code_of(name)
        codes.append(FREE_CODE + index if code is None or code in codes else code)
    return np.array(codes, np.uint8)


def find_phase(name: str, pattern: NDArray[np.integer], sensor: FilterArray) -> tuple[int, int]:
    """Return the site of the sensor's super-pixel that pixel (0, 0) has in a file whose CFA has the codes `pattern` (row,
    col).

    Channels that TIFF/EP knows must have their code, each of the others one code of any value. InputFileError, naming
    `name`, if no site fits, or several that differ.
    """
    if max(pattern.shape) > LARGEST:
        raise InputFileError(f"{name} has a colour filter array of {pattern.shape[0]}×{pattern.shape[1]}; it is damaged")
    size = tuple(np.lcm(pattern.shape, sensor.cfa.shape).tolist())
    theirs = tiled(pattern, size)
    phases = list(itertools.product(range(sensor.cfa.shape[0]), range(sensor.cfa.shape[1])))
    ours = {phase: tiled(shifted_cfa(sensor.cfa, phase), size) for phase in phases}
    codes = channel_codes(sensor.channels)
    exact = [phase for phase in phases if np.array_equal(codes[ours[phase]], theirs)]
    fitting = exact or [phase for phase in phases if _fits(ours[phase], theirs, sensor.channels)]
    if not fitting:
        raise InputFileError(
            f"{name} has the colour filter array {_written(pattern)}, the table {_written(codes[sensor.cfa])}; {CURE}"
        )
    if any((ours[phase] != ours[fitting[0]]).any() for phase in fitting):
        raise InputFileError(
            f"{name}: its colour filter array {_written(pattern)} fits several sites of the table's; "
            "give that of the first pixel with ‹phase› ROW,COL"
        )
    return fitting[0]


def neutral_of_channels(
    neutral: NDArray[np.float64] | None, pattern: NDArray[np.integer] | None, phase: tuple[int, int], sensor: FilterArray
) -> tuple[float, ...] | None:
    """Return the signal of a grey in each of a sensor's channels from that in the colours of a file, `neutral` (colour, 2)
    with their codes: by name or, of a file whose CFA `pattern` begins at site `phase`, by place. None without all."""
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
    """Return a pattern as rg/gb; codes without a letter as numbers."""
    rows = [[LETTERS[code].lower() if code < FREE_CODE else f"({code})" for code in row] for row in pattern.tolist()]
    return "/".join("".join(row) for row in rows)
