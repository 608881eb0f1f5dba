"""Solve the first layer's transforms from the accumulated sums (docs/method.md#solution).

The transform of each class is a Wiener filter. Classes with few patches are supplemented in three ways
(docs/method.md#classes-with-few-patches):

* **Neighbouring levels.** The sums of the neighbouring levels are added with weights below 1. They are a good substitute,
  because samples are normalised by their level, and transforms change slowly with level.
* **Pseudo-patches.** A class with fewer patches than taps has no unique solution. A class with slightly more patches
  overfits their noise. Therefore, the mean sums of the class's *parent* are added, with the weight of `parent_patches`
  patches. The parent is mainly the mean over all classes with the same level, contrast and saturation case. In a class with
  many patches, the pseudo-patches have hardly any effect. A class without patches gets its parent's transform.
* **Nearest class.** If the parent has no patches either, the class uses the transform of the nearest solved class.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.partial_sums import ClassSums
from l3cli.errors import L3Error
from l3cli.physics.display import XYZ
from l3cli.physics.stokes import STOKES
from l3cli.training import systems
from l3cli.training.goal import Goal
from l3cli.training.highlights import flat_moments, grey_patches, plain_colours, steps_back, white_channels
from l3cli.training.lines import split_noise
from l3cli.training.plain_surfaces import at_taps, has_single_bands, output_gains, single_bands
from l3cli.training.recipe import LearningRecipe
from l3cli.training.sums import moment_matrix, turned_places, width_of
from l3cli.training.symmetry import Turn

Array = NDArray[np.float64]
# A parent is a weighted mean of two terms: the mean over its own level, and the mean over all levels of its saturation case.
# The weight of the second term is 1 if the parent's level has no patches, 0.55 for THIN_PARENT patches, and approaches
# CASE_SHARE for many patches.
CASE_SHARE = 0.1
THIN_PARENT = 100.0


def shrunk(
    sums: ClassSums, parents: ClassSums, classes: NDArray[np.intp], rule: ClassRule, recipe: LearningRecipe
) -> tuple[Array, Array]:
    """Add pseudo-patches, and the sums of neighbouring levels, to the sums of classes.

    Every class receives `parent_patches` pseudo-patches of its parent. Unsaturated classes also receive the sums of the
    neighbouring levels, with the weights `level_pool` (docs/method.md#classes-with-few-patches).

    Parameters
    ----------
    sums : ClassSums
        Sums of all classes of a site.
    parents : ClassSums
        Result of `parents_of`.
    classes : ndarray, (class)
        Class numbers, either all saturated or all unsaturated.
    rule : ClassRule
        Class rule of the first layer.
    recipe : LearningRecipe
        The [learning] section of the class recipe.

    Returns
    -------
    moments : ndarray, (class, pair)
        Packed moments of each class.
    noise : ndarray, (class, noise column)
        Noise sums of each class.
    """
    _, level, contrast, combination, kind = rule.split(classes)
    moments, noise, count = sums.moments[classes], sums.noise[classes], sums.count[classes]
    own = np.maximum(count, 1e-9)
    for distance, weight in enumerate(() if rule.case(kind).any() else recipe.level_pool, start=1):
        for other in (level - distance, level + distance):
            helped = np.flatnonzero((own >= 1) & (other >= 0) & (other < rule.levels))
            neighbour = rule.join(other, contrast, kind, combination=combination)[helped]
            moments[helped] += weight * sums.moments[neighbour]
            count[helped] += weight * sums.count[neighbour]
    noise *= (count / own)[:, None]  # the class's own noise sums, scaled to the pooled number of patches
    parent = parent_of(classes, rule)
    moments += recipe.parent_patches * parents.moments[parent]
    noise += recipe.parent_patches * parents.noise[parent]
    return moments, noise


def parents_of(sums: ClassSums, rule: ClassRule) -> ClassSums:
    """Compute the sums per patch that supplement classes with few patches (docs/method.md#classes-with-few-patches).

    There is one parent for each level, contrast and saturation case. Its sums are a weighted mean of two terms:

    1. the sums per patch of all classes with this level, contrast and saturation case. If these classes have no patches, all
       contrasts are included;
    2. the sums per patch of all classes with this saturation case, at any level and contrast. The fewer patches the level
       has, the larger is the weight of this term.

    The returned `count` is the number of patches with the level and saturation case of each parent, at any contrast.
    """
    first = np.unique(rule.case(np.arange(rule.kinds)), return_index=True)[1]  # first kind of each saturation case

    def by_case(values: Array) -> Array:
        return np.add.reduceat(values.reshape(*rule.shape, -1), first, axis=3).sum(axis=2)

    count = by_case(sums.count)
    level_count = np.broadcast_to(count.sum(axis=1, keepdims=True), count.shape)

    def means(values: Array) -> Array:
        summed = by_case(values)
        smoothed = summed / np.maximum(count, 1e-9)
        level = summed.sum(axis=1, keepdims=True) / np.maximum(count.sum(axis=1, keepdims=True), 1e-9)
        case = summed.sum(axis=(0, 1)) / np.maximum(count.sum(axis=(0, 1)), 1e-9)
        known = (1 - CASE_SHARE) * level_count / (level_count + THIN_PARENT)
        mean = known * np.where(count > 0, smoothed, level) + (1 - known) * case
        return mean.reshape(-1, summed.shape[-1])

    return ClassSums(means(sums.moments), means(sums.noise), level_count.reshape(-1).copy())


def parent_of(index: Any, rule: ClassRule) -> Any:
    """Return the parent's index for each class index."""
    place = rule.split(index)
    return rule.join_cases(place.level, place.contrast, rule.case(place.kind))


# In textured classes of spectral tables, the response of a site may deviate from the common response. The deviation is
# penalised like an error in uniform patches that have this fraction of the power of the class's own patches.
UNIFORM_WEIGHT = 0.2
# If noise has μ times the power of the signal, uniform surfaces have the weight 1 / (1 + 1000 μ + (2000 χ μ)²). χ is 1 for
# the chroma of white and falls to 0 away from white (docs/method.md#uniform-surfaces).
NOISE_FADES = 1000.0
WHITE_FADES = 2000.0
# Weight of uniform surfaces in classes with a direction, relative to classes without a direction, if the rule has several
# chromas. A larger weight makes dark pictures worse (docs/notebook.md#surfaces-in-classes-with-a-direction).
DIRECTED_SURFACES = 0.01
CLASSES_AT_ONCE = 64  # number of classes in a batch of linear systems


class OutputKind(NamedTuple):
    """Settings of an output's least-squares problem."""

    noise_weight: float  # weight of noise relative to bias (docs/method.md#noise-weights)
    # Whether the output is also trained on uniform greys, surfaces and single bands (docs/method.md#clipped-areas). For
    # luminance, this is true only if uniform areas have separate classes, because clipped textures and clipped uniform areas
    # differ in mean luminance.
    uniform_patches: bool


@dataclass(frozen=True)
class Solution:
    """Wiener solutions for all classes of one canonical site, in the opponent basis (docs/method.md#equal-response).

    A transform's *response* consists of the sum of its taps in each channel, and its intercept. It determines how uniform
    areas are rendered. The *compliance* determines how the optimal taps change if the response is constrained to another
    value.
    """

    taps: Array  # (class, tap + 1, output); the last tap is the intercept
    response: Array  # (class, channel + 1, output); the last row is the intercept
    compliance: Array  # (class, distinct OutputKind, tap + 1, channel + 1)
    compliance_response: Array  # (class, distinct OutputKind, channel + 1, channel + 1) compliance, summed per channel
    solved: NDArray[np.bool_]  # (class) whether the class has a solution
    samples: Array  # (class) number of the class's own patches, averaged over the orientations
    condition: Array  # (class) largest condition number over the outputs, or 0 if the class has no solution
    colours: Array  # (channel, channel) second moments of the channel means over uniform patches, scaled to a trace of 1
    white: Array | None  # (channel) signals of white, or None if unknown
    power: Array  # (class) squared channel means, summed over the patches of the class, its neighbours and its parent
    outputs: Array  # (output, output) second moments of the targets, summed over unsaturated classes


@dataclass(frozen=True)
class Transforms:
    """Transforms for all classes of one site, for taps in fractions of full scale."""

    weights: Array  # (class, output, tap)
    intercept: Array  # (class, output)
    samples: Array  # (class) number of the class's own patches
    condition: Array  # (class) condition number


def solve(
    sums: ClassSums, rule: ClassRule, window: NDArray[np.int64], turns: list[Turn], recipe: LearningRecipe, goal: Goal
) -> Solution:
    """Solve the transforms of one canonical site, class by class, by least squares.

    The solution is T = Y Xᵀ (X Xᵀ + Λ)⁻¹. Each column of X contains the taps of a training patch, and the same column of Y
    contains its target. Λ is the weighted noise covariance. The sums of classes with few patches are supplemented with the
    sums of neighbouring levels and of their parents. If neither a class nor its parent has patches, the class has no
    solution.

    Parameters
    ----------
    sums : ClassSums
        Sums of all classes of the site.
    rule : ClassRule
        Class rule of the first layer.
    window : ndarray, (tap)
        Channel of each tap.
    turns : list of Turn
        Orientations that leave the CFA layout of the window unchanged. The sums are averaged over these orientations.
    recipe : LearningRecipe
        The [learning] section of the class recipe.
    goal : Goal
        The training goal.

    Returns
    -------
    Solution
        The optimal taps of each class, and how they change if the response is constrained.

    Raises
    ------
    L3Error
        If no class has training patches.
    """
    parents = parents_of(sums, rule)
    parent = parent_of(np.arange(sums.count.size), rule)
    samples = np.mean([sums.count[turn.classes] for turn in turns], axis=0)
    solved = parents.count[parent] > 0 if recipe.parent_patches else samples > 0
    if not solved.any():
        raise L3Error("no class has training patches; simulate more frames")
    groups = np.append(window, window.max() + 1)  # the intercept is treated as an additional channel
    member = (groups[None] == np.arange(groups.max() + 1)[:, None]).astype(np.float64)
    equations = _equations(recipe, goal, rule)
    basis = _opponent_basis(goal)
    white = white_channels(sums, rule, window, goal.white, goal.white_signal, goal.white_error)
    levels = goal.black_level, goal.white_level
    greys = grey_patches(sums, rule, window, goal.white, *levels, white, goal.filters, goal.sensitivity)
    surfaces = _surfaces(rule, window, goal, white) if recipe.plain_surfaces else {}
    near_white = _near_white(rule, goal)
    gains = None
    if goal.outputs == goal.channels:
        gains = output_gains(flat_moments(sums, rule, groups.size + len(goal.outputs)), window)
    taps = np.zeros((solved.size, groups.size, len(goal.outputs)))
    compliance = np.zeros((solved.size, len(set(equations)), groups.size, len(member)))
    condition, power = np.zeros(solved.size), np.zeros(solved.size)
    means = member[:-1, :-1] / member[:-1, :-1].sum(axis=1, keepdims=True)
    columns = {one: [column for column, each in enumerate(equations) if each == one] for one in sorted(set(equations))}
    saturated = rule.case(rule.split(np.arange(solved.size)).kind) > 0
    for clips in (False, True):
        used = groups.size if clips else groups.size - 1  # only saturated classes have an intercept
        every = np.flatnonzero(solved & (saturated == clips))
        for first in range(0, every.size, CLASSES_AT_ONCE):
            batch = every[first : first + CLASSES_AT_ONCE]
            moments, noise, shared = _averaged(sums, parents, batch, turns, rule, recipe)
            supplemented = moments.copy()
            for place, index in enumerate(batch.tolist()):
                count = samples[index] + recipe.parent_patches
                if index in greys:
                    supplemented[place] += count * greys[index]
                elif gains is not None and has_single_bands(rule, index):
                    supplemented[place] += single_bands(moments[place], window, gains)
                elif (plain := surfaces.get(index)) is not None:
                    noisy = noise[place].sum() / moments[place].diagonal()[: window.size].sum()
                    fades = 1.0 + NOISE_FADES * noisy + (near_white[index] * noisy) ** 2
                    supplemented[place] += recipe.plain_surfaces * (count / fades) * plain
            power[batch] = (means @ supplemented[:, : window.size, : window.size] * means).sum(axis=(1, 2))
            for number, ((noise_weight, uniform_patches), wanted) in enumerate(columns.items()):
                of = supplemented if uniform_patches else moments
                flat = np.broadcast_to(member.T[:used], (batch.size, used, len(member)))
                right = np.concatenate([of[:, :used, groups.size :] @ basis[:, wanted], flat], axis=2)
                system = systems.Equations(of[:, :used, :used], noise, noise_weight, right, shared)
                solution, worst = systems.solve_within(system, recipe.ridge, member[:, :used], goal.integers)
                taps[batch[:, None, None], np.arange(used)[:, None], wanted] = solution[..., : len(wanted)]
                compliance[batch, number, :used] = solution[..., len(wanted) :]
                condition[batch] = np.maximum(condition[batch], worst)
    targets = moment_matrix(sums.moments[~saturated].sum(axis=0), width_of(sums.moments))[groups.size :, groups.size :]
    about = solved, samples, condition, plain_colours(sums, rule, window), white, power, targets
    return Solution(taps, member @ taps, compliance, member @ compliance, *about)


def _averaged(
    sums: ClassSums, parents: ClassSums, batch: NDArray[np.intp], turns: list[Turn], rule: ClassRule, recipe: LearningRecipe
) -> tuple[Array, Array, Array | None]:
    """Average the results of `shrunk` for a batch of classes over the orientations `turns`.

    Returns
    -------
    moments : ndarray, (class, column, column)
        Moment matrices.
    noise : ndarray, (class, tap)
        Noise variances.
    shared : ndarray, (class, tap, tap), or None
        Covariances of taps in the same row or column. None if the camera has no line noise.
    """
    width, taps = width_of(sums.moments), rule.patch**2
    moments, noise, shared = np.zeros((batch.size, sums.moments.shape[1])), np.zeros((batch.size, taps)), None
    for turn in turns:
        turned_moments, turned_noise = shrunk(sums, parents, turn.classes[batch], rule, recipe)
        moments += turned_moments[:, turned_places(turn.taps, width)] / len(turns)
        variance, covariance = split_noise(turned_noise, taps)
        noise += variance[:, turn.taps] / len(turns)
        if covariance is not None:
            turned = covariance[:, turn.taps[:, None], turn.taps] / len(turns)
            shared = turned if shared is None else shared + turned
    return moment_matrix(moments, width), noise, shared


def _surfaces(rule: ClassRule, window: NDArray[np.int64], goal: Goal, white: Array | None) -> dict[int, Array]:
    """Return the moments of additional uniform patches for unsaturated classes of the lowest contrast, by class.

    Only these classes are trained on uniform patches, so that textured surfaces keep their colour. The patches are measured
    surfaces or, if the outputs contain S1 and S2, a polarised grey. In classes with a direction, the patches have the
    weight `DIRECTED_SURFACES`, unless the rule has only one chroma. Chromas that occur only in stripes are trained on
    stripes, in classes of any direction.

    The dict is empty if the goal contains neither surfaces nor a polarised grey. It is also empty if the goal contains
    surfaces, but `white` (from `white_channels`) does not come from the camera model.
    """
    plain: dict[int, Array]
    if goal.polarised is not None:
        plain = dict.fromkeys(range(rule.chromas), at_taps(goal.polarised, window))
    elif goal.surfaces is None or white is None or goal.white_signal is None or not np.array_equal(white, goal.white_signal):
        return {}
    else:
        plain = {chroma: each for chroma, each in enumerate(goal.surfaces.moments(rule, window)) if each is not None}
    levels = np.arange(rule.levels)
    every = np.arange(rule.combinations)[:, None]  # a pixel near a uniform area's border may have a direction
    trained: dict[int, Array] = {}
    directed = 1.0 if rule.chromas == 1 else DIRECTED_SURFACES
    for chroma, each in plain.items():
        trained |= dict.fromkeys(rule.join(levels, 0, chroma).tolist(), each)
        trained |= dict.fromkeys(np.ravel(rule.join(levels, 0, chroma, combination=every[1:])).tolist(), directed * each)
    if goal.surfaces is None:
        return trained
    for chroma, each in goal.surfaces.moments_of_stripes(rule, window).items():
        trained |= dict.fromkeys(np.ravel(rule.join(levels, 0, chroma, combination=every)).tolist(), each)
    return trained


def _near_white(rule: ClassRule, goal: Goal) -> Array:
    """Return the factor 2000 χ of each class (see WHITE_FADES).

    Noise moves some greys into the classes of chromas close to white. These greys must stay grey, so uniform surfaces have
    less weight in noisy classes close to white.
    """
    kind = rule.split(np.arange(rule.classes_per_site)).kind
    if goal.surfaces is None:
        return np.zeros(kind.size)
    return np.asarray(goal.surfaces.nearness(rule)[np.minimum(kind, rule.chromas - 1)] * WHITE_FADES)


def equal_responses(
    solutions: list[Solution], copies: list[int], rule: ClassRule, recipe: LearningRecipe, goal: Goal
) -> list[Transforms]:
    """Constrain the transforms of all sites to a common response (docs/method.md#equal-response).

    All sites then render a uniform patch identically, and white is rendered exactly as white. For spectral outputs, the
    responses of textured classes may differ between sites if this reduces the error. If a class is not solved at every site,
    it uses the transforms of the nearest class that is.

    Parameters
    ----------
    solutions : list of Solution
        Solution of each canonical site.
    copies : list of int
        Number of CFA sites that each canonical site represents.
    rule : ClassRule
        Class rule of the first layer.
    recipe : LearningRecipe
        The [learning] section of the class recipe.
    goal : Goal
        The training goal.

    Returns
    -------
    list of Transforms
        Transforms of each canonical site.

    Raises
    ------
    L3Error
        If no class has a solution at every site.
    """
    solved = np.all([solution.solved for solution in solutions], axis=0)
    if not solved.any():
        raise L3Error("no class has training patches at every CFA site; simulate more frames")
    constrained = [solution.taps for solution in solutions]
    if recipe.equal_response:
        constrained = _constrained(solutions, copies, rule, solved, goal, _equations(recipe, goal, rule))
    back = np.linalg.inv(_opponent_basis(goal))
    if goal.integers is not None:
        fitting = solved & np.all([systems.fits(taps @ back, goal.white, goal.integers) for taps in constrained], axis=0)
        solved = fitting if fitting.any() else solved
    transforms = []
    for solution, taps in zip(solutions, constrained, strict=True):
        filled = np.swapaxes(taps @ back, 1, 2)[_nearest(solved, rule)]
        transforms.append(Transforms(filled[..., :-1], filled[..., -1], solution.samples, solution.condition))
    return transforms


def _constrained(
    solutions: list[Solution],
    copies: list[int],
    rule: ClassRule,
    solved: NDArray[np.bool_],
    goal: Goal,
    equations: list[OutputKind],
) -> list[Array]:
    """Find the common response with the least error, and return each site's taps constrained to it.

    White is rendered exactly if `_exact_white` returns its signals. If the outputs contain Stokes parameters, white that is
    polarised equally at all wavelengths is also rendered exactly. The luminance of a grey that gets brighter must not drop
    when its last channel clips (see `steps_back`).
    """
    constrained = [solution.taps.copy() for solution in solutions]
    saturated = rule.case(rule.split(np.arange(solved.size)).kind) > 0
    white = _exact_white(solutions, goal)
    rising = solutions[0].white if goal.outputs[:3] == XYZ else None
    of_white = (_opponent_basis(goal).T @ goal.white).tolist()
    colour_compliance = np.pad(_colour_compliance(solutions, copies), (0, 1))
    # If there are many bands, each band has few pixels, and textures are more accurate if the responses of the sites may
    # differ. In colour pictures, even small differences between sites would be visible.
    free = (rule.split(np.arange(solved.size)).contrast > 0) & (goal.outputs[:3] not in (XYZ, STOKES))
    for kind in (False, True):
        used = slice(None) if kind else slice(0, -1)  # unsaturated classes have no intercept
        members = np.flatnonzero(solved & (saturated == kind))
        for output, each in enumerate(equations):
            number = sorted(set(equations)).index(each)
            stiffness = []
            for solution in solutions:
                compliance_response = solution.compliance_response[members, number][:, used, used]
                wide = np.where(free[members], 1 / (UNIFORM_WEIGHT * np.maximum(solution.power[members], 1e-12)), 0.0)
                compliance_response = compliance_response + wide[:, None, None] * colour_compliance[used, used]
                stiffness.append(np.linalg.inv(compliance_response))
            response = [solution.response[members][:, used, output, None] for solution in solutions]
            total = sum(copy * stiff for copy, stiff in zip(copies, stiffness, strict=True))
            pull = sum(copy * k @ r for copy, k, r in zip(copies, stiffness, response, strict=True))
            common = np.linalg.solve(total, pull)
            if white is not None and not kind and goal.stokes_signals is not None:
                lights = np.stack([white, *goal.stokes_signals], axis=1)
                name = goal.outputs[output]
                wanted = np.array([of_white[output], name == "S1", name == "S2"])[:, None]
                bend = np.linalg.solve(total, np.broadcast_to(lights, (*common.shape[:2], 3)))
                common = common + bend @ np.linalg.solve(lights.T @ bend, wanted - lights.T @ common)
            elif white is not None and not kind:
                bend = np.linalg.solve(total, np.broadcast_to(white[:, None], common.shape))
                missing = of_white[output] - white @ common
                common = common + bend * (missing / (white @ bend))[:, None]
            if kind and rising is not None and output == XYZ.index("Y") and members.size:
                last, missing = steps_back(common[..., 0], members, rule, rising, goal.black_level, goal.white_level)
                bend = np.linalg.solve(np.asarray(total)[last], np.ones((last.size, common.shape[1], 1)))
                common[last] += bend * (missing / bend.sum(axis=(1, 2)))[:, None, None]
            for site, (stiff, separate) in enumerate(zip(stiffness, response, strict=True)):
                change = solutions[site].compliance[members, number][:, :, used] @ (stiff @ (common - separate))
                constrained[site][members, :, output] += change[..., 0]
    return constrained


def _exact_white(solutions: list[Solution], goal: Goal) -> Array | None:
    """Return the camera model's signals of white, or None if white need not be rendered exactly.

    White is rendered exactly if the camera model predicts its signals, the patches of every site agree with them, and the
    outputs are colours or Stokes parameters.
    """
    known, estimates = goal.white_signal, [solution.white for solution in solutions]
    if (
        known is None
        or goal.outputs[:3] not in (XYZ, STOKES)
        or not all(each is not None and np.array_equal(each, known) for each in estimates)
    ):
        return None
    return known


def _colour_compliance(solutions: list[Solution], copies: list[int]) -> Array:
    """Return the matrix (channel, channel) that determines by how much the responses of sites may differ.

    The more frequent a colour is in uniform patches, the less the responses to it may differ. Responses to grey must not
    differ.
    """
    colour_compliance = np.linalg.inv(np.average([solution.colours for solution in solutions], axis=0, weights=copies))
    white = solutions[0].white
    if white is not None:
        colour_compliance -= np.outer(colour_compliance @ white, colour_compliance @ white) / (
            white @ colour_compliance @ white
        )
    return np.asarray(colour_compliance)


def _equations(recipe: LearningRecipe, goal: Goal, rule: ClassRule) -> list[OutputKind]:
    """Return the settings of each output in the opponent basis."""
    # The squared error is smallest if noise and bias have equal weights. A larger noise weight is useful only for outputs
    # that are displayed.
    unseen = OutputKind(min(recipe.luminance_noise, 1.0), True)
    if goal.outputs[:3] != XYZ:
        return [unseen] * len(goal.outputs)
    chroma = OutputKind(recipe.chroma_noise, True)
    return [chroma, OutputKind(recipe.luminance_noise, rule.contrasts > 1), chroma] + [unseen] * (len(goal.outputs) - 3)


def _opponent_basis(goal: Goal) -> Array:
    """Return the matrix that converts X, Y, Z to the opponent components X − X_w Y, Y, Z − Z_w Y.

    For greys under the training illuminant, the first and third components are zero. All other outputs are unchanged.
    """
    basis = np.eye(len(goal.outputs))
    if goal.outputs[:3] == XYZ:
        basis[1, 0], basis[1, 2] = -goal.white[0], -goal.white[2]
    return basis


def _nearest(filled: NDArray[np.bool_], rule: ClassRule) -> NDArray[np.int64]:
    """Map each class to the solved class that provides its transform.

    A solved class uses its own transform. An unsolved class uses the solved class of the same kind with the nearest level
    and contrast, preferably with the same direction. If no class of this kind is solved, it uses the nearest class of any
    kind.
    """
    _, level, contrast, combination, kind = rule.split(np.arange(filled.size))
    known = np.flatnonzero(filled)
    source = np.arange(filled.size)
    for index in np.flatnonzero(~filled):
        far = np.abs(level[known] - level[index]) * rule.contrasts + np.abs(contrast[known] - contrast[index])
        far = far + (kind[known] != kind[index]) * filled.size + 0.5 * (combination[known] != combination[index])
        source[index] = known[np.argmin(far)]
    return source
