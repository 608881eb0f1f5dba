"""Compute the weights of training samples in the second pass (docs/method.md#second-pass).

The larger a sample's error in the first pass, the lower its weight in the second pass. Without these weights, least squares
would mainly reduce the few largest errors.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.physics.display import XYZ
from l3cli.training.lines import SharedNoise

Floats = NDArray[np.float32]
MIN_TARGET = 0.02  # lower limit of the target in relative errors, as a fraction of the level
TARGET_FLOOR = 0.05  # fraction of the level added to a target's brightness (docs/method.md#sample-weights)
ERROR_FLOOR = 0.25  # squared error, in ΔE² or degrees², below which all samples have about the same weight
# Factors that convert errors of the cube roots of X, Y and Z to errors of L*, a* and b*. CIELAB uses 116, 500 and 200. The
# factors for a* and b* are lower here, because chroma errors are less visible.
LIGHTNESS, RED_GREEN, YELLOW_BLUE = 116.0, 250.0, 150.0
PRODUCTS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2))  # output pairs with noise covariances that affect the colour error


@dataclass(frozen=True)
class ColourWeighting:
    """Computes the weights of a canonical site's samples from their colour errors in the first pass."""

    weights: Floats  # (class, tap, output) transforms of the first pass
    products: Floats  # (class, tap, product) products XX, YY, ZZ, XY and YZ of the weights, for noise propagation
    intercept: Floats  # (class, output) intercepts of the first pass
    white: Floats  # (output) perfect white
    power: float  # the recipe key error_power

    def weight(
        self, clean: Floats, variance: Floats, target: Floats, level: Floats, runs: list[tuple[int, int, int]],
        shared: SharedNoise | None = None,
    ) -> Floats:  # fmt: skip
        """Compute the weight (e² + ¼)^(−power) of each patch.

        e² is the expected squared error of the first pass in CIELAB units: squared bias plus noise variance.

        Parameters
        ----------
        clean, variance : ndarray, (patch, tap)
            Noise-free signals as fractions of full scale, and the variance of their noise.
        target : ndarray, (patch, 3)
            Ideal X, Y and Z.
        level : ndarray, (patch)
            Level of each patch, as a fraction of full scale.
        runs : list of (class, first patch, end patch)
            Range of patches of each class, from `sums.runs_of`.
        shared : SharedNoise, optional
            Row and column noise, which is also included in `variance`. [default: the noise of all taps is independent]

        Returns
        -------
        ndarray, (patch)
        """
        relative = 1 / level[:, None]
        # derivatives of the cube roots of X/X_w, Y/Y_w and Z/Z_w
        slope = np.maximum(target * relative / self.white, MIN_TARGET) ** np.float32(-2 / 3) / (3 * self.white)
        bias, noise = np.empty_like(target), np.empty((len(target), 5), np.float32)
        for index, first, last in runs:
            bias[first:last] = clean[first:last] @ self.weights[index] + self.intercept[index]
            noise[first:last] = variance[first:last] @ self.products[index]
            if shared is not None:
                noise[first:last] += shared.of(first, last).propagated(self.weights[index], PRODUCTS)
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
    """Computes the weights of a canonical site's samples from their spectral angles in the first pass."""

    weights: Floats  # (class, tap, output) transforms of the first pass
    squares: Floats  # (class, tap) squared weights, summed over the outputs, for noise propagation
    intercept: Floats  # (class, output) intercepts of the first pass
    power: float  # the recipe key error_power

    def weight(
        self, clean: Floats, variance: Floats, target: Floats, level: Floats, runs: list[tuple[int, int, int]],
        shared: SharedNoise | None = None,
    ) -> Floats:  # fmt: skip
        """Compute the weight (e² + ¼)^(−power) of each patch.

        e² is the expected squared spectral angle, in degrees², between the noisy result of the first pass and the target.
        The parameters are the same as for `ColourWeighting.weight`, except that `target` has the shape (patch, output).
        """
        bias, noise = np.empty_like(target), np.empty_like(level)
        for index, first, last in runs:
            bias[first:last] = clean[first:last] @ self.weights[index] + self.intercept[index]
            noise[first:last] = variance[first:last] @ self.squares[index]
            if shared is not None:
                squares = [(output, output) for output in range(target.shape[1])]
                noise[first:last] += shared.of(first, last).propagated(self.weights[index], squares).sum(axis=1)
        bias -= target
        outputs = target.shape[1]
        size = np.maximum((target**2).sum(axis=1), outputs * (MIN_TARGET * level) ** 2)
        across = np.maximum((bias**2).sum(axis=1) - (bias * target).sum(axis=1) ** 2 / size, 0)
        error = (across + noise * np.float32(1 - 1 / outputs)) / size * np.float32(np.degrees(1) ** 2)
        return np.asarray((error + ERROR_FLOOR) ** np.float32(-self.power))


SampleWeighting = ColourWeighting | SpectralWeighting


def sample_weighting(table: TransformTable, site: int, power: float) -> SampleWeighting:
    """Prepare the second pass's weights for a canonical site's samples.

    Parameters
    ----------
    table : TransformTable
        Result of the first pass. Its outputs are X, Y, Z or a spectrum.
    site : int
        The canonical site.
    power : float
        The recipe key error_power.

    Returns
    -------
    ColourWeighting or SpectralWeighting
        ColourWeighting if the outputs are X, Y, Z.
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
    """Convert errors in X, Y and Z to squared CIELAB errors, with a reduced weight of chroma.

    Parameters
    ----------
    error, target : ndarray, (…, 3)
        Errors of X, Y, Z, and the ideal X, Y, Z.
    level : ndarray, (…)
        Level of each target, as a fraction of full scale.
    white : ndarray, (3,)
        X, Y, Z of a perfect white.

    Returns
    -------
    ndarray, (…)
    """
    relative = 1 / level[..., None]
    slope = np.maximum(target * relative / white, MIN_TARGET) ** np.float32(-2 / 3) / (3 * white)
    x, y, z = np.moveaxis(slope * error * relative, -1, 0)
    return np.asarray((LIGHTNESS * y) ** 2 + (RED_GREEN * (x - y)) ** 2 + (YELLOW_BLUE * (y - z)) ** 2)
