"""Computes the automatic exposure of frames, and counts pixels for which the table was not trained (docs/method.md#display).

Sequences are measured on a sample of about 1500 pixels per frame.
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

GRID = (32, 48)  # largest number of rows and of columns in the grid of sampled pixels
# Relative luminance error that noise can cause near clipped pixels, where fewer channels measure the luminance.
NOISE_WHERE_CLIPPED = 0.05


class SpreadSamples:
    """Extracts about 1500 evenly spaced patches at one CFA site from a frame, and determines the class of each patch."""

    def __init__(self, table: TransformTable) -> None:
        self._table = table
        self._neighbours = neighbourhoods(table.cfa, table.first.rule.patch, len(table.channels))
        self._orders: dict[int, TapOrder] = {}  # CFA site → order of the taps

    def of(self, frame: RawFrame, gains: np.ndarray | None = None) -> tuple[RawFrame, int, Integers]:
        """Return patches of a frame, with the CFA site and the class of each patch.

        Parameters
        ----------
        frame : RawFrame
            Frame from which the patches are taken.
        gains : ndarray, (channel,), optional
            White balance gains to apply to the patches.

        Returns
        -------
        patches : RawFrame
            Frame whose values have the axes (patch, tap), with the shading of each patch.
        site : int
            CFA site of all patches, which is the site of the first pixel of the frame.
        labels : ndarray, (patch,)
            Class of each patch in the first layer, numbered within the site.
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
        """Return the patches of a frame, without white balance gains."""
        return self._at_levels(self._cut(frame))

    def _at_levels(self, cut: RawFrame) -> RawFrame:
        """Scale patches to the table's black and white levels, and correct their colour shading."""
        table = self._table
        return cut.at_levels(table.black_level, table.white_level, table.bits).shading_corrected()

    def _cut(self, frame: RawFrame) -> RawFrame:
        """Extract the patches of a frame, with the black and white levels of the frame."""
        down, across = self._geometry(frame)
        patches = frame.values.reshape(-1).take(_places(down, across))
        shading = None
        if frame.shading is not None:
            (row, row_source), (col, col_source) = _windows(*down), _windows(*across)
            taken = (row_source[:, None, :, None], col_source[None, :, None, :])
            shading = frame.shading.of_patches(taken, row[:, 0], col[:, 0])
        return replace(frame, values=patches, shading=shading)

    def shape(self, frame: RawFrame) -> tuple[int, int]:
        """Return the number of rows and of columns in the grid of patches. The patches are numbered row by row."""
        down, across = self._geometry(frame)
        return len(_windows(*down)[0]), len(_windows(*across)[0])

    def _geometry(self, frame: RawFrame) -> list[tuple[int, int, int, int]]:
        """Return the arguments of `_windows` for the rows and for the columns."""
        table = self._table
        return [(frame.values.shape[axis], table.cfa.shape[axis], table.first.rule.patch, GRID[axis]) for axis in (0, 1)]

    def signal(self, patches: RawFrame) -> NDArray[np.float32]:
        """Convert the values of patches to fractions of full scale."""
        full_scale = np.float32(self._table.white_level - self._table.black_level)
        return (patches.values.astype(np.float32) - np.float32(patches.black_level)) / full_scale


class LightMeter:
    """Measures the 99th percentile of the luminance in a frame, from about 1500 pixels that are rendered on the CPU.

    The effect of noise near clipped pixels is removed, as in `still_scale`. The result is limited to the luminance of a
    white that clips every channel, because l3 always displays such a white as white. All sampled pixels have the same CFA
    site, which is sufficient because all sites respond equally to uniform areas. The result does not depend on the device.
    """

    def __init__(self, table: TransformTable) -> None:
        self.table, self._samples = table, SpreadSamples(table)
        self._weights = np.ascontiguousarray(table.first.weights[:, 1])
        self._intercept = table.first.intercept[:, 1]
        self._limit = np.inf if table.clipped_white is None else table.clipped_white[1]

    def brightness(self, frame: RawFrame, balance: WhiteBalance | None = None) -> float:
        """Return the luminance Y that is displayed as white, after the white balance gains of `balance`."""
        patches, site, labels = self._samples.of(frame, None if balance is None else balance.gains)
        classes = self.table.first.rule.on_site(labels, site)
        luminance = np.einsum("nt,nt->n", self._weights[classes], self._samples.signal(patches)) + self._intercept[classes]
        if patches.shading is not None:
            luminance *= patches.shading.gain[:, 0]
        rule, raised = self.table.first.rule, 1.0 if balance is None else balance.luminance
        white = _white(luminance, rule.case(rule.split(labels).kind) > 0)
        return raised * frame.light_share * min(white, self._limit)


def still_scale(luminance: NDArray[np.floating], frame: RawFrame, table: TransformTable) -> float:
    """Return the automatic exposure scale of a still image, which is the factor that maps white to 1.

    Parameters
    ----------
    luminance : ndarray, (row, col)
        Rendered Y of the frame.
    frame : RawFrame
        The frame, with white balance gains applied.
    table : TransformTable
        The table that rendered the frame.

    Returns
    -------
    float
        The scale, or 1 if the scene is dark.
    """
    rule, floor = table.first.rule, frame.black_level + frame.dark
    clips_from = floor + (rule.saturation - table.black_level) / (table.white_level - table.black_level) * (
        frame.white_level - floor
    )
    clipped = frame.values >= clips_from
    white = _white(luminance, _near(clipped, rule.saturation_radius)) if clipped.any() else white_percentile(luminance)
    return 1.0 / white if white > 0 else 1.0


def _white(luminance: NDArray[np.floating], clipped: NDArray[np.bool_]) -> float:
    """Return the luminance that should be displayed as white: the 99th percentile, corrected for the noise of clipped areas.

    Noise raises the percentile, so that a uniform white would be displayed as grey. The effect is visible in areas where
    some channels clip, because fewer channels measure the luminance there. The result is therefore the mean luminance of the
    pixels that differ from the percentile by at most `NOISE_WHERE_CLIPPED`. For pixels outside clipped areas, this mean uses
    the percentile instead of the luminance.
    """
    white = white_percentile(luminance)
    alike = np.abs(luminance - white) <= NOISE_WHERE_CLIPPED * white
    if not (alike & clipped).any():
        return white
    return float(np.where(clipped, luminance, white)[alike].mean(dtype=np.float64))


def _near(marked: NDArray[np.bool_], radius: int) -> NDArray[np.bool_]:
    """Return a mask of the pixels within `radius` rows and `radius` columns of a marked pixel."""
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
    """Choose evenly spaced patches along one axis of a frame, and return the indices of their samples.

    There are at most `most` patches. All patches are centred on samples with the CFA phase of the first sample.

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
    """Return the index of each patch value in the flattened frame, with the axes (patch, tap).

    Indexing the flattened frame is twice as fast as indexing by row and column.
    """
    (_, row), (_, col) = _windows(*down), _windows(*across)
    places = row[:, None, :, None].astype(np.intp) * across[0] + col[None, :, None, :]
    places.flags.writeable = False
    return places.reshape(-1, row.shape[1] * col.shape[1])


class SteadyExposure:
    """Computes the exposure scale of the frames of a sequence, one after another.

    The scale of the first frame is computed from its brightness alone. For later frames, the logarithm of the scale
    approaches the required value exponentially, which smooths measurement noise and follows changes of the light without
    overshoot. Changes of the analog gain are compensated immediately. The scale does not depend on later frames.
    """

    def __init__(self, rate: Fraction) -> None:
        self._share = followed_share(rate)
        self._log: float | None = None

    def scale(self, brightness: float, gain: float = 1.0) -> float:
        """Return the scale of the next frame, from its brightness and analog gain.

        A completely dark frame has the scale of the previous frame, or 1 at the beginning of a sequence.
        """
        if brightness > 0:
            wanted = math.log(gain / brightness)
            self._log = wanted if self._log is None else self._log + self._share * (wanted - self._log)
        return 1.0 if self._log is None else math.exp(self._log) / gain


@dataclass(frozen=True)
class OutOfRange:
    """Fractions of a frame's pixels that are outside the training range of the table, or saturated.

    `darker`, `brighter` and `untrained` count different pixels.
    """

    darker: float  # pixels darker than all trained levels
    brighter: float  # pixels brighter than all trained levels
    untrained: float  # pixels at trained levels whose classes have no training patches
    saturated: float  # pixels that are clipped or near a clipped pixel


class RangeMeter:
    """Measures the fraction of a frame's pixels for which a table was not trained, from about 1500 pixels per frame."""

    def __init__(self, table: TransformTable) -> None:
        self._table, self._spread = table, SpreadSamples(table)
        self._samples = table.first.rule.by_feature(table.first.samples)

    def outside(self, frame: RawFrame) -> OutOfRange:
        """Measure the fractions of pixels in a frame that are too dark, too bright, untrained or saturated."""
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
        """Return the lowest and the highest signal for which the table was trained, as fractions of full scale."""
        table = self._table
        learned = np.flatnonzero(self._samples.sum(axis=(0, 2, 3, 4)) > 0)
        edges = np.concatenate([[0.0], level.inner_bounds(table.first.rule, table.black_level, table.white_level), [1.0]])
        return (float(edges[learned[0]]), float(edges[learned[-1] + 1])) if learned.size else (0.0, 1.0)
