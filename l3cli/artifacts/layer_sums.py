"""Sums of a layer that reads planes: what one shard of its pass has added up, per canonical site and class
(docs/method.md#layers)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.layers import RATIO_TAPS, PlaneRule, one_rule
from l3cli.artifacts.quiet_set import same_plane_classes
from l3cli.artifacts.schema import Artifact, check, data, group
from l3cli.artifacts.structure_rule import StructureRule
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.tree_rule import TreeRule


@dataclass(frozen=True)
class LayerSums:
    """Sums of one canonical site over its rows. A column is a tap, the intercept or an output of the opponent basis."""

    moments: NDArray[np.float64] = data(
        "float64", "plane_class", "plane_pair", doc="products of columns without noise: upper triangle, row by row"
    )
    noise: NDArray[np.float64] = data(
        "float64", "plane_class", "plane_tap_pair", doc="products of what noise adds to the taps: upper triangle, row by row"
    )
    count: NDArray[np.float64] = data("float64", "plane_class", doc="training rows")

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True)
class PartialLayerSums(Artifact):
    """Head of a file of a layer's partial sums; the sums lie in the groups sums/00000… in the order of `sites`, those of a
    quiet set in quiet_sums/00000….

    Its history ends with the training run that all shards belong to, so that shards of one run have equal histories.
    """

    kind: ClassVar[str] = "partial sums of a layer"
    version: ClassVar[int] = 4
    made_by: ClassVar[str] = '"l3 train --shard I/N"'

    shard: int = data("int64", doc="which part of the run this is, from 1 …")
    shards: int = data("int64", doc="… to this many")
    mosaics: NDArray[np.int64] = data("int64", "frame", doc="mosaics of every training frame, in all shards")
    side: int = data("int64", unit="pixel", doc="side of the windows")
    table: TransformTable = group()  # whose outputs the layer reads
    sites: NDArray[np.int64] = data(
        "int64", "canonical_site", doc="CFA sites that are trained, row · cfa columns + column", coordinate=True
    )
    structure: StructureRule | None = group(default=None)  # the layer's rule, if by structure
    tree: TreeRule | None = group(default=None)  # the layer's rule, if by a tree
    ratio_taps: int = data("int64", doc="taps behind those of the windows, of colour ratios", default=0)
    quiet_structure: StructureRule | None = group(default=None)  # the same of the quiet set, if the table has one
    quiet_tree: TreeRule | None = group(default=None)  # the same of the quiet set

    @property
    def rule(self) -> PlaneRule:
        return one_rule(self.structure, self.tree)

    @property
    def quiet_rule(self) -> PlaneRule | None:
        return one_rule(self.quiet_structure, self.quiet_tree) if self.table.quiet else None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.shard <= self.shards:
            raise ValueError(f"there is no shard {self.shard} of {self.shards}")
        if self.table.camera is None:
            raise ValueError("table must hold its camera")
        if self.ratio_taps not in (0, RATIO_TAPS):
            raise ValueError(f"ratio_taps is {self.ratio_taps}, neither 0 nor {RATIO_TAPS}")
        if self.side < 1 or self.side % 2 == 0:
            raise ValueError(f"side is {self.side}, not odd")
        below = self.table.first.rule
        if (len(self.rule.gradient_factor), self.rule.cases) != (below.levels, below.lost_cases):
            raise ValueError("rule has other levels or saturation cases than the table's first layer")
        if len(self.rule.turns) != self.table.cfa.size:
            raise ValueError(f"rule is for {len(self.rule.turns)} sites, the CFA has {self.table.cfa.size}")
        if self.quiet_rule and not same_plane_classes(self.quiet_rule, self.rule):
            raise ValueError("the quiet set's rule has other classes than the usual one")

    @property
    def shapes(self) -> tuple[tuple[int, int], tuple[int, int], tuple[int]]:
        """Return the shapes of moments, noise and count of every site."""
        classes, outputs = self.rule.classes_per_site, len(self.table.outputs)
        taps = outputs * self.side**2 + self.ratio_taps
        width = taps + 1 + outputs
        return (classes, width * (width + 1) // 2), (classes, taps * (taps + 1) // 2), (classes,)
