"""Uniform clipped areas: properties of the formula (docs/method.md#uniform-clipped-areas) and of the kernels."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.conditions import Condition
from l3cli.artifacts.layers import Clipping
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import LightSpectrum
from l3cli.classes.clipping import CLIPS, KEPT, WHITE_FROM, Mosaic, block_maps, block_sides, clipping_maps, replaced
from l3cli.frames.frame import RawFrame
from l3cli.physics import spectra
from l3cli.physics.display import daylight, delta_e_2000, displayed, displayed_xyz, lab
from l3cli.physics.mosaic import shifted_cfa
from l3cli.rendering.conditions import Mix, mixed
from l3cli.rendering.exposure import LightMeter, still_scale
from l3cli.rendering.opencl import work
from l3cli.rendering.opencl.renderer import OpenCLRenderer
from l3cli.rendering.reference import ReferenceRenderer, mosaic_of
from l3cli.training.clipping import learned_clipping
from tests.helpers.cameras import BAYER, X_TRANS
from tests.helpers.paths import CONFIGS
from tests.helpers.tables import (
    random_table,
    with_clipped_white,
    with_clipping,
    with_coarse_chroma,
    with_first,
    with_lights,
    with_refinement,
)

ARRAYS = {"bayer": BAYER, "x-trans": X_TRANS}


def soft_frame(table: TransformTable, shape: tuple[int, int], phase: tuple[int, int] = (0, 0)) -> RawFrame:
    """A frame whose channels rise to clip one after the other, but for a dark square."""
    cfa = shifted_cfa(table.cfa, phase)
    rows, cols = np.indices(shape)
    gain = np.linspace(0.7, 1.3, len(table.channels))[cfa[rows % cfa.shape[0], cols % cfa.shape[1]]]
    signal = gain * (0.3 + 1.1 * cols / shape[1]) + 0.01 * np.random.default_rng(0).normal(size=shape)
    signal[shape[0] // 2 : shape[0] // 2 + 5, 5:12] = 0.1
    span = table.white_level - table.black_level
    values = np.clip(signal * span + table.black_level, 0, table.white_level).astype(np.uint16)
    return RawFrame("soft", values, table.black_level, table.white_level, phase)


def vivid_frame(table: TransformTable, white: NDArray) -> RawFrame:
    """A uniform frame in which no channel clips, but channels of a grey of the same brightness do."""
    rows, cols = np.indices((40, 52))
    channel = table.cfa[rows % table.cfa.shape[0], cols % table.cfa.shape[1]]
    signal = np.where(channel == white.argmin(), KEPT + 0.05, KEPT + 0.03) + 0.02 * (-1.0) ** (rows // 2 + cols // 2)
    values = signal * (table.white_level - table.black_level) + table.black_level
    return RawFrame("vivid", values.astype(np.uint16), table.black_level, table.white_level, (0, 0))


@pytest.mark.parametrize(("array", "variant"), [("bayer", "graphics"), ("x-trans", "processor")])
def test_backends_agree(monkeypatch: pytest.MonkeyPatch, array: str, variant: str) -> None:
    """Also in bands, at any phase, and in frames smaller than a block."""
    bare = with_coarse_chroma(with_refinement(random_table(ARRAYS[array], black_level=64.0, patch=5), 5, ratios=1))
    table = with_clipping(bare)
    frames = [soft_frame(table, (190, 131)), soft_frame(table, (43, 300), (1, 1)), soft_frame(table, (3, 2))]
    assert table.later[-1].clipping is not None
    frames.append(vivid_frame(table, table.later[-1].clipping.white))
    device = OpenCLRenderer(table, variant=variant)
    exact = [ReferenceRenderer(table).exact_outputs(frame) for frame in frames]
    for frame, expected in zip(frames, exact, strict=True):
        np.testing.assert_allclose(device.outputs(frame), expected, atol=1e-5 * np.abs(expected).max())
    changed = np.abs(ReferenceRenderer(bare).exact_outputs(frames[0]) - exact[0])
    assert changed.max() > 0.05
    assert not changed[:, :, :10].any()  # nothing is near clipping
    clipping = table.later[-1].clipping
    assert clipping is not None
    assert clipping_maps(mosaic_of(frames[0], table), clipping.response, clipping.white)[4].max() > 0.05
    whole = device.outputs(frames[0])
    monkeypatch.setattr(work, "BAND_PIXELS", 10 * 131)
    np.testing.assert_array_equal(OpenCLRenderer(table, variant=variant).outputs(frames[0]), whole)


LIGHT = 20  # pixels, side of a light that contains few uniform blocks


def lights_frame(table: TransformTable, width: int, places: list[tuple[int, int]]) -> RawFrame:
    """A dark frame of 203 rows with small lights, in which some channels clip, at the given first pixels."""
    rows, cols = np.indices((203, width))
    channel = table.cfa[rows % table.cfa.shape[0], cols % table.cfa.shape[1]]
    light = np.linspace(0.65, 1.3, len(table.channels))[channel]
    signal = 0.2 * light
    for row, col in places:
        here = slice(row, row + LIGHT), slice(col, col + LIGHT)
        signal[here] = light[here]
    span = table.white_level - table.black_level
    values = np.clip(signal * span + table.black_level, 0, table.white_level).astype(np.uint16)
    return RawFrame("lights", values, table.black_level, table.white_level)


@pytest.mark.parametrize(("array", "lanes", "width"), [("bayer", None, 1063), ("x-trans", 8, 571)])
def test_single_lights_are_corrected_wherever_they_are(array: str, lanes: int | None, width: int) -> None:
    """Also at the corners of a frame and of tiles, and in a frame that a renderer renders after another one.

    What the kernels skip must not be left from an earlier frame.
    """
    bare = with_coarse_chroma(with_refinement(random_table(ARRAYS[array], black_level=64.0, patch=5), 5, ratios=1))
    table = with_clipping(bare)
    device = OpenCLRenderer(table, variant="processor", lanes=lanes)
    sides = block_sides(table.cfa)
    corner = min(48 * sides[0] - 8, 183), min(256 * sides[1] - 8, width - LIGHT)  # of a tile of blocks, or of the frame
    lit = [(0, 0), corner, (88, 502), (88, 56)]  # tiles of quads are 96 × 512 pixels
    moved = [(0, width - LIGHT), (183, 0), (40, 300)]
    frames = [lights_frame(table, width, places) for places in (lit, [], moved)]
    exact = [ReferenceRenderer(table).exact_outputs(frame) for frame in frames]
    for places, frame, expected in zip((lit, [], moved), frames, exact, strict=True):
        changed = np.abs(expected - ReferenceRenderer(bare).exact_outputs(frame)).max(axis=0)
        assert changed.any() == bool(places)
        for row, col in places:
            assert changed[row : row + LIGHT, col : col + LIGHT].max() > 0.01
    for number in (0, 0, 1, 1, 2, 2, 0):  # in pairs, because a renderer has two sets of buffers
        outputs, expected = device.outputs(frames[number]), exact[number]
        np.testing.assert_allclose(outputs, expected, atol=1e-5 * np.abs(expected).max())


def test_estimates_of_an_earlier_frame_do_not_spread() -> None:
    """Estimates spread from a uniform area without clipped channels, where the frames before have estimates."""
    bare = with_coarse_chroma(with_refinement(random_table(BAYER, black_level=64.0, patch=5), 5, ratios=1))
    table = with_clipping(bare)
    device = OpenCLRenderer(table, variant="processor")
    rows, cols = np.indices((203, 512))
    span, channel = table.white_level - table.black_level, table.cfa[rows % 2, cols % 2]
    right = np.where(cols < 256, 0.62, 1.0) * np.array([0.7, 1.0, 1.3])[channel]  # the right half clips
    left = np.where(cols < 256, 1.0, 0.62) * np.array([0.7, 1.0, 1.1])[channel]
    for signal in (left, right):
        values = np.clip(signal * span + table.black_level, 0, table.white_level).astype(np.uint16)
        frame = RawFrame("sky", values, table.black_level, table.white_level)
        expected = ReferenceRenderer(table).exact_outputs(frame)
        for _ in range(2):  # because a renderer has two sets of buffers
            np.testing.assert_allclose(device.outputs(frame), expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize(("sides", "variant"), [((), "processor"), ((3,), "graphics")], ids=["one layer", "two layers"])
def test_no_pixel_is_brighter_than_the_clipped_white(sides: tuple[int, ...], variant: str) -> None:
    bare = with_refinement(random_table(BAYER, black_level=64.0, patch=5), *sides)
    frame = soft_frame(bare, (43, 131))
    before = ReferenceRenderer(bare).exact_outputs(frame)
    table = with_clipped_white(bare, float(np.quantile(before[1][before[1] > 0], 0.5)))
    expected, white = ReferenceRenderer(table).exact_outputs(frame), table.clipped_white
    assert white is not None
    brighter = before[1] > white[1]
    np.testing.assert_array_equal(expected[:, ~brighter], before[:, ~brighter])
    np.testing.assert_allclose(expected[1, brighter], white[1])
    far = before[1] > WHITE_FROM * white[1]
    assert far.any()
    np.testing.assert_allclose(expected[:, far], np.broadcast_to(white[:, None], (3, far.sum())))
    device = OpenCLRenderer(table, variant=variant)
    for outputs in (device.outputs(frame), device.classified(frame)[0]):
        np.testing.assert_allclose(outputs, expected, atol=1e-5 * np.abs(expected).max())


def test_the_clipped_white_fills_the_weakest_channel() -> None:
    camera, radiance, white, to_signals, clipping = learned("fiveband")
    grid = spectra.light_grid(camera.wavelength).astype(float)
    light = LightSpectrum(grid, spectra.at_luminance(spectra.illuminant("D65", grid), grid, 1.0).astype(np.float32), 0.0)
    table = dataclasses.replace(
        random_table(camera.cfa), channels=camera.channels, camera=camera, light=light, white_point=white
    )
    table = dataclasses.replace(table, output_unit=camera.output_unit)
    assert table.clipped_white is not None
    np.testing.assert_allclose(table.clipped_white, white / (radiance @ to_signals).min(), rtol=1e-3)
    np.testing.assert_allclose(table.clipped_white[1], 1 / clipping.white.min(), rtol=1e-6)
    assert dataclasses.replace(table, light=None).clipped_white is None


def flat(signals: NDArray, cfa: NDArray[np.uint8]) -> Mosaic:
    """A mosaic of one colour (channel), shares of full scale."""
    values = np.minimum(np.tile(signals[cfa], (12, 12)), 1.0) * 60000
    return Mosaic(values.astype(np.uint16), cfa, 0.0, 60000.0)


def learned(name: str) -> tuple[CameraModel, NDArray, NDArray, NDArray, Clipping]:
    """A camera, the photons and XYZ of daylight, signals (wavelength, channel) of photons, and what is learned."""
    camera = load_camera(CONFIGS / f"cameras/{name}.toml")
    grid = spectra.light_grid(camera.wavelength).astype(float)
    light = LightSpectrum(grid, spectra.at_luminance(spectra.illuminant("D65", grid), grid, 1.0).astype(np.float32), 0.0)
    radiance, weights = spectra.illuminant("D65", camera.wavelength), spectra.xyz_weights(camera.wavelength)
    radiance = radiance / (radiance @ weights.T)[1]
    white = radiance @ weights.T
    clipping = learned_clipping(camera, light, white)
    assert clipping is not None
    return camera, radiance, white, camera.signal_weights.T * (camera.output_unit / camera.full_scale), clipping


@pytest.mark.parametrize("name", ["fiveband", "rgbw"])
def test_light_rises_smoothly_to_white(name: str) -> None:
    camera, radiance, white, to_signals, clipping = learned(name)
    signals, seen = radiance @ to_signals, []
    for over in np.geomspace(0.5, 1.2 * signals.max() / signals.min(), 60):
        mosaic = flat(over / signals.max() * signals, camera.cfa)
        by_classes = over / signals.max() * white if over < CLIPS else np.zeros(3)  # that know nothing where a channel clips
        outputs = np.broadcast_to(by_classes[:, None, None], (3, *mosaic.values.shape))
        seen.append(replaced(outputs, mosaic, clipping.response, clipping.white)[:, 9, 9])
    luminance = np.array(seen)[:, 1]
    assert np.diff(luminance).min() > -0.005 * luminance.max()
    assert np.diff(luminance).max() < 0.1 * luminance.max()
    np.testing.assert_allclose(np.array(seen) / luminance[:, None], np.broadcast_to(white, (60, 3)), rtol=0.002)
    np.testing.assert_allclose(luminance[-1], 1 / signals.min(), rtol=0.002)


@pytest.mark.parametrize("name", ["bayer", "fiveband"])
def test_colours_that_do_not_clip_do_not_change(name: str) -> None:
    camera, radiance, _, to_signals, clipping = learned(name)
    surfaces = (spectra.reflectance_library(camera.wavelength) * radiance) @ to_signals
    for signals in surfaces[::40]:
        brightest = 0.99 * KEPT / signals.max()
        assert not clipping_maps(flat(brightest * signals, camera.cfa), clipping.response, clipping.white).any()


def test_an_evening_sky_keeps_its_colours_until_it_clips() -> None:
    """The sky becomes brighter and more orange downwards. In the last rows, green reaches 0.97 of full scale."""
    camera, radiance, white, to_signals, clipping = learned("bayer")
    blue, orange = (np.interp(camera.wavelength, [450, 550, 650], at)[:, None] for at in ([0.8, 0.6, 0.6], [0.4, 0.8, 1.1]))
    orange_share = np.linspace(0, 1, 200)
    sky = radiance[:, None] * ((1 - orange_share) * blue + orange_share * orange) * np.linspace(0.5, 1, 200)
    signals, truth = to_signals.T @ sky, sky.T @ spectra.xyz_weights(camera.wavelength).T
    level = 0.97 / signals.max()
    rows, cols = np.indices((200, 16))
    values = 60000 * level * signals[camera.cfa[rows % 2, cols % 2], rows]
    mosaic = Mosaic(values.astype(np.uint16), camera.cfa, 0.0, 60000.0)
    outputs = np.broadcast_to(level * truth.T[:, :, None], (3, *rows.shape))
    changed = replaced(outputs, mosaic, clipping.response, clipping.white)
    pictures = (displayed(xyz, white, 1 / clipping.white.max()) for xyz in (changed, outputs))
    error = delta_e_2000(*(lab(displayed_xyz(picture), daylight()) for picture in pictures))
    assert error.max() > 0.2  # the outputs are replaced
    assert error.mean() < 0.2


@pytest.mark.parametrize(("name", "most"), [("bayer", 2.1), ("fiveband", 3.0)])
def test_vivid_colours_become_white_in_small_steps(name: str, most: float) -> None:
    """Largest ΔE00 of exposures 2 % apart, as displayed as white ends, mean over vivid surfaces."""
    camera, radiance, white, to_signals, clipping = learned(name)
    lit = spectra.reflectance_library(camera.wavelength) * radiance
    colours = lab(lit @ spectra.xyz_weights(camera.wavelength).T, white)
    vivid = (lit @ to_signals)[np.hypot(colours[:, 1], colours[:, 2]) > 45][::5]
    over, largest = np.exp(np.arange(np.log(CLIPS), np.log(4), 0.02)), []
    for surface in vivid:
        means = np.minimum(surface[:, None, None] / surface.max() * over, 1.0)
        outputs = block_maps(means, np.zeros(means.shape[1:]), clipping.response, clipping.white)[1:]
        picture = displayed(outputs, white, 1 / (radiance @ to_signals).min())
        seen = lab(displayed_xyz(picture), daylight())[0]
        largest.append(delta_e_2000(seen[1:], seen[:-1]).max())
    assert np.mean(largest) < most


def test_clipped_areas_take_the_hue_of_the_same_surface_nearby() -> None:
    """Columns of one surface are exposed more and more. Clipped ones take the colour of darker ones."""
    camera, radiance, _, to_signals, clipping = learned("bayer")
    skin = np.interp(camera.wavelength, [400, 500, 600, 700], [0.15, 0.3, 0.6, 0.7]) * radiance
    signals, colour = skin @ to_signals, skin @ spectra.xyz_weights(camera.wavelength).T
    over = np.repeat([0.5, 0.8, 1.3, 1.5, 9.0], 12)  # of the exposure that fills the first channel
    rows, cols = np.indices((60, 60))
    values = np.minimum(over * (signals / signals.max())[camera.cfa[rows % 2, cols % 2]], 1.0)
    mosaic = Mosaic((60000 * values).astype(np.uint16), camera.cfa, 0.0, 60000.0)
    maps = clipping_maps(mosaic, clipping.response, clipping.white)[4:, 20:40]
    assert not maps[:, :, :20].any()  # nothing clips
    assert not maps[:, :, 54:].any()  # every channel clips
    taken, x, z = maps[:, :, 28:34]
    assert taken.min() > 0.6
    np.testing.assert_allclose(x / taken, colour[0] / colour[1], rtol=0.03)
    np.testing.assert_allclose(z / taken, colour[2] / colour[1], rtol=0.06)


@pytest.mark.parametrize(("name", "most"), [("bayer", 0.035), ("fiveband", 0.055)])
def test_an_over_exposed_sky_keeps_its_hue_far_from_unclipped_sky(name: str, most: float) -> None:
    """Rows of sky become brighter and less blue downwards. The mean error of X/Y and Z/Y is relative to a white."""
    camera, radiance, white, to_signals, clipping = learned(name)
    blue = np.interp(camera.wavelength, [400, 480, 600, 700], [0.6, 0.6, 0.2, 0.15])[:, None]
    brightness, share = np.linspace(0.6, 1.2, 240), np.linspace(0, 0.6, 240)
    sky = radiance[:, None] * ((1 - share) * blue + share)
    signals, colours = to_signals.T @ sky, sky.T @ spectra.xyz_weights(camera.wavelength).T
    level = brightness / (signals[:, 0].max() / 0.9)
    rows, cols = np.indices((240, 48))
    channel = camera.cfa[rows % camera.cfa.shape[0], cols % camera.cfa.shape[1]]
    values = np.minimum((level * signals)[channel, rows], 1.0)
    mosaic = Mosaic((60000 * values).astype(np.uint16), camera.cfa, 0.0, 60000.0)
    taken, *maps = clipping_maps(mosaic, clipping.response, clipping.white)[4:, :, 24]
    clips = (level * signals).max(axis=0) > 1
    partly = clips & ((level * signals).min(axis=0) < 0.85)
    far = np.flatnonzero(partly)[40:]  # rows that are at least 40 pixels from unclipped sky
    assert far.size > 30
    assert taken[far].min() > 0.5
    truth, of_white = colours[far][:, ::2] / colours[far][:, 1:2], white[::2] / white[1]
    assert np.abs((np.stack(maps, 1)[far] / taken[far, None] - truth) / of_white).mean() < most


@pytest.mark.parametrize("name", ["bayer", "fiveband"])
def test_a_large_over_exposed_sky_has_no_bands(name: str) -> None:
    """The signals rise in steps of 2 % of full scale, as in a picture with few levels. Steps of the hue must stay small."""
    camera, radiance, white, to_signals, clipping = learned(name)
    blue = np.interp(camera.wavelength, [400, 480, 600, 700], [0.6, 0.6, 0.2, 0.15])[:, None]
    length = 440
    brightness, share = np.linspace(0.6, 1.3, length), np.linspace(0, 0.6, length)
    signals = to_signals.T @ (radiance[:, None] * ((1 - share) * blue + share))
    exact = brightness / (signals[:, 0].max() / 0.9) * signals
    rows, cols = np.indices((length, 48))
    channel = camera.cfa[rows % camera.cfa.shape[0], cols % camera.cfa.shape[1]]
    values = np.minimum(np.round(50 * exact) / 50, 1.0)[channel, rows]
    mosaic = Mosaic((60000 * values).astype(np.uint16), camera.cfa, 0.0, 60000.0)
    taken, *maps = clipping_maps(mosaic, clipping.response, clipping.white)[4:, :, 24]
    partly = (exact.max(axis=0) > 1) & (exact.min(axis=0) < 0.85)
    far = np.flatnonzero(partly)[100:]  # rows that are at least 100 pixels from unclipped sky
    assert far.size > 30
    assert taken[far].min() > 0.7
    hue = np.stack(maps)[:, far] / taken[far] * (white[1] / white[::2])[:, None]
    assert np.abs(hue[:, 4:] - hue[:, :-4]).max() < 0.05


def test_a_white_that_clips_keeps_its_hue_beside_vivid_surfaces() -> None:
    camera, radiance, _, to_signals, clipping = learned("bayer")
    signals = radiance @ to_signals
    vivid = (radiance * np.interp(camera.wavelength, [540, 560], [0.1, 1.0])) @ to_signals
    rows, cols = np.indices((48, 64))
    channel = camera.cfa[rows % 2, cols % 2]
    for exposure in (1.1, 1.4, 3.0):
        paper = exposure * signals / signals.max()
        values = np.minimum(np.where(cols < 32, 0.7 * (vivid / vivid.max())[channel], paper[channel]), 1.0)
        mosaic = Mosaic((60000 * values).astype(np.uint16), camera.cfa, 0.0, 60000.0)
        taken = clipping_maps(mosaic, clipping.response, clipping.white)[4]
        assert taken.max() < 0.1


def test_a_white_of_which_one_channel_does_not_clip_is_not_tinted_by_its_surroundings() -> None:
    """Only red does not clip, so the white is similar to surfaces of any colour."""
    camera, radiance, white, to_signals, clipping = learned("fiveband")
    paper = 1.45 * radiance @ to_signals / (radiance @ to_signals).max()
    blue = (radiance * np.interp(camera.wavelength, [470, 500], [1.0, 0.1])) @ to_signals
    rows, cols = np.indices((48, 64))
    channel = camera.cfa[rows % camera.cfa.shape[0], cols % camera.cfa.shape[1]]
    values = np.minimum(np.where(cols < 32, 0.7 * (blue / blue.max())[channel], paper[channel]), 1.0)
    mosaic = Mosaic((60000 * values).astype(np.uint16), camera.cfa, 0.0, 60000.0)
    outputs = np.broadcast_to(white[:, None, None], (3, *rows.shape))
    changed = replaced(outputs, mosaic, clipping.response, clipping.white)[:, :, 36:]
    assert np.abs(changed / changed[1] / white[:, None, None] - 1).max() < 0.1


def test_skin_that_clips_beside_a_dark_edge_is_not_mottled() -> None:
    """Red and green clip next to a dark edge, so that only blue shows the luminance. Single pixels render it with noise."""
    camera, radiance, _, to_signals, clipping = learned("bayer")
    skin = radiance * np.interp(camera.wavelength, [420, 500, 560, 620], [0.3, 0.5, 0.55, 1.0])
    signals, colour = skin @ to_signals, skin @ spectra.xyz_weights(camera.wavelength).T
    rows, cols = np.indices((64, 64))
    level = np.interp(rows, [0, 34, 40, 48], [0.5, 0.75, 1.2, 1.25]) / np.sort(signals)[1]
    level[48:] *= 0.05
    values = np.minimum(level * signals[camera.cfa[rows % 2, cols % 2]], 1.0)
    mosaic = Mosaic((60000 * values).astype(np.uint16), camera.cfa, 0.0, 60000.0)
    truth = level * colour[:, None, None]
    noise = np.random.default_rng(0).normal(1, 0.15, size=rows.shape)
    made = replaced(truth * noise, mosaic, clipping.response, clipping.white) / truth
    assert made[1, 44:48].std() < 0.5 * noise[44:48].std()
    assert np.abs(made[:, 44:48].mean(axis=(1, 2)) - 1).max() < 0.06


def test_a_table_keeps_it_and_refuses_what_cannot_be(tmp_path: Path) -> None:
    table = with_clipping(with_coarse_chroma(with_refinement(random_table(BAYER, patch=5), 5)))
    save(table, tmp_path / "table.h5")
    kept, clipping = load(TransformTable, tmp_path / "table.h5").later[-1].clipping, table.later[-1].clipping
    assert kept is not None
    assert clipping is not None
    np.testing.assert_array_equal(kept.response, clipping.response)
    for response in (np.zeros((4, 3, 3)), np.full((4, 4, 3), np.nan)):
        with pytest.raises(ValueError, match="response"):
            Clipping(response, np.ones(3))
    with pytest.raises(ValueError, match="must also have coarse_chroma"):
        dataclasses.replace(table.later[-1], coarse_chroma=None)
    wrong = dataclasses.replace(table.later[-1], clipping=Clipping(np.zeros((5, 5, 3)), np.ones(4)))
    with pytest.raises(ValueError, match="channel"):
        dataclasses.replace(table, later=(wrong,))


def test_lights_have_what_becomes_of_clipped_areas_of_their_own(tmp_path: Path) -> None:
    table = with_lights(with_clipping(with_coarse_chroma(with_refinement(random_table(BAYER, patch=5), 5))), "A", "D65")
    own: list[Condition] = []
    clippings: list[Clipping] = []
    for number, condition in enumerate(table.conditions):
        clipping = with_clipping(table, seed=20 + number).later[-1].clipping
        assert clipping is not None
        clippings.append(clipping)
        later = dataclasses.replace(condition.later[-1], clipping=clipping)
        own.append(dataclasses.replace(condition, later=(*condition.later[:-1], later)))
    save(dataclasses.replace(table, conditions=tuple(own)), tmp_path / "table.h5")
    table = load(TransformTable, tmp_path / "table.h5")
    warm, cool, between = (mixed(table, Mix(0, 1, share)).later[-1].clipping for share in (0.0, 1.0, 0.25))
    assert warm is not None
    assert cool is not None
    assert between is not None
    for end, clipping in ((warm, clippings[0]), (cool, clippings[1])):
        np.testing.assert_array_equal(end.response, clipping.response)
    np.testing.assert_allclose(between.response, 0.75 * warm.response + 0.25 * cool.response)
    np.testing.assert_allclose(between.white, 0.75 * warm.white + 0.25 * cool.white)


def test_over_exposed_areas_are_exposed_as_white() -> None:
    """Brightness that is shown white is at most that of the clipped white, so that it does not depend on what classes
    guess."""
    bare = random_table(BAYER, black_level=64.0, patch=5)
    frame = soft_frame(bare, (96, 131))
    brightness = LightMeter(bare).brightness(frame)
    assert brightness > 0
    for limit in (0.5, 2.0):
        table = with_clipped_white(bare, limit * brightness)
        assert LightMeter(table).brightness(frame) == pytest.approx(min(limit, 1.0) * brightness)


@pytest.mark.parametrize("clips", [True, False])
def test_noise_does_not_make_over_exposed_white_grey(clips: bool) -> None:
    """Luminance is red here. If green clips, the noise of red must not raise the luminance that is shown as white."""
    table = random_table(BAYER, black_level=64.0, patch=5)
    weights = np.zeros_like(table.first.weights)
    weights[:, :, table.first.rule.patch**2 // 2] = 1.0
    table = with_first(table, weights=weights, intercept=np.zeros_like(table.first.intercept))
    rows, cols = np.indices((96, 132))
    red = table.cfa[rows % 2, cols % 2] == table.cfa[0, 0]
    luminance = 0.5 + 0.005 * np.random.default_rng(0).normal(size=red.shape)
    signal = np.where(red, luminance, 1.0 if clips else 0.5)
    values = (signal * (table.white_level - table.black_level) + table.black_level).round().astype(np.uint16)
    frame = RawFrame("page", values, table.black_level, table.white_level, (0, 0))
    percentile = 0.5 + 2.33 * 0.005
    assert LightMeter(table).brightness(frame) == pytest.approx(0.5 if clips else percentile, abs=0.002)
    assert 1 / still_scale(luminance, frame, table) == pytest.approx(0.5 if clips else percentile, abs=0.002)
