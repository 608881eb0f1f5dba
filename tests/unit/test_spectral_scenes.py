"""Spectral cubes of all storage layouts: values, wavelengths and missing data are read as the files state them.

A message about a wrong file names the field that is wrong.
"""

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import TrainingFrame, open_training_set
from l3cli.errors import InputFileError
from l3cli.evaluation.evaluation import Evaluation
from l3cli.frames.scene import Scene, SpectralCube
from l3cli.io.scenes import bands, cube, envi
from l3cli.simulation.light import OUTPUTS, Target, require_seen
from l3cli.simulation.sources import Cube, Envi, scene_of
from l3cli.training.layers.mosaics import Mosaics, _usable
from l3cli.training.patches import sample_patches
from tests.helpers.calls import L3, Refused
from tests.helpers.recipes import FEW_CLASSES
from tests.helpers.tables import random_table

NM = np.arange(400.0, 701.0, 10.0)
PLAIN = np.kron([[0.9, 0.6], [0.3, 0.1]], np.ones((10, 12)))  # (row, col) reflectances of four areas
TRUTH = np.repeat(PLAIN[..., None], NM.size, axis=2) * np.linspace(1.0, 0.8, NM.size)  # (row, col, band)
ORDERS = {"bsq": (2, 0, 1), "bil": (0, 2, 1), "bip": (0, 1, 2)}


def numbers(values: Any) -> str:
    return "{" + ", ".join(f"{value:.9g}" for value in np.broadcast_to(values, NM.size)) + "}"


def written(folder: Path, stored: np.ndarray, more: str = "", drop: str = "", nm: np.ndarray = NM) -> Path:
    """An ENVI cube, bsq, with further lines in its header; `drop`: a field left out."""
    codes = {"u1": 1, "i2": 2, "i4": 3, "f4": 4, "f8": 5, "u2": 12, "u4": 13, "i8": 14, "u8": 15, "c8": 6}
    fields = {
        "samples": stored.shape[1], "lines": stored.shape[0], "bands": stored.shape[2], "interleave": "bsq",
        "data type": codes[stored.dtype.str[1:]], "byte order": int(stored.dtype.str[0] == ">"), "wavelength": numbers(nm),
    }  # fmt: skip
    lines = [f"{name} = {value}" for name, value in fields.items() if name != drop]
    (folder / "scene.hdr").write_text("\n".join(["ENVI", *lines, more]), encoding="utf-8")
    (folder / "scene.img").write_bytes(np.ascontiguousarray(stored.transpose(2, 0, 1)).tobytes())
    return folder / "scene.hdr"


def scene(cube: SpectralCube, **keys: Any) -> Scene:
    return scene_of(cube, Cube(file="x", **keys), "x", None)


def envi_scene(path: Path, **keys: Any) -> Scene:
    source = Envi(file="x", **keys)
    return scene_of(envi.read(path, source.holds), source, "x", None)


# ------------------------------------------------------------------------------------------------------------ ENVI

SCALED = {
    "scale factor": (10000 * TRUTH, "reflectance scale factor = 10000"),
    "gains": (1000 * TRUTH, f"data gain values = {numbers(1e-3)}"),
    "gains of each band": (1e7 * TRUTH / NM, f"data gain values = {numbers(NM * 1e-7)}"),
    "offsets": (1000 * TRUTH + 100, f"data gain values = {numbers(1e-3)}\ndata offset values = {numbers(-0.1)}"),
    "reflectance gains": (1000 * TRUTH, f"data reflectance gain values = {numbers(1e-3)}"),
    "reflectance offsets": (
        1000 * TRUTH + 200,
        f"data reflectance gain values = {numbers(1e-3)}\ndata reflectance offset values = {numbers(-0.2)}",
    ),
    "gains to radiance and reflectance": (
        1000 * TRUTH,
        f"data gain values = {numbers(7.0)}\ndata reflectance gain values = {numbers(1e-3)}",
    ),
    "gains of one, and a scale factor": (
        10000 * TRUTH,
        f"data gain values = {numbers(1)}\ndata offset values = {numbers(0)}\nreflectance scale factor = 10000",
    ),
}


@pytest.mark.parametrize("case", SCALED)
def test_stated_scales_give_reflectance(tmp_path: Path, case: str) -> None:
    stored, more = SCALED[case]
    for dtype in ("<u2", ">i4"):
        found = envi_scene(written(tmp_path, np.rint(stored).astype(dtype), more))
        assert np.allclose(found.reflectance, TRUTH, atol=1.1e-3)


def test_gains_to_radiance_are_taken_where_the_recipe_says_radiance(tmp_path: Path) -> None:
    more = f"data gain values = {numbers(NM)}\ndata reflectance gain values = {numbers(1e-3)}"
    values = envi.read(written(tmp_path, np.rint(1000 * TRUTH).astype("<u2"), more), "radiance").values
    assert np.allclose(values, np.rint(1000 * TRUTH) * NM, rtol=1e-6)


@pytest.mark.parametrize(
    ("unit", "values"),
    [
        ("Nanometers", NM), ("nm", NM), ("Micrometers", NM / 1e3), ("µm", NM / 1e3), ("microns", NM / 1e3),
        ("Millimeters", NM / 1e6), ("Meters", NM / 1e9), ("Angstroms", NM * 10), ("angstrom", NM * 10),
        ("Wavenumber", 1e7 / NM), ("cm-1", 1e7 / NM), ("GHz", 299792458 / NM), ("MHz", 299792458e3 / NM),
        ("Unknown", NM), ("", NM / 1e3),
    ],
)  # fmt: skip
def test_wavelengths_of_every_unit(tmp_path: Path, unit: str, values: np.ndarray) -> None:
    path = written(tmp_path, TRUTH.astype("<f4"), f"wavelength units = {unit}", nm=values)
    found = envi_scene(path)
    assert np.allclose(found.wavelength, NM, rtol=1e-6)
    assert np.allclose(found.reflectance, TRUTH, atol=1e-6)


@pytest.mark.parametrize(("unit", "first"), [("Index", 1), ("Index", 0), ("Unknown", 1)])
def test_indices_are_no_wavelengths(tmp_path: Path, unit: str, first: int) -> None:
    path = written(tmp_path, TRUTH.astype("<f4"), f"wavelength units = {unit}", nm=np.arange(31.0) + first)
    assert envi.read(path).wavelength is None
    found = envi_scene(path, wavelength_range_nm=(400.0, 700.0, 10.0))
    assert np.allclose(found.reflectance, TRUTH, atol=1e-6)


@pytest.mark.parametrize("form", ["{} nm", "Band ({:g} Nanometers)", "B{}_nm", "{}"])
def test_band_names_state_wavelengths(tmp_path: Path, form: str) -> None:
    names = ", ".join(form.format(int(nm)) for nm in NM)
    path = written(tmp_path, TRUTH.astype("<f4"), f"band names = {{\n {names}}}", drop="wavelength")
    assert np.array_equal(envi_scene(path).wavelength, NM)


def test_bad_bands_are_left_out(tmp_path: Path) -> None:
    stored, good = TRUTH.copy(), np.ones(NM.size)
    good[[0, 13, 14, 15]], stored[..., [0, 13, 14, 15]] = 0, -5.0
    found = envi_scene(written(tmp_path, stored.astype("<f4"), f"bbl = {numbers(good)}"))
    assert np.array_equal(found.wavelength, NM[good > 0])
    assert np.allclose(found.reflectance, TRUTH[..., good > 0], atol=1e-6)


def test_bands_out_of_order_are_sorted(tmp_path: Path) -> None:
    order = np.random.default_rng(0).permutation(NM.size)
    found = envi_scene(written(tmp_path, TRUTH[..., order].astype("<f4"), nm=NM[order]))
    assert np.array_equal(found.wavelength, NM)
    assert np.allclose(found.reflectance, TRUTH, atol=1e-6)
    twice = SpectralCube(TRUTH, np.where(NM == 500, 510.0, NM))
    with pytest.raises(ValueError, match="510 nm"):
        scene(twice)


@pytest.mark.parametrize("interleave", ORDERS)
def test_frame_offsets_are_skipped(tmp_path: Path, interleave: str) -> None:
    stored = np.ascontiguousarray(TRUTH.transpose(ORDERS[interleave])).astype(">f4")
    content = b"h" * 7
    for major in stored:
        content += b"m" * 3 + b"".join(b"a" * 2 + minor.tobytes() + b"b" * 5 for minor in major) + b"n"
    more = f"interleave = {interleave}\nheader offset = 7\nmajor frame offsets = {{3, 1}}\nminor frame offsets = {{2, 5}}"
    path = written(tmp_path, TRUTH.astype(">f4"), more)
    (tmp_path / "scene.img").write_bytes(content)
    assert np.allclose(envi.read(path).values, TRUTH, atol=1e-6)


def test_a_header_as_people_write_it(tmp_path: Path) -> None:
    listed = ",\n; a comment = {\n  ".join(f"{nm:g}" for nm in NM)
    text = f"""ENVI
; made = by hand
Description =
{{ samples = 3,
  lines = 4 }}
Lines   = 20
SAMPLES = 24
bands   = 31
data\ttype = 4
Interleave = BSQ
wavelength units =  Nanometers
Wavelength =
{{ {listed}, }}
sensor type = Unknown
x start = 5
z plot titles = {{Wavelength, Value}}
"""
    written(tmp_path, TRUTH.astype("<f4"))
    (tmp_path / "scene.hdr").write_text(text, encoding="utf-8-sig")
    found = envi_scene(tmp_path / "scene.hdr")
    assert np.array_equal(found.wavelength, NM)
    assert np.allclose(found.reflectance, TRUTH, atol=1e-6)


@pytest.mark.parametrize(
    ("more", "drop", "field"),
    [
        ("file type = ENVI Classification", "", "file type"),
        ("file type = ENVI Spectral Library", "", "file type"),
        ("file type = TIFF", "", "file type"),
        ("file compression = 1", "", "file compression"),
        ("read procedures = {a, b}", "", "read procedures"),
        ("data type = 6", "", "data type"),
        ("data type = 99", "", "data type"),
        ("byte order = 2", "", "byte order"),
        ("interleave = tiled", "", "interleave"),
        ("", "interleave", "interleave"),
        ("", "samples", "samples"),
        ("header offset = -4", "", "header offset"),
        ("minor frame offsets = {0.5, 1}", "", "minor frame offsets"),
        ("wavelength units = furlongs", "", "wavelength units"),
        ("wavelength = {400, 500}", "", "wavelength"),
        ("bbl = {1, 0}", "", "bbl"),
        (f"bbl = {numbers(0)}", "", "bbl"),
        (f"bbl = {numbers(0.5)}", "", "bbl"),
        ("data gain values = {a}", "", "data gain values"),
        (f"data gain values = {numbers(0)}", "", "data gain values"),
        (f"data gain values = {numbers(2)}\nreflectance scale factor = 100", "", "reflectance scale factor"),
        ("reflectance scale factor = 0", "", "reflectance scale factor"),
        ("data ignore value = none", "", "data ignore value"),
    ],
)
def test_what_cannot_be_read_is_named(tmp_path: Path, more: str, drop: str, field: str) -> None:
    path = written(tmp_path, TRUTH.astype("<f4"), more, drop)
    with pytest.raises(InputFileError, match=rf'scene\.hdr: the field "{field}"'):
        envi.read(path)


def test_a_harmless_field_changes_nothing(tmp_path: Path) -> None:
    plain = envi.read(written(tmp_path, TRUTH.astype("<f4")))
    harmless = [field for field in envi.FIELDS if field.fate == envi.HARMLESS]
    assert len(harmless) > 20
    lines = "\n".join(f"{field.name} = {{7, 8}}" for field in harmless)
    other = envi.read(written(tmp_path, TRUTH.astype("<f4"), lines))
    assert np.array_equal(other.values, plain.values)
    assert other.wavelength is not None
    assert np.array_equal(other.wavelength, NM)
    assert (other.white, other.good, other.ignored) == (plain.white, plain.good, plain.ignored)


def test_fields_of_a_maker_that_may_change_values_are_named(tmp_path: Path, l3: L3, bayer_recipe: Path) -> None:
    more = "radiance gain = {2, 3}\nfps = 30\nDark  Level = 12\ncalibration =\ndata offset values = {0}"
    path = written(tmp_path, TRUTH.astype("<f4"), more)
    assert envi.unknown(path) == ["radiance gain", "dark level"]
    (tmp_path / "scenes.toml").write_text('exposure_share = [0.9]\n[[scene]]\nsource = "envi"\nfile = "scene.hdr"\n')
    code, _, err = l3("simulate", tmp_path / "scenes.toml", "--camera", bayer_recipe, "-o", tmp_path / "set.h5")
    assert (code, sum("scene.hdr" in line and "dark level" in line for line in err.splitlines())) == (0, 1)


# ---------------------------------------------------------------------------------------------------- the question


@pytest.mark.parametrize("dtype", ["i2", "u2", "i4", "u4", "i8"])
def test_integers_without_a_scale_are_asked_for_it(dtype: str) -> None:
    stored = np.rint(10000 * TRUTH).astype(dtype)
    with pytest.raises(ValueError, match="white"):
        scene(SpectralCube(stored, NM))
    for known in (scene(SpectralCube(stored, NM, 10000.0)), scene(SpectralCube(stored, NM), white=10000.0)):
        assert np.allclose(known.reflectance, TRUTH, atol=1e-4)


def test_integers_that_fill_their_type_have_its_top_as_white() -> None:
    for dtype, top in (("u2", 65535), ("u1", 255)):
        found = scene(SpectralCube(np.rint(TRUTH * top).astype(dtype), NM)).reflectance
        assert np.allclose(found, TRUTH, atol=0.003)


def test_a_number_below_zero_in_all_bands_is_asked_about() -> None:
    stored = TRUTH.astype(np.float32)
    stored[3, 4] = -0.5
    with pytest.raises(ValueError, match=r"ignored = -0\.5"):
        scene(SpectralCube(stored, NM))
    found = scene(SpectralCube(stored, NM), ignored=-0.5)
    assert found.ignored is not None
    assert np.argwhere(found.ignored).tolist() == [[3, 4]]
    stored[3, 4] = np.linspace(-0.1, -0.05, NM.size)  # noise
    assert scene(SpectralCube(stored, NM)).reflectance[3, 4].max() == 0


@pytest.mark.parametrize(
    ("kind", "outputs", "least"),
    [
        ("CIE 1931", OUTPUTS["CIE 1931"], "Y"),
        ("luminance", OUTPUTS["luminance"], "Y"),
        ("reflectance 31", OUTPUTS["reflectance 31"], "400…700"),
        ("camera", ("r", "g", "b"), "channels"),
    ],
)
def test_cubes_beside_what_is_wanted_are_refused(bayer: CameraModel, kind: str, outputs: Any, least: str) -> None:
    target = Target(outputs, "", kind)
    require_seen(NM, target, bayer)
    for beside in (np.arange(1000.0, 1301.0, 10.0), np.arange(4000.0, 7001.0, 100.0)):
        with pytest.raises(ValueError, match="nm"):
            require_seen(beside, target, bayer)


# ----------------------------------------------------------------------------------------------------- missing data

MARKS = {
    "negative": ("<i2", -9999, "data ignore value = -9999"),
    "zero": ("<u2", 0, "data ignore value = 0"),
    "rounded": ("<f4", -3.4028235e38, "data ignore value = -3.40282e+38"),
    "NaN": ("<f4", np.nan, "data ignore value = NaN"),
}


@pytest.mark.parametrize("case", MARKS)
def test_marked_pixels_have_their_neighbours_reflectance(tmp_path: Path, case: str) -> None:
    dtype, mark, more = MARKS[case]
    stored = np.rint(TRUTH * 10000).astype(dtype) if "f" not in dtype else TRUTH.astype(dtype)
    white = "" if "f" in dtype else "\nreflectance scale factor = 10000"
    stored[2:5, 3:5, 7:9] = mark  # in some bands alone
    found = envi_scene(written(tmp_path, stored, more + white))
    expected = np.zeros(PLAIN.shape, bool)
    expected[2:5, 3:5] = True
    assert found.ignored is not None
    assert np.array_equal(found.ignored, expected)
    assert np.allclose(found.reflectance, TRUTH, atol=1e-4)


@pytest.fixture
def simulated(l3: L3, bayer_recipe: Path, tmp_path: Path) -> Callable[[str], Path]:
    def run(text: str) -> Path:
        (tmp_path / "scenes.toml").write_text(f"exposure_share = [0.9]\n[[scene]]\n{text}")
        code, _, err = l3(
            "simulate", tmp_path / "scenes.toml", "--camera", bayer_recipe, "-o", tmp_path / "set.h5", "--force"
        )
        assert code == 0, err
        return tmp_path / "set.h5"

    return run


def test_no_patch_touches_a_marked_pixel(tmp_path: Path, simulated: Callable[[str], Path]) -> None:
    stored = np.rint(TRUTH * 10000).astype("<i2")
    stored[4, 6] = -9999
    written(tmp_path, stored, "data ignore value = -9999\nreflectance scale factor = 10000")
    path = simulated('source = "envi"\nfile = "scene.hdr"\nscale = 2.0\nflip = "cols"\n')
    with open_training_set(path) as reader:
        frame, head = reader.frame(0), reader.head
    assert isinstance(frame, TrainingFrame)
    assert frame.ignored is not None
    places = np.argwhere(frame.ignored.mask)
    assert places.min(axis=0).tolist() == [7, 33]  # samples 4 and 24 - 1 - 6 at 2 pixels each, and those beside them
    assert places.max(axis=0).tolist() == [10, 36]
    luminance = frame.target[1] / frame.white[1]
    assert luminance[7:11, 33:37].min() > 0.8  # not black
    # Each pixel's target says where it is: no patch's window reaches the marked ones.
    rows, cols = frame.raw.shape
    where = np.arange(rows * cols, dtype=np.float32).reshape(rows, cols)
    numbered = type(frame)(**{**vars(frame), "target": np.stack([where] * 3), "exposure": 1.0})
    side = 5
    window = np.zeros(side * side, np.int64)
    patches = sample_patches(numbered, head, 1.0, window, 4000, [np.arange(side * side)], np.random.default_rng(0))
    centres = np.unique(patches.target[:, 0].astype(int))
    free = np.zeros((rows, cols), bool)
    free[2:-2, 2:-2] = True
    free[7 - 2 : 10 + 3, 33 - 2 : 36 + 3] = False
    assert set(centres) <= set(np.flatnonzero(free))
    assert centres.size > 0.9 * free.sum()


def test_a_marked_pixel_counts_in_no_figure_of_evaluate(simulated: Callable[[str], Path], tmp_path: Path) -> None:
    stored = TRUTH.astype("<f4")
    stored[4:7, 6:9] = np.nan
    written(tmp_path, stored, "data ignore value = nan")
    with open_training_set(simulated('source = "envi"\nfile = "scene.hdr"\n')) as reader:
        frame, head = reader.frame(0), reader.head
    assert isinstance(frame, TrainingFrame)
    camera = head.camera
    table = random_table(camera.cfa.tolist(), bits=camera.bits, black_level=camera.black_level, patch=3)
    table = dataclasses.replace(table, channels=camera.channels)
    evaluation = Evaluation(table, head)
    planes = {name: frame.target.copy() for name in evaluation.pipelines}
    for each in planes.values():
        each[:, 4:7, 6:9] *= 5
    evaluation.add(frame, planes, np.zeros(frame.raw.shape, np.int64))
    document = evaluation.document()
    assert document["mean"]["ours"]["p95_delta_e"] < 1e-6
    assert document["mean"]["ours"]["psnr"] == pytest.approx(120)
    rows, cols = frame.raw.shape
    inside = (rows - 2 * document["border"]) * (cols - 2 * document["border"])
    assert sum(each["pixels"] for each in document["by_class"]["level"]) == inside - 9


def test_layers_learn_from_no_pixel_near_a_marked_one(simulated: Callable[[str], Path], tmp_path: Path) -> None:
    stored = TRUTH.astype("<f4")
    stored[4, 6] = np.nan
    written(tmp_path, stored, "data ignore value = nan")
    with open_training_set(simulated('source = "envi"\nfile = "scene.hdr"\n')) as reader:
        usable = _usable(reader.frame(0), 3)  # type: ignore[arg-type]
    expected = np.ones(PLAIN.shape, bool)
    expected[1:8, 3:10] = False
    assert usable is not None
    assert np.array_equal(usable[0], expected)
    zeros = np.zeros(PLAIN.shape)
    whole = Mosaics(1, zeros.astype(np.uint16), None, zeros[None].astype(np.float32))
    joined = Mosaics.joined([whole, Mosaics(1, whole.values, None, whole.target, usable[0])])
    assert joined.usable is not None
    assert joined.usable.sum() == 2 * PLAIN.size - 49


def test_a_table_is_learned_beside_marked_pixels(simulated: Callable[[str], Path], tmp_path: Path, l3: L3) -> None:
    stored = np.random.default_rng(0).random((48, 48, NM.size)).astype("<f4")
    stored[20:23, 20:24] = np.nan
    written(tmp_path, stored, "data ignore value = nan")
    path = simulated('source = "envi"\nfile = "scene.hdr"\n')
    (tmp_path / "few.toml").write_text(f"{FEW_CLASSES}[[layer]]\nside = 3\nmosaics = 4\nrows = 200\n")
    code, _, err = l3("train", path, "--classes", tmp_path / "few.toml", "-o", tmp_path / "table.h5")
    assert code == 0, err


def test_clips_do_not_move_marked_pixels(tmp_path: Path, refused: Refused, bayer_recipe: Path) -> None:
    stored = np.tile(TRUTH, (3, 3, 1)).astype("<f4")
    stored[4, 6] = np.nan
    written(tmp_path, stored, "data ignore value = nan")
    motion = "[scene.motion]\nframes = 2\nsize = [20, 20]\npan_pixels_per_frame = [0.0, 1.0]\n"
    (tmp_path / "scenes.toml").write_text(
        f'exposure_share = [0.9]\n[[scene]]\nsource = "envi"\nfile = "scene.hdr"\n{motion}'
    )
    arguments = ("--camera", bayer_recipe, "-o", tmp_path / "out.h5")
    assert "scene.hdr" in refused(3, "simulate", tmp_path / "scenes.toml", *arguments)


# -------------------------------------------------------------------------------------------------------------- TIFF

PAGES = np.ascontiguousarray(TRUTH.transpose(2, 0, 1))


@pytest.mark.parametrize("dtype", ["u1", "u2", "u4", "i2", "f4", "f8"])
@pytest.mark.parametrize("how", ["shaped", "bare", "deflate", "imagej", "ome", "planes"])
def test_pages_of_a_tiff_are_bands(tmp_path: Path, how: str, dtype: str) -> None:
    stored = PAGES.astype(dtype) if dtype[0] == "f" else np.rint(PAGES * 120).astype(dtype)
    if how == "imagej" and dtype not in ("u1", "u2", "f4"):
        return  # ImageJ knows no others
    ways: dict[str, dict[str, Any]] = {
        "shaped": {}, "bare": {"metadata": None}, "deflate": {"compression": "zlib"}, "imagej": {"imagej": True},
        "ome": {"ome": True, "metadata": {"axes": "CYX"}}, "planes": {"planarconfig": "separate"},
    }  # fmt: skip
    tifffile.imwrite(tmp_path / "a.tif", stored, photometric="minisblack", **ways[how])
    assert bands.size(tmp_path / "a.tif") == PLAIN.shape
    assert np.array_equal(bands.read(tmp_path / "a.tif").values, stored.transpose(1, 2, 0))


def test_frames_behind_the_only_page_are_bands(tmp_path: Path) -> None:
    """ImageJ and tifffile may store a stack as one page and the other frames behind it."""
    stored = np.rint(PAGES * 60000).astype("u2")
    tifffile.imwrite(tmp_path / "a.tif", stored, photometric="minisblack", truncate=True)
    assert len(tifffile.TiffFile(tmp_path / "a.tif").pages) == 1
    assert np.array_equal(bands.read(tmp_path / "a.tif").values, stored.transpose(1, 2, 0))


def test_pages_compressed_by_other_programs_are_bands(tmp_path: Path) -> None:
    import OpenImageIO as oiio

    stored = np.rint(PAGES * 60000).astype("u2")
    spec = oiio.ImageSpec(24, 20, 1, "uint16")
    spec.attribute("compression", "lzw")
    sink = oiio.ImageOutput.create(str(tmp_path / "a.tif"))
    assert sink is not None
    for number, page in enumerate(stored):
        assert sink.open(str(tmp_path / "a.tif"), spec, "AppendSubimage" if number else "Create")
        assert sink.write_image(page[..., None])
    sink.close()
    assert np.array_equal(bands.read(tmp_path / "a.tif").values, stored.transpose(1, 2, 0))


def labelled(path: Path, how: str) -> None:
    """Write a TIFF that states its wavelengths in one of the ways of other programs."""
    names = [f"{nm:g} nm" for nm in NM]
    stored = PAGES.astype("f4")
    if how == "ImageJ":
        tifffile.imwrite(path, stored, imagej=True, metadata={"Labels": names})
    elif how == "OME":
        tifffile.imwrite(
            path, stored, ome=True, photometric="minisblack", metadata={"axes": "CYX", "Channel": {"Name": names}}
        )
    elif how == "tifffile":
        tifffile.imwrite(path, stored, photometric="minisblack", metadata={"wavelengths": NM.tolist()})
    elif how == "GDAL":
        items = "".join(
            f'<Item name="DESCRIPTION" sample="{band}" role="description">{name}</Item>' for band, name in enumerate(names)
        )
        tags = [(42112, 2, 0, f"<GDALMetadata>{items}</GDALMetadata>", True)]
        tifffile.imwrite(path, TRUTH.astype("f4"), photometric="minisblack", planarconfig="contig", extratags=tags)
    else:
        with tifffile.TiffWriter(path) as sink:
            for name, page in zip(names, stored, strict=True):
                tags = [(285, 2, 0, name, True)] if how == "page names" else []
                about = name if how == "descriptions" else None
                sink.write(page, photometric="minisblack", metadata=None, extratags=tags, description=about)


@pytest.mark.parametrize("how", ["ImageJ", "OME", "tifffile", "GDAL", "page names", "descriptions"])
def test_pages_state_their_wavelengths(tmp_path: Path, how: str) -> None:
    labelled(tmp_path / "a.tif", how)
    found = scene(bands.read(tmp_path / "a.tif"))
    assert np.array_equal(found.wavelength, NM)
    assert np.allclose(found.reflectance, TRUTH, atol=1e-6)


def test_gdal_states_scale_wavelength_and_missing_data(tmp_path: Path) -> None:
    stored = np.rint(10000 * TRUTH).astype("i2")
    stored[3, 4] = -9999
    items = "".join(
        f'<Item name="SCALE" sample="{band}" role="scale">0.0001</Item>'
        f'<Item name="CENTRAL_WAVELENGTH_UM" sample="{band}">{nm / 1000:.4g}</Item>'
        for band, nm in enumerate(NM)
    )
    tags = [(42112, 2, 0, f"<GDALMetadata>{items}</GDALMetadata>", True), (42113, 2, 0, "-9999", True)]
    tifffile.imwrite(tmp_path / "a.tif", stored, photometric="minisblack", planarconfig="contig", extratags=tags)
    found = scene(bands.read(tmp_path / "a.tif"))
    assert np.allclose(found.wavelength, NM)
    assert found.ignored is not None
    assert np.argwhere(found.ignored).tolist() == [[3, 4]]
    assert np.allclose(found.reflectance, TRUTH, atol=1e-4)


def test_a_tiff_of_several_axes_is_refused(tmp_path: Path) -> None:
    stored = np.zeros((3, 4, 20, 24), "u2")
    tifffile.imwrite(tmp_path / "a.tif", stored, imagej=True, metadata={"axes": "ZCYX"})
    with pytest.raises(InputFileError, match="3×4×20×24"):
        bands.read(tmp_path / "a.tif")


# ----------------------------------------------------------------------------------------------- folders and channels


@pytest.mark.parametrize("form", ["{}nm", "face_{}nm", "face_{}.0nm_left", "{}", "img_{}", "b{}_nm"])
def test_files_of_a_folder_state_wavelengths(tmp_path: Path, form: str) -> None:
    folder = tmp_path / "scene"
    folder.mkdir()
    for index in range(0, NM.size, 6):
        tifffile.imwrite(folder / f"{form.format(int(NM[index]))}.tif", PAGES[index].astype("f4"))
    if "nm" in form:
        tifffile.imwrite(folder / "preview.tif", PAGES[0].astype("f4"))
    found = scene(bands.read(folder))
    assert np.array_equal(found.wavelength, NM[::6])
    assert np.allclose(found.reflectance, TRUTH[..., ::6], atol=1e-6)


@pytest.mark.parametrize("first", [1, 400])
def test_numbers_that_count_are_no_wavelengths(tmp_path: Path, first: int) -> None:
    folder = tmp_path / "scene"
    folder.mkdir()
    for index in range(5):
        tifffile.imwrite(folder / f"img_{first + index}.tif", PAGES[index].astype("f4"))
    assert bands.read(folder).wavelength is None


@pytest.mark.parametrize("form", ["S0.{:g}nm", "T.{:g}nm", "S0.{:g},5nm"])
def test_channels_of_exr_state_wavelengths(tmp_path: Path, form: str) -> None:
    from l3cli.io.pictures.registry import write_picture

    write_picture(tmp_path / "a.exr", TRUTH.astype(np.float32), tuple(form.format(nm) for nm in NM))
    wavelength = bands.read(tmp_path / "a.exr").wavelength
    assert wavelength is not None
    assert np.allclose(wavelength, NM + (0.5 if ",5" in form else 0.0))


# ---------------------------------------------------------------------------------------- HDF5, netCDF and MATLAB


def hdf5(path: Path, how: str) -> None:
    import h5py

    with h5py.File(path, "w") as root:
        root["a/b/cube"] = TRUTH
        if how == "attribute of the cube":
            root["a/b/cube"].attrs["wavelengths"] = NM
        elif how == "attribute of a group":
            root["a"].attrs["Wavelength"] = NM
        elif how == "attribute of the file":
            root.attrs["wavelength_nm"] = NM
        elif how == "beside":
            root["a/b/wavelength"], root["a/wavelength"] = NM, NM + 99
        elif how == "in another group":
            root["c/Spectral_Data/Wavelength"] = NM
            root["c/Spectral_Data/FWHM"] = np.full(NM.size, 5.0)
        elif how == "in micrometres":
            root["a/wavelengths"] = NM / 1000
            root["a/wavelengths"].attrs["Units"] = "micrometers"
        elif how == "unit in the name":
            root["a/wavelength_um"] = NM / 1000
        elif how == "column":
            root["a/lambda"] = NM[:, None]
        elif how == "name of a dimension scale":
            root["a/band"], root["a/b/count"] = NM / 1000, np.arange(NM.size)
            root["a/band"].attrs["units"] = "um"
            root["a/band"].make_scale("wavelength")
            root["a/b/cube"].dims[2].attach_scale(root["a/band"])
        elif how == "standard name":
            root["a/spectral"] = NM * 10
            root["a/spectral"].attrs["standard_name"], root["a/spectral"].attrs["units"] = "radiation_wavelength", "angstrom"


HOW = [
    "attribute of the cube", "attribute of a group", "attribute of the file", "beside", "in another group",
    "in micrometres", "unit in the name", "column", "name of a dimension scale", "standard name",
]  # fmt: skip


@pytest.mark.parametrize("how", HOW)
def test_hdf5_states_wavelengths(tmp_path: Path, how: str) -> None:
    hdf5(tmp_path / "a.h5", how)
    found = scene(cube.read(tmp_path / "a.h5", None, "row col band"))
    assert np.allclose(found.wavelength, NM)
    assert np.allclose(found.reflectance, TRUTH, atol=1e-6)


@pytest.mark.parametrize(("name", "source"), [("a.tif", "channels"), ("a.exr", "channels"), ("a.hdr", "envi")])
def test_a_file_of_another_source_names_that_source(tmp_path: Path, name: str, source: str) -> None:
    (tmp_path / name).write_bytes(b"II*\0")
    for function in (cube.read, cube.size):
        with pytest.raises(InputFileError, match=f'source = "{source}"'):
            function(tmp_path / name, None, "row col band")


@pytest.mark.parametrize("kind", ["ENVI  Standard", "envi\tstandard ", "ENVI"])
def test_blanks_in_the_file_type_do_not_count(tmp_path: Path, kind: str) -> None:
    path = written(tmp_path, TRUTH.astype("<f4"), f"file type = {kind}", drop="file type")
    assert np.allclose(envi_scene(path).reflectance, TRUTH, atol=1e-6)


def test_two_lists_of_wavelengths_are_a_question(tmp_path: Path) -> None:
    import h5py

    hdf5(tmp_path / "a.h5", "in another group")
    with h5py.File(tmp_path / "a.h5", "a") as root:
        root["d/wavelength"] = NM + 5
    with pytest.raises(InputFileError, match="wavelengths_nm"):
        cube.read(tmp_path / "a.h5", None, "row col band")


@pytest.mark.parametrize(
    ("stored", "attributes"),
    [
        (10000 * TRUTH, {"scale_factor": 1e-4, "_FillValue": np.int16(-9999)}),
        (10000 * TRUTH + 500, {"scale_factor": [1e-4], "add_offset": [-0.05], "missing_value": [-9999]}),
        (10000 * TRUTH, {"Scale_Factor": 10000.0, "Data_Ignore_Value": -9999.0}),
    ],
)
def test_attributes_scale_and_mark(tmp_path: Path, stored: np.ndarray, attributes: dict[str, Any]) -> None:
    import h5py

    stored = np.rint(stored).astype("i2")
    stored[3, 4] = -9999
    with h5py.File(tmp_path / "a.nc", "w") as root:
        root["reflectance"], root["wavelength"] = stored, NM
        root["reflectance"].attrs.update(attributes)
        root["good_wavelengths"] = (NM != 500).astype(float)
    found = scene(cube.read(tmp_path / "a.nc", None, "row col band"))
    assert found.ignored is not None
    assert np.argwhere(found.ignored).tolist() == [[3, 4]]
    assert 500 not in found.wavelength
    assert np.allclose(found.reflectance, TRUTH[..., NM != 500], atol=2e-4)


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_structs_of_matlab_state_wavelengths(tmp_path: Path, version: str) -> None:
    import h5py
    from scipy.io import savemat

    if version == "5":
        savemat(tmp_path / "a.MAT", {"hsi": {"data": {"cube": TRUTH}, "info": {"Wavelengths": NM[:, None]}}, "n": 3})
    else:
        with h5py.File(tmp_path / "a.MAT", "w", userblock_size=512) as root:
            root["hsi/data/cube"], root["hsi/info/Wavelengths"] = TRUTH.T, NM[None]
        with open(tmp_path / "a.MAT", "r+b") as stream:
            stream.write(b"MATLAB 7.3 MAT-file")
    found = scene(cube.read(tmp_path / "a.MAT", "hsi.data.cube", "row col band"))
    assert np.array_equal(found.wavelength, NM)
    assert np.allclose(found.reflectance, TRUTH, atol=1e-6)


# ------------------------------------------------------------------------------------------------------- the commands


def make_large(path: Path) -> None:
    """Write zeros, as data may begin, more than a text may be."""
    path.write_bytes(b"")
    os.truncate(path, 1 << 27)


@pytest.mark.parametrize(
    ("spoil", "cure"),
    [
        (lambda folder: (folder / "scene.img").unlink(), "beside the header"),
        (lambda folder: (folder / "scene.img").write_bytes(b"x"), "use the whole file"),
        (lambda folder: (folder / "scene.hdr").write_text("#?RADIANCE"), "give the .hdr file"),
        (lambda folder: make_large(folder / "scene.hdr"), "give the .hdr file"),
        (lambda folder: written(folder, TRUTH.astype("<f4"), drop="lines"), "use a complete ENVI header"),
    ],
)
def test_a_readers_own_fix_is_what_is_said(
    tmp_path: Path, refused: Refused, bayer_recipe: Path, spoil: Callable[[Path], Any], cure: str
) -> None:
    written(tmp_path, TRUTH.astype("<f4"))
    spoil(tmp_path)
    (tmp_path / "scenes.toml").write_text('exposure_share = [0.9]\n[[scene]]\nsource = "envi"\nfile = "scene.hdr"\n')
    line = refused(3, "simulate", tmp_path / "scenes.toml", "--camera", bayer_recipe, "-o", tmp_path / "out.h5")
    assert cure in line
    assert "shrink" not in line


def test_cubes_without_visible_light_are_refused(tmp_path: Path, refused: Refused, bayer_recipe: Path) -> None:
    written(tmp_path, TRUTH.astype("<f4"), nm=NM + 600)
    (tmp_path / "scenes.toml").write_text('exposure_share = [0.9]\n[[scene]]\nsource = "envi"\nfile = "scene.hdr"\n')
    line = refused(3, "simulate", tmp_path / "scenes.toml", "--camera", bayer_recipe, "-o", tmp_path / "out.h5")
    assert "1000…1300 nm" in line
