"""Survey a folder of frames, or a folder that contains only tables, for the draft of a measurement file.

In a folder of frames, l3 reads the metadata of each file, selects the frames from one sensor, and determines what each frame
shows.
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

SAMPLED = 6  # number of frames from which the period of the filter array is estimated
SKIPPED = "; skipped"  # end of each note about an unused file
MOST_NOTED = 12  # largest number of notes about rejected files; a single note covers the others
LIGHT = re.compile(r"light[ _]+(?!diode)(.+)", re.IGNORECASE)  # heading of a channel's column in a sweep table
USUAL = {1: ["y"], 3: ["r", "g", "b"]}  # assumed names of the channels, for each number of columns
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
    progress: Callable[[Sequence[Any], int, str], Iterable[Any]]  # iterates over a sequence and displays the progress


@dataclass(frozen=True)
class _Fact:
    """A frame and the metadata in its file."""

    path: str
    shape: tuple[int, int]
    mean: float  # mean raw value in DN
    raw: RawFile  # without values if the values of all frames would need too much memory

    @property
    def sensor(self) -> tuple[object, ...]:
        return self.shape, None if self.raw.pattern is None else self.raw.pattern.tobytes()


def survey(
    listing: CaptureFolder, tables: list[Spectra], notes: list[str], camera: CameraModel | None, reading: Reading
) -> Survey:
    """Determine what the frames in a folder show, and collect their metadata.

    Parameters
    ----------
    listing : CaptureFolder
        The folder and its files.
    tables : list of Spectra
        Tables of spectra in the folder.
    notes : list of str
        Remarks for the user. Remarks about unused files and assumptions are appended.
    camera : CameraModel or None
        The camera, if it is known.
    reading : Reading
        Functions that read frames.

    Raises
    ------
    InputFileError
        If the folder contains no usable raw frame.
    RecipeError
        If the size of the frames differs from the size of the sensor of `camera`.
    """
    facts = _facts(listing, notes, reading)
    if not facts:
        reason = f": {notes[0].removesuffix(SKIPPED)}" if notes else ""
        cure = "" if "; " in reason else "; specify a folder with the captures of a camera"  # the reason may contain a cure
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
    """Set the wavelengths of frames with unitless wavelengths in their names, and add a note about these frames."""
    names = with_bare_wavelengths([frame.name for frame in usable])
    new = [name for name, frame in zip(names, usable, strict=True) if name != frame.name]
    if new:
        notes.append(
            f"assumed that numbers in the names of {len(new)} monochromatic frames are wavelengths in nm, for example "
            f"{new[0].nm:g} in {new[0].path}"
        )
    return [replace(frame, name=name) for frame, name in zip(usable, names, strict=True)]


def _facts(listing: CaptureFolder, notes: list[str], reading: Reading) -> list[_Fact]:
    """Read the metadata of all files, and keep the pixel values of as many frames as fit into 64 MiB.

    Unreadable files are skipped with a note.
    """
    facts, room = [], 64 << 20
    refused: list[str] = []
    for path in reading.progress(listing.frames, len(listing.frames), "files"):
        try:
            raw = reading.read(path)
        except L3Error as error:
            refused.append(str(error).replace(f"{listing.folder / path}", path) + SKIPPED)
            continue
        rows, cols = raw.values.shape
        fits = raw.values.nbytes < room
        room -= raw.values.nbytes if fits else 0
        mean = float(raw.values.mean())
        facts.append(_Fact(path, (rows, cols), mean, raw if fits else replace(raw, values=raw.values[:0].copy())))
    notes += first_lines(refused, MOST_NOTED, "skipped {} more files")
    return facts


def _frames_of_one_sensor(facts: Sequence[_Fact], notes: list[str]) -> list[_Fact]:
    """Select the frames with the most common combination of size and filter array, and add notes about the others."""
    count = Counter(fact.sensor for fact in facts)
    usual = max(count, key=lambda sensor: (count[sensor], -[fact.sensor for fact in facts].index(sensor)))
    for sensor in count:
        if sensor != usual:
            others = [fact for fact in facts if fact.sensor == sensor]
            rows, cols = others[0].shape
            notes.append(
                f"skipped {len(others)} of {len(facts)} frames, because their size or colour filter array differs "
                f"({rows}×{cols}, for example {others[0].path}); make a separate draft for these frames"
            )
    return [fact for fact in facts if fact.sensor == usual]


def _period(facts: Sequence[_Fact], camera: CameraModel | None, reading: Reading) -> tuple[int, int]:
    """Return the CFA period (rows, columns).

    It comes from the first available of: (1) the camera; (2) the metadata of the files; (3) an estimate from a sample of the
    frames.
    """
    known = facts[0].raw.pattern if camera is None else camera.cfa
    if known is not None:
        return known.shape[0], known.shape[1]
    bright = sorted(facts, key=lambda fact: -fact.mean)
    sample = bright[:: max(1, len(bright) // SAMPLED)][:SAMPLED]
    frames = [reading.read(fact.path).values for fact in sample]
    return period_of([frame for frame in frames if not drawn(frame)] or frames)


def _summarised(facts: Sequence[_Fact], period: tuple[int, int], notes: list[str], reading: Reading) -> list[Frame]:
    """Summarise all frames except drawings and masks.

    Exposure times in the metadata take precedence over exposure times in file names. Notes are added about contradictory
    exposure times, drawings, and frames with apparently processed values.
    """
    usable, refused, changed = [], [], Counter[str]()
    for fact in reading.progress(facts, len(facts), "frames"):
        raw = fact.raw if fact.raw.values.size else reading.read(fact.path)
        if drawn(raw.values):
            refused.append(f"skipped {fact.path}, which seems to be a mask or a drawing, because it has no noise")
            continue
        if change := altered(raw.values):
            changed[change] += 1
        name, seconds = read_name(fact.path), raw.seconds
        if seconds is not None and name.seconds is not None and abs(seconds / name.seconds - 1) > 0.1:
            refused.append(
                f"{fact.path}: the exposure time is {name.seconds:g} s in the name but {seconds:g} s in the metadata; used "
                "the metadata"
            )
        by_name = seconds is None
        shown = summarise(raw.values, period)
        usable.append(Frame(name, shown, name.seconds if by_name else seconds, by_name, fact.raw.count))
    notes += first_lines(refused, MOST_NOTED, "similar notes about {} more files")
    notes += [f"{counted(count, 'frame')}: {change}; use unprocessed raw values" for change, count in changed.most_common(2)]
    return usable


def first_lines(lines: Sequence[str], most: int, more: str) -> list[str]:
    """Return the first `most` lines. If there are more, add the line `more`, in which {} is the number of omitted lines."""
    return [*lines[:most], *([more.format(len(lines) - most)] if len(lines) > most else [])]


def compose_tables(tables: Sequence[Spectra], camera: CameraModel | None, name: str, left_out: Sequence[str]) -> DraftText:
    """Draft a measurement file from tables alone.

    The tables contain a sweep with a photodiode as reference, or finished curves.

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
    """Return the channel names in a sweep with a photodiode, or an empty list if the table contains no such sweep."""
    names = spectra.table.names or ()
    channels = [match[1] for name in names if (match := LIGHT.fullmatch(name))]
    diode = any("diode" in DIODE.get(name.casefold(), name).casefold() for name in names)
    return channels if diode and len(names) == 2 * len(channels) + 2 else []


def _finished(tables: Sequence[Spectra]) -> list[Spectra]:
    """Select the tables that may contain responsivities.

    Tables with spectra of monochromator steps or of patches are excluded. A table with a single column may describe a lamp
    or a photodiode, so it is selected only if it is the only table.
    """
    broad = [table for table in tables if not table.has_patches and not _has_lines(table)]
    broad = [table for table in broad if len(table.table.values) <= MAX_CHANNELS and table.table.values.max() > 0]
    return [table for table in broad if len(table.table.values) > 1] or (broad if len(tables) == 1 else [])


def _has_lines(spectra: Spectra) -> bool:
    """Return whether the columns are monochromator spectra, one per wavelength setting.

    They are if all column names contain a wavelength or, in a table without a heading, if most spectra are narrow-band.
    """
    names = spectra.table.names
    return spectra.narrow if names is None else all(read_name(f"{name}.csv").nm is not None for name in names)


def _nothing(tables: Sequence[Spectra]) -> str:
    table = tables[0]
    first, last = table.table.wavelength[[0, -1]]
    more = f" and {len(tables) - 1} more" if len(tables) > 1 else ""
    return (
        f"the folder contains no raw frame, and {table.path} ({counted(len(table.table.values), 'column')}, "
        f"{first:g}…{last:g} nm){more} contains neither a sweep nor responsivities; add a table with one column per "
        "channel, or add the captures"
    )


def _body(out: DraftText, names: list[str] | None, columns: int) -> None:
    """Add the sections [sensor], [cfa] and [optics] with keys that the user must fill in.

    `names` are the channel names in the heading of the table, or None if the table has no heading. `columns` is the number
    of columns in the table.
    """
    out.table("[sensor]")
    for key, example, what in SENSOR:
        out.todo(key, example, what, "[sensor]")
    out.table("[cfa]")
    if names:
        out.key("channels", names, "from the heading of the table")
    elif columns in USUAL:
        out.assume("channels", USUAL[columns], "the usual order of the columns; the table has no heading")
    else:
        out.todo("channels", ["r", "g", "b"], "channel names, in the order of the columns in the table", "[cfa]")
    out.todo("pattern", ["r g", "g b"], "one period of the colour filter array, as channel names, row by row", "[cfa]")
    unknown_optics(out)


def _photodiode(out: DraftText, sweep: Spectra, tables: Sequence[Spectra]) -> None:
    """Add the key `photodiode` with the name of the table that contains the photodiode's response.

    It is a table with one column that covers the wavelengths of the sweep. If there are several, the first one is used and
    marked as assumed. If there is none, the key becomes a TODO.
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
        out.assume("photodiode", single[0].path, f"the first of several tables with one column; not used: {others}")


def _per_energy(out: DraftText, curves: Spectra) -> None:
    """Add the key `per_energy`, which specifies whether the curves are per energy or per photon.

    The unit in the heading determines the value. If the heading contains no unit, a value is assumed.
    """
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
    """Add the [datasheet] section with the camera's black level, white level and noise.

    The section is needed because tables of responsivities do not contain these values. If the camera is unknown, it becomes
    a TODO.
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
