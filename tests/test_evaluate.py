"""Quality figures: equal to ISETCam's own where it was run, zero for equal pictures, worse for worse ones."""

from pathlib import Path

import numpy as np
import pytest

from l3cli import spectra
from l3cli.evaluate.quality import quality


def a_picture(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.random((3, 20, 30)) * np.array([0.95, 1.0, 1.09])[:, None, None]


def test_equal_pictures_are_perfect() -> None:
    found = quality(a_picture(0), a_picture(0), spectra.white_point("A"))
    assert found.mean_delta_e == pytest.approx(0, abs=1e-9)
    assert found.psnr == pytest.approx(120)


def test_more_error_is_worse_in_every_figure() -> None:
    white = spectra.white_point("D65")
    small, large = (quality(a_picture(0) * factor, a_picture(0), white) for factor in (1.02, 1.2))
    assert 0 < small.median_delta_e < large.median_delta_e
    assert small.mean_delta_e < large.mean_delta_e
    assert small.p95_delta_e < large.p95_delta_e
    assert small.psnr > large.psnr


def test_the_border_is_left_out() -> None:
    broken = a_picture(0)
    broken[:, :2] = 0
    broken[:, :, -2:] = 0
    assert quality(broken, a_picture(0), spectra.white_point("D65"), border=2).mean_delta_e < 1e-9


def test_delta_e_is_that_of_isetcam(l3_data: Path) -> None:
    reference = np.load(l3_data.parent / "reference/isetcam/metrics.npz")
    lab_a, lab_b = (spectra.lab(reference[name], reference["white"]) for name in ("xyz_a", "xyz_b"))
    assert np.abs(lab_a - reference["lab_a"]).max() < 0.01
    difference = spectra.delta_e_2000(lab_a, lab_b)
    assert difference.mean() == pytest.approx(5.88029, abs=1e-4)
    assert np.abs(difference - reference["dE2000"]).max() < 0.01
