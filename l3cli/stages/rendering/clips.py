"""Rendering of several clips with one command.

Each clip is rendered separately. If a clip fails, the remaining clips are still rendered.
"""

import contextlib
import functools
import os
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.errors import DeviceError, InputFileError, L3Error, RecipeError
from l3cli.io.destination import destination_of
from l3cli.io.file_names import PATTERN, clips_in, name_of, refuse_one_name
from l3cli.io.raw.files import RawOverrides, holds_several
from l3cli.io.sequences import frame_files, is_one_file, is_still
from l3cli.io.video import is_video
from l3cli.options.render import RenderOptions
from l3cli.stages.rendering.job import stated_overrides, video_choice
from l3cli.stages.rendering.pictures import Renderers
from l3cli.stages.rendering.render import render
from l3cli.stages.rendering.reports import Tally
from l3cli.system.console import Gathering
from l3cli.system.files import FULL, STDIN, FilesUsed, dated, refuse_existing, refuse_filled_folder
from l3cli.system.outputs import OutputGuard, refuse_unwritable

RENDERED, KEPT, FAILED = "rendered", "kept", "failed"  # outcome of a clip; "kept": finished by an earlier run
MAX_WARNINGS = 1000  # maximum number of warnings in the report of a clip


def clips_of(inputs: Sequence[Path], table: Path, options: RenderOptions, output: Path) -> tuple[Path, ...]:
    """Replace each input that is a folder of clips by the clips in the folder.

    Raises
    ------
    RecipeError
        If a folder of clips contains the output, or if the output contains a folder of clips.
    """
    clips: list[Path] = []
    sensor = functools.partial(load, TransformTable, table)
    for each in inputs:
        inside = clips_in(each, sensor, stated_overrides(options), options.console.warn) if each.is_dir() else []
        source, target = (Path(os.path.realpath(path)) for path in (each, output))  # realpath accepts circular links
        if inside and (source in (target, *target.parents) or target in source.parents):
            raise RecipeError(
                f"the output {output} and the folder of clips {each} must not contain each other; choose another output "
                "folder"
            )
        clips += [path for path in inside if os.path.realpath(path) != os.path.realpath(table)] or [each]
    return tuple(clips)


def are_clips(inputs: Sequence[Path], table: Path, options: RenderOptions, output: Path) -> bool:
    """Return whether each input is a separate clip.

    This is the case if there are several inputs and at least one is a sequence, or if the output is a folder of videos.
    Otherwise, several files with one frame each are rendered together.
    """
    if is_video(Path(f"clip.{options.format}")) and not is_video(output):
        return True
    sensor, known = functools.cache(functools.partial(load, TransformTable, table)), stated_overrides(options)
    return len(inputs) > 1 and any(not is_one_file(path) or _is_stack(path, sensor, known) for path in inputs)


def _is_stack(path: Path, sensor: Callable[[], TransformTable], known: RawOverrides) -> bool:
    """Return whether a file contains several frames. Unreadable files count as False, and are reported later."""
    with contextlib.suppress(L3Error, OSError):
        return path.is_file() and holds_several(path, sensor, known)
    return False


@dataclass
class ClipReport:
    """Outcome of a clip."""

    clip: str
    output: str
    state: str  # RENDERED, KEPT or FAILED
    frames: int = 0  # number of frames whose pictures exist
    left_out: int = 0  # number of frames that were skipped because of errors
    seconds: float = 0.0
    frames_per_s: float | None = None
    frame_times: str | None = None  # Tally.frame_times
    warnings: list[str] = field(default_factory=list)
    error: str | None = None


@dataclass
class Summary:
    """Outcome of all clips so far."""

    clips: list[ClipReport] = field(default_factory=list)
    first_error_code: int | None = None  # exit code for the error of the first failed clip
    files: list[FilesUsed] = field(default_factory=list)  # files of each rendered clip

    def add(self, clip: str, output: Path, tally: Tally, warnings: list[str]) -> None:
        """Add a clip that was rendered."""
        state = RENDERED if tally.made else KEPT
        rate = tally.done / tally.seconds if tally.seconds else None
        counts = tally.done, tally.failures, tally.seconds, rate, tally.frame_times
        self.clips.append(ClipReport(clip, str(output), state, *counts, warnings))
        self.files.append(tally.files)

    def fail(self, clip: str, output: Path, error: L3Error | OSError, message: str, warnings: list[str]) -> None:
        """Add a clip that failed."""
        self.first_error_code = self.first_error_code or getattr(error, "exit_code", 1)
        self.clips.append(ClipReport(clip, str(output), FAILED, warnings=warnings, error=message))

    @property
    def exit_code(self) -> int:
        """Exit code: 0 if all frames were rendered, the code of the first error if all clips failed, otherwise 1."""
        states = {clip.state for clip in self.clips}
        if self.first_error_code is not None and states == {FAILED}:
            return self.first_error_code
        return 1 if FAILED in states or any(clip.left_out for clip in self.clips) else 0

    def document(self) -> dict[str, Any]:
        """Return the outcome as JSON data."""
        counts = Counter(clip.state for clip in self.clips)
        return {
            "clips": [asdict(clip) for clip in self.clips],
            **{f"clips_{state}": counts[state] for state in (RENDERED, KEPT, FAILED)},
            "frames": sum(clip.frames for clip in self.clips),
            "left_out": sum(clip.left_out for clip in self.clips),
        }


def render_one(table: Path, inputs: tuple[Path, ...], output: Path, options: RenderOptions) -> Summary:
    """Render one clip as `render` does, and return a summary."""
    gathering, summary = Gathering(options.console, MAX_WARNINGS), Summary()
    tally = render(table, inputs, output, replace(options, console=gathering))
    name = str(inputs[0]) if len(inputs) == 1 else f"{inputs[0]} and {len(inputs) - 1} more"
    summary.add(name, output, tally, gathering.warnings)
    return summary


def render_clips(table: Path, clips: Sequence[Path], folder: Path, options: RenderOptions, summary: Summary) -> None:
    """Render each clip to a file or folder with the name of the clip.

    A clip with an error is reported and skipped.

    Parameters
    ----------
    table : Path
        File of the transform table.
    clips : sequence of Path
        The inputs.
    folder : Path
        Folder of the outputs.
    options : RenderOptions
        Options of `l3 render`.
    summary : Summary
        Receives the outcome of each clip.

    Raises
    ------
    RecipeError
        Before any work, if `folder` or `options` are unsuitable for clips, or if two clips have the same name. During the
        run, if the table changes.
    L3Error
        Before any work, if an output exists, unless `resume` or `force` is set. During the run, if the disk is full.
    DeviceError
        If the OpenCL device cannot be used.
    """
    _refuse_folder(folder, options)
    sources = list(dict.fromkeys(clips))
    refuse_one_name(sources)
    sensor, table_state = load(TransformTable, table), dated(table)
    renderers = Renderers()
    with OutputGuard(options.console) as guard:
        guard.protect(table)
        for source in sources:
            with contextlib.suppress(InputFileError, OSError):  # the error is reported later, when this clip is rendered
                guard.protect(*frame_files(source))
                _refuse_output(_output_of(source, folder, sensor, options), options)
        for number, source in enumerate(sources, 1):
            options.console.info(f"clip {number} of {len(sources)}: {source}")
            if dated(table) != table_state:
                raise RecipeError(f"{table} has changed during the run; start the run again")
            _render_clip(table, sensor, source, folder, options, renderers, summary)


def _refuse_folder(folder: Path, options: RenderOptions) -> None:
    """Raise RecipeError if the output is not a folder or an option is unsuitable for clips.

    Raises L3Error if files cannot be created in the folder.
    """
    if folder == STDIN or is_video(folder) or PATTERN.search(folder.name) or folder.is_file():
        raise RecipeError(
            f"the output {folder} can contain only one clip; specify a folder, and set ‹format› to the file type of the "
            "videos"
        )
    if options.uncertainty is not None:
        raise RecipeError("‹uncertainty› works only for a single frame; render one frame, or remove ‹uncertainty›")
    destination_of(folder / f"clip.{options.format}", options.format, video_choice(options), options.shard)
    refuse_unwritable(folder)


def _output_of(source: Path, folder: Path, table: TransformTable, options: RenderOptions) -> Path:
    """Return the output file or output folder of a clip.

    Raises
    ------
    InputFileError
        If the output depends on the content of the clip, and the clip cannot be read.
    """
    name = name_of(source)
    if is_video(Path(f"clip.{options.format}")) or is_still(source, table, stated_overrides(options)):
        return folder / f"{name}.{options.format}"
    return folder / name.replace(".", "_")  # l3 would treat a name that contains a period as a file


def _refuse_output(output: Path, options: RenderOptions) -> None:
    """Raise L3Error if a clip's output exists, unless the options permit continuing or replacing it."""
    if options.resume or options.force:
        return
    (refuse_existing if output.suffix else refuse_filled_folder)(output, force=False)


def _render_clip(
    table: Path, sensor: TransformTable, source: Path, folder: Path, options: RenderOptions, renderers: Renderers,
    summary: Summary,
) -> None:  # fmt: skip
    """Render a clip and add its outcome to the summary.

    Errors become part of the summary. They are raised only if they affect all clips, such as a missing device or a full
    disk.
    """
    output, gathering = folder / name_of(source), Gathering(options.console, MAX_WARNINGS)
    try:
        output = _output_of(source, folder, sensor, options)
        tally = render(table, (source,), output, replace(options, console=gathering), renderers)
    except (L3Error, OSError) as error:
        renderers.forget()
        cause = error if isinstance(error, OSError) else error.__cause__
        if isinstance(error, DeviceError) or (isinstance(cause, OSError) and cause.errno in FULL):
            raise
        message = f"{error.filename or source}: {error.strerror}" if isinstance(error, OSError) else str(error)
        options.console.report(f"l3: {source}: {message}" if str(source) not in message else f"l3: {message}")
        summary.fail(str(source), output, error, message, gathering.warnings)
        return
    if output.suffix and tally.made == 1:  # for sequences, `render` has already reported the speed
        options.console.info(f"{output}: rendered in {tally.seconds:.2g} s")
    summary.add(str(source), output, tally, gathering.warnings)
