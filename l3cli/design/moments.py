"""Moments of spectral patches, from which the error of every array follows: gathered once, for one lens, pixel and light
(docs/method.md#designs).

Weights w are (Y + 0.02)^(-2/3), the slope of CIELAB about a grey, or 1. Sums of scenes add up.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.design import SOFT, WEIGHTINGS, LightMoments

Array = NDArray[np.float64]

SIDE = 7  # pixels of the neighbourhood that arrays are judged by
LEVEL_EDGES, CONTRAST_EDGES = (0.06, 0.25), (0.06, 0.25)
GROUPS = (len(LEVEL_EDGES) + 1) * (len(CONTRAST_EDGES) + 1)
DARKEST, POWER = 0.02, 2 / 3  # of white: below, errors do not weigh more; CIELAB's slope
KEPT = 0.9999  # of the power of spectra
SOFTNESS = 2.0  # pixels, standard deviation of the blur of chroma; S-CIELAB's about 50 pixels a degree
WINDOW = 2  # pixels to each side that tell the group


@dataclass(frozen=True)
class Gathered:
    """Sums over the patches of some scenes; they add up."""

    patches: Array  # (group)
    weight: Array  # (weighting, group)
    mean: Array  # (weighting, group, coefficient)
    moment: Array  # (weighting, group, entry, entry)

    def __add__(self, other: "Gathered") -> "Gathered":
        return Gathered(*(getattr(self, name) + getattr(other, name) for name in self.__dataclass_fields__))


def spectral_power(reflectance: NDArray[np.floating], rate: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the second moment (wavelength, wavelength) of photons, of each pixel of a scene (row, col, band) over the
    scene's mean; `rate` (wavelength, band) is that of unit reflectance."""
    pixels = reflectance.reshape(-1, reflectance.shape[-1]).astype(np.float64)
    bands = pixels.T @ pixels / max(float(np.square(pixels.mean())), 1e-12) / len(pixels)
    return np.asarray(rate @ bands @ rate.T)


def principal_spectra(power: Array, white: Array) -> tuple[NDArray[np.float64], float]:
    """Return the basis (wavelength, term) that keeps KEPT of a `power` (wavelength, wavelength), scaled to the mean of
    `white` (wavelength), and the share that is lost."""
    values, vectors = np.linalg.eigh(power)
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    held = np.cumsum(values) / values.sum()
    terms = max(int(np.searchsorted(held, KEPT)) + 1, 3)
    signs = np.sign(vectors[np.abs(vectors).argmax(axis=0), np.arange(vectors.shape[1])])
    return vectors[:, :terms] * signs[:terms] * white.mean(), float(max(1.0 - held[terms - 1], 0.0))


def gather(
    planes: NDArray[np.float32],
    target: NDArray[np.float32],
    sharp: NDArray[np.float32],
    patches: int,
    rng: np.random.Generator,
) -> Gathered:
    """Return the sums over patches at random places of a scene.

    `planes` (term, row, col) are coefficients behind the lens, `sharp` the same before it, `target` (XYZ, row, col) over
    white.
    """
    from scipy.ndimage import gaussian_filter

    half, window = np.arange(-(SIDE // 2), SIDE // 2 + 1), np.arange(-WINDOW, WINDOW + 1)
    soft = np.stack([gaussian_filter(plane, SOFTNESS, mode="reflect") for plane in target])
    row, col = (rng.integers(SIDE // 2, length - SIDE // 2, patches) for length in planes.shape[1:])
    z = planes[:, row[:, None, None] + half[:, None], col[:, None, None] + half].transpose(1, 2, 3, 0).reshape(patches, -1)
    around = target[1][row[:, None, None] + window[:, None], col[:, None, None] + window]
    level = around.mean(axis=(1, 2))
    contrast = around.std(axis=(1, 2)) / (level + 1e-4)
    group = np.searchsorted(CONTRAST_EDGES, contrast) * (len(LEVEL_EDGES) + 1) + np.searchsorted(LEVEL_EDGES, level)
    entries = np.concatenate([z, target[:, row, col].T, soft[:, row, col].T, sharp[:, row, col].T], axis=1, dtype=np.float32)
    seen = (np.maximum(target[1][row, col], 0) + np.float32(DARKEST)) ** np.float32(-POWER)
    size, taps = entries.shape[1], z.shape[1]
    total = Gathered(
        np.zeros(GROUPS),
        np.zeros((len(WEIGHTINGS), GROUPS)),
        np.zeros((len(WEIGHTINGS), GROUPS, taps)),
        np.zeros((len(WEIGHTINGS), GROUPS, size, size)),
    )
    for number in np.unique(group):
        inside = group == number
        total.patches[number] = inside.sum()
        for place, weight in enumerate((seen[inside], np.ones(int(inside.sum()), np.float32))):
            rows = entries[inside] * weight[:, None]
            total.moment[place, number] = rows.T @ rows
            total.mean[place, number] = weight @ rows[:, :taps]
            total.weight[place, number] = np.square(weight).sum()
    return total


def tap_symmetries(side: int) -> list[NDArray[np.intp]]:
    """Return the taps (side²) of a patch in each of its eight orientations."""
    taps = np.arange(side * side).reshape(side, side)
    return [np.rot90(each, turn).ravel() for each in (taps, taps.T) for turn in range(4)]


def in_all_orientations(sums: Gathered, terms: int) -> Gathered:
    """Return the mean of sums over the eight orientations of every patch: mirrored arrays then have the same error."""
    taps = SIDE**2 * terms
    behind = np.arange(taps, taps + SOFT.stop + terms)
    moment, mean = np.zeros_like(sums.moment), np.zeros_like(sums.mean)
    for turned in tap_symmetries(SIDE):
        places = (turned[:, None] * terms + np.arange(terms)).ravel()
        order = np.concatenate([places, behind])
        moment += sums.moment[:, :, order[:, None], order] / 8
        mean += sums.mean[:, :, places] / 8
    return Gathered(sums.patches, sums.weight, mean, moment)


def light_moments(illuminant: str, basis: Array, white: Array, lost: float, sums: Gathered) -> LightMoments:
    """Return the moments under a light from the sums of all scenes."""
    sums = in_all_orientations(sums, basis.shape[1])
    return LightMoments(
        illuminant=illuminant,
        basis=basis,
        white_photons=white,
        lost=lost,
        patches=sums.patches,
        weight=sums.weight,
        mean=sums.mean,
        moment=sums.moment,
    )
