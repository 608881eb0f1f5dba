"""`l3 calibrate` with photos of a chart: outputs, messages, and one line for each mistake."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.store import load
from l3cli.calibration.photo.estimate import WAVELENGTH
from l3cli.io.pictures.dng import write_dng
from l3cli.physics import spectra
from tests.helpers import photos
from tests.helpers.calls import L3, Refused

BLACK, WHITE = 256, 4095
FILE = f"""name = "drawn"
[sensor]
rows = 600
cols = 800
pixel_pitch_um = 4.0
bits = 12
[cfa]
channels = ["r", "g", "b"]
pattern = ["r g", "g b"]
[optics]
focal_length_mm = 50
f_number = 4
[datasheet]
black_level_dn = {BLACK}
white_level_dn = {WHITE}
well_capacity_e = 7600
read_noise_e = 8
"""
CORNERS = f"corners = {photos.UPRIGHT.tolist()}\n"  # to find them takes longer than all else


def mosaic(seed: int = 0, light: str = "D65", scale: float = 1.0) -> np.ndarray:
    values = scale * photos.photograph(photos.UPRIGHT, np.random.default_rng(seed), light_name=light)
    return np.clip(np.rint(values + BLACK), 0, WHITE).astype(np.uint16)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Photos of a chart as .npy, under two lights, and one that is clipped; and none."""
    path = tmp_path_factory.mktemp("photos")
    np.save(path / "d65.npy", mosaic())
    np.save(path / "a.npy", mosaic(1, "A"))
    np.save(path / "clipped.npy", mosaic(scale=12.0))
    np.save(path / "none.npy", np.full((600, 800), 700, np.uint16))
    np.save(path / "small.npy", mosaic()[:300, :300])
    (path / "table.csv").write_text("nm,light\n450,1\n650,1\n")
    return path


def measured(folder: Path, text: str, head: str = FILE) -> Path:
    path = folder / "photo.toml"
    path.write_text(head + text)
    return path


def test_a_dng_alone_makes_a_camera(folder: Path, bayer: CameraModel, tmp_path: Path, l3: L3) -> None:
    cfa = np.array([[0, 1], [1, 2]], np.uint8)
    camera = replace(bayer, rows=600, cols=800, bits=12, black_level=float(BLACK), white_level=float(WHITE), cfa=cfa)
    colour = {"A": np.eye(3), "D65": np.eye(3)}
    write_dng(tmp_path / "chart.dng", mosaic(), camera, colour, None, 0.01)
    code, out, err = l3("calibrate", "--photo", tmp_path / "chart.dng", "--light", "D65", "-o", tmp_path / "camera.h5")
    assert code == 0, err
    model = load(CameraModel, tmp_path / "camera.h5")
    assert (model.channels, model.bits, model.black_level) == (("r", "g", "b"), 12, BLACK)
    assert model.gain == pytest.approx(photos.GAIN, rel=0.1)
    truth = photos.drawn(1)
    truth = truth / truth.max()
    assert np.sqrt(np.mean((model.responsivity - truth) ** 2)) < 0.05
    assert np.mean(np.abs(model.responsivity - truth) <= model.responsivity_band + 0.005) > 0.85
    assert "chart.dng: classic, illuminant D65" in out
    assert "a further photo under" in out
    assert "not measured, assumed to be 0: dark current, DSNU, PRNU" in out
    code, out, err = l3("calibrate", "--photo", tmp_path / "chart.dng", "-o", tmp_path / "guessed.h5", "--json")
    assert code == 0, err
    photo = json.loads(out)["photos"]["chart.dng"]
    assert photo["guessed"]
    assert photo["light"] in ("D50", "D55", "D65", "D75")
    assert sum(photo["probable lights"].values()) == pytest.approx(1)
    assert photo["light"] == next(iter(photo["probable lights"]))
    assert photo["probable lights"]["D65"] > 0.1
    assert l3("export", tmp_path / "guessed.h5", "-o", tmp_path / "exported")[0] == 0
    offsets = tifffile.imread(tmp_path / "exported/chart_offsets.tif")
    assert offsets.shape == (2, 600, 800)
    assert abs(float(offsets.mean()) - BLACK) < 100


def test_glare_of_a_photo_that_begins_at_another_site(bayer: CameraModel, tmp_path: Path, l3: L3) -> None:
    cfa = np.array([[0, 1], [1, 2]], np.uint8)
    camera = replace(bayer, rows=600, cols=800, bits=12, black_level=float(BLACK), white_level=float(WHITE), cfa=cfa)
    write_dng(tmp_path / "chart.dng", mosaic(), camera, {"A": np.eye(3), "D65": np.eye(3)}, None, 0.01)
    head = FILE.replace('"r g", "g b"', '"g r", "b g"').replace("cols = 800", "cols = 802")
    path = measured(tmp_path, '[photo]\nframes = ["chart.dng"]\nlight = "D65"\n', head)
    assert l3("calibrate", path, "-o", tmp_path / "camera.h5", "--quiet")[0] == 0
    assert l3("export", tmp_path / "camera.h5", "-o", tmp_path / "out", "--quiet")[0] == 0
    model = load(CameraModel, tmp_path / "camera.h5")
    assert model.fit is not None
    assert model.fit.photo is not None
    offsets = np.rint(model.black_level + model.fit.photo.glare[0])
    assert len(set(offsets)) > 1
    for page in tifffile.imread(tmp_path / "out/chart_offsets.tif"):
        np.testing.assert_array_equal(page, offsets[np.tile(cfa, (300, 400))])


def test_a_file_of_another_array_is_refused(bayer: CameraModel, tmp_path: Path, refused: Refused) -> None:
    cfa = np.array([[0, 1], [1, 2]], np.uint8)
    camera = replace(bayer, rows=600, cols=800, bits=12, black_level=float(BLACK), white_level=float(WHITE), cfa=cfa)
    write_dng(tmp_path / "chart.dng", mosaic(), camera, {"A": np.eye(3), "D65": np.eye(3)}, None, 0.01)
    head = FILE.replace('["r", "g", "b"]', '["c", "m", "y"]').replace('"r g", "g b"', '"c m", "m y"')
    path = measured(tmp_path, '[photo]\nframes = ["chart.dng"]\n', head)
    line = refused(3, "calibrate", path, "-o", tmp_path / "camera.h5")
    assert "cfa.pattern" in line


def test_two_lights_corners_and_a_data_sheet(folder: Path, tmp_path: Path, l3: L3) -> None:
    text = f'[[photo]]\nframes = ["d65.npy"]\nlight = "D65"\nchart = "classic ISO 17321"\n{CORNERS}'
    text += '[[photo]]\nframes = ["a.npy"]\nlight = "A"\nchart = "classic ISO 17321"\n' + CORNERS
    code, _, err = l3("calibrate", measured(folder, text), "-o", tmp_path / "camera.h5")
    assert code == 0, err
    camera = load(CameraModel, tmp_path / "camera.h5")
    assert camera.fit is not None
    assert camera.fit.photo is not None
    assert camera.fit.photo.lights == ("D65", "A")
    assert camera.noise.read_noise == 8
    assert camera.declared == ("gain", "noise")
    size, surfaces = WAVELENGTH.size, spectra.reflectance_library(WAVELENGTH)[::9]
    stimuli = surfaces * spectra.illuminant("4000K", WAVELENGTH)
    for truth, ours in zip(photos.drawn(1), camera.responsivity, strict=True):
        assert ours.size == size
        true, got = stimuli @ truth, stimuli @ ours
        assert np.sqrt(np.mean((got * true.sum() / got.sum() - true) ** 2)) < 0.01 * true.max()


def test_a_light_that_is_named_is_used_and_what_contradicts_it_is_a_warning(folder: Path, tmp_path: Path, l3: L3) -> None:
    path = measured(folder, f'[photo]\nframes = ["a.npy"]\nlight = "D65"\nchart = "classic ISO 17321"\n{CORNERS}')
    code, out, err = l3("calibrate", path, "-o", tmp_path / "camera.h5", "--json")
    assert code == 0, err
    (warning,) = json.loads(out)["run"]["warnings"]
    assert "a.npy" in warning
    photo = json.loads(out)["photos"]["a.npy"]
    assert (photo["light"], photo["guessed"]) == ("D65", False)
    assert photo["deficit"] > 3
    assert photo["nearest"] in ("A", "2400K", "3200K")
    true = path.with_name("true.toml")
    true.write_text(path.read_text().replace('"D65"', '"A"'))
    code, out, err = l3("calibrate", true, "-o", tmp_path / "camera.h5", "--json", "--force")
    assert (code, json.loads(out)["run"]["warnings"]) == (0, [])


def test_reflectances_and_light_of_csv_files(folder: Path, tmp_path: Path, l3: L3) -> None:
    names = ",".join(f"patch_{number + 1} (%)" for number in range(24))
    rows = np.column_stack([WAVELENGTH, 100.0 * photos.REFLECTANCE.T])
    (folder / "chart.csv").write_text(f"nm,{names}\n" + "\n".join(",".join(f"{x:.6g}" for x in row) for row in rows))
    grid = np.arange(380.0, 781.0, 5.0)
    lamp = np.column_stack([grid, spectra.illuminant("A", grid)])
    (folder / "lamp.csv").write_text("nm,lamp (photons/s/sr/m²/nm)\n" + "\n".join(f"{nm:g},{x:.6g}" for nm, x in lamp))
    text = f'[photo]\nframes = ["a.npy", "a.npy"]\nlight = "lamp.csv"\nchart = "chart.csv"\n{CORNERS}'
    code, out, err = l3("calibrate", measured(folder, text), "-o", tmp_path / "camera.h5", "--json")
    assert code == 0, err
    photo = json.loads(out)["photos"]["a.npy"]
    assert (photo["chart"], photo["light"]) == ("chart", "lamp.csv")
    assert max(photo["misfit %"]) < 1


def test_a_white_shot_and_a_dark_one(folder: Path, tmp_path: Path, l3: L3) -> None:
    slope = np.linspace(1.0, 0.7, 800)
    np.save(folder / "slanted.npy", np.rint((mosaic() - BLACK) * slope + BLACK).clip(0).astype(np.uint16))
    noise = np.random.default_rng(3).standard_normal((600, 800))
    np.save(folder / "white.npy", np.rint(2000 * slope + BLACK + 20 * noise).astype(np.uint16))
    np.save(folder / "dark.npy", np.rint(BLACK + 4 * noise).astype(np.uint16))
    text = f'[photo]\nframes = ["slanted.npy"]\nlight = "D65"\nchart = "classic ISO 17321"\n{CORNERS}'
    text += 'white = ["white.npy"]\ndark = ["dark.npy"]\n'
    code, out, err = l3("calibrate", measured(folder, text), "-o", tmp_path / "camera.h5", "--json")
    assert code == 0, err
    result = json.loads(out)
    assert result["camera"]["black level"]["value"] == pytest.approx(BLACK, abs=0.5)
    assert result["photos"]["slanted.npy"]["uneven %"] < 3


@pytest.mark.parametrize(
    ("text", "code", "words"),
    [
        ('frames = ["none.npy"]', 3, "no chart with 4×6 patches"),
        ('frames = ["clipped.npy"]\nCORNERS', 3, "shorten the exposure"),
        ('frames = ["d65.npy"]\nlight = "D66"', 2, '"D66" is unknown'),
        ('frames = ["d65.npy"]\nlight = "table.csv"', 3, "from 400 to 700 nm"),
        ('frames = ["d65.npy"]\nchart = "clasic"', 2, 'did you mean "classic"'),
        ('frames = ["d65.npy"]\nlayout = [10, 14]', 2, "layout = [10, 14] has 140"),
        ('frames = ["d65.npy"]\ncorners = [[1, 2], [3, 4]]', 2, "corners has 2 values; use at least 4"),
        ('frames = ["d65.npy"]\ncorners = [[0, 0], [900, 0], [900, 500], [0, 500]]', 3, "corner of the chart is outside"),
        ('frames = ["d65.npy"]\ncorners = [[10, 10], [20, 20], [30, 30], [40, 40]]', 3, "on a line"),
        ('frames = ["d65.npy"]\ncorners = [[20, 20], [160, 20], [160, 120], [20, 120]]', 3, "do not resemble the patches"),
        ('frames = ["d65.npy"]\nlayout = [6, 4]\ncorners = [[20, 20], [160, 20], [160, 120], [20, 120]]', 3, "4, 24 and 21"),
        ('frames = ["d65.npy", "small.npy"]', 3, "differ in size or CFA phase"),
        ("frames = []", 2, "frames has 0 values; use at least 1"),
        ('frames = ["missing.npy"]', 3, "missing.npy does not exist"),
        ('frames = ["table.csv"]', 3, "table.csv"),
    ],
)
def test_one_line_for_every_mistake(
    folder: Path, text: str, code: int, words: str, tmp_path: Path, refused: Refused
) -> None:
    text = text.replace("CORNERS", CORNERS)
    assert words in refused(code, "calibrate", measured(folder, f"[photo]\n{text}\n"), "-o", tmp_path / "camera.h5")


def test_wrong_calls(folder: Path, tmp_path: Path, refused: Refused) -> None:
    path = measured(folder, '[photo]\nframes = ["d65.npy"]\n')
    assert "--photo" in refused(2, "calibrate", "-o", tmp_path / "camera.h5")
    assert "--photo" in refused(2, "calibrate", path, "--photo", folder / "d65.npy", "-o", tmp_path / "camera.h5")
    assert "--light" in refused(2, "calibrate", path, "--light", "A", "-o", tmp_path / "camera.h5")
    line = refused(3, "calibrate", "--photo", folder / "d65.npy", "-o", tmp_path / "camera.h5")
    assert "d65.npy" in line


def test_levels_that_nobody_states(folder: Path, tmp_path: Path, refused: Refused) -> None:
    path = measured(folder, '[photo]\nframes = ["d65.npy"]\n', FILE.partition("[datasheet]")[0])
    assert "d65.npy" in refused(3, "calibrate", path, "-o", tmp_path / "camera.h5")
    dark = '[[photo]]\nframes = ["a.npy"]\ndark = ["none.npy"]\n'  # says nothing of the other photo
    path = measured(folder, dark + '[[photo]]\nframes = ["d65.npy"]\n', FILE.partition("[datasheet]")[0])
    assert "d65.npy" in refused(3, "calibrate", path, "-o", tmp_path / "camera.h5")


def test_a_prior_of_a_folder(folder: Path, tmp_path: Path, l3: L3, refused: Refused) -> None:
    (folder / "cameras").mkdir(exist_ok=True)
    for seed in range(12):
        curves = photos.drawn(seed) * WAVELENGTH
        rows = "\n".join(",".join(f"{value:.6g}" for value in row) for row in np.column_stack([WAVELENGTH, curves.T]))
        (folder / f"cameras/{seed}.csv").write_text(f"nm,r,g,b\n{rows}\n")
    path = measured(folder, f'[photo]\nframes = ["d65.npy"]\nlight = "D65"\n{CORNERS}', 'prior = "cameras"\n' + FILE)
    code, out, err = l3("calibrate", path, "-o", tmp_path / "camera.h5")
    assert code == 0, err
    assert "prior of the curves" in out
    path = measured(folder, '[photo]\nframes = ["d65.npy"]\n', 'prior = "nowhere"\n' + FILE)
    assert "use a folder with the curves of 8 to" in refused(3, "calibrate", path, "-o", tmp_path / "other.h5")
