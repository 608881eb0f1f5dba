"""What a run over many clips has made, in a file beside its outputs, so that it can be stopped at any time and go on.

JSON lines: first the run's key, then one as each clip is begun and one as it has ended, on the disk before anything else
happens. So an output whose clip was begun and has not ended is half of this run's making; names, sizes and times tell one
content of a file from another, as in mark.py.
"""

import contextlib
import errno
import hashlib
import json
import os
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from l3cli.errors import RecipeError
from l3cli.files import is_ours, write_whole
from l3cli.io.sequences import frame_files
from l3cli.ledger import dated


@dataclass(frozen=True)
class Entry:
    """How a clip stands."""

    of: str  # identity of the clip's files
    output: str
    made: str | None = None  # identity of what is in the output; None: not ended, or failed
    error: str | None = None
    begun: bool = True  # False: refused before anything was written
    frames: int = 0
    left_out: int = 0
    seconds: float = 0.0

    def has(self, output: Path) -> bool:
        """Whether what lies in an output is of this clip: all that it made, unchanged, or what it was stopped at."""
        return self.output == os.path.realpath(output) and (
            self.made == identity_of_output(output) if self.made else self.begun
        )


def identity_of(files: Iterable[Path]) -> str:
    """Of files, by names, sizes and times."""
    known = [[path.name, *(dated(path) or ())] for path in files]
    return hashlib.sha256(json.dumps(known).encode()).hexdigest()[:32]


def identity_of_clip(source: Path) -> str:
    """Of the files of a clip, in a folder all that are not hidden; OSError or InputFileError if there are none."""
    if source.is_dir():
        return identity_of(sorted(path for path in source.iterdir() if not path.name.startswith(".")))
    return identity_of(frame_files(source))


def identity_of_output(output: Path) -> str:
    """Of a file, or of all files of a folder."""
    inside = sorted(path for path in output.iterdir() if not is_ours(path.name)) if output.is_dir() else [output]
    return identity_of(inside)


class JobState:
    """How the clips of the run `key` stand. `path`: of the file that holds it."""

    def __init__(self, path: Path, key: str) -> None:
        self._path, self._key = path, key
        self._entries: dict[str, Entry] = {}
        self._file: int | None = None

    def take_over(self) -> None:
        """Go on where a run was stopped, if one was; RecipeError if that was another one."""
        if not self._path.is_file():
            return
        with open(self._path, encoding="utf-8", errors="replace") as file:
            if file.readline().strip() != self._key:
                raise RecipeError(
                    f"{self._path.parent} holds a run with another table or options; name another folder, or add ‹force›"
                )
            for line in file:
                with contextlib.suppress(ValueError, TypeError):  # a line that was cut off
                    clip, about = json.loads(line)
                    self._entries[clip] = Entry(**about)

    def begin(self) -> None:
        """Write what is known; what happens from now on goes behind it."""
        lines = [self._key, *(json.dumps([clip, asdict(entry)]) for clip, entry in self._entries.items())]
        write_whole(self._path, "\n".join(lines) + "\n")
        self._file = os.open(self._path, os.O_WRONLY | os.O_APPEND)

    def entry(self, clip: Path) -> Entry | None:
        """How a clip stands; None: nothing is known of it."""
        return self._entries.get(os.path.realpath(clip))

    def note(self, clip: Path, entry: Entry) -> None:
        """How a clip stands from now on, on the disk when this returns."""
        assert self._file is not None
        self._entries[os.path.realpath(clip)] = entry
        line = (json.dumps([os.path.realpath(clip), asdict(entry)]) + "\n").encode()
        if os.write(self._file, line) < len(line):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self._path))
        os.fdatasync(self._file)

    def keep_only(self, clips: Iterable[Path]) -> None:
        """Forget, in memory, all clips but these."""
        known = {os.path.realpath(clip) for clip in clips}
        self._entries = {clip: entry for clip, entry in self._entries.items() if clip in known}

    @property
    def has_outputs(self) -> bool:
        """Whether anything is there that the run has made or begun."""
        return any(entry.begun and os.path.exists(entry.output) for entry in self._entries.values())

    def end(self, complete: bool) -> None:
        """Remove the file of a run that has made everything."""
        if self._file is not None:
            os.close(self._file)
            self._file = None
        if complete:
            self._path.unlink(missing_ok=True)
