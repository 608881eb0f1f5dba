"""The lens warp of DNG files: known warps become straight, and pictures, floats and whites use the same positions."""

import dataclasses
import struct
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.store import save
from l3cli.artifacts.table import TransformTable
from l3cli.errors import InputFileError, RecipeError
from l3cli.frames.frame import as_taken
from l3cli.frames.lens_warp import LensWarp, Terms, warped
from l3cli.frames.shading import FRACTION
from l3cli.io.images import read_image
from l3cli.io.raw.files import RawOverrides, read_raw
from l3cli.physics.spaces import SRGB
from l3cli.rendering.display import make_display
from l3cli.rendering.opencl.renderer import OpenCLRenderer
from l3cli.rendering.reference import ReferenceRenderer
from l3cli.rendering.uncertainty import uncertainty
from l3cli.rendering.white.scene_white import Square
from tests.helpers import dng_files
from tests.helpers.calls import L3
from tests.helpers.cameras import BAYER
from tests.helpers.tables import random_table

PATTERN = np.array([[0, 1], [1, 2]])
RED: Terms = (1.002, 0.05, -0.02, 0.003, 1e-3, -2e-3)
GREEN: Terms = (1.0, 0.05, -0.02, 0.003, 1e-3, -2e-3)
BLUE: Terms = (0.997, 0.05, -0.02, 0.003, 1e-3, -2e-3)
CENTRE = (0.52, 0.47)
LIST_3 = 51022


def source(terms: Terms, row: float, col: float, rows: int, cols: int) -> tuple[float, float]:
    """The equations of WarpRectilinear, for the centre of one pixel."""
    kr0, kr1, kr2, kr3, kt0, kt1 = terms
    cy, cx = CENTRE[0] * rows, CENTRE[1] * cols
    m = np.hypot(max(cx, cols - cx), max(cy, rows - cy))
    dx, dy = (col + 0.5 - cx) / m, (row + 0.5 - cy) / m
    r2 = dx**2 + dy**2
    f = kr0 + kr1 * r2 + kr2 * r2**2 + kr3 * r2**3
    tangential_x = kt0 * 2 * dx * dy + kt1 * (r2 + 2 * dx**2)
    tangential_y = kt1 * 2 * dx * dy + kt0 * (r2 + 2 * dy**2)
    return cy + m * (f * dy + tangential_y) - 0.5, cx + m * (f * dx + tangential_x) - 0.5


def content(*sets: Terms) -> bytes:
    """The content of an opcode WarpRectilinear."""
    numbers = [value for terms in sets for value in terms]
    return struct.pack(f">I{len(numbers) + 2}d", len(sets), *numbers, CENTRE[1], CENTRE[0])


@pytest.mark.parametrize("sets", [(GREEN,) * 3, (RED, GREEN, BLUE)])
def test_a_grid_of_points_comes_out_straight(sets: tuple[Terms, Terms, Terms]) -> None:
    rows, cols = 240, 320
    y, x = np.mgrid[:rows, :cols]
    points = [(row, col) for row in range(24, rows - 16, 32) for col in range(24, cols - 16, 32)]
    taken = np.zeros((3, rows, cols))
    for colour, terms in enumerate(sets):
        for point in points:
            row, col = source(terms, *point, rows, cols)
            taken[colour] += np.exp(-((y - row) ** 2 + (x - col) ** 2) / (2 * 2.0**2))
    outputs = np.einsum("op,prc->orc", np.linalg.inv(SRGB.from_xyz), taken).astype(np.float32)
    made = warped(outputs, ("X", "Y", "Z"), [LensWarp(sets, CENTRE, (rows, cols))])
    colours = np.einsum("po,orc->prc", SRGB.from_xyz, made)
    for row, col in points:
        window = np.s_[row - 8 : row + 9, col - 8 : col + 9]
        for plane in colours:
            weight = plane[window]
            assert (weight * y[window]).sum() / weight.sum() == pytest.approx(row, abs=0.05)
            assert (weight * x[window]).sum() / weight.sum() == pytest.approx(col, abs=0.05)


def test_outputs_that_are_no_colours_move_as_green() -> None:
    planes = np.random.default_rng(1).random((2, 30, 40), np.float32)
    separate, together = (LensWarp(sets, CENTRE, (30, 40)) for sets in ((RED, GREEN, BLUE), (GREEN,) * 3))
    np.testing.assert_array_equal(warped(planes, ("a", "b"), [separate]), warped(planes, ("a", "b"), [together]))


def test_a_shift_by_whole_pixels_changes_no_value() -> None:
    """Two warps in succession: the second undoes the first, so that only the places count, not the interpolation."""
    planes = np.random.default_rng(1).random((3, 20, 20), np.float32)
    there, back = (LensWarp((terms,) * 3, (0.5, 0.5), (20, 20)) for terms in ((0.5, 0, 0, 0, 0, 0), (2.0, 0, 0, 0, 0, 0)))
    np.testing.assert_allclose(warped(planes, "XYZ", [there, back]), planes, atol=1e-6)


@pytest.fixture(scope="module")
def table() -> TransformTable:
    return dataclasses.replace(random_table(BAYER, bits=12, black_level=64, patch=5), white_level=4000.0)


def photo(folder: Path, *opcodes: tuple[int, int, bytes], orientation: int = 1) -> Path:
    """A DNG of 60 × 80 pixels with masked borders and a crop."""
    values = np.random.default_rng(3).integers(300, 3500, (66, 88)).astype(np.uint16)
    values = np.asarray((values + np.roll(values, 2, 0) + np.roll(values, 2, 1)) // 3, np.uint16)
    tags = {
        50829: (dng_files.LONG, [2, 4, 66, 88]), 50719: (dng_files.LONG, [2, 2]), 50720: (dng_files.LONG, [80, 60]),
        274: (dng_files.SHORT, [orientation]), LIST_3: dng_files.opcode_list(*opcodes),
    }  # fmt: skip
    return dng_files.write_dng(folder / "a.dng", values, PATTERN, 16, tags=tags)


@pytest.mark.parametrize("flags", [0, 1])
@pytest.mark.parametrize("sets", [(GREEN,), (RED, GREEN, BLUE)])
def test_pictures_and_outputs_of_a_file_are_warped(
    tmp_path: Path, table: TransformTable, l3: L3, flags: int, sets: tuple[Terms, ...]
) -> None:
    save(table, tmp_path / "table.h5")
    path = photo(tmp_path, (1, flags, content(*sets)), orientation=6)
    call = ("render", tmp_path / "table.h5", path, "--backend", "reference", "-o")
    assert l3(*call, tmp_path / "warped.exr")[0] == 0
    assert l3(*call, tmp_path / "left.exr", "--opcodes", "leave")[0] == 0
    moved, left = (as_taken(read_image(tmp_path / f"{name}.exr")[0], 6) for name in ("warped", "left"))
    red, green, blue = sets if len(sets) == 3 else sets * 3
    warp = LensWarp((red, green, blue), CENTRE, (64, 84), (2, 2))
    wanted = np.moveaxis(warped(np.moveaxis(left, -1, 0), table.outputs, [warp]), 0, -1)
    np.testing.assert_allclose(moved, wanted, rtol=1e-4, atol=1e-5)
    assert np.abs(moved - left).max() > 0.05
    assert warp.source(np.array(0.0), np.array(0.0), 1) == pytest.approx(
        np.subtract(source(GREEN, 2, 2, 64, 84), 2)
    )  # the terms refer to the active area, not to the crop
    frame = read_raw(path, table)
    assert frame.warps == (warp,)
    assert l3(*call, tmp_path / "a.png", "--exposure", "1", "--white", "table")[0] == 0
    shown = ReferenceRenderer(table).encoded(np.moveaxis(wanted, -1, 0), make_display(table.white_point, 1.0, 8))
    picture = as_taken(read_image(tmp_path / "a.png")[0], 6)
    np.testing.assert_allclose(picture * (255 if picture.dtype.kind == "f" else 1), shown, atol=1.01)


def test_devices_encode_changed_outputs_as_the_reference_does(table: TransformTable) -> None:
    outputs = np.random.default_rng(5).random((3, 40, 60), np.float32)
    display = make_display(table.white_point, 0.8, 16)
    wanted, made = (each(table).encoded(outputs, display) for each in (ReferenceRenderer, OpenCLRenderer))
    assert np.abs(wanted.astype(int) - made).max() <= 2


def test_vignetting_after_a_warp_refers_to_the_warped_picture(tmp_path: Path, table: TransformTable) -> None:
    vignette = struct.pack(">7d", 0.8, 0, 0, 0, 0, CENTRE[1], CENTRE[0])
    frame = read_raw(photo(tmp_path, (1, 0, content(GREEN)), (3, 0, vignette)), table)
    assert frame.shading is not None
    row, col = 20, 30  # in the picture
    there = np.rint(np.subtract(source(GREEN, row + 2, col + 2, 64, 84), 2)).astype(int)
    exact = np.subtract(source(GREEN, row + 2, col + 2, 64, 84), 2)
    assert frame.shading.colour is not None
    gain = frame.shading.gain_map(80) * (1 + frame.shading.colour / 2**FRACTION)
    slopes = [each[tuple(there)] for each in np.gradient(gain)]
    squared = ((row + 2.5 - CENTRE[0] * 64) ** 2 + (col + 2.5 - CENTRE[1] * 84) ** 2) / ((0.52 * 64) ** 2 + (0.53 * 84) ** 2)
    assert gain[tuple(there)] + np.dot(slopes, exact - there) == pytest.approx(1 + 0.8 * squared, rel=1e-3)


def test_a_place_in_the_picture_is_looked_up_where_the_sensor_has_it(tmp_path: Path, table: TransformTable) -> None:
    frame = read_raw(photo(tmp_path, (1, 0, content(GREEN))), table)
    rows, cols = Square(10, 70, 4).within(frame).where
    middle = np.subtract(source(GREEN, 9.5 + 2, 69.5 + 2, 64, 84), 2)
    assert (rows.start + 1.5, cols.start + 1.5) == pytest.approx(middle, abs=0.51)
    assert (rows.stop - rows.start, cols.stop - cols.start) == (4, 4)


def test_the_noise_of_a_warped_picture_is_not_stated(tmp_path: Path, table: TransformTable) -> None:
    frame = read_raw(photo(tmp_path, (1, 0, content(GREEN))), table)
    with pytest.raises(RecipeError):
        uncertainty(ReferenceRenderer(table), frame)


def test_a_warp_that_changes_nothing_is_none(tmp_path: Path, table: TransformTable) -> None:
    assert read_raw(photo(tmp_path, (1, 0, content((1.0, 0.0, 0.0, 0.0, 0.0, 0.0)))), table).warps == ()


def test_gain_maps_after_a_warp_are_refused(tmp_path: Path, table: TransformTable) -> None:
    gains = dng_files.gain_map(np.full((1, 1), 2.0), (0, 0, 64, 84), (0, 3))
    path = photo(tmp_path, (1, 0, content(GREEN)), (9, 0, gains))
    with pytest.raises(InputFileError):
        read_raw(path, table)
    assert read_raw(path, table, RawOverrides(opcodes="leave")).shading is None


@pytest.mark.parametrize(
    "damaged",
    [
        content(GREEN)[:-8],
        content(RED, GREEN),
        content((np.nan, 0, 0, 0, 0, 0)),
        content((-1.0, 0, 0, 0, 0, 0)),
        content((1.0, 1e9, 0, 0, 0, 0)),
        content((1.0, 0, 0, 0, 5.0, 0)),
        struct.pack(">I", 1 << 30),
    ],
)
def test_damaged_warps_are_refused(tmp_path: Path, table: TransformTable, damaged: bytes) -> None:
    with pytest.raises(InputFileError, match="damaged tags"):
        read_raw(photo(tmp_path, (1, 0, damaged)), table)
