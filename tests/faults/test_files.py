"""Outputs are complete or absent, have one writer at a time, and remains of dead processes are removed."""

import errno
import fcntl
import os
import resource
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.container import new_file
from l3cli.errors import InputFileError, L3Error
from l3cli.io.pictures.dng import LIGHT_CODES, write_dng
from l3cli.io.video import VideoChoice, new_video, new_y4m
from l3cli.system import files
from l3cli.system.files import atomic_output, require_same, sha256, write_whole
from l3cli.system.locks import sole_writer_of_file, sole_writer_of_folder
from tests.helpers.calls import L3

DEAD = ".a.01234567.l3tmp.h5"


def names(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def start(work: Callable[[], object]) -> int:
    """Number of a new process that does some work and ends with 0, or 1 if that raised."""
    child = os.fork()
    if not child:
        try:
            work()
        except BaseException:
            os._exit(1)
        os._exit(0)
    return child


def in_a_child(work: Callable[[], object]) -> int:
    """Exit code of a process that does some work."""
    return os.waitstatus_to_exitcode(os.waitpid(start(work), 0)[1])


def test_an_output_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "new/a.txt"
    with atomic_output(path) as temporary:
        temporary.write_text("half")
        assert temporary.suffix == ".txt"
        assert names(tmp_path) == ["new", f"new/{temporary.name}"]
    assert names(tmp_path) == ["new", "new/a.txt"]

    def stopped() -> None:
        with atomic_output(path) as temporary:
            temporary.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    assert names(tmp_path) == ["new", "new/a.txt"]
    assert path.read_text() == "half"


def test_an_interrupted_creation_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A signal can arrive between the creation of the temporary file and the next line of Python."""
    create = os.open

    def interrupted(*arguments: Any) -> int:
        os.close(create(*arguments))
        assert len(names(tmp_path)) == 1
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "open", interrupted)
    with pytest.raises(KeyboardInterrupt), atomic_output(tmp_path / "a.txt"):
        pass
    assert not names(tmp_path)


def test_every_writer_writes_in_place(tmp_path: Path) -> None:
    """A temporary file that a library replaced would be neither locked nor flushed."""
    picture, choice = np.zeros((16, 16, 3), np.uint8), VideoChoice(Fraction(25), 8)
    for path, writer in (
        (tmp_path / "a.mp4", new_video),
        (tmp_path / "a.mov", new_video),
        (tmp_path / "a.mkv", new_video),
        (tmp_path / "a.y4m", new_y4m),
    ):
        with writer(path, choice) as video:
            video.write(picture)
            (temporary,) = tmp_path.glob(".*")
            before = temporary.stat().st_ino
        assert path.stat().st_ino == before
    with new_file(tmp_path / "a.h5") as root:
        root["a"] = 1
        (temporary,) = tmp_path.glob(".*")
        before = temporary.stat().st_ino
    assert (tmp_path / "a.h5").stat().st_ino == before


def test_only_what_a_dead_run_left_of_the_output_is_removed(tmp_path: Path) -> None:
    others = [".b.01234567.l3tmp.h5", ".a.01234567.l3tmp.png", ".a.h5", "a.l3tmp.h5", ".a.tmp.h5"]
    for name in (DEAD, ".a.h5.l3lock", *others):
        (tmp_path / name).touch()
    with atomic_output(tmp_path / "a.h5") as alive, sole_writer_of_file(tmp_path / "a.h5") as locked:
        assert locked
        assert names(tmp_path) == sorted([alive.name, ".a.h5.l3lock", *others])
    assert names(tmp_path) == sorted(["a.h5", *others])
    with sole_writer_of_folder(tmp_path):
        assert names(tmp_path) == sorted(["a.h5", ".l3lock", *others[2:]])


def test_one_run_at_a_time(tmp_path: Path) -> None:
    path = tmp_path / "new/deep/a.h5"

    def claim() -> None:
        with sole_writer_of_file(path):
            pass

    with sole_writer_of_file(path):
        assert in_a_child(claim) == 1
        with pytest.raises(L3Error, match="being written by another run"):
            claim()
        with sole_writer_of_file(path.with_name("b.h5")), sole_writer_of_folder(path.parent):
            pass  # other outputs
    assert names(tmp_path) == []
    with (
        sole_writer_of_folder(path.parent, "%04d.png"),
        pytest.raises(L3Error),
        sole_writer_of_folder(path.parent, "%04d.png"),
    ):
        pass
    assert names(tmp_path) == []


def test_the_lock_of_a_dead_run_is_free(tmp_path: Path) -> None:
    def die() -> None:
        with sole_writer_of_file(tmp_path / "a.h5"), atomic_output(tmp_path / "a.h5"):
            os._exit(0)

    assert in_a_child(die) == 0
    assert len(names(tmp_path)) == 2
    with sole_writer_of_file(tmp_path / "a.h5"):
        assert names(tmp_path) == [".a.h5.l3lock"]
    assert names(tmp_path) == []


def test_a_lock_that_is_removed_while_it_is_taken_is_taken_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its file is opened, then its holder ends and removes it, then the lock of a file without a name is got."""
    path, really = tmp_path / "a.h5", fcntl.flock
    holder = sole_writer_of_file(path)
    holder.__enter__()

    def first_let_go(descriptor: int, operation: int) -> None:
        monkeypatch.setattr(fcntl, "flock", really)
        holder.__exit__(None, None, None)
        really(descriptor, operation)

    def claim() -> None:
        with sole_writer_of_file(path):
            pass

    monkeypatch.setattr(fcntl, "flock", first_let_go)
    with sole_writer_of_file(path):
        assert in_a_child(claim) == 1
    assert in_a_child(claim) == 0
    assert names(tmp_path) == []


def test_storage_without_locks_is_reported_and_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, l3: L3) -> None:
    def unknown(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", unknown)
    (tmp_path / DEAD).touch()
    with sole_writer_of_file(tmp_path / "a.h5") as locked:
        assert not locked
        write_whole(tmp_path / "a.h5", "a")
    assert names(tmp_path) == sorted([DEAD, "a.h5"])  # whether its writer is dead cannot be known
    (tmp_path / "in.json").write_text("[]")
    code, _, err = l3("compare", tmp_path / "in.json", "-o", tmp_path / "a.html")
    assert code == 3
    assert err.startswith(f"warning: {tmp_path}/a.html is on storage without file locks")


def test_a_full_disk_names_the_output(tmp_path: Path) -> None:
    def full() -> None:
        with atomic_output(tmp_path / "a.txt"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(L3Error, match="cannot be written: No space left on device; free some space"):
        full()
    with pytest.raises(L3Error, match="cannot be written: File exists"):
        write_whole(Path("/dev/null/a.txt"), "")
    assert files.TEMPORARY.fullmatch(DEAD)

    def block_disk() -> None:
        with atomic_output(tmp_path / "b.txt"):
            (tmp_path / "b.txt").mkdir()

    with pytest.raises(L3Error, match=r"b\.txt cannot be written: Is a directory; choose another output"):
        block_disk()
    assert names(tmp_path) == ["b.txt"]


def test_a_raw_file_that_does_not_fit_names_itself(bayer: CameraModel, tmp_path: Path) -> None:
    """The library that makes it would say that only a part of an array was written."""
    path, before = tmp_path / "a.dng", resource.getrlimit(resource.RLIMIT_FSIZE)
    colour = {light: np.eye(3) for light in LIGHT_CODES}
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, before[1]))
    try:
        with pytest.raises(L3Error, match=r"a\.dng cannot be written: File too large; free some space"):
            write_dng(path, np.full((64, 64), 500, np.uint16), bayer, colour, None, 0.01)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert names(tmp_path) == []


# ------------------------------------------------------------------------------------------------ in folders of others


@pytest.mark.parametrize("kind", ["link", "dangling link", "pipe", "folder"])
def test_what_lies_in_the_locks_place_is_neither_followed_nor_touched(tmp_path: Path, kind: str) -> None:
    victim, lock = tmp_path / "victim", tmp_path / ".out.h5.l3lock"
    victim.write_text("mine")
    victim.chmod(0o600)
    if kind == "pipe":
        os.mkfifo(lock)
    elif kind == "folder":
        lock.mkdir()
    else:
        lock.symlink_to(victim if kind == "link" else tmp_path / "new")
    with (
        pytest.raises(L3Error, match=r"\.out\.h5\.l3lock is not an l3 lock file; remove it"),
        sole_writer_of_file(tmp_path / "out.h5"),
    ):
        pass
    assert names(tmp_path) == [".out.h5.l3lock", "victim"]
    assert (victim.stat().st_mode & 0o777, victim.read_text()) == (0o600, "mine")


def test_a_link_among_the_temporary_files_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "victim").write_text("mine")
    (tmp_path / DEAD).symlink_to(tmp_path / "victim")
    os.mkfifo(tmp_path / ".a.01234568.l3tmp.h5")
    with sole_writer_of_file(tmp_path / "a.h5"):
        pass
    assert names(tmp_path) == [DEAD, ".a.01234568.l3tmp.h5", "victim"]


@pytest.mark.parametrize(("umask", "mode"), [(0o022, 0o644), (0o077, 0o600), (0o002, 0o664)])
def test_modes_are_the_umasks_and_no_more_than_the_output_had(tmp_path: Path, umask: int, mode: int) -> None:
    path = tmp_path / "a.h5"

    def modes() -> tuple[int, ...]:
        with sole_writer_of_file(path), atomic_output(path) as temporary:
            temporary.write_text("a")
            hidden = (tmp_path / ".a.h5.l3lock", temporary)
            hidden_modes = tuple(each.stat().st_mode & 0o777 for each in hidden)
        return (*hidden_modes, path.stat().st_mode & 0o777)

    before = os.umask(umask)
    try:
        assert modes() == (mode, mode, mode)
        path.chmod(0o600)  # a private output that is replaced stays private
        assert modes() == (0o600, 0o600, 0o600)
        path.chmod(0o444)
        assert modes() == (0o644 & ~umask,) * 3  # we must write it ourselves
    finally:
        os.umask(before)


def test_the_lock_of_another_users_dead_run_is_free_where_it_can_be_read(tmp_path: Path) -> None:
    if os.geteuid():
        pytest.skip("only root can be another user")
    tmp_path.chmod(0o777)
    for folder in tmp_path.parents[:3]:
        folder.chmod(folder.stat().st_mode | 0o011)

    def as_nobody() -> None:
        os.setgid(65534)
        os.setuid(65534)
        with sole_writer_of_file(tmp_path / "a.h5"):
            pass

    lock = tmp_path / ".a.h5.l3lock"
    lock.touch(0o644)
    assert in_a_child(as_nobody) == 0
    assert names(tmp_path) == []
    lock.touch(0o600)
    assert in_a_child(as_nobody) == 1
    assert names(tmp_path) == [".a.h5.l3lock"]


@pytest.mark.parametrize("name", ["n" * 240 + ".h5", "µ" * 120 + ".h5", "a." + "s" * 240, "m" * 255])
def test_names_as_long_as_names_may_be(tmp_path: Path, name: str) -> None:
    path, other = tmp_path / name, tmp_path / (name[:-8] + "x" + name[-7:])

    def die() -> None:
        with sole_writer_of_file(path), atomic_output(path):
            os._exit(0)

    assert in_a_child(die) == 0
    assert len(names(tmp_path)) == 2
    with sole_writer_of_file(other):
        assert len(names(tmp_path)) == 3  # it is distinguished from its like
    with sole_writer_of_file(path) as locked, atomic_output(path) as temporary:
        assert locked
        assert len(names(tmp_path)) == 2  # what the dead run left is gone
        assert temporary.suffix == (path.suffix if len(path.suffix) in range(1, 10) else ".l3tmp")
        temporary.write_text("whole")
    assert names(tmp_path) == [name]
    os.fsencode(temporary.name).decode("utf-8")  # no letter is cut in two


def test_a_worker_notices_another_file_of_the_same_size_and_time(tmp_path: Path) -> None:
    path = tmp_path / "frame.raw"
    path.write_bytes(b"one")
    digest, before = sha256(path), path.stat()
    require_same(path, digest)
    path.write_bytes(b"two")
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    with pytest.raises(InputFileError, match="differs on the machine of a worker"):
        require_same(path, digest)
    with pytest.raises(InputFileError, match="cannot be read by a worker"):
        require_same(tmp_path / "absent", digest)
