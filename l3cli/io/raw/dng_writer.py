"""Raw mosaics as DNG 1.4 files that other raw developers open: any colour filter array, matrices of any number of channels.

Nothing in a file depends on when and where it was written.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli import __version__
from l3cli.artifacts.camera import CameraModel
from l3cli.files import atomic_output
from l3cli.io.raw.cfa_codes import channel_codes
from l3cli.io.raw.tiff_tags import (
    ASCII,
    BYTE,
    COLOUR_FILTER_ARRAY,
    DOUBLE,
    FRACTIONS,
    LONG,
    RATIONAL,
    RECTANGULAR,
    SHORT,
    SRATIONAL,
    UPRIGHT,
    TiffTag,
)

COLOR_MATRICES = (TiffTag.COLOR_MATRIX_1, TiffTag.COLOR_MATRIX_2)
ILLUMINANTS = (TiffTag.CALIBRATION_ILLUMINANT_1, TiffTag.CALIBRATION_ILLUMINANT_2)
LIGHT_CODES = {"A": 17, "D65": 21}  # of CalibrationIlluminant (EXIF LightSource), in the order of the matrices
FINE = 10**9  # denominator at most
LARGEST = 2**31 - 1  # of numerator and denominator
Tag = tuple[int, int, int, object, bool]


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
    with atomic_output(path) as temporary:
        tifffile.imwrite(
            temporary,
            values,
            byteorder="<",
            photometric=COLOUR_FILTER_ARRAY,
            rowsperstrip=values.shape[0],
            metadata=None,
            software=f"l3cli {__version__}",
            extratags=tags,
        )


def _mosaic_tags(camera: CameraModel, shape: Sequence[int]) -> list[Tag]:
    rows, cols = shape
    codes = channel_codes(camera.channels)
    return [
        _tag(TiffTag.NEW_SUBFILE_TYPE, LONG, [0]),  # the full picture
        _tag(TiffTag.CFA_REPEAT_PATTERN_DIM, SHORT, camera.cfa.shape),
        _tag(TiffTag.CFA_PATTERN, BYTE, codes[camera.cfa].ravel()),
        _tag(TiffTag.CFA_PLANE_COLOR, BYTE, codes[_planes(camera)]),
        _tag(TiffTag.CFA_LAYOUT, SHORT, [RECTANGULAR]),
        _tag(TiffTag.BLACK_LEVEL_REPEAT_DIM, SHORT, [1, 1]),
        _tag(TiffTag.BLACK_LEVEL, RATIONAL, [camera.black_level]),
        _tag(TiffTag.WHITE_LEVEL, LONG, [camera.white_level]),
        _tag(TiffTag.DEFAULT_SCALE, RATIONAL, [1, 1]),
        _tag(TiffTag.DEFAULT_CROP_ORIGIN, LONG, [0, 0]),
        _tag(TiffTag.DEFAULT_CROP_SIZE, LONG, [cols, rows]),
        _tag(TiffTag.ACTIVE_AREA, LONG, [0, 0, rows, cols]),
    ]


def _colour_tags(camera: CameraModel, colour: RawColour, neutral: NDArray[np.floating] | None) -> list[Tag]:
    tags, planes = [], _planes(camera)
    for index, (light, code) in enumerate(LIGHT_CODES.items()):
        tags.append(_tag(COLOR_MATRICES[index], SRATIONAL, colour.matrices[light][planes].ravel()))
        tags.append(_tag(ILLUMINANTS[index], SHORT, [code]))
    if neutral is not None:
        tags.append(_tag(TiffTag.AS_SHOT_NEUTRAL, RATIONAL, neutral[planes]))
    full_scale = camera.white_level - camera.black_level
    constant, linear, _ = camera.noise_terms()
    noise = (linear / full_scale, constant / full_scale**2)  # variance = S · x + O of values x between black and white level
    return [*tags, _tag(TiffTag.NOISE_PROFILE, DOUBLE, noise)]


def _planes(camera: CameraModel) -> list[int]:
    """The channels in the order of the colour planes: of three, what most pixels have in the middle, for most developers
    interpolate the second plane on the quincunx that green has in a Bayer array."""
    planes = list(range(len(camera.channels)))
    if len(planes) == 3:
        commonest = int(np.bincount(camera.cfa.ravel(), minlength=3).argmax())
        planes.remove(commonest)
        planes.insert(1, commonest)
    return planes


def _shot(camera: CameraModel, exposure: float) -> list[Tag]:
    name = camera.name.encode("ascii", "replace").decode()
    return [
        _text(TiffTag.MAKE, "l3cli"),
        _text(TiffTag.MODEL, name),
        _tag(TiffTag.ORIENTATION, SHORT, [UPRIGHT]),
        _tag(TiffTag.EXPOSURE_TIME, RATIONAL, [exposure]),
        _tag(TiffTag.F_NUMBER, RATIONAL, [camera.optics.f_number]),
        _tag(TiffTag.FOCAL_LENGTH, RATIONAL, [camera.optics.focal_length * 1e3]),
        _tag(TiffTag.DNG_VERSION, BYTE, [1, 4, 0, 0]),
        _tag(TiffTag.DNG_BACKWARD_VERSION, BYTE, [1, 1, 0, 0]),
        _text(TiffTag.UNIQUE_CAMERA_MODEL, name),
    ]


def _tag(code: int, kind: int, numbers: Iterable[float]) -> Tag:
    if kind == DOUBLE:
        values: list[float] = [float(number) for number in numbers]
    elif kind in FRACTIONS:
        fractions = [_fraction(float(number)) for number in numbers]
        values = [part for fraction in fractions for part in (fraction.numerator, fraction.denominator)]
    else:
        values = [int(number) for number in numbers]
    count = len(values) // (2 if kind in FRACTIONS else 1)
    return code, kind, count, tuple(values) if len(values) > 1 else values[0], True


def _fraction(number: float) -> Fraction:
    """The nearest fraction whose parts fit into 32 bits."""
    return Fraction(number).limit_denominator(min(FINE, int(LARGEST / max(1.0, abs(number)))))


def _text(code: int, text: str) -> Tag:
    return code, ASCII, 0, text, True
