"""Accuracy of 31 reflectances estimated from 16 bands, compared with two common methods (docs/measurement.md#reflectances).

python -m pytest -m slow -s tests/studies/test_reflectance_study.py      needs L3_DATA; five minutes on a core

The snapshot camera records three multispectral scenes and five faces under D65, with and without noise. The table is trained
only on dead leaves. The metrics are the metrics of `l3 evaluate --border 10 --json`.
"""

import json
from pathlib import Path

import pytest

from l3cli.evaluation.reflectance import ESTIMATES
from tests.helpers.bands import BORDER, unseen_scenes
from tests.helpers.calls import L3

FRAMES, PATCHES = 50, 40000  # a third of what scenes and classes "bands" have
SHOWN = ("rmse", "gfc", "mean_angle", "delta_e_a", "delta_e_d65", "delta_e_f11")
LARGEST_RMSE = {"all": 0.021, "none": 0.020}  # mean over the scenes, by what noise the frames have
HEAD = 'illuminants = ["D65"]\nexposure_share = [0.9]\ntarget.outputs = "reflectance 31"\n'
LEAVES = '[[scene]]\nsource = "dead leaves"\nsize = [160, 160]\ncount = {count}\n'
pytestmark = pytest.mark.slow


def test_reflectances_are_better_known_than_by_estimates(
    tmp_path: Path, l3_data: Path, l3: L3, capsys: pytest.CaptureFixture[str]
) -> None:
    scenes = {"leaves": HEAD + LEAVES.format(count=FRAMES)}
    hidden = unseen_scenes(l3_data).partition("[[scene]]")
    scenes |= {noise: f'{HEAD}sensor.noise = "{noise}"\n{hidden[1]}{hidden[2]}' for noise in LARGEST_RMSE}
    for name, text in scenes.items():
        (tmp_path / f"{name}.toml").write_text(text)
        made = "--camera", "snapshot16", "-o", tmp_path / f"{name}.h5", "--jobs", 2, "--quiet"
        assert l3("simulate", tmp_path / f"{name}.toml", *made)[0] == 0
    classes = Path(__file__).parents[2].joinpath("configs/classes/bands.toml").read_text()
    fewer = classes.replace("patches = 120000", f"patches = {PATCHES}").replace("mosaics = 6000", "mosaics = 2000")
    (tmp_path / "classes.toml").write_text(fewer)
    arguments = "--classes", tmp_path / "classes.toml", "-o", tmp_path / "table.h5", "--jobs", 2, "--quiet"
    assert l3("train", tmp_path / "leaves.h5", *arguments)[0] == 0
    for noise, most in LARGEST_RMSE.items():
        code, out, _ = l3(
            "evaluate", tmp_path / "table.h5", tmp_path / f"{noise}.h5", "--border", BORDER, "--json", "--quiet"
        )
        assert code == 0
        document = json.loads(out)
        with capsys.disabled():
            for frame in [*document["frames"], {"scene": "mean", **document["mean"]}]:
                for name in ("ours", *ESTIMATES):
                    values = " ".join(f"{frame[name][figure]:7.4f}" for figure in SHOWN)
                    print(f"noise {noise:5} {frame['scene']:24} {name:7} {values}", flush=True)
        for frame in document["frames"]:
            assert frame["ours"]["rmse"] < min(frame[name]["rmse"] for name in ESTIMATES), (noise, frame["scene"])
        assert document["mean"]["ours"]["rmse"] <= most
