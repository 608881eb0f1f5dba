"""What calibration found, in EMVA 1288 names and units, and how close it comes to a known truth."""

from typing import Any

import numpy as np

from l3cli import spectra
from l3cli.artifacts.camera import CameraModel
from l3cli.errors import InputFileError


def camera_figures(camera: CameraModel) -> dict[str, tuple[float, str]]:
    """Figures of the whole camera: EMVA 1288 name → value, unit."""
    noise = camera.noise
    return {
        "overall system gain K": (camera.gain, "DN/e-"),
        "temporal dark noise": (noise.read_noise, "e-"),
        "dark current": (noise.dark_current, "e-/s"),
        "DSNU": (noise.dsnu, "e-"),
        "PRNU": (100.0 * noise.prnu, "%"),
        "saturation capacity": (min(noise.well_capacity, camera.full_scale), "e-"),
        "black level": (camera.black, "DN"),
        "saturation level": (camera.white, "DN"),
    }


def figures(camera: CameraModel) -> dict[str, Any]:
    """Figures of a calibrated camera and of each of its channels, ready for JSON."""
    fit = camera.fit
    assert fit is not None
    columns = {
        "peak QE (%)": 100.0 * camera.responsivity.max(axis=1),
        "K (DN/e-)": fit.conversion_gain,
        "dark noise (e-)": fit.read_noise,
        "dark current (e-/s)": fit.dark_current,
        "DSNU (e-)": fit.dsnu,
        "PRNU (%)": 100.0 * fit.prnu,
        "offset (DN)": fit.beta,
        "R²": fit.r_squared,
        "RMSE (%)": 100.0 * fit.relative_rmse,
    }
    return {
        "camera": {name: {"value": value, "unit": unit} for name, (value, unit) in camera_figures(camera).items()},
        "channels": _by_channel(camera, columns),
        "smoothing": fit.chosen_smoothing,
        "saturation reached": bool(fit.white_reached),
    }


def compare(camera: CameraModel, truth: CameraModel) -> dict[str, Any]:
    """How close a calibrated camera comes to the one that was measured: figures, and curves of each channel.

    InputFileError if the two do not have the same channels.
    """
    if camera.channels != truth.channels:
        raise InputFileError(
            f"the truth has the channels {' '.join(truth.channels)}, the measurements {' '.join(camera.channels)}; "
            "give the camera that was measured"
        )
    real = spectra.resample(truth.responsivity, truth.wavelength, camera.wavelength)
    error = camera.responsivity - real
    columns = {
        "responsivity RMS error (% of peak)": 100.0 * np.sqrt(np.mean(error**2, axis=1)) / real.max(axis=1),
        "gain alpha·r error (%)": 100.0 * (camera.gain * camera.responsivity.sum(1) / (truth.gain * real.sum(1)) - 1.0),
        "within band (%)": 100.0 * np.mean(np.abs(error) <= camera.responsivity_band, axis=1),
    }
    true = camera_figures(truth)
    return {
        "camera": {
            name: {"recovered": value, "true": true[name][0], "unit": unit}
            | {"error %": 100.0 * (value / true[name][0] - 1.0) if true[name][0] else None}
            for name, (value, unit) in camera_figures(camera).items()
        },
        "channels": _by_channel(camera, columns),
    }


def _by_channel(camera: CameraModel, columns: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Columns (channel) as one row of plain numbers a channel."""
    return {
        name: {title: float(column[index]) for title, column in columns.items()}
        for index, name in enumerate(camera.channels)
    }


def as_text(result: dict[str, Any]) -> str:
    """`figures`, with `compare` under "truth" if there, as plain text."""
    truth = result.get("truth")
    lines = []
    for name, entry in result["camera"].items():
        line = f"{name:24}{entry['value']:12.5g} {entry['unit']:6}"
        if truth:
            known = truth["camera"][name]
            error = "" if known["error %"] is None else f"  error {known['error %']:+.2f} %"
            line += f"  true {known['true']:10.5g}{error}"
        lines.append(line.rstrip())
    lines += ["", *_table(result["channels"])]
    if truth:
        lines += ["", *_table(truth["channels"])]
    return "\n".join(lines)


def _table(rows: dict[str, dict[str, float]]) -> list[str]:
    """Rows of numbers below two header lines: names, and the units that stand in brackets after them."""
    titles = list(next(iter(rows.values())))
    names = [title.partition(" (")[0] for title in titles]
    units = [title.partition(" (")[2].rstrip(")") for title in titles]
    widths = [max(8, len(name), len(unit)) for name, unit in zip(names, units, strict=True)]
    side = max(len("channel"), *map(len, rows))

    def line(first: str, cells: list[str]) -> str:
        return "  ".join([first.ljust(side), *(cell.rjust(width) for cell, width in zip(cells, widths, strict=True))])

    body = [line(name, [f"{row[title]:.5g}" for title in titles]) for name, row in rows.items()]
    return [line("channel", names), line("", units), *body]
