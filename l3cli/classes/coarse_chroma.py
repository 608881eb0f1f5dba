"""Coarse chroma: the mean chroma of similar pixels over an area much larger than a window (docs/method.md#coarse-chroma).

The planes are averaged over blocks of 4 × 4 pixels. The blocks are smoothed in four edge-avoiding steps, with spacings of 1,
2, 4 and 8 blocks. The resulting change in chroma is interpolated between the blocks and added to each pixel.
"""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.layers import PLANE_STEP, CoarseChroma
from l3cli.classes.planes import CHROMA, LUMINANCE

BLOCK = 4  # pixels; side of a block
SPACINGS = (1, 2, 4, 8)  # spacing of each step, in blocks
REACH = BLOCK * (sum(SPACINGS) + 2)  # pixels; pixels at a larger distance have no influence
ALIKE = np.array([3.0, 4.0, 5.0, 6.0])  # width of the similarity in each step, in standard deviations of noise
POWER = 8  # exponent of (1 − u / POWER), which approximates exp(−u) but reaches zero
STEP_WEIGHTS = np.array([1.0, 2.0, 1.0]) / 4
Array = NDArray[np.float64]


def scales_of(chroma: CoarseChroma, share: float = 1.0) -> Array:
    """Return the squared differences up to which blocks count as similar.

    Parameters
    ----------
    chroma : CoarseChroma
        The coarse chroma of a table.
    share : float
        Noise variance of the frame, as a fraction of the camera's.

    Returns
    -------
    ndarray, (step, plane, power of luminance)
        Coefficients of polynomials in the luminance, in squared steps of a plane.
    """
    steps = chroma.variance * (share / PLANE_STEP**2) * PLANE_STEP ** np.arange(chroma.variance.shape[-1])
    return steps * (4 * POWER * ALIKE**2)[:, None, None]


def coarse_change(planes: NDArray[np.int32], scales: Array) -> Array:
    """Return the change (chroma, row, col) that coarse chroma adds to the chroma planes, in steps of a plane.

    Parameters
    ----------
    planes : ndarray, (plane, row, col)
        Planes of the previous layer.
    scales : ndarray
        Result of `scales_of`.
    """
    before = blocks = blocks_of(planes)
    for spacing, scale in zip(SPACINGS, scales, strict=True):
        blocks = edge_avoiding(blocks, spacing, scale)
    change = np.pad((blocks - before)[CHROMA], ((0, 0), (1, 1), (1, 1)))
    (above, down), (left, right) = map(_between, planes.shape[1:])
    change = change[:, above] * (1 - down)[:, None] + change[:, above + 1] * down[:, None]
    return np.asarray(change[..., left] * (1 - right) + change[..., left + 1] * right)


def blocks_of(planes: NDArray) -> Array:
    """Return the block means (plane, row, col) of planes. Incomplete blocks are completed by repeating the last pixels."""
    rows, cols = planes.shape[1:]
    whole = np.pad(planes, ((0, 0), (0, -rows % BLOCK), (0, -cols % BLOCK)), mode="edge")
    return np.asarray(whole.reshape(3, -(-rows // BLOCK), BLOCK, -(-cols // BLOCK), BLOCK).mean(axis=(2, 4)))


def edge_avoiding(blocks: Array, spacing: int, scale: Array) -> Array:
    """Average the similar blocks among 3 × 3 blocks with the given spacing, and return the means (plane, row, col)."""
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
    """Return the block before each pixel along an axis, and the weight of the block after it. Block 0 lies outside."""
    low, place = np.divmod(np.arange(length) + BLOCK // 2, BLOCK)
    return low, (place + 0.5) / BLOCK


def _at(scale: Array, luminance: Array) -> Array:
    """Return the scale (plane, row, col) at a luminance (row, col). Negative luminances count as zero."""
    above = np.maximum(luminance, 0)
    return np.asarray(np.einsum("pn,nrc->prc", scale, np.stack([np.ones_like(above), above, above**2])))
