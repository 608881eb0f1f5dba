"""Correct the polarisers of single pixels in raw frames (docs/method.md#polarisers-of-single-pixels).

A super-pixel is a block of 2×2 pixels of one colour behind polarisers at different angles. Let m be the signals of its four
pixels, each divided by the response of its channel to unpolarised light. If the Stokes vector s is the same at all four
pixels, then

    m = (A + D) s

Each row of A is the response of a channel to S0, S1 and S2. D contains the deviations of the pixels. The corrected signals
m' are the signals of pixels without deviations:

    m' = m - D (A + D)⁺ m

The pseudo-inverse (A + D)⁺ estimates s. The part of m that no uniform light can cause, such as an edge, is not changed.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.frames.shading import clipped_from

SIDE = 2  # pixels; side of a super-pixel
FRACTION = 15  # number of fractional bits of the stored deviations and of the coefficients
# Largest coefficient. The sum of four products of a coefficient and a 16-bit signal then fits into 32 bits.
MAX_COEFFICIENT = 2**13 - 1
SAME_COLOUR = 0.1  # largest difference between responsivities of the same colour, each divided by its peak
LARGEST_CONDITION = 20.0  # largest condition number of A, as for the angles in a calibration
ROWS_AT_ONCE = 64  # rows of super-pixels per batch, to limit memory use


@dataclass(frozen=True, eq=False)
class SuperPixelCorrection:
    """The correction of the pixels' polarisers for the frames of one camera."""

    # (own, other, block row, block col): change in the signal of pixel `own` of a super-pixel per unit signal of pixel
    # `other` of the same super-pixel, in units of 2^-FRACTION
    coefficients: NDArray[np.int16]

    def corrected(self, values: NDArray[np.uint16], black_level: float, white_level: float) -> NDArray[np.uint16]:
        """Return the corrected raw values (row, col) of a full frame.

        Super-pixels with a clipped pixel are unchanged, and no other pixel becomes clipped.
        """
        rows, cols = (SIDE * length for length in self.coefficients.shape[2:])
        black, clipped = round(black_level), clipped_from(black_level, white_level)
        places = [np.s_[row:rows:SIDE, col:cols:SIDE] for row, col in np.ndindex(SIDE, SIDE)]
        before = [values[place].astype(np.int32) for place in places]
        intact = np.logical_and.reduce([each < clipped for each in before])
        signals, result = [each - black for each in before], values.copy()
        for place, own, of_pixel in zip(places, before, self.coefficients, strict=True):
            change = np.full(own.shape, 1 << FRACTION >> 1, np.int32)
            for signal, coefficient in zip(signals, of_pixel, strict=True):
                change += signal * coefficient
            result[place] = np.where(intact, np.clip(own + (change >> FRACTION), 0, clipped - 1), own)
        return result


def super_pixels(camera: CameraModel) -> NDArray[np.bool_]:
    """Return which blocks of 2×2 pixels in one period of the CFA are super-pixels: (block row, block col).

    In a super-pixel, all channels have the same colour, and their polarisers are sufficient to determine S0, S1 and S2. If
    the period has an odd number of rows or columns, there are no super-pixels, and the result is empty.
    """
    if camera.polarisers is None or camera.cfa.shape[0] % SIDE or camera.cfa.shape[1] % SIDE:
        return np.zeros((0, 0), bool)
    curves = camera.responsivity / camera.responsivity.max(axis=1, keepdims=True)
    channels = _by_block(camera.cfa)
    alike = np.ptp(curves[channels], axis=2).max(axis=2) < SAME_COLOUR
    return np.asarray(alike & (np.linalg.cond(camera.relative_stokes_response[channels]) < LARGEST_CONDITION))


def plan_super_pixels(camera: CameraModel) -> SuperPixelCorrection | None:
    """Return the correction for the camera's frames, or None if the deviations of its pixels are unknown."""
    field, found = camera.polariser_field, super_pixels(camera)
    if field is None or not found.any():
        return None
    rows, cols = (length - length % SIDE for length in (camera.rows, camera.cols))
    response, gain = camera.relative_stokes_response, camera.signal_weights.sum(axis=1)
    channels = _by_block(camera.channel_map((rows, cols)))
    inside = np.tile(found, (-(-len(channels) // found.shape[0]), -(-channels.shape[1] // found.shape[1])))
    deviations = _by_block(field.response_deviation[:rows, :cols])
    coefficients = np.zeros((SIDE**2, SIDE**2, *channels.shape[:2]), np.int16)
    for start in range(0, len(channels), ROWS_AT_ONCE):
        part = np.s_[start : start + ROWS_AT_ONCE]
        chosen = inside[part][: len(channels[part]), : channels.shape[1]]
        own = channels[part][chosen]
        deviation = deviations[part][chosen] / 2.0**FRACTION
        actual = response[own] + deviation
        transposed = actual.swapaxes(1, 2)
        change = -deviation @ np.linalg.solve(transposed @ actual, transposed)
        change *= gain[own][:, :, None] / gain[own][:, None]
        limited = np.clip(np.rint(change * 2**FRACTION), -MAX_COEFFICIENT, MAX_COEFFICIENT)
        coefficients[:, :, part][:, :, chosen] = np.moveaxis(limited, 0, -1)
    return SuperPixelCorrection(coefficients)


def _by_block(pixels: NDArray) -> NDArray:
    """Rearrange pixels (row, col, …) by super-pixels: (block row, block col, pixel, …)."""
    rows, cols = (length // SIDE for length in pixels.shape[:2])
    parts = pixels.reshape(rows, SIDE, cols, SIDE, *pixels.shape[2:]).swapaxes(1, 2)
    return parts.reshape(rows, cols, SIDE**2, *pixels.shape[2:])
