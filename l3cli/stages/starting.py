"""The `l3 init` stage, which creates a folder with recipes and a Makefile for a camera.

The camera is specified by one of l3's own recipes, a recipe or design of the user, the name of a known camera, or raw files.
l3 identifies the camera of raw files from their metadata.
"""

import itertools
import os
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import CfaRecipe, camera_files, known_arrays, load_camera, parse_cfa
from l3cli.artifacts.design import Design
from l3cli.artifacts.fit import guessed_light
from l3cli.artifacts.store import load
from l3cli.calibration import figures, model
from l3cli.calibration.photo import responsivity
from l3cli.calibration.photo.estimate import MEASURED
from l3cli.calibration.photo.recipe import PhotoCamera, SensorNoise, gains_of, noise_of, without_photo
from l3cli.calibration.photo.responsivity import ColourMatrix
from l3cli.design.recipe import camera_texts
from l3cli.errors import InputFileError, RecipeError, suggestion
from l3cli.frames.frame import RawFrame
from l3cli.frames.measurement import Body, Measurements, Stated
from l3cli.frames.raw_sanity import BELOW, ArrayDoubt, PhaseDoubt, array_doubt, black_doubt, phase_doubt, share_below_black
from l3cli.io.chart_photos import bits_of
from l3cli.io.curves import shipped_statistics
from l3cli.io.known_cameras import ROLES, known_as, known_cameras, known_curves
from l3cli.io.measurements import read_photos
from l3cli.io.raw.cfa_codes import LETTERS, code_of
from l3cli.io.raw.files import BY_SUFFIX, is_photo
from l3cli.io.raw.libraw import stated
from l3cli.io.raw.unread import refuse_unread
from l3cli.options.commands import InitOptions
from l3cli.physics.mosaic import array_rows, shifted_cfa
from l3cli.recipes.builtin import (
    COMMON,
    CURVES,
    common_files,
    curves_of,
    folder_files,
    for_lights,
    for_several_lights,
    known_camera,
    known_recipes,
    summary,
)
from l3cli.simulation.lab import SMALLEST_SENSOR
from l3cli.system.console import Console
from l3cli.system.files import FilesUsed, atomic_output, blamed_on, files_to_read, refuse_protected, require_regular
from l3cli.system.outputs import OutputGuard

COLOURS = set(LETTERS.lower())  # colour letters, which need not be separated by blanks in ‹pattern›
# Nona Bayer array, which is common in smartphones
NONA = "ggg rrr/ggg rrr/ggg rrr/bbb ggg/bbb ggg/bbb ggg"
RAW_OVERRIDES = ("black_level", "white_level", "opcodes")  # options that replace values in the raw files
SINGLE_CAMERA_OPTIONS = ("phase", "pattern", "black_level", "white_level")  # options that apply to only one camera
NEW_FOLDER = "mine"  # folder name in suggested commands, as in the documentation
PHOTO_LINK = "picture"  # name of the symbolic link to the photo, because make does not support all file names
CHART_WHITE = "chart"  # value of ‹white› for l3 render if the illuminant of the chart was only estimated
MAX_CHART_PHOTOS = 4  # maximum number of photos per camera in which l3 searches for a ColorChecker
FOLDER_FILES = (*COMMON, "camera.toml", CURVES)  # files that l3 init writes into a folder
Taken = Sequence[tuple[Path, Stated]]  # raw files of one camera, each with its metadata


def start(starter: Path, folder: Path, options: InitOptions) -> FilesUsed:
    """Create a folder from a camera recipe or benchmark included with l3.

    Parameters
    ----------
    starter : Path
        Camera recipe, or folder of a benchmark.
    folder : Path
        Folder to create.
    options : InitOptions
        Options of `l3 init`.

    Returns
    -------
    FilesUsed
        The files that were read and written.

    Raises
    ------
    L3Error
        If the folder is not empty and `force` is not set, or if a file cannot be written.
    """
    origins = folder_files(starter)
    with OutputGuard(options.console) as guard:
        guard.protect(*origins.values())
        guard.guard_folder(folder, options.force, *origins)
        curves = curves_of(starter)
        contents = {name: origin.read_bytes() for name, origin in origins.items()}
        contents |= known_camera(contents) if curves else {}
        contents |= for_lights(contents) if for_several_lights(starter) else {}
        used = files_to_read({"recipes": origins.values()})
        write_folder(folder, contents)
        edits = f"put your curves into {curves.name} and your values into camera.toml, then " if curves else ""
        options.console.info(f"{folder}: {summary(starter)}; next: {edits}make -C {shlex.quote(str(folder))}")
        return used.and_wrote(*(folder / name for name in contents))


def start_recipe(recipe: Path, folder: Path, options: InitOptions) -> FilesUsed:
    """Create a folder from a camera recipe of the user.

    The folder contains copies of the recipe, its base recipe and its curve files, which refer to each other.

    Raises
    ------
    RecipeError
        If the file is not a camera recipe.
    L3Error
        If the folder is not empty and `force` is not set, or if a file cannot be written.
    """
    with OutputGuard(options.console) as guard:
        files = camera_files(recipe)
        guard.protect(*files)
        guard.guard_folder(folder, options.force, *FOLDER_FILES)
        camera = load_camera(recipe)
        names = {file: file.name if file.name not in (*COMMON, "camera.toml") else f"own_{file.name}" for file in files}
        names[recipe] = "camera.toml"
        texts = {names[file]: file.read_bytes() for file in files}
        for file, (other, name) in itertools.product(files, names.items()):
            stated = os.path.relpath(other, file.parent)  # paths in a recipe are relative to its folder
            for quote in ('"', "'") if file.suffix == ".toml" else ():
                texts[names[file]] = texts[names[file]].replace(
                    f"{quote}{stated}{quote}".encode(), f"{quote}{name}{quote}".encode()
                )
        used = _write_recipes(folder, common_files(camera.rows, camera.cols) | texts, {"recipe": files})
        options.console.info(f"{folder}: {camera.name}; next: make -C {shlex.quote(str(folder))}")
        return used


def start_named(name: str, folder: Path, options: InitOptions) -> FilesUsed:
    """Create a folder from the name of a known camera (l3cli/io/known_cameras).

    Raises
    ------
    L3Error
        If the folder is not empty and `force` is not set, or if a file cannot be written.
    """
    with OutputGuard(options.console) as guard:
        guard.guard_folder(folder, options.force, *FOLDER_FILES)
        camera = named_camera(name)
        used = _write_recipes(folder, _contents(camera), {})
        options.console.info(_camera_line(folder, camera))
        return used


def start_designed(path: Path, folder: Path, options: InitOptions) -> FilesUsed:
    """Create a folder for the camera of a design, with the CFA that has the lowest predicted error.

    Raises
    ------
    InputFileError
        If `path` is not a design.
    L3Error
        If the folder is not empty and `force` is not set, or if a file cannot be written.
    """
    with OutputGuard(options.console) as guard:
        guard.protect(path)
        guard.guard_folder(folder, options.force, *FOLDER_FILES)
        design = load(Design, path)
        camera = design.camera(*design.winner)
        texts = camera_texts(camera, f"The camera with the best CFA of the design {design.name}, by predicted error.")
        contents = common_files(camera.rows, camera.cols) | {name: text.encode() for name, text in texts.items()}
        used = _write_recipes(folder, contents, {"design": [path]})
        options.console.info(
            f"{folder}: {camera.name}, the best of {design.tried} CFAs in the design; "
            f"next: make -C {shlex.quote(str(folder))}"
        )
        return used


def _write_recipes(folder: Path, contents: Mapping[str, bytes], reads: Mapping[str, Sequence[Path]]) -> FilesUsed:
    """Write a recipe folder, then check the new camera recipe."""
    used = files_to_read(reads)
    write_folder(folder, contents)
    load_camera(folder / "camera.toml")
    return used.and_wrote(*(folder / name for name in contents))


def named_camera(name: str) -> PhotoCamera:
    """Build a known camera from measured responsivities, published sensor data and assumed values such as the f-number."""
    known, curves = known_cameras().camera[name], known_curves(name)
    return without_photo(known.body, known.levels, known.stated, curves, known_cameras().source)


def write_folder(folder: Path, contents: Mapping[str, bytes]) -> None:
    """Write files into a folder, and create the folder if it does not exist.

    Each file appears only when it is complete. Files with names ending in .sh become executable.

    Parameters
    ----------
    folder : Path
        The folder.
    contents : mapping of str to bytes
        Name and content of each file.
    """
    for name, content in contents.items():
        with atomic_output(folder / name) as temporary:
            temporary.write_bytes(content)
            temporary.chmod(0o755 if name.endswith(".sh") else 0o644)


# --------------------------------------------------------------------------------------------------- from raw files


def start_from(photos: Sequence[Path], folder: Path, options: InitOptions) -> tuple[list[Path], FilesUsed]:
    """Create a folder for the camera of the given raw files, or subfolders if the files are from several cameras.

    Each folder also contains a symbolic link to the raw file that `make` renders.

    Parameters
    ----------
    photos : sequence of Path
        Raw files, or folders of raw files. Other files in these folders are reported and skipped.
    folder : Path
        Folder to create.
    options : InitOptions
        Options of `l3 init`.

    Returns
    -------
    list of Path
        The folder of each camera.
    FilesUsed
        The raw files, and the files and links that were written.

    Raises
    ------
    RecipeError
        If an option for a single camera is set, but the files are from several cameras.
    InputFileError
        If a file is not a raw file, or if its CFA, black level or white level is unknown.
    L3Error
        If the folder cannot be written.
    """
    console = options.console
    with OutputGuard(console) as guard:
        files = [file for photo in photos for file in _raw_files(photo)]
        guard.protect(*files)
        guard.guard_folder(folder, options.force, *FOLDER_FILES, *(f"*/{name}" for name in FOLDER_FILES))
        listed = {file for photo in photos if photo.is_dir() for file in _raw_files(photo)}
        cameras = _sorted_by_camera(files, listed, console)
        if len(cameras) > 1 and (given := [name for name in SINGLE_CAMERA_OPTIONS if getattr(options, name) is not None]):
            raise RecipeError(
                f"‹{given[0]}› applies to one camera, but the raw files are from {len(cameras)} cameras; use the raw files "
                f"of one camera, or remove ‹{given[0]}›"
            )
        places = _places(folder, list(cameras))
        made = {
            places[name]: photographed(taken, options)
            for name, taken in console.progress(cameras.items(), len(cameras), "cameras")
        }
        contents = {place: _contents(camera) for place, camera in made.items()}
        links = {place / _link_name(camera): camera.photo.resolve() for place, camera in made.items() if camera.photo}
        for link in links:
            if not link.is_symlink():  # links from an earlier run may be replaced
                refuse_protected(link)
        used = files_to_read({"photos": files})
        for place, camera in made.items():
            write_folder(place, contents[place])
            load_camera(place / "camera.toml")  # raises an error if the recipe is invalid
            _link(place / _link_name(camera), links[place / _link_name(camera)])
            console.info(_camera_line(place, camera))
    written = [place / name for place, texts in contents.items() for name in texts]
    return list(made), used.and_wrote(*written, *links)


def refuse_as_table(photo: Path, inputs: Sequence[Path], output: Path) -> None:
    """Raise an error, because `l3 render` was called with a raw file instead of a table.

    The message suggests commands: the same command with the table first or, if the inputs contain no table, commands that
    train a table and render the raw files.

    Parameters
    ----------
    photo : Path
        The raw file.
    inputs : sequence of Path
        The other inputs of `l3 render`.
    output : Path
        The output of `l3 render`.

    Raises
    ------
    RecipeError
        Always, unless the file does not exist.
    InputFileError
        If the file does not exist.
    """
    require_regular(photo, "specify a table and a raw file")
    photos = list({path.resolve(): path for path in (photo, *inputs)}.values())  # list each file only once
    if table := next((each for each in inputs if each.suffix == ".h5"), None):
        others = [each for each in photos if each != table]
        raise RecipeError(
            f"{photo} is a raw file; write the table before the raw files: {_rendering(table, others, output)}"
        )
    making = f"l3 init --from {shlex.join(map(str, photos))} {NEW_FOLDER} && make -C {NEW_FOLDER} table.h5"
    rendering = _rendering(Path(NEW_FOLDER, "table.h5"), photos, output)
    raise RecipeError(
        f"{photo} is a raw file, but l3 render also needs a table; train a table for the camera, then render: "
        f"{making}; {rendering}"
    )


def _rendering(table: Path, photos: Sequence[Path], output: Path) -> str:
    return shlex.join(["l3", "render", *map(str, (table, *photos)), "-o", str(output)])


def _contents(camera: PhotoCamera) -> dict[str, bytes]:
    """Return the content of each file in a camera's folder, by file name."""
    common = common_files(camera.body.rows, camera.body.cols)
    makefile = common["Makefile"].decode()
    shown = camera.photo and _link_name(camera)
    known = " ".join(f"--{name.replace('_', '-')} {value}" for name, value in camera.overrides.items())
    for line, value in (("PHOTO ?=\n", shown), ("WHITE ?=\n", camera.white), ("RENDER ?=\n", known)):
        assert line in makefile
        makefile = makefile.replace(line, f"{line.rstrip()} {value}\n" if value else line)
    texts = {"camera.toml": camera.recipe(), CURVES: camera.curve_file(), "Makefile": makefile}
    return common | {name: text.encode() for name, text in texts.items()}


def _link(path: Path, photo: Path) -> None:
    with blamed_on(path):
        path.unlink(missing_ok=True)
        path.symlink_to(photo)


def _link_name(camera: PhotoCamera) -> str:
    """Return the name of the link to the photo that the Makefile renders."""
    assert camera.photo is not None
    suffix = camera.photo.suffix.lower()
    return f"{PHOTO_LINK}{suffix if is_photo(camera.photo) else ''}"


def _camera_line(place: Path, camera: PhotoCamera) -> str:
    """Describe a new folder in one line: camera, sources of its data, assumptions, and next command."""
    body, array = camera.body, "/".join(array_rows(camera.body.channels, camera.body.cfa, ""))
    white = f" ‹white› {camera.white}" if camera.white not in (None, CHART_WHITE) else ""
    known = "".join(f" ‹{name}› {value}" for name, value in camera.overrides.items())
    others = f"l3 render {shlex.quote(str(place / 'table.h5'))} RAW{white}{known} -o PICTURE.png"
    levels = f"{camera.black_level:g}…{camera.white_level:g} DN"
    photo = "" if camera.photo else " PHOTO=RAW"
    return (
        f"{place}: {camera.name}, {array}, {body.rows}×{body.cols} pixels, {levels}; curves {camera.origin}; "
        f"noise {camera.noise.source}; assumed: {', '.join(camera.assumed)}; next: make -C {shlex.quote(str(place))} "
        f"picture.png{photo}; to render another photo: {others}"
    )


def _raw_files(photo: Path) -> list[Path]:
    """List the raw files in a folder. If `photo` is a file, the list contains this file.

    Raises InputFileError if there are no raw files, if l3 does not read the format of the file, or if the file contains no
    metadata about the camera.
    """
    if not photo.is_dir():
        if photo.exists() and photo.suffix.lower() in BY_SUFFIX and not is_photo(photo):
            raise InputFileError(
                f"{photo} contains no metadata about the camera; use a DNG or a camera's own raw file, or start from a "
                'recipe, such as "l3 init bayer DIR"'
            )
        if photo.is_file() and not is_photo(photo):
            refuse_unread(photo)
        return [photo]
    files = sorted(path for path in photo.iterdir() if is_photo(path) and path.is_file())
    if not files:
        raise InputFileError(f"{photo} contains no raw files; use a folder with DNG, CR2, NEF, ARW or similar files")
    return files


def _sorted_by_camera(files: Sequence[Path], listed: set[Path], console: Console) -> dict[str, list[tuple[Path, Stated]]]:
    """Group raw files by camera.

    Unreadable files are reported and skipped if they were found in a folder (`listed`). For other unreadable files, or if no
    raw file remains, an InputFileError is raised.
    """
    cameras: dict[str, list[tuple[Path, Stated]]] = {}
    for path in dict.fromkeys(files):
        try:
            facts = stated(path)
        except InputFileError as error:
            if path not in listed:
                raise
            console.report(f"skipped: {error}")
            continue
        cameras.setdefault(facts.camera, []).append((path, facts))
    if not cameras:
        raise InputFileError(f"{files[0].parent} contains no raw file that l3 can read; use the camera's original raw files")
    return cameras


def _places(folder: Path, names: Sequence[str]) -> dict[str, Path]:
    """Return the folder of each camera: `folder` for a single camera, otherwise a subfolder named after the camera."""
    if len(names) == 1:
        return {names[0]: folder}
    places: dict[str, Path] = {}
    for name in names:
        plain = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") or "unknown_camera"
        while folder / plain in places.values():
            plain += "_"
        places[name] = folder / plain
    return places


# ----------------------------------------------------------------------------------- cameras from raw files


def photographed(taken: Taken, options: InitOptions) -> PhotoCamera:
    """Build a camera from raw files.

    The responsivities are fitted to a ColorChecker in one of the first MAX_CHART_PHOTOS photos. If these photos show no
    usable chart, the responsivities come from other sources (see `_without_chart`).

    Raises
    ------
    InputFileError
        If the CFA, black level or white level of the first file is unknown, if its pixels contradict its CFA, or if no
        responsivities are available.
    """
    taken = sorted(taken, key=lambda each: each[1].iso or 0.0)  # gains are relative to the lowest ISO speed
    path, known = taken[0]
    gains = gains_of(known, [each for _, each in taken])
    measured = _measurements(path, options)
    frame = measured.photos[0].frames[0]
    levels = frame.black_level, frame.white_level
    noise = noise_of(known, levels[1] - levels[0])
    # The CFA in the recipe starts at the first pixel. If the CFA in the file differs, rendering needs phase 0,0.
    phase = "0,0" if any(options.phase or ()) or options.pattern is not None else None
    given = {"phase": phase} | {name: getattr(options, name) for name in RAW_OVERRIDES}
    overrides = {name: f"{value}" for name, value in given.items() if value is not None}
    for other, facts in taken[:MAX_CHART_PHOTOS]:
        found = _by_chart(measured if other == path else _measurements(other, options), options.console)
        if found is None or found.channels != measured.body.channels:
            continue
        assert found.fit is not None
        assert found.fit.photo is not None
        fit = found.fit.photo
        light = white = fit.lights[0]
        if fit.guessed[0] and fit.likely is not None:
            light, white = f"an unknown illuminant ({guessed_light(fit.likely.of(0))})", CHART_WHITE
            options.console.warn(
                f"{other.name}: l3 has estimated the illuminant of the chart, and all colours depend on this estimate; "
                "set the illuminant with ‹light›"
            )
        origin = f"of the {fit.charts[0]} ColorChecker in {other.name}, under {light}"
        if known.noise is None:
            over = facts.iso / known.iso if facts.iso and known.iso else 1.0  # gain is proportional to the ISO speed
            noise = SensorNoise(found.gain / over, found.noise.read_noise, "as measured on the patches of the chart")
        curves = found.responsivity / found.responsivity.max()
        balance = white if len(found.channels) > 1 else None  # monochrome cameras need no white balance
        return PhotoCamera(
            other, measured.body, *levels, known, found.wavelength, curves, origin, noise, balance, gains, overrides
        )
    curves, origin = _without_chart(path, known, measured)
    return PhotoCamera(
        path, measured.body, *levels, known, curves.wavelength, curves.relative, origin, noise, gains=gains,
        overrides=overrides,
    )  # fmt: skip


def _measurements(path: Path, options: InitOptions) -> Measurements:
    """Read a raw file. Values in the options take precedence over values in the file.

    A doubtful black level causes a warning. Raises InputFileError if the frame is too small, or if the pixels contradict the
    CFA, phase or black level in the file and no option overrides it. Raises RecipeError if the black level is not below the
    white level.
    """
    try:
        answers = {name: value for name in RAW_OVERRIDES if (value := getattr(options, name)) is not None}
        measured = read_photos([path], options.light, answers).measurements
    except InputFileError as error:
        reason, other_cure, _ = str(error).partition("; write a measurement file")
        cure = '; start from a recipe instead, such as "l3 init bayer DIR"' if other_cure else ""
        raise InputFileError(reason + cure) from error
    frame, body = measured.photos[0].frames[0], measured.body
    if body.rows < SMALLEST_SENSOR[0] or body.cols < SMALLEST_SENSOR[1]:
        least = "×".join(map(str, SMALLEST_SENSOR))
        raise InputFileError(
            f"{path} has {body.rows}×{body.cols} pixels, but l3 needs at least {least}; use a raw file of the whole sensor"
        )
    if options.pattern is not None:
        channels, cfa = array_named(options.pattern)
        frame = replace(frame, neutral=neutral_by_name(frame, body, channels))
        body = replace(body, channels=channels, cfa=cfa)
    elif other := array_doubt(frame, shifted_cfa(body.cfa, options.phase or (0, 0))):
        raise InputFileError(f"{path}: {_another_array(body, other)}")
    if options.phase is None and (doubt := phase_doubt(frame, body.cfa, frame.neutral)):
        raise InputFileError(f"{path}: {_misplaced(body, doubt)}")
    white_level = frame.white_level if options.white_level is None else options.white_level
    black_level = frame.black_level if options.black_level is None else options.black_level
    if not black_level < white_level:
        raise RecipeError(
            f"‹black_level› is {black_level:g}, but must be less than the white level of {path}, {white_level:g} DN; set a "
            "lower black level"
        )
    frame = replace(frame, black_level=black_level, white_level=white_level)
    if options.black_level is None and (share := share_below_black(frame)):
        raise InputFileError(
            f"{path}: {share:.0%} of the pixels have values less than {BELOW * black_level:.0f} DN, although the file "
            f"states a black level of {black_level:g} DN; the bit depth may be different, or black may already be "
            "subtracted; set ‹black_level› and ‹white_level›"
        )
    if options.black_level is None and (black := black_doubt(frame, body.cfa)) is not None:
        options.console.warn(
            f"{path} states a black level of 0, but the darkest values of all channels are about {black:.0f} DN (white "
            f"level {frame.white_level:.0f} DN); if colours look washed out, set ‹black_level› {black:.0f}"
        )
    body = replace(body, bits=bits_of(white_level), cfa=shifted_cfa(body.cfa, options.phase or (0, 0)))
    return replace(measured, body=body, photos=(replace(measured.photos[0], frames=(frame,)),))


def array_named(text: str) -> tuple[tuple[str, ...], NDArray[np.uint8]]:
    """Parse the CFA that ‹pattern› specifies.

    Parameters
    ----------
    text : str
        Name of a camera recipe included with l3, or rows of channel names such as "rg/gb" or "r g ir g/…". Rows are
        separated by "/" and channels by blanks, which may be omitted between single colour letters.

    Returns
    -------
    tuple of str
        Names of the channels.
    ndarray, (row, col)
        Channel of each site, as an index.

    Raises
    ------
    RecipeError
        If the text is neither the name of a recipe nor the rows of a CFA.
    """
    known = known_arrays()
    if text not in known and "/" not in text:
        raise RecipeError(
            f'‹pattern› "{text}" is neither a camera recipe nor the rows of a CFA, such as rg/gb; {suggestion(text, known)}'
        )
    if text not in known:
        words = [row.lower().split() for row in text.split("/")]
        rows = [" ".join(" ".join(each) if set(each) <= COLOURS else each for each in row) for row in words]
        known = {text: CfaRecipe(list(dict.fromkeys(" ".join(rows).split())), rows)}
    return tuple(known[text].channels), parse_cfa(known[text], f'‹pattern› "{text}"')


def neutral_by_name(frame: RawFrame, body: Body, channels: Sequence[str]) -> tuple[float, ...] | None:
    """Return a grey object's signal in each of `channels`, according to a raw file's white balance.

    Returns None if the file does not contain all channels.
    """
    known = dict(zip(body.channels, frame.neutral or (), strict=False))
    return tuple(known[name] for name in channels) if set(channels) <= set(known) else None


def _another_array(body: Body, doubt: ArrayDoubt) -> str:
    """Compose the error message for pixels that contradict the stated CFA in every phase."""
    stated = "/".join(array_rows(body.channels, body.cfa, ""))
    likely = doubt.likely({name: array_named(name)[1] for name in (*known_arrays(), NONA)})
    named = " or ".join(f'"{each}"' if "/" in each else each for each in likely[:2])
    return (
        f"the file states the CFA {stated}, but pixels at sites of the same colour differ by {doubt.differ:.0%}; set "
        f"‹pattern› {named} or the rows of the actual CFA, or ‹pattern› {stated} if the file is correct"
    )


def _misplaced(body: Body, doubt: PhaseDoubt) -> str:
    """Compose the error message for pixels that match the stated CFA only in another phase."""
    phases = [(0, 0), *doubt.phases]
    patterns = ["/".join(array_rows(body.channels, shifted_cfa(body.cfa, each), "")) for each in phases]
    stated, *shown = [(f"{row},{col}", pattern) for (row, col), pattern in zip(phases, patterns, strict=True)]
    (best, pattern), others = shown[0], " or ".join(f"{phase} ({pattern})" for phase, pattern in shown[1:])
    if doubt.by_grey:
        why = f"but the mean colour of the picture fits the white balance of the file only if the CFA is {pattern}"
    else:
        least = f"and with the CFA {pattern} by only {doubt.least:.1%}"
        why = f"but with this CFA, pixels of the same channel differ by {doubt.stated:.1%}, {least}"
    other = f", or {others} if the colours are wrong" if others else ""
    return f"the file states the CFA {stated[1]}, {why}; set ‹phase› {best}{other}, or ‹phase› 0,0 if the file is correct"


def _by_chart(measured: Measurements, console: Console) -> CameraModel | None:
    """Fit a camera model to the ColorChecker in a photo, and print warnings about the fit.

    Returns None if the photo shows no usable chart, or if the fit is too poor.
    """
    try:
        camera = model.calibrate(measured)
    except InputFileError:
        return None
    wrong = figures.shortfall(camera)
    if wrong:
        console.warn(f"the chart is ignored: {wrong}")
    for doubt in figures.doubts(camera):
        console.warn(doubt)
    return None if wrong else camera


def _without_chart(path: Path, known: Stated, measured: Measurements) -> tuple[responsivity.Curves, str]:
    """Determine responsivities without a chart, and describe their source.

    The first available source is used: (1) measured curves of this camera; (2) colour matrices in the file; (3) the mean of
    the measured cameras; (4) for a single channel, bare silicon behind an infrared filter. If the raw values are already
    white-balanced according to the file, the curves from source (3) are balanced for D65.

    Raises
    ------
    InputFileError
        If no source covers the channels.
    """
    channels = measured.body.channels
    if (name := known_as(known.camera)) and sorted(channels) == sorted(ROLES):
        measured_curves = known_curves(name)
        relative = measured_curves.responsivity[[ROLES.index(channel) for channel in channels]]
        return responsivity.Curves(
            measured_curves.wavelength, relative, np.zeros_like(relative)
        ), f"of {name}, {known_cameras().source}"
    prior = responsivity.prior_of(channels, shipped_statistics())
    codes = [code_of(name) for name in channels]
    chosen = [each for each in known.matrices if set(codes) <= each.rows.keys()]
    if chosen:
        stated = [ColourMatrix(each.light, each.of(codes)) for each in chosen]
        lights = " and ".join(f"{each.light}{' (assumed)' if each.assumed else ''}" for each in chosen)
        what = "the colour matrices" if len(chosen) > 1 else "the colour matrix"
        return responsivity.curves_of_matrices(
            stated, prior
        ), f"from {what} for {lights}; a photo of a ColorChecker gives better curves"
    if prior.source == MEASURED:
        curves = responsivity.usual_curves(prior)
        origin = "assumed: the mean of 52 measured cameras, because the file states no colour matrix"
        neutral = measured.photos[0].frames[0].neutral
        if neutral is None or np.ptp(neutral) > 0:
            return curves, origin
        # Equal signals for grey mean that the raw values are already white-balanced, because no sensor responds equally in
        # all channels.
        balanced = responsivity.balanced_curves(curves, "D65")
        return balanced, f"{origin}; balanced for D65, because the values in the file are white-balanced"
    if len(channels) == 1:
        bare = load_camera(known_recipes("cameras")["mono"])
        relative = bare.responsivity / bare.responsivity.max()
        return responsivity.Curves(
            bare.wavelength, relative, np.zeros_like(relative)
        ), "assumed: silicon behind an infrared filter, because curves cannot be fitted to the photo of a monochrome camera"
    raise InputFileError(
        f"{path} shows no ColorChecker and contains no colour matrix, so the responsivities of {', '.join(channels)} are "
        'unknown; photograph a ColorChecker, or start from curves with "l3 init from_curves DIR"'
    )
