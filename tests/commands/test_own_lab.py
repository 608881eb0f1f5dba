"""The examples of docs/own-lab.md are copied: every source of responsivities with every description of the sensor."""

import re
from itertools import product
from pathlib import Path

import msgspec
import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.store import load
from l3cli.io.measurement_recipe import CaptureRecipe, MeasurementRecipe
from l3cli.io.pictures.openimageio import write_mosaic
from l3cli.recipes.toml import load_recipe
from l3cli.simulation.sensor import expose
from tests.helpers.calls import L3
from tests.helpers.readme import PAGES, blocks

EXAMPLES = blocks(PAGES["own-lab.md"])
HEAD = next(block for block in EXAMPLES if block.startswith("name = "))
TABLES = {match[1]: block for block in EXAMPLES if (match := re.match(r"\[\[?(\w+)\]", block))}
FILES = {match[1]: block for block in EXAMPLES if (match := re.match(r"# (\S+\.csv)", block))}


def take_frames(folder: Path, recipe: MeasurementRecipe, camera: CameraModel) -> None:
    """What a camera gives of the white and dark frames that a measurement file names."""
    captures: list[tuple[CaptureRecipe, float]] = [(white, 1.2e6) for white in recipe.white]  # e-/s
    captures += [(dark, 0.0) for dark in recipe.dark]
    for number, (capture, rate) in enumerate(captures):
        assert capture.seconds is not None
        for trial, name in enumerate(capture.frames):
            electrons = np.full((camera.rows, camera.cols), rate * capture.seconds)
            rng = np.random.default_rng([number, trial])
            write_mosaic(folder / name, expose(camera, electrons, capture.seconds, rng))


@pytest.mark.parametrize(("source", "sensor"), [*product(["sweep", "curves"], ["white", "datasheet"])])
def test_the_examples_make_a_camera(source: str, sensor: str, bayer_recipe: Path, tmp_path: Path, l3: L3) -> None:
    file, camera = tmp_path / "MEASUREMENTS.toml", load_camera(bayer_recipe)
    stated = TABLES["uncertainty"] if source == "sweep" else re.sub("photodiode.*", "", TABLES["uncertainty"])
    file.write_text("\n\n".join([HEAD, TABLES[source], TABLES[sensor], stated]))
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    recipe = load_recipe(file, MeasurementRecipe)
    assert msgspec.to_builtins(recipe)[source]
    take_frames(tmp_path, recipe, camera)
    assert l3("check", file)[0] == 0
    code, _, err = l3("calibrate", file, "-o", tmp_path / "camera.h5", "--quiet")
    assert (code, err) == (0, "")
    made = load(CameraModel, tmp_path / "camera.h5")
    assert made.wavelength[made.responsivity.argmax(axis=1)].tolist() in ([600, 550, 450], [600, 500, 450])
    if sensor == "white":
        assert made.gain == pytest.approx(camera.gain, rel=0.05)
        assert made.noise.read_noise == pytest.approx(camera.noise.read_noise, rel=0.1)
