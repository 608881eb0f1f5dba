"""The linear systems of the classes.

Transforms that would be too large for the integers of the planes get a larger ridge (docs/method.md#too-large-transforms).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from l3cli.artifacts.layers import PLANES
from l3cli.classes.planes import opponent_basis, room_between, room_for

Array = NDArray[np.float64]
MAX_RIDGE_STEPS = 5  # largest number of times that a ridge is raised tenfold
EQUAL_RESPONSE_MARGIN = 4.0  # margin for the equal response of sites, which changes the transforms afterwards
ROUNDING_MARGIN = 1.001  # margin for rounding, because transforms are stored as float32


class Integers(NamedTuple):
    """Parameters that determine the integer formats of the planes."""

    bits: int
    black_level: float  # DN
    white_level: float  # DN


class Equations(NamedTuple):
    """The normal equations of classes whose outputs share the weight of the noise."""

    power: Array  # (class, tap, tap) X Xᵀ; the last tap is the intercept, if there is one
    noise: Array  # (class, tap) diagonal of Λ, without the intercept
    noise_weight: float
    right: Array  # (class, tap, column) Y Xᵀ for each output, then the taps of each channel


def solve_within(equations: Equations, ridge: float, member: Array, integers: Integers | None) -> tuple[Array, Array]:
    """Solve the systems of all classes so that the transforms fit the integers of the planes.

    Parameters
    ----------
    equations : Equations
    ridge : float
        Relative ridge. It is raised by factors of ten, at most `MAX_RIDGE_STEPS` times, for classes whose transforms would
        be too large. So it is if the change that adapts a transform to another response of the channels would be too large.
    member : ndarray, (channel, tap)
        Which taps belong to each channel.
    integers : Integers or None
        The integer formats; None if any transform will do.

    Returns
    -------
    solutions : ndarray, (class, tap, column)
        Solutions for the columns of `equations.right`.
    conditions : ndarray, (class)
        Condition numbers of the systems.
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
    """Return which transforms make planes that fit the integers.

    Parameters
    ----------
    transforms : ndarray, (class, tap + 1, output)
        The intercept is the last tap.
    white : ndarray, (output)
        White of the table. Transforms to X, Y, Z are tested as the planes that they make. Other outputs are tested as they
        are, because they are larger than their components.
    integers : Integers

    Returns
    -------
    ndarray of bool, (class)
    """
    planes = np.swapaxes(transforms @ opponent_basis(white) if len(white) == PLANES else transforms, 1, 2)
    return room_for(planes[..., :-1], planes[..., -1], *integers) > ROUNDING_MARGIN


def fits_between(transforms: Array) -> NDArray[np.bool_]:
    """Return which transforms (class, tap + 1, plane) of planes fit the integers, as bool (class)."""
    planes = np.swapaxes(transforms, 1, 2)
    return room_between(planes[..., :-1], planes[..., -1]) > ROUNDING_MARGIN


def _moderate(solutions: Array, member: Array, taps: int, integers: Integers) -> NDArray[np.bool_]:
    """Return which transforms are smaller than the largest ones by the factor `EQUAL_RESPONSE_MARGIN`.

    The change for a response that is larger by one in a channel must be as small, too.
    """
    outputs, used = solutions.shape[2] - len(member), member.any(axis=1)
    compliance = solutions[..., outputs:][..., used]
    bends = compliance @ np.linalg.pinv(member[used] @ compliance)
    changes = np.concatenate([solutions[..., :outputs], bends], axis=2).swapaxes(1, 2)
    return np.asarray(room_for(changes[..., :taps], changes[..., taps:].sum(axis=2), *integers) > EQUAL_RESPONSE_MARGIN)


def _systems(equations: Equations, chosen: NDArray[np.intp], ridge: float) -> Array:
    """Return X Xᵀ + noise_weight · Λ + ridge of the chosen classes, (class, tap, tap), including any intercept."""
    taps = equations.noise.shape[1]
    systems = equations.power[chosen]
    diagonal = np.einsum("cii->ci", systems)  # a view: writes change the systems
    diagonal[:, taps:] += 1e-9
    mean = diagonal[:, :taps].mean(axis=1, keepdims=True)
    diagonal[:, :taps] += equations.noise_weight * equations.noise[chosen] + ridge * mean + 1e-12
    return systems


def solve_positive(system: Array, right: Array) -> tuple[Array, float]:
    """Solve a symmetric positive system by Cholesky; also estimate its condition number (1-norm)."""
    factor, failed = lapack.dpotrf(system.T, lower=False)
    if failed:  # rounding has made a nearly singular system indefinite
        return np.asarray(np.linalg.solve(system, right), np.float64), float(np.linalg.cond(system, 1))
    solution, _ = lapack.dpotrs(factor, right, lower=False)
    reciprocal, _ = lapack.dpocon(factor, np.abs(system).sum(axis=0).max(), uplo="U")
    return solution, 1.0 / max(reciprocal, 1e-30)
