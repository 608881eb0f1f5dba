"""Channels that are exposed or amplified apart: what measurements say of their settings (docs/method.md#exposures)."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import Readout
from l3cli.artifacts.fit import NoiseFit
from l3cli.errors import InputFileError
from l3cli.frames.measurement import Body

TOLERANCE = 0.1  # relative, by which a setting may differ from what frames say of it
CERTAIN = 4.0  # standard deviations of a gain that do
Array = NDArray[np.float64]


def check_gains(measured: Array, error: Array, body: Body) -> None:
    """Raise InputFileError if conversion gains (channel), known to `error`, contradict the gains of the measurement file."""
    if body.readout is None:
        return
    relative = measured / body.channel_gains
    lowest = body.channel_gains == body.channel_gains.min()
    usual = float(np.average(relative[lowest], weights=1.0 / error[lowest] ** 2))
    certain = np.abs(relative - usual) > CERTAIN * error / body.channel_gains
    for channel in np.flatnonzero(certain & (np.abs(relative / usual - 1.0) > TOLERANCE)).tolist():
        name, seen = body.channels[channel], measured[channel] / usual
        raise InputFileError(
            f"channel {name}: white frames say a gain of {seen:.3g} times that of the others, the measurement file "
            f"{body.channel_gains[channel]:.3g}; correct channel.{name}.gain"
        )


def check_exposures(responsivity: Array, body: Body) -> None:
    """Raise InputFileError if efficiencies (channel, wavelength) of channels with one filter differ, as they do if an
    exposure is not that of the measurement file."""
    if body.readout is None:
        return
    whole = responsivity.sum(axis=1)
    for channel, first in enumerate(body.readout.same_filter.tolist()):
        ratio = float(whole[channel] / whole[first])
        if abs(ratio - 1.0) > TOLERANCE:
            name, seen = body.channels[channel], body.channel_exposures[channel] * ratio
            raise InputFileError(
                f"channel {name} responds as if exposed for {seen:.3g} of the frame's time beside {body.channels[first]}, "
                f"the measurement file says {body.channel_exposures[channel]:.3g}; correct channel.{name}.exposure"
            )


def filter_curves(curves: Array, band: Array, body: Body) -> tuple[Array, Array]:
    """Return the relative curves and bands (channel, wavelength) of what channels give, as those of their filters, peak
    1."""
    setting = (body.channel_gains * body.channel_exposures)[:, None]
    peak = float((curves / setting).max())
    return curves / setting / peak, band / setting / peak


def measured_readout(body: Body, noise: NoiseFit | None, read_noise: float) -> Readout | None:
    """Return the settings with the read noise that was measured, `read_noise` (e-) where none was; None: all channels
    alike."""
    if body.readout is None:
        return None
    each = np.full(len(body.channels), read_noise) if noise is None else noise.read_noise
    return replace(body.readout, channel_read_noise=np.asarray(each, np.float64))
