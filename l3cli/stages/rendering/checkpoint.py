"""The checkpoint of a sequence of pictures: which of them a stopped run has made, and of which frames.

Size and time identify a file: digests would take as long as a tenth of the rendering. Only where a frame's file has these
and another inode, or one that was touched since, does the digest decide that its picture states.
"""

import contextlib
import hashlib
import json
import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from l3cli.errors import RecipeError
from l3cli.frames.frame import RawFrame
from l3cli.io.pictures.registry import file_identity
from l3cli.io.sequences import FrameReference, FrameSequence
from l3cli.options.render import RenderOptions
from l3cli.stages.rendering.destination import Destination, refuse_outputs
from l3cli.system.checkpoint import Checkpoint, key_in
from l3cli.system.files import sha256
from l3cli.system.ledger import fingerprint


def file_state(path: Path) -> list[int] | None:
    """Return size and time of a regular file; None if there is none."""
    return list(fingerprint(path)[:2]) if path.is_file() else None


class PictureCheckpoint(Checkpoint):
    """The checkpoint of pictures, each by its name: state of its file, origin of its frame, inode of the frame's file, and
    the identity that the picture states of its frame."""

    def __init__(self, path: Path, key: str, force: bool = False) -> None:
        super().__init__(path, key, force)
        self._unasked: set[str] = set()  # pictures whose frames have not come up yet

    def go_on(self, made_by: Path) -> None:
        """Go on where the run that wrote the checkpoint stopped; RecipeError, naming the output, if that was another one."""
        if not self.take_over():
            raise RecipeError(f"{made_by} holds a run with another table, inputs or options; leave ‹resume› out")
        self.items = {name: made for name, made in self.items.items() if self._is_there(name, made)}
        self._unasked = set(self.items)

    def _is_there(self, name: str, made: list[Any]) -> bool:
        return bool(file_state(self.path.with_name(name)) == made[0])

    def is_ours(self, file: Path) -> bool:
        """Return whether a file exists that the run has made."""
        return file.name in self.items and self._is_there(file.name, self.items[file.name])

    def keeps(self, file: Path, pending: FrameReference) -> bool:
        """Return whether the picture of a frame exists already; RecipeError if it was made of something else. Without an
        origin nothing can be said yet."""
        self._unasked.discard(file.name)
        if pending.origin is None or not self.is_ours(file):
            return False
        _, origin, inode, identity = self.items[file.name]
        same = inode == list(pending.inode or ()) or (pending.source and identity == file_identity(sha256(pending.source)))
        if origin != pending.origin or not same:
            raise RecipeError(f"{file} was made of another input than is given now; leave ‹resume› out")
        return True

    def refuse_others(self) -> None:
        """RecipeError if pictures are there whose frames have not come up."""
        if self._unasked:
            raise RecipeError(
                f"{self.path.with_name(min(self._unasked))} was made of a frame that is not given now; leave ‹resume› out"
            )

    def made(self, file: Path, temporary: Path, pending: FrameReference) -> None:
        """List a picture of a frame that is about to get its name."""
        self.add(file.name, [file_state(temporary), pending.origin, list(pending.inode or ()), pending.identity])


def listed_pictures(path: Path) -> list[Path]:
    """Return the pictures that a stopped run has made, by its checkpoint, and nobody has changed since."""
    found = Checkpoint(path, key_in(path) or "")
    found.take_over()
    named = {path.with_name(name): made[0] for name, made in found.items.items()}
    return [picture for picture, state in named.items() if file_state(picture) == state]


class FrameOrigins:
    """Records what pictures are made of, frame by frame: by file, number, size and time; by content where there is no file
    to go by. `all_before`: the exposure of a frame depends on every one before it, and so does its picture."""

    def __init__(self, whole: Path, all_before: bool) -> None:
        self._whole, self._all_before = whole, all_before  # `whole`: the file of frames that are no files
        self._before = ""

    def of(self, pending: FrameReference) -> FrameReference:
        """The frame with its origin, if that is known before it is read; ask before, lest it change in between."""
        source = pending.source or self._whole
        if not source.is_file():
            return pending
        size, changed, *inode = fingerprint(source)
        known = self._with_origin(pending, [os.path.realpath(source), pending.number, size, changed])
        return replace(known, inode=tuple(inode))

    def of_read(self, pending: FrameReference, frame: RawFrame) -> FrameReference:
        """The frame with its origin."""
        if pending.origin is not None:
            return pending
        return self._with_origin(pending, [pending.number, hashlib.sha256(frame.values.tobytes()).hexdigest()])

    def _with_origin(self, pending: FrameReference, identity: list) -> FrameReference:
        origin = hashlib.sha256(json.dumps([self._before, *identity]).encode()).hexdigest()
        if self._all_before:
            self._before = origin
        return replace(pending, origin=origin)


@contextlib.contextmanager
def checkpointed(
    destination: Destination, key: str, options: RenderOptions, sequence: FrameSequence, origins: Callable[[], FrameOrigins]
) -> Iterator[PictureCheckpoint | None]:
    """Refuse what cannot be written, then keep the checkpoint of the run `key`, for a sequence of pictures, until all is
    done. `origins`: of its frames."""
    if destination.kind not in ("pattern", "folder"):
        if options.resume:
            raise RecipeError(f"‹resume› goes on with a sequence of pictures; {destination.path} is written in one go")
        refuse_outputs(destination, sequence, options.force)
        yield None
        return
    checkpoint = PictureCheckpoint(destination.checkpoint, key, options.force)
    if options.resume and checkpoint.path.is_file():
        checkpoint.go_on(destination.path)
        if sequence.count is not None:
            _refuse_changed(destination, sequence, checkpoint, origins())
    refuse_outputs(destination, sequence, checkpoint.force, checkpoint.is_ours)
    checkpoint.begin()
    try:
        yield checkpoint
    except BaseException:
        if not checkpoint.items:
            checkpoint.end()
        raise
    checkpoint.end()


def _refuse_changed(
    destination: Destination, sequence: FrameSequence, checkpoint: PictureCheckpoint, origins: FrameOrigins
) -> None:
    """RecipeError, before anything is read, if pictures are there that are known to be of other frames."""
    for place, pending in enumerate(sequence.frames):
        pending = origins.of(pending)  # which may tell of every frame before
        if sequence.renders(place):
            checkpoint.keeps(destination.file(pending.number, pending.stem), pending)
    checkpoint.refuse_others()
