"""`l3 calibrate --draft`: a folder of captures with names that are common in labs yields a measurement file."""

import re
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.store import load
from l3cli.cli import run
from l3cli.errors import InputFileError
from l3cli.io.curves import write_curves
from l3cli.io.frames import read_capture
from l3cli.io.pictures.dng import LIGHT_CODES, write_dng
from l3cli.io.pictures.openimageio import write_mosaic
from l3cli.io.pictures.registry import write_picture
from l3cli.spectra.file import read_table
from l3cli.spectra.units import PHOTON_RADIANCE
from tests.helpers.calls import L3, Refused

LAB = """
lamp_drift = 0.0
monitor_error = 0.0
wavelength_error_nm = 0.0
falloff = 0.05
[mono]
step_nm = 30
bandwidth_nm = 30
overexposed = 1
[chart]
illuminants = ["A", "D65"]
[white]
levels = [0.2, 0.5, 0.8, 1.5]
trials = 2
[dark]
exposures_s = [0.01, 0.1, 0.5]
trials = 2
"""
Naming = Callable[[str, int, str, float, int, int], str]  # kind, capture, light, seconds, trial, frame → path


def flat(kind: str, capture: int, light: str, seconds: float, trial: int, frame: int) -> str:
    """Everything in the name."""
    return f"{kind}_{light}_{seconds * 1000:g}ms_{trial + 1:02d}.tif"


def by_kind(kind: str, capture: int, light: str, seconds: float, trial: int, frame: int) -> str:
    """A folder for each kind, numbers alone within."""
    return f"{kind}/step{capture:03d}_{trial}.tif"


def as_cameras(kind: str, capture: int, light: str, seconds: float, trial: int, frame: int) -> str:
    """No kind at all."""
    return f"IMG_{frame:04d}.TIF"


@pytest.fixture(scope="module")
def lab(bayer_recipe: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a lab without drift measures of the small Bayer camera; camera.h5 is what its own measurement file gives."""
    folder = tmp_path_factory.mktemp("draft") / "lab"
    folder.mkdir()
    (folder / "lab.toml").write_text(LAB)
    assert run(["lab", str(bayer_recipe), "-o", str(folder), "--recipe", str(folder / "lab.toml"), "--quiet"]) == 0
    assert run(["calibrate", str(folder / "MEASUREMENTS.toml"), "-o", str(folder / "camera.h5"), "--quiet"]) == 0
    return folder


def with_a_file_a_step(folder: Path) -> None:
    """The spectra of the monochromator as a spectrometer saves them: a file each, the unit in its preamble."""
    table = read_table(folder / "mono.csv")
    (folder / "mono.csv").unlink()
    for number, curve in enumerate(table.values):
        rows = "\n".join(f"{nm:.4f}\t{value:.8g}" for nm, value in zip(table.wavelength, curve, strict=True))
        text = f"Spectrometer: QEP01234\nUnits: photons/s/sr/m²/nm\n>>>>>Begin Spectral Data<<<<<\n{rows}\n"
        (folder / f"step_{number:02d}.txt").write_text(text)


def renamed(lab: Path, folder: Path, naming: Naming, timed: bool = True) -> Path:
    """The lab's captures and spectra in another folder under other names, without its measurement file."""
    frame = 0
    measured = tomllib.loads((lab / "MEASUREMENTS.toml").read_text())
    for kind in ("mono", "chart", "white", "dark"):
        for number, capture in enumerate(measured[kind]):
            for trial, name in enumerate(capture["frames"]):
                frame += 1
                light = Path(name).stem.split("_")[1]
                path = folder / naming(kind, number, light, capture["exposure_s"], trial, frame)
                path.parent.mkdir(parents=True, exist_ok=True)
                if timed:
                    shutil.copy(lab / name, path)
                else:
                    write_mosaic(path, read_capture(lab / name).values)
    for path in (lab / "spectra").iterdir():
        shutil.copy(path, folder)
    if naming is by_kind:
        with_a_file_a_step(folder)
    return folder


@pytest.mark.parametrize("naming", [flat, by_kind, as_cameras])
def test_a_draft_gives_the_camera_of_the_labs_own_file(
    naming: Naming, lab: Path, bayer_recipe: Path, tmp_path: Path, l3: L3
) -> None:
    folder = renamed(lab, tmp_path / "captures", naming)
    code, out, err = l3("calibrate", "--draft", folder, "--camera", bayer_recipe, "-o", folder / "M.toml")
    assert (code, out) == (0, "")
    assert "next: l3 calibrate" in err
    assert "TODO " not in (folder / "M.toml").read_text().partition("\n")[2]
    assert l3("calibrate", folder / "M.toml", "-o", tmp_path / "camera.h5", "--quiet")[::2] == (0, "")
    drafted, own = load(CameraModel, tmp_path / "camera.h5"), load(CameraModel, lab / "camera.h5")
    assert (drafted.gain, drafted.black_level, drafted.white_level) == (own.gain, own.black_level, own.white_level)
    assert drafted.noise == own.noise
    # The corners of the charts are found, to a third of a pixel, not given.
    np.testing.assert_allclose(drafted.responsivity, own.responsivity, atol=2e-4 * own.responsivity.max())


def test_what_nobody_states_is_marked(lab: Path, tmp_path: Path, l3: L3, refused: Refused) -> None:
    """Exposure times, pixel pitch and optics; the array is seen in the monochromatic frames."""

    def without_times(kind: str, capture: int, light: str, seconds: float, trial: int, frame: int) -> str:
        return f"{kind}_{light}_{capture}_{trial}.tif"

    folder = renamed(lab, tmp_path / "captures", without_times, timed=False)
    code, _, err = l3("calibrate", "--draft", folder, "-o", folder / "M.toml")
    assert code == 0
    assert "missing: exposure_s of mono_430nm_0_0.tif: s; exposure time of" in err
    assert "missing: pixel_pitch_um of [sensor]" in err
    text = (folder / "M.toml").read_text()
    steps = text.count("\n[[mono]]")
    assert steps > 8
    assert f"s; exposure time of {steps} captures; if a capture differs, set exposure_s there" in text
    assert text.count("# TODO exposure_s = 0.01") == text.count("\n[[") - steps + 1
    assert tomllib.loads(text)["cfa"] == {"channels": ["r", "g", "b"], "pattern": ["r g", "g b"]}
    assert "`pixel_pitch_um`" in refused(2, "calibrate", folder / "M.toml", "-o", tmp_path / "c.h5")
    whole = re.sub("# TODO (pixel|focal|f_num)", r"\1", text)
    (folder / "M.toml").write_text(whole)
    assert "exposure_s" in refused(2, "calibrate", folder / "M.toml", "-o", tmp_path / "c.h5")
    (folder / "M.toml").write_text(re.sub("# TODO exposure_s", "exposure_s", whole))
    assert "exposure_s" not in refused(3, "calibrate", folder / "M.toml", "-o", tmp_path / "c.h5")  # not that of each


def test_what_all_steps_lack_is_asked_once(lab: Path, bayer_recipe: Path, tmp_path: Path, l3: L3, refused: Refused) -> None:
    """Their unit, which holds for every step that has none of its own, or the table of their spectra."""
    folder = renamed(lab, tmp_path / "captures", flat)
    draft = ("calibrate", "--draft", folder, "--camera", bayer_recipe, "-o", folder / "M.toml", "--force")
    table = read_table(folder / "mono.csv")
    assert table.names is not None
    power = 1e3 * table.values * 1.98644586e-16 / table.wavelength  # mW/(sr m² nm)
    write_curves(folder / "mono.csv", table.wavelength, power, table.names)
    assert "missing: unit of mono.csv: unit of the radiances of" in l3(*draft)[2]
    text = (folder / "M.toml").read_text()
    assert text.count("# TODO unit") == text.count("# TODO") == 1
    (folder / "M.toml").write_text(re.sub('# TODO unit = "[^"]*"', 'unit = "mW/(sr m² nm)"', text))
    assert l3("calibrate", folder / "M.toml", "-o", tmp_path / "camera.h5", "--quiet")[::2] == (0, "")
    drafted, own = load(CameraModel, tmp_path / "camera.h5"), load(CameraModel, lab / "camera.h5")
    np.testing.assert_allclose(drafted.responsivity, own.responsivity, atol=2e-4 * own.responsivity.max())
    (folder / "mono.csv").unlink()
    assert "missing: spectrum of " in l3(*draft)[2]
    text = (folder / "M.toml").read_text()
    assert text.count("TODO") == 2  # that of the heading, and one
    assert text.count('spectrum = "spectra/mono.csv"') == text.count("\n[[mono]]")
    assert "spectra/mono.csv" in refused(3, "calibrate", folder / "M.toml", "-o", tmp_path / "c.h5")


def test_raw_files_of_cameras_state_their_array_and_times(lab: Path, bayer: CameraModel, tmp_path: Path, l3: L3) -> None:
    """The lab's frames as DNG, one kind as FITS: the same sensor."""
    fits = pytest.importorskip("astropy.io.fits")
    folder = tmp_path / "captures"
    colour = {light: np.eye(3) for light in LIGHT_CODES}
    for path in lab.glob("*/*.tif"):
        file = folder / path.relative_to(lab).with_suffix(".dng")
        file.parent.mkdir(parents=True, exist_ok=True)
        raw = read_capture(path)
        if path.parent.name != "dark":
            write_dng(file, raw.values, bayer, colour, None, raw.seconds or 1.0)
            continue
        header = fits.Header({"EXPTIME": raw.seconds, "BAYERPAT": "RGGB"})
        fits.writeto(file.with_suffix(".fits"), raw.values, header)
    for path in (lab / "spectra").iterdir():
        shutil.copy(path, folder)
    assert l3("calibrate", "--draft", folder, "-o", folder / "M.toml", "--quiet")[0] == 0
    text = (folder / "M.toml").read_text()
    assert 'pattern = ["r g", "g b"]' in text
    assert "exposure_s" in text
    for line, value in (("pixel_pitch_um", 4.0), ("focal_length_mm", 25.0), ("f_number", 2.8)):
        text = re.sub(f"# TODO {line} = .*", f"{line} = {value}", text)
    (folder / "M.toml").write_text(text)
    assert l3("calibrate", folder / "M.toml", "-o", tmp_path / "camera.h5", "--quiet")[::2] == (0, "")
    drafted, own = load(CameraModel, tmp_path / "camera.h5"), load(CameraModel, lab / "camera.h5")
    assert (drafted.gain, drafted.black_level, drafted.noise) == (own.gain, own.black_level, own.noise)
    (folder / "M.toml").write_text(text.replace('"r g", "g b"', '"g r", "b g"'))
    code, _, err = l3("calibrate", folder / "M.toml", "-o", tmp_path / "other.h5", "--quiet")
    assert (code, err.count("\n")) == (3, 1)
    assert "cfa.pattern" in err


def test_what_all_bands_lack_is_asked_once(l3_data: Path, tmp_path: Path, l3: L3) -> None:
    """Two of the seven filters, a chart through each at three exposures."""
    wanted = re.compile("(550nm|700nm|dark)_(25|250|2000)ms_")
    for path in (l3_data / "calibration/flea3_bandpass").rglob("*"):
        if path.is_file() and (path.suffix != ".tif" or wanted.search(path.name)):
            (tmp_path / "in" / path.parent.name).mkdir(parents=True, exist_ok=True)
            (tmp_path / "in" / path.parent.name / path.name).symlink_to(path)
    code, _, err = l3("calibrate", "--draft", tmp_path / "in", "-o", tmp_path / "M.toml")
    assert (code, err.count("missing: radiance of "), err.count("missing: unit of ")) == (0, 1, 1)
    text = (tmp_path / "M.toml").read_text()
    bands = text.partition("\n[[band]]")[2].partition("# TODO [datasheet]")[0]
    assert (bands.count("[[band]]"), bands.count("TODO"), bands.count('radiance = "spectra/700nm.csv"')) == (5, 1, 3)


def test_names_alone_report_exposure_times(lab: Path, bayer_recipe: Path, tmp_path: Path, l3: L3) -> None:
    folder = renamed(lab, tmp_path / "captures", flat, timed=False)
    assert l3("calibrate", "--draft", folder, "--camera", bayer_recipe, "-o", folder / "M.toml", "--quiet")[0] == 0
    drafted, own = (
        tomllib.loads((path / name).read_text()) for path, name in ((folder, "M.toml"), (lab, "MEASUREMENTS.toml"))
    )
    for kind in ("mono", "white", "dark"):
        assert sorted(each["exposure_s"] for each in drafted[kind]) == sorted(each["exposure_s"] for each in own[kind])


def test_spectra_go_to_their_steps_whatever_is_missing(lab: Path, bayer_recipe: Path, tmp_path: Path, l3: L3) -> None:
    """Steps whose names state the wavelength keep theirs; for a stray frame none is guessed. One step taken again too long
    needs no spectrum of its own."""
    folder = renamed(lab, tmp_path / "captures", flat)
    draft = ("calibrate", "--draft", folder, "--camera", bayer_recipe, "-o", folder / "M.toml", "--force")
    steps = sorted(folder.glob("mono_*nm_*.tif"))
    stray = steps[0].rename(folder / "stray.tif")
    steps[1].unlink()
    code, _, err = l3(*draft)
    assert code == 0
    assert "missing: spectrum of stray.tif: " in err
    for capture in tomllib.loads((folder / "M.toml").read_text())["mono"]:
        if capture["frames"] != ["stray.tif"]:
            assert capture["column"] == capture["frames"][0].split("_")[1].replace("-", " ")
    stray.unlink()

    for number, path in enumerate(sorted(folder.glob("mono_*"))):
        path.rename(folder / f"mono_{number:02d}.tif")
    table = read_table(folder / "mono.csv")
    assert table.names is not None
    left = [number for number, name in enumerate(table.names) if "long" not in name][2:]
    write_curves(
        folder / "mono.csv", table.wavelength, table.values[left], [table.names[number] for number in left], PHOTON_RADIANCE
    )
    code, _, err = l3(*draft)
    assert code == 0
    assert f"spectra were assigned to {len(left) + 1} monochromatic captures in the order of the file names" in err
    columns = [capture["column"] for capture in tomllib.loads((folder / "M.toml").read_text())["mono"]]
    assert len(columns) - len(set(columns)) == 1  # the step that is taken again


def test_what_is_no_raw_frame_is_distinguished(lab: Path, tmp_path: Path, l3: L3) -> None:
    """Developed pictures, masks, stretched values, frames of another sensor: a line each, and none is taken."""
    folder = tmp_path / "captures"
    shutil.copytree(lab / "white", folder)
    values = read_capture(next(folder.glob("*.tif"))).values
    for name in ("developed.tif", "shown.jpg"):
        write_picture(folder / name, np.zeros((192, 256, 3), np.uint8))
    patches = np.arange(24, dtype=np.uint16).reshape(4, 6)
    write_mosaic(folder / "labels.png", np.repeat(np.repeat(patches, 48, 0), 43, 1)[:, :256])
    write_mosaic(folder / "white_other.tif", values[:96])
    write_mosaic(folder / "white_shifted.tif", (values << 4).astype(np.uint16))
    write_mosaic(folder / "white_stretched.tif", np.rint(values * (65535 / 4095)).astype(np.uint16))
    (folder / "notes.txt").write_text("The lamp was warm.\n")
    code, _, err = l3("calibrate", "--draft", folder, "-o", tmp_path / "M.toml")
    assert code == 0
    assert any("developed.tif has 3 channels of uint8" in line and line.endswith("skipped") for line in err.splitlines())
    assert "1 × .jpg: developed pictures contain no raw values; skipped" in err
    assert "skipped labels.png, which seems to be a mask or a drawing, because it has no noise" in err
    assert "colour filter array differs (96×256, for example white_other.tif)" in err
    assert "1 frame: all values are multiples of 16" in err
    assert "of the frequent values, the next higher value never occurs" in err
    assert "notes.txt" not in err
    frames = "".join(re.findall("frames = .*", (tmp_path / "M.toml").read_text()))
    assert not re.search("developed|shown|labels|other", frames)


def test_what_a_reader_says_to_do_reaches_the_user(lab: Path, tmp_path: Path, l3: L3) -> None:
    folder = tmp_path / "captures"
    shutil.copytree(lab / "white", folder)
    np.save(folder / "white_float.npy", read_capture(next(folder.glob("*.tif"))).values / 4095)
    (folder / "lamp.csv").write_text("wavelength_nm,power\n400,1\n410,1\n405,1\n")
    code, _, err = l3("calibrate", "--draft", folder, "-o", tmp_path / "M.toml")
    assert code == 0
    for name, reader in (("white_float.npy", read_capture), ("lamp.csv", read_table)):
        with pytest.raises(InputFileError) as refused:
            reader(folder / name)
        said = str(refused.value).removeprefix(str(folder / name)).lstrip(": ")
        assert any(name in line and said in line for line in err.splitlines()), name


def test_a_photo_of_a_chart_is_found(l3_data: Path, tmp_path: Path, l3: L3) -> None:
    """The colour chart in its picture, the developed DNG and the headerless dump left out."""
    assert l3("calibrate", "--draft", l3_data / "raw", "-o", tmp_path / "M.toml", "--quiet")[0] == 0
    drafted = tomllib.loads((tmp_path / "M.toml").read_text())
    assert drafted["photo"][0]["frames"] == [str(l3_data / "raw/colorchart.dng")]
    corners = np.array(drafted["photo"][0]["corners"])
    np.testing.assert_allclose(corners, [[664, 578], [1304, 564], [1315, 973], [645, 985]], atol=2.0)
    assert (drafted["sensor"]["rows"], drafted["sensor"]["cols"], drafted["sensor"]["bits"]) == (1156, 1734, 14)


def test_a_photo_gets_the_light_that_was_measured(l3_data: Path, tmp_path: Path, l3: L3) -> None:
    """The only lamp in the folder, as its spectrometer writes it, makes a measurement file that is taken at once."""
    folder = tmp_path / "captures"
    folder.mkdir()
    (folder / "colorchart.dng").symlink_to(l3_data / "raw/colorchart.dng")
    grid = np.arange(380, 781, 5)
    rows = "\n".join(f"{nm};{(nm / 560) ** 3:.4f}".replace(".", ",") for nm in grid)
    (folder / "lamp.txt").write_bytes(f"Wavelength;Irradiance\r\n[nm];[µW/cm²/nm]\r\n{rows}\r\n".encode("utf-16"))
    code, _, err = l3("calibrate", "--draft", folder, "-o", folder / "M.toml")
    assert code == 0
    assert 'assumed: light = "lamp.txt": the only measured illuminant in the folder' in err
    assert "next: l3 calibrate" in err


FIGURES = "[datasheet]\nblack_level_dn = 64\nwhite_level_dn = 4000\nwell_capacity_e = 20000\n"
NM = np.arange(400, 701, 10)
BUMPS = {name: np.exp(-(((NM - centre) / 45.0) ** 2)) for name, centre in (("blue", 460), ("green", 540), ("red", 610))}


def completed(text: str) -> str:
    """A draft with its examples taken."""
    return re.sub("^# TODO (.*)", r"\1", text, flags=re.MULTILINE).partition("[datasheet]")[0] + FIGURES


def test_a_folder_of_a_sweep_gives_its_measurement_file(tmp_path: Path, l3: L3) -> None:
    """Not the published result that lies beside it."""
    light = [60 + 900 * curve for curve in BUMPS.values()]
    dark = [np.full(NM.size, 60.0)] * len(BUMPS)
    names = [*(f"light {name}" for name in BUMPS), *(f"dark {name}" for name in BUMPS), "diode", "dark"]
    write_curves(tmp_path / "sweep.csv", NM, np.array([*light, *dark, NM / 10, NM * 0 + 1.0]), names)
    write_curves(tmp_path / "fds100.csv", np.array([390, 710]), np.array([[0.2, 0.4]]), ["response"], "A/W")
    write_curves(tmp_path / "published.csv", NM, np.array(list(BUMPS.values())), list(BUMPS))
    file = tmp_path / "M.toml"
    code, _, err = l3("calibrate", "--draft", tmp_path, "-o", file)
    assert code == 0
    assert "3 tables, no frames; replace each TODO in the file, then: l3 calibrate" in err
    drafted = tomllib.loads(file.read_text())
    assert drafted["sweep"] == {"table": "sweep.csv", "photodiode": "fds100.csv"}
    assert drafted["cfa"]["channels"] == list(BUMPS)
    file.write_text(completed(file.read_text()).replace('"r g", "g b"', '"red green", "green blue"'))
    assert l3("calibrate", file, "-o", tmp_path / "camera.h5", "--quiet")[::2] == (0, "")
    peaks = load(CameraModel, tmp_path / "camera.h5").responsivity.argmax(axis=1)
    assert (np.abs(NM[peaks] - [460, 540, 610]) <= 10).all()


@pytest.mark.parametrize(("unit", "per_energy"), [("", True), ("A/W", True), ("%", False)])
def test_a_folder_of_finished_curves_gives_its_measurement_file(
    unit: str, per_energy: bool, bayer_recipe: Path, tmp_path: Path, l3: L3
) -> None:
    """Of a known camera nothing is missing; the lamp beside the curves is none of them."""
    write_curves(tmp_path / "lamp.csv", NM, (NM / 560.0)[None] ** 3, ["power"])
    write_curves(tmp_path / "qe.csv", NM, np.array(list(BUMPS.values())), ["b", "g", "r"], unit)
    arguments = ("calibrate", "--draft", tmp_path, "--camera", bayer_recipe, "-o", tmp_path / "M.toml")
    code, _, err = l3(*arguments)
    assert (code, "missing" in err) == (0, False)
    assert "next: l3 calibrate" in err
    assert tomllib.loads((tmp_path / "M.toml").read_text())["curves"] == {"file": "qe.csv", "per_energy": per_energy}
    assert l3("calibrate", tmp_path / "M.toml", "-o", tmp_path / "camera.h5", "--quiet")[::2] == (0, "")
    assert load(CameraModel, tmp_path / "camera.h5").channels == ("r", "g", "b")


def test_published_results_are_drafted(l3_data: Path, tmp_path: Path, l3: L3) -> None:
    """With the measurement beside them, which has no wavelengths, named as what to give instead."""
    folder = l3_data / "calibration/ssftool_D7000"
    err = l3("calibrate", "--draft", folder, "-o", tmp_path / "M.toml")[2]
    measured = "if D7000_calibration.dat, D7000_spectrum.dat contain the raw sweep, add wavelengths and use [sweep]"
    assert f'published_result.csv": finished curves; {measured}' in err
    (tmp_path / "M.toml").write_text(completed((tmp_path / "M.toml").read_text()))
    assert l3("calibrate", tmp_path / "M.toml", "-o", tmp_path / "camera.h5", "--quiet")[::2] == (0, "")


def test_drafts_are_refused_before_any_work(lab: Path, tmp_path: Path, refused: Refused) -> None:
    draft = ("calibrate", "--draft", lab)
    assert "MEASUREMENTS.toml" in refused(1, *draft, "-o", lab / "MEASUREMENTS.toml")
    assert "lab.toml" in refused(3, "calibrate", "--draft", lab / "lab.toml", "-o", tmp_path / "M.toml")
    assert "spectra" in refused(3, "calibrate", "--draft", lab / "spectra", "-o", tmp_path / "M.toml")
    assert "--camera" in refused(2, *draft, "--camera", "fiveband", "-o", tmp_path / "M.toml")
