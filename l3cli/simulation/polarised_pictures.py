"""Scenes from pictures behind a polariser, and from pictures of Stokes parameters (docs/polarisation.md#pictures-as-scenes).

S0 is converted to reflectances in the same way as ordinary pictures, and single-channel pictures become grey surfaces. In
colour pictures, S1/S0 and S2/S0 depend on the wavelength, because the three colours can be polarised differently.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.frames.scene import Polarisation, PolarisedPictures, Scene
from l3cli.physics.display import srgb_decoded
from l3cli.physics.stokes import fit_stokes
from l3cli.simulation import sources
from l3cli.simulation.reflectances import DRAWN, primaries, raise_to_spectra, shrunk

Floats = NDArray[np.float32]

# Wavelengths in nm at which the polarisation of colour pictures is sampled. Interpolation changes S1 and S2 by less than
# 0.3 % of S0 (RMS), even if the polarisations of the colours are unrelated.
NODES = np.arange(450.0, 651.0, 20.0)
BLOCK = 16  # side in pixels of the blocks over which residuals of Malus's law are averaged to reduce the noise
CONTRADICTION = 0.01  # l3 warns if `StokesPicture.contradiction` is larger; photos from good cameras reach 0.004
NOISE_LIMIT = 3.0  # smaller residuals of Malus's law, in standard deviations of the noise, count as noise
ROUNDING = 1e-4  # rounding tolerance for degrees of polarisation above 1


@dataclass(frozen=True)
class StokesPicture:
    """Linear pictures of S0, S1 and S2, where an S0 of 1 is white."""

    stokes: Floats  # (3, row, col, colour) with 1 or 3 colours; the degree of polarisation is at most 1
    contradiction: float  # RMS residual of Malus's law, relative to the mean intensity; 0 if noise explains it
    impossible: float  # fraction of the pixels with a degree of polarisation above 1 before it was limited


def stokes_of_pictures(content: PolarisedPictures, source: sources.PolarisedPictures) -> StokesPicture:
    """Compute Stokes parameters from the pictures of a source.

    Raises
    ------
    ValueError
        If the values contradict the recipe, or if the value of white is unknown.
    """
    values = content.values
    if getattr(source, "holds", "linear") == "sRGB":
        if values.dtype not in (np.uint8, np.uint16):
            raise ValueError(
                f'holds = "sRGB" needs 8-bit or 16-bit integers, but the values are {values.dtype}; remove holds'
            )
        levels = srgb_decoded(np.arange(np.iinfo(values.dtype).max + 1) / np.iinfo(values.dtype).max)
        values = levels.astype(np.float32)[values]
    linear = values * np.float32(1.0 / (source.white or sources.usual_white(values)))
    if not np.isfinite(linear).all():
        raise ValueError("the pictures contain values that are not finite (NaN or Inf); repair the file")
    contradiction = 0.0
    if content.angles is None:
        stokes = linear
    else:
        fitted, residual = fit_stokes(linear, content.angles)
        # Pictures are scaled so that white is 1 behind the polariser, which transmits half of unpolarised light. The fitted
        # S0 of white is therefore 2.
        stokes = fitted * np.float32(0.5)
        contradiction = _contradiction(residual, float(linear.mean(dtype=np.float64)))
    usual = float(np.median(stokes[0]))
    if usual > sources.MAX_MEDIAN_REFLECTANCE:
        raise ValueError(
            f"the median of S0 is {usual:.3g}, although white is 1; set white to the "
            "value that the file stores for a perfect white"
        )
    small = np.stack([shrunk(each, source.shrink) for each in stokes]).astype(np.float32)
    return _possible(small, contradiction)


def _contradiction(residual: Floats, intensity: float) -> float:
    """Return the RMS residual of Malus's law, averaged over blocks of pixels, relative to the mean intensity.

    The result is 0 if noise explains the residual.
    """
    rows, cols = (length // BLOCK for length in residual.shape[1:3])
    if not (rows and cols and intensity > 0):
        return 0.0
    whole = residual[:, : rows * BLOCK, : cols * BLOCK]
    means = whole.reshape(len(residual), rows, BLOCK, cols, BLOCK, -1).mean(axis=(2, 4), dtype=np.float64)
    systematic = float(np.sqrt(np.mean(means**2)))
    noise = float(np.std(np.diff(residual, axis=2))) / np.sqrt(2) / BLOCK
    return systematic / intensity if systematic > NOISE_LIMIT * noise else 0.0


def _possible(stokes: Floats, contradiction: float) -> StokesPicture:
    """Limit S0 to at least 0, and the degree of polarisation to at most 1."""
    bright = np.maximum(stokes[0], 0)
    polarised = np.hypot(stokes[1], stokes[2])
    impossible = (polarised > bright * (1 + ROUNDING)).any(axis=-1).mean()
    factor = np.minimum(bright / np.maximum(polarised, np.finfo(np.float32).tiny), 1)
    return StokesPicture(np.stack([bright, stokes[1] * factor, stokes[2] * factor]), contradiction, float(impossible))


def scene_of_stokes(picture: StokesPicture, wavelength: NDArray[np.float64], name: str) -> Scene:
    """Convert pictures of Stokes parameters to a spectral scene with polarisation.

    Parameters
    ----------
    picture : StokesPicture
        The pictures.
    wavelength : ndarray, (band,)
        Wavelengths in nm, as for `raise_to_spectra`.
    name : str
        Name of the scene.

    Returns
    -------
    Scene
        The scene, without an illuminant.
    """
    scene = raise_to_spectra(np.broadcast_to(picture.stokes[0], (*picture.stokes.shape[1:3], 3)), wavelength, name)
    if picture.stokes.shape[3] == 1:
        nodes, stokes = np.array([DRAWN.mean()]), picture.stokes
    else:
        nodes, stokes = NODES, picture.stokes @ primaries()[:, np.isin(DRAWN, NODES)].astype(np.float32)
    ratio = stokes[1:] / np.maximum(stokes[0], np.finfo(np.float32).tiny)
    return replace(scene, polarisation=Polarisation(nodes, np.moveaxis(ratio, 0, 2)))
