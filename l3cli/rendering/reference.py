"""Reference renderer in float64 (docs/method.md#rendering). Tests compare all other backends with it."""

import functools
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.layers import PLANE_STEP, MosaicLayer, PlaneLayer
from l3cli.artifacts.table import ChromaSmoothing, SpectralSmoothing, TransformTable
from l3cli.classes.clipping import Mosaic, limited_to_white, replaced
from l3cli.classes.coarse_chroma import coarse_change, scales_of
from l3cli.classes.decide import label_mosaic
from l3cli.classes.planes import CHROMA, FixedPoint, coarse, planes_basis, refined_fixed_point
from l3cli.classes.refinement import label_planes, mirrored, taps_behind
from l3cli.classes.windows import Integers
from l3cli.frames.frame import RawFrame, pad_mosaic
from l3cli.physics.mosaic import channel_reach, shifted_cfa
from l3cli.rendering.conditions import NoiseSets
from l3cli.rendering.display import Display, encode, require_known_layers, require_xyz

# Neighbours for chroma smoothing, as (row, column) offsets in pixels. With more neighbours, smoothing would be slower. Near
# and far neighbours together average out both fine and coarse patterns of residual noise and aliasing.
CHROMA_NEIGHBOURS = ((-1, -1), (-1, 1), (1, -1), (1, 1), (-4, 0), (4, 0), (0, -4), (0, 4))
FAR_CHROMA_NEIGHBOURS = ((-5, -5), (-5, 5), (5, -5), (5, 5), (-8, 0), (8, 0), (0, -8), (0, 8))
FAR_LIKENESS = 0.5  # far neighbours show other surfaces more often, so their chroma must be closer by this factor
CHROMA_REACH = 8  # largest offset in pixels
# The contrast around a pixel is limited to this multiple of the pixel's luminance. Without the limit, chroma smoothing would
# blur dark pixels next to bright lights.
MAX_CONTRAST = 4.0

# A pixel's luminance must not fall below the smallest nearby raw value (relative to white), multiplied by one of these
# factors. The first factor applies to values above the black level, the second factor to values below it. The second factor
# is large, because clipping the noise of dark areas would raise their mean.
LEAST_OF_POSITIVE, LEAST_OF_NEGATIVE = 0.5, 2.0
# The raw values are first increased by this multiple of the standard deviation of the noise without light. Otherwise, a
# single raw value with a large negative noise would make its neighbours black. A larger multiple would brighten frames
# without light.
LEAST_NOISE = 0.75
RAISED_CHROMA = 2.0  # if Y is raised, X and Z change by at most this multiple of the change in Y

SMOOTHING_DARKEST = 2.0**-20  # darker pixels are not smoothed; in output units, far below the noise of any sensor


class ReferenceRenderer:
    """Slow, exact renderer in numpy. `make_renderer` describes the parameter `by_noise`."""

    def __init__(self, table: TransformTable, by_noise: bool = False) -> None:
        require_known_layers(table)
        self.table, self._sets = table, NoiseSets(table, by_noise)

    def labels(self, frame: RawFrame, layer: int = 0) -> Integers:
        """Return the class map (row, col) of a layer. Layer 0 reads the raw frame."""
        levelled = at_table_levels(frame, self.table)
        labels = self._labels(levelled)
        return self._refine(levelled, labels, layer)[1][layer] if layer else labels

    def outputs(self, frame: RawFrame) -> NDArray[np.float32]:
        """Render a frame to the outputs of the table, (output, row, col)."""
        return self.exact_outputs(frame).astype(np.float32)

    def classified(self, frame: RawFrame) -> tuple[NDArray[np.float32], list[Integers]]:
        """Return the outputs and the class maps (row, col) of the first and last layers.

        A table with a single layer has a single class map.
        """
        exact, labels = self.exact_classified(frame)
        return exact.astype(np.float32), [labels[0], *labels[1:][-1:]]

    def picture(self, frame: RawFrame, display: Display) -> NDArray:
        """Render a frame to a picture (row, col, 3).

        Raises RecipeError if the table's outputs cannot be shown as a picture.
        """
        require_xyz(self.table.outputs)
        return encode(self.exact_outputs(frame), display)

    def encoded(self, outputs: NDArray[np.float32], display: Display) -> NDArray:
        """Encode the outputs (output, row, col) of a frame as a picture (row, col, 3)."""
        return encode(outputs, display)

    def pictures(self, frames: Iterable[tuple[RawFrame, Display]]) -> Iterator[NDArray]:
        """Yield the picture of each frame, in order."""
        return (self.picture(frame, display) for frame, display in frames)

    def exact_outputs(self, frame: RawFrame) -> NDArray[np.float64]:
        """Render a frame to the outputs of the table (output, row, col) in float64, without the rounding of `outputs`.

        All steps after the layers are included: correction of clipped areas, shading gain, smoothing of spectra or chroma,
        and compensation for the range lost to dark current.
        """
        return self.exact_classified(frame)[0]

    def exact_classified(self, frame: RawFrame) -> tuple[NDArray[np.float64], list[Integers]]:
        """Return the result of `exact_outputs` and the class maps (row, col) of all layers."""
        levelled = at_table_levels(frame, self.table)
        labels = [self._labels(levelled)]
        gain = 1.0 if frame.shading is None else frame.shading.gain_map(frame.values.shape[1])
        made = np.zeros(())
        if self.table.later:
            planes, labels = self._refine(levelled, labels[0], len(self.table.later))
            last, share = self._sets.later[-1], self._sets.share(frame)
            made = refinement_outputs(planes, labels[-1], last, share, self.table.chroma_outputs)
            made = self._with_plain_clipped_areas(made, levelled)
        if not self.table.later or self.table.components:
            made = made + output_planes(levelled, labels[0], self.table, self._sets.first)
        if (clipped_white := self.table.clipped_white) is not None:
            made = limited_to_white(made, clipped_white)
        made = gain * made
        if self.table.spectra:
            made = smoothed_spectra(made, self.table.spectra)
        if self.table.chroma_smoothing:
            least = least_luminance(levelled, self.table)
            made = smoothed_chroma(made, self.table.chroma_smoothing, self.table.white_point, gain * least)
        return frame.light_share * made, labels

    def last_layer(self, frame: RawFrame) -> tuple[NDArray[np.int32], Integers]:
        """Return the planes (plane, row, col) that the last refinement layer reads, and its class map (row, col)."""
        levelled = at_table_levels(frame, self.table)
        planes, labels = self._refine(levelled, self._labels(levelled), len(self.table.later))
        return planes, labels[-1]

    @functools.cached_property
    def _fixed_points(self) -> list[FixedPoint]:
        """Fixed-point transforms of every layer except the last."""
        basis = planes_basis(self.table)
        return [self._sets.first_fixed_point, *(refined_fixed_point(layer, basis) for layer in self._sets.later[:-1])]

    def _labels(self, levelled: RawFrame) -> Integers:
        """Return the first-layer class of every pixel. The frame must be the result of `at_table_levels`.

        Classes are numbered consecutively over all sets of transforms.
        """
        usual, *others = (
            label_mosaic(levelled.values, table.first.rule, table.cfa, len(table.channels), levelled.phase)
            for table in self._sets.tables
        )
        chosen, labels = self._sets.chosen(levelled) if others else None, usual
        for number, of_set in enumerate(others, 1):
            labels = np.where(chosen == number, number * len(self.table.first.weights) + of_set, labels)
        return labels

    def _refine(self, levelled: RawFrame, first_labels: Integers, number: int) -> tuple[NDArray[np.int32], list[Integers]]:
        """Return the planes that refinement layer `number` (counted from 1) reads, and class maps up to its own."""
        later = self._sets.later
        planes = first_planes(levelled, first_labels, self.table, self._fixed_points[0])
        labels = [first_labels, self._refined_labels(planes, first_labels, 0)]
        for place, fixed in enumerate(self._fixed_points[1:number], 1):
            planes = refinement_planes(planes, labels[-1], later[place - 1], fixed)
            labels.append(self._refined_labels(planes, first_labels, place))
        return planes, labels

    def _with_plain_clipped_areas(self, made: NDArray[np.float64], levelled: RawFrame) -> NDArray[np.float64]:
        """Correct the outputs in clipped areas, if the table contains the coefficients for it."""
        clipping = self.table.later[-1].clipping
        if clipping is None:
            return made
        return replaced(made, mosaic_of(levelled, self.table), clipping.response, clipping.white)

    def _refined_labels(self, planes: NDArray[np.int32], first_labels: Integers, place: int) -> Integers:
        """Classify every pixel for refinement layer `place` (counted from 0)."""
        rule, *others = self._sets.refinement_rules(place)
        return label_planes(planes, first_labels, rule, self.table.first.rule, *others)


def at_table_levels(frame: RawFrame, table: TransformTable) -> RawFrame:
    """Scale a frame to the table's black level, white level and bit depth, and correct its colour shading."""
    return frame.at_levels(table.black_level, table.white_level, table.bits).shading_corrected()


def mosaic_of(levelled: RawFrame, table: TransformTable) -> Mosaic:
    """Combine a frame's raw values and CFA in the form that `classes.clipping` requires.

    `levelled` is a frame from `at_table_levels`.
    """
    cfa = shifted_cfa(table.cfa, levelled.phase)
    return Mosaic(levelled.values, cfa, levelled.black_level, table.white_level)


def output_planes(frame: RawFrame, labels: Integers, table: TransformTable, first: MosaicLayer) -> NDArray[np.float64]:
    """Apply the transforms of the first layer in floating point.

    Parameters
    ----------
    frame : RawFrame
        Frame from `at_table_levels`.
    labels : ndarray, (row, col)
        Class of each pixel.
    table : TransformTable
        Table that contains the layer.
    first : MosaicLayer
        First layer, with the classes of all sets of transforms.

    Returns
    -------
    ndarray, (output, row, col)
    """
    signal = (frame.values - frame.black_level) / (table.white_level - table.black_level)
    return _transformed(_mosaic_windows(signal, table), labels, first)


def first_planes(frame: RawFrame, labels: Integers, table: TransformTable, fixed: FixedPoint) -> NDArray[np.int32]:
    """Apply the first layer in fixed point, and return the planes for the first refinement layer.

    Parameters
    ----------
    frame : RawFrame
        Frame from `at_table_levels`.
    labels : ndarray, (row, col)
        Class of each pixel.
    table : TransformTable
        Table that contains the layer.
    fixed : FixedPoint
        Fixed-point transforms of the first layer.

    Returns
    -------
    ndarray, (plane, row, col)
    """
    return _fixed_point_planes(_mosaic_windows(frame.values.astype(np.int64), table), labels, fixed)


def refinement_planes(
    planes: NDArray[np.int32], labels: Integers, layer: PlaneLayer, fixed: FixedPoint
) -> NDArray[np.int32]:
    """Apply a refinement layer in fixed point, and return the planes for the next refinement layer.

    Parameters
    ----------
    planes : ndarray, (plane, row, col)
        Planes of the previous layer.
    labels : ndarray, (row, col)
        Class of each pixel.
    layer : PlaneLayer
        Refinement layer.
    fixed : FixedPoint
        Fixed-point transforms of the layer.

    Returns
    -------
    ndarray, (plane, row, col)
    """
    return _fixed_point_planes(_windows(coarse(planes).astype(np.int64), layer), labels, fixed)


def refinement_outputs(
    planes: NDArray[np.int32], labels: Integers, layer: PlaneLayer, share: float = 1.0, chroma: Sequence[int] = CHROMA
) -> NDArray[np.float64]:
    """Apply the transforms of the last refinement layer in floating point.

    Parameters
    ----------
    planes : ndarray, (plane, row, col)
        Planes of the previous layer.
    labels : ndarray, (row, col)
        Class of each pixel.
    layer : PlaneLayer
        Last refinement layer.
    share : float
        Noise variance of the frame, as a fraction of the camera's noise variance.
    chroma : sequence of int
        Indices of the outputs that receive the coarse chroma.

    Returns
    -------
    ndarray, (output, row, col)
    """
    ratios = np.moveaxis(taps_behind(planes, layer.side, layer.ratio_taps), 0, -1) * PLANE_STEP
    made = _transformed(_windows(planes.astype(np.float64) * PLANE_STEP, layer), labels, layer, ratios)
    if layer.coarse_chroma:
        made[list(chroma)] += coarse_change(planes, scales_of(layer.coarse_chroma, share)) * PLANE_STEP
    return made


def _mosaic_windows(values: NDArray, table: TransformTable) -> NDArray:
    """Return a view of the window around each mosaic pixel, (1, row, col, window row, window col)."""
    patch = table.first.rule.patch
    padded = pad_mosaic(values, table.first.rule.radius, table.cfa.shape)
    return np.lib.stride_tricks.sliding_window_view(padded[None], (patch, patch), (1, 2))


def _windows(planes: NDArray, layer: PlaneLayer) -> NDArray:
    """Return a view of the window around each pixel in every plane, (plane, row, col, window row, window col)."""
    return np.lib.stride_tricks.sliding_window_view(mirrored(planes, layer.radius), (layer.side, layer.side), (1, 2))


def _patches(windows: NDArray, row: int) -> NDArray:
    """Return the taps (col, tap) of all windows in one picture row, plane after plane."""
    return np.moveaxis(windows[:, row], 0, 1).reshape(windows.shape[2], -1)


def _fixed_point_planes(windows: NDArray, labels: Integers, fixed: FixedPoint) -> NDArray[np.int32]:
    """Apply fixed-point transforms to windows (plane, row, col, …), and return planes (plane, row, col)."""
    made = np.empty((fixed.weights.shape[1], *labels.shape), np.int32)
    for row, label in enumerate(labels):
        sums = (fixed.weights[label] * _patches(windows, row)[:, None]).sum(axis=-1) + fixed.intercept[label]
        made[:, row] = fixed.planes(sums.T, label)
    return made


def _transformed(
    windows: NDArray, labels: Integers, layer: MosaicLayer | PlaneLayer, ratios: NDArray | None = None
) -> NDArray[np.float64]:
    """Apply floating-point transforms to windows (plane, row, col, …), and return outputs (output, row, col).

    The colour ratios (row, col, tap), if any, are additional taps after those from the window.
    """
    outputs = np.empty((layer.weights.shape[1], *labels.shape))
    for row, label in enumerate(labels):  # row by row: gathering the transforms of all pixels at once would need gigabytes
        patches = _patches(windows, row)
        if ratios is not None:
            patches = np.concatenate([patches, ratios[row]], axis=1)
        weighted = layer.weights[label].astype(np.float64) @ patches[..., None]
        outputs[:, row] = (weighted[..., 0] + layer.intercept[label]).T
    return outputs


def white_scale(table: TransformTable) -> NDArray[np.float64]:
    """Return the factor (channel,) that converts raw values of a white object to its luminance.

    Raw values are in DN above black, and the luminance is in output units.
    """
    assert table.white_signals is not None
    return np.asarray(1 / (table.white_signals * (table.white_level - table.black_level)))


def raising_constants(table: TransformTable) -> dict[str, float | int]:
    """Return the constants, by name, for raising the luminance of pixels that are too dark.

    The result is empty if the table does not contain the channel signals of white.
    """
    if table.white_signals is None:
        return {}
    factors = {
        "least_of_positive": LEAST_OF_POSITIVE,
        "least_of_negative": LEAST_OF_NEGATIVE,
        "raised_chroma": RAISED_CHROMA,
    }
    return {"least_reach": channel_reach(table.cfa), **factors}


def least_black_level(table: TransformTable) -> float:
    """Return the black level in DN for `least_luminance`. Because of noise, it is lower than the level of the table."""
    noise = float(np.sqrt(table.camera.noise_variance(np.zeros(1))[0])) if table.camera else 0.0
    return table.black_level - LEAST_NOISE * noise


def least_luminance(frame: RawFrame, table: TransformTable) -> NDArray[np.float64]:
    """Return a lower limit for the luminance of each pixel, computed from the raw values around it.

    Each raw value in a window around the pixel, minus `least_black_level`, is divided by the signal of white in the same
    channel. The limit is the smallest of these ratios, times a constant factor. The window is just large enough to contain
    all channels. Values outside the frame are ignored. If the table does not contain the channel signals of white, the limit
    is −∞.

    Parameters
    ----------
    frame : RawFrame
        Frame from `at_table_levels`.
    table : TransformTable
        Table that renders the frame.

    Returns
    -------
    ndarray, (row, col)
    """
    if table.white_signals is None:
        return np.full(frame.values.shape, -np.inf)
    cfa, shape = shifted_cfa(table.cfa, frame.phase), frame.values.shape
    channel = np.tile(cfa, [-(-length // period) for length, period in zip(shape, cfa.shape, strict=True)])
    scale = white_scale(table)[channel[: shape[0], : shape[1]]]
    reach = channel_reach(table.cfa)
    padded = np.pad((frame.values - least_black_level(table)) * scale, reach, constant_values=np.inf)
    smallest = np.lib.stride_tricks.sliding_window_view(padded, (2 * reach + 1,) * 2).min(axis=(2, 3))
    return np.asarray(smallest * np.where(smallest > 0, LEAST_OF_POSITIVE, LEAST_OF_NEGATIVE))


def smoothed_spectra(planes: NDArray[np.float64], smoothing: SpectralSmoothing) -> NDArray[np.float64]:
    """Average the spectrum of each pixel with similar neighbours, without changing the pixel's brightness.

    For the central pixel p of a window and any pixel q in it, let o be the spectrum and Y its mean:

        w_q = max(0, 1 − ((Y_q − Y_p) / (reach · Y_p))²)²
        o_p ← ō_p · Y_p / Ȳ_p

    ō and Ȳ are means over the window, weighted by w. They are computed from differences to the central pixel, so that
    uniform areas do not change in any bit. At the borders, planes are mirrored about the outermost pixels.

    Parameters
    ----------
    planes : ndarray, (output, row, col)
        Spectra.
    smoothing : SpectralSmoothing
        Window size in pixels, and `reach` as in the equation.

    Returns
    -------
    ndarray, (output, row, col)
    """
    _, rows, cols = planes.shape
    brightness = planes.mean(axis=0)
    padded, around = mirrored(planes, smoothing.radius), mirrored(brightness, smoothing.radius)
    scale = smoothing.reach * np.maximum(brightness, SMOOTHING_DARKEST)
    total, brighter, change = np.ones_like(brightness), np.zeros_like(brightness), np.zeros_like(planes)
    for down, right in np.ndindex(smoothing.window, smoothing.window):
        if down == right == smoothing.radius:
            continue  # `total` starts at 1, the weight of the central pixel
        there = slice(down, down + rows), slice(right, right + cols)
        difference = around[there] - brightness
        weight = np.maximum(1 - np.square(difference / scale), 0) ** 2
        total += weight
        brighter += weight * difference
        change += weight * (padded[:, *there] - planes)
    safe = np.where(brightness > SMOOTHING_DARKEST, brightness, 1.0)
    share = safe / np.where(brightness > SMOOTHING_DARKEST, brightness + brighter / total, 1.0)
    return np.where(brightness > SMOOTHING_DARKEST, (planes + change / total) * share, planes)


def smoothed_chroma(
    planes: NDArray[np.float64],
    smoothing: ChromaSmoothing,
    white: NDArray[np.float64],
    least: NDArray[np.float64] | float = -np.inf,
) -> NDArray[np.float64]:
    """Average the chroma of each pixel with similar neighbours, then raise the luminance of pixels that are too dark.

    The averaging does not change the luminance. For a pixel p, its neighbours q (CHROMA_NEIGHBOURS and
    FAR_CHROMA_NEIGHBOURS), and X_w and Z_w of `white`:

        e_q = X_q Y_p − X_p Y_q
        f_q = Z_q Y_p − Z_p Y_q
        t_p = Y_p + min(mean of |Y_q − Y_p| over CHROMA_NEIGHBOURS, MAX_CONTRAST · Y_p)
        r_q = reach · t_p if Y_q > Y_p, otherwise min(reach · t_p, Y_p)
        w_q = max(0, 1 − ((Y_q − Y_p) / r_q)² − ((e_q / X_w)² + (f_q / Z_w)²) / (l_q · Y_p · t_p)²)²
        X_p ← X_p + Σ w_q e_q / (Y_p + Σ w_q Y_q)

    l_q is `likeness` for CHROMA_NEIGHBOURS, and FAR_LIKENESS · `likeness` for FAR_CHROMA_NEIGHBOURS. Z changes in the same
    way. The new X_p / Y_p is the weighted mean of X over p and its neighbours, divided by the weighted mean of Y. In t_p,
    the contrast around the pixel is added to its luminance, because the false colours of aliasing are proportional to the
    contrast. Neighbours without luminance have no weight. Areas of constant chromaticity do not change in any bit. At the
    borders, planes are mirrored about the outermost pixels.

    If Y_p is below `least`, it is raised to `least`. X_p and Z_p then move towards the chroma of the diagonal neighbours, by
    at most RAISED_CHROMA times the change in Y_p.

    Parameters
    ----------
    planes : ndarray, (3, row, col)
        X, Y and Z.
    smoothing : ChromaSmoothing
        Differences in luminance (`reach`) and chroma (`likeness`) at which a neighbour's weight reaches zero.
    white : ndarray, (3,)
        XYZ of white, with Y = 1.
    least : ndarray, (row, col), or float
        Lower limit for the luminance of each pixel (`least_luminance`).

    Returns
    -------
    ndarray, (3, row, col)
    """
    luminance, chroma = planes[1], planes[::2]
    bright = luminance > SMOOTHING_DARKEST
    safe = np.where(bright, luminance, 1.0)
    padded, (rows, cols) = mirrored(planes, CHROMA_REACH), luminance.shape
    offsets = CHROMA_NEIGHBOURS + FAR_CHROMA_NEIGHBOURS
    places = ((CHROMA_REACH + down, CHROMA_REACH + right) for down, right in offsets)
    neighbours = [padded[:, first : first + rows, left : left + cols] for first, left in places]
    contrast = np.mean([np.abs(there[1] - safe) for there in neighbours[: len(CHROMA_NEIGHBOURS)]], axis=0)
    tolerance = safe + np.minimum(contrast, MAX_CONTRAST * safe)
    brighter = smoothing.reach * tolerance
    darker = np.minimum(brighter, safe)
    scale = (white[::2] / white[1])[:, None, None] * smoothing.likeness * safe * tolerance
    total, change, diagonal = safe.copy(), np.zeros_like(chroma), np.zeros_like(planes)
    for (down, right), there in zip(offsets, neighbours, strict=True):
        unlike = there[::2] * safe - chroma * there[1]
        limit = scale if (down, right) in CHROMA_NEIGHBOURS else FAR_LIKENESS * scale
        difference = (there[1] - safe) / np.where(there[1] > safe, brighter, darker)
        square = np.square(difference) + np.square(unlike / limit).sum(axis=0)
        weight = np.maximum(1 - square, 0) ** 2
        total += weight * there[1]
        change += weight * unlike
        if abs(down) == abs(right) == 1:
            diagonal += there
    smoothed = planes.copy()
    smoothed[::2] += np.where(bright, change / total, 0.0)
    raised = np.maximum(luminance, least)
    most = RAISED_CHROMA * (raised - luminance)
    share = raised / np.maximum(np.maximum(diagonal[1], raised), SMOOTHING_DARKEST)
    smoothed[::2] += np.clip(share * diagonal[::2] - smoothed[::2], -most, most)
    smoothed[1] = raised
    return smoothed
