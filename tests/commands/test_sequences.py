"""Sequences in, numbered pictures out: every kind of input, order and numbers, broken frames, resuming, exposure in time."""

import contextlib
import itertools
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile

from l3cli.artifacts.store import save
from l3cli.frame import RawFrame
from l3cli.io.images import read_image, write_mosaic
from l3cli.io.numbered import numbered_files, numbered_name
from l3cli.io.raw.files import KnownBetter
from l3cli.io.sequences import find_frames
from l3cli.physics.display import exposure_scale
from l3cli.rendering.balance import TIME_CONSTANT
from l3cli.rendering.exposure import LightMeter, SteadyExposure
from l3cli.rendering.reference import ReferenceRenderer
from tests.helpers.calls import L3, Refused
from tests.helpers.cameras import BAYER, FIVE_BAND
from tests.helpers.sequences import COUNT, FAST, RGGB, RUN, frames, pictures
from tests.helpers.tables import random_table, with_first


@pytest.fixture
def table(tmp_path: Path) -> Path:
    save(RGGB, tmp_path / "table.h5")
    return tmp_path / "table.h5"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """frame_07.tif … frame_11.tif"""
    (tmp_path / "frames").mkdir()
    for number, mosaic in enumerate(frames(), 7):
        write_mosaic(tmp_path / f"frames/frame_{number:02d}.tif", mosaic)
    return tmp_path / "frames"


@pytest.fixture
def truth(l3: Callable, tmp_path: Path, table: Path, folder: Path) -> list[np.ndarray]:
    """Each frame rendered alone, at one exposure."""
    rendered = []
    for path in sorted(folder.iterdir()):
        assert l3("render", table, path, "-o", tmp_path / "alone.png", "--exposure", 0.8, "--force", *FAST) == (0, "", "")
        rendered.append(read_image(tmp_path / "alone.png")[0])
    return rendered


# ------------------------------------------------------------------------------------------------------------ inputs


def write_stack(path: Path) -> Path:
    if path.suffix == ".npy":
        np.save(path, frames())
    elif path.suffix == ".raw":
        frames().astype("<u2").tofile(path)
    else:
        with h5py.File(path, "w") as root:
            root.create_dataset("take/raw", data=frames(), chunks=(1, 20, 28), compression="gzip")
            root["take/other"] = frames()[0]
    return path


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
    assert b"frame 4: stdin ends within the frame" in cut.stderr


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
    known = KnownBetter()
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
    known = KnownBetter()
    for name in ("b_9.npy", "b_10.npy"):
        np.save(tmp_path / name, frames()[0])
    footage = find_frames((tmp_path,), RGGB, known)
    assert [(each.number, each.stem) for each in footage.frames] == [(9, "b_9"), (10, "b_10")]
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
        (2, "no number", (folder, *out, "--fps", "fast")),
        (2, "within 0.001…1000", (folder, *out, "--fps", 0)),
        (2, "--size", ("-", *out)),
        (2, "holds one picture", (folder / "*.tif", "-o", tmp_path / "a.png")),
        (2, "a.gif", (folder / "*.tif", "-o", tmp_path / "a.gif")),
        (2, "--codec", (folder / "*.tif", *out, "--codec", "h264")),
        (2, "--resume", (folder / "*.tif", "-o", tmp_path / "a.mp4", "--resume")),
        (2, "--dataset", (folder / "*.tif", *out, "--dataset", "x")),
        (3, "matches no file", (tmp_path / "x_%04d.tif", *out)),
        (3, "matches no file", (tmp_path / "x_*.tif", *out)),
        (3, "no raw frames", (tmp_path / "empty", *out)),
        (3, ".npy and .tif", (folder, *out)),
        (3, "2 datasets of frames (a, b)", (tmp_path / "two.h5", *out)),
        (3, "floats is float64", (tmp_path / "two.h5", *out, "--dataset", "floats")),
        (3, "c is no dataset", (tmp_path / "two.h5", *out, "--dataset", "c")),
        (3, "does not exist", (tmp_path / "none.h5", *out)),
        (3, "frame 12 is not in", (folder / "*.tif", *out, "--frames", "11-12")),
        (3, "frame 5 is not in", (tmp_path / "mixed.npy", *out, "--frames", "4-5")),
    ):
        assert word in refused(code, "render", table, *arguments)


# --------------------------------------------------------------------------------------------------- broken and resumed


def test_a_missing_frame_stops_the_run_before_any_work(
    l3: L3, refused: Refused, tmp_path: Path, table: Path, folder: Path
) -> None:
    (folder / "frame_09.tif").unlink()
    pattern = folder / "frame_%02d.tif"
    assert "frame 9 is not in" in refused(3, "render", table, pattern, "-o", tmp_path / "out", *FAST)
    code, out, err = l3("render", table, pattern, "-o", tmp_path / "out", "--skip-bad", *FAST)
    assert (code, out, err.count("\n")) == (1, "", 2)
    assert "frame 9 is not in" in err
    assert "1 of 5 frames left out" in err
    assert list(pictures(tmp_path / "out")) == [f"frame_{number:02d}.png" for number in (7, 8, 10, 11)]


def test_a_broken_frame_stops_the_run_and_is_named(l3: L3, tmp_path: Path, table: Path, folder: Path) -> None:
    (folder / "frame_09.tif").write_bytes(b"nothing")
    code, _, err = l3("render", table, folder, "-o", tmp_path / "out", *FAST)
    assert (code, err.count("\n")) == (3, 1)
    assert "frame_09.tif" in err
    code, _, err = l3("render", table, folder, "-o", tmp_path / "out", "--skip-bad", "--resume", *FAST)
    assert (code, err.count("\n")) == (1, 2)
    assert len(pictures(tmp_path / "out")) == 4
    code, _, err = l3("render", table, folder, "-o", tmp_path / "only", "--frames", "9", "--skip-bad", *FAST)
    assert code == 3
    assert not (tmp_path / "only").exists()


@pytest.mark.parametrize("exposure", ["auto", 0.8])
def test_resuming_gives_the_same_bytes(l3: L3, tmp_path: Path, table: Path, folder: Path, exposure: float | str) -> None:
    call = ("render", table, folder, "--exposure", exposure, *FAST)
    assert l3(*call, "-o", tmp_path / "whole")[0] == 0
    keep = (folder / "frame_10.tif").read_bytes()
    (folder / "frame_10.tif").write_bytes(b"")
    assert l3(*call, "-o", tmp_path / "out")[0] == 3
    (folder / "frame_10.tif").write_bytes(keep)
    done = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").glob("*.png")}
    assert len(done) == 3
    assert "--force" in l3(*call, "-o", tmp_path / "out")[2]
    assert "leave --resume out" in l3(*call, "-o", tmp_path / "out", "--resume", "--bits", 16)[2]
    assert l3(*call, "-o", tmp_path / "out", "--resume") == (0, "", "")
    assert all(path.stat().st_mtime_ns == then for path, then in done.items())
    ours, theirs = ({path.name: path.read_bytes() for path in (tmp_path / name).iterdir()} for name in ("out", "whole"))
    assert ours == theirs
    assert "--force" in l3(*call, "-o", tmp_path / "out", "--resume")[2]


def stopped(l3: Callable, monkeypatch: pytest.MonkeyPatch, after: int, *call: object) -> None:
    """Run a call that ends, as if killed, when a picture more than `after` is about to get its name."""
    from l3cli.stages.rendering import destination

    class Killed(BaseException):
        pass

    rename, named = os.replace, itertools.count(1)

    def renamed(source: Path, path: Path) -> None:
        if path.suffix == ".png" and next(named) > after:
            raise Killed
        rename(source, path)

    with monkeypatch.context() as patch:
        patch.setattr(destination, "PICTURE_WRITERS", 1)
        patch.setattr(os, "replace", renamed)
        with pytest.raises(Killed):
            l3(*call)


@pytest.fixture
def other(tmp_path: Path) -> Path:
    """A table whose pictures differ."""
    save(with_first(RGGB, weights=RGGB.first.weights * np.float32(0.5)), tmp_path / "other.h5")
    return tmp_path / "other.h5"


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


@pytest.mark.parametrize("output", ["out", "out/p_%02d.png"])
@pytest.mark.parametrize("again", [(), ("--force",)])
def test_resuming_never_keeps_another_runs_pictures(
    l3: L3,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    table: Path,
    other: Path,
    folder: Path,
    output: str,
    again: tuple[str, ...],
) -> None:
    options = (folder, "--exposure", 0.8, *FAST, "-o")
    assert l3("render", table, *options, tmp_path / output)[0] == 0
    assert l3("render", other, *options, tmp_path / output.replace("out", "whole"))[0] == 0
    stopped(l3, monkeypatch, 2, "render", other, *options, tmp_path / output, "--force")
    assert len([path for path in (tmp_path / "out").iterdir() if path.suffix == ".png"]) == COUNT
    assert l3("render", other, *options, tmp_path / output, "--resume", *again) == (0, "", "")
    assert contents(tmp_path / "out") == contents(tmp_path / "whole")


def test_resuming_replaces_nothing_that_the_run_did_not_make(
    l3: L3, refused: Refused, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, table: Path, folder: Path
) -> None:
    call = ("render", table, folder, "--exposure", 0.8, *FAST, "-o")
    assert l3(*call, tmp_path / "whole")[0] == 0
    stopped(l3, monkeypatch, 2, *call, tmp_path / "out")
    out = tmp_path / "out"
    (out / "frame_11.png").write_bytes(b"somebody's")  # where one is still to be made
    assert "frame_11.png exists; add --force" in refused(1, *call, out, "--resume")
    (out / "frame_11.png").unlink()
    (out / "frame_07.png").write_bytes(b"retouched")
    assert "frame_07.png exists; add --force" in refused(1, *call, out, "--resume")
    assert l3(*call, out, "--resume", "--force") == (0, "", "")
    assert contents(out) == contents(tmp_path / "whole")


def other_frame(path: Path) -> None:
    """Another mosaic under the same name, as many bytes."""
    mosaic = tifffile.imread(path)
    size = path.stat().st_size
    write_mosaic(path, mosaic[::-1])
    assert path.stat().st_size == size


@pytest.mark.parametrize("source", ["folder", "pattern", "glob", "names", "stack"])
def test_resuming_notices_inputs_that_changed(
    l3: L3, refused: Refused, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, table: Path, folder: Path, source: str
) -> None:
    inputs = {
        "folder": (folder,),
        "pattern": (folder / "frame_%02d.tif",),
        "glob": (folder / "*.tif",),
        "names": sorted(folder.iterdir()),
        "stack": (write_stack(tmp_path / "long.npy"),),
    }[source]
    call = ("render", table, *inputs, "--exposure", 0.8, *FAST, "-o", tmp_path / "out")
    stopped(l3, monkeypatch, 2, *call)
    if source == "stack":
        np.save(tmp_path / "long.npy", frames()[::-1])
    else:
        other_frame(folder / "frame_08.tif")
    made = contents(tmp_path / "out")
    assert "leave --resume out" in refused(2, *call, "--resume")
    assert contents(tmp_path / "out") == made
    assert l3(*call, "--force") == (0, "", "")


def test_resuming_takes_frames_that_were_mended_since_and_notices_those_that_are_gone(
    l3: L3, refused: Refused, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, table: Path, folder: Path
) -> None:
    call = ("render", table, folder, "--exposure", 0.8, *FAST, "-o")
    stopped(l3, monkeypatch, 2, *call, tmp_path / "out")
    other_frame(folder / "frame_09.tif")
    assert l3(*call, tmp_path / "whole") == (0, "", "")
    (folder / "frame_07.tif").rename(tmp_path / "frame_07.tif")
    assert "leave --resume out" in refused(2, *call, tmp_path / "out", "--resume")
    (tmp_path / "frame_07.tif").rename(folder / "frame_07.tif")
    assert l3(*call, tmp_path / "out", "--resume") == (0, "", "")
    assert contents(tmp_path / "out") == contents(tmp_path / "whole")


def test_resuming_notices_a_frame_that_others_took_their_exposure_from(
    l3: L3, refused: Refused, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, table: Path, folder: Path
) -> None:
    keep = (folder / "frame_07.tif").read_bytes()
    (folder / "frame_07.tif").write_bytes(b"")
    call = ("render", table, folder, "--exposure", "auto", "--skip-bad", *FAST, "-o", tmp_path / "out")
    stopped(l3, monkeypatch, 2, *call)
    (folder / "frame_07.tif").write_bytes(keep)
    assert "leave --resume out" in refused(2, *call, "--resume")


def test_resuming_goes_by_the_files_not_by_how_their_names_are_typed(
    l3: L3, refused: Refused, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, table: Path, folder: Path
) -> None:
    shutil.copytree(folder, tmp_path / "elsewhere/frames")
    for path in (tmp_path / "elsewhere/frames").iterdir():
        other_frame(path)
    options = ("--exposure", 0.8, *FAST, "-o", tmp_path / "out")
    with contextlib.chdir(tmp_path):
        stopped(l3, monkeypatch, 2, "render", table, "frames", *options)
    with contextlib.chdir(tmp_path / "elsewhere"):
        assert "leave --resume out" in refused(2, "render", table, "frames", *options, "--resume")
    assert l3("render", table, folder, *options, "--resume") == (0, "", "")


def test_a_stream_is_resumed_only_with_the_same_frames(tmp_path: Path, table: Path) -> None:
    call = [sys.executable, "-c", RUN, "render", table, "-", "--size", "20x28", "-o", tmp_path / "out", "--exposure", 0.8]

    def fed(mosaics: np.ndarray, *more: str) -> tuple[int, str]:
        line = [str(part) for part in (*call, *FAST, *more)]
        ended = subprocess.run(line, input=mosaics.astype("<u2").tobytes(), capture_output=True, check=False)
        return ended.returncode, ended.stderr.decode()

    cut = np.append(frames(), frames()[0])[: 3 * 20 * 28 + 5]
    assert fed(cut)[0] == 3
    assert len(list((tmp_path / "out").glob("*.png"))) == 3
    code, said = fed(frames()[::-1], "--resume")
    assert (code, said.count("\n")) == (2, 1)
    assert "leave --resume out" in said
    assert fed(frames()[:2], "--resume")[0] == 2
    assert fed(frames(), "--resume") == (0, "")
    assert len(list((tmp_path / "out").iterdir())) == COUNT


def test_a_mark_that_was_cut_off_costs_no_more_than_its_last_picture(
    l3: L3, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, table: Path, folder: Path
) -> None:
    call = ("render", table, folder, "--exposure", 0.8, *FAST, "-o")
    assert l3(*call, tmp_path / "whole")[0] == 0
    stopped(l3, monkeypatch, 3, *call, tmp_path / "out")
    mark = tmp_path / "out/.l3-render"
    mark.write_bytes(mark.read_bytes()[:-9])
    (tmp_path / "out/frame_09.png").unlink()  # not yet renamed
    assert l3(*call, tmp_path / "out", "--resume") == (0, "", "")
    assert contents(tmp_path / "out") == contents(tmp_path / "whole")


def test_what_is_there_is_refused_before_any_work(refused: Refused, tmp_path: Path, table: Path, folder: Path) -> None:
    write_mosaic(tmp_path / "out/frame_09.png", frames()[0])
    assert "frame_09.png exists" in refused(1, "render", table, folder, "-o", tmp_path / "out")
    assert "frame_09.png exists" in refused(1, "render", table, "-", "-o", tmp_path / "out", "--size", "20x28")


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
