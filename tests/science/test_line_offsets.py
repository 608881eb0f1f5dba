"""Row and column offsets are estimated from the picture itself and subtracted, and the noise that remains is known."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from l3cli.api import raw_frame
from l3cli.artifacts.camera import CameraModel, Readout, variance_left_by_picture
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.errors import RecipeError
from l3cli.frames.frame import RawFrame
from l3cli.frames.line_offsets import without_picture_offsets
from l3cli.io.frames import FrameFiles
from l3cli.rendering.temporal.noise import ONE, require_noise
from l3cli.rendering.temporal.reference import ReferenceFilter
from l3cli.simulation.sensor import expose
from tests.helpers.paths import CONFIGS
from tests.helpers.raw_files import read_in_every_way

ROWS, COLS = 300, 1536
SIGNAL = {"bayer": 120.0, "fiveband": 264.0}  # e-; 0.02 of full scale
Array = np.ndarray


def camera_of(name: str, row: float = 0.0, column: float = 0.0) -> CameraModel:
    """A camera whose row noise and column noise are these multiples of its read noise. It has no other fixed pattern."""
    camera = load_camera(CONFIGS / f"cameras/{name}.toml")
    read = camera.noise.read_noise
    noise = dataclasses.replace(
        camera.noise, row_temporal_noise=row * read, column_temporal_noise=column * read, prnu=0.0, dsnu=0.0
    )
    return dataclasses.replace(camera, noise=noise, rows=ROWS, cols=COLS)


def taken(camera: CameraModel, electrons: Array, seed: int = 1, offsets: float = 1.0) -> tuple[Array, Array, Array]:
    """Values of a frame without offsets, values of the frame with offsets, and offsets of all pixels in e-."""
    noise = dataclasses.replace(camera.noise, row_temporal_noise=0.0, column_temporal_noise=0.0)
    quiet = dataclasses.replace(camera, noise=noise)
    plain = expose(quiet, electrons.astype(np.float32), 0.0, np.random.default_rng([seed, 3])).astype(np.float64)
    rng = np.random.default_rng([seed, 4])
    rows = rng.normal(0, camera.noise.row_temporal_noise, (len(electrons), 1))
    offset = offsets * (rows + rng.normal(0, camera.noise.column_temporal_noise, electrons.shape[1]))
    gains = camera.gain * camera.channel_gains[camera.channel_map(electrons.shape)]
    return plain, np.clip(np.rint(plain + offset * gains), 0, 2**camera.bits - 1).astype(np.uint16), offset


def corrected(camera: CameraModel, values: Array, **settings: object) -> Array:
    frame = RawFrame("frame", values, camera.black_level, camera.white_level, **settings)  # type: ignore[arg-type]
    return without_picture_offsets(frame, camera).values.astype(np.float64)


def error_of_rows(camera: CameraModel, electrons: Array, offsets: float = 1.0, seed: int = 1) -> Array:
    """Error of each row after the correction, relative to the standard deviation of the row noise."""
    plain, values, _ = taken(camera, electrons, seed, offsets)
    return np.asarray((corrected(camera, values) - plain).mean(axis=1) / (camera.gain * camera.noise.row_temporal_noise))


@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("name", ["bayer", "fiveband"])
def test_offsets_are_found_to_the_predicted_accuracy(name: str, ratio: float) -> None:
    """In uniform areas, the error is at most as large as predicted, and not much smaller."""
    camera = camera_of(name, ratio)
    noise, signal = camera.noise, SIGNAL[name]
    variance = np.mean([error_of_rows(camera, np.full((ROWS, COLS), signal), seed=seed).var() for seed in range(3)])
    lines = noise.row_temporal_noise**2
    predicted = variance_left_by_picture(lines, camera.pixel_variance() + signal, 0.0, COLS) / lines
    assert 0.4 * predicted < variance < 1.1 * predicted
    assert predicted < camera.line_variances()[0] / camera.gain**2 / lines < 0.3  # the camera model includes the scene


def test_columns_are_corrected_as_rows_are(bayer: CameraModel) -> None:
    for row, column in ((0.0, 1.0), (1.0, 1.0)):
        camera = camera_of("bayer", row, column)
        plain, values, offset = taken(camera, np.full((ROWS, COLS), 120.0))
        error = (corrected(camera, values) - plain) / camera.gain
        assert error.mean(axis=0).var() < 0.1 * offset.mean(axis=0).var()
        assert error.mean(axis=1).var() < 0.1 * offset.mean(axis=1).var() + 0.01
    tall = dataclasses.replace(camera_of("bayer", 0.0, 1.0), rows=COLS, cols=ROWS)
    tall = dataclasses.replace(tall, cfa=camera.cfa.T.copy())
    wide = camera_of("bayer", 1.0)
    values = taken(wide, np.full((ROWS, COLS), 120.0))[1]
    across = corrected(tall, np.ascontiguousarray(values.T)).T
    assert np.abs(across - corrected(wide, values)).max() <= 1  # rounding differs


def test_frames_of_sensors_without_line_noise_are_unchanged() -> None:
    camera = camera_of("bayer")
    _, values, _ = taken(camera_of("bayer", 2.0), np.full((ROWS, COLS), 120.0))
    frame = RawFrame("frame", values, camera.black_level, camera.white_level)
    assert without_picture_offsets(frame, camera) is frame
    assert camera.corrected_noise() is camera.noise
    assert camera.as_corrected() is camera


def places() -> tuple[Array, Array]:
    return np.arange(ROWS)[:, None] + np.zeros((1, COLS)), np.arange(COLS) + np.zeros((ROWS, 1))


def scene_of(kind: str) -> Array:
    """Signal of a scene that could be mistaken for offsets, relative to its darkest or usual signal."""
    row, col = places()
    if kind == "chart":
        return np.where((col > 500) & (col < 1100), 1.0 + (row % 6 < 3), 1.0)
    if kind == "patches":  # of an evenly lit chart, with dark gaps, behind a lens
        level = np.random.default_rng(4).uniform(0.3, 2, (10, 3)).repeat(32, 0).repeat(512, 1)[:ROWS]
        return np.asarray(gaussian_filter1d(np.where(row % 32 < 2, 0.3, level), 0.8, axis=0))
    return {
        "uniform": row * 0 + 1,
        "horizon": np.where(row < 120, 4.0, 1.0),
        "faint horizon": np.where(row < 120, 1.2, 1.0),
        "blurred horizon": 2 - 1 / (1 + np.exp((120 - row) / 2)),
        "sky": 2 - 1.8 * row / ROWS,
        "waves": np.abs(np.sin(row / 40)) + 0.2,
        "shading": 1 - 0.2 * (((row - 150) / 150) ** 2 + ((col - 768) / 768) ** 2),
        "blinds": 1.0 + (row % 20 < 10),
        "faint blinds": 1 + 0.1 * (row % 20 < 10),
        "fainter blinds": 1 + 0.03 * (row % 10 < 5),
        "lines": 1 + 0.05 * (row % 2),
    }[kind]


KINDS = (
    "uniform", "horizon", "faint horizon", "blurred horizon", "sky", "waves", "shading", "blinds", "faint blinds",
    "fainter blinds", "lines", "chart", "patches",
)  # fmt: skip


@pytest.mark.parametrize("ratio", [0.5, 2.0])
@pytest.mark.parametrize("kind", KINDS)
def test_scenes_with_horizontal_structures_are_not_damaged(kind: str, ratio: float) -> None:
    """No row changes by more than three standard deviations of the row noise, and rows on average by hardly more than one.

    This holds with row noise and for frames whose row noise another program has already removed.
    """
    camera, electrons = camera_of("bayer", ratio), 120.0 * scene_of(kind)
    error, harm = error_of_rows(camera, electrons), error_of_rows(camera, electrons, offsets=0.0)
    assert np.abs(harm).max() <= 3.1
    assert harm.std() <= 1.2
    assert error.std() <= 1.2
    if kind in ("uniform", "horizon", "faint horizon", "blurred horizon", "sky", "shading", "chart"):
        assert harm.std() < 0.45
        assert error.std() < 0.6
    if kind == "patches":
        assert harm.std() < 0.6
        assert error.std() < 0.7


@pytest.mark.parametrize(("ratio", "largest"), [(0.5, 0.53), (2.0, 0.33)])
def test_blurred_edges_do_not_vote(ratio: float, largest: float) -> None:
    """Among objects with edges that a lens blurs, the offsets are about as accurate as training assumes."""
    rng, light = np.random.default_rng(6), np.ones((ROWS, COLS))
    for _ in range(4000):
        row, col, height, width = (rng.integers(*each) for each in ((-20, ROWS), (-40, COLS), (8, 40), (16, 80)))
        light[max(row, 0) : max(row + height, 0), max(col, 0) : max(col + width, 0)] = rng.uniform(0.2, 2.0)
    light = 120 * gaussian_filter(light, 0.8)
    camera = camera_of("bayer", ratio)
    assert np.mean([error_of_rows(camera, light, seed=seed).std() for seed in range(1, 4)]) < largest


def test_row_noise_stays_where_the_picture_does_not_show_it() -> None:
    """Empty, clipped and small frames are unchanged, and a narrow crop is not worse than without the correction."""
    camera = camera_of("bayer", 1.0)
    for level in (0, int(camera.white_level), 2**camera.bits - 1):
        values = np.full((60, 80), level, np.uint16)
        np.testing.assert_array_equal(corrected(camera, values), values)
    values = taken(camera, np.full((40, 48), 120.0))[1]
    np.testing.assert_array_equal(corrected(camera, values), values)
    for rows in (1, 2, 3):
        assert corrected(camera, values[:rows].repeat(2, axis=1)).shape == (rows, 96)
    row, col = places()
    texture = 120 * (1 + 0.5 * np.sin(row / 7) * np.sin(col / 5))
    assert error_of_rows(camera, texture[:200, :64]).std() < 0.8


def test_clipped_and_hot_pixels_do_not_vote() -> None:
    camera, rng = camera_of("bayer", 1.0), np.random.default_rng(1)
    plain, values, _ = taken(camera, np.full((ROWS, COLS), 120.0))
    spoilt = values.copy()
    spoilt[rng.random(values.shape) < 0.01] = 3000
    spoilt[:, 700:900] = int(camera.white_level)
    spoilt[:, 900:1400] = 0
    found = corrected(camera, spoilt)
    np.testing.assert_array_equal(found[:, 700:900], int(camera.white_level))
    same = spoilt == values
    error = ((found - plain) * same).sum(axis=1) / same.sum(axis=1) / (camera.gain * camera.noise.row_temporal_noise)
    assert error.std() < 0.35


def test_offsets_are_proportional_to_the_gain_of_each_channel() -> None:
    camera = camera_of("bayer", 2.0)
    readout = Readout(np.ones(3), np.array([1.0, 4.0, 2.0]), np.full(3, camera.noise.read_noise), np.arange(3))
    camera = dataclasses.replace(camera, readout=readout)
    plain, values, offset = taken(camera, np.full((ROWS, COLS), 120.0))
    error, channel = corrected(camera, values) - plain, camera.channel_map(values.shape)
    for number, gain in enumerate(readout.channel_gain):
        of_row = [np.mean(row[each == number]) for row, each in zip(error, channel, strict=True) if (each == number).any()]
        assert np.std(of_row) < 0.25 * gain * camera.gain * offset.std()
    quiet = camera.as_corrected()
    for number in range(3):
        terms = [each.noise_terms(channel=np.array([number]))[0] for each in (camera, quiet)]
        assert terms[0] == pytest.approx(terms[1])


def test_the_phase_and_the_gain_of_a_frame_are_used() -> None:
    camera = camera_of("fiveband", 1.0)
    plain, values, _ = taken(camera, np.full((ROWS, COLS), 264.0) * (1 + camera.channel_map((ROWS, COLS))))
    cut = (slice(3, None), slice(1, None))
    found = corrected(camera, np.ascontiguousarray(values[cut]), phase=(3, 1))
    assert (found - plain[cut]).mean(axis=1).std() < 0.3 * camera.gain * camera.noise.row_temporal_noise
    amplified = camera.at_gain(4.0)
    plain, values, _ = taken(amplified, np.full((ROWS, COLS), 66.0))
    found = corrected(camera, values, gain=4.0)
    assert (found - plain).mean(axis=1).std() < 0.3 * amplified.gain * camera.noise.row_temporal_noise


def test_a_second_correction_changes_little() -> None:
    """The offsets that remain in a corrected frame, or in a simulated frame, are not amplified."""
    camera = camera_of("bayer", 1.0)
    row, col = places()
    electrons = 120 * (1 + 0.15 * np.sin(row / 7) * np.sin(col / 5))
    plain, values, _ = taken(camera, electrons)
    once = corrected(camera, values)
    twice = corrected(camera, once.astype(np.uint16))
    assert (twice - plain).mean(axis=1).std() < 1.1 * (once - plain).mean(axis=1).std()
    simulated = expose(camera, electrons.astype(np.float32), 0.0, np.random.default_rng(2))
    again = corrected(camera, simulated)
    expected = electrons * camera.gain + camera.black_level
    assert (again - expected).mean(axis=1).std() < 1.1 * (simulated - expected).mean(axis=1).std()


def test_training_frames_have_the_noise_of_corrected_frames() -> None:
    camera = camera_of("bayer", 1.0, 0.5)
    light = np.full((ROWS, COLS), 120.0, np.float32)
    frames = np.array([expose(camera, light, 0.0, np.random.default_rng(seed)) for seed in range(6)], np.float64)
    pixels = (frames - frames.mean(axis=2, keepdims=True) - frames.mean(axis=1, keepdims=True)).var()
    found = frames.mean(axis=2).var(axis=1).mean() - pixels / COLS, frames.mean(axis=1).var(axis=1).mean() - pixels / ROWS
    assert found == pytest.approx(camera.line_variances(), rel=0.1)
    again = camera.as_corrected()
    assert again.corrected_noise() is again.noise
    assert again.line_variances() == camera.line_variances()
    assert again.noise_terms() == camera.noise_terms()


@pytest.mark.parametrize(("ratio", "signal"), [(0.0, 120.0), (1.0, 0.0), (1.0, 120.0), (2.0, 0.0), (2.0, 120.0)])
def test_the_temporal_filter_averages_the_remaining_row_noise(ratio: float, signal: float) -> None:
    """In a static scene, hardly more noise remains than without row noise, as the filter predicts. Motion is still found."""
    camera = dataclasses.replace(camera_of("bayer", ratio), rows=160, cols=512)
    require_noise(camera)
    light = signal * np.random.default_rng(3).uniform(0.5, 1.5, (8, 26)).repeat(20, 0).repeat(20, 1)[:, :512]
    filtered, before, after = ReferenceFilter(camera.cfa.shape, camera), [], []
    for number in range(10):
        values = corrected(camera, taken(camera, light, seed=number)[1])
        frame = RawFrame("frame", values.astype(np.uint16), camera.black_level, camera.white_level)
        made = filtered.filtered(frame).values
        if number >= 7:
            error = [each - light * camera.gain - camera.black_level for each in (values, made)]
            before.append(np.mean(error[0] ** 2))
            after.append(np.mean(error[1] ** 2))
    assert filtered.history is not None
    predicted, left = filtered.history.left.mean() / ONE, np.mean(after) / np.mean(before)
    assert predicted < 0.165
    assert left == pytest.approx(
        predicted + 1 / 12 / np.mean(before), abs=0.05
    )  # the filtered values are rounded to whole DN
    moved = taken(camera, np.roll(light, 1, axis=1) + 40.0, seed=20)[1]
    filtered.filtered(RawFrame("frame", corrected(camera, moved).astype(np.uint16), camera.black_level, camera.white_level))
    assert filtered.history.left.mean() / ONE > 0.6


def test_the_temporal_filter_requires_that_most_of_the_row_noise_is_removed() -> None:
    narrow = dataclasses.replace(camera_of("bayer", 1.0), cols=48)
    with pytest.raises(RecipeError, match="row and column noise"):
        require_noise(narrow)


def test_every_way_to_read_gives_the_same_frame(tmp_path: Path) -> None:
    """A picture, a stack, a headerless file and an array are corrected. Frames for a calibration are not."""
    camera = camera_of("bayer", 1.0, 0.5)
    values = taken(camera, np.full((ROWS, COLS), 120.0))[1]
    expected = corrected(camera, values)
    assert (expected != values).mean() > 0.5
    for frame in (raw_frame(values, camera), *read_in_every_way(values, camera, tmp_path)):
        np.testing.assert_array_equal(frame.values, expected)
        assert frame.notes == ()
    np.save(tmp_path / "dark.npy", values)
    for_calibration = FrameFiles((tmp_path / "dark.npy",), (ROWS, COLS), camera.bits, camera)
    np.testing.assert_array_equal(next(iter(for_calibration)), values)


def test_the_correction_does_not_depend_on_the_layout_in_memory() -> None:
    camera = camera_of("bayer", 1.0, 0.5)
    values = taken(camera, np.full((ROWS, COLS), 120.0))[1]
    expected = corrected(camera, values)
    np.testing.assert_array_equal(corrected(camera, values), expected)
    np.testing.assert_array_equal(corrected(camera, np.asfortranarray(values)), expected)
    np.testing.assert_array_equal(corrected(camera, values.repeat(2, axis=1)[:, ::2]), expected)
