"""Draft a measurement file from a folder.

If the folder contains frames, l3 reads the metadata of each file, selects the frames of one sensor, and determines what each
frame shows. A folder may also contain only tables, as published measurements do.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import MAX_CHANNELS, CameraModel
from l3cli.artifacts.camera_recipe import CfaRecipe, noise_recipe
from l3cli.calibration.draft.compose import HEAD, PITCH, DraftText, Survey, known_body, unknown_optics
from l3cli.calibration.draft.names import altered, drawn, period_of, read_name, summarise, with_bare_wavelengths
from l3cli.calibration.draft.sorting import Frame, Spectra, scale_of, sort_frames, with_plain_kinds
from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.frames.measurement import DIODE, CaptureFolder, RawFile
from l3cli.system.text import counted

SAMPLED = 6  # number of frames from which the period of the array is estimated
LEFT_OUT = "; left out"  # end of each note on a file that is not used
MOST_NOTED = 12  # largest number of rejected files with a line of their own
LIGHT = re.compile(r"light[ _]+(?!diode)(.+)", re.IGNORECASE)  # heading of the column of a channel in a sweep
USUAL = {1: ["y"], 3: ["r", "g", "b"]}  # default channel names by number of columns
SENSOR = (
    ("rows", 3000, "of the sensor, by its data sheet"),
    ("cols", 4000, "of the sensor, by its data sheet"),
    ("pixel_pitch_um", 3.45, PITCH),
    ("bits", 12, "of the converter, by its data sheet"),
)
SHEET = (("black_level_dn", 64), ("white_level_dn", 4095), ("well_capacity_e", 10000), ("read_noise_e", 5.0))


@dataclass(frozen=True)
class Reading:
    """How to read the frames of a folder."""

    read: Callable[[str], RawFile]  # reads a frame by its path
    array_of: Callable[[NDArray[np.integer]], CfaRecipe]  # converts the CFA codes in a file to an array
    progress: Callable[[Sequence[Any], int, str], Iterable[Any]]  # shows the progress of a loop


@dataclass(frozen=True)
class _Fact:
    """A frame and the metadata in its file."""

    path: str
    shape: tuple[int, int]
    mean: float
    raw: RawFile  # without pixel values if memory is short

    @property
    def sensor(self) -> tuple[object, ...]:
        return self.shape, None if self.raw.pattern is None else self.raw.pattern.tobytes()


def survey(
    listing: CaptureFolder, tables: list[Spectra], notes: list[str], camera: CameraModel | None, reading: Reading
) -> Survey:
    """Survey a folder of frames.

    Parameters
    ----------
    listing : CaptureFolder
        The folder and its files.
    tables : list of Spectra
        Tables of spectra in the folder.
    notes : list of str
        A line is added for each file that is left out.
    camera : CameraModel or None
        The camera, if known.
    reading : Reading
        How to read frames.

    Returns
    -------
    Survey
        Contents of the folder.

    Raises
    ------
    InputFileError
        If the folder contains no raw frame.
    RecipeError
        If the frames are not from `camera`.
    """
    facts = _facts(listing, notes, reading)
    if not facts:
        reason = f": {notes[0].removesuffix(LEFT_OUT)}" if notes else ""
        cure = "" if "; " in reason else "; give the folder of a camera's captures"  # the reader's own says more
        raise InputFileError(f"{listing.folder} holds no raw frame{reason}{cure}")
    used = _frames_of_one_sensor(facts, notes)
    shape, pattern = used[0].shape, used[0].raw.pattern
    if camera is not None and shape != (camera.rows, camera.cols):
        raise RecipeError(
            f"{camera.name} has {camera.rows}×{camera.cols} pixels, the frames {shape[0]}×{shape[1]}; give their camera"
        )
    period = _period(used, camera, reading)
    usable = _with_wavelengths(_summarised(used, period, notes, reading), notes)
    if not usable:
        raise InputFileError(f"{listing.folder} holds no raw frame that can be used; {notes[-1]}")
    black = next((fact.raw.black_level for fact in used if fact.raw.black_level is not None), None)
    white = next((fact.raw.white_level for fact in used if fact.raw.white_level is not None), None)
    scale = scale_of(usable, black)
    groups = with_plain_kinds(sort_frames(usable, scale, notes), scale, notes)
    array = None if pattern is None else reading.array_of(pattern)
    return Survey(shape, period, array, black, white, scale, groups, tables, notes)


def _with_wavelengths(usable: list[Frame], notes: list[str]) -> list[Frame]:
    """Return the frames, with wavelengths that their names contain without a unit."""
    names = with_bare_wavelengths([frame.name for frame in usable])
    new = [name for name, frame in zip(names, usable, strict=True) if name != frame.name]
    if new:
        notes.append(f"numbers in the names of {len(new)} monochromatic frames taken for nm: {new[0].nm:g} in {new[0].path}")
    return [replace(frame, name=name) for frame, name in zip(usable, names, strict=True)]


def _facts(listing: CaptureFolder, notes: list[str], reading: Reading) -> list[_Fact]:
    """Read the metadata of every file. Pixel values are kept as long as they fit into memory."""
    facts, room = [], 64 << 20
    refused: list[str] = []
    for path in reading.progress(listing.frames, len(listing.frames), "files"):
        try:
            raw = reading.read(path)
        except L3Error as error:
            refused.append(str(error).replace(f"{listing.folder / path}", path) + LEFT_OUT)
            continue
        rows, cols = raw.values.shape
        fits = raw.values.nbytes < room
        room -= raw.values.nbytes if fits else 0
        mean = float(raw.values.mean())
        facts.append(_Fact(path, (rows, cols), mean, raw if fits else replace(raw, values=raw.values[:0].copy())))
    notes += first_lines(refused, MOST_NOTED, "{} more such files left out")
    return facts


def _frames_of_one_sensor(facts: Sequence[_Fact], notes: list[str]) -> list[_Fact]:
    """Return the frames with the size and array that most frames have."""
    count = Counter(fact.sensor for fact in facts)
    usual = max(count, key=lambda sensor: (count[sensor], -[fact.sensor for fact in facts].index(sensor)))
    for sensor in count:
        if sensor != usual:
            others = [fact for fact in facts if fact.sensor == sensor]
            rows, cols = others[0].shape
            notes.append(
                f"{len(others)} of {len(facts)} frames are of another size or array ({rows}×{cols}, such as "
                f"{others[0].path}): left out; draft them apart"
            )
    return [fact for fact in facts if fact.sensor == usual]


def _period(facts: Sequence[_Fact], camera: CameraModel | None, reading: Reading) -> tuple[int, int]:
    """Return the period (rows, columns) of the array, from the camera, the metadata, or else the brightest frames."""
    known = facts[0].raw.pattern if camera is None else camera.cfa
    if known is not None:
        return known.shape[0], known.shape[1]
    bright = sorted(facts, key=lambda fact: -fact.mean)
    sample = bright[:: max(1, len(bright) // SAMPLED)][:SAMPLED]
    frames = [reading.read(fact.path).values for fact in sample]
    return period_of([frame for frame in frames if not drawn(frame)] or frames)


def _summarised(facts: Sequence[_Fact], period: tuple[int, int], notes: list[str], reading: Reading) -> list[Frame]:
    """Summarise every frame. Drawings are left out. Frames that seem to be processed are noted."""
    usable, refused, changed = [], [], Counter[str]()
    for fact in reading.progress(facts, len(facts), "frames"):
        raw = fact.raw if fact.raw.values.size else reading.read(fact.path)
        if drawn(raw.values):
            refused.append(f"{fact.path}: has no noise, as masks and drawings have none; left out")
            continue
        if change := altered(raw.values):
            changed[change] += 1
        name, seconds = read_name(fact.path), raw.seconds
        if seconds is not None and name.seconds is not None and abs(seconds / name.seconds - 1) > 0.1:
            refused.append(f"{fact.path}: its name says {name.seconds:g} s, its file {seconds:g} s; the file's is taken")
        by_name = seconds is None
        shown = summarise(raw.values, period)
        usable.append(Frame(name, shown, name.seconds if by_name else seconds, by_name, fact.raw.count))
    notes += first_lines(refused, MOST_NOTED, "{} more such files left out")
    notes += [
        f"{count} frame{'s' * (count > 1)}: {what}; check that they are raw values" for what, count in changed.most_common(2)
    ]
    return usable


def first_lines(lines: Sequence[str], most: int, more: str) -> list[str]:
    """Return the first `most` lines, and a line with the number of further lines in the format `more`."""
    return [*lines[:most], *([more.format(len(lines) - most)] if len(lines) > most else [])]


def compose_tables(tables: Sequence[Spectra], camera: CameraModel | None, name: str, left_out: Sequence[str]) -> DraftText:
    """Draft a measurement file from tables alone: a sweep beside a photodiode, or finished curves.

    Parameters
    ----------
    tables : sequence of Spectra
        Tables of the folder.
    camera : CameraModel or None
        The camera, if it is known. Sensor, array and optics are then taken from it.
    name : str
        Name of the folder.
    left_out : sequence of str
        Notes on files that are not tables of spectra.

    Raises
    ------
    InputFileError
        If no table contains a sweep or curves.
    """
    out = DraftText()
    sweep = next((table for table in tables if channels_of_sweep(table)), None)
    curves = _finished(tables)
    if sweep is None and not curves:
        raise InputFileError(_nothing(tables))
    used = sweep or curves[0]
    names = channels_of_sweep(used) or (list(used.table.names) if used.table.names else None)
    if camera is None:
        out.assume("name", name, "the folder's name", announced=False)
        _body(out, names, len(used.table.values))
    else:
        out.key("name", camera.name)
        known_body(out, camera)
    if sweep is not None:
        out.table("[sweep]", table=sweep.path)
        _photodiode(out, sweep, tables)
    else:
        out.table("[curves]")
        if left_out:
            files = ", ".join(note.partition(":")[0] for note in left_out)
            out.assume(
                "file", used.path, f"finished curves; if {files} measured them, give a [sweep] of those with wavelengths"
            )
        else:
            out.key("file", used.path)
        for other in curves[1:]:
            out.comment(f"or {other.path}")
        _per_energy(out, used)
    sensor_figures(out, camera)
    out.comment("", "How well photodiode and wavelengths were known: [uncertainty] (documentation, Measurement files)")
    out.head(HEAD)
    return out


def channels_of_sweep(spectra: Spectra) -> list[str]:
    """Return the channels in the heading of a sweep beside a photodiode, or an empty list for other tables."""
    names = spectra.table.names or ()
    channels = [match[1] for name in names if (match := LIGHT.fullmatch(name))]
    diode = any("diode" in DIODE.get(name.casefold(), name).casefold() for name in names)
    return channels if diode and len(names) == 2 * len(channels) + 2 else []


def _finished(tables: Sequence[Spectra]) -> list[Spectra]:
    """Return the tables that may be responsivities.

    Lines of a monochromator and patches of a chart are excluded. A table of one column may be a lamp or a photodiode, so it
    counts only if there is no other table.
    """
    broad = [table for table in tables if not table.has_patches and not _has_lines(table)]
    broad = [table for table in broad if len(table.table.values) <= MAX_CHANNELS and table.table.values.max() > 0]
    return [table for table in broad if len(table.table.values) > 1] or (broad if len(tables) == 1 else [])


def _has_lines(spectra: Spectra) -> bool:
    """Whether the columns are the steps of a monochromator: by the wavelengths in the heading, or by their shape."""
    names = spectra.table.names
    return spectra.narrow if names is None else all(read_name(f"{name}.csv").nm is not None for name in names)


def _nothing(tables: Sequence[Spectra]) -> str:
    table = tables[0]
    first, last = table.table.wavelength[[0, -1]]
    more = f" and {len(tables) - 1} more" if len(tables) > 1 else ""
    return (
        f"{table.path} ({counted(len(table.table.values), 'column')}, {first:g}…{last:g} nm){more}: neither a sweep nor "
        "responsivities, and there is no raw frame; add the table with a column for each channel, or the captures"
    )


def _body(out: DraftText, names: list[str] | None, columns: int) -> None:
    """Add [sensor], [cfa] and [optics] for the user to fill in; channel names come from the table."""
    out.table("[sensor]")
    for key, example, what in SENSOR:
        out.todo(key, example, what, "[sensor]")
    out.table("[cfa]")
    if names:
        out.key("channels", names, "as the table's heading names them")
    elif columns in USUAL:
        out.assume("channels", USUAL[columns], "the usual order of columns; the table has no heading")
    else:
        out.todo("channels", ["r", "g", "b"], "names of the channels, in the order of the table's columns", "[cfa]")
    out.todo("pattern", ["r g", "g b"], "rows of names, which repeat over the sensor", "[cfa]")
    unknown_optics(out)


def _photodiode(out: DraftText, sweep: Spectra, tables: Sequence[Spectra]) -> None:
    """Add the table of the photodiode: one column that covers the sweep."""
    grid = sweep.table.wavelength
    single = [table for table in tables if table is not sweep and len(table.table.values) == 1]
    single = [table for table in single if table.table.wavelength[0] <= grid[0] and grid[-1] <= table.table.wavelength[-1]]
    if not single:
        out.todo("photodiode", "diode.csv", "response of the photodiode over the whole sweep, such as A/W", "[sweep]")
    elif len(single) == 1:
        out.key("photodiode", single[0].path)
    else:
        others = ", ".join(table.path for table in single[1:])
        out.assume("photodiode", single[0].path, f"one of several tables of one column: also {others}")


def _per_energy(out: DraftText, curves: Spectra) -> None:
    """Add whether the curves are per energy or per photon. Their unit decides, if there is one."""
    possible = [each for each in (True, False) if _has_unit(curves, each)]
    if len(possible) == 1:
        out.key("per_energy", possible[0], "by the unit in the heading")
    elif "%" in curves.table.units:
        out.assume("per_energy", False, "percentages are quantum efficiencies; true: relative, per energy")
    else:
        out.assume("per_energy", True, "relative curves usually are; false: per photon, as quantum efficiencies are")


def _has_unit(curves: Spectra, per_energy: bool) -> bool:
    try:
        curves.table.responses(per_energy, "per_energy")
    except InputFileError:
        return False
    return True


def sensor_figures(out: DraftText, camera: CameraModel | None) -> None:
    """Add [datasheet], because tables of curves say nothing about the sensor."""
    if camera is None:
        out.todo_table("[datasheet]", "the sensor's figures: no white and dark frames measure them", *SHEET)
        return
    out.table(
        "[datasheet]",
        black_level_dn=camera.black_level,
        white_level_dn=camera.white_level,
        gain_dn_per_e=camera.gain,
        **msgspec.structs.asdict(noise_recipe(camera.noise)),
    )
