"""Real raw files, rendered with a table for a camera with published responsivities."""

import os
import struct
from pathlib import Path

import numpy as np
import pytest

import l3cli
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.cli import run
from l3cli.io.images import read_image
from l3cli.io.raw.files import read_raw
from l3cli.physics import spectra
from l3cli.physics.display import adaptation_matrix, daylight, delta_e_2000, displayed_xyz, lab, srgb_decoded
from tests.helpers.calls import L3, Refused
from tests.helpers.tables import colorimetric_table

# The camera: published curves of the Canon 600D, whose sensor is that of the 550D that took colorchart.dng. The noise
# figures are plausible for that generation; black, white and depth are those of the file.
CAMERA = """
name = "Canon 550D by the published responsivities of the 600D"
[sensor]
rows = 1156
cols = 1734
pixel_pitch_um = 4.3
bits = 14
gain_dn_per_e = 0.6
black_level_dn = 2056
white_level_dn = 15000
[cfa]
channels = ["r", "g", "b"]
pattern = ["r g", "g b"]
[responsivity]
wavelength_nm = [400, 720, 10]
peak_efficiency = 0.35
file = "{curves}"
per_energy = true
[noise]
read_noise_e = 8.0
dsnu_e = 1.0
prnu = 0.006
well_capacity_e = 24000
[optics]
focal_length_mm = 50
f_number = 4
"""
SCENES = """
illuminants = ["A"]  # the photograph was taken indoors, by tungsten light
exposure_share = [0.9]
[[scene]]
source = "dead leaves"
size = [128, 128]
count = 12
"""
CLASSES = "[classes]\npatch = 7\n[learning]\npatches = 20000\n"
PATCH_ROWS, PATCH_COLS = (624, 722, 822, 926), (716, 820, 926, 1032, 1144, 1252)  # centres of the chart's patches, pixels


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    data = Path(os.environ.get("L3_DATA", ""))
    if not os.environ.get("L3_DATA") or not data.is_dir():
        pytest.skip("L3_DATA does not name the folder of real data")
    folder = tmp_path_factory.mktemp("canon")
    curves = data / "sensitivities/ssf-data/Canon_600D__camspec.csv"
    (folder / "camera.toml").write_text(CAMERA.format(curves=curves.resolve()))
    (folder / "scenes.toml").write_text(SCENES)
    (folder / "classes.toml").write_text(CLASSES)
    training, table = str(folder / "training.h5"), str(folder / "table.h5")
    camera = str(folder / "camera.toml")
    assert run(["simulate", str(folder / "scenes.toml"), "--camera", camera, "-o", training, "--quiet"]) == 0
    assert run(["train", training, "--classes", str(folder / "classes.toml"), "-o", table, "--quiet"]) == 0
    return folder / "table.h5"


@pytest.fixture(scope="module")
def chart(table: Path) -> np.ndarray:
    """colorchart.dng as XYZ (row, col, 3)."""
    raw = Path(os.environ["L3_DATA"]) / "raw/colorchart.dng"
    output = table.parent / "chart.exr"
    assert run(["render", str(table), str(raw), "-o", str(output)]) == 0
    return read_image(output)[0]


def patch_windows(picture: np.ndarray, half: int) -> np.ndarray:
    """(24, row, col, 3) windows about the centres of the chart's patches, dark skin first, black last."""
    return np.array([picture[row - half : row + half, col - half : col + half] for row in PATCH_ROWS for col in PATCH_COLS])


def test_the_chart_has_its_published_colours(chart: np.ndarray) -> None:
    assert chart.shape == (1156, 1734, 3)
    wavelength = np.arange(400.0, 701.0, 5.0)
    names, reflectance = spectra.colorchecker(wavelength)
    light = spectra.illuminant("D65", wavelength)
    published = reflectance @ (spectra.xyz_weights(wavelength) * light).T / (spectra.xyz_weights(wavelength)[1] @ light)
    measured = patch_windows(chart, 20).mean(axis=(1, 2))
    white = spectra.white_point("D65")
    # One fit of exposure and white: the white patch, with its published luminance, is made neutral.
    scene_white = measured[18] / published[18, 1]
    adapted = measured @ adaptation_matrix(scene_white, white).T / scene_white[1]
    ours, truth = lab(adapted, white), lab(published, white)
    difference = delta_e_2000(ours, truth)
    report = ", ".join(f"{name} {error:.1f}" for name, error in zip(names, difference, strict=True))
    print(f"mean ΔE00 {difference.mean():.2f}: {report}")
    assert difference.mean() < 6, report
    assert (np.diff(ours[18:, 0]) < -8).all()  # the greys go from white to black, left to right
    assert np.corrcoef(ours[:, 0], truth[:, 0])[0, 1] > 0.99
    coloured = np.hypot(truth[:, 1], truth[:, 2]) > 20
    hue = np.angle((ours[:, 1] + 1j * ours[:, 2]) * np.conj(truth[:, 1] + 1j * truth[:, 2]), deg=True)
    # Every hue in its place round the circle; blue is 31° off by the sister model's curves and the room's mixed light.
    assert np.abs(hue[coloured]).max() < 40


def test_plain_areas_show_no_cfa_pattern(chart: np.ndarray) -> None:
    """On each grey patch the four CFA sites differ by no more than their noise explains."""
    for window in patch_windows(chart, 24)[18:]:
        sites = [window[row::2, col::2].reshape(-1, 3) for row in (0, 1) for col in (0, 1)]
        mean = window.mean(axis=(0, 1))
        spread = np.ptp([site.mean(axis=0) for site in sites], axis=0)
        noise = np.max([site.std(axis=0) / np.sqrt(len(site)) for site in sites], axis=0)
        assert (spread < 5 * noise + 0.01 * mean[1]).all()


def test_another_phase_and_other_levels(table: Path, l3: L3) -> None:
    raw = Path(os.environ["L3_DATA"]) / "raw/kodak_dc50.kdc"
    output = table.parent / "kodak.png"
    code, _, err = l3("render", table, raw, "-o", output)
    assert code == 0, err
    picture = read_image(output)[0] / 255
    assert picture.shape == (512, 768, 3)
    assert 0.1 < picture.mean() < 0.9
    flat = picture[:, :, 1] - np.roll(picture[:, :, 1], 1, axis=1)
    # No column pattern of the mosaic; 0.006 to 0.011 by the seed of so small a table.
    assert np.abs(flat[:, ::2].mean() - flat[:, 1::2].mean()) < 0.013


def test_a_raw_file_that_is_balanced_already_gets_a_neutral_picture(tmp_path: Path, l3: L3) -> None:
    """The file's multipliers are 1, 1, 1: its grey has equal signals. By a table that shows plain areas as they are."""
    raw = Path(os.environ["L3_DATA"]) / "raw/kodak_dc50.kdc"
    assert l3("init", "--from", raw, tmp_path / "mine", "--quiet")[0] == 0
    camera = load_camera(tmp_path / "mine/camera.toml")
    grey = camera.signal_weights @ spectra.illuminant("D65", camera.wavelength)
    np.testing.assert_allclose(grey / grey.max(), 1, atol=0.01)
    save(colorimetric_table(camera), tmp_path / "table.h5")
    assert read_raw(raw, load(TransformTable, tmp_path / "table.h5")).neutral == (1.0, 1.0, 1.0)
    for white, most in (("camera", 12), ("auto", 25), ("1,1,1", 12)):
        picture = tmp_path / f"{white}.png"
        assert l3("render", tmp_path / "table.h5", raw, "--white", white, "-o", picture, "--quiet")[0] == 0
        assert np.ptp(read_image(picture)[0].reshape(-1, 3).mean(axis=0)) < most  # 60 pink without


def test_a_linear_dng_is_refused(table: Path, tmp_path: Path, refused: Refused) -> None:
    raw = Path(os.environ["L3_DATA"]) / "raw/canon_eos_6d.dng"
    assert "demosaicked" in refused(3, "render", table, raw, "-o", tmp_path / "picture.png")


def test_greys_of_the_chart_are_neutral_by_a_grey_and_by_a_file_that_states_it(table: Path, l3: L3, tmp_path: Path) -> None:
    """The camera was set to daylight (5500 K), the chart is lit by tungsten: what the file states is no grey's. A copy that
    states the neutral of the chart's second grey shows it so. Dark greys carry the glare of a blue window: 4 to 5."""
    raw = Path(os.environ["L3_DATA"]) / "raw/colorchart.dng"
    frame = l3cli.read_raw(raw, l3cli.load(table))  # type: ignore[arg-type]
    assert frame.neutral == (1.0, 2.477, 1.462)
    window = (
        frame.values[PATCH_ROWS[3] - 20 : PATCH_ROWS[3] + 20, PATCH_COLS[1] - 20 : PATCH_COLS[1] + 20] - frame.black_level
    )
    colours = {"r": window[0::2, 0::2].mean(), "g": window[0::2, 1::2].mean(), "b": window[1::2, 1::2].mean()}
    stated = struct.pack("<6I", 1000, 1000, 2477, 1000, 1462, 1000)
    content = raw.read_bytes()
    assert content.count(stated) == 1
    new = struct.pack("<6I", *(int(number) for colour in "rgb" for number in (colours[colour] * 1000, 1000)))
    (tmp_path / "stated.dng").write_bytes(content.replace(stated, new))
    grey = f"{PATCH_ROWS[3]},{PATCH_COLS[1]}"
    for file, white in ((tmp_path / "stated.dng", "camera"), (raw, grey), (raw, "chart")):
        code, _, err = l3("render", table, file, "--white", white, "--bits", 16, "-o", tmp_path / "a.tif", "--force")
        assert code == 0
        assert 2700 < float(err.split(" K,")[0].split()[-1]) < 3100
        assert ("the white balance in the file is 55" in err) == (white == "chart")
        windows = patch_windows(srgb_decoded(read_image(tmp_path / "a.tif")[0] / 65535), 18)[18:]
        chroma = np.hypot(*lab(displayed_xyz(windows.mean(axis=(1, 2))), daylight())[:, 1:].T)
        print(white, np.round(chroma, 1))
        assert chroma[:3].max() < 3
        assert chroma.max() < 6
