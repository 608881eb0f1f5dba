"""Defect map and flat field of a camera, from its dark and white frames (docs/method.md#corrections)."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.fit import Fit
from l3cli.calibration import defects as defective
from l3cli.calibration import noise
from l3cli.calibration.captures import Sensor
from l3cli.calibration.flat_field import flat_field
from l3cli.calibration.statistics import mean_frame
from l3cli.errors import InputFileError
from l3cli.frames.measurement import Body, Capture, Measurements

LEAST_SIGNAL = 0.02  # of full scale: a white that is darker says little of a pixel's response
MOST_DEFECTIVE = 0.05  # share of the pixels: of more no frame can be corrected
Array = NDArray[np.float64]


def with_corrections(camera: CameraModel, sensor: Sensor, body: Body) -> CameraModel:
    """Return the camera with the defects of its dark and white frames, and with a flat field if the whites are even: for
    noise they need not be."""
    shape = (body.rows, body.cols)
    defects = defective.as_map(sensor.defects, sensor.dark.hot, shape)
    try:
        return replace(camera, defects=defects, flat_field=flat_field(sensor.response, body))
    except InputFileError:
        return replace(camera, defects=defects)


def correct_by_frames(camera: CameraModel, measurements: Measurements) -> CameraModel:
    """Return the camera with the defects and the flat field of dark and white frames, of one exposure or several; all else
    stays.

    InputFileError if the whites are too dark, clipped or uneven, or if too many pixels are defective.
    """
    body, darks = measurements.body, measurements.darks
    means = [mean_frame(capture).astype(np.float64) for capture in darks]
    hot = defective.join(defective.none(), *(defective.outliers(mean, body.cfa) for mean in means))
    response = np.zeros((body.rows, body.cols))
    for capture in measurements.whites:
        both = mean_frame(capture).astype(np.float64), means[_nearest(darks, capture.exposure)]
        mean, dark = (defective.patched(each, body.cfa, hot) for each in both)
        _check_level(mean, camera, capture.name)
        response += mean - dark
    dead, response = noise.dead_pixels(response, body.cfa)
    every = defective.join(hot, dead)
    if len(every) > MOST_DEFECTIVE * response.size:
        raise InputFileError(
            f"{len(every) / response.size:.0%} of the pixels would be defective; are the dark frames without light, "
            "the white ones of an even white?"
        )
    found = defective.as_map(every, hot, (body.rows, body.cols))
    return replace(camera, defects=found, flat_field=flat_field(response, body), fit=camera.fit or Fit())


def _nearest(darks: Sequence[Capture], exposure: float) -> int:
    """Return the dark capture whose exposure time is nearest, by ratio."""
    return int(np.argmin([abs(np.log(dark.exposure / exposure)) for dark in darks]))


def _check_level(mean: NDArray[np.floating], camera: CameraModel, name: str) -> None:
    span = camera.white_level - camera.black_level
    for channel, label in enumerate(camera.channels):
        rows, cols = camera.cfa.shape
        sites = np.argwhere(camera.cfa == channel)
        values = np.concatenate([mean[row::rows, col::cols].ravel() for row, col in sites])
        if np.quantile(values, 0.999) >= camera.black_level + noise.SATURATED * span:
            raise InputFileError(f"{name}: channel {label} is clipped; expose the white frames shorter")
        if np.median(values) < camera.black_level + LEAST_SIGNAL * span:
            raise InputFileError(f"{name}: channel {label} is dark; expose the white frames longer")
