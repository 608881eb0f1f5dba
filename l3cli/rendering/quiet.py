"""Frames that a filter in time has left less noise than their camera's.

By a table with a quiet set (noise_sets.py) each pixel is rendered by the set that its noise asks for. By one of a single
set classes decide against what is left in the frame: what a class rule compares with noise is scaled by the share of its
variance, contrasts and directions of a mosaic, strengths of edges, so that detail that noise would hide is told from flat
areas again; transforms stay as they were learned.
"""

import itertools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.class_rule import FurtherFeatures
from l3cli.artifacts.table import TransformTable
from l3cli.classes.features import further_features
from l3cli.frames.frame import RawFrame
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
    return replace(table, first=replace(table.first, rule=first), later=later, quiet=None)


def _scaled(edges: NDArray[np.uint32], share: float) -> NDArray[np.uint32]:
    """Edges (edge, …) times a share; they still increase."""
    least = np.arange(len(edges)).reshape(-1, *[1] * (edges.ndim - 1))
    return np.maximum(np.rint(edges * share), least).astype(np.uint32)


class QuietRenderer:
    """Renders each frame by what its noise asks for: a frame of all its camera's noise by the table's usual set, as if there
    were no other; one that is filtered in time by both sets, pixel by pixel, or by the table for its share of noise where
    there is one set."""

    def __init__(self, renderer: Renderer, make: Callable[[TransformTable, bool], Renderer]) -> None:
        self.table, self._make = renderer.table, make
        self._renderers: dict[float | None, Renderer] = {1.0: renderer}  # by share of noise; None: by pixel

    def _of(self, share: float | None) -> Renderer:
        if share not in self._renderers:
            by_pixel = share is None
            self._renderers[share] = self._make(self.table if share is None else quiet_table(self.table, share), by_pixel)
        return self._renderers[share]

    def _share(self, frame: RawFrame) -> float | None:
        """By what a frame is rendered."""
        return None if self.table.quiet and frame.noise_left is not None else frame.noise_share

    def labels(self, frame: RawFrame, layer: int = 0) -> NDArray[np.integer]:
        """As Renderer."""
        return self._of(self._share(frame)).labels(frame, layer)

    def outputs(self, frame: RawFrame) -> NDArray[np.float32]:
        """As Renderer."""
        return self._of(self._share(frame)).outputs(frame)

    def picture(self, frame: RawFrame, display: Display) -> NDArray:
        """As Renderer."""
        return self._of(self._share(frame)).picture(frame, display)

    def pictures(self, frames: Iterable[tuple[RawFrame, Display]]) -> Iterator[NDArray]:
        """As Renderer; frames that follow one another with the same noise overlap on the device."""
        shared = ((self._share(frame), (frame, display)) for frame, display in frames)
        for share, run in itertools.groupby(shared, key=itemgetter(0)):
            yield from self._of(share).pictures(each for _, each in run)


def quiet_renderer(backend: str, table: TransformTable, **options: str | None) -> QuietRenderer:
    """The renderer of a backend (renderer.make_renderer) that takes frames of any noise."""

    def make(wanted: TransformTable, by_noise: bool) -> Renderer:
        return make_renderer(backend, wanted, by_noise, **options)

    return QuietRenderer(make(table, False), make)
