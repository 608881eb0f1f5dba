"""Compute the uncertainty of rendered outputs due to camera noise (docs/measurement.md#uncertainty).

The standard deviation of an output at pixel p is modelled as

    σ(p) = G(class) · K(kind) · E(p) · s(p)

* s is the standard deviation of a raw value at the pixel's signal level.
* G is a gain for each class of the last layer.
* K is a factor for each kind (chroma or saturation case) of the first layer.
* E is a factor for the outermost rows and columns. They are noisier, because mirrored windows contain some raw values twice.

G, K and E are determined by a parametric bootstrap. The rendered picture is treated as the true scene. Several frames of
this scene with independent noise are simulated and rendered. G, K and E are then fitted so that the mean σ equals the
measured standard deviation over the renderings, in each class, in each kind, and in the outermost rows and columns. The
result includes the effect of noise on the classification.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import QUANTISATION, CameraModel
from l3cli.artifacts.layers import MosaicLayer
from l3cli.artifacts.table import TransformTable
from l3cli.classes.clipping import KEPT, block_means, block_sides, estimated_maps, plain_blocks
from l3cli.classes.coarse_chroma import BLOCK
from l3cli.errors import RecipeError
from l3cli.frames.frame import RawFrame, upright
from l3cli.physics.mosaic import shifted_cfa, tiled
from l3cli.physics.stokes import MAX_CORRELATION, has_stokes, luminance_name, polarisation_sigma, stokes_of
from l3cli.rendering.reference import at_table_levels, mosaic_of
from l3cli.rendering.renderer import Renderer

Array = NDArray[np.floating]
Labels = NDArray[np.integer]
CLIPPED = 1  # bit of the mask: clipped values affect the class or the result
UNTRAINED = 2  # bit of the mask: the class has no training patches
# In large frames, only a grid of pieces is simulated.
PIECE_PIXELS = 96  # approximate side of a piece
PIECES_PER_SIDE = 4  # number of pieces along each side of the frame
SEAM_PIXELS = 8  # width of the border to ignore in each piece
BUDGET = 1 << 18  # approximate total number of pixels in all renderings
DRAWS = (5, 40)  # minimum and maximum numbers of renderings
SMOOTHED = 0.5  # σ in pixels of a Gaussian blur that removes the picture's own noise before noise is simulated
FITS = 3  # iterations of the robust fit from outputs to raw signals
ROUNDS = 4  # iterations of the fit of G and K, enough for convergence
PRIOR = 50  # weight, in pixels, of the prior that a class has the same gain as the larger group that contains it
EDGE_PIXELS = 4  # number of rows and columns at each side with their own factor E; elsewhere, E is within 2 % of 1
TILES = (1, 2, 4, 8, 16)  # sides of tiles, in pixels; the noise of tile means is measured for each size
MIN_TILES = 9  # tile sizes with fewer tiles per rendering are not evaluated
MIN_VARIANCE = 1e-30  # avoids division by zero if noise changes no raw value, as in a black frame
MIN_SIDE = 32  # smallest side of a frame, in pixels
SUMS = ((0, 1), (0, 2), (1, 2))  # pairs of Stokes parameters; the variances of their sums determine their covariances
STRIP = 1 << 16  # number of pixels to process together, so that they fit into the CPU cache
SEED = 20


@dataclass(frozen=True)
class NoiseGains:
    """The factors G, K and E, which convert raw noise to output noise (see the module docstring)."""

    # If the table has Stokes parameters, the axis "output" contains the outputs, followed by SUMS.
    by_class: NDArray[np.float32]  # (class of the last layer, output) gain G
    by_kind: NDArray[np.float32]  # (class of the first layer, output) factor K
    by_edge: NDArray[np.float32]  # (side, distance, output) factor E; the sides are top, bottom, left and right
    # (tile size, output) variance of tile means times the pixels per tile, relative to the pixel variance; 1 for white noise
    area: Array
    unit: float  # raw signal above black, in DN, at which the brightness of the outputs is 1


@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty of a frame's outputs, in upright orientation."""

    sigma: NDArray[np.float32]  # (row, col, output) standard deviation due to camera noise
    mask: NDArray[np.uint8]  # (row, col) bits CLIPPED and UNTRAINED; 0 for reliable pixels
    gains: NoiseGains  # result of the bootstrap, reusable for other frames of the same scene
    # (row, col, 2) standard deviations of DoLP, and of AoLP in degrees; None for tables without Stokes parameters
    polarisation: NDArray[np.float32] | None = None

    def of_mean(self, inside: NDArray[np.bool_]) -> Array:
        """Return the standard deviation, due to noise, of each output's mean over a region.

        The correlation between pixels is assumed to have the same effect as in a square with the same number of pixels.

        Parameters
        ----------
        inside : ndarray of bool, (row, col)
            Mask of the region, with at least one pixel.

        Returns
        -------
        ndarray, (output,)
        """
        pixels = int(inside.sum())
        sides = np.log2(TILES[: len(self.gains.area)])
        area = np.array([np.interp(math.log2(pixels) / 2, sides, each) for each in self.gains.area.T])
        return np.sqrt(np.square(self.sigma[inside].astype(np.float64)).mean(axis=0) * area / pixels)


def require_known_noise(table: TransformTable) -> None:
    """Raise a RecipeError if the table does not contain its camera's noise model."""
    if table.camera is None:
        raise RecipeError(
            "the uncertainty depends on the camera's noise model, which this table does not contain; train the table again"
        )


def uncertainty(renderer: Renderer, frame: RawFrame, like: Uncertainty | None = None) -> Uncertainty:
    """Compute the uncertainty of a frame's outputs.

    Parameters
    ----------
    renderer : Renderer
        Renderer with a single set of transforms, trained for the gain and noise of the frame.
    frame : RawFrame
        The raw frame.
    like : Uncertainty, optional
        Uncertainty of another frame of the same scene. Its factors G, K and E are reused, so the bootstrap is skipped.

    Returns
    -------
    Uncertainty

    Raises
    ------
    RecipeError
        If the table does not contain its camera's noise model, if the frame requests a lens warp, or if it is too small.
    """
    if frame.warps:
        raise RecipeError(
            f"{frame.name} requests a lens warp, for which l3 cannot compute the uncertainty; set ‹opcodes› leave to omit "
            "the warp"
        )
    table = renderer.table
    require_known_noise(table)
    (outputs, labels), (rows, columns) = renderer.classified(frame), frame.values.shape
    gain = 1.0 if frame.shading is None else frame.shading.gain_map(columns)
    scale = np.asarray(frame.light_share * gain, np.float32)
    gains = like.gains if like else _noise_gains(renderer, frame, outputs, scale)
    flags = _flags(table)
    by_class, by_kind = (np.ascontiguousarray(each.T) for each in (gains.by_class, gains.by_kind))
    sigma = np.empty((by_class.shape[0], rows, columns), outputs.dtype)
    mask, terms = _replaced(table, frame), _noise_terms(table, frame)
    for first in range(0, rows, step := max(STRIP // columns, 1)):
        strip = np.s_[first : first + step]
        cells, share = [each[strip].astype(np.intp) for each in labels], scale[strip] if scale.ndim else scale
        spread = _raw_sigma(table, terms, gains.unit, outputs[:, strip], share)
        for of, cell in zip(flags, cells, strict=True):
            mask[strip] |= of.take(cell)
        for plane, of, of_kind in zip(sigma[:, strip], by_class, by_kind, strict=True):
            of.take(cells[-1], out=plane, mode="clip")
            plane *= spread
            if table.later:
                plane *= of_kind.take(cells[0])
    for of_side, side in zip(gains.by_edge, _sides(sigma), strict=True):
        side *= of_side.T[:, :, None]
    turn, own, polarisation = frame.orientation, sigma[: len(outputs)], None
    if has_stokes(table.outputs):
        polarisation = upright(_of_polarisation(table, outputs, sigma), turn)
    return Uncertainty(upright(np.moveaxis(own, 0, -1), turn), upright(mask, turn), gains, polarisation)


def _with_sums(table: TransformTable, outputs: Array) -> Array:
    """Append the sums of pairs of Stokes parameters (SUMS) if the outputs contain Stokes parameters."""
    if not has_stokes(table.outputs):
        return outputs
    stokes = stokes_of(outputs, table.outputs)
    return np.concatenate([outputs, [stokes[one] + stokes[other] for one, other in SUMS]])


def _of_polarisation(table: TransformTable, outputs: Array, sigma: Array) -> NDArray[np.float32]:
    """Return the standard deviations of DoLP, and of AoLP in degrees: (row, col, 2).

    `sigma` (output, row, col) contains the standard deviations of the outputs and of SUMS. The covariance of two Stokes
    parameters follows from their variances and the variance of their sum.
    """
    made = np.empty((*outputs.shape[1:], 2), np.float32)
    for first in range(0, len(made), step := max(STRIP // made.shape[1], 1)):
        strip = np.s_[:, first : first + step]
        stokes = stokes_of(outputs[strip], table.outputs).astype(np.float64)
        each = stokes_of(sigma[: len(outputs)][strip], table.outputs).astype(np.float64)
        covariance = np.zeros((3, *stokes.shape))
        covariance[np.arange(3), np.arange(3)] = np.square(each)
        for (one, other), of_sum in zip(SUMS, sigma[len(outputs) :][strip], strict=True):
            most = MAX_CORRELATION * each[one] * each[other]
            product = (np.square(of_sum) - np.square(each[one]) - np.square(each[other])) / 2
            covariance[one, other] = covariance[other, one] = np.clip(product, -most, most)
        made[first : first + step] = np.moveaxis(polarisation_sigma(stokes, covariance), 0, -1)
    return made


@dataclass(frozen=True)
class RegionMean:
    """Mean of the outputs over a region of a picture."""

    mean: Array  # (output)
    sigma: Array  # (output) standard deviation of the mean due to camera noise
    pixels: int  # number of pixels
    unusual: float  # fraction of pixels that are clipped, or in a class without training patches


def region(picture: NDArray[np.floating], of: Uncertainty, polygon: Sequence[tuple[float, float]]) -> RegionMean:
    """Average the outputs over a polygon, and compute the uncertainty of the mean.

    The noise of neighbouring pixels is correlated, because their windows share raw values. The uncertainty of the mean takes
    this correlation into account.

    Parameters
    ----------
    picture : ndarray, (row, col, output)
        Outputs of a frame, from `Renderer.outputs`.
    of : Uncertainty
        Uncertainty of the same frame, from `Renderer.uncertainty`.
    polygon : sequence of (float, float)
        Corners (row, col). Pixel centres have integer coordinates. A pixel is in the region if its centre is inside the
        polygon.

    Returns
    -------
    RegionMean

    Raises
    ------
    RecipeError
        If no pixel is inside the polygon, or if the picture and the uncertainty have different shapes.

    Examples
    --------
    >>> import l3cli as l3
    >>> renderer = l3.Renderer("table.h5")
    >>> frame = l3.read_raw("unseen/00000_composition-5-0_raw.tif", renderer.table)
    >>> grey = l3.region(renderer.outputs(frame), renderer.uncertainty(frame), [(10, 10), (10, 40), (30, 40), (30, 10)])
    >>> grey.mean.shape, grey.sigma.shape, grey.pixels
    ((3,), (3,), 600)
    """
    if picture.shape != of.sigma.shape:
        raise RecipeError(
            f"the picture has the shape {picture.shape}, but the uncertainty has the shape {of.sigma.shape}; compute both "
            "from the same frame"
        )
    inside = within_polygon(picture.shape[:2], polygon)
    if not inside.any():
        raise RecipeError("the polygon contains no pixel centre; use corners (row, col) inside the picture")
    mean = picture[inside].mean(axis=0, dtype=np.float64)
    return RegionMean(mean, of.of_mean(inside), int(inside.sum()), float((of.mask[inside] > 0).mean()))


def within_polygon(shape: tuple[int, ...], polygon: Sequence[tuple[float, float]]) -> NDArray[np.bool_]:
    """Return a mask (row, col) of the pixels with centres inside a polygon, by the even-odd rule.

    Parameters
    ----------
    shape : tuple of int
        Numbers of rows and columns.
    polygon : sequence of (float, float)
        Corners (row, col). Pixel centres have integer coordinates.
    """
    row, col = np.indices(shape)
    inside = np.zeros(shape, bool)
    corners = np.asarray(polygon, np.float64)
    for (top, left), (bottom, right) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        crossed = (row < top) != (row < bottom)
        with np.errstate(divide="ignore", invalid="ignore"):
            inside ^= crossed & (col < left + (row - top) * (right - left) / (bottom - top))
    return inside


def _flags(table: TransformTable) -> list[NDArray[np.uint8]]:
    """Return the mask bits (CLIPPED, UNTRAINED) of each class, for the first layer and, if there is another, the last."""
    rule, samples = table.first.rule, [table.first.samples, *(layer.samples for layer in table.later[-1:])]
    flags = [np.where(each > 0, 0, UNTRAINED).astype(np.uint8) for each in samples]
    flags[0][rule.case(rule.split(np.arange(len(table.first.weights))).kind) > 0] |= CLIPPED
    return flags


def _replaced(table: TransformTable, frame: RawFrame) -> NDArray[np.uint8]:
    """Return an array (row, col) that is CLIPPED where rendering corrects clipped areas, and 0 elsewhere."""
    none, clipping = np.zeros(frame.values.shape, np.uint8), table.later[-1].clipping if table.later else None
    if clipping is None:
        return none
    mosaic = mosaic_of(at_table_levels(frame, table), table)
    if mosaic.values.max() - mosaic.black_level < KEPT * (mosaic.white_level - mosaic.black_level):
        return none
    (means, spread), sides = block_means(mosaic, len(table.channels)), block_sides(mosaic.cfa)
    numbers, _, _, share = plain_blocks(means, spread)
    hue, _ = estimated_maps(means, spread, clipping.response, clipping.white, sides)
    blocks = np.where(hue[0] > 0, CLIPPED, 0).astype(np.uint8)
    np.put(blocks, numbers[share > 0], CLIPPED)
    replaced = np.pad(blocks, 1, mode="edge")
    for axis, side in enumerate(sides):
        # Each pixel is interpolated between the blocks `low` and `low + 1` of the padded map.
        low = (np.arange(none.shape[axis]) + side // 2) // side
        replaced = replaced.take(low, axis) | replaced.take(low + 1, axis)
    return replaced


def _sides(planes: NDArray[Any]) -> list[NDArray[Any]]:
    """Return views of the outermost rows and columns at the top, bottom, left and right.

    Each view has the axes (…, distance from the border, position along the border).
    """
    turned = planes.swapaxes(-1, -2)
    return [each[..., :EDGE_PIXELS, :] for each in (planes, planes[..., ::-1, :], turned, turned[..., ::-1, :])]


def _raw_sigma(
    table: TransformTable, terms: tuple[Array, Array, float], unit: float, outputs: Array, scale: Array
) -> Array:  # fmt: skip
    """Return the standard deviation s of a raw value at each pixel's signal level, as a fraction of full scale.

    The noise terms are averaged over the channels. `scale` is `RawFrame.light_share` times each pixel's shading gain. Both
    the outputs and the result include this factor.
    """
    span = table.white_level - table.black_level
    constant, linear, quadratic = (np.mean(term) / span**2 for term in terms)
    signal = np.maximum(_brightness(table, outputs), 0)
    variance = signal * np.float32(quadratic * unit**2)
    variance += np.float32(linear * unit) * scale
    variance *= signal
    variance += np.float32(constant) * scale**2
    return np.sqrt(variance, out=variance)


def _brightness(table: TransformTable, outputs: Array) -> Array:
    name = luminance_name(table.outputs)
    return np.asarray(outputs[table.outputs.index(name)] if name in table.outputs else outputs.mean(axis=0))


def _noise_terms(table: TransformTable, frame: RawFrame) -> tuple[Array, Array, float]:
    """Return a frame's constant (channel,), linear (channel,) and quadratic noise terms.

    They apply to raw values in DN, scaled to the table's black and white levels.
    """
    every = np.arange(len(table.channels))
    camera, dark = _camera_and_dark(table, frame)
    constant, linear, quadratic = camera.noise_terms(dark, every)
    return np.broadcast_to(constant, every.size), np.broadcast_to(linear, every.size), quadratic


def _line_variances(table: TransformTable, frame: RawFrame) -> tuple[float, float]:
    """Return the variances of row noise and column noise in DN², for values scaled to the table's levels."""
    camera, dark = _camera_and_dark(table, frame)
    return camera.line_variances(dark)


def _camera_and_dark(table: TransformTable, frame: RawFrame) -> tuple[CameraModel, float]:
    """Return the table's camera with its noise reduced to the noise of the frame, and the frame's dark signal.

    In a temporally filtered frame, only the fraction `frame.noise_share` of the noise variance is left. The dark signal is
    in DN, scaled to the table's black and white levels.
    """
    assert table.camera is not None
    dark = frame.dark * (table.white_level - table.black_level) / (frame.white_level - frame.black_level)
    return replace(table.camera, noise_left=frame.noise_share), dark


# ----------------------------------------------------------------------------------------------------------- bootstrap


def _noise_gains(renderer: Renderer, frame: RawFrame, outputs: Array, scale: Array) -> NoiseGains:
    """Determine the factors G, K and E by a bootstrap. The frame's `outputs` are multiplied by `scale`.

    Raises RecipeError if the frame is too small.
    """
    from scipy.ndimage import gaussian_filter

    table = renderer.table
    # Two steps of rendering work on blocks: the correction of clipped areas, and coarse chroma. Pieces begin at multiples of
    # both block sizes.
    units = [math.lcm(side, BLOCK) for side in block_sides(table.cfa)]
    if min(frame.values.shape) < (least := max(MIN_SIDE, *units)):
        tall, wide = frame.values.shape
        raise RecipeError(
            f"the frame has {tall}×{wide} pixels, but the uncertainty requires at least {least}×{least} pixels; use a "
            "larger frame"
        )
    rows, cols = (_sampled(length, unit) for length, unit in zip(frame.values.shape, units, strict=True))
    shown = _cut(outputs, rows, cols) / (_cut(scale, rows, cols) if scale.ndim else scale)
    levelled = at_table_levels(frame, table)
    matrix, unit = _back(table, levelled, (rows, cols), shown)
    scene = gaussian_filter(shown, (0, SMOOTHED, SMOOTHED))
    channel = tiled(shifted_cfa(table.cfa, levelled.phase), scene.shape[1:])
    span = table.white_level - table.black_level
    signal = sum(part[channel] * plane for part, plane in zip(matrix.T, scene, strict=True)).clip(0, span)
    constant, linear, quadratic = terms = _noise_terms(table, frame)
    lines, gain = _line_variances(table, frame), table.camera.channel_gains[channel] if table.camera else 1.0
    variance = constant[channel] + (linear[channel] + quadratic * signal) * signal - QUANTISATION - sum(lines) * gain**2
    sigma = np.sqrt(np.maximum(variance, 0))
    draws = int(np.clip(BUDGET // signal.size, *DRAWS))
    own = len(outputs)
    made = np.empty((len(_with_sums(table, scene)), draws, *signal.shape), np.float32)
    first, last = np.empty((2, draws, *signal.shape), np.intp)
    rng = np.random.default_rng(SEED)
    for draw in range(draws):
        noisy = table.black_level + signal + sigma * rng.standard_normal(signal.shape, np.float32)
        for of_lines, axis in zip(lines, (1, 0), strict=True):
            if of_lines:
                offsets = rng.standard_normal(signal.shape[1 - axis]) * np.sqrt(of_lines)
                noisy += gain * np.expand_dims(offsets, axis)
        values = np.clip(np.rint(noisy), 0, 2**table.bits - 1).astype(np.uint16)
        again = RawFrame("again", values, table.black_level, table.white_level, levelled.phase)
        rendered, labels = renderer.classified(again)
        made[:, draw] = _with_sums(table, rendered)
        first[draw], last[draw] = labels[0], labels[-1]
    spread = _raw_sigma(table, terms, unit, made[:own], np.ones((), np.float32))
    deviations = made - made.mean(axis=1, keepdims=True)
    # The standard deviation of a few draws is too small on average, by this factor.
    chi = math.exp(math.lgamma(draws / 2) - math.lgamma((draws - 1) / 2)) * math.sqrt(2 / draws)
    measured = np.sqrt(np.square(deviations).mean(axis=1)) / chi
    inner = np.flatnonzero(_counts(rows)), np.flatnonzero(_counts(cols))
    inside = [_cut(each, *inner).reshape(draws, -1) for each in (first, last)]
    within = _cut(spread, *inner).reshape(draws, -1)
    by_class, by_kind = _raked(table, inside[0], inside[1], within, _cut(measured, *inner))
    expected = by_class[last] * spread[..., None]
    if table.later:
        expected *= by_kind[first]
    by_edge = _edge_factors(measured, np.moveaxis(expected.mean(axis=0), -1, 0), inner)
    gains, factors, edges = (each.astype(np.float32) for each in (by_class, by_kind, by_edge))
    return NoiseGains(gains, factors, edges, _areas(_cut(deviations[:own], *inner)), unit)


def _edge_factors(measured: Array, expected: Array, inner: tuple[Labels, Labels]) -> Array:
    """Return the factors E (side, distance, output), the ratios of measured to expected standard deviations near each
    border.

    Corners and the seams between simulated pieces are ignored.
    """
    rows, cols = inner
    pairs = zip((cols, cols, rows, rows), _sides(measured), _sides(expected), strict=True)
    ratios = [_along(seen, along) / np.maximum(_along(wanted, along), MIN_VARIANCE) for along, seen, wanted in pairs]
    return np.moveaxis(np.array(ratios), 1, 2)


def _along(planes: Array, along: Labels) -> Array:
    return planes[..., along].mean(axis=-1)


def _cut(planes: NDArray[Any], rows: Labels, cols: Labels) -> NDArray[Any]:
    return planes.take(rows, -2).take(cols, -1)


def _back(table: TransformTable, levelled: RawFrame, sampled: tuple[Labels, Labels], outputs: Array) -> tuple[Array, float]:
    """Fit a matrix that converts outputs to raw signals in DN, the inverse of rendering.

    The matrix is fitted to block means, because outputs and raw values disagree in fine patterns. The robust fit minimises
    errors relative to the brightness of each block.

    Parameters
    ----------
    table : TransformTable
        Table with which the outputs were rendered.
    levelled : RawFrame
        The frame, from `at_table_levels`.
    sampled : (ndarray, ndarray)
        Row and column indices of `outputs` in the frame.
    outputs : ndarray, (output, row, col)
        Outputs of the sampled rows and columns.

    Returns
    -------
    matrix : ndarray, (channel, output)
    unit : float
        Mean raw signal, in DN above black, at which the brightness of the outputs is 1.
    """
    sides = block_sides(table.cfa)
    rows, cols = (length // side for length, side in zip(outputs.shape[1:], sides, strict=True))

    def means(planes: Array) -> Array:
        whole = planes[:, : rows * sides[0], : cols * sides[1]]
        parts = whole.reshape(len(planes), rows, sides[0], cols, sides[1])
        return parts.mean(axis=(2, 4)).reshape(len(planes), -1)

    sites = [(at + offset) % period for at, offset, period in zip(sampled, levelled.phase, table.cfa.shape, strict=True)]
    there = _cut(table.cfa, *sites) == np.arange(len(table.channels))[:, None, None]
    signal = means(there * (_cut(levelled.values, *sampled) - levelled.black_level)) / np.maximum(means(there), 1e-9)
    wanted = means(outputs.astype(np.float64))
    weight = relative = 1 / np.square(np.maximum(signal.mean(axis=0), 1.0))
    for _ in range(FITS):
        weighted = wanted * weight
        matrix = signal @ weighted.T @ np.linalg.pinv(wanted @ weighted.T, 1e-6, hermitian=True)
        error = np.square(matrix @ wanted - signal).sum(axis=0) * relative
        weight = relative / np.maximum(error, max(float(np.median(error)), 1e-18))
    unit = signal.mean() / max(float(_brightness(table, wanted).mean()), 1e-9)
    return matrix, float(max(unit, 0.0))


def _sampled(length: int, unit: int) -> NDArray[np.int64]:
    """Choose the rows or columns to simulate: all of them or, in a large frame, evenly spaced pieces.

    Pieces begin at multiples of `unit`. The first and last pieces include the borders of the frame.
    """
    piece = max(PIECE_PIXELS // unit, 1) * unit
    if length <= piece * PIECES_PER_SIDE:
        return np.arange(length)
    starts = np.linspace(0, length - piece, PIECES_PER_SIDE).astype(np.int64) // unit * unit
    lengths = [*[piece] * (PIECES_PER_SIDE - 1), length - starts[-1]]
    return np.concatenate([start + np.arange(size) for start, size in zip(starts, lengths, strict=True)])


def _counts(indices: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return a mask of the indices from `_sampled` that are far from seams between pieces and from the frame's borders."""
    seams = np.concatenate([[-0.5], np.flatnonzero(np.diff(indices) != 1) + 0.5, [indices.size - 0.5]])
    return np.asarray(np.abs(np.arange(indices.size)[:, None] - seams).min(axis=1) > SEAM_PIXELS)


def _raked(table: TransformTable, first: Labels, last: Labels, spread: Array, measured: Array) -> tuple[Array, Array]:
    """Fit the gains G and the factors K by iterative proportional fitting.

    Pixels are grouped in four ways: (1) by level, (2) by the class in the last layer, pooled over all CFA sites, (3) by the
    class in the last layer at each site, and (4) by the kind in the first layer. In each group, the fit makes the
    mean of the predicted standard deviations equal to the mean of the measured standard deviations.

    Parameters
    ----------
    table : TransformTable
        Table with one set of transforms.
    first, last : ndarray, (draw, pixel)
        Classes in the first and last layers.
    spread : ndarray, (draw, pixel)
        Standard deviation s of raw values.
    measured : ndarray, (output, row, col)
        Standard deviation over the renderings.

    Returns
    -------
    by_class : ndarray, (class of the last layer, output)
        Gains G.
    by_kind : ndarray, (class of the first layer, output)
        Factors K.
    """
    from scipy.sparse import coo_array

    layer, rule, every = table.layers[-1], table.first.rule, np.arange(len(table.layers[-1].weights))
    within, kind = layer.rule.within_site(every), rule.split(np.arange(len(table.first.weights))).kind
    axes = [layer.rule.split(every).level, within if isinstance(layer, MosaicLayer) else within[1], every]
    size, cell = int(kind.max()) + 1 if table.later else 1, last.astype(np.intp)
    if table.later:
        cell = cell * size + kind[first]
    used = np.flatnonzero(np.bincount(cell.ravel()))  # combinations of class and kind that occur
    number = np.zeros(used[-1] + 1, np.intp)
    number[used] = np.arange(used.size)
    cell = number[cell]
    parts = [axis[used // size] for axis in axes]
    if table.later:
        axes, parts = [*axes, kind], [*parts, used % size]
    factors = [np.ones((int(axis.max()) + 1, len(measured))) for axis in axes]
    factors[0] *= measured.mean(axis=(1, 2)) / spread.mean()
    prior = PRIOR * len(last) * measured.mean(axis=(1, 2))
    wanted = _summed(cell.ravel(), np.tile(measured.reshape(len(measured), -1), len(cell)).T, used.size)
    seen = [_summed(part, wanted, len(factor)) for part, factor in zip(parts, factors, strict=True)]
    # To save time, each pixel's mean over all draws is approximated from two draws: the draw itself, and the one before it,
    # which represents all others.
    alone, others = _summed(cell.ravel(), spread.reshape(-1, 1) / len(cell), used.size), 1 - 1 / len(cell)
    by_others = coo_array((np.roll(spread * others, 1, 0).ravel(), (cell.ravel(), np.roll(cell, 1, 0).ravel()))).tocsr()
    for _ in range(ROUNDS):
        for factor, part, of in zip(factors, parts, seen, strict=True):
            by_cell = math.prod(each[at] for each, at in zip(factors, parts, strict=True))
            predicted = _summed(part, alone * by_cell + by_others @ by_cell, len(factor))
            factor *= (of + prior) / np.maximum(predicted + prior, MIN_VARIANCE)
    gains = math.prod(factor[axis] for factor, axis in zip(factors[:3], axes, strict=False))
    return np.asarray(gains), factors[3][kind] if table.later else np.ones((1, len(measured)))


def _summed(part: Labels, values: NDArray[Any], size: int) -> Array:
    """Sum values (cell, output) over all cells with the same number in `part`: (part, output)."""
    return np.stack([np.bincount(part, of, size) for of in values.T], axis=-1)


def _areas(deviations: Array) -> Array:
    """Compute `NoiseGains.area` from the renderings' deviations from their mean: (output, draw, row, col)."""
    areas, means = [], deviations
    for side in TILES:
        if side > 1:
            rows, cols = (length // 2 * 2 for length in means.shape[2:])
            means = (means[..., :rows:2, :cols] + means[..., 1:rows:2, :cols]) / 2
            means = (means[..., ::2] + means[..., 1::2]) / 2
        if means[0, 0].size < MIN_TILES:
            break
        areas.append(side**2 * np.square(means).mean(axis=(1, 2, 3)))
    return np.array(areas) / np.maximum(areas[0], MIN_VARIANCE)
