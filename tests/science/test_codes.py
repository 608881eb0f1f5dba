"""Pictures whose codes are the camera's channels: the mosaic and the target are these codes, without spectra."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.training_set import open_training_set
from l3cli.evaluation.demosaic import tiled
from l3cli.frames.scene import ChannelPicture
from l3cli.io.pictures.registry import write_picture
from tests.helpers.paths import CONFIGS

CAMERA = CONFIGS / "benchmarks/bayer/camera.toml"
HEAD = 'exposure_share = [{share}]\nsensor.noise = "none"\ntarget.outputs = "camera"\n'
SCENE = '[[scene]]\nsource = "rgb"\nholds = "codes"\nfile = "{file}"\n'


@pytest.fixture
def codes(tmp_path: Path) -> np.ndarray:
    """The codes of picture.png, 24 × 20."""
    pixels = np.random.default_rng(0).integers(0, 256, (24, 20, 3), dtype=np.uint8)
    write_picture(tmp_path / "picture.png", pixels)
    return pixels


def recipe(folder: Path, text: str) -> Path:
    (folder / "scenes.toml").write_text(text)
    return folder / "scenes.toml"


def test_mosaic_and_target_are_the_codes(codes: np.ndarray, tmp_path: Path, l3: Callable) -> None:
    scenes = recipe(tmp_path, HEAD.format(share="0.9, 0.5") + SCENE.format(file="picture.png"))
    assert l3("simulate", scenes, "--camera", CAMERA, "-o", tmp_path / "set.h5", "--quiet")[0] == 0
    with open_training_set(tmp_path / "set.h5") as reader:
        camera, frames = reader.head.camera, [reader.frame(0), reader.frame(1)]
    sampled = np.take_along_axis(codes, tiled(camera.cfa, codes.shape[:2])[..., None].astype(int), axis=2)[..., 0]
    for frame, share in zip(frames, (0.9, 0.5), strict=True):
        assert np.abs(frame.raw - sampled / 255 * share * camera.white_level).max() <= 0.51
        assert frame.white == pytest.approx(np.full(3, frame.white[0]))
        target = np.moveaxis(frame.target, 0, -1) / frame.white[0] * 255
        assert target == pytest.approx(codes, abs=1e-3)
    assert frames[0].exposure == pytest.approx(frames[1].exposure * 1.8)


def test_channels_are_taken_by_their_names(codes: np.ndarray, tmp_path: Path, l3: Callable) -> None:
    text = CAMERA.read_text().replace('["r", "g", "b"]', '["b", "r", "g"]')
    (tmp_path / "camera.toml").write_text(text)
    framing = "crop = [2, 4, 18, 16]\nrotate = 90\n"
    scenes = recipe(tmp_path, HEAD.format(share="0.9") + SCENE.format(file="picture.png") + framing)
    assert l3("simulate", scenes, "--camera", tmp_path / "camera.toml", "-o", tmp_path / "set.h5", "--quiet")[0] == 0
    with open_training_set(tmp_path / "set.h5") as reader:
        frame = reader.frame(0)
        assert reader.head.outputs == ("b", "r", "g")
    turned = np.rot90(codes[2:20, 4:20])
    assert np.moveaxis(frame.target, 0, -1) / frame.white[0] * 255 == pytest.approx(turned[..., [2, 0, 1]], abs=1e-3)


def test_a_picture_of_floats_is_linear_already(tmp_path: Path, l3: Callable) -> None:
    write_picture(tmp_path / "picture.exr", np.full((16, 16, 3), 0.25, np.float32), ("R", "G", "B"))
    scenes = recipe(tmp_path, HEAD.format(share="0.9") + SCENE.format(file="picture.exr"))
    assert l3("simulate", scenes, "--camera", CAMERA, "-o", tmp_path / "set.h5", "--quiet")[0] == 0
    with open_training_set(tmp_path / "set.h5") as reader:
        assert reader.frame(0).target / reader.frame(0).white[0] == pytest.approx(np.full((3, 16, 16), 0.25), rel=1e-6)


def test_what_has_no_spectra_is_refused(codes: np.ndarray, tmp_path: Path, refused: Callable) -> None:
    def says(text: str, camera: object = CAMERA) -> str:
        return str(refused(2, "simulate", recipe(tmp_path, text), "--camera", camera, "-o", tmp_path / "set.h5"))

    scene = SCENE.format(file="picture.png")
    assert 'target.outputs = "camera"' in says("exposure_share = [0.9]\n" + scene)
    assert "no target.illuminant" in says('target.illuminant = "A"\n' + HEAD.format(share=0.9) + scene)
    assert "r, g, b, o, c" in says(HEAD.format(share=0.9) + scene, "fiveband")
    assert "no light of its own" in says('illuminants = ["scene"]\n' + HEAD.format(share=0.9) + scene)
    assert "holds" in says(HEAD.format(share=0.9) + scene.replace("codes", "code"))


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e7])
def test_a_signal_is_a_number(value: float) -> None:
    with pytest.raises(ValueError, match="not finite, or above"):
        ChannelPicture("picture", np.full((16, 16, 3), value, np.float32))
