"""Statistics of measured cameras' curves: the table that comes with l3, or a folder of measured curves
(docs/method.md#charts-in-photographs)."""

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np

from l3cli.errors import InputFileError
from l3cli.frames.measurement import CurveStatistics, FinishedCurves
from l3cli.io.curves import read_finished
from l3cli.recipes.builtin import recipe_folder
from l3cli.recipes.toml import Recipe, load_recipe

ROLES = ("r", "g", "b")  # channels of the table that comes with l3, and of the cameras of a folder
SUFFIXES = (".csv", ".json")
LEAST = 8  # cameras of a folder: fewer say nothing of how curves vary
MOST = 2000


class PriorRecipe(Recipe):
    """Statistics of measured curves."""

    title: ClassVar[str] = "a table of curve statistics"

    source: str  # whose curves, by whom, under which licence
    wavelength_nm: list[float]
    mean: dict[str, list[float]]  # channel → wavelength
    modes: list[dict[str, list[float]]]  # channel → wavelength, each mode by its standard deviation
    log_peak: list[float]
    log_peak_covariance: list[list[float]]


def shipped() -> CurveStatistics:
    """Return the statistics that come with l3, of r, g and b."""
    recipe = load_recipe(recipe_folder() / "priors" / "rgb.toml", PriorRecipe)
    return CurveStatistics(
        np.array(recipe.wavelength_nm),
        np.array([recipe.mean[role] for role in ROLES]),
        np.array([[mode[role] for role in ROLES] for mode in recipe.modes]),
        np.array(recipe.log_peak),
        np.array(recipe.log_peak_covariance),
    )


def prior_files(folder: Path) -> list[Path]:
    """Return the files of curves in a folder; InputFileError if there are too few."""
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES) if folder.is_dir() else []
    if not LEAST <= len(files) <= MOST:
        raise InputFileError(
            f"{folder} holds {len(files)} files of curves (CSV or rawtoaces JSON); a prior needs {LEAST} cameras or more"
        )
    return files


def read_cameras(files: Sequence[Path]) -> tuple[FinishedCurves, ...]:
    """Return the curves of measured cameras, r g b, per energy in the files; InputFileError names one that holds none."""
    return tuple(read_finished(path, ROLES, per_energy=True) for path in files)
