"""Compute the class of a pixel from the statistics of its patch, in integer arithmetic.

This module is the reference implementation. All renderers must assign every pixel to the same class as this module, and the
tests verify this.
"""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.class_rule import ClassRule
from l3cli.classes import chroma, contrast, level, saturation
from l3cli.classes.features import features_of
from l3cli.classes.statistics import PatchSums, Statistics, mosaic_statistics, patch_statistics, window_sums
from l3cli.classes.windows import Integers, Neighbourhoods, TapOrder, neighbourhoods, tap_order


def labels(rule: ClassRule, statistics: Statistics) -> Integers:
    """Return the class of every pixel. Classes are numbered from 0 within each CFA site."""
    levels = level.levels(rule, statistics)
    contrasts = contrast.contrasts(rule, statistics, levels)
    kinds = rule.kind(chroma.chromas(rule, statistics), saturation.cases(rule, statistics.code))
    combination = rule.join_features(
        [
            np.minimum(module.values(feature, rule, sums, levels), feature.size - 1)
            for (module, feature), sums in zip(features_of(rule), window_sums(rule, statistics), strict=True)
        ]
    )
    return rule.join(levels, contrasts, kinds, combination=combination)


def label_mosaic(
    values: NDArray[np.uint16], rule: ClassRule, cfa: NDArray[np.uint8], channels: int, phase: tuple[int, int] = (0, 0)
) -> Integers:
    """Return the class of every pixel of a raw frame.

    Parameters
    ----------
    values : ndarray, (row, col)
        Raw values in DN.
    rule : ClassRule
        The class rule.
    cfa : ndarray, (cfa_row, cfa_col)
        Channel of each site.
    channels : int
        Number of channels.
    phase : tuple of int
        CFA site (row, col) of the first pixel.

    Returns
    -------
    ndarray, (row, col)
        Class index of each pixel. Classes are numbered consecutively over all sites.
    """
    statistics = mosaic_statistics(values, rule, neighbourhoods(cfa, rule.patch, channels), cfa, phase)
    return rule.on_site(labels(rule, statistics), statistics.site)


def label_patches(
    patches: NDArray[np.unsignedinteger],
    rule: ClassRule,
    neighbours: Neighbourhoods,
    site: int,
    order: TapOrder | None = None,
) -> Integers:
    """Return the class of each patch. Classes are numbered from 0 within the CFA site.

    Parameters
    ----------
    patches : ndarray, (patch, tap)
        Raw values in DN.
    rule : ClassRule
        The class rule.
    neighbours : Neighbourhoods
        Result of `neighbourhoods` for the CFA.
    site : int
        CFA site at the centre of the patches.
    order : TapOrder, optional
        Result of `tap_order` for the site. [default: it is computed]
    """
    order = order or tap_order(rule, neighbours, site)
    return label_sums(patch_statistics(patches.T[order.taps].astype(np.uint32), rule, order), rule, neighbours, site)


def label_sums(seen: PatchSums, rule: ClassRule, neighbours: Neighbourhoods, site: int) -> Integers:
    """Return the class of each patch, given its sums. Classes are numbered from 0 within the CFA site."""
    return labels(rule, _statistics(seen, neighbours, site))


def observe_patches(
    patches: NDArray[np.unsignedinteger], rule: ClassRule, neighbours: Neighbourhoods, site: int
) -> dict[str, NDArray[np.float64]]:
    """Measure the pilot patches' statistics from which additional features compute their constants.

    Parameters
    ----------
    patches : ndarray, (patch, tap)
        Raw values of the pilot patches in DN.
    rule : ClassRule
        The class rule.
    neighbours : Neighbourhoods
        Result of `neighbourhoods` for the CFA.
    site : int
        CFA site at the centre of the patches.

    Returns
    -------
    dict of str to ndarray, (patch, …)
        Statistics by name of the additional feature. Empty if the class rule has no additional features.
    """
    if not rule.feature_list:
        return {}
    order = tap_order(rule, neighbours, site)
    statistics = _statistics(patch_statistics(patches.T[order.taps].astype(np.uint32), rule, order), neighbours, site)
    levels = level.levels(rule, statistics)
    return {
        feature.name: module.observe(feature, rule, sums, levels)
        for (module, feature), sums in zip(features_of(rule), window_sums(rule, statistics), strict=True)
    }


def _statistics(seen: PatchSums, neighbours: Neighbourhoods, site: int) -> Statistics:
    sums, windows = (each.astype(np.int64).T for each in (seen.sums, seen.windows))
    squares = None if seen.squares is None else seen.squares.astype(np.int64).T
    return Statistics(neighbours, np.array([site]), sums, squares, seen.code, windows)
