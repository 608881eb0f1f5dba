"""The drafting stage: a folder of captures, or of tables alone → a measurement file with what is missing marked."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera_recipe import camera_files, load_camera
from l3cli.calibration.draft.compose import compose
from l3cli.calibration.draft.tables import compose_tables
from l3cli.errors import L3Error, RecipeError
from l3cli.io.captures import list_captures, read_capture
from l3cli.io.measurement_recipe import MeasurementRecipe
from l3cli.io.measurements import measurements_of
from l3cli.options.pipeline import DraftOptions
from l3cli.recipes.toml import parse_recipe
from l3cli.stages.claims import OutputGuard, refuse_unwritable
from l3cli.stages.drafting.survey import named_from, spectra_of, survey
from l3cli.stages.plan import Made, before_work, is_dry
from l3cli.system.files import refuse_existing, refuse_protected, write_whole
from l3cli.system.ledger import is_noting
from l3cli.system.locks import sole_writer_of_file
from l3cli.system.text import counted

MOST_SAID = 8  # assumptions and missing things of which each gets a line on the console


def draft(folder: Path, output: Path, options: DraftOptions) -> str:
    """Write the draft of a measurement file of the captures in a folder, or of its tables if it has no frames; its text.

    Sensor, array and optics are those of the options' camera, since frames do not state them. InputFileError if
    the folder holds neither raw frames nor responsivities, RecipeError if the camera is another one, L3Error if the output
    cannot be written.
    """
    if output.suffix != ".toml":
        raise RecipeError(f"{output}: a measurement file ends in .toml; name it MEASUREMENTS.toml")
    camera, console = options.camera, options.console
    with OutputGuard(console) as claims:
        claims.protect(*(camera_files(camera) if camera else ()))
        refuse_protected(output)
        refuse_unwritable(output)
        refuse_existing(output, options.force)
        claims.hold(sole_writer_of_file(output), output)
        known = load_camera(camera) if camera else None
        listing = list_captures(folder)
        if is_dry() or is_noting():
            contents = counted(len(listing.frames), "frame") if listing.frames else counted(len(listing.tables), "table")
            inputs = {
                "frames": [folder / name for name in listing.frames],
                "tables": [folder / name for name in listing.tables],
            }
            before_work(inputs, Made(output, f"draft of a measurement file of {contents}"))
        notes, name = list[str](), folder.absolute().name
        if not listing.frames and (tables := spectra_of(listing, output, notes)):
            text, contents = compose_tables(tables, known, name, notes), f"{counted(len(tables), 'table')}, no frames"
        else:
            seen = survey(listing, output, known, console)

            def read(path: str) -> NDArray[np.float64]:
                return read_capture(folder / path).values.astype(np.float64)

            text, notes = compose(seen, known, name, named_from(folder, output), read), seen.notes
            contents = f"{len(seen.groups)} captures, {sum(len(group.frames) for group in seen.groups)} frames"
        write_whole(output, str(text))
        for line in (*notes, *_few("assumed", "ASSUMED", text.assumed), *_few("missing", "TODO", text.missing)):
            console.info(line)
        written = f"{output}: {contents}"
        problem = "" if text.missing else _problem(str(text), output)
        if problem:
            console.warn(f"l3 calibrate will not take it yet: {problem}")
        then = "fill in what is marked TODO, then" if text.missing else "next"
        console.info(written if problem else f"{written}; {then}: l3 calibrate {output} -o camera.h5")
        return str(text)


def _few(what: str, mark: str, lines: list[str]) -> list[str]:
    """Return the first lines of what is assumed or missing, and how the others are marked in the file."""
    more = [f"… and {len(lines) - MOST_SAID} more, marked {mark}"] if len(lines) > MOST_SAID else []
    return [f"{what}: {line}" for line in lines[:MOST_SAID]] + more


def _problem(text: str, output: Path) -> str:
    """Return why calibration would refuse a draft in which nothing seems to be missing; "" if it would not, before any
    frame."""
    try:
        measurements_of(parse_recipe(text, MeasurementRecipe, str(output)), output)
    except L3Error as error:
        return str(error)
    return ""
