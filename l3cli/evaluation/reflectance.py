"""Quality of estimated reflectances, as spectra and as colours under several illuminants (docs/measurement.md#reflectances).

Two linear estimators, "wiener" and "pinv", are the baselines for tables whose outputs are spectra.
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
# Function that simulates training frames with the illuminant and exposure of a given frame.
Drawn = Callable[[TrainingPair, LightSpectrum], Iterable[TrainingFrame]]
LIGHTS = {"delta_e_a": "A", "delta_e_d65": "D65", "delta_e_f11": "F11"}  # metric → illuminant
ESTIMATES = ("wiener", "pinv")  # names of the estimators


@dataclass(frozen=True)
class ReflectanceQuality(BandQuality):
    """Metrics of one frame of reflectances."""

    delta_e_a: float  # mean CIEDE2000 of the colours under illuminant A, whose white is the reference white
    delta_e_d65: float
    delta_e_f11: float


def judge_reflectances(
    rendered: Array, target: Array, white: Array, border: int = 0, counted: NDArray[np.bool_] | None = None
) -> tuple[ReflectanceQuality, Array]:
    """Return the metrics and the spectral angle (row, col) of reflectance planes at the wavelengths of spectra.REFLECTANCES.

    The parameters are the same as for `judge_bands`.
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
    """Return L*a*b* (row, col, 3) of reflectances (output, row, col) under an illuminant, relative to its white."""
    weights = _xyz_weights(light)
    return lab(np.maximum(np.einsum("xo,ork->rkx", weights, reflectance), 0.0), weights.sum(axis=1))


@functools.cache
def _xyz_weights(light: str) -> Array:
    """Return the weights (3, output) that convert reflectances at spectra.SAMPLED to XYZ under an illuminant.

    White has Y = 1.
    """
    grid = np.arange(380.0, 781.0)
    weights = spectra.xyz_weights(grid) * spectra.illuminant(light, grid)
    return np.asarray(weights @ spectra.held_interpolation(spectra.SAMPLED, grid) / weights[1].sum())


class Estimates:
    """Linear estimators of spectra from the demosaicked bands of each pixel.

    Bands are demosaicked with `best_of_bands`. The estimators are fitted to simulated training frames (`drawn`), once for
    each combination of illuminant and exposure. Let Y be the outputs and P the bands of all pixels, without noise and
    mosaic. "pinv" is Y P⁺, where P⁺ is the pseudo-inverse. "wiener" is Y Pᵀ (P Pᵀ + E Eᵀ)⁻¹, where E is the error that noise
    causes in the demosaicked bands.
    """

    def __init__(self, camera: CameraModel, drawn: Drawn) -> None:
        self._camera, self._drawn, self._demosaic = camera, drawn, best_of_bands(camera.cfa)
        self._fitted: dict[tuple[bytes, float], dict[str, Array]] = {}

    def planes(self, frame: TrainingPair) -> dict[str, Array]:
        """Return the estimated planes (output, row, col) of each estimator, in the target's unit.

        Raises InputFileError if the illuminant of the frame is invisible to the camera.
        """
        white = white_electrons(frame, self._camera)
        key = white.tobytes(), frame.exposure
        if key not in self._fitted:
            self._fitted[key] = self._fit(frame)
        bands = balanced_bands(frame, self._camera, white, self._demosaic)
        unit = frame.white[:, None, None]
        return {name: np.einsum("oc,crk->ork", matrix, bands) * unit for name, matrix in self._fitted[key].items()}

    def _fit(self, like: TrainingPair) -> dict[str, Array]:
        """Fit the matrix (output, channel) of each estimator. Outputs and bands are relative to white."""
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
