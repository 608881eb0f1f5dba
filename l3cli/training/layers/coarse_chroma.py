"""Measure the noise of simulated greys for the coarse chroma filter (docs/method.md#coarse-chroma).

The filter averages neighbouring blocks of pixels if noise can explain the difference between the blocks.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from l3cli.artifacts.layers import COMPARED, PLANE_STEP, CoarseChroma
from l3cli.classes.coarse_chroma import SPACINGS, blocks_of, edge_avoiding, scales_of
from l3cli.classes.planes import LUMINANCE
from l3cli.training.layers.learn import LayerPass
from l3cli.training.layers.mosaics import Mosaics
from l3cli.training.lines import LineNoise
from l3cli.training.patches import expose_patches

LUMINANCES = np.geomspace(0.0008, 0.8, 16)  # luminances of the greys, relative to a white with Y = 1
GREY_SIDE_PIXELS = 128  # side of each simulated grey, in pixels
CUT = 3  # number of blocks ignored at each edge, because they have fewer neighbours

Array = NDArray[np.float64]


def measured_noise(layer: LayerPass) -> CoarseChroma:
    """Measure the noise level for a layer's coarse chroma filter.

    Each step of the filter smooths block means. A step's noise level is the variance of its block means in simulated greys.

    Parameters
    ----------
    layer : LayerPass
        The layer to be trained.

    Returns
    -------
    CoarseChroma
    """
    greys = _planes_of_greys(layer)
    luminance = np.array([grey[LUMINANCE].mean() for grey in greys]) * PLANE_STEP
    blocks = list(map(blocks_of, greys))
    found = np.empty(COMPARED)
    for step, spacing in enumerate(SPACINGS):
        found[step] = rising_terms(luminance, _variances(blocks))
        scale = scales_of(CoarseChroma(found[[step] * COMPARED[0]]))[step]
        blocks = [edge_avoiding(each, spacing, scale) for each in blocks]
    return CoarseChroma(found)


def _planes_of_greys(layer: LayerPass) -> list[NDArray[np.int32]]:
    """Render simulated greys with the previous layers, and return their planes, from dark to bright."""
    camera, period = layer.camera, layer.camera.cfa.shape
    margin = layer.exposed.margin - layer.margin
    rows, cols = (-(-(GREY_SIDE_PIXELS + 2 * margin) // each) * each for each in period)
    channel = camera.channel_map((rows, cols))
    see, rng, greys = layer.seer(), layer.rng(0, 4), []
    lines = LineNoise.of(camera, layer.exposed.dark)
    for luminance in LUMINANCES:
        signal = (layer.grey * luminance).astype(np.float32)[channel]
        offsets = None if lines is None else lines.drawn(signal.shape, rng)
        values = expose_patches(signal, camera, rng, None, layer.exposed.dark, channel, offsets).astype(np.uint16)
        target = np.zeros((len(layer.basis), rows, cols), np.float32)
        greys.append(see(Mosaics(1, values, None, target)).noisy)
    return greys


def _variances(planes: list[Array]) -> Array:
    """Return the variance of the blocks of each grey, without `CUT` blocks at each edge: (grey, plane)."""
    return np.array([each[:, CUT:-CUT, CUT:-CUT].var(axis=(1, 2)) for each in planes])


def rising_terms(luminance: Array, variances: Array) -> Array:
    """Fit each plane's variance with a polynomial in luminance that has non-negative coefficients.

    The fit minimises the squared error of the log variance. In dark areas, some layers reduce chroma so strongly that the
    polynomial cannot follow the low variance. A fit that minimises relative errors would then underestimate the variance in
    brighter areas and leave visible blotches.

    Parameters
    ----------
    luminance : ndarray, (grey)
        Luminance of each grey, relative to a white with Y = 1.
    variances : ndarray, (grey, plane)
        Variances in squared plane steps.

    Returns
    -------
    ndarray, (plane, power)
        Polynomial coefficients, in output units squared.
    """
    powers = np.maximum(luminance, 0.0)[:, None] ** np.arange(COMPARED[2])
    start, terms = 1 / np.maximum(powers.max(axis=0), PLANE_STEP), np.empty((variances.shape[1], COMPARED[2]))
    for plane, known in enumerate(np.log(np.maximum(variances.T, 1.0))):
        sizes = np.log(start) + known.max(initial=0.0, where=luminance > 0) - np.array([10.0, 3.0, 0.0])
        terms[plane] = np.exp(least_squares(lambda logs, of=known: np.log(powers @ np.exp(logs)) - of, sizes).x)
    terms *= PLANE_STEP**2
    terms[:, 0] = np.maximum(terms[:, 0], PLANE_STEP**2)
    return terms
