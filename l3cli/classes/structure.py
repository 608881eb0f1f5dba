"""Structure: strength and direction of the edge at a pixel, from the luminance that the layer before has made
(docs/method.md#structure, with the formulas). The angle of (a, b) there is twice that of the gradient. All is computed in
integers below 2³¹, and so equal everywhere.
"""

import functools

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.plane_rules import DIRECTIONS, GRADIENT, StructureRule
from l3cli.classes.windows import Integers

WIDE, NEAR = 3, 2  # lengths of `triangle_sums`: weights 1 2 3 2 1 and 1 2 1
SIGMA = 16  # gradient units a standard deviation of noise
NOISE_TRACE = 2 * 81 * SIGMA**2  # trace of the tensor that noise alone makes on average
REACH = 3  # pixels beyond a plane that the structure of its edge reads


def structures(luminance: Integers, level: Integers, site: Integers, rule: StructureRule) -> Integers:
    """Return structure (row, col) from luminance (row + 2 REACH, col + 2 REACH) and levels of the first layer (row + 4, col
    + 4), both with a margin of mirrored pixels, and CFA sites (row, col)."""
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
    """Return weighted sums (row, col) of products of gradients, each scaled by `factor` and `shift` (row + 4, col + 4)."""
    across = np.clip((luminance[1:-1, 2:] - luminance[1:-1, :-2]) * factor >> shift, -GRADIENT, GRADIENT)
    down = np.clip((luminance[2:, 1:-1] - luminance[:-2, 1:-1]) * factor >> shift, -GRADIENT, GRADIENT)
    xx, yy, xy = (triangle_sums(each, WIDE).astype(np.int64) for each in (across * across, down * down, across * down))
    return xx, yy, xy


def triangle_sums(values: NDArray[np.integer], length: int) -> NDArray[np.integer]:
    """Return sums of values (row, col) over windows whose weights grow along both axes from 1 to `length` and fall again: of
    sums of `length` values those of as many. Integers of 32 bits are added in a third of the time of 64 with weights."""
    for _ in range(2):
        for axis in (0, 1):
            count = values.shape[axis] - length + 1
            parts = [
                values[first : first + count] if axis == 0 else values[:, first : first + count] for first in range(length)
            ]
            values = functools.reduce(np.add, parts)
    return values


def directions(a: Integers, b: Integers) -> tuple[Integers, Integers]:
    """Return the number 0…7 of the multiple of 45° nearest the angle of (a, b), and how long (a, b) is along it."""
    width, height = np.abs(a), np.abs(b)
    flat, steep = 12 * height < 5 * width, 12 * width < 5 * height  # 22.6°
    diagonal = np.where(a > 0, np.where(b > 0, 1, 7), np.where(b > 0, 3, 5))
    direction = np.where(flat, np.where(a > 0, 0, 4), np.where(steep, np.where(b > 0, 2, 6), diagonal))
    along = np.where(flat, width, np.where(steep, height, (width + height) * 45 >> 6))
    return direction, along


def turn_signs(turn: NDArray[np.int64]) -> tuple[int, int]:
    """Return the signs that (a, b) take when a 3 × 3 window is read in the order `turn` (tap): a quarter turn changes
    both, a mirror image that of b, a transposition that of a."""
    row, col = np.divmod(turn.reshape(3, 3), 3)
    down, right = (row[2, 1] - row[1, 1], col[2, 1] - col[1, 1]), (row[1, 2] - row[1, 1], col[1, 2] - col[1, 1])
    swapped = down[0] == 0  # the tap below the centre lies to its right
    product = (down[1] if swapped else down[0]) * (right[0] if swapped else right[1])
    return (-1 if swapped else 1), int(product)


def name(rule: StructureRule, number: int, site: int) -> str:
    """Return a structure at a site in text, such as "flat", "strength 2 of 2, no direction" or "strength 1 of 2, edge at
    45°": the angle is that of the edge, from the horizontal, anticlockwise."""
    if number == 0:
        return "flat"
    strength, within = divmod(number - 1, 1 + DIRECTIONS)
    stem = f"strength {strength + 1} of {rule.strengths}"
    if within == 0:
        return f"{stem}, no direction"
    across, down = rule.turns[site].tolist()
    angle = 2 * np.pi * (within - 1) / DIRECTIONS  # of (a, b), twice that of the gradient, in the site's orientation
    gradient = np.degrees(np.arctan2(np.sin(angle) * down, np.cos(angle) * across)) / 2  # from the horizontal, downwards
    return f"{stem}, edge at {np.round(90 - gradient, 1) % 180:g}°"
