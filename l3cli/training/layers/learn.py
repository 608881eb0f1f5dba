"""Train a refinement layer: accumulate the sums and solve the transforms (docs/method.md#learning-on-mosaics).

As in the first layer, the sums of classes with few samples are supplemented with the sums of other classes. An unsaturated
class also uses samples from classes with neighbouring levels and strengths. Every class uses pseudo-samples from its
*parent*, a weighted mean of many classes. The parent of an unsaturated class is mainly the mean over all unsaturated classes
with the same level. The parent of a saturated class is a mean over all classes with the same saturation case, with larger
weights for nearby levels.
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
FADED_RESPONSE = 0.97  # transforms with a lower chroma gain in uniform areas would visibly desaturate them
OWN_LEVEL_FRACTION = 0.9  # fraction of the pseudo-samples from the class's own level; the others come from all levels


@dataclass(frozen=True)
class LayerGoal:
    """Parameters for solving the transforms of a refinement layer."""

    pool: tuple[float, ...]  # weights of samples from classes one level away, two levels away and so on
    parent: float  # number of pseudo-samples from the parent
    ridge: float  # ridge of the least-squares fit, relative to the mean power of a tap
    noise_weights: tuple[float, ...]  # (output) weight of the noise covariance in the fit
    white: Array  # (plane) planes of a white with Y = 1, which the layer must preserve
    windows: int  # number of window taps; all other taps are 0 in uniform areas
    # (output) index of the chroma plane that the output must not attenuate in unsaturated uniform areas, or -1 if the output
    # is not a chroma output; () if no output is constrained
    keeps: tuple[int, ...] = ()
    strength_pool: float = 0.0  # weight of samples from classes with the next lower and the next higher strength
    corrects: bool = False  # whether the layer's results are added to the first layer's outputs; they are 0 for white
    exact: bool = False  # whether uniform areas keep the planes in `keeps` exactly, as required for Stokes parameters


def solve_layer(
    sums: list[LayerSums], copies: list[int], rule: PlaneRule, goal: LayerGoal, equal: bool = True
) -> list[Array]:
    """Solve the transforms of a refinement layer, class by class.

    Uniform areas must look the same at all CFA sites, and greys must not gain a colour cast, even if they clip. The
    solutions of all sites are therefore constrained to a common response to uniform areas (docs/method.md#equal-response).

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
        raise L3Error("a refinement layer has no class with samples at every CFA site; simulate more or larger frames")
    fitting = solved & np.all([fits_between(one) for one in transforms], axis=0)
    source = _nearest(fitting if fitting.any() else solved, rule)
    return [one[source] for one in transforms]


def _solution(moments: Array, noise: Array, noise_weight: float, ridge: float, of: list[int], member: Array) -> Array:
    """Compute the Wiener solutions for some outputs, and their compliance.

    The compliance determines how the optimal taps change if the response to uniform areas is constrained. The solutions
    contain no intercept, so that black stays black.

    Parameters
    ----------
    moments : ndarray, (column, column)
        Moments of the taps, the intercept and the outputs.
    noise : ndarray, (column, column)
        Noise covariance of the taps and, if the layer corrects the first layer's outputs, of the outputs.
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
        The solution for each output, followed by the compliance for each plane.
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
    """Constrain the taps of all sites to a common response to uniform areas.

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
        Whether to preserve the chroma planes in `goal.keeps` if the common response would attenuate them or, for Stokes
        parameters, always.

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
        if plane >= 0 and (goal.exact or common[plane, column] + goal.corrects < FADED_RESPONSE):
            common[:, column] = 0 if goal.corrects else np.eye(len(white))[plane]
    return [
        one[:, :count] + one[:, count:] @ (k @ (common - r)) for one, k, r in zip(estimates, stiff, response, strict=True)
    ]


class _Parents:
    """Each parent's mean sums per sample.

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
    """Add the statistics of other classes to a class's moments and noise, or return None if its parent has no samples.

    The parent's pseudo-samples are always added. If the class is unsaturated and has samples, the samples of classes with
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
    """Map each class to the solved class that provides its transform.

    A solved class uses its own transform. An unsolved class uses the solved class with the same structure or saturation case
    at the nearest level. Without such a class, it uses the nearest solved class, preferably one without structure.
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
    """Settings for training one refinement layer, and the previous layers."""

    camera: CameraModel
    rule: ClassRule  # class rule of the first layer
    fixed: FixedPoint  # fixed-point transforms with which the first layer computes planes
    before: tuple[PlaneLayer, ...]  # refinement layers that have already been trained
    basis: NDArray[np.float64]  # (output, plane) opponent basis, which converts outputs to planes
    outputs: MosaicLayer | None  # first layer if the new layer corrects the first layer's outputs, otherwise None
    white_point: NDArray[np.float64]  # (output) outputs of a perfect white under the training illuminant, with Y = 1
    grey: NDArray[np.float64]  # (channel) signals of this perfect white, as fractions of full scale
    recipe: LayerRecipe
    learning: LearningRecipe
    mosaics: tuple[int, ...]  # (frame) number of mosaics to draw from each frame
    chroma: tuple[int, ...]  # indices of the outputs that correspond to the chroma planes
    pictures: bool  # whether the outputs are X, Y, Z
    stokes: bool  # whether the outputs contain Stokes parameters; their noise is as visible as luminance and chroma noise
    exposure: float  # mean exposure time of the training frames, in s
    seed: int

    @property
    def exposed(self) -> Exposed:
        """Settings for simulating mosaics."""
        dark = self.camera.dark_signal(self.exposure)
        inner = math.isqrt(math.ceil(self.recipe.rows / self.recipe.density) - 1) + 1
        margin = self.rule.radius + sum(margin_of(layer.side) for layer in self.before) + self.margin
        noisy = self.learning.noise != "none"
        achromatic = self.recipe.achromatic if self.outputs is None or self.stokes else 0.0
        return Exposed(self.camera, self.learning, dark, achromatic, noisy, inner, margin)

    @property
    def margin(self) -> int:
        """Largest distance, in pixels, between a pixel and the input pixels on which its output depends."""
        return margin_of(self.recipe.side)

    @property
    def blocks(self) -> list[range]:
        """Ranges of frames that are processed together."""
        return frame_blocks([count * self.recipe.rows for count in self.mosaics], LAYER_SAMPLES)

    @property
    def number(self) -> int:
        """Number of the layer in the table, counted from 1."""
        return 2 + len(self.before)

    def rng(self, frame: int, purpose: int) -> np.random.Generator:
        """Return the random number generator for a frame and a purpose. All of these generators are independent."""
        return np.random.default_rng([self.seed, self.number + 1, frame, purpose])

    def seer(self) -> Callable[[Mosaics], Seen]:
        """Return a function that renders mosaics with the previous layers."""
        first = FirstLayer(self.camera, self.rule, self.fixed, self.outputs)
        stages = [PlaneStage(layer, self.rule, self.basis) for layer in self.before]

        def see(mosaics: Mosaics) -> Seen:
            return functools.reduce(lambda seen, stage: stage.see(seen), stages, first.see(mosaics))

        return see

    def reading(self, side: int) -> Reading:
        """Return the order in which windows of `side` × `side` pixels are read at each site."""
        maps = self._site_maps()
        order = np.array([orientations(side)[one.orientation] for one in maps])
        ratios = self.recipe.ratio_taps
        return Reading(np.array([one.canonical for one in maps]), order, ratios, self.made, self.outputs is not None)

    @property
    def made(self) -> int:
        """Number of outputs: one per plane, or one per output of the table if the layer corrects the first layer."""
        return PLANES if self.outputs is None else len(self.basis)

    def grid_steps(self, rule: PlaneRule) -> NDArray[np.float64]:
        """Return the grid steps (level, pair) to which products of columns are rounded."""
        return grid_steps(rule, self.rule, self.camera, self.reading(self.recipe.side).taps, self.made)

    @property
    def turns(self) -> list[int]:
        """Each CFA site's orientation relative to its canonical site, as an index into `symmetry.orientations`."""
        return [one.orientation for one in self._site_maps()]

    def _site_maps(self) -> list[SiteMap]:
        neighbours = neighbourhoods(self.camera.cfa, self.rule.patch, len(self.camera.channels))
        return site_maps(neighbours.channel, self.rule.patch, self.learning.orientations(self.camera))


def no_sums(layer: LayerPass, rule: PlaneRule) -> dict[int, LayerSums]:
    reading = layer.reading(layer.recipe.side)
    return {site: empty_sums(rule, reading) for site in np.unique(reading.canonical).tolist()}


def sum_layer(
    layer: LayerPass, rule: PlaneRule, blocks: Iterable[tuple[int, Iterable[TrainingPair]]]
) -> dict[int, LayerSums]:
    """Draw samples from training frames, and accumulate the sums of each class at each site.

    Parameters
    ----------
    layer : LayerPass
        Settings for training the refinement layer, and the previous layers.
    rule : PlaneRule
        Class rule of the layer to be trained.
    blocks : iterable of (int, iterable of TrainingPair)
        For each block of frames, the index of its first frame, and its frames.

    Returns
    -------
    dict of int to LayerSums
        Sums by canonical site.
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
    """Yield random mosaics from frames. `first` is the index of the first frame. For `purpose`, see `LayerPass.rng`."""
    for index, frame in enumerate(frames, first):
        yield from mosaics_of(frame, layer.mosaics[index], layer.exposed, layer.rng(index, purpose))


def add_sums(sums: dict[int, LayerSums], more: dict[int, LayerSums]) -> None:
    """Add `more` to `sums` in place. The addition is exact, so the order of calls does not matter."""
    for site, part in more.items():
        add(sums[site], part)


def learn_layer(layer: LayerPass, rule: PlaneRule, sums: dict[int, LayerSums]) -> PlaneLayer:
    """Solve the transforms of a refinement layer.

    Parameters
    ----------
    layer : LayerPass
        Settings for training the refinement layer, and the previous layers.
    rule : PlaneRule
        Class rule of the layer.
    sums : dict of int to LayerSums
        Sums over all frames, by canonical site.

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
    kinds = corrects, layer.stokes
    goal = LayerGoal(*pools, recipe.ridge, noise_weights, white, windows, keeps, recipe.strength_pool, *kinds)
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
    """Average a canonical site's sums over the orientations that leave the CFA around the site unchanged.

    This is possible only if a rotation or reflection of the windows permutes the classes. It does not permute the leaves of
    a tree, so the sums for a tree are returned unchanged.
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
