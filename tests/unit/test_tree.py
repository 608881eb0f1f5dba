"""Decision trees: values that the tests read, the leaf of each pixel, growth of a tree, and invalid trees."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from l3cli.artifacts.layers import PLANE_TOP
from l3cli.artifacts.plane_rules import FACTORS, MAX_DEPTH, MAX_LEAVES, MAX_SHIFT, ORIENTATIONS, SMALLEST, TESTS, TreeRule
from l3cli.artifacts.schema import equal
from l3cli.classes import tree
from l3cli.classes.windows import Integers
from l3cli.parallel.threads import threaded
from l3cli.training.layers.rules import SAMPLES_PER_TAP, TreeSamples, grow
from l3cli.training.symmetry import orientations
from tests.helpers.tables import random_tree

SIDE = 2 * tree.BORDER_PIXELS + 1


def a_rule(**fields: Any) -> TreeRule:
    """A rule for a level and four sites: a root, a node on its second branch, three leaves."""
    one: dict[str, Any] = {
        "gradient_factor": np.array([64], np.uint8),
        "gradient_shift": np.array([6], np.uint8),
        "test": np.array([0, 0, 20, 0, 0], np.uint8),
        "threshold": np.array([100.0, 0.0, -3.5, 0.0, 0.0], np.float32),
        "branch": np.array([1, 0, 3, 0, 0], np.int32),
        "turns": np.array([0, 1, 4, 7], np.uint8),
        "cases": 2,
    }
    return TreeRule(**(one | fields))


def seen_of(planes: Integers, factor: int = 64, shift: int = 6) -> tree.Evidence:
    """Evidence of planes with a margin of REACH."""
    shape = planes.shape[1] - 2, planes.shape[2] - 2
    return tree.evidence(planes, np.full(shape, factor), np.full(shape, shift))


# ------------------------------------------------------------------------------------------------------------ evidence


@given(st.integers(0, ORIENTATIONS - 1), st.integers(0, 2**32 - 1), st.sampled_from([10, 1000, PLANE_TOP]))
def test_a_turned_picture_shows_what_the_unturned_one_does_where_the_turn_is_known(turn: int, seed: int, top: int) -> None:
    """All tests of a site whose window is read in the order orientations()[turn]; gradients of whole numbers, since
    others are rounded down, whatever their sign."""
    canonical = np.random.default_rng(seed).integers(-top, top + 1, (3, SIDE, SIDE))
    turned = np.empty((3, SIDE**2), np.int64)
    turned[:, orientations(SIDE)[turn]] = canonical.reshape(3, -1)
    one, other = seen_of(canonical), seen_of(turned.reshape(canonical.shape))
    test, sign = tree.turned_tests(turn)
    np.testing.assert_array_equal(other.numerators[test] * np.array(sign)[:, None, None], one.numerators)
    np.testing.assert_array_equal(other.denominators, one.denominators)


def test_orientations_are_distinguished() -> None:
    """As long as something differs between them: no two of the eight rearrange the tests alike."""
    assert len({str(tree.turned_tests(turn)) for turn in range(ORIENTATIONS)}) == ORIENTATIONS
    for turn in range(ORIENTATIONS):
        denominators = [tree.EVERY[test].denominator for test in tree.turned_tests(turn)[0]]
        assert denominators == [test.denominator for test in tree.EVERY]


class Bounded(np.ndarray):
    """Integers whose every result must fit 32 bits, as those of the kernels do."""

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **further: Any) -> Any:
        plain = (each.view(np.ndarray) if isinstance(each, Bounded) else each for each in inputs)
        result = getattr(ufunc, method)(*plain, **further)
        assert np.abs(result).max(initial=0) < 2**31, ufunc
        return result.view(Bounded)


EXTREMES = {
    "checkerboard": lambda row, col: (row + col) % 2,
    "squares": lambda row, col: (row // 2 + col // 2) % 2,
    "columns": lambda row, col: col // 2 % 2,
    "narrow columns": lambda row, col: col % 2,
    "rows": lambda row, col: row // 2 % 2,
    "diagonals": lambda row, col: (row + col) // 2 % 2,
    "edge": lambda row, col: (row + col) // SIDE % 2,
    "top": lambda row, col: row * 0,
    "ramp": lambda row, col: col / (SIDE + 3),
    "ramp down": lambda row, col: (SIDE + 3 - row) / (SIDE + 3),
}


@settings(max_examples=60)
@given(
    st.lists(st.sampled_from([*EXTREMES, "random"]), min_size=3, max_size=3),
    st.lists(st.sampled_from([-1, 1]), min_size=3, max_size=3),
    st.integers(0, MAX_SHIFT),
    st.integers(0, 2**32 - 1),
)
def test_evidence_fits_32_bits(names: list[str], signs: list[int], shift: int, seed: int) -> None:
    """Of planes at both their ends, with the largest factor."""
    row, col = np.mgrid[: SIDE + 4, : SIDE + 4]
    rng = np.random.default_rng(seed)
    ups = [rng.integers(0, 2, row.shape) if name == "random" else EXTREMES[name](row, col) for name in names]
    planes = np.stack([sign * np.rint(PLANE_TOP * (1 - 2 * up)) for sign, up in zip(signs, ups, strict=True)]).astype(
        np.int64
    )
    plain_sums = tree.sums

    def bounded_sums(values: Integers, length: int) -> Integers:
        assert plain_sums(np.abs(values.view(np.ndarray)), length).max() < 2**31  # whatever is added first
        return plain_sums(values.view(np.ndarray), length).view(Bounded)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(tree, "sums", bounded_sums)
        seen = seen_of(planes.view(Bounded), FACTORS[1], shift)
    assert (np.abs(seen.numerators) < 2.0**31).all()
    assert (seen.denominators >= 1).all()


def test_evidence_of_plain_edges_is_what_its_names_state() -> None:
    row, col = np.mgrid[:SIDE, :SIDE] - SIDE // 2
    names = [test.name for test in tree.EVERY]

    def quotient(plane: Integers, name: str) -> float:
        seen = seen_of(np.stack([plane, plane, -plane]))
        number = names.index(name)
        return float(seen.numerators[number, 0, 0] / seen.denominators[tree.EVERY[number].denominator, 0, 0])

    assert quotient(col * 500, "across − down") == pytest.approx(1, abs=0.01)
    assert quotient(row * 500, "across − down") == pytest.approx(-1, abs=0.01)
    assert quotient((row + col) * 500, "diagonal") == pytest.approx(1, abs=0.01)
    assert quotient((row - col) * 500, "diagonal") == pytest.approx(-1, abs=0.01)
    assert quotient((row - col) * 500, "coherence") == pytest.approx(1, abs=0.02)
    assert abs(quotient((row**2 + col**2) * 100, "coherence")) < 0.01
    assert quotient(-col * 500, "slope across") < 0 < quotient(col * 500, "slope across")
    assert quotient(col**2 * 100, "bend across") > 0 == quotient(col**2 * 100, "bend down")
    assert quotient(col * 500, "first chroma along luminance") == pytest.approx(1, abs=0.01)
    assert quotient(col * 500, "second chroma along luminance") == pytest.approx(-1, abs=0.01)
    assert (
        quotient(col % 2 * 500, "chroma curvature across − down")
        > 10
        > -10
        > quotient(row % 2 * 500, "chroma curvature across − down")
    )
    assert quotient(col * 500, "chroma curvature") == 0 < 10 < quotient((row + col) % 2 * 500, "chroma curvature")
    assert quotient(0 * col + 3000, "first chroma") == 1 == -quotient(0 * col + 3000, "second chroma")
    assert quotient(0 * col + 1, "first chroma") == 16 / tree.DARK


# ------------------------------------------------------------------------------------------------------------ leaves


def from_left_to_right(branch: np.ndarray, node: int = 0) -> list[int]:
    """Leaves below a node."""
    first = int(branch[node])
    return [*from_left_to_right(branch, first), *from_left_to_right(branch, first + 1)] if first else [node]


@given(st.integers(1, 60), st.integers(0, 2**32 - 1))
def test_leaves_are_those_of_a_walk_pixel_by_pixel(leaves: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = (12, 13)
    planes = rng.normal(0, 300, (3, shape[0] + 6, shape[1] + 6)).round().astype(np.int64)
    seen = seen_of(planes, 100, 5)
    test, threshold, branch = random_tree(seen, leaves, rng)
    rule = a_rule(test=test, threshold=threshold, branch=branch, turns=rng.integers(0, 8, 4).astype(np.uint8))
    site = rng.integers(0, 4, shape)
    fallen = tree.leaves(seen, site, rule)
    number = {node: leaf for leaf, node in enumerate(from_left_to_right(branch))}
    for row, col in np.ndindex(shape):
        tests, signs = tree.turned_tests(int(rule.turns[site[row, col]]))
        node = 0
        while branch[node]:
            asked = int(test[node])
            numerator = seen.numerators[tests[asked], row, col] * signs[asked]
            above = numerator > threshold[node] * seen.denominators[tree.EVERY[asked].denominator, row, col]
            node = int(branch[node]) + int(above)
        assert fallen[row, col] == number[node]
    assert rule.structures == leaves
    assert np.unique(tree.leaves(seen, site * 0, dataclasses.replace(rule, turns=np.zeros(4, np.uint8)))).size == leaves


# ------------------------------------------------------------------------------------------------------------ rules


def chain(depth: int) -> dict[str, Any]:
    """A tree whose second branches each have a test again."""
    branch = np.zeros(2 * depth + 1, np.int32)
    branch[:-1:2] = np.arange(1, 2 * depth, 2)
    return {"branch": branch, "test": branch.astype(np.uint8) * 0, "threshold": branch.astype(np.float32) * 0}


def full(depth: int) -> dict[str, Any]:
    """A tree of 2^depth leaves."""
    branch = np.arange(1, 2 ** (depth + 2) - 2, 2, dtype=np.int32)
    branch[2**depth - 1 :] = 0
    return {"branch": branch, "test": branch.astype(np.uint8) * 0, "threshold": branch.astype(np.float32) * 0}


def test_trees_at_their_limits() -> None:
    assert (a_rule(**chain(MAX_DEPTH)).depth, a_rule(**chain(MAX_DEPTH)).structures) == (MAX_DEPTH, MAX_DEPTH + 1)
    most = a_rule(**full(11))
    assert (most.structures, most.depth) == (MAX_LEAVES, 11)
    assert most.leaf[-MAX_LEAVES:].tolist() == list(range(MAX_LEAVES))
    lone = a_rule(**chain(0))
    assert (lone.structures, lone.depth, lone.leaf.tolist(), lone.kinds) == (1, 0, [0], 2)


NO_TREE = "branch is not a tree"


@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({"branch": np.array([1, 0, 2, 0, 0], np.int32)}, NO_TREE),  # a node that is its own branch
        ({"branch": np.array([3, 0, 0, 1, 0], np.int32)}, NO_TREE),  # a node that is the branch of one after it
        ({"branch": np.array([1, 0, 1, 0, 0], np.int32)}, NO_TREE),  # two of one branch, and two nodes of none
        ({"branch": np.array([1, 0, 0, 0, 0], np.int32)}, NO_TREE),
        ({"branch": np.array([1, 0, 4, 0, 0], np.int32)}, NO_TREE),  # beyond the last node
        ({"branch": np.array([1, 0, 2**31 - 1, 0, 0], np.int32)}, NO_TREE),
        ({"branch": np.array([1, 0, -3, 0, 0], np.int32)}, NO_TREE),
        ({**full(0), "branch": np.zeros(0, np.int32), "test": np.zeros(0, np.uint8), "threshold": np.zeros(0)}, NO_TREE),
        ({"branch": np.array([1, 0, 0], np.int32)}, "node has length 3 in branch"),
        (chain(MAX_DEPTH + 1), f"the tree has a depth of {MAX_DEPTH + 1} tests, but the depth may be at most {MAX_DEPTH}"),
        (full(12), f"the tree has 4096 leaves, but may have at most {MAX_LEAVES}"),
        ({"test": np.array([0, 0, TESTS, 0, 0], np.uint8)}, f"test must be less than {TESTS}"),
        ({"turns": np.array([0, ORIENTATIONS, 0, 0], np.uint8)}, f"turns must be less than {ORIENTATIONS}"),
        ({"cases": 0}, "cases must be at least 1"),
        ({"gradient_factor": np.array([128], np.uint8)}, "gradient_factor must be at most 127"),
        ({"gradient_shift": np.array([25], np.uint8)}, "gradient_shift at most 24"),
        ({"threshold": np.array([np.nan, 0, 0, 0, 0], np.float32)}, "not finite"),
        ({"threshold": np.array([np.inf, 0, 0, 0, 0], np.float32)}, "not finite"),
        ({"threshold": np.array([2.0**32, 0, 0, 0, 0], np.float32)}, "every threshold must be 0 or have an absolute value"),
        ({"threshold": np.array([-1e-40, 0, 0, 0, 0], np.float32)}, "every threshold must be 0 or have an absolute value"),
    ],
)
def test_what_is_no_tree_is_refused(fields: dict[str, Any], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        a_rule(**fields)


# ------------------------------------------------------------------------------------------------------------ growth


def a_sample(test: int, threshold: float, seed: int, noise: float = 0.0, rows: int = 4000, taps: int = 5) -> TreeSamples:
    """Rows whose targets are made by one filter where a test's quotient exceeds a threshold, and by another elsewhere."""
    rng = np.random.default_rng(seed)
    numerators = rng.normal(size=(TESTS, rows)).astype(np.float32)
    denominators = rng.uniform(0.5, 2, (4, rows)).astype(np.float32)
    above = numerators[test] > np.float32(threshold) * denominators[tree.EVERY[test].denominator]
    seen = rng.normal(size=(rows, taps)).astype(np.float32)
    filters = rng.normal(size=(2, taps, 3))
    target = np.where(above[:, None], seen @ filters[1], seen @ filters[0]) + noise * rng.normal(size=(rows, 3))
    return TreeSamples(np.concatenate([seen, target], axis=1).astype(np.float32), numerators, denominators)


@pytest.mark.parametrize(
    ("test", "threshold"),
    [(0, -0.4), (4, 0.5), (9, 0.0), (14, -0.4), (18, 0.5), (20, 0.0)],  # each of a kind of tests
)
def test_growth_finds_the_test_and_the_threshold_that_made_the_targets(test: int, threshold: float) -> None:
    """Of two sites, each with filters of its own; to a sixth of the rows at the root, and closer farther down."""
    samples = [a_sample(test, threshold, seed, noise=0.3) for seed in (1, 2)]
    root = grow(samples, 2)
    assert root.test[0] == test
    quotient = np.concatenate([np.divide(*one.compared(test, np.arange(4000))) for one in samples])
    assert abs(np.mean(quotient <= root.threshold[0]) - np.mean(quotient <= threshold)) <= 1 / 12 + 0.01
    grown = grow(samples, 8)
    close = np.abs(grown.threshold[grown.test == test] - threshold).min()
    assert close <= max(0.12, abs(root.threshold[0] - threshold) / 3)


def test_growth_stops_where_one_filter_made_everything() -> None:
    """Whatever the noise: of many tests the best seems to gain something by chance alone."""
    for seed in range(6):
        one = a_sample(0, -1e9, seed, noise=10.0**-seed)
        assert len(grow([one, a_sample(3, -1e9, seed + 9, noise=0.1)], 64).branch) <= 3
    constant = dataclasses.replace(one, numerators=one.numerators * 0)
    assert grow([constant], 64).branch.tolist() == [0]


def test_a_leaf_keeps_rows_for_its_filters_at_every_site() -> None:
    samples = [a_sample(2, 0.1, 1, rows=500), a_sample(2, 0.1, 2, rows=90)]
    rule = a_rule(**grow(samples, 64)._asdict())
    assert rule.structures > 1
    for one in samples:
        seen = tree.Evidence(one.numerators, one.denominators)
        fallen = tree.leaves(seen, np.zeros(len(one.columns), np.int64), rule)
        assert np.bincount(fallen, minlength=rule.structures).min() >= SAMPLES_PER_TAP * 5
    assert grow([a_sample(2, 0.1, 1, rows=39)], 64).branch.tolist() == [0]


def test_rows_on_a_threshold_fall_where_they_do_when_rendering() -> None:
    """Not where their quotient, which is rounded, is not above it."""
    ratios = [(n, d) for n in range(1, 99) for d in range(1, 99) if np.float32(n / d) * np.float32(d) < np.float32(n)]
    numerator, denominator = ratios[0]
    one = a_sample(1, 0.0, 1, noise=0.1, rows=1200)
    rows = np.arange(1200)
    tied, low = rows < 700, rows >= 1190
    numerators = np.zeros_like(one.numerators)
    numerators[1] = np.where(tied, numerator, np.where(low, -1, numerator + 5))
    one = dataclasses.replace(one, numerators=numerators, denominators=np.full_like(one.denominators, denominator))
    rng = np.random.default_rng(0)
    columns = one.columns.copy()
    columns[:, 5:] = np.where(
        tied[:, None], columns[:, :5] @ rng.normal(size=(5, 3)), columns[:, :5] @ rng.normal(size=(5, 3))
    )
    rule = a_rule(**grow([dataclasses.replace(one, columns=columns)], 64)._asdict())
    fallen = tree.leaves(tree.Evidence(one.numerators, one.denominators), rows * 0, rule)
    assert np.bincount(fallen, minlength=rule.structures).min() >= SAMPLES_PER_TAP * 5


def test_growth_adds_up_exactly_and_so_the_same_tree_from_rows_in_any_order() -> None:
    one = a_sample(5, 0.3, 1, noise=0.5, rows=3001, taps=19)
    order = np.random.default_rng(0).permutation(3001)
    other = TreeSamples(one.columns[order], one.numerators[:, order], one.denominators[:, order])
    exact, again = (each.on_grid().columns.astype(np.float64) for each in (one, other))
    np.testing.assert_array_equal(exact.T @ exact, again.T @ again)
    plain, permuted = (each.columns.astype(np.float64) for each in (one, other))
    assert not np.array_equal(plain.T @ plain, permuted.T @ permuted)
    assert (np.abs(exact - plain).max(axis=0) <= np.abs(plain).max(axis=0) * 2.0**-16).all()
    trees = [a_rule(**grow([each], 12)._asdict()) for each in (one, other)]
    assert trees[0].structures > 2
    assert equal(*trees)


def test_growth_gives_the_same_tree_in_threads_and_as_many_leaves_as_may_be() -> None:
    samples = [a_sample(6, 0.2, seed, rows=3000) for seed in (1, 2)]
    for leaves in (1, 2, 7):
        with threaded(2) as mapped:
            one, again = (a_rule(**grow(samples, leaves, each)._asdict()) for each in (map, mapped))
        assert equal(one, again)
        assert one.structures <= leaves
    assert (np.abs(one.threshold[one.threshold != 0]) >= SMALLEST).all()
