"""Check captures against each other, to find wrong exposure times, units and illuminants.

The signal is proportional to exposure time × radiance. A mistyped exposure time, a wrong unit or swapped illuminants
therefore change the ratio between signal and expected signal by a large factor. The tolerances are much wider than the
variations of lamps, lenses and sensors.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from l3cli.calibration.responsivity import Sweep, light_centre
from l3cli.errors import InputFileError
from l3cli.frames.measurement import BandCapture, Capture, ChartCapture, MonoCapture

FACTOR = 1.5  # largest plausible ratio between signals per second under the same illuminant
# Largest plausible ratio between the responses to charts and to a monochromator. The limit is high, because a monochromator
# illuminates the frame differently.
SCALE = 3.0
STEP = 3.0  # a response that differs from both neighbouring responses by more than this factor is implausible
# Like STEP, but for the first and last captures. They are compared with the nearest capture, and with a value extrapolated
# from the two nearest captures.
END = 20.0
LEAST = 0.02  # differences below this fraction of the largest response or signal are ignored
NEAR_TOP = 0.85  # signals above this fraction of the largest signal may be saturated
LONGEST = 20.0  # a saturated capture is implausible if its expected signal exceeds the largest signal by this factor
DRIFT = 0.05  # DN; tolerated drift of the black level
Array = NDArray[np.float64]


def check_whites(captures: Sequence[Capture], lit: Array, signal: Array) -> None:
    """Raise InputFileError if the signal of a white capture is not roughly proportional to its exposure time.

    Parameters
    ----------
    captures : sequence of Capture
        White captures.
    lit : ndarray, (capture,)
        Exposure time in s, corrected for the brightness of the lamp.
    signal : ndarray, (capture, channel)
        Mean signal above black in DN.
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


def check_darks(captures: Sequence[Capture], signal: Array, deviation: float = 0.0) -> None:
    """Raise InputFileError if a dark capture's mean value is far from the line through the other dark captures.

    A capture is checked only if the other captures have at least three different exposure times.

    Parameters
    ----------
    captures : sequence of Capture
        Dark captures.
    signal : ndarray, (capture,)
        Mean raw value of each capture in DN.
    deviation : float
        Standard deviation of these means in DN, due to temporal row and column noise.
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
        if off > max(DRIFT, 10.0 * rest, 10.0 * deviation, 0.5 * grown, worst):
            worst, outlier = off, (capture, signal[index], predicted)
    if outlier is not None:
        capture, value, predicted = outlier
        raise InputFileError(
            f"the mean of {capture.name} after {capture.exposure:g} s in the dark is {value:.2f} DN, but the other dark "
            f"captures predict {predicted:.2f} DN; check its exposure time, and that no light reached the sensor"
        )


def check_series(captures: Sequence[BandCapture], light: NDArray[np.int64], values: Array, valid: NDArray[np.bool_]) -> None:
    """Raise InputFileError if a capture contradicts other captures with the same filter.

    Parameters
    ----------
    captures : sequence of BandCapture
        Captures of a chart through narrow-band filters.
    light : ndarray, (capture,)
        Index of the filter of each capture.
    values : ndarray, (capture, patch, channel)
        Mean signal above black of each patch in DN.
    valid : ndarray of bool, (capture, patch, channel)
        Whether the patch is unsaturated in the channel.
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
    """Raise InputFileError if a chart contradicts the other charts or the monochromatic captures.

    Parameters
    ----------
    captures : sequence of ChartCapture
        Captures of charts.
    measured : ndarray, (chart, channel)
        Measured signals.
    predicted : ndarray, (chart, channel)
        Signals predicted from the responsivities that were fitted to the monochromatic captures.
    absolute : bool
        Whether the monochromatic radiances are in absolute units. If they are relative, the charts are compared only with
        each other.
    """
    ratio = np.median(np.maximum(measured, 1e-9) / np.maximum(predicted, 1e-30), axis=1)
    # If there are only two charts, the monochromatic captures determine which one is wrong.
    votes = np.append(ratio, 1.0) if absolute and len(ratio) == 2 else ratio
    off = np.abs(np.log(ratio / np.median(votes)))
    if off.max() > np.log(FACTOR if votes.size > 2 else FACTOR**2):
        raise _odd(captures[int(off.argmax())], float(ratio[off.argmax()] / np.median(votes)), "chart")
    scale = float(np.median(ratio))
    if absolute and not 1 / SCALE < scale < SCALE:
        raise InputFileError(
            f"the [[chart]] captures are {_factor(scale)} than predicted from the [[mono]] captures; check the exposure "
            'times and radiances of both, or set unit = "relative photons" if the scale of the [[mono]] radiances is unknown'
        )


def odd_steps(captures: Sequence[MonoCapture], sweep: Sweep) -> tuple[str, ...]:
    """Find implausible monochromatic captures, and describe them.

    In every channel that is sensitive at its wavelength, the response of an implausible capture is far above, or far below,
    the responses at both neighbouring wavelengths. The search removes the worst capture and repeats until all remaining
    captures are plausible.

    Returns
    -------
    tuple of str
        One line per implausible capture, beginning with the worst.
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
    """Return the factor by which a monochromatic capture is too bright (> 1) or too dark (< 1) for its neighbours.

    If the capture is plausible in at least one channel, the factor is 1. Otherwise, it is the factor in the channel that
    deviates least. `order` contains capture indices sorted by wavelength. `place` is the capture's position in `order`.
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
            continue  # both the response and its prediction are negligible
        value = max(values[at], 1e-3 * floor)
        factors.append(value / high if value > max(high, floor) else value / low if value < low else 1.0)
    if not factors or min(factors) <= 1.0 <= max(factors):
        return 1.0
    return float(min(factors, key=lambda factor: abs(np.log(factor))))


def _check_alike(captures: Sequence[Capture], rates: Array, kind: str) -> None:
    """Raise InputFileError if the signals per second of captures under one illuminant differ by more than FACTOR.

    Three or more captures are compared with their median. Two captures are compared with each other.
    """
    if len(captures) < 2:
        return
    off = np.abs(np.log(rates / np.median(rates)))
    worst = int(off.argmax())
    if len(captures) == 2 and np.ptp(np.log(rates)) > np.log(FACTOR):
        raise InputFileError(
            f"the signals per second of {captures[0].name} and {captures[1].name} differ by a factor of "
            f"{np.exp(np.ptp(np.log(rates))):.3g}; check the exposure times of both captures"
        )
    if len(captures) > 2 and off[worst] > np.log(FACTOR):
        raise _odd(captures[worst], float(rates[worst] / np.median(rates)), kind)


def _odd(capture: Capture, factor: float, kind: str) -> InputFileError:
    return InputFileError(
        f"{capture.name} is {_factor(factor)} than the other {kind} captures predict for {capture.exposure:g} s; "
        "check its exposure time, monitor reading and illuminant"
    )


def _factor(factor: float) -> str:
    return f"{factor:.3g} times brighter" if factor > 1 else f"{1 / factor:.3g} times darker"
