"""Macros of the curve of a colour space, as the kernels compute it (opencl/common/encoding.cl)."""

import functools

import numpy as np

from l3cli.physics.spaces import Curve


@functools.cache
def curve_macros(curve: Curve, steps: int, degree: int) -> dict[str, int | str]:
    """A curve, its power part as a polynomial in the fourth root (encoding.cl), fitted at Chebyshev's nodes."""
    lowest = curve.knee**0.25
    root = lowest + (1 - lowest) * (np.cos(np.linspace(0, np.pi, 1001)) + 1) / 2
    terms = np.polynomial.polynomial.polyfit(root, curve.encoded(root**4), degree)
    return {
        "CURVE_KNEE": _literal(curve.knee),
        "CURVE_SLOPE": _literal(curve.slope),
        "CURVE_STEPS": steps,
        "CURVE_DEGREE": degree,
        "CURVE_TERMS": ",".join(_literal(term) for term in terms),
    }


@functools.cache
def curve_pieces(curve: Curve, top: int) -> dict[str, int | str]:
    """A curve's codes up to `top`, and half a code, as 32 parabolas in u = 2^-8 + CURVE_SHARE · x within 3e-5 of `top`: four
    an octave, fitted at Chebyshev's nodes, in the order in which the upper bits of u number them."""
    start, share = 2.0**-8, 1 - 2.0**-8 - 2.0**-22
    octave, quarter = np.divmod(np.arange(32), 4)
    half = start * 2.0**octave / 8
    middle = start * 2.0**octave * (1 + quarter / 4) + half
    node = np.cos(np.linspace(0, np.pi, 101))
    codes = top * curve.encoded((middle + half * node[:, None] - start) / share) + 0.5
    c, b, a = np.polynomial.polynomial.polyfit(node, codes, 2) / half ** np.arange(3)[:, None]
    terms = np.array([c - b * middle + a * middle**2, b - 2 * a * middle, a])
    first = int(np.float32(start).view(np.int32)) >> 21 & 31
    numbered = np.roll(terms, first, axis=1).ravel()
    return {"CURVE_SHARE": _literal(share), "CURVE_PIECES": ",".join(_literal(term) for term in numbered)}


def _literal(value: float) -> str:
    """A number as OpenCL C writes one in single precision; whole numbers have an exponent, without which they are none."""
    return f"{value:.8e}f"
