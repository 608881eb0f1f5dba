"""Cameras by name, compared with curves that another laboratory measured.

python -m pytest -m slow -s tests/studies/test_named_study.py      needs L3_DATA

The raw files are simulated with the measured curves. Two tables render these raw files: table 1 is trained with the curves
of the named camera, table 2 with the measured curves.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from l3cli.io.curves import read_finished
from tests.helpers.calls import L3

pytestmark = pytest.mark.slow

MEASURED = {  # measured by two laboratories: name, file of ssf-data
    "nikon_d200": "Nikon_D200__camspec.csv",
    "nikon_d700": "Nikon_D700__camspec.csv",
    "nikon_d5100": "Nikon_D5100__camspec.csv",
    "canon_eos_600d": "Canon_600D__camspec.csv",
}
SCENES = """
illuminants = ["D65"]
luminances_cd_m2 = [400.0]
exposure_share = [0.9]
"""
LEAVES = '[[scene]]\nsource = "dead leaves"\nsize = [160, 160]\ncount = 40\n'
SURFACES = '[[scene]]\nsource = "surfaces"\nsize = [160, 160]\ncount = 6\npatches = [4, 4]\n'
UNSEEN = '[[scene]]\nsource = "composition"\nsize = [360, 640]\nseed = {}\n'
MOST = 0.2  # ΔE00
GRID = np.arange(400.0, 701.0, 10.0)


@pytest.mark.parametrize("name", MEASURED)
def test_named_beside_measured(name: str, tmp_path: Path, l3: L3, l3_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert l3("init", name, "named", "--quiet")[0] == 0
    Path("training.toml").write_text(SCENES + LEAVES + SURFACES)
    Path("unseen.toml").write_text(SCENES + "".join(UNSEEN.format(seed) for seed in (7, 8, 9)))
    curves = read_finished(l3_data / "sensitivities/ssf-data" / MEASURED[name], ["red", "green", "blue"], per_energy=False)
    rows = np.column_stack([GRID, *(np.interp(GRID, curves.wavelength, each) for each in curves.responsivity)])
    np.savetxt("measured.csv", rows, "%.6g", ",", header="wavelength_nm,r,g,b", comments="")
    named = Path("named/camera.toml").read_text()
    Path("named/measured.csv").write_text(Path("measured.csv").read_text())
    Path("named/measured.toml").write_text(named.replace('file = "curves.csv"', 'file = "measured.csv"'))
    cameras = {"named": "named/camera.toml", "measured": "named/measured.toml"}
    unseen = ("simulate", "unseen.toml", "--camera", cameras["measured"], "-o", "unseen.h5", "--dng", "raw", "--quiet")
    assert l3(*unseen)[0] == 0
    for each, camera in cameras.items():
        assert l3("simulate", "training.toml", "--camera", camera, "-o", f"{each}.h5", "--quiet")[0] == 0
        assert l3("train", f"{each}.h5", "-o", f"{each}_table.h5", "--draft", "--quiet")[0] == 0
        to = ("-o", each, "--exposure", "1", "--quiet")
        assert l3("render", f"{each}_table.h5", *sorted(Path("raw").glob("*.dng")), *to)[0] == 0
    judged = ("--rival", "named", "--rival", "measured", "--json", "--quiet")
    code, out, _ = l3("evaluate", "measured_table.h5", "unseen.h5", *judged)
    means = json.loads(out)["mean"]
    errors = {each: means[each]["mean_delta_e"] for each in cameras}
    print(f"{name}: ΔE00 {errors}, {errors['named'] - errors['measured']:+.3f}")
    assert code == 0
    assert errors["named"] - errors["measured"] < MOST
