"""Make the pictures of docs/gallery/ and the page docs/gallery.md: python docs/gallery/gallery.py [NAME …]

For every camera recipe of `l3 init`, or for the recipes in the arguments, a table is trained with the scene recipe SCENES
and with the class recipe that `l3 init` selects. The table then renders a frame of scene.toml, which is not in the training
set. Polarisation cameras have their own scene recipes, and pictures of the polarisation. If recipes are named, the entries
of all other recipes in figures.json are kept. Several arrays are processed at the same time, each in one process, so that no
process has to wait for another.
"""

import argparse
import json
import re
import sys
import tempfile
import time
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import OpenImageIO as oiio
import polarised
from page import page
from pictures import Picture, drawing, enlarged, grid, labelled, raw_picture

import l3cli
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingSet, open_training_set
from l3cli.evaluation.evaluation import Evaluation
from l3cli.evaluation.pictures import frame_pictures
from l3cli.io.pictures.openimageio import encoded, jpeg
from l3cli.parallel import ordered_map
from l3cli.recipes.builtin import classes_of, find_recipe, known_recipes, summary
from l3cli.stages.evaluation import FrameRenderers, evaluate_frame
from l3cli.system.console import Silent
from l3cli.system.files import write_whole

FOLDER = Path(__file__).parent
FIGURES = FOLDER / "figures.json"
PAGE = FOLDER.parent / "gallery.md"
SCENES = "default"
FRONT, FRONT_FILE = "fiveband", "front.jpg"  # the camera recipe and the file of the picture in the README
SHOWN = ("raw", "ideal", "ours", "basic")
FACTOR = 4
CROP, CROP_SIZE = (10, 215), (45, 80)  # pixels; corner and size (row, col) of the crop that is enlarged
FRONT_CORNER, FRONT_SIZE, FRONT_FACTOR = (15, 106), (156, 210), 2  # crop of the picture in the README, and its enlargement
LABELS = {"raw": "raw frame", "ideal": "ideal", "ours": "l3", "basic": "basic pipeline"}
QUALITY, FRONT_QUALITY = 80, 90  # JPEG quality
PNG_UP = 0x20  # PNG filter that stores the difference from the row above, which is zero in enlarged pictures


def png(picture: Picture) -> bytes:
    """Encode a picture as a small PNG file. l3 itself encodes faster but larger files."""
    spec = oiio.ImageSpec(picture.shape[1], picture.shape[0], 3, "uint8")
    spec.attribute("oiio:ColorSpace", "sRGB")
    spec.attribute("png:compressionLevel", 9)
    spec.attribute("png:filter", PNG_UP)
    return encoded("picture.png", spec, picture)


def arrays() -> dict[str, tuple[Path, list[str]]]:
    """Return the recipe and the twins of every array by name. Twins have the same array but begin at a different pixel."""
    known = known_recipes("cameras")
    recipes = {name: tomllib.loads(path.read_text(encoding="utf-8")) for name, path in known.items()}
    twins = {name: Path(recipe["base"]).stem for name, recipe in recipes.items() if set(recipe) <= {"name", "base", "phase"}}
    return {
        name: (path, [twin for twin, base in twins.items() if base == name])
        for name, path in known.items()
        if name not in twins
    }


class Array(NamedTuple):
    """A colour filter array for which pictures are made."""

    name: str
    path: Path
    twins: list[str]
    jobs: int


def effort(path: Path) -> int:
    """Estimate the effort for an array as sites × channels. Large arrays start first, so that no core is idle at the end."""
    rows, cols, channels = map(int, re.findall(r"\d+", summary(path))[:3])
    return rows * cols * channels


def make(array: Array) -> tuple[dict[str, Any], float]:
    """Write the pictures of an array. Return the entry for figures.json and the CPU time in seconds."""
    begin, (name, path, twins, jobs) = time.process_time(), array
    about: dict[str, Any] = {"summary": summary(path), "classes": classes_of(path), "twins": twins}
    with tempfile.TemporaryDirectory(prefix="l3-gallery-") as folder:
        training, table, unseen = (Path(folder, f"{each}.h5") for each in ("training", "table", "unseen"))
        scenes: Path | str = SCENES
        scene, outputs = FOLDER / "scene.toml", polarised.OUTPUTS.get(name)
        if outputs is not None:
            path = polarised.noisy_camera(path, Path(folder))
            scenes = polarised.with_outputs(find_recipe(name, "scenes"), outputs, Path(folder, "training.toml"), lens=False)
            scene = polarised.with_outputs(scene, outputs, Path(folder, "scene.toml"))
        l3cli.simulate(scenes, path, training, jobs=jobs)
        l3cli.train(training, table, classes=about["classes"], jobs=jobs)
        l3cli.simulate(scene, path, unseen)
        if outputs is not None:
            return about | put_polarised(name, polarised.judged(table, unseen)), time.process_time() - begin
        head, pictures, figures = judged(table, unseen)
    write_whole(FOLDER / f"{name}.svg", drawing(head.camera).encode())
    shown = [pictures[each] for each in SHOWN]
    crops = [enlarged(picture, CROP, CROP_SIZE, FACTOR) for picture in shown]
    write_whole(FOLDER / f"{name}.jpg", jpeg(grid([shown[:2], shown[2:]]), QUALITY))
    write_whole(FOLDER / f"{name}_crop.png", png(grid([crops[:2], crops[2:]])))
    if name == FRONT:
        write_whole(FOLDER / FRONT_FILE, jpeg(front(pictures), FRONT_QUALITY))
    return about | {"title": head.camera.name, "figures": figures}, time.process_time() - begin


def put_polarised(name: str, made: polarised.Judged) -> dict[str, Any]:
    """Write the pictures of a polarisation camera. Return the remaining items of its entry for figures.json."""
    crops = [[enlarged(picture, CROP, CROP_SIZE, FACTOR) for picture in row] for row in made.pictures]
    write_whole(FOLDER / f"{name}.svg", drawing(made.head.camera).encode())
    write_whole(FOLDER / f"{name}.jpg", jpeg(grid(made.pictures), QUALITY))
    write_whole(FOLDER / f"{name}_crop.png", png(grid(crops)))
    return {"title": made.head.camera.name, "polarisation": made.figures, "scale": made.scale}


def front(pictures: dict[str, Picture]) -> Picture:
    """Return the picture of the README: 2 × 2 panels, each with a label above."""
    panels = [
        labelled(enlarged(pictures[name], FRONT_CORNER, FRONT_SIZE, FRONT_FACTOR), label) for name, label in LABELS.items()
    ]
    return grid([panels[:2], panels[2:]])


def judged(table: Path, unseen: Path) -> tuple[TrainingSet, dict[str, Picture], dict[str, dict[str, float]]]:
    """Render the only frame of a set. Return the head of the set, the pictures, and mean ΔE00 and PSNR of every pipeline."""
    transforms = l3cli.load(table)
    assert isinstance(transforms, TransformTable)
    with open_training_set(unseen) as reader:
        evaluation = Evaluation(transforms, reader.head)
        frame, planes = evaluate_frame(evaluation, FrameRenderers("opencl", transforms, Silent()), reader, 0)
        pictures = frame_pictures(frame, planes) | {"raw": raw_picture(frame, reader.head.camera)}
        mean = evaluation.document()["mean"]
        figures = {name: {key: round(of[key], 2) for key in ("mean_delta_e", "psnr")} for name, of in mean.items()}
        return reader.head, pictures, figures


def main(names: list[str], jobs: int) -> int:
    """Return 0, or 2 if a name is not the name of an array."""
    known = arrays()
    if unknown := [name for name in names if name not in known]:
        print(f'no array "{unknown[0]}"; there are {", ".join(known)}', file=sys.stderr)
        return 2
    entries = json.loads(FIGURES.read_text(encoding="utf-8")) if names and FIGURES.exists() else {}
    wanted = sorted(dict.fromkeys(names) or known, key=lambda name: -effort(known[name][0]))
    at_once = min(jobs, len(wanted))
    arrays_wanted = [Array(name, *known[name], jobs // at_once) for name in wanted]
    start = time.perf_counter()
    for name, (entry, seconds) in zip(wanted, ordered_map(make, arrays_wanted, at_once), strict=True):
        entries[name] = entry
        entries = {each: entries[each] for each in known if each in entries}
        write_whole(FIGURES, (json.dumps(entries, indent=1, ensure_ascii=False) + "\n").encode())
        write_whole(PAGE, page(entries, SCENES).encode())
        print(f"{name}: {seconds:.0f} s of processor; {time.perf_counter() - start:.0f} s since the beginning", flush=True)
    return 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    sys.exit(main(given.names, given.jobs))
