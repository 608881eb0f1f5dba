"""Cameras with polarisers: recipe keys, and electrons for known Stokes parameters."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel, Polarisers
from l3cli.artifacts.camera_recipe import camera_files, load_camera
from l3cli.artifacts.store import load, save
from l3cli.errors import L3Error, RecipeError
from l3cli.recipes.builtin import find_recipe, folder_files

RECIPE = find_recipe("polarised", "cameras")


@pytest.fixture(scope="module")
def camera() -> CameraModel:
    return load_camera(RECIPE)


def behind(camera: CameraModel, angles: list[float], extinction: float = np.inf) -> CameraModel:
    """Return the camera with other angles, and the same extinction ratio in all channels."""
    leakage = np.full(camera.responsivity.shape, 1 / extinction)
    return replace(camera, polarisers=Polarisers(np.array(angles, float), leakage))


def electrons(camera: CameraModel, stokes: tuple[float, float, float]) -> np.ndarray:
    """Return the electrons of each channel for light whose Stokes parameters are the same at all wavelengths."""
    return np.asarray(np.einsum("scw,s->c", camera.stokes_weights, stokes))


@pytest.mark.parametrize("extinction", [1.0, 4.0, 300.0, np.inf])
@pytest.mark.parametrize("stokes", [(1.0, 0.0, 0.0), (1.0, 0.3, -0.2), (2.0, -1.2, 1.6)])
def test_electrons_of_known_light(camera: CameraModel, extinction: float, stokes: tuple[float, float, float]) -> None:
    """The intensity along an axis is half the sum of S0 and the component of the polarised light, and so is it across."""
    angles = [0.0, 17.5, 90.0, 135.0]
    angle = np.radians(angles)
    component = stokes[1] * np.cos(2 * angle) + stokes[2] * np.sin(2 * angle)
    along, across = (stokes[0] + component) / 2, (stokes[0] - component) / 2
    whole = replace(camera, polarisers=None).electron_weights.sum(axis=1)
    found = electrons(behind(camera, angles, extinction), stokes)
    np.testing.assert_allclose(found, whole * (along + across / extinction), rtol=1e-12, atol=1e-12 * whole.max())


def test_malus(camera: CameraModel) -> None:
    """Fully polarised light at 25 degrees behind ideal polarisers falls with the square of the cosine."""
    angles = np.array([25.0, 55.0, 115.0, 160.0])
    light = 1.0, float(np.cos(np.radians(50))), float(np.sin(np.radians(50)))
    found = electrons(behind(camera, list(angles)), light)
    whole = replace(camera, polarisers=None).electron_weights.sum(axis=1)
    np.testing.assert_allclose(found / whole, np.cos(np.radians(angles - 25)) ** 2, atol=1e-12)


def test_responses_to_unpolarised_light_are_those_of_the_camera(camera: CameraModel) -> None:
    np.testing.assert_array_equal(camera.stokes_weights[0], camera.electron_weights)
    bare = replace(camera, polarisers=None)
    np.testing.assert_array_equal(bare.stokes_weights[0], bare.electron_weights)
    assert not bare.stokes_weights[1:].any()
    assert camera.electron_weights.sum() == pytest.approx(bare.electron_weights.sum() / 2, rel=0.005)


def test_a_recipe_mixes_channels_with_and_without_polarisers(tmp_path: Path) -> None:
    """Polarisers alone do not make channels that are read out differently."""
    text = find_recipe("bayer", "cameras").read_text()
    path = tmp_path / "camera.toml"
    path.write_text(text + "[channel.g]\npolariser_deg = 30.0\nextinction = 50.0\n")
    camera = load_camera(path)
    assert camera.readout is None
    assert camera.polarisers is not None
    np.testing.assert_array_equal(camera.polarisers.present, [False, True, False])
    np.testing.assert_array_equal(camera.polarisers.polariser_deg, [0, 30, 0])
    np.testing.assert_allclose(camera.polarisers.extinction[:, 0], [1, 50, 1])
    np.testing.assert_array_equal(camera.stokes_response[[0, 2], 0], 1.0)
    path.write_text(text + "[channel.g]\npolariser_deg = 30.0\ngain = 2.0\n")
    other = load_camera(path)
    assert other.readout is not None
    assert other.polarisers is not None
    assert np.isinf(other.polarisers.extinction[1]).all()


def test_polarisers_come_back_from_a_file(camera: CameraModel, bayer: CameraModel, tmp_path: Path) -> None:
    save(camera, tmp_path / "camera.h5")
    again = load(CameraModel, tmp_path / "camera.h5")
    np.testing.assert_array_equal(again.stokes_response, camera.stokes_response)
    save(bayer, tmp_path / "bayer.h5")
    assert load(CameraModel, tmp_path / "bayer.h5").polarisers is None
    assert b"polariser" not in (tmp_path / "bayer.h5").read_bytes()


@pytest.mark.parametrize(
    "keys",
    ["polariser_deg = 180.0", "polariser_deg = -1.0", "polariser_deg = 0.0\nextinction = 0.5", "extinction = 10.0"],
)
def test_impossible_polarisers_are_refused(keys: str, tmp_path: Path) -> None:
    path = tmp_path / "camera.toml"
    path.write_text(find_recipe("bayer", "cameras").read_text() + f"[channel.g]\n{keys}\n")
    with pytest.raises(RecipeError, match=r"channel\.g"):
        load_camera(path)


def test_extinction_ratios_below_one_in_a_file_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "camera.toml"
    path.write_text(
        find_recipe("bayer", "cameras").read_text() + '[channel.g]\npolariser_deg = 0.0\nextinction = "curve.csv"\n'
    )
    with pytest.raises(L3Error, match=r"curve\.csv"):
        load_camera(path)
    (tmp_path / "curve.csv").write_text("wavelength_nm,ratio\n400,0.5\n700,20\n")
    with pytest.raises(L3Error, match=r"curve\.csv"):
        load_camera(path)


def test_a_new_folder_contains_the_extinction_ratios() -> None:
    assert "polarised_extinction.csv" in folder_files(RECIPE)
    assert RECIPE.parent / "polarised_extinction.csv" in camera_files(RECIPE)


@pytest.mark.parametrize("name", ["polarised", "polarised_colour"])
def test_the_angles_of_the_arrays(name: str) -> None:
    """Both arrays have the angles of Sony's sensors."""
    camera = load_camera(find_recipe(name, "cameras"))
    assert camera.polarisers is not None
    angles = camera.polarisers.polariser_deg[camera.channel_map((4, 4))]
    np.testing.assert_array_equal(angles, np.tile([[90, 45], [135, 0]], (2, 2)))
