"""What must hold of colour: a ColorChecker comes out true under every light that was learned, itself unlearned."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import open_training_set
from l3cli.frames.frame import RawFrame
from l3cli.physics import paint, spectra
from l3cli.physics.display import delta_e_2000, lab
from l3cli.rendering.renderer import make_renderer
from l3cli.simulation import reflectances
from l3cli.simulation.charts import colorchecker_patches
from l3cli.training import plain_surfaces
from tests.helpers.paths import CONFIGS

CAMERA = CONFIGS / "cameras/fiveband.toml"
CHART = """
illuminants = ["{light}"]
exposure_share = [0.4, 0.9]
[sensor]
noise = "none"
[[scene]]
source = "colorchecker"
size = [144, 216]
"""
LIKE_A_PATCH = 0.9995  # cosine between spectra from which a measured surface may be a patch of the chart measured again
MARGIN = 6  # pixels inside a patch's rim


@pytest.fixture
def without_the_chart(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The library of reflectances without any surface that is nearly a patch of the ColorChecker."""
    whole = spectra.reflectance_library

    def unlike(wavelength: np.ndarray) -> np.ndarray:
        library, visible = whole(wavelength), (wavelength >= 420) & (wavelength <= 700)
        chart = spectra.colorchecker(wavelength)[1][:18, visible]
        cosine = (library[:, visible] @ chart.T) / np.linalg.norm(chart, axis=1)
        alike = (cosine / np.linalg.norm(library[:, visible], axis=1, keepdims=True) > LIKE_A_PATCH).any(axis=1)
        assert 3 < alike.sum() < 60
        return library[~alike]

    monkeypatch.setattr(spectra, "reflectance_library", unlike)
    reflectances.surfaces.cache_clear()
    plain_surfaces.cached_reflectances.cache_clear()
    yield
    reflectances.surfaces.cache_clear()
    plain_surfaces.cached_reflectances.cache_clear()


def chart_errors(table: Path, chart: Path) -> np.ndarray:
    """ΔE00 (frame, patch) within the patches of a chart's frames, relative to the light's white, in no gamut."""
    transforms = load(TransformTable, table)
    renderer, errors = make_renderer("opencl", transforms), []
    with open_training_set(chart) as frames:
        camera = frames.head.camera
        for frame in frames:
            outputs = renderer.outputs(RawFrame("chart", frame.raw, camera.black_level, camera.white_level))
            planes = outputs * transforms.output_unit / frame.exposure
            labs = [lab(np.moveaxis(np.asarray(xyz), 0, -1), frame.white) for xyz in (planes, frame.target)]
            error = delta_e_2000(*labs)
            inner = [
                (slice(rows.start + MARGIN, rows.stop - MARGIN), slice(cols.start + MARGIN, cols.stop - MARGIN))
                for rows, cols in colorchecker_patches(error.shape)
            ]
            errors.append([error[where].mean() for where in inner])
    return np.array(errors)


def learned_errors(light: str, classes: str, count: int, folder: Path, l3: Callable) -> np.ndarray:
    scenes = (CONFIGS / "scenes/colour.toml").read_text()
    assert '["D65"]' in scenes
    assert "count = 80" in scenes
    (folder / "scenes.toml").write_text(scenes.replace('"D65"', f'"{light}"').replace("count = 80", f"count = {count}"))
    (folder / "chart.toml").write_text(CHART.format(light=light))
    (folder / "classes.toml").write_text(classes)
    for name in ("scenes", "chart"):
        arguments = ("simulate", folder / f"{name}.toml", "--camera", CAMERA, "-o", folder / f"{name}.h5", "--quiet")
        assert l3(*arguments)[0] == 0
    code, _, err = l3(
        "train", folder / "scenes.h5", "--classes", folder / "classes.toml", "-o", folder / "table.h5", "--quiet"
    )
    assert code == 0, err
    return chart_errors(folder / "table.h5", folder / "chart.h5")


def colour_classes(**changes: object) -> str:
    lines = (CONFIGS / "classes/colour.toml").read_text().splitlines()
    for key, value in changes.items():
        assert sum(line.startswith(f"{key} ") for line in lines) == 1
        lines = [f"{key} = {value}" if line.startswith(f"{key} ") else line for line in lines]
    return "\n".join(lines)


@pytest.mark.usefixtures("without_the_chart")
@pytest.mark.parametrize("light", ["D65", "A"])
def test_an_unseen_chart_comes_out_true(light: str, tmp_path: Path, l3: Callable) -> None:
    """Small: 5×5 patches, 30 charts of surfaces, and a tenth more allowed than the full recipe below must reach."""
    errors = learned_errors(light, colour_classes(patch=5, patches=10000, draws=4), 30, tmp_path, l3)
    print(f"{light}: mean ΔE00 {errors.mean():.2f}, worst patch {errors.max():.2f}")
    assert errors.mean(axis=1).max() < 0.9, np.round(errors, 1)


@pytest.mark.slow
@pytest.mark.usefixtures("without_the_chart")
@pytest.mark.parametrize("light", ["D65", "A", "F2", "3200K"])
def test_an_unseen_chart_comes_out_true_by_the_full_recipe(light: str, tmp_path: Path, l3: Callable) -> None:
    errors = learned_errors(light, colour_classes(), 80, tmp_path, l3)
    print(f"\n{light}: mean ΔE00 {errors.mean():.2f}, worst patch {errors.max():.2f}")
    assert errors.mean(axis=1).max() < 0.8, np.round(errors, 1)


def test_titanium_white_darkens_the_violet_only() -> None:
    wavelength = np.arange(380.0, 731.0, 10.0)
    for seed in range(20):
        grey = np.full(wavelength.size, 0.05 + 0.045 * seed)
        rng = np.random.default_rng(seed)
        painted = paint.with_titanium_white(grey, wavelength, rng.uniform(0.05, 0.8), rng.uniform(5.0, 11.0))
        assert (painted <= grey + 1e-12).all()
        assert (np.diff(painted) > -1e-12).all()
        assert painted[wavelength > 500] == pytest.approx(grey[wavelength > 500], rel=0.02)
        assert painted[0] < 0.9 * grey[0]
