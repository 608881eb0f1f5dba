"""Raw formats: packed dumps, graymaps and FITS files."""

import dataclasses
import re
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from astropy.io import fits
from hypothesis import given
from hypothesis import strategies as st

from l3cli.errors import InputFileError, RecipeError
from l3cli.frames.frame import RawFrame
from l3cli.frames.packings import PACKINGS
from l3cli.frames.raw_sanity import smoother_reading
from l3cli.io.frames import read_frame
from l3cli.io.images import read_image
from l3cli.io.raw.files import RawOverrides, read_raw
from l3cli.io.raw.fits import INSTALL
from l3cli.io.raw.headerless import content_of, make_layout
from l3cli.io.sequences import find_frames
from l3cli.physics.mosaic import shifted_cfa
from tests.helpers.calls import L3, Refused
from tests.helpers.cameras import FIVE_BAND
from tests.helpers.raw_files import RGGB
from tests.helpers.tables import random_table

# ------------------------------------------------------------------------------------------------------ packed dumps


def packed_bits(values: list[int], packing: str) -> str:
    """The bits of pixels in the order in which a stream fills bytes: of "p" each byte from its lowest bit on, else from its
    highest."""
    bits = int(re.findall(r"\d+", packing)[-1])
    written = [f"{value:0{bits}b}" for value in values]
    return "".join(each[::-1] if packing.endswith("p") else each for each in written)


def pack_line(values: list[int], packing: str) -> bytes:
    """Pixels that follow one another, by the descriptions of MIPI CSI-2, PFNC and GigE Vision."""
    if packing.endswith(("p", "pmsb")):
        stream = packed_bits(values, packing)
        parts = [stream[start : start + 8].ljust(8, "0") for start in range(0, len(stream), 8)]
        return bytes(int(part[::-1] if packing.endswith("p") else part, 2) for part in parts)
    if packing.startswith("raw") or packing.endswith("Packed"):
        bits, pixels = (10, 4) if packing == "raw10" else (12 if "12" in packing else 10, 2)
        low, line = bits - 8, b""
        for start in range(0, len(values), pixels):
            group = [*values[start : start + pixels], *[0] * pixels][:pixels]
            apart = low if packing.startswith("raw") else 4
            lower = sum((value & (2**low - 1)) << apart * place for place, value in enumerate(group))
            upper = [value >> low for value in group]
            line += bytes([*upper, lower] if packing.startswith("raw") else [upper[0], lower, upper[1]])
        return line if packing.startswith("raw") else line[: -(-len(values) * 12 // 8)]
    return np.array(values, "u1" if packing.endswith("8") else "<u2").tobytes()


def pack(values: np.ndarray, packing: str, stride: int | None = None) -> bytes:
    """A frame, its rows padded to `stride` bytes."""
    if PACKINGS[packing].cells:  # 0°, 45°, 90° and 135° of a cell whose rows are 90 45 and 135 0
        cells = [values[1::2, 1::2], values[::2, 1::2], values[::2, ::2], values[1::2, ::2]]
        values = np.stack(cells, axis=-1).reshape(len(values) // 2, -1)
    return b"".join(pack_line(row, packing).ljust(stride or 0, b"\xa5") for row in values.tolist())


def random_frame(packing: str, shape: tuple[int, ...], seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 2 ** PACKINGS[packing].bits, shape).astype(np.uint16)


@given(
    packing=st.sampled_from(sorted(PACKINGS)), rows=st.integers(1, 5), cols=st.integers(1, 23), padding=st.integers(0, 9),
    seed=st.integers(0, 2**32),
)  # fmt: skip
def test_packed_values_come_back(packing: str, rows: int, cols: int, padding: int, seed: int) -> None:
    if PACKINGS[packing].cells:
        rows, cols = 2 * rows, 2 * cols
    values = random_frame(packing, (rows, cols), seed)
    stride = PACKINGS[packing].bytes_of(2 * cols if PACKINGS[packing].cells else cols) + padding
    layout = make_layout((rows, cols), packing, stride)
    content = pack(values, packing, stride)
    assert len(content) == layout.frame_bytes
    np.testing.assert_array_equal(layout.unpack(content), values)


@given(packing=st.sampled_from(["Mono10p", "Mono12p", "Mono12Packed", "Mono14pmsb"]), cols=st.integers(1, 9))
def test_rows_of_a_stream_of_bits_follow_without_a_gap(packing: str, cols: int) -> None:
    values = random_frame(packing, (3, cols), cols)
    content = pack(values.reshape(1, -1), packing)
    layout = make_layout((3, cols), packing)
    assert len(content) == layout.frame_bytes
    np.testing.assert_array_equal(layout.unpack(content), values)


def test_the_bytes_of_the_standards() -> None:
    """MIPI CSI-2, the figures of RAW10 and RAW12: P1…P4 upper bits, then all lower bits, P1 in the lowest. PFNC: Mono12p
    from the lowest bit on. GigE Vision: the lower bits of both pixels in the middle byte."""
    ten = make_layout((1, 4), "raw10").unpack(bytes([0x12, 0x34, 0x56, 0x78, 0b11_10_01_00]))
    assert ten.tolist() == [[0x12 << 2, 0x34 << 2 | 1, 0x56 << 2 | 2, 0x78 << 2 | 3]]
    twelve = {"raw12": [0xAB, 0x12, 0x3C], "Mono12p": [0xBC, 0x3A, 0x12], "mono12packed": [0xAB, 0x3C, 0x12]}
    twelve |= {"BayerRG12pmsb": [0xAB, 0xC1, 0x23], "12p": twelve["Mono12p"]}
    for name, stored in twelve.items():
        assert make_layout((1, 2), name).unpack(bytes(stored)).tolist() == [[0xABC, 0x123]]
    assert make_layout((1, 2), "Mono10Packed").unpack(bytes([0xAB, 0x21, 0xCD])).tolist() == [[0xAB << 2 | 1, 0xCD << 2 | 2]]
    assert make_layout((1, 2), "Mono16", byte_order="big").unpack(bytes([1, 2, 3, 4])).tolist() == [[0x102, 0x304]]


def test_frames_of_polarisation_cameras(tmp_path: Path) -> None:
    """PolarizedAngles names: the four angles of a cell follow one another, the lower bits of the first value first."""
    values = np.array([[0x900, 0x450], [0x135, 0x00A]], np.uint16)
    stored = [0x0A, 0x00, 0x45, 0x00, 0x59, 0x13]
    angles = "PolarizedAngles_0d_45d_90d_135d_Mono12p"
    np.testing.assert_array_equal(make_layout((2, 2), angles).unpack(bytes(stored)), values)
    for name, usual in (("PolarizeMono12Packed", "Mono12Packed"), ("BayerRGPolarized10p", "Mono10p"), ("Polarized8", "u8")):
        assert make_layout((4, 6), name).packing.pieces == PACKINGS[usual].pieces
    two = random_frame("Mono12", (2, 32, 40), 8)
    (tmp_path / "a.raw").write_bytes(b"".join(pack(frame, angles) for frame in two))
    frames = all_frames(tmp_path / "a.raw", RawOverrides(size=(32, 40), packing=angles))
    np.testing.assert_array_equal([frame.values for frame in frames if frame], two)
    for size, name in (((3, 4), angles), ((4, 4), "PolarizedStokes_S0_S1_S2_Mono8"), ((4, 4), "PolarizedDolpAolp_BayerRG8")):
        with pytest.raises(RecipeError, match=name):
            make_layout(size, name)


@pytest.mark.parametrize(("order", "phase"), [("RG", (0, 0)), ("GR", (0, 1)), ("GB", (1, 0)), ("BG", (1, 1))])
def test_a_bayer_name_says_where_the_array_begins(tmp_path: Path, order: str, phase: tuple[int, int]) -> None:
    values = random_frame("Mono12p", (10, 12), 3)
    (tmp_path / "a.raw").write_bytes(b"header" + pack(values, "Mono12p"))
    frame = read_raw(tmp_path / "a.raw", RGGB, RawOverrides(size=(10, 12), packing=f"Bayer{order}12p", skip=6))
    np.testing.assert_array_equal(frame.values, values)
    assert frame.phase == phase
    assert frame.notes == ()
    whole = random_frame("Mono12p", (RGGB.rows, RGGB.cols), 3)
    (tmp_path / "whole.raw").write_bytes(pack(whole, "Mono12p"))
    notes = read_raw(tmp_path / "whole.raw", RGGB, RawOverrides(packing=f"Bayer{order}12p")).notes
    assert bool(notes) == (phase != (0, 0))  # of the whole sensor, whose array the table knows
    five = dataclasses.replace(random_table(FIVE_BAND), rows=10, cols=12)
    with pytest.raises(InputFileError, match="colour filter array"):
        read_raw(tmp_path / "a.raw", five, RawOverrides(size=(10, 12), packing=f"Bayer{order}12p", skip=6))


def all_frames(path: Path, known: RawOverrides) -> list[RawFrame | None]:
    sequence = find_frames((path,), RGGB, known).frames
    return [sequence.read(reference.number) for reference in sequence]


def test_headers_and_byte_orders_of_files_and_stacks(tmp_path: Path) -> None:
    values = random_frame("Mono16", (3, 32, 40), 4)
    (tmp_path / "a.bin").write_bytes(bytes(178) + values.astype(">u2").tobytes())
    known = RawOverrides(skip=178, byte_order="big")
    frames = all_frames(tmp_path / "a.bin", known)
    np.testing.assert_array_equal([frame.values for frame in frames if frame], values)
    for cut in (177, 179):
        with pytest.raises(InputFileError, match=r"bytes|in the middle of frame"):
            all_frames(tmp_path / "a.bin", RawOverrides(skip=cut))
    with pytest.raises(RecipeError, match="not to the packing Mono10p"):
        make_layout((4, 4), "Mono10p", byte_order="little")


def scene(kind: str, bits: int, noise: float) -> np.ndarray:
    """A mosaic (row, col) of a scene with noise, in DN, black at a sixteenth of full scale."""
    row, col = np.indices((64, 80))
    light = {
        "flat": 0.4 + 0 * row,
        "dark": 0.0 * row,
        "waves": 0.4 + 0.3 * np.sin(row / 9) * np.cos(col / 7) + 0.1 * ((row + col) % 2),
        "patches": np.kron(np.random.default_rng(1).random((8, 10)), np.ones((8, 8))) * (0.6 + 0.4 * ((row + col) % 2)),
        "stars": 0.0 + (np.random.default_rng(2).random(row.shape) > 0.99),
        "noise": np.random.default_rng(3).random(row.shape),
    }[kind]
    top = 2**bits
    values = top / 16 + 0.9 * top * light + np.random.default_rng(5).normal(0, noise * top, row.shape)
    return np.clip(np.rint(values), 0, top - 1).astype(np.uint16)


FITTING = {
    "Mono10p": ("raw10", "Mono10pmsb"), "raw10": ("Mono10p",), "Mono12p": ("raw12", "Mono12Packed", "Mono12pmsb"),
    "Mono12Packed": ("raw12", "Mono12p"), "raw12": ("Mono12Packed", "Mono12p"), "Mono14p": ("Mono14pmsb",),
}  # fmt: skip


@pytest.mark.parametrize("true", sorted(FITTING))
@pytest.mark.parametrize("kind", ["flat", "dark", "waves", "patches"])
def test_a_wrong_packing_is_told_with_the_right_one(true: str, kind: str) -> None:
    values = scene(kind, PACKINGS[true].bits, 0.005)
    for wrong in FITTING[true]:
        layout = make_layout(values.shape, wrong)
        assert smoother_reading(content_of(pack(values, true), layout)["readings"](), RGGB.cfa) == f"‹packing› {true}"


@pytest.mark.parametrize("name", [*sorted(FITTING), "Mono8", "u16", "Mono12", "BayerGR12", "Mono10Packed"])
@pytest.mark.parametrize("kind", ["flat", "dark", "waves", "patches", "stars", "noise"])
def test_a_right_packing_is_never_doubted(name: str, kind: str) -> None:
    for noise in (0.0, 0.0005, 0.005, 0.05, 0.3):
        values = scene(kind, PACKINGS[name].bits, noise)
        content = content_of(pack(values, name), make_layout(values.shape, name))
        assert smoother_reading(content["readings"](), RGGB.cfa) == ""


@pytest.mark.parametrize("bits", [10, 12, 14, 16])
def test_exchanged_bytes_are_told(bits: int) -> None:
    values = scene("waves", bits, 0.005)
    right, wrong = (make_layout(values.shape, "u16", byte_order=order) for order in ("big", "little"))
    stored = values.astype(">u2").tobytes()
    assert smoother_reading(content_of(stored, wrong)["readings"](), RGGB.cfa) == "‹byte_order› big"
    assert smoother_reading(content_of(stored, right)["readings"](), RGGB.cfa) == ""
    shifted = (scene("flat", 8, 0.02) << 8).astype("<u2").tobytes()  # a depth of 8 bits in the upper byte
    assert smoother_reading(content_of(shifted, make_layout(values.shape, "u16"))["readings"](), RGGB.cfa) == ""


def test_a_misread_frame_is_warned_of_once(l3: L3, tmp_path: Path, raw_table: Path) -> None:
    values = scene("waves", 10, 0.005)
    (tmp_path / "a.raw").write_bytes(pack(values, "Mono10p"))
    given = ("--size", "64x80", "--black-level", 64, "--white-level", 1023, "--exposure", 1, "--backend", "reference")
    code, _, said = l3("render", raw_table, tmp_path / "a.raw", "-o", tmp_path / "a.png", "--packing", "raw10", *given)
    assert code == 0
    assert [line for line in said.splitlines() if "warning" in line and "--packing Mono10p" in line]
    assert "--phase" not in said
    code, _, said = l3("render", raw_table, tmp_path / "a.raw", "-o", tmp_path / "b.png", "--packing", "mono10P", *given)
    assert code == 0
    assert "--packing" not in said


def test_packed_files_and_stacks_render_as_their_values(l3: L3, tmp_path: Path, raw_table: Path, mosaic: np.ndarray) -> None:
    np.save(tmp_path / "a.npy", np.stack([mosaic >> 2, mosaic >> 3]))
    levels = ("--black-level", 16, "--white-level", 1023, "--exposure", 0.8, "--backend", "reference", "--quiet")
    assert l3("render", raw_table, tmp_path / "a.npy", "-o", tmp_path / "truth", *levels) == (0, "", "")
    content = [pack(values, "raw10", 64) for values in (mosaic >> 2, mosaic >> 3)]
    (tmp_path / "a.raw10").write_bytes(b"".join(content))
    (tmp_path / "a.bin").write_bytes(b"".join(content))
    (tmp_path / "one.raw10").write_bytes(content[1])
    layout = ("--stride", 64, *levels)
    assert l3("render", raw_table, tmp_path / "a.raw10", "-o", tmp_path / "out", *layout) == (0, "", "")
    assert l3("render", raw_table, tmp_path / "a.bin", "-o", tmp_path / "bin", "--packing", "raw10", *layout) == (0, "", "")
    assert l3("render", raw_table, tmp_path / "one.raw10", "-o", tmp_path / "one.png", *layout) == (0, "", "")
    for number in (0, 1):
        truth = read_image(tmp_path / f"truth/a_{number:06d}.png")[0]
        np.testing.assert_array_equal(read_image(tmp_path / f"out/a_{number:06d}.png")[0], truth)
        np.testing.assert_array_equal(read_image(tmp_path / f"bin/a_{number:06d}.png")[0], truth)
    np.testing.assert_array_equal(read_image(tmp_path / "one.png")[0], truth)


def test_a_packed_stream_renders(tmp_path: Path, raw_table: Path, mosaic: np.ndarray) -> None:
    arguments = [
        "render",
        raw_table,
        "-",
        "-o",
        tmp_path / "####.png",
        "--size",
        "32x40",
        "--packing",
        "raw12",
        "--stride",
        64,
    ]
    command = [sys.executable, "-c", "import sys; from l3cli.cli import run; sys.exit(run(sys.argv[1:]))"]
    command += [str(each) for each in (*arguments, "--backend", "reference", "--quiet", "--exposure", 0.8)]
    done = subprocess.run(command, input=pack(mosaic, "raw12", 64) * 2, capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    assert (tmp_path / "0000.png").read_bytes() == (tmp_path / "0001.png").read_bytes()


def test_dumps_of_another_size_are_refused(refused: Refused, tmp_path: Path, raw_table: Path) -> None:
    (tmp_path / "a.raw12").write_bytes(bytes(1925))
    assert "a.raw12" in refused(3, "render", raw_table, tmp_path / "a.raw12", "-o", tmp_path / "a.png")
    short = refused(2, "render", raw_table, tmp_path / "a.raw12", "-o", tmp_path / "a.png", "--stride", 59)
    assert "stride" in short
    (tmp_path / "b.raw").write_bytes(bytes(1600))
    assert "raw10, Mono10p, Mono10pmsb" in refused(3, "render", raw_table, tmp_path / "b.raw", "-o", tmp_path / "a.png")
    assert "raw14" in refused(2, "render", raw_table, tmp_path / "a.raw12", "-o", tmp_path / "a.png", "--packing", "raw14")
    with pytest.raises(RecipeError, match="has no pixels"):
        make_layout((0, 4), "raw10", None)


# ---------------------------------------------------------------------------------------------------------- graymaps


@given(
    rows=st.integers(1, 6), cols=st.integers(1, 6), top=st.integers(1, 65535), seed=st.integers(0, 2**32),
    gap=st.sampled_from([" ", "\n", "\r\n", "\t", "\n# made by hand\n", " #\n#\n "]),
)  # fmt: skip
def test_graymaps_keep_their_values(
    tmp_path_factory: pytest.TempPathFactory, rows: int, cols: int, top: int, seed: int, gap: str
) -> None:
    values = np.random.default_rng(seed).integers(0, top + 1, (rows, cols)).astype(np.uint16)
    path = tmp_path_factory.mktemp("pgm") / "a.PGM"
    header = gap.join(("P5", str(cols), str(rows), str(top))).encode() + b"\n"
    path.write_bytes(header + values.astype(np.uint8 if top < 256 else ">u2").tobytes())
    np.testing.assert_array_equal(read_raw(path, RGGB).values, values)


def test_a_lab_may_write_graymaps(tmp_path: Path, mosaic: np.ndarray) -> None:
    (tmp_path / "a.pgm").write_bytes(b"P5 40 32 4095\n" + mosaic.astype(">u2").tobytes())
    np.testing.assert_array_equal(read_frame(tmp_path / "a.pgm", (32, 40), 12), mosaic)
    with pytest.raises(InputFileError, match=r"a\.pgm"):
        read_frame(tmp_path / "a.pgm", (32, 40), 11)
    with pytest.raises(InputFileError, match=r"a\.pgm"):
        read_frame(tmp_path / "a.pgm", (40, 32), 12)
    (tmp_path / "b.pgm").write_bytes(b"P5 2 1 255\nab")
    with pytest.raises(InputFileError, match=r"b\.pgm"):
        read_frame(tmp_path / "b.pgm", (1, 2), 12)


@pytest.mark.parametrize(
    "content",
    [
        b"P2\n2 1\n9\n1 2\n",
        b"P6 1 1 255\nabc",
        b"",
        b"P5 2 2 255\nabc",
        b"P5 2 2 255\nabcde",
        b"P5 0 2 255\n",
        b"P5 1 1 70000\naa",
        b"P5 2 1 9\n\x01\x0a",
        b"P5 999999999 999999999 65535\n",
    ],
)
def test_broken_graymaps_are_refused(refused: Refused, tmp_path: Path, raw_table: Path, content: bytes) -> None:
    (tmp_path / "a.pgm").write_bytes(content)
    assert "a.pgm" in refused(3, "render", raw_table, tmp_path / "a.pgm", "-o", tmp_path / "a.png")


def test_a_folder_of_graymaps_is_a_sequence(l3: L3, tmp_path: Path, raw_table: Path, mosaic: np.ndarray) -> None:
    (tmp_path / "clip").mkdir()
    for number in (9, 10):
        (tmp_path / f"clip/{number}.pgm").write_bytes(b"P5 40 32 4095\n" + mosaic.astype(">u2").tobytes())
    assert l3("render", raw_table, tmp_path / "clip", "-o", tmp_path / "out", "--backend", "reference", "--quiet") == (
        0,
        "",
        "",
    )
    assert sorted(path.name for path in (tmp_path / "out").glob("[!.]*")) == ["10.png", "9.png"]


# -------------------------------------------------------------------------------------------------------------- FITS


@pytest.mark.parametrize("name", ["a.fits", "a.fit", "a.FTS"])
def test_fits_keeps_unsigned_values(tmp_path: Path, mosaic: np.ndarray, name: str) -> None:
    mosaic[0, :2] = (0, 65535)
    fits.writeto(tmp_path / name, mosaic)
    frame = read_raw(tmp_path / name, RGGB)
    np.testing.assert_array_equal(frame.values, mosaic)
    assert (frame.black_level, frame.white_level, frame.phase) == (RGGB.black_level, RGGB.white_level, (0, 0))
    fits.writeto(tmp_path / name, (mosaic >> 8).astype(np.uint8), overwrite=True)
    np.testing.assert_array_equal(read_raw(tmp_path / name, RGGB).values, mosaic >> 8)


def test_packed_fits_and_its_header(tmp_path: Path, mosaic: np.ndarray) -> None:
    header = fits.Header({"BAYERPAT": "RGGB", "XBAYROFF": 1, "YBAYROFF": 0, "ROWORDER": "BOTTOM-UP"})
    units = fits.HDUList([fits.PrimaryHDU(), fits.CompImageHDU(mosaic[::-1], header, compression_type="RICE_1")])
    units.writeto(tmp_path / "a.fits")
    frame = read_raw(tmp_path / "a.fits", RGGB)
    np.testing.assert_array_equal(frame.values, mosaic)
    assert frame.phase == (0, 1)
    assert read_raw(tmp_path / "a.fits", RGGB, RawOverrides(phase=(1, 1))).phase == (1, 1)
    fits.setval(tmp_path / "a.fits", "BAYERPAT", value="RGB", ext=1)
    (note,) = read_raw(tmp_path / "a.fits", RGGB).notes
    assert 'BAYERPAT "RGB" is not a 2×2 or 6×6 pattern' in note
    fits.setval(tmp_path / "a.fits", "ROWORDER", value="BOTTOM", ext=1)
    with pytest.raises(InputFileError, match="ROWORDER"):
        read_raw(tmp_path / "a.fits", RGGB)
    fits.setval(tmp_path / "a.fits", "ROWORDER", value="TOP-DOWN", ext=1)
    fits.setval(tmp_path / "a.fits", "BAYERPAT", value="CMYG", ext=1)
    with pytest.raises(InputFileError, match="mc/gy"):
        read_raw(tmp_path / "a.fits", RGGB)


X_TRANS_LETTERS = "GGRGGBGGBGGRBRGRBGGGBGGRGGRGGBRBGBRG"  # as Siril writes it


@pytest.mark.parametrize(("row", "col", "order"), [(0, 0, ""), (1, 0, ""), (2, 5, "TOP-DOWN"), (4, 3, "BOTTOM-UP")])
def test_x_trans_of_fits_and_its_phase(tmp_path: Path, mosaic: np.ndarray, row: int, col: int, order: str) -> None:
    array = np.array(["rgb".index(letter) for letter in X_TRANS_LETTERS.lower()], np.uint8).reshape(6, 6)
    table = dataclasses.replace(random_table(array, bits=12), rows=32, cols=40)
    header = fits.Header({"BAYERPAT": X_TRANS_LETTERS, "XBAYROFF": col, "YBAYROFF": row})
    if order:
        header["ROWORDER"] = order
    fits.writeto(tmp_path / "a.fits", mosaic[:: -1 if order == "BOTTOM-UP" else 1], header)
    frame = read_raw(tmp_path / "a.fits", table)
    np.testing.assert_array_equal(frame.values, mosaic)
    np.testing.assert_array_equal(
        shifted_cfa(table.cfa, frame.phase), array[(np.arange(6)[:, None] + row) % 6, (np.arange(6) + col) % 6]
    )


def test_an_image_in_an_extension_inherits_the_primary_header(tmp_path: Path, mosaic: np.ndarray) -> None:
    header = fits.Header({"BAYERPAT": "GBRG", "EXPTIME": 0.25, "ROWORDER": "BOTTOM-UP"})
    own = fits.Header({"EXPTIME": 0.5})
    units = fits.HDUList([fits.PrimaryHDU(header=header), fits.ImageHDU(mosaic[::-1], own)])
    units.writeto(tmp_path / "a.fits")
    frame = read_raw(tmp_path / "a.fits", RGGB)
    np.testing.assert_array_equal(frame.values, mosaic)
    assert (frame.phase, frame.exposure) == ((1, 0), 0.5)


@pytest.mark.parametrize(("number", "name"), [(32008, "bitshuffle"), (32001, "blosc"), (32015, "zstd"), (40000, "40000")])
def test_a_filter_that_is_missing_is_named(
    tmp_path: Path, raw_table: Path, refused: Refused, number: int, name: str
) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        created = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        created.set_chunk((1, 32, 40))
        created.set_filter(number, h5py.h5z.FLAG_OPTIONAL, ())
        space = h5py.h5s.create_simple((2, 32, 40))
        dataset = h5py.h5d.create(file.id, b"frames", h5py.h5t.NATIVE_UINT16, space, created)
        for frame in range(2):
            dataset.write_direct_chunk((frame, 0, 0), bytes(100))
    line = refused(3, "render", raw_table, tmp_path / "a.h5", "-o", tmp_path / "out")
    assert name in line
    assert "hdf5plugin" in line


def test_a_fits_cube_is_a_sequence(tmp_path: Path, mosaic: np.ndarray) -> None:
    fits.writeto(tmp_path / "a.fits", np.stack([mosaic, mosaic // 2, mosaic // 3]), fits.Header({"BAYERPAT": "RGGB"}))
    sequence = find_frames((tmp_path / "a.fits",), RGGB, RawOverrides())
    read = [(each.stem, sequence.frames.read(each.number)) for each in sequence.frames]
    assert [stem for stem, _ in read] == ["a_000000", "a_000001", "a_000002"]
    for divisor, (_, frame) in enumerate(read, 1):
        assert frame is not None
        np.testing.assert_array_equal(frame.values, mosaic // divisor)


def test_broken_fits_is_refused(
    refused: Refused, tmp_path: Path, raw_table: Path, mosaic: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, output = tmp_path / "a.fits", tmp_path / "a.png"
    path.write_bytes(b"nothing")
    assert "a.fits" in refused(3, "render", raw_table, path, "-o", output)
    fits.writeto(path, mosaic, overwrite=True)
    path.write_bytes(path.read_bytes()[:3000])
    assert "a.fits" in refused(3, "render", raw_table, path, "-o", output)
    for values in (mosaic / 2, mosaic.astype(np.int16) - 9, mosaic + 1e6):
        fits.writeto(path, values, overwrite=True)
        assert "a.fits" in refused(3, "render", raw_table, path, "-o", output)
    fits.HDUList([fits.PrimaryHDU()]).writeto(path, overwrite=True)
    assert "a.fits" in refused(3, "render", raw_table, path, "-o", output)
    monkeypatch.setitem(sys.modules, "astropy.io", None)
    monkeypatch.setenv("L3_TRUST", "1")  # the process that decodes has separate modules
    assert INSTALL in refused(1, "render", raw_table, path, "-o", output)
