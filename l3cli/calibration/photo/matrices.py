"""Colour matrices of a raw file → responsivities: curves that answer to the patches of a chart as the matrices say
(docs/method.md#charts-in-photographs)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.calibration.curves import Curves
from l3cli.calibration.photo.estimate import Shot, estimate
from l3cli.calibration.photo.prior import ROLES, WAVELENGTH, Prior, camera_prior, smooth, turned
from l3cli.calibration.photo.responsivity import curves_of
from l3cli.calibration.responsivity import COVERAGE
from l3cli.frames.measurement import CurveStatistics
from l3cli.physics import spectra

ERROR = 0.02  # of a patch's value: what no matrix of nine numbers says of a camera, beside the misfit that is found
Array = NDArray[np.floating]


@dataclass(frozen=True)
class ColourMatrix:
    """Colours of a camera under one light as a raw file states them (DNG 1.7, ColorMatrix)."""

    light: str  # its name
    values: Array  # (channel, 3) XYZ → channels


def curves_of_matrices(matrices: Sequence[ColourMatrix], prior: Prior) -> Curves:
    """Return the most probable curves, relative, with 95 % bands, of a camera that has these matrices: the posterior of
    `prior` given the responses that the matrices predict for a ColorChecker under their lights."""
    reflectance = spectra.colorchecker(WAVELENGTH)[1]
    shots = [_shot(matrix, reflectance) for matrix in matrices]
    return curves_of(estimate(shots, prior))


def usual_curves(prior: Prior) -> Curves:
    """Return the mean of measured cameras, for one of which nothing is known."""
    peaks = np.exp(prior.log_peak)[:, None]
    deviation = np.sqrt(np.diag(prior.covariance)).reshape(prior.mean.shape)
    mean = np.asarray(prior.mean * peaks, np.float64)
    return Curves(WAVELENGTH, mean, COVERAGE * deviation * peaks).to_common_peak()


def prior_of(channels: Sequence[str], known: CurveStatistics) -> Prior:
    """Return the prior of measured cameras for channels r, g and b, that of smoothness for others."""
    if sorted(channels) != sorted(ROLES):
        return smooth(len(channels))
    return camera_prior(turned(known, [ROLES.index(name) for name in channels]))


def _shot(matrix: ColourMatrix, reflectance: Array) -> Shot:
    """Return the chart as the matrix predicts it, evenly lit and without glare."""
    light = spectra.illuminant(matrix.light, WAVELENGTH)
    weights = spectra.xyz_weights(WAVELENGTH)
    xyz = (reflectance * light) @ weights.T / (weights[1] @ light)
    values = np.asarray(xyz @ matrix.values.T, np.float64)
    place = np.zeros((len(values), 2))
    deviation = ERROR * np.abs(values)
    return Shot(light, reflectance, place, values, deviation, values > 0, uneven=0.0, glare=0.0)
