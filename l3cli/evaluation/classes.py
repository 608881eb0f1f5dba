"""Mean error of a table by class of its rule, to see which classes are worst (docs/method.md#classes)."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.classes import chroma, contrast, level, saturation
from l3cli.classes.features import further_features

Array = NDArray[np.floating]
LEAST_SHARE = 1e-3  # of all pixels that a class needs to be listed among the worst
LISTED = 10


class ClassErrors:
    """Sums of pixel errors by level, contrast, further features and kind (chroma or saturation case), over all CFA sites."""

    def __init__(self, table: TransformTable, pipelines: tuple[str, ...]) -> None:
        self._rule, self._table = table.first.rule, table
        self._pixels = np.zeros(table.first.rule.shape, dtype=np.int64)
        self._sums = {name: np.zeros(table.first.rule.shape) for name in pipelines}

    def add(self, labels: NDArray[np.integer], errors: dict[str, Array]) -> None:
        """Count pixels of a frame: the class (…) of each and the error (…) of every pipeline there."""
        rule = self._rule
        within, classes = rule.within_site(labels.ravel()), rule.classes_per_site
        self._pixels += rule.by_axis(np.bincount(within, minlength=classes))[0]
        for name, error in errors.items():
            self._sums[name] += rule.by_axis(np.bincount(within, weights=error.ravel(), minlength=classes))[0]

    def by_axis(self, figure: str) -> dict[str, list[dict[str, Any]]]:
        """Return the mean error, called `figure`, of the classes met along each axis: level, contrast, chroma, saturation
        and further features."""
        table, rule = self._table, self._rule
        axes: dict[str, list[tuple[dict[str, Any], Any]]] = {
            "level": [(level.entry(table, index), np.s_[index]) for index in range(rule.levels)],
            "contrast": [(contrast.entry(table, index), np.s_[:, index]) for index in range(rule.contrasts)],
            "chroma": [(chroma.entry(table, index), np.s_[..., index]) for index in range(rule.chromas)],
            "saturation": [
                (saturation.entry(table, index), np.s_[..., rule.kinds_of(index)]) for index in range(rule.cases)
            ],
        }
        values = rule.split_further(np.arange(rule.further))
        for (feature, each), value in zip(further_features(rule), values, strict=True):
            axes[each.name] = [(feature.entry(table, index), np.s_[:, :, value == index]) for index in range(each.size)]
        every = {axis: [self._entry(figure, *about) for about in entries] for axis, entries in axes.items()}
        return {axis: [entry for entry in entries if entry["pixels"]] for axis, entries in every.items()}

    def worst(self, figure: str, pipeline: str) -> list[dict[str, Any]]:
        """Return the classes of the largest mean error of `pipeline` among those of at least a thousandth of the pixels."""
        pixels = np.maximum(self._pixels, 1)
        seen = self._pixels >= max(LEAST_SHARE * self._pixels.sum(), 1)
        mean = np.where(seen, self._sums[pipeline] / pixels, -1.0)
        entries = []
        for flat in np.argsort(mean, axis=None, kind="stable")[::-1][: min(LISTED, int(seen.sum()))]:
            place = self._rule.split(int(flat))
            case = int(self._rule.case(place.kind))
            about = level.entry(self._table, place.level) | contrast.entry(self._table, place.contrast)
            about |= {"chroma": None if case else place.kind, "case": case}
            values = self._rule.split_further(place.further)
            for (feature, _), value in zip(further_features(self._rule), values, strict=True):
                about |= feature.entry(self._table, value)
            entries.append(self._entry(figure, about, place[1:]))
        return entries

    def _entry(self, figure: str, about: dict[str, Any], where: Any) -> dict[str, Any]:
        pixels = int(self._pixels[where].sum())
        means = {name: {figure: float(sums[where].sum()) / max(pixels, 1)} for name, sums in self._sums.items()}
        return {**about, "pixels": pixels, **means}
