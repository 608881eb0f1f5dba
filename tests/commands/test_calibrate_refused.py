"""Measurements that cannot be used: one line that names the culprit, the right exit code, and no output."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.store import load
from l3cli.io.frames import read_frame
from l3cli.io.pictures.openimageio import write_mosaic
from tests.helpers.calls import L3, Refused
from tests.helpers.hostile_inputs import TABLE
from tests.helpers.paths import CONFIGS


@pytest.fixture
def folder(lab_folder: Path) -> Path:
    return lab_folder


@pytest.fixture
def bayer(fine_bayer_recipe: Path) -> CameraModel:
    return load_camera(fine_bayer_recipe)


@pytest.fixture
def copied(lab_folder: Path, tmp_path: Path) -> Path:
    """A copy of the lab's folder, to be spoilt."""
    return Path(shutil.copytree(lab_folder, tmp_path / "lab"))


def edit(folder: Path, old: str, new: str, count: int = 1) -> None:
    path = folder / "MEASUREMENTS.toml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, count))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("exposure_s", "exposure", "[mono"),
        ("pixel_pitch_um = 4.0\n", "", "`pixel_pitch_um`"),
        ("[[dark]]", "[[darkness]]", "`darkness`"),
        ("bits = 12", "bits = 99", "sensor.bits"),
        ("rows = 192", "rows = 12", "too few"),
        ('column = "410nm"', "column = 999", "spectra/mono.csv"),
        ('"g b"', '"g x"', '"x"'),
        ("[sensor]", "[sensor", "MEASUREMENTS.toml"),
        ("f_number = 2.8", "f_number = 0", "optics.f_number"),
        ("object_distance_m = 0.0", "object_distance_m = 0.01", "not larger than the focal length"),
        ("exposure_s = ", "exposure_s = -", "exposure_s"),
        ("exposure_s = ", "exposure_s = nan #", "mono.exposure_s"),
        ("monitor = ", "monitor = inf #", "mono.monitor"),
        (
            "[sensor]",
            "[datasheet]\nwell_capacity_e = 1\nblack_level_dn = 0\nwhite_level_dn = 1\n[sensor]",
            "[datasheet]",
        ),
        ("[sensor]", '[curves]\nfile = "x.csv"\n[sensor]', "curves"),
        ("lamp_drift = ", "lamp_drift = -", "lamp_drift"),
    ],
)
def test_wrong_keys_are_recipe_errors(
    old: str, new: str, words: str, copied: Path, tmp_path: Path, refused: Refused
) -> None:
    edit(copied, old, new)
    line = refused(2, "calibrate", copied / "MEASUREMENTS.toml", "-o", tmp_path / "camera.h5")
    assert words in line
    assert "MEASUREMENTS.toml" in line


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:20000])


def too_small(path: Path) -> None:
    write_mosaic(path, np.zeros((100, 100), dtype=np.uint16))


def too_deep(path: Path) -> None:
    write_mosaic(path, np.full((192, 256), 5000, dtype=np.uint16))


def no_picture(path: Path) -> None:
    path.write_text("not a picture")


@pytest.mark.parametrize(
    ("kind", "spoil"),
    [("mono", Path.unlink), ("chart", truncate), ("white", too_small), ("dark", too_deep), ("mono", no_picture)],
)
def test_bad_frames_are_named(
    kind: str, spoil: Callable[[Path], None], copied: Path, tmp_path: Path, refused: Refused
) -> None:
    frame = sorted((copied / kind).iterdir())[1]
    spoil(frame)
    assert frame.name in refused(3, "calibrate", copied / "MEASUREMENTS.toml", "-o", tmp_path / "camera.h5")


def test_a_frame_of_another_kind_is_named(copied: Path, tmp_path: Path, refused: Refused) -> None:
    frame = sorted((copied / "dark").iterdir())[0]
    frame.write_bytes(b"P5 256 192 255\n" + bytes(192 * 256))
    line = refused(3, "calibrate", copied / "MEASUREMENTS.toml", "-o", tmp_path / "camera.h5")
    assert frame.name in line


@pytest.mark.parametrize(("name", "column"), [("mono.csv", "dark, as it were"), ("mono.csv", "nan"), ("chart_*_A.csv", "")])
def test_bad_spectra_are_named(name: str, column: str, copied: Path, tmp_path: Path, refused: Refused) -> None:
    (path,) = (copied / "spectra").glob(name)
    lines = path.read_text().splitlines()
    cells = lines[10].split(",")
    lines[10] = ",".join([*cells[:-1], column])
    path.write_text("\n".join(lines))
    assert path.name in refused(3, "calibrate", copied / "MEASUREMENTS.toml", "-o", tmp_path / "camera.h5")


def test_a_chart_needs_24_radiances(copied: Path, tmp_path: Path, refused: Refused) -> None:
    (path,) = (copied / "spectra").glob("chart_*_A.csv")
    path.write_text("\n".join(line.rpartition(",")[0] for line in path.read_text().splitlines()))
    line = refused(3, "calibrate", copied / "MEASUREMENTS.toml", "-o", tmp_path / "camera.h5")
    assert path.name in line


def test_a_missing_spectrum_is_named(copied: Path, tmp_path: Path, refused: Refused) -> None:
    (copied / "spectra/mono.csv").unlink()
    assert "mono.csv" in refused(3, "calibrate", copied / "MEASUREMENTS.toml", "-o", tmp_path / "camera.h5")


@pytest.mark.parametrize("name", ["mono.csv", "chart_*_A.csv"])
def test_spectra_that_end_too_early_are_named(name: str, copied: Path, tmp_path: Path, refused: Refused) -> None:
    (path,) = (copied / "spectra").glob(name)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], *(line for line in lines[1:] if float(line.partition(",")[0]) < 600)]))
    line = refused(3, "calibrate", copied / "MEASUREMENTS.toml", "-o", tmp_path / "camera.h5")
    assert "_A.tif" in line or "590nm" in line


def test_a_lost_channel_is_named_by_the_validation(copied: Path, tmp_path: Path, refused: Refused, l3: L3) -> None:
    """A chart whose exposure is stated 10 % too long: R² stays high, the relative RMSE does not."""
    text = (copied / "MEASUREMENTS.toml").read_text()
    before, chart = text.split("[[chart]]", 1)
    line = next(line for line in chart.splitlines() if line.startswith("exposure_s"))
    chart = chart.replace(line, f"exposure_s = {1.1 * float(line.partition('=')[2])}", 1)
    (copied / "MEASUREMENTS.toml").write_text(f"{before}[[chart]]{chart}")
    command = ("calibrate", copied / "MEASUREMENTS.toml", "-o", tmp_path / "camera.h5")
    line = refused(1, *command)
    assert "the validation of channel r has R² 0.99" in line
    assert "--accept" in line
    code, _, err = l3(*command, "--accept")
    assert code == 0
    assert "because --accept is set: the validation of channel r" in err
    assert load(CameraModel, tmp_path / "camera.h5").history[0].options == {"accept": True}


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """A sweep of four wavelengths as a table beside a photodiode."""
    folder = tmp_path / "table"
    folder.mkdir()
    (folder / "MEASUREMENTS.toml").write_text(TABLE)
    rows = [f"{nm},100,110,{90 + nm / 10},64,64,64,{nm / 10},1" for nm in (400, 500, 600, 700)]
    (folder / "sweep.csv").write_text("\n".join(["nm,light r,light g,light b,dark r,dark g,dark b,diode,dark", *rows]))
    (folder / "diode.csv").write_text("390,0.5\n710,0.9\n")
    return folder


def test_a_table_makes_a_relative_camera(table: Path, tmp_path: Path, l3: L3) -> None:
    """The photodiode's curve divides, its dark reading is lost first, and energy becomes photons."""
    (table / "MEASUREMENTS.toml").write_text(TABLE.replace("[datasheet]", "[datasheet]\ncolumn_noise_e = 0.5"))
    assert l3("calibrate", table / "MEASUREMENTS.toml", "-o", tmp_path / "camera.h5")[0] == 0
    camera = load(CameraModel, tmp_path / "camera.h5")
    wavelength = np.array([400.0, 500.0, 600.0, 700.0])
    energy = (wavelength / 10 - 1) / np.interp(wavelength, [390, 710], [0.5, 0.9])
    expected = np.array([[36.0] * 4, [46.0] * 4, 26 + wavelength / 10]) / energy / wavelength
    np.testing.assert_allclose(camera.responsivity, expected / expected.max(), rtol=1e-12)
    assert not camera.absolute
    assert camera.gain == pytest.approx((4000 - 64) / 20000)
    assert (camera.noise.read_noise, camera.noise.column_noise) == (0, 0.5)


def test_a_band_is_made_of_what_is_stated_or_there_is_none(table: Path, tmp_path: Path, l3: L3, refused: Refused) -> None:
    """Nothing in a table of means says how well it was measured: the diode's error and the wavelength's must be stated."""
    from l3cli.report.camera import responsivity_figures

    text = (table / "MEASUREMENTS.toml").read_text()
    command = ("calibrate", table / "MEASUREMENTS.toml", "-o", tmp_path / "camera.h5", "--force")

    def camera_of(stated: str) -> tuple[CameraModel, str]:
        (table / "MEASUREMENTS.toml").write_text(f"{text}\n{stated}")
        code, _, err = l3(*command)
        assert code == 0, err
        camera = load(CameraModel, tmp_path / "camera.h5")
        figures = responsivity_figures(camera)
        assert len(figures) == 1 + bool(camera.responsivity_band.any())
        assert ('fill-opacity="0.25"' in figures[0].svg) == bool(camera.responsivity_band.any())
        return camera, err

    for stated in ("", "[uncertainty]\nphotodiode = 0.01", "[uncertainty]\nwavelength_nm = 0.5"):
        camera, err = camera_of(stated)
        assert not camera.responsivity_band.any()
        assert "to compute a band, set photodiode and wavelength_nm in [uncertainty]" in err
    camera, err = camera_of("[uncertainty]\nphotodiode = 0.003\nlamp_drift = 0.004\nwavelength_nm = 0.5")
    assert "no confidence band" not in err
    slope = np.gradient(camera.responsivity, camera.wavelength, axis=1)
    expected = np.hypot(1.96 * np.hypot(0.005 * camera.responsivity, 0.5 * slope), 0.0002)
    np.testing.assert_allclose(camera.responsivity_band, expected, rtol=1e-6)
    (table / "MEASUREMENTS.toml").write_text(f"{text}\n[uncertainty]\nphotodiode = 2")
    assert "uncertainty.photodiode is" in refused(2, *command)
    finished = text.replace('[sweep]\ntable = "sweep.csv"\nphotodiode', '[curves]\nfile = "curves.csv"\n#')
    (table / "MEASUREMENTS.toml").write_text(f"{finished}\n[uncertainty]\nphotodiode = 0.01")
    assert "[sweep]" in refused(2, *command)


def test_finished_curves_are_columns_of_a_shared_file(table: Path, tmp_path: Path, l3: L3, refused: Refused) -> None:
    rows = [f"{nm},9,{nm},5,{nm + 1}" for nm in (400, 500, 600, 700)]
    (table / "curves.csv").write_text("\n".join(["nm,IR,red,g,b", *rows]))
    text = (table / "MEASUREMENTS.toml").read_text().replace('[sweep]\ntable = "sweep.csv"\nphotodiode', "[curves]\n{}\n#")
    command = ("calibrate", table / "MEASUREMENTS.toml", "-o", tmp_path / "camera.h5")
    (table / "MEASUREMENTS.toml").write_text(text.replace("{}", 'file = "curves.csv"\ncolumns = {w = "red"}'))
    assert "curves.columns" in refused(2, *command)
    (table / "MEASUREMENTS.toml").write_text(text.replace("{}", 'file = "curves.csv"\ncolumns = {r = "red"}'))
    code, _, err = l3(*command)
    assert (code, "curves.csv: columns that are not used: IR" in err) == (0, True)
    camera = load(CameraModel, tmp_path / "camera.h5")
    np.testing.assert_allclose(camera.responsivity[0], 400 / 401, rtol=1e-9)  # in proportion to wavelength: per photon flat


def test_the_last_lines_state_peaks_widths_and_files(table: Path, tmp_path: Path, l3: L3) -> None:
    rows = [
        f"{nm},{100 + 100 * (nm == 500)},{110 + 50 * (nm == 600)},{90 + nm / 10},64,64,64,50,1" for nm in range(400, 701, 50)
    ]
    (table / "sweep.csv").write_text("\n".join(rows))
    (table / "diode.csv").write_text("390,1\n710,1\n")
    camera = tmp_path / "camera.h5"
    _, out, err = l3("calibrate", table / "MEASUREMENTS.toml", "-o", camera)
    *_, title, heading, units, red, green, blue = (line.split() for line in out.splitlines())
    assert (title, heading, units) == (["curves,", "400…700", "nm"], ["channel", "peak", "FWHM"], ["nm", "nm"])
    assert (red[:2], green[:2], blue) == (["r", "500"], ["g", "600"], ["b", "400", "–"])
    assert 50 < float(red[2]) < 200
    written = f"wrote {camera}; its dataset responsivity contains the curves; to write the curves as CSV: "
    assert err.splitlines()[-1] == f"{written}l3 export {camera} -o DIR"


def test_a_photodiodes_column_is_named(table: Path, tmp_path: Path, l3: L3, refused: Refused) -> None:
    """A certificate with an uncertainty beside the response: one column, by name or number; none is guessed."""
    assert l3("calibrate", table / "MEASUREMENTS.toml", "-o", tmp_path / "one.h5", "--quiet")[0] == 0
    (table / "diode.csv").write_text("nm,response (A/W),u (%)\n390,0.5,3\n710,0.9,2\n")
    line = refused(3, "calibrate", table / "MEASUREMENTS.toml", "-o", tmp_path / "two.h5")
    assert "diode.csv" in line
    text = (table / "MEASUREMENTS.toml").read_text()
    for column in ("1", '"response"'):
        (table / "MEASUREMENTS.toml").write_text(text.replace('"diode.csv"', f'{{file = "diode.csv", column = {column}}}'))
        assert l3("calibrate", table / "MEASUREMENTS.toml", "-o", tmp_path / "two.h5", "--quiet", "--force")[0] == 0
        one, two = load(CameraModel, tmp_path / "one.h5"), load(CameraModel, tmp_path / "two.h5")
        np.testing.assert_array_equal(one.responsivity, two.responsivity)


@pytest.mark.parametrize(
    ("name", "old", "new", "code", "words"),
    [
        ("sweep.csv", "400,100", "400,text", 3, "sweep.csv"),
        ("sweep.csv", "500,100", "500,nan", 3, "sweep.csv"),
        ("sweep.csv", ",1\n600", "\n600", 3, "sweep.csv"),
        ("diode.csv", "390,", "450,", 3, "diode.csv"),
        ("diode.csv", "0.5", "-0.5", 3, "sweep.csv"),
        ("sweep.csv", "64,50.0,1", "64,1.0,1", 3, "500 nm"),
        ("MEASUREMENTS.toml", '"diode.csv"', '"none.csv"', 3, "none.csv"),
        ("MEASUREMENTS.toml", '["r", "g", "b"]', '["r", "g", "b", "w"]', 2, "cfa.pattern"),
        ("MEASUREMENTS.toml", '"r g", "g b"', '"r g", "g g"', 2, "cfa.pattern"),
        ("MEASUREMENTS.toml", "white_level_dn = 4000", "white_level_dn = 5000", 2, "white_level_dn"),
        (
            "MEASUREMENTS.toml",
            "well_capacity_e = 20000",
            "well_capacity_e = 0",
            2,
            "datasheet.well_capacity_e",
        ),
        ("MEASUREMENTS.toml", "[datasheet]", "[data_sheet]", 2, "data_sheet"),
        (
            "MEASUREMENTS.toml",
            '[sweep]\ntable = "sweep.csv"\nphotodiode',
            '[curves]\nfile = "sweep.csv"\n#',
            3,
            "sweep.csv",
        ),
        ("MEASUREMENTS.toml", '[sweep]\ntable = "sweep.csv"\nphotodiode', '[curves]\nfile = "a.json"\n#', 3, "a.json"),
    ],
)
def test_a_bad_table_is_named(
    name: str, old: str, new: str, code: int, words: str, table: Path, tmp_path: Path, refused: Refused
) -> None:
    (table / "a.json").write_text('{"spectral_data": {"data": {"main": {"400": [1, 2, "x"]}}}}')
    text = (table / name).read_text()
    assert old in text
    (table / name).write_text(text.replace(old, new, 1))
    assert words in refused(code, "calibrate", table / "MEASUREMENTS.toml", "-o", tmp_path / "camera.h5")


def test_a_table_of_other_channels_is_refused(table: Path, tmp_path: Path, refused: Refused) -> None:
    path = table / "sweep.csv"
    path.write_text("\n".join(line.rpartition(",")[0] for line in path.read_text().splitlines()))
    line = refused(3, "calibrate", table / "MEASUREMENTS.toml", "-o", tmp_path / "camera.h5")
    assert "sweep.csv" in line


def corners_of(folder: Path) -> str:
    text = (folder / "MEASUREMENTS.toml").read_text()
    return next(line for line in text.splitlines() if line.startswith("corners"))


@pytest.mark.parametrize(
    ("corners", "code", "words"),
    [
        ("corners = [[-5, 10], [240, 10], [240, 180], [10, 180]]", 3, "corner of the chart is outside"),
        ("corners = [[10, 10], [240, 10], [240, 1800], [10, 180]]", 3, "corner of the chart is outside"),
        ("corners = [[10, 10], [10, 10], [10, 10], [10, 10]]", 3, "corners"),
        ("corners = [[10, 10], [14, 10], [14, 14], [10, 14]]", 3, "too few pixels"),
        ("corners = [[10, 10], [14, 10]]", 2, "corners"),
    ],
)
def test_wrong_corners_are_named(
    corners: str, code: int, words: str, copied: Path, tmp_path: Path, refused: Refused
) -> None:
    edit(copied, corners_of(copied), corners)
    assert words in refused(code, "calibrate", copied / "MEASUREMENTS.toml", "-o", tmp_path / "camera.h5")


def test_charts_upside_down_do_not_make_a_camera(copied: Path, tmp_path: Path, refused: Refused) -> None:
    line = corners_of(copied)
    first, second, third, fourth = json.loads(line.partition("= ")[2])
    edit(copied, line, f"corners = {[third, fourth, first, second]}", count=-1)
    assert "the chart values poorly" in refused(3, "calibrate", copied / "MEASUREMENTS.toml", "-o", tmp_path / "camera.h5")


def test_saturated_captures_are_refused(copied: Path, bayer: CameraModel, tmp_path: Path, refused: Refused) -> None:
    full = np.full((bayer.rows, bayer.cols), 3814, dtype=np.uint16)
    chart = sorted((copied / "chart").iterdir())[0]
    left = read_frame(chart, (bayer.rows, bayer.cols), bayer.bits).copy()
    write_mosaic(chart, full)
    command = (3, "calibrate", copied / "MEASUREMENTS.toml", "-o", tmp_path / "camera.h5")
    assert chart.name in refused(*command)
    write_mosaic(chart, left)
    for frame in (copied / "mono").iterdir():
        write_mosaic(frame, full)
    assert "channel r" in refused(*command)
    for frame in (copied / "white").iterdir():
        write_mosaic(frame, full)
    assert "white" in refused(*command)


def test_the_truth_is_checked_first(folder: Path, tmp_path: Path, refused: Refused) -> None:
    fiveband = CONFIGS / "cameras/fiveband.toml"
    command = ("calibrate", folder / "MEASUREMENTS.toml", "-o", tmp_path / "new.h5", "--truth")
    assert "r g b o c" in refused(3, *command, fiveband)
    assert "none.h5" in refused(3, *command, tmp_path / "none.h5")
