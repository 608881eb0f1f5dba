"""The render stage: raw frames through a table → pictures, one by one, as a sequence or as a video."""

import contextlib
import functools
import itertools
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import astuple, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.errors import DeviceError, InputFileError, L3Error, RecipeError, suggestion
from l3cli.frames.correction import CameraFile, correction_in, hot_test
from l3cli.frames.frame import RawFrame
from l3cli.frames.gain_estimate import estimate_gain
from l3cli.io.destination import Destination, destination_of, guard_outputs, paged
from l3cli.io.pictures.dng import MOSAICS
from l3cli.io.pictures.registry import write_picture
from l3cli.io.raw.files import are_photos
from l3cli.io.sequences import STDIN_NAME, FrameSequence, find_frames, read_dark
from l3cli.io.video import USUAL_RATE, Pacing
from l3cli.options.render import RenderOptions
from l3cli.physics.display import TONES
from l3cli.physics.spaces import REC2020
from l3cli.rendering.conditions import Mix, described, known_gains, mixed, nearest_for
from l3cli.rendering.display import require_xyz
from l3cli.rendering.opencl.devices import cache_warning
from l3cli.rendering.raw_checks import odd_exposure_time
from l3cli.rendering.renderer import NoiseRenderer
from l3cli.rendering.rendition import Rendition, chosen_space, outputs_as_they_are
from l3cli.rendering.temporal.chunks import Chunks, filters
from l3cli.rendering.white.scene_white import far_from_training
from l3cli.rendering.white.source import WhiteSource, given_white, usual_balance, white_source
from l3cli.stages.rendering.checkpoint import FrameDigests, checkpointed, input_files, overrides, part_of, video_choice
from l3cli.stages.rendering.executors import Renderers, RenderSetup, executor_of, while_reading
from l3cli.stages.rendering.sequence import SequenceJob, Tally, render_frames
from l3cli.system.console import Console
from l3cli.system.files import sha256
from l3cli.system.outputs import OutputGuard

if TYPE_CHECKING:
    from l3cli.parallel.cluster import Scheduler


def render(
    table: Path, inputs: tuple[Path, ...], output: Path, options: RenderOptions, renderers: Renderers | None = None
) -> Tally:
    """Render raw frames through a table into a picture, numbered files, a folder or a video. `renderers`: shared with other
    runs. RecipeError, InputFileError, DeviceError or L3Error before anything is written where that is known."""
    # One long sequence: in this order a refusal comes before any work, and no output takes the place of what is read.
    console, dark, white, scheduler = options.console, options.dark, options.white, options.cluster()
    choice, known = video_choice(options), overrides(options)
    destination = destination_of(output, options.format, choice, options.shard)
    engine = {name: value for name, value in {"device": options.device, "variant": options.variant}.items() if value}
    with OutputGuard(console) as guard:
        guard.protect(table, *inputs, *itertools.chain(*options.inputs().values()))
        guard_outputs(destination, options.force, guard)
        if options.uncertainty is not None:
            guard.guard_file(options.uncertainty, options.force)
        _refuse_misplaced(destination, options)
        if engine and options.backend != "opencl":
            raise RecipeError(
                f"‹{next(iter(engine))}› is for the opencl backend; leave it or ‹backend› {options.backend} out"
            )
        with while_reading(options.backend, engine, destination.file_suffix, scheduler):
            transforms, digest = load(TransformTable, table), sha256(table)
        if not destination.linear or options.space is not None:
            transforms = transforms.pictured()
        if dark:
            frames = find_frames(dark, transforms, replace(known, gains=()))
            known = replace(known, dark=read_dark(_protected(frames, guard)))
        model = None if options.camera is None else CameraFile(options.camera.absolute(), sha256(options.camera))
        correction = None if model is None else correction_in(model, transforms)
        known = replace(known, correction=correction, hot=hot_test(transforms) if options.hot == "auto" else None)
        photos = are_photos(inputs[0]) and (not destination.linear or options.space is not None)
        source = white_source(white, transforms, photos)
        lit, mix = transforms, None if source else mix_of_given(white, transforms, nearest_for, console)
        transforms = mixed(lit, mix)
        rendition = _rendition(destination, None if source else white, transforms, options)
        if rendition.balance is not None and transforms.shows_grey:
            console.info(f"{table} tells no colours; pictures are grey")
        find = functools.partial(find_frames, inputs, transforms, selection=options.frames, dataset=options.dataset)
        sequence = find(known)
        if options.shard is not None:
            if sequence.count == 1 and not (inputs[0].exists() or set("%#*?[") & set(str(inputs[0]))):
                raise InputFileError(f"{inputs[0]} does not exist; give a folder, a pattern or a stack")
            sequence = replace(sequence, part=part_of(sequence, options.shard, options.temporal))
        if options.deflicker and sequence.stills and destination.pictures:
            raise RecipeError(f"‹deflicker› is for frames that follow one another; {sequence.what} is no sequence")
        if options.uncertainty is not None and sequence.count != 1:
            raise RecipeError("‹uncertainty› is of one frame; name one, or leave it out")
        if options.uncertainty is not None:
            from l3cli.rendering.uncertainty import require_known_noise  # which few frames need

            require_known_noise(transforms)
        destination = paged(destination, sequence)
        if options.uncertainty is not None:
            for each in sequence.frames:
                if options.uncertainty.resolve() == destination.file(each.number, each.stem).resolve():
                    raise RecipeError(f"{options.uncertainty} is named for two outputs; name two files")
        _protected(sequence, guard)
        if sequence.missing and not options.skip_bad:
            raise sequence.absent(sequence.missing[0])
        used = input_files(table, inputs, sequence, options)
        if options.gain is None and not known.gains and (gain := gain_of_first(transforms, find(known), console)):
            known = replace(known, unlabelled_gain=gain)
            sequence = replace(sequence, frames=find(known).frames)
        stated = sequence.times() if sequence.times is not None and options.fps is None else None
        stated = None if stated is None or stated.are_even else stated
        pacing = Pacing(sequence.unit, stated, sequence.unit or 1)
        rate = options.fps or sequence.rate or USUAL_RATE
        choice = replace(choice, rate=rate, tick=pacing.tick if destination.has_times else None)
        if source is not None and lit.lights:
            mix, sequence = mix_of_first(source, lit, sequence, console)
            transforms = mixed(lit, mix)
            source, rendition = (
                white_source(white, transforms, photos, lit),
                replace(rendition, balance=usual_balance(transforms)),
            )
        setup = RenderSetup(
            table.absolute(), digest, options.backend, engine, known, rendition, destination.file_suffix, model, mix
        )
        chunks = _chunks(options.backend, engine, transforms, scheduler, sequence, console) if options.temporal else None
        ends = [sequence.count] if options.deflicker else []  # the last frames depend on how many follow them
        key = options.run_key(
            digest, os.environ.get("L3_DEVICE"), choice, mix and astuple(mix), known.unlabelled_gain, *ends
        )
        job = SequenceJob(sequence, destination, transforms, rendition, source, choice, pacing, chunks, options)
        digests = functools.partial(FrameDigests, inputs[0], job.follows)
        with (
            checkpointed(destination, key, options, sequence, digests) as checkpoint,
            executor_of(setup, transforms, scheduler, renderers or Renderers()) as executor,
        ):
            if options.uncertainty is not None:  # first: a frame that is too small leaves no picture that is in the way
                write_uncertainty(options.uncertainty, transforms, sequence, engine, options)
            tally = render_frames(job, executor, checkpoint, digests())
            written = [*tally.written, *([] if options.uncertainty is None else [options.uncertainty])]
            tally.files = used.and_wrote(*written)
        for text in filter(None, (odd_exposure_time(known.exposure, transforms), cache_warning())):
            console.warn(text)
        return tally


def _chunks(
    backend: str, engine: Mapping[str, str | None], table: TransformTable, scheduler: "Scheduler | None",
    sequence: FrameSequence, console: Console,
) -> Chunks:  # fmt: skip
    """Return the filters of a sequence. They run here, also where workers render: frames depend on one another."""
    if sequence.count == 1:
        console.warn("one frame has none before it: ‹temporal› changes nothing of it; give a sequence")
    try:
        return Chunks(filters(backend, table, **engine))
    except DeviceError:
        if scheduler is None:
            raise
        return Chunks(filters("reference", table))  # the devices are the workers'; all backends give the same


def _protected(sequence: FrameSequence, guard: OutputGuard) -> FrameSequence:
    """Return frames whose files no output may replace; those of a stream, which may be endless, lie in one file."""
    if not sequence.is_stream:
        guard.protect(*(reference.source for reference in sequence.frames if reference.source))
    return sequence


def _refuse_misplaced(destination: Destination, options: RenderOptions) -> None:
    """Raise RecipeError if something is asked for that the destination cannot have."""
    space, exposure = options.space, options.exposure
    if destination.linear and space is None and (exposure.factor is not None or exposure.stops or options.white is not None):
        raise RecipeError(
            "files of floating point hold the outputs as they are; ‹exposure› and ‹white› are for those of a ‹space›"
        )
    if destination.linear and space is None and options.deflicker:
        raise RecipeError(
            "‹deflicker› changes exposures, and files of floating point hold the outputs as they are; name a ‹space›"
        )
    if options.tone is not None and (destination.linear or destination.raw):
        raise RecipeError("‹tone› is for pictures of codes, and values are linear here; leave it out, or name a .png")
    if space not in (None, "srgb") and not destination.one_by_one:
        raise RecipeError("videos are sRGB; leave ‹space› out, or name pictures")
    if space is not None and destination.raw:
        raise RecipeError("a DNG file has channels of its own; leave ‹space› out")
    if options.remosaic is not None and not destination.raw:
        raise RecipeError("‹remosaic› is for raw developers; name a .dng")
    if options.uncertainty is not None and (options.uncertainty.suffix.lower() != ".exr" or options.temporal):
        raise RecipeError("‹uncertainty› is written as .exr, without ‹temporal›; name such a file")


def write_uncertainty(
    path: Path, table: TransformTable, sequence: FrameSequence, engine: dict[str, str], options: RenderOptions
) -> None:
    """Write the uncertainty of the only frame of a sequence (docs/measurement.md#uncertainty), of the outputs as they are;
    RecipeError if it is not known of the table."""
    (frame,) = (sequence.frames.series.read(number) for number in sequence.frames.wanted)
    if frame is None:
        raise InputFileError("the frame is missing, and so is its uncertainty")
    from l3cli.rendering.uncertainty import uncertainty

    found = uncertainty(NoiseRenderer(options.backend, table, **engine).of_frame(frame), frame)
    pixels = np.concatenate([found.sigma, found.mask[..., None].astype(np.float32)], axis=2)
    names = (*(f"sigma.{name}" for name in table.outputs), "mask")
    write_picture(path, pixels, names)
    share = float((found.mask > 0).mean())
    options.console.info(f"{path}: written; {share:.1%} of the pixels are clipped or of classes without training patches")


def _rendition(destination: Destination, white: str | None, table: TransformTable, options: RenderOptions) -> Rendition:
    """Return the rendition of outputs as pictures, under a white that is given; RecipeError if there is none."""
    if destination.linear and options.space is None:
        return outputs_as_they_are(table)
    require_xyz(table.outputs)
    given, space_of = given_white(white, table), chosen_space(options.space, destination.linear)
    balance = usual_balance(table) if white is None or given is None else given.balance
    if white is not None and given is not None and (doubt := far_from_training(white, given, table)):
        options.console.warn(doubt)
    if white is not None and given is not None and table.camera is not None and "," not in white:
        from l3cli.simulation.light import named_beyond_known

        for unknown in named_beyond_known((white,), table.camera):
            options.console.warn(unknown)
    exposure = options.exposure
    rendition = Rendition(
        balance, exposure.factor, options.bits, space_of, stops=exposure.stops, stated_exposure=exposure.stated,
        tone=TONES[options.tone] if options.tone else None,
    )  # fmt: skip
    if not destination.raw:
        return rendition
    if options.remosaic not in (None, *MOSAICS):
        raise RecipeError(f'mosaic "{options.remosaic}" is unknown; {suggestion(options.remosaic, MOSAICS)}')
    return replace(rendition, space=replace(REC2020, curve=None), raw=True, mosaic=options.remosaic)


Choice = Callable[[TransformTable, NDArray[np.floating]], Mix | None]  # mix_for or nearest_for


def mix_of_given(white: str | None, table: TransformTable, choice: Choice, console: Console) -> Mix | None:
    """Return the choice for a white that is given by name or "x,y"; None, the transforms of all lights in common, for that
    of the table. RecipeError as given_white."""
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
    """Return the light nearest to the white of the first of the frames, by whose transforms all of them are rendered, and
    the frames; None, the transforms of all lights in common, where it has none. What is wrong with a frame is said when it
    is rendered."""
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


def gain_of_first(table: TransformTable, sequence: FrameSequence, console: Console) -> float | None:
    """Return the analog gain that is estimated from the noise of the first of the frames, for all that do not state theirs;
    None where the first does, the noise of the table's camera is known at one gain alone, or there is no estimate."""
    if table.camera is None or known_gains(table) == (1, 1):
        return None
    if sequence.what == STDIN_NAME:
        console.warn("the gain of frames on stdin is not estimated, but taken for 1; give ‹gain›")
        return None
    first, _ = _first_frame(sequence)
    if first is None or table.gain_at(first.shot.iso) is not None:
        return None
    try:
        estimate = estimate_gain(first, table.camera)
    except ValueError as reason:
        console.warn(f"{first.name}: its gain is unknown ({reason}), and taken for 1; give ‹gain›")
        return None
    low, high = estimate.bounds
    extent = "" if sequence.count == 1 else ", for all frames without ISO speed"
    console.warn(
        f"{first.name}: gain {estimate.gain:.3g} ({low:.2g} to {high:.2g}) estimated from its noise{extent}; give ‹gain› to "
        "state it"
    )
    return estimate.gain


def _first_frame(sequence: FrameSequence) -> tuple[RawFrame | None, FrameSequence]:
    """Return the first frame, None if there is none or it is broken, and the frames again: those of a stream come once."""
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
