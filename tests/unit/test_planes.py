"""Fixed-point layers: 16-bit weights, sums that fit into 32 bits, and planes close to the floating-point planes."""

import dataclasses

import numpy as np
import pytest

from l3cli.artifacts.layers import PLANE_STEP
from l3cli.classes.planes import (
    COARSE,
    COARSE_TOP,
    MAX_FRACTION,
    coarse,
    fixed_point,
    opponent_basis,
    raw_middle,
    refined_fixed_point,
)
from l3cli.classes.windows import window_channels
from l3cli.errors import InputFileError
from tests.helpers.cameras import BAYER, FIVE_BAND
from tests.helpers.tables import random_table, with_first, with_refinement


@pytest.mark.parametrize("bits", [8, 12, 16])
@pytest.mark.parametrize("size", [1e-3, 1.0, 30.0])
def test_no_raw_values_leave_32_bits(bits: int, size: float) -> None:
    table = random_table(FIVE_BAND, bits=bits, black_level=2.0 ** (bits - 4), patch=9)
    table = with_first(table, weights=table.first.weights * np.float32(size))
    fixed, middle = fixed_point(table), raw_middle(bits)
    weights = fixed.weights.astype(np.int64)
    least, most = -middle, 2**bits - 1 - middle
    assert least >= -(2**15)
    assert most < 2**15
    offset = fixed.intercept + middle * weights.sum(axis=-1)
    size_of_sum = (np.abs(weights) * max(-least, most)).sum(axis=-1) + np.abs(offset) + 2**MAX_FRACTION
    assert size_of_sum.max() < 2**31
    assert np.abs(weights).max() < 2**15
    one_more = (np.abs(weights).max(axis=(1, 2)) >= 2**14 - 1) | (size_of_sum.max(axis=-1) >= 2**29)
    assert (one_more | (fixed.fraction == MAX_FRACTION)).all()  # no class has room for another bit


def test_weights_of_each_channel_add_up_as_they_did() -> None:
    table = random_table(FIVE_BAND, bits=12, black_level=108.93, patch=9)
    fixed, basis = fixed_point(table), opponent_basis(table.white_point)
    exact = np.einsum("cot,op->cpt", table.first.weights.astype(np.float64), basis)
    exact *= 2.0 ** fixed.fraction[:, None, None] / ((table.white_level - table.black_level) * PLANE_STEP)
    assert np.abs(fixed.weights - exact).max() <= 1 + 1e-6
    channel = window_channels(table.cfa, 9)[table.first.rule.split(np.arange(len(exact))).site]
    for index in range(5):
        member = (channel == index)[:, None]
        assert np.abs(((fixed.weights - exact) * member).sum(axis=-1)).max() <= 0.5 + 1e-6


def test_weights_that_lose_most_are_rounded_up_and_of_equal_ones_the_first() -> None:
    table = random_table(BAYER, bits=12, patch=5)
    first = table.first.weights.reshape(len(table.first.weights), -1, 5, 5)
    symmetric = first + first[..., ::-1]  # as sites that are mirror images of themselves: each weight but the middle's twice
    table = with_first(table, weights=symmetric.reshape(table.first.weights.shape))
    fixed, step = fixed_point(table), (table.white_level - table.black_level) * PLANE_STEP
    luminance = table.first.weights[:, 1].astype(np.float64) / step * 2.0 ** fixed.fraction[:, None]
    channels = window_channels(table.cfa, 5)[table.first.rule.split(np.arange(len(luminance))).site]
    choices = 0
    for wanted, made, channel in zip(luminance, fixed.weights[:, 1], channels, strict=True):
        for index in range(3):
            part = wanted[channel == index]
            up, loss = made[channel == index] - np.floor(part), np.floor(part) - part
            by_loss, count = np.lexsort([np.arange(len(part)), loss]), int(up.sum())
            assert sorted(by_loss[:count]) == np.flatnonzero(up).tolist()
            choices += 0 < count < len(up) and loss[by_loss[count - 1]] == loss[by_loss[count]]
    assert choices > len(luminance) / 2  # where one of two equal weights was


def test_layers_between_read_16_bits_and_stay_within_32() -> None:
    table = with_refinement(random_table(BAYER, bits=12), 5, 3)
    layer = table.later[0]
    layer = dataclasses.replace(layer, intercept=np.full_like(layer.intercept, 0.7))
    fixed = refined_fixed_point(layer, opponent_basis(table.white_point))
    sums = (np.abs(fixed.weights.astype(np.int64)) * COARSE_TOP).sum(axis=-1) + np.abs(fixed.intercept) + 2**MAX_FRACTION
    assert sums.max() < 2**31
    planes = np.array([0, 1 << COARSE >> 1, (1 << COARSE >> 1) - 1, -(1 << COARSE), 2**22 - 1, 1 - 2**22], np.int32)
    assert coarse(planes).tolist() == [0, 1, 0, -1, COARSE_TOP, -COARSE_TOP]


def test_transforms_beyond_all_planes_are_refused() -> None:
    table = random_table(BAYER, bits=8)
    with pytest.raises(InputFileError, match="do not fit into fixed-point numbers"):
        fixed_point(with_first(table, weights=table.first.weights * np.float32(1e4)))
