"""Find the symmetries of a colour filter array.

If the neighbourhoods of two sites are rotations or reflections of each other, the sites are trained together. The eight
rotations and reflections of a square are called *orientations*, and are numbered in the order of the function
`orientations`. The parameter `allowed` lists the orientations that training may use.

A patch that is read in an allowed orientation must be as likely as the original patch, and must have the same noise. If
scenes, optics and noise are isotropic, all eight orientations are allowed. If row noise and column noise differ, rows must
remain rows. Polarisers allow only a half turn, because other orientations change the sign of S1 or S2. The allowed
orientations must form a group, so that two sites that match a third site also match each other.
"""

import functools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.plane_rules import DIRECTIONS, StructureRule
from l3cli.classes import structure
from l3cli.classes.features import features_of

Indices = NDArray[np.int64]
Allowed = tuple[int, ...]  # numbers of the orientations that training may use, in increasing order, beginning with 0
EVERY_ORIENTATION: Allowed = tuple(range(8))  # for isotropic noise
IDENTITY_ONLY: Allowed = (0,)  # every site is trained separately
HALF_TURN: Allowed = (0, 2)  # for polarisers, because all other orientations change the signs of S1 or S2
LINES_KEPT: Allowed = (0, 2, 5, 7)  # rows stay rows and columns stay columns: identity, half turn and two reflections
# Training may exchange rows and columns if the variances of row and column offsets differ by at most this fraction of the
# pixel noise variance in the dark. The exchange doubles the number of training patches per site, which is then worth more
# than the exact covariance.
MAX_LINE_DIFFERENCE = 1 / 16


def orientations_of_scenes(camera: CameraModel) -> Allowed:
    """Return the orientations to which simulated scenes may be rotated or mirrored for training.

    All orientations of a scene are equally likely. If the camera has polarisers, only a half turn is allowed, because all
    other orientations change the angle of polarisation.
    """
    return EVERY_ORIENTATION if camera.polarisers is None else HALF_TURN


def orientations_of_frames(camera: CameraModel) -> Allowed:
    """Return the orientations in which windows of noisy frames may be read for training.

    A rotated or mirrored frame must be as likely as the original, including its noise. If row noise and column noise differ
    by more than MAX_LINE_DIFFERENCE, rows must remain rows.
    """
    noise = camera.corrected_noise()
    rows = noise.row_temporal_noise**2 + noise.row_noise**2
    columns = noise.column_temporal_noise**2 + noise.column_noise**2
    same = abs(rows - columns) <= MAX_LINE_DIFFERENCE * camera.pixel_variance()
    return tuple(number for number in orientations_of_scenes(camera) if same or number in LINES_KEPT)


@dataclass(frozen=True)
class SiteMap:
    """The canonical site that provides a site's transforms, and the orientation that relates the two sites.

    If ``patch`` is a patch at the site, ``patch[permutation]`` has the CFA layout of the canonical site.
    """

    canonical: int  # index of the canonical site
    orientation: int  # index of the orientation in `orientations`
    permutation: Indices  # (tap) permutation of the taps in this orientation


@functools.cache
def orientations(patch: int) -> tuple[Indices, ...]:
    """Return the tap permutations for the eight orientations of a square patch, beginning with the identity."""
    taps = np.arange(patch * patch).reshape(patch, patch)
    return tuple(np.rot90(side, turns).ravel() for side in (taps, taps.T) for turns in range(4))


def site_maps(channel: Indices, patch: int, allowed: Allowed = EVERY_ORIENTATION) -> list[SiteMap]:
    """Find each site's canonical site and orientation (docs/method.md#symmetry).

    The canonical site is the first site that has the same CFA layout in one of the allowed orientations.

    Parameters
    ----------
    channel : ndarray, (site, tap)
        Channel of each tap in the window of each site.
    patch : int
        Side of the windows, in pixels.
    allowed : tuple of int
        Numbers of the allowed orientations.

    Returns
    -------
    list of SiteMap
        One per site.
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
    """Return the allowed orientations that leave `window`, the channel of each tap, unchanged."""
    return [number for number in allowed if (window[orientations(patch)[number]] == window).all()]


def turned_classes(rule: ClassRule, number: int) -> Indices:
    """Return, for each class, the class of its patches when they are read in orientation `number`.

    Level, contrast, chroma and saturation case do not depend on the order of the taps, so they are the same in every
    orientation. Features such as direction can change.

    Parameters
    ----------
    rule : ClassRule
        Class rule of the first layer.
    number : int
        Index of the orientation in `orientations`.

    Returns
    -------
    ndarray, (class)
        Index of the class within the site.
    """
    transposed, turns = divmod(number, 4)
    place = rule.split(np.arange(rule.classes_per_site))
    values = zip(features_of(rule), rule.split_features(place.combination), strict=True)
    combination = rule.join_features(
        [module.turned(feature, bool(transposed), turns)[value] for (module, feature), value in values]
    )
    return rule.join(place.level, place.contrast, place.kind, combination=combination)


class Turn(NamedTuple):
    """An orientation that leaves the CFA layout of a window unchanged."""

    taps: Indices  # (tap) permutation of the taps
    classes: Indices  # (class) patches of the class classes[c] have the class c when they are read in this orientation


def turns_of(rule: ClassRule, window: Indices, allowed: Allowed = EVERY_ORIENTATION) -> list[Turn]:
    """Return the orientations from `stabilisers` as permutations of taps and classes, beginning with the identity."""
    return [
        Turn(orientations(rule.patch)[number], np.argsort(turned_classes(rule, number)))
        for number in stabilisers(window, rule.patch, allowed)
    ]


def turned_structures(rule: StructureRule, number: int) -> Indices:
    """Return, for each structure class, the class of its windows when they are read in orientation `number`.

    Only the direction of edges changes.
    """
    across, down = structure.turn_signs(orientations(3)[number])
    place = rule.split(np.arange(rule.classes_per_site))
    strength, within = np.divmod(place.kind - 1, 1 + DIRECTIONS)
    direction = DIRECTIONS // 2 - (within - 1) if across < 0 else within - 1  # index of the direction
    direction = (direction if down > 0 else -direction) % DIRECTIONS
    directed = (place.kind > 0) & (place.kind < rule.structures) & (within > 0)
    return np.asarray(rule.join(place.level, np.where(directed, 2 + strength * (1 + DIRECTIONS) + direction, place.kind)))
