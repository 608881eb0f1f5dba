"""Warnings about frames that do not fit a table.

A frame may come from another camera or CFA, or have light levels for which the table was not trained. Its values may also be
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

MAX_OVERSHOOT = 1.5  # highest value of a saturated pixel, relative to the white level
SHALLOW = 0.55  # relative to the white level; a sensor with the stated bit depth does not clip at a lower value
CLIPPED = 1e-3  # the sensor is assumed to clip if at least this fraction of the pixels has the highest value
NEAR_BLACK = 0.75  # values count as black if their ratio to the black level lies between this number and its inverse
BLACK_PERCENTILE = 0.1  # percentile of the values that is close to black in most pictures
SAME_DEPTH = 0.02  # largest relative difference between the white levels of equal bit depths
SHEARED = 1.5  # a size is wrong if rows differ more, by this factor, than after exchanging rows and columns
ROW_PAIRS = 64  # number of pairs of rows that are compared

NOTABLE = {"darker": 0.05, "brighter": 0.05, "untrained": 0.2, "saturated": 0.1}  # fraction of a frame that is reported
# An exposure time is probably in another unit if it exceeds this number of seconds, or this multiple of the training's.
LONG, MANY_TIMES = 60.0, 100.0


@dataclass
class FrameWarnings:
    """Collects the warnings about the frames of a run.

    Each warning is reported once. If it concerns several frames, the worst frame is named.
    """

    table: TransformTable
    _seen: int = 0
    _first_is_beyond: bool = False  # whether the first frame has values that the converter cannot give
    _untimed: list[str] = field(default_factory=list)  # frames whose exposure time and dark level are unknown
    _others: dict[str, tuple[str, int]] = field(default_factory=dict)  # warning → first frame, number of frames
    _notes: dict[str, str] = field(default_factory=dict)  # note of a file → first frame
    _worst: dict[str, tuple[float, str, int]] = field(default_factory=dict)  # kind → fraction, worst frame, number of frames

    def __post_init__(self) -> None:
        self._meter = RangeMeter(self.table)

    def measure(self, frame: RawFrame) -> None:
        """Check a frame."""
        self._seen += 1
        if self.table.dark_signal(1.0) and frame.exposure is None and not frame.dark_measured:
            self._untimed.append(frame.name)
        of_camera = other_camera(frame, self.table), other_gain(frame, self.table)
        misread = _misread(frame)  # if the frame is misread, other checks of its values are meaningless
        of_values = (misread,) if misread else (other_phase(frame, self.table), *value_warnings(frame, self.table))
        for text in (*of_camera, *of_values):
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
        """Check every still, or the first frame of a sequence.

        Later frames of a sequence are only checked for values that the converter cannot give, and only if the first frame
        has none.
        """
        if stills or not self._seen:
            self.measure(frame)
            self._first_is_beyond = bool(beyond_converter(frame, self.table))
        elif not self._first_is_beyond:
            self._note(beyond_converter(frame, self.table), frame.name)

    def _note(self, text: str, name: str) -> None:
        """Count a warning about a frame. An empty text is ignored."""
        if text:
            first, count = self._others.get(text, (name, 0))
            self._others[text] = first, count + 1

    @property
    def assumption(self) -> str:
        """A line about the exposure time that is assumed for frames without one, or "" if there are no such frames."""
        if not self._untimed:
            return ""
        exposure, dark = self.table.exposure, self.table.dark_signal(None)
        return (
            f"{self._untimed[0]}: exposure time unknown; subtracting the dark current of the training's {exposure:.3g} s "
            f"({dark:.2g} DN); give ‹exposure_time› or ‹dark›"
        )

    def lines(self) -> Iterator[str]:
        """Yield one line per warning."""
        darkest, brightest = self._meter.learned_range()
        texts = {
            "darker": f"are darker than anything the table was trained on ({darkest:.2g} of full scale); name a "
            "lower learning.darkest or simulate shorter exposures, and train again",
            "brighter": f"are brighter than anything the table was trained on ({brightest:.2g} of full scale); raise "
            "learning.brightest or simulate longer exposures, and train again",
            "untrained": "fall into classes that are filled from their neighbours; train on more scenes or patches",
            "saturated": "are clipped or touch clipped ones, where colour is a guess; expose shorter, or give ‹white_level›",
        }
        for text, (name, count) in self._others.items():
            yield f"{name}{f' and {count - 1} more' if count > 1 else ''}: {text}"
        for note, name in self._notes.items():
            yield f"{name}: {note}"
        for what, (share, name, count) in self._worst.items():
            where = name if self._seen == 1 else f"{count} of {self._seen} frames, most in {name}"
            yield f"{where}: {share:.0%} of the pixels {texts[what]}"


def other_camera(frame: RawFrame, table: TransformTable) -> str:
    """Return a warning if the file names a camera other than the table's, otherwise ""."""
    theirs = [_words(name) for name in frame.taken_by]
    ours = _words(table.camera_name)
    if not frame.taken_by or any(ours & words - _words(frame.taken_by[0]) or ours == words for words in theirs):
        return ""
    name = max(frame.taken_by[:2], key=len)
    return (
        f"it was taken by {name}, the table is for {table.camera_name}; give the table of this camera, or name it so in "
        "its recipe"
    )


def _words(name: str) -> set[str]:
    return set(re.findall(r"[0-9a-z]+", name.lower()))


def other_phase(frame: RawFrame, table: TransformTable) -> str:
    """Return a warning, with the phase that fits, if the pixels contradict the stated CFA phase, otherwise ""."""
    if other := _other_array(frame, table):
        return other
    doubt = phase_doubt(frame, table.cfa)
    if doubt is None:
        return ""
    fitting = " or ".join(f"{row},{col}" for row, col in doubt.phases)
    return (
        f"sites of one channel differ by {doubt.stated:.1%} on average: the stated position of its colour filter array is "
        f"wrong; with ‹phase› {fitting} they differ by {doubt.least:.1%}"
    )


def _misread(frame: RawFrame) -> str:
    """Return a warning if values look like noise but would be smooth with another packing or byte order, otherwise ""."""
    if not frame.misread:
        return ""
    return f"its pixels look like noise: neighbours of one channel are unrelated; read it with {frame.misread}"


def _other_array(frame: RawFrame, table: TransformTable) -> str:
    """Return a warning if the pixels contradict the table's CFA at any phase, otherwise ""."""
    doubt = array_doubt(frame, table.cfa)
    if doubt is None:
        return ""
    known = {name: parse_cfa(each, name) for name, each in known_arrays().items()}
    return (
        f"sites of one colour differ by {doubt.differ:.0%}: it has another colour filter array than the table, such as "
        f"{' or '.join(doubt.likely(known)[:2])}; make a table for its array (‹pattern› of l3 init)"
    )


def other_gain(frame: RawFrame, table: TransformTable) -> str:
    """Return a warning if the noise at the frame's analog gain is unknown, or too large for the levels, otherwise ""."""
    if frame.gain == 1:
        return ""
    its = f"its analog gain is {frame.gain:.3g} times that of the table's camera"
    if table.camera is None:
        return f"{its}, whose noise is unknown, because the table does not hold its camera; train it again"
    there, (least, most) = table.camera.at_gain(frame.gain), known_gains(table)
    deviation = float(np.sqrt(np.max(there.noise_terms(channel=np.arange(len(there.channels)))[0])))
    if deviation > there.black_level:
        return (
            f"{its}: noise in the dark is {deviation:.0f} DN, more than the black level of {there.black_level:.0f} DN; "
            "values below 0 are cut off, and the dark becomes too bright"
        )
    if least != most and not least / FAR_GAIN < frame.gain < most * FAR_GAIN:
        return f"{its}, whose read noise is known for {least:.3g} to {most:.3g}; that of the nearest is taken"
    return ""


def odd_exposure_time(seconds: float | None, table: TransformTable) -> str:
    """Return a warning if a given exposure time is probably not in seconds, otherwise "" or nothing."""
    times = seconds / table.exposure if seconds is not None and table.exposure else 0.0
    if seconds is None or (seconds <= LONG and times < MANY_TIMES):
        return ""
    compared = f", {times:.0f} times that of the training ({table.exposure:.3g} s)" if times >= MANY_TIMES else ""
    return (
        f"‹exposure_time› {seconds:g} is {seconds:g} seconds{compared}: dark current of "
        f"{table.dark_signal(seconds):.3g} DN is taken off; give seconds, not milliseconds"
    )


def value_warnings(frame: RawFrame, table: TransformTable) -> Iterator[str]:
    """Yield warnings about values that the table's camera can hardly have produced with the frame's levels and size."""
    top = int(frame.values.max())
    too_high = top > MAX_OVERSHOOT * frame.white_level
    lower = "" if too_high else _clips_lower(frame, top) or _below_black(frame) or _fog(frame, table)
    if text := _too_high(frame, table.bits, top) if too_high else beyond_converter(frame, table) or lower:
        yield text
    if text := _torn(frame, table.cfa.shape[0]):
        yield text


def _too_high(frame: RawFrame, bits: int, top: int) -> str:
    """Return a warning about values above the white level, otherwise ""."""
    every, most = int(np.bitwise_or.reduce(frame.values, axis=None)), 2**bits - 1
    step = every & -every
    if 0 < every & 0xFF <= most >> 8 and bits < 16:
        return (
            f"the bytes of its values are exchanged: no low byte is above {every & 0xFF}; give them lower byte first, or "
            "‹byte_order› big of a headerless file"
        )
    if step >= 4 and top // step <= most:
        return (
            f"all its values are multiples of {step} and reach {top}, its white level is {frame.white_level:g} DN: they are "
            f"shifted up; divide them by {step}, or give ‹black_level› and ‹white_level› of values as these"
        )
    if top <= most:
        return ""  # only the stated white level is too low
    return (
        f"its values reach {top} DN, its white level is {frame.white_level:g}: they are of another depth, or not raw; "
        "give ‹black_level› and ‹white_level›"
    )


def beyond_converter(frame: RawFrame, table: TransformTable) -> str:
    """Return a warning about values that the camera's A/D converter cannot produce, otherwise "".

    The frame must be at the table's levels.
    """
    most = 2**table.bits - 1
    levels = (frame.black_level, frame.white_level) == (table.black_level, table.white_level)
    if not levels or frame.values.max() <= most:
        return ""
    return (
        f"some of its values are above {most} DN, the most that the table's {table.bits} bits hold, and are taken for "
        "clipped: it is of another depth, or not raw; give ‹black_level› and ‹white_level›"
    )


def _clips_lower(frame: RawFrame, top: int) -> str:
    """Return a warning if values clip at the highest value of a lower bit depth, otherwise ""."""
    depth = top.bit_length()
    if not (top > frame.black_level and 8 <= depth < 16 and top == 2**depth - 1 and top < SHALLOW * frame.white_level):
        return ""
    share = float((frame.values == top).mean())
    if share < CLIPPED:
        return ""
    return (
        f"{share:.1%} of its pixels have {top} DN and none has more: it clips there, as {depth} bits do, and its "
        f"white level is {frame.white_level:g}; give ‹black_level› and ‹white_level›"
    )


def _below_black(frame: RawFrame) -> str:
    """Return a warning about values that lie farther below black than noise explains, otherwise ""."""
    share = share_below_black(frame)
    if not share:
        return ""
    return (
        f"{share:.0%} of its pixels have less than {BELOW * frame.black_level:.0f} DN, its black level is "
        f"{frame.black_level:g}: the black level has been subtracted already, or the values have another bit depth; give "
        "‹black_level› and ‹white_level›"
    )


def _fog(frame: RawFrame, table: TransformTable) -> str:
    """Return a warning if the darkest values lie at the camera's black level but the stated black level is far lower."""
    black = table.black_level
    other_depth = abs(frame.white_level - table.white_level) > SAME_DEPTH * table.white_level
    if black < SMALLEST_BLACK or frame.black_level > black / 2 or other_depth:
        return ""
    darkest = float(np.percentile(frame.values[::3, ::3], BLACK_PERCENTILE))
    if not NEAR_BLACK * black <= darkest <= black / NEAR_BLACK:
        return ""
    return (
        f"its darkest values lie at {darkest:.0f} DN, near the camera's black level of {black:g}; with the black level "
        f"{frame.black_level:g} colours look washed out; omit ‹black_level›, or give {black:g}"
    )


def _torn(frame: RawFrame, period: int) -> str:
    """Return a warning if rows would be much smoother with rows and columns exchanged, otherwise ""."""
    rows, cols = frame.values.shape
    if not frame.exchangeable or rows == cols:
        return ""
    if _step(frame.values, period) <= SHEARED * _step(frame.values.reshape(cols, rows), period):
        return ""
    return f"the picture looks sheared at {rows}×{cols} pixels; did you mean ‹size› {cols}x{rows} (rows first)?"


def _step(values: NDArray[np.uint16], period: int) -> float:
    """Return the mean difference between rows that are `period` rows apart and therefore have the same channels."""
    last = len(values) - period
    if last < 1:
        return 0.0
    first = np.unique(np.linspace(0, last - 1, ROW_PAIRS).astype(int))
    return float(np.abs(values[first + period].astype(np.float32) - values[first]).mean())
