"""Plain surfaces: what a uniform area of a real colour gives, beside what patches of scenes teach
(docs/method.md#plain-surfaces).

Patches of scenes are textured. A class follows them where their detail tells something of their colour, which is wrong on
plain areas, and its plain areas are few. So every plain class is also taught uniform areas of measured surfaces of its
colour, as they are and paler, bare and painted; and whites and greys of paint, of which the made world is full. Where there
are none, as the colour is that of stripes which repeat with the array, it is taught that these are grey.
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
from l3cli.physics.paint import LARGEST, SMALLEST, with_saturation, with_titanium_white
from l3cli.training.stripes import MODULATIONS, false_colours, optimal_reflectances, shares

Array = NDArray[np.float64]

SATURATIONS = (0.2, 0.4, 0.6, 0.8, 1.0)  # of measured surfaces: what is made of them is mostly paler
EDGES, WIDTHS = (0.1, 0.2, 0.4), (6.5, 9.5)  # of titanium white, K/S at 405 nm and nm, as the training scenes have them
BARE = 2  # times each surface counts without titanium white, which three quarters of the surfaces have
GREYS = np.geomspace(0.03, 0.95, 12)  # reflectances of paints without dye …
GREY_SHARE = 6.0  # … which together count as much as so many times the other surfaces of their chroma
OF_WHITE = 3.0  # times more is taught of white's own chroma, where a cast is seen first
NEAR_WHITE = 0.2  # distance of channel shares, of their mean, at which a chroma is as near as noise brings dark greys
FEWEST = 4  # surfaces a channel, that tell what a chroma is
SAME_WHITE = 0.005  # relative, for a coarse grid: outputs whose white is not that of the light are others


@functools.lru_cache(maxsize=4)
def cached_reflectances(wavelength: tuple[float, ...]) -> tuple[Array, Array]:
    """Reflectances of surfaces (surface, wavelength), and of painted greys."""
    grid = np.array(wavelength)
    paler = np.concatenate([with_saturation(spectra.reflectance_library(grid), each) for each in SATURATIONS])
    paler = np.clip(paler, SMALLEST, LARGEST)
    painted = [with_titanium_white(paler, grid, edge, width) for edge in EDGES for width in WIDTHS]
    greys = np.repeat(GREYS[:, None], grid.size, axis=1)
    whites = [with_titanium_white(greys, grid, edge, width) for edge in EDGES for width in WIDTHS]
    return np.concatenate([paler] * BARE + painted), np.concatenate(whites)


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
        """Mean moments (column, column) of uniform patches of the surfaces of each chroma of a rule, columns and weights as
        of sums; None: too few surfaces to tell. `window` (tap) names channels."""
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
        """As `moments`, of stripes and what else has their colours, by chroma: those that stripes have for themselves."""
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
    """Mean moments (column, column) of samples (sample, channel or output) that count unlike."""
    weight = count / count.sum() / (signals.mean(axis=1) * outputs[:, 1])
    values = np.concatenate([signals, np.zeros((len(signals), 1)), outputs], axis=1)
    # Not by BLAS, whose sums depend on how many threads it has.
    products = np.einsum("s,si,sj->ij", weight, values, values, optimize=False)
    channels = signals.shape[1]
    columns = np.concatenate([window, np.arange(channels, values.shape[1])])  # all taps of a channel are alike
    return np.asarray(products[np.ix_(columns, columns)])


def plain_surfaces(camera: CameraModel, light: LightSpectrum, target: LightSpectrum, white: Array) -> PlainSurfaces | None:
    """Surfaces as the camera sees them under `light`, with outputs under `target`; None if the outputs, of which a white
    has `white` at Y = 1, are not CIE 1931 X, Y, Z, or the light gives a channel nothing."""
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
    signals, outputs = _seen(np.concatenate([surfaces, greys]), to_signals, to_outputs)
    if not signals.min() > 0:
        return None
    stripes = false_colours(camera, grid, lit)
    modulated = (1.0 + MODULATIONS[:, None, None] * stripes).reshape(-1, len(electrons)) * to_signals.sum(axis=1)
    vivid, vivid_outputs = _seen(optimal_reflectances(grid), to_signals, to_outputs)
    beyond = np.concatenate([modulated, vivid])
    beyond_outputs = np.concatenate([np.broadcast_to(white, (len(modulated), 3)), vivid_outputs])
    return PlainSurfaces(signals, outputs, electrons.sum(axis=1), len(greys), beyond, beyond_outputs, len(modulated))


def _seen(reflectances: Array, to_signals: Array, to_outputs: Array) -> tuple[Array, Array]:
    """Signals and outputs of surfaces (surface, wavelength). Not by BLAS, whose sums depend on how many threads it has."""
    return np.einsum("sw,cw->sc", reflectances, to_signals), np.einsum("sw,ow->so", reflectances, to_outputs)


def _nearest(signals: Array, centres: Array) -> NDArray[np.intp]:
    """The chroma (sample) of signals (sample, channel)."""
    return np.argmin(((shares(signals)[:, None] - centres[None]) ** 2).sum(axis=2), axis=1)
