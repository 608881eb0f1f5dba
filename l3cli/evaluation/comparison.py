"""Cameras beside each other over the light on the scene: from which luminance on one of them is the better."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from l3cli.errors import InputFileError, RecipeError, suggestion
from l3cli.evaluation.evaluation import OURS, higher_is_better

LARGEST = 1e12  # of a figure, of a luminance in cd/m²


@dataclass(frozen=True)
class Curve:
    """A figure of one camera over luminances."""

    name: str
    luminance: tuple[float, ...]  # cd/m² of a perfect white, rising
    value: tuple[float, ...]


def curve_of(document: Mapping[str, Any], figure: str) -> Curve:
    """The mean of `figure` at each luminance, from a document of `l3 evaluate --json`; InputFileError if it lacks them,
    RecipeError if its frames have no figure of that name."""
    try:
        known = {name for frame in document["frames"] for name in frame[OURS]}
        if known and figure not in known:
            raise RecipeError(f'no figure "{figure}"; {suggestion(figure, sorted(known))}')
        by_luminance: dict[float, list[float]] = {}
        for frame in document["frames"]:
            by_luminance.setdefault(float(frame["luminance"]), []).append(float(frame[OURS][figure]))
        values = [value for at_one in by_luminance.values() for value in at_one]
        if not all(abs(value) <= LARGEST for value in values) or not all(0 < at <= LARGEST for at in by_luminance):
            raise ValueError("no number that a figure can be")
        rising = sorted(by_luminance)
        name = str(document["camera"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputFileError(f'no figure {figure} by luminance; give what "l3 evaluate --json" prints') from error
    return Curve(name, tuple(rising), tuple(float(np.mean(by_luminance[each])) for each in rising))


def require_comparable(curves: list[Curve]) -> None:
    """InputFileError unless all curves have the same luminances."""
    for other in curves[1:]:
        if other.luminance != curves[0].luminance:
            raise InputFileError(
                f"{curves[0].name} and {other.name} were evaluated at other luminances; simulate both alike"
            )


def crossings(one: Curve, other: Curve, figure: str) -> list[float]:
    """Luminances (cd/m²) at which the better of two curves changes, on a logarithmic scale between their points."""
    sign = 1.0 if higher_is_better(figure) else -1.0
    lead = sign * (np.array(one.value) - np.array(other.value))
    luminances = []
    for (at, before), (to, after) in pairwise(zip(np.log(one.luminance), lead, strict=True)):
        if before * after < 0:
            luminances.append(float(np.exp(at + (to - at) * before / (before - after))))
    return luminances
