"""Scenes, which are the spectral input of a simulation. They come from files or are drawn by l3."""

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

MAX_TIMES_WHITE = 1e6  # highest value relative to a perfect white, such as the sun beside a sheet of paper
BRIGHTEST_UNLIT = 1e26  # highest value in scenes without an illuminant; large, because linear pictures may have any scale
SHOWN = 390.0, 710.0  # nm; range that drawn scenes cover for every camera, and in which fingerprints are computed
PROJECTIONS = 8  # number of values in a fingerprint
ALIKE = 1e-3  # relative difference below which two fingerprints belong to the same scene; far larger than rounding errors
NO_ILLUMINANT: Final = None  # illuminant of scenes that consist of reflectances only


@dataclass(frozen=True)
class Scene:
    """An image of spectral reflectances, with its illuminant if there is one.

    `reflectance` is the radiance divided by the radiance of a perfect white. It is never negative, and exceeds 1 in specular
    highlights (docs/method.md#simulation). Synthetic scenes, RGB pictures raised to spectra, and cubes of reflectance have
    NO_ILLUMINANT, and can be simulated under any illuminant. If radiance was recorded under an unknown illuminant, the scene
    gets an equal-photon illuminant. Such a scene can be simulated as it was recorded, but not under other illuminants.
    """

    name: str
    wavelength: NDArray[np.float64]  # (band) nm, increasing
    reflectance: NDArray[np.float32]  # (row, col, band)
    illuminant: NDArray[np.float64] | None  # (band) photons/s/sr/m²/nm of a perfect white, or NO_ILLUMINANT
    # (row, col) mask of pixels without data, which were filled from their neighbours; None if there are none
    ignored: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        bands = self.wavelength.size
        if self.reflectance.ndim != 3 or self.reflectance.shape[2] != bands:
            raise ValueError(f"scene {self.name}: samples of shape {self.reflectance.shape} do not fit {bands} wavelengths")
        if bands > 1 and (np.diff(self.wavelength) <= 0).any():
            raise ValueError(f"scene {self.name}: wavelengths do not increase")
        if self.illuminant is not NO_ILLUMINANT and self.illuminant.shape != (bands,):
            raise ValueError(f"scene {self.name}: the illuminant does not fit {bands} wavelengths")
        if not np.isfinite(self.reflectance).all():
            raise ValueError(f"scene {self.name}: contains values that are not finite")
        brightest = BRIGHTEST_UNLIT if self.illuminant is NO_ILLUMINANT else MAX_TIMES_WHITE
        if float(np.max(self.reflectance, initial=0.0)) > brightest:
            raise ValueError(
                f"scene {self.name}: contains values above {brightest:g}, brighter than any light; check its white"
            )

    @functools.cached_property
    def fingerprint(self) -> NDArray[np.float64]:
        """Projections of the reflectances in the range SHOWN, or of all bands if none lie in this range.

        They are the same for every camera.
        """
        inside = (self.wavelength >= SHOWN[0]) & (self.wavelength <= SHOWN[1])
        return _projections(self.reflectance, inside | (not inside.any()))


@dataclass(frozen=True)
class ChannelPicture:
    """A picture of the signals of a camera's channels, without illuminant, lens and spectra."""

    name: str
    signal: NDArray[np.float32]  # (row, col, channel) ≥ 0; 1 is the signal of a perfect white in the brightest channel

    def __post_init__(self) -> None:
        if not (np.isfinite(self.signal).all() and float(np.max(self.signal, initial=0.0)) <= MAX_TIMES_WHITE):
            raise ValueError(f"scene {self.name}: contains values that are not finite, or above {MAX_TIMES_WHITE:g}")

    @functools.cached_property
    def fingerprint(self) -> NDArray[np.float64]:
        """Projections of the signals."""
        return _projections(self.signal, np.ones(self.signal.shape[2], bool))


def _projections(values: NDArray[np.float32], planes: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Project the selected planes of `values` (row, col, plane) onto PROJECTIONS patterns of random signs.

    The projections are divided by the square root of the number of values. Different values give different results. Equal
    values give equal results except for rounding, which varies between machines.
    """

    def signs(axis: int, length: int) -> NDArray[np.float32]:
        return np.random.default_rng([axis, length]).choice(np.array([-1, 1], np.float32), (PROJECTIONS, length))

    rows, cols, count = values.shape
    weights = np.zeros((PROJECTIONS, count), np.float32)
    weights[:, planes] = signs(2, int(planes.sum()))
    across = np.einsum("rck,kc->rk", values @ weights.T, signs(1, cols), dtype=np.float64)
    return np.asarray((across.T * signs(0, rows)).sum(axis=1) / np.sqrt(rows * cols * planes.sum()), np.float64)


def shown_alike(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Return whether two frames show the same scene under the same illuminant.

    Each mapping has the entries "scene" (the fingerprint) and "light".
    """
    first, second = (np.asarray(each["scene"], np.float64) for each in (one, other))
    if one["light"] != other["light"] or first.shape != second.shape:
        return False
    return bool(np.linalg.norm(first - second) <= ALIKE * max(np.linalg.norm(first), np.linalg.norm(second)))


@dataclass(frozen=True)
class SpectralCube:
    """A spectral cube as stored in a file, before its scale and illuminant are known."""

    values: NDArray  # (row, col, band)
    wavelength: NDArray[np.float64] | None  # (band) nm; None if the file does not state them
    white: float | None = None  # stored value of a perfect white, if the file states it
    good: NDArray[np.bool_] | None = None  # (band) false for bands that are marked as bad; None if all are good
    ignored: NDArray[np.bool_] | None = None  # (row, col) mask of pixels that are marked as missing; None if there are none
