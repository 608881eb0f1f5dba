"""From sums to transforms: a Wiener solution for every class, thin classes shrunk, empty ones filled (METHOD 4)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import ClassRule
from l3cli.errors import L3Error
from l3cli.spectra import white_point
from l3cli.train.recipe import LearningRecipe
from l3cli.train.sums import Sums

Array = NDArray[np.float64]
NO_INTERCEPT = 1e12  # ridge that keeps the intercept at zero
CASE_SHARE = 0.1  # of the pseudo-patches come from all levels of a case


@dataclass(frozen=True)
class Transforms:
    """Transforms of the classes of one site, taps in units of full scale."""

    weights: Array  # (class, output, tap)
    intercept: Array  # (class, output)
    samples: Array  # (class) patches of its own; 0: filled


def solve(sums: Sums, rule: ClassRule, recipe: LearningRecipe, outputs: tuple[str, ...]) -> Transforms:
    """Transforms of every class of a site: T = Y Xᵀ (X Xᵀ + Λ)⁻¹, with neighbours' help where a class is thin.

    Raises L3Error if not one class has patches.
    """
    shape = (rule.levels, rule.contrasts, rule.cases)
    shrunk = _with_parents(_pooled(sums, shape, recipe.level_pool), shape, recipe.parent_patches)
    solvable = np.flatnonzero(shrunk.count > 0)
    if not solvable.size:
        raise L3Error("no class has training patches; simulate more frames")
    taps, count = sums.noise.shape[1], len(outputs)
    weights = np.zeros((len(sums.count), count, taps))
    intercept = np.zeros((len(sums.count), count))
    for index in solvable:
        case = index % rule.cases
        solution = _wiener(shrunk.moments[index], shrunk.noise[index], case > 0, recipe, outputs)
        weights[index], intercept[index] = solution[:taps].T, solution[taps]
    source = _nearest(shrunk.count > 0, shape)
    return Transforms(weights[source], intercept[source], sums.count)


def _pooled(sums: Sums, shape: tuple[int, int, int], pool: tuple[float, ...]) -> Sums:
    """Unsaturated classes with weighted sums of the levels beside them added; sums are relative to the level, so they
    add. The noise stays the class's own, scaled to the new number of patches."""
    levels = shape[0]
    moments = sums.moments.reshape(*shape, *sums.moments.shape[1:])
    count = sums.count.reshape(shape)
    pooled_moments, pooled_count = moments.copy(), count.copy()
    for distance, weight in enumerate(pool, start=1):
        for step in (-distance, distance):
            to = slice(max(0, -step), min(levels, levels - step))
            origin = slice(max(0, step), min(levels, levels + step))
            pooled_moments[to, :, 0] += weight * moments[origin, :, 0]
            pooled_count[to, :, 0] += weight * count[origin, :, 0]
    own = sums.count > 0
    flat_count = np.where(own, pooled_count.reshape(-1), 0.0)
    growth = np.divide(flat_count, sums.count, out=np.zeros_like(flat_count), where=own)
    flat_moments = pooled_moments.reshape(sums.moments.shape) * own[:, None, None]
    return Sums(flat_moments, sums.noise * growth[:, None], flat_count)


def _with_parents(sums: Sums, shape: tuple[int, int, int], pseudo_patches: int) -> Sums:
    """Every class with pseudo-patches of its (case, level) parent and, a few, of its case (METHOD 4.5)."""
    count = sums.count.reshape(shape)
    level_count, case_count = count.sum(axis=1), count.sum(axis=(0, 1))

    def shrunk(values: Array) -> Array:
        split = values.reshape(*shape, *values.shape[1:])
        level_sum = split.sum(axis=1)
        tail = (1,) * (values.ndim - 1)
        level_mean = level_sum / np.maximum(level_count, 1e-9).reshape(*level_count.shape, *tail)
        case_mean = level_sum.sum(axis=0) / np.maximum(case_count, 1e-9).reshape(*case_count.shape, *tail)
        parent = (1 - CASE_SHARE) * level_mean + CASE_SHARE * case_mean[None]
        return (split + pseudo_patches * parent[:, None]).reshape(values.shape)

    known = np.broadcast_to((level_count > 0)[:, None], shape).reshape(-1)
    total = np.where(known, sums.count + pseudo_patches, 0.0)
    if not pseudo_patches:
        return sums
    return Sums(shrunk(sums.moments), shrunk(sums.noise), total)


def _wiener(moments: Array, noise: Array, has_intercept: bool, recipe: LearningRecipe, outputs: tuple[str, ...]) -> Array:
    """(tap + 1, output): solves in a basis where luminance and chroma weigh noise differently (METHOD 4.3)."""
    taps = noise.size
    power, cross = moments[: taps + 1, : taps + 1], moments[: taps + 1, taps + 1 :]
    ridge = np.full(taps + 1, recipe.ridge * np.trace(power[:taps, :taps]) / taps + 1e-12)
    ridge[taps] = 1e-9 if has_intercept else NO_INTERCEPT
    basis = _opponent_basis(outputs)
    factors = [recipe.luminance_noise] * len(outputs)
    if outputs == ("X", "Y", "Z"):
        factors = [recipe.chroma_noise, recipe.luminance_noise, recipe.chroma_noise]
    cross = cross @ basis
    solution = np.empty_like(cross)
    for factor in sorted(set(factors)):
        columns = [index for index, own in enumerate(factors) if own == factor]
        system = power + np.diag(ridge + np.append(factor * noise, 0.0))
        solution[:, columns] = np.linalg.solve(system, cross[:, columns])
    return solution @ np.linalg.inv(basis)


def _opponent_basis(outputs: tuple[str, ...]) -> Array:
    """Columns X − X_w Y, Y, Z − Z_w Y for XYZ with the D65 white; the identity for other outputs."""
    basis = np.eye(len(outputs))
    if outputs == ("X", "Y", "Z"):
        white = white_point("D65")
        basis[1, 0], basis[1, 2] = -white[0], -white[2]
    return basis


def _nearest(filled: NDArray[np.bool_], shape: tuple[int, int, int]) -> NDArray[np.int64]:
    """For every class the filled class it takes its transform from: itself, else the same case at the nearest level and
    contrast, else the nearest of any case."""
    level, contrast, case = np.unravel_index(np.arange(filled.size), shape)
    known = np.flatnonzero(filled)
    source = np.arange(filled.size)
    for index in np.flatnonzero(~filled):
        far = np.abs(level[known] - level[index]) * shape[1] + np.abs(contrast[known] - contrast[index])
        far = far + (case[known] != case[index]) * filled.size
        source[index] = known[np.argmin(far)]
    return source
