"""Compiled kernels, kept from run to run.

PoCL keeps what it compiles in a folder and believes whatever it finds there: a damaged file or a full disk ends the process,
or gives other pixels. So it gets a folder of this process alone, on a disk with room. What it puts there for a program is
kept as one file with its SHA-256, and laid there again before a later run builds that program; a kept file that is not as it
was written is as good as none. Other drivers keep their kernels themselves; pyopencl's cache, which unpickles what it
finds, is not used.
"""

import atexit
import contextlib
import functools
import hashlib
import io
import os
import shutil
import stat
import tempfile
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path

from l3cli.errors import DeviceError, L3Error
from l3cli.files import sweep, write_whole
from l3cli.locks import sole_writer_of_folder

PREFIX = "l3-kernels-"
ROOM = 16 << 20  # bytes, several times what the kernels of a table need while they are compiled
YOUNG = 60  # seconds in which a folder may be another run's that has not locked it yet
PROGRAMS = "??/*"  # PoCL's folders of a program each


class _Cache:
    """PoCL's folder, and the one where its kernels are kept."""

    def __init__(self) -> None:
        self.kept = _kept_folder()
        self.folder = _private_folder(self.kept)
        self.unkept = "" if self.kept else "there is no home folder"
        self._built: dict[Path, tuple[set[Path], set[str]]] = {}  # kept file: its programs, what it holds
        os.environ["POCL_CACHE_DIR"] = str(self.folder)

    @contextlib.contextmanager
    def building(self, identity: str) -> Iterator[None]:
        """Lay the kernels of a program, known by its `identity`, into PoCL's folder and hear what it adds to them."""
        file = (self.kept or self.folder) / f"{hashlib.sha256(identity.encode()).hexdigest()}.kernels"
        before = set(self.folder.glob(PROGRAMS))
        held = set() if file in self._built else _lay(file, self.folder)
        yield
        programs, known = self._built.get(file, (set(), held))
        self._built[file] = programs | (set(self.folder.glob(PROGRAMS)) - before), known

    def keep(self) -> None:
        """Keep what has been compiled; where that cannot be, `unkept` says why."""
        for file, (programs, known) in self._built.items():
            files = {path for program in programs for path in program.rglob("*") if path.is_file()}
            names = {str(path.relative_to(self.folder)) for path in files}
            if self.unkept or names <= known:
                continue
            try:
                write_whole(file, _packed(self.folder, names))
                sweep(file.parent)
            except L3Error as error:
                self.unkept = f"{file.parent}: {getattr(error.__cause__, 'strerror', None) or error}"
            known |= names


@functools.cache
def _cache() -> _Cache:
    return _Cache()


def prepare() -> None:
    """See to it, before the first device is asked for, that kernels can be compiled. DeviceError if no disk has room."""
    os.environ["PYOPENCL_NO_CACHE"] = "1"
    _cache()


def building(identity: str) -> contextlib.AbstractContextManager[None]:
    """A block in which a program is built. `identity` holds all that its kernels depend on."""
    return _cache().building(identity)


def keep() -> None:
    """Keep the kernels that have run so far for later runs."""
    _cache().keep()


def unkept() -> str:
    """What to say of kernels that could not be kept; empty if all were."""
    if not _cache.cache_info().currsize or not _cache().unkept:
        return ""
    return (
        f"compiled kernels cannot be kept ({_cache().unkept}), so each run compiles them anew, which takes seconds; "
        "set XDG_CACHE_HOME to a folder with room that can be written to"
    )


def _kept_folder() -> Path | None:
    """Where kernels are kept: in POCL_CACHE_DIR, else below XDG_CACHE_HOME or the home folder; None if there is none."""
    chosen, caches = Path(os.environ.get("POCL_CACHE_DIR", "")), Path(os.environ.get("XDG_CACHE_HOME", ""))
    if chosen.is_absolute():
        return chosen
    home = Path(os.path.expanduser("~"))
    if not caches.is_absolute() and home.is_absolute() and os.environ.get("HOME") != "":
        caches = home / ".cache"
    return caches / "l3cli" / "kernels" if caches.is_absolute() else None


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


def _packed(folder: Path, names: set[str]) -> bytes:
    """Files below a folder as one, behind its SHA-256."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name in sorted(names):
            archive.writestr(name, (folder / name).read_bytes())
    content = packed.getvalue()
    return hashlib.sha256(content).digest() + content


def _lay(file: Path, folder: Path) -> set[str]:
    """Unpack what is kept into a folder; the files' names, none if the file is not there or not as it was written."""
    try:
        whole = file.read_bytes()
    except OSError:
        return set()
    size = hashlib.sha256().digest_size
    if hashlib.sha256(whole[size:]).digest() != whole[:size]:
        return set()
    with zipfile.ZipFile(io.BytesIO(whole[size:])) as archive:
        archive.extractall(folder)
        return set(archive.namelist())
