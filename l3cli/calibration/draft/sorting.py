"""Group frames into captures, and assign spectra to captures.

The type of a capture follows from the names of its frames or, if they do not contain it, from the content of the frames. Its
spectrum is found by the wavelength or illuminant in the names, or by the order of the names.
"""

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera_recipe import CfaRecipe
from l3cli.calibration.draft.names import EVEN, Name, Summary, natural, read_name
from l3cli.frames.chart import corner_cells, locate, through
from l3cli.frames.measurement import PATCHES
from l3cli.physics import charts
from l3cli.spectra.table import BRIGHTEST, DIMMEST, CurveTable

DARK = 0.01  # fraction of `Scale.range`; frames with a lower signal are dark frames
ALIKE = 0.04  # largest relative difference between signals in one capture, or between colours under one illuminant
CLIPPED = 0.97  # fraction of `Scale.range`; captures with a higher 90th percentile are saturated
SAME_RATE = 0.1  # largest relative difference between signals per second under the same illuminant
LEAST_WHITES = 3  # smallest number of captures under the same illuminant that are classified as white
# A frame with "dark" in its name is suspicious if its signal exceeds both the fraction BRIGHT_DARK of `Scale.range` and
# BRIGHTER times its noise.
BRIGHT_DARK, BRIGHTER = 0.05, 5.0
Array = NDArray[np.floating]
SAME_CHANNEL = 0.05  # largest difference between two sites of the same channel, as a fraction of the largest response
LEAST_STEPS = 5  # smallest number of monochromatic captures from which the colour filter array is guessed
GRID_NM = np.arange(400.0, 701.0, 10.0)
SEARCHED = 6  # number of brightest unclipped captures in which l3 searches for a chart
DIM = 0.05  # captures with a signal below this fraction of `Scale.range` are too dark to search for a chart
Corners = list[tuple[float, float]]  # column and row in pixels of the outer corners of patches 1, 6, 24 and 19
NARROW_NM = 40.0  # nm; largest FWHM of a narrow-band spectrum
NEAR_NM = 5.0  # nm; largest difference between the wavelength in a name and the peak of the spectrum


@dataclass(frozen=True)
class Frame:
    """A raw frame in the folder."""

    name: Name
    summary: Summary
    seconds: float | None  # exposure time, from the metadata or, if they do not contain it, from the file name
    by_name: bool = False  # whether the exposure time comes from the file name
    count: int = 1  # number of frames in the file, all of the same scene with the same exposure


@dataclass(frozen=True)
class Group:
    """A capture: frames of the same scene with the same exposure."""

    kind: str  # dark, white, mono, band, chart or polariser; if the type is unknown: "plain" (uniform) or "structured"
    frames: tuple[Frame, ...]

    @property
    def first(self) -> Frame:
        return self.frames[0]

    @property
    def level(self) -> Array:
        """Mean value of each CFA site in DN."""
        return np.asarray(np.mean([frame.summary.level for frame in self.frames], axis=0))


@dataclass(frozen=True)
class Scale:
    """Range of the values of all frames in a folder."""

    black: Array  # (site,): black level in DN
    bright: float  # highest 90th percentile of all frames and sites in DN

    @property
    def range(self) -> float:
        return max(self.bright - float(self.black.mean()), 1.0)

    def signal(self, group: Group) -> Array:
        """Return the mean signal above black of each CFA site in DN."""
        return np.asarray(group.level - self.black)

    def clipped(self, group: Group) -> bool:
        """Return whether the brightest CFA site of a capture is saturated."""
        high = max(float(frame.summary.high.max()) for frame in group.frames)
        return high - self.black.mean() >= CLIPPED * self.range


def scale_of(frames: Sequence[Frame], black: float | None) -> Scale:
    """Determine the range of raw values over all frames in a folder.

    The black level in DN is the first available of: (1) `black`, from the metadata; (2) the mean of the darkest frame with
    "dark" in its name; (3) the mean of the darkest frame, if it is uniform; (4) 0.
    """
    sites = frames[0].summary.level.size
    called = [frame for frame in frames if frame.name.kind == "dark"]
    darkest = min(called or frames, key=lambda frame: float(frame.summary.level.mean()))
    bright = max(float(frame.summary.high.max()) for frame in frames)
    if black is not None:
        level: Array = np.full(sites, black)
    elif called or (darkest.summary.unevenness(0.0) < EVEN and np.ptp(darkest.summary.level) < DARK * bright / 3):
        level = darkest.summary.level
    else:
        level = np.zeros(sites)
    return Scale(level, bright)


def sort_frames(frames: Sequence[Frame], scale: Scale, notes: list[str]) -> list[Group]:
    """Group frames into captures, sorted by name. Remarks about frames that contradict their names are added to `notes`."""
    ordered = sorted(frames, key=lambda frame: natural(frame.name.path))
    kinds = [_kind(frame, scale, notes) for frame in ordered]
    groups: dict[tuple[object, ...], list[Frame]] = {}
    for frame, kind in zip(ordered, kinds, strict=True):
        time = None if frame.seconds is None else float(f"{frame.seconds:.3g}")
        name = frame.name
        known = (kind, name.nm, name.light, name.angle, time, name.words if kind != "dark" else None)
        members = groups.setdefault((*known, frame.name.series if frame.seconds is None else None), [])
        members.append(frame)
    captures = [Group(str(key[0]), tuple(part)) for key, members in groups.items() for part in _alike(members, scale)]
    return sorted(captures, key=lambda group: natural(group.first.name.path))


def _kind(frame: Frame, scale: Scale, notes: list[str]) -> str:
    """Determine a frame's type (see `Group.kind`) from its name or, if the name does not contain it, from the frame.

    A note is added if a frame with "dark" in its name is bright.
    """
    name, black = frame.name, float(scale.black.mean())
    signal = frame.summary.level - scale.black
    share = float(signal.max()) / scale.range
    if name.kind == "dark" and share > BRIGHT_DARK and signal.max() > BRIGHTER * frame.summary.noise:
        notes.append(
            f'{name.path} has "dark" in its name, but is {signal.max():.0f} DN brighter than black; check this file'
        )
    if name.kind == "chart" and name.nm is not None:
        return "band"
    if name.kind is not None:
        return name.kind
    if share < DARK and float(np.ptp(signal)) < DARK * scale.range / 3:
        return "dark"
    structured = share >= DARK and frame.summary.unevenness(black) > EVEN
    if name.nm is not None:
        return "band" if structured else "mono"
    return "structured" if structured else "plain"


def _alike(members: Sequence[Frame], scale: Scale) -> Iterable[list[Frame]]:
    """Split frames with similar names into lists with about the same signal at each CFA site."""
    parts: list[list[Frame]] = []
    for frame in members:
        signal = frame.summary.level - scale.black
        for part in parts:
            other = part[0].summary.level - scale.black
            if np.abs(signal - other).max() <= max(ALIKE * float(np.abs(other).max()), DARK * scale.range):
                part.append(frame)
                break
        else:
            parts.append([frame])
    return parts


def with_plain_kinds(groups: Sequence[Group], scale: Scale, notes: list[str]) -> list[Group]:
    """Classify each capture of the type "plain" as white or monochromatic, and add a note about the result.

    White captures have the same illuminant, and monochromatic captures have different ones. The largest group of unclipped
    captures under the same illuminant is therefore white, if it consists of at least LEAST_WHITES captures and if no name
    contains "white". All other unclipped captures are monochromatic. A clipped capture has no usable colour, so it gets the
    type of the preceding plain capture.
    """
    plain = [group for group in groups if group.kind == "plain"]
    if not plain:
        return list(groups)
    usable = [group for group in plain if not scale.clipped(group)]
    has_white = any(group.kind == "white" for group in groups)
    largest: list[Group] = []
    for group in usable:
        cluster = [other for other in usable if _same_light(group, other, scale)]
        largest = max(largest, cluster, key=lambda each: sum(len(group.frames) for group in each))
    white = [] if has_white or len(largest) < LEAST_WHITES else largest
    kinds: dict[int, str] = {}
    last = "mono"
    for group in plain:
        if group in usable:
            last = "white" if any(group is each for each in white) else "mono"
        kinds[id(group)] = last
    whites = sum(kind == "white" for kind in kinds.values())
    notes.append(
        f"the names of {len(kinds)} captures do not contain their type; from their content, {whites} were classified as "
        f"white (same illuminant, several exposures) and {len(kinds) - whites} as monochromatic; check these captures"
    )
    return [replace(group, kind=kinds.get(id(group), group.kind)) for group in groups]


def _same_light(group: Group, other: Group, scale: Scale) -> bool:
    """Return whether two uniform captures have the same illuminant.

    Their colours must agree. If both exposure times are known, their signals per second must also agree.
    """
    one, two = scale.signal(group), scale.signal(other)
    if min(one.max(), two.max()) <= 0 or np.abs(one / one.max() - two / two.max()).max() > ALIKE:
        return False
    times = group.first.seconds, other.first.seconds
    return None in times or abs(one.max() * times[1] / (two.max() * times[0]) - 1.0) < SAME_RATE


def guess_array(steps: Sequence[Group], scale: Scale, period: tuple[int, int]) -> CfaRecipe | None:
    """Guess the colour filter array from the wavelengths to which its sites respond.

    `steps` are monochromatic captures. They are ignored if they clip, if they are too dark, or if their names contain no
    wavelength. Returns None if fewer than LEAST_STEPS captures remain, or if no site responds.
    """
    steps = [step for step in steps if step.first.name.nm is not None and not scale.clipped(step)]
    if len(steps) < LEAST_STEPS:
        return None
    # Captures have different exposures, so the responses in each capture are divided by the largest one.
    signal = np.array([scale.signal(step) for step in steps])
    weight = signal.max(axis=1, keepdims=True)
    seen = weight[:, 0] > 0.05 * weight.max()
    shares = signal[seen] / weight[seen]
    wavelength = np.array([step.first.name.nm for step in steps], dtype=np.float64)[seen]
    channel_of: list[int] = []
    curves: list[Array] = []
    for curve in shares.T:
        alike = [number for number, other in enumerate(curves) if np.abs(curve - other).max() < SAME_CHANNEL]
        if not alike:
            curves.append(curve)
        channel_of.append(alike[0] if alike else len(curves) - 1)
    if len(wavelength) < LEAST_STEPS or max(curve.max() for curve in curves) <= 0:
        return None
    peaks = [float(wavelength[curve > 0.5 * curve.max()].mean()) for curve in curves]
    names = _names(peaks)
    order = np.argsort([-peak for peak in peaks]) if len(peaks) == 3 else np.arange(len(peaks))
    rows, cols = period
    pattern = [" ".join(names[channel_of[row * cols + col]] for col in range(cols)) for row in range(rows)]
    return CfaRecipe([names[number] for number in order], pattern)


def _names(peaks: Sequence[float]) -> list[str]:
    """Name channels by their peak wavelengths in nm.

    A single channel is called "w", and three channels "r", "g" and "b". Otherwise names contain the peak wavelength, as in
    "nm550".
    """
    if len(peaks) == 1:
        return ["w"]
    if len(peaks) == 3:
        letters = dict(zip(np.argsort(peaks).tolist(), "bgr", strict=True))
        return [letters[number] for number in range(3)]
    names = [f"nm{peak:.0f}" for peak in peaks]
    return [name if names.count(name) == 1 else f"{name}_{number + 1}" for number, name in enumerate(names)]


def find_corners(mosaic: Array, period: tuple[int, int]) -> Corners | None:
    """Find the corners of a ColorChecker in a mosaic of values above black, or return None if there is no ColorChecker.

    CFA sites are treated as separate channels, because the channels may be unknown.
    """
    sites = np.arange(period[0] * period[1], dtype=np.uint8).reshape(period)
    found = locate(mosaic, sites, charts.chart("classic", GRID_NM)[1], charts.CLASSIC)
    if found is None:
        return None
    return [(round(float(x), 1), round(float(y), 1)) for x, y in through(found.to_pixels, corner_cells(*charts.CLASSIC))]


def corners_of_series(
    groups: Sequence[Group], scale: Scale, period: tuple[int, int], read: Callable[[str], Array]
) -> Corners | None:
    """Find the corners of a chart that does not move during a series of captures.

    The corners are the median over several captures. `read` returns the raw values of the frame at a path. If there is no
    chart, the result is None.
    """
    lit = [group for group in groups if scale.signal(group).max() > DIM * scale.range]
    lit.sort(key=lambda group: (scale.clipped(group), -float(scale.signal(group).max())))
    black = float(scale.black.mean())
    found = [each for group in lit[:SEARCHED] if (each := find_corners(read(group.first.name.path) - black, period))]
    if not found:
        return None
    middle = np.median(np.array(found), axis=0)
    return [(round(float(x), 1), round(float(y), 1)) for x, y in middle]


@dataclass(frozen=True)
class Spectra:
    """A table of spectra in the folder."""

    path: str  # path as it is written in the measurement file
    name: Name  # information in the path relative to the folder
    table: CurveTable

    @property
    def narrow(self) -> bool:
        """Whether most columns are narrow-band spectra, such as the steps of a monochromator."""
        return float(np.mean([_narrow(self.table.wavelength, curve) for curve in self.table.values])) > 0.5

    @property
    def has_patches(self) -> bool:
        """Whether the table contains the spectra of a ColorChecker: one column per patch, most of them not narrow-band."""
        return len(self.table.values) == PATCHES and not self.narrow


@dataclass(frozen=True)
class Column:
    """One spectrum in a table."""

    spectra: Spectra  # the table
    number: int  # number of the column, from 1
    name: str | None  # name of the column in the heading; None if the table has no heading
    nm: float  # wavelength in the heading or, if the heading contains none, wavelength of the peak

    @property
    def key(self) -> int | str:
        """Value for the key `column` in a measurement file: the column's name if it is unique, otherwise its number."""
        names = self.spectra.table.names or ()
        return self.name if self.name and names.count(self.name) == 1 else self.number


def columns_of(tables: Sequence[Spectra]) -> list[Column]:
    """List the columns of all tables in which most spectra are narrow-band.

    A column's wavelength comes from its name or, if the table has only one column, from the file name. If neither contains a
    wavelength, the wavelength of the peak is used.
    """
    columns = []
    for spectra in tables:
        if not spectra.narrow:
            continue
        names = spectra.table.names or (None,) * len(spectra.table.values)
        for number, (name, curve) in enumerate(zip(names, spectra.table.values, strict=True), 1):
            stated = read_name(f"{name}.csv").nm if name else None
            stated = stated if stated is not None or len(names) > 1 else spectra.name.nm
            peak = float(spectra.table.wavelength[int(np.argmax(curve))])
            columns.append(Column(spectra, number, name, peak if stated is None else stated))
    return columns


def match_steps(steps: Sequence[Group], columns: Sequence[Column], scale: Scale, notes: list[str]) -> list[Column | None]:
    """Assign a spectrum to each monochromatic capture, or None if no spectrum matches.

    Captures are matched by the wavelengths in their names or, if a name contains none, by their order.
    """
    if not columns or not steps:
        return [None] * len(steps)
    found = [_by_wavelength(step.first.name, columns) for step in steps]
    unnamed = [number for number, step in enumerate(steps) if step.first.name.nm is None]
    if unnamed:
        rest = [column for column in columns if all(column is not each for each in found)]
        given = _in_order([steps[number] for number in unnamed], rest, scale, notes)
        for number, column in zip(unnamed, given, strict=True):
            found[number] = column
    return found


def _in_order(
    steps: Sequence[Group], columns: Sequence[Column], scale: Scale, notes: list[str]
) -> Sequence[Column] | list[None]:
    """Assign spectra by their order to captures without a wavelength in their names, and add a note about the result.

    This requires as many spectra as captures or monochromator steps. Otherwise, no spectra are assigned.
    """
    numbers = list(range(len(steps))) if len(steps) == len(columns) else _steps_in_order(steps, scale)
    if numbers[-1] + 1 != len(columns):
        notes.append(
            f"{len(columns)} spectra could not be assigned to {len(steps)} monochromatic captures; write the wavelengths "
            'into the file names (mono_450nm.tif), or set "spectrum" and "column" of each capture'
        )
        return [None] * len(steps)
    notes.append(
        f"spectra were assigned to {len(steps)} monochromatic captures in the order of the file names, {columns[0].nm:g} to "
        f"{columns[-1].nm:g} nm; check the order"
    )
    return [columns[number] for number in numbers]


def _steps_in_order(steps: Sequence[Group], scale: Scale) -> list[int]:
    """Return each capture's monochromator step, counted from 0.

    An unclipped capture after a clipped capture is a repetition of the same step with a shorter exposure.
    """
    forward = (not scale.clipped(step) or scale.clipped(before) for before, step in itertools.pairwise(steps))
    return list(itertools.accumulate(forward, initial=0))


def _by_wavelength(name: Name, columns: Sequence[Column]) -> Column | None:
    if name.nm is None:
        return None
    wanted = name.nm
    nearest = min(abs(column.nm - wanted) for column in columns)
    if nearest > NEAR_NM:
        return None
    nearest_columns = [column for column in columns if abs(column.nm - wanted) == nearest]

    def unlike(column: Column) -> tuple[int, int]:
        words = read_name(f"{column.name}.csv").words if column.name else column.spectra.name.words
        return len(words ^ name.words), column.number

    return min(nearest_columns, key=unlike)


def match_charts(charts: Sequence[Group], tables: Sequence[Spectra], notes: list[str]) -> list[Spectra | None]:
    """Assign a table of radiances to each chart, or None if no table matches.

    A table matches if its name and the chart's name contain the same illuminant. If a chart has no match, but there are as
    many tables as charts, all tables are assigned by their order, and a note is added.
    """
    patches = [table for table in tables if table.has_patches]
    lights = [table.name.light for table in patches]
    found: list[Spectra | None] = []
    for chart in charts:
        light = chart.first.name.light
        found.append(patches[lights.index(light)] if light is not None and lights.count(light) == 1 else None)
    if None in found and len(patches) == len(charts):
        notes.append(f"radiances were assigned to {len(charts)} charts in the order of the file names; check the order")
        return list(patches)
    return found


def match_light(chart: Group, tables: Sequence[Spectra]) -> tuple[Spectra | None, bool]:
    """Find the measured illuminant of a photo of a chart.

    Illuminant spectra are tables with one broad-band column. A table matches a photo if both names contain the same
    illuminant, or if the photo's name contains the table's name. If no table matches, a single table is used anyway, unless
    its name contains an illuminant.

    Returns
    -------
    table : Spectra or None
        The spectrum, or None if there is no suitable table.
    named : bool
        Whether the table matches the photo by name.
    """
    broad = [table for table in tables if len(table.table.values) == 1 and not table.narrow]
    same = [table for table in broad if table.name.light is not None and table.name.light == chart.first.name.light]
    if len(same) == 1:
        return same[0], True
    stem = PurePath(chart.first.name.path).stem.lower()
    named = [table for table in broad if PurePath(table.name.path).stem.lower() in stem]
    if len(named) == 1:
        return named[0], True
    return (broad[0], False) if len(broad) == 1 and broad[0].name.light is None else (None, False)


def radiances(table: CurveTable, column: int | None) -> Array:
    """Return the values of one column, counted from 0, or of all columns if it is None: (column, wavelength)."""
    return table.values if column is None else table.values[column : column + 1]


def unknown_unit(table: CurveTable, column: int | None) -> bool:
    """Return whether the unit of radiances is unknown: not in the heading, and not evident from typical photon radiances."""
    return not any(table.units) and not DIMMEST <= radiances(table, column).max() <= BRIGHTEST


def note_unused(columns: Sequence[Column], matched: Sequence[Column | None], notes: list[str]) -> None:
    """Add a note about spectra that were not assigned to a capture, if other spectra were assigned."""
    unused = [column for column in columns if all(column is not each for each in matched)]
    if unused and any(matched):
        where = ", ".join(f"{column.nm:g} nm" for column in unused[:6])
        notes.append(
            f"{len(unused)} spectra were not assigned to a monochromatic capture: {where}{' …' if len(unused) > 6 else ''}"
        )


def _narrow(wavelength: Array, curve: Array) -> bool:
    base = float(np.median(curve))
    above = wavelength[curve - base > 0.5 * (curve.max() - base)]
    return bool(above.size) and bool(np.ptp(above) <= NARROW_NM)
