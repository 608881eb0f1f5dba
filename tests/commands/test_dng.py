"""`l3 simulate --dng`: simulated frames as files that other raw developers open and that render as the frames themselves."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rawpy
import tifffile

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.store import save
from l3cli.artifacts.training_set import open_training_set
from l3cli.cli import run
from l3cli.io.images import read_image
from l3cli.io.pictures.dng import LIGHT_CODES, write_dng
from l3cli.io.raw.files import read_raw
from l3cli.physics import spectra
from l3cli.physics.display import delta_e_2000, lab, srgb_from_xyz_matrix
from l3cli.simulation.light import colour_matrix, make_light, neutral
from tests.helpers.cameras import BAYER, bayer_camera
from tests.helpers.paths import CONFIGS
from tests.helpers.tables import random_table

SCENES = """
illuminants = ["D65", "A"]
exposure_share = [0.9]
[[scene]]
source = "colorchecker"
size = [96, 144]
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of frames of the small Bayer camera, as TIFF and as DNG, with their table."""
    folder = tmp_path_factory.mktemp("dng")
    (folder / "camera.toml").write_text(bayer_camera().replace("black_level_dn = 64", "black_level_dn = 64.25"))
    (folder / "scenes.toml").write_text(SCENES)
    arguments = ["simulate", "scenes.toml", "--camera", "camera.toml", "-o", "t.h5", "--pictures", "p", "--dng", "d"]
    paths = {name: str(folder / name) for name in ("scenes.toml", "camera.toml", "t.h5", "p", "d")}
    assert run([paths.get(each, each) for each in arguments] + ["--quiet"]) == 0
    table = random_table(BAYER, bits=12, black_level=64.25, patch=5)
    save(dataclasses.replace(table, white_level=3814.0), folder / "table.h5")
    return folder


@pytest.fixture(scope="module")
def frames(made: Path) -> list[np.ndarray]:
    with open_training_set(made / "t.h5") as training:
        return [frame.raw for frame in training]


def files(made: Path) -> list[Path]:
    return sorted((made / "d").iterdir())


def test_one_file_a_frame_rendered_to_the_same_pixels(l3: Callable, made: Path, frames: list[np.ndarray]) -> None:
    names = [path.stem for path in files(made)]
    assert names == [path.name.removesuffix("_raw.tif") for path in sorted((made / "p").glob("*_raw.tif"))]
    for name in names:
        for source, output in ((made / f"d/{name}.dng", "dng.png"), (made / f"p/{name}_raw.tif", "tif.png")):
            assert l3("render", made / "table.h5", source, "-o", made / output, "--backend", "reference", "--force")[0] == 0
        np.testing.assert_array_equal(read_image(made / "dng.png")[0], read_image(made / "tif.png")[0])


def test_other_developers_see_the_camera(made: Path, frames: list[np.ndarray]) -> None:
    for path, values in zip(files(made), frames, strict=True):
        with rawpy.imread(str(path)) as raw:
            np.testing.assert_array_equal(raw.raw_image, values)
            assert set(raw.black_level_per_channel) == {64}  # LibRaw takes whole numbers
            assert raw.white_level == 3814
            assert [raw.color_desc.decode()[index] for index in raw.raw_pattern.ravel()] == list("RGGB")
            assert raw.sizes.flip == 0


def test_other_developers_make_a_true_picture(made: Path) -> None:
    """LibRaw's picture, white balanced by AsShotNeutral, against the wanted one, patch by patch."""
    wavelength = np.arange(380.0, 781.0, 5.0)
    _, reflectance = spectra.colorchecker(wavelength)
    weights = spectra.xyz_weights(wavelength) * spectra.illuminant("D65", wavelength)
    wanted, white = reflectance @ weights.T / weights[1].sum(), spectra.white_point("D65")
    for path, error in zip(files(made), (2.0, 7.0), strict=True):
        with rawpy.imread(str(path)) as raw:
            picture = raw.postprocess(use_camera_wb=True, no_auto_bright=True, output_bps=16, gamma=(1, 1)) / 65535
        reached = picture[:96, :144].reshape(4, 24, 6, 24, 3)[:, 8:16, :, 8:16].mean(axis=(1, 3)).reshape(24, 3)
        xyz = reached @ np.linalg.inv(srgb_from_xyz_matrix()).T
        xyz *= wanted[18, 1] / xyz[18, 1]
        difference = delta_e_2000(lab(xyz, white), lab(wanted, white))
        assert difference.mean() < error, difference.round(1)
        greys = reached[18:]
        assert (np.ptp(greys, axis=1) < 0.03 * greys.mean(axis=1) + 0.004).all()  # noise


def test_tags_are_those_of_the_specification(made: Path) -> None:
    with tifffile.TiffFile(files(made)[0]) as file:
        written = file.pages[0].tags.values()
        tags, kind = {tag.code: tag.value for tag in written}, {tag.code: (int(tag.dtype), tag.count) for tag in written}
    kinds = {
        254: (4, 1), 274: (3, 1), 33421: (3, 2), 33422: (1, 4), 50706: (1, 4), 50707: (1, 4), 50710: (1, 3), 50711: (3, 1),
        50713: (3, 2), 50714: (5, 1), 50717: (4, 1), 50718: (5, 2), 50719: (4, 2), 50720: (4, 2), 50721: (10, 9),
        50722: (10, 9), 50728: (5, 3), 50778: (3, 1), 50779: (3, 1), 50829: (4, 4), 51041: (12, 2), 33434: (5, 1),
    }  # fmt: skip
    assert {code: kind[code] for code in kinds} == kinds
    assert list(tags) == sorted(tags)  # TIFF asks for it
    assert (tags[262], tags[258], tags[277]) == (32803, 16, 1)
    assert (tags[50778], tags[50779]) == (17, 21)
    assert tags[50829] == (0, 0, 96, 144)
    assert tags[50714] == (257, 4)
    assert tags[50708] == "small Bayer"
    assert 306 not in tags  # no clock


def test_same_frames_same_bytes(made: Path, tmp_path: Path) -> None:
    again = ["simulate", str(made / "scenes.toml"), "--camera", str(made / "camera.toml"), "-o", str(tmp_path / "t.h5")]
    assert run([*again, "--dng", str(tmp_path / "d"), "--quiet"]) == 0
    for path in files(made):
        assert path.read_bytes() == (tmp_path / "d" / path.name).read_bytes()


@pytest.mark.parametrize("recipe", ["fiveband", "xtrans", "quad_bayer", "rgbw4x4", "rgbir", "cmy", "snapshot16"])
def test_any_array_comes_back(tmp_path: Path, recipe: str) -> None:
    camera = load_camera(CONFIGS / f"cameras/{recipe}.toml")
    values = np.random.default_rng(0).integers(0, round(camera.white_level) + 1, (40, 60)).astype(np.uint16)
    write_dng(tmp_path / "a.dng", values, camera, _colour(camera), None, 1e-5)
    frame = read_raw(tmp_path / "a.dng", camera)
    np.testing.assert_array_equal(frame.values, values)
    assert (frame.black_level, frame.white_level, frame.phase, frame.orientation) == (
        camera.black_level,
        camera.white_level,
        (0, 0),
        0,
    )
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        np.testing.assert_array_equal(raw.raw_image, values)


def test_matrices_and_neutral_follow_the_planes(tmp_path: Path) -> None:
    """Of three channels the commonest, yellow here, is the second plane; every tag keeps that order."""
    camera = load_camera(CONFIGS / "cameras/cmy.toml")
    light = make_light("D65", {}, camera.wavelength)
    grey = neutral(camera, light)
    write_dng(tmp_path / "a.dng", np.zeros((4, 6), np.uint16), camera, _colour(camera), grey, 0.01)
    with tifffile.TiffFile(tmp_path / "a.dng") as file:
        tags = file.pages[0].tags
        planes, matrix, shown = (tags.valueof(code) for code in (50710, 50722, 50728))
    assert list(planes) == [3, 5, 4]
    np.testing.assert_allclose(np.divide(shown[::2], shown[1::2]), grey[[0, 2, 1]], rtol=1e-6)
    np.testing.assert_allclose(np.divide(matrix[::2], matrix[1::2]).reshape(3, 3), _colour(camera)["D65"][[0, 2, 1]])


@pytest.mark.parametrize("recipe", ["bayer", "fiveband", "cmy"])
def test_the_matrix_meets_white_and_surfaces(recipe: str) -> None:
    camera = load_camera(CONFIGS / f"cameras/{recipe}.toml")
    for name in LIGHT_CODES:
        light = make_light(name, {}, camera.wavelength)
        matrix = colour_matrix(camera, light)
        white = spectra.xyz_weights(light.wavelength) @ light.radiance
        np.testing.assert_allclose(matrix @ (white / white[1]), neutral(camera, light), rtol=1e-9)
        _, reflectance = spectra.colorchecker(light.wavelength)
        seen = camera.electron_weights @ spectra.sampling_matrix(light.wavelength, camera.wavelength)
        channels = (reflectance * light.radiance) @ seen.T / (seen @ light.radiance).max()
        xyz = (reflectance * light.radiance) @ spectra.xyz_weights(light.wavelength).T / white[1]
        assert np.abs(xyz @ matrix.T - channels).mean() < 0.02


def test_what_exists_already_is_refused(refused: Callable, made: Path, tmp_path: Path) -> None:
    call = ("simulate", made / "scenes.toml", "--camera", made / "camera.toml", "-o", tmp_path / "t.h5", "--dng")
    (tmp_path / "file").write_bytes(b"")
    assert "name a folder" in refused(1, *call, tmp_path / "file")
    (tmp_path / "full").mkdir()
    (tmp_path / "full/mine.dng").write_bytes(b"")
    assert "not empty" in refused(1, *call, tmp_path / "full")


def _colour(camera: CameraModel) -> dict[str, np.ndarray]:
    return {name: colour_matrix(camera, make_light(name, {}, camera.wavelength)) for name in LIGHT_CODES}
