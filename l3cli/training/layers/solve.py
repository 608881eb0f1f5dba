"""From a plane layer's sums to its transforms (docs/method.md#layers)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.partial_sums import LayerSums
from l3cli.artifacts.table import PlaneRule
from l3cli.errors import L3Error
from l3cli.training.sums import moment_matrix
from l3cli.training.systems import fits_between, solve_positive

Array = NDArray[np.float64]
FADING = 0.97  # response of a chroma plane to itself, below which it is faded
NEAR_SHARE = 0.9  # of the pseudo-patches come from the class's level, the others from all levels


@dataclass(frozen=True)
class LayerGoal:
    """Outputs that a plane layer's transforms are learned for."""

    pool: tuple[float, ...]  # weight of the classes one, two… levels away
    parent: float  # pseudo-patches
    ridge: float
    noise: tuple[float, ...]  # (output) weight of noise
    white: Array  # (plane) what the layer before makes of a white of Y = 1, and this one shall
    windows: int  # taps of the windows; those behind them are zero on flat areas
    keeps: bool = False  # whether unsaturated classes that would fade the chroma of uniform windows keep it


def solve_layer(
    sums: list[LayerSums], copies: list[int], rule: PlaneRule, goal: LayerGoal, equal: bool = True
) -> list[Array]:
    """Return rows (class, tap + 1, output) of the canonical sites, each of which stands for `copies`, constrained so that
    all answer flat areas alike, and white with white: what the layer before makes of greys, also of those that clip, stays
    as grey as it is. L3Error if no class can be solved."""
    taps = int((np.sqrt(8 * sums[0].noise.shape[1] + 1) - 1) / 2)
    outputs, planes = len(goal.noise), len(goal.white)
    member = np.zeros((taps, planes))  # (tap, plane)
    member[: goal.windows] = np.kron(np.eye(planes), np.ones((goal.windows // planes, 1)))
    rows = [np.zeros((rule.classes_per_site, taps + 1, outputs)) for _ in sums]
    solved = np.zeros(rule.classes_per_site, bool)
    parents = [_Parents(one, rule) for one in sums]
    for index in range(rule.classes_per_site):
        shrunk = [_shrunk(one, parent, index, rule, goal) for one, parent in zip(sums, parents, strict=True)]
        whole = [(moment_matrix(one[0], taps + 1 + outputs), moment_matrix(one[1], taps)) for one in shrunk if one]
        if len(whole) < len(sums):
            continue
        solved[index] = True
        for output, factor in enumerate(goal.noise):
            estimates = [_solution(moments, noise, factor, goal.ridge, output, member) for moments, noise in whole]
            keeps = goal.keeps and not goal.white[output] and not rule.case(rule.split(index).kind)
            constrained = (
                _constrained(estimates, member, copies, goal.white, output, keeps)
                if equal
                else [one[:, 0] for one in estimates]
            )
            for site, row in enumerate(constrained):
                rows[site][index, :taps, output] = row
    if not solved.any():
        raise L3Error("no class of the second layer has training rows of every site; train on more, or larger, frames")
    fitting = solved & np.all([fits_between(one) for one in rows], axis=0)
    source = _nearest(fitting if fitting.any() else solved, rule)
    return [one[source] for one in rows]


def _solution(moments: Array, noise: Array, factor: float, ridge: float, output: int, member: Array) -> Array:
    """Return the Wiener solution (tap) of an output, and behind it how it gives way to a change of the flat response (tap, 1
    + plane). Moments are of taps, intercept and outputs. There is no intercept: no light is answered with none."""
    taps = len(noise)
    system = moments[:taps, :taps] + factor * noise
    system.reshape(-1)[:: taps + 1] += ridge * np.trace(system) / taps + 1e-12
    return solve_positive(system, np.column_stack([moments[:taps, taps + 1 + output], member]))[0]


def _constrained(
    estimates: list[Array], member: Array, copies: list[int], white: Array, output: int, keeps: bool = False
) -> list[Array]:
    """Return the rows (tap) of the sites with one flat response, of all that answer white with white the one of least
    squared error; `keeps`: unless it fades the output's own plane, which then stays as it is."""
    stiff = [np.linalg.pinv(member.T @ one[:, 1:]) for one in estimates]
    response = [member.T @ one[:, 0] for one in estimates]
    total = sum((copy * k for copy, k in zip(copies, stiff, strict=True)), np.zeros((len(white), len(white))))
    total += 1e-9 * np.trace(total) / len(white) * np.eye(len(white))
    pull = sum((copy * k @ r for copy, k, r in zip(copies, stiff, response, strict=True)), np.zeros(len(white)))
    common, bend = np.linalg.solve(total, pull), np.linalg.solve(total, white)
    common += bend * (white[output] - white @ common) / (white @ bend)
    if keeps and common[output] < FADING:
        common = np.eye(len(white))[output]
    return [one[:, 0] + one[:, 1:] @ (k @ (common - r)) for one, k, r in zip(estimates, stiff, response, strict=True)]


class _Parents:
    """Mean sums of a row of each level, and of all levels, of the unsaturated classes; and of each case."""

    def __init__(self, sums: LayerSums, rule: PlaneRule) -> None:
        def means(values: Array) -> tuple[Array, Array]:
            by_kind = values.reshape(rule.levels, rule.kinds, -1)
            count = sums.count.reshape(rule.levels, rule.kinds, 1)
            free, number = by_kind[:, : rule.structures].sum(axis=1), count[:, : rule.structures].sum(axis=1)
            every = free.sum(axis=0) / max(number.sum(), 1)
            level = np.where(number > 0, free / np.maximum(number, 1), every)
            mixed = NEAR_SHARE * level + (1 - NEAR_SHARE) * every
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
    """Return sums of a class with its neighbours in level and its parent's pseudo-rows; None: nothing like it was seen."""
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
        for distance, share in enumerate(goal.pool, start=1):
            for other in (level - distance, level + distance):
                if 0 <= other < rule.levels:
                    neighbour = rule.join(other, kind)
                    moments += share * sums.moments[neighbour]
                    count += share * sums.count[neighbour]
        noise = noise * (count / sums.count[index])
    return moments + goal.parent * parents.moments[level], noise + goal.parent * parents.noise[level]


def _nearest(filled: NDArray[np.bool_], rule: PlaneRule) -> NDArray[np.int64]:
    """Return for every class the solved one it takes its transform from: itself, the same kind at the nearest level, else a
    flat one of the nearest level."""
    _, level, kind = rule.split(np.arange(filled.size))
    known = np.flatnonzero(filled)
    source = np.arange(filled.size)
    for index in np.flatnonzero(~filled):
        far = np.abs(level[known] - level[index]) + (kind[known] != kind[index]) * 1000 + (kind[known] > 0) * 100.0
        source[index] = known[np.argmin(far)]
    return source
