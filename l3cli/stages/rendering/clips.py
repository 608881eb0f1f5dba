"""Many clips in one call: each is rendered as if it were alone, and an error in one does not stop the others."""

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

RENDERED, KEPT, FAILED = "rendered", "kept", "failed"  # states of a clip
MAX_WARNINGS = 1000  # largest number of warnings in the report of a clip


def clips_of(inputs: Sequence[Path], table: Path, options: RenderOptions, output: Path) -> tuple[Path, ...]:
    """Return the inputs, with folders of clips replaced by their clips.

    Raises
    ------
    RecipeError
        If such a folder contains the output, or the output the folder.
    """
    clips: list[Path] = []
    sensor = functools.partial(load, TransformTable, table)
    for each in inputs:
        inside = clips_in(each, sensor, stated_overrides(options), options.console.warn) if each.is_dir() else []
        source, target = (Path(os.path.realpath(path)) for path in (each, output))  # resolves even a loop of links
        if inside and (source in (target, *target.parents) or target in source.parents):
            raise RecipeError(f"one of {output} and {each} contains the other; name an output elsewhere")
        clips += [path for path in inside if os.path.realpath(path) != os.path.realpath(table)] or [each]
    return tuple(clips)


def are_clips(inputs: Sequence[Path], table: Path, options: RenderOptions, output: Path) -> bool:
    """Return whether each input is a clip of its own.

    This is so if there are several inputs and one of them is a sequence, or if videos are to be written into a folder.
    Several files with one frame each are a single job.
    """
    if is_video(Path(f"clip.{options.format}")) and not is_video(output):
        return True
    sensor, known = functools.cache(functools.partial(load, TransformTable, table)), stated_overrides(options)
    return len(inputs) > 1 and any(not is_one_file(path) or _is_stack(path, sensor, known) for path in inputs)


def _is_stack(path: Path, sensor: Callable[[], TransformTable], known: RawOverrides) -> bool:
    """Return whether a file has several frames. Errors in the file are reported when it is rendered."""
    with contextlib.suppress(L3Error, OSError):
        return path.is_file() and holds_several(path, sensor, known)
    return False


@dataclass
class ClipReport:
    """Outcome of a clip."""

    clip: str
    output: str
    state: str  # RENDERED, KEPT from an earlier run, or FAILED
    frames: int = 0
    left_out: int = 0  # frames
    seconds: float = 0.0
    frames_per_s: float | None = None
    frame_times: str | None = None  # as in Tally
    warnings: list[str] = field(default_factory=list)
    error: str | None = None


@dataclass
class Summary:
    """Outcome of all clips so far."""

    clips: list[ClipReport] = field(default_factory=list)
    first_error_code: int | None = None  # exit code of the first clip that failed
    files: list[FilesUsed] = field(default_factory=list)  # of each rendered clip

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
        """0 if every frame of every clip was rendered, otherwise 1, or the code of the first error if all clips failed."""
        states = {clip.state for clip in self.clips}
        if self.first_error_code is not None and states == {FAILED}:
            return self.first_error_code
        return 1 if FAILED in states or any(clip.left_out for clip in self.clips) else 0

    def document(self) -> dict[str, Any]:
        """Return the outcome, ready for JSON."""
        counts = Counter(clip.state for clip in self.clips)
        return {
            "clips": [asdict(clip) for clip in self.clips],
            **{f"clips_{state}": counts[state] for state in (RENDERED, KEPT, FAILED)},
            "frames": sum(clip.frames for clip in self.clips),
            "left_out": sum(clip.left_out for clip in self.clips),
        }


def render_one(table: Path, inputs: tuple[Path, ...], output: Path, options: RenderOptions) -> Summary:
    """Render one clip, or several files of one frame each. Errors are those of `render`."""
    gathering, summary = Gathering(options.console, MAX_WARNINGS), Summary()
    tally = render(table, inputs, output, replace(options, console=gathering))
    name = str(inputs[0]) if len(inputs) == 1 else f"{inputs[0]} and {len(inputs) - 1} more"
    summary.add(name, output, tally, gathering.warnings)
    return summary


def render_clips(table: Path, clips: Sequence[Path], folder: Path, options: RenderOptions, summary: Summary) -> None:
    """Render each clip to a file or folder of its name. Errors in a clip are reported, and the others are rendered.

    Parameters
    ----------
    table : Path
    clips : sequence of Path
        The inputs.
    folder : Path
        Folder of the outputs.
    options : RenderOptions
    summary : Summary
        Receives the outcome of each clip.

    Raises
    ------
    RecipeError
        Before any work, if the folder or the options do not fit clips, or if two clips have the same name. Later, if the
        table changes.
    L3Error
        Before any work, if an output exists, unless `resume` or `force` is set. Later, if the disk is full.
    DeviceError
        If nothing can be rendered.
    """
    _refuse_folder(folder, options)
    sources = list(dict.fromkeys(clips))
    refuse_one_name(sources)
    sensor, table_state = load(TransformTable, table), dated(table)
    renderers = Renderers()
    with OutputGuard(options.console) as guard:
        guard.protect(table)
        for source in sources:
            with contextlib.suppress(InputFileError, OSError):  # reported when this clip is rendered
                guard.protect(*frame_files(source))
                _refuse_output(_output_of(source, folder, sensor, options), options)
        for number, source in enumerate(sources, 1):
            options.console.info(f"clip {number} of {len(sources)}: {source}")
            if dated(table) != table_state:
                raise RecipeError(f"{table} has changed since the run began; start the run again")
            _render_clip(table, sensor, source, folder, options, renderers, summary)


def _refuse_folder(folder: Path, options: RenderOptions) -> None:
    """Refuse an output that is not a folder, and options that do not fit clips."""
    if folder == STDIN or is_video(folder) or PATTERN.search(folder.name) or folder.is_file():
        raise RecipeError(f"{folder} is for one clip; name a folder, and give the type of its files with ‹format›")
    if options.uncertainty is not None:
        raise RecipeError("‹uncertainty› needs a single frame; give one frame, or leave it out")
    destination_of(folder / f"clip.{options.format}", options.format, video_choice(options), options.shard)
    refuse_unwritable(folder)


def _output_of(source: Path, folder: Path, table: TransformTable, options: RenderOptions) -> Path:
    """Return the file or folder of a clip. Raises InputFileError if the clip must be read for this and cannot be."""
    name = name_of(source)
    if is_video(Path(f"clip.{options.format}")) or is_still(source, table, stated_overrides(options)):
        return folder / f"{name}.{options.format}"
    return folder / name.replace(".", "_")  # a name with a suffix would stand for a file


def _refuse_output(output: Path, options: RenderOptions) -> None:
    """Raise L3Error if an output exists, unless it may be continued or replaced."""
    if options.resume or options.force:
        return
    (refuse_existing if output.suffix else refuse_filled_folder)(output, force=False)


def _render_clip(
    table: Path, sensor: TransformTable, source: Path, folder: Path, options: RenderOptions, renderers: Renderers,
    summary: Summary,
) -> None:  # fmt: skip
    """Render a clip and add its outcome to the summary. Raises only errors that would also stop every other clip."""
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
    if output.suffix and tally.made == 1:  # of a sequence, its rate was reported
        options.console.info(f"{output}: rendered in {tally.seconds:.2g} s")
    summary.add(str(source), output, tally, gathering.warnings)
