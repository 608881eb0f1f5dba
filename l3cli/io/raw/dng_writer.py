"""Raw mosaics as DNG 1.4 files that other raw developers open: any colour filter array, matrices of any number of channels.

Nothing in a file depends on when and where it was written.
"""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli import __version__
from l3cli.artifacts.camera import CameraModel
from l3cli.io.raw.cfa_codes import channel_codes
from l3cli.io.raw.tiff_tags import (
    BYTE,
    COLOUR_FILTER_ARRAY,
    DOUBLE,
    LONG,
    RATIONAL,
    RECTANGULAR,
    SHORT,
    SRATIONAL,
    UPRIGHT,
    Entry,
    TiffTag,
    entry,
    text_entry,
)
from l3cli.system.files import write_whole

COLOR_MATRICES = (TiffTag.COLOR_MATRIX_1, TiffTag.COLOR_MATRIX_2)
ILLUMINANTS = (TiffTag.CALIBRATION_ILLUMINANT_1, TiffTag.CALIBRATION_ILLUMINANT_2)
LIGHT_CODES = {"A": 17, "D65": 21}  # of CalibrationIlluminant (EXIF LightSource), in the order of the matrices


@dataclass(frozen=True)
class RawColour:
    """A camera's colours: M (channel, 3) from XYZ to channels under each of LIGHT_CODES."""

    matrices: Mapping[str, NDArray[np.floating]]


def write_dng(
    path: Path,
    values: NDArray[np.uint16],
    camera: CameraModel,
    colour: RawColour,
    neutral: NDArray[np.floating] | None,
    exposure: float,
) -> None:
    """A mosaic (row, col) in DN, CFA phase (0, 0), exposed for `exposure` s; `neutral` (channel): what grey gives, if known.

    The file appears whole or not at all.
    """
    import tifffile

    mosaic, seen = _mosaic_tags(camera, values.shape), _colour_tags(camera, colour, neutral)
    tags = sorted([*mosaic, *seen, *_shot(camera, exposure)])
    content = io.BytesIO()  # not the file: tifffile leaves the reason out where a disk is full
    tifffile.imwrite(
        content,
        values,
        byteorder="<",
        photometric=COLOUR_FILTER_ARRAY,
        rowsperstrip=values.shape[0],
        metadata=None,
        software=f"l3cli {__version__}",
        extratags=tags,
    )
    write_whole(path, content.getbuffer())


def _mosaic_tags(camera: CameraModel, shape: Sequence[int]) -> list[Entry]:
    rows, cols = shape
    codes = channel_codes(camera.channels)
    return [
        entry(TiffTag.NEW_SUBFILE_TYPE, LONG, [0]),  # the full picture
        entry(TiffTag.CFA_REPEAT_PATTERN_DIM, SHORT, camera.cfa.shape),
        entry(TiffTag.CFA_PATTERN, BYTE, codes[camera.cfa].ravel()),
        entry(TiffTag.CFA_PLANE_COLOR, BYTE, codes[_planes(camera)]),
        entry(TiffTag.CFA_LAYOUT, SHORT, [RECTANGULAR]),
        entry(TiffTag.BLACK_LEVEL_REPEAT_DIM, SHORT, [1, 1]),
        entry(TiffTag.BLACK_LEVEL, RATIONAL, [camera.black_level]),
        entry(TiffTag.WHITE_LEVEL, LONG, [camera.white_level]),
        entry(TiffTag.DEFAULT_SCALE, RATIONAL, [1, 1]),
        entry(TiffTag.DEFAULT_CROP_ORIGIN, LONG, [0, 0]),
        entry(TiffTag.DEFAULT_CROP_SIZE, LONG, [cols, rows]),
        entry(TiffTag.ACTIVE_AREA, LONG, [0, 0, rows, cols]),
    ]


def _colour_tags(camera: CameraModel, colour: RawColour, neutral: NDArray[np.floating] | None) -> list[Entry]:
    tags, planes = [], _planes(camera)
    for index, (light, code) in enumerate(LIGHT_CODES.items()):
        tags.append(entry(COLOR_MATRICES[index], SRATIONAL, colour.matrices[light][planes].ravel()))
        tags.append(entry(ILLUMINANTS[index], SHORT, [code]))
    if neutral is not None:
        tags.append(entry(TiffTag.AS_SHOT_NEUTRAL, RATIONAL, neutral[planes]))
    full_scale = camera.white_level - camera.black_level
    constant, linear, _ = camera.noise_terms()
    noise = (linear / full_scale, constant / full_scale**2)  # variance = S · x + O of values x between black and white level
    return [*tags, entry(TiffTag.NOISE_PROFILE, DOUBLE, noise)]


def _planes(camera: CameraModel) -> list[int]:
    """Return the channels in the order of the colour planes: of three, what most pixels have in the middle, for most
    developers interpolate the second plane on the quincunx that green has in a Bayer array."""
    planes = list(range(len(camera.channels)))
    if len(planes) == 3:
        commonest = int(np.bincount(camera.cfa.ravel(), minlength=3).argmax())
        planes.remove(commonest)
        planes.insert(1, commonest)
    return planes


def _shot(camera: CameraModel, exposure: float) -> list[Entry]:
    name = camera.name.encode("ascii", "replace").decode()
    return [
        text_entry(TiffTag.MAKE, "l3cli"),
        text_entry(TiffTag.MODEL, name),
        entry(TiffTag.ORIENTATION, SHORT, [UPRIGHT]),
        entry(TiffTag.EXPOSURE_TIME, RATIONAL, [exposure]),
        entry(TiffTag.F_NUMBER, RATIONAL, [camera.optics.f_number]),
        entry(TiffTag.FOCAL_LENGTH, RATIONAL, [camera.optics.focal_length * 1e3]),
        entry(TiffTag.DNG_VERSION, BYTE, [1, 4, 0, 0]),
        entry(TiffTag.DNG_BACKWARD_VERSION, BYTE, [1, 1, 0, 0]),
        text_entry(TiffTag.UNIQUE_CAMERA_MODEL, name),
    ]
