"""A scene: a spectral picture from outside, ready to be seen by a camera."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

BRIGHTEST = 1e6  # times a perfect white: the sun on a sheet of paper, seen beside it
BRIGHTEST_UNLIT = 1e26  # of a scene without illuminant: a linear picture may hold values of any scale
NO_ILLUMINANT: Final = None  # of a scene that came as reflectance: it was seen under no light that is known


@dataclass(frozen=True)
class Scene:
    """A picture of spectral reflectances with the light it was seen under, if there is one.

    `reflectance` is radiance / that of a perfect white: ≥ 0, above 1 in speculars (docs/method.md#simulation). Synthetic
    scenes, raised RGB pictures and cubes of reflectance have NO_ILLUMINANT: every light may be laid on them. Radiance whose
    light is not known has that of equal photons as its illuminant: it may be seen as it is, not relit.
    """

    name: str
    wavelength: NDArray[np.float64]  # (band) nm, increasing
    reflectance: NDArray[np.float32]  # (row, col, band)
    illuminant: NDArray[np.float64] | None  # (band) photons/s/sr/m²/nm of a perfect white, or NO_ILLUMINANT

    def __post_init__(self) -> None:
        bands = self.wavelength.size
        if self.reflectance.ndim != 3 or self.reflectance.shape[2] != bands:
            raise ValueError(f"scene {self.name}: {self.reflectance.shape} samples do not fit {bands} wavelengths")
        if bands > 1 and (np.diff(self.wavelength) <= 0).any():
            raise ValueError(f"scene {self.name}: wavelengths do not increase")
        if self.illuminant is not NO_ILLUMINANT and self.illuminant.shape != (bands,):
            raise ValueError(f"scene {self.name}: the illuminant does not fit {bands} wavelengths")
        if not np.isfinite(self.reflectance).all():
            raise ValueError(f"scene {self.name}: holds values that are not finite")
        brightest = BRIGHTEST_UNLIT if self.illuminant is NO_ILLUMINANT else BRIGHTEST
        if float(np.max(self.reflectance, initial=0.0)) > brightest:
            raise ValueError(f"scene {self.name}: holds values above {brightest:g}, more than light can be; check its white")


@dataclass(frozen=True)
class ChannelPicture:
    """A picture of what the channels of a camera collect, without light, lens and spectra."""

    name: str
    signal: NDArray[np.float32]  # (row, col, channel) ≥ 0; 1: what a perfect white gives the brightest channel

    def __post_init__(self) -> None:
        if not (np.isfinite(self.signal).all() and float(np.max(self.signal, initial=0.0)) <= BRIGHTEST):
            raise ValueError(f"scene {self.name}: holds values that are not finite, or above {BRIGHTEST:g}")


@dataclass(frozen=True)
class SpectralCube:
    """A cube as a file stores it, before anything is known about its scale and light."""

    values: NDArray  # (row, col, band)
    wavelength: NDArray[np.float64] | None  # (band) nm; None: the file does not say
    white: float | None = None  # stored value of a perfect white, where the file states it
