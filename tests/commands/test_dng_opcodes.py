"""Opcode lists of DNG files: bad pixels and gains are carried out, what moves pixels is refused or, if optional, noted."""

import struct
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.store import save
from l3cli.artifacts.table import TransformTable
from l3cli.errors import InputFileError
from l3cli.frames.frame import RawFrame
from l3cli.frames.shading import FRACTION
from l3cli.io.raw.files import read_raw
from tests.helpers.calls import L3, Refused
from tests.helpers.cameras import BAYER
from tests.helpers.dng_files import LONG, Tags, gain_map, opcode_list, write_dng
from tests.helpers.tables import random_table

LIST_1, LIST_2, LIST_3 = 51008, 51009, 51022
ROWS, COLS = 40, 60
ACTIVE, CROP = (2, 4, 38, 58), (1, 3, 30, 48)  # top, left, bottom, right; row, column, rows, columns within it
TAGS: Tags = {50829: (LONG, list(ACTIVE)), 50719: (LONG, [CROP[1], CROP[0]]), 50720: (LONG, [CROP[3], CROP[2]])}
PATTERN = np.array(BAYER)


@pytest.fixture(scope="module")
def table() -> TransformTable:
    return random_table(BAYER, bits=12, black_level=64.0, patch=3)


def stored() -> np.ndarray:
    rows, cols = np.mgrid[:ROWS, :COLS]
    return np.asarray(1000 + 100 * PATTERN[rows % 2, cols % 2], np.uint16)


def read(path: Path, values: np.ndarray, table: TransformTable, tags: Tags) -> RawFrame:
    return read_raw(write_dng(path / "a.dng", values, PATTERN, 16, tags=TAGS | tags), table)


def gain_in(frame: RawFrame) -> np.ndarray:
    """What every value is multiplied by, its own part and that of the outputs."""
    assert frame.shading is not None
    colour = 0 if frame.shading.colour is None else frame.shading.colour / 2**FRACTION
    return np.asarray(frame.shading.gain_map(frame.values.shape[1]) * (1 + colour))


def in_view(whole: np.ndarray) -> np.ndarray:
    """What a frame shows of an active area."""
    return whole[CROP[0] : CROP[0] + CROP[2], CROP[1] : CROP[1] + CROP[3]]


def test_bad_pixels_are_mended_wherever_their_list_counts_from(tmp_path: Path, table: TransformTable) -> None:
    sound = read(tmp_path, stored(), table, {}).values
    values = stored()
    values[[10, 11, 20], [10, 10, 30]] = 7
    values[30:33, 40:42] = 9
    values[15] = 11
    constant = opcode_list((4, 0, struct.pack(">II", 7, 0)))
    listed = struct.pack(">III", 0, 0, 2) + struct.pack(">4I", 30, 40, 33, 42) + struct.pack(">4I", 15, 0, 16, COLS)
    there = struct.pack(">III", 0, 1, 1) + struct.pack(">2I", 13, 1) + struct.pack(">4I", 28, 36, 31, 38)
    values[15, 5] = 13
    one = opcode_list((4, 0, struct.pack(">II", 7, 0)), (5, 0, listed))
    np.testing.assert_array_equal(read(tmp_path, values, table, {LIST_1: one}).values, sound)
    values[15] = stored()[15]
    values[15, 5] = 13
    np.testing.assert_array_equal(
        read(tmp_path, values, table, {LIST_1: constant, LIST_2: opcode_list((5, 0, there))}).values, sound
    )
    beyond = struct.pack(">III", 0, 1, 1) + struct.pack(">2i", -5, 4000) + struct.pack(">4i", -9, -9, 0, 99999)
    assert read(tmp_path, stored(), table, {LIST_2: opcode_list((5, 0, beyond))}).values.shape == sound.shape


def test_gain_maps_are_gains_of_their_sites_or_planes(tmp_path: Path, table: TransformTable) -> None:
    rows, cols = ACTIVE[2] - ACTIVE[0], ACTIVE[3] - ACTIVE[1]
    rng = np.random.default_rng(2)
    maps = {site: 1 + 0.2 * site[0] + np.cumsum(0.1 * rng.random((3, 4)), axis=1) for site in np.ndindex(2, 2)}
    opcodes = [(9, 0, gain_map(grid, (*site, rows, cols), pitch=(2, 2))) for site, grid in maps.items()]
    frame = read(tmp_path, stored(), table, {LIST_2: opcode_list(*opcodes)})
    y, x = ((np.arange(length) + 0.5) / length for length in (rows, cols))
    wanted = np.zeros((rows, cols))
    for (row, col), grid in maps.items():
        lines = np.array([np.interp(y, np.linspace(0, 1, 3), column) for column in grid.T]).T
        whole = np.array([np.interp(x, np.linspace(0, 1, 4), line) for line in lines])
        wanted[row::2, col::2] = whole[row::2, col::2]
    np.testing.assert_allclose(gain_in(frame), in_view(wanted), rtol=1e-4)
    np.testing.assert_array_equal(frame.values, read(tmp_path, stored(), table, {}).values)

    by_plane = opcode_list((9, 0, gain_map(np.array([[[1.0, 1.2, 1.5]]]), (0, 0, rows, cols), (0, 3))))
    frame = read(tmp_path, stored(), table, {LIST_3: by_plane})
    channel = np.tile(PATTERN, (rows // 2, cols // 2))
    np.testing.assert_allclose(gain_in(frame), in_view(np.array([1.0, 1.2, 1.5])[channel]), rtol=1e-4)


def test_radial_vignetting_is_a_gain_of_all_channels(tmp_path: Path, table: TransformTable) -> None:
    terms = struct.pack(">7d", 0.5, 0.25, 0, 0, 0, 0.5, 0.5)
    frame = read(tmp_path, stored(), table, {LIST_3: opcode_list((3, 1, terms))})
    rows, cols = ACTIVE[2] - ACTIVE[0], ACTIVE[3] - ACTIVE[1]
    y, x = np.arange(rows) + 0.5 - rows / 2, np.arange(cols) + 0.5 - cols / 2
    squared = (y[:, None] ** 2 + x**2) / (rows**2 + cols**2) * 4
    np.testing.assert_allclose(gain_in(frame), in_view(1 + 0.5 * squared + 0.25 * squared**2), rtol=2e-4)
    assert frame.notes == ()


def test_what_moves_pixels_is_refused_or_noted(tmp_path: Path, table: TransformTable, l3: L3, refused: Refused) -> None:
    save(table, tmp_path / "table.h5")
    render = ("render", tmp_path / "table.h5", tmp_path / "a.dng", "-o", tmp_path / "a.png", "--backend", "reference")
    warp = struct.pack(">I", 1) + struct.pack(">8d", 1, 0, 0, 0, 0, 0, 0.5, 0.5)
    write_dng(tmp_path / "a.dng", stored(), PATTERN, 16, tags={LIST_3: opcode_list((1, 0, warp))})
    assert "a.dng is to be changed by WarpRectilinear of OpcodeList3, which is not carried out" in refused(3, *render)
    write_dng(tmp_path / "a.dng", stored(), PATTERN, 16, tags={LIST_3: opcode_list((1, 1, warp), (77, 1, b""))})
    code, _, err = l3(*render)
    assert code == 0
    assert "a.dng: WarpRectilinear of OpcodeList3 is optional and not carried out" in err
    assert "a.dng: opcode 77 of OpcodeList3 is optional and not carried out" in err
    for stage, number in ((LIST_1, 9), (LIST_2, 4), (LIST_3, 5), (LIST_2, 8)):
        write_dng(tmp_path / "a.dng", stored(), PATTERN, 16, tags={stage: opcode_list((number, 0, b""))})
        assert "not carried out" in refused(3, *render, "--force")


@pytest.mark.parametrize(
    "opcodes",
    [
        (9, 0, b"short"),
        (9, 0, gain_map(np.full((2, 2), np.nan), (0, 0, 9, 9))),
        (9, 0, gain_map(np.zeros((2, 2)), (0, 0, 9, 9))),
        (9, 0, gain_map(np.ones((2, 2)), (0, 0, 9, 9))[:-4]),
        (9, 0, gain_map(np.ones((2, 2)), (0, 0, 9, 9), pitch=(0, 1))),
        (3, 0, struct.pack(">7d", 1e300, 1e300, 0, 0, 0, 0.5, 0.5)),
        (3, 0, struct.pack(">7d", -2, 0, 0, 0, 0, 0.5, 0.5)),
        (3, 0, struct.pack(">7d", np.inf, 0, 0, 0, 0, 0.5, 0.5)),
        (5, 0, struct.pack(">III", 0, 1 << 30, 0)),
    ],
)
def test_damaged_lists_are_refused(tmp_path: Path, table: TransformTable, opcodes: tuple[int, int, bytes]) -> None:
    with pytest.raises(InputFileError, match="its tags are damaged"):
        read(tmp_path, stored(), table, {LIST_2: opcode_list(opcodes)})


def test_lists_that_end_early_or_never_are_refused(tmp_path: Path, table: TransformTable) -> None:
    kind, content = opcode_list((9, 0, gain_map(np.ones((2, 2)), (0, 0, 9, 9))))
    for broken in (content[:-1], content[:6], [0xFF] * 4 + content[4:], [0, 0, 0, 2] + content[4:]):
        with pytest.raises(InputFileError, match="its tags are damaged"):
            read(tmp_path, stored(), table, {LIST_2: (kind, broken)})
    planes = opcode_list((9, 0, gain_map(np.full((1, 1), 2.0), (0, 0, 1 << 31, 1 << 31), (0, (1 << 32) - 1))))
    for tag in (LIST_2, LIST_3):
        assert gain_in(read(tmp_path, stored(), table, {tag: planes})) == pytest.approx(2.0)
