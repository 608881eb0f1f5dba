"""Chroma from far around, where pixels are alike, for which windows are too small (docs/method.md#coarse-chroma).

Quads are means of 2 × 2 pixels of the planes, blocks those of 2 × 2 quads. Blocks pass four edge-avoiding steps, over blocks
1, 2, 4 and 8 from each other. A quad reads the last from its four nearest blocks, those that are like it after the first.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import PLANE_STEP, CoarseChroma
from l3cli.classes.planes import CHROMA, LUMINANCE
from l3cli.classes.refinement import mirrored, window_means

QUAD, BLOCK = 2, 4  # pixels a side
SPACINGS = (1, 2, 4, 8)  # blocks, by step
REACH = BLOCK * (sum(SPACINGS) + 2)  # pixels beyond which nothing counts
ALIKE = 3.5  # standard deviations of noise that likeness falls off by
POWER = 8  # of 1 − u / POWER, which is nearly exp(−u), but has an end
OWN = 0.05  # weight of the pixel's own window
STEP_WEIGHTS = np.array([1.0, 2.0, 1.0]) / 4
LUMINANCE_WEIGHTS = np.array([1.0, 4.0, 1.0]) / 6  # of quads about one; chroma has equal ones
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Far:
    """Chroma of the last blocks as quads read it: what it adds to a pixel is `chroma` − `share` · the pixel's own."""

    chroma: Array  # (chroma, quad row, quad col)
    share: Array  # (quad row, quad col) 0…1, of the blocks that are alike


def scales_of(chroma: CoarseChroma, share: float = 1.0) -> Array:
    """Return the squares of differences, in squared steps of a plane, from which on nothing is alike, (compared, plane,
    power of luminance in steps); `share`: of the camera's noise variance."""
    steps = chroma.variance * (share / PLANE_STEP**2) * PLANE_STEP ** np.arange(chroma.variance.shape[-1])
    return steps * (POWER * ALIKE**2 * np.array([4.0] * len(SPACINGS) + [2.0])[:, None, None])


def coarse_change(planes: NDArray[np.int32], side: int, scales: Array) -> Array:
    """Return what coarse chroma adds to the outputs (chroma, row, col) of planes (plane, row, col), in their steps, that are
    read by windows of `side`; `scales`: of `scales_of`."""
    own = window_means(mirrored(planes[CHROMA].astype(np.float64), side // 2), side)
    far = read_far(halved(planes.astype(np.float64)), scales)
    rows, cols = (np.arange(length) // QUAD for length in planes.shape[1:])
    place = rows[:, None], cols
    return np.asarray(far.chroma[:, *place] - far.share[place] * own)


def read_far(quads: Array, scales: Array) -> Far:
    """Return what quads (plane, row, col) read of the blocks that they make."""
    evidence, blocks = quad_evidence(quads), halved(quads)
    first = blocks = edge_avoiding(blocks, SPACINGS[0], scales[0])
    for spacing, scale in zip(SPACINGS[1:], scales[1:], strict=False):
        blocks = edge_avoiding(blocks, spacing, scale)
    least = _at(scales[-1], evidence[LUMINANCE])
    total, weights = np.zeros_like(evidence), np.zeros(evidence.shape[1:])
    for rows, down in _nearest_blocks(quads.shape[1], blocks.shape[1]):
        for cols, across in _nearest_blocks(quads.shape[2], blocks.shape[2]):
            there = (slice(None), rows[:, None], cols)
            weight = down[:, None] * across * likeness(first[there] - evidence, least)
            total += weight * blocks[there]
            weights += weight
    share = 1 / (weights + OWN)
    return Far(total[CHROMA] * share, weights * share)


def halved(planes: Array) -> Array:
    """Return the means (plane, row, col) of 2 × 2 values of planes; at an odd end of those that are there."""
    rows, cols = planes.shape[1:]
    whole = np.pad(planes, ((0, 0), (0, rows % 2), (0, cols % 2)), mode="edge")
    return np.asarray(whole.reshape(3, -(-rows // 2), 2, -(-cols // 2), 2).mean(axis=(2, 4)))


def quad_evidence(quads: Array) -> Array:
    """Return what a quad is compared by (plane, row, col): means over 3 × 3 quads, the outermost repeated."""
    padded = np.pad(quads, ((0, 0), (1, 1), (1, 1)), mode="edge")
    weights = np.full((3, 3), 1 / 3)
    weights[LUMINANCE] = LUMINANCE_WEIGHTS
    for axis, length in enumerate(quads.shape[1:], 1):
        parts = (padded.take(range(i, i + length), axis) * weights[:, i, None, None] for i in range(3))
        padded = np.add.reduce(list(parts))
    return padded


def edge_avoiding(blocks: Array, spacing: int, scale: Array) -> Array:
    """Return the mean (plane, row, col) over 3 × 3 blocks `spacing` from each other, of those alike."""
    _, rows, cols = blocks.shape
    least = _at(scale, blocks[LUMINANCE])
    padded = np.pad(blocks, ((0, 0), (spacing, spacing), (spacing, spacing)))
    inside = np.pad(np.ones((rows, cols)), spacing)
    change, weights = np.zeros_like(blocks), np.zeros((rows, cols))
    for i, j in np.ndindex(3, 3):
        there = slice(i * spacing, i * spacing + rows), slice(j * spacing, j * spacing + cols)
        difference = padded[:, *there] - blocks
        weight = STEP_WEIGHTS[i] * STEP_WEIGHTS[j] * inside[there] * likeness(difference, least)
        change += weight * difference
        weights += weight
    return np.asarray(blocks + change / weights)


def likeness(difference: Array, least: Array) -> Array:
    """Return the weight (row, col) of what differs so (plane, row, col); 0 from the square `least` on."""
    return np.asarray(np.maximum(1 - (difference**2 / least).sum(axis=0), 0) ** POWER)


def _nearest_blocks(quads: int, blocks: int) -> list[tuple[NDArray[np.intp], Array]]:
    """Return, twice, the place of a block next to each quad and the weight of linear interpolation, 0 where none is."""
    low = (np.arange(quads) + 1) // 2 - 1
    share = np.where(np.arange(quads) % 2, 0.25, 0.75)  # of the next one
    pairs = ((low, 1 - share), (low + 1, share))
    return [(np.clip(at, 0, blocks - 1), np.where((at >= 0) & (at < blocks), part, 0.0)) for at, part in pairs]


def _at(scale: Array, luminance: Array) -> Array:
    """Return the scale (plane, power) at a luminance (row, col), no less than in darkness."""
    above = np.maximum(luminance, 0)
    return np.asarray(np.einsum("pn,nrc->prc", scale, np.stack([np.ones_like(above), above, above**2])))
