"""Simulation of the sensor, from mean photo-electrons to raw values in DN (docs/method.md#sensor).

This module also generates the sensor defects of the virtual lab.
"""

import functools
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint
from typing import Annotated, Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel, Noise
from l3cli.errors import RecipeError, shortened, suggestion
from l3cli.recipes.toml import NotNegative, Recipe, Share
from l3cli.system.plugins import NOISE, blamed, plugins

MAX_ELECTRONS = 1e15  # limit in e-, above any full-well capacity and small enough for the Poisson generator
NOISES = ("all", "shot", "none")  # "shot": only the shot noise of light and dark current; "none": only quantisation
OfMillion = Annotated[float, msgspec.Meta(ge=0, le=1e6)]


@dataclass(frozen=True)
class FixedPattern:
    """Fixed differences between the pixels of a camera, which are the same in every frame."""

    prnu: NDArray[np.float32]  # (row, col), relative deviation of the response, including row and column deviations
    dsnu: NDArray[np.float32]  # (row, col), offset in e-, including fixed row and column offsets


def fixed_pattern(camera: CameraModel) -> FixedPattern:
    """Generate the PRNU and DSNU of each pixel, as determined by the camera's `fixed_pattern_seed`."""
    return _fixed_pattern(camera.fixed_pattern_seed, (camera.rows, camera.cols), camera.noise)


@functools.lru_cache(maxsize=1)
def _fixed_pattern(seed: int, shape: tuple[int, int], noise: Noise) -> FixedPattern:
    rng = np.random.default_rng(seed)
    response = rng.standard_normal(shape, dtype=np.float32) * np.float32(noise.prnu)
    offset = rng.standard_normal(shape, dtype=np.float32) * np.float32(noise.dsnu)
    offset += rng.standard_normal(shape[1], dtype=np.float32) * np.float32(noise.column_noise)
    offset += rng.standard_normal((shape[0], 1), dtype=np.float32) * np.float32(noise.row_noise)
    for lines, deviation in (((shape[0], 1), noise.row_prnu), (shape[1], noise.column_prnu)):
        if deviation:
            response += rng.standard_normal(lines, dtype=np.float32) * np.float32(deviation)
    return FixedPattern(response, offset)


def mosaic(electrons: NDArray[np.float32], cfa: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Sample the electrons of all channels, (channel, row, col), with the CFA. The first pixel is at site (0, 0)."""
    down, across = cfa.shape
    values = np.empty(electrons.shape[1:], electrons.dtype)
    for row, col in np.ndindex(cfa.shape):
        values[row::down, col::across] = electrons[cfa[row, col], row::down, col::across]
    return values


def signals(camera: CameraModel, rates: NDArray[np.floating]) -> NDArray[np.floating]:
    """Multiply each pixel's electron rate, in e-/s, by the relative gain of its channel.

    The result times the camera gain is the signal in DN/s.
    """
    return rates if camera.readout is None else rates * camera.channel_gains[camera.channel_map(rates.shape)]


def saturating_exposure(camera: CameraModel, rates: NDArray[np.floating], share: float) -> float:
    """Return the exposure time in s at which a given fraction of the pixels saturates.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    rates : ndarray, (row, col)
        Mean photo-electrons per pixel, in e-/s.
    share : float
        Fraction of saturated pixels.

    Raises
    ------
    ValueError
        If the brightest pixels collect no electrons.
    """
    rate = float(np.quantile(signals(camera, rates), 1.0 - share)) + camera.noise.dark_current
    if rate <= 0:
        raise ValueError("the scene is too dark for exposure_saturated; use exposure_share or exposure_s instead")
    return camera.full_scale / rate


def averaging_exposure(camera: CameraModel, rates: NDArray[np.floating], share: float) -> float:
    """Return the exposure time in s at which the mean signal before clipping is a given fraction of full scale.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    rates : ndarray, (row, col)
        Mean photo-electrons per pixel, in e-/s.
    share : float
        Mean signal as a fraction of full scale.

    Raises
    ------
    ValueError
        If the pixels collect no electrons.
    """
    rate = float(np.mean(signals(camera, rates), dtype=np.float64))
    if rate <= 0:
        raise ValueError("the scene is too dark for exposure_mean; use exposure_share or exposure_s instead")
    return share * camera.full_scale / rate


def with_analog_gain(camera: CameraModel, gain: float) -> CameraModel:
    """Multiply the analog gain of a camera by `gain`.

    The black level does not change. At a higher gain, fewer electrons are needed to reach the white level.
    """
    white_level = min(camera.black_level + gain * (camera.white_level - camera.black_level), 2.0**camera.bits - 1)
    return replace(camera.at_gain(gain), white_level=white_level)


def expose(
    camera: CameraModel, electrons: NDArray[np.floating], exposure: float, rng: np.random.Generator, noises: str = "all"
) -> NDArray[np.uint16]:
    """Simulate one raw frame (docs/method.md#sensor).

    If the camera has masked pixels, the result is a frame that has already been corrected with them.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    electrons : ndarray, (row, col)
        Mean photo-electrons collected during the exposure.
    exposure : float
        Exposure time in s.
    rng : Generator
        Random generator of the noise.
    noises : str
        One of NOISES, or the name of a noise model in an installed package.

    Returns
    -------
    ndarray of uint16, (row, col)
        Raw values in DN. A frame that is smaller than the sensor gets the fixed pattern of the sensor's upper left part.

    Raises
    ------
    ValueError
        If the frame is larger than the sensor.
    """
    rows, cols = electrons.shape
    if rows > camera.rows or cols > camera.cols:
        raise ValueError(
            f"the frame has {rows}×{cols} pixels, but the sensor has only {camera.rows}×{camera.cols}; use a smaller frame"
        )
    camera = camera.as_corrected()
    whole = fixed_pattern(camera)
    pattern = FixedPattern(whole.prnu[:rows, :cols], whole.dsnu[:rows, :cols])
    return read_out(camera, pattern, electrons, exposure, rng, noises)


def read_out(
    camera: CameraModel,
    pattern: FixedPattern,
    electrons: NDArray[np.floating],
    exposure: float,
    rng: np.random.Generator,
    noises: str = "all",
) -> NDArray[np.uint16]:
    """Simulate one raw frame in DN, with a given fixed pattern of the same shape as `electrons`.

    The other parameters are as in `expose`.
    """
    noise, readout = camera.noise, camera.readout
    time: Any = exposure
    read_noise: Any = np.float32(noise.read_noise)
    gain: Any = np.float32(camera.gain)
    if readout is not None:  # the channels differ in exposure, read noise and gain
        channel = camera.channel_map(electrons.shape)
        time = exposure * readout.channel_exposure[channel]
        read_noise = readout.channel_read_noise.astype(np.float32)[channel]
        gain = (camera.gain * readout.channel_gain).astype(np.float32)[channel]
    if noises in NOISES:
        signal = _collected(camera, pattern, electrons, time, read_noise, rng, noises)
    else:
        signal = _noisy_by(noises, electrons, time, camera, rng)
    np.minimum(signal, np.float32(noise.well_capacity), out=signal)
    values = np.rint(gain * signal + np.float32(camera.black_level))
    return np.clip(values, 0, 2**camera.bits - 1).astype(np.uint16)


def _collected(
    camera: CameraModel, pattern: FixedPattern, electrons: NDArray[np.floating], time: Any, read_noise: Any,
    rng: np.random.Generator, noises: str,
) -> NDArray[np.float32]:  # fmt: skip
    """Add dark current and noise to the electrons in each pixel.

    `noises` is "all", "shot" (only shot noise) or "none". Only "all" includes the fixed pattern. Signals are limited to
    MAX_ELECTRONS before noise is added.
    """
    noise = camera.noise
    signal = np.clip(electrons, 0.0, MAX_ELECTRONS) + np.minimum(noise.dark_current * time, MAX_ELECTRONS)
    if noises != "none":
        signal = rng.poisson(signal)
    signal = signal.astype(np.float32)
    if noises == "all":
        signal += rng.standard_normal(signal.shape, dtype=np.float32) * read_noise
        signal *= 1 + pattern.prnu
        signal += pattern.dsnu
        for axis, deviation in enumerate((noise.row_temporal_noise, noise.column_temporal_noise)):
            if deviation:  # drawn only if needed, so that cameras without line noise keep their random numbers
                offsets = rng.standard_normal(signal.shape[axis], dtype=np.float32) * np.float32(deviation)
                signal += offsets[:, None] if axis == 0 else offsets
    return signal


def with_masked(
    camera: CameraModel, pattern: FixedPattern, electrons: NDArray[np.floating]
) -> tuple[FixedPattern, NDArray[np.floating]]:
    """Add the camera's masked pixels, which collect no light, around the light-sensitive pixels.

    Masked pixels share the fixed offset of their column and their row, which is estimated by the mean of `pattern` over the
    column or row. Fully masked columns get random offsets. If the camera has no masked pixels, the arguments are returned
    unchanged.
    """
    masked, noise = camera.masked, camera.noise
    if masked is None:
        return pattern, electrons
    rng, shape = np.random.default_rng([camera.fixed_pattern_seed, 2]), masked.around(*electrons.shape)
    offsets = rng.standard_normal(shape, dtype=np.float32) * np.float32(noise.dsnu)
    columns = rng.standard_normal(shape[1], dtype=np.float32) * np.float32(noise.column_noise)
    inner = np.s_[masked.top : masked.top + electrons.shape[0], masked.left : masked.left + electrons.shape[1]]
    columns[inner[1]] = pattern.dsnu.mean(axis=0)
    offsets += columns
    if noise.row_noise:
        offsets[inner[0]] += pattern.dsnu.mean(axis=1, keepdims=True) - pattern.dsnu.mean()
    response, light = np.zeros(shape, np.float32), np.zeros(shape, electrons.dtype)
    response[inner], offsets[inner], light[inner] = pattern.prnu, pattern.dsnu, electrons
    return FixedPattern(response, offsets), light


@functools.cache
def noise_plugin(name: str) -> EntryPoint:
    """Find a noise model in an installed package (docs/python.md#a-noise-model).

    Raises
    ------
    RecipeError
        If no installed package provides a noise model with this name.
    """
    offered = {each: entry for each, entry in plugins(NOISE).items() if each not in NOISES}
    if name not in offered:
        known = suggestion(name, offered) if offered else "install the package that provides it"
        raise RecipeError(f'no installed package has a noise model "{shortened(name)}"; {known}')
    return offered[name]


def _noisy_by(
    name: str, electrons: NDArray[np.floating], time: Any, camera: CameraModel, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Add noise to the electrons with the noise model `name` of a plugin. Raises L3Error if it returns invalid values."""
    entry = noise_plugin(name)
    with blamed(entry):
        signal = np.array(entry.load()(electrons.copy(), time, camera, rng), np.float32)
        if signal.shape != electrons.shape or not np.isfinite(signal).all():
            raise ValueError(
                f"the noise model returned an array with the shape {signal.shape}; it must return finite numbers of "
                f"electrons with the shape {electrons.shape}"
            )
    return signal


class DefectRecipe(Recipe):
    """Defects of the sensor in the virtual lab."""

    hot_pixels_per_million: OfMillion = 25.0
    hot_current_e_per_s: NotNegative = 4000.0  # additional dark current of a hot pixel
    dead_pixels_per_million: OfMillion = 10.0
    dust_specks_per_million: Annotated[float, msgspec.Meta(ge=0, le=10_000)] = 4.0  # each speck casts a soft shadow
    dust_depth: Share = 0.03  # fraction of the light that is lost at the centre of a shadow
    dust_radius_px: Annotated[float, msgspec.Meta(gt=0, le=1000)] = 12.0
    blinking_pixels_per_million: OfMillion = 0.0  # pixels that switch between two levels at random (telegraph noise)
    blinking_step_e: NotNegative = 50.0  # mean difference of the two levels, which is exponentially distributed
    # Polarisers of single pixels: largest deviations from the mean of the channel. They are uniformly distributed.
    polariser_deg: Annotated[float, msgspec.Meta(ge=0, le=45)] = 1.0
    polariser_leakage: Share = 0.2  # as a fraction of the leakage, which is the inverse of the extinction ratio


@dataclass(frozen=True)
class SensorDefects:
    """The defects of one sensor, which are the same in every frame.

    For cameras without polarisers, `turn` and `leakage` are single values, 0 and 1.
    """

    hot: NDArray[np.int64]  # (pixel, 2), row and column of each hot pixel
    dead: NDArray[np.int64]  # (pixel, 2), row and column of each dead pixel
    shade: NDArray[np.float32]  # (row, col), transmittance of the dust
    blinking: NDArray[np.int64]  # (pixel, 2), row and column of each blinking pixel
    steps: NDArray[np.float32]  # (pixel,), difference between the two levels of each blinking pixel, in e-
    turn: NDArray[np.float32]  # (row, col), angle of each pixel's polariser relative to its channel, in degrees
    leakage: NDArray[np.float32]  # (row, col), leakage of each pixel's polariser relative to its channel

    def blinks(self, rng: np.random.Generator) -> NDArray[np.float32]:
        """Draw each blinking pixel's offset in one frame, in e-. Both levels are equally probable."""
        return self.steps * rng.integers(0, 2, self.steps.size).astype(np.float32)


def defects_of(camera: CameraModel, recipe: DefectRecipe) -> SensorDefects:
    """Draw the sensor defects that `recipe` specifies.

    They are random, but the camera's `fixed_pattern_seed` is the seed, so each call returns the same defects.
    """
    polarised = camera.polarisers is not None
    return _draw(camera.fixed_pattern_seed, camera.rows, camera.cols, polarised, msgspec.structs.astuple(recipe))


@functools.lru_cache(maxsize=1)
def _draw(seed: int, rows: int, cols: int, polarised: bool, figures: tuple[float, ...]) -> SensorDefects:
    recipe = DefectRecipe(*figures)
    rng = np.random.default_rng([seed, 1])

    def scattered(per_million: float) -> NDArray[np.int64]:
        count = round(per_million * 1e-6 * rows * cols)
        return np.stack([rng.integers(0, rows, count), rng.integers(0, cols, count)], axis=1)

    hot, dead = scattered(recipe.hot_pixels_per_million), scattered(recipe.dead_pixels_per_million)
    shade = np.ones((rows, cols), dtype=np.float32)
    reach = int(np.ceil(4 * recipe.dust_radius_px))
    for row, col in scattered(recipe.dust_specks_per_million):
        top, left = max(row - reach, 0), max(col - reach, 0)
        part = shade[top : row + reach, left : col + reach]
        y, x = np.arange(part.shape[0]) + top - row, np.arange(part.shape[1]) + left - col
        part -= (recipe.dust_depth * np.exp(-0.5 * (y[:, None] ** 2 + x**2) / recipe.dust_radius_px**2)).astype(np.float32)
    blinking = scattered(recipe.blinking_pixels_per_million)  # drawn later, so that the other defects do not depend on it
    steps = rng.exponential(recipe.blinking_step_e, len(blinking)).astype(np.float32)
    turn, leakage = np.zeros((1, 1), np.float32), np.ones((1, 1), np.float32)
    if polarised:
        turn, change = (rng.uniform(-1.0, 1.0, (rows, cols)).astype(np.float32) for _ in range(2))
        turn *= np.float32(recipe.polariser_deg)
        leakage = 1 + np.float32(recipe.polariser_leakage) * change
    return SensorDefects(hot, dead, shade, blinking, steps, turn, leakage)
