"""A plane layer from training frames: its class rule, its sums, its transforms (docs/method.md#layers)."""

import functools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.partial_sums import LayerSums
from l3cli.artifacts.plane_rules import StructureRule
from l3cli.artifacts.table import RATIO_TAPS, PlaneLayer, PlaneRule, rule_fields
from l3cli.artifacts.training_set import TrainingPair
from l3cli.classes.planes import FixedPoint
from l3cli.classes.refinement import label_planes
from l3cli.classes.windows import neighbourhoods
from l3cli.training.layers.mosaics import Exposed, FirstLayer, Mosaics, PlaneStage, Seen, margin_of, mosaics_of, sheets_of
from l3cli.training.layers.rows import GatheredRows, Reading, empty_sums, grid_steps, require_exact, row_weights
from l3cli.training.layers.solve import LayerGoal, solve_layer
from l3cli.training.recipe import LayerRecipe, LearningRecipe
from l3cli.training.sums import add, turned_places, width_of
from l3cli.training.symmetry import orientations, site_maps, turned_structures
from l3cli.training.training_pass import LAYER_ROWS, frame_blocks


@dataclass(frozen=True)
class LayerPass:
    """All that the work on a plane layer, however it is divided, has in common."""

    camera: CameraModel
    rule: ClassRule  # of the first layer
    fixed: FixedPoint  # its transforms to the opponent basis
    before: tuple[PlaneLayer, ...]  # learned already, between the first and the one to be learned
    basis: NDArray[np.float64]  # (X Y Z, plane)
    white_point: NDArray[np.float64]  # (output) a perfect white under the training light, Y = 1
    grey: NDArray[np.float64]  # (channel) its signals, shares of full scale
    recipe: LayerRecipe
    learning: LearningRecipe
    mosaics: tuple[int, ...]  # (frame)
    pictures: bool  # whether the outputs are X, Y, Z
    exposure: float  # s
    seed: int

    @property
    def exposed(self) -> Exposed:
        dark = self.camera.dark_signal(self.exposure)
        inner = math.isqrt(math.ceil(self.recipe.rows / self.recipe.density) - 1) + 1
        margin = self.rule.radius + sum(margin_of(layer.side) for layer in self.before) + self.margin
        noisy = self.learning.noise != "none"
        return Exposed(self.camera, self.learning, dark, self.recipe.achromatic, noisy, inner, margin)

    @property
    def margin(self) -> int:
        """Return the pixels about each that the layer to be learned reads."""
        return margin_of(self.recipe.side)

    @property
    def blocks(self) -> list[range]:
        """Return the frames whose rows are sorted together."""
        return frame_blocks([count * self.recipe.rows for count in self.mosaics], LAYER_ROWS)

    @property
    def number(self) -> int:
        """Return the number of the layer to be learned, the first being 1."""
        return 2 + len(self.before)

    def rng(self, frame: int, purpose: int) -> np.random.Generator:
        """Return the generator of a frame of the training run, for one purpose."""
        return np.random.default_rng([self.seed, self.number + 1, frame, purpose])

    def seer(self) -> Callable[[Mosaics], Seen]:
        """Return a function that gives the planes of mosaics as the layers before make them."""
        first = FirstLayer(self.camera, self.rule, self.fixed)
        stages = [PlaneStage(layer, self.rule, self.basis) for layer in self.before]

        def see(mosaics: Mosaics) -> Seen:
            return functools.reduce(lambda seen, stage: stage.see(seen), stages, first.see(mosaics))

        return see

    def reading(self, side: int) -> Reading:
        """Return the reading of windows of `side` at every site."""
        maps, turns = self._turns()
        order = np.array([orientations(side)[turn] for turn in turns])
        return Reading(np.array([one.canonical for one in maps]), order, self.ratio_taps)

    @property
    def ratio_taps(self) -> int:
        return RATIO_TAPS if self.recipe.colour_ratios else 0

    def grid_steps(self, rule: PlaneRule) -> NDArray[np.float64]:
        """Return grid steps of the moments (level, pair)."""
        return grid_steps(rule, self.rule, self.camera, self.reading(self.recipe.side).taps, 3)

    @property
    def turns(self) -> list[int]:
        """Return the number (site) of the orientation in which a site is learned."""
        return self._turns()[1]

    def _turns(self):  # type: ignore[no-untyped-def]
        neighbours = neighbourhoods(self.camera.cfa, self.rule.patch, len(self.camera.channels))
        maps = site_maps(neighbours.channel, self.rule.patch, self.learning.symmetry)
        every = orientations(self.rule.patch)
        return maps, [next(k for k, turn in enumerate(every) if (turn == one.permutation).all()) for one in maps]


def no_sums(layer: LayerPass, rule: PlaneRule) -> dict[int, LayerSums]:
    """Return the sums of every canonical site over no frames."""
    reading = layer.reading(layer.recipe.side)
    return {site: empty_sums(rule, reading.taps, 3) for site in np.unique(reading.canonical).tolist()}


def sum_layer(
    layer: LayerPass, rule: PlaneRule, blocks: Iterable[tuple[int, Iterable[TrainingPair]]]
) -> dict[int, LayerSums]:
    """Return the sums of every canonical site over blocks (index of the first frame, frames)."""
    see, reading, sums = layer.seer(), layer.reading(layer.recipe.side), no_sums(layer, rule)
    noise = bool(layer.recipe.luminance_noise or layer.recipe.chroma_noise)
    gathered = GatheredRows(sums, rule, reading, layer.basis, layer.grid_steps(rule), noise)
    for first, frames in blocks:
        rng = layer.rng(first, 3)
        for mosaics in sheets_of(drawn_mosaics(layer, frames, first, purpose=1), layer.camera.cfa.shape[0]):
            seen = see(mosaics)
            label = label_planes(seen.noisy, seen.label, rule, layer.rule)
            weight = row_weights(seen, layer.basis, layer.white_point, layer.learning, layer.pictures)
            inner = seen.inner_pixels(layer.margin)
            pixels = inner if layer.recipe.density == 1 else inner[rng.random(inner.size) < layer.recipe.density]
            gathered.add(seen, label, pixels, weight)
        gathered.add_up()
    return sums


def drawn_mosaics(layer: LayerPass, frames: Iterable[TrainingPair], first: int, purpose: int) -> Iterator[Mosaics]:
    """Yield the mosaics of frames, of which `first` is the index of the first."""
    for index, frame in enumerate(frames, first):
        yield from mosaics_of(frame, layer.mosaics[index], layer.exposed, layer.rng(index, purpose))


def add_sums(sums: dict[int, LayerSums], more: dict[int, LayerSums]) -> None:
    """Add `more` to `sums` in place; exact, in whatever order."""
    for site, part in more.items():
        add(sums[site], part)


def learn_layer(layer: LayerPass, rule: PlaneRule, sums: dict[int, LayerSums]) -> PlaneLayer:
    """Return the layer from the sums of all canonical sites; L3Error if they have become too large to be exact."""
    for one in sums.values():
        require_exact(one, rule, layer.grid_steps(rule))
    recipe, reading = layer.recipe, layer.reading(layer.recipe.side)
    copies = [int((reading.canonical == site).sum()) for site in sums]
    noise = (recipe.chroma_noise, recipe.luminance_noise, recipe.chroma_noise)
    if not layer.pictures:
        noise = (min(recipe.luminance_noise, 1.0),) * 3  # as in the first layer
    white, windows = np.array([0.0, 1.0, 0.0]), 3 * recipe.side**2
    goal = LayerGoal(
        recipe.level_pool,
        recipe.parent_patches,
        recipe.ridge,
        noise,
        white,
        windows,
        recipe.coarse_chroma,
    )
    sums = {site: _symmetric(layer, rule, site, one) for site, one in sums.items()}
    solved = dict(
        zip(sums, solve_layer(list(sums.values()), copies, rule, goal, layer.learning.equal_response), strict=True)
    )
    back = np.linalg.inv(layer.basis)
    weights, intercept, samples = [], [], []
    for site, canonical in enumerate(reading.canonical.tolist()):
        rows = np.swapaxes(solved[canonical] @ back, 1, 2)  # (class, output, tap + 1)
        taps = rows[..., :windows].reshape(*rows.shape[:2], 3, -1)
        turned = np.empty_like(taps)
        turned[..., reading.order[site]] = taps
        weights.append(np.concatenate([turned.reshape(*rows.shape[:2], -1), rows[..., windows:-1]], axis=-1))
        intercept.append(rows[..., -1])
        samples.append(sums[canonical].count)
    return PlaneLayer(
        side=recipe.side,
        **rule_fields(rule),
        weights=np.concatenate(weights).astype(np.float32),
        intercept=np.concatenate(intercept).astype(np.float32),
        samples=np.concatenate(samples),
    )


def _symmetric(layer: LayerPass, rule: PlaneRule, site: int, sums: LayerSums) -> LayerSums:
    """Return the sums of a canonical site averaged over the orientations that leave its window of the mosaic as it is, each
    with the classes that it turns into one another; those of a tree's leaves, which no orientation does, as they are."""
    if not (layer.learning.symmetry and isinstance(rule, StructureRule)):
        return sums
    window = neighbourhoods(layer.camera.cfa, layer.rule.patch, len(layer.camera.channels)).channel[site]
    alike = [number for number, turn in enumerate(orientations(layer.rule.patch)) if (window[turn] == window).all()]
    moments, noise, count = (np.zeros_like(each) for each in (sums.moments, sums.noise, sums.count))
    for number in alike:
        turn = orientations(layer.recipe.side)[number]
        taps = np.concatenate([turn + plane * turn.size for plane in range(3)])
        classes = turned_structures(rule, number)
        for total, each in ((moments, sums.moments), (noise, sums.noise)):
            total[classes] += each[:, turned_places(taps, width_of(each))] / len(alike)
        count[classes] += sums.count / len(alike)
    return LayerSums(moments, noise, count)
