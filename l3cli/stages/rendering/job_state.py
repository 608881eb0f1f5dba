"""State of a run over many clips, in a file beside its outputs, so that it can be stopped at any time and go on.

JSON lines: first the runs' key, then one as each clip is begun and one as it has ended, on the disk before anything else
happens. So an output whose clip was begun and has not ended is half of a run's making. Outputs are known by names, sizes and
times, clips by names and fingerprints: another clip of the same size and time is another clip.
"""

import contextlib
import errno
import hashlib
import json
import os
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from l3cli.errors import InputFileError, RecipeError
from l3cli.io.sequences import frame_files
from l3cli.stages.rendering.destination import Destination
from l3cli.stages.rendering.mark import listed_pictures
from l3cli.system.files import is_ours, refuse_protected, write_whole
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
    def mark(self) -> Path:
        """Lies among the pictures of a run that was stopped."""
        return Destination(self.output, "folder", "").mark

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
        return self.same or self.is_file or self.mark.is_file()  # else nothing says which pictures are of that run

    @property
    def kept(self) -> bool:
        """Return whether the output is whole and of this content."""
        return self.ours and self.same and self.entry is not None and self.entry.made is not None

    def clear(self) -> None:
        """Remove the pictures that a run before has made of another content of the clip: it may have had more frames."""
        if self.entry is None or self.is_file or not self.output.is_dir():
            return
        made = files_of_output(self.output) if self.entry.made else []
        for path in made or (listed_pictures(self.mark) if self.mark.is_file() else []):
            refuse_protected(path)
            path.unlink()


class JobState:
    """States of the clips of the run `key`. `path`: of the file that holds it."""

    def __init__(self, path: Path, key: str) -> None:
        self._path, self._key = path, key
        self._entries: dict[str, Entry] = {}
        self._file: int | None = None

    def take_over(self, required: bool) -> None:
        """Read what runs before have made. Of another table or other options nothing is taken; RecipeError if it is
        `required`."""
        if not self._path.is_file():
            return
        with open(self._path, encoding="utf-8", errors="replace") as file:
            if file.readline().strip() != self._key:
                if not required:
                    return
                raise RecipeError(
                    f"{self._path.parent} holds a run with another table or options; name another folder, or add ‹force›"
                )
            for line in file:
                with contextlib.suppress(ValueError, TypeError):  # a line that was cut off
                    output, about = json.loads(line)
                    self._entries[output] = Entry(**about)

    def begin(self) -> None:
        """Write what is known of outputs that are there; what happens from now on goes behind it."""
        self._entries = {name: entry for name, entry in self._entries.items() if self._path.with_name(name).exists()}
        lines = [self._key, *(json.dumps([output, asdict(entry)]) for output, entry in self._entries.items())]
        write_whole(self._path, "\n".join(lines) + "\n")
        self._file = os.open(self._path, os.O_WRONLY | os.O_APPEND)

    def entry(self, output: Path) -> Entry | None:
        """Return the state of a clip; None: nothing is known of it."""
        return self._entries.get(output.name)

    def note(self, output: Path, entry: Entry) -> None:
        """Set the state of a clip; it is on the disk when this returns."""
        assert self._file is not None
        self._entries[output.name] = entry
        line = (json.dumps([output.name, asdict(entry)]) + "\n").encode()
        if os.write(self._file, line) < len(line):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self._path))
        os.fdatasync(self._file)

    def end(self) -> None:
        """Close the file; remove it if nothing is there of what it knows."""
        if self._file is None:
            return
        os.close(self._file)
        self._file = None
        if not any(os.path.exists(self._path.with_name(output)) for output in self._entries):
            self._path.unlink(missing_ok=True)
