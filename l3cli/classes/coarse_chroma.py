"""Average the chroma of similar pixels in an area much larger than a window (docs/method.md#coarse-chroma).

The opponent planes are averaged over blocks of 4 × 4 pixels. The blocks are then smoothed in four edge-avoiding steps, with
spacings of 1, 2, 4 and 8 blocks. The change in chroma is interpolated between the blocks and added to each pixel.
"""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.layers import PLANE_STEP, CoarseChroma
from l3cli.classes.planes import CHROMA, LUMINANCE

BLOCK = 4  # side of a block in pixels
SPACINGS = (1, 2, 4, 8)  # spacing of each step, in blocks
REACH = BLOCK * (sum(SPACINGS) + 2)  # largest distance, in pixels, at which a pixel can affect the result
ALIKE = np.array([3.0, 4.0, 5.0, 6.0])  # width of the similarity function in each step, in standard deviations of the noise
POWER = 8  # exponent in (1 − u / POWER)^POWER, an approximation of exp(−u) that reaches zero
STEP_WEIGHTS = np.array([1.0, 2.0, 1.0]) / 4
Array = NDArray[np.float64]


def scales_of(chroma: CoarseChroma, noise_ratio: float = 1.0) -> Array:
    """Compute the values by which squared differences between blocks are divided in the similarity function.

    Parameters
    ----------
    chroma : CoarseChroma
        Coarse chroma settings of a table.
    noise_ratio : float
        Noise variance of the frame, divided by the camera's noise variance.

    Returns
    -------
    ndarray, (step, plane, power of luminance)
        Coefficients of a polynomial in the luminance, for planes and luminance in units of PLANE_STEP.
    """
    steps = chroma.variance * (noise_ratio / PLANE_STEP**2) * PLANE_STEP ** np.arange(chroma.variance.shape[-1])
    return steps * (4 * POWER * ALIKE**2)[:, None, None]


def coarse_change(planes: NDArray[np.int32], scales: Array) -> Array:
    """Compute the change that the coarse chroma filter adds to the two chroma planes, in units of PLANE_STEP.

    Parameters
    ----------
    planes : ndarray, (plane, row, col)
        Opponent planes of the previous layer's outputs, in units of PLANE_STEP.
    scales : ndarray
        Result of `scales_of`.

    Returns
    -------
    ndarray, (chroma plane, row, col)
        Change in each chroma plane.
    """
    before = blocks = blocks_of(planes)
    for spacing, scale in zip(SPACINGS, scales, strict=True):
        blocks = edge_avoiding(blocks, spacing, scale)
    change = np.pad((blocks - before)[CHROMA], ((0, 0), (1, 1), (1, 1)))
    (above, down), (left, right) = map(_between, planes.shape[1:])
    change = change[:, above] * (1 - down)[:, None] + change[:, above + 1] * down[:, None]
    return np.asarray(change[..., left] * (1 - right) + change[..., left + 1] * right)


def blocks_of(planes: NDArray) -> Array:
    """Return block means (plane, block row, block col). Incomplete blocks are filled with repeated border pixels."""
    rows, cols = planes.shape[1:]
    whole = np.pad(planes, ((0, 0), (0, -rows % BLOCK), (0, -cols % BLOCK)), mode="edge")
    return np.asarray(whole.reshape(3, -(-rows // BLOCK), BLOCK, -(-cols // BLOCK), BLOCK).mean(axis=(2, 4)))


def edge_avoiding(blocks: Array, spacing: int, scale: Array) -> Array:
    """Average each block with its eight neighbours at a given spacing, weighted by their similarity.

    Parameters
    ----------
    blocks : ndarray, (plane, row, col)
        Block means of the planes.
    spacing : int
        Distance between neighbours, in blocks.
    scale : ndarray, (plane, power of luminance)
        Scales of this step from `scales_of`.
    """
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
    """Return the interpolation between blocks for each pixel along an axis.

    The results are the index of the block before the pixel, and the weight of the next block. Index 0 is the padding block
    before the frame.
    """
    low, place = np.divmod(np.arange(length) + BLOCK // 2, BLOCK)
    return low, (place + 0.5) / BLOCK


def _at(scale: Array, luminance: Array) -> Array:
    """Evaluate the polynomials `scale` (plane, power) at luminances (row, col). Negative luminances count as 0."""
    above = np.maximum(luminance, 0)
    return np.asarray(np.einsum("pn,nrc->prc", scale, np.stack([np.ones_like(above), above, above**2])))
