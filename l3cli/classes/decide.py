"""The class of a pixel from the statistics of its neighbourhood: the integer truth that every renderer is held against."""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.class_rule import ClassRule
from l3cli.classes import chroma, contrast, level, saturation
from l3cli.classes.statistics import Statistics, mosaic_statistics, patch_statistics
from l3cli.classes.windows import Integers, Neighbourhoods, neighbourhoods, tap_order


def labels(rule: ClassRule, statistics: Statistics) -> Integers:
    """Class within its site (…) of every pixel."""
    levels = level.levels(rule, statistics)
    contrasts = contrast.contrasts(rule, statistics, levels)
    kinds = rule.kind(chroma.chromas(rule, statistics), saturation.cases(rule, statistics.code))
    return rule.join(levels, contrasts, kinds)


def label_mosaic(
    values: NDArray[np.uint16], rule: ClassRule, cfa: NDArray[np.uint8], channels: int, phase: tuple[int, int] = (0, 0)
) -> Integers:
    """Class of every pixel of a mosaic (row, col) whose first pixel has CFA site `phase`."""
    statistics = mosaic_statistics(values, rule, neighbourhoods(cfa, rule.patch, channels), cfa, phase)
    return rule.on_site(labels(rule, statistics), statistics.site)


def label_patches(patches: NDArray[np.unsignedinteger], rule: ClassRule, near: Neighbourhoods, site: int) -> Integers:
    """Class within `site` of each patch (patch, tap) of DN."""
    order = tap_order(rule, near, site)
    return label_statistics(*patch_statistics(patches.T[order.taps].astype(np.uint32), rule, order), rule, near, site)


def label_statistics(
    sums: NDArray[np.uint32],
    squares: NDArray[np.uint32],
    code: Integers,
    rule: ClassRule,
    near: Neighbourhoods,
    site: int,
) -> Integers:
    """Class within `site` of each patch from channel sums and squares (channel, patch) and saturation codes (patch)."""
    where = np.array([site])
    return labels(rule, Statistics(near, where, sums.astype(np.int64).T, squares.astype(np.int64).T, code))
