"""Targets of training: observers, other matching functions, or the camera's own bands (docs/method.md#simulation)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.physics import spectra
from l3cli.simulation.light import Curve, Light, electron_weights, matching_weights

Array = NDArray[np.floating]

OUTPUTS = {
    "CIE 1931": ("X", "Y", "Z"),
    "CIE 1964": ("X10", "Y10", "Z10"),
    "luminance": ("Y",),
    "CIE 1931 + IR": ("X", "Y", "Z", "IR"),
}
CAMERA = "camera"  # the camera's own bands at full resolution


@dataclass(frozen=True)
class Target:
    """The wanted outputs, and the light they are wanted under."""

    outputs: tuple[str, ...]
    description: str
    kind: str  # a key of OUTPUTS, CAMERA, or the name of a file of matching functions
    functions: Curve | None = None  # of the file: wavelength nm, (output, wavelength) per watt
    light: Light | None = None  # None: that of the frame


XYZ = Target(OUTPUTS["CIE 1931"], "CIE 1931 XYZ of the scene under its own light, without lens or noise", "CIE 1931")


def make_target(
    kind: str, functions: Curve | None, names: tuple[str, ...], light: Light | None, camera: CameraModel
) -> Target:
    """Return the target of a recipe: `kind` as in Target, with `functions` and their `names` if it is a file."""
    outputs = OUTPUTS.get(kind, camera.channels if kind == CAMERA else names)
    what = {
        "CIE 1931": "CIE 1931 XYZ",
        "CIE 1964": "CIE 1964 XYZ",
        "luminance": "luminance",
        "CIE 1931 + IR": "CIE 1931 XYZ and near infrared",
        CAMERA: "all bands of the camera (cd/m² of D65 that would saturate its brightest channel as fast)",
    }.get(kind, f"the matching functions of {kind}")
    under = f"under {light.name}" if light else "under its own light"
    return Target(outputs, f"{what} of the scene {under}, without lens or noise", kind, functions, light)


def output_weights(target: Target, camera: CameraModel, light: Light, bands: Array) -> Array:
    """Return W (output, band): outputs of unit reflectance in each band when `light` falls on the frame, in cd/m².

    The camera's bands come in the same unit: the share of full scale a second, times the camera's saturation exposure.
    """
    if target.light:
        light = target.light.at(light.luminance)
    if target.kind == CAMERA:
        weights = electron_weights(camera, light, bands) * (camera.saturation_exposure / camera.full_scale)
        return weights if camera.readout is None else weights * camera.channel_gains[:, None]
    if target.functions:
        grid, values = target.functions
        functions: Array = spectra.average(values, grid, light.wavelength)
    elif target.kind == "luminance":
        functions = spectra.colour_matching_functions(light.wavelength)[1:2]
    elif target.kind == "CIE 1931 + IR":
        visible = spectra.colour_matching_functions(light.wavelength)
        functions = np.vstack([visible, spectra.near_infrared(light.wavelength)])
    else:
        functions = spectra.colour_matching_functions(light.wavelength, target.kind)
    return matching_weights(functions, light, bands)
