"""What white balance is worth under eight lights that a table trained under D65 has not seen (docs/method.md#scene-white).

python -m pytest -m slow -s tests/studies/test_white_study.py      needs L3_DATA; three minutes on a core

Five faces, leaves and a composition, each under eight lights, on a Bayer table of few leaves by the recipe `fast`, or on the
table that L3_TABLE names with its camera in L3_CAMERA. Mean ΔE00 of pictures beside ideal ones under the same light, both
adapted to D65, as "l3 evaluate" compares them, after a common exposure.
"""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingPair, open_training_set
from l3cli.evaluation.quality import cropped
from l3cli.frame import RawFrame
from l3cli.physics import spectra
from l3cli.physics.display import displayed, displayed_delta_e, srgb_from_xyz_matrix, white_luminance
from l3cli.rendering.auto_white import AutoWhite
from l3cli.rendering.balance import WhiteBalance, balanced, plain_balance
from l3cli.rendering.renderer import Renderer, make_renderer
from l3cli.rendering.white import Whites
from l3cli.rendering.white_source import usual_balance

LIGHTS = ("2500K", "3200K", "4000K", "D5000K", "9000K", "F2", "F11", "LED-B3")
BORDER = 8  # pixels
HEAD = "illuminants = [{}]\nexposure_share = [{}]\n"
UNSEEN = """
[[scene]]
source = "composition"
size = [240, 426]
seed = 7
[[scene]]
source = "dead leaves"
size = [200, 200]
count = 3
seed = 91
"""
FEW = (
    HEAD.format('"{}"', 0.9)
    + """
[[scene]]
source = "dead leaves"
size = [160, 160]
count = 12
[[scene]]
source = "surfaces"
size = [160, 160]
count = 3
patches = [4, 4]
"""
)
pytestmark = pytest.mark.slow


def error(renderer: Renderer, frame: TrainingPair, raw: RawFrame, balance: WhiteBalance) -> float:
    """Mean ΔE00 of the picture of a frame."""
    outputs = renderer.outputs(balanced(raw, renderer.table, balance.gains))
    shown = np.einsum("oc,crk->ork", balance.adaptation, outputs)
    ideal = np.einsum("oc,crk->ork", plain_balance(frame.white, 1).adaptation, frame.target)
    exposed = shown * ((shown[1] * ideal[1]).sum() / (shown[1] ** 2).sum())
    scale = white_luminance(frame.target[1])
    linear = np.clip(np.einsum("oc,crk->rko", srgb_from_xyz_matrix() / scale, exposed), 0.0, 1.0)
    return float(cropped(displayed_delta_e(linear, displayed(frame.target, frame.white, scale)), BORDER).mean())


def test_eight_lights(tmp_path: Path, l3_data: Path, l3: Callable, capsys: pytest.CaptureFixture[str]) -> None:
    camera = os.environ.get("L3_CAMERA", "bayer")
    faces = "".join(
        f'[[scene]]\nsource = "iset"\nfile = "{l3_data}/scenes/people_small_{face}_scene.mat"\n' for face in (1, 2, 4, 5, 6)
    )
    (tmp_path / "unseen.toml").write_text(HEAD.format(str(LIGHTS)[1:-1].replace("'", '"'), 0.8) + faces + UNSEEN)
    assert l3("simulate", tmp_path / "unseen.toml", "--camera", camera, "-o", tmp_path / "unseen.h5", "--quiet")[0] == 0
    trained = {"D65": Path(os.environ["L3_TABLE"])} if "L3_TABLE" in os.environ else {}
    for light in () if trained else ("D65", "2500K", "F2"):
        (tmp_path / f"{light}.toml").write_text(FEW.format(light))
        trained[light] = tmp_path / f"{light}.table.h5"
        few = tmp_path / f"{light}.h5"
        assert l3("simulate", tmp_path / f"{light}.toml", "--camera", camera, "-o", few, "--quiet")[0] == 0
        assert l3("train", few, "--classes", "fast", "-o", trained[light], "--quiet")[0] == 0
    renderers = {light: make_renderer("opencl", load(TransformTable, path)) for light, path in trained.items()}
    found = measured(renderers, tmp_path / "unseen.h5")
    with capsys.disabled():
        print(f"\n{'mean ΔE00':28}" + "".join(f"{light:>8}" for light in LIGHTS) + f"{'mean':>8}")
        for name, of_light in found.items():
            means = [float(np.mean(of_light[light])) if of_light[light] else float("nan") for light in LIGHTS]
            print(f"{name:28}" + "".join(f"{mean:8.2f}" for mean in means) + f"{np.nanmean(means):8.2f}", flush=True)
    mean = {name: float(np.mean([float(np.mean(each)) for each in of.values() if each])) for name, of in found.items()}
    assert mean["camera"] < 0.9 * mean["adapted from its grey"] < mean["adapted from x,y"]
    assert mean["auto"] < 0.6 * mean["the table's white"]


def measured(renderers: dict[str, Renderer], unseen: Path) -> dict[str, dict[str, list[float]]]:
    """Errors of every frame, by way of balancing and light."""
    renderer = renderers["D65"]
    table, whites = renderer.table, Whites(renderer.table)
    auto = AutoWhite(whites)
    found: dict[str, dict[str, list[float]]] = {}
    with open_training_set(unseen) as reader:
        camera = reader.head.camera
        for frame in reader:
            dark = camera.dark_signal(frame.dark_time)
            raw = RawFrame(frame.scene, frame.raw, camera.black_level, camera.white_level, dark=dark)
            neutral = camera.electron_weights @ spectra.illuminant(frame.illuminant, camera.wavelength)
            estimated = auto.white(raw)
            assert estimated
            channels = len(table.channels)
            grey = whites.grey.outputs_of(0.4 * neutral[None] / neutral.max())[0]
            for name, balance in {
                "the table's white": usual_balance(table),
                "adapted from x,y": plain_balance(frame.white, channels),
                "adapted from its grey": plain_balance(grey, channels),
                "camera": whites.of_neutral(neutral).balance,
                "auto": estimated.balance,
            }.items():
                errors = found.setdefault(name, {light: [] for light in LIGHTS})
                errors[frame.illuminant].append(error(renderer, frame, raw, balance))
            if frame.illuminant in renderers:
                errors = found.setdefault("a table trained under it", {light: [] for light in LIGHTS})
                own = plain_balance(frame.white, channels)
                errors[frame.illuminant].append(error(renderers[frame.illuminant], frame, raw, own))
    return found
