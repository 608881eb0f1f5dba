"""Accuracy of the calibration of the five-band camera in the virtual lab, for many seeds of lamps, scale and noise.

python -m pytest -m slow -s tests/studies/test_calibration_study.py      21 seeds of the whole sensor; prints all metrics
"""

import json
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.calls import L3
from tests.helpers.paths import CONFIGS

RECIPE = CONFIGS / "cameras/fiveband.toml"
LIMITS = {  # the largest error allowed in any seed, and in any channel where the figure is one of channels
    "overall system gain K": 1.0,
    "temporal dark noise": 3.0,
    "dark current": 5.0,
    "DSNU": 5.0,
    "PRNU": 5.0,
    "responsivity RMS error (% of peak)": 1.0,
    "gain alpha·r error (%)": 0.5,
    "offset error (DN)": 0.3,
}
COVERAGE = (90.0, 99.0)  # % of wavelengths, pooled over seeds and channels


def one_seed(seed: int, recipe: Path, folder: Path, l3: L3) -> dict[str, np.ndarray]:
    """Errors of one session of the virtual lab: % or DN, one a camera or one a channel; and the coverage of the band."""
    assert l3("lab", recipe, "-o", folder / "lab", "--seed", seed, "--jobs", 2, "--quiet")[0] == 0
    command = ("calibrate", folder / "lab/MEASUREMENTS.toml", "-o", folder / "camera.h5", "--truth", recipe, "--json")
    code, out, err = l3(*command, "--force", "--quiet")
    assert (code, err) == (0, "")
    shutil.rmtree(folder / "lab")
    result = json.loads(out)
    truth = result["truth"]
    errors = {name: np.array([entry["error %"]]) for name, entry in truth["camera"].items() if name in LIMITS}
    for name in next(iter(truth["channels"].values())):
        errors[name] = np.array([channel[name] for channel in truth["channels"].values()])
    black_level = truth["camera"]["black level"]["true"]
    errors["offset error (DN)"] = np.array([channel["offset (DN)"] - black_level for channel in result["channels"].values()])
    return errors


def study(seeds: range, recipe: Path, folder: Path, l3: L3, limits: dict[str, float] = LIMITS) -> None:
    """Every seed's errors against the limits, and the pooled coverage; printed."""
    runs = [one_seed(seed, recipe, folder, l3) for seed in seeds]
    lines = []
    for name, limit in limits.items():
        values = np.abs(np.stack([run[name] for run in runs]))
        lines.append(f"{name:36} worst {values.max():8.4f}   RMS {np.sqrt((values**2).mean()):8.4f}   limit {limit}")
    coverage = np.mean([run["within band (%)"] for run in runs])
    print("\n".join([f"\n{len(seeds)} seeds", *lines, f"95 % band covers {coverage:.2f} %, limits {COVERAGE}"]))
    for name, limit in limits.items():
        assert max(np.abs(run[name]).max() for run in runs) < limit, name
    if len(seeds) > 10:
        assert COVERAGE[0] <= coverage <= COVERAGE[1]
    else:
        assert coverage > 80.0  # errors of a wavelength scale or a lamp are common to all wavelengths of a session


@pytest.mark.slow
def test_twenty_one_seeds(tmp_path: Path, l3: L3) -> None:
    study(range(21), RECIPE, tmp_path, l3)


@pytest.mark.slow
def test_a_whole_session_in_time_and_memory(tmp_path: Path, l3: L3) -> None:
    """31 wavelengths × 4, 4 charts × 8, and 6 exposures × 32 of dark and white frames of 2048×1164: 540 frames."""
    (tmp_path / "lab.toml").write_text("""
[mono]
trials = 4
overexposed = 0
[chart]
trials = 8
[white]
levels = [0.05, 0.2, 0.4, 0.6, 0.85, 1.6]
trials = 32
[dark]
exposures_s = [0.01, 0.1, 0.5, 1.0, 1.5, 2.0]
trials = 32
""")
    assert l3("lab", RECIPE, "-o", tmp_path / "lab", "--recipe", tmp_path / "lab.toml", "--jobs", 2, "--quiet")[0] == 0
    assert len(list((tmp_path / "lab").glob("*/*.tif"))) == 540
    command = [
        sys.executable,
        "-c",
        "from l3cli.cli import main; main()",
        "calibrate",
        str(tmp_path / "lab/MEASUREMENTS.toml"),
    ]
    start = time.perf_counter()
    subprocess.run([*command, "-o", str(tmp_path / "camera.h5"), "--quiet"], check=True, stdout=subprocess.DEVNULL)
    seconds = time.perf_counter() - start
    kilobytes = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    print(f"\n540 frames in {seconds:.1f} s, at most {kilobytes / 1e6:.2f} GB")
    shutil.rmtree(tmp_path / "lab")
    assert kilobytes < 1e6
