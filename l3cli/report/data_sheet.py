"""An EMVA 1288 data sheet of a calibrated camera on one page: operation point, figures, the plots of release 4.0
(docs/measurement.md#data-sheet)."""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import QUANTISATION, CameraModel, sensitivity_threshold
from l3cli.artifacts.fit import NoiseFit
from l3cli.report import colours
from l3cli.report.camera import responsivity_figures, transfer_figure
from l3cli.report.drawing import Plot, spanning
from l3cli.report.parts import Figure, Figures, Section, Subsection, Table, Text
from l3cli.system.text import tidy

Array = NDArray[np.floating]
LINEAR = (0.05, 0.95)  # share of saturation over which linearity is judged
SHOT_MOST = 1e-3  # of saturation, from which the curve of signal over noise is drawn


def data_sheet(camera: CameraModel) -> Section:
    """Return the data sheet of a camera whose noise was measured."""
    assert camera.fit is not None
    noise = camera.fit.noise
    assert noise is not None
    plots = [transfer_figure(camera, noise), linearity_figure(camera, noise), deviation_figure(camera, noise)]
    parts = (
        Subsection("Operation point", (operation_point(camera, noise),)),
        Subsection("Figures", (figures_table(camera, noise), Text(MEANINGS))),
        Subsection("Plots", (Figures((*plots, snr_figure(camera, noise), *responsivity_figures(camera))),)),
    )
    return Section("EMVA 1288 data sheet", f"{camera.name}: as measured, channel by channel.", parts)


MEANINGS = (
    "η: quantum efficiency with lens and filters, at the channel's peak. SNR max: root of the saturation capacity. "
    "Threshold: signal whose signal-to-noise ratio is 1; DR: saturation capacity over it. DSNU and PRNU: standard "
    "deviations over pixels. LE: mean deviation from a line over 5–95 % of saturation, relative. Photons are those of the "
    "peak wavelength before the lens, per pixel and exposure; curves that are relative state none."
)


def operation_point(camera: CameraModel, noise: NoiseFit) -> Table:
    """Return what was measured, and how."""
    first, last = float(noise.exposure.min()), float(noise.exposure.max())
    array = " / ".join(" ".join(camera.channels[channel] for channel in row) for row in camera.cfa)
    rows = (
        ("Camera", camera.name),
        ("Pixels", f"{camera.cols} × {camera.rows}, {tidy(1e6 * camera.pixel_pitch)} µm"),
        ("Colour filter array", array),
        ("Resolution of values", f"{camera.bits} bits"),
        ("Black and white level", f"{tidy(camera.black_level, 5)} and {tidy(camera.white_level, 5)} DN"),
        ("Exposures of white frames", f"{noise.exposure.size}, {tidy(1e3 * first)} to {tidy(1e3 * last)} ms"),
        ("Saturation", "reached" if noise.white_level_reached else "not reached: the converter's last value"),
        ("Lens", f"{tidy(1e3 * camera.optics.focal_length)} mm, f/{camera.optics.f_number:g}"),
    )
    return Table("Operation point", ("quantity", "value"), rows)


def figures_table(camera: CameraModel, noise: NoiseFit) -> Table:
    """Return the figures of each channel, as lines of the standard's table."""
    gain, capacity = noise.conversion_gain, noise.saturation_capacity
    least = sensitivity_threshold(noise.read_noise, gain)
    peak = camera.responsivity.argmax(axis=1)
    efficiency = camera.responsivity.max(axis=1)
    lines: list[tuple[str, Array]] = [("peak wavelength (nm)", camera.wavelength[peak])]
    if camera.absolute:
        lines += [("quantum efficiency η (%)", 100 * efficiency)]
    lines += [
        ("overall system gain K (DN/e⁻)", gain),
        ("± of K (DN/e⁻)", noise.conversion_gain_error),
        ("inverse gain 1/K (e⁻/DN)", 1 / gain),
        ("temporal dark noise (e⁻)", noise.read_noise),
        ("temporal dark noise (DN)", np.hypot(gain * noise.read_noise, np.sqrt(QUANTISATION))),
        ("SNR max (dB)", 10 * np.log10(capacity)),
        ("SNR max (bit)", np.log2(capacity) / 2),
        ("threshold (e⁻)", least),
        ("saturation capacity (e⁻)", capacity),
    ]
    if camera.absolute:
        lines += [("threshold (photons)", least / efficiency), ("saturation capacity (photons)", capacity / efficiency)]
    lines += [
        ("dynamic range DR (dB)", 20 * np.log10(capacity / least)),
        ("dynamic range DR (bit)", np.log2(capacity / least)),
        ("DSNU1288 (e⁻)", noise.dsnu),
        ("DSNU1288 (DN)", gain * noise.dsnu),
        ("PRNU1288 (%)", 100 * noise.prnu),
        ("linearity error LE (%)", 100 * noise.linearity_error),
        ("dark current (e⁻/s)", noise.dark_current),
    ]
    rows = tuple((name, *(tidy(float(value), 4) for value in values)) for name, values in lines)
    return Table("Figures of each channel", ("quantity", *camera.channels), rows)


def _lit(camera: CameraModel, noise: NoiseFit, channel: int) -> tuple[Array, Array, Array]:
    """Return exposure (s), signal above the dark (DN) and the line through it over LINEAR, of the exposures of a channel."""
    gain = noise.conversion_gain[channel]
    order = np.argsort(noise.exposure, kind="stable")
    exposure, mean = noise.exposure[order], noise.photon_transfer_mean[order, channel]
    signal = mean - gain * noise.dark_current[channel] * exposure
    share = mean / (gain * noise.saturation_capacity[channel])
    chosen = (share >= LINEAR[0]) & (share <= LINEAR[1]) & (signal > 0)
    if chosen.sum() < 2:
        return exposure, signal, np.full(exposure.size, np.nan)
    return exposure, signal, np.polyval(np.polyfit(exposure[chosen], signal[chosen], 1, w=1 / signal[chosen]), exposure)


def linearity_figure(camera: CameraModel, noise: NoiseFit) -> Figure:
    """Return the mean signal over the exposure time, with its line."""
    every = [_lit(camera, noise, channel) for channel in range(len(camera.channels))]
    plot = Plot(
        spanning("exposure time (s)", noise.exposure, zero=True),
        spanning("mean signal above the dark (DN)", np.array([signal for _, signal, _ in every]), zero=True),
    )
    keys = colours.channel_keys(camera)
    for key, (exposure, signal, line) in zip(keys, every, strict=True):
        inside = np.isfinite(line) & (line <= 1.1 * signal.max())
        plot.line(exposure[inside], line[inside], key.colour, key.mark, 1.2)
        plot.dots(exposure, signal, key.colour, colours.MARKS[key.mark], series=key.label)
    return plot.figure("Linearity", "Lines are fitted over 5–95 % of saturation, relative deviations being least.", keys)


def deviation_figure(camera: CameraModel, noise: NoiseFit) -> Figure:
    """Return the relative deviation from that line over the signal."""
    keys, drawn = colours.channel_keys(camera), []
    for channel in range(len(keys)):
        _, signal, line = _lit(camera, noise, channel)
        share = signal / (noise.conversion_gain[channel] * noise.saturation_capacity[channel])
        inside = np.isfinite(line) & (share >= LINEAR[0]) & (share <= LINEAR[1])
        drawn.append((100 * share[inside], 100 * (signal[inside] / line[inside] - 1)))
    plot = Plot(
        spanning("mean signal (% of saturation)", np.concatenate([share for share, _ in drawn]), zero=True),
        spanning("deviation from the line (%)", np.concatenate([deviation for _, deviation in drawn])),
    )
    for key, (share, deviation) in zip(keys, drawn, strict=True):
        if share.size:
            plot.line(share, deviation, key.colour, key.mark, 1.2)
            plot.dots(share, deviation, key.colour, colours.MARKS[key.mark], series=key.label)
    errors = ", ".join(
        f"{name} {tidy(100 * float(error), 3)} %" for name, error in zip(camera.channels, noise.linearity_error, strict=True)
    )
    return plot.figure(
        "Deviation from linearity",
        f"LE: {errors}, the lamp's drift taken off where a monitor states it; drawn it is not.",
        keys,
    )


def snr_figure(camera: CameraModel, noise: NoiseFit) -> Figure:
    """Return signal over noise over the signal: as measured, by the figures, and of photons alone."""
    most = float(noise.saturation_capacity.max())
    electrons = np.geomspace(most * SHOT_MOST, most, 60)
    plot = Plot(
        spanning("signal (e⁻)", electrons, log=True),
        spanning("signal over noise (1)", np.sqrt(electrons[[0, -1]]) * (0.3, 1.0), log=True),
    )
    plot.line(electrons, np.sqrt(electrons), "currentColor", "dotted", 1.2)
    keys = colours.channel_keys(camera)
    for channel, key in enumerate(keys):
        gain, dark = noise.conversion_gain[channel], noise.read_noise[channel]
        variance = electrons + dark**2 + QUANTISATION / gain**2
        plot.line(electrons, electrons / np.sqrt(variance), key.colour, key.mark, 1.2)
        mean, measured = noise.photon_transfer_mean[:, channel], noise.photon_transfer_variance[:, channel]
        inside = (mean > 0) & (measured > 0) & (mean < LINEAR[1] * gain * noise.saturation_capacity[channel])
        snr = mean[inside] / np.sqrt(measured[inside])
        plot.dots(mean[inside] / gain, snr, key.colour, colours.MARKS[key.mark], series=key.label)
    return plot.figure("Signal over noise", "Temporal noise alone; dotted: an ideal sensor, of photons' noise alone.", keys)
