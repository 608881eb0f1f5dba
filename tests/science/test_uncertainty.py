"""Uncertainty of outputs: the closed form beside what many noisy frames give, through one layer and two; regions; masks."""

from dataclasses import replace

import numpy as np
import pytest

from l3cli.artifacts.table import TransformTable
from l3cli.errors import RecipeError
from l3cli.frames.frame import RawFrame, upright
from l3cli.rendering.renderer import make_renderer
from l3cli.rendering.uncertainty import CLIPPED, UNTRAINED, Uncertainty, region, uncertainty, within_polygon
from l3cli.simulation.sensor import expose
from tests.helpers.cameras import BAYER, FIVE_BAND, random_camera
from tests.helpers.tables import random_table, with_clipping, with_coarse_chroma, with_refinement, with_spectra

SIDE, FRAMES = 48, 150


def even_table(cfa: list[list[int]], layers: int) -> TransformTable:
    """A table whose classes of a site have one transform: what noise does to classes then does not count."""
    table = random_table(cfa)
    channels = len(table.channels)
    camera = replace(random_camera(cfa, channels, 12, 0.0), rows=SIDE, cols=SIDE)
    table = replace(table, camera=replace(camera, black_level=table.black_level, white_level=table.white_level))
    if layers == 2:
        table = with_refinement(table, 3, ratios=True)

    def evened(layer):  # type: ignore[no-untyped-def]
        first = np.arange(len(layer.weights)) // layer.rule.classes_per_site * layer.rule.classes_per_site
        return replace(layer, weights=layer.weights[first], intercept=layer.intercept[first])

    return replace(table, first=evened(table.first), later=tuple(map(evened, table.later)))


def noisy_frame(table: TransformTable, share: float, seed: int, orientation: int = 0) -> RawFrame:
    assert table.camera is not None
    camera = replace(table.camera, fixed_pattern_seed=seed)
    even = np.linspace(0.6, 1.4, len(camera.channels))[camera.channel_map((SIDE, SIDE))]
    electrons = (share * camera.full_scale * even).astype(np.float32)
    values = expose(camera, electrons, 0.01, np.random.default_rng([seed, 7]))
    return RawFrame("frame", values, camera.black_level, camera.white_level, orientation=orientation)


@pytest.mark.parametrize("cfa", [BAYER, FIVE_BAND], ids=["bayer", "five bands"])
@pytest.mark.parametrize("layers", [1, 2])
def test_closed_form_is_what_noisy_frames_give(cfa: list[list[int]], layers: int) -> None:
    """σ of every output within 4 %, of the mean of regions of 8×8 pixels within 6 %."""
    table = even_table(cfa, layers)
    renderer = make_renderer("opencl", table)
    for share in (0.02, 0.3):
        frames = [noisy_frame(table, share, seed) for seed in range(FRAMES)]
        outputs = np.array([np.moveaxis(renderer.outputs(frame), 0, -1) for frame in frames])[:, 8:-8, 8:-8]
        found = uncertainty(table, frames[0], lambda each: make_renderer("opencl", each))
        assert (found.mask & CLIPPED == 0).all()
        varying = (outputs - outputs.mean(axis=0)).std(axis=(0, 1, 2), ddof=1) * np.sqrt(FRAMES / (FRAMES - 1))
        predicted = np.sqrt((found.sigma[8:-8, 8:-8] ** 2).mean(axis=(0, 1)))
        assert varying == pytest.approx(predicted, rel=0.04)
        tiles = outputs.reshape(FRAMES, 4, 8, 4, 8, -1).mean(axis=(2, 4))
        varying = (tiles - tiles.mean(axis=0)).std(axis=(0, 1, 2)) * np.sqrt(FRAMES / (FRAMES - 1))
        squares = [((r, c), (r, c + 7.5), (r + 7.5, c + 7.5), (r + 7.5, c)) for r in (8, 24) for c in (8, 16)]
        means = [region(np.moveaxis(renderer.outputs(frames[0]), 0, -1), found, square) for square in squares]
        assert {mean.pixels for mean in means} == {64}
        assert varying == pytest.approx(np.sqrt(np.mean([mean.sigma**2 for mean in means], axis=0)), rel=0.06)


def test_masks_name_what_was_not_trained() -> None:
    table = even_table(BAYER, 2)
    bright = noisy_frame(table, 2.0, 1)
    assert (uncertainty(table, bright, lambda each: make_renderer("opencl", each)).mask & CLIPPED).all()
    thin = replace(table, first=replace(table.first, samples=np.zeros_like(table.first.samples)))
    found = uncertainty(thin, noisy_frame(thin, 0.3, 1), lambda each: make_renderer("opencl", each))
    assert (found.mask & UNTRAINED).all()


def test_masks_name_plain_areas_that_clipping_replaces() -> None:
    """Nothing clips there yet, and classes are those of unclipped pixels."""
    bare = with_coarse_chroma(even_table(BAYER, 2))
    near = noisy_frame(bare, 0.94 / 1.4, 1)
    assert not (uncertainty(bare, near, lambda each: make_renderer("reference", each)).mask & CLIPPED).any()
    found = uncertainty(with_clipping(bare), near, lambda each: make_renderer("reference", each))
    assert (found.mask & CLIPPED).mean() > 0.9


def test_maps_are_upright_and_regions_are_those_of_the_picture() -> None:
    table = even_table(BAYER, 1)

    def of(orientation: int) -> Uncertainty:
        frame = noisy_frame(table, 0.1, 3, orientation)
        frame.values[:, : SIDE // 2] //= 4  # the left half is darker
        return uncertainty(table, frame, lambda each: make_renderer("opencl", each))

    lying, turned = of(0), of(6)
    assert np.array_equal(turned.sigma, upright(lying.sigma, 6))
    inside = within_polygon((SIDE, SIDE), [(4.5, 4.5), (4.5, 20.5), (12.5, 20.5), (12.5, 4.5)])
    assert inside.sum() == 8 * 16
    assert turned.of_mean(upright(inside, 6)) == pytest.approx(lying.of_mean(inside), rel=1e-9)


def test_what_is_not_known_is_refused() -> None:
    table = even_table(BAYER, 1)
    frame = noisy_frame(table, 0.1, 3)
    others = (
        (replace(table, camera=None), "does not hold its camera"),
        (with_refinement(table, 3, 3), "2 refinement layers"),
        (with_spectra(replace(table, outputs=("a", "b", "c")), 3, 0.5), "smooths spectra"),
    )
    for other, words in others:
        with pytest.raises(RecipeError, match=words):
            uncertainty(other, frame, lambda each: make_renderer("opencl", each))
    found = uncertainty(table, frame, lambda each: make_renderer("opencl", each))
    for picture, corners, words in ((found.sigma[1:], [(0, 0)], "give one frame's"), (found.sigma, [(0, 0)], "no pixel")):
        with pytest.raises(RecipeError, match=words):
            region(picture, found, corners)
