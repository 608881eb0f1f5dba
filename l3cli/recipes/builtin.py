"""The recipes that come with l3 (configs/ in the repository or the wheel), and the starter folders made from them."""

import itertools
import os
import re
import textwrap
import tomllib
from collections.abc import Mapping
from pathlib import Path

from l3cli.errors import InputFileError, RecipeError, suggestion

# Subfolder of configs/ → kind of recipe in it.
KIND_OF_FOLDER = {"cameras": "camera", "lab": "lab", "scenes": "scene", "classes": "class", "designs": "design"}
CURVES = "curves.csv"  # name of the file with the camera's curves in a starter folder
# The other files of a starter folder, beside camera.toml: name in the folder → name in configs/.
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
# Replacements in the pipelines for a real camera. Its recipe is used directly, instead of a calibration in the virtual lab.
KNOWN = {
    "Makefile": ("CAMERA ?= camera.h5", "CAMERA ?= camera.toml"),
    "Snakefile": ('config.get("camera", "snakemake/camera.h5")', 'config.get("camera", "camera.toml")'),
    "slurm.sh": ("${CAMERA:-camera.h5}", "${CAMERA:-camera.toml}"),
}
# Replacements in the scene recipe and in the class recipe to train for two illuminants.
LIGHTS = '["A", "D65"]'
ILLUMINANTS = 'illuminants = ["D65"]\n', f"illuminants = {LIGHTS}\n"
LEARNING = (
    "[learning]\n",
    f"[learning]\nlights = {LIGHTS}    # each has transforms of its own; a frame's white chooses\n",
)
# Class recipes of cameras that do not use the class recipe `default`.
CLASSES = {"nona_bayer_hdr": "blocks", "rgbir4x4": "long_period"}


def recipe_folder() -> Path:
    """Return the folder of the recipes that come with l3. In a source checkout it lies beside the package."""
    package = Path(__file__).parents[1]
    inside = package / "configs"
    return inside if inside.is_dir() else package.parent / "configs"


def known_benchmarks() -> dict[str, Path]:
    """Return the benchmark folders that come with l3, by name."""
    return {f"benchmark-{path.name}": path for path in sorted((recipe_folder() / "benchmarks").iterdir()) if path.is_dir()}


def known_recipes(kind: str) -> dict[str, Path]:
    """Return the recipes of one kind (a key of KINDS) that come with l3, by name."""
    return {path.stem: path for path in sorted((recipe_folder() / kind).glob("*.toml"))}


def find_recipe(text: str, kind: str) -> Path:
    """Find a recipe by path, or by name among the recipes that come with l3.

    Parameters
    ----------
    text : str
        A path, or the name of a recipe.
    kind : str
        A key of KINDS.

    Returns
    -------
    Path
        The recipe. If `text` is the path of some other missing file, it is returned unchanged, so that opening it fails.

    Raises
    ------
    RecipeError
        If `text` is a name that no recipe has.
    InputFileError
        If `text` is the path of a missing file that has the name of a recipe that comes with l3.
    """
    if os.path.isfile(text):
        return Path(text)
    known, path = known_recipes(kind), Path(text)
    if text in known:
        return known[text]
    if os.path.exists(text):
        return path
    if os.sep not in text and not path.suffix:
        raise RecipeError(f'no file and no {KIND_OF_FOLDER[kind]} recipe is called "{text}"; {suggestion(text, known)}')
    if path.suffix == ".toml" and path.stem in known:
        raise InputFileError(f'{text} does not exist; give "{path.stem}" without a path for the recipe that comes with l3')
    return path


def starters() -> dict[str, Path]:
    """Return everything from which a starter folder can be made, by name: camera recipes and benchmark folders."""
    return known_recipes("cameras") | known_benchmarks()


def slug_of(name: str) -> str:
    """Convert the name of a camera to lower case with underscores, as it is typed on the command line."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")


def cameras_by_name(text: str = "") -> dict[str, tuple[str, ...]]:
    """Find cameras among those whose measured curves come with l3.

    Parameters
    ----------
    text : str
        Words that must all occur in the names of a camera. Capitals do not matter. [default: all cameras]

    Returns
    -------
    dict of str to tuple of str
        Name to type → all names of the camera.
    """
    known = tomllib.loads((recipe_folder() / "priors" / "cameras.toml").read_text(encoding="utf-8"))["camera"]
    names = {slug: (each["name"], *each.get("also", ())) for slug, each in known.items()}
    words = slug_of(text).split("_")
    return {slug: each for slug, each in names.items() if all(word in slug_of(" ".join(each)) for word in words)}


def known_camera(contents: Mapping[str, bytes]) -> dict[str, bytes]:
    """Adapt the pipelines in `contents` to a real camera, whose recipe is used directly instead of lab measurements."""
    known = {}
    for name, (usual, recipe) in KNOWN.items():
        text = contents[name].decode()
        assert usual in text
        known[name] = text.replace(usual, recipe).encode()
    return known


def common_files(rows: int, cols: int) -> dict[str, bytes]:
    """Return the files of a starter folder except the camera recipe, with scenes that fit a sensor of `rows` × `cols`."""
    files = {name: (recipe_folder() / source).read_bytes() for name, source in COMMON.items()}
    files |= known_camera(files) | for_lights(files)
    return files | {name: fitting_scenes(files[name].decode(), rows, cols).encode() for name in SCENES}


def for_lights(contents: Mapping[str, bytes]) -> dict[str, bytes]:
    """Return the scene recipe and the class recipe in `contents`, changed to train for daylight and incandescent light.

    The originals name only one illuminant, so that each can be used without the other.
    """
    changed = {}
    for name, (before, after) in {"scenes.toml": ILLUMINANTS, "classes.toml": LEARNING}.items():
        text = contents[name].decode()
        assert text.count(before) == 1
        changed[name] = text.replace(before, after).encode()
    return changed


def fitting_scenes(text: str, rows: int, cols: int) -> str:
    """Return the text of a scene recipe with all scenes limited to `rows` × `cols` pixels.

    If random scenes become smaller, their number is increased, so that training sees as many pixels as before.
    """

    def fitted(scene: re.Match[str]) -> str:
        height, width, count = (int(number or 0) for number in scene.groups())
        fitting = min(height, rows), min(width, cols)
        more = -(-count * height * width // (fitting[0] * fitting[1]))
        return f"size = [{fitting[0]}, {fitting[1]}]" + (f"\ncount = {more}" if count else "")

    return re.sub(r"\bsize = \[(\d+), (\d+)\](?:\ncount = (\d+))?", fitted, text)


def summary(starter: Path) -> str:
    """Return a one-line summary of a camera recipe or of the camera of a benchmark.

    It consists of the period of the CFA, the number of channels and the first sentence of the comment at the top.
    """
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
    """Return the name of the class recipe for a camera recipe that comes with l3."""
    return CLASSES.get(camera.stem, "default")


def folder_files(starter: Path) -> dict[str, Path]:
    """Return the source file of each file in a starter folder, by its name in the folder."""
    if starter.is_dir():
        return {path.name: path for path in sorted(starter.iterdir())}
    sources = COMMON | {"classes.toml": f"classes/{classes_of(starter)}.toml"}
    files = {name: recipe_folder() / source for name, source in sources.items()} | {"camera.toml": starter}
    return files | {path.name: path for path in _named(starter)}


def _base(camera: Path) -> Path | None:
    """Return the camera recipe on which this one is based, in the same folder, or None."""
    named = tomllib.loads(camera.read_text(encoding="utf-8")).get("base")
    return None if named is None else camera.parent / named


def curves_of(starter: Path) -> Path | None:
    """Return the file of curves that a camera recipe names, or None."""
    if starter.is_dir():
        return None
    named = tomllib.loads((_base(starter) or starter).read_text(encoding="utf-8"))["responsivity"].get("file")
    return None if named is None else starter.parent / named


def _named(camera: Path) -> list[Path]:
    """Return the other files that a camera recipe needs: its base and its curves."""
    return [path for path in (_base(camera), curves_of(camera)) if path is not None]
