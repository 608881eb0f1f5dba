"""The light on scenes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.schema import check, data


@dataclass(frozen=True)
class LightSpectrum:
    """Light on a scene: the radiance of a perfect white of 1 cd/m²."""

    wavelength: NDArray[np.float64] = data("float64", "wavelength", unit="nm", doc="where the light is tabulated")
    radiance: NDArray[np.float32] = data(
        "float32", "wavelength", unit="photons/s/sr/m^2/nm", doc="of a perfect white of 1 cd/m^2"
    )
    spread: float = data("float64", doc="of a mean: largest relative difference of a light from it", default=0.0)

    def __post_init__(self) -> None:
        check(self)
        if not (self.wavelength.size > 1 and self.wavelength[0] > 0 and (np.diff(self.wavelength) > 0).all()):
            raise ValueError("light_wavelength must increase, above zero")
        if not self.radiance.min() >= 0 < self.radiance.max():
            raise ValueError("radiance is not that of a light")
