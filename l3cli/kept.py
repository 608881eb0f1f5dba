"""Files that are kept from run to run to save time: compiled kernels, tables as they are rendered by.

Each begins with the SHA-256 of all that follows. One that is not as it was written, or that another user could have
written, is as good as none.
"""

import contextlib
import functools
import hashlib
import os
import stat
from collections.abc import Iterable
from pathlib import Path

from l3cli.files import atomic_output, sweep

DIGEST = hashlib.sha256().digest_size
TRUSTED = 0  # the number of the system's own user


@functools.cache  # PoCL gets another POCL_CACHE_DIR later
def kept_folder() -> Path | None:
    """Where files are kept: in POCL_CACHE_DIR, else below XDG_CACHE_HOME or the home folder; None if there is none."""
    chosen, caches = Path(os.environ.get("POCL_CACHE_DIR", "")), Path(os.environ.get("XDG_CACHE_HOME", ""))
    if chosen.is_absolute():
        return chosen
    home = Path(os.path.expanduser("~"))
    if not caches.is_absolute() and home.is_absolute() and os.environ.get("HOME") != "":
        caches = home / ".cache"
    return caches / "l3cli" / "kernels" if caches.is_absolute() else None


def read_kept(file: Path, most: int) -> memoryview | None:
    """What is kept in a file, of at most so many bytes; None if it is not there, or not to be believed."""
    try:
        with open(os.open(file, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb", buffering=0) as source:
            state = os.fstat(source.fileno())
            if not stat.S_ISREG(state.st_mode) or not DIGEST <= state.st_size <= DIGEST + most:
                return None
            if state.st_uid not in (os.geteuid(), TRUSTED) or state.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
                return None
            content, got = memoryview(bytearray(state.st_size)), 0
            while count := source.readinto(content[got:]):
                got += count
    except (OSError, MemoryError):
        return None
    rest = content[DIGEST:]
    return rest.toreadonly() if got == len(content) and hashlib.sha256(rest).digest() == content[:DIGEST] else None


def write_kept(file: Path, parts: Iterable[bytes | memoryview]) -> None:
    """Keep parts, one after the other, in a file that only this user may write. L3Error or OSError if that cannot be."""
    digest = hashlib.sha256()
    with atomic_output(file) as temporary, open(temporary, "r+b") as sink:
        os.fchmod(sink.fileno(), stat.S_IRUSR | stat.S_IWUSR)
        sink.write(bytes(DIGEST))
        for part in parts:
            digest.update(part)
            sink.write(part)
        sink.seek(0)
        sink.write(digest.digest())
    sweep(file.parent)


def forget_oldest(folder: Path, suffix: str, most: int) -> None:
    """Remove the files of a suffix that have not been used for longest, until the others have at most so many bytes."""
    with contextlib.suppress(OSError):
        files = [(each.stat(follow_symlinks=False), each.path) for each in os.scandir(folder) if each.name.endswith(suffix)]
        size = 0
        for state, path in sorted(files, key=lambda each: each[0].st_mtime_ns, reverse=True):
            size += state.st_size
            if size > most:
                with contextlib.suppress(OSError):
                    os.unlink(path)
