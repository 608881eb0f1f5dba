"""Train a refinement layer: sum over the samples and solve the transforms (docs/method.md#learning-on-mosaics).

As in the first layer, classes with few samples are supported by other classes. An unsaturated class also uses samples of
classes with neighbouring levels and strengths. Every class uses pseudo-samples of a *parent*, which is a weighted mean of
many classes. The parent of an unsaturated class is mainly the mean over all unsaturated classes of the same level. The
parent of a saturated class is a mean over all classes of the same saturation case, with larger weights for nearby levels.
"""

import functools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.layers import PLANES, MosaicLayer, PlaneLayer, PlaneRule, rule_fields
from l3cli.artifacts.partial_sums import LayerSums
from l3cli.artifacts.plane_rules import StructureRule
from l3cli.artifacts.training_set import TrainingPair
from l3cli.classes.planes import CHROMA, LUMINANCE, FixedPoint
from l3cli.classes.refinement import label_planes
from l3cli.classes.windows import neighbourhoods
from l3cli.errors import L3Error
from l3cli.training.layers.mosaics import Exposed, FirstLayer, Mosaics, PlaneStage, Seen, margin_of, mosaics_of, sheets_of
from l3cli.training.layers.samples import GatheredSamples, Reading, empty_sums, grid_steps, require_exact, sample_weights
from l3cli.training.recipe import LayerRecipe, LearningRecipe
from l3cli.training.sums import add, moment_matrix, turned_places, width_of
from l3cli.training.symmetry import SiteMap, orientations, site_maps, stabilisers, turned_structures
from l3cli.training.systems import fits_between, solve_positive
from l3cli.training.training_pass import LAYER_SAMPLES, frame_blocks

Array = NDArray[np.float64]
FADED_RESPONSE = 0.97  # a transform fades a chroma plane if the plane's gain in uniform areas is below this value
OWN_LEVEL_FRACTION = 0.9  # fraction of the pseudo-samples that come from the level of the class; others come from all levels


@dataclass(frozen=True)
class LayerGoal:
    """Parameters for solving the transforms of a refinement layer."""

    pool: tuple[float, ...]  # weights of the samples of classes whose level differs by 1, by 2, and so on
    parent: float  # number of pseudo-samples from the parent
    ridge: float  # ridge of the least-squares fit, relative to the mean power of a tap
    noise_weights: tuple[float, ...]  # (output) weight of the noise covariance in the fit
    white: Array  # (plane) planes of a white with Y = 1; the layer must preserve this white
    windows: int  # number of window taps; the remaining taps are 0 in uniform areas
    # (output) chroma plane that the output preserves in uniform areas of unsaturated classes, or -1; () if no plane is kept
    keeps: tuple[int, ...] = ()
    strength_pool: float = 0.0  # weight of samples from the classes with the next lower and the next higher strength
    corrects: bool = False  # whether the layer corrects the outputs of the first layer; corrections are 0 for white


def solve_layer(
    sums: list[LayerSums], copies: list[int], rule: PlaneRule, goal: LayerGoal, equal: bool = True
) -> list[Array]:
    """Solve the transforms of a refinement layer, class by class.

    Uniform areas must have equal outputs at all CFA sites, and grey areas, even if clipped, must not gain a colour cast.
    The solutions of all sites are therefore constrained to a common response to uniform areas
    (docs/method.md#equal-response).

    Parameters
    ----------
    sums : list of LayerSums
        Sums of each canonical site over all frames.
    copies : list of int
        Number of CFA sites that each canonical site represents.
    rule : PlaneRule
        Class rule of the layer.
    goal : LayerGoal
        Parameters for solving the transforms.
    equal : bool
        Whether to constrain all sites to a common response.

    Returns
    -------
    list of ndarray, (class, tap + 1, output)
        Transforms of each canonical site. The last tap is the intercept.

    Raises
    ------
    L3Error
        If no class has samples at every site.
    """
    outputs, planes = len(goal.noise_weights), len(goal.white)
    taps, noisy = width_of(sums[0].moments) - 1 - outputs, width_of(sums[0].noise)
    member = np.zeros((taps, planes))  # (tap, plane)
    member[: goal.windows] = np.kron(np.eye(planes), np.ones((goal.windows // planes, 1)))
    transforms = [np.zeros((rule.classes_per_site, taps + 1, outputs)) for _ in sums]
    solved = np.zeros(rule.classes_per_site, bool)
    parents = [_Parents(one, rule) for one in sums]
    for index in range(rule.classes_per_site):
        shrunk = [_shrunk(one, parent, index, rule, goal) for one, parent in zip(sums, parents, strict=True)]
        whole = [(moment_matrix(one[0], taps + 1 + outputs), moment_matrix(one[1], noisy)) for one in shrunk if one]
        if len(whole) < len(sums):
            continue
        solved[index] = True
        keeps = bool(goal.keeps) and not rule.case(rule.split(index).kind)
        for noise_weight in dict.fromkeys(goal.noise_weights):
            of = [output for output, each in enumerate(goal.noise_weights) if each == noise_weight]
            estimates = [_solution(moments, noise, noise_weight, goal.ridge, of, member) for moments, noise in whole]
            if equal:
                estimates = _constrained(estimates, member, copies, goal, of, keeps)
            for site, one in enumerate(estimates):
                transforms[site][index, :taps, of] = one[:, : len(of)].T
    if not solved.any():
        raise L3Error("no class of a refinement layer has samples at every CFA site; simulate more frames or larger frames")
    fitting = solved & np.all([fits_between(one) for one in transforms], axis=0)
    source = _nearest(fitting if fitting.any() else solved, rule)
    return [one[source] for one in transforms]


def _solution(moments: Array, noise: Array, noise_weight: float, ridge: float, of: list[int], member: Array) -> Array:
    """Return the Wiener solutions for some outputs, and the compliance of these solutions.

    The compliance describes how the optimal taps change if the response to uniform areas is constrained. The solutions have
    no intercept, because black must stay black.

    Parameters
    ----------
    moments : ndarray, (column, column)
        Moments of the taps, the intercept and the outputs.
    noise : ndarray, (column, column)
        Noise covariance of the taps and, if the layer corrects outputs, of the outputs.
    noise_weight : float
        Factor by which the noise covariance is multiplied.
    ridge : float
        Ridge relative to the mean power of a tap.
    of : list of int
        Indices of the outputs to solve.
    member : ndarray, (tap, plane)
        1 if a tap belongs to a plane, otherwise 0.

    Returns
    -------
    ndarray, (tap, output + plane)
        One column per output with the solution, then one column per plane with the compliance.
    """
    taps, outputs = len(member), np.array(of)
    system = moments[:taps, :taps] + noise_weight * noise[:taps, :taps]
    right = moments[:taps, taps + 1 + outputs]
    if len(noise) > taps:
        right = right - noise_weight * noise[:taps, taps + outputs]
    system.reshape(-1)[:: taps + 1] += ridge * np.trace(system) / taps + 1e-12
    return solve_positive(system, np.column_stack([right, member]))[0]


def _constrained(
    estimates: list[Array], member: Array, copies: list[int], goal: LayerGoal, of: list[int], keeps: bool
) -> list[Array]:
    """Constrain the taps of all sites so that every site has the same response to uniform areas.

    The common response minimises the squared error and preserves white.

    Parameters
    ----------
    estimates : list of ndarray, (tap, output + plane)
        Result of `_solution` for each canonical site.
    member : ndarray, (tap, plane)
        1 if a tap belongs to a plane, otherwise 0.
    copies : list of int
        Number of CFA sites that each canonical site represents.
    goal : LayerGoal
        Parameters for solving the transforms.
    of : list of int
        Indices of the solved outputs.
    keeps : bool
        Whether the chroma planes in `goal.keeps` are preserved in uniform areas if the common response would fade these
        planes.

    Returns
    -------
    list of ndarray, (tap, output)
        Constrained taps of each canonical site.
    """
    white, count = goal.white, len(of)
    wanted = np.zeros(count) if goal.corrects else white[of]
    stiff = [np.linalg.pinv(member.T @ one[:, count:]) for one in estimates]
    response = [member.T @ one[:, :count] for one in estimates]
    total = sum((copy * k for copy, k in zip(copies, stiff, strict=True)), np.zeros((len(white), len(white))))
    total += 1e-9 * np.trace(total) / len(white) * np.eye(len(white))
    pull = sum((copy * k @ r for copy, k, r in zip(copies, stiff, response, strict=True)), np.zeros((len(white), count)))
    common, bend = np.linalg.solve(total, pull), np.linalg.solve(total, white)
    common += np.outer(bend, (wanted - white @ common) / (white @ bend))
    for column, output in enumerate(of):
        plane = goal.keeps[output] if keeps else -1
        if plane >= 0 and common[plane, column] + goal.corrects < FADED_RESPONSE:
            common[:, column] = 0 if goal.corrects else np.eye(len(white))[plane]
    return [
        one[:, :count] + one[:, count:] @ (k @ (common - r)) for one, k, r in zip(estimates, stiff, response, strict=True)
    ]


class _Parents:
    """The parents of all classes, as mean sums per sample.

    Unsaturated classes have one parent per level. Saturated classes have one parent per level and saturation case.
    """

    def __init__(self, sums: LayerSums, rule: PlaneRule) -> None:
        def means(values: Array) -> tuple[Array, Array]:
            by_kind = values.reshape(rule.levels, rule.kinds, -1)
            count = sums.count.reshape(rule.levels, rule.kinds, 1)
            free, number = by_kind[:, : rule.structures].sum(axis=1), count[:, : rule.structures].sum(axis=1)
            every = free.sum(axis=0) / max(number.sum(), 1)
            level = np.where(number > 0, free / np.maximum(number, 1), every)
            mixed = OWN_LEVEL_FRACTION * level + (1 - OWN_LEVEL_FRACTION) * every
            cases, many = by_kind[:, rule.structures :], count[:, rule.structures :]
            whole = cases.sum(axis=0) / np.maximum(many.sum(axis=0), 1)
            around = sum(np.roll(np.pad(cases, ((1, 1), (0, 0), (0, 0))), step, 0)[1:-1] for step in (-1, 0, 1))
            crowd = sum(np.roll(np.pad(many, ((1, 1), (0, 0), (0, 0))), step, 0)[1:-1] for step in (-1, 0, 1))
            smoothed = np.where(crowd > 0, around / np.maximum(crowd, 1), whole)
            return mixed, 0.8 * smoothed + 0.2 * whole

        self.moments, self.case_moments = means(sums.moments)
        self.noise, self.case_noise = means(sums.noise)
        self.has_case = sums.count.reshape(rule.levels, rule.kinds)[:, rule.structures :].sum(axis=0) > 0
        self.has_free = sums.count.reshape(rule.levels, rule.kinds)[:, : rule.structures].sum() > 0


def _shrunk(sums: LayerSums, parents: _Parents, index: int, rule: PlaneRule, goal: LayerGoal) -> tuple[Array, Array] | None:
    """Return the moments and the noise of a class with support from other classes, or None if the parent has no samples.

    Pseudo-samples of the parent are always added. If the class is unsaturated and has samples, samples of classes with
    neighbouring levels or strengths are also added.
    """
    _, level, kind = rule.split(index)
    case = int(rule.case(kind))
    if case:
        if not parents.has_case[case - 1]:
            return None
        return (
            sums.moments[index] + goal.parent * parents.case_moments[level, case - 1],
            sums.noise[index] + goal.parent * parents.case_noise[level, case - 1],
        )
    if not parents.has_free:
        return None
    moments, noise, count = sums.moments[index].copy(), sums.noise[index], sums.count[index]
    if count > 0:
        neighbours = [
            (share, rule.join(other, kind))
            for distance, share in enumerate(goal.pool, start=1)
            for other in (level - distance, level + distance)
            if 0 <= other < rule.levels
        ]
        if goal.strength_pool and isinstance(rule, StructureRule):
            neighbours += [(goal.strength_pool, rule.join(level, other)) for other in rule.next_strengths(kind)]
        for share, neighbour in neighbours:
            moments += share * sums.moments[neighbour]
            count += share * sums.count[neighbour]
        noise = noise * (count / sums.count[index])
    return moments + goal.parent * parents.moments[level], noise + goal.parent * parents.noise[level]


def _nearest(filled: NDArray[np.bool_], rule: PlaneRule) -> NDArray[np.int64]:
    """Return, for each class, the index of the solved class whose transform the class uses.

    A solved class uses its own transform. An unsolved class uses the transform of a solved class with the same structure or
    saturation case, at the nearest level. If there is no such class, solved classes without structure are preferred.
    """
    _, level, kind = rule.split(np.arange(filled.size))
    known = np.flatnonzero(filled)
    source = np.arange(filled.size)
    for index in np.flatnonzero(~filled):
        far = np.abs(level[known] - level[index]) + (kind[known] != kind[index]) * 1000 + (kind[known] > 0) * 100.0
        source[index] = known[np.argmin(far)]
    return source


@dataclass(frozen=True)
class LayerPass:
    """Settings for the training of one refinement layer, and results of the earlier layers."""

    camera: CameraModel
    rule: ClassRule  # class rule of the first layer
    fixed: FixedPoint  # fixed-point transforms of the first layer, which compute the planes
    before: tuple[PlaneLayer, ...]  # refinement layers that have already been trained
    basis: NDArray[np.float64]  # (output, plane) opponent basis, which converts outputs to planes
    outputs: MosaicLayer | None  # first layer, if the new layer corrects the outputs of the first layer; otherwise None
    white_point: NDArray[np.float64]  # (output) outputs of a perfect white under the training illuminant, with Y = 1
    grey: NDArray[np.float64]  # (channel) signals of this perfect white, as fractions of full scale
    recipe: LayerRecipe
    learning: LearningRecipe
    mosaics: tuple[int, ...]  # (frame) number of mosaics to draw from each frame
    chroma: tuple[int, ...]  # indices of the outputs that belong to the chroma planes
    pictures: bool  # whether the outputs are X, Y, Z
    stokes: bool  # whether the outputs contain Stokes parameters, whose noise is as visible as noise of luminance and chroma
    exposure: float  # mean exposure time of the training frames, in s
    seed: int

    @property
    def exposed(self) -> Exposed:
        """Settings for the simulation of the mosaics."""
        dark = self.camera.dark_signal(self.exposure)
        inner = math.isqrt(math.ceil(self.recipe.rows / self.recipe.density) - 1) + 1
        margin = self.rule.radius + sum(margin_of(layer.side) for layer in self.before) + self.margin
        noisy = self.learning.noise != "none"
        achromatic = self.recipe.achromatic if self.outputs is None or self.stokes else 0.0
        return Exposed(self.camera, self.learning, dark, achromatic, noisy, inner, margin)

    @property
    def margin(self) -> int:
        """Largest distance, in pixels, between a pixel and the input pixels that the layer reads for this pixel."""
        return margin_of(self.recipe.side)

    @property
    def blocks(self) -> list[range]:
        """Ranges of frames. All frames of a range are processed together."""
        return frame_blocks([count * self.recipe.rows for count in self.mosaics], LAYER_SAMPLES)

    @property
    def number(self) -> int:
        """Number of the layer in the table. The first layer has the number 1."""
        return 2 + len(self.before)

    def rng(self, frame: int, purpose: int) -> np.random.Generator:
        """Return a random generator for a frame. Generators with different values of `purpose` are independent."""
        return np.random.default_rng([self.seed, self.number + 1, frame, purpose])

    def seer(self) -> Callable[[Mosaics], Seen]:
        """Return a function that renders mosaics with all layers before the new layer."""
        first = FirstLayer(self.camera, self.rule, self.fixed, self.outputs)
        stages = [PlaneStage(layer, self.rule, self.basis) for layer in self.before]

        def see(mosaics: Mosaics) -> Seen:
            return functools.reduce(lambda seen, stage: stage.see(seen), stages, first.see(mosaics))

        return see

    def reading(self, side: int) -> Reading:
        """Return the settings for reading windows of `side` × `side` pixels in the orientation of the canonical site."""
        maps = self._site_maps()
        order = np.array([orientations(side)[one.orientation] for one in maps])
        ratios = self.recipe.ratio_taps
        return Reading(np.array([one.canonical for one in maps]), order, ratios, self.made, self.outputs is not None)

    @property
    def made(self) -> int:
        """Number of outputs: one per plane or, if the layer corrects the first layer, one per output of the table."""
        return PLANES if self.outputs is None else len(self.basis)

    def grid_steps(self, rule: PlaneRule) -> NDArray[np.float64]:
        """Return the grid steps to which the sums of the layer are rounded.

        The result has the axes (level, pair of columns).
        """
        return grid_steps(rule, self.rule, self.camera, self.reading(self.recipe.side).taps, self.made)

    @property
    def turns(self) -> list[int]:
        """For each CFA site, the number of the orientation in which the windows of the site are trained."""
        return [one.orientation for one in self._site_maps()]

    def _site_maps(self) -> list[SiteMap]:
        neighbours = neighbourhoods(self.camera.cfa, self.rule.patch, len(self.camera.channels))
        return site_maps(neighbours.channel, self.rule.patch, self.learning.orientations(self.camera))


def no_sums(layer: LayerPass, rule: PlaneRule) -> dict[int, LayerSums]:
    """Return empty sums for every canonical site, to which samples can be added."""
    reading = layer.reading(layer.recipe.side)
    return {site: empty_sums(rule, reading) for site in np.unique(reading.canonical).tolist()}


def sum_layer(
    layer: LayerPass, rule: PlaneRule, blocks: Iterable[tuple[int, Iterable[TrainingPair]]]
) -> dict[int, LayerSums]:
    """Draw samples from training frames, and add up their products by site and class.

    Parameters
    ----------
    layer : LayerPass
        Settings for the training of the refinement layer, and results of the earlier layers.
    rule : PlaneRule
        Class rule of the layer to be trained.
    blocks : iterable of (int, iterable of TrainingPair)
        Pairs (index of the first frame of a block, frames of the block).

    Returns
    -------
    dict of int to LayerSums
        Sums of each canonical site.
    """
    see, reading, sums = layer.seer(), layer.reading(layer.recipe.side), no_sums(layer, rule)
    noise = bool(layer.recipe.luminance_noise or layer.recipe.chroma_noise)
    gathered = GatheredSamples(sums, rule, reading, layer.basis, layer.grid_steps(rule), noise)
    for first, frames in blocks:
        rng = layer.rng(first, 3)
        for mosaics in sheets_of(drawn_mosaics(layer, frames, first, purpose=1), layer.camera.cfa.shape[0]):
            seen = see(mosaics)
            label = label_planes(seen.noisy, seen.label, rule, layer.rule)
            weight = sample_weights(seen, layer.basis, layer.white_point, layer.learning, layer.pictures)
            inner = seen.inner_pixels(layer.margin)
            pixels = inner if layer.recipe.density == 1 else inner[rng.random(inner.size) < layer.recipe.density]
            gathered.add(seen, label, pixels, weight)
        gathered.add_up()
    return sums


def drawn_mosaics(layer: LayerPass, frames: Iterable[TrainingPair], first: int, purpose: int) -> Iterator[Mosaics]:
    """Yield mosaics drawn from `frames`, beginning with frame number `first`. `purpose` is as in `LayerPass.rng`."""
    for index, frame in enumerate(frames, first):
        yield from mosaics_of(frame, layer.mosaics[index], layer.exposed, layer.rng(index, purpose))


def add_sums(sums: dict[int, LayerSums], more: dict[int, LayerSums]) -> None:
    """Add `more` to `sums` in place. The additions are exact, so the result does not depend on the order of the calls."""
    for site, part in more.items():
        add(sums[site], part)


def learn_layer(layer: LayerPass, rule: PlaneRule, sums: dict[int, LayerSums]) -> PlaneLayer:
    """Solve the transforms of a refinement layer from the sums of all canonical sites.

    Parameters
    ----------
    layer : LayerPass
        Settings for the training of the refinement layer, and results of the earlier layers.
    rule : PlaneRule
        Class rule of the layer.
    sums : dict of int to LayerSums
        Sums of each canonical site, over all frames.

    Returns
    -------
    PlaneLayer

    Raises
    ------
    L3Error
        If no class can be solved, or if a sum is too large for exact addition in float64.
    """
    for one in sums.values():
        require_exact(one, rule, layer.grid_steps(rule))
    recipe, reading = layer.recipe, layer.reading(layer.recipe.side)
    copies = [int((reading.canonical == site).sum()) for site in sums]
    chroma = dict(zip(layer.chroma, CHROMA, strict=True)) if layer.chroma else {}
    noise_weights = tuple(recipe.chroma_noise if each in chroma else recipe.luminance_noise for each in range(layer.made))
    if layer.outputs is None and not (layer.pictures or layer.stokes):
        noise_weights = (min(recipe.luminance_noise, 1.0),) * layer.made  # as in the first layer
    white, windows = np.eye(PLANES)[LUMINANCE], PLANES * recipe.side**2
    pools = (recipe.level_pool, recipe.parent_patches)
    keeps = tuple(chroma.get(each, -1) for each in range(layer.made)) if recipe.coarse_chroma else ()
    corrects = layer.outputs is not None
    goal = LayerGoal(*pools, recipe.ridge, noise_weights, white, windows, keeps, recipe.strength_pool, corrects)
    sums = {site: _symmetric(layer, rule, site, one) for site, one in sums.items()}
    solved = dict(
        zip(sums, solve_layer(list(sums.values()), copies, rule, goal, layer.learning.equal_response), strict=True)
    )
    back = np.linalg.inv(layer.basis) if layer.outputs is None else np.eye(layer.made)
    weights, intercept, samples = [], [], []
    for site, canonical in enumerate(reading.canonical.tolist()):
        transforms = np.swapaxes(solved[canonical] @ back, 1, 2)  # (class, output, tap + 1)
        taps = transforms[..., :windows].reshape(*transforms.shape[:2], PLANES, -1)
        turned = np.empty_like(taps)
        turned[..., reading.order[site]] = taps
        weights.append(np.concatenate([turned.reshape(*transforms.shape[:2], -1), transforms[..., windows:-1]], axis=-1))
        intercept.append(transforms[..., -1])
        samples.append(sums[canonical].count)
    return PlaneLayer(
        side=recipe.side,
        **rule_fields(rule),
        weights=np.concatenate(weights).astype(np.float32),
        intercept=np.concatenate(intercept).astype(np.float32),
        samples=np.concatenate(samples),
    )


def _symmetric(layer: LayerPass, rule: PlaneRule, site: int, sums: LayerSums) -> LayerSums:
    """Average the sums of a canonical site over the orientations that leave the CFA around the site unchanged.

    Rotating or reflecting a window permutes the structure classes. The leaves of a tree are not permuted in this way, so
    the sums for a tree are returned unchanged.
    """
    if not isinstance(rule, StructureRule):
        return sums
    window = neighbourhoods(layer.camera.cfa, layer.rule.patch, len(layer.camera.channels)).channel[site]
    alike = stabilisers(window, layer.rule.patch, layer.learning.orientations(layer.camera))
    moments, noise, count = (np.zeros_like(each) for each in (sums.moments, sums.noise, sums.count))
    for number in alike:
        turn = orientations(layer.recipe.side)[number]
        taps = np.concatenate([turn + plane * turn.size for plane in range(PLANES)])
        classes = turned_structures(rule, number)
        for total, each in ((moments, sums.moments), (noise, sums.noise)):
            total[classes] += each[:, turned_places(taps, width_of(each))] / len(alike)
        count[classes] += sums.count / len(alike)
    return LayerSums(moments, noise, count)
