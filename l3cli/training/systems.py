"""The linear systems of the classes, and transforms that are too large to be of use (docs/method.md#too-large)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import PLANES
from l3cli.classes.planes import opponent_basis, room_between, room_for

Array = NDArray[np.float64]
STEPS = 5  # times that a ridge is raised tenfold, at most
SPARE = 4.0  # so much smaller than the largest that fit are transforms before sites are made to answer alike
ROUNDED = 1.001  # transforms are stored in float32


class Integers(NamedTuple):
    """Parameters that the integers of the planes follow from."""

    bits: int
    black_level: float  # DN
    white_level: float  # DN


class Equations(NamedTuple):
    """The normal equations of classes for outputs that noise weighs alike."""

    power: Array  # (class, tap, tap) X Xᵀ, the intercept last if there is one
    noise: Array  # (class, tap) Λ, without the intercept
    factor: float  # of the noise
    right: Array  # (class, tap, output, then channel) Y Xᵀ, and which taps belong to a channel


def solve_within(equations: Equations, ridge: float, member: Array, integers: Integers | None) -> tuple[Array, Array]:
    """Return the solutions (class, tap, as `right`) and their condition numbers (class): with `ridge`, or, if transforms or
    what bends them to another response of the channels, whose taps `member` (channel, tap) tells, are too large, with the
    least of its multiples by ten that makes them small enough."""
    solutions, conditions = np.empty_like(equations.right), np.empty(len(equations.right))
    left = np.arange(len(solutions))
    for step in range(STEPS + 1):
        systems = _systems(equations, left, ridge * 10**step)
        for index, system in zip(left.tolist(), systems, strict=True):
            solutions[index], conditions[index] = solve_positive(system, equations.right[index])
        if integers is None:
            break
        left = left[~_moderate(solutions[left], member, equations.noise.shape[1], integers)]
    return solutions, conditions


def fits(rows: Array, white: Array, integers: Integers) -> NDArray[np.bool_]:
    """Return whether the planes of transforms (class, tap and intercept, output) to X, Y, Z, or, as they are larger than
    their components, those to others, fit integers (class)."""
    planes = np.swapaxes(rows @ opponent_basis(white) if len(white) == PLANES else rows, 1, 2)
    return room_for(planes[..., :-1], planes[..., -1], *integers) > ROUNDED


def fits_between(rows: Array) -> NDArray[np.bool_]:
    """Return whether transforms (class, tap and intercept, plane) of planes to planes fit integers (class)."""
    planes = np.swapaxes(rows, 1, 2)
    return room_between(planes[..., :-1], planes[..., -1]) > ROUNDED


def _moderate(solutions: Array, member: Array, taps: int, integers: Integers) -> NDArray[np.bool_]:
    """Return whether transforms (class), and their change for a response one larger in a channel, fit SPARE times."""
    outputs, used = solutions.shape[2] - len(member), member.any(axis=1)
    compliance = solutions[..., outputs:][..., used]
    bends = compliance @ np.linalg.pinv(member[used] @ compliance)
    rows = np.concatenate([solutions[..., :outputs], bends], axis=2).swapaxes(1, 2)
    return np.asarray(room_for(rows[..., :taps], rows[..., taps:].sum(axis=2), *integers) > SPARE)


def _systems(equations: Equations, chosen: NDArray[np.intp], ridge: float) -> Array:
    """Return x Xᵀ + factor · Λ + ridge over taps and any intercept, of `chosen` classes (class, tap, tap)."""
    taps = equations.noise.shape[1]
    systems = equations.power[chosen]
    diagonal = np.einsum("cii->ci", systems)  # a view
    diagonal[:, taps:] += 1e-9
    mean = diagonal[:, :taps].mean(axis=1, keepdims=True)
    diagonal[:, :taps] += equations.factor * equations.noise[chosen] + ridge * mean + 1e-12
    return systems


def solve_positive(system: Array, right: Array) -> tuple[Array, float]:
    """Return the solution of a symmetric positive system by Cholesky, and an estimate of its condition number (1-norm)."""
    from scipy.linalg import lapack

    factor, failed = lapack.dpotrf(system.T, lower=False)
    if failed:  # rounding has made a nearly singular system indefinite
        return np.asarray(np.linalg.solve(system, right), np.float64), float(np.linalg.cond(system, 1))
    solution, _ = lapack.dpotrs(factor, right, lower=False)
    reciprocal, _ = lapack.dpocon(factor, np.abs(system).sum(axis=0).max(), uplo="U")
    return solution, 1.0 / max(reciprocal, 1e-30)
