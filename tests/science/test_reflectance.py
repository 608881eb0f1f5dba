"""Reflectances and radiances as outputs, compared with known values (docs/measurement.md#reflectances)."""

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel, Noise
from l3cli.artifacts.store import load
from l3cli.artifacts.table import SpectralSmoothing, TransformTable
from l3cli.artifacts.training_set import LightSpectrum, TrainingFrame, TrainingPair, TrainingSet, write_training_set
from l3cli.cli.evaluate import print_tables
from l3cli.evaluation.reflectance import ESTIMATES, Estimates, judge_reflectances
from l3cli.frames.scene import Scene
from l3cli.io.images import read_image
from l3cli.physics import spectra
from l3cli.physics.display import delta_e_2000, lab
from l3cli.simulation import frame as simulated_frame
from l3cli.simulation.frame import simulate
from l3cli.simulation.light import Light, automatic_exposure, make_light, make_target
from l3cli.simulation.recipe import Lens
from tests.helpers.calls import L3, Refused

GRID = spectra.SAMPLED
BLOCK = 16  # pixels of a plain patch, at least
PLAIN = Lens(diffraction=False)


def quiet_camera(camera: CameraModel) -> CameraModel:
    return dataclasses.replace(camera, noise=Noise(0.01, 0.0, 0.0, 0.0, 15000.0))


def inks(count: int) -> np.ndarray:
    """Reflectances (ink, wavelength), of which scenes here are mixtures: as many as a camera has bands, and as narrow."""
    centre = np.linspace(430.0, 650.0, count)[:, None]
    return np.asarray(0.15 / count + 0.4 * np.exp(-0.5 * (count * (GRID - centre) / 180.0) ** 2))


def patches(count: int, seed: int, side: int = 4) -> Scene:
    """Plain patches, each another mixture of the inks, `side` in a row."""
    mix = np.random.default_rng(seed).uniform(0.05, 1.0, (side, side, count))
    block = 4 * BLOCK // side
    cube = (mix @ inks(count)).repeat(block, axis=0).repeat(block, axis=1)
    return Scene(f"patches {seed}", GRID, cube.astype(np.float32), None)


def frame_of(
    camera: CameraModel,
    light: Light,
    seed: int,
    outputs: str = "reflectance 31",
    noises: str = "none",
    side: int = 4,
    share: float = 0.8,
) -> TrainingFrame:
    """A frame in which a perfect white fills its brightest channel to `share` of full scale."""
    target, exposure = make_target(outputs, None, (), None, camera), automatic_exposure(camera, light, share)
    return simulate(camera, patches(len(camera.channels), seed, side), light, exposure, PLAIN, (seed,), target, noises)


def inside(planes: np.ndarray) -> np.ndarray:
    """The middle pixels of every patch, to which no mosaic brings other patches: (output, patch, pixel)."""
    tiles = planes.reshape(len(planes), -1, BLOCK, planes.shape[2] // BLOCK, BLOCK)[:, :, 7:9, :, 7:9]
    return np.moveaxis(tiles, 3, 2).reshape(len(planes), -1, 4)


@pytest.mark.parametrize("name", ["A", "D65", "F11"])
def test_reflectances_are_those_of_the_scene_under_every_light(name: str, fiveband: CameraModel) -> None:
    frame = frame_of(fiveband, make_light(name, {}, fiveband.wavelength).at(40.0), 1)
    np.testing.assert_allclose(frame.white, 40.0, rtol=1e-9)
    truth = np.moveaxis(patches(len(fiveband.channels), 1).reflectance, 2, 0)
    np.testing.assert_allclose(frame.target / 40.0, truth, rtol=1e-5)


def test_radiances_are_of_the_light_in_the_unit_of_luminance(fiveband: CameraModel) -> None:
    equal = frame_of(fiveband, make_light("E", {}, fiveband.wavelength).at(40.0), 1, "radiance 31")
    np.testing.assert_allclose(equal.white, 40.0, rtol=2e-3)  # as ȳ is scaled
    candle = frame_of(fiveband, make_light("A", {}, fiveband.wavelength).at(40.0), 1, "radiance 31")
    falls = 1.435e7 / 2848  # nm: CIE 15 has light A so
    power = (GRID / 560) ** -5 * np.expm1(falls / 560) / np.expm1(falls / GRID)
    np.testing.assert_allclose((candle.white / candle.white[16])[1:-1], power[1:-1], rtol=3e-3)
    np.testing.assert_allclose((candle.white / candle.white[16])[[0, -1]], power[[0, -1]], rtol=0.01)  # half a step each
    truth = np.moveaxis(patches(len(fiveband.channels), 1).reflectance, 2, 0)
    np.testing.assert_allclose(candle.target[1:-1], (truth * candle.white[:, None, None])[1:-1], rtol=0.02)


def test_estimates_are_exact_for_scenes_of_as_many_spectra_as_bands(bayer: CameraModel) -> None:
    camera = quiet_camera(bayer)
    light = make_light("A", {}, camera.wavelength).at(100.0)

    def drawn(like: TrainingPair, spectrum: LightSpectrum) -> Iterator[TrainingFrame]:
        np.testing.assert_allclose(spectrum.radiance, light.radiance / 100.0, rtol=1e-6)
        assert like.illuminant == "A"
        return (frame_of(camera, light, seed, side=1) for seed in range(10, 40))

    unseen = frame_of(camera, light, 1, side=1)
    made = Estimates(camera, drawn).planes(unseen)
    assert tuple(made) == ESTIMATES
    for planes in made.values():
        np.testing.assert_allclose(planes, unseen.target, atol=0.5)  # of 100 of a white: DN are rounded


def test_wiener_forgoes_what_noise_hides(bayer: CameraModel) -> None:
    light = make_light("D65", {}, bayer.wavelength).at(1.0)

    def drawn(like: TrainingPair, spectrum: LightSpectrum) -> Iterator[TrainingFrame]:
        return (frame_of(bayer, light, seed, noises="all", share=0.01) for seed in range(10, 22))

    unseen = frame_of(bayer, light, 1, noises="all", share=0.01)
    made = Estimates(bayer, drawn).planes(unseen)
    rmse = {name: judge_reflectances(planes, unseen.target, unseen.white)[0].rmse for name, planes in made.items()}
    assert rmse["wiener"] < 0.95 * rmse["pinv"]


def test_figures_of_known_errors() -> None:
    names, chart = spectra.colorchecker(GRID)
    target = chart.T[:, :, None] * 80.0
    white = np.full(GRID.size, 80.0)
    same, _ = judge_reflectances(target, target, white)
    assert (same.rmse, same.gfc) == pytest.approx((0.0, 1.0), abs=1e-12)
    assert (same.delta_e_a, same.delta_e_d65, same.delta_e_f11) == pytest.approx((0, 0, 0), abs=1e-6)
    brighter, _ = judge_reflectances(1.1 * target, target, white)
    assert brighter.rmse == pytest.approx(0.1 * np.sqrt((chart**2).mean()))
    assert brighter.gfc == pytest.approx(1.0)
    grey = np.full((GRID.size, 2, 2), 40.0)
    known = float(delta_e_2000(*(lab(np.full(3, value), np.ones(3)) for value in (0.5, 0.6))))
    changed, _ = judge_reflectances(1.2 * grey, grey, white)
    assert (changed.delta_e_a, changed.delta_e_d65, changed.delta_e_f11) == pytest.approx((known,) * 3, abs=0.01)
    red = target.copy()
    red[-10:] *= 1.2  # 610 nm and more, of which incandescent light has most
    reddened, _ = judge_reflectances(red, target, white)
    assert reddened.delta_e_a > 1.02 * reddened.delta_e_d65 > 0.5
    assert 0.9 < reddened.gfc < 1.0
    fine = np.arange(380.0, 781.0, 5.0)
    colours = [
        lab((spectra.xyz_weights(fine) * spectra.illuminant("F11", fine)) @ spectra.colorchecker(fine)[1][index],
            (spectra.xyz_weights(fine) * spectra.illuminant("F11", fine)).sum(axis=1))
        for index in map(names.index, ("purplish blue", "magenta"))
    ]  # fmt: skip
    blue, magenta = (target[:, [names.index(name)]] for name in ("purplish blue", "magenta"))
    assert judge_reflectances(blue, magenta, white)[0].delta_e_f11 == pytest.approx(delta_e_2000(*colours), rel=0.01)


SCENES = """
exposure_share = [0.9]
illuminants = ["A"]
target.outputs = "{outputs}"
[[scene]]
source = "dead leaves"
size = [48, 56]
count = 2
"""
CLASSES = "[classes]\npatch = 5\nlevels = 2\nchromas = 1\n[learning]\npatches = 4000\nspectral_window = 3\n"


def test_a_table_recovers_reflectances_of_its_model(bayer: CameraModel, tmp_path: Path, l3: L3) -> None:
    """Scenes of as many spectra as bands leave nothing to guess: what is learned under one light is the truth."""
    camera = quiet_camera(bayer)
    light = make_light("A", {}, camera.wavelength).at(100.0)
    head = TrainingSet(camera, spectra.REFLECTANCES, "reflectances")
    with write_training_set(tmp_path / "training.h5", head) as writer:
        for seed in range(10, 40):
            writer.append(frame_of(camera, light, seed, side=1))
    (tmp_path / "classes.toml").write_text(CLASSES + 'noise = "none"\n')
    arguments = "--classes", tmp_path / "classes.toml", "-o", tmp_path / "table.h5", "--quiet"
    assert l3("train", tmp_path / "training.h5", *arguments)[0] == 0
    table = load(TransformTable, tmp_path / "table.h5")
    assert table.spectra == SpectralSmoothing(3, 0.3)
    np.testing.assert_allclose(table.white_point, 1.0)
    unseen = frame_of(camera, light, 1)
    np.save(tmp_path / "raw.npy", unseen.raw)
    assert l3("render", tmp_path / "table.h5", tmp_path / "raw.npy", "-o", tmp_path / "made.exr", "--quiet")[0] == 0
    assert b"spectralLayoutVersion" in (tmp_path / "made.exr").read_bytes()
    pixels, names = read_image(tmp_path / "made.exr")
    planes = np.moveaxis(pixels, 2, 0)[[names.index(f"T.{nm:g}nm") for nm in GRID]]
    made = planes * (table.output_unit / unseen.exposure)
    np.testing.assert_allclose(inside(made), inside(unseen.target), atol=0.5)  # of 100 of a white


@pytest.mark.parametrize("outputs", ["reflectance 31", "radiance 31"])
def test_estimates_stand_beside_a_table(
    outputs: str,
    bayer_recipe: Path,
    tmp_path: Path,
    l3: L3,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(simulated_frame, "DRAWN", 12)
    (tmp_path / "scenes.toml").write_text(SCENES.format(outputs=outputs))
    (tmp_path / "classes.toml").write_text(CLASSES.replace("spectral_window = 3\n", ""))
    training, table = tmp_path / "training.h5", tmp_path / "table.h5"
    assert l3("simulate", tmp_path / "scenes.toml", "--camera", bayer_recipe, "-o", training, "--quiet")[0] == 0
    assert l3("train", training, "--classes", tmp_path / "classes.toml", "-o", table, "--quiet")[0] == 0
    code, out, _ = l3("evaluate", table, training, "--json", "--quiet", "--backend", "reference")
    assert code == 0
    document = json.loads(out)
    assert document["pipelines"] == ["ours", *ESTIMATES]
    assert len(document["by_band"]) == GRID.size
    colours = {"delta_e_a", "delta_e_d65", "delta_e_f11"} & set(document["mean"]["ours"])
    assert len(colours) == (3 if outputs == "reflectance 31" else 0)
    assert document["mean"]["ours"]["rmse"] < document["mean"]["wiener"]["rmse"] < 0.15
    assert set(document["standards"]["figures"]) == {"ours"}
    print_tables(document)
    out = capsys.readouterr().out
    assert "wiener" in out
    assert ("ΔE00 D65" in out) == (outputs == "reflectance 31")


def test_what_cannot_be_is_refused(tmp_path: Path, refused: Refused) -> None:
    def words(text: str) -> str:
        (tmp_path / "scenes.toml").write_text(
            'exposure_share = [0.9]\n[[scene]]\nsource = "dead leaves"\nsize = [64, 64]\n' + text
        )
        arguments = tmp_path / "scenes.toml", "--camera", "bayer", "-o", tmp_path / "set.h5"
        return str(refused(2, "simulate", *arguments))

    assert "does not depend on the illuminant" in words('[target]\noutputs = "reflectance 31"\nilluminant = "D65"\n')
    assert '"reflectance 31"' in words('[target]\noutputs = "reflectance 30"\n')
