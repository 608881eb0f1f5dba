"""Designs: the closed form is what a brute-force regression reaches; equal arrays have one error and one name."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from l3cli.artifacts.design import LightMoments
from l3cli.design.error import RIDGE, Level, Noise, array_errors, seen_by, wanted_outputs
from l3cli.design.moments import GROUPS, SIDE, Gathered, gather, light_moments
from l3cli.design.search import (
    Problem,
    anneal,
    arrangements,
    canonical,
    distinct,
    every_array,
    independent_outputs,
    multiset_size,
    symmetries,
)
from l3cli.design.tuning import Tuning, error_gradient
from l3cli.frames.frame import least_period

TERMS, NOISE = 3, Noise(floor=9.0, dark=0.0, full=6000.0, prnu=0.01)
CURVES = np.array([[0.4, 0.1, 0.0], [0.1, 0.5, 0.1], [0.0, 0.1, 0.4], [0.5, 0.6, 0.5]])
BASIS = 2000.0 * np.eye(3)


def planes(seed: int) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Coefficients behind a lens, target, coefficients before it, of a scene of coarse random texture."""
    rng = np.random.default_rng(seed)
    coarse = np.kron(rng.uniform(0.1, 1.0, (TERMS, 16, 16)), np.ones((1, 4, 4)))
    sharp = (coarse * rng.uniform(0.8, 1.2, coarse.shape)).astype(np.float32)
    soft = (sharp + np.roll(sharp, 1, 1) + np.roll(sharp, 1, 2)) / np.float32(3)
    colours = np.array([[0.6, 0.4, 0], [0.2, 0.7, 0.1], [0, 0.1, 0.9]], np.float32)
    return soft, np.tensordot(colours, sharp, 1), sharp


@pytest.fixture(scope="module")
def moments() -> LightMoments:
    rng = np.random.default_rng(0)
    sums = gather(*planes(0), 1500, rng) + gather(*planes(1), 1500, rng)
    return light_moments("D65", BASIS, BASIS.sum(axis=1), 0.0, sums)


@pytest.fixture(scope="module")
def problem(moments: LightMoments) -> Problem:
    seen = seen_by(moments, CURVES, wanted_outputs("XYZ", "lab", moments, CURVES))
    return Problem((seen,), (Level("a", 0, 0.9), Level("b", 0, None, 1.0, 0.05)), NOISE)


def test_sums_of_scenes_add_up() -> None:
    one, two = (gather(*planes(n), 300, np.random.default_rng(n)) for n in range(2))
    both = one + two
    assert both.patches.sum() == 600
    assert np.array_equal(both.moment, two.moment + one.moment)


@pytest.mark.parametrize(("output", "counts"), [("XYZ", "lab"), ("XYZ", "linear"), ("bands", "lab"), ("reflectance", "lab")])
def test_the_closed_form_is_what_regression_on_noisy_patches_reaches(output: str, counts: str) -> None:
    """Every patch with many draws of noise: the residual of least squares on them all."""
    rng, count, draws, dose = np.random.default_rng(3), 800, 40, 0.5
    z = rng.uniform(0.1, 1.0, (count, 1, TERMS)) * rng.uniform(0.7, 1.3, (count, SIDE**2, TERMS))
    centre = z[:, SIDE**2 // 2]
    target = centre @ rng.uniform(0, 0.5, (3, TERMS)).T
    weight = (target[:, 1] + 0.02) ** (-2 / 3) if (output, counts) == ("XYZ", "lab") else np.ones(count)
    entries = np.hstack([z.reshape(count, -1), target, target, centre])
    size, taps = entries.shape[1], SIDE**2 * TERMS
    zeros = (np.zeros((2, GROUPS)), np.zeros((2, GROUPS, taps)), np.zeros((2, GROUPS, size, size)))
    sums = Gathered(np.eye(GROUPS)[0] * count, *zeros)
    for place, w in enumerate(((target[:, 1] + 0.02) ** (-2 / 3), np.ones(count))):
        rows = entries * w[:, None]
        sums.weight[place, 0], sums.mean[place, 0], sums.moment[place, 0] = (w**2).sum(), w @ rows[:, :taps], rows.T @ rows
    light = LightMoments("D65", BASIS, BASIS.sum(axis=1), 0.0, sums.patches, sums.weight, sums.mean, sums.moment)
    wanted = wanted_outputs(output, counts, light, CURVES)
    cfa = np.array([[1, 0], [2, 1]])
    errors = array_errors(seen_by(light, CURVES, wanted), cfa, NOISE, [Level("", 0, None, 1.0, dose)])[0, 0]
    y = weight[:, None] * (np.hstack([target, target, centre]) @ wanted.rows.T)
    residuals = []
    for site in np.ndindex(2, 2):
        off = np.arange(SIDE) - SIDE // 2
        filters = cfa[np.ix_((site[0] + off) % 2, (site[1] + off) % 2)].ravel()
        signal = dose * np.einsum("nti,ti->nt", z, CURVES[filters] @ BASIS)
        variance = NOISE.floor + signal + (NOISE.prnu * signal) ** 2
        s = signal + np.sqrt(variance) * rng.standard_normal((draws, *signal.shape))
        rows = (weight[:, None] * s).reshape(draws * count, -1)
        wide = np.tile(y, (draws, 1))
        fit = np.linalg.lstsq(rows, wide, rcond=None)[0]
        residuals.append(np.sqrt(np.square(wide - rows @ fit).sum(axis=1).mean()))
    assert RIDGE < 1e-5
    assert errors == pytest.approx(np.mean(residuals), rel=0.01)


@given(st.integers(0, 2**32 - 1), st.sampled_from([(2, 2), (2, 3), (4, 4)]), st.integers(2, 4))
@settings(max_examples=30, deadline=None)
def test_arrays_that_are_the_same_have_one_name(seed: int, shape: tuple[int, int], filters: int) -> None:
    rng = np.random.default_rng(seed)
    cfa = rng.integers(filters, size=shape)
    other = np.roll(cfa, rng.integers(4, size=2), (0, 1))
    other = other[::-1] if rng.random() < 0.5 else other[:, ::-1]
    other = np.rot90(other, int(rng.integers(4)) if shape[0] == shape[1] else 2)
    assert canonical(other) == canonical(cfa)
    assert sorted(canonical(cfa)) == sorted(cfa.astype(np.uint8).tobytes())


@pytest.mark.parametrize("turn", range(4))
def test_arrays_that_are_the_same_have_one_error(problem: Problem, turn: int) -> None:
    cfa = np.array([[0, 1], [3, 2]])
    other = np.rot90(np.roll(cfa, turn, (0, 1)) if turn % 2 else cfa.T, turn)
    assert problem.errors(other) == pytest.approx(problem.errors(cfa), rel=1e-7)


def test_enumerations_have_each_array_once() -> None:
    shape = (2, 2)
    every = np.array(list(itertools.product(range(3), repeat=4)))
    single = distinct(every, shape, 3)
    names = [canonical(row.reshape(shape)) for row in every]
    assert len(single) == len(set(names)) == len({canonical(row.reshape(shape)) for row in single})
    assert len(symmetries((4, 4))) == 128
    seven = every_array(shape, range(7), None, lambda used: len(used) > 2)
    assert seven is not None
    assert len(seven) == 315
    assert every_array((4, 4), range(5), None, lambda used: True) is None
    counted = list(arrangements([2, 1, 1]))
    assert len(counted) == len(set(map(tuple, counted))) == multiset_size([2, 1, 1]) == 12
    assert all(sorted(each) == [0, 0, 1, 2] for each in counted)


def test_an_array_is_named_by_its_least_period() -> None:
    cfa = np.array([[0, 1, 0, 1], [2, 2, 2, 2]])
    assert least_period(cfa).tolist() == [[0, 1], [2, 2]]
    assert least_period(np.vstack([cfa, cfa[::-1]])).shape == (4, 2)


def test_independent_outputs_are_counted() -> None:
    assert independent_outputs(CURVES[:3]) == 3
    assert independent_outputs(np.array([[1.0, 0, 0], [2, 0, 0], [0, 1, 0]])) == 2


def test_annealing_comes_to_the_best_of_all(problem: Problem) -> None:
    every = every_array((2, 2), range(4), None, lambda used: len(used) > 2)
    assert every is not None
    best = min(problem.score(problem.errors(cfa)) for cfa in every)
    error, _ = anneal(problem, (2, 2), range(4), None, lambda used: len(used) > 2, 120, np.random.default_rng(0))
    assert error == pytest.approx(best, rel=0.01)
    _, counted = anneal(problem, (2, 2), range(3), [1, 2, 1], lambda used: True, 10, np.random.default_rng(0))
    assert sorted(counted.ravel().tolist()) == [0, 1, 1, 2]


@pytest.mark.parametrize("level", [Level("", 0, 0.9, 100.0), Level("", 0, None, 1.0, 0.05), Level("", 0, None, 1.0, 4.0)])
def test_the_gradient_is_what_differences_are(moments: LightMoments, level: Level) -> None:
    """By automatic exposure, by a fixed one, and where groups clip."""
    noise, bayer = Noise(9.0, 20.0, 6000.0, 0.01), np.array([[1, 0], [2, 1]])
    wanted = wanted_outputs("XYZ", "lab", moments, CURVES)
    error, gradient = error_gradient(moments, wanted, CURVES, bayer, noise, level)
    seen = seen_by(moments, CURVES, wanted)
    assert error == pytest.approx((array_errors(seen, bayer, noise, [level])[0] * seen.share).sum(), rel=1e-9)
    for place in [(0, 0), (1, 1), (2, 2), (1, 0), (3, 1)]:
        step = np.zeros_like(CURVES)
        step[place] = 1e-5
        ends = [error_gradient(moments, wanted, CURVES + sign * step, bayer, noise, level)[0] for sign in (1, -1)]
        assert gradient[place] == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-3, abs=1e-6)


def test_tuning_leads_downhill_within_bounds(moments: LightMoments) -> None:
    wavelength, bare = np.array([450.0, 550.0, 650.0]), np.full(3, 0.6)
    given = np.array([[640.0, 60.0, 0.9], [560.0, 60.0, 0.9], [430.0, 60.0, 0.9]])
    levels = (Level("", 0, 0.9), Level("", 0, None, 1.0, 0.02))
    wanted = (wanted_outputs("XYZ", "lab", moments, CURVES),)
    bayer, floors = np.array([[1, 0], [2, 1]]), [0.04] * 3
    tuning = Tuning((moments,), wanted, levels, NOISE, bayer, CURVES, wavelength, bare, (0, 1, 2), given, floors, True)
    score, slopes = tuning.score(given)
    for place in [(0, 0), (1, 1), (2, 2)]:
        step = np.zeros_like(given)
        step[place] = 1e-4
        assert slopes[place] == pytest.approx(
            (tuning.score(given + step)[0] - tuning.score(given - step)[0]) / 2e-4, rel=1e-3
        )
    best, parameters = tuning.descend(given)
    assert best < score - 1e-3
    assert ((parameters >= [400, 10, 0.1]) & (parameters <= [700, 150, 1])).all()


def test_more_light_is_less_error_until_it_clips(moments: LightMoments) -> None:
    seen, bayer = seen_by(moments, CURVES, wanted_outputs("XYZ", "lab", moments, CURVES)), np.array([[1, 0], [2, 1]])
    levels = [Level("", 0, None, 1.0, seconds) for seconds in (0.01, 0.1, 1.0, 100.0)]
    total = array_errors(seen, bayer, NOISE, levels) @ seen.share
    assert total[0] > total[1] > total[2]
    assert total[3] > 2 * total[2]
