"""Uniform areas of measured surfaces, which are added to the patches of scenes (docs/method.md#plain-surfaces).

Patches of scenes are textured. A class learns to infer colour from their detail, which is wrong on uniform areas, and few
patches are uniform. So each class of uniform areas is also trained on uniform areas of measured surfaces of its colour. They
include paler, bare and painted versions, and white and grey paints, which are common in man-made scenes. Some chromas occur
only in stripes that repeat with the array. Classes of such a chroma are trained to render it as grey
(docs/method.md#stripes).

If the outputs are the channels of the camera, uniform classes are also trained on areas in which each band varies on its own
(docs/method.md#single-bands). Training surfaces have smooth spectra, and few dead leaves have uniform bright areas. Without
this, a class would treat every spectrum that its few colours do not span as noise, and would give all areas of another
material a colour cast. Noise differs from pixel to pixel, whereas a spectrum is common to a whole neighbourhood.
"""

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.training_set import LightSpectrum
from l3cli.classes.chroma import chroma_centres
from l3cli.physics import spectra
from l3cli.physics.spectra import BLACKEST, WHITEST, with_saturation, with_titanium_white

Array = NDArray[np.float64]

MODULATIONS = np.linspace(0.3, 0.95, 8)  # of the stripes in the training
CENTRE = 0.65  # modulation at the centre of a chroma of stripes; the chroma begins half way from there to white
MAX_STRIPE_CHROMAS = 8  # largest number of stripes with a chroma of their own
# Least distance to the chroma of white in channel fractions; nearer, noisy greys would count as stripes
MIN_STRIPE_CHROMA = 0.1
UNLIKE = 0.5  # least distance of stripes to any optimal colour, relative to their distance to white
BAND_EDGES = 31  # wavelengths at which an optimal colour may begin or end
BLACKS = (0.02, 0.1, 0.3)  # reflectances of an optimal colour where it is dark


def uniform_stripes(cfa: NDArray[np.integer], channels: int) -> Array:
    """Return the stripe patterns of an array that look like a uniform colour.

    Parameters
    ----------
    cfa : ndarray, (row, col)
        Channel of each site.
    channels : int

    Returns
    -------
    ndarray, (stripe, channel)
        Value of the stripes at all sites of each channel. Stripes repeat a whole number of times per array, have a mean of 0
        and lie within ±1. All sites of a channel have the same value, and not all channels have the same one.
    """
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
    """Return the stripes of `uniform_stripes` whose colour no surface can have.

    Parameters
    ----------
    camera : CameraModel
    wavelength : ndarray, (wavelength)
        In nm.
    photons : ndarray, (wavelength)
        Relative photon flux of the light.

    Returns
    -------
    ndarray, (stripe, channel)
        Stripes that are far from white, and that differ from each optimal colour by at least `UNLIKE` of their distance to
        white.
    """
    electrons = camera.signal_weights @ spectra.sampling_matrix(wavelength, camera.wavelength) * photons
    white = electrons.sum(axis=1)
    if not white.min() > 0:
        return np.zeros((0, white.size))
    stripes = uniform_stripes(camera.cfa, white.size)
    optimal = shares(np.einsum("sw,cw->sc", optimal_reflectances(wavelength), electrons))
    centres = stripe_shares(white, stripes)
    distance = np.linalg.norm(centres - shares(white[None]), axis=1)
    nearest = np.linalg.norm(centres[:, None] - optimal[None], axis=2).min(axis=1)
    false = (distance >= MIN_STRIPE_CHROMA) & (nearest >= UNLIKE * distance)
    order = np.argsort(-nearest[false], kind="stable")[:MAX_STRIPE_CHROMAS]
    return np.asarray(stripes[false][order])


def stripe_shares(white: Array, stripes: Array) -> Array:
    """Return the chroma centres (stripe, channel) of stripes on a white whose signals are `white` (channel)."""
    return shares(white * (1.0 + CENTRE * stripes))


def shares(signals: Array) -> Array:
    """Return signals (…, channel) divided by their sum."""
    return np.asarray(signals / signals.sum(axis=-1, keepdims=True))


def optimal_reflectances(wavelength: Array) -> Array:
    """Return Schrödinger's optimal colours, the most vivid that a surface can have, and paler versions of them.

    Returns
    -------
    ndarray, (surface, wavelength)
        Reflectances that are bright in one band, or in all but one band, and dark elsewhere.
    """
    edges = np.linspace(0, wavelength.size, BAND_EDGES).round()
    first, last = np.triu_indices(BAND_EDGES, 1)
    place = np.arange(wavelength.size)
    band = (place >= edges[first, None]) & (place < edges[last, None])
    bright = np.concatenate([band, ~band])
    return np.concatenate([np.where(bright, 1.0, black) for black in BLACKS])


SATURATIONS = (0.2, 0.4, 0.6, 0.8, 1.0)  # versions of measured surfaces; most man-made surfaces are paler
EDGES, WIDTHS = (0.1, 0.2, 0.4), (6.5, 9.5)  # of titanium white, as in the training scenes: K/S at 405 nm, and nm
BARE = 2  # copies of each surface without titanium white, which three quarters of the surfaces contain
GREYS = np.geomspace(0.03, 0.95, 12)  # reflectances of paints without dye
GREY_SHARE = 100.0  # weight of all GREYS together, relative to the other surfaces of their chroma
OF_WHITE = 3.0  # weight of the chroma of white, where a colour cast is most visible
NEAR_WHITE = 0.2  # distance to white, relative to the mean channel fraction, that noise gives to dark greys
MIN_SURFACES = 4  # surfaces per channel that a chroma needs
SAME_WHITE = 0.005  # relative tolerance for the white of X, Y, Z on a coarse wavelength grid


@functools.lru_cache(maxsize=4)
def cached_reflectances(wavelength: tuple[float, ...]) -> tuple[Array, int]:
    """Return reflectances (surface, wavelength), and how many of them, at the end, are painted greys."""
    grid = np.array(wavelength)
    paler = np.concatenate([with_saturation(spectra.reflectance_library(grid), each) for each in SATURATIONS])
    paler = np.clip(paler, BLACKEST, WHITEST)
    painted = [with_titanium_white(paler, grid, edge, width) for edge in EDGES for width in WIDTHS]
    greys = np.repeat(GREYS[:, None], grid.size, axis=1)
    whites = [with_titanium_white(greys, grid, edge, width) for edge in EDGES for width in WIDTHS]
    return np.concatenate([paler] * BARE + painted + whites), sum(map(len, whites))


@dataclass(frozen=True)
class PlainSurfaces:
    """Surfaces under a light, scaled so that white has Y = 1."""

    signals: Array  # (surface, channel) fractions of full scale
    outputs: Array  # (surface, 3) X, Y, Z
    white: Array  # (channel) signals of white
    greys: int  # number of paints without dye, which come last
    beyond: Array  # (sample, channel) signals of stripes of false colours, and of optimal colours
    beyond_outputs: Array  # (sample, 3)
    stripes: int  # number of stripes, which come first and have the outputs of white

    def moments(self, rule: ClassRule, window: NDArray[np.int64]) -> list[Array | None]:
        """Return mean moments of uniform patches of the surfaces of each chroma.

        Parameters
        ----------
        rule : ClassRule
        window : ndarray, (tap)
            Channel of each tap.

        Returns
        -------
        list of ndarray (column, column) or None, (chroma)
            Columns and weights are those of the sums. None: the chroma has too few surfaces.
        """
        centres = chroma_centres(rule)
        chroma = _nearest(self.signals, centres)
        every = [self._mean(chroma == each, window) for each in range(rule.chromas)]
        white = int(_nearest(self.white[None], centres)[0])
        if rule.chromas > 1 and (of_white := every[white]) is not None:
            every[white] = OF_WHITE * of_white
        return every

    def nearness(self, rule: ClassRule) -> Array:
        """Return how near each chroma of a rule is to white (chroma): 1 for the chroma of white, down to 0."""
        if rule.chromas == 1:
            return np.zeros(1)
        distance = (chroma_centres(rule) - shares(self.white[None])) * rule.channels / NEAR_WHITE
        return np.asarray(np.exp(-(distance**2).sum(axis=1)))

    def moments_of_stripes(self, rule: ClassRule, window: NDArray[np.int64]) -> dict[int, Array]:
        """Return mean moments of stripes, and of vivid colours like theirs, by chroma.

        Only chromas that consist of stripes alone are included. Parameters are those of `moments`.
        """
        if rule.chromas == 1:
            return {}
        chroma = _nearest(self.beyond, chroma_centres(rule))
        stripes = np.bincount(chroma[: self.stripes], minlength=rule.chromas)
        vivid = np.bincount(chroma[self.stripes :], minlength=rule.chromas)
        surfaces = np.bincount(_nearest(self.signals, chroma_centres(rule)), minlength=rule.chromas)
        # A chroma belongs to stripes if it contains half of the modulations of one; other chromas contain only pale ones.
        theirs = np.flatnonzero((stripes >= len(MODULATIONS) / 2) & (surfaces < MIN_SURFACES * self.signals.shape[1]))
        every = {}
        for each in theirs.tolist():
            # Stripes and vivid colours have the same total weight, because a lamp may have a colour that no surface has.
            count = np.repeat([1 / stripes[each], 1 / max(vivid[each], 1)], [stripes[each], vivid[each]])
            members = chroma == each
            every[each] = _moments(self.beyond[members], self.beyond_outputs[members], count, window)
        return every

    def _mean(self, members: NDArray[np.bool_], window: NDArray[np.int64]) -> Array | None:
        dyed = np.count_nonzero(members[: -self.greys])
        if dyed < MIN_SURFACES * self.signals.shape[1]:
            return None
        count = np.append(np.ones(len(members) - self.greys), np.full(self.greys, GREY_SHARE * dyed / self.greys))[members]
        return _moments(self.signals[members], self.outputs[members], count, window)


def _moments(signals: Array, outputs: Array, count: Array, window: NDArray[np.int64]) -> Array:
    """Return weighted mean moments (column, column) of samples (sample, channel or output)."""
    weight = count / count.sum() / (signals.mean(axis=1) * outputs[:, 1])
    values = np.concatenate([signals, np.zeros((len(signals), 1)), outputs], axis=1)
    # Not by BLAS, whose sums depend on how many threads it has.
    products = np.einsum("s,si,sj->ij", weight, values, values, optimize=False)
    channels = signals.shape[1]
    columns = np.concatenate([window, np.arange(channels, values.shape[1])])  # all taps of a channel are alike
    return np.asarray(products[np.ix_(columns, columns)])


def plain_surfaces(camera: CameraModel, light: LightSpectrum, target: LightSpectrum, white: Array) -> PlainSurfaces | None:
    """Return the surfaces as a camera sees them.

    Parameters
    ----------
    camera : CameraModel
    light : LightSpectrum
        Illuminant of the scene.
    target : LightSpectrum
        Illuminant for which the outputs are computed.
    white : ndarray, (output)
        Outputs of white, Y = 1.

    Returns
    -------
    PlainSurfaces or None
        None if the outputs are not CIE 1931 X, Y, Z, or if a channel receives no light.
    """
    grid = light.wavelength  # as fine as the edge of titanium white needs
    lit = light.radiance.astype(np.float64)
    wanted = spectra.resample(target.radiance.astype(np.float64), target.wavelength, grid)
    electrons = camera.signal_weights @ spectra.sampling_matrix(grid, camera.wavelength) * lit
    matching = spectra.xyz_weights(grid) * wanted
    of_white = matching.sum(axis=1)
    if not of_white.min() > 0 or (np.abs(of_white / of_white[1] - white) > SAME_WHITE * white).any():
        return None
    to_signals = electrons * (camera.output_unit / camera.full_scale)
    to_outputs = matching * (white / of_white)[:, None]
    surfaces, greys = cached_reflectances(tuple(grid))
    signals, outputs = _seen(surfaces, to_signals, to_outputs)
    if not signals.min() > 0:
        return None
    stripes = false_colours(camera, grid, lit)
    modulated = (1.0 + MODULATIONS[:, None, None] * stripes).reshape(-1, len(electrons)) * to_signals.sum(axis=1)
    vivid, vivid_outputs = _seen(optimal_reflectances(grid), to_signals, to_outputs)
    beyond = np.concatenate([modulated, vivid])
    beyond_outputs = np.concatenate([np.broadcast_to(white, (len(modulated), 3)), vivid_outputs])
    return PlainSurfaces(signals, outputs, electrons.sum(axis=1), greys, beyond, beyond_outputs, len(modulated))


def _seen(reflectances: Array, to_signals: Array, to_outputs: Array) -> tuple[Array, Array]:
    """Return signals and outputs of surfaces. BLAS is not used, because its sums depend on the number of threads."""
    return np.einsum("sw,cw->sc", reflectances, to_signals), np.einsum("sw,ow->so", reflectances, to_outputs)


def _nearest(signals: Array, centres: Array) -> NDArray[np.intp]:
    """Return the chroma (sample) of signals (sample, channel)."""
    return np.argmin(((shares(signals)[:, None] - centres[None]) ** 2).sum(axis=2), axis=1)


BAND_DEVIATION = 0.1  # standard deviation of a band that varies on its own, relative to its mean


def output_gains(moments: Array, window: NDArray[np.int64]) -> Array | None:
    """Return the gain from a uniform patch of one channel to the output of that channel, by regression over uniform patches.

    Parameters
    ----------
    moments : ndarray, (column, column)
        Summed moments of uniform patches.
    window : ndarray, (tap)
        Channel of each tap.

    Returns
    -------
    ndarray, (channel), or None
        None if a channel has no signal.
    """
    taps, means = window.size, _membership(window) / np.bincount(window)
    signal, both = means.T @ moments[:taps, :taps] @ means, means.T @ moments[:taps, taps + 1 :]
    return np.asarray(both.diagonal() / signal.diagonal()) if signal.diagonal().min() > 0 else None


def single_bands(moments: Array, window: NDArray[np.int64], gains: Array) -> Array:
    """Return moments of uniform patches in which each band varies on its own.

    Parameters
    ----------
    moments : ndarray, (column, column)
        Moments of a class. The result counts as many patches, and they vary around the mean colour of the class.
    window : ndarray, (tap)
        Channel of each tap.
    gains : ndarray, (channel)
        From `output_gains`.

    Returns
    -------
    ndarray, (column, column)
        The standard deviation of a band is `BAND_DEVIATION` of its mean.
    """
    taps, member = window.size, _membership(window)
    mean = moments[:taps, taps] @ member / np.bincount(window)  # times the number of patches, as weighed
    columns = np.concatenate([member, np.zeros((1, gains.size)), np.diag(gains)])
    power = (BAND_DEVIATION * mean) ** 2 / max(moments[taps, taps], 1e-12)
    return np.asarray((columns * power) @ columns.T)


def teaches(rule: ClassRule, index: int) -> bool:
    """Return whether a class holds unsaturated patches of the lowest of several contrasts."""
    place = rule.split(index)
    return bool(rule.contrasts > 1 and place.contrast == 0 and not rule.case(place.kind))


def _membership(window: NDArray[np.int64]) -> Array:
    """Return 1 where a tap belongs to a channel, otherwise 0, (tap, channel)."""
    return (window[:, None] == np.arange(window.max() + 1)).astype(np.float64)
