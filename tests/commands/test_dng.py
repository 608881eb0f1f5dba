"""DNG files: other software opens simulated frames, and tags and opcodes that change pixels are applied or reported.

docs/raw-files.md describes each tag and opcode.
"""

import dataclasses
import re
import struct
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rawpy
import tifffile

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.store import save
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import open_training_set
from l3cli.cli import run
from l3cli.errors import InputFileError
from l3cli.frames.frame import RawFrame
from l3cli.frames.shading import FRACTION
from l3cli.io import isolated
from l3cli.io.images import read_image
from l3cli.io.pictures.dng import LIGHT_CODES, write_dng
from l3cli.io.raw.files import RawOverrides, read_raw
from l3cli.physics import spectra
from l3cli.physics.display import SRGB_FROM_XYZ, delta_e_2000, lab
from l3cli.simulation.light import colour_matrix, make_light, neutral
from tests.helpers import dng_files
from tests.helpers.calls import L3, Refused
from tests.helpers.cameras import BAYER, bayer_camera
from tests.helpers.dng_files import (
    ASCII,
    BYTE,
    LONG,
    RATIONAL,
    SHORT,
    SRATIONAL,
    UNDEFINED,
    Tags,
    gain_map,
    lossless_jpeg,
    opcode_list,
    packed,
)
from tests.helpers.paths import CONFIGS, ROOT
from tests.helpers.raw_files import RGGB
from tests.helpers.tables import random_table

SCENES = """
illuminants = ["D65", "A"]
exposure_share = [0.9]
[[scene]]
source = "colorchecker"
size = [96, 144]
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of frames of the small Bayer camera, as TIFF and as DNG, with their table."""
    folder = tmp_path_factory.mktemp("dng")
    (folder / "camera.toml").write_text(bayer_camera().replace("black_level_dn = 64", "black_level_dn = 64.25"))
    (folder / "scenes.toml").write_text(SCENES)
    arguments = ["simulate", "scenes.toml", "--camera", "camera.toml", "-o", "t.h5", "--pictures", "p", "--dng", "d"]
    paths = {name: str(folder / name) for name in ("scenes.toml", "camera.toml", "t.h5", "p", "d")}
    assert run([paths.get(each, each) for each in arguments] + ["--quiet"]) == 0
    table = random_table(BAYER, bits=12, black_level=64.25, patch=5)
    save(dataclasses.replace(table, white_level=3814.0), folder / "table.h5")
    return folder


@pytest.fixture(scope="module")
def frames(made: Path) -> list[np.ndarray]:
    with open_training_set(made / "t.h5") as training:
        return [frame.raw for frame in training]


REFERENCE = ("--backend", "reference", "--force")


def files(made: Path) -> list[Path]:
    return sorted((made / "d").glob("[!.]*"))


def test_one_file_a_frame_rendered_to_the_same_pixels(l3: L3, made: Path, frames: list[np.ndarray]) -> None:
    names = [path.stem for path in files(made)]
    assert names == [path.name.removesuffix("_raw.tif") for path in sorted((made / "p").glob("*_raw.tif"))]
    for name in names:
        for source, output in ((made / f"d/{name}.dng", "dng.png"), (made / f"p/{name}_raw.tif", "tif.png")):
            rendered = l3("render", made / "table.h5", source, "--white", "table", "-o", made / output, *REFERENCE)
            assert rendered[0] == 0, rendered[2]
        np.testing.assert_array_equal(read_image(made / "dng.png")[0], read_image(made / "tif.png")[0])


def test_other_developers_see_the_camera(made: Path, frames: list[np.ndarray]) -> None:
    for path, values in zip(files(made), frames, strict=True):
        with rawpy.imread(str(path)) as raw:
            np.testing.assert_array_equal(raw.raw_image, values)
            assert set(raw.black_level_per_channel) == {64}  # LibRaw takes whole numbers
            assert raw.white_level == 3814
            assert [raw.color_desc.decode()[index] for index in raw.raw_pattern.ravel()] == list("RGGB")
            assert raw.sizes.flip == 0


def test_other_developers_make_a_true_picture(made: Path) -> None:
    """LibRaw's picture, white balanced by AsShotNeutral, against the wanted one, patch by patch."""
    wavelength = np.arange(380.0, 781.0, 5.0)
    _, reflectance = spectra.colorchecker(wavelength)
    weights = spectra.xyz_weights(wavelength) * spectra.illuminant("D65", wavelength)
    wanted, white = reflectance @ weights.T / weights[1].sum(), spectra.white_point("D65")
    for path, error in zip(files(made), (2.0, 7.0), strict=True):
        with rawpy.imread(str(path)) as raw:
            picture = raw.postprocess(use_camera_wb=True, no_auto_bright=True, output_bps=16, gamma=(1, 1)) / 65535
        reached = picture[:96, :144].reshape(4, 24, 6, 24, 3)[:, 8:16, :, 8:16].mean(axis=(1, 3)).reshape(24, 3)
        xyz = reached @ np.linalg.inv(SRGB_FROM_XYZ).T
        xyz *= wanted[18, 1] / xyz[18, 1]
        difference = delta_e_2000(lab(xyz, white), lab(wanted, white))
        assert difference.mean() < error, difference.round(1)
        greys = reached[18:]
        assert (np.ptp(greys, axis=1) < 0.03 * greys.mean(axis=1) + 0.004).all()  # noise


def test_tags_are_those_of_the_specification(made: Path) -> None:
    with tifffile.TiffFile(files(made)[0]) as file:
        written = file.pages[0].tags.values()
        tags, kind = {tag.code: tag.value for tag in written}, {tag.code: (int(tag.dtype), tag.count) for tag in written}
    kinds = {
        254: (4, 1), 274: (3, 1), 33421: (3, 2), 33422: (1, 4), 50706: (1, 4), 50707: (1, 4), 50710: (1, 3), 50711: (3, 1),
        50713: (3, 2), 50714: (5, 1), 50717: (4, 1), 50718: (5, 2), 50719: (4, 2), 50720: (4, 2), 50721: (10, 9),
        50722: (10, 9), 50728: (5, 3), 50778: (3, 1), 50779: (3, 1), 50829: (4, 4), 51041: (12, 2), 33434: (5, 1),
    }  # fmt: skip
    assert {code: kind[code] for code in kinds} == kinds
    assert list(tags) == sorted(tags)  # TIFF asks for it
    assert (tags[262], tags[258], tags[277]) == (32803, 16, 1)
    assert (tags[50778], tags[50779]) == (17, 21)
    assert tags[50829] == (0, 0, 96, 144)
    assert tags[50714] == (257, 4)
    assert tags[50708] == "small Bayer"
    assert 306 not in tags  # no clock


def test_same_frames_same_bytes(made: Path, tmp_path: Path) -> None:
    again = ["simulate", str(made / "scenes.toml"), "--camera", str(made / "camera.toml"), "-o", str(tmp_path / "t.h5")]
    assert run([*again, "--dng", str(tmp_path / "d"), "--quiet"]) == 0
    for path in files(made):
        assert path.read_bytes() == (tmp_path / "d" / path.name).read_bytes()


@pytest.mark.parametrize("recipe", ["fiveband", "xtrans", "quad_bayer", "rgbw4x4", "rgbir", "cmy", "snapshot16"])
def test_any_array_comes_back(tmp_path: Path, recipe: str) -> None:
    camera = load_camera(CONFIGS / f"cameras/{recipe}.toml")
    values = np.random.default_rng(0).integers(0, round(camera.white_level) + 1, (40, 60)).astype(np.uint16)
    write_dng(tmp_path / "a.dng", values, camera, _colour(camera), None, 1e-5)
    frame = read_raw(tmp_path / "a.dng", camera)
    np.testing.assert_array_equal(frame.values, values)
    assert (frame.black_level, frame.white_level, frame.phase, frame.orientation) == (
        camera.black_level,
        camera.white_level,
        (0, 0),
        0,
    )
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        np.testing.assert_array_equal(raw.raw_image, values)


def test_matrices_and_neutral_follow_the_planes(tmp_path: Path) -> None:
    """Of three channels the commonest, yellow here, is the second plane; every tag keeps that order."""
    camera = load_camera(CONFIGS / "cameras/cmy.toml")
    light = make_light("D65", {}, camera.wavelength)
    grey = neutral(camera, light)
    write_dng(tmp_path / "a.dng", np.zeros((4, 6), np.uint16), camera, _colour(camera), grey, 0.01)
    with tifffile.TiffFile(tmp_path / "a.dng") as file:
        tags = file.pages[0].tags
        planes, matrix, shown = (tags.valueof(code) for code in (50710, 50722, 50728))
    assert list(planes) == [3, 5, 4]
    np.testing.assert_allclose(np.divide(shown[::2], shown[1::2]), grey[[0, 2, 1]], rtol=1e-6)
    np.testing.assert_allclose(np.divide(matrix[::2], matrix[1::2]).reshape(3, 3), _colour(camera)["D65"][[0, 2, 1]])


@pytest.mark.parametrize("recipe", ["bayer", "fiveband", "cmy"])
def test_the_matrix_meets_white_and_surfaces(recipe: str) -> None:
    camera = load_camera(CONFIGS / f"cameras/{recipe}.toml")
    for name in LIGHT_CODES:
        light = make_light(name, {}, camera.wavelength)
        matrix = colour_matrix(camera, light)
        white = spectra.xyz_weights(light.wavelength) @ light.radiance
        np.testing.assert_allclose(matrix @ (white / white[1]), neutral(camera, light), rtol=1e-9)
        _, reflectance = spectra.colorchecker(light.wavelength)
        seen = camera.electron_weights @ spectra.sampling_matrix(light.wavelength, camera.wavelength)
        channels = (reflectance * light.radiance) @ seen.T / (seen @ light.radiance).max()
        xyz = (reflectance * light.radiance) @ spectra.xyz_weights(light.wavelength).T / white[1]
        assert np.abs(xyz @ matrix.T - channels).mean() < 0.02


def test_what_exists_already_is_refused(refused: Refused, made: Path, tmp_path: Path) -> None:
    call = ("simulate", made / "scenes.toml", "--camera", made / "camera.toml", "-o", tmp_path / "t.h5", "--dng")
    (tmp_path / "file").write_bytes(b"")
    assert "file" in refused(1, *call, tmp_path / "file")
    (tmp_path / "full").mkdir()
    (tmp_path / "full/mine.dng").write_bytes(b"")
    assert "full" in refused(1, *call, tmp_path / "full")


def _colour(camera: CameraModel) -> dict[str, np.ndarray]:
    return {name: colour_matrix(camera, make_light(name, {}, camera.wavelength)) for name in LIGHT_CODES}


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
COLOUR_MATRIX = (SRATIONAL, [part for each in (7, -2, -1, -5, 12, 3, -1, 2, 6) for part in (each, 10)])
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
    "SamplesPerPixel": ({277: (SHORT, [2]), 258: (SHORT, [16, 16])}, [np.stack([MOSAIC, MOSAIC // 2], -1).tobytes()],
                        the_mosaic),
    "AsShotWhiteXY": ({50721: COLOUR_MATRIX, 50729: (RATIONAL, [44757, 100000, 40745, 100000])}, None,
                      lambda frame: frame.neutral == (0.7041, 1, 0.4008)),
    "WhiteLevel": ({50717: (LONG, [3500])}, None, lambda frame: frame.white_level == 3500),
    "DefaultCropOrigin": ({50719: (LONG, [3, 2]), 50720: (LONG, [20, 10])}, None, at(np.s_[2:12], np.s_[3:23])),
    "DefaultCropSize": ({50720: (LONG, [20, 10])}, None, at(np.s_[:10], np.s_[:20])),
    "AsShotNeutral": ({50728: (RATIONAL, [1, 2, 1, 1, 2, 3])}, None, lambda frame: frame.neutral == (0.5, 1, 2 / 3)),
    "BaselineExposure": ({50730: (SRATIONAL, [-1, 2])}, None, lambda frame: frame.baseline_exposure == -0.5),
    "ActiveArea": (MASK, None, at(np.s_[2:30], np.s_[4:40])),
    "MaskedAreas": (  # the camera of these files has no row noise
        MASK | {50830: (LONG, [0, 0, 32, 4])}, None, lambda frame: not frame.notes and at(np.s_[2:30], np.s_[4:40])(frame)
    ),
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
    "DNGBackwardVersion": (
        {50707: (BYTE, [1, 8, 0, 0])},
        "requires DNG version 1.8, but l3 supports only versions up to 1.7",
    ),
    "NewSubFileType": ({254: (LONG, [16])}, "contains no raw image"),
    "BitsPerSample": ({258: (SHORT, [32])}, "LibRaw"),
    "Compression": ({259: (SHORT, [52546])}, "has JPEG XL"),
    "FillOrder": ({266: (SHORT, [2])}, "bits in reverse"),
    "Orientation": ({274: (SHORT, [9])}, "the tag Orientation is 9, but TIFF defines only 1…8"),
    "SamplesPerPixel": ({277: (SHORT, [3]), 262: (SHORT, [34892])}, "already demosaicked"),
    "samples of three": ({277: (SHORT, [3])}, "3 samples per pixel"),
    "TileWidth": (tiled(48, 32), "tiles are wider than the image"),
    "Predictor": ({317: (SHORT, [2])}, "stores differences"),
    "SampleFormat": ({339: (SHORT, [3])}, "floating-point"),
    "CFALayout": ({50711: (SHORT, [3])}, "staggered"),
    "DefaultCropOrigin": ({50719: (LONG, [1, 0])}, r"the default crop \(0, 1, 32, 41\) exceeds the active area of 32×41"),
    "ActiveArea": ({50829: (LONG, [0, 0, 33, 41])}, r"the active area \(0, 0, 33, 41\) exceeds the 32×41 pixels"),
    "ColorimetricReference": ({50879: (SHORT, [1])}, "the values of a developed picture"),
    "SubTileBlockSize": ({50974: (LONG, [2, 2])}, "pixels in blocks"),
    "RowInterleaveFactor": ({50975: (LONG, [0])}, "has damaged tags"),
    "ColumnInterleaveFactor": ({52547: (LONG, [0])}, "has damaged tags"),
    "OpcodeList3": ({51022: opcode_list((2, 0, b""))}, "WarpFisheye"),
}
OF_OTHERS = {  # tags that lie between those of DNG
    "RawImageSegmentation", "AliasLayerMetadata", "IJMetadataByteCounts", "IJMetadata", "RPCCoefficientTag", "SRawType",
    "PanasonicTitle", "PanasonicTitle2", "RSID", "GEO_METADATA", "ProfileIFD", "FibicsXML", "CacheBlob", "CacheVersion",
    "MicroManagerMetadata", "ZIFmetadata", "ZIFannotations",
}  # fmt: skip
HARMLESS = {  # they change no pixel of the mosaic: hints, colours, looks, previews, names, times, checksums
    "NoiseProfile", "BaselineExposureOffset", "BaselineNoise", "BaselineSharpness", "BayerGreenSplit",
    "LinearResponseLimit", "ChromaBlurRadius", "AntiAliasStrength", "ShadowScale", "BestQualityScale",
    "DefaultBlackRender", "NoiseReductionApplied", "RawToPreviewGain", "ColorMatrix1", "ColorMatrix2",
    "ColorMatrix3", "CameraCalibration1", "CameraCalibration2", "CameraCalibration3", "ReductionMatrix1",
    "ReductionMatrix2", "ReductionMatrix3", "ForwardMatrix1", "ForwardMatrix2", "ForwardMatrix3",
    "CalibrationIlluminant1", "CalibrationIlluminant2", "CalibrationIlluminant3", "IlluminantData1", "IlluminantData2",
    "AnalogBalance", "ProfileName", "ProfileCopyright", "ProfileEmbedPolicy", "ProfileGroupName",
    "ProfileCalibrationSignature", "CameraCalibrationSignature", "AsShotProfileName", "ProfileToneCurve",
    "ProfileHueSatMapDims", "ProfileHueSatMapData1", "ProfileHueSatMapData2", "ProfileHueSatMapData3",
    "ProfileHueSatMapEncoding", "ProfileLookTableDims", "ProfileLookTableData", "ProfileLookTableEncoding",
    "ProfileGainTableMap", "ProfileGainTableMap2", "ProfileDynamicRange", "RGBTables", "AsShotICCProfile",
    "AsShotPreProfileMatrix", "CurrentICCProfile", "CurrentPreProfileMatrix", "PreviewApplicationName",
    "PreviewApplicationVersion", "PreviewSettingsName", "PreviewSettingsDigest", "PreviewColorSpace", "PreviewDateTime",
    "DepthFormat", "DepthNear", "DepthFar", "DepthUnits", "DepthMeasureType", "SemanticName", "SemanticInstanceID",
    "MaskSubArea", "EnhanceParams", "DNGVersion", "UniqueCameraModel", "LocalizedCameraModel", "CameraSerialNumber",
    "CameraLabel", "LensInfo", "ReelName", "TimeCodes", "FrameRate", "TStop", "ImageSequenceInfo", "ImageStats",
    "OriginalRawFileName", "OriginalRawFileData", "OriginalRawFileDigest", "OriginalDefaultFinalSize",
    "OriginalBestQualitySize", "OriginalDefaultCropSize", "RawDataUniqueID", "RawImageDigest", "NewRawImageDigest",
    "DNGPrivateData", "MakerNoteSafety", "JXLDistance", "JXLEffort", "JXLDecodeSpeed",
}  # fmt: skip
NOTED: dict[str, tuple[Tags, str]] = {
    "DefaultScale": ({50718: (RATIONAL, [2, 1, 1, 1])}, "pixels are not square (DefaultScale 2, 1)"),
    "OpcodeList3": ({51022: opcode_list((2, 1, b""))}, "WarpFisheye"),
    "DefaultUserCrop": ({51125: (RATIONAL, [1, 4, 0, 1, 1, 1, 1, 1])}, "(DefaultUserCrop) is not applied"),
}


def read(folder: Path, tags: Tags, strips: list[bytes] | None = None) -> RawFrame:
    cols = 40 if tags.get(258) == (SHORT, [12]) else COLS
    return read_raw(dng_files.write_dng(folder / "a.dng", MOSAIC[:, :cols], PATTERN, strips=strips, tags=tags), RGGB)


@pytest.mark.parametrize("name", READ)
def test_what_is_read_changes_the_frame_as_it_states(tmp_path: Path, name: str) -> None:
    tags, strips, holds = READ[name]
    frame = read(tmp_path, tags, strips)
    assert holds(frame)
    assert frame.notes == (TWO_SAMPLES,) * (name == "SamplesPerPixel")


TWO_SAMPLES = "the file has two samples per pixel (dual pixels), and l3 uses only the first sample"
BLACK_LEVELS: dict[
    str, tuple[Tags, float | np.ndarray]
] = {  # of tags as cameras and apps write them; (row, col) of each site
    "four without BlackLevelRepeatDim": ({50714: (RATIONAL, [64, 1] * 4)}, 64),
    "four that differ without BlackLevelRepeatDim": ({50714: (SHORT, [60, 62, 66, 68])}, np.array([[60, 62], [66, 68]])),
    "one beside 2×2": ({50713: (SHORT, [2, 2]), 50714: (SHORT, [32])}, 32),
    "four beside 1×1": ({50713: (SHORT, [1, 1]), 50714: (SHORT, [32] * 4)}, 32),
    "three that are equal": ({50714: (SHORT, [32] * 3)}, 32),
    "BlackLevelRepeatDim of one number": ({50713: (SHORT, [2]), 50714: (SHORT, [32] * 4)}, 32),
    "fractions": ({50714: (RATIONAL, [129, 2])}, 64.5),
    "signed fractions": ({50714: (SRATIONAL, [129, 2])}, 64.5),
    "two samples per pixel": ({277: (SHORT, [2]), 258: (SHORT, [16, 16]), 50714: (SHORT, [32, 40])}, 32),
    "none": ({}, 0),
}


@pytest.mark.parametrize("name", BLACK_LEVELS)
def test_black_levels_as_cameras_write_them(tmp_path: Path, name: str) -> None:
    tags, wanted = BLACK_LEVELS[name]
    strips = [np.stack([MOSAIC, MOSAIC // 2], -1).tobytes()] if 277 in tags else None
    frame = read_raw(
        dng_files.write_dng(tmp_path / "a.dng", MOSAIC, PATTERN, strips=strips, tags=tags, drop=[50714][bool(tags) :]), RGGB
    )
    sites = np.broadcast_to(wanted, (2, 2))[np.arange(ROWS)[:, None] % 2, np.arange(COLS) % 2]
    np.testing.assert_array_equal(frame.values - frame.black_level, MOSAIC - sites)


@pytest.mark.parametrize(
    "tags",
    [
        {50714: (SHORT, [60, 62, 64])},
        {50714: (RATIONAL, [64, 0])},
        {50713: (SHORT, [0, 2]), 50714: (SHORT, [60, 62, 64])},
        {50714: (SHORT, [4096])},
        {50714: (SRATIONAL, [-5, 1])},
        {50715: (SRATIONAL, [2, 1])},
    ],
)
def test_a_black_level_that_cannot_be_told_is_refused_until_it_is_given(tmp_path: Path, tags: Tags) -> None:
    path = dng_files.write_dng(tmp_path / "a.dng", MOSAIC, PATTERN, tags=tags)
    with pytest.raises(InputFileError, match="black_level"):
        read_raw(path, RGGB)
    frame = read_raw(path, RGGB, RawOverrides(black_level=40.0))
    assert the_mosaic(frame)
    assert (frame.black_level, frame.white_level) == (40, 4000)


A, D65, OTHER = (SHORT, [17]), (SHORT, [21]), (SHORT, [255])
SECOND = (SRATIONAL, [part for each in (9, -3, -1, -5, 12, 3, -1, 2, 8) for part in (each, 10)])
MATRIX_1, MATRIX_2 = (np.reshape(each[1][::2], (3, 3)) / 10 for each in (COLOUR_MATRIX, SECOND))
TWICE = (SRATIONAL, [part for each in (2, 0, 0, 0, 1, 0, 0, 0, 1) for part in (each, 1)])
TWICE_RED = np.diag([2.0, 1, 1])


def white(x: float, y: float) -> tuple[int, list[int]]:
    return RATIONAL, [round(x * 100000), 100000, round(y * 100000), 100000]


def halfway() -> tuple[float, float]:
    """The chromaticity of a black body whose reciprocal temperature lies halfway between those of A and D65."""
    light = spectra.illuminant(f"{2 / (1 / 2856 + 1 / 6504):.3f}K", np.arange(380.0, 781.0, 5.0))
    xyz = spectra.xyz_weights(np.arange(380.0, 781.0, 5.0)) @ light
    return float(xyz[0] / xyz.sum()), float(xyz[1] / xyz.sum())


def spectrum_data(order: str) -> bytes:
    """IlluminantData of D65 by its power every 5 nm, first and step as fractions."""
    grid = np.arange(380.0, 781.0, 5.0)
    power = spectra.illuminant("D65", grid) / grid
    values = [1140, 3, 10, 2, *(part for each in power / power.max() for part in (round(each * 10**6), 10**6))]
    return struct.pack(f"{order}HI{len(values)}I", 1, len(grid), *values)


TWO_LIGHTS = {50721: COLOUR_MATRIX, 50722: SECOND, 50778: A, 50779: D65}
SIGNED, OTHERWISE = (ASCII, list(b"one\0")), (ASCII, list(b"two\0"))
WHITES: dict[str, tuple[Tags, tuple[float, float], np.ndarray]] = {  # tags, the white's x and y, matrix times gains
    "below both lights": (TWO_LIGHTS, (0.5, 0.415), MATRIX_1),
    "at the first": (TWO_LIGHTS, (0.44757, 0.40745), MATRIX_1),
    "at the second": (TWO_LIGHTS, (0.3127, 0.329), MATRIX_2),
    "above both": (TWO_LIGHTS, (0.28, 0.29), MATRIX_2),
    "between them": (TWO_LIGHTS, halfway(), (MATRIX_1 + MATRIX_2) / 2),
    "exchanged": (
        {50721: SECOND, 50722: COLOUR_MATRIX, 50778: D65, 50779: A}, halfway(), (MATRIX_1 + MATRIX_2) / 2
    ),
    "one matrix": ({50721: COLOUR_MATRIX, 50778: D65}, (0.44757, 0.40745), MATRIX_1),
    "lights not stated": ({50721: COLOUR_MATRIX, 50722: SECOND}, (0.3127, 0.329), MATRIX_1),
    "another light": (TWO_LIGHTS | {50779: OTHER}, (0.3127, 0.329), MATRIX_1),
    "another light of a chromaticity": (
        TWO_LIGHTS | {50779: OTHER, 52534: (UNDEFINED, list(struct.pack("<H4I", 0, 3127, 10000, 329, 1000)))}, halfway(),
        (MATRIX_1 + MATRIX_2) / 2,
    ),
    "another light of a spectrum": (
        TWO_LIGHTS | {50779: OTHER, 52534: (UNDEFINED, list(spectrum_data("<")))}, halfway(), (MATRIX_1 + MATRIX_2) / 2
    ),
    "a third light of a spectrum, big-endian": (
        TWO_LIGHTS | {50778: OTHER, 50779: OTHER, 52529: OTHER, 52531: SECOND, 52535: (UNDEFINED, list(spectrum_data(">"))),
                      52533: (UNDEFINED, list(struct.pack("<H4I", 0, 44757, 100000, 40745, 100000)))},
        halfway(), (MATRIX_1 + MATRIX_2) / 2,
    ),
    "three lights": (
        TWO_LIGHTS | {52529: (SHORT, [23]), 52531: COLOUR_MATRIX}, (0.3457, 0.3585), MATRIX_1
    ),
    "AnalogBalance": (
        {50721: COLOUR_MATRIX, 50727: (RATIONAL, [2, 1, 1, 1, 1, 1])}, (0.3127, 0.329), TWICE_RED @ MATRIX_1
    ),
    "CameraCalibration": (TWO_LIGHTS | {50723: TWICE, 50724: TWICE}, (0.3127, 0.329), TWICE_RED @ MATRIX_2),
    "CameraCalibration interpolated": (
        TWO_LIGHTS | {50723: TWICE}, halfway(), np.diag([1.5, 1, 1]) @ (MATRIX_1 + MATRIX_2) / 2
    ),
    "CameraCalibration of this profile": (
        TWO_LIGHTS | {50724: TWICE, 50931: SIGNED, 50932: SIGNED}, (0.3127, 0.329), TWICE_RED @ MATRIX_2
    ),
    "CameraCalibration of another profile": (
        TWO_LIGHTS | {50724: TWICE, 50931: SIGNED, 50932: OTHERWISE}, (0.3127, 0.329), MATRIX_2
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", WHITES)
def test_the_grey_of_a_white_that_is_stated_by_its_chromaticity(tmp_path: Path, name: str) -> None:
    """DNG 1.7.1, chapter 6: AnalogBalance · CameraCalibration · ColorMatrix · (x/y, 1, (1 - x - y)/y)."""
    tags, (x, y), matrix = WHITES[name]
    grey = matrix @ (x / y, 1, (1 - x - y) / y)
    frame = read(tmp_path, tags | {50729: white(x, y)})
    assert frame.neutral is not None
    np.testing.assert_allclose(frame.neutral, grey / grey.max(), atol=4e-4)


def test_the_spectrum_of_an_illuminant_is_read_on_a_new_account(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without its cache folder, matplotlib cannot be imported where no file can be written."""
    for variable in ("HOME", "XDG_CONFIG_HOME", "XDG_CACHE_HOME"):
        monkeypatch.setenv(variable, str(tmp_path / "new"))
    monkeypatch.delenv("MPLCONFIGDIR", raising=False)
    isolated._end_child()  # the next process has this environment
    test_the_grey_of_a_white_that_is_stated_by_its_chromaticity(tmp_path, "another light of a spectrum")
    isolated._end_child()


def test_a_white_that_is_none_counts_as_not_stated(tmp_path: Path) -> None:
    for tags in (
        {50721: COLOUR_MATRIX, 50729: white(0.9, 0.4)},
        {50721: COLOUR_MATRIX, 50729: (RATIONAL, [1, 0, 1, 3])},
        {50721: (SRATIONAL, [1, 1] * 4), 50729: white(0.31, 0.33)},
        {50729: white(0.31, 0.33)},
    ):
        assert read(tmp_path, tags).neutral is None
    both = {50721: COLOUR_MATRIX, 50728: (RATIONAL, [1, 2, 1, 1, 2, 3]), 50729: white(0.31, 0.33)}
    assert read(tmp_path, both).neutral == (0.5, 1, 2 / 3)


def test_the_mosaic_is_read_next_to_a_larger_enhanced_image(tmp_path: Path) -> None:
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
    path = dng_files.write_dng(tmp_path / "a.tif", MOSAIC, PATTERN, tags={50975: (LONG, [2])}, drop=drop)
    with pytest.raises(InputFileError, match=r"a\.tif contains a DNG mosaic"):
        read_raw(path, RGGB)


@pytest.mark.parametrize("name", NOTED)
def test_what_is_left_to_the_user_is_reported(tmp_path: Path, name: str) -> None:
    tags, words = NOTED[name]
    frame = read(tmp_path, tags)
    assert the_mosaic(frame)
    (note,) = frame.notes
    assert words in note


def test_the_page_states_what_is_done_with_every_tag_that_counts() -> None:
    text = (ROOT / "docs" / "raw-files.md").read_text()
    _, _, section = text.partition("## Tags of a DNG")
    rows = [line.split("|")[1:3] for line in section.splitlines() if line.startswith("| ")]
    named: dict[str, set[str]] = defaultdict(set)
    for what, tags in rows[1:]:
        named[what.strip()] |= set(re.findall(r"\w+", tags))
    assert named["applies"] == {*READ}
    assert named["rejects"] == {*REFUSED} - {"samples of three"}
    assert named["warns"] == {*NOTED}
    known = {name for code, name in tifffile.TIFF.TAGS.items() if 50706 <= code <= 52555}
    assert known - HARMLESS - set().union(*named.values()) == OF_OTHERS


LIST_1, LIST_2, LIST_3 = 51008, 51009, 51022
STORED_ROWS, STORED_COLS = 40, 60
ACTIVE, CROP = (2, 4, 38, 58), (1, 3, 30, 48)  # top, left, bottom, right; row, column, rows, columns within it
TAGS: Tags = {50829: (LONG, list(ACTIVE)), 50719: (LONG, [CROP[1], CROP[0]]), 50720: (LONG, [CROP[3], CROP[2]])}


@pytest.fixture(scope="module")
def table() -> TransformTable:
    return random_table(BAYER, bits=12, black_level=64.0, patch=3)


def stored() -> np.ndarray:
    rows, cols = np.mgrid[:STORED_ROWS, :STORED_COLS]
    return np.asarray(1000 + 100 * PATTERN[rows % 2, cols % 2], np.uint16)


def with_lists(path: Path, values: np.ndarray, table: TransformTable, tags: Tags) -> RawFrame:
    return read_raw(dng_files.write_dng(path / "a.dng", values, PATTERN, 16, tags=TAGS | tags), table)


def gain_in(frame: RawFrame) -> np.ndarray:
    """What every value is multiplied by, its own part and that of the outputs."""
    assert frame.shading is not None
    colour = 0 if frame.shading.colour is None else frame.shading.colour / 2**FRACTION
    return np.asarray(frame.shading.gain_map(frame.values.shape[1]) * (1 + colour))


def in_view(whole: np.ndarray) -> np.ndarray:
    """What a frame shows of an active area."""
    return whole[CROP[0] : CROP[0] + CROP[2], CROP[1] : CROP[1] + CROP[3]]


def test_bad_pixels_are_corrected_wherever_their_list_counts_from(tmp_path: Path, table: TransformTable) -> None:
    sound = with_lists(tmp_path, stored(), table, {}).values
    values = stored()
    values[[10, 11, 20], [10, 10, 30]] = 7
    values[30:33, 40:42] = 9
    values[15] = 11
    constant = opcode_list((4, 0, struct.pack(">II", 7, 0)))
    listed = struct.pack(">III", 0, 0, 2) + struct.pack(">4I", 30, 40, 33, 42) + struct.pack(">4I", 15, 0, 16, STORED_COLS)
    there = struct.pack(">III", 0, 1, 1) + struct.pack(">2I", 13, 1) + struct.pack(">4I", 28, 36, 31, 38)
    values[15, 5] = 13
    one = opcode_list((4, 0, struct.pack(">II", 7, 0)), (5, 0, listed))
    np.testing.assert_array_equal(with_lists(tmp_path, values, table, {LIST_1: one}).values, sound)
    values[15] = stored()[15]
    values[15, 5] = 13
    np.testing.assert_array_equal(
        with_lists(tmp_path, values, table, {LIST_1: constant, LIST_2: opcode_list((5, 0, there))}).values, sound
    )
    beyond = struct.pack(">III", 0, 1, 1) + struct.pack(">2i", -5, 4000) + struct.pack(">4i", -9, -9, 0, 99999)
    assert with_lists(tmp_path, stored(), table, {LIST_2: opcode_list((5, 0, beyond))}).values.shape == sound.shape


def test_gain_maps_are_gains_of_their_sites_or_planes(tmp_path: Path, table: TransformTable) -> None:
    rows, cols = ACTIVE[2] - ACTIVE[0], ACTIVE[3] - ACTIVE[1]
    rng = np.random.default_rng(2)
    maps = {site: 1 + 0.2 * site[0] + np.cumsum(0.1 * rng.random((3, 4)), axis=1) for site in np.ndindex(2, 2)}
    opcodes = [(9, 0, gain_map(grid, (*site, rows, cols), pitch=(2, 2))) for site, grid in maps.items()]
    frame = with_lists(tmp_path, stored(), table, {LIST_2: opcode_list(*opcodes)})
    y, x = ((np.arange(length) + 0.5) / length for length in (rows, cols))
    wanted = np.zeros((rows, cols))
    for (row, col), grid in maps.items():
        lines = np.array([np.interp(y, np.linspace(0, 1, 3), column) for column in grid.T]).T
        whole = np.array([np.interp(x, np.linspace(0, 1, 4), line) for line in lines])
        wanted[row::2, col::2] = whole[row::2, col::2]
    np.testing.assert_allclose(gain_in(frame), in_view(wanted), rtol=1e-4)
    np.testing.assert_array_equal(frame.values, with_lists(tmp_path, stored(), table, {}).values)

    by_plane = opcode_list((9, 0, gain_map(np.array([[[1.0, 1.2, 1.5]]]), (0, 0, rows, cols), (0, 3))))
    frame = with_lists(tmp_path, stored(), table, {LIST_3: by_plane})
    channel = np.tile(PATTERN, (rows // 2, cols // 2))
    np.testing.assert_allclose(gain_in(frame), in_view(np.array([1.0, 1.2, 1.5])[channel]), rtol=1e-4)


def test_radial_vignetting_is_a_gain_of_all_channels(tmp_path: Path, table: TransformTable) -> None:
    terms = struct.pack(">7d", 0.5, 0.25, 0, 0, 0, 0.5, 0.5)
    frame = with_lists(tmp_path, stored(), table, {LIST_3: opcode_list((3, 1, terms))})
    rows, cols = ACTIVE[2] - ACTIVE[0], ACTIVE[3] - ACTIVE[1]
    y, x = np.arange(rows) + 0.5 - rows / 2, np.arange(cols) + 0.5 - cols / 2
    squared = (y[:, None] ** 2 + x**2) / (rows**2 + cols**2) * 4
    np.testing.assert_allclose(gain_in(frame), in_view(1 + 0.5 * squared + 0.25 * squared**2), rtol=2e-4)
    assert frame.notes == ()


def test_what_moves_pixels_is_refused_or_noted(tmp_path: Path, table: TransformTable, l3: L3, refused: Refused) -> None:
    save(table, tmp_path / "table.h5")
    render = ("render", tmp_path / "table.h5", tmp_path / "a.dng", "-o", tmp_path / "a.png", "--backend", "reference")
    fisheye = struct.pack(">I", 1) + struct.pack(">6d", 1, 0, 0, 0, 0.5, 0.5)
    dng_files.write_dng(tmp_path / "a.dng", stored(), PATTERN, 16, tags={LIST_3: opcode_list((2, 0, fisheye))})
    assert "WarpFisheye" in refused(3, *render)
    dng_files.write_dng(tmp_path / "a.dng", stored(), PATTERN, 16, tags={LIST_3: opcode_list((2, 1, fisheye), (77, 1, b""))})
    code, _, err = l3(*render)
    assert code == 0
    assert "a.dng: the optional correction WarpFisheye in OpcodeList3 is ignored" in err
    assert "a.dng: the optional correction opcode 77 in OpcodeList3 is ignored" in err
    for stage, number in ((LIST_1, 9), (LIST_2, 4), (LIST_3, 5), (LIST_2, 8)):
        dng_files.write_dng(tmp_path / "a.dng", stored(), PATTERN, 16, tags={stage: opcode_list((number, 0, b""))})
        assert "a.dng" in refused(3, *render, "--force")
        assert l3(*render, "--force", "--opcodes", "leave")[0] == 0


def test_opcodes_are_left_out_where_that_is_asked_for(tmp_path: Path, table: TransformTable) -> None:
    """Corrections of brightness are applied. There is a note about each opcode that is not."""
    vignette, warp = struct.pack(">7d", 0.5, 0, 0, 0, 0, 0.5, 0.5), struct.pack(">I8d", 1, 1, 0.1, 0, 0, 0, 0, 0.5, 0.5)
    lists = opcode_list((3, 0, vignette), (2, 0, b""), (8, 0, b""), (1, 0, warp))
    path = dng_files.write_dng(tmp_path / "a.dng", stored(), PATTERN, 16, tags={LIST_3: lists})
    with pytest.raises(InputFileError, match="WarpFisheye in OpcodeList3"):
        read_raw(path, table)
    frame = read_raw(path, table, RawOverrides(opcodes="leave"))
    np.testing.assert_array_equal(frame.values, stored())
    assert frame.shading is not None
    assert [note.split()[3] for note in frame.notes[:2]] == ["WarpFisheye", "MapPolynomial"]
    assert len(frame.notes) == 3
    assert frame.warps == ()


@pytest.mark.parametrize(
    "opcodes",
    [
        (9, 0, b"short"),
        (9, 0, gain_map(np.full((2, 2), np.nan), (0, 0, 9, 9))),
        (9, 0, gain_map(np.zeros((2, 2)), (0, 0, 9, 9))),
        (9, 0, gain_map(np.ones((2, 2)), (0, 0, 9, 9))[:-4]),
        (9, 0, gain_map(np.ones((2, 2)), (0, 0, 9, 9), pitch=(0, 1))),
        (3, 0, struct.pack(">7d", 1e300, 1e300, 0, 0, 0, 0.5, 0.5)),
        (3, 0, struct.pack(">7d", -2, 0, 0, 0, 0, 0.5, 0.5)),
        (3, 0, struct.pack(">7d", np.inf, 0, 0, 0, 0, 0.5, 0.5)),
        (5, 0, struct.pack(">III", 0, 1 << 30, 0)),
    ],
)
def test_damaged_lists_are_refused(tmp_path: Path, table: TransformTable, opcodes: tuple[int, int, bytes]) -> None:
    with pytest.raises(InputFileError, match=r"a\.dng"):
        with_lists(tmp_path, stored(), table, {LIST_2: opcode_list(opcodes)})


def test_lists_that_end_early_or_never_are_refused(tmp_path: Path, table: TransformTable) -> None:
    kind, content = opcode_list((9, 0, gain_map(np.ones((2, 2)), (0, 0, 9, 9))))
    for broken in (content[:-1], content[:6], [0xFF] * 4 + content[4:], [0, 0, 0, 2] + content[4:]):
        with pytest.raises(InputFileError, match=r"a\.dng"):
            with_lists(tmp_path, stored(), table, {LIST_2: (kind, broken)})
    planes = opcode_list((9, 0, gain_map(np.full((1, 1), 2.0), (0, 0, 1 << 31, 1 << 31), (0, (1 << 32) - 1))))
    for tag in (LIST_2, LIST_3):
        assert gain_in(with_lists(tmp_path, stored(), table, {tag: planes})) == pytest.approx(2.0)
