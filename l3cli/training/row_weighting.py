"""Row weights of the second pass: large perceived errors count less than their square (docs/method.md#second-pass)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable

Floats = NDArray[np.float32]
DARKEST = 0.02  # of the level: darker targets are not judged more strictly
ERROR_FLOOR = 0.25  # ΔE², below which errors count alike
# What an error of f(X), f(Y), f(Z) is in L*, a*, b*; the chroma rows are halved and eased, as eyes forgive more of them.
LIGHTNESS, RED_GREEN, YELLOW_BLUE = 116.0, 250.0, 150.0


@dataclass(frozen=True)
class RowWeighting:
    """Transforms of one site's classes from the first pass, in XYZ."""

    weights: Floats  # (class, tap, output)
    products: Floats  # (class, tap, product) XX, YY, ZZ, XY, YZ of the weights: how noise of the taps adds up
    intercept: Floats  # (class, output)
    white: Floats  # (output)
    power: float  # of the weight

    def weight(
        self, clean: Floats, variance: Floats, target: Floats, level: Floats, runs: list[tuple[int, int, int]]
    ) -> Floats:
        """(e² + ¼)^(−power) of each patch (patch): e is the Lab error expected of the first pass, bias and noise.

        `clean` and `variance` (patch, tap), `target` (patch, 3), `level` (patch), all in shares of full scale; `runs` are
        class, first and last patch of the patches of each class.
        """
        relative = 1 / level[:, None]
        slope = np.maximum(target * relative / self.white, DARKEST) ** np.float32(-2 / 3) / (3 * self.white)  # d f / d XYZ
        bias, noise = np.empty_like(target), np.empty((len(target), 5), np.float32)
        for index, first, last in runs:
            bias[first:last] = clean[first:last] @ self.weights[index] + self.intercept[index]
            noise[first:last] = variance[first:last] @ self.products[index]
        x, y, z = (slope * (bias - target) * relative).T
        error = (LIGHTNESS * y) ** 2 + (RED_GREEN * (x - y)) ** 2 + (YELLOW_BLUE * (y - z)) ** 2
        xx, yy, zz, xy, yz = (noise * relative**2).T
        sx, sy, sz = slope.T
        error += LIGHTNESS**2 * sy**2 * yy
        error += RED_GREEN**2 * (sx**2 * xx - 2 * sx * sy * xy + sy**2 * yy)
        error += YELLOW_BLUE**2 * (sy**2 * yy - 2 * sy * sz * yz + sz**2 * zz)
        return (error + ERROR_FLOOR) ** np.float32(-self.power)


def row_weighting(table: TransformTable, site: int, power: float) -> RowWeighting:
    """The weighting of a canonical site from the first pass's table; its weights go with `power` of the squared error."""
    classes = table.first.rule.of_site(site)
    x, y, z = np.moveaxis(table.first.weights[classes], 1, 0)
    products = np.stack([x * x, y * y, z * z, x * y, y * z], axis=-1)
    weights = np.ascontiguousarray(np.swapaxes(table.first.weights[classes], 1, 2))
    return RowWeighting(weights, products, table.first.intercept[classes], table.white_point.astype(np.float32), power)


def lab_error(error: Floats, target: Floats, level: Floats, white: NDArray[np.floating]) -> Floats:
    """Squared Lab error (…), chroma halved and eased, of errors in XYZ (…, 3) about targets (…, 3) at levels (…)."""
    relative = 1 / level[..., None]
    slope = np.maximum(target * relative / white, DARKEST) ** np.float32(-2 / 3) / (3 * white)
    x, y, z = np.moveaxis(slope * error * relative, -1, 0)
    return np.asarray((LIGHTNESS * y) ** 2 + (RED_GREEN * (x - y)) ** 2 + (YELLOW_BLUE * (y - z)) ** 2)
