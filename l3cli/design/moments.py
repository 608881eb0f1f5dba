"""Moments of spectral patches, from which the error of every array follows: gathered once, for one lens, pixel and light
(docs/method.md#designs).

Weights w are (Y + 0.02)^(-2/3), the slope of CIELAB about a grey, or 1. Sums of scenes add up.
"""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.design import GROUPS, KINDS, SIDE, SOFT, WEIGHTINGS

Array = NDArray[np.float64]
Sums = dict[str, Array]  # patches, weight, mean and moment as LightMoments has them; they add up

EDGE, LEVELS = 0.25, (0.06, 0.25)  # from which contrast; mean luminance over white
NEUTRAL = 5.0  # chroma over luminance
CHROMA = np.array([[250, -250, 0], [0, 150, -150]]) / 3.0  # d(a*, b*) / d(XYZ over white), halved
DARKEST, POWER = 0.02, 2 / 3  # of white: below, errors do not weigh more; CIELAB's slope
KEPT = 0.9999  # of the power of spectra
SOFTNESS = 2.0  # pixels, standard deviation of the blur of chroma; S-CIELAB's about 50 pixels a degree
WINDOW = 2  # pixels to each side that tell the group


def empty_sums(terms: int) -> Sums:
    """Return the sums over no patches, of so many terms a tap."""
    kinds, taps = (len(WEIGHTINGS), len(GROUPS)), SIDE**2 * terms
    shapes = {"patches": kinds[1:], "weight": kinds, "mean": (*kinds, taps)}
    shapes["moment"] = (*kinds, taps + SOFT.stop + terms, taps + SOFT.stop + terms)
    return {name: np.zeros(shape) for name, shape in shapes.items()}


def spectral_power(reflectance: NDArray[np.floating], rate: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the second moment (wavelength, wavelength) of photons, of each pixel of a scene (row, col, band) over the
    scene's mean; `rate` (wavelength, band) is that of unit reflectance."""
    pixels = reflectance.reshape(-1, reflectance.shape[-1]).astype(np.float64)
    bands = pixels.T @ pixels / max(float(np.square(pixels.mean())), 1e-12) / len(pixels)
    return np.asarray(rate @ bands @ rate.T)


def principal_spectra(power: Array, white: Array) -> NDArray[np.float64]:
    """Return the basis (wavelength, term) that keeps KEPT of a `power` (wavelength, wavelength), scaled to the mean of
    `white` (wavelength)."""
    values, vectors = np.linalg.eigh(power)
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    held = np.cumsum(values) / values.sum()
    terms = max(int(np.searchsorted(held, KEPT)) + 1, 3)
    signs = np.sign(vectors[np.abs(vectors).argmax(axis=0), np.arange(vectors.shape[1])])
    return np.asarray(vectors[:, :terms] * signs[:terms] * white.mean())


def gather(
    sums: Sums,
    planes: NDArray[np.float32],
    target: NDArray[np.float32],
    sharp: NDArray[np.float32],
    patches: int,
    rng: np.random.Generator,
) -> None:
    """Add patches at random places of a scene to sums.

    `planes` (term, row, col) are coefficients behind the lens, `sharp` the same before it, `target` (XYZ, row, col) over
    white.
    """
    from scipy.ndimage import gaussian_filter

    half, window = np.arange(-(SIDE // 2), SIDE // 2 + 1), np.arange(-WINDOW, WINDOW + 1)
    soft = np.stack([gaussian_filter(plane, SOFTNESS, mode="reflect") for plane in target])
    row, col = (rng.integers(SIDE // 2, length - SIDE // 2, patches) for length in planes.shape[1:])
    z = planes[:, row[:, None, None] + half[:, None], col[:, None, None] + half].transpose(1, 2, 3, 0).reshape(patches, -1)
    group = groups_of(target[:, row[:, None, None] + window[:, None], col[:, None, None] + window])
    entries = np.concatenate([z, target[:, row, col].T, soft[:, row, col].T, sharp[:, row, col].T], axis=1, dtype=np.float32)
    seen = (np.maximum(target[1][row, col], 0) + np.float32(DARKEST)) ** np.float32(-POWER)
    for number in np.unique(group):
        inside = group == number
        sums["patches"][number] += inside.sum()
        for place, weight in enumerate((seen[inside], np.ones(int(inside.sum()), np.float32))):
            rows = entries[inside] * weight[:, None]
            sums["moment"][place, number] += rows.T @ rows
            sums["mean"][place, number] += weight @ rows[:, : z.shape[1]]
            sums["weight"][place, number] += np.square(weight).sum()


def groups_of(around: NDArray[np.float32]) -> NDArray[np.intp]:
    """Return the group of each patch by XYZ over white (XYZ, patch, row, col) of its middle: by hue as classes are, where
    eyes see one."""
    mean = around.mean(axis=(2, 3))
    contrast = around[1].std(axis=(1, 2)) / (mean[1] + 1e-4)
    a, b = CHROMA @ mean / (mean[1] + DARKEST)
    hue = np.where(np.hypot(a, b) < NEUTRAL, 0, np.where(b > 0, np.where(a > 0, 1, 2), np.where(a > 0, 4, 3)))
    kinds = (contrast > EDGE).astype(np.intp), np.searchsorted(LEVELS, mean[1]), hue
    return np.ravel_multi_index(kinds, tuple(map(len, KINDS)))


def in_all_orientations(sums: Sums, terms: int) -> Sums:
    """Return the mean of sums over the eight orientations of every patch: mirrored arrays then have the same error."""
    taps = np.arange(SIDE**2 * terms).reshape(SIDE, SIDE, terms)
    behind = np.arange(taps.size, taps.size + SOFT.stop + terms)
    moment, mean = np.zeros_like(sums["moment"]), np.zeros_like(sums["mean"])
    for turned in (np.rot90(each, turn) for each in (taps, taps.swapaxes(0, 1)) for turn in range(4)):
        order = np.concatenate([turned.ravel(), behind])
        moment += sums["moment"][:, :, order[:, None], order] / 8
        mean += sums["mean"][:, :, turned.ravel()] / 8
    return sums | {"mean": mean, "moment": moment}
