"""Symmetry of a colour filter array.

Sites whose neighbourhoods are rotations or reflections of each other are trained together. A rotation or reflection of a
square is an *orientation*; the eight orientations are numbered as `orientations` lists them. Which of them a training may
use is a set of these numbers, `Allowed`, that every function here receives.

The set is an assumption about the camera: a patch that is read in an allowed orientation must be as likely as the patch
itself, and have the same noise. All eight orientations assume that scenes, optics and noise are isotropic. Noise of whole
rows or columns, or polarisers, allow fewer: rows must stay rows. The set must be a group, so that sites that match a third
site also match each other.
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
Allowed = tuple[int, ...]  # numbers of the orientations that training may use, increasing, with 0
EVERY_ORIENTATION: Allowed = tuple(range(8))  # isotropic noise
IDENTITY_ONLY: Allowed = (0,)  # every site is trained on its own


@dataclass(frozen=True)
class SiteMap:
    """How a site is trained: patch_of_site[permutation] has the layout of the patches of the canonical site."""

    canonical: int  # site
    orientation: int  # number of the orientation
    permutation: Indices  # (tap) of that orientation


@functools.cache
def orientations(patch: int) -> tuple[Indices, ...]:
    """Return the tap permutations of the eight rotations and reflections of a square patch, the identity first."""
    taps = np.arange(patch * patch).reshape(patch, patch)
    return tuple(np.rot90(side, turns).ravel() for side in (taps, taps.T) for turns in range(4))


def site_maps(channel: Indices, patch: int, allowed: Allowed = EVERY_ORIENTATION) -> list[SiteMap]:
    """Return how each site is trained (docs/method.md#symmetry).

    Parameters
    ----------
    channel : ndarray, (site, tap)
        Channel of each tap in the window of each site.
    patch : int
        Side of the windows in pixels.
    allowed : tuple of int
        Orientations in which a site may be trained as another one.

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
                SiteMap(known, number, orientations(patch)[number])
                for known in canonical
                for number in allowed
                if (window[orientations(patch)[number]] == channel[known]).all()
            ),
            None,
        )
        if site_map is None:
            canonical.append(site)
            site_map = SiteMap(site, 0, orientations(patch)[0])
        maps.append(site_map)
    return maps


def stabilisers(window: Indices, patch: int, allowed: Allowed = EVERY_ORIENTATION) -> list[int]:
    """Return the numbers of the allowed orientations that leave the layout of a window (tap) unchanged."""
    return [number for number in allowed if (window[orientations(patch)[number]] == window).all()]


def turned_classes(rule: ClassRule, number: int) -> Indices:
    """Return the class of each class's patches after they are read in orientation `number`.

    Only the values of the features beyond the basic ones can change, because sums over all taps of a patch stay the same.

    Parameters
    ----------
    rule : ClassRule
    number : int
        Number of the orientation.

    Returns
    -------
    ndarray, (class)
        Classes within a site.
    """
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


def turns_of(rule: ClassRule, window: Indices, allowed: Allowed = EVERY_ORIENTATION) -> list[Turn]:
    """Return the allowed orientations that leave a window (tap) unchanged, the identity first."""
    return [
        Turn(orientations(rule.patch)[number], np.argsort(turned_classes(rule, number)))
        for number in stabilisers(window, rule.patch, allowed)
    ]


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
