"""Metrics for estimated reflectances: spectral errors, and colour differences under several illuminants.

docs/measurement.md#reflectances defines the metrics.

The linear estimators "wiener" and "pinv" are baselines for tables with spectral outputs.
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
# Simulates training frames with a given illuminant, and the exposure time of a given frame.
Drawn = Callable[[TrainingPair, LightSpectrum], Iterable[TrainingFrame]]
LIGHTS = {"delta_e_a": "A", "delta_e_d65": "D65", "delta_e_f11": "F11"}  # illuminant of each colour metric
ESTIMATES = ("wiener", "pinv")  # names of the estimators


@dataclass(frozen=True)
class ReflectanceQuality(BandQuality):
    """Metrics of one frame with reflectance outputs."""

    delta_e_a: float  # mean CIEDE2000 under illuminant A, which is also the reference white
    delta_e_d65: float  # mean CIEDE2000 under D65
    delta_e_f11: float  # mean CIEDE2000 under F11


def judge_reflectances(
    rendered: Array, target: Array, white: Array, border: int = 0, counted: NDArray[np.bool_] | None = None
) -> tuple[ReflectanceQuality, Array]:
    """Compare rendered reflectances with a target. The outputs must be spectra.REFLECTANCES.

    The parameters are as in `judge_bands`. The second result contains the spectral angles.
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
    """Return the matrix (3, output) from reflectances at spectra.SAMPLED to XYZ, with Y = 1 for a perfect white."""
    grid = np.arange(380.0, 781.0)
    weights = spectra.xyz_weights(grid) * spectra.illuminant(light, grid)
    return np.asarray(weights @ spectra.held_interpolation(spectra.SAMPLED, grid) / weights[1].sum())


class Estimates:
    """Linear estimators, which compute the spectrum of each pixel from its demosaicked bands.

    The bands come from `best_of_bands`. The estimators are fitted to frames that `drawn` simulates, once per illuminant and
    exposure time.

    Let the columns of Y be the target spectra of all pixels, and the columns of P their bands without noise and mosaicking.
    The matrix of "pinv" is Y P⁺, with the pseudo-inverse P⁺. The matrix of "wiener" is Y Pᵀ (P Pᵀ + E Eᵀ)⁻¹, where E is the
    error that noise causes in the demosaicked bands.
    """

    def __init__(self, camera: CameraModel, drawn: Drawn) -> None:
        self._camera, self._drawn, self._demosaic = camera, drawn, best_of_bands(camera.cfa)
        self._fitted: dict[tuple[bytes, float], dict[str, Array]] = {}

    def planes(self, frame: TrainingPair) -> dict[str, Array]:
        """Return each estimator's planes (output, row, col) for a frame, in the unit of the target.

        Raises InputFileError if the camera does not respond to the frame's illuminant.
        """
        white = white_electrons(frame, self._camera)
        key = white.tobytes(), frame.exposure
        if key not in self._fitted:
            self._fitted[key] = self._fit(frame)
        bands = balanced_bands(frame, self._camera, white, self._demosaic)
        unit = frame.white[:, None, None]
        return {name: np.einsum("oc,crk->ork", matrix, bands) * unit for name, matrix in self._fitted[key].items()}

    def _fit(self, like: TrainingPair) -> dict[str, Array]:
        """Fit each estimator's matrix (output, channel) by least squares to random scenes.

        The scenes have the illuminant and exposure time of `like`. Only the Wiener estimator takes noise into account.
        Outputs and bands are fractions of a perfect white.
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
