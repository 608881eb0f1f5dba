"""Picture files: what is written comes back, says what it is, and is whole."""

import signal
import time
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from l3cli.errors import RecipeError
from l3cli.io.images import read_image
from l3cli.io.pictures.registry import format_of, write_picture
from l3cli.system import signals
from tests.helpers.tables import XYZ

ENDING = (signal.SIGALRM, signal.SIGINT, signal.SIGTERM)


@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.TIFF", "a.jxl"])
@pytest.mark.parametrize("bits", [8, 16])
def test_lossless_pictures_come_back_as_written(tmp_path: Path, name: str, bits: int) -> None:
    picture = np.random.default_rng(0).integers(0, 2**bits, (5, 7, 3)).astype(f"uint{bits}")
    write_picture(tmp_path / name, picture)
    pixels, names = read_image(tmp_path / name)
    np.testing.assert_array_equal(pixels, picture)
    assert (pixels.dtype, names) == (picture.dtype, ("R", "G", "B"))


def test_jpeg_comes_back_alike(tmp_path: Path) -> None:
    ramp = np.linspace(0, 255, 64).astype(np.uint8)
    picture = np.stack(
        [np.broadcast_to(ramp, (32, 64)), np.full((32, 64), 90, np.uint8), np.full((32, 64), 200, np.uint8)], -1
    )
    write_picture(tmp_path / "a.jpg", picture)
    pixels, _ = read_image(tmp_path / "a.jpg")
    assert np.abs(pixels.astype(int) - picture).max() <= 4  # quality 95, no chroma subsampling


def test_exr_keeps_floats_and_names(tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).normal(size=(5, 7, 3)).astype(np.float32) * 3
    write_picture(tmp_path / "a.exr", pixels, XYZ)
    back, names = read_image(tmp_path / "a.exr")
    assert (names, back.dtype) == (XYZ, np.float32)
    np.testing.assert_array_equal(back, pixels)
    write_picture(tmp_path / "b.exr", pixels[..., :2], ("nir", "leaf"))
    back, names = read_image(tmp_path / "b.exr")
    np.testing.assert_array_equal(back[..., [names.index("nir"), names.index("leaf")]], pixels[..., :2])


def test_pictures_say_that_they_are_srgb(tmp_path: Path) -> None:
    write_picture(tmp_path / "a.png", np.zeros((2, 2, 3), np.uint8))
    content = (tmp_path / "a.png").read_bytes()
    assert (b"iCCP" in content, b"sRGB" in content, b"gAMA" in content) == (True, False, False)  # one of them, says PNG
    for name in ("a.png", "a.tif", "a.jpg"):
        write_picture(tmp_path / name, np.zeros((2, 2, 3), np.uint8))
        source = oiio.ImageInput.open(str(tmp_path / name))
        assert source is not None
        assert "srgb" in str(source.spec()["oiio:ColorSpace"]).lower()


def test_an_interrupted_picture_leaves_no_complaints(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """A signal at any moment: the PNG library would print on stderr that half a picture is one."""
    picture, before = np.zeros((2, 2, 3), np.uint8), {each: signal.getsignal(each) for each in ENDING}
    ends = 0
    try:
        for moment in np.linspace(2e-6, 2e-4, 100):
            for each in ENDING:
                signal.signal(each, signals.end)
            try:
                signal.setitimer(signal.ITIMER_REAL, moment)
                write_picture(tmp_path / "picture.png", picture)
                time.sleep(0.2)  # it may have had to wait
            except signals.Terminated:
                ends += 1
    finally:
        for each in ENDING:
            signal.signal(each, before[each])
    assert ends == 100
    assert capfd.readouterr().err == ""


def test_formats_that_cannot_be_are_refused() -> None:
    for name, bits in (("a.gif", 8), ("a", 8), ("a.jpg", 16)):
        with pytest.raises(RecipeError, match=r"\.png"):
            format_of(Path(name), bits)
