"""The mark of a sequence of pictures: it lies beside them while a run lasts, says to `l3 render --resume` which run
that is, and lists what it has made, of what.

A picture is listed before it gets its name, the list being on the disk by then. So a file that is not listed is none of the
run's, however it ended; one that is listed, but not there, is made. Size and time identify a file: digests would take as
long as a tenth of the rendering. Only where a frame's file has these and another inode, or one that was touched since, does
the digest decide that its picture states.
"""

import contextlib
import errno
import hashlib
import json
import os
import stat
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO, NamedTuple

from l3cli.errors import RecipeError
from l3cli.frames.frame import RawFrame
from l3cli.io.pictures.registry import file_identity
from l3cli.io.sequences import FrameReference
from l3cli.system.files import sha256, write_whole
from l3cli.system.ledger import fingerprint

Dated = tuple[int, int]  # size in bytes, time of the last change in ns


def _dated(path: Path) -> Dated | None:
    """Size and time of a regular file; None if there is none."""
    try:
        state = path.stat()
    except OSError:
        return None
    return (state.st_size, state.st_mtime_ns) if stat.S_ISREG(state.st_mode) else None


class _Made(NamedTuple):
    """A picture that a run has made."""

    dated: Dated
    origin: str | None  # of its frame
    inode: tuple[int, ...] | None  # of the frame's file: time of its last change, number
    identity: str  # that the picture states of its frame


class Mark:
    """The mark of the run `key`. `force`: it may replace what it finds."""

    def __init__(self, path: Path, key: str, force: bool) -> None:
        self._path, self._key, self.force = path, key, force
        self._made: dict[str, _Made] = {}  # by name
        self._unasked: set[str] = set()  # pictures whose frames have not come up yet
        self._file: BinaryIO | None = None

    def take_over(self, made_by: str) -> None:
        """Go on where the run under the path stopped; RecipeError, naming the output, if that was another one."""
        first, *lines = self._path.read_text(encoding="utf-8", errors="replace").split("\n")
        if first.split(" ")[0] != self._key:
            raise RecipeError(f"{made_by} holds a run with another table, inputs or options; leave ‹resume› out")
        self.force = self.force or first.endswith(" force")
        self._made = {name: made for name, made in _listed(lines) if _dated(self._path.with_name(name)) == made.dated}
        self._unasked = set(self._made)

    def is_ours(self, file: Path) -> bool:
        """Return whether a file exists that the run has made."""
        return file.name in self._made and _dated(file) == self._made[file.name].dated

    def keeps(self, file: Path, pending: FrameReference) -> bool:
        """Return whether the picture of a frame exists already; RecipeError if it was made of something else. Without an
        origin nothing can be said yet."""
        self._unasked.discard(file.name)
        if pending.origin is None or not self.is_ours(file):
            return False
        made = self._made[file.name]
        same = made.inode == pending.inode or (pending.source and made.identity == file_identity(sha256(pending.source)))
        if made.origin != pending.origin or not same:
            raise RecipeError(f"{file} was made of another input than is given now; leave ‹resume› out")
        return True

    def refuse_others(self) -> None:
        """RecipeError if pictures are there whose frames have not come up."""
        if self._unasked:
            raise RecipeError(
                f"{self._path.with_name(min(self._unasked))} was made of a frame that is not given now; leave ‹resume› out"
            )

    def begin(self) -> None:
        """Write the mark; what is listed from now on goes behind it."""
        lines = [f"{self._key} force" if self.force else self._key]
        lines += [json.dumps([name, *made]) for name, made in self._made.items()]
        write_whole(self._path, "\n".join(lines))
        self._file = open(self._path, "ab", buffering=0)  # noqa: SIM115

    def add(self, file: Path, temporary: Path, pending: FrameReference) -> None:
        """List a picture of a frame that is about to get its name."""
        assert self._file is not None
        made = [_dated(temporary), pending.origin, pending.inode, pending.identity]
        line = ("\n" + json.dumps([file.name, *made])).encode()
        if self._file.write(line) < len(line):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        os.fdatasync(self._file)

    def end(self, complete: bool) -> None:
        """Remove the mark of a run that is complete, or has listed nothing."""
        assert self._file is not None
        self._file.close()
        if complete or b"\n" not in self._path.read_bytes():
            self._path.unlink()


def _listed(lines: Iterable[str]) -> Iterator[tuple[str, _Made]]:
    """Each picture in the lines of a mark, by name."""
    for line in lines:
        with contextlib.suppress(ValueError, TypeError):  # a line that was cut off
            name, dated, origin, inode, identity = json.loads(line)
            yield name, _Made(tuple(dated), origin, inode and tuple(inode), identity)


def listed_pictures(mark: Path) -> list[Path]:
    """Return the pictures that a stopped run has made, by its mark, and nobody has changed since."""
    lines = mark.read_text(encoding="utf-8", errors="replace").split("\n")[1:]
    known = {mark.with_name(name): made.dated for name, made in _listed(lines)}
    return [path for path, dated in known.items() if _dated(path) == dated]


class Origins:
    """Records what pictures are made of, frame by frame: by file, number, size and time; by content where there is no file
    to go by. `all_before`: the exposure of a frame depends on every one before it, and so does its picture."""

    def __init__(self, whole: Path, all_before: bool) -> None:
        self._whole, self._all_before = whole, all_before  # `whole`: the file of frames that are no files
        self._before = ""

    def of(self, pending: FrameReference) -> FrameReference:
        """The frame with its origin, if that is known before it is read; ask before, lest it change in between."""
        source = pending.source or self._whole
        if _dated(source) is None:
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
