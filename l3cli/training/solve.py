"""Solve the transforms of the first layer from its sums (docs/method.md#solution).

Each class has a Wiener solution. Classes with few patches get help (docs/method.md#thin-classes):

* **Neighbours.** The sums of the neighbouring levels are added with weights below one. This is possible because sums are
  relative to the level, and helps because transforms change slowly with it.
* **Pseudo-samples.** With fewer patches than taps a class has no unique solution, and with few more it would fit their
  noise. So the mean sums of its *parent*, which joins all chromas of the same level, contrast and saturation case, count as
  `parent_patches` samples more. They decide what the patches of the class leave open, and hardly matter where there are
  many. A class without patches has nothing else, and takes the transform of its parent.
* **Nearest class.** If the parent has no patches either, the class takes the transform of the nearest class that has one.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.partial_sums import ClassSums
from l3cli.errors import L3Error
from l3cli.physics.display import XYZ
from l3cli.training import systems
from l3cli.training.goal import Goal
from l3cli.training.highlights import flat_moments, grey_patches, plain_colours, steps_back, white_channels
from l3cli.training.plain_surfaces import output_gains, single_bands, teaches
from l3cli.training.recipe import LearningRecipe
from l3cli.training.sums import moment_matrix, turned_places, width_of
from l3cli.training.symmetry import Turn

Array = NDArray[np.float64]
CASE_SHARE = 0.1  # smallest fraction of the pseudo-patches from all levels of a saturation case
THIN_PARENT = 100.0  # number of patches of a level and case at which half of the other pseudo-patches come from all levels


def shrunk(
    sums: ClassSums, parents: ClassSums, classes: NDArray[np.intp], rule: ClassRule, recipe: LearningRecipe
) -> tuple[Array, Array]:
    """Return the sums of classes, with help from their neighbours and parents (docs/method.md#thin-classes).

    Unsaturated classes get a fraction of the sums of the neighbouring levels. These can be added because sums are relative
    to the level. All classes get pseudo-patches of their parent.

    Parameters
    ----------
    sums, parents : ClassSums
    classes : ndarray, (class)
        Numbers of the classes. All of them must be saturated, or none.
    rule : ClassRule
    recipe : LearningRecipe

    Returns
    -------
    moments : ndarray, (class, pair)
    noise : ndarray, (class, tap)
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
    noise *= (count / own)[:, None]  # of the class, scaled to the new number of patches
    parent = parent_of(classes, rule)
    moments += recipe.parent_patches * parents.moments[parent]
    noise += recipe.parent_patches * parents.noise[parent]
    return moments, noise


def parents_of(sums: ClassSums, rule: ClassRule) -> ClassSums:
    """Return the mean sums per patch of each parent (docs/method.md#thin-classes).

    A parent comprises the classes with the same level, contrast and saturation case, whatever their chroma and other
    features. If none of them has patches, it comprises all contrasts. The mean of the whole saturation case is mixed in,
    with a larger weight if there are few patches. The count of a parent is the number of patches of its level and case.
    """
    first = np.unique(rule.case(np.arange(rule.kinds)), return_index=True)[1]  # kind of each case

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
    """Return the parents of the classes `index`. A parent joins all chromas and other features of a saturation case."""
    place = rule.split(index)
    return rule.join_cases(place.level, place.contrast, rule.case(place.kind))


UNIFORM_WEIGHT = 0.2  # uniform patches per textured patch on which a difference between sites counts as an error
NOISE_FADES = 1000.0  # rate at which uniform surfaces lose weight with the ratio of noise to signal power
WHITE_FADES = 2000.0  # rate with the square of that ratio, for chromas near white, which may be greys
CLASSES_AT_ONCE = 64  # classes that are solved together


class OutputKind(NamedTuple):
    """How the equations of an output differ from those of other outputs."""

    noise_weight: float  # how much noise weighs against bias (docs/method.md#noise-weights)
    taught: bool  # whether what clips is taught to be grey (docs/method.md#clipped-areas), and plain areas single bands:
    # luminance only where plain areas have classes for themselves, for textures that clip have other means


@dataclass(frozen=True)
class Solution:
    """Wiener solutions of the classes of one canonical site, in the opponent basis, with their compliance.

    `taps` holds the taps and, last, the intercept. `response` is what a uniform patch of one channel (last: the intercept)
    adds to each output. `compliance` is the change of the taps when that response changes by one
    (docs/method.md#equal-response).
    """

    taps: Array  # (class, tap + 1, output)
    response: Array  # (class, channel + 1, output)
    compliance: Array  # (class, equations, tap + 1, channel + 1)
    compliance_response: Array  # (class, equations, channel + 1, channel + 1): the response of the compliance
    solved: NDArray[np.bool_]  # (class)
    samples: Array  # (class) patches of its own, a mean over the turns
    condition: Array  # (class) of the equations for the least noisy output; 0: not solved
    colours: Array  # (channel, channel) second moments of the channels' means over plain patches, of trace 1
    white: Array | None  # (channel) signals of white, if the training patches bear them out
    power: Array  # (class) sum of the channels' squared means over its patches and those that help it
    outputs: Array  # (output, output) second moments of the targets of unsaturated classes


@dataclass(frozen=True)
class Transforms:
    """Transforms of the classes of one site, taps in units of full scale."""

    weights: Array  # (class, output, tap)
    intercept: Array  # (class, output)
    samples: Array  # (class) number of its own patches; 0: filled from another class
    condition: Array  # (class)


# Long: what is solved once for all classes stands before the one loop over them.
def solve(
    sums: ClassSums, rule: ClassRule, window: NDArray[np.int64], turns: list[Turn], recipe: LearningRecipe, goal: Goal
) -> Solution:
    """Solve the classes of a canonical site that have patches, or whose parent has patches.

    The solution is T = Y Xᵀ (X Xᵀ + Λ)⁻¹. Classes with few patches get help from their neighbours and parents.

    Parameters
    ----------
    sums : ClassSums
    rule : ClassRule
    window : ndarray, (tap)
        Channel of each tap.
    turns : list of Turn
        Orientations that leave the window unchanged. Sums are averaged over them.
    recipe : LearningRecipe
    goal : Goal

    Returns
    -------
    Solution

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
    groups = np.append(window, window.max() + 1)  # every channel, and the intercept as one more
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
        used = groups.size if clips else groups.size - 1  # an intercept if saturated
        every = np.flatnonzero(solved & (saturated == clips))
        for first in range(0, every.size, CLASSES_AT_ONCE):
            batch = every[first : first + CLASSES_AT_ONCE]
            moments, noise = _averaged(sums, parents, batch, turns, rule, recipe)
            taught = moments.copy()
            for place, index in enumerate(batch.tolist()):
                count = samples[index] + recipe.parent_patches
                if index in greys:
                    taught[place] += count * greys[index]
                elif gains is not None and teaches(rule, index):
                    taught[place] += single_bands(moments[place], window, gains)
                elif (plain := surfaces.get(index)) is not None:
                    noisy = noise[place].sum() / moments[place].diagonal()[: window.size].sum()
                    fades = 1.0 + NOISE_FADES * noisy + (near_white[index] * noisy) ** 2
                    taught[place] += recipe.plain_surfaces * (count / fades) * plain
            power[batch] = (means @ taught[:, : window.size, : window.size] * means).sum(axis=(1, 2))
            for number, ((noise_weight, is_taught), wanted) in enumerate(columns.items()):
                of = taught if is_taught else moments
                flat = np.broadcast_to(member.T[:used], (batch.size, used, len(member)))
                right = np.concatenate([of[:, :used, groups.size :] @ basis[:, wanted], flat], axis=2)
                system = systems.Equations(of[:, :used, :used], noise, noise_weight, right)
                solution, worst = systems.solve_within(system, recipe.ridge, member[:, :used], goal.integers)
                taps[batch[:, None, None], np.arange(used)[:, None], wanted] = solution[..., : len(wanted)]
                compliance[batch, number, :used] = solution[..., len(wanted) :]
                condition[batch] = np.maximum(condition[batch], worst)
    targets = moment_matrix(sums.moments[~saturated].sum(axis=0), width_of(sums.moments))[groups.size :, groups.size :]
    about = solved, samples, condition, plain_colours(sums, rule, window), white, power, targets
    return Solution(taps, member @ taps, compliance, member @ compliance, *about)


def _averaged(
    sums: ClassSums, parents: ClassSums, batch: NDArray[np.intp], turns: list[Turn], rule: ClassRule, recipe: LearningRecipe
) -> tuple[Array, Array]:
    """Return the moments (class, column, column) and noise (class, tap) of a batch, with help, averaged over `turns`."""
    width = width_of(sums.moments)
    moments, noise = np.zeros((batch.size, sums.moments.shape[1])), np.zeros((batch.size, sums.noise.shape[1]))
    for turn in turns:
        turned_moments, turned_noise = shrunk(sums, parents, turn.classes[batch], rule, recipe)
        moments += turned_moments[:, turned_places(turn.taps, width)] / len(turns)
        noise += turned_noise[:, turn.taps] / len(turns)
    return moment_matrix(moments, width), noise


def _surfaces(rule: ClassRule, window: NDArray[np.int64], goal: Goal, white: Array | None) -> dict[int, Array]:
    """Return the moments of uniform surfaces and of stripes, for the unsaturated classes of the lowest contrast.

    Uniform surfaces are for classes without a direction, stripes for classes with any direction. The result is empty unless
    the training patches confirm the computed white of the camera.
    """
    if goal.surfaces is None or white is None or goal.white_signal is None or not np.array_equal(white, goal.white_signal):
        return {}
    plain = {chroma: each for chroma, each in enumerate(goal.surfaces.moments(rule, window)) if each is not None}
    levels = np.arange(rule.levels)
    taught = {index: each for chroma, each in plain.items() for index in rule.join(levels, 0, chroma).tolist()}
    every = np.arange(rule.combinations)[:, None]  # near what is uniform lies what is nearly so, and has a direction
    for chroma, each in goal.surfaces.moments_of_stripes(rule, window).items():
        taught |= dict.fromkeys(rule.join(levels, 0, chroma, combination=every).ravel().tolist(), each)
    return taught


def _near_white(rule: ClassRule, goal: Goal) -> Array:
    """Return the rate (class) at which uniform surfaces lose weight near white.

    Noise brings greys into these classes, and greys must stay grey.
    """
    kind = rule.split(np.arange(rule.classes_per_site)).kind
    if goal.surfaces is None:
        return np.zeros(kind.size)
    return np.asarray(goal.surfaces.nearness(rule)[np.minimum(kind, rule.chromas - 1)] * WHITE_FADES)


def equal_responses(
    solutions: list[Solution], copies: list[int], rule: ClassRule, recipe: LearningRecipe, goal: Goal
) -> list[Transforms]:
    """Constrain the transforms of all sites to a common response (docs/method.md#equal-response).

    All sites then render a uniform patch alike, and textures as far as that pays. White becomes exactly white. A class
    without a solution at some site uses the nearest solved class, the same one at all sites.

    Parameters
    ----------
    solutions : list of Solution
        One per canonical site.
    copies : list of int
        Number of CFA sites that each canonical site represents.
    rule : ClassRule
    recipe : LearningRecipe
    goal : Goal

    Returns
    -------
    list of Transforms
        One per canonical site.

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
    """Return the taps (class, tap + 1, output) of all sites, constrained to a common response.

    Of all common responses, this takes the one with the least squared error.
    """
    constrained = [solution.taps.copy() for solution in solutions]
    saturated = rule.case(rule.split(np.arange(solved.size)).kind) > 0
    white = _exact_white(solutions, goal)
    rising = solutions[0].white if goal.outputs[:3] == XYZ else None
    of_white = (_opponent_basis(goal).T @ goal.white).tolist()
    colour_compliance = np.pad(_colour_compliance(solutions, copies), (0, 1))
    # Among textures of many bands, each measured by few pixels, sites do better apart; colours show the least difference.
    free = (rule.split(np.arange(solved.size)).contrast > 0) & (goal.outputs[:3] != XYZ)
    for kind in (False, True):
        used = slice(None) if kind else slice(0, -1)  # without an intercept there is none to equalise
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
            if white is not None and not kind:
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
    """Return the signals of white (channel) if the outputs are colours and the patches of every site confirm the signals."""
    known, borne = goal.white_signal, [solution.white for solution in solutions]
    if (
        known is None
        or goal.outputs[:3] != XYZ
        or not all(each is not None and np.array_equal(each, known) for each in borne)
    ):
        return None
    return known


def _colour_compliance(solutions: list[Solution], copies: list[int]) -> Array:
    """Return the tolerance (channel, channel) for different responses of sites.

    It is smaller in directions in which the uniform patches of the scenes would show the difference more.
    """
    colour_compliance = np.linalg.inv(np.average([solution.colours for solution in solutions], axis=0, weights=copies))
    white = solutions[0].white
    if white is not None:
        colour_compliance -= np.outer(colour_compliance @ white, colour_compliance @ white) / (
            white @ colour_compliance @ white
        )  # greys are answered alike to the last bit
    return np.asarray(colour_compliance)


def _equations(recipe: LearningRecipe, goal: Goal, rule: ClassRule) -> list[OutputKind]:
    """Return the equations of each output in the opponent basis."""
    unseen = OutputKind(
        min(recipe.luminance_noise, 1.0), True
    )  # nobody looks at these outputs, so more noise reduction has no use
    if goal.outputs[:3] != XYZ:
        return [unseen] * len(goal.outputs)
    chroma = OutputKind(recipe.chroma_noise, True)
    return [chroma, OutputKind(recipe.luminance_noise, rule.contrasts > 1), chroma] + [unseen] * (len(goal.outputs) - 3)


def _opponent_basis(goal: Goal) -> Array:
    """Return columns X − X_w Y, Y, Z − Z_w Y for X, Y, Z, zero on greys under the training light; others unchanged."""
    basis = np.eye(len(goal.outputs))
    if goal.outputs[:3] == XYZ:
        basis[1, 0], basis[1, 2] = -goal.white[0], -goal.white[2]
    return basis


def _nearest(filled: NDArray[np.bool_], rule: ClassRule) -> NDArray[np.int64]:
    """Return the filled class whose transform each class uses.

    A filled class uses its own. Any other class uses the same kind at the nearest level and contrast, preferably with the
    same other features. If there is none, it uses the nearest class of any kind.
    """
    _, level, contrast, combination, kind = rule.split(np.arange(filled.size))
    known = np.flatnonzero(filled)
    source = np.arange(filled.size)
    for index in np.flatnonzero(~filled):
        far = np.abs(level[known] - level[index]) * rule.contrasts + np.abs(contrast[known] - contrast[index])
        far = far + (kind[known] != kind[index]) * filled.size + 0.5 * (combination[known] != combination[index])
        source[index] = known[np.argmin(far)]
    return source
