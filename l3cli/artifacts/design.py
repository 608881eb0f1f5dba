"""Artifacts for the design of colour filter arrays: scene moments and designs.

Scene moments contain statistics of scenes, and do not depend on the CFA. A design contains CFAs and their
predicted errors.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.schema import Artifact, check, data, group
from l3cli.physics.mosaic import array_rows

SHARP, SOFT = slice(0, 3), slice(3, 6)  # targets: X, Y, Z; and X, Y, Z whose chroma is blurred as in human vision
WEIGHTINGS = ("seen", "linear")  # weights of patches: as the eye perceives errors, or equal
SIDE = 7  # side of a patch in pixels; the predicted error is the error at its centre
KINDS = (("plain", "edge"), ("dark", "middle", "bright"), ("neutral", "orange", "green", "blue", "magenta"))
# names of the groups of patches: contrast of the patch, then brightness and hue of its centre
GROUPS = tuple(map(" ".join, itertools.product(*KINDS)))
TIE = 0.02  # errors that differ by less than this fraction count as equal
Rows = tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]  # a table for the terminal: its headings and its rows


@dataclass(frozen=True)
class LightMoments:
    """Weighted sums of products of the spectra and targets of patches under one illuminant, for each group of patches.

    The spectrum at each tap is described by `terms` coefficients. The entries of the moments are, in this order:

    1. the coefficients of the SIDE × SIDE taps, tap by tap;
    2. X, Y, Z at the centre, relative to white;
    3. X, Y, Z at the centre with blurred chroma, relative to white;
    4. the coefficients of the scene at the centre, without the blur of the lens.
    """

    illuminant: str = data("str", doc="name of the illuminant")
    basis: NDArray[np.float64] = data(
        "float64",
        "wavelength",
        "term",
        unit="photons/s",
        doc="basis of the photon spectra at a pixel, for a perfect white of 1 cd/m^2",
    )
    white_photons: NDArray[np.float64] = data(
        "float64", "wavelength", unit="photons/s", doc="photons per pixel from a perfect white of 1 cd/m^2"
    )
    patches: NDArray[np.float64] = data(
        "float64", "group", doc="number of patches in each group, by contrast, level and hue of the centre"
    )
    weight: NDArray[np.float64] = data(
        "float64",
        "weighting",
        "group",
        doc="sum of the squared weights of the patches: (Y + 0.02)^(-4/3), or 1 for the weighting linear",
    )
    mean: NDArray[np.float64] = data("float64", "weighting", "group", "coefficient", doc="weighted sum of coefficients")
    moment: NDArray[np.float64] = data(
        "float64", "weighting", "group", "entry", "entry", doc="weighted second moments of coefficients and targets"
    )

    def __post_init__(self) -> None:
        check(self)
        entries = self.mean.shape[-1] + SOFT.stop + self.terms
        if self.moment.shape[-2:] != (entries, entries) or not self.patches.sum() > 0:
            raise ValueError("the shape of the moments does not match the number of taps, targets and terms")

    @property
    def terms(self) -> int:
        return self.basis.shape[1]


@dataclass(frozen=True, repr=False)
class SceneMoments(Artifact):
    """Statistics of the light that scenes produce on pixels without filters (docs/arrays.md#which-array)."""

    kind: ClassVar[str] = "scene moments"
    made_by: ClassVar[str] = '"l3 design moments"'

    pixel_pitch: float = data("float64", unit="m", doc="distance between the centres of neighbouring pixels")
    f_number: float = data("float64", doc="f-number of the lens")
    wavelength: NDArray[np.float64] = data("float64", "wavelength", unit="nm", doc="wavelengths of the filter curves")
    light: tuple[LightMoments, ...] = group()

    def __post_init__(self) -> None:
        super().__post_init__()
        fit = [each.patches.size == len(GROUPS) and each.mean.shape[-1] == SIDE**2 * each.terms for each in self.light]
        if not (fit and all(fit) and self.pixel_pitch > 0 and self.f_number > 0):
            raise ValueError("a different version of l3 computed these scene moments; compute the moments again")


@dataclass(frozen=True)
class Tuned:
    """A CFA whose filters were optimised, with its predicted errors before and after this tuning."""

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
        """Describe the tuned filters in one line, followed by one line with the predicted errors for each light level.

        The line for a level contains the error before tuning, the error after tuning, and the error of the best Bayer CFA
        with the tuned filters.
        """
        rows = zip(self.tuned_filters, self.parameters, strict=True)
        filters = ", ".join(
            f"{name} {centre:.0f} nm σ {sigma:.0f} nm peak {peak:.2f}" for name, (centre, sigma, peak) in rows
        )
        gains = zip(levels, self.before, self.after, self.bayer, strict=True)
        lines = [
            f"{level}: {old:.3f} → {new:.3f}; Bayer array with the tuned filters: {own:.3f}."
            for level, old, new, own in gains
        ]
        return [f"tuned filters of {self.pattern}: {filters}.", *lines]


@dataclass(frozen=True)
class Truth:
    """Measured errors of CFAs, to verify the predictions.

    The CFAs were trained and then evaluated on the same scenes.
    """

    trained: tuple[str, ...] = data(
        "str", "trained", doc="names of the trained arrays; (tuned) marks an array with tuned filters"
    )
    expected: NDArray[np.float64] = data("float64", "trained", "level", doc="predicted error of each of these arrays")
    figures: tuple[str, ...] = data(
        "str", "figure", doc="names of the measured metrics: mean_delta_e (CIEDE2000), scielab, output_psnr (dB)"
    )
    measured: NDArray[np.float64] = data(
        "float64", "trained", "level", "figure", doc="measured metrics, averaged over the scenes"
    )
    crops: NDArray[np.uint8] = data(
        "uint8",
        "trained",
        "level",
        "crop_row",
        "crop_col",
        "rgb",
        doc="rendered crop from the middle of the first scene, as sRGB codes",
    )
    ideals: NDArray[np.uint8] = data(
        "uint8", "level", "crop_row", "crop_col", "rgb", doc="ideal picture of the same crop, as sRGB codes"
    )
    digest: str = data("str", doc="SHA-256 that identifies the content of the scenes, which is the same for all arrays")

    def correlation(self, level: int, figure: int = 0) -> float:
        """Return Spearman's rank correlation between the predicted errors and a measured metric.

        `level` and `figure` are the indices of the level and the metric. A metric in dB is first converted to an error.
        """
        expected, measured = (np.argsort(np.argsort(each)) for each in self._logarithms(level, figure))
        return float(np.corrcoef(expected, measured)[0, 1])

    def in_order(self, level: int, figure: int = 0) -> float:
        """Return the fraction of pairs of CFAs that the prediction and the measurement rank in the same order.

        Pairs are ignored unless both their predicted errors and their measured errors differ by more than TIE. If no pair
        is left, the result is NaN.
        """
        one, other = np.triu_indices(len(self.trained), 1)
        expected, measured = (each[one] - each[other] for each in self._logarithms(level, figure))
        differ = (np.abs(expected) > TIE) & (np.abs(measured) > TIE)
        return float((expected * measured > 0)[differ].mean()) if differ.any() else float("nan")

    def table(self, levels: Sequence[str]) -> Rows:
        """Return headings and rows of a table that compares the predicted and the measured errors of the trained CFAs."""
        headings = (*(f"{level}\n{what}" for level in levels for what in ("predicted", "ΔE00")), "array")
        both = np.stack([self.expected, self.measured[..., 0]], axis=-1).reshape(len(self.trained), -1)
        return headings, tuple(
            (*(f"{value:.2f}" for value in row), name) for name, row in zip(self.trained, both, strict=True)
        )

    def agreement(self, levels: Sequence[str]) -> list[str]:
        """Describe, in one line per level, how well the predicted errors rank the CFAs in each metric."""
        if len(self.trained) == 1:
            return ["A single array cannot be ranked."]
        lines = []
        for place, level in enumerate(levels):
            shares = [self.in_order(place, number) for number in range(len(self.figures))]
            pairs = [f" ({share:.0%})" if np.isfinite(share) else "" for share in shares]
            ranks = [f"{each} {self.correlation(place, n):.2f}{pairs[n]}" for n, each in enumerate(self.figures)]
            lines.append(
                f"{level}: rank correlation (and fraction of pairs in the right order, of the pairs that differ by more "
                f"than {TIE:.0%}): {', '.join(ranks)}."
            )
        return lines

    def _logarithms(self, level: int, figure: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        measured = self.measured[:, level, figure]
        of_decibels = -measured * (np.log(10) / 20)
        return np.log(self.expected[:, level]), of_decibels if self.figures[figure].endswith("psnr") else np.log(measured)


def overall(errors: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the geometric mean of errors over the last axis, which contains the levels."""
    return np.asarray(np.exp(np.log(np.maximum(errors, 1e-12)).mean(axis=-1)))


@dataclass(frozen=True, repr=False)
class Design(Artifact):
    """Colour filter arrays with filters from a library, and their predicted errors. The best CFA comes first."""

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
    mapped: tuple[str, ...] = data(
        "str", "mapped", doc="arrays in map_error: the best array, the best Bayer array, and the best array at each level"
    )
    map_error: NDArray[np.float64] = data(
        "float64", "mapped", "dose", doc="predicted error of these arrays under the illuminant of the first level"
    )
    pixel: CameraModel = group()  # camera model with the sensor, the noise and the lens; its CFA is not used
    tuned: Tuned | None = group(default=None)
    truth: Truth | None = group(default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.patterns and -1 <= self.bayer < len(self.patterns) and self.error.min(initial=0) >= 0):
            raise ValueError("a design must contain at least one array, and errors must not be negative")

    @property
    def summary(self) -> str:
        return f'"{self.name}", {self.tried} arrays of {", ".join(self.filters)}; best: {self.winner[0]}'

    @property
    def predicted(self) -> NDArray[np.float64]:
        """Predicted error of each CFA at each level, as the mean over all patches: (candidate, level)."""
        return np.asarray(np.einsum("clg,lg->cl", self.error, self.share))

    @property
    def score(self) -> NDArray[np.float64]:
        """Predicted error of each CFA, as the geometric mean over the levels."""
        return overall(self.predicted)

    @property
    def winner(self) -> tuple[str, NDArray[np.float64]]:
        """The best CFA, as rows of filter names, and the quantum efficiencies of all filters, (filter, wavelength).

        This is the tuned CFA if there is one and its error is lower than the error of the first CFA.
        """
        if self.tuned is not None and overall(self.tuned.after) < self.score[0]:
            return self.tuned.pattern, self.tuned.tuned_efficiency
        return self.patterns[0], self.efficiency

    def best(self, most: int) -> list[int]:
        """Return the indices of the first `most` CFAs, followed by the index of the best Bayer CFA, if there is one."""
        return list(dict.fromkeys([*range(min(most, len(self.patterns))), *([self.bayer] if self.bayer >= 0 else [])]))

    @property
    def caption(self) -> str:
        """Caption of the table of CFAs."""
        ties = f"=: at most {TIE:.0%} worse than the best array"
        return (
            f"predicted error ({self.unit}) of {self.tried} arrays; {ties}; changes are relative to the best Bayer array "
            "with the same filters"
        )

    def table(self, most: int) -> Rows:
        """Return headings and rows of a table of the first `most` CFAs and the best Bayer CFA.

        The columns are the rank, the predicted errors, their changes relative to the best Bayer CFA with the same filters,
        and the CFA. The mark "=" after a rank means that the CFA is at most TIE worse than the best CFA.
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
        """One sentence per level about the best CFA at this level.

        The sentence states how much lower the error of this CFA is than the error of the best Bayer CFA, and which
        fraction of the difference is due to the filters of the CFA.
        """
        lines = []
        for place, (level, errors) in enumerate(zip(self.levels, self.predicted.T, strict=True)):
            best, rival = int(errors.argmin()), self.patterns[self.bayer]
            least, bayer, own = errors[best], errors[self.bayer], self.dyes[best, place]
            if self.bayer < 0:
                lines.append(f"{level}: {self.patterns[best]}, {least:.2f} {self.unit}.")
            elif least > bayer * (1 - TIE):
                lines.append(f"{level}: no array has an error more than {TIE:.0%} below {rival} (Bayer).")
            else:
                filters = min(max((bayer - own) / (bayer - least), 0), 1) if own else 0.0
                most = f"; {filters:.0%} of this difference is due to its filters" if filters else ""
                gain = f"{bayer - least:.2f} {self.unit} ({1 - least / bayer:.0%})"
                lines.append(f"{level}: the error of {self.patterns[best]} is {gain} below {rival} (Bayer){most}.")
        return lines

    @property
    def crossings(self) -> list[str]:
        """Sentences with the exposures (cd s/m²) at which a CFA becomes better or worse than the best Bayer CFA."""
        lines: list[str] = []
        bayer = self.map_error[[self.mapped.index(self.patterns[self.bayer])]] if self.bayer >= 0 else self.map_error
        for name, over in zip(self.mapped, self.map_error / bayer - 1, strict=True):
            for at in np.flatnonzero(over[1:] * over[:-1] < 0):
                if min(np.abs(over[: at + 1]).max(), np.abs(over[at + 1 :]).max()) >= TIE:
                    below, above = (name, "Bayer") if over[at] < 0 else ("Bayer", name)
                    dose = f"{self.dose[at]:.2g}–{self.dose[at + 1]:.2g} cd s/m²"
                    lines.append(f"{below} is better below {dose}, and {above} is better above.")
        return lines

    def camera(self, pattern: str, efficiency: NDArray[np.float64]) -> CameraModel:
        """Return a camera with the pixel of this design and a given CFA.

        Parameters
        ----------
        pattern : str
            The CFA, as rows of filter names separated by "/".
        efficiency : ndarray, (filter, wavelength)
            Quantum efficiencies of all filters of the design, in e-/photon.
        """
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
    """Convert a CFA, (cfa_row, cfa_col) filter indices, to text: rows of filter names, separated by "/"."""
    return " / ".join(array_rows(names, cfa))


def sites(pattern: str, names: Sequence[str]) -> NDArray[np.intp]:
    """Convert text such as "g r / b g" to filter indices, (cfa_row, cfa_col). This is the inverse of `shown`."""
    return np.array([[names.index(name) for name in row.split()] for row in pattern.split("/")])
