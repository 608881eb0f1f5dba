"""Uncertainty of rendered outputs (docs/measurement.md#uncertainty): the noise of the camera through all that a table does,
the choice of classes included, by the parametric bootstrap.

    σ(p) = G(class) · K(kind) · s(p)      s: standard deviation of a raw value as bright as the output of the pixel p

The picture is taken for a scene, which the camera sees again and again with new noise. Gains G of the classes of the last
layer, and factors K of the kinds of the first, make the mean σ of each the standard deviation of those renderings.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import QUANTISATION, CameraModel
from l3cli.artifacts.table import MosaicLayer, TransformTable
from l3cli.classes.clipping import KEPT, block_maps, block_means, block_sides
from l3cli.errors import RecipeError
from l3cli.frames.frame import RawFrame, shifted_cfa, tiled, upright
from l3cli.rendering.reference import at_table_levels, mosaic_of
from l3cli.rendering.renderer import Renderer

Array = NDArray[np.floating]
Labels = NDArray[np.integer]
# Bits of a mask: clipped values decide the class or the result; a class without training patches of its own.
CLIPPED, UNTRAINED = 1, 2
PIECE, PIECES, SEAM = 96, 4, 8  # pixels, side of a piece of a large frame; pieces a side; pixels at edges, not counted
BUDGET, DRAWS = 1 << 18, (5, 40)  # pixels that all renderings have, unless that makes fewer or more renderings
SMOOTHED = 0.5  # pixels, of a Gaussian: noise that is left in a picture would count twice
ROUNDS = 4  # in which gains and factors settle
PRIOR = 50  # pixels for which a class follows the classes that it is one of
TILES = (1, 2, 4, 8, 16)  # pixels, sides of regions whose means are compared; pieces hold whole ones
FEWEST = 9  # tiles of a frame
LITTLE = 1e-30  # where noise changes no raw value, as in a black frame of a quiet camera, σ is 0
LEAST = 32  # pixels, side of a frame
SEED = 20


@dataclass(frozen=True)
class NoiseGains:
    """Noise of outputs over that of raw values, as a scene has it; serves other frames of the scene."""

    by_class: NDArray[np.float32]  # (class of the last layer, output)
    by_kind: NDArray[np.float32]  # (class of the first layer, output) factor of its kind
    area: Array  # (tile, output) variance of the mean over a tile times its pixels, over that of a pixel
    unit: float  # DN of a raw value where the brightness of the outputs is 1


@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty of a frame's outputs, upright as they are."""

    sigma: NDArray[np.float32]  # (row, col, output) standard deviation left by the camera's noise
    bias: NDArray[np.float32] | None  # (row, col, output) mean error of the class in training; None: not known of the table
    mask: NDArray[np.uint8]  # (row, col) CLIPPED, UNTRAINED or both; 0: as trained
    gains: NoiseGains

    def of_mean(self, inside: NDArray[np.bool_]) -> Array:
        """Return the standard deviation (output) of the mean over the pixels (row, col) that are `inside`, whose noise is
        correlated as that of a square of as many pixels."""
        pixels = int(inside.sum())
        sides = np.log2(TILES[: len(self.gains.area)])
        area = np.array([np.interp(math.log2(pixels) / 2, sides, each) for each in self.gains.area.T])
        return np.sqrt(np.square(self.sigma[inside].astype(np.float64)).mean(axis=0) * area / pixels)


def require_known_noise(table: TransformTable) -> None:
    """Raise RecipeError if the table does not know its camera's noise."""
    if table.camera is None:
        raise RecipeError("the table does not hold its camera, whose noise is needed; train it again")


def uncertainty(renderer: Renderer, frame: RawFrame, like: Uncertainty | None = None) -> Uncertainty:
    """Return the uncertainty of a frame's outputs by a renderer of one set of transforms, those for the frame's gain and
    noise; `like`: that of a frame of the same scene, whose gains serve. RecipeError as `require_known_noise`, and for a
    frame that is too small."""
    table = renderer.table
    require_known_noise(table)
    outputs = renderer.outputs(frame)
    labels = [renderer.labels(frame, number) for number in sorted({0, len(table.later)})]
    gain = 1.0 if frame.shading is None else frame.shading.gain_map(frame.values.shape[1])
    scale = np.asarray(frame.light_share * gain, np.float32)
    gains = like.gains if like else _noise_gains(renderer, frame, outputs / scale)
    spread = scale * _raw_sigma(table, frame, gains.unit, outputs, scale)
    sigma = gains.by_class.take(labels[-1], axis=0)
    sigma *= spread[..., None]
    if table.later:
        sigma *= gains.by_kind.take(labels[0], axis=0)
    turn, bias = frame.orientation, None
    if known := table.layers[-1].bias:
        bias = upright(known.mean.take(labels[-1], axis=0) * np.broadcast_to(scale, spread.shape)[..., None], turn)
    return Uncertainty(upright(sigma, turn), bias, upright(_mask(table, labels, frame), turn), gains)


@dataclass(frozen=True)
class RegionMean:
    """Mean outputs over a region of a picture."""

    mean: Array  # (output)
    sigma: Array  # (output) standard deviation that the camera's noise leaves
    pixels: int
    unusual: float  # share of pixels that are clipped or of classes without training patches


def region(picture: NDArray[np.floating], of: Uncertainty, polygon: Sequence[tuple[float, float]]) -> RegionMean:
    """Return the mean of a picture's outputs (row, col, output) over the pixels whose centres lie in a polygon of (row, col)
    corners, with its uncertainty, in which the correlations of pixels count. RecipeError if it holds no pixel, or picture
    and uncertainty are not of one frame."""
    if picture.shape != of.sigma.shape:
        raise RecipeError(f"the picture is of shape {picture.shape}, its uncertainty {of.sigma.shape}; give one frame's")
    inside = within_polygon(picture.shape[:2], polygon)
    if not inside.any():
        raise RecipeError("the polygon holds no pixel; give corners as (row, col) within the picture")
    mean = picture[inside].mean(axis=0, dtype=np.float64)
    return RegionMean(mean, of.of_mean(inside), int(inside.sum()), float((of.mask[inside] > 0).mean()))


def within_polygon(shape: tuple[int, ...], polygon: Sequence[tuple[float, float]]) -> NDArray[np.bool_]:
    """Return which pixels (row, col) have their centres, whole numbers, within a polygon of (row, col) corners, by the
    even-odd rule."""
    row, col = np.indices(shape)
    inside = np.zeros(shape, bool)
    corners = np.asarray(polygon, np.float64)
    for (top, left), (bottom, right) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        crossed = (row < top) != (row < bottom)
        with np.errstate(divide="ignore", invalid="ignore"):
            inside ^= crossed & (col < left + (row - top) * (right - left) / (bottom - top))
    return inside


def _mask(table: TransformTable, labels: Sequence[Labels], frame: RawFrame) -> NDArray[np.uint8]:
    """Return the mask (row, col) of pixels by their classes, and where the clipped area about them takes the place of their
    transforms."""
    rule = table.first.rule
    clipped = rule.case(rule.split(np.arange(len(table.first.weights))).kind) > 0
    flags = np.where(clipped, CLIPPED, 0).astype(np.uint8)
    flags[table.first.samples == 0] |= UNTRAINED
    mask = flags.take(labels[0])
    if not table.later:
        return mask
    mask |= np.where(table.later[-1].samples > 0, 0, UNTRAINED).astype(np.uint8).take(labels[-1])
    mosaic = mosaic_of(at_table_levels(frame, table), table)
    clipping = table.later[-1].clipping
    if clipping and mosaic.values.max() - mosaic.black_level >= KEPT * (mosaic.white_level - mosaic.black_level):
        means = block_means(mosaic, len(table.channels))
        replaced = np.pad(block_maps(*means, clipping.response, clipping.white)[0] > 0, 1, mode="edge")
        for axis, (length, side) in enumerate(zip(mask.shape, block_sides(mosaic.cfa), strict=True)):
            low = (np.arange(length) + side // 2) // side  # of the blocks on either side of a pixel, counted from the margin
            replaced = replaced.take(low, axis) | replaced.take(low + 1, axis)
        mask |= np.where(replaced, CLIPPED, 0).astype(np.uint8)
    return mask


def _raw_sigma(table: TransformTable, frame: RawFrame, unit: float, outputs: Array, scale: Array) -> Array:
    """Return the standard deviation (row, col), as a share of full scale, of raw values as bright as outputs (output, row,
    col), those of transforms times `scale`; mean over the channels."""
    constant, linear, quadratic = (np.mean(term) for term in _noise_terms(table, frame))
    signal = np.maximum(_brightness(table, outputs), 0) * (np.float32(unit) / scale)
    variance = (np.float32(quadratic) * signal + np.float32(linear)) * signal + np.float32(constant)
    return np.sqrt(variance, out=variance) / np.float32(table.white_level - table.black_level)


def _brightness(table: TransformTable, outputs: Array) -> Array:
    return np.asarray(outputs[table.outputs.index("Y")] if "Y" in table.outputs else outputs.mean(axis=0))


def _noise_terms(table: TransformTable, frame: RawFrame) -> tuple[Array, Array, float]:
    """Return the terms (channel) of the noise of a frame at the table's levels."""
    assert table.camera is not None
    every = np.arange(len(table.channels))
    camera: CameraModel = replace(table.camera, noise_left=frame.noise_share)
    dark = frame.dark * (table.white_level - table.black_level) / (frame.white_level - frame.black_level)
    constant, linear, quadratic = camera.noise_terms(dark, every)
    return np.broadcast_to(constant, every.size), np.broadcast_to(linear, every.size), quadratic


# ----------------------------------------------------------------------------------------------------------- bootstrap


def _noise_gains(renderer: Renderer, frame: RawFrame, outputs: Array) -> NoiseGains:
    """Return the gains of the scene that a frame's outputs (output, row, col) show, before they are scaled."""
    from scipy.ndimage import gaussian_filter

    table = renderer.table
    if min(frame.values.shape) < LEAST:
        raise RecipeError(f"the frame is smaller than {LEAST}×{LEAST} pixels; too few to tell what noise does")
    matrix, unit = _back(table, at_table_levels(frame, table), outputs)
    rows, cols = (_sampled(length) for length in outputs.shape[1:])
    scene = gaussian_filter(outputs[:, rows[:, None], cols].astype(np.float64), (0, SMOOTHED, SMOOTHED))
    channel = tiled(table.cfa, scene.shape[1:])
    span = table.white_level - table.black_level
    signal = np.einsum("rco,orc->rc", matrix[channel], scene).clip(0, span)
    constant, linear, quadratic = _noise_terms(table, frame)
    sigma = np.sqrt(np.maximum(constant[channel] + (linear[channel] + quadratic * signal) * signal - QUANTISATION, 0))
    rng = np.random.default_rng(SEED)
    made, first, last, spread = [], [], [], []
    draws = int(np.clip(BUDGET // signal.size, *DRAWS))
    inner = np.ix_(_counts(rows), _counts(cols))
    for _ in range(draws):
        values = np.rint(table.black_level + signal + sigma * rng.standard_normal(signal.shape, np.float32))
        values = np.clip(values, 0, 2**table.bits - 1).astype(np.uint16)
        again = RawFrame("again", values, table.black_level, table.white_level)
        made.append(renderer.outputs(again))
        first.append(renderer.labels(again)[inner])
        last.append(renderer.labels(again, len(table.later))[inner])
        spread.append(_raw_sigma(table, frame, unit, made[-1], np.ones(1, np.float32))[inner])
    deviations = np.asarray(made) - np.mean(made, axis=0)
    # Without the bias of a root of few squares.
    chi = math.exp(math.lgamma(draws / 2) - math.lgamma((draws - 1) / 2)) * math.sqrt(2 / draws)
    measured = np.moveaxis(np.sqrt(np.square(deviations).mean(axis=0)) / chi, 0, -1)[inner]
    by_class, by_kind = _raked(table, np.array(first), np.array(last), np.array(spread), measured)
    return NoiseGains(by_class.astype(np.float32), by_kind.astype(np.float32), _areas(deviations[..., *inner]), unit)


def _back(table: TransformTable, levelled: RawFrame, outputs: Array) -> tuple[Array, float]:
    """Return the signals (channel, output), in DN, that outputs (output, row, col) stand for, by least squares over blocks
    of a frame at the table's levels, relative to their brightness; and mean DN over mean brightness."""
    sides = block_sides(table.cfa)
    cut = tuple(length // side * side for length, side in zip(levelled.values.shape, sides, strict=True))
    inside = np.s_[..., : cut[0], : cut[1]]

    def means(planes: Array) -> Array:
        parts = planes[inside].reshape(len(planes), cut[0] // sides[0], sides[0], cut[1] // sides[1], sides[1])
        return parts.mean(axis=(2, 4)).reshape(len(planes), -1)

    channel = tiled(shifted_cfa(table.cfa, levelled.phase), levelled.values.shape)
    there = channel == np.arange(len(table.channels))[:, None, None]
    signal = means(there * (levelled.values - levelled.black_level)) / np.maximum(means(there), 1e-9)
    wanted = means(outputs.astype(np.float64))
    weight = 1 / np.maximum(signal.mean(axis=0), 1.0)
    matrix = np.linalg.lstsq((wanted * weight).T, (signal * weight).T, rcond=1e-3)[0].T
    unit = signal.mean() / max(float(_brightness(table, wanted).mean()), 1e-9)
    return matrix, float(max(unit, 0.0))


def _sampled(length: int) -> NDArray[np.int64]:
    """Return indices along a side of a frame: all, or those of a few pieces spread evenly."""
    if length <= PIECE * PIECES:
        return np.arange(length)
    starts = np.linspace(0, length - PIECE, PIECES).astype(np.int64)
    return (starts[:, None] + np.arange(PIECE)).ravel()


def _counts(indices: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which of `_sampled` indices lie away from seams of pieces and from the ends, where mirrored neighbours make
    noise larger."""
    seams = np.concatenate([[-0.5], np.flatnonzero(np.diff(indices) != 1) + 0.5, [indices.size - 0.5]])
    return np.asarray(np.abs(np.arange(indices.size)[:, None] - seams).min(axis=1) > SEAM)


def _raked(table: TransformTable, first: Labels, last: Labels, spread: Array, measured: Array) -> tuple[Array, Array]:
    """Return gains (class of the last layer, output) and factors (class of the first, output) by which, over the pixels of
    each level, class within its site and class of the last layer, and of each kind of the first, the mean over the draws of
    what classes (draw, row, col) and `spread` (draw, row, col) predict is what was `measured` (row, col, output)."""
    layer, rule = table.layers[-1], table.first.rule
    place, every = layer.rule.split(np.arange(len(layer.weights))), np.arange(len(layer.weights))
    within = layer.rule.within_site(every)
    kind = np.asarray(rule.split(np.arange(len(table.first.weights))).kind)
    axes = [np.asarray(place.level), np.asarray(within if isinstance(layer, MosaicLayer) else within[1]), every]
    cells = [each[last].reshape(len(last), -1) for each in axes]
    if table.later:
        cells.append(kind[first].reshape(len(first), -1))
    spread, measured = spread.reshape(len(spread), -1, 1), measured.reshape(-1, measured.shape[-1]).astype(np.float64)
    factors = [np.ones((int(cell.max()) + 1, measured.shape[1])) for cell in cells]
    factors[0] *= measured.sum(axis=0) / spread.mean(axis=0).sum()
    seen = [_summed(cell, np.broadcast_to(measured, (len(cell), *measured.shape))) for cell in cells]
    prior = PRIOR * len(last) * measured.mean(axis=0)
    predicted = spread * math.prod(factor[cell] for factor, cell in zip(factors, cells, strict=True))
    for _ in range(ROUNDS):
        for factor, cell, wanted in zip(factors, cells, seen, strict=True):
            mean = np.broadcast_to(predicted.mean(axis=0), predicted.shape)
            change = (wanted + prior) / np.maximum(_summed(cell, mean) + prior, LITTLE)
            factor *= change
            predicted = predicted * change[cell]
    gains = math.prod(_filled(factor, axis) for factor, axis in zip(factors, axes, strict=False))
    return np.asarray(gains), _filled(factors[3], kind) if table.later else np.ones((1, 1))


def _summed(cell: Labels, values: Array) -> Array:
    """Return the sums (cell, output) of values (draw, pixel, output) by their cells (draw, pixel)."""
    return np.stack([np.bincount(cell.ravel(), values[..., o].ravel()) for o in range(values.shape[-1])], axis=-1)


def _filled(factor: Array, cell: Labels) -> Array:
    """Return the factors (class, output) of the cells (class); of those that no pixel was in, 1."""
    return np.asarray(np.pad(factor, ((0, max(int(cell.max()) + 1 - len(factor), 0)), (0, 0)), constant_values=1.0)[cell])


def _areas(deviations: Array) -> Array:
    """Return how the means of tiles vary (tile, output), from deviations (draw, output, row, col)."""
    areas = []
    for side in TILES:
        rows, cols = (length // side for length in deviations.shape[2:])
        if rows * cols < FEWEST:
            break
        cut = deviations[..., : rows * side, : cols * side].reshape(*deviations.shape[:2], rows, side, cols, side)
        areas.append(side**2 * np.square(cut.mean(axis=(3, 5))).mean(axis=(0, 2, 3)))
    return np.array(areas) / np.maximum(areas[0], LITTLE)
