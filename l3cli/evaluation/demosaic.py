"""Full-resolution channels from a mosaic by the methods that a table is compared with: nothing here learns anything.

Methods take a mosaic (row, col) of CFA phase (0, 0), in those of bands one in which a perfect white is 1 in every band
(docs/method.md#baselines-for-bands), and give channels (channel, row, col). Borders are mirrored in phase.
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

from l3cli.errors import L3Error
from l3cli.evaluation.quality import cropped
from l3cli.frames.frame import pad_mosaic, tiled
from l3cli.system.plugins import BASELINES, blamed, described, plugins

Array = NDArray[np.floating]
CFA = NDArray[np.uint8]
Demosaic = Callable[[Array, CFA], Array]
Direction = tuple[int, int]  # signs of a row and a column offset
DIRECTIONS: tuple[Direction, ...] = tuple((down, right) for down in (-1, 0, 1) for right in (-1, 0, 1) if down or right)
PERIODS = 4  # of margin, beyond the reach of every method of bands; a frame is wrapped round there
CODES = 255.0  # of a perfect white: the unit of the 1 in PPID's weights
SIGMA = 0.55  # of the Gaussian, in distances between neighbouring samples of a channel: best on dead leaves (five-band)
MARGIN = 8  # pixels, even, beyond the reach of the Bayer methods


def interpolate(mosaic: Array, cfa: CFA) -> Array:
    """Return the channels (channel, row, col) of a mosaic (row, col), each by itself: Gaussian-weighted mean of the
    channel's samples about a pixel (normalised convolution, Knutsson and Westin 1993), mirrored at the borders. Any CFA;
    exact where flat."""
    from scipy.ndimage import gaussian_filter

    channel = tiled(cfa, mosaic.shape)
    planes = []
    for index in range(int(cfa.max()) + 1):
        sampled = (channel == index).astype(np.float64)
        sigma = SIGMA * np.sqrt(cfa.size / (cfa == index).sum())
        reach = max(cfa.shape)  # no pixel is further from a sample of the channel
        planes.append(
            gaussian_filter(mosaic * sampled, sigma, mode="mirror", radius=reach)
            / gaussian_filter(sampled, sigma, mode="mirror", radius=reach)
        )
    return np.array(planes)


def malvar(mosaic: Array, cfa: CFA) -> Array:
    """Interpolate, as `interpolate`, a Bayer CFA: Malvar, He and Cutler 2004, by colour-demosaicing."""
    return _by_colour_demosaicing("demosaicing_CFA_Bayer_Malvar2004", mosaic, cfa)


def menon(mosaic: Array, cfa: CFA) -> Array:
    """Interpolate, as `interpolate`, a Bayer CFA: Menon, Andriani and Calvagno 2007, by colour-demosaicing."""
    return _by_colour_demosaicing("demosaicing_CFA_Bayer_Menon2007", mosaic, cfa)


def baselines(cfa: CFA) -> dict[str, Demosaic]:
    """Return every method for pictures that fits a CFA and is installed, by name; "basic" is always among them."""
    return _with_plugins({"basic": interpolate} | _bayer_baselines(cfa), cfa)


def band_baselines(cfa: CFA) -> dict[str, Demosaic]:
    """Return, as `baselines`, for the camera's own bands at every pixel: "bilinear" where it is a method of the field, with
    "sd" and "ppid" where every band occurs once a period; else "basic"."""
    if occurs_once(cfa):
        return _with_plugins({"bilinear": bilinear, "sd": spectral_difference, "ppid": ppi_difference}, cfa)
    if bayer_roles(cfa) is not None:
        return _with_plugins({"bilinear": bilinear} | _bayer_baselines(cfa), cfa)
    return _with_plugins({"basic": interpolate}, cfa)


def best_of_bands(cfa: CFA) -> Demosaic:
    """Return the best method for bands of l3 itself that fits a CFA and is installed: PPID where every band occurs once a
    period, Menon's for Bayer, else normalised convolution."""
    if occurs_once(cfa):
        return ppi_difference
    return _bayer_baselines(cfa).get("menon", interpolate)


def bayer_roles(cfa: CFA) -> tuple[int, int, int] | None:
    """Return which channels of a Bayer CFA play red, green, blue: green is on a diagonal; None if it is no such CFA."""
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
    """Return `known` methods and those of installed packages (docs/python.md#a-baseline). L3Error if one of these fails, or
    has the name of a known one."""
    methods = dict(known)
    for name, entry in plugins(BASELINES).items():
        if name in known:
            raise L3Error(f"{described(entry)} is called like a baseline of l3 itself; rename it")
        with blamed(entry):
            method = entry.load()(cfa)
        if method is not None:
            methods[name] = functools.partial(_interpolated_by, entry, method)
    return methods


def _interpolated_by(entry: EntryPoint, method: Callable[[Array], Array], mosaic: Array, cfa: CFA) -> Array:
    """Return the channels (channel, row, col) of a mosaic (row, col) by a method of a package; L3Error if they are none."""
    with blamed(entry):
        planes = np.asarray(method(mosaic), np.float64)
        shape = (int(cfa.max()) + 1, *mosaic.shape)
        if planes.shape != shape or not np.isfinite(planes).all():
            raise ValueError(f"channels must be finite and of shape {shape}; these are of {planes.shape}")
    return planes


def _by_colour_demosaicing(name: str, mosaic: Array, cfa: CFA) -> Array:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import colour_demosaicing

        roles = bayer_roles(cfa)
        assert roles is not None
        letter = dict(zip(roles, "RGB", strict=True))
        pattern = "".join(letter[int(channel)] for channel in cfa.ravel())
        padded = pad_mosaic(mosaic, MARGIN, cfa.shape)  # the package itself breaks the mosaic's phase at the borders
        planes = cropped(np.moveaxis(getattr(colour_demosaicing, name)(padded, pattern), -1, 0), MARGIN)
    return planes[[roles.index(channel) for channel in range(3)]]


# ----------------------------------------------------------------------------------- methods of the field for many bands


def occurs_once(cfa: CFA) -> bool:
    """Return whether every band of a CFA of at least 2×2 occurs once a period."""
    return min(cfa.shape) > 1 and int(cfa.max()) + 1 == cfa.size == np.unique(cfa).size


def bilinear(mosaic: Array, cfa: CFA) -> Array:
    """Return every band by itself: samples nearer than a period weighed by triangles, "weighted bilinear" (Brauers and Aach
    2006). Of a Bayer CFA this is bilinear interpolation."""
    return _by_site(mosaic, cfa, lambda padded: lambda site: _interpolated(padded, cfa, site))


def spectral_difference(mosaic: Array, cfa: CFA) -> Array:
    """Return the bands by Brauers and Aach, "A color filter array based multispectral camera", 2006. Differences of bands
    are interpolated: at a pixel of band l the differences of all samples from the bilinear plane of l are, and l's sample is
    added."""

    def method(padded: Array) -> Callable[[Direction], Array]:
        plain = _all_sites(padded, cfa, lambda site: _interpolated(padded, cfa, site))

        def at(site: Direction) -> Array:
            return _samples(padded, cfa, site) + _interpolated(padded - plain[cfa[site]], cfa, site)

        return at

    return _by_site(mosaic, cfa, method)


def ppi_difference(mosaic: Array, cfa: CFA) -> Array:
    """Return PPID (Mihoubi, Losson, Mathon and Macaire, "Multispectral demosaicing using pseudo-panchromatic image", IEEE
    Trans. Computational Imaging 3, 2017, equations 21 to 34) for a CFA that `occurs_once`: the differences of all samples
    from the pseudo-panchromatic image, the mean of all bands, are interpolated along edges."""

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
    """Return the pseudo-panchromatic image (row, col) of a mosaic: its mean over a period, sharpened by what the mosaic's
    samples of the same band a period away lie off theirs (equations 23 to 28)."""
    from scipy.ndimage import correlate1d

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
    """Return by direction the weight (row, col) of what lies there: small where samples of the same band, a period apart,
    differ (equations 25 to 27); 1 of the pixel itself."""
    weights: dict[Direction, Array] = {(0, 0): np.ones(values.shape)}
    for down, right in DIRECTIONS:
        change = np.abs(values - _moved(values, _step((down, right), period)))
        total = np.ones(values.shape)
        for prefetched, aside in itertools.product((0, 1), (-1, 0, 1)):
            if down and right:
                place = ((prefetched + (aside < 0)) * down, (prefetched + (aside > 0)) * right)
            else:
                place = (prefetched * down + aside * right, prefetched * right + aside * down)
            total += (2 - prefetched) * (2 - abs(aside)) * _moved(change, place)
        weights[down, right] = 1.0 / total
    return weights


# ------------------------------------------------------------------------------------------------------ interpolation


def _interpolated(plane: Array, cfa: CFA, site: Direction, weights: Mapping[Direction, Array] | None = None) -> Array:
    """Return bands (band, row, col) at the pixels of a CFA site, from the samples of `plane` less than a period away:
    weighed by a triangle in either direction, and by `weights` of their direction. The site's own band is the sample."""
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
    """Return the result of a method, prepared with the padded mosaic, at the pixels of every site; without the margin."""
    margin = PERIODS * math.lcm(*cfa.shape)
    return cropped(_all_sites(padded := pad_mosaic(mosaic, margin, cfa.shape), cfa, method(padded)), margin)


def _all_sites(padded: Array, cfa: CFA, at: Callable[[Direction], Array]) -> Array:
    bands = np.empty((int(cfa.max()) + 1, *padded.shape))
    for row, col in np.ndindex(*cfa.shape):
        bands[:, row :: cfa.shape[0], col :: cfa.shape[1]] = at((row, col))
    return bands


def _samples(plane: Array, cfa: CFA, site: Direction, offset: Direction = (0, 0)) -> Array:
    """Return the samples of a plane at `offset` from the pixels of a site; beyond the end those of the other end."""
    rows, cols = (
        (np.arange(first, length, step) + by) % length
        for first, length, step, by in zip(site, plane.shape, cfa.shape, offset, strict=True)
    )
    return plane[np.ix_(rows, cols)]


def _moved(plane: Array, by: tuple[int, ...]) -> Array:
    """Return at every pixel what lies at an offset from it."""
    return np.roll(plane, tuple(-each for each in by), (0, 1))


def _step(direction: Direction, period: tuple[int, ...]) -> tuple[int, ...]:
    """Return a period in a direction."""
    return tuple(sign * length for sign, length in zip(direction, period, strict=True))
