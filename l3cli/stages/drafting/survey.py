"""Content of a folder of captures: frames of one sensor by their values, tables of spectra, and what is left out."""

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.calibration.draft.compose import Survey
from l3cli.calibration.draft.matching import Spectra
from l3cli.calibration.draft.names import natural, read_name, with_bare_wavelengths
from l3cli.calibration.draft.sorting import Frame, scale_of, sort_frames, with_plain_kinds
from l3cli.calibration.draft.summary import altered, drawn, period_of, summarise
from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.io.captures import CaptureFolder, RawFile, read_capture, read_spectra
from l3cli.io.photos import array_of
from l3cli.stages.console import Console

SAMPLED = 6  # frames that an array's period is taken from
MOST_NOTED = 12  # frames of which each gets a line of its own


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
    """Facts that a file states about its frame."""

    path: str
    shape: tuple[int, int]
    pattern: NDArray[np.int64] | None
    black: float | None
    white: float | None
    seconds: float | None
    mean: float

    @property
    def sensor(self) -> tuple[object, ...]:
        return self.shape, None if self.pattern is None else self.pattern.tobytes()


def survey(listing: CaptureFolder, output: Path, camera: CameraModel | None, console: Console) -> Survey:
    """Read every file of a folder. InputFileError if it holds no raw frame, RecipeError if they are not of `camera`."""
    notes = list(listing.notes)
    tables = spectra_of(listing, output, notes)
    facts, frames = _facts(listing, notes, console)
    if not facts:
        reason = f": {notes[0].removesuffix('; left out')}" if notes else ""
        raise InputFileError(f"{listing.folder} holds no raw frame{reason}; give the folder of a camera's captures")
    kept = _frames_of_one_sensor(facts, notes)
    shape, pattern = kept[0].shape, kept[0].pattern
    if camera is not None and shape != (camera.rows, camera.cols):
        raise RecipeError(
            f"{camera.name} has {camera.rows}×{camera.cols} pixels, the frames {shape[0]}×{shape[1]}; give their camera"
        )
    period = _period(kept, camera, listing)
    usable = _with_wavelengths(_summarised(kept, period, listing, notes, frames, console), notes)
    if not usable:
        raise InputFileError(f"{listing.folder} holds no raw frame that can be used; {notes[-1]}")
    black = next((fact.black for fact in kept if fact.black is not None), None)
    white = next((fact.white for fact in kept if fact.white is not None), None)
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


def _facts(listing: CaptureFolder, notes: list[str], console: Console) -> tuple[list[_Fact], dict[str, RawFile]]:
    """Return the facts that every frame's file states, and the frames that fit into memory meanwhile."""
    facts, kept, room = [], dict[str, RawFile](), 64 << 20
    refused: list[str] = []
    for path in console.progress(listing.frames, len(listing.frames), "files"):
        try:
            raw = read_capture(listing.folder / path)
        except L3Error as error:
            refused.append(str(error).replace(f"{listing.folder / path}", path).partition(";")[0] + "; left out")
            continue
        rows, cols = raw.values.shape
        mean = float(raw.values.mean())
        facts.append(_Fact(path, (rows, cols), raw.pattern, raw.black_level, raw.white_level, raw.seconds, mean))
        if raw.values.nbytes < room:
            room -= raw.values.nbytes
            kept[path] = raw
    notes += _few(refused)
    return facts, kept


def _few(lines: Sequence[str]) -> list[str]:
    return [
        *lines[:MOST_NOTED],
        *([f"{len(lines) - MOST_NOTED} more such files left out"] if len(lines) > MOST_NOTED else []),
    ]


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
    known = facts[0].pattern if camera is None else camera.cfa
    if known is not None:
        return known.shape[0], known.shape[1]
    bright = sorted(facts, key=lambda fact: -fact.mean)
    sample = bright[:: max(1, len(bright) // SAMPLED)][:SAMPLED]
    frames = [read_capture(listing.folder / fact.path).values for fact in sample]
    return period_of([frame for frame in frames if not drawn(frame)] or frames)


def _summarised(
    facts: Sequence[_Fact],
    period: tuple[int, int],
    listing: CaptureFolder,
    notes: list[str],
    kept: dict[str, RawFile],
    console: Console,
) -> list[Frame]:
    """Return every frame by what it shows; those that are no raw values are left out or noted."""
    usable, refused, changed = [], [], Counter[str]()
    for fact in console.progress(facts, len(facts), "frames"):
        raw = kept.get(fact.path) or read_capture(listing.folder / fact.path)
        if drawn(raw.values):
            refused.append(f"{fact.path}: has no noise, as masks and drawings have none; left out")
            continue
        if change := altered(raw.values):
            changed[change] += 1
        name = read_name(fact.path)
        seconds = fact.seconds if fact.seconds is not None else name.seconds
        if fact.seconds is not None and name.seconds is not None and abs(fact.seconds / name.seconds - 1) > 0.1:
            refused.append(
                f"{fact.path}: its name says {name.seconds:g} s, its file {fact.seconds:g} s; the file's is taken"
            )
        usable.append(Frame(name, summarise(raw.values, period), seconds, fact.seconds is None))
    notes += _few(refused)
    notes += [
        f"{count} frame{'s' * (count > 1)}: {what}; check that they are raw values" for what, count in changed.most_common(2)
    ]
    return usable
