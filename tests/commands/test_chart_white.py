"""l3 render --white chart: the greys of a ColorChecker in the frame, wherever and however it lies."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.store import save
from l3cli.charts import locate
from l3cli.charts.locate import Located
from l3cli.charts.patches import corner_cells, homography
from l3cli.frames.frame import RawFrame, as_taken, upright
from l3cli.io.images import read_image
from l3cli.io.pictures.dng import LIGHT_CODES, write_dng
from l3cli.physics import spectra
from l3cli.physics.display import daylight, displayed_xyz, lab, srgb_decoded
from l3cli.stages.rendering.chart_white import _greys, _place
from tests.helpers.photos import FIRST, PITCH, chart_mosaic
from tests.helpers.tables import colorimetric_table


def chroma(picture: Path) -> np.ndarray:
    """C*ab of the neutral patches, from white to black, of a picture in which the chart lies upright."""
    values = srgb_decoded(read_image(picture)[0] / 65535)
    places = [(FIRST[0] + 3 * PITCH, FIRST[1] + PITCH * each) for each in range(6)]
    means = np.array([values[row + 4 : row + 20, col + 4 : col + 20].mean(axis=(0, 1)) for row, col in places])
    return np.asarray(np.hypot(*lab(displayed_xyz(means), daylight())[:, 1:].T))


@pytest.fixture(scope="module")
def table(bayer: CameraModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("chart") / "table.h5"
    save(colorimetric_table(dataclasses.replace(bayer, noise=dataclasses.replace(bayer.noise, dark_current=0.0))), path)
    return path


def test_its_greys_are_neutral_also_where_the_file_states_another_white(
    l3: Callable, table: Path, bayer: CameraModel, tmp_path: Path
) -> None:
    raw, picture = tmp_path / "photo.dng", tmp_path / "a.tif"
    daylight_neutral = bayer.electron_weights @ spectra.illuminant("D55", bayer.wavelength)
    colour = dict.fromkeys(LIGHT_CODES, np.eye(3))
    write_dng(raw, chart_mosaic(bayer, "A"), bayer, colour, daylight_neutral / daylight_neutral.max(), 0.01)
    call = ("render", table, raw, "--bits", 16, "--backend", "reference", "-o", picture, "--force", "--white")
    code, _, err = l3(*call, "chart")
    assert code == 0
    line = next(each for each in err.splitlines() if ": white of the greys of a ColorChecker: x,y = 0.4" in each)
    assert 2700 < float(line.split(" K,")[0].split()[-1]) < 3000
    rows, cols = ([int(n) for n in each.split()[-1].split("–")] for each in line.split("; rows ")[1].split(", "))
    np.testing.assert_allclose([*rows, *cols], [39, 39 + 4 * PITCH, 31, 31 + 6 * PITCH], atol=6)
    assert "its file states another white (5" in err
    assert chroma(picture).max() < 3
    assert l3(*call, "camera")[0] == 0
    assert chroma(picture).max() > 20


def test_clipped_patches_are_left_out_and_pictures_without_a_chart_are_refused(
    l3: Callable, refused: Callable, table: Path, bayer: CameraModel, tmp_path: Path
) -> None:
    values = chart_mosaic(bayer, "A", share=1.3)  # white and the next grey clip
    np.save(tmp_path / "bright.npy", values)
    options = ("--bits", 16, "--backend", "reference", "--exposure", 0.5, "--white", "chart")
    assert l3("render", table, tmp_path / "bright.npy", *options, "-o", tmp_path / "a.tif")[0] == 0
    assert chroma(tmp_path / "a.tif")[2:].max() < 3
    np.save(tmp_path / "none.npy", values[:80, :120])  # six of its patches
    error = refused(3, "render", table, tmp_path / "none.npy", *options, "-o", tmp_path / "b.tif")
    assert "no ColorChecker of 4×6 patches is found in it" in error
    assert "ROW,COL" in error


def test_a_find_that_is_not_certain_is_none(
    refused: Callable, table: Path, bayer: CameraModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    np.save(tmp_path / "chart.npy", chart_mosaic(bayer, "A"))
    found = locate.locate

    def doubtful(*of: Any) -> Located:
        located = found(*of)
        assert located is not None
        return dataclasses.replace(located, fit=0.94)

    monkeypatch.setattr(locate, "locate", doubtful)
    error = refused(3, "render", table, tmp_path / "chart.npy", "--white", "chart", "-o", tmp_path / "a.png")
    assert "no ColorChecker of 4×6 patches is found in it" in error


@pytest.mark.parametrize("orientation", range(8))
def test_its_place_is_that_in_the_upright_picture(orientation: int) -> None:
    marked = np.zeros((100, 140), np.uint16)
    marked[30:70, 20:80] = 1
    corners = np.array([[20, 30], [80, 30], [80, 70], [20, 70]], float)
    frame = RawFrame("a", marked, 0, 4095, orientation=orientation)
    located = Located(homography(corner_cells(4, 6), corners), 1.0)
    place = [int(n) for text in _place(frame, located).split(", ") for n in text.split()[-1].split("–")]
    shown = np.argwhere(upright(marked, orientation))
    (top, left), (bottom, right) = shown.min(axis=0), shown.max(axis=0)
    np.testing.assert_allclose(place, [top, bottom, left, right], atol=1)
    assert as_taken(upright(marked, orientation), orientation).sum() == marked.sum()
    for number, grey in enumerate(_greys(frame, located)):
        rows, cols = grey.where
        assert marked[grey.where].all()
        assert 60 <= rows.start < rows.stop <= 70
        assert 20 + 10 * number <= cols.start < cols.stop <= 30 + 10 * number
