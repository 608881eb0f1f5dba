"""Foreign files are decoded in an isolated process with limits of time and memory."""

import dataclasses
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.store import save
from l3cli.errors import InputFileError
from l3cli.io import isolated
from l3cli.io.decoder_process import ABI, SECCOMP, measures
from l3cli.io.pictures.openimageio import write_mosaic
from l3cli.system.limits import MEGAPIXELS, TRUST
from tests.helpers.calls import L3
from tests.helpers.cameras import BAYER
from tests.helpers.decoders import (
    LANDLOCK_SINCE,
    REACHES,
    abort,
    count,
    crash,
    echo,
    hoard,
    limits,
    reach,
    read,
    sleep,
    stumble,
    work,
    write_much,
)
from tests.helpers.tables import random_table
from tests.helpers.tasks import PATIENCE


@pytest.fixture
def limited(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("f", "bad.dng"):
        (tmp_path / name).touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    monkeypatch.setenv("L3_DECODE_SECONDS", "1")
    monkeypatch.setenv(MEGAPIXELS, "4")
    monkeypatch.delenv(TRUST, raising=False)


def test_values_come_back_as_they_went_and_one_child_decodes_all(limited: None) -> None:
    first, second = echo(Path("f"), "é\udcff", None), echo(Path("f"), "", 2**70)
    assert first["process"] == second["process"] != os.getpid()
    assert (first["received"], second["received"]) == (("é\udcff", None, [1.5, True]), ("", 2**70, [1.5, True]))
    arrays = first["arrays"]
    assert (arrays["empty"].shape, arrays["empty"].dtype, arrays["one"]) == ((0, 3), np.float32, 2.5)
    assert arrays["F"].tolist() == [[0, 1, 2], [3, 4, 5]]
    assert arrays["F"].dtype == np.dtype(">u2")
    assert arrays["C"].tolist() == [False, False, True, True]


@pytest.mark.parametrize(
    ("decoder", "message"),
    [
        (crash, "crashes its decoder (SIGSEGV)"),
        (abort, "crashes its decoder (SIGABRT)"),
        (work, "takes longer than 1 s to decode"),
        (hoard, "needs more memory to decode than"),
        (stumble, "cannot be decoded (IndexError: list index"),
        (write_much, "File too large"),
    ],
)
def test_a_file_at_worst_ends_its_decoder(limited: None, decoder: Callable[[Path], None], message: str) -> None:
    with pytest.raises(InputFileError, match=r"^bad.dng") as caught:
        decoder(Path("bad.dng"))
    assert message in str(caught.value)
    assert echo(Path("f"), "still here", 0)["received"][0] == "still here"


def test_limits_are_not_lifted_again(limited: None) -> None:
    assert all(soft == hard != resource.RLIM_INFINITY for soft, hard in limits(Path("f")))


@pytest.mark.parametrize("what", REACHES)
def test_a_decoder_reaches_nothing_but_its_file(limited: None, what: str) -> None:
    Path("secret").write_text("the caller's")
    held = measures(Path("f"))
    abi = max([int(each.removeprefix(ABI)) for each in held if each.startswith(ABI)], default=0)
    if SECCOMP not in held and abi < LANDLOCK_SINCE.get(what, 1):
        pytest.skip("no measure that prevents this is available here")
    assert reach(Path("f"), what, "secret") in ("EACCES", "EPERM")
    assert {path.name for path in Path().iterdir()} == {"f", "bad.dng", "secret"}


def test_a_confined_decoder_reads_its_file_and_the_installation(limited: None) -> None:
    Path("f").write_bytes(b"content")
    Path("link").symlink_to("f")
    assert read(Path("f"))[0] == read(Path("link"))[0] == 7
    Path("new").write_bytes(b"other")
    Path("new").replace("f")  # another file of the name
    assert read(Path("f"))[0] == 5


def test_a_name_that_libraries_cannot_open_is_refused(limited: None) -> None:
    name = Path(os.fsdecode(b"\xff.dng"))
    name.touch()
    with pytest.raises(InputFileError, match="is not UTF-8"):
        read(name)


def test_files_read_in_turn_keep_their_processes(limited: None) -> None:
    names = [Path(f"{number}") for number in range(10)]
    for name in names:
        name.touch()
    assert [count(name) for name in names[:3] * 2] == [1, 1, 1, 2, 2, 2]
    assert [count(name) for name in names] == [3, 3, 3] + [1] * 7
    assert count(names[-1]) == 2
    assert count(names[0]) == 1  # the one asked longest ago has ended


def test_a_decoder_that_sleeps_is_ended_by_the_clock(limited: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(isolated, "WALL_PER_CPU_TIME", 1)
    with pytest.raises(InputFileError, match="takes longer"):
        sleep(Path("bad.dng"))


def test_who_trusts_decodes_in_place(limited: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(TRUST, "1")
    assert echo(Path("f"), "", 0)["process"] == os.getpid()
    with pytest.raises(InputFileError, match=r"^f cannot be decoded \(IndexError"):
        stumble(Path("f"))


def test_trust_is_an_option(l3: L3, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    monkeypatch.setattr(isolated._Child, "ask", lambda *_: seen.append("asked"))
    table = dataclasses.replace(random_table(BAYER, bits=12, black_level=64.0), rows=20, cols=24)
    save(table, tmp_path / "table.h5")
    write_mosaic(tmp_path / "a.tif", np.full((20, 24), 900, np.uint16))
    call = ("render", tmp_path / "table.h5", tmp_path / "a.tif", "--backend", "reference", "-o", tmp_path / "a.png")
    assert l3(*call, "--trust")[0] == 0
    assert (seen, os.environ.get(TRUST)) == ([], None)


@pytest.mark.parametrize(
    "answer",
    [
        b"no json",
        b"[]",
        b'{"dict": {}}',
        b'{"dict": {"error": "SystemExit", "message": "0"}}',
        b'{"dict": {"value": {"array": ["<f8", [1000000000000], 0]}}}',
        b'{"dict": {"value": {"array": ["<f8", [4], -8]}}}',
        b'{"dict": {"value": {"array": ["O", [1], 0]}}}',
        b'{"dict": {"value": {"array": ["<u2", [-1, -4], 0]}}}',
        b"[" * 100_000,
    ],
)
def test_a_child_that_lies_is_not_believed(limited: None, monkeypatch: pytest.MonkeyPatch, answer: bytes) -> None:
    monkeypatch.setattr(isolated, "receive", lambda *_: answer)
    with pytest.raises(InputFileError, match=r"^f: the decoder returned an invalid reply"):
        echo(Path("f"), "", 0)


def test_the_child_ends_with_its_parent(limited: None) -> None:
    program = "import os, signal\nfrom pathlib import Path\nfrom tests.helpers.decoders import echo\n"
    program += "print(echo(Path('f'), '', 0)['process'], flush=True)\nos.kill(os.getpid(), signal.SIGKILL)"
    child = int(subprocess.run([sys.executable, "-c", program], capture_output=True, check=False).stdout)
    deadline = time.monotonic() + PATIENCE
    while lives(child):
        assert time.monotonic() < deadline, f"process {child} lives on"
        time.sleep(0.05)


def lives(process: int) -> bool:
    try:
        return "(zombie)" not in Path(f"/proc/{process}/status").read_text()
    except OSError:  # it is gone, perhaps since a moment ago
        return False
