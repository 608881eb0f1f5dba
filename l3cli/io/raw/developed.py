"""Rendered frames as DNG 1.4 files that raw developers take for a camera's own: three linear channels at every pixel, or one
of them at each in a Bayer mosaic (docs/method.md#display).

The channels are those of Rec. 2020, in which the scene's white is equal in all three. Exposure is left to the developer:
the file states what ours would be.
"""

import io
from collections.abc import Sequence
from dataclasses import replace
from math import log2

import numpy as np
from numpy.typing import NDArray

from l3cli.io.icc import D50
from l3cli.io.label import Label
from l3cli.io.raw.shot import entries_of
from l3cli.io.raw.tiff_tags import (
    BYTE,
    COLOUR_FILTER_ARRAY,
    LINEAR_RAW,
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
from l3cli.physics.spaces import REC2020, adaptation_matrix

MOSAICS = ("bayer",)
RGGB = np.array([[0, 1], [1, 2]])
BLACK_LEVEL, WHITE_LEVEL = 0, 65535  # DN; LibRaw takes another black level off pixels of three channels, but not off white
HEADROOM = 2.0  # value at white level: clipped areas are estimated to be brighter than 1, which is full scale of the sensor
D65_CODE = 21  # of CalibrationIlluminant
CAMERA = "l3cli linear Rec. 2020"


def raw_values(linear: NDArray[np.floating], mosaic: str | None) -> NDArray[np.uint16]:
    """Return DN (row, col, 3) of linear Rec. 2020 values (row, col, 3), or (row, col) of a `mosaic` of them."""
    if mosaic is not None:
        sites = np.tile(RGGB, [-(-length // 2) for length in linear.shape[:2]])[: linear.shape[0], : linear.shape[1]]
        linear = np.take_along_axis(linear, sites[..., None], axis=2)[..., 0]
    return np.clip(np.rint(linear * (WHITE_LEVEL / HEADROOM)), BLACK_LEVEL, WHITE_LEVEL).astype(np.uint16)


def dng_file(values: NDArray[np.uint16], exposure_scale: float, label: Label) -> bytes:
    """Return the file of `raw_values`, upright; `exposure_scale`: factor of what should be shown with 1 as white."""
    import tifffile

    is_mosaic = values.ndim == 2
    tags = [*_pixel_tags(values.shape), *_colour_tags(exposure_scale), *_shot_tags(label)]
    content = io.BytesIO()
    tifffile.imwrite(
        content,
        values,
        byteorder="<",
        photometric=COLOUR_FILTER_ARRAY if is_mosaic else LINEAR_RAW,
        planarconfig=None if is_mosaic else "contig",
        rowsperstrip=values.shape[0],
        metadata=None,
        software=label.software,
        extratags=sorted(tags + (_mosaic_tags() if is_mosaic else [])),
    )
    return content.getvalue()


def _pixel_tags(shape: Sequence[int]) -> list[Entry]:
    rows, cols = shape[:2]
    channels = 1 if len(shape) == 2 else shape[2]
    return [
        entry(TiffTag.NEW_SUBFILE_TYPE, LONG, [0]),  # the full picture
        entry(TiffTag.ORIENTATION, SHORT, [UPRIGHT]),
        entry(TiffTag.BLACK_LEVEL_REPEAT_DIM, SHORT, [1, 1]),
        entry(TiffTag.BLACK_LEVEL, LONG, [BLACK_LEVEL] * channels),
        entry(TiffTag.WHITE_LEVEL, LONG, [WHITE_LEVEL] * channels),
        entry(TiffTag.DEFAULT_SCALE, RATIONAL, [1, 1]),
        entry(TiffTag.DEFAULT_CROP_ORIGIN, LONG, [0, 0]),
        entry(TiffTag.DEFAULT_CROP_SIZE, LONG, [cols, rows]),
        entry(TiffTag.ACTIVE_AREA, LONG, [0, 0, rows, cols]),
        entry(TiffTag.DNG_VERSION, BYTE, [1, 4, 0, 0]),
        entry(TiffTag.DNG_BACKWARD_VERSION, BYTE, [1, 1, 0, 0]),
    ]


def _mosaic_tags() -> list[Entry]:
    return [
        entry(TiffTag.CFA_REPEAT_PATTERN_DIM, SHORT, RGGB.shape),
        entry(TiffTag.CFA_PATTERN, BYTE, RGGB.ravel()),
        entry(TiffTag.CFA_PLANE_COLOR, BYTE, range(3)),
        entry(TiffTag.CFA_LAYOUT, SHORT, [RECTANGULAR]),
    ]


def _colour_tags(exposure_scale: float) -> list[Entry]:
    to_connection_space = adaptation_matrix(REC2020.neutral_xyz, D50) @ REC2020.to_xyz
    return [
        entry(TiffTag.COLOR_MATRIX_1, SRATIONAL, REC2020.from_xyz.ravel()),
        entry(TiffTag.FORWARD_MATRIX_1, SRATIONAL, to_connection_space.ravel()),
        entry(TiffTag.CALIBRATION_ILLUMINANT_1, SHORT, [D65_CODE]),
        entry(TiffTag.AS_SHOT_NEUTRAL, RATIONAL, [1, 1, 1]),
        entry(TiffTag.BASELINE_EXPOSURE, SRATIONAL, [log2(exposure_scale * HEADROOM)]),
    ]


def _shot_tags(label: Label) -> list[Entry]:
    """Return the tags of the shot. The camera is another one: developers would use its matrices for these channels."""
    camera = " ".join(filter(None, (label.shot.make, label.shot.model)))
    texts = {
        TiffTag.MAKE: "l3cli",
        TiffTag.MODEL: "linear Rec. 2020",
        TiffTag.UNIQUE_CAMERA_MODEL: CAMERA,
        TiffTag.IMAGE_DESCRIPTION: ", ".join(filter(None, (camera, label.description))),
    }
    tags = [text_entry(code, text) for code, text in texts.items() if text]
    return tags + entries_of(replace(label.shot, make="", model=""), label.exposure)
