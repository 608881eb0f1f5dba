"""Published demosaicking methods for polarisation cameras, written from their descriptions.

A method is a function of a mosaic (row, col) and a CFA. The CFA contains 2×2 different channels or, for colour cameras, 4×4
pixels whose blocks of 2×2 pixels have one colour. The result contains an image of each channel (channel, row, col). Borders
are mirrored.

newton    Newton's polynomials: N. Li, Y. Zhao, Q. Pan, S. G. Kong, "Demosaicking DoFP images using Newton's polynomial
          interpolation and polarization difference model", Optics Express 27, 2019, 1376-1391.
igri      Residual interpolation with an edge-aware guide: M. Morimatsu, Y. Monno, M. Tanaka, M. Okutomi, "Monochrome and
          color polarization demosaicking using edge-aware residual interpolation", ICIP 2020. The method is called EARI
          there, and IGRI1 in "Monochrome and color polarization demosaicking based on intensity-guided residual
          interpolation", IEEE Sensors Journal 21, 2021, 26985-26996.
lmmse     One linear transform per site, trained on another picture: A. Spote, P.-J. Lapray, J.-B. Thomas, I. Farup, "Joint
          demosaicing of colour and polarisation from filter arrays", Color and Imaging Conference 2021.
"""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate, uniform_filter

from l3cli.artifacts.training_set import open_training_set
from l3cli.evaluation.basic import balanced_bands, stokes_response, white_electrons
from l3cli.evaluation.demosaic import menon
from l3cli.evaluation.quality import cropped
from l3cli.frames.frame import pad_mosaic
from l3cli.physics.mosaic import tiled
from l3cli.physics.stokes import STOKES, stokes_of

Array = NDArray[np.floating[Any]]
CFA = NDArray[np.uint8]
MARGIN = 16  # width of the mirrored margin in pixels; wider than the support of all methods and a multiple of all periods
# Newton's polynomials
THRESHOLD = 5.8  # ratio of the differences along two directions from which only one direction is used
TINY = 1e-15
# residual interpolation
RADIUS = 5  # pixels; the windows of the linear fits have 11×11 pixels
BILINEAR = np.outer([0.5, 1, 0.5], [0.5, 1, 0.5])
LAPLACIAN = np.zeros((5, 5))
LAPLACIAN[[0, 2, 2, 4], [2, 0, 4, 2]], LAPLACIAN[2, 2] = -1, 4
# LMMSE
WINDOW = 9  # pixels, side of the neighbourhood
RIDGE = 1e-6  # relative to the mean power of a tap
CONSTANT = 0.05  # value of the constant tap


def newton(mosaic: Array, cfa: CFA) -> Array:
    """Demosaick with Newton's polynomials."""
    if cfa.shape != (2, 2):
        return _by_colour(mosaic, cfa, newton)
    padded = pad_mosaic(mosaic, MARGIN, cfa.shape)
    channel = tiled(cfa, padded.shape)
    right, below, diagonal = (np.roll(channel, shift, (0, 1)) for shift in ((0, -1), (-1, 0), (-1, -1)))
    planes = np.zeros((4, *padded.shape))
    across, down = _polynomial(padded, padded, (0, 1)), _polynomial(padded, padded, (1, 0))
    falling, rising = _polynomial(padded, padded, (1, 1)), _polynomial(padded, padded, (1, -1))
    _put(planes, channel, padded)
    _put(planes, right, across)
    _put(planes, below, down)
    _put(planes, diagonal, _fused(padded, (falling, rising), ((1, 1), (1, -1))))
    # The channels of the pixels beside and below are also estimated in the other direction, from the first results.
    beside = _polynomial_of_planes(planes, padded, right, (1, 0))
    under = _polynomial_of_planes(planes, padded, below, (0, 1))
    _put(planes, right, _fused(padded, (across, beside), ((0, 1), (1, 0))))
    _put(planes, below, _fused(padded, (under, down), ((0, 1), (1, 0))))
    return cropped(planes, MARGIN)


def _put(planes: Array, channel: NDArray[np.uint8], values: Array) -> None:
    np.put_along_axis(planes, channel[None].astype(np.intp), values[None], 0)


def _moved(plane: Array, step: tuple[int, int], times: int) -> Array:
    return np.roll(plane, (-times * step[0], -times * step[1]), (0, 1))


def _polynomial(own: Array, other: Array, step: tuple[int, int]) -> Array:
    """Interpolate the difference of two channels that alternate along a direction.

    `own` contains the samples at even distances, and `other` contains the samples at odd distances. The polynomials of both
    sides are averaged.
    """
    samples = (other, 1), (own, 2), (other, 3)
    near, middle, far = (_moved(of, step, times) + _moved(of, step, -times) for of, times in samples)
    return 0.5 * own + (7 * near - 4 * middle + far) / 16


def _polynomial_of_planes(planes: Array, own: Array, wanted: NDArray[np.uint8], step: tuple[int, int]) -> Array:
    """Call `_polynomial` for each pixel, with samples of the channel `wanted` from `planes` as the other samples."""
    every = np.stack([_polynomial(own, plane, step) for plane in planes])
    return np.take_along_axis(every, wanted[None].astype(np.intp), 0)[0]


def _fused(own: Array, estimates: tuple[Array, Array], steps: tuple[tuple[int, int], tuple[int, int]]) -> Array:
    """Combine estimates along two directions. The direction along an edge has the smaller differences of channels."""
    around = [(row, col) for row in (-1, 0, 1) for col in (-1, 0, 1)]
    spread = [sum(_moved(np.abs(each - own), step, 2) for step in around) for each in estimates]
    slopes = [
        np.abs(_moved(own, step, 1) - _moved(own, step, -1)) + np.abs(2 * own - _moved(own, step, 2) - _moved(own, step, -2))
        for step in steps
    ]
    first, second = (1 / (slope + TINY) for slope in slopes)
    mean = (first * estimates[0] + second * estimates[1]) / (first + second)
    mean = np.where(spread[0] > THRESHOLD * spread[1], estimates[1], mean)
    return np.where(spread[1] > THRESHOLD * spread[0], estimates[0], mean)


def igri(mosaic: Array, cfa: CFA) -> Array:
    """Demosaick with residual interpolation. The guide is the intensity, averaged along edges."""
    if cfa.shape != (2, 2):
        return _by_colour(mosaic, cfa, igri)
    padded = pad_mosaic(mosaic, MARGIN, cfa.shape)
    channel, guide = tiled(cfa, padded.shape), _edge_aware(padded)
    return cropped(np.stack([_residual(guide, padded, channel == index) for index in range(4)]), MARGIN)


def _edge_aware(mosaic: Array) -> Array:
    """Return the intensity: means of 2×3 pixels on the four sides of a pixel, with smaller weights across edges."""
    total, norm = np.zeros_like(mosaic), np.zeros_like(mosaic)
    for turns in range(4):
        mean = np.zeros((3, 3))
        mean[:2] = [[0.125, 0.25, 0.125]] * 2
        change = np.zeros((3, 3))
        change[:2] = [[-0.5, 1, -0.5], [0.5, -1, 0.5]]
        side = np.zeros((5, 5))
        side[:3] = 1 / 15
        mean, change, side = (np.rot90(each, turns) for each in (mean, change, side))
        weight = 1 / (correlate(np.abs(correlate(mosaic, change)), side) + TINY)
        total += weight * correlate(mosaic, mean)
        norm += weight
    return total / norm


def _residual(guide: Array, mosaic: Array, mask: NDArray[np.bool_]) -> Array:
    """Interpolate one channel: a local linear function of the guide, and the residuals by bilinear interpolation.

    The slope minimises the Laplacian of the residuals (minimised-Laplacian residual interpolation). The coefficients of
    overlapping windows are averaged with the inverse of their squared errors as weights.
    """
    of, samples, guided = mask.astype(float), np.where(mask, mosaic, 0), np.where(mask, guide, 0)
    curved, bent = (np.where(mask, correlate(each, LAPLACIAN), 0) for each in (samples, guided))

    def mean(values: Array) -> Array:
        return uniform_filter(values, 2 * RADIUS + 1, mode="mirror")

    count = mean(of)
    slope = mean(bent * curved) / (mean(bent * bent) + TINY)
    offset = (mean(samples) - slope * mean(guided)) / count
    square = mean(samples**2) + slope**2 * mean(guided**2) + offset**2 * count
    square += 2 * (slope * offset * mean(guided) - slope * mean(guided * samples) - offset * mean(samples))
    weight = 1 / (np.maximum(square / count, 0) + 1e-10)
    tentative = (mean(slope * weight) * guide + mean(offset * weight)) / mean(weight)
    return tentative + correlate(np.where(mask, mosaic - tentative, 0), BILINEAR)


def _by_colour(mosaic: Array, cfa: CFA, method: Callable[[Array, CFA], Array]) -> Array:
    """Demosaick a colour polarisation mosaic: first the colours behind each polariser, then the polarisation of each colour.

    Pixels behind one polariser form a Bayer mosaic of half the size, which Menon's method demosaicks.
    """
    colours = np.zeros((3, *mosaic.shape))
    angle_of_site = np.arange(4, dtype=np.uint8).reshape(2, 2)
    planes = np.zeros((int(cfa.max()) + 1, *mosaic.shape))
    channels = np.zeros((3, 2, 2), np.uint8)  # (colour, row, col) channel of each colour behind the polariser of a site
    for row, col in np.ndindex(2, 2):
        bayer = cfa[row::2, col::2]
        names, ranks = np.unique(bayer, return_inverse=True)
        channels[:, row, col] = names
        colours[:, row::2, col::2] = menon(mosaic[row::2, col::2], ranks.reshape(2, 2).astype(np.uint8))
    for colour in range(3):
        planes[channels[colour].ravel()] = method(colours[colour], angle_of_site)
    return planes


def lmmse(scene: Array, training: Array, mosaic: Array, cfa: CFA) -> Array:
    """Demosaick with one linear transform of 9×9 pixels per site.

    Parameters
    ----------
    scene : ndarray, (channel, row, col)
        Images of another scene, on which the transforms are trained.
    training : ndarray, (row, col)
        Mosaic of the other scene, with the noise of `mosaic`.
    mosaic : ndarray, (row, col)
        The mosaic.
    cfa : ndarray
        Array of the mosaic.
    """
    planes = np.zeros((len(scene), *mosaic.shape))
    for row, col in np.ndindex(*cfa.shape):
        taps = _windows(training, cfa, (row, col))
        wanted = scene[:, row :: cfa.shape[0], col :: cfa.shape[1]].reshape(len(scene), -1).T
        moments = taps.T @ taps
        moments += RIDGE * np.trace(moments) / len(moments) * np.eye(len(moments))
        weights = np.linalg.solve(moments, taps.T @ wanted)
        there = planes[:, row :: cfa.shape[0], col :: cfa.shape[1]]
        there[:] = (_windows(mosaic, cfa, (row, col)) @ weights).T.reshape(there.shape)
    return planes


def trained_on_other_scenes(sets: Iterable[Path]) -> Callable[[Array, CFA], Array]:
    """Return LMMSE for the frames of training sets of two frames each.

    For each frame, the transforms are trained on the other frame of the set. For other mosaics, the transforms are trained
    on a frame of the first set.
    """
    others: dict[bytes, tuple[Array, Array]] = {}
    for path in sets:
        with open_training_set(path) as reader:
            frames, camera = list(reader), reader.head.camera
        seen: list[Any] = [
            balanced_bands(each, camera, white_electrons(each, camera), lambda mosaic, _: mosaic) for each in frames
        ]
        scenes: list[Any] = [
            np.tensordot(stokes_response(each, camera), stokes_of(each.target, STOKES) / each.white[1], 1) for each in frames
        ]
        others |= {seen[own].tobytes(): (scenes[1 - own], seen[1 - own]) for own in (0, 1)}

    def demosaic(mosaic: Array, cfa: CFA) -> Array:
        scene, training = others.get(mosaic.tobytes(), next(iter(others.values())))
        return lmmse(scene, training, mosaic, cfa)

    return demosaic


def _windows(mosaic: Array, cfa: CFA, site: tuple[int, int]) -> Array:
    """Return the neighbourhoods (pixel, tap) of a site, with a constant as the last tap."""
    padded = np.pad(mosaic, WINDOW // 2, mode="reflect")
    every = np.lib.stride_tricks.sliding_window_view(padded, (WINDOW, WINDOW))
    taps = every[site[0] :: cfa.shape[0], site[1] :: cfa.shape[1]].reshape(-1, WINDOW**2)
    return np.concatenate([taps, np.full((len(taps), 1), CONSTANT)], axis=1)
