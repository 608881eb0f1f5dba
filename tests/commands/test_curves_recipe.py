"""Camera recipes with curves from a CSV file: common layouts are read, and each mistake is reported in one line."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.physics import spectra
from tests.helpers.calls import L3, Refused
from tests.helpers.paths import CONFIGS
from tests.helpers.recipes import SMALL

RECIPE = CONFIGS / "cameras/from_curves.toml"
CSV = "from_curves.csv"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The shipped recipe with its curves, and small scenes."""
    for name in (RECIPE.name, CSV):
        shutil.copy(RECIPE.with_name(name), tmp_path / name)
    (tmp_path / "scenes.toml").write_text(SMALL["scenes"])
    return tmp_path


def curves() -> tuple[np.ndarray, np.ndarray]:
    """(wavelength) nm and (wavelength, channel) % of the shipped file."""
    table = np.loadtxt(RECIPE.with_name(CSV), delimiter=",", skiprows=1)
    return table[:, 0], table[:, 1:]


def written(heading: str, wavelength: np.ndarray, columns: np.ndarray, separator: str = ",") -> str:
    rows = [separator.join(f"{value:.9g}" for value in row) for row in np.column_stack([wavelength, columns])]
    return "\n".join([heading, *rows]) + "\n"


def camera_of(folder: Path, text: str, **keys: str) -> CameraModel:
    (folder / CSV).write_text(text)
    recipe, path = RECIPE.read_text(), folder / "camera.toml"
    added = "".join(f"\n{key} = {value}" for key, value in keys.items())
    path.write_text(recipe.replace(f'file = "{CSV}"', f'file = "{CSV}"{added}'))
    return load_camera(path)


def test_quantum_efficiencies_are_read_as_they_are() -> None:
    camera, (wavelength, percent) = load_camera(RECIPE), curves()
    np.testing.assert_array_equal(camera.wavelength, wavelength)
    np.testing.assert_allclose(camera.responsivity, percent.T / 100, rtol=1e-12)
    assert camera.responsivity.max() == pytest.approx(0.56, abs=0.01)


def test_other_units_orders_and_grids_of_the_same_curves(folder: Path) -> None:
    truth, (nm, percent) = load_camera(RECIPE), curves()
    share = percent / 100
    amperes = share * (1.602176634e-19 * spectra.photons_from_energy(nm, np.ones(nm.size)))[:, None]  # e- a joule, in A/W
    same = [
        camera_of(folder, written("nm;b (e-/photon);r (e-/photon);g (e-/photon)", nm, share[:, [2, 0, 1]], ";")),
        camera_of(folder, written("r,wavelength (um),g,b", share[:, :1], np.column_stack([nm / 1000, share[:, 1:]]))),
        camera_of(folder, written("wavelength_nm,r (%),g (%),b (%)", nm[::-1], percent[::-1])),
        camera_of(folder, written("wavelength_nm,r (A/W),g (A/W),b (A/W)", nm, amperes), per_energy="true"),
        camera_of(folder, written("wavelength_nm,r (mA/W),g (A/W),b (A/W)", nm, amperes * [1e3, 1, 1]), per_energy="true"),
        camera_of(folder, written("wavelength_nm,r (a.u.),g (rel.),b", nm, 7 * share), peak_efficiency=f"{share.max()}"),
    ]
    for camera in same:
        np.testing.assert_allclose(camera.responsivity, truth.responsivity, rtol=1e-6)
        np.testing.assert_allclose(camera.wavelength, truth.wavelength, rtol=1e-9)
    on_grid = camera_of(folder, written("nm,r (%),g (%),b (%)", nm, percent), wavelength_nm="[400, 700, 10]")
    assert on_grid.wavelength.tolist() == np.arange(400.0, 701, 10).tolist()
    np.testing.assert_allclose(on_grid.responsivity[:, 3:-3], truth.responsivity[:, 8:-8:2], atol=0.02)


def test_arrays_share_a_file_whose_other_columns_are_left_out(folder: Path, l3: L3, refused: Refused) -> None:
    truth, (nm, percent) = load_camera(RECIPE), curves()
    four = np.column_stack([percent[:, 2], percent.mean(axis=1), percent[:, :2]])
    camera = camera_of(folder, written("nm,b (%),NIR (%),r (%),G (%)", nm, four))
    np.testing.assert_allclose(camera.responsivity, truth.responsivity, rtol=1e-9)
    note = f"{folder / CSV}: columns that are not used: NIR"
    simulate = ("simulate", folder / "scenes.toml", "--camera", folder / "camera.toml", "-o", folder / "training.h5")
    assert note in l3(*simulate)[2]
    assert note in l3("check", folder / "camera.toml")[1]
    text = (folder / CSV).read_text()
    mapped = camera_of(folder, text, columns='{r = "NIR", g = "g"}')
    np.testing.assert_allclose(mapped.responsivity[0], percent.mean(axis=1) / 100, rtol=1e-7)
    (folder / CSV).write_text(text.replace(",r (%)", ",rot (%)"))
    (folder / "camera.toml").write_text(RECIPE.read_text())
    words = 'no column is called "r"; use one of b, NIR, rot, G; or select one with columns = {r = "NIR"}'
    assert words in refused(3, *simulate, "--force")
    (folder / "camera.toml").write_text(RECIPE.read_text().replace(f'"{CSV}"', f'"{CSV}"\ncolumns = {{ir = "NIR"}}'))
    assert "responsivity.columns" in refused(2, *simulate, "--force")
    (folder / CSV).write_text(written("nm,r (%),r (%),g (%),b (%)", nm, four))
    (folder / "camera.toml").write_text(RECIPE.read_text())
    assert CSV in refused(3, *simulate, "--force")
    (folder / CSV).write_text(written("", nm, four).lstrip())
    assert CSV in refused(3, *simulate, "--force")


def digitised(nm: np.ndarray, percent: np.ndarray) -> str:
    """What WebPlotDigitizer exports of the curves, each a point every 2 nm where it is above 0.2 % in no order."""
    rng = np.random.default_rng(0)
    points = []
    for curve in percent.T:
        x = rng.permutation(np.arange(nm[0], nm[-1], 2.0) + rng.uniform(-0.2, 0.2))
        y = np.interp(x, nm, curve)
        points.append([f"{a:.5f}, {b:.5f}" for a, b in zip(x[y > 0.2], y[y > 0.2], strict=True)])
    rows = [",".join(one[row] if row < len(one) else "," for one in points) for row in range(max(map(len, points)))]
    return "\n".join(["r (%),,g (%),,b (%),", "X,Y,X,Y,X,Y", *rows]) + "\n"


def test_curves_digitised_from_a_plot_are_read_as_they_are(folder: Path) -> None:
    truth, (nm, percent) = load_camera(RECIPE), curves()
    text = digitised(nm, percent)
    assert len({line.count(",,") for line in text.splitlines()[2:]}) > 1  # curves end where they are zero
    camera = camera_of(folder, text)
    ours = np.array([np.interp(nm[1:-1], camera.wavelength, curve) for curve in camera.responsivity])
    np.testing.assert_allclose(ours, truth.responsivity[:, 1:-1], atol=0.004)
    below = camera_of(folder, text.replace("X,Y", "x,y") + "712, -0.0001,,,,\n")
    assert below.responsivity.min() == 0


def percent_without_unit(nm: np.ndarray, percent: np.ndarray) -> str:
    return written("wavelength_nm,r,g,b", nm, percent)


MISTAKES: dict[str, tuple[Callable[[np.ndarray, np.ndarray], str], str]] = {
    "order": (
        lambda nm, percent: written("nm,r (%),g (%),b (%)", nm[[1, 0, *range(2, nm.size)]], percent),
        "are not in order",
    ),
    "names": (
        lambda nm, percent: written("nm,r (%),leaf (%),b (%)", nm, percent),
        'column "leaf" is not expected',
    ),
    "count": (lambda nm, percent: written("nm,r (%),g (%)", nm, percent[:, :2]), "contains 2 curves instead of 3"),
    "unit": (
        lambda nm, percent: written("nm,r (W/nm),g (W/nm),b (W/nm)", nm, percent),
        '"W/nm" is not a unit of responsivity',
    ),
    "energy": (lambda nm, percent: written("nm,r (A/W),g (A/W),b (A/W)", nm, percent / 200), "per_energy = true"),
    "relative": (lambda nm, percent: written("nm,r (a.u.),g (a.u.),b (a.u.)", nm, percent / 100), "set responsivity.peak"),
    "percent": (percent_without_unit, 'is 55.93, but cannot exceed 1; add "(%)"'),
    "peak": (lambda nm, percent: written("nm,r (%),g (%),b (%)", nm, percent * 3), "quantum efficiency is 1.678"),
    "share": (lambda nm, percent: written("nm,r (%),g (%),b (%)", nm, percent / 1000), "quantum efficiency is 0.0005593"),
    "normal": (
        lambda nm, percent: written("nm,r,g,b", nm, percent / percent.max()),
        "seems to contain relative curves, because the highest peak is 1",
    ),
    "below": (lambda nm, percent: written("nm,r (%),g (%),b (%)", nm, percent - 5), "contains negative values"),
    "dark": (lambda nm, percent: written("nm,r (%),g (%),b (%)", nm, percent * [1, 0, 1]), "channel g is zero"),
    "metres": (lambda nm, percent: written("wavelength,r,g,b", nm / 1000, percent), "in um they are 390…710 nm"),
    "coarse": (lambda nm, percent: written("nm,r (%),g (%),b (%)", nm[::8], percent[::8]), "a gap between 390 and 430 nm"),
    "gap": (
        lambda nm, percent: written(
            "nm,r (%),g (%),b (%)", np.delete(nm, range(20, 30)), np.delete(percent, range(20, 30), 0)
        ),
        "a gap between 485 and 540 nm",
    ),
    "cut": (lambda nm, percent: written("nm,r (%),g (%),b (%)", nm[:44], percent[:44]), "ends at 605 nm, where"),
    "not a pair": (
        lambda nm, percent: digitised(nm, percent) + "400,text,,,,\n",
        '"400, text" in curve 1 (r (%)) is not a pair of X and Y',
    ),
    "no foot": (
        lambda nm, percent: "\n".join(
            [
                "r,,g,,b,",
                "X,Y,X,Y,X,Y",
                *(f"{x},50,{x},50,{x},50" if x <= 600 else f",,{x},50,{x},50" for x in range(400, 701, 10)),
            ]
        ),
        '"r" ends at 600 nm, where its value is still 100% of the peak',
    ),
    "heading": (
        lambda nm, percent: written("nm,r (%),g (%)", nm, percent),
        "the heading has 3 columns, but the rows have 4",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_in_curves_is_one_line(mistake: str, folder: Path, refused: Refused, l3: L3) -> None:
    text, words = MISTAKES[mistake]
    (folder / CSV).write_text(text(*curves()))
    line = refused(3, "simulate", folder / "scenes.toml", "--camera", folder / RECIPE.name, "-o", folder / "training.h5")
    assert line.startswith(f"l3: {folder / CSV}")
    assert words in line
    code, out, _ = l3("check", folder / RECIPE.name)
    number = RECIPE.read_text().partition("\nfile =")[0].count("\n") + 2
    assert (code, out) == (3, f"{folder / RECIPE.name}:{number}: {line.removeprefix('l3: ')}")


@pytest.mark.parametrize(
    ("old", "new", "code", "words"),
    [
        (CSV, "none.csv", 3, "none.csv does not exist"),
        (
            f'file = "{CSV}"',
            f'file = "{CSV}"\nwavelength_nm = [800, 900, 5]',
            3,
            "covers 390…710 nm, but responsivity.wavelength_nm",
        ),
        (f'file = "{CSV}"', f'file = "{CSV}"\npeak_efficiency = 40', 2, "40 % is 0.4"),
        (
            f'file = "{CSV}"',
            "gaussians = {r = []}",
            2,
            "missing key `wavelength_nm` in [responsivity], which responsivity.gaussians requires",
        ),
        (f'file = "{CSV}"', "", 2, "set either responsivity.gaussians or responsivity.file"),
    ],
)
def test_a_mistake_in_the_recipe_is_one_line(
    old: str, new: str, code: int, words: str, folder: Path, refused: Refused
) -> None:
    path = folder / RECIPE.name
    path.write_text(path.read_text().replace(old, new))
    assert words in refused(code, "simulate", folder / "scenes.toml", "--camera", path, "-o", folder / "training.h5")
