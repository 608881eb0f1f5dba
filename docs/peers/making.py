"""Make the training sets and tables for the comparison in a folder. Existing files are reused."""

import os
import re
import shutil
import tomllib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import provenance

import l3cli
from l3cli.io.images import read_image
from l3cli.options.commands import InitOptions
from l3cli.recipes.builtin import find_recipe, known_benchmarks
from l3cli.stages.starting import start

PICTURES = {"Kodak": "kodak", "McMaster": "mcmaster"}  # folders below demosaicking/ in the data folder
RECIPES = ("default", "best")  # class recipes for frames with noise
LEVELS = (0.2, 0.02, 0.01)  # mean signals, as fractions of full scale
DAYS, FACES = ("01", "06", "13"), (1, 2, 4, 5, 6)
PHOTOS = {"BanteaySrei_03.jpg": 4, "FruitMCC_6500.tif": 3, "woodDuck.png": 3, "elephant.png": 2}  # reduction factor of each
NANOMETRES = [405, 435, 450, 470, 505, 525, 570, 590, 630, 645, 660, 700, 780, 850, 870, 890, 910, 940, 970]
POLARISED_SHARES = (0.9, 0.1, 0.02)  # signals of an unpolarised white, as fractions of full scale
ANGLES = (0, 45, 90, 135)  # angles of the polariser in the photographs, in degrees
COMPOSITION = '[[scene]]\nsource = "composition"\nsize = [360, 480]\nseed = 7\n'
PATTERN = re.compile(r"^pattern = \[.*?^\]", re.DOTALL | re.MULTILINE)


def data_folder() -> Path:
    """Return the data folder (L3_DATA). Raise SystemExit if pictures are missing."""
    folder = Path(os.environ.get("L3_DATA", "../shared/data")).resolve()
    for needed in ("demosaicking/kodak", "demosaicking/training", "pictures", "scenes"):
        if not (folder / needed).is_dir():
            raise SystemExit(f"{folder / needed} is missing; give the folder of the real data in L3_DATA")
    return folder


def codes(folder: Path, data: Path, array: str, jobs: int) -> tuple[dict[str, Path], Path]:
    """Return test sets and table of the benchmark `l3 init benchmark-bayer`, with the CFA of the recipe `array`."""
    if not (folder / "camera.toml").exists():
        start(known_benchmarks()["benchmark-bayer"], folder, InitOptions(force=True))
        given = PATTERN.search(find_recipe(array, "cameras").read_text(encoding="utf-8"))
        camera = (folder / "camera.toml").read_text(encoding="utf-8")
        assert given is not None
        (folder / "camera.toml").write_text(PATTERN.sub(given[0], camera), encoding="utf-8")
    test = (folder / "test.toml").read_text(encoding="utf-8")
    sets = {}
    for name, pictures in PICTURES.items():
        if (source := data / "demosaicking" / pictures).is_dir():
            recipe = _written(folder / f"{pictures}.toml", test.replace("test/*", f"{source}/*"))
            sets[name] = _simulated(recipe, folder / "camera.toml", folder / f"{pictures}.h5", jobs)
    learned = (folder / "training.toml").read_text(encoding="utf-8")
    recipe = _written(folder / "learned.toml", learned.replace("training/*", f"{data}/demosaicking/training/*"))
    training = _simulated(recipe, folder / "camera.toml", folder / "training.h5", jobs)
    return sets, _trained(training, str(folder / "classes.toml"), folder / "table.h5", jobs)


def bands(folder: Path, data: Path, jobs: int) -> tuple[dict[str, Path], Path]:
    """Return the test set of sixteen bands (scenes and faces), and the table, which is trained on dead leaves only."""
    head = 'illuminants = ["D65"]\nexposure_share = [0.9]\n[target]\noutputs = "camera"\n'
    cubes = [
        f'[[scene]]\nsource = "cube"\nfile = "{data}/scenes/multispectral_day{day}.mat"\nwavelengths_nm = {NANOMETRES}\n'
        for day in DAYS
    ]
    folder.mkdir(parents=True, exist_ok=True)
    recipe = _written(folder / "test.toml", head + "".join(cubes) + _faces(data))
    unseen = _simulated(recipe, "snapshot16", folder / "test.h5", jobs)
    training = _simulated("bands", "snapshot16", folder / "training.h5", jobs)
    return {"bands": unseen}, _trained(training, "bands", folder / "table.h5", jobs)


def noise(folder: Path, data: Path, jobs: int, recipes: Sequence[str] = RECIPES) -> tuple[dict[str, Path], dict[str, Path]]:
    """Return the test sets of a Bayer camera with noise at each of LEVELS, and the tables by class recipe."""
    folder.mkdir(parents=True, exist_ok=True)
    sets = {}
    for level in LEVELS:
        head = f'illuminants = ["D65"]\nexposure_mean = [{level}]\n'
        recipe = _written(folder / f"test{level}.toml", head + COMPOSITION + _faces(data) + _photos(data))
        sets[f"{level}"] = _simulated(recipe, "bayer", folder / f"test{level}.h5", jobs)
    training = _simulated("default", "bayer", folder / "training.h5", jobs)
    return sets, {name: _trained(training, name, folder / f"{name}.h5", jobs) for name in recipes}


def polarisation(folder: Path, data: Path, jobs: int) -> tuple[dict[str, Path], Path]:
    """Return the test sets of a monochrome polarisation camera at each of POLARISED_SHARES, and the table.

    The scenes are the green channels of photographs of two scenes behind a polariser. The table is trained on dead leaves
    only. The lens blurs neither the photographs nor the training scenes, because the photographs were already taken through
    a lens.
    """
    folder.mkdir(parents=True, exist_ok=True)
    scenes, sharp = "", "[lens]\ndiffraction = false\n"
    for number in (1, 2):
        stack = folder / f"scene{number}.npy"
        pictures = [read_image(data / f"polarisation/colour/{angle}_{number}.png")[0] for angle in ANGLES]
        np.save(stack, np.stack([picture[..., 1] for picture in pictures]).astype(np.float32) / 255)
        scenes += f'[[scene]]\nsource = "polariser"\nfile = "{stack}"\nangles_deg = {list(ANGLES)}\n'
    sets = {}
    for share in POLARISED_SHARES:
        head = f'illuminants = ["D65"]\nexposure_share = [{share}]\n[target]\noutputs = "Stokes"\n{sharp}'
        recipe = _written(folder / f"test{share}.toml", head + scenes)
        sets[f"{share}"] = _simulated(recipe, "polarised", folder / f"test{share}.h5", jobs)
    text = find_recipe("polarised", "scenes").read_text(encoding="utf-8")
    recipe = _written(folder / "training.toml", text.replace("[target]", f"{sharp}\n[target]"))
    training = _simulated(recipe, "polarised", folder / "training.h5", jobs)
    return sets, _trained(training, "polarised", folder / "table.h5", jobs)


def _faces(data: Path) -> str:
    return "".join(f'[[scene]]\nsource = "iset"\nfile = "{data}/scenes/people_small_{face}_scene.mat"\n' for face in FACES)


def _photos(data: Path) -> str:
    return "".join(
        f'[[scene]]\nsource = "rgb"\nfile = "{data}/pictures/{name}"\nshrink = {shrink}\n' for name, shrink in PHOTOS.items()
    )


def _written(path: Path, text: str) -> Path:
    tomllib.loads(text)
    path.write_text(text, encoding="utf-8")
    return path


def _simulated(scenes: Path | str, camera: Path | str, output: Path, jobs: int) -> Path:
    if not output.exists():
        shutil.rmtree(output.with_suffix(".h5.parts"), ignore_errors=True)
        l3cli.simulate(scenes, camera, output, jobs=jobs)
    return output


def _trained(training: Path, classes: str, output: Path, jobs: int) -> Path:
    if not output.exists():
        l3cli.train(training, output, classes=classes, jobs=jobs)
        provenance.stamp(output)
    return output
