"""Interrupted sequences: missing or broken frames, and runs that resume an earlier run."""

import contextlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tifffile

from l3cli.artifacts.store import save
from l3cli.io.pictures.openimageio import write_mosaic
from tests.helpers.calls import L3, Refused
from tests.helpers.runs import Runs
from tests.helpers.sequences import COUNT, FAST, RGGB, RUN, frames, pictures, write_stack
from tests.helpers.tables import with_first

ANOTHER = "remove --resume"  # of a run whose inputs or options are others


@pytest.fixture
def runs(l3: L3, refused: Refused, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, table: Path, folder: Path) -> Runs:
    return Runs(l3, refused, monkeypatch, tmp_path)


def other_frame(path: Path) -> None:
    """Another mosaic under the same name, as many bytes."""
    size = path.stat().st_size
    write_mosaic(path, tifffile.imread(path)[::-1])
    assert path.stat().st_size == size


def test_a_missing_frame_stops_the_run_before_any_work(runs: Runs) -> None:
    (runs.frames / "frame_09.tif").unlink()
    pattern = runs.frames / "frame_%02d.tif"
    assert "9" in runs.refused(3, source=pattern)
    code, out, err = runs("--skip-bad", source=pattern)
    assert (code, out, err.count("\n")) == (1, "", 2)
    assert "9" in err
    assert "1 of 5 frames failed and were skipped" in err
    assert list(pictures(runs.out)) == [f"frame_{number:02d}.png" for number in (7, 8, 10, 11)]


def test_a_broken_frame_stops_the_run_and_is_named(runs: Runs) -> None:
    (runs.frames / "frame_09.tif").write_bytes(b"nothing")
    code, _, err = runs()
    assert (code, err.count("\n"), "frame_09.tif" in err) == (3, 1, True)
    code, _, err = runs("--skip-bad", "--resume")
    assert (code, err.count("\n")) == (1, 2)
    assert len(pictures(runs.out)) == 4
    assert runs("--frames", "9", "--skip-bad", out="only")[0] == 3
    assert not (runs.folder / "only").exists()


@pytest.mark.parametrize("exposure", ["auto", 0.8])
def test_resuming_gives_the_same_bytes(runs: Runs, l3: L3, exposure: float | str) -> None:
    frame, options = runs.frames / "frame_10.tif", ("--exposure", exposure)
    whole = frame.read_bytes()
    frame.write_bytes(b"")
    assert runs(*options)[0] == 3
    frame.write_bytes(whole)
    done = {path: path.stat().st_mtime_ns for path in runs.out.glob("*.png")}
    assert len(done) == 3
    assert "--force" in runs(*options)[2]
    assert ANOTHER in runs(*options, "--resume", "--bits", 16)[2]
    assert runs(*options, "--resume") == (0, "", "")
    assert all(path.stat().st_mtime_ns == then for path, then in done.items())
    runs.require_whole(*options)
    done = {path: path.stat().st_mtime_ns for path in runs.out.glob("*.png")}
    code, _, err = l3(*(word for word in runs.call(*options, "--resume") if word != "--quiet"))
    assert (code, "already finished" in err) == (0, True)
    assert all(path.stat().st_mtime_ns == then for path, then in done.items())
    assert ANOTHER in runs.refused(2, *options, "--resume", "--bits", 16)  # a finished run with other options is another


def test_resuming_a_finished_run_renders_what_came_since_and_replaces_nothing(runs: Runs) -> None:
    shutil.copytree(runs.frames, runs.folder / "all")
    (runs.frames / "frame_10.tif").unlink()
    assert runs("--force") == (0, "", "")
    shutil.copy(runs.folder / "all/frame_10.tif", runs.frames)
    assert runs("--resume") == (0, "", "")
    runs.require_whole()
    (runs.out / "frame_07.png").write_bytes(b"retouched")  # which the first run was allowed to replace, and this one is not
    assert "frame_07.png" in runs.refused(1, "--resume")
    for path in runs.out.glob(".*"):
        path.unlink()
    assert "frame_08.png" in runs.refused(1, "--resume", "--frames", "8-11")  # nothing says of which run it is


@pytest.mark.parametrize("output", ["out", "out/p_%02d.png"])
def test_resuming_never_keeps_another_runs_pictures(runs: Runs, output: str) -> None:
    save(with_first(RGGB, weights=RGGB.first.weights * np.float32(0.5)), runs.folder / "other.h5")
    assert runs(out=output)[0] == 0
    runs.stop(2, "--force", out=output, table="other.h5")
    assert len(list(runs.out.glob("*.png"))) == COUNT
    assert "--force" in runs("--resume", out=output, table="other.h5")[2]
    assert runs("--resume", "--force", out=output, table="other.h5") == (0, "", "")
    assert runs(out=output.replace("out", "whole"), table="other.h5")[0] == 0
    assert runs.made() == runs.made("whole")


def test_resuming_replaces_nothing_that_the_run_did_not_make(runs: Runs) -> None:
    runs.stop(2)
    (runs.out / "frame_11.png").write_bytes(b"somebody's")  # where one is still to be made
    assert "frame_11.png " in runs.refused(1, "--resume")
    (runs.out / "frame_11.png").unlink()
    (runs.out / "frame_07.png").write_bytes(b"retouched")
    assert "frame_07.png " in runs.refused(1, "--resume")
    assert runs("--resume", "--force") == (0, "", "")
    runs.require_whole()


@pytest.mark.parametrize("kind", ["folder", "pattern", "glob", "names", "stack"])
def test_resuming_renders_what_has_changed(runs: Runs, kind: str) -> None:
    source = {
        "folder": runs.frames,
        "pattern": runs.frames / "frame_%02d.tif",
        "glob": runs.frames / "*.tif",
        "names": sorted(runs.frames.iterdir()),
        "stack": write_stack(runs.folder / "long.npy"),
    }[kind]
    runs.stop(2, source=source)
    if kind == "stack":
        np.save(runs.folder / "long.npy", frames()[::-1])
    else:
        other_frame(runs.frames / "frame_08.tif")
    assert runs("--resume", source=source) == (0, "", "")
    runs.require_whole(source=source)


def test_resuming_notices_another_frame_of_the_same_size_and_time(runs: Runs) -> None:
    runs.stop(2)
    frame, before = runs.frames / "frame_08.tif", (runs.frames / "frame_08.tif").stat()
    shutil.copyfile(runs.frames / "frame_11.tif", frame)
    os.utime(frame, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert frame.stat().st_size == before.st_size
    assert runs("--resume") == (0, "", "")
    runs.require_whole()


def test_resuming_renders_frames_again_that_took_their_exposure_from_a_changed_one(runs: Runs) -> None:
    first, options = runs.frames / "frame_07.tif", ("--exposure", "auto", "--skip-bad")
    whole = first.read_bytes()
    first.write_bytes(b"")
    runs.stop(2, *options)
    first.write_bytes(whole)
    assert runs(*options, "--resume") == (0, "", "")
    runs.require_whole(*options)


def test_a_picture_whose_frame_is_gone_stays_and_is_named(runs: Runs, l3: L3) -> None:
    assert runs() == (0, "", "")
    picture = runs.out / "frame_08.png"
    content = picture.read_bytes()
    (runs.frames / "frame_08.tif").unlink()
    code, _, err = l3(*(word for word in runs.call("--resume") if word != "--quiet"))
    assert (code, str(picture) in err) == (0, True)
    assert picture.read_bytes() == content


def test_frames_of_another_folder_are_another_run(runs: Runs) -> None:
    shutil.copytree(runs.frames, runs.folder / "elsewhere/frames")
    with contextlib.chdir(runs.folder):
        runs.stop(2, source="frames")
    with contextlib.chdir(runs.folder / "elsewhere"):
        assert ANOTHER in runs.refused(2, "--resume", source="frames")
    assert runs("--resume") == (0, "", "")
    runs.require_whole()


def test_a_stream_is_resumed_by_the_content_of_its_frames(tmp_path: Path, table: Path) -> None:
    call = [sys.executable, "-c", RUN, "render", table, "-", "--size", "20x28", "-o", tmp_path / "out", "--exposure", 0.8]

    def fed(mosaics: np.ndarray, *more: str) -> tuple[int, str]:
        line = [str(part) for part in (*call, *FAST, *more)]
        ended = subprocess.run(line, input=mosaics.astype("<u2").tobytes(), capture_output=True, check=False)
        return ended.returncode, ended.stderr.decode()

    cut = np.append(frames(), frames()[0])[: 3 * 20 * 28 + 5]
    assert fed(cut)[0] == 3
    assert len(list((tmp_path / "out").glob("*.png"))) == 3
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").glob("*.png")}
    assert fed(frames(), "--resume") == (0, "")
    assert all(path.stat().st_mtime_ns == then for path, then in kept.items())
    forward = pictures(tmp_path / "out")
    assert len(forward) == COUNT
    assert fed(frames()[::-1], "--resume") == (0, "")
    backward = pictures(tmp_path / "out")
    assert all(np.array_equal(backward[one], forward[other]) for one, other in zip(forward, reversed(forward), strict=True))


def test_a_checkpoint_that_was_cut_off_costs_no_more_than_its_last_picture(runs: Runs) -> None:
    runs.stop(3)
    checkpoint = runs.out / ".l3-unfinished"
    checkpoint.write_bytes(checkpoint.read_bytes()[:-9])
    (runs.out / "frame_09.png").unlink()  # not yet renamed
    assert runs("--resume") == (0, "", "")
    runs.require_whole()


def test_what_is_there_is_refused_before_any_work(runs: Runs) -> None:
    write_mosaic(runs.out / "frame_09.png", frames()[0])
    assert "frame_09.png" in runs.refused(1)
    assert "frame_09.png" in runs.refused(1, "--size", "20x28", source="-")


@pytest.mark.parametrize(
    ("options", "after"), [((), 2), ((), COUNT + 2), (("--format", "mkv"), 0), (("--format", "mkv"), 1)]
)
def test_clips_that_were_stopped_are_continued(runs: Runs, options: tuple[str, ...], after: int) -> None:
    source = [runs.frames, write_stack(runs.folder / "stack.npy")]

    def contents(out: str) -> dict[Path, bytes]:
        folder = runs.folder / out
        return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("[!.]*.*")}

    assert runs(*options, source=source, out="whole")[0] == 0
    runs.stop(after, *options, source=source)
    assert len(contents("out")) == after
    assert runs(*options, "--resume", source=source)[0] == 0
    assert contents("out") == contents("whole")
    times = [path.stat().st_mtime_ns for path in sorted(runs.out.rglob("[!.]*.*"))]
    assert runs(*options, "--resume", source=source)[0] == 0  # everything is finished
    assert [path.stat().st_mtime_ns for path in sorted(runs.out.rglob("[!.]*.*"))] == times


def test_a_finished_still_is_left_as_it_is(runs: Runs, l3: L3) -> None:
    """Only with --resume does a still leave a hidden file that says what it was made from."""
    frame = runs.frames / "frame_07.tif"
    assert runs(source=frame, out="a.png") == (0, "", "")
    assert not list(runs.folder.glob(".*"))
    assert "a.png" in runs.refused(1, "--resume", source=frame, out="a.png")
    assert runs("--resume", source=frame, out="b.png") == (0, "", "")
    then = (runs.folder / "b.png").stat().st_mtime_ns
    code, _, err = l3(*(word for word in runs.call("--resume", source=frame, out="b.png") if word != "--quiet"))
    assert (code, "already finished" in err) == (0, True)
    assert (runs.folder / "b.png").stat().st_mtime_ns == then
    other_frame(frame)
    assert runs("--resume", source=frame, out="b.png") == (0, "", "")
    assert (runs.folder / "b.png").read_bytes() != (runs.folder / "a.png").read_bytes()
