"""`l3 init --from`: cameras from raw files, and a picture of the raw file from the created folder."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import AnalogGains, CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.calibration.photo.estimate import WAVELENGTH
from l3cli.calibration.photo.recipe import gains_of
from l3cli.export.profiles import light_matrices
from l3cli.frames.measurement import Stated
from l3cli.io.pictures.dng import write_dng
from l3cli.io.raw.files import read_raw
from l3cli.physics import spectra
from l3cli.recipes.builtin import COMMON, find_recipe
from l3cli.recipes.toml import parse_toml
from tests.helpers import dng_files, photos
from tests.helpers.calls import L3, Refused

XTRANS = np.array([[1, 0, 1, 1, 2, 1], [2, 1, 2, 0, 1, 0], [1, 0, 1, 1, 2, 1]] * 2)
SRATIONAL, ASCII = 10, 2
IDENTITY = {"A": np.eye(3), "D65": np.eye(3)}


def scene(camera: CameraModel, seed: int = 0) -> np.ndarray:
    """A raw frame of a slope and its noise, without a chart."""
    rng = np.random.default_rng(seed)
    slope = np.linspace(0.1, 0.6, 128)[:, None] * np.linspace(0.5, 1.0, 160)
    electrons = rng.poisson(slope * (camera.white_level - camera.black_level) / camera.gain)
    return np.rint(camera.black_level + camera.gain * electrons).astype(np.uint16)


@pytest.fixture(scope="module")
def photo(bayer: CameraModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A DNG of the small Bayer camera with its matrices and noise profile."""
    path = tmp_path_factory.mktemp("photo") / "photo.dng"
    found = {light: light_matrices(bayer, light) for light in ("A", "D65")}
    matrices = {light: each.colour.values for light, each in found.items() if each}
    write_dng(path, scene(bayer), bayer, matrices, None, 0.01)
    return path


def responses(camera: CameraModel, light: str) -> np.ndarray:
    """(surface, channel) of a ColorChecker over those of a white."""
    seen = spectra.illuminant(light, camera.wavelength) * camera.responsivity
    shares: np.ndarray = spectra.colorchecker(camera.wavelength)[1] @ seen.T / seen.sum(axis=1)
    return shares


def test_a_photo_without_a_table_gets_the_commands_that_lead_to_its_picture(
    photo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, l3: L3, refused: Refused
) -> None:
    monkeypatch.chdir(tmp_path)
    named = tmp_path / "my photo.dng"
    shutil.copy(photo, named)
    line = refused(2, "render", named.name, "-o", "p.png").strip()
    assert line.startswith("l3: my photo.dng is a raw file, but l3 render also needs a table")
    commands = line.partition("then render: ")[2]
    first, make, then = (shlex.split(each) for each in re.split(" && |; ", commands))
    assert l3(*first[1:])[0] == 0
    assert make == ["make", "-C", "mine", "table.h5"]
    assert "\ntable.h5: " in (tmp_path / "mine/Makefile").read_text()
    assert then == ["l3", "render", "mine/table.h5", "my photo.dng", "-o", "p.png"]
    assert named.name in refused(2, "render", named, photo, "-o", "p.png")
    twice = refused(2, "render", named.name, f"./{named.name}", "-o", "p.png")  # the photo in place of the table, too
    assert "l3 render mine/table.h5 'my photo.dng' -o p.png" in twice
    (tmp_path / "table.h5").touch()
    swapped = refused(2, "render", "my photo.dng", "table.h5", "-o", "p.png")
    assert "write the table before the raw files: l3 render table.h5 'my photo.dng' -o p.png" in swapped
    assert "missing.dng" in refused(3, "render", "missing.dng", "-o", "p.png")
    assert "--photo" in refused(2, "calibrate", named, "-o", "camera.h5")


def test_a_camera_by_its_matrices_and_noise_profile(bayer: CameraModel, photo: Path, tmp_path: Path, l3: L3) -> None:
    folder = tmp_path / "mine"
    code, out, err = l3("init", "--from", photo, folder)
    assert (code, out) == (0, "")
    assert err.count("\n") == 1
    assert "curves from the colour matrices for A and D65" in err
    assert "noise from the noise profile of the file" in err
    assert "assumed: peak efficiency, pixel pitch;" in err
    assert f"make -C {folder} picture.png; to render another photo: l3 render {folder}/table.h5 RAW -o PICTURE.png" in err
    camera = load_camera(folder / "camera.toml")
    assert (camera.name, camera.channels, camera.bits) == ("l3cli small Bayer", ("r", "g", "b"), 12)
    assert (camera.rows, camera.cols) == (128, 160)
    assert (camera.black_level, camera.white_level) == (bayer.black_level, bayer.white_level)
    np.testing.assert_array_equal(camera.cfa, bayer.cfa)
    assert camera.gain == pytest.approx(bayer.gain, rel=0.05)
    assert camera.noise.read_noise == pytest.approx(bayer.noise.read_noise, rel=0.5)  # with what else does not grow
    assert camera.optics.f_number == bayer.optics.f_number
    assert camera.optics.focal_length == bayer.optics.focal_length
    for light in ("A", "D65"):
        assert np.abs(responses(camera, light) - responses(bayer, light)).max() < 0.03
    assert "pixel_pitch_um = 5 # assumed" in (folder / "camera.toml").read_text()
    for name, text in {"Makefile": "CAMERA ?= camera.toml", "slurm.sh": "${CAMERA:-camera.toml}"}.items():
        assert text in (folder / name).read_text()
    assert os.access(folder / "slurm.sh", os.X_OK)


def test_a_camera_at_several_iso_speeds(bayer: CameraModel, tmp_path: Path, l3: L3) -> None:
    """The lowest is that of its figures; read noise at the others is as their noise profiles say, and a table is learned for
    all of them, which renders each file by the transforms for its gain."""
    noise = replace(bayer.noise, read_noise=4.0, prnu=0.0, dsnu=0.0, column_noise=0.0)
    camera = replace(bayer, noise=noise, gains=AnalogGains(np.array([4.0, 16.0]), np.array([2.0, 1.0]), 200.0))
    (tmp_path / "taken").mkdir()
    for gain, name in ((16.0, "a"), (1.0, "b"), (4.0, "c")):
        there = camera.at_gain(gain)
        write_dng(tmp_path / f"taken/{name}.dng", scene(there), there, IDENTITY, None, 0.01 / gain)
    code, _, err = l3("init", "--from", tmp_path / "taken", tmp_path / "mine")
    assert code == 0, err
    made = load_camera(tmp_path / "mine/camera.toml")
    assert made.gains is not None
    assert (made.gains.iso, made.gains.analog_gain.tolist()) == (200, [4, 16])
    assert made.gain == pytest.approx(camera.gain, rel=0.05)
    np.testing.assert_allclose(made.gains.gain_read_noise, [2.0, 1.0], rtol=0.05)
    assert l3("check", tmp_path / "mine/classes.toml")[0] == 0
    assert read_raw(tmp_path / "taken/a.dng", made).gain == 16
    assert [path.resolve().name for path in (tmp_path / "mine").glob("picture.*")] == ["b.dng"]
    lowest = Stated("some", (), (1e-4, 1e-8), 100.0, None, None, None)
    assert gains_of(lowest, [replace(lowest, iso=iso) for iso in (100.0, 400.0, 102400.0)]) == ((4.0, pytest.approx(1.0)),)


def test_its_folder_makes_a_picture_of_the_photo(photo: Path, tmp_path: Path, l3: L3) -> None:
    folder = tmp_path / "mine"
    assert l3("init", "--from", photo, folder, "--quiet")[0] == 0
    assert {path.name for path in folder.iterdir()} == {*COMMON, "camera.toml", "curves.csv", "picture.dng"}
    environment = {name: value for name, value in os.environ.items() if name not in ("MAKEFLAGS", "MAKELEVEL")}
    dry = ["make", "--dry-run", "-C", str(folder), f"L3={sys.executable} -m l3cli", "picture.png"]
    steps = subprocess.run(dry, text=True, capture_output=True, check=True, env=environment).stdout
    assert [line.split()[3] for line in steps.splitlines() if " -m l3cli " in line] == [
        *("simulate", "train", "render", "train", "render")
    ]
    assert "render table.h5 picture.dng -o picture.png" in re.sub(" +", " ", steps)
    assert (folder / "picture.dng").samefile(photo)
    assert l3("check", folder / "camera.toml")[0] == 0


WALL = np.array([1.0, 0.7, 0.3])  # channels of a grey under a lamp


def wall(camera: CameraModel, top: int, left: int) -> np.ndarray:
    """A raw frame of a wall from dark to bright under a lamp, without its first rows and columns."""
    lit = np.linspace(0, 3000, camera.cols + 2) * WALL[np.tile(camera.cfa, (camera.rows // 2 + 1, camera.cols // 2 + 1))]
    noise = np.random.default_rng(0).normal(0, 3, lit.shape)
    return np.rint(256 + lit + noise).astype(np.uint16)[top : top + camera.rows, left : left + camera.cols].copy()


def test_an_array_that_the_pixels_belie_is_refused_until_answered(
    bayer: CameraModel, tmp_path: Path, l3: L3, refused: Refused
) -> None:
    camera = replace(bayer, black_level=256.0, white_level=4095.0)
    write_dng(tmp_path / "a.dng", wall(camera, 1, 0), camera, IDENTITY, WALL, 0.01)
    call = ("init", "--from", tmp_path / "a.dng", tmp_path / "mine")
    line = refused(3, *call)
    assert "a.dng: the file states the CFA rg/gb, but with this CFA, pixels of the same channel differ by " in line
    assert line.endswith("set --phase 1,0, or 0,1 (gr/bg) if the colours are wrong, or --phase 0,0 if the file is correct\n")
    assert not (tmp_path / "mine").exists()
    code, _, err = l3(*call, "--phase", "1,0")
    assert code == 0, err
    assert "gb/rg" in err
    assert "--phase 0,0 -o PICTURE.png" in err
    assert "RENDER ?= --phase 0,0\n" in (tmp_path / "mine/Makefile").read_text()
    made = load_camera(tmp_path / "mine/camera.toml")
    assert [[made.channels[site] for site in row] for row in made.cfa] == [["g", "b"], ["r", "g"]]
    write_dng(tmp_path / "b.dng", wall(camera, 1, 1), camera, IDENTITY, WALL, 0.01)
    swapped = refused(3, "init", "--from", tmp_path / "b.dng", tmp_path / "other")
    assert "the file states the CFA rg/gb, but the mean colour" in swapped
    assert "only if the CFA is bg/gr" in swapped
    assert swapped.endswith("set --phase 1,1, or --phase 0,0 if the file is correct\n")
    assert l3(*call, "--phase", "0,0", "--force", "--quiet")[0] == 0
    assert load_camera(tmp_path / "mine/camera.toml").cfa.tolist() == [[0, 1], [1, 2]]
    assert "RENDER ?=\n" in (tmp_path / "mine/Makefile").read_text()


def test_a_black_level_of_0_is_questioned(bayer: CameraModel, tmp_path: Path, l3: L3, refused: Refused) -> None:
    camera = replace(bayer, black_level=0.0, white_level=4095.0)
    write_dng(tmp_path / "a.dng", wall(camera, 0, 0), camera, IDENTITY, WALL, 0.01)
    call = ("init", "--from", tmp_path / "a.dng", tmp_path / "mine")
    code, _, err = l3(*call)
    assert code == 0
    (line,) = [each for each in err.splitlines() if "states a black level of 0" in each]
    seen = int(line.rpartition(" ")[2])
    assert 245 < seen < 260
    assert f"about {seen} DN (white level 4095 DN); if colours look washed out, set --black-level {seen}" in line
    assert "--black-level" in refused(2, *call, "--black-level", "5000", "--force")
    code, _, err = l3(*call, "--black-level", "256", "--force")
    assert (code, "states a black level" in err) == (0, False)
    assert load_camera(tmp_path / "mine/camera.toml").black_level == 256
    assert "RENDER ?= --black-level 256" in (tmp_path / "mine/Makefile").read_text()


def quad_photo(path: Path) -> None:
    """A mosaic of 2×2 pixels behind each filter, whose file states rg/gb."""
    rng, site = np.random.default_rng(0), np.kron(np.array([[0, 1], [1, 2]]), np.ones((2, 2), int))
    light = np.kron(rng.uniform(0.1, 1.0, (16, 20)), np.ones((12, 12)))
    values = 64 + 2000 * light * WALL[np.tile(site, (48, 60))] + rng.normal(0, 3, light.shape)
    tags = {50714: (dng_files.SHORT, [64]), 50717: (dng_files.LONG, [4095])}
    dng_files.write_dng(path, np.rint(values).astype(np.uint16), np.array([[0, 1], [1, 2]]), tags=tags)


@pytest.mark.parametrize("pattern", ["rr gg/rr gg/gg bb/gg bb", "r r g g / r r g g / g g b b / g g b b", "quad_bayer"])
def test_another_array_than_the_stated_is_refused_until_it_is_named(
    tmp_path: Path, l3: L3, refused: Refused, pattern: str
) -> None:
    quad_photo(tmp_path / "a.dng")
    call = ("init", "--from", tmp_path / "a.dng", tmp_path / "mine")
    assert "quad_bayer" in refused(3, *call)
    named: tuple[str, ...] = ("--pattern", pattern)
    if pattern == "quad_bayer":  # the recipe begins with green
        assert "0,2" in refused(3, *call, *named)
        named = (*named, "--phase", "0,2")
    code, _, err = l3(*call, *named)
    assert code == 0, err
    camera = load_camera(tmp_path / "mine/camera.toml")
    written = ["".join(camera.channels[site] for site in row) for row in camera.cfa]
    assert written == ["rrgg", "rrgg", "ggbb", "ggbb"]
    assert "RENDER ?= --phase 0,0\n" in (tmp_path / "mine/Makefile").read_text()
    assert l3("check", tmp_path / "mine")[0] == 0
    assert l3(*call, "--pattern", "rg/gb", "--force")[0] == 0  # it is as the file states


def test_an_array_that_is_none_is_refused(tmp_path: Path, refused: Refused) -> None:
    quad_photo(tmp_path / "a.dng")
    for pattern in ("quad_baier", "rg/g", "/"):
        refused(2, "init", "--from", tmp_path / "a.dng", tmp_path / "mine", "--pattern", pattern)


def test_values_below_the_black_level_are_refused_until_answered(bayer: CameraModel, tmp_path: Path, l3: L3) -> None:
    """10-bit values under the levels of 16 bits."""
    tags = {50714: (dng_files.SHORT, [4096]), 50717: (dng_files.LONG, [65535])}
    values = np.minimum(scene(bayer), 1023)
    dng_files.write_dng(tmp_path / "a.dng", values, np.array([[0, 1], [1, 2]]), tags=tags)
    call = ("init", "--from", tmp_path / "a.dng", tmp_path / "mine")
    code, _, err = l3(*call)
    assert code == 3
    assert "a.dng" in err
    assert l3(*call, "--black-level", "64", "--white-level", "1023")[0] == 0
    camera = load_camera(tmp_path / "mine/camera.toml")
    assert (camera.black_level, camera.white_level, camera.bits) == (64, 1023, 10)
    assert "RENDER ?= --black-level 64.0 --white-level 1023.0\n" in (tmp_path / "mine/Makefile").read_text()


def test_a_camera_without_filters(tmp_path: Path, l3: L3) -> None:
    """LinearRaw of one sample a pixel, and no colour matrix, which such a camera cannot have."""
    light = np.linspace(0.05, 0.6, 96)[:, None] * np.linspace(0.5, 1.0, 128)
    values = np.random.default_rng(0).poisson(10000 * light) * 0.3 + 64
    tags, none = {262: (dng_files.SHORT, [34892])}, (33421, 33422, 50710)
    dng_files.write_dng(tmp_path / "a.dng", np.rint(values).astype(np.uint16), np.array([[0]]), tags=tags, drop=none)
    code, _, err = l3("init", "--from", tmp_path / "a.dng", tmp_path / "mine")
    assert code == 0, err
    camera = load_camera(tmp_path / "mine/camera.toml")
    assert (camera.channels, camera.cfa.tolist(), camera.black_level, camera.white_level) == (("w",), [[0]], 64, 4000)
    shipped = load_camera(find_recipe("mono", "cameras"))
    wanted = np.interp(camera.wavelength, shipped.wavelength, shipped.responsivity[0])
    np.testing.assert_allclose(camera.responsivity[0] / camera.responsivity.max(), wanted / wanted.max(), atol=0.01)
    assert l3("check", tmp_path / "mine")[0] == 0


@pytest.mark.parametrize(("tag", "value"), [(50714, [60, 62, 64]), (50714, [5000])])
def test_a_black_level_that_cannot_be_told_is_given(
    bayer: CameraModel, tmp_path: Path, l3: L3, tag: int, value: list
) -> None:
    tags = {tag: (dng_files.SHORT, value), 50717: (dng_files.LONG, [4095])}
    dng_files.write_dng(tmp_path / "a.dng", scene(bayer), np.array([[0, 1], [1, 2]]), tags=tags)
    call = ("init", "--from", tmp_path / "a.dng", tmp_path / "mine")
    assert l3(*call)[0] == 3
    assert l3(*call, "--black-level", "64")[0] == 0
    assert load_camera(tmp_path / "mine/camera.toml").black_level == 64


def test_a_lens_warp_is_no_matter_of_the_camera_once_it_is_to_be_left(bayer: CameraModel, tmp_path: Path, l3: L3) -> None:
    warp = {51022: dng_files.opcode_list((2, 0, b""))}
    dng_files.write_dng(tmp_path / "a.dng", scene(bayer), np.array([[0, 1], [1, 2]]), tags=warp)
    call = ("init", "--from", tmp_path / "a.dng", tmp_path / "mine")
    assert l3(*call)[0] == 3
    assert l3(*call, "--opcodes", "leave")[0] == 0
    assert "RENDER ?= --opcodes leave\n" in (tmp_path / "mine/Makefile").read_text()


@pytest.mark.parametrize("size", [(480, 640), (96, 128), (64, 96), (300, 100)])
def test_scenes_fit_the_sensor(tmp_path: Path, l3: L3, size: tuple[int, int]) -> None:
    values = np.random.default_rng(0).integers(100, 900, size).astype(np.uint16)
    dng_files.write_dng(tmp_path / "a.dng", values, np.array([[0, 1], [1, 2]]))
    assert l3("init", "--from", tmp_path / "a.dng", tmp_path / "mine")[0] == 0
    code, out, err = l3("check", tmp_path / "mine")
    assert code == 0, out + err
    learned = parse_toml((tmp_path / "mine/scenes.toml").read_text(), "scenes.toml")["scene"]
    for scene_made, (pixels, count) in zip(learned, ((160 * 160, 60), (160 * 160, 6)), strict=True):
        rows, cols = scene_made["size"]
        assert rows <= size[0]
        assert cols <= size[1]
        assert rows * cols * scene_made["count"] >= pixels * count


def test_a_sensor_of_hardly_any_pixels_is_refused(tmp_path: Path, l3: L3) -> None:
    dng_files.write_dng(tmp_path / "a.dng", np.full((40, 60), 900, np.uint16), np.array([[0, 1], [1, 2]]))
    assert l3("init", "--from", tmp_path / "a.dng", tmp_path / "mine")[0] == 3


def test_a_camera_by_the_chart_in_its_photo(bayer: CameraModel, tmp_path: Path, l3: L3) -> None:
    camera = replace(bayer, rows=600, cols=800, black_level=256.0, white_level=4095.0, name="of charts")
    chart = photos.photograph(photos.UPRIGHT, np.random.default_rng(0)) + camera.black_level
    (tmp_path / "taken").mkdir()
    write_dng(tmp_path / "taken/a.dng", scene(camera), camera, IDENTITY, None, 0.01)
    values = np.clip(np.rint(chart), 0, 4095).astype(np.uint16)
    write_dng(tmp_path / "taken/b.dng", values, camera, IDENTITY, None, 0.01)
    code, _, err = l3("init", "--from", tmp_path / "taken", "--light", "D65", tmp_path / "mine")
    assert code == 0, err
    assert "curves of the classic ColorChecker in b.dng, under D65;" in err
    assert "--white D65" in err
    assert "WHITE ?= D65\n" in (tmp_path / "mine/Makefile").read_text()
    code, _, err = l3("init", "--from", tmp_path / "taken/b.dng", tmp_path / "unnamed")
    assert code == 0, err
    assert re.search(r"under an unknown illuminant \(guessed: [^;]*D65 \d+ %", err)
    assert "set the illuminant with --light" in err
    assert "--white" not in err
    assert "WHITE ?= chart\n" in (tmp_path / "unnamed/Makefile").read_text()
    made, truth = load_camera(tmp_path / "mine/camera.toml"), photos.drawn(1)
    light = spectra.illuminant("A", WAVELENGTH)
    for ours, true in zip(made.responsivity, truth, strict=True):
        figures = [photos.REFLECTANCE @ (light * curve) / (light * curve).sum() for curve in (ours, true)]
        assert np.abs(figures[0] - figures[1]).max() < 0.02


def test_noise_of_a_chart_at_another_speed_is_brought_to_that_of_the_recipe(tmp_path: Path, l3: L3) -> None:
    (tmp_path / "taken").mkdir()
    chart = np.clip(np.rint(photos.photograph(photos.UPRIGHT, np.random.default_rng(0)) + 256), 0, 4095).astype(np.uint16)
    for iso, values in ((100, np.full_like(chart, 900)), (400, chart)):
        tags = {34855: (dng_files.SHORT, [iso]), 50714: (dng_files.SHORT, [256]), 50717: (dng_files.LONG, [4095])}
        dng_files.write_dng(tmp_path / f"taken/{iso}.dng", values, np.array([[0, 1], [1, 2]]), tags=tags)
    code, _, err = l3("init", "--from", tmp_path / "taken", "--light", "D65", tmp_path / "mine")
    assert code == 0, err
    assert "in 400.dng, under D65; noise as measured on the patches of the chart" in err
    assert load_camera(tmp_path / "mine/camera.toml").gain == pytest.approx(photos.GAIN / 4, rel=0.1)


def test_a_photo_of_any_name_leads_to_a_recipe(photo: Path, tmp_path: Path, l3: L3) -> None:
    hostile = Path(shutil.copy(photo, tmp_path / 'a"\nname = 1\n[x`touch PWNED`]\x1b$(touch PWNED).dng'))
    code, _, err = l3("init", "--from", hostile, tmp_path / "d'`x`")
    assert code == 0, err
    assert (tmp_path / "d'`x`/picture.dng").samefile(hostile)
    assert l3("check", tmp_path / "d'`x`/camera.toml")[0] == 0
    assert "touch" not in (tmp_path / "d'`x`/Makefile").read_text()
    assert shlex.split(err.partition("next: ")[2].partition(";")[0])[2] == f"{tmp_path}/d'`x`"


def test_the_link_to_the_photo_is_made_again_and_takes_the_place_of_no_photo(photo: Path, tmp_path: Path, l3: L3) -> None:
    mine, left = tmp_path / "mine", shutil.copy(photo, tmp_path / "kept.dng")
    for given in (left, left, mine / "picture.dng"):  # the last is the link itself
        assert l3("init", "--from", given, mine, "--force", "--quiet")[0] == 0
        assert (mine / "picture.dng").readlink() == left
    (mine / "picture.dng").unlink()
    shutil.copy(photo, mine / "picture.dng")
    code, _, err = l3("init", "--from", mine / "picture.dng", mine, "--force")
    assert (code, "is an input" in err) == (2, True)
    assert (mine / "picture.dng").read_bytes() == photo.read_bytes()


def test_a_mixed_folder_is_sorted_by_camera(bayer: CameraModel, photo: Path, tmp_path: Path, l3: L3) -> None:
    taken = tmp_path / "taken"
    taken.mkdir()
    for name in ("1.DNG", "2.dng"):
        shutil.copy(photo, taken / name)
    dng_files.write_dng(taken / "3.dng", scene(bayer), XTRANS, tags={272: (ASCII, list(b"X/T 1\0"))})
    (taken / "4.dng").write_bytes(b"nothing")
    (taken / "5.jpg").write_bytes(b"nothing")
    code, _, err = l3("init", "--from", taken, tmp_path / "all")
    assert code == 0, err
    assert {path.name for path in (tmp_path / "all").iterdir()} == {"l3cli_small_bayer", "x_t_1"}
    lines = err.splitlines()
    assert sum("skipped" in line and "4.dng" in line for line in lines) == 1
    assert sum("next: make" in line for line in lines) == 2
    made = load_camera(tmp_path / "all/x_t_1/camera.toml")
    assert made.cfa.shape == (6, 6) or made.cfa.shape == (3, 6)
    assert "the mean of 52 measured cameras" in (tmp_path / "all/x_t_1/camera.toml").read_text()
    again = ("init", "--from", taken / "1.DNG", taken / "2.dng", tmp_path / "one")  # as a shell expands *.dng
    assert l3(*again)[0] == 0
    assert (tmp_path / "one/camera.toml").is_file()


def test_wrong_calls(photo: Path, bayer: CameraModel, tmp_path: Path, refused: Refused) -> None:
    refused(2, "init", "--from", photo)
    dng_files.write_dng(tmp_path / "other.dng", scene(bayer), np.array([[0, 1], [1, 2]]), tags={272: (ASCII, list(b"X\0"))})
    both = ("init", "--from", photo, tmp_path / "other.dng", tmp_path / "new", "--phase", "0,1")
    assert "--phase" in refused(2, *both)
    assert photo.name in refused(1, "init", "--from", photo, photo)
    (tmp_path / "full").mkdir()
    (tmp_path / "full/mine.txt").write_text("")
    assert "full" in refused(1, "init", "--from", photo, tmp_path / "full")
    assert "D66" in refused(2, "init", "--from", photo, tmp_path / "new", "--light", "D66")
    np.save(tmp_path / "raw.npy", scene(bayer))
    assert "raw.npy" in refused(3, "init", "--from", tmp_path / "raw.npy", tmp_path / "new")
    (tmp_path / "broken.dng").write_bytes(photo.read_bytes()[:2000])
    assert "broken.dng" in refused(3, "init", "--from", tmp_path / "broken.dng", tmp_path / "new")
    magenta = np.array([[3, 4], [5, 3]])
    dng_files.write_dng(tmp_path / "cmy.dng", scene(bayer), magenta, tags={50710: (1, [3, 4, 5])})
    assert "cmy.dng" in refused(3, "init", "--from", tmp_path / "cmy.dng", tmp_path / "new")


@pytest.mark.parametrize(
    "bad", [{50721: (SRATIONAL, [0, 0] * 9)}, {50721: (3, [1])}, {33421: (3, [2, 2]), 272: (ASCII, [7, 0])}]
)
def test_damaged_tags_count_as_none(bad: dng_files.Tags, bayer: CameraModel, tmp_path: Path, l3: L3) -> None:
    dng_files.write_dng(tmp_path / "odd.dng", scene(bayer), np.array([[0, 1], [1, 2]]), tags=bad)
    code, _, err = l3("init", "--from", tmp_path / "odd.dng", tmp_path / "new")
    assert code == 0, err
    assert "the mean of 52 measured cameras" in err
    assert json.loads('"' + load_camera(tmp_path / "new/camera.toml").name + '"')
