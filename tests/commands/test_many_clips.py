"""Many clips in one call, and repeated calls: each clip is rendered once, and an error affects only its own clip."""

import contextlib
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from l3cli.cli import run
from l3cli.errors import DeviceError, InputFileError, RecipeError
from l3cli.io.file_names import name_of
from l3cli.io.pictures.openimageio import write_mosaic
from l3cli.options.render import RenderOptions
from l3cli.rendering.renderer import make_renderer
from l3cli.stages.rendering import clips
from l3cli.stages.rendering.clips import Summary, render_clips
from tests.helpers.calls import L3, Refused
from tests.helpers.sequences import COUNT, FAST, RUN, frames, pictures, write_raw_video, write_stack


@pytest.fixture
def shots(tmp_path: Path) -> Path:
    """A folder with a clip of each kind, of the same frames: fold/, pat_00.tif …, stack.npy, still.npy, v.mkv."""
    folder = tmp_path / "shots"
    (folder / "fold").mkdir(parents=True)
    for number, mosaic in enumerate(frames()):
        write_mosaic(folder / f"fold/f_{number:02d}.tif", mosaic)
        shutil.copy(folder / f"fold/f_{number:02d}.tif", folder / f"pat_{number:02d}.tif")
    np.save(folder / "stack.npy", frames())
    np.save(folder / "still.npy", frames(1)[0])
    write_raw_video(folder / "v.mkv")
    return folder


NAMES = ("fold", "pat_%02d.tif", "stack.npy", "still.npy", "v.mkv")
PLACES = ("fold", "pat", "stack", "still.png", "v")


def names(folder: Path) -> list[str]:
    """Return what a user sees in a folder."""
    return sorted(path.name for path in folder.iterdir() if path.name[0] != ".")


def document(out: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(out)
    return found


# -------------------------------------------------------------------------------------------------------- many clips


def test_each_clip_is_rendered_as_if_alone(l3: L3, tmp_path: Path, table: Path, shots: Path) -> None:
    call = ("render", table, *(shots / name for name in NAMES), "-o", tmp_path / "out", *FAST)
    code, out, err = l3(*call)
    assert (code, err) == (0, "")
    assert names(tmp_path / "out") == sorted(PLACES)
    lines = out.splitlines()
    assert lines[-1] == f"clips: 5 rendered, 0 kept, 0 failed; frames: {4 * COUNT + 1}, 0 skipped"
    assert [line.split()[0] for line in lines[1:-1]] == [str(shots / name) for name in NAMES]
    for name, place in zip(NAMES, PLACES, strict=True):
        alone, many = tmp_path / "alone" / place, tmp_path / "out" / place
        assert l3("render", table, shots / name, "-o", alone, *FAST)[0] == 0
        if many.is_file():
            assert many.read_bytes() == alone.read_bytes()
            continue
        ours, theirs = pictures(many), pictures(alone)
        assert list(ours) == list(theirs)
        assert len(ours) == COUNT
        assert all(np.array_equal(ours[each], theirs[each]) for each in ours)


@pytest.mark.parametrize("suffix", [".npy", ".fits", ".tif"])
def test_several_stacks_are_clips(l3: L3, tmp_path: Path, table: Path, suffix: str) -> None:
    """Names do not tell a stack from a single frame; contents do."""
    stacks = [tmp_path / f"{name}{suffix}" for name in ("a", "b")]
    for path in stacks:
        write_stack(path)
    call = ("render", table, *stacks, "-o", tmp_path / "out", *FAST, "--json")
    code, out, err = l3(*call)
    assert (code, err) == (0, "")
    assert [(clip["state"], clip["frames"]) for clip in document(out)["clips"]] == [("rendered", COUNT)] * 2
    assert l3("render", table, stacks[1], "-o", tmp_path / "alone", *FAST)[0] == 0
    ours, alone = pictures(tmp_path / "out/b"), pictures(tmp_path / "alone")
    assert list(ours) == list(alone) == [f"b_{number:06d}.png" for number in range(COUNT)]
    assert all(np.array_equal(ours[name], alone[name]) for name in ours)


@pytest.mark.parametrize("suffix", [".npy", ".fits", ".raw", ".h5"])
def test_an_empty_stack_is_a_bad_file(refused: Refused, tmp_path: Path, table: Path, suffix: str) -> None:
    empty = write_stack(tmp_path / f"empty{suffix}", frames(0))
    chosen = ("--dataset", "take/raw") if suffix == ".h5" else ()
    assert "empty" in refused(3, "render", table, empty, "-o", tmp_path / "out", *FAST, *chosen)


def test_a_clip_that_fails_stops_no_other_and_is_all_that_is_done_again(
    l3: L3, tmp_path: Path, table: Path, shots: Path
) -> None:
    whole = (shots / "v.mkv").read_bytes()
    (shots / "cut.mkv").write_bytes(whole[:700])
    given = [shots / name for name in ("cut.mkv", "gone.mkv", "stack.npy", "still.npy")]
    call = ("render", table, *given, "-o", tmp_path / "out", *FAST, "--json")
    code, out, err = l3(*call)
    found = document(out)
    assert code == found["run"]["exit_code"] == 1
    assert [clip["state"] for clip in found["clips"]] == ["failed", "failed", "rendered", "rendered"]
    assert err.count("\n") == 2
    assert (found["clips_failed"], found["frames"], found["left_out"]) == (2, COUNT + 1, 0)
    assert "does not exist" in found["clips"][1]["error"]
    first = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*.png")}
    shutil.copy(shots / "v.mkv", shots / "cut.mkv")
    shutil.copy(shots / "v.mkv", shots / "gone.mkv")
    code, out, _ = l3(*call)
    assert code == 1  # without --resume what is there is refused
    assert "not empty" in document(out)["run"]["error"]["message"]
    code, out, err = l3(*call, "--resume")  # the state of the run that failed is still there
    found = document(out)
    assert (code, err) == (0, "")
    assert [clip["state"] for clip in found["clips"]] == ["rendered", "rendered", "kept", "kept"]
    assert found["frames"] == 3 * COUNT + 1
    assert all(path.stat().st_mtime_ns == at for path, at in first.items())
    assert names(tmp_path / "out") == ["cut", "gone", "stack", "still.png"]


def test_if_all_fail_the_exit_code_is_that_of_the_first(l3: L3, tmp_path: Path, table: Path) -> None:
    call = ("render", table, tmp_path / "a.mkv", tmp_path / "b.mkv", "-o", tmp_path / "out", *FAST)
    assert l3(*call)[0] == 3
    assert not (tmp_path / "out").exists()


def test_what_no_clip_can_become_is_refused_before_work(refused: Refused, tmp_path: Path, table: Path, shots: Path) -> None:
    call = ("render", table, shots / "fold", shots / "v.mkv", "-o", tmp_path / "out", *FAST)
    assert "32" in refused(2, *call, "--bits", 32, "--format", "mp4")
    assert "--crf" in refused(2, *call, "--crf", 3)
    assert "gif" in refused(2, *call, "--format", "gif")


def test_two_clips_of_one_name_or_one_that_is_there_are_refused_before_work(
    refused: Refused, tmp_path: Path, table: Path, shots: Path
) -> None:
    (tmp_path / "other").mkdir()
    shutil.copy(shots / "v.mkv", tmp_path / "other/v.mkv")
    call = ("render", table, shots / "fold", "-o", tmp_path / "out", *FAST)
    assert "v.mkv" in refused(2, *call, shots / "v.mkv", tmp_path / "other/v.mkv")
    refused(2, *call, "-")
    (tmp_path / "out").mkdir()
    (tmp_path / "out/still.png").write_text("mine")
    assert "still.png" in refused(1, *call, shots / "still.npy")
    (tmp_path / "out/v").mkdir()
    (tmp_path / "out/v/mine").write_text("mine")
    assert str(tmp_path / "out/v") in refused(1, *call, shots / "v.mkv")
    assert "specify a folder" in refused(
        2, "render", table, shots / "fold", shots / "v.mkv", "-o", tmp_path / "a.mp4", *FAST
    )


def test_clips_of_a_folder_become_videos(l3: L3, tmp_path: Path, table: Path, shots: Path) -> None:
    call = ("render", table, shots / "stack.npy", shots / "fold", "-o", tmp_path / "out", "--format", "mkv", *FAST)
    assert l3(*call)[0] == 0
    assert names(tmp_path / "out") == ["fold.mkv", "stack.mkv"]


@pytest.mark.parametrize(
    ("source", "name"),
    [("take_####.tif", "take"), ("a/%04d.dng", "a"), ("b/*.tif", "b"), ("b/x*[0-9].tif", "x"), ("v.2.mkv", "v.2")],
)
def test_names_of_clips(source: str, name: str) -> None:
    assert name_of(Path(source)) == name


def test_an_output_is_never_taken_for_a_pattern(l3: L3, tmp_path: Path, table: Path, shots: Path) -> None:
    np.save(tmp_path / "a#1.npy", frames(1)[0])
    shutil.copytree(shots / "fold", tmp_path / "take.1")
    call = ("render", table, tmp_path / "a#1.npy", tmp_path / "take.1", "-o", tmp_path / "out", *FAST)
    assert l3(*call)[0] == 0
    assert names(tmp_path / "out") == ["a_1.png", "take_1"]


# -------------------------------------------------------------------------------------------------------- the same again


@pytest.fixture
def again(tmp_path: Path, table: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[tuple[str, str]]]:
    """`l3 render table.h5 in -o out --resume`, whenever it is called: name and state of each clip in tmp_path/in."""
    (tmp_path / "in").mkdir()

    def call(*options: object, code: int = 0) -> list[tuple[str, str]]:
        output = io.StringIO()
        with contextlib.redirect_stdout(output):
            command = ["render", table, tmp_path / "in", "-o", tmp_path / "out", "--resume", "--json", *FAST, *options]
            assert run([*map(str, command)]) == code
        return [(Path(clip["clip"]).name, clip["state"]) for clip in document(output.getvalue())["clips"]]

    return call


def test_a_folder_of_clips_is_rendered_again_and_again(again: Callable, shots: Path, tmp_path: Path) -> None:
    """New and changed clips are rendered, the others are kept. What others have put in the place of an output stays."""
    spot, out = tmp_path / "in", tmp_path / "out"
    shutil.copytree(shots / "fold", spot / "fo; touch x `ld`")
    np.save(spot / "--half $(1).npy", frames())
    (spot / "notes.txt").write_text("mine")
    (spot / ".coming.npy").write_bytes(b"half")
    (spot / "empty").mkdir()
    first = [("--half $(1).npy", "rendered"), ("fo; touch x `ld`", "rendered")]
    assert again() == first
    assert names(out) == ["--half $(1)", "fo; touch x `ld`"]
    assert again() == [(name, "kept") for name, _ in first]
    shutil.copy(shots / "v.mkv", spot)  # a new name
    np.save(spot / "still.npy", frames(1)[0])
    assert again()[2:] == [("still.npy", "rendered"), ("v.mkv", "rendered")]
    assert {state for _, state in again()} == {"kept"}
    np.save(spot / "--half $(1).npy", frames()[::-1])
    np.save(spot / "still.npy", frames(2)[1])
    assert [state for _, state in again()] == ["rendered", "kept", "rendered", "kept"]
    (out / "still.png").write_text("mine")
    assert [state for _, state in again(code=1)] == ["kept", "kept", "failed", "kept"]
    assert (out / "still.png").read_text() == "mine"


@pytest.mark.parametrize("suffix", ["mkv", "y4m"])
def test_videos_are_kept_or_rendered_again(again: Callable, shots: Path, tmp_path: Path, suffix: str) -> None:
    clip, video = tmp_path / "in/fold", tmp_path / f"out/fold.{suffix}"
    shutil.copytree(shots / "fold", clip)
    assert again("--format", suffix) == [("fold", "rendered")]
    before = video.read_bytes()
    assert again("--format", suffix) == [("fold", "kept")]
    (clip / "f_01.tif").write_bytes((clip / "f_02.tif").read_bytes())
    assert again("--format", suffix) == [("fold", "rendered")]
    assert video.read_bytes() != before
    assert again("--format", suffix, "--frames", "0-2", code=2) == [("fold", "failed")]  # other options are another run
    assert again("--format", suffix, "--frames", "0-2", "--force") == [("fold", "rendered")]


def test_a_full_disk_a_missing_device_or_another_table_stops_all(
    tmp_path: Path, table: Path, shots: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sources, options = [shots / "v.mkv", shots / "stack.npy"], RenderOptions(force=True)
    for error, raised in ((DeviceError("none"), DeviceError), (OSError(28, "full"), OSError)):
        calls: list[Path] = []

        def fails(_: Path, inputs: tuple[Path, ...], *__: object, error: Exception = error, calls: list = calls) -> Any:
            calls.append(inputs[0])
            raise error

        with monkeypatch.context() as patched:
            patched.setattr(clips, "render", fails)
            with pytest.raises(raised):
                render_clips(table, sources, tmp_path / "out", options, Summary())
        assert calls == sources[:1]

    def touched(*_: object) -> Any:
        os.utime(table, (1, 1))
        raise InputFileError("broken")

    monkeypatch.setattr(clips, "render", touched)
    with pytest.raises(RecipeError, match="has changed during the run"):
        render_clips(table, sources, tmp_path / "out", options, Summary())


def test_a_folder_of_clips_and_its_output_lie_apart(refused: Refused, table: Path, shots: Path) -> None:
    for path in (shots / "fold").parent.glob("pat*"):
        path.unlink()
    assert str(shots / "out") in refused(2, "render", table, shots, *FAST, "-o", shots / "out")


def test_a_folder_of_frames_is_one_clip_and_what_else_is_in_it_is_named(
    l3: L3, tmp_path: Path, table: Path, shots: Path
) -> None:
    fold = shots / "fold"
    (fold / "frame.h5").write_bytes(b"")
    call = ("render", table, fold, "-o", tmp_path / "out", "--format", "mkv", "--backend", "reference")
    assert "without" not in l3(*call)[2]
    shutil.copy(shots / "v.mkv", fold)
    assert f"{fold} is rendered as one sequence of frames, without v.mkv;" in l3(*call, "--force")[2]
    assert names(tmp_path / "out") == ["fold.mkv"]


def test_a_renderer_is_made_once_and_anew_after_an_error(
    again: Callable, shots: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What OpenCL builds for one stays in memory."""
    made: list[str] = []

    def counted(backend: str, *about: Any, **options: Any) -> Any:
        made.append(backend)
        return make_renderer(backend, *about, **options)

    monkeypatch.setattr("l3cli.rendering.renderer.make_renderer", counted)
    for name in ("a.npy", "b.npy", "d.npy"):
        np.save(tmp_path / "in" / name, frames(2))
    again()
    assert made == ["reference"]
    (tmp_path / "in/c.npy").write_bytes(b"cut")
    again("--force", "--frames", "0", code=1)
    assert made == ["reference"] * 3


def test_ctrl_c_ends_many_clips_with_130_and_their_results(table: Path, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", frames(2))
    np.save(tmp_path / "b.npy", np.tile(frames(), (2000, 1, 1)))
    call = (
        "render",
        table,
        tmp_path / "a.npy",
        tmp_path / "b.npy",
        "-o",
        tmp_path / "out",
        "--format",
        "mkv",
        "--json",
        *FAST,
    )
    program = f"from l3cli.system.signals import heed; heed(); {RUN}"
    command = [sys.executable, "-c", program, *map(str, call)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as ended:
        end = time.monotonic() + 300
        while not (tmp_path / "out/a.mkv").exists() and time.monotonic() < end:
            time.sleep(0.05)
        time.sleep(0.3)
        ended.send_signal(signal.SIGINT)
        out, err = ended.communicate(timeout=300)
    found = document(out)
    assert (ended.returncode, err) == (130, "l3: interrupted\n")
    assert [clip["state"] for clip in found["clips"]] == ["rendered"]
    assert found["run"]["error"]["kind"] == "interrupted"
    assert names(tmp_path / "out") == ["a.mkv"]
