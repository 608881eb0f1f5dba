"""Runs whole commands in hostile environments and checks the results.

An environment has unusual streams, locales, home folders, terminals, file names or file modes. In each, a command must give
the same bytes and exit code, at most one line of warning, no traceback, and no files elsewhere. Choices come from a seed in
test_environments.py (few) or fuzz.py (many).
"""

import contextlib
import functools
import json
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from l3cli.artifacts.store import save
from l3cli.cli import run
from l3cli.io.pictures.openimageio import write_mosaic
from tests.helpers.hostile_spoiling import Choices, one_of
from tests.helpers.paths import ROOT

RUN = [sys.executable, "-m", "l3cli"]
SECONDS = 300
PLACES = int(os.environ.get("L3_HOSTILE_PLACES", "3"))  # that the test suite draws
CLOSED = ("", "0", "1", "2", "01", "02", "12", "012")
LOCALES: tuple[dict[str, str], ...] = (
    {},
    {"LC_ALL": "C.utf8"},
    {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    {"LC_ALL": "nowhere"},
    {"PYTHONIOENCODING": "ascii"},
    {"PYTHONIOENCODING": "latin-1"},
)
HOMES = ("kept", "unset", "empty", "unwritable", "file", "full")
TERMS = (None, "", "dumb", "xterm-256color", "\x1b[2J", "no such terminal")
COLUMNS = (None, "", "0", "1", "-3", "²", "1e9", "80", "99999999999999999999")
NAMES = (
    b"plain",
    b"n" * 240,
    "éµ×".encode(),
    b"f\xff\xfe",
    b"a\nl3: b\x1b[31m\x07",
    "\u202ert\u009b".encode(),
    b"two  words 'n' \"q\"",
)
UMASKS = (0o000, 0o022, 0o027, 0o077)
COMMANDS = ("render", "opencl", "info", "json", "compare", "missing", "verify")


@dataclass(frozen=True)
class Place:
    """A command and the environment in which it runs."""

    command: str
    closed: str
    locale: dict[str, str]
    home: str
    term: str | None
    columns: str | None
    name: bytes
    umask: int

    @staticmethod
    def drawn(choices: Choices) -> "Place":
        kinds = (COMMANDS, CLOSED, LOCALES, HOMES, TERMS, COLUMNS, NAMES, UMASKS)
        return Place(*(one_of(choices, kind) for kind in kinds))


def make_desk(folder: Path) -> None:
    """Make a table, a raw frame as .tif and .npy, an evaluation, and the rendered pictures reference.png and opencl.png."""
    from tests.helpers.cameras import BAYER
    from tests.helpers.tables import random_table, with_first

    table = random_table(BAYER, bits=12, black_level=64.0)
    cases = table.first.rule.case_of_code.copy()
    cases[0] = 0  # what does not clip is not taken for clipped
    save(with_first(table, rule=replace(table.first.rule, case_of_code=cases)), folder / "table.h5")
    values = np.random.default_rng(0).integers(700, 900, (20, 24)).astype(np.uint16)  # nothing worth a warning
    write_mosaic(folder / "raw.tif", values)
    np.save(folder / "raw.npy", values)
    frames = [{"luminance": light, "ours": {"scielab": 2.0}} for light in (1.0, 10.0)]
    (folder / "evaluation.json").write_text(json.dumps({"camera": "µ\x1b[2J\u202e", "frames": frames}))
    for backend in ("reference", "opencl"):
        call = ["render", f"{folder}/table.h5", f"{folder}/raw.tif", "-o", f"{folder}/{backend}.png", "--exposure", "1"]
        assert run([*call, "--backend", backend, "--quiet"]) == 0


@functools.cache
def small_disks() -> bool:
    """Whether small disks of any size can be mounted here."""
    with tempfile.TemporaryDirectory() as folder:
        mount = ["unshare", "-rm", "mount", "-t", "tmpfs", "tmpfs", folder]
        return shutil.which("unshare") is not None and not subprocess.run(mount, capture_output=True).returncode


def judge(desk: Path, place: Place) -> str | None:
    """Run a command in an environment and return what went wrong, or None."""
    with tempfile.TemporaryDirectory(prefix="l3-place-") as folder:
        return _judge(desk, place, Path(folder))


def _judge(desk: Path, place: Place, folder: Path) -> str | None:
    work, tmp, home = folder / "work", folder / "tmp", folder / "home"
    for each in (work, tmp, home):
        each.mkdir()
    inside = os.fsencode(work) + b"/" + place.name
    for source, suffix in (("table.h5", b".h5"), ("raw.tif", b".tif"), ("raw.npy", b".npy"), ("evaluation.json", b".json")):
        shutil.copy(os.fsencode(desk / source), inside + suffix)
    before = set(os.listdir(os.fsencode(work)))
    line, code, made = _call(place)
    ended = _run(line, place, work, tmp, home)
    new = set(os.listdir(os.fsencode(work))) - before
    problem = f"exit code {ended.returncode}, not {code}" if ended.returncode != code else _judge_text(place, ended, code)
    if problem is None and new != ({place.name + b".png"} if made else set()):
        problem = f"made {new}"
    if problem is None and made and Path(os.fsdecode(inside + b".png")).read_bytes() != (desk / made).read_bytes():
        problem = "another picture"
    if problem is None and made and os.stat(inside + b".png").st_mode & 0o777 != 0o666 & ~place.umask:
        problem = "another mode"
    if problem is None and os.listdir(tmp):
        problem = f"left {os.listdir(tmp)}"
    return None if problem is None else f"{place}: {problem}\n{ended.stdout[-500:]!r}\n{ended.stderr[-2000:]!r}"


def _call(place: Place) -> tuple[list[bytes], int, str]:
    """Return the words of the command, its exit code, and the file that its picture must equal."""
    name = place.name
    render = [b"render", name + b".h5", name + b".tif", b"-o", name + b".png", b"--exposure", b"1", b"--backend"]
    calls: dict[str, tuple[list[bytes], int, str]] = {
        "render": ([*render, b"reference"], 0, "reference.png"),
        "opencl": ([*render, b"opencl"], 0, "opencl.png"),
        "info": ([b"info", name + b".h5"], 0, ""),
        "json": ([b"info", name + b".h5", b"--json"], 0, ""),
        "compare": ([b"compare", name + b".json"], 0, ""),
        "missing": ([b"info", name + b"x"], 3, ""),
        "verify": ([b"info", b"--verify", name + b".h5", name + b".tif"], 3, ""),
    }
    return calls[place.command]


def _run(line: list[bytes], place: Place, work: Path, tmp: Path, home: Path) -> "subprocess.CompletedProcess[bytes]":
    cleared = ("HOME", "XDG_CACHE_HOME", "POCL_CACHE_DIR", "TERM", "COLUMNS", "LC_ALL", "LANG", "PYTHONIOENCODING")
    known = {key: value for key, value in os.environ.items() if key not in cleared}
    known |= {"PYTHONPATH": str(ROOT), "TMPDIR": str(tmp), **place.locale}
    known |= {key: value for key, value in (("TERM", place.term), ("COLUMNS", place.columns)) if value is not None}
    before = ""
    if place.home == "unwritable":
        known["HOME"] = "/proc"
    elif place.home == "file":
        known["HOME"] = str(ROOT / "README.md")
    elif place.home == "empty":
        known["HOME"] = ""
    elif place.home != "unset":
        known["HOME"] = str(home)
    if place.home == "kept":
        known["HOME"] = os.environ.get("HOME", str(home))
    prefix: list[str] = []
    if place.home == "full" and small_disks():
        prefix, before = ["unshare", "-rm"], f"mount -t tmpfs -o size=8k tmpfs '{home}' && "
    shut = " ".join(f"{number}>&-" for number in place.closed)
    script = f'{before}umask {place.umask:03o} && exec "$@" {shut}'
    command = [*prefix, "sh", "-c", script, "sh", *RUN]
    with contextlib.suppress(KeyError):
        del known["L3_TRUST"]
    return subprocess.run([*map(os.fsencode, command), *line], cwd=work, env=known, capture_output=True, timeout=SECONDS)


def _judge_text(place: Place, ended: "subprocess.CompletedProcess[bytes]", code: int) -> str | None:
    """Return what is wrong with the command's output, or None."""
    words = ended.stderr.decode("utf-8", "replace")
    lines = words.splitlines()
    messages = [each for each in lines if each.startswith("l3: ")]
    if "Traceback" in words or len(lines) - len(messages) > 1 or len(messages) != (bool(code) and "2" not in place.closed):
        return "said too much or too little"
    if any(each.startswith("warning: ") is False for each in lines if each not in messages):
        return "no warning"
    text = (ended.stdout + ended.stderr).decode("latin-1" if "latin" in str(place.locale) else "utf-8")
    if any(not (letter.isprintable() or letter == "\n") for letter in text):
        return "control characters"
    if place.command in ("info", "json", "compare") and "1" not in place.closed and not ended.stdout:
        return "no result"
    if place.command == "json" and "1" not in place.closed:
        json.loads(ended.stdout)
    return None
