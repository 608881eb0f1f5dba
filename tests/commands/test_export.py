"""`l3 export` of cameras: the files have the documented structure and agree with the camera."""

import csv
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.store import load, save
from l3cli.export import profiles
from l3cli.export.profiles import datasheet
from l3cli.physics import spectra
from l3cli.physics.display import SRGB_FROM_XYZ, adaptation_matrix, delta_e_2000, lab, white_point
from l3cli.recipes.builtin import find_recipe
from l3cli.simulation.light import colour_matrix, make_light
from tests.helpers import lenses
from tests.helpers.calls import L3, Refused

GRID = np.arange(380.0, 781.0, 5.0)
CHART = spectra.colorchecker(GRID)[1]
RASPBERRY_PI = ["libcamera_pisp.json", "libcamera_rpi.json"]  # 5, and those before
FILES = ["datasheet.csv", "dcp.json", *RASPBERRY_PI, "libcamera_simple.yaml", "rawtoaces.json", "responsivity.csv"]


@pytest.fixture(scope="module")
def exported(bayer_recipe: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    from l3cli.cli import run

    folder = tmp_path_factory.mktemp("exported")
    assert run(["export", str(bayer_recipe), "-o", str(folder), "--quiet"]) == 0
    return folder


def write_files(camera: CameraModel, folder: Path) -> None:
    for name, content in profiles.export(camera).files.items():
        (folder / name).write_text(content)


def seen(camera: CameraModel, light: str) -> tuple[np.ndarray, np.ndarray]:
    """Channels (patch, channel) of the chart under a light, a white's Y 1, and those of a white."""
    weights = spectra.average(camera.responsivity, camera.wavelength, GRID) * spectra.illuminant(light, GRID)
    return CHART @ weights.T, weights.sum(axis=1)


def chart_xyz(light: str) -> np.ndarray:
    weights = spectra.xyz_weights(GRID) * spectra.illuminant(light, GRID)
    return np.asarray(CHART @ weights.T / weights[1].sum())


def test_the_same_bytes_of_a_recipe_and_a_model(exported: Path, bayer: CameraModel, tmp_path: Path, l3: L3) -> None:
    assert sorted(path.name for path in exported.iterdir()) == FILES
    save(bayer, tmp_path / "camera.h5")
    code, out, err = l3("export", tmp_path / "camera.h5", "-o", tmp_path / "again")
    assert code == 0, err
    assert all((exported / name).read_bytes() == (tmp_path / "again" / name).read_bytes() for name in FILES)
    assert re.search(r"^D65 +CCM +\d+\.\d\d +\d+\.\d\d +\d+\.\d\d ", out, re.MULTILINE)
    assert [line.split()[0] for line in out.splitlines()[1:]] == ["A"] * 3 + ["D50"] + ["D65"] * 3


def test_dcp_matrices_develop_the_chart(exported: Path, bayer: CameraModel) -> None:
    """As a developer does, by the DNG specification: by ColorMatrix alone, and by ForwardMatrix over the white."""
    dcp = json.loads((exported / "dcp.json").read_text())
    assert (dcp["CalibrationIlluminant1"], dcp["CalibrationIlluminant2"]) == ("StdA", "D65")
    for number, light, code, most in ((1, "A", "StdA", (2.5, 4.0)), (2, "D65", "D65", (2.0, 2.0))):
        values, white = seen(bayer, light)
        neutral = np.array(dcp["AsShotNeutral"][code])
        np.testing.assert_allclose(neutral, white / white.max(), atol=1e-5)
        colour, forward = np.array(dcp[f"ColorMatrix{number}"]), np.array(dcp[f"ForwardMatrix{number}"])
        lit = white_point(light)
        np.testing.assert_allclose(colour @ lit, neutral, atol=2e-4)
        np.testing.assert_allclose(forward.sum(axis=1), white_point("D50"), atol=3e-4)
        directly = values / white.max() @ np.linalg.inv(colour).T
        assert delta_e_2000(lab(directly, lit), lab(chart_xyz(light), lit)).mean() < most[0]
        adapted = (values / white) @ forward.T
        d50 = white_point("D50")
        assert delta_e_2000(lab(adapted, d50), lab(chart_xyz("D50"), d50)).mean() < most[1]
        other = directly @ adaptation_matrix(lit, d50).T
        assert delta_e_2000(lab(other, d50), lab(adapted, d50)).mean() < 5.0


def test_each_matrix_beats_least_squares(exported: Path, bayer: CameraModel) -> None:
    """RMS over the surfaces that are fitted, of ColorMatrix1 beside the matrix that simulated DNG files get."""
    light = make_light("A", {}, bayer.wavelength)
    library = spectra.reflectance_library(light.wavelength)
    weights = spectra.average(bayer.responsivity, bayer.wavelength, light.wavelength) * light.radiance
    channels = library @ weights.T / weights.sum(axis=1).max()
    to_xyz = spectra.xyz_weights(light.wavelength) * light.radiance
    xyz, white = library @ to_xyz.T / to_xyz[1].sum(), to_xyz.sum(axis=1) / to_xyz[1].sum()
    refined = np.array(json.loads((exported / "dcp.json").read_text())["ColorMatrix1"])
    plain = colour_matrix(bayer, light)
    squares = [
        np.square(delta_e_2000(lab(channels @ np.linalg.inv(m).T, white), lab(xyz, white))).mean() for m in (refined, plain)
    ]
    assert squares[0] < squares[1] - 0.01


def read_tuning(path: Path) -> dict[str, Any]:
    """The algorithms of a tuning file, refused where libcamera's reader would: Controller::read, and read() of each."""
    content = json.loads(path.read_text())
    assert 2.0 <= content["version"] < 3.0
    assert content["target"] in ("bcm2835", "pisp")
    assert all(len(each) == 1 for each in content["algorithms"])
    algorithms = {name: parameters for each in content["algorithms"] for name, parameters in each.items()}
    level = algorithms["rpi.black_level"]["black_level"]
    assert isinstance(level, int)
    assert 0 <= level < 2**16
    assert all(isinstance(algorithms["rpi.noise"][key], float) for key in ("reference_constant", "reference_slope"))
    ccms = algorithms["rpi.ccm"]["ccms"]
    assert all(len(each["ccm"]) == 9 for each in ccms)
    assert (np.diff([each["ct"] for each in ccms]) > 0).all()
    awb = algorithms["rpi.awb"]
    if awb["bayes"]:
        curve = np.reshape(awb["ct_curve"], (-1, 3))
        assert (np.diff(curve[:, 0]) > 0).all()
        assert awb["modes"]["auto"]["lo"] < awb["modes"]["auto"]["hi"]
        assert all(len(each["prior"]) % 2 == 0 for each in awb["priors"])
    if alsc := algorithms.get("rpi.alsc"):
        cells = {"bcm2835": 16 * 12, "pisp": 32 * 32}[content["target"]]
        assert len(alsc["luminance_lut"]) == cells
        assert all(len(each["table"]) == cells for name in ("Cr", "Cb") for each in alsc[f"calibrations_{name}"])
    return algorithms


def between(table: np.ndarray, rows: np.ndarray, cols: np.ndarray) -> np.ndarray:
    """Values of a table at places, linear between its entries, beyond them as the last ones."""
    parts = []
    for places, count in ((rows, len(table)), (cols, table.shape[1])):
        inside = np.clip(places, 0, count - 1)
        below = np.minimum(inside.astype(int), count - 2)
        weights = np.zeros((places.size, count))
        weights[np.arange(places.size), below] = 1 - (inside - below)
        weights[np.arange(places.size), below + 1] = inside - below
        parts.append(weights)
    return np.asarray(parts[0] @ table @ parts[1].T)


@pytest.mark.parametrize(
    ("name", "cells", "vertices", "most", "rms"),
    [("libcamera_pisp.json", (32, 32), (33, 33), 0.01, 0.002), ("libcamera_rpi.json", (12, 16), (49, 64), 0.06, 0.008)],
)
def test_shading_is_undone_as_the_processors_interpolate(
    bayer: CameraModel, name: str, cells: tuple[int, int], vertices: tuple[int, int], most: float, rms: float, tmp_path: Path
) -> None:
    """A lens that halves the light in the corners, by a model of both processors: tables hold for the middles of cells, from
    which the corners of a grid are interpolated, and pixels from those. The coarse one goes on flat for half of a 12th."""
    camera = replace(bayer, flat_field=lenses.flat_field(bayer))
    write_files(camera, tmp_path)
    alsc = read_tuning(tmp_path / name)["rpi.alsc"]
    assert alsc["luminance_strength"] == 1.0
    luminance = np.reshape(alsc["luminance_lut"], cells)
    red, blue = (np.reshape(alsc[f"calibrations_{each}"][0]["table"], cells) for each in ("Cr", "Cb"))
    assert {luminance.min(), red.min(), blue.min()} == {1.0}
    truth = lenses.gain(camera, np.arange(camera.rows), np.arange(camera.cols))
    for channel, table in enumerate((luminance * red, luminance, luminance * blue)):
        corners = between(table, *(np.linspace(0, n, v) - 0.5 for n, v in zip(cells, vertices, strict=True)))
        places = ((np.arange(n) + 0.5) / n * (v - 1) for n, v in zip((camera.rows, camera.cols), vertices, strict=True))
        left = between(corners, *places) / truth[channel]
        left /= np.median(left)
        assert np.abs(left - 1).max() < most
        assert left.std() < rms
    smooth = np.abs(np.diff(red, 2, axis=1)).max()
    assert smooth < 0.01  # neighbours are compared by the algorithm that refines these tables


def test_libcamera_gets_levels_noise_white_and_colours(exported: Path, bayer: CameraModel) -> None:
    tuning = read_tuning(exported / "libcamera_rpi.json")
    assert read_tuning(exported / "libcamera_pisp.json") == tuning  # but for its target
    assert "missing: rpi.alsc" in (exported / "libcamera_pisp.json").read_text()
    assert tuning["rpi.black_level"]["black_level"] == 64 * 16
    curve = np.reshape(tuning["rpi.awb"]["ct_curve"], (-1, 3))
    white = seen(bayer, "D6500K")[1]
    at = curve[curve[:, 0] == 6500][0]
    np.testing.assert_allclose(at[1:], [white[0] / white[1], white[2] / white[1]], atol=1e-4)
    ccms = tuning["rpi.ccm"]["ccms"]
    assert [each["ct"] for each in ccms] == [2856, 5003, 6504]
    d65 = white_point("D65")
    for each, light, most in zip(ccms, ("A", "D50", "D65"), (4.5, 2.5, 2.0), strict=True):
        matrix = np.reshape(each["ccm"], (3, 3))
        np.testing.assert_allclose(matrix.sum(axis=1), 1.0, atol=1e-9)
        values, white = seen(bayer, light)
        xyz = (values / white) @ matrix.T @ np.linalg.inv(SRGB_FROM_XYZ).T
        assert delta_e_2000(lab(xyz, d65), lab(chart_xyz("D65"), d65)).mean() < most
    noise = tuning["rpi.noise"]
    for signal in (100.0, 1000.0, 3000.0):  # DN; tuning files count in sixteenths of it
        deviation = noise["reference_constant"] + noise["reference_slope"] * np.sqrt(16 * signal)
        assert deviation / 16 == pytest.approx(np.sqrt(bayer.noise_variance(np.array(signal))), rel=0.25)


def test_the_simple_pipeline_gets_the_same(exported: Path) -> None:
    text, tuning = (exported / "libcamera_simple.yaml").read_text(), read_tuning(exported / "libcamera_rpi.json")
    assert text.splitlines()[1:4] == ["%YAML 1.1", "---", "version: 1"]
    assert "blackLevel: 1024\n" in text
    rows = re.findall(r"- ct: (\d+)\n +ccm: \[(.*?)\]", text, re.DOTALL)
    assert [int(ct) for ct, _ in rows] == [2856, 5003, 6504]
    for (_, values), each in zip(rows, tuning["rpi.ccm"]["ccms"], strict=True):
        assert [float(value) for value in values.split(",")] == each["ccm"]


def test_a_data_sheet_has_units_and_sources(exported: Path, pipeline: Path) -> None:
    rows = list(csv.DictReader((exported / "datasheet.csv").read_text().splitlines()))
    found = {(row["quantity"], row["channel"]): (row["value"], row["unit"], row["source"]) for row in rows}
    assert found["pixel pitch", ""] == ("4", "um", "recipe")
    assert found["overall system gain K", ""] == ("0.25", "DN/e-", "recipe")
    assert found["PRNU", ""] == ("0.5", "%", "recipe")
    assert found["peak responsivity", "g"] == ("0.4", "e-/photon", "recipe")
    assert found["share of the pixels", "g"] == ("50", "%", "recipe")
    measured = datasheet(load(CameraModel, pipeline / "camera.h5"))
    assert {row[-1] for row in measured if row[0] in ("dark current", "peak responsivity")} == {"measured"}
    assert {row[-1] for row in measured if row[0] in ("pixel pitch", "f-number")} == {"declared"}


def test_other_arrays_get_no_tuning_and_greys_no_matrices(bayer: CameraModel, tmp_path: Path, l3: L3) -> None:
    quad = replace(bayer, name="quad", cfa=np.repeat(np.repeat(bayer.cfa, 2, 0), 2, 1))
    grey = replace(bayer, name="grey, one", channels=("w",), cfa=np.zeros((1, 1), np.uint8),
                   responsivity=bayer.responsivity[1:2], responsivity_band=bayer.responsivity_band[1:2])  # fmt: skip
    red_dark = bayer.responsivity.copy()
    red_dark[0] = 0.0
    blind = replace(bayer, name="blind", responsivity=red_dark)
    polarised = replace(load_camera(find_recipe("polarised", "cameras")), name="polarised")
    colour = replace(load_camera(find_recipe("polarised_colour", "cameras")), name="colour")
    noise = 1 + 0.02 * np.random.default_rng(1).standard_normal(polarised.responsivity.shape)
    polarised = replace(polarised, responsivity=polarised.responsivity * noise)  # as measured
    for camera, left_out, line in (
        (polarised, FILES[1:5], "fewer than three of its channels have different responsivities"),
        (colour, FILES[2:5], "colour has no tuning files"),
        (quad, FILES[2:5], "quad has no tuning files for libcamera, which supports only 2×2 arrays of r, g and b"),
        (grey, FILES[1:5], "grey, one has no colour matrices and no tuning files, because it has fewer than three channels"),
        (blind, FILES[1:5], "a channel receives almost no light from A"),
    ):
        save(camera, tmp_path / "camera.h5")
        code, out, err = l3("export", tmp_path / "camera.h5", "-o", tmp_path / camera.name, "--quiet")
        assert (code, err.count("\n")) == (0, 1)
        assert line in err
        assert sorted(path.name for path in (tmp_path / camera.name).iterdir()) == sorted(set(FILES) - set(left_out))
        assert bool(out) == (camera.name in ("quad", "colour"))
        (tmp_path / "camera.h5").unlink()
    assert '"grey, one"' in (tmp_path / "grey, one/datasheet.csv").read_text()


def test_names_of_channels_and_order_do_not_matter(exported: Path, bayer: CameraModel, tmp_path: Path) -> None:
    channels = [2, 0, 1]  # of b, r, g
    cfa = np.array([[channels.index(channel) for channel in row] for row in bayer.cfa.tolist()], np.uint8)
    turned = replace(bayer, channels=("Blue", "Red", "Green"), cfa=cfa, responsivity=bayer.responsivity[channels])
    order = profiles.bayer_order(turned.channels, turned.cfa)
    assert order == (1, 2, 0)
    assert profiles.bayer_order(bayer.channels, bayer.cfa) == (0, 1, 2)
    for names in (("r", "g", "w"), ("r", "red", "g"), ("r", "g", "b", "w")):
        assert profiles.bayer_order(names, bayer.cfa) is None
    assert profiles.bayer_order(bayer.channels, np.array([[0, 1], [2, 1]], np.uint8)) is None
    write_files(replace(turned, name="c\udcff\nm"), tmp_path)  # a name that is not a text
    assert "camera,,c??m,,recipe" in (tmp_path / "datasheet.csv").read_text()
    ours, theirs = (read_tuning(folder / "libcamera_rpi.json") for folder in (tmp_path, exported))
    dcps = [json.loads((folder / "dcp.json").read_text()) for folder in (tmp_path, exported)]
    assert [profile["Channels"] for profile in dcps] == [["Red", "Green", "Blue"], ["r", "g", "b"]]
    for tag in ("ColorMatrix1", "ForwardMatrix2"):
        np.testing.assert_allclose(dcps[0][tag], dcps[1][tag], atol=1e-3)
    assert ours["rpi.awb"] == theirs["rpi.awb"]
    for one, other in zip(ours["rpi.ccm"]["ccms"], theirs["rpi.ccm"]["ccms"], strict=True):
        np.testing.assert_allclose(one["ccm"], other["ccm"], atol=1e-3)


def test_refusals(exported: Path, bayer_recipe: Path, tmp_path: Path, refused: Refused) -> None:
    assert "--force" in refused(1, "export", bayer_recipe, "-o", exported)
    (tmp_path / "file").write_text("")
    assert "is a file, not a folder" in refused(1, "export", bayer_recipe, "-o", tmp_path / "file")
    assert "did you mean" in refused(2, "export", "fivebnd", "-o", tmp_path / "new")
    (tmp_path / "table.h5").write_bytes(b"no HDF5")
    assert "table.h5" in refused(3, "export", tmp_path / "table.h5", "-o", tmp_path / "new")
