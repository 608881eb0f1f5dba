"""Polarised scenes: electrons for known Stokes parameters, polarisation of leaves, and angles after framing."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel, Polarisers
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.classes.windows import neighbourhoods
from l3cli.evaluation import standards
from l3cli.evaluation.basic import develop_stokes
from l3cli.evaluation.demosaic import stokes_baselines
from l3cli.evaluation.quality import judge_stokes
from l3cli.frames.scene import NO_ILLUMINANT, Polarisation, Scene
from l3cli.physics.stokes import STOKES, aolp, dolp, stokes_of
from l3cli.recipes.builtin import find_recipe
from l3cli.simulation import procedural
from l3cli.simulation.frame import simulate
from l3cli.simulation.light import CAMERA, OUTPUTS, Target, make_light, stokes_weights
from l3cli.simulation.polarisation import fresnel_degree
from l3cli.simulation.recipe import Lens
from l3cli.simulation.sources import DeadLeaves, WantedScene, on_sensor
from l3cli.training.symmetry import EVERY_ORIENTATION, orientations_of_scenes, stabilisers

TARGET = Target(STOKES, "Stokes parameters", "Stokes")
WAVELENGTH = np.arange(390.0, 711.0, 10.0)


@pytest.fixture(scope="module")
def camera() -> CameraModel:
    return replace(load_camera(find_recipe("polarised", "cameras")), rows=64, cols=64)


def uniform(first: float, second: float, grey: float = 0.5) -> Scene:
    """Return a scene of one grey with the same S1/S0 and S2/S0 everywhere."""
    ratio = np.broadcast_to(np.array([first, second], np.float32)[:, None], (32, 32, 2, 1)).copy()
    cube = np.full((32, 32, WAVELENGTH.size), grey, np.float32)
    return Scene("uniform", WAVELENGTH, cube, NO_ILLUMINANT, polarisation=Polarisation(np.array([550.0]), ratio))


@pytest.mark.parametrize("extinction", [10.0, np.inf])
@pytest.mark.parametrize(("first", "second"), [(0.4, -0.25), (0.9, 0.3)])
def test_electrons_of_known_stokes_parameters(camera: CameraModel, extinction: float, first: float, second: float) -> None:
    """Half of S0 and of the component along the axis is along, the rest across, and the rest passes weakly."""
    angles = np.array([90.0, 30.0, 135.0, 0.0])
    camera = replace(camera, polarisers=Polarisers(angles, np.full(camera.responsivity.shape, 1 / extinction)))
    light = make_light("D65", {}, camera.wavelength).at(100.0)
    made = simulate(camera, uniform(first, second), light, 0.01, Lens(), (0,), TARGET, "none")
    plain = simulate(replace(camera, polarisers=None), uniform(0, 0), light, 0.01, Lens(), (0,), TARGET, "none")
    component = first * np.cos(2 * np.radians(angles)) + second * np.sin(2 * np.radians(angles))
    wanted = (1 + component + (1 - component) / extinction) / 2
    shares = made.electrons[:, 8:24, 8:24] / plain.electrons[:, 8:24, 8:24]
    np.testing.assert_allclose(shares, np.broadcast_to(wanted[:, None, None], shares.shape), rtol=1e-6)
    np.testing.assert_allclose(
        made.target, np.broadcast_to(np.array([first * 50, 50, second * 50])[:, None, None], (3, 32, 32)), rtol=2e-6
    )
    np.testing.assert_array_equal(made.white, [0, made.white[1], 0])


def test_electrons_of_leaves_behind_ideal_polarisers(camera: CameraModel) -> None:
    """Also pixels that are nearly dark behind a polariser agree with arithmetic of 64 bits, relative to their own signal."""
    angles = np.array([90.0, 45.0, 135.0, 0.0])
    ideal = replace(camera, polarisers=Polarisers(angles, np.zeros(camera.responsivity.shape)))
    light = make_light("D65", {}, camera.wavelength).at(100.0)
    scene = procedural.draw(WantedScene(DeadLeaves(size=(64, 64))), 3, camera.wavelength, True)
    assert scene.polarisation is not None
    made = simulate(ideal, scene, light, 0.01, Lens(diffraction=False), (0,), TARGET, "none").electrons
    weights, share = stokes_weights(ideal, light, scene.wavelength), scene.polarisation.weights(scene.wavelength)
    ratio = np.einsum("rcin,nb->ircb", scene.polarisation.ratio.astype(np.float64), share)
    stokes = scene.reflectance * np.concatenate([np.ones((1, *ratio.shape[1:])), ratio])
    wanted = 0.01 * np.einsum("scb,srkb->crk", weights, stokes)
    assert (wanted.min(axis=0) < 0.1 * wanted.max(axis=0)).any()
    np.testing.assert_allclose(made, wanted, rtol=1e-6)


@pytest.mark.parametrize("name", ["polarised", "polarised_colour"])
def test_the_bands_of_a_camera_are_behind_its_polarisers(name: str) -> None:
    """The bands are proportional to the electrons of all channels, and a white without polarisation is in their unit."""
    camera = replace(load_camera(find_recipe(name, "cameras")), rows=32, cols=32)
    light = make_light("D65", {}, camera.wavelength).at(100.0)
    made = simulate(camera, uniform(0.4, -0.25), light, 0.01, Lens(), (0,), Target(camera.channels, "", CAMERA), "none")
    factor = made.electrons / made.target
    np.testing.assert_allclose(factor, np.full_like(factor, factor.mean()), rtol=1e-5)


def test_polarisation_that_depends_on_the_wavelength(camera: CameraModel) -> None:
    """Light that is polarised only at long wavelengths changes the electrons by the share of those wavelengths."""
    scene = uniform(0.0, 0.0)
    ratio = np.zeros((32, 32, 2, 2), np.float32)
    ratio[..., 0, 1] = 1.0  # S1 rises from 0 at 500 nm to S0 at 600 nm
    scene = replace(scene, polarisation=Polarisation(np.array([500.0, 600.0]), ratio))
    light = make_light("D65", {}, camera.wavelength).at(100.0)
    ideal = replace(camera, polarisers=Polarisers(np.array([90.0, 45.0, 135.0, 0.0]), np.zeros(camera.responsivity.shape)))
    made = simulate(ideal, scene, light, 0.01, Lens(), (0,), TARGET, "none").electrons[:, 16, 16]
    assert made[1] == pytest.approx(made[2], rel=1e-5)
    assert made[0] + made[3] == pytest.approx(made[1] + made[2], rel=1e-5)
    assert 0.4 < (made[3] - made[0]) / (made[3] + made[0]) < 0.6


def test_colour_and_stokes_outputs_are_the_same_light(camera: CameraModel) -> None:
    kind = "CIE 1931 + Stokes"
    light = make_light("D65", {}, camera.wavelength).at(100.0)
    both, stokes = (
        simulate(camera, uniform(0.3, 0.1), light, 0.01, Lens(), (0,), Target(OUTPUTS[each], "", each), "none")
        for each in (kind, "Stokes")
    )
    np.testing.assert_allclose(stokes_of(both.target, OUTPUTS[kind]), stokes_of(stokes.target, STOKES), rtol=1e-6)


def test_reflectances_of_leaves_do_not_depend_on_the_polarisation() -> None:
    wanted = WantedScene(DeadLeaves(size=(48, 64), patterned=0.2))
    plain, polarised = (procedural.draw(wanted, 5, WAVELENGTH, each) for each in (False, True))
    np.testing.assert_array_equal(plain.reflectance, polarised.reflectance)
    assert plain.polarisation is None
    again = procedural.draw(wanted, 5, WAVELENGTH, True)
    assert polarised.polarisation is not None
    assert again.polarisation is not None
    np.testing.assert_array_equal(polarised.polarisation.ratio, again.polarisation.ratio)


def test_most_leaves_are_weakly_polarised_and_some_strongly() -> None:
    degrees = []
    for number in range(12):
        scene = procedural.draw(WantedScene(DeadLeaves(size=(64, 64)), number=number), 1, WAVELENGTH, True)
        assert scene.polarisation is not None
        ratio = scene.polarisation.ratio
        degrees.append(np.hypot(ratio[..., 0, :], ratio[..., 1, :]).ravel())
    degree = np.concatenate(degrees)
    assert degree.max() <= 1
    assert np.median(degree) < 0.1
    assert 0.05 < (degree > 0.3).mean() < 0.4


def test_the_polarisations_of_the_colours_are_almost_unrelated() -> None:
    """A colour camera must not infer the polarisation of one colour from the other colours."""
    ratios = []
    for number in range(12):
        scene = procedural.draw(WantedScene(DeadLeaves(size=(64, 64)), number=number), 1, WAVELENGTH, True)
        assert scene.polarisation is not None
        ratios.append(scene.polarisation.ratio.reshape(-1, 2, 3))
    blue, green, red = np.moveaxis(np.concatenate(ratios), 2, 0)  # (pixel, 2)
    for one, other in ((blue, green), (green, red), (blue, red)):
        correlation = (one * other).sum() / np.sqrt((one**2).sum() * (other**2).sum())
        assert abs(correlation) < 0.5
        assert np.median(np.hypot(*one.T)) == pytest.approx(np.median(np.hypot(*other.T)), rel=0.4)


def test_fresnel() -> None:
    """A dielectric does not polarise at normal incidence and at grazing incidence, and fully at Brewster's angle."""
    brewster = np.sin(np.arctan(1.5))
    degree = fresnel_degree(np.array([0.0, brewster, 1.0], np.float32))
    np.testing.assert_allclose(degree, [0, 1, 0], atol=1e-5)


@pytest.mark.parametrize(
    ("framing", "angle"), [({}, 20.0), ({"rotate": 90}, 110.0), ({"rotate": 180}, 20.0), ({"flip": "cols"}, 160.0),
                           ({"flip": "rows"}, 160.0), ({"flip": "rows", "rotate": 270}, 70.0), ({"scale": 0.5}, 20.0)]
)  # fmt: skip
def test_framing_turns_the_angle(camera: CameraModel, framing: dict, angle: float) -> None:
    double = 2 * np.radians(20.0)
    scene = uniform(0.5 * float(np.cos(double)), 0.5 * float(np.sin(double)))
    framed = on_sensor(scene, DeadLeaves(size=(32, 32), **framing), camera)
    assert framed.polarisation is not None
    assert framed.polarisation.ratio.shape[:2] == framed.reflectance.shape[:2]
    stokes = np.stack([np.ones(framed.reflectance.shape[:2]), *np.moveaxis(framed.polarisation.ratio[..., 0], -1, 0)])
    np.testing.assert_allclose(aolp(stokes), angle, atol=1e-3)
    np.testing.assert_allclose(dolp(stokes), 0.5, atol=1e-5)


def test_bilinear_interpolation_recovers_uniform_light(camera: CameraModel) -> None:
    """The baseline knows the angles and the extinction ratios of the camera."""
    light = make_light("D65", {}, camera.wavelength).at(100.0)
    frame = simulate(camera, uniform(0.4, -0.3), light, 0.05, Lens(), (0,), TARGET, "none")
    made = develop_stokes(frame, camera, stokes_baselines(camera.cfa)["bilinear"])
    np.testing.assert_allclose(made, frame.target, atol=0.1)  # cd/m², of a white of 100; the raw values are integers
    quality, errors = judge_stokes(made, frame.target, frame.white, STOKES)
    assert errors.max() < 2e-3
    assert quality.aolp_rmse is not None
    assert quality.aolp_rmse < 0.1
    assert quality.dolp_bias is None
    assert quality.psnr_s0 > 60


def test_errors_of_stokes_parameters() -> None:
    """A degree of 0.1 where there is none is the bias, and an angle that is turned by 10 degrees the error of the angle."""
    white = np.array([0.0, 2.0, 0.0])
    target = np.stack([np.zeros((8, 8)), np.ones((8, 8)), np.zeros((8, 8))])
    made = target.copy()
    made[0] = 0.1
    quality, errors = judge_stokes(made, target, white, STOKES)
    assert quality.dolp_bias == pytest.approx(0.1)
    assert quality.mean_dolp_error == pytest.approx(0.1)
    assert quality.aolp_rmse is None
    assert quality.psnr_s1 == pytest.approx(-20 * np.log10(0.05))
    np.testing.assert_allclose(errors, 0.1)
    for planes, angle in ((target, 175.0), (made, 5.0)):
        planes[0], planes[2] = 0.5 * np.cos(2 * np.radians(angle)), 0.5 * np.sin(2 * np.radians(angle))
    quality, errors = judge_stokes(made, target, white, STOKES)
    assert quality.aolp_rmse == pytest.approx(10.0)
    assert quality.dolp_bias is None
    assert errors.max() < 1e-12


def test_the_brightness_of_stokes_parameters_is_s0() -> None:
    """Sharpness and signal-to-noise ratio must not depend on S1 and S2."""
    planes = np.random.default_rng(1).random((3, 64, 64))
    margin = standards.MARGIN_PIXELS
    np.testing.assert_array_equal(standards.brightness(planes, STOKES), planes[1, margin:-margin, margin:-margin])


def test_only_half_turns_leave_the_record_of_a_scene_alike(camera: CameraModel) -> None:
    """A turned scene gives the turned electrons of the same channels; a mirrored one those of other channels."""
    channel = neighbourhoods(camera.cfa, 5, 4).channel
    allowed = orientations_of_scenes(camera)
    assert stabilisers(channel[0], 5) != list(allowed) == stabilisers(channel[0], 5, allowed)
    assert orientations_of_scenes(replace(camera, polarisers=None)) == EVERY_ORIENTATION
    wanted = WantedScene(DeadLeaves(size=(32, 32)))
    scene, light = procedural.draw(wanted, 1, WAVELENGTH, True), make_light("D65", {}, camera.wavelength).at(100.0)

    def electrons(**framing: Any) -> np.ndarray:
        framed = on_sensor(scene, DeadLeaves(size=(32, 32), **framing), camera)
        return simulate(camera, framed, light, 0.01, Lens(), (0,), TARGET, "none").electrons

    plain = electrons()
    np.testing.assert_allclose(electrons(rotate=180), plain[:, ::-1, ::-1], rtol=1e-4, atol=1e-4 * plain.max())
    mirrored = electrons(flip="cols")
    assert abs(mirrored - plain[:, :, ::-1]).max() > 0.05 * plain.max()
    np.testing.assert_allclose(mirrored[[0, 2, 1, 3]], plain[:, :, ::-1], rtol=1e-4, atol=1e-4 * plain.max())
