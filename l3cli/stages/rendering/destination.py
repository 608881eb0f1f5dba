"""Destination of pictures, the files that exist there already, and the checkpoint that lets a sequence of them go on."""

import contextlib
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from l3cli.errors import RecipeError
from l3cli.io.file_names import PATTERN, last_number, numbered_files, numbered_name
from l3cli.io.frame_times import Pacing
from l3cli.io.pictures.pages import PAGED, new_pages
from l3cli.io.pictures.registry import FLOAT_BITS, Picture, format_of, holds_linear, holds_raw
from l3cli.io.raw.files import RawOverrides
from l3cli.io.sequences import FrameReference, FrameSequence
from l3cli.io.video import USUAL_RATE, Y4M, VideoChoice, check_video, is_video, new_video, new_y4m
from l3cli.options.render import RenderOptions
from l3cli.stages.claims import OutputGuard, refuse_unwritable
from l3cli.stages.rendering.mark import Mark, Origins
from l3cli.stages.rendering.rendition import Rendition, file_of
from l3cli.system.files import atomic_output, refuse_existing, refuse_protected
from l3cli.system.locks import sole_writer_of_folder

PICTURE_WRITERS = 2  # threads that compress picture files
STDOUT = Path("-")


@dataclass(frozen=True)
class Destination:
    """Destination of pictures: "stream" (y4m to stdout), "video", "pattern" (numbered files), "folder", a single "file",
    or "pages" of one."""

    path: Path
    kind: str
    suffix: str  # of the files in a folder
    bits: int = 8  # of a value
    shard: tuple[int, int] | None = None  # that is written, number from 1 of how many

    @property
    def one_by_one(self) -> bool:
        """Return whether every frame becomes a file."""
        return self.kind in ("pattern", "folder", "file")

    @property
    def pictures(self) -> bool:
        """Return whether every frame becomes a picture by itself, be it a file or a page."""
        return self.one_by_one or self.kind == "pages"

    @property
    def linear(self) -> bool:
        """Return whether linear values are written rather than codes."""
        return self.one_by_one and holds_linear(self.file(0, "frame"), self.bits)

    @property
    def raw(self) -> bool:
        """Return whether files for raw developers are written."""
        return self.one_by_one and holds_raw(self.file(0, "frame"))

    @property
    def has_times(self) -> bool:
        """Return whether every frame has a time of its own."""
        return self.kind == "video" and self.path.suffix.lower() != Y4M

    def file(self, number: int, stem: str) -> Path:
        """The file of a frame."""
        if self.kind == "pattern":
            return numbered_name(self.path, number)
        return self.path / f"{stem}.{self.suffix}" if self.kind == "folder" else self.path

    @property
    def file_suffix(self) -> str | None:
        """Suffix of every file, where every frame becomes one."""
        return self.file(0, "frame").suffix if self.one_by_one else None

    @property
    def mark(self) -> Path:
        """Lies beside the pictures while a run lasts, and identifies it to `--resume`."""
        name = f"{self._of_shard}.l3-render"
        return self.path / name if self.kind == "folder" else self.path.with_name(f".{self.path.name}{name}")

    @property
    def lock(self) -> tuple[Path, str]:
        """The folder, and what tells these pictures from others in it, of the lock that other runs respect: shards of a
        sequence are written side by side."""
        folder, name = (self.path, "") if self.kind == "folder" else (self.path.parent, self.path.name)
        return folder, name + self._of_shard

    @property
    def _of_shard(self) -> str:
        return "" if self.shard is None else ".{}-of-{}".format(*self.shard)


def overrides(options: RenderOptions) -> RawOverrides:
    """Return what the options state about raw files."""
    levels = options.black_level, options.white_level, options.phase
    return RawOverrides(*levels, options.size, options.packing, options.stride, options.exposure_time)


def video_choice(options: RenderOptions) -> VideoChoice:
    """Return how videos are encoded."""
    return VideoChoice(options.fps or USUAL_RATE, options.bits, options.codec, options.crf, options.preset)


def destination_of(output: Path, options: RenderOptions) -> Destination:
    """The destination that a name asks for; RecipeError if nothing of that name can be written."""
    suffix, choice, shard = options.format, video_choice(options), options.shard
    if choice.bits == FLOAT_BITS and (output == STDOUT or is_video(output)):
        raise RecipeError("values of 32 bits are for pictures; name a .tif or .exr, or leave ‹bits› out")
    if output == STDOUT:
        destination = Destination(output, "stream", suffix, shard=shard)
        check_video(Path("stdout.y4m"), choice)
        if sys.stdout.isatty():
            raise RecipeError("a y4m stream is not for a terminal; pipe it on, or name a file with -o")
    elif is_video(output):
        destination = Destination(output, "video", suffix, shard=shard)
        check_video(output, choice)
    else:
        kind = "file" if output.suffix and not output.is_dir() else "folder"
        destination = Destination(output, "pattern" if PATTERN.search(output.name) else kind, suffix, choice.bits, shard)
        format_of(destination.file(0, "frame"), choice.bits)
        if choice.codec or choice.crf is not None:
            raise RecipeError(f"{output}: ‹codec› and ‹crf› are for videos; name a .mp4, .mov or .mkv")
    return destination


def paged(destination: Destination, sequence: FrameSequence) -> Destination:
    """The destination with pages, if it is a single file that can have them and there are several frames."""
    if destination.kind == "file" and sequence.rendered != 1 and destination.path.suffix.lower() in PAGED:
        return replace(destination, kind="pages")
    return destination


def claim(destination: Destination, force: bool, claims: OutputGuard) -> None:
    """L3Error, before anything is read, if nothing can be written there, another run does so, or a video or single picture
    is there already; RecipeError if that is read."""
    if destination.kind in ("video", "file"):
        claims.claim_file(destination.path, force)
    elif destination.kind == "stream":
        refuse_protected(1)
    else:
        refuse_unwritable(destination.file(0, "frame"))
        claims.hold(sole_writer_of_folder(*destination.lock), destination.path)


def refuse_outputs(destination: Destination, sequence: FrameSequence, force: bool, mark: Mark | None = None) -> None:
    """RecipeError if the frames do not fit into the destination or would replace what is read, L3Error if they would replace
    what is there and not of the mark's run."""
    if destination.kind == "file" and sequence.rendered != 1:
        count = "a sequence" if sequence.rendered is None else f"{sequence.rendered} frames"
        raise RecipeError(
            f"{destination.path} holds one picture, the inputs are {count}; name a folder, a pattern "
            f"({destination.path.stem}_%04d{destination.path.suffix}), a .tif or a video"
        )
    if destination.kind not in ("pattern", "folder"):
        return
    if sequence.is_stream:
        files = _existing(destination, sequence)
    else:
        pictures = (pending for place, pending in enumerate(sequence.frames) if sequence.renders(place))
        files = [destination.file(pending.number, pending.stem) for pending in pictures]
    if len(set(files)) < len(files):
        raise RecipeError("two inputs have the same name and would write the same file; render them one by one")
    for file in files:
        refuse_protected(file)
        refuse_existing(file, force or (mark is not None and mark.is_ours(file)))


def refuse_missing(sequence: FrameSequence) -> None:
    """InputFileError if it is known already that a frame is missing."""
    if sequence.missing:
        raise sequence.absent(sequence.missing[0])


def _existing(destination: Destination, sequence: FrameSequence) -> list[Path]:
    """Pictures that are there and that frames of a stream, which may be endless, would replace."""
    if sequence.wanted is None:
        return _pictures(destination)
    wanted = sequence.wanted if sequence.part is None else sequence.wanted[sequence.part.start : sequence.part.stop]
    if destination.kind == "pattern":
        return [file for number, file in numbered_files(destination.path).items() if number in wanted]
    numbers = {last_number(file) for file in _pictures(destination)}
    frames = [sequence.frames.pending(number) for number in numbers if number is not None and number in wanted]
    return [destination.file(pending.number, pending.stem) for pending in frames]


def _pictures(destination: Destination) -> list[Path]:
    """The files that are there in a folder or of a pattern."""
    if destination.kind == "pattern":
        return list(numbered_files(destination.path).values())
    return sorted(destination.path.glob(f"*.{destination.suffix}"))


@contextlib.contextmanager
def marked(
    destination: Destination,
    key: str,
    options: RenderOptions,
    sequence: FrameSequence,
    origins: Callable[[], Origins],
) -> Iterator[Mark | None]:
    """Refuse what cannot be written, then keep the mark of the run `key`, for a sequence of pictures, until all is done.

    `origins`: of its inputs.
    """
    resume, force = options.resume, options.force
    if destination.kind not in ("pattern", "folder"):
        if resume:
            raise RecipeError(f"‹resume› goes on with a sequence of pictures; {destination.path} is written in one go")
        refuse_outputs(destination, sequence, force)
        yield None
        return
    mark = Mark(destination.mark, key, force)
    if resume and destination.mark.is_file():
        mark.take_over(str(destination.path))
        if sequence.count is not None:
            _refuse_changed(destination, sequence, mark, origins())
    refuse_outputs(destination, sequence, mark.force, mark)
    mark.begin()
    try:
        yield mark
    except BaseException:
        mark.end(complete=False)
        raise
    mark.end(complete=True)


def _refuse_changed(destination: Destination, sequence: FrameSequence, mark: Mark, origins: Origins) -> None:
    """RecipeError, before anything is read, if pictures are there that are known to be of other frames."""
    for place, pending in enumerate(sequence.frames):
        pending = origins.of(pending)  # which may tell of every frame before
        if sequence.renders(place):
            mark.keeps(destination.file(pending.number, pending.stem), pending)
    mark.refuse_others()


@contextlib.contextmanager
def open_sink(
    destination: Destination, choice: VideoChoice, rendition: Rendition, outputs: tuple[str, ...], mark: Mark | None,
    sequence: FrameSequence, pacing: Pacing,
) -> Iterator[tuple[Callable[[tuple[FrameReference, Any]], None], int]]:  # fmt: skip
    """Open the writer of frames; give it and the number of threads that may call it at a time."""

    def timed(write: Callable[[Any, int], None]) -> Callable[[tuple[FrameReference, Any]], None]:
        return lambda item: write(item[1], pacing.time(item[0].number))

    if destination.one_by_one:

        def write(item: tuple[FrameReference, Any]) -> None:
            pending, made = item
            file = destination.file(pending.number, pending.stem)
            content = made if isinstance(made, bytes) else file_of(file, made, rendition, outputs)
            with atomic_output(file) as temporary:
                temporary.write_bytes(content)
                if mark:
                    mark.add(file, temporary, pending)

        yield write, PICTURE_WRITERS
    elif destination.kind == "pages":
        with new_pages(destination.path, sequence.rendered) as pages:
            yield timed(lambda made, _: pages.write(Picture(made.pixels, rendition.space, made.label))), 1
    elif not destination.has_times:
        with new_y4m(None if destination.kind == "stream" else destination.path, choice) as stream:
            yield timed(lambda made, _: stream.write(made.pixels)), 1
    else:
        with new_video(destination.path, choice) as video:
            yield timed(lambda made, time: video.write(made.pixels, time)), 1
