"""Weights of the training samples in the second pass (docs/method.md#second-pass).

A sample whose error in the first pass was large gets a lower weight. Large errors, in colour or in the spectrum, therefore
count less than their square.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.physics.display import XYZ

Floats = NDArray[np.float32]
MIN_TARGET = 0.02  # fraction of the level; errors of darker targets are computed as if the targets had this brightness
TARGET_FLOOR = 0.05  # fraction of the level below which the weight no longer rises (docs/method.md#sample-weights)
ERROR_FLOOR = 0.25  # ΔE² or degrees²; samples with smaller errors have about the same weight
# Factors that convert errors of f(X), f(Y) and f(Z) to errors of L*, a* and b*. The factors for a* and b* are lower than the
# 500 and 200 of CIELAB, because errors of chroma are less visible.
LIGHTNESS, RED_GREEN, YELLOW_BLUE = 116.0, 250.0, 150.0


@dataclass(frozen=True)
class ColourWeighting:
    """Sample weights at one canonical site, from errors of the first pass in X, Y and Z."""

    weights: Floats  # (class, tap, output) transforms of the first pass
    products: Floats  # (class, tap, product) products XX, YY, ZZ, XY, YZ of the weights, to propagate the noise of the taps
    intercept: Floats  # (class, output) intercepts of the first pass
    white: Floats  # (output) perfect white
    power: float  # exponent of the squared error

    def weight(
        self, clean: Floats, variance: Floats, target: Floats, level: Floats, runs: list[tuple[int, int, int]]
    ) -> Floats:
        """Return the weight (e² + ¼)^(−power) of each patch.

        e² is the expected squared CIELAB error of the first pass, the sum of bias and noise.

        Parameters
        ----------
        clean, variance : ndarray, (patch, tap)
            Noise-free signals and noise variance, in fractions of full scale.
        target : ndarray, (patch, 3)
            X, Y and Z that the transforms should give.
        level : ndarray, (patch)
            Level of each patch, as a fraction of full scale.
        runs : list of (class, first patch, end patch)
            Runs of patches with the same class.

        Returns
        -------
        ndarray, (patch)
        """
        relative = 1 / level[:, None]
        slope = np.maximum(target * relative / self.white, MIN_TARGET) ** np.float32(-2 / 3) / (
            3 * self.white
        )  # d f / d XYZ
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


@dataclass(frozen=True)
class SpectralWeighting:
    """Sample weights at one canonical site, from errors of the first pass in a spectrum."""

    weights: Floats  # (class, tap, output) transforms of the first pass
    squares: Floats  # (class, tap) squared weights summed over the outputs, which propagate the noise of the taps
    intercept: Floats  # (class, output) intercepts of the first pass
    power: float  # exponent of the squared error

    def weight(
        self, clean: Floats, variance: Floats, target: Floats, level: Floats, runs: list[tuple[int, int, int]]
    ) -> Floats:
        """Return the weight (e² + ¼)^(−power) of each patch.

        e² is the expected square of the spectral angle in the first pass, in degrees², the sum of bias and noise. The
        parameters are the same as for `ColourWeighting.weight`, except that `target` is (patch, output).
        """
        bias, noise = np.empty_like(target), np.empty_like(level)
        for index, first, last in runs:
            bias[first:last] = clean[first:last] @ self.weights[index] + self.intercept[index]
            noise[first:last] = variance[first:last] @ self.squares[index]
        bias -= target
        outputs = target.shape[1]
        size = np.maximum((target**2).sum(axis=1), outputs * (MIN_TARGET * level) ** 2)
        across = np.maximum((bias**2).sum(axis=1) - (bias * target).sum(axis=1) ** 2 / size, 0)
        error = (across + noise * np.float32(1 - 1 / outputs)) / size * np.float32(np.degrees(1) ** 2)
        return np.asarray((error + ERROR_FLOOR) ** np.float32(-self.power))


SampleWeighting = ColourWeighting | SpectralWeighting


def sample_weighting(table: TransformTable, site: int, power: float) -> SampleWeighting:
    """Return the weighting for a canonical site from the table that the first pass has learned.

    Parameters
    ----------
    table : TransformTable
        Table with the outputs X, Y, Z or a spectrum.
    site : int
    power : float
        Exponent of the squared error.

    Returns
    -------
    ColourWeighting or SpectralWeighting
    """
    classes = table.first.rule.of_site(site)
    weights = np.ascontiguousarray(np.swapaxes(table.first.weights[classes], 1, 2))
    intercept = table.first.intercept[classes]
    if table.outputs != XYZ:
        return SpectralWeighting(weights, (weights**2).sum(axis=2), intercept, power)
    x, y, z = np.moveaxis(table.first.weights[classes], 1, 0)
    products = np.stack([x * x, y * y, z * z, x * y, y * z], axis=-1)
    return ColourWeighting(weights, products, intercept, table.white_point.astype(np.float32), power)


def lab_error(error: Floats, target: Floats, level: Floats, white: NDArray[np.floating]) -> Floats:
    """Return squared CIELAB errors (…) with reduced weight of chroma.

    Parameters
    ----------
    error, target : ndarray, (…, 3)
        Errors in X, Y, Z, and the targets that they refer to.
    level : ndarray, (…)
        Level of each target, as a fraction of full scale.
    white : ndarray, (3,)
        Perfect white.
    """
    relative = 1 / level[..., None]
    slope = np.maximum(target * relative / white, MIN_TARGET) ** np.float32(-2 / 3) / (3 * white)
    x, y, z = np.moveaxis(slope * error * relative, -1, 0)
    return np.asarray((LIGHTNESS * y) ** 2 + (RED_GREEN * (x - y)) ** 2 + (YELLOW_BLUE * (y - z)) ** 2)
