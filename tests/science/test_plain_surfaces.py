"""Training on uniform areas of measured surfaces, in addition to the patches of scenes (docs/method.md#uniform-surfaces)."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.layers import MosaicLayer
from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import LightSpectrum, white_signal
from l3cli.classes.features import ClassRecipe
from l3cli.classes.rule import make_rule
from l3cli.classes.windows import neighbourhoods
from l3cli.frames.scene import NO_ILLUMINANT, Polarisation, Scene
from l3cli.physics import spectra
from l3cli.physics.display import delta_e_2000, lab
from l3cli.physics.stokes import COLOUR_STOKES, STOKES
from l3cli.simulation.frame import simulate
from l3cli.simulation.light import OUTPUTS, Target, make_light
from l3cli.simulation.recipe import Lens
from l3cli.training.plain_surfaces import (
    GREY_SHARE,
    MIN_SURFACES,
    POLARISED_DEVIATION,
    POLARISED_NODES,
    PlainSurfaces,
    at_taps,
    false_colours,
    plain_surfaces,
    polarised_grey,
)  # fmt: skip
from l3cli.training.solve import DIRECTED_SURFACES
from tests.helpers.calls import L3
from tests.helpers.paths import CONFIGS

SCENES = """
illuminants = {lights}
exposure_share = [0.9]
[target]
outputs = "{outputs}"
[[scene]]
source = "dead leaves"
size = [80, 80]
count = 4
"""
CLASSES = """
[classes]
patch = 5
levels = {levels}
chromas = {chromas}
contrasts = []
[learning]
patches = 1500
draws = 3
first_draws = 0
plain_surfaces = {weight}
"""
STRIPES = 6  # that have a chroma with the five-band camera, the first ones
DIRECTION = """
[classes.direction]
orientations = 4
strengths = [2.0]
"""


def surfaces_of(camera: CameraModel, light: str, target: str | None = None) -> tuple[PlainSurfaces | None, np.ndarray]:
    """Surfaces under a light with outputs under another, and the white of that."""
    one, other = (spectrum(camera, name) for name in (light, target or light))
    white = spectra.xyz_weights(other.wavelength) @ other.radiance
    return plain_surfaces(camera, one, other, white / white[1]), white / white[1]


def spectrum(camera: CameraModel, light: str) -> LightSpectrum:
    return make_light(light, {}, camera.wavelength).spectrum


@pytest.fixture(scope="module")
def fiveband() -> CameraModel:
    return load_camera(CONFIGS / "cameras/fiveband.toml")


@pytest.mark.parametrize(("light", "target"), [("D65", None), ("A", None), ("F2", "D65")])
def test_surfaces_are_learned_as_they_are(fiveband: CameraModel, light: str, target: str | None) -> None:
    """The transform that the moments alone give answers every surface with about its colour."""
    surfaces, white = surfaces_of(fiveband, light, target)
    assert surfaces is not None
    rule = make_rule(ClassRecipe(patch=5, levels=2, chromas=0), fiveband, np.zeros(32, np.uint16))
    window = neighbourhoods(fiveband.cfa, 5, 5).channel[5]
    (moments,) = surfaces.moments(rule, window)
    assert moments is not None
    assert np.allclose(moments, moments.T)
    taps = window.size
    system = moments[:taps, :taps] + 1e-9 * np.eye(taps)
    transform = np.linalg.solve(system, moments[:taps, taps + 1 :])
    error = delta_e_2000(lab(surfaces.signals[:, window] @ transform, white), lab(surfaces.outputs, white))
    assert np.median(error) < (0.8 if target is None else 1.6)
    assert moments[taps].any() == False  # noqa: E712  no intercept: darkness is answered with darkness


def test_paint_counts_where_noise_leaves_it_open(fiveband: CameraModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """White paint and pale yellow differ by less than noise: with greys of paint among the surfaces, paint is believed."""
    surfaces, white = surfaces_of(fiveband, "D65")
    assert surfaces is not None
    rule = make_rule(ClassRecipe(patch=5, levels=2, chromas=0), fiveband, np.zeros(32, np.uint16))
    window = neighbourhoods(fiveband.cfa, 5, 5).channel[0]
    errors = []
    for share in (0.0, GREY_SHARE):
        monkeypatch.setattr("l3cli.training.plain_surfaces.GREY_SHARE", share)
        (moments,) = surfaces.moments(rule, window)
        assert moments is not None
        taps = window.size
        transform = np.linalg.solve(moments[:taps, :taps] + 1e-4 * np.eye(taps), moments[:taps, taps + 1 :])
        paints = np.s_[-surfaces.greys :]
        shown = surfaces.signals[paints][:, window] @ transform
        errors.append(delta_e_2000(lab(shown, white), lab(surfaces.outputs[paints], white)).mean())
    assert errors[1] < 0.5 * errors[0]


def test_outputs_of_another_observer_are_not_taught(fiveband: CameraModel) -> None:
    light = spectrum(fiveband, "D65")
    functions = spectra.colour_matching_functions(light.wavelength, "CIE 1964")
    white = spectra.matching_weights(functions, light.wavelength) @ light.radiance
    assert plain_surfaces(fiveband, light, light, white / white[1]) is None


def test_a_chroma_of_few_surfaces_is_left_to_its_patches(fiveband: CameraModel) -> None:
    surfaces, _ = surfaces_of(fiveband, "D65")
    assert surfaces is not None
    left = np.r_[: MIN_SURFACES * 5 - 1, len(surfaces.signals) - surfaces.greys : len(surfaces.signals)]
    few = replace(surfaces, signals=surfaces.signals[left], outputs=surfaces.outputs[left])
    rule = make_rule(ClassRecipe(patch=5, levels=2, chromas=0), fiveband, np.zeros(32, np.uint16))
    assert few.moments(rule, neighbourhoods(fiveband.cfa, 5, 5).channel[0]) == [None]


def learned(
    lights: list[str],
    weight: float,
    folder: Path,
    l3: L3,
    more: str = "",
    levels: int = 2,
    chromas: int = 6,
    camera: str = "fiveband",
    outputs: str = "CIE 1931",
) -> TransformTable:
    """A small table of a camera, of classes with `more` keys."""
    folder.mkdir(exist_ok=True)
    (folder / "scenes.toml").write_text(SCENES.format(lights=str(lights).replace("'", '"'), outputs=outputs))
    (folder / "classes.toml").write_text(CLASSES.format(weight=weight, levels=levels, chromas=chromas) + more)
    if not (folder / "scenes.h5").exists():
        recipe = CONFIGS / f"cameras/{camera}.toml"
        assert l3("simulate", folder / "scenes.toml", "--camera", recipe, "-o", folder / "scenes.h5", "--quiet")[0] == 0
    table = folder / f"table {weight}.h5"
    assert l3("train", folder / "scenes.h5", "--classes", folder / "classes.toml", "-o", table, "--quiet")[0] == 0
    return load(TransformTable, table)


def chart_error(table: TransformTable, camera: CameraModel) -> float:
    """Mean ΔE00 of what the unsaturated classes of a mean level make of plain areas of a ColorChecker, at all sites."""
    light, rule = spectrum(camera, "D65"), table.first.rule
    grid = light.wavelength
    lit = spectra.colorchecker(grid)[1] * light.radiance
    seen = spectra.resample(lit, grid, camera.wavelength) @ camera.electron_weights.T
    signals = seen * (camera.saturation_exposure / camera.full_scale)
    matching = spectra.xyz_weights(grid)
    luminance = matching[1] @ light.radiance
    white, wanted = matching @ light.radiance / luminance, lit @ matching.T / luminance
    chromas = np.argmin(signals @ rule.chroma_weights.T, axis=1)
    errors = []
    for site, window in enumerate(neighbourhoods(camera.cfa, rule.patch, 5).channel):
        classes = site * rule.classes_per_site + rule.join(2, 0, chromas)
        shown = np.einsum("pot,pt->po", table.first.weights[classes], signals[:, window])
        errors.append(delta_e_2000(lab(shown, white), lab(wanted, white)))
    return float(np.mean(errors))


def stripe_chroma(table: TransformTable, camera: CameraModel) -> float:
    """Largest C*ab of what the unsaturated classes of a mean level make of stripes of false colours, at all sites."""
    light, rule = spectrum(camera, "D65"), table.first.rule
    white = white_signal(light, camera) / white_signal(light, camera).sum()
    wanted = spectra.xyz_weights(light.wavelength) @ light.radiance
    stripes = false_colours(camera, light.wavelength, light.radiance.astype(float))
    signals = white * (1 + 0.7 * stripes)
    chromas = np.argmin(signals @ rule.chroma_weights.T, axis=1)
    chroma = []
    for site, window in enumerate(neighbourhoods(camera.cfa, rule.patch, 5).channel):
        weights = table.first.weights[site * rule.classes_per_site + rule.join(2, 0, chromas)]
        shown = np.einsum("pot,pt->po", weights, signals[:, window])
        scale = shown[:, 1].mean()  # as bright as a white, whatever the unit
        chroma.append(np.hypot(*lab(shown / scale, wanted / wanted[1])[:, 1:].T).max())
    return float(np.max(chroma))


def change(one: TransformTable, other: TransformTable, level: int, white: bool = False) -> float:
    """Relative difference of the weights of a level's unsaturated classes of surfaces, or of those of white alone."""
    rule = one.first.rule
    place = rule.split(np.arange(len(one.first.weights)))
    of = (place.level == level) & (place.kind >= (rule.chromas - 1 if white else STRIPES)) & (place.kind < rule.chromas)
    return float(np.abs(one.first.weights - other.first.weights)[of].mean() / np.abs(one.first.weights[of]).mean())


def test_plain_colours_of_an_unseen_chart_and_stripes_are_truer(fiveband: CameraModel, tmp_path: Path, l3: L3) -> None:
    without, taught = (learned(["D65"], weight, tmp_path, l3, levels=4) for weight in (0.0, 30.0))
    assert chart_error(taught, fiveband) < 0.8 * chart_error(without, fiveband)
    assert stripe_chroma(taught, fiveband) < 20 < 50 < stripe_chroma(without, fiveband)
    # Where noise hides what a surface is, it is hardly taught, and least what may be a grey.
    assert change(without, taught, level=0) < 0.1 * change(without, taught, level=2)
    assert change(without, taught, level=1, white=True) < 0.02 * change(without, taught, level=2, white=True)


def surface_errors(first: MosaicLayer, camera: CameraModel, chromas: np.ndarray) -> np.ndarray:
    """Mean ΔE00 (direction) of the measured surfaces in classes with a direction, at site 0 and a mean level.

    `chromas` contains the chroma of each surface.
    """
    surfaces, white = surfaces_of(camera, "D65")
    assert surfaces is not None
    signals = surfaces.signals[:, neighbourhoods(camera.cfa, first.rule.patch, len(camera.channels)).channel[0]]
    directed = first.weights[first.rule.join(2, 0, chromas, combination=np.arange(1, first.rule.combinations)[:, None])]
    shown = lab(np.einsum("dsot,st->dso", directed, signals, optimize=True), white)
    return delta_e_2000(shown, np.broadcast_to(lab(surfaces.outputs, white), shown.shape)).mean(axis=1)


def test_classes_of_a_direction_are_trained_on_surfaces_with_a_small_weight(
    fiveband: CameraModel, tmp_path: Path, l3: L3
) -> None:
    """A textured surface keeps its colour. A larger weight would make uniform patches more important than edges."""
    surfaces, _ = surfaces_of(fiveband, "D65")
    assert surfaces is not None
    errors, weights = [], []
    for weight in (0.0, 30.0, 30.0 / DIRECTED_SURFACES):
        first = learned(["D65"], weight, tmp_path, l3, DIRECTION, levels=4).first
        chromas = np.argmin(surfaces.signals @ first.rule.chroma_weights.T, axis=1)
        errors.append(surface_errors(first, fiveband, chromas))
        weights.append(first.weights[first.rule.join(2, 0, chromas, combination=1)])
    assert (errors[1] < 0.97 * errors[0]).all()
    assert np.abs(weights[1] - weights[0]).mean() < 0.5 * np.abs(weights[2] - weights[0]).mean()


def test_classes_of_a_direction_are_taught_surfaces_where_there_are_no_chromas(tmp_path: Path, l3: L3) -> None:
    """An edge then hides no chroma, and a patch keeps the colour of its middle towards its edges."""
    camera, errors = load_camera(CONFIGS / "cameras/rccb.toml"), []
    for weight in (0.0, 30.0):
        first = learned(["D65"], weight, tmp_path, l3, DIRECTION, levels=4, chromas=1, camera="rccb").first
        surfaces, _ = surfaces_of(camera, "D65")
        assert surfaces is not None
        errors.append(surface_errors(first, camera, np.zeros(len(surfaces.signals), int)))
    assert errors[1].max() < 0.95 * errors[0].min()


def test_training_under_several_lights_is_left_to_its_patches(tmp_path: Path, l3: L3) -> None:
    """Their mean is the light of none of them."""
    without, taught = (learned(["D65", "A"], weight, tmp_path, l3) for weight in (0.0, 3.0))
    assert taught.light is not None
    assert taught.light.spread > 0.1
    np.testing.assert_array_equal(taught.first.weights, without.first.weights)


@pytest.mark.parametrize(("name", "outputs"), [("polarised", STOKES), ("polarised_colour", COLOUR_STOKES)])
def test_the_polarised_grey_is_what_the_simulation_makes_of_it(name: str, outputs: tuple[str, ...]) -> None:
    """Each Stokes parameter at each wavelength changes signals and outputs as in a simulated frame of a uniform grey."""
    camera = replace(load_camera(CONFIGS / f"cameras/{name}.toml"), rows=16, cols=16)
    light = make_light("D65", {}, camera.wavelength).at(100.0)
    kind = next(kind for kind, names in OUTPUTS.items() if names == outputs)
    target, values = Target(outputs, "", kind), []
    nodes = np.eye(2 * POLARISED_NODES.size).reshape(-1, 2, POLARISED_NODES.size)
    for ratio in [np.zeros_like(nodes[0]), *nodes]:
        every = np.broadcast_to(ratio.astype(np.float32), (16, 16, *ratio.shape)).copy()
        grey = np.ones((16, 16, camera.wavelength.size), np.float32)
        scene = Scene("grey", camera.wavelength, grey, NO_ILLUMINANT, polarisation=Polarisation(POLARISED_NODES, every))
        made = simulate(camera, scene, light, 0.01, Lens(diffraction=False), (0,), target, "none")
        values.append(np.concatenate([each[:, 8, 8] for each in (made.electrons, made.target)]).astype(np.float64))
    plain, channels = values[0], len(camera.channels)
    luminance = plain[channels:][outputs.index("Y" if "Y" in outputs else "S0")]
    scale = np.where(np.arange(plain.size) < channels, plain[:channels].mean(), luminance)
    change = (np.array(values[1:]) - plain) / scale * POLARISED_DEVIATION
    moments = polarised_grey(camera, light.spectrum, outputs)
    signal = white_signal(light.spectrum, camera).mean()
    units = np.where(np.arange(plain.size) < channels, signal, 1.0)
    columns = np.delete(np.arange(len(moments)), channels)
    wanted = change.T @ change * units[:, None] * units / signal
    np.testing.assert_allclose(moments[np.ix_(columns, columns)], wanted, rtol=2e-3, atol=2e-3 * wanted.max())
    assert not moments[channels].any()


def test_polarisation_of_uniform_areas_is_not_inferred_from_other_colours(tmp_path: Path, l3: L3) -> None:
    """Classes trained on the polarised grey compute its S1 and S2, at any polarisation of the colours."""
    camera, errors = load_camera(CONFIGS / "cameras/polarised_colour.toml"), []
    window = neighbourhoods(camera.cfa, 5, len(camera.channels)).channel[0]
    moments = at_taps(polarised_grey(camera, spectrum(camera, "D65"), COLOUR_STOKES), window)
    outputs = window.size + 1 + np.array([COLOUR_STOKES.index("S1"), COLOUR_STOKES.index("S2")])
    power = moments[outputs, outputs]
    for weight in (0.0, 30.0):
        first = learned(
            ["D65"],
            weight,
            tmp_path,
            l3,
            DIRECTION,
            levels=4,
            chromas=1,
            camera="polarised_colour",
            outputs="CIE 1931 + Stokes",
        ).first
        rows = first.weights[first.rule.join(2, 0, 0, combination=np.arange(first.rule.combinations)), 3:, : window.size]
        made = np.einsum("dot,tu,dou->do", rows, moments[: window.size, : window.size], rows, optimize=True)
        both = np.einsum("dot,to->do", rows, moments[: window.size, outputs])
        errors.append((power - 2 * both + made) / power)
    assert errors[1].max() < 0.01
    assert errors[1].max() < 0.2 * errors[0].min()
