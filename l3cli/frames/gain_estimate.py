"""The analog gain of a frame that states none, from the noise of its plain areas (docs/method.md#gains).

Patches are aligned with the array, so that it does not matter how far apart the samples of a channel lie. Each patch, less
the mean of every channel, is divided by the noise that the camera would have at a supposed gain. Principal components of all
patches part texture, in the stronger half of them, from the weaker half, in which natural pictures hold next to none: noise
level estimation by principal components (Pyatykh, Hesser and Zheng, 2013) in patches of weak texture (Liu, Tanaka and
Okutomi, 2013). Those patches are plain whose strong components hold least; the noise is that of their weak components. Noise
in both is independent, so that the choice does not bias it, and components of one half of the frame measure the other.

The gain is the most likely one of all plain patches, dark and bright, by the noise model. What is left of texture grows with
the square of the signal, as response nonuniformity does, and counts as such (`excess`). The division is repeated with each
gain until it stays.
"""

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.frames.frame import RawFrame

SIDE, LEAST_STEP = 8, 4  # pixels of a patch's sides; between patches, at least: whole periods of the array
MOST_PATCHES = 20_000  # of a frame
ROUNDS, CLOSE = 10, 0.01  # of supposing a gain, at most; by how little the last one changes it, relative
STRIPE = 8  # patches, whose components measure the next as many, and the other way round
CLIPPED, MOST_CLIPPED = 0.99, 0.02  # of full scale, from which on a pixel is clipped; share of a patch's pixels
CLEAR = 2.5  # standard deviations that a signal keeps from black and white, where noise is clipped
LEVELS, LEAST_PLAIN = 8, 32  # ranges of signal; plain patches of each, at least
PLAIN = ((0.05, 1.0), (0.01, 2.0))  # share of a range that is plain if strong components hold so many times the weak at most
AGREE = 1.3  # variance of a range over that at the gain, at most, if it agrees
LOWEST, HIGHEST = 2.0**-8, 2.0**10  # gains that are tried
USUAL_EXCESS, MOST_EXCESS = 0.01**2, 25.0  # relative variance of texture, to be expected; times that
STEPS, SMALL = 50, 1e-4  # of Fisher scoring, at most; of a parameter
SYSTEMATIC, MOST_ERROR = 0.04, 0.08  # relative error beside that of chance (tests/studies/test_gain_study.py); of both
Array = NDArray[np.float64]


@dataclass(frozen=True)
class GainEstimate:
    """An analog gain over a camera's, estimated."""

    gain: float
    error: float  # relative standard error

    @property
    def bounds(self) -> tuple[float, float]:
        """Return the gains two standard errors below and above."""
        return self.gain * float(np.exp(-2 * self.error)), self.gain * float(np.exp(2 * self.error))


def estimate_gain(frame: RawFrame, camera: CameraModel) -> GainEstimate:
    """Return the analog gain of a frame over that of its camera; ValueError, with the reason, if plain areas that are not
    clipped do not tell it."""
    patches, gain, excess = _patches_of(frame, camera), 1.0, 0.0
    for _ in range(ROUNDS):
        plain = _consistent(_plain(patches, camera, gain, excess), camera, gain)
        before, (gain, excess) = gain, _most_likely(plain, camera, gain, excess)
        if abs(np.log(gain / before)) < CLOSE:
            break
    of_chance = np.linalg.inv(_information(plain.slopes(camera, gain, excess), plain.components))[0, 0]
    error = float(np.sqrt(of_chance + SYSTEMATIC**2))
    if error > MOST_ERROR:
        raise ValueError("too few areas are plain")
    return GainEstimate(float(f"{gain:.3g}"), error)


@dataclass(frozen=True, eq=False)
class _Patches:
    """Patches of a frame, in DN of its camera above black."""

    values: Array  # (patch, pixel)
    means: Array  # (patch, channel) of those that the array has
    half: NDArray[np.bool_]  # (patch) whether it is of the frame's second half
    channel: NDArray[np.intp]  # (pixel) index along the channels of `means`
    sites: NDArray[np.uint8]  # (channel) the camera's channel
    black: float  # DN below black at which values are clipped
    span: float  # DN from black to white

    @property
    def member(self) -> NDArray[np.bool_]:
        """Return (pixel, channel) whether a pixel is of a channel."""
        return np.asarray(self.channel[:, None] == np.arange(len(self.sites)))

    def chosen(self, which: NDArray[np.bool_]) -> "_Patches":
        """Return some of the patches."""
        parts = self.values[which], self.means[which], self.half[which]
        return _Patches(*parts, self.channel, self.sites, self.black, self.span)


def _patches_of(frame: RawFrame, camera: CameraModel) -> _Patches:
    """Return patches of a frame of which few pixels are clipped; ValueError if the frame is smaller than one."""
    starts = [-phase % period for phase, period in zip(frame.phase, camera.cfa.shape, strict=True)]
    aligned = frame.values[starts[0] :, starts[1] :]
    if min(aligned.shape) < SIDE:
        raise ValueError(f"it is smaller than {SIDE}×{SIDE} pixels")
    windows = sliding_window_view(aligned, (SIDE, SIDE))
    down, across = (period * -(-LEAST_STEP // period) for period in camera.cfa.shape)
    thin = max(1, int(np.ceil(np.sqrt(windows.shape[0] * windows.shape[1] / (down * across * MOST_PATCHES)))))
    windows = windows[:: down * thin, :: across * thin]
    half = np.broadcast_to(np.arange(windows.shape[1]) // STRIPE % 2 > 0, windows.shape[:2]).ravel()
    values, full = windows.reshape(len(half), -1), frame.white_level - frame.black_level
    clipped = (values == 0) | (values >= frame.black_level + CLIPPED * full)
    sound = clipped.mean(axis=1) <= MOST_CLIPPED
    span = camera.white_level - camera.black_level
    signal = (values[sound] - frame.black_level) * (span / full)
    sites, channel = np.unique(camera.channel_map((SIDE, SIDE)), return_inverse=True)
    member = channel.ravel()[:, None] == np.arange(len(sites))
    means = signal @ (member / member.sum(axis=0))
    return _Patches(signal, means, half[sound], channel.ravel(), sites, frame.black_level * span / full, span)


@dataclass(frozen=True, eq=False)
class _Plain:
    """Plain patches, and the noise of their weak components over that which was supposed."""

    level: NDArray[np.intp]  # (patch) number of its range of signal
    measured: Array  # (patch) variance, relative
    components: int  # that it was measured in
    signal: Array  # (patch, channel) DN
    weight: Array  # (patch, channel) share of the pixels over the supposed variance, 1/DN²
    sites: NDArray[np.uint8]  # (channel) the camera's channel

    def chosen(self, which: NDArray[np.bool_]) -> "_Plain":
        """Return some of the patches."""
        parts = self.level[which], self.measured[which], self.components, self.signal[which], self.weight[which]
        return _Plain(*parts, self.sites)

    def predicted(self, camera: CameraModel, gain: float, excess: float) -> Array:
        """Return the variance (patch) at a gain, relative to the supposed one as `measured`."""
        return np.asarray((_variance(self.signal, self.sites, camera, gain, excess) * self.weight).sum(axis=1))

    def slopes(self, camera: CameraModel, gain: float, excess: float) -> Array:
        """Return the derivatives (2, patch) of its logarithm by that of the gain and by the excess."""
        middle = self.predicted(camera, gain, excess)
        moved = self.predicted(camera, gain * np.exp(SMALL), excess), self.predicted(camera, gain, excess + SMALL)
        return np.stack([np.log(each / middle) / SMALL for each in moved])


def _variance(signal: Array, sites: NDArray[np.uint8], camera: CameraModel, gain: float, excess: float) -> Array:
    """Return the variance (patch, channel) in DN² of noise, and of texture of `excess` times the usual variance."""
    constant, linear, quadratic = camera.at_gain(gain).noise_terms(channel=sites)
    return np.asarray(constant + (linear + (quadratic + USUAL_EXCESS * excess) * signal) * signal)


def _plain(patches: _Patches, camera: CameraModel, gain: float, excess: float) -> _Plain:
    """Return the plain patches by a supposed gain; ValueError if there are none."""
    signal = np.maximum(patches.means, 0.0)
    room = CLEAR * np.sqrt(_variance(signal, patches.sites, camera, gain, excess))
    clear = np.asarray(((patches.means - room > -patches.black) & (patches.means + room < patches.span)).all(axis=1))
    if clear.sum() < 4 * LEAST_PLAIN:
        raise ValueError("nearly all of it is clipped at black or white")
    patches, signal = patches.chosen(clear), signal[clear]
    variance = _variance(signal, patches.sites, camera, gain, excess)
    whitened = (patches.values - patches.means[:, patches.channel]) / np.sqrt(variance)[:, patches.channel]
    weak, strong, components = _energies(whitened, patches)
    share = patches.member.mean(axis=0)
    ranges = np.clip(len(signal) // (4 * LEAST_PLAIN), 1, LEVELS)
    plain = []
    for level in np.array_split(np.argsort(signal @ share, kind="stable"), ranges):
        plainest = level[np.argsort(strong[level], kind="stable")]
        for part, texture in PLAIN:
            some = plainest[: max(LEAST_PLAIN, int(part * len(level)))]
            if strong[some].mean() < texture * weak[some].mean():
                plain.append(some)
                break
    if not plain:
        raise ValueError("no area is plain")
    chosen, number = np.concatenate(plain), np.repeat(np.arange(len(plain)), [len(some) for some in plain])
    return _Plain(number, weak[chosen], components, signal[chosen], share / variance[chosen], patches.sites)


def _energies(whitened: Array, patches: _Patches) -> tuple[Array, Array, int]:
    """Return the mean square of the weak and of the strong components of each patch (patch), and how many are weak."""
    pixels, channels = patches.member.shape
    every = np.linalg.qr(np.concatenate([patches.member, np.eye(pixels)], axis=1))[0]
    directions = every[:, channels:]  # means are left out
    count = (pixels - channels) // 2
    weak, strong = np.empty(len(whitened)), np.empty(len(whitened))
    for half in (False, True):
        measured, other = patches.half == half, whitened[patches.half != half]
        components = directions @ np.linalg.eigh(directions.T @ (other.T @ other) @ directions)[1]  # the weakest first
        squares = (whitened[measured] @ components) ** 2
        weak[measured], strong[measured] = squares[:, :count].mean(axis=1), squares[:, count:].mean(axis=1)
    return weak, strong, count


def _consistent(plain: _Plain, camera: CameraModel, gain: float) -> _Plain:
    """Return the patches of those ranges of signal that agree about the gain, on the lowest that a quarter of them share;
    ValueError if none do. Others hold texture in weak components, such as a grating of two pixels a line."""
    count = int(plain.level.max()) + 1
    alone = [_most_likely(plain.chosen(plain.level == each), camera, gain, None)[0] for each in range(count)]
    for each in sorted(alone):
        relative = plain.measured / plain.predicted(camera, each, 0.0)
        means = np.bincount(plain.level, relative) / np.bincount(plain.level)
        agree = (means > 1 / AGREE) & (means < AGREE)
        if agree.sum() >= count / 4:
            return plain.chosen(agree[plain.level])
    raise ValueError("no area is plain")


def _most_likely(plain: _Plain, camera: CameraModel, gain: float, excess: float | None) -> tuple[float, float]:
    """Return the gain and the excess that make the measured variances most likely: these of gamma distributions about the
    predicted ones, the excess of a normal one that is 1 wide. By Fisher scoring from those supposed; None: no excess."""
    free, excess = excess is not None, excess or 0.0
    for _ in range(STEPS):
        slopes = plain.slopes(camera, gain, excess)
        if not slopes[0].any():  # black, of a camera without noise of reading
            if free:
                raise ValueError("all of it is black")
            break
        residual = plain.measured / plain.predicted(camera, gain, excess) - 1.0
        towards = plain.components / 2 * slopes @ residual - np.array([0.0, excess])
        by_gain, by_excess = np.linalg.solve(_information(slopes, plain.components), towards) if free else (0.0, -1.0)
        if not 0 <= excess + by_excess <= MOST_EXCESS:
            by_excess = np.clip(by_excess, -excess, MOST_EXCESS - excess)
            by_gain = slopes[0] @ (residual - by_excess * slopes[1]) / (slopes[0] @ slopes[0])
        gain = float(np.clip(gain * np.exp(np.clip(by_gain, -1.0, 1.0)), LOWEST, HIGHEST))
        excess += float(by_excess)
        if abs(by_gain) < SMALL:
            break
    return gain, excess


def _information(slopes: Array, components: int) -> Array:
    """Return the Fisher information (2, 2) of both parameters."""
    return np.asarray(components / 2 * slopes @ slopes.T + np.diag([0.0, 1.0]))
