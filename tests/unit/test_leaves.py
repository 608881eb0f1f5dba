"""Leaves, fields and textures of procedural scenes, compared with slower implementations."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from l3cli.simulation import fields, leaves

Array = NDArray[np.floating]
SHAPE = (60, 90)


# -------------------------------------------------------------------------------------------------------- leaves


@pytest.mark.parametrize(("smallest", "largest"), [(4.0, 60.0), (20.0, 60.0), (3.0, 5.0)])
def test_each_pixel_shows_the_first_leaf_that_covers_it(
    monkeypatch: pytest.MonkeyPatch, smallest: float, largest: float
) -> None:
    """Beside leaves laid one by one in float64, none of them taken for hidden."""
    batches: list[leaves.Drawn] = []
    draw = leaves._drawn

    def left(*arguments: Any) -> leaves.Drawn:
        batches.append(draw(*arguments))
        return batches[-1]

    monkeypatch.setattr(leaves, "_drawn", left)
    cover = leaves.dead_leaves(np.random.default_rng(3), SHAPE, smallest, largest)
    assert len(batches) > 1
    row, col, radius = _plainly(batches, SHAPE)
    shown = cover.row[cover.label], cover.col[cover.label], cover.radius[cover.label]
    unlike = ~np.all(
        [np.isclose(one, other, atol=1e-3) for one, other in zip(shown, (row, col, radius), strict=True)], axis=0
    )
    assert unlike.mean() < 1e-4  # pixels on an edge, where float32 decides otherwise
    assert np.mean(cover.label == cover.label.max()) <= leaves.UNCOVERED
    assert np.unique(cover.label[cover.label < len(cover.radius) - 1]).size == len(cover.radius) - 1


def _plainly(batches: list[leaves.Drawn], shape: tuple[int, int]) -> tuple[Array, Array, Array]:
    """Row, column and radius of the leaf at each pixel; the ground's where there is none."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    shown = (np.full(shape, shape[0] / 2), np.full(shape, shape[1] / 2), np.full(shape, max(shape) / 2))
    free = np.ones(shape, bool)
    for drawn in batches:
        for kind, row, col, radius, angle, slimness in zip(
            drawn.shape, drawn.row, drawn.col, drawn.radius, drawn.angle, drawn.slimness, strict=True
        ):
            covered = free & _inside(kind, y - row, x - col, radius, angle, slimness)
            for plane, value in zip(shown, (row, col, radius), strict=True):
                plane[covered] = value
            free &= ~covered
    return shown


def _inside(kind: int, y: Array, x: Array, radius: float, angle: float, slimness: float) -> NDArray[np.bool_]:
    u, v = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
    turn = np.arctan2(v, u)
    edge = 0.7 + 0.15 * np.sin(3 * turn + angle) + 0.12 * np.sin(5 * turn + 9 * angle)
    masks = (
        np.hypot(x, y) < radius,
        np.hypot(u, v / slimness) < radius,
        (abs(u) < 0.7 * radius) & (abs(v) < 0.7 * radius * slimness),
        (u > -0.5 * radius) & (abs(v) < 0.5 * radius * slimness - 0.5 * u),
        np.hypot(u, v) < radius * edge,
    )
    return masks[kind]


# -------------------------------------------------------------------------------------------------------- fields


def plain_pink(rng: np.random.Generator, shape: tuple[int, int], exponent: float) -> Array:
    """White noise, filtered, in float64."""
    frequency = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.fftfreq(shape[1]))
    amplitude = np.maximum(frequency, 1 / max(shape)) ** -exponent
    amplitude[0, 0] = 0.0
    field = np.fft.ifft2(np.fft.fft2(rng.standard_normal(shape)) * amplitude).real
    return field / field.std()


def spectrum(field: Array) -> Array:
    """Logarithm of the mean power in octaves of frequency."""
    power = abs(np.fft.fft2(field)) ** 2
    frequency = np.hypot(np.fft.fftfreq(field.shape[0])[:, None], np.fft.fftfreq(field.shape[1]))
    octave = np.rint(np.log2(np.maximum(frequency, 1e-9))).astype(int)
    return np.log([power[octave == one].mean() for one in range(-6, 0)])


@pytest.mark.parametrize("shape", [(128, 192), (129, 191), (190, 129)])
@pytest.mark.parametrize("exponent", [0.4, 1.0, 1.6])
def test_pink_fields_have_the_statistics_of_filtered_noise(shape: tuple[int, int], exponent: float) -> None:
    rng = np.random.default_rng(0)
    quick = [fields.pink(rng, shape, exponent) for _ in range(12)]
    plain = [plain_pink(rng, shape, exponent) for _ in range(12)]
    for field in quick:
        assert field.dtype == np.float32
        assert abs(field.mean()) < 1e-4
        assert field.std() == pytest.approx(1.0, rel=1e-4)
    one, other = (np.mean([spectrum(field) for field in drawn], axis=0) for drawn in (quick, plain))
    np.testing.assert_allclose(one, other, atol=0.25)  # the lowest octave has few coefficients
    np.testing.assert_allclose(one[2:], other[2:], atol=0.12)
    slope = np.polyfit(np.arange(1, 6) * np.log(2), one[1:], 1)[0]
    assert slope == pytest.approx(-2 * exponent, abs=0.15)
    if exponent < 1:  # of a steep spectrum, few coefficients decide
        for power, normal in ((4, 3.0), (6, 15.0)):
            assert np.mean([np.mean(field.astype(float) ** power) for field in quick]) == pytest.approx(normal, rel=0.03)


def test_a_field_drawn_out_changes_faster_along_its_direction() -> None:
    ratios = []
    for seed in range(8):
        field = fields.pink(np.random.default_rng(seed), (128, 128), 1.1, 6.0)
        gradient = np.array([np.diff(field, axis=0)[:, :-1].reshape(-1), np.diff(field, axis=1)[:-1].reshape(-1)])
        strengths = np.linalg.eigvalsh(gradient @ gradient.T)
        ratios.append(strengths[1] / strengths[0])
    assert np.median(ratios) > 3


@pytest.mark.parametrize(("exponent", "stretch"), [(0.5, 1.0), (1.0, 1.0), (1.3, 1.0), (1.1, 4.0)])
def test_a_piece_changes_as_the_whole_field_does(exponent: float, stretch: float) -> None:
    rng, shape = np.random.default_rng(1), (120, 200)
    whole = [fields.pink(rng, shape, exponent, stretch) for _ in range(20)]
    pieces = [fields.piece(rng, 64, shape, exponent, stretch) for _ in range(20)]
    for piece, level in pieces:
        assert piece.shape == (64, 64)
        assert piece.var() + level**2 == pytest.approx(1.0, abs=1e-3)
    for lag in (1, 4, 8):
        one, other = (
            np.mean([np.log(np.mean((field[:, lag:] - field[:, :-lag]) ** 2)) for field in drawn])
            for drawn in (whole, [piece for piece, _ in pieces])
        )
        assert one == pytest.approx(other, abs=0.2), lag


def test_textures_have_about_unit_variance_and_differ_from_leaf_to_leaf(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fields, "WIDEST", 128)
    rng, count = np.random.default_rng(2), 800
    texture = np.arange(count) % fields.TEXTURES
    of = fields.draw_textures(rng, (256, 256), texture, 2)
    label = np.repeat(np.arange(count), 32 * 8).reshape(count * 32, 8)  # a row of blocks of 32 x 8 samples
    down = np.tile(np.arange(32.0, dtype=np.float32), count)[:, None]
    value = fields.sampled(of, label, down, np.arange(8, dtype=np.float32)).reshape(count, 32, 8)
    assert value.dtype == np.float32
    for number in range(fields.TEXTURES):
        drawn = value[texture == number]
        assert np.mean(drawn**2) == pytest.approx(1.0, abs=0.35), number
        if number != fields.STRIPES:  # these have one phase all over the picture
            assert np.ptp(drawn[:, 0, 0]) > 1, number
    assert set(np.unique(value[texture == fields.STRIPES])) == {-1.0, 1.0}
    blotches = value[texture == fields.BLOTCHES]
    assert abs(blotches).max() <= 1
    assert np.mean(abs(blotches) > 0.9) > 0.5
    whole = fields.sampled(of, np.zeros((4, 600), np.intp), np.arange(4.0)[:, None], np.arange(600.0))
    assert np.array_equal(whole[:, :128], whole[:, 128:256])  # periodic


# ------------------------------------------------------------------------------------------------------- drawing
