"""Parts of a report: axes and their ticks, numbers, labels, pictures, downloads, the verdict."""

import numpy as np

from l3cli.report.drawing import Axis, Places, spanning, tick_text
from l3cli.report.evaluation import verdict
from l3cli.report.page import csv_uri, file_stem
from l3cli.report.parts import Data
from l3cli.report.pictures import fitted, reduced
from l3cli.system.text import tidy
from tests.helpers.pages import csv_rows


def test_a_verdict_says_by_which_figures_and_how_often() -> None:
    def said(frames: int, **wins: int) -> str:
        figures = {"ours": dict.fromkeys(wins, 1.0)}
        return verdict({"frames": [figures] * frames, "better": {"basic": wins}})

    assert said(1, mean_delta_e=1, ssim=1) == "Ours is nearer to the ideal than basic by every figure."
    assert said(3, mean_delta_e=3, ssim=3) == "Ours is nearer to the ideal than basic by every figure, in every frame."
    some = "Ours is nearer to the ideal than basic by mean ΔE00 in 3 of 4 frames"
    assert said(4, mean_delta_e=3, ssim=3) == f"{some}."
    assert said(4, mean_delta_e=3, ssim=2) == f"{some}, not by SSIM (1)."
    assert said(1, mean_delta_e=0, ssim=1) == "Ours is not nearer to the ideal than basic by mean ΔE00."


def test_a_spreadsheet_computes_nothing_that_is_a_name() -> None:
    rows = csv_rows(csv_uri(Data(("name", "value"), (("=HYPERLINK(1)", -1.5), ("-2+3", 2.0), ('a,"b', 0.1 + 0.2)))))
    assert rows == [["name", "value"], [" =HYPERLINK(1)", "-1.5"], [" -2+3", "2"], ['a,"b', "0.3"]]
    assert (file_stem("Größe: ../a b"), file_stem("…")) == ("gr-e-a-b", "figure")


def test_ticks_are_round_and_enough() -> None:
    for axis in (
        Axis("", 0, 0.27),
        Axis("", -3.2, 3.4),
        Axis("", 1e-7, 10, True),
        Axis("", 0.21, 0.29, True),
        Axis("", 0.2, 1.3, True),
    ):
        ticks = axis.ticks()
        assert 3 <= len(ticks) <= 10, ticks
        assert all(axis.low * 0.99 <= tick <= axis.high * 1.01 or abs(tick) < 1e-9 for tick in ticks)
        assert len({tick_text(tick) for tick in ticks}) == len(ticks)
    assert (tick_text(1e-7), tick_text(0.01), tick_text(-2), tick_text(2e5)) == ("10⁻⁷", "0.01", "−2", "2×10⁵")
    assert spanning("", np.full(3, 2.0)).high > spanning("", np.full(3, 2.0)).low


def test_numbers_read_without_exponents_where_they_can() -> None:
    shown = [tidy(value) for value in (0, 0.25, -0.0979, 24000, 12.3456, 1.1843e7, 3.2e-6)]
    assert shown == ["0", "0.25", "−0.0979", "24000", "12.3", "1.18×10⁷", "3.20×10⁻⁶"]


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


def test_pictures_are_made_smaller_until_they_fit() -> None:
    def jpeg(pixels: np.ndarray, quality: int) -> bytes:
        return b"x" * (pixels.size * quality // 100)

    picture = np.zeros((64, 96, 3), np.uint8)
    assert fitted(picture, 10**6, jpeg)[1] == (64, 96)
    uri, size = fitted(picture, 3000, jpeg)
    assert size == (16, 24)
    assert len(uri) < 3100
    assert np.allclose(reduced(np.arange(16.0).reshape(4, 4, 1), 2)[..., 0], [[2.5, 4.5], [10.5, 12.5]])


def test_what_is_no_number_is_named_as_such() -> None:
    assert [tidy(value) for value in (float("nan"), float("inf"), float("-inf"))] == ["–", "∞", "−∞"]
