"""Many clips in one call, and a folder that is watched: each rendered once, what is wrong with one is left at that one."""

import functools
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from l3cli.artifacts.store import save
from l3cli.errors import DeviceError, L3Error, RecipeError
from l3cli.io.images import write_mosaic
from l3cli.io.raw.files import KnownBetter
from l3cli.rendering.renderer import make_renderer
from l3cli.stages.checking.output_schema import output_schema
from l3cli.stages.console import Silent
from l3cli.stages.rendering.clips import ClipJob, name_of
from l3cli.stages.rendering.render import render
from l3cli.stages.rendering.watch import STATE, watch
from tests.helpers.calls import L3, Refused
from tests.helpers.sequences import COUNT, FAST, RGGB, RUN, frames, pictures, write_raw_video

jsonschema = pytest.importorskip("jsonschema")


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
    return sorted(path.name for path in folder.iterdir())


def document(out: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(out)
    jsonschema.validate(found, output_schema())
    return found


# -------------------------------------------------------------------------------------------------------- many clips


def test_each_clip_is_rendered_as_if_alone(l3: L3, tmp_path: Path, table: Path, shots: Path) -> None:
    call = ("render", table, *(shots / name for name in NAMES), "-o", tmp_path / "out", *FAST)
    code, out, err = l3(*call)
    assert (code, err) == (0, "")
    assert names(tmp_path / "out") == sorted(PLACES)  # and no state of a run that is complete
    lines = out.splitlines()
    assert lines[-1] == f"clips: 5 rendered, 0 kept, 0 failed; frames: {4 * COUNT + 1}, 0 left out"
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
    assert code == 1  # without --resume what is there is refused …
    assert "not empty" in document(out)["run"]["error"]["message"]
    code, out, err = l3(*call, "--resume")  # … and the state of the run that failed is still there
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
    assert "values of 32 bits are for pictures" in refused(2, *call, "--bits", 32, "--format", "mp4")
    assert "--codec and --crf are for videos" in refused(2, *call, "--crf", 3)
    assert "pictures are written as" in refused(2, *call, "--format", "gif")


def test_two_clips_of_one_name_or_one_that_is_there_are_refused_before_work(
    refused: Refused, tmp_path: Path, table: Path, shots: Path
) -> None:
    (tmp_path / "other").mkdir()
    shutil.copy(shots / "v.mkv", tmp_path / "other/v.mkv")
    call = ("render", table, shots / "fold", "-o", tmp_path / "out", *FAST)
    assert 'would both become "v"' in refused(2, *call, shots / "v.mkv", tmp_path / "other/v.mkv")
    assert "stdin is one clip" in refused(2, *call, "-")
    (tmp_path / "out").mkdir()
    (tmp_path / "out/still.png").write_text("mine")
    assert "still.png exists" in refused(1, *call, shots / "still.npy")
    (tmp_path / "out/v").mkdir()
    (tmp_path / "out/v/mine").write_text("mine")
    assert "v is not empty" in refused(1, *call, shots / "v.mkv")
    assert "name a folder" in refused(2, "render", table, shots / "fold", shots / "v.mkv", "-o", tmp_path / "a.mp4", *FAST)


def test_videos_in_a_folder_and_a_dry_run_of_them(l3: L3, tmp_path: Path, table: Path, shots: Path) -> None:
    call = ("render", table, shots / "stack.npy", shots / "fold", "-o", tmp_path / "out", "--format", "mkv", *FAST)
    code, out, err = l3(*call, "--dry-run")
    assert (code, err) == (0, "")
    assert f"makes {tmp_path / 'out/stack.mkv'}: video of 5 frames" in out
    assert f"makes {tmp_path / 'out/fold.mkv'}: video of 5 frames" in out
    assert not (tmp_path / "out").exists()
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


def test_a_full_disk_or_a_missing_device_stops_all(tmp_path: Path, table: Path, shots: Path) -> None:
    for error, raised in ((DeviceError("none"), DeviceError), (OSError(28, "full"), OSError)):
        calls: list[Path] = []

        def fails(inputs: tuple[Path, ...], *_: object, error: Exception = error, calls: list = calls, **__: object) -> Any:
            calls.append(inputs[0])
            raise error

        stage = functools.partial(fails, known=KnownBetter())
        job = ClipJob(table, tmp_path / "out", "png", stage, Silent(), force=True)
        with pytest.raises(raised):
            job.run([shots / "v.mkv", shots / "stack.npy"], resume=False)
        assert calls == [shots / "v.mkv"]


# ------------------------------------------------------------------------------------------------------------- watch


class Ends(Exception):
    """The last look."""


class Said(Silent):
    """A console that keeps what is left out."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def alert(self, message: str) -> None:
        self.lines.append(message)


@pytest.fixture
def watched(tmp_path: Path, table: Path) -> Callable[..., tuple[ClipJob, list[str]]]:
    """Watch tmp_path/in: each step is called instead of a pause, and the watch ends after the last."""
    (tmp_path / "in").mkdir()

    def call(*steps: Callable[[], object], stage: Any = render, **options: Any) -> tuple[ClipJob, list[str]]:
        left: Iterator[Callable[[], object]] = iter(steps)

        def pause(_: float) -> None:
            step = next(left, None)
            if step is None:
                raise Ends
            step()

        console = Said()
        one = functools.partial(stage, table, suffix="png", known=KnownBetter(), backend="reference", skip_bad=False)
        job = ClipJob(table, tmp_path / "out", "png", one, console, **options)
        with pytest.raises(Ends):
            watch(job, tmp_path / "in", 1.0, pause)
        return job, console.lines

    return call


def nothing() -> None:
    pass


def test_what_is_whole_is_rendered_once_also_by_the_next_watch(watched: Callable, shots: Path, tmp_path: Path) -> None:
    here, whole = tmp_path / "in", (shots / "stack.npy").read_bytes()
    half = here / "stack.npy"
    steps = (
        lambda: half.write_bytes(whole[:500]),
        lambda: half.write_bytes(whole[:900]),  # it grows: not whole yet
        lambda: half.write_bytes(whole),
        lambda: shutil.move(shutil.copy(shots / "still.npy", here / ".hidden"), here / "still.npy"),
        nothing,
        nothing,
    )
    job, said = watched(*steps)
    assert said == []
    assert [report.clip for report in job.summary.clips] == [str(here / "stack.npy"), str(here / "still.npy")]
    assert names(tmp_path / "out") == [STATE, "stack", "still.png"]
    job, said = watched(nothing, nothing)
    assert (job.summary.clips, said) == (type(job.summary.clips)(maxlen=1000), [])
    job, _ = watched(lambda: np.save(half, frames()[::-1]), nothing, nothing)  # another content
    assert [report.clip for report in job.summary.clips] == [str(half)]
    assert job.summary.exit_code == 0


def test_what_cannot_be_rendered_is_said_once_and_not_tried_again(watched: Callable, shots: Path, tmp_path: Path) -> None:
    here = tmp_path / "in"
    os.mkfifo(here / "pipe.dng")
    (here / "link.mkv").symlink_to(shots / "v.mkv")
    (here / "notes.txt").write_text("mine")
    (here / "cut.mkv").write_bytes((shots / "v.mkv").read_bytes()[:700])
    (here / ("x" * 251 + ".npy")).write_bytes(b"")
    (here / "\udcff.npy").write_bytes((shots / "still.npy").read_bytes())
    (here / "empty").mkdir()
    job, said = watched(*[nothing] * 4)
    assert len(said) == 6
    assert [line for line in said if "left out" in line] == [
        f"l3: {here}/link.mkv is a link; left out",
        f"l3: {here}/notes.txt is a file of no raw format; left out",
        f"l3: {here}/pipe.dng is a pipe; left out",
    ]
    assert (job.summary.counts["failed"], job.summary.counts["rendered"]) == (3, 1)
    job, said = watched(*[nothing] * 3)
    assert not job.summary.clips
    assert len(said) == 3  # links and the like, of which no state is kept
    job, said = watched(lambda: shutil.copy(shots / "v.mkv", here / "cut.mkv"), nothing, nothing)
    assert [report.state for report in job.summary.clips] == ["rendered"]


def test_what_was_half_done_is_done_again(watched: Callable, shots: Path, tmp_path: Path) -> None:
    shutil.copy(shots / "stack.npy", tmp_path / "in/stack.npy")
    shutil.copy(shots / "still.npy", tmp_path / "in/still.npy")
    done: list[str] = []

    def dies(table: Path, inputs: tuple[Path, ...], output: Path, console: Any, **choices: Any) -> Any:
        tally = render(table, inputs, output, console, **choices)
        done.append(output.name)
        if output.name == "stack":
            raise Ends  # as a kill would end it: pictures are there, and nothing says so
        return tally

    watched(nothing, nothing, stage=dies)
    assert done == ["stack"]
    (tmp_path / "out/stack/stack_000002.png").unlink()
    job, said = watched(nothing, nothing)
    assert said == []
    assert [report.state for report in job.summary.clips] == ["rendered", "rendered"]
    assert len(pictures(tmp_path / "out/stack")) == COUNT


def test_what_others_have_put_there_is_not_replaced(watched: Callable, shots: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/still.png").write_text("mine")
    shutil.copy(shots / "still.npy", tmp_path / "in/still.npy")
    _, said = watched(nothing, nothing, nothing)
    assert len(said) == 1
    assert "still.png exists" in said[0]
    watched(nothing, nothing)
    assert (tmp_path / "out/still.png").read_text() == "mine"
    job, _ = watched(nothing, nothing, force=True)
    assert job.summary.counts["rendered"] == 1


def test_memory_is_that_of_what_lies_in_the_folder(watched: Callable, shots: Path, tmp_path: Path) -> None:
    here = tmp_path / "in"
    steps: list[Callable[[], object]] = []
    for number in range(4):
        steps.append(functools.partial(shutil.copy, shots / "still.npy", here / f"{number}.npy"))
        steps += [nothing, functools.partial(os.unlink, here / f"{number}.npy")]
    job, _ = watched(*steps, nothing)
    assert job.summary.counts["rendered"] == 4
    assert job.state.entry(here / "3.npy") is None


def test_a_renderer_is_made_once_and_anew_after_an_error(
    watched: Callable, shots: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What OpenCL builds for one stays in memory."""
    made: list[str] = []

    def counted(backend: str, *about: Any, **options: Any) -> Any:
        made.append(backend)
        return make_renderer(backend, *about, **options)

    monkeypatch.setattr("l3cli.rendering.quiet.make_renderer", counted)
    for name in ("a.npy", "b.npy", "d.npy"):
        shutil.copy(shots / "still.npy", tmp_path / "in" / name)
    watched(nothing)
    assert made == ["reference"]
    (tmp_path / "in/c.npy").write_bytes(b"cut")
    watched(nothing, nothing, force=True)
    assert made == ["reference"] * 3


def test_a_watch_that_cannot_be_is_refused(watched: Callable, refused: Refused, table: Path, tmp_path: Path) -> None:
    here = tmp_path / "in"
    call = ("render", table, *FAST)
    assert "lie in one another" in refused(2, *call, "--watch", here, "-o", here / "out")
    assert "cannot be watched" in refused(3, *call, "--watch", tmp_path / "none", "-o", tmp_path / "out")
    assert "give either" in refused(2, *call, "--watch", here, here / "a.npy", "-o", tmp_path / "out")
    assert "give either" in refused(2, *call, "-o", tmp_path / "out")
    assert "--every goes with --watch" in refused(2, *call, here / "a.npy", "--every", 3, "-o", tmp_path / "out")
    assert "dry run" in refused(2, *call, "--watch", here, "-o", tmp_path / "out", "--dry-run")
    watched(nothing)
    save(RGGB, table)
    stage = functools.partial(render, table, known=KnownBetter())
    job = ClipJob(table, tmp_path / "out", "png", stage, Silent())
    os.utime(table, (1, 1))
    with pytest.raises(L3Error, match="has changed since the run began"):
        job.one(here / "a.npy")
    other = ClipJob(table, tmp_path / "out", "tif", stage, Silent())
    with pytest.raises(RecipeError, match="another table or options"):
        watch(other, here, 1.0)


def test_ctrl_c_ends_a_watch_with_130_and_its_results(table: Path, shots: Path, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    shutil.copy(shots / "still.npy", tmp_path / "in")
    call = ("render", table, "--watch", tmp_path / "in", "--every", "0.1", "-o", tmp_path / "out", "--json", *FAST)
    program = f"from l3cli.interrupts import heed; heed(); {RUN}"
    command = [sys.executable, "-c", program, *map(str, call)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
        end = time.monotonic() + 60
        while not (tmp_path / "out/still.png").exists() and time.monotonic() < end:
            time.sleep(0.05)
        time.sleep(0.3)
        run.send_signal(signal.SIGINT)
        out, err = run.communicate(timeout=30)
    found = document(out)
    assert (run.returncode, err) == (130, "l3: interrupted\n")
    assert [clip["state"] for clip in found["clips"]] == ["rendered"]
    assert found["run"]["error"]["kind"] == "interrupted"
    assert names(tmp_path / "out") == [STATE, "still.png"]
