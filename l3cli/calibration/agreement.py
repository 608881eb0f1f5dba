"""Check captures against each other, to find wrong exposure times and lights.

Signals are proportional to exposure time times radiance. A mistyped exposure, a wrong unit or two swapped lights therefore
stand out by a large factor, long before a fit looks wrong. The tolerances are far wider than the variations of lamps,
lenses and sensors.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from l3cli.calibration.responsivity import Sweep, light_centre
from l3cli.errors import InputFileError
from l3cli.frames.measurement import BandCapture, Capture, ChartCapture, MonoCapture

FACTOR = 1.5  # largest ratio between signals per second under one light
SCALE = 3.0  # largest ratio between the scales from charts and from monochromators, which fill different parts of frames
STEP, END = 3.0, 20.0  # largest ratio of a monochromator step to both neighbours; of the first or last step to the next two
LEAST = 0.02  # fraction of the largest response or signal below which differences are ignored
NEAR_TOP = 0.85  # fraction of the largest signal above which a signal may be saturated
LONGEST = 20.0  # exposures that exceed saturation by more than this factor are mistakes
DRIFT = 0.05  # DN by which the black level may drift
Array = NDArray[np.float64]


def check_whites(captures: Sequence[Capture], lit: Array, signal: Array) -> None:
    """Raise InputFileError if the signal of a white capture is not proportional to the exposure time.

    `lit` (capture) is the time under light in seconds. `signal` (capture, channel) is the mean DN above black.
    """
    top = signal.max(axis=0)
    total = np.maximum(signal.sum(axis=1), 1e-9)
    below = (signal < NEAR_TOP * top).all(axis=1) & (total > LEAST * total.max())
    rates = total / lit
    _check_alike([captures[int(index)] for index in np.flatnonzero(below)], rates[below], "white")
    if not below.any():
        return
    expected = lit * np.median(rates[below])
    for capture, value, linear, saturates in zip(captures, total, expected, ~below, strict=True):
        if saturates and (value > FACTOR * linear or linear > LONGEST * total.max()):
            raise _odd(capture, value / linear, "white")


def check_darks(captures: Sequence[Capture], signal: Array) -> None:
    """Raise InputFileError if the mean signal of a dark capture is far from the line through all other dark captures.

    `signal` (capture) is in DN. A capture is checked only if the others have at least three exposure times.
    """
    exposure = np.array([capture.exposure for capture in captures])
    worst, outlier = 0.0, None
    for index, capture in enumerate(captures):
        others = np.arange(len(captures)) != index
        if np.unique(exposure[others]).size < 3:
            continue
        line = np.polyfit(exposure[others], signal[others], 1)
        rest = float(np.abs(signal[others] - np.polyval(line, exposure[others])).max())
        predicted = float(np.polyval(line, exposure[index]))
        off = abs(signal[index] - predicted)
        grown = max(abs(predicted - line[1]), abs(signal[index] - line[1]))
        if off > max(DRIFT, 10.0 * rest, 0.5 * grown, worst):
            worst, outlier = off, (capture, signal[index], predicted)
    if outlier is not None:
        capture, value, predicted = outlier
        raise InputFileError(
            f"{capture.name}: {value:.2f} DN after {capture.exposure:g} s in the dark, but the other dark captures predict "
            f"{predicted:.2f} DN; check its exposure"
        )


def check_series(captures: Sequence[BandCapture], light: NDArray[np.int64], values: Array, valid: NDArray[np.bool_]) -> None:
    """Raise InputFileError if the patch values of a capture contradict the other captures of the same band.

    `light` (capture) is the index of the band. `values`, in DN, and `valid` are (capture, patch, channel).
    """
    lit = np.array([capture.lit for capture in captures])[:, None, None]
    for band in np.unique(light):
        chosen = np.flatnonzero(light == band)
        seen = np.where(valid[chosen], values[chosen] / lit[chosen], np.nan)
        known = ~np.isnan(seen).all(axis=0)
        usual = np.zeros(known.shape)
        usual[known] = np.nanmedian(seen[:, known], axis=0)
        used = valid[chosen] & known
        sums = np.where(used, values[chosen], 0.0).sum(axis=(1, 2))
        expected = (np.where(used, usual, 0.0) * lit[chosen]).sum(axis=(1, 2))
        count = used.sum(axis=(1, 2))
        plain = (count > 0) & (np.maximum(sums, expected) > LEAST * values.max() * count) & (expected > 0)
        rates = np.maximum(sums[plain], 1e-9) / expected[plain]
        _check_alike([captures[index] for index in chosen[plain]], rates, "band")


def check_charts(captures: Sequence[ChartCapture], measured: Array, predicted: Array, absolute: bool) -> None:
    """Raise InputFileError if one chart contradicts the other charts, or if all charts contradict the monochromator.

    `measured` and `predicted` are (chart, channel). The predictions come from the curves that the monochromator gave. If
    both kinds of capture have radiances in absolute units (`absolute`), their scales are compared, too.
    """
    ratio = np.median(np.maximum(measured, 1e-9) / np.maximum(predicted, 1e-30), axis=1)
    votes = np.append(ratio, 1.0) if absolute and len(ratio) == 2 else ratio  # the monochromator decides between two charts
    off = np.abs(np.log(ratio / np.median(votes)))
    if off.max() > np.log(FACTOR if votes.size > 2 else FACTOR**2):
        raise _odd(captures[int(off.argmax())], float(ratio[off.argmax()] / np.median(votes)), "chart")
    scale = float(np.median(ratio))
    if absolute and not 1 / SCALE < scale < SCALE:
        raise InputFileError(
            f"the [[chart]] captures are {_factor(scale)} than the [[mono]] captures predict; check exposures and radiances "
            'of both (unit = "relative photons" for a monochromator whose scale is not known)'
        )


def odd_steps(captures: Sequence[MonoCapture], sweep: Sweep) -> tuple[str, ...]:
    """Describe the monochromatic captures whose response is far above or below both neighbours in wavelength.

    A capture is listed only if it is implausible in every channel that sees it. The worst capture comes first. It is left
    out before the next capture is searched for.
    """
    centre = np.array([light_centre(capture.wavelength, capture.radiance) for capture in captures])
    left = list(np.argsort(centre, kind="stable"))
    steps = []
    while len(left) > 3:
        factors = [_step_factor(sweep, left, place) for place in range(len(left))]
        worst = int(np.argmax(np.abs(np.log(factors))))
        if factors[worst] == 1.0:
            break
        steps.append(f"{captures[left[worst]].name}: {_factor(factors[worst])} than its neighbours")
        del left[worst]
    return tuple(steps)


def _step_factor(sweep: Sweep, order: Sequence[int], place: int) -> float:
    """Return the factor by which a step is brighter (> 1) or darker (< 1) than its neighbours allow.

    The channel with the smallest deviation decides. The factor is 1 if the step is plausible in any channel. `place` is the
    position of the step in `order`.
    """
    factors = []
    for channel in range(sweep.values.shape[1]):
        if not sweep.valid[order[place], channel]:
            continue
        seen = [index for index in order if sweep.valid[index, channel]]
        values = np.maximum(sweep.values[seen, channel], 0.0)
        floor = LEAST * values.max()
        at = seen.index(order[place])
        if at == 0 or at == len(seen) - 1:
            next_one, next_but_one = (values[1], values[2]) if at == 0 else (values[-2], values[-3])
            beyond = next_one * next_one / max(next_but_one, floor)
            low, high = min(next_one, beyond) / END, max(next_one, beyond) * END
        else:
            low, high = min(values[at - 1], values[at + 1]) / STEP, max(values[at - 1], values[at + 1]) * STEP
        if max(values[at], low) < floor:
            continue  # the channel hardly sees this step, as its neighbours predict
        value = max(values[at], 1e-3 * floor)
        factors.append(value / high if value > max(high, floor) else value / low if value < low else 1.0)
    if not factors or min(factors) <= 1.0 <= max(factors):
        return 1.0
    return float(min(factors, key=lambda factor: abs(np.log(factor))))


def _check_alike(captures: Sequence[Capture], rates: Array, kind: str) -> None:
    """Raise InputFileError if the signal per second (capture) of one capture differs too much from the others."""
    if len(captures) < 2:
        return
    off = np.abs(np.log(rates / np.median(rates)))
    worst = int(off.argmax())
    if len(captures) == 2 and np.ptp(np.log(rates)) > np.log(FACTOR):
        raise InputFileError(
            f"{captures[0].name} and {captures[1].name}: their signals per second of light differ by a factor of "
            f"{np.exp(np.ptp(np.log(rates))):.3g}; check the exposures of both"
        )
    if len(captures) > 2 and off[worst] > np.log(FACTOR):
        raise _odd(captures[worst], float(rates[worst] / np.median(rates)), kind)


def _odd(capture: Capture, factor: float, kind: str) -> InputFileError:
    return InputFileError(
        f"{capture.name}: {_factor(factor)} than the other {kind} captures predict for {capture.exposure:g} s; "
        "check its exposure, monitor and light"
    )


def _factor(factor: float) -> str:
    return f"{factor:.3g} times brighter" if factor > 1 else f"{1 / factor:.3g} times darker"
