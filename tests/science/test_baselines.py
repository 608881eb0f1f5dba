"""What a table is compared with gets all that the table has: the camera's whole grid, the frame's light, the light that
is wanted (docs/method.md#basic-pipeline)."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.paths import CONFIGS
from tests.helpers.recipes import FEW_CLASSES

CHART = '[[scene]]\nsource = "colorchecker"\nsize = [192, 288]\n'
LEAVES = 'exposure_share = [0.9]\n[[scene]]\nsource = "dead leaves"\nsize = [48, 48]\ncount = 2\n'
WAVELENGTH = np.arange(380, 781, 2)
CENTRES = np.array([[455], [545], [615]])
LINES = np.exp(-0.5 * ((WAVELENGTH - CENTRES) / 8.0) ** 2).sum(axis=0)  # a lamp of three narrow bands


@pytest.fixture
def basic(tmp_path: Path, l3: Callable) -> Callable[[str, str], list[dict]]:
    """`basic(camera, head)`: figures of the basic pipeline on ColorCheckers that a recipe's camera sees, frame by frame."""
    lamp = [f"{at},{power:.6f}" for at, power in zip(WAVELENGTH, LINES, strict=True)]
    (tmp_path / "lamp.csv").write_text("\n".join(lamp))
    (tmp_path / "leaves.toml").write_text(LEAVES)
    (tmp_path / "classes.toml").write_text(FEW_CLASSES)

    def judged(name: str, head: str) -> list[dict]:
        (tmp_path / "chart.toml").write_text(head + CHART)
        camera = ("--camera", CONFIGS / f"cameras/{name}.toml", "--quiet", "--force")
        assert l3("simulate", tmp_path / "leaves.toml", *camera, "-o", tmp_path / "training.h5")[0] == 0
        assert l3("simulate", tmp_path / "chart.toml", *camera, "-o", tmp_path / "chart.h5")[0] == 0
        train = ("train", tmp_path / "training.h5", "--classes", tmp_path / "classes.toml", "--quiet", "--force")
        assert l3(*train, "-o", tmp_path / "table.h5")[0] == 0
        code, out, _ = l3(
            "evaluate", tmp_path / "table.h5", tmp_path / "chart.h5", "--json", "--quiet", "--backend", "reference"
        )
        assert code == 0
        return [frame["basic"] for frame in json.loads(out)["frames"]]

    return judged


def test_the_basic_matrix_is_fitted_over_all_that_the_camera_sees(basic: Callable) -> None:
    (frames,) = basic("rgbir", "exposure_share = [0.9]\n")  # sees to 830 nm; of a fit up to 780 nm alone comes 14.1, not 4.8
    assert frames["median_delta_e"] < 7


def test_the_basic_matrix_is_fitted_for_the_very_light_of_the_frame(basic: Callable) -> None:
    lights = '["D65", "lamp.csv", "0.6 A + 0.4 lamp.csv"]'
    frames = basic("fiveband", f"exposure_share = [0.9]\nluminances_cd_m2 = [7.0]\nilluminants = {lights}\n")
    assert len(frames) == 3
    assert max(frame["median_delta_e"] for frame in frames) < 5  # of the nearest CIE lights come 3.4, 8.5 and 8.6


def test_the_basic_matrix_is_fitted_for_the_light_that_is_wanted(basic: Callable) -> None:
    head = 'exposure_share = [0.9]\nilluminants = ["A"]\n[target]\nilluminant = "lamp.csv"\n'
    (frames,) = basic("fiveband", head)
    assert frames["median_delta_e"] < 6.5  # of a fit to the frame's light come 8.0
