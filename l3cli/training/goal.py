"""The training goal: everything that determines the first layer's transforms, except the training samples.

The goal is the same for all sites and both passes.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.layers import PLANES
from l3cli.artifacts.training_set import LightSpectrum, TrainingSet, stokes_signals, white_signal
from l3cli.physics.display import XYZ
from l3cli.physics.spectra import is_spectrum
from l3cli.physics.stokes import COLOUR_STOKES, STOKES
from l3cli.training.highlights import error_of_white
from l3cli.training.plain_surfaces import PlainSurfaces, plain_surfaces, polarised_grey
from l3cli.training.systems import Integers

Array = NDArray[np.float64]
LARGEST_CONDITION = 100.0  # largest condition number of the signals of S0, S1 and S2; with four angles, it is 1.4
ONE_LIGHT = 0.001  # illuminants with at most this relative spread count as a single illuminant


@dataclass(frozen=True)
class Goal:
    """Outputs, illuminant and camera properties for which the first layer is trained."""

    outputs: tuple[str, ...]
    channels: tuple[str, ...]
    white: Array  # (output) outputs of a perfect white under the training illuminant, with Y = 1
    white_signal: Array | None  # (channel) signals of this white, as fractions of full scale, or None if unknown
    black_level: float  # DN
    white_level: float  # DN
    white_error: Array | float = 0.0  # (channel) relative error of white's signals if they are estimated from patches
    surfaces: PlainSurfaces | None = None  # measured surfaces under the training illuminant; None if they are not trained on
    stokes_signals: Array | None = None  # (S1 or S2, channel) change of `white_signal` if S1 or S2 equals S0, or None
    polarised: Array | None = None  # moments from `polarised_grey` under the training illuminant; None if not trained on
    filters: tuple[int, ...] = ()  # (channel) first channel with the same filter, or () if no channels share a filter
    sensitivity: Array | None = None  # (channel) relative sensitivity, or None if all channels are equally exposed
    integers: Integers | None = None  # integer formats of the planes, or None if no refinement layer can follow


def one_light(light: LightSpectrum | None) -> LightSpectrum | None:
    """Return the mean illuminant if all frames have the same known illuminant, otherwise None."""
    return light if light is not None and light.spread <= ONE_LIGHT else None


def has_components(head: TrainingSet) -> bool:
    """Whether a refinement layer can correct the outputs' three leading components.

    This requires a spectrum of more than three outputs, or colour outputs with Stokes parameters.
    """
    spectrum = is_spectrum(head.outputs, head.camera.channels)
    return head.outputs == COLOUR_STOKES or (len(head.outputs) > PLANES and spectrum)


def goal_of(head: TrainingSet, white_point: Array, light: LightSpectrum | None) -> Goal:
    """Derive the training goal from the properties of the training sets.

    Parameters
    ----------
    head : TrainingSet
        Properties common to all training frames, such as the camera and the outputs.
    white_point : ndarray, (output)
        Mean outputs of a perfect white, with Y = 1.
    light : LightSpectrum or None
        Mean illuminant of the frames, or None if the illuminant is unknown.

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
    if one_light(light) and head.outputs in (COLOUR_STOKES, STOKES):
        optional["polarised"] = polarised_grey(camera, light, head.outputs)
        changes = stokes_signals(light, camera)
        # With polarisers at fewer than three angles, the signals do not determine S0, S1 and S2.
        if np.linalg.cond(np.vstack([signal, changes])) < LARGEST_CONDITION:
            optional["stokes_signals"] = changes
    return Goal(head.outputs, camera.channels, white_point, signal, *levels, white_error, surfaces, **optional)
