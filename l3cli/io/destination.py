"""Destinations of rendered pictures: a file, the pages of a file, a folder, numbered files, a video or a stream.

The module derives the destination from the output name, checks for existing files, and opens the destination for writing.
"""

import contextlib
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from l3cli.errors import RecipeError
from l3cli.io.file_names import PATTERN, last_number, numbered_files, numbered_name
from l3cli.io.pictures.openimageio import PAGED, new_pages
from l3cli.io.pictures.registry import format_of, holds_linear, holds_raw, picture_file
from l3cli.io.sequences import FrameReference, FrameSequence
from l3cli.io.video import Y4M, Pacing, VideoChoice, check_video, is_video, new_video, new_y4m
from l3cli.physics.display import FLOAT_BITS
from l3cli.system.files import UNFINISHED, atomic_output, refuse_existing, refuse_protected, shortened
from l3cli.system.locks import sole_writer_of_folder
from l3cli.system.outputs import OutputGuard, refuse_unwritable

STDOUT = Path("-")
PICTURE_WRITERS = 2  # number of threads that compress picture files


@dataclass(frozen=True)
class Destination:
    """Where rendered pictures are written."""

    path: Path
    # "stream" (y4m on stdout), "video", "pattern" (numbered files), "folder", "file" (one picture) or "pages" (TIFF)
    kind: str
    suffix: str  # suffix of the files in a folder, without a period
    bits: int = 8  # bits per value
    shard: tuple[int, int] | None = None  # number of the shard (counted from 1) and of all shards; None without shards

    @property
    def one_by_one(self) -> bool:
        """Whether each frame is written to a separate file."""
        return self.kind in ("pattern", "folder", "file")

    @property
    def pictures(self) -> bool:
        """Whether each frame becomes a separate picture: a file, or a page of a file."""
        return self.one_by_one or self.kind == "pages"

    @property
    def linear(self) -> bool:
        """Whether the files contain linear values instead of integer codes."""
        return self.one_by_one and holds_linear(self.file(0, "frame"), self.bits)

    @property
    def raw(self) -> bool:
        """Whether the files are raw files (DNG) for raw converters."""
        return self.one_by_one and holds_raw(self.file(0, "frame"))

    @property
    def has_times(self) -> bool:
        """Whether the destination stores each frame's time instead of a constant frame rate."""
        return self.kind == "video" and self.path.suffix.lower() != Y4M

    def file(self, number: int, stem: str) -> Path:
        """Return the output file of a frame. `stem`, its file name without suffix, is used only in a folder."""
        if self.kind == "pattern":
            return numbered_name(self.path, number)
        return self.path / f"{stem}.{self.suffix}" if self.kind == "folder" else self.path

    @property
    def file_suffix(self) -> str | None:
        """Suffix of the files if each frame is written to a separate file, otherwise None."""
        return self.file(0, "frame").suffix if self.one_by_one else None

    @property
    def checkpoint(self) -> Path:
        """Path of the checkpoint file, in the same folder as the pictures. Each shard has its own checkpoint file."""
        ending = f"{self._of_shard}{UNFINISHED}"
        if self.kind == "folder":
            return self.path / ending
        return self.path.with_name(f".{shortened(self.path.name, len(ending) + 1)}{ending}")

    @property
    def lock(self) -> tuple[Path, str]:
        """Folder and name of the lock that keeps other runs from writing to the destination. Each shard has its own."""
        folder, name = (self.path, "") if self.kind == "folder" else (self.path.parent, self.path.name)
        return folder, name + self._of_shard

    @property
    def _of_shard(self) -> str:
        return "" if self.shard is None else ".{}-of-{}".format(*self.shard)


def destination_of(output: Path, suffix: str, choice: VideoChoice, shard: tuple[int, int] | None) -> Destination:
    """Derive the destination from the output name.

    Parameters
    ----------
    output : Path
        A file, a folder, a pattern of numbered files, or "-" for stdout.
    suffix : str
        Suffix of the files in a folder, without a period.
    choice : VideoChoice
        Bits per value, codec and other settings.
    shard : tuple of int, optional
        Number of the shard, counted from 1, and total number of shards.

    Returns
    -------
    Destination
        The destination. An output such as "out.tif" is first treated as a single picture ("file"), because the number of
        frames is not yet known. `paged` later changes it to "pages" if there are several frames.

    Raises
    ------
    RecipeError
        If l3 cannot write this type of output, or if the type does not support the settings.
    """
    if choice.bits == FLOAT_BITS and (output == STDOUT or is_video(output)):
        raise RecipeError("videos cannot store 32 bits per value; write a .tif or .exr file, or remove ‹bits›")
    if output == STDOUT:
        destination = Destination(output, "stream", suffix, shard=shard)
        check_video(Path("stdout.y4m"), choice)
        if sys.stdout.isatty():
            raise RecipeError(
                "a y4m stream cannot be shown in a terminal; pipe the stream to another program, or specify a file with -o"
            )
    elif is_video(output):
        destination = Destination(output, "video", suffix, shard=shard)
        check_video(output, choice)
    else:
        kind = "file" if output.suffix and not output.is_dir() else "folder"
        destination = Destination(output, "pattern" if PATTERN.search(output.name) else kind, suffix, choice.bits, shard)
        format_of(destination.file(0, "frame"), choice.bits)
        if choice.codec or choice.crf is not None:
            raise RecipeError(f"{output}: ‹codec› and ‹crf› apply only to videos; write a .mp4, .mov or .mkv")
    return destination


def paged(destination: Destination, sequence: FrameSequence) -> Destination:
    """Turn a single TIFF file into a multi-page TIFF file if several frames are rendered to it.

    Any other destination is returned unchanged.
    """
    if destination.kind == "file" and sequence.rendered != 1 and destination.path.suffix.lower() in PAGED:
        return replace(destination, kind="pages")
    return destination


def guard_outputs(destination: Destination, may_exist: bool, guard: OutputGuard) -> None:
    """Check and lock a destination before any input is read.

    Parameters
    ----------
    destination : Destination
        The destination.
    may_exist : bool
        Whether a video or a single picture may already exist. Files in a folder are checked later, by `refuse_outputs`.
    guard : OutputGuard
        Keeps the lock until the stage ends.

    Raises
    ------
    L3Error
        If the destination is not writable, if another run is writing to it, or if it exists although `may_exist` is False.
    RecipeError
        If the output is also an input.
    """
    if destination.kind in ("video", "file"):
        guard.guard_file(destination.path, may_exist)
    elif destination.kind == "stream":
        refuse_protected(1)
    else:
        refuse_unwritable(destination.file(0, "frame"))
        guard.hold(sole_writer_of_folder(*destination.lock), destination.path)


def refuse_outputs(
    destination: Destination, sequence: FrameSequence, force: bool, is_ours: Callable[[Path], bool] = lambda file: False
) -> None:
    """Raise an error if the frames cannot be written to the destination.

    Parameters
    ----------
    destination : Destination
        The destination.
    sequence : FrameSequence
        The frames.
    force : bool
        Whether existing files may be replaced.
    is_ours : callable
        Function that takes an existing file and returns whether it may be replaced even without `force`. [default: no file]

    Raises
    ------
    RecipeError
        If there are several frames but the destination can store only one, if two frames would be written to the same file,
        or if a file would replace an input.
    L3Error
        If a file exists and must not be replaced.
    """
    if destination.kind == "file" and sequence.rendered != 1:
        count = "a sequence" if sequence.rendered is None else f"{sequence.rendered} frames"
        raise RecipeError(
            f"{destination.path} can store only one picture, but the inputs are {count}; write to a folder, a pattern "
            f"({destination.path.stem}_%04d{destination.path.suffix}), a .tif file or a video"
        )
    if destination.kind == "stream":
        return
    if destination.kind not in ("pattern", "folder"):
        files = [destination.path]
    elif sequence.is_stream:
        files = _existing(destination, sequence)
    else:
        pictures = (reference for place, reference in enumerate(sequence.frames) if sequence.renders(place))
        files = [destination.file(reference.number, reference.stem) for reference in pictures]
    if len(set(files)) < len(files):
        raise RecipeError("two inputs have the same name and the same output file; render these inputs separately")
    for file in files:
        refuse_protected(file)
        refuse_existing(file, force or is_ours(file))


def _existing(destination: Destination, sequence: FrameSequence) -> list[Path]:
    """Return the existing picture files that rendering a stream could overwrite, without reading the stream."""
    if sequence.wanted is None:
        return _pictures(destination)
    wanted = sequence.wanted if sequence.part is None else sequence.wanted[sequence.part.start : sequence.part.stop]
    if destination.kind == "pattern":
        return [file for number, file in numbered_files(destination.path).items() if number in wanted]
    numbers = {last_number(file) for file in _pictures(destination)}
    frames = [sequence.frames.reference(number) for number in numbers if number is not None and number in wanted]
    return [destination.file(reference.number, reference.stem) for reference in frames]


def _pictures(destination: Destination) -> list[Path]:
    """Return the existing files that match the destination's pattern or, in a folder, its suffix."""
    if destination.kind == "pattern":
        return list(numbered_files(destination.path).values())
    return sorted(destination.path.glob(f"*.{destination.suffix}"))


@contextlib.contextmanager
def sink_of(
    destination: Destination, sequence: FrameSequence, choice: VideoChoice, pacing: Pacing,
    before_rename: Callable[[Path, Path, FrameReference | None], None],
) -> Iterator[tuple[Callable[[tuple[FrameReference, Any]], None], int]]:  # fmt: skip
    """Context manager that opens a destination and yields a function that writes frames to it.

    Parameters
    ----------
    destination : Destination
        The destination.
    sequence : FrameSequence
        The frames that will be written.
    choice : VideoChoice
        Video settings.
    pacing : Pacing
        Converts frame numbers to times in a video.
    before_rename : callable
        Function that is called when a file is complete but still has its temporary name. Its arguments are the final path,
        the temporary path, and the frame, or None if the file contains all frames.

    Yields
    ------
    callable
        Function that writes a frame. Its argument is a tuple (FrameReference, picture).
    int
        Number of threads that may call this function at the same time.
    """
    path = destination.path

    def timed(write: Callable[[Any, int], None]) -> Callable[[tuple[FrameReference, Any]], None]:
        return lambda item: write(item[1], pacing.time(item[0].number))

    if destination.one_by_one:

        def write(item: tuple[FrameReference, Any]) -> None:
            reference, picture = item
            file = destination.file(reference.number, reference.stem)
            content = picture if isinstance(picture, bytes) else picture_file(file, picture)
            with atomic_output(file) as temporary:
                temporary.write_bytes(content)
                before_rename(file, temporary, reference)

        yield write, PICTURE_WRITERS
    elif destination.kind == "pages":
        with new_pages(path, sequence.rendered, lambda temporary: before_rename(path, temporary, None)) as pages:
            yield timed(lambda picture, _: pages.write(picture)), 1
    elif not destination.has_times:
        output = None if destination.kind == "stream" else path
        with new_y4m(output, choice, lambda temporary: before_rename(path, temporary, None)) as stream:
            yield timed(lambda picture, _: stream.write(picture.pixels)), 1
    else:
        with new_video(path, choice, lambda temporary: before_rename(path, temporary, None)) as video:
            yield timed(lambda picture, time: video.write(picture.pixels, time)), 1
