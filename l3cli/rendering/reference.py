"""The reference renderer in float64 (docs/method.md#rendering). Tests compare every other backend with this renderer."""

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

# Neighbours used for chroma smoothing, as (row, column) offsets in pixels. Only eight neighbours are used, for speed. The
# mixture of near and far neighbours averages out the residual patterns of noise and aliasing.
CHROMA_NEIGHBOURS = ((-1, -1), (-1, 1), (1, -1), (1, 1), (-4, 0), (4, 0), (0, -4), (0, 4))
CHROMA_REACH = 4  # largest offset in pixels

# Lower limit of a pixel's luminance, as a multiple of the smallest nearby raw value relative to white. The first factor is
# for values above the black level, and the second factor is for values below. The second factor is large, because cutting
# off noise in the dark would change the mean.
LEAST_OF_POSITIVE, LEAST_OF_NEGATIVE = 0.5, 2.0
RAISED_CHROMA = 2.0  # largest change of X and Z when the luminance is raised, as a multiple of the change of Y

# Darker pixels are not smoothed. The value is in output units, and far below the noise of any sensor.
SMOOTHING_DARKEST = 2.0**-20


class ReferenceRenderer:
    """A slow and exact renderer in numpy. See `make_renderer` for the parameter `by_noise`."""

    def __init__(self, table: TransformTable, by_noise: bool = False) -> None:
        require_known_layers(table)
        self.table, self._sets = table, NoiseSets(table, by_noise)

    def labels(self, frame: RawFrame, layer: int = 0) -> Integers:
        """Return the class of every pixel as an array (row, col). Layers are counted from 0."""
        levelled = at_table_levels(frame, self.table)
        labels = self._labels(levelled)
        return self._refine(levelled, labels, layer)[1] if layer else labels

    def outputs(self, frame: RawFrame) -> NDArray[np.float32]:
        """Render a frame, and return the outputs of the table as an array (output, row, col)."""
        return self.exact_outputs(frame).astype(np.float32)

    def classified(self, frame: RawFrame) -> tuple[NDArray[np.float32], list[Integers]]:
        """Return the outputs, and a list with the class maps (row, col) of the first and the last layer.

        For a table with a single layer, the list contains one class map.
        """
        return self.outputs(frame), [self.labels(frame, number) for number in sorted({0, len(self.table.later)})]

    def picture(self, frame: RawFrame, display: Display) -> NDArray:
        """Render a frame as a picture (row, col, 3).

        Raises RecipeError if pictures cannot be made from the outputs of the table.
        """
        require_xyz(self.table.outputs)
        return encode(self.exact_outputs(frame), display)

    def encoded(self, outputs: NDArray[np.float32], display: Display) -> NDArray:
        """Encode the outputs (output, row, col) of a frame as a picture (row, col, 3)."""
        return encode(outputs, display)

    def pictures(self, frames: Iterable[tuple[RawFrame, Display]]) -> Iterator[NDArray]:
        """Yield the picture of each frame, in the order of the frames."""
        return (self.picture(frame, display) for frame, display in frames)

    def exact_outputs(self, frame: RawFrame) -> NDArray[np.float64]:
        """Return the outputs (output, row, col) in float64. The method `outputs` rounds the same values to float32.

        The outputs include all steps after the layers: the replacement of clipped areas, the gain of the shading, the
        smoothing of spectra or chroma, and the correction for dark current.
        """
        levelled = at_table_levels(frame, self.table)
        labels = self._labels(levelled)
        gain = 1.0 if frame.shading is None else frame.shading.gain_map(frame.values.shape[1])
        made = np.zeros(())
        if self.table.later:
            planes, refined_labels = self._refine(levelled, labels, len(self.table.later))
            last, share = self._sets.later[-1], self._sets.share(frame)
            made = refinement_outputs(planes, refined_labels, last, share, self.table.chroma_outputs)
            made = self._with_plain_clipped_areas(made, levelled)
        if not self.table.later or self.table.components:
            made = made + output_planes(levelled, labels, self.table, self._sets.first)
        if (clipped_white := self.table.clipped_white) is not None:
            made = limited_to_white(made, clipped_white)
        made = gain * made
        if self.table.spectra:
            made = smoothed_spectra(made, self.table.spectra)
        if self.table.chroma_smoothing:
            least = least_luminance(levelled, self.table)
            made = smoothed_chroma(made, self.table.chroma_smoothing, self.table.white_point, gain * least)
        return frame.light_share * made

    def planes(self, frame: RawFrame) -> NDArray[np.int32]:
        """Return the planes that the last layer reads. The table must have a refinement layer."""
        levelled = at_table_levels(frame, self.table)
        return self._refine(levelled, self._labels(levelled), len(self.table.later))[0]

    @functools.cached_property
    def _fixed_points(self) -> list[FixedPoint]:
        """Fixed-point transforms of all layers except the last."""
        basis = planes_basis(self.table)
        return [self._sets.first_fixed_point, *(refined_fixed_point(layer, basis) for layer in self._sets.later[:-1])]

    def _labels(self, levelled: RawFrame) -> Integers:
        """Return the class of every pixel in the first layer.

        The raw values of `levelled` must be scaled to the table's black and white levels. Classes are numbered consecutively
        over all sets of transforms.
        """
        usual, *others = (
            label_mosaic(levelled.values, table.first.rule, table.cfa, len(table.channels), levelled.phase)
            for table in self._sets.tables
        )
        chosen, labels = self._sets.chosen(levelled) if others else None, usual
        for number, of_set in enumerate(others, 1):
            labels = np.where(chosen == number, number * len(self.table.first.weights) + of_set, labels)
        return labels

    def _refine(self, levelled: RawFrame, first_labels: Integers, number: int) -> tuple[NDArray[np.int32], Integers]:
        """Return the planes that a refinement layer reads, and the class of every pixel in this layer.

        Layers are counted from 1.
        """
        later = self._sets.later
        planes = first_planes(levelled, first_labels, self.table, self._fixed_points[0])
        labels = self._refined_labels(planes, first_labels, 0)
        for place, fixed in enumerate(self._fixed_points[1:number], 1):
            planes = refinement_planes(planes, labels, later[place - 1], fixed)
            labels = self._refined_labels(planes, first_labels, place)
        return planes, labels

    def _with_plain_clipped_areas(self, made: NDArray[np.float64], levelled: RawFrame) -> NDArray[np.float64]:
        """Replace the outputs of uniform clipped areas if the table contains the necessary coefficients."""
        clipping = self.table.later[-1].clipping
        if clipping is None:
            return made
        return replaced(made, mosaic_of(levelled, self.table), clipping.response, clipping.white)

    def _refined_labels(self, planes: NDArray[np.int32], first_labels: Integers, place: int) -> Integers:
        """Return the class of every pixel in a refinement layer. Refinement layers are counted from 0."""
        rule, *others = self._sets.refinement_rules(place)
        return label_planes(planes, first_labels, rule, self.table.first.rule, *others)


def at_table_levels(frame: RawFrame, table: TransformTable) -> RawFrame:
    """Convert a frame to the black level, white level and bit depth of the table, and correct its colour shading."""
    return frame.at_levels(table.black_level, table.white_level, table.bits).shading_corrected()


def mosaic_of(levelled: RawFrame, table: TransformTable) -> Mosaic:
    """Return the raw values and the CFA of a frame, in the form that the replacement of uniform clipped areas needs.

    The raw values of `levelled` must already be scaled to the table's black and white levels.
    """
    cfa = shifted_cfa(table.cfa, levelled.phase)
    return Mosaic(levelled.values, cfa, levelled.black_level, table.white_level)


def output_planes(frame: RawFrame, labels: Integers, table: TransformTable, first: MosaicLayer) -> NDArray[np.float64]:
    """Apply the transforms of a first layer in floating point.

    Parameters
    ----------
    frame : RawFrame
        Frame whose raw values are scaled to the table's black and white levels.
    labels : ndarray, (row, col)
        Class of each pixel.
    table : TransformTable
        Table to which the layer belongs.
    first : MosaicLayer
        The first layer, with the classes of all sets of transforms.

    Returns
    -------
    ndarray, (output, row, col)
    """
    signal = (frame.values - frame.black_level) / (table.white_level - table.black_level)
    return _transformed(_mosaic_windows(signal, table), labels, first)


def first_planes(frame: RawFrame, labels: Integers, table: TransformTable, fixed: FixedPoint) -> NDArray[np.int32]:
    """Apply the transforms of the first layer in fixed point, and return the planes.

    Parameters
    ----------
    frame : RawFrame
        Frame whose raw values are scaled to the table's black and white levels.
    labels : ndarray, (row, col)
        Class of each pixel.
    table : TransformTable
        Table to which the layer belongs.
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
    """Apply the transforms of a refinement layer in fixed point to the planes of the previous layer.

    Parameters
    ----------
    planes : ndarray, (plane, row, col)
        Planes of the previous layer.
    labels : ndarray, (row, col)
        Class of each pixel.
    layer : PlaneLayer
        The layer.
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
        The layer.
    share : float
        Noise variance of the frame, as a fraction of the noise variance of the camera.
    chroma : sequence of int
        Indices of the outputs to which coarse chroma is added.

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
    """Return the window around each pixel of a mosaic, with the axes (1, row, col, window row, window col)."""
    patch = table.first.rule.patch
    padded = pad_mosaic(values, table.first.rule.radius, table.cfa.shape)
    return np.lib.stride_tricks.sliding_window_view(padded[None], (patch, patch), (1, 2))


def _windows(planes: NDArray, layer: PlaneLayer) -> NDArray:
    """Return the window around each pixel in every plane, with the axes (plane, row, col, window row, window col)."""
    return np.lib.stride_tricks.sliding_window_view(mirrored(planes, layer.radius), (layer.side, layer.side), (1, 2))


def _patches(windows: NDArray, row: int) -> NDArray:
    """Return the taps (col, tap) of all windows in one row of the picture. The taps of each plane are consecutive."""
    return np.moveaxis(windows[:, row], 0, 1).reshape(windows.shape[2], -1)


def _fixed_point_planes(windows: NDArray, labels: Integers, fixed: FixedPoint) -> NDArray[np.int32]:
    """Apply fixed-point transforms to the windows around all pixels, and return the planes.

    `windows` has the axes (plane, row, col, …). The result has the axes (plane, row, col).
    """
    made = np.empty((fixed.weights.shape[1], *labels.shape), np.int32)
    for row, label in enumerate(labels):
        sums = (fixed.weights[label] * _patches(windows, row)[:, None]).sum(axis=-1) + fixed.intercept[label]
        made[:, row] = fixed.planes(sums.T, label)
    return made


def _transformed(
    windows: NDArray, labels: Integers, layer: MosaicLayer | PlaneLayer, ratios: NDArray | None = None
) -> NDArray[np.float64]:
    """Apply floating-point transforms to the windows around all pixels, and return the outputs.

    `windows` has the axes (plane, row, col, …). `ratios` (row, col, tap) contains the colour ratios, which are additional
    taps after the taps of the windows. The result has the axes (output, row, col).
    """
    outputs = np.empty((layer.weights.shape[1], *labels.shape))
    for row, label in enumerate(labels):  # row by row, because the transforms of all pixels would need gigabytes
        patches = _patches(windows, row)
        if ratios is not None:
            patches = np.concatenate([patches, ratios[row]], axis=1)
        weighted = layer.weights[label].astype(np.float64) @ patches[..., None]
        outputs[:, row] = (weighted[..., 0] + layer.intercept[label]).T
    return outputs


def white_scale(table: TransformTable) -> NDArray[np.float64]:
    """Return one factor per channel that converts raw values of a white object to the luminance of the object.

    Raw values are in DN above black, and luminances are in output units.
    """
    assert table.white_signals is not None
    return np.asarray(1 / (table.white_signals * (table.white_level - table.black_level)))


def raising_constants(table: TransformTable) -> dict[str, float | int]:
    """Return the constants for raising the luminance of pixels that are too dark.

    The keys of the result are the names of the constants. The result is empty if the table does not contain the signals of a
    white.
    """
    if table.white_signals is None:
        return {}
    factors = {
        "least_of_positive": LEAST_OF_POSITIVE,
        "least_of_negative": LEAST_OF_NEGATIVE,
        "raised_chroma": RAISED_CHROMA,
    }
    return {"least_reach": channel_reach(table.cfa), **factors}


def least_luminance(frame: RawFrame, table: TransformTable) -> NDArray[np.float64]:
    """Return the lowest luminance that each pixel can have according to the raw values around the pixel.

    Each raw value in a window around the pixel is divided by the value that a white object has in the same channel. The
    lowest luminance is a fraction of the smallest of these ratios. The window is just large enough to contain all channels.
    Values outside the frame are ignored. If the table does not contain the signals of a white, the result is −∞.

    Parameters
    ----------
    frame : RawFrame
        Frame whose raw values are scaled to the table's black and white levels.
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
    padded = np.pad((frame.values - frame.black_level) * scale, reach, constant_values=np.inf)
    smallest = np.lib.stride_tricks.sliding_window_view(padded, (2 * reach + 1,) * 2).min(axis=(2, 3))
    return np.asarray(smallest * np.where(smallest > 0, LEAST_OF_POSITIVE, LEAST_OF_NEGATIVE))


def smoothed_spectra(planes: NDArray[np.float64], smoothing: SpectralSmoothing) -> NDArray[np.float64]:
    """Smooth spectra by averaging each pixel with similar neighbours, without changing the brightness of a pixel.

    Let o be the outputs of a pixel, Y the mean of its outputs, p the central pixel of a window, and q any pixel of the
    window:

        w_q = max(0, 1 − ((Y_q − Y_p) / (reach · Y_p))²)²
        o_p ← ō_p · Y_p / Ȳ_p

    ō and Ȳ are means over the window, weighted by w. The means are computed from differences to the central pixel, so that
    uniform areas are unchanged to the last bit. At the borders, planes are mirrored about the outermost pixels.

    Parameters
    ----------
    planes : ndarray, (output, row, col)
        Spectra.
    smoothing : SpectralSmoothing
        Size of the window, and reach.

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
            continue  # the central pixel has a weight of 1, which `total` already contains
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
    """Smooth chroma by averaging each pixel with similar neighbours, then raise pixels that are too dark.

    Smoothing does not change the luminance.

    Let p be a pixel and q one of its neighbours (CHROMA_NEIGHBOURS). X_w and Z_w are the X and Z of `white`:

        e_q = X_q Y_p − X_p Y_q
        f_q = Z_q Y_p − Z_p Y_q
        w_q = max(0, 1 − ((Y_q − Y_p) / (reach · Y_p))² − ((e_q / X_w)² + (f_q / Z_w)²) / (likeness · Y_p²)²)²
        X_p ← X_p + Σ w_q e_q / (Y_p + Σ w_q Y_q)

    Z is changed in the same way. The new ratio X_p / Y_p is the weighted mean of X over p and its neighbours, divided by the
    weighted mean of Y. Areas of one chromaticity are unchanged to the last bit. At the borders, planes are mirrored about
    the outermost pixels.

    If Y_p is below `least`, it becomes `least`. X_p and Z_p then move towards the chroma of the diagonal neighbours, by at
    most RAISED_CHROMA times the change of Y_p.

    Parameters
    ----------
    planes : ndarray, (3, row, col)
        X, Y and Z.
    smoothing : ChromaSmoothing
        Differences of luminance and chroma at which the weight of a neighbour becomes zero.
    white : ndarray, (3,)
        XYZ of white, with Y = 1.
    least : ndarray, (row, col), or float
        Lower limit of the luminance of each pixel (`least_luminance`).

    Returns
    -------
    ndarray, (3, row, col)
    """
    luminance, chroma = planes[1], planes[::2]
    bright = luminance > SMOOTHING_DARKEST
    safe = np.where(bright, luminance, 1.0)
    scale = (white[::2] / white[1])[:, None, None] * smoothing.likeness * np.square(safe)
    padded, (rows, cols) = mirrored(planes, CHROMA_REACH), luminance.shape
    total, change, diagonal = safe.copy(), np.zeros_like(chroma), np.zeros_like(planes)
    for down, right in CHROMA_NEIGHBOURS:
        first, left = CHROMA_REACH + down, CHROMA_REACH + right
        there = padded[:, first : first + rows, left : left + cols]
        unlike = there[::2] * safe - chroma * there[1]
        square = np.square((there[1] - safe) / (smoothing.reach * safe)) + np.square(unlike / scale).sum(axis=0)
        weight = np.maximum(1 - square, 0) ** 2
        total += weight * there[1]
        change += weight * unlike
        if abs(down) == abs(right):
            diagonal += there
    smoothed = planes.copy()
    smoothed[::2] += np.where(bright, change / total, 0.0)
    raised = np.maximum(luminance, least)
    most = RAISED_CHROMA * (raised - luminance)
    share = raised / np.maximum(np.maximum(diagonal[1], raised), SMOOTHING_DARKEST)
    smoothed[::2] += np.clip(share * diagonal[::2] - smoothed[::2], -most, most)
    smoothed[1] = raised
    return smoothed
