"""Smooth rendering of uniform areas where channels begin to clip (docs/method.md#plain-clipped-areas).

Classes switch abruptly where channels clip. In uniform areas their outputs are therefore replaced by a smooth function of
the channel means.

The means are taken over blocks. A block consists of whole periods of the array and has sides of at least 4 pixels. A quad
of 2 × 2 pixels interpolates four maps between the blocks around it: the fraction of its outputs that is replaced, and the
three outputs that replace it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SMALLEST_BLOCK = 4  # pixels, shortest side of a block
QUAD = 2  # pixels, side of a quad
# Mean of a channel, as a fraction of full scale, at which it begins to count as clipped, and at which it counts fully.
BEGINS, CLIPS = 0.6, 0.985
# Mean of the brightest channel, as a fraction of full scale, at which replacement begins, and at which it is complete.
KEPT, REPLACED = 0.85, 0.975
# Range of a channel within 3 × 3 blocks, as a fraction of full scale: up to the first uniform, from the second textured.
PLAIN, TEXTURED = 0.12, 0.3
WHITE_FROM = 1.25  # times the luminance of the clipped white, from which pixels are rendered white
MIN_WEIGHT = 1e-6  # of a clipped channel in the grey level, so that the weights never sum to zero
MAPS = 4  # the fraction of the outputs that is replaced, and the values added to X, Y and Z
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Mosaic:
    """A mosaic and its levels, as a table expects them."""

    values: NDArray[np.uint16]  # (row, col) DN
    cfa: NDArray[np.uint8]  # (cfa_row, cfa_col) channels, starting at the mosaic's first pixel
    black_level: float  # DN
    white_level: float


def block_sides(cfa: NDArray[np.uint8]) -> tuple[int, int]:
    """Return the rows and columns of a block, which are whole periods of the array."""
    rows, cols = (-(-SMALLEST_BLOCK // period) * period for period in cfa.shape)
    return rows, cols


def first_bright(black_level: float, white_level: float) -> int:
    """Return the lowest DN of a pixel that makes its block count as bright."""
    return int(np.ceil(black_level + BEGINS * (white_level - black_level)))


def limited_to_white(outputs: Array, clipped_white: Array) -> Array:
    """Limit outputs (output, row, col), of which the first three are X, Y, Z, to the luminance of a white.

    Where all channels clip, nothing tells how bright a pixel is, and classes differ in what they guess: without a limit,
    flat white areas would look grey beside the brighter pixels along edges. The colour of a pixel fades to that of the white
    as its luminance rises from the limit to WHITE_FROM times the limit.

    Parameters
    ----------
    outputs : ndarray, (output, row, col)
        Rendered outputs, in the table's output unit.
    clipped_white : ndarray, (3)
        XYZ of the darkest white that clips every channel (`TransformTable.clipped_white`).

    Returns
    -------
    ndarray, (output, row, col)
        The outputs. Pixels that are not brighter than the white are unchanged.
    """
    limit = clipped_white[1]
    luminance = np.maximum(outputs[1], limit)
    faded = np.minimum((luminance - limit) / ((WHITE_FROM - 1) * limit), 1.0)
    xyz = limit / luminance * (1 - faded) * outputs[:3] + faded * clipped_white[:, None, None]
    return np.concatenate([xyz, outputs[3:]])


def replaced(outputs: Array, mosaic: Mosaic, response: Array, white: Array) -> Array:
    """Replace the outputs of uniform areas where channels clip.

    Parameters
    ----------
    outputs : ndarray, (output, row, col)
    mosaic : Mosaic
    response : ndarray, (clipped, signal, output)
        `Clipping.response` of the table.
    white : ndarray, (channel,)
        Signals of a white.
    """
    share, added = np.split(clipping_maps(mosaic, response, white), [1])
    return np.asarray((1 - share) * outputs + added)


def clipping_maps(mosaic: Mosaic, response: Array, white: Array) -> Array:
    """Return the maps (map, row, col) for every pixel. Parameters as in `replaced`."""
    means, spread = block_means(mosaic, len(response) - 1)
    maps, shape = block_maps(means, spread, response, white), mosaic.values.shape
    for axis, (length, side) in enumerate(zip(shape, block_sides(mosaic.cfa), strict=True), 1):
        place = (np.arange(length) // QUAD * QUAD + QUAD / 2) / side - 0.5  # of quads, in blocks
        low = np.floor(place).astype(int)
        share = (place - low).reshape(-1, *[1] * (2 - axis))
        first, second = (maps.take(np.clip(at, 0, maps.shape[axis] - 1), axis) for at in (low, low + 1))
        maps = first + share * (second - first)
    return maps


def block_means(mosaic: Mosaic, channels: int) -> tuple[Array, Array]:
    """Return the means and ranges of the channels in the blocks of a mosaic.

    The last blocks lie completely within the mosaic, and may overlap the blocks before them.

    Returns
    -------
    means : ndarray, (channel, block row, block col)
        As fractions of full scale. They are 0 in blocks that contain nothing bright, or lack a channel.
    spread : ndarray, (block row, block col)
        Largest range of a channel, as a fraction of full scale.
    """
    sides, shape = block_sides(mosaic.cfa), mosaic.values.shape
    values = mosaic.values
    for axis, (length, side) in enumerate(zip(shape, sides, strict=True)):
        if length > side and (begin := length - side) % side:  # shift the last block back, keeping the order of its sites
            index = np.append(np.arange(length // side * side), begin + (np.arange(side) - begin) % side)
            values = values.take(index, axis)
    blocks, count = tuple(-(-length // side) for length, side in zip(shape, sides, strict=True)), np.zeros(channels, int)
    total, highest = (np.zeros((channels, *blocks), kind) for kind in (np.uint32, np.uint16))
    lowest = np.full_like(highest, 2**16 - 1)
    for place in np.ndindex(*np.minimum(sides, shape).tolist()):
        each = values[place[0] :: sides[0], place[1] :: sides[1]]
        channel = mosaic.cfa[place[0] % mosaic.cfa.shape[0], place[1] % mosaic.cfa.shape[1]]
        count[channel] += 1
        total[channel] += each
        np.minimum(lowest[channel], each, out=lowest[channel])
        np.maximum(highest[channel], each, out=highest[channel])
    span = mosaic.white_level - mosaic.black_level
    whole = (highest.max(axis=0) >= first_bright(mosaic.black_level, mosaic.white_level)) & count.all()
    means = np.minimum((total / np.maximum(count, 1)[:, None, None] - mosaic.black_level) / span, 1.0)
    return np.where(whole, means, 0.0), np.where(whole, (highest - lowest).max(axis=0) / span, 0.0)


def plain_blocks(means: Array, spread: Array) -> tuple[NDArray[np.intp], Array, Array, Array]:
    """Return the blocks that may be uniform.

    Blocks are left out if they are textured, or if they are dark. Dark blocks have means of 0, so that a bright block
    beside one differs from it by at least TEXTURED.

    Parameters
    ----------
    means : ndarray, (channel, block row, block col)
    spread : ndarray, (block row, block col)
        As returned by `block_means`.

    Returns
    -------
    numbers : ndarray, (block,)
        Indices of the blocks, row by row.
    signal : ndarray, (channel, block)
        Smoothed means.
    plain : ndarray, (block,)
        1 for uniform blocks, falling to 0 for textured ones.
    share : ndarray, (block,)
        Fraction of the outputs that is replaced.
    """
    numbers = np.flatnonzero(means.any(axis=0) & (spread < TEXTURED))
    row, col = np.divmod(numbers, spread.shape[1])
    padded = np.pad(means, ((0, 0), (1, 1), (1, 1)), mode="edge").reshape(len(means), -1)
    ranges, own = np.pad(spread, 1, mode="edge"), means.reshape(len(means), -1).take(numbers, axis=1)
    signal, widest = np.zeros_like(own), np.zeros(numbers.size)
    for i, j in np.ndindex(3, 3):
        at = (row + i) * ranges.shape[1] + col + j
        neighbour = padded.take(at, axis=1)
        signal += (2 - abs(i - 1)) * (2 - abs(j - 1)) / 16 * neighbour
        widest = np.maximum(widest, np.maximum(np.abs(neighbour - own).max(axis=0), ranges.take(at)))
    plain = 1 - smooth_step(widest, PLAIN, TEXTURED)
    return numbers, signal, plain, plain * smooth_step(signal.max(axis=0), KEPT, REPLACED)


def block_maps(means: Array, spread: Array, response: Array, white: Array) -> Array:
    """Return the maps (map, block row, block col) from the means and ranges of the blocks."""
    numbers, signal, plain, share = plain_blocks(means, spread)
    level = grey_level(signal, white)
    grey = np.minimum(level * white[:, None], 1.0)
    usual = np.einsum("so,sb->ob", response[0, :-1], signal - grey + level * white[:, None])
    added = np.einsum("tso,tsb->ob", response[1:], added_terms(signal) - added_terms(grey))
    maps = np.zeros((MAPS, spread.size))
    maps[:, numbers] = np.concatenate([share[None], share * usual + plain * added])
    return maps.reshape(MAPS, *spread.shape)


def grey_level(signal: Array, white: Array) -> Array:
    """Return the brightness (…) of signals (channel, …) as a grey, where a white is 1.

    It is the mean of the channels' estimates, weighted by how little each clips. If all channels clip, it is the largest
    estimate. `white` (channel) holds the signals of a white.
    """
    level = np.stack([each / one for each, one in zip(signal, white, strict=True)])
    clipped = smooth_step(signal, BEGINS, CLIPS)
    weight = np.maximum(1 - clipped, MIN_WEIGHT)
    mean, every = (weight * level).sum(axis=0) / weight.sum(axis=0), clipped.min(axis=0)
    return np.asarray(mean + every * (level.max(axis=0) - mean))


def added_terms(signal: Array) -> Array:
    """Return the terms (clipped, signal, …) of signals (channel, …) that a response turns into a correction of the outputs.

    There is one group of terms per clipped channel: all signals and 1, weighted by how far the channel clips.
    """
    terms = np.concatenate([signal, np.ones_like(signal[:1])])
    return np.asarray(smooth_step(signal, BEGINS, CLIPS)[:, None] * terms)


def smooth_step(values: Array, low: float, high: float) -> Array:
    """Return 0 up to `low`, 1 from `high` on, and a smooth transition in between."""
    part = np.clip((values - low) / (high - low), 0.0, 1.0)
    return np.asarray(part * part * (3 - 2 * part))
