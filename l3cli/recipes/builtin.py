"""Find the built-in recipes in configs/, and list the files that `l3 init` writes into a new folder."""

import itertools
import os
import re
import textwrap
import tomllib
from collections.abc import Mapping
from pathlib import Path

from l3cli.errors import InputFileError, RecipeError, suggestion
from l3cli.system.text import counted

# Subfolder of configs/ → name of its recipes in messages.
KIND_OF_FOLDER = {"cameras": "camera", "lab": "lab", "scenes": "scene", "classes": "class", "designs": "design"}
CURVES = "curves.csv"  # file in a new folder that contains the camera's responsivities
# Files in a new folder, in addition to camera.toml: name in the new folder → path in configs/.
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
SCENES = ("scenes.toml", "bands_scenes.toml", "unseen.toml")  # the scene recipes in COMMON
# Pipeline file → (text, replacement) for real cameras. The replacement makes the pipeline start from the camera recipe.
# Without it, the pipeline calibrates a camera model in the virtual lab.
KNOWN = {
    "Makefile": ("CAMERA ?= camera.h5", "CAMERA ?= camera.toml"),
    "Snakefile": ('config.get("camera", "snakemake/camera.h5")', 'config.get("camera", "camera.toml")'),
    "slurm.sh": ("${CAMERA:-camera.h5}", "${CAMERA:-camera.toml}"),
}
# Illuminants of recipes for several illuminants. ILLUMINANTS and LEARNING are pairs (text, replacement), which insert these
# illuminants into the scene recipe and the class recipe.
LIGHTS = '["A", "D65"]'
ILLUMINANTS = 'illuminants = ["D65"]\n', f"illuminants = {LIGHTS}\n"
LEARNING = (
    "[learning]\n",
    f"[learning]\nlights = {LIGHTS}    # trains transforms for each illuminant; the white of a frame selects them\n",
)
# Cameras with their own scene recipes: configs/scenes/NAME.toml for training and NAME_unseen.toml for evaluation.
POLARISED = ("polarised", "polarised_colour")
# Camera recipe → class recipe, for all cameras that do not use the class recipe `default`.
CLASSES = {
    "nona_bayer_hdr": "blocks",
    "polarised": "polarised",
    "polarised_colour": "polarised",
    "rccb": "clear",
    "rgbir4x4": "long_period",
}


def recipe_folder() -> Path:
    """Return the folder configs/, which is inside an installed package, or next to the package in the repository."""
    package = Path(__file__).parents[1]
    inside = package / "configs"
    return inside if inside.is_dir() else package.parent / "configs"


def known_benchmarks() -> dict[str, Path]:
    """Return the folders of the built-in benchmarks, by names such as "benchmark-bayer"."""
    return {f"benchmark-{path.name}": path for path in sorted((recipe_folder() / "benchmarks").iterdir()) if path.is_dir()}


def known_recipes(kind: str) -> dict[str, Path]:
    """Return the built-in recipes of one type, as a mapping from recipe name to file.

    `kind` is the type: a subfolder of configs/, such as "cameras". The result is empty if the subfolder does not exist.
    """
    return {path.stem: path for path in sorted((recipe_folder() / kind).glob("*.toml"))}


def find_recipe(text: str, kind: str) -> Path:
    """Find the file of a recipe that the user specified by path or by name.

    Parameters
    ----------
    text : str
        Path of a recipe file, or name of a built-in recipe. An existing file has precedence over a built-in recipe of the
        same name.
    kind : str
        Type of the recipe: a key of KIND_OF_FOLDER, the name of a subfolder of configs/.

    Returns
    -------
    Path
        Path of the recipe. The file may be missing; the caller reports this.

    Raises
    ------
    RecipeError
        If `text` is a name without a suffix, but neither a file nor a built-in recipe has this name.
    InputFileError
        If `text` is the path of a missing .toml file, and a built-in recipe has this name.
    """
    if os.path.isfile(text):
        return Path(text)
    known, path = known_recipes(kind), Path(text)
    if text in known:
        return known[text]
    if os.path.exists(text):
        return path
    if os.sep not in text and not path.suffix:
        raise RecipeError(f'no file or {KIND_OF_FOLDER[kind]} recipe "{text}" exists; {suggestion(text, known)}')
    if path.suffix == ".toml" and path.stem in known:
        raise InputFileError(f'{text} does not exist; write "{path.stem}" to use the built-in recipe')
    return path


def starters() -> dict[str, Path]:
    """Return the camera recipes and benchmark folders from which `l3 init` can create a folder, by name."""
    return known_recipes("cameras") | known_benchmarks()


def slug_of(name: str) -> str:
    """Convert a camera name to the form used on the command line, such as "Nikon D80" to "nikon_d80"."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")


def cameras_by_name(text: str = "") -> dict[str, tuple[str, ...]]:
    """Find cameras for which l3 includes measured responsivities.

    Parameters
    ----------
    text : str
        Words that must all occur in a camera's names, in upper or lower case. [default: find all cameras]

    Returns
    -------
    dict of str to tuple of str
        For each camera, its command-line name and all of its other names.
    """
    known = tomllib.loads((recipe_folder() / "priors" / "cameras.toml").read_text(encoding="utf-8"))["camera"]
    names = {slug: (each["name"], *each.get("also", ())) for slug, each in known.items()}
    words = slug_of(text).split("_")
    return {slug: each for slug, each in names.items() if all(word in slug_of(" ".join(each)) for word in words)}


def known_camera(contents: Mapping[str, bytes]) -> dict[str, bytes]:
    """Return the pipeline files from `contents`, adapted to a real camera (see KNOWN)."""
    known = {}
    for name, (usual, recipe) in KNOWN.items():
        text = contents[name].decode()
        assert usual in text
        known[name] = text.replace(usual, recipe).encode()
    return known


def common_files(rows: int, cols: int) -> dict[str, bytes]:
    """Return the contents of all files that `l3 init` writes for a real camera, except the camera recipe, by file name.

    Scenes are limited to `rows` × `cols` pixels, the size of the sensor.
    """
    files = {name: (recipe_folder() / source).read_bytes() for name, source in COMMON.items()}
    files |= known_camera(files) | for_lights(files)
    return files | {name: fitting_scenes(files[name].decode(), rows, cols).encode() for name in SCENES}


def for_several_lights(starter: Path) -> bool:
    """Whether the recipes that `l3 init` writes from `starter` train a table for several illuminants.

    `starter` is a camera recipe, or the folder of a benchmark. The result is False for benchmarks, because their own recipes
    specify the illuminants. It is also False for polarisation cameras, because a table with Stokes outputs supports only one
    illuminant.
    """
    return not starter.is_dir() and starter.stem not in POLARISED


def for_lights(contents: Mapping[str, bytes]) -> dict[str, bytes]:
    """Return the scene recipe and the class recipe from `contents`, changed to train for the illuminants A and D65.

    The recipes in configs/ use only one illuminant, so that any scene recipe can be combined with any class recipe.
    """
    changed = {}
    for name, (before, after) in {"scenes.toml": ILLUMINANTS, "classes.toml": LEARNING}.items():
        text = contents[name].decode()
        assert text.count(before) == 1
        changed[name] = text.replace(before, after).encode()
    return changed


def fitting_scenes(text: str, rows: int, cols: int) -> str:
    """Limit every scene in the text of a scene recipe to `rows` × `cols` pixels.

    The number of random scenes is increased, so that the total number of pixels does not decrease.
    """

    def fitted(scene: re.Match[str]) -> str:
        height, width, count = (int(number or 0) for number in scene.groups())
        fitting = min(height, rows), min(width, cols)
        more = -(-count * height * width // (fitting[0] * fitting[1]))
        return f"size = [{fitting[0]}, {fitting[1]}]" + (f"\ncount = {more}" if count else "")

    return re.sub(r"\bsize = \[(\d+), (\d+)\](?:\ncount = (\d+))?", fitted, text)


def summary(starter: Path) -> str:
    """Describe a camera recipe, or the camera in a benchmark folder, in one line.

    The line contains the CFA period, the number of channels, and the first sentence of the comment at the top of the recipe.
    """
    camera = starter / "camera.toml" if starter.is_dir() else starter
    text = camera.read_text(encoding="utf-8")
    cfa = tomllib.loads((_base(camera) or camera).read_text(encoding="utf-8"))["cfa"]
    comment = " ".join(
        line.lstrip("# ") for line in itertools.takewhile(lambda line: line.startswith("#"), text.splitlines())
    )
    sentence = textwrap.shorten(re.split(r"[:;] |[.] (?=[A-Z])", comment)[0].rstrip("."), 84, placeholder=" …")
    period = f"{len(cfa['pattern'])}×{len(cfa['pattern'][0].split())}"
    channels = counted(len(cfa["channels"]), "channel")
    return f"{period}, {channels:11}  {sentence}"


def classes_of(camera: Path) -> str:
    """Return the name of the class recipe that suits a camera recipe."""
    return CLASSES.get(camera.stem, "default")


def folder_files(starter: Path) -> dict[str, Path]:
    """Return the files that are copied to a new folder, by their names in that folder."""
    if starter.is_dir():
        return {path.name: path for path in sorted(starter.iterdir())}
    sources = COMMON | {"classes.toml": f"classes/{classes_of(starter)}.toml"}
    if starter.stem in POLARISED:
        sources |= {"scenes.toml": f"scenes/{starter.stem}.toml", "unseen.toml": f"scenes/{starter.stem}_unseen.toml"}
    files = {name: recipe_folder() / source for name, source in sources.items()} | {"camera.toml": starter}
    return files | {path.name: path for path in _named(starter)}


def _base(camera: Path) -> Path | None:
    """Return the camera recipe on which a recipe is based (its key `base`), or None if it has no such key."""
    named = tomllib.loads(camera.read_text(encoding="utf-8")).get("base")
    return None if named is None else camera.parent / named


def curves_of(starter: Path) -> Path | None:
    """Return the file that contains a camera recipe's responsivities, or None if it refers to no such file.

    The result is also None for a benchmark folder.
    """
    if starter.is_dir():
        return None
    named = tomllib.loads((_base(starter) or starter).read_text(encoding="utf-8"))["responsivity"].get("file")
    return None if named is None else starter.parent / named


def _extinctions(camera: Path) -> list[Path]:
    """Return the files of extinction ratios to which a camera recipe refers, without duplicates."""
    recipe = tomllib.loads((_base(camera) or camera).read_text(encoding="utf-8"))
    named = [one.get("extinction") for one in recipe.get("channel", {}).values()]
    return list(dict.fromkeys(camera.parent / name for name in named if isinstance(name, str)))


def _named(camera: Path) -> list[Path]:
    """Return all files to which a camera recipe refers: its base recipe, responsivities and extinction ratios."""
    return [path for path in (_base(camera), curves_of(camera), *_extinctions(camera)) if path is not None]
