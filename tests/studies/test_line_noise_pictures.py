"""Pictures of sensors with row noise, by tables that know the noise of rows, and by tables that take it for pixel noise.

python -m pytest -m slow -s tests/studies/test_line_noise_pictures.py      60 minutes of processor time

For each camera and each row temporal noise, tables are trained on two draws of dead leaves: for the camera
as it is ("rows"), for a camera without row noise and with the same noise variance of a pixel ("pixels"), and for the camera
with 16 masked pixels per row ("masked"). The tables render raw frames of three unseen scenes, as wide as the sensor, at a
mean signal of 0.02 of full scale. The frames are read as l3 render reads them, which corrects the offsets of the rows with
masked pixels or with the picture itself. The class recipe is `default` with a quarter of its patches.

Stripes are the standard deviation of the row means of a uniform area at this signal, relative to the mean. Bands are the
standard deviation of the change of the row means in the scenes that the row noise causes, relative to the mean.
"""

import functools
import itertools
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingFrame, open_training_set
from l3cli.cli import run
from l3cli.evaluation.quality import quality
from l3cli.frames.frame import RawFrame
from l3cli.io.raw.files import RawOverrides, frame_of
from l3cli.rendering.renderer import make_renderer
from l3cli.simulation.sensor import FixedPattern, fixed_pattern, mosaic, read_out, with_masked
from tests.helpers.paths import CONFIGS

RATIOS = (0.5, 1.0, 2.0)  # row temporal noise, relative to the read noise
BORDER, MASKED = 12, 16
PATCHES = "patches = 120000", "patches = 30000"
ROWS, COLS = 192, 1920  # size of the unseen scenes
DRAWS = (0, 1)  # seeds of the training scenes
TRAINING = """
exposure_share = [0.9]
[[scene]]
source = "dead leaves"
size = [160, 160]
count = 24
[[scene]]
source = "surfaces"
size = [160, 160]
count = 4
patches = [4, 4]
"""
UNSEEN = f"""
exposure_mean = [0.02]
[[scene]]
source = "composition"
size = [{ROWS}, {COLS}]
seed = 7
[[scene]]
source = "dead leaves"
size = [{ROWS}, {COLS}]
[[scene]]
source = "surfaces"
size = [{ROWS}, {COLS}]
"""


def recipe_of(name: str, ratio: float, kind: str, folder: Path) -> Path:
    """Write the recipe of a camera whose row noise is stated ("rows"), removed ("masked") or hidden ("pixels")."""
    text = (CONFIGS / f"cameras/{name}.toml").read_text()
    found = re.search(r"read_noise_e = ([0-9.]+)", text)
    assert found is not None
    read = float(found[1])
    if kind == "pixels":
        text = text.replace(found[0], f"read_noise_e = {read * np.hypot(1.0, ratio):.9g}")
    else:
        text = text.replace(found[0], f"{found[0]}\nrow_temporal_noise_e = {read * ratio:g}")
    path = folder / f"{kind}.toml"
    path.write_text(text + (f"\n[masked]\nleft = {MASKED}\n" if kind == "masked" else ""))
    return path


def read(camera: CameraModel, electrons: np.ndarray, seconds: float, seed: int, table: TransformTable) -> RawFrame:
    """Simulate a raw frame with its masked pixels and its row noise, and read it as `l3 render` reads it."""
    whole = fixed_pattern(camera)
    rows, cols = electrons.shape
    camera = replace(camera, rows=rows, cols=cols)
    pattern = FixedPattern(whole.prnu[:rows, :cols], whole.dsnu[:rows, :cols])
    values = read_out(camera, *with_masked(camera, pattern, electrons), seconds, np.random.default_rng([seed, 3]))
    sensor = replace(camera, noise=table.camera.noise, masked=table.camera.masked) if table.camera else camera
    return frame_of("frame", {"values": values}, sensor, RawOverrides(exposure=seconds))


def judged(table: Path, unseen: Path, camera: Path) -> tuple[float, float, float, float]:
    """Return the mean ΔE00 and the mean PSNR over the unseen scenes, and the stripes and the bands in percent."""
    trained, sensor = load(TransformTable, table), load_camera(camera)
    quiet = replace(sensor, noise=replace(sensor.noise, row_temporal_noise=0.0), masked=None)
    plain = replace(trained, camera=quiet)
    renderer = make_renderer("opencl", trained)
    errors, bands, signal = [], [], np.zeros(len(sensor.channels))
    with open_training_set(unseen) as reader:
        for index in range(len(reader)):
            frame = reader.frame(index)
            assert isinstance(frame, TrainingFrame)
            electrons = mosaic(frame.electrons, sensor.cfa)
            made = renderer.outputs(read(sensor, electrons, frame.exposure, index, trained))
            found = quality(made * (trained.output_unit / frame.exposure), frame.target, frame.white, BORDER)
            errors.append((found.mean_delta_e, found.psnr))
            without = renderer.outputs(read(quiet, electrons, frame.exposure, index, plain))[1]
            change = (made[1] - without)[BORDER:-BORDER, BORDER:-BORDER].mean(axis=1)
            bands.append(change.var() / without.mean() ** 2)
            channel = sensor.channel_map(electrons.shape)
            signal += np.bincount(channel.ravel(), electrons.ravel()) / np.bincount(channel.ravel()) / len(reader)
    uniform, stripes = signal[sensor.channel_map((ROWS, COLS))].astype(np.float32), []
    for seed in range(4):
        light = renderer.outputs(read(sensor, uniform, 0.0, 10 + seed, trained))[1]
        rows = light[BORDER:-BORDER, BORDER:-BORDER].mean(axis=1)
        stripes.append(rows.var() / rows.mean() ** 2)
    return (*np.mean(errors, axis=0).tolist(), *(100 * float(np.sqrt(np.mean(each))) for each in (stripes, bands)))


def simulated(scenes: str, camera: Path, seed: int, made: Path) -> Path:
    made.with_suffix(".txt").write_text(scenes)
    command = ["simulate", made.with_suffix(".txt"), "--camera", camera, "-o", made, "--seed", seed]
    assert run([*map(str, command), "--quiet", "--force"]) == 0
    return made


@pytest.fixture(scope="module")
def unseen(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, int], Path]:
    """Function that simulates the unseen scenes of a camera and a draw. They contain no noise, so all cases share them."""
    folder = tmp_path_factory.mktemp("unseen")
    return functools.cache(
        lambda name, draw: simulated(UNSEEN, CONFIGS / f"cameras/{name}.toml", 100 + draw, folder / f"{name}-{draw}.h5")
    )


@pytest.mark.slow
@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("name", ["bayer", "fiveband"])
def test_row_noise(name: str, ratio: float, unseen: Callable[[str, int], Path], tmp_path: Path) -> None:
    """On the mean of two draws, rows whose offsets are corrected have at most half of the stripes, and smaller errors."""
    classes = (CONFIGS / "classes/default.toml").read_text()
    assert PATCHES[0] in classes
    (tmp_path / "classes.toml").write_text(classes.replace(*PATCHES))
    cameras = {kind: recipe_of(name, ratio, kind, tmp_path) for kind in ("rows", "pixels", "masked")}

    found: dict[str, list[tuple[float, float, float, float]]] = {kind: [] for kind in cameras}
    for draw, kind in itertools.product(DRAWS, cameras):
        table, seen = tmp_path / f"{kind}.h5", "rows" if kind == "pixels" else kind
        scenes = simulated(TRAINING, cameras[kind], draw, tmp_path / f"training-{kind}.h5")
        learn = ["train", scenes, "--classes", tmp_path / "classes.toml", "-o", table]
        assert run([*map(str, learn), "--quiet", "--force"]) == 0
        found[kind].append(judged(table, unseen(name, draw), cameras[seen]))
        error, psnr, stripes, bands = found[kind][-1]
        print(
            f"\n{name}, row noise {ratio:g} × read noise, draw {draw}, {kind}: ΔE00 {error:.2f}, PSNR {psnr:.2f} dB, "
            f"stripes {stripes:.2f} %, bands {bands:.2f} %",
            end="",
            flush=True,
        )
    mean = {kind: np.mean(values, axis=0) for kind, values in found.items()}
    for better in ("rows", "masked"):
        assert mean[better][0] < mean["pixels"][0]  # ΔE00
        assert mean[better][1] > mean["pixels"][1]  # PSNR
        assert mean[better][3] < mean["pixels"][3]  # bands
    assert mean["rows"][2] <= 0.5 * mean["pixels"][2]  # stripes
