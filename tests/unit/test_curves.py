"""The curves of colour spaces as kernels compute them."""

import re

import numpy as np
import pytest

from l3cli.physics.spaces import BT2020_CURVE, SRGB_CURVE, Curve
from l3cli.rendering.opencl.layout import _literal, curve_pieces


@pytest.mark.parametrize("curve", [SRGB_CURVE, BT2020_CURVE])
def test_parabolas_follow_the_curve(curve: Curve) -> None:
    """What encoding.cl does with them, in float32."""
    macros = curve_pieces(curve, 255)
    terms = np.array([term.rstrip("f") for term in str(macros["CURVE_PIECES"]).split(",")], np.float32).reshape(3, 32)
    share, start, end = np.float32(str(macros["CURVE_SHARE"])[:-1]), np.float32(2**-8), np.float32(1 - 2**-24)
    linear = np.linspace(-0.1, 1.1, 1_000_001).astype(np.float32)
    u = np.clip(linear * share + start, start, end)
    piece = u.view(np.int32) >> 21 & 31
    codes = (terms[2][piece] * u + terms[1][piece]) * u + terms[0][piece]
    expected = 255 * curve.encoded(linear.astype(np.float64)) + 0.5
    assert np.abs(codes - expected).max() < 3e-5 * 255
    assert (codes.min(), codes.max()) == (pytest.approx(0.5, abs=1e-6), pytest.approx(255.5, abs=0.01))
    assert codes.max() < 256
    assert np.mean(codes.astype(int) != expected.astype(int)) < 0.002


@pytest.mark.parametrize("value", [0.0, 1.0, -1.0, 4.5, 1e-12, -266132.977])
def test_numbers_are_literals_of_single_precision(value: float) -> None:
    """OpenCL C has no 0f: fits give whole numbers on some machines."""
    assert re.fullmatch(r"-?\d\.\d+e[+-]\d+f", _literal(value))
    assert np.float32(_literal(value)[:-1]) == np.float32(value)
