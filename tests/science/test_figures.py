"""No metric is NaN or infinite for any camera and illuminant. Metrics that cannot be computed are omitted."""

import dataclasses
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.cli import terminal
from l3cli.cli.evaluate import print_tables
from l3cli.physics import spectra
from l3cli.system.text import figure
from tests.helpers.calls import L3, Refused
from tests.helpers.cameras import bayer_camera
from tests.helpers.recipes import FEW_CLASSES
from tests.helpers.tables import with_first

LEAVES = 'exposure_share = [0.9]\n[[scene]]\nsource = "dead leaves"\nsize = [40, 40]\n'
NO_NUMBER = re.compile(r"\b(nan|inf|infinity)\b", re.IGNORECASE)
CAMERAS = {  # what is changed in a Bayer recipe
    "in steps of 25 nm": ("[400, 700, 10]", "[400, 1000, 25]"),
    "a channel beyond the visible": ("centre_nm = 600, sigma_nm = 35", "centre_nm = 930, sigma_nm = 10"),
    "a single channel": ('["r", "g", "b"]\npattern = ["r g", "g b"]', '["g"]\npattern = ["g"]'),
}


def strict(text: str) -> Any:
    """JSON as every other reader takes it."""

    def refuse(constant: str) -> Any:
        raise AssertionError(f"{constant} is no JSON")

    return json.loads(text, parse_constant=refuse)


@pytest.fixture
def judged(tmp_path: Path, l3: L3, capsys: pytest.CaptureFixture[str]) -> Callable[[str, str], dict]:
    """`judged(camera, head)`: the evaluation of a table of a camera recipe on leaves, whose texts hold no NaN."""
    (tmp_path / "red.csv").write_text("\n".join(f"{at},{660 <= at <= 680:d}" for at in range(400, 705, 5)))
    (tmp_path / "classes.toml").write_text(FEW_CLASSES)

    def made(camera: str, head: str = "") -> dict:
        (tmp_path / "camera.toml").write_text(camera)
        (tmp_path / "scenes.toml").write_text(head + LEAVES)
        simulate = ("simulate", tmp_path / "scenes.toml", "--camera", tmp_path / "camera.toml", "--quiet")
        assert l3(*simulate, "-o", tmp_path / "a.h5") == (0, "", "")
        assert l3(*simulate, "-o", tmp_path / "b.h5", "--seed", 1) == (0, "", "")
        assert (
            l3("train", tmp_path / "a.h5", "--classes", tmp_path / "classes.toml", "-o", tmp_path / "t.h5", "--quiet")[0]
            == 0
        )
        judge = ("evaluate", tmp_path / "t.h5", tmp_path / "b.h5", "--backend", "reference")
        code, out, err = l3(*judge, "--json")
        assert code == 0
        if "1000" not in camera:  # D65 ends at 830 nm
            assert err == ""
        document = strict(out)
        print_tables(document)
        assert not NO_NUMBER.search(capsys.readouterr().out)
        return document

    return made


@pytest.mark.parametrize("name", CAMERAS)
def test_every_camera_has_figures(name: str, judged: Callable) -> None:
    old, new = CAMERAS[name]
    recipe = bayer_camera()
    assert old in recipe
    recipe = recipe.replace(old, new)
    if name == "a single channel":
        recipe = "\n".join(line for line in recipe.splitlines() if line[:4] not in ("r = ", "b = "))
    if name == "a channel beyond the visible":
        recipe = recipe.replace("[400, 700, 10]", "[400, 1000, 10]")
    mean = judged(recipe)["mean"]
    assert 0 < mean["basic"]["mean_delta_e"] < 60
    assert 0 < mean["basic"]["psnr"] < 60


def test_a_light_without_blue_has_figures(judged: Callable) -> None:
    mean = judged(bayer_camera(), 'illuminants = ["red.csv"]\n')["mean"]
    assert 0 < mean["ours"]["output_psnr"] < 100
    assert mean["basic"]["mean_delta_e"] < 30


def test_a_table_that_overflows_is_named(pipeline: Path, tmp_path: Path, refused: Refused) -> None:
    table = load(TransformTable, pipeline / "table.h5")
    weights = (
        table.first.weights
        * np.float32(1e25)
        * np.where(np.arange(table.first.weights.shape[2]) % 2, 1, -1).astype(np.float32)
    )
    save(dataclasses.replace(with_first(table, weights=weights), output_unit=1e26), tmp_path / "huge.h5")
    line = refused(3, "evaluate", tmp_path / "huge.h5", pipeline / "unseen.h5", "--quiet", "--backend", "reference")
    assert "infinite or implausibly large values" in line


def test_a_grid_finer_than_the_camera_and_beyond_it_holds_no_nan() -> None:
    matrix = spectra.sampling_matrix(np.arange(380.0, 781.0, 5.0), np.arange(400.0, 1001.0, 10.0))
    assert np.isfinite(matrix).all()
    assert matrix[:38].sum(axis=1) == pytest.approx(np.ones(38))
    assert not matrix[40:].any()


def test_what_is_no_number_is_null_and_reported(capsys: pytest.CaptureFixture[str]) -> None:
    document = {"a": [1.0, float("nan")], "b": {"c": float("-inf")}, "d": "nan", "e": None, "f": (True, 2)}
    terminal.show_json(terminal.finite(document, terminal.Terminal()))
    out, err = capsys.readouterr()
    assert strict(out) == {"a": [1.0, None], "b": {"c": None}, "d": "nan", "e": None, "f": [True, 2]}
    assert err == "warning: some values cannot be computed and are null in the JSON: a.1, b.c\n"
    terminal.show_json(terminal.finite(document, terminal.ErrorsOnly()))
    assert capsys.readouterr().err == ""
    assert [figure(value, ".2f") for value in (1.234, float("nan"), float("inf"))] == ["1.23", "–", "–"]
