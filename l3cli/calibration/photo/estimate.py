"""Estimate a camera's responsivities, and a photo's illuminant, from the patches of a colour chart.

The estimate is the posterior of a Gaussian model (docs/method.md#charts-in-photographs). The same model provides the
probability of each candidate illuminant. It also determines which illuminant an additional photo should have, so that the
colour error decreases most.
"""

import functools
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.frames.measurement import CurveStatistics, FinishedCurves
from l3cli.physics import spectra

WAVELENGTH = np.arange(400.0, 721.0, 10.0)  # nm; all published camera responsivities cover this range
ROLES = ("r", "g", "b")  # channels of the measured cameras
MODES = 16  # number of principal components of measured cameras; more components would not change the results
# The prior of measured cameras includes smooth deviations. The constants are the deviations' fraction of the variance and
# their correlation length in nm.
SMOOTH_SHARE, SMOOTH_NM = 0.1, 25.0
LEAST_SPREAD = 0.01  # smallest standard deviation between cameras, as a fraction of the peak
# Mean, standard deviation and correlation length (nm) of the responsivity of an unknown filter.
UNKNOWN_MEAN, UNKNOWN_SPREAD, UNKNOWN_NM = 0.3, 0.35, 45.0
UNKNOWN_PEAK = 0.7  # standard deviation of the natural logarithm of the peak of an unknown channel
PEAK_FLOOR = 0.25  # added in quadrature to the spread of known peaks, because channels may have different converter gains
MEASURED, UNLIKE, SMOOTH = "measured cameras", "cameras unlike the measured ones", "smooth"  # names of the priors
# The prior of unusual cameras has WIDENING times the standard deviation of measured cameras. It also includes smooth
# deviations with the standard deviation UNLIKE_SPREAD (fraction of the peak) and the correlation length UNLIKE_NM.
WIDENING = 2.0
UNLIKE_SPREAD, UNLIKE_NM = 0.05, 35.0
# The evidence for an illuminant is overconfident, because no prior describes a camera exactly. With the log evidence divided
# by these factors, the computed probabilities match the frequency of correct guesses (tests/studies/test_photo_study.py).
TEMPERING = {True: 1.5, False: 6.0}  # True: one of the priors is based on measured cameras
JITTER = 1e-6  # added to the diagonals of covariances, so that they can be inverted
STEPS = 4  # number of times that the product of responsivity and illumination is linearised; 3 would be almost as good
SCALE_SPREAD = 0.5  # relative standard deviation of a channel's scale around the first guess; nearly uninformative
SHOT_SPREAD = 0.3  # relative standard deviation of a shot's exposure around the first guess, except for the first shot
FARTHEST = 4.0  # largest factor by which scales and exposures may differ from the first guess
CURVATURE = 0.5  # standard deviation of a quadratic term of the illumination, relative to a linear term
FLOOR = 0.001  # unexplained error, as a fraction of the brightest patch
ERRORS = (0.0, 0.002, 0.005, 0.01, 0.02, 0.035, 0.06)  # relative model errors to try, from wrong reflectances or texture
TERMS = 6  # number of terms of the illumination: constant, x, y, x², xy, y²
Array = NDArray[np.floating]
MOST_EVIDENCES = 1000  # largest number of cached results
_EVIDENCES: dict[bytes, float] = {}  # cache, because the same shots and illuminants are evaluated three times
IMPROBABLE = 0.02  # illuminants with a lower probability do not widen the confidence band
# l3 warns if another illuminant is more probable than the specified one, and the log probability ratio exceeds this value.
NOTICED = 3.0


@dataclass(frozen=True)
class Prior:
    """Gaussian prior for a camera's responsivity curves and their peak heights."""

    mean: Array  # (channel, wavelength): mean of the curves, each with a peak of about 1
    covariance: Array  # (channel · wavelength, channel · wavelength): covariance of the curves
    log_peak: Array  # (channel,): mean of the natural logarithm of the peak
    log_peak_covariance: Array  # (channel, channel): covariance of these logarithms
    source: str  # MEASURED, UNLIKE or SMOOTH


def statistics(cameras: Sequence[FinishedCurves]) -> CurveStatistics:
    """Compute the mean responsivity curves of several cameras, and up to MODES principal components.

    All cameras must have the same channels.
    """
    curves = np.array([spectra.average(each.responsivity, each.wavelength, WAVELENGTH) for each in cameras])
    peaks = curves.max(axis=2)
    shapes = curves / peaks[..., None]
    mean = shapes.mean(axis=0)
    flat = (shapes - mean).reshape(len(curves), -1) / np.sqrt(max(len(curves) - 1, 1))
    _, size, directions = np.linalg.svd(flat, full_matrices=False)
    chosen = (size[:, None] * directions)[:MODES]
    heights = np.log(peaks) - np.log(peaks).mean(axis=1, keepdims=True)
    spread = np.atleast_2d(np.cov(heights.T)) if len(curves) > 1 else np.zeros((mean.shape[0],) * 2)
    return CurveStatistics(WAVELENGTH, mean, chosen.reshape(-1, *mean.shape), heights.mean(axis=0), spread)


def camera_prior(known: CurveStatistics) -> Prior:
    """Return the prior for a camera that resembles the measured cameras and has the same channels."""
    count, size = known.mean.shape
    covariance = _covariance(known.modes).reshape(count * size, count * size) + JITTER * np.eye(count * size)
    return Prior(
        known.mean,
        np.asarray(covariance, np.float64),
        known.log_peak,
        known.log_peak_covariance + PEAK_FLOOR**2 * np.eye(count),
        MEASURED,
    )


def unlike(prior: Prior) -> Prior:
    """Widen the prior of the measured cameras, so that it also covers cameras that are unlike all of them.

    The covariance is multiplied by WIDENING². Then the covariance of smooth deviations is added, which do not occur in any
    measured camera.
    """
    count, size = prior.mean.shape
    further = np.kron(np.eye(count), _smooth(np.full(size, UNLIKE_SPREAD), UNLIKE_NM))
    return replace(prior, covariance=WIDENING**2 * prior.covariance + further, source=UNLIKE)


def placed(prior: Prior, places: Sequence[int], channels: int) -> Prior:
    """Extend a prior to a camera with more channels, or with the same channels in a different order.

    Parameters
    ----------
    prior : Prior
        Prior for some of the channels.
    places : sequence of int
        New index of each channel in `prior`. All other channels of the result get the smooth prior.
    channels : int
        Number of channels in the result.
    """
    whole, size = smooth(channels), WAVELENGTH.size
    at = np.array(places)
    curves = (at[:, None] * size + np.arange(size)).ravel()
    mean, covariance = whole.mean.copy(), whole.covariance.copy()
    peak, spread = whole.log_peak.copy(), whole.log_peak_covariance.copy()
    mean[at], peak[at] = prior.mean, prior.log_peak
    covariance[np.ix_(curves, curves)], spread[np.ix_(at, at)] = prior.covariance, prior.log_peak_covariance
    return Prior(mean, covariance, peak, spread, prior.source)


def plausible(channels: Sequence[str], known: CurveStatistics | None) -> list[Prior]:
    """Return the priors that may describe a camera.

    If the camera has the channels r, g and b, these are the prior of the measured cameras, the wider prior from `unlike`,
    and the smooth prior. For other cameras, or if `known` is None, it is only the smooth prior.
    """
    if known is None or not set(ROLES) <= set(channels):
        return [smooth(len(channels))]
    like = camera_prior(known)
    places = [channels.index(role) for role in ROLES]
    return [*(placed(each, places, len(channels)) for each in (like, unlike(like))), smooth(len(channels))]


def smooth(channels: int) -> Prior:
    """Return a prior for channels with unknown filters. It assumes only that their curves are smooth."""
    size = WAVELENGTH.size
    one = _smooth(np.full(size, UNKNOWN_SPREAD), UNKNOWN_NM) + JITTER * np.eye(size)
    covariance = np.kron(np.eye(channels), one)
    mean = np.full((channels, size), UNKNOWN_MEAN)
    return Prior(mean, covariance, np.zeros(channels), np.eye(channels) * UNKNOWN_PEAK**2, SMOOTH)


def _covariance(modes: Array) -> Array:
    """Return the covariance of measured cameras' curves: (channel, wavelength, channel, wavelength).

    It is the weighted mean of two covariances. One is the covariance of the principal components `modes`, (mode, channel,
    wavelength). The other is the covariance of smooth deviations, which are independent in each channel.
    """
    _, count, size = modes.shape
    flat = modes.reshape(len(modes), -1)
    sampled = flat.T @ flat
    spread = np.hypot(np.sqrt(np.diag(sampled)).reshape(count, size), LEAST_SPREAD)
    smooth = np.zeros((count, size, count, size))
    for channel in range(count):
        smooth[channel, :, channel] = _smooth(spread[channel], SMOOTH_NM)
    return (1 - SMOOTH_SHARE) * sampled.reshape(count, size, count, size) + SMOOTH_SHARE * smooth


def _smooth(spread: Array, correlation_nm: float) -> Array:
    """Return the covariance (wavelength, wavelength) of smooth deviations with the standard deviation `spread`."""
    distance = (WAVELENGTH[:, None] - WAVELENGTH) / correlation_nm
    return np.exp(-0.5 * distance**2) * np.outer(spread, spread)


@dataclass(frozen=True)
class Shot:
    """The patches of a chart in one photo under one illuminant."""

    light: Array  # (wavelength,): relative photon radiance of a perfect white
    reflectance: Array  # (patch, wavelength)
    place: Array  # (patch, 2): x and y on the chart, from −1 to 1
    values: Array  # (patch, channel): mean value above black in DN
    deviation: Array  # (patch, channel): standard deviation of each value in DN
    used: NDArray[np.bool_]  # (patch, channel): whether the value is used
    # prior standard deviation of the illumination's linear terms; small if a white target corrects the illumination
    uneven: float = 0.2
    glare: float = 0.03  # standard deviation of the glare, as a fraction of the brightest patch

    @functools.cached_property
    def stimuli(self) -> Array:
        """Each patch's relative photon radiance: (patch, wavelength)."""
        return self.reflectance * self.light

    @functools.cached_property
    def terms(self) -> Array:
        """Illumination terms at each patch: (patch, term)."""
        return terms(self.place)

    @functools.cached_property
    def brightest(self) -> Array:
        """Largest used value in each channel, in DN above black: (channel,). If no value is used, it is 1."""
        top = np.where(self.used, self.values, 0.0).max(axis=0)
        return np.where(top > 0, top, 1.0)


@dataclass(frozen=True)
class Posterior:
    """Estimate of a camera's responsivities from the patches in one or more photos."""

    responsivity: Array  # (channel, wavelength): DN per unit of the illuminant; never negative
    covariance: Array  # (channel · wavelength, channel · wavelength): covariance of the responsivity
    glare: Array  # (shot, channel): offset that glare adds to all patches, in DN
    illumination: Array  # (shot, term): coefficients of the illumination terms
    error: float  # relative error of the patch values apart from noise, for example from wrong reflectances
    evidence: float  # natural logarithm of the probability of the values, up to a constant
    predicted: tuple[Array, ...]  # for each shot, (patch, channel): predicted value in DN


def estimate(shots: Sequence[Shot], prior: Prior) -> Posterior:
    """Estimate the responsivities from all shots, assuming the most probable model error in ERRORS."""
    candidates = [_solve(shots, prior, error) for error in ERRORS]
    best = max(candidates, key=lambda solution: solution.evidence)
    return best.posterior()


def evidence(shots: Sequence[Shot], prior: Prior) -> float:
    """Return the log probability of the patch values under the illuminants in `shots`, up to a constant.

    The probability is averaged over the model errors in ERRORS. Results are cached.
    """
    every: list[Shot | Prior] = [*shots, prior]
    parts = [getattr(each, field.name) for each in every for field in fields(each) if field.name != "source"]
    content = hashlib.sha256(b"".join(np.asarray(part).tobytes() for part in parts)).digest()
    if content not in _EVIDENCES:
        if len(_EVIDENCES) == MOST_EVIDENCES:
            _EVIDENCES.clear()
        _EVIDENCES[content] = _log_mean([_solve(shots, prior, error).evidence for error in ERRORS])
    return _EVIDENCES[content]


def _log_mean(logarithms: Sequence[float]) -> float:
    """Return ln(mean(exp(logarithms))) without overflow."""
    return float(np.logaddexp.reduce(logarithms) - np.log(len(logarithms)))


def terms(place: Array) -> Array:
    """Evaluate the illumination's polynomial terms at patch coordinates: (patch, term).

    `place`, (patch, 2), contains x and y, from −1 to 1 across the chart.
    """
    x, y = place.T
    return np.stack([np.ones_like(x), x, y, x * x - np.mean(x * x), x * y, y * y - np.mean(y * y)], axis=1)


# -------------------------------------------------------------------------------------------------------- solution


@dataclass(frozen=True)
class _Solution:
    """The final linearised model, values ≈ design @ state, and its solution.

    The state vector contains the responsivities, the glare and the illumination coefficients. It has a Gaussian prior.
    """

    shots: Sequence[Shot]
    shape: tuple[int, int]  # number of channels, number of wavelengths
    design: Array  # (value, state)
    values: Array  # (value,): right-hand side of the linearised model
    noise: Array  # (value,): variance of each value
    mean: Array  # (state,): mean of the prior
    covariance: Array  # (state, state): covariance of the prior
    state: Array  # (state,): most probable state, which may contain negative responsivities
    error: float  # model error, as in `Posterior`
    evidence: float  # as in `Posterior`

    def posterior(self) -> Posterior:
        """Return the estimate, with responsivities constrained to be non-negative."""
        count, size = self.shape
        curves = count * size
        state = self.state if self.state[:curves].min() >= 0 else self._not_negative()
        gain = np.linalg.solve(self.design @ self.covariance @ self.design.T + np.diag(self.noise), self.design)
        spread = self.covariance - self.covariance @ self.design.T @ gain @ self.covariance
        responsivity, glare, illumination = _split_state(state, len(self.shots), count, size)
        return Posterior(
            responsivity,
            spread[:curves, :curves],
            glare,
            illumination,
            self.error,
            self.evidence,
            tuple(_predict(shot, responsivity, glare[i], illumination[i]) for i, shot in enumerate(self.shots)),
        )

    def _not_negative(self) -> Array:
        """Return the most probable state in which no responsivity is negative."""
        from scipy.optimize import lsq_linear

        curves = self.shape[0] * self.shape[1]
        free = np.diag(self.covariance) > 0
        root = np.linalg.cholesky(self.covariance[np.ix_(free, free)])
        whitening = np.linalg.solve(root, np.eye(len(root)))
        weight = 1.0 / np.sqrt(self.noise)
        system = np.vstack([self.design[:, free] * weight[:, None], whitening])
        measured = (self.values - self.design[:, ~free] @ self.mean[~free]) * weight
        right = np.concatenate([measured, whitening @ self.mean[free]])
        least = np.where(np.arange(free.size) < curves, 0.0, -np.inf)[free]
        state = self.mean.copy()
        state[free] = lsq_linear(system, right, bounds=(least, np.inf)).x
        return state


def _solve(shots: Sequence[Shot], prior: Prior, error: float) -> _Solution:
    count, size = prior.mean.shape
    used = np.concatenate([shot.used.T.ravel() for shot in shots])  # channel by channel
    state = _first_guess(shots, prior)
    first = scale = _scale(state, prior)
    for _ in range(STEPS):
        mean, covariance = _before(shots, prior, scale)
        design, right, noise = _expansion(shots, state, count, size, error)
        design, right, noise = design[used], right[used], noise[used]
        across = covariance @ design.T
        spread = design @ across + np.diag(noise)
        off = right - design @ mean
        solved = np.linalg.solve(spread, off)
        state = mean + across @ solved
        # Under a wrong illuminant, the iteration could diverge. The scales are therefore kept close to the first guess.
        scale = np.clip(_scale(state, prior), first / FARTHEST, first * FARTHEST)
        # For the same reason, the exposures are kept close to their prior means.
        exposures = slice(state.size - len(shots) * TERMS, None, TERMS)
        state[exposures] = np.clip(state[exposures], mean[exposures] / FARTHEST, mean[exposures] * FARTHEST)
    logarithm = np.log(np.diag(np.linalg.cholesky(spread))).sum()
    probability = -0.5 * off @ solved - logarithm + _peaks(state, prior)
    return _Solution(shots, (count, size), design, right, noise, mean, covariance, state, error, float(probability))


def _first_guess(shots: Sequence[Shot], prior: Prior) -> Array:
    """Return the initial state: the prior's mean curves scaled to the first shot, uniform illumination and no glare."""
    count = len(prior.mean)
    expected = [shot.stimuli @ prior.mean.T for shot in shots]

    def ratio(shot: Shot, predicted: Array) -> Array:
        top = (shot.values * predicted * shot.used).sum(axis=0)
        return np.maximum(top / np.maximum((predicted**2 * shot.used).sum(axis=0), 1e-300), 1e-12)

    scale = ratio(shots[0], expected[0])
    illumination = np.zeros((len(shots), TERMS))
    for index, shot in enumerate(shots):
        illumination[index, 0] = np.median(ratio(shot, expected[index]) / scale)
    glare = np.zeros(len(shots) * count)
    return np.concatenate([(scale[:, None] * prior.mean).ravel(), glare, illumination.ravel()])


def _scale(state: Array, prior: Prior) -> Array:
    """Return, for each channel, the least-squares factor from the prior's mean curve to the curve in `state`."""
    count, size = prior.mean.shape
    curves = state[: count * size].reshape(count, size)
    return np.maximum((curves * prior.mean).sum(axis=1) / (prior.mean**2).sum(axis=1), 1e-12)


def _before(shots: Sequence[Shot], prior: Prior, scale: Array) -> tuple[Array, Array]:
    """Return the prior mean and covariance of the state, with each channel's curve scaled by `scale`."""
    count, size = prior.mean.shape
    curves = (scale[:, None] * prior.mean).ravel()
    factors = np.repeat(scale, size)
    spread = prior.covariance * np.outer(factors, factors)
    for channel in range(count):
        part = slice(channel * size, (channel + 1) * size)
        spread[part, part] += SCALE_SPREAD**2 * np.outer(curves[part], curves[part])
    glare = np.concatenate([(shot.glare * shot.brightest) ** 2 for shot in shots])
    linear = np.array([0.0, 1.0, 1.0, CURVATURE, CURVATURE, CURVATURE])
    illumination = np.concatenate([(shot.uneven * linear) ** 2 for shot in shots])
    illumination[TERMS::TERMS] = SHOT_SPREAD**2
    exposures = np.concatenate(
        [np.eye(1, TERMS)[0] * _exposure(shots, index, curves.reshape(count, size)) for index in range(len(shots))]
    )
    mean = np.concatenate([curves, np.zeros(glare.size), exposures])
    covariance = np.zeros((mean.size, mean.size))
    covariance[: curves.size, : curves.size] = spread
    rest = np.arange(curves.size, mean.size)
    covariance[rest, rest] = np.concatenate([glare, illumination * np.repeat(exposures[::TERMS], TERMS) ** 2])
    return mean, covariance


def _exposure(shots: Sequence[Shot], index: int, curves: Array) -> float:
    """Estimate a shot's exposure relative to the first shot, from the responsivities `curves`."""
    if index == 0:
        return 1.0
    shot, predicted = shots[index], shots[index].stimuli @ curves.T
    return float((shot.values * shot.used).sum() / (predicted * shot.used).sum())


def _expansion(shots: Sequence[Shot], state: Array, count: int, size: int, error: float) -> tuple[Array, Array, Array]:
    """Linearise the model around a state. Return the design matrix, the right-hand side and the variances.

    Rows are sorted by shot, then channel, then patch.
    """
    responsivity, glare, illumination = _split_state(state, len(shots), count, size)
    designs, rights, variances = [], [], []
    curves, offsets = count * size, len(shots) * count
    for index, shot in enumerate(shots):
        basis = shot.terms
        share, even = basis @ illumination[index], shot.stimuli @ responsivity.T
        design = np.zeros((count, len(basis), state.size))
        for channel in range(count):
            design[channel, :, channel * size : (channel + 1) * size] = share[:, None] * shot.stimuli
            design[channel, :, curves + index * count + channel] = 1.0
            first = curves + offsets + index * TERMS
            design[channel, :, first : first + TERMS] = even[:, channel, None] * basis
        predicted = share[:, None] * even + glare[index]
        designs.append(design.reshape(-1, state.size))
        rights.append((shot.values + share[:, None] * even).T.ravel())
        known = shot.deviation**2 + (FLOOR * shot.brightest) ** 2 + (error * predicted) ** 2
        variances.append(known.T.ravel())
    return np.concatenate(designs), np.concatenate(rights), np.concatenate(variances)


def _split_state(state: Array, shots: int, count: int, size: int) -> tuple[Array, Array, Array]:
    """Split a state into responsivities (channel, wavelength), glare (shot, channel) and illumination (shot, term)."""
    curves, offsets = count * size, shots * count
    return (
        state[:curves].reshape(count, size),
        state[curves : curves + offsets].reshape(shots, count),
        state[curves + offsets :].reshape(shots, TERMS),
    )


def _predict(shot: Shot, responsivity: Array, glare: Array, illumination: Array) -> Array:
    """Predict a shot's patch values in DN: (patch, channel)."""
    return (shot.terms @ illumination)[:, None] * (shot.stimuli @ responsivity.T) + glare


def _peaks(state: Array, prior: Prior) -> float:
    """Return the log prior probability of the channels' relative peak heights, up to a constant."""
    count, size = prior.mean.shape
    heights = np.log(np.maximum(state[: count * size].reshape(count, size).max(axis=1), 1e-300))
    off = heights - heights.mean() - (prior.log_peak - prior.log_peak.mean())
    return float(-0.5 * off @ np.linalg.solve(prior.log_peak_covariance + 1e-9 * np.eye(count), off))


def compare(shots: Sequence[Shot], index: int, among: Sequence[Prior], candidates: Mapping[str, Array]) -> tuple[str, float]:
    """Find the most probable common illuminant for a shot, and compare it with the shot's stated illuminant.

    Parameters
    ----------
    shots : sequence of Shot
        Photos of charts, from one camera.
    index : int
        Index of the shot.
    among : sequence of Prior
        Possible priors for the camera, from `plausible`.
    candidates : mapping of str to ndarray, (wavelength,)
        Relative photon radiances of the common illuminants.

    Returns
    -------
    nearest : str
        The most probable common illuminant.
    deficit : float
        Natural logarithm of the probability ratio between `nearest` and the illuminant in `shots[index]`, at least 0.
    """
    others = {name: _likelihood(_under(shots, index, light), among) for name, light in candidates.items()}
    nearest = max(others, key=lambda name: others[name])
    return nearest, max(others[nearest] - _likelihood(shots, among), 0.0)


def probabilities(
    shots: Sequence[Shot], index: int, among: Sequence[Prior], candidates: Mapping[str, Array]
) -> dict[str, float]:
    """Return each candidate illuminant's probability for a shot, assuming that one of the candidates is correct.

    The parameters are the same as in `compare`.
    """
    logarithms = {name: _likelihood(_under(shots, index, light), among) for name, light in candidates.items()}
    top = max(logarithms.values())
    weights = {name: float(np.exp(each - top)) for name, each in logarithms.items()}
    return {name: weight / sum(weights.values()) for name, weight in weights.items()}


def unsure_of_light(
    posterior: Posterior,
    shots: Sequence[Shot],
    index: int,
    prior: Prior,
    likely: Mapping[str, float],
    candidates: Mapping[str, Array],
) -> Posterior:
    """Widen a posterior's covariance, because the illuminant was guessed.

    The responsivities are estimated again under each probable illuminant and scaled to the same sum. The scatter of these
    estimates is added to the covariance, weighted by the illuminants' probabilities.

    Parameters
    ----------
    posterior : Posterior
        Estimate under the guessed illuminant.
    shots : sequence of Shot
        All shots.
    index : int
        Index of the shot with the guessed illuminant.
    prior : Prior
        Prior for the camera.
    likely : mapping of str to float
        Probability of each illuminant. Illuminants with a probability below IMPROBABLE are ignored.
    candidates : mapping of str to ndarray, (wavelength,)
        Relative photon radiance of each illuminant.
    """
    added = np.zeros_like(posterior.covariance)
    for name, probability in likely.items():
        if probability < IMPROBABLE or candidates[name] is shots[index].light:
            continue
        other = estimate(_under(shots, index, candidates[name]), prior).responsivity
        off = (other * (posterior.responsivity.sum() / other.sum()) - posterior.responsivity).ravel()
        added += probability * np.outer(off, off)
    return replace(posterior, covariance=posterior.covariance + added)


def _likelihood(shots: Sequence[Shot], among: Sequence[Prior]) -> float:
    """Return the log of the patch values' probability, averaged over the priors, and divided by TEMPERING."""
    measured = any(prior.source == MEASURED for prior in among)
    return _log_mean([evidence(shots, prior) for prior in among]) / TEMPERING[measured]


def _under(shots: Sequence[Shot], index: int, light: Array) -> list[Shot]:
    """Return copies of the shots in which the shot `index` has the illuminant `light`."""
    return [replace(shot, light=light) if number == index else shot for number, shot in enumerate(shots)]


# ---------------------------------------------------------------------------------------------------- colour errors


def response_errors(responsivity: Array, covariance: Array, light: Array, surfaces: Array) -> Array:
    """Return each channel's relative error in predicting the signals of surfaces under an illuminant.

    The error is the RMS, over the surfaces, of the signals' standard deviations, relative to the largest signal. The
    surfaces' mean signal is assumed to be known, because exposure and white balance determine it.

    Parameters
    ----------
    responsivity : ndarray, (channel, wavelength)
        Estimated responsivities.
    covariance : ndarray, (channel · wavelength, channel · wavelength)
        Covariance of the responsivities.
    light : ndarray, (wavelength,)
        Photon radiance of the illuminant.
    surfaces : ndarray, (surface, wavelength)
        Reflectances.
    """
    count, size = responsivity.shape
    stimuli = surfaces * light
    errors = np.zeros(count)
    for channel in range(count):
        responses = stimuli @ responsivity[channel]
        centred = stimuli - np.outer(responses, stimuli.sum(axis=0)) / responses.sum()
        part = slice(channel * size, (channel + 1) * size)
        variance = np.einsum("sw,wv,sv->s", centred, covariance[part, part], centred)
        errors[channel] = np.sqrt(np.maximum(variance, 0.0).mean()) / responses.max()
    return errors


def next_light(
    shot: Shot, posterior: Posterior, candidates: Mapping[str, Array], judged_under: Sequence[Array], surfaces: Array
) -> tuple[str, float]:
    """Find the illuminant for an additional photo of the same chart that reduces the colour error most.

    Parameters
    ----------
    shot : Shot
        A photo of the chart. The additional photo is assumed to have the same noise and glare.
    posterior : Posterior
        Estimate from the existing photos.
    candidates : mapping of str to ndarray, (wavelength,)
        Possible illuminants of the additional photo.
    judged_under : sequence of ndarray, (wavelength,)
        Illuminants under which colour errors are computed.
    surfaces : ndarray, (surface, wavelength)
        Reflectances for which colour errors are computed.

    Returns
    -------
    light : str
        Name of the best illuminant in `candidates`.
    remaining : float
        Colour error after the additional photo, divided by the present colour error.
    """

    def error(covariance: Array) -> float:
        each = [response_errors(posterior.responsivity, covariance, light, surfaces) for light in judged_under]
        return float(np.sqrt(np.mean(np.square(each))))

    before = error(posterior.covariance)
    after = {name: error(_with(shot, posterior, light)) for name, light in candidates.items()}
    best = min(after, key=lambda name: after[name])
    return best, after[best] / before if before > 0 else 1.0


def _with(shot: Shot, posterior: Posterior, light: Array) -> Array:
    """Predict the responsivities' covariance after an additional shot under `light`.

    The exposure and the glare of the additional shot are unknown.
    """
    count = len(posterior.responsivity)
    stimuli = shot.reflectance * (light / light.mean() * shot.light.mean())
    predicted = (stimuli @ posterior.responsivity.T).T
    design = np.kron(np.eye(count), stimuli)
    error = np.maximum(shot.deviation.T / shot.values.max(axis=0)[:, None] * predicted.max(axis=1)[:, None], 1e-12)
    noise = np.diag((error**2 + (max(posterior.error, ERRORS[1]) * predicted) ** 2).ravel())
    noise += SHOT_SPREAD**2 * np.outer(predicted.ravel(), predicted.ravel())
    glare = shot.glare * predicted.max(axis=1)
    noise += np.kron(np.diag(glare**2), np.ones((len(stimuli),) * 2))
    crossed = posterior.covariance @ design.T
    remaining = posterior.covariance - crossed @ np.linalg.solve(design @ crossed + noise, crossed.T)
    return np.asarray(remaining, dtype=np.float64)
