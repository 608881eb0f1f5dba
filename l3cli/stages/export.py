"""The `l3 export` stage, which writes a camera model or a transform table as files for other software.

A camera is exported as curves, colour matrices, tuning files and a data sheet, and a table as C source or as arrays.
"""

from pathlib import Path
from typing import Any

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import camera_files, load_camera
from l3cli.artifacts.store import load, open_artifact
from l3cli.artifacts.table import TransformTable
from l3cli.errors import InputFileError, RecipeError
from l3cli.export import profiles
from l3cli.export.folder import folder_files
from l3cli.export.source import PREFIX, c_files
from l3cli.io.glare import glare_files
from l3cli.options.commands import ExportOptions
from l3cli.physics.display import XYZ
from l3cli.rendering.conditions import at_gain, known_gains, mix_for, mixed, noise_limits
from l3cli.rendering.white.scene_white import far_from_training
from l3cli.rendering.white.source import given_white
from l3cli.simulation.light import named_beyond_known
from l3cli.stages.rendering.job import light_mix_of_given
from l3cli.system.files import FilesUsed, files_to_read, write_whole
from l3cli.system.outputs import OutputGuard
from l3cli.system.text import a

LOW_NOISE_README = """
## Low-noise transforms

This is the second set of transforms of a table. Use this set for pixels where a temporal filter has left at most
{limit:.3g} of the variance of the temporal noise. The set was trained for a fraction of {noise_left:.3g}. Render all other
pixels with the usual set, which is exported separately and has its own test files.
"""


def is_table(path: Path) -> bool:
    """Return True for a transform table, and False for a camera.

    A file with the suffix .toml counts as a camera and is not read.

    Raises
    ------
    InputFileError
        If the file is neither a transform table nor a camera.
    """
    if path.suffix == ".toml":
        return False
    with open_artifact(path) as root:
        kind = str(root.attrs["kind"])
    if kind not in (CameraModel.kind, TransformTable.kind):
        raise InputFileError(
            f"{path} is {a(kind)}, which cannot be exported; use a camera model, a camera recipe or a transform table"
        )
    return kind == TransformTable.kind


def export(camera: Path, output: Path, options: ExportOptions) -> tuple[dict[str, dict[str, dict[str, Any]]], FilesUsed]:
    """Write the curves, matrices, tuning files and data sheet of a camera into a folder.

    Parameters
    ----------
    camera : Path
        Camera model or camera recipe.
    output : Path
        Folder to write.
    options : ExportOptions
        Options of `l3 export`. Only `force` and `console` are used.

    Returns
    -------
    dict
        Colour errors of the matrices, by illuminant.
    FilesUsed
        The files that were read and written.

    Raises
    ------
    RecipeError, InputFileError
        If the input is not a camera.
    L3Error
        If a file exists and `force` is not set, or if a file cannot be written.
    """
    console = options.console
    with OutputGuard(console) as guard:
        guard.protect(camera, *camera_files(camera))
        model = load_camera(camera)
        texts, errors, note = profiles.export(model)
        files: dict[str, str | bytes] = {**texts, **glare_files(model)}
        for name in files:
            guard.guard_file(output / name, options.force)
        used = files_to_read({"camera": camera_files(camera)})
        for name, content in files.items():
            write_whole(output / name, content)
        if note:
            console.report(note)
        console.info(f"wrote {', '.join(files)} to {output}")
        return errors, used.and_wrote(*(output / name for name in files))


def export_table(table: Path, output: Path, options: ExportOptions) -> tuple[list[str], FilesUsed]:
    """Write a transform table into a folder, as C source or as arrays.

    The options can select the transforms for one white, one gain, or temporally filtered frames. If a table has several sets
    of transforms and the options select none, l3 reports which set is exported.

    Parameters
    ----------
    table : Path
        Transform table.
    output : Path
        Folder to write.
    options : ExportOptions
        Options of `l3 export`. The default format is C source.

    Returns
    -------
    list of str
        Names of the files that were written.
    FilesUsed
        The files that were read and written.

    Raises
    ------
    InputFileError
        If the file is not a table, or if the format does not support the table.
    RecipeError
        If an option does not fit the format or the table.
    L3Error
        If a file exists and `force` is not set, or if a file cannot be written.
    """
    form, words, prefix, which = options.form or "c", options.words, options.prefix, options.which
    white, console = options.white, options.console
    if form != "c" and (words or prefix is not None):
        raise RecipeError(f"‹{'words' if words else 'prefix'}› applies only to C source; remove this option")
    if which and form == "folder":
        raise RecipeError("‹set› applies only to C source, because a folder of arrays contains both sets; remove ‹set›")
    with OutputGuard(console) as guard:
        guard.protect(table)
        guard.hold_folder(output)
        transforms = load(TransformTable, table)
        if white is not None and not transforms.lights and (form != "c" or transforms.outputs != XYZ):
            raise RecipeError(
                f"‹white› {white} needs transforms for single illuminants, which {table} does not contain; remove ‹white›"
            )
        if white is not None or form != "folder":  # a folder without ‹white› contains the transforms of all illuminants
            transforms = mixed(transforms, light_mix_of_given(white, transforms, mix_for, console))
        if options.gain is not None:
            transforms = at_gain(transforms, options.gain)
        elif known_gains(transforms) != (1, 1):
            console.report(
                f"{table}: exporting the transforms for a gain of 1; to export the transforms for a different gain, set "
                "‹gain›"
            )
        shown, readme = given_white(white, transforms), ""
        low = next((each for each in transforms.noises if each.noise and each.noise.noise_left < 1), None)
        if which == "low-noise" and low is None:
            raise RecipeError(
                f"{table} has only one set of transforms; remove ‹set›, or train a table with learning.noise_left"
            )
        if low and form != "folder" and which is None:
            console.report(
                f"{table}: exporting the usual set of transforms; to export the set for temporally filtered frames, use "
                "‹set› low-noise"
            )
        if low and low.noise and which == "low-noise":
            values = {"limit": noise_limits(transforms)[low.noise], "noise_left": low.noise.noise_left}
            transforms, readme = transforms.under(low), LOW_NOISE_README.format(**values)
        balance = shown.balance if shown else None
        if white and shown and form == "c" and (doubt := far_from_training(white, shown, transforms)):
            console.warn(doubt)
        if white and shown and transforms.camera is not None and "," not in white:
            for unknown in named_beyond_known((white,), transforms.camera):
                console.warn(unknown)
        if form == "c":
            files = c_files(transforms, words or "float32", balance, PREFIX if prefix is None else prefix)
        else:
            files = folder_files(transforms)
        if readme:
            files["README.md"] += readme.encode()
        for name in files:
            guard.guard_file(output / name, options.force)
        used = files_to_read({"table": [table]})
        for name, content in files.items():
            write_whole(output / name, content)
        console.info(f"wrote {', '.join(files)} to {output}")
        return list(files), used.and_wrote(*(output / name for name in files))
