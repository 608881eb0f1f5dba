"""State of the outputs of many clips, by the checkpoint that lies beside them.

An item is an output, listed as its clip is begun and again as it has ended. So an output whose clip was begun and has not
ended is half of a run's making. Outputs are known by names, sizes and times, clips by names and fingerprints: another clip
of the same size and time is another clip.
"""

import hashlib
import json
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from l3cli.errors import InputFileError
from l3cli.io.sequences import frame_files
from l3cli.stages.rendering.checkpoint import listed_pictures
from l3cli.stages.rendering.destination import Destination
from l3cli.system.files import is_ours, refuse_protected
from l3cli.system.ledger import dated, fingerprint


@dataclass(frozen=True)
class Entry:
    """State of a clip."""

    clip: str  # file or folder, pattern or glob that it is made of, absolute
    of: str  # identity of the clip's files
    made: str | None = None  # identity of what is in the output; None: not ended, or failed
    frames: int = 0
    left_out: int = 0
    seconds: float = 0.0
    frame_times: str | None = None


def _identity(known: Iterable[object]) -> str:
    return hashlib.sha256(json.dumps(list(known)).encode()).hexdigest()[:32]


def identity_of_clip(source: Path) -> str:
    """Return the identity of a clip's files, by names and fingerprints; InputFileError if a folder or glob holds none."""
    return _identity([path.name, *(fingerprint(path) if path.exists() else ())] for path in frame_files(source))


def identity_of_output(output: Path) -> str:
    """Return the identity of a file, or of all files of a folder, by names, sizes and times."""
    return _identity([path.name, *(dated(path) or ())] for path in files_of_output(output))


def files_of_output(output: Path) -> list[Path]:
    """Return the file, or all files of the folder but locks and the like."""
    return sorted(path for path in output.iterdir() if not is_ours(path.name)) if output.is_dir() else [output]


@dataclass(frozen=True)
class Standing:
    """State of a clip and its output."""

    source: Path
    output: Path
    is_file: bool
    of: str  # identity of the clip
    entry: Entry | None  # what a run before has made there; None: nothing, or it does not matter

    @property
    def same(self) -> bool:
        """Return whether the output is of this content."""
        return self.entry is not None and self.entry.of == self.of

    @property
    def checkpoint(self) -> Path:
        """File among the pictures of a run that was stopped."""
        return Destination(self.output, "folder", "").checkpoint

    @property
    def of_other(self) -> Path | None:
        """The clip in another place that the output was made of, as long as it is there."""
        if self.entry is None or self.same or self.entry.clip == os.path.realpath(self.source):
            return None
        clip = Path(self.entry.clip)
        try:
            return clip if any(path.exists() for path in frame_files(clip)) else None
        except (InputFileError, OSError):
            return None

    @property
    def ours(self) -> bool:
        """Return whether the output may be replaced or continued: it is unchanged since a run made it of this clip or one
        that is gone, or it is where that run was stopped."""
        if self.entry is None or self.of_other:
            return False
        if self.entry.made is not None:
            return self.entry.made == identity_of_output(self.output)
        return self.same or self.is_file or self.checkpoint.is_file()  # else nothing says which pictures are of that run

    @property
    def is_finished(self) -> bool:
        """Return whether the output is whole and of this content."""
        return self.ours and self.same and self.entry is not None and self.entry.made is not None

    def clear(self) -> None:
        """Remove the pictures that a run before has made of another content of the clip: it may have had more frames."""
        if self.entry is None or self.is_file or not self.output.is_dir():
            return
        for path in files_of_output(self.output) if self.entry.made else listed_pictures(self.checkpoint):
            refuse_protected(path)
            path.unlink()
