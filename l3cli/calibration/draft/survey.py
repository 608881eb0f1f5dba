"""Survey of a folder of captures: what every frame's file states, which frames are of one sensor, what each shows."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import CfaRecipe
from l3cli.calibration.draft.compose import Survey
from l3cli.calibration.draft.matching import Spectra
from l3cli.calibration.draft.names import altered, drawn, period_of, read_name, summarise, with_bare_wavelengths
from l3cli.calibration.draft.sorting import Frame, scale_of, sort_frames, with_plain_kinds
from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.frames.measurement import CaptureFolder, RawFile

SAMPLED = 6  # frames that an array's period is taken from
MOST_NOTED = 12  # frames of which each gets a line of its own


@dataclass(frozen=True)
class Reading:
    """Access to the frames of a folder."""

    read: Callable[[str], RawFile]  # a frame, by its path
    array_of: Callable[[NDArray[np.integer]], CfaRecipe]  # the array of the codes that a file states
    progress: Callable[[Sequence[Any], int, str], Iterable[Any]]  # shows how far a loop has come


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


def survey(
    listing: CaptureFolder, tables: list[Spectra], notes: list[str], camera: CameraModel | None, reading: Reading
) -> Survey:
    """Return the content of a folder whose tables are known; `notes` gets what is left out. InputFileError if it holds no
    raw frame, RecipeError if they are not of `camera`."""
    facts = _facts(listing, notes, reading)
    if not facts:
        reason = f": {notes[0].removesuffix('; left out')}" if notes else ""
        raise InputFileError(f"{listing.folder} holds no raw frame{reason}; give the folder of a camera's captures")
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
    """Return the frames with wavelengths that their names state without a unit."""
    names = with_bare_wavelengths([frame.name for frame in usable])
    new = [name for name, frame in zip(names, usable, strict=True) if name != frame.name]
    if new:
        notes.append(f"numbers in the names of {len(new)} monochromatic frames taken for nm: {new[0].nm:g} in {new[0].path}")
    return [replace(frame, name=name) for frame, name in zip(usable, names, strict=True)]


def _facts(listing: CaptureFolder, notes: list[str], reading: Reading) -> list[_Fact]:
    """Return what every frame's file states, with the frames that fit into memory meanwhile."""
    facts, room = [], 64 << 20
    refused: list[str] = []
    for path in reading.progress(listing.frames, len(listing.frames), "files"):
        try:
            raw = reading.read(path)
        except L3Error as error:
            refused.append(str(error).replace(f"{listing.folder / path}", path).partition(";")[0] + "; left out")
            continue
        rows, cols = raw.values.shape
        fits = raw.values.nbytes < room
        room -= raw.values.nbytes if fits else 0
        mean = float(raw.values.mean())
        facts.append(_Fact(path, (rows, cols), mean, raw if fits else replace(raw, values=raw.values[:0].copy())))
    notes += first_lines(refused, MOST_NOTED, "{} more such files left out")
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


def _period(facts: Sequence[_Fact], camera: CameraModel | None, reading: Reading) -> tuple[int, int]:
    """Return the rows and columns of the array: the camera's, that of the files, or as the brightest frames show it."""
    known = facts[0].raw.pattern if camera is None else camera.cfa
    if known is not None:
        return known.shape[0], known.shape[1]
    bright = sorted(facts, key=lambda fact: -fact.mean)
    sample = bright[:: max(1, len(bright) // SAMPLED)][:SAMPLED]
    frames = [reading.read(fact.path).values for fact in sample]
    return period_of([frame for frame in frames if not drawn(frame)] or frames)


def _summarised(facts: Sequence[_Fact], period: tuple[int, int], notes: list[str], reading: Reading) -> list[Frame]:
    """Return every frame by what it shows; those that are no raw values are left out or noted."""
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
        usable.append(Frame(name, summarise(raw.values, period), name.seconds if by_name else seconds, by_name))
    notes += first_lines(refused, MOST_NOTED, "{} more such files left out")
    notes += [
        f"{count} frame{'s' * (count > 1)}: {what}; check that they are raw values" for what, count in changed.most_common(2)
    ]
    return usable


def first_lines(lines: Sequence[str], most: int, more: str) -> list[str]:
    """Return the first lines, and one that says how many more there are."""
    return [*lines[:most], *([more.format(len(lines) - most)] if len(lines) > most else [])]
