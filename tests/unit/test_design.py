"""Designs: the closed-form error equals a brute-force regression, and equal arrays have the same error and name."""

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.design import GROUPS, SIDE, LightMoments
from l3cli.design.error import (
    TAP_RIDGE,
    Level,
    Noise,
    Seen,
    Sums,
    array_errors,
    empty_sums,
    gather,
    groups_of,
    in_all_orientations,
    noise_of,
    seen_by,
    spectra_of,
    wanted_outputs,
)
from l3cli.design.search import (
    Problem,
    anneal,
    arrangements,
    canonical,
    distinct,
    every_array,
    independent_outputs,
    symmetries,
)
from l3cli.physics.mosaic import least_period

TERMS, NOISE = 3, Noise(floor=9.0, dark=0.0, full=6000.0, uneven=1e-4)
CURVES = np.array([[0.4, 0.1, 0.0], [0.1, 0.5, 0.1], [0.0, 0.1, 0.4], [0.5, 0.6, 0.5]])
BASIS = 2000.0 * np.eye(3)
HUES = ((0.4, 0.3, 0.1), (0.15, 0.2, 0.1), (0.1, 0.15, 0.4), (0.3, 0.2, 0.3))  # XYZ over white


def planes(seed: int) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Coefficients behind a lens, target, coefficients before it, of a scene of coarse random texture."""
    rng = np.random.default_rng(seed)
    coarse = np.kron(rng.uniform(0.1, 1.0, (TERMS, 16, 16)), np.ones((1, 4, 4)))
    sharp = (coarse * rng.uniform(0.8, 1.2, coarse.shape)).astype(np.float32)
    soft = (sharp + np.roll(sharp, 1, 1) + np.roll(sharp, 1, 2)) / np.float32(3)
    colours = np.array([[0.6, 0.4, 0], [0.2, 0.7, 0.1], [0, 0.1, 0.9]], np.float32)
    return soft, np.tensordot(colours, sharp, 1), sharp


def gathered(rng: np.random.Generator, patches: int, *scenes: int) -> Sums:
    sums = empty_sums(TERMS)
    for scene in scenes:
        gather(sums, *planes(scene), patches, rng)
    return sums


@pytest.fixture(scope="module")
def moments() -> LightMoments:
    rng = np.random.default_rng(0)
    sums = gathered(rng, 1500, 0, 1)
    return LightMoments("D65", BASIS, BASIS.sum(axis=1), **in_all_orientations(sums, TERMS))


def seen(moments: LightMoments, output: str = "XYZ", counts: str = "lab") -> Seen:
    return seen_by(CURVES, moments, spectra_of(moments, output, counts, CURVES))


@pytest.fixture(scope="module")
def problem(moments: LightMoments) -> Problem:
    return Problem((seen(moments),), (Level("a", 0, 0.9), Level("b", 0, None, 1.0, 0.05)), NOISE)


def test_sums_of_scenes_add_up() -> None:
    rng, again = np.random.default_rng(1), np.random.default_rng(1)
    both, one, two = gathered(rng, 300, 0, 1), gathered(again, 300, 0), gathered(again, 300, 1)
    assert both["patches"].sum() == 600
    assert np.array_equal(both["moment"], one["moment"] + two["moment"])


def test_each_group_is_averaged_over_all_orientations() -> None:
    """The mean is the same however the patches are turned or mirrored, and of as much power."""
    sums, rng = empty_sums(TERMS), np.random.default_rng(5)
    for name in ("patches", "moment", "mean"):
        sums[name] += rng.uniform(1, 2, sums[name].shape)
    averaged = in_all_orientations(sums, TERMS)
    taps = np.arange(SIDE**2 * TERMS).reshape(SIDE, SIDE, TERMS)
    behind = np.arange(taps.size, sums["moment"].shape[-1])
    for turned in (taps[::-1], taps.swapaxes(0, 1)):  # every other orientation is made of these two
        order = np.concatenate([turned.ravel(), behind])
        np.testing.assert_allclose(averaged["moment"][:, :, order[:, None], order], averaged["moment"], rtol=1e-12)
        np.testing.assert_allclose(averaged["mean"][:, :, turned.ravel()], averaged["mean"], rtol=1e-12)
    for part in (np.arange(taps.size), behind):
        traces = [np.einsum("pgii->pg", each["moment"][:, :, part[:, None], part]) for each in (averaged, sums)]
        np.testing.assert_allclose(traces[0], traces[1], rtol=1e-12)
    np.testing.assert_allclose(averaged["mean"].sum(axis=2), sums["mean"].sum(axis=2), rtol=1e-12)


@pytest.mark.parametrize(
    ("output", "counts", "rows", "columns"),
    [
        ("XYZ", "lab", 0, 0),
        ("XYZ", "linear", 0, 0),
        ("bands", "lab", 0, 0),
        ("reflectance", "lab", 0, 0),
        ("XYZ", "lab", 40, 20),
    ],
)
def test_the_closed_form_is_what_regression_on_noisy_patches_reaches(
    output: str, counts: str, rows: float, columns: float
) -> None:
    """Every patch with many draws of noise: the residual of least squares on them all."""
    rng, count, draws, dose = np.random.default_rng(3), 800, 40, 0.5
    z = rng.uniform(0.1, 1.0, (count, 1, TERMS)) * rng.uniform(0.7, 1.3, (count, SIDE**2, TERMS))
    centre = z[:, SIDE**2 // 2]
    target = centre @ rng.uniform(0, 0.5, (3, TERMS)).T
    weight = (target[:, 1] + 0.02) ** (-2 / 3) if (output, counts) == ("XYZ", "lab") else np.ones(count)
    entries = np.hstack([z.reshape(count, -1), target, target, centre])
    size, taps = entries.shape[1], SIDE**2 * TERMS
    sums = {"patches": np.eye(len(GROUPS))[0] * count, "weight": np.zeros((2, 30)), "mean": np.zeros((2, 30, taps))}
    sums["moment"] = np.zeros((2, 30, size, size))
    for place, w in enumerate(((target[:, 1] + 0.02) ** (-2 / 3), np.ones(count))):
        weighted = entries * w[:, None]
        sums["weight"][place, 0], sums["mean"][place, 0] = (w**2).sum(), w @ weighted[:, :taps]
        sums["moment"][place, 0] = weighted.T @ weighted
    light = LightMoments("D65", BASIS, BASIS.sum(axis=1), **sums)
    cfa = np.array([[1, 0], [2, 1]])
    noise = dataclasses.replace(NOISE, floor=NOISE.floor + rows + columns, rows=rows, columns=columns)
    errors = array_errors(seen(light, output, counts), cfa, noise, Level("", 0, None, 1.0, dose))[0]
    y = weight[:, None] * (np.hstack([target, target, centre]) @ wanted_outputs(light, output, counts, CURVES)[0].T)
    residuals = []
    for site in np.ndindex(2, 2):
        off = np.arange(SIDE) - SIDE // 2
        filters = cfa[np.ix_((site[0] + off) % 2, (site[1] + off) % 2)].ravel()
        signal = dose * np.einsum("nti,ti->nt", z, CURVES[filters] @ BASIS)
        variance = NOISE.floor + signal + NOISE.uneven * signal**2
        s = signal + np.sqrt(variance) * rng.standard_normal((draws, *signal.shape))
        for shared, axis in ((rows, 1), (columns, 0)):
            of_lines = rng.standard_normal((draws, count, SIDE)) * np.sqrt(shared) if shared else np.zeros(SIDE)
            s += of_lines[..., np.indices((SIDE, SIDE))[1 - axis].ravel()]
        taken = (weight[:, None] * s).reshape(draws * count, -1)
        wide = np.tile(y, (draws, 1))
        fit = np.linalg.lstsq(taken, wide, rcond=None)[0]
        residuals.append(np.sqrt(np.square(wide - taken @ fit).sum(axis=1).mean()))
    assert TAP_RIDGE < 1e-5
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
    assert len(counted) == len(set(map(tuple, counted))) == 12
    assert all(sorted(each) == [0, 0, 1, 2] for each in counted)


def test_patches_are_grouped_by_contrast_level_and_hue() -> None:
    grey = np.full((3, 1, 5, 5), 0.5)
    edge, dark = grey.copy(), grey / 20
    edge[:, :, :2] /= 4
    colours = [np.reshape(xyz, (3, 1, 1, 1)) * np.ones((1, 1, 5, 5)) for xyz in HUES]
    groups = groups_of(np.concatenate([grey, edge, dark, *colours], axis=1).astype(np.float32))
    assert [GROUPS[each] for each in groups] == [
        "plain bright neutral", "edge bright neutral", "plain dark neutral", "plain bright orange", "plain middle green",
        "plain middle blue", "plain middle magenta",
    ]  # fmt: skip


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
    best = min(map(problem.score, every))
    rng, start = np.random.default_rng(0), np.array([[0, 1], [2, 3]])
    found = anneal(problem, start, range(4), False, lambda used: len(used) > 2, rng, 120)
    assert problem.score(found) == pytest.approx(best, rel=0.01)
    counted = anneal(problem, np.array([[0, 1], [1, 2]]), range(3), True, lambda used: True, rng, 10)
    assert sorted(counted.ravel().tolist()) == [0, 1, 1, 2]


def test_more_light_is_less_error_until_it_clips(moments: LightMoments) -> None:
    bayer = np.array([[1, 0], [2, 1]])
    levels = [Level("", 0, None, 1.0, seconds) for seconds in (0.01, 0.1, 1.0, 100.0)]
    total = Problem((seen(moments),), tuple(levels), NOISE).means(bayer)
    assert total[0] > total[1] > total[2]
    assert total[3] > 2 * total[2]


def test_designs_have_the_noise_of_cameras(fiveband: CameraModel) -> None:
    """Designs have a formula of their own. Each noise parameter, and each new one, must be part of both formulas."""
    names = [each.name for each in dataclasses.fields(fiveband.noise) if each.name != "well_capacity"]
    values = {name: getattr(fiveband.noise, name) or 0.01 for name in names}
    camera = dataclasses.replace(fiveband, noise=dataclasses.replace(fiveband.noise, **values))
    noise, (constant, linear, quadratic) = noise_of(camera), camera.noise_terms()
    assert constant == pytest.approx(noise.floor * camera.gain**2, rel=1e-9)
    assert linear == pytest.approx(camera.gain, rel=1e-9)
    assert quadratic == pytest.approx(noise.uneven, rel=1e-9)
    assert camera.line_variances() == pytest.approx(np.multiply((noise.rows, noise.columns), camera.gain**2), rel=1e-9)
    for name, value in values.items():
        less = dataclasses.replace(camera, noise=dataclasses.replace(camera.noise, **{name: value / 2}))
        assert noise_of(less) != noise, name
        assert less.noise_terms(less.dark_signal(1.0)) != camera.noise_terms(camera.dark_signal(1.0)), name
