"""File formats of astronomy, capture programs and laboratories: supported formats are read.

For any other format, the message names the format and suggests an alternative.
"""

import itertools
import struct
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io

from l3cli.errors import InputFileError
from l3cli.io.raw.files import BY_SUFFIX, RawOverrides, read_raw
from l3cli.io.raw.unread import MISNAMED, UNREAD
from l3cli.io.sequences import find_frames
from tests.helpers.calls import L3, Refused
from tests.helpers.raw_files import RGGB

FRAMES = np.random.default_rng(8).integers(0, 4096, (3, 32, 40)).astype(np.uint16)
SMOOTH = (2000 + 1500 * np.sin(np.indices((3, 32, 40)).sum(0) / 6)).astype(np.uint16)


def frames_of(path: Path, dataset: str | None = None) -> list[tuple[np.ndarray, tuple[int, int]]]:
    """Values and phase of the frames of a file."""
    sequence = find_frames((path,), RGGB, RawOverrides(), dataset=dataset).frames
    found = (sequence.read(each.number) for each in sequence)
    return [(frame.values, frame.phase) for frame in itertools.takewhile(lambda frame: frame is not None, found) if frame]


def ser(values: np.ndarray, colour: int = 0, little: int = 0, bits: int = 16, dtype: str = "<u2") -> bytes:
    numbers = struct.pack("<7i", 0, colour, little, values.shape[2], values.shape[1], bits, len(values))
    times = np.arange(len(values), dtype="<u8").tobytes()
    return (b"LUCAM-RECORDER" + numbers).ljust(178, b"\0") + values.astype(dtype).tobytes() + times


@pytest.mark.parametrize("little", [0, 1])
@pytest.mark.parametrize("dtype", ["<u2", ">u2"])
def test_ser_is_read_in_the_byte_order_of_its_pixels(tmp_path: Path, little: int, dtype: str) -> None:
    (tmp_path / "a.ser").write_bytes(ser(SMOOTH, 0, little, 12, dtype))
    read = frames_of(tmp_path / "a.ser")
    np.testing.assert_array_equal([values for values, _ in read], SMOOTH)
    assert read[0][1] == (0, 0)


@pytest.mark.parametrize(("colour", "phase"), [(8, (0, 0)), (9, (0, 1)), (10, (1, 0)), (11, (1, 1))])
def test_ser_states_its_array(tmp_path: Path, colour: int, phase: tuple[int, int]) -> None:
    values = FRAMES >> 4
    (tmp_path / "a.ser").write_bytes(ser(values, colour, bits=8, dtype="u1"))
    for number, (read, where) in enumerate(frames_of(tmp_path / "a.ser")):
        np.testing.assert_array_equal(read, values[number])
        assert where == phase


def test_ser_that_lies_is_refused(tmp_path: Path, refused: Refused, raw_table: Path) -> None:
    good = ser(SMOOTH)
    spoiled = {
        "colours": ser(SMOOTH, 100),
        "another array": ser(SMOOTH, 16),
        "no kind": ser(SMOOTH, 5),
        "cut": good[:-3000],
        "header": good[:100],
        "huge": good[:26] + struct.pack("<2i", 2**31 - 1, 2**31 - 1) + good[34:],
        "negative": good[:26] + struct.pack("<2i", -40, 32) + good[34:],
        "many": good[:38] + struct.pack("<i", 2**31 - 1) + good[42:],
        "none": good[:38] + struct.pack("<i", 0) + good[42:],
        "deep": good[:34] + struct.pack("<i", 32) + good[38:],
    }
    for name, content in spoiled.items():
        (tmp_path / f"{name}.ser").write_bytes(content)
        refused(3, "render", raw_table, tmp_path / f"{name}.ser", "-o", tmp_path / "out/")


def test_y4m_of_one_channel_is_read(tmp_path: Path) -> None:
    for name, depth in (("mono", 8), ("mono12", 12), ("mono16", 16)):
        values = (FRAMES >> 4 if depth == 8 else FRAMES).astype("u1" if depth == 8 else "<u2")
        frames = b"".join(b"FRAME\n" + frame.tobytes() for frame in values)
        (tmp_path / "a.y4m").write_bytes(f"YUV4MPEG2 W40 H32 F25:1 Ip A1:1 C{name}\n".encode() + frames)
        np.testing.assert_array_equal([read for read, _ in frames_of(tmp_path / "a.y4m")], values)
    (tmp_path / "a.y4m").write_bytes(b"YUV4MPEG2 W40 H32 F25:1 Ip A1:1 C420jpeg\nFRAME\n" + bytes(40 * 32 * 3 // 2))
    with pytest.raises(InputFileError, match="yuv420p"):
        frames_of(tmp_path / "a.y4m")


def avi(frames: np.ndarray, fourcc: bytes, palette: np.ndarray | None) -> bytes:
    """An uncompressed AVI of 8 bits, as capture programs write it."""
    count, rows, cols = frames.shape
    colours = b"" if palette is None else np.pad(palette[:, None].repeat(3, 1), ((0, 0), (0, 1))).astype("u1").tobytes()
    picture = struct.pack("<IiiHH4s5I", 40, cols, rows, 1, 8, fourcc, rows * cols, 0, 0, len(colours) // 4, 0) + colours

    def chunk(name: bytes, content: bytes) -> bytes:
        return name + struct.pack("<I", len(content)) + content

    def listed(name: bytes, content: bytes) -> bytes:
        return chunk(b"LIST", name + content)

    stream = struct.pack("<4s4s9I4h", b"vids", b"DIB ", 0, 0, 0, 1, 25, 0, count, rows * cols, 0, 0, 0, cols, rows) + bytes(
        4
    )
    header = struct.pack("<14I", 40000, 0, 0, 16, count, 0, 1, rows * cols, cols, rows, 0, 0, 0, 0)
    about = listed(b"hdrl", chunk(b"avih", header) + listed(b"strl", chunk(b"strh", stream) + chunk(b"strf", picture)))
    stored = frames if palette is None else frames[:, ::-1]  # DIB has the lowest row first
    return chunk(b"RIFF", b"AVI " + about + listed(b"movi", b"".join(chunk(b"00db", f.tobytes()) for f in stored)))


def test_uncompressed_avi_is_read(tmp_path: Path) -> None:
    values = (FRAMES >> 4).astype(np.uint8)
    for fourcc, palette in ((bytes(4), np.arange(256)), (b"Y800", None)):
        (tmp_path / "a.avi").write_bytes(avi(values, fourcc, palette))
        np.testing.assert_array_equal([read for read, _ in frames_of(tmp_path / "a.avi")], values)
    for fourcc, palette, word in ((bytes(4), np.arange(256)[::-1], "palette"), (b"BA81", None, "codec")):
        (tmp_path / "a.avi").write_bytes(avi(values, fourcc, palette))
        with pytest.raises(InputFileError, match=word):
            frames_of(tmp_path / "a.avi")


def test_matlab_files_keep_frames_last(tmp_path: Path) -> None:
    frames = np.concatenate([FRAMES, FRAMES])  # three along the last axis are the channels of a picture
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"raw": frames.transpose(1, 2, 0), "gain": 2.0, "note": "x"})
    content = path.read_bytes()
    path.write_bytes(b"MATLAB 5.0 MAT-file, Platform: GLNXA64".ljust(116) + content[116:])  # as MATLAB writes it
    np.testing.assert_array_equal([read for read, _ in frames_of(path)], frames)
    scipy.io.savemat(path, {"raw": frames, "other": frames})  # as Python writes it
    np.testing.assert_array_equal([read for read, _ in frames_of(path, "raw")], frames)
    with pytest.raises(InputFileError, match="2 arrays"):
        frames_of(path)
    with pytest.raises(InputFileError, match="no variable"):
        frames_of(path, "nothing")
    scipy.io.savemat(path, {"raw": frames[0]})
    np.testing.assert_array_equal(frames_of(path)[0][0], frames[0])
    path.write_bytes(path.read_bytes()[:900])
    with pytest.raises(InputFileError):
        frames_of(path)
    with h5py.File(path, "w", userblock_size=512) as file:
        file["raw"] = frames.transpose(0, 2, 1)
        file["raw"].attrs["MATLAB_class"] = np.bytes_("uint16")
    with open(path, "r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512))
    np.testing.assert_array_equal([read for read, _ in frames_of(path)], frames)


# --------------------------------------------------------------------------------------------------- formats not read


def test_known_formats_are_never_called_damaged(tmp_path: Path) -> None:
    for each in UNREAD:
        for suffix in each.suffixes:
            assert suffix not in BY_SUFFIX
            (tmp_path / f"a{suffix}").write_bytes(b"content of any kind")
            with pytest.raises(InputFileError) as raised:
                read_raw(tmp_path / f"a{suffix}", RGGB)
            assert str(raised.value).endswith(f"is {each.name}; {each.instead}")
        for place, magic in each.magic:
            (tmp_path / "a.unknown").write_bytes(bytes(place) + magic + bytes(100))
            with pytest.raises(InputFileError, match=each.name):
                read_raw(tmp_path / "a.unknown", RGGB)
    for magic, suffix in MISNAMED.items():
        assert suffix in BY_SUFFIX
        (tmp_path / "a.unknown").write_bytes(magic + bytes(100))
        with pytest.raises(InputFileError, match=rf"rename the file to a\{suffix}"):
            read_raw(tmp_path / "a.unknown", RGGB)


def test_a_format_that_is_not_read_is_refused_in_a_line(tmp_path: Path, l3: L3, refused: Refused, raw_table: Path) -> None:
    (tmp_path / "a.xisf").write_bytes(b"XISF0100" + bytes(5000))
    assert "FITS" in refused(3, "render", raw_table, tmp_path / "a.xisf", "-o", tmp_path / "a.png")
    (tmp_path / "a.jpg").write_bytes(b"\xff\xd8\xff" + bytes(5000))
    assert "use the camera's raw file" in refused(3, "init", "--from", tmp_path / "a.jpg", tmp_path / "folder")
    (tmp_path / "a.ser").write_bytes(ser(SMOOTH, 8))
    assert l3("render", raw_table, tmp_path / "a.ser", "-o", tmp_path / "out/", "--backend", "reference", "--quiet")[0] == 0
    assert len(list((tmp_path / "out").glob("*.png"))) == 3
