"""Train uniform areas on measured reflectances, in addition to patches from scenes (docs/method.md#uniform-surfaces).

Most patches from scenes are textured. A class that is trained only on textures infers colour from detail, and renders
uniform areas in wrong colours. Each class for uniform areas is therefore also trained on measured surfaces with its chroma.
Classes with a direction are trained on the same surfaces, mostly with a small weight. Each surface is used at several
saturations, both bare and mixed with titanium white. White and grey paints are added because they are common in man-made
scenes.

Some chromas occur only in stripes with the period of the CFA. Classes with these chromas are trained to render grey
(docs/method.md#stripes).

If the outputs are the camera's channels, classes for uniform areas are also trained on patches in which each band varies
independently (docs/method.md#single-bands). The training surfaces have smooth spectra. Without independent bands, a class
would treat any deviation from a smooth spectrum as noise, and shift the colours of uniform areas with other spectra.

If the outputs contain S1 and S2, classes for uniform areas are also trained on a polarised grey
(docs/method.md#polarised-grey). A class trained only on textures would infer the polarisation of one colour from the pixels
of the others, also in uniform areas.
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

MODULATIONS = np.linspace(0.3, 0.95, 8)  # modulation depths of the training stripes
CENTRE = 0.65  # modulation depth of the stripes at a chroma centre
MAX_STRIPE_CHROMAS = 8
# Smallest distance between stripes and white, in channel fractions. If it were smaller, noisy greys would count as stripes.
MIN_STRIPE_CHROMA = 0.1
UNLIKE = 0.5  # smallest distance from stripes to the nearest optimal colour, relative to their distance from white
BAND_EDGES = 31  # number of candidate wavelengths for the edges of an optimal colour's bright band
BLACKS = (0.02, 0.1, 0.3)  # reflectances outside the bright band of an optimal colour


def uniform_stripes(cfa: NDArray[np.integer], channels: int) -> Array:
    """Find the stripe patterns that the CFA cannot distinguish from a uniform colour.

    The patterns are sinusoids with a whole number of periods per CFA period, a mean of 0 and an amplitude of 1. A pattern
    has the same value at all sites of a channel, but not at the sites of all channels.

    Parameters
    ----------
    cfa : ndarray, (row, col)
        Channel of each site.
    channels : int
        Number of channels.

    Returns
    -------
    ndarray, (stripe, channel)
        Each pattern's value at the sites of each channel.
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
            stripes.append(means.round(6) + 0.0)  # + 0.0 turns −0 into 0, so that `unique` finds equal stripes
    return np.unique(np.reshape(stripes, (-1, channels)), axis=0)


def false_colours(camera: CameraModel, wavelength: Array, photons: Array) -> Array:
    """Find stripes that the camera records as a colour that no surface can have.

    Candidates are the patterns from `uniform_stripes`. Colours are compared as channel fractions. The distance between a
    pattern and white must be at least `MIN_STRIPE_CHROMA`. The distance to the nearest optimal colour must be at least
    `UNLIKE` times the distance to white.

    Parameters
    ----------
    camera : CameraModel
        Camera with the CFA and the responsivities.
    wavelength : ndarray, (wavelength)
        Wavelengths in nm.
    photons : ndarray, (wavelength)
        Relative photon flux of the illuminant.

    Returns
    -------
    ndarray, (stripe, channel)
        At most `MAX_STRIPE_CHROMAS` patterns, starting with the one that is farthest from all optimal colours.
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
    """Return the chroma centres of stripe patterns on a white surface with the signals `white` (channel).

    The result has the shape (stripe, channel).
    """
    return shares(white * (1.0 + CENTRE * stripes))


def shares(signals: Array) -> Array:
    """Divide signals by their sum over the channels (the last axis)."""
    return np.asarray(signals / signals.sum(axis=-1, keepdims=True))


def optimal_reflectances(wavelength: Array) -> Array:
    """Return reflectances close to Schrödinger's optimal colours, the most saturated colours that a surface can have.

    Each reflectance is 1 either inside or outside a wavelength band. At all other wavelengths, it is one of `BLACKS`.

    Returns
    -------
    ndarray, (surface, wavelength)
    """
    edges = np.linspace(0, wavelength.size, BAND_EDGES).round()
    first, last = np.triu_indices(BAND_EDGES, 1)
    place = np.arange(wavelength.size)
    band = (place >= edges[first, None]) & (place < edges[last, None])
    bright = np.concatenate([band, ~band])
    return np.concatenate([np.where(bright, 1.0, black) for black in BLACKS])


SATURATIONS = (0.2, 0.4, 0.6, 0.8, 1.0)  # saturations of each measured surface, from pale to unchanged
EDGES = 0.1, 0.2, 0.4  # titanium white's ratio of absorption to scattering (K/S) at 405 nm, as in the training scenes
WIDTHS = 6.5, 9.5  # width of titanium white's absorption edge, in nm
BARE = 2  # number of copies of each surface without titanium white; there are six copies with titanium white
GREYS = np.geomspace(0.03, 0.95, 12)  # reflectances of white and grey paints
GREY_SHARE = 100.0  # total weight of the white and grey paints, divided by the total weight of a chroma's other surfaces
OF_WHITE = 3.0  # additional weight of the chroma of white, where a colour cast is most visible
# Typical distance of the chroma of noisy dark greys from the chroma of white, in units of 1 / number of channels
NEAR_WHITE = 0.2
MIN_SURFACES = 4  # smallest number of surfaces per channel for which a chroma is trained
SAME_WHITE = 0.005  # relative tolerance of the white's X, Y, Z, because different wavelength grids change them slightly


@functools.lru_cache(maxsize=4)
def cached_reflectances(wavelength: tuple[float, ...]) -> tuple[Array, int]:
    """Return the reflectances of the training surfaces on a wavelength grid.

    Each measured surface is used at several saturations, both bare and mixed with titanium white.

    Returns
    -------
    reflectances : ndarray, (surface, wavelength)
        The measured surfaces, followed by white and grey paints with titanium white.
    greys : int
        Number of white and grey paints.
    """
    grid = np.array(wavelength)
    paler = np.concatenate([with_saturation(spectra.reflectance_library(grid), each) for each in SATURATIONS])
    paler = np.clip(paler, BLACKEST, WHITEST)
    painted = [with_titanium_white(paler, grid, edge, width) for edge in EDGES for width in WIDTHS]
    greys = np.repeat(GREYS[:, None], grid.size, axis=1)
    whites = [with_titanium_white(greys, grid, edge, width) for edge in EDGES for width in WIDTHS]
    return np.concatenate([paler] * BARE + painted + whites), sum(map(len, whites))


@dataclass(frozen=True)
class PlainSurfaces:
    """Signals and outputs of uniform surfaces under one illuminant, scaled so that white has Y = 1."""

    signals: Array  # (surface, channel) as fractions of full scale
    outputs: Array  # (surface, 3) X, Y, Z
    white: Array  # (channel) signals of white
    greys: int  # number of white and grey paints, which are the last surfaces
    beyond: Array  # (sample, channel) signals of stripes with impossible colours, followed by optimal colours
    beyond_outputs: Array  # (sample, 3) targets X, Y, Z of these samples; the target of all stripes is white
    stripes: int  # number of stripes, which are the first samples of `beyond`

    def moments(self, rule: ClassRule, window: NDArray[np.int64]) -> list[Array | None]:
        """Compute the mean moments of uniform patches for each chroma.

        Parameters
        ----------
        rule : ClassRule
            Class rule of the first layer.
        window : ndarray, (tap)
            Channel of each tap.

        Returns
        -------
        list of (ndarray, (column, column), or None)
            One entry per chroma, or None if the chroma has too few surfaces. The columns are taps, intercept and outputs,
            weighted as in `ClassSums`.
        """
        centres = chroma_centres(rule)
        chroma = _nearest(self.signals, centres)
        every = [self._mean(chroma == each, window) for each in range(rule.chromas)]
        white = int(_nearest(self.white[None], centres)[0])
        if rule.chromas > 1 and (of_white := every[white]) is not None:
            every[white] = OF_WHITE * of_white
        return every

    def nearness(self, rule: ClassRule) -> Array:
        """Return each chroma's closeness to white, from 1 for white to almost 0 for saturated colours."""
        if rule.chromas == 1:
            return np.zeros(1)
        distance = (chroma_centres(rule) - shares(self.white[None])) * rule.channels / NEAR_WHITE
        return np.asarray(np.exp(-(distance**2).sum(axis=1)))

    def moments_of_stripes(self, rule: ClassRule, window: NDArray[np.int64]) -> dict[int, Array]:
        """Compute the mean moments of stripes and optimal colours for chromas that occur only in stripes.

        The parameters are the same as for `moments`.

        Returns
        -------
        dict of int to ndarray, (column, column)
            Moments by chroma.
        """
        if rule.chromas == 1:
            return {}
        chroma = _nearest(self.beyond, chroma_centres(rule))
        stripes = np.bincount(chroma[: self.stripes], minlength=rule.chromas)
        vivid = np.bincount(chroma[self.stripes :], minlength=rule.chromas)
        surfaces = np.bincount(_nearest(self.signals, chroma_centres(rule)), minlength=rule.chromas)
        # Train a chroma on stripes if it contains few surfaces, and at least half as many stripes as there are modulation
        # depths. A chroma with fewer stripes contains only low-contrast stripes.
        theirs = np.flatnonzero((stripes >= len(MODULATIONS) / 2) & (surfaces < MIN_SURFACES * self.signals.shape[1]))
        every = {}
        for each in theirs.tolist():
            # Optimal colours get the same total weight as stripes, because lamps can have colours that no surface has.
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
    """Compute the weighted mean moments of uniform patches. Each sample is a surface or a stripe pattern.

    Parameters
    ----------
    signals : ndarray, (sample, channel)
        Signals of each sample.
    outputs : ndarray, (sample, output)
        Outputs of each sample.
    count : ndarray, (sample)
        Weight of each sample in the mean.
    window : ndarray, (tap)
        Channel of each tap.

    Returns
    -------
    ndarray, (column, column)
        The columns are taps, intercept and outputs.
    """
    weight = count / count.sum() / (signals.mean(axis=1) * outputs[:, 1])
    values = np.concatenate([signals, np.zeros((len(signals), 1)), outputs], axis=1)
    # einsum instead of BLAS, because BLAS results depend on the number of threads
    return at_taps(np.einsum("s,si,sj->ij", weight, values, values, optimize=False), window)


def plain_surfaces(camera: CameraModel, light: LightSpectrum, target: LightSpectrum, white: Array) -> PlainSurfaces | None:
    """Compute the signals and outputs of the training surfaces for a camera and an illuminant.

    Parameters
    ----------
    camera : CameraModel
        Camera with the responsivities.
    light : LightSpectrum
        Illuminant of the scene.
    target : LightSpectrum
        Illuminant under which the outputs X, Y, Z are computed.
    white : ndarray, (output)
        Outputs of a perfect white, with Y = 1.

    Returns
    -------
    PlainSurfaces or None
        None if `white` contradicts the CIE 1931 observer, or if a channel receives no light from some surface.
    """
    grid = light.wavelength  # fine enough for titanium white's absorption edge
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
    # einsum instead of BLAS, because BLAS results depend on the number of threads
    return np.einsum("sw,cw->sc", reflectances, to_signals), np.einsum("sw,ow->so", reflectances, to_outputs)


def _nearest(signals: Array, centres: Array) -> NDArray[np.intp]:
    """Return the index of the chroma centre that is nearest to each sample."""
    return np.argmin(((shares(signals)[:, None] - centres[None]) ** 2).sum(axis=2), axis=1)


BAND_DEVIATION = 0.1  # standard deviation of a band's independent variation, relative to the band's mean


def output_gains(moments: Array, window: NDArray[np.int64]) -> Array | None:
    """Return the slope of each output over its channel's signal in uniform areas, by regression.

    Parameters
    ----------
    moments : ndarray, (column, column)
        Summed moments of uniform patches.
    window : ndarray, (tap)
        Channel of each tap.

    Returns
    -------
    ndarray, (channel), or None
        Ratio of output to signal, or None if a channel has no signal.
    """
    taps, means = window.size, _membership(window) / np.bincount(window)
    signal, both = means.T @ moments[:taps, :taps] @ means, means.T @ moments[:taps, taps + 1 :]
    return np.asarray(both.diagonal() / signal.diagonal()) if signal.diagonal().min() > 0 else None


def single_bands(moments: Array, window: NDArray[np.int64], gains: Array) -> Array:
    """Compute the moments of uniform patches in which each band varies independently around the mean colour of a class.

    The standard deviation of a band, over the patches, is `BAND_DEVIATION` times its mean. The patches have the same total
    weight as the class's training patches.

    Parameters
    ----------
    moments : ndarray, (column, column)
        Moments of the class.
    window : ndarray, (tap)
        Channel of each tap.
    gains : ndarray, (channel)
        Result of `output_gains`.

    Returns
    -------
    ndarray, (column, column)
    """
    taps, member = window.size, _membership(window)
    mean = moments[:taps, taps] @ member / np.bincount(window)  # mean of each band, times the total weight of the patches
    columns = np.concatenate([member, np.zeros((1, gains.size)), np.diag(gains)])
    power = (BAND_DEVIATION * mean) ** 2 / max(moments[taps, taps], 1e-12)
    return np.asarray((columns * power) @ columns.T)


def has_single_bands(rule: ClassRule, index: int) -> bool:
    """Whether a class is also trained on the patches from `single_bands`.

    This applies to unsaturated classes of the lowest contrast, if the class rule distinguishes several contrasts.
    """
    place = rule.split(index)
    return bool(rule.contrasts > 1 and place.contrast == 0 and not rule.case(place.kind))


def _membership(window: NDArray[np.int64]) -> Array:
    """Return a matrix (tap, channel) that is 1 at each tap's channel, and 0 elsewhere."""
    return (window[:, None] == np.arange(window.max() + 1)).astype(np.float64)


POLARISED_NODES = np.array([450.0, 550.0, 650.0])  # nm; wavelengths at which the polarisation of the grey is independent
POLARISED_DEVIATION = 0.1  # standard deviation of S1/S0 and of S2/S0 of the grey at each wavelength


def polarised_grey(camera: CameraModel, light: LightSpectrum, outputs: tuple[str, ...]) -> Array:
    """Compute the moments that polarisation adds to the moments of a uniform grey.

    S1/S0 and S2/S0 vary independently from patch to patch, and at each wavelength of `POLARISED_NODES`. They are
    interpolated linearly between these wavelengths.

    Parameters
    ----------
    camera : CameraModel
        Camera with polarisers.
    light : LightSpectrum
        Illuminant of the scene.
    outputs : tuple of str
        Names of the outputs, which contain S1 and S2.

    Returns
    -------
    ndarray, (column, column)
        The columns are channels, intercept and outputs. The patches have a total weight of 1.
    """
    grid, lit = light.wavelength, light.radiance.astype(np.float64)
    share = np.array([np.interp(grid, POLARISED_NODES, node) for node in np.eye(POLARISED_NODES.size)])
    weights = camera.stokes_weights * camera.channel_gains[:, None] @ spectra.sampling_matrix(grid, camera.wavelength) * lit
    # einsum instead of BLAS, because BLAS results depend on the number of threads
    signals = np.einsum("kcw,nw->knc", weights, share) * (camera.output_unit / camera.full_scale)
    luminance = np.einsum("w,nw->n", spectra.xyz_weights(grid)[1] * lit, share)
    channels = signals.shape[2]
    patterns = np.zeros((2, POLARISED_NODES.size, channels + 1 + len(outputs)))
    for number, name in enumerate(("S1", "S2")):
        patterns[number, :, :channels] = signals[1 + number]
        patterns[number, :, channels + 1 + outputs.index(name)] = luminance / luminance.sum()
    white = signals[0].sum(axis=0).mean()  # mean signal of a white, whose Y is 1
    moments = np.einsum("kni,knj->ij", patterns, patterns, optimize=False)
    return np.asarray(moments * (POLARISED_DEVIATION**2 / white))


def at_taps(moments: Array, window: NDArray[np.int64]) -> Array:
    """Convert moments of uniform patches from the columns channels, intercept and outputs to taps, intercept and outputs."""
    channels = window.max() + 1
    columns = np.concatenate([window, np.arange(channels, len(moments))])  # all taps of a channel have the same value
    return np.asarray(moments[np.ix_(columns, columns)])
