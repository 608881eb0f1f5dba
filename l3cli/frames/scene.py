"""A scene: a spectral image from a file or drawn by l3, which a camera model can see."""

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

BRIGHTEST = 1e6  # times a perfect white, such as the sun beside a sheet of paper
BRIGHTEST_UNLIT = 1e26  # limit for scenes without illuminant, since linear pictures may have any scale
SHOWN = 390.0, 710.0  # nm, range that drawn scenes cover for every camera, and that fingerprints compare
PROJECTIONS = 8  # numbers in a fingerprint
ALIKE = 1e-3  # relative difference of fingerprints of one scene; rounding is far smaller, other scenes differ far more
NO_ILLUMINANT: Final = None  # of scenes of reflectances, whose light is not known


@dataclass(frozen=True)
class Scene:
    """A picture of spectral reflectances, and the light in the picture, if it is known.

    `reflectance` is the radiance divided by that of a perfect white. It is ≥ 0, and above 1 in specular highlights
    (docs/method.md#simulation). Synthetic scenes, RGB pictures raised to spectra, and cubes of reflectance have
    NO_ILLUMINANT, and can be lit by any light. Radiance under an unknown light has the equal-photon spectrum as its
    illuminant: it can be seen as it is, but not relit.
    """

    name: str
    wavelength: NDArray[np.float64]  # (band) nm, increasing
    reflectance: NDArray[np.float32]  # (row, col, band)
    illuminant: NDArray[np.float64] | None  # (band) photons/s/sr/m²/nm of a perfect white, or NO_ILLUMINANT
    # (row, col) pixels without data in the file, which are filled from their neighbours; None: there are none
    ignored: NDArray[np.bool_] | None = None

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
            raise ValueError(
                f"scene {self.name}: holds values above {brightest:g}, brighter than any light; check its white"
            )

    @functools.cached_property
    def fingerprint(self) -> NDArray[np.float64]:
        """Projections of the reflectances within SHOWN, or of all if none lie within. They are the same for every camera."""
        inside = (self.wavelength >= SHOWN[0]) & (self.wavelength <= SHOWN[1])
        return _projections(self.reflectance, inside | (not inside.any()))


@dataclass(frozen=True)
class ChannelPicture:
    """A picture of what the channels of a camera collect, without light, lens and spectra."""

    name: str
    signal: NDArray[np.float32]  # (row, col, channel) ≥ 0; 1 is the signal of a perfect white in the brightest channel

    def __post_init__(self) -> None:
        if not (np.isfinite(self.signal).all() and float(np.max(self.signal, initial=0.0)) <= BRIGHTEST):
            raise ValueError(f"scene {self.name}: holds values that are not finite, or above {BRIGHTEST:g}")

    @functools.cached_property
    def fingerprint(self) -> NDArray[np.float64]:
        """Projections of the signals."""
        return _projections(self.signal, np.ones(self.signal.shape[2], bool))


def _projections(values: NDArray[np.float32], planes: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return sums of values (row, col, plane) of the selected planes, weighted by PROJECTIONS patterns of random signs.

    The sums are divided by the square root of the number of values. Different values give different sums; equal values give
    equal sums, except for rounding, which varies between machines.
    """

    def signs(axis: int, length: int) -> NDArray[np.float32]:
        return np.random.default_rng([axis, length]).choice(np.array([-1, 1], np.float32), (PROJECTIONS, length))

    rows, cols, count = values.shape
    weights = np.zeros((PROJECTIONS, count), np.float32)
    weights[:, planes] = signs(2, int(planes.sum()))
    across = np.einsum("rck,kc->rk", values @ weights.T, signs(1, cols), dtype=np.float64)
    return np.asarray((across.T * signs(0, rows)).sum(axis=1) / np.sqrt(rows * cols * planes.sum()), np.float64)


def shown_alike(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Return whether two frames show the same scene under the same light.

    Each mapping has the entries "scene" (the fingerprint) and "light".
    """
    first, second = (np.asarray(each["scene"], np.float64) for each in (one, other))
    if one["light"] != other["light"] or first.shape != second.shape:
        return False
    return bool(np.linalg.norm(first - second) <= ALIKE * max(np.linalg.norm(first), np.linalg.norm(second)))


@dataclass(frozen=True)
class SpectralCube:
    """A spectral cube as a file stores it, before its scale and light are known."""

    values: NDArray  # (row, col, band)
    wavelength: NDArray[np.float64] | None  # (band) nm; None: the file states none
    white: float | None = None  # stored value of a perfect white, if the file states it
    good: NDArray[np.bool_] | None = None  # (band) false for bands that the file calls bad; None: all are good
    ignored: NDArray[np.bool_] | None = None  # (row, col) pixels that the file marks as missing; None: there are none
