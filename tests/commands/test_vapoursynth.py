"""The VapourSynth filter: the same pixels as `l3 render` in any order and from many threads, and one line per mistake."""

import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import l3cli
from l3cli.artifacts.store import save
from l3cli.io.images import read_image
from l3cli.rendering import renderer as renderers
from tests.helpers.calls import L3
from tests.helpers.readme import PAGES, fenced
from tests.helpers.sequences import COUNT, RGGB, frames, with_row_noise, write_raw_video
from tests.helpers.tables import with_low_noise

vs: Any = pytest.importorskip("vapoursynth", reason='has wheels for Python ≥ 3.12 alone: "make vapoursynth"')


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A table and a clip of its camera."""
    folder = tmp_path_factory.mktemp("hosts")
    save(RGGB, folder / "table.h5")
    write_raw_video(folder / "clip.mkv")
    write_raw_video(folder / "clip8.mkv", "gray")
    return folder


def mosaics(values: np.ndarray | None = None, form: Any = None) -> Any:
    """A clip of mosaics (frame, row, col)."""
    values = frames() if values is None else values
    blank = vs.core.std.BlankClip(
        width=values.shape[2], height=values.shape[1], length=len(values), format=form or vs.GRAY16, keep=True
    )

    def filled(n: int, f: Any) -> Any:
        made = f.copy()
        np.asarray(made[0])[...] = values[n]
        return made

    return blank.std.ModifyFrame([blank], filled)


def pixels(frame: Any) -> np.ndarray:
    """A frame (row, col, 3)."""
    return np.stack([np.asarray(frame[plane]) for plane in range(3)], axis=-1)


def rendered(l3: L3, folder: Path, out: Path, *options: object, clip: str = "clip.mkv") -> np.ndarray:
    """What the command makes of a clip, (frame, row, col, 3)."""
    code, _, err = l3("render", folder / "table.h5", folder / clip, "-o", out, "--quiet", *options)
    assert code == 0, err
    return np.stack([read_image(path)[0] for path in sorted(out.glob("*.png"))])


@pytest.mark.parametrize("bits", [8, 16])
def test_the_example_gives_the_pixels_of_the_command(
    l3: L3, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bits: int
) -> None:
    (script,) = (text for text in fenced(PAGES["video.md"], "python") if "vapoursynth" in text)
    assert len(script.splitlines()) <= 10
    script = script.replace('"clip.mkv"', '"clip.mkv", cachemode=0').replace("bits=16", f"bits={bits}, exposure=0.7")
    monkeypatch.chdir(folder)
    if not hasattr(vs.core, "bs"):
        pytest.skip("vapoursynth-bestsource, which reads the example's clip, is not installed")
    names: dict[str, Any] = {}
    exec(compile(script, "render.vpy", "exec"), names)
    expected = rendered(l3, folder, tmp_path / "out", "--exposure", 0.7, "--bits", bits)
    assert len(names["picture"]) == len(expected) == COUNT
    for number, picture in enumerate(expected):
        np.testing.assert_array_equal(pixels(names["picture"].get_frame(number)), picture)
    assert vs.get_output(0).clip.format.name == "YUV444P10"
    assert vs.get_output(0).clip.fps == 24
    vs.clear_outputs()


def test_the_exposure_of_the_first_frame_holds(l3: L3, folder: Path, tmp_path: Path) -> None:
    """The first frame is as the command shows the first of a sequence, the others by the same factor."""
    from l3cli.video_hosts.vapoursynth import render

    clip = render(mosaics(), folder / "table.h5")
    expected = rendered(l3, folder, tmp_path / "out")
    made = {number: pixels(clip.get_frame(number)) for number in reversed(range(COUNT))}
    np.testing.assert_array_equal(made[0], expected[0])
    assert (made[COUNT - 1] != expected[-1]).any()  # the command follows the light


def test_frames_in_any_order_from_many_threads(folder: Path) -> None:
    """Two clips of one core, four threads, every frame several times: always the same pixels, by one context a clip."""
    from l3cli.video_hosts.vapoursynth import render

    vs.core.num_threads, before = 4, vs.core.num_threads
    made: list[object] = []
    with pytest.MonkeyPatch.context() as patch:
        original = renderers.make_renderer

        def counted(*given: Any, **options: Any) -> Any:
            made.append(given)
            return original(*given, **options)

        patch.setattr(renderers, "make_renderer", counted)
        clips = [render(mosaics(), folder / "table.h5", exposure=0.7, bits=bits) for bits in (8, 16)]
        asked = [(clip, number) for clip in range(2) for number in [*range(COUNT)] * 4]
        random.Random(1).shuffle(asked)
        waiting = [(clip, number, clips[clip].get_frame_async(number)) for clip, number in asked]
        got = [(clip, number, pixels(future.result(timeout=600))) for clip, number, future in waiting]
    vs.core.num_threads = before
    assert len(made) == 2
    renderer = l3cli.Renderer(RGGB)
    expected = [[renderer.picture(frame, exposure=0.7, bits=bits) for frame in frames()] for bits in (8, 16)]
    assert all(np.array_equal(picture, expected[clip][number]) for clip, number, picture in got)


@pytest.mark.parametrize("threads", [1, 4])
def test_frames_filtered_in_time_are_those_of_the_command_in_any_order(
    l3: L3, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, threads: int
) -> None:
    """One after the other, as when a film is written, and jumping about, as when it is edited."""
    from l3cli.rendering.temporal import chunks
    from l3cli.video_hosts.vapoursynth import render

    monkeypatch.setattr(chunks, "CHUNK", 3)
    monkeypatch.setattr(chunks, "LEAD", 1)
    table, still = with_row_noise()
    np.save(tmp_path / "still.npy", still)
    save(with_low_noise(table), tmp_path / "table.h5")
    call = ("render", tmp_path / "table.h5", tmp_path / "still.npy", "-o", tmp_path / "out", "--temporal", "--exposure", 0.7)
    assert l3(*call)[0] == 0
    expected = [read_image(path)[0] for path in sorted((tmp_path / "out").glob("*.png"))]
    vs.core.num_threads, before = threads, vs.core.num_threads
    raw = mosaics(still)
    options: Any = {"exposure": 0.7, "temporal": True}
    in_order = [pixels(frame) for frame in render(raw, tmp_path / "table.h5", **options).frames()]
    asked = [*range(COUNT)] * 3
    random.Random(2).shuffle(asked)
    jumping = render(raw, tmp_path / "table.h5", **options)
    waiting = [(number, jumping.get_frame_async(number)) for number in asked]
    got = [(number, pixels(future.result(timeout=600))) for number, future in waiting]
    vs.core.num_threads = before
    np.testing.assert_array_equal(in_order, expected)
    assert all(np.array_equal(picture, expected[number]) for number, picture in got)
    alone = pixels(render(raw, tmp_path / "table.h5", exposure=0.7).get_frame(2))
    assert (alone != expected[2]).any()
    renderer = l3cli.Renderer(with_low_noise(table))
    corrected = l3cli.raw_frame(still[2], renderer.table)
    assert (corrected.values != still[2]).any()
    np.testing.assert_array_equal(alone, renderer.picture(corrected, exposure=0.7))


def test_floating_point_is_linear_and_states_it(folder: Path) -> None:
    from l3cli.video_hosts.vapoursynth import render

    frame = render(mosaics(), folder / "table.h5", bits=32, exposure=0.7).get_frame(1)
    np.testing.assert_array_equal(pixels(frame), l3cli.Renderer(RGGB).picture(frames()[1], exposure=0.7, bits=32))
    assert (frame.format.name, frame.props["_Transfer"]) == ("RGBS", vs.TRANSFER_LINEAR)
    frame = render(mosaics(), folder / "table.h5").get_frame(1)
    assert (frame.props["_Transfer"], frame.props["_Matrix"]) == (vs.TRANSFER_IEC_61966_2_1, vs.MATRIX_RGB)


def test_eight_bits_with_levels_and_a_phase(l3: L3, folder: Path, tmp_path: Path) -> None:
    from l3cli.video_hosts.vapoursynth import render

    raw = mosaics((frames() >> 4).astype(np.uint8), vs.GRAY8)
    clip = render(raw, folder / "table.h5", exposure=0.7, phase=(1, 0), black_level=4, white_level=255)
    options = ("--black-level", 4, "--white-level", 255, "--phase", "1,0", "--exposure", 0.7)
    expected = rendered(l3, folder, tmp_path / "out", *options, clip="clip8.mkv")
    assert all(np.array_equal(pixels(clip.get_frame(number)), picture) for number, picture in enumerate(expected))


def test_a_clip_has_the_size_that_it_has(folder: Path) -> None:
    from l3cli.video_hosts.vapoursynth import render

    half = frames()[:, :10, :16]
    expected = l3cli.Renderer(RGGB).picture(half[1], exposure=0.7)
    for options in ({}, {"size": (10, 16)}, {"size": "10x16", "phase": "0,0"}):
        made = render(mosaics(half), folder / "table.h5", exposure=0.7, **options).get_frame(1)
        np.testing.assert_array_equal(pixels(made), expected)


@pytest.mark.parametrize(
    ("clip", "options", "words"),
    [
        ({}, {"exposure": -1.0}, r"exposure -1 is not within 1e-09…1e\+09"),
        ({}, {"bits": 10}, "pictures cannot have 10 bits; use 8, 16 or 32"),
        ({}, {"white": "D5"}, "did you mean"),
        ({}, {"temporal": True}, "temporal requires the camera's noise"),
        ({}, {"size": (30, 28)}, "frames have 20×28 pixels .* instead of 30×28; .* set size 20x28"),
        ({}, {"size": "30x28"}, "frames have 20×28 pixels .* instead of 30×28; .* set size 20x28"),
        ({}, {"size": "30"}, 'size is "30"; write two whole numbers'),
        ({}, {"white_level": 3.0}, "set black_level and white_level"),
        ({}, {"table": "nothing.h5"}, "nothing.h5 does not exist"),
        ({}, {"table": "/"}, "/ is a folder"),
        ({"format": "RGB24"}, {}, "the clip has the format RGB24; use a mosaic in DN"),
        ({"format": "GRAYS"}, {}, "the clip has the format GrayS"),
        ({"varsize": True}, {}, "format or size varies"),
    ],
)
def test_mistakes_are_one_line(folder: Path, clip: dict[str, Any], options: dict[str, Any], words: str) -> None:
    from l3cli.video_hosts.vapoursynth import render

    form = {**clip, "format": getattr(vs, clip.get("format", "GRAY16"))}
    with pytest.raises(vs.Error, match=words) as raised:
        render(vs.core.std.BlankClip(width=28, height=20, **form), **{"table": folder / "table.h5", **options})
    assert str(raised.value).startswith("l3: ")
    assert "\n" not in str(raised.value)
