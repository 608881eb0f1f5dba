"""Time of one core to learn from a patch, on synthetic frames."""

import cProfile
import pstats
import time
from dataclasses import replace
from typing import Any

import numpy as np

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import TrainingFrame, TrainingSet
from l3cli.training.accumulate import sum_sites
from l3cli.training.recipe import LearningRecipe, TrainingRecipe, for_camera
from l3cli.training.row_weighting import row_weighting
from l3cli.training.table import assemble, learn_site, pilot_patches, survey, take_pilot
from l3cli.training.training_pass import FIRST, LAST, TrainingPass, frame_blocks, spread_patches

REPEATS = 2  # of which the faster counts, in CPU seconds: other work on the machine only slows
FRAMES, SIDE = 8, 160
STAGES = {  # functions whose time, with all that they call, makes a stage
    "patches": ("patches_of",),
    "expose": ("expose_patches",),
    "label": ("patch_statistics", "label_sums"),
    "weigh": ("noise_share", "weight"),
    "sum": ("add_products",),
    "solve": ("learn_site", "assemble"),
}


def measure(camera: CameraModel, patches: int) -> dict[str, Any]:
    """Return the time of the faster of REPEATS trainings from frames in memory, `patches` a site, to a table, by stages. A
    row is a patch at one of the levels it is rescaled to."""
    frames = [synthetic_frame(camera, seed) for seed in range(FRAMES)]
    recipe = for_camera(TrainingRecipe(learning=LearningRecipe(patches=patches)), camera)
    times, rows = [], 0
    for _ in range(REPEATS):
        start = time.process_time()
        rows = train(frames, camera, recipe)
        times.append(time.process_time() - start)
    with cProfile.Profile(time.process_time) as profile:
        train(frames, camera, recipe)
    return {
        "rows": rows,
        "cpu_s": min(times),
        "rows_per_s": rows / min(times),
        "stages_ns": {name: share * min(times) / rows * 1e9 for name, share in stage_shares(profile).items()},  # a row
    }


def train(frames: list[TrainingFrame], camera: CameraModel, recipe: TrainingRecipe) -> int:
    """Train a table in both passes over `frames`; return the number of rows that were added up."""
    head = TrainingSet(camera=camera, outputs=("X", "Y", "Z"), target_description="synthetic")
    patches = spread_patches(recipe.learning.patches, [len(frames)], None)
    pilot = take_pilot(frames, 0, pilot_patches(patches), head, recipe, 0)
    rule, white, exposure, _ = survey([pilot], patches, head, recipe, 0)
    pass_, table, rows = TrainingPass(head, patches, rule, recipe.learning, white, 0, FIRST, exposure), None, 0
    for number in (FIRST, LAST):
        pass_ = replace(pass_, number=number)
        weightings = {
            site: row_weighting(table, site, pass_.recipe.error_power) if table else None for site in pass_.divisors
        }
        blocks = [
            (block[0], tuple(weightings), iter(frames[block.start : block.stop])) for block in frame_blocks(pass_.patches)
        ]
        sums = sum_sites(pass_, blocks, weightings)
        rows += sum(int(site_sums.count.sum()) for site_sums in sums.values())
        table = assemble(pass_, {site: learn_site(pass_, [sums.pop(site)], site) for site in weightings}, ())
    return rows


def stage_shares(profile: cProfile.Profile) -> dict[str, float]:
    """Return the share of the profiled time in each of STAGES, and in all the rest."""
    profile.create_stats()
    stats = pstats.Stats(profile)
    spent = dict.fromkeys(STAGES, 0.0)
    for (path, _, name), (_, _, _, cumulative, _) in stats.stats.items():  # type: ignore[attr-defined]
        for stage, names in STAGES.items():
            if name in names and "l3cli" in path:
                spent[stage] += cumulative
    whole = stats.total_tt  # type: ignore[attr-defined]
    shares = {stage: seconds / whole for stage, seconds in spent.items()}
    return {**shares, "rest": 1 - sum(shares.values())}


def synthetic_frame(camera: CameraModel, seed: int) -> TrainingFrame:
    """Return a frame of squares of many colours and sizes, lit unevenly."""
    rng = np.random.default_rng(seed)
    share = np.full((len(camera.channels), SIDE, SIDE), 0.3)
    for size in np.geomspace(80, 3, 400).astype(int):
        row, col = rng.integers(0, SIDE - size, 2)
        share[:, row : row + size, col : col + size] = rng.random((len(share), 1, 1))
    share *= np.linspace(0.3, 1.0, SIDE)
    target = np.einsum("oc,crk->ork", rng.random((3, len(share))), share) * camera.saturation_exposure / 0.01
    return TrainingFrame(
        raw=np.zeros((SIDE, SIDE), np.uint16),
        electrons=(share * camera.full_scale).astype(np.float32),
        target=target.astype(np.float32),
        white=np.array([95.0, 100.0, 109.0]),
        scene="synthetic",
        illuminant="D65",
        luminance=100.0,
        exposure=0.01,
        seed=(0, seed),
    )
