"""Benefit of white balance under eight illuminants that are not in the training set (docs/method.md#scene-white).

python -m pytest -m slow -s tests/studies/test_white_study.py      needs L3_DATA; a quarter of an hour on a core

Five faces, dead leaves and a composition are simulated under eight illuminants. The table is a Bayer table with few training
scenes and the class recipe `fast`, or the table in L3_TABLE with its camera in L3_CAMERA. The metric is the mean ΔE00
between pictures and ideal pictures under the same illuminant, both adapted to D65, as in `l3 evaluate`, with a common
exposure.

The second test measures the benefit of transforms for single illuminants, of which the nearest is used or two are mixed. It
uses the camera in L3_CAMERA, and the class recipe or file in L3_CLASSES.
"""

import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingPair, open_training_set
from l3cli.evaluation.quality import cropped
from l3cli.frames.frame import RawFrame
from l3cli.physics import spectra
from l3cli.physics.display import SRGB_FROM_XYZ, displayed, displayed_delta_e, white_luminance
from l3cli.recipes.builtin import known_recipes
from l3cli.rendering.conditions import mix_for, mixed, nearest_for
from l3cli.rendering.renderer import Renderer, make_renderer
from l3cli.rendering.white.scene_white import SceneWhite, WhiteBalance, Whites, balanced, plain_balance
from l3cli.rendering.white.source import AutoWhite, usual_balance
from tests.helpers.calls import L3

LIGHTS = ("2500K", "3200K", "4000K", "D5000K", "9000K", "F2", "F11", "LED-B3")
BLACK_BODIES_AND_LAMPS = ("2500K", "3200K", "4000K", "D5000K", "6500K", "9000K", "F2", "LED-B3")
MIXED = {("A", "D65"): "two", ("2300K", "D4300K", "D10000K"): "three"}  # lights of training, the coolest last
GIVEN = ("light", "neutral", "x,y", "auto", "adapted alone")  # what is known of a white
GAIN = 0.05  # ΔE00 that what is taken may be behind the best of all
BORDER = 8  # pixels
HEAD = "illuminants = {}\nexposure_share = [{}]\n"
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
FEW = """
[[scene]]
source = "dead leaves"
size = [160, 160]
count = {}
[[scene]]
source = "surfaces"
size = [160, 160]
count = {}
patches = [4, 4]
"""
CAMERA = os.environ.get("L3_CAMERA", "bayer")
Found = dict[str, dict[str, list[float]]]  # errors of frames, by way of balancing and light
pytestmark = pytest.mark.slow


def error(renderer: Renderer, frame: TrainingPair, raw: RawFrame, balance: WhiteBalance) -> float:
    """Mean ΔE00 of the picture of a frame."""
    outputs = renderer.outputs(balanced(raw, renderer.table, balance.gains))
    shown = np.einsum("oc,crk->ork", balance.adaptation, outputs)
    ideal = np.einsum("oc,crk->ork", plain_balance(frame.white, 1).adaptation, frame.target)
    exposed = shown * ((shown[1] * ideal[1]).sum() / (shown[1] ** 2).sum())
    scale = white_luminance(frame.target[1])
    linear = np.clip(np.einsum("oc,crk->rko", SRGB_FROM_XYZ / scale, exposed), 0.0, 1.0)
    return float(cropped(displayed_delta_e(linear, displayed(frame.target, frame.white, scale)), BORDER).mean())


@pytest.fixture
def simulated(tmp_path: Path, l3_data: Path, l3: L3) -> Callable[[tuple[str, ...], str, float], Path]:
    """Simulates scenes of a recipe under lights, exposed to a share of full scale."""

    def simulate(lights: tuple[str, ...], scenes: str, share: float) -> Path:
        name = f"{'+'.join(lights)} {share}"
        (tmp_path / f"{name}.toml").write_text(HEAD.format(str(list(lights)).replace("'", '"'), share) + scenes)
        made = tmp_path / f"{name}.h5"
        assert l3("simulate", tmp_path / f"{name}.toml", "--camera", CAMERA, "-o", made, "--quiet")[0] == 0
        return made

    return simulate


@pytest.fixture
def unseen(simulated: Callable, l3_data: Path) -> Callable[[tuple[str, ...]], Path]:
    """Simulates the scenes that are judged, under lights."""
    faces = "".join(
        f'[[scene]]\nsource = "iset"\nfile = "{l3_data}/scenes/people_small_{face}_scene.mat"\n' for face in (1, 2, 4, 5, 6)
    )
    return lambda lights: simulated(lights, faces + UNSEEN, 0.8)


def shown(found: Found, lights: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> dict[str, float]:
    """Prints the errors; their means over lights."""
    with capsys.disabled():
        print(f"\n{'mean ΔE00':36}" + "".join(f"{light:>8}" for light in lights) + f"{'mean':>8}")
        for name, of_light in found.items():
            means = [float(np.mean(of_light[light])) if of_light[light] else float("nan") for light in lights]
            print(f"{name:36}" + "".join(f"{mean:8.2f}" for mean in means) + f"{np.nanmean(means):8.2f}", flush=True)
    return {name: float(np.mean([float(np.mean(each)) for each in of.values() if each])) for name, of in found.items()}


def test_eight_lights(
    tmp_path: Path, simulated: Callable, unseen: Callable, l3: L3, capsys: pytest.CaptureFixture[str]
) -> None:
    trained = {"D65": Path(os.environ["L3_TABLE"])} if "L3_TABLE" in os.environ else {}
    for light in () if trained else ("D65", "2500K", "F2"):
        trained[light] = tmp_path / f"{light}.table.h5"
        few = simulated((light,), FEW.format(12, 3), 0.9)
        assert l3("train", few, "--classes", "fast", "-o", trained[light], "--quiet")[0] == 0
    renderers = {light: make_renderer("opencl", load(TransformTable, path)) for light, path in trained.items()}
    mean = shown(measured(renderers, unseen(LIGHTS)), LIGHTS, capsys)
    assert mean["camera"] < 0.9 * mean["adapted from its grey"] < mean["adapted from x,y"]
    assert mean["camera"] < 0.95 * mean["x,y"] < 0.95**2 * mean["adapted from x,y"]
    assert mean["auto"] < 0.6 * mean["the table's white"]


def test_transforms_of_several_lights(
    tmp_path: Path, simulated: Callable, unseen: Callable, l3: L3, capsys: pytest.CaptureFixture[str]
) -> None:
    """Those of the light nearest to that of the scene, or mixed for it, beside what tables do without."""
    every = sorted({light for lights in MIXED for light in lights} | {"D65"})
    sets = {light: simulated((light,), FEW.format(20, 5), 0.9) for light in every}
    classes = os.environ.get("L3_CLASSES", "fast")
    recipe = known_recipes("classes").get(classes, Path(classes)).read_text()
    (tmp_path / "one.toml").write_text(recipe)

    def trained(lights: tuple[str, ...], kind: str) -> TransformTable:
        made = tmp_path / f"{'+'.join(lights)}.table.h5"
        of, key = [sets[light] for light in lights], f"[learning]\nlights = {list(lights)}\n"
        (tmp_path / "several.toml").write_text(recipe.replace("[learning]\n", key, 1))
        assert l3("train", *of, "--classes", tmp_path / f"{kind}.toml", "-o", made, "--quiet")[0] == 0
        return load(TransformTable, made)

    tables = {"one light, D65": trained(("D65",), "one")}
    for lights, name in MIXED.items():
        of_lights = trained(lights, "several")
        tables |= {f"{name} lights together": mixed(of_lights, None), f"{name} lights, nearest": of_lights}
        tables[f"{name} lights, mixed"] = of_lights
    found: Found = {}
    made: dict[tuple[str, str, str], tuple[Renderer, WhiteBalance]] = {}
    for frame, raw in frames_of(unseen(BLACK_BODIES_AND_LAMPS)):
        for name, table in tables.items():
            for given in GIVEN:
                key = name, given, raw.name if given == "auto" else frame.illuminant
                if key not in made or given == "auto":
                    first = given_as(given, table, frame, raw)
                    choice = nearest_for if "nearest" in name else mix_for
                    lit = mixed(table, choice(table, first.light.xyz))
                    made[key] = make_renderer("opencl", lit), given_as(given, lit, frame, raw, table).balance
                errors = found.setdefault(f"{name}: {given}", {light: [] for light in BLACK_BODIES_AND_LAMPS})
                errors[frame.illuminant].append(error(made[key][0], frame, raw, made[key][1]))
    mean = shown(found, BLACK_BODIES_AND_LAMPS, capsys)
    for given in GIVEN:
        of = {name.split(":")[0]: value for name, value in mean.items() if name.endswith(f": {given}")}
        best = min(value for name, value in of.items() if ("mixed" if given == "adapted alone" else "nearest") in name)
        assert best < min(of.values()) + (GAIN if given != "auto" else math.inf)


def given_as(
    given: str, table: TransformTable, frame: TrainingPair, raw: RawFrame, by: TransformTable | None = None
) -> SceneWhite:
    """The white of a frame of which its light, its neutral or its chromaticity is known, or nothing, estimated `by` another
    table; without gains it is only adapted from its chromaticity."""
    whites, camera = Whites(table), table.camera
    assert camera
    if given == "light":
        return whites.of_light(frame.illuminant)
    if given == "neutral":
        return whites.of_neutral(camera.signal_weights @ spectra.illuminant(frame.illuminant, camera.wavelength))
    if given == "auto":
        estimated = AutoWhite(Whites(by) if by else whites, whites).white(raw)
        assert estimated
        return estimated
    return whites.of_chromaticity(frame.white) if given == "x,y" else whites.of_xyz(frame.white)


def frames_of(unseen: Path) -> Iterator[tuple[TrainingPair, RawFrame]]:
    """Frames with their raw values."""
    with open_training_set(unseen) as reader:
        camera = reader.head.camera
        for frame in reader:
            dark = camera.dark_signal(frame.dark_time)
            yield frame, RawFrame(frame.scene, frame.raw, camera.black_level, camera.white_level, dark=dark)


def measured(renderers: dict[str, Renderer], unseen: Path) -> Found:
    """Errors of every frame, by way of balancing and light."""
    renderer = renderers["D65"]
    table, whites = renderer.table, Whites(renderer.table)
    auto = AutoWhite(whites)
    found: Found = {}
    camera = table.camera
    assert camera
    for frame, raw in frames_of(unseen):
        neutral = camera.signal_weights @ spectra.illuminant(frame.illuminant, camera.wavelength)
        estimated = auto.white(raw)
        assert estimated
        channels = len(table.channels)
        grey = whites.grey.outputs_of(0.4 * neutral[None] / neutral.max())[0]
        for name, balance in {
            "the table's white": usual_balance(table),
            "adapted from x,y": plain_balance(frame.white, channels),
            "adapted from its grey": plain_balance(grey, channels),
            "x,y": whites.of_chromaticity(frame.white).balance,
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
