"""Multi-page TIFF files: pages are frames of a sequence, and are rejected as single pictures. Output of several pages."""

import io
import json
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import ImageCms

from l3cli.artifacts.store import save
from l3cli.errors import InputFileError
from l3cli.io.frames import read_frame
from l3cli.io.images import read_image
from l3cli.io.pictures.openimageio import write_mosaic
from l3cli.io.pictures.registry import write_picture
from l3cli.io.raw.tiff import count_pages, read_page
from l3cli.system.limits import TRUST
from tests.helpers.calls import L3, Refused
from tests.helpers.cameras import BAYER
from tests.helpers.sequences import COUNT, FAST, frames, pictures
from tests.helpers.tables import random_table

PLAIN = {"photometric": "minisblack", "metadata": None}


def write_pages(path: Path, pages: Iterable[np.ndarray], big: bool = False, order: str = "<", **options: object) -> Path:
    with tifffile.TiffWriter(path, bigtiff=big, byteorder=order) as file:
        for page in pages:
            file.write(page, contiguous=False, **{**PLAIN, **options})
    return path


@pytest.mark.parametrize(
    "options",
    [{}, {"big": True}, {"order": ">"}, {"compression": "zlib"}, {"rowsperstrip": 3}, {"subfiletype": 2}],
    ids=lambda options: next(iter(options), "plain"),
)
def test_pages_are_the_frames_of_a_stack(l3: L3, tmp_path: Path, table: Path, options: dict) -> None:
    np.save(tmp_path / "a.npy", frames())
    write_pages(tmp_path / "a.tif", frames(), **options)
    for name in ("a.npy", "a.tif"):
        assert l3("render", table, tmp_path / name, "-o", tmp_path / name.replace(".", "_"), *FAST) == (0, "", "")
    ours, theirs = pictures(tmp_path / "a_tif"), pictures(tmp_path / "a_npy")
    assert list(ours) == [f"a_{number:06d}.png" for number in range(COUNT)]
    assert all(np.array_equal(ours[name], theirs[name]) for name in theirs)


def test_pages_are_chosen_by_number_and_become_videos(l3: L3, tmp_path: Path, table: Path) -> None:
    stack = write_pages(tmp_path / "a.tiff", frames())
    assert l3("render", table, stack, "-o", tmp_path / "%d.png", "--frames", "1-4x3", *FAST) == (0, "", "")
    assert sorted(path.name for path in tmp_path.glob("*.png")) == ["1.png", "4.png"]
    assert l3("render", table, stack, "-o", tmp_path / "a.mp4", *FAST) == (0, "", "")
    code, _, err = l3("render", table, stack, "-o", tmp_path / "x.png", *FAST)
    assert (code, "the inputs are 5 frames" in err) == (2, True)


def test_pages_are_read_one_by_one_in_any_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_pages(tmp_path / "a.tif", frames())
    for trusting in ("0", "1"):
        monkeypatch.setenv(TRUST, trusting)
        assert count_pages(path) == COUNT
        for number in (3, 0, 4, 4, 1):
            np.testing.assert_array_equal(read_page(path, number)["values"], frames()[number])
    other = write_pages(tmp_path / "b.tif", frames()[::-1])
    np.testing.assert_array_equal(read_page(other, 0)["values"], frames()[-1])
    write_pages(path, frames()[::-1])  # another file takes the name
    np.testing.assert_array_equal(read_page(path, 0)["values"], frames()[-1])


def test_a_tiff_of_one_page_is_a_frame_as_before(l3: L3, tmp_path: Path, table: Path) -> None:
    write_mosaic(tmp_path / "a.tif", frames()[0])
    assert count_pages(tmp_path / "a.tif") == 1
    assert l3("render", table, tmp_path / "a.tif", "-o", tmp_path / "out", *FAST) == (0, "", "")
    assert list(pictures(tmp_path / "out")) == ["a.png"]


def with_thumbnail(path: Path) -> None:
    with tifffile.TiffWriter(path) as file:
        file.write(frames()[0], **PLAIN)
        file.write(frames()[0][::4, ::4], subfiletype=1, **PLAIN)


def with_mask(path: Path) -> None:
    with tifffile.TiffWriter(path) as file:
        file.write(frames()[0], **PLAIN)
        file.write(frames()[0], subfiletype=2, **PLAIN)
    with tifffile.TiffFile(path, mode="r+") as file:
        file.pages[1].tags["NewSubfileType"].overwrite(4)


def with_colours(path: Path) -> None:
    write_pages(path, [frames()[0], np.zeros((20, 28, 3), np.uint16)], photometric=None)


def with_full_subfile(path: Path) -> None:
    with tifffile.TiffWriter(path) as file:
        file.write(frames()[0], subifds=1, **PLAIN)
        file.write(frames()[1], **PLAIN)


def cut_chain(path: Path) -> None:
    write_pages(path, frames(), compression="zlib")
    content = path.read_bytes()
    with tifffile.TiffFile(path) as file:
        path.write_bytes(content[: file.pages[3].offset + 4])


def round_chain(path: Path) -> None:
    write_pages(path, frames())
    with tifffile.TiffFile(path) as file:
        offsets = [page.offset for page in file.pages]
    content = bytearray(path.read_bytes())
    at = offsets[2] + 2 + 12 * int.from_bytes(content[offsets[2] : offsets[2] + 2], "little")
    content[at : at + 4] = offsets[0].to_bytes(4, "little")
    path.write_bytes(content)


ODD: dict[str, tuple[Callable[[Path], object], str]] = {
    "thumbnail": (with_thumbnail, "page 2 "),
    "mask": (with_mask, "page 2 "),
    "another size": (lambda path: write_pages(path, [*frames()[:2], frames()[2][:-2]]), "page 3 "),
    "another depth": (lambda path: write_pages(path, [frames()[0], (frames()[1] >> 4).astype(np.uint8)]), "page 2 "),
    "colours": (with_colours, "page 2 "),
    "a subfile": (with_full_subfile, "images that are not pages"),
    "ImageJ without pages": (
        lambda path: tifffile.imwrite(path, frames(), imagej=True, truncate=True), "has only 1 page"
    ),
    "tifffile without pages": (
        lambda path: tifffile.imwrite(path, frames(), photometric="minisblack", truncate=True), "has only 1 page"
    ),
    "cut": (cut_chain, "damaged"),
    "round": (round_chain, "damaged"),
}  # fmt: skip


@pytest.mark.parametrize("kind", ODD)
def test_pages_of_another_kind_are_refused_not_dropped(refused: Refused, tmp_path: Path, table: Path, kind: str) -> None:
    make, words = ODD[kind]
    make(tmp_path / "a.tif")
    line = refused(3, "render", table, tmp_path / "a.tif", "-o", tmp_path / "out", "--skip-bad", *FAST)
    assert "a.tif" in line
    assert words in line


def test_a_smaller_copy_below_a_frame_is_no_frame(l3: L3, tmp_path: Path, table: Path) -> None:
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        for mosaic in frames():
            file.write(mosaic, subifds=1, contiguous=False, **PLAIN)
            file.write(mosaic[::4, ::4], subfiletype=1, **PLAIN)
    assert l3("render", table, tmp_path / "a.tif", "-o", tmp_path / "out", *FAST) == (0, "", "")
    assert len(pictures(tmp_path / "out")) == COUNT


def test_a_description_of_another_picture_is_not_believed(tmp_path: Path) -> None:
    for text in ('{"shape": [40, 56]}', '{"shape": [20, 28]}', '{"shape": []}', '{"shape": [,,]}', '{"shape": [0]}'):
        path = write_pages(tmp_path / "a.tif", frames()[:1], description=text)
        assert count_pages(path) == 1
        assert read_image(path)[0].shape == (20, 28, 1)


def test_elsewhere_a_file_has_one_picture(refused: Refused, tmp_path: Path, table: Path) -> None:
    (tmp_path / "in").mkdir()
    stack = write_pages(tmp_path / "in/a_1.tif", frames())
    words = "has more than one page"
    assert words in refused(3, "render", table, tmp_path / "in/a_%d.tif", "-o", tmp_path / "out", *FAST)
    for read in (read_image, lambda path: read_frame(path, (20, 28), 12)):
        with pytest.raises(InputFileError, match=words):
            read(stack)
    hidden = tmp_path / "in/hidden.tif"
    tifffile.imwrite(hidden, frames(), imagej=True, truncate=True)
    with pytest.raises(InputFileError, match="has only 1 page"):
        read_image(hidden)


def test_a_picture_of_several_parts_is_refused(tmp_path: Path) -> None:
    import OpenImageIO as oiio

    specs = [oiio.ImageSpec(8, 6, 3, "half") for _ in range(2)]
    for number, spec in enumerate(specs):
        spec.attribute("oiio:subimagename", f"part {number}")
    sink = oiio.ImageOutput.create(str(tmp_path / "a.exr"))
    assert sink is not None
    assert sink.open(str(tmp_path / "a.exr"), tuple(specs))
    for number, spec in enumerate(specs):
        if number:
            assert sink.open(str(tmp_path / "a.exr"), spec, "AppendSubimage")
        assert sink.write_image(np.zeros((6, 8, 3), np.float16))
    sink.close()
    with pytest.raises(InputFileError, match="has more than one part"):
        read_image(tmp_path / "a.exr")


def test_bands_in_pages_are_still_read(tmp_path: Path) -> None:
    from l3cli.io.scenes import bands

    write_pages(tmp_path / "a.tif", frames())
    np.testing.assert_array_equal(bands.read(tmp_path / "a.tif").values, np.moveaxis(frames(), 0, 2))
    write_picture(tmp_path / "b.tif", np.zeros((20, 28, 3), np.uint8))
    assert bands.read(tmp_path / "b.tif").values.shape == (20, 28, 3)
    tifffile.imwrite(tmp_path / "c.tif", frames(), photometric="minisblack", description=json.dumps({"shape": [5, 20, 28]}))
    assert bands.read(tmp_path / "c.tif").values.shape == (20, 28, 5)


PAGES = 3


@pytest.fixture
def desk(tmp_path: Path) -> Path:
    """A folder with a table, a stack of frames, and the same frames as files."""
    save(random_table(BAYER, bits=12, black_level=64.0, patch=5), tmp_path / "table.h5")
    frames = np.random.default_rng(5).integers(60, 1200, (PAGES, 24, 30)).astype(np.uint16)
    frames[1] //= 3
    np.save(tmp_path / "stack.npy", frames)
    for number, frame in enumerate(frames):
        np.save(tmp_path / f"f_{number}.npy", frame)
    return tmp_path


@pytest.mark.parametrize("bits", [8, 16, 32])
def test_pages_are_the_pictures_of_a_folder(l3: L3, desk: Path, bits: int) -> None:
    for source in (("stack.npy",), tuple(f"f_{number}.npy" for number in range(PAGES))):
        inputs = [desk / name for name in source]
        for output in ("a.tif", "out"):
            options = ("--format", "tif", "--bits", bits, "--backend", "reference", "--quiet", "--force")
            assert l3("render", desk / "table.h5", *inputs, "-o", desk / output, *options)[0] == 0
        files = sorted((desk / "out").glob("[!.]*"))
        with tifffile.TiffFile(desk / "a.tif") as file:
            assert len(file.pages) == len(files) == PAGES
            for page, alone in zip(file.pages, files, strict=True):
                np.testing.assert_array_equal(page.asarray(), read_image(alone)[0])
                assert page.description == tifffile.TiffFile(alone).pages[0].description
                assert page.tags.valueof(306) is None  # no clock
        for path in files:
            path.unlink()


@pytest.mark.parametrize("count", [1, 2])
def test_an_orientation_that_tiff_does_not_know_is_refused(refused: Refused, desk: Path, count: int) -> None:
    with tifffile.TiffWriter(desk / "a.tif") as file:
        for number in range(count):
            file.write(np.load(desk / "stack.npy")[number], extratags=[(274, 3, 1, 9 - 3 * (number < count - 1), True)])
    words = refused(3, "render", desk / "table.h5", desk / "a.tif", "-o", desk / "a.png" if count == 1 else desk / "out")
    assert "a.tif: the tag Orientation is 9, but TIFF defines only 1…8" in words


def test_pages_state_what_they_are(l3: L3, desk: Path) -> None:
    call = ("render", desk / "table.h5", desk / "stack.npy", "--space", "rec2020", "--backend", "reference")
    for name in ("a.tif", "b.tif"):
        assert l3(*call, "-o", desk / name)[0] == 0
    assert (desk / "a.tif").read_bytes() == (desk / "b.tif").read_bytes()
    with tifffile.TiffFile(desk / "a.tif") as file:
        for page in file.pages:
            profile = ImageCms.ImageCmsProfile(io.BytesIO(page.tags.valueof(34675))).profile
            assert profile.profile_description == "Rec. 2020"


def test_pages_are_of_one_size_and_there_or_not(l3: L3, refused: Refused, desk: Path) -> None:
    np.save(desk / "f_1.npy", np.zeros((20, 30), np.uint16))
    inputs = [desk / f"f_{number}.npy" for number in range(PAGES)]
    err = refused(3, "render", desk / "table.h5", *inputs, "-o", desk / "a.tif", "--backend", "reference")
    assert "f_1.npy has 20×30 pixels, but the first page has 24×30" in err
    (desk / "b.tif").write_bytes(b"mine")
    assert "exists" in refused(1, "render", desk / "table.h5", desk / "stack.npy", "-o", desk / "b.tif")
    assert "a .tif" in refused(2, "render", desk / "table.h5", desk / "stack.npy", "-o", desk / "c.png")


def test_a_full_disk_is_named(l3: L3, desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """numpy's error says how much of an array has been written, and no more."""

    def write(*_: object, **__: object) -> None:
        raise OSError("864000 requested and 366464 written")

    monkeypatch.setattr(tifffile.TiffWriter, "write", write)
    code, _, err = l3(
        "render", desk / "table.h5", desk / "stack.npy", "-o", desk / "a.tif", "--backend", "reference", "--quiet"
    )
    assert (code, "No space left" in err, err.count("\n")) == (1, True, 1)
    assert not (desk / "a.tif").exists()
