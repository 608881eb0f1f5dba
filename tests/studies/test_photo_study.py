"""Responsivities from one photo of a chart, for all measured cameras (docs/method.md#charts-in-photographs).

Each camera is simulated, and its responsivities are estimated with a prior from all other cameras.
"""

import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from l3cli.calibration.photo.estimate import (
    NOTICED,
    ROLES,
    WAVELENGTH,
    Prior,
    camera_prior,
    compare,
    estimate,
    plausible,
    probabilities,
    statistics,
)
from l3cli.calibration.photo.responsivity import ColourMatrix, candidates, curves_of_matrices, usual_curves
from l3cli.frames.measurement import FinishedCurves
from l3cli.io.curves import prior_files, read_cameras, read_finished
from l3cli.physics import spectra
from tests.helpers import photos

pytestmark = pytest.mark.slow

NOISE = 0.005  # of the brightest patch
SECOND = "A"  # the light that responses are judged under; the photo is taken under D65
DISTINCT = ("A", "4000K", "D65", "F2", "F11", "LED-B1", "LED-B3", "LED-B5")  # of neighbouring daylights and lamps one


@dataclass(frozen=True)
class Camera:
    """A measured camera."""

    name: str  # without maker's habits of spelling: one camera measured twice has one name
    maker: str
    curves: FinishedCurves

    @property
    def responsivity(self) -> np.ndarray:
        return np.asarray(spectra.average(self.curves.responsivity, self.curves.wavelength, WAVELENGTH))


@pytest.fixture(autouse=True, scope="module")
def one_thread() -> Iterator[None]:
    with threadpool_limits(1, user_api="blas"):
        yield


@pytest.fixture(scope="module")
def cameras(l3_data: Path) -> list[Camera]:
    folders = ("sensitivities/rawtoaces/data/camera", "sensitivities/ssf-data")
    files = [path for folder in folders for path in prior_files(l3_data / folder)]
    named = []
    for path, curves in zip(files, read_cameras(files), strict=True):
        name = re.sub(r"(_380_780_5|__camspec|__spectroscope)$", "", path.stem)
        plain = re.sub(r"EOS|MARK|[_-]", "", name.upper())
        named.append(Camera(plain, name.split("_")[0].upper(), curves))
    assert len(named) >= 80
    return named


@pytest.fixture(scope="module")
def surfaces(l3_data: Path) -> np.ndarray:
    """190 reflectances (surface, wavelength) of rawtoaces, none of a ColorChecker's."""
    path = l3_data / "sensitivities/rawtoaces/data/training/training_spectral.json"
    table = read_finished(path, [f"patch{number + 1}" for number in range(190)], per_energy=False)
    return np.array([np.interp(WAVELENGTH, table.wavelength, row) for row in table.responsivity])


def prior_without(cameras: list[Camera], left_out: Camera) -> Prior:
    return camera_prior(statistics([each.curves for each in cameras if each.name != left_out.name]))


def priors_without(cameras: list[Camera], left_out: Camera) -> list[Prior]:
    return plausible(ROLES, statistics([each.curves for each in cameras if each.name != left_out.name]))


@dataclass(frozen=True)
class Outcome:
    """Figures of every channel of every camera."""

    responses: np.ndarray  # RMS error over the surfaces / the largest response
    covered: np.ndarray  # share of the responses within their band
    curves: np.ndarray  # RMS error / peak
    curves_covered: np.ndarray

    def __str__(self) -> str:
        median, high = (100 * np.percentile(self.responses, share) for share in (50, 95))
        curve, far = (100 * np.percentile(self.curves, share) for share in (50, 95))
        worst = 100 * self.responses.max()
        return (
            f"responses {median:.2f} % (95 %: {high:.2f}, worst {worst:.2f}), band covers {100 * self.covered.mean():.1f} %;"
            f" curves {curve:.1f} % ({far:.1f}), covered {100 * self.curves_covered.mean():.1f} %"
        )


def study(
    cameras: list[Camera], surfaces: np.ndarray, *, second: bool = False, glare: float = 0.0, uneven: float = 0.0
) -> Outcome:
    parts = []
    for index, camera in enumerate(cameras):
        rng, truth = np.random.default_rng(index), camera.responsivity
        names = ("D65", SECOND) if second else ("D65",)
        shots = [photos.shot(truth, name, rng, noise=NOISE, glare=glare, uneven=uneven) for name in names]
        posterior = estimate(shots, prior_without(cameras, camera))
        judged = "4000K" if second else SECOND
        parts.append((*photos.response_figures(truth, posterior, judged, surfaces), *photos.curve_figures(truth, posterior)))
    outcome = Outcome(*(np.concatenate(part) for part in zip(*parts, strict=True)))
    print(outcome)
    return outcome


def test_one_photo(cameras: list[Camera], surfaces: np.ndarray) -> None:
    outcome = study(cameras, surfaces)
    assert np.median(outcome.responses) <= 0.0035
    assert np.percentile(outcome.responses, 95) <= 0.01
    assert 0.90 <= outcome.covered.mean() <= 0.99
    assert 0.90 <= outcome.curves_covered.mean() <= 0.99


def test_the_cameras_of_rawtoaces(cameras: list[Camera], surfaces: np.ndarray) -> None:
    """The 52 cameras whose statistics come with l3, each under the prior of the 51 others and nothing else."""
    ours = cameras[:52]
    assert {each.maker for each in ours} >= {"ARRI", "CANON", "NIKON", "SONY"}
    outcome = study(ours, surfaces)
    assert np.median(outcome.responses) <= 0.0035
    assert outcome.responses.max() <= 0.015


def test_glare_and_uneven_light(cameras: list[Camera], surfaces: np.ndarray) -> None:
    outcome = study(cameras, surfaces, glare=0.02, uneven=0.2)
    assert np.median(outcome.responses) <= 1.5 * 0.0035
    assert np.percentile(outcome.responses, 95) <= 1.5 * 0.01
    assert 0.90 <= outcome.covered.mean() <= 0.99


def test_a_second_light(cameras: list[Camera], surfaces: np.ndarray) -> None:
    outcome = study(cameras, surfaces, second=True)
    assert np.median(outcome.responses) <= 0.0025
    assert np.percentile(outcome.responses, 95) <= 0.006


def test_colour_matrices_alone(cameras: list[Camera], surfaces: np.ndarray) -> None:
    """No photo but the matrices of a DNG for A and D65, by least squares over a ColorChecker, in four decimals: error of
    responses to other surfaces over the largest, their mean known; beside the mean of all other cameras."""
    errors: dict[str, list[np.ndarray]] = {name: [] for name in ("A", "D65", "F11", "mean of cameras")}
    weights = spectra.xyz_weights(WAVELENGTH)
    for camera in cameras[:52]:
        truth, prior, stated = camera.responsivity, prior_without(cameras[:52], camera), []
        for name in ("A", "D65"):
            light = spectra.illuminant(name, WAVELENGTH)
            chart = photos.REFLECTANCE * light / (light @ weights[1])
            values = np.linalg.lstsq(chart @ weights.T, chart @ truth.T, rcond=None)[0].T
            stated.append(ColourMatrix(name, np.round(values / np.abs(values).max(), 4)))
        ours, usual = (curves.relative for curves in (curves_of_matrices(stated, prior), usual_curves(prior)))
        for name in ("A", "D65", "F11"):
            errors[name].append(response_errors(truth, ours, name, surfaces))
            errors["mean of cameras"].append(response_errors(truth, usual, name, surfaces))
    for name, parts in errors.items():
        median, high = (100 * np.percentile(np.concatenate(parts), share) for share in (50, 95))
        print(f"{name}: {median:.2f} % ({high:.2f})")
        assert name == "mean of cameras" or (median <= 0.4 and high <= 2.0)


def response_errors(truth: np.ndarray, ours: np.ndarray, light: str, surfaces: np.ndarray) -> np.ndarray:
    stimuli = surfaces * spectra.illuminant(light, WAVELENGTH)
    seen, true = stimuli @ ours.T, stimuli @ truth.T
    errors: np.ndarray = np.abs(seen * true.sum(axis=0) / seen.sum(axis=0) - true) / true.max(axis=0)
    return errors.ravel()


def test_a_wrong_light_is_noticed(cameras: list[Camera]) -> None:
    """Every twelfth camera under each light, named as each other one; and named rightly."""
    lights = {name: spectra.illuminant(name, WAVELENGTH) for name in DISTINCT}
    wrong: list[bool] = []
    right: list[bool] = []
    for index, camera in list(enumerate(cameras))[::12]:
        among = priors_without(cameras, camera)
        for true, named in itertools.product(DISTINCT, DISTINCT):
            shot = photos.shot(
                camera.responsivity, true, np.random.default_rng(index), noise=NOISE, glare=0.02, uneven=0.2, named=named
            )
            (right if true == named else wrong).append(compare([shot], 0, among, lights)[1] > NOTICED)
    print(f"noticed {100 * np.mean(wrong):.1f} % of {len(wrong)}, false alarms {100 * np.mean(right):.1f} % of {len(right)}")
    assert np.mean(wrong) >= 0.8
    assert np.mean(right) <= 0.02


@pytest.mark.parametrize("others", [False, True], ids=["one of the 52 left out", "cameras of other sets"])
def test_a_guess_states_its_probability(cameras: list[Camera], others: bool) -> None:
    """Every second camera under each of the usual lights; the priors are of the 52 cameras that come with l3, without it."""
    shipped, lights = cameras[:52], candidates()
    stated: list[float] = []  # probability of the light that is guessed
    hit: list[bool] = []
    doubted: list[bool] = []  # whether the true light, had it been named, would have been warned of
    for index, camera in enumerate((cameras[52:] if others else shipped)[::2]):
        among = priors_without(shipped, camera)
        for number, true in enumerate(lights):
            rng = np.random.default_rng([index, number])
            shot = photos.shot(camera.responsivity, true, rng, noise=0.002, glare=0.02, uneven=0.1)
            likely = probabilities([shot], 0, among, lights)
            guessed = max(likely, key=lambda name: likely[name])
            stated.append(likely[guessed])
            hit.append(guessed == true)
            doubted.append(np.log(likely[guessed] / likely[true]) > NOTICED)
    print(f"guessed rightly {np.mean(hit):.3f}, stated {np.mean(stated):.3f}, true lights doubted {np.mean(doubted):.3f}")
    for low, high in itertools.pairwise((0.0, 0.5, 0.7, 0.9, 0.99, 1.01)):
        inside = [at for at, each in enumerate(stated) if low <= each < high]
        if inside:
            print(
                f"stated {low:g} to {high:g}: {len(inside)} photos, mean {np.mean([stated[at] for at in inside]):.2f}, "
                f"hit {np.mean([hit[at] for at in inside]):.2f}"
            )
    assert np.mean(stated) == pytest.approx(np.mean(hit), abs=0.08)
    assert np.mean(doubted) <= 0.02
