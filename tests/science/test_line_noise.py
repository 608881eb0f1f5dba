"""Temporal noise of rows and columns: simulation, normal equations of all layers, and unsupported uses."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from l3cli.artifacts.camera import AnalogGains, CameraModel
from l3cli.artifacts.training_set import TrainingSet
from l3cli.calibration.figures import as_text, compare, figures
from l3cli.calibration.noise import DarkNoise, dark_noise, fixed_line_noise, line_noise, line_weights, response_noise
from l3cli.calibration.noise import LineNoise as NoiseOfLines
from l3cli.calibration.statistics import line_squares, mean_squares, measure_level, no_defects
from l3cli.classes.contrast import noise_of_grey, stored_edges
from l3cli.classes.direction import DirectionKeys
from l3cli.classes.features import ClassRecipe
from l3cli.classes.rule import make_rule
from l3cli.design.error import noise_of
from l3cli.errors import RecipeError
from l3cli.frames.measurement import Body, Capture
from l3cli.rendering.temporal.noise import require_noise
from l3cli.simulation import sensor
from l3cli.training.accumulate import sum_sites
from l3cli.training.layers.mosaics import Exposed, mosaics_of
from l3cli.training.lines import LineNoise, SharedNoise, line_pairs, split_noise
from l3cli.training.patches import expose_patches
from l3cli.training.recipe import LearningRecipe
from l3cli.training.symmetry import EVERY_ORIENTATION, LINES_KEPT
from l3cli.training.training_pass import LAST, TrainingPass
from tests.helpers.training_sets import a_frame

PATCH = 5


def with_lines(camera: CameraModel, row: float, column: float, fixed: float = 0.0, fixed_row: float = 0.0) -> CameraModel:
    """The camera with this noise of rows and columns in its frames, which are not corrected again."""
    noise = dataclasses.replace(
        camera.noise,
        row_temporal_noise=row,
        column_temporal_noise=column,
        column_noise=fixed,
        row_noise=fixed_row,
        dsnu=0.0,
        prnu=0.0,
    )
    return dataclasses.replace(camera, noise=noise, lines_corrected=True)


@pytest.fixture
def lined(bayer: CameraModel) -> CameraModel:
    return with_lines(bayer, 8.0, 5.0)


def dark_frames(camera: CameraModel, count: int) -> np.ndarray:
    """Frames without light, in electrons, of the whole sensor."""
    dark = np.zeros((camera.rows, camera.cols), np.float32)
    frames = [sensor.expose(camera, dark, 0.0, np.random.default_rng([3, seed])) for seed in range(count)]
    return (np.array(frames, np.float64) - camera.black_level) / camera.gain


def line_covariances(values: np.ndarray) -> tuple[float, float]:
    """Mean product of different values (…, row, col) in one row, and in one column."""

    def within(sums: np.ndarray, count: int) -> float:
        return float((sums**2).mean() - (values**2).mean() * count) / (count * (count - 1))

    rows, cols = values.shape[-2:]
    return within(values.sum(axis=-1), cols), within(values.sum(axis=-2), rows)


def test_each_line_of_a_frame_gets_one_offset(lined: CameraModel) -> None:
    frames = dark_frames(lined, 30)
    row, column = line_covariances(frames)
    assert row == pytest.approx(64, rel=0.05)
    assert column == pytest.approx(25, rel=0.05)
    assert frames.var() == pytest.approx(16 + 64 + 25 + 1 / 12 / lined.gain**2, rel=0.03)
    assert frames.mean(axis=0).std() < 3  # drawn anew in each frame
    np.testing.assert_array_equal(dark_frames(lined, 1)[0], frames[0])
    constant = lined.noise_terms()[0]
    assert constant == pytest.approx(lined.gain**2 * frames.var(), rel=0.03)
    assert lined.line_variances() == pytest.approx((lined.gain**2 * 64, lined.gain**2 * 25))


def test_without_line_noise_the_other_random_numbers_stay(bayer: CameraModel) -> None:
    """What line noise adds comes last, so that a frame without it is what it was."""
    light = np.full((8, 8), 100.0, np.float32)
    plain, lined = (
        sensor.expose(camera, light, 0.0, np.random.default_rng(1)).astype(float)
        for camera in (with_lines(bayer, 0, 0), with_lines(bayer, 0, 40))
    )
    assert np.ptp(lined - plain, axis=0).max() <= 1.0


def pass_of(camera: CameraModel, **recipe: Any) -> TrainingPass:
    rule = make_rule(ClassRecipe(patch=PATCH, levels=2), camera, np.zeros(8, np.uint16))
    head = TrainingSet(camera=camera, outputs=("X", "Y", "Z"), target_description="")
    learning = LearningRecipe(patches=4000, draws=1, darkest=0.003, brightest=0.3, **recipe)
    return TrainingPass(head, (4000,), rule, learning, np.ones(3), 1, LAST)


def test_the_first_layer_carries_the_covariance_of_simulated_frames(lined: CameraModel) -> None:
    """Frames of the simulated sensor, in which windows are cut out, are the truth."""
    pass_ = pass_of(lined)
    sums = sum_sites(pass_, [(0, (1,), iter([a_frame(lined, 1, smooth=False)]))], {1: None})[1]
    kept = sums.count > 100
    _, shared = split_noise(sums.noise, PATCH**2)
    assert shared is not None
    width = PATCH**2 + 1 + 3
    intercept = np.flatnonzero(np.equal(*np.triu_indices(width)))[PATCH**2]  # the sum of the squared weights
    unclipped = shared[kept] / sums.moments[kept][:, intercept, None, None]
    values = dark_frames(lined, 200) * lined.gain / (lined.white_level - lined.black_level)
    windows = np.lib.stride_tricks.sliding_window_view(values, (PATCH, PATCH), axis=(1, 2))[:, ::PATCH, ::PATCH]
    row, column = line_covariances(windows)
    pairs = line_pairs(PATCH)
    found = unclipped[:, pairs.first, pairs.second]
    assert found[:, pairs.is_row] == pytest.approx(row, rel=0.02)
    assert found[:, ~pairs.is_row] == pytest.approx(column, rel=0.02)
    apart = np.ones((PATCH**2, PATCH**2), bool)
    apart[pairs.first, pairs.second] = apart[pairs.second, pairs.first] = False
    assert not unclipped[:, apart].any()


def test_clipped_taps_share_no_noise(lined: CameraModel) -> None:
    """And patches that contain noise already lack only a part of it."""
    lines = LineNoise.of(lined)
    assert lines is not None
    shares = np.ones((1, PATCH**2), np.float32)
    shares[0, 0] = 0
    noise = np.concatenate([np.zeros(PATCH**2), SharedNoise(lines, shares).covariances()])
    _, shared = split_noise(noise[None], PATCH**2)
    assert shared is not None
    assert not shared[0, 0].any()
    assert shared[0, 1, 2] == pytest.approx(lines.rows)
    assert shared[0, 1, 1 + PATCH] == pytest.approx(lines.columns)
    lacking = np.array([0.0, 0.25])
    offsets = lines.drawn_for_taps(np.arange(PATCH**2), PATCH, lacking, np.random.default_rng(1))
    assert not offsets.values[:, 0].any()
    assert offsets.variance[0].tolist() == pytest.approx([0, 0.25 * lines.total])


def test_propagated_noise_is_that_of_the_full_covariance(lined: CameraModel) -> None:
    lines, rng = LineNoise.of(lined), np.random.default_rng(2)
    assert lines is not None
    weights, shares = (rng.normal(size=shape).astype(np.float32) for shape in ((PATCH**2, 3), (4, PATCH**2)))
    row, col = np.divmod(np.arange(PATCH**2), PATCH)
    same = lines.rows * (row[:, None] == row) + lines.columns * (col[:, None] == col)
    np.fill_diagonal(same, 0)
    expected = [[(weights[:, p] * s) @ same @ (weights[:, q] * s) for p, q in ((0, 0), (1, 2))] for s in shares]
    found = SharedNoise(lines, shares).propagated(weights, ((0, 0), (1, 2)))
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("noise", ["sampled", "none"])
def test_noise_that_is_not_analytic_leaves_no_covariance(lined: CameraModel, noise: str) -> None:
    sums = sum_sites(pass_of(lined, noise=noise), [(0, (1,), iter([a_frame(lined, 1, smooth=True)]))], {1: None})[1]
    assert not sums.noise.any()


def test_sampled_noise_has_the_covariance_of_the_analytic(lined: CameraModel) -> None:
    """Moments with drawn noise are, but for chance, moments without noise plus the covariances."""
    frame = a_frame(lined, 1, smooth=True)
    dark = dataclasses.replace(frame, electrons=frame.electrons * 0)
    recipe = {"rescale": False, "level_power": 0.0, "brightness_power": 0.0}
    analytic, sampled = (
        sum_sites(pass_of(lined, noise=noise, **recipe), [(0, (1,), iter([dark]))], {1: None})[1]
        for noise in ("analytic", "sampled")
    )
    width, pairs = PATCH**2 + 4, line_pairs(PATCH)
    place = np.zeros((width, width), int)
    place[np.triu_indices(width)] = np.arange(width * (width + 1) // 2)
    found = (sampled.moments - analytic.moments).sum(axis=0)[place[pairs.first, pairs.second]]
    expected = analytic.noise.sum(axis=0)[PATCH**2 :]
    for which in (pairs.is_row, ~pairs.is_row):
        assert found[which].mean() == pytest.approx(expected[which].mean(), rel=0.05)


def test_mosaics_of_later_layers_have_the_covariance_of_simulated_frames(lined: CameraModel) -> None:
    frame = a_frame(lined, 1, smooth=True, size=(96, 96))
    exposed = Exposed(lined, LearningRecipe(darkest=0.003, brightest=0.3), 0.0, 0.0, noisy=True, inner=40, margin=4)
    noise = []
    for mosaic in mosaics_of(frame, 400, exposed, np.random.default_rng(1)):
        assert mosaic.clean is not None
        noise.append((mosaic.values - mosaic.clean) / lined.gain)
    row, column = line_covariances(np.array(noise))
    assert row == pytest.approx(64, rel=0.02)
    assert column == pytest.approx(25, rel=0.02)


def test_class_edges_are_what_such_noise_reaches(lined: CameraModel) -> None:
    """Contrast is measured from the mean of a channel, which line noise moves, too."""
    values, channel = dark_frames(lined, 40)[:, :90, :90] * lined.gain, lined.channel_map((90, 90))[:9, :9]
    windows = np.lib.stride_tricks.sliding_window_view(values, (9, 9), axis=(1, 2))[:, ::10, ::10].reshape(-1, 9, 9)
    seen = np.mean([windows[:, channel == each].var(axis=1).mean() for each in range(3)])
    recipe = ClassRecipe(patch=9, contrasts=(1.0,))
    edge = stored_edges(recipe, np.zeros(1), lined, 0, 0.0)[0, 0] / 512 / 3 - 1 / 3
    assert edge == pytest.approx(seen, rel=0.05)
    assert edge < 0.92 * noise_of_grey(np.zeros(1), lined, 0.0)[0]
    rule = make_rule(
        ClassRecipe(patch=9, levels=2, direction=DirectionKeys(strengths=(3.0,))), lined, np.zeros(8, np.uint16)
    )
    counts = np.zeros((4, 9, 9))
    for window in rule.feature_list[0].windows:
        counts[window.sum, window.top : window.top + window.rows, window.left : window.left + window.columns] += window.sign
    head = rule.feature_list[0].constants
    sums = np.abs(np.einsum("nrc,src->ns", windows, counts)) * head[[0, 1, 0, 1]]
    assert (sums > head[5]).any(axis=1).mean() < 0.02  # hardly any direction where there is only noise


def test_transposed_sites_are_trained_together_if_rows_and_columns_have_equal_noise(bayer: CameraModel) -> None:
    recipe = LearningRecipe()
    assert recipe.orientations(with_lines(bayer, 5, 5)) == EVERY_ORIENTATION
    assert recipe.orientations(with_lines(bayer, 5, 4, 3)) == EVERY_ORIENTATION
    assert recipe.orientations(with_lines(bayer, 0, 0, 3, 3)) == EVERY_ORIENTATION
    assert recipe.orientations(with_lines(bayer, 0.9, 0)) == EVERY_ORIENTATION  # far below the noise of the pixels
    for camera in (
        with_lines(bayer, 5, 0),
        with_lines(bayer, 0, 0, 3),
        with_lines(bayer, 5, 5, 2),
        with_lines(bayer, 0, 0, 0, 3),
    ):
        assert recipe.orientations(camera) == LINES_KEPT


def test_noise_of_lines_follows_the_read_noise_over_gains(lined: CameraModel) -> None:
    camera = dataclasses.replace(lined, gains=AnalogGains(np.array([4.0]), np.array([2.0]), 100.0))
    there = camera.at_gain(4.0)
    assert (there.noise.read_noise, there.noise.row_temporal_noise) == (2.0, 4.0)
    assert lined.at_gain(4.0).noise == lined.noise
    left = dataclasses.replace(lined, noise_left=0.25)
    assert left.line_variances() == pytest.approx([each / 4 for each in lined.line_variances()])


def test_a_design_has_the_line_noise_of_its_camera(lined: CameraModel) -> None:
    noise = noise_of(lined)
    assert (noise.rows, noise.columns) == pytest.approx((64, 25))
    assert noise.floor == pytest.approx(lined.noise_terms()[0] / lined.gain**2)


def test_what_does_not_serve_shared_noise_refuses_it(lined: CameraModel, bayer: CameraModel) -> None:
    with pytest.raises(RecipeError):
        require_noise(lined)
    assert require_noise(with_lines(bayer, 0, 0, 3)).noise.column_noise == 3
    with pytest.raises(ValueError, match="offsets"):
        expose_patches(np.zeros((2, 2), np.float32), lined, np.random.default_rng(1))


def captures_of(camera: CameraModel, seed: int, offsets: np.ndarray | float = 0.0) -> list[Capture]:
    """Dark captures of four exposure times with four frames each. `offsets` is a fixed pattern in electrons."""
    light = np.maximum(np.zeros((camera.rows, camera.cols), np.float32) + offsets, 0)
    quiet = dataclasses.replace(camera, noise=dataclasses.replace(camera.noise, dsnu=1.0))
    return [
        Capture(f"{t}", t, [sensor.expose(quiet, light, t, np.random.default_rng([seed, at, n])) for n in range(4)])
        for at, t in enumerate((0.01, 0.5, 1.0, 2.0))
    ]


def body_of(camera: CameraModel) -> Body:
    b = camera
    return Body(b.name, b.rows, b.cols, b.pixel_pitch, b.bits, b.channels, b.cfa, b.optics)


@pytest.mark.parametrize(("row", "column"), [(2.0, 0.0), (0.0, 3.0), (4.0, 1.5)])
def test_dark_frames_give_the_noise_of_rows_and_columns(bayer: CameraModel, row: float, column: float) -> None:
    """Beside read noise, fixed offsets of columns and dark current, and within its uncertainty."""
    camera = with_lines(bayer, row, column, fixed=3.0)
    dark = dark_noise(captures_of(camera, 1), body_of(camera))
    for found, true in ((dark.rows, row), (dark.columns, column)):
        assert found.deviation / camera.gain == pytest.approx(true, rel=0.1)
        assert abs(found.deviation / camera.gain - true) <= 3 * found.error / camera.gain
        assert (found.error > 0) == (true > 0)
    assert dark.pixel_variance is not None
    assert np.sqrt(dark.pixel_variance) / camera.gain == pytest.approx(4.0, rel=0.03)


@pytest.mark.parametrize(("row", "column", "temporal"), [(2.0, 0.0, 0.0), (0.0, 3.0, 0.0), (2.0, 3.0, 4.0), (0.0, 0.0, 8.0)])
def test_dark_frames_give_the_fixed_offsets_of_rows_and_columns(
    bayer: CameraModel, row: float, column: float, temporal: float
) -> None:
    """Temporal noise of lines that is left in the mean of the frames is neither fixed noise of lines nor DSNU."""
    camera = with_lines(bayer, temporal, temporal, column, row)
    pattern = sensor.fixed_pattern(camera).dsnu
    dark = dark_noise(captures_of(camera, 1), body_of(camera))
    for found, true, own in (
        (dark.fixed_rows, row, pattern.mean(axis=1)),
        (dark.fixed_columns, column, pattern.mean(axis=0)),
    ):
        assert found.deviation / camera.gain == pytest.approx(own.std() if true else 0.0, abs=0.15 if temporal else 0.05)
        assert abs(found.deviation / camera.gain - true) <= 3 * found.error / camera.gain
        assert (found.error > 0) == (true > 0)
    assert dark.dsnu_error is not None
    assert np.mean(dark.dsnu) / camera.gain == pytest.approx(1.0, abs=0.05)
    assert (np.abs(dark.dsnu / camera.gain - 1.0) < 4 * dark.dsnu_error / camera.gain).all()


def white_captures(rows: float, columns: float, temporal: float) -> list[Capture]:
    """White captures of four exposure times with eight frames each, uneven light, and a PRNU of 1 % of the pixels."""
    rng = np.random.default_rng(5)
    shape = (192, 256)
    response = 1 + rng.normal(0, 0.01, shape) + rng.normal(0, rows, (192, 1)) + rng.normal(0, columns, 256)
    y, x = np.linspace(-1, 1, 192), np.linspace(-1, 1, 256)
    light = 12000.0 * (1 - (y[:, None] ** 2 + x**2) / 6) * response

    def frame(exposure: float) -> np.ndarray:
        offsets = rng.normal(0, temporal, (192, 1))
        return np.rint(rng.normal(light * exposure, np.sqrt(light * exposure)) * 0.25 + 64 + offsets).astype(np.uint16)

    return [Capture(f"{t}", t, [frame(t) for _ in range(8)]) for t in (0.1, 0.25, 0.4, 0.55)]


@pytest.mark.parametrize(
    ("rows", "columns", "temporal"), [(0.0, 0.0, 0.0), (0.0, 0.0, 30.0), (0.004, 0.0, 0.0), (0.003, 0.006, 3.0)]
)
def test_white_frames_give_the_response_of_rows_and_columns(
    bayer: CameraModel, rows: float, columns: float, temporal: float
) -> None:
    captures, body = white_captures(rows, columns, temporal), body_of(dataclasses.replace(bayer, rows=192, cols=256))
    levels = [measure_level(capture, body, no_defects()) for capture in captures]
    zero = np.zeros(3)
    dark = DarkNoise(np.full(3, 64.0), zero, zero, zero, rows=NoiseOfLines(temporal, 0.0))
    found = response_noise(captures, levels, np.ones((4, 3), bool), body, dark)
    for line, true in ((found.rows, rows), (found.columns, columns)):
        assert line.deviation == pytest.approx(true, rel=0.15)
        assert abs(line.deviation - true) <= 3 * line.error
    total = np.sqrt(0.01**2 + rows**2 + columns**2)
    assert found.prnu == pytest.approx(total, rel=0.04)
    assert (np.abs(found.prnu - total) < 4 * found.prnu_error).all()


def test_rows_and_columns_of_a_sensor_differ_in_response(bayer: CameraModel) -> None:
    """The response of each line is the same in every frame, and the pixels of a camera without it stay as they are."""
    noise = dataclasses.replace(bayer.noise, row_prnu=0.02, column_prnu=0.03)
    plain, lined = (sensor.fixed_pattern(c).prnu for c in (bayer, dataclasses.replace(bayer, noise=noise)))
    lines = (lined - plain).astype(np.float64)
    rows, columns = lines.mean(axis=1, keepdims=True), lines.mean(axis=0)
    np.testing.assert_allclose(lines, rows + columns - lines.mean(), atol=1e-6)
    assert rows.std() == pytest.approx(0.02, rel=0.15)
    assert columns.std() == pytest.approx(0.03, rel=0.15)
    camera = dataclasses.replace(bayer, noise=dataclasses.replace(noise, dsnu=0.0))
    light = np.full((bayer.rows, bayer.cols), 2000.0, np.float32)
    signal = sensor.expose(camera, light, 0.0, np.random.default_rng(1)) - bayer.black_level
    assert signal.var() == pytest.approx(float(camera.noise_variance(signal.mean())), rel=0.05)
    assert signal.var() > 1.5 * float(bayer.noise_variance(signal.mean()))


def test_noise_of_lines_that_was_not_found_is_compared_too(bayer: CameraModel) -> None:
    """Noise that only the true camera has is missing from the results, and noise that only the results have is false."""
    true = with_lines(bayer, 4.0, 0.0)
    true = dataclasses.replace(true, noise=dataclasses.replace(true.noise, row_prnu=0.01))
    result = figures(with_lines(bayer, 0.0, 3.0))
    result["truth"] = compare(with_lines(bayer, 0.0, 3.0), true)
    known = result["truth"]["camera"]
    missed = {"recovered": 0.0, "true": 4.0, "unit": "e-", "error %": -100.0}
    assert known["row temporal noise"] == missed
    assert known["row PRNU"] == missed | {"true": 1.0, "unit": "%"}
    assert known["column temporal noise"] == missed | {"recovered": 3.0, "true": 0.0, "error %": None}
    lines = {line[:24].strip(): line.split() for line in as_text(result)}
    assert lines["row temporal noise"][3:] == ["0", "e-", "true", "4", "error", "-100.00", "%"]


def test_no_line_noise_is_found_where_there_is_none(bayer: CameraModel) -> None:
    """In at most one of twenty sets of three exposure times."""
    body, rng = body_of(dataclasses.replace(bayer, rows=48, cols=64)), np.random.default_rng(1)
    found = 0
    for _ in range(300):
        squares = [
            mean_squares([line_squares(np.rint(rng.normal(0, deviation, (48, 64))), body)], body) for deviation in (2, 3, 5)
        ]
        rows = line_noise([(each.rows, each.pixels, each.row_freedom) for each in squares], 64)
        columns = line_noise([(each.columns, each.pixels, each.column_freedom) for each in squares], 48)
        found += rows.deviation > 0 or columns.deviation > 0
    assert found <= 15


def test_no_fixed_offsets_are_found_where_there_are_none(bayer: CameraModel) -> None:
    """At most one of twenty sets of dark frames gives an offset, also if the rows have temporal noise."""
    body, rng = body_of(dataclasses.replace(bayer, rows=48, cols=64)), np.random.default_rng(1)
    weights = line_weights(np.array([0.1, 1.0, 2.0]))[0]
    found = 0
    for trial in range(150):
        noise = rng.normal(0, 2, (3, 4, 48, 64)) + rng.normal(0, 2.0 * (trial % 2), (3, 4, 48, 1))
        frames = np.rint(64 + rng.normal(0, 1, (48, 64)) + noise)  # three exposure times with four frames each
        pairs = [[line_squares(one[0] - one[1], body) / 2, line_squares(one[2] - one[3], body) / 2] for one in frames]
        squares = [mean_squares(each, body) for each in pairs]
        mean = mean_squares([line_squares(np.tensordot(weights, frames.mean(axis=1), 1), body)], body)
        rows, columns = (
            fixed_line_noise(lines(mean), [lines(each) for each in squares], weights**2 / 4, pixels)
            for lines, pixels in (
                (lambda each: (each.rows, each.pixels, each.row_freedom), 64),
                (lambda each: (each.columns, each.pixels, each.column_freedom), 48),
            )
        )
        found += rows.deviation > 0 or columns.deviation > 0
    assert found <= 7


def test_read_noise_is_what_pixels_do_not_share(bayer: CameraModel) -> None:
    """Also if it is far weaker than the noise of rows and columns."""
    camera = with_lines(bayer, 16.0, 16.0)
    dark = dark_noise(captures_of(camera, 2), body_of(camera))
    assert dark.pixel_variance is not None
    assert np.sqrt(dark.pixel_variance) / camera.gain == pytest.approx(4.0, rel=0.03)


def test_row_noise_is_no_wrong_exposure_time(bayer: CameraModel) -> None:
    """Strong row noise moves the means of dark frames, which must not be taken for contradicting captures."""
    camera = with_lines(dataclasses.replace(bayer, rows=64, cols=96), 40.0, 0.0)
    for seed in range(5):
        dark = dark_noise(captures_of(camera, seed), body_of(camera))
        assert dark.rows.deviation / camera.gain == pytest.approx(40, rel=0.2)
