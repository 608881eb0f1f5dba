"""Uncertainty of rendered outputs: the noise of the camera through the transforms of each pixel's classes, in closed form
(docs/measurement.md#uncertainty).

    σ² = Σ t² λ        t: transform of the raw values about a pixel, through all layers; λ: noise variance of those values

Transforms are composed for each combination of classes that a frame has, at every site, as if the classes of a pixel were
those of its neighbours too; noise is that of each channel's mean about the pixel.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import PLANE_STEP, MosaicLayer, PlaneLayer, TransformTable
from l3cli.classes.clipping import clipping_maps
from l3cli.classes.coarse_chroma import BLOCK, blocks_of, own_shares, scales_of
from l3cli.classes.planes import CHROMA, LUMINANCE, opponent_basis
from l3cli.classes.refinement import RATIO_DARKEST, mirrored, window_means
from l3cli.classes.windows import window_channels
from l3cli.errors import RecipeError
from l3cli.frames.frame import RawFrame, as_taken, mirrored_indices, upright
from l3cli.rendering.conditions import at_gain, nearest_step, with_edges_for
from l3cli.rendering.reference import at_table_levels, mosaic_of
from l3cli.rendering.renderer import Renderer

Array = NDArray[np.float64]
# Bits of a mask: clipped values decide the class or the result; a class without training patches of its own.
CLIPPED, UNTRAINED = 1, 2
SHARES = 8  # steps in which shares of coarse chroma are distinguished
MOST_LAYERS = 1  # of refinement: what follows has classes that mirrored sites name in another way
# Weights by distance of what blocks of four pixels, interpolated, are of a row of pixels, wherever these begin.
BLOCKS_READ = np.array([0.07, 0.14, 0.19, 0.20, 0.19, 0.14, 0.07])
AT_ONCE = 64  # combinations of classes that are composed together


@dataclass(frozen=True)
class _Slopes:
    """Dependence of colour ratios and coarse chroma on the planes that a last layer reads, about their values: each (…)."""

    ratio: Array  # ρ of the luminance
    colour: Array  # (…, chroma) chroma over luminance, means of the window; 0 where ρ is clamped
    share: Array  # of coarse chroma


@dataclass(frozen=True)
class _Kernels:
    """Transforms of the raw values about every pixel of a frame."""

    table: TransformTable
    within: tuple[NDArray[np.int64], ...]  # by layer (combination) class within its site
    slopes: _Slopes | None  # (combination)
    combination: NDArray[np.int64]  # (row, col)
    site: NDArray[np.int64]  # (row, col)
    noise: Array  # (channel, row, col) variance of raw values about each pixel, in squares of full scale

    def variance(self) -> Array:
        """Return the variance (output, row, col) of outputs."""
        energies, variance = _energies(self), np.zeros((len(self.table.outputs), *self.site.shape))
        for output, each in enumerate(variance):
            for channel, of_channel in enumerate(self.noise):
                each += energies[self.combination, self.site, output, channel] * of_channel
        return variance

    def variance_of_mean(self, inside: NDArray[np.bool_]) -> Array:
        """Return the variance (output) of the mean over pixels (row, col) that are `inside`: of the sum of their kernels,
        since neighbours read the same raw values."""
        rows, cols = np.nonzero(inside)
        combination, site = self.combination[rows, cols], self.site[rows, cols]
        total = np.zeros((len(self.table.outputs), *inside.shape))
        period = self.table.cfa.shape
        for chosen in _batches(np.unique(combination)):
            there = np.isin(combination, chosen)
            kernels = composed(self, chosen)[np.searchsorted(chosen, combination[there]), site[there]]
            reach = kernels.shape[-1] // 2
            down, across = (mirrored_indices(n, reach, p) for n, p in zip(inside.shape, period, strict=True))
            for row, col in np.ndindex(kernels.shape[-2:]):
                at = down[rows[there] + row], across[cols[there] + col]
                for output, plane in enumerate(total):
                    np.add.at(plane, at, kernels[:, output, row, col])
        own = self.table.cfa.ravel()[self.site]
        noise = np.take_along_axis(self.noise, own[None].astype(np.intp), axis=0)[0]
        return np.asarray((total**2 * noise).sum(axis=(1, 2)) / rows.size**2)


@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty of a frame's outputs, upright as they are."""

    sigma: NDArray[np.float32]  # (row, col, output) standard deviation left by the camera's noise
    mask: NDArray[np.uint8]  # (row, col) CLIPPED, UNTRAINED or both; 0: as trained
    orientation: int
    kernels: _Kernels
    scale: Array  # (row, col) as the sensor lies: what outputs are multiplied by after the transforms

    def of_mean(self, inside: NDArray[np.bool_]) -> Array:
        """Return the standard deviation (output) of the mean over the pixels (row, col) that are `inside`, whose noise is
        correlated as the transforms make it."""
        there = as_taken(inside, self.orientation)
        return np.asarray(np.sqrt(self.kernels.variance_of_mean(there)) * float(self.scale[there].mean()))


def require_closed_form(table: TransformTable) -> None:
    """Raise RecipeError if the table does not know its camera's noise, has too many layers, or smooths spectra, of which no
    closed form is known."""
    if table.camera is None:
        raise RecipeError("the table does not hold its camera, whose noise is needed; train it again")
    if table.spectra is not None:
        raise RecipeError("the table smooths spectra, whose noise has no closed form; train it with spectral_window = 0")
    if len(table.later) > MOST_LAYERS:
        raise RecipeError(
            f"the table has {len(table.later)} refinement layers; noise is known through {MOST_LAYERS}, as of default"
        )


def uncertainty(table: TransformTable, frame: RawFrame, make: Callable[[TransformTable], Renderer]) -> Uncertainty:
    """Return the uncertainty of a frame's outputs by a table of one light; `make`: renderers of tables.

    RecipeError as `require_closed_form`.
    """
    require_closed_form(table)
    table = at_gain(table, nearest_step(frame.gain))
    table = replace(with_edges_for(table, frame.noise_share) if frame.noise_share < 1 else table, conditions=())
    renderer = make(table)
    labels = [renderer.labels(frame, number).astype(np.int64) for number in range(len(table.layers))]
    key, slopes = _keys(table, labels, frame, make)
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    inverse = inverse.reshape(key.shape)
    within = tuple(_within(layer, each.ravel()[first]) for layer, each in zip(table.layers, labels, strict=True))
    site = np.asarray(table.first.rule.split(labels[0]).site, np.int64)
    means = slopes and _means(slopes, inverse, len(first))
    kernels = _Kernels(table, within, means, inverse, site, channel_noise(frame, table, site))
    gain = 1.0 if frame.shading is None else frame.shading.gain_map(frame.values.shape[1])
    scale = np.broadcast_to(np.asarray(frame.light_share * gain, np.float64), key.shape)
    sigma = np.moveaxis(scale * np.sqrt(np.maximum(kernels.variance(), 0.0)), 0, -1).astype(np.float32)
    turn = frame.orientation
    return Uncertainty(upright(sigma, turn), upright(_mask(table, labels, frame), turn), turn, kernels, scale)


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


def _mask(table: TransformTable, labels: Sequence[NDArray[np.int64]], frame: RawFrame) -> NDArray[np.uint8]:
    """Return the mask (row, col) of pixels by their classes in each layer, and where the clipped area about them takes the
    place of their transforms, whose noise is not that of the result."""
    rule = table.first.rule
    mask = np.where(rule.case(rule.split(labels[0]).kind) > 0, CLIPPED, 0).astype(np.uint8)
    for layer, label in zip(table.layers, labels, strict=True):
        mask |= np.where(layer.samples[label] > 0, 0, UNTRAINED).astype(np.uint8)
    if table.later and (clipping := table.later[-1].clipping):
        mosaic = mosaic_of(at_table_levels(frame, table), table)
        mask |= np.where(clipping_maps(mosaic, clipping.response, clipping.white)[0] > 0, CLIPPED, 0).astype(np.uint8)
    return mask


def channel_noise(frame: RawFrame, table: TransformTable, site: NDArray[np.int64]) -> Array:
    """Return the noise variance (channel, row, col) of raw values about each pixel, in squares of full scale, by the mean of
    each channel over a patch; `site` (row, col): of the pixels."""
    from scipy.ndimage import uniform_filter

    camera = table.camera
    assert camera is not None
    levelled, camera = at_table_levels(frame, table), replace(camera, noise_left=frame.noise_share)
    every = np.arange(len(table.channels))
    constant, linear, quadratic = camera.noise_terms(frame.dark, every)
    constant, linear = (np.broadcast_to(each, every.size) for each in (constant, linear))
    channels, signal = table.cfa.ravel()[site], levelled.values - levelled.black_level
    side = max(table.first.rule.patch, *table.cfa.shape) | 1  # every window holds every channel
    noise = np.empty((every.size, *channels.shape))
    for channel, of_channel in enumerate(noise):
        there = (channels == channel).astype(np.float64)
        seen = uniform_filter(there, side, mode="mirror")
        mean = np.maximum(uniform_filter(there * signal, side, mode="mirror") / np.maximum(seen, 1e-9), 0.0)
        of_channel[:] = constant[channel] + (linear[channel] + quadratic * mean) * mean
    return noise / (table.white_level - table.black_level) ** 2


# --------------------------------------------------------------------------------------------- combinations of classes


def _within(layer: MosaicLayer | PlaneLayer, label: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the classes within their site."""
    within = layer.rule.within_site(label)
    return np.asarray(within if isinstance(layer, MosaicLayer) else within[1], np.int64)


def _keys(
    table: TransformTable, labels: Sequence[NDArray[np.int64]], frame: RawFrame, make: Callable[[TransformTable], Renderer]
) -> tuple[NDArray[np.int64], _Slopes | None]:
    """Return the combination of classes (row, col), numbers in no order, and the slopes of the last layer, if it has any."""
    key = np.zeros(labels[0].shape, np.int64)
    for layer, label in zip(table.layers, labels, strict=True):
        _, numbers = np.unique(key * len(layer.weights) + _within(layer, label), return_inverse=True)
        key = numbers.reshape(label.shape)
    last = table.later[-1] if table.later else None
    if last is None or not (last.ratio_taps or last.coarse_chroma):
        return key, None
    before = replace(table, later=table.later[:-1])
    basis = opponent_basis(table.white_point)
    planes = np.einsum("orc,op->prc", make(before).outputs(frame).astype(np.float64) / frame.light_share, basis) / PLANE_STEP
    slopes = _slopes(planes, last)
    return key * (SHARES + 1) + np.rint(slopes.share * SHARES).astype(np.int64), slopes


def _slopes(planes: Array, layer: PlaneLayer) -> _Slopes:
    """Return the slopes (row, col) of planes (plane, row, col), in their steps."""
    means = window_means(mirrored(planes, layer.radius), layer.side)
    luminance = np.maximum(means[LUMINANCE], RATIO_DARKEST)
    ratio = (planes[LUMINANCE] - means[LUMINANCE]) / luminance
    colour = np.where((np.abs(ratio) < 1) & (means[LUMINANCE] > RATIO_DARKEST), means[CHROMA] / luminance, 0.0)
    share = np.zeros_like(ratio)
    if layer.coarse_chroma:
        changed = 1.0 - own_shares(blocks_of(planes), scales_of(layer.coarse_chroma))
        rows, cols = (np.arange(length) // BLOCK for length in share.shape)
        share = changed[rows[:, None], cols]
    return _Slopes(np.clip(ratio, -1, 1), np.moveaxis(colour, 0, -1), share)


def _means(slopes: _Slopes, inverse: NDArray[np.int64], count: int) -> _Slopes:
    """Return the mean slopes of each of so many combinations of classes; `inverse` (row, col): that of each pixel."""
    pixels = np.bincount(inverse.ravel(), minlength=count)

    def mean(values: Array) -> Array:
        return np.asarray(np.bincount(inverse.ravel(), values.ravel(), count) / pixels)

    colour = np.stack([mean(slopes.colour[..., each]) for each in range(slopes.colour.shape[-1])], axis=-1)
    return _Slopes(mean(slopes.ratio), colour, mean(slopes.share))


# -------------------------------------------------------------------------------------------------------- composition


def _energies(kernels: _Kernels) -> Array:
    """Return Σ t² over the taps of each channel, (combination, site, output, channel)."""
    table, count = kernels.table, kernels.within[0].size
    energies = np.empty((count, table.cfa.size, len(table.outputs), len(table.channels)))
    for chosen in _batches(np.arange(count)):
        made = composed(kernels, chosen)
        window = window_channels(table.cfa, made.shape[-1])
        member = (window[..., None] == np.arange(len(table.channels))).astype(np.float64)  # (site, tap, channel)
        energies[chosen] = np.square(made).reshape(*made.shape[:3], -1) @ member[None]
    return energies


def _batches(combinations: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """Yield combinations a few at a time."""
    return (combinations[start : start + AT_ONCE] for start in range(0, combinations.size, AT_ONCE))


def composed(of: _Kernels, chosen: NDArray[np.int64]) -> Array:
    """Return kernels (combination, site, output, row, col) on raw values in units of full scale, of chosen combinations."""
    table, within = of.table, [each[chosen] for each in of.within]
    slopes = of.slopes and _Slopes(of.slopes.ratio[chosen], of.slopes.colour[chosen], of.slopes.share[chosen])
    first, period = table.first, table.cfa.shape
    sites = np.arange(table.cfa.size)
    kernels = first.weights[first.rule.on_site(within[0][:, None], sites)].astype(np.float64)
    kernels = kernels.reshape(*kernels.shape[:3], first.rule.patch, first.rule.patch)
    for number, layer in enumerate(table.later):
        planes = np.einsum("nsokl,op->nspkl", kernels, opponent_basis(table.white_point), optimize=True)
        place = layer.rule.split(within[1 + number])
        last = slopes if number == len(table.later) - 1 else None
        taps = _window_taps(layer, layer.rule.join(place.level[:, None], place.kind[:, None], sites), last)
        size, side = kernels.shape[-1], taps.shape[-1]
        flat = planes.reshape(*planes.shape[:3], -1)
        kernels = np.zeros((*kernels.shape[:3], size + side - 1, size + side - 1))
        for down, right in np.ndindex(side, side):
            moved = _moved(period, down - side // 2, right - side // 2)
            made = taps[..., down, right] @ flat[:, moved]
            kernels[..., down : down + size, right : right + size] += made.reshape(*made.shape[:3], size, size)
    return kernels


def _moved(period: tuple[int, ...], down: int, right: int) -> NDArray[np.int64]:
    """Return the site (site) so many pixels below and right of each."""
    row, col = np.divmod(np.arange(period[0] * period[1]), period[1])
    return np.asarray((row + down) % period[0] * period[1] + (col + right) % period[1])


def _window_taps(layer: PlaneLayer, label: NDArray[np.int64], slopes: _Slopes | None) -> Array:
    """Return the taps (combination, site, output, plane, row, col) of a layer's classes, with what its colour ratios and
    coarse chroma add to first order."""
    weights = layer.weights[label].astype(np.float64)
    planes, side = weights.shape[2], layer.side
    taps = weights[..., : layer.window_taps].reshape(*weights.shape[:3], planes, side, side).copy()
    if slopes is None:
        return taps
    ratio = slopes.ratio[:, None, None, None, None]
    for place, plane in enumerate(CHROMA[: layer.ratio_taps]):
        weight = weights[..., layer.window_taps + place][..., None, None]
        colour = slopes.colour[:, place][:, None, None, None, None]
        taps[..., plane, :, :] += weight * ratio / side**2
        taps[..., LUMINANCE, :, :] -= weight * colour * (1 + ratio) / side**2
        taps[..., LUMINANCE, layer.radius, layer.radius] += (weight * colour)[..., 0, 0]
    if layer.coarse_chroma:
        wider = max(len(BLOCKS_READ) - side, 0) // 2
        taps = np.pad(taps, [(0, 0)] * 4 + [(wider, wider)] * 2)
        taken = np.pad(np.outer(BLOCKS_READ, BLOCKS_READ), max(side - len(BLOCKS_READ), 0) // 2)
        for plane in CHROMA:
            taps[:, :, plane, plane] -= slopes.share[:, None, None, None] * taken
    return taps
