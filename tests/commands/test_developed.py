"""`l3 render -o a.dng`: LibRaw reads the DNG files of any array, with the same colours as the rendered pictures."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rawpy
import tifffile

from l3cli import __version__
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.store import save
from l3cli.artifacts.table import TransformTable
from l3cli.frames.frame import RawFrame
from l3cli.io.images import read_image
from l3cli.io.pictures.dng import HEADROOM, WHITE_LEVEL
from l3cli.io.raw.files import read_raw
from l3cli.physics.display import daylight, delta_e_2000, displayed_xyz, lab, scene_white, srgb_decoded
from l3cli.physics.spaces import REC2020, SRGB, adaptation_matrix
from l3cli.rendering.reference import ReferenceRenderer
from tests.helpers.calls import L3, Refused
from tests.helpers.cameras import BAYER
from tests.helpers.paths import CONFIGS
from tests.helpers.tables import random_table, with_first

RECIPES = sorted(path.stem for path in (CONFIGS / "cameras").glob("*.toml"))
KINDS = {"bayer", "cmy", "fiveband", "quad_bayer_hdr", "rgbir", "snapshot16", "xtrans"}  # `make soak` has the others
PATCH = 24  # pixels
BASELINE_EXPOSURE = 50730


def mixing_table(cfa: np.ndarray) -> TransformTable:
    """A table whose outputs are the means of channels around a pixel, each the share of one of sRGB's primaries."""
    channels = int(cfa.max()) + 1
    side = max(cfa.shape) // 2 * 2 + 1
    primaries = SRGB.to_xyz[:, np.arange(channels) % 3] / np.bincount(np.arange(channels) % 3)[np.arange(channels) % 3]
    table = random_table(cfa, bits=12, black_level=64.0, patch=side)
    weights = np.empty((cfa.size, 3, side**2), np.float32)
    for site, (row, col) in enumerate(np.ndindex(*cfa.shape)):
        steps = np.arange(side) - side // 2
        seen = cfa[np.ix_((row + steps) % cfa.shape[0], (col + steps) % cfa.shape[1])].ravel()
        weights[site] = primaries[:, seen] / np.bincount(seen)[seen]
    classes = table.first.rule.classes_per_site
    table = with_first(table, weights=weights.repeat(classes, 0), intercept=np.zeros_like(table.first.intercept))
    return dataclasses.replace(table, white_point=SRGB.to_xyz.sum(axis=1))


def patches(cfa: np.ndarray, seed: int = 0) -> np.ndarray:
    """A mosaic of 4×6 plain patches."""
    share = np.random.default_rng(seed).uniform(0.02, 0.9, (int(cfa.max()) + 1, 4, 6))
    share[:, 0, 0] = 0.9  # a white
    planes = 64 + share.repeat(PATCH, 1).repeat(PATCH, 2) * (4095 - 64)
    rows, cols = np.indices(planes.shape[1:])
    return np.rint(planes[cfa[rows % cfa.shape[0], cols % cfa.shape[1]], rows, cols]).astype(np.uint16)


def centres(picture: np.ndarray) -> np.ndarray:
    """(24, 3) means of the middles of the patches."""
    inner = picture.reshape(4, PATCH, 6, PATCH, 3)[:, 9:15, :, 9:15]
    return inner.mean(axis=(1, 3)).reshape(24, 3)


def developed(path: Path) -> np.ndarray:
    """LibRaw's picture, linear sRGB, its exposure that of the file's baseline."""
    with rawpy.imread(str(path)) as raw:
        picture = raw.postprocess(use_camera_wb=True, no_auto_bright=True, output_bps=16, gamma=(1, 1)) / 65535
    return picture * 2 ** stated(path, BASELINE_EXPOSURE)


def stated(path: Path, code: int) -> Any:
    """A tag's value, a fraction divided out."""
    with tifffile.TiffFile(path) as file:
        value = file.pages[0].tags.valueof(code)
    return value[0] / value[1] if isinstance(value, tuple) and len(value) == 2 else value


def difference(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """CIEDE2000 of linear sRGB."""
    one, other = (lab(displayed_xyz(np.clip(each, 0, 1)), daylight()) for each in (one, other))
    return delta_e_2000(one, other)


@pytest.mark.parametrize(
    "recipe", [name if name in KINDS else pytest.param(name, marks=pytest.mark.soak) for name in RECIPES]
)
def test_any_array_opens_with_our_colours(l3: L3, tmp_path: Path, recipe: str) -> None:
    cfa = load_camera(CONFIGS / f"cameras/{recipe}.toml").cfa
    save(mixing_table(cfa), tmp_path / "table.h5")
    np.save(tmp_path / "frame.npy", patches(cfa))
    options = ("--backend", "reference", "--quiet")
    for name, further in (("a.png", ("--bits", 16)), ("a.dng", ()), ("b.dng", ("--remosaic", "bayer"))):
        assert l3("render", tmp_path / "table.h5", tmp_path / "frame.npy", "-o", tmp_path / name, *further, *options)[0] == 0
    ours = centres(srgb_decoded(read_image(tmp_path / "a.png")[0] / 65535))
    assert np.ptp(ours, axis=0).min() > 0.3  # they are colours
    for name, most in (("a.dng", 0.2), ("b.dng", 0.5)):
        assert difference(centres(developed(tmp_path / name)), ours).max() < most


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a table of random weights, whose outputs are of any colour, and a frame."""
    folder = tmp_path_factory.mktemp("developed")
    save(random_table(BAYER, bits=12, black_level=64.0, patch=5), folder / "table.h5")
    np.save(folder / "frame.npy", np.random.default_rng(5).integers(60, 3000, (33, 41)).astype(np.uint16))
    return folder


def test_values_are_linear_and_exposure_is_stated(l3: L3, desk: Path) -> None:
    options = ("--backend", "reference", "--white", "A", "--exposure", 3)
    assert l3("render", desk / "table.h5", desk / "frame.npy", "-o", desk / "l.dng", *options)[0] == 0
    assert l3("render", desk / "table.h5", desk / "frame.npy", "-o", desk / "m.dng", "--remosaic", "bayer", *options)[0] == 0
    table = random_table(BAYER, bits=12, black_level=64.0, patch=5)
    outputs = ReferenceRenderer(table).exact_outputs(RawFrame("f", np.load(desk / "frame.npy"), 64.0, 4095.0))
    matrix = REC2020.from_xyz @ adaptation_matrix(scene_white("A"), REC2020.neutral_xyz)
    wanted = np.einsum("po,orc->rcp", matrix, outputs) / HEADROOM * WHITE_LEVEL
    values, mosaic = tifffile.imread(desk / "l.dng"), tifffile.imread(desk / "m.dng")
    assert np.abs(values - np.clip(wanted, 0, WHITE_LEVEL)).max() < 0.6
    for row, col, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        np.testing.assert_array_equal(mosaic[row::2, col::2], values[row::2, col::2, channel])
    assert stated(desk / "l.dng", BASELINE_EXPOSURE) == pytest.approx(np.log2(3 * HEADROOM))


def test_a_mosaic_is_a_raw_frame_and_a_developed_one_is_none(l3: L3, refused: Refused, desk: Path) -> None:
    for name, further in (("c.dng", ()), ("d.dng", ("--remosaic", "bayer"))):
        call = ("render", desk / "table.h5", desk / "frame.npy", "-o", desk / name, "--backend", "reference", *further)
        assert l3(*call)[0] == 0
    frame = read_raw(desk / "d.dng", random_table(BAYER, bits=12, patch=5))
    assert (frame.black_level, frame.white_level, frame.phase, frame.values.shape) == (0, 65535, (0, 0), (33, 41))
    assert "already demosaicked" in refused(3, "render", desk / "table.h5", desk / "c.dng", "-o", desk / "e.png")


def test_frames_of_a_sequence_become_files_each_with_its_exposure(l3: L3, desk: Path) -> None:
    frames = np.stack([np.load(desk / "frame.npy") // share for share in (1, 2)])
    np.save(desk / "stack.npy", frames)
    call = ("render", desk / "table.h5", desk / "stack.npy", "-o", desk / "out/####.dng", "--backend", "reference")
    assert l3(*call)[0] == 0
    made = [desk / f"out/{number:04d}.dng" for number in range(2)]
    assert stated(made[1], BASELINE_EXPOSURE) > stated(made[0], BASELINE_EXPOSURE)
    before = [path.read_bytes() for path in made]
    assert l3(*call, "--force")[0] == 0
    assert [path.read_bytes() for path in made] == before


def test_a_developed_frame_names_its_makers_not_its_camera(l3: L3, desk: Path) -> None:
    """A developer that knows the camera would take its matrix for these channels."""
    assert l3("render", desk / "table.h5", desk / "frame.npy", "-o", desk / "n.dng", "--backend", "reference")[0] == 0
    assert (stated(desk / "n.dng", 271), stated(desk / "n.dng", 305)) == ("l3cli", f"l3cli {__version__}")
    assert stated(desk / "n.dng", 270).startswith("transform table SHA-256 ")
    assert stated(desk / "n.dng", 306) is None  # no clock


def test_other_outputs_than_xyz_are_refused(refused: Refused, desk: Path) -> None:
    save(random_table(BAYER, bits=12, patch=5, outputs=("nir",)), desk / "nir.h5")
    assert "nir" in refused(2, "render", desk / "nir.h5", desk / "frame.npy", "-o", desk / "y.dng")
