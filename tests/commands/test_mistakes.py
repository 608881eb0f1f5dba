"""Typical mistakes of every command: one line that names the culprit and the cure, the right exit code, and nothing done.

MISTAKES holds exit codes and calls, below each words of the answer. The desk they are made at has the files of a whole
pipeline beside some that are none of them.
"""

import os
import re
import shlex
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.helpers.cameras import bayer_camera

RECIPES = {  # recipes with one thing wrong: name ← (text that is right, what is replaced in it, by what)
    "source.toml": ("scenes", '"dead leaves"', '"dead leafs"'),
    "key.toml": ("scenes", "count", "counts"),
    "lamp.toml": ("scenes", "exposure_share", 'illuminants = ["D56"]\nexposure_share'),
    "negative.toml": ("scenes", "0.9", "-0.9"),
    "outputs.toml": ("scenes", "[[scene]]", '[target]\noutputs = "CIE1931"\n[[scene]]'),
    "noise.toml": ("scenes", "[[scene]]", '[sensor]\nnoise = "shots"\n[[scene]]'),
    "classes_key.toml": ("classes", "levels", "level"),
    "even.toml": ("classes", "patch = 5", "patch = 4"),
    "channel.toml": ("camera", '"g b"', '"g bl"'),
    "curve.toml": ("camera", "r = [{", "red = [{"),
    "centre.toml": ("camera", "centre_nm", "center_nm"),
    "rows.toml": ("camera", "rows = 192", "rows = -192"),
    "electrons.toml": ("camera", "read_noise_e = 4.0", "read_noise_e = -4.0"),
    "width.toml": ("camera", "sigma_nm = 35", "sigma_nm = 0"),
    "pitch.toml": ("camera", "pixel_pitch_um = 4.0", "pixel_pitch_um = 0"),
    "bits.toml": ("camera", "bits = 12", "bits = 20"),
}
MISTAKES = """
    2 paint
        no command "paint"; did you mean
    2 trian training.h5
        did you mean "train"? see "l3 --help"
    2 info --jsn camera.h5
        no option --jsn; did you mean "--json"? see "l3 info --help"

    2 calibrate camera.toml -o new.h5
        camera.toml is a camera recipe; give a measurement file
    2 calibrate scenes.toml -o new.h5
        scenes.toml is a scene recipe; give a measurement file
    3 calibrate camera.h5 -o new.h5
        camera.h5 is not a text file; give a measurement file
    3 calibrate lab -o new.h5
        lab is a folder; give a measurement file
    3 calibrate nothing.toml -o new.h5
        nothing.toml does not exist; give a measurement file
    2 calibrate empty.toml -o new.h5
        empty.toml:1: missing key `name`
    2 calibrate lab/MEASUREMENTS.toml
        Missing option '-o'
    1 calibrate lab/MEASUREMENTS.toml -o folder
        folder is a folder; name a file
    1 calibrate lab/MEASUREMENTS.toml -o raw.tif/new.h5
        raw.tif is a file, not a folder; name another output
    2 calibrate lab/MEASUREMENTS.toml -o new.toml
        .toml is for recipes; name an output
    1 calibrate lab/MEASUREMENTS.toml -o new.h5 --export raw.tif
        raw.tif is a file, not a folder
    3 calibrate lab/MEASUREMENTS.toml -o new.h5 --truth table.h5
        table.h5 holds a transform table; give the file written by
    2 calibrate lab/MEASUREMENTS.toml -o new.h5 --jobs 0
        0 is not within 1…4096; the nearest is 1

    2 simulate camera.toml --camera scenes.toml -o new.h5
        scenes.toml is a scene recipe; give a camera recipe
    2 simulate lab/MEASUREMENTS.toml --camera camera.h5 -o new.h5
        is a measurement file; give a scene recipe
    2 simulate scenes.toml --camera lab/MEASUREMENTS.toml -o new.h5
        is a measurement file; give a camera recipe
    2 simulate classes.toml --camera camera.h5 -o new.h5
        classes.toml is a class recipe; give a scene recipe
    3 simulate scenes.toml --camera table.h5 -o new.h5
        table.h5 holds a transform table; give the file written by
    3 simulate scenes.toml --camera raw.tif -o new.h5
        raw.tif is not an HDF5 file; give the file written by
    3 simulate scenes.toml --camera folder -o new.h5
        folder is a folder; give the file written by
    2 simulate scenes.toml -o new.h5
        Missing option '--camera'
    2 simulate empty.toml --camera camera.h5 -o new.h5
        empty.toml: scene or pair must have an entry
    2 simulate scenes.toml --camera camera.h5 -o new.h5 --seed -1
        -1 is not within 0…9223372036854775807; the nearest is 0
    2 simulate scenes.toml --camera camera.h5 -o camera.h5 --force
        camera.h5 is an input; name another output
    1 simulate scenes.toml --camera camera.h5 -o new.h5 --pictures raw.tif
        raw.tif is a file; name a folder
    2 simulate source.toml --camera camera.h5 -o new.h5
        [scene[1].source]; did you mean "dead leaves"?
    2 simulate key.toml --camera camera.h5 -o new.h5
        unknown key `counts` in [scene[1]]; did you mean "count"?
    2 simulate lamp.toml --camera camera.h5 -o new.h5
        illuminant "D56" is unknown; did you mean "D
    2 simulate negative.toml --camera camera.h5 -o new.h5
        exposures must be above zero
    2 simulate outputs.toml --camera camera.h5 -o new.h5
        "CIE1931" is unknown; did you mean "CIE 1931"
    2 simulate noise.toml --camera camera.h5 -o new.h5
        [sensor.noise]; did you mean "shot"?
    2 simulate scenes.toml --camera channel.toml -o new.h5
        "bl" is no channel; did you mean "b"?
    2 simulate scenes.toml --camera curve.toml -o new.h5
        "red" is no channel; there are r, g, b
    2 simulate scenes.toml --camera centre.toml -o new.h5
        unknown key `center_nm`
    2 simulate scenes.toml --camera rows.toml -o new.h5
        rows.toml: sensor.rows is -192, and must be above zero
    2 simulate scenes.toml --camera electrons.toml -o new.h5
        noise.read_noise_e is -4, and must not be negative
    2 simulate scenes.toml --camera width.toml -o new.h5
        a sigma of the Gaussians of r is 0
    2 simulate scenes.toml --camera pitch.toml -o new.h5
        sensor.pixel_pitch_um is 0
    2 simulate scenes.toml --camera bits.toml -o new.h5
        sensor.bits is 20; a raw value has 1 to 16 bits

    2 train training.h5 --classes scenes.toml -o new.h5
        scenes.toml is a scene recipe; give a class recipe
    3 train training.h5 --classes camera.h5 -o new.h5
        camera.h5 is not a text file; give a class recipe
    2 train training.h5 --classes classes_key.toml -o new.h5
        unknown key `level` in [classes]; did you mean "levels"
    2 train training.h5 --classes even.toml -o new.h5
        even.toml: classes.patch is 4, not an odd number
    3 train scenes.toml -o new.h5
        scenes.toml is not an HDF5 file; give the file written by
    3 train camera.h5 -o new.h5
        camera.h5 holds a camera model; give the file written by
    3 train empty.h5 -o new.h5
        empty.h5 is not an HDF5 file; give the file written by
    3 train nothing.h5 -o new.h5
        nothing.h5 does not exist; make it with "l3 simulate"
    2 train training.h5 -o training.h5 --force
        training.h5 is an input; name another output
    2 train training.h5 -o new.h5 --shares 1,2
        2 shares for 1 training sets
    2 train training.h5 -o new.h5 --shares=-1
        -1 is not within 0…1e+06; the nearest is 0
    2 train training.h5 -o new.h5 --shard 3/2
        shards count from 1/2 to 2/2
    3 train --merge table.h5 -o new.h5
        table.h5 holds a transform table; give the file written by

    3 render raw.tif table.h5 -o new.png
        raw.tif is not an HDF5 file; give the file written by "l3 train"
    3 render training.h5 raw.tif -o new.png
        training.h5 holds a training set; give the file written by
    3 render table.h5 table.h5 -o new.png
        table.h5 holds no dataset uint16 (frame, row, col)
    3 render table.h5 picture.png -o new.png
        picture.png has 3 channels
    3 render table.h5 camera.toml -o new.png
        give a camera raw, a one-channel TIFF
    3 render table.h5 empty.tif -o new.png
        empty.tif is not an image
    3 render table.h5 folder -o new.png
        folder holds no raw frames; give a folder of
    3 render table.h5 nothing.tif -o new.png
        nothing.tif does not exist; give a raw file
    3 render table.h5 cut.raw -o new.png
        give its size with --size ROWSxCOLS
    2 render table.h5 raw.tif
        Missing option '-o'
    2 render table.h5 -o new.png
        Missing argument 'INPUT...'
    2 render table.h5 raw.tif -o new.jp2
        pictures are written as .png
    2 render table.h5 raw.tif -o raw.tif --force
        raw.tif is an input; name another output
    1 render table.h5 raw.tif -o raw.tif/new.png
        raw.tif is a file, not a folder
    2 render table.h5 raw.tif -o new.png --exposure -1
        -1 is not within 1e-09…1e+09 times Y
    2 render table.h5 raw.tif -o new.png --white-level -5
        -5 is not within 0…65535 DN; the nearest is 0
    3 render table.h5 raw.tif -o new.png --white-level 5
        give --black-level and --white-level
    2 render table.h5 raw.tif -o new.png --white D651
        illuminant "D651" is unknown; did you mean "D65"
    2 render table.h5 raw.tif -o new.png --backend opencll
        did you mean "opencl"?
    2 render table.h5 raw.tif -o new.mp4 --codec h256
        did you mean "h265" or "h264"?
    2 render table.h5 raw.tif -o new.png --phase 1
        "1" is not ROW,COL

    3 evaluate training.h5 table.h5
        training.h5 holds a training set; give the file written by
    3 evaluate table.h5 camera.h5
        camera.h5 holds a camera model; give the file written by
    1 evaluate table.h5 unseen.h5 --pictures raw.tif
        raw.tif is a file; name a folder
    2 evaluate table.h5 unseen.h5 --viewing -3
        -3 is not within 2…1000 samples/degree; the nearest is 2

    3 report table.h5 raw.tif -o new.html
        raw.tif is not an HDF5 file; give the file written by
    2 report table.h5 -o new.pdf
        name a file that ends in .html
    1 report table.h5 -o raw.tif/new.html
        raw.tif is a file, not a folder

    3 compare table.h5
        table.h5: not readable as JSON; give what "l3 evaluate --json" prints
    3 compare nothing.json
        nothing.json does not exist; give what
    3 compare folder
        folder is a folder; give what
    3 compare empty.json
        give what "l3 evaluate --json" prints

    2 info
        give either a FILE or --version
    3 info raw.tif
        raw.tif is not an HDF5 file; give the file written by
    3 info folder
        folder is a folder; give the file written by

    2 lab scenes.toml -o new
        scenes.toml is a scene recipe; give a camera recipe
    2 lab camera.toml --recipe scenes.toml -o new
        scenes.toml is a scene recipe; give a lab recipe
    3 lab table.h5 -o new
        table.h5 holds a transform table; give the file written by
    1 lab camera.toml -o raw.tif
        raw.tif is a file, not a folder
    1 lab camera.toml -o lab
        MEASUREMENTS.toml exists; add --force

    2 init byer new
        no recipe "byer"; did you mean "bayer"?
    1 init bayer raw.tif
        raw.tif is a file; name a folder
    4 bench --device nvdia --quiet
        no OpenCL device is called "nvdia"
"""
CASES = re.findall(r"^    (\d) (.+)\n {8}(.+)$", MISTAKES, re.MULTILINE)


@pytest.fixture(scope="module")
def desk(pipeline: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of a pipeline and others, in a folder where mistakes are made."""
    folder = tmp_path_factory.mktemp("desk")
    for path in pipeline.iterdir():
        (folder / path.name).symlink_to(path)
    (folder / "raw.tif").symlink_to(next((pipeline / "unseen").glob("*_raw.tif")))
    for name in ("empty.toml", "empty.h5", "empty.tif"):
        (folder / name).touch()
    (folder / "empty.json").write_text("{}")
    (folder / "cut.raw").write_bytes(bytes(1001))
    (folder / "folder").mkdir()
    right = {name: (pipeline / f"{name}.toml").read_text() for name in ("scenes", "classes")} | {"camera": bayer_camera()}
    for name, (origin, old, new) in RECIPES.items():
        assert old in right[origin], name
        (folder / name).write_text(right[origin].replace(old, new))
    return folder


@pytest.mark.parametrize(("code", "call", "words"), CASES, ids=[call for _, call, _ in CASES])
def test_a_mistake_is_one_line_with_the_cure(
    code: str, call: str, words: str, desk: Path, refused: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(desk)
    before = {path: path.lstat().st_mtime_ns for path in desk.rglob("*")}
    assert words in refused(int(code), *shlex.split(call))
    assert {path: path.lstat().st_mtime_ns for path in desk.rglob("*")} == before


def test_a_missing_extra_is_named(desk: Path, refused: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    monkeypatch.chdir(desk)
    assert 'pip install "l3cli[video]"' in refused(1, "render", "table.h5", "raw.tif", "-o", "new.mp4")


def test_a_device_that_is_not_there_is_named(desk: Path, refused: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("L3_DEVICE", "nvdia")
    monkeypatch.chdir(desk)
    line = refused(4, "render", "table.h5", "raw.tif", "-o", "new.png")
    assert 'no OpenCL device is called "nvdia"; --device or L3_DEVICE must be one of 0: ' in line


def test_a_folder_that_may_not_be_written_is_named_before_any_work(
    pipeline: Path, tmp_path: Path, refused: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    locked = tmp_path / "locked"
    locked.mkdir()
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != locked)  # as root may write everywhere
    for call in (
        ("simulate", pipeline / "scenes.toml", "--camera", pipeline / "camera.h5", "-o", locked / "new/new.h5"),
        ("train", pipeline / "training.h5", "-o", locked / "new.h5"),
        ("lab", pipeline / "camera.toml", "-o", locked / "new"),
        ("render", pipeline / "table.h5", pipeline / "picture.png", "-o", locked / "new.png"),
    ):
        assert f"{locked} cannot be written to; name an output" in refused(1, *call)
