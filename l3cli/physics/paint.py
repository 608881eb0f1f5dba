"""Reflectances of painted surfaces by formula (docs/method.md#procedural-scenes)."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]

LARGEST, SMALLEST = 1.0, 0.002  # reflectances


def with_saturation(reflectance: Array, saturation: float, drawn: NDArray[np.bool_] | slice = slice(None)) -> Array:
    """reflectance (…, band) drawn towards its geometric mean: 0 is grey, 1 leaves it. The mean is that of the
    bands `drawn`, of all without."""
    grey = np.exp(np.log(reflectance[..., drawn]).mean(axis=-1, keepdims=True))
    return np.asarray(grey * (reflectance / grey) ** saturation)


def with_titanium_white(reflectance: Array, wavelength: Array, edge: float, width: float) -> Array:
    """reflectance (…, band) in [SMALLEST, LARGEST] with the absorption edge of rutile (3.0 eV, 413 nm) added: whatever is
    scattered by titanium white turns dark within some 20 nm of it. `edge` is the K/S it adds at 405 nm (about 0.2), `width`
    how fast that falls, in nm (5 to 11): Kubelka–Munk; the tail falls exponentially, as Urbach's rule says.

    Cameras and eyes weigh this edge differently; without it a table takes white paint for yellow.
    """
    pigment = (1.0 - reflectance) ** 2 / (2.0 * reflectance)
    return np.clip(kubelka_munk(pigment + edge * np.exp(-(wavelength - 405.0) / width)), SMALLEST, LARGEST)


def kubelka_munk(absorption_per_scattering: Array) -> Array:
    """Reflectance of an opaque layer of given K/S (Kubelka–Munk)."""
    ratio = absorption_per_scattering
    return 1.0 + ratio - np.sqrt(ratio**2 + 2.0 * ratio)
