"""Share of a frame that a table has learned to render: measured on few pixels, so that it costs a millisecond or two."""

from dataclasses import dataclass

import numpy as np

from l3cli.artifacts.table import TransformTable
from l3cli.classes import level
from l3cli.classes.decide import label_patches
from l3cli.classes.windows import neighbourhoods
from l3cli.frames.frame import RawFrame
from l3cli.rendering.exposure import spread_patches


@dataclass(frozen=True)
class Coverage:
    """Shares of a frame's pixels, each counted once at most among the first three."""

    darker: float  # than every level that the table has patches of
    brighter: float
    untrained: float  # between those levels, in classes without patches of their own
    saturated: float  # clipped, or so near a clipped pixel that it decides the class


class CoverageMeter:
    """The coverage of frames by a table, from about 1500 pixels of one CFA site each (as LightMeter)."""

    def __init__(self, table: TransformTable) -> None:
        self._table = table
        self._near = neighbourhoods(table.cfa, table.first.rule.patch, len(table.channels))
        self._samples = table.first.rule.by_axis(table.first.samples)

    def coverage(self, frame: RawFrame) -> Coverage:
        """Return the coverage of a frame of any size and phase."""
        rule = self._table.first.rule
        patches, site = spread_patches(frame, self._table)
        labels = label_patches(patches.values, rule, self._near, site)
        place = rule.split(labels)
        learned = np.flatnonzero(self._samples[site].sum(axis=(1, 2, 3)) > 0)
        lowest, highest = (learned[0], learned[-1]) if learned.size else (0, rule.levels - 1)
        darker, brighter = place.level < lowest, place.level > highest
        untrained = (self._table.first.samples[rule.on_site(labels, site)] == 0) & ~darker & ~brighter
        saturated = rule.lost(place.kind) > 0
        return Coverage(*(float(np.mean(mask)) for mask in (darker, brighter, untrained, saturated)))

    def learned_range(self) -> tuple[float, float]:
        """The darkest and brightest level that the table has patches of, as shares of full scale."""
        table = self._table
        learned = np.flatnonzero(self._samples.sum(axis=(0, 2, 3, 4)) > 0)
        edges = np.concatenate([[0.0], level.inner_bounds(table.first.rule, table.black_level, table.white_level), [1.0]])
        return (float(edges[learned[0]]), float(edges[learned[-1] + 1])) if learned.size else (0.0, 1.0)
