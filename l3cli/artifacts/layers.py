"""The layers of a transform table: the first reads the mosaic, later ones the outputs of the layer before
(docs/method.md#layers)."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.plane_rules import GradientScale, StructureRule, TreeRule
from l3cli.artifacts.schema import check, data, group

PlaneRule = StructureRule | TreeRule
PLANE_STEP = 2.0**-18  # of the output unit: what a plane's integers count, far below the noise of any sensor
RATIO_TAPS = 2  # behind those of the windows, of a last layer that has them: chroma as shading would make it
PLANE_TOP = 2**22 - 1  # 16 times a full scale: differences times a factor of 7 bits stay within 32 bits


@dataclass(frozen=True)
class MosaicLayer:
    """Transforms of patches of the mosaic: output = weights · (patch − black level) / full scale + intercept."""

    rule: ClassRule = group()
    weights: NDArray[np.float32] = data(
        "float32", "class", "output", "tap", doc="taps row by row; per unit of (DN − black level) / full scale"
    )
    intercept: NDArray[np.float32] = data("float32", "class", "output", doc="added to the weighted sum")
    samples: NDArray[np.float64] = data("float64", "class", doc="training patches; 0: filled from a neighbour")
    condition: NDArray[np.float32] = data("float32", "class", doc="condition number of the class's equations; 0: none")

    def __post_init__(self) -> None:
        check(self)
        if self.weights.shape[2] != self.rule.patch**2:
            raise ValueError(f"weights has {self.weights.shape[2]} taps, the rule's patch {self.rule.patch**2}")

    def pictured(self) -> "MosaicLayer":
        """Return the layer of the first three outputs alone."""
        return replace(self, weights=self.weights[:, :3], intercept=self.intercept[:, :3])


@dataclass(frozen=True)
class PlaneLayer:
    """Transforms of square windows of the planes X − aY, Y, Z − bY (of a white: zero, its Y, zero) of the layer before."""

    side: int = data("int64", unit="pixel", doc="side of the windows")
    weights: NDArray[np.float32] = data(
        "float32",
        "plane_class",
        "output",
        "plane_tap",
        doc="taps plane by plane, each row by row, behind them the colour ratios' two if there are any; per output unit",
    )
    intercept: NDArray[np.float32] = data("float32", "plane_class", "output", doc="added to the weighted sum")
    samples: NDArray[np.float64] = data("float64", "plane_class", doc="training patches; 0: filled from a neighbour")
    structure: StructureRule | None = group(default=None)  # its classes, if by structure
    tree: TreeRule | None = group(default=None)  # its classes, if by a tree

    def __post_init__(self) -> None:
        check(self)
        one_rule(self.structure, self.tree)

    @property
    def rule(self) -> PlaneRule:
        return one_rule(self.structure, self.tree)

    @property
    def radius(self) -> int:
        return self.side // 2

    @property
    def window_taps(self) -> int:
        """Taps of the windows; what follows are those of the colour ratios (docs/method.md#colour-ratios)."""
        return self.weights.shape[1] * self.side**2

    @property
    def ratio_taps(self) -> int:
        """RATIO_TAPS or none."""
        return self.weights.shape[2] - self.window_taps

    def scaled_as(self, scale: GradientScale) -> "PlaneLayer":
        """Return the layer with gradients scaled so."""
        return replace(self, **rule_fields(self.rule.scaled_as(scale)))


def rule_fields(rule: PlaneRule) -> dict[str, Any]:
    """Return the rule as the field that holds it."""
    return {"structure" if isinstance(rule, StructureRule) else "tree": rule}


def one_rule(structure: StructureRule | None, tree: TreeRule | None) -> PlaneRule:
    """Return the rule that is there; ValueError unless it is one of the two."""
    if structure is None and tree is not None:
        return tree
    if structure is not None and tree is None:
        return structure
    raise ValueError("a layer has either a structure rule or a tree")
