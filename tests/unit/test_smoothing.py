"""Smoothed spectra and smoothed chroma: properties of the formulas, and comparison with the kernels (docs/method.md)."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import ChromaSmoothing, SpectralSmoothing, TransformTable
from l3cli.errors import RecipeError
from l3cli.frames.frame import RawFrame
from l3cli.frames.shading import NODE_SPACING_COLUMNS, Shading
from l3cli.physics.mosaic import channel_reach
from l3cli.recipes.faults import refuse_first
from l3cli.rendering.display import encode, make_display
from l3cli.rendering.opencl import work
from l3cli.rendering.opencl.renderer import OpenCLRenderer
from l3cli.rendering.reference import (
    CHROMA_NEIGHBOURS,
    FAR_CHROMA_NEIGHBOURS,
    SMOOTHING_DARKEST,
    ReferenceRenderer,
    least_luminance,
    smoothed_chroma,
    smoothed_spectra,
    white_scale,
)
from l3cli.training.recipe import LearningRecipe, learning_faults
from l3cli.training.summary import insight, learned
from tests.helpers.cameras import BAYER, FIVE_BAND
from tests.helpers.rendered import TABLES
from tests.helpers.tables import (
    frame_of_all_levels,
    random_table,
    with_clipped_white,
    with_smoothed_chroma,
    with_spectra,
)

SIXTEEN = np.arange(16).reshape(4, 4)
SMOOTHINGS = st.builds(SpectralSmoothing, st.sampled_from([3, 5]), st.floats(0.01, 0.99))


def spectra_of(seed: int, noise: float = 0.3, shape: tuple[int, int] = (7, 9)) -> NDArray[np.float64]:
    """Outputs (output, row, col) of random brightness, dark and bright, some of them negative."""
    rng = np.random.default_rng(seed)
    return np.exp(rng.normal(-1, 1, shape)) * (1 + noise * rng.normal(size=(6, *shape)))


@given(st.integers(0, 2**32 - 1), SMOOTHINGS)
def test_brightness_is_kept_and_scale_does_not_matter(seed: int, smoothing: SpectralSmoothing) -> None:
    planes = spectra_of(seed)
    smoothed = smoothed_spectra(planes, smoothing)
    np.testing.assert_allclose(smoothed.mean(axis=0), planes.mean(axis=0), rtol=1e-9)
    np.testing.assert_allclose(smoothed_spectra(4 * planes, smoothing), 4 * smoothed, rtol=1e-9, atol=1e-12)


@given(st.integers(0, 2**32 - 1), SMOOTHINGS, st.integers(0, 3), st.booleans())
def test_it_turns_with_the_planes(seed: int, smoothing: SpectralSmoothing, turns: int, mirrored: bool) -> None:
    def turned(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.rot90(values[..., ::-1] if mirrored else values, turns, (1, 2))

    planes = spectra_of(seed)
    np.testing.assert_allclose(
        smoothed_spectra(turned(planes), smoothing), turned(smoothed_spectra(planes, smoothing)), atol=1e-9
    )


@given(st.integers(0, 2**32 - 1), SMOOTHINGS)
def test_an_output_is_a_mean_of_neighbours_times_at_most_what_reach_allows(seed: int, smoothing: SpectralSmoothing) -> None:
    """No band rises above what any pixel has, but for brightness within reach: nothing is divided by next to nothing."""
    planes = np.abs(spectra_of(seed))
    most = planes.max(axis=(1, 2), keepdims=True) / (1 - smoothing.reach)
    smoothed = smoothed_spectra(planes, smoothing)
    assert (smoothed >= 0).all()
    assert (smoothed <= most * (1 + 1e-9)).all()


def test_plain_areas_one_colour_and_edges_of_brightness_stay() -> None:
    smoothing = SpectralSmoothing(5, 0.3)
    plain = np.broadcast_to(np.random.default_rng(0).random((16, 1, 1)), (16, 8, 9)).copy()
    assert np.array_equal(smoothed_spectra(plain, smoothing), plain)
    shaded = plain * np.random.default_rng(1).uniform(0.1, 1, (8, 9))
    np.testing.assert_allclose(smoothed_spectra(shaded, smoothing), shaded, rtol=1e-12)
    edge = plain.copy()
    edge[:, :, 4:] = 0.6 * plain[::-1, :, 4:]  # of another spectrum, and beyond reach
    assert np.array_equal(smoothed_spectra(edge, smoothing), edge)


def test_noise_of_spectra_falls_and_the_dark_stays_finite() -> None:
    rng = np.random.default_rng(2)
    spectrum = rng.uniform(0.5, 1, (16, 1, 1))
    noisy = spectrum + 0.05 * rng.normal(size=(16, 30, 30))
    smoothed = smoothed_spectra(noisy, SpectralSmoothing(3, 0.3))
    share = np.std(smoothed - spectrum) / np.std(noisy - spectrum)
    assert share == pytest.approx((1 / 9 + 8 / 9 / 16) ** 0.5, abs=0.03)  # a mean of nine, but brightness's own sixteenth
    for level in (0.0, SMOOTHING_DARKEST, 1e-30, -1.0):
        dark = level * (1 + rng.normal(size=(4, 6, 6)))
        made = smoothed_spectra(dark, SpectralSmoothing(3, 0.9))
        assert np.isfinite(made).all()
        below = dark.mean(axis=0) <= SMOOTHING_DARKEST
        assert np.array_equal(made[:, below], dark[:, below])


@pytest.mark.parametrize(
    ("variant", "window", "reach", "outputs"), [("processor", 3, 0.3, 16), ("graphics", 3, 0.3, 16), ("graphics", 9, 0.5, 2)]
)
def test_kernels_agree_with_the_reference(
    variant: str, window: int, reach: float, outputs: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also of a frame smaller than the window, and of one that is taken in bands of a few rows."""
    names = tuple(f"b{index}" for index in range(outputs))
    bare = random_table(SIXTEEN, black_level=64.0, patch=5, outputs=names, contrasts=(1.4,))
    table = with_spectra(bare, window, reach)
    reference, renderer = ReferenceRenderer(table), OpenCLRenderer(table, variant=variant)
    for shape, band in (((3, 4), 100), ((53, 70), 100), ((52, 71), 7)):
        monkeypatch.setattr(work, "BAND_PIXELS", band * shape[1])
        frame = frame_of_all_levels(table, np.random.default_rng(3), shape, (1, 2))
        expected, (labels,) = reference.exact_classified(frame)
        unsmoothed = ReferenceRenderer(dataclasses.replace(table, spectra=None)).exact_outputs(frame)
        assert np.abs(expected - unsmoothed).max() > 1e-3
        # float32 spectra are right to 1e-6; weights, whose slope is 1.5 / reach, to 1e-5 of what neighbours differ by
        np.testing.assert_allclose(renderer.outputs(frame), expected, atol=1e-5 * np.abs(expected).max())
        assert np.array_equal(renderer.labels(frame), labels)


def test_a_table_keeps_it_and_refuses_what_cannot_be(tmp_path: Path) -> None:
    table = with_spectra(random_table([[0, 1], [1, 2]], outputs=("a", "b")), 5, 0.25)
    save(table, tmp_path / "table.h5")
    assert load(TransformTable, tmp_path / "table.h5").spectra == SpectralSmoothing(5, 0.25)
    assert "smoothed over 5 × 5 pixels" in "\n".join(learned(insight(table)))
    for window, reach in ((4, 0.3), (11, 0.3), (3, 0.0), (3, 1.0)):
        with pytest.raises(ValueError, match=r"window is|reach is"):
            SpectralSmoothing(window, reach)
    for outputs in (("X", "Y", "Z"), ("a",)):
        with pytest.raises(ValueError, match="cannot be smoothed"):
            with_spectra(random_table([[0, 1], [1, 2]], outputs=outputs), 3, 0.3)
    with pytest.raises(RecipeError, match="spectral_window is 4; use 0 for no smoothing, or one of 3, 5, 7, 9"):
        refuse_first(learning_faults(LearningRecipe(darkest=0.001, spectral_window=4)))


# -------------------------------------------------------------------------------------------------------------- chroma
CHROMA, WHITE = ChromaSmoothing(0.6, 0.4), np.array([0.95, 1.0, 1.09])
FLAT = np.broadcast_to(np.array([0.4, 0.5, 0.3])[:, None, None], (3, 24, 30))


def colours_of(seed: int, noise: float = 0.1) -> NDArray[np.float64]:
    """X, Y, Z (3, row, col) of random brightness and chroma, some of them negative."""
    rng = np.random.default_rng(seed)
    return np.exp(rng.normal(-1, 0.3, (11, 13))) * (WHITE[:, None, None] + noise * rng.normal(size=(3, 11, 13)))


@given(st.integers(0, 2**32 - 1), st.integers(0, 3), st.booleans())
def test_chroma_keeps_luminance_scale_and_orientation(seed: int, turns: int, mirrored: bool) -> None:
    def turned(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.rot90(values[..., ::-1] if mirrored else values, turns, (1, 2))

    planes = colours_of(seed)
    smoothed = smoothed_chroma(planes, CHROMA, WHITE)
    assert np.array_equal(smoothed[1], planes[1])
    np.testing.assert_allclose(smoothed_chroma(4 * planes, CHROMA, WHITE), 4 * smoothed, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(smoothed_chroma(turned(planes), CHROMA, WHITE), turned(smoothed), atol=1e-9)


def test_one_chromaticity_stays_and_noise_of_chroma_falls() -> None:
    rng = np.random.default_rng(1)
    assert np.array_equal(smoothed_chroma(FLAT, CHROMA, WHITE), FLAT)
    shaded = FLAT * np.exp2(rng.integers(-3, 4, FLAT.shape[1:]))  # powers of two, which are exact
    assert np.array_equal(smoothed_chroma(shaded, CHROMA, WHITE), shaded)
    noisy = FLAT.copy()
    noisy[::2] += 0.001 * rng.normal(size=noisy[::2].shape)
    share = np.std((smoothed_chroma(noisy, CHROMA, WHITE) - FLAT)[::2, 8:-8, 8:-8]) / 0.001
    assert share == pytest.approx(17**-0.5, abs=0.03)  # mean of 17 pixels


@pytest.mark.parametrize(
    ("difference", "offsets"),
    [(0.19, CHROMA_NEIGHBOURS + FAR_CHROMA_NEIGHBOURS), (0.21, CHROMA_NEIGHBOURS), (0.39, CHROMA_NEIGHBOURS), (0.41, ())],
)
def test_far_neighbours_must_be_twice_as_similar(difference: float, offsets: tuple[tuple[int, int], ...]) -> None:
    """A pixel of another chroma changes all pixels of which it is a neighbour, unless the difference is too large."""
    planes = np.broadcast_to(0.5 * WHITE[:, None, None], (3, 40, 40)).copy()
    planes[0, 20, 20] *= 1 + difference
    changed = np.argwhere(smoothed_chroma(planes, CHROMA, WHITE)[0] != planes[0]) - 20
    expected = {*offsets, (0, 0)} if offsets else set()
    assert {(down, right) for down, right in changed.tolist()} == expected


def test_vivid_lines_of_one_pixel_keep_their_colour() -> None:
    for line in ([0.41, 0.21, 0.02], [0.36, 0.72, 0.12], [0.18, 0.07, 0.95]):  # sRGB primaries
        planes = FLAT.copy()
        for across in (slice(15, 16), slice(5, 7)):
            planes[:, :, across] = 0.5 / line[1] * np.array(line)[:, None, None]  # of the same luminance
        assert np.array_equal(smoothed_chroma(planes, CHROMA, WHITE), planes)
        for luminance, lost in ((0.2, 0.0), (0.35, 0.0), (0.8, 0.2)):  # around the lines, the luminance is 0.5
            vivid = luminance / line[1] * np.array(line)
            planes[:, :, 5:7] = planes[:, :, 15:16] = vivid[:, None, None]
            left = smoothed_chroma(planes, CHROMA, WHITE)[:, :, 15] - vivid[:, None]
            assert (np.abs(left) <= lost * np.abs(vivid - luminance / 0.5 * FLAT[:, 0, 0])[:, None] + 1e-12).all()


def test_false_colours_of_stripes_fall() -> None:
    """The errors of chroma are as large in the dark stripes as in the bright ones, as those of aliasing are."""
    luminance = np.where(np.arange(60) % 4 < 2, 0.15, 0.5) * np.ones((60, 1))
    errors = 0.04 * np.random.default_rng(3).normal(size=(2, 60, 60))
    planes = WHITE[:, None, None] * luminance
    false = planes.copy()
    false[::2] += WHITE[::2, None, None] * errors
    left = (smoothed_chroma(false, CHROMA, WHITE) - planes)[::2] / WHITE[::2, None, None]
    for level, most in ((0.15, 0.88), (0.5, 0.46)):  # without the contrast in the tolerance 0.96 and 0.48
        assert np.std(left[:, luminance == level]) < most * np.std(errors[:, luminance == level])


def test_the_dark_stays_finite() -> None:
    rng = np.random.default_rng(2)
    for level in (0.0, SMOOTHING_DARKEST, 1e-30, -1.0):
        dark = level * (1 + rng.normal(size=(3, 6, 6)))
        made = smoothed_chroma(dark, CHROMA, WHITE)
        assert np.isfinite(made).all()
        below = dark[1] <= SMOOTHING_DARKEST
        assert np.array_equal(made[:, below], dark[:, below])


def pixels_of(table: TransformTable, signal: NDArray[np.float64]) -> RawFrame:
    """A frame of these luminances of a white (row, col), without noise but with rounding to DN."""
    cfa = np.tile(table.cfa, (signal.shape[0] // 2 + 1, signal.shape[1] // 2 + 1))[: signal.shape[0], : signal.shape[1]]
    values = table.black_level + signal / white_scale(table)[cfa]
    return RawFrame("pixels", np.rint(values).astype(np.uint16), table.black_level, table.white_level)


@pytest.mark.parametrize("cfa", [BAYER, FIVE_BAND])
def test_a_black_pixel_gets_half_of_the_smallest_raw_value_nearby(cfa: NDArray) -> None:
    table = with_clipped_white(random_table(cfa, 16, 64.0), 1.2)
    signal = np.full((9, 11), 0.4)
    signal[:, 7:] = 0.1
    least = least_luminance(pixels_of(table, signal), table)
    np.testing.assert_allclose(least[:, :6], 0.2, rtol=0.01)
    np.testing.assert_allclose(least[:, 6:], 0.05, rtol=0.01)
    planes = 0.4 * np.broadcast_to(np.array([0.9, 1.0, 0.3])[:, None, None], (3, 9, 11)).copy()
    black = planes.copy()
    black[:, 4, 3] = 0.1, -0.05, 0.2
    made = smoothed_chroma(black, CHROMA, WHITE, np.full((9, 11), 0.2))
    np.testing.assert_allclose(made[:, 4, 3], [0.18, 0.2, 0.06])
    made[:, 4, 3] = planes[:, 4, 3]
    np.testing.assert_allclose(made, planes)


def with_noise_of(table: TransformTable, noise: float) -> TransformTable:
    """The table of a camera that has this noise without light, as the luminance of a white."""
    camera = table.camera
    assert camera is not None
    read_noise = noise / white_scale(table).mean() / camera.gain
    return dataclasses.replace(
        table, camera=dataclasses.replace(camera, noise=dataclasses.replace(camera.noise, read_noise=read_noise))
    )


def test_raising_hardly_changes_the_mean_of_noise_in_the_dark() -> None:
    table = with_noise_of(with_clipped_white(random_table(BAYER, 12, 64.0), 1.2), 0.005)
    noise = np.random.default_rng(4).normal(size=(200, 200))
    for signal, most in ((0.0, 0.1), (0.005, 0.05), (0.02, 0.01)):
        frame = pixels_of(table, signal + 0.005 * noise)
        rendered = signal + 0.0025 * np.random.default_rng(5).normal(size=noise.shape)
        raised = np.maximum(rendered, least_luminance(frame, table))
        assert abs(raised.mean() - rendered.mean()) < most * 0.0025


def test_the_noise_of_one_raw_value_makes_no_black_pixels() -> None:
    """The signal of a grey is three times the noise without light, and one raw value is smaller by twice the noise."""
    table = with_noise_of(with_clipped_white(random_table(BAYER, 16, 640.0), 1.2), 0.01)
    signal = np.full((9, 9), 0.03)
    signal[4, 4] -= 2 * 0.01
    least = least_luminance(pixels_of(table, signal), table)
    assert (least > 0.03 / 4).all()
    assert least[4, 4] < 0.03 / 3


@pytest.mark.parametrize(
    ("cfa", "reach"),
    [([[0]], 0), (BAYER, 1), (np.repeat(np.repeat(BAYER, 3, 0), 3, 1), 2), (FIVE_BAND, 1), (np.arange(16).reshape(4, 4), 2)],
)
def test_the_window_contains_every_channel_or_lacks_one_of_many(cfa: NDArray, reach: int) -> None:
    assert channel_reach(np.asarray(cfa, np.uint8)) == reach


CHROMA_TABLES = ("bayer", "two layers", "coarse chroma")  # whose other kernels test_render.py compiles, too
CHROMA_KERNELS = [(name, variant, True) for name in CHROMA_TABLES for variant in ("processor", "graphics")]
CHROMA_KERNELS += [("two layers", "graphics", False)]


@pytest.mark.parametrize(("name", "variant", "raises"), CHROMA_KERNELS)
def test_kernels_of_chroma_agree_with_the_reference(
    name: str, variant: str, raises: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Outputs, pictures and classes, with and without a known illuminant. If it is known, black pixels are raised.

    One frame is smaller than the window, one is larger than a tile, and one has lens shading and is rendered in bands of a
    few rows.
    """
    bare = TABLES[name]()
    if raises:
        bare = with_clipped_white(bare, 1.0)
    table = with_smoothed_chroma(bare)
    unraised = ReferenceRenderer(dataclasses.replace(table, light=None))
    reference, renderer = ReferenceRenderer(table), OpenCLRenderer(table, variant=variant)
    for shape, band in (((2, 3), 100), ((110, 140), 200), ((52, 71), 7)):
        monkeypatch.setattr(work, "BAND_PIXELS", band * shape[1])
        frame = frame_of_all_levels(table, np.random.default_rng(3), shape, (1, 1))
        if shape == (52, 71):
            nodes = -(-shape[1] // NODE_SPACING_COLUMNS) + 1
            gain = np.random.default_rng(6).uniform(1, 2, (shape[0], nodes)).astype(np.float32)
            frame = dataclasses.replace(frame, shading=Shading(gain, None))
        expected, labels = reference.exact_classified(frame)
        assert shape == (2, 3) or np.abs(expected - ReferenceRenderer(bare).exact_outputs(frame)).max() > 0.05
        assert shape == (2, 3) or (expected[1] > unraised.exact_outputs(frame)[1]).any() == raises
        shaded = frame.shading is not None
        depths = (8, 16) if name == "bayer" else () if shaded else (8,)  # the layers do not change how chroma is encoded
        for bits in depths:
            display = make_display(table.white_point, 1.0, bits)
            off = np.abs(renderer.picture(frame, display).astype(int) - encode(expected, display))
            assert off.max() <= (1 if bits == 8 else 3)
        np.testing.assert_allclose(renderer.outputs(frame), expected, atol=1e-5 * np.abs(expected).max())
        assert np.array_equal(renderer.labels(frame), labels[0])


def test_a_table_keeps_smoothed_chroma_and_refuses_other_outputs(tmp_path: Path) -> None:
    table = with_smoothed_chroma(random_table(BAYER, patch=3), 0.5, 0.3)
    save(table, tmp_path / "table.h5")
    assert load(TransformTable, tmp_path / "table.h5").chroma_smoothing == ChromaSmoothing(0.5, 0.3)
    assert insight(table)["chroma_smoothing"] == {"reach": 0.5, "likeness": 0.3}
    assert "less than 50 % in luminance and 30 % in chroma" in "\n".join(learned(insight(table)))
    for reach, likeness in ((0.0, 0.4), (1.0, 0.4), (0.6, 0.0)):
        with pytest.raises(ValueError, match=r"reach is|likeness is"):
            ChromaSmoothing(reach, likeness)
    with pytest.raises(ValueError, match="requires the outputs X, Y, Z"):
        with_smoothed_chroma(random_table(BAYER, outputs=("a", "b", "c")))
