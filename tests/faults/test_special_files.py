"""Pipes, sockets, devices, folders and broken links are rejected before they are opened, so that no command hangs."""

import os
import re
import socket
from pathlib import Path

import pytest

from l3cli.artifacts.store import save
from l3cli.errors import InputFileError
from l3cli.system.files import open_regular, require_regular, sha256
from l3cli.system.limits import read_bounded
from tests.helpers.calls import Refused
from tests.helpers.hostile import HANGS, timed
from tests.helpers.sequences import FAST, RGGB


@pytest.fixture
def places(tmp_path: Path) -> Path:
    """A folder with one place of each kind."""
    folder = tmp_path / "places"
    folder.mkdir()
    os.mkfifo(folder / "pipe")
    (folder / "folder").mkdir()
    (folder / "device").symlink_to("/dev/zero")
    (folder / "nothing").symlink_to("/dev/null")
    (folder / "dangling").symlink_to("nowhere")
    (folder / "loop").symlink_to("loop")
    one = socket.socket(socket.AF_UNIX)
    place = os.getcwd()
    os.chdir(folder)  # names of sockets are short
    one.bind("socket")
    os.chdir(place)
    one.close()
    return folder


KINDS = {
    "pipe": "is a pipe", "socket": "is a socket", "device": "is a device",
    "nothing": "is a device", "folder": "is a folder", "dangling": "does not exist",
    "loop": "cannot be read: Too many levels of symbolic links",
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_only_regular_files_are_opened(places: Path, kind: str) -> None:
    path = places / kind
    for reader in (require_regular, open_regular, sha256, read_bounded):
        with timed(HANGS), pytest.raises((InputFileError, OSError)) as caught:
            reader(path)
        assert isinstance(caught.value, InputFileError)
        assert KINDS[kind] in str(caught.value)
        assert re.search("; (specify|use) ", str(caught.value))


def test_a_file_is_opened_without_waiting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A pipe that takes the name between check and opening is refused when it is open."""
    os.mkfifo(tmp_path / "pipe")
    monkeypatch.setattr("l3cli.system.files.require_regular", lambda *_: None)
    with timed(HANGS), pytest.raises(InputFileError, match="pipe"):
        open_regular(tmp_path / "pipe")
    (tmp_path / "file").write_bytes(b"content")
    with open_regular(tmp_path / "file") as stream:
        assert os.get_blocking(stream.fileno())
        assert stream.read() == b"content"


def test_a_pipe_named_as_a_file_gets_the_hint_of_the_stream(refused: Refused, tmp_path: Path, places: Path) -> None:
    save(RGGB, tmp_path / "table.h5")
    (tmp_path / "a.raw").symlink_to(places / "pipe")
    line = refused(3, "render", tmp_path / "table.h5", tmp_path / "a.raw", "-o", tmp_path / "a.png", *FAST)
    assert "a.raw" in line


def test_a_loop_of_links_is_no_frame_and_no_folder_of_clips(refused: Refused, tmp_path: Path, places: Path) -> None:
    save(RGGB, tmp_path / "table.h5")
    (tmp_path / "loop.tif").symlink_to("loop.tif")
    line = refused(3, "render", tmp_path / "table.h5", tmp_path / "loop.tif", "-o", tmp_path / "a.png", *FAST)
    assert "loop.tif" in line
    (tmp_path / "loop").symlink_to("loop")
    line = refused(1, "render", tmp_path / "table.h5", places / "folder", "-o", tmp_path / "loop", *FAST)
    assert str(tmp_path / "loop") in line
