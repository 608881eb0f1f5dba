"""Compute the classes and the additional taps of refinement layers for whole frames (docs/method.md#structure)."""

import functools
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.layers import RATIO_TAPS, PlaneRule
from l3cli.artifacts.plane_rules import StructureRule
from l3cli.classes import tree
from l3cli.classes.planes import CHROMA, LUMINANCE
from l3cli.classes.structure import BORDER_PIXELS, structures
from l3cli.classes.windows import Integers
from l3cli.frames.frame import mirrored_indices

RATIO_DARKEST = 2**9  # lower limit of the mean luminance as a divisor, in units of PLANE_STEP
ROWS_AT_ONCE = 64  # number of rows that are processed together, small enough for the processor cache


def label_planes(
    planes: NDArray[np.int32], first: Integers, rule: PlaneRule, first_rule: ClassRule, *others: PlaneRule
) -> Integers:
    """Classify every pixel for a refinement layer.

    Parameters
    ----------
    planes : ndarray, (plane, row, col)
        Opponent planes of the previous layer's outputs.
    first : ndarray, (row, col)
        Class of each pixel in the first layer.
    rule : PlaneRule
        Class rule of the refinement layer.
    first_rule : ClassRule
        Class rule of the first layer.
    *others : PlaneRule
        Class rules for other noise levels (docs/method.md#noise-sets), which differ from `rule` only in their gradient
        scales.

    Returns
    -------
    ndarray, (row, col)
        Class of each pixel. The classes of `rule` at all sites come first, followed by the classes of each rule in `others`.
    """
    place = first_rule.split(first)
    scale = place.level + first_rule.levels * (place.site // len(rule.turns)) if others else place.level
    kind = rule.kind(_structure(planes, scale, place.site, _of_all_sets(rule, others)), first_rule.lost(place.kind))
    return rule.join(rule.level_of(place.level), kind, place.site)


def _of_all_sets(rule: PlaneRule, others: tuple[PlaneRule, ...]) -> PlaneRule:
    """Combine class rules by concatenating their site orientations and gradient scales."""
    names = ("turns", "gradient_factor", "gradient_shift") if others else ()
    arrays: dict[str, Any] = {name: np.concatenate([getattr(each, name) for each in (rule, *others)]) for name in names}
    return replace(rule, **arrays)


def _structure(planes: NDArray[np.int32], level: Integers, site: Integers, rule: PlaneRule) -> Integers:
    """Return the structure of each pixel or, if the rule is a tree, its leaf, as if no channel clipped."""
    if isinstance(rule, StructureRule):
        luminance = mirrored(planes[LUMINANCE].astype(np.int32), BORDER_PIXELS)
        return structures(luminance, mirrored(level, BORDER_PIXELS - 1), site, rule)
    return tree.leaves(plane_evidence(planes, level, rule.gradient_factor, rule.gradient_shift), site, rule)


def plane_evidence(
    planes: NDArray[np.int32], level: Integers, factor: NDArray[np.uint8], shift: NDArray[np.uint8]
) -> tree.Evidence:
    """Compute the numerators and denominators for all tests of a tree at every pixel.

    Parameters
    ----------
    planes : ndarray, (plane, row, col)
        Opponent planes of the previous layer's outputs.
    level : ndarray, (row, col)
        Level of each pixel in the first layer.
    factor, shift : ndarray, (level,)
        Gradients are multiplied by `factor` and shifted right by `shift` bits.
    """
    place = mirrored(level, tree.BORDER_PIXELS - 1)
    return tree.evidence(
        mirrored(planes.astype(np.int32), tree.BORDER_PIXELS), factor.astype(np.int32)[place], shift.astype(np.int32)[place]
    )


def mirrored(planes: NDArray, margin: int) -> NDArray:
    """Pad the last two axes by reflection, without repeating the outermost rows and columns."""
    rows, cols = (mirrored_indices(length, margin, 1) for length in planes.shape[-2:])
    return planes[..., rows[:, None], cols]


def window_means(planes: NDArray, side: int) -> NDArray:
    """Return the means of planes over side × side windows. The planes must have a margin of side // 2 pixels.

    Shifted copies of the planes are added along rows, and then along columns. This is ten times as fast as a sum over a
    strided view.
    """
    rows, cols = (length - side + 1 for length in planes.shape[-2:])
    across = functools.reduce(np.add, [planes[..., first : first + cols] for first in range(side)])
    return np.asarray(functools.reduce(np.add, [across[..., first : first + rows, :] for first in range(side)]) / side**2)


def first_label_words(rule: PlaneRule, first: ClassRule, *others: PlaneRule) -> NDArray[np.uint64]:
    """Return a 64-bit word for each class of the first layer, in the layout of opencl/common/gradient.cl.

    The lower half contains the gradient factor, the gradient shift (from bit 8) and the site's orientation (from bit 14).
    The upper half contains the refinement layer's first class for the site and level. If all channels of a colour filter
    clip, the upper half instead contains the class of the saturation case, and its highest bit is set. The parameters are
    the same as for `label_planes`.
    """
    every = _of_all_sets(rule, others)
    place = first.split(np.arange(len(every.turns) * first.classes_per_site))
    scale = place.level + first.levels * (place.site // len(rule.turns))
    factor, shift = (values[scale].astype(np.uint64) for values in (every.gradient_factor, every.gradient_shift))
    if isinstance(every, StructureRule):
        turned = (every.turns < 0) @ np.array([1, 2])
    else:
        axes = np.array([tree.turned_axes(turn) for turn in every.turns.tolist()])
        turned = (axes * [1, -1, -1] > 0) @ np.array([1, 2, 4])
    case = first.lost(place.kind)
    start = rule.join(rule.level_of(place.level), rule.kind(0, case), place.site)
    upper = start | (case > 0).astype(np.int64) << 31
    lower = factor | shift << np.uint64(8) | turned.astype(np.uint64)[place.site] << np.uint64(14)
    return lower | upper.astype(np.uint64) << np.uint64(32)


def shaded_chroma(planes: NDArray, side: int) -> NDArray[np.float64]:
    """Estimate the deviation of each pixel's chroma from its window's mean, assuming that only shading varies.

    On a surface of one colour, the chroma planes are proportional to the luminance Y. At the centre of a side × side window,
    a chroma plane C then differs from its mean in the window by

        C̄ · ρ        ρ = clamp((Y − Ȳ) / max(Ȳ, RATIO_DARKEST), ±1)

    where a bar denotes a mean over the window. The result has the shape (chroma plane, row, col) and the unit of `planes`.
    """
    exact = planes.astype(np.float64)
    first, luminance, second = window_means(mirrored(exact, side // 2), side)
    share = np.clip((exact[LUMINANCE] - luminance) / np.maximum(luminance, RATIO_DARKEST), -1, 1)
    return np.stack([first * share, second * share])


def bilateral_change(planes: NDArray, side: int) -> NDArray[np.floating]:
    """Return the mean chroma of similar pixels in a side × side window, minus the chroma of the central pixel.

    Each pixel q in the window is weighted by its similarity to the central pixel, over all planes p. The result for a chroma
    plane C is

        Σ w_q (C_q − C) / Σ w_q        w_q = max(0, d̄ + RATIO_DARKEST² − d_q)²        d_q = Σ_p (p_q − p)²

    where d̄ is the mean of d_q over the window. The result has the shape (chroma plane, row, col) and the unit of `planes`.
    """
    # Float32 planes from training remain float32. Integers become float64.
    planes = planes.astype(np.result_type(planes, np.float32))
    padded, (_, rows, cols) = mirrored(planes, side // 2), planes.shape
    change = np.empty((2, rows, cols), planes.dtype)
    for first in range(0, rows, ROWS_AT_ONCE):
        own = planes[:, first : first + ROWS_AT_ONCE]
        down = own.shape[1]
        away = [padded[:, first + row : first + row + down, col : col + cols] - own for row, col in np.ndindex(side, side)]
        squares = [np.square(each).sum(axis=0) for each in away]
        reach = np.mean(squares, axis=0) + RATIO_DARKEST**2
        weights = [np.square(np.maximum(reach - each, 0)) for each in squares]
        change[:, first : first + down] = sum(w * each[CHROMA] for w, each in zip(weights, away, strict=True)) / sum(weights)
    return change


def taps_behind(planes: NDArray, side: int, count: int) -> NDArray[np.floating]:
    """Compute the additional taps of the last layer with `shaded_chroma` and `bilateral_change`.

    Parameters
    ----------
    planes : ndarray, (plane, row, col)
        Opponent planes of the previous layer's outputs.
    side : int
        Side of the windows in pixels.
    count : int
        Number of additional taps: a value in RATIO_TAPS.

    Returns
    -------
    ndarray, (tap, row, col)
        Values of the taps, in the unit of `planes`.
    """
    kinds = (shaded_chroma, bilateral_change)[: RATIO_TAPS.index(count)]
    return np.concatenate([np.empty((0, *planes.shape[1:])), *(kind(planes, side) for kind in kinds)])
