"""The colour filter array stated in raw files: codes, phases, DNG files, and camera raw files read by LibRaw."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from l3cli.errors import InputFileError
from l3cli.frames.frame import with_one_black_level
from l3cli.io.raw.cfa_codes import channel_codes, find_phase
from l3cli.io.raw.files import RawOverrides, read_raw
from tests.helpers.calls import Refused
from tests.helpers.cameras import FIVE_BAND
from tests.helpers.dng_files import BYTE, LONG, RATIONAL, SHORT, SRATIONAL, lossless_jpeg, packed, write_dng
from tests.helpers.raw_files import RGGB
from tests.helpers.tables import random_table

X_TRANS = np.array(
    [[1, 2, 1, 1, 0, 1], [0, 1, 0, 2, 1, 2], [1, 2, 1, 1, 0, 1], [1, 0, 1, 1, 2, 1], [2, 1, 2, 0, 1, 0], [1, 0, 1, 1, 2, 1]]
)
QUAD = np.kron(np.array([[0, 1], [1, 2]]), np.ones((2, 2), int))
RGB = ("r", "g", "b")
PATTERN = np.array([[0, 1], [1, 2]])


@dataclasses.dataclass(frozen=True)
class Sensor:
    """What the readers ask of a table."""

    channels: tuple[str, ...]
    cfa: np.ndarray
    rows: int = 32
    cols: int = 40
    black_level: float = 64.0
    white_level: float = 4095.0
    camera: None = None

    def dark_signal(self, exposure: float | None) -> float:
        return 0.0

    def gain_at(self, iso: float) -> None:
        return None


def sensor(channels: tuple[str, ...], cfa: np.ndarray) -> Any:
    return Sensor(channels, cfa.astype(np.uint8))


# --------------------------------------------------------------------------------------- the colour filter array


@given(
    st.sampled_from([(RGB, PATTERN), (RGB, X_TRANS), (("r", "g", "b", "ir"), np.array([[0, 1], [3, 2]])),
                     (tuple("abcdefghijklmnop"), np.arange(16).reshape(4, 4)), (("r", "g", "b", "o", "c"), FIVE_BAND)]),
    st.integers(0, 20), st.integers(0, 20),
)  # fmt: skip
def test_phase_of_free_codes(case: tuple[tuple[str, ...], np.ndarray], row: int, col: int) -> None:
    channels, cfa = case
    ours = sensor(channels, np.asarray(cfa))
    seen = np.roll(channel_codes(channels)[cfa], (-row, -col), axis=(0, 1))
    phase = find_phase("f", seen, ours)
    np.testing.assert_array_equal(np.roll(cfa, (-phase[0], -phase[1]), axis=(0, 1)), np.roll(cfa, (-row, -col), axis=(0, 1)))


def test_codes_are_those_of_the_standard() -> None:
    assert channel_codes(("Red", "g", "B", "cyan", "M", "y", "white", "ir", "r")).tolist() == [0, 1, 2, 3, 4, 5, 6, 14, 15]


def test_what_another_writer_calls_infrared() -> None:
    ours = sensor(("r", "g", "b", "ir"), np.array([[0, 1], [3, 2]]))
    assert find_phase("f", np.array([[9, 2], [0, 1]]), ours) == (1, 0)


@pytest.mark.parametrize(
    ("channels", "cfa", "pattern", "word"),
    [
        (RGB, PATTERN, QUAD, r"rrgg/rrgg/ggbb/ggbb, but the table has rg/gb.*‹phase›"),
        (RGB, QUAD, PATTERN, r"rg/gb, but the table has rrgg"),
        (RGB, X_TRANS, PATTERN, r"rg/gb, but the table has gb"),
        (RGB, PATTERN, np.array([[0, 1], [2, 1]]), r"rg/bg"),
        (("r", "g", "b", "w"), np.array([[0, 1], [3, 2]]), PATTERN, r"the table has rg/wb"),
        (("one", "two"), np.array([[0, 1], [1, 0]]), np.array([[0, 1], [1, 0]]), r"several positions.*‹phase›"),
        (RGB, PATTERN, np.zeros((17, 2), int), r"17×2"),
    ],
)
def test_another_array_is_refused(channels: tuple[str, ...], cfa: np.ndarray, pattern: np.ndarray, word: str) -> None:
    with pytest.raises(InputFileError, match=word):
        find_phase("f", pattern, sensor(channels, np.asarray(cfa)))


# --------------------------------------------------------------------------------------------------------------- DNG


def tiles(values: np.ndarray, size: tuple[int, int], encode: Callable[[np.ndarray], bytes]) -> list[bytes]:
    rows, cols = (-(-length // step) * step for length, step in zip(values.shape, size, strict=True))
    whole = np.pad(values, ((0, rows - values.shape[0]), (0, cols - values.shape[1])), mode="edge")
    starts = [(row, col) for row in range(0, rows, size[0]) for col in range(0, cols, size[1])]
    return [encode(whole[row : row + size[0], col : col + size[1]]) for row, col in starts]


def read_bayer(path: Path, phase: tuple[int, int] | None = None) -> Any:
    return read_raw(path, RGGB, RawOverrides(phase=phase))


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
def test_packed_dng(tmp_path: Path, bits: int, order: str) -> None:
    values = np.random.default_rng(bits).integers(0, 2**bits, (23, 33)).astype(np.uint16)
    cfa = channel_codes(("r", "g", "b", "o", "c"))[FIVE_BAND]
    known = {50714: (SHORT, [7]), 50717: (LONG, [200])}
    frame = read_raw(write_dng(tmp_path / "a.dng", values, cfa, bits, order, tags=known), random_table(FIVE_BAND, patch=9))
    np.testing.assert_array_equal(frame.values, values)
    assert (frame.black_level, frame.white_level, frame.phase) == (7, 200, (0, 0))


def test_compressed_and_divided_dng(tmp_path: Path, mosaic: np.ndarray) -> None:
    def tiled(bits: int, compression: int, encode: Callable[[np.ndarray], bytes]) -> Path:
        strips = tiles(mosaic, (16, 16), encode)
        lengths = (LONG, [len(strip) for strip in strips])
        tags = {259: (SHORT, [compression]), 322: (LONG, [16]), 323: (LONG, [16]), 324: (LONG, [0] * 6), 325: lengths}
        return write_dng(tmp_path / "a.dng", mosaic, PATTERN, bits, strips=strips, tags=tags)

    strips = [packed(mosaic[start : start + 8], 12, "<") for start in range(0, 32, 8)]
    divided = {278: (LONG, [8])}
    for path in (
        lambda: write_dng(tmp_path / "a.dng", mosaic, PATTERN, strips=[lossless_jpeg(mosaic)], tags={259: (SHORT, [7])}),
        lambda: write_dng(tmp_path / "a.dng", mosaic, PATTERN, 12, strips=strips, tags=divided),
        lambda: tiled(16, 7, lossless_jpeg),
        lambda: tiled(12, 1, lambda tile: packed(tile, 12, "<")),
    ):
        np.testing.assert_array_equal(read_bayer(path()).values, mosaic)
    write_dng(tmp_path / "a.dng", mosaic, PATTERN, 12, strips=strips, gap=2, tags=divided)
    with pytest.raises(InputFileError, match="strips"):
        read_bayer(tmp_path / "a.dng")


def test_masked_borders_crop_and_orientation(tmp_path: Path, mosaic: np.ndarray) -> None:
    tags = {
        50829: (SHORT, [3, 4, 29, 39]),  # active area: top, left, bottom, right
        50719: (RATIONAL, [5, 1, 2, 1]),  # crop origin: across, down
        50720: (SHORT, [15, 10]),
        274: (SHORT, [6]),
    }
    frame = read_bayer(write_dng(tmp_path / "a.dng", mosaic, PATTERN, tags=tags))
    np.testing.assert_array_equal(frame.values, mosaic[5:15, 9:24])
    assert frame.phase == (0, 1)  # two rows down and five columns across from the corner of the active area
    assert frame.orientation == 6  # LibRaw's code of a quarter turn to the right
    assert read_bayer(tmp_path / "a.dng", (1, 0)).phase == (1, 0)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_is_that_of_libraw(tmp_path: Path, mosaic: np.ndarray, orientation: int) -> None:
    import rawpy

    path = write_dng(tmp_path / "a.dng", mosaic, PATTERN, tags={274: (SHORT, [orientation])})
    with rawpy.imread(str(path)) as raw:
        assert read_bayer(path).orientation == raw.sizes.flip


def test_black_levels_that_differ_become_one(tmp_path: Path) -> None:
    values = np.full((32, 40), 1000, np.uint16)
    values[1, 1] = 4000
    columns, rows = [2 * (col % 3) for col in range(36)], [1, 0] * 14
    tags = {
        50829: (SHORT, [4, 4, 32, 40]),
        50713: (SHORT, [2, 2]),
        50714: (RATIONAL, [60, 1, 64, 1, 68, 1, 128, 2]),
        50715: (SRATIONAL, [part for step in columns for part in (step, 1)]),
        50716: (SRATIONAL, [part for step in rows for part in (step, 1)]),
    }
    frame = read_bayer(write_dng(tmp_path / "a.dng", values, PATTERN, tags=tags))
    black_level = np.tile([[60, 64], [68, 64]], (14, 18)) + np.array(columns) + np.array(rows)[:, None]
    np.testing.assert_array_equal(frame.values - frame.black_level, 1000 - black_level)
    assert frame.black_level == round(black_level.mean())
    assert frame.white_level - frame.black_level == 4000 - black_level.max()  # the pixel that saturates first


def test_saturation_survives_levelling() -> None:
    black_level, white_level = np.array([[96.0, 104.0]]), np.array([[1000.0, 1000.0]])
    values, common, top = with_one_black_level(np.array([[1000, 1000], [96, 104]], np.uint16), black_level, white_level)
    assert (common, top) == (100, 996)
    assert values.tolist() == [[1004, 996], [100, 100]]
    assert with_one_black_level(values, np.array([[64.5]]), np.array(900.0))[1:] == (64.5, 900.0)


@pytest.mark.parametrize(
    ("tags", "word"),
    [
        ({33421: (SHORT, [4, 4]), 33422: (BYTE, QUAD.ravel().tolist())}, "rrgg/rrgg/ggbb/ggbb, but the table has rg/gb"),
        ({50829: (SHORT, [8, 0, 33, 40])}, "active area (8, 0, 33, 40) exceeds the 32×40 pixels"),
        ({50720: (SHORT, [41, 24])}, "crop"),
        ({50714: (SHORT, [4000])}, "has a black level of 4000 DN, which is not between 0 and the white level"),
        ({50715: (SRATIONAL, [1, 1])}, "instead of 40"),
        ({50714: (RATIONAL, [1, 0])}, "damaged black level"),
        ({50711: (SHORT, [2])}, "staggered"),
        ({33421: (SHORT, [0, 4])}, "damaged tags"),
        ({33421: (SHORT, [65535, 65535])}, "damaged tags"),
        ({274: (SHORT, [99])}, "the tag Orientation is 99, but TIFF defines only 1…8"),
    ],
)
def test_a_dng_that_does_not_fit_is_refused(
    refused: Refused, tmp_path: Path, raw_table: Path, mosaic: np.ndarray, tags: dict[int, tuple[int, list[int]]], word: str
) -> None:
    write_dng(tmp_path / "a.dng", mosaic, PATTERN, tags=tags)
    assert word in refused(3, "render", raw_table, tmp_path / "a.dng", "-o", tmp_path / "a.png")


# ------------------------------------------------------------------------------------------------- camera raws by LibRaw


@pytest.mark.parametrize("name", ["a.raf", "a.nef"])
def test_libraw_gives_the_phase_of_any_array_it_knows(tmp_path: Path, mosaic: np.ndarray, name: str) -> None:
    """LibRaw goes by a file's content, so that a DNG under a camera's suffix is read as the camera's raws are."""
    tags = {50829: (SHORT, [4, 6, 30, 38])}
    cfa = X_TRANS if name == "a.raf" else PATTERN
    path = write_dng(tmp_path / name, mosaic, np.roll(cfa, (-1, -1), axis=(0, 1)), tags=tags)
    frame = read_raw(path, sensor(RGB, cfa))
    np.testing.assert_array_equal(frame.values, mosaic[4:30, 6:38])
    assert (frame.phase, frame.black_level, frame.white_level) == ((1, 1), 64, 4000)
    with pytest.raises(InputFileError, match="‹phase›"):
        read_raw(path, sensor(RGB, QUAD))
    assert read_raw(path, sensor(RGB, QUAD), RawOverrides(phase=(2, 3))).phase == (2, 3)


@pytest.mark.parametrize("name", ["a.dng", "a.nef"])
def test_a_sensor_without_filters(tmp_path: Path, mosaic: np.ndarray, name: str) -> None:
    one = np.array([[0]])
    path = write_dng(tmp_path / name, mosaic, one, tags={262: (SHORT, [34892])}, drop=(33421, 33422, 50710))
    frame = read_raw(path, sensor(("clear",), np.array([[0]])))
    np.testing.assert_array_equal(frame.values, mosaic)
    with pytest.raises(InputFileError, match="array w, but the table has rg/gb"):
        read_bayer(path)


def test_libraw_black_levels_of_the_colours_become_one(tmp_path: Path, mosaic: np.ndarray) -> None:
    tags = {50713: (SHORT, [2, 2]), 50714: (SHORT, [60, 64, 66, 70])}
    mosaic = np.maximum(mosaic, 100)
    frame = read_bayer(write_dng(tmp_path / "a.nef", mosaic, PATTERN, tags=tags))
    black_level = np.tile([[60, 64], [66, 70]], (16, 20))
    np.testing.assert_array_equal(frame.values - frame.black_level, mosaic - black_level)
    assert frame.white_level - frame.black_level == 3930
