"""Scene moments, what scenes are to any array behind a lens and pixel; and a design, arrays with their predicted errors."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.schema import Artifact, check, data, group

SHARP, SOFT = slice(0, 3), slice(3, 6)  # of targets: X, Y, Z; the same, blurred as an eye sees chroma
WEIGHTINGS = ("seen", "linear")
TIE = 0.02  # relative difference of errors that means nothing


@dataclass(frozen=True)
class LightMoments:
    """Second moments of patches and targets under one light, summed over all patches.

    A patch holds `terms` coefficients of each of its side × side taps, tap by tap; behind these stand the targets of its
    centre: X, Y, Z over those of white, the same blurred, and its coefficients before the lens.
    """

    illuminant: str = data("str", doc="name of the light")
    basis: NDArray[np.float64] = data(
        "float64", "wavelength", "term", unit="photons/s", doc="of a pixel and a step of the grid, white being 1 cd/m^2"
    )
    white_photons: NDArray[np.float64] = data(
        "float64", "wavelength", unit="photons/s", doc="the same of a perfect white of 1 cd/m^2"
    )
    lost: float = data("float64", doc="share of the power of spectra that the terms leave out")
    patches: NDArray[np.float64] = data("float64", "group", doc="patches of each group")
    weight: NDArray[np.float64] = data("float64", "weighting", "group", doc="sum of squared weights")
    mean: NDArray[np.float64] = data("float64", "weighting", "group", "coefficient", doc="weighted sum of coefficients")
    moment: NDArray[np.float64] = data(
        "float64", "weighting", "group", "entry", "entry", doc="weighted sum of products of coefficients and targets"
    )

    def __post_init__(self) -> None:
        check(self)
        entries = self.mean.shape[-1] + SOFT.stop + self.terms
        if self.moment.shape[-2:] != (entries, entries):
            raise ValueError("moments do not hold taps, targets and terms")
        if not (self.patches.min(initial=0) >= 0 and self.patches.sum() > 0 and 0 <= self.lost < 1):
            raise ValueError("moments are of no patches")

    @property
    def terms(self) -> int:
        return self.basis.shape[1]

    @property
    def share(self) -> NDArray[np.float64]:
        """Return the share (group) of the patches."""
        return np.asarray(self.patches / self.patches.sum())


@dataclass(frozen=True)
class SceneMoments(Artifact):
    """Second moments of scenes behind one lens and pixel, whatever its filters (docs/arrays.md#design)."""

    kind: ClassVar[str] = "scene moments"
    version: ClassVar[int] = 2
    made_by: ClassVar[str] = '"l3 design moments"'

    pixel_pitch: float = data("float64", unit="m", doc="distance of pixel centres")
    f_number: float = data("float64", doc="of the lens")
    side: int = data("int64", unit="pixel", doc="side of a patch")
    wavelength: NDArray[np.float64] = data("float64", "wavelength", unit="nm", doc="grid of filters")
    level_edge: NDArray[np.float64] = data(
        "float64", "level_edge", doc="of groups: mean luminance of 5x5 pixels over white", coordinate=True
    )
    contrast_edge: NDArray[np.float64] = data(
        "float64", "contrast_edge", doc="of groups: standard deviation of these over their mean", coordinate=True
    )
    weightings: tuple[str, ...] = data("str", "weighting", doc="seen: of a patch (Y + 0.02)^(-2/3); linear: 1")
    light: tuple[LightMoments, ...] = group()

    def __post_init__(self) -> None:
        super().__post_init__()
        groups = (self.level_edge.size + 1) * (self.contrast_edge.size + 1)
        taps = self.side**2
        for each in self.light:
            if each.patches.size != groups or each.mean.shape[-1] != taps * each.terms:
                raise ValueError("moments do not fit their groups or the side of a patch")
        if not (self.light and self.side % 2 and self.pixel_pitch > 0 and self.f_number > 0):
            raise ValueError("moments need a light, an odd side, a pixel and a lens")
        if self.weightings != WEIGHTINGS:
            raise ValueError(f"weightings are not {', '.join(WEIGHTINGS)}")

    @property
    def groups(self) -> tuple[str, ...]:
        """Return the names of the groups, in order."""
        levels = _named(self.level_edge, ("dark", "middle", "bright"))
        contrasts = _named(self.contrast_edge, ("plain", "texture", "edge"))
        return tuple(f"{level} {contrast}" for contrast in contrasts for level in levels)


def _named(edges: NDArray[np.float64], names: tuple[str, ...]) -> list[str]:
    return list(names) if len(edges) + 1 == len(names) else [f"{number + 1}" for number in range(len(edges) + 1)]


@dataclass(frozen=True)
class Tuned:
    """Filters of one array that were tuned."""

    pattern: str = data("str", doc="the array, rows of names")
    parameters: NDArray[np.float64] = data(
        "float64", "tuned_filter", "parameter", unit="nm, nm, 1", doc="centre, sigma and peak of each filter"
    )
    tuned_filters: tuple[str, ...] = data("str", "tuned_filter", doc="their names")
    tuned_efficiency: NDArray[np.float64] = data("float64", "filter", "wavelength", unit="e-/photon", doc="of all filters")
    before: NDArray[np.float64] = data("float64", "level", doc="predicted error with the given filters")
    after: NDArray[np.float64] = data("float64", "level", doc="with the tuned ones")
    bayer: NDArray[np.float64] = data("float64", "level", doc="of the best Bayer array of the tuned filters")
    ends: NDArray[np.float64] = data("float64", "start", doc="error over all levels that each start came to")


@dataclass(frozen=True)
class Truth:
    """Arrays that were trained and judged on the same unseen scenes."""

    trained: tuple[str, ...] = data("str", "trained", doc="arrays; (tuned): with tuned filters")
    expected: NDArray[np.float64] = data("float64", "trained", "level", doc="their predicted errors")
    figures: tuple[str, ...] = data("str", "figure", doc="mean_delta_e (CIEDE2000), scielab, output_psnr (dB)")
    measured: NDArray[np.float64] = data("float64", "trained", "level", "figure", doc="means over the scenes")
    crops: NDArray[np.uint8] = data(
        "uint8", "trained", "level", "crop_row", "crop_col", "rgb", doc="the middle of the first scene, sRGB codes"
    )
    ideals: NDArray[np.uint8] = data("uint8", "level", "crop_row", "crop_col", "rgb", doc="the same without any error")
    digest: str = data("str", doc="SHA-256 of what the scenes show, the same for all arrays")

    def correlation(self, level: int, figure: int = 0) -> float:
        """Return Spearman's rank correlation of predicted errors with a figure; of dB with errors relative to the peak."""
        expected, measured = (np.argsort(np.argsort(each)) for each in self._logarithms(level, figure))
        return float(np.corrcoef(expected, measured)[0, 1])

    def in_order(self, level: int, figure: int = 0) -> float:
        """Return the share of the pairs of arrays, of those that differ by more than TIE in predicted error and in a figure,
        that both order alike; NaN if there are none."""
        one, other = np.triu_indices(len(self.trained), 1)
        expected, measured = (each[one] - each[other] for each in self._logarithms(level, figure))
        differ = (np.abs(expected) > TIE) & (np.abs(measured) > TIE)
        return float((expected * measured > 0)[differ].mean()) if differ.any() else float("nan")

    def in_words(self, level: int, figure: int = 0) -> str:
        """Return both as a sentence's part."""
        share = self.in_order(level, figure)
        pairs = f", {share:.0%} of the pairs beyond {TIE:.0%} in order" if np.isfinite(share) else ""
        return f"{self.correlation(level, figure):.2f}{pairs}"

    def _logarithms(self, level: int, figure: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the logarithms (trained) of predicted and measured errors."""
        measured = self.measured[:, level, figure]
        of_decibels = -measured * (np.log(10) / 20)
        return np.log(self.expected[:, level]), of_decibels if self.figures[figure].endswith("psnr") else np.log(measured)


def overall(errors: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the geometric mean (…) of errors (…, level)."""
    return np.asarray(np.exp(np.log(np.maximum(errors, 1e-12)).mean(axis=-1)))


@dataclass(frozen=True)
class Design(Artifact):
    """Arrays of a library of filters, best first, with their predicted errors."""

    kind: ClassVar[str] = "design"
    version: ClassVar[int] = 2
    made_by: ClassVar[str] = '"l3 design"'

    name: str = data("str", doc="what the design is called")
    unit: str = data("str", doc="of errors")
    wavelength: NDArray[np.float64] = data("float64", "wavelength", unit="nm", doc="grid of filters")
    filters: tuple[str, ...] = data("str", "filter", doc="names of the library's filters")
    efficiency: NDArray[np.float64] = data(
        "float64", "filter", "wavelength", unit="e-/photon", doc="lens and pixel included"
    )
    levels: tuple[str, ...] = data("str", "level", doc="lights and exposures that arrays are judged at")
    groups: tuple[str, ...] = data("str", "group", doc="kinds of patches")
    share: NDArray[np.float64] = data("float64", "level", "group", doc="share of the patches")
    tried: int = data("int64", doc="arrays that were judged")
    patterns: tuple[str, ...] = data("str", "candidate", doc="arrays, best first: rows of names, divided by /")
    error: NDArray[np.float64] = data("float64", "candidate", "level", "group", doc="predicted error, mean over sites")
    dyes: NDArray[np.float64] = data(
        "float64", "candidate", "level", doc="predicted error of the best Bayer array of the same filters; 0: there is none"
    )
    bayer: int = data("int64", doc="place among the candidates of the best Bayer array of the library; -1: there is none")
    sensitivity: NDArray[np.float64] = data(
        "float64", "filter", doc="relative change of the best array's error if a filter lies 5 nm off, the larger of both"
    )
    dose: NDArray[np.float64] = data("float64", "dose", unit="cd s/m^2", doc="luminance of white x time", coordinate=True)
    mapped: tuple[str, ...] = data("str", "mapped", doc="arrays: the best, Bayer, the best of each level")
    map_error: NDArray[np.float64] = data("float64", "mapped", "dose", doc="predicted error under the first level's light")
    pixel: CameraModel | None = group(default=None)  # sensor, noise and lens; its array does not count
    tuned: Tuned | None = group(default=None)
    truth: Truth | None = group(default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.patterns and -1 <= self.bayer < len(self.patterns) and self.error.min(initial=0) >= 0):
            raise ValueError("a design holds arrays and errors from 0")

    @property
    def predicted(self) -> NDArray[np.float64]:
        """Return the predicted error (candidate, level), mean over patches."""
        return np.asarray(np.einsum("clg,lg->cl", self.error, self.share))

    @property
    def score(self) -> NDArray[np.float64]:
        """Return the predicted error (candidate) over all levels, their geometric mean."""
        return overall(self.predicted)

    @property
    def winner(self) -> tuple[str, NDArray[np.float64]]:
        """Return the best array, rows of names, and its filters (filter, wavelength): the tuned ones if they are better."""
        if self.tuned is not None and overall(self.tuned.after) < self.score[0]:
            return self.tuned.pattern, self.tuned.tuned_efficiency
        return self.patterns[0], self.efficiency

    @property
    def ties(self) -> NDArray[np.bool_]:
        """Return which arrays (candidate) beside the best are as good, within TIE."""
        return np.asarray((self.score <= self.score[0] * (1 + TIE)) & (np.arange(len(self.score)) > 0))

    @property
    def verdict(self) -> list[str]:
        """Return a sentence a level: what beats Bayer's array there, by how much, and how much of it the filters alone."""
        lines = []
        for place, level in enumerate(self.levels):
            errors = self.predicted[:, place]
            best = int(errors.argmin())
            if self.bayer < 0:
                lines.append(f"{level}: {self.patterns[best]}, {errors[best]:.2f} {self.unit}.")
                continue
            bayer, own = errors[self.bayer], self.dyes[best, place]
            if errors[best] > bayer * (1 - TIE):
                lines.append(f"{level}: nothing beats {self.patterns[self.bayer]} (Bayer) by more than {TIE:.0%}.")
                continue
            gain = f"{bayer - errors[best]:.2f} {self.unit} ({1 - errors[best] / bayer:.0%})"
            filters = min(max((bayer - own) / (bayer - errors[best]), 0), 1) if own else 0.0
            most = f"; its filters in Bayer's array make {filters:.0%} of that" if filters else ""
            lines.append(f"{level}: {self.patterns[best]} beats {self.patterns[self.bayer]} (Bayer) by {gain}{most}.")
        return lines

    @property
    def crossings(self) -> list[str]:
        """Return a sentence on each array of the map that Bayer's overtakes, or that overtakes it, as light grows."""
        if self.bayer < 0:
            return []
        bayer = self.map_error[self.mapped.index(self.patterns[self.bayer])]
        lines = []
        for name, errors in zip(self.mapped, self.map_error, strict=True):
            over = errors / bayer - 1
            sign = np.sign(over)
            for at in np.flatnonzero(sign[1:] * sign[:-1] < 0):
                if min(np.abs(over[: at + 1]).max(), np.abs(over[at + 1 :]).max()) < TIE:
                    continue
                below, above = (name, "Bayer") if sign[at] < 0 else ("Bayer", name)
                lines.append(f"Below {self.dose[at]:.2g}–{self.dose[at + 1]:.2g} cd s/m² {below}, above {above}.")
        return lines
