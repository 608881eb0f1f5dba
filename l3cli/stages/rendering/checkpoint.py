"""Checkpoint of a run that makes pictures: which of them it has made, and of which frames, so that the same run goes on, or
does nothing if it had ended; the part that a shard makes; and the plan of a run.

Size and time identify a file: digests would take as long as a tenth of the rendering. Only where a frame's file has these
and another inode, or one that was touched since, does the digest decide that its picture states.
"""

import contextlib
import hashlib
import json
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.frames.frame import RawFrame
from l3cli.io.destination import Destination, refuse_outputs
from l3cli.io.pictures.registry import file_identity
from l3cli.io.raw.files import RawOverrides
from l3cli.io.sequences import FrameReference, FrameSequence
from l3cli.io.video import USUAL_RATE, VideoChoice
from l3cli.options.render import GAIN, RenderOptions
from l3cli.rendering.temporal.chunks import CHUNK
from l3cli.system.checkpoint import Checkpoint, key_in
from l3cli.system.files import FINISHED, UNFINISHED, FilesUsed, dated, files_to_read, fingerprint, sha256
from l3cli.system.limits import read_bounded
from l3cli.system.text import counted


def overrides(options: RenderOptions) -> RawOverrides:
    """Return what the options state about raw files; InputFileError if the list of gains cannot be read."""
    levels = options.black_level, options.white_level, options.phase
    gains = gains_in(options.gains) if options.gains else ()
    return RawOverrides(
        *levels, options.size, options.packing, options.stride, options.exposure_time, options.gain, gains,
        skip=options.skip, byte_order=options.byte_order, opcodes=options.opcodes,
    )  # fmt: skip


def gains_in(path: Path) -> tuple[float, ...]:
    """Return the analog gains that a text file lists; InputFileError if it holds anything else, or none."""
    gains, give = [], "give a text file of the gain of each frame, a line each"
    for number, text in enumerate(read_bounded(path, give).decode(errors="replace").split(), 1):
        try:
            gains.append(float(GAIN.read(text)))
        except ValueError as error:
            raise InputFileError(f"{path}: gain {number}: {error}") from None
    if not gains:
        raise InputFileError(f"{path} is empty; {give}")
    return tuple(gains)


def video_choice(options: RenderOptions) -> VideoChoice:
    """Return how videos are encoded."""
    return VideoChoice(options.fps or USUAL_RATE, options.bits, options.codec, options.crf, options.preset)


def part_of(sequence: FrameSequence, shard: tuple[int, int], temporal: bool) -> range:
    """Return the places, from 0, of the frames that a shard (number from 1, of how many) renders; of a sequence that is
    filtered in time whole chunks, where each shard has one. RecipeError if nobody knows how many frames there are, or they
    are too few."""
    number, shards = shard
    if sequence.count is None:
        raise RecipeError(f"{sequence.what} does not say how many frames it has; choose those of all shards with ‹frames›")
    count = sequence.count - sequence.lost
    if count < shards:
        raise RecipeError(f"{sequence.what} has {counted(count, 'frame')}, too few for {shards} shards")
    # A shard that begins within a chunk filters what lies before it there, too.
    grid = CHUNK if temporal and count >= shards * CHUNK else 1
    first, last = (count * index // shards for index in (number - 1, number))
    return range(_nearest(first, grid), count if number == shards else _nearest(last, grid))


def _nearest(place: int, grid: int) -> int:
    """Round halves up, so that places at least `grid` apart stay apart."""
    return (place + grid // 2) // grid * grid


def input_files(table: Path, inputs: Sequence[Path], sequence: FrameSequence, options: RenderOptions) -> FilesUsed:
    """Return the files that are read. Frames of a stream, which may be endless, are not listed."""
    frames = [] if sequence.is_stream else [frame for place, frame in enumerate(sequence.frames) if sequence.renders(place)]
    files = [reference.source for reference in frames if reference.source is not None]
    return files_to_read({"table": [table], "inputs": files or inputs, "dark frames": options.dark})


class PictureCheckpoint(Checkpoint):
    """The checkpoint of pictures, each by its name: state of its file, origin of its frame, inode of the frame's file, and
    the identity that the picture states of its frame."""

    def __init__(self, path: Path, key: str, force: bool) -> None:
        super().__init__(path, key, force)
        self._unasked: set[str] = set()  # pictures whose frames have not come up yet

    @property
    def finished(self) -> Path:
        """Return the file that lists the pictures of a run that has ended, from which frames that came since are told."""
        return self.path.with_name(self.path.name.removesuffix(UNFINISHED) + FINISHED)

    def begin(self) -> None:
        super().begin()
        self.finished.unlink(missing_ok=True)

    def go_on(self, made_by: Path) -> None:
        """Continue where the run that wrote the checkpoint stopped or ended; RecipeError, naming the output, if another
        did."""
        if not self.take_over(self.path if self.path.is_file() else self.finished):
            raise RecipeError(f"{made_by} holds a run with another table, inputs or options; leave ‹resume› out")
        self.items = {name: made for name, made in self.items.items() if self._is_there(name, made)}
        self._unasked = set(self.items)

    def _is_there(self, name: str, made: list[Any]) -> bool:
        return dated(self.path.with_name(name)) == made[0]

    def is_ours(self, file: Path) -> bool:
        """Return whether a file exists that the run has made."""
        return file.name in self.items and self._is_there(file.name, self.items[file.name])

    def has(self, file: Path, reference: FrameReference) -> bool:
        """Return whether the picture of a frame exists already; RecipeError if it was made of something else. Without an
        origin nothing can be said yet."""
        self._unasked.discard(file.name)
        if reference.origin is None or not self.is_ours(file):
            return False
        _, origin, inode, identity = self.items[file.name]
        source, same_file = reference.source, inode == list(reference.inode or ())
        if origin != reference.origin or not (same_file or (source and identity == file_identity(sha256(source)))):
            raise RecipeError(f"{file} was made of another input than is given now; leave ‹resume› out")
        return True

    def refuse_others(self) -> None:
        """Raise RecipeError if pictures are there whose frames have not come up."""
        if self._unasked:
            raise RecipeError(
                f"{self.path.with_name(min(self._unasked))} was made of a frame that is not given now; leave ‹resume› out"
            )

    def made(self, file: Path, temporary: Path, reference: FrameReference) -> None:
        """List a picture of a frame that is about to get its name."""
        self.add(file.name, [dated(temporary), reference.origin, list(reference.inode or ()), reference.identity])


def listed_pictures(path: Path) -> list[Path]:
    """Return the pictures that a stopped run has made, by its checkpoint, and nobody has changed since."""
    found = Checkpoint(path, key_in(path) or "")
    found.take_over()
    named = {path.with_name(name): made[0] for name, made in found.items.items()}
    return [picture for picture, state in named.items() if dated(picture) == state]


class FrameDigests:
    """Record of what pictures are made of, frame by frame: by file, number, size and time; by content where there is no file
    to go by. `all_before`: the exposure of a frame depends on every one before it, and so does its picture."""

    def __init__(self, whole: Path, all_before: bool) -> None:
        self._whole, self._all_before = whole, all_before  # `whole`: the file of frames that are no files
        self._before = ""

    def of(self, reference: FrameReference) -> FrameReference:
        """Return the frame with its origin, if that is known before it is read; ask before, lest it change in between."""
        source = reference.source or self._whole
        if not source.is_file():
            return reference
        size, changed, *inode = fingerprint(source)
        known = self._with_origin(reference, [os.path.realpath(source), reference.number, size, changed])
        return replace(known, inode=tuple(inode))

    def of_read(self, reference: FrameReference, frame: RawFrame) -> FrameReference:
        """Return the frame with its origin."""
        if reference.origin is not None:
            return reference
        return self._with_origin(reference, [reference.number, hashlib.sha256(frame.values.tobytes()).hexdigest()])

    def _with_origin(self, reference: FrameReference, identity: list) -> FrameReference:
        origin = hashlib.sha256(json.dumps([self._before, *identity]).encode()).hexdigest()
        if self._all_before:
            self._before = origin
        return replace(reference, origin=origin)


@contextlib.contextmanager
def checkpointed(
    destination: Destination, key: str, options: RenderOptions, sequence: FrameSequence, digests: Callable[[], FrameDigests]
) -> Iterator[PictureCheckpoint | None]:
    """Refuse what cannot be written, then keep the checkpoint of the run `key`, for a sequence of pictures, until all is
    done. `digests`: of its frames."""
    if destination.kind not in ("pattern", "folder"):
        if options.resume:
            raise RecipeError(f"‹resume› goes on with a sequence of pictures; {destination.path} is written in one go")
        refuse_outputs(destination, sequence, options.force)
        yield None
        return
    checkpoint = PictureCheckpoint(destination.checkpoint, key, options.force)
    is_ours = checkpoint.is_ours
    if options.resume and (checkpoint.path.is_file() or checkpoint.finished.is_file()):
        checkpoint.go_on(destination.path)
        if sequence.count is not None:
            _refuse_changed(destination, sequence, checkpoint, digests())
    elif options.resume:
        is_ours = _refuse_unknown
    refuse_outputs(destination, sequence, checkpoint.force, is_ours)
    checkpoint.begin()
    try:
        yield checkpoint
    except BaseException:
        if not checkpoint.items:
            checkpoint.end()
        raise
    checkpoint.end(checkpoint.finished)


def _refuse_unknown(file: Path) -> bool:
    """Raise L3Error if a picture is there that no run has listed."""
    if file.is_file():
        raise L3Error(f"{file} exists, and nothing says of which run it is; add ‹force› to render it again")
    return False


def _refuse_changed(
    destination: Destination, sequence: FrameSequence, checkpoint: PictureCheckpoint, digests: FrameDigests
) -> None:
    """Raise RecipeError, before anything is read, if pictures are there that are known to be of other frames."""
    for place, reference in enumerate(sequence.frames):
        reference = digests.of(reference)  # which may tell of every frame before
        if sequence.renders(place):
            checkpoint.has(destination.file(reference.number, reference.stem), reference)
    checkpoint.refuse_others()
