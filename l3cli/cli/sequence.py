"""What `l3 render` does with frames, be it one or thousands: read ahead, render, write behind.

Reading, rendering and writing overlap in threads with short queues between them, so that memory is bounded whatever the
length; the libraries let go of Python's lock in their long calls.
"""

import contextlib
import hashlib
import json
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from l3cli.cli import options
from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.files import refuse_existing, write_whole
from l3cli.frame import RawFrame, upright
from l3cli.io import images
from l3cli.io.sequences import PATTERN, Footage, Pending, numbered_files, numbered_name
from l3cli.io.video import VideoChoice, check_video, is_video, new_video, new_y4m
from l3cli.parallel import Behind, ahead
from l3cli.render.display import automatic_exposure, make_display
from l3cli.render.exposure import LightMeter, SteadyExposure

if TYPE_CHECKING:
    from l3cli.artifacts.table import TransformTable
    from l3cli.cli.elsewhere import Elsewhere
    from l3cli.render.renderer import Renderer

DEPTH = 3  # frames that wait at most between reading and rendering, and between rendering and writing
PICTURE_WRITERS = 2  # threads that compress picture files
STDOUT = Path("-")
USUAL_RATE = Fraction(30)  # frames a second, where neither the caller nor the input tells


@dataclass(frozen=True)
class Target:
    """Where pictures go: "stream" (y4m to stdout), "video", "pattern" (numbered files), "folder" or a single "file"."""

    path: Path
    kind: str
    suffix: str  # of the files in a folder

    @property
    def one_by_one(self) -> bool:
        """Whether every frame becomes a file of its own."""
        return self.kind in ("pattern", "folder", "file")

    @property
    def linear(self) -> bool:
        """Whether linear outputs are written rather than pictures."""
        return self.one_by_one and images.is_linear(self.file(0, "frame"))

    def file(self, number: int, stem: str) -> Path:
        """The file of a frame."""
        if self.kind == "pattern":
            return numbered_name(self.path, number)
        return self.path / f"{stem}.{self.suffix}" if self.kind == "folder" else self.path

    @property
    def mark(self) -> Path:
        """Lies beside the pictures while a run is under way, and tells `--resume` which run it was."""
        return self.path / ".l3-render" if self.kind == "folder" else self.path.with_name(f".{self.path.name}.l3-render")


def make_target(output: Path, suffix: str, choice: VideoChoice) -> Target:
    """The target that a name asks for; RecipeError if nothing of that name can be written."""
    if output == STDOUT:
        target = Target(output, "stream", suffix)
        check_video(Path("stdout.y4m"), choice)
        if sys.stdout.isatty():
            raise RecipeError("a y4m stream is not for a terminal; pipe it on, or name a file with -o")
    elif is_video(output):
        target = Target(output, "video", suffix)
        check_video(output, choice)
    else:
        kind = "file" if output.suffix and not output.is_dir() else "folder"
        target = Target(output, "pattern" if PATTERN.search(output.name) else kind, suffix)
        images.check_format(target.file(0, "frame"), choice.bits)
        if choice.codec or choice.crf is not None:
            raise RecipeError(f"{output}: --codec and --crf are for videos; name a .mp4, .mov or .mkv")
    return target


def refuse_single(target: Target, force: bool) -> None:
    """L3Error, before anything is read, if a video or single picture is there already."""
    if target.kind in ("video", "file"):
        refuse_existing(target.path, force)


def refuse_outputs(target: Target, footage: Footage, force: bool) -> None:
    """RecipeError if the frames do not fit into the target, L3Error if they would replace what is there."""
    if target.kind == "file" and footage.count != 1:
        count = "a sequence" if footage.count is None else f"{footage.count} frames"
        raise RecipeError(
            f"{target.path} holds one picture, the inputs are {count}; name a folder, a pattern "
            f"({target.path.stem}_%04d{target.path.suffix}) or a video"
        )
    if footage.count is not None and target.one_by_one:
        _spare_inputs(target, footage)
    if target.kind not in ("pattern", "folder"):
        return
    if footage.count is None:
        files = _pictures(target)
    else:
        files = [target.file(pending.number, pending.stem) for pending in footage.frames]
    if len(set(files)) < len(files):
        raise RecipeError("two inputs have the same name and would write the same file; render them one by one")
    for file in files:
        refuse_existing(file, force)


def _spare_inputs(target: Target, footage: Footage) -> None:
    """RecipeError if a picture would take the place of a raw frame, whatever --force says."""
    for pending in footage.frames:
        file = target.file(pending.number, pending.stem)
        if pending.source is not None and file.exists() and pending.source.exists() and file.samefile(pending.source):
            raise RecipeError(f"{file} is an input; name another output")


def refuse_missing(footage: Footage) -> None:
    """InputFileError if it is known already that a frame is missing."""
    if footage.count is not None:
        for pending in footage.frames:
            if pending.missing:
                raise pending.missing


def _pictures(target: Target) -> list[Path]:
    """The files that are there in a folder or of a pattern."""
    if target.kind == "pattern":
        return list(numbered_files(target.path).values())
    return sorted(target.path.glob(f"*.{target.suffix}"))


@contextlib.contextmanager
def marked(target: Target, key: list[Any], resume: bool, force: bool, footage: Footage) -> Iterator[bool]:
    """Refuse what cannot be written, then keep the run's mark until all is done. Yields whether an earlier run goes on.

    `key` tells all that the pictures' bytes depend on.
    """
    if target.kind not in ("pattern", "folder"):
        if resume:
            raise RecipeError(f"--resume goes on with a sequence of pictures; {target.path} is written in one go")
        refuse_outputs(target, footage, force)
        yield False
        return
    text = hashlib.sha256(json.dumps(key, sort_keys=True, default=str).encode()).hexdigest()
    goes_on = resume and target.mark.is_file()
    if goes_on and target.mark.read_text() != text:
        raise RecipeError(f"{target.path} holds a run with another table, inputs or options; leave --resume out")
    refuse_outputs(target, footage, force or goes_on)
    new = not target.mark.parent.exists()
    target.mark.parent.mkdir(parents=True, exist_ok=True)
    target.mark.write_text(text)
    try:
        yield goes_on
    except BaseException:
        if not _pictures(target):
            target.mark.unlink()
            with contextlib.suppress(OSError):
                if new:
                    target.mark.parent.rmdir()
        raise
    target.mark.unlink()


# ------------------------------------------------------------------------------------------------------ rendering


@dataclass(frozen=True)
class Look:
    """What makes pictures of outputs."""

    white: Any  # XYZ of the scene's white; None: outputs are written as they are
    exposure: float | None  # None: automatic
    bits: int


@dataclass(frozen=True)
class Taken:
    """A frame and how bright it is to be shown, or why it was not read; neither where its picture is there already."""

    pending: Pending
    frame: RawFrame | Path | None = None  # a path: whoever renders it is to read it
    scale: float = 0.0  # of exposure; 0: the frame's own
    error: L3Error | None = None


class Here:
    """Renders frames in this process."""

    by_path = False  # whether it reads files itself

    def __init__(self, renderer: "Renderer", look: Look) -> None:
        self._renderer, self._look = renderer, look

    def develop(self, frames: Iterator[Taken]) -> Iterator[tuple[Taken, Any]]:
        """Every frame with its pixels; None where there are none to be had."""
        for each in ahead(frames, DEPTH):
            yield (
                each,
                pixels_of(self._renderer, each.frame, self._look, each.scale) if isinstance(each.frame, RawFrame) else None,
            )


def render_frames(
    footage: Footage, target: Target, room: "Here | Elsewhere", table: "TransformTable", look: Look, choice: VideoChoice,
    goes_on: bool, skip_bad: bool, quiet: bool,
) -> int:  # fmt: skip
    """Render every frame into the target; how many were left out. What is broken is raised, unless `skip_bad`: then it is
    said."""
    start = time.monotonic()
    done = failures = 0
    frames = _taken(footage, target, _Exposure(footage, target, table, look, choice.rate), goes_on, room.by_path)
    with _open_sink(target, choice, table.outputs) as (write, threads), Behind(write, DEPTH, threads) as writing:
        for each, made in options.progress(room.develop(frames), footage.count, "frames", quiet):
            error = made if isinstance(made, L3Error) else each.error
            if error is not None:
                if not skip_bad:
                    raise error
                failures += 1
                click.echo(f"l3: {error}", err=True)
                continue
            if made is not None:
                writing.put((each.pending, made))
            done += 1
        if not done:
            raise InputFileError("none of the frames could be read; nothing is written")
    if not footage.stills:
        rate = done / max(time.monotonic() - start, 1e-9)
        options.say(f"{target.path}: {done} frames, {rate:.3g} a second", quiet)
    if failures:
        click.echo(f"l3: {failures} of {done + failures} frames left out", err=True)
    return failures


class _Exposure:
    """Exposure scale of one frame after the other: as the caller says, or steady in time; 0 where each has its own."""

    def __init__(self, footage: Footage, target: Target, table: "TransformTable", look: Look, rate: Fraction) -> None:
        # Stills that become files have each its own exposure.
        steady = look.white is not None and look.exposure is None and not (footage.stills and target.one_by_one)
        self.fixed = look.exposure or 0.0
        self._meter = LightMeter(table) if steady else None
        self._steady = SteadyExposure(rate)

    @property
    def measured(self) -> bool:
        """Whether it has to see every frame."""
        return self._meter is not None

    def scale(self, frame: RawFrame) -> float:
        return self.fixed if self._meter is None else self._steady.scale(self._meter.brightness(frame))


def _taken(footage: Footage, target: Target, exposure: _Exposure, goes_on: bool, by_path: bool) -> Iterator[Taken]:
    """Read, and expose, frame after frame; of frames that are kept only what the exposure of later ones needs. `by_path` a
    file that need not be looked at is left to who renders it."""
    size: tuple[int, ...] | None = None
    for pending in footage.frames:
        kept = goes_on and target.file(pending.number, pending.stem).exists()
        if kept and not exposure.measured and footage.count is not None:
            yield Taken(pending)
            continue
        try:
            if by_path and pending.source and not pending.missing and target.one_by_one and not exposure.measured:
                yield Taken(pending, pending.source.absolute(), exposure.fixed)
                continue
            frame = pending.read()
            if frame is None:
                return
            if not target.one_by_one:
                size = size or _upright_shape(frame)
                _require_size(frame, size)
            scale = exposure.scale(frame)
        except (L3Error, OSError) as error:
            yield Taken(pending, error=error if isinstance(error, L3Error) else InputFileError(str(error)))
            continue
        yield Taken(pending) if kept else Taken(pending, frame, scale)


def _upright_shape(frame: RawFrame) -> tuple[int, ...]:
    return upright(frame.values, frame.orientation).shape


def _require_size(frame: RawFrame, size: tuple[int, ...]) -> None:
    found = _upright_shape(frame)
    if found != size:
        raise InputFileError(
            f"{frame.name} has {found[0]}×{found[1]} pixels, the video {size[0]}×{size[1]}; give frames of one size"
        )


def pixels_of(renderer: "Renderer", frame: RawFrame, look: Look, scale: float) -> Any:
    """Picture, or linear outputs where there is no white, (row, col, value). `scale` 0: this frame's own exposure."""
    if look.white is None:
        return upright(np.moveaxis(renderer.outputs(frame), 0, -1), frame.orientation)
    # The exposure of one frame alone needs the whole frame's luminance before the first value is encoded: two runs.
    scale = scale or automatic_exposure(renderer.outputs(frame)[1])
    return upright(renderer.picture(frame, make_display(look.white, scale, look.bits)), frame.orientation)


def write_pixels(file: Path, made: Any, outputs: tuple[str, ...]) -> None:
    """A picture, or linear outputs if the file's name asks for them."""
    if images.is_linear(file):
        images.write_linear(file, made, outputs)
    else:
        images.write_picture(file, made)


@contextlib.contextmanager
def _open_sink(
    target: Target, choice: VideoChoice, outputs: tuple[str, ...]
) -> Iterator[tuple[Callable[[tuple[Pending, Any]], None], int]]:
    """What writes a frame, and the number of threads that may do so at a time."""
    if target.one_by_one:

        def write(item: tuple[Pending, Any]) -> None:
            pending, made = item
            file = target.file(pending.number, pending.stem)
            if isinstance(made, bytes):
                write_whole(file, made)
            else:
                write_pixels(file, made, outputs)

        yield write, PICTURE_WRITERS
    elif target.kind == "stream" or target.path.suffix.lower() == ".y4m":
        with new_y4m(None if target.kind == "stream" else target.path, choice) as stream:
            yield lambda item: stream.write(item[1]), 1
    else:
        with new_video(target.path, choice) as video:
            yield lambda item: video.write(item[1]), 1
