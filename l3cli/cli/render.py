"""l3 render: renders raw frames to pictures with a table."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from l3cli.cli import options as declared
from l3cli.cli.results import Record, Result
from l3cli.cli.terminal import show_table, with_options
from l3cli.errors import L3Error
from l3cli.options.render import RenderOptions
from l3cli.system.files import all_files

if TYPE_CHECKING:
    from l3cli.stages.rendering.clips import Summary


@click.command()
@click.argument("table", type=declared.FILE, metavar="TABLE.h5")
@click.argument("inputs", type=declared.FILE, nargs=-1, metavar="INPUT...")
@declared.output(
    "Picture to write (.png .tif .jpg .jxl .exr .dng), numbered files (a_%04d.png, a_####.tif), folder, video, or - for y4m "
    "on stdout"
)
@declared.of(RenderOptions, declared.trust)
def render(table: Path, inputs: tuple[Path, ...], output: Path, options: RenderOptions) -> Result:
    """Render INPUT with TABLE.h5. INPUT is one or more raw files, or one sequence.

    Files: DNG, camera raw, one-channel TIFF, PNG or PGM, FITS, .npy, or headerless .raw, .bin, .raw10 or .raw12.
    Sequences: a folder, a pattern (a_%04d.tif, a_####.tif), a quoted glob, a stack (.npy, HDF5, FITS, MATLAB), a
    headerless file with many frames, SER, a grey video (FFV1 in MKV, y4m, uncompressed AVI), or - (headerless frames on
    stdin).

    If you specify several INPUTs and one of them is a sequence, each INPUT is a clip. If an INPUT folder contains videos,
    stacks or folders, each of them is a clip. l3 renders every clip to a folder or file with the same name in the output
    folder. If a clip fails, l3 still renders the remaining clips (exit code 1). To render only files that were added or
    changed since, run the same command with --resume.

    With --exposure auto, the 99th percentile of Y is rendered as white. In a sequence, the exposure changes smoothly over
    time.

    If --skip-bad skips a frame, the exit code is 1.

    \b
    Example: l3 render table.h5 frame.dng -o picture.png
    """
    if click.get_current_context().ensure_object(Record).as_json and output == Path("-"):
        raise click.UsageError("--json and -o - both write to stdout; specify an output file or remove --json")
    from l3cli.io.isolated import start
    from l3cli.io.raw.files import is_photo, needs_isolation

    if is_photo(table):
        from l3cli.stages.starting import refuse_as_table

        refuse_as_table(table, inputs, output)
    if not inputs:
        raise click.UsageError("Missing argument 'INPUT...'.")
    if any(needs_isolation(path) for path in inputs):
        start()  # start the isolated process while the following imports run; both take about a third of a second
    from l3cli.stages.rendering.clips import Summary, are_clips, clips_of, render_clips, render_one

    clips = clips_of(inputs, table, options, output)
    if clips == inputs and not are_clips(inputs, table, options, output):
        return clips_result(render_one(table, inputs, output, options))
    if options.shard is not None:
        raise click.UsageError(
            "--shard works only for one sequence, but there are several input clips; render the clips one by one"
        )
    summary = Summary()
    try:
        render_clips(table, clips, output, options, summary)
    except (L3Error, KeyboardInterrupt) as ended:
        if not summary.clips:
            raise
        return clips_result(summary, ended)
    return clips_result(summary, show_text=True)


def clips_result(summary: "Summary", fault: BaseException | None = None, show_text: bool = False) -> Result:
    """Return the result of `l3 render`.

    `fault` is the error or interruption that ended the command before all clips were rendered. It is None if all clips were
    rendered. If there is a fault, or if `show_text` is true, a table of the clips is printed.
    """
    document = _worded(summary.document())
    text = (lambda: _table(document)) if show_text or fault else None
    return Result(document, text, fault, summary.exit_code, all_files(summary.files))


def _worded(value: Any) -> Any:
    """Replace parameters such as ‹skip_bad› in all messages of a document by options such as --skip-bad."""
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
    total = f"clips: {states}; frames: {document['frames']}, {document['left_out']} skipped"
    show_table([], ["clip", "output", "frames", "frames/s", "skipped", "warnings", ""], rows, total)
