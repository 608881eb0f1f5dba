"""Many clips in one call, each rendered as if alone, one after the other: a mistake in one does not stop the others."""

import contextlib
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.errors import DeviceError, InputFileError, L3Error, RecipeError
from l3cli.io.file_names import PATTERN
from l3cli.io.sequences import frame_files, is_still
from l3cli.io.video import is_video
from l3cli.options.render import RenderOptions
from l3cli.stages.rendering.clip_inputs import (
    Entry,
    Standing,
    identity_of_clip,
    identity_of_output,
    name_of,
    refuse_one_name,
)
from l3cli.stages.rendering.destination import destination_of, overrides
from l3cli.stages.rendering.executors import Renderers
from l3cli.stages.rendering.render import render
from l3cli.stages.rendering.sequence import Tally
from l3cli.system.checkpoint import Checkpoint
from l3cli.system.console import Gathering
from l3cli.system.files import FULL, STDIN, UNFINISHED, refuse_existing, refuse_filled_folder, sha256
from l3cli.system.ledger import dated
from l3cli.system.locks import sole_writer_of_folder
from l3cli.system.output_guard import OutputGuard, refuse_unwritable
from l3cli.system.plan import Planned, is_dry

RENDERED, KEPT, FAILED = "rendered", "kept", "failed"  # of a clip
MOST_WARNINGS = 1000  # of a clip, in its report
STATE = f".clips{UNFINISHED}"


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

    def add(self, report: ClipReport) -> None:
        self.clips.append(report)
        self.counts[report.state] += 1
        self.frames += report.frames
        self.left_out += report.left_out

    @property
    def exit_code(self) -> int:
        """0 if every frame of every clip is there; that of the error if all clips failed, else 1."""
        if self.code is not None and not (self.counts[RENDERED] or self.counts[KEPT]):
            return self.code
        return 1 if self.counts[FAILED] or self.left_out else 0

    def document(self) -> dict[str, Any]:
        """All of it, ready for JSON."""
        states = {f"clips_{state}": self.counts[state] for state in (RENDERED, KEPT, FAILED)}
        return {"clips": [asdict(each) for each in self.clips], **states, "frames": self.frames, "left_out": self.left_out}


def alone(table: Path, inputs: tuple[Path, ...], output: Path, options: RenderOptions) -> Summary:
    """One clip, or several files of one frame each, whose errors are those of `render`."""
    heard, summary = Gathering(options.console, MOST_WARNINGS), Summary()
    tally = render(table, inputs, output, replace(options, console=heard))
    named = str(inputs[0]) if len(inputs) == 1 else f"{inputs[0]} and {len(inputs) - 1} more"
    summary.add(_report(named, output, tally, heard.warnings))
    return summary


def _report(clip: str, output: Path, tally: Tally, warnings: list[str]) -> ClipReport:
    rate = tally.done / tally.seconds if tally.seconds else None
    counts = tally.done, tally.failures, tally.seconds, rate, tally.frame_times
    return ClipReport(clip, str(output), RENDERED, *counts, warnings)


class ClipJob:
    """Clips that go into a folder, each to a file or folder of its name."""

    def __init__(self, table: Path, folder: Path, options: RenderOptions) -> None:
        """RecipeError if the output is no folder or cannot hold videos or pictures of the options' format."""
        if folder == STDIN or is_video(folder) or PATTERN.search(folder.name) or folder.is_file():
            raise RecipeError(f"{folder} is for one clip; name a folder, and the kind of its files with ‹format›")
        self.folder, self.console, self.summary = folder, options.console, Summary()
        self._renderers = Renderers()
        self._path, self._options = table, options
        self._table, self._dated = load(TransformTable, table), dated(table)
        destination_of(folder / f"clip.{options.format}", options)
        self._checkpoint = Checkpoint(folder / STATE, options.run_key(sha256(table)))

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
        with OutputGuard(self.console) as claims:
            refuse_unwritable(self.folder / STATE)
            claims.protect(self._path)
            if not is_dry():
                claims.hold(sole_writer_of_folder(self.folder), self.folder)
            self._take_over()
            later = (L3Error, OSError) if resume and not is_dry() else (InputFileError, OSError)  # said when it is its turn
            standings: list[Standing] = []
            for source in sources:
                with contextlib.suppress(*later):
                    claims.protect(*frame_files(source))
                    standings.append(self._standing(source))
            if is_dry():
                self._plan(standings)
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

    def _plan(self, standings: Sequence[Standing]) -> None:
        """In a dry run Planned for all clips; what is wrong with the first one is raised."""
        reads: dict[str, list[Path]] = {}
        makes = []
        for standing in standings:
            if standing.is_finished:
                continue
            try:
                force = self._options.force or standing.ours
                render(self._path, (standing.source,), standing.output, replace(self._options, resume=False, force=force))
            except Planned as plan:
                makes += plan.makes
                for role, paths in plan.reads.items():
                    reads.setdefault(role, []).extend(paths)
        raise Planned(reads, makes)

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
            (refuse_existing if is_file else refuse_filled_folder)(output, False)
        return standing

    def _one(self, source: Path) -> None:
        """Render a clip, unless it is there; what is wrong with it is said and counted."""
        if dated(self._path) != self._dated:
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

    def _fail(self, source: Path, output: Path, heard: Gathering, error: L3Error | OSError) -> None:
        """Say and count what is wrong with a clip; raise what would be wrong with every other one, too."""
        self._renderers.forget()
        cause = error if isinstance(error, OSError) else error.__cause__
        if isinstance(error, DeviceError) or (isinstance(cause, OSError) and cause.errno in FULL):
            raise error
        message = f"{error.filename or source}: {error.strerror}" if isinstance(error, OSError) else str(error)
        heard.report(f"l3: {source}: {message}" if str(source) not in message else f"l3: {message}")
        self.summary.code = self.summary.code or getattr(error, "exit_code", 1)
        warnings = heard.warnings[:-1]  # without the error
        self.summary.add(ClipReport(str(source), str(output), FAILED, warnings=warnings, error=message))
