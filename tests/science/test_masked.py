"""Masked pixels: the offsets of rows and columns that they show are subtracted, and the noise that remains is known."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from l3cli.api import raw_frame
from l3cli.artifacts.camera import CameraModel, MaskedPixels
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.store import load, save
from l3cli.design.recipe import camera_texts
from l3cli.errors import RecipeError
from l3cli.frames.frame import RawFrame
from l3cli.frames.masked import line_offsets
from l3cli.io.frames import FrameFiles
from l3cli.io.raw.files import RawOverrides, frame_of, read_raw
from l3cli.rendering.temporal.noise import require_noise
from l3cli.rendering.temporal.reference import ReferenceFilter
from l3cli.simulation.sensor import FixedPattern, expose, fixed_pattern, read_out, with_masked
from tests.helpers.cameras import bayer_camera
from tests.helpers.dng_files import LONG, write_dng
from tests.helpers.raw_files import read_in_every_way

SIDES = MaskedPixels(left=12, right=4, top=6, bottom=10)


def with_noise(camera: CameraModel, masked: MaskedPixels | None = SIDES, **noise: float) -> CameraModel:
    """The camera with row noise of twice its read noise, and with masked pixels."""
    changed = dataclasses.replace(camera.noise, **{"row_temporal_noise": 8.0, "prnu": 0.0, "dsnu": 0.0} | noise)
    return dataclasses.replace(camera, noise=changed, masked=masked)


def whole_frame(camera: CameraModel, seed: int, light: float = 100.0) -> np.ndarray:
    """A frame with its masked pixels."""
    electrons = np.full((camera.rows, camera.cols), light, np.float32)
    pattern, surrounded = with_masked(camera, fixed_pattern(camera), electrons)
    return read_out(camera, pattern, surrounded, 0.0, np.random.default_rng([seed, 5]))


def line_variances(frames: np.ndarray) -> tuple[float, float]:
    """Variances of the offsets of rows and of columns in frames without a fixed pattern."""
    rows, cols = frames.shape[1:]
    pixels = (frames - frames.mean(axis=2, keepdims=True) - frames.mean(axis=1, keepdims=True)).var()
    return frames.mean(axis=2).var(axis=1).mean() - pixels / cols, frames.mean(axis=1).var(axis=1).mean() - pixels / rows


@pytest.mark.parametrize("column", [0.0, 6.0])
def test_what_remains_of_the_offsets_is_what_the_camera_model_states(bayer: CameraModel, column: float) -> None:
    camera = with_noise(bayer, column_temporal_noise=column)
    frames = np.array(
        [frame_of("one", {"values": whole_frame(camera, seed)}, camera, RawOverrides()).values for seed in range(40)]
    )
    assert frames.shape[1:] == (camera.rows, camera.cols)
    row, columns = line_variances(frames.astype(np.float64))
    left = camera.line_variances()
    assert row == pytest.approx(left[0], rel=0.06)
    assert columns == pytest.approx(left[1], rel=0.06, abs=0.002)
    assert left[0] < 0.02 * 64 * camera.gain**2  # 16 masked pixels: 98.4 % of the variance of the rows is removed
    signal = 100 * camera.gain
    assert frames.var() == pytest.approx(camera.noise_variance(np.array(signal)), rel=0.02)
    assert frames.mean() == pytest.approx(camera.black_level + signal, abs=0.05)


def test_training_frames_have_the_noise_of_corrected_frames(bayer: CameraModel) -> None:
    camera = with_noise(bayer, dsnu=2.0)
    light = np.full((camera.rows, camera.cols), 100.0, np.float32)
    frames = np.array([expose(camera, light, 0.0, np.random.default_rng(seed)) for seed in range(20)], np.float64)
    row, _ = line_variances(frames - frames.mean(axis=0))
    assert row * 20 / 19 == pytest.approx(camera.line_variances()[0], rel=0.06)


def test_hot_masked_pixels_and_columns_do_not_shift_rows() -> None:
    rng = np.random.default_rng(1)
    offsets, values = rng.normal(0, 2, 400), rng.normal(0, 1, (400, 16))
    values += offsets[:, None]
    plain = line_offsets(values, 2, 4.0, 1.0)
    values[7, 3] += 2000.0
    values[:, 5] += 300.0
    spoilt = line_offsets(values, 2, 4.0, 1.0)
    assert np.abs(spoilt - plain).max() < 0.5
    assert np.var(plain - offsets) == pytest.approx(4 / 65, rel=0.2)


def test_few_masked_pixels_are_trusted_less(bayer: CameraModel) -> None:
    """One masked pixel shows less than it would add: the noise is never higher than without it."""
    weak = with_noise(bayer, MaskedPixels(left=1), row_temporal_noise=1.0)
    row = weak.line_variances()[0]
    pixel = 16 + 1 / 12 / weak.gain**2
    assert row == pytest.approx(weak.gain**2 * pixel / (1 + pixel))


def test_frames_without_masked_pixels_stay_and_are_warned_of(bayer: CameraModel) -> None:
    camera, values = with_noise(bayer), np.full((192, 256), 90, np.uint16)
    frame = frame_of("one", {"values": values}, camera, RawOverrides())
    np.testing.assert_array_equal(frame.values, values)
    assert len(frame.notes) == 1
    assert "masked pixels" in frame.notes[0]
    for each in (camera, dataclasses.replace(camera, masked=None)):  # noise that training assumes, and that remains here
        assert f"{each.offset_noise:.2g} e-" in frame.notes[0]
    quiet = with_noise(bayer, row_temporal_noise=0.0)
    assert not frame_of("one", {"values": values}, quiet, RawOverrides()).notes


def test_masked_pixels_change_nothing_without_line_noise(bayer: CameraModel) -> None:
    quiet = with_noise(bayer, row_temporal_noise=0.0)
    values = whole_frame(quiet, 1)
    np.testing.assert_array_equal(raw_frame(values, quiet).values, values[6:-10, 12:-4])
    assert quiet.corrected_noise() == quiet.noise


def test_clipped_pixels_stay_clipped(bayer: CameraModel) -> None:
    camera = with_noise(bayer)
    values = whole_frame(camera, 2, light=1e5)
    values[6:-10, 12:-4] = int(camera.white_level)
    assert (raw_frame(values, camera).values == int(camera.white_level)).all()


def test_every_way_to_read_gives_the_same_frame(bayer: CameraModel, tmp_path: Path) -> None:
    """A picture, a stack, a headerless file, an array, and a DNG that states its masked areas."""
    camera = with_noise(bayer, MaskedPixels(left=8, top=4), column_temporal_noise=4.0)
    values = whole_frame(camera, 3)
    expected = raw_frame(values, camera)
    pattern = np.array([[0, 1], [1, 2]])
    areas = {50829: (LONG, [4, 8, 196, 264]), 50830: (LONG, [0, 8, 4, 264, 4, 0, 196, 8]), 50717: (LONG, [3814])}
    dng = write_dng(tmp_path / "one.dng", values, pattern, tags=areas)
    levels = RawOverrides(white_level=expected.white_level)
    for frame in (
        *read_in_every_way(values, camera, tmp_path),
        read_raw(dng, camera, levels),
        read_raw(dng, dataclasses.replace(camera, masked=None), levels),
    ):
        np.testing.assert_array_equal(frame.values, expected.values)
        assert (frame.phase, frame.notes) == ((0, 0), ())


def test_damaged_masked_areas_are_not_used(bayer: CameraModel, tmp_path: Path) -> None:
    camera = with_noise(bayer, None)
    values = whole_frame(with_noise(bayer, MaskedPixels(left=8)), 3)
    for areas in ([0, 0, 192], [0, 0, 192, 9], [0, 0, 193, 8], [0, 8, 192, 8]):
        tags = {50829: (LONG, [0, 8, 192, 264]), 50830: (LONG, areas)}
        dng = write_dng(tmp_path / "one.dng", values, np.array([[0, 1], [1, 2]]), tags=tags)
        frame = read_raw(dng, camera, RawOverrides(white_level=camera.white_level))
        np.testing.assert_array_equal(frame.values, raw_frame(values[:, 8:], camera).values)
        assert len(frame.notes) == 1
        assert "MaskedAreas" in frame.notes[0]


def test_calibration_cuts_masked_pixels_off(bayer: CameraModel, tmp_path: Path) -> None:
    camera = with_noise(bayer)
    values = whole_frame(camera, 4)
    np.save(tmp_path / "one.npy", values)
    files = FrameFiles((tmp_path / "one.npy",), (camera.rows, camera.cols), camera.bits, camera, camera.masked)
    np.testing.assert_array_equal(next(iter(files)), values[6:-10, 12:-4])


def test_masked_pixels_come_back_from_recipes_and_artifacts(bayer: CameraModel, tmp_path: Path) -> None:
    camera = with_noise(bayer)
    for name, text in camera_texts(camera, "a test").items():
        (tmp_path / name).write_text(text)
    assert load_camera(tmp_path / "camera.toml").masked == SIDES
    save(camera, tmp_path / "camera.h5")
    assert load(CameraModel, tmp_path / "camera.h5").masked == SIDES


def test_frames_that_masked_pixels_corrected_can_be_filtered_in_time(bayer: CameraModel) -> None:
    """The row noise that 16 masked pixels leave is hardly taken for motion."""
    rows, cols = 96, 128
    left = []
    for row, masked in ((0.0, None), (8.0, MaskedPixels(left=16))):
        camera = dataclasses.replace(with_noise(bayer, masked, row_temporal_noise=row), rows=rows, cols=cols)
        filtered, light = ReferenceFilter((2, 2), require_noise(camera)), np.full((rows, cols), 300.0, np.float32)
        for seed in range(11):
            raw = expose(camera, light, 0.0, np.random.default_rng([seed, 3]))
            frame = filtered.filtered(RawFrame("frame", raw, camera.black_level, camera.white_level))
        left.append(frame.values.var() / raw.var())
    assert left[0] < 0.14
    assert left[1] == pytest.approx(left[0], rel=0.25)
    with pytest.raises(RecipeError):
        require_noise(with_noise(bayer, MaskedPixels(left=2)))


@pytest.mark.parametrize("section", ["[masked]\n", "[masked]\nleft = 4\n[channel.g]\ngain = 4.0\n"])
def test_impossible_masked_pixels_are_refused(tmp_path: Path, section: str) -> None:
    (tmp_path / "camera.toml").write_text(bayer_camera() + section)
    with pytest.raises(RecipeError, match="masked"):
        load_camera(tmp_path / "camera.toml")


def test_the_lab_surrounds_frames_with_masked_pixels(bayer: CameraModel) -> None:
    camera = with_noise(bayer, dsnu=2.0, column_noise=20.0, row_temporal_noise=0.0)
    pattern = fixed_pattern(camera)
    light = np.full((camera.rows, camera.cols), 500.0, np.float32)
    around, surrounded = with_masked(camera, pattern, light)
    assert surrounded.shape == around.dsnu.shape == (208, 272)
    assert not surrounded[:, :12].any()
    assert (surrounded[6:-10, 12:-4] == 500).all()
    np.testing.assert_allclose(around.dsnu[:6, 12:-4].mean(axis=0), pattern.dsnu.mean(axis=0), atol=5.0)
    plain = dataclasses.replace(camera, masked=None)
    same: tuple[FixedPattern, np.ndarray] = with_masked(plain, pattern, light)
    assert same[0] is pattern
    assert same[1] is light
