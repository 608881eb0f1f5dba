"""Videos: raw videos as inputs, encoded videos and y4m as outputs, colour tags, and no partial outputs."""

import dataclasses
import functools
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from l3cli.artifacts.store import save
from l3cli.io.images import read_image
from l3cli.io.video import VideoChoice, new_video, new_y4m
from l3cli.stages.rendering import pictures as rendered_pictures
from tests.helpers.calls import L3, Refused
from tests.helpers.sequences import COUNT, FAST, RGGB, RUN, frames, pictures, write_raw_video
from tests.helpers.videos import decoded, frame_times

OUTPUTS = {  # arguments: encoder, pixel format, transfer (13: sRGB, 1: BT.709), matrix, range (1: limited)
    ("a.mp4",): ("h264", "yuv420p", 13, 1, 1),
    ("a.mkv", "--codec", "h264", "--crf", 10): ("h264", "yuv420p", 13, 1, 1),
    ("a.mov", "--codec", "h265"): ("hevc", "yuv420p", 13, 1, 1),
    ("b.mp4", "--codec", "h265", "--bits", 16): ("hevc", "yuv420p10le", 13, 1, 1),
    ("a.mov",): ("prores", "yuv422p10le", 1, 1, 1),
    ("a.mkv",): ("ffv1", "bgr0", 13, 0, 2),
    ("b.mkv", "--bits", 16): ("ffv1", "gbrp16le", 13, 0, 2),
}


@pytest.fixture
def stack(tmp_path: Path) -> Path:
    np.save(tmp_path / "stack.npy", frames())
    return tmp_path / "stack.npy"


# ------------------------------------------------------------------------------------------------------------- outputs


@pytest.mark.parametrize("arguments", list(OUTPUTS), ids=lambda arguments: " ".join(map(str, arguments)))
def test_videos_state_what_they_hold(
    l3: L3, tmp_path: Path, table: Path, stack: Path, arguments: tuple[int | str, ...]
) -> None:
    name, options = str(arguments[0]), arguments[1:]
    call = ("render", table, stack, *options, "--fps", "24000/1001", *FAST)
    assert l3(*call, "-o", tmp_path / name) == (0, "", "")
    with av.open(str(tmp_path / name)) as video:
        stream = video.streams.video[0]
        times = [float(frame.time) for frame in video.decode(video=0)]
        context = stream.codec_context  # after decoding, since frames may say otherwise than the container
        tags = (context.name, context.pix_fmt, int(context.color_trc), int(context.colorspace), int(context.color_range))
        assert tags == OUTPUTS[arguments]
        assert int(context.color_primaries) == 1
        assert stream.average_rate == Fraction(24000, 1001)
        assert (context.width, context.height) == (RGGB.cols, RGGB.rows)
    np.testing.assert_allclose(times, np.arange(COUNT) * 1001 / 24000, atol=1e-3)


def test_the_same_pictures_give_the_same_bytes(tmp_path: Path) -> None:
    codecs = [("a.mp4", "h264"), ("a.mkv", "h264"), ("b.mp4", "h265"), ("b.mkv", "ffv1"), ("a.mov", "prores")]
    # Not smaller: below three macroblocks x264's threads do not always agree with themselves.
    noise = np.random.default_rng(0).integers(0, 200, (48, 64, 3))
    for folder in ("one", "two"):
        for name, codec in codecs:
            with new_video(tmp_path / folder / name, VideoChoice(Fraction(25), 8, codec)) as video:
                for number in range(5):
                    video.write((noise * (0.8 + 0.1 * number)).astype(np.uint8))
        time.sleep(1.1 * (folder == "one"))  # whatever writes the clock into a file writes another second
    for name, codec in codecs:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes(), codec


@pytest.mark.parametrize("name", ["a.mp4", "a.mov"])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_h265_of_few_frames_has_decoding_times(tmp_path: Path, name: str, count: int) -> None:
    """x265 sets no decoding times of B-frames in videos of one or two frames: those have none. Frames as small as these it
    would write beyond, and end the process."""
    noise, made = np.random.default_rng(0).integers(0, 200, (30, 48, 3)), set()
    for again in range(4):  # what was not set differs from one time to the next
        path = tmp_path / f"{again}{name}"
        with new_video(path, VideoChoice(Fraction(25), 8, "h265")) as video:
            for number in range(count):
                video.write((noise * (0.8 + 0.1 * number)).astype(np.uint8))
        made.add(path.read_bytes())
    assert len(made) == 1
    with av.open(str(path)) as video:
        packets = [packet for packet in video.demux(video=0) if packet.size]
        decoding = [float(packet.dts * packet.time_base) for packet in packets]
        shown = [float(packet.pts * packet.time_base) for packet in packets]
    np.testing.assert_allclose(sorted(shown), np.arange(count) / 25)
    np.testing.assert_allclose(decoding, (np.arange(count) - (0 if count < 3 else 2)) / 25)
    np.testing.assert_allclose(frame_times(path), np.arange(count) / 25)


def test_h264_is_the_same_on_a_machine_of_more_cores(tmp_path: Path) -> None:
    with new_video(tmp_path / "a.mp4", VideoChoice(Fraction(25), 8)) as video:
        video.write(np.zeros((64, 64, 3), np.uint8))
    content = (tmp_path / "a.mp4").read_bytes()  # where x264 says how it worked
    assert b" threads=4 " in content
    assert b" sliced_threads=0 " in content


def test_luma_and_chroma_are_those_of_the_picture_itself(tmp_path: Path) -> None:
    """It is widened to four bytes a pixel before FFmpeg reads it."""
    picture = np.random.default_rng(0).integers(0, 256, (34, 46, 3), dtype=np.uint8)
    with new_y4m(tmp_path / "a.y4m", VideoChoice(Fraction(25), 8)) as video:
        video.write(picture)
    frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
    plain = frame.reformat(format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG")
    content = (tmp_path / "a.y4m").read_bytes()
    assert content.endswith(b"FRAME\n" + plain.to_ndarray().tobytes())


@pytest.mark.parametrize(("bits", "pixels"), [(8, "rgb24"), (16, "rgb48le")])
def test_ffv1_holds_the_very_pictures(l3: L3, tmp_path: Path, table: Path, stack: Path, bits: int, pixels: str) -> None:
    call = ("render", table, stack, "--bits", bits, *FAST)
    assert l3(*call, "-o", tmp_path / "a.mkv")[0] == 0
    assert l3(*call, "-o", tmp_path / "out")[0] == 0
    np.testing.assert_array_equal(decoded(tmp_path / "a.mkv", pixels), list(pictures(tmp_path / "out").values()))


def test_colours_survive_the_matrix_and_the_range(tmp_path: Path) -> None:
    colours = np.array([[255, 255, 255], [0, 0, 0], [230, 40, 30], [40, 180, 60], [30, 50, 200], [128, 128, 128]], np.uint8)
    picture = np.repeat(np.repeat(colours[None], 32, 0), 32, 1)
    for name, codec in (("a.mp4", "h264"), ("b.mp4", "h265"), ("a.mov", "prores")):
        with new_video(tmp_path / name, VideoChoice(Fraction(30), 8, codec, 1.0 if codec != "prores" else None)) as video:
            video.write(picture)
        with av.open(str(tmp_path / name)) as coded:
            frame = next(coded.decode(video=0))
            luma = frame.to_ndarray(format="yuv444p")[0][16, 16::32].astype(int)
            back = frame.reformat(format="rgb24", src_colorspace="ITU709").to_ndarray()[16, 16::32].astype(int)
        # BT.709 luma in limited range: 16 + 219 · (0.2126 R + 0.7152 G + 0.0722 B)
        np.testing.assert_allclose(luma, 16 + 219 / 255 * colours @ [0.2126, 0.7152, 0.0722], atol=2)
        assert np.abs(back - colours).max() <= 4


def test_odd_sizes_are_padded_by_a_row_or_column(l3: L3, tmp_path: Path, table: Path) -> None:
    odd = frames()[:, :19, :27]
    np.save(tmp_path / "odd.npy", odd)
    for name, size in (("a.mp4", (20, 28)), ("a.mov", (19, 28)), ("a.mkv", (19, 27)), ("a.y4m", (20, 28))):
        assert l3("render", table, tmp_path / "odd.npy", "-o", tmp_path / name, *FAST)[0] == 0
        assert decoded(tmp_path / name).shape == (COUNT, *size, 3)
    whole = decoded(tmp_path / "a.y4m", "yuv420p")
    np.testing.assert_array_equal(whole[:, 19, :28], whole[:, 18, :28])


def test_y4m_goes_to_a_file_and_to_stdout(tmp_path: Path, l3: L3, table: Path, stack: Path) -> None:
    call = ("render", table, stack, "--fps", 25, *FAST)
    assert l3(*call, "-o", tmp_path / "a.y4m") == (0, "", "")
    content = (tmp_path / "a.y4m").read_bytes()
    head, _, _ = content.partition(b"\n")
    assert head == b"YUV4MPEG2 W28 H20 F25:1 Ip A1:1 C420jpeg XCOLORRANGE=LIMITED"
    assert len(content) == len(head) + 1 + COUNT * (len(b"FRAME\n") + 28 * 20 * 3 // 2)
    assert (np.diff(decoded(tmp_path / "a.y4m").mean(axis=(1, 2, 3))) > 0).all()  # in order
    piped = subprocess.run([sys.executable, "-c", RUN, *map(str, call), "-o", "-"], capture_output=True, check=True)
    assert piped.stdout == content
    assert l3(*call, "--bits", 16, "-o", tmp_path / "b.y4m")[0] == 0
    with av.open(str(tmp_path / "b.y4m")) as video:
        assert video.streams.video[0].codec_context.pix_fmt == "yuv420p10le"


# -------------------------------------------------------------------------------------------------------------- inputs


@pytest.mark.parametrize("pixels", ["gray", "gray12le", "gray16le"])
def test_raw_videos_give_the_pictures_of_their_frames(l3: L3, tmp_path: Path, table: Path, stack: Path, pixels: str) -> None:
    source = write_raw_video(tmp_path / "clip.mkv", pixels)
    if pixels == "gray":
        np.save(stack, (frames() >> 4).astype(np.uint8))
    assert l3("render", table, source, "-o", tmp_path / "out", *FAST, "--fps", 30) == (0, "", "")
    assert l3("render", table, stack, "-o", tmp_path / "truth", *FAST)[0] == 0
    assert list(pictures(tmp_path / "out")) == [f"clip_{number:06d}.png" for number in range(COUNT)]
    ours, theirs = (list(pictures(tmp_path / name).values()) for name in ("out", "truth"))
    np.testing.assert_array_equal(ours, theirs)


def test_a_raw_video_keeps_its_rate_and_numbers(l3: L3, tmp_path: Path, table: Path) -> None:
    source = write_raw_video(tmp_path / "clip.mkv", rate=48)
    assert l3("render", table, source, "-o", tmp_path / "a.mkv", *FAST)[0] == 0
    with av.open(str(tmp_path / "a.mkv")) as video:
        assert video.streams.video[0].average_rate == 48
    assert l3("render", table, source, "-o", tmp_path / "n/%d.png", "--frames", "1-4x2", *FAST)[0] == 0
    assert list(pictures(tmp_path / "n")) == ["1.png", "3.png"]
    code, _, err = l3("render", table, source, "-o", tmp_path / "m/%d.png", "--frames", "4-6", *FAST)
    assert (code, err.count("\n")) == (3, 1)
    assert "frames 5-6 are not in" in err
    code, _, err = l3("render", table, source, "-o", tmp_path / "l/%d.png", "--frames", "4-6", "--skip-bad", *FAST)
    assert (code, err.count("\n")) == (1, 2)


@pytest.mark.parametrize(("group", "whole"), [(1, (0, 1, 3, 4)), (4, (0, 1, 4))])
def test_a_damaged_raw_video_names_the_frame(
    l3: L3, tmp_path: Path, table: Path, group: int, whole: tuple[int, ...]
) -> None:
    source = write_raw_video(tmp_path / "clip.mkv", group=group)  # a frame is lost as far as the next key frame
    with av.open(str(source)) as video:
        packets = [bytes(packet) for packet in video.demux(video=0) if packet.size]
    content = bytearray(source.read_bytes())
    content[content.index(packets[2]) + len(packets[2]) // 2] ^= 0xFF
    source.write_bytes(content)
    code, _, err = l3("render", table, source, "-o", tmp_path / "a.mp4", *FAST)
    assert (code, err.count("\n")) == (3, 1)
    assert "frame 2" in err
    assert not (tmp_path / "a.mp4").exists()
    code, _, err = l3("render", table, source, "-o", tmp_path / "out", "--skip-bad", *FAST)
    assert (code, err.count("\n")) == (1, COUNT - len(whole) + 1)
    assert list(pictures(tmp_path / "out")) == [f"clip_{number:06d}.png" for number in whole]


def test_other_videos_are_refused(refused: Refused, l3: L3, tmp_path: Path, table: Path, stack: Path) -> None:
    assert l3("render", table, stack, "-o", tmp_path / "rgb.mkv", *FAST)[0] == 0
    (tmp_path / "text.mkv").write_text("no video")
    (tmp_path / "none.mkv").touch()
    assert "rgb.mkv" in refused(3, "render", table, tmp_path / "rgb.mkv", "-o", tmp_path / "a.mp4")
    for name in ("text.mkv", "none.mkv", "missing.mkv"):
        assert name in refused(3, "render", table, tmp_path / name, "-o", tmp_path / "a.mp4")


# ------------------------------------------------------------------------------------------------ whole or not at all


def test_wrong_calls_are_refused_in_one_line(refused: Refused, tmp_path: Path, table: Path, stack: Path) -> None:
    (tmp_path / "there.mp4").write_bytes(b"mine")
    assert "there.mp4" in refused(1, "render", table, stack, "-o", tmp_path / "there.mp4")
    assert "--crf" in refused(2, "render", table, stack, "-o", tmp_path / "a.mkv", "--crf", 20)


def test_without_pyav_the_cure_is_named(
    refused: Refused, tmp_path: Path, table: Path, stack: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "clip.mkv").touch()
    monkeypatch.setitem(sys.modules, "av", None)
    monkeypatch.setenv("L3_TRUST", "1")  # the process that decodes has separate modules
    for source, output in ((stack, "a.mp4"), (stack, "a.y4m"), (tmp_path / "clip.mkv", "out")):
        assert 'pip install "l3cli[video]"' in refused(1, "render", table, source, "-o", tmp_path / output)


def test_frames_of_another_size_are_named(l3: L3, tmp_path: Path, table: Path) -> None:
    for number in range(3):
        np.save(tmp_path / f"f_{number}.npy", frames()[number][: 20 - 2 * (number == 1)])
    pattern = tmp_path / "f_%d.npy"
    code, _, err = l3("render", table, pattern, "-o", tmp_path / "a.mp4", *FAST)
    assert (code, err.count("\n")) == (3, 1)
    assert "f_1.npy" in err
    assert not (tmp_path / "a.mp4").exists()
    code, _, err = l3("render", table, pattern, "-o", tmp_path / "a.mp4", "--skip-bad", *FAST)
    assert (code, err.count("\n")) == (1, 2)
    assert len(decoded(tmp_path / "a.mp4")) == 2


def test_nothing_is_left_where_no_frame_could_be_read(refused: Refused, tmp_path: Path, table: Path) -> None:
    np.save(tmp_path / "f.npy", frames().astype(np.float32)[0] / 3)
    assert "f.npy" in refused(3, "render", table, tmp_path / "f.npy", "-o", tmp_path / "a.mp4", *FAST)
    nothing = subprocess.run(
        [sys.executable, "-c", RUN, "render", str(table), "-", "-o", str(tmp_path / "a.mp4"), "--size", "20x28", *FAST],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
    )
    assert (nothing.returncode, nothing.stderr.count("\n")) == (3, 1)
    assert not list(tmp_path.glob("*a.*mp4"))


@pytest.mark.parametrize("name", ["a.mp4", "a.mkv", "a.y4m"])
def test_an_interrupted_video_leaves_nothing(
    l3: L3, tmp_path: Path, table: Path, stack: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    rendered = rendered_pictures.upright
    calls: list[int] = []

    def interrupted(*arguments: Any) -> np.ndarray:
        calls.append(1)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return rendered(*arguments)

    monkeypatch.setattr(rendered_pictures, "upright", interrupted)
    before = sorted(tmp_path.iterdir())
    assert l3("render", table, stack, "-o", tmp_path / name, *FAST) == (130, "", "\nl3: interrupted\n")
    assert sorted(tmp_path.iterdir()) == before


def test_ctrl_c_stops_a_run_that_waits_for_its_input(tmp_path: Path, table: Path) -> None:
    call = (sys.executable, "-m", "l3cli", "render", table, "-", "-o", tmp_path / "a.mp4", "--size", "20x28", *FAST)
    before = sorted(tmp_path.iterdir())
    command = [str(part) for part in call]
    heard = functools.partial(signal.signal, signal.SIGINT, signal.default_int_handler)  # a background job ignores it
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, preexec_fn=heard) as waiting:
        assert waiting.stdin is not None
        assert waiting.stderr is not None
        deadline = time.monotonic() + 300
        while not any(".l3tmp" in path.name for path in tmp_path.iterdir()) and time.monotonic() < deadline:
            waiting.stdin.write(frames()[0].tobytes())  # until the encoder has begun its file
            waiting.stdin.flush()
            time.sleep(0.05)
        waiting.send_signal(signal.SIGINT)
        assert waiting.wait(300) == 130
        assert waiting.stderr.read().strip() == b"l3: interrupted"
    assert sorted(tmp_path.iterdir()) == before


def test_a_reader_that_goes_away_ends_the_run(tmp_path: Path, table: Path) -> None:
    np.save(tmp_path / "long.npy", np.tile(frames(), (400, 1, 1)))
    call = (sys.executable, "-c", RUN, "render", table, tmp_path / "long.npy", "-o", "-", *FAST)
    with subprocess.Popen([str(part) for part in call], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as writing:
        assert writing.stdout is not None
        assert writing.stderr is not None
        assert writing.stdout.read(9) == b"YUV4MPEG2"
        writing.stdout.close()
        assert writing.wait(300) == 1
        assert writing.stderr.read() == b""


def test_the_opencl_device_feeds_the_encoder(l3: L3, tmp_path: Path, table: Path, stack: Path) -> None:
    assert l3("render", table, stack, "-o", tmp_path / "a.mkv", "--exposure", 0.8, "--quiet") == (0, "", "")
    assert l3("render", table, stack, "-o", tmp_path / "out", "--exposure", 0.8, "--quiet") == (0, "", "")
    np.testing.assert_array_equal(decoded(tmp_path / "a.mkv"), list(pictures(tmp_path / "out").values()))
    single = dataclasses.replace(RGGB, camera_name="one")
    save(single, tmp_path / "one.h5")
    np.save(tmp_path / "one.npy", frames()[2])
    assert l3("render", tmp_path / "one.h5", tmp_path / "one.npy", "-o", tmp_path / "one.png", "--exposure", 0.8)[0] == 0
    np.testing.assert_array_equal(read_image(tmp_path / "one.png")[0], decoded(tmp_path / "a.mkv")[2])


# --------------------------------------------------------------------------------------------------------------- times

UNEVEN = (0, 40, 80, 480, 500)  # ms


@pytest.fixture
def rendered(l3: L3, tmp_path: Path, table: Path) -> Callable[..., tuple[str, list[str]]]:
    """Render a clip to an output in tmp_path; what the document says of its times, and its warnings."""

    def call(clip: Path, output: str, *options: object, code: int = 0) -> tuple[str, list[str]]:
        got, out, err = l3("render", table, clip, "-o", tmp_path / output, *options, "--json", *FAST)
        assert got == code, err
        about = json.loads(out)["clips"][0]
        return about["frame_times"], about["warnings"]

    return call


@pytest.mark.parametrize("output", ["a.mp4", "a.mov", "a.mkv"])
def test_the_times_of_a_variable_rate_are_kept(rendered: Callable, tmp_path: Path, output: str) -> None:
    clip = write_raw_video(tmp_path / "v.mkv", times=UNEVEN)
    assert rendered(clip, output) == ("kept", [])
    np.testing.assert_allclose(frame_times(tmp_path / output), np.array(UNEVEN) / 1000, atol=1e-3)


def test_times_that_an_output_cannot_hold_are_reported(rendered: Callable, tmp_path: Path) -> None:
    clip = write_raw_video(tmp_path / "v.mkv", times=UNEVEN)
    for output, why in (
        ("a.y4m", "y4m has a constant rate of 24 frames per second"),
        ("pictures", "pictures have no times"),
        ("a.tif", "no times"),
    ):
        state, (warning,) = rendered(clip, output)
        assert state == "lost"
        assert "the time between frames varies (0.02–0.4 s), but" in warning
        assert why in warning
    assert rendered(clip, "b.mp4", "--fps", 25) == ("even", [])
    np.testing.assert_allclose(frame_times(tmp_path / "b.mp4"), np.arange(COUNT) / 25, atol=1e-4)


def test_every_second_frame_of_a_variable_rate_is_shown_in_half_the_time(rendered: Callable, tmp_path: Path) -> None:
    clip = write_raw_video(tmp_path / "v.mkv", times=UNEVEN)
    assert rendered(clip, "a.mp4", "--frames", "0-4x2")[0] == "kept"
    np.testing.assert_allclose(frame_times(tmp_path / "a.mp4"), [0, 0.04, 0.25], atol=1e-3)


def test_a_rate_that_a_container_rounds_is_constant(rendered: Callable, tmp_path: Path) -> None:
    clip = write_raw_video(tmp_path / "v.mkv", rate=30, times=(0, 33, 67, 100, 133))
    assert rendered(clip, "a.mp4") == ("even", [])
    np.testing.assert_allclose(frame_times(tmp_path / "a.mp4"), np.arange(COUNT) / 30, atol=1e-4)


def test_gaps_in_the_numbers_of_a_folder_are_gaps_of_its_video(rendered: Callable, tmp_path: Path) -> None:
    clip = tmp_path / "clip"
    clip.mkdir()
    for number, mosaic in zip((1, 2, 3, 7, 8), frames(), strict=True):
        np.save(clip / f"f_{number}.npy", mosaic)
    gap = f"{clip}: frames are missing between 3 and 7"
    assert rendered(clip, "a.mp4") == ("kept", [f"{gap}; the video shows the frame before a gap until the next frame"])
    np.testing.assert_allclose(frame_times(tmp_path / "a.mp4"), np.array([0, 1, 2, 6, 7]) / 30, atol=1e-4)
    state, (warning,) = rendered(clip, "a.y4m")
    assert (state, gap in warning) == ("lost", True)
    assert rendered(clip, "pictures") == (None, [])
    for number in (1, 2, 3, 7, 8):
        (clip / f"f_{number}.npy").rename(clip / f"g_{number**3 + 10**17}.npy")
    state, (warning,) = rendered(clip, "b.mp4")
    assert (state, "not consecutive frame numbers" in warning) == ("lost", True)


def test_a_frame_left_out_leaves_its_time(rendered: Callable, tmp_path: Path) -> None:
    (tmp_path / "clip").mkdir()
    for number, mosaic in enumerate(frames()):
        np.save(tmp_path / f"clip/f_{number}.npy", mosaic)
    (tmp_path / "clip/f_2.npy").write_bytes(b"broken")
    assert rendered(tmp_path / "clip", "a.mp4", "--skip-bad", code=1)[0] == "kept"
    np.testing.assert_allclose(frame_times(tmp_path / "a.mp4"), np.array([0, 1, 3, 4]) / 30, atol=1e-4)
