"""Calibration recovers a known camera, and reports measurements that cannot be used."""

import dataclasses
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel, Noise
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.store import load
from l3cli.calibration import noise, responsivity
from l3cli.calibration.captures import Sensor, fit_series, measure_charts, measure_sweep
from l3cli.calibration.model import from_data_sheet
from l3cli.calibration.statistics import mean_value, measure_level, no_defects
from l3cli.errors import InputFileError
from l3cli.frames.measurement import (
    CHART_COLS,
    CHART_ROWS,
    BandCapture,
    Body,
    Capture,
    ChartCapture,
    Measurements,
    MonoCapture,
    SensorFigures,
)
from l3cli.system.files import sha256
from tests.helpers.calls import L3

GOALS = {  # % of the truth
    "overall system gain K": 1.0,
    "temporal dark noise": 3.0,
    "dark current": 5.0,
    "DSNU": 5.0,
    "PRNU": 5.0,
    "saturation capacity": 1.0,
}


@pytest.fixture(scope="module")
def bayer_recipe(fine_bayer_recipe: Path) -> Path:
    return fine_bayer_recipe


@pytest.fixture(scope="module")
def bayer(bayer_recipe: Path) -> CameraModel:
    return load_camera(bayer_recipe)


@pytest.fixture
def folder(lab_folder: Path) -> Path:
    return lab_folder


@pytest.fixture
def copied(lab_folder: Path, tmp_path: Path) -> Path:
    """A copy of the lab's folder, to be spoilt."""
    return Path(shutil.copytree(lab_folder, tmp_path / "lab"))


@pytest.fixture
def body(bayer: CameraModel) -> Body:
    b = bayer
    return Body(b.name, b.rows, b.cols, b.pixel_pitch, b.bits, b.channels, b.cfa, b.optics)


DARK = noise.DarkNoise(black_level=np.full(3, 64.0), slope=np.zeros(3), variance=np.zeros(3), dsnu=np.zeros(3))


def white_transfer() -> noise.PhotonTransfer:
    """A photon transfer that is known for its white level of 4095 DN alone."""
    return noise.PhotonTransfer(
        np.zeros((1, 3)), np.zeros((1, 3)), np.ones((1, 3), dtype=bool), 4095.0, True, np.ones(3), np.zeros(3), np.zeros(3)
    )


# ------------------------------------------------------------------------------------------------------- recovery


def test_the_truth_comes_back(folder: Path, bayer: CameraModel, bayer_recipe: Path, tmp_path: Path, l3: L3) -> None:
    code, out, err = l3(
        "calibrate", folder / "MEASUREMENTS.toml", "-o", tmp_path / "camera.h5", "--truth", bayer_recipe, "--json", "--quiet"
    )
    assert (code, err) == (0, "")
    truth = json.loads(out)["truth"]
    for name, goal in GOALS.items():
        assert abs(truth["camera"][name]["error %"]) < goal, name
    assert truth["camera"]["white level"]["recovered"] == bayer.white_level == 3814
    assert abs(truth["camera"]["black level"]["recovered"] - bayer.black_level) < 0.3
    assert json.loads(out)["saturation reached"] is True
    for channel in truth["channels"].values():
        assert channel["responsivity RMS error (% of peak)"] < 1.0
        assert abs(channel["gain alpha·r error (%)"]) < 0.5

    camera = load(CameraModel, tmp_path / "camera.h5")
    true = np.array([np.interp(camera.wavelength, bayer.wavelength, curve) for curve in bayer.responsivity])
    error = np.abs(camera.responsivity - true) / true.max(axis=1, keepdims=True)
    assert np.sqrt((error**2).mean(axis=1)).max() < 0.01  # the command's figure, computed anew
    assert (camera.responsivity_band > 0).all()
    assert np.mean(np.abs(camera.responsivity - true) <= camera.responsivity_band) > 0.75  # 95 %, but neighbours go together
    assert camera.responsivity_band.max() < 0.02 * true.max()
    assert camera.fit is not None
    assert camera.fit.chart is not None
    assert abs(camera.fit.chart.beta - bayer.black_level).max() < 0.5
    assert camera.fit.chart.r_squared.min() > 0.9995
    assert camera.fit.chart.relative_rmse.max() < 0.01
    assert camera.fit.chart.illuminants == ("D65", "A", "3200K", "FL2")


def test_light_lost_off_the_axis_is_no_inefficiency(bayer_recipe: Path, tmp_path: Path, l3: L3) -> None:
    """A lens so short that the corners get four fifths of the light: forgetting it costs 8 % of the efficiency."""
    recipe = tmp_path / "wide.toml"
    recipe.write_text(bayer_recipe.read_text().replace("focal_length_mm = 25", "focal_length_mm = 2"))
    (tmp_path / "lab.toml").write_text("monitor_error = 0.0\n[white]\ntrials = 2")
    assert l3("lab", recipe, "-o", tmp_path / "lab", "--recipe", tmp_path / "lab.toml")[0] == 0
    command = ("calibrate", tmp_path / "lab/MEASUREMENTS.toml", "-o", tmp_path / "camera.h5", "--truth", recipe, "--json")
    code, out, _ = l3(*command)
    assert code == 0
    for channel in json.loads(out)["truth"]["channels"].values():
        assert abs(channel["gain alpha·r error (%)"]) < 0.5
        assert channel["responsivity RMS error (% of peak)"] < 1.0


def test_history_names_every_file_and_no_path(folder: Path, tmp_path: Path, l3: L3) -> None:
    for name in ("a.h5", "b.h5"):
        assert l3("calibrate", folder / "MEASUREMENTS.toml", "-o", tmp_path / name)[0] == 0
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()
    (stage,) = load(CameraModel, tmp_path / "a.h5").history
    assert stage.command == "calibrate"
    assert stage.options == {}
    assert stage.recipe == (folder / "MEASUREMENTS.toml").read_text()
    assert stage.inputs["measurements"] == [sha256(folder / "MEASUREMENTS.toml")]
    assert sorted(stage.inputs["frames"]) == sorted(sha256(path) for path in folder.rglob("*.tif"))
    assert sorted(stage.inputs["spectra"]) == sorted(sha256(path) for path in folder.rglob("*.csv"))
    assert str(folder) not in (tmp_path / "a.h5").read_bytes().decode("latin-1")


def test_a_sweep_that_never_saturates_states_it(copied: Path, tmp_path: Path, l3: L3) -> None:
    text = (copied / "MEASUREMENTS.toml").read_text()
    blocks = text.split("\n\n")
    brightest = [index for index, block in enumerate(blocks) if "[[white]]" in block][-1]
    (copied / "MEASUREMENTS.toml").write_text("\n\n".join(blocks[:brightest] + blocks[brightest + 1 :]))
    code, _, err = l3("calibrate", copied / "MEASUREMENTS.toml", "-o", tmp_path / "camera.h5")
    assert code == 0
    assert "no white frame saturates" in err
    camera = load(CameraModel, tmp_path / "camera.h5")
    assert camera.white_level == 4095
    assert camera.gain == pytest.approx(0.25, rel=0.01)


# -------------------------------------------------------------------------------------------------- Eq. 1 and Eq. 2


def triangles(centres: np.ndarray, wavelength: np.ndarray, width: float) -> np.ndarray:
    return np.maximum(0.0, 1.0 - np.abs(wavelength - centres[:, None]) / width)


def test_eq1_sees_through_the_bandwidth_of_the_lights() -> None:
    wavelength = np.arange(400.0, 700.5, 1.0)
    truth = np.exp(-0.5 * ((wavelength - 540.0) / 20.0) ** 2)
    lights = triangles(np.arange(430.0, 675.0, 10.0), wavelength, 30.0)
    nodes = responsivity.node_grid([(wavelength, light) for light in lights])
    assert nodes[0] == 400
    assert nodes[-1] == 700
    design = responsivity.node_photons(wavelength, lights, nodes)
    photons = design.sum(axis=1, keepdims=True)
    values = lights @ truth / photons[:, 0]
    true = np.interp(nodes, wavelength, truth)
    recovered = responsivity.solve(design / photons, values, 1e-6)
    as_lines = np.interp(nodes, np.arange(430.0, 675.0, 10.0), values)
    assert np.abs(recovered - true).max() < 0.02
    assert np.abs(as_lines - true).max() > 0.1  # what taking the lights for lines would cost
    scaled = responsivity.solve(design / photons, 1e-3 * values, 1e-6)
    np.testing.assert_allclose(scaled, 1e-3 * recovered, atol=1e-9)  # smoothing does not depend on the unit
    assert responsivity.solve(design / photons, values - 0.05, 1e-6).min() >= 0


def test_a_saturated_monochromatic_capture_is_left_out_of_its_channel_alone() -> None:
    design, truth = np.eye(12), np.linspace(1.0, 2.0, 12)
    values = np.stack([truth, truth], axis=1)
    values[5] = 0.3
    valid = np.ones((12, 2), dtype=bool)
    valid[5, 0] = False
    sweep = responsivity.Sweep(np.arange(12.0), design, values, valid)
    first, second = responsivity.solve_channels(sweep, 1e-4)
    assert first[5] == pytest.approx(truth[5], abs=0.01)
    assert second[5] == pytest.approx(0.3, abs=0.05)


def test_dark_current_is_no_light(body: Body) -> None:
    """A long exposure in weak light: 40 DN of light above 60 DN of dark signal, in mono and chart captures alike."""
    none = noise.LineNoise(0.0, 0.0)
    response = noise.ResponseNoise(np.zeros(3), np.zeros(3), none, none, no_defects(), np.ones((16, 16)))
    sensor = Sensor(replace(DARK, slope=np.full(3, 30.0)), white_transfer(), response, np.ones(1), no_defects())
    wavelength, slit = np.arange(500.0, 521.0), np.r_[0.0, np.ones(19), 0.0]
    frame = np.full((192, 256), 64 + 60 + 40, dtype=np.uint16)
    light = MonoCapture("mono.tif", 2.0, [frame], wavelength, slit)
    sweep, _ = measure_sweep([light], body, sensor)
    photons = body.photons_per_radiance * 2.0 * 19.0
    np.testing.assert_allclose(sweep.values, 40.0 / photons, rtol=1e-6)
    corners = np.array([[0.0, 0.0], [256.0, 0.0], [256.0, 192.0], [0.0, 192.0]])
    chart = ChartCapture("chart.tif", 2.0, [frame], "A", corners, wavelength, np.tile(slit, (24, 1)))
    charts = measure_charts([chart], sweep.nodes, body, sensor)
    np.testing.assert_allclose(charts.values, 64.0 + 40.0)
    np.testing.assert_allclose(charts.photons.sum(axis=-1), photons, rtol=2e-3)  # the lens loses a little off the axis


def test_smoothing_is_the_middle_of_the_plateau() -> None:
    deltas = np.geomspace(1e-4, 1e4, 9)
    errors = np.array([2.0, 1.01, 1.04, 1.0, 1.02, 1.3, 1.0, 3.0, 9.0])
    assert responsivity.choose_smoothing(deltas, errors) == pytest.approx(np.sqrt(1e-3 * 1e0))


def test_bands_cover_what_noise_does() -> None:
    """Pooled over draws, close to 95 % of the truth lies within the band: declared drift and visible noise both count."""
    rng = np.random.default_rng(3)
    nodes = np.arange(400.0, 701.0, 5.0)
    centres = np.arange(410.0, 691.0, 10.0)
    fine = np.arange(400.0, 701.0, 1.0)
    design = responsivity.node_photons(fine, triangles(centres, fine, 10.0), nodes)
    design /= design.sum(axis=1, keepdims=True)
    truth = np.exp(-0.5 * ((nodes - 540.0) / 40.0) ** 2)
    inside = []
    for _ in range(20):
        values = (design @ truth * (1 + rng.normal(0, 0.005, centres.size)) + rng.normal(0, 0.002, centres.size))[:, None]
        sweep = responsivity.Sweep(nodes, design, values, np.ones_like(values, dtype=bool))
        curve = responsivity.solve_channels(sweep, 1e-3)
        band = responsivity.confidence_bands(sweep, curve, 1e-3, 0.005, 0.0)
        inside.append(np.abs(curve[0] - truth) <= band[0])
    assert 0.85 < np.mean(inside) <= 1.0
    assert band.max() < 0.1
    shifted = responsivity.confidence_bands(sweep, curve, 1e-3, 0.005, 2.0)
    assert shifted[0, nodes == 500.0] > 1.3 * band[0, nodes == 500.0]  # the flank suffers from a wrong wavelength


def test_eq2_is_exact_without_noise_and_never_negative() -> None:
    photons = np.linspace(10.0, 90.0, 24)
    alpha, beta = responsivity.fit_gain(photons, 3.5 * photons + 70.0, 64.0)
    assert alpha == pytest.approx(3.5, rel=1e-9)
    assert beta == pytest.approx(70.0, rel=1e-9)
    assert responsivity.fit_gain(photons, 500.0 - photons, 64.0)[0] == pytest.approx(0.0, abs=1e-6)


def test_eq2_trusts_the_dark_patches() -> None:
    """A bright patch that is off by 2 % must not move the offset by a DN (it would, unweighted)."""
    photons = np.geomspace(3.0, 100.0, 24)
    values = 20.0 * photons + 64.0
    values[-1] *= 1.02
    assert abs(responsivity.fit_gain(photons, values, 64.0)[1] - 64.0) < 0.3
    assert abs(np.polyfit(photons, values, 1)[1] - 64.0) > 1.0


def test_cross_validation_predicts_a_chart_from_the_others() -> None:
    photons = np.random.default_rng(0).uniform(10, 100, (3, 24))
    values = 5.0 * photons + 64.0
    assert responsivity.cross_validate(photons, values, 64.0) < 1e-9
    values[0] = 5.5 * photons[0] + 64.0
    assert 0.03 < responsivity.cross_validate(photons, values, 64.0) < 0.15


def test_patches_are_located_in_a_turned_chart_in_perspective() -> None:
    corners = np.array([[30.0, 40.0], [280.0, 20.0], [260.0, 190.0], [50.0, 170.0]])
    patches = responsivity.patch_map(corners, 220, 320)

    def along(x: float, y: float) -> tuple[int, int]:
        """Pixel of chart position 0…1 by intersecting lines through the corners' diagonals, patch by patch."""
        matrix = np.array(
            [
                equation
                for (u, v), (col, row) in zip([(0, 0), (1, 0), (1, 1), (0, 1)], corners, strict=True)
                for equation in (
                    [u, v, 1, 0, 0, 0, -col * u, -col * v, -col],
                    [0, 0, 0, u, v, 1, -row * u, -row * v, -row],
                )
            ]
        )
        solution = np.linalg.svd(matrix)[2][-1].reshape(3, 3)
        col, row, scale = solution @ (x, y, 1.0)
        return round(row / scale), round(col / scale)

    for patch in range(24):
        y, x = divmod(patch, 6)
        assert patches[along((x + 0.5) / 6, (y + 0.5) / 4)] == patch
        assert patches[along((x + 0.02) / 6, (y + 0.5) / 4)] == 24
    assert (patches[:15] == 24).all()


def test_patches_of_a_capture_do_not_depend_on_the_captures_before(body: Body) -> None:
    """Captures may differ in their defective pixels and in the place of the chart."""
    values = np.random.default_rng(0).integers(0, 4000, (body.rows, body.cols)).astype(np.uint16)
    size = np.array([body.cols, body.rows])
    whole, part = (size * scale * [[0, 0], [1, 0], [1, 1], [0, 1]] for scale in (1.0, 0.8))
    half = np.argwhere(np.indices(values.shape)[1] % 4 < 2)  # columns of defective pixels

    def measured(corners: np.ndarray, defects: np.ndarray) -> np.ndarray:
        capture = ChartCapture("chart", 0.1, [values], "A", corners, np.zeros(0), np.zeros((24, 0)))
        return responsivity.patch_values(capture, body, 4095.0, defects)[0]

    first, *others = (measured(*each) for each in ((whole, no_defects()), (whole, half), (part, no_defects())))
    for other in others:
        assert (other != first).all()
    assert np.array_equal(measured(whole, no_defects()), first)
    assert np.array_equal(measured(whole, half), others[0])
    assert np.array_equal(measured(whole, no_defects()), first)


# ---------------------------------------------------------------------------------------------------------- noise


def drawn(mean: np.ndarray, sigma: float, trials: int, rng: np.random.Generator) -> list[np.ndarray]:
    frames = mean + rng.normal(0, sigma, (trials, *mean.shape)) + rng.normal(0, 1.0, (trials, 1, 1))
    return [np.rint(frame).astype(np.uint16) for frame in frames]


def test_temporal_variance_knows_no_fixed_pattern_and_no_drift(body: Body) -> None:
    rng = np.random.default_rng(0)
    pattern = 500.0 + rng.normal(0, 50.0, (192, 256))
    level = measure_level(Capture("flat", 0.1, drawn(pattern, 4.0, 4, rng)), body, no_defects())
    assert level.trials == 4
    np.testing.assert_allclose(level.variance, 16.0 + 1 / 12, rtol=0.05)
    np.testing.assert_allclose(mean_value(level.counts), 500.0, atol=2.0)


def test_dark_frames_give_read_noise_dark_current_and_dsnu(body: Body) -> None:
    """Few trials and a small DSNU: forgetting the estimator's variance would add 40 %, row and column noise more."""
    rng = np.random.default_rng(1)
    offsets = 64.0 + rng.normal(0, 1.0, (192, 256)) + rng.normal(0, 3.0, 256) + rng.normal(0, 3.0, (192, 1))
    offsets[100, 50], offsets[101, 51] = 900.0, 20.0  # stuck pixels alone would make the DSNU 4 DN
    captures = [
        Capture(f"{t}", t, drawn(offsets + 5.0 * t, np.sqrt(2.0**2 + 1.5 * t), 2, rng)) for t in (0.1, 1.0, 2.0, 3.0)
    ]
    dark = noise.dark_noise(captures, body)
    np.testing.assert_allclose(np.sqrt(dark.variance), 2.0, rtol=0.03)
    np.testing.assert_allclose(dark.dsnu, 1.0, rtol=0.05)
    assert dark.hot.tolist() == [[100, 50], [101, 51]]
    np.testing.assert_allclose(dark.slope, 5.0, atol=1.5)  # frames drift by 1 DN
    np.testing.assert_allclose(dark.black_level, 64.0, atol=3.0)


@pytest.mark.parametrize("line_noise", [0.0, 2.0])
def test_noise_of_rows_and_columns_that_changes_from_frame_to_frame_is_no_dsnu(body: Body, line_noise: float) -> None:
    """It belongs to the read noise. Row and column noise of 2 DN once made a DSNU of 1 DN 0."""
    rng = np.random.default_rng(4)
    offsets = 64.0 + rng.normal(0, 1.0, (192, 256))

    def frame(mean: np.ndarray) -> np.ndarray:
        lines = rng.normal(0, line_noise, (192, 1)) + rng.normal(0, line_noise, 256)
        return np.rint(mean + rng.normal(0, 2.0, mean.shape) + lines).astype(np.uint16)

    captures = [Capture(f"{t}", t, [frame(offsets) for _ in range(4)]) for t in (0.1, 1.0, 2.0, 3.0)]
    dark = noise.dark_noise(captures, body)
    np.testing.assert_allclose(np.sqrt(dark.variance), np.sqrt(2.0**2 + 2 * line_noise**2), rtol=0.06)
    np.testing.assert_allclose(dark.dsnu, 1.0, rtol=0.03)


def white_levels(well: float, exposures: list[float], trials: int) -> tuple[list[Capture], np.ndarray]:
    """White frames of K = 0.25 DN/e-, PRNU 1 %, light falling off by a third, that clip at `well` electrons."""
    rng = np.random.default_rng(2)
    response = 1.0 + rng.normal(0, 0.01, (192, 256))
    y, x = np.linspace(-1, 1, 192), np.linspace(-1, 1, 256)
    light = 12000.0 * (1.0 - (y[:, None] ** 2 + x**2) / 6.0)

    def frame(exposure: float) -> np.ndarray:
        electrons = rng.poisson(light * exposure) * response
        return np.rint(np.minimum(electrons, well) * 0.25 + 64.0).astype(np.uint16)

    return [Capture(f"{t}", t, [frame(t) for _ in range(trials)]) for t in exposures], response


def test_photon_transfer_stops_where_the_well_is_full(body: Body) -> None:
    captures, _ = white_levels(9000.0, [0.1, 0.25, 0.4, 0.55, 0.74, 2.0], trials=4)
    levels = [measure_level(capture, body, no_defects()) for capture in captures]
    transfer = noise.photon_transfer(levels, body, DARK)
    assert transfer.white_level == 9000 * 0.25 + 64
    assert transfer.white_level_reached
    assert transfer.used.tolist() == [[True] * 3] * 4 + [[False] * 3] * 2  # 0.74: the brightest pixels are full
    np.testing.assert_allclose(transfer.gain, 0.25, rtol=0.02)
    everything = np.polyfit(transfer.mean[:, 1], transfer.variance[:, 1], 1)[0]
    assert abs(everything / 0.25 - 1) > 0.2  # what counting the full wells in would do


def test_prnu_of_uneven_light(body: Body) -> None:
    captures, response = white_levels(9000.0, [0.1, 0.25, 0.4, 0.55], trials=20)
    levels = [measure_level(capture, body, no_defects()) for capture in captures]
    found = noise.response_noise(captures, levels, np.ones((4, 3), dtype=bool), body, DARK)
    assert not found.dead.size
    assert (found.rows.deviation, found.columns.deviation) == (0, 0)
    sites = (response[0::2, 0::2], np.stack([response[0::2, 1::2], response[1::2, 0::2]]), response[1::2, 1::2])
    # Known to ~0.4 %; a local mean that shrinks what it is subtracted from would cost 1 %.
    assert np.mean(found.prnu / [site.std() for site in sites]) == pytest.approx(1.0, abs=0.006)


def test_single_frames_and_single_exposures_are_refused(body: Body) -> None:
    frame = np.full((192, 256), 64, dtype=np.uint16)
    with pytest.raises(InputFileError, match=r"alone\.tif"):
        measure_level(Capture("alone.tif", 0.1, [frame]), body, no_defects())
    with pytest.raises(InputFileError, match="all dark frames have the same exposure"):
        noise.dark_noise([Capture("a", 0.1, [frame, frame])], body)
    captures, _ = white_levels(9000.0, [0.3, 0.3], trials=2)
    with pytest.raises(InputFileError, match="channel r "):
        noise.photon_transfer([measure_level(capture, body, no_defects()) for capture in captures], body, DARK)


def test_a_saturated_patch_is_named(body: Body) -> None:
    frame = np.full((192, 256), 500, dtype=np.uint16)
    frame[144:, :43] = 4000  # patch 19
    corners = np.array([[0.0, 0.0], [256.0, 0.0], [256.0, 192.0], [0.0, 192.0]])
    wavelength, radiance = np.arange(400.0, 701.0), np.ones((24, 301))
    chart = ChartCapture("chart.tif", 0.1, [frame], "A", corners, wavelength, radiance)
    with pytest.raises(InputFileError, match=r"chart\.tif: patch 19 "):
        responsivity.unsaturated_values(chart, body, 3900.0, no_defects())
    dark = replace(chart, frames=[np.minimum(frame, 1000)])
    assert responsivity.unsaturated_values(dark, body, 3900.0, no_defects())[18, 0] == 1000


WHITE, BLACK = 3800.0, 100.0
RESPONSE = np.array([[0.05, 0.2, 1.0], [0.1, 0.8, 0.1]])  # (band, channel)
REFLECTANCE = np.linspace(0.05, 0.9, 24)
CORNERS = np.array([[0.0, 0.0], [256.0, 0.0], [256.0, 192.0], [0.0, 192.0]])
WAVELENGTH = np.arange(400.0, 601.0)


def capture(band: int, exposure: float, body: Body, monitor: float = 1.0) -> BandCapture:
    """Light falls off by a third from left to right; the dark value grows by 40 DN a second."""
    shape = np.exp(-0.5 * ((WAVELENGTH - (450.0, 550.0)[band]) / 5.0) ** 2)
    patch = (np.arange(192)[:, None] * CHART_ROWS // 192) * CHART_COLS + np.arange(256) * CHART_COLS // 256
    light = REFLECTANCE[patch] * (1.0 - (patch % CHART_COLS) / 15.0)
    channel = body.cfa[np.ix_(np.arange(192) % 2, np.arange(256) % 2)]
    signal = 20000.0 * RESPONSE[band][channel] * light * exposure * monitor
    frame = np.rint(np.minimum(BLACK + 40.0 * exposure + signal, WHITE)).astype(np.uint16)
    radiance = REFLECTANCE[:, None] * shape
    name, light_name = f"{band}_{exposure}.tif", f"band {band}"
    return BandCapture(name, exposure, [frame], light_name, CORNERS, WAVELENGTH, radiance, monitor=monitor)


def darks(exposures: list[float]) -> list[Capture]:
    frames = [np.full((192, 256), BLACK + 40.0 * t, dtype=np.uint16) for t in exposures]
    return [Capture(f"dark {t}", t, [frame]) for t, frame in zip(exposures, frames, strict=True)]


def test_responses_come_back_and_exposures_predict_each_other(body: Body) -> None:
    captures = [capture(band, t, body) for t in (0.05, 0.1, 0.5) for band in (1, 0)]
    captures.append(capture(0, 0.2, body, monitor=0.9))
    curves, fit = fit_series(captures, darks([0.5, 0.05]), body, BLACK, WHITE)
    assert fit.lights == ("band 0", "band 1")
    np.testing.assert_allclose(curves.wavelength, [450.0, 550.0], atol=0.1)
    np.testing.assert_allclose(fit.response, RESPONSE, rtol=0.005)
    np.testing.assert_allclose(curves.relative, RESPONSE.T, rtol=0.005)
    assert fit.spread.max() < 0.02  # rounding of small values; the uneven light is taken out
    assert fit.r_squared.min() > 0.9999
    assert fit.relative_rmse.max() < 0.01  # frames are rounded
    assert fit.linearity_error.max() < 0.001
    assert any("0_0.5.tif: patches saturated" in line and "in b" in line for line in fit.left_out)
    assert not any("0_0.05.tif" in line for line in fit.left_out)
    longest = next(i for i, c in enumerate(captures) if c.name == "0_0.5.tif")
    assert not fit.used[longest, 12:, 2].any()
    assert fit.used[longest, :, 0].all()
    figures = SensorFigures(1.0, BLACK, WHITE, Noise(4.0, 0.0, 0.0, 0.0, 4000.0))
    measured = Measurements(body, bands=tuple(captures), darks=tuple(darks([0.5, 0.05])), datasheet=figures)
    stated = dataclasses.replace(measured, lamp_drift=0.01)
    known, more = (from_data_sheet(each, figures).responsivity_band for each in (measured, stated))
    np.testing.assert_allclose(known, curves.band)
    np.testing.assert_allclose(more, np.hypot(curves.band, 0.0196 * curves.relative))  # [uncertainty] widens it


def test_a_capture_has_no_part_in_its_prediction(body: Body) -> None:
    """One lamp 10 % brighter than its monitor says: predicted from the others, the capture stands out by that much."""
    captures = [capture(0, t, body) for t in (0.03, 0.06, 0.1)]
    captures[2] = dataclasses.replace(capture(0, 0.1, body, monitor=1.1), monitor=1.0)
    _, fit = fit_series([*captures, capture(1, 0.05, body), capture(1, 0.1, body)], darks([0.03, 0.1]), body, BLACK, WHITE)
    np.testing.assert_allclose(fit.measured[2, :, 2] / fit.predicted[2, :, 2], 1.1, rtol=0.01)


def test_a_nonlinear_channel_shows(body: Body) -> None:
    altered = []
    for t in (0.03, 0.06, 0.1, 0.15):
        taken = capture(0, t, body)
        frame = next(iter(taken.frames)).astype(float)
        blue = frame[1::2, 1::2] - BLACK
        frame[1::2, 1::2] = BLACK + blue * (1.0 - 3e-5 * blue)
        altered.append(dataclasses.replace(taken, frames=[np.rint(frame).astype(np.uint16)]))
    other = [capture(1, t, body) for t in (0.05, 0.1, 0.2)]
    _, fit = fit_series([*altered, *other], darks([0.03, 0.2]), body, BLACK, WHITE)
    assert fit.relative_rmse[2] > 0.01
    assert fit.linearity_error[2] > 5 * fit.linearity_error[1]


def test_a_band_without_two_usable_exposures_is_named(body: Body) -> None:
    captures = [capture(band, t, body) for band in (0, 1) for t in (0.05, 0.1)]
    with pytest.raises(InputFileError, match="filter band 1"):
        fit_series(captures[:3], [], body, BLACK, WHITE)
    full = [dataclasses.replace(c, frames=[np.full((192, 256), 3800, dtype=np.uint16)]) for c in captures]
    with pytest.raises(InputFileError, match="filter band 0"):
        fit_series(full, [], body, BLACK, WHITE)
