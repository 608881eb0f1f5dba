"""The recipes that come with l3, by name (configs/ of a checkout or wheel), and the folders to start from, made of them."""

import itertools
import os
import re
import textwrap
import tomllib
from collections.abc import Mapping
from pathlib import Path

from l3cli.errors import InputFileError, RecipeError, suggestion

# Folders of configs/: what they hold.
KINDS = {"cameras": "camera", "lab": "lab", "scenes": "scene", "classes": "class", "designs": "design"}
# What a folder of recipes holds beside its camera.toml: name there ← name in configs/.
CURVES = "curves.csv"  # of a folder of recipes that l3 writes for a camera
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
SCENES = ("scenes.toml", "bands_scenes.toml", "unseen.toml")  # of these, the scene recipes
KNOWN = {  # what the pipelines take for the camera where its recipe is no invented truth: the recipe itself, no virtual lab
    "Makefile": ("CAMERA ?= camera.h5", "CAMERA ?= camera.toml"),
    "Snakefile": ('config.get("camera", "snakemake/camera.h5")', 'config.get("camera", "camera.toml")'),
    "slurm.sh": ("${CAMERA:-camera.h5}", "${CAMERA:-camera.toml}"),
}
# What the recipes of a folder say for several lights: a scene recipe, a class recipe.
LIGHTS = '["A", "D65"]'
ILLUMINANTS = 'illuminants = ["D65"]\n', f"illuminants = {LIGHTS}\n"
LEARNING = (
    "[learning]\n",
    f"[learning]\nlights = {LIGHTS}    # each has transforms of its own; a frame's white chooses\n",
)
# Camera recipes whose classes are not those of `default`: their class recipe, by name.
CLASSES = {"nona_bayer_hdr": "blocks", "rgbir4x4": "long_period"}


def recipe_folder() -> Path:
    """Return the folder of the recipes that come with l3: inside the installed package, or beside it in a checkout."""
    package = Path(__file__).parents[1]
    inside = package / "configs"
    return inside if inside.is_dir() else package.parent / "configs"


def known_benchmarks() -> dict[str, Path]:
    """Return the folders of recipes of a whole benchmark that come with l3, by name."""
    return {f"benchmark-{path.name}": path for path in sorted((recipe_folder() / "benchmarks").iterdir()) if path.is_dir()}


def known_recipes(kind: str) -> dict[str, Path]:
    """Return the recipes of a kind (KINDS) that come with l3, by name."""
    return {path.stem: path for path in sorted((recipe_folder() / kind).glob("*.toml"))}


def find_recipe(text: str, kind: str) -> Path:
    """Return the file that `text` names or, where there is none, the recipe of that name that comes with l3.

    RecipeError for a name that is neither's, InputFileError for a missing file that is called like such a recipe; a path to
    anything else is left to whoever opens it.
    """
    if os.path.isfile(text):
        return Path(text)
    known, path = known_recipes(kind), Path(text)
    if text in known:
        return known[text]
    if os.path.exists(text):
        return path
    if os.sep not in text and not path.suffix:
        raise RecipeError(f'there is no file and no {KINDS[kind]} recipe "{text}"; {suggestion(text, known)}')
    if path.suffix == ".toml" and path.stem in known:
        raise InputFileError(f'{text} does not exist; without a path "{path.stem}" is the recipe that comes with l3')
    return path


def starters() -> dict[str, Path]:
    """Return what a folder may be made of, by name: camera recipes, and folders of benchmarks."""
    return known_recipes("cameras") | known_benchmarks()


def slug_of(name: str) -> str:
    """Return the name of a camera as it is typed."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")


def cameras_by_name(text: str = "") -> dict[str, tuple[str, ...]]:
    """Return all names of the cameras whose curves come with l3, by the name that is typed; of those alone that have all
    words of `text` in their names, capitals or not."""
    known = tomllib.loads((recipe_folder() / "priors" / "cameras.toml").read_text(encoding="utf-8"))["camera"]
    names = {slug: (each["name"], *each.get("also", ())) for slug, each in known.items()}
    words = slug_of(text).split("_")
    return {slug: each for slug, each in names.items() if all(word in slug_of(" ".join(each)) for word in words)}


def known_camera(contents: Mapping[str, bytes]) -> dict[str, bytes]:
    """Return the pipelines among `contents` as those of a camera that its recipe describes: nothing is measured."""
    known = {}
    for name, (usual, recipe) in KNOWN.items():
        text = contents[name].decode()
        assert usual in text
        known[name] = text.replace(usual, recipe).encode()
    return known


def common_files(rows: int, cols: int) -> dict[str, bytes]:
    """Return what a folder holds beside the recipe of a camera of `rows` × `cols` pixels, whose scenes fit that sensor."""
    files = {name: (recipe_folder() / source).read_bytes() for name, source in COMMON.items()}
    files |= known_camera(files) | for_lights(files)
    return files | {name: fitting_scenes(files[name].decode(), rows, cols).encode() for name in SCENES}


def for_lights(contents: Mapping[str, bytes]) -> dict[str, bytes]:
    """Return the scene and class recipe among `contents` as they train for daylight and for lamps.

    The recipes that come with l3 name one light, so that each can be used without the other.
    """
    changed = {}
    for name, (before, after) in {"scenes.toml": ILLUMINANTS, "classes.toml": LEARNING}.items():
        text = contents[name].decode()
        assert text.count(before) == 1
        changed[name] = text.replace(before, after).encode()
    return changed


def fitting_scenes(text: str, rows: int, cols: int) -> str:
    """Return the text of a scene recipe with no scene larger than `rows` × `cols` pixels. Of random scenes that become
    smaller there are more, so that as many pixels are learned from."""

    def fitted(scene: re.Match[str]) -> str:
        height, width, count = (int(number or 0) for number in scene.groups())
        fitting = min(height, rows), min(width, cols)
        more = -(-count * height * width // (fitting[0] * fitting[1]))
        return f"size = [{fitting[0]}, {fitting[1]}]" + (f"\ncount = {more}" if count else "")

    return re.sub(r"\bsize = \[(\d+), (\d+)\](?:\ncount = (\d+))?", fitted, text)


def summary(starter: Path) -> str:
    """Return one line on a camera recipe, or that of a benchmark: the period of its array, its channels, the first sentence
    of the file's first comment."""
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
    """Return the class recipe of a camera recipe that l3 brings, by name."""
    return CLASSES.get(camera.stem, "default")


def folder_files(starter: Path) -> dict[str, Path]:
    """Return the files of the recipe folder of a camera recipe or a benchmark, by name: those it is copied from."""
    if starter.is_dir():
        return {path.name: path for path in sorted(starter.iterdir())}
    sources = COMMON | {"classes.toml": f"classes/{classes_of(starter)}.toml"}
    files = {name: recipe_folder() / source for name, source in sources.items()} | {"camera.toml": starter}
    return files | {path.name: path for path in _named(starter)}


def _base(camera: Path) -> Path | None:
    """Return the camera recipe that this one builds on, beside it."""
    named = tomllib.loads(camera.read_text(encoding="utf-8")).get("base")
    return None if named is None else camera.parent / named


def curves_of(starter: Path) -> Path | None:
    """Return the file of curves that a camera recipe names."""
    if starter.is_dir():
        return None
    named = tomllib.loads((_base(starter) or starter).read_text(encoding="utf-8"))["responsivity"].get("file")
    return None if named is None else starter.parent / named


def _named(camera: Path) -> list[Path]:
    """Return the files beside a camera recipe that it needs: its base, its curves."""
    return [path for path in (_base(camera), curves_of(camera)) if path is not None]
