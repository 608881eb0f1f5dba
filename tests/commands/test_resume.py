"""Sequences that break off: frames that are missing or broken, and runs that resume what another has left."""

import contextlib
import itertools
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile

from l3cli.artifacts.store import save
from l3cli.io.pictures.openimageio import write_mosaic
from tests.helpers.calls import L3, Refused
from tests.helpers.sequences import COUNT, FAST, RGGB, RUN, frames, pictures, write_stack
from tests.helpers.tables import with_first

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


def test_resuming_notices_another_frame_of_the_same_size_and_time(
    l3: L3, refused: Refused, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, table: Path, folder: Path
) -> None:
    call = ("render", table, folder, "--exposure", 0.8, *FAST, "-o", tmp_path / "out")
    stopped(l3, monkeypatch, 2, *call)
    frame, before = folder / "frame_08.tif", (folder / "frame_08.tif").stat()
    shutil.copyfile(folder / "frame_11.tif", frame)
    os.utime(frame, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert frame.stat().st_size == before.st_size
    assert "frame_08.png was made of another input" in refused(2, *call, "--resume")


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
