"""What `l3 render` does with frames, be it one or thousands: read ahead, render, write behind.

Reading, rendering and writing overlap in threads with short queues between them, so that memory is bounded whatever the
length; the libraries let go of Python's lock in their long calls.
"""

import contextlib
import hashlib
import json
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from l3cli.cli import options
from l3cli.cli.cautions import Cautions
from l3cli.cli.mark import Mark, Origins
from l3cli.cli.terminal import tell
from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.files import atomic_output, refuse_existing, refuse_spared, sha256, sole_writer_of_folder
from l3cli.frame import RawFrame, upright
from l3cli.io import images
from l3cli.io.sequences import PATTERN, Footage, Pending, last_number, numbered_files, numbered_name
from l3cli.io.video import VideoChoice, check_video, is_video, new_video, new_y4m
from l3cli.parallel.threads import Behind, ahead
from l3cli.physics.display import automatic_exposure
from l3cli.render.display import Display, make_display
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
    def file_suffix(self) -> str | None:
        """Of every file, where every frame becomes one."""
        return self.file(0, "frame").suffix if self.one_by_one else None

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


def claim(target: Target, force: bool) -> None:
    """L3Error, before anything is read, if nothing can be written there, another run does so, or a video or single picture
    is there already; RecipeError if that is read."""
    if target.kind in ("video", "file"):
        options.claim_file(target.path, force)
    elif target.kind == "stream":
        refuse_spared(1)
    else:
        options.refuse_unwritable(target.file(0, "frame"))
        folder, name = (target.path, "") if target.kind == "folder" else (target.path.parent, target.path.name)
        options.hold(sole_writer_of_folder(folder, name), target.path)


def refuse_outputs(target: Target, footage: Footage, force: bool, mark: Mark | None = None) -> None:
    """RecipeError if the frames do not fit into the target or would replace what is read, L3Error if they would replace
    what is there and not of the mark's run."""
    if target.kind == "file" and footage.count != 1:
        count = "a sequence" if footage.count is None else f"{footage.count} frames"
        raise RecipeError(
            f"{target.path} holds one picture, the inputs are {count}; name a folder, a pattern "
            f"({target.path.stem}_%04d{target.path.suffix}) or a video"
        )
    if target.kind not in ("pattern", "folder"):
        return
    if footage.is_stream:
        files = _in_the_way(target, footage)
    else:
        files = [target.file(pending.number, pending.stem) for pending in footage.frames]
    if len(set(files)) < len(files):
        raise RecipeError("two inputs have the same name and would write the same file; render them one by one")
    for file in files:
        refuse_spared(file)
        refuse_existing(file, force or (mark is not None and mark.is_ours(file)))


def refuse_missing(footage: Footage) -> None:
    """InputFileError if it is known already that a frame is missing."""
    if footage.missing:
        raise footage.absent(footage.missing[0])


def _in_the_way(target: Target, footage: Footage) -> list[Path]:
    """Pictures that are there and that frames of a stream, which may be endless, would replace."""
    if footage.wanted is None:
        return _pictures(target)
    if target.kind == "pattern":
        return [file for number, file in numbered_files(target.path).items() if number in footage.wanted]
    numbers = {last_number(file) for file in _pictures(target)}
    frames = [footage.frames.pending(number) for number in numbers if number is not None and number in footage.wanted]
    return [target.file(pending.number, pending.stem) for pending in frames]


def _pictures(target: Target) -> list[Path]:
    """The files that are there in a folder or of a pattern."""
    if target.kind == "pattern":
        return list(numbered_files(target.path).values())
    return sorted(target.path.glob(f"*.{target.suffix}"))


@contextlib.contextmanager
def marked(
    target: Target, key: list[Any], resume: bool, force: bool, footage: Footage, origins: Callable[[], Origins]
) -> Iterator[Mark | None]:
    """Refuse what cannot be written, then keep the run's mark, for a sequence of pictures, until all is done.

    `key` tells all that the pictures' bytes depend on beside the inputs, which `origins` tell.
    """
    if target.kind not in ("pattern", "folder"):
        if resume:
            raise RecipeError(f"--resume goes on with a sequence of pictures; {target.path} is written in one go")
        refuse_outputs(target, footage, force)
        yield None
        return
    mark = Mark(target.mark, hashlib.sha256(json.dumps(key, sort_keys=True, default=str).encode()).hexdigest(), force)
    if resume and target.mark.is_file():
        mark.take_over(str(target.path))
        if footage.count is not None:
            _refuse_changed(target, footage, mark, origins())
    refuse_outputs(target, footage, mark.force, mark)
    mark.begin()
    try:
        yield mark
    except BaseException:
        mark.end(complete=False)
        raise
    mark.end(complete=True)


def _refuse_changed(target: Target, footage: Footage, mark: Mark, origins: Origins) -> None:
    """RecipeError, before anything is read, if pictures are there that are known to be of other frames."""
    for pending in footage.frames:
        mark.keeps(target.file(pending.number, pending.stem), origins.of(pending).origin)
    mark.refuse_others()


# ------------------------------------------------------------------------------------------------------ rendering


@dataclass(frozen=True)
class Look:
    """What makes pictures of outputs."""

    white: Any  # XYZ of the scene's white; None: outputs are written as they are
    exposure: float | None  # None: automatic
    bits: int


@dataclass(frozen=True)
class Unread:
    """A frame that whoever renders it is to read."""

    path: Path
    digest: str  # SHA-256 of the file


@dataclass(frozen=True)
class _Read:
    """A frame that was read or is to be, or why not."""

    pending: Pending
    frame: RawFrame | Unread | None
    brightness: float = 0.0
    error: L3Error | None = None
    kept: bool = False  # its picture is there already
    lost: int = 1  # frames that there are not, if there is an error


Exposed = tuple[Pending, Any, float]  # with the frame and the scale of its exposure, 0: its own


@dataclass
class _Tally:
    """How many frames there are pictures of, and how many were left out."""

    done: int = 0
    failures: int = 0

    def leave_out(self, error: L3Error, skip_bad: bool, count: int = 1) -> None:
        """Say that a frame, or several, are left out; raise why, unless `skip_bad`."""
        if not skip_bad:
            raise error
        self.failures += count
        tell(f"l3: {error}")


def render_frames(
    footage: Footage, target: Target, room: "Here | Elsewhere", table: "TransformTable", look: Look, choice: VideoChoice,
    mark: Mark | None, origins: Origins, skip_bad: bool, quiet: bool,
) -> int:  # fmt: skip
    """Render every frame into the target; how many were left out. What is broken is raised, unless `skip_bad`: then it is
    said."""
    start = time.monotonic()
    steady = SteadyExposure(choice.rate) if is_steady(footage, target, look) else None
    tally, cautions = _Tally(), Cautions(table)
    for numbers in footage.missing:
        tally.leave_out(footage.absent(numbers), skip_bad, len(numbers))
    with _open_sink(target, choice, table.outputs, mark) as (write, threads), Behind(write, DEPTH, threads) as writing:
        meter = LightMeter(table) if steady else None
        reading = ahead(_read(footage, target, meter, mark, origins, room.by_path), DEPTH)
        reading = options.progress(reading, footage.count and footage.count - footage.lost, "frames", quiet)
        exposed = cautions.watched(_exposed(reading, look, steady, skip_bad, tally), footage.stills)
        for pending, made in room.develop(exposed):
            if isinstance(made, L3Error):
                tally.done -= 1
                tally.leave_out(made, skip_bad)
            else:
                writing.put((pending, made))
        if not tally.done:
            raise InputFileError("none of the frames could be read; nothing is written")
    cautions.tell(quiet)
    done, failures = tally.done, tally.failures
    if not footage.stills:
        rate = done / max(time.monotonic() - start, 1e-9)
        options.say(f"{target.path}: {done} frames, {rate:.3g} a second", quiet)
    if failures:
        tell(f"l3: {failures} of {done + failures} frames left out")
    return failures


def is_steady(footage: Footage, target: Target, look: Look) -> bool:
    """Automatic exposure is steady in time, except for stills that become files: each of those has its own."""
    return look.white is not None and look.exposure is None and not (footage.stills and target.one_by_one)


def _read(
    footage: Footage, target: Target, meter: LightMeter | None, mark: Mark | None, origins: Origins, by_path: bool
) -> Iterator[_Read]:
    """Read, and measure, frame after frame; of frames that are kept only what the exposure of later ones needs. `by_path`
    a file that becomes a file, and is not measured, is left to who renders it."""
    size: tuple[int, ...] | None = None
    for pending in footage.frames:
        file, kept = target.file(pending.number, pending.stem), False
        if mark:
            pending = origins.of(pending)
            kept = pending.origin is not None and mark.keeps(file, pending.origin)
        if kept and meter is None and not footage.is_stream:
            yield _Read(pending, None, kept=True)
            continue
        try:
            if by_path and pending.source and target.one_by_one and meter is None:
                yield _Read(pending, Unread(pending.source.absolute(), sha256(pending.source)), kept=kept)
                continue
            frame = pending.read()
            if frame is None:
                if rest := footage.rest(pending.number):
                    yield _Read(pending, None, error=footage.absent(rest), lost=len(rest))
                break
            if not target.one_by_one:
                size = size or _upright_shape(frame)
                _require_size(frame, size)
            brightness = meter.brightness(frame) if meter else 0.0
        except (L3Error, OSError) as error:
            yield _Read(pending, None, error=error if isinstance(error, L3Error) else InputFileError(str(error)))
            continue
        if mark and pending.origin is None:
            pending = origins.of_read(pending, frame)
            kept = mark.keeps(file, pending.origin)
        yield _Read(pending, frame, brightness, kept=kept)
    if mark:
        mark.refuse_others()


def _upright_shape(frame: RawFrame) -> tuple[int, ...]:
    return upright(frame.values, frame.orientation).shape


def _require_size(frame: RawFrame, size: tuple[int, ...]) -> None:
    found = _upright_shape(frame)
    if found != size:
        raise InputFileError(
            f"{frame.name} has {found[0]}×{found[1]} pixels, the video {size[0]}×{size[1]}; give frames of one size"
        )


def _exposed(
    reading: Iterable[_Read], look: Look, steady: SteadyExposure | None, skip_bad: bool, tally: _Tally
) -> Iterator[Exposed]:
    """The frames to render, each with its scale (0: its own exposure); what is broken is raised, or said and counted."""
    for each in reading:
        if each.error is not None:
            tally.leave_out(each.error, skip_bad, each.lost)
            continue
        tally.done += 1
        if each.frame is not None:
            scale = look.exposure or (steady.scale(each.brightness) if steady else 0.0)
            if not each.kept:
                yield each.pending, each.frame, scale


class Here:
    """Renders frames in this process."""

    by_path = False  # whether it reads files itself

    def __init__(self, renderer: "Renderer", look: Look) -> None:
        self._renderer, self._look = renderer, look

    def develop(self, exposed: Iterator[Exposed]) -> Iterator[tuple[Pending, Any]]:
        """Picture, or linear outputs where there is no white, (row, col, value), of each frame, in order.

        Pictures whose exposure is known beforehand overlap on the device: while one is written the next is at work.
        """
        at_work: deque[tuple[Pending, RawFrame]] = deque()

        def displayed() -> Iterator[tuple[RawFrame, Display]]:
            for pending, frame, scale in exposed:
                at_work.append((pending, frame))
                yield frame, _display(self._renderer, frame, self._look, scale)

        if self._look.white is None:
            for pending, frame, _ in exposed:
                yield pending, _linear(self._renderer, frame)
            return
        for picture in self._renderer.pictures(displayed()):
            pending, frame = at_work.popleft()
            yield pending, upright(picture, frame.orientation)


def pixels_of(renderer: "Renderer", frame: RawFrame, look: Look, scale: float) -> Any:
    """What `Here` makes of a frame."""
    if look.white is None:
        return _linear(renderer, frame)
    return upright(renderer.picture(frame, _display(renderer, frame, look, scale)), frame.orientation)


def _linear(renderer: "Renderer", frame: RawFrame) -> Any:
    return upright(np.moveaxis(renderer.outputs(frame), 0, -1), frame.orientation)


def _display(renderer: "Renderer", frame: RawFrame, look: Look, scale: float) -> Display:
    # The exposure of one frame alone needs the whole frame's luminance before the first value is encoded: two runs.
    return make_display(look.white, scale or automatic_exposure(renderer.outputs(frame)[1]), look.bits)


def file_of(path: Path, made: Any, outputs: tuple[str, ...]) -> bytes:
    """The content of a picture's file, or of one of linear outputs if its name asks for them."""
    return images.linear_file(path, made, outputs) if images.is_linear(path) else images.picture_file(path, made)


@contextlib.contextmanager
def _open_sink(
    target: Target, choice: VideoChoice, outputs: tuple[str, ...], mark: Mark | None
) -> Iterator[tuple[Callable[[tuple[Pending, Any]], None], int]]:
    """What writes a frame, and the number of threads that may do so at a time."""
    if target.one_by_one:

        def write(item: tuple[Pending, Any]) -> None:
            pending, made = item
            file = target.file(pending.number, pending.stem)
            content = made if isinstance(made, bytes) else file_of(file, made, outputs)
            with atomic_output(file) as temporary:
                temporary.write_bytes(content)
                if mark:
                    mark.add(file, temporary, pending.origin)

        yield write, PICTURE_WRITERS
    elif target.kind == "stream" or target.path.suffix.lower() == ".y4m":
        with new_y4m(None if target.kind == "stream" else target.path, choice) as stream:
            yield lambda item: stream.write(item[1]), 1
    else:
        with new_video(target.path, choice) as video:
            yield lambda item: video.write(item[1]), 1
