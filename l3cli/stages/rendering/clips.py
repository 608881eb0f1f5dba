"""Many clips in one call, each rendered as if alone, one after the other: a mistake in one does not stop the others."""

import collections
import contextlib
import functools
import hashlib
import json
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from l3cli import __version__
from l3cli.errors import DeviceError, InputFileError, L3Error, RecipeError
from l3cli.files import FULL, STDIN, UNFINISHED, refuse_existing, refuse_filled_folder, sha256
from l3cli.io.numbered import PATTERN
from l3cli.io.raw.files import KnownBetter
from l3cli.io.sequences import frame_files, is_one_file, is_still
from l3cli.io.video import USUAL_RATE, VideoChoice, is_video
from l3cli.ledger import dated
from l3cli.locks import sole_writer_of_folder
from l3cli.rendering.kept_table import open_table
from l3cli.stages.claims import Claims, refuse_unwritable
from l3cli.stages.console import Console, Gathering
from l3cli.stages.plan import Planned, is_dry
from l3cli.stages.rendering.destination import Destination, destination_of
from l3cli.stages.rendering.executors import Renderers
from l3cli.stages.rendering.job_state import Entry, JobState, identity_of_clip, identity_of_output
from l3cli.stages.rendering.sequence import Tally

Render = functools.partial[Tally]  # render(inputs, output, console, resume=…, force=…): the stage, all other choices made
RENDERED, KEPT, FAILED = "rendered", "kept", "failed"  # of a clip
MOST_KEPT = 1000  # reports, and warnings in one: a folder may be watched for months
STATE = f".clips{UNFINISHED}"
WILD = re.compile(r"\[[^]]*\]|[*?]")


@dataclass
class ClipReport:
    """What has become of a clip."""

    clip: str
    output: str
    state: str  # RENDERED, KEPT from a run before, or FAILED
    frames: int = 0
    left_out: int = 0  # frames
    seconds: float = 0.0
    frames_per_s: float | None = None
    warnings: list[str] = field(default_factory=list)
    error: str | None = None


@dataclass
class Summary:
    """What has become of all clips, and reports of the last ones."""

    clips: collections.deque[ClipReport] = field(default_factory=lambda: collections.deque(maxlen=MOST_KEPT))
    counts: collections.Counter[str] = field(default_factory=collections.Counter)
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


def are_clips(inputs: Sequence[Path], output: Path, suffix: str) -> bool:
    """Whether each input is a clip of its own: there are several, of which one is a sequence, or videos are wanted in a
    folder. Several files of one frame each are one job."""
    wants_videos = is_video(Path(f"clip.{suffix}")) and not is_video(output)
    return wants_videos or (len(inputs) > 1 and not all(map(is_one_file, inputs)))


def name_of(source: Path) -> str:
    """What the output of a clip is called: as its file or folder; of a pattern or glob what is left without its
    placeholders or, if nothing is, as the folder that it lies in."""
    if source.exists():
        name = source.resolve().name if source.is_dir() else source.stem
        return PATTERN.sub("_", name) or "clip"  # which an output must not be taken for
    plain = WILD.sub("", PATTERN.sub("", source.stem)).strip("_-. ")
    return plain or WILD.sub("", source.parent.resolve().name) or "clip"


def alone(render: Render, inputs: tuple[Path, ...], output: Path, console: Console, resume: bool, force: bool) -> Summary:
    """One clip, or several files of one frame each, whose errors are those of `render`."""
    heard, summary = Gathering(console, MOST_KEPT), Summary()
    tally = render(inputs, output, heard, resume=resume, force=force)
    named = str(inputs[0]) if len(inputs) == 1 else f"{inputs[0]} and {len(inputs) - 1} more"
    summary.add(_report(named, output, tally, heard.warnings))
    return summary


def _report(clip: str, output: Path, tally: Tally, warnings: list[str]) -> ClipReport:
    rate = tally.done / tally.seconds if tally.seconds else None
    return ClipReport(clip, str(output), RENDERED, tally.done, tally.failures, tally.seconds, rate, warnings)


class ClipJob:
    """Clips that go into a folder, each to a file or folder of its name."""

    def __init__(
        self, table: Path, folder: Path, suffix: str, render: Render, console: Console, *, force: bool = False
    ) -> None:  # fmt: skip
        """`suffix`: of videos, or of the pictures in a folder for each clip; `render`: of one clip, with all that its bytes
        depend on beside table and clip among its keywords. RecipeError if the output is no folder or cannot hold this."""
        if folder == STDIN or is_video(folder) or PATTERN.search(folder.name) or folder.is_file():
            raise RecipeError(f"{folder} is for one clip; name a folder, and the kind of its files with ‹format›")
        self.folder, self.console, self.force, self.summary = folder, console, force, Summary()
        self._renderers = Renderers()
        self._path, self._suffix = table, suffix
        self._render = functools.partial(render, renderers=self._renderers)
        self._table, self._dated = open_table(table).table, dated(table)
        choices = {name: value for name, value in render.keywords.items() if name not in ("skip_bad", "scheduler")}
        self._known: KnownBetter = choices["known"]
        about = {name: choices[name] for name in ("codec", "crf", "preset") if name in choices}
        choice = VideoChoice(choices.get("rate") or USUAL_RATE, choices.get("bits", 8), **about)
        destination_of(folder / f"clip.{suffix}", suffix, choice)
        named = (each for value in choices.values() for each in (value if isinstance(value, tuple) else (value,)))
        files = [dated(each) for each in named if isinstance(each, Path)]  # of darks and cameras
        key = [sha256(table), __version__, suffix, sorted(choices.items()), files]
        self._key = hashlib.sha256(json.dumps(key, default=str).encode()).hexdigest()
        self.state = JobState(folder / STATE, self._key)

    @contextlib.contextmanager
    def opened(self, name: str, take_over: bool) -> Iterator[Claims]:
        """Hold the folder for this run, and its state in the file `name`, that of a run before if it is to be taken over."""
        with Claims(self.console) as claims:
            refuse_unwritable(self.folder / name)
            claims.spare(self._path)
            if is_dry():
                yield claims
                return
            claims.hold(sole_writer_of_folder(self.folder), self.folder)
            self.state = JobState(self.folder / name, self._key)
            if take_over:
                self.state.take_over()
            try:
                yield claims
            finally:
                self.state.end(complete=False)

    def output_of(self, source: Path) -> tuple[Path, bool]:
        """Where a clip goes, and whether to a single file; InputFileError if it must be read to be known and cannot."""
        name = name_of(source)
        if is_video(Path(f"clip.{self._suffix}")) or is_still(source, self._table, self._known):
            return self.folder / f"{name}.{self._suffix}", True
        return self.folder / name.replace(".", "_"), False  # a name with a suffix would be a file's

    def run(self, sources: Sequence[Path], resume: bool) -> None:
        """Render all clips; what is wrong with one is said and counted. RecipeError or L3Error before any work if two have
        one name or an output is there, DeviceError if nothing can be rendered, L3Error if the disk is full."""
        sources = list(dict.fromkeys(sources))
        _refuse_one_name(sources)
        with self.opened(STATE, resume) as claims:
            for source in sources:
                with contextlib.suppress(InputFileError, OSError):  # said when it is its turn
                    claims.spare(*frame_files(source))
                    self._refuse_output(source, *self.output_of(source))
            if is_dry():
                self._plan(sources)
            self.state.begin()  # now that nothing is refused: what it replaces may be another run's
            for number, source in enumerate(sources, 1):
                self.console.say(f"clip {number} of {len(sources)}: {source}")
                self.one(source)
            self.state.end(complete=not self.summary.counts[FAILED] or not self.state.has_outputs)

    def _plan(self, sources: Sequence[Path]) -> None:
        """In a dry run Planned for all clips; what is wrong with the first one is raised."""
        reads: dict[str, list[Path]] = {}
        makes = []
        for source in sources:
            try:
                self._render((source,), self.output_of(source)[0], self.console, resume=False, force=self.force)
            except Planned as plan:
                makes += plan.makes
                for role, paths in plan.reads.items():
                    reads.setdefault(role, []).extend(paths)
        raise Planned(reads, makes)

    def _refuse_output(self, source: Path, output: Path, is_file: bool) -> None:
        """L3Error if something is there that is not of this run."""
        entry = self.state.entry(source)
        if not (self.force or (entry and entry.has(output))):
            (refuse_existing if is_file else refuse_filled_folder)(output, False)

    def one(self, source: Path, expected: str | None = None) -> None:
        """Render a clip, unless it is there; what is wrong with it is said and counted. `expected`: its identity, else it
        is left for later."""
        if dated(self._path) != self._dated:
            raise RecipeError(f"{self._path} has changed since the run began; begin it again")
        output, heard = self.folder / name_of(source), Gathering(self.console, MOST_KEPT)
        of, begun = "", False
        try:
            of = identity_of_clip(source)
            if expected not in (None, of):
                return
            output, is_file = self.output_of(source)
            entry = self.state.entry(source)
            ours, same = bool(entry and entry.has(output)), bool(entry and entry.of == of)
            if entry and ours and same and entry.made:
                self.summary.add(ClipReport(str(source), str(output), KEPT, entry.frames, entry.left_out, entry.seconds))
                return
            self._refuse_output(source, output, is_file)
            self.state.note(source, Entry(of, os.path.realpath(output)))
            begun = True
            goes_on = ours and same and not is_file and Destination(output, "folder", self._suffix).mark.is_file()
            tally = self._render((source,), output, heard, resume=goes_on, force=self.force or (ours and not goes_on))
        except (L3Error, OSError) as error:
            self._fail(source, output, of, begun, heard, error)
            return
        if is_file and tally.done == 1:  # of sequences their stage says so
            self.console.say(f"{output}: rendered in {tally.seconds:.2g} s")
        made = identity_of_output(output)
        self.state.note(
            source, Entry(of, os.path.realpath(output), made, None, True, tally.done, tally.failures, tally.seconds)
        )
        self.summary.add(_report(str(source), output, tally, heard.warnings))

    def _fail(
        self, source: Path, output: Path, of: str, begun: bool, heard: Gathering, error: L3Error | OSError
    ) -> None:  # fmt: skip
        """Say and count what is wrong with a clip; raise what would be wrong with every other one, too."""
        self._renderers.forget()
        cause = error if isinstance(error, OSError) else error.__cause__
        if isinstance(error, DeviceError) or (isinstance(cause, OSError) and cause.errno in FULL):
            raise error
        message = f"{error.filename or source}: {error.strerror}" if isinstance(error, OSError) else str(error)
        self.state.note(source, Entry(of, os.path.realpath(output), None, message, begun))
        heard.alert(f"l3: {source}: {message}" if str(source) not in message else f"l3: {message}")
        self.summary.code = self.summary.code or getattr(error, "exit_code", 1)
        warnings = heard.warnings[:-1]  # without the error
        self.summary.add(ClipReport(str(source), str(output), FAILED, warnings=warnings, error=message))


def _refuse_one_name(sources: Sequence[Path]) -> None:
    named: dict[str, Path] = {}
    for source in sources:
        if source == STDIN:
            raise RecipeError("stdin is one clip; render it alone")
        other = named.setdefault(name_of(source), source)
        if other != source:
            raise RecipeError(f'{other} and {source} would both become "{name_of(source)}"; render them apart')
