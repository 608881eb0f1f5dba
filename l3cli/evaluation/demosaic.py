"""Untrained demosaicking methods, the baselines for tables.

A method converts a mosaic (row, col), which begins at CFA site (0, 0), to one plane per channel (channel, row, col). Methods
for bands require a mosaic in which a perfect white is 1 in every band (docs/method.md#baselines-for-bands). At the borders,
mosaics are mirrored so that the CFA pattern continues.
"""

import functools
import importlib.util
import itertools
import math
import warnings
from collections.abc import Callable, Mapping
from importlib.metadata import EntryPoint

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d, gaussian_filter

from l3cli.errors import L3Error
from l3cli.evaluation.quality import cropped
from l3cli.frames.frame import pad_mosaic
from l3cli.physics.mosaic import tiled
from l3cli.system.plugins import BASELINES, blamed, described, plugins

Array = NDArray[np.floating]
CFA = NDArray[np.uint8]
Demosaic = Callable[[Array, CFA], Array]
Direction = tuple[int, int]  # row offset and column offset
DIRECTIONS: tuple[Direction, ...] = tuple((down, right) for down in (-1, 0, 1) for right in (-1, 0, 1) if down or right)
# Mirrored margin for band methods, in CFA periods. It is wider than the support of the methods, which wrap around at the
# border.
BAND_MARGIN_PERIODS = 4
CODES = 255.0  # value of a perfect white for PPID, whose weights contain a constant for 8-bit values
# σ of the Gaussian, relative to the mean distance between a channel's samples; the best value for dead leaves with a
# five-band CFA.
SIGMA_SAMPLES = 0.55
BAYER_MARGIN_PIXELS = 8  # mirrored margin for Bayer methods: even, and wider than their support


def interpolate(mosaic: Array, cfa: CFA) -> Array:
    """Interpolate each channel of any CFA independently, by normalised convolution (Knutsson and Westin 1993).

    The result is the Gaussian-weighted mean of the channel's samples around each pixel, which is exact in uniform areas.
    """
    channel = tiled(cfa, mosaic.shape)
    planes = []
    for index in range(int(cfa.max()) + 1):
        sampled = (channel == index).astype(np.float64)
        sigma = SIGMA_SAMPLES * np.sqrt(cfa.size / (cfa == index).sum())
        reach = max(cfa.shape)  # within this distance, every pixel has a sample of every channel
        planes.append(
            gaussian_filter(mosaic * sampled, sigma, mode="mirror", radius=reach)
            / gaussian_filter(sampled, sigma, mode="mirror", radius=reach)
        )
    return np.array(planes)


def malvar(mosaic: Array, cfa: CFA) -> Array:
    """Demosaick a Bayer mosaic by the method of Malvar, He and Cutler (2004), using colour-demosaicing."""
    return _by_colour_demosaicing("demosaicing_CFA_Bayer_Malvar2004", mosaic, cfa)


def menon(mosaic: Array, cfa: CFA) -> Array:
    """Demosaick a Bayer mosaic by the method of Menon, Andriani and Calvagno (2007), using colour-demosaicing."""
    return _by_colour_demosaicing("demosaicing_CFA_Bayer_Menon2007", mosaic, cfa)


def baselines(cfa: CFA) -> dict[str, Demosaic]:
    """Return the available baselines for XYZ tables with a CFA, as name → demosaicking method.

    "basic" is always included.
    """
    return _with_plugins({"basic": interpolate} | _bayer_baselines(cfa), cfa)


def band_baselines(cfa: CFA) -> dict[str, Demosaic]:
    """Return the available baselines for tables with the camera's bands as outputs, as name → demosaicking method.

    If every band occurs once per CFA period, these are "bilinear", "sd" and "ppid". For a Bayer CFA, they are "bilinear"
    and, if colour-demosaicing is installed, "malvar" and "menon". For any other CFA, there is only "basic". Methods from
    plugins are added.
    """
    if occurs_once(cfa):
        return _with_plugins({"bilinear": bilinear, "sd": spectral_difference, "ppid": ppi_difference}, cfa)
    if bayer_roles(cfa) is not None:
        return _with_plugins({"bilinear": bilinear} | _bayer_baselines(cfa), cfa)
    return _with_plugins({"basic": interpolate}, cfa)


def stokes_baselines(cfa: CFA) -> dict[str, Demosaic]:
    """Return the baseline for a monochrome polarisation camera, as name → demosaicking method."""
    return {"bilinear": bilinear} if occurs_once(cfa) else {"basic": interpolate}


def best_of_bands(cfa: CFA) -> Demosaic:
    """Return the best built-in demosaicking method for the bands of a CFA.

    This is PPID if every band occurs once per CFA period. For a Bayer CFA, it is the method of Menon et al. if
    colour-demosaicing is installed. Otherwise, it is normalised convolution.
    """
    if occurs_once(cfa):
        return ppi_difference
    return _bayer_baselines(cfa).get("menon", interpolate)


def bayer_roles(cfa: CFA) -> tuple[int, int, int] | None:
    """Return the channel indices that a Bayer method treats as red, green and blue, or None for any other CFA.

    Green is the channel that occurs twice, on a diagonal.
    """
    if cfa.shape != (2, 2) or sorted(np.bincount(cfa.ravel()).tolist()) != [1, 1, 2]:
        return None
    for one, other in (((0, 0), (1, 1)), ((0, 1), (1, 0))):
        if cfa[one] == cfa[other]:
            green = int(cfa[one])
            first, second = sorted({0, 1, 2} - {green})
            return first, green, second
    return None


def _bayer_baselines(cfa: CFA) -> dict[str, Demosaic]:
    known = bayer_roles(cfa) is not None and importlib.util.find_spec("colour_demosaicing") is not None
    return {"malvar": malvar, "menon": menon} if known else {}


def _with_plugins(known: dict[str, Demosaic], cfa: CFA) -> dict[str, Demosaic]:
    """Add the methods of installed plugins to `known` (docs/python.md#a-baseline).

    Raises L3Error if a plugin fails, or if it has the name of a method in `known`.
    """
    methods = dict(known)
    for name, entry in plugins(BASELINES).items():
        if name in known:
            raise L3Error(f"{described(entry)} has the same name as a built-in baseline; rename the plugin")
        with blamed(entry):
            method = entry.load()(cfa)
        if method is not None:
            methods[name] = functools.partial(_interpolated_by, entry, method)
    return methods


def _interpolated_by(entry: EntryPoint, method: Callable[[Array], Array], mosaic: Array, cfa: CFA) -> Array:
    """Demosaick a mosaic with a plugin's method. Raises L3Error if it fails or returns an invalid result."""
    with blamed(entry):
        planes = np.asarray(method(mosaic), np.float64)
        shape = (int(cfa.max()) + 1, *mosaic.shape)
        if planes.shape != shape:
            raise ValueError(f"the result has the shape {planes.shape}; return an array with the shape {shape}")
        if not np.isfinite(planes).all():
            raise ValueError("the result contains NaN or infinite values; return finite values")
    return planes


def _by_colour_demosaicing(name: str, mosaic: Array, cfa: CFA) -> Array:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import colour_demosaicing

        roles = bayer_roles(cfa)
        assert roles is not None
        letter = dict(zip(roles, "RGB", strict=True))
        pattern = "".join(letter[int(channel)] for channel in cfa.ravel())
        # The padding of colour-demosaicing would interrupt the CFA pattern.
        padded = pad_mosaic(mosaic, BAYER_MARGIN_PIXELS, cfa.shape)
        planes = cropped(np.moveaxis(getattr(colour_demosaicing, name)(padded, pattern), -1, 0), BAYER_MARGIN_PIXELS)
    return planes[[roles.index(channel) for channel in range(3)]]


# ------------------------------------------------------------------------------- published methods for multispectral CFAs


def occurs_once(cfa: CFA) -> bool:
    """Whether every band occurs exactly once per period of a CFA with at least 2×2 sites."""
    return min(cfa.shape) > 1 and int(cfa.max()) + 1 == cfa.size == np.unique(cfa).size


def bilinear(mosaic: Array, cfa: CFA) -> Array:
    """Interpolate every band independently by weighted bilinear interpolation (Brauers and Aach 2006).

    The weights decrease linearly to zero at a distance of one period. For a Bayer CFA, this is ordinary bilinear
    interpolation.
    """
    return _by_site(mosaic, cfa, lambda padded: lambda site: _interpolated(padded, cfa, site))


def spectral_difference(mosaic: Array, cfa: CFA) -> Array:
    """Interpolate differences between bands (Brauers and Aach, "A color filter array based multispectral camera", 2006).

    To compute all bands at the pixels of band l, the method interpolates band l bilinearly and subtracts it from all
    samples. It interpolates these differences at the pixels of band l, and adds the samples of band l.
    """

    def method(padded: Array) -> Callable[[Direction], Array]:
        plain = _all_sites(padded, cfa, lambda site: _interpolated(padded, cfa, site))

        def at(site: Direction) -> Array:
            return _samples(padded, cfa, site) + _interpolated(padded - plain[cfa[site]], cfa, site)

        return at

    return _by_site(mosaic, cfa, method)


def ppi_difference(mosaic: Array, cfa: CFA) -> Array:
    """Demosaick with PPID, for a CFA in which every band occurs once per period (`occurs_once`).

    The pseudo-panchromatic image is an estimate of the mean of all bands. The method subtracts it from all samples,
    interpolates the differences along edges, and adds it again (Mihoubi, Losson, Mathon and Macaire, "Multispectral
    demosaicing using pseudo-panchromatic image", IEEE Trans. Computational Imaging 3, 2017, equations 21 to 34).
    """

    def method(padded: Array) -> Callable[[Direction], Array]:
        values = CODES * padded
        weights = _edge_weights(values, cfa.shape)
        panchromatic = _panchromatic(values, cfa.shape, weights)

        def at(site: Direction) -> Array:
            difference = _interpolated(values - panchromatic, cfa, site, weights)
            return (_samples(panchromatic, cfa, site) + difference) / CODES

        return at

    return _by_site(mosaic, cfa, method)


def _panchromatic(values: Array, period: tuple[int, ...], weights: Mapping[Direction, Array]) -> Array:
    """Estimate the mean of all bands at each pixel of a mosaic (row, col), by equations 23 to 28 of Mihoubi et al. (2017).

    At each pixel, l3 subtracts the sample from the average over one period around the pixel. The result is each pixel's
    sample, plus the weighted mean of these differences at the pixel's neighbours one period away.
    """
    smooth = values
    for axis, length in enumerate(period):
        kernel = np.ones(length) if length % 2 else np.convolve(np.ones(length), (0.5, 0.5))
        smooth = correlate1d(smooth, kernel / length, axis, mode="wrap")
    total, norm = np.zeros(values.shape), np.zeros(values.shape)
    for each in DIRECTIONS:
        total += weights[each] * _moved(smooth - values, _step(each, period))
        norm += weights[each]
    sharp: Array = values + total / norm
    return sharp


def _edge_weights(values: Array, period: tuple[int, ...]) -> dict[Direction, Array]:
    """Return the weights (row, col) of neighbours in each direction, by equations 25 to 27 of Mihoubi et al. (2017).

    The more a band changes over one period in a direction, the smaller the weight. For the direction (0, 0), all weights are
    1.
    """
    weights: dict[Direction, Array] = {(0, 0): np.ones(values.shape)}
    for down, right in DIRECTIONS:
        change = np.abs(values - _moved(values, _step((down, right), period)))
        total = np.ones(values.shape)
        for ahead, aside in itertools.product((0, 1), (-1, 0, 1)):
            if down and right:
                place = ((ahead + (aside < 0)) * down, (ahead + (aside > 0)) * right)
            else:
                place = (ahead * down + aside * right, ahead * right + aside * down)
            total += (2 - ahead) * (2 - abs(aside)) * _moved(change, place)
        weights[down, right] = 1.0 / total
    return weights


# ------------------------------------------------------------------------------------------------------ interpolation


def _interpolated(plane: Array, cfa: CFA, site: Direction, weights: Mapping[Direction, Array] | None = None) -> Array:
    """Interpolate all bands (band, row, col) at the pixels of a CFA site.

    The samples of `plane` within one period are weighted by factors that decrease linearly with the distances in rows and
    columns, and by the `weights` of their direction, if any. The site's own band keeps its samples.
    """
    total = np.zeros((int(cfa.max()) + 1, *_samples(plane, cfa, site).shape))
    norm = np.zeros_like(total)
    for down, right in itertools.product(*(range(1 - length, length) for length in cfa.shape)):
        band = cfa[(site[0] + down) % cfa.shape[0], (site[1] + right) % cfa.shape[1]]
        share: float | Array = float((cfa.shape[0] - abs(down)) * (cfa.shape[1] - abs(right)))
        if weights is not None:
            share = share * _samples(weights[int(np.sign(down)), int(np.sign(right))], cfa, site)
        total[band] += share * _samples(plane, cfa, site, (down, right))
        norm[band] += share
    bands: Array = total / norm
    bands[cfa[site]] = _samples(plane, cfa, site)
    return bands


def _by_site(mosaic: Array, cfa: CFA, method: Callable[[Array], Callable[[Direction], Array]]) -> Array:
    """Pad a mosaic, demosaick the pixels of each CFA site, and remove the margin.

    `method` converts the padded mosaic to a function that computes all bands at the pixels of a site.
    """
    margin = BAND_MARGIN_PERIODS * math.lcm(*cfa.shape)
    return cropped(_all_sites(padded := pad_mosaic(mosaic, margin, cfa.shape), cfa, method(padded)), margin)


def _all_sites(padded: Array, cfa: CFA, at: Callable[[Direction], Array]) -> Array:
    bands = np.empty((int(cfa.max()) + 1, *padded.shape))
    for row, col in np.ndindex(*cfa.shape):
        bands[:, row :: cfa.shape[0], col :: cfa.shape[1]] = at((row, col))
    return bands


def _samples(plane: Array, cfa: CFA, site: Direction, offset: Direction = (0, 0)) -> Array:
    """Return the values of a plane at `offset` from the pixels of a CFA site. The plane wraps around at its borders."""
    rows, cols = (
        (np.arange(first, length, step) + by) % length
        for first, length, step, by in zip(site, plane.shape, cfa.shape, offset, strict=True)
    )
    return plane[np.ix_(rows, cols)]


def _moved(plane: Array, by: tuple[int, ...]) -> Array:
    """Shift a plane so that each pixel contains the value at the offset `by`. The plane wraps around at its borders."""
    return np.roll(plane, tuple(-each for each in by), (0, 1))


def _step(direction: Direction, period: tuple[int, ...]) -> tuple[int, ...]:
    """Return the offset of one CFA period in a direction, in pixels."""
    return tuple(sign * length for sign, length in zip(direction, period, strict=True))
