"""Compiled kernels, kept from run to run.

PoCL keeps what it compiles in a folder and believes whatever it finds there: a damaged file or a full disk ends the process,
or gives other pixels. So it gets a folder of this process alone, on a disk with room. A program whose kernels have run is
kept as OpenCL's binary of it, one file with its SHA-256, of which a later run builds the program without the compiler; a
kept file that is not as it was written is as good as none. Other drivers keep their kernels themselves; pyopencl's cache,
which unpickles what it finds, is not used.
"""

import atexit
import contextlib
import functools
import hashlib
import os
import shutil
import stat
import tempfile
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from l3cli.errors import DeviceError, L3Error
from l3cli.kept import kept_folder, read_kept, write_kept
from l3cli.locks import sole_writer_of_folder

PREFIX = "l3-kernels-"
ROOM = 16 << 20  # bytes, several times what the kernels of a table need while they are compiled
YOUNG = 60  # seconds in which a folder may be another run's that has not locked it yet
PROGRAMS = "??/*"  # PoCL's folders of a program each
COMPILED = "*/*/*.so"  # below each of them: a folder a kernel, in it one for each size of work-groups
MOST = 64 << 20  # bytes of one that is kept
GENERAL = "0-0-0"  # PoCL's folder, of each kernel, of the form for work-groups of any size


class Made(NamedTuple):
    """A program that has been built."""

    program: Any
    kernels: tuple[str, ...]  # their names
    binary: Callable[[], bytes]
    spares_general: bool  # whether the driver is known to leave alone the general forms that `_spare_general_forms` lays


class _Cache:
    """PoCL's folder, and the one where its kernels are kept."""

    def __init__(self) -> None:
        self.kept = kept_folder()
        self.folder = _private_folder(self.kept)
        self.unkept = "" if self.kept else "there is no home folder"
        self._new: dict[Path, tuple[set[Path], Made]] = {}  # file to be kept: PoCL's folders of what it is to hold
        os.environ["POCL_CACHE_DIR"] = str(self.folder)
        os.environ["PYOPENCL_NO_CACHE"] = "1"

    def built(self, identity: str, compiled: Callable[[], Made], of_binary: Callable[[bytes], Made | None]) -> Made:
        """A program known by its `identity`: of the binary that is kept, or else compiled."""
        file = (self.kept or self.folder) / f"{hashlib.sha256(identity.encode()).hexdigest()}.program"
        binary = _read(file)
        if binary is not None and (program := of_binary(binary)) is not None:
            return program
        before = set(self.folder.glob(PROGRAMS))
        made = compiled()
        if folders := set(self.folder.glob(PROGRAMS)) - before:
            self._new[file] = folders, made
        return made

    def keep(self) -> None:
        """Keep programs all of whose kernels have run; where that cannot be, `unkept` says why. No other one is: a kernel
        that its binary lacks would be compiled in every run."""
        for file, (folders, made) in list(self._new.items()):
            if {path.stem for folder in folders for path in folder.glob(COMPILED)} < set(made.kernels):
                continue
            del self._new[file]
            if self.unkept:
                continue
            try:
                if made.spares_general:
                    _spare_general_forms(folders)
                write_kept(file, [zlib.compress(made.binary(), 1)])
            except (L3Error, OSError) as error:
                self.unkept = f"{file.parent}: {getattr(error.__cause__ or error, 'strerror', None) or error}"


@functools.cache
def _cache() -> _Cache:
    return _Cache()


def prepare() -> None:
    """See to it, before the first device is asked for, that kernels can be compiled. DeviceError if no disk has room."""
    _cache()


def built(identity: str, compiled: Callable[[], Made], of_binary: Callable[[bytes], Made | None]) -> Made:
    """A program: of_binary(what an earlier run has kept of it), where that is not None, else compiled(). `identity` holds
    all that its kernels depend on."""
    return _cache().built(identity, compiled, of_binary)


def keep() -> None:
    """Keep the programs whose kernels have run so far for later runs."""
    _cache().keep()


def unkept() -> str:
    """What to say of kernels that could not be kept; empty if all were."""
    if not _cache.cache_info().currsize or not _cache().unkept:
        return ""
    return (
        f"compiled kernels cannot be kept ({_cache().unkept}), so each run compiles them anew, which takes seconds; "
        "set XDG_CACHE_HOME to a folder with room that can be written to"
    )


def _private_folder(kept: Path | None) -> Path:
    """A new folder that is removed when this process ends, or by a later one if it is killed. DeviceError if no disk has
    room."""
    places = [Path(place) for place in (os.environ.get("TMPDIR"), "/tmp", "/var/tmp", "/dev/shm", kept) if place]
    for place in places:
        with contextlib.suppress(OSError, L3Error):
            if place == kept:
                place.mkdir(parents=True, exist_ok=True)
            if os.statvfs(place).f_flag & os.ST_NOEXEC:
                continue  # compiled kernels are loaded as programs are
            _remove_abandoned(place)
            folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=place))
            owned = contextlib.ExitStack()
            owned.callback(shutil.rmtree, folder, ignore_errors=True)
            try:
                owned.enter_context(sole_writer_of_folder(folder))
                with tempfile.TemporaryFile(dir=folder) as room:
                    os.posix_fallocate(room.fileno(), 0, ROOM)
            except BaseException:
                owned.close()
                raise
            atexit.register(_end, owned, os.getpid())
            return folder
    raise DeviceError(
        f"no disk has {ROOM >> 20} MB to compile kernels in ({', '.join(map(str, places))}); free some space or set TMPDIR"
    )


def _end(owned: contextlib.ExitStack, owner: int) -> None:
    if os.getpid() == owner:
        owned.close()


def _remove_abandoned(place: Path) -> None:
    """Remove what processes left here that were killed."""
    for folder in place.glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError, L3Error):
            state = folder.lstat()
            if stat.S_ISDIR(state.st_mode) and state.st_uid == os.geteuid() and time.time() - state.st_mtime > YOUNG:
                with sole_writer_of_folder(folder) as locked:
                    if locked:
                        shutil.rmtree(folder)


def _spare_general_forms(programs: set[Path]) -> None:
    """Give every kernel that has run as its general form the one that ran. PoCL puts the general form into a binary, too,
    and compiles it for that, which takes as long as all before; it uses it only where it has no compiler."""
    for compiled in [path for program in programs for path in program.glob(COMPILED)]:
        general = compiled.parents[1] / GENERAL
        if not general.exists():
            general.mkdir()
            os.link(compiled, general / compiled.name)


def _read(file: Path) -> bytes | None:
    """What is kept in a file; None if it is not there or not as it was written."""
    try:
        content = read_kept(file, MOST)
        return None if content is None else zlib.decompress(content)
    except zlib.error:
        return None
