"""Symmetry of a colour filter array.

Sites whose neighbourhoods are rotations or reflections of each other are trained together.
"""

import functools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.plane_rules import DIRECTIONS, StructureRule
from l3cli.classes import structure
from l3cli.classes.features import features_of

Indices = NDArray[np.int64]


@dataclass(frozen=True)
class SiteMap:
    """How a site is trained: patch_of_site[permutation] has the layout of the patches of the canonical site."""

    canonical: int  # site
    permutation: Indices  # (tap)


@functools.cache
def orientations(patch: int) -> tuple[Indices, ...]:
    """Return the tap permutations of the eight rotations and reflections of a square patch, the identity first."""
    taps = np.arange(patch * patch).reshape(patch, patch)
    return tuple(np.rot90(side, turns).ravel() for side in (taps, taps.T) for turns in range(4))


def site_maps(channel: Indices, patch: int, shared: bool = True) -> list[SiteMap]:
    """Return how each site is trained (docs/method.md#symmetry).

    Parameters
    ----------
    channel : ndarray, (site, tap)
        Channel of each tap in the window of each site.
    patch : int
        Side of the windows in pixels.
    shared : bool
        False: every site is trained on its own.

    Returns
    -------
    list of SiteMap, (site)
        The first site whose window is the same in some orientation, and that orientation.
    """
    maps: list[SiteMap] = []
    canonical: list[int] = []
    for site, window in enumerate(channel):
        site_map = next(
            (
                SiteMap(known, permutation)
                for known in (canonical if shared else ())
                for permutation in orientations(patch)
                if (window[permutation] == channel[known]).all()
            ),
            None,
        )
        if site_map is None:
            canonical.append(site)
            site_map = SiteMap(site, orientations(patch)[0])
        maps.append(site_map)
    return maps


def stabilisers(window: Indices, patch: int) -> list[Indices]:
    """Return the orientations that leave the layout of a window (tap) unchanged."""
    return [permutation for permutation in orientations(patch) if (window[permutation] == window).all()]


def turned_classes(rule: ClassRule, permutation: Indices) -> Indices:
    """Return the class of each class's patches after an orientation permutes their taps.

    Only the values of the features beyond the basic ones can change, because sums over all taps of a patch stay the same.

    Parameters
    ----------
    rule : ClassRule
    permutation : ndarray, (tap)
        One of `orientations`.

    Returns
    -------
    ndarray, (class)
        Classes within a site.
    """
    number = next(n for n, each in enumerate(orientations(rule.patch)) if np.array_equal(each, permutation))
    transposed, turns = divmod(number, 4)
    place = rule.split(np.arange(rule.classes_per_site))
    values = zip(features_of(rule), rule.split_features(place.combination), strict=True)
    combination = rule.join_features(
        [module.turned(feature, bool(transposed), turns)[value] for (module, feature), value in values]
    )
    return rule.join(place.level, place.contrast, place.kind, combination=combination)


class Turn(NamedTuple):
    """An orientation that leaves the window of a site unchanged, and its effect on patches."""

    taps: Indices  # (tap) permutation
    classes: Indices  # (class) the class whose patches become patches of this class


def turns_of(rule: ClassRule, window: Indices, shared: bool = True) -> list[Turn]:
    """Return the orientations that leave a window (tap) unchanged, the identity first.

    Only the identity is returned if sites are not trained together (`shared`).
    """
    every = stabilisers(window, rule.patch) if shared else [orientations(rule.patch)[0]]
    return [Turn(turn, np.argsort(turned_classes(rule, turn))) for turn in every]


def turned_structures(rule: StructureRule, number: int) -> Indices:
    """Return the class of each class's windows when they are read in orientation `number` of `orientations`.

    Only the direction of an edge changes.
    """
    across, down = structure.turn_signs(orientations(3)[number])
    place = rule.split(np.arange(rule.classes_per_site))
    strength, within = np.divmod(place.kind - 1, 1 + DIRECTIONS)
    direction = DIRECTIONS // 2 - (within - 1) if across < 0 else within - 1  # of twice the gradient's angle
    direction = (direction if down > 0 else -direction) % DIRECTIONS
    directed = (place.kind > 0) & (place.kind < rule.structures) & (within > 0)
    return np.asarray(rule.join(place.level, np.where(directed, 2 + strength * (1 + DIRECTIONS) + direction, place.kind)))
