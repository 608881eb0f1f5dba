"""Writes configs/priors/rgb.toml, statistics of the measured cameras of rawtoaces: python -m tests.helpers.priors."""

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.calibration.photo.estimate import ROLES, statistics
from l3cli.frames.measurement import CurveStatistics
from l3cli.io.curves import prior_files, read_cameras
from tests.helpers.paths import ROOT

TABLE = ROOT / "configs" / "priors" / "rgb.toml"
SOURCE = (
    "statistics of the spectral sensitivities of 52 cameras measured for rawtoaces (Academy Software Foundation, "
    "rawtoaces-data, Apache-2.0): means and principal modes, no camera's curves"
)


def measured(data: Path) -> CurveStatistics:
    """The statistics of the cameras in the folder of real data."""
    return statistics(read_cameras(prior_files(data / "sensitivities/rawtoaces/data/camera")))


def as_toml(known: CurveStatistics) -> str:
    """The text of the table."""

    def numbers(values: NDArray[np.float64], digits: int = 5) -> str:
        return "[" + ", ".join(f"{value:.{digits}f}" for value in values) + "]"

    lines = [f'source = "{SOURCE}"', f"wavelength_nm = {numbers(known.wavelength, 1)}"]
    lines += [f"log_peak = {numbers(known.log_peak)}"]
    lines += [f"log_peak_covariance = [{', '.join(numbers(row) for row in known.log_peak_covariance)}]", "", "[mean]"]
    lines += [f"{role} = {numbers(curve)}" for role, curve in zip(ROLES, known.mean, strict=True)]
    for mode in known.modes:
        lines += ["", "[[modes]]", *(f"{role} = {numbers(curve)}" for role, curve in zip(ROLES, mode, strict=True))]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    TABLE.write_text(as_toml(measured(Path(os.environ["L3_DATA"]))))
