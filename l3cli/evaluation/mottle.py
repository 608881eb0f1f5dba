"""Noise in plain patches: blotches of colour, which means over all pixels hide, and all of it as the eye weighs it
(docs/method.md#quality-figures)."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
BLUR = 4.0  # pixels, σ of the Gaussian that leaves blotches and takes grain
CUT = 6  # pixels around a patch that do not belong to it: there edges have their say
EVEN = 1.0  # of L*, a* and b* of the target, from the least to the largest value that a plain window holds
LEAST = 24 * 24  # pixels of a patch
MOST = 64  # patches of a frame, the largest
DARK, WHITE, GREY = 30.0, 85.0, 10.0  # L* below and above which a patch is dark or white; C*ab below which it has no hue
HUES = ((-30.0, "red"), (60.0, "yellow"), (120.0, "green"), (200.0, "blue"))  # degrees from which on a patch is of a hue
VISUAL = np.array([1.0, 0.852, 0.323])  # weights of the standard deviations of L*, a*, b*: ISO 15739:2013, there of L*u*v*
KINDS = ("white", "grey", "dark", *(name for _, name in HUES))


class PlainPatches:
    """The patches of a target, CIELAB (row, col, 3) as displayed, that have one colour."""

    def __init__(self, target: Array) -> None:
        from scipy.ndimage import find_objects, label, maximum_filter1d, minimum_filter1d

        def extreme(of: Any) -> Array:
            window = 2 * CUT + 1
            return np.asarray(of(of(target, window, axis=0, mode="nearest"), window, axis=1, mode="nearest"))

        self._target = target
        numbers, _ = label((extreme(maximum_filter1d) - extreme(minimum_filter1d)).max(axis=2) <= EVEN)
        sizes = np.bincount(numbers.ravel())
        sizes[0] = 0
        largest = np.argsort(-sizes, kind="stable")[:MOST]
        places = find_objects(numbers)
        self._patches = [
            (places[number - 1], numbers[places[number - 1]] == number) for number in largest if sizes[number] >= LEAST
        ]

    @property
    def kinds(self) -> list[str]:
        """Return the kind of each patch."""
        return [kind_of(self._target[place][inside].mean(axis=0)) for place, inside in self._patches]

    def variances(self, shown: Array) -> Array:
        """Return the variance of a* and b* (patch), together, of a picture, CIELAB (row, col, 3) as displayed, after the
        blur, about the mean of each patch; what the target itself varies by is taken off before."""
        from scipy.ndimage import gaussian_filter

        found = []
        for place, inside in self._patches:
            error = (shown[place] - self._target[place])[..., 1:] * inside[..., None]
            weight = gaussian_filter(inside.astype(np.float64), BLUR)
            blurred = gaussian_filter(error, (BLUR, BLUR, 0))[inside] / weight[inside][:, None]
            found.append(blurred.var(axis=0).sum())
        return np.array(found)

    def visual_noise(self, seen: Array, wanted: Array) -> float | None:
        """Return the weighted standard deviations of CIELAB, mean over the patches, of a picture (row, col, 3) after the
        eye's blur, less the target after the same; None without a patch."""
        errors = [(seen[place] - wanted[place])[inside] for place, inside in self._patches]
        return float(np.mean([VISUAL @ each.std(axis=0) for each in errors])) if errors else None


def mottle(variances: Array) -> float | None:
    """Return the root mean square, over patches, of C*ab about their mean; None without a patch."""
    return float(np.sqrt(variances.mean())) if len(variances) else None


def kind_of(lab: Array) -> str:
    """Return the kind of a patch of the CIELAB (3)."""
    chroma, hue = float(np.hypot(lab[1], lab[2])), float(np.degrees(np.arctan2(lab[2], lab[1])))
    if lab[0] < DARK:
        return "dark"
    if chroma < GREY:
        return "white" if lab[0] >= WHITE else "grey"
    return [name for start, name in HUES if start <= (hue - HUES[0][0]) % 360 + HUES[0][0]][-1]
