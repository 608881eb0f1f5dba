"""Units and physical plausibility of inputs: values are converted or rejected, with a suggestion in the message."""

import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.store import load
from l3cli.errors import InputFileError, RecipeError
from l3cli.frames.measurement import PATCH_NAMES
from l3cli.io.measurements import patch_name
from l3cli.physics import spectra
from l3cli.spectra import units
from l3cli.spectra.file import read_table
from tests.helpers.calls import L3, Refused

RADIANCE = {"J": 1, "s": -1, "sr": -1, "m": -3}


@pytest.fixture
def copied(lab_folder: Path, tmp_path: Path) -> Path:
    """A lab's folder whose texts can be spoilt."""
    return Path(shutil.copytree(lab_folder, tmp_path / "lab"))


def edit(folder: Path, pattern: str, new: str | Callable[[re.Match[str]], str], count: int = 0) -> None:
    path = folder / "MEASUREMENTS.toml"
    text, changed = re.subn(pattern, new, path.read_text(), count=count)
    assert changed
    path.write_text(text)


# ----------------------------------------------------------------------------------------------------------- units


@pytest.mark.parametrize(
    ("text", "per_nm"),
    [
        ("W/(sr m² nm)", 1.0),
        ("W/sr/m^2/nm", 1.0),
        ("W sr-1 m-2 nm-1", 1.0),
        ("W·m⁻²·sr⁻¹·nm⁻¹", 1.0),
        ("W per sr per m2 per nm", 1.0),
        ("mW/(m² sr nm)", 1e-3),
        ("µW/(cm² sr nm)", 1e-2),
        ("W m**-2 sr**-1 µm**-1", 1e-3),
        ("W/(sr m² Å)", 10.0),
    ],
)
def test_spellings_of_radiance(text: str, per_nm: float) -> None:
    unit = units.parse(text)
    assert unit is not None
    assert unit.powers == RADIANCE
    assert unit.scale == pytest.approx(1e9 * per_nm)


@pytest.mark.parametrize("text", ["", "lumen", "W/", "W/(sr", ")", "m-21", "(" * 5000, "W^x", "1e5 W"])
def test_what_is_no_unit(text: str) -> None:
    assert units.parse(text) is None


@pytest.mark.parametrize(
    ("heading", "parts"),
    [
        ("r (A/W)", ("r", "A/W")),
        ("patch 1 [W/(sr m² nm)]", ("patch 1", "W/(sr m² nm)")),
        ("T / %", ("T", "%")),
        ("white 9.5 (.05 D)", ("white 9.5 (.05 D)", None)),
        ("460nm (erg/s/cm2/sr/A)", ("460nm", "erg/s/cm2/sr/A")),
        ("460nm", ("460nm", None)),
    ],
)
def test_headings_with_units(heading: str, parts: tuple[str, str | None]) -> None:
    assert units.split(heading) == parts


# ------------------------------------------------------------------------------------------------------------- CSV


@pytest.mark.parametrize(
    "text",
    [
        "400,1,2\n500,3,4\n",
        "500,3,4\n400,1,2\n",
        "nm,a,b\n400,1,2\n500,3,4\n",
        "nm,b,a\n400,2,1\n500,4,3\n",
        "b,wavelength (nm),a\n2,400,1\n4,500,3\n",
        ",A,B\n400,1,2\n500,3,4\n",
        "# nm,b,a\n400,2,1\n500,4,3\n",
        "wavelength_um,a,b\n0.4,1,2\n0.5,3,4\n",
        "wavelength (Å),a,b\n4000,1,2\n5000,3,4\n",
        "λ [nm];a;b\n400;1,0;2,0\n500;3;4\n",
        "lambda\ta\tb\n400,0\t1\t2\n500,0\t3\t4\n",
        "400 1 2\n500 3 4\n",
    ],
)
def test_tables_that_state_the_same(text: str, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(text)
    table = read_table(tmp_path / "t.csv").ordered(("a", "b"))
    np.testing.assert_allclose(table.wavelength, [400.0, 500.0])
    np.testing.assert_allclose(table.values, [[1.0, 3.0], [2.0, 4.0]])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("nm,a,c\n400,1,2\n", '"c" is not expected'),
        ("nm,a,a\n400,1,2\n", '"a" is called|two columns are called "a"'),
        ("nm,wavelength,a\n1,2,3\n", '"nm" and "wavelength" both contain wavelengths'),
        ("frequency_THz,a,b\n400,1,2\n", 'name exactly one column "wavelength_nm"'),
        ("wavelength (THz),a,b\n400,1,2\n", "has no unit of length"),
        ("0.4,1,2\n0.7,1,2\n", r"in um they are 400…700 nm; rename the wavelength column to \"wavelength_um\""),
        ("wavelength_nm,a,b\n4000,1,2\n7000,1,2\n", "in A they are 400…700 nm"),
        ("4e-7,1,2\n7e-7,1,2\n", "in m they are"),
        ("wavelength_um,a,b\n400,1,2\n700,1,2\n", '"wavelength_um"'),
        ("nm,a,b\n400,5,1,0\n", "if commas are decimal points"),
        ("400,1,1\n400,2,2\n", "wavelengths are not in order"),
        ("400,1,1\n410,nan,1\n", "wavelengths are not in order, or a value is not a number"),
        ("400,1,1\n410\n", "same number of values"),
        ("400,1\n410,1\n", "contains 1 curves instead of 2"),
        ("", "is not a table"),
        ("nm;a;b\n400;1.234,5;1\n", "not a row of numbers"),
        ("nm;a;b\n400;1,5;1.5\n", "both commas and points"),
    ],
)
def test_tables_that_are_refused(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(InputFileError, match=words):
        read_table(tmp_path / "t.csv").ordered(("a", "b"))


def test_capitals_count_where_they_distinguish_channels(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("nm,R,r\n400,1,2\n")
    np.testing.assert_array_equal(read_table(tmp_path / "t.csv").ordered(("r", "R")).values, [[2.0], [1.0]])
    with pytest.raises(InputFileError, match="is not expected"):
        read_table(tmp_path / "t.csv").ordered(("r", "g"))


def test_radiances_in_any_unit_are_photons(tmp_path: Path) -> None:
    grid, photons = np.array([400.0, 500.0]), np.array([1e15, 2e15])
    watts = photons / spectra.photons_from_energy(grid, np.ones(2))
    for unit, values in (
        ("photons/s/sr/m²/nm", photons),
        ("photons s-1 sr-1 cm-2 nm-1", photons * 1e-4),
        ("W/(sr m² nm)", watts),
        ("µW/(sr cm² nm)", watts * 1e2),
    ):
        rows = "\n".join(f"{nm},{value:.12g}" for nm, value in zip(grid, values, strict=True))
        (tmp_path / "stated.csv").write_text(f"nm,a ({unit})\n{rows}\n")
        (tmp_path / "untold.csv").write_text(f"nm,a\n{rows}\n")
        np.testing.assert_allclose(read_table(tmp_path / "stated.csv").photons(None)[0], photons, rtol=1e-9)
        np.testing.assert_allclose(read_table(tmp_path / "untold.csv").photons(unit)[0], photons, rtol=1e-9)
    with pytest.raises(InputFileError, match="correct the"):
        read_table(tmp_path / "stated.csv").photons("W/(sr m² nm)")
    with pytest.raises(InputFileError, match="not of spectral radiance"):
        read_table(tmp_path / "untold.csv").photons("W/(m² nm)")  # an irradiance


def test_shares_and_responses_in_percent(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("nm,T (%)\n400,50\n500,92\n")
    np.testing.assert_allclose(read_table(path).shares(), [[0.5, 0.92]])
    path.write_text("nm,T\n400,50\n500,92\n")
    with pytest.raises(InputFileError, match="percent"):
        read_table(path).shares()
    path.write_text("nm,r (A/W)\n400,50\n500,92\n")
    with pytest.raises(InputFileError, match="per_energy = true"):
        read_table(path).responses(False, "per_energy")
    path.write_text("nm,EQE (%)\n400,50\n500,92\n")  # of a photodiode
    np.testing.assert_allclose(read_table(path).per_energy(), [[50 * 400, 92 * 500]])


def test_patches_are_those_of_the_chart() -> None:
    names, _ = spectra.colorchecker(np.arange(400.0, 701.0, 10.0))
    assert [patch_name(name) for name in names] == list(PATCH_NAMES)
    assert [patch_name(f"patch_{number}") for number in range(1, 25)] == list(PATCH_NAMES)
    assert patch_name("patch 25") == "patch 25"


# ----------------------------------------------------------------------------------------------------- calibration


def test_an_efficiency_above_one_is_refused_whoever_accepts_it(copied: Path, tmp_path: Path, refused: Refused) -> None:
    edit(copied, r"f_number = 2.8", "f_number = 28")
    line = refused(3, "calibrate", copied / "MEASUREMENTS.toml", "-o", tmp_path / "camera.h5", "--accept")
    assert "the peak quantum efficiency would be 38" in line
    assert "f_number" in line


def test_milliseconds_for_seconds_are_guessed(copied: Path, tmp_path: Path, refused: Refused, l3: L3) -> None:
    edit(copied, r"exposure_s = (\S+)", lambda match: f"exposure_s = {1e3 * float(match[1])}")
    command = ("calibrate", copied / "MEASUREMENTS.toml", "-o", tmp_path / "camera.h5")
    line = refused(1, *command)
    assert "peak quantum efficiency is only 0.04 %" in line
    assert "exposure_ms" in line
    edit(copied, "exposure_s", "exposure_ms")
    assert l3(*command)[0] == 0
    assert load(CameraModel, tmp_path / "camera.h5").responsivity.max() == pytest.approx(0.4, rel=0.01)


def test_one_exposure_in_one_unit(copied: Path, tmp_path: Path, refused: Refused) -> None:
    edit(copied, r"(exposure_s = \S+)", r"\1\nexposure_ms = 5", count=1)
    line = refused(2, "calibrate", copied / "MEASUREMENTS.toml", "-o", tmp_path / "camera.h5")
    assert "exposure_ms" in line


def exposures(folder: Path, kind: str) -> list[str]:
    """The first frames of all captures of a kind."""
    return re.findall(rf'frames = \["({kind}/[^"]*)"', (folder / "MEASUREMENTS.toml").read_text())


def mistype(folder: Path, frame: str, factor: float) -> None:
    edit(folder, rf'("{frame}".*\n)exposure_s = (\S+)', lambda match: f"{match[1]}exposure_s = {factor * float(match[2])}")


LONGER, SHORTER = (1e3, 0.4), (1e-3, 0.7)  # than it was, and which of the captures it is
MISTYPED = [("mono", *LONGER), ("mono", *SHORTER), ("chart", *LONGER), ("white", *SHORTER), ("dark", *LONGER)]
MORE = [("chart", *SHORTER), ("white", *LONGER), ("dark", *SHORTER)]  # by make soak


@pytest.mark.parametrize(
    ("kind", "factor", "place"), [*MISTYPED, *(pytest.param(*each, marks=pytest.mark.soak) for each in MORE)]
)
def test_a_mistyped_exposure_is_named(
    kind: str, factor: float, place: float, copied: Path, tmp_path: Path, refused: Refused
) -> None:
    captures = exposures(copied, kind)
    frame = captures[int(place * len(captures))]
    mistype(copied, frame, factor)
    code = (
        1 if kind == "mono" and factor > 1 else 3
    )  # too dark a step is one that --accept takes; too bright a one ruins all
    line = refused(code, "calibrate", copied / "MEASUREMENTS.toml", "-o", tmp_path / "camera.h5")
    assert frame in line


def test_an_odd_step_can_be_accepted(copied: Path, tmp_path: Path, refused: Refused, l3: L3) -> None:
    """A filter narrower than the steps resembles one: a key says otherwise."""
    (frame,) = (name for name in exposures(copied, "mono") if "_500nm." in name)
    mistype(copied, frame, 8.0)
    command = ("calibrate", copied / "MEASUREMENTS.toml", "-o", tmp_path / "camera.h5")
    line = refused(1, *command)
    assert frame in line
    code, _, err = l3(*command, "--accept")
    assert code == 0
    assert f"because --accept is set: {frame}" in err
    fit = load(CameraModel, tmp_path / "camera.h5").fit
    assert fit is not None
    assert fit.sweep is not None
    assert [line.partition(":")[0] for line in fit.sweep.odd] == [frame]


def test_inputs_replaced_during_it_are_refused(
    copied: Path, tmp_path: Path, refused: Refused, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between reading and writing a frame gets other content: the history would name what was not read."""
    from l3cli.calibration import model

    calibrate, frame = model.calibrate, min((copied / "dark").iterdir())
    replacement = tmp_path / "replacement"

    def replaced(*arguments: object) -> CameraModel:
        camera = calibrate(*arguments)  # type: ignore[arg-type]
        replacement.write_bytes(frame.read_bytes()[:-1] + b"x")
        os.replace(replacement, frame)
        return camera

    monkeypatch.setattr(model, "calibrate", replaced)
    line = refused(3, "calibrate", copied / "MEASUREMENTS.toml", "-o", tmp_path / "camera.h5")
    assert frame.name in line


# --------------------------------------------------------------------------------------------------------- recipes


@pytest.mark.parametrize(
    ("key", "wrong", "words"),
    [
        ("peak_efficiency", "55", "55 % is 0.55"),
        ("peak_efficiency", "1.01", "write a fraction of at most 1"),
        ("prnu", "0.5", "0.5 % is 0.005"),
        ("pixel_pitch_um", "0.004", "did you mean 4?"),
        ("pixel_pitch_um", "4e-6", "did you mean 4?"),
        ("focal_length_mm", "0.025", "did you mean 25?"),
        ("f_number", "0.28", "at least 0.5"),
    ],
)
def test_figures_of_another_unit_are_refused(key: str, wrong: str, words: str, bayer_recipe: Path, tmp_path: Path) -> None:
    path = tmp_path / "camera.toml"
    path.write_text(re.sub(rf"{key} = \S+", f"{key} = {wrong}", bayer_recipe.read_text()))
    with pytest.raises(RecipeError, match=re.escape(words)) as raised:
        load_camera(path)
    assert key in str(raised.value)


def test_responsivities_are_known_by_their_names(bayer_recipe: Path, tmp_path: Path) -> None:
    truth = load_camera(bayer_recipe)
    text = re.sub(r"\[responsivity.gaussians\].*?(?=\[noise\])", "", bayer_recipe.read_text(), flags=re.S)
    (tmp_path / "camera.toml").write_text(text.replace("peak_efficiency = 0.4\n", 'peak_efficiency = 0.4\nfile = "c.csv"\n'))
    rows = np.column_stack([truth.wavelength, truth.responsivity[[2, 0, 1]].T])
    (tmp_path / "c.csv").write_text("\n".join(["nm,b,r,g", *(",".join(map(str, row)) for row in rows)]))
    np.testing.assert_allclose(load_camera(tmp_path / "camera.toml").responsivity, truth.responsivity, rtol=1e-9)


def test_bands_of_a_cube_in_micrometres_are_refused(bayer_recipe: Path, tmp_path: Path, refused: Refused) -> None:
    scenes = tmp_path / "scenes.toml"
    np.save(tmp_path / "cube.npy", np.full((20, 20, 3), 0.5))
    scenes.write_text(
        'illuminants = ["D65"]\nexposure_share = [0.9]\n[[scene]]\nsource = "cube"\nfile = "cube.npy"\n'
        "wavelengths_nm = [0.4, 0.55, 0.7]\n"
    )
    line = refused(2, "simulate", scenes, "--camera", bayer_recipe, "-o", tmp_path / "t.h5")
    assert "in um they are 400…700 nm" in line


def test_reflectances_in_percent_are_refused(bayer_recipe: Path, tmp_path: Path, l3: L3) -> None:
    scenes = tmp_path / "scenes.toml"
    np.save(tmp_path / "cube.npy", np.full((20, 20, 31), 50.0))
    text = (
        'illuminants = ["D65"]\nexposure_share = [0.9]\n[[scene]]\nsource = "cube"\nfile = "cube.npy"\n'
        "wavelength_range_nm = [400, 700, 10]\n"
    )
    scenes.write_text(text)
    command = ("simulate", scenes, "--camera", bayer_recipe, "-o", tmp_path / "t.h5")
    assert l3(*command)[0] == 3
    assert "100 for percent" in l3(*command)[2]
    scenes.write_text(text + "white = 100\n")
    assert l3(*command)[0] == 0
