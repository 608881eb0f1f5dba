"""Writes the curve statistics and curves of measured cameras: `python -m tests.helpers.priors`.

configs/priors/rgb.toml gets the statistics of the rawtoaces cameras, and cameras.csv gets their curves.
"""

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.calibration.photo.estimate import ROLES, statistics
from l3cli.frames.measurement import CurveStatistics
from l3cli.io.curves import prior_files, read_cameras
from l3cli.recipes.builtin import slug_of
from tests.helpers.paths import ROOT

TABLE, CURVES = (ROOT / "configs" / "priors" / name for name in ("rgb.toml", "cameras.csv"))
NM = slice(0, 69)  # 380 to 720 nm; the files end at 780 nm, but above 720 nm all responsivities are below 0.6 % of the peak
SOURCE = (
    "statistics of the spectral sensitivities of 52 cameras measured for rawtoaces (Academy Software Foundation, "
    "rawtoaces-data, Apache-2.0): means and principal modes, no camera's curves"
)


def measured(data: Path) -> CurveStatistics:
    """Return the statistics of the cameras in the data folder."""
    return statistics(read_cameras(prior_files(data / "sensitivities/rawtoaces/data/camera")))


def as_toml(known: CurveStatistics) -> str:
    """Format the statistics as TOML."""

    def numbers(values: NDArray[np.float64], digits: int = 5) -> str:
        return "[" + ", ".join(f"{value:.{digits}f}" for value in values) + "]"

    lines = [f'source = "{SOURCE}"', f"wavelength_nm = {numbers(known.wavelength, 1)}"]
    lines += [f"log_peak = {numbers(known.log_peak)}"]
    lines += [f"log_peak_covariance = [{', '.join(numbers(row) for row in known.log_peak_covariance)}]", "", "[mean]"]
    lines += [f"{role} = {numbers(curve)}" for role, curve in zip(ROLES, known.mean, strict=True)]
    for mode in known.modes:
        lines += ["", "[[modes]]", *(f"{role} = {numbers(curve)}" for role, curve in zip(ROLES, mode, strict=True))]
    return "\n".join(lines) + "\n"


def curves_as_csv(data: Path) -> str:
    """Format the curves of all cameras, per photon and with a maximum of 1, as CSV with columns such as "nikon_d810 r"."""
    files = prior_files(data / "sensitivities/rawtoaces/data/camera")
    curves = read_cameras(files)
    names = [f"{slug_of(path.stem.removesuffix('_380_780_5'))} {role}" for path in files for role in ROLES]
    columns = np.vstack([each.responsivity / each.responsivity.max() for each in curves])[:, NM]
    lines = (
        f"{at:g}," + ",".join(f"{value:.4f}".rstrip("0").rstrip(".") for value in row)
        for at, row in zip(curves[0].wavelength[NM], columns.T, strict=True)
    )
    return "\n".join([",".join(["wavelength_nm", *names]), *lines]) + "\n"


if __name__ == "__main__":
    given = Path(os.environ["L3_DATA"])
    TABLE.write_text(as_toml(measured(given)))
    CURVES.write_text(curves_as_csv(given))
