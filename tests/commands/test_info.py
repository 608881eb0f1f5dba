"""l3 info describes a raw file as l3 reads it."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.helpers import dng_files
from tests.helpers.calls import L3, Refused
from tests.helpers.dng_files import ASCII, RATIONAL, SHORT, Tags

GRBG = np.array([[1, 0], [2, 1]])
VALUES = np.arange(100, 100 + 24 * 32, dtype=np.uint16).reshape(24, 32)


def described(l3: L3, path: Path) -> dict:
    code, out, _ = l3("info", path, "--json", "--quiet")
    assert code == 0
    document: dict = json.loads(out)
    return document


def test_a_dng_is_described_as_its_tags_state(l3: L3, tmp_path: Path) -> None:
    tags: Tags = {
        274: (SHORT, [6]),
        33434: (RATIONAL, [1, 50]),
        50728: (RATIONAL, [1, 2, 1, 1, 2, 3]),
        271: (ASCII, list(b"Some\0")),
        272: (ASCII, list(b"Some One\0")),
    }
    path = dng_files.write_dng(tmp_path / "a.dng", VALUES, GRBG, tags=tags)
    found = described(l3, path)
    assert (found["size"], found["black_level"], found["white_level"]) == ([24, 32], 64, 4000)
    assert found["values"] == {"lowest": 100, "mean": VALUES.mean(), "highest": 100 + 24 * 32 - 1}
    assert (found["filter_array"], found["orientation"], found["exposure_time"]) == ("gr/bg", 6, 0.02)
    assert found["neutral"] == pytest.approx({"r": 0.5, "g": 1, "b": 2 / 3}, rel=1e-6)
    out = l3("info", path)[1]
    for line in ("24×32 pixels", "gr/bg", "0.02 s", "turned by 90° to the right", "r 0.5 : g 1 : b 0.6667"):
        assert line in out


def test_the_saturated_fraction_counts_values_at_the_white_level(l3: L3, tmp_path: Path) -> None:
    values = VALUES.copy()
    values[:6] = 4000
    path = dng_files.write_dng(tmp_path / "a.dng", values, GRBG)
    assert described(l3, path)["saturated"] == 0.25
    assert "reached by 25 % of the pixels" in l3("info", path)[1]


def test_a_picture_file_states_only_its_values(l3: L3, tmp_path: Path) -> None:
    (tmp_path / "a.pgm").write_bytes(b"P5 32 24 65535\n" + VALUES.astype(">u2").tobytes())
    found = described(l3, tmp_path / "a.pgm")
    assert found["size"] == [24, 32]
    assert {found[key] for key in ("black_level", "white_level", "filter_array", "neutral", "exposure_time", "camera")} == {
        None
    }
    assert l3("info", tmp_path / "a.pgm")[1].count("not stated") == 5


def test_files_that_are_no_frame_are_refused(refused: Refused, tmp_path: Path) -> None:
    (tmp_path / "a.dng").write_bytes(b"text")
    assert "a.dng" in refused(3, "info", tmp_path / "a.dng")
    np.save(tmp_path / "rgb.npy", np.zeros((4, 4, 3), np.uint16))
    assert "rgb.npy" in refused(3, "info", tmp_path / "rgb.npy")


def test_a_photo_of_a_real_camera_is_described(l3: L3, l3_data: Path) -> None:
    found = described(l3, l3_data / "raw/colorchart.dng")
    assert (found["camera"], found["filter_array"], found["black_level"]) == ("Canon EOS Kiss X4", "rg/gb", 2056)
