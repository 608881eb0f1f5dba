"""Compares cameras at each scene luminance, and finds the luminance ranges in which each camera is better."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from l3cli.errors import InputFileError, RecipeError, suggestion
from l3cli.evaluation.evaluation import OURS
from l3cli.frames.scene import shown_alike
from l3cli.physics.figures import in_words, sign
from l3cli.system.text import short_names

MAX_METRIC = 1e12  # largest plausible metric, luminance (cd/m²) or exposure time (s)
CLIPPING = 0.05  # a camera clips if at least this fraction of pixels is at full scale; highlights usually cover less
OTHER_SCENES = (
    "the evaluations contain different scenes or illuminants and cannot be compared; "
    "simulate all training sets with the same scene recipe and seed"
)
UNKNOWN_SCENES = (
    "the scenes or illuminants of some frames are unknown, so the cameras may not be comparable; "
    "simulate the training sets again"
)


@dataclass(frozen=True)
class Curve:
    """A metric of one camera as a function of luminance."""

    name: str  # name of the camera
    luminance: tuple[float, ...]  # luminance of a perfect white in cd/m², in increasing order
    value: tuple[float, ...]  # metric at each luminance
    clipped: tuple[float, ...]  # fraction of pixels at full scale, at each luminance
    exposure: tuple[float, ...]  # longest exposure time in s, at each luminance


@dataclass(frozen=True)
class Comparison:
    """All metrics of several cameras as functions of luminance."""

    curves: dict[str, list[Curve]]  # metric → one curve per camera, in the order of the evaluations
    alike: bool | None  # whether all cameras were evaluated on the same scenes; None if unknown

    @property
    def cameras(self) -> list[Curve]:
        """Curves of the first metric, one per camera."""
        return next(iter(self.curves.values()))

    def sentences(self, figure: str) -> list[str]:
        """Describe at which luminances each camera of each pair is better in the metric `figure`.

        The result is empty if the scenes differ.
        """
        pairs = [] if self.alike is False else itertools.combinations(self.curves[figure], 2)
        return [verdict(one, other, figure) for one, other in pairs]

    @property
    def doubt(self) -> str | None:
        """Warning if comparing the cameras is impossible or doubtful, otherwise None."""
        return {False: OTHER_SCENES, None: UNKNOWN_SCENES}.get(self.alike) if len(self.cameras) > 1 else None

    @property
    def clipping(self) -> list[str]:
        """One sentence for each camera that clips, with the luminance at which clipping begins."""
        return list(filter(None, map(clipping, self.cameras)))

    def document(self) -> dict[str, Any]:
        """Return the comparison as a dictionary for JSON."""
        cameras = [
            {"camera": camera.name, "luminance": list(camera.luminance)}
            | {figure: list(curves[index].value) for figure, curves in self.curves.items()}
            for index, camera in enumerate(self.cameras)
        ]
        changes = [
            {"figure": figure, "one": one.name, "other": other.name, "luminances": tuple(crossings(one, other, figure))}
            for figure, curves in self.curves.items()
            for one, other in itertools.combinations(curves, 2)
        ]
        verdicts = [*itertools.chain(*map(self.sentences, self.curves)), *self.clipping]
        return {"curves": cameras, "crossings": changes, "same_scenes": self.alike, "verdicts": verdicts}


def curve_of(document: Mapping[str, Any], figure: str, file: Path) -> Curve:
    """Return a metric from an evaluation as a function of luminance. Frames with the same luminance are averaged.

    Parameters
    ----------
    document : mapping
        Content of a file from `l3 evaluate --json`.
    figure : str
        Key of the metric.
    file : Path
        File to name in error messages.

    Raises
    ------
    InputFileError
        If the document is not an evaluation of single frames, or if it contains implausible numbers.
    RecipeError
        If the evaluation does not contain the metric.
    """
    try:
        known = {name for frame in document["frames"] for name in frame[OURS]}
        if known and figure not in known:
            raise RecipeError(f'the metric "{figure}" is unknown; {suggestion(figure, sorted(known))}')
        by_luminance: dict[float, list[tuple[float, float, float]]] = {}
        for frame in document["frames"]:
            row = float(frame[OURS][figure]), float(frame["clipped"]), float(frame["exposure"])
            by_luminance.setdefault(float(frame["luminance"]), []).append(row)
        rows = [row for at_one in by_luminance.values() for row in at_one]
        sound = all(
            abs(value) <= MAX_METRIC and 0 <= clipped <= 1 and 0 < time <= MAX_METRIC for value, clipped, time in rows
        )
        if not sound or not all(0 < at <= MAX_METRIC for at in by_luminance):
            raise ValueError("implausible number")
        rising = sorted(by_luminance)
        name = str(document["camera"])
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise InputFileError(
            f'{file} does not contain the metric "{figure}" for each frame; use the output of "l3 evaluate --json"'
        ) from error
    value, clipped = (tuple(float(np.mean([row[part] for row in by_luminance[each]])) for each in rising) for part in (0, 1))
    exposure = tuple(max(time for _, _, time in by_luminance[each]) for each in rising)
    return Curve(name, tuple(rising), value, clipped, exposure)


def named_by_files(curves: list[Curve], files: tuple[Path, ...]) -> list[Curve]:
    """Make the camera names of curves unique by appending file names to duplicates."""
    names = [curve.name for curve in curves]
    return [
        curve if names.count(curve.name) == 1 else replace(curve, name=f"{curve.name} ({file.removesuffix('.json')})")
        for curve, file in zip(curves, short_names(files), strict=True)
    ]


def same_scenes(documents: Sequence[Mapping[str, Any]]) -> bool | None:
    """Whether all evaluations contain the same scenes under the same illuminants, or None if some are unknown.

    Raises InputFileError if a document is not from `l3 evaluate --json`.
    """
    try:
        first, *others = map(_shown, documents)
        if not all(itertools.chain(first.values(), *(other.values() for other in others))):
            return None
        return all(
            first.keys() == other.keys() and all(shown_alike(first[place], other[place]) for place in first)
            for other in others
        )
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise InputFileError(
            'an evaluation does not contain the scene and luminance of each frame; use the output of "l3 evaluate --json"'
        ) from error


def _shown(document: Mapping[str, Any]) -> dict[tuple[str, str, str], Any]:
    """Return the fingerprints of each frame's scene and illuminant, or None for frames without fingerprints.

    The keys are (scene, illuminant, luminance).
    """
    return {
        (str(frame.get("scene")), str(frame.get("illuminant")), f"{float(frame['luminance']):.6g}"): frame.get("shown")
        for frame in document["frames"]
    }


def require_comparable(curves: list[Curve]) -> None:
    """Raise InputFileError unless all curves have the same luminances."""
    for other in curves[1:]:
        if other.luminance != curves[0].luminance:
            raise InputFileError(
                f"{curves[0].name} and {other.name} were evaluated at different luminances; "
                "simulate both training sets with the same scene recipe"
            )


def crossings(one: Curve, other: Curve, figure: str) -> list[float]:
    """Return the luminances in cd/m² at which two curves of the metric `figure` cross.

    Between the measured luminances, the difference is interpolated over log luminance.
    """
    lead = sign(figure) * (np.array(one.value) - np.array(other.value))
    luminances = []
    for at, to in pairwise(np.flatnonzero(lead)):
        if lead[at] * lead[to] < 0:  # the curves cross in between
            to = min(to, at + 1) if lead[at + 1] == 0 else to
            share = lead[at] / (lead[at] - lead[to])
            low, high = np.log(one.luminance[at]), np.log(one.luminance[to])
            luminances.append(float(np.exp(low + (high - low) * share)))
    return luminances


def verdict(one: Curve, other: Curve, figure: str) -> str:
    """Describe the luminance ranges in which each of two cameras is better, and the largest difference."""
    lead = sign(figure) * (np.array(one.value) - np.array(other.value))
    if not lead.any():
        return f"{figure}: {one.name} and {other.name} are equal at every luminance."
    bounds = [0.0, *crossings(one, other, figure), np.inf]
    parts: list[str] = []
    for low, high in pairwise(bounds):
        inside = lead[(np.array(one.luminance) >= low) & (np.array(one.luminance) <= high)]
        most = inside[np.argmax(abs(inside))]
        better, worse = (one, other) if most > 0 else (other, one)
        than = "" if parts else f" is better than {worse.name}"
        parts.append(f"{better.name}{than} {_range(low, high)}, by up to {in_words(abs(most), figure)}")
    return f"{figure}: {'; '.join(parts)}."


def _range(low: float, high: float) -> str:
    if low == 0.0:
        return "at every luminance" if high == np.inf else f"below {high:.3g} cd/m²"
    return f"above {low:.3g} cd/m²" if high == np.inf else f"from {low:.3g} to {high:.3g} cd/m²"


def clipping(curve: Curve) -> str | None:
    """Describe above which luminance a camera clips, or return None if it does not clip at the highest luminance."""
    some = [share >= CLIPPING for share in curve.clipped]
    if not some[-1]:
        return None
    first = len(some) - next((index for index, clips in enumerate(reversed(some)) if not clips), len(some))
    times = set(curve.exposure[first:])
    at = f" at {_time(curve.exposure[first])}" if len(times) == 1 else ""
    share = f"{curve.clipped[-1]:.0%} of its pixels at {curve.luminance[-1]:g} cd/m²"
    return f"{curve.name} clips{at} from {curve.luminance[first]:g} cd/m² upwards: {share}."


def _time(seconds: float) -> str:
    """Format an exposure time, as a fraction such as 1/60 s if possible."""
    parts = round(1.0 / seconds)
    return f"1/{parts} s" if parts > 1 and abs(parts * seconds - 1.0) < 0.01 else f"{seconds:.3g} s"
