"""Frames that a filter in time has left less noise than their camera's: classes decide against what is left.

What a class rule compares with noise is scaled by the share of its variance that is left: contrasts and directions of a
mosaic, strengths of edges. So detail that noise would hide is told from flat areas again. Transforms stay as they were
learned.
"""

import itertools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.further_features import FurtherFeatures
from l3cli.artifacts.table import TransformTable
from l3cli.classes.features import further_features
from l3cli.frame import RawFrame
from l3cli.rendering.display import Display
from l3cli.rendering.renderer import Renderer, make_renderer


def quiet_table(table: TransformTable, share: float) -> TransformTable:
    """The table for frames with this share of the camera's noise variance. Trees stay as they are."""
    rule = table.first.rule
    axes = tuple(feature.quieter(axis, share) for feature, axis in further_features(rule))
    features = FurtherFeatures.of(axes) if axes else None
    first = replace(rule, contrast_edges=_scaled(rule.contrast_edges, share), features=features)
    later = tuple(
        layer
        if layer.structure is None
        else replace(
            layer, structure=replace(layer.structure, strength_edges=_scaled(layer.structure.strength_edges, share))
        )
        for layer in table.later
    )
    return replace(table, first=replace(table.first, rule=first), later=later)


def _scaled(edges: NDArray[np.uint32], share: float) -> NDArray[np.uint32]:
    """Edges (edge, …) times a share; they still increase."""
    least = np.arange(len(edges)).reshape(-1, *[1] * (edges.ndim - 1))
    return np.maximum(np.rint(edges * share), least).astype(np.uint32)


class QuietRenderer:
    """Renders each frame by the table for its share of noise; the table's own for a whole one."""

    def __init__(self, renderer: Renderer, make: Callable[[TransformTable], Renderer]) -> None:
        self.table, self._make = renderer.table, make
        self._renderers = {1.0: renderer}

    def _of(self, share: float) -> Renderer:
        if share not in self._renderers:
            self._renderers[share] = self._make(quiet_table(self.table, share))
        return self._renderers[share]

    def labels(self, frame: RawFrame, layer: int = 0) -> NDArray[np.integer]:
        """As Renderer."""
        return self._of(frame.noise_share).labels(frame, layer)

    def outputs(self, frame: RawFrame) -> NDArray[np.float32]:
        """As Renderer."""
        return self._of(frame.noise_share).outputs(frame)

    def picture(self, frame: RawFrame, display: Display) -> NDArray:
        """As Renderer."""
        return self._of(frame.noise_share).picture(frame, display)

    def pictures(self, frames: Iterable[tuple[RawFrame, Display]]) -> Iterator[NDArray]:
        """As Renderer; frames that follow one another with the same noise overlap on the device."""
        shared = ((frame.noise_share, (frame, display)) for frame, display in frames)
        for share, run in itertools.groupby(shared, key=itemgetter(0)):
            yield from self._of(share).pictures(each for _, each in run)


def quiet_renderer(backend: str, table: TransformTable, **options: str | None) -> QuietRenderer:
    """The renderer of a backend (renderer.make_renderer) that takes frames of any noise."""

    def make(table: TransformTable) -> Renderer:
        return make_renderer(backend, table, **options)

    return QuietRenderer(make(table), make)
