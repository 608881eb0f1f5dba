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
PLANE_STEP = 2.0**-18  # quantisation step of planes in output units, far below the noise of any sensor
# Largest quantised plane value, 16 times full scale. The difference of two plane values, times a 7-bit factor, then fits
# into 32 bits.
PLANE_TOP = 2**22 - 1
# Numbers of extra taps that the last layer may have: 0, 2 (colour ratios) or 4 (colour ratios and bilateral chroma).
RATIO_TAPS = (0, 2, 4)
COMPARED = (4, 3, 3)  # shape of `CoarseChroma.variance`: smoothing steps, planes, powers of luminance


@dataclass(frozen=True)
class MosaicLayer:
    """The first layer of a table, which computes each pixel's outputs from the mosaic patch around the pixel.

    The outputs are weights · (patch − black level) / full scale + intercept. Weights and intercept depend on the pixel's
    class.
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
            raise ValueError(f"weights has {self.weights.shape[2]} taps, but the patch has {self.rule.patch**2} pixels")

    def pictured(self, taken: list[int]) -> "MosaicLayer":
        """Return the layer with a part of its outputs: those with the indices `taken`."""
        return replace(self, weights=self.weights[:, taken], intercept=self.intercept[:, taken])


@dataclass(frozen=True)
class CoarseChroma:
    """Noise model for coarse chroma smoothing (docs/method.md#coarse-chroma).

    The last layer smooths chroma over blocks of pixels, in several steps. In each step, the noise model determines whether
    two blocks differ by more than their noise.
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
            raise ValueError("variance must contain finite coefficients that are not negative, and positive constant terms")

    def with_noise(self, share: float) -> "CoarseChroma":
        """Return the noise model with all variances multiplied by `share`."""
        return CoarseChroma(self.variance * share)


@dataclass(frozen=True)
class Clipping:
    """Linear response for uniform areas in which channels clip (docs/method.md#uniform-clipped-areas)."""

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
    """A refinement layer, which computes each pixel's outputs from square windows of three opponent planes.

    The planes are X − aY, Y and Z − bY, where X, Y, Z are the outputs of the previous layer. The factors a and b are chosen
    so that white has the plane values (0, Y, 0).
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
    structure: StructureRule | None = group(default=None)  # None if the class rule is a decision tree
    tree: TreeRule | None = group(default=None)  # None if the class rule distinguishes structures
    coarse_chroma: CoarseChroma | None = group(default=None)  # None: chroma is computed only from the windows
    clipping: Clipping | None = group(default=None)  # requires coarse_chroma; None: clipped areas are not smoothed

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
        """Total number of taps in the windows of the three planes. Their weights come first in `weights`."""
        return PLANES * self.side**2

    @property
    def ratio_taps(self) -> int:
        """Number of extra taps for colour ratios and bilateral chroma, one of RATIO_TAPS."""
        return self.weights.shape[2] - self.window_taps

    def with_noise(self, share: float) -> "PlaneLayer":
        """Adapt the layer to frames with `share` times the noise variance. Only the coarse chroma's noise model changes."""
        return replace(self, coarse_chroma=self.coarse_chroma.with_noise(share)) if self.coarse_chroma else self

    def scaled_as(self, scale: GradientScale) -> "PlaneLayer":
        """Return the layer with a different gradient scale in its class rule."""
        return replace(self, **rule_fields(self.rule.scaled_as(scale)))


def rule_fields(rule: PlaneRule) -> dict[str, Any]:
    """Return the keyword argument, `structure` or `tree`, that passes a class rule to PlaneLayer."""
    return {"structure" if isinstance(rule, StructureRule) else "tree": rule}


def one_rule(structure: StructureRule | None, tree: TreeRule | None) -> PlaneRule:
    """Return whichever class rule is not None. Raises ValueError unless exactly one rule is set."""
    if structure is None and tree is not None:
        return tree
    if structure is not None and tree is None:
        return structure
    raise ValueError("a layer must have either a structure rule or a tree")
