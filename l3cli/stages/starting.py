"""The stage of `l3 init`, which writes a folder with recipes and a pipeline.

It starts from a recipe that comes with l3, a recipe or design of the user, the name of a known camera, or raw files, whose
cameras it identifies.
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
from l3cli.options.commands import InitOptions
from l3cli.physics.mosaic import array_rows, shifted_cfa
from l3cli.recipes.builtin import (
    COMMON,
    CURVES,
    common_files,
    curves_of,
    folder_files,
    for_lights,
    known_camera,
    known_recipes,
    summary,
)
from l3cli.simulation.lab import SMALLEST_SENSOR
from l3cli.system.console import Console
from l3cli.system.files import FilesUsed, atomic_output, blamed_on, files_to_read, refuse_protected, require_regular
from l3cli.system.outputs import OutputGuard

COLOURS = set(LETTERS.lower())  # letters that need no blanks between them in ‹pattern›
NONA = "ggg rrr/ggg rrr/ggg rrr/bbb ggg/bbb ggg/bbb ggg"  # nona Bayer, common in telephones, which has no recipe in l3
ANSWERS = ("black_level", "white_level", "opcodes")  # options that replace what raw files state
OF_ONE = ("phase", "pattern", "black_level", "white_level")  # options that are valid for one camera only
NEW_FOLDER = "mine"  # name of the folder in suggested commands and in the documentation
SHOWN = "picture"  # name of a link to the photo, because make cannot handle every file name
CHART_WHITE = "chart"  # ‹white› of l3 render if the illuminant of the chart is only estimated
SEARCHED = 4  # photos per camera that are searched for a ColorChecker
WRITTEN = (*COMMON, "camera.toml", CURVES)  # files written to a folder
Taken = Sequence[tuple[Path, Stated]]  # raw files of one camera, with the metadata of each


def start(starter: Path, folder: Path, options: InitOptions) -> FilesUsed:
    """Write the folder of a recipe or benchmark that comes with l3.

    Each file appears only when it is complete.

    Parameters
    ----------
    starter : Path
        Camera recipe, or folder of a benchmark.
    folder : Path
        Folder to write.
    options : InitOptions
        Options of `l3 init`.

    Raises
    ------
    L3Error
        If the folder is not empty and `force` is not set, or if it cannot be written.
    """
    origins = folder_files(starter)
    with OutputGuard(options.console) as guard:
        guard.protect(*origins.values())
        guard.guard_folder(folder, options.force, *origins)
        curves = curves_of(starter)
        contents = {name: origin.read_bytes() for name, origin in origins.items()}
        contents |= known_camera(contents) if curves else {}
        contents |= {} if starter.is_dir() else for_lights(contents)
        used = files_to_read({"recipes": origins.values()})
        write_folder(folder, contents)
        edits = f"put your curves into {curves.name} and your values into camera.toml, then " if curves else ""
        options.console.info(f"{folder}: {summary(starter)}; next: {edits}make -C {shlex.quote(str(folder))}")
        return used.and_wrote(*(folder / name for name in contents))


def start_recipe(recipe: Path, folder: Path, options: InitOptions) -> FilesUsed:
    """Write the folder of a user's own camera recipe, with its base recipe and its curves.

    Raises
    ------
    RecipeError
        If the file is not a camera recipe.
    L3Error
        As `start`.
    """
    with OutputGuard(options.console) as guard:
        files = camera_files(recipe)
        guard.protect(*files)
        guard.guard_folder(folder, options.force, *WRITTEN)
        camera = load_camera(recipe)
        names = {file: file.name if file.name not in (*COMMON, "camera.toml") else f"own_{file.name}" for file in files}
        names[recipe] = "camera.toml"
        texts = {names[file]: file.read_bytes() for file in files}
        for file, (other, name) in itertools.product(files, names.items()):
            stated = os.path.relpath(other, file.parent)  # recipes name files relative to themselves
            for quote in ('"', "'") if file.suffix == ".toml" else ():
                texts[names[file]] = texts[names[file]].replace(
                    f"{quote}{stated}{quote}".encode(), f"{quote}{name}{quote}".encode()
                )
        used = _write_recipes(folder, common_files(camera.rows, camera.cols) | texts, {"recipe": files})
        options.console.info(f"{folder}: {camera.name}; next: make -C {shlex.quote(str(folder))}")
        return used


def start_named(name: str, folder: Path, options: InitOptions) -> FilesUsed:
    """Write the folder of a camera that l3 knows by name (l3cli/io/known_cameras). Raise L3Error as `start` does."""
    with OutputGuard(options.console) as guard:
        guard.guard_folder(folder, options.force, *WRITTEN)
        camera = named_camera(name)
        used = _write_recipes(folder, _contents(camera), {})
        options.console.info(_camera_line(folder, camera))
        return used


def start_designed(path: Path, folder: Path, options: InitOptions) -> FilesUsed:
    """Write the folder of a camera with the best CFA of a design.

    Raises
    ------
    InputFileError
        If the file is not a design.
    L3Error
        As `start`.
    """
    with OutputGuard(options.console) as guard:
        guard.protect(path)
        guard.guard_folder(folder, options.force, *WRITTEN)
        design = load(Design, path)
        camera = design.camera(*design.winner)
        texts = camera_texts(camera, f"The camera with the best CFA of the design {design.name}, by predicted error.")
        contents = common_files(camera.rows, camera.cols) | {name: text.encode() for name, text in texts.items()}
        used = _write_recipes(folder, contents, {"design": [path]})
        options.console.info(
            f"{folder}: {camera.name}, the best of {design.tried} CFAs; next: make -C {shlex.quote(str(folder))}"
        )
        return used


def _write_recipes(folder: Path, contents: Mapping[str, bytes], reads: Mapping[str, Sequence[Path]]) -> FilesUsed:
    """Write a recipe folder, and refuse a camera that cannot be simulated."""
    used = files_to_read(reads)
    write_folder(folder, contents)
    load_camera(folder / "camera.toml")
    return used.and_wrote(*(folder / name for name in contents))


def named_camera(name: str) -> PhotoCamera:
    """Return a known camera: measured curves, published facts, and assumptions for the rest."""
    known, curves = known_cameras().camera[name], known_curves(name)
    return without_photo(known.body, known.levels, known.stated, curves, known_cameras().source)


def write_folder(folder: Path, contents: Mapping[str, bytes]) -> None:
    """Create a folder and write files into it. Each file appears only when it is complete. Scripts are executable."""
    for name, content in contents.items():
        with atomic_output(folder / name) as temporary:
            temporary.write_bytes(content)
            temporary.chmod(0o755 if name.endswith(".sh") else 0o644)


# --------------------------------------------------------------------------------------------------- from raw files


def start_from(photos: Sequence[Path], folder: Path, options: InitOptions) -> tuple[list[Path], FilesUsed]:
    """Write the recipe folder of the camera that took some raw files.

    Parameters
    ----------
    photos : sequence of Path
        Raw files, or folders of raw files. If several cameras took them, each camera gets a folder in `folder`.
    folder : Path
        Folder to write.
    options : InitOptions
        Options of `l3 init`.

    Returns
    -------
    list of Path
        The folders that were written.
    FilesUsed
        The raw files, and the files and links that were written.

    Raises
    ------
    InputFileError
        If a file is not a raw file, or if it does not state its CFA and levels.
    L3Error
        If the folder cannot be written.
    """
    console = options.console
    with OutputGuard(console) as guard:
        files = [file for photo in photos for file in _raw_files(photo)]
        guard.protect(*files)
        guard.guard_folder(folder, options.force, *WRITTEN, *(f"*/{name}" for name in WRITTEN))
        listed = {file for photo in photos if photo.is_dir() for file in _raw_files(photo)}
        cameras = _sorted_by_camera(files, listed, console)
        if len(cameras) > 1 and (given := [name for name in OF_ONE if getattr(options, name) is not None]):
            raise RecipeError(f"‹{given[0]}› is for one camera; give the raw files of one camera only")
        places = _places(folder, list(cameras))
        made = {
            places[name]: photographed(taken, options)
            for name, taken in console.progress(cameras.items(), len(cameras), "cameras")
        }
        contents = {place: _contents(camera) for place, camera in made.items()}
        links = {place / _shown(camera): camera.photo.resolve() for place, camera in made.items() if camera.photo}
        for link in links:
            if not link.is_symlink():  # a link from an earlier call points to the photo, and may be replaced
                refuse_protected(link)
        used = files_to_read({"photos": files})
        for place, camera in made.items():
            write_folder(place, contents[place])
            load_camera(place / "camera.toml")  # refuses a camera that cannot be simulated
            _link(place / _shown(camera), links[place / _shown(camera)])
            console.info(_camera_line(place, camera))
    written = [place / name for place, texts in contents.items() for name in texts]
    return list(made), used.and_wrote(*written, *links)


def refuse_as_table(photo: Path, inputs: Sequence[Path], output: Path) -> None:
    """Raise an error because a raw file was given where `l3 render` expects a table.

    Raises
    ------
    RecipeError
        The message shows the commands that lead from the raw file to a picture.
    InputFileError
        If the file does not exist.
    """
    require_regular(photo, "give a table and a raw file")
    if table := next((each for each in inputs if each.suffix == ".h5"), None):
        others = [photo, *(each for each in inputs if each != table)]
        raise RecipeError(f"{photo} is a raw file; the table comes first: {_rendering(table, others, output)}")
    photos = [photo, *inputs]
    making = f"l3 init --from {shlex.join(map(str, photos))} {NEW_FOLDER} && make -C {NEW_FOLDER} table.h5"
    rendering = _rendering(Path(NEW_FOLDER, "table.h5"), photos, output)
    raise RecipeError(
        f"{photo} is a raw file, and no table is given; make a table for its camera, then render: {making}; {rendering}"
    )


def _rendering(table: Path, photos: Sequence[Path], output: Path) -> str:
    """Return the command that renders raw files."""
    return shlex.join(["l3", "render", *map(str, (table, *photos)), "-o", str(output)])


def _contents(camera: PhotoCamera) -> dict[str, bytes]:
    """Return the files of a camera's folder, by name."""
    common = common_files(camera.body.rows, camera.body.cols)
    makefile = common["Makefile"].decode()
    shown = camera.photo and _shown(camera)
    known = " ".join(f"--{name.replace('_', '-')} {value}" for name, value in camera.overrides.items())
    for line, value in (("PHOTO ?=\n", shown), ("WHITE ?=\n", camera.white), ("RENDER ?=\n", known)):
        assert line in makefile
        makefile = makefile.replace(line, f"{line.rstrip()} {value}\n" if value else line)
    texts = {"camera.toml": camera.recipe(), CURVES: camera.curve_file(), "Makefile": makefile}
    return common | {name: text.encode() for name, text in texts.items()}


def _link(path: Path, photo: Path) -> None:
    """Replace `path` by a symbolic link to the photo."""
    with blamed_on(path):
        path.unlink(missing_ok=True)
        path.symlink_to(photo)


def _shown(camera: PhotoCamera) -> str:
    """Return the name of the link to the photo that picture.png shows."""
    assert camera.photo is not None
    suffix = camera.photo.suffix.lower()
    return f"{SHOWN}{suffix if is_photo(camera.photo) else ''}"


def _camera_line(place: Path, camera: PhotoCamera) -> str:
    """Return a message about a new folder: its camera, the origin of the data, the assumptions, and the next command."""
    body, array = camera.body, "/".join(array_rows(camera.body.channels, camera.body.cfa, ""))
    white = f" ‹white› {camera.white}" if camera.white not in (None, CHART_WHITE) else ""
    known = "".join(f" ‹{name}› {value}" for name, value in camera.overrides.items())
    others = f"l3 render {shlex.quote(str(place / 'table.h5'))} RAW{white}{known} -o PICTURE.png"
    levels = f"{camera.black_level:g}…{camera.white_level:g} DN"
    photo = "" if camera.photo else " PHOTO=RAW"
    return (
        f"{place}: {camera.name}, {array}, {body.rows}×{body.cols}, {levels}; curves {camera.origin}; "
        f"noise {camera.noise.source}; assumed: {', '.join(camera.assumed)}; next: make -C {shlex.quote(str(place))} "
        f"picture.png{photo}; another photo: {others}"
    )


def _raw_files(photo: Path) -> list[Path]:
    """Return the raw files of a folder, or the file itself."""
    if not photo.is_dir():
        if photo.exists() and photo.suffix.lower() in BY_SUFFIX and not is_photo(photo):
            raise InputFileError(
                f"{photo} does not say which camera took it; give a DNG or a camera's own raw file, or start from a recipe, "
                'such as "l3 init bayer DIR"'
            )
        return [photo]
    files = sorted(path for path in photo.iterdir() if is_photo(path) and path.is_file())
    if not files:
        raise InputFileError(f"{photo} contains no raw files; give a folder with DNG, CR2, NEF, ARW… files")
    return files


def _sorted_by_camera(files: Sequence[Path], listed: set[Path], console: Console) -> dict[str, list[tuple[Path, Stated]]]:
    """Group the files by camera. Files of a folder that are not raw files are skipped, with a message for each."""
    cameras: dict[str, list[tuple[Path, Stated]]] = {}
    for path in dict.fromkeys(files):
        try:
            facts = stated(path)
        except InputFileError as error:
            if path not in listed:
                raise
            console.report(f"left out: {error}")
            continue
        cameras.setdefault(facts.camera, []).append((path, facts))
    if not cameras:
        raise InputFileError(
            f"{files[0].parent}: no file is a readable raw file; give raw files with the mosaic of a camera"
        )
    return cameras


def _places(folder: Path, names: Sequence[str]) -> dict[str, Path]:
    """Return the folder of each camera."""
    if len(names) == 1:
        return {names[0]: folder}
    places: dict[str, Path] = {}
    for name in names:
        plain = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") or "unknown_camera"
        while folder / plain in places.values():
            plain += "_"
        places[name] = folder / plain
    return places


# ----------------------------------------------------------------------------- a camera as its raw files show it


def photographed(taken: Taken, options: InitOptions) -> PhotoCamera:
    """Return the camera that took some raw files.

    Its curves come from a ColorChecker in one of the first files, otherwise from measured curves, colour matrices or the
    mean of measured cameras.

    Raises
    ------
    InputFileError
        If the first file does not state its CFA and levels, if its pixels contradict the CFA, or if the responsivities
        cannot be determined.
    """
    taken = sorted(taken, key=lambda each: each[1].iso or 0.0)  # gains are relative to the lowest ISO speed
    path, known = taken[0]
    gains = gains_of(known, [each for _, each in taken])
    measured = _measurements(path, options)
    frame = measured.photos[0].frames[0]
    levels = frame.black_level, frame.white_level
    noise = noise_of(known, levels[1] - levels[0])
    # The CFA of the recipe starts at the first pixel, so rendering needs phase 0,0 if the file states another CFA.
    phase = "0,0" if any(options.phase or ()) or options.pattern is not None else None
    given = {"phase": phase} | {name: getattr(options, name) for name in ANSWERS}
    overrides = {name: f"{value}" for name, value in given.items() if value is not None}
    for other, facts in taken[:SEARCHED]:
        found = _by_chart(measured if other == path else _measurements(other, options), options.console)
        if found is None or found.channels != measured.body.channels:
            continue
        assert found.fit is not None
        assert found.fit.photo is not None
        fit = found.fit.photo
        light = white = fit.lights[0]
        if fit.guessed[0] and fit.likely is not None:
            light, white = f"a light that is {guessed_light(fit.likely.of(0))}", CHART_WHITE
            options.console.warn(
                f"{other.name}: the illuminant of the chart was estimated, and all colours depend on it; give ‹light›"
            )
        origin = f"of the {fit.charts[0]} ColorChecker in {other.name}, under {light}"
        if known.noise is None:
            over = facts.iso / known.iso if facts.iso and known.iso else 1.0  # gain is proportional to the ISO speed
            noise = SensorNoise(found.gain / over, found.noise.read_noise, "as measured on the patches of the chart")
        curves = found.responsivity / found.responsivity.max()
        balance = white if len(found.channels) > 1 else None  # pictures of one channel are grey
        return PhotoCamera(
            other, measured.body, *levels, known, found.wavelength, curves, origin, noise, balance, gains, overrides
        )
    curves, origin = _without_chart(path, known, measured)
    return PhotoCamera(
        path, measured.body, *levels, known, curves.wavelength, curves.relative, origin, noise, gains=gains,
        overrides=overrides,
    )  # fmt: skip


def _measurements(path: Path, options: InitOptions) -> Measurements:
    """Read a raw file, with the CFA and black level of the options if given.

    A doubtful black level leads to a warning. If the pixels contradict the stated CFA and no option settles the doubt,
    InputFileError is raised.
    """
    try:
        answers = {name: value for name in ANSWERS if (value := getattr(options, name)) is not None}
        measured = read_photos([path], options.light, answers).measurements
    except InputFileError as error:
        reason, other_cure, _ = str(error).partition("; write a measurement file")
        cure = '; start from a recipe instead, such as "l3 init bayer DIR"' if other_cure else ""
        raise InputFileError(reason + cure) from error
    frame, body = measured.photos[0].frames[0], measured.body
    if body.rows < SMALLEST_SENSOR[0] or body.cols < SMALLEST_SENSOR[1]:
        least = "×".join(map(str, SMALLEST_SENSOR))
        raise InputFileError(
            f"{path} has {body.rows}×{body.cols} pixels, but at least {least} are needed; give a file of the whole sensor"
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
            f"‹black_level› {black_level:g} is not below the white level of {path}, {white_level:g} DN; give a lower one"
        )
    frame = replace(frame, black_level=black_level, white_level=white_level)
    if options.black_level is None and (share := share_below_black(frame)):
        raise InputFileError(
            f"{path}: {share:.0%} of the pixels are below {BELOW * black_level:.0f} DN, but it states a black level of "
            f"{black_level:g} DN; the values have another bit depth, or black has been subtracted: give ‹black_level› "
            "and ‹white_level›"
        )
    if options.black_level is None and (black := black_doubt(frame, body.cfa)) is not None:
        options.console.warn(
            f"{path} states a black level of 0, but the darkest values of all channels are about {black:.0f} of "
            f"{frame.white_level:.0f} DN; if colours look washed out, give ‹black_level› {black:.0f}"
        )
    body = replace(body, bits=bits_of(white_level), cfa=shifted_cfa(body.cfa, options.phase or (0, 0)))
    return replace(measured, body=body, photos=(replace(measured.photos[0], frames=(frame,)),))


def array_named(text: str) -> tuple[tuple[str, ...], NDArray[np.uint8]]:
    """Return the channels and the CFA (row, col) that ‹pattern› names.

    Parameters
    ----------
    text : str
        Name of a camera recipe that comes with l3, or rows divided by "/". A row names channels divided by blanks; letters
        of colours may stand together: "rg/gb", "r g ir g/…".

    Raises
    ------
    RecipeError
        If the text is neither, or if its rows do not form a CFA.
    """
    known = known_arrays()
    if text not in known and "/" not in text:
        raise RecipeError(f'‹pattern› "{text}" is neither a camera recipe nor rows such as rg/gb; {suggestion(text, known)}')
    if text not in known:
        words = [row.lower().split() for row in text.split("/")]
        rows = [" ".join(" ".join(each) if set(each) <= COLOURS else each for each in row) for row in words]
        known = {text: CfaRecipe(list(dict.fromkeys(" ".join(rows).split())), rows)}
    return tuple(known[text].channels), parse_cfa(known[text], f'‹pattern› "{text}"')


def neutral_by_name(frame: RawFrame, body: Body, channels: Sequence[str]) -> tuple[float, ...] | None:
    """Return the raw file's signals of a grey for `channels`, matched by name, or None if one is unknown."""
    known = dict(zip(body.channels, frame.neutral or (), strict=False))
    return tuple(known[name] for name in channels) if set(channels) <= set(known) else None


def _another_array(body: Body, doubt: ArrayDoubt) -> str:
    """Return the message that the pixels fit the stated CFA in no phase, and which option helps."""
    stated = "/".join(array_rows(body.channels, body.cfa, ""))
    likely = doubt.likely({name: array_named(name)[1] for name in (*known_arrays(), NONA)})
    named = " or ".join(f'"{each}"' if "/" in each else each for each in likely[:2])
    return (
        f"it states the CFA {stated}, but its pixels show another: sites of one colour differ by {doubt.differ:.0%}; give "
        f"‹pattern› {named} or its rows, or ‹pattern› {stated} if that is right"
    )


def _misplaced(body: Body, doubt: PhaseDoubt) -> str:
    """Return the message that the CFA seems to start at another site, and which option helps."""
    phases = [(0, 0), *doubt.phases]
    patterns = ["/".join(array_rows(body.channels, shifted_cfa(body.cfa, each), "")) for each in phases]
    stated, *shown = [(f"{row},{col}", pattern) for (row, col), pattern in zip(phases, patterns, strict=True)]
    (best, pattern), others = shown[0], " or ".join(f"{phase} ({pattern})" for phase, pattern in shown[1:])
    if doubt.by_grey:
        why = f"but its mean is far from the grey that it states, and close to it as {pattern}, unless that white is wrong"
    else:
        least = f"as {pattern} only by {doubt.least:.1%}"
        why = f"but its pixels show {pattern}: sites of one channel differ by {doubt.stated:.1%}, {least}"
    other = f", {others} if that gives true colours" if others else ""
    return f"it states {stated[1]}, {why}; give ‹phase› {best}{other}, or 0,0 if the file is right"


def _by_chart(measured: Measurements, console: Console) -> CameraModel | None:
    """Return the camera model from the ColorChecker in a photo, or None if there is no chart or the fit fails its checks."""
    try:
        camera = model.calibrate(measured)
    except InputFileError:
        return None
    wrong = figures.shortfall(camera)
    if wrong:
        console.warn(f"chart ignored: {wrong}")
    for doubt in figures.doubts(camera):
        console.warn(doubt)
    return None if wrong else camera


def _without_chart(path: Path, known: Stated, measured: Measurements) -> tuple[responsivity.Curves, str]:
    """Return the responsivities from the first available source, and a text that names the source.

    The sources are the measured curves of this camera, the file's colour matrices, and the mean of measured cameras.
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
        ), f"from {what} for {lights}; a photo of a ColorChecker gives better ones"
    if prior.source == MEASURED:
        curves = responsivity.usual_curves(prior)
        origin = "assumed: the mean of 52 measured cameras, because the file states no colour matrix"
        neutral = measured.photos[0].frames[0].neutral
        if neutral is None or np.ptp(neutral) > 0:
            return curves, origin
        # No sensor responds to a grey with equal signals, so the values have been white-balanced already.
        balanced = responsivity.balanced_curves(curves, "D65")
        return balanced, f"{origin}; balanced for D65, as the file's values are for its white"
    if len(channels) == 1:
        bare = load_camera(known_recipes("cameras")["mono"])
        relative = bare.responsivity / bare.responsivity.max()
        return responsivity.Curves(
            bare.wavelength, relative, np.zeros_like(relative)
        ), "assumed: silicon behind an infrared filter, because a camera without filters shows no colours to fit"
    raise InputFileError(
        f"{path} shows no chart and states no colour matrix, so the responsivities of {', '.join(channels)} are unknown; "
        'photograph a ColorChecker, or start from curves, "l3 init from_curves DIR"'
    )
