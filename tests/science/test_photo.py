"""Charts in photos: detection, measurement, and estimates of known responsivities, with a real photo from a Canon 550D.

tests/studies/test_photo_study.py tests the estimates for many measured cameras (docs/method.md#charts-in-photographs).
"""

import json
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.fit import PhotoFit
from l3cli.artifacts.store import load
from l3cli.calibration.photo import estimate as estimation
from l3cli.calibration.photo import responsivity
from l3cli.calibration.photo.estimate import WAVELENGTH, Posterior, Prior, camera_prior, estimate, smooth, terms
from l3cli.frames import chart
from l3cli.frames.chart import corner_cells, homography, through
from l3cli.io.curves import read_cameras, shipped_statistics
from l3cli.io.images import read_image
from l3cli.physics import charts, spectra
from l3cli.physics.display import delta_e_2000, displayed_xyz, lab, white_point
from tests.helpers import photos, priors
from tests.helpers.calls import L3
from tests.helpers.paths import ROOT
from tests.helpers.photos import BAYER, GAIN, GRID, PLACE, READ, REFLECTANCE, UPRIGHT, photograph

SEEDS = range(8)
SURFACES = spectra.reflectance_library(WAVELENGTH)[::5]


@pytest.fixture(autouse=True, scope="module")
def one_thread() -> Iterator[None]:
    """As in the command: small matrices are faster so."""
    with threadpool_limits(1, user_api="blas"):
        yield


@pytest.fixture(scope="module")
def prior() -> Prior:
    return camera_prior(shipped_statistics())


@pytest.fixture(scope="module")
def plain(prior: Prior) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return figures(prior)


def figures(prior: Prior, glare: float = 0.0, uneven: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors of responses under A from a chart under D65, and shares of these and of the curves within the band."""
    errors, shares, curves = [], [], []
    for seed in SEEDS:
        camera = photos.drawn(seed)
        posterior = estimate([photos.shot(camera, "D65", np.random.default_rng(seed), glare=glare, uneven=uneven)], prior)
        error, share = photos.response_figures(camera, posterior, "A", SURFACES)
        errors.append(error)
        shares.append(share)
        curves.append(photos.curve_figures(camera, posterior)[1])
    return np.concatenate(errors), np.concatenate(shares), np.concatenate(curves)


def test_responses_under_another_light_and_the_band(plain: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    errors, shares, curves = plain
    assert np.median(errors) < 0.0035
    assert np.percentile(errors, 95) < 0.01
    assert 0.9 <= shares.mean() <= 0.995
    assert 0.9 <= curves.mean() <= 0.995


def test_glare_and_uneven_light_cost_little(prior: Prior, plain: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    hard = figures(prior, glare=0.02, uneven=0.2)
    assert np.median(hard[0]) < 1.5 * max(np.median(plain[0]), 0.0025)
    assert hard[1].mean() >= 0.9


def test_curves_are_nowhere_negative_and_noise_free_patches_fit(prior: Prior) -> None:
    camera = photos.drawn(3)
    shot = photos.shot(camera, "D65", np.random.default_rng(0), noise=1e-4)
    posterior = estimate([shot], prior)
    assert posterior.responsivity.min() >= 0
    assert np.abs(posterior.predicted[0] - shot.values).max() < 0.005 * photos.BRIGHTEST


def test_glare_and_illumination_are_recovered(prior: Prior) -> None:
    camera = photos.drawn(5)
    even = photos.shot(camera, "D65", np.random.default_rng(0), noise=0.001, glare=0.05)
    glare = 0.05 * (even.values.mean(axis=0) / 1.05)
    np.testing.assert_allclose(estimate([even], prior).glare[0], glare, atol=0.01 * photos.BRIGHTEST)


def test_a_second_light_helps(prior: Prior) -> None:
    one, two = [], []
    for seed in SEEDS:
        camera, rng = photos.drawn(seed), np.random.default_rng(seed)
        shots = [photos.shot(camera, light, rng, uneven=0.2) for light in ("D65", "A")]
        one.append(photos.response_figures(camera, estimate(shots[:1], prior), "4000K", SURFACES)[0])
        two.append(photos.response_figures(camera, estimate(shots, prior), "4000K", SURFACES)[0])
    assert np.median(two) < 0.9 * np.median(one)


def test_the_light_that_is_advised_helps_more_than_more_of_the_same(prior: Prior) -> None:
    camera = photos.drawn(1)
    shot = photos.shot(camera, "D65", np.random.default_rng(1))
    posterior = estimate([shot], prior)
    candidates = {name: spectra.illuminant(name, WAVELENGTH) for name in ("D65", "A", "F11", "D50")}
    best, remaining = estimation.next_light(shot, posterior, candidates, list(candidates.values()), SURFACES)
    assert best in ("A", "F11")
    assert 0.2 < remaining < 0.95


def test_a_clipped_patch_is_left_out(prior: Prior) -> None:
    camera = photos.drawn(2)
    shot = photos.shot(camera, "D65", np.random.default_rng(2))
    shot.values[18, 1] = 700.0
    shot.used[18, 1] = False
    assert photos.response_figures(camera, estimate([shot], prior), "A", SURFACES)[0].max() < 0.015


LIGHTS = [("A", "D65"), ("LED-B3", "D50"), ("D65", "A"), ("F11", "D65"), ("D65", "F2")]
WRONG = [(seed, *each) for seed in range(2) for each in LIGHTS]
FEW = {name: spectra.illuminant(name, WAVELENGTH) for name in ("A", "D50", "D65", "F2", "F11", "LED-B3", "4000K")}


@pytest.fixture(scope="module")
def among() -> list[Prior]:
    return estimation.plausible(("r", "g", "b"), shipped_statistics())


@pytest.mark.parametrize(
    ("seed", "true", "named"),
    [each if at < 2 else pytest.param(*each, marks=pytest.mark.soak) for at, each in enumerate(WRONG)],
)
def test_a_wrong_light_is_noticed_and_the_right_one_not(among: list[Prior], seed: int, true: str, named: str) -> None:
    camera, rng = photos.drawn(seed), np.random.default_rng(seed)
    wrong = photos.shot(camera, true, rng, uneven=0.2, named=named)
    assert estimation.compare([wrong], 0, among, FEW)[1] > estimation.NOTICED
    right = photos.shot(camera, true, rng, uneven=0.2)
    assert estimation.compare([right], 0, among, FEW)[1] <= estimation.NOTICED


def curves_of(name: str) -> tuple[tuple[str, ...], np.ndarray]:
    """Channels and curves of a recipe, or of one of the cameras of ssf-data, which are measured per energy."""
    if not name.endswith(".csv"):
        camera = load_camera(ROOT / f"configs/cameras/{name}.toml")
        return camera.channels, spectra.average(camera.responsivity, camera.wavelength, WAVELENGTH)
    if not os.environ.get("L3_DATA"):
        pytest.skip("L3_DATA does not name the folder of real data")
    (curves,) = read_cameras([Path(os.environ["L3_DATA"]) / "sensitivities/ssf-data" / name])
    return ("r", "g", "b"), spectra.average(curves.responsivity, curves.wavelength, WAVELENGTH)


@pytest.mark.parametrize(("true", "other"), [("D65", "4000K"), ("A", "D50"), ("LED-B3", "A")])
@pytest.mark.parametrize(
    "name",
    ["bayer", "rgbw", "Nokia_N900__camspec.csv", "Point_Grey_Grasshopper_50S5C__camspec.csv"],
)
def test_no_true_light_of_a_camera_unlike_the_measured_ones_is_doubted(name: str, true: str, other: str) -> None:
    """Photographed nearly without noise, when misfits of the prior weigh most."""
    channels, curves = curves_of(name)
    shot = photos.shot(curves, true, np.random.default_rng(0), noise=0.001)
    lights = {each: spectra.illuminant(each, WAVELENGTH) for each in (true, other, "F11")}
    priors_of = estimation.plausible(channels, shipped_statistics())
    assert estimation.compare([shot], 0, priors_of, lights)[1] < estimation.NOTICED


def test_the_prior_of_channels_in_any_order_and_with_further_ones(prior: Prior) -> None:
    turned = estimation.placed(prior, [2, 1, 0], 3)
    assert np.array_equal(turned.mean, prior.mean[::-1])
    assert turned.covariance[0, 0] == prior.covariance[2 * WAVELENGTH.size, 2 * WAVELENGTH.size]
    more = estimation.placed(prior, [1, 2, 3], 4)
    size = WAVELENGTH.size
    assert np.array_equal(more.covariance[size:, size:], prior.covariance)
    assert np.array_equal(more.covariance[:size, :size], smooth(1).covariance)
    assert not more.covariance[:size, size:].any()
    assert (more.log_peak[1:] == prior.log_peak).all()


def test_a_light_that_is_only_guessed_widens_the_band(prior: Prior, among: list[Prior]) -> None:
    candidates = {name: spectra.illuminant(name, WAVELENGTH) for name in ("A", "D50", "D55", "D65", "D75", "F11")}
    camera = photos.drawn(6)
    shot = photos.shot(camera, "D55", np.random.default_rng(6))
    likely = estimation.probabilities([shot], 0, among, candidates)
    assert sum(likely.values()) == pytest.approx(1.0)
    assert likely["A"] + likely["F11"] < 0.01
    guessed = replace(shot, light=candidates[max(likely, key=lambda name: likely[name])])
    known = estimate([guessed], prior)
    unsure = estimation.unsure_of_light(known, [guessed], 0, prior, likely, candidates)
    assert (np.diag(unsure.covariance) >= np.diag(known.covariance)).all()
    assert np.diag(unsure.covariance).mean() > 1.1 * np.diag(known.covariance).mean()


def test_dyes_that_no_camera_has_take_the_smooth_prior() -> None:
    camera = load_camera(ROOT / "configs/cameras/fiveband.toml")
    curves = spectra.average(camera.responsivity, camera.wavelength, WAVELENGTH)
    shot = photos.shot(curves, "D65", np.random.default_rng(0))
    posterior = estimate([shot], smooth(len(curves)))
    errors, shares = photos.response_figures(curves, posterior, "A", SURFACES)
    assert errors.max() < 0.02
    assert shares.mean() > 0.9


def test_curves_unlike_all_measured_ones_are_more_probable_when_merely_smooth(prior: Prior) -> None:
    """By the evidence a camera with an infrared channel is told from one that sees red, green and blue."""

    def evidences(curves: np.ndarray) -> list[float]:
        shot = photos.shot(curves, "D65", np.random.default_rng(0))
        found: list[Posterior] = [estimate([shot], each) for each in (prior, smooth(3))]
        return [each.evidence for each in found]

    usual, odd = photos.drawn(4), np.roll(photos.drawn(4), 8, axis=1)
    measured, plain = evidences(usual)
    assert measured > plain
    measured, plain = evidences(odd)
    assert measured < plain


def test_the_table_is_that_of_the_measured_cameras() -> None:
    if not os.environ.get("L3_DATA"):
        pytest.skip("L3_DATA does not name the folder of real data")
    assert priors.TABLE.read_text() == priors.as_toml(priors.measured(Path(os.environ["L3_DATA"])))


@pytest.mark.parametrize("turns", [pytest.param(0, marks=pytest.mark.soak), 3])
def test_a_chart_is_found_however_it_lies(turns: int) -> None:
    mosaic = photograph(UPRIGHT, np.random.default_rng(0), turns=turns)
    located = chart.locate(mosaic, BAYER, REFLECTANCE, GRID)
    assert located is not None
    corners = through(located.to_pixels, corner_cells(*GRID))
    col, row = UPRIGHT.T
    truth = [(col, row), (row, 799 - col), (799 - col, 599 - row), (599 - row, col)][turns]  # as rot90 moves pixels
    np.testing.assert_allclose(corners.T, truth, atol=4)


def test_a_picture_without_a_chart_has_none() -> None:
    far = UPRIGHT + 5000
    assert chart.locate(photograph(far, np.random.default_rng(1)), BAYER, REFLECTANCE, GRID) is None


@pytest.mark.parametrize("shape", [(1, 1), (3, 500), (8, 8), (10, 2000)])
def test_a_picture_of_a_few_pixels_has_none(shape: tuple[int, int]) -> None:
    mosaic = np.random.default_rng(1).uniform(0, 1000, shape)
    assert chart.locate(mosaic, BAYER, REFLECTANCE, GRID) is None
    with np.errstate(all="raise"):
        assert chart.locate(np.zeros((80, 90)), BAYER, REFLECTANCE, GRID) is None


def test_values_next_to_dust_and_clipping_and_the_noise_of_one_shot() -> None:
    rng = np.random.default_rng(2)
    mosaic = photograph(UPRIGHT, rng)
    clean = photograph(UPRIGHT, np.random.default_rng(2)).copy()
    to_pixels = homography(corner_cells(*GRID), UPRIGHT)
    row, col = 190, 215  # in patch 1
    mosaic[row : row + 4, col : col + 5] = 2900.0
    values = chart.patch_values([mosaic], BAYER, to_pixels, GRID, saturation=2950.0)
    truth = chart.patch_values([clean], BAYER, to_pixels, GRID, saturation=1e9)
    np.testing.assert_allclose(values.mean, truth.mean, rtol=0.02, atol=3)
    assert {(patch, why) for patch, _, why in values.left_out} == {(18, "clipped")}
    transfer = chart.photon_transfer([truth])
    assert transfer is not None
    assert transfer[0] == pytest.approx(GAIN, rel=0.1)
    assert transfer[1] == pytest.approx(READ, rel=0.5)


def test_two_frames_give_the_noise_without_the_pattern() -> None:
    frames = [photograph(UPRIGHT, np.random.default_rng(seed)) for seed in (3, 3)]
    scene = frames[0]
    pattern = 1.0 + 0.05 * np.random.default_rng(4).standard_normal(scene.shape)
    rng = np.random.default_rng(5)
    noisy = [np.rint(scene * pattern + READ * rng.standard_normal(scene.shape)) for _ in range(2)]
    to_pixels = homography(corner_cells(*GRID), UPRIGHT)
    two = chart.patch_values(noisy, BAYER, to_pixels, GRID, saturation=1e9)
    np.testing.assert_allclose(np.median(two.variance), READ**2, rtol=0.15)


def test_too_small_a_chart_is_refused() -> None:
    mosaic = photograph(UPRIGHT, np.random.default_rng(6))
    tiny = homography(corner_cells(*GRID), 300 + (UPRIGHT - 300) / 20)
    with pytest.raises(ValueError, match="pixels of channel"):
        chart.patch_values([mosaic], BAYER, tiny, GRID, saturation=1e9)


# Charts of paints, plastics and textiles under the photo's light, and what they are under daylight.
SCENES = """
illuminants = ["A"]
exposure_share = [0.9]
[target]
illuminant = "D65"
[[scene]]
source = "surfaces"
size = [160, 160]
patches = [10, 10]
count = 40
"""
HALF = 20  # pixels about a patch's centre


@pytest.fixture
def photo(l3_data: Path) -> Path:
    return l3_data / "raw/colorchart.dng"


def fit_of(camera: CameraModel) -> PhotoFit:
    assert camera.fit is not None
    assert camera.fit.photo is not None
    return camera.fit.photo


def test_the_chart_its_light_and_its_noise(photo: Path, tmp_path: Path, l3: L3, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(responsivity, "locate", photos.locating_once())
    code, out, err = l3("calibrate", "--photo", photo, "-o", tmp_path / "camera.h5")
    assert code == 0, err
    camera = load(CameraModel, tmp_path / "camera.h5")
    fit = fit_of(camera)
    assert fit.lights[0] in ("A", "2400K", "3200K")  # indoors, by tungsten light
    assert fit.prior in (estimation.MEASURED, estimation.UNLIKE)
    assert fit.misfit.max() < 0.01
    np.testing.assert_allclose(fit.corners[0], [[664, 578], [1304, 564], [1315, 973], [645, 985]], atol=6)
    assert "colours ± 95 %" in out
    assert 0.5 < camera.gain < 4
    assert (camera.black_level, camera.white_level) == (2056, 15000)


def centres(fit: PhotoFit) -> np.ndarray:
    """(24, 2) row, col of the patches' centres, of a chart that is nearly seen from the front."""
    first, second, third, fourth = fit.corners[0]
    y, x = (np.indices((4, 6)).reshape(2, 24) + 0.5) / [[4], [6]]
    x, y = x[:, None], y[:, None]
    place = first * (1 - x) * (1 - y) + second * x * (1 - y) + third * x * y + fourth * (1 - x) * y
    return np.rint(place[:, ::-1]).astype(int)


@pytest.mark.slow
def test_its_own_colours(photo: Path, tmp_path: Path, l3: L3) -> None:
    (tmp_path / "scenes.toml").write_text(SCENES)
    camera, training, table = (tmp_path / name for name in ("camera.h5", "training.h5", "table.h5"))
    assert l3("calibrate", "--photo", photo, "--light", "A", "-o", camera)[0] == 0
    assert l3("export", camera, "-o", tmp_path / "exported")[0] == 0
    assert l3("simulate", tmp_path / "scenes.toml", "--camera", camera, "-o", training, "--jobs", "2")[0] == 0
    assert l3("train", training, "--classes", "single", "-o", table, "--jobs", "2")[0] == 0
    fit = fit_of(load(CameraModel, camera))
    # Black level and glare of each channel, which calibration found in this photo, stand in for a dark frame.
    offsets = tmp_path / "exported/colorchart_offsets.tif"
    assert l3("render", table, photo, "--dark", offsets, "-o", tmp_path / "clean.exr")[0] == 0
    assert l3("render", table, photo, "-o", tmp_path / "plain.exr")[0] == 0
    wavelength = np.arange(400.0, 701.0, 5.0)
    weights = spectra.xyz_weights(wavelength) * spectra.illuminant("D65", wavelength)
    published = spectra.colorchecker(wavelength)[1] @ weights.T / weights[1].sum()
    white = spectra.white_point("D65")
    means = {}
    for name in ("clean", "plain"):
        picture = read_image(tmp_path / f"{name}.exr")[0]
        windows = [picture[row - HALF : row + HALF, col - HALF : col + HALF] for row, col in centres(fit)]
        measured = np.mean(windows, axis=(1, 2))
        balanced = measured / measured[18] * white * published[18, 1]  # exposure and white: the white patch is neutral
        means[name] = float(delta_e_2000(lab(balanced, white), lab(published, white)).mean())
    print(means)
    assert means["clean"] <= 2.5
    assert means["plain"] <= 3.5


VISIBLE = np.arange(380.0, 781.0, 5.0)
MOST = {"ColorMatrix1": 1.5, "ForwardMatrix1": 2.1, "CCM": 2.4}  # mean CIEDE2000


def errors(xyz: np.ndarray, light: str) -> np.ndarray:
    """Of the chart's patches (24, 3) of free exposure beside those under a light."""
    weights = spectra.xyz_weights(VISIBLE) * spectra.illuminant(light, VISIBLE)
    wanted, white = charts.chart("classic", VISIBLE)[1] @ weights.T / weights[1].sum(), white_point(light)
    exposed = xyz * (xyz[:, 1] @ wanted[:, 1]) / (xyz[:, 1] @ xyz[:, 1])
    return np.asarray(delta_e_2000(lab(exposed, white), lab(wanted, white)))


@pytest.mark.slow
def test_a_real_chart_is_developed_by_what_is_exported(l3_data: Path, tmp_path: Path, l3: L3) -> None:
    photo = l3_data / "raw/colorchart.dng"
    assert l3("calibrate", "--photo", photo, "--light", "A", "-o", tmp_path / "camera.h5")[0] == 0
    assert l3("export", tmp_path / "camera.h5", "-o", tmp_path)[0] == 0
    camera = load(CameraModel, tmp_path / "camera.h5")
    assert camera.fit is not None
    assert camera.fit.photo is not None
    fit = camera.fit.photo
    values = (fit.measured[0] - fit.glare[0]) / (terms(PLACE) @ fit.illumination[0])[:, None]
    dcp = json.loads((tmp_path / "dcp.json").read_text())
    tuning = json.loads((tmp_path / "libcamera_rpi.json").read_text())
    (ccms,) = (each["rpi.ccm"]["ccms"] for each in tuning["algorithms"] if "rpi.ccm" in each)
    balanced = values / np.array(dcp["AsShotNeutral"]["StdA"])
    picture = balanced @ np.reshape(ccms[0]["ccm"], (3, 3)).T
    found = {
        "ColorMatrix1": errors(values @ np.linalg.inv(dcp["ColorMatrix1"]).T, "A"),
        "ForwardMatrix1": errors(balanced @ np.transpose(dcp["ForwardMatrix1"]), "D50"),
        "CCM": errors(displayed_xyz(picture), "D65"),
    }
    for name, each in found.items():
        print(f"{name}: mean ΔE00 {each.mean():.2f}, worst {each.max():.2f} (patch {each.argmax() + 1})")
        assert each.mean() < MOST[name]
