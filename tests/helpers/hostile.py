"""Hostile inputs: the files that are corrupted, the commands that read them, and the rules that every command must keep."""

import contextlib
import io
import itertools
import os
import resource
import shutil
import signal
import sys
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

from l3cli.artifacts import container
from l3cli.cli import run
from l3cli.io.raw.files import CAMERA_RAW, FORMATS, RawFormat
from l3cli.system.limits import MEGAPIXELS
from tests.helpers.hostile_inputs import DRAWN, make_inputs
from tests.helpers.hostile_spoiling import Choices, spoiled_bytes, spoiled_hdf5, spoiled_layer, spoiled_text

CACHE = str(Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser(), "l3cli"))  # l3's cache of kernels
SECONDS = 10  # of processor time; an input that takes longer is a hang
PATIENCE = 12  # multiple of SECONDS; an input that takes longer by the clock is a hang
LONGEST = 1000  # characters of a line
MEMORY = 1 << 30  # bytes that an input may allocate; MOST_MEGAPIXELS needs far less
MOST_MEGAPIXELS = 0.25  # larger inputs are refused


@dataclass(frozen=True)
class Subject:
    """A file to corrupt and the commands that read it. {file} stands for the file, {out} for the output folder."""

    name: str
    spoil: Callable[[bytes, Choices], bytes]
    commands: tuple[str, ...]
    text: str = ""  # of recipe.toml, which names the file
    often: int = 3  # times in each turn of the long run; 1 for slow commands


def _scene(source: str, name: str, more: str = "") -> str:
    return f'exposure_share = [0.9]\nilluminants = ["D65"]\n[[scene]]\nsource = "{source}"\nfile = "{name}"\n{more}'


RANGE = "wavelength_range_nm = [400, 700, 50]\n"
SIMULATE = "simulate recipe.toml --camera camera.toml -o {out}/t.h5"
DRAW_WITH = "simulate drawn.toml --camera {file} -o {out}/t.h5"
REPORT = "report {file} -o {out}/r.html"
RENDER = "render table.h5 {file} -o {out}/a.png --backend reference"
SEQUENCE = "render table.h5 {file} -o {out}/%d.png --backend reference --skip-bad"
CALIBRATE = "calibrate {file} -o {out}/camera.h5 --accept"
LISTED = "calibrate lab/MEASUREMENTS.toml -o {out}/camera.h5 --accept"
CHECK = "check camera.toml {file}"


def _frame(kind: RawFormat) -> Subject:
    """Return the raw file of a format, which hostile_inputs.py writes."""
    spoil = spoiled_hdf5 if kind.module == "hdf5" else spoiled_bytes
    size = " --size 20x24" if kind.wants_geometry else ""
    return Subject(f"frame{kind.suffixes[0]}", spoil, ((RENDER if kind.holds_frame else SEQUENCE) + size,))


SUBJECTS = (
    Subject(
        "camera.h5",
        spoiled_hdf5,
        ("info {file}", "info {file} --json", DRAW_WITH, REPORT),
    ),
    Subject("table.h5", spoiled_hdf5, ("info {file}", "render {file} frame.npy -o {out}/a.png --backend reference", REPORT)),
    Subject("tree.h5", spoiled_layer, ("info {file}", "render {file} frame.npy -o {out}/a.png --backend reference", REPORT)),
    Subject(
        "training.h5",
        spoiled_hdf5,
        (
            "info {file}",
            "train {file} --classes classes.toml -o {out}/t.h5",
            "evaluate table.h5 {file} --backend reference --pictures {out}/p",
            REPORT,
        ),
        often=1,
    ),
    Subject("sums.h5", spoiled_hdf5, ("train --merge {file} -o {out}/t.h5",), often=1),
    Subject("camera.toml", spoiled_text, (DRAW_WITH, "check {file}")),
    Subject("curves.toml", spoiled_text, (DRAW_WITH, "check {file}")),
    Subject(
        "scenes.toml", spoiled_text, ("simulate {file} --camera camera.toml -o {out}/t.h5 --pictures {out}", CHECK), often=1,
    ),
    Subject("classes.toml", spoiled_text, ("train training.h5 --classes {file} -o {out}/t.h5", CHECK), often=1),
    Subject("lab.toml", spoiled_text, ("lab camera.toml --recipe {file} -o {out}/lab", CHECK), often=1),
    Subject("lab/MEASUREMENTS.toml", spoiled_text, (CALIBRATE, CHECK), often=1),
    Subject("table.toml", spoiled_text, (CALIBRATE,)),
    Subject("sweep.csv", spoiled_text, ("calibrate table.toml -o {out}/camera.h5 --accept",)),
    Subject("diode.csv", spoiled_text, ("calibrate table.toml -o {out}/camera.h5 --accept",)),
    Subject("curves.csv", spoiled_text, ("simulate drawn.toml --camera curves.toml -o {out}/t.h5",)),
    Subject("curves.json", spoiled_text, ("calibrate curves_of.toml -o {out}/camera.h5 --accept",)),
    Subject("lamp.csv", spoiled_text, (SIMULATE,), 'illuminants = ["lamp.csv"]\n' + DRAWN),
    Subject("lab/spectra/mono.csv", spoiled_text, (LISTED,), often=1),
    Subject("lab/spectra/chart_010_D65.csv", spoiled_text, (LISTED,), often=1),
    Subject("lab/white/012_D65_0.tif", spoiled_bytes, (LISTED,), often=1),
    Subject("lab/mono/000_430nm.tif", spoiled_bytes, (LISTED,), often=1),
    Subject("lab/dark/015_cap_0.pgm", spoiled_bytes, ("calibrate lab/pgm.toml -o {out}/camera.h5 --accept",), often=1),
    Subject("evaluation.json", spoiled_text, ("compare {file} other.json --figure psnr -o {out}/c.html",)),
    *map(_frame, (each for each in FORMATS if each is not CAMERA_RAW)),
    Subject("frame.raw10", spoiled_bytes, (RENDER + " --size 20x24",)),
    Subject("stack.npy", spoiled_bytes, (SEQUENCE,)),
    Subject("scene.mat", spoiled_bytes, (SIMULATE,), _scene("iset", "scene.mat")),
    Subject("scene73.mat", spoiled_hdf5, (SIMULATE,), _scene("iset", "scene73.mat")),
    Subject("packed.mat", spoiled_bytes, (SIMULATE,), _scene("cube", "packed.mat", RANGE)),
    Subject("cube.h5", spoiled_hdf5, (SIMULATE,), _scene("cube", "cube.h5", RANGE)),
    Subject("cube.npy", spoiled_bytes, (SIMULATE,), _scene("cube", "cube.npy", RANGE)),
    Subject("cube.hdr", spoiled_text, (SIMULATE,), _scene("envi", "cube.hdr")),
    Subject("bands/band_3.png", spoiled_bytes, (SIMULATE,), _scene("bands", "bands", RANGE)),
    Subject("channels.exr", spoiled_bytes, (SIMULATE,), _scene("channels", "channels.exr")),
    Subject("pages.tif", spoiled_bytes, (SIMULATE,), _scene("channels", "pages.tif", RANGE)),
    Subject("picture.png", spoiled_bytes, (SIMULATE,), _scene("rgb", "picture.png")),
    Subject("picture.jpg", spoiled_bytes, (SIMULATE,), _scene("rgb", "picture.jpg")),
    Subject("picture.tif", spoiled_bytes, (SIMULATE,), _scene("rgb", "picture.tif")),
)  # fmt: skip


# ------------------------------------------------------------------------------------------------------- judgement


class Hang(BaseException):
    """Raised if an input takes too long."""


@contextlib.contextmanager
def confined() -> Iterator[None]:
    """Limit the size of inputs, the time of decoders, and the memory of this process."""
    before = {name: os.environ.get(name) for name in (MEGAPIXELS, "L3_DECODE_SECONDS")}
    os.environ |= {MEGAPIXELS: str(MOST_MEGAPIXELS), "L3_DECODE_SECONDS": "3"}
    old = resource.getrlimit(resource.RLIMIT_AS)
    has = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (has + MEMORY, old[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, old)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


class Workshop:
    """A folder of valid inputs. One of them at a time is corrupted and read."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.inputs = folder, folder / "inputs"
        make_inputs(self.inputs)
        self.names = self.files()
        self.whole = {subject.name: (self.inputs / subject.name).read_bytes() for subject in SUBJECTS}
        self.recipe = (self.inputs / "recipe.toml").read_bytes()

    def files(self) -> set[Path]:
        """Return all files in the folder."""
        # Path.rglob of Python 3.11.2 fails at a link whose target has too long a name.
        return {Path(folder, name) for folder, *names in os.walk(self.folder) for name in itertools.chain(*names)}

    def judge(self, subject: Subject, choices: Choices) -> str | None:
        """Corrupt the subject's file, run a command on it, and return what went wrong, or None."""
        content = subject.spoil(self.whole[subject.name], choices)
        return self.judge_content(subject, content, choices.integer(0, len(subject.commands) - 1))

    def judge_content(self, subject: Subject, content: bytes, command: int = 0) -> str | None:
        """Run a command of the subject on `content`, and return what went wrong, or None."""
        path, out = self.inputs / subject.name, self.folder / "out"
        (self.inputs / "recipe.toml").write_text(subject.text or DRAWN)
        path.write_bytes(content)
        if content.startswith(container.TITLE):
            container.seal(path)  # without a new digest, every change would be detected
        arguments = [word.format(file=path, out=out) if "{" in word else word for word in subject.commands[command].split()]
        try:
            with contextlib.chdir(self.inputs):
                return verdict(arguments) or self.strays(out)
        finally:
            path.write_bytes(self.whole[subject.name])
            (self.inputs / "recipe.toml").write_bytes(self.recipe)
            shutil.rmtree(out, ignore_errors=True)

    def strays(self, out: Path, known: set[Path] | None = None) -> str | None:
        """Return files outside `out` that were not there before (in `known`, or at the beginning), or None."""
        new = {path for path in self.files() - (known or self.names) if path != out and out not in path.parents}
        return f"left {sorted(map(str, new))}" if new else None


def verdict(
    arguments: list[str],
    patience: float = PATIENCE * SECONDS,
    codes: tuple[int, ...] = (0, 1, 2, 3),
    lines: int | None = None,
) -> str | None:
    """Run `l3 ARGUMENTS` and return what went wrong, or None.

    The exit code must be one of `codes`. A failure must print one line with its reason. The run may take `patience` seconds
    and may print `lines` lines of up to LONGEST characters on stdout.
    """
    stdout, stderr = io.StringIO(), io.StringIO()
    timers = ((signal.ITIMER_PROF, signal.SIGPROF, SECONDS), (signal.ITIMER_REAL, signal.SIGALRM, patience))
    old = [signal.signal(number, _ring) for _, number, _ in timers]
    for timer, _, seconds in timers:
        signal.setitimer(timer, seconds)
    try:
        with contextlib.redirect_stdout(stdout), contextlib.redirect_stderr(stderr):
            code = run(arguments)
    except Hang:
        return "hangs\n" + traceback.format_exc()
    except BaseException:
        return traceback.format_exc()
    finally:
        for (timer, number, _), handler in zip(timers, old, strict=True):
            signal.setitimer(timer, 0)
            signal.signal(number, signal.SIG_DFL if handler is None else handler)  # None: a handler not set by Python
    words = stderr.getvalue()
    messages = [line for line in words.splitlines() if line.startswith("l3: ")]
    if "Traceback" in words or "out of memory" in words:
        return f"exit code {code}: {words}"
    if code not in codes or (code and not messages):
        return f"exit code {code} without a word: {words}"
    if len(messages) > 1 and "--skip-bad" not in arguments:
        return f"exit code {code} in {len(messages)} lines: {words}"
    shown = stdout.getvalue().splitlines()
    if lines is not None and (len(shown) > lines or max(map(len, shown), default=0) > LONGEST):
        return f"exit code {code} with more than {lines} lines, or one of more than {LONGEST} letters"
    if any(not (letter.isprintable() or letter == "\n") for letter in words):
        return f"exit code {code} with control characters: {words!r}"
    return None


HANGS = 300  # seconds; a call that takes longer is a hang, even on a busy machine


@contextlib.contextmanager
def timed(seconds: float) -> Iterator[None]:
    """Raise Hang if the block takes longer than `seconds`."""
    old = signal.signal(signal.SIGALRM, _ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, old)


def _ring(number: int, frame: object) -> None:
    raise Hang


_allowed: list[str] = []  # folders in which an input may write files


@contextlib.contextmanager
def watched(*folders: Path) -> Iterator[list[str]]:
    """Return a list of forbidden actions in the block.

    These are opening files for writing outside `folders`, running a shell, evaluating code, and unpickling by name.
    """
    if not _allowed:
        sys.addaudithook(_audit)
    _allowed[:] = ["on", *(str(folder) for folder in folders), CACHE, "/dev/null"]
    _seen.clear()
    try:
        yield _seen
    finally:
        _allowed[:] = ["off"]


_seen: list[str] = []


def _audit(event: str, arguments: tuple[Any, ...]) -> None:
    if not _allowed or _allowed[0] != "on":
        return
    unpickled = event.startswith("pickle.") and not _is_of_workers()
    if event == "os.system" or unpickled or (event == "subprocess.Popen" and not _is_decoder(arguments)):
        _seen.append(f"{event} {arguments}")
    elif event == "open" and isinstance(arguments[0], str) and (arguments[2] or 0) & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
        path = os.path.abspath(arguments[0])
        if not path.startswith(tuple(_allowed[1:])) and not any(part in path for part in ("__pycache__", "/.hypothesis/")):
            _seen.append(f"{event} {arguments}")


def _is_of_workers() -> bool:
    """Whether the current call receives results from worker processes of this process."""
    frame: FrameType | None = sys._getframe()
    while frame is not None and frame.f_globals.get("__name__") != "multiprocessing.connection":
        frame = frame.f_back
    return frame is not None


def _is_decoder(arguments: tuple[Any, ...]) -> bool:
    return "l3cli.io.decoder_process" in str(arguments[1])
