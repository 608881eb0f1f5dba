"""Plain areas where channels begin to clip: one smooth function of the channels' means takes the place of classes, which
switch hard (docs/method.md#plain-clipped-areas).

Blocks are whole periods of the array, of 4 pixels a side at least. A quad, 2 × 2 pixels, reads four maps from the blocks
about it: the share of its outputs that is replaced, and what replaces it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.frames.frame import tiled

SMALLEST = 4  # pixels, side of a block
QUAD = 2  # pixels a side
BEGINS, CLIPS = 0.6, 0.985  # means of a channel, shares of full scale, between which it passes for clipped more and more
KEPT, REPLACED = 0.85, 0.975  # of the brightest channel, between which outputs are replaced
PLAIN, TEXTURED = 0.12, 0.3  # range of a channel within 3 × 3 blocks, up to and from which they are so
FAINTEST = 1e-6  # weight of a channel that clips
MAPS = 4  # share of the outputs that is replaced, and what is added to X, Y and Z
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Mosaic:
    """A mosaic at a table's levels."""

    values: NDArray[np.uint16]  # (row, col) DN
    cfa: NDArray[np.uint8]  # channels, as seen from its first pixel
    black_level: float  # DN
    white_level: float


def block_sides(cfa: NDArray[np.uint8]) -> tuple[int, int]:
    """Return rows and columns of a block: whole periods of the array."""
    rows, cols = (-(-SMALLEST // period) * period for period in cfa.shape)
    return rows, cols


def first_bright(black_level: float, white_level: float) -> int:
    """Return the least DN that makes a block count."""
    return int(np.ceil(black_level + BEGINS * (white_level - black_level)))


def replaced(outputs: Array, mosaic: Mosaic, response: Array, white: Array) -> Array:
    """Return outputs (output, row, col) with those of plain areas where channels clip replaced, from the `response`
    (clipped, signal, output) and the signals of `white` (channel) of a table."""
    share, added = np.split(clipping_maps(mosaic, response, white), [1])
    return np.asarray((1 - share) * outputs + added)


def clipping_maps(mosaic: Mosaic, response: Array, white: Array) -> Array:
    """Return the maps (map, row, col) of every pixel; arguments as of `replaced`."""
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
    """Return the means (channel, block row, block col) of the blocks of a mosaic, shares of full scale, and the largest
    range of a channel in each (block row, block col). Blocks at the ends lie within the mosaic; those that hold nothing
    bright, or lack a channel, have means of 0."""
    sides, shape = block_sides(mosaic.cfa), mosaic.values.shape
    places = []
    for length, side in zip(shape, sides, strict=True):
        first = np.minimum(np.arange(-(-length // side)) * side, max(length - side, 0))
        places.append((first[:, None] + np.arange(min(side, length))).ravel())
    blocks = tuple(-(-length // side) for length, side in zip(shape, sides, strict=True))

    def in_blocks(values: NDArray) -> NDArray:
        cut = values[np.ix_(*places)].reshape(blocks[0], -1, blocks[1], len(places[1]) // blocks[1])
        return cut.transpose(0, 2, 1, 3).reshape(*blocks, -1)

    channel = in_blocks(tiled(mosaic.cfa, shape))
    values = in_blocks(mosaic.values.astype(np.int64))
    span, means, ranges = mosaic.white_level - mosaic.black_level, [], []
    whole = values.max(axis=-1) >= first_bright(mosaic.black_level, mosaic.white_level)
    for number in range(channels):
        there = channel == number
        count = there.sum(axis=-1)
        whole &= count > 0
        mean = np.where(there, values, 0).sum(axis=-1) / np.maximum(count, 1)
        means.append(np.minimum((mean - mosaic.black_level) / span, 1.0))
        lowest = np.where(there, values, 2**16).min(axis=-1)
        ranges.append((np.where(there, values, 0).max(axis=-1) - lowest) / span)
    return np.where(whole, means, 0.0), np.where(whole, np.max(ranges, axis=0), 0.0)


def block_maps(means: Array, spread: Array, response: Array, white: Array) -> Array:
    """Return the maps (map, block row, block col) of blocks from their means and ranges."""
    _, rows, cols = means.shape
    padded = np.pad(means, ((0, 0), (1, 1), (1, 1)), mode="edge")
    ranges = np.pad(spread, 1, mode="edge")
    signal, widest = np.zeros_like(means), np.zeros_like(spread)
    for i, j in np.ndindex(3, 3):
        there = slice(i, i + rows), slice(j, j + cols)
        signal += (2 - abs(i - 1)) * (2 - abs(j - 1)) / 16 * padded[:, *there]
        differs = np.abs(padded[:, *there] - means).max(axis=0)
        widest = np.maximum(widest, np.maximum(differs, ranges[there]))
    plain = 1 - smooth_step(widest, PLAIN, TEXTURED)
    share = plain * smooth_step(signal.max(axis=0), KEPT, REPLACED)
    level = grey_level(signal, white)
    grey = np.minimum(level * white[:, None, None], 1.0)
    usual = np.einsum("so,srk->ork", response[0, :-1], signal - grey + level * white[:, None, None])
    added = np.einsum("tso,tsrk->ork", response[1:], added_terms(signal) - added_terms(grey))
    return np.concatenate([share[None], share * usual + plain * added])


def grey_level(signal: Array, white: Array) -> Array:
    """Return the grey (…), a white being 1, that is taken for the brightness of signals (channel, …): the mean of what
    channels say that do not clip, and the most that one says if all do. `white` (channel) are the signals of a white."""
    level = np.stack([each / one for each, one in zip(signal, white, strict=True)])
    clipped = smooth_step(signal, BEGINS, CLIPS)
    weight = np.maximum(1 - clipped, FAINTEST)
    mean, every = (weight * level).sum(axis=0) / weight.sum(axis=0), clipped.min(axis=0)
    return np.asarray(mean + every * (level.max(axis=0) - mean))


def added_terms(signal: Array) -> Array:
    """Return the terms (clipped, signal, …) of signals (channel, …) whose sum by a response adds to the outputs of plain
    areas: of each channel as far as it clips, all signals and 1."""
    terms = np.concatenate([signal, np.ones_like(signal[:1])])
    return np.asarray(smooth_step(signal, BEGINS, CLIPS)[:, None] * terms)


def smooth_step(values: Array, low: float, high: float) -> Array:
    """Return 0 up to `low`, 1 from `high` on, and smoothly what lies between."""
    part = np.clip((values - low) / (high - low), 0.0, 1.0)
    return np.asarray(part * part * (3 - 2 * part))
