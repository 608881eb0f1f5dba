"""Typical mistakes in every command: one line that names the culprit and the fix, the right exit code, and no output.

MISTAKES contains the exit code, the call, and words of the message. The calls are made in a folder that contains the files
of a whole pipeline, and other files.
"""

import dataclasses
import json
import os
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.cli import run
from l3cli.evaluation.camera_match import MAX_DELTA_E, camera_differences, colour_difference, noise_ratio
from tests.helpers.calls import L3, Refused
from tests.helpers.cameras import bayer_camera
from tests.helpers.tables import colorimetric_table
from tests.helpers.training_sets import a_set

MISTAKES = """
    2 paint
        no command "paint"; did you mean
    2 trian training.h5
        did you mean "train"? see "l3 --help"
    2 info --jsn camera.h5
        no option --jsn; did you mean "--json"? see "l3 info --help"
    2 calibrate camera.toml -o new.h5
        camera.toml is a camera recipe; use a measurement file
    2 calibrate scenes.toml -o new.h5
        scenes.toml is a scene recipe; use a measurement file
    3 calibrate camera.h5 -o new.h5
        camera.h5 is not a text file; use a measurement file
    3 calibrate lab -o new.h5
        lab is a folder; use a measurement file
    3 calibrate nothing.toml -o new.h5
        nothing.toml does not exist; use a measurement file
    2 calibrate empty.toml -o new.h5
        empty.toml:1: missing key `name`
    2 calibrate lab/MEASUREMENTS.toml
        Missing option '-o'
    2 calibrate no_pitch.toml -o new.h5
        missing key `pixel_pitch_um` in [sensor]
    2 calibrate bits.toml -o new.h5
        sensor.bits is 99; use at most 16
    2 calibrate broken.toml -o new.h5
        not valid TOML
    2 calibrate two_kinds.toml -o new.h5
        contains mono and curves
    2 calibrate rotator.toml -o new.h5
        [rotator] applies only to [[polariser]] captures; add [[polariser]] captures, or remove [rotator]
    2 calibrate reference.toml -o new.h5
        "rotator.reference" is channel "r", which has no angle; set channel.r.polariser_deg
    2 calibrate two_zeros.toml -o new.h5
        "rotator.reference" already sets the zero of the scale; remove it or "rotator.offset_deg"
    1 calibrate lab/MEASUREMENTS.toml -o folder
        folder is a folder; choose a file
    1 calibrate lab/MEASUREMENTS.toml -o raw.tif/new.h5
        raw.tif is a file, not a folder; choose an output other than
    2 calibrate lab/MEASUREMENTS.toml -o new.toml
        .toml is for recipes; choose an output
    3 calibrate lab/MEASUREMENTS.toml -o new.h5 --truth table.h5
        table.h5 contains a transform table; use a file written by
    2 simulate camera.toml --camera scenes.toml -o new.h5
        scenes.toml is a scene recipe; use a camera recipe
    2 simulate lab/MEASUREMENTS.toml --camera camera.h5 -o new.h5
        is a measurement file; use a scene recipe
    2 simulate scenes.toml --camera lab/MEASUREMENTS.toml -o new.h5
        is a measurement file; use a camera recipe
    2 simulate classes.toml --camera camera.h5 -o new.h5
        classes.toml is a class recipe; use a scene recipe
    3 simulate scenes.toml --camera table.h5 -o new.h5
        table.h5 contains a transform table; use a file written by
    3 simulate scenes.toml --camera raw.tif -o new.h5
        raw.tif is not an HDF5 file; use a file written by
    3 simulate scenes.toml --camera folder -o new.h5
        folder is a folder; use a file written by
    2 simulate scenes.toml -o new.h5
        Missing option '--camera'
    2 simulate empty.toml --camera camera.h5 -o new.h5
        empty.toml: the recipe contains no scenes
    2 simulate scenes.toml --camera camera.h5 -o camera.h5 --force
        camera.h5 is an input; choose another output
    1 simulate scenes.toml --camera camera.h5 -o new.h5 --pictures raw.tif
        raw.tif is a file; choose a folder
    2 simulate sized.toml --camera camera.h5 -o new.h5
        unknown key `size` in [scene[2]] with source = "iset"; use one of source, crop, flip
    2 train training.h5 --classes scenes.toml -o new.h5
        scenes.toml is a scene recipe; use a class recipe
    3 train training.h5 --classes camera.h5 -o new.h5
        camera.h5 is not a text file; use a class recipe
    3 train scenes.toml -o new.h5
        scenes.toml is not an HDF5 file; use a file written by
    3 train camera.h5 -o new.h5
        camera.h5 contains a camera model; use a file written by
    3 train empty.h5 -o new.h5
        empty.h5 is not an HDF5 file; use a file written by
    3 train nothing.h5 -o new.h5
        nothing.h5 does not exist; create it with "l3 simulate"
    2 train training.h5 -o training.h5 --force
        training.h5 is an input; choose another output
    3 train --merge table.h5 -o new.h5
        table.h5 contains a transform table; use a file written by
    3 render raw.tif table.h5 -o new.png
        raw.tif is not an HDF5 file; use a file written by "l3 train"
    3 render training.h5 raw.tif -o new.png
        training.h5 contains a training set; use a file written by
    3 render table.h5 table.h5 -o new.png
        table.h5 contains a transform table, not raw frames; use a camera raw, a TIFF or PNG file
    3 render table.h5 camera.h5 -o new.png
        camera.h5 contains a camera model, not raw frames; use a camera raw, a TIFF or PNG file
    3 render table.h5 training.h5 -o new.png
        training.h5 contains a training set, not raw frames; use a camera raw, a TIFF or PNG file
    3 render table.h5 picture.png -o new.png
        picture.png has 3 channels
    3 render table.h5 camera.toml -o new.png
        use a camera raw, a TIFF or PNG file with one channel
    3 render table.h5 empty.tif -o new.png
        empty.tif is not a picture
    3 render table.h5 folder -o new.png
        folder contains no raw frames; use a folder with
    3 render table.h5 nothing.tif -o new.png
        nothing.tif does not exist; use a raw file
    3 render table.h5 cut.raw -o new.png
        specify the layout with --size ROWSxCOLS, --packing, --stride and --skip
    2 render table.h5 cut.raw -o new.png --packing PolarizedStokes_S0_S1_S2_Mono8
        values that the camera computed from its raw values; record raw frames in a format such as PolarizeMono12p
    2 render table.h5 raw.tif
        Missing option '-o'
    2 render table.h5 -o new.png
        Missing argument 'INPUT...'
    2 render table.h5 raw.tif -o new.jp2
        has the unsupported suffix ".jp2"; use .png
    2 render table.h5 raw.tif -o raw.tif --force
        raw.tif is an input; choose another output
    1 render table.h5 raw.tif -o raw.tif/new.png
        raw.tif is a file, not a folder
    3 render table.h5 raw.tif -o new.png --white-level 5
        set --black-level and --white-level
    2 render table.h5 raw.tif -o new.png --white D651
        illuminant "D651" is unknown; did you mean "D65"
    2 render table.h5 raw.tif -o new.png --space acescg
        write an .exr file, or a .tif file with --bits 32
    2 render table.h5 raw.tif -o new.tif --space xyz --bits 16
        linear
    2 render table.h5 raw.tif -o new.png --bits 32
        new.png: .png files have 8 or 16 bits per value, not 32; use .tif or .exr
    2 render table.h5 raw.tif -o new.mp4 --bits 32
        write a .tif or .exr
    2 render table.h5 raw.tif -o new.mp4 --space rec2020
        videos are always sRGB; remove --space
    2 render table.h5 raw.tif -o new.exr --white A
        --space
    2 render table.h5 raw.tif -o new.png --space sRGB
        did you mean "srgb"?
    2 render table.h5 raw.tif -o new.dng --space srgb
        remove --space
    2 render table.h5 raw.tif -o new.dng --bits 32
        remove --bits
    2 render table.h5 raw.tif -o new.png --remosaic bayer
        write a .dng
    2 render table.h5 raw.tif -o new.mp4 --remosaic bayer
        write a .dng
    2 render table.h5 raw.tif -o new.dng --remosaic xtrans
        bayer
    2 render table.h5 raw.tif -o new.mp4 --bits 16
        --codec h265
    2 render table.h5 raw.tif -o new.mp4 --codec ffv1
        use a file name that ends in .mkv
    2 render table.h5 raw.tif -o new.y4m --codec h264
        not compressed
    2 render table.h5 raw.tif -o new.mp4 --preset best
        --preset
    2 render table.h5 raw.tif -o new.mkv --codec vp9
        vp9
    2 render table.h5 raw.tif -o new.png --white 30,40,0
        2…1000 pixels
    2 render table.h5 raw.tif -o new.png --white 30,40,2.5
        whole pixels
    2 render table.h5 raw.tif -o new.png --white -3,40
        0…1000000 pixels
    2 render table.h5 raw.tif -o new.png --white 2,1,1,1.5
        has 4 multipliers; set one for each of the channels r, g, b
    2 render table.h5 raw.tif -o new.png --white 2.1,0,1.4
        0.05…20
    2 render table.h5 raw.tif -o new.png --white 2.1,nan,1.4
        not a number
    3 render table.h5 raw.tif -o new.png --white 5000,5000
        extends beyond the picture (160×240 pixels)
    3 render table.h5 raw.tif -o new.png --white camera
        contains no white balance
    3 render table.h5 grey.npy -o new.png --white chart
        no ColorChecker with 4×6 patches found
    3 render table.h5 text.pgm -o new.png
        in text form
    3 render table.h5 colours.pgm -o new.png
        not a binary PGM
    3 render table.h5 cut.pgm -o new.png
        truncated
    3 render table.h5 long.pgm -o new.png
        too long
    3 render table.h5 zero.pgm -o new.png
        invalid header
    3 render table.h5 above.pgm -o new.png
        maximum of 9
    3 render table.h5 text.fits -o new.png
        cannot be decoded
    2 render table.h5 raw.tif -o new.png --backend opencll
        did you mean "opencl"?
    2 render table.h5 raw.tif -o new.mp4 --codec h256
        did you mean "h265" or "h264"?
    2 render table.h5 raw.tif -o new.png --tone acess
        '--tone': 'acess'; did you mean "aces"?
    2 render table.h5 raw.tif -o new.png --phase 1
        "1" does not have the form ROW,COL
    3 evaluate training.h5 table.h5
        training.h5 contains a training set; use a file written by
    3 evaluate table.h5 camera.h5
        camera.h5 contains a camera model; use a file written by
    1 evaluate table.h5 unseen.h5 --pictures raw.tif
        raw.tif is a file; choose a folder
    3 report table.h5 raw.tif -o new.html
        raw.tif is not an HDF5 file; use a file written by
    2 report table.h5 -o new.pdf
        use a file name that ends in .html
    1 report table.h5 -o raw.tif/new.html
        raw.tif is a file, not a folder
    3 compare table.h5
        table.h5 is not a JSON file; use a file that contains the output of "l3 evaluate --json"
    3 compare nothing.json
        nothing.json does not exist; use a file
    3 compare folder
        folder is a folder; use a file
    3 compare empty.json
        use the output of "l3 evaluate --json"
    2 info
        specify either a FILE or --version
    3 info scenes.toml
        scenes.toml is not an HDF5 file; use a file written by
    3 info folder
        folder is a folder; use a file written by
    2 lab scenes.toml -o new
        scenes.toml is a scene recipe; use a camera recipe
    2 lab camera.toml --recipe scenes.toml -o new
        scenes.toml is a scene recipe; use a lab recipe
    3 lab table.h5 -o new
        table.h5 contains a transform table; use a file written by
    1 lab camera.toml -o raw.tif
        raw.tif is a file, not a folder
    1 lab camera.toml -o lab
        MEASUREMENTS.toml exists; add --force
    2 report table.h5 unseen.h5 --at "5 lux" -o new.html
        unseen.h5 has no frame at --at 5 lux; choose one of its illuminances: 314 lux
    2 report table.h5 unseen.h5 --at 5 -o new.html
        "5" has no unit; add lux or cd/m2, as in "5 lux"
    2 report table.h5 unseen.h5 --at "dim lux" -o new.html
        "dim" is not a number; use a number within
    2 init byer new
        no recipe "byer"; did you mean "bayer"?
    1 init bayer raw.tif
        raw.tif is a file; choose a folder
    2 calibrate -o new.h5
        --photo
    2 calibrate lab/MEASUREMENTS.toml --light A -o new.h5
        remove --light
    2 calibrate lab/MEASUREMENTS.toml --camera bayer -o new.h5
        --camera works only with --draft
    2 calibrate --draft lab -o new.h5
        ends in .toml
    3 calibrate --draft nothing -o new.toml
        nothing is not a folder
    3 calibrate --draft folder -o new.toml
        folder contains no raw frame
    3 calibrate --draft lab/spectra -o new.toml
        neither a sweep nor responsivities; add a table
    2 calibrate --draft lab -o new.toml --photo a.dng
        remove --photo
    2 calibrate --draft lab lab/MEASUREMENTS.toml -o new.toml
        remove MEASUREMENTS.toml
    2 calibrate --draft lab --camera fiveband -o new.toml
        but the frames have
    2 simulate scenes.toml --camera camera.h5 -o new.h5 --tls-ca raw.tif --tls-cert raw.tif --tls-key raw.tif
        need --scheduler
    2 simulate scenes.toml --camera camera.h5 -o new.h5 --scheduler tcp://127.0.0.1:1 --jobs 2
        remove --jobs
    2 simulate scenes.toml --camera camera.h5 -o new.h5 --scheduler 127.0.0.1:8786
        is not a scheduler address
    2 simulate scenes.toml --camera camera.h5 -o new.h5 --scheduler tls://127.0.0.1:1
        needs --tls-ca, --tls-cert and --tls-key
    2 train training.h5 --classes level.toml -o new.h5
        unknown key `level` in [classes]
    2 train training.h5 --classes levels.toml -o new.h5
        more levels than distinct values
    2 train training.h5 --shares 1,2 -o new.h5
        --shares contains 2 values, but the number of training sets is 1
    2 train training.h5 --shares 0 -o new.h5
        set at least one above zero
    2 train training.h5 --shares 1e999 -o new.h5
        the nearest valid value is 1e+06
    2 train training.h5 --shares x -o new.h5
        is not a number
    2 train training.h5 --shares "" -o new.h5
        separate the numbers by commas, for example 1,0.7,0.4
    2 train training.h5 --shard 4/3 -o new.h5
        use a shard from 1/3 to 3/3
    2 train training.h5 --shard 3 -o new.h5
        does not have the form I/N
    3 train training.h5 --shard 1/3 --first table.h5 -o new.h5
        is not the table of the first pass
    2 train training.h5 --first table.h5 -o new.h5
        --first works only with --shard
    2 train --merge training.h5 --shard 1/3 -o new.h5
        --merge reads classes
    2 train --merge training.h5 --shares 1 -o new.h5
        --merge reads classes
    3 train --merge training.h5 -o new.h5
        training.h5 contains a training set; use a file written by
    2 render table.h5 raw.tif -o new.jpg --bits 16
        8 bits
    2 render table.h5 raw.tif -o new.png --exposure +1
        write +1EV for 1 EV more than auto, or 1 to multiply Y by this factor
    2 render table.h5 raw.tif -o new.png --exposure -1
        auto, camera, and EV relative to auto, such as -1EV
    2 render table.h5 raw.tif -o new.png --exposure 30EV
        -20…20 EV
    2 render table.h5 raw.tif -o new.png --size 3x-4
        ROWSxCOLS
    2 render table.h5 raw.tif -o new.png --backend reference --variant graphics
        --variant applies only to the backend opencl
    2 render table.h5 raw.tif -o new.exr --hot yes
        auto
    3 render table.h5 raw.tif -o new.exr --camera camera.h5
        set --camera to the camera that took the frame
    3 render table.h5 raw.tif -o new.exr --camera nothing.h5
        nothing.h5 does not exist
    2 render table.h5 raw.tif -o new.png --uncertainty new.tif
        .exr
    2 render table.h5 frames -o new.mp4 --bits 32
        videos cannot store 32 bits
    2 render table.h5 raw.tif picture.png -o new --format gif
        unsupported suffix
    2 render table.h5 raw.tif - -o new
        stdin cannot be combined with other inputs
    2 evaluate
        or --sequence
    2 evaluate table.h5
        or --sequence
    2 evaluate table.h5 --sequence unseen
        cannot be combined with TABLE.h5
    2 evaluate --sequence unseen --viewing 60
        --viewing cannot be used with --sequence
    3 evaluate --sequence nothing
        nothing does not exist
    3 evaluate --sequence folder
        folder contains no pictures
    3 evaluate --sequence picture.png
        single file
    3 compare list.json
        not a result of l3 evaluate
    2 export table.h5 -o new --set low-noise
        has only one set of transforms; remove --set
    2 export table.h5 -o new --to folder --set low-noise
        a folder of arrays contains both sets; remove --set
    2 export table.h5 -o new --prefix 1
        use a letter from a to z
    2 export table.h5 -o new --prefix test
        reserved for the test program
    2 export table.h5 -o new --to folder --prefix eye
        --prefix applies only to C source
    2 export table.h5 -o new --to folder --words int16
        --words applies only to C source
    2 export camera.h5 -o new --words int16
        --words works only for transform
    2 export table.h5 -o new --words half
        'half'; use one of float32, int16
    2 export camera.h5 -o new --to c
        --to works only for transform tables
    2 export table.h5 -o new --to halide
        'halide'; use one of c, folder
    3 export training.h5 -o new
        cannot be exported; use a camera model, a camera recipe or a transform table
    1 export table.h5 -o raw.tif
        raw.tif is a file; choose a folder
    2 design classes.toml -o new.h5
        --moments
    3 check nothing.toml
        nothing.toml does not exist
    3 check folder
        folder contains no recipes
    2 check fivebnd
        did you mean "fiveband"
    2 check
        Missing argument
    2 init bayer
        "l3 init bayer bayer"
    2 init zzz new
        fiveband, from_curves, monno
    1 init bayer lab
        lab is not empty; add --force
    2 init bayer new more
        "more" is not expected
    2 init bayer new --light A
        specify the raw files with --from
    2 init bayer new --phase 0,1
        --phase works only with raw files
    3 init --from folder new
        folder contains no raw files
    3 init --from nothing.dng new
        nothing.dng does not exist
    4 bench --device nvdia --quiet
        no OpenCL device is called "nvdia"
"""
CASES = re.findall(r"^    (\d) (.+)\n {8}(.+)$", MISTAKES, re.MULTILINE)


RAW_FILES = {
    "cut.raw": bytes(1001),
    "text.pgm": b"P2\n2 1\n9\n1 2\n",
    "colours.pgm": b"P6 1 1 255\nabc",
    "cut.pgm": b"P5 2 2 255\nabc",
    "long.pgm": b"P5 2 2 255\nabcde",
    "zero.pgm": b"P5 0 2 255\n",
    "above.pgm": b"P5 2 1 9\n\x01\x0a",
    "text.fits": b"nothing",
}
TURNED = "".join(f'[[polariser]]\nframes = ["a.tif"]\nexposure_s = 0.01\nangle_deg = {angle}\n' for angle in (0, 60, 120))
MEASUREMENTS = {  # what is replaced in the measurement file, by the file with the mistake
    "no_pitch": ("pixel_pitch_um = 4.0\n", ""),
    "bits": ("bits = 12", "bits = 99"),
    "broken": ("[sensor]", "[sensor"),
    "two_kinds": ("[sensor]", '[curves]\nfile = "x.csv"\n[sensor]'),
    "rotator": ("[sensor]", "[rotator]\nextinction = 1000\n[sensor]"),
    "reference": ("[sensor]", f'{TURNED}[rotator]\nreference = "r"\n[sensor]'),
    "two_zeros": ("[sensor]", f'{TURNED}[rotator]\nreference = "r"\noffset_deg = 3\n[sensor]'),
}


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
    (folder / "list.json").write_text("[1]")
    (folder / "level.toml").write_text("[classes]\nlevel = 3\n")
    (folder / "levels.toml").write_text("[classes]\nlevels = 50000\n")
    grey = '[[scene]]\nsource = "grey ramp"\nsize = [32, 48]\n'
    (folder / "sized.toml").write_text(f'{grey}[[scene]]\nsource = "iset"\nfile = "face.mat"\nsize = [32, 48]\n')
    np.save(folder / "grey.npy", np.full((64, 64), 300, np.uint16))
    for name, content in RAW_FILES.items():
        (folder / name).write_bytes(content)
    measurements = (pipeline / "lab/MEASUREMENTS.toml").read_text()
    for name, (old, new) in MEASUREMENTS.items():
        assert old in measurements
        (folder / f"{name}.toml").write_text(measurements.replace(old, new, 1))
    (folder / "folder").mkdir()
    return folder


@pytest.mark.parametrize(("code", "call", "words"), CASES, ids=[call for _, call, _ in CASES])
def test_a_mistake_is_one_line_with_the_cure(
    code: str, call: str, words: str, desk: Path, refused: Refused, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(desk)
    before = {path: path.lstat().st_mtime_ns for path in desk.rglob("*")}
    assert words in refused(int(code), *shlex.split(call))
    assert {path: path.lstat().st_mtime_ns for path in desk.rglob("*")} == before


def test_a_device_that_is_not_there_is_named(desk: Path, refused: Refused, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("L3_DEVICE", "nvdia")
    monkeypatch.chdir(desk)
    line = refused(4, "render", "table.h5", "raw.tif", "-o", "new.png")
    assert 'no OpenCL device is called "nvdia"; set --device or L3_DEVICE to one of 0: ' in line


def test_a_folder_that_may_not_be_written_is_named_before_any_work(
    pipeline: Path, tmp_path: Path, refused: Refused, monkeypatch: pytest.MonkeyPatch
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
        assert f"{locked} is not writable; choose an output" in refused(1, *call)


SHAPE = (64, 100)


@pytest.fixture
def table(bayer: CameraModel, tmp_path: Path) -> Path:
    save(dataclasses.replace(colorimetric_table(bayer), exposure=0.02), tmp_path / "table.h5")
    return tmp_path / "table.h5"


def test_one_line_of_each(l3: L3, table: Path, bayer: CameraModel, tmp_path: Path) -> None:
    row, col = np.indices(SHAPE)
    light = (0.4 + 0.3 * np.sin(col / 8) + 0.2 * np.cos(row / 30)) * (bayer.white_level - bayer.black_level)
    values = np.rint(bayer.black_level + light).astype("<u2")
    values.tofile(tmp_path / "a.raw")
    values.byteswap().tofile(tmp_path / "b.raw")
    right, exchanged = "{}x{}".format(*SHAPE), "{1}x{0}".format(*SHAPE)

    def warnings(name: str, *options: object) -> list[str]:
        call = ("render", table, tmp_path / name, "-o", tmp_path / "a.png", "--backend", "reference", "--force", *options)
        code, _, err = l3(*call)
        assert code == 0
        return [line for line in err.splitlines() if "classes" not in line and "clipped" not in line]

    timed = ("--exposure-time", 0.02)
    assert warnings("a.raw", "--size", right, *timed) == []
    (torn,) = warnings("a.raw", "--size", exchanged, *timed)
    assert torn.endswith(f"did you mean --size {right} (rows first)?")
    (swapped,) = warnings("b.raw", "--size", right, *timed)
    assert swapped.endswith("the file was probably read in the wrong format; read it with --byte-order big")
    (long,) = warnings("a.raw", "--size", right, "--exposure-time", 20)
    assert long.startswith("warning: --exposure-time 20 means 20 seconds (1000 times the training mean of 0.02 s)")
    assert long.endswith("set the time in seconds, not milliseconds")


TWIN = bayer_camera()
OTHERS = {  # what is changed in the recipe, and what is said of it
    "colour": ("centre_nm = 600", "centre_nm = 640", "ΔE00"),
    "sensitivity": ("f_number = 2.8", "f_number = 4.0", "sensitivity by a factor of 0.49"),
    "noise": ("read_noise_e = 4.0", "read_noise_e = 12.0", "noise by a factor of 2."),
}


@pytest.fixture(scope="module")
def frames(pipeline: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A set of unseen frames of other cameras, all of which bear the same name, beside their recipes."""
    folder, artifacts = tmp_path_factory.mktemp("others"), {}
    (folder / "scenes.toml").write_text('exposure_share = [0.8]\n[[scene]]\nsource = "grey ramp"\nsize = [32, 48]\n')
    for name, (old, new, _) in OTHERS.items():
        assert old in TWIN
        (folder / f"{name}.toml").write_text(TWIN.replace(old, new))
        artifacts[name] = folder / f"{name}.h5"
        call = ["simulate", folder / "scenes.toml", "--camera", folder / f"{name}.toml", "-o", artifacts[name], "--quiet"]
        assert name == "noise" or run([str(word) for word in call]) == 0
    return artifacts


def test_frames_of_another_camera_are_warned_of(pipeline: Path, frames: dict[str, Path], l3: L3) -> None:
    camera = load_camera(pipeline / "camera.toml")
    for name, (_, _, words) in OTHERS.items():
        assert words in camera_differences(camera, load_camera(frames[name].with_suffix(".toml")))
    call = ("evaluate", pipeline / "table.h5", frames["colour"], "--json")
    code, out, err = l3(*call)
    assert code == 0
    assert err.count("\n") == 1
    assert "table.h5 was trained for camera" in err
    assert OTHERS["colour"][2] in err
    assert json.loads(out)["frames"]
    assert l3(*call, "--quiet")[2] == ""


def test_frames_with_other_channels_are_refused(
    pipeline: Path, bayer: CameraModel, fiveband: CameraModel, tmp_path: Path, refused: Refused
) -> None:
    frames = a_set(tmp_path / "five.h5", fiveband, 1)
    assert "different CFAs" in refused(3, "evaluate", pipeline / "table.h5", frames)
    assert camera_differences(bayer, fiveband) == "channels (r, g, b; r, g, b, o, c)"


def test_the_camera_measured_or_described_is_the_same(pipeline: Path, l3: L3) -> None:
    assert l3("evaluate", pipeline / "table.h5", pipeline / "unseen.h5", "--json")[2] == ""
    one, other = load_camera(pipeline / "camera.toml"), load(CameraModel, pipeline / "camera.h5")
    assert colour_difference(one, other) < 0.3
    assert noise_ratio(one, other) == pytest.approx(1, abs=0.05)


def test_what_two_calibrations_differ_by_is_no_other_camera(bayer: CameraModel) -> None:
    moved = np.array([np.interp(bayer.wavelength - 1.0, bayer.wavelength, curve) for curve in bayer.responsivity])
    again = dataclasses.replace(bayer, name="B", responsivity=moved * np.array([1.05, 1.03, 1.02])[:, None])
    again = dataclasses.replace(again, noise=dataclasses.replace(bayer.noise, read_noise=4.4), gain=bayer.gain * 1.02)
    assert 0.1 < colour_difference(bayer, again) < MAX_DELTA_E
    assert camera_differences(bayer, again) == camera_differences(again, bayer) == ""
    assert "colours" in camera_differences(bayer, dataclasses.replace(bayer, responsivity=bayer.responsivity[[1, 0, 2]]))


def test_a_table_that_does_not_hold_its_camera_knows_its_sensitivity(
    pipeline: Path, frames: dict[str, Path], tmp_path: Path, l3: L3
) -> None:
    table = load(TransformTable, pipeline / "table.h5")
    assert table.camera is not None
    assert table.camera.fit is None
    with pytest.raises(ValueError, match="different channels or CFAs"):
        dataclasses.replace(table, camera=dataclasses.replace(table.camera, cfa=table.cfa[::-1]))
    save(dataclasses.replace(table, camera=None), tmp_path / "old.h5")
    assert l3("evaluate", tmp_path / "old.h5", pipeline / "unseen.h5", "--json")[2] == ""
    assert "factor of 0.49" in l3("evaluate", tmp_path / "old.h5", frames["sensitivity"], "--json")[2]


def test_a_report_states_it_too(pipeline: Path, frames: dict[str, Path], tmp_path: Path, l3: L3) -> None:
    out = ("-o", tmp_path / "report.html", "--force", "--backend", "reference")
    code, _, err = l3("report", pipeline / "camera.h5", pipeline / "table.h5", frames["colour"], *out)
    assert code == 0
    assert "warning: table.h5 was trained for camera" in err
    page = (tmp_path / "report.html").read_text()
    assert page.count("table.h5 was trained for camera") == 2  # above all, and above the evaluation
    save(load_camera(frames["noise"].with_suffix(".toml")), tmp_path / "noisy.h5")
    for first in ("table.h5", "camera.h5", "unseen.h5"):
        err = l3("report", pipeline / first, tmp_path / "noisy.h5", *out)[2]
        assert "noisy.h5" in err
        assert "are for different cameras" in err
        assert "different cameras" not in l3("report", pipeline / first, pipeline / "camera.h5", *out)[2]
