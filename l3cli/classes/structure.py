"""Structure: strength and direction of the edge at a pixel, from the luminance of the previous layer's output.

docs/method.md#structure contains the formulas. Let xx, yy and xy be the elements of the structure tensor, a = xx − yy and
b = 2 xy. The angle of the vector (a, b) is twice the angle of the gradient. All integers are below 2³¹, so the results are
the same on every device.
"""

import functools

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.plane_rules import DIRECTIONS, GRADIENT, StructureRule
from l3cli.classes.windows import Integers

WIDE, NEAR = 3, 2  # lengths for `triangle_sums`, with the weights 1 2 3 2 1 and 1 2 1
SIGMA = 16  # standard deviation of noise in scaled gradients
NOISE_TRACE = 2 * 81 * SIGMA**2  # mean trace of the structure tensor of pure noise
BORDER_PIXELS = 3  # width of the mirrored margin, in pixels


def structures(luminance: Integers, level: Integers, site: Integers, rule: StructureRule) -> Integers:
    """Return the structure of every pixel: (row, col).

    Parameters
    ----------
    luminance : ndarray, (row + 6, col + 6)
        Luminance plane with a margin of 3 mirrored pixels.
    level : ndarray, (row + 4, col + 4)
        Level of each pixel in the first layer, with a margin of 2 mirrored pixels.
    site : ndarray, (row, col)
        CFA site of each pixel.
    rule : StructureRule
        Class rule of the layer.
    """
    xx, yy, xy = tensor(luminance, rule.gradient_factor.astype(np.int32)[level], rule.gradient_shift.astype(np.int32)[level])
    trace = xx + yy
    strength = np.searchsorted(rule.strength_edges.astype(np.int64), trace, side="left")
    turn = rule.turns.astype(np.int64)[site]
    direction, along = directions((xx - yy >> 6) * turn[..., 0], (xy >> 5) * turn[..., 1])
    within = np.where(64 * along > rule.coherence * (trace >> 6), 1 + direction, 0)
    return np.where(strength > 0, 1 + (strength - 1) * (1 + DIRECTIONS) + within, 0)


def tensor(
    luminance: NDArray[np.integer], factor: NDArray[np.int32], shift: NDArray[np.int32]
) -> tuple[Integers, Integers, Integers]:
    """Compute the elements xx, yy and xy of the structure tensor: weighted sums of products of gradients.

    The gradients are first multiplied by `factor`, shifted right by `shift` bits, and clipped. The gradients, `factor` and
    `shift` have two rows and columns fewer than `luminance`. The tensor has four rows and columns fewer than the gradients.
    """
    across = np.clip((luminance[1:-1, 2:] - luminance[1:-1, :-2]) * factor >> shift, -GRADIENT, GRADIENT)
    down = np.clip((luminance[2:, 1:-1] - luminance[:-2, 1:-1]) * factor >> shift, -GRADIENT, GRADIENT)
    xx, yy, xy = (triangle_sums(each, WIDE).astype(np.int64) for each in (across * across, down * down, across * down))
    return xx, yy, xy


def triangle_sums(values: NDArray[np.integer], length: int) -> NDArray[np.integer]:
    """Return triangle-weighted sums over square windows with the side 2 `length` − 1.

    Along each axis, the weights increase from 1 to `length` and then decrease to 1. They result from adding `length`
    neighbouring values twice along each axis. With 32-bit integers, this is three times as fast as weighted sums with 64-bit
    integers.
    """
    for _ in range(2):
        for axis in (0, 1):
            count = values.shape[axis] - length + 1
            parts = [
                values[first : first + count] if axis == 0 else values[:, first : first + count] for first in range(length)
            ]
            values = functools.reduce(np.add, parts)
    return values


def directions(a: Integers, b: Integers) -> tuple[Integers, Integers]:
    """Round the angle of the vector (a, b) to a multiple of 45°.

    Returns
    -------
    direction : ndarray
        Angle divided by 45°, from 0 to 7.
    along : ndarray
        Component of (a, b) in this direction.
    """
    width, height = np.abs(a), np.abs(b)
    flat, steep = 12 * height < 5 * width, 12 * width < 5 * height  # the boundary is at 22.6°
    diagonal = np.where(a > 0, np.where(b > 0, 1, 7), np.where(b > 0, 3, 5))
    direction = np.where(flat, np.where(a > 0, 0, 4), np.where(steep, np.where(b > 0, 2, 6), diagonal))
    along = np.where(flat, width, np.where(steep, height, (width + height) * 45 >> 6))
    return direction, along


def turn_signs(turn: NDArray[np.int64]) -> tuple[int, int]:
    """Return the signs by which a = xx − yy and b = 2 xy are multiplied when a window is turned.

    `turn` contains the original index of each tap in the turned 3 × 3 window. A rotation by 90° changes both signs.
    Mirroring changes the sign of b, and transposition changes the sign of a.
    """
    row, col = np.divmod(turn.reshape(3, 3), 3)
    down, right = (row[2, 1] - row[1, 1], col[2, 1] - col[1, 1]), (row[1, 2] - row[1, 1], col[1, 2] - col[1, 1])
    swapped = down[0] == 0  # the tap below the centre moves to the right or left of the centre
    product = (down[1] if swapped else down[0]) * (right[0] if swapped else right[1])
    return (-1 if swapped else 1), int(product)


def name(rule: StructureRule, number: int, site: int) -> str:
    """Return the name of a structure, such as "flat" or "strength 1 of 2, edge at 45°".

    The edge's angle is measured anticlockwise from the horizontal. It depends on the orientation of the CFA site.
    """
    if number == 0:
        return "flat"
    strength, within = divmod(number - 1, 1 + DIRECTIONS)
    stem = f"strength {strength + 1} of {rule.strengths}"
    if within == 0:
        return f"{stem}, no direction"
    across, down = rule.turns[site].tolist()
    # Angle of the vector (a, b) of `turn_signs`, which is twice the angle of the gradient. It refers to windows in the
    # orientation that was used to train the site.
    angle = 2 * np.pi * (within - 1) / DIRECTIONS
    gradient = np.degrees(np.arctan2(np.sin(angle) * down, np.cos(angle) * across)) / 2  # angle below the horizontal
    return f"{stem}, edge at {np.round(90 - gradient, 1) % 180:g}°"
