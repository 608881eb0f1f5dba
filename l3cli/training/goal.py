"""The goal of the transforms of a training run, which is the same for all sites and passes."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.layers import PLANES
from l3cli.artifacts.training_set import LightSpectrum, TrainingSet, white_signal
from l3cli.physics.display import XYZ
from l3cli.physics.spectra import is_spectrum
from l3cli.training.highlights import error_of_white
from l3cli.training.plain_surfaces import PlainSurfaces, plain_surfaces
from l3cli.training.systems import Integers

Array = NDArray[np.float64]
ONE_LIGHT = 0.001  # largest spread of lights that count as the same


@dataclass(frozen=True)
class Goal:
    """Outputs, levels, lights and surfaces for which the transforms are learned."""

    outputs: tuple[str, ...]
    channels: tuple[str, ...]
    white: Array  # (output) of a perfect white under the training light, Y = 1
    white_signal: Array | None  # (channel) signals of that white, fractions of full scale; None: not known
    black_level: float  # DN, of the camera
    white_level: float  # DN, at which a pixel of the camera saturates
    white_error: Array | float = 0.0  # (channel) relative error with which surfaces predict white_signal
    surfaces: PlainSurfaces | None = None  # under the training light; None: light not known, or other outputs
    filters: tuple[int, ...] = ()  # (channel) first channel with its filter; (): every channel has its own
    sensitivity: Array | None = None  # (channel) as of the camera; None: all alike
    integers: Integers | None = None  # formats of the planes for a next layer; None: no layer can follow


def one_light(light: LightSpectrum | None) -> LightSpectrum | None:
    """Return the mean light if it is known and all frames have the same light, otherwise None."""
    return light if light is not None and light.spread <= ONE_LIGHT else None


def has_components(head: TrainingSet) -> bool:
    """Return whether the outputs are a spectrum, whose leading components a layer may refine."""
    return len(head.outputs) > PLANES and is_spectrum(head.outputs, head.camera.channels)


def goal_of(head: TrainingSet, white_point: Array, light: LightSpectrum | None) -> Goal:
    """Return the goal of a training run.

    Parameters
    ----------
    head : TrainingSet
        Head of the training sets.
    white_point : ndarray, (output)
        Mean outputs of white.
    light : LightSpectrum or None
        Mean light of the frames; None if it is not known.

    Returns
    -------
    Goal
    """
    camera = head.camera
    levels = camera.black_level, camera.white_level
    optional: dict[str, Any] = {}
    if len(head.outputs) == 3 or has_components(head):
        optional["integers"] = Integers(camera.bits, *levels)
    if camera.readout is not None:
        optional |= {"filters": tuple(camera.readout.same_filter.tolist()), "sensitivity": camera.sensitivity}
    if light is None:
        return Goal(head.outputs, camera.channels, white_point, None, *levels, **optional)
    signal, white_error = white_signal(light, camera), error_of_white(light, camera)
    surfaces = None
    if one_light(light) and head.outputs == XYZ:
        surfaces = plain_surfaces(camera, light, head.target_light or light, white_point)
    return Goal(head.outputs, camera.channels, white_point, signal, *levels, white_error, surfaces, **optional)
