"""A scene: a spectral picture from outside, ready to be seen by a camera."""

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

BRIGHTEST = 1e6  # times a perfect white: the sun beside a sheet of paper
BRIGHTEST_UNLIT = 1e26  # of a scene without illuminant: a linear picture may hold values of any scale
SHOWN = 390.0, 710.0  # nm: what drawn scenes hold for every camera, and what is compared of any scene
PROJECTIONS = 8  # in a fingerprint
ALIKE = 1e-3  # relative difference of fingerprints of one scene: rounding is far below, other scenes far above
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
    # (row, col) pixels whose file holds no data for them, where their neighbours' reflectance stands; None: there are none
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
            raise ValueError(f"scene {self.name}: holds values above {brightest:g}, more than light can be; check its white")

    @functools.cached_property
    def fingerprint(self) -> NDArray[np.float64]:
        """Return projections of the reflectances within SHOWN, of all if there are none: the same for any camera."""
        inside = (self.wavelength >= SHOWN[0]) & (self.wavelength <= SHOWN[1])
        return _projections(self.reflectance, inside | (not inside.any()))


@dataclass(frozen=True)
class ChannelPicture:
    """A picture of what the channels of a camera collect, without light, lens and spectra."""

    name: str
    signal: NDArray[np.float32]  # (row, col, channel) ≥ 0; 1: what a perfect white gives the brightest channel

    def __post_init__(self) -> None:
        if not (np.isfinite(self.signal).all() and float(np.max(self.signal, initial=0.0)) <= BRIGHTEST):
            raise ValueError(f"scene {self.name}: holds values that are not finite, or above {BRIGHTEST:g}")

    @functools.cached_property
    def fingerprint(self) -> NDArray[np.float64]:
        """Return the projections of the signals."""
        return _projections(self.signal, np.ones(self.signal.shape[2], bool))


def _projections(values: NDArray[np.float32], planes: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return sums of values (row, col, plane) of some planes under PROJECTIONS patterns of random signs, over the root
    of their number: any other values have other sums, but for rounding, which differs between machines."""

    def signs(axis: int, length: int) -> NDArray[np.float32]:
        return np.random.default_rng([axis, length]).choice(np.array([-1, 1], np.float32), (PROJECTIONS, length))

    rows, cols, count = values.shape
    weights = np.zeros((PROJECTIONS, count), np.float32)
    weights[:, planes] = signs(2, int(planes.sum()))
    across = np.einsum("rck,kc->rk", values @ weights.T, signs(1, cols), dtype=np.float64)
    return np.asarray((across.T * signs(0, rows)).sum(axis=1) / np.sqrt(rows * cols * planes.sum()), np.float64)


def shown_alike(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Return whether two frames show one scene under one light, by "scene" (their fingerprints) and "light" of each."""
    first, second = (np.asarray(each["scene"], np.float64) for each in (one, other))
    if one["light"] != other["light"] or first.shape != second.shape:
        return False
    return bool(np.linalg.norm(first - second) <= ALIKE * max(np.linalg.norm(first), np.linalg.norm(second)))


@dataclass(frozen=True)
class SpectralCube:
    """A cube as a file stores it, before anything is known about its scale and light."""

    values: NDArray  # (row, col, band)
    wavelength: NDArray[np.float64] | None  # (band) nm; None: the file states none
    white: float | None = None  # stored value of a perfect white, where the file states it
    good: NDArray[np.bool_] | None = None  # (band) those that the file does not call bad; None: all
    ignored: NDArray[np.bool_] | None = None  # (row, col) pixels that the file marks as without data; None: there are none
