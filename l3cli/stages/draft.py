"""The drafting stage: a folder of captures, or of tables alone → a measurement file with what is missing marked."""

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import camera_files, load_camera
from l3cli.calibration.draft.compose import Survey, compose
from l3cli.calibration.draft.matching import Spectra
from l3cli.calibration.draft.names import altered, drawn, natural, period_of, read_name, summarise, with_bare_wavelengths
from l3cli.calibration.draft.sorting import Frame, scale_of, sort_frames, with_plain_kinds
from l3cli.calibration.draft.tables import compose_tables
from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.io.frames import CaptureFolder, RawFile, list_captures, read_capture, read_spectra
from l3cli.io.measurement_recipe import MeasurementRecipe
from l3cli.io.measurements import measurements_of
from l3cli.io.photos import array_of
from l3cli.options.pipeline import DraftOptions
from l3cli.recipes.toml import parse_recipe
from l3cli.system.console import Console
from l3cli.system.files import write_whole
from l3cli.system.ledger import is_noting
from l3cli.system.output_guard import OutputGuard
from l3cli.system.plan import Made, before_work, is_dry
from l3cli.system.text import counted

MOST_LINES = 8  # assumptions and missing things of which each gets a line on the console
SAMPLED = 6  # frames that an array's period is taken from
MOST_NOTED = 12  # frames of which each gets a line of its own


def draft(folder: Path, output: Path, options: DraftOptions) -> str:
    """Write the draft of a measurement file of the captures in a folder, or of its tables if it has no frames; its text.

    Sensor, array and optics are those of the options' camera, since frames do not state them. InputFileError if
    the folder holds neither raw frames nor responsivities, RecipeError if the camera is another one, L3Error if the output
    cannot be written.
    """
    if output.suffix != ".toml":
        raise RecipeError(f"{output}: a measurement file ends in .toml; name it MEASUREMENTS.toml")
    camera, console = options.camera, options.console
    with OutputGuard(console) as claims:
        claims.protect(*(camera_files(camera) if camera else ()))
        claims.claim_file(output, options.force, recipe=True)
        known = load_camera(camera) if camera else None
        listing = list_captures(folder)
        if is_dry() or is_noting():
            contents = counted(len(listing.frames), "frame") if listing.frames else counted(len(listing.tables), "table")
            inputs = {
                "frames": [folder / name for name in listing.frames],
                "tables": [folder / name for name in listing.tables],
            }
            before_work(inputs, Made(output, f"draft of a measurement file of {contents}"))
        notes, name = list[str](), folder.absolute().name
        if not listing.frames and (tables := spectra_of(listing, output, notes)):
            text, contents = compose_tables(tables, known, name, notes), f"{counted(len(tables), 'table')}, no frames"
        else:
            seen = survey(listing, output, known, console)

            def read(path: str) -> NDArray[np.float64]:
                return read_capture(folder / path).values.astype(np.float64)

            text, notes = compose(seen, known, name, named_from(folder, output), read), seen.notes
            contents = f"{len(seen.groups)} captures, {sum(len(group.frames) for group in seen.groups)} frames"
        write_whole(output, str(text))
        assumed = _first([f"assumed: {line}" for line in text.assumed], MOST_LINES, "… and {} more, marked ASSUMED")
        missing = _first([f"missing: {line}" for line in text.missing], MOST_LINES, "… and {} more, marked TODO")
        for line in (*notes, *assumed, *missing):
            console.info(line)
        written = f"{output}: {contents}"
        problem = "" if text.missing else _problem(str(text), output)
        if problem:
            console.warn(f"l3 calibrate will not take it yet: {problem}")
        then = "fill in what is marked TODO, then" if text.missing else "next"
        console.info(written if problem else f"{written}; {then}: l3 calibrate {output} -o camera.h5")
        return str(text)


def _first(lines: Sequence[str], most: int, more: str) -> list[str]:
    """Return the first lines, and one that says how many more there are."""
    return [*lines[:most], *([more.format(len(lines) - most)] if len(lines) > most else [])]


def _problem(text: str, output: Path) -> str:
    """Return why calibration would refuse a draft in which nothing seems to be missing; "" if it would not, before any
    frame."""
    try:
        measurements_of(parse_recipe(text, MeasurementRecipe, str(output)), output)
    except L3Error as error:
        return str(error)
    return ""


# ---------------------------------------------------------------------------------------------------- survey


def named_from(path: Path, output: Path) -> str:
    """Return the name of a path in a measurement file: relative to its folder, whole where that leads out of it."""
    relative = os.path.relpath(path, output.parent)
    return str(path.absolute()) if relative.startswith("..") else Path(relative).as_posix()


def spectra_of(listing: CaptureFolder, output: Path, notes: list[str]) -> list[Spectra]:
    """Return the tables of spectra of a folder in the natural order of their names; `notes` gets what is left out."""
    tables = read_spectra(listing, notes)
    spectra = [Spectra(named_from(listing.folder / name, output), read_name(name), table) for name, table in tables]
    return sorted(spectra, key=lambda each: natural(each.name.path))


@dataclass(frozen=True)
class _Fact:
    """A frame, and what its file states about it."""

    path: str
    shape: tuple[int, int]
    mean: float
    raw: RawFile  # whose values are empty where memory is short

    @property
    def sensor(self) -> tuple[object, ...]:
        return self.shape, None if self.raw.pattern is None else self.raw.pattern.tobytes()


def survey(listing: CaptureFolder, output: Path, camera: CameraModel | None, console: Console) -> Survey:
    """Read every file of a folder. InputFileError if it holds no raw frame, RecipeError if they are not of `camera`."""
    notes = list(listing.notes)
    tables = spectra_of(listing, output, notes)
    facts = _facts(listing, notes, console)
    if not facts:
        reason = f": {notes[0].removesuffix('; left out')}" if notes else ""
        raise InputFileError(f"{listing.folder} holds no raw frame{reason}; give the folder of a camera's captures")
    used = _frames_of_one_sensor(facts, notes)
    shape, pattern = used[0].shape, used[0].raw.pattern
    if camera is not None and shape != (camera.rows, camera.cols):
        raise RecipeError(
            f"{camera.name} has {camera.rows}×{camera.cols} pixels, the frames {shape[0]}×{shape[1]}; give their camera"
        )
    period = _period(used, camera, listing)
    usable = _with_wavelengths(_summarised(used, period, listing, notes, console), notes)
    if not usable:
        raise InputFileError(f"{listing.folder} holds no raw frame that can be used; {notes[-1]}")
    black = next((fact.raw.black_level for fact in used if fact.raw.black_level is not None), None)
    white = next((fact.raw.white_level for fact in used if fact.raw.white_level is not None), None)
    scale = scale_of(usable, black)
    groups = with_plain_kinds(sort_frames(usable, scale, notes), scale, notes)
    array = None if pattern is None else array_of(pattern)
    return Survey(shape, period, array, black, white, scale, groups, tables, notes)


def _with_wavelengths(usable: list[Frame], notes: list[str]) -> list[Frame]:
    """Return the frames with wavelengths that their names state without a unit."""
    names = with_bare_wavelengths([frame.name for frame in usable])
    new = [name for name, frame in zip(names, usable, strict=True) if name != frame.name]
    if new:
        notes.append(f"numbers in the names of {len(new)} monochromatic frames taken for nm: {new[0].nm:g} in {new[0].path}")
    return [replace(frame, name=name) for frame, name in zip(usable, names, strict=True)]


def _facts(listing: CaptureFolder, notes: list[str], console: Console) -> list[_Fact]:
    """Return what every frame's file states, with the frames that fit into memory meanwhile."""
    facts, room = [], 64 << 20
    refused: list[str] = []
    for path in console.progress(listing.frames, len(listing.frames), "files"):
        try:
            raw = read_capture(listing.folder / path)
        except L3Error as error:
            refused.append(str(error).replace(f"{listing.folder / path}", path).partition(";")[0] + "; left out")
            continue
        rows, cols = raw.values.shape
        fits = raw.values.nbytes < room
        room -= raw.values.nbytes if fits else 0
        mean = float(raw.values.mean())
        facts.append(_Fact(path, (rows, cols), mean, raw if fits else replace(raw, values=raw.values[:0].copy())))
    notes += _first(refused, MOST_NOTED, "{} more such files left out")
    return facts


def _frames_of_one_sensor(facts: Sequence[_Fact], notes: list[str]) -> list[_Fact]:
    """Return the frames of the size and array that most frames have."""
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


def _period(facts: Sequence[_Fact], camera: CameraModel | None, listing: CaptureFolder) -> tuple[int, int]:
    """Return the rows and columns of the array: the camera's, that of the files, or as the brightest frames show it."""
    known = facts[0].raw.pattern if camera is None else camera.cfa
    if known is not None:
        return known.shape[0], known.shape[1]
    bright = sorted(facts, key=lambda fact: -fact.mean)
    sample = bright[:: max(1, len(bright) // SAMPLED)][:SAMPLED]
    frames = [read_capture(listing.folder / fact.path).values for fact in sample]
    return period_of([frame for frame in frames if not drawn(frame)] or frames)


def _summarised(
    facts: Sequence[_Fact], period: tuple[int, int], listing: CaptureFolder, notes: list[str], console: Console
) -> list[Frame]:
    """Return every frame by what it shows; those that are no raw values are left out or noted."""
    usable, refused, changed = [], [], Counter[str]()
    for fact in console.progress(facts, len(facts), "frames"):
        raw = fact.raw if fact.raw.values.size else read_capture(listing.folder / fact.path)
        if drawn(raw.values):
            refused.append(f"{fact.path}: has no noise, as masks and drawings have none; left out")
            continue
        if change := altered(raw.values):
            changed[change] += 1
        name, seconds = read_name(fact.path), raw.seconds
        if seconds is not None and name.seconds is not None and abs(seconds / name.seconds - 1) > 0.1:
            refused.append(f"{fact.path}: its name says {name.seconds:g} s, its file {seconds:g} s; the file's is taken")
        by_name = seconds is None
        usable.append(Frame(name, summarise(raw.values, period), name.seconds if by_name else seconds, by_name))
    notes += _first(refused, MOST_NOTED, "{} more such files left out")
    notes += [
        f"{count} frame{'s' * (count > 1)}: {what}; check that they are raw values" for what, count in changed.most_common(2)
    ]
    return usable
