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
from l3cli.io.cfa_codes import channel_codes
from l3cli.io.dng import COLOUR_FILTER_ARRAY

BYTE, ASCII, SHORT, LONG, RATIONAL, SRATIONAL, DOUBLE = 1, 2, 3, 4, 5, 10, 12  # types of TIFF
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
        _tag(254, LONG, [0]),  # NewSubfileType: the full picture
        _tag(33421, SHORT, camera.cfa.shape),  # CFARepeatPatternDim
        _tag(33422, BYTE, codes[camera.cfa].ravel()),  # CFAPattern
        _tag(50710, BYTE, codes[_planes(camera)]),  # CFAPlaneColor
        _tag(50711, SHORT, [1]),  # CFALayout: rectangular
        _tag(50713, SHORT, [1, 1]),  # BlackLevelRepeatDim
        _tag(50714, RATIONAL, [camera.black]),
        _tag(50717, LONG, [camera.white]),
        _tag(50718, RATIONAL, [1, 1]),  # DefaultScale
        _tag(50719, LONG, [0, 0]),  # DefaultCropOrigin
        _tag(50720, LONG, [cols, rows]),  # DefaultCropSize
        _tag(50829, LONG, [0, 0, rows, cols]),  # ActiveArea
    ]


def _colour_tags(camera: CameraModel, colour: RawColour, neutral: NDArray[np.floating] | None) -> list[Tag]:
    tags, planes = [], _planes(camera)
    for index, (light, code) in enumerate(LIGHT_CODES.items()):
        tags.append(_tag(50721 + index, SRATIONAL, colour.matrices[light][planes].ravel()))  # ColorMatrix1, 2
        tags.append(_tag(50778 + index, SHORT, [code]))  # CalibrationIlluminant1, 2
    if neutral is not None:
        tags.append(_tag(50728, RATIONAL, neutral[planes]))  # AsShotNeutral
    full_scale = camera.white - camera.black
    constant, linear, _ = camera.noise_terms
    noise = (linear / full_scale, constant / full_scale**2)  # variance = S · x + O of values x between black and white
    return [*tags, _tag(51041, DOUBLE, noise)]  # NoiseProfile


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
        _text(271, "l3cli"),  # Make
        _text(272, name),  # Model
        _tag(274, SHORT, [1]),  # Orientation
        _tag(33434, RATIONAL, [exposure]),  # ExposureTime
        _tag(33437, RATIONAL, [camera.optics.f_number]),  # FNumber
        _tag(37386, RATIONAL, [camera.optics.focal_length * 1e3]),  # FocalLength
        _tag(50706, BYTE, [1, 4, 0, 0]),  # DNGVersion
        _tag(50707, BYTE, [1, 1, 0, 0]),  # DNGBackwardVersion
        _text(50708, name),  # UniqueCameraModel
    ]


def _tag(code: int, kind: int, numbers: Iterable[float]) -> Tag:
    if kind == DOUBLE:
        values: list[float] = [float(number) for number in numbers]
    elif kind in (RATIONAL, SRATIONAL):
        fractions = [_fraction(float(number)) for number in numbers]
        values = [part for fraction in fractions for part in (fraction.numerator, fraction.denominator)]
    else:
        values = [int(number) for number in numbers]
    count = len(values) // (2 if kind in (RATIONAL, SRATIONAL) else 1)
    return code, kind, count, tuple(values) if len(values) > 1 else values[0], True


def _fraction(number: float) -> Fraction:
    """The nearest fraction whose parts fit into 32 bits."""
    return Fraction(number).limit_denominator(min(FINE, int(LARGEST / max(1.0, abs(number)))))


def _text(code: int, text: str) -> Tag:
    return code, ASCII, 0, text, True
