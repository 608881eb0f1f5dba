"""Measure the channels' polarisers with a rotating linear polariser (docs/method.md#rotating-polariser).

If a channel's polariser has the angle θ and the leakage k (the inverse of the extinction ratio), its response to light
polarised at the angle φ follows Malus's law:

    signal = brightness · gain / 2 · [(1 + k) + p (1 − k) cos 2(θ − φ)]

The light's degree of polarisation p follows from the extinction ratio of the rotating polariser. The brightness may change
between captures, because lamps drift and their light can itself be polarised. It is therefore estimated for each capture.
This is possible because the channels have different angles.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import QUANTISATION, CameraModel, Polarisers
from l3cli.artifacts.fit import PolariserFit
from l3cli.calibration import statistics
from l3cli.calibration.noise import TOLERATED
from l3cli.errors import InputFileError, listed
from l3cli.frames.measurement import LEAKAGE_NM, Body, Capture, PolariserCapture, Rotator
from l3cli.physics.stokes import angle_difference, malus

BRIGHTNESS = 0.05  # relative standard deviation of a capture's brightness (prior)
BLACK_ERROR = 0.05  # DN; standard deviation of the black level, which may drift after the dark frames
LARGEST_CONDITION = 20.0  # largest condition number of the fit of Malus's law; with angles of 0°, 10° and 20°, it is 64
LEAST_MODULATION = 0.2  # a smaller modulation means that the light is unpolarised, or that the channel has no polariser
WRONG_ANGLE = 3.0  # degrees; larger errors of a capture's stated angle are reported
OTHER_ANGLE = 10.0  # degrees; larger errors of a channel's stated angle are reported
Array = NDArray[np.float64]


def harmonics(degrees: Array) -> Array:
    """Return 1, cos 2φ and sin 2φ for each angle φ in degrees: (angle, 3)."""
    twice = 2.0 * np.radians(degrees)
    return np.stack([np.ones_like(twice), np.cos(twice), np.sin(twice)], axis=-1)


@dataclass(frozen=True)
class Guess:
    """First estimate of the parameters of Malus's law, from separate fits of the channels."""

    gain: Array  # (channel,): DN/s
    angle: Array  # (channel,): degrees
    leakage: Array  # (channel,): inverse of the extinction ratio
    modulation: Array  # (channel,): amplitude of the signal relative to its mean


# ---------------------------------------------------------------------------------------------------------- the fit


def fit_polarisers(
    light_angle: Array,
    rate: Array,
    deviation: Array,
    polarised: NDArray[np.bool_],
    light_polarisation: float = 1.0,
    light_angle_error: float = 0.0,
    black_error: Array | float = 0.0,
) -> PolariserFit:
    """Fit Malus's law to the signals of the channels behind a rotating polariser.

    Parameters
    ----------
    light_angle : ndarray, (capture,)
        Angle of the transmission axis of the rotating polariser in degrees, counter-clockwise in the picture.
    rate : ndarray, (capture, channel)
        Signal per second of exposure in DN/s, without dark signal.
    deviation : ndarray, (capture, channel)
        Standard deviation of each rate in DN/s. Rates with an infinite standard deviation are ignored.
    polarised : ndarray of bool, (channel,)
        Whether each channel has a polariser. At least one channel must have one.
    light_polarisation : float
        Degree of linear polarisation of the light.
    light_angle_error : float
        Standard deviation of each `light_angle` in degrees. The errors of the captures are independent.
    black_error : ndarray, (capture,), or float
        Standard deviation of the subtracted dark signal in DN/s. A channel's error in DN is the same in all captures.

    Returns
    -------
    PolariserFit
        Angle, leakage and relative gain of each channel. If the rates scatter more than `deviation` explains, the standard
        deviations of the results are increased accordingly.
    """
    from scipy.optimize import least_squares

    (captures, channels), used = rate.shape, np.isfinite(deviation)
    first = first_guess(light_angle, rate, used, polarised, light_polarisation)
    count = int(polarised.sum())
    black = np.broadcast_to(black_error, captures)[:, None]
    # The parameters of a channel are ln gain and angle, both relative to the first estimate, and the leakage. The other
    # parameters are black level errors, ln brightnesses and light angle errors, in units of their prior standard deviations.
    parts = np.cumsum([channels, count, count, channels, captures])

    def unpacked(values: Array) -> tuple[Array, ...]:
        gain, turn, leak, offset, brightness, light_turn = np.split(values, parts)
        leakage, angle = np.ones(channels), np.zeros(channels)
        leakage[polarised], angle[polarised] = leak, turn
        angle, turned = first.angle + np.degrees(angle), light_angle + light_angle_error * light_turn
        return first.gain * np.exp(gain), angle, leakage, offset * black, np.exp(BRIGHTNESS * brightness), turned

    def predict(values: Array) -> Array:
        gain, angle, leakage, offset, brightness, turned = unpacked(values)
        return brightness[:, None] * malus(turned, gain, angle, leakage, light_polarisation) + offset

    def residuals(values: Array) -> Array:
        return np.concatenate([((rate - predict(values)) / deviation)[used], values[parts[2] :]])

    start = np.concatenate([np.zeros(channels + count), first.leakage[polarised], np.zeros(channels + 2 * captures)])
    solved = least_squares(residuals, start, method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    # Degrees of freedom: number of rates minus number of parameters. Light angle errors and black level errors are not
    # counted, because their priors are narrow. One brightness is not counted, because the gains include the mean brightness.
    spare = int(used.sum()) - parts[2] - (len(rate) - 1)
    scatter = 2.0 * solved.cost / spare if spare > 0 else 1.0
    covariance = np.linalg.inv(solved.jac.T @ solved.jac) * max(1.0, scatter)
    gain, angle, leakage, _, brightness, _ = unpacked(solved.x)
    error = np.sqrt(np.diag(covariance))
    angle_error, leakage_error = np.zeros(channels), np.zeros(channels)
    angle_error[polarised] = np.degrees(error[parts[0] : parts[1]])
    leakage_error[polarised] = error[parts[1] : parts[2]]
    relative = np.eye(channels) - gain / gain.sum()  # derivative of ln(gain / mean gain) with respect to ln gain
    gain_variance = np.diag(relative @ covariance[:channels, :channels] @ relative.T)
    return PolariserFit(
        light_angle=light_angle,
        light_polarisation=light_polarisation,
        polarised=polarised,
        angle=np.where(polarised, angle % 180.0, 0.0),
        angle_error=angle_error,
        leakage=leakage,
        leakage_error=leakage_error,
        gain=gain / gain.mean(),
        gain_error=gain / gain.mean() * np.sqrt(gain_variance),
        brightness=brightness,
        used=used,
        measured=rate,
        predicted=predict(solved.x),
    )


def first_guess(
    light_angle: Array, rate: Array, used: NDArray[np.bool_], polarised: NDArray[np.bool_], light_polarisation: float
) -> Guess:
    """Estimate each channel's gain, angle and leakage with a linear fit, assuming that the light is constant."""
    terms = harmonics(light_angle)
    law = np.array([np.linalg.lstsq(terms[use], of[use], rcond=None)[0] for use, of in zip(used.T, rate.T, strict=True)])
    mean, amplitude = law[:, 0], np.hypot(law[:, 1], law[:, 2])
    full = amplitude / light_polarisation
    return Guess(
        gain=np.where(polarised, mean + full, mean),
        angle=np.where(polarised, np.degrees(np.arctan2(law[:, 2], law[:, 1])) / 2.0, 0.0),
        leakage=np.where(polarised, (mean - full) / (mean + full), 1.0),
        modulation=amplitude / mean,
    )


# ------------------------------------------------------------------------------------------------------ the captures


@dataclass(frozen=True)
class Electronics:
    """Sensor properties for converting raw values to rates with uncertainties."""

    dark: Array  # (capture, channel): mean value in the dark in DN, including the black level
    saturation: float  # DN; pixels at or above this value are saturated
    gain: Array  # (channel,): conversion gain in DN/e-
    dark_variance: Array  # (channel,): temporal variance in the dark in DN²
    defects: statistics.Defects  # defective pixels, which are ignored


def measure_polarisers(
    captures: Sequence[PolariserCapture],
    rotator: Rotator,
    body: Body,
    electronics: Electronics,
    each: statistics.Each = map,
) -> PolariserFit:
    """Measure the polarisers of all channels in frames taken through a rotating polariser.

    Each channel ignores captures in which it is saturated. If the measurement file does not specify polarisers, a channel
    counts as polarised if its signal depends on the angle of the rotating polariser.

    Raises
    ------
    InputFileError
        If the usable captures have too few different angles, if the light is not polarised, if captures contradict each
        other, or if the measured angles contradict the measurement file.
    """
    read = functools.partial(_means, body=body, saturation=electronics.saturation, defects=electronics.defects)
    mean, pixels, saturated = (np.array(values) for values in zip(*each(read, captures), strict=True))
    lit = np.array([capture.lit for capture in captures])[:, None]
    signal, used = mean - electronics.dark, saturated <= TOLERATED
    variance = noise_variance(signal, electronics)
    angle = np.array([capture.angle for capture in captures])
    _check_angles(angle, used, body)
    guess = first_guess(angle, signal / lit, used, np.ones(len(body.channels), bool), rotator.polarisation)
    polarised = guess.modulation > LEAST_MODULATION if body.polarisers is None else body.polarisers.present
    weak = polarised & (guess.modulation < LEAST_MODULATION) if polarised.any() else ~polarised
    if weak.any():
        name, modulation = body.channels[int(weak.argmax())], guess.modulation[weak.argmax()]
        raise InputFileError(
            f"the signal of channel {name} changes by only {modulation:.1%} when the polariser in front of the light "
            'rotates; check this polariser and "polariser_deg"'
        )
    deviation = np.where(used, np.sqrt(variance / pixels) / lit, np.inf)
    fit = fit_polarisers(
        angle, signal / lit, deviation, polarised, rotator.polarisation, rotator.angle_error, BLACK_ERROR / lit[:, 0]
    )
    _check_captures(captures, fit)
    if rotator.reference is not None:
        fit = _with_reference(fit, rotator.reference, body)
    if body.polarisers is not None and (wrong := contradiction(body, fit.angle)):
        raise InputFileError(wrong)
    return fit


def noise_variance(signal: Array, electronics: Electronics) -> Array:
    """Return the temporal variance of a pixel in DN², for signals (…, channel) in DN."""
    return electronics.gain * np.maximum(signal, 0.0) + electronics.dark_variance + QUANTISATION


def _means(capture: Capture, body: Body, saturation: float, defects: statistics.Defects) -> tuple[Array, Array, Array]:
    """Return each channel's mean value in DN, number of pixels in all frames, and saturated fraction."""
    counts = statistics.count_values(capture, body, defects)
    return statistics.mean_value(counts), counts.sum(axis=1), statistics.share_from(counts, saturation)


def _check_angles(angle: Array, used: NDArray[np.bool_], body: Body) -> None:
    """Raise InputFileError if the usable captures have too few different angles to fit Malus's law."""
    for name, chosen in zip(body.channels, used.T, strict=True):
        count = np.unique(angle[chosen] % 180.0).size
        if count < 3 or np.linalg.cond(harmonics(angle[chosen])) > LARGEST_CONDITION:
            raise InputFileError(
                f"l3 cannot determine the angle of channel {name} from captures with {count} usable angles of the rotating "
                "polariser; use at least 3 angles, spread over 180°, and avoid saturation"
            )


def _check_captures(captures: Sequence[PolariserCapture], fit: PolariserFit) -> None:
    """Raise InputFileError if a capture's frames contradict its stated polariser angle.

    The true angle is computed from the ratios between the channels. Captures with fewer than three usable channels with
    different angles are not checked.
    """
    response = fit.gain[:, None] * np.stack([1.0 + fit.leakage, *(1.0 - fit.leakage) * harmonics(fit.angle).T[1:]], axis=1)
    seen = []
    for rate, chosen, stated in zip(fit.measured, fit.used, fit.light_angle, strict=True):
        if chosen.sum() < 3 or np.linalg.cond(response[chosen]) > LARGEST_CONDITION:
            seen.append(stated)
            continue
        _, cosine, sine = np.linalg.lstsq(response[chosen], rate[chosen], rcond=None)[0]
        seen.append(np.degrees(np.arctan2(sine, cosine)) / 2.0 % 180.0)
    wrong = angle_difference(np.array(seen), fit.light_angle)
    worst = int(np.abs(wrong - np.median(wrong)).argmax())
    if abs(wrong[worst] - np.median(wrong)) > WRONG_ANGLE:
        raise InputFileError(
            f"{captures[worst].name}: the frames imply that the rotating polariser was at {seen[worst]:.1f}°, but "
            f'"angle_deg" is {captures[worst].angle:g}; correct "angle_deg"'
        )


def _with_reference(fit: PolariserFit, reference: str, body: Body) -> PolariserFit:
    """Shift all angles so that the channel `reference` has its stated angle.

    The measurement error of the reference channel is added to the errors of the other angles in quadrature. The reference
    channel's own error becomes 0.
    """
    if body.polarisers is None or reference not in body.channels:
        raise InputFileError(
            f'"rotator.reference" is "{reference}", which is not a channel with a stated polariser angle; write the name of '
            "a channel with polariser_deg"
        )
    channel = body.channels.index(reference)
    shift = angle_difference(body.polarisers.polariser_deg[channel], fit.angle[channel])
    error = np.where(fit.polarised, np.hypot(fit.angle_error, fit.angle_error[channel]), 0.0)
    error[channel] = 0.0
    return replace(
        fit,
        light_angle=fit.light_angle + shift,
        angle=np.where(fit.polarised, (fit.angle + shift) % 180.0, 0.0),
        angle_error=error,
    )


def contradiction(body: Body, measured: Array) -> str:
    """Return an error message if the measured angles contradict the channels' stated angles, otherwise "".

    Parameters
    ----------
    body : Body
        The camera, with its stated angles.
    measured : ndarray, (channel,)
        Measured angle of each channel in degrees.
    """
    assert body.polarisers is not None
    stated, present = body.polarisers.polariser_deg, body.polarisers.present
    wrong = np.flatnonzero(present & (np.abs(angle_difference(measured, stated)) > OTHER_ANGLE))
    if not wrong.size:
        return ""
    found = listed(f"{body.channels[each]} has {measured[each]:.1f}° instead of {stated[each]:g}°" for each in wrong)
    # For each measured angle, find the nearest stated angle of any channel.
    known = np.unique(stated[present])
    nearest = known[np.abs(angle_difference(measured[present][:, None], known)).argmin(axis=1)]
    close = (np.abs(angle_difference(measured[present], nearest)) <= OTHER_ANGLE).all()
    swapped = close and np.array_equal(np.sort(nearest), np.sort(stated[present]))
    cure = 'correct "polariser_deg" or "cfa.pattern"'
    shift = angle_difference(measured, stated)[present]
    if (np.abs(angle_difference(measured, -stated))[present] < OTHER_ANGLE).all():
        cure += ', or count "angle_deg" counter-clockwise'
    elif (np.abs(turned := angle_difference(shift, shift[0])) < OTHER_ANGLE).all():
        cure += f', or subtract {(shift[0] + turned.mean()) % 180.0:.0f}° from "angle_deg"'
    if swapped:
        return f"the measured angles imply that polarisers are swapped: {found}; {cure}"
    return f"the measured angles of polarisers differ from the stated angles: {found}; {cure}"


# -------------------------------------------------------------------------------------------------------- the camera


def polarisers_of(fit: PolariserFit | None, body: Body, wavelength: Array) -> Polarisers | None:
    """Return a camera's measured polarisers or, if they were not measured, its stated polarisers.

    Parameters
    ----------
    fit : PolariserFit or None
        The measured polarisers, or None if they were not measured. The leakage is the same at all wavelengths.
    body : Body
        The camera with the stated polarisers, if any.
    wavelength : ndarray, (wavelength,)
        Wavelengths of the camera in nm.

    Returns
    -------
    Polarisers or None
        None if no channel has a polariser.
    """
    if fit is not None:
        leakage = np.clip(fit.leakage, 0.0, 1.0)[:, None]
        return Polarisers(fit.angle, np.repeat(leakage, wavelength.size, axis=1)) if fit.polarised.any() else None
    if body.polarisers is None:
        return None
    leakage = np.array([np.interp(wavelength, LEAKAGE_NM, of) for of in body.polarisers.leakage])
    return Polarisers(body.polarisers.polariser_deg, leakage)


def with_polarisers(camera: CameraModel, fit: PolariserFit | None, body: Body) -> CameraModel:
    """Add polarisers to a camera model with responsivities that were measured in unpolarised light.

    In channels with a polariser, the responsivity is multiplied by 2 / (1 + k), where k is the leakage. It then applies to
    light polarised along the transmission axis. Relative responsivities are rescaled to a highest peak of 1. If no channel
    has a polariser, the camera model is returned unchanged.
    """
    polarisers = polarisers_of(fit, body, camera.wavelength)
    if polarisers is None:
        return camera
    passed = polarisers.stokes_response[:, 0]
    curve, band = camera.responsivity / passed, camera.responsivity_band / passed
    peak = 1.0 if camera.absolute else float(curve.max())
    return replace(camera, responsivity=curve / peak, responsivity_band=band / peak, polarisers=polarisers)
