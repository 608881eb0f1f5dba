"""Solve the normal equations of each class.

If the transform of a class is too large for the planes' integer formats, it is computed again with a larger ridge
(docs/method.md#transforms-that-are-too-large).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from l3cli.artifacts.layers import PLANES
from l3cli.classes.planes import opponent_basis, room_between, room_for

Array = NDArray[np.float64]
MAX_RIDGE_STEPS = 5  # maximum number of tenfold increases of a ridge
EQUAL_RESPONSE_MARGIN = 4.0  # headroom factor for the correction that the equal-response constraint adds later
ROUNDING_MARGIN = 1.001  # headroom factor for the later rounding of transforms to float32


class Integers(NamedTuple):
    """Camera properties that determine the planes' integer formats."""

    bits: int
    black_level: float  # DN
    white_level: float  # DN


class Equations(NamedTuple):
    """Normal equations of several classes, for outputs with the same noise weight (docs/method.md#solution)."""

    power: Array  # (class, tap, tap) X Xᵀ; in saturated classes the last tap is the intercept
    noise: Array  # (class, tap) diagonal of the noise matrix Λ, without the intercept
    noise_weight: float
    right: Array  # (class, tap, column) right-hand sides: first X Yᵀ for each output, then 1 for the taps of each channel
    shared: Array | None = None  # (class, tap, tap) off-diagonal part of Λ from row and column noise, or None


def solve_within(equations: Equations, ridge: float, member: Array, integers: Integers | None) -> tuple[Array, Array]:
    """Solve the normal equations of all classes, so that the transforms fit the planes' integer formats.

    If a transform is too large, its class is solved again with a ten times larger ridge, up to `MAX_RIDGE_STEPS` times. The
    same applies if the correction that the equal-response constraint adds later could be too large.

    Parameters
    ----------
    equations : Equations
        Normal equations of the classes.
    ridge : float
        Initial ridge, relative to the mean power of a tap.
    member : ndarray, (channel, tap)
        1 if a tap belongs to a channel, otherwise 0.
    integers : Integers or None
        Camera properties that determine the integer formats, or None if transforms may have any size.

    Returns
    -------
    solutions : ndarray, (class, tap, column)
        One solution per column of `equations.right`.
    conditions : ndarray, (class)
        Condition number of each class.
    """
    solutions, conditions = np.empty_like(equations.right), np.empty(len(equations.right))
    left = np.arange(len(solutions))
    for step in range(MAX_RIDGE_STEPS + 1):
        systems = _systems(equations, left, ridge * 10**step)
        for index, system in zip(left.tolist(), systems, strict=True):
            solutions[index], conditions[index] = solve_positive(system, equations.right[index])
        if integers is None:
            break
        left = left[~_moderate(solutions[left], member, equations.noise.shape[1], integers)]
    return solutions, conditions


def fits(transforms: Array, white: Array, integers: Integers) -> NDArray[np.bool_]:
    """Whether each class's transform fits the planes' integer formats.

    Transforms with three outputs are first converted, so that they compute opponent planes. Transforms with more outputs are
    tested without conversion. This test is stricter, because no plane of such a table (`LeadingComponents`) is larger than
    the largest output relative to white.

    Parameters
    ----------
    transforms : ndarray, (class, tap + 1, output)
        The intercept is the last tap.
    white : ndarray, (output)
        Outputs of a perfect white.
    integers : Integers
        Camera properties that determine the integer formats.

    Returns
    -------
    ndarray of bool, (class)
    """
    planes = np.swapaxes(transforms @ opponent_basis(white) if len(white) == PLANES else transforms, 1, 2)
    return room_for(planes[..., :-1], planes[..., -1], *integers) > ROUNDING_MARGIN


def fits_between(transforms: Array) -> NDArray[np.bool_]:
    """Whether each transform of a refinement layer (class, tap + 1, plane) fits the planes' integer formats."""
    planes = np.swapaxes(transforms, 1, 2)
    return room_between(planes[..., :-1], planes[..., -1]) > ROUNDING_MARGIN


def _moderate(solutions: Array, member: Array, taps: int, integers: Integers) -> NDArray[np.bool_]:
    """Whether each class's transform leaves enough headroom in the integer formats for the equal-response constraint.

    Two things must still fit if multiplied by `EQUAL_RESPONSE_MARGIN`: the transform, and the correction that changes the
    response to one channel by 1.
    """
    outputs, used = solutions.shape[2] - len(member), member.any(axis=1)
    compliance = solutions[..., outputs:][..., used]
    bends = compliance @ np.linalg.pinv(member[used] @ compliance)
    changes = np.concatenate([solutions[..., :outputs], bends], axis=2).swapaxes(1, 2)
    return np.asarray(room_for(changes[..., :taps], changes[..., taps:].sum(axis=2), *integers) > EQUAL_RESPONSE_MARGIN)


def _systems(equations: Equations, chosen: NDArray[np.intp], ridge: float) -> Array:
    """Return the matrices X Xᵀ + noise_weight · Λ + ridge (class, tap, tap) for the chosen classes."""
    taps = equations.noise.shape[1]
    systems = equations.power[chosen]
    diagonal = np.einsum("cii->ci", systems)  # a view: changes to the diagonal also change `systems`
    diagonal[:, taps:] += 1e-9
    mean = diagonal[:, :taps].mean(axis=1, keepdims=True)
    diagonal[:, :taps] += equations.noise_weight * equations.noise[chosen] + ridge * mean + 1e-12
    if equations.shared is not None:
        systems[:, :taps, :taps] += equations.noise_weight * equations.shared[chosen]
    return systems


def solve_positive(system: Array, right: Array) -> tuple[Array, float]:
    """Solve a symmetric positive definite system by Cholesky decomposition.

    Parameters
    ----------
    system : ndarray, (row, row)
        Matrix of the system.
    right : ndarray, (row, column)
        Right-hand sides.

    Returns
    -------
    solution : ndarray, (row, column)
        One solution per right-hand side.
    condition : float
        Estimated condition number in the 1-norm.
    """
    factor, failed = lapack.dpotrf(system.T, lower=False)
    if failed:  # rounding errors made a nearly singular matrix indefinite
        return np.asarray(np.linalg.solve(system, right), np.float64), float(np.linalg.cond(system, 1))
    solution, _ = lapack.dpotrs(factor, right, lower=False)
    reciprocal, _ = lapack.dpocon(factor, np.abs(system).sum(axis=0).max(), uplo="U")
    return solution, 1.0 / max(reciprocal, 1e-30)
