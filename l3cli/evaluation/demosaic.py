"""Full-resolution channels from a mosaic by the methods that a table is compared with: nothing here learns anything."""

import functools
import importlib.util
import warnings
from collections.abc import Callable
from importlib.metadata import EntryPoint

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import L3Error
from l3cli.evaluation.bands import bilinear, occurs_once, ppi_difference, spectral_difference
from l3cli.evaluation.quality import cropped
from l3cli.frames.frame import pad_mosaic
from l3cli.system.plugins import BASELINES, blamed, described, plugins

Array = NDArray[np.floating]
Demosaic = Callable[[Array, NDArray[np.uint8]], Array]
SIGMA = 0.55  # of the Gaussian, in distances between neighbouring samples of a channel: best on dead leaves (five-band)
MARGIN = 8  # pixels, even, beyond the reach of the Bayer methods


def interpolate(mosaic: Array, cfa: NDArray[np.uint8]) -> Array:
    """Return the channels (channel, row, col) of a mosaic (row, col), each by itself: Gaussian-weighted mean of the
    channel's samples about a pixel (normalised convolution, Knutsson and Westin 1993), mirrored at the borders. Any CFA;
    exact where flat."""
    from scipy.ndimage import gaussian_filter

    channel = tiled(cfa, mosaic.shape)
    planes = []
    for index in range(int(cfa.max()) + 1):
        here = (channel == index).astype(np.float64)
        sigma = SIGMA * np.sqrt(cfa.size / (cfa == index).sum())
        reach = max(cfa.shape)  # no pixel is further from a sample of the channel
        planes.append(
            gaussian_filter(mosaic * here, sigma, mode="mirror", radius=reach)
            / gaussian_filter(here, sigma, mode="mirror", radius=reach)
        )
    return np.array(planes)


def malvar(mosaic: Array, cfa: NDArray[np.uint8]) -> Array:
    """As `interpolate`, for a Bayer CFA: Malvar, He and Cutler 2004, by colour-demosaicing."""
    return _by_colour_demosaicing("demosaicing_CFA_Bayer_Malvar2004", mosaic, cfa)


def menon(mosaic: Array, cfa: NDArray[np.uint8]) -> Array:
    """As `interpolate`, for a Bayer CFA: Menon, Andriani and Calvagno 2007, by colour-demosaicing."""
    return _by_colour_demosaicing("demosaicing_CFA_Bayer_Menon2007", mosaic, cfa)


def baselines(cfa: NDArray[np.uint8]) -> dict[str, Demosaic]:
    """Return every method for pictures that fits a CFA and is installed, by name; "basic" is always among them."""
    return _with_plugins({"basic": interpolate} | _bayer_baselines(cfa), cfa)


def band_baselines(cfa: NDArray[np.uint8]) -> dict[str, Demosaic]:
    """As `baselines`, for the camera's own bands at every pixel: "bilinear" where it is a method of the field, with "sd" and
    "ppid" where every band occurs once a period; else "basic"."""
    if occurs_once(cfa):
        return _with_plugins({"bilinear": bilinear, "sd": spectral_difference, "ppid": ppi_difference}, cfa)
    if bayer_roles(cfa) is not None:
        return _with_plugins({"bilinear": bilinear} | _bayer_baselines(cfa), cfa)
    return _with_plugins({"basic": interpolate}, cfa)


def bayer_roles(cfa: NDArray[np.uint8]) -> tuple[int, int, int] | None:
    """Which channels of a Bayer CFA play red, green, blue: green is the one on a diagonal; None if it is no such CFA."""
    if cfa.shape != (2, 2) or sorted(np.bincount(cfa.ravel()).tolist()) != [1, 1, 2]:
        return None
    for one, other in (((0, 0), (1, 1)), ((0, 1), (1, 0))):
        if cfa[one] == cfa[other]:
            green = int(cfa[one])
            first, second = sorted({0, 1, 2} - {green})
            return first, green, second
    return None


def tiled(cfa: NDArray[np.uint8], shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return the channel (row, col) of every pixel of a frame of `shape`, CFA phase (0, 0)."""
    return cfa[np.ix_(np.arange(shape[0]) % cfa.shape[0], np.arange(shape[1]) % cfa.shape[1])]


def _bayer_baselines(cfa: NDArray[np.uint8]) -> dict[str, Demosaic]:
    known = bayer_roles(cfa) is not None and importlib.util.find_spec("colour_demosaicing") is not None
    return {"malvar": malvar, "menon": menon} if known else {}


def _with_plugins(known: dict[str, Demosaic], cfa: NDArray[np.uint8]) -> dict[str, Demosaic]:
    """`known` methods and those of installed packages (docs/python.md#a-baseline). L3Error if one of these fails, or has
    the name of a known one."""
    methods = dict(known)
    for name, entry in plugins(BASELINES).items():
        if name in known:
            raise L3Error(f"{described(entry)} is called like a baseline of l3 itself; rename it")
        with blamed(entry):
            method = entry.load()(cfa)
        if method is not None:
            methods[name] = functools.partial(_interpolated_by, entry, method)
    return methods


def _interpolated_by(entry: EntryPoint, method: Callable[[Array], Array], mosaic: Array, cfa: NDArray[np.uint8]) -> Array:
    """Return the channels (channel, row, col) of a mosaic (row, col) by a method of a package; L3Error if they are none."""
    with blamed(entry):
        planes = np.asarray(method(mosaic), np.float64)
        shape = (int(cfa.max()) + 1, *mosaic.shape)
        if planes.shape != shape or not np.isfinite(planes).all():
            raise ValueError(f"channels must be finite and of shape {shape}; these are of {planes.shape}")
    return planes


def _by_colour_demosaicing(name: str, mosaic: Array, cfa: NDArray[np.uint8]) -> Array:
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
