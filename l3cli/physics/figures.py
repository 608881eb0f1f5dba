"""Names, units and number formats of quality metrics (docs/method.md#quality-metrics)."""

from collections.abc import Sequence
from dataclasses import dataclass

from l3cli.system.text import figure as number


@dataclass(frozen=True)
class Figure:
    """How to display a quality metric."""

    heading: str  # name and unit in reports
    short: str  # column heading in the terminal
    unit: str = ""  # unit after a number in sentences, with a leading space if necessary
    more_is_better: bool = False  # whether larger values are better
    digits: int = 2  # number of decimal places


# Metrics of frames, in the order of reports, followed by test-chart metrics from standards (docs/measurement.md).
FIGURES = {
    "mean_delta_e": Figure("mean ΔE00", "ΔE00 mean", " ΔE00"),
    "median_delta_e": Figure("median ΔE00", "median", " ΔE00"),
    "p95_delta_e": Figure("95 % ΔE00", "95 %", " ΔE00"),
    "scielab": Figure("S-CIELAB ΔE00", "S-CIELAB", " ΔE00"),
    "mottle": Figure("mottle of uniform patches (C*ab)", "mottle", " C*ab"),
    "visual_noise": Figure("visual noise of uniform patches", "visual noise"),
    "psnr": Figure("PSNR (dB)", "PSNR dB", " dB", more_is_better=True),
    "output_psnr": Figure("linear PSNR (dB)", "linear dB", " dB", more_is_better=True),
    "ssim": Figure("SSIM (1)", "SSIM", more_is_better=True, digits=4),
    "mean_angle": Figure("mean spectral angle (°)", "SAM mean °", "°"),
    "median_angle": Figure("median angle (°)", "median", "°"),
    "p95_angle": Figure("95 % angle (°)", "95 %", "°"),
    "mean_error": Figure("mean error (white is 1)", "error mean", digits=4),
    "gfc": Figure("goodness of fit (1)", "GFC", more_is_better=True, digits=4),
    "rmse": Figure("RMSE (white is 1)", "RMSE", digits=4),
    "delta_e_a": Figure("mean ΔE00 under A", "ΔE00 A", " ΔE00"),
    "delta_e_d65": Figure("mean ΔE00 under D65", "ΔE00 D65", " ΔE00"),
    "delta_e_f11": Figure("mean ΔE00 under F11", "ΔE00 F11", " ΔE00"),
    "mean_dolp_error": Figure("mean error of DoLP (1)", "DoLP error", digits=4),
    "psnr_dolp": Figure("PSNR of DoLP (dB)", "DoLP dB", " dB", more_is_better=True),
    "aolp_rmse": Figure("RMS error of AoLP (°)", "AoLP °", "°"),
    "dolp_bias": Figure("bias of DoLP of unpolarised light (1)", "DoLP bias", digits=4),
    "psnr_intensities": Figure("PSNR of intensities (dB)", "I dB", " dB", more_is_better=True),
    "psnr_s0": Figure("PSNR of S0 (dB)", "S0 dB", " dB", more_is_better=True),
    "psnr_s1": Figure("PSNR of S1 (dB)", "S1 dB", " dB", more_is_better=True),
    "psnr_s2": Figure("PSNR of S2 (dB)", "S2 dB", " dB", more_is_better=True),
    "mtf50_rows": Figure("MTF50 along rows (cycles/pixel)", "MTF50\nrows", " cycles/pixel", more_is_better=True, digits=3),
    "mtf50_columns": Figure(
        "MTF50 along columns (cycles/pixel)", "MTF50\ncolumns", " cycles/pixel", more_is_better=True, digits=3
    ),
    "snr10": Figure("SNR10 (lux)", "SNR10\nlux", " lux", digits=1),
    "camera_delta_e": Figure("ΔE00 by the camera's uncertainty", "camera\nΔE00", " ΔE00"),
}


def figure_text(figure: str, value: float | None) -> str:
    """Format a metric without its unit. None, NaN and infinity are shown as a dash."""
    return "–" if value is None else number(value, f".{FIGURES[figure].digits}f")


def known_mean(values: Sequence[float | None]) -> float | None:
    """Return the mean of all values except None, or None if there are none."""
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None


def sign(figure: str) -> float:
    """Return 1 if larger values of a metric are better, otherwise −1. Unknown metrics have the sign −1."""
    known = FIGURES.get(figure)
    return 1.0 if known and known.more_is_better else -1.0


def in_words(value: float, figure: str) -> str:
    """Format a difference between two values of a metric, with the unit if the metric is known."""
    unit = FIGURES[figure].unit if figure in FIGURES else ""
    return f"{value:.2g}{unit}" if value < 10 else f"{value:.0f}{unit}"
