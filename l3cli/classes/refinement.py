"""Classes of a plane layer, of whole frames: from the planes and classes of the first layer (docs/method.md#structure)."""

import functools
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.plane_rules import StructureRule
from l3cli.artifacts.table import RATIO_TAPS, PlaneRule
from l3cli.classes import tree
from l3cli.classes.planes import CHROMA, LUMINANCE
from l3cli.classes.structure import REACH, structures
from l3cli.classes.windows import Integers
from l3cli.frames.frame import mirrored_indices

RATIO_DARKEST = 2**9  # steps of a plane: the least mean luminance that a ratio is taken to
ROWS_AT_ONCE = 64  # whose differences stay in the caches


def label_planes(
    planes: NDArray[np.int32], first: Integers, rule: PlaneRule, first_rule: ClassRule, *others: PlaneRule
) -> Integers:
    """Return the class (row, col) of every pixel, among those of all sites, from the first layer's planes (plane, row, col)
    and classes (row, col). `others`: the rules of further sets of transforms, which differ in the scale of gradients alone;
    classes of the sets follow one another, as if each had sites of its own."""
    place = first_rule.split(first)
    scale = place.level + first_rule.levels * (place.site // len(rule.turns)) if others else place.level
    kind = rule.kind(_structure(planes, scale, place.site, _of_all_sets(rule, others)), first_rule.lost(place.kind))
    return rule.join(rule.level_of(place.level), kind, place.site)


def _of_all_sets(rule: PlaneRule, others: tuple[PlaneRule, ...]) -> PlaneRule:
    """Return the rule with the sites of all sets, and the scales of gradients at the levels of all."""
    names = ("turns", "gradient_factor", "gradient_shift") if others else ()
    arrays: dict[str, Any] = {name: np.concatenate([getattr(each, name) for each in (rule, *others)]) for name in names}
    return replace(rule, **arrays)


def _structure(planes: NDArray[np.int32], level: Integers, site: Integers, rule: PlaneRule) -> Integers:
    """Return the structure class (row, col) of pixels where nothing is saturated."""
    if isinstance(rule, StructureRule):
        luminance = mirrored(planes[LUMINANCE].astype(np.int32), REACH)
        return structures(luminance, mirrored(level, REACH - 1), site, rule)
    return tree.leaves(plane_evidence(planes, level, rule.gradient_factor, rule.gradient_shift), site, rule)


def plane_evidence(
    planes: NDArray[np.int32], level: Integers, factor: NDArray[np.uint8], shift: NDArray[np.uint8]
) -> tree.Evidence:
    """Return the quantities that a tree's tests compare, from planes (plane, row, col), levels (row, col) and the scale
    (level) of gradients."""
    place = mirrored(level, tree.REACH - 1)
    return tree.evidence(
        mirrored(planes.astype(np.int32), tree.REACH), factor.astype(np.int32)[place], shift.astype(np.int32)[place]
    )


def mirrored(planes: NDArray, margin: int) -> NDArray:
    """Return the planes (…, row, col) with `margin` more pixels on each side, mirrored about the outermost ones."""
    rows, cols = (mirrored_indices(length, margin, 1) for length in planes.shape[-2:])
    return planes[..., rows[:, None], cols]


def window_means(planes: NDArray, side: int) -> NDArray:
    """Return the means (…, row, col) over side × side of planes (…, row, col) with a margin of mirrored pixels. Whole planes
    are added, along rows and then along columns: means of a strided view of windows take ten times as long."""
    rows, cols = (length - side + 1 for length in planes.shape[-2:])
    across = functools.reduce(np.add, [planes[..., first : first + cols] for first in range(side)])
    return np.asarray(functools.reduce(np.add, [across[..., first : first + rows, :] for first in range(side)]) / side**2)


def first_label_words(rule: PlaneRule, first: ClassRule, *others: PlaneRule) -> NDArray[np.uint64]:
    """Return a word for each class (class) of the first layer, as kernels read it. Its lower half holds the factor of
    gradients, from bit 8 on their shift, from bit 14 on the orientation of its site; its upper half the first class of
    its site and level, with the highest bit set where saturation decides and it is the class (opencl/common/gradient.cl).
    `others`: as in label_planes."""
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
    """Return the distance of the two chroma planes of a pixel from their means over side × side if all of the window had one
    colour and only light and shade: (chroma, row, col) of planes (plane, row, col), in their steps.

        C̄ · ρ        ρ = clamp((Y − Ȳ) / max(Ȳ, RATIO_DARKEST), ±1)

    """
    exact = planes.astype(np.float64)
    first, luminance, second = window_means(mirrored(exact, side // 2), side)
    share = np.clip((exact[LUMINANCE] - luminance) / np.maximum(luminance, RATIO_DARKEST), -1, 1)
    return np.stack([first * share, second * share])


def bilateral_change(planes: NDArray, side: int) -> NDArray[np.floating]:
    """Return the distance of the two chroma planes of a pixel to their means over the pixels q of side × side that are like
    it in all planes p: (chroma, row, col) of planes (plane, row, col), in their steps.

        Σ w_q (C_q − C) / Σ w_q        w_q = max(0, d̄ + RATIO_DARKEST² − d_q)²        d_q = Σ_p (p_q − p)²

    """
    planes = planes.astype(np.result_type(planes, np.float32))  # training's are of float32, and rounded as they are
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
    """Return the taps behind the windows of side × side of a last layer that has `count` of them: (tap, row, col) of planes
    (plane, row, col), in their steps."""
    kinds = (shaded_chroma, bilateral_change)[: RATIO_TAPS.index(count)]
    return np.concatenate([np.empty((0, *planes.shape[1:])), *(kind(planes, side) for kind in kinds)])
