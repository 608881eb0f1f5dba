"""The rendering checkpoint: a list of finished outputs, which `--resume` needs to continue an interrupted run.

A picture is finished if its file is unchanged since the earlier run wrote it, and if its frame and settings are the same as
in the earlier run. Files are compared by size, times and inode, because SHA-256 digests would add about 10 % to the
rendering time.
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
    """List of a run's finished outputs: name, state and origin of each file.

    The origin is a digest of the frames and settings from which a picture was rendered. The name of the checkpoint file ends
    in `.l3-unfinished` during the run, and in `.l3-finished` afterwards.

    Parameters
    ----------
    path : Path
        File of the checkpoint, in the folder of the outputs.
    key : str
        Digest of the table, the input paths, and the options that affect the outputs.
    """

    def __init__(self, path: Path, key: str) -> None:
        super().__init__(path, key)
        self._unseen: set[str] = set()  # pictures of the earlier run that this run has not reached yet

    @property
    def finished(self) -> Path:
        """Path of the checkpoint file after the run."""
        return self.path.with_name(self.path.name.removesuffix(UNFINISHED) + FINISHED)

    def continue_run(self, output: Path, force: bool) -> None:
        """Read the checkpoint of an earlier run, if there is one.

        With `force`, the checkpoint of a different run is ignored.

        Raises
        ------
        RecipeError
            If the earlier run had a different table, options or input paths, and `force` is not set.
        """
        earlier = self.path if self.path.is_file() else self.finished
        if earlier.is_file() and not self.take_over(earlier) and not force:
            raise RecipeError(
                f"{output} was written by a run with a different table, different inputs or different options; remove "
                "‹resume› or add ‹force›"
            )
        self._unseen = {name for name in self.items if self.is_ours(self.path.with_name(name))}

    def is_ours(self, file: Path) -> bool:
        """Return whether a file exists and is unchanged since the run wrote it."""
        return file.name in self.items and dated(file) == self.items[file.name]["file"]

    def has(self, file: Path, origin: str) -> bool:
        """Return whether an output is finished and has the given origin. An unknown origin ("") never matches.

        After this call, the output is no longer listed in `abandoned`.
        """
        self._unseen.discard(file.name)
        return bool(origin) and self.is_ours(file) and self.items[file.name]["origin"] == origin

    def list_output(self, file: Path, temporary: Path, origin: str, **counts: int) -> None:
        """Add an output to the list. Call this method just before the output's temporary file is renamed.

        `counts` are named numbers of frames, which are stored with the output.
        """
        self.add(file.name, {"file": dated(temporary), "origin": origin, **counts})

    @contextlib.contextmanager
    def kept(self) -> Iterator[None]:
        """Write the checkpoint file during a `with` block, and rename it to `finished` afterwards.

        If the block fails, the file keeps its name, so that the run can be continued. It is deleted if the block fails
        before any output is finished.
        """
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
        """Pictures of the earlier run without a corresponding frame in the inputs of this run."""
        return [self.path.with_name(name) for name in sorted(self._unseen)]


def checkpoint_of(destination: Destination, key: str, resume: bool, force: bool) -> PictureCheckpoint:
    """Create the checkpoint of a run. With `resume`, it lists the finished outputs of an earlier run."""
    checkpoint = PictureCheckpoint(destination.checkpoint, key)
    if resume:
        checkpoint.continue_run(destination.path, force)
    return checkpoint


class FrameOrigins:
    """Computes the origin of each picture: a digest of the frames and settings from which it is rendered.

    Parameters
    ----------
    inputs : Path
        The input, which identifies frames that do not have a separate file.
    settings : object
        JSON data with settings that affect all pictures but are not part of the run key, such as the estimated gain.
    follow : bool
        Whether each picture depends on all previous frames. Origins must then be computed in frame order.
    """

    def __init__(self, inputs: Path, settings: Any, follow: bool) -> None:
        self._inputs, self._before, self._follow = inputs, _digest(settings), follow

    def of(self, reference: FrameReference) -> FrameReference:
        """Compute the origin (a digest) of a picture from its frame's file, and add it to the reference.

        Call this method before the frame is read, because the file could change during reading. If the frame has no separate
        file, the input file is used. If the input is not a file, the reference is returned unchanged.
        """
        source = reference.source or self._inputs
        return self._with_origin(reference, fingerprint(source)) if source.is_file() else reference

    def of_read(self, reference: FrameReference, frame: RawFrame) -> FrameReference:
        """Compute a picture's origin from the raw values of its frame, unless `of` has already added an origin."""
        if reference.origin:
            return reference
        return self._with_origin(reference, hashlib.sha256(frame.values.tobytes()).hexdigest())

    def of_all(self, sequence: FrameSequence) -> str:
        """Return the origin of a video or multi-page file, or "" for frames from a stream without a file."""
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
