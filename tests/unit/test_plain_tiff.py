"""TIFFs as l3 writes them, read without a library: the same values as by the library, and every other file left to it."""

import os
import struct
from pathlib import Path

import numpy as np
import pytest

from l3cli.io.pictures.openimageio import write_mosaic
from l3cli.io.pictures.registry import write_picture
from l3cli.io.raw import registry, tiff
from l3cli.system.limits import MEGAPIXELS, TRUST


def mosaic(rows: int, cols: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 65536, (rows, cols), np.uint16)


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(TRUST, "1")


@pytest.mark.parametrize("exposure", [None, 1e-6, 0.01, 1 / 3, 2.5, 4000.0])
@pytest.mark.parametrize("shape", [(1, 1), (3, 2), (32, 7), (33, 50), (100, 301)])
def test_the_same_as_by_the_library(tmp_path: Path, shape: tuple[int, int], exposure: float | None) -> None:
    path = tmp_path / "a.tif"
    write_mosaic(path, mosaic(*shape), exposure)
    content = tiff.read_plain(path)
    content = tiff.read_by_library(path)
    values, time = content["values"], content["exposure"]
    assert content is not None
    np.testing.assert_array_equal(content["values"], mosaic(*shape))
    np.testing.assert_array_equal(content["values"], values)
    assert (content["values"].dtype, content["exposure"]) == (values.dtype, time)
    assert tiff.is_plain(path)
    assert not registry.needs_isolation(path)


def test_every_changed_byte_is_refused_or_read_as_by_the_library(tmp_path: Path) -> None:
    path, broken = tmp_path / "a.tif", tmp_path / "b.tif"
    write_mosaic(path, mosaic(5, 7), 0.04)
    whole, accepted = path.read_bytes(), 0
    for place in range(len(whole)):
        for change in (1, 0x80, 0xFF):
            broken.write_bytes(whole[:place] + bytes([whole[place] ^ change]) + whole[place + 1 :])
            content = tiff.read_plain(broken)
            assert tiff.is_plain(broken) == (content is not None)
            if content is not None:
                content = tiff.read_by_library(broken)
                values, time = content["values"], content["exposure"]
                np.testing.assert_array_equal(content["values"], values)
                assert content["exposure"] == pytest.approx(time, rel=1e-6)
                accepted += 1
        broken.write_bytes(whole[:place])
        assert tiff.read_plain(broken) is None
    assert 70 <= accepted < 2 * len(whole)  # of three times as many: pixels, the date, the exposure, unused bytes


def test_a_directory_that_claims_much_or_leads_back_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    write_mosaic(path, mosaic(40, 7))
    whole = path.read_bytes()
    (at,) = struct.unpack("<I", whole[4:8])
    following = at + 2 + 12 * struct.unpack("<H", whole[at : at + 2])[0]
    for place, content in (
        (following, struct.pack("<I", at)),  # a page behind, the same again
        (at, b"\xff\xff"),
        (at + 2 + 4, struct.pack("<I", 2**32 - 1)),  # so many widths
        (at + 2 + 8, struct.pack("<I", 2**31)),  # so wide
    ):
        path.write_bytes(whole[:place] + content + whole[place + len(content) :])
        assert tiff.read_plain(path) is None


def test_other_files_are_left_to_the_isolated_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    coloured, empty, pipe, plain = (tmp_path / f"{name}.tif" for name in ("coloured", "empty", "pipe", "plain"))
    write_picture(coloured, np.zeros((4, 4, 3), np.uint8))
    empty.touch()
    os.mkfifo(pipe)
    write_mosaic(plain, mosaic(20, 30))
    for path in (coloured, empty, pipe, tmp_path, tmp_path / "missing.tif"):
        assert not tiff.is_plain(path)
        assert registry.needs_isolation(path) == bool(path.suffix)
    write_mosaic(tmp_path / "eight.tif", mosaic(20, 30).astype(np.uint8))
    assert tiff.is_plain(tmp_path / "eight.tif")
    assert tiff.read_plain(tmp_path / "eight.tif", (16,)) is None
    monkeypatch.setenv(MEGAPIXELS, "0.0001")
    assert not tiff.is_plain(plain)  # whoever reads all kinds says that it is too large
    monkeypatch.setenv(MEGAPIXELS, "many")
    assert not tiff.is_plain(plain)
