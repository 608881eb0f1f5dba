"""Estimate a frame's analog gain from the noise in uniform areas (docs/method.md#gains).

1. The frame is divided into patches that are aligned with the CFA, so that all patches have the same channels at the same
   positions. In each patch, the channel means are subtracted, and the differences are divided by the standard deviation of
   the noise at an assumed gain.
2. The principal components of all patches are divided into a strong and a weak half. Texture is in the strong half. In the
   weak half, natural pictures have almost no texture. The components are computed from one half of the frame and applied to
   the other half.
3. The patches with the smallest strong components are assumed to be uniform, and their noise is measured in the weak
   components. This selection causes no bias, because the noise in the weak components is independent of the noise in the
   strong components.
4. The gain is the maximum-likelihood estimate for all uniform patches, dark and bright, under the noise model. The variance
   of the remaining texture is assumed to be proportional to the square of the signal, like that of photo-response
   nonuniformity. The factor of proportionality is fitted as a second parameter (`excess`).

These steps are repeated with the estimated gain until it no longer changes. The method combines noise estimation by
principal components (Pyatykh, Hesser and Zheng, 2013) with the selection of weakly textured patches (Liu, Tanaka and
Okutomi, 2013).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.frames.frame import RawFrame

# Side of a patch, and minimum spacing of patches (rounded up to a multiple of the CFA period), in pixels.
PATCH_SIDE_PIXELS, MIN_STEP = 8, 4
MAX_PATCHES = 20_000  # maximum number of patches in a frame
ROUNDS, CLOSE = 10, 0.01  # maximum number of iterations; they end earlier if the relative change in gain is below CLOSE
STRIPE = 8  # width, in patches, of the alternating vertical stripes that form the two halves of the frame
# A pixel is clipped at or above the fraction CLIPPED of full scale. A patch is used only if at most the fraction MAX_CLIPPED
# of its pixels is clipped.
CLIPPED, MAX_CLIPPED = 0.99, 0.02
# Minimum distance between a channel mean and black or white, in standard deviations, so that almost no noise is clipped.
MIN_DEVIATIONS = 2.5
SIGNAL_RANGES, MIN_PLAIN = 8, 32  # maximum number of signal ranges, and minimum number of uniform patches in each range
# Criteria for uniform patches, in the order in which they are tried. Each criterion consists of the fraction of patches to
# select in a signal range, and the maximum mean square of their strong components, relative to their weak components.
PLAIN = ((0.05, 1.0), (0.01, 2.0))
AGREE = 1.3  # a signal range agrees with a gain if its measured and predicted variance differ by less than this factor
LOWEST, HIGHEST = 2.0**-8, 2.0**10  # range of gains
USUAL_EXCESS, MAX_EXCESS = 0.01**2, 25.0  # expected relative variance of texture, and maximum multiple of this variance
# Fisher scoring: maximum number of steps. It ends earlier if log gain changes by less than SMALL.
MAX_SCORING_STEPS, SMALL = 50, 1e-4
# Relative standard errors: systematic error (tests/studies/test_gain_study.py), and maximum error of an accepted estimate.
SYSTEMATIC, MAX_ERROR = 0.04, 0.08
LINE_TERMS = (
    "row_temporal_noise", "column_temporal_noise", "row_noise", "column_noise", "row_prnu", "column_prnu",
)  # fmt: skip
Array = NDArray[np.float64]


@dataclass(frozen=True)
class GainEstimate:
    """An estimated analog gain, relative to the gain of the camera model."""

    gain: float
    error: float  # relative standard error

    @property
    def bounds(self) -> tuple[float, float]:
        """Interval of ±2 standard errors around the gain, on a logarithmic scale."""
        return self.gain * float(np.exp(-2 * self.error)), self.gain * float(np.exp(2 * self.error))


def estimate_gain(frame: RawFrame, camera: CameraModel) -> GainEstimate:
    """Estimate a frame's analog gain, relative to the gain of the camera model.

    The frame may have any black and white levels, and any phase of the camera's CFA.

    Raises
    ------
    ValueError
        If the gain cannot be estimated, for example because too few areas are uniform and unclipped. The message is
        only the reason, because the caller tells the user what to do.
    """
    camera = _without_lines(camera)
    patches, gain, excess = _patches_of(frame, camera), 1.0, 0.0
    for _ in range(ROUNDS):
        plain = _consistent(_plain(patches, camera, gain, excess), camera, gain)
        before, (gain, excess) = gain, _most_likely(plain, camera, gain, excess)
        if abs(np.log(gain / before)) < CLOSE:
            break
    of_chance = np.linalg.inv(_information(plain.slopes(camera, gain, excess), plain.components))[0, 0]
    error = float(np.sqrt(of_chance + SYSTEMATIC**2))
    if error > MAX_ERROR:
        raise ValueError("too few areas are uniform")
    return GainEstimate(float(f"{gain:.3g}"), error)


def _without_lines(camera: CameraModel) -> CameraModel:
    """Return the camera without the noise of rows and columns.

    In a patch, row and column noise has one component per row and one per column. These are among the strong components, so
    the weak components contain only the noise of single pixels.
    """
    camera = camera.as_corrected()
    return replace(camera, noise=replace(camera.noise, **dict.fromkeys(LINE_TERMS, 0.0)))


@dataclass(frozen=True, eq=False)
class _Patches:
    """A frame's patches, in DN above black, scaled to the levels of the camera model."""

    values: Array  # (patch, pixel)
    means: Array  # (patch, channel) mean of each channel
    half: NDArray[np.bool_]  # (patch) whether the patch is in the second half of the frame
    channel: NDArray[np.intp]  # (pixel) channel, as an index into the columns of `means`
    sites: NDArray[np.uint8]  # (channel) index of the channel in the camera model
    black: float  # DN; black level of the frame, and therefore the largest possible negative signal
    span: float  # DN; difference between white and black level

    @property
    def member(self) -> NDArray[np.bool_]:
        """Mask of each channel's pixels: (pixel, channel)."""
        return np.asarray(self.channel[:, None] == np.arange(len(self.sites)))

    def chosen(self, which: NDArray[np.bool_]) -> "_Patches":
        parts = self.values[which], self.means[which], self.half[which]
        return _Patches(*parts, self.channel, self.sites, self.black, self.span)


def _patches_of(frame: RawFrame, camera: CameraModel) -> _Patches:
    """Cut a frame into at most about MAX_PATCHES patches, and return those with few clipped pixels.

    Raises ValueError if the frame is smaller than a patch.
    """
    starts = [-phase % period for phase, period in zip(frame.phase, camera.cfa.shape, strict=True)]
    aligned = frame.values[starts[0] :, starts[1] :]
    if min(aligned.shape) < PATCH_SIDE_PIXELS:
        raise ValueError(f"the frame is smaller than {PATCH_SIDE_PIXELS}×{PATCH_SIDE_PIXELS} pixels")
    windows = sliding_window_view(aligned, (PATCH_SIDE_PIXELS, PATCH_SIDE_PIXELS))
    down, across = (period * -(-MIN_STEP // period) for period in camera.cfa.shape)
    thin = max(1, int(np.ceil(np.sqrt(windows.shape[0] * windows.shape[1] / (down * across * MAX_PATCHES)))))
    windows = windows[:: down * thin, :: across * thin]
    half = np.broadcast_to(np.arange(windows.shape[1]) // STRIPE % 2 > 0, windows.shape[:2]).ravel()
    values, full = windows.reshape(len(half), -1), frame.white_level - frame.black_level
    clipped = (values == 0) | (values >= frame.black_level + CLIPPED * full)
    sound = clipped.mean(axis=1) <= MAX_CLIPPED
    span = camera.white_level - camera.black_level
    signal = (values[sound] - frame.black_level) * (span / full)
    sites, channel = np.unique(camera.channel_map((PATCH_SIDE_PIXELS, PATCH_SIDE_PIXELS)), return_inverse=True)
    member = channel.ravel()[:, None] == np.arange(len(sites))
    means = signal @ (member / member.sum(axis=0))
    return _Patches(signal, means, half[sound], channel.ravel(), sites, frame.black_level * span / full, span)


@dataclass(frozen=True, eq=False)
class _Plain:
    """Uniform patches, and the variance of their weak components.

    Variances are relative to an assumed variance: the noise variance at the gain with which the patches were selected.
    """

    level: NDArray[np.intp]  # (patch) index of the signal range
    measured: Array  # (patch) measured variance, relative to the assumed variance
    components: int  # number of weak components
    signal: Array  # (patch, channel) mean signal in DN
    weight: Array  # (patch, channel) 1/DN²; the channel's fraction of the pixels, divided by the assumed variance
    sites: NDArray[np.uint8]  # (channel) index of the channel in the camera model

    def chosen(self, which: NDArray[np.bool_]) -> "_Plain":
        parts = self.level[which], self.measured[which], self.components, self.signal[which], self.weight[which]
        return _Plain(*parts, self.sites)

    def predicted(self, camera: CameraModel, gain: float, excess: float) -> Array:
        """Predict each patch's variance from the noise model at `gain`, relative to the assumed variance."""
        return np.asarray((_variance(self.signal, self.sites, camera, gain, excess) * self.weight).sum(axis=1))

    def slopes(self, camera: CameraModel, gain: float, excess: float) -> Array:
        """Return the derivatives of the log predicted variance with respect to log gain and excess: (2, patch)."""
        middle = self.predicted(camera, gain, excess)
        moved = self.predicted(camera, gain * np.exp(SMALL), excess), self.predicted(camera, gain, excess + SMALL)
        return np.stack([np.log(each / middle) / SMALL for each in moved])


def _variance(signal: Array, sites: NDArray[np.uint8], camera: CameraModel, gain: float, excess: float) -> Array:
    """Return the variance of noise plus texture, in DN², for each patch and channel.

    The relative variance of the texture is `excess` · USUAL_EXCESS.
    """
    constant, linear, quadratic = camera.at_gain(gain).noise_terms(channel=sites)
    return np.asarray(constant + (linear + (quadratic + USUAL_EXCESS * excess) * signal) * signal)


def _plain(patches: _Patches, camera: CameraModel, gain: float, excess: float) -> _Plain:
    """Select uniform patches, for an assumed gain and excess.

    Patches near black or white are excluded. All others are divided into signal ranges, and the most uniform patches in each
    range are selected. Raises ValueError if nearly all patches are near black or white, or if none is uniform.
    """
    signal = np.maximum(patches.means, 0.0)
    room = MIN_DEVIATIONS * np.sqrt(_variance(signal, patches.sites, camera, gain, excess))
    clear = np.asarray(((patches.means - room > -patches.black) & (patches.means + room < patches.span)).all(axis=1))
    if clear.sum() < 4 * MIN_PLAIN:
        raise ValueError("nearly all pixels are clipped at black or white")
    patches, signal = patches.chosen(clear), signal[clear]
    variance = _variance(signal, patches.sites, camera, gain, excess)
    whitened = (patches.values - patches.means[:, patches.channel]) / np.sqrt(variance)[:, patches.channel]
    weak, strong, components = _energies(whitened, patches)
    share = patches.member.mean(axis=0)
    ranges = np.clip(len(signal) // (4 * MIN_PLAIN), 1, SIGNAL_RANGES)
    plain = []
    for level in np.array_split(np.argsort(signal @ share, kind="stable"), ranges):
        plainest = level[np.argsort(strong[level], kind="stable")]
        for part, texture in PLAIN:
            some = plainest[: max(MIN_PLAIN, int(part * len(level)))]
            if strong[some].mean() < texture * weak[some].mean():
                plain.append(some)
                break
    if not plain:
        raise ValueError("no uniform area was found")
    chosen, number = np.concatenate(plain), np.repeat(np.arange(len(plain)), [len(some) for some in plain])
    return _Plain(number, weak[chosen], components, signal[chosen], share / variance[chosen], patches.sites)


def _energies(whitened: Array, patches: _Patches) -> tuple[Array, Array, int]:
    """Split the variation within each patch into weak components (noise) and strong components (texture).

    The components are the eigenvectors of the pixel covariance, orthogonal to the channel means. They are computed from one
    half of the patches and applied to the other half, so that no patch affects its own components.

    Returns
    -------
    weak, strong : ndarray, (patch,)
        Mean squares of the components with the smaller eigenvalues, and of the components with the larger eigenvalues.
    count : int
        Number of weak components.
    """
    pixels, channels = patches.member.shape
    every = np.linalg.qr(np.concatenate([patches.member, np.eye(pixels)], axis=1))[0]
    directions = every[:, channels:]  # orthogonal to the channel means
    count = (pixels - channels) // 2
    weak, strong = np.empty(len(whitened)), np.empty(len(whitened))
    for half in (False, True):
        measured, other = patches.half == half, whitened[patches.half != half]
        components = directions @ np.linalg.eigh(directions.T @ (other.T @ other) @ directions)[1]  # in ascending order
        squares = (whitened[measured] @ components) ** 2
        weak[measured], strong[measured] = squares[:, :count].mean(axis=1), squares[:, count:].mean(axis=1)
    return weak, strong, count


def _consistent(plain: _Plain, camera: CameraModel, gain: float) -> _Plain:
    """Keep only the patches in signal ranges where the weak components contain noise and no texture.

    Texture in the weak components, for example a grating with a period of two pixels, raises the gain that is estimated from
    a range. A gain is therefore estimated from each range separately, and these gains are tried in ascending order. The
    first gain that predicts the noise in at least a quarter of the ranges is accepted, and these ranges are kept. Raises
    ValueError if no gain does.
    """
    count = int(plain.level.max()) + 1
    alone = [_most_likely(plain.chosen(plain.level == each), camera, gain, None)[0] for each in range(count)]
    for each in sorted(alone):
        relative = plain.measured / plain.predicted(camera, each, 0.0)
        means = np.bincount(plain.level, relative) / np.bincount(plain.level)
        agree = (means > 1 / AGREE) & (means < AGREE)
        if agree.sum() >= count / 4:
            return plain.chosen(agree[plain.level])
    raise ValueError("no uniform area was found")


def _most_likely(plain: _Plain, camera: CameraModel, gain: float, excess: float | None) -> tuple[float, float]:
    """Find the most likely gain and excess for the measured variances, by Fisher scoring that starts at `gain` and `excess`.

    The measured variances are assumed to have gamma distributions around the predicted variances. The prior of the excess is
    a normal distribution with a standard deviation of 1. If `excess` is None, it is fixed at 0. Otherwise, ValueError is
    raised if all pixels are black, because the noise then does not depend on the gain.
    """
    free, excess = excess is not None, excess or 0.0
    for _ in range(MAX_SCORING_STEPS):
        slopes = plain.slopes(camera, gain, excess)
        if not slopes[0].any():  # the frame is black, and the camera has no read noise
            if free:
                raise ValueError("all pixels are black")
            break
        residual = plain.measured / plain.predicted(camera, gain, excess) - 1.0
        towards = plain.components / 2 * slopes @ residual - np.array([0.0, excess])
        by_gain, by_excess = np.linalg.solve(_information(slopes, plain.components), towards) if free else (0.0, -1.0)
        if not 0 <= excess + by_excess <= MAX_EXCESS:
            by_excess = np.clip(by_excess, -excess, MAX_EXCESS - excess)
            by_gain = slopes[0] @ (residual - by_excess * slopes[1]) / (slopes[0] @ slopes[0])
        gain = float(np.clip(gain * np.exp(np.clip(by_gain, -1.0, 1.0)), LOWEST, HIGHEST))
        excess += float(by_excess)
        if abs(by_gain) < SMALL:
            break
    return gain, excess


def _information(slopes: Array, components: int) -> Array:
    """Return the Fisher information matrix, (2, 2), of the log gain and the excess."""
    return np.asarray(components / 2 * slopes @ slopes.T + np.diag([0.0, 1.0]))
