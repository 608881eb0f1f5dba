"""Which transforms of a table of several lights a run takes (docs/method.md#several-lights)."""

import contextlib
import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.errors import L3Error
from l3cli.frames.frame import RawFrame
from l3cli.io.sequences import FrameSequence
from l3cli.rendering.conditions import Mix, described, nearest_for
from l3cli.rendering.white.source import WhiteSource, given_white
from l3cli.system.console import Console

Choice = Callable[[TransformTable, NDArray[np.floating]], Mix | None]  # mix_for or nearest_for


def mix_of_given(white: str | None, table: TransformTable, choice: Choice, console: Console) -> Mix | None:
    """The choice for a white that is given by name or "x,y"; None, the transforms of all lights in common, for that of the
    table. RecipeError as given_white."""
    if not table.lights:
        return None
    given = given_white(white, table)
    if given is None:
        names = ", ".join(light.name for light in table.lights)
        console.info(f"the table's transforms for all its lights in common ({names}) are taken; ‹white› chooses others")
        return None
    mix = choice(table, given.light.xyz)
    assert mix is not None
    console.info(f"white {white}: transforms of {described(table, mix)}")
    return mix


def mix_of_first(
    source: WhiteSource, table: TransformTable, sequence: FrameSequence, console: Console
) -> tuple[Mix | None, FrameSequence]:
    """The light nearest to the white of the first of the frames, by whose transforms all of them are rendered, and the
    frames; None, the transforms of all lights in common, where it has none. What is wrong with a frame is said when it is
    rendered."""
    first, sequence = _first_frame(sequence)
    white, alone = None, sequence.count == 1
    if first is not None:
        with contextlib.suppress(L3Error):
            white = source.white(first)
    if first is None or white is None:
        if not alone:
            console.info("the first frame tells no white; the table's transforms for all its lights in common are taken")
        return None, sequence
    mix = nearest_for(table, white.light.xyz)
    assert mix is not None
    extent = "" if alone else ", for all frames"
    console.info(f"{first.name}: white {source.about}: transforms of {described(table, mix)}{extent}")
    return mix, sequence


def _first_frame(sequence: FrameSequence) -> tuple[RawFrame | None, FrameSequence]:
    """The first frame, None if there is none or it is broken, and the frames again: those of a stream come once."""
    frames = sequence.frames
    number = next(iter(frames.wanted), None)
    if number is None:
        return None, sequence
    first: RawFrame | None = None
    broken: Exception | None = None
    try:
        first = frames.series.read(number)
    except (L3Error, OSError) as error:
        broken = error
    if not sequence.is_stream:
        return first, sequence

    def read(wanted: int) -> RawFrame | None:
        if wanted != number:
            return frames.series.read(wanted)
        if broken is not None:
            raise broken
        return first

    # Numbers without an end come once, too.
    wanted = itertools.chain([number], frames.wanted) if isinstance(frames.wanted, Iterator) else frames.wanted
    return first, replace(sequence, frames=replace(frames, series=replace(frames.series, read=read), wanted=wanted))
