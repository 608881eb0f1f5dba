"""The `l3 calibrate` stage, which estimates a camera model from measurements or drafts a measurement file."""

import itertools
import os
import shlex
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import camera_files, load_camera
from l3cli.artifacts.store import save
from l3cli.calibration import figures, model
from l3cli.calibration.draft.compose import Composer
from l3cli.calibration.draft.folder import Reading, compose_tables, first_lines, survey
from l3cli.calibration.draft.names import natural, read_name
from l3cli.calibration.draft.sorting import Spectra
from l3cli.errors import L3Error, RecipeError
from l3cli.frames.measurement import CaptureFolder, FinishedCurves, SweepTable
from l3cli.io.chart_photos import array_of
from l3cli.io.frames import list_captures, read_capture, read_spectra
from l3cli.io.measurements import measurements_of, parse_measurements, read_measurements, read_photos
from l3cli.options.commands import CalibrateOptions, DraftOptions
from l3cli.parallel import ordered_map
from l3cli.system.files import FilesUsed, files_to_read, write_whole
from l3cli.system.outputs import OutputGuard
from l3cli.system.text import counted

MAX_PRINTED = 8  # maximum number of printed lines about assumed values, and about missing values


def calibrate(
    measurements: Path | None, output: Path, options: CalibrateOptions
) -> tuple[CameraModel, dict[str, Any], FilesUsed]:
    """Calibrate a camera from a measurement file or from raw photos of a ColorChecker, and write the camera model.

    The quality of the fit is checked, unless the measurement file only corrects an existing camera model. Warnings are
    printed on the console.

    Parameters
    ----------
    measurements : Path or None
        Measurement file. None if `options.photos` contains photos.
    output : Path
        Camera model to write.
    options : CalibrateOptions
        Options of `l3 calibrate`.

    Returns
    -------
    CameraModel
        The model.
    dict
        Output of `l3 calibrate --json`.
    FilesUsed
        The files that were read and written.

    Raises
    ------
    InputFileError, RecipeError
        If the measurements are unsuitable, or if `measurements` and `options.photos` are both set or both missing.
    L3Error
        If the model predicts the charts poorly and `accept` is not set, or if the output cannot be written.
    """
    photos, light, truth = options.photos, options.light, options.truth
    console, force = options.console, options.force
    if (measurements is None) == (not photos):
        raise RecipeError(
            "calibration needs either a measurement file or raw photos; specify a measurement file, or set ‹photo›"
        )
    if light is not None and measurements is not None:
        raise RecipeError(
            "‹light› applies only to photos, because a measurement file contains its own illuminants; remove ‹light›"
        )
    with OutputGuard(console) as guard:
        guard.protect(*photos, *filter(None, [measurements, truth]))
        guard.guard_file(output, force)
        given = read_photos(photos, light) if measurements is None else read_measurements(measurements)
        measured = given.measurements
        files = files_to_read(given.files | {"camera to compare with": camera_files(truth) if truth else []})
        guard.protect(*itertools.chain(*files.read.values()))
        true = load_camera(truth) if truth else None

        def each(function: Callable[[Any], Any], captures: Iterable[Any]) -> Iterator[Any]:
            captures = list(captures)
            return console.progress(ordered_map(function, captures, options.jobs), len(captures), "captures")

        camera = model.calibrate(measured, each)
        earlier = measured.base.history if measured.base else ()
        shortfall = None if measured.base else figures.shortfall(camera)
        if shortfall and not options.accept:
            culprit = "" if measurements is None else f"{measurements}: "
            raise L3Error(f"{culprit}{shortfall}, or add ‹accept›")
        history = given.history(({"light": None} if photos else {}) | options.chosen())
        camera = replace(camera, history=(*earlier, history))
        result: dict[str, Any] = figures.figures(camera)
        if true is not None:
            result["truth"] = figures.compare(camera, true)
        save(camera, output)
        for doubt in figures.doubts(camera):
            console.warn(doubt)
        if shortfall:
            fault, _, _ = shortfall.partition(";")
            console.info(f"the camera model is saved despite a fault, because ‹accept› is set: {fault}")
        if result["saturation reached"] is False:
            console.info(
                "no white frame saturates, so the highest code of the converter is used as the white level; to measure the "
                "white level, add a longer exposure"
            )
        if isinstance(measured.curve, FinishedCurves) and measured.curve.note:
            console.info(measured.curve.note)
        if measured.curve is not None and not camera.responsivity_band.any():
            light = "photodiode" if isinstance(measured.curve, SweepTable) else "lamp_drift"
            console.info(
                f"the curves have no confidence band; to compute a band, set {light} and wavelength_nm in [uncertainty]"
            )
        csv = f"l3 export {shlex.quote(str(output))} -o DIR"
        console.info(f"wrote {output}; its dataset responsivity contains the curves; to write the curves as CSV: {csv}")
        return camera, result, files.and_wrote(output)


def draft(folder: Path, output: Path, options: DraftOptions) -> FilesUsed:
    """Write a draft of a measurement file for a folder of captures.

    If the folder contains no raw frames, the draft describes its tables of responsivities. Sensor, CFA and optics come from
    `options.camera`, because frames contain no information about them. The draft marks unknown values with TODO and assumed
    values with ASSUMED. The most important of these values are also printed.

    Parameters
    ----------
    folder : Path
        Folder of captures or tables.
    output : Path
        Measurement file to write (.toml).
    options : DraftOptions
        Options of `l3 calibrate --draft`.

    Returns
    -------
    FilesUsed
        The files that were read and written.

    Raises
    ------
    InputFileError
        If the folder contains neither raw frames nor responsivities.
    RecipeError
        If the frames do not fit the camera, or if the output file name does not end in .toml.
    L3Error
        If the output cannot be written.
    """
    if output.suffix != ".toml":
        raise RecipeError(
            f"{output} is not a valid name for a measurement file; use a name that ends in .toml, such as MEASUREMENTS.toml"
        )
    camera, console = options.camera, options.console
    with OutputGuard(console) as guard:
        guard.protect(*(camera_files(camera) if camera else ()))
        guard.guard_file(output, options.force, recipe=True)
        known = load_camera(camera) if camera else None
        listing = list_captures(folder)
        frames, tables = ([folder / name for name in names] for names in (listing.frames, listing.tables))
        files = files_to_read({"frames": frames, "tables": tables})
        notes, name = list[str](), folder.absolute().name
        if not listing.frames and (spectra := spectra_of(listing, output, notes)):
            text, contents = compose_tables(spectra, known, name, notes), f"{counted(len(spectra), 'table')}, no frames"
        else:
            notes = list(listing.notes)
            reading = Reading(lambda path: read_capture(folder / path), array_of, console.progress)
            seen = survey(listing, spectra_of(listing, output, notes), notes, known, reading)

            def read(path: str) -> NDArray[np.float64]:
                return reading.read(path).values.astype(np.float64)

            text, notes = Composer(seen, known, named_from(folder, output), read).text(name), seen.notes
            contents = f"{len(seen.groups)} captures, {sum(len(group.frames) for group in seen.groups)} frames"
        write_whole(output, str(text))
        assumed = first_lines(
            [f"assumed: {line}" for line in text.assumed], MAX_PRINTED, "… and {} more, marked ASSUMED in the file"
        )
        missing = first_lines(
            [f"missing: {line}" for line in text.missing], MAX_PRINTED, "… and {} more, marked TODO in the file"
        )
        for line in (*notes, *assumed, *missing):
            console.info(line)
        written = f"{output}: {contents}"
        problem = "" if text.missing else _problem(str(text), output)
        if problem:
            console.warn(f"l3 calibrate cannot use {output} yet: {problem}")
        then = "replace each TODO in the file, then" if text.missing else "next"
        console.info(written if problem else f"{written}; {then}: l3 calibrate {output} -o camera.h5")
        return files.and_wrote(output)


def _problem(text: str, output: Path) -> str:
    """Return the error that `l3 calibrate` would report for a draft without missing values, or "" if there is none."""
    try:
        measurements_of(parse_measurements(text, output), output)
    except L3Error as error:
        return str(error)
    return ""


# ---------------------------------------------------------------------------------------------------- survey


def named_from(path: Path, output: Path) -> str:
    """Return a path for use in the measurement file `output`: relative if it is inside the file's folder, else absolute."""
    relative = os.path.relpath(path, output.parent)
    return str(path.absolute()) if relative.startswith("..") else Path(relative).as_posix()


def spectra_of(listing: CaptureFolder, output: Path, notes: list[str]) -> list[Spectra]:
    """Read the tables of spectra in a folder, in natural order of their names.

    A message about each skipped file is appended to `notes`.
    """
    tables = read_spectra(listing, notes)
    spectra = [Spectra(named_from(listing.folder / name, output), read_name(name), table) for name, table in tables]
    return sorted(spectra, key=lambda each: natural(each.name.path))
