"""Tags of a DNG that change pixels: each is read, refused in its words or warned of, as docs/raw-files.md says."""

import re
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile

from l3cli.errors import InputFileError
from l3cli.frames.frame import RawFrame
from l3cli.io.raw.files import read_raw
from tests.helpers.dng_files import (
    BYTE,
    LONG,
    RATIONAL,
    SHORT,
    SRATIONAL,
    Tags,
    gain_map,
    lossless_jpeg,
    opcode_list,
    packed,
    write_dng,
)
from tests.helpers.paths import ROOT
from tests.helpers.raw_files import RGGB

PATTERN = np.array([[0, 1], [1, 2]])
MOSAIC = np.random.default_rng(3).integers(64, 3000, (32, 41)).astype(np.uint16)
ROWS, COLS = MOSAIC.shape
DELTAS = (SRATIONAL, [part for each in range(ROWS) for part in (each % 2, 1)])


def in_fields(values: np.ndarray, count: int) -> np.ndarray:
    """Rows 0, n, 2n…, then 1, n + 1…: as the tags of interleaving say."""
    return np.concatenate([values[field::count] for field in range(count)])


def the_mosaic(frame: RawFrame) -> bool:
    return np.array_equal(frame.values, MOSAIC)


def at(rows: slice, cols: slice) -> Callable[[RawFrame], bool]:
    return lambda frame: np.array_equal(frame.values, MOSAIC[rows, cols])


def tiles(width: int, length: int) -> list[bytes]:
    """The mosaic in tiles as wide as it is, or wider."""
    whole = np.pad(MOSAIC, ((0, 0), (0, width - COLS)))
    return [whole[top : top + length].tobytes() for top in range(0, ROWS, length)]


def tiled(width: int, length: int) -> Tags:
    sizes = [len(each) for each in tiles(width, length)]
    return {322: (LONG, [width]), 323: (LONG, [length]), 324: (LONG, [0] * len(sizes)), 325: (LONG, sizes)}


MASK = {50829: (LONG, [2, 4, 30, 40])}
SQUARED = (np.arange(4096) ** 2 // 256).tolist()
# What is read: tags, what is stored, what the frame must be.
READ: dict[str, tuple[Tags, list[bytes] | None, Callable[[RawFrame], bool]]] = {
    "NewSubFileType": ({254: (LONG, [0])}, None, the_mosaic),
    "BitsPerSample": ({258: (SHORT, [12])}, [packed(MOSAIC[:, :40], 12, "<")], at(np.s_[:], np.s_[:40])),
    "Compression": ({259: (SHORT, [7])}, [lossless_jpeg(MOSAIC)], the_mosaic),
    "PhotometricInterpretation": ({262: (SHORT, [32803])}, None, the_mosaic),
    "Orientation": ({274: (SHORT, [6])}, None, lambda frame: frame.orientation == 6),
    "RowsPerStrip": ({278: (LONG, [16])}, [MOSAIC[:16].tobytes(), MOSAIC[16:].tobytes()], the_mosaic),
    "TileWidth": (tiled(48, 16), tiles(48, 16), the_mosaic),
    "CFARepeatPatternDim": ({33421: (SHORT, [2, 4]), 33422: (BYTE, [0, 1] * 2 + [1, 2] * 2)}, None, the_mosaic),
    "CFAPattern": ({33422: (BYTE, [2, 1, 1, 0])}, None, lambda frame: frame.phase == (1, 1)),
    "CFAPlaneColor": ({50710: (BYTE, [2, 1, 0]), 50728: (RATIONAL, [3, 1, 2, 1, 1, 1])}, None,
                      lambda frame: frame.neutral == (1, 2, 3)),
    "LinearizationTable": ({50712: (SHORT, SQUARED), 50717: (LONG, [65000])}, None,
                           lambda frame: np.array_equal(frame.values, np.array(SQUARED)[MOSAIC])),
    "BlackLevelRepeatDim": ({50713: (SHORT, [1, 2]), 50714: (SHORT, [60, 68])}, None, lambda frame: frame.black_level == 64),
    "BlackLevel": ({50714: (SHORT, [32])}, None, lambda frame: frame.black_level == 32),
    "BlackLevelDeltaH": ({50715: (SRATIONAL, [2, 1] * COLS)}, None, lambda frame: frame.black_level == 66),
    "BlackLevelDeltaV": ({50716: DELTAS}, None, lambda frame: not the_mosaic(frame)),
    "WhiteLevel": ({50717: (LONG, [3500])}, None, lambda frame: frame.white_level == 3500),
    "DefaultCropOrigin": ({50719: (LONG, [3, 2]), 50720: (LONG, [20, 10])}, None, at(np.s_[2:12], np.s_[3:23])),
    "DefaultCropSize": ({50720: (LONG, [20, 10])}, None, at(np.s_[:10], np.s_[:20])),
    "AsShotNeutral": ({50728: (RATIONAL, [1, 2, 1, 1, 2, 3])}, None, lambda frame: frame.neutral == (0.5, 1, 2 / 3)),
    "ActiveArea": (MASK, None, at(np.s_[2:30], np.s_[4:40])),
    "RowInterleaveFactor": ({50975: (SHORT, [3])}, [in_fields(MOSAIC, 3).tobytes()], the_mosaic),
    "ColumnInterleaveFactor": (
        {52547: (LONG, [2]), 50975: (LONG, [2]), **MASK}, [in_fields(in_fields(MOSAIC, 2).T, 2).T.tobytes()],
        at(np.s_[2:30], np.s_[4:40]),
    ),
    "OpcodeList1": ({51008: opcode_list((4, 0, bytes(8)))}, None, the_mosaic),
    "OpcodeList2": ({51009: opcode_list((9, 0, gain_map(np.full((1, 1), 2.0), (0, 0, ROWS, COLS))))}, None,
                    lambda frame: frame.shading is not None),
    "OpcodeList3": ({51022: opcode_list((9, 0, gain_map(np.full((1, 1), 2.0), (0, 0, ROWS, COLS), (0, 3))))}, None,
                    lambda frame: frame.shading is not None),
}  # fmt: skip
REFUSED: dict[str, tuple[Tags, str]] = {
    "DNGBackwardVersion": ({50707: (BYTE, [1, 8, 0, 0])}, "for readers of DNG 1.8, this is one of 1.7"),
    "NewSubFileType": ({254: (LONG, [16])}, "holds no raw image"),
    "BitsPerSample": ({258: (SHORT, [32])}, "LibRaw"),
    "Compression": ({259: (SHORT, [52546])}, "compressed by JPEG XL"),
    "FillOrder": ({266: (SHORT, [2])}, "bits in reverse"),
    "Orientation": ({274: (SHORT, [9])}, "its orientation is 9, TIFF knows 1…8"),
    "SamplesPerPixel": ({277: (SHORT, [3]), 262: (SHORT, [34892])}, "already demosaicked"),
    "TileWidth": (tiled(48, 32), "tiles are wider than the image"),
    "Predictor": ({317: (SHORT, [2])}, "stores differences"),
    "SampleFormat": ({339: (SHORT, [3])}, "floating-point"),
    "CFALayout": ({50711: (SHORT, [3])}, "staggered"),
    "DefaultCropOrigin": ({50719: (LONG, [1, 0])}, r"its crop \(0, 1, 32, 41\) is not within its active area of 32×41"),
    "ActiveArea": ({50829: (LONG, [0, 0, 33, 41])}, r"its active area \(0, 0, 33, 41\) is not within its 32×41 pixels"),
    "ColorimetricReference": ({50879: (SHORT, [1])}, "a picture's values, not a scene's"),
    "SubTileBlockSize": ({50974: (LONG, [2, 2])}, "pixels in blocks"),
    "RowInterleaveFactor": ({50975: (LONG, [0])}, "its tags are damaged"),
    "ColumnInterleaveFactor": ({52547: (LONG, [0])}, "its tags are damaged"),
    "OpcodeList3": ({51022: opcode_list((1, 0, b""))}, "WarpRectilinear"),
}
OF_OTHERS = {  # tags that lie between those of DNG
    "RawImageSegmentation", "AliasLayerMetadata", "IJMetadataByteCounts", "IJMetadata", "RPCCoefficientTag", "SRawType",
    "PanasonicTitle", "PanasonicTitle2", "RSID", "GEO_METADATA", "ProfileIFD", "FibicsXML", "CacheBlob", "CacheVersion",
    "MicroManagerMetadata", "ZIFmetadata", "ZIFannotations",
}  # fmt: skip
NOTED: dict[str, tuple[Tags, str]] = {
    "DefaultScale": ({50718: (RATIONAL, [2, 1, 1, 1])}, "its pixels are not square (DefaultScale 2, 1)"),
    "OpcodeList3": ({51022: opcode_list((1, 1, b""))}, "WarpRectilinear"),
    "DefaultUserCrop": ({51125: (RATIONAL, [1, 4, 0, 1, 1, 1, 1, 1])}, "(DefaultUserCrop) is not applied"),
}


def read(folder: Path, tags: Tags, strips: list[bytes] | None = None) -> RawFrame:
    cols = 40 if tags.get(258) == (SHORT, [12]) else COLS
    return read_raw(write_dng(folder / "a.dng", MOSAIC[:, :cols], PATTERN, strips=strips, tags=tags), RGGB)


@pytest.mark.parametrize("name", READ)
def test_what_is_read_changes_the_frame_as_it_says(tmp_path: Path, name: str) -> None:
    tags, strips, holds = READ[name]
    frame = read(tmp_path, tags, strips)
    assert holds(frame)
    assert frame.notes == ()


def test_the_mosaic_is_read_beside_a_larger_enhanced_image(tmp_path: Path) -> None:
    version = (50706, "B", 4, (1, 4, 0, 0), True)
    array = [(33421, "H", 2, (2, 2), True), (33422, "B", 4, (0, 1, 1, 2), True)]
    with tifffile.TiffWriter(tmp_path / "a.dng") as file:
        file.write(MOSAIC, photometric=32803, extratags=[*array, version], metadata=None, subifds=1)
        enhanced = np.zeros((2 * ROWS, 2 * COLS, 3), np.uint16)
        file.write(enhanced, photometric=34892, planarconfig="contig", metadata=None, subfiletype=16)
    assert the_mosaic(read_raw(tmp_path / "a.dng", RGGB))


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_read_is_refused_in_its_words(tmp_path: Path, name: str) -> None:
    tags, words = REFUSED[name]
    with pytest.raises(InputFileError, match=words) as caught:
        read(tmp_path, tags)
    assert "a.dng" in str(caught.value)


@pytest.mark.parametrize("drop", [(), (50706,)])
def test_a_mosaic_by_another_name_is_refused(tmp_path: Path, drop: tuple[int, ...]) -> None:
    path = write_dng(tmp_path / "a.tif", MOSAIC, PATTERN, tags={50975: (LONG, [2])}, drop=drop)
    with pytest.raises(InputFileError, match=r"a\.tif is a DNG's mosaic"):
        read_raw(path, RGGB)


@pytest.mark.parametrize("name", NOTED)
def test_what_is_left_to_the_user_is_said(tmp_path: Path, name: str) -> None:
    tags, words = NOTED[name]
    frame = read(tmp_path, tags)
    assert the_mosaic(frame)
    (note,) = frame.notes
    assert words in note


def test_the_page_says_of_every_tag_what_is_done_and_the_tables_above_test_it() -> None:
    text = (ROOT / "docs" / "raw-files.md").read_text()
    _, _, section = text.partition("## Tags of a DNG")
    table, _, harmless = section.partition("\nThe rest is harmless:\n")
    rows = [line.split("|")[1:3] for line in table.splitlines() if line.startswith("| ")]
    named: dict[str, set[str]] = defaultdict(set)
    for what, tags in rows[1:]:
        named[what.strip()] |= set(re.findall(r"\w+", tags))
    assert named["read"] == {*READ}
    assert named["refused"] == {*REFUSED}
    assert named["warned"] == {*NOTED}
    named["harmless"] = set(re.findall(r"\w+", harmless))
    known = {name for code, name in tifffile.TIFF.TAGS.items() if 50706 <= code <= 52555}
    assert known - set().union(*named.values()) == OF_OTHERS
