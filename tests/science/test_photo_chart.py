"""A chart in a mosaic: found wherever it lies, its patches measured beside dust, clipped pixels and noise."""

import numpy as np
import pytest

from l3cli.charts import locate, patches
from l3cli.charts.patches import corner_cells, homography, through
from tests.helpers.photos import BAYER, GAIN, GRID, READ, REFLECTANCE, UPRIGHT, photograph


@pytest.mark.parametrize("turns", range(4))
def test_a_chart_is_found_however_it_lies(turns: int) -> None:
    mosaic = photograph(UPRIGHT, np.random.default_rng(0), turns=turns)
    located = locate.locate(mosaic, BAYER, REFLECTANCE, GRID)
    assert located is not None
    corners = through(located.to_pixels, corner_cells(*GRID))
    col, row = UPRIGHT.T
    truth = [(col, row), (row, 799 - col), (799 - col, 599 - row), (599 - row, col)][turns]  # as rot90 moves pixels
    np.testing.assert_allclose(corners.T, truth, atol=4)


def test_a_picture_without_a_chart_has_none() -> None:
    far = UPRIGHT + 5000
    assert locate.locate(photograph(far, np.random.default_rng(1)), BAYER, REFLECTANCE, GRID) is None


@pytest.mark.parametrize("shape", [(1, 1), (3, 500), (8, 8), (10, 2000)])
def test_a_picture_of_a_few_pixels_has_none(shape: tuple[int, int]) -> None:
    mosaic = np.random.default_rng(1).uniform(0, 1000, shape)
    assert locate.locate(mosaic, BAYER, REFLECTANCE, GRID) is None
    with np.errstate(all="raise"):
        assert locate.locate(np.zeros((80, 90)), BAYER, REFLECTANCE, GRID) is None


def test_values_beside_dust_and_clipping_and_the_noise_of_one_shot() -> None:
    rng = np.random.default_rng(2)
    mosaic = photograph(UPRIGHT, rng)
    clean = photograph(UPRIGHT, np.random.default_rng(2)).copy()
    to_pixels = homography(corner_cells(*GRID), UPRIGHT)
    row, col = 190, 215  # in patch 1
    mosaic[row : row + 4, col : col + 5] = 2900.0
    values = patches.patch_values([mosaic], BAYER, to_pixels, GRID, saturation=2950.0)
    truth = patches.patch_values([clean], BAYER, to_pixels, GRID, saturation=1e9)
    np.testing.assert_allclose(values.mean, truth.mean, rtol=0.02, atol=3)
    assert {(patch, why) for patch, _, why in values.left_out} == {(18, "clipped")}
    transfer = patches.photon_transfer([truth])
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
    two = patches.patch_values(noisy, BAYER, to_pixels, GRID, saturation=1e9)
    np.testing.assert_allclose(np.median(two.variance), READ**2, rtol=0.15)


def test_too_small_a_chart_is_refused() -> None:
    mosaic = photograph(UPRIGHT, np.random.default_rng(6))
    tiny = homography(corner_cells(*GRID), 300 + (UPRIGHT - 300) / 20)
    with pytest.raises(ValueError, match="pixels of channel"):
        patches.patch_values([mosaic], BAYER, tiny, GRID, saturation=1e9)
