"""Measure the polarisers of single pixels with a rotating polariser (docs/method.md#polarisers-of-single-pixels).

For known angles and brightnesses of the light, Malus's law is linear in the response of a pixel to S0, S1 and S2. Three
weighted sums of the frames are therefore the least-squares estimates for all pixels.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel, PolariserField
from l3cli.artifacts.fit import PolariserFit
from l3cli.calibration import statistics
from l3cli.calibration.captures import Sensor, electronics_of, flat_field
from l3cli.calibration.polarisers import Electronics, harmonics, noise_variance
from l3cli.errors import InputFileError
from l3cli.frames.measurement import Body, Measurements, SensorFigures
from l3cli.frames.shading import interpolation
from l3cli.frames.super_pixels import FRACTION, super_pixels

LARGEST_DEVIATION = 0.25  # larger deviations, which only defective pixels have, are clipped to this value
Array = NDArray[np.float64]


def with_pixel_polarisers(
    camera: CameraModel, measurements: Measurements, sensor: Sensor | SensorFigures, each: statistics.Each = map
) -> CameraModel:
    """Add the deviations of single pixels to a camera model whose polarisers were measured.

    The camera model is returned unchanged if there are no captures behind a rotating polariser, if the array has no
    super-pixels, or if the light was not uniform.
    """
    fit = camera.fit.polarisers if camera.fit else None
    if fit is None or not measurements.polariser or not super_pixels(camera).any() or fit.used.sum(axis=0).min() < 4:
        return camera
    body, electronics = measurements.body, electronics_of(measurements, sensor)
    weights, noise = estimator(fit, np.array([capture.lit for capture in measurements.polariser]), electronics)
    sums = statistics.weighted_sums(measurements.polariser, weights, body, each)
    dark = np.einsum("sjc,jc->sc", weights, electronics.dark)
    sums -= dark[:, camera.channel_map((body.rows, body.cols))]
    try:
        found = deviations(sums, noise, body, electronics.defects)
    except InputFileError:  # from `flat_field`
        return camera
    limited = np.moveaxis(np.clip(found, -LARGEST_DEVIATION, LARGEST_DEVIATION), 0, -1)
    return replace(camera, polariser_field=PolariserField(np.rint(limited * 2**FRACTION).astype(np.int16)))


def estimator(fit: PolariserFit, lit: Array, electronics: Electronics) -> tuple[Array, Array]:
    """Return the captures' weights in four sums, and the noise of the first three sums.

    The first three sums estimate each pixel's response to S0, S1 and S2. The fourth sum is 0 for any response, so that it
    contains only noise. The number of frames in each capture does not have to be known, because `deviations` measures the
    noise in the fourth sum.

    Parameters
    ----------
    fit : PolariserFit
        The measured polarisers of the channels. Each channel needs at least four captures.
    lit : ndarray, (capture,)
        Exposure time of each capture in s, multiplied by the relative lamp intensity.
    electronics : Electronics
        Noise of the sensor.

    Returns
    -------
    weights : ndarray, (sum, capture, channel)
        Weights of the sums that estimate the response to S0, S1 and S2, and of the sum that contains only noise. They are 0
        for captures in which the channel is saturated.
    noise : ndarray, (channel, stokes, stokes)
        Covariance of the estimates' errors, divided by the variance of the fourth sum.
    """
    rows = harmonics(fit.light_angle) * [1.0, fit.light_polarisation, fit.light_polarisation]
    rows *= (fit.brightness * lit)[:, None]
    variance = noise_variance(fit.measured * lit[:, None], electronics)
    weights, noise = np.zeros((4, *fit.used.shape)), np.zeros((fit.used.shape[1], 3, 3))
    for channel, used in enumerate(fit.used.T):
        estimates, silent = np.linalg.pinv(rows[used]), np.linalg.svd(rows[used])[0][:, -1]
        weights[:, used, channel] = [*estimates, silent]
        of_pixel = variance[used, channel]
        noise[channel] = estimates * of_pixel @ estimates.T / (silent**2 @ of_pixel)
    return weights, noise


def deviations(sums: Array, noise: Array, body: Body, defects: statistics.Defects) -> Array:
    """Return the deviation of each pixel's response from the mean response of its channel.

    Smooth changes of the gain over the frame are removed, because they also contain the shading of the light. The noise of
    the estimates is reduced with a Wiener filter, so that a few frames are not worse than no correction.

    Parameters
    ----------
    sums : ndarray, (sum, row, col)
        Estimated responses to S0, S1 and S2, and the sum that contains only noise.
    noise : ndarray, (channel, stokes, stokes)
        Second result of `estimator`.
    body : Body
        Filter array of the camera.
    defects : ndarray, (defect, 2)
        Row and column of defective pixels, whose deviations are set to 0.

    Returns
    -------
    ndarray, (stokes, row, col)
        Deviations, divided by the mean response to S0.

    Raises
    ------
    InputFileError
        If the frames were not evenly lit.
    """
    whole = np.stack([statistics.patched(each, body.cfa, defects) for each in sums])
    field = flat_field(whole[0], body)
    down = interpolation(field.grid_row, np.arange(body.rows))
    across = interpolation(field.grid_col, np.arange(body.cols))
    (rows, cols), result = body.cfa.shape, np.zeros((3, *whole.shape[1:]))
    for channel in range(len(body.channels)):
        gain = down @ field.shading_gain[channel] @ across.T
        sites = [np.s_[:, row::rows, col::cols] for row, col in np.argwhere(body.cfa == channel).tolist()]
        parts = [whole[site] * gain[site[1:]] for site in sites]
        values = np.concatenate([part.reshape(4, -1) for part in parts], axis=1)
        mean = values[:3].mean(axis=1)
        kept = without_noise(np.cov(values[:3]), noise[channel] * values[3].var())
        for site, part in zip(sites, parts, strict=True):
            result[site] = np.tensordot(kept, part[:3] - mean[:, None, None], 1) / mean[0]
    result[:, defects[:, 0], defects[:, 1]] = 0.0
    return result


def without_noise(covariance: Array, noise: Array) -> Array:
    """Return the matrix that estimates values from noisy values with the smallest mean square error.

    Let C be the covariance of the noisy values and N the covariance of their noise. The matrix is (C − N) C⁻¹. Components
    whose variance does not exceed the noise are set to 0.
    """
    root = np.linalg.cholesky(noise)
    inverse = np.linalg.inv(root)
    variance, vectors = np.linalg.eigh(inverse @ covariance @ inverse.T)
    kept = np.maximum(1.0 - 1.0 / np.maximum(variance, 1.0), 0.0)
    return np.asarray(root @ (vectors * kept) @ vectors.T @ inverse)
