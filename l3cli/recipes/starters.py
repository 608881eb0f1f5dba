"""Folders to start from: the recipes of one kind of camera with the pipelines from them on, or a benchmark."""

import itertools
import re
import textwrap
import tomllib
from collections.abc import Mapping
from pathlib import Path

from l3cli.recipes.builtin import known_benchmarks, known_recipes, recipe_folder

# What a folder of recipes holds beside its camera.toml: name there ← name in configs/.
COMMON = {
    "lab.toml": "lab/default.toml",
    "scenes.toml": "scenes/default.toml",
    "bands_scenes.toml": "scenes/bands.toml",
    "unseen.toml": "scenes/demo_unseen.toml",
    "classes.toml": "classes/default.toml",
    "bands_classes.toml": "classes/bands.toml",
    "Makefile": "pipelines/Makefile",
    "Snakefile": "pipelines/Snakefile",
    "slurm.sh": "pipelines/slurm.sh",
}
KNOWN = {  # what the pipelines take for the camera where its recipe is no invented truth: the recipe itself, no virtual lab
    "Makefile": ("CAMERA ?= camera.h5", "CAMERA ?= camera.toml"),
    "Snakefile": ('config.get("camera", "snakemake/camera.h5")', 'config.get("camera", "camera.toml")'),
    "slurm.sh": ("${CAMERA:-camera.h5}", "${CAMERA:-camera.toml}"),
}
# Camera recipes whose classes are not those of `default`: their class recipe, by name.
CLASSES = {"nona_bayer_hdr": "blocks", "rgbir4x4": "long_period"}


def starters() -> dict[str, Path]:
    """Return what a folder may be made of, by name: camera recipes, and folders of benchmarks."""
    return known_recipes("cameras") | known_benchmarks()


def known_camera(contents: Mapping[str, bytes]) -> dict[str, bytes]:
    """Return the pipelines among `contents` as those of a camera that its recipe describes: nothing is measured."""
    known = {}
    for name, (usual, recipe) in KNOWN.items():
        text = contents[name].decode()
        assert usual in text
        known[name] = text.replace(usual, recipe).encode()
    return known


def summary(starter: Path) -> str:
    """One line on a camera recipe, or that of a benchmark: the period of its array, its channels, the first sentence of the
    file's first comment."""
    camera = starter / "camera.toml" if starter.is_dir() else starter
    text = camera.read_text(encoding="utf-8")
    cfa = tomllib.loads((_base(camera) or camera).read_text(encoding="utf-8"))["cfa"]
    comment = " ".join(
        line.lstrip("# ") for line in itertools.takewhile(lambda line: line.startswith("#"), text.splitlines())
    )
    sentence = textwrap.shorten(re.split(r"[:;] |[.] (?=[A-Z])", comment)[0].rstrip("."), 84, placeholder=" …")
    period = f"{len(cfa['pattern'])}×{len(cfa['pattern'][0].split())}"
    return f"{period}, {len(cfa['channels']):2} channels  {sentence}"


def classes_of(camera: Path) -> str:
    """The class recipe of a camera recipe that l3 brings, by name."""
    return CLASSES.get(camera.stem, "default")


def folder_files(starter: Path) -> dict[str, Path]:
    """Return the files of the recipe folder of a camera recipe or a benchmark, by name: those it is copied from."""
    if starter.is_dir():
        return {path.name: path for path in sorted(starter.iterdir())}
    sources = COMMON | {"classes.toml": f"classes/{classes_of(starter)}.toml"}
    files = {name: recipe_folder() / source for name, source in sources.items()} | {"camera.toml": starter}
    return files | {path.name: path for path in _named(starter)}


def _base(camera: Path) -> Path | None:
    """The camera recipe that this one builds on, beside it."""
    named = tomllib.loads(camera.read_text(encoding="utf-8")).get("base")
    return None if named is None else camera.parent / named


def curves_of(starter: Path) -> Path | None:
    """The file of curves that a camera recipe names."""
    if starter.is_dir():
        return None
    named = tomllib.loads((_base(starter) or starter).read_text(encoding="utf-8"))["responsivity"].get("file")
    return None if named is None else starter.parent / named


def _named(camera: Path) -> list[Path]:
    """The files beside a camera recipe that it needs: its base, its curves."""
    return [path for path in (_base(camera), curves_of(camera)) if path is not None]
