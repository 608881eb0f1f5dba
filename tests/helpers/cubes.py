"""Spectral cubes and files that contain them."""

from pathlib import Path

import numpy as np

from l3cli.physics import spectra

WAVELENGTH = np.arange(400.0, 701.0, 10.0)


def a_cube(shape: tuple[int, int] = (20, 24)) -> np.ndarray:
    """Return a random cube (row, col, wavelength)."""
    return np.random.default_rng(0).random((*shape, 31)).astype(np.float32)


def basis_file(path: Path, illuminant: object = None, mean: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Write a file of basis coefficients in the format of ISET's sceneToFile.

    Returns the photons (row, col, wavelength) and the illuminant (wavelength) that the file describes.
    """
    from scipy.io import savemat

    rng = np.random.default_rng(1)
    light = np.linspace(1.0, 2.0, 31) * 1e16
    basis, coefficients = rng.random((31, 4)), rng.random((20, 24, 4)) * 2e15
    average = rng.random(31) * 1e15 if mean else np.zeros(31)
    stored: dict[str, object] = {"mcCOEF": coefficients, "basis": {"basis": basis, "wave": WAVELENGTH}, "comment": "test"}
    if mean:
        stored["imgMean"] = average
    if illuminant == "photons":
        stored["illuminant"] = {"name": "D65", "data": {"photons": light}, "spectrum": {"wave": WAVELENGTH}}
    if illuminant == "energy":
        energy = light / spectra.photons_from_energy(WAVELENGTH, np.ones(31))
        stored["illuminant"] = {"data": energy, "wavelength": WAVELENGTH}
    savemat(path, stored)
    return coefficients @ basis.T + average, light
