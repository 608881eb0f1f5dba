"""The evaluation of a rendered sequence, beside the ideal one or without it → figures over time."""

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError, RecipeError
from l3cli.evaluation.sequence import CELL, SequenceEvaluation, SequenceFigures
from l3cli.io.picture_sequences import PictureSequence, find_pictures, read_motion
from l3cli.stages.console import Console
from l3cli.stages.plan import before_work
from l3cli.system.limits import read_bounded

Array = NDArray[np.float32]
UNLIKE = 1.05  # times as bright: figures of lightness would compare two exposures
GIVE = 'give what "l3 evaluate --sequence … --json" prints'


def evaluate_sequence(
    rendered: Path, console: Console, *, ideal: Path | None = None, border: int | None = None
) -> SequenceFigures:
    """Figures of a sequence of pictures or a video, beside an ideal one if there is one, with the known motion that lies
    beside its pictures.

    `border`: pixels left out at each edge; None: none. InputFileError if a sequence cannot be read, or they differ in size
    or number; RecipeError if nothing is left within the border.
    """
    ours = find_pictures(rendered)
    wanted = None if ideal is None else find_pictures(ideal)
    _require_alike(ours, wanted)
    margin = border or 0
    if min(ours.shape) - 2 * margin < CELL:
        rows, cols = ours.shape
        raise RecipeError(f"{rendered}: a border of {margin} leaves no patch of {CELL}×{CELL} pixels of {rows}×{cols}")
    before_work({"pictures": ours.files, "ideal": wanted.files if wanted else (), "motion": wanted.motion if wanted else ()})
    evaluation = SequenceEvaluation(str(rendered), None if ideal is None else str(ideal), margin)
    light = np.zeros(2)
    for ours_now, ideal_now, motion in console.progress(_frames(ours, wanted), ours.count, "frames"):
        evaluation.add(ours_now, ideal_now, motion)
        light += [ours_now.mean(), 0.0 if ideal_now is None else ideal_now.mean()]
    if wanted is not None and not 1 / UNLIKE <= light[0] / max(light[1], 1e-9) <= UNLIKE:
        ratio = light[0] / max(light[1], 1e-9)
        console.warn(
            f"{rendered} is {ratio:.3g} times as bright as {ideal}; render it with ‹exposure› {1 / ratio:.3g} times as large"
        )
    try:
        return evaluation.figures()
    except ValueError as error:
        raise InputFileError(f"{rendered}: {error}") from error


def read_sequence_figures(path: Path) -> SequenceFigures:
    """Return the figures that `l3 evaluate --sequence` printed as JSON; InputFileError if a file holds something else."""
    try:
        printed = msgspec.json.decode(read_bounded(path, GIVE), type=dict[str, Any])
        printed.pop("run", None)  # how the command ran
        figures = msgspec.convert(printed, SequenceFigures)
    except (OSError, msgspec.MsgspecError, RecursionError) as error:
        raise InputFileError(f"{path} is no evaluation of a sequence; {GIVE}") from error
    if len(figures.frames) < 2:
        raise InputFileError(f"{path} holds fewer than two frames; {GIVE}")
    return figures


def document(figures: SequenceFigures) -> dict[str, Any]:
    """The figures, ready for JSON."""
    return dict(msgspec.to_builtins(figures))


def _require_alike(ours: PictureSequence, wanted: PictureSequence | None) -> None:
    if ours.count == 1:
        raise InputFileError(f"{ours.name} holds one picture; a sequence has two or more")
    if wanted is None:
        return
    if ours.shape != wanted.shape:
        sizes = " and ".join(f"{rows}×{cols}" for rows, cols in (ours.shape, wanted.shape))
        raise InputFileError(f"{ours.name} and {wanted.name} are of {sizes} pixels; give pictures of the same frames")
    if ours.count is not None and wanted.count is not None and ours.count != wanted.count:
        counts = f"{ours.count} and {wanted.count} pictures"
        raise InputFileError(f"{ours.name} and {wanted.name} hold {counts}; give pictures of the same frames")


def _frames(ours: PictureSequence, wanted: PictureSequence | None) -> Iterator[tuple[Array, Array | None, Array | None]]:
    """Rendered picture, ideal one and known motion of each frame; InputFileError if one sequence ends before the other."""
    ideals: Iterator[Array | None] = wanted.pictures() if wanted else itertools.repeat(None)
    motions = iter(wanted.motion) if wanted else iter(())
    for number, picture in enumerate(ours.pictures()):
        ideal = next(ideals, None)
        if wanted is not None and ideal is None:
            raise InputFileError(f"{wanted.name} ends after {number} pictures, {ours.name} goes on; give the same frames")
        motion = next(motions, None)
        yield picture, ideal, None if motion is None else read_motion(motion, ours.shape)
    if wanted is not None and next(ideals, None) is not None:
        raise InputFileError(f"{ours.name} ends before {wanted.name}; give pictures of the same frames")
