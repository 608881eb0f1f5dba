"""The light on a scene, and what camera and observer make of it for each band of the scene's reflectance (METHOD 1.2, 2)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli import spectra
from l3cli.artifacts.camera import CameraModel
from l3cli.errors import RecipeError
from l3cli.scene import Scene

Array = NDArray[np.floating]

OWN = "scene"  # the name of the light that a scene was measured under


@dataclass(frozen=True)
class Light:
    """Radiance of a perfect white on the grid where light and reflectance are multiplied."""

    name: str
    luminance: float  # cd/m² of a perfect white
    wavelength: Array  # (sample) nm
    radiance: Array  # (sample) photons/s/sr/m²/nm


def named_light(name: str, luminance: float, seen: Array) -> Light:
    """A CIE illuminant or black body, every nm over what the observer and a camera with wavelengths `seen` see, so that no
    spectral line is missed; RecipeError if the name is unknown."""
    first, last = min(380.0, seen[0]), max(780.0, seen[-1])
    wavelength = np.arange(np.floor(first), last + 1.0)
    radiance = spectra.at_luminance(spectra.illuminant(name, wavelength), wavelength, luminance)
    return Light(name, luminance, wavelength, radiance)


def own_light(scene: Scene, luminance: float) -> Light:
    """The light the scene came with, at another luminance; nothing is known of it outside the scene's wavelengths.

    RecipeError if it has no light of its own, or none that an eye can see.
    """
    if scene.illuminant is None or spectra.xyz_weights(scene.wavelength)[1] @ scene.illuminant <= 0:
        raise RecipeError(f'scene {scene.name} has no visible light of its own; leave "{OWN}" out of illuminants')
    return Light(OWN, luminance, scene.wavelength, spectra.at_luminance(scene.illuminant, scene.wavelength, luminance))


def electron_weights(camera: CameraModel, light: Light, bands: Array) -> Array:
    """Photo-electrons a second (channel, band) of unit reflectance in each band.

    The responsivity is taken as linear between its samples, so each sample sees the light's mean under its own hat.
    """
    seen = camera.electron_weights @ spectra.sampling_matrix(light.wavelength, camera.wavelength)
    return (seen * light.radiance) @ held_interpolation(bands, light.wavelength)


def xyz_weights(light: Light, bands: Array) -> Array:
    """CIE XYZ in cd/m² (3, band) of unit reflectance in each band."""
    return (spectra.xyz_weights(light.wavelength) * light.radiance) @ held_interpolation(bands, light.wavelength)


def held_interpolation(bands: Array, wavelength: Array) -> Array:
    """M (wavelength, band): linear interpolation of a reflectance, held constant beyond its first and last band, as the
    CIE recommends (CIE 15)."""
    return spectra.interpolation_matrix(bands, np.clip(wavelength, bands[0], bands[-1]))


def white_rates(camera: CameraModel, light: Light) -> Array:
    """Photo-electrons a second (channel) of a perfect white."""
    return electron_weights(camera, light, light.wavelength).sum(axis=1)


def automatic_exposure(camera: CameraModel, light: Light, share: float) -> float:
    """Seconds until a perfect white fills its brightest channel to `share` of full scale."""
    return float(share * camera.full_scale / white_rates(camera, light).max())


def uncovered_share(camera: CameraModel, bands: Array) -> float:
    """Share of an white of equal photons's electrons from outside the scene's bands, in the channel where it is largest."""
    weights = camera.electron_weights
    outside = (camera.wavelength < bands[0]) | (camera.wavelength > bands[-1])
    return float((weights[:, outside].sum(axis=1) / weights.sum(axis=1)).max())
