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
from l3cli.importing import without_collecting
from l3cli.interrupts import Terminated
from l3cli.stages.plan import is_dry

if TYPE_CHECKING:
    from l3cli.parallel.cluster import Scheduler
    from l3cli.stages.console import Console

PRESETS = ("ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow", "slower", "veryslow")


PHASE = options.Number(0, 65535, "rows or columns", whole=True)
SIZE = options.Number(1, 1_000_000, "pixels", whole=True)
EXPOSURE = options.Number(1e-9, 1e9, "times Y")
FRAME = options.Number(0, 10**18 - 1, whole=True)  # names may hold the time to a microsecond
STEP = options.Number(1, 10**18 - 1, "frames", whole=True)
RATE = options.Number(0.001, 1000, "frames/s")
RATE_PART = options.Number(1, 10**12, whole=True)  # of a rate written as a fraction
LEVEL = options.Number(0, 65535, "DN")
TIME = options.Number(0, 1e5, "s")
EVERY = options.Number(0.1, 86400, "s")
USUAL_EVERY = 2.0  # s


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


def _exposure(context: Any, parameter: Any, text: str) -> float | None:
    """Reads a number, or "auto" as None."""
    try:
        return None if text == "auto" else EXPOSURE.read(text)
    except click.BadParameter as error:
        raise click.BadParameter(f"{error.message}, or auto") from None


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
    metavar="auto|VALUE",
    show_default=True,
    help="Factor of Y; what it brings to 1 is shown white.",
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
@click.option("--resume", is_flag=True, help="Continue a sequence of pictures, or many clips, where a run was stopped.")
@click.option(
    "--watch", "watched", type=options.FILE, metavar="FOLDER",
    help="Instead of INPUT: render whatever arrives whole in FOLDER, until Ctrl-C.",
)  # fmt: skip
@click.option(
    "--every", type=EVERY, metavar="SECONDS",
    help="Time between two looks at --watch's folder; what did not change in it is whole [default: 2].",
)  # fmt: skip
@options.scheduler
@options.trust
@options.force
@options.dry_run
@options.quiet
def render(
    table: Path, inputs: tuple[Path, ...], output: Path, suffix: str, frames: range | None, dataset: str | None,
    fps: Fraction | None, codec: str | None, crf: float | None, preset: str, backend: str, device: str | None,
    variant: str | None, exposure: float | None, white: str | None, space: str | None, remosaic: str | None,
    bits: str, black_level: float | None, white_level: float | None, exposure_time: float | None, dark: tuple[Path, ...],
    camera: Path | None, hot: str,
    phase: tuple[int, int] | None, size: tuple[int, int] | None, packing: str | None,
    stride: int | None, temporal: bool, shard: tuple[int, int] | None, skip_bad: bool, resume: bool, watched: Path | None,
    every: float | None, scheduler: "Scheduler | None", force: bool, console: "Console",
) -> Result:  # fmt: skip
    """Render INPUT through TABLE.h5: files (DNG, camera raw, one-channel TIFF, PNG or PGM, FITS, .npy, headerless .raw,
    .bin, .raw10 or .raw12), or a sequence: a folder, a pattern (a_%04d.tif, a_####.tif), a quoted glob, a stack (.npy, HDF5,
    FITS), a headerless file of many frames, a grey video (FFV1 in MKV), or - (headerless frames on stdin).

    Several INPUTs of which one is a sequence are clips: each becomes a folder or file of its name in the folder -o, and what
    is wrong with one does not stop the others (exit code 1).

    With --exposure auto the 99th percentile of Y is shown white, smoothed over time in a sequence.

    \b
    Example: l3 render table.h5 frame.dng -o picture.png
    """
    _refuse_contradictions(inputs, output, watched, every, shard)
    from l3cli.io.apart import start
    from l3cli.io.raw.registry import needs_sandbox

    if any(needs_sandbox(path) for path in inputs):
        start()  # it takes a third of a second, like what follows
    with without_collecting():
        from l3cli.io.raw.files import KnownBetter
        from l3cli.stages.rendering.clips import ClipJob, alone, are_clips
        from l3cli.stages.rendering.render import render as stage

    known = KnownBetter(black_level, white_level, phase, size, packing, stride, exposure_time)
    render_one = functools.partial(
        stage, table, rate=fps, bits=int(bits), codec=codec, crf=crf, preset=preset, suffix=suffix,
        frames=frames, dataset=dataset, known=known, dark=dark, camera=camera, hot=hot == "auto", exposure=exposure,
        white=white, space=space, remosaic=remosaic, backend=backend, device=device, variant=variant, skip_bad=skip_bad,
        scheduler=scheduler, temporal=temporal,
    )  # fmt: skip
    if watched is None and not are_clips(inputs, output, suffix):
        render_one = functools.partial(render_one, shard=shard)
        return clips_result(alone(render_one, inputs, output, console, resume, force))
    if shard is not None:
        raise click.UsageError("--shard divides one sequence; these inputs are several clips")
    job = ClipJob(table, output, suffix, render_one, console, force=force)
    try:
        if watched is None:
            job.run(inputs, resume)
        else:
            from l3cli.stages.rendering.watch import watch

            watch(job, watched, USUAL_EVERY if every is None else every)
    except (L3Error, KeyboardInterrupt, Terminated) as ended:
        if not job.summary.clips:
            raise
        return clips_result(job.summary, ended)
    return clips_result(job.summary, show_text=True)


def _refuse_contradictions(
    inputs: tuple[Path, ...], output: Path, watched: Path | None, every: float | None, shard: tuple[int, int] | None
) -> None:
    """UsageError if what is asked for cannot go together."""
    if bool(inputs) == (watched is not None):
        raise click.UsageError("give either INPUTs or --watch FOLDER")
    if every is not None and watched is None:
        raise click.UsageError("--every goes with --watch")
    if watched is not None and is_dry():
        raise click.UsageError("--watch never ends, so a dry run cannot say what it makes; leave one of them out")
    if watched is not None and shard is not None:
        raise click.UsageError("--shard divides one sequence; leave it or --watch out")
    if Record.current is not None and output == Path("-"):
        raise click.UsageError("-o - writes pictures to stdout, where --json goes; name a file or leave --json out")
