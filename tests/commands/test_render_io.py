"""Files of `l3 render`: raw inputs, picture outputs, and one clear line for each error."""

import dataclasses
import time
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from l3cli.api import Renderer
from l3cli.artifacts.store import save
from l3cli.frames.frame import RawFrame
from l3cli.io.images import read_image
from l3cli.io.pictures.registry import write_picture
from l3cli.io.raw.files import RawOverrides, read_raw
from l3cli.io.tags import LIBRAW_FLIP
from l3cli.physics import spectra
from l3cli.physics.display import SRGB_FROM_XYZ, adaptation_matrix, scene_white
from l3cli.rendering.display import make_display
from l3cli.rendering.reference import ReferenceRenderer
from l3cli.system.files import sha256
from tests.helpers.calls import L3, Refused
from tests.helpers.cameras import BAYER
from tests.helpers.tables import XYZ, random_table

RGGB = dataclasses.replace(random_table(BAYER, bits=14, black_level=512.0), camera_name="RGGB")


@pytest.fixture
def mosaic() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 2**14, (RGGB.rows, RGGB.cols)).astype(np.uint16)


@pytest.fixture
def table(tmp_path: Path) -> Path:
    save(RGGB, tmp_path / "table.h5")
    return tmp_path / "table.h5"


@pytest.fixture
def raw(tmp_path: Path, mosaic: np.ndarray) -> Path:
    np.save(tmp_path / "frame.npy", mosaic)
    return tmp_path / "frame.npy"


# ------------------------------------------------------------------------------------------------------ raw files


def write_mono(path: Path, values: np.ndarray, kind: str = "uint16", **attributes: int) -> Path:
    spec = oiio.ImageSpec(values.shape[1], values.shape[0], 1, kind)
    for key, value in attributes.items():
        spec.attribute(key.replace("__", ":"), value)
    sink = oiio.ImageOutput.create(str(path))
    assert sink is not None
    assert sink.open(str(path), spec)
    assert sink.write_image(values[..., None])
    sink.close()
    return path


def test_plain_files_hold_the_same_frame(tmp_path: Path, mosaic: np.ndarray, raw: Path) -> None:
    mosaic.astype("<u2").tofile(tmp_path / "a.raw")
    mosaic.astype("<u2").tofile(tmp_path / "a.bin")
    paths = [raw, tmp_path / "a.raw", tmp_path / "a.bin"]
    paths += [write_mono(tmp_path / name, mosaic) for name in ("a.tif", "a.png")]
    for path in paths:
        frame = read_raw(path, RGGB)
        np.testing.assert_array_equal(frame.values, mosaic)
        assert (frame.black_level, frame.white_level, frame.phase) == (RGGB.black_level, RGGB.white_level, (0, 0))


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_pictures_of_mosaics_state_how_the_camera_was_held(tmp_path: Path, mosaic: np.ndarray, orientation: int) -> None:
    path = write_mono(tmp_path / "a.tif", mosaic, Orientation=orientation)
    frame = read_raw(path, RGGB)
    np.testing.assert_array_equal(frame.values, mosaic)
    assert frame.orientation == LIBRAW_FLIP[orientation]


def test_narrow_files_keep_their_values(tmp_path: Path, mosaic: np.ndarray) -> None:
    eight = (mosaic >> 6).astype(np.uint8)
    np.save(tmp_path / "a.npy", eight)
    np.save(tmp_path / "big.npy", mosaic.astype(">u2"))
    np.testing.assert_array_equal(read_raw(tmp_path / "a.npy", RGGB).values, eight)
    np.testing.assert_array_equal(read_raw(tmp_path / "big.npy", RGGB).values, mosaic)
    np.testing.assert_array_equal(read_raw(write_mono(tmp_path / "a.png", eight, "uint8"), RGGB).values, eight)
    twelve = write_mono(tmp_path / "a.tif", (mosaic & 0xFFF) << 4 | (mosaic & 0xFFF) >> 8, oiio__BitsPerSample=12)
    np.testing.assert_array_equal(read_raw(twelve, RGGB).values, mosaic & 0xFFF)


def test_a_picture_is_not_taken_for_a_stack_of_narrow_frames(
    refused: Refused, tmp_path: Path, table: Path, mosaic: np.ndarray
) -> None:
    for channels in (1, 3):
        np.save(tmp_path / "a.npy", np.dstack([mosaic] * channels))
        assert "a.npy" in refused(3, "render", table, tmp_path / "a.npy", "-o", tmp_path / "out")


def test_what_the_caller_knows_better_wins(tmp_path: Path, mosaic: np.ndarray) -> None:
    mosaic[:10, :6].tofile(tmp_path / "a.raw")
    frame = read_raw(tmp_path / "a.raw", RGGB, RawOverrides(black_level=7.0, white_level=99.0, phase=(1, 3), size=(10, 6)))
    assert (frame.values.shape, frame.black_level, frame.white_level, frame.phase) == ((10, 6), 7.0, 99.0, (1, 1))


# --------------------------------------------------------------------------------------------------------- l3 render


def expected_picture(mosaic: np.ndarray, white: str, scale: float, bits: int) -> np.ndarray:
    frame = RawFrame("f", mosaic, RGGB.black_level, RGGB.white_level)
    return ReferenceRenderer(RGGB).picture(frame, make_display(scene_white(white), scale, bits))


@pytest.mark.parametrize("backend", ["opencl", "reference"])
@pytest.mark.parametrize("bits", [8, 16])
def test_render_writes_the_picture_of_the_reference(
    l3: L3, tmp_path: Path, table: Path, raw: Path, mosaic: np.ndarray, backend: str, bits: int
) -> None:
    output = tmp_path / "new" / "a.png"
    arguments = ("--backend", backend, "--bits", bits, "--exposure", 0.8, "--white", "A", "--quiet")
    assert l3("render", table, raw, "-o", output, *arguments) == (0, "", "")
    pixels, _ = read_image(output)
    truth = expected_picture(mosaic, "A", 0.8, bits)
    assert np.abs(pixels.astype(int) - truth).max() <= (1 if bits == 8 else 2)


def test_automatic_exposure_shows_one_percent_white(l3: L3, tmp_path: Path, table: Path, raw: Path) -> None:
    assert l3("render", table, raw, "-o", tmp_path / "a.png")[0] == 0
    assert l3("render", table, raw, "-o", tmp_path / "a.exr")[0] == 0
    planes, names = read_image(tmp_path / "a.exr")
    assert names == XYZ
    frame = RawFrame("f", np.load(raw), RGGB.black_level, RGGB.white_level)
    exact = np.moveaxis(ReferenceRenderer(RGGB).exact_outputs(frame), 0, -1)
    np.testing.assert_allclose(planes, exact, atol=1e-5)
    display = make_display(RGGB.white_point, 1 / np.percentile(exact[..., 1], 99), 8)
    truth = ReferenceRenderer(RGGB).picture(frame, display).astype(int)
    assert np.abs(read_image(tmp_path / "a.png")[0] - truth).max() <= 1


def test_the_same_input_gives_the_same_bytes(l3: L3, tmp_path: Path, table: Path, raw: Path) -> None:
    suffixes = ("png", "tif", "jpg", "jxl", "exr", "dng")
    for name in ("a", "b"):
        for suffix in suffixes:
            assert l3("render", table, raw, "-o", tmp_path / f"{name}.{suffix}")[0] == 0
        time.sleep(1.1)  # whatever writes the clock into a file writes another second
    for suffix in suffixes:
        assert sha256(tmp_path / f"a.{suffix}") == sha256(tmp_path / f"b.{suffix}")


def test_several_inputs_fill_a_folder_and_failures_can_be_left_out(
    l3: L3, tmp_path: Path, table: Path, raw: Path, mosaic: np.ndarray
) -> None:
    np.save(tmp_path / "second.npy", mosaic[:9, :11])
    (tmp_path / "broken.npy").write_bytes(b"nothing")
    inputs = (raw, tmp_path / "broken.npy", tmp_path / "second.npy")
    code, out, err = l3("render", table, *inputs, "-o", tmp_path / "out", "--format", "tif", "--skip-bad", "--quiet")
    assert (code, out, err.count("\n")) == (1, "", 2)
    assert "broken.npy" in err
    assert "1 of 3 frames" in err
    assert sorted(path.name for path in (tmp_path / "out").glob("[!.]*")) == ["frame.tif", "second.tif"]
    assert read_image(tmp_path / "out/second.tif")[0].shape == (9, 11, 3)


def test_picture_is_turned_upright(
    l3: L3, tmp_path: Path, table: Path, mosaic: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    frame = RawFrame("f", mosaic[:6, :10], RGGB.black_level, RGGB.white_level, orientation=6)
    monkeypatch.setattr("l3cli.io.sequences.read_raw", lambda *_: frame)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "frame.dng").touch()
    for name in ("a.png", "a.exr"):
        assert l3("render", table, "frame.dng", "-o", tmp_path / name)[0] == 0
        assert read_image(tmp_path / name)[0].shape == (10, 6, 3)


def test_existing_outputs_are_refused_before_any_work(refused: Refused, tmp_path: Path, table: Path, raw: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"mine")
    assert "a.png" in refused(1, "render", "missing.h5", raw, "-o", tmp_path / "a.png")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "frame.png").write_bytes(b"mine")
    assert "frame.png" in refused(1, "render", table, raw, tmp_path / "b.npy", "-o", tmp_path / "out")
    assert "new.png" in refused(2, "render", table, raw, tmp_path / "b.npy", "-o", tmp_path / "new.png")
    assert (tmp_path / "a.png").read_bytes() == b"mine"


def test_values_above_the_converter_in_later_frames_are_reported_once(
    l3: L3, tmp_path: Path, table: Path, mosaic: np.ndarray
) -> None:
    frames = np.stack([mosaic] * 4)
    frames[2:, 0, 0] = 65535
    np.save(tmp_path / "clip.npy", frames)
    code, _, err = l3("render", table, tmp_path / "clip.npy", "-o", tmp_path / "out", "--backend", "reference")
    assert code == 0
    (line,) = (line for line in err.splitlines() if "16383 DN" in line)
    assert "frame 2 and 1 other frame: some values exceed 16383 DN, the maximum for the table's 14 bits" in line
    with pytest.warns(UserWarning, match="the array: some values exceed 16383 DN"):
        Renderer(RGGB, backend="reference").picture(frames[2])


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("-o", "a.jpg", "--bits", 16), "a.jpg"),
        (("-o", "a.exr", "--exposure", 2), "--exposure"),
        (("-o", "a.png", "--exposure", "+1"), "--exposure"),
        (("-o", "a.png", "--exposure", "-1"), "--exposure"),
        (("-o", "a.png", "--exposure", "30EV"), "--exposure"),
        (("-o", "a.exr", "--exposure", "+1EV"), "--exposure"),
        (("-o", "a.png", "--white", "0.5;0.2"), "0.5;0.2"),
        (("-o", "a.png", "--size", "3x-4"), "--size"),
    ],
)
def test_wrong_calls_are_refused(
    refused: Refused,
    table: Path,
    raw: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[int | str, ...],
    word: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert word in refused(2, "render", table, raw, *arguments)


def test_equal_names_are_refused(refused: Refused, table: Path, raw: Path, tmp_path: Path) -> None:
    refused(2, "render", table, raw, Path("elsewhere/frame.raw"), "-o", tmp_path / "out")


def test_pictures_of_other_outputs_are_refused_but_exr_is_written(
    l3: L3, refused: Refused, tmp_path: Path, raw: Path
) -> None:
    save(random_table(BAYER, bits=14, outputs=("nir", "leaf")), tmp_path / "bands.h5")
    assert "nir, leaf" in refused(2, "render", tmp_path / "bands.h5", raw, "-o", tmp_path / "a.png")
    assert l3("render", tmp_path / "bands.h5", raw, "-o", tmp_path / "a.exr")[0] == 0
    assert set(read_image(tmp_path / "a.exr")[1]) == {"nir", "leaf"}


def test_broken_inputs_are_refused_in_one_line(
    refused: Refused, tmp_path: Path, table: Path, mosaic: np.ndarray, raw: Path
) -> None:
    output = tmp_path / "out.png"
    whole = write_mono(tmp_path / "whole.png", mosaic).read_bytes()
    files = {
        "short.raw": (b"\0" * 10, "--size"),
        "text.dng": (b"not a raw file", "not a DNG file"),
        "text.tif": (b"not an image", "not a picture"),
        "text.npy": (b"not an array", "numpy.save"),
        "cut.npy": (raw.read_bytes()[:500], "numpy.save"),
        "empty.npy": (b"", "numpy.save"),
        "cut.png": (whole[: len(whole) // 2], "cut.png"),
    }
    arrays = {
        "float.npy": (mosaic / 2, "not DN"),
        "cube.npy": (mosaic[None, None], "(row, col)"),
        "object.npy": (np.array([[None]]), "numpy.save"),
        "none.npy": (mosaic[:0], "no pixels"),
    }
    for name, (content, _) in files.items():
        (tmp_path / name).write_bytes(content)
    for name, (array, _) in arrays.items():
        np.save(tmp_path / name, array, allow_pickle=True)
    inputs = {name: words for name, (_, words) in (files | arrays).items()}
    inputs |= {"archive.npy": "archive", "float.tif": "not DN", "rgb.png": "3 channels"}
    inputs |= {"folder.dng": "folder", "missing.dng": "does not exist"}
    np.savez(tmp_path / "archive.npz", mosaic)
    (tmp_path / "archive.npz").rename(tmp_path / "archive.npy")
    write_mono(tmp_path / "float.tif", mosaic.astype(np.float32) / 3, "float")
    write_picture(tmp_path / "rgb.png", np.zeros((4, 4, 3), np.uint8))
    (tmp_path / "folder.dng").mkdir()
    for name, word in inputs.items():
        line = refused(3, "render", table, tmp_path / name, "-o", output)
        assert name in line
        assert word in line
    assert "--white-level" in refused(3, "render", table, raw, "-o", output, "--black-level", 20000)
    assert raw.name in refused(3, "render", raw, raw, "-o", output)


def test_matrices_and_adaptation_are_those_of_colour_science() -> None:
    """Whose very numbers are rendered by, without it (test_start)."""
    colour = spectra.colour_science()
    np.testing.assert_array_equal(SRGB_FROM_XYZ, colour.RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB)
    a, d65 = spectra.white_point("A"), spectra.white_point("D65")
    theirs = colour.adaptation.matrix_chromatic_adaptation_VonKries(a, d65, transform="Bradford")
    np.testing.assert_allclose(adaptation_matrix(3 * a, d65), theirs, atol=1e-12)


# ------------------------------------------------------------------------------------------------------- real files


def test_real_raws_keep_size_levels_and_phase(l3: L3, l3_data: Path, tmp_path: Path, table: Path) -> None:
    facts = {"colorchart.dng": ((1156, 1734), 2056, 15000, (0, 0)), "kodak_dc50.kdc": ((512, 768), 0, 16383, (0, 1))}
    for name, (shape, black_level, white_level, phase) in facts.items():
        frame = read_raw(l3_data / "raw" / name, RGGB)
        assert (frame.values.shape, frame.black_level, frame.white_level, frame.phase) == (
            shape,
            black_level,
            white_level,
            phase,
        )
        assert frame.orientation == 0
        output = tmp_path / name.replace(name[-3:], "png")
        assert l3("render", table, l3_data / "raw" / name, "-o", output)[0] == 0
        assert read_image(output)[0].shape == (*shape, 3)


def test_real_headerless_raw(l3: L3, l3_data: Path, tmp_path: Path, table: Path) -> None:
    source = l3_data / "raw" / "openisp_test_1920x1080_10bit_u16le_RGGB.raw"
    options = ("--size", "1080x1920", "--black-level", 0, "--white-level", 1020)
    assert l3("render", table, source, "-o", tmp_path / "a.jpg", *options)[0] == 0
    assert read_image(tmp_path / "a.jpg")[0].shape == (1080, 1920, 3)


def test_device_and_variant_are_chosen_for_one_run(l3: L3, refused: Refused, tmp_path: Path, table: Path, raw: Path) -> None:
    for variant in ("processor", "graphics"):
        output = tmp_path / f"{variant}.png"
        assert l3("render", table, raw, "-o", output, "--device", 0, "--variant", variant)[0] == 0
    one, other = (read_image(tmp_path / f"{variant}.png")[0] for variant in ("processor", "graphics"))
    assert np.abs(one.astype(int) - other).max() <= 1
    assert "no such device" in refused(4, "render", table, raw, "-o", tmp_path / "a.png", "--device", "no such device")
    wrong = ("render", table, raw, "-o", tmp_path / "a.png", "--backend", "reference", "--variant", "graphics")
    assert "--variant" in refused(2, *wrong)
