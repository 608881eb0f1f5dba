"""Normal equations: transforms that do not fit the integer formats are reduced or omitted. Weights for spectral outputs."""

from dataclasses import replace

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.partial_sums import ClassSums, LayerSums
from l3cli.classes.features import ClassRecipe
from l3cli.classes.planes import opponent_basis, room_between, room_for
from l3cli.classes.rule import make_rule
from l3cli.evaluation.quality import spectral_angle
from l3cli.training import systems
from l3cli.training.goal import Goal
from l3cli.training.layers.learn import LayerGoal, solve_layer
from l3cli.training.recipe import LearningRecipe
from l3cli.training.sample_weighting import ERROR_FLOOR, MIN_TARGET, SpectralWeighting
from l3cli.training.solve import Solution, equal_responses, solve
from l3cli.training.sums import pairs
from l3cli.training.symmetry import Turn
from l3cli.training.systems import Equations, Integers, fits, solve_within
from tests.helpers.cameras import random_camera
from tests.helpers.tables import random_table, with_refinement

BITS = Integers(12, 64.0, 4095.0)
WHITE = np.array([0.95, 1.0, 1.09])
CHANNELS = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 1.0]])  # of three taps and no intercept


def equations_of(*classes: tuple[np.ndarray, np.ndarray]) -> Equations:
    """Equations of classes of rows and their targets."""
    power = np.array([rows.T @ rows for rows, _ in classes])
    right = np.array([np.column_stack([rows.T @ targets, CHANNELS.T]) for rows, targets in classes])
    return Equations(power, np.zeros(power.shape[:2]), 0.0, right)


def test_a_solution_that_fits_is_left_as_it_is() -> None:
    rng = np.random.default_rng(0)
    rows = rng.random((50, 3))
    equations = equations_of((rows, rows @ rng.random((3, 2))))
    with_limit, without = (solve_within(equations, 1e-5, CHANNELS, limit) for limit in (BITS, None))
    np.testing.assert_array_equal(with_limit[0], without[0])
    np.testing.assert_array_equal(with_limit[1], without[1])


def test_taps_that_all_but_clip_do_not_get_weights_that_no_layer_could_read() -> None:
    """Two clipped taps differ by a ten-thousandth in one row, in which the target differs by a half; a class solved with
    it, whose solution fits, stays as it is."""
    rows, usual = np.ones((20, 3)), np.random.default_rng(0).random((20, 3))
    rows[3, 2] -= 1e-4
    targets = np.ones((20, 1))
    targets[3] = 1.5
    equations = equations_of((rows, targets), (usual, usual[:, :1]))
    without, _ = solve_within(equations, 1e-12, CHANNELS, None)
    solution, _ = solve_within(equations, 1e-12, CHANNELS, BITS)
    room = [room_for(one[:1, :, 0, None].swapaxes(1, 2), np.zeros((1, 1)), *BITS)[0] for one in (without, solution)]
    assert room[0] < 1
    assert room[1] > 3.9  # four times, rounded
    np.testing.assert_allclose(np.delete(rows, 3, 0) @ solution[0, :, 0], 1.0, atol=0.05)  # what rows have in common stays
    np.testing.assert_array_equal(solution[1], without[1])


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_what_fits_follows_from_the_camera_s_bits(bits: int) -> None:
    top = 2.0**bits - 1
    integers = Integers(bits, top / 16, top)
    rows = np.zeros((2, 82, 3))
    rows[0, 5] = top * 15 / 16 * 2**15 / 2**18 * 0.9  # a weight per DN in steps of a plane below 2¹⁵
    rows[1, 5] = rows[0, 5] * 1.3
    assert fits(rows, np.array([0.0, 1.0, 0.0]), integers).tolist() == [True, False]


def solutions_of(camera: CameraModel, recipe: LearningRecipe, bits: Integers | None) -> tuple[list[Solution], Goal]:
    """A saturated class of one site, learned from four patches of taps that all but clip, and another of many."""
    rule = make_rule(ClassRecipe(patch=3, levels=4, chromas=1), camera, np.array([0, 1, 1, 1], np.uint16))
    rng = np.random.default_rng(1)
    width = 9 + 1 + 3
    row, col = pairs(width)
    count, moments = np.zeros(rule.classes_per_site), np.zeros((rule.classes_per_site, row.size))
    thin, thick = (int(rule.join(level, 0, kind)) for level, kind in ((3, rule.chromas), (2, 0)))
    for index, patches, spread in ((thin, 4, 1e-7), (thick, 5000, 0.5)):
        taps = 1 - spread * rng.random((patches, 9))
        rows = np.column_stack([taps, np.ones(patches), rng.random((patches, 3))])
        count[index], moments[index] = patches, (rows.T @ rows)[row, col]
    goal = Goal(("X", "Y", "Z"), camera.channels, WHITE, None, camera.black_level, camera.white_level, integers=bits)
    window = camera.cfa[np.arange(9) // 3 % 2, np.arange(9) % 3 % 2].astype(np.int64)
    sums = ClassSums(moments, np.zeros((count.size, 9)), count)
    return [solve(sums, rule, window, [Turn(np.arange(9), np.arange(count.size))], recipe, goal)], goal


@pytest.mark.parametrize("steps", [systems.MAX_RIDGE_STEPS, 0])
def test_no_transform_of_a_table_is_too_large(steps: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where no ridge makes a class fit, which then takes the transform of the nearest."""
    camera = random_camera([[0, 1], [1, 0]], 2, 12, 64.0)
    recipe = LearningRecipe(ridge=1e-14, parent_patches=0, plain_surfaces=0.0)
    rule = make_rule(ClassRecipe(patch=3, levels=4, chromas=1), camera, np.array([0, 1, 1, 1], np.uint16))

    def room(bits: Integers | None) -> float:
        solutions, goal = solutions_of(camera, recipe, bits)
        table = equal_responses(solutions, [1], rule, recipe, goal)[0]
        basis = opponent_basis(WHITE)
        planes = np.einsum("cot,op->cpt", table.weights, basis)
        return float(room_for(planes, table.intercept @ basis, *BITS).min())

    monkeypatch.setattr(systems, "MAX_RIDGE_STEPS", steps)
    assert room(None) < 1
    assert room(BITS) > 1


def test_nor_one_between_layers() -> None:
    """Of a class whose rows all but agree, so that their differences are taken for what the target differs by."""
    table = with_refinement(random_table([[0, 1], [1, 0]]), 3)
    rule = table.later[0].rule
    taps, rng = 27, np.random.default_rng(2)
    row, col = pairs(taps + 1 + 3)
    count = np.zeros(rule.classes_per_site)
    moments = np.zeros((rule.classes_per_site, row.size))
    for index, spread in ((rule.join(0, 0), 0.5), (rule.join(1, 0), 1e-9)):
        windows = 1 - spread * rng.random((200, taps))
        rows = np.column_stack([windows, np.ones(200), rng.random((200, 3))])
        count[index], moments[index] = 200, (rows.T @ rows)[row, col]
    sums = LayerSums(moments, np.zeros((count.size, taps * (taps + 1) // 2)), count)
    goal = LayerGoal((), 0.0, 1e-18, (1.0, 1.0, 1.0), np.array([0.0, 1.0, 0.0]), taps)
    (solved,) = solve_layer([sums], [1], rule, goal)
    planes = np.swapaxes(solved, 1, 2)
    assert room_between(planes[..., :-1], planes[..., -1]).min() > 1
    np.testing.assert_array_equal(solved[rule.join(1, 0)], solved[rule.join(0, 0)])


def test_strengths_share_their_rows() -> None:
    """Those of one direction, none with the lowest: the middle one of four with its neighbours."""
    table = with_refinement(random_table([[0, 1], [1, 0]]), 3)
    structure = table.later[0].structure
    assert structure is not None
    rule = replace(structure, strength_edges=np.array([100, 200, 300, 400], np.uint32))
    taps, rng = 27, np.random.default_rng(2)
    row, col = pairs(taps + 1 + 3)
    edges = [rule.join(0, 1 + 9 * strength + 2) for strength in range(4)]
    count, moments = np.zeros(rule.classes_per_site), np.zeros((rule.classes_per_site, row.size))
    for index in (*edges, rule.join(0, edges[2] + 1)):
        rows = np.column_stack([rng.random((200, taps)), np.ones(200), rng.random((200, 3))])
        count[index], moments[index] = 200, (rows.T @ rows)[row, col]
    noise = np.tile(np.eye(taps)[np.triu_indices(taps)], (count.size, 1)) * count[:, None]

    def solved(moments: np.ndarray, noise: np.ndarray, pool: float = 0.0) -> np.ndarray:
        about = (1e-9, (1.0, 1.0, 1.0), np.array([0.0, 1.0, 0.0]), taps)
        return solve_layer([LayerSums(moments, noise, count)], [1], rule, LayerGoal((), 0.0, *about, strength_pool=pool))[0]

    alone, shared = solved(moments, noise), solved(moments, noise, 0.5)
    expected_moments, expected_noise = moments.copy(), noise.copy()
    for index, others in ((edges[1], edges[2:3]), (edges[2], edges[1::2]), (edges[3], edges[2:3])):
        expected_moments[index] += 0.5 * moments[others].sum(axis=0)
        expected_noise[index] += 0.5 * noise[others].sum(axis=0)
    np.testing.assert_allclose(shared, solved(expected_moments, expected_noise), rtol=0, atol=1e-9)
    changed = np.flatnonzero((shared != alone).any(axis=(1, 2)))
    assert set(edges[1:]) <= set(changed)
    assert not {edges[0], rule.join(0, edges[2] + 1)} & set(changed)


@pytest.mark.parametrize("exact", [False, True])
def test_uniform_areas_keep_stokes_parameters_exactly(exact: bool) -> None:
    """The target of output 0 is 1.2 times plane 0. A layer for Stokes parameters does not amplify uniform areas."""
    table = with_refinement(random_table([[0, 1], [1, 0]]), 3)
    rule = table.later[0].rule
    taps, rng = 27, np.random.default_rng(2)
    windows = rng.random((400, taps))
    means = windows.reshape(400, 3, -1).mean(axis=2)  # (sample, plane)
    rows = np.column_stack([windows, np.ones(400), means * [1.2, 1.0, 1.0]])
    count, moments = np.zeros(rule.classes_per_site), np.zeros((rule.classes_per_site, (taps + 4) * (taps + 5) // 2))
    count[0], moments[0] = 400, (rows.T @ rows)[pairs(taps + 4)]
    sums = LayerSums(moments, np.zeros((count.size, taps * (taps + 1) // 2)), count)
    goal = LayerGoal((), 0.0, 1e-12, (1.0, 1.0, 1.0), np.array([0.0, 1.0, 0.0]), taps, (0, -1, 2), exact=exact)
    (solved,) = solve_layer([sums], [1], rule, goal)
    response = solved[0, :taps].reshape(3, -1, 3).sum(axis=1)  # (plane, output)
    expected = np.diag([1.0 if exact else 1.2, 1.0, 1.0])
    np.testing.assert_allclose(response, expected, atol=1e-6)


TAPS, OUTPUTS, COUNT = 9, 6, 40
POWER = 0.25


def error(weight: np.ndarray) -> np.ndarray:
    """Squared error in degrees that a weight stands for."""
    return weight ** (-1 / POWER) - ERROR_FLOOR


def patches() -> tuple[SpectralWeighting, dict]:
    rng = np.random.default_rng(3)
    weights = rng.normal(0, 0.02, (2, TAPS, OUTPUTS)).astype(np.float32)
    intercept = np.full((2, OUTPUTS), 0.3, np.float32)
    clean = rng.uniform(0, 1, (COUNT, TAPS)).astype(np.float32)
    target = rng.normal(0.3, 0.03, (COUNT, OUTPUTS)).astype(np.float32)
    runs = [(0, 0, 25), (1, 25, COUNT)]
    about = {"clean": clean, "target": target, "level": target.mean(axis=1), "runs": runs}
    return SpectralWeighting(weights, (weights**2).sum(axis=2), intercept, POWER), about


def outputs(weighting: SpectralWeighting, clean: np.ndarray) -> np.ndarray:
    of = np.repeat([0, 1], [25, COUNT - 25])
    return np.einsum("pt,pto->po", clean, weighting.weights[of]) + weighting.intercept[of]


def test_rows_weigh_by_the_spectral_angle_of_the_first_pass() -> None:
    weighting, about = patches()
    weight = weighting.weight(variance=np.zeros((COUNT, TAPS), np.float32), **about)
    made = outputs(weighting, about["clean"])
    size = np.linalg.norm(about["target"], axis=1)
    across = np.sin(np.radians(spectral_angle(made.T[..., None], about["target"].T[..., None])[:, 0]))
    angle = np.degrees(across * np.linalg.norm(made, axis=1) / size)  # of an output as long as the target
    np.testing.assert_allclose(error(weight), angle**2, rtol=1e-3)


def test_brighter_or_darker_outputs_of_the_right_spectrum_weigh_as_none() -> None:
    weighting, about = patches()
    about["target"] = outputs(weighting, about["clean"]) / 1.3
    weight = weighting.weight(variance=np.zeros((COUNT, TAPS), np.float32), **about)
    np.testing.assert_allclose(weight, ERROR_FLOOR**-POWER, rtol=1e-4)


def test_noise_counts_as_the_angle_that_it_makes_on_average() -> None:
    weighting, about = patches()
    about["target"] = outputs(weighting, about["clean"])
    variance = np.full((COUNT, TAPS), 0.01**2, np.float32)
    rng = np.random.default_rng(4)
    noisy = [outputs(weighting, about["clean"] + rng.normal(0, 0.01, (COUNT, TAPS))) for _ in range(400)]
    angles = [spectral_angle(each.T[..., None], about["target"].T[..., None]) for each in noisy]
    # Noise of the outputs is no more along the spectrum than across it: what is left out is a matter of single patches.
    expected = np.mean(error(weighting.weight(variance=variance, **about)))
    assert expected == pytest.approx(np.mean(np.square(angles)), rel=0.1)


def test_targets_darker_than_a_fiftieth_of_their_level_are_judged_no_more_strictly() -> None:
    weighting, about = patches()
    about["target"] = np.zeros((COUNT, OUTPUTS), np.float32)
    about["level"] = np.ones(COUNT, np.float32)
    weight = weighting.weight(variance=np.zeros((COUNT, TAPS), np.float32), **about)
    made = np.linalg.norm(outputs(weighting, about["clean"]), axis=1)
    np.testing.assert_allclose(error(weight), (np.degrees(made / MIN_TARGET) ** 2) / OUTPUTS, rtol=1e-3)
