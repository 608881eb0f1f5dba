"""The pipeline a laboratory builds without training pictures: white balance, demosaic, one colour matrix (METHOD 7).

Clipped channels are left as they are: cutting all of them where the first clips keeps highlights neutral, but costs 0.6 ΔE00
over faces at three light levels, and what a table is compared with should be the stronger of the two.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli import spectra
from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import TrainingPair
from l3cli.errors import RecipeError
from l3cli.evaluate.demosaic import Demosaic, tiled

Array = NDArray[np.floating]
RIDGE = (
    0.05  # of the matrix, relative to the mean square of the channels' differences: noise against colour (ΔE 1.7 of a chart)
)
UNNAMED = ("A", "D50", "D55", "D65", "D75", "E", "FL2", "FL11")  # lights taken for one of which only the white is known


@dataclass(frozen=True)
class Colour:
    """A camera's colour correction for one light, both sides relative to a perfect white."""

    white_rates: Array  # (channel) photo-electrons a second of a perfect white of 1 cd/m²
    matrix: Array  # (output, channel), each row sums to 1


def fit_colour(camera: CameraModel, illuminant: str) -> Colour:
    """XYZ from channels by ridge regression over measured reflectances under a named light; white stays exactly white.

    RecipeError if the illuminant has no such name.
    """
    wavelength = np.arange(380.0, 781.0, 5.0)
    light = spectra.at_luminance(spectra.illuminant(illuminant, wavelength), wavelength, 1.0)
    library = np.vstack([np.ones(wavelength.size), spectra.reflectance_library(wavelength)])
    seen = camera.electron_weights @ spectra.sampling_matrix(wavelength, camera.wavelength)
    electrons = (library * light) @ seen.T
    xyz = (library * light) @ spectra.xyz_weights(wavelength).T
    return Colour(electrons[0], white_preserving_ridge(electrons[1:] / electrons[0], xyz[1:] / xyz[0]))


def white_preserving_ridge(channels: Array, outputs: Array) -> Array:
    """M (output, channel), rows of sum 1, that takes white-balanced channels (sample, channel) to outputs (sample, output).

    Ridge regression of what the outputs differ from the channels' mean by, on what the channels differ from it by."""
    mean = channels.mean(axis=1, keepdims=True)
    differences = channels - mean
    gram = differences.T @ differences
    ridge = RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram))
    matrix = np.linalg.solve(gram + ridge, differences.T @ (outputs - mean)).T
    return matrix - matrix.mean(axis=1, keepdims=True) + 1.0 / len(gram)


def develop(frame: TrainingPair, camera: CameraModel, colour: Colour, demosaic: Demosaic) -> Array:
    """XYZ (3, row, col) in the target's unit of a frame's raw: black and dark off, white balance, demosaic, matrix."""
    electrons = (frame.raw - camera.black) / camera.gain - camera.noise.dark_current * frame.dark_time
    white = colour.white_rates * frame.luminance * frame.exposure
    balanced = electrons / white[tiled(camera.cfa, frame.raw.shape)]
    planes = np.einsum("oc,crk->ork", colour.matrix, demosaic(balanced, camera.cfa))
    return planes * frame.white[:, None, None]


def light_of(frame: TrainingPair) -> str:
    """The name of a frame's light, or of the common light nearest to its white where it has none ("scene")."""
    try:
        spectra.illuminant(frame.illuminant, np.array([550.0]))
    except RecipeError:
        return min(UNNAMED, key=lambda name: _distance(spectra.white_point(name), frame.white))
    return frame.illuminant


def _distance(one: Array, other: Array) -> float:
    """Of two whites (3), between their chromaticities."""
    return float(np.hypot(*(one / one.sum() - other / other.sum())[:2]))
