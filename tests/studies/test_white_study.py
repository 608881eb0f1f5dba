"""What white balance is worth under eight lights that a table has not seen (docs/method.md#scene-white).

python -m pytest -m slow -s tests/studies/test_white_study.py      needs L3_DATA; six minutes on a core

Five faces, leaves and a composition, each under eight lights, on a Bayer table of few leaves by the recipe `fast`, or on the
table that L3_TABLE names with its camera in L3_CAMERA. Mean ΔE00 of pictures beside ideal ones under the same light, both
adapted to D65, as "l3 evaluate" compares them, after a common exposure.

The second test asks what transforms learned under several lights and mixed for that of the scene would gain; its camera is
that of L3_CAMERA too, its class recipe the built-in one, or file, of L3_CLASSES.
"""

import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest

from l3cli.artifacts.layers import MosaicLayer, PlaneLayer
from l3cli.artifacts.partial_sums import ClassSums
from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import LightSpectrum, TrainingPair, open_training_set
from l3cli.evaluation.quality import cropped
from l3cli.frame import RawFrame
from l3cli.parallel import workers
from l3cli.physics import spectra
from l3cli.physics.display import displayed, displayed_delta_e, srgb_from_xyz_matrix, white_luminance
from l3cli.physics.near_lights import temperature
from l3cli.recipes import known_recipes
from l3cli.rendering.auto_white import AutoWhite
from l3cli.rendering.balance import WhiteBalance, balanced, plain_balance
from l3cli.rendering.renderer import Renderer, make_renderer
from l3cli.rendering.white import SceneWhite, Whites
from l3cli.rendering.white_source import usual_balance
from l3cli.stages.console import Silent
from l3cli.stages.training.later_layers import layer_mosaics, layer_pass, layer_rule, summed_layer
from l3cli.stages.training.passes import Execution, first_pass, learn_unit, summed
from l3cli.stages.training.run import open_run
from l3cli.training.division import frame_blocks
from l3cli.training.layers.learn import learn_layer
from l3cli.training.table import assemble, learn_site
from l3cli.training.training_pass import LAST

LIGHTS = ("2500K", "3200K", "4000K", "D5000K", "9000K", "F2", "F11", "LED-B3")
BLACK_BODIES_AND_LAMPS = ("2500K", "3200K", "4000K", "D5000K", "6500K", "9000K", "F2", "LED-B3")
MIXED = {("A", "D65"): "two", ("2300K", "D4300K", "D10000K"): "three"}  # lights of training, the coolest last
GAIN = 0.1  # ΔE00, from which on it would be worth the trouble
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
Layer = TypeVar("Layer", MosaicLayer, PlaneLayer)
Found = dict[str, dict[str, list[float]]]  # errors of frames, by way of balancing and light
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


@pytest.fixture
def simulated(tmp_path: Path, l3_data: Path, l3: Callable) -> Callable[[tuple[str, ...], str, float], Path]:
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
    tmp_path: Path, simulated: Callable, unseen: Callable, l3: Callable, capsys: pytest.CaptureFixture[str]
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


def test_transforms_of_several_lights_gain_nothing(
    simulated: Callable, unseen: Callable, capsys: pytest.CaptureFixture[str]
) -> None:
    """What each light of training has of its own, mixed for the light of the scene, beside what tables do without."""
    every = {light for lights in MIXED for light in lights} | {"D65"}
    sets = {light: simulated((light,), FEW.format(20, 5), 0.9) for light in sorted(every)}
    one = learned((sets["D65"],))
    together = {lights: learned(tuple(sets[light] for light in lights)) for lights in MIXED}
    apart = {lights: [learned((sets[light],), together[lights]) for light in lights] for lights in MIXED}
    found: Found = {}
    balances: dict[tuple[str, str, str], tuple[Renderer, WhiteBalance]] = {}
    for frame, raw in frames_of(unseen(BLACK_BODIES_AND_LAMPS)):
        tables = {"one light, D65": one}
        tables |= {f"{name} lights together": together[lights] for lights, name in MIXED.items()}
        tables |= {f"{name} lights, mixed": mixed(apart[lights], frame.white) for lights, name in MIXED.items()}
        for name, table in tables.items():
            for given in ("light", "neutral", "x,y"):
                key = name, given, frame.illuminant
                if key not in balances:
                    balances[key] = make_renderer("opencl", table), given_as(given, table, frame).balance
                errors = found.setdefault(f"{name}: {given} given", {light: [] for light in BLACK_BODIES_AND_LAMPS})
                errors[frame.illuminant].append(error(balances[key][0], frame, raw, balances[key][1]))
    mean = shown(found, BLACK_BODIES_AND_LAMPS, capsys)
    for given in ("light", "neutral", "x,y"):
        of = {name.split(":")[0]: value for name, value in mean.items() if name.endswith(f": {given} given")}
        best = min(value for name, value in of.items() if "mixed" in name)
        assert min(value for name, value in of.items() if "mixed" not in name) - best < GAIN


def given_as(given: str, table: TransformTable, frame: TrainingPair) -> SceneWhite:
    """The white of a frame of which its light, its neutral or its chromaticity is known."""
    whites, camera = Whites(table), table.camera
    assert camera
    if given == "light":
        return whites.of_light(frame.illuminant)
    if given == "neutral":
        return whites.of_neutral(camera.signal_weights @ spectra.illuminant(frame.illuminant, camera.wavelength))
    return whites.of_chromaticity(frame.white)


def learned(training: tuple[Path, ...], alike: TransformTable | None = None) -> TransformTable:
    """As "l3 train" makes it or, so that transforms can be mixed, with the class rules of the table `alike`."""
    classes = os.environ.get("L3_CLASSES", "fast")
    run = open_run(training, known_recipes("classes").get(classes, Path(classes)), None, 0)
    with workers(1, None) as crew:
        execution = Execution(crew, False, Silent())
        pass_, table = first_pass(run, execution), None
        pass_ = replace(pass_, rule=alike.first.rule if alike else pass_.rule)
        for number in range(pass_.number, LAST + 1):
            pass_ = replace(pass_, number=number)
            sums = summed(learn_unit, run, pass_, table, frame_blocks(pass_), execution)
            solved = {site: learn_site(pass_, [one], site) if isinstance(one, ClassSums) else one for site, one in sums}
            table = assemble(pass_, solved, run.history_of_pass(number))
        assert table
        for number in range(len(run.recipe.layer)):
            layer = layer_pass(table, run.recipe, layer_mosaics(run, number), run.seed)
            rule = alike.later[number].rule if alike else layer_rule(run, layer, execution)
            planes = summed_layer(run, layer, rule, range(len(layer.mosaics)), execution)
            table = replace(table, later=(*table.later, learn_layer(layer, rule, planes)))
    return table


def mixed(tables: list[TransformTable], white: np.ndarray) -> TransformTable:
    """Tables of the same classes, the warmest light first, mixed for the light of a white (3): linearly in reciprocal colour
    temperature between the two nearest, not beyond the outer ones."""
    mireds = [1e6 / temperature(table.white_point)[0] for table in tables]
    mired = float(np.clip(1e6 / temperature(white)[0], mireds[-1], mireds[0]))
    cooler = next(place for place in range(1, len(tables)) if mired >= mireds[place])
    warm, cool = tables[cooler - 1], tables[cooler]
    share = (mireds[cooler - 1] - mired) / (mireds[cooler - 1] - mireds[cooler])

    def between(one: Layer, other: Layer) -> Layer:
        weights = one.weights + np.float32(share) * (other.weights - one.weights)
        return replace(one, weights=weights, intercept=one.intercept + np.float32(share) * (other.intercept - one.intercept))

    assert warm.light
    assert cool.light
    radiance = warm.light.radiance + np.float32(share) * (cool.light.radiance - warm.light.radiance)
    return replace(
        warm,
        first=between(warm.first, cool.first),
        later=tuple(map(between, warm.later, cool.later)),
        light=LightSpectrum(warm.light.wavelength, radiance, 0.0),
        white_point=warm.white_point + share * (cool.white_point - warm.white_point),
    )


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
