"""Plain surfaces: what a uniform area of a real colour gives, beside what patches of scenes teach
(docs/method.md#plain-surfaces).

Patches of scenes are textured. A class follows them where their detail tells something of their colour, which is wrong on
plain areas, and its plain areas are few. So every plain class is also taught uniform areas of measured surfaces of its
colour, as they are and paler, bare and painted; and whites and greys of paint, of which the made world is full. Where there
are none, as the colour is that of stripes which repeat with the array, it is taught that these are grey
(docs/method.md#stripes).

Training surfaces are smooth spectra and plain patches of bright leaves are few. So where the outputs are the camera's
channels, plain classes are also taught that each band may differ by itself (docs/method.md#single-bands): else a class takes
for noise whatever of a spectrum its handful of colours do not span, and casts a colour on all areas of another material.
Noise differs from pixel to pixel; spectrum is what a whole neighbourhood has in common.
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

MODULATIONS = np.linspace(0.3, 0.95, 8)  # of the stripes that are taught
CENTRE = 0.65  # modulation whose colour is the centre of a chroma: half way to white begins what is taken for stripes
FARTHEST = 8  # stripes at most that have a chroma
APART = 0.1  # in shares of the channels, from the chroma of white, or noise takes greys for stripes
UNLIKE = 0.5  # of its distance to white that stripes keep from every optimal colour
BAND_EDGES = 31  # wavelengths at which an optimal colour may begin or end
BLACKS = (0.02, 0.1, 0.3)  # reflectances of an optimal colour where it is dark


def uniform_stripes(cfa: NDArray[np.integer], channels: int) -> Array:
    """Return stripes (stripe, channel) of a whole number of periods in an array `cfa` (row, col) and a mean of 0, that are
    the same value within ±1 at all sites of a channel, and not the same at all channels."""
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
    """Return stripes (stripe, channel), as those of `uniform_stripes`, whose colour no surface can have under a light of
    `photons` at each `wavelength` in nm: none is less than UNLIKE of its distance to white away from an optimal colour, and
    none near white."""
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
    """Return the chroma centres (stripe, channel) of stripes (stripe, channel) on a white of these signals (channel)."""
    return shares(white * (1.0 + CENTRE * stripes))


def shares(signals: Array) -> Array:
    """Return signals (…, channel) over their sum."""
    return np.asarray(signals / signals.sum(axis=-1, keepdims=True))


def optimal_reflectances(wavelength: Array) -> Array:
    """Return reflectances (surface, wavelength) that are bright in one band or in all but one and dark elsewhere:
    Schrödinger's optimal colours, the most vivid that a surface can have, and paler ones."""
    edges = np.linspace(0, wavelength.size, BAND_EDGES).round()
    first, last = np.triu_indices(BAND_EDGES, 1)
    place = np.arange(wavelength.size)
    band = (place >= edges[first, None]) & (place < edges[last, None])
    bright = np.concatenate([band, ~band])
    return np.concatenate([np.where(bright, 1.0, black) for black in BLACKS])


SATURATIONS = (0.2, 0.4, 0.6, 0.8, 1.0)  # of measured surfaces: what is made of them is mostly paler
EDGES, WIDTHS = (0.1, 0.2, 0.4), (6.5, 9.5)  # of titanium white, K/S at 405 nm and nm, as the training scenes have them
BARE = 2  # times each surface counts without titanium white, which three quarters of the surfaces have
GREYS = np.geomspace(0.03, 0.95, 12)  # reflectances of paints without dye
GREY_SHARE = 100.0  # times the other surfaces of their chroma that GREYS together count as
OF_WHITE = 3.0  # times more is taught of white's own chroma, where a cast is seen first
NEAR_WHITE = 0.2  # distance of channel shares, of their mean, at which a chroma is as near as noise brings dark greys
FEWEST = 4  # surfaces a channel, that tell what a chroma is
SAME_WHITE = 0.005  # relative, for a coarse grid: outputs whose white is not that of the light are others


@functools.lru_cache(maxsize=4)
def cached_reflectances(wavelength: tuple[float, ...]) -> tuple[Array, int]:
    """Return reflectances of surfaces (surface, wavelength), and how many of them, the last, are painted greys."""
    grid = np.array(wavelength)
    paler = np.concatenate([with_saturation(spectra.reflectance_library(grid), each) for each in SATURATIONS])
    paler = np.clip(paler, BLACKEST, WHITEST)
    painted = [with_titanium_white(paler, grid, edge, width) for edge in EDGES for width in WIDTHS]
    greys = np.repeat(GREYS[:, None], grid.size, axis=1)
    whites = [with_titanium_white(greys, grid, edge, width) for edge in EDGES for width in WIDTHS]
    return np.concatenate([paler] * BARE + painted + whites), sum(map(len, whites))


@dataclass(frozen=True)
class PlainSurfaces:
    """Surfaces under a light, of which a white has Y = 1."""

    signals: Array  # (surface, channel) shares of full scale
    outputs: Array  # (surface, 3) X, Y, Z
    white: Array  # (channel) signals of white
    greys: int  # how many of them, the last, are paints without dye
    beyond: Array  # (sample, channel) signals of stripes of false colours, and of optimal colours
    beyond_outputs: Array  # (sample, 3)
    stripes: int  # how many of them, the first, are stripes, whose outputs are those of white

    def moments(self, rule: ClassRule, window: NDArray[np.int64]) -> list[Array | None]:
        """Return mean moments (column, column) of uniform patches of the surfaces of each chroma of a rule, columns and
        weights as of sums; None: too few surfaces to tell. `window` (tap) names channels."""
        centres = chroma_centres(rule)
        chroma = _nearest(self.signals, centres)
        every = [self._mean(chroma == each, window) for each in range(rule.chromas)]
        white = int(_nearest(self.white[None], centres)[0])
        if rule.chromas > 1 and (of_white := every[white]) is not None:
            every[white] = OF_WHITE * of_white
        return every

    def nearness(self, rule: ClassRule) -> Array:
        """Return the nearness to white (chroma) of each chroma of a rule: 1 for white's own, falling off to 0."""
        if rule.chromas == 1:
            return np.zeros(1)
        distance = (chroma_centres(rule) - shares(self.white[None])) * rule.channels / NEAR_WHITE
        return np.asarray(np.exp(-(distance**2).sum(axis=1)))

    def moments_of_stripes(self, rule: ClassRule, window: NDArray[np.int64]) -> dict[int, Array]:
        """Return, as `moments`, of stripes and what else has their colours, by chroma: those of stripes alone."""
        if rule.chromas == 1:
            return {}
        chroma = _nearest(self.beyond, chroma_centres(rule))
        stripes = np.bincount(chroma[: self.stripes], minlength=rule.chromas)
        vivid = np.bincount(chroma[self.stripes :], minlength=rule.chromas)
        surfaces = np.bincount(_nearest(self.signals, chroma_centres(rule)), minlength=rule.chromas)
        # Their chroma has most modulations of one, others may have the palest.
        theirs = np.flatnonzero((stripes >= len(MODULATIONS) / 2) & (surfaces < FEWEST * self.signals.shape[1]))
        every = {}
        for each in theirs.tolist():
            # Both count alike, however many: a lamp may have a colour that no surface has.
            count = np.repeat([1 / stripes[each], 1 / max(vivid[each], 1)], [stripes[each], vivid[each]])
            members = chroma == each
            every[each] = _moments(self.beyond[members], self.beyond_outputs[members], count, window)
        return every

    def _mean(self, members: NDArray[np.bool_], window: NDArray[np.int64]) -> Array | None:
        dyed = np.count_nonzero(members[: -self.greys])
        if dyed < FEWEST * self.signals.shape[1]:
            return None
        count = np.append(np.ones(len(members) - self.greys), np.full(self.greys, GREY_SHARE * dyed / self.greys))[members]
        return _moments(self.signals[members], self.outputs[members], count, window)


def _moments(signals: Array, outputs: Array, count: Array, window: NDArray[np.int64]) -> Array:
    """Return mean moments (column, column) of samples (sample, channel or output) that count unlike."""
    weight = count / count.sum() / (signals.mean(axis=1) * outputs[:, 1])
    values = np.concatenate([signals, np.zeros((len(signals), 1)), outputs], axis=1)
    # Not by BLAS, whose sums depend on how many threads it has.
    products = np.einsum("s,si,sj->ij", weight, values, values, optimize=False)
    channels = signals.shape[1]
    columns = np.concatenate([window, np.arange(channels, values.shape[1])])  # all taps of a channel are alike
    return np.asarray(products[np.ix_(columns, columns)])


def plain_surfaces(camera: CameraModel, light: LightSpectrum, target: LightSpectrum, white: Array) -> PlainSurfaces | None:
    """Return surfaces as the camera sees them under `light`, with outputs under `target`; None if the outputs, of which a
    white has `white` at Y = 1, are not CIE 1931 X, Y, Z, or the light gives a channel nothing."""
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
    """Return signals and outputs of surfaces (surface, wavelength). Not by BLAS, whose sums depend on its threads."""
    return np.einsum("sw,cw->sc", reflectances, to_signals), np.einsum("sw,ow->so", reflectances, to_outputs)


def _nearest(signals: Array, centres: Array) -> NDArray[np.intp]:
    """Return the chroma (sample) of signals (sample, channel)."""
    return np.argmin(((shares(signals)[:, None] - centres[None]) ** 2).sum(axis=2), axis=1)


SPREAD = 0.1  # standard deviation of one band by itself, of its mean


def output_gains(moments: Array, window: NDArray[np.int64]) -> Array | None:
    """Return the gain (channel) from a flat patch of one channel to the output of that channel, by regression over plain
    patches of summed `moments` (column, column); None if a channel has no signal there. `window` (tap) names channels."""
    taps, means = window.size, _membership(window) / np.bincount(window)
    signal, both = means.T @ moments[:taps, :taps] @ means, means.T @ moments[:taps, taps + 1 :]
    return np.asarray(both.diagonal() / signal.diagonal()) if signal.diagonal().min() > 0 else None


def single_bands(moments: Array, window: NDArray[np.int64], gains: Array) -> Array:
    """Return moments (column, column) of flat patches, as many as make up those of a class, `moments`: they differ from the
    mean colour of these in each band by itself, by SPREAD of it. `gains` as from `output_gains`."""
    taps, member = window.size, _membership(window)
    mean = moments[:taps, taps] @ member / np.bincount(window)  # times the number of patches, as weighed
    columns = np.concatenate([member, np.zeros((1, gains.size)), np.diag(gains)])
    power = (SPREAD * mean) ** 2 / max(moments[taps, taps], 1e-12)
    return np.asarray((columns * power) @ columns.T)


def teaches(rule: ClassRule, index: int) -> bool:
    """Return whether patches of a class are plain: of the lowest of several contrasts, and nothing saturated."""
    place = rule.split(index)
    return bool(rule.contrasts > 1 and place.contrast == 0 and not rule.case(place.kind))


def _membership(window: NDArray[np.int64]) -> Array:
    """Return 1 where a tap is of a channel (tap, channel)."""
    return (window[:, None] == np.arange(window.max() + 1)).astype(np.float64)
