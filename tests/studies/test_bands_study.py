"""How good 16 bands are on scenes that training has not seen, and that no switch of the shipped recipe is better off
(docs/method.md#equal-response).

python -m pytest -m slow -s tests/studies/test_bands_study.py      needs L3_DATA; ten minutes on two cores

The snapshot camera sees three multispectral scenes and five faces; training sees dead leaves alone. Figures are means over
the bands and scenes: PSNR with a perfect white of each band as 1.
"""

from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import open_training_set
from l3cli.cli import run
from l3cli.frame import RawFrame
from l3cli.rendering.renderer import make_renderer
from tests.helpers.paths import CONFIGS

CAMERA = CONFIGS / "cameras/snapshot16.toml"
DAYS, FACES = ("01", "06", "13"), (1, 2, 4, 5, 6)
NANOMETRES = [405, 435, 450, 470, 505, 525, 570, 590, 630, 645, 660, 700, 780, 850, 870, 890, 910, 940, 970]
MARGIN = 10  # pixels
NOISE_DIFFERENCE = 0.1  # dB: smaller differences are chance
WITHOUT = {
    "equal response": "equal_response = false",
    "noise covariance": "luminance_noise = 0.0",
    "half the weight on noise": "luminance_noise = 0.5",
    "level pooling": "level_pool = []",
}

pytestmark = pytest.mark.slow


def _simulated(folder: Path, name: str, recipe: str) -> Path:
    (folder / f"{name}.toml").write_text(recipe)
    training = folder / f"{name}.h5"
    assert run(["simulate", str(folder / f"{name}.toml"), "--camera", str(CAMERA), "-o", str(training), "--quiet"]) == 0
    return training


def _psnr(table: TransformTable, training: Path) -> float:
    """dB, mean over the bands of the only frame."""
    with open_training_set(training) as reader:
        camera, frame = reader.head.camera, next(iter(reader))
    raw = RawFrame(frame.scene, frame.raw, camera.black_level, camera.white_level)
    shown = make_renderer("opencl", table).outputs(raw) * (table.output_unit / frame.exposure)
    error = ((shown - frame.target) / frame.white[:, None, None])[:, MARGIN:-MARGIN, MARGIN:-MARGIN]
    return float(np.mean(-10 * np.log10((error.astype(np.float64) ** 2).mean(axis=(1, 2)))))


def test_no_switch_is_better_off(tmp_path: Path, l3_data: Path) -> None:
    head = 'illuminants = ["D65"]\nexposure_share = [0.9]\n[target]\noutputs = "camera"\n[[scene]]\n'
    sources = [
        f'source = "cube"\nfile = "{l3_data}/scenes/multispectral_day{day}.mat"\nwavelengths_nm = {NANOMETRES}\n'
        for day in DAYS
    ] + [f'source = "iset"\nfile = "{l3_data}/scenes/people_small_{face}_scene.mat"\n' for face in FACES]
    unseen = [_simulated(tmp_path, f"unseen{index}", head + source) for index, source in enumerate(sources)]
    leaves = _simulated(tmp_path, "leaves", (CONFIGS / "scenes/bands.toml").read_text())
    shipped = (CONFIGS / "classes/default.toml").read_text()
    psnr = {}
    for name, key in {"nothing": "", **WITHOUT}.items():
        lines = [line for line in shipped.splitlines() if not key or not line.startswith(f"{key.split()[0]} ")]
        (tmp_path / "classes.toml").write_text("\n".join(lines).replace("[learning]", f"[learning]\n{key}"))
        arguments = [
            "train",
            leaves,
            "--classes",
            tmp_path / "classes.toml",
            "-o",
            tmp_path / "table.h5",
            "--force",
            "--quiet",
        ]
        assert run([str(argument) for argument in arguments]) == 0
        psnr[name] = np.mean([_psnr(load(TransformTable, tmp_path / "table.h5"), one) for one in unseen])
        print(f"without {name:24} {psnr[name]:6.2f} dB", flush=True)
    assert psnr["nothing"] >= 38.4
    assert max(psnr.values()) <= psnr["nothing"] + NOISE_DIFFERENCE
