"""The section of rendered sequences in a report: noise, flicker and errors of each frame."""

from typing import Any

import numpy as np

from l3cli.report.drawing import Plot, spanning
from l3cli.report.parts import Figure, Figures, Section, Subsection, Table, Text
from l3cli.system.text import figure as number
from l3cli.system.text import tidy

Documents = dict[str, dict[str, Any]]  # file name → document of `l3 evaluate --sequence --json`
SEQUENCE_METRICS = {  # metric of a whole sequence → heading with unit
    "temporal_sigma": "temporal σ of L*",
    "patch_sigma": "σ of patch means (L*)",
    "still_share": "still patches (share)",
    "largest_jump": "largest jump of mean L*",
    "largest_jump_frame": "in frame",
    "warped_error": "warped error (L*)",
    "psnr": "PSNR (dB)",
    "mean_delta_e": "mean ΔE00",
}
FRAME_METRICS = {  # metric of a frame → title, label of the axis, whether the axis begins at 0
    "step_sigma": ("Noise over time", "σ of the change of L* on still patches", True),
    "jump": ("Flicker over time", "jump of mean L* since the frame before", False),
    "warped_error": ("Error along the motion", "warped error (L*)", True),
    "mean_delta_e": ("Colour error over time", "mean ΔE00", True),
    "psnr": ("PSNR over time", "PSNR (dB)", False),
    "mean_lightness": ("Brightness over time", "mean L*", False),
}
MEANINGS = (
    "L* is the CIE lightness of the displayed picture, 0 to 100. Temporal σ is the standard deviation of a pixel over time, "
    "on patches of 8 × 8 pixels whose content stays still. The σ of the patch means is visible as flickering blotches. A "
    "jump is the change of a frame's mean L* minus the change of the ideal's mean. The warped error is the difference "
    "between the errors of a frame and of the frame before, compared along the known motion."
)


def sequence_section(documents: Documents) -> Section:
    """Build the section that compares evaluated sequences.

    Parameters
    ----------
    documents : dict of str to dict
        File name → document of `l3 evaluate --sequence --json`.

    Returns
    -------
    Section
        A table with the metrics of whole sequences, and plots against the frame number with one line per sequence.
    """
    rows = tuple(
        (name, str(len(document["frames"])), *(_cell(figure, document[figure]) for figure in SEQUENCE_METRICS))
        for name, document in documents.items()
    )
    table = Table("Whole sequences", ("evaluation", "frames", *SEQUENCE_METRICS.values()), rows)
    drawn = tuple(_curves(documents, figure) for figure in FRAME_METRICS if _known(documents, figure))
    parts = (Subsection("Whole sequences", (table, Text(MEANINGS))), Subsection("Over the frames", (Figures(drawn),)))
    lead = "How much the lightness of still areas changes from frame to frame, and how far the pictures are from the ideal."
    return Section("Sequences over time", lead, parts)


def summary(documents: Documents) -> str:
    """State the temporal noise and the largest jump of each sequence, with one sentence per sequence."""
    return " ".join(_sentence(name, document) for name, document in documents.items())


def _sentence(name: str, document: dict[str, Any]) -> str:
    noise, jump = document["temporal_sigma"], document["largest_jump"]
    still = "no still patches" if noise is None else f"a temporal σ of {_cell('', noise)} L* on still patches"
    jumps = "" if jump is None else f", and its mean L* jumps by {_cell('', jump)} at most"
    return f"{name} has {still}{jumps}."


def _cell(figure: str, value: float | None) -> str:
    if value is None:
        return "–"
    form = {"largest_jump_frame": ".0f", "psnr": ".2f"}.get(figure, ".3f")
    return number(value, form).replace("-", "−")


def _known(documents: Documents, figure: str) -> bool:
    """Whether any frame of any sequence has this metric."""
    return any(frame[figure] is not None for document in documents.values() for frame in document["frames"])


def _curves(documents: Documents, figure: str) -> Figure:
    """Plot a metric against the frame number for every sequence that has it."""
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
    """Return the numbers of the frames that have a metric, and the values of the metric."""
    known = [(frame["frame"], frame[figure]) for frame in document["frames"] if frame[figure] is not None]
    at, values = np.array(known, np.float64).reshape(-1, 2).T
    return at, values
