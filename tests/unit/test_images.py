"""Picture files: written values are read back, with metadata. TIFF files that l3 reads without a library. ENVI cubes."""

import math
import os
import struct
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest
import spectral

from l3cli.errors import InputFileError, RecipeError
from l3cli.io.images import read_image
from l3cli.io.pictures.openimageio import write_mosaic
from l3cli.io.pictures.registry import format_of, write_picture
from l3cli.io.raw import files, tiff
from l3cli.io.scenes import envi
from l3cli.system.limits import MEGAPIXELS, TRUST
from tests.helpers.cubes import WAVELENGTH, a_cube
from tests.helpers.tables import XYZ


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


def test_pictures_state_that_they_are_srgb(tmp_path: Path) -> None:
    write_picture(tmp_path / "a.png", np.zeros((2, 2, 3), np.uint8))
    content = (tmp_path / "a.png").read_bytes()
    assert (b"iCCP" in content, b"sRGB" in content, b"gAMA" in content) == (True, False, False)  # one of them, says PNG
    for name in ("a.png", "a.tif", "a.jpg"):
        write_picture(tmp_path / name, np.zeros((2, 2, 3), np.uint8))
        source = oiio.ImageInput.open(str(tmp_path / name))
        assert source is not None
        assert "srgb" in str(source.spec()["oiio:ColorSpace"]).lower()


def test_formats_that_cannot_be_are_refused() -> None:
    for name, bits in (("a.gif", 8), ("a", 8), ("a.jpg", 16)):
        with pytest.raises(RecipeError, match=r"\.png"):
            format_of(Path(name), bits)


def mosaic(rows: int, cols: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 65536, (rows, cols), np.uint16)


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(TRUST, "1")


@pytest.mark.usefixtures("in_this_process")
@pytest.mark.parametrize("exposure", [None, 1e-6, 0.01, 1 / 3, 2.5, 4000.0])
@pytest.mark.parametrize("shape", [(1, 1), (3, 2), (32, 7), (33, 50), (100, 301)])
def test_the_same_as_by_the_library(tmp_path: Path, shape: tuple[int, int], exposure: float | None) -> None:
    path = tmp_path / "a.tif"
    write_mosaic(path, mosaic(*shape), exposure)
    plain, theirs = tiff.read_plain(path), tiff.read_by_library(path)
    assert plain is not None
    np.testing.assert_array_equal(plain["values"], mosaic(*shape))
    np.testing.assert_array_equal(plain["values"], theirs["values"])
    assert (plain["values"].dtype, plain["exposure"]) == (theirs["values"].dtype, theirs["exposure"])
    assert tiff.is_plain(path)
    assert not files.needs_isolation(path)


@pytest.mark.usefixtures("in_this_process")
def test_every_changed_byte_is_refused_or_read_as_by_the_library(tmp_path: Path) -> None:
    path, broken = tmp_path / "a.tif", tmp_path / "b.tif"
    write_mosaic(path, mosaic(5, 7), 0.04)
    whole, accepted = path.read_bytes(), 0
    for place in range(len(whole)):
        change = (1, 0x80, 0xFF)[place % 3]
        broken.write_bytes(whole[:place] + bytes([whole[place] ^ change]) + whole[place + 1 :])
        plain = tiff.read_plain(broken)
        assert tiff.is_plain(broken) == (plain is not None)
        if plain is not None:
            theirs = tiff.read_by_library(broken)
            np.testing.assert_array_equal(plain["values"], theirs["values"])
            assert plain["exposure"] == pytest.approx(theirs["exposure"], rel=1e-6)
            accepted += 1
        broken.write_bytes(whole[:place])
        assert tiff.read_plain(broken) is None
    assert 70 <= accepted < 2 / 3 * len(whole)  # pixels, the date, the exposure, unused bytes


@pytest.mark.usefixtures("in_this_process")
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


@pytest.mark.usefixtures("in_this_process")
def test_other_files_are_left_to_the_isolated_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    coloured, empty, pipe, plain = (tmp_path / f"{name}.tif" for name in ("coloured", "empty", "pipe", "plain"))
    write_picture(coloured, np.zeros((4, 4, 3), np.uint8))
    empty.touch()
    os.mkfifo(pipe)
    write_mosaic(plain, mosaic(20, 30))
    for path in (coloured, empty, pipe, tmp_path, tmp_path / "missing.tif"):
        assert not tiff.is_plain(path)
        assert files.needs_isolation(path) == bool(path.suffix)
    write_mosaic(tmp_path / "eight.tif", mosaic(20, 30).astype(np.uint8))
    assert tiff.is_plain(tmp_path / "eight.tif")
    assert tiff.read_plain(tmp_path / "eight.tif", (16,)) is None
    monkeypatch.setenv(MEGAPIXELS, "0.0001")
    assert not tiff.is_plain(plain)  # whoever reads all kinds says that it is too large
    monkeypatch.setenv(MEGAPIXELS, "many")
    assert not tiff.is_plain(plain)


TYPES = ["u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"]
KNOWN = {"wavelength": [f"{nm:.1f}" for nm in WAVELENGTH], "wavelength units": "Nanometers", "description": "of\ntwo lines"}


def save(path: Path, values: np.ndarray, **how: Any) -> np.ndarray:
    """What is written to an ENVI file by spectral."""
    spectral.envi.save_image(str(path), values, dtype=values.dtype, **{"metadata": KNOWN} | how)
    return values


@pytest.mark.parametrize("interleave", ["bsq", "bil", "bip"])
@pytest.mark.parametrize("byteorder", ["little", "big"])
@pytest.mark.parametrize("dtype", TYPES)
def test_what_spectral_writes_is_read(tmp_path: Path, interleave: str, byteorder: str, dtype: str) -> None:
    stored = (a_cube() * 250 - (dtype[0] != "u") * 100).astype(dtype)
    save(tmp_path / "scene.hdr", stored, interleave=interleave, byteorder=byteorder)
    cube = envi.read(tmp_path / "scene.hdr")
    assert np.array_equal(cube.values, stored)
    assert cube.values.dtype.newbyteorder("=") == dtype
    assert cube.wavelength is not None
    assert np.array_equal(cube.wavelength, WAVELENGTH)
    assert cube.white is None


@pytest.mark.parametrize("ext", ["", "img", "dat", "raw", "IMG"])
def test_data_lie_next_to_the_header_under_any_of_spectrals_names(tmp_path: Path, ext: str) -> None:
    stored = save(tmp_path / "scene.hdr", a_cube(), ext=ext)
    assert np.array_equal(envi.read(tmp_path / "scene.hdr").values, stored)
    assert envi.files(tmp_path / "scene.hdr")[1].name == f"scene.{ext}".rstrip(".")


@pytest.mark.parametrize(("unit", "nm"), [("Nanometers", 1.0), ("Micrometers", 1000.0), ("Unknown", 1000.0)])
def test_bands_lie_where_spectral_finds_them(tmp_path: Path, unit: str, nm: float) -> None:
    listed = [f"{each / nm:.4f}" for each in WAVELENGTH]
    save(tmp_path / "scene.hdr", a_cube(), metadata={"wavelength": listed, "wavelength units": unit})
    cube, theirs = envi.read(tmp_path / "scene.hdr"), spectral.open_image(str(tmp_path / "scene.hdr"))
    assert cube.wavelength is not None
    assert np.allclose(cube.wavelength, np.array(theirs.bands.centers) * nm, rtol=1e-12)


def test_both_read_the_same_from_a_header_of_other_writers(tmp_path: Path) -> None:
    stored = np.rint(a_cube() * 10000).astype(">u2")
    (tmp_path / "scene.bil").write_bytes(bytes(128) + np.ascontiguousarray(stored.transpose(0, 2, 1)).tobytes())
    (tmp_path / "scene.hdr").write_text(
        "ENVI\r\ndescription = {\r\n  lines = 3, of another}\r\n; fields = {not closed\r\nsamples = 24\r\nlines   = 20\r\n"
        "bands =31\r\nheader offset = 128\r\ndata type = 12\r\ninterleave = bil\r\nbyte order = 1\r\n"
        f"reflectance scale factor = 10000\r\nwavelength = {{\r\n {', '.join(map(str, WAVELENGTH))} }}\r\n",
        newline="",
    )
    ours, theirs = envi.read(tmp_path / "scene.hdr"), spectral.open_image(str(tmp_path / "scene.hdr"))
    assert ours.white is not None
    assert ours.wavelength is not None
    assert np.allclose(ours.values / ours.white, np.asarray(theirs.load()), rtol=1e-6)
    assert np.array_equal(ours.wavelength, theirs.bands.centers)


@pytest.mark.parametrize("dtype", ["c8", "c16"])
def test_complex_values_are_refused(tmp_path: Path, dtype: str) -> None:
    save(tmp_path / "scene.hdr", a_cube().astype(dtype))
    with pytest.raises(InputFileError, match=r"scene\.hdr: .* which l3 does not support"):
        envi.read(tmp_path / "scene.hdr")


def test_a_cube_cut_short_is_refused_with_both_sizes(tmp_path: Path) -> None:
    stored = save(tmp_path / "scene.hdr", a_cube())
    data = tmp_path / "scene.img"
    data.write_bytes(data.read_bytes()[:-1])
    with pytest.raises(
        InputFileError, match=f"{stored.nbytes - 1} bytes, but its header requires {math.prod(stored.shape) * 4}"
    ):
        envi.read(tmp_path / "scene.hdr")
