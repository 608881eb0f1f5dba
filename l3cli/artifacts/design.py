"""Scene moments, which describe scenes independently of the array; and designs, arrays with their predicted errors."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.schema import Artifact, check, data, group
from l3cli.physics.mosaic import array_rows

SHARP, SOFT = slice(0, 3), slice(3, 6)  # targets: X, Y, Z, and X, Y, Z blurred as the eye blurs chroma
WEIGHTINGS = ("seen", "linear")
SIDE = 7  # pixels, side of the neighbourhood from which errors are predicted
KINDS = (("plain", "edge"), ("dark", "middle", "bright"), ("neutral", "orange", "green", "blue", "magenta"))
GROUPS = tuple(map(" ".join, itertools.product(*KINDS)))  # of patches, by contrast, level and hue of their centre
TIE = 0.02  # errors that differ by less than this fraction count as equal
Rows = tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]  # headings and rows of a table


@dataclass(frozen=True)
class LightMoments:
    """Second moments of patches and targets under one light, summed over all patches.

    The spectrum of each tap is given by `terms` coefficients. An entry of the moments is a coefficient of one of the SIDE ×
    SIDE taps (tap by tap), or one of the targets at the centre: X, Y, Z relative to white, the same blurred, and the
    coefficients of the scene in front of the lens.
    """

    illuminant: str = data("str", doc="name of the illuminant")
    basis: NDArray[np.float64] = data(
        "float64", "wavelength", "term", unit="photons/s", doc="basis of the spectra at a pixel, for white of 1 cd/m^2"
    )
    white_photons: NDArray[np.float64] = data(
        "float64", "wavelength", unit="photons/s", doc="photons per pixel from a perfect white of 1 cd/m^2"
    )
    patches: NDArray[np.float64] = data(
        "float64", "group", doc="number of patches in each group, by contrast, level and hue of the centre"
    )
    weight: NDArray[np.float64] = data(
        "float64", "weighting", "group", doc="sum of squared weights, (Y + 0.02)^(-4/3), or 1 for linear"
    )
    mean: NDArray[np.float64] = data("float64", "weighting", "group", "coefficient", doc="weighted sum of coefficients")
    moment: NDArray[np.float64] = data(
        "float64", "weighting", "group", "entry", "entry", doc="weighted second moments of coefficients and targets"
    )

    def __post_init__(self) -> None:
        check(self)
        entries = self.mean.shape[-1] + SOFT.stop + self.terms
        if self.moment.shape[-2:] != (entries, entries) or not self.patches.sum() > 0:
            raise ValueError("the shape of the moments does not fit their taps, targets and terms")

    @property
    def terms(self) -> int:
        return self.basis.shape[1]


@dataclass(frozen=True, repr=False)
class SceneMoments(Artifact):
    """Second moments of scenes behind a lens and a pixel, whatever the filters (docs/arrays.md#which-array)."""

    kind: ClassVar[str] = "scene moments"
    made_by: ClassVar[str] = '"l3 design moments"'

    pixel_pitch: float = data("float64", unit="m", doc="distance of pixel centres")
    f_number: float = data("float64", doc="f-number of the lens")
    wavelength: NDArray[np.float64] = data("float64", "wavelength", unit="nm", doc="wavelengths of the filter curves")
    light: tuple[LightMoments, ...] = group()

    def __post_init__(self) -> None:
        super().__post_init__()
        fit = [each.patches.size == len(GROUPS) and each.mean.shape[-1] == SIDE**2 * each.terms for each in self.light]
        if not (fit and all(fit) and self.pixel_pitch > 0 and self.f_number > 0):
            raise ValueError("the groups or patches of these moments are not those of this l3; gather the moments again")


@dataclass(frozen=True)
class Tuned:
    """One array whose filters were tuned, with the errors before and after."""

    pattern: str = data("str", doc="the array, as rows of filter names")
    parameters: NDArray[np.float64] = data(
        "float64", "tuned_filter", "parameter", unit="nm, nm, 1", doc="centre, sigma and peak of each filter"
    )
    tuned_filters: tuple[str, ...] = data("str", "tuned_filter", doc="names of the tuned filters")
    tuned_efficiency: NDArray[np.float64] = data(
        "float64", "filter", "wavelength", unit="e-/photon", doc="quantum efficiency of all filters after tuning"
    )
    before: NDArray[np.float64] = data("float64", "level", doc="predicted error with the given filters")
    after: NDArray[np.float64] = data("float64", "level", doc="predicted error with the tuned filters")
    bayer: NDArray[np.float64] = data(
        "float64", "level", doc="predicted error of the best Bayer array with the tuned filters"
    )

    def words(self, levels: Sequence[str]) -> list[str]:
        """Return one sentence on the tuned filters, and one per level on how much they reduce the error."""
        rows = zip(self.tuned_filters, self.parameters, strict=True)
        filters = ", ".join(
            f"{name} {centre:.0f} nm σ {sigma:.0f} nm peak {peak:.2f}" for name, (centre, sigma, peak) in rows
        )
        gains = zip(levels, self.before, self.after, self.bayer, strict=True)
        lines = [f"{level}: {old:.3f} → {new:.3f}; Bayer of the tuned filters {own:.3f}." for level, old, new, own in gains]
        return [f"filters of {self.pattern}, tuned: {filters}.", *lines]


@dataclass(frozen=True)
class Truth:
    """Arrays that were trained, rendered and evaluated on the same unseen scenes."""

    trained: tuple[str, ...] = data("str", "trained", doc="arrays that were trained; (tuned) marks tuned filters")
    expected: NDArray[np.float64] = data("float64", "trained", "level", doc="predicted error of each of these arrays")
    figures: tuple[str, ...] = data("str", "figure", doc="mean_delta_e (CIEDE2000), scielab, output_psnr (dB)")
    measured: NDArray[np.float64] = data(
        "float64", "trained", "level", "figure", doc="measured metrics, means over the scenes"
    )
    crops: NDArray[np.uint8] = data(
        "uint8", "trained", "level", "crop_row", "crop_col", "rgb", doc="crop from the middle of the first scene, sRGB codes"
    )
    ideals: NDArray[np.uint8] = data("uint8", "level", "crop_row", "crop_col", "rgb", doc="the same crop without error")
    digest: str = data("str", doc="SHA-256 of what the scenes show, the same for all arrays")

    def correlation(self, level: int, figure: int = 0) -> float:
        """Return Spearman's rank correlation of the predicted errors with a measured metric at a level.

        A metric in dB is converted to a relative error first.
        """
        expected, measured = (np.argsort(np.argsort(each)) for each in self._logarithms(level, figure))
        return float(np.corrcoef(expected, measured)[0, 1])

    def in_order(self, level: int, figure: int = 0) -> float:
        """Return the fraction of pairs of arrays that prediction and measurement rank alike.

        Only pairs that differ by more than TIE in both count. The result is NaN if there are none.
        """
        one, other = np.triu_indices(len(self.trained), 1)
        expected, measured = (each[one] - each[other] for each in self._logarithms(level, figure))
        differ = (np.abs(expected) > TIE) & (np.abs(measured) > TIE)
        return float((expected * measured > 0)[differ].mean()) if differ.any() else float("nan")

    def table(self, levels: Sequence[str]) -> Rows:
        """Return headings and rows that compare the predicted with the measured errors of the trained arrays."""
        headings = (*(f"{level}\n{what}" for level in levels for what in ("predicted", "ΔE00")), "array")
        both = np.stack([self.expected, self.measured[..., 0]], axis=-1).reshape(len(self.trained), -1)
        return headings, tuple(
            (*(f"{value:.2f}" for value in row), name) for name, row in zip(self.trained, both, strict=True)
        )

    def agreement(self, levels: Sequence[str]) -> list[str]:
        """Return one sentence per level on how well the prediction ranks the arrays, for each metric."""
        if len(self.trained) == 1:
            return ["One array has no rank."]
        lines = []
        for place, level in enumerate(levels):
            shares = [self.in_order(place, number) for number in range(len(self.figures))]
            pairs = [f" ({share:.0%})" if np.isfinite(share) else "" for share in shares]
            ranks = [f"{each} {self.correlation(place, n):.2f}{pairs[n]}" for n, each in enumerate(self.figures)]
            lines.append(f"{level}: rank correlation (pairs beyond {TIE:.0%} in order) {', '.join(ranks)}.")
        return lines

    def _logarithms(self, level: int, figure: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the logarithms (trained) of predicted and of measured errors."""
        measured = self.measured[:, level, figure]
        of_decibels = -measured * (np.log(10) / 20)
        return np.log(self.expected[:, level]), of_decibels if self.figures[figure].endswith("psnr") else np.log(measured)


def overall(errors: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the geometric mean (…) over the levels of errors (…, level)."""
    return np.asarray(np.exp(np.log(np.maximum(errors, 1e-12)).mean(axis=-1)))


@dataclass(frozen=True, repr=False)
class Design(Artifact):
    """Arrays that can be built from a library of filters, best first, with their predicted errors."""

    kind: ClassVar[str] = "design"
    made_by: ClassVar[str] = '"l3 design"'

    name: str = data("str", doc="name of the design")
    unit: str = data("str", doc="unit of the errors")
    wavelength: NDArray[np.float64] = data("float64", "wavelength", unit="nm", doc="wavelengths of the filter curves")
    filters: tuple[str, ...] = data("str", "filter", doc="names of the library's filters")
    efficiency: NDArray[np.float64] = data(
        "float64", "filter", "wavelength", unit="e-/photon", doc="quantum efficiency of each filter with pixel and lens"
    )
    levels: tuple[str, ...] = data("str", "level", doc="illuminants and exposures for which errors are predicted")
    groups: tuple[str, ...] = data("str", "group", doc="names of the groups of patches")
    share: NDArray[np.float64] = data("float64", "level", "group", doc="fraction of the patches in each group")
    tried: int = data("int64", doc="number of arrays whose error was predicted")
    patterns: tuple[str, ...] = data("str", "candidate", doc="arrays, best first, as rows of filter names separated by /")
    error: NDArray[np.float64] = data("float64", "candidate", "level", "group", doc="predicted error, as a mean over sites")
    dyes: NDArray[np.float64] = data(
        "float64",
        "candidate",
        "level",
        doc="predicted error of the best Bayer array with the same filters; 0 if there is none",
    )
    bayer: int = data("int64", doc="index of the best Bayer array among the candidates; -1 if there is none")
    sensitivity: NDArray[np.float64] = data(
        "float64", "filter", doc="relative change of the best array's error if the filter is shifted by 5 nm"
    )
    dose: NDArray[np.float64] = data(
        "float64", "dose", unit="cd s/m^2", doc="luminance of white × exposure time", coordinate=True
    )
    mapped: tuple[str, ...] = data("str", "mapped", doc="the best array, the Bayer array and the best array at each level")
    map_error: NDArray[np.float64] = data(
        "float64", "mapped", "dose", doc="predicted error under the illuminant of the first level"
    )
    pixel: CameraModel = group()  # sensor, noise and lens; its own array is not used
    tuned: Tuned | None = group(default=None)
    truth: Truth | None = group(default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.patterns and -1 <= self.bayer < len(self.patterns) and self.error.min(initial=0) >= 0):
            raise ValueError("a design needs arrays, and errors that are not negative")

    @property
    def summary(self) -> str:
        return f'"{self.name}", {self.tried} arrays of {", ".join(self.filters)}; best: {self.winner[0]}'

    @property
    def predicted(self) -> NDArray[np.float64]:
        """Predicted error (candidate, level), mean over patches."""
        return np.asarray(np.einsum("clg,lg->cl", self.error, self.share))

    @property
    def score(self) -> NDArray[np.float64]:
        """Predicted error (candidate), geometric mean over the levels."""
        return overall(self.predicted)

    @property
    def winner(self) -> tuple[str, NDArray[np.float64]]:
        """The best array, as rows of names, and its filters (filter, wavelength): the tuned ones if they are better."""
        if self.tuned is not None and overall(self.tuned.after) < self.score[0]:
            return self.tuned.pattern, self.tuned.tuned_efficiency
        return self.patterns[0], self.efficiency

    def best(self, most: int) -> list[int]:
        """Return the indices of the best arrays, at most `most`, and of the Bayer array."""
        return list(dict.fromkeys([*range(min(most, len(self.patterns))), *([self.bayer] if self.bayer >= 0 else [])]))

    @property
    def caption(self) -> str:
        """Caption of `table`."""
        ties = f"=: within {TIE:.0%} of the best"
        return f"{self.tried} arrays, predicted error ({self.unit}); {ties}; to Bayer of the same filters"

    def table(self, most: int) -> Rows:
        """Return headings and rows: the best arrays and the Bayer array, with ranks, errors and their change from Bayer.

        A rank marked "=" is a tie with the best. Changes compare an array with the best Bayer array of the same filters.
        """
        headings = ("", *self.levels, *(f"{level}\nto Bayer" for level in self.levels), "array")
        rows = []
        for place in self.best(most):
            tie = "=" if place > 0 and self.score[place] <= self.score[0] * (1 + TIE) else ""
            array = f"{self.patterns[place]}{' (Bayer)' if place == self.bayer else ''}"
            errors, own = self.predicted[place], self.dyes[place]
            changes = (f"{100 * (error / of - 1):+.1f} %" if of > 0 else "–" for error, of in zip(errors, own, strict=True))
            rows.append((f"{place + 1}{tie}", *(f"{error:.3f}" for error in errors), *changes, array))
        return headings, tuple(rows)

    @property
    def verdict(self) -> list[str]:
        """One sentence per level: which array beats the Bayer array, by how much, and which part is due to its filters."""
        lines = []
        for place, (level, errors) in enumerate(zip(self.levels, self.predicted.T, strict=True)):
            best, rival = int(errors.argmin()), self.patterns[self.bayer]
            least, bayer, own = errors[best], errors[self.bayer], self.dyes[best, place]
            if self.bayer < 0:
                lines.append(f"{level}: {self.patterns[best]}, {least:.2f} {self.unit}.")
            elif least > bayer * (1 - TIE):
                lines.append(f"{level}: nothing beats {rival} (Bayer) by more than {TIE:.0%}.")
            else:
                filters = min(max((bayer - own) / (bayer - least), 0), 1) if own else 0.0
                most = f"; its filters in Bayer's array make {filters:.0%} of that" if filters else ""
                gain = f"{bayer - least:.2f} {self.unit} ({1 - least / bayer:.0%})"
                lines.append(f"{level}: {self.patterns[best]} beats {rival} (Bayer) by {gain}{most}.")
        return lines

    @property
    def crossings(self) -> list[str]:
        """Sentences on the arrays that overtake the Bayer array, or are overtaken by it, as the light increases."""
        lines: list[str] = []
        bayer = self.map_error[[self.mapped.index(self.patterns[self.bayer])]] if self.bayer >= 0 else self.map_error
        for name, over in zip(self.mapped, self.map_error / bayer - 1, strict=True):
            for at in np.flatnonzero(over[1:] * over[:-1] < 0):
                if min(np.abs(over[: at + 1]).max(), np.abs(over[at + 1 :]).max()) >= TIE:
                    below, above = (name, "Bayer") if over[at] < 0 else ("Bayer", name)
                    lines.append(f"Below {self.dose[at]:.2g}–{self.dose[at + 1]:.2g} cd s/m² {below}, above {above}.")
        return lines

    def camera(self, pattern: str, efficiency: NDArray[np.float64]) -> CameraModel:
        """Return the camera with the design's pixel, an array given as text, and filters (filter, wavelength)."""
        cfa = sites(pattern, self.filters)
        used = np.unique(cfa)
        return replace(
            self.pixel,
            name=pattern,
            channels=tuple(self.filters[each] for each in used),
            cfa=np.searchsorted(used, cfa).astype(np.uint8),
            wavelength=self.wavelength,
            responsivity=efficiency[used],
            responsivity_band=np.zeros_like(efficiency[used]),
        )


def shown(cfa: NDArray[np.integer], names: Sequence[str]) -> str:
    """Return an array (row, col) of filter numbers as text: rows of names, separated by /."""
    return " / ".join(array_rows(names, cfa))


def sites(pattern: str, names: Sequence[str]) -> NDArray[np.intp]:
    """Return the array (row, col) of filter numbers that `shown` has written as text."""
    return np.array([[names.index(name) for name in row.split()] for row in pattern.split("/")])
