"""Symmetry of a colour filter array: sites whose neighbourhoods are rotations or mirror images share their training."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.int64]


@dataclass(frozen=True)
class SiteMap:
    """Where a site's training comes from: patch_of_site[permutation] is laid out like the canonical site's patch."""

    canonical: int  # site
    permutation: Indices  # (tap)


def orientations(patch: int) -> list[Indices]:
    """Tap permutations (tap) of the eight rotations and mirror images of a square patch, the identity first."""
    taps = np.arange(patch * patch).reshape(patch, patch)
    return [np.rot90(side, turns).ravel() for side in (taps, taps.T) for turns in range(4)]


def site_maps(channel: Indices, patch: int, shared: bool = True) -> list[SiteMap]:
    """For the windows (site, tap) of every site: the first site alike under some orientation (docs/method.md#symmetry), or
    itself unless training is `shared`."""
    maps: list[SiteMap] = []
    canonical: list[int] = []
    for site, window in enumerate(channel):
        found = next(
            (
                SiteMap(known, permutation)
                for known in (canonical if shared else ())
                for permutation in orientations(patch)
                if (window[permutation] == channel[known]).all()
            ),
            None,
        )
        if found is None:
            canonical.append(site)
            found = SiteMap(site, orientations(patch)[0])
        maps.append(found)
    return maps


def stabilisers(window: Indices, patch: int) -> list[Indices]:
    """The orientations that leave the layout of one window (tap) as it is."""
    return [permutation for permutation in orientations(patch) if (window[permutation] == window).all()]
