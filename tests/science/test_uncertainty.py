"""Predicted uncertainty of outputs, compared with many noisy frames for one and two layers. Regions and masks."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from l3cli.artifacts.layers import PlaneLayer
from l3cli.artifacts.table import TransformTable
from l3cli.classes.planes import opponent_basis
from l3cli.classes.windows import window_channels
from l3cli.errors import RecipeError
from l3cli.frames.frame import RawFrame, upright
from l3cli.physics.stokes import STOKES, angle_difference, aolp, dolp, polarisation_sigma, stokes_of
from l3cli.rendering.renderer import NoiseRenderer, make_renderer
from l3cli.rendering.uncertainty import CLIPPED, UNTRAINED, Uncertainty, region, uncertainty, within_polygon
from l3cli.simulation.sensor import expose
from tests.helpers.cameras import BAYER, FIVE_BAND, random_camera
from tests.helpers.tables import random_table, with_clipping, with_coarse_chroma, with_refinement

SIDE, FRAMES = 48, 150


def even_table(cfa: list[list[int]], layers: int, of_contrast: float = 0.0) -> TransformTable:
    """A table that answers plain areas alike at all sites, with random taps; the classes of a site have one transform, times
    1 ± `of_contrast` by their contrast."""
    table, rng = random_table(cfa, contrasts=(1.0,)), np.random.default_rng(5)
    channels = len(table.channels)
    camera = replace(random_camera(cfa, channels, 12, 0.0), rows=SIDE, cols=SIDE)
    table = replace(table, camera=replace(camera, black_level=table.black_level, white_level=table.white_level))
    rule = table.first.rule
    matrix, contrast = rng.uniform(0.1, 0.5, (3, channels)), rule.split(np.arange(rule.classes_per_site)).contrast
    factor = 1 + of_contrast * np.where(contrast > 0, 1, -1)
    sites = [factor[:, None, None] * taps_of(rng, matrix, window) for window in window_channels(table.cfa, rule.patch)]
    first = replace(
        table.first,
        weights=np.concatenate(sites).astype(np.float32),
        intercept=np.zeros_like(table.first.intercept),
    )
    table = replace(table, first=first)
    if layers == 1:
        return table
    table = with_refinement(table, *[3] * (layers - 1), ratios=layers == 2)
    back = np.linalg.inv(opponent_basis(table.white_point)).T

    def refining(layer: PlaneLayer) -> PlaneLayer:
        weights = np.zeros_like(layer.weights)
        weights[..., : layer.window_taps] = taps_of(rng, back, np.repeat(np.arange(3), layer.side**2))
        weights[..., layer.window_taps :] = 0.1
        return replace(layer, weights=weights)

    return replace(table, later=tuple(map(refining, table.later)))


def taps_of(rng: np.random.Generator, response: NDArray[np.floating], source: NDArray[np.integer]) -> NDArray[np.floating]:
    """Return random taps (output, tap), those of each source (tap) of a sum `response` (output, source)."""
    taps = rng.uniform(0.2, 1.8, (len(response), source.size))
    sums = np.stack([taps[:, source == number].sum(axis=1) for number in range(response.shape[1])], axis=1)
    return np.asarray(taps * (response / sums)[:, source])


def noisy_frame(table: TransformTable, share: float, seed: int, orientation: int = 0) -> RawFrame:
    assert table.camera is not None
    camera = replace(table.camera, fixed_pattern_seed=seed)
    even = np.linspace(0.6, 1.4, len(camera.channels))[camera.channel_map((SIDE, SIDE))]
    electrons = (share * camera.full_scale * even).astype(np.float32)
    values = expose(camera, electrons, 0.01, np.random.default_rng([seed, 7]))
    return RawFrame("frame", values, camera.black_level, camera.white_level, orientation=orientation)


def measured(outputs: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return the standard deviation (output) of outputs (frame, …, output) over the frames."""
    deviations = outputs - outputs.mean(axis=0)
    return deviations.std(axis=tuple(range(outputs.ndim - 1))) * np.sqrt(FRAMES / (FRAMES - 1))


@pytest.mark.parametrize(
    ("cfa", "layers", "line_noise"),
    [(BAYER, 1, 0.0), (BAYER, 2, 0.0), (FIVE_BAND, 1, 0.0), (FIVE_BAND, 2, 0.0), (BAYER, 1, 8.0)],
    ids=["bayer", "bayer layers", "five bands", "five bands layers", "bayer line noise"],
)
def test_sigma_is_what_noisy_frames_give(cfa: list[list[int]], layers: int, line_noise: float) -> None:
    """σ of every output within 4 %, of the mean of regions of 8×8 pixels within 6 %."""
    table = even_table(cfa, layers)
    assert table.camera is not None
    noise = replace(table.camera.noise, row_temporal_noise=line_noise, column_temporal_noise=line_noise)
    table = replace(table, camera=replace(table.camera, noise=noise))
    renderer = make_renderer("opencl", table)
    for share in (0.02, 0.3):
        frames = [noisy_frame(table, share, seed) for seed in range(FRAMES)]
        outputs = np.array([np.moveaxis(renderer.outputs(frame), 0, -1) for frame in frames])[:, 8:-8, 8:-8]
        found = uncertainty(renderer, frames[0])
        assert (found.mask & CLIPPED == 0).all()
        predicted = np.sqrt((found.sigma[8:-8, 8:-8] ** 2).mean(axis=(0, 1)))
        assert measured(outputs) == pytest.approx(predicted, rel=0.04)
        tiles = outputs.reshape(FRAMES, 4, 8, 4, 8, -1).mean(axis=(2, 4))
        squares = [((r, c), (r, c + 7.5), (r + 7.5, c + 7.5), (r + 7.5, c)) for r in (8, 24) for c in (8, 16)]
        means = [region(np.moveaxis(renderer.outputs(frames[0]), 0, -1), found, square) for square in squares]
        assert {mean.pixels for mean in means} == {64}
        assert measured(tiles) == pytest.approx(np.sqrt(np.mean([mean.sigma**2 for mean in means], axis=0)), rel=0.06)


def stokes_table() -> TransformTable:
    """A table for S1, S0 and S2 whose noise is correlated, because all of them are sums of the same four channels."""
    table = even_table([[0, 1], [2, 3]], 1)
    weights = table.first.weights * np.array([[0.4], [1.0], [-0.25]], np.float32)
    weights[:, 0] -= 0.2 * weights[:, 1]  # S1 has the correlation of a difference with S0
    return replace(table, outputs=STOKES, first=replace(table.first, weights=weights))


def test_sigma_of_degree_and_angle_is_what_noisy_frames_give() -> None:
    """Where the polarisation is clear, within 4 %; both would be wrong by 20 % and more without the covariances."""
    table = stokes_table()
    renderer = make_renderer("opencl", table)
    frames = [noisy_frame(table, 0.3, seed) for seed in range(FRAMES)]
    stokes = np.array([stokes_of(renderer.outputs(frame), STOKES) for frame in frames])[..., 8:-8, 8:-8]
    degree, angle = dolp(np.moveaxis(stokes, 1, 0)), aolp(np.moveaxis(stokes, 1, 0))
    assert 0.1 < degree.mean() < 0.9
    found = uncertainty(renderer, frames[0])
    assert found.polarisation is not None
    assert found.sigma.shape == (SIDE, SIDE, 3)
    wanted = [measured(degree[..., None])[0], measured(angle_difference(angle, float(np.median(angle)))[..., None])[0]]
    inside = found.polarisation[8:-8, 8:-8]
    assert np.sqrt((inside**2).mean(axis=(0, 1))) == pytest.approx(wanted, rel=0.04)
    alone = np.zeros((3, 3, *inside.shape[:2]))
    alone[range(3), range(3)] = np.moveaxis(found.sigma[8:-8, 8:-8, [1, 0, 2]], -1, 0) ** 2
    ignoring = polarisation_sigma(stokes[0], alone)
    assert (abs(np.sqrt((ignoring**2).mean(axis=(1, 2))) / wanted - 1) > 0.2).any()
    for orientation in (0, 5, 6):
        turned = uncertainty(renderer, replace(frames[0], orientation=orientation))
        np.testing.assert_array_equal(turned.polarisation, upright(found.polarisation, orientation))


@pytest.mark.parametrize("ratio", [0.0, 10.0])
def test_noise_of_polarisation(ratio: float) -> None:
    """Light that is `ratio` times as polarised as its noise. At 0, the angle is uniform and the degree is biased."""
    covariance = np.array([[1e-4, 4e-5, -2e-5], [4e-5, 2e-4, 3e-5], [-2e-5, 3e-5, 1.5e-4]])
    noise = float(np.sqrt(covariance[[1, 2], [1, 2]].mean()))
    truth = np.array([0.5, ratio * noise * np.cos(0.7), ratio * noise * np.sin(0.7)])
    noisy = np.random.default_rng(2).multivariate_normal(truth, covariance, 100_000).T
    stated = polarisation_sigma(truth[:, None], covariance[..., None])[:, 0]
    found = dolp(noisy).std(), float(np.sqrt((angle_difference(aolp(noisy), np.degrees(0.35)) ** 2).mean()))
    if ratio:
        assert stated == pytest.approx(found, rel=0.02)
    else:
        assert stated[1] == pytest.approx(180 / np.sqrt(12), rel=1e-3)
        assert found[1] == pytest.approx(180 / np.sqrt(12), rel=0.02)
        assert stated[0] == pytest.approx(found[0], rel=0.06)
        assert dolp(noisy).mean() == pytest.approx(np.sqrt(np.pi / 2) * noise / 0.5, rel=0.02)
    each = np.broadcast_to(covariance[..., None], (3, 3, noisy.shape[1]))
    assert polarisation_sigma(noisy, each)[0].mean() == pytest.approx(found[0], rel=0.02 if ratio else 0.12)


def test_classes_that_noise_chooses_count() -> None:
    """Where each of two classes is chosen at times, what tells them apart is noise, several times that of the values."""
    even, chosen = even_table(BAYER, 1), even_table(BAYER, 1, of_contrast=0.01)
    frames = [noisy_frame(chosen, 0.3, seed) for seed in range(FRAMES)]
    sigmas = {}
    for name, table in {"even": even, "chosen": chosen}.items():
        renderer = make_renderer("opencl", table)
        outputs = np.array([np.moveaxis(renderer.outputs(frame), 0, -1) for frame in frames])
        maps = np.array([uncertainty(renderer, frame).sigma for frame in frames[:4]])
        sigmas[name] = measured(outputs)
        assert sigmas[name] == pytest.approx(maps.mean(axis=(0, 1, 2)), rel=0.06)
    assert (sigmas["chosen"] > 2 * sigmas["even"]).all()


def test_gains_of_a_scene_serve_its_other_frames() -> None:
    table = even_table(BAYER, 3)
    renderer = make_renderer("opencl", table)
    first, other = (noisy_frame(table, 0.2, seed) for seed in (1, 2))
    found = uncertainty(renderer, first)
    like = uncertainty(renderer, other, found)
    assert like.gains is found.gains
    assert np.array_equal(uncertainty(renderer, first, found).sigma, found.sigma)
    assert like.sigma.mean(axis=(0, 1)) == pytest.approx(uncertainty(renderer, other).sigma.mean(axis=(0, 1)), rel=0.05)


def test_dark_current_is_of_the_frames_scale_and_a_frame_without_noise_has_none() -> None:
    table = even_table(BAYER, 1)
    renderer, frame = make_renderer("reference", table), replace(noisy_frame(table, 0.1, 1), dark=300.0)
    wide = replace(frame, values=16 * frame.values, black_level=16 * frame.black_level, white_level=16 * frame.white_level)
    assert np.array_equal(uncertainty(renderer, replace(wide, dark=4800.0)).sigma, uncertainty(renderer, frame).sigma)
    assert table.camera is not None
    quiet = replace(table, camera=replace(table.camera, gain=0.01, noise=replace(table.camera.noise, read_noise=1.0)))
    black = replace(frame, values=np.full_like(frame.values, table.black_level), dark=0.0)
    found = uncertainty(make_renderer("reference", quiet), black)
    assert not found.sigma.any()
    assert not found.of_mean(np.ones(black.values.shape, bool)).any()


def test_masks_name_what_was_not_trained() -> None:
    table = even_table(BAYER, 2)
    bright = noisy_frame(table, 2.0, 1)
    assert (uncertainty(make_renderer("opencl", table), bright).mask & CLIPPED).all()
    thin = replace(table, first=replace(table.first, samples=np.zeros_like(table.first.samples)))
    found = uncertainty(make_renderer("opencl", thin), noisy_frame(thin, 0.3, 1))
    assert (found.mask & UNTRAINED).all()


def test_masks_name_plain_areas_that_clipping_replaces() -> None:
    """Nothing clips there yet, and classes are those of unclipped pixels."""
    bare = with_coarse_chroma(even_table(BAYER, 2))
    near = noisy_frame(bare, 0.94 / 1.4, 1)
    assert not (uncertainty(make_renderer("reference", bare), near).mask & CLIPPED).any()
    found = uncertainty(make_renderer("reference", with_clipping(bare)), near)
    assert (found.mask & CLIPPED).mean() > 0.9


def test_maps_are_upright_and_regions_are_those_of_the_picture() -> None:
    table = even_table(BAYER, 1)

    def of(orientation: int) -> Uncertainty:
        frame = noisy_frame(table, 0.1, 3, orientation)
        frame.values[:, : SIDE // 2] //= 4  # the left half is darker
        return uncertainty(make_renderer("opencl", table), frame)

    lying, turned = of(0), of(6)
    assert np.array_equal(turned.sigma, upright(lying.sigma, 6))
    inside = within_polygon((SIDE, SIDE), [(4.5, 4.5), (4.5, 20.5), (12.5, 20.5), (12.5, 4.5)])
    assert inside.sum() == 8 * 16
    assert turned.of_mean(upright(inside, 6)) == pytest.approx(lying.of_mean(inside), rel=1e-9)


def test_large_frames_are_sampled_and_noise_is_that_of_their_gain() -> None:
    table = even_table(BAYER, 1)
    small, size = noisy_frame(table, 0.1, 3), 12
    large = replace(small, values=np.tile(small.values, (size, size)))
    renderer = NoiseRenderer("opencl", table)
    maps = (uncertainty(renderer.of_frame(frame), frame).sigma for frame in (small, large))
    usual, many = (each[8:-8, 8:-8].mean(axis=(0, 1)) for each in maps)
    assert many == pytest.approx(usual, rel=0.03)
    brighter = replace(small, gain=4.0)
    assert (uncertainty(renderer.of_frame(brighter), brighter).sigma[8:-8, 8:-8].mean(axis=(0, 1)) > 1.5 * usual).all()


def test_what_is_not_known_is_refused() -> None:
    table = even_table(BAYER, 1)
    frame, renderer = noisy_frame(table, 0.1, 3), make_renderer("opencl", table)
    with pytest.raises(RecipeError, match="depends on the camera's noise model"):
        uncertainty(make_renderer("opencl", replace(table, camera=None)), frame)
    with pytest.raises(RecipeError, match="requires at least 32×32 pixels"):
        uncertainty(renderer, replace(frame, values=frame.values[:8]))
    found = uncertainty(renderer, frame)
    for picture, corners, words in ((found.sigma[1:], [(0, 0)], "has the shape"), (found.sigma, [(0, 0)], "no pixel")):
        with pytest.raises(RecipeError, match=words):
            region(picture, found, corners)


def test_sigma_at_borders_and_corners_counts_mirrored_neighbours_once() -> None:
    """Where windows read a raw value twice, σ is that of its doubled weight: at every side within 10 %, over the corners
    12 %."""
    table = even_table(BAYER, 2)
    renderer = make_renderer("opencl", table)
    frames = [noisy_frame(table, 0.3, seed) for seed in range(FRAMES)]
    deviations = np.array([renderer.outputs(frame) for frame in frames]).std(axis=0, ddof=1)
    predicted = np.moveaxis(np.mean([uncertainty(renderer, frame).sigma for frame in frames[:4]], axis=0), -1, 0)

    def ratio(*place: slice | int) -> NDArray[np.floating]:
        at = (slice(None), *place)
        return np.asarray(deviations[at].reshape(3, -1).mean(axis=1) / predicted[at].reshape(3, -1).mean(axis=1))

    along, outermost = slice(8, -8), [*range(3), *range(-3, 0)]
    for distance in outermost:
        assert ratio(distance, along) == pytest.approx(1, abs=0.1)
        assert ratio(along, distance) == pytest.approx(1, abs=0.1)
    corner = (slice(0, 2), slice(-2, None))
    corners = [ratio(row, col) for row, col in itertools.product(corner, corner)]
    assert np.mean(corners, axis=0) == pytest.approx(1, abs=0.12)
    assert np.abs(np.array(corners) - 1).max() < 0.25  # of four pixels each
    inner = predicted[:, along, along].mean(axis=(1, 2))
    assert (predicted[:, 0, along].mean(axis=1) > 1.08 * inner).all()
