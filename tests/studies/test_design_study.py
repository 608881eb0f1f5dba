"""Arrays of one pixel as the closed form ranks them, and as training does: sixteen arrays, three lights.

python -m pytest -m slow -s tests/studies/test_design_study.py      half an hour on a core; --jobs 2 of l3 design halves it
"""

from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.design import Design
from l3cli.artifacts.store import load
from tests.helpers.calls import L3

pytestmark = pytest.mark.slow
DESIGN = """
name = "sixteen arrays"
[pixel]
camera = "bayer"
bare = 0.61
[filters]
r = { channel = "r" }
g = { channel = "g" }
b = { channel = "b" }
w = {}
c = { centre_nm = 500, sigma_nm = 55 }
y = { centre_nm = 590, sigma_nm = 75 }
o = { centre_nm = 590, sigma_nm = 40 }
k = { centre_nm = 500, sigma_nm = 28 }
[[pattern]]
arrays = [
  ["g r", "b g"], ["r b", "b g"], ["r g", "r b"], ["w r", "b g"], ["w r", "b w"], ["c y", "y r"], ["c y", "g r"],
  ["k o", "b k"], ["g b", "o g"], ["r k", "b g"],
  ["w w w r", "w g w w", "w w w b", "g w w w"], ["r r g g", "r r g g", "g g b b", "g g b b"],
  ["r g b"], ["w y", "c w"], ["r w", "b w"], ["g b r b", "g g g g", "r g b g", "g g g g"],
]
[[level]]
share = 0.9
[[level]]
luminance_cd_m2 = 20
exposure_s = 0.0333
[[level]]
luminance_cd_m2 = 2
exposure_s = 0.0333
"""
# Of rank correlations and of shares of pairs in order, by level.
LEAST = {"mean_delta_e": ((0.9, 0.5, 0.8), (0.9, 0.65, 0.9)), "scielab": ((0.9, 0.9, 0.9), (0.95, 0.95, 0.95))}


def test_sixteen_arrays_are_ranked_as_training_ranks_them(
    tmp_path: Path, l3: L3, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "design.toml").write_text(DESIGN)
    scenes, output = tmp_path / "scenes.h5", tmp_path / "design.h5"
    assert l3("design", "moments", "default", "--camera", "bayer", "-o", scenes, "--quiet")[0] == 0
    code, out, err = l3("design", tmp_path / "design.toml", "--moments", scenes, "-o", output, "--truth", 16, "--quiet")
    assert code == 0, err
    truth = load(Design, output).truth
    assert truth is not None
    with capsys.disabled():
        print(out)
    for figure, (least, fewest) in LEAST.items():
        number = truth.figures.index(figure)
        assert (np.array([truth.correlation(level, number) for level in range(3)]) >= least).all(), figure
        assert (np.array([truth.in_order(level, number) for level in range(3)]) >= fewest).all(), figure
