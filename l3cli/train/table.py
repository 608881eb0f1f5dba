"""The training room's front: what the command calls, in the order it calls it."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.base import Stage
from l3cli.artifacts.table import ClassRule, TransformTable
from l3cli.artifacts.training_set import TrainingPair, TrainingSet
from l3cli.classify import make_rule, neighbourhoods, saturation_codes
from l3cli.train.cases import choose_cases
from l3cli.train.patches import draw_levels, expose_patches, patches_of
from l3cli.train.recipe import TrainingRecipe, check_learning
from l3cli.train.solve import Goal, Solution, equal_responses, solve
from l3cli.train.sums import Sums, accumulate, symmetrise
from l3cli.train.symmetry import site_maps, stabilisers

PILOT_PATCHES = 4000  # patches a site over all frames that decide which saturation cases are kept


def training_rule(
    frames: Iterable[TrainingPair], total: int, head: TrainingSet, recipe: TrainingRecipe, seed: int
) -> ClassRule:
    """The class rule for `head.camera`, its saturation cases chosen from a pilot sample of the `total` frames."""
    check_learning(recipe.learning)
    camera = head.camera
    codes = 2 ** len(camera.channels)
    rule = make_rule(recipe.classes, camera, np.zeros(codes, dtype=np.uint16))
    near = neighbourhoods(camera.cfa, rule.patch, len(camera.channels))
    canonical = canonical_sites(head, rule)
    occurrences = np.zeros(codes, dtype=np.int64)
    for index, frame in enumerate(frames):
        for site in canonical:
            rng = np.random.default_rng([seed, 0, index, site])
            count = -(-PILOT_PATCHES // total)
            patches = patches_of(frame, head, near, site, count, rng)
            own_level = np.maximum(patches.signal.mean(axis=1), 1e-3)
            scale = patches.possible(draw_levels(recipe.learning, len(own_level), rng) / own_level)[:, None]
            carried = None if patches.carried is None else (patches.carried * scale**2).astype(np.float32)
            values, _, _ = expose_patches((patches.signal * scale).astype(np.float32), camera, rng, carried)
            occurrences += np.bincount(saturation_codes(values, rule, near, site), minlength=codes)
    return make_rule(recipe.classes, camera, choose_cases(occurrences, recipe.classes.max_cases))


def canonical_sites(head: TrainingSet, rule: ClassRule) -> list[int]:
    """The sites that are trained; all others are their rotations or mirror images."""
    near = neighbourhoods(head.camera.cfa, rule.patch, len(head.camera.channels))
    return sorted({site_map.canonical for site_map in site_maps(near.channel, rule.patch)})


def train_site(
    frames: Iterable[TrainingPair],
    total: int,
    head: TrainingSet,
    rule: ClassRule,
    site: int,
    recipe: TrainingRecipe,
    white_point: NDArray[np.float64],
    seed: int,
) -> Solution:
    """Solutions of one canonical site from all `total` frames, read in turn; `white_point` (output) with Y = 1."""
    camera = head.camera
    near = neighbourhoods(camera.cfa, rule.patch, len(camera.channels))
    sums = Sums.empty(rule.classes_per_site, rule.patch**2, len(head.outputs))
    window = near.channel[site]
    for index, frame in enumerate(frames):
        rng = np.random.default_rng([seed, 1, index, site])
        count = -(-recipe.learning.patches // total)
        patches = patches_of(frame, head, near, site, count, rng)
        accumulate(sums, patches, camera, rule, near, site, recipe.learning, rng)
    shared = symmetrise(sums, stabilisers(window, rule.patch))
    return solve(shared, rule, window, recipe.learning, Goal(head.outputs, white_point))


def assemble(
    head: TrainingSet,
    rule: ClassRule,
    solutions: dict[int, Solution],
    recipe: TrainingRecipe,
    white_point: NDArray[np.float64],
    history: tuple[Stage, ...],
) -> TransformTable:
    """The table of all sites from the solutions of the canonical ones; `white_point` (output) with Y = 1."""
    camera = head.camera
    near = neighbourhoods(camera.cfa, rule.patch, len(camera.channels))
    maps = site_maps(near.channel, rule.patch)
    copies = [sum(site_map.canonical == site for site_map in maps) for site in solutions]
    equal = equal_responses(list(solutions.values()), copies, rule, recipe.learning, Goal(head.outputs, white_point))
    transforms = dict(zip(solutions, equal, strict=True))
    weights, intercept, samples = [], [], []
    for site_map in maps:
        trained = transforms[site_map.canonical]
        turned = np.empty_like(trained.weights)
        turned[..., site_map.permutation] = trained.weights
        weights.append(turned)
        intercept.append(trained.intercept)
        samples.append(trained.samples)
    return TransformTable(
        history=history,
        camera_name=camera.name,
        rows=camera.rows,
        cols=camera.cols,
        channels=camera.channels,
        cfa=camera.cfa,
        bits=camera.bits,
        black=camera.black,
        white=camera.white,
        outputs=head.outputs,
        output_unit=camera.white_dose,
        white_point=white_point,
        rule=rule,
        weights=np.concatenate(weights).astype(np.float32),
        intercept=np.concatenate(intercept).astype(np.float32),
        samples=np.concatenate(samples),
    )


def mean_white(frames: Iterable[TrainingPair]) -> NDArray[np.float64]:
    """Mean white point (output) of the frames' lights, each at Y = 1 (for other outputs than XYZ: at a mean of 1)."""
    whites = np.array([frame.white / (frame.white[1] if frame.white.size == 3 else frame.white.mean()) for frame in frames])
    return whites.mean(axis=0)
