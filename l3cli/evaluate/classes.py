"""Where a table errs: mean error by class of its rule, to see which classes are worst (docs/method.md#classes)."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import CHROMA_SCALE, LEVEL_FRACTION, ClassRule, TransformTable

Array = NDArray[np.floating]
LEAST_SHARE = 1e-3  # of all pixels that a class needs to be listed among the worst
LISTED = 10


class ClassErrors:
    """Sums of pixel errors by level, contrast and kind (chroma or saturation case), over the sites of the CFA."""

    def __init__(self, table: TransformTable, pipelines: tuple[str, ...]) -> None:
        self._rule, self._table = table.rule, table
        shape = (table.rule.levels, table.rule.contrasts, table.rule.kinds)
        self._pixels = np.zeros(shape, dtype=np.int64)
        self._sums = {name: np.zeros(shape) for name in pipelines}

    def add(self, labels: NDArray[np.integer], errors: dict[str, Array]) -> None:
        """Count a frame: class (row, col) of every pixel and the error (row, col) of every pipeline there."""
        within = labels.ravel() % self._rule.classes_per_site
        size, shape = self._rule.classes_per_site, self._pixels.shape
        self._pixels += np.bincount(within, minlength=size).reshape(shape)
        for name, error in errors.items():
            self._sums[name] += np.bincount(within, weights=error.ravel(), minlength=size).reshape(shape)

    def by_axis(self, figure: str) -> dict[str, list[dict[str, Any]]]:
        """Mean error, called `figure`, of the classes met along each axis: level, contrast, chroma, saturation."""
        rule, unsaturated = self._rule, slice(0, self._rule.chromas)
        levels = [self._entry(figure, _level(self._table, index), np.s_[index]) for index in range(rule.levels)]
        contrasts = [self._entry(figure, {"contrast": index}, np.s_[:, index]) for index in range(rule.contrasts)]
        chromas = [self._entry(figure, _chroma(self._table, index), np.s_[:, :, index]) for index in range(rule.chromas)]
        none = self._entry(figure, _case(self._table, 0), np.s_[:, :, unsaturated])
        others = [
            self._entry(figure, _case(self._table, case), np.s_[:, :, rule.chromas - 1 + case])
            for case in range(1, rule.cases)
        ]
        axes = {"level": levels, "contrast": contrasts, "chroma": chromas, "saturation": [none, *others]}
        return {axis: [entry for entry in entries if entry["pixels"]] for axis, entries in axes.items()}

    def worst(self, figure: str, pipeline: str) -> list[dict[str, Any]]:
        """The classes of the largest mean error of `pipeline` among those that hold a thousandth of the pixels or more."""
        pixels = np.maximum(self._pixels, 1)
        seen = self._pixels >= max(LEAST_SHARE * self._pixels.sum(), 1)
        mean = np.where(seen, self._sums[pipeline] / pixels, -1.0)
        found = []
        for flat in np.argsort(mean, axis=None, kind="stable")[::-1][: min(LISTED, int(seen.sum()))]:
            level, contrast, kind = np.unravel_index(flat, mean.shape)
            chromatic = kind < self._rule.chromas
            case = 0 if chromatic else int(kind) - self._rule.chromas + 1
            about = _level(self._table, int(level)) | {"contrast": int(contrast)}
            about |= {"chroma": int(kind) if chromatic else None, "case": case}
            found.append(self._entry(figure, about, (level, contrast, kind)))
        return found

    def _entry(self, figure: str, about: dict[str, Any], where: Any) -> dict[str, Any]:
        pixels = int(self._pixels[where].sum())
        means = {name: {figure: float(sums[where].sum()) / max(pixels, 1)} for name, sums in self._sums.items()}
        return {**about, "pixels": pixels, **means}


def _level(table: TransformTable, index: int) -> dict[str, Any]:
    """Number and bounds of a level, as shares of full scale; the first begins at 0, the last ends at 1."""
    edges = table.rule.level_edges / (2.0**LEVEL_FRACTION * len(table.channels)) * 2**table.rule.shift
    shares = np.clip((edges - table.black) / (table.white - table.black), 0.0, 1.0)
    bounds = [0.0, *shares.tolist(), 1.0]
    return {"level": index, "from": bounds[index], "to": bounds[index + 1]}


def _chroma(table: TransformTable, index: int) -> dict[str, Any]:
    """Number of a chroma and its centre as the channels' shares, read back from the rule's weights |q|² − 2 q."""
    return {"chroma": index, "shares": dict(zip(table.channels, chroma_centres(table.rule)[index].tolist(), strict=True))}


def chroma_centres(rule: ClassRule) -> Array:
    """Chroma centres q (chroma, channel), rows of sum 1, of the integer weights |q|² − 2 q; equal shares if there is one."""
    weights = rule.chroma_weights / CHROMA_SCALE
    channels = weights.shape[1]
    if rule.chromas == 1:
        return np.full((1, channels), 1.0 / channels)
    square = (weights.sum(axis=1, keepdims=True) + 2.0) / channels
    return np.clip((square - weights) / 2.0, 0.0, 1.0)


def _case(table: TransformTable, case: int) -> dict[str, Any]:
    """Number of a saturation case and the channels that all patterns sorted into it have saturated."""
    codes = np.flatnonzero(table.rule.case_of_code == case)
    common = int(np.bitwise_and.reduce(codes)) if codes.size else 0
    return {"case": case, "saturated": [name for bit, name in enumerate(table.channels) if common >> bit & 1]}
