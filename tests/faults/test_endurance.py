"""Endurance: over many small frames, memory and speed stay constant and no file stays open.

These tests use a few hundred frames. `make soak` runs 20 000 frames through each mode of `l3 render` and 2000 through
`l3 simulate`.
"""

import dataclasses
import io
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import pytest

from l3cli.artifacts.store import save
from l3cli.io.pictures.openimageio import write_mosaic
from l3cli.io.raw.hdf5 import chunks_of_a_frame
from tests.helpers.sequences import RGGB

L3 = (sys.executable, "-c", "from l3cli.cli import main; main()")
TABLE = dataclasses.replace(RGGB, rows=64, cols=96)
DISTINCT = 50  # frames; all others are links to them
FLAT = 0.05  # share by which memory may grow from the second tenth to the last
SLOWER = 0.5  # and processor time a frame, which others on the machine stretch too: give it one that is idle
MOMENTARY = 4  # files that reading and writing have open now and then
TICKS = os.sysconf("SC_CLK_TCK")
SCENES = """
illuminants = ["D65", "A", "F2", "D50"]
luminances_cd_m2 = [1.0, 10.0, 100.0, 1000.0, 10000.0]
exposure_share = [0.9]
[[scene]]
source = "dead leaves"
size = [48, 64]
"""


@dataclass(frozen=True)
class Sample:
    """A run at a moment."""

    frames: int  # done so far
    seconds: float
    processor: float  # seconds
    memory: float  # MB
    handles: int


def sample_of(run: int, frames: int) -> Sample | None:
    """All processes of a run, which leads a process group; None if it has ended."""
    processor, memory, handles = 0.0, 0.0, 0
    for entry in Path("/proc").iterdir():
        if not entry.name.isdecimal():
            continue
        try:
            fields = (entry / "stat").read_text().rpartition(")")[2].split()
            if int(fields[2]) != run:
                continue
            status = (entry / "status").read_text().splitlines()
            handles += len(os.listdir(entry / "fd"))
        except OSError:  # it has ended meanwhile
            continue
        memory += next((int(line.split()[1]) / 1e3 for line in status if line.startswith("VmRSS")), 0.0)
        processor += sum(map(int, fields[11:15])) / TICKS  # of itself and its children that have ended
    return Sample(frames, time.monotonic(), processor, memory, handles) if memory else None


def watched(done: Callable[["subprocess.Popen[bytes]"], int], pulse: float, *command: object) -> list[Sample]:
    """Samples of `l3 COMMAND`, every `pulse` seconds while it runs; `done` counts its frames."""
    samples: list[Sample] = []
    with subprocess.Popen([*L3, *map(str, command), "--quiet"], stdout=subprocess.PIPE, start_new_session=True) as run:
        while run.poll() is None:
            frames = done(run)
            if (not samples or frames > samples[-1].frames) and (sample := sample_of(run.pid, frames)):
                samples.append(sample)
            time.sleep(pulse)
    assert run.returncode == 0
    return samples


def sipped(frame_bytes: int) -> Callable[["subprocess.Popen[bytes]"], int]:
    """Counts the frames of a y4m stream on stdout, a few of which are read at each sample: however fast they are made, there
    are samples in between."""
    got = [0]

    def done(run: "subprocess.Popen[bytes]") -> int:
        assert run.stdout is not None
        got[0] += len(run.stdout.read(4 * frame_bytes))
        return got[0] // frame_bytes

    return done


def piped(frame_bytes: int) -> Callable[["subprocess.Popen[bytes]"], int]:
    """Counts the frames of a y4m stream on stdout, which is read by a thread."""
    got = [0]
    threads: list[threading.Thread] = []

    def read(run: "subprocess.Popen[bytes]") -> None:
        assert isinstance(run.stdout, io.BufferedReader)
        while chunk := run.stdout.read1(1 << 20):
            got[0] += len(chunk)

    def done(run: "subprocess.Popen[bytes]") -> int:
        if not threads:
            threads.append(threading.Thread(target=read, args=(run,), daemon=True))
            threads[0].start()
        return got[0] // frame_bytes

    return done


def in_folder(folder: Path) -> Callable[["subprocess.Popen[bytes]"], int]:
    return lambda run: len(os.listdir(folder)) if folder.is_dir() else 0


def per_frame(samples: list[Sample], what: str, stretch: int) -> float:
    """Seconds or processor seconds a frame of the fastest stretch of so many frames: others use the machine too."""
    spent, start = [], samples[0]
    for sample in samples:
        if sample.frames - start.frames >= stretch:
            spent.append((getattr(sample, what) - getattr(start, what)) / (sample.frames - start.frames))
            start = sample
    return min(spent, default=float("nan"))


def require_steady(what: str, samples: list[Sample], frames: int, capsys: pytest.CaptureFixture[str], lasting: bool) -> None:
    """Compare the second tenth, when all is warm, with the last; of a run that does not last its halves, without rates."""
    early, late = (0.2, 0.9) if lasting else (0.5, 0.5)
    first = [sample for sample in samples if frames / 10 <= sample.frames < frames * early]
    last = [sample for sample in samples if sample.frames >= frames * late]
    assert len(first) > lasting, "too few samples; give more frames"
    assert len(last) > lasting, "too few samples; give more frames"
    memory = [float(np.median([sample.memory for sample in part])) for part in (first, last)]
    handles = [max(sample.handles for sample in part) for part in (first, last)]
    seconds, processor = (
        [per_frame(part, name, frames // 100) for part in (first, last)] for name in ("seconds", "processor")
    )
    with capsys.disabled():
        if lasting:
            print(f"\n{what}, {frames} frames, second → last tenth: {memory[0]:.1f} → {memory[1]:.1f} MB,", end=" ")
            print(f"{handles[0]} → {handles[1]} handles, {1 / seconds[0]:.0f} → {1 / seconds[1]:.0f} frames/s,", end=" ")
            print(f"{1e3 * processor[0]:.2f} → {1e3 * processor[1]:.2f} core ms a frame")
    assert memory[1] < memory[0] * (1 + FLAT)
    assert handles[1] <= handles[0] + MOMENTARY
    if lasting:
        assert processor[1] < processor[0] * (1 + SLOWER)


READERS = ("a folder of .raw", "a stack .npy")  # whose like, a folder and a stack of another kind, `make test` has


@pytest.fixture(
    params=["a folder with .tif", "a stack .h5", *(pytest.param(each, marks=pytest.mark.soak) for each in READERS)]
)
def clip(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[[int], tuple[str, Path]]:
    """Makes a sequence of so many frames."""

    def make(count: int) -> tuple[str, Path]:
        rng = np.random.default_rng(0)
        shape = (DISTINCT, TABLE.rows, TABLE.cols)
        frames = np.clip(rng.normal(800, 300, shape), 0, 4095).astype("<u2")
        kind = request.param.rpartition(".")[2]
        if kind in ("npy", "h5"):
            path = tmp_path / f"stack.{kind}"
            whole = np.resize(frames, (count, *shape[1:]))
            if kind == "npy":
                np.save(path, whole)
            else:
                with h5py.File(path, "w") as file:
                    file.create_dataset("raw", data=whole, chunks=(8, *shape[1:]), compression="gzip", compression_opts=1)
            return request.param, path
        folder = tmp_path / "frames"
        folder.mkdir()
        for number in range(count):
            path = folder / f"{number:05d}.{kind}"
            if number >= DISTINCT:
                os.link(folder / f"{number % DISTINCT:05d}.{kind}", path)
            elif kind == "raw":
                frames[number].tofile(path)
            else:
                write_mosaic(path, frames[number])
        return request.param, folder

    return make


def render(
    clip: Callable[[int], tuple[str, Path]], folder: Path, count: int, capsys: pytest.CaptureFixture[str], lasting: bool
) -> None:
    what, source = clip(count)
    save(TABLE, folder / "table.h5")
    streamed = len("FRAME\n") + TABLE.rows * TABLE.cols * 3 // 2
    if not lasting:
        done, output = sipped(streamed), "-"
    elif what.endswith((".raw", ".h5")):
        done, output = piped(streamed), "-"
    else:
        done, output = in_folder(folder / "out"), str(folder / "out/####.tif")
    samples = watched(
        done,
        0.2 if lasting else 0.0,
        "render",
        folder / "table.h5",
        source,
        "--size",
        f"{TABLE.rows}x{TABLE.cols}",
        "-o",
        output,
    )
    require_steady(f"render {what} → {'y4m' if output == '-' else 'pictures'}", samples, count, capsys, lasting)


def simulate(folder: Path, camera: Path, count: int, capsys: pytest.CaptureFixture[str], lasting: bool) -> None:
    (folder / "scenes.toml").write_text(f"{SCENES}count = {count // 20}\n")
    output = folder / "training.h5"
    command = ("simulate", folder / "scenes.toml", "--camera", camera, "-o", output)
    samples = watched(in_folder(folder / "training.h5.parts"), 0.2 if lasting else 0.02, *command)
    require_steady("simulate", samples, count, capsys, lasting)


def test_hundreds_of_frames_are_rendered(
    clip: Callable[[int], tuple[str, Path]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    render(clip, tmp_path, 240, capsys, lasting=False)


def test_a_hundred_frames_are_simulated(tmp_path: Path, bayer_recipe: Path, capsys: pytest.CaptureFixture[str]) -> None:
    simulate(tmp_path, bayer_recipe, 100, capsys, lasting=False)


@pytest.mark.parametrize(("chunks", "frames"), [((8, 10, 24), 8), ((1, 20, 48), 1), ((3, 7, 48), 3 * 21 / 20)])
def test_a_stack_keeps_no_more_than_the_next_frames(chunks: tuple[int, ...], frames: float) -> None:
    """Of chunks of many frames those that one frame lies in; a cache of more would fill as frames go by."""
    with h5py.File("stack", "w", driver="core", backing_store=False) as file:
        data = file.create_dataset("raw", shape=(100, 20, 48), dtype="uint16", chunks=chunks)
        assert chunks_of_a_frame(data) == frames * 20 * 48 * 2


@pytest.mark.soak
def test_twenty_thousand_frames_are_rendered(
    clip: Callable[[int], tuple[str, Path]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    render(clip, tmp_path, 20_000, capsys, lasting=True)


@pytest.mark.soak
def test_two_thousand_frames_are_simulated(tmp_path: Path, bayer_recipe: Path, capsys: pytest.CaptureFixture[str]) -> None:
    simulate(tmp_path, bayer_recipe, 2000, capsys, lasting=True)
