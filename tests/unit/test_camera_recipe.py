"""Camera recipes and camera models have corresponding fields, so that no new field is lost."""

from dataclasses import dataclass, fields, replace

import pytest

from l3cli.artifacts import camera_recipe
from l3cli.artifacts.camera import CameraModel, Noise, Optics
from l3cli.artifacts.camera_recipe import NoiseRecipe, noise_entries, noise_of, optics_of, optics_recipe
from l3cli.artifacts.schema import data
from l3cli.calibration.draft.compose import DraftText
from l3cli.calibration.draft.folder import sensor_figures
from l3cli.calibration.figures import camera_figures
from l3cli.design.recipe import camera_texts
from l3cli.export.profiles import datasheet


def test_every_field_comes_back() -> None:
    noise = Noise(**{field.name: 0.25 * (number + 1) for number, field in enumerate(fields(Noise))})
    assert noise_of(NoiseRecipe(**noise_entries(noise))) == noise
    optics = Optics(**{field.name: 0.25 * (number + 1) for number, field in enumerate(fields(Optics))})
    assert optics_of(optics_recipe(optics)) == optics


def test_a_new_term_of_the_noise_is_not_lost(bayer: CameraModel, monkeypatch: pytest.MonkeyPatch) -> None:
    @dataclass(frozen=True)
    class WithCorners(Noise):
        corner_noise: float = data("float64", unit="e-", doc="offset of each corner", default=0.0)

    class WithCornersRecipe(NoiseRecipe):
        corner_noise_e: float = 0.0

    monkeypatch.setattr(camera_recipe, "Noise", WithCorners)
    monkeypatch.setattr(camera_recipe, "NoiseRecipe", WithCornersRecipe)
    noise = WithCorners(**{field.name: getattr(bayer.noise, field.name) for field in fields(Noise)}, corner_noise=1.5)
    assert noise_of(WithCornersRecipe(**noise_entries(noise))) == noise
    camera = replace(bayer, noise=noise)
    assert "corner_noise_e = 1.5" in camera_texts(camera, "a test")["camera.toml"]
    draft = DraftText()
    sensor_figures(draft, camera)
    assert "corner_noise_e = 1.5" in str(draft)


def test_temporal_and_fixed_terms_are_the_noise_in_the_dark(bayer: CameraModel) -> None:
    """A reading in the dark has the terms of both kinds, and a temporal filter leaves the fixed ones."""
    noise = replace(bayer.noise, read_noise=3.0, dsnu=2.0, column_noise=1.5)
    lines = replace(noise, row_temporal_noise=2.0, column_temporal_noise=1.0, row_noise=3.0)
    assert (lines.temporal, lines.fixed, lines.dark_noise) == (9.0 + 4.0 + 1.0, 4.0 + 2.25 + 9.0, pytest.approx(14**0.5))
    camera = replace(bayer, noise=noise, lines_corrected=True)
    assert (noise.temporal, noise.fixed, noise.dark_noise) == (9.0, 4.0 + 2.25, 3.0)
    assert camera.noise_terms()[0] == pytest.approx(camera.gain**2 * (9.0 + 4.0 + 2.25) + 1 / 12)
    filtered = replace(camera, noise_left=0.25)
    assert filtered.noise_terms()[0] == pytest.approx(camera.gain**2 * (9.0 / 4 + 4.0 + 2.25) + 1 / 12)


def test_column_noise_is_a_figure_of_the_camera_that_declares_it(bayer: CameraModel) -> None:
    camera = replace(bayer, noise=replace(bayer.noise, column_noise=1.5))
    assert camera_figures(camera)["column noise"] == (1.5, "e-")
    assert ("column noise", "", 1.5, "e-", "recipe") in datasheet(camera)
    assert "column noise" not in camera_figures(replace(bayer, noise=replace(bayer.noise, column_noise=0.0)))
    lined = replace(bayer, noise=replace(bayer.noise, read_noise=3.0, row_temporal_noise=4.0))
    assert camera_figures(lined)["temporal dark noise"] == (5.0, "e-")
    assert camera_figures(lined)["row temporal noise"] == (4.0, "e-")
    assert "column temporal noise" not in camera_figures(lined)


def test_terms_that_a_camera_lacks_are_not_written(bayer: CameraModel) -> None:
    """Recipes of cameras without noise of rows and columns are what they were before it was known."""
    assert "temporal" not in camera_texts(bayer, "a test")["camera.toml"]
    assert "row_noise_e" not in camera_texts(bayer, "a test")["camera.toml"]
    lined = replace(bayer, noise=replace(bayer.noise, row_temporal_noise=4.0))
    assert "row_temporal_noise_e = 4.0" in camera_texts(lined, "a test")["camera.toml"]
