"""l3 render: raw frames through a table."""

import functools
import re
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from l3cli.cli import options
from l3cli.cli.clip_tables import clips_result
from l3cli.cli.results import Record, Result
from l3cli.errors import L3Error, shortened
from l3cli.system.signals import Terminated

if TYPE_CHECKING:
    from l3cli.parallel.cluster import Scheduler
    from l3cli.stages.console import Console

PRESETS = ("ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow", "slower", "veryslow")
PHASE = options.Number(0, 65535, "rows or columns", whole=True)
SIZE = options.Number(1, 1_000_000, "pixels", whole=True)
EXPOSURE = options.Number(1e-9, 1e9, "times Y")
STOPS = options.Number(-20, 20, "EV")
FRAME = options.Number(0, 10**18 - 1, whole=True)  # names may hold the time to a microsecond
STEP = options.Number(1, 10**18 - 1, "frames", whole=True)
RATE = options.Number(0.001, 1000, "frames/s")
RATE_PART = options.Number(1, 10**12, whole=True)  # of a rate written as a fraction
LEVEL = options.Number(0, 65535, "DN")
TIME = options.Number(0, 1e5, "s")


def _pair(separator: str, number: options.Number) -> Callable[[Any, Any, str | None], tuple[int, int] | None]:
    """Reads "a<separator>b" as two whole numbers."""

    def read(context: Any, parameter: Any, text: str | None) -> tuple[int, int] | None:
        if text is None:
            return None
        first, has_separator, second = text.partition(separator)
        if not has_separator:
            raise click.BadParameter(f'"{shortened(text)}" is not {parameter.metavar}')
        try:
            return int(number.read(first)), int(number.read(second))
        except click.BadParameter as error:
            raise click.BadParameter(f"{parameter.metavar}: {error.message}") from None

    return read


def _exposure(context: Any, parameter: Any, text: str) -> tuple[float | None, float]:
    """Read a factor of Y, "auto" as None, or stops from the automatic exposure ("+1EV")."""
    if text == "auto":
        return None, 0.0
    if text.lower().endswith("ev"):
        return None, STOPS.read(text[:-2].rstrip())
    try:
        factor = EXPOSURE.read(text)
    except click.BadParameter as error:
        raise click.BadParameter(f"{error.message}, auto, or stops from it such as -1EV") from None
    if text.startswith("+"):  # a factor has no sign: stops may be meant
        raise click.BadParameter(
            f"{text} may be a factor or stops; give {text[1:]} (times Y), or {text}EV (brighter than auto)"
        )
    return factor, 0.0


def _frames(context: Any, parameter: Any, text: str | None) -> range | None:
    """Reads FROM-TO[xSTEP]."""
    if text is None:
        return None
    match = re.fullmatch(r"(\d+)(?:-(\d+))?(?:x(\d+))?", text, re.ASCII)
    if not match:
        raise click.BadParameter(f'"{shortened(text)}" is not {parameter.metavar}, such as 1-500 or 1-500x2')
    first, last = int(FRAME.read(match[1])), int(FRAME.read(match[2] or match[1]))
    step = int(STEP.read(match[3] or "1"))
    if last < first:
        raise click.BadParameter(f"{text} holds no frame; give the lower number first")
    return range(first, last + 1, step)


def _rate(context: Any, parameter: Any, text: str | None) -> Fraction | None:
    """Reads a number or fraction as a rate that videos hold."""
    if text is None:
        return None
    from l3cli.io.video import storable_rate

    above, slash, below = text.partition("/")
    if not slash:
        return storable_rate(Fraction(RATE.read(text)))
    rate = Fraction(int(RATE_PART.read(above)), int(RATE_PART.read(below)))
    RATE.read(repr(float(rate)))
    return storable_rate(rate)


def _refuse_watching(context: Any, parameter: Any, value: str | None) -> None:
    """UsageError for options that there were once."""
    if value is not None:
        raise click.UsageError(
            "--watch is no more; call again for what has arrived: l3 render TABLE.h5 FOLDER -o OUTPUT --resume"
        )


@click.command()
@click.argument("table", type=options.FILE, metavar="TABLE.h5")
@click.argument("inputs", type=options.FILE, nargs=-1, metavar="INPUT...")
@options.output(
    "Picture (.png .tif .jpg .jxl .exr .dng), numbered files (a_%04d.png, a_####.tif), folder, video, or - (y4m to stdout)"
)
@click.option(
    "--format",
    "suffix",
    default="png",
    show_default=True,
    metavar="SUFFIX",
    help="Suffix of the files in a folder; of a video, each INPUT becomes one.",
)
@click.option("--frames", callback=_frames, metavar="FROM-TO[xSTEP]", help="Numbers of the frames to render.")
@click.option("--dataset", metavar="NAME", help="Frames of an HDF5 input [default: its only stack].")
@click.option(
    "--fps", callback=_rate, metavar="RATE", help="Frames a second, 25 or 30000/1001 [default: the input's or 30]."
)
@click.option(
    "--codec",
    type=click.Choice(["h264", "h265", "ffv1", "prores"]),
    help="Codec of a video [default: .mp4 h264, .mov prores, .mkv ffv1].",
)
@click.option(
    "--crf",
    type=options.Number(0, 51),
    metavar="0…51",
    help="Rate factor of h264, h265; lower is better [default: the encoder's].",
)
@click.option(
    "--preset", type=click.Choice(PRESETS), default="veryfast", show_default=True, metavar="NAME",
    help=f"Effort of h264, h265: {', '.join(PRESETS)}.",
)  # fmt: skip
@options.backend
@options.device
@options.variant
@click.option(
    "--exposure",
    default="auto",
    callback=_exposure,
    metavar="auto|VALUE|±NEV",
    show_default=True,
    help="Factor of Y; what it brings to 1 is shown white. +1EV: twice as bright as auto.",
)
@click.option(
    "--white",
    metavar="NAME|x,y|camera|auto|chart|ROW,COL[,SIZE]",
    help="Scene white shown neutral: light, chromaticity, the file's, estimated, a ColorChecker's, a grey's pixels "
    "[default: table's].",
)
@click.option(
    "--space", type=click.Choice(["srgb", "display-p3", "rec2020", "acescg", "xyz"]),
    help="Colour space [default: srgb; of .exr and 32 bits the table's outputs as they are].",
)  # fmt: skip
@click.option(
    "--remosaic", type=click.Choice(["bayer"]),
    help="Mosaic of a .dng [default: all three channels at every pixel].",
)  # fmt: skip
@click.option(
    "--bits", type=click.Choice(["8", "16", "32"]), default="8", show_default=True,
    help="Bits a value of a picture; 32: linear, floating point (.tif).",
)  # fmt: skip
@click.option(
    "--black-level", type=LEVEL, metavar="DN", help="Black level of the inputs [default: the file's or the table's]."
)
@click.option("--white-level", type=LEVEL, metavar="DN", help="White level of the inputs [default: the file's or table's].")
@click.option(
    "--exposure-time", type=TIME, metavar="SECONDS",
    help="Exposure time of the inputs, for subtracting dark current [default: the file's or the training's].",
)  # fmt: skip
@click.option(
    "--dark", type=options.FILE, multiple=True, metavar="FRAME",
    help="Dark frames of the same exposure time, files or a sequence; their mean is subtracted. May be repeated.",
)  # fmt: skip
@click.option(
    "--camera",
    type=options.FILE,
    metavar="CAMERA.h5",
    help="Camera model, or table of one, whose defects and flat field are corrected.",
)
@click.option(
    "--hot", type=click.Choice(["auto", "off"]), default="off", show_default=True,
    help="Hot pixels that no camera model lists: find and mend them in each frame.",
)  # fmt: skip
@click.option("--phase", callback=_pair(",", PHASE), metavar="ROW,COL", help="CFA site of the inputs' first pixel, from 0.")
@click.option(
    "--size", callback=_pair("x", SIZE), metavar="ROWSxCOLS", help="Pixels of headerless inputs [default: the table's]."
)
@click.option(
    "--packing", type=click.Choice(["u16", "raw10", "raw12"]),
    help="Packing of headerless inputs: 16 bits, or MIPI [default: .raw10 and .raw12 MIPI, else u16].",
)  # fmt: skip
@click.option(
    "--stride",
    type=options.Number(1, 100_000_000, "bytes", whole=True),
    metavar="BYTES",
    help="Bytes from row to row [default: no padding].",
)
@click.option(
    "--temporal", is_flag=True, help="Frames follow one another in time: blend each with what is not noise of those before."
)
@click.option(
    "--shard", callback=options.shard, metavar="I/N",
    help="Render only part I of N, from 1, of a sequence, to the same pictures as a run over all of it.",
)  # fmt: skip
@click.option("--skip-bad", is_flag=True, help="Leave out missing and broken frames; exit code 1 if there were any.")
@click.option(
    "--resume",
    is_flag=True,
    help="Continue a sequence of pictures where a run was stopped; of many clips render what is new or changed.",
)
@click.option(
    "--watch", "--every", hidden=True, is_eager=True, expose_value=False, callback=_refuse_watching,
    help="No more: --resume renders what has arrived in a folder.",
)  # fmt: skip
@options.scheduler
@options.trust
@options.force
@options.dry_run
@options.quiet
def render(
    table: Path, inputs: tuple[Path, ...], output: Path, suffix: str, frames: range | None, dataset: str | None,
    fps: Fraction | None, codec: str | None, crf: float | None, preset: str, backend: str, device: str | None,
    variant: str | None, exposure: tuple[float | None, float], white: str | None, space: str | None, remosaic: str | None,
    bits: str, black_level: float | None, white_level: float | None, exposure_time: float | None, dark: tuple[Path, ...],
    camera: Path | None, hot: str,
    phase: tuple[int, int] | None, size: tuple[int, int] | None, packing: str | None,
    stride: int | None, temporal: bool, shard: tuple[int, int] | None, skip_bad: bool, resume: bool,
    scheduler: "Scheduler | None", force: bool, console: "Console",
) -> Result:  # fmt: skip
    """Render INPUT through TABLE.h5: files (DNG, camera raw, one-channel TIFF, PNG or PGM, FITS, .npy, headerless .raw,
    .bin, .raw10 or .raw12), or a sequence: a folder, a pattern (a_%04d.tif, a_####.tif), a quoted glob, a stack (.npy, HDF5,
    FITS), a headerless file of many frames, a grey video (FFV1 in MKV), or - (headerless frames on stdin).

    Several INPUTs of which one is a sequence are clips, and so is what lies in a folder of videos, stacks and folders: each
    becomes a folder or file of its name in the folder -o, and what is wrong with one does not stop the others (exit code 1).
    With --resume the same call renders what has been added or changed since.

    With --exposure auto the 99th percentile of Y is shown white, smoothed over time in a sequence.

    \b
    Example: l3 render table.h5 frame.dng -o picture.png
    """
    if Record.current is not None and output == Path("-"):
        raise click.UsageError("-o - writes pictures to stdout, where --json goes; name a file or leave --json out")
    from l3cli.io.isolated import start
    from l3cli.io.raw.registry import is_photo, needs_isolation

    if is_photo(table):
        from l3cli.stages.photo_start import refuse_as_table

        refuse_as_table(table, inputs, output)
    if not inputs:
        raise click.UsageError("Missing argument 'INPUT...'.")
    if any(needs_isolation(path) for path in inputs):
        start()  # it takes a third of a second, like what follows
    from l3cli.io.raw.files import RawOverrides
    from l3cli.stages.rendering.clip_inputs import are_clips, clips_of
    from l3cli.stages.rendering.clips import ClipJob, alone
    from l3cli.stages.rendering.render import render as stage

    known = RawOverrides(black_level, white_level, phase, size, packing, stride, exposure_time)
    render_one = functools.partial(
        stage, table, rate=fps, bits=int(bits), codec=codec, crf=crf, preset=preset, suffix=suffix,
        frames=frames, dataset=dataset, known=known, dark=dark, camera=camera, hot=hot == "auto", exposure=exposure[0],
        stops=exposure[1], white=white, space=space, remosaic=remosaic, backend=backend, device=device, variant=variant,
        skip_bad=skip_bad, scheduler=scheduler, temporal=temporal,
    )  # fmt: skip
    clips = clips_of(inputs, table, known, output, console)
    if clips == inputs and not are_clips(inputs, output, suffix):
        render_one = functools.partial(render_one, shard=shard)
        return clips_result(alone(render_one, inputs, output, console, resume, force))
    if shard is not None:
        raise click.UsageError("--shard divides one sequence; these inputs are several clips")
    job = ClipJob(table, output, suffix, render_one, console, force=force)
    try:
        job.run(clips, resume)
    except (L3Error, KeyboardInterrupt, Terminated) as ended:
        if not job.summary.clips:
            raise
        return clips_result(job.summary, ended)
    return clips_result(job.summary, show_text=True)
