"""What raw developers want to know of a camera's colours: matrices from XYZ to its channels, the channels of a white."""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.physics import spectra
from l3cli.physics.matrices import fit_through
from l3cli.simulation.light import Light, electron_weights, white_rates

Array = NDArray[np.floating]


def colour_matrix(camera: CameraModel, light: Light) -> Array:
    """M (channel, 3): channels = M @ XYZ of surfaces under `light`, whose white has Y = 1 and 1 in its brightest channel.

    Least squares over measured reflectances, with the white met exactly: developers find the white balance by it.
    """
    library = spectra.reflectance_library(light.wavelength)
    weights = electron_weights(camera, light, light.wavelength)
    white = weights.sum(axis=1)
    channels = library @ weights.T / white.max()
    to_xyz = spectra.xyz_weights(light.wavelength) * light.radiance
    xyz_white = to_xyz.sum(axis=1)
    xyz = library @ to_xyz.T / xyz_white[1]
    return fit_through(xyz, channels, xyz_white / xyz_white[1], white / white.max())


def neutral(camera: CameraModel, light: Light) -> Array:
    """(channel) of a grey surface under `light`, 1 in the brightest."""
    rates = white_rates(camera, light)
    return rates / rates.max()
