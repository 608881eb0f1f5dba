"""The training room's front: what the command calls, in the order it calls it."""

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.base import Stage
from l3cli.artifacts.table import ClassRule, TransformTable
from l3cli.artifacts.training_set import TrainingPair, TrainingSet
from l3cli.classify import make_rule, neighbourhoods, saturation_codes
from l3cli.train.kinds import channel_shares, choose_cases, choose_chromas
from l3cli.train.patches import draw_levels, expose_patches, patches_of
from l3cli.train.recipe import TrainingRecipe, check_learning
from l3cli.train.solve import Goal, Solution, equal_responses, solve
from l3cli.train.sums import Sums, accumulate, symmetrise
from l3cli.train.symmetry import site_maps, stabilisers
from l3cli.train.weighing import Judge

PILOT_PATCHES = 4000  # patches a site over all frames that decide which saturation cases are kept


def training_rule(
    frames: Iterable[TrainingPair], total: int, head: TrainingSet, recipe: TrainingRecipe, seed: int
) -> ClassRule:
    """The class rule for `head.camera`; its saturation cases and chroma centres come from a pilot sample of the frames."""
    check_learning(recipe.learning)
    camera = head.camera
    codes = 2 ** len(camera.channels)
    rule = make_rule(recipe.classes, camera, np.zeros(codes, dtype=np.uint16))
    near = neighbourhoods(camera.cfa, rule.patch, len(camera.channels))
    canonical = canonical_sites(head, rule)
    occurrences = np.zeros(codes, dtype=np.int64)
    shares = []
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
            shares.append(channel_shares(patches.signal, near, site))
    case_of_code = choose_cases(occurrences, recipe.classes.max_cases)
    centres = choose_chromas(np.concatenate(shares), recipe.classes.chromas, seed)
    return make_rule(recipe.classes, camera, case_of_code, centres)


def canonical_sites(head: TrainingSet, rule: ClassRule) -> list[int]:
    """The sites that are trained; all others are their rotations or mirror images."""
    near = neighbourhoods(head.camera.cfa, rule.patch, len(head.camera.channels))
    return sorted({site_map.canonical for site_map in site_maps(near.channel, rule.patch)})


def train_site(
    read_frames: Callable[[], Iterable[TrainingPair]],
    total: int,
    head: TrainingSet,
    rule: ClassRule,
    site: int,
    recipe: TrainingRecipe,
    white_point: NDArray[np.float64],
    seed: int,
) -> Solution:
    """Solutions of one canonical site from the `total` frames, read in turn once a pass; `white_point` (output), Y = 1."""
    goal = Goal(head.outputs, white_point)
    learning = recipe.learning
    near = neighbourhoods(head.camera.cfa, rule.patch, len(head.camera.channels))
    window = near.channel[site]

    def one_pass(number: int, draws: int, judge: Judge | None) -> Solution:
        sums = Sums.empty(rule.classes_per_site, rule.patch**2, len(head.outputs))
        count = -(-learning.patches // total)
        for index, frame in enumerate(read_frames()):
            rng = np.random.default_rng([seed, number, index, site])
            patches = patches_of(frame, head, near, site, count, rng)
            accumulate(sums, patches, head.camera, rule, near, site, learning, draws, judge, rng)
        return solve(symmetrise(sums, stabilisers(window, rule.patch)), rule, window, learning, goal)

    judge = None
    if learning.first_draws and head.outputs == ("X", "Y", "Z"):
        first = one_pass(1, learning.first_draws, None)
        (filled,) = equal_responses([first], [1], rule, learning, goal)
        judge = Judge(np.swapaxes(filled.weights, 1, 2), filled.intercept, white_point)
    return one_pass(2, learning.draws, judge)


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
