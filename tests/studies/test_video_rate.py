"""Speed of rendering a sequence to a video, compared with the encoder alone, and memory.

python -m pytest -m slow -s tests/studies/test_video_rate.py      1800 frames of 1280×720; prints all metrics (make video)
L3_VIDEO_FRAMES=600 L3_VIDEO_CLASSES=default python -m pytest …      fewer frames, and another class recipe than `fast`

Because machines are shared and noisy, the study tests only the memory and the number of frames, and prints the rates.
"""

import os
import subprocess
import sys
import time
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.io.images import read_image
from l3cli.io.raw.files import read_raw
from l3cli.io.video import VideoChoice, new_video
from tests.helpers.paths import CONFIGS

FRAMES = int(os.environ.get("L3_VIDEO_FRAMES", "1800"))
CLASSES = os.environ.get("L3_VIDEO_CLASSES", "fast")
DISTINCT = 60
MEMORY = 1000  # MB at most, whatever the length
L3 = (sys.executable, "-c", "from l3cli.cli import main; main()")
ENCODER = (sys.executable, "-c", "from tests.studies.test_video_rate import encoder_alone; encoder_alone()")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """table.h5, and frames/ with FRAMES names of DISTINCT headerless raw frames: a pan over a scene with fresh noise."""
    where = tmp_path_factory.mktemp("video")
    camera = CONFIGS / "cameras/fiveband.toml"
    made(*L3, "simulate", CONFIGS / "scenes/default.toml", "--camera", camera, "-o", where / "training.h5", "--jobs", 2)
    made(*L3, "train", where / "training.h5", "--classes", CONFIGS / f"classes/{CLASSES}.toml", "-o", where / "table.h5")
    scene = (CONFIGS / "scenes/demo_unseen.toml").read_text()
    (where / "scene.toml").write_text(f'{scene}\n[sensor]\nnoise = "none"\n')
    pictures = ("--pictures", where / "clean")
    made(*L3, "simulate", where / "scene.toml", "--camera", camera, "-o", where / "clean.h5", *pictures)
    clean = read_raw(next((where / "clean").glob("*_raw.tif")), load(TransformTable, where / "table.h5")).values
    write_pan(clean.astype(float), where / "frames")
    return where


def write_pan(clean: np.ndarray, frames: Path) -> None:
    camera = load_camera(CONFIGS / "cameras/fiveband.toml")
    rng = np.random.default_rng(0)
    spread = np.sqrt(camera.gain * np.maximum(clean - camera.black_level, 0) + (camera.gain * camera.noise.read_noise) ** 2)
    frames.mkdir()
    for number in range(FRAMES):
        path = frames / f"{number:05d}.raw"
        if number >= DISTINCT:
            os.link(frames / f"{number % DISTINCT:05d}.raw", path)
            continue
        shift = 4 * min(number, DISTINCT - number)  # there and back again, by whole super-pixels
        noisy = np.roll(clean + rng.normal(size=clean.shape) * spread, shift, axis=1)
        np.clip(np.rint(noisy), 0, 2**camera.bits - 1).astype("<u2").tofile(path)


def made(*command: object) -> None:
    subprocess.run([str(part) for part in command], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def measured(*command: object) -> tuple[float, float, float]:
    """Seconds, processor seconds and peak MB of a command."""
    start, peak = time.perf_counter(), 0.0
    with subprocess.Popen([str(part) for part in command], stdout=subprocess.DEVNULL) as process:
        while (done := os.wait4(process.pid, os.WNOHANG))[0] == 0:
            peak = max(peak, high_water(process.pid))  # of rusage, Linux lets a child begin with its parent's peak
            time.sleep(0.05)
        process.returncode = os.waitstatus_to_exitcode(done[1])
    assert process.returncode == 0
    return time.perf_counter() - start, done[2].ru_utime + done[2].ru_stime, peak


def high_water(process: int) -> float:
    """The most memory in MB that a process has had so far."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    return next((int(line.split()[1]) / 1e3 for line in lines if line.startswith("VmHWM")), 0.0)


def encoder_alone() -> None:
    """Encode the pictures in argv[1] again and again, as l3 render does."""
    pictures = np.load(sys.argv[1], mmap_mode="r")
    with new_video(Path(sys.argv[2]), VideoChoice(Fraction(30), 8)) as video:
        for number in range(FRAMES):
            video.write(pictures[number % len(pictures)])


@pytest.mark.slow
def test_video_rate(folder: Path) -> None:
    command = (*L3, "render", folder / "table.h5", folder / "frames", "--size", "720x1280", "--quiet", "--force")
    made(*command, "-o", folder / "pictures_%05d.png", "--frames", f"0-{DISTINCT - 1}")
    pictures = [read_image(folder / f"pictures_{number:05d}.png")[0] for number in range(DISTINCT)]
    np.save(folder / "pictures.npy", np.stack(pictures))
    print(f"\n{FRAMES} frames of 1280×720, {CLASSES}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    print(f"{'':34} {'s':>7} {'frames/s':>8} {'core ms a frame':>15} {'peak MB':>8}")
    rates = {}
    for name, arguments in {
        "encoder alone, H.264 veryfast": (*ENCODER, folder / "pictures.npy", folder / "alone.mp4"),
        "raw → H.264 veryfast": (*command, "-o", folder / "whole.mp4"),
        "raw → H.264, filtered in time": (*command, "-o", folder / "quiet.mp4", "--temporal"),
        "raw → y4m": (*command, "-o", "-"),
        "raw → y4m, filtered in time": (*command, "-o", "-", "--temporal"),
        "raw → 16-bit TIFF": (*command, "-o", folder / "sixteen_%05d.tif", "--bits", 16, "--frames", f"0-{FRAMES // 4 - 1}"),
    }.items():
        seconds, processor, peak = measured(*arguments)
        frames = FRAMES // 4 if "TIFF" in name else FRAMES
        rates[name] = frames / seconds
        print(f"{name:34} {seconds:7.1f} {rates[name]:8.1f} {processor / frames * 1e3:15.1f} {peak:8.0f}")
        if "raw" in name:
            assert peak < MEMORY
    print(f"whole / encoder alone: {rates['raw → H.264 veryfast'] / rates['encoder alone, H.264 veryfast']:.2f}")
    with av.open(str(folder / "whole.mp4")) as video:
        assert video.streams.video[0].frames == FRAMES
    assert len(list(folder.glob("sixteen_*.tif"))) == FRAMES // 4
