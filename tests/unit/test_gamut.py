"""Gamut mapping: hue, lightness and steps along ramps, kernels, and unchanged colours inside the gamut."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from l3cli.frames.frame import RawFrame
from l3cli.physics import spectra
from l3cli.physics.correlated_lights import radiance
from l3cli.physics.gamut import gamut_of, into_gamut
from l3cli.physics.spaces import SPACES, SRGB, adaptation_matrix
from l3cli.rendering.display import Display, encode
from l3cli.rendering.opencl.renderer import OpenCLRenderer
from tests.helpers.tables import random_table, with_first

ENCODED = [space for space in SPACES.values() if space.curve]
WAVELENGTHS = np.arange(400.0, 701.0, 5.0)
KINDS: dict[str, dict[str, Any]] = {
    "processor": {}, "16 lanes": {"lanes": 16}, "graphics": {"variant": "graphics"},
}  # fmt: skip
# The kernels differ by kind, and spaces by constants in them, so each occurs once. Each pair would be compiled.
KERNELS = [pytest.param(space, list(KINDS)[at % len(KINDS)], id=space.name) for at, space in enumerate(ENCODED)]
Array = NDArray[np.float64]


def surfaces(count: int = 3000, seed: int = 0) -> Array:
    """XYZ (surface, 3) of surfaces with one band or notch, from spectral colours to greys, under two lamps: lit by either,
    seen with the white of one, and up to 1.5 times as bright."""
    rng = np.random.default_rng(seed)
    centre, width = rng.uniform(420, 680, (count, 1)), rng.uniform(4, 60, (count, 1))
    floor = rng.uniform(0, 0.6, (count, 1))
    band = floor + (1 - floor) * np.exp(-(((WAVELENGTHS - centre) / width) ** 2))
    band = np.where(rng.random((count, 1)) < 0.3, 1 - band, band) * rng.uniform(0.05, 1.5, (count, 1))
    weights = spectra.xyz_weights(WAVELENGTHS)
    lamp, seen = (weights @ radiance(mired, 0.0, WAVELENGTHS) for mired in (350.0, 200.0))
    mixed = np.where(rng.random((count, 1)) < 0.5, radiance(350.0, 0.0, WAVELENGTHS), radiance(200.0, 0.0, WAVELENGTHS))
    made = (band * mixed) @ weights.T / max(lamp[1], seen[1])
    return np.asarray(made @ adaptation_matrix(seen, SRGB.neutral_xyz).T)


def oklab(xyz: Array) -> Array:
    """OkLab of XYZ relative to D65, by colour-science."""
    import colour

    return np.asarray(colour.XYZ_to_Oklab(xyz))


def hue_error(one: Array, other: Array) -> Array:
    """Distance in OkLab at right angles to the hue of `one`, for OkLab's a and b."""
    direction = one[:, 1:] / np.linalg.norm(one[:, 1:], axis=1, keepdims=True)
    return np.abs(direction[:, 0] * other[:, 2] - direction[:, 1] * other[:, 1])


def linear_and_shown(space: Any, xyz: Array) -> tuple[Array, Array]:
    linear = xyz @ space.from_xyz.T
    return linear, np.clip(into_gamut(linear, gamut_of(space)), 0, 1)


@pytest.mark.parametrize("space", ENCODED, ids=lambda space: space.name)
def test_colours_inside_stay_as_they_are(space: Any) -> None:
    rng = np.random.default_rng(1)
    linear = np.concatenate([rng.random((500, 3)), rng.integers(0, 2, (100, 3)).astype(float)])
    np.testing.assert_array_equal(into_gamut(linear, gamut_of(space)), linear)


@pytest.mark.parametrize("space", ENCODED, ids=lambda space: space.name)
def test_colours_outside_keep_hue_and_lightness(space: Any) -> None:
    """Clipping each value turns the hue of the same colours by more than ten times as much."""
    xyz = surfaces()
    linear, shown = linear_and_shown(space, xyz)
    back = np.linalg.inv(space.from_xyz).T
    before, after, clipped = (oklab(values @ back) for values in (linear, shown, np.clip(linear, 0, 1)))
    vivid = (linear.min(axis=1) < 0) & (linear.max(axis=1) <= 1)
    assert vivid.sum() > 10
    turned, turned_by_clipping = (hue_error(before[vivid], other[vivid]) for other in (after, clipped))
    assert np.percentile(turned, 95) < 1e-3
    assert np.percentile(turned_by_clipping, 95) > 1e-2
    assert np.abs(after[vivid, 0] - before[vivid, 0]).max() < 0.02
    too_bright = (linear.max(axis=1) > 1.02) & (linear @ back[:, 1] < 0.6)
    assert (
        hue_error(before[too_bright], after[too_bright]).mean()
        < 0.4 * hue_error(before[too_bright], clipped[too_bright]).mean()
    )
    assert (after[too_bright, 0] <= before[too_bright, 0] + 1e-6).all()


@pytest.mark.parametrize("space", ENCODED, ids=lambda space: space.name)
def test_highlights_end_in_white_as_they_are_clipped(space: Any) -> None:
    rng = np.random.default_rng(2)
    linear = rng.uniform(0, 3, (3000, 3))
    bright = linear[linear @ gamut_of(space).luminance >= 1]
    np.testing.assert_allclose(into_gamut(bright, gamut_of(space)), np.minimum(bright, 1), atol=1e-12)
    greys = np.linspace(0, 2, 401)[:, None] * np.ones(3)
    np.testing.assert_allclose(into_gamut(greys, gamut_of(space)), np.minimum(greys, 1), atol=1e-12)


@pytest.mark.parametrize("space", ENCODED, ids=lambda space: space.name)
def test_no_steps_along_ramps_out_of_the_gamut(space: Any) -> None:
    """From a grey to colours beyond, and from dark to four times as bright: a finer ramp has smaller steps."""
    ends = surfaces(60, seed=3) @ space.from_xyz.T

    def largest_steps(points: int) -> Array:
        share = np.linspace(0.02, 1, points)[:, None, None]
        ramps = np.concatenate([0.2 * (1 - share) + share * ends, 4 * share * ends], axis=1)
        codes = 255 * space.curve.encoded(into_gamut(ramps, gamut_of(space)))
        return np.abs(np.diff(codes, axis=0)).max(axis=(0, 2))

    coarse, fine = largest_steps(1001), largest_steps(8001)
    assert coarse.max() < 12
    assert (fine < 0.35 * coarse + 0.02).all()


@pytest.mark.parametrize(("space", "kind"), KERNELS)
def test_kernels_do_as_the_reference(space: Any, kind: str) -> None:
    """Pixels inside have the same code whatever lies beside them; those outside that of the reference."""
    table = random_table([[0]], bits=16, patch=3)
    taps = np.zeros_like(table.first.weights)
    for output, tap in enumerate((1, 4, 7)):
        taps[:, output, tap] = 1.0  # X, Y, Z are three neighbours
    table = with_first(table, weights=taps, intercept=np.full_like(table.first.intercept, -0.1))
    values = np.random.default_rng(5).integers(0, 1 << 16, (48, 64)).astype(np.uint16)
    frame = RawFrame("noise", values, table.black_level, table.white_level)
    renderer = OpenCLRenderer(table, **KINDS[kind])
    for bits in (8, 16):
        display = Display(space.from_xyz * 1.2, bits, space)
        truth = encode(renderer.outputs(frame), display)
        error = np.abs(renderer.picture(frame, display).astype(int) - truth)
        linear = np.einsum("po,orc->rcp", display.matrix, renderer.outputs(frame).astype(np.float64))
        inside = (linear.min(axis=-1) >= 0) & (linear.max(axis=-1) <= 1)
        assert 0.05 < inside.mean() < 0.95
        assert error.max() <= 1
