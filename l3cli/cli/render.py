"""l3 render: raw frames through a table."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from l3cli.cli import options as declared
from l3cli.cli.results import Record, Result
from l3cli.cli.terminal import show_table, with_options
from l3cli.errors import L3Error
from l3cli.options.render import RenderOptions
from l3cli.system.signals import Terminated

if TYPE_CHECKING:
    from l3cli.stages.rendering.clips import Summary


def _refuse_watching(context: Any, parameter: Any, value: str | None) -> None:
    """Raise UsageError for options that there were once."""
    if value is not None:
        raise click.UsageError(
            "--watch is no more; call again for what has arrived: l3 render TABLE.h5 FOLDER -o OUTPUT --resume"
        )


@click.command()
@click.argument("table", type=declared.FILE, metavar="TABLE.h5")
@click.argument("inputs", type=declared.FILE, nargs=-1, metavar="INPUT...")
@declared.output(
    "Picture (.png .tif .jpg .jxl .exr .dng), numbered files (a_%04d.png, a_####.tif), folder, video, or - (y4m to stdout)"
)
@declared.of(RenderOptions, declared.trust, declared.dry_run)
@click.option(
    "--watch", "--every", hidden=True, is_eager=True, expose_value=False, callback=_refuse_watching,
    help="No more: --resume renders what has arrived in a folder.",
)  # fmt: skip
def render(table: Path, inputs: tuple[Path, ...], output: Path, options: RenderOptions) -> Result:
    """Render INPUT through TABLE.h5: files (DNG, camera raw, one-channel TIFF, PNG or PGM, FITS, .npy, headerless .raw,
    .bin, .raw10 or .raw12), or a sequence: a folder, a pattern (a_%04d.tif, a_####.tif), a quoted glob, a stack (.npy, HDF5,
    FITS, MATLAB), a headerless file of many frames, SER, a grey video (FFV1 in MKV, y4m, uncompressed AVI), or - (headerless
    frames on stdin).

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
    from l3cli.io.raw.files import is_photo, needs_isolation

    if is_photo(table):
        from l3cli.stages.starting import refuse_as_table

        refuse_as_table(table, inputs, output)
    if not inputs:
        raise click.UsageError("Missing argument 'INPUT...'.")
    if any(needs_isolation(path) for path in inputs):
        start()  # it takes a third of a second, like what follows
    from l3cli.stages.rendering.clips import ClipJob, alone, are_clips, clips_of

    clips = clips_of(inputs, table, options, output)
    if clips == inputs and not are_clips(inputs, table, options, output):
        return clips_result(alone(table, inputs, output, options))
    if options.shard is not None:
        raise click.UsageError("--shard divides one sequence; these inputs are several clips")
    job = ClipJob(table, output, options)
    try:
        job.run(clips)
    except (L3Error, KeyboardInterrupt, Terminated) as ended:
        if not job.summary.clips:
            raise
        return clips_result(job.summary, ended)
    return clips_result(job.summary, show_text=True)


def clips_result(summary: "Summary", fault: BaseException | None = None, show_text: bool = False) -> Result:
    """Return the result of l3 render; with `show_text`, or where `fault` ended a run over many clips, with a table."""
    document = _worded(summary.document())
    text = (lambda: _table(document)) if show_text or fault else None
    return Result(document, text, fault, summary.exit_code)


def _worded(value: Any) -> Any:
    """Return a document in which messages name options."""
    if isinstance(value, dict):
        return {key: _worded(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_worded(each) for each in value]
    return with_options(value) if isinstance(value, str) else value


def _table(document: dict[str, Any]) -> None:
    rows = []
    for clip in document["clips"]:
        rate = "" if clip["frames_per_s"] is None else f"{clip['frames_per_s']:.3g}"
        counts = [str(clip["frames"]), rate, str(clip["left_out"]), str(len(clip["warnings"]))]
        rows.append([clip["clip"], clip["output"], *counts, clip["state"]])
    states = ", ".join(f"{document[f'clips_{state}']} {state}" for state in ("rendered", "kept", "failed"))
    total = f"clips: {states}; frames: {document['frames']}, {document['left_out']} left out"
    show_table([], ["clip", "output", "frames", "frames/s", "left out", "warnings", ""], rows, total)
