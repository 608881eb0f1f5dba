"""Several frames into one .tif: a page each."""

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import ImageCms

from l3cli.artifacts.store import save
from l3cli.io.images import read_image
from tests.helpers.cameras import BAYER
from tests.helpers.tables import random_table

COUNT = 3


@pytest.fixture
def desk(tmp_path: Path) -> Path:
    """A folder with a table, a stack of frames, and the same frames as files."""
    save(random_table(BAYER, bits=12, black_level=64.0, patch=5), tmp_path / "table.h5")
    frames = np.random.default_rng(5).integers(60, 1200, (COUNT, 24, 30)).astype(np.uint16)
    frames[1] //= 3
    np.save(tmp_path / "stack.npy", frames)
    for number, frame in enumerate(frames):
        np.save(tmp_path / f"f_{number}.npy", frame)
    return tmp_path


@pytest.mark.parametrize("bits", [8, 16, 32])
def test_pages_are_the_pictures_of_a_folder(l3: Callable, desk: Path, bits: int) -> None:
    for source in (("stack.npy",), tuple(f"f_{number}.npy" for number in range(COUNT))):
        inputs = [desk / name for name in source]
        for output in ("a.tif", "out"):
            options = ("--format", "tif", "--bits", bits, "--backend", "reference", "--quiet", "--force")
            assert l3("render", desk / "table.h5", *inputs, "-o", desk / output, *options)[0] == 0
        files = sorted((desk / "out").iterdir())
        with tifffile.TiffFile(desk / "a.tif") as file:
            assert len(file.pages) == len(files) == COUNT
            for page, alone in zip(file.pages, files, strict=True):
                np.testing.assert_array_equal(page.asarray(), read_image(alone)[0])
                assert page.description == tifffile.TiffFile(alone).pages[0].description
                assert page.tags.valueof(306) is None  # no clock
        for path in files:
            path.unlink()


@pytest.mark.parametrize("count", [1, 2])
def test_an_orientation_that_tiff_does_not_know_is_refused(refused: Callable, desk: Path, count: int) -> None:
    with tifffile.TiffWriter(desk / "a.tif") as file:
        for number in range(count):
            file.write(np.load(desk / "stack.npy")[number], extratags=[(274, 3, 1, 9 - 3 * (number < count - 1), True)])
    words = refused(3, "render", desk / "table.h5", desk / "a.tif", "-o", desk / "a.png" if count == 1 else desk / "out")
    assert "a.tif: its orientation is 9, TIFF knows 1…8; mend the tag Orientation" in words


def test_pages_say_what_they_are(l3: Callable, desk: Path) -> None:
    call = ("render", desk / "table.h5", desk / "stack.npy", "--space", "rec2020", "--backend", "reference")
    for name in ("a.tif", "b.tif"):
        assert l3(*call, "-o", desk / name)[0] == 0
    assert (desk / "a.tif").read_bytes() == (desk / "b.tif").read_bytes()
    with tifffile.TiffFile(desk / "a.tif") as file:
        for page in file.pages:
            profile = ImageCms.ImageCmsProfile(io.BytesIO(page.tags.valueof(34675))).profile
            assert profile.profile_description == "Rec. 2020"


def test_pages_are_of_one_size_and_there_or_not(l3: Callable, refused: Callable, desk: Path) -> None:
    np.save(desk / "f_1.npy", np.zeros((20, 30), np.uint16))
    inputs = [desk / f"f_{number}.npy" for number in range(COUNT)]
    err = refused(3, "render", desk / "table.h5", *inputs, "-o", desk / "a.tif", "--backend", "reference")
    assert "f_1.npy has 20×30 pixels, the first page 24×30" in err
    (desk / "b.tif").write_bytes(b"mine")
    assert "exists" in refused(1, "render", desk / "table.h5", desk / "stack.npy", "-o", desk / "b.tif")
    assert "in one go" in refused(2, "render", desk / "table.h5", desk / "stack.npy", "-o", desk / "c.tif", "--resume")
    assert "a .tif" in refused(2, "render", desk / "table.h5", desk / "stack.npy", "-o", desk / "c.png")


def test_a_full_disk_is_named(l3: Callable, desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """numpy's error says how much of an array has been written, and no more."""

    def write(*_: object, **__: object) -> None:
        raise OSError("864000 requested and 366464 written")

    monkeypatch.setattr(tifffile.TiffWriter, "write", write)
    code, _, err = l3(
        "render", desk / "table.h5", desk / "stack.npy", "-o", desk / "a.tif", "--backend", "reference", "--quiet"
    )
    assert (code, "No space left" in err, err.count("\n")) == (1, True, 1)
    assert not (desk / "a.tif").exists()
