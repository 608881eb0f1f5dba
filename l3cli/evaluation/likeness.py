"""Comparison of the camera that took frames with that of a table: by their signals, not by names or digests.

A table turns shares of full scale into colours, so what counts is what a camera makes of surfaces: the ratios of its
channels (colour), the exposure that fills them (sensitivity), and the noise on them. The limits leave room for two
calibrations of one camera. Of 28 published cameras those with a sensor in common (Nikon D3 and D700, D40 and D50, Canon 600D
and 60D, 500D and 50D) lie 0.9 to 1.5 ΔE00 apart, nearly all others 2.2 to 40; an error of 1 nm makes 0.5, one of 3 % in the
gain of a channel 1.2.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.schema import equal
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import LightSpectrum
from l3cli.evaluation.basic import electrons_of, fit_colour, lit_library, named_light
from l3cli.physics import spectra
from l3cli.physics.display import delta_e_2000, lab

Array = NDArray[np.floating]
LIGHTS = ("D65", "A")
MOST_COLOUR = 2.0  # mean ΔE00 of measured surfaces
MOST_SENSITIVITY = 1.1  # factor: lamps and photodiodes of two laboratories agree within 5 %
MOST_NOISE = 1.25  # factor of a standard deviation
NOISE_SHARES = (0.0, 0.01, 0.1, 0.5)  # of full scale, at which noise is compared


def unlike(known: TransformTable | CameraModel, camera: CameraModel) -> str:
    """Return how `camera` differs from another of the same channels, or from that which a table was learned for, in words;
    "" if it does not.

    Of a table that does not hold its camera, as older ones do not, sensitivity alone is known.
    """
    learned = known.camera if isinstance(known, TransformTable) else known
    exposure = known.output_unit if learned is None else learned.saturation_exposure  # older tables are of alike channels
    if learned is not None and equal(replace(learned, fit=None), replace(camera, fit=None)):
        return ""
    differences = []
    if learned is not None and not (colour := colour_difference(learned, camera)) <= MOST_COLOUR:
        differences.append(f"colours by ΔE00 {colour:.1f}")
    sensitivity = exposure / camera.saturation_exposure
    if _factor(sensitivity) > MOST_SENSITIVITY:
        differences.append(f"sensitivity by a factor of {sensitivity:.3g}")
    if learned is not None and _factor(noise := noise_ratio(learned, camera)) > MOST_NOISE:
        differences.append(f"noise by a factor of {noise:.3g}")
    return ", ".join(differences)


def colour_difference(one: CameraModel, other: CameraModel) -> float:
    """Return the mean CIEDE2000 between measured reflectances seen by two cameras of the same channels, through the white
    balance and colour matrix of `one`; whatever factor their sensitivities have in common is left out. Of D65 and A the
    larger."""
    return max(_colour_difference(one, other, named_light(name, one, other)) for name in LIGHTS)


def _colour_difference(one: CameraModel, other: CameraModel, light: LightSpectrum) -> float:
    colour = fit_colour(one, light)
    library, falling = lit_library(light)
    white = spectra.xyz_weights(light.wavelength) @ falling
    labs = []
    for camera in (one, other):
        electrons = electrons_of(camera, light, library * falling)
        balanced = electrons * colour.balance
        size = balanced[0].mean()
        seen = (balanced / size if size > 0 else balanced) @ colour.matrix.T
        labs.append(lab(np.maximum(seen, 0.0) * white, white))
    return float(delta_e_2000(*labs).mean())


def noise_ratio(one: CameraModel, other: CameraModel) -> float:
    """Return the noise of `other` over that of `one`, both as shares of full scale, where they differ most."""
    spreads = []
    for camera in (one, other):
        full = camera.white_level - camera.black_level
        spreads.append(np.sqrt(camera.noise_variance(np.array(NOISE_SHARES) * full)) / full)
    ratios = spreads[1] / spreads[0]
    return float(ratios[np.abs(np.log(ratios)).argmax()])


def _factor(ratio: float) -> float:
    """Return a ratio or its inverse, whichever is above 1."""
    return max(ratio, 1.0 / ratio)
