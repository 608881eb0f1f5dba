"""Warn about frames that do not fit a table.

A frame may come from another camera, have another CFA, or be too dark or bright for the training. Raw values may be
implausible because of a wrong bit depth, byte order, black level or size.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera_recipe import known_arrays, parse_cfa
from l3cli.artifacts.table import TransformTable
from l3cli.frames.frame import RawFrame
from l3cli.frames.raw_sanity import BELOW, SMALLEST_BLACK, array_doubt, phase_doubt, share_below_black
from l3cli.rendering.conditions import FAR_GAIN, known_gains
from l3cli.rendering.exposure import RangeMeter
from l3cli.system.text import counted

MAX_OVERSHOOT = 1.5  # largest plausible value of a saturated pixel, relative to the white level
SHALLOW = 0.55  # a sensor that clips below this fraction of the white level probably has a lower bit depth than stated
CLIPPED = 1e-3  # the sensor is assumed to clip if at least this fraction of the pixels has the frame's largest value
NEAR_BLACK = 0.75  # a value is near the black level if their ratio is between 0.75 and 1 / 0.75
BLACK_PERCENTILE = 0.1  # in most pictures, this percentile of the values is near the black level
SAME_DEPTH = 0.02  # white levels with a smaller relative difference belong to the same bit depth
# Rows and columns were probably swapped if swapping them back reduces the differences between neighbouring rows by more than
# this factor.
SHEARED = 1.5
ROW_PAIRS = 64  # number of row pairs to compare

NOTABLE = {"darker": 0.05, "brighter": 0.05, "untrained": 0.2, "saturated": 0.1}  # smallest fractions to report
# An exposure time is probably not in seconds if it is longer than LONG, or if it is at least MANY_TIMES the mean exposure
# time of the training frames.
LONG = 60.0  # s
MANY_TIMES = 100.0


@dataclass
class FrameWarnings:
    """Collects warnings about the frames that a command renders.

    Each warning is reported once. If it concerns several frames, it names the first or the worst one.
    """

    table: TransformTable
    _seen: int = 0  # number of checked frames
    _first_is_beyond: bool = False  # whether the first frame contains values that the A/D converter cannot produce
    _untimed: list[str] = field(default_factory=list)  # names of frames without exposure time and dark frame
    _others: dict[str, tuple[str, int]] = field(default_factory=dict)  # warning → name of the first frame, number of frames
    _notes: dict[str, str] = field(default_factory=dict)  # remark of a file reader → name of the first frame
    # field of OutOfRange → fraction of pixels in the worst frame, name of the worst frame, number of affected frames
    _worst: dict[str, tuple[float, str, int]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._meter = RangeMeter(self.table)

    def measure(self, frame: RawFrame) -> None:
        """Check a frame's metadata and values, and measure how many of its pixels are outside the trained range."""
        self._seen += 1
        if self.table.dark_signal(1.0) and frame.exposure is None and not frame.dark_measured:
            self._untimed.append(frame.name)
        of_camera = other_camera(frame, self.table), other_gain(frame, self.table)
        for text in (*of_camera, *pixel_warnings(frame, self.table)):
            self._note(text, frame.name)
        for note in frame.notes:
            self._notes.setdefault(note, frame.name)
        outside = self._meter.outside(frame)
        for what, limit in NOTABLE.items():
            share = getattr(outside, what)
            if share >= limit:
                worst, name, count = self._worst.get(what, (0.0, "", 0))
                self._worst[what] = (share, frame.name, count + 1) if share > worst else (worst, name, count + 1)

    def check(self, frame: RawFrame, stills: bool) -> None:
        """Check a still or the next frame of a sequence.

        The first frame of a sequence is checked like a still. Later frames are checked only for values that the A/D
        converter cannot produce, unless the first frame already contains such values.
        """
        if stills or not self._seen:
            self.measure(frame)
            self._first_is_beyond = bool(beyond_converter(frame, self.table))
        elif not self._first_is_beyond:
            self._note(beyond_converter(frame, self.table), frame.name)

    def _note(self, text: str, name: str) -> None:
        """Store a warning about the frame `name`, unless the text is empty."""
        if text:
            first, count = self._others.get(text, (name, 0))
            self._others[text] = first, count + 1

    @property
    def assumption(self) -> str:
        """A line about the exposure time that l3 assumes for frames without one, or "" if there are none."""
        if not self._untimed:
            return ""
        exposure, dark = self.table.exposure, self.table.dark_signal(None)
        return (
            f"{self._untimed[0]}: the exposure time is unknown, so l3 subtracts the dark current for {exposure:.3g} s, the "
            f"mean exposure time of the training frames ({dark:.2g} DN); set ‹exposure_time› or ‹dark›"
        )

    def lines(self) -> Iterator[str]:
        """Yield all warnings, one line each."""
        darkest, brightest = self._meter.learned_range()
        texts = {
            "darker": f"are darker than all training samples ({darkest:.2g} of full scale); check ‹black_level› and "
            "‹exposure_time›, or reduce learning.darkest and train again",
            "brighter": f"are brighter than all training samples ({brightest:.2g} of full scale); check ‹white_level›, or "
            "increase learning.brightest and train again",
            "untrained": "belong to classes without training patches; train on more scenes or increase learning.patches",
            "saturated": "are clipped or next to clipped pixels, where colours are estimates; use a shorter exposure, or "
            "correct ‹white_level›",
        }
        for text, (name, count) in self._others.items():
            others = f" and {counted(count - 1, 'other frame')}" if count > 1 else ""
            yield f"{name}{others}: {text}"
        for note, name in self._notes.items():
            yield f"{name}: {note}"
        for what, (share, name, count) in self._worst.items():
            affected = f" (the worst of {counted(count, 'affected frame')}, {self._seen} in total)" if self._seen > 1 else ""
            yield f"{name}{affected}: {share:.0%} of the pixels {texts[what]}"


def other_camera(frame: RawFrame, table: TransformTable) -> str:
    """Return a warning if the file comes from a different camera than the table, otherwise ""."""
    if not frame.taken_by or _names_camera(_words(table.camera_name), [_words(name) for name in frame.taken_by]):
        return ""
    name = max(frame.taken_by[:2], key=len)
    return (
        f"the file comes from the camera {name}, but the table is for {table.camera_name}; use a table for this camera, or "
        "set this name in the camera recipe"
    )


def _names_camera(words: set[str], names: list[set[str]]) -> bool:
    """Whether the words of a camera name refer to the camera with these names, of which the first is the manufacturer.

    If both sides contain model numbers, such as 550D, they must have one in common. Otherwise, any common word except the
    manufacturer is sufficient.
    """
    if words in names:
        return True
    theirs = set[str]().union(*names)
    numbers, known = _model_numbers(words), _model_numbers(theirs)
    return not numbers.isdisjoint(known) if numbers and known else not words.isdisjoint(theirs - names[0])


def _model_numbers(words: set[str]) -> set[str]:
    """Return the words that consist of letters and digits."""
    return {word for word in words if re.search("[0-9]", word) and re.search("[a-z]", word)}


def _words(name: str) -> set[str]:
    return set(re.findall(r"[0-9a-z]+", name.lower()))


def other_phase(frame: RawFrame, table: TransformTable) -> str:
    """Return a warning if the pixels contradict the CFA of the table or the stated CFA phase, otherwise ""."""
    if other := _other_array(frame, table):
        return other
    doubt = phase_doubt(frame, table.cfa)
    if doubt is None:
        return ""
    fitting = " or ".join(f"{row},{col}" for row, col in doubt.phases)
    return (
        "the phase of the colour filter array seems wrong: sites of the same channel differ by "
        f"{doubt.stated:.1%} on average; set ‹phase› {fitting}, which reduces the difference to {doubt.least:.1%}"
    )


def _misread(frame: RawFrame) -> str:
    """Return a warning if the values look like noise but would be smooth if read in another format, otherwise ""."""
    if not frame.misread:
        return ""
    return f"the pixels look like noise, so the file was probably read in the wrong format; read it with {frame.misread}"


def _other_array(frame: RawFrame, table: TransformTable) -> str:
    """Return a warning if the pixels contradict the CFA of the table at every phase, otherwise ""."""
    doubt = array_doubt(frame, table.cfa)
    if doubt is None:
        return ""
    known = {name: parse_cfa(each, name) for name, each in known_arrays().items()}
    return (
        "the table is for a different colour filter array: sites of the same colour differ by "
        f"{doubt.differ:.0%} in this frame; train a table for its array, probably {' or '.join(doubt.likely(known)[:2])} "
        "(see ‹pattern› of l3 init)"
    )


def other_gain(frame: RawFrame, table: TransformTable) -> str:
    """Return a warning if the noise at the frame's analog gain is unknown or exceeds the black level, otherwise ""."""
    if frame.gain == 1:
        return ""
    stated = f"the analog gain of the frame is {frame.gain:.3g} times the gain of the table's camera"
    if table.camera is None:
        return f"{stated}, but the table does not contain the noise model of its camera; train the table again"
    there, (least, most) = table.camera.at_gain(frame.gain), known_gains(table)
    deviation = float(np.sqrt(np.max(there.noise_terms(channel=np.arange(len(there.channels)))[0])))
    if deviation > there.black_level:
        return (
            f"{stated}, where the noise in dark areas ({deviation:.0f} DN) exceeds the black level "
            f"({there.black_level:.0f} DN), so negative noise is clipped and dark areas become too bright; use a lower gain"
        )
    if least != most and not least / FAR_GAIN < frame.gain < most * FAR_GAIN:
        return (
            f"{stated}, but the camera model contains the read noise only for {least:.3g} to {most:.3g} times its gain; l3 "
            "uses the read noise at the nearest of these gains"
        )
    return ""


def odd_exposure_time(seconds: float | None, table: TransformTable) -> str:
    """Return a warning if an exposure time is probably not in seconds, otherwise ""."""
    times = seconds / table.exposure if seconds is not None and table.exposure else 0.0
    if seconds is None or (seconds <= LONG and times < MANY_TIMES):
        return ""
    compared = f" ({times:.0f} times the training mean of {table.exposure:.3g} s)" if times >= MANY_TIMES else ""
    return (
        f"‹exposure_time› {seconds:g} means {seconds:g} seconds{compared}, so l3 subtracts a dark signal of "
        f"{table.dark_signal(seconds):.3g} DN; set the time in seconds, not milliseconds"
    )


def pixel_warnings(frame: RawFrame, table: TransformTable) -> list[str]:
    """Return warnings about the pixels of a frame.

    If the file was probably read in the wrong format or size, there are no other warnings, because they would mislead.
    """
    misread = _misread(frame) or _torn(frame, table.cfa.shape[0])
    texts = [misread] if misread else [other_phase(frame, table), _value_warning(frame, table)]
    return [text for text in texts if text]


def _value_warning(frame: RawFrame, table: TransformTable) -> str:
    """Return a warning if raw values are implausible for the table's camera or for the stated levels, otherwise ""."""
    top = int(frame.values.max())
    if top > MAX_OVERSHOOT * frame.white_level:
        return _too_high(frame, table.bits, top)
    return beyond_converter(frame, table) or _clips_lower(frame, top) or _below_black(frame) or _fog(frame, table)


def _too_high(frame: RawFrame, bits: int, top: int) -> str:
    """Return a warning about values far above the white level and their probable cause, otherwise "".

    The cause may be a wrong byte order, a common factor of all values, or another bit depth. `top` is the largest value.
    """
    every, most = int(np.bitwise_or.reduce(frame.values, axis=None)), 2**bits - 1
    step = every & -every
    if 0 < every & 0xFF <= most >> 8 and bits < 16:
        return (
            f"the two bytes of each value seem to be swapped, because no low byte exceeds {every & 0xFF}; write the low "
            "byte first, or set ‹byte_order› big for a headerless file"
        )
    if step >= 4 and top // step <= most:
        return (
            f"all values are multiples of {step} and reach {top} DN, although the white level is {frame.white_level:g} DN; "
            f"divide the values by {step}, or multiply ‹black_level› and ‹white_level› by {step}"
        )
    if top <= most:
        return ""  # the values fit the bit depth, and only the stated white level is too low
    return (
        f"the values reach {top} DN, but the white level is {frame.white_level:g} DN; if the frame has a different bit "
        "depth, set ‹black_level› and ‹white_level›"
    )


def beyond_converter(frame: RawFrame, table: TransformTable) -> str:
    """Return a warning about values that the camera's A/D converter cannot produce, otherwise "".

    Frames with other black and white levels than the table are not checked.
    """
    most = 2**table.bits - 1
    levels = (frame.black_level, frame.white_level) == (table.black_level, table.white_level)
    if not levels or frame.values.max() <= most:
        return ""
    return (
        f"some values exceed {most} DN, the maximum for the table's {table.bits} bits, and are treated as clipped; if the "
        "frame has a different bit depth, set ‹black_level› and ‹white_level›"
    )


def _clips_lower(frame: RawFrame, top: int) -> str:
    """Return a warning if the values clip at the maximum of a lower bit depth, otherwise ""."""
    depth = top.bit_length()
    if not (top > frame.black_level and 8 <= depth < 16 and top == 2**depth - 1 and top < SHALLOW * frame.white_level):
        return ""
    share = float((frame.values == top).mean())
    if share < CLIPPED:
        return ""
    return (
        f"{share:.1%} of the pixels have the value {top} DN, the maximum for {depth} bits, but the white level is "
        f"{frame.white_level:g} DN; set ‹black_level› and ‹white_level›"
    )


def _below_black(frame: RawFrame) -> str:
    """Return a warning if values are farther below the black level than noise can explain, otherwise ""."""
    share = share_below_black(frame)
    if not share:
        return ""
    return (
        f"{share:.0%} of the pixels have values less than {BELOW * frame.black_level:.0f} DN, although the black level is "
        f"{frame.black_level:g} DN; if the black level was already subtracted or the bit depth is different, set "
        "‹black_level› and ‹white_level›"
    )


def _fog(frame: RawFrame, table: TransformTable) -> str:
    """Return a warning if the darkest values are near the table's black level but far above the stated one, otherwise ""."""
    black = table.black_level
    other_depth = abs(frame.white_level - table.white_level) > SAME_DEPTH * table.white_level
    if black < SMALLEST_BLACK or frame.black_level > black / 2 or other_depth:
        return ""
    darkest = float(np.percentile(frame.values[::3, ::3], BLACK_PERCENTILE))
    if not NEAR_BLACK * black <= darkest <= black / NEAR_BLACK:
        return ""
    return (
        f"the darkest values are about {darkest:.0f} DN, near the camera's black level of {black:g} DN, but ‹black_level› "
        f"is {frame.black_level:g} DN, so colours look washed out; omit ‹black_level›, or set it to {black:g}"
    )


def _torn(frame: RawFrame, period: int) -> str:
    """Return a warning if the values would form a much smoother picture of cols×rows pixels, otherwise ""."""
    rows, cols = frame.values.shape
    if not frame.exchangeable or rows == cols:
        return ""
    if _step(frame.values, period) <= SHEARED * _step(frame.values.reshape(cols, rows), period):
        return ""
    return f"the picture looks sheared at {rows}×{cols} pixels; did you mean ‹size› {cols}x{rows} (rows first)?"


def _step(values: NDArray[np.uint16], period: int) -> float:
    """Return the mean absolute difference between rows one CFA period apart, which contain the same channels."""
    last = len(values) - period
    if last < 1:
        return 0.0
    first = np.unique(np.linspace(0, last - 1, ROW_PAIRS).astype(int))
    return float(np.abs(values[first + period].astype(np.float32) - values[first]).mean())
