"""A plane layer from training frames: its class rule, its sums, its transforms (docs/method.md#layers)."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.layer_sums import LayerSums
from l3cli.artifacts.layers import PlaneLayer
from l3cli.artifacts.structure_rule import FACTORS, MOST_SHIFT, StructureRule
from l3cli.artifacts.training_set import TrainingPair
from l3cli.classes import structure
from l3cli.classes.later import label_planes
from l3cli.classes.planes import LUMINANCE, FixedPoint
from l3cli.classes.windows import neighbourhoods
from l3cli.training.layers.first import FirstLayer
from l3cli.training.layers.mosaics import Exposed, mosaics_of
from l3cli.training.layers.rows import Reading, add_rows, empty_sums, grid_steps, inner_pixels, require_exact, row_weights
from l3cli.training.layers.solve import LayerGoal, solve_layer
from l3cli.training.recipe import LayerRecipe, LearningRecipe
from l3cli.training.symmetry import orientations, site_maps

PASS = 3  # of the training run, after the two of the first layer
PILOT_MOSAICS = 48  # over all frames, that tell how noisy the first layer's luminance is
BRIGHTEST = 0.8  # share of full scale up to which they tell
FEWEST = 1000  # pixels of a level that tell


@dataclass(frozen=True)
class LayerPass:
    """All that the work on a plane layer, however it is divided, has in common."""

    camera: CameraModel
    rule: ClassRule  # of the first layer
    fixed: FixedPoint  # its transforms to the opponent basis
    basis: NDArray[np.float64]  # (X Y Z, plane)
    white_point: NDArray[np.float64]  # (output) a perfect white under the training light, Y = 1
    recipe: LayerRecipe
    learning: LearningRecipe
    mosaics: tuple[int, ...]  # (frame)
    exposure: float  # s
    seed: int

    @property
    def exposed(self) -> Exposed:
        dark = self.camera.dark_signal(self.exposure)
        return Exposed(self.camera, self.learning, dark, self.recipe.achromatic)

    @property
    def first_layer(self) -> FirstLayer:
        return FirstLayer(self.camera, self.rule, self.fixed)

    def reading(self, side: int) -> Reading:
        """How windows of `side` are read at every site."""
        maps, turns = self._turns()
        return Reading(np.array([one.canonical for one in maps]), np.array([orientations(side)[turn] for turn in turns]))

    def grid_steps(self, rule: StructureRule) -> NDArray[np.float64]:
        """Grid steps of the moments (level, pair)."""
        return grid_steps(rule, self.rule, self.camera, 3 * self.recipe.side**2, 3)

    def signs(self) -> NDArray[np.int8]:
        """Signs (site, component) of the structure tensor in the orientation that a site is learned in."""
        return np.array([structure.turn_signs(orientations(3)[turn]) for turn in self._turns()[1]], np.int8)

    def _turns(self):  # type: ignore[no-untyped-def]
        near = neighbourhoods(self.camera.cfa, self.rule.patch, len(self.camera.channels))
        maps = site_maps(near.channel, self.rule.patch, self.learning.symmetry)
        every = orientations(self.rule.patch)
        return maps, [next(k for k, turn in enumerate(every) if (turn == one.permutation).all()) for one in maps]


def luminance_noise(layer: LayerPass, frames: Iterable[TrainingPair], first: int, every: int) -> list[NDArray[np.float64]]:
    """Of every frame whose index, `first` that of the first, is a multiple of `every`: sums of squared differences that
    noise makes between pixels two apart of the luminance, and their number (2, level)."""
    see, measured = layer.first_layer.see, []
    for index, frame in enumerate(frames, first):
        if index % every:
            continue
        total = np.zeros((2, layer.rule.levels))
        rng = np.random.default_rng([layer.seed, PASS, index, 0])
        for mosaic in mosaics_of(frame, 1, layer.exposed, rng):
            seen = see(mosaic)
            noise = seen.noisy[LUMINANCE] - seen.clean[LUMINANCE]
            across, down = noise[1:-1, 2:] - noise[1:-1, :-2], noise[2:, 1:-1] - noise[:-2, 1:-1]
            place = layer.rule.split(seen.label)
            tells = ((layer.rule.case(place.kind) == 0) & (seen.brightness < BRIGHTEST))[1:-1, 1:-1]
            level = place.level[1:-1, 1:-1][tells]
            total[0] += np.bincount(level, ((across**2 + down**2) / 2)[tells], layer.rule.levels)
            total[1] += np.bincount(level, minlength=layer.rule.levels)
        measured.append(total)
    return measured


def structure_rule(layer: LayerPass, noise: Iterable[NDArray[np.float64]]) -> StructureRule:
    """The class rule of the layer from `luminance_noise` of all frames in order."""
    squares, count = np.sum([np.zeros((2, layer.rule.levels)), *noise], axis=0)
    known = np.flatnonzero((count >= min(FEWEST, count.max())) & (squares > 0))
    deviation = np.ones(layer.rule.levels)
    if known.size:
        spread = np.log(squares[known] / count[known]) / 2
        deviation = np.exp(np.interp(np.arange(layer.rule.levels), known, spread))
    scale = structure.SIGMA / deviation  # = factor / 2^shift, with a factor of 7 bits
    shift = np.clip(np.ceil(np.log2(FACTORS[0] / scale)), 0, MOST_SHIFT)
    factor = np.clip(np.rint(scale * 2**shift), 1, FACTORS[1])
    return StructureRule(
        level_step=layer.recipe.level_step,
        gradient_factor=factor.astype(np.uint8),
        gradient_shift=shift.astype(np.uint8),
        strength_edges=np.rint(np.array(layer.recipe.strengths) * structure.NOISE_TRACE).astype(np.uint32),
        coherence=round(64 * layer.recipe.coherence),
        turns=layer.signs(),
        cases=layer.rule.cases,
    )


def no_sums(layer: LayerPass, rule: StructureRule) -> dict[int, LayerSums]:
    """Sums of every canonical site over no frames."""
    side = layer.recipe.side
    return {site: empty_sums(rule, 3 * side**2, 3) for site in np.unique(layer.reading(side).canonical).tolist()}


def sum_layer(layer: LayerPass, rule: StructureRule, frames: Iterable[TrainingPair], first: int) -> dict[int, LayerSums]:
    """Sums of every canonical site over frames, `first` being the index of the first."""
    see, reading, sums = layer.first_layer.see, layer.reading(layer.recipe.side), no_sums(layer, rule)
    steps = layer.grid_steps(rule)
    for index, frame in enumerate(frames, first):
        rng = np.random.default_rng([layer.seed, PASS, index, 1])
        for mosaic in mosaics_of(frame, layer.mosaics[index], layer.exposed, rng):
            seen = see(mosaic)
            inner = inner_pixels(seen.label.shape)
            label = label_planes(seen.noisy, seen.label, rule, layer.rule)
            pixels = rng.choice(inner, min(layer.recipe.rows, inner.size), replace=False)
            powers = (layer.learning.brightness_power, layer.learning.error_power)
            weight = row_weights(seen, layer.basis, layer.white_point, *powers)
            add_rows(sums, seen, label, rule, reading, pixels, weight, layer.basis, steps)
    return sums


def add_sums(sums: dict[int, LayerSums], more: dict[int, LayerSums]) -> None:
    """Add `more` to `sums` in place; exact, in whatever order."""
    for site, part in more.items():
        whole = sums[site]
        for total, value in ((whole.moments, part.moments), (whole.noise, part.noise), (whole.count, part.count)):
            np.add(total, value, out=total)


def learn_layer(layer: LayerPass, rule: StructureRule, sums: dict[int, LayerSums]) -> PlaneLayer:
    """The layer from the sums of all canonical sites; L3Error if they have become too large to be exact."""
    for one in sums.values():
        require_exact(one, rule, layer.grid_steps(rule))
    recipe, reading = layer.recipe, layer.reading(layer.recipe.side)
    copies = [int((reading.canonical == site).sum()) for site in sums]
    noise = (recipe.chroma_noise, recipe.luminance_noise, recipe.chroma_noise)
    goal = LayerGoal(recipe.level_pool, recipe.parent_patches, recipe.ridge, noise, np.array([0.0, 1.0, 0.0]))
    solved = dict(
        zip(sums, solve_layer(list(sums.values()), copies, rule, goal, layer.learning.equal_response), strict=True)
    )
    back = np.linalg.inv(layer.basis)
    weights, intercept, samples = [], [], []
    for site, canonical in enumerate(reading.canonical.tolist()):
        rows = np.swapaxes(solved[canonical] @ back, 1, 2)  # (class, output, tap + 1)
        taps = rows[..., :-1].reshape(*rows.shape[:2], 3, -1)
        turned = np.empty_like(taps)
        turned[..., reading.order[site]] = taps
        weights.append(turned.reshape(*rows.shape[:2], -1))
        intercept.append(rows[..., -1])
        samples.append(sums[canonical].count)
    return PlaneLayer(
        side=recipe.side,
        rule=rule,
        weights=np.concatenate(weights).astype(np.float32),
        intercept=np.concatenate(intercept).astype(np.float32),
        samples=np.concatenate(samples),
    )
