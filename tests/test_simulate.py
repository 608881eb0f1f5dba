"""Simulation: light, lens and sensor against closed forms, colour-science and ISETCam; the command from recipe to file."""

import csv
import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from l3cli import spectra
from l3cli.artifacts.camera import CameraModel, Noise, Optics
from l3cli.artifacts.training_set import open_training_set
from l3cli.scene import Scene
from l3cli.simulate import charts, light, optics, procedural, sensor
from l3cli.simulate.drawn import draw
from l3cli.simulate.frame import simulate
from l3cli.simulate.recipe import Lens
from l3cli.simulate.sources import ColorChecker, WantedScene
from l3cli.simulate.targets import make_target
from tests.conftest import CONFIGS

PLAIN = Lens(diffraction=False)


def grey_scene(camera: CameraModel, shape: tuple[int, int] = (32, 32), reflectance: float = 0.5) -> Scene:
    wavelength = procedural.grid(camera.wavelength)
    return Scene("grey", wavelength, np.full((*shape, wavelength.size), reflectance, np.float32), None)


# ---------------------------------------------------------------------------------------------------- reference


@pytest.fixture
def isetcam(l3_data: Path) -> Path:
    """ISETCam's numbers (METHOD 1.3)."""
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
        black=0.0,
        white=4095.0,
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


def test_electrons_and_noise_meet_isetcam(isetcam: Path) -> None:
    camera = isetcam_camera(isetcam)
    table = np.genfromtxt(isetcam / "spectra.csv", delimiter=",", names=True)
    given = json.loads((isetcam / "params.json").read_text())
    patches = np.array([table[f"mcc_{patch:02d}"] for patch in range(1, 25)])
    illuminant = spectra.photons_from_energy(table["wave"], table["illum_energy_D65"])
    white = given["mean_luminance_cd_m2"] / (patches @ (table["V"] * table["illum_energy_D65"])).mean()
    white *= table["V"] @ table["illum_energy_D65"]  # cd/m² of a perfect white in that scene
    rows = [row for row in csv.DictReader((isetcam / "mcc_bayer_d65.csv").open()) if row["offaxis"] == "nocos4"]
    assert len(rows) == 72
    variances = []
    for row in rows:
        patch = patches[int(row["patch"]) - 1].astype(np.float32)
        scene = Scene("patch", table["wave"], np.broadcast_to(patch, (16, 16, patch.size)).copy(), illuminant)
        frame = simulate(camera, scene, light.own_light(scene, white), given["exp_time"], Lens(), (0, 0))
        assert frame.target[1].mean() == pytest.approx(float(row["scene_Y_cd_m2"]), rel=2e-3)
        mean = frame.electrons["rgb".index(row["channel"])].mean() + camera.noise.dark_current * given["exp_time"]
        assert mean == pytest.approx(float(row["electrons_noisefree"]), rel=3e-3), row
        expected = camera.noise_variance(np.array(camera.gain * mean)) - 1 / 12  # volts are not quantised
        variances.append(float(row["volts_noisy_var"]) * 4095**2 / expected)
    # A quarter of 61 × 61 pixels a patch and channel know their variance to 4.6 %, all 72 together to 0.6 %.
    assert np.mean(variances) == pytest.approx(1.0, abs=0.02)
    assert np.std(variances) == pytest.approx(0.046, abs=0.02)


def test_mean_and_variance_of_a_flat_frame_are_those_of_the_method(fiveband: CameraModel) -> None:
    noise, electrons, exposure = fiveband.noise, 6000.0, 0.1
    flat = np.full((fiveband.rows, fiveband.cols), electrons)
    raw = sensor.expose(fiveband, flat, exposure, np.random.default_rng(1)).astype(float)
    mean = electrons + noise.dark_current * exposure
    assert (raw.mean() - fiveband.black) / fiveband.gain == pytest.approx(mean, rel=5e-4)
    pattern = noise.prnu**2
    variance = (mean + noise.read_noise**2) * (1 + pattern) + pattern * mean**2 + noise.dsnu**2
    assert raw.var() == pytest.approx(fiveband.gain**2 * variance + 1 / 12, rel=0.02)


def test_saturated_pixels_stay_within_the_converter(bayer: CameraModel) -> None:
    for electrons in (1e6, 1e25):
        raw = sensor.expose(bayer, np.full((32, 32), electrons), 1.0, np.random.default_rng(0))
        assert raw.min() == raw.max() == bayer.white


def test_fixed_pattern_belongs_to_the_camera(bayer: CameraModel) -> None:
    quiet = dataclasses.replace(bayer, noise=dataclasses.replace(bayer.noise, prnu=0.2))
    flat = np.full((64, 64), 3000.0)
    one, other = (sensor.expose(quiet, flat, 0.0, np.random.default_rng(seed)).astype(float) for seed in (1, 2))
    assert np.corrcoef(one.ravel(), other.ravel())[0, 1] > 0.95


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
        scale = 50.0
        if observer == "CIE 1964":  # luminance is that of the 2° observer
            other = colour.MSDS_CMFS[spectra.OBSERVERS["CIE 1931"]]
            light_values = colour.SDS_ILLUMINANTS[name].copy().align(cmfs.shape).values
            scale *= (cmfs.values[:, 1] @ light_values) / (other.values[:, 1] @ light_values)
        for patch, (rows, cols) in zip(patches, charts.colorchecker_patches(size), strict=True):
            expected = colour.sd_to_XYZ(patch, cmfs, colour.SDS_ILLUMINANTS[name], method="Integration") / 100 * scale
            assert np.allclose(frame.target[:, rows, cols].mean(axis=(1, 2)), expected, rtol=2e-5), name


def test_spectral_lines_between_samples_count() -> None:
    grid = np.arange(400.0, 701.0, 10.0)
    fine = np.arange(380.0, 781.0)
    line = np.where(fine == 435.0, 1.0, 0.0)
    seen = spectra.sampling_matrix(fine, grid) @ line
    assert (seen * spectra.bin_widths(grid)).sum() == pytest.approx(1.0)


def test_automatic_exposure_brings_white_to_its_share(fiveband: CameraModel) -> None:
    falling = light.make_light("3200K", {}, fiveband.wavelength).at(20.0)
    exposure = light.automatic_exposure(fiveband, falling, 0.9)
    frame = simulate(fiveband, grey_scene(fiveband, reflectance=1.0), falling, exposure, PLAIN, (0,))
    assert frame.electrons.mean(axis=(1, 2)).max() == pytest.approx(0.9 * fiveband.full_scale, rel=1e-4)
    assert frame.white[1] == pytest.approx(20.0, rel=1e-6)
    assert np.allclose(frame.target.mean(axis=(1, 2)), frame.white, rtol=1e-5)


# --------------------------------------------------------------------------------------------------------- lens


@pytest.mark.parametrize(("pitch", "f_number"), [(5e-6, 2.8), (1e-6, 2.8), (3e-6, 16.0)])
def test_low_rank_diffraction_stays_within_its_error(pitch: float, f_number: float) -> None:
    wavelength = np.arange(400.0, 701.0, 10.0)
    transfer = optics.low_rank_transfer(np.sqrt(0.5) / pitch, tuple(wavelength), f_number)
    frequency = np.random.default_rng(0).uniform(0, np.sqrt(0.5) / pitch, 5000)
    radial = np.array([np.interp(frequency, transfer.frequency, term) for term in transfer.radial])
    exact = optics.diffraction_transfer(frequency, wavelength, f_number)
    assert abs(radial.T @ transfer.spectral - exact).max() < 1e-4
    assert optics.diffraction_transfer(np.array([0.0]), wavelength, f_number) == pytest.approx(1.0)


def test_diffraction_blurs_each_band_by_its_own_transfer(bayer: CameraModel) -> None:
    """Against a Fourier transform a band, on a periodic pattern that mirrors into itself."""
    pitch, f_number, cycles = 2e-6, 4.0, 0.25
    wavelength = procedural.grid(bayer.wavelength)
    wave = np.cos(2 * np.pi * cycles * (np.arange(64) + 0.5))
    cube = np.broadcast_to(0.5 + 0.4 * wave[:, None, None], (64, 64, wavelength.size)).astype(np.float32)
    weights = np.random.default_rng(0).random((3, wavelength.size))
    lens = optics.lens_transfer(Optics(0.05, f_number, 0.0), pitch, wavelength, True, 0.0)
    assert lens is not None
    planes = optics.project(cube, (weights[:, None] * lens.spectral).reshape(-1, wavelength.size))
    got = optics.blurred_channels(planes.reshape(3, -1, 64, 64), lens, pitch)
    transfer = optics.diffraction_transfer(np.array([cycles / pitch]), wavelength, f_number)[0]
    expected = 0.5 * weights.sum(axis=1)[:, None] + 0.4 * (weights @ transfer)[:, None] * wave
    assert np.allclose(got[:, :, 32], expected, atol=1e-4 * weights.sum(axis=1).max())
    assert transfer.max() - transfer.min() > 0.1


def test_off_axis_light_falls_as_the_fourth_power_of_the_cosine(fiveband: CameraModel) -> None:
    fall = optics.relative_illumination(fiveband.optics, fiveband.pixel_pitch, (1164, 2048))
    distance = optics.image_distance(fiveband.optics)
    corner = np.hypot(581.5, 1023.5) * fiveband.pixel_pitch
    assert fall[0, 0] == pytest.approx(np.cos(np.arctan(corner / distance)) ** 4, rel=1e-5)
    assert fall[582, 1024] == pytest.approx(1.0, abs=1e-6)


# ------------------------------------------------------------------------------------------------------ command


def test_frames_are_scenes_times_lights_times_exposures(
    l3: Callable[..., tuple[int, str, str]], bayer_recipe: Path, tmp_path: Path
) -> None:
    recipe = tmp_path / "scenes.toml"
    recipe.write_text(
        'illuminants = ["D65", "A"]\nluminances_cd_m2 = [10.0, 100.0]\nexposure_share = [0.9]\n'
        '[[scene]]\nsource = "dead leaves"\nsize = [32, 48]\ncount = 2\n'
        '[[scene]]\nsource = "colorchecker"\nsize = [64, 96]\n'
    )
    output, pictures = tmp_path / "new/training.h5", tmp_path / "new/pictures"
    code, out, err = l3("simulate", recipe, "--camera", bayer_recipe, "-o", output, "--seed", 5, "--pictures", pictures)
    assert (code, out) == (0, ""), err
    with open_training_set(output) as reader:
        frames = list(reader)
        stage = reader.head.history[-1]
    assert len(frames) == 3 * 2 * 2
    assert [frame.illuminant for frame in frames[:4]] == ["D65", "D65", "A", "A"]
    assert {frame.scene for frame in frames} == {"dead leaves 0.0", "dead leaves 0.1", "colorchecker 0.0"}
    assert frames[7].seed.tolist() == [5, 7]
    assert frames[1].luminance == pytest.approx(100.0)
    assert np.allclose(frames[0].electrons, frames[1].electrons, rtol=1e-5)  # exposure makes up for luminance
    assert np.allclose(10 * frames[0].target, frames[1].target, rtol=1e-5)
    assert (stage.command, stage.options) == ("simulate", {"seed": 5})
    assert "dead leaves" in stage.recipe
    assert "small Bayer" in stage.recipe
    assert str(tmp_path) not in json.dumps(dataclasses.asdict(stage))
    assert len(list(pictures.glob("*_raw.tif"))) == len(list(pictures.glob("*_ideal.png"))) == len(frames)


def test_pictures_hold_the_raw_frame_and_a_white_that_is_white(
    l3: Callable[..., tuple[int, str, str]], bayer_recipe: Path, tmp_path: Path
) -> None:
    from l3cli.io.images import read_image

    recipe = tmp_path / "chart.toml"
    recipe.write_text('illuminants = ["A"]\nexposure_share = [0.9]\n[[scene]]\nsource = "colorchecker"\nsize = [128, 192]\n')
    code, _, err = l3("simulate", recipe, "--camera", bayer_recipe, "-o", tmp_path / "t.h5", "--pictures", tmp_path / "p")
    assert code == 0, err
    with open_training_set(tmp_path / "t.h5") as reader:
        raw = reader.frame(0).raw
    stored, names = read_image(next((tmp_path / "p").glob("*_raw.tif")))
    assert stored.dtype == np.uint16
    assert len(names) == 1
    assert np.array_equal(stored[..., 0], raw)
    ideal, _ = read_image(next((tmp_path / "p").glob("*_ideal.png")))
    rows, cols = charts.colorchecker_patches((128, 192))[21]  # neutral 5
    patch = ideal[rows, cols].reshape(-1, 3).astype(int)
    assert np.ptp(patch.mean(axis=0)) < 4
    assert 110 < patch.mean() < 130


def test_the_same_bytes_whatever_the_number_of_jobs(
    l3: Callable[..., tuple[int, str, str]], bayer_recipe: Path, tmp_path: Path
) -> None:
    for jobs in (1, 2):
        arguments = ("--camera", bayer_recipe, "-o", tmp_path / f"{jobs}.h5", "--jobs", jobs, "--quiet")
        assert l3("simulate", CONFIGS / "scenes/small.toml", *arguments) == (0, "", "")
    first = (tmp_path / "1.h5").read_bytes()
    assert first == (tmp_path / "2.h5").read_bytes()
    assert l3("simulate", CONFIGS / "scenes/small.toml", *arguments, "--force", "--seed", 1)[0] == 0
    assert first != (tmp_path / "2.h5").read_bytes()


HEAD = 'illuminants = ["D65"]\nexposure_share = [0.9]\n'
LEAVES = '[[scene]]\nsource = "dead leaves"\nsize = [32, 32]\n'


@pytest.mark.parametrize(
    ("text", "code", "said"),
    [
        (HEAD + '[[scene]]\nsource = "live leaves"\nsize = [32, 32]\n', 2, "live leaves"),
        (HEAD + LEAVES + "colour = 3\n", 2, "colour"),
        (HEAD + '[[scene]]\nsource = "dead leaves"\n', 2, "size"),
        (HEAD + '[[scene]]\nsource = "dead leaves"\nsize = [15, 32]\n', 2, "16×16"),
        (HEAD + '[[scene]]\nsource = "dead leaves"\nsize = [32, 3200]\n', 2, "larger than the sensor"),
        (HEAD + '[[scene]]\nsource = "iset"\nfile = "no/such/*.mat"\n', 3, "does not exist"),
        (HEAD.replace("D65", "daylight") + LEAVES, 2, "daylight"),
        (HEAD.replace("D65", "scene") + LEAVES, 2, "light of its own"),
        (HEAD.replace("D65", "3K") + LEAVES, 2, "no light"),
        (HEAD + "exposure_s = [0.1]\n" + LEAVES, 2, "either exposure_share"),
        (HEAD.replace("0.9", "-1") + LEAVES, 2, "above zero"),
        (HEAD + LEAVES + "count = 0\n", 2, "at least 1"),
        (HEAD + "scene = []\n", 2, "an entry"),
        (HEAD, 2, "scene"),
    ],
)
def test_a_wrong_recipe_is_one_line(
    refused: Callable[..., str], bayer_recipe: Path, tmp_path: Path, text: str, code: int, said: str
) -> None:
    recipe = tmp_path / "scenes.toml"
    recipe.write_text(text)
    assert said in refused(code, "simulate", recipe, "--camera", bayer_recipe, "-o", tmp_path / "out.h5")


def test_fixed_exposure_needs_an_absolute_camera(refused: Callable[..., str], bayer: CameraModel, tmp_path: Path) -> None:
    from l3cli.artifacts.base import save

    save(dataclasses.replace(bayer, absolute=False), tmp_path / "relative.h5")
    (tmp_path / "scenes.toml").write_text("exposure_s = [0.01]\n" + LEAVES)
    arguments = (tmp_path / "scenes.toml", "--camera", tmp_path / "relative.h5", "-o", tmp_path / "out.h5")
    assert "exposure_share" in refused(2, "simulate", *arguments)


def test_existing_output_and_filled_folder_are_refused(
    refused: Callable[..., str], bayer_recipe: Path, tmp_path: Path
) -> None:
    (tmp_path / "out.h5").write_text("mine")
    recipe = CONFIGS / "scenes/small.toml"
    assert "--force" in refused(1, "simulate", recipe, "--camera", bayer_recipe, "-o", tmp_path / "out.h5")
    arguments = ("--camera", bayer_recipe, "-o", tmp_path / "new.h5", "--pictures", tmp_path)
    assert "not empty" in refused(1, "simulate", recipe, *arguments)
    assert (tmp_path / "out.h5").read_text() == "mine"
