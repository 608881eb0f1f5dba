"""The polarisers of single pixels are measured behind a rotating polariser, and corrected in frames."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import asdict
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel, PolariserField
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.store import load, save
from l3cli.calibration.figures import pixel_angle_deviation
from l3cli.calibration.model import calibrate
from l3cli.calibration.pixel_polarisers import without_noise
from l3cli.frames.correction import correction_of
from l3cli.frames.frame import RawFrame
from l3cli.frames.measurement import Body, Capture, Measurements, PolariserCapture, Rotator
from l3cli.frames.super_pixels import FRACTION, plan_super_pixels, super_pixels
from l3cli.physics.stokes import angle_difference, aolp, dolp
from l3cli.recipes.builtin import find_recipe
from l3cli.simulation.lab import DarkRecipe, LabCapture, LabRecipe, PolariserRecipe, plan, take
from l3cli.simulation.sensor import DefectRecipe, SensorDefects, defects_of, fixed_pattern

Array = NDArray[np.float64]
DEGREE, ANGLE = 0.3, 25.0  # polarisation of the test light, in degrees
FRAMES = 64  # number of averaged frames of the test light


@pytest.fixture(scope="module", params=["polarised", "polarised_colour"])
def camera(request: pytest.FixtureRequest) -> CameraModel:
    return replace(load_camera(find_recipe(request.param, "cameras")), rows=96, cols=144)


def with_deviations(camera: CameraModel, scale: float) -> tuple[CameraModel, Array]:
    """A camera whose pixels have known random deviations (row, col, stokes)."""
    random = np.random.default_rng(3).normal(size=(camera.rows, camera.cols, 3)) * scale
    field = PolariserField(np.rint(random * 2**FRACTION).astype(np.int16))
    return replace(camera, polariser_field=field), field.response_deviation / 2.0**FRACTION


def stokes_of_super_pixels(camera: CameraModel, signals: Array) -> Array:
    """Least-squares Stokes parameters (3, super-pixel) for the nominal polarisers, from signals (row, col)."""
    response, gain = camera.relative_stokes_response, camera.signal_weights.sum(axis=1)
    channel, found = camera.channel_map((camera.rows, camera.cols)), []
    for row, col in np.ndindex(camera.rows // 2, camera.cols // 2):
        block = np.s_[2 * row : 2 * row + 2, 2 * col : 2 * col + 2]
        own = channel[block].ravel()
        found.append(np.linalg.lstsq(response[own], signals[block].ravel() / gain[own])[0])
    return np.array(found).T


def test_pixels_with_deviations_become_nominal(camera: CameraModel) -> None:
    """Uniform light through pixels with known deviations is that of pixels without deviations, within rounding."""
    deviating, deviation = with_deviations(camera, 0.03)
    response, gain = camera.relative_stokes_response, camera.signal_weights.sum(axis=1)
    channel = camera.channel_map((camera.rows, camera.cols))
    light = np.array([1.0, *(DEGREE * f(2 * np.radians(ANGLE)) for f in (np.cos, np.sin))])
    scale = 20000 * (gain / gain.max())[channel]
    nominal, seen = scale * (response[channel] @ light), scale * ((response[channel] + deviation) @ light)
    correction = plan_super_pixels(deviating)
    assert correction is not None
    made = correction.corrected(np.rint(seen + 1000).astype(np.uint16), 1000.0, 65535.0)
    assert np.abs(seen - nominal).max() > 1000
    # Rounding of the values and of the sixteen-bit coefficients.
    assert np.abs(made - 1000.0 - nominal).max() < 0.5 + 0.5 + 0.2 + 4 * 0.5 / 2**FRACTION * nominal.max()


def test_arithmetic_of_the_coefficients(camera: CameraModel) -> None:
    """Integers against the formula in float64, for frames that are not uniform. Clipped super-pixels are unchanged."""
    deviating, deviation = with_deviations(camera, 0.03)
    values = np.random.default_rng(1).integers(0, 2**12, (camera.rows, camera.cols)).astype(np.uint16)
    correction = plan_super_pixels(deviating)
    assert correction is not None
    made = correction.corrected(values, 100.0, 4095.0)
    response, gain = camera.relative_stokes_response, camera.signal_weights.sum(axis=1)
    channel, clipped = camera.channel_map(values.shape), 0
    for row, col in np.ndindex(camera.rows // 2, camera.cols // 2):
        block = np.s_[2 * row : 2 * row + 2, 2 * col : 2 * col + 2]
        own, off = channel[block].ravel(), deviation[block].reshape(4, 3)
        before, after = values[block].ravel(), made[block].ravel()
        if before.max() >= 100 + 0.985 * 3995:
            np.testing.assert_array_equal(before, after)
            clipped += 1
            continue
        signal = (before - 100.0) / gain[own]
        change = -gain[own] * (off @ np.linalg.pinv(response[own] + off) @ signal)
        expected = np.clip(before + change, 0, np.ceil(100 + 0.985 * 3995) - 1)
        assert np.abs(after - expected).max() < 0.5 + 4 * 4095 * 0.5 / 2**FRACTION
    assert clipped


def test_super_pixels_have_one_colour(camera: CameraModel, bayer: CameraModel) -> None:
    assert super_pixels(camera).all()
    assert not super_pixels(bayer).any()
    turned = replace(camera, cfa=np.roll(camera.cfa, 1, (0, 1)))
    assert super_pixels(turned).all() == (camera.cfa.shape == (2, 2))
    assert correction_of(with_deviations(camera, 0.01)[0]).super_pixels is not None


def measured(camera: CameraModel, defects: DefectRecipe, trials: int) -> CameraModel:
    """The camera, measured behind a rotating polariser in the lab."""
    recipe = LabRecipe(dark=DarkRecipe(exposures_s=(0.001,)), polariser=PolariserRecipe(trials=trials))
    planned = [capture for capture in plan(camera, recipe, 7) if capture.kind in ("dark", "polariser")]
    geometry = camera.rows, camera.cols, camera.pixel_pitch, camera.bits
    body = Body(camera.name, *geometry, camera.channels, camera.cfa, camera.optics)
    frames = {each.name: [take(camera, each, trial, 7, defects) for trial in range(each.trials)] for each in planned}
    return calibrate(
        Measurements(
            body=body,
            darks=tuple(Capture(each.name, each.exposure, frames[each.name]) for each in planned if each.kind == "dark"),
            polariser=tuple(
                PolariserCapture(each.name, each.exposure, frames[each.name], monitor=each.monitor, angle=each.angle)
                for each in planned
                if each.kind == "polariser"
            ),
            rotator=Rotator(leakage=1 / recipe.polariser.extinction, angle_error=recipe.polariser.angle_error_deg),
            base=camera,
        )
    )


def partly_polarised(camera: CameraModel) -> LabCapture:
    """A capture of uniform light with the degree DEGREE at ANGLE, without falloff."""
    capture = next(each for each in plan(camera, LabRecipe(), 7) if each.kind == "polariser")
    assert capture.unpolarised is not None
    stokes = DEGREE * float(np.cos(2 * np.radians(ANGLE))), DEGREE * float(np.sin(2 * np.radians(ANGLE)))
    along, across = capture.unpolarised
    assert camera.polarisers is not None
    twice = 2 * np.radians(camera.polarisers.polariser_deg)
    component = stokes[0] * np.cos(twice) + stokes[1] * np.sin(twice)
    electrons = along * (1 + component) + across * (1 - component)
    return replace(capture, electrons=electrons, stokes=stokes, falloff=0.0, trials=FRAMES)


def errors(camera: CameraModel, signals: Array) -> Array:
    """RMS deviation of DoLP and AoLP (degrees) of the super-pixels from the mean over the frame."""
    stokes = stokes_of_super_pixels(camera, signals)
    middle = stokes.mean(axis=1)
    degree, angle = dolp(stokes) - dolp(middle), angle_difference(aolp(stokes), aolp(middle))
    return np.sqrt([np.mean(degree**2), np.mean(angle**2)])


def true_deviation(camera: CameraModel, capture: LabCapture, defects: SensorDefects) -> Array:
    """Response (row, col, stokes) of each pixel minus that of its channel, relative to the channel's response to S0."""
    assert camera.polarisers is not None
    assert capture.unpolarised is not None
    channel = camera.channel_map((camera.rows, camera.cols))
    along, across = capture.unpolarised[:, 0, channel]
    twice = 2 * np.radians(camera.polarisers.polariser_deg[channel] + defects.turn)
    own, total = across * defects.leakage, along + across
    response = np.stack([along + own, (along - own) * np.cos(twice), (along - own) * np.sin(twice)], axis=-1)
    response *= ((1 + fixed_pattern(camera).prnu) / total)[..., None]
    for each in range(len(camera.channels)):
        response[channel == each] -= response[channel == each].mean(axis=0)
    return response


def test_errors_of_degree_and_angle_fall(camera: CameraModel) -> None:
    """Uniform polarised light: the errors that the pixels cause fall to what the noise of the calibration leaves."""
    camera = replace(camera, noise=replace(camera.noise, dsnu=0.0, dark_current=0.0))
    defects = DefectRecipe(hot_pixels_per_million=0, dead_pixels_per_million=0, dust_specks_per_million=0)
    none = DefectRecipe(**asdict(defects) | {"polariser_deg": 0.0, "polariser_leakage": 0.0})
    capture, levels = partly_polarised(camera), (camera.black_level, camera.white_level)
    true = true_deviation(camera, capture, defects_of(camera, defects))
    response, gain = camera.relative_stokes_response, camera.signal_weights.sum(axis=1)
    channel = camera.channel_map((camera.rows, camera.cols))
    light = np.array([1.0, *(DEGREE * f(2 * np.radians(ANGLE)) for f in (np.cos, np.sin))])

    def caused_by(deviation: Array) -> Array:
        return errors(camera, gain[channel] * ((response[channel] + deviation) @ light))

    def mean_of(frames: list[NDArray[np.uint16]]) -> Array:
        return np.asarray(np.mean(frames, axis=0) - camera.black_level)

    seen = [take(camera, capture, trial, 11, defects) for trial in range(FRAMES)]
    ideal = replace(camera, noise=replace(camera.noise, prnu=0.0))
    noise = errors(camera, mean_of([take(ideal, capture, trial, 11, none) for trial in range(FRAMES)]))
    before = np.sqrt(errors(camera, mean_of(seen)) ** 2 - noise**2)
    np.testing.assert_allclose(before, caused_by(true), rtol=0.05)
    for trials, largest in ((2, 0.6), (16, 0.3)):
        calibrated = measured(camera, defects, trials)
        correction = correction_of(calibrated)
        assert calibrated.polariser_field is not None
        made = [correction.corrected(RawFrame("frame", values, *levels)).values for values in seen]
        after = np.sqrt(errors(camera, mean_of(made)) ** 2 - noise**2)
        left = caused_by(true - calibrated.polariser_field.response_deviation / 2.0**FRACTION)
        print(f"{trials} frames per angle: errors of DoLP and AoLP {before} before, {after} after")
        np.testing.assert_allclose(after, left, rtol=0.15)
        assert (after < largest * before).all()
    # The Wiener filter makes the stored deviations a little smaller than the true ones.
    np.testing.assert_allclose(pixel_angle_deviation(calibrated), np.std(defects_of(camera, defects).turn), rtol=0.06)


def test_the_wiener_filter_has_the_smallest_error() -> None:
    """Values with a known covariance and known noise, one component of which is far below the noise."""
    rng = np.random.default_rng(2)
    root = rng.normal(size=(3, 3)) * [1.0, 0.5, 0.05]
    noise = np.diag([0.2, 0.3, 0.4])
    true = root @ rng.normal(size=(3, 200_000))
    seen = true + np.sqrt(noise) @ rng.normal(size=true.shape)
    kept = without_noise(np.cov(seen), noise)
    best = true @ seen.T @ np.linalg.inv(seen @ seen.T)
    np.testing.assert_allclose(kept, best, atol=0.01)
    np.testing.assert_array_equal(without_noise(0.9 * noise, noise), np.zeros((3, 3)))


def test_deviations_of_the_lab(camera: CameraModel) -> None:
    """Uniform within the limits of the recipe, the same in every frame, and none without polarisers."""
    defects = defects_of(camera, DefectRecipe())
    assert 0.95 < np.abs(defects.turn).max() <= 1.0
    assert defects.turn.std() == pytest.approx(1 / np.sqrt(3), rel=0.02)
    assert (defects.leakage.min() >= 0.8) & (defects.leakage.max() <= 1.2)
    assert defects_of(replace(camera, polarisers=None), DefectRecipe()).turn.size == 1


def test_the_field_comes_back_from_a_file(camera: CameraModel, tmp_path: Path) -> None:
    deviating, deviation = with_deviations(camera, 0.01)
    save(deviating, tmp_path / "camera.h5")
    again = load(CameraModel, tmp_path / "camera.h5")
    assert again.polariser_field is not None
    np.testing.assert_array_equal(again.polariser_field.response_deviation / 2.0**FRACTION, deviation)
    with pytest.raises(ValueError, match="polariser field"):
        replace(deviating, rows=camera.rows - 1)
    assert deviating.resized(8, 12).polariser_field is None
