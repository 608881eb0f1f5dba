"""Parts of reports: axes, numbers, labels, pictures, downloads, the verdict, and patches of a chart."""

import dataclasses
import re

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.fit import ChartFit
from l3cli.artifacts.training_set import LightSpectrum, TrainingPair, TrainingSet
from l3cli.evaluation.pictures import holds_chart, inner, patch_colours
from l3cli.frames.measurement import PATCH_NAMES
from l3cli.physics import spectra
from l3cli.report.drawing import Places
from l3cli.report.evaluation import verdict
from l3cli.report.parts import Data, Figures, Table, csv_uri, file_stem
from l3cli.report.validation import calibration_figures
from l3cli.simulation.procedural import BOARD, chart_places, colorchecker_patches
from l3cli.stages.report import chart_subsection
from tests.helpers.pages import csv_rows


def test_a_verdict_states_by_which_figures_and_how_often() -> None:
    def words(frames: int, **wins: int) -> str:
        figures = {"ours": dict.fromkeys(wins, 1.0)}
        return verdict({"frames": [figures] * frames, "better": {"basic": wins}})

    assert words(1, mean_delta_e=1, ssim=1) == "Ours is closer to the ideal than basic in every metric."
    assert words(3, mean_delta_e=3, ssim=3) == "Ours is closer to the ideal than basic in every metric, in every frame."
    some = "Ours is closer to the ideal than basic in mean ΔE00 (3 of 4 frames)"
    assert words(4, mean_delta_e=3, ssim=3) == f"{some}."
    assert words(4, mean_delta_e=3, ssim=2) == f"{some}, but not in SSIM (1)."
    assert words(1, mean_delta_e=0, ssim=1) == "Ours is not closer to the ideal than basic in mean ΔE00."


def test_a_spreadsheet_computes_nothing_that_is_a_name() -> None:
    rows = csv_rows(csv_uri(Data(("name", "value"), (("=HYPERLINK(1)", -1.5), ("-2+3", 2.0), ('a,"b', 0.1 + 0.2)))))
    assert rows == [["name", "value"], [" =HYPERLINK(1)", "-1.5"], [" -2+3", "2"], ['a,"b', "0.3"]]
    assert (file_stem("Größe: ../a b"), file_stem("…")) == ("gr-e-a-b", "figure")


def test_a_label_goes_where_there_is_room_or_nowhere() -> None:
    free = Places(200, 100)
    assert free.place(100, 50, "here") == (100, 45 - 13.5 + 10, "middle")
    crossed_by = Places(200, 100)
    crossed_by.take([(100, 0), (100, 100)], joined=True)
    place = crossed_by.place(100, 50, "aside")
    assert place is not None
    assert place[2] == "start"
    full = Places(200, 100)
    full.take([(x, y) for y in range(0, 100, 4) for x in range(0, 200, 4)], joined=False)
    assert full.place(100, 50, "nowhere") is None


WAVELENGTH = np.arange(390.0, 731.0, 10.0)


def chart_frame(size: tuple[int, int] = (84, 124), light: str = "A") -> TrainingPair:
    """A ColorChecker that fills a frame, under a white of 100 cd/m²."""
    radiance = spectra.illuminant(light, WAVELENGTH)
    weights = spectra.xyz_weights(WAVELENGTH) * radiance
    weights *= 100.0 / weights[1].sum()
    white = weights.sum(axis=1)
    target = np.repeat(BOARD * white, np.prod(size)).reshape(3, *size)
    for reflectance, (rows, cols) in zip(spectra.colorchecker(WAVELENGTH)[1], colorchecker_patches(size), strict=True):
        target[:, rows, cols] = (weights @ reflectance)[:, None, None]
    return TrainingPair(
        raw=np.zeros(size, np.uint16),
        target=target.astype(np.float32),
        white=white,
        scene="chart",
        illuminant=light,
        luminance=100.0,
        exposure=0.01,
        light=LightSpectrum(WAVELENGTH, radiance.astype(np.float32)),
    )


def test_a_chart_is_seen_only_where_one_is() -> None:
    frame = chart_frame()
    filling, within = chart_places((84, 124))
    assert holds_chart(frame, frame.light, filling)
    assert not holds_chart(frame, frame.light, within)
    assert not holds_chart(frame, None, filling)
    turned = dataclasses.replace(frame, target=frame.target[:, ::-1].copy())
    assert not holds_chart(turned, frame.light, filling)
    rows, cols = inner(filling[7])
    stained = frame.target.copy()
    stained[:, rows.start, cols] += 20.0
    assert not holds_chart(dataclasses.replace(frame, target=stained), frame.light, filling)
    flat = dataclasses.replace(frame, target=np.ones_like(frame.target))
    assert not holds_chart(flat, frame.light, filling)


def test_errors_are_those_of_the_patches(bayer: CameraModel) -> None:
    frame = chart_frame()
    regions = chart_places((84, 124))[0]
    ours = frame.target.copy()
    rows, cols = regions[14]
    ours[:, rows, cols] *= 0.7  # the red patch becomes darker
    ours[:, rows.start, cols] = 0  # what lies beside a patch's edge does not count
    planes = {"ours": ours, "basic": frame.target}
    colours = patch_colours(frame, planes, regions)
    assert np.allclose(np.delete(colours.delta_e["ours"], 14), 0, atol=1e-3)
    assert 5 < colours.delta_e["ours"][14] < 20
    assert np.allclose(colours.delta_e["basic"], 0)
    head = TrainingSet(camera=bayer, outputs=("X", "Y", "Z"), target_description="")
    part = chart_subsection(frame, 2, planes, head)
    assert part is not None
    figures, table = part.blocks
    assert isinstance(figures, Figures)
    assert isinstance(table, Table)
    figure = figures.figures[0]
    assert figure.title == "Patches in frame 3, chart, A"
    assert f"Largest ΔE00 of ours: red, {colours.delta_e['ours'][14]:.2f}" in figure.finding
    assert figure.svg.count("<rect") == 48
    fills = re.findall('fill="(#[0-9a-f]{6})"', figure.svg)
    assert [one == other for one, other in zip(fills[::2], fills[1::2], strict=True)] == [patch != 14 for patch in range(24)]
    assert [row[0] for row in table.rows] == list(PATCH_NAMES)
    assert figure.data is not None
    assert len(figure.data.rows) == 24
    assert chart_subsection(dataclasses.replace(frame, light=None), 2, planes, head) is None


@pytest.mark.parametrize(("lights", "drawn"), [(("D65", "A"), 2), (("my lamp", "A"), 1)])
def test_charts_of_a_calibration_show_measured_next_to_predicted(
    bayer: CameraModel, lights: tuple[str, ...], drawn: int
) -> None:
    surfaces = spectra.colorchecker(bayer.wavelength)[1]
    radiance = [spectra.illuminant(light, bayer.wavelength) for light in ("D65", "A")]
    predicted = np.array([surfaces * light @ bayer.responsivity.T for light in radiance])
    predicted *= 2000 / predicted.max()
    measured = predicted.copy()
    measured[-1, 12] *= 1.2  # the blue patch of the last chart
    none = np.zeros(3)
    fit = ChartFit(none, none, none + 64, none, none, lights, measured + 64, predicted + 64)
    figures = calibration_figures(bayer, fit)
    assert [figure.title for figure in figures] == [f"Chart under {light}" for light in lights[-drawn:]]
    assert "Largest ΔE00 of measured: blue" in figures[-1].finding
    assert figures[-1].data is not None
    errors = np.array([float(row[3]) for row in figures[-1].data.rows])
    assert errors[12] > 1
    assert np.allclose(np.delete(errors, 12), 0, atol=1e-6)
