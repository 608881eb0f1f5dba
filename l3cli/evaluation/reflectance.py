"""Metrics of reflectances, as spectra and as colours under several illuminants (docs/measurement.md#reflectances).

The module also contains the linear estimators "wiener" and "pinv", which are the baselines for tables with spectral outputs.
"""

import functools
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import LightSpectrum, TrainingFrame, TrainingPair
from l3cli.evaluation.basic import balance_of, balanced_bands, light_of, white_electrons
from l3cli.evaluation.demosaic import best_of_bands
from l3cli.evaluation.quality import BandQuality, cropped, judge_bands, of_counted
from l3cli.physics import spectra
from l3cli.physics.display import delta_e_2000, lab

Array = NDArray[np.floating]
# Function that simulates training frames with the illuminant and the exposure time of a given frame.
Drawn = Callable[[TrainingPair, LightSpectrum], Iterable[TrainingFrame]]
LIGHTS = {"delta_e_a": "A", "delta_e_d65": "D65", "delta_e_f11": "F11"}  # illuminant of each colour metric
ESTIMATES = ("wiener", "pinv")  # names of the estimators


@dataclass(frozen=True)
class ReflectanceQuality(BandQuality):
    """Metrics of one frame whose outputs are reflectances."""

    delta_e_a: float  # mean CIEDE2000 under illuminant A; the illuminant is the reference white
    delta_e_d65: float  # mean CIEDE2000 under D65
    delta_e_f11: float  # mean CIEDE2000 under F11


def judge_reflectances(
    rendered: Array, target: Array, white: Array, border: int = 0, counted: NDArray[np.bool_] | None = None
) -> tuple[ReflectanceQuality, Array]:
    """Compare rendered reflectances with a target. The outputs must be spectra.REFLECTANCES.

    The parameters and the second result, the spectral angles, are the same as in `judge_bands`.
    """
    figures, angles = judge_bands(rendered, target, white, border, counted)
    inside = None if counted is None else cropped(counted, border)
    shares = [cropped(planes, border) / white[:, None, None] for planes in (rendered, target)]
    colours = {
        figure: float(of_counted(delta_e_2000(*(_lab(each, light) for each in shares)), inside).mean())
        for figure, light in LIGHTS.items()
    }
    return ReflectanceQuality(**asdict(figures), **colours), angles


def _lab(reflectance: Array, light: str) -> Array:
    """Convert reflectances (output, row, col) to CIELAB (row, col, 3) under an illuminant."""
    weights = _xyz_weights(light)
    return lab(np.maximum(np.einsum("xo,ork->rkx", weights, reflectance), 0.0), weights.sum(axis=1))


@functools.cache
def _xyz_weights(light: str) -> Array:
    """Return the matrix (3, output) that converts reflectances at spectra.SAMPLED to XYZ. Y of a perfect white is 1."""
    grid = np.arange(380.0, 781.0)
    weights = spectra.xyz_weights(grid) * spectra.illuminant(light, grid)
    return np.asarray(weights @ spectra.held_interpolation(spectra.SAMPLED, grid) / weights[1].sum())


class Estimates:
    """Linear estimators that compute the spectrum of each pixel from its demosaicked bands.

    The bands are demosaicked with `best_of_bands`. The estimators are fitted to training frames that `drawn` simulates, once
    for each combination of illuminant and exposure time.

    Let the columns of Y be the target spectra of all pixels, and let the columns of P be their bands without noise and
    without mosaicking. The matrix of the estimator "pinv" is Y P⁺, where P⁺ is the pseudo-inverse. The matrix of the
    estimator "wiener" is Y Pᵀ (P Pᵀ + E Eᵀ)⁻¹, where E is the error that noise causes in the demosaicked bands.
    """

    def __init__(self, camera: CameraModel, drawn: Drawn) -> None:
        self._camera, self._drawn, self._demosaic = camera, drawn, best_of_bands(camera.cfa)
        self._fitted: dict[tuple[bytes, float], dict[str, Array]] = {}

    def planes(self, frame: TrainingPair) -> dict[str, Array]:
        """Estimate the planes (output, row, col) of a frame, in the unit of the target. The keys are names of estimators.

        Raises InputFileError if the camera does not respond to the illuminant of the frame.
        """
        white = white_electrons(frame, self._camera)
        key = white.tobytes(), frame.exposure
        if key not in self._fitted:
            self._fitted[key] = self._fit(frame)
        bands = balanced_bands(frame, self._camera, white, self._demosaic)
        unit = frame.white[:, None, None]
        return {name: np.einsum("oc,crk->ork", matrix, bands) * unit for name, matrix in self._fitted[key].items()}

    def _fit(self, like: TrainingPair) -> dict[str, Array]:
        """Fit the matrix (output, channel) of each estimator by least squares.

        The training frames are random scenes with the illuminant and the exposure time of `like`. The Wiener estimator takes
        the noise of the demosaicked bands into account, and the pseudo-inverse does not. Outputs and bands are fractions of
        a perfect white.
        """
        white = white_electrons(like, self._camera)
        balance = balance_of(white, like.exposure, self._camera)[:, None, None]
        squares, noises = np.zeros((2, white.size, white.size))
        products = np.zeros((white.size, len(like.white)))
        for frame in self._drawn(like, light_of(like, self._camera)):
            wanted = frame.target / np.where(frame.white > 0, frame.white, 1.0)[:, None, None]
            bands = frame.electrons * balance
            mosaic = np.take_along_axis(bands, self._camera.channel_map(frame.raw.shape)[None], axis=0)[0]
            noise = balanced_bands(frame, self._camera, white, self._demosaic) - self._demosaic(mosaic, self._camera.cfa)
            squares += np.einsum("brk,crk->bc", bands, bands, optimize=True)
            noises += np.einsum("brk,crk->bc", noise, noise, optimize=True)
            products += np.einsum("brk,ork->bo", bands, wanted, optimize=True)
        seen = {"wiener": squares + noises, "pinv": squares}
        return {name: np.linalg.lstsq(seen[name], products)[0].T for name in ESTIMATES}
