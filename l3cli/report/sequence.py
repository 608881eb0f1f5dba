"""The section of a report about evaluated sequences: noise, flicker and errors over time."""

from typing import Any

import numpy as np

from l3cli.report.drawing import Plot, spanning
from l3cli.report.parts import Figure, Figures, Section, Subsection, Table, Text
from l3cli.system.text import figure as number
from l3cli.system.text import tidy

Documents = dict[str, dict[str, Any]]  # outputs of `l3 evaluate --sequence --json`, by file name
SEQUENCE_METRICS = {  # column headings of the metrics of a whole sequence
    "temporal_sigma": "temporal σ of L*",
    "patch_sigma": "temporal σ of patch means of L*",
    "still_share": "fraction of still patches",
    "largest_jump": "largest jump of mean L*",
    "largest_jump_frame": "frame with the largest jump",
    "warped_error": "warped error (L*)",
    "psnr": "PSNR (dB)",
    "mean_delta_e": "mean ΔE00",
}
FRAME_METRICS = {  # per-frame metrics: (plot title, y-axis label, True if the y axis starts at 0)
    "step_sigma": ("Noise over time", "temporal σ of L* in still patches", True),
    "jump": ("Flicker over time", "jump of mean L* since the previous frame", False),
    "warped_error": ("Error along the motion", "warped error (L*)", True),
    "mean_delta_e": ("Colour error over time", "mean ΔE00", True),
    "psnr": ("PSNR over time", "PSNR (dB)", False),
    "mean_lightness": ("Brightness over time", "mean L*", False),
}
MEANINGS = (
    "L* is the CIE lightness of the displayed picture, from 0 to 100. Still patches are areas of 8 × 8 pixels without "
    "motion. The temporal σ is the standard deviation of a pixel over time in these patches. A large temporal σ of the "
    "patch means is visible as flickering blotches. A jump is the change of the mean L* since the previous frame, minus the "
    "same change in the ideal sequence. The warped error is the RMS change of the error from one frame to the next, "
    "measured along the motion of the objects."
)


def sequence_section(documents: Documents) -> Section:
    """Build the section that compares evaluated sequences.

    A table lists the metrics of each sequence. Plots show the metrics of each frame, with one line per sequence. A plot is
    omitted if no sequence has the metric.
    """
    rows = tuple(
        (name, str(len(document["frames"])), *(_cell(figure, document[figure]) for figure in SEQUENCE_METRICS))
        for name, document in documents.items()
    )
    table = Table("Whole sequences", ("evaluation", "frames", *SEQUENCE_METRICS.values()), rows)
    drawn = tuple(_curves(documents, figure) for figure in FRAME_METRICS if _known(documents, figure))
    parts = (Subsection("Whole sequences", (table, Text(MEANINGS))), Subsection("Frame by frame", (Figures(drawn),)))
    lead = "This section shows how much the lightness of still areas changes over time, and the errors of the pictures."
    return Section("Sequences", lead, parts)


def summary(documents: Documents) -> str:
    """Return one sentence per sequence, with its temporal noise and its largest jump in lightness."""
    return " ".join(_sentence(name, document) for name, document in documents.items())


def _sentence(name: str, document: dict[str, Any]) -> str:
    noise, jump = document["temporal_sigma"], document["largest_jump"]
    still = "no still patches" if noise is None else f"a temporal σ of {_cell('', noise)} L* in still patches"
    jumps = "" if jump is None else f", and the largest jump of its mean L* is {_cell('', jump)}"
    return f"{name} has {still}{jumps}."


def _cell(figure: str, value: float | None) -> str:
    if value is None:
        return "–"
    form = {"largest_jump_frame": ".0f", "psnr": ".2f"}.get(figure, ".3f")
    return number(value, form).replace("-", "−")


def _known(documents: Documents, figure: str) -> bool:
    """Whether any frame in any sequence has a value for the metric `figure`."""
    return any(frame[figure] is not None for document in documents.values() for frame in document["frames"])


def _curves(documents: Documents, figure: str) -> Figure:
    """Plot a metric against the frame number, with one line per sequence that has the metric."""
    title, label, zero = FRAME_METRICS[figure]
    series = {name: _series(document, figure) for name, document in documents.items()}
    longest = max(float(at.max(initial=1.0)) for at, _ in series.values())
    y = spanning(label, np.concatenate([values for _, values in series.values()]), zero=zero)
    plot = Plot(spanning("frame", [0.0, longest]), y)
    keys = plot.curves(series, size=0, width=1.6)
    sentences = (
        f"{name} {tidy(values.min())} to {tidy(values.max())}, mean {tidy(values.mean())}"
        for name, (_, values) in series.items()
        if values.size
    )
    return plot.figure(title, f"{label}: {'; '.join(sentences)}.", keys)


def _series(document: dict[str, Any], figure: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the frame numbers and the values of a metric, without frames that lack it."""
    known = [(frame["frame"], frame[figure]) for frame in document["frames"] if frame[figure] is not None]
    at, values = np.array(known, np.float64).reshape(-1, 2).T
    return at, values
