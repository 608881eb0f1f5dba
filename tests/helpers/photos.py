"""Simulated photos of a chart, taken by cameras that are drawn from curve statistics."""

import functools
import hashlib
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.calibration.photo import estimate
from l3cli.calibration.photo.estimate import WAVELENGTH, Posterior, Shot
from l3cli.frames.chart import corner_cells, homography, locate, through
from l3cli.io.curves import shipped_statistics
from l3cli.physics import charts, spectra

Array = NDArray[np.floating]
ROWS, COLS = np.divmod(np.arange(24), 6)
PLACE = np.stack([(COLS - 2.5) / 2.5, (ROWS - 1.5) / 1.5], axis=1)
BRIGHTEST = 1000.0  # DN
BAYER = np.array([[0, 1], [1, 2]], dtype=np.uint8)
GRID = (4, 6)
UPRIGHT = np.array([[180, 150], [580, 160], [590, 430], [170, 420]], dtype=np.float64)  # col, row of patches 1, 6, 24, 19
GAIN, READ = 0.5, 4.0  # DN/e-, DN
REFLECTANCE = spectra.colorchecker(WAVELENGTH)[1]

PITCH, PATCH, FIRST = 30, 24, (42, 34)  # pixels: distance of patches, side of a patch, position of the first patch
SMALL = (200, 250)  # pixels


def chart_mosaic(camera: CameraModel, light: str, share: float = 0.8) -> np.ndarray:
    """Simulate a raw frame of a ColorChecker in front of a lighter, striped wall.

    The white patch reaches the fraction `share` of full scale in its brightest channel.
    """
    reflectance = charts.chart("classic", camera.wavelength)[1]
    radiance = spectra.illuminant(light, camera.wavelength)
    surfaces = np.vstack([reflectance, np.full_like(radiance, 0.03), np.full_like(radiance, 0.4), reflectance[4] * 1.2])
    signals = (surfaces * radiance) @ camera.electron_weights.T / (camera.electron_weights @ radiance).max()
    shown = np.where(np.arange(SMALL[1]) // 11 % 2 == 0, 25, 26) * np.ones(SMALL, int)
    top, left = FIRST
    shown[top - 10 : top + 4 * PITCH + 5, left - 10 : left + 6 * PITCH + 5] = 24
    for patch in range(24):
        row, col = (start + PITCH * place for start, place in zip(FIRST, divmod(patch, 6), strict=True))
        shown[row : row + PATCH, col : col + PATCH] = patch
    channel = np.tile(camera.cfa, (SMALL[0] // 2, SMALL[1] // 2))
    values = np.take_along_axis(signals[shown], channel[..., None], axis=2)[..., 0]
    noise = np.random.default_rng(1).normal(0, 4, SMALL)
    full = camera.white_level - camera.black_level
    return np.rint(np.clip(camera.black_level + share * full * values + noise, 0, camera.white_level)).astype(np.uint16)


known_cameras = functools.cache(shipped_statistics)


def locating_once() -> Callable[..., Any]:
    """Return a `frames.chart.locate` that remembers its results, so that each frame is searched only once."""
    known: dict[bytes, Any] = {}

    def once(*arguments: Any) -> Any:
        key = hashlib.sha256(b"".join(np.asarray(each).tobytes() for each in arguments)).digest()
        if key not in known:
            known[key] = locate(*arguments)
        return known[key]

    return once


def drawn(seed: int) -> Array:
    """Draw the responsivities (channel, wavelength) per photon of a camera similar to the measured cameras."""
    known, rng = known_cameras(), np.random.default_rng([seed, 1])
    shape = known.mean + np.tensordot(rng.standard_normal(len(known.modes)), known.modes, axes=1)
    shape = np.maximum(shape, 0.0)
    return shape / shape.max(axis=1, keepdims=True) * np.exp(known.log_peak)[:, None]


def photograph(
    corners: np.ndarray, rng: np.random.Generator, cfa: np.ndarray = BAYER, turns: int = 0, light_name: str = "D65"
) -> np.ndarray:
    """Simulate a mosaic (row, col) in DN above black: a chart with black gaps in front of random colour blotches."""
    camera = drawn(1)
    light = spectra.illuminant(light_name, WAVELENGTH)
    values = REFLECTANCE * light @ camera.T
    values = 3000.0 * values / values.max()
    shape = (600, 800)
    to_cells = np.linalg.inv(homography(corner_cells(*GRID), corners))
    col, row = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    cells = through(to_cells, np.stack([col, row], axis=-1))
    x, y = cells[..., 0], cells[..., 1]
    blotches = np.kron(rng.random((12, 16, 3)), np.ones((50, 50, 1)))
    picture = 100.0 + 1500.0 * blotches + 80.0 * np.sin(col / 3.0)[..., None]
    picture[(x > -0.5) & (x < 6.5) & (y > -0.5) & (y < 4.5)] = 60.0
    on = (x > 0) & (x < 6) & (y > 0) & (y < 4) & (np.abs(x % 1 - 0.5) < 0.42) & (np.abs(y % 1 - 0.5) < 0.42)
    picture[on] = values[(y[on].astype(int) * 6 + x[on].astype(int))]
    picture = np.rot90(picture, turns)
    tiled = np.tile(cfa, (picture.shape[0] // 2, picture.shape[1] // 2))
    mosaic = np.take_along_axis(picture, tiled[..., None].astype(int), axis=2)[..., 0]
    return np.rint(mosaic + np.sqrt(GAIN * mosaic + READ**2) * rng.standard_normal(mosaic.shape))


def shot(
    camera: Array, light: str, rng: np.random.Generator, *, noise: float = 0.005, glare: float = 0.0, uneven: float = 0.0,
    named: str | None = None,
) -> Shot:  # fmt: skip
    """Simulate the patches of a ColorChecker.

    `noise` is relative to the brightest patch, `glare` to the mean. `uneven` is the relative fall of the light over the
    chart. `named` is the illuminant that the photo states, if it differs from `light`.
    """
    reflectance = spectra.colorchecker(WAVELENGTH)[1]
    values = reflectance * spectra.illuminant(light, WAVELENGTH) @ camera.T
    values = values / values.max() * BRIGHTEST
    values = values + glare * values.mean(axis=0)
    if uneven:
        slopes = rng.standard_normal(estimate.TERMS) * (0.0, 1.0, 1.0, 0.5, 0.5, 0.5)
        fall = estimate.terms(PLACE) @ slopes
        values = values * (1.0 - uneven * (fall - fall.min()) / np.ptp(fall))[:, None]
    deviation = np.full_like(values, noise) * values.max(axis=0)
    values = values + deviation * rng.standard_normal(values.shape)
    taken = spectra.illuminant(named or light, WAVELENGTH)
    return Shot(taken, reflectance, PLACE, values, deviation, np.ones(values.shape, dtype=bool))


def response_figures(camera: Array, posterior: Posterior, light: str, surfaces: Array) -> tuple[Array, Array]:
    """Evaluate the responses to surfaces (surface, wavelength) under a light, scaled to the true mean.

    Returns the RMS error (channel) relative to the largest response, and the fraction (channel) of errors within the 95 %
    band.
    """
    stimuli = surfaces * spectra.illuminant(light, WAVELENGTH)
    size, errors, shares = WAVELENGTH.size, [], []
    for channel, (truth, curve) in enumerate(zip(camera, posterior.responsivity, strict=True)):
        part = slice(channel * size, (channel + 1) * size)
        true, ours = stimuli @ truth, stimuli @ curve
        centred = stimuli - np.outer(ours, stimuli.sum(axis=0)) / ours.sum()
        scale = true.sum() / ours.sum()
        spread = scale * np.sqrt(np.einsum("sw,wv,sv->s", centred, posterior.covariance[part, part], centred))
        off = ours * scale - true
        errors.append(np.sqrt(np.mean(off**2)) / true.max())
        shares.append(np.mean(np.abs(off) <= 1.96 * spread + 1e-4 * true.max()))
    return np.array(errors), np.array(shares)


def curve_figures(camera: Array, posterior: Posterior) -> tuple[Array, Array]:
    """Evaluate curves that are scaled to equal areas.

    Returns the RMS error (channel) relative to the peak, and the fraction (channel) of errors within the 95 % band.
    """
    size, errors, shares = WAVELENGTH.size, [], []
    for channel, (truth, curve) in enumerate(zip(camera, posterior.responsivity, strict=True)):
        part, scale = slice(channel * size, (channel + 1) * size), truth.sum() / curve.sum()
        free = np.eye(size) - np.outer(curve, np.ones(size)) / curve.sum()
        spread = scale * np.sqrt(np.diag(free @ posterior.covariance[part, part] @ free.T))
        off = curve * scale - truth
        errors.append(np.sqrt(np.mean(off**2)) / truth.max())
        shares.append(np.mean(np.abs(off) <= 1.96 * spread + 0.002 * truth.max()))
    return np.array(errors), np.array(shares)
