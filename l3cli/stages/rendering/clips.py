"""Many clips in one call, each rendered as if alone, one after the other: a mistake in one does not stop the others.

The checkpoint beside the outputs lists an output as its clip is begun and again as it has ended. So an output whose clip was
begun and has not ended is half of a run's making. Outputs are known by names, sizes and times, clips by names and
fingerprints: another clip of the same size and time is another clip.
"""

import contextlib
import functools
import hashlib
import json
import os
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.errors import DeviceError, InputFileError, L3Error, RecipeError
from l3cli.io.destination import Destination, destination_of
from l3cli.io.file_names import PATTERN, clips_in, name_of, refuse_one_name
from l3cli.io.raw.files import RawOverrides, holds_several
from l3cli.io.sequences import frame_files, is_one_file, is_still
from l3cli.io.video import is_video
from l3cli.options.render import RenderOptions
from l3cli.stages.rendering.checkpoint import listed_pictures, overrides, video_choice
from l3cli.stages.rendering.executors import Renderers
from l3cli.stages.rendering.render import render
from l3cli.stages.rendering.sequence import Tally
from l3cli.system import files
from l3cli.system.checkpoint import Checkpoint
from l3cli.system.console import Gathering
from l3cli.system.files import FilesUsed
from l3cli.system.locks import sole_writer_of_folder
from l3cli.system.outputs import OutputGuard, refuse_unwritable


def clips_of(inputs: Sequence[Path], table: Path, options: RenderOptions, output: Path) -> tuple[Path, ...]:
    """Return each input, in the place of a folder of clips what lies in it. RecipeError if the output would arrive there."""
    clips: list[Path] = []
    sensor = functools.partial(load, TransformTable, table)
    for each in inputs:
        inside = clips_in(each, sensor, overrides(options), options.console.warn) if each.is_dir() else []
        ours, theirs = (Path(os.path.realpath(path)) for path in (each, output))  # of a loop of links, too
        if inside and (ours in (theirs, *theirs.parents) or theirs in ours.parents):
            raise RecipeError(f"{output} and {each} lie in one another; name an output elsewhere")
        clips += [path for path in inside if os.path.realpath(path) != os.path.realpath(table)] or [each]
    return tuple(clips)


def are_clips(inputs: Sequence[Path], table: Path, options: RenderOptions, output: Path) -> bool:
    """Return whether each input is a clip of its own: there are several, of which one is a sequence, or videos are wanted
    in a folder. Several files of one frame each are one job."""
    if is_video(Path(f"clip.{options.format}")) and not is_video(output):
        return True
    sensor, known = functools.cache(functools.partial(load, TransformTable, table)), overrides(options)
    return len(inputs) > 1 and any(not is_one_file(path) or _is_stack(path, sensor, known) for path in inputs)


def _is_stack(path: Path, sensor: Callable[[], TransformTable], known: RawOverrides) -> bool:
    """Return whether a file holds several frames. What is wrong with it is said when it is rendered."""
    with contextlib.suppress(L3Error, OSError):
        return path.is_file() and holds_several(path, sensor, known)
    return False


@dataclass(frozen=True)
class Entry:
    """State of a clip."""

    clip: str  # file or folder, pattern or glob that it is made of, absolute
    of: str  # identity of the clip's files
    made: str | None = None  # identity of what is in the output; None: not ended, or failed
    frames: int = 0
    left_out: int = 0
    seconds: float = 0.0
    frame_times: str | None = None


def _identity(known: Iterable[object]) -> str:
    return hashlib.sha256(json.dumps(list(known)).encode()).hexdigest()[:32]


def identity_of_clip(source: Path) -> str:
    """Return the identity of a clip's files, by names and fingerprints; InputFileError if a folder or glob holds none."""
    return _identity([path.name, *(files.fingerprint(path) if path.exists() else ())] for path in frame_files(source))


def identity_of_output(output: Path) -> str:
    """Return the identity of a file, or of all files of a folder, by names, sizes and times."""
    return _identity([path.name, *(files.dated(path) or ())] for path in files_of_output(output))


def files_of_output(output: Path) -> list[Path]:
    """Return the file, or all files of the folder but locks and the like."""
    return sorted(path for path in output.iterdir() if not files.is_ours(path.name)) if output.is_dir() else [output]


@dataclass(frozen=True)
class Standing:
    """State of a clip and its output."""

    source: Path
    output: Path
    is_file: bool
    of: str  # identity of the clip
    entry: Entry | None  # what a run before has made there; None: nothing, or it does not matter

    @property
    def same(self) -> bool:
        """Return whether the output is of this content."""
        return self.entry is not None and self.entry.of == self.of

    @property
    def checkpoint(self) -> Path:
        """Return the file among the pictures of a run that was stopped."""
        return Destination(self.output, "folder", "").checkpoint

    @property
    def of_other(self) -> Path | None:
        """Return the clip in another place that the output was made of, as long as it is there."""
        if self.entry is None or self.same or self.entry.clip == os.path.realpath(self.source):
            return None
        clip = Path(self.entry.clip)
        try:
            return clip if any(path.exists() for path in frame_files(clip)) else None
        except (InputFileError, OSError):
            return None

    @property
    def ours(self) -> bool:
        """Return whether the output may be replaced or continued: it is unchanged since a run made it of this clip or one
        that is gone, or it is where that run was stopped."""
        if self.entry is None or self.of_other:
            return False
        if self.entry.made is not None:
            return self.entry.made == identity_of_output(self.output)
        return self.same or self.is_file or self.checkpoint.is_file()  # else nothing says which pictures are of that run

    @property
    def is_finished(self) -> bool:
        """Return whether the output is whole and of this content."""
        return self.ours and self.same and self.entry is not None and self.entry.made is not None

    def clear(self) -> None:
        """Remove the pictures that a run before has made of another content of the clip: it may have had more frames."""
        if self.entry is None or self.is_file or not self.output.is_dir():
            return
        for path in files_of_output(self.output) if self.entry.made else listed_pictures(self.checkpoint):
            files.refuse_protected(path)
            path.unlink()


RENDERED, KEPT, FAILED = "rendered", "kept", "failed"  # of a clip
MOST_WARNINGS = 1000  # of a clip, in its report
STATE = f".clips{files.UNFINISHED}"


@dataclass
class ClipReport:
    """Outcome of a clip."""

    clip: str
    output: str
    state: str  # RENDERED, KEPT from a run before, or FAILED
    frames: int = 0
    left_out: int = 0  # frames
    seconds: float = 0.0
    frames_per_s: float | None = None
    frame_times: str | None = None  # as of Tally
    warnings: list[str] = field(default_factory=list)
    error: str | None = None


@dataclass
class Summary:
    """Outcome of all clips, and reports of the last ones."""

    clips: list[ClipReport] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)
    frames: int = 0
    left_out: int = 0
    code: int | None = None  # exit code of the first clip that failed
    files: list[FilesUsed] = field(default_factory=list)  # of each rendered clip

    def add(self, report: ClipReport) -> None:
        self.clips.append(report)
        self.counts[report.state] += 1
        self.frames += report.frames
        self.left_out += report.left_out

    @property
    def exit_code(self) -> int:
        """Return 0 if every frame of every clip is there; that of the error if all clips failed, else 1."""
        if self.code is not None and not (self.counts[RENDERED] or self.counts[KEPT]):
            return self.code
        return 1 if self.counts[FAILED] or self.left_out else 0

    def document(self) -> dict[str, Any]:
        """Return all of it, ready for JSON."""
        states = {f"clips_{state}": self.counts[state] for state in (RENDERED, KEPT, FAILED)}
        return {"clips": [asdict(each) for each in self.clips], **states, "frames": self.frames, "left_out": self.left_out}


def alone(table: Path, inputs: tuple[Path, ...], output: Path, options: RenderOptions) -> Summary:
    """Render one clip, or several files of one frame each, whose errors are those of `render`."""
    heard, summary = Gathering(options.console, MOST_WARNINGS), Summary()
    tally = render(table, inputs, output, replace(options, console=heard))
    named = str(inputs[0]) if len(inputs) == 1 else f"{inputs[0]} and {len(inputs) - 1} more"
    summary.add(_report(named, output, tally, heard.warnings))
    summary.files.append(tally.files)
    return summary


def _report(clip: str, output: Path, tally: Tally, warnings: list[str]) -> ClipReport:
    rate = tally.done / tally.seconds if tally.seconds else None
    counts = tally.done, tally.failures, tally.seconds, rate, tally.frame_times
    return ClipReport(clip, str(output), RENDERED, *counts, warnings)


class ClipJob:
    """Clips that go into a folder, each to a file or folder of its name."""

    def __init__(self, table: Path, folder: Path, options: RenderOptions) -> None:
        """Raise RecipeError if the output is not a folder or cannot hold videos or pictures of the options' format."""
        if folder == files.STDIN or is_video(folder) or PATTERN.search(folder.name) or folder.is_file():
            raise RecipeError(f"{folder} is for one clip; name a folder, and the kind of its files with ‹format›")
        if options.uncertainty is not None:
            raise RecipeError("‹uncertainty› is of one frame; name one, or leave it out")
        self.folder, self.console, self.summary = folder, options.console, Summary()
        self._renderers = Renderers()
        self._path, self._options = table, options
        self._table, self._dated = load(TransformTable, table), files.dated(table)
        destination_of(folder / f"clip.{options.format}", options.format, video_choice(options), options.shard)
        self._checkpoint = Checkpoint(folder / STATE, options.run_key(files.sha256(table)))

    def output_of(self, source: Path) -> tuple[Path, bool]:
        """Return the output of a clip, and whether it is a single file; InputFileError if the clip must be read to know
        and cannot."""
        name = name_of(source)
        suffix = self._options.format
        if is_video(Path(f"clip.{suffix}")) or is_still(source, self._table, overrides(self._options)):
            return self.folder / f"{name}.{suffix}", True
        return self.folder / name.replace(".", "_"), False  # a name with a suffix would be a file's

    def run(self, sources: Sequence[Path]) -> None:
        """Render all clips; what is wrong with one is said and counted. On resuming those stay that a run before has
        rendered, and what it made of a clip that has changed is replaced. RecipeError before any work if two have one name,
        L3Error, unless resuming, if an output is there; DeviceError if nothing can be rendered, L3Error on a full disk."""
        sources, resume = list(dict.fromkeys(sources)), self._options.resume
        refuse_one_name(sources)
        with OutputGuard(self.console) as guard:
            refuse_unwritable(self.folder / STATE)
            guard.protect(self._path)
            guard.hold(sole_writer_of_folder(self.folder), self.folder)
            self._take_over()
            later = (L3Error, OSError) if resume else (InputFileError, OSError)  # said when it is its turn
            for source in sources:
                with contextlib.suppress(*later):
                    guard.protect(*frame_files(source))
                    self._standing(source)
            self._checkpoint.begin()  # now that nothing is refused: what it replaces may be another run's
            try:
                for number, source in enumerate(sources, 1):
                    self.console.info(f"clip {number} of {len(sources)}: {source}")
                    self._one(source)
            finally:
                if not any(os.path.exists(self.folder / name) for name in self._checkpoint.items):
                    self._checkpoint.end()

    def _take_over(self) -> None:
        """Read what runs before have made and is there. RecipeError, on resuming, if that was with another table or other
        options."""
        known = self._checkpoint
        if not known.take_over() and known.path.is_file() and self._options.resume and not self._options.force:
            raise RecipeError(
                f"{self.folder} holds a run with another table or options; name another folder, or add ‹force›"
            )
        known.items = {name: entry for name, entry in known.items.items() if (self.folder / name).exists()}

    def _note(self, output: Path, entry: Entry) -> None:
        self._checkpoint.add(output.name, asdict(entry))

    def _standing(self, source: Path) -> Standing:
        """Return the state of a clip and its output. L3Error if something exists that may not be replaced."""
        of, (output, is_file) = identity_of_clip(source), self.output_of(source)
        known = self._checkpoint.items.get(output.name) if self._options.resume else None
        standing = Standing(source, output, is_file, of, known and Entry(**known))
        if not (self._options.force or standing.ours):
            if standing.of_other:
                raise L3Error(
                    f"{output} was made of {standing.of_other}, which is still there; name another folder, or add ‹force›"
                )
            (files.refuse_existing if is_file else files.refuse_filled_folder)(output, False)
        return standing

    def _one(self, source: Path) -> None:
        """Render a clip, unless it is there; what is wrong with it is said and counted."""
        if files.dated(self._path) != self._dated:
            raise RecipeError(f"{self._path} has changed since the run began; begin it again")
        output, heard = self.folder / name_of(source), Gathering(self.console, MOST_WARNINGS)
        try:
            standing = self._standing(source)
            output, entry = standing.output, standing.entry
            if standing.is_finished and entry:
                about = entry.frames, entry.left_out, entry.seconds, None, entry.frame_times
                self.summary.add(ClipReport(str(source), str(output), KEPT, *about))
                return
            goes_on = standing.ours and standing.same and standing.checkpoint.is_file()
            if standing.ours and not goes_on:
                standing.clear()
            begun = Entry(os.path.realpath(source), standing.of)
            self._note(output, begun)
            force = self._options.force or (standing.ours and not goes_on)
            options = replace(self._options, console=heard, resume=goes_on, force=force)
            tally = render(self._path, (source,), output, options, self._renderers)
        except (L3Error, OSError) as error:
            self._fail(source, output, heard, error)
            return
        if standing.is_file and tally.done == 1:  # of sequences their stage says so
            self.console.info(f"{output}: rendered in {tally.seconds:.2g} s")
        made = identity_of_output(output)
        ended = replace(begun, made=made, frames=tally.done, left_out=tally.failures, seconds=tally.seconds)
        self._note(output, replace(ended, frame_times=tally.frame_times))
        self.summary.add(_report(str(source), output, tally, heard.warnings))
        self.summary.files.append(tally.files)

    def _fail(self, source: Path, output: Path, heard: Gathering, error: L3Error | OSError) -> None:
        """Report and count what is wrong with a clip; raise what would be wrong with every other one, too."""
        self._renderers.forget()
        cause = error if isinstance(error, OSError) else error.__cause__
        if isinstance(error, DeviceError) or (isinstance(cause, OSError) and cause.errno in files.FULL):
            raise error
        message = f"{error.filename or source}: {error.strerror}" if isinstance(error, OSError) else str(error)
        heard.report(f"l3: {source}: {message}" if str(source) not in message else f"l3: {message}")
        self.summary.code = self.summary.code or getattr(error, "exit_code", 1)
        warnings = heard.warnings[:-1]  # without the error
        self.summary.add(ClipReport(str(source), str(output), FAILED, warnings=warnings, error=message))
