"""Warnings of inputs that a table was not made for, and what to do about them."""

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from l3cli.frames.frame import RawFrame
from l3cli.rendering.exposure import CoverageMeter
from l3cli.rendering.opencl.devices import cache_warning
from l3cli.rendering.raw_checks import best_phases, beyond_converter, mistaken
from l3cli.system.console import Console
from l3cli.system.files import sha256

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from l3cli.artifacts.camera import CameraModel
    from l3cli.artifacts.table import TransformTable
    from l3cli.rendering.white.scene_white import SceneWhite
    from l3cli.stages.rendering.rendition import Exposed

NOTABLE = {"darker": 0.05, "brighter": 0.05, "untrained": 0.2, "saturated": 0.1}  # shares of a frame that are worth a word
SITES_DIFFER = 0.1  # of the mean of a channel, between its sites, from which on the array is not where it is taken to be …
SITES_AGREE = 0.4  # … if another phase leaves no more than this of it
LONG, MANY_TIMES = 60.0, 100.0  # s; times the training's: exposure times that are probably in another unit
NEAR_WHITE = 0.02  # distance of chromaticities u′v′ from which on two whites are different lights


@dataclass
class FrameWarnings:
    """Looks at some frames of a run and, in the end, says each thing once: of one frame, or of the worst of several."""

    table: "TransformTable"
    _seen: int = 0
    _untimed: list[str] = field(default_factory=list)  # frames whose exposure time and dark level are unknown
    _others: dict[str, tuple[str, int]] = field(
        default_factory=dict
    )  # what is said of the camera or the array: frame, number
    _notes: dict[str, str] = field(default_factory=dict)  # first frame of each
    _worst: dict[str, tuple[float, str, int]] = field(default_factory=dict)  # share, frame, number of frames

    def __post_init__(self) -> None:
        self._meter = CoverageMeter(self.table)

    def measure(self, frame: "RawFrame") -> None:
        """Measure a frame."""
        self._seen += 1
        if self.table.dark_signal(1.0) and frame.exposure is None and not frame.dark_measured:
            self._untimed.append(frame.name)
        for text in (other_camera(frame, self.table), other_phase(frame, self.table), *mistaken(frame, self.table)):
            self._note(text, frame.name)
        for note in frame.notes:
            self._notes.setdefault(note, frame.name)
        coverage = self._meter.coverage(frame)
        for what, limit in NOTABLE.items():
            share = getattr(coverage, what)
            if share >= limit:
                worst, name, count = self._worst.get(what, (0.0, "", 0))
                self._worst[what] = (share, frame.name, count + 1) if share > worst else (worst, name, count + 1)

    def watched(self, frames: "Iterator[Exposed]", stills: bool) -> "Iterator[Exposed]":
        """Pass frames on, after a check of every still, or the first frame of a sequence, unless others are to read it.
        Later frames are only checked for values that the converter cannot give, and only if the first has none."""
        first_text = ""
        for each in frames:
            if isinstance(each.frame, RawFrame) and (stills or not self._seen):
                self.measure(each.frame)
                first_text = beyond_converter(each.frame, self.table)
            elif isinstance(each.frame, RawFrame) and not first_text:
                self._note(beyond_converter(each.frame, self.table), each.frame.name)
            yield each

    def _note(self, text: str, name: str) -> None:
        """Count what is said of a frame; "" says nothing."""
        if text:
            first, count = self._others.get(text, (name, 0))
            self._others[text] = first, count + 1

    def report(self, console: Console) -> None:
        """One line for each warning."""
        darkest, brightest = self._meter.learned_range()
        texts = {
            "darker": f"are darker than anything the table was trained on ({darkest:.2g} of full scale); name a "
            "lower learning.darkest or simulate shorter exposures, and train again",
            "brighter": f"are brighter than anything the table was trained on ({brightest:.2g} of full scale); raise "
            "learning.brightest or simulate longer exposures, and train again",
            "untrained": "fall into classes that are filled from their neighbours; train on more scenes or patches",
            "saturated": "are clipped or touch clipped ones, where colour is a guess; expose shorter, or mend ‹white_level›",
        }
        if self._untimed:
            exposure, dark = self.table.exposure, self.table.dark_signal(None)
            console.info(
                f"{self._untimed[0]}: exposure time unknown; dark current of the training's {exposure:.3g} s is taken off "
                f"({dark:.2g} DN); give ‹exposure_time› or ‹dark›"
            )
        for text, (name, count) in self._others.items():
            console.warn(f"{name}{f' and {count - 1} more' if count > 1 else ''}: {text}")
        for note, name in self._notes.items():
            console.warn(f"{name}: {note}")
        for what, (share, name, count) in self._worst.items():
            where = name if self._seen == 1 else f"{count} of {self._seen} frames, most in {name}"
            console.warn(f"{where}: {share:.0%} of the pixels {texts[what]}")


def other_camera(frame: "RawFrame", table: "TransformTable") -> str:
    """Return a warning if a file names another camera than the table's; "" if it names none, or that one."""
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


def other_phase(frame: "RawFrame", table: "TransformTable") -> str:
    """Return a warning, with the phase that fits, if the sites of one channel differ as they do where a file misstates
    its array; else ""."""
    now, least, phases = best_phases(frame, table)
    if now < SITES_DIFFER or not phases or least > SITES_AGREE * now:
        return ""
    fitting = " or ".join(f"{row},{col}" for row, col in phases)
    return (
        f"sites of one channel differ by {now:.0%} on average, its colour filter array begins elsewhere than it says; "
        f"‹phase› {fitting} leaves {least:.1%}"
    )


def warn_of_white(asked: str, white: "SceneWhite", table: "TransformTable", console: Console) -> None:
    """Say so if colours are asked for under a light that the table was probably not trained under, and that is not named."""
    if white.modelled and "," not in asked:
        return
    if np.linalg.norm(_uv(white.light.xyz) - _uv(table.white_point)) > NEAR_WHITE:
        x, y = table.white_point[:2] / table.white_point.sum()
        how = "colours are adapted from it alone; name the light, or train with it among the illuminants of SCENES.toml"
        if white.modelled:
            how = "taken for that of a black body or daylight; name a fluorescent or LED lamp, or give a grey's ROW,COL"
        console.warn(f"‹white› {asked} is far from the mean light of the training, x,y = {x:.4f},{y:.4f}: {how}")


def warn_of_odd_white(what: str, white: "SceneWhite", console: Console) -> None:
    """Say so if no light that is likely gives a white."""
    if not white.plausible:
        console.warn(
            f"{what} is what no daylight, lamp or black body gives the table's camera ({white}); greys are made neutral by "
            "it, and no colour is corrected further; is it the table of this camera? give ‹white› otherwise"
        )


def warn_of_stated_white(name: str, white: "SceneWhite", stated: "SceneWhite", console: Console) -> None:
    """Say so if a file states quite another white than what is grey in its frame has."""
    if np.linalg.norm(_uv(white.light.xyz) - _uv(stated.light.xyz)) > NEAR_WHITE:
        console.warn(
            f"{name}: its file states another white ({stated.light.kelvin:.0f} K) than its chart shows "
            f"({white.light.kelvin:.0f} K); the chart's is taken, and ‹white› camera would leave a cast"
        )


def warn_of_exposure_time(seconds: float | None, table: "TransformTable", console: Console) -> None:
    """Say so if an exposure time that is given is probably not in seconds."""
    if seconds is None:
        return
    times = seconds / table.exposure if table.exposure else 0.0
    if seconds > LONG or times >= MANY_TIMES:
        beside = f", {times:.0f} times that of the training ({table.exposure:.3g} s)" if times >= MANY_TIMES else ""
        console.warn(
            f"‹exposure_time› {seconds:g} is {seconds:g} seconds{beside}: dark current of "
            f"{table.dark_signal(seconds):.3g} DN is taken off; give seconds, not milliseconds"
        )


def warn_if_trained_on(table: "TransformTable", path: "Path", frames: "Path", console: Console) -> None:
    """Say so if a table is judged on frames that its history names as its training."""
    inputs = {digest for stage in table.history for digests in stage.inputs.values() for digest in digests}
    if sha256(frames) in inputs:
        text = "figures flatter it; simulate other scenes, or the same ones with another ‹seed›"
        console.warn(f"{path} was trained on {frames}: {text}")


def warn_if_unlike(table: tuple[object, "TransformTable"], frames: tuple[object, "CameraModel"], console: Console) -> str:
    """Say so if a table is judged on frames of another camera than it was trained for; both with the name of their file.
    What is said, or ""."""
    from l3cli.evaluation.likeness import unlike

    (name, transforms), (other, camera) = table, frames
    if not (differences := unlike(transforms, camera)):
        return ""
    text = (
        f"{name} was trained for another camera ({transforms.camera_name}) than took the frames of {other} ({camera.name}): "
        f"they differ in {differences}; judge it on frames of its own camera"
    )
    console.warn(text)
    return text


def warn_of_kernels(console: Console) -> None:
    """Say so if the next run has to compile the same kernels again."""
    if reason := cache_warning():
        console.warn(reason)


def _uv(white: np.ndarray) -> np.ndarray:
    """CIE 1976 u′v′ of XYZ."""
    x, y, z = white
    return np.array([4 * x, 9 * y]) / (x + 15 * y + 3 * z)
