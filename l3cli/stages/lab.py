"""The `l3 lab` stage, which simulates laboratory measurements of a camera."""

import functools
import shlex
from pathlib import Path
from typing import Any

import numpy as np

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import camera_files, columns_left_out, load_camera
from l3cli.io import measurement_recipe as files
from l3cli.io.curves import write_curves
from l3cli.io.pictures.openimageio import write_mosaic
from l3cli.options.commands import LabOptions
from l3cli.parallel import workers
from l3cli.recipes.load import load_recipe
from l3cli.simulation.lab import FOLDERS, LabCapture, LabRecipe, chart_corners, plan, take
from l3cli.simulation.light import camera_unknown
from l3cli.simulation.sensor import DefectRecipe
from l3cli.spectra.units import PHOTON_RADIANCE
from l3cli.system.files import FilesUsed, files_to_read, refuse_existing, refuse_protected
from l3cli.system.locks import sole_writer_of_folder
from l3cli.system.outputs import OutputGuard, refuse_unwritable

MONO = "spectra/mono.csv"  # file with the monochromator's spectrum at each step


def measure(camera: Path, output: Path, options: LabOptions) -> tuple[Path, FilesUsed]:
    """Simulate the lab measurements of a camera, and write them into a folder.

    The folder contains the frames, files of spectra, and the measurement file MEASUREMENTS.toml. `options.jobs` processes
    simulate and write the frames.

    Parameters
    ----------
    camera : Path
        Camera model or camera recipe.
    output : Path
        Folder to write.
    options : LabOptions
        Options of `l3 lab`.

    Returns
    -------
    Path
        The measurement file in the folder.
    FilesUsed
        The files that were read and written.

    Raises
    ------
    RecipeError, InputFileError
        If the camera or the lab recipe is unsuitable.
    L3Error
        If the folder already contains a measurement file and `force` is not set, or if the folder cannot be written.
    """
    recipe, seed, console = options.recipe, options.seed, options.console
    file = output / "MEASUREMENTS.toml"
    with OutputGuard(console) as guard:
        guard.protect(camera, *filter(None, [recipe]))
        refuse_protected(file)
        refuse_unwritable(file)
        refuse_existing(file, options.force)
        guard.hold(sole_writer_of_folder(output, inside=FOLDERS), output)
        refuse_existing(file, options.force)  # checked again, because another run may have written it before the lock
        guard.protect(*camera_files(camera))
        model = load_camera(camera)
        chosen = load_recipe(recipe, LabRecipe) if recipe else LabRecipe()
        captures = plan(model, chosen, seed)
        for name in _names(captures):
            refuse_protected(output / name)
        used = files_to_read({"camera": camera_files(camera), "lab recipe": [recipe] if recipe else []})
        if note := columns_left_out(camera):
            console.info(note)
        lights = (*chosen.lights, *([] if model.polarisers is None else [chosen.polariser.illuminant]))
        for unknown in camera_unknown(camera, model, tuple(dict.fromkeys(lights))):
            console.warn(unknown)
        # The measurement file is written last. An old one is removed first, because it would no longer match the frames.
        file.unlink(missing_ok=True)
        work = [(capture, trial) for capture in captures for trial in range(capture.trials)]
        write_frame = functools.partial(_write_frame, model, chosen.defects, output, seed)
        with workers(options.jobs) as pool:
            for _ in console.progress(pool(write_frame, work), len(work), "frames"):
                pass
        files.write_measurements(_described(model, chosen, captures, output), file)
        console.info(
            f"{file}: {len(captures)} captures, {len(work)} frames; next: l3 calibrate {shlex.quote(str(file))} -o camera.h5"
        )
        return file, used.and_wrote(*(output / name for name in _names(captures)))


def _write_frame(model: CameraModel, defects: DefectRecipe, folder: Path, seed: int, job: tuple[LabCapture, int]) -> None:
    """Simulate and write one frame, possibly in a worker process."""
    capture, trial = job
    write_mosaic(folder / _frame_name(capture, trial), take(model, capture, trial, seed, defects), capture.exposure)


def _frame_name(capture: LabCapture, trial: int) -> str:
    return f"{capture.name}_{trial}.tif" if capture.trials > 1 else f"{capture.name}.tif"


def _names(captures: tuple[LabCapture, ...]) -> list[str]:
    """Return the paths of all files to write, relative to the folder."""
    frames = [_frame_name(capture, trial) for capture in captures for trial in range(capture.trials)]
    charts = [_chart_name(capture) for capture in captures if capture.kind == "chart"]
    return ["MEASUREMENTS.toml", MONO, *charts, *frames]


def _chart_name(capture: LabCapture) -> str:
    return f"spectra/{capture.name.replace('/', '_')}.csv"


def _described(
    model: CameraModel, chosen: LabRecipe, captures: tuple[LabCapture, ...], folder: Path
) -> files.MeasurementRecipe:
    """Write the files of spectra into `folder`, and compose the measurement file, which is written later."""
    mono: list[files.MonoRecipe] = []
    charts: list[files.ChartRecipe] = []
    others: dict[str, list[files.CaptureRecipe]] = {"white": [], "dark": [], "polariser": []}
    for capture in captures:
        common: dict[str, Any] = {
            "frames": [_frame_name(capture, trial) for trial in range(capture.trials)],
            "exposure_s": capture.exposure,
            "monitor": capture.monitor,
        }
        if capture.kind == "mono":
            mono.append(files.MonoRecipe(**common, spectrum=MONO, column=capture.light))
        elif capture.kind == "chart":
            name = _chart_name(capture)
            patches = [f"patch_{patch}" for patch in range(1, len(capture.radiance) + 1)]
            write_curves(folder / name, capture.wavelength, capture.radiance, patches, PHOTON_RADIANCE)
            corners = chart_corners(model)
            charts.append(files.ChartRecipe(**common, illuminant=capture.light, corners=corners, radiance=name))
        elif capture.kind == "polariser":
            others[capture.kind].append(files.PolariserRecipe(**common, angle_deg=capture.angle))
        else:
            others[capture.kind].append(files.CaptureRecipe(**common))
    steps = [capture for capture in captures if capture.kind == "mono"]
    radiances, lights = np.concatenate([step.radiance for step in steps]), [step.light for step in steps]
    write_curves(folder / MONO, steps[0].wavelength, radiances, lights, PHOTON_RADIANCE)
    uncertainty = files.UncertaintyRecipe(lamp_drift=chosen.monitor_error, wavelength_nm=chosen.wavelength_error_nm)
    rotator = None
    if others["polariser"]:
        turned = chosen.polariser
        rotator = files.RotatorRecipe(extinction=turned.extinction, angle_error_deg=turned.angle_error_deg)
    return files.describe(model, uncertainty, mono=mono, chart=charts, rotator=rotator, **others)
