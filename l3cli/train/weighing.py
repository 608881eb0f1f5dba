"""Row weights of the second pass: large perceived errors of the first one count less than their square (METHOD 4.4)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
DARKEST = 0.02  # of the level: darker targets are not judged more strictly
ERROR_FLOOR = 0.25  # ΔE², below which errors count alike
# What an error of f(X), f(Y), f(Z) is in L*, a*, b*; the chroma rows are halved and eased, as eyes forgive more of them.
LIGHTNESS, RED_GREEN, YELLOW_BLUE = 116.0, 250.0, 150.0


@dataclass(frozen=True)
class Judge:
    """Transforms of one site's classes from the first pass, in XYZ."""

    weights: Array  # (class, tap, output)
    intercept: Array  # (class, output)
    white: Array  # (output)

    def weight(self, clean: Array, variance: Array, target: Array, level: Array, label: NDArray[np.int64]) -> Array:
        """(e² + ¼)^(−¼) of each patch (patch): e is the Lab error expected of the first pass, bias and noise.

        `clean` and `variance` (patch, tap), `target` (patch, 3), `level` (patch), all in shares of full scale.
        """
        slope = np.maximum(target / level[:, None] / self.white, DARKEST) ** (-2 / 3) / 3 / self.white  # d f(t) / d XYZ
        bias, noise = np.empty_like(target), np.empty((len(target), 5))
        order = np.argsort(label, kind="stable")
        classes, start = np.unique(label[order], return_index=True)
        for index, members in zip(classes, np.split(order, start[1:]), strict=True):
            own = self.weights[index].astype(np.float32)
            bias[members] = clean[members] @ own + self.intercept[index] - target[members]
            products = np.stack([*(own**2).T, own[:, 0] * own[:, 1], own[:, 1] * own[:, 2]], axis=1)
            noise[members] = variance[members] @ products
        x, y, z = (slope * bias / level[:, None]).T
        error = (LIGHTNESS * y) ** 2 + (RED_GREEN * (x - y)) ** 2 + (YELLOW_BLUE * (y - z)) ** 2
        xx, yy, zz, xy, yz = (noise / level[:, None] ** 2).T
        sx, sy, sz = slope.T
        error += LIGHTNESS**2 * sy**2 * yy
        error += RED_GREEN**2 * (sx**2 * xx - 2 * sx * sy * xy + sy**2 * yy)
        error += YELLOW_BLUE**2 * (sy**2 * yy - 2 * sy * sz * yz + sz**2 * zz)
        return (error + ERROR_FLOOR) ** -0.25
