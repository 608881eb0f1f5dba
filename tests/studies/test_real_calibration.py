"""Calibration from published measurements: monochromator sweeps of seven cameras, and a chart behind seven filters."""

import json
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.store import load
from l3cli.io.curves import write_curves
from l3cli.spectra.file import read_table
from tests.helpers.calls import L3

SWEEPS = (
    "Canon_EOS_5D_Mark_III_001",
    "Canon_EOS_5D_Mark_III_002",
    "Lumix_GF3_001",
    "Lumix_GH1_001",
    "Pentax_ist_DL_001",
    "Samsung_NX1100_001",
    "Sony_ILCE-7M2_001",
)
SENSOR = """
[sensor]
rows = {rows}
cols = {cols}
pixel_pitch_um = {pitch}
bits = {bits}
[cfa]
channels = ["r", "g", "b"]
pattern = [{pattern}]
[optics]
focal_length_mm = 50
f_number = 4
"""


def sweep_folder(source: Path, folder: Path) -> Path:
    """A sweep as `l3 calibrate` reads it: the means of camera.dat and diode.dat in one table beside a measurement file."""
    info = (source / "info.txt").read_text().splitlines()
    camera, diode = np.loadtxt(source / "camera.dat"), np.loadtxt(source / "diode.dat").ravel()
    wavelength = 0.1 * (float(info[4]) + float(info[5]) * np.arange(len(camera) // 2))
    table = np.concatenate([camera[1::2].T, camera[0::2].T, diode[1::2][None], diode[0::2][None]])
    names = [f"{kind}_{channel}" for kind in ("light", "dark") for channel in "rgb"]
    write_curves(folder / "sweep.csv", wavelength, table, [*names, "diode_light", "diode_dark"])
    photodiode = source.parent / "Diode" / Path(info[3]).name
    file = folder / "MEASUREMENTS.toml"
    sensor = SENSOR.format(rows=3000, cols=4000, pitch=5.0, bits=14, pattern='"r g", "g b"')
    file.write_text(f"""
name = "{source.name}"
{sensor}
[sweep]
table = "sweep.csv"
photodiode = {json.dumps(str(photodiode))}
[datasheet]
black_level_dn = {camera[0::2].mean():.1f}
white_level_dn = 15000
well_capacity_e = 60000
read_noise_e = 4.0
[uncertainty]
lamp_drift = 0.005
wavelength_nm = 0.5
""")
    return file


@pytest.mark.parametrize("name", SWEEPS)
def test_a_real_sweep_gives_the_published_response(name: str, l3_data: Path, tmp_path: Path, l3: L3) -> None:
    """Within 0.0015 of the peak everywhere, for all seven (docs/method.md#sweeps-and-band-series)."""
    source = l3_data / "calibration/monochromator" / name
    file = sweep_folder(source, tmp_path)
    code, out, err = l3("calibrate", file, "-o", tmp_path / "camera.h5", "--json", "--quiet")
    assert (code, err) == (0, "")
    assert l3("export", tmp_path / "camera.h5", "-o", tmp_path / "out")[0] == 0
    published = np.loadtxt(source / "response.dat").T
    reference = published[1:] / published[1:].max()
    table = read_table(tmp_path / "out/responsivity.csv").counted(3)
    exported = table.values
    np.testing.assert_allclose(table.wavelength, published[0])
    assert np.abs(exported - reference).max() <= 0.0015

    camera = load(CameraModel, tmp_path / "camera.h5")
    assert not camera.absolute
    assert camera.responsivity.max() == 1.0
    assert camera.declared == ("gain", "black level", "white level", "noise")
    assert json.loads(out)["responsivity"] == "relative"
    assert camera.gain == pytest.approx((camera.white_level - camera.black_level) / 60000)
    np.testing.assert_allclose(
        camera.responsivity * camera.wavelength / (camera.responsivity * camera.wavelength).max(), exported, atol=1e-6
    )
    index = camera.responsivity.argmax()
    assert 0.005 < camera.responsivity_band.ravel()[index] < 0.02  # 1.96 × 0.5 % and a little of the wavelength


def test_exported_curves_come_back(l3_data: Path, tmp_path: Path, l3: L3) -> None:
    """A published camera of rawtoaces through [curves] and out again: the same JSON numbers."""
    source = l3_data / "sensitivities/rawtoaces/data/camera/Nikon_D800E_380_780_5.json"
    sensor = SENSOR.format(rows=300, cols=400, pitch=5.0, bits=14, pattern='"r g", "g b"')
    rest = "[datasheet]\nblack_level_dn = 600\nwhite_level_dn = 15000\nwell_capacity_e = 60000\n"
    file = tmp_path / "MEASUREMENTS.toml"
    file.write_text(f'name = "Nikon D800E"\n{sensor}\n[curves]\nfile = {json.dumps(str(source))}\n{rest}')
    assert l3("calibrate", file, "-o", tmp_path / "a.h5", "--quiet")[0] == 0
    assert l3("export", tmp_path / "a.h5", "-o", tmp_path / "out")[0] == 0
    given, written = (json.loads(path.read_text())["spectral_data"] for path in (source, tmp_path / "out/rawtoaces.json"))
    assert written["index"]["main"] == given["index"]["main"] == ["R", "G", "B"]
    assert list(written["data"]["main"]) == list(given["data"]["main"])
    curves = np.array(list(given["data"]["main"].values()))
    np.testing.assert_allclose(list(written["data"]["main"].values()), curves / curves.max(), atol=1e-12)
    file.write_text(file.read_text().replace(json.dumps(str(source)), '"out/responsivity.csv"'))
    assert l3("calibrate", file, "-o", tmp_path / "b.h5", "--quiet")[0] == 0
    one, other = load(CameraModel, tmp_path / "a.h5"), load(CameraModel, tmp_path / "b.h5")
    np.testing.assert_allclose(one.responsivity, other.responsivity, atol=1e-7)


# ------------------------------------------------------------------------------------------- a chart behind filters

BANDS = ("400 nm", "442 nm", "500 nm", "550 nm", "600 nm", "650 nm", "700 nm")  # columns of the measured spectra
FILES = (400, 450, 500, 550, 600, 650, 700)  # what the file names call them
CORNERS = [
    [27.8, 27.4],
    [384.1, 26.3],
    [361.2, 247.0],
    [50.8, 240.5],
]  # of the chart in the pictures, by its patches' centres
SHAPE = (342, 408)


def series_folder(source: Path, folder: Path, files: tuple[int, ...] = FILES) -> Path:
    """The flea3's chart behind its filters, seven exposures each, as `l3 calibrate` reads it."""
    text = (source / "spectral_data/spectra_averaged.csv").read_text().splitlines()
    names = text[0].split(",")
    table = np.array([line.split(",") for line in text[1:] if line.strip()], dtype=float).T
    wavelength = table[0]
    visible = (wavelength >= 380) & (wavelength <= 780)
    first = names.index("dark skin")
    blocks = []
    for band in files:
        light = table[names.index(BANDS[FILES.index(band)])]
        radiance = np.maximum(light * table[first : first + 24], 0.0)[:, visible]
        write_curves(folder / f"{band}.csv", wavelength[visible], radiance, names[first : first + 24])
        for path in sorted(source.glob(f"color_checker/*_{band}nm_*.tif")):
            seconds = float(path.name.split("_")[3].removesuffix("ms")) / 1000
            blocks.append(f"""
[[band]]
illuminant = "{band}"
frames = [{json.dumps(str(path))}]
exposure_s = {seconds}
corners = {CORNERS}
radiance = "{band}.csv"
""")
    for path in sorted(source.glob("dark_frames/d2_dark_*0004.tif")):
        seconds = float(path.name.split("_")[2].removesuffix("ms")) / 1000
        blocks.append(f"\n[[dark]]\nframes = [{json.dumps(str(path))}]\nexposure_s = {seconds}\n")
    file = folder / "MEASUREMENTS.toml"
    sensor = SENSOR.format(rows=SHAPE[0], cols=SHAPE[1], pitch=3.45, bits=8, pattern='"g b", "r g"')
    sheet = "[datasheet]\nblack_level_dn = 0\nwhite_level_dn = 249\nwell_capacity_e = 8000\nread_noise_e = 10\n"
    file.write_text(f'name = "Flea3"\n{sensor}\n{sheet}' + "".join(blocks))
    return file


def test_real_bands_follow_exposure(l3_data: Path, tmp_path: Path, l3: L3) -> None:
    """Every exposure predicted from the others with R² ≥ 0.999 in every channel, saturated patches left out."""
    file = series_folder(l3_data / "calibration/flea3_bandpass", tmp_path)
    command = ("calibrate", file, "-o", tmp_path / "camera.h5")
    code, out, err = l3(*command)
    assert (code, out) == (1, "")  # 8 bits and a flickering projector: a relative RMSE of 4 % where 2 % are wanted
    assert "the validation of channel r has R² 0.999" in err
    assert not (tmp_path / "camera.h5").exists()
    code, out, err = l3(*command, "--accept", "--json")
    assert code == 0
    assert "because --accept is set: the validation of channel r" in err
    result = json.loads(out)
    for channel in result["channels"].values():
        assert channel["R²"] >= 0.999
        assert channel["RMSE (%)"] < 5.0
        assert channel["LE (%)"] < 0.6  # linearity over 5–95 % of full scale
    camera = load(CameraModel, tmp_path / "camera.h5")
    assert camera.history[0].options == {"accept": True}
    assert not camera.absolute
    assert len(result["left out"]) == 24  # captures of which one patch or more saturates
    assert camera.fit is not None
    assert camera.fit.series is not None
    series = camera.fit.series
    assert series.measured[series.used].max() < 249 * 0.985
    assert series.used.mean() > 0.7
    # The filters lie where their spectra say, not where their names do.
    np.testing.assert_allclose(camera.wavelength, [398.0, 440.5, 498.0, 547.0, 594.6, 639.6, 692.1], atol=0.1)
    assert series.response.argmax(axis=1)[1:].tolist() == [2, 1, 1, 0, 0, 0]
    seen = series.response >= 0.2 * series.response.max(axis=1, keepdims=True)
    assert series.spread[1:][seen[1:]].max() < 0.2  # of 24 patches from 3 to 90 % reflectance
    assert series.spread[0].max() > 0.3  # 400 nm: what leaks past the filter outshines it
