"""The render stage: raw frames through a table → pictures, one by one, as a sequence or as a video."""

import functools
import os
from collections.abc import Mapping
from dataclasses import astuple, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from l3cli import __version__
from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.errors import DeviceError, InputFileError, RecipeError
from l3cli.io.frame_times import Pacing
from l3cli.io.raw.files import RawOverrides
from l3cli.io.sequences import FrameSequence, find_frames, read_dark
from l3cli.io.video import USUAL_RATE, VideoChoice
from l3cli.rendering.display import require_xyz
from l3cli.rendering.temporal.chunks import Chunks, filters
from l3cli.rendering.white.lights import mixed, nearest_for
from l3cli.rendering.white.source import given_white, usual_balance
from l3cli.stages.claims import OutputGuard
from l3cli.stages.console import Console
from l3cli.stages.input_warnings import warn_of_exposure_time, warn_of_kernels, warn_of_white
from l3cli.stages.rendering.chart_white import source_of
from l3cli.stages.rendering.corrections import CameraFile, correction_in, hot_test
from l3cli.stages.rendering.destination import Destination, claim, destination_of, marked, paged, refuse_missing
from l3cli.stages.rendering.executors import Renderers, RenderSetup, executor_of, while_reading
from l3cli.stages.rendering.lights import mix_of_first, mix_of_given
from l3cli.stages.rendering.mark import Origins
from l3cli.stages.rendering.plan import plan
from l3cli.stages.rendering.rendition import Rendition, chosen_space, for_developers, outputs_as_they_are
from l3cli.stages.rendering.sequence import Tally, follows, render_frames
from l3cli.stages.rendering.shards import part_of
from l3cli.system.files import sha256

if TYPE_CHECKING:
    from l3cli.parallel.cluster import Scheduler

NOTHING_KNOWN = RawOverrides()


def render(
    table: Path, inputs: tuple[Path, ...], output: Path, console: Console, *, rate: Fraction | None = None, bits: int = 8,
    codec: str | None = None, crf: float | None = None, preset: str = "veryfast", suffix: str = "png",
    frames: range | None = None, dataset: str | None = None, known: RawOverrides = NOTHING_KNOWN,
    dark: tuple[Path, ...] = (), camera: Path | None = None, hot: bool = False,
    exposure: float | None = None, stops: float = 0.0,
    white: str | None = None, space: str | None = None, remosaic: str | None = None,
    backend: str = "opencl", device: str | None = None, variant: str | None = None, skip_bad: bool = False,
    resume: bool = False, scheduler: "Scheduler | None" = None, renderers: Renderers | None = None, force: bool = False,
    temporal: bool = False, shard: tuple[int, int] | None = None,
) -> Tally:  # fmt: skip
    """Render raw frames through a table into a picture, numbered files, a folder (of files that end in `suffix`) or a video.

    `rate`: frames/s of a video, None: the input's or 30; `bits`, `codec`, `crf`, `preset`: of pictures and videos. `frames`:
    numbers of those to take. `dataset`: of an HDF5 input. `known`: what is known better of the inputs than they say; `dark`:
    frames without light, whose mean is taken off; `camera`: model whose defects and flat field are corrected; `hot`: mend
    each frame's hot pixels. `exposure`: factor of Y, None: automatic; `stops`: EV by which pictures are brighter than that.
    `white`: name or chromaticity of the scene's white, "camera", "auto", "chart" or "ROW,COL[,SIZE]" of a grey, None: the
    table's. `space`: of the values, None: sRGB, in floating point the outputs as they are; `remosaic`: mosaic of a DNG
    file, "bayer". `skip_bad`: leave out broken frames.
    `resume`: go on where a run was stopped. `renderers`: shared with other runs. `temporal`: frames follow one another in
    time, and share what is not noise. `shard`: (number from 1, of how many) that is rendered alone, as in a run over all.
    RecipeError, InputFileError, DeviceError or L3Error before anything is written where that is known.
    """
    # One long sequence: in this order a refusal comes before any work, and no output takes the place of what is read.
    choice = VideoChoice(rate or USUAL_RATE, bits, codec, crf, preset)
    destination = replace(destination_of(output, suffix, choice), shard=shard)
    engine = {name: value for name, value in {"device": device, "variant": variant}.items() if value is not None}
    with OutputGuard(console) as claims:
        claims.protect(table, *inputs, *dark, *filter(None, [camera]))
        claim(destination, force, claims)
        _refuse_misplaced(destination, white, exposure, stops, space, remosaic)
        if engine and backend != "opencl":
            raise RecipeError(f"‹{next(iter(engine))}› is for the opencl backend; leave it or ‹backend› {backend} out")
        with while_reading(backend, engine, destination.file_suffix, scheduler):
            transforms, digest = load(TransformTable, table), sha256(table)
        if not destination.linear or space is not None:
            transforms = transforms.pictured()
        if dark:
            known = replace(known, dark=read_dark(_spared(find_frames(dark, transforms, known), claims)))
        model = None if camera is None else CameraFile(camera.absolute(), sha256(camera))
        correction = None if model is None else correction_in(model, transforms)
        known = replace(known, correction=correction, hot=hot_test(transforms) if hot else None)
        source = source_of(white, transforms) if white is not None else None
        lit, mix = transforms, None if source else mix_of_given(white, transforms, nearest_for, console)
        transforms = mixed(lit, mix)
        rendition = _rendition(destination, None if source else white, exposure, space, remosaic, bits, transforms, console)
        rendition = replace(rendition, stops=stops)
        sequence = find_frames(inputs, transforms, known, frames, dataset)
        if shard is not None:
            if sequence.count == 1 and not (inputs[0].exists() or set("%#*?[") & set(str(inputs[0]))):
                raise InputFileError(f"{inputs[0]} does not exist; give a folder, a pattern or a stack")
            sequence = replace(sequence, part=part_of(sequence, shard, temporal))
        destination = paged(destination, sequence)
        _spared(sequence, claims)
        if not skip_bad:
            refuse_missing(sequence)
        choice = replace(choice, rate=rate or sequence.rate or USUAL_RATE)
        plan(table, inputs, dark, sequence, destination, force or resume, skip_bad)
        stated = sequence.times() if sequence.times is not None and rate is None else None
        stated = None if stated is None or stated.are_even else stated
        pacing = Pacing(sequence.unit, stated, sequence.unit or 1)
        choice = replace(choice, tick=pacing.tick if destination.has_times else None)
        if source is not None and white is not None and lit.lights:
            mix, sequence = mix_of_first(source, lit, sequence, console)
            transforms = mixed(lit, mix)
            source, rendition = source_of(white, transforms, lit), replace(rendition, balance=usual_balance(transforms))
        setup = RenderSetup(table.absolute(), digest, backend, engine, known, rendition, destination.file_suffix, model, mix)
        steady = follows(sequence, destination) and (rendition.measures_exposure or source is not None)
        chunks = _chunks(backend, engine, transforms, scheduler, sequence, console) if temporal else None
        chosen = {"device": os.environ.get("L3_DEVICE"), **engine}
        levels = (replace(known, dark=None, correction=None), known.dark and known.dark.digest)
        key: list[Any] = [setup.digest, __version__, frames, dataset, suffix, backend, chosen, exposure, white, choice]
        key += [space, remosaic, *levels, known.correction and known.correction.digest, steady, temporal, shard]
        key += [] if mix is None else [astuple(mix)]
        key += [stops] if stops else []
        origins = functools.partial(Origins, inputs[0], steady or temporal)
        with (
            marked(destination, key, resume, force, sequence, origins) as mark,
            executor_of(setup, transforms, scheduler, renderers or Renderers()) as executor,
        ):
            tally = render_frames(
                sequence, destination, executor, transforms, rendition, source, choice, mark, origins(), skip_bad, console,
                pacing, chunks,
            )  # fmt: skip
        warn_of_exposure_time(known.exposure, transforms, console)
        warn_of_kernels(console)
        return tally


def _chunks(
    backend: str, engine: Mapping[str, str | None], table: TransformTable, scheduler: "Scheduler | None",
    sequence: FrameSequence, console: Console,
) -> Chunks:  # fmt: skip
    """The filters of a sequence. They run here, also where workers render: frames depend on one another."""
    if sequence.count == 1:
        console.warn("one frame has none before it: ‹temporal› changes nothing of it; give a sequence")
    try:
        return Chunks(filters(backend, table, **engine))
    except DeviceError:
        if scheduler is None:
            raise
        return Chunks(filters("reference", table))  # the devices are the workers'; all backends give the same


def _spared(sequence: FrameSequence, claims: OutputGuard) -> FrameSequence:
    """Frames whose files no output may replace; those of a stream, which may be endless, lie in one file."""
    if not sequence.is_stream:
        claims.protect(*(pending.source for pending in sequence.frames if pending.source))
    return sequence


def _refuse_misplaced(
    destination: Destination,
    white: str | None,
    exposure: float | None,
    stops: float,
    space: str | None,
    remosaic: str | None,
) -> None:
    """RecipeError if something is asked for that the destination cannot have."""
    if destination.linear and space is None and (exposure is not None or stops or white is not None):
        raise RecipeError(
            "files of floating point hold the outputs as they are; ‹exposure› and ‹white› are for those of a ‹space›"
        )
    if space not in (None, "srgb") and not destination.one_by_one:
        raise RecipeError("videos are sRGB; leave ‹space› out, or name pictures")
    if space is not None and destination.raw:
        raise RecipeError("a DNG file has channels of its own; leave ‹space› out")
    if remosaic is not None and not destination.raw:
        raise RecipeError("‹remosaic› is for raw developers; name a .dng")


def _rendition(
    destination: Destination, white: str | None, exposure: float | None, space: str | None, remosaic: str | None,
    bits: int, table: TransformTable, console: Console,
) -> Rendition:  # fmt: skip
    """Return the rendition of outputs as pictures; RecipeError if there is none."""
    if destination.linear and space is None:
        return outputs_as_they_are(table)
    require_xyz(table.outputs)
    given, space_of = given_white(white, table), chosen_space(space, destination.linear)
    balance = usual_balance(table) if white is None or given is None else given.balance
    if white is not None and given is not None:
        warn_of_white(white, given, table, console)
    rendition = Rendition(balance, exposure, bits, space_of)
    return for_developers(rendition, remosaic) if destination.raw else rendition
