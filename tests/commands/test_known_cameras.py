"""`l3 init` of cameras by name: the 52 cameras whose measured curves come with l3."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera_recipe import load_camera
from l3cli.io.curves import ROLES, prior_files, read_cameras
from l3cli.io.known_cameras import known_as, known_cameras, known_curves
from l3cli.recipes.builtin import slug_of
from tests.helpers import dng_files
from tests.helpers.calls import L3, Refused


def test_a_folder_by_name(tmp_path: Path, l3: L3) -> None:
    code, out, err = l3("init", "nikon_d810", tmp_path / "mine")
    assert (code, out) == (0, "")
    assert "measured for rawtoaces" in err
    assert "assumed: peak efficiency, focal length, f-number; next: make -C" in err
    assert "picture.png PHOTO=RAW; to render another" in err
    camera = load_camera(tmp_path / "mine/camera.toml")
    assert (camera.name, camera.rows, camera.cols, camera.bits) == ("Nikon D810", 4912, 7360, 14)
    assert camera.gains is not None
    assert camera.gains.iso == 64
    curves = known_curves("nikon_d810")
    inside = np.interp(camera.wavelength, curves.wavelength, curves.responsivity[1]) * 0.4
    np.testing.assert_allclose(camera.responsivity[1], inside, atol=1e-4)
    assert "CAMERA ?= camera.toml" in (tmp_path / "mine/Makefile").read_text()
    assert camera.gains.analog_gain.tolist() == [4, 16, 64]
    assert l3("check", tmp_path / "mine/camera.toml", tmp_path / "mine/classes.toml")[0] == 0


def test_every_camera_makes_a_recipe(tmp_path: Path, l3: L3) -> None:
    """X-Trans bodies with their array; of those of which little is published the rest is marked as assumed."""
    for name in ("fujifilm_x_t4", "arashi_vision_insta360_x5", "arri_d21"):
        assert l3("init", name, tmp_path / name)[0] == 0
        camera = load_camera(tmp_path / name / "camera.toml")
        assert camera.cfa.shape == ((6, 6) if "x_t4" in name else (2, 2))
    assert "pixel_pitch_um = 5 # assumed" in (tmp_path / "arashi_vision_insta360_x5/camera.toml").read_text()
    for name in known_cameras().camera:
        curves = known_curves(name)
        assert curves.responsivity.max() == 1
        assert (curves.responsivity.max(axis=1) > 0.2).all()
        assert curves.responsivity.argmax(axis=1).tolist() == sorted(
            curves.responsivity.argmax(axis=1).tolist(), reverse=True
        )


def test_the_list_is_searched_by_words(l3: L3, refused: Refused) -> None:
    code, out, _ = l3("init", "--list", "Nikon", "d8", "--json")
    assert code == 0
    assert list(json.loads(out)["cameras"]) == ["nikon_d800e", "nikon_d810", "nikon_d850"]
    assert len(json.loads(l3("init", "--list", "--json")[1])["cameras"]) == 52
    assert "Kiss X7" in l3("init", "--list", "rebel sl1")[1]  # by another name of it
    assert '"l3 init --list" lists 52 more cameras by name' in l3("init")[2]
    assert 'no camera has the name "zeiss"; "l3 init --list"' in refused(2, "init", "--list", "zeiss")
    assert 'no recipe "nikon_d81"; did you mean "nikon_d810" or ' in refused(2, "init", "nikon_d81", "x")


@pytest.mark.parametrize(
    ("stated", "name"),
    [
        ("NIKON CORPORATION NIKON D810", "nikon_d810"),
        ("Canon EOS 5D", "canon_eos_5d"),
        ("Canon EOS 5D Mark III", "canon_eos_5d_mark_iii"),
        ("Canon EOS Kiss X7", "canon_eos_100d"),
        ("SONY ILCE-7RM3A", "sony_ilce_7rm3"),
        ("FUJIFILM X-T3", "fujifilm_x_t3"),
        ("Canon EOS 550D", None),
        ("", None),
    ],
)
def test_makes_and_models_as_raw_files_state_them(stated: str, name: str | None) -> None:
    assert known_as(stated) == name


def test_a_photo_of_a_known_camera_has_its_curves(tmp_path: Path, l3: L3) -> None:
    photo, values = tmp_path / "photo.dng", np.random.default_rng(0).integers(300, 2000, (96, 128))
    names = {271: (2, list(b"NIKON CORPORATION\0")), 272: (2, list(b"NIKON D810\0"))}
    dng_files.write_dng(photo, values.astype(np.uint16), np.array([[1, 0], [2, 1]]), tags=names)
    code, _, err = l3("init", "--from", photo, tmp_path / "mine")
    assert code == 0
    assert "curves of nikon_d810, measured for rawtoaces" in err
    camera, curves = load_camera(tmp_path / "mine/camera.toml"), known_curves("nikon_d810")
    inside = np.interp(camera.wavelength, curves.wavelength, curves.responsivity[0]) * 0.4
    np.testing.assert_allclose(camera.responsivity[camera.channels.index("r")], inside, atol=1e-4)


@pytest.mark.skipif("L3_DATA" not in os.environ, reason="L3_DATA is not set")
def test_shipped_curves_are_those_measured() -> None:
    files = prior_files(Path(os.environ["L3_DATA"]) / "sensitivities/rawtoaces/data/camera")
    names = [slug_of(path.stem.removesuffix("_380_780_5")) for path in files]
    assert sorted(names) == sorted(known_cameras().camera)
    for name, measured in zip(names, read_cameras(files), strict=True):
        shipped, scale = known_curves(name), measured.responsivity.max()
        for role in range(len(ROLES)):
            there = np.interp(shipped.wavelength, measured.wavelength, measured.responsivity[role] / scale)
            np.testing.assert_allclose(shipped.responsivity[role], there, atol=5.1e-5)
            beyond = (measured.wavelength < shipped.wavelength[0]) | (measured.wavelength > shipped.wavelength[-1])
            assert measured.responsivity[role][beyond].max() / scale < 0.006


def test_make_drafts_a_photo_then_renders_it(tmp_path: Path, l3: L3) -> None:
    """The photo lies where make -C is called; another one makes the picture again."""
    assert l3("init", "canon_eos_5d", tmp_path / "mine")[0] == 0
    (tmp_path / "photo.dng").touch()

    def dry(photo: str) -> subprocess.CompletedProcess[str]:
        call = ["make", "-n", "-C", "mine", f"L3={sys.executable} -m l3cli", "picture.png", f"PHOTO={photo}"]
        known = os.environ | {"PWD": str(tmp_path)}
        return subprocess.run(call, cwd=tmp_path, env=known, capture_output=True, text=True, check=False)

    steps = [line.split(" -m l3cli ")[1] for line in dry("photo.dng").stdout.splitlines() if " -m l3cli " in line]
    assert [(step.split()[0], step.split()[1]) for step in steps] == [
        ("simulate", "scenes.toml"), ("train", "training.h5"), ("render", "draft.h5"), ("train", "training.h5"),
        ("render", "table.h5"),
    ]  # fmt: skip
    assert "--draft -o draft.h5" in steps[1]
    assert f" {tmp_path}/photo.dng " in steps[-1]
    assert not (tmp_path / "mine/.shown").exists()  # make -n writes nothing
    missing = dry("other.dng")
    assert missing.returncode == 2
    assert f"other.dng must be a file in {tmp_path}/mine or in {tmp_path}, or have a path" in missing.stderr
