"""Checks whether two camera models describe the same camera, for example a table's camera and the camera of frames.

The comparison uses the properties that matter for a table, not names or digests: the colours of measured surfaces, the
saturation exposure, and the noise. The limits are wide enough for two calibrations of the same camera.

The limit for colours is based on 28 published cameras. Pairs with the same sensor (Nikon D3 and D700, D40 and D50, Canon
600D and 60D, 500D and 50D) differ by 0.9 to 1.5 ΔE00, and nearly all other pairs by 2.2 to 40 ΔE00. A wavelength error of
1 nm causes 0.5 ΔE00, and an error of 3 % in the gain of one channel causes 1.2 ΔE00.
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
MAX_DELTA_E = 2.0  # largest mean ΔE00 over measured surfaces
CHANNEL_NOISE = 0.003  # typical uncertainty of a calibrated channel, relative to white; the matrix should not amplify it
MAX_SENSITIVITY_RATIO = 1.1  # largest ratio of sensitivities; calibrations of two laboratories agree within 5 %
MAX_NOISE_RATIO = 1.25  # largest ratio of noise standard deviations
NOISE_SIGNALS = (0.0, 0.01, 0.1, 0.5)  # fractions of full scale at which noise is compared


def camera_differences(known: TransformTable | CameraModel, camera: CameraModel) -> str:
    """Describe in which properties two camera models differ too much to be two calibrations of the same camera.

    Parameters
    ----------
    known : TransformTable or CameraModel
        Reference camera, or a table for it. For a table without a camera model, only channels and sensitivity are compared.
    camera : CameraModel
        Camera to compare.

    Returns
    -------
    str
        Differences beyond the limits, separated by commas, or "" if there are none. If the channels have different names,
        nothing else is compared.
    """
    if known.channels != camera.channels:
        return f"channels ({', '.join(known.channels)}; {', '.join(camera.channels)})"
    learned = known.camera if isinstance(known, TransformTable) else known
    # Without a camera model, all channels are assumed to have the same exposure and gain, so that the table's output unit is
    # the saturation exposure.
    exposure = known.output_unit if learned is None else learned.saturation_exposure
    if learned is not None and equal(replace(learned, fit=None), replace(camera, fit=None)):
        return ""
    differences = []
    if learned is not None and not (colour := colour_difference(learned, camera)) <= MAX_DELTA_E:
        differences.append(f"colours by {colour:.1f} ΔE00")
    sensitivity = exposure / camera.saturation_exposure
    if _factor(sensitivity) > MAX_SENSITIVITY_RATIO:
        differences.append(f"sensitivity by a factor of {sensitivity:.3g}")
    if learned is not None and _factor(noise := noise_ratio(learned, camera)) > MAX_NOISE_RATIO:
        differences.append(f"noise by a factor of {noise:.3g}")
    return ", ".join(differences)


def colour_difference(one: CameraModel, other: CameraModel) -> float:
    """Return the mean CIEDE2000 difference between two cameras' colours of measured surfaces.

    Both cameras, which must have the same channels, use the white balance and colour matrix of `one`. Differences in overall
    sensitivity are ignored. The result is the larger of the means under D65 and A.
    """
    return max(_colour_difference(one, other, named_light(name, one, other)) for name in LIGHTS)


def _colour_difference(one: CameraModel, other: CameraModel, light: LightSpectrum) -> float:
    colour = fit_colour(one, light, channel_noise=CHANNEL_NOISE)
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
    """Return the noise standard deviation of `other`, divided by the noise standard deviation of `one`.

    Noise and signal are fractions of full scale. The ratio is computed at each signal in NOISE_SIGNALS, and the ratio that
    differs most from 1 is returned.
    """
    spreads = []
    for camera in (one, other):
        full = camera.white_level - camera.black_level
        spreads.append(np.sqrt(camera.noise_variance(np.array(NOISE_SIGNALS) * full)) / full)
    ratios = spreads[1] / spreads[0]
    return float(ratios[np.abs(np.log(ratios)).argmax()])


def _factor(ratio: float) -> float:
    return max(ratio, 1.0 / ratio)
