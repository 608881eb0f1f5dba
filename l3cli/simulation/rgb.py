"""RGB pictures as spectra: the smoothest reflectances of their colours (docs/method.md#pictures-raised-to-spectra)."""

import functools

import numpy as np
from numpy.typing import NDArray

from l3cli.frames.scene import NO_ILLUMINANT, Scene
from l3cli.physics import spectra
from l3cli.physics.display import srgb_from_xyz_matrix
from l3cli.simulation.light import make_light, matching_weights
from l3cli.simulation.reflectances import DRAWN

Array = NDArray[np.floating]

EXACTNESS = 1e4  # weight of the colour equations against roughness


def raise_to_spectra(linear: NDArray[np.float32], wavelength: NDArray[np.float64], name: str) -> Scene:
    """Return the scene of a linear sRGB picture (row, col, 3): reflectance = red · R + green · G + blue · B.

    The three spectra are at least 0 and sum to 1 at every wavelength, so that values in 0…1 give reflectances in 0…1.
    `wavelength` (band) in nm are some of DRAWN and any beyond, where spectra are held.
    """
    cube = np.maximum(linear, np.float32(0.0)) @ primaries().astype(np.float32)
    if not np.array_equal(wavelength, DRAWN):  # taken of one product, so that every camera is shown the same values
        cube = cube[..., abs(np.subtract.outer(wavelength, DRAWN)).argmin(axis=1)]
    return Scene(name, wavelength, cube, NO_ILLUMINANT)


def shrunk(linear: NDArray[np.float32], by: int) -> NDArray[np.float32]:
    """Return a linear picture (row, col, 3) with each `by` × `by` pixels averaged to one; what is left over at the end is
    cut."""
    rows, cols = (length // by * by for length in linear.shape[:2])
    return linear[:rows, :cols].reshape(rows // by, by, cols // by, by, 3).mean(axis=(1, 3))


@functools.cache
def primaries() -> Array:
    """Return reflectances (3, band) at DRAWN whose colours under D65 are the sRGB primaries: the smoothest that are not
    negative and sum to 1 (after Mallett and Yuksel, "Spectral primary decomposition", 2019)."""
    from scipy.optimize import lsq_linear

    count = DRAWN.size
    rough = np.diff(np.eye(count), axis=0)
    light = make_light("D65", {}, DRAWN)
    observer = spectra.colour_matching_functions(light.wavelength)
    to_rgb = srgb_from_xyz_matrix() @ matching_weights(observer, light, DRAWN)
    rows = [
        np.kron(np.eye(3), rough),
        EXACTNESS * np.kron(np.eye(3), to_rgb),
        EXACTNESS * np.kron(np.ones(3), np.eye(count)),
    ]
    colours = np.eye(3) * to_rgb.sum(axis=1)  # a perfect white is (1, 1, 1) but for the grid's own error
    wanted = np.concatenate([np.zeros(3 * (count - 1)), EXACTNESS * colours.ravel(), EXACTNESS * np.ones(count)])
    solution = lsq_linear(np.concatenate(rows), wanted, bounds=(0.0, 1.0), tol=1e-12).x.reshape(3, count)
    return solution / solution.sum(axis=0)
