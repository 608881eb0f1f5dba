"""Warnings about raw values that the camera cannot produce, and no warnings about possible values."""

import dataclasses

import numpy as np
import pytest

from l3cli.artifacts.table import TransformTable
from l3cli.frames.frame import RawFrame
from l3cli.io.raw.headerless import make_layout
from l3cli.rendering.raw_checks import pixel_warnings
from tests.helpers.cameras import BAYER
from tests.helpers.tables import random_table

BLACK, WHITE = 240.0, 4095.0
SHAPE = (96, 160)


@pytest.fixture(scope="module")
def table() -> TransformTable:
    return random_table(BAYER, black_level=BLACK)


def picture(share: float = 1.0, black: float = BLACK, white: float = WHITE, seed: int = 1) -> np.ndarray:
    """A mosaic of smooth light and dark things, the brightest of them clipped at a `share` above one, with noise."""
    rng = np.random.default_rng(seed)
    row, col = np.indices(SHAPE)
    light = np.abs(np.sin(row / 17) * np.cos(col / 23 + row / 40)) ** 2 * (1 + 0.3 * ((row + col) % 2))
    values = black + share * (white - black) * light * 1.1 + rng.normal(0, 6, SHAPE)
    return np.rint(np.clip(values, 0, white)).astype(np.uint16)


def words(
    values: np.ndarray, table: TransformTable, black: float = BLACK, white: float = WHITE, exchangeable: bool = False
) -> str:
    return " / ".join(pixel_warnings(RawFrame("frame", values, black, white, exchangeable=exchangeable), table))


def test_nothing_is_reported_of_what_cameras_give(table: TransformTable) -> None:
    for share in (2.0, 1.0, 0.3, 0.02, 0.0):
        assert words(picture(share), table, exchangeable=True) == ""
    noise = np.random.default_rng(2).normal(BLACK, 40, SHAPE)
    assert words(np.rint(np.clip(noise, 0, WHITE)).astype(np.uint16), table, exchangeable=True) == ""
    assert words(picture(1.0, 0.0), table, 0.0) == ""  # black has been taken off, and is said so
    ten_bits = picture(1.2, 60.0, 1023.0)
    assert words(ten_bits, table, 60.0, 1023.0) == ""  # of another depth, and said so
    assert words(ten_bits << 6, table, 60.0 * 64, 1023.0 * 64) == ""
    assert words(np.full(SHAPE, 255, np.uint16), random_table(BAYER, black_level=0.0), 0.0, 255.0) == ""


@pytest.mark.parametrize("share", [1.2, 0.3])
def test_bytes_that_are_exchanged_and_values_that_are_shifted_up(table: TransformTable, share: float) -> None:
    values = picture(share)
    assert "the two bytes of each value seem to be swapped" in words(values.byteswap(), table)
    for shift in (2, 4):
        text = words(values << shift, table)
        assert ("" if (values.max() << shift) < 1.5 * WHITE else f"all values are multiples of {2**shift}") in text
    assert "exchanged" not in words(values << 4, table)
    assert words(np.minimum(picture(), 3000), table, white=1500.0) == ""  # what is beyond a white level given too low clips
    assert "different bit depth" in words(picture(1.2, 240, 16383), table)


def test_values_that_the_converter_cannot_give(table: TransformTable) -> None:
    values = picture()
    values[0, :3] = 5000
    assert "some values exceed 4095 DN, the maximum for the table's 12 bits" in words(values, table)
    assert words(values, table, white=4096.0) == ""  # the level is of its file, and so is its depth
    values[0, 0] = 65535
    assert "the values reach 65535 DN, but the white level is 4095" in words(values, table)


def test_fewer_bits_than_the_tables(table: TransformTable) -> None:
    assert "the maximum for 8 bits, but the white level is 4095" in words(picture(1.5, 4, 255), table)
    assert "the maximum for 10 bits" in words(picture(1.5, 60, 1023), table)
    assert "the black level was already subtracted or the bit depth is different" in words(picture(0.5, 4, 255), table)
    assert "the black level was already subtracted" in words(picture(1.0, 0.0), table)


def test_a_black_level_that_leaves_fog(table: TransformTable) -> None:
    text = words(picture(), table, 0.0)
    assert "the darkest values are about 2" in text
    assert "or set it to 240" in text
    assert words(picture(), table, 200.0) == ""
    bright = np.maximum(picture(), 900)
    assert words(bright, table, 0.0) == ""


@pytest.mark.parametrize("share", [1.0, 0.1])
def test_rows_and_columns_that_are_exchanged(table: TransformTable, share: float) -> None:
    values = picture(share)
    torn = values.reshape(SHAPE[::-1])
    for read in (torn, torn >> 4):  # the second one also has the values of another bit depth
        text = words(read, table, exchangeable=True)
        assert text.startswith("the picture looks sheared")
        assert text.endswith("‹size› 96x160 (rows first)?")
    assert words(torn, table) == ""  # its file says how many there are
    assert words(values, table, exchangeable=True) == ""


def test_sizes_that_fit_a_file_exchanged() -> None:
    assert make_layout((96, 160), "u16", None).exchangeable
    assert not make_layout((96, 160), "u16", 324).exchangeable
    assert make_layout((96, 160), "raw10", None).exchangeable
    assert not make_layout((97, 160), "raw10", None).exchangeable
    assert dataclasses.replace(make_layout((96, 160), "raw12", None), stride=250).exchangeable is False
