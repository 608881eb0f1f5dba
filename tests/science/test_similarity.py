"""Structural similarity is scikit-image's with the window of Wang et al. 2004: 11 × 11, Gaussian of σ 1.5, values in 0…1."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from skimage.metrics import structural_similarity

from l3cli.evaluation.quality import ssim

RNG = np.random.default_rng(5)


def a_picture(shape: tuple[int, int]) -> NDArray[np.float64]:
    """Edges, plain areas, texture and clipped highlights in 0…1."""
    row, col = np.indices(shape)
    plain = 0.15 + 0.5 * (col > shape[1] // 3) + 0.6 * (row > 2 * shape[0] // 3)
    return np.clip(plain + 0.1 * np.sin(row * 0.9) * np.sin(col * 1.3), 0.0, 1.0)


SEEN: dict[str, Callable[[NDArray[np.float64]], NDArray[np.float64]]] = {
    "noise": lambda picture: picture + RNG.normal(0.0, 0.08, picture.shape),
    "darker": lambda picture: 0.8 * picture,
    "shifted": lambda picture: np.roll(picture, 1, axis=1),
    "inverted": lambda picture: 1.0 - picture,
    "flat": lambda picture: np.full_like(picture, picture.mean()),
    "black": np.zeros_like,
    "the same": np.copy,
}


@pytest.mark.parametrize("shape", [(11, 11), (12, 40), (61, 47)])
@pytest.mark.parametrize("seen", SEEN)
def test_ssim_is_that_of_scikit_image(shape: tuple[int, int], seen: str) -> None:
    picture = a_picture(shape)
    other = np.clip(SEEN[seen](picture), 0.0, 1.0)
    window = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "data_range": 1.0}
    assert ssim(other, picture) == pytest.approx(structural_similarity(other, picture, **window), abs=1e-12)
