"""Frames a second of a 1280×720 clip in VapourSynth and GStreamer, beside `l3 render` in the same run.

python -m pytest -m slow -s tests/studies/test_host_rate.py      (half a minute; L3_TABLE: another table, of any sensor)

Machines are shared and noisy: what is asserted is that every frame arrives, the rates are for reading.
"""

import dataclasses
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import l3cli
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from tests.helpers.cameras import BAYER
from tests.helpers.gstreamer import environment, require_gstreamer
from tests.helpers.tables import random_table

FRAMES, ROWS, COLS = int(os.environ.get("L3_VIDEO_FRAMES", "200")), 720, 1280
L3 = (sys.executable, "-c", "from l3cli.cli import main; main()")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A table, and a clip of smooth light with noise: what classes do is as in pictures."""
    where, rng = tmp_path_factory.mktemp("rate"), np.random.default_rng(0)
    given = os.environ.get("L3_TABLE")
    table = load(TransformTable, Path(given)) if given else random_table(BAYER, black_level=64.0)
    save(dataclasses.replace(table, rows=ROWS, cols=COLS), where / "table.h5")
    light = np.add.outer(np.linspace(0.02, 0.5, ROWS), np.linspace(0, 0.3, COLS)) * (table.white_level - table.black_level)
    with (where / "clip.raw").open("wb") as clip:
        for _ in range(FRAMES):
            noisy = table.black_level + light + rng.normal(size=light.shape, scale=4)
            np.clip(np.rint(noisy), 0, table.white_level).astype("<u2").tofile(clip)
    return where


def report(what: str, seconds: float) -> None:
    print(f"{what}: {FRAMES / seconds:.1f} frames/s, {1000 * seconds / FRAMES:.1f} ms each")


def test_the_command(folder: Path) -> None:
    """To y4m that nobody reads, with the start of the process."""
    start = time.monotonic()
    with (folder / "clip.raw").open("rb") as clip:
        call = [*L3, "render", "table.h5", "-", "--size", f"{ROWS}x{COLS}", "-o", "-", "--quiet"]
        film = subprocess.Popen(call, cwd=folder, stdin=clip, stdout=subprocess.PIPE)
    assert film.stdout is not None
    nbytes = 0
    while part := film.stdout.read(1 << 20):
        nbytes += len(part)
    assert film.wait() == 0
    assert nbytes > FRAMES * ROWS * COLS * 1.5
    report("l3 render to y4m", time.monotonic() - start)


def test_the_python_interface(folder: Path) -> None:
    clip = np.memmap(folder / "clip.raw", "<u2", "r", shape=(FRAMES, ROWS, COLS))
    show = l3cli.Renderer(folder / "table.h5").sequence(None)
    show(clip[0])
    start = time.monotonic()
    for frame in clip:
        show(frame)
    report("Renderer.sequence", time.monotonic() - start)


@pytest.mark.parametrize("form", ["RGB", "RGBA64_LE"])
def test_gstreamer(folder: Path, form: str) -> None:
    """With the start of the process."""
    require_gstreamer()
    source = f"filesrc location=clip.raw ! rawvideoparse format=gray16-le width={COLS} height={ROWS} framerate=30/1"
    line = f"gst-launch-1.0 -q {source} ! queue ! l3render table=table.h5 ! video/x-raw,format={form} ! queue ! fakesink"
    start = time.monotonic()
    subprocess.run(line.split(), cwd=folder, env=environment(), check=True, timeout=300)
    report(f"GStreamer, {form}", time.monotonic() - start)


@pytest.mark.parametrize("bits", [8, 16])
def test_vapoursynth(folder: Path, bits: int) -> None:
    """Python ≥ 3.12."""
    vs = pytest.importorskip("vapoursynth")
    from l3cli.video_hosts.vapoursynth import render

    raw = np.memmap(folder / "clip.raw", "<u2", "r", shape=(FRAMES, ROWS, COLS))
    blank = vs.core.std.BlankClip(width=COLS, height=ROWS, length=FRAMES, format=vs.GRAY16, keep=True)

    def filled(n: int, f: Any) -> Any:
        made = f.copy()
        np.asarray(made[0])[...] = raw[n]
        return made

    clip = render(blank.std.ModifyFrame([blank], filled), folder / "table.h5", bits=bits)
    start = time.monotonic()
    count = sum(1 for _ in clip.frames(close=True))
    report(f"VapourSynth, {bits} bits", time.monotonic() - start)
    assert count == FRAMES
