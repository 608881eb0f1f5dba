"""Chroma from far around, where pixels are alike, for which windows are too small (docs/method.md#coarse-chroma).

Blocks are means of 4 × 4 pixels of the planes. They pass four edge-avoiding steps, over blocks 1, 2, 4 and 8 from each
other. Pixels get what these change of chroma, interpolated between blocks: nothing where an edge divides a block.
"""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import PLANE_STEP, CoarseChroma
from l3cli.classes.planes import CHROMA, LUMINANCE

BLOCK = 4  # pixels a side
SPACINGS = (1, 2, 4, 8)  # blocks, by step
REACH = BLOCK * (sum(SPACINGS) + 2)  # pixels beyond which nothing counts
ALIKE = np.array([3.0, 4.0, 5.0, 6.0])  # standard deviations of noise that likeness falls off by, by step
POWER = 8  # of 1 − u / POWER, which is nearly exp(−u), but has an end
STEP_WEIGHTS = np.array([1.0, 2.0, 1.0]) / 4
Array = NDArray[np.float64]


def scales_of(chroma: CoarseChroma, share: float = 1.0) -> Array:
    """Return the squares of differences, in squared steps of a plane, from which on nothing is alike, (step, plane, power of
    luminance in steps); `share`: of the camera's noise variance."""
    steps = chroma.variance * (share / PLANE_STEP**2) * PLANE_STEP ** np.arange(chroma.variance.shape[-1])
    return steps * (4 * POWER * ALIKE**2)[:, None, None]


def coarse_change(planes: NDArray[np.int32], scales: Array) -> Array:
    """Return what coarse chroma adds to the outputs (chroma, row, col) of planes (plane, row, col), in their steps;
    `scales`: of `scales_of`. Beyond the frame nothing is added."""
    before = blocks = blocks_of(planes)
    for spacing, scale in zip(SPACINGS, scales, strict=True):
        blocks = edge_avoiding(blocks, spacing, scale)
    change = np.pad((blocks - before)[CHROMA], ((0, 0), (1, 1), (1, 1)))
    (above, down), (left, right) = map(_between, planes.shape[1:])
    change = change[:, above] * (1 - down)[:, None] + change[:, above + 1] * down[:, None]
    return np.asarray(change[..., left] * (1 - right) + change[..., left + 1] * right)


def blocks_of(planes: NDArray) -> Array:
    """Return the means (plane, row, col) of blocks of planes, whose outermost pixels are repeated to fill them."""
    rows, cols = planes.shape[1:]
    whole = np.pad(planes, ((0, 0), (0, -rows % BLOCK), (0, -cols % BLOCK)), mode="edge")
    return np.asarray(whole.reshape(3, -(-rows // BLOCK), BLOCK, -(-cols // BLOCK), BLOCK).mean(axis=(2, 4)))


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
        alike = np.maximum(1 - (difference**2 / least).sum(axis=0), 0) ** POWER
        weight = STEP_WEIGHTS[i] * STEP_WEIGHTS[j] * inside[there] * alike
        change += weight * difference
        weights += weight
    return np.asarray(blocks + change / weights)


def _between(length: int) -> tuple[NDArray[np.intp], Array]:
    """Return the block before each of so many pixels, 0 being one before the first, and the share of the next."""
    low, place = np.divmod(np.arange(length) + BLOCK // 2, BLOCK)
    return low, (place + 0.5) / BLOCK


def _at(scale: Array, luminance: Array) -> Array:
    """Return the scale (plane, power) at a luminance (row, col), no less than in darkness."""
    above = np.maximum(luminance, 0)
    return np.asarray(np.einsum("pn,nrc->prc", scale, np.stack([np.ones_like(above), above, above**2])))
