"""Determine the automatic exposure, and the fraction of pixels that lie outside the trained range of a table.

Only the exposure of stills is measured on all pixels. All other measurements use about 1500 pixels per frame. See
docs/method.md#display.
"""

import functools
import math
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.classes import level
from l3cli.classes.decide import label_patches
from l3cli.classes.windows import Integers, TapOrder, neighbourhoods, tap_order, window_channels
from l3cli.frames.frame import RawFrame, mirrored_indices
from l3cli.physics.display import white_percentile
from l3cli.rendering.white.scene_white import WhiteBalance, balanced_patches, followed_share

GRID = (32, 48)  # maximum numbers of rows and columns of sampled pixels
# Relative error of the luminance, due to noise, near clipped pixels. Fewer channels contribute to the luminance there.
NOISE_WHERE_CLIPPED = 0.05


class SpreadSamples:
    """Extracts about 1500 evenly spaced patches from a frame, all at one CFA site, and classifies them."""

    def __init__(self, table: TransformTable) -> None:
        self._table = table
        self._neighbours = neighbourhoods(table.cfa, table.first.rule.patch, len(table.channels))
        self._orders: dict[int, TapOrder] = {}  # CFA site → order of the taps

    def of(self, frame: RawFrame, gains: np.ndarray | None = None) -> tuple[RawFrame, int, Integers]:
        """Extract and classify patches of a frame.

        Parameters
        ----------
        frame : RawFrame
            Frame to sample.
        gains : ndarray, (channel,), optional
            White-balance gains to apply to the patches.

        Returns
        -------
        patches : RawFrame
            Patches at the table's levels, with values of shape (patch, tap) and the shading of each patch.
        site : int
            CFA site of all patches. It is the site of the frame's first pixel.
        labels : ndarray, (patch,)
            First-layer class of each patch, numbered within the site.
        """
        table, rule = self._table, self._table.first.rule
        cut, site = self._cut(frame), frame.phase[0] * table.cfa.shape[1] + frame.phase[1]
        if gains is not None:
            cut = balanced_patches(cut, window_channels(table.cfa, rule.patch)[site], gains)
        if site not in self._orders:
            self._orders[site] = tap_order(rule, self._neighbours, site)
        cut = self._at_levels(cut)
        return cut, site, label_patches(cut.values, rule, self._neighbours, site, self._orders[site])

    def patches(self, frame: RawFrame) -> RawFrame:
        """Extract patches, scaled to the table's levels, without white balance or classification."""
        return self._at_levels(self._cut(frame))

    def _at_levels(self, cut: RawFrame) -> RawFrame:
        """Scale patches to the table's levels, and correct their colour shading."""
        table = self._table
        return cut.at_levels(table.black_level, table.white_level, table.bits).shading_corrected()

    def _cut(self, frame: RawFrame) -> RawFrame:
        down, across = self._geometry(frame)
        patches = frame.values.reshape(-1).take(_places(down, across))
        shading = None
        if frame.shading is not None:
            (row, row_source), (col, col_source) = _windows(*down), _windows(*across)
            taken = (row_source[:, None, :, None], col_source[None, :, None, :])
            shading = frame.shading.of_patches(taken, row[:, 0], col[:, 0])
        return replace(frame, values=patches, shading=shading)

    def shape(self, frame: RawFrame) -> tuple[int, int]:
        """Return the numbers of rows and columns of patches, which are ordered row by row."""
        down, across = self._geometry(frame)
        return len(_windows(*down)[0]), len(_windows(*across)[0])

    def _geometry(self, frame: RawFrame) -> list[tuple[int, int, int, int]]:
        table = self._table
        return [(frame.values.shape[axis], table.cfa.shape[axis], table.first.rule.patch, GRID[axis]) for axis in (0, 1)]

    def signal(self, patches: RawFrame) -> NDArray[np.float32]:
        """Convert patch values to fractions of full scale."""
        full_scale = np.float32(self._table.white_level - self._table.black_level)
        return (patches.values.astype(np.float32) - np.float32(patches.black_level)) / full_scale


class LightMeter:
    """Measures the 99th percentile of a frame's luminance from about 1500 pixels.

    The effect of noise near clipped pixels is removed, as in `still_scale`. The result is limited to the luminance of a
    white that clips all channels, because l3 always displays such a white as white. One CFA site is sufficient, because all
    sites respond equally to uniform areas. The pixels are rendered on the CPU, so that the result does not depend on the
    OpenCL device.
    """

    def __init__(self, table: TransformTable) -> None:
        self.table, self._samples = table, SpreadSamples(table)
        self._weights = np.ascontiguousarray(table.first.weights[:, 1])
        self._intercept = table.first.intercept[:, 1]
        self._limit = np.inf if table.clipped_white is None else table.clipped_white[1]

    def brightness(self, frame: RawFrame, balance: WhiteBalance | None = None) -> float:
        """Return the luminance Y to display as white, for a frame with the white balance `balance`."""
        patches, site, labels = self._samples.of(frame, None if balance is None else balance.gains)
        classes = self.table.first.rule.on_site(labels, site)
        luminance = np.einsum("nt,nt->n", self._weights[classes], self._samples.signal(patches)) + self._intercept[classes]
        if patches.shading is not None:
            luminance *= patches.shading.gain[:, 0]
        rule, raised = self.table.first.rule, 1.0 if balance is None else balance.luminance
        white = _white(luminance, rule.case(rule.split(labels).kind) > 0)
        return raised * frame.light_share * min(white, self._limit)


def still_scale(luminance: NDArray[np.floating], frame: RawFrame, table: TransformTable) -> float:
    """Compute the automatic exposure scale of a still: the factor that maps the luminance of white to 1.

    Parameters
    ----------
    luminance : ndarray, (row, col)
        Rendered Y.
    frame : RawFrame
        The frame, after white-balance gains.
    table : TransformTable
        Table that rendered the frame.

    Returns
    -------
    float
        Exposure scale, or 1 if the frame is completely dark.
    """
    rule, floor = table.first.rule, frame.black_level + frame.dark
    clips_from = floor + (rule.saturation - table.black_level) / (table.white_level - table.black_level) * (
        frame.white_level - floor
    )
    clipped = frame.values >= clips_from
    white = _white(luminance, _near(clipped, rule.saturation_radius)) if clipped.any() else white_percentile(luminance)
    return 1.0 / white if white > 0 else 1.0


def _white(luminance: NDArray[np.floating], clipped: NDArray[np.bool_]) -> float:
    """Return the luminance to display as white: the 99th percentile, corrected for noise in clipped areas.

    Noise raises the percentile, so that a uniform white would look grey. This is visible where some channels clip, because
    fewer channels contribute to the luminance. The correction averages over all pixels with a luminance within
    `NOISE_WHERE_CLIPPED` of the percentile. A clipped pixel contributes its own luminance to the mean, and any other pixel
    contributes the percentile.
    """
    white = white_percentile(luminance)
    alike = np.abs(luminance - white) <= NOISE_WHERE_CLIPPED * white
    if not (alike & clipped).any():
        return white
    return float(np.where(clipped, luminance, white)[alike].mean(dtype=np.float64))


def _near(marked: NDArray[np.bool_], radius: int) -> NDArray[np.bool_]:
    """Dilate a mask by `radius` pixels in rows and columns."""
    for turned in (False, True):
        marked = marked.T if turned else marked
        near = marked.copy()
        for distance in range(1, radius + 1):
            near[distance:] |= marked[:-distance]
            near[:-distance] |= marked[distance:]
        marked = near.T if turned else near
    return marked


@functools.lru_cache(4)  # the result is the same for all frames of a sequence
def _windows(length: int, period: int, patch: int, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Choose at most `most` evenly spaced patches along one axis, and return the indices of their samples.

    The central samples of all patches have the same CFA phase as the first sample of the frame.

    Returns
    -------
    padded : ndarray, (patch, tap)
        Index of each sample in the frame including its mirrored margins.
    source : ndarray, (patch, tap)
        Index of each sample in the frame without margins.
    """
    available = -(-length // period)
    spread = np.linspace(0, available - 1, min(most, available)).round().astype(int)
    chosen = spread[np.diff(spread, prepend=-1) > 0]  # np.unique would load modules that rendering does not need
    padded = chosen[:, None] * period + np.arange(patch)
    return padded, mirrored_indices(length, patch // 2, period)[padded]


@functools.lru_cache(1)
def _places(down: tuple[int, int, int, int], across: tuple[int, int, int, int]) -> np.ndarray:
    """Return the indices (patch, tap) of all patch values in the flattened frame.

    Access by these indices is twice as fast as access by row and column.
    """
    (_, row), (_, col) = _windows(*down), _windows(*across)
    places = row[:, None, :, None].astype(np.intp) * across[0] + col[None, :, None, :]
    places.flags.writeable = False
    return places.reshape(-1, row.shape[1] * col.shape[1])


class SteadyExposure:
    """Smooths the automatic exposure of a sequence over time, frame by frame.

    The first frame is exposed for its own brightness. Afterwards, the logarithm of the scale approaches the measured value
    exponentially. This suppresses measurement noise, and follows changes in lighting without overshoot. Changes in the
    analog gain are compensated immediately. Later frames do not affect the scale of a frame.
    """

    def __init__(self, rate: Fraction) -> None:
        self._share = followed_share(rate)
        self._log: float | None = None

    def scale(self, brightness: float, gain: float = 1.0) -> float:
        """Return the exposure scale for the next frame.

        `brightness` is the luminance to display as white. If it is 0, the scale of the previous frame is returned, or 1 at
        the beginning of a sequence.
        """
        if brightness > 0:
            wanted = math.log(gain / brightness)
            self._log = wanted if self._log is None else self._log + self._share * (wanted - self._log)
        return 1.0 if self._log is None else math.exp(self._log) / gain


@dataclass(frozen=True)
class OutOfRange:
    """Fractions of a frame's pixels that are saturated, or for which a table was not trained.

    A pixel is included in at most one of the first three fractions.
    """

    darker: float  # darker than all trained levels
    brighter: float  # brighter than all trained levels
    untrained: float  # at a trained level, but in a class without training patches
    saturated: float  # clipped or near a clipped pixel


class RangeMeter:
    """Estimates the fraction of a frame's pixels for which a table was not trained, from about 1500 pixels."""

    def __init__(self, table: TransformTable) -> None:
        self._table, self._spread = table, SpreadSamples(table)
        self._samples = table.first.rule.by_feature(table.first.samples)

    def outside(self, frame: RawFrame) -> OutOfRange:
        """Estimate the fractions of pixels that are too dark, too bright, in untrained classes, or saturated."""
        rule = self._table.first.rule
        _, site, labels = self._spread.of(frame)
        place = rule.split(labels)
        learned = np.flatnonzero(self._samples[site].sum(axis=(1, 2, 3)) > 0)
        lowest, highest = (learned[0], learned[-1]) if learned.size else (0, rule.levels - 1)
        darker, brighter = place.level < lowest, place.level > highest
        untrained = (self._table.first.samples[rule.on_site(labels, site)] == 0) & ~darker & ~brighter
        saturated = rule.lost(place.kind) > 0
        return OutOfRange(*(float(np.mean(mask)) for mask in (darker, brighter, untrained, saturated)))

    def learned_range(self) -> tuple[float, float]:
        """Return the lowest and highest trained signals, as fractions of full scale."""
        table = self._table
        learned = np.flatnonzero(self._samples.sum(axis=(0, 2, 3, 4)) > 0)
        edges = np.concatenate([[0.0], level.inner_bounds(table.first.rule, table.black_level, table.white_level), [1.0]])
        return (float(edges[learned[0]]), float(edges[learned[-1] + 1])) if learned.size else (0.0, 1.0)
