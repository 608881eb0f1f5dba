"""Matrices between the channels of a camera and XYZ, fitted over surfaces with the white met exactly
(docs/method.md#colour-matrices)."""

import numpy as np
from numpy.typing import NDArray

from l3cli.physics.display import delta_e_2000, lab

PRECISION = 1e-3  # of the gradient of mean squares: more changes no figure


def fit_through(inputs: Array, outputs: Array, known: Array, answer: Array, noise: Array | float = 0.0) -> Array:
    """M (output, input) of least squares over surfaces of |outputs − M inputs|² for which M @ known = answer (by a Lagrange
    multiplier); inputs (surface, input), outputs (surface, output). `noise` (input): variances that the inputs have beside,
    which M is not to amplify."""
    gram = inputs.T @ inputs + len(inputs) * np.diag(np.broadcast_to(noise, inputs.shape[1:]))
    free = np.linalg.solve(gram, inputs.T @ outputs).T
    towards = np.linalg.solve(gram, known)
    return free + np.outer(answer - free @ known, towards / (known @ towards))


def colour_errors(xyz: Array, wanted: Array, white: Array) -> Array:
    """CIEDE2000 (surface) between XYZ (surface, 3) of one scale, relative to `white` (3)."""
    return delta_e_2000(lab(xyz, white), lab(wanted, white))


def refinement(xyz: Array, wanted: Array, white: Array) -> Array:
    """R (3, 3) that leaves `white` (3) as it is, for which the squares of CIEDE2000 between R @ xyz and `wanted`, both
    (surface, 3), are least near the unit matrix."""
    from scipy.optimize import minimize

    goal, free = lab(wanted, white), np.linalg.svd(white[None])[2][1:]  # directions (2, 3) that white has nothing of

    def turned(change: Array) -> Array:
        return np.eye(3) + change.reshape(3, 2) @ free

    def error(change: Array) -> float:  # of squares, since those are smooth where a surface is met
        return float(np.square(delta_e_2000(lab(xyz @ turned(change).T, white), goal)).mean())

    return turned(minimize(error, np.zeros(6), method="BFGS", options={"gtol": PRECISION}).x)
