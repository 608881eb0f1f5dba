"""Which light a chart was photographed under, and which other one would say most (docs/method.md#charts-in-photographs)."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from l3cli.calibration.photo.estimate import ERRORS, SHOT_SPREAD, Posterior, Prior, Shot, estimate, evidence

IMPROBABLE = 0.02  # of a light: below it adds nothing to a band
NOTICED = 3.0  # natural logarithm: a light that is e³ times less probable than another is questioned
Array = NDArray[np.floating]


def compare(shots: Sequence[Shot], index: int, prior: Prior, candidates: Mapping[str, Array]) -> tuple[str, float]:
    """Return the most probable of `candidates`, name → (wavelength) relative photon radiance, as light of shot `index`, and
    the natural logarithm of how much less probable the shot's own light is, at least 0."""
    others = _evidences(shots, index, prior, candidates)
    nearest = max(others, key=lambda name: others[name])
    return nearest, max(others[nearest] - evidence(shots, prior), 0.0)


def probabilities(shots: Sequence[Shot], index: int, prior: Prior, candidates: Mapping[str, Array]) -> dict[str, float]:
    """Return the probability of each candidate that it is the light of shot `index`, if it is one of them."""
    logarithms = _evidences(shots, index, prior, candidates)
    top = max(logarithms.values())
    weights = {name: float(np.exp(each - top)) for name, each in logarithms.items()}
    return {name: weight / sum(weights.values()) for name, weight in weights.items()}


def unsure_of_light(
    posterior: Posterior, shots: Sequence[Shot], index: int, prior: Prior, candidates: Mapping[str, Array]
) -> Posterior:
    """Return the posterior with what its covariance lacks if the light of shot `index` is only guessed: the scatter of the
    curves under all candidates that it may be, by their probabilities, each set at the posterior's overall scale."""
    added = np.zeros_like(posterior.covariance)
    for name, probability in probabilities(shots, index, prior, candidates).items():
        if probability < IMPROBABLE or candidates[name] is shots[index].light:
            continue
        other = estimate(_under(shots, index, candidates[name]), prior).responsivity
        off = (other * (posterior.responsivity.sum() / other.sum()) - posterior.responsivity).ravel()
        added += probability * np.outer(off, off)
    return replace(posterior, covariance=posterior.covariance + added)


def _evidences(shots: Sequence[Shot], index: int, prior: Prior, candidates: Mapping[str, Array]) -> dict[str, float]:
    return {name: evidence(_under(shots, index, light), prior) for name, light in candidates.items()}


def _under(shots: Sequence[Shot], index: int, light: Array) -> list[Shot]:
    """Return the shots, one of them under another light."""
    return [replace(shot, light=light) if number == index else shot for number, shot in enumerate(shots)]


# ------------------------------------------------------------------------------------------------- what is known of colours


def response_errors(responsivity: Array, covariance: Array, light: Array, surfaces: Array) -> Array:
    """Return the standard deviation (channel) of the responses to surfaces (surface, wavelength) under a light, RMS over
    them, over the largest; their mean, which exposure and white balance set, is taken as known."""
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
    """Return the candidate under which a second shot of the same chart would help most, and the share of the error of
    responses to `surfaces` under the lights `judged_under` that would remain."""

    def error(covariance: Array) -> float:
        each = [response_errors(posterior.responsivity, covariance, light, surfaces) for light in judged_under]
        return float(np.sqrt(np.mean(np.square(each))))

    before = error(posterior.covariance)
    after = {name: error(_with(shot, posterior, light)) for name, light in candidates.items()}
    best = min(after, key=lambda name: after[name])
    return best, after[best] / before if before > 0 else 1.0


def _with(shot: Shot, posterior: Posterior, light: Array) -> Array:
    """Return the covariance of the responsivities after one more shot, of unknown exposure and glare, under a light."""
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
