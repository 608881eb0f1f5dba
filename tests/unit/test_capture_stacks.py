"""TIFF stacks as captures of a calibration: each page is a frame."""

from pathlib import Path

import numpy as np
import pytest
import tifffile

from l3cli.artifacts.camera import CameraModel
from l3cli.errors import InputFileError
from l3cli.io.frames import FrameFiles, WholeFrames
from tests.helpers.calls import L3

SHAPE = (192, 256)


def pages(mean: float, count: int = 2) -> np.ndarray:
    """(page, row, col) even frames with noise."""
    return np.random.default_rng(int(mean)).normal(mean, 6, (count, *SHAPE)).clip(0, 4095).round().astype(np.uint16)


@pytest.mark.parametrize("compression", [None, "zlib"])
def test_a_stack_gives_its_pages_as_frames(compression: str | None, bayer: CameraModel, tmp_path: Path) -> None:
    frames = pages(500, 3)
    tifffile.imwrite(tmp_path / "stack.tif", frames[:2], photometric="minisblack", compression=compression)
    tifffile.imwrite(tmp_path / "one.tif", frames[2], photometric="minisblack")
    paths = (tmp_path / "stack.tif", tmp_path / "one.tif")
    np.testing.assert_array_equal(list(FrameFiles(paths, SHAPE, 12)), frames)
    assert (bayer.rows, bayer.cols) == SHAPE
    np.testing.assert_array_equal(list(WholeFrames(paths, bayer)), frames)


@pytest.mark.parametrize("suffix", [".npy", ".fits"])
def test_stacks_of_other_formats(suffix: str, bayer: CameraModel, tmp_path: Path, bayer_recipe: Path, l3: L3) -> None:
    folder = tmp_path / "captures"
    folder.mkdir()
    for name, mean in (("dark_10ms", 64), ("white_10ms", 900)):
        write_stack(folder / (name + suffix), pages(mean, 3))
    white = (folder / ("white_10ms" + suffix),)
    np.testing.assert_array_equal(list(FrameFiles(white, SHAPE, 12)), pages(900, 3))
    np.testing.assert_array_equal(list(WholeFrames(white, bayer)), pages(900, 3))
    write_stack(tmp_path / ("wrong" + suffix), pages(900, 3) * np.uint16(10))
    with pytest.raises(InputFileError, match="wrong"):
        list(FrameFiles((tmp_path / ("wrong" + suffix),), SHAPE, 12))
    l3("calibrate", "--draft", folder, "--camera", bayer_recipe, "-o", tmp_path / "M.toml")
    text = (tmp_path / "M.toml").read_text()
    assert all(name + suffix in text and f"{name}{suffix}: a single" not in text for name in ("dark_10ms", "white_10ms"))


def write_stack(path: Path, frames: np.ndarray) -> None:
    """A stack (frame, row, col) of the format that the suffix names."""
    if path.suffix == ".npy":
        np.save(path, frames)
        return
    header = pytest.importorskip("astropy.io.fits").PrimaryHDU(frames)
    header.header["CTYPE3"] = "FRAME"
    header.writeto(path)


def test_a_wrong_page_is_named(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "small.tif", pages(500)[:, :100], photometric="minisblack")
    tifffile.imwrite(tmp_path / "float.tif", pages(500).astype(np.float32), photometric="minisblack")
    tifffile.imwrite(tmp_path / "deep.tif", pages(500) * np.uint16(10), photometric="minisblack")
    for name in ("small.tif", "float.tif", "deep.tif"):
        with pytest.raises(InputFileError, match=name):
            list(FrameFiles((tmp_path / name,), SHAPE, 12))


def test_a_draft_takes_a_stack_for_several_frames(bayer_recipe: Path, tmp_path: Path, l3: L3) -> None:
    folder = tmp_path / "captures"
    folder.mkdir()
    for name, mean, count in (("dark_10ms", 64, 2), ("dark_20ms", 65, 1), ("white_10ms", 900, 3)):
        tifffile.imwrite(folder / f"{name}.tif", pages(mean, count), photometric="minisblack")
    l3("calibrate", "--draft", folder, "--camera", bayer_recipe, "-o", tmp_path / "M.toml")
    text = (tmp_path / "M.toml").read_text()
    (alone,) = [line for line in text.splitlines() if "single" in line]
    assert "dark_20ms.tif" in alone
