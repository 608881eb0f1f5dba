"""The integer class rule: exact in 32 bits, and equal for mosaics and for patches (docs/method.md#classes)."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from l3cli.artifacts.camera import CameraModel
from l3cli.classes.chroma import chroma_centres, chroma_widths
from l3cli.classes.decide import label_mosaic, label_patches, labels
from l3cli.classes.features import ClassRecipe
from l3cli.classes.level import LEVEL_FRACTION
from l3cli.classes.rule import make_rule
from l3cli.classes.statistics import mosaic_statistics
from l3cli.classes.windows import neighbourhoods, sites
from l3cli.errors import RecipeError
from l3cli.frames.frame import mirrored_indices, pad_mosaic
from tests.helpers.tables import random_case_of_code


def windows(values: np.ndarray, patch: int, cfa_shape: tuple[int, int]) -> np.ndarray:
    padded = pad_mosaic(values, patch // 2, cfa_shape)
    return np.lib.stride_tricks.sliding_window_view(padded, (patch, patch)).reshape(*values.shape, -1)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(4, 23), st.integers(4, 23), st.integers(0, 3), st.integers(0, 3))
def test_mosaic_and_patches_are_labelled_alike(
    fiveband: CameraModel, seed: int, rows: int, cols: int, row_phase: int, col_phase: int
) -> None:
    rng = np.random.default_rng(seed)
    centres = rng.dirichlet(np.ones(5), 6)
    recipe = ClassRecipe(contrasts=(1.4, 4.0), chroma_dither=bool(seed % 2))
    rule = make_rule(recipe, fiveband, random_case_of_code(5, rng), centres)
    values = rng.choice([0, 109, 120, 700, 4000, 4095], (rows, cols)).astype(np.uint16)
    values[: rows // 2] = rng.integers(100, 140, (rows // 2, cols))
    labels = label_mosaic(values, rule, fiveband.cfa, 5, (row_phase, col_phase))
    neighbours = neighbourhoods(fiveband.cfa, rule.patch, 5)
    site = sites(rows, cols, fiveband.cfa.shape, (row_phase, col_phase))
    patches = windows(values, rule.patch, fiveband.cfa.shape)
    for number in np.unique(site):
        of_site = label_patches(patches[site == number], rule, neighbours, number) + number * rule.classes_per_site
        assert (of_site == labels[site == number]).all()


def test_one_contrast_asks_for_no_squares_and_changes_no_other_feature(fiveband: CameraModel) -> None:
    rng = np.random.default_rng(2)
    about = fiveband, random_case_of_code(5, rng), rng.dirichlet(np.ones(5), 6)
    values = rng.integers(100, 4096, (24, 31)).astype(np.uint16)
    neighbours, places = neighbourhoods(fiveband.cfa, 9, 5), []
    for contrasts in ((1.4,), ()):
        rule = make_rule(ClassRecipe(contrasts=contrasts), *about)
        statistics = mosaic_statistics(values, rule, neighbours, fiveband.cfa, (0, 0))
        assert (statistics.squares is None) == (not contrasts)
        places.append(rule.split(labels(rule, statistics)))
    listed, one = places
    assert listed.contrast.max() == 1
    assert one.contrast.max() == 0
    assert (listed.level == one.level).all()
    assert (listed.kind == one.kind).all()


@pytest.mark.parametrize(("rows", "cols"), [(1, 1), (1, 23), (3, 2), (23, 3)])
def test_a_mosaic_smaller_than_the_array_has_labels_of_its_sites(fiveband: CameraModel, rows: int, cols: int) -> None:
    """Its padding repeats samples of other channels, so that there are no patches to compare with."""
    rng = np.random.default_rng(rows)
    rule = make_rule(ClassRecipe(contrasts=(1.4, 4.0)), fiveband, random_case_of_code(5, rng), rng.dirichlet(np.ones(5), 6))
    labels = label_mosaic(rng.integers(0, 4096, (rows, cols)).astype(np.uint16), rule, fiveband.cfa, 5, (1, 2))
    assert (labels // rule.classes_per_site == sites(rows, cols, fiveband.cfa.shape, (1, 2))).all()


def extreme_patches(taps: int) -> np.ndarray:
    rng = np.random.default_rng(5)
    black_and_white = rng.choice([0, 65535], (200, taps)).astype(np.uint16)
    flat = np.full((1, taps), 65535, np.uint16)
    half = np.where(np.arange(taps) % 2, 65535, 0).astype(np.uint16)[None]
    return np.concatenate([black_and_white, flat, half])


def test_sites_take_the_second_chroma_in_turn(fiveband: CameraModel) -> None:
    """Along a line from one centre to the next a growing share of the sites takes the other, half of them in the middle, and
    none near the centres; without dither all change at once."""
    centres = np.array([[0.3, 0.2, 0.2, 0.2, 0.1], [0.1, 0.2, 0.2, 0.2, 0.3], [0.05, 0.05, 0.05, 0.8, 0.05]])
    neighbours = neighbourhoods(fiveband.cfa, 9, 5)
    for dither in (False, True):
        recipe = ClassRecipe(contrasts=(), chroma_dither=dither)
        rule = make_rule(recipe, fiveband, np.zeros(32, np.uint16), centres)
        kept = chroma_centres(rule)
        shares = []
        for step in np.linspace(0, 1, 33):
            mean = 5000.0 * ((1 - step) * kept[0] + step * kept[1]) + fiveband.black_level
            chromas = []
            for site in range(16):
                patch = np.rint(mean[neighbours.channel[site]])[None].astype(np.uint16)
                chromas.append(int(rule.split(label_patches(patch, rule, neighbours, site)[0]).kind))
            assert set(chromas) <= {0, 1}
            shares.append(np.mean(chromas))
        assert np.all(np.diff(shares) >= 0)
        assert (shares[0], shares[-1]) == (0, 1)
        inner = [share for share in shares if 0 < share < 1]
        if dither:
            assert shares[16] == pytest.approx(0.5, abs=1 / 16)
            assert max(np.diff(shares)) <= 1 / 8
        else:
            assert len(inner) <= 1  # rounded values of the middle are not quite there


@pytest.mark.parametrize("patch", [5, 9, 15])
def test_the_sums_fit_32_bits(fiveband: CameraModel, patch: int) -> None:
    """The formulas evaluated in wrapping 32-bit arithmetic, as a kernel does, for the extremes of 16-bit values."""
    camera = dataclasses.replace(fiveband, bits=16, white_level=65535.0)
    recipe = ClassRecipe(patch=patch, contrasts=(1.4, 4.0), chroma_dither=True)
    rule = make_rule(recipe, camera, np.zeros(32, np.uint16), np.eye(5))
    neighbours = neighbourhoods(camera.cfa, patch, 5)
    patches = extreme_patches(patch**2)
    for site in range(16):
        expected = label_patches(patches, rule, neighbours, site)
        member = neighbours.channel[site][:, None] == np.arange(5)
        values = (patches >> rule.shift).astype(np.uint32)
        level_sum = np.zeros(len(patches), np.uint32)
        score = np.zeros((len(rule.chroma_weights), len(patches)), np.int32)
        contrast_sum, channel_sum = np.zeros(len(patches), np.uint32), np.zeros(len(patches), np.int32)
        for channel in range(5):
            of_channel = values[:, member[:, channel]]
            total, square = of_channel.sum(axis=1, dtype=np.uint32), (of_channel * of_channel).sum(axis=1, dtype=np.uint32)
            scaled = total * np.uint32(neighbours.mean_reciprocal[site, channel])
            mean = scaled >> np.uint32(16)
            deviation = square - mean * (total + total - np.uint32(neighbours.count[site, channel]) * mean)
            level_sum += scaled >> np.uint32(8)
            signal = np.maximum((scaled >> np.uint32(12)).astype(np.int32) - np.int32(rule.chroma_black_level), 0)
            signal = np.minimum(signal, 65535)
            score += signal * rule.chroma_weights[:, channel, None]
            channel_sum += signal
            product = deviation * np.uint32(neighbours.variance_reciprocal[site, channel])
            contrast_sum += np.minimum(product, np.uint32((2**32 - 1) // 5))
        level = np.searchsorted(rule.level_edges, level_sum, side="right")
        nearest, second = np.argsort(score, axis=0, kind="stable")[:2]
        least, next_least = np.sort(score, axis=0)[:2]
        turn = np.int32(2 * (site * 159 + 79 & 255) - 255)
        reach = ((channel_sum >> 8) * chroma_widths(rule)[nearest] >> 8) * np.where(nearest < second, turn, -turn)
        assert reach.dtype == np.int32
        chroma = np.where(next_least - least < reach, second, nearest)
        contrast = (contrast_sum[None] > rule.contrast_edges[:, level]).sum(axis=0)
        assert ((level * rule.contrasts + contrast) * rule.kinds + chroma == expected).all()


def test_level_contrast_and_case_mean_what_they_state(fiveband: CameraModel) -> None:
    rng = np.random.default_rng(0)
    case_of_code = np.zeros(32, np.uint16)
    case_of_code[0b00010] = 1
    rule = make_rule(ClassRecipe(), fiveband, case_of_code)
    span = fiveband.white_level - fiveband.black_level

    def label(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        labels = label_mosaic(values.astype(np.uint16), rule, fiveband.cfa, 5)
        level, contrast, case = np.unravel_index(
            labels[20:40, 20:40] % rule.classes_per_site, (rule.levels, rule.contrasts, rule.kinds)
        )
        return level, contrast, case

    previous = -1.0
    for share in (0.002, 0.02, 0.2, 0.8):
        mean = fiveband.black_level + share * span
        noisy = mean + rng.standard_normal((60, 60)) * np.sqrt(fiveband.noise_variance(np.array(share * span)))
        level, contrast, case = label(np.rint(noisy).clip(0, 4095))
        assert np.abs(level - np.median(level)).max() <= 1
        assert level.mean() > previous + 2
        previous = level.mean()
        assert contrast.mean() < 0.15  # noise alone is not texture
        assert (case == 0).all()
        stripes = mean + 0.5 * share * span * (np.arange(60) // 4 % 2 * 2 - 1)[None].repeat(60, 0)
        if share > 0.01:  # below, stripes drown in noise
            assert label(stripes)[1].mean() > 0.95
    bright = np.full((60, 60), 1000)
    green = fiveband.cfa[np.ix_(np.arange(60) % 4, np.arange(60) % 4)] == 1
    bright[green] = 4095
    assert (label(bright)[2] == 1).all()


@pytest.mark.parametrize(
    ("recipe", "message"),
    [
        (ClassRecipe(patch=3), "does not contain every channel"),
        (ClassRecipe(levels=1), "levels ≥ 2"),
        (ClassRecipe(levels=60000), "more levels than distinct values"),
        (ClassRecipe(contrasts=(2.0, 1.0)), "increasing order"),
        (ClassRecipe(patch=8), "odd"),
        (ClassRecipe(patch=17), "odd number from 1 to 15"),
        (ClassRecipe(highest_level=1.2), "highest_level < 1"),
        (ClassRecipe(level_edges=(0.2, 0.1)), "increasing numbers"),
        (ClassRecipe(level_edges=()), "increasing numbers"),
        (ClassRecipe(level_edges=(0.5, 1.0)), "between 0 and 1"),
    ],
)
def test_an_impossible_rule_is_refused(fiveband: CameraModel, recipe: ClassRecipe, message: str) -> None:
    with pytest.raises(RecipeError, match=message):
        make_rule(recipe, fiveband, np.zeros(32, np.uint16))


def test_level_edges_are_spaced_or_given(fiveband: CameraModel) -> None:
    def edges(**keys: Any) -> np.ndarray:
        rule = make_rule(ClassRecipe(**keys), fiveband, np.zeros(32, np.uint16))
        values = rule.level_edges / (2**LEVEL_FRACTION * 5)
        return (values - fiveband.black_level) / (fiveband.white_level - fiveband.black_level)

    step = 1 / (2**LEVEL_FRACTION * 5) / (fiveband.white_level - fiveband.black_level)
    assert edges(levels=5, lowest_level=0.2, highest_level=0.8, spacing="linear") == pytest.approx(
        [0.2, 0.4, 0.6, 0.8], abs=step
    )
    assert edges(levels=4, lowest_level=0.1, highest_level=0.9) == pytest.approx([0.1, 0.3, 0.9], abs=step)
    assert edges(levels=7, level_edges=(0.05, 0.5)) == pytest.approx([0.05, 0.5], abs=step)


@settings(deadline=None)
@given(st.integers(1, 40), st.integers(0, 7), st.integers(1, 8))
def test_padding_keeps_the_cfa_phase(length: int, margin: int, period: int) -> None:
    indices = mirrored_indices(length, margin, period)
    wanted = np.arange(-margin, length + margin)
    assert indices.min() >= 0
    assert indices.max() < length
    assert (indices[margin : margin + length] == np.arange(length)).all()
    if length >= period:
        assert ((indices - wanted) % period == 0).all()


def test_padding_mirrors_where_the_phase_allows() -> None:
    assert mirrored_indices(6, 3, 2).tolist() == [3, 2, 1, 0, 1, 2, 3, 4, 5, 4, 3, 2]
    assert mirrored_indices(8, 2, 4)[:2].tolist() == [2, 3]


def test_indices_are_joined_as_they_are_split(fiveband: CameraModel) -> None:
    rng = np.random.default_rng(3)
    rule = make_rule(ClassRecipe(contrasts=(1.4, 4.0)), fiveband, random_case_of_code(5, rng), rng.dirichlet(np.ones(5), 6))
    index = np.arange(16 * rule.classes_per_site)
    site, level, contrast, combination, kind = rule.split(index)
    assert not combination.any()
    np.testing.assert_array_equal((site, level, contrast, combination, kind), np.unravel_index(index, (16, *rule.shape)))
    np.testing.assert_array_equal(rule.join(level, contrast, kind, site), index)
    np.testing.assert_array_equal(rule.on_site(rule.join(level, contrast, kind), site), index)
    np.testing.assert_array_equal(rule.within_site(index), rule.join(level, contrast, kind))
    assert rule.split(1234) == tuple(part[1234] for part in (site, level, contrast, combination, kind))
    assert rule.by_feature(index)[7, 3, 2, 0, 4] == rule.join(3, 2, 4, 7)
    assert index[rule.of_site(2)].tolist() == index[site == 2].tolist()


def test_a_kind_is_a_chroma_or_a_saturation_case(fiveband: CameraModel) -> None:
    rng = np.random.default_rng(4)
    rule = make_rule(ClassRecipe(), fiveband, random_case_of_code(5, rng), rng.dirichlet(np.ones(5), 6))
    assert rule.kind(np.arange(6), 0).tolist() == [0, 1, 2, 3, 4, 5]
    assert rule.kind(5, np.arange(1, 4)).tolist() == [6, 7, 8]
    kinds = np.arange(rule.kinds)
    assert rule.case(kinds).tolist() == [0, 0, 0, 0, 0, 0, 1, 2, 3]
    assert rule.case(kinds.astype(np.uint32)).tolist() == rule.case(kinds).tolist()  # as labels are
    for case in range(rule.cases):
        assert np.atleast_1d(kinds[rule.kinds_of(case)]).tolist() == kinds[rule.case(kinds) == case].tolist()
