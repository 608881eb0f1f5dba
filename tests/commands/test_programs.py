"""The recipes of docs/programs.md, run in the programs that they are for and compared with l3."""

import re
import shutil
import subprocess
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rawpy
import tifffile
from numpy.typing import NDArray

import l3cli
from l3cli.errors import InputFileError, RecipeError
from l3cli.io.images import read_image
from l3cli.io.pictures.registry import write_picture
from tests.helpers.calls import L3
from tests.helpers.dng_files import LONG, RATIONAL, SHORT, write_dng
from tests.helpers.readme import PAGES, blocks, commands, fenced

PAGE = PAGES["programs.md"]
RECIPES = {title: blocks(f"{text}\n")[0] for title, text in re.findall(r"^## (.+)\n((?:(?!^## ).*\n)*)", PAGE, re.M)}
RGGB = np.array([[0, 1], [1, 2]])


@pytest.fixture(scope="module")
def made(pipeline: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a table and a frame of its camera that states levels and a white: frame.dng, and its mosaic.png."""
    folder = tmp_path_factory.mktemp("programs")
    shutil.copy(pipeline / "table.h5", folder)
    mosaic = tifffile.imread(next((pipeline / "unseen").glob("*_raw.tif")))
    matrix = [part for entry in (9000, -2000, -800, -4000, 12000, 2000, -500, 1500, 6000) for part in (entry, 10000)]
    white = {50714: (SHORT, [66]), 50717: (LONG, [3800]), 50728: (RATIONAL, [60, 100, 100, 100, 70, 100])}
    tags = {**white, 33434: (RATIONAL, [1, 8]), 50721: (10, matrix), 50778: (SHORT, [21])}
    for name in ("frame", "photo", "other"):
        write_dng(folder / f"{name}.dng", mosaic, RGGB, tags=tags)
    write_picture(folder / "mosaic.png", mosaic[..., None])
    return folder


@pytest.fixture
def there(made: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The same, as the working folder."""
    monkeypatch.chdir(made)
    return made


def names_of(title: str) -> dict[str, Any]:
    """What a recipe defines, once it has run."""
    names: dict[str, Any] = {}
    exec(RECIPES[title], names)
    return names


def expected(**options: Any) -> NDArray[np.uint8]:
    table = l3cli.load_table("table.h5")
    return l3cli.Renderer(table).picture(l3cli.read_raw("frame.dng", table), **options)


def test_every_recipe_is_tried_here_and_short() -> None:
    assert list(RECIPES) == ["rawpy", "darktable, RawTherapee", "OpenCV", "ROS", "deepinv", "napari", "ImageIO"]
    assert max(len(recipe.splitlines()) for recipe in RECIPES.values()) <= 30


@pytest.mark.skipif(not hasattr(rawpy.RawPy, "other"), reason="rawpy is too old for the recipe")
def test_arrays_of_rawpy(there: Path) -> None:
    names, table = names_of("rawpy"), l3cli.load_table("table.h5")
    np.testing.assert_array_equal(names["picture"], expected())
    with rawpy.imread("frame.dng") as raw:
        made, own = names["frame_of"](raw, table), l3cli.read_raw("frame.dng", table)
        assert own.exposure
        assert (made.exposure, made.dark, made.gain) == pytest.approx((own.exposure, own.dark, own.gain))
        ours = l3cli.raw_frame(raw.raw_image_visible.copy(), l3cli.load_table("table.h5"), pattern="bggr")
    assert ours.phase == (1, 1)


def test_arrays_that_are_no_frames(there: Path) -> None:
    table, values = l3cli.load_table("table.h5"), np.full((8, 8), 100, np.uint16)
    for pattern in ("rgb", "rgxb", ["rg", "gb"], np.array([["rg", "g"], ["g", "b"]])):
        with pytest.raises(RecipeError, match=r"pattern .* is not a filter array; pass rows of the letters RGBCMYW"):
            l3cli.raw_frame(values, table, pattern=pattern)
    with pytest.raises(InputFileError, match="the array has the colour filter array rr/gg"):
        l3cli.raw_frame(values, table, pattern="rrgg")
    with pytest.raises(InputFileError, match="is not a raw frame; pass raw values"):
        l3cli.raw_frame(values.astype(np.float32), table)
    stated = l3cli.raw_frame(values, table, neutral={"R": 0.5, "G": 1.0, "B": 0.7}, black_level=10, white_level=255)
    assert (stated.neutral, stated.black_level, stated.white_level) == ((0.5, 1.0, 0.7), 10, 255)
    with pytest.warns(UserWarning, match="array") as told:
        l3cli.raw_frame(np.full((8, 8), 9000, np.uint16), table)
    assert told[0].filename == __file__


def test_linear_dng_are_developed(there: Path, l3: L3) -> None:
    """By LibRaw, and by RawTherapee and darktable where they are installed: light and colours are those of l3's picture."""
    lines = RECIPES["darktable, RawTherapee"].splitlines()
    for words in commands(lines[0]):
        assert l3(*words, "--quiet")[0] == 0
    wanted, shown = expected(), {}
    with rawpy.imread("linear/photo.dng") as raw:
        shown["LibRaw"] = raw.postprocess(use_camera_wb=True, no_auto_bright=True, bright=2.0 ** stops(there))
    for command, line in zip(("rawtherapee-cli", "darktable-cli"), lines[1:], strict=True):
        if shutil.which(command):
            (there / "developed").mkdir()
            subprocess.run(["bash", "-ec", line], check=True, capture_output=True)
            shown[command] = read_image(there / "developed/photo.jpg")[0]
            shutil.rmtree(there / "developed")
    for program, picture in shown.items():
        assert picture.shape == wanted.shape, program
        ours, theirs = (each.reshape(-1, 3).mean(axis=0) for each in (wanted.astype(float), picture.astype(float)))
        assert np.corrcoef(wanted[..., 1].ravel(), picture[..., 1].ravel())[0, 1] > 0.9, program
        assert np.abs(theirs / theirs.sum() - ours / ours.sum()).max() < 0.05, (program, ours, theirs)


def stops(folder: Path) -> float:
    with tifffile.TiffFile(folder / "linear/photo.dng") as file:
        above, below = file.pages[0].tags["BaselineExposure"].value
    return float(above / below)


def test_opencv(there: Path) -> None:
    cv2 = pytest.importorskip("cv2")
    names = names_of("OpenCV")
    mosaic = cv2.imread("mosaic.png", cv2.IMREAD_UNCHANGED)
    theirs = cv2.demosaicing(mosaic, cv2.COLOR_BayerRGGB2BGR)
    ours = names["demosaicing"](mosaic)
    assert (ours.shape, ours.dtype) == (theirs.shape, np.uint8)
    np.testing.assert_array_equal(ours[..., ::-1], l3cli.Renderer("table.h5").sequence(Fraction(30))(mosaic))
    np.testing.assert_array_equal(cv2.imread("picture.png"), ours)


@pytest.mark.parametrize(
    ("encoding", "big"), [("bayer_rggb16", 0), ("bayer_rggb16", 1), ("bayer_grbg16", 0), ("bayer_rggb8", 0)]
)
def test_messages_of_ros(there: Path, encoding: str, big: int) -> None:
    """Rows may be longer than the picture is wide, as drivers pad them."""
    debayer = names_of("ROS")["Debayer"]
    with rawpy.imread("frame.dng") as raw:
        values = raw.raw_image_visible[:, "grbg" in encoding :].copy()
    levels: dict[str, Any] = {"black_level": 66, "white_level": 3800}
    if encoding.endswith("8"):
        values, levels = (values >> 4).astype(np.uint8), {"black_level": 4.125, "white_level": 237.5}
    sent = values.astype((">" if big else "<") + values.dtype.str[1:])
    rows = np.pad(sent.view(np.uint8).reshape(len(sent), -1), ((0, 0), (0, 6)))
    message = SimpleNamespace(
        header="as it came", height=len(values), width=values.shape[1], encoding=encoding, is_bigendian=big,
        step=rows.shape[1], data=rows.tobytes(),
    )  # fmt: skip
    reply = debayer("table.h5", **levels)(message)
    assert (reply.header, reply.encoding, reply.step, reply.height) == ("as it came", "rgb8", 3 * reply.width, len(values))
    shown = np.frombuffer(reply.data, np.uint8).reshape(reply.height, reply.width, 3)
    table = l3cli.load_table("table.h5")
    frame = l3cli.raw_frame(values, table, pattern=encoding[6:10], **levels)
    np.testing.assert_array_equal(shown, l3cli.Renderer(table).sequence(Fraction(30))(frame))
    bright = np.abs(shown.astype(int) - expected(white="table")[:, shown.shape[1] * -1 :])
    assert np.median(bright) < (12 if encoding.endswith("8") else 3)


def test_deepinv(there: Path) -> None:
    """The forward model has its adjoint and the camera's noise; l3 makes of its mosaics what it makes of arrays."""
    deepinv, torch = pytest.importorskip("deepinv"), pytest.importorskip("torch")
    names, table = names_of("deepinv"), l3cli.load_table("table.h5")
    physics, model = names["Camera"](table, 24, 30), names["Rendered"](table)
    assert physics.adjointness_test(torch.rand(2, 3, 24, 30)).abs() < 1e-3
    assert table.camera is not None
    flat = physics(torch.full((1, 3, 24, 30), 0.5).repeat(200, 1, 1, 1))
    full = (table.white_level - table.black_level) / table.camera.gain
    assert flat.std().item() == pytest.approx(np.sqrt(0.5 * full + table.camera.noise.read_noise**2) / full, rel=0.02)
    mosaics = physics.A(torch.rand(2, 3, 24, 30) * 0.5)
    pictures = model(mosaics, physics)
    assert isinstance(model, deepinv.models.Reconstructor)
    assert pictures.shape == (2, 3, 24, 30)
    codes = table.black_level + mosaics[1, 0].numpy() * (table.white_level - table.black_level)
    alone = l3cli.Renderer(table).picture(codes.round().astype(np.uint16), exposure=1.0, white="table", bits=32)
    np.testing.assert_array_equal(pictures[1].movedim(0, -1).numpy(), alone)


def test_napari_reads_tables_and_frames_through_npe2(there: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    npe2 = pytest.importorskip("npe2")
    (there / "my_napari.py").write_text(RECIPES["napari"])
    (manifest,) = fenced(PAGE, "yaml")
    (there / "napari.yaml").write_text(manifest)
    monkeypatch.syspath_prepend(str(there))
    manager = npe2.PluginManager()
    manager.register(npe2.PluginManifest.from_file(there / "napari.yaml"))
    monkeypatch.setattr(npe2.PluginManager, "instance", classmethod(lambda cls: manager))
    table = l3cli.load_table("table.h5")
    layers = npe2.read([str(there / "table.h5")], stack=False)
    assert [each[1]["name"] for each in layers] == [f"layer {number + 1}" for number in range(len(table.layers))]
    middle = layers[0][0][5, 1, 0, 2, 2]
    assert middle == table.first.weights[5, 1, 12]
    raw, classes, picture = npe2.read([str(there / "frame.dng")], stack=False)
    frame = l3cli.read_raw("frame.dng", table)
    np.testing.assert_array_equal(raw[0], frame.values)
    np.testing.assert_array_equal(classes[0], l3cli.Renderer(table).labels(frame))
    assert (classes[2], picture[1]["rgb"]) == ("labels", True)
    np.testing.assert_array_equal(picture[0], expected())
    (there / "elsewhere").mkdir(exist_ok=True)
    shutil.copy("frame.dng", there / "elsewhere")
    with pytest.raises(ValueError, match="No readers"):
        npe2.read([str(there / "elsewhere/frame.dng")], stack=False)


def test_imageio(there: Path) -> None:
    iio = pytest.importorskip("imageio.v3")
    names = names_of("ImageIO")
    np.testing.assert_array_equal(names["picture"], expected())
    plugin = names["Rendered"]
    deep = iio.imread("frame.dng", plugin=plugin, table="table.h5", bits=16, white="table")
    np.testing.assert_array_equal(deep, expected(bits=16, white="table"))
    assert iio.improps("frame.dng", plugin=plugin).shape == deep.shape
    assert set(iio.immeta("frame.dng", plugin=plugin)) == {"exposure", "iso"}
    assert [each.shape for each in iio.imiter("frame.dng", plugin=plugin)] == [deep.shape]
