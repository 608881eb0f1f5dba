"""Sequences as inputs and numbered pictures as outputs: all types of input, order, numbers, and exposure over time."""

import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile

from l3cli.artifacts.store import save
from l3cli.frames.frame import RawFrame
from l3cli.io.file_names import numbered_files, numbered_name
from l3cli.io.images import read_image
from l3cli.io.raw.files import RawOverrides
from l3cli.io.sequences import find_frames
from l3cli.physics.display import exposure_scale
from l3cli.rendering.exposure import LightMeter, SteadyExposure
from l3cli.rendering.reference import ReferenceRenderer
from l3cli.rendering.white.scene_white import TIME_CONSTANT
from tests.helpers.calls import L3, Refused
from tests.helpers.cameras import BAYER, FIVE_BAND
from tests.helpers.sequences import COUNT, FAST, RGGB, RUN, frames, pictures, write_stack
from tests.helpers.tables import random_table, with_first


@pytest.fixture
def truth(l3: L3, tmp_path: Path, table: Path, folder: Path) -> list[np.ndarray]:
    """Each frame rendered alone, at one exposure."""
    rendered = []
    for path in sorted(folder.iterdir()):
        assert l3("render", table, path, "-o", tmp_path / "alone.png", "--exposure", 0.8, "--force", *FAST) == (0, "", "")
        rendered.append(read_image(tmp_path / "alone.png")[0])
    return rendered


# ------------------------------------------------------------------------------------------------------------ inputs


@pytest.mark.parametrize("stack", ["a.npy", "a.raw", "a.h5"])
def test_a_stack_gives_the_pictures_of_its_frames(
    l3: L3, tmp_path: Path, table: Path, truth: list[np.ndarray], stack: str
) -> None:
    source = write_stack(tmp_path / stack)
    assert l3("render", table, source, "-o", tmp_path / "out", "--exposure", 0.8, *FAST) == (0, "", "")
    rendered = pictures(tmp_path / "out")
    assert list(rendered) == [f"a_{number:06d}.png" for number in range(COUNT)]
    np.testing.assert_array_equal(list(rendered.values()), truth)


@pytest.mark.parametrize("name", ["", "frame_%02d.tif", "frame_##.tif", "frame_*.tif", "frame_[01]?.tif"])
def test_files_of_a_folder_keep_names_and_numbers(
    l3: L3, tmp_path: Path, table: Path, folder: Path, truth: list[np.ndarray], name: str
) -> None:
    assert l3("render", table, folder / name, "-o", tmp_path / "out", "--exposure", 0.8, *FAST) == (0, "", "")
    rendered = pictures(tmp_path / "out")
    assert list(rendered) == [f"frame_{number:02d}.png" for number in range(7, 12)]
    np.testing.assert_array_equal(list(rendered.values()), truth)
    assert l3("render", table, folder / name, "-o", tmp_path / "new/p_%04d.png", "--exposure", 0.8, *FAST)[0] == 0
    assert list(pictures(tmp_path / "new")) == [f"p_{number:04d}.png" for number in range(7, 12)]


def test_stdin_is_a_stream_of_frames(tmp_path: Path, table: Path, folder: Path, truth: list[np.ndarray]) -> None:
    render = ("render", table, "-", "-o", tmp_path / "out/####.png", "--size", "20x28", "--exposure", 0.8, *FAST)
    given = frames().astype("<u2").tobytes()
    command = [sys.executable, "-c", RUN, *(str(part) for part in render)]
    subprocess.run([*command, "--frames", "1-4x3"], input=given, check=True)
    rendered = pictures(tmp_path / "out")
    assert list(rendered) == ["0001.png", "0004.png"]
    np.testing.assert_array_equal(list(rendered.values()), [truth[1], truth[4]])
    cut = subprocess.run([*command, "--force"], input=given[:-1], capture_output=True)
    assert (cut.returncode, cut.stderr.count(b"\n")) == (3, 1)
    assert b"frame 4: stdin ends in the middle of a frame" in cut.stderr


def test_ranges_choose_by_number(l3: L3, tmp_path: Path, table: Path, folder: Path) -> None:
    for frames_, numbers in (("8-11x3", (8, 11)), ("9", (9,)), ("7-8", (7, 8))):
        output = tmp_path / frames_
        assert l3("render", table, folder, "-o", output / "%d.png", "--frames", frames_, *FAST)[0] == 0
        assert sorted(numbered_files(output / "%d.png")) == list(numbers)


def test_camera_raws_of_a_folder_are_a_sequence(l3: L3, l3_data: Path, tmp_path: Path, table: Path) -> None:
    (tmp_path / "clip").mkdir()
    for number in (1, 2):
        (tmp_path / f"clip/A001_{number:06d}.dng").symlink_to(l3_data / "raw/colorchart.dng")
    (tmp_path / "clip/A001.wav").write_bytes(b"sound")
    save(random_table(BAYER, bits=14, patch=3), tmp_path / "camera.h5")
    assert l3("render", tmp_path / "camera.h5", tmp_path / "clip", "-o", tmp_path / "out", "--format", "jpg")[0] == 0
    rendered = pictures(tmp_path / "out", "*.jpg")
    assert list(rendered) == ["A001_000001.jpg", "A001_000002.jpg"]
    assert rendered["A001_000001.jpg"].shape == (1156, 1734, 3)


def test_cinema_dng_states_its_rate(tmp_path: Path) -> None:
    rate_tag = [(51044, "2i", 1, (24000, 1001), True)]
    for name, tags in (("a_1.dng", rate_tag), ("a_2.dng", rate_tag), ("b_1.dng", []), ("b_2.dng", [])):
        tifffile.imwrite(tmp_path / name, frames()[0], extratags=tags)
    known = RawOverrides()
    assert find_frames((tmp_path / "a_*.dng",), RGGB, known).rate == Fraction(24000, 1001)
    assert find_frames((tmp_path / "a_%d.dng",), RGGB, known).rate == Fraction(24000, 1001)
    assert find_frames((tmp_path / "b_%d.dng",), RGGB, known).rate is None
    assert find_frames((tmp_path / "a_1.dng",), RGGB, known).rate is None  # a frame alone
    for number in (1, 2):
        (tmp_path / f"c_{number}.dng").write_bytes(b"no DNG")
    assert find_frames((tmp_path / "c_%d.dng",), RGGB, known).rate is None


def test_raw_frames_are_never_replaced(refused: Refused, tmp_path: Path, table: Path, folder: Path) -> None:
    before = {path: path.read_bytes() for path in folder.iterdir()}
    for output in (folder / "frame_%02d.tif", folder, folder / "frame_07.tif"):
        source = folder / "frame_07.tif" if output.suffix and output.exists() else folder
        line = refused(2, "render", table, source, "-o", output, "--format", "tif", "--force")
        assert "is an input" in line
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


def test_numbers_come_from_names_where_names_have_them(tmp_path: Path) -> None:
    known = RawOverrides()
    for name in ("b_9.npy", "b_10.npy"):
        np.save(tmp_path / name, frames()[0])
    sequence = find_frames((tmp_path,), RGGB, known)
    assert [(each.number, each.stem) for each in sequence.frames] == [(9, "b_9"), (10, "b_10")]
    np.save(tmp_path / "c.npy", frames()[0])
    assert [each.number for each in find_frames((tmp_path,), RGGB, known).frames] == [0, 1, 2]


def test_patterns_are_spelled_as_they_are_read(tmp_path: Path) -> None:
    for name in ("a_0001.tif", "a_10000.tif", "a_001.tif", "a_0002.tiff", "b_0001.tif", "a_00003.tif"):
        (tmp_path / name).touch()
    assert list(numbered_files(tmp_path / "a_%04d.tif")) == [1, 10000]
    assert list(numbered_files(tmp_path / "a_####.tif")) == [1, 10000]
    assert numbered_name(Path("x/a_%d.tif"), 7) == Path("x/a_7.tif")


def test_wrong_calls_are_refused_in_one_line(refused: Refused, tmp_path: Path, table: Path, folder: Path) -> None:
    (tmp_path / "empty").mkdir()
    np.save(tmp_path / "mixed.npy", frames())
    with h5py.File(tmp_path / "two.h5", "w") as root:
        root["a"], root["b"], root["floats"] = frames(), frames(), np.zeros(3)
    (tmp_path / "frames/odd.npy").write_bytes(b"")
    out = ("-o", tmp_path / "out")
    for code, word, arguments in (
        (2, "lower number first", (folder, *out, "--frames", "9-7")),
        (2, "FROM-TO", (folder, *out, "--frames", "9-")),
        (2, "within 1", (folder, *out, "--frames", "1-2x0")),
        (2, "not a number", (folder, *out, "--fps", "fast")),
        (2, "within 0.001…1000", (folder, *out, "--fps", 0)),
        (2, "--size", ("-", *out)),
        (2, "can store only one picture", (folder / "*.tif", "-o", tmp_path / "a.png")),
        (2, "a.gif", (folder / "*.tif", "-o", tmp_path / "a.gif")),
        (2, "--codec", (folder / "*.tif", *out, "--codec", "h264")),
        (2, "--dataset", (folder / "*.tif", *out, "--dataset", "x")),
        (3, "matches no file", (tmp_path / "x_%04d.tif", *out)),
        (3, "matches no file", (tmp_path / "x_*.tif", *out)),
        (3, "no raw frames", (tmp_path / "empty", *out)),
        (3, ".npy and .tif", (folder, *out)),
        (3, "2 datasets of frames (a, b)", (tmp_path / "two.h5", *out)),
        (3, '"floats" is float64', (tmp_path / "two.h5", *out, "--dataset", "floats")),
        (3, 'contains no dataset "c"', (tmp_path / "two.h5", *out, "--dataset", "c")),
        (3, "does not exist", (tmp_path / "none.h5", *out)),
        (3, "frame 12 is not in", (folder / "*.tif", *out, "--frames", "11-12")),
        (3, "frame 5 is not in", (tmp_path / "mixed.npy", *out, "--frames", "4-5")),
    ):
        assert word in refused(code, "render", table, *arguments)


# --------------------------------------------------------------------------------------------------------- exposure


@pytest.mark.parametrize("cfa", [BAYER, FIVE_BAND])
def test_the_meter_reads_what_the_table_would_show(cfa: list[list[int]]) -> None:
    table = random_table(cfa, bits=12, black_level=100.0)
    # Weights like those of a trained table: all sites answer alike.
    table = with_first(table, weights=np.abs(table.first.weights), intercept=np.zeros_like(table.first.intercept))
    rows, cols = np.mgrid[:120, :160]
    values = (100 + 3000 * (0.3 + 0.3 * np.sin(rows / 25) + 0.3 * np.cos(cols / 40))).clip(0).astype(np.uint16)
    frame = RawFrame("f", values, 100.0, 4095.0, phase=(1, 1))
    exact = ReferenceRenderer(table).exact_outputs(frame)[1]
    period = table.cfa.shape
    seen = exact[:: period[0], :: period[1]]  # the site that is measured
    assert LightMeter(table).brightness(frame) == pytest.approx(1 / exposure_scale(seen), rel=0.02)
    for shape in ((1, 1), (3, 50), (7, 2)):
        small = RawFrame("f", values[: shape[0], : shape[1]], 50.0, 4000.0)
        assert np.isfinite(LightMeter(table).brightness(small))


def scales(brightness: list[float], rate: int = 30) -> np.ndarray:
    exposure = SteadyExposure(Fraction(rate))
    return np.array([exposure.scale(value) for value in brightness])


def test_noise_does_not_flicker() -> None:
    exposures = scales([0.5 * (1.1 if number % 2 else 1 / 1.1) for number in range(200)])
    change = np.abs(np.diff(np.log(exposures)))
    assert change[1:].max() < 0.01  # ±10 % from frame to frame becomes less than 1 %
    assert np.ptp(np.log(exposures[100:])) < 0.01


def test_a_change_of_light_is_followed_without_overshoot() -> None:
    exposures = scales([0.2] * 30 + [0.8] * 150)
    np.testing.assert_allclose(exposures[:30], 5.0)
    assert (np.diff(exposures[29:]) < 0).all()
    assert exposures[-1] == pytest.approx(1 / 0.8, rel=0.02)
    after = np.log(exposures[30 + int(TIME_CONSTANT * 30) - 1] / 5.0) / np.log(0.2 / 0.8)
    assert after == pytest.approx(1 - np.exp(-1))
    # as many seconds at any rate
    assert scales([0.2] * 60 + [0.8] * 60, 60)[-1] == pytest.approx(scales([0.2] * 30 + [0.8] * 30, 30)[-1])


def test_dark_frames_leave_the_exposure_where_it_was() -> None:
    np.testing.assert_allclose(scales([0.0, -1.0, 0.5, 0.0]), [1, 1, 2, 2])


def test_files_named_one_by_one_have_separate_exposures_a_sequence_has_a_common_one(
    l3: L3, tmp_path: Path, table: Path, folder: Path
) -> None:
    call = ("render", table, "--backend", "reference")
    assert l3(*call, *sorted(folder.iterdir()), "-o", tmp_path / "stills")[0] == 0
    assert l3(*call, folder, "-o", tmp_path / "sequence")[0] == 0
    stills, sequence = (list(pictures(tmp_path / name).values()) for name in ("stills", "sequence"))
    for path, picture in zip(sorted(folder.iterdir()), stills, strict=True):
        assert l3(*call, path, "-o", tmp_path / "alone.png", "--force")[0] == 0
        np.testing.assert_array_equal(read_image(tmp_path / "alone.png")[0], picture)
    assert (sequence[-1] > stills[-1]).mean() > 0.3  # the light grows by more than the exposure follows in five frames
