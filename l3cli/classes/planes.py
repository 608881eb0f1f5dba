"""The first layer in fixed point: planes whose integers are the same wherever they are computed (docs/method.md#layers).

    plane = clamp(Σ W · DN + B + 2^(F − 1) >> F, ±32767)

W and B are the layer's weights and intercept per DN and PLANE_STEP, times 2^F, rounded; F is the largest for which no sum of
any class and any DN leaves 32 bits.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.layers import PLANE_STEP, PLANE_TOP
from l3cli.classes.windows import Integers

MOST_FRACTION = 16


@dataclass(frozen=True)
class FixedPoint:
    """A layer's weights as integers."""

    weights: NDArray[np.int32]  # (class, output, tap)
    intercept: NDArray[np.int32]  # (class, output)
    fraction: int  # F

    def planes(self, sums: Integers) -> NDArray[np.int16]:
        """Planes of sums Σ W · DN + B."""
        rounded = (sums + (1 << self.fraction >> 1)) >> self.fraction
        return np.clip(rounded, -PLANE_TOP, PLANE_TOP).astype(np.int16)


def fixed_point(
    weights: NDArray[np.floating], intercept: NDArray[np.floating], black: float, white: float, bits: int
) -> FixedPoint:
    """`weights` (class, output, tap) and `intercept` (class, output) per share of full scale, as integers per DN."""
    per_dn = weights.astype(np.float64) / ((white - black) * PLANE_STEP)
    offset = intercept.astype(np.float64) / PLANE_STEP - black * per_dn.sum(axis=-1)
    largest = (np.abs(per_dn).sum(axis=-1) * (2**bits - 1) + np.abs(offset)).max()
    fraction = int(min(MOST_FRACTION, np.floor(np.log2((2.0**31 - 1) / (largest * 1.01 + 1)))))
    whole = np.rint(per_dn * 2.0**fraction)
    back = intercept.astype(np.float64) / PLANE_STEP * 2.0**fraction - black * whole.sum(axis=-1)
    return FixedPoint(whole.astype(np.int32), np.rint(back).astype(np.int32), fraction)
