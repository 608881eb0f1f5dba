"""Stripes that repeat with the array, and so are a uniform area of a false colour to it (docs/method.md#stripes)."""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.physics import spectra

Array = NDArray[np.float64]

MODULATIONS = np.linspace(0.3, 0.95, 8)  # of the stripes that are taught
CENTRE = 0.65  # modulation whose colour is the centre of a chroma: half way to white begins what is taken for stripes
FARTHEST = 8  # stripes at most that have a chroma
APART = 0.1  # in shares of the channels, from the chroma of white, or noise takes greys for stripes
UNLIKE = 0.5  # of its distance to white that stripes keep from every optimal colour
EDGES = 31  # wavelengths at which an optimal colour may begin or end
BLACKS = (0.02, 0.1, 0.3)  # reflectances of an optimal colour where it is dark


def uniform_stripes(cfa: NDArray[np.integer], channels: int) -> Array:
    """Stripes (stripe, channel) of a whole number of periods in an array `cfa` (row, col) and a mean of 0, that are the same
    value within ±1 at all sites of a channel, and not the same at all channels."""
    rows, cols = cfa.shape
    sites = np.stack([cfa == channel for channel in range(channels)]).reshape(channels, -1)
    sites = sites / sites.sum(axis=1, keepdims=True)
    down, across = np.mgrid[:rows, :cols]
    stripes = []
    for u, v, quarter in np.ndindex(rows, cols, 4):
        wave = np.cos(2 * np.pi * (u * down / rows + v * across / cols) + np.pi / 2 * quarter).ravel()
        means = sites @ wave
        if np.ptp(means) > 0.5 and np.allclose(sites @ wave**2, means**2, atol=1e-9):
            stripes.append(means.round(6) + 0.0)  # no −0: equal stripes are one
    return np.unique(np.reshape(stripes, (-1, channels)), axis=0)


def false_colours(camera: CameraModel, wavelength: Array, photons: Array) -> Array:
    """Stripes (stripe, channel), as those of `uniform_stripes`, whose colour no surface can have under a light of `photons`
    at each `wavelength` in nm: none is less than UNLIKE of its distance to white away from an optimal colour, and none
    near white."""
    electrons = camera.signal_weights @ spectra.sampling_matrix(wavelength, camera.wavelength) * photons
    white = electrons.sum(axis=1)
    if not white.min() > 0:
        return np.zeros((0, white.size))
    stripes = uniform_stripes(camera.cfa, white.size)
    optimal = shares(np.einsum("sw,cw->sc", optimal_reflectances(wavelength), electrons))
    centres = stripe_shares(white, stripes)
    distance = np.linalg.norm(centres - shares(white[None]), axis=1)
    nearest = np.linalg.norm(centres[:, None] - optimal[None], axis=2).min(axis=1)
    false = (distance >= APART) & (nearest >= UNLIKE * distance)
    order = np.argsort(-nearest[false], kind="stable")[:FARTHEST]
    return np.asarray(stripes[false][order])


def stripe_shares(white: Array, stripes: Array) -> Array:
    """The chroma centres (stripe, channel) of stripes (stripe, channel) on a white of these signals (channel)."""
    return shares(white * (1.0 + CENTRE * stripes))


def shares(signals: Array) -> Array:
    """Signals (…, channel) over their sum."""
    return np.asarray(signals / signals.sum(axis=-1, keepdims=True))


def optimal_reflectances(wavelength: Array) -> Array:
    """Reflectances (surface, wavelength) that are bright in one band or in all but one and dark elsewhere: Schrödinger's
    optimal colours, the most vivid that a surface can have, and paler ones."""
    edges = np.linspace(0, wavelength.size, EDGES).round()
    first, last = np.triu_indices(EDGES, 1)
    place = np.arange(wavelength.size)
    band = (place >= edges[first, None]) & (place < edges[last, None])
    bright = np.concatenate([band, ~band])
    return np.concatenate([np.where(bright, 1.0, black) for black in BLACKS])
