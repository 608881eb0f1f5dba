"""Correct the outputs in areas with clipped channels.

There are two corrections:

* Where a channel starts to clip, a pixel's class changes abruptly. In a uniform area, this would be visible as a contour.
  The outputs in uniform areas are therefore replaced with a smooth function of the channel means
  (docs/method.md#uniform-clipped-areas).
* Clipped areas get the hue of nearby unclipped areas that may show the same surface (docs/method.md#hue-of-clipped-areas).

The channel means are computed in blocks of whole CFA periods, at least 4 × 4 pixels in size. Each block has seven values,
called *maps*:

1. the fraction of the outputs to replace. It is large in uniform areas. It is also large in smooth blocks next to an edge,
   if most of the luminance is in clipped channels.
2. to 4. the replacements for X, Y and Z, multiplied by this fraction
5. the weight of the hue from nearby unclipped blocks
6. and 7. X/Y and Z/Y of this hue, multiplied by the weight

The maps are interpolated between blocks, with one value for each *quad* of 2 × 2 pixels.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SMALLEST_BLOCK = 4  # smallest side of a block in pixels
QUAD = 2  # side of a quad in pixels
# The degree to which a channel clips increases from 0 at the channel mean BEGINS to 1 at CLIPS (fractions of full scale).
BEGINS, CLIPS = 0.6, 0.985
# The corrections for clipped channels (`added_terms`) begin at a higher channel mean. Otherwise, they would change colours
# that do not clip yet.
CORRECTED_FROM = 0.65
# l3 mixes the outputs with their replacement. The weight of the replacement increases from 0 to 1 while the mean of the
# brightest channel increases from KEPT to REPLACED (fractions of full scale).
KEPT, REPLACED = 0.85, 0.975
# In 3 × 3 blocks around a uniform block, the values of each channel differ by at most PLAIN. Around a textured block, they
# differ by TEXTURED or more (fractions of full scale).
PLAIN, TEXTURED = 0.12, 0.3
WHITE_FROM = 1.25  # pixels with at least this luminance, relative to the clipped white, are rendered white
MIN_WEIGHT = 1e-6  # smallest weight of a channel, so that sums of weights are never zero
# Number of maps, and number of the maps that replace the outputs.
MAPS, REPLACEMENT_MAPS = 7, 4
HUE_STEPS = 2  # a clipped block is compared with this number of blocks in each direction
HUE_REACH = 24  # distance, in pixels, from a clipped block to the farthest of these blocks
MAX_DIFFERENCE = 0.05  # blocks with at least this squared relative difference certainly show different surfaces
MIN_SIGNAL = 0.02  # smallest signal used as a divisor, as a fraction of full scale
# The weight of the surrounding hue is L / (L + D). L is the similarity of the surroundings, as a fraction of its maximum.
# D is HUE_DOUBT plus GREY_DOUBT times the squared similarity of the clipped block to white.
HUE_DOUBT, GREY_DOUBT = 0.05, 12.0
# The estimates of clipped blocks spread over uniform areas in several passes. These are the distances of the passes in
# pixels. The last one is shorter. Otherwise, blocks at different multiples of a distance would never be averaged, and skies
# would have bands.
SPREAD_DISTANCES = (32, 32, 32, 32, 32, 16)
MAX_CHANGE = 0.6  # estimates spread only to blocks with a smaller mean squared relative difference in the unclipped channels
WHITE_DOUBT = 0.001  # ridge that limits the amount of white in the mixture with the surrounding colour
MAX_HUE = 10.0  # largest X/Y and Z/Y of a hue
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Mosaic:
    """A raw frame with its CFA, rescaled to the black and white levels of the table."""

    values: NDArray[np.uint16]  # (row, col): DN
    cfa: NDArray[np.uint8]  # (cfa_row, cfa_col): channel of each site, starting at the first pixel
    black_level: float  # DN
    white_level: float  # DN


def block_sides(cfa: NDArray[np.uint8]) -> tuple[int, int]:
    """Return a block's height and width in pixels: multiples of the CFA's height and width."""
    rows, cols = (-(-SMALLEST_BLOCK // period) * period for period in cfa.shape)
    return rows, cols


def first_bright(black_level: float, white_level: float) -> int:
    """Return the lowest raw value, in DN, that counts as bright. Blocks without bright pixels are ignored."""
    return int(np.ceil(black_level + BEGINS * (white_level - black_level)))


def limited_to_white(outputs: Array, clipped_white: Array) -> Array:
    """Limit the luminance of the outputs to the luminance of the clipped white.

    If all channels clip, the raw values do not determine a pixel's brightness, and different classes estimate different
    values. Without the limit, uniform white areas would look grey next to brighter pixels along their edges. Above the
    limit, colours fade to white. All pixels above WHITE_FROM times the limit are white.

    Parameters
    ----------
    outputs : ndarray, (output, row, col)
        Rendered outputs in output units. The first three outputs must be X, Y and Z.
    clipped_white : ndarray, (3,)
        XYZ of the darkest white that clips every channel (`TransformTable.clipped_white`).

    Returns
    -------
    ndarray, (output, row, col)
        Limited X, Y and Z, followed by the unchanged other outputs.
    """
    limit = clipped_white[1]
    luminance = np.maximum(outputs[1], limit)
    faded = np.minimum((luminance - limit) / ((WHITE_FROM - 1) * limit), 1.0)
    xyz = limit / luminance * (1 - faded) * outputs[:3] + faded * clipped_white[:, None, None]
    return np.concatenate([xyz, outputs[3:]])


def replaced(outputs: Array, mosaic: Mosaic, response: Array, white: Array) -> Array:
    """Correct the outputs of uniform clipped areas, then the hue of all clipped areas.

    Parameters
    ----------
    outputs : ndarray, (output, row, col)
        Rendered X, Y and Z.
    mosaic : Mosaic
        Mosaic from which the outputs were rendered.
    response : ndarray, (clipped, signal, output)
        `Clipping.response` of the table.
    white : ndarray, (channel,)
        `Clipping.white` of the table.

    Returns
    -------
    ndarray, (output, row, col)
        Corrected X, Y and Z.
    """
    share, added, taken, hue = np.split(clipping_maps(mosaic, response, white), [1, 4, 5])
    x, y, z = (1 - share) * outputs + added
    (x_share, z_share), kept = hue, 1 - taken[0]
    return np.stack([kept * x + x_share * y, y, kept * z + z_share * y])


def clipping_maps(mosaic: Mosaic, response: Array, white: Array) -> Array:
    """Compute the seven maps (see the module docstring) at every pixel: (map, row, col).

    The parameters are the same as for `replaced`.
    """
    (means, spread), sides = block_means(mosaic, len(response) - 1), block_sides(mosaic.cfa)
    hue, estimated = estimated_maps(means, spread, response, white, sides)
    replacement = (1 - estimated[0]) * block_maps(means, spread, response, white) + estimated
    maps = np.concatenate([replacement, hue])
    for axis, (length, side) in enumerate(zip(mosaic.values.shape, sides, strict=True), 1):
        place = (np.arange(length) // QUAD * QUAD + QUAD / 2) / side - 0.5  # position of the quad, in blocks
        low = np.floor(place).astype(int)
        share = (place - low).reshape(-1, *[1] * (2 - axis))
        first, second = (maps.take(np.clip(at, 0, maps.shape[axis] - 1), axis) for at in (low, low + 1))
        maps = first + share * (second - first)
    return maps


def block_means(mosaic: Mosaic, channels: int) -> tuple[Array, Array]:
    """Compute each block's channel means, and the range of its values.

    If the mosaic does not consist of whole blocks, the last row and column of blocks are moved inward and overlap their
    neighbours.

    Returns
    -------
    means : ndarray, (channel, block row, block col)
        Channel means as fractions of full scale. If a block has no bright pixel or lacks a channel, all its means are 0.
    spread : ndarray, (block row, block col)
        Largest difference between two values of the same channel, as a fraction of full scale.
    """
    sides, shape = block_sides(mosaic.cfa), mosaic.values.shape
    values = mosaic.values
    for axis, (length, side) in enumerate(zip(shape, sides, strict=True)):
        # Move the last block back to the end of the mosaic, and sort its pixels so that the CFA continues.
        if length > side and (begin := length - side) % side:
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
    """Select the bright blocks without texture, and measure how uniform they are.

    A bright block next to a dark block is not uniform, because a dark block's means are 0.

    Parameters
    ----------
    means : ndarray, (channel, block row, block col)
        Channel means from `block_means`.
    spread : ndarray, (block row, block col)
        Ranges from `block_means`.

    Returns
    -------
    numbers : ndarray, (block,)
        Indices of the selected blocks, in row-major order.
    signal : ndarray, (channel, block)
        Channel means, smoothed over 3 × 3 blocks.
    plain : ndarray, (block,)
        Uniformity of each block, from 0 (textured) to 1 (uniform).
    share : ndarray, (block,)
        Fraction of the outputs to replace.
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
    return numbers, signal, plain, plain * replaced_fraction(signal)


def replaced_fraction(signal: Array) -> Array:
    """Return the fraction of the outputs to replace in uniform areas, from the channel means (channel, …)."""
    return smooth_step(signal.max(axis=0), KEPT, REPLACED)


def block_maps(means: Array, spread: Array, response: Array, white: Array) -> Array:
    """Compute the four maps that replace the outputs of uniform areas: (map, block row, block col).

    The parameters are the same as for `replaced` and `plain_blocks`.
    """
    numbers, signal, _, share = plain_blocks(means, spread)
    level = grey_level(signal, white)
    grey = np.minimum(level * white[:, None], 1.0)
    usual = np.einsum("so,sb->ob", response[0, :-1], signal - grey + level * white[:, None])
    added = np.einsum("tso,tsb->ob", response[1:], added_terms(signal) - added_terms(grey))
    maps = np.zeros((REPLACEMENT_MAPS, spread.size))
    maps[:, numbers] = np.concatenate([share[None], share * (usual + added)])
    return maps.reshape(-1, *spread.shape)


def hue_spacing(side: int) -> int:
    """Return the spacing, in blocks of `side` pixels, between the blocks that are compared with a clipped block."""
    return max(HUE_REACH // (HUE_STEPS * side), 1)


def spread_spacings(side: int) -> tuple[int, ...]:
    """Return how far each pass spreads the estimates, in blocks of `side` pixels."""
    return tuple(max(distance // side, 1) for distance in SPREAD_DISTANCES)


def reach(cfa: NDArray[np.uint8]) -> int:
    """Return the number of rows above and below a pixel that can affect its values in `clipping_maps`."""
    side = block_sides(cfa)[0]
    return (HUE_STEPS * hue_spacing(side) + sum(spread_spacings(side)) + 3) * side


@dataclass(frozen=True)
class ClippedBlocks:
    """Blocks in which some channels clip, but not all."""

    numbers: NDArray[np.intp]  # (block,): indices of the blocks, in row-major order
    own: Array  # (channel, block): channel means, at least MIN_SIGNAL
    clipped: Array  # (channel, block): degree to which each channel clips
    shape: tuple[int, int]  # block rows and block columns of the frame

    def neighbour(self, down: int, right: int) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """Return the index of each block's neighbour at an offset in blocks, and whether this neighbour exists.

        The index of a neighbour outside the frame is 0.
        """
        row, col = np.divmod(self.numbers, self.shape[1])
        row, col = row + down, col + right
        inside = (row >= 0) & (row < self.shape[0]) & (col >= 0) & (col < self.shape[1])
        return np.where(inside, row * self.shape[1] + col, 0), inside

    def scaled(self, signal: Array) -> tuple[Array, Array]:
        """Scale signals (channel, block) to the brightness of the blocks in their unclipped channels.

        Returns
        -------
        signal : ndarray, (channel, block)
            Scaled signals.
        likeness : ndarray, (block,)
            Similarity between each block and the scaled signals, from 0 to 1. It is 1 if the scaled signals equal the
            block's means in the unclipped channels, and are at least as large in the clipped channels.
        """
        ratio, unclipped = signal / self.own, 1 - self.clipped
        scale = (unclipped * ratio).sum(axis=0) / ((unclipped * ratio**2).sum(axis=0) + MIN_WEIGHT)
        missing = 1 - scale * ratio
        difference = (unclipped * missing**2 + self.clipped * np.maximum(missing, 0.0) ** 2).sum(axis=0)
        return scale * signal, np.maximum(1 - difference / MAX_DIFFERENCE, 0.0)

    def change(self, signal: Array) -> Array:
        """Return the mean squared relative difference between blocks and `signal` in the unclipped channels: (block,)."""
        unclipped = 1 - self.clipped
        return np.asarray((unclipped * (1 - signal / self.own) ** 2).sum(axis=0) / (unclipped.sum(axis=0) + MIN_WEIGHT))

    def estimated(self, colour: Array, white: Array) -> Array:
        """Estimate the signals that the blocks would have without clipping: (channel, block).

        Unclipped channels keep their signals. In clipped channels, the estimate comes from the mixture of `colour` (channel,
        block) and white that best fits the unclipped channels.
        """
        unclipped, ratio, of_white = 1 - self.clipped, colour / self.own, white[:, None] / self.own
        squares = (unclipped * ratio**2).sum(axis=0) + MIN_WEIGHT
        scale, white_scale = ((unclipped * ratio * each).sum(axis=0) / squares for each in (1.0, of_white))
        rest = of_white - white_scale * ratio
        added = (unclipped * rest * (1 - scale * ratio)).sum(axis=0) / ((unclipped * rest**2).sum(axis=0) + WHITE_DOUBT)
        added = np.maximum(added, 0.0)
        mixture = np.maximum(scale - added * white_scale, 0.0) * colour + added * white[:, None]
        return unclipped * self.own + self.clipped * np.maximum(mixture, self.own)


def estimated_maps(
    means: Array, spread: Array, response: Array, white: Array, sides: tuple[int, int]
) -> tuple[Array, Array]:
    """Estimate the hue and outputs of clipped blocks from nearby unclipped blocks.

    A nearby block may show the same surface under less light. To test this, l3 scales its signals to the brightness of the
    clipped block. If the surface is the same, the scaled signals equal the clipped block's unclipped channels, and reach
    full scale in its clipped channels. The estimates then spread over uniform areas, such as a sky, in several passes.

    Parameters
    ----------
    means : ndarray, (channel, block row, block col)
        Channel means from `block_means`.
    spread : ndarray, (block row, block col)
        Ranges from `block_means`.
    response : ndarray, (clipped, signal, output)
        `Clipping.response` of the table.
    white : ndarray, (channel,)
        `Clipping.white` of the table.
    sides : tuple of int
        Height and width of a block in pixels.

    Returns
    -------
    hue : ndarray, (map, block row, block col)
        Weight of the hue, and X/Y and Z/Y of the hue, multiplied by the weight.
    estimated : ndarray, (map, block row, block col)
        Fraction of the outputs to replace, and the estimated X, Y and Z, multiplied by this fraction. The fraction is large
        in smooth blocks next to an edge, if most of the luminance is in clipped channels. The outputs of single pixels would
        be noisy there, because they depend on weak signals in the other channels.
    """
    channels, *shape = means.shape
    signals, every = means.reshape(channels, -1), smooth_step(means, KEPT, REPLACED).reshape(channels, -1)
    numbers = np.flatnonzero((every.max(axis=0) > 0) & (every.min(axis=0) < 1))
    own = np.maximum(signals[:, numbers], MIN_SIGNAL)
    blocks = ClippedBlocks(numbers, own, every[:, numbers], (shape[0], shape[1]))
    most, partial = blocks.clipped.max(axis=0), 1 - blocks.clipped.min(axis=0)
    trust = np.where(signals.any(axis=0), (1 - every.max(axis=0)) ** 2, 0.0)

    total, likeness, steps = np.zeros_like(own), np.zeros(numbers.size), np.arange(-HUE_STEPS, HUE_STEPS + 1)
    for i, j in np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2):
        there, inside = blocks.neighbour(i * hue_spacing(sides[0]), j * hue_spacing(sides[1]))
        signal, alike = blocks.scaled(signals[:, there])
        near = (HUE_STEPS + 1 - abs(i)) * (HUE_STEPS + 1 - abs(j)) / (HUE_STEPS + 1) ** 4
        weight = near * inside * trust[there] * alike**2
        likeness += weight
        total += weight * signal
    doubt = HUE_DOUBT + GREY_DOUBT * blocks.scaled(white[:, None])[1] ** 2
    # `estimates` are the signals that each block would have without clipping. Their `reliability` is between 0 and 1.
    estimates, reliability = signals.copy(), trust.copy()
    found = blocks.estimated(total / np.where(likeness > 0, likeness, 1.0), white)
    estimates[:, numbers] = np.where(likeness > 0, found, own)
    reliability[numbers] = partial * np.maximum(trust[numbers], likeness / (likeness + doubt))

    plain = np.zeros(signals.shape[1])
    uniform, _, uniformity, _ = plain_blocks(means, spread)
    plain[uniform] = uniformity
    for down, right in zip(*map(spread_spacings, sides), strict=True):
        best = reliability[numbers].copy()
        likeness, total = best.copy(), best * estimates[:, numbers]
        for i, j in [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]:
            there, inside = blocks.neighbour(i * down, j * right)
            between, _ = blocks.neighbour(i * (down // 2), j * (right // 2))
            signal, alike = blocks.scaled(estimates[:, there])
            weight = inside * plain[numbers] * plain[between] * plain[there] * partial * reliability[there]
            weight *= np.maximum(alike - blocks.change(signals[:, there]) / MAX_CHANGE, 0.0)
            best = np.maximum(best, weight)
            weight *= (2 - abs(i)) * (2 - abs(j)) / 4
            likeness += weight
            total += weight * signal
        found = blocks.estimated(total / np.where(likeness > 0, likeness, 1.0), white)
        estimates, reliability = estimates.copy(), reliability.copy()
        estimates[:, numbers], reliability[numbers] = np.where(likeness > 0, found, own), best

    x, y, z = np.einsum("so,sb->ob", response[0, :-1], estimates[:, numbers])
    hue = np.clip(np.stack([x, z]) / np.maximum(y, MIN_WEIGHT * MIN_WEIGHT), 0.0, MAX_HUE)
    luminance = np.abs(response[0, :-1, 1]) * white
    smooth = 1 - smooth_step(spread.ravel()[numbers], PLAIN, TEXTURED)  # unlike `plain`, not influenced by adjacent blocks
    unknown = luminance @ blocks.clipped / luminance.sum()
    taken, lost = reliability[numbers] * np.stack([most, (smooth - plain[numbers]) * unknown])
    maps = np.zeros((MAPS, means[0].size))
    maps[:, numbers] = np.stack([taken, *(taken * hue), lost, lost * x, lost * y, lost * z])
    return maps[: MAPS - REPLACEMENT_MAPS].reshape(-1, *shape), maps[MAPS - REPLACEMENT_MAPS :].reshape(-1, *shape)


def grey_level(signal: Array, white: Array) -> Array:
    """Estimate the brightness of surfaces from their signals, assuming that the surfaces are grey.

    Each channel provides an estimate, and the result is their weighted mean. The more a channel clips, the lower its weight.
    If all channels clip, the result is the largest estimate.

    Parameters
    ----------
    signal : ndarray, (channel, …)
        Channel means as fractions of full scale.
    white : ndarray, (channel,)
        Signals of a white with a brightness of 1.

    Returns
    -------
    ndarray, (…)
        Brightness relative to the white.
    """
    level = np.stack([each / one for each, one in zip(signal, white, strict=True)])
    clipped = smooth_step(signal, BEGINS, CLIPS)
    weight = np.maximum(1 - clipped, MIN_WEIGHT)
    mean, every = (weight * level).sum(axis=0) / weight.sum(axis=0), clipped.min(axis=0)
    return np.asarray(mean + every * (level.max(axis=0) - mean))


def added_terms(signal: Array) -> Array:
    """Return the regressors from which corrections of clipped outputs are computed.

    Each channel has a group of terms: all channel means and the constant 1, multiplied by the degree to which the channel
    clips, which increases from CORRECTED_FROM to CLIPS.

    Parameters
    ----------
    signal : ndarray, (channel, …)
        Channel means as fractions of full scale.

    Returns
    -------
    ndarray, (channel, channel + 1, …)
        One group of terms per channel.
    """
    terms = np.concatenate([signal, np.ones_like(signal[:1])])
    return np.asarray(smooth_step(signal, CORRECTED_FROM, CLIPS)[:, None] * terms)


def smooth_step(values: Array, low: float, high: float) -> Array:
    """Apply the smoothstep function to `values`. It rises from 0 at `low` to 1 at `high`."""
    part = np.clip((values - low) / (high - low), 0.0, 1.0)
    return np.asarray(part * part * (3 - 2 * part))
