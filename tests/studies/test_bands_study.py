"""Quality of 16 bands on scenes that are not in the training set (docs/method.md#equal-response).

python -m pytest -m slow -s tests/studies/test_bands_study.py      needs L3_DATA; a quarter of an hour on two cores

The study also tests that no other setting of the first layer improves the recipe that comes with l3. The snapshot camera
records three multispectral scenes and five faces. The table is trained only on dead leaves. The metrics are the metrics of
`l3 evaluate --border 10 --json`: PSNR of each band, relative to a perfect white, and spectral angle, averaged over the
scenes.
"""

import json
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pytest

from l3cli.artifacts.partial_sums import open_partial_sums
from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import open_training_set
from l3cli.evaluation.quality import band_figures, band_quality
from l3cli.frames.frame import RawFrame
from l3cli.recipes.load import load_recipe
from l3cli.rendering.renderer import make_renderer
from l3cli.training.recipe import TrainingRecipe
from l3cli.training.solve import Solution
from l3cli.training.table import assemble, learn_site
from l3cli.training.training_pass import TrainingPass
from tests.helpers.bands import BORDER, unseen_scenes
from tests.helpers.calls import L3
from tests.helpers.paths import CONFIGS

LEAST_PSNR, LARGEST_ANGLE = 40.3, 1.97  # dB, degrees; noise-free faces alone had 2.2 before spectra were smoothed
NOISE_DIFFERENCE = 0.1  # dB: smaller differences are chance
ANGLE_DIFFERENCE = 0.02  # degrees: likewise
WITHOUT: dict[str, dict[str, Any]] = {
    "equal response": {"equal_response": False},
    "noise covariance": {"luminance_noise": 0.0},
    "half the weight on noise": {"luminance_noise": 0.5},
    "level pooling": {"level_pool": ()},
    "parents": {"parent_patches": 0},
    "smoothed spectra": {"spectral_window": 0},
}
pytestmark = pytest.mark.slow


class Figures(NamedTuple):
    psnr: float  # dB, mean over bands and scenes
    angle: float  # degrees, mean over scenes


def printed(document: dict, pipeline: str) -> Figures:
    bands = [band[pipeline]["psnr"] for band in document["by_band"]]
    return Figures(float(np.mean(bands)), document["mean"][pipeline]["mean_angle"])


def measured(table: TransformTable, unseen: Path) -> Figures:
    """What `printed` gives of ours, without the rivals, which take longer than all else."""
    psnr, angle, renderer = [], [], make_renderer("opencl", table)
    with open_training_set(unseen) as reader:
        camera = reader.head.camera
        for frame in reader:
            dark = camera.dark_signal(frame.dark_time)
            raw = RawFrame(frame.scene, frame.raw, camera.black_level, camera.white_level, dark=dark)
            shown = renderer.outputs(raw) * (table.output_unit / frame.exposure)
            judged = shown, frame.target, frame.white, BORDER
            psnr.append([band["psnr"] for band in band_figures(*judged)])
            angle.append(band_quality(*judged).mean_angle)
    return Figures(float(np.mean(psnr)), float(np.mean(angle)))


def solution(sums: Path, index: int, switches: dict[str, Any]) -> tuple[int, Solution]:
    """A canonical site by index, solved from its sums, which no switch changes."""
    with open_partial_sums(sums) as reader:
        pass_, site = pass_of(reader.head, switches), int(reader.head.sites[index])
        return site, learn_site(pass_, [reader.site(index)], site)


def pass_of(head: Any, switches: dict[str, Any]) -> TrainingPass:
    learning = load_recipe(CONFIGS / "classes/bands.toml", TrainingRecipe).learning
    about = (head.training, tuple(head.patches.tolist()), head.rule, msgspec.structs.replace(learning, **switches))
    return TrainingPass(*about, head.white_point, 0, head.pass_number, head.exposure, head.light)


def learned(sums: Path, switches: dict[str, Any]) -> TransformTable:
    """What "l3 train" makes of the sums with some keys of the recipe changed."""
    with open_partial_sums(sums) as reader:
        head = reader.head
    work = [sums] * head.sites.size, range(head.sites.size), [switches] * head.sites.size
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        solutions = dict(pool.map(solution, *work))
    return assemble(pass_of(head, switches), solutions, head.history)


def test_unseen_scenes_and_switches(tmp_path: Path, l3_data: Path, l3: L3, capsys: pytest.CaptureFixture[str]) -> None:
    names = ("leaves", "unseen", "sums", "first", "first_layer", "layer_sums", "table")
    leaves, unseen, sums, first, first_layer, layer_sums, table = (tmp_path / f"{name}.h5" for name in names)

    def tell(name: str, of: Figures) -> None:
        with capsys.disabled():
            print(f"{name:32} {of.psnr:6.2f} dB {of.angle:6.3f}°", flush=True)

    (tmp_path / "unseen.toml").write_text(unseen_scenes(l3_data))
    for scenes, output in ((tmp_path / "unseen.toml", unseen), (CONFIGS / "scenes/bands.toml", leaves)):
        assert l3("simulate", scenes, "--camera", "snapshot16", "-o", output, "--quiet")[0] == 0
    shard = "train", leaves, "--classes", "bands", "--shard", "1/1", "--jobs", 2, "--quiet"
    made = [shard, (*shard, "--first", first), (*shard, "--first", first_layer)]
    for each, parts, merged in zip(made, (layer_sums, sums, layer_sums), (first, first_layer, table), strict=True):
        assert l3(*each, "--force", "-o", parts)[0] == 0
        assert l3("train", "--merge", parts, "-o", merged, "--jobs", 2, "--quiet")[0] == 0
    code, out, _ = l3("evaluate", table, unseen, "--border", BORDER, "--json", "--quiet")
    assert code == 0
    document = json.loads(out)
    for pipeline in document["pipelines"]:
        tell(pipeline, printed(document, pipeline))
    shipped = measured(load(TransformTable, table), unseen)
    assert printed(document, "ours") == pytest.approx(shipped)
    without, alone = {}, measured(load(TransformTable, first_layer), unseen)
    tell("first layer alone", alone)
    for name, switches in WITHOUT.items():
        without[name] = measured(learned(sums, switches), unseen)
        tell(f"without {name}", without[name])
    assert shipped.psnr >= LEAST_PSNR
    assert shipped.angle <= LARGEST_ANGLE
    assert max(each.psnr for each in without.values()) <= alone.psnr + NOISE_DIFFERENCE
    assert min(each.angle for each in without.values()) >= alone.angle - ANGLE_DIFFERENCE
