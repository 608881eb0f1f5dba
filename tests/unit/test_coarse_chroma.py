"""Coarse chroma: properties of the formula (docs/method.md#coarse-chroma). test_render.py tests the kernels."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from l3cli.artifacts.layers import COMPARED, PLANE_STEP, CoarseChroma
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.classes.coarse_chroma import BLOCK, REACH, SPACINGS, coarse_change, edge_avoiding, scales_of
from l3cli.classes.planes import LUMINANCE
from l3cli.classes.refinement import mirrored, window_means
from l3cli.errors import RecipeError
from l3cli.evaluation.quality import BLUR
from l3cli.recipes.faults import refuse_first
from l3cli.rendering.conditions import with_edges_for
from l3cli.rendering.opencl.renderer import OpenCLRenderer
from l3cli.rendering.reference import ReferenceRenderer
from l3cli.training.layers.coarse_chroma import LUMINANCES, rising_terms
from l3cli.training.recipe import LayerRecipe, layer_faults
from tests.helpers.cameras import BAYER
from tests.helpers.tables import frame_of_all_levels, random_table, with_coarse_chroma, with_low_noise, with_refinement

SIDE, SIGMA = 5, 0.01


def noise_of(sigma: float) -> CoarseChroma:
    """Noise of white planes of `sigma` output units at every luminance, but for what steps leave, which is guessed."""
    left = np.array([1 / 16, 1 / 40, 1 / 100, 1 / 250])
    return CoarseChroma(sigma**2 * left[:, None, None] * np.ones(COMPARED) * (1.0, 0.0, 0.0))


def planes_of(
    seed: int, shape: tuple[int, int], colour: tuple[float, float, float], sigma: float = SIGMA
) -> NDArray[np.int32]:
    noise = sigma * np.random.default_rng(seed).normal(size=(3, *shape))
    return np.rint((np.array(colour)[:, None, None] + noise) / PLANE_STEP).astype(np.int32)


def window_chroma(planes: NDArray[np.int32]) -> NDArray[np.float64]:
    return np.delete(window_means(mirrored(planes.astype(np.float64), SIDE // 2), SIDE), LUMINANCE, axis=0)


SHAPES = st.tuples(st.integers(1, 40), st.integers(1, 40))


@given(SHAPES, st.lists(st.integers(-(2**21), 2**21), min_size=3, max_size=3))
def test_a_plain_picture_stays(shape: tuple[int, int], colour: list[int]) -> None:
    planes = np.broadcast_to(np.array(colour, np.int32)[:, None, None], (3, *shape))
    change = coarse_change(planes, scales_of(noise_of(SIGMA)))
    np.testing.assert_allclose(change, 0, atol=1e-6)  # steps of a plane


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(0, 3), st.booleans())
def test_it_turns_with_the_planes(seed: int, turns: int, mirrored: bool) -> None:
    """Of pictures of whole blocks, whose grid turns with them."""

    def turned(values: NDArray) -> NDArray:
        return np.rot90(values[..., ::-1] if mirrored else values, turns, (1, 2))

    planes, scales = planes_of(seed, (8 * BLOCK, 6 * BLOCK), (0.02, 0.3, -0.05), 4 * SIGMA), scales_of(noise_of(SIGMA))
    np.testing.assert_allclose(
        coarse_change(turned(planes), scales), turned(coarse_change(planes, scales)), rtol=1e-9, atol=1e-6
    )


def test_a_light_and_its_ground_stay_apart() -> None:
    """A block that an edge divides is like none: nothing changes at the edge, and there is no rim about it."""
    planes = planes_of(4, (96, 96), (0.0, 0.2, 0.0), SIGMA / 10)
    planes[0, 42:54, 42:54] += round(0.2 / PLANE_STEP)
    change = coarse_change(planes, scales_of(noise_of(SIGMA / 10)))
    assert np.abs(change[0]).max() * PLANE_STEP < SIGMA / 2


def test_mottle_goes_and_colour_stays() -> None:
    planes, shape = planes_of(0, (200, 200), (0.03, 0.1, -0.02)), (slice(None), slice(REACH, -REACH), slice(REACH, -REACH))
    mean = window_chroma(planes)
    made = mean + coarse_change(planes, scales_of(noise_of(SIGMA)))
    before, after = (gaussian_filter(each, (0, BLUR, BLUR))[shape] * PLANE_STEP for each in (mean, made))
    assert (after.std(axis=(1, 2)) < 0.3 * before.std(axis=(1, 2))).all()
    np.testing.assert_allclose(after.mean(axis=(1, 2)), (0.03, -0.02), atol=0.03 * SIGMA)


@pytest.mark.parametrize("plane", [0, 1, 2])
def test_an_edge_of_any_plane_keeps_colours_apart(plane: int) -> None:
    """Also one that luminance does not show: the other side stays out of what is within a block of it."""
    left, right = planes_of(1, (96, 48), (0.0, 0.2, 0.0)), planes_of(2, (96, 48), (0.0, 0.2, 0.0))
    right[plane] += round(0.15 / PLANE_STEP)
    right[2] += round(0.02 / PLANE_STEP)
    planes = np.concatenate([left, right], axis=2)
    made = window_chroma(planes) + coarse_change(planes, scales_of(noise_of(SIGMA)))
    mean = made[1, 8:-8].mean(axis=0) * PLANE_STEP
    blue = 0.02 + (0.15 if plane == 2 else 0.0)
    np.testing.assert_allclose(mean[: 48 - 2 * BLOCK], 0, atol=0.1 * SIGMA)
    np.testing.assert_allclose(mean[48 + 2 * BLOCK :], blue, atol=0.1 * SIGMA)


@pytest.mark.parametrize("variant", ["processor", "graphics"])
def test_less_noise_keeps_more_apart_in_every_backend(variant: str) -> None:
    """Of frames that a filter in time has cleaned, some of whose pixels have transforms of their own."""
    table = with_low_noise(with_coarse_chroma(with_refinement(random_table(BAYER, patch=5), 5)))
    frame = frame_of_all_levels(table, np.random.default_rng(3), (60, 90))
    reference, device = ReferenceRenderer(table, True), OpenCLRenderer(table, variant=variant, by_noise=True)
    made = []
    for share in (1.0, 0.1, 1.0):
        cleaned = dataclasses.replace(frame, noise_share=share)
        made.append(reference.exact_outputs(cleaned))
        np.testing.assert_allclose(device.outputs(cleaned), made[-1], atol=1e-5 * np.abs(made[-1]).max())
    assert np.abs(made[0] - made[1]).max() > 0.01


def test_a_step_is_a_mean_of_nine_and_of_fewer_at_the_edges() -> None:
    means = np.random.default_rng(0).normal(size=(3, 9, 9))
    far = np.full((3, 3), 1e12) * (1.0, 0.0, 0.0)
    weights = np.outer([1, 2, 1], [1, 2, 1]) / 16
    for apart in SPACINGS[:2]:
        there = means[:, 4 - apart : 5 + apart : apart, 4 - apart : 5 + apart : apart]
        softened = edge_avoiding(means, apart, far)
        np.testing.assert_allclose(softened[:, 4, 4], (there * weights).sum(axis=(1, 2)))
        corner = means[:, : 1 + apart : apart, : 1 + apart : apart]
        np.testing.assert_allclose(softened[:, 0, 0], (corner * weights[1:, 1:]).sum(axis=(1, 2)) / weights[1:, 1:].sum())


def test_noise_that_no_terms_follow_is_met_in_the_mean() -> None:
    """As `best` has it: of luminance in per cent, standard deviations that fall only above the dark."""
    deviation = LUMINANCES * np.interp(np.log(LUMINANCES), np.log([0.004, 0.3]), [0.05, 0.0045])
    variance = np.repeat((deviation / PLANE_STEP)[:, None] ** 2, 3, axis=1)
    terms = rising_terms(LUMINANCES, variance)
    fit = terms @ LUMINANCES ** np.arange(3)[:, None]
    mean = np.exp(np.log(fit / deviation**2).mean(axis=1) / 2)
    assert mean.min() > 0.8  # relative to the variance alone: 0.65
    assert mean.max() < 1.2
    assert terms.min() >= 0


def test_a_table_keeps_it_and_refuses_what_cannot_be(tmp_path: Path) -> None:
    bare = with_refinement(random_table(BAYER, patch=5), 5)
    table = with_coarse_chroma(bare)
    save(table, tmp_path / "table.h5")
    chroma = load(TransformTable, tmp_path / "table.h5").later[-1].coarse_chroma
    assert chroma is not None
    assert table.later[-1].coarse_chroma is not None
    np.testing.assert_array_equal(chroma.variance, table.later[-1].coarse_chroma.variance)
    frame = frame_of_all_levels(table, np.random.default_rng(3), (40, 60))
    made, without = (ReferenceRenderer(each).exact_outputs(frame) for each in (table, bare))
    assert np.abs(made - without).max() > 0.01
    quiet = with_edges_for(table, 0.25).later[-1].coarse_chroma
    assert quiet is not None
    np.testing.assert_allclose(quiet.variance, chroma.variance / 4)
    for variance in (np.ones((3, 3, 3)), -np.ones(COMPARED), np.zeros(COMPARED)):
        with pytest.raises(ValueError, match="variance"):
            CoarseChroma(variance)
    with pytest.raises(ValueError, match="only the last layer may have coarse_chroma"):
        dataclasses.replace(table, later=(table.later[0], bare.later[0]))
    with pytest.raises(RecipeError, match="is allowed only in the last layer"):
        refuse_first(layer_faults((LayerRecipe(coarse_chroma=True), LayerRecipe())))
