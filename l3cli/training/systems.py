"""The linear systems of the classes, and transforms that are too large to be of use (docs/method.md#too-large)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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


class Equation(NamedTuple):
    """The normal equations of a class for outputs that noise weighs alike."""

    power: Array  # (tap, tap) X Xᵀ, the intercept last if there is one
    noise: Array  # (tap) Λ, without the intercept
    factor: float  # of the noise
    right: Array  # (tap, output, then channel) Y Xᵀ, and which taps belong to a channel


def solve_within(equation: Equation, ridge: float, member: Array, integers: Integers | None) -> tuple[Array, float]:
    """The solution (tap, as `right`) and its condition number: with `ridge`, or, if transforms or what bends them to another
    response of the channels, whose taps `member` (channel, tap) tells, are too large, with the least of its multiples by
    ten that makes them small enough."""
    for step in range(STEPS + 1):
        system = _system(equation.power, equation.noise, equation.factor, ridge * 10**step)
        solution, condition = solve_positive(system, equation.right)
        if integers is None or _moderate(solution, member, len(equation.noise), integers):
            break
    return solution, condition


def fits(rows: Array, white: Array, integers: Integers) -> NDArray[np.bool_]:
    """Return whether the planes of transforms (class, tap and intercept, output) to X, Y, Z fit integers (class)."""
    planes = np.swapaxes(rows @ opponent_basis(white), 1, 2)
    return room_for(planes[..., :-1], planes[..., -1], *integers) > ROUNDED


def fits_between(rows: Array) -> NDArray[np.bool_]:
    """Return whether transforms (class, tap and intercept, plane) of planes to planes fit integers (class)."""
    planes = np.swapaxes(rows, 1, 2)
    return room_between(planes[..., :-1], planes[..., -1]) > ROUNDED


def _moderate(solution: Array, member: Array, taps: int, integers: Integers) -> bool:
    """Return whether transforms, and their change for a response that is one larger in a channel, fit SPARE times."""
    outputs = solution.shape[1] - len(member)
    used = member.any(axis=1)
    compliance = solution[:, outputs:][:, used]
    bends = compliance @ np.linalg.pinv(member[used] @ compliance)
    rows = np.concatenate([solution[:, :outputs], bends], axis=1).T
    intercept = rows[:, taps:].sum(axis=1)
    return bool(room_for(rows[None, :, :taps], intercept[None], *integers)[0] > SPARE)


def _system(power: Array, noise: Array, factor: float, ridge: float) -> Array:
    """X Xᵀ + factor · Λ + ridge over taps and, if `power` has it, the intercept."""
    taps = noise.size
    system = power.copy()
    diagonal = system.reshape(-1)[:: len(system) + 1]
    diagonal[taps:] += 1e-9
    diagonal[:taps] += factor * noise + ridge * diagonal[:taps].mean() + 1e-12
    return system


def solve_positive(system: Array, right: Array) -> tuple[Array, float]:
    """The solution of a symmetric positive system by Cholesky, and an estimate of its condition number (1-norm)."""
    from scipy.linalg import lapack

    factor, failed = lapack.dpotrf(system.T, lower=False)
    if failed:  # rounding has made a nearly singular system indefinite
        return np.asarray(np.linalg.solve(system, right), np.float64), float(np.linalg.cond(system, 1))
    solution, _ = lapack.dpotrs(factor, right, lower=False)
    reciprocal, _ = lapack.dpocon(factor, np.abs(system).sum(axis=0).max(), uplo="U")
    return solution, 1.0 / max(reciprocal, 1e-30)
