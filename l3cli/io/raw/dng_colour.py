"""Read colour tags in DNG files: the colour matrices, and the signals of a grey surface under the file's white point.

According to DNG 1.7.1, chapter 6, a white surface under light with the chromaticity x, y produces the signals
AB · CC · CM · (x/y, 1, (1 - x - y)/y). AB is AnalogBalance. CM is interpolated between ColorMatrix1, 2 and 3, and CC between
CameraCalibration1, 2 and 3, both linearly in the reciprocal of the correlated colour temperature.
"""

import contextlib
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.io.tags import BROKEN, numbers
from l3cli.physics import spectra

Array = NDArray[np.float64]

OTHER_LIGHT = 255  # value of CalibrationIlluminant for an illuminant described by IlluminantData
KELVIN = {  # value of CalibrationIlluminant (Exif LightSource) → correlated colour temperature in K
    1: 5500.0, 2: 4150.0, 3: 2856.0, 4: 5500.0, 9: 5500.0, 10: 6504.0, 11: 7504.0, 12: 6400.0, 13: 5050.0, 14: 4150.0,
    15: 3525.0, 16: 2925.0, 17: 2856.0, 18: 4874.0, 19: 6774.0, 20: 5503.0, 21: 6504.0, 22: 7504.0, 23: 5003.0, 24: 3200.0,
}  # fmt: skip
MIREDS = np.arange(40.0, 1000.0, 0.25)  # search grid of reciprocal colour temperatures, in mired (10^-6/K)
DECIMALS = 4  # decimals of a camera neutral that is computed from AsShotWhiteXY, as many as AsShotNeutral has
# Tag numbers of IlluminantData1, 2 and 3, because the third number in tifffile is wrong.
ILLUMINANT_DATA = {1: 52533, 2: 52534, 3: 52535}
# Types of IlluminantData. Chromaticity: x and y. Spectrum: first wavelength in nm, step in nm, and power at each wavelength.
CHROMATICITY, SPECTRUM = 0, 1


@dataclass(frozen=True)
class Calibration:
    """Matrices in a DNG file for one illuminant."""

    light: int  # value of CalibrationIlluminant; 0 if the file does not name the illuminant
    kelvin: float | None  # correlated colour temperature of the illuminant in K; None if unknown
    colour: Array  # (plane, 3) matrix from XYZ to the signals of the reference camera
    camera: Array  # (plane, plane) matrix from reference signals to signals of this camera


def calibrations(first: Any, planes: int) -> list[Calibration]:
    """Return the calibrations on a DNG file's first page. `planes` is the number of colour planes.

    Missing and damaged calibrations are omitted, so the result may be empty.
    """
    tags, found = first.tags, []
    ours = tags.valueof("CameraCalibrationSignature", "") == tags.valueof("ProfileCalibrationSignature", "")
    for number in (1, 2, 3):
        with contextlib.suppress(*BROKEN):
            colour = np.reshape(numbers(first, f"ColorMatrix{number}", ()), (planes, 3)).astype(np.float64)
            stated = numbers(first, f"CameraCalibration{number}", np.eye(planes)) if ours else np.eye(planes)
            balance = np.reshape(numbers(first, "AnalogBalance", np.ones(planes)), (planes, 1)).astype(np.float64)
            camera = balance * np.reshape(stated, (planes, planes))
            light = int(tags.valueof(f"CalibrationIlluminant{number}") or 0)
            other = _white_of(tags.valueof(ILLUMINANT_DATA[number])) if light == OTHER_LIGHT else None
            found.append(Calibration(light, KELVIN.get(light) if other is None else temperature(*other), colour, camera))
    return found


def as_shot_neutral(first: Any, planes: int) -> Array | None:
    """Return the signal of a grey surface in each colour plane, (plane,), from AsShotNeutral or AsShotWhiteXY.

    Returns None if both tags are missing or damaged, or if the file lacks the colour matrix for converting AsShotWhiteXY to
    signals.
    """
    with contextlib.suppress(*BROKEN):
        stated = np.asarray(numbers(first, "AsShotNeutral", ()), np.float64)
        if _is_neutral(stated, planes):
            return stated
    with contextlib.suppress(*BROKEN):
        x, y = numbers(first, "AsShotWhiteXY", (0.0, 0.0))
        known = calibrations(first, planes)
        if known and _is_white(x, y):
            colour, camera = interpolated(known, temperature(x, y))
            signals = camera @ colour @ np.array([x / y, 1.0, (1.0 - x - y) / y])
            signals = np.round(signals / signals.max(), DECIMALS)
            return signals if _is_neutral(signals, planes) else None
    return None


def interpolated(known: Sequence[Calibration], kelvin: float) -> tuple[Array, Array]:
    """Return the colour matrix and the camera matrix for a correlated colour temperature in K.

    The matrices are interpolated linearly in the reciprocal temperature, and are constant beyond the outermost calibrations.
    If fewer than two calibrations have a known temperature, the matrices of the first one are returned. `known` must not be
    empty.
    """
    placed = {1e6 / each.kelvin: each for each in known if each.kelvin is not None}  # reciprocal temperature → calibration
    mireds = np.array(sorted(placed))
    if len(mireds) < 2:
        return known[0].colour, known[0].camera
    mired = np.clip(1e6 / kelvin, mireds[0], mireds[-1])
    after = int(np.clip(np.searchsorted(mireds, mired), 1, len(mireds) - 1))
    below, above = placed[mireds[after - 1]], placed[mireds[after]]
    part = (mired - mireds[after - 1]) / (mireds[after] - mireds[after - 1])
    return (1 - part) * below.colour + part * above.colour, (1 - part) * below.camera + part * above.camera


def temperature(x: float, y: float) -> float:
    """Compute the correlated colour temperature, in K, of a chromaticity x, y.

    It is the temperature of the nearest black body in the CIE 1960 u, v diagram, from 1000 K to 25 000 K.

    References
    ----------
    M. Krystek, An algorithm to calculate correlated colour temperature, Color Research & Application 10 (1985) 38-40:
    u and v of black bodies as rational functions of temperature.
    """
    kelvin = 1e6 / MIREDS
    locus_u = (0.860117757 + 1.54118254e-4 * kelvin + 1.28641212e-7 * kelvin**2) / (
        1 + 8.42420235e-4 * kelvin + 7.08145163e-7 * kelvin**2
    )
    locus_v = (0.317398726 + 4.22806245e-5 * kelvin + 4.20481691e-8 * kelvin**2) / (
        1 - 2.89741816e-5 * kelvin + 1.61456053e-7 * kelvin**2
    )
    below = -2 * x + 12 * y + 3
    return float(kelvin[np.argmin((locus_u - 4 * x / below) ** 2 + (locus_v - 6 * y / below) ** 2)])


def _white_of(content: Any) -> tuple[float, float] | None:
    """Return the chromaticity x, y of the illuminant in IlluminantData, which contains either x and y or a spectrum.

    Both byte orders are tried. Returns None if the data are missing or damaged.
    """
    for order in "<>":
        with contextlib.suppress(*BROKEN):
            (kind,) = struct.unpack_from(f"{order}H", bytes(content))
            if kind == CHROMATICITY:
                x, y = _fractions(bytes(content), order, 2, 2)
            elif kind == SPECTRUM:
                (count,) = struct.unpack_from(f"{order}I", bytes(content), 2)
                first, step, *power = _fractions(bytes(content), order, 6, 2 + count)
                x, y = _chromaticity(first + step * np.arange(count), np.array(power))
            else:
                continue
            if _is_white(x, y):
                return x, y
    return None


def _fractions(content: bytes, order: str, start: int, count: int) -> list[float]:
    """Read `count` unsigned fractions (pairs of 32-bit integers), starting at byte `start`."""
    parts = struct.unpack_from(f"{order}{2 * count}I", content, start)
    return [above / below for above, below in zip(parts[::2], parts[1::2], strict=True)]


def _chromaticity(wavelength: Array, power: Array) -> tuple[float, float]:
    """Return the chromaticity x, y of a power spectrum. The power is assumed to be 0 outside the wavelengths (in nm)."""
    grid = np.arange(360.0, 831.0)
    x, y, z = map(float, spectra.colour_matching_functions(grid) @ np.interp(grid, wavelength, power, 0.0, 0.0))
    return x / (x + y + z), y / (x + y + z)


def _is_white(x: float, y: float) -> bool:
    return bool(x > 0.01 and y > 0.01 and x + y < 1)


def _is_neutral(signals: Array, planes: int) -> bool:
    return len(signals) == planes and bool(np.isfinite(signals).all() and signals.min() > 0)
