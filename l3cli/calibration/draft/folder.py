"""Drafts a measurement file from a folder.

If the folder contains frames, l3 reads the metadata of each file, selects the frames of one sensor, and determines the
content of each frame. A folder may also contain only tables, such as published measurements.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import MAX_CHANNELS, CameraModel
from l3cli.artifacts.camera_recipe import CfaRecipe, noise_entries
from l3cli.calibration.draft.compose import HEAD, PITCH, DraftText, Survey, known_body, unknown_optics
from l3cli.calibration.draft.names import altered, drawn, period_of, read_name, summarise, with_bare_wavelengths
from l3cli.calibration.draft.sorting import Frame, Spectra, scale_of, sort_frames, with_plain_kinds
from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.frames.measurement import DIODE, CaptureFolder, RawFile
from l3cli.system.text import counted

SAMPLED = 6  # number of frames from which the period of the array is estimated
LEFT_OUT = "; left out"  # end of each note about a file that is not used
MOST_NOTED = 12  # largest number of rejected files with separate notes
LIGHT = re.compile(r"light[ _]+(?!diode)(.+)", re.IGNORECASE)  # heading of the column of a channel in a sweep
USUAL = {1: ["y"], 3: ["r", "g", "b"]}  # default channel names by number of columns
SENSOR = (
    ("rows", 3000, "number of rows, from the data sheet"),
    ("cols", 4000, "number of columns, from the data sheet"),
    ("pixel_pitch_um", 3.45, PITCH),
    ("bits", 12, "bit depth of the converter, from the data sheet"),
)
SHEET = (("black_level_dn", 64), ("white_level_dn", 4095), ("well_capacity_e", 10000), ("read_noise_e", 5.0))


@dataclass(frozen=True)
class Reading:
    """Functions that read the frames of a folder."""

    read: Callable[[str], RawFile]  # reads the frame with the given path
    array_of: Callable[[NDArray[np.integer]], CfaRecipe]  # converts the CFA codes in a file to a colour filter array
    progress: Callable[[Sequence[Any], int, str], Iterable[Any]]  # shows the progress of a loop


@dataclass(frozen=True)
class _Fact:
    """A frame and the metadata in its file."""

    path: str
    shape: tuple[int, int]
    mean: float
    raw: RawFile  # without pixel values if they would need too much memory

    @property
    def sensor(self) -> tuple[object, ...]:
        return self.shape, None if self.raw.pattern is None else self.raw.pattern.tobytes()


def survey(
    listing: CaptureFolder, tables: list[Spectra], notes: list[str], camera: CameraModel | None, reading: Reading
) -> Survey:
    """Determine the contents of a folder of frames.

    Parameters
    ----------
    listing : CaptureFolder
        The folder and its files.
    tables : list of Spectra
        Tables of spectra in the folder.
    notes : list of str
        A note is added for each file that is left out.
    camera : CameraModel or None
        The camera, if it is known.
    reading : Reading
        Functions that read frames.

    Raises
    ------
    InputFileError
        If the folder contains no raw frame.
    RecipeError
        If the size of the frames does not agree with `camera`.
    """
    facts = _facts(listing, notes, reading)
    if not facts:
        reason = f": {notes[0].removesuffix(LEFT_OUT)}" if notes else ""
        cure = "" if "; " in reason else "; specify a folder with the captures of a camera"  # unless the reason says more
        raise InputFileError(f"{listing.folder} contains no raw frame{reason}{cure}")
    used = _frames_of_one_sensor(facts, notes)
    shape, pattern = used[0].shape, used[0].raw.pattern
    if camera is not None and shape != (camera.rows, camera.cols):
        raise RecipeError(
            f"{camera.name} has {camera.rows}×{camera.cols} pixels, but the frames have {shape[0]}×{shape[1]} pixels; "
            "set ‹camera› to the camera that captured the frames"
        )
    period = _period(used, camera, reading)
    usable = _with_wavelengths(_summarised(used, period, notes, reading), notes)
    if not usable:
        raise InputFileError(f"{listing.folder} contains no usable raw frame; {notes[-1]}")
    black = next((fact.raw.black_level for fact in used if fact.raw.black_level is not None), None)
    white = next((fact.raw.white_level for fact in used if fact.raw.white_level is not None), None)
    scale = scale_of(usable, black)
    groups = with_plain_kinds(sort_frames(usable, scale, notes), scale, notes)
    array = None if pattern is None else reading.array_of(pattern)
    return Survey(shape, period, array, black, white, scale, groups, tables, notes)


def _with_wavelengths(usable: list[Frame], notes: list[str]) -> list[Frame]:
    """Add wavelengths that the names of frames contain without a unit."""
    names = with_bare_wavelengths([frame.name for frame in usable])
    new = [name for name, frame in zip(names, usable, strict=True) if name != frame.name]
    if new:
        notes.append(
            f"numbers in the names of {len(new)} monochromatic frames are assumed to be wavelengths in nm, for example "
            f"{new[0].nm:g} in {new[0].path}"
        )
    return [replace(frame, name=name) for frame, name in zip(usable, names, strict=True)]


def _facts(listing: CaptureFolder, notes: list[str], reading: Reading) -> list[_Fact]:
    """Read the metadata of every file. Pixel values are kept as long as they fit into 64 MiB.

    Files that cannot be read are left out, and notes about them are added.
    """
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
    notes += first_lines(refused, MOST_NOTED, "{} more files left out")
    return facts


def _frames_of_one_sensor(facts: Sequence[_Fact], notes: list[str]) -> list[_Fact]:
    """Return the frames with the most common combination of size and colour filter array.

    Notes about the other frames are added.
    """
    count = Counter(fact.sensor for fact in facts)
    usual = max(count, key=lambda sensor: (count[sensor], -[fact.sensor for fact in facts].index(sensor)))
    for sensor in count:
        if sensor != usual:
            others = [fact for fact in facts if fact.sensor == sensor]
            rows, cols = others[0].shape
            notes.append(
                f"{len(others)} of {len(facts)} frames left out, because their size or colour filter array differs "
                f"({rows}×{cols}, for example {others[0].path}); make a separate draft for these frames"
            )
    return [fact for fact in facts if fact.sensor == usual]


def _period(facts: Sequence[_Fact], camera: CameraModel | None, reading: Reading) -> tuple[int, int]:
    """Return the period of the colour filter array in rows and columns.

    It is the period of the camera, if the camera is known, or the period in the metadata. Otherwise it is estimated from
    the brightest frames.
    """
    known = facts[0].raw.pattern if camera is None else camera.cfa
    if known is not None:
        return known.shape[0], known.shape[1]
    bright = sorted(facts, key=lambda fact: -fact.mean)
    sample = bright[:: max(1, len(bright) // SAMPLED)][:SAMPLED]
    frames = [reading.read(fact.path).values for fact in sample]
    return period_of([frame for frame in frames if not drawn(frame)] or frames)


def _summarised(facts: Sequence[_Fact], period: tuple[int, int], notes: list[str], reading: Reading) -> list[Frame]:
    """Summarise every frame.

    Drawings are left out. Notes are added about drawings, about frames that seem to be processed, and about frames whose
    exposure time differs between the file name and the metadata. The exposure time in the metadata is used.
    """
    usable, refused, changed = [], [], Counter[str]()
    for fact in reading.progress(facts, len(facts), "frames"):
        raw = fact.raw if fact.raw.values.size else reading.read(fact.path)
        if drawn(raw.values):
            refused.append(f"{fact.path} has no noise, so it seems to be a mask or a drawing; left out")
            continue
        if change := altered(raw.values):
            changed[change] += 1
        name, seconds = read_name(fact.path), raw.seconds
        if seconds is not None and name.seconds is not None and abs(seconds / name.seconds - 1) > 0.1:
            refused.append(
                f"{fact.path}: the exposure time is {name.seconds:g} s in the name but {seconds:g} s in the metadata, "
                "which are used"
            )
        by_name = seconds is None
        shown = summarise(raw.values, period)
        usable.append(Frame(name, shown, name.seconds if by_name else seconds, by_name, fact.raw.count))
    notes += first_lines(refused, MOST_NOTED, "similar notes about {} more files")
    notes += [
        f"{counted(count, 'frame')}: {change}; use raw values that are not processed"
        for change, count in changed.most_common(2)
    ]
    return usable


def first_lines(lines: Sequence[str], most: int, more: str) -> list[str]:
    """Return the first `most` lines. If there are more, append the text `more` with their number."""
    return [*lines[:most], *([more.format(len(lines) - most)] if len(lines) > most else [])]


def compose_tables(tables: Sequence[Spectra], camera: CameraModel | None, name: str, left_out: Sequence[str]) -> DraftText:
    """Draft a measurement file from tables alone: a sweep that was measured with a photodiode, or finished curves.

    Parameters
    ----------
    tables : sequence of Spectra
        Tables in the folder.
    camera : CameraModel or None
        The camera, if it is known. The draft then contains its sensor, colour filter array and optics.
    name : str
        Name of the folder.
    left_out : sequence of str
        Notes about files that are not tables of spectra.

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
        out.assume("name", name, "the name of the folder", announced=False)
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
                "file", used.path, f"finished curves; if {files} contain the raw sweep, add wavelengths and use [sweep]"
            )
        else:
            out.key("file", used.path)
        for other in curves[1:]:
            out.comment(f"or {other.path}")
        _per_energy(out, used)
    sensor_figures(out, camera)
    out.comment(
        "", "State the uncertainty of photodiode and wavelengths in [uncertainty] (see Measurement files in the docs)."
    )
    out.head(HEAD)
    return out


def channels_of_sweep(spectra: Spectra) -> list[str]:
    """Return the channels in the heading of a sweep with a photodiode, or an empty list for other tables."""
    names = spectra.table.names or ()
    channels = [match[1] for name in names if (match := LIGHT.fullmatch(name))]
    diode = any("diode" in DIODE.get(name.casefold(), name).casefold() for name in names)
    return channels if diode and len(names) == 2 * len(channels) + 2 else []


def _finished(tables: Sequence[Spectra]) -> list[Spectra]:
    """Return the tables that may contain responsivities.

    The spectra of monochromator steps and of patches are excluded. A table with a single column may be a lamp or a
    photodiode. It is therefore only returned if it is the only table.
    """
    broad = [table for table in tables if not table.has_patches and not _has_lines(table)]
    broad = [table for table in broad if len(table.table.values) <= MAX_CHANNELS and table.table.values.max() > 0]
    return [table for table in broad if len(table.table.values) > 1] or (broad if len(tables) == 1 else [])


def _has_lines(spectra: Spectra) -> bool:
    """Return whether the columns are spectra of a monochromator, one column per wavelength setting.

    If the table has a heading, every column name must contain a wavelength. Otherwise, most spectra must be narrow-band.
    """
    names = spectra.table.names
    return spectra.narrow if names is None else all(read_name(f"{name}.csv").nm is not None for name in names)


def _nothing(tables: Sequence[Spectra]) -> str:
    table = tables[0]
    first, last = table.table.wavelength[[0, -1]]
    more = f" and {len(tables) - 1} more" if len(tables) > 1 else ""
    return (
        f"{table.path} ({counted(len(table.table.values), 'column')}, {first:g}…{last:g} nm){more}: neither a sweep nor "
        "responsivities, and there is no raw frame; add a table with one column per channel, or the captures"
    )


def _body(out: DraftText, names: list[str] | None, columns: int) -> None:
    """Add [sensor], [cfa] and [optics] with values that the user must fill in. The table may contain the channel names."""
    out.table("[sensor]")
    for key, example, what in SENSOR:
        out.todo(key, example, what, "[sensor]")
    out.table("[cfa]")
    if names:
        out.key("channels", names, "from the heading of the table")
    elif columns in USUAL:
        out.assume("channels", USUAL[columns], "the usual order of columns, because the table has no heading")
    else:
        out.todo("channels", ["r", "g", "b"], "channel names, in the order of the columns in the table", "[cfa]")
    out.todo("pattern", ["r g", "g b"], "channel names, row by row, which repeat over the sensor", "[cfa]")
    unknown_optics(out)


def _photodiode(out: DraftText, sweep: Spectra, tables: Sequence[Spectra]) -> None:
    """Add the table of the photodiode, which has one column and covers the wavelengths of the sweep.

    If there is no such table, a TODO is added. If there are several, the first table is used and marked as an assumption.
    """
    grid = sweep.table.wavelength
    single = [table for table in tables if table is not sweep and len(table.table.values) == 1]
    single = [table for table in single if table.table.wavelength[0] <= grid[0] and grid[-1] <= table.table.wavelength[-1]]
    if not single:
        what = "response of the photodiode at all wavelengths of the sweep, for example in A/W"
        out.todo("photodiode", "diode.csv", what, "[sweep]")
    elif len(single) == 1:
        out.key("photodiode", single[0].path)
    else:
        others = ", ".join(table.path for table in single[1:])
        out.assume("photodiode", single[0].path, f"the first of several tables with one column; the others are {others}")


def _per_energy(out: DraftText, curves: Spectra) -> None:
    """Add whether the curves are per energy or per photon. A unit in the heading of the table decides."""
    possible = [each for each in (True, False) if _has_unit(curves, each)]
    if len(possible) == 1:
        out.key("per_energy", possible[0], "from the unit in the heading")
    elif "%" in curves.table.units:
        out.assume("per_energy", False, "percentages are usually quantum efficiencies; write true for curves per energy")
    else:
        out.assume("per_energy", True, "usual for relative curves; write false for curves per photon")


def _has_unit(curves: Spectra, per_energy: bool) -> bool:
    try:
        curves.table.responses(per_energy, "per_energy")
    except InputFileError:
        return False
    return True


def sensor_figures(out: DraftText, camera: CameraModel | None) -> None:
    """Add [datasheet], because tables of curves do not contain the noise and the levels of the sensor.

    The values are those of the camera. If the camera is unknown, the section is a TODO.
    """
    if camera is None:
        out.todo_table("[datasheet]", "levels and noise of the sensor, from its data sheet", *SHEET)
        return
    out.table(
        "[datasheet]",
        black_level_dn=camera.black_level,
        white_level_dn=camera.white_level,
        gain_dn_per_e=camera.gain,
        **noise_entries(camera.noise),
    )
