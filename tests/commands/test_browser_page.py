"""A table exported as a browser page: classes and pictures equal the reference, and unsupported DNG files are rejected."""

import base64
import dataclasses
import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from l3cli.api import Renderer, read_raw
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.cli import run
from l3cli.rendering.reference import ReferenceRenderer
from tests.helpers.browser import Browser
from tests.helpers.dng_files import LONG, RATIONAL, SHORT, Tags, lossless_jpeg, opcode_list, packed, write_dng
from tests.helpers.tables import random_table, with_refinement

pytestmark = pytest.mark.skipif(
    not (shutil.which("clang") and shutil.which("wasm-ld")), reason="no clang or no wasm-ld here; .ci/run installs both"
)
RGGB = np.array([[0, 1], [1, 2]])
DROPPED = """(async () => {
  const bytes = Uint8Array.from(atob("%s"), (letter) => letter.charCodeAt(0)), given = new DataTransfer();
  given.items.add(new File([bytes], "a.dng"));
  status.textContent = "…";
  drop.dispatchEvent(new DragEvent("drop", { dataTransfer: given, bubbles: true, cancelable: true }));
  while (status.textContent.endsWith("…")) await new Promise((done) => setTimeout(done, 20));
  return status.textContent;
})()"""
SAVED = """(async () => {
  while (save.hidden) await new Promise((done) => setTimeout(done, 20));
  return save.download;
})()"""
DEVELOPED = """(async () => {
  const bytes = Uint8Array.from(atob("%s"), (letter) => letter.charCodeAt(0)), made = await develop(bytes.buffer);
  return [await new Promise((done) => {
    const reader = new FileReader();
    reader.onload = () => done(reader.result.split(",")[1]);
    reader.readAsDataURL(new Blob([made.labels, made.picture]));
  }), made.rows, made.columns];
})()"""


def page_of(table: TransformTable, folder: Path) -> Path:
    save(table, folder / "table.h5")
    assert run(["export", str(folder / "table.h5"), "-o", str(folder / "source"), "--quiet"]) == 0
    made = subprocess.run(["make", "-C", folder / "source", "page"], check=True, capture_output=True, text=True)
    assert not made.stderr  # clang prints no warnings
    return folder / "source/l3_page.html"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """That of a table of two random layers without its camera, which takes no dark current off and states no white."""
    return page_of(with_refinement(random_table(RGGB, 12, 64.0, patch=7), 3), tmp_path_factory.mktemp("page"))


def table_of(page: Path) -> TransformTable:
    return load(TransformTable, page.parents[1] / "table.h5")


def developed(tab: Browser, dng: Path, layers: int) -> tuple[NDArray[np.uint32], NDArray[np.uint8]]:
    """Classes (layer, row, col) and the picture as the sensor lies (row, col, 3)."""
    text, rows, columns = tab.run(DEVELOPED % base64.b64encode(dng.read_bytes()).decode())
    content, count = base64.b64decode(text), 4 * layers * rows * columns
    labels = np.frombuffer(content[:count], np.uint32).reshape(layers, rows, columns)
    return labels, np.frombuffer(content[count:], np.uint8).reshape(rows, columns, 3)


def dropped(tab: Browser, dng: Path) -> str:
    """What the page says of a file that is dropped on it."""
    said: str = tab.run(DROPPED % base64.b64encode(dng.read_bytes()).decode())
    return said


def textured(shape: tuple[int, int], top: int = 4095, seed: int = 3) -> NDArray[np.uint16]:
    rng = np.random.default_rng(seed)
    blocks = rng.random((shape[0] // 6 + 1, shape[1] // 6 + 1)).repeat(6, 0).repeat(6, 1)[: shape[0], : shape[1]]
    return np.clip(top * (0.02 + 1.1 * blocks**2 + 0.02 * rng.normal(size=shape)), 0, top).astype(np.uint16)


def test_a_frame_of_the_camera_is_what_l3_renders(pipeline: Path, tmp_path: Path, tab: Browser) -> None:
    """Dropped, it is shown; classes are those of the reference, the picture that of l3 render within one code."""
    table = dataclasses.replace(load(TransformTable, pipeline / "table.h5"), black_level=64.0, white_level=3814.0)
    made = page_of(table, tmp_path)
    raw = read_raw(next((pipeline / "unseen").glob("*_raw.tif")), table)
    raw = dataclasses.replace(raw, dark=0.0)  # which codes of a file cannot take off
    levels: Tags = {50714: (SHORT, [64]), 50717: (LONG, [3814]), 274: (SHORT, [6])}
    dng = write_dng(tmp_path / "a.dng", raw.values, RGGB, tags=levels)
    tab.open(made)
    said = dropped(tab, dng)
    rows, columns = raw.values.shape
    assert said.startswith(f"a.dng from some camera: {rows} × {columns} pixels in ")
    assert tab.run("[canvas.hidden, canvas.width, canvas.height]") == [False, rows, columns]
    assert tab.run(SAVED) == "a.png"
    upright = tab.run("[...canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data]")
    labels, picture = developed(tab, dng, len(table.layers))
    for layer, ours in enumerate(labels):
        np.testing.assert_array_equal(ours, ReferenceRenderer(table).labels(raw, layer))
    shown = Renderer(table).picture(raw, white="table")
    assert np.abs(picture.astype(int) - shown).max() <= 1
    turned = np.reshape(np.array(upright, np.uint8), (columns, rows, 4))
    np.testing.assert_array_equal(turned[..., :3], np.rot90(picture, -1))
    assert (turned[..., 3] == 255).all()
    assert tab.complaints() == []


def test_the_page_is_small(tmp_path: Path) -> None:
    """By one layer of 9×9 patches, as `fast` has."""
    table = random_table(RGGB, 12, 64.0, patch=9, contrasts=())
    made = page_of(table, tmp_path)
    assert (made.parent / "page.html").stat().st_size < 20_000
    code = made.parent / "code.wasm"
    subprocess.run(["clang", "--target=wasm32", "-O3", "-msimd128", "-c", "-o", code, made.parent / "l3.c"], check=True)
    assert code.stat().st_size < 100_000


TILES: Tags = {322: (LONG, [48]), 323: (LONG, [32]), 324: (LONG, [0] * 6), 325: (LONG, [48 * 32 * 2] * 6)}
STRIPS = (273, 278, 279)
FORMS: dict[str, dict[str, Any]] = {
    "16 bits": {},
    "16 bits, Motorola": {"order": ">"},
    "8 bits": {"bits": 8, "tags": {50714: (SHORT, [3]), 50717: (LONG, [250])}},
    "10 bits": {"bits": 10, "tags": {50717: (LONG, [1000])}},
    "12 bits": {"bits": 12},
    "14 bits, Motorola": {"bits": 14, "order": ">", "tags": {50717: (LONG, [16000])}},
    "a crop": {"tags": {50829: (LONG, [3, 5, 60, 93]), 50719: (LONG, [2, 1]), 50720: (LONG, [70, 50])}},
    "levels of sites": {"tags": {50713: (SHORT, [2, 2]), 50714: (RATIONAL, [64, 1, 66, 1, 62, 1, 64, 1])}},
    "levels of columns": {"tags": {50715: (RATIONAL, [n % 3 for n in range(96) for n in (n, 1)])}},
    "a curve": {"bits": 8, "tags": {50712: (SHORT, [16 * n for n in range(256)])}},
    "three strips": {"strips": 3},
    "tiles": {"tiles": True, "tags": TILES, "drop": STRIPS},
    "lossless JPEG": {"jpeg": (1, 1)},
    **{f"lossless JPEG of two, predictor {n}": {"jpeg": (2, n)} for n in range(1, 8)},
    "lossless JPEG of four, 12 bits, in tiles": {"jpeg": (4, 1), "bits": 12, "tiles": True, "tags": TILES, "drop": STRIPS},
    "a gain map": {"tags": {51009: opcode_list((1, 1, b"\0\0\0\0"))}},
}  # fmt: skip


def form(
    path: Path, bits: int = 16, order: str = "<", strips: int = 1, tiles: bool = False, jpeg: tuple[int, int] | None = None,
    **more: Any,
) -> Path:  # fmt: skip
    values = textured((64, 96), min(2**bits - 1, 4095 if bits != 14 else 16383))

    def coded(part: NDArray[np.uint16]) -> bytes:
        return lossless_jpeg(part, *jpeg, bits) if jpeg else packed(part, bits, order)

    parts = [coded(each) for each in np.array_split(values, strips)]
    if strips == 3:
        more["tags"] = {278: (LONG, [22])}  # of the first two
        parts = [coded(values[at : at + 22]) for at in (0, 22, 44)]
    if tiles:
        parts = [coded(values[row : row + 32, col : col + 48]) for row in (0, 32) for col in (0, 48)]
        more["tags"] = {**more["tags"], 324: (LONG, [0] * 4), 325: (LONG, [len(each) for each in parts])}
    if jpeg:
        more["tags"] = {**more.get("tags", {}), 259: (SHORT, [7])}
    return write_dng(path, values, RGGB[::-1], bits, order, strips=parts, **more)


@pytest.mark.parametrize("name", FORMS)
def test_forms_of_dng_are_read_as_by_l3(name: str, page: Path, tmp_path: Path, tab: Browser) -> None:
    """Its classes depend on every value and on the site of the first pixel."""
    table, dng = table_of(page), form(tmp_path / "a.dng", **FORMS[name])
    tab.open(page)
    labels, picture = developed(tab, dng, 2)
    frame = read_raw(dng, table)
    assert frame.phase == ((0, 0) if name == "a crop" else (1, 0))
    for layer, ours in enumerate(labels):
        np.testing.assert_array_equal(ours, ReferenceRenderer(table).labels(frame, layer))
    shown = Renderer(table, backend="reference").picture(frame, white="table")
    assert np.abs(picture.astype(int) - shown).max() <= 1
    assert dropped(tab, dng).endswith("ignored: OpcodeList2") == (name == "a gain map")


def test_the_white_that_a_file_states_is_shown_neutral(pipeline: Path, tmp_path: Path, tab: Browser) -> None:
    table = load(TransformTable, pipeline / "table.h5")
    assert table.camera is not None
    grey = np.array([0.2, 0.5, 0.45])  # a grey under a warm lamp
    values = np.rint(table.black_level + grey[np.tile(RGGB, (30, 40))] * (table.white_level - table.black_level))
    levels: Tags = {50714: (SHORT, [64]), 50717: (LONG, [int(table.white_level)])}
    neutral: Tags = {50728: (RATIONAL, [40, 100, 100, 100, 90, 100])}
    tab.open(page_of(table, tmp_path))
    casts = []
    for tags in (levels, levels | neutral, levels):  # one file leaves nothing to the next
        dng = write_dng(tmp_path / "a.dng", values.astype(np.uint16), RGGB, tags=tags)
        _, picture = developed(tab, dng, len(table.layers))
        casts.append(int(np.ptp(np.median(picture, axis=(0, 1)))))
    assert casts[0] == casts[2] > 40
    assert casts[1] <= 4


CONVERT = "convert the file to a DNG with lossless JPEG compression or without compression"


@pytest.mark.parametrize(
    ("tags", "words"),
    [
        ({259: (SHORT, [8])}, f"compression Deflate is not supported; {CONVERT}"),
        ({259: (SHORT, [5])}, f"compression 5 is not supported; {CONVERT}"),
        ({259: (SHORT, [7])}, "the file is damaged or not a DNG"),
        ({262: (SHORT, [2])}, "the file contains no camera mosaic"),
        ({277: (SHORT, [3])}, "the file is already demosaicked (linear DNG); use the raw file that the camera wrote"),
        ({266: (SHORT, [2])}, "this page does not support FillOrder 2"),
        ({258: (SHORT, [32])}, "this page does not support BitsPerSample 32"),
        ({50829: (LONG, [0, 0, 70, 96])}, "the crop area extends beyond the image; the file is damaged"),
        ({33422: (1, [1, 1, 1, 1])}, "the colour filter array in the file differs from that of this page's camera"),
        ({273: (LONG, [2**31])}, "the file is damaged or not a DNG"),
    ],
)
def test_what_cannot_be_read_is_named_in_a_line(tags: Tags, words: str, page: Path, tmp_path: Path, tab: Browser) -> None:
    tab.open(page)
    dng = write_dng(tmp_path / "a.dng", textured((64, 96)), RGGB, tags=tags)
    if 273 in tags:  # cut off
        dng.write_bytes(dng.read_bytes()[:-100])
    assert dropped(tab, dng) == f"a.dng: {words}"
    assert tab.run("[canvas.hidden, save.hidden]") == [True, True]
    cut = lossless_jpeg(textured((64, 96)))[:-1000]
    assert dropped(tab, write_dng(dng, textured((64, 96)), RGGB, strips=[cut], tags={259: (SHORT, [7])})) == (
        "a.dng: the image data in the file are damaged"
    )
    for content in (b"", b"II*\0", b"PNG" * 100):
        dng.write_bytes(content)
        assert dropped(tab, dng) in ("a.dng: the file is damaged or not a DNG", "a.dng: the file is not a DNG")
    assert tab.complaints() == []


def test_the_name_of_a_camera_cannot_leave_its_string(tmp_path: Path) -> None:
    table = random_table(RGGB, 12, 64.0)
    save(table, tmp_path / "table.h5")
    odd = "</script><b>"
    save(dataclasses.replace(table, camera_name=odd), tmp_path / "odd.h5")
    assert run(["export", str(tmp_path / "odd.h5"), "-o", str(tmp_path / "c"), "--prefix", "eye", "--quiet"]) == 0
    text = (tmp_path / "c/page.html").read_text()
    assert odd not in text
    assert "c.eye_render(" in text
    facts = json.loads(text.partition("const TABLE = ")[2].partition(";\n")[0])
    assert facts["camera"] == odd
