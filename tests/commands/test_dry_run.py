"""--dry-run of every command that writes: what would be read and made on stdout, refusals as ever, nothing on the disk."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from l3cli.system.locks import sole_writer_of_file
from tests.helpers.calls import L3, Refused

SENTENCES = {  # a call that works, and what its dry run says
    "calibrate lab/MEASUREMENTS.toml -o {out}/c.h5 --truth camera.toml": (
        "reads frames: 85 files, ",
        "reads camera to compare with: {in}/camera.toml, ",
        "makes {out}/c.h5: camera model of 3 channels\n",
    ),
    "export camera.h5 -o {out}/e": ("reads camera: {in}/camera.h5, ", "makes {out}/e/rawtoaces.json: export\n"),
    "calibrate --draft lab -o {out}/M.toml": ("reads frames: 85 files, ", "makes {out}/M.toml: draft of"),
    "simulate scenes.toml --camera camera.h5 -o {out}/t.h5 --pictures {out}/p --dng {out}/d": (
        "reads recipes: 2 files, ",
        "makes {out}/t.h5: training set, {frames} frames of 192×256, ",
        "makes {out}/p: pictures of {frames} frames of 192×256\n",
        "makes {out}/d: pictures of",
    ),
    "train training.h5 --classes classes.toml -o {out}/t.h5": (
        "reads training sets: {in}/training.h5, ",
        "makes {out}/t.h5: transform table of ",
    ),
    "train training.h5 --classes classes.toml --shard 1/2 -o {out}/s.h5": (
        "makes {out}/s.h5: partial sums, shard 1 of 2, of",
    ),
    "render table.h5 {raw} -o {out}/p.png": ("reads table: {in}/table.h5, ", "makes {out}/p.png: picture of 1 frame\n"),
    "render table.h5 unseen/*_raw.tif -o {out}/p/####.tif": ("makes {out}/p/####.tif: numbered pictures of ",),
    "evaluate table.h5 unseen.h5 --pictures {out}/p": ("reads frames: {in}/unseen.h5, ", "makes {out}/p: pictures of "),
    "report camera.h5 table.h5 -o {out}/r.html": ("reads artifacts: 2 files, ", "makes {out}/r.html: page\n"),
    "lab camera.toml -o {out}/lab": ("reads camera: {in}/camera.toml, ", "frames of 192×256, "),
    "init bayer {out}/demo": ("makes {out}/demo/Makefile: copy, ",),
}


def everything(folder: Path) -> Iterator[tuple[str, int, int]]:
    for path in sorted(folder.rglob("*")):
        status = path.lstat()
        yield str(path), status.st_size, status.st_mtime_ns


def arguments(sentence: str, folder: Path, out: Path) -> list[str]:
    raw = next((folder / "unseen").glob("*_raw.tif"))
    words = sentence.format(out=out, raw=raw).split()
    names = {path.name for path in folder.iterdir()}
    return [str(folder / word) if index and word.partition("/")[0] in names else word for index, word in enumerate(words)]


@pytest.mark.parametrize("sentence", SENTENCES)
def test_a_dry_run_states_what_would_be_made(sentence: str, pipeline: Path, tmp_path: Path, l3: L3) -> None:
    before, changed = list(everything(pipeline)), tmp_path.stat().st_mtime_ns
    code, out, err = l3(*arguments(sentence, pipeline, tmp_path / "new"), "--dry-run")
    assert (code, err) == (0, "")
    assert out.endswith("dry run: nothing has been written\n")
    frames = out.partition("training set, ")[2].partition(" ")[0]
    for answer in SENTENCES[sentence]:
        assert (
            answer.replace("{out}", str(tmp_path / "new")).replace("{in}", str(pipeline)).replace("{frames}", frames) in out
        )
    assert list(everything(pipeline)) == before
    assert (list(tmp_path.iterdir()), tmp_path.stat().st_mtime_ns) == (
        [],
        changed,
    )  # nor was anything made and removed again


@pytest.mark.parametrize("sentence", SENTENCES)
def test_a_dry_run_refuses_what_is_there(sentence: str, pipeline: Path, tmp_path: Path, refused: Refused) -> None:
    """As the run itself does, with its exit code."""
    call = arguments(sentence, pipeline, tmp_path)
    at = next(index for index, word in enumerate(call) if word.startswith(str(tmp_path)))
    output = Path(call[at])
    if "#" in output.name or not output.suffix:
        folder = output.parent if "#" in output.name else output
        folder.mkdir()
        numbered = [folder / f"{number:04d}.tif" for number in range(40)]
        for path in [*numbered, folder / "MEASUREMENTS.toml", folder / "rawtoaces.json"]:
            path.write_text("mine")
    else:
        output.write_text("mine")
    real, dry = (refused(1, *call, *more) for more in ((), ("--dry-run",)))
    assert dry == real


def test_a_dry_run_refuses_wrong_inputs(pipeline: Path, tmp_path: Path, refused: Refused) -> None:
    calls = {
        "none.tif": (3, "render", pipeline / "table.h5", pipeline / "none.tif", "-o", tmp_path / "p.png"),
        "table.h5": (3, "train", pipeline / "table.h5", "-o", tmp_path / "t.h5"),
        "camera.toml": (2, "calibrate", pipeline / "camera.toml", "-o", tmp_path / "c.h5"),
    }
    for name, (code, *call) in calls.items():
        assert name in refused(code, *call, "--dry-run")


def test_a_dry_run_respects_another_run(pipeline: Path, tmp_path: Path, l3: L3) -> None:
    """It is refused what another run writes, and leaves that run's lock."""
    output = tmp_path / "t.h5"
    with sole_writer_of_file(output):
        before = list(everything(tmp_path))
        code, out, err = l3("train", pipeline / "training.h5", "-o", output, "--dry-run")
        assert (code, out) == (1, "")
        assert "is being written by another run" in err
        assert list(everything(tmp_path)) == before
    assert l3("train", pipeline / "training.h5", "-o", output, "--dry-run")[0] == 0
