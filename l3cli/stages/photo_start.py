"""A folder to start from for each camera of some raw files: its recipe, and the pipelines from it on."""

import re
import shlex
from collections.abc import Sequence
from pathlib import Path

from l3cli.artifacts.camera_recipe import load_camera
from l3cli.errors import InputFileError
from l3cli.io.raw.registry import BY_SUFFIX, CAMERA_RAW
from l3cli.io.raw.stated import Stated, stated
from l3cli.recipes import recipe_folder
from l3cli.stages.claims import Claims
from l3cli.stages.console import Console
from l3cli.stages.photo_camera import photographed
from l3cli.stages.photo_recipe import CURVES, PhotoCamera
from l3cli.stages.plan import Made, before_work
from l3cli.stages.starting import COMMON, write_folder

RAW_SUFFIXES = (".dng", *CAMERA_RAW.suffixes)  # of files that say which camera they are of
OWN = {  # what the pipelines take for the camera: the recipe itself, instead of a virtual lab that measures it
    "Makefile": ("CAMERA ?= camera.h5", "CAMERA ?= camera.toml"),
    "Snakefile": ('config.get("camera", "snakemake/camera.h5")', 'config.get("camera", "camera.toml")'),
    "slurm.sh": ("${CAMERA:-camera.h5}", "${CAMERA:-camera.toml}"),
}


def start_from(
    photos: Sequence[Path], folder: Path, console: Console, *, light: str | None = None, force: bool = False
) -> list[Path]:
    """Write the recipe folder of the camera that took the raw files `photos`, or that lie in folders among them; of several
    cameras a folder each within `folder`. `light`: of the charts that are in the photos; None: guessed. The folders.

    InputFileError if a file is no raw file that states its array and levels, L3Error if the folder cannot be written.
    """
    names = (*COMMON, "camera.toml", CURVES)
    with Claims(console) as claims:
        files = [file for photo in photos for file in _raw_files(photo)]
        claims.spare(*files)
        claims.claim_folder(folder, force, *names, *(f"*/{name}" for name in names))
        listed = {file for photo in photos if photo.is_dir() for file in _raw_files(photo)}
        cameras = _sorted_by_camera(files, listed, console)
        places = _places(folder, list(cameras))
        made = {
            places[name]: photographed(taken, light, console)
            for name, taken in console.progress(cameras.items(), len(cameras), "cameras")
        }
        contents = {place: _contents(camera) for place, camera in made.items()}
        sizes = {place / name: len(content) for place, texts in contents.items() for name, content in texts.items()}
        before_work({"photos": files}, *(Made(path, "recipe", size) for path, size in sizes.items()))
        for place, camera in made.items():
            write_folder(place, contents[place])
            load_camera(place / "camera.toml")  # what cannot be simulated is refused now
            console.say(_told(place, camera))
    return list(made)


def _contents(camera: PhotoCamera) -> dict[str, bytes]:
    """What the folder of a camera holds, by name."""
    texts = {name: (recipe_folder() / source).read_text(encoding="utf-8") for name, source in COMMON.items()}
    for name, (usual, ours) in OWN.items():
        assert usual in texts[name]
        texts[name] = texts[name].replace(usual, ours)
    texts |= {"camera.toml": camera.recipe(), CURVES: camera.curve_file()}
    return {name: text.encode() for name, text in texts.items()}


def _told(place: Path, camera: PhotoCamera) -> str:
    """One line on a folder: the camera, what is from where, what is assumed, what comes next."""
    body, frame = camera.body, camera.frame
    pattern = "/".join("".join(body.channels[site] for site in row) for row in body.cfa)
    white = f" ‹white› {camera.light}" if camera.light else ""
    picture = f"{shlex.join(['l3', 'render', str(place / 'table.h5'), str(camera.photo)])}{white} -o picture.png"
    levels = f"{frame.black_level:g}…{frame.white_level:g} DN"
    return (
        f"{place}: {camera.name}, {pattern}, {body.rows}×{body.cols}, {levels}; curves {camera.origin}; noise "
        f"{camera.noise.source}; assumed: {', '.join(camera.assumed)}; next: make -C {shlex.quote(str(place))} && {picture}"
    )


def _raw_files(photo: Path) -> list[Path]:
    """The raw files of a folder, or the file itself."""
    if not photo.is_dir():
        if photo.exists() and photo.suffix.lower() in BY_SUFFIX and photo.suffix.lower() not in RAW_SUFFIXES:
            raise InputFileError(
                f"{photo} does not say which camera took it; give a DNG or a camera's own raw file, or start from a recipe, "
                'such as "l3 init bayer DIR"'
            )
        return [photo]
    files = sorted(path for path in photo.iterdir() if path.suffix.lower() in RAW_SUFFIXES and path.is_file())
    if not files:
        raise InputFileError(f"{photo} holds no raw files of cameras; give one with DNG, CR2, NEF, ARW… files")
    return files


def _sorted_by_camera(files: Sequence[Path], listed: set[Path], console: Console) -> dict[str, list[tuple[Path, Stated]]]:
    """The files by make and model. Those of a folder that are no raw files are left out with a line each."""
    cameras: dict[str, list[tuple[Path, Stated]]] = {}
    for path in dict.fromkeys(files):
        try:
            told = stated(path)
        except InputFileError as error:
            if path not in listed:
                raise
            console.alert(f"left out: {error}")
            continue
        cameras.setdefault(told.camera, []).append((path, told))
    if not cameras:
        raise InputFileError(f"{files[0].parent}: none of its files can be read; give raw files with the mosaic of a camera")
    return cameras


def _places(folder: Path, names: Sequence[str]) -> dict[str, Path]:
    """Where the folder of each camera is made."""
    if len(names) == 1:
        return {names[0]: folder}
    places: dict[str, Path] = {}
    for name in names:
        plain = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") or "unknown_camera"
        while folder / plain in places.values():
            plain += "_"
        places[name] = folder / plain
    return places
