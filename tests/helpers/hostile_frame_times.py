"""Hostile frame rates: videos whose frames follow after any time, and folders whose numbers have any gaps.

A video that can hold the times of its frames has those of what it was made of; where it cannot, and only there, a warning
says so, and --json too.
"""

import contextlib
import io
import json
import shutil
from dataclasses import dataclass
from fractions import Fraction
from itertools import accumulate, pairwise
from pathlib import Path

import av
import numpy as np

from l3cli.cli import run
from tests.helpers.hostile import Workshop
from tests.helpers.hostile_spoiling import Choices, one_of
from tests.helpers.sequences import write_raw_video

STEPS = (1, 2, 17, 33, 34, 40, 41, 400, 3_600_000)  # ms
GAPS = (1, 1, 1, 1, 2, 3, 7, 1000)  # of numbers
SUFFIXES = (".mp4", ".mov", ".mkv", ".y4m", "")
LINES = ("frames follow after", "do not count frames", "no frame is there")  # of warnings
RATE = 30  # frames/s, of a folder


@dataclass(frozen=True)
class Clip:
    """A clip of frames at times, in ms, or of numbers, and what it is rendered to."""

    steps: tuple[int, ...]
    is_folder: bool
    suffix: str

    def __str__(self) -> str:
        return f"{'gaps' if self.is_folder else 'ms'} {self.steps} to {self.suffix or 'pictures'}"


@dataclass(frozen=True)
class FrameTimes:
    """A clip of uneven times in place of one of a constant rate."""

    name: str = "frame times"
    often: int = 1

    def draw(self, choices: Choices) -> Clip:
        """A clip."""
        is_folder = choices.integer(0, 2) == 0
        usual = one_of(choices, STEPS)
        steps = [
            one_of(choices, GAPS) if is_folder else one_of(choices, (usual, *STEPS)) for _ in range(choices.integer(1, 6))
        ]
        return Clip(tuple(steps), is_folder, one_of(choices, SUFFIXES))

    def judge(self, shop: Workshop, clip: Clip) -> str | None:
        """What did not hold, or None."""
        out, times = shop.folder / "out", list(accumulate(clip.steps, initial=0))
        out.mkdir()
        try:
            return _verdict(shop.inputs, out, clip, times)
        finally:
            shutil.rmtree(out)


def _verdict(inputs: Path, out: Path, clip: Clip, times: list[int]) -> str | None:
    mosaics = np.load(inputs / "stack.npy")[np.zeros(len(times), int)]
    source, made = out / ("clip" if clip.is_folder else "clip.mkv"), out / f"made{clip.suffix}"
    if clip.is_folder:
        source.mkdir()
        for number, mosaic in zip(times, mosaics, strict=True):
            np.save(source / f"{number}.npy", mosaic)
    else:
        write_raw_video(source, mosaics=mosaics, times=times)
    words, errors = io.StringIO(), io.StringIO()
    call = ("render", inputs / "table.h5", source, "-o", made, "--backend", "reference", "--json")
    with contextlib.redirect_stdout(words), contextlib.redirect_stderr(errors):
        code = run([*map(str, call)])
    if code:
        return f"exit code {code}: {errors.getvalue()}"
    state, warned = json.loads(words.getvalue())["clips"][0]["frame_times"], any(line in errors.getvalue() for line in LINES)
    even = len(set(clip.steps)) == 1 or (not clip.is_folder and max(clip.steps) - min(clip.steps) <= 1)
    if even:
        return None if state in ("even", None) and not warned else f"{state} of even frames: {errors.getvalue()}"
    if clip.suffix in (".y4m", ""):
        lost = state == "lost" and warned
        return None if lost or (clip.is_folder and not clip.suffix) else f"{state}, though no times can be kept"
    if clip.is_folder and state == "lost":
        counted = 2 * clip.steps.count(min(clip.steps)) >= len(clip.steps)
        return None if warned and not (counted and all(step % min(clip.steps) == 0 for step in clip.steps)) else "lost gaps"
    tick = Fraction(1, RATE * min(clip.steps)) if clip.is_folder else Fraction(1, 1000)
    with av.open(str(made)) as video:
        got = [frame.time for frame in video.decode(video=0)]
    wanted = [float(time * tick) for time in times]
    close = len(got) == len(wanted) and np.allclose(np.array(got) - got[0], wanted, atol=2e-3)
    rising = all(before < after for before, after in pairwise(got))
    return None if state == "kept" and close and rising else f"{state}: {got} instead of {wanted}"
