"""`l3 render --temporal`: sequences, videos, stills, resumed runs, and frames that cannot be blended."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.store import save
from l3cli.frames.frame import RawFrame
from l3cli.io.images import read_image
from l3cli.io.pictures.openimageio import write_mosaic
from l3cli.rendering.conditions import with_edges_for
from l3cli.rendering.reference import ReferenceRenderer
from l3cli.rendering.temporal import chunks
from l3cli.rendering.temporal.reference import ReferenceFilter
from tests.helpers.calls import L3, Refused
from tests.helpers.sequences import FAST, filtered_places, pictures
from tests.helpers.still_scene import BLACK, CAMERA, COLS, COUNT, ROWS, TABLE, mosaics
from tests.helpers.tables import with_low_noise

LINEAR = (*FAST, "--bits", 32, "--format", "tif")


def test_a_picture_is_that_of_its_filtered_mosaic(l3: L3, tmp_path: Path, still_table: Path, still_frames: Path) -> None:
    """The noise of a still scene falls; the first frame is as without; classes go by the noise that is left."""
    assert l3("render", still_table, still_frames, "-o", tmp_path / "out", "--temporal", *LINEAR) == (0, "", "")
    assert l3("render", still_table, still_frames, "-o", tmp_path / "plain", *LINEAR) == (0, "", "")
    ours, plain = pictures(tmp_path / "out", "*.tif"), pictures(tmp_path / "plain", "*.tif")
    assert np.array_equal(ours["frame_0.tif"], plain["frame_0.tif"])
    spread = [np.stack([*each.values()][-4:]).std(axis=0).mean() for each in (ours, plain)]
    assert spread[0] < spread[1] / 2
    filtered, shares = ReferenceFilter((2, 2), CAMERA), []
    for name, mosaic in zip(ours, mosaics(), strict=True):
        made = filtered.filtered(RawFrame("frame", mosaic, BLACK, 4095.0))
        shares.append(made.noise_share)
        outputs = ReferenceRenderer(with_edges_for(TABLE, made.noise_share)).outputs(made)
        assert np.array_equal(ours[name], np.moveaxis(outputs, 0, -1))
    assert (shares[0], shares[-1]) == (1.0, 0.5)


def test_pixels_of_little_noise_are_rendered_by_their_transforms(l3: L3, tmp_path: Path, still_frames: Path) -> None:
    two = with_low_noise(TABLE)
    save(two, tmp_path / "two.h5")
    assert l3("render", tmp_path / "two.h5", still_frames, "-o", tmp_path / "out", "--temporal", *LINEAR) == (0, "", "")
    filtered, quiet = ReferenceFilter((2, 2), CAMERA), []
    for name, mosaic in zip(sorted(each.name for each in still_frames.iterdir()), mosaics(), strict=True):
        made = filtered.filtered(RawFrame("frame", mosaic, BLACK, 4095.0))
        assert made.noise_left is not None
        quiet.append(made.noise_left.below([0.125**0.75], made.values.shape).mean())
        outputs = ReferenceRenderer(two, by_noise=True).outputs(made)
        assert np.array_equal(read_image(tmp_path / "out" / name)[0], np.moveaxis(outputs, 0, -1))
    assert (quiet[0], quiet[-1] > 0.8) == (0.0, True)


def test_stacks_and_files_named_one_by_one_are_sequences_too(
    l3: L3, tmp_path: Path, still_table: Path, still_frames: Path
) -> None:
    np.save(tmp_path / "stack.npy", mosaics())
    assert l3("render", still_table, still_frames, "-o", tmp_path / "out", "--temporal", *LINEAR)[0] == 0
    assert l3("render", still_table, tmp_path / "stack.npy", "-o", tmp_path / "a_%d.tif", "--temporal", *LINEAR)[0] == 0
    assert l3("render", still_table, *sorted(still_frames.iterdir()), "-o", tmp_path / "one", "--temporal", *LINEAR)[0] == 0
    for number in range(COUNT):
        truth = read_image(tmp_path / f"out/frame_{number}.tif")[0]
        assert np.array_equal(read_image(tmp_path / f"a_{number}.tif")[0], truth)
        assert np.array_equal(read_image(tmp_path / f"one/frame_{number}.tif")[0], truth)


@pytest.mark.parametrize("broken", [3, 5])
def test_resuming_reads_what_it_needs_and_gives_the_same_bytes(
    l3: L3, tmp_path: Path, still_table: Path, still_frames: Path, monkeypatch: pytest.MonkeyPatch, broken: int
) -> None:
    monkeypatch.setattr(chunks, "CHUNK", 4)
    monkeypatch.setattr(chunks, "LEAD", 1)
    call = ("render", still_table, still_frames, "--temporal", "--exposure", 0.8, *FAST)
    assert l3(*call, "-o", tmp_path / "whole")[0] == 0
    frame = still_frames / f"frame_{broken}.tif"
    content = frame.read_bytes()
    frame.write_bytes(b"")
    assert l3(*call, "-o", tmp_path / "out")[0] == 3
    assert len(pictures(tmp_path / "out")) == broken
    frame.write_bytes(content)
    assert "remove --resume" in l3(*(word for word in call if word != "--temporal"), "-o", tmp_path / "out", "--resume")[2]
    taken = filtered_places(monkeypatch)
    assert l3(*call, "-o", tmp_path / "out", "--resume") == (0, "", "")
    assert taken == [*range(max(0, broken // 4 * 4 - 1), COUNT)]  # its chunk, and what leads in
    ours, theirs = ({path.name: path.read_bytes() for path in (tmp_path / name).glob("[!.]*")} for name in ("out", "whole"))
    assert ours == theirs


def test_one_frame_is_rendered_as_it_is_with_a_word(l3: L3, tmp_path: Path, still_table: Path, still_frames: Path) -> None:
    still = still_frames / "frame_3.tif"
    code, _, err = l3("render", still_table, still, "-o", tmp_path / "a.png", "--temporal", "--backend", "reference")
    assert code == 0
    assert "--temporal has no effect on a single frame" in err
    assert l3("render", still_table, still, "-o", tmp_path / "b.png", *FAST)[0] == 0
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_frames_of_another_size_start_anew(l3: L3, tmp_path: Path, still_table: Path, still_frames: Path) -> None:
    for number in (4, 5, 6):
        write_mosaic(still_frames / f"frame_{number}.tif", mosaics(ROWS - 7)[number])
    assert l3("render", still_table, still_frames, "-o", tmp_path / "out", "--temporal", *LINEAR)[0] == 0
    assert l3("render", still_table, still_frames, "-o", tmp_path / "plain", *LINEAR)[0] == 0
    ours, plain = pictures(tmp_path / "out", "*.tif"), pictures(tmp_path / "plain", "*.tif")
    same = [np.array_equal(ours[name], plain[name]) for name in sorted(ours)]
    assert same == [number in (0, 4, 7) for number in range(COUNT)]


def test_a_gap_is_no_frame(l3: L3, tmp_path: Path, still_table: Path, still_frames: Path) -> None:
    (still_frames / "frame_4.tif").unlink()
    call = ("render", still_table, still_frames / "frame_%d.tif", "--temporal", *LINEAR)
    code, _, err = l3(*call, "-o", tmp_path / "out")
    assert (code, "frame 4 is not in" in err) == (3, True)
    assert l3(*call, "-o", tmp_path / "out", "--skip-bad")[0] == 1
    assert len(pictures(tmp_path / "out", "*.tif")) == COUNT - 1


def test_dark_current_and_dark_frames_stay_what_they_are(l3: L3, tmp_path: Path, still_frames: Path) -> None:
    camera = dataclasses.replace(CAMERA, noise=dataclasses.replace(CAMERA.noise, dark_current=400.0))
    save(dataclasses.replace(TABLE, camera=camera), tmp_path / "warm.h5")
    write_mosaic(tmp_path / "dark.tif", np.full((ROWS, COLS), round(BLACK) + 20, np.uint16))
    for number, options in enumerate((("--exposure-time", 0.5), ("--dark", tmp_path / "dark.tif"))):
        call = ("render", tmp_path / "warm.h5", still_frames, *LINEAR, *options)
        assert l3(*call, "-o", tmp_path / f"out{number}", "--temporal")[0] == 0
        assert l3(*call, "-o", tmp_path / f"plain{number}")[0] == 0
        ours, plain = (pictures(tmp_path / f"{name}{number}", "*.tif") for name in ("out", "plain"))
        assert np.array_equal(ours["frame_0.tif"], plain["frame_0.tif"])
        assert np.stack([*ours.values()]).mean() == pytest.approx(np.stack([*plain.values()]).mean(), rel=0.02)


def test_a_table_without_its_camera_is_one_line(refused: Refused, tmp_path: Path, still_frames: Path) -> None:
    save(dataclasses.replace(TABLE, camera=None), tmp_path / "old.h5")
    call = ("render", tmp_path / "old.h5", still_frames, "-o", tmp_path / "out", "--temporal", *FAST)
    assert "--temporal requires the camera's noise" in refused(2, *call)
    assert not (tmp_path / "out").exists()
