"""Checkpoint of a rendering: which outputs are finished and what each was made from, so that `--resume` can continue.

A picture is finished if its file is as the run left it and was made from the same frame with the same settings. Files are
identified by size, times and inode, because SHA-256 of all frames would take as long as a tenth of the rendering.
"""

import contextlib
import hashlib
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from l3cli.errors import RecipeError
from l3cli.frames.frame import RawFrame
from l3cli.io.destination import Destination
from l3cli.io.sequences import FrameReference, FrameSequence
from l3cli.system.checkpoint import Checkpoint
from l3cli.system.files import FINISHED, UNFINISHED, dated, fingerprint, refuse_protected


class PictureCheckpoint(Checkpoint):
    """The finished outputs of a run by file name, each with the state of its file and the origin of its frames.

    During the run the file is called `.l3-unfinished`, and afterwards `.l3-finished`.

    Parameters
    ----------
    path : Path
        File of the checkpoint, beside the outputs.
    key : str
        Digest of the table, of the options on which the bytes of the outputs depend, and of the paths of the inputs.
    """

    def __init__(self, path: Path, key: str) -> None:
        super().__init__(path, key)
        self._unseen: set[str] = set()  # pictures of the earlier run whose frames have not come up yet

    @property
    def finished(self) -> Path:
        """File of the checkpoint after the end of the run."""
        return self.path.with_name(self.path.name.removesuffix(UNFINISHED) + FINISHED)

    def continue_run(self, output: Path, force: bool) -> None:
        """Read which outputs an earlier run has finished, if there was one.

        Raises
        ------
        RecipeError
            If the earlier run had another table, other options or inputs elsewhere, unless `force` is set.
        """
        earlier = self.path if self.path.is_file() else self.finished
        if earlier.is_file() and not self.take_over(earlier) and not force:
            raise RecipeError(
                f"{output} contains a run with another table, inputs or options; leave ‹resume› out, or add ‹force›"
            )
        self._unseen = {name for name in self.items if self.is_ours(self.path.with_name(name))}

    def is_ours(self, file: Path) -> bool:
        """Whether a file exists and is as the run left it."""
        return file.name in self.items and dated(file) == self.items[file.name]["file"]

    def has(self, file: Path, origin: str) -> bool:
        """Whether an output is finished and was made from this origin ("" if the origin is not known yet)."""
        self._unseen.discard(file.name)
        return bool(origin) and self.is_ours(file) and self.items[file.name]["origin"] == origin

    def list_output(self, file: Path, temporary: Path, origin: str, **counts: int) -> None:
        """List an output, with counts of its frames, just before its temporary file is renamed."""
        self.add(file.name, {"file": dated(temporary), "origin": origin, **counts})

    @contextlib.contextmanager
    def kept(self) -> Iterator[None]:
        """Keep the checkpoint during the block. It stays if the block fails, unless nothing was finished."""
        refuse_protected(self.finished)
        self.begin()
        self.finished.unlink(missing_ok=True)
        try:
            yield
        except BaseException:
            if not self.items:
                self.end()
            raise
        self.path.replace(self.finished)

    @property
    def abandoned(self) -> list[Path]:
        """Pictures of the earlier run whose frames are no longer among the inputs."""
        return [self.path.with_name(name) for name in sorted(self._unseen)]


def checkpoint_of(destination: Destination, key: str, resume: bool, force: bool) -> PictureCheckpoint:
    """Return the checkpoint of a run, with the outputs that an earlier run has finished if `resume` is set."""
    checkpoint = PictureCheckpoint(destination.checkpoint, key)
    if resume:
        checkpoint.continue_run(destination.path, force)
    return checkpoint


class FrameOrigins:
    """Identifies what each picture is made from, as a digest.

    Parameters
    ----------
    inputs : Path
        The file with all frames, unless each frame has a file of its own.
    settings : object
        Further facts on which all pictures depend, such as the estimated gain; ready for JSON.
    follow : bool
        Whether a picture depends on all frames before it.
    """

    def __init__(self, inputs: Path, settings: Any, follow: bool) -> None:
        self._inputs, self._before, self._follow = inputs, _digest(settings), follow

    def of(self, reference: FrameReference) -> FrameReference:
        """Return the reference with its origin, if that is known before the frame is read.

        Call it before reading, because the file could change in between.
        """
        source = reference.source or self._inputs
        return self._with_origin(reference, fingerprint(source)) if source.is_file() else reference

    def of_read(self, reference: FrameReference, frame: RawFrame) -> FrameReference:
        """Return the reference of a frame that was read, with its origin."""
        if reference.origin:
            return reference
        return self._with_origin(reference, hashlib.sha256(frame.values.tobytes()).hexdigest())

    def of_all(self, sequence: FrameSequence) -> str:
        """Return the origin of a video or of the pages of a file; "" if it is not known before the frames are read."""
        if not sequence.is_stream:
            return _digest([self.of(reference).origin for reference in sequence.frames] + [str(sequence.part)])
        if not self._inputs.is_file():
            return ""
        return _digest([self._before, fingerprint(self._inputs), str(sequence.wanted), str(sequence.part)])

    def _with_origin(self, reference: FrameReference, identity: Any) -> FrameReference:
        origin = _digest([self._before, reference.number, identity])
        if self._follow:
            self._before = origin
        return replace(reference, origin=origin)


def _digest(facts: Any) -> str:
    return hashlib.sha256(json.dumps(facts, default=str).encode()).hexdigest()
