"""The layers of a transform table (docs/method.md#layers).

The first layer computes outputs from the mosaic. Each refinement layer computes outputs from the three opponent planes of
the previous layer's outputs.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.plane_rules import GradientScale, StructureRule, TreeRule
from l3cli.artifacts.schema import check, data, group

PlaneRule = StructureRule | TreeRule
PLANES = 3  # number of input planes of a refinement layer: X − aY, Y and Z − bY
PLANE_STEP = 2.0**-18  # quantisation step of planes in output units; it is far below the noise of any sensor
# Largest quantised value of a plane, which is 16 times full scale. A difference between two values, multiplied by a
# 7-bit factor, then fits into 32 bits.
PLANE_TOP = 2**22 - 1
# Allowed numbers of additional taps of the last layer: 0, 2 (colour ratios) or 4 (colour ratios and bilateral chroma).
RATIO_TAPS = (0, 2, 4)
COMPARED = (4, 3, 3)  # shape of `CoarseChroma.variance`: smoothing steps, planes, powers of luminance


@dataclass(frozen=True)
class MosaicLayer:
    """The first layer of a table. It computes the outputs of each pixel from the patch of the mosaic around the pixel.

    The outputs are weights · (patch − black level) / full scale + intercept, with the weights and the intercept of the
    pixel's class.
    """

    rule: ClassRule = group()
    weights: NDArray[np.float32] = data(
        "float32",
        "class",
        "output",
        "tap",
        doc="weights of the taps, row by row, for values of (DN − black level) / full scale",
    )
    intercept: NDArray[np.float32] = data(
        "float32", "class", "output", doc="constant that is added to the weighted sum of the taps"
    )
    samples: NDArray[np.float64] = data(
        "float64", "class", doc="number of training patches; 0: the class uses the transform of a similar class"
    )
    condition: NDArray[np.float32] = data(
        "float32", "class", doc="condition number of the equations; 0 if the class was not trained"
    )

    def __post_init__(self) -> None:
        check(self)
        if self.weights.shape[2] != self.rule.patch**2:
            raise ValueError(f"weights has {self.weights.shape[2]} taps, but the patch of the rule has {self.rule.patch**2}")

    def pictured(self, taken: list[int]) -> "MosaicLayer":
        """Return a copy of the layer with only the outputs whose indices are in `taken`."""
        return replace(self, weights=self.weights[:, taken], intercept=self.intercept[:, taken])


@dataclass(frozen=True)
class CoarseChroma:
    """Noise model for the smoothing of coarse chroma (docs/method.md#coarse-chroma).

    The last layer smooths coarse chroma over blocks of pixels, in several steps. In each step, the noise model determines
    whether two blocks differ by more than their noise.
    """

    variance: NDArray[np.float64] = data(
        "float64",
        "step",
        "plane",
        "power",
        doc="coefficients of the noise variance of the blocks that each step reads: at luminance Y, this variance is "
        "Σ variance · Y^power, in squared output units",
    )

    def __post_init__(self) -> None:
        check(self)
        if self.variance.shape != COMPARED:
            raise ValueError(f"variance has the shape {self.variance.shape}, but must have the shape {COMPARED}")
        if not (np.isfinite(self.variance).all() and self.variance.min() >= 0 and self.variance[..., 0].min() > 0):
            raise ValueError("variance must not be negative, and must be positive at luminance 0")

    def with_noise(self, share: float) -> "CoarseChroma":
        """Return the noise model for frames whose noise variance is multiplied by `share`."""
        return CoarseChroma(self.variance * share)


@dataclass(frozen=True)
class Clipping:
    """Response that renders uniform areas in which channels clip (docs/method.md#uniform-clipped-areas)."""

    response: NDArray[np.float64] = data(
        "float64",
        "clipped",
        "signal",
        "output",
        doc="response to the mean of each channel (fraction of full scale) and to a constant 1: first the response of all "
        "areas, then the change for each clipped channel",
    )
    white: NDArray[np.float64] = data(
        "float64",
        "channel",
        doc="signals of a perfect white with Y = 1 under the training illuminant, as fractions of full scale",
    )

    def __post_init__(self) -> None:
        check(self)
        if not self.white.min() > 0:
            raise ValueError("white must contain only positive values")
        if self.response.shape[:2] != (1 + self.white.size,) * 2 or not np.isfinite(self.response).all():
            raise ValueError(
                f"response has the shape {self.response.shape}; its first two axes must have the length "
                f"{1 + self.white.size}, which is the number of channels + 1, and its values must be finite"
            )


@dataclass(frozen=True)
class PlaneLayer:
    """A refinement layer. It computes the outputs of each pixel from square windows of three opponent planes.

    The planes are X − aY, Y and Z − bY, from the outputs X, Y, Z of the previous layer. The factors a and b are chosen so
    that the planes of a white object are (0, Y, 0).
    """

    side: int = data("int64", unit="pixel", doc="side of the windows")
    weights: NDArray[np.float32] = data(
        "float32",
        "plane_class",
        "output",
        "plane_tap",
        doc="weights of the taps: the planes one after the other, each row by row, then colour ratios and bilateral chroma "
        "if there are any; per output unit",
    )
    intercept: NDArray[np.float32] = data(
        "float32", "plane_class", "output", doc="constant that is added to the weighted sum of the taps"
    )
    samples: NDArray[np.float64] = data(
        "float64", "plane_class", doc="number of training patches; 0: the class uses the transform of a similar class"
    )
    structure: StructureRule | None = group(default=None)  # class rule with structures; None if the class rule is a tree
    tree: TreeRule | None = group(default=None)  # class rule with a decision tree; None if classes are structures
    coarse_chroma: CoarseChroma | None = group(default=None)  # None: chroma is computed only from the windows
    clipping: Clipping | None = group(default=None)  # requires coarse chroma; None: clipped areas are not smoothed

    def __post_init__(self) -> None:
        check(self)
        one_rule(self.structure, self.tree)
        if self.clipping and not self.coarse_chroma:
            raise ValueError("a layer with clipping must also have coarse_chroma")

    @property
    def rule(self) -> PlaneRule:
        """The class rule of the layer: `structure` or `tree`."""
        return one_rule(self.structure, self.tree)

    @property
    def radius(self) -> int:
        return self.side // 2

    @property
    def window_taps(self) -> int:
        """Number of taps in the windows of all planes. These taps come first in `weights`."""
        return PLANES * self.side**2

    @property
    def ratio_taps(self) -> int:
        """Number of taps for colour ratios and bilateral chroma, which is one of RATIO_TAPS."""
        return self.weights.shape[2] - self.window_taps

    def with_noise(self, share: float) -> "PlaneLayer":
        """Return the layer for frames whose noise variance is multiplied by `share`. Only coarse chroma changes."""
        return replace(self, coarse_chroma=self.coarse_chroma.with_noise(share)) if self.coarse_chroma else self

    def scaled_as(self, scale: GradientScale) -> "PlaneLayer":
        """Return a copy of the layer whose class rule uses the given scale of gradients."""
        return replace(self, **rule_fields(self.rule.scaled_as(scale)))


def rule_fields(rule: PlaneRule) -> dict[str, Any]:
    """Return a class rule as a keyword argument of PlaneLayer. The keyword is `structure` or `tree`, depending on the type
    of the rule."""
    return {"structure" if isinstance(rule, StructureRule) else "tree": rule}


def one_rule(structure: StructureRule | None, tree: TreeRule | None) -> PlaneRule:
    """Return the class rule that is not None.

    Raises
    ------
    ValueError
        If both are None, or if neither is None.
    """
    if structure is None and tree is not None:
        return tree
    if structure is not None and tree is None:
        return structure
    raise ValueError("a layer must have either a structure rule or a tree")
