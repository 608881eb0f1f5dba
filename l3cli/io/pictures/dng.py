"""Write DNG 1.4 files for raw converters.

Rendered frames are written in linear Rec. 2020, either with three channels per pixel or as a Bayer mosaic, so that raw
converters treat them like files from a camera (docs/method.md#display). A white surface has equal values in all channels.
The values are not scaled for display. Instead, the tag BaselineExposure contains the exposure that l3 would apply.

Raw mosaics can have any colour filter array and any number of channels.
"""

import io
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import log2
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli import __version__
from l3cli.artifacts.camera import CameraModel
from l3cli.frames.frame import Shot
from l3cli.io.pictures.icc import D50
from l3cli.io.pictures.registry import Label, Picture
from l3cli.io.raw.cfa_codes import channel_codes
from l3cli.io.tags import (
    BYTE,
    COLOUR_FILTER_ARRAY,
    DOUBLE,
    LINEAR_RAW,
    LONG,
    RATIONAL,
    RECTANGULAR,
    SHORT,
    SRATIONAL,
    UPRIGHT,
    Entry,
    entry,
    shot_entries,
    text_entry,
)
from l3cli.physics.mosaic import tiled
from l3cli.physics.spaces import REC2020, adaptation_matrix
from l3cli.system.files import write_whole


def _file(values: NDArray[np.uint16], software: str, tags: list[Entry], camera: str) -> bytes:
    """Encode a mosaic, (row, col), or a picture, (row, col, 3), as a DNG file.

    `tags` are added to the tags that all DNG files from l3 contain. `camera` is the value of UniqueCameraModel.
    """
    import tifffile

    rows, cols, *channels = values.shape
    tags = [
        entry("NewSubfileType", LONG, [0]),  # 0 means a full-size image
        entry("Orientation", SHORT, [UPRIGHT]),
        entry("BlackLevelRepeatDim", SHORT, [1, 1]),
        entry("DefaultScale", RATIONAL, [1, 1]),
        entry("DefaultCropOrigin", LONG, [0, 0]),
        entry("DefaultCropSize", LONG, [cols, rows]),
        entry("ActiveArea", LONG, [0, 0, rows, cols]),
        entry("DNGVersion", BYTE, [1, 4, 0, 0]),
        entry("DNGBackwardVersion", BYTE, [1, 1, 0, 0]),
        text_entry("Make", "l3cli"),
        text_entry("UniqueCameraModel", camera),
        *tags,
    ]
    content = io.BytesIO()  # tifffile would not report a full disk
    tifffile.imwrite(
        content,
        values,
        byteorder="<",
        photometric=LINEAR_RAW if channels else COLOUR_FILTER_ARRAY,
        planarconfig="contig" if channels else None,
        rowsperstrip=rows,
        metadata=None,
        software=software,
        extratags=sorted(tags),
    )
    return content.getvalue()


def _mosaic_tags(pattern: NDArray[np.integer], planes: Sequence[int]) -> list[Entry]:
    """Return the tags that describe a CFA.

    `pattern` (row, col) contains the colour code of each site. `planes` (plane) contains the colour code of each plane.
    """
    return [
        entry("CFARepeatPatternDim", SHORT, pattern.shape),
        entry("CFAPattern", BYTE, pattern.ravel()),
        entry("CFAPlaneColor", BYTE, planes),
        entry("CFALayout", SHORT, [RECTANGULAR]),
    ]


# ------------------------------------------------------------------------------------------------ rendered frames

MOSAICS = ("bayer",)
RGGB = np.array([[0, 1], [1, 2]])
# The black level is 0, because for pixels with three channels, LibRaw does not subtract it from the white level.
BLACK_LEVEL, WHITE_LEVEL = 0, 65535  # DN
HEADROOM = 2.0  # linear value stored as WHITE_LEVEL; above 1, because l3 estimates values above 1 in clipped areas
D65_CODE = 21  # value of CalibrationIlluminant for D65
CAMERA = "linear Rec. 2020"  # value of the tag Model


def raw_values(linear: NDArray[np.floating], mosaic: str | None) -> NDArray[np.uint16]:
    """Convert linear Rec. 2020 values, (row, col, 3), to DN.

    The result is a picture, (row, col, 3), or a Bayer mosaic, (row, col), if `mosaic` is "bayer".
    """
    if mosaic is not None:
        linear = np.take_along_axis(linear, tiled(RGGB, linear.shape)[..., None], axis=2)[..., 0]
    return np.clip(np.rint(linear * (WHITE_LEVEL / HEADROOM)), BLACK_LEVEL, WHITE_LEVEL).astype(np.uint16)


def encode(path: Path, picture: Picture) -> bytes:
    """Encode a rendered frame as a DNG file. The pixels must come from `raw_values`."""
    values = picture.pixels
    channels = 1 if values.ndim == 2 else values.shape[2]
    to_connection_space = adaptation_matrix(REC2020.neutral_xyz, D50) @ REC2020.to_xyz
    tags = [
        entry("BlackLevel", LONG, [BLACK_LEVEL] * channels),
        entry("WhiteLevel", LONG, [WHITE_LEVEL] * channels),
        entry("ColorMatrix1", SRATIONAL, REC2020.from_xyz.ravel()),
        entry("ForwardMatrix1", SRATIONAL, to_connection_space.ravel()),
        entry("CalibrationIlluminant1", SHORT, [D65_CODE]),
        entry("AsShotNeutral", RATIONAL, [1, 1, 1]),
        entry("BaselineExposure", SRATIONAL, [log2(picture.exposure_scale * HEADROOM)]),
        *(_mosaic_tags(RGGB, range(3)) if values.ndim == 2 else []),
        *_label_tags(picture.label),
    ]
    return _file(values, picture.label.software, tags, f"l3cli {CAMERA}")


def _label_tags(label: Label) -> list[Entry]:
    """Return the tags with the metadata of the raw frame and of the transform table.

    Make and Model do not name the original camera, because raw converters would then apply its colour matrices.
    """
    shot = label.shot
    description = ", ".join(filter(None, (" ".join(filter(None, (shot.make, shot.model))), label.description)))
    tags = [text_entry("Model", CAMERA), *shot_entries(replace(shot, make="", model=""), label.exposure)]
    return tags + ([text_entry("ImageDescription", description)] if description else [])


# --------------------------------------------------------------------------------------------------- raw mosaics

LIGHT_CODES = {"A": 17, "D65": 21}  # illuminants of ColorMatrix1 and 2 → values of CalibrationIlluminant


def write_dng(
    path: Path,
    values: NDArray[np.uint16],
    camera: CameraModel,
    matrices: Mapping[str, NDArray[np.floating]],
    neutral: NDArray[np.floating] | None,
    exposure: float,
) -> None:
    """Write a raw mosaic atomically as a DNG file.

    Parameters
    ----------
    path : Path
        The file.
    values : ndarray, (row, col)
        Mosaic in DN. The first pixel is CFA site (0, 0).
    camera : CameraModel
        The camera.
    matrices : mapping of str to ndarray, (channel, 3)
        Colour matrix, from XYZ to channel signals, for each illuminant in LIGHT_CODES.
    neutral : ndarray, (channel,), or None
        Signal of a grey surface in each channel, or None if unknown.
    exposure : float
        Exposure time in s.
    """
    name, planes, codes = camera.name, _planes(camera), channel_codes(camera.channels)
    full_scale = camera.white_level - camera.black_level
    constant, linear, _ = camera.noise_terms()
    # Slope and intercept of the noise variance, with signals from 0 (black) to 1 (white).
    noise = (linear / full_scale, constant / full_scale**2)
    iso = camera.gains.iso if camera.gains else 0.0
    shot = Shot(model=name, f_number=camera.optics.f_number, focal_length=camera.optics.focal_length * 1e3, iso=iso)
    tags = [
        entry("BlackLevel", RATIONAL, [camera.black_level]),
        entry("WhiteLevel", LONG, [camera.white_level]),
        *_mosaic_tags(codes[camera.cfa], codes[planes].tolist()),
        entry("NoiseProfile", DOUBLE, noise),
        *shot_entries(shot, exposure),
    ]
    for number, (light, code) in enumerate(LIGHT_CODES.items(), 1):
        tags.append(entry(f"ColorMatrix{number}", SRATIONAL, matrices[light][planes].ravel()))
        tags.append(entry(f"CalibrationIlluminant{number}", SHORT, [code]))
    if neutral is not None:
        tags.append(entry("AsShotNeutral", RATIONAL, neutral[planes]))
    write_whole(path, _file(values, f"l3cli {__version__}", tags, name))


def _planes(camera: CameraModel) -> list[int]:
    """Return the channel index of each colour plane.

    Of three channels, the one with the most pixels becomes the second plane, because most raw converters assume that the
    second plane is the green channel of a Bayer CFA.
    """
    planes = list(range(len(camera.channels)))
    if len(planes) == 3:
        commonest = int(np.bincount(camera.cfa.ravel(), minlength=3).argmax())
        planes.remove(commonest)
        planes.insert(1, commonest)
    return planes
