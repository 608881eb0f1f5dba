"""First phase of rendering: open the table, find the frames, and check all options.

Errors that do not depend on the content of frames are raised here, before anything is written.
"""

import itertools
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.errors import InputFileError, RecipeError, suggestion
from l3cli.frames.correction import CameraFile, correction_in, hot_test
from l3cli.io.destination import Destination, destination_of, guard_outputs, paged, refuse_outputs
from l3cli.io.pictures.dng import MOSAICS
from l3cli.io.pictures.registry import BY_SUFFIX
from l3cli.io.raw.files import RawOverrides, are_photos
from l3cli.io.sequences import FrameSequence, find_frames, read_dark
from l3cli.io.video import USUAL_RATE, VideoChoice
from l3cli.options.render import GAIN, RenderOptions
from l3cli.parallel.threads import BackgroundTask
from l3cli.physics.display import TONES
from l3cli.physics.spaces import REC2020, SRGB
from l3cli.physics.stokes import STOKES, has_stokes
from l3cli.rendering.conditions import Mix, described, mixed, nearest_for
from l3cli.rendering.display import require_xyz
from l3cli.rendering.renderer import make_ready
from l3cli.rendering.rendition import OUTPUTS, Rendition, chosen_space, outputs_as_they_are
from l3cli.rendering.temporal.chunks import CHUNK
from l3cli.rendering.temporal.noise import require_noise
from l3cli.rendering.white.scene_white import SceneWhite, far_from_training
from l3cli.rendering.white.source import WhiteSource, given_white, usual_balance, white_source
from l3cli.stages.rendering.checkpoint import PictureCheckpoint, checkpoint_of
from l3cli.system.console import Console
from l3cli.system.files import FilesUsed, files_to_read, sha256
from l3cli.system.limits import read_bounded
from l3cli.system.outputs import OutputGuard
from l3cli.system.text import counted

if TYPE_CHECKING:
    from l3cli.parallel.cluster import Scheduler


@dataclass(frozen=True)
class Job:
    """Inputs, destination and settings of a rendering that do not depend on the content of frames."""

    table_file: Path
    digest: str  # SHA-256 of the table
    table: TransformTable  # table that still contains the transforms for all its illuminants
    inputs: tuple[Path, ...]
    sequence: FrameSequence
    destination: Destination
    overrides: RawOverrides  # values that replace the metadata of raw files, the dark frame, and corrections
    camera: CameraFile | None  # camera model with the defects and the flat field to correct
    engine: dict[str, str]  # options of the backend
    shows_photos: bool  # True if the raw files contain a white balance and the outputs are pictures
    white_source: WhiteSource | None  # method that finds each frame's white; None to use the white of the rendition
    light_mix: Mix | None  # mixture of the table's illuminants for the option `white`
    rendition: Rendition
    scheduler: "Scheduler | None"
    checkpoint: PictureCheckpoint | None  # None for outputs that cannot be resumed, such as streams and single pictures
    files: FilesUsed
    options: RenderOptions

    def find(self, overrides: RawOverrides) -> FrameSequence:
        """List the frames of the inputs. The frames are read later, with the given overrides."""
        return find_frames(self.inputs, self.table, overrides, self.options.frames, self.options.dataset)

    @property
    def in_order(self) -> bool:
        """True for sequences, in which exposure and white change smoothly. For stills, each frame has its own values."""
        return not (self.sequence.stills and self.destination.pictures)

    @property
    def frames_depend_on_earlier(self) -> bool:
        """Whether the picture of a frame depends on previous frames."""
        measures = self.rendition.measures_exposure or self.white_source is not None or self.options.deflicker
        return (self.in_order and measures) or self.options.temporal


def open_job(
    table_file: Path, inputs: tuple[Path, ...], output: Path, options: RenderOptions, guard: OutputGuard, is_clip: bool
) -> Job:
    """Open the table, find the frames, and check all options, before anything is written.

    If `resume` is set, this function also reads the list of finished outputs of the earlier run.

    Parameters
    ----------
    table_file : Path
        File of the transform table.
    inputs : tuple of Path
        Files with one frame each, or one sequence.
    output : Path
        Picture, pattern of numbered pictures, folder, video, or "-" for standard output.
    options : RenderOptions
        Options of `l3 render`.
    guard : OutputGuard
        Protects the inputs and locks the outputs.
    is_clip : bool
        Whether the input is one of several clips. A clip always has a checkpoint, even if it is a single picture.

    Raises
    ------
    RecipeError, InputFileError, DeviceError, L3Error
        If the frames cannot be rendered.
    """
    scheduler, stated = options.cluster(), stated_overrides(options)
    place = destination_of(output, options.format, video_choice(options), options.shard)
    guard.protect(table_file, *inputs, *itertools.chain(*options.inputs().values()))
    guard_outputs(place, options.force or options.resume, guard)
    if options.uncertainty is not None:
        guard.guard_file(options.uncertainty, options.force)
    engine = _engine(options)
    _refuse_misplaced(place, options)
    with _prepared_meanwhile(options.backend, engine, place.file_suffix, scheduler):
        loaded, digest = load(TransformTable, table_file), sha256(table_file)
    table = loaded.pictured() if has_display(place, options) and options.show is None else loaded
    _refuse_polarisation(table, place, options)
    camera = None if options.camera is None else CameraFile(options.camera.absolute(), sha256(options.camera))
    overrides = _with_corrections(stated, table, camera, options, guard)
    shows_photos = has_display(place, options) and not has_stokes(table.outputs) and are_photos(inputs[0])
    white = None if table.outputs == STOKES else options.white  # white balance has no effect on grey pictures of S0
    source = white_source(white, table, shows_photos)
    light_mix = None if source else light_mix_of_given(white, table, nearest_for, options.console)
    rendition = _rendition(place, None if source else white, mixed(table, light_mix), options)
    if rendition.balance is not None and table.shows_grey:
        options.console.info(f"{table_file} has no colour outputs, so the pictures are grey")
    sequence = _frames(inputs, table, overrides, options)
    destination = paged(place, sequence)
    _refuse_frames(sequence, destination, table, options)
    _protect_frames(sequence, guard)
    keeps = destination.kind != "stream" and (destination.kind != "file" or options.resume or is_clip)
    key = options.run_key(digest, os.environ.get("L3_DEVICE"), _folder_or_file(inputs))
    checkpoint = checkpoint_of(destination, key, options.resume, options.force) if keeps else None
    refuse_outputs(destination, sequence, options.force, checkpoint.is_ours if checkpoint else lambda _: False)
    return Job(
        table_file=table_file,
        digest=digest,
        table=table,
        inputs=inputs,
        sequence=sequence,
        destination=destination,
        overrides=overrides,
        camera=camera,
        engine=engine,
        shows_photos=shows_photos,
        white_source=source,
        light_mix=light_mix,
        rendition=rendition,
        scheduler=scheduler,
        checkpoint=checkpoint,
        files=_files_read(table_file, inputs, sequence, options),
        options=options,
    )


# ------------------------------------------------------------------------------------------------------------ options


def stated_overrides(options: RenderOptions) -> RawOverrides:
    """Collect the option values that replace the metadata of raw files.

    Raises
    ------
    InputFileError
        If the file with the gains of the frames cannot be read.
    """
    levels = options.black_level, options.white_level, options.phase
    gains = _gains_in(options.gains) if options.gains else ()
    return RawOverrides(
        *levels, options.size, options.packing, options.stride, options.exposure_time, options.gain, gains,
        skip=options.skip, byte_order=options.byte_order, opcodes=options.opcodes,
    )  # fmt: skip


def _gains_in(path: Path) -> tuple[float, ...]:
    """Read a text file with the analog gain of each frame, separated by blanks or line ends.

    Raises InputFileError if the file is empty or contains an invalid gain.
    """
    gains, give = [], "use a text file that contains the gain of each frame, one per line"
    for number, text in enumerate(read_bounded(path, give).decode(errors="replace").split(), 1):
        try:
            gains.append(float(GAIN.read(text)))
        except ValueError as error:
            raise InputFileError(f"{path}: gain {number}: {error}") from None
    if not gains:
        raise InputFileError(f"{path} is empty; {give}")
    return tuple(gains)


def video_choice(options: RenderOptions) -> VideoChoice:
    """Return the settings of the video encoder."""
    return VideoChoice(options.fps or USUAL_RATE, options.bits, options.codec, options.crf, options.preset)


def has_display(destination: Destination, options: RenderOptions) -> bool:
    """True if white balance and exposure are applied to the outputs. False if the outputs are written unchanged."""
    return not destination.linear or options.space is not None


def _engine(options: RenderOptions) -> dict[str, str]:
    """Return the backend options that the user has set. Raise RecipeError if the backend does not support an option."""
    engine = {name: value for name, value in {"device": options.device, "variant": options.variant}.items() if value}
    if engine and options.backend != "opencl":
        raise RecipeError(
            f"‹{next(iter(engine))}› applies only to the backend opencl; leave out ‹{next(iter(engine))}› or ‹backend› "
            f"{options.backend}"
        )
    return engine


def _prepared_meanwhile(
    backend: str, engine: dict[str, str], suffix: str | None, scheduler: "Scheduler | None"
) -> BackgroundTask:
    """Context manager that prepares the OpenCL device and the writer for files with `suffix` in the background."""

    def work() -> None:
        if scheduler is None:
            make_ready(backend, **engine)
        if suffix is not None:
            BY_SUFFIX[suffix.lower()].make_ready()

    return BackgroundTask(work)


def _refuse_misplaced(destination: Destination, options: RenderOptions) -> None:
    """Raise RecipeError if an option does not apply to the destination."""
    space, exposure = options.space, options.exposure
    if not has_display(destination, options):
        if exposure.factor is not None or exposure.stops or options.white is not None:
            name = "exposure" if options.white is None else "white"
            raise RecipeError(
                f"‹{name}› has no effect on a floating-point file, which contains the unchanged outputs; add ‹space›, or "
                f"remove ‹{name}›"
            )
        if options.deflicker:
            raise RecipeError(
                "‹deflicker› has no effect on a floating-point file, which contains the unchanged outputs; add ‹space›, or "
                "remove ‹deflicker›"
            )
    if options.tone is not None and (destination.linear or destination.raw):
        raise RecipeError("‹tone› applies only to display images, but the output is linear; remove ‹tone›")
    if space not in (None, "srgb") and not destination.one_by_one:
        raise RecipeError("‹space› applies only to pictures, because videos are always sRGB; remove ‹space›")
    if space is not None and destination.raw:
        raise RecipeError("‹space› cannot be used for DNG files, which have their own colour space; remove ‹space›")
    if options.remosaic is not None and not destination.raw:
        raise RecipeError("‹remosaic› applies only to DNG files; remove ‹remosaic›, or write a .dng")
    if options.resume and destination.kind == "stream":
        raise RecipeError("‹resume› does not work for output to stdout; remove ‹resume›, or write to a file")
    if options.uncertainty is not None and options.uncertainty.suffix.lower() != ".exr":
        raise RecipeError(f"‹uncertainty› {options.uncertainty} is not an .exr file; use a file name that ends in .exr")
    if options.uncertainty is not None and options.temporal:
        raise RecipeError("‹uncertainty› cannot be combined with ‹temporal›; remove one of these options")


def _refuse_polarisation(table: TransformTable, destination: Destination, options: RenderOptions) -> None:
    """Raise RecipeError if an option does not apply to a table with Stokes parameters."""
    if options.show is None:
        return
    if not has_stokes(table.outputs):
        raise RecipeError(
            f"‹show› {options.show} needs a table with the outputs S1 and S2, but the outputs are "
            f"{', '.join(table.outputs)}; remove ‹show›, or use a table for a camera with polarisers"
        )
    if destination.linear or destination.raw:
        raise RecipeError(f"‹show› makes pictures for display, but {destination.path} contains linear values; remove ‹show›")
    exposed = options.exposure.factor is not None or bool(options.exposure.stops)
    given = {"white": options.white, "space": options.space, "tone": options.tone, "deflicker": options.deflicker}
    for name, value in [*given.items(), ("exposure", exposed)]:
        if value:
            raise RecipeError(f"‹{name}› has no effect on pictures of polarisation; remove ‹{name}› or ‹show›")


# ------------------------------------------------------------------------------------------------------------- inputs


def _with_corrections(
    stated: RawOverrides, table: TransformTable, camera: CameraFile | None, options: RenderOptions, guard: OutputGuard
) -> RawOverrides:
    """Add the dark frame, the corrections of the camera model and the test for hot pixels to the overrides."""
    dark = None
    if options.dark:
        sequence = find_frames(options.dark, table, replace(stated, gains=()))
        _protect_frames(sequence, guard)
        dark = read_dark(sequence)
    correction = None if camera is None else correction_in(camera, table)
    return replace(stated, dark=dark, correction=correction, hot=hot_test(table) if options.hot == "auto" else None)


def _frames(
    inputs: tuple[Path, ...], table: TransformTable, overrides: RawOverrides, options: RenderOptions
) -> FrameSequence:
    """List the frames of the inputs, or the part that a shard renders.

    Raises InputFileError if a shard is set and the input does not exist.
    """
    sequence = find_frames(inputs, table, overrides, options.frames, options.dataset)
    if options.shard is None:
        return sequence
    if sequence.count == 1 and not (inputs[0].exists() or set("%#*?[") & set(str(inputs[0]))):
        raise InputFileError(f"{inputs[0]} does not exist; specify a folder, a pattern or a file with several frames")
    return replace(sequence, part=part_of(sequence, options.shard, options.temporal))


def part_of(sequence: FrameSequence, shard: tuple[int, int], temporal: bool) -> range:
    """Return the positions, counted from 0, of the frames that a shard renders.

    Parameters
    ----------
    sequence : FrameSequence
        All frames.
    shard : tuple of int
        Number of the shard, counted from 1, and number of shards.
    temporal : bool
        Whether the temporal filter is used, which works in chunks of frames. If there are enough frames, each shard then
        starts with a chunk, because otherwise it would also have to filter earlier frames.

    Raises
    ------
    RecipeError
        If the number of frames is unknown, or smaller than the number of shards.
    """
    number, shards = shard
    if sequence.count is None:
        raise RecipeError(
            f"{sequence.what} does not state its number of frames, which ‹shard› needs; set ‹frames› to the total "
            "number of frames in all shards"
        )
    count = sequence.count - sequence.lost
    if count < shards:
        raise RecipeError(
            f"{sequence.what} has {counted(count, 'frame')}, but ‹shard› divides it into {shards} shards; use fewer shards"
        )
    grid = CHUNK if temporal and count >= shards * CHUNK else 1
    first, last = (count * index // shards for index in (number - 1, number))
    return range(_nearest(first, grid), count if number == shards else _nearest(last, grid))


def _nearest(position: int, grid: int) -> int:
    """Round to the nearest multiple of `grid`.

    Halves are rounded up, so that positions at a distance of at least `grid` have different results.
    """
    return (position + grid // 2) // grid * grid


def _protect_frames(sequence: FrameSequence, guard: OutputGuard) -> None:
    """Ensure that no output replaces the file of a frame. Streams, which may be endless, have no files."""
    if not sequence.is_stream:
        guard.protect(*(reference.source for reference in sequence.frames if reference.source))


def _refuse_frames(sequence: FrameSequence, destination: Destination, table: TransformTable, options: RenderOptions) -> None:
    """Raise RecipeError if an option does not apply to the frames.

    Raises InputFileError if frames are missing and `skip_bad` is not set.
    """
    if options.deflicker and sequence.stills and destination.pictures:
        raise RecipeError(
            f"‹deflicker› applies only to sequences, but {sequence.what} is not a sequence; remove ‹deflicker›"
        )
    if options.uncertainty is not None:
        if sequence.count != 1:
            raise RecipeError("‹uncertainty› works only for a single frame; render one frame, or remove ‹uncertainty›")
        from l3cli.rendering.uncertainty import require_known_noise  # imported here to save start-up time

        require_known_noise(table)
        for each in sequence.frames:
            if options.uncertainty.resolve() == destination.file(each.number, each.stem).resolve():
                raise RecipeError(
                    f"‹uncertainty› {options.uncertainty} is also the name of the picture; choose a different file name"
                )
    if options.temporal:
        require_noise(table.camera)
    if sequence.missing and not options.skip_bad:
        raise sequence.absent(sequence.missing[0])


def _folder_or_file(inputs: tuple[Path, ...]) -> str:
    """Return the path that identifies the inputs of a run: the input or, if there are several files, their folder.

    A run can therefore be continued with additional files in the same folder.
    """
    return os.path.realpath(inputs[0] if len(inputs) == 1 else inputs[0].parent)


def _files_read(table_file: Path, inputs: tuple[Path, ...], sequence: FrameSequence, options: RenderOptions) -> FilesUsed:
    """List the files that a rendering reads, except frames from a stream, which may be endless."""
    frames = () if sequence.is_stream else sequence.frames
    files = [frame.source for place, frame in enumerate(frames) if frame.source and sequence.renders(place)]
    return files_to_read({"table": [table_file], "inputs": files or inputs, "dark frames": options.dark})


# ------------------------------------------------------------------------------------------------------------ display

Choice = Callable[[TransformTable, NDArray[np.floating]], Mix | None]  # mix_for or nearest_for


def light_mix_of_given(white: str | None, table: TransformTable, choice: Choice, console: Console) -> Mix | None:
    """Find the mixture of a table's illuminants that matches the option `white`, and report it on the console.

    Parameters
    ----------
    white : str or None
        Name of an illuminant, or a chromaticity "x,y". None for the white of the table.
    table : TransformTable
        The table.
    choice : callable
        Function that chooses the mixture, `mix_for` or `nearest_for`.
    console : Console
        Receives the message.

    Returns
    -------
    Mix or None
        The mixture, or None for the white of the table, which is rendered with the table's common transforms.

    Raises
    ------
    RecipeError
        If the white is unknown.
    """
    if not table.lights:
        return None
    given = given_white(white, table)
    if given is None:
        names = ", ".join(light.name for light in table.lights)
        console.info(
            f"using the transforms trained on all illuminants of the table ({names}); to use the transforms for one "
            "illuminant, set ‹white›"
        )
        return None
    light_mix = choice(table, given.light.xyz)
    assert light_mix is not None
    console.info(f"white {white}: using the transforms for {described(table, light_mix)}")
    return light_mix


def _rendition(destination: Destination, white: str | None, table: TransformTable, options: RenderOptions) -> Rendition:
    """Return the settings that convert the outputs of the table to pictures.

    If the user has set a white, it is checked, which can cause warnings. Raises RecipeError if an option for pictures is
    invalid.
    """
    if options.show is not None:
        return replace(OUTPUTS, bits=options.bits, space=SRGB, polarisation=options.show)
    if not has_display(destination, options):
        return outputs_as_they_are(table)
    require_xyz(table.outputs)
    given = given_white(white, table)
    if white is not None and given is not None:
        warn_of_white(white, given, table, options.console)
    exposure = options.exposure
    rendition = Rendition(
        usual_balance(table) if given is None else given.balance, exposure.factor, options.bits,
        chosen_space(options.space, destination.linear), stops=exposure.stops, stated_exposure=exposure.stated,
        tone=TONES[options.tone] if options.tone else None,
    )  # fmt: skip
    if not destination.raw:
        return rendition
    if options.remosaic not in (None, *MOSAICS):
        raise RecipeError(f'‹remosaic› "{options.remosaic}" is unknown; {suggestion(options.remosaic, MOSAICS)}')
    return replace(rendition, space=replace(REC2020, curve=None), raw=True, mosaic=options.remosaic)


def warn_of_white(name: str, white: SceneWhite, table: TransformTable, console: Console) -> None:
    """Warn if a white point is far from the training illuminants, or if its spectrum does not cover the camera's range."""
    if doubt := far_from_training(name, white, table):
        console.warn(doubt)
    if table.camera is not None and "," not in name:
        from l3cli.simulation.light import named_beyond_known  # imported here to save start-up time

        for doubt in named_beyond_known((name,), table.camera):
            console.warn(doubt)
