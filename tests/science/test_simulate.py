"""Simulation of light, lens and sensor, compared with closed-form results, colour-science and ISETCam."""

import csv
import dataclasses
import json
import warnings
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel, Noise, Optics
from l3cli.artifacts.training_set import open_training_set
from l3cli.frames.scene import ChannelPicture, Scene
from l3cli.io.pictures.registry import write_picture
from l3cli.physics import spectra
from l3cli.physics.lens import diffraction_transfer, relative_illumination
from l3cli.physics.mosaic import tiled
from l3cli.simulation import fields, light, procedural, sensor
from l3cli.simulation.frame import blurred_channels, lens_transfer, low_rank_transfer, project, simulate
from l3cli.simulation.light import make_target
from l3cli.simulation.procedural import draw
from l3cli.simulation.recipe import Lens
from l3cli.simulation.sources import ColorChecker, WantedScene
from tests.helpers.calls import L3, Refused
from tests.helpers.paths import CONFIGS

PLAIN = Lens(diffraction=False)


def grey_scene(camera: CameraModel, shape: tuple[int, int] = (32, 32), reflectance: float = 0.5) -> Scene:
    wavelength = procedural.grid(camera.wavelength)
    return Scene("grey", wavelength, np.full((*shape, wavelength.size), reflectance, np.float32), None)


# ---------------------------------------------------------------------------------------------------- reference


@pytest.fixture
def isetcam(l3_data: Path) -> Path:
    """ISETCam's numbers (docs/method.md#optics)."""
    folder = l3_data.parent / "reference/isetcam"
    if not folder.is_dir():
        pytest.skip("the ISETCam reference is not at hand")
    return folder


def isetcam_camera(folder: Path) -> CameraModel:
    """The Bayer sensor of the reference run; its well holds 1 V at 24 000 e-/V."""
    table = np.genfromtxt(folder / "spectra.csv", delimiter=",", names=True)
    given = json.loads((folder / "params.json").read_text())
    efficiency = np.array([table[f"qe_rgb_{channel}"] for channel in "rgb"]) * given["fill_factor"]
    well = given["vswing"] / given["conversion_gain"]
    volts = {name: given[name] / given["conversion_gain"] for name in ("read_noise_volts", "dark_voltage", "dsnu_volts")}
    return CameraModel(
        name="ISETCam Bayer",
        rows=given["sensor_rows_cols"][0],
        cols=given["sensor_rows_cols"][1],
        pixel_pitch=given["pixel_size"],
        bits=12,
        channels=("r", "g", "b"),
        cfa=np.array(given["cfa_bayer"]).astype(np.uint8) - 1,
        wavelength=table["wave"],
        responsivity=efficiency,
        responsivity_band=np.zeros_like(efficiency),
        absolute=True,
        gain=4095 / well,
        black_level=0.0,
        white_level=4095.0,
        fixed_pattern_seed=0,
        noise=Noise(
            read_noise=volts["read_noise_volts"],
            dark_current=volts["dark_voltage"],
            dsnu=volts["dsnu_volts"],
            prnu=given["prnu_percent"] / 100,
            well_capacity=well,
        ),
        optics=Optics(given["focal_length"], given["fnumber"], given["scene_distance_m"]),
    )


@pytest.mark.parametrize("off_axis", ["nocos4", "cos4"])
def test_electrons_and_noise_meet_isetcam(isetcam: Path, off_axis: str) -> None:
    camera = isetcam_camera(isetcam)
    table = np.genfromtxt(isetcam / "spectra.csv", delimiter=",", names=True)
    given = json.loads((isetcam / "params.json").read_text())
    patches = np.array([table[f"mcc_{patch:02d}"] for patch in range(1, 25)], np.float32)
    illuminant = spectra.photons_from_energy(table["wave"], table["illum_energy_D65"])
    white = given["mean_luminance_cd_m2"] / (patches @ (table["V"] * table["illum_energy_D65"])).mean()
    white *= table["V"] @ table["illum_energy_D65"]  # cd/m² of a perfect white in that scene
    spread = patches.reshape(6, 4, -1).transpose(1, 0, 2).copy()
    chart = Scene("patches", table["wave"], spread, illuminant.astype(np.float64))
    frame = simulate(camera, chart, light.scene_light(chart, white), given["exp_time"], PLAIN, (0, 0))
    patch_pixels = given["patch_px"] * given["oi_sample_spacing_m"][0] / camera.pixel_pitch
    fall = relative_illumination(camera.optics.image_distance, camera.pixel_pitch, (camera.rows, camera.cols))
    dark = camera.noise.dark_current * given["exp_time"]  # only the noisy frames hold it
    samples = {"r": 61**2 / 4, "g": 61**2 / 2, "b": 61**2 / 4}  # pixels of a patch and channel
    variances, darks, known, deviations = [], [], [], []
    rows = list(csv.DictReader((isetcam / "mcc_bayer_d65.csv").open()))
    on_axis = [float(row["electrons_noisefree"]) for row in rows if row["offaxis"] == "nocos4"]
    for number, row in enumerate(row for row in rows if row["offaxis"] == off_axis):
        down, across = (int(row["patch"]) - 1) % 4, (int(row["patch"]) - 1) // 4
        assert frame.target[1, down, across] == pytest.approx(float(row["scene_Y_cd_m2"]), rel=2e-5)
        mean = float(frame.electrons["rgb".index(row["channel"]), down, across])
        if off_axis == "cos4":  # the mean over the 61×61 pixels about the patch's middle
            y, x = camera.rows / 2 + (down - 1.5) * patch_pixels, camera.cols / 2 + (across - 2.5) * patch_pixels
            darker = fall[round(y) - 30 : round(y) + 31, round(x) - 30 : round(x) + 31].mean()
            assert float(row["electrons_noisefree"]) / on_axis[number] == pytest.approx(darker, abs=3e-4)
            mean *= darker
        noise_free = float(row["electrons_noisefree"])
        deviations.append(mean / noise_free - 1.0)
        darks.append(float(row["volts_noisy_mean"]) / given["conversion_gain"] - noise_free)
        expected = camera.noise_variance(np.array(camera.gain * (mean + dark))) - 1 / 12  # volts are not quantised
        variances.append(float(row["volts_noisy_var"]) * 4095**2 / expected)
        known.append(samples[row["channel"]] / (float(row["volts_noisy_var"]) / given["conversion_gain"] ** 2))
    assert len(variances) == 72
    assert np.abs(deviations).max() < 2e-3
    assert abs(np.mean(deviations)) < 2e-4  # the dark current would add 3.6e-4
    assert np.average(darks, weights=known) == pytest.approx(dark, abs=3 / np.sqrt(np.sum(known)))
    assert 3 / np.sqrt(np.sum(known)) < dark  # so few electrons are distinguished from none
    # A quarter of 61 × 61 pixels a patch and channel know their variance to 4.6 %, all 72 together to 0.6 %.
    assert np.mean(variances) == pytest.approx(1.0, abs=0.02)
    assert np.std(variances) == pytest.approx(0.046, abs=0.02)


def test_mean_and_variance_of_a_flat_frame_are_those_of_the_method(fiveband: CameraModel) -> None:
    noise, electrons, exposure = fiveband.noise, 6000.0, 0.1
    flat = np.full((fiveband.rows, fiveband.cols), electrons)
    raw = sensor.expose(fiveband, flat, exposure, np.random.default_rng(1)).astype(float)
    mean = electrons + noise.dark_current * exposure
    assert (raw.mean() - fiveband.black_level) / fiveband.gain == pytest.approx(mean, rel=5e-4)
    pattern = noise.prnu**2
    variance = (mean + noise.read_noise**2) * (1 + pattern) + pattern * mean**2 + noise.dsnu**2
    assert raw.var() == pytest.approx(fiveband.gain**2 * variance + 1 / 12, rel=0.02)


def test_dark_frames_have_the_read_noise(fiveband: CameraModel) -> None:
    dark = dataclasses.replace(fiveband, noise=dataclasses.replace(fiveband.noise, dark_current=0.0, dsnu=0.0, prnu=0.0))
    raw = sensor.expose(dark, np.zeros((dark.rows, dark.cols)), 0.0, np.random.default_rng(2)).astype(float)
    assert raw.var() == pytest.approx((dark.gain * dark.noise.read_noise) ** 2 + 1 / 12, rel=0.01)


def test_saturated_pixels_stay_within_the_converter(bayer: CameraModel) -> None:
    for electrons in (1e6, 1e25):
        raw = sensor.expose(bayer, np.full((32, 32), electrons), 1.0, np.random.default_rng(0))
        assert raw.min() == raw.max() == bayer.white_level


def test_fixed_pattern_belongs_to_the_camera(bayer: CameraModel) -> None:
    quiet = dataclasses.replace(bayer, noise=dataclasses.replace(bayer.noise, prnu=0.2))
    flat = np.full((64, 64), 3000.0)
    one, other = (sensor.expose(quiet, flat, 0.0, np.random.default_rng(seed)).astype(float) for seed in (1, 2))
    assert np.corrcoef(one.ravel(), other.ravel())[0, 1] > 0.95


def test_noise_modes_leave_out_what_they_state(fiveband: CameraModel) -> None:
    flat = np.full((200, 200), 3000.0)
    raw = {mode: sensor.expose(fiveband, flat, 0.5, np.random.default_rng(1), mode).astype(float) for mode in sensor.NOISES}
    mean = 3000.0 + fiveband.noise.dark_current * 0.5
    for mode in raw:
        assert (raw[mode].mean() - fiveband.black_level) / fiveband.gain == pytest.approx(mean, rel=2e-3)
    assert np.ptp(raw["none"]) == 0
    assert raw["shot"].var() == pytest.approx(fiveband.gain**2 * mean + 1 / 12, rel=0.03)
    assert raw["all"].var() == pytest.approx(fiveband.noise_variance(np.array(fiveband.gain * mean)), rel=0.03)


def test_column_noise_belongs_to_the_columns(bayer: CameraModel) -> None:
    noise = dataclasses.replace(bayer.noise, column_noise=30.0)
    striped = dataclasses.replace(bayer, noise=noise, lines_corrected=True)
    pattern = sensor.fixed_pattern(striped)
    assert pattern.dsnu.mean(axis=0).std() == pytest.approx(30.0, rel=0.15)
    assert (pattern.dsnu - pattern.dsnu.mean(axis=0)).std() == pytest.approx(bayer.noise.dsnu, rel=0.02)
    signal = np.array(500.0)
    assert striped.noise_variance(signal) - bayer.noise_variance(signal) == pytest.approx((30 * bayer.gain) ** 2)


def test_analog_gain_reaches_the_converters_top_sooner(bayer: CameraModel) -> None:
    bright = sensor.with_analog_gain(bayer, 4.0)
    assert (bright.gain, bright.white_level, bright.black_level) == (4 * bayer.gain, 4095.0, bayer.black_level)
    assert sensor.with_analog_gain(bayer, 0.5).white_level == pytest.approx(
        bayer.black_level + (bayer.white_level - bayer.black_level) / 2
    )


# -------------------------------------------------------------------------------------------------------- light


@pytest.mark.parametrize("observer", ["CIE 1931", "CIE 1964"])
def test_targets_are_the_xyz_of_colour_science(fiveband: CameraModel, observer: str) -> None:
    import colour

    size = (96, 144)
    chart = draw(WantedScene(ColorChecker(size=size)), 0, fiveband.wavelength)
    target = make_target(observer, None, (), None, fiveband)
    cmfs = colour.MSDS_CMFS[spectra.OBSERVERS[observer]]
    for name in ("D65", "A", "FL2", "D50", "LED-B1"):
        falling = light.make_light(name, {}, fiveband.wavelength).at(50.0)
        frame = simulate(fiveband, chart, falling, 0.01, PLAIN, (0,), target)
        patches = colour.SDS_COLOURCHECKERS["ISO 17321-1"].values()
        shape = colour.SpectralShape(300, 830, 1)
        fine_a = colour.colorimetry.sd_CIE_standard_illuminant_A(shape)  # by its formula, not by the table at every 5 nm
        tabulated = fine_a if name == "A" else colour.SDS_ILLUMINANTS[name]
        scale = 50.0
        if observer == "CIE 1964":  # luminance is that of the 2° observer
            other = colour.MSDS_CMFS[spectra.OBSERVERS["CIE 1931"]]
            light_values = tabulated.copy().align(cmfs.shape).values
            scale *= (cmfs.values[:, 1] @ light_values) / (other.values[:, 1] @ light_values)
        for patch, (rows, cols) in zip(patches, procedural.colorchecker_patches(size), strict=True):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # it warns that it interpolates
                expected = colour.sd_to_XYZ(patch, cmfs, tabulated, method="Integration") / 100 * scale
            assert np.allclose(frame.target[:, rows, cols].mean(axis=(1, 2)), expected, rtol=2e-5), name


def test_spectral_lines_between_samples_count() -> None:
    grid = np.arange(400.0, 701.0, 10.0)
    fine = np.arange(380.0, 781.0)
    line = np.where(fine == 435.0, 1.0, 0.0)
    seen = spectra.sampling_matrix(fine, grid) @ line
    assert (seen * spectra.bin_widths(grid)).sum() == pytest.approx(1.0)


def test_patterns_lie_on_their_share_of_the_leaves_and_change_nothing_else() -> None:
    nm = procedural.grid(np.array([400.0, 700.0]))
    plain, none, half, every = (
        procedural.dead_leaves(np.random.default_rng(3), (64, 64), nm, *share) for share in ((), (0.0,), (0.5,), (1.0,))
    )
    assert (plain == none).all()
    changed = [float((abs(cube - plain).max(axis=2) > 1e-6).mean()) for cube in (half, every)]
    assert 0.05 < changed[0] < changed[1]
    for cube in (half, every):
        assert cube.min() >= 0
        assert cube.max() <= procedural.MAX_TIMES_WHITE


def test_a_grating_covers_its_duty_at_two_pixels_a_period() -> None:
    one = {name: np.array([value], np.float32) for name, value in (("angle", 0.7), ("kind", 0), ("present", 1))}
    both = {name: np.full((2, 1), value, np.float32) for name, value in (("period", 4.0), ("width", 1.6), ("phase", 0.3))}
    colour = np.ones((1, 31), np.float32)
    grating = fields.Patterns(
        one["present"] > 0,
        colour,
        colour,
        one["kind"].astype(int),
        one["angle"],
        both["period"],
        both["width"],
        both["phase"],
    )
    down, across = np.ogrid[:200, :200]
    share = fields.coverage(grating, np.zeros((200, 200), int), down, across)
    assert share.mean() == pytest.approx(0.4, abs=0.01)
    assert share.max() == pytest.approx(1.0)
    assert share.min() == 0.0


def test_automatic_exposure_brings_white_to_its_share(fiveband: CameraModel) -> None:
    falling = light.make_light("3200K", {}, fiveband.wavelength).at(20.0)
    exposure = light.automatic_exposure(fiveband, falling, 0.9)
    frame = simulate(fiveband, grey_scene(fiveband, reflectance=1.0), falling, exposure, PLAIN, (0,))
    assert frame.electrons.mean(axis=(1, 2)).max() == pytest.approx(0.9 * fiveband.full_scale, rel=1e-4)
    assert frame.white[1] == pytest.approx(20.0, rel=1e-6)
    assert np.allclose(frame.target.mean(axis=(1, 2)), frame.white, rtol=1e-5)


def test_an_exposure_by_saturated_pixels_saturates_as_many(bayer: CameraModel) -> None:
    cube = np.random.default_rng(0).random((100, 120, 31)).astype(np.float32)
    falling = light.make_light("A", {}, bayer.wavelength).at(30.0)
    scene = Scene("noise", np.arange(400.0, 701.0, 10.0), cube, None)
    frame = simulate(bayer, scene, falling, partial(sensor.saturating_exposure, share=0.05), PLAIN, (0,))
    assert (sensor.mosaic(frame.electrons, bayer.cfa) >= bayer.full_scale).mean() == pytest.approx(0.05, abs=2e-3)


def test_daylight_and_mixtures_have_their_colours() -> None:
    import colour

    seen = np.arange(400.0, 701.0, 10.0)

    def chromaticity(name: str, measured: dict | None = None) -> np.ndarray:
        made = light.make_light(name, measured or {}, seen)
        assert spectra.xyz_weights(made.wavelength)[1] @ made.radiance == pytest.approx(1.0)
        xyz = spectra.xyz_weights(made.wavelength) @ made.radiance
        return xyz / xyz.sum()

    for kelvin in (4500, 6504, 10000):
        expected = colour.temperature.CCT_to_xy_CIE_D(kelvin * 1.4388 / 1.438)
        assert np.allclose(chromaticity(f"D{kelvin}K")[:2], expected, atol=2e-3)
    assert np.array_equal(chromaticity("F11"), chromaticity("FL11"))
    d65, a = (spectra.xyz_weights(np.arange(360.0, 831)) @ light.make_light(n, {}, seen).radiance for n in ("D65", "A"))
    mixed = (3 * d65 + a) / 4
    assert np.allclose(chromaticity("0.75 D65 + 0.25 A"), mixed / mixed.sum(), rtol=1e-9)
    assert np.allclose(chromaticity("3 D65 + A"), mixed / mixed.sum(), rtol=1e-9)
    grid = np.arange(380.0, 781.0, 5.0)
    table = colour.SDS_ILLUMINANTS["D65"].copy().align(colour.SpectralShape(380, 780, 5)).values[None]
    assert np.allclose(chromaticity("lamp.csv", {"lamp.csv": (grid, table)}), d65 / d65.sum(), atol=1e-4)


def test_a_light_on_the_cameras_grid_stays_there(bayer: CameraModel) -> None:
    spiky = np.random.default_rng(0).random((1, bayer.wavelength.size)) + 0.1
    made = light.make_light("lamp.csv", {"lamp.csv": (bayer.wavelength, spiky)}, bayer.wavelength)
    photons = spectra.photons_from_energy(bayer.wavelength, spiky[0])
    assert np.allclose(light.white_rates(bayer, made) / (bayer.electron_weights @ photons), made.radiance[0] / photons[0])


def test_targets_of_every_kind_are_of_one_scene(fiveband: CameraModel) -> None:
    scene = grey_scene(fiveband, reflectance=0.25)
    falling = light.make_light("A", {}, fiveband.wavelength).at(40.0)
    d65 = light.make_light("D65", {}, fiveband.wavelength)
    grid = np.arange(380.0, 781.0, 5.0)
    functions = (grid, spectra.colour_matching_functions(grid))

    def seen(
        kind: str, functions: light.Curve | None = None, names: tuple[str, ...] = (), wanted: light.Light | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        target = make_target(kind, functions, names, wanted, fiveband)
        frame = simulate(fiveband, scene, falling, 0.01, PLAIN, (0,), target)
        assert len(target.outputs) == len(frame.target)
        assert np.allclose(frame.target[:, 3, 3], 0.25 * frame.white, rtol=1e-5)
        share = frame.electrons[:, 3, 3] / fiveband.full_scale
        return frame.target[:, 3, 3], share

    xyz, share = seen("CIE 1931")
    assert xyz[1] == pytest.approx(10.0, rel=1e-5)
    assert seen("luminance")[0] == pytest.approx(xyz[1], rel=1e-5)
    assert np.allclose(seen("a.csv", functions, ("X", "Y", "Z"))[0], xyz, rtol=1e-4)
    assert np.allclose(seen("camera")[0] * 0.01 / fiveband.saturation_exposure, share, rtol=1e-5)
    corrected, _ = seen("CIE 1931", wanted=d65)
    assert np.allclose(corrected / corrected[1], spectra.white_point("D65"), rtol=1e-3)


# --------------------------------------------------------------------------------------------------------- lens


@pytest.mark.parametrize(("pitch", "f_number"), [(5e-6, 2.8), (1e-6, 2.8), (3e-6, 16.0)])
def test_low_rank_diffraction_stays_within_its_error(pitch: float, f_number: float) -> None:
    wavelength = np.arange(400.0, 701.0, 10.0)
    transfer = low_rank_transfer(np.sqrt(0.5) / pitch, tuple(wavelength), f_number)
    frequency = np.random.default_rng(0).uniform(0, np.sqrt(0.5) / pitch, 5000)
    radial = np.array([np.interp(frequency, transfer.frequency, term) for term in transfer.radial])
    exact = diffraction_transfer(frequency, wavelength, f_number)
    assert abs(radial.T @ transfer.spectral - exact).max() < 1e-4
    assert diffraction_transfer(np.array([0.0]), wavelength, f_number) == pytest.approx(1.0)


def test_diffraction_blurs_each_band_by_its_transfer(bayer: CameraModel) -> None:
    """Against a Fourier transform a band, on a periodic pattern that mirrors into itself."""
    pitch, f_number, cycles = 2e-6, 4.0, 0.25
    wavelength = procedural.grid(bayer.wavelength)
    wave = np.cos(2 * np.pi * cycles * (np.arange(64) + 0.5))
    cube = np.broadcast_to(0.5 + 0.4 * wave[:, None, None], (64, 64, wavelength.size)).astype(np.float32)
    weights = np.random.default_rng(0).random((3, wavelength.size))
    lens = lens_transfer(Optics(0.05, f_number, 0.0), pitch, wavelength, True, 0.0)
    assert lens is not None
    planes = project(cube, (weights[:, None] * lens.spectral).reshape(-1, wavelength.size))
    got = blurred_channels(planes.reshape(3, -1, 64, 64), lens, pitch)
    transfer = diffraction_transfer(np.array([cycles / pitch]), wavelength, f_number)[0]
    expected = 0.5 * weights.sum(axis=1)[:, None] + 0.4 * (weights @ transfer)[:, None] * wave
    assert np.allclose(got[:, :, 32], expected, atol=1e-4 * weights.sum(axis=1).max())
    assert transfer.max() - transfer.min() > 0.1


@pytest.mark.parametrize("f_number", [4.0, 5.6, 8.0])
@pytest.mark.parametrize("nanometres", [450.0, 650.0])
def test_the_transfer_function_of_a_simulated_edge_is_that_of_the_method(f_number: float, nanometres: float) -> None:
    """The edge's spread function, four samples a pixel across a 2° edge, blurred against sharp (ISO 12233)."""
    pitch, band, angle = 1.5e-6, np.array([nanometres]), 2.0
    edge = procedural.slanted_edge((400, 400), band, angle, 0.05, 0.8).transpose(2, 0, 1)
    lens = lens_transfer(Optics(0.05, f_number, 0.0), pitch, band, True, 0.0)
    assert lens is not None
    blurred = blurred_channels(edge[None].copy(), lens, pitch)
    down, across = np.ogrid[-199.5:200, -199.5:200]
    distance = across * np.cos(np.radians(angle)) + down * np.sin(np.radians(angle))
    edges = np.arange(-640, 641) / 4
    pixels, _ = np.histogram(distance, edges)
    sharp, soft = (
        np.diff(np.histogram(distance, edges, weights=image[0].astype(float))[0] / pixels) for image in (edge, blurred)
    )
    window = np.hanning(sharp.size)
    measured = abs(np.fft.rfft(soft * window)) / abs(np.fft.rfft(sharp * window))
    frequency = np.fft.rfftfreq(sharp.size, 0.25)
    used = (frequency > 0.02) & (frequency < 0.45)
    expected = diffraction_transfer(frequency / pitch, band, f_number)[:, 0]
    assert abs(measured - expected)[used].max() < 1e-3


def test_defocus_is_a_gaussian_of_its_width() -> None:
    pitch, sigma = 4e-6, 6e-6
    point = np.zeros((1, 1, 65, 65), np.float32)
    point[0, 0, 32, 32] = 1
    lens = lens_transfer(Optics(0.05, 4.0, 0.0), pitch, np.array([550.0]), False, sigma)
    assert lens is not None
    got = blurred_channels(point, lens, pitch)[0]
    axis = np.arange(65) - 32
    assert got.sum() == pytest.approx(1.0, rel=1e-5)
    assert (got.sum(axis=0) * axis**2).sum() == pytest.approx((sigma / pitch) ** 2, rel=1e-3)
    assert lens_transfer(Optics(0.05, 4.0, 0.0), pitch, np.array([550.0]), False, 0.0) is None


def test_off_axis_light_falls_as_the_fourth_power_of_the_cosine(fiveband: CameraModel) -> None:
    fall = relative_illumination(fiveband.optics.image_distance, fiveband.pixel_pitch, (1164, 2048))
    distance = fiveband.optics.image_distance
    corner = np.hypot(581.5, 1023.5) * fiveband.pixel_pitch
    assert fall[0, 0] == pytest.approx(np.cos(np.arctan(corner / distance)) ** 4, rel=1e-5)
    assert fall[582, 1024] == pytest.approx(1.0, abs=1e-6)


CAMERA = CONFIGS / "benchmarks/bayer/camera.toml"
HEAD = 'exposure_share = [{share}]\nsensor.noise = "none"\ntarget.outputs = "camera"\n'
SCENE = '[[scene]]\nsource = "rgb"\nholds = "codes"\nfile = "{file}"\n'


@pytest.fixture
def codes(tmp_path: Path) -> np.ndarray:
    """The codes of picture.png, 24 × 20."""
    pixels = np.random.default_rng(0).integers(0, 256, (24, 20, 3), dtype=np.uint8)
    write_picture(tmp_path / "picture.png", pixels)
    return pixels


def recipe(folder: Path, text: str) -> Path:
    (folder / "scenes.toml").write_text(text)
    return folder / "scenes.toml"


def test_mosaic_and_target_are_the_codes(codes: np.ndarray, tmp_path: Path, l3: L3) -> None:
    scenes = recipe(tmp_path, HEAD.format(share="0.9, 0.5") + SCENE.format(file="picture.png"))
    assert l3("simulate", scenes, "--camera", CAMERA, "-o", tmp_path / "set.h5", "--quiet")[0] == 0
    with open_training_set(tmp_path / "set.h5") as reader:
        camera, frames = reader.head.camera, [reader.frame(0), reader.frame(1)]
    sampled = np.take_along_axis(codes, tiled(camera.cfa, codes.shape[:2])[..., None].astype(int), axis=2)[..., 0]
    for frame, share in zip(frames, (0.9, 0.5), strict=True):
        assert np.abs(frame.raw - sampled / 255 * share * camera.white_level).max() <= 0.51
        assert frame.white == pytest.approx(np.full(3, frame.white[0]))
        target = np.moveaxis(frame.target, 0, -1) / frame.white[0] * 255
        assert target == pytest.approx(codes, abs=1e-3)
    assert frames[0].exposure == pytest.approx(frames[1].exposure * 1.8)


def test_channels_are_taken_by_their_names(codes: np.ndarray, tmp_path: Path, l3: L3) -> None:
    text = CAMERA.read_text().replace('["r", "g", "b"]', '["b", "r", "g"]')
    (tmp_path / "camera.toml").write_text(text)
    framing = "crop = [2, 4, 18, 16]\nrotate = 90\n"
    scenes = recipe(tmp_path, HEAD.format(share="0.9") + SCENE.format(file="picture.png") + framing)
    assert l3("simulate", scenes, "--camera", tmp_path / "camera.toml", "-o", tmp_path / "set.h5", "--quiet")[0] == 0
    with open_training_set(tmp_path / "set.h5") as reader:
        frame = reader.frame(0)
        assert reader.head.outputs == ("b", "r", "g")
    turned = np.rot90(codes[2:20, 4:20])
    assert np.moveaxis(frame.target, 0, -1) / frame.white[0] * 255 == pytest.approx(turned[..., [2, 0, 1]], abs=1e-3)


def test_a_picture_of_floats_is_linear_already(tmp_path: Path, l3: L3) -> None:
    write_picture(tmp_path / "picture.exr", np.full((16, 16, 3), 0.25, np.float32), ("R", "G", "B"))
    scenes = recipe(tmp_path, HEAD.format(share="0.9") + SCENE.format(file="picture.exr"))
    assert l3("simulate", scenes, "--camera", CAMERA, "-o", tmp_path / "set.h5", "--quiet")[0] == 0
    with open_training_set(tmp_path / "set.h5") as reader:
        assert reader.frame(0).target / reader.frame(0).white[0] == pytest.approx(np.full((3, 16, 16), 0.25), rel=1e-6)


def test_what_has_no_spectra_is_refused(codes: np.ndarray, tmp_path: Path, refused: Refused) -> None:
    def words(text: str, camera: object = CAMERA) -> str:
        return str(refused(2, "simulate", recipe(tmp_path, text), "--camera", camera, "-o", tmp_path / "set.h5"))

    scene = SCENE.format(file="picture.png")
    assert 'target.outputs = "camera"' in words("exposure_share = [0.9]\n" + scene)
    assert "remove target.illuminant" in words('target.illuminant = "A"\n' + HEAD.format(share=0.9) + scene)
    assert "r, g, b, o, c" in words(HEAD.format(share=0.9) + scene, "fiveband")
    assert "no illuminant of its own" in words('illuminants = ["scene"]\n' + HEAD.format(share=0.9) + scene)
    assert "holds" in words(HEAD.format(share=0.9) + scene.replace("codes", "code"))


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e7])
def test_a_signal_is_a_number(value: float) -> None:
    with pytest.raises(ValueError, match="not finite or exceed"):
        ChannelPicture("picture", np.full((16, 16, 3), value, np.float32))
