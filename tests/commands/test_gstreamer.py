"""The GStreamer element: the same pixels as `l3 render`, negotiated caps, and errors on the bus."""

import json
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.store import save
from l3cli.io.images import read_image
from tests.helpers.calls import L3
from tests.helpers.gstreamer import PYTHON, environment, require_gstreamer
from tests.helpers.readme import PAGES, fenced
from tests.helpers.sequences import COUNT, RGGB, frames, with_row_noise

# Every pipeline: the error that it ends with, or None.
RUN = """
import json, sys
from l3cli.video_hosts.gstreamer import Gst, register
register()
messages = []
for line in json.loads(sys.argv[1]):
    film = Gst.parse_launch(line)
    film.set_state(Gst.State.PLAYING)
    ended = film.get_bus().timed_pop_filtered(300 * Gst.SECOND, Gst.MessageType.EOS | Gst.MessageType.ERROR)
    failed = ended is None or ended.type == Gst.MessageType.ERROR
    messages.append([ended.src.get_name(), ended.parse_error().gerror.message] if failed else None)
    film.set_state(Gst.State.NULL)
print(json.dumps(messages))
"""
SOURCE = "filesrc location=clip.raw ! rawvideoparse format=gray16-le width=28 height=20 framerate=30/1"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A table and a clip of its camera, where there is a GStreamer that can use them."""
    require_gstreamer()
    folder = tmp_path_factory.mktemp("hosts")
    save(RGGB, folder / "table.h5")
    frames().astype("<u2").tofile(folder / "clip.raw")
    np.save(folder / "clip.npy", frames())
    return folder


def run(folder: Path, lines: Sequence[str]) -> list[list[str] | None]:
    """Run pipelines; the element and the message that each ends with, None: it has run to its end."""
    call = [PYTHON, "-c", RUN, json.dumps(lines)]
    done = subprocess.run(call, cwd=folder, env=environment(), capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    listed: list[list[str] | None] = json.loads(done.stdout)
    return listed


def rendered(l3: L3, clip: Path, out: Path, *options: object) -> np.ndarray:
    """What the command makes of a clip, (frame, row, col, 3)."""
    code, _, err = l3("render", clip.parent / "table.h5", clip, "-o", out, "--quiet", *options)
    assert code == 0, err
    return np.stack([read_image(path)[0] for path in sorted(out.glob("*.png"))])


def read(path: Path, dtype: str = "u1", channels: int = 3, cols: int = 28) -> np.ndarray:
    """Frames (frame, row, col, channel) of a file of frames whose rows are whole words of four bytes."""
    used = cols * channels * np.dtype(dtype).itemsize
    lines = np.fromfile(path, "u1").reshape(-1, 20, -(-used // 4) * 4)[..., :used]
    return np.ascontiguousarray(lines).view(dtype).reshape(-1, 20, cols, channels)


def test_the_example_of_gst_launch_gives_the_pixels_of_the_command(l3: L3, folder: Path, tmp_path: Path) -> None:
    """The plugin as the loader finds it; exposure follows the light, as in the command."""
    (line,) = (text for text in fenced(PAGES["video.md"], "sh") if "l3render" in text)
    env = {**environment(), "GST_REGISTRY": str(tmp_path / "registry.bin")}
    done = subprocess.run(["sh", "-c", line], cwd=folder, env=env, capture_output=True, text=True, timeout=600)
    if 'no element "l3render"' in done.stderr:
        pytest.skip("GStreamer's loader of Python plugins is missing (gstreamer1.0-python3-plugin-loader)")
    assert done.returncode == 0, done.stderr
    np.testing.assert_array_equal(read(folder / "film.rgb"), rendered(l3, folder / "clip.npy", tmp_path / "out"))


def test_the_example_in_python_gives_the_pixels_of_the_command(l3: L3, folder: Path, tmp_path: Path) -> None:
    (script,) = (text for text in fenced(PAGES["video.md"], "python") if "gstreamer" in text)
    assert len(script.splitlines()) <= 11
    subprocess.run([PYTHON, "-c", script], cwd=folder, env=environment(), check=True, timeout=600)
    film = read(folder / "film16.rgba", "<u2", 4)
    expected = rendered(l3, folder / "clip.npy", tmp_path / "out", "--bits", 16)
    np.testing.assert_array_equal(film[..., :3], expected)
    assert (film[..., 3] == 65535).all()


def test_other_mosaics(l3: L3, folder: Path, tmp_path: Path) -> None:
    """Bayer orders give the phase, rows may be padded, eight bits have levels of their own, a clip may be cropped."""
    bits8, cut = (frames() >> 4).astype(np.uint8), frames()[:, :, :27]
    padded = np.pad(cut, ((0, 0), (0, 0), (0, 1)))
    bits8.tofile(folder / "clip8.raw")
    padded.astype("<u2").tofile(folder / "cut.raw")
    np.save(folder / "clip8.npy", bits8)
    np.save(folder / "cut.npy", cut)
    bayer = "filesrc location={} blocksize={} ! video/x-bayer,format={},width={},height=20,framerate=30/1 ! "
    end = "l3render table=table.h5 exposure=0.7 {} ! filesink location={}"
    assert (
        run(
            folder,
            [
                bayer.format("clip.raw", 1120, "gbrg12le", 28) + end.format("", "phase.rgb"),
                bayer.format("clip8.raw", 560, "rggb", 28) + end.format("black-level=4 white-level=255", "levels.rgb"),
                bayer.format("cut.raw", 1120, "rggb16le", 27) + end.format("size=20x27 white=A", "cut.rgb"),
            ],
        )
        == [None] * 3
    )
    shown = ("--exposure", 0.7)
    expected = rendered(l3, folder / "clip.npy", tmp_path / "phase", *shown, "--phase", "1,0")
    np.testing.assert_array_equal(read(folder / "phase.rgb"), expected)
    expected = rendered(l3, folder / "clip8.npy", tmp_path / "8", *shown, "--black-level", 4, "--white-level", 255)
    np.testing.assert_array_equal(read(folder / "levels.rgb"), expected)
    expected = rendered(l3, folder / "cut.npy", tmp_path / "cut", *shown, "--white", "A")
    np.testing.assert_array_equal(read(folder / "cut.rgb", cols=27), expected)
    assert len(expected) == COUNT


def test_row_offsets_are_subtracted_and_frames_are_filtered_in_time(l3: L3, folder: Path, tmp_path: Path) -> None:
    table, still = with_row_noise()
    save(table, tmp_path / "table.h5")
    still.astype("<u2").tofile(tmp_path / "still.raw")
    np.save(tmp_path / "still.npy", still)
    source = SOURCE.replace("clip.raw", "still.raw").replace("width=28", "width=192")
    line = "{} ! l3render table=table.h5 {} ! video/x-raw,format=RGB ! filesink location={}"
    calls = [line.format(source, "temporal=true", "quiet.rgb"), line.format(source, "", "alone.rgb")]
    assert run(tmp_path, calls) == [None] * 2
    quiet = rendered(l3, tmp_path / "still.npy", tmp_path / "quiet", "--temporal")
    alone = rendered(l3, tmp_path / "still.npy", tmp_path / "alone")
    np.testing.assert_array_equal(read(tmp_path / "quiet.rgb", cols=192), quiet)
    np.testing.assert_array_equal(read(tmp_path / "alone.rgb", cols=192), alone)
    assert (alone != quiet).any()
    save(replace(table, camera=None), tmp_path / "table.h5")
    assert (rendered(l3, tmp_path / "still.npy", tmp_path / "uncorrected") != alone).any()


def test_mistakes_are_one_line_on_the_bus(folder: Path) -> None:
    other = SOURCE.replace("width=28", "width=14").replace("height=20", "height=40")
    colours = SOURCE.replace("gray16-le", "rgb")
    short = "filesrc location=clip.raw blocksize=1000 ! video/x-bayer,format=rggb12le,width=28,height=20"
    cases = [
        (f"{SOURCE} ! l3render", "the property table is empty; set it to a file from l3 train"),
        (f"{SOURCE} ! l3render table=nothing.h5", 'nothing.h5 does not exist; create it with "l3 train"'),
        (f"{SOURCE} ! l3render table=clip.raw", "clip.raw is not an HDF5 file"),
        (f"{SOURCE} ! l3render table=table.h5 size=720", 'size is "720"; write two whole numbers'),
        (f"{SOURCE} ! l3render table=table.h5 exposure=1e-12", "exposure 1e-12 is not within"),
        (f"{SOURCE} ! l3render table=table.h5 device=none", 'no OpenCL device is called "none"'),
        (f"{SOURCE} ! l3render table=table.h5 white=D5", 'illuminant "D5" is unknown'),
        (f"{SOURCE} ! l3render table=table.h5 white-level=3", "set black-level and white-level"),
        (f"{other} ! l3render table=table.h5", "frames have 40×14 pixels (rows × columns) instead of 20×28"),
        (f"{short} ! l3render table=table.h5", "the buffer of 1000 bytes is too small for a frame of 20×28 pixels"),
        (f"{colours} ! l3render table=table.h5", "Internal data stream error"),  # caps that are never agreed on
    ]
    for (line, words), listed in zip(cases, run(folder, [f"{line} ! fakesink" for line, _ in cases]), strict=True):
        assert listed is not None, words
        assert listed[0].startswith("rawvideoparse" if "format=rgb " in line else "l3render")
        assert words in listed[1]
        assert "\n" not in listed[1]
        assert "‹" not in listed[1]
