"""Metadata of pictures: shooting data and origin are included, and time and place are not included."""

import hashlib
import shutil
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import OpenImageIO as oiio
import pytest
from PIL import Image

from l3cli import __version__
from l3cli.artifacts.store import save
from l3cli.frames.frame import Shot
from l3cli.io.images import read_image
from l3cli.io.raw.files import read_raw
from l3cli.io.tags import believable_shot
from l3cli.system.files import sha256
from tests.helpers.calls import L3
from tests.helpers.cameras import BAYER
from tests.helpers.dng_files import BYTE, RATIONAL, SHORT, Tags, write_dng
from tests.helpers.tables import random_table

TABLE = random_table(BAYER, bits=12, black_level=64.0, patch=5)
TAGS: Tags = {
    271: (BYTE, list(b"Maker\0")), 272: (BYTE, list(b"Model 7\0")), 33434: (RATIONAL, [1, 125]), 33437: (RATIONAL, [28, 10]),
    34855: (SHORT, [800]), 36867: (BYTE, list(b"2021:02:03 04:05:06\0")), 37386: (RATIONAL, [35, 1]),
    42036: (BYTE, list(b"EF 35mm\0")),
}  # fmt: skip
TEXT_TAGS = (271, 272, 36867, 42036)
SHOT = Shot("Maker", "Model 7", "EF 35mm", "2021:02:03 04:05:06", 2.8, 35.0, 800.0)


def as_texts(path: Path) -> None:
    """Make texts of the tags that the helper has written as bytes."""
    content = bytearray(path.read_bytes())
    count = int.from_bytes(content[8:10], "little")
    for at in range(10, 10 + 12 * count, 12):
        if int.from_bytes(content[at : at + 2], "little") in TEXT_TAGS:
            content[at + 2 : at + 4] = (2).to_bytes(2, "little")
    path.write_bytes(content)


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a table and a DNG that says how it was taken."""
    folder = tmp_path_factory.mktemp("labels")
    save(TABLE, folder / "table.h5")
    values = np.random.default_rng(5).integers(60, 3000, (24, 30)).astype(np.uint16)
    as_texts(write_dng(folder / "frame.dng", values, np.array([[0, 1], [1, 2]]), tags=TAGS))
    return folder


def words(path: Path) -> Any:
    """What a file says of itself, by OpenImageIO."""
    source = oiio.ImageInput.open(str(path))
    assert source is not None
    return source.spec()


def test_raw_files_state_how_they_were_taken(desk: Path) -> None:
    frame = read_raw(desk / "frame.dng", TABLE)
    assert (frame.shot, frame.exposure) == (SHOT, 1 / 125)


@pytest.mark.parametrize("suffix", ["png", "tif", "jpg", "exr"])
def test_pictures_carry_it_on(l3: L3, desk: Path, suffix: str) -> None:
    path = desk / f"a.{suffix}"
    assert l3("render", desk / "table.h5", desk / "frame.dng", "-o", path, "--backend", "reference")[0] == 0
    spec = words(path)
    texts = ("Make", "Model", "Exif:LensModel", "Exif:DateTimeOriginal", "Software")
    assert [spec.getattribute(name) for name in texts] == ["Maker", "Model 7", "EF 35mm", SHOT.date, f"l3cli {__version__}"]
    numbers = [spec.getattribute(name) for name in ("ExposureTime", "FNumber", "Exif:FocalLength", "Exif:ISOSpeed")]
    np.testing.assert_allclose(numbers, [1 / 125, 2.8, 35, 800], rtol=1e-3)
    made_from = f"transform table SHA-256 {sha256(desk / 'table.h5')}, raw file SHA-256 {sha256(desk / 'frame.dng')}"
    assert spec.getattribute("ImageDescription") == made_from


def test_jpeg_xl_holds_it_as_xmp(l3: L3, desk: Path) -> None:
    path = desk / "a.jxl"
    assert l3("render", desk / "table.h5", desk / "frame.dng", "-o", path, "--backend", "reference")[0] == 0
    content, at, boxes = path.read_bytes(), 0, {}
    while at < len(content):
        size = int.from_bytes(content[at : at + 4], "big")
        boxes[content[at + 4 : at + 8]] = content[at + 8 : at + size]
        at += size
    (described,) = ElementTree.fromstring(boxes[b"xml "])[0]
    stated = {name.partition("}")[2]: value for name, value in described.attrib.items()}
    assert (stated["Make"], stated["LensModel"], stated["ExposureTime"]) == ("Maker", "EF 35mm", "1/125")
    assert (stated["FNumber"], stated["DateTimeOriginal"]) == ("14/5", "2021-02-03T04:05:06")
    assert sha256(desk / "frame.dng") in stated["ImageDescription"]
    assert read_image(path)[0].shape == (24, 30, 3)


def test_exif_is_read_by_others(l3: L3, desk: Path) -> None:
    path = desk / "b.jpg"
    assert l3("render", desk / "table.h5", desk / "frame.dng", "-o", path, "--backend", "reference")[0] == 0
    exif = Image.open(path).getexif()
    assert (exif[271], exif[272], exif[42036]) == ("Maker", "Model 7", "EF 35mm")
    inner = exif.get_ifd(34665)
    assert (inner[36867], inner[34855]) == (SHOT.date, 800)
    assert 306 not in exif  # no clock


def test_frames_of_a_stack_are_known_by_their_values(l3: L3, desk: Path) -> None:
    frames = np.random.default_rng(6).integers(60, 3000, (2, 24, 30)).astype(np.uint16)
    np.save(desk / "stack.npy", frames)
    assert l3("render", desk / "table.h5", desk / "stack.npy", "-o", desk / "out", "--backend", "reference")[0] == 0
    for number, frame in enumerate(frames):
        text = words(desk / f"out/stack_{number:06d}.png").getattribute("ImageDescription")
        assert text.endswith(f"raw values SHA-256 {hashlib.sha256(frame.astype('<u2').tobytes()).hexdigest()}")


def test_neither_name_nor_place_is_in_a_picture(l3: L3, desk: Path, tmp_path: Path) -> None:
    shutil.copy(desk / "table.h5", tmp_path / "other.h5")
    shutil.copy(desk / "frame.dng", tmp_path / "renamed.dng")
    options = ("--backend", "reference")
    assert l3("render", tmp_path / "other.h5", tmp_path / "renamed.dng", "-o", tmp_path / "a.tif", *options)[0] == 0
    assert l3("render", desk / "table.h5", desk / "frame.dng", "-o", desk / "c.tif", *options)[0] == 0
    assert (tmp_path / "a.tif").read_bytes() == (desk / "c.tif").read_bytes()


def test_what_a_file_states_is_not_believed_blindly() -> None:
    stated: dict[str, Any] = {
        "make": "a\x1b[2J\nb\0", "model": "m" * 1000, "lens": 7, "date": "yesterday", "f_number": float("nan"),
        "focal_length": -3.0, "iso": 1e300, "other": 5,
    }  # fmt: skip
    assert believable_shot(stated) == Shot("a[2Jb", "m" * 100)
