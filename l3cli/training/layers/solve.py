"""From a plane layer's sums to its transforms (docs/method.md#layers)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.layer_sums import LayerSums
from l3cli.artifacts.structure_rule import StructureRule
from l3cli.training.solve import _solve_positive
from l3cli.training.sums import moment_matrix

Array = NDArray[np.float64]
NEAR_SHARE = 0.9  # of the pseudo-patches come from the class's level, the others from all levels


@dataclass(frozen=True)
class LayerGoal:
    """What a plane layer's transforms are to give."""

    pool: tuple[float, ...]  # weight of the classes one, two… levels away
    parent: float  # pseudo-patches
    ridge: float
    noise: tuple[float, ...]  # (output) weight of noise
    white: Array  # (plane) what the layer before makes of a white of Y = 1, and this one shall


def solve_layer(
    sums: list[LayerSums], copies: list[int], rule: StructureRule, goal: LayerGoal, equal: bool = True
) -> list[Array]:
    """Rows (class, tap + 1, output) of the canonical sites, each of which stands for `copies`, bent so that all answer flat
    areas alike and, where nothing is saturated, white with white."""
    taps = int((np.sqrt(8 * sums[0].noise.shape[1] + 1) - 1) / 2)
    outputs, planes = len(goal.noise), len(goal.white)
    plane = np.repeat(np.arange(planes), taps // planes)
    rows = [np.zeros((rule.classes_per_site, taps + 1, outputs)) for _ in sums]
    solved = np.zeros(rule.classes_per_site, bool)
    parents = [_Parents(one, rule) for one in sums]
    for index in range(rule.classes_per_site):
        shrunk = [_shrunk(one, parent, index, rule, goal) for one, parent in zip(sums, parents, strict=True)]
        if any(one is None for one in shrunk):
            continue
        solved[index] = True
        saturated = int(rule.case(rule.split(index).kind) > 0)
        used, groups = taps + saturated, planes + saturated
        member = (np.append(plane, planes)[:used, None] == np.arange(groups)).astype(np.float64)
        for output, factor in enumerate(goal.noise):
            found = []
            for packed, noise in shrunk:  # type: ignore[misc]
                moments = moment_matrix(packed, taps + 1 + outputs)
                system = moments[:used, :used].copy()
                system[:taps, :taps] += factor * moment_matrix(noise, taps)
                diagonal = system.reshape(-1)[:: used + 1]
                diagonal[:taps] += goal.ridge * diagonal[:taps].mean() + 1e-12
                diagonal[taps:] += 1e-9
                found.append(_solve_positive(system, np.column_stack([moments[:used, taps + 1 + output], member]))[0])
            if not equal:
                for site, one in enumerate(found):
                    rows[site][index, :used, output] = one[:, 0]
                continue
            stiff = [np.linalg.pinv(member.T @ one[:, 1:]) for one in found]
            response = [member.T @ one[:, 0] for one in found]
            total = sum(copy * k for copy, k in zip(copies, stiff, strict=True))
            total = total + 1e-9 * np.trace(total) / groups * np.eye(groups)
            pull = sum(copy * k @ r for copy, k, r in zip(copies, stiff, response, strict=True))
            common = np.linalg.solve(total, pull)
            if not saturated:
                bend = np.linalg.solve(total, goal.white)
                common = common + bend * (goal.white[output] - goal.white @ common) / (goal.white @ bend)
            for site, (one, k, r) in enumerate(zip(found, stiff, response, strict=True)):
                rows[site][index, :used, output] = one[:, 0] + one[:, 1:] @ (k @ (common - r))
    source = _nearest(solved, rule)
    return [one[source] for one in rows]


class _Parents:
    """Mean sums of a row of each level, and of all levels, of the unsaturated classes; and of each case."""

    def __init__(self, sums: LayerSums, rule: StructureRule) -> None:
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
            near = np.where(crowd > 0, around / np.maximum(crowd, 1), whole)
            return mixed, 0.8 * near + 0.2 * whole

        self.moments, self.case_moments = means(sums.moments)
        self.noise, self.case_noise = means(sums.noise)
        self.has_case = sums.count.reshape(rule.levels, rule.kinds)[:, rule.structures :].sum(axis=0) > 0
        self.has_free = sums.count.reshape(rule.levels, rule.kinds)[:, : rule.structures].sum() > 0


def _shrunk(
    sums: LayerSums, parents: _Parents, index: int, rule: StructureRule, goal: LayerGoal
) -> tuple[Array, Array] | None:
    """Sums of a class with its neighbours in level and its parent's pseudo-rows; None: nothing like it was seen."""
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


def _nearest(filled: NDArray[np.bool_], rule: StructureRule) -> NDArray[np.int64]:
    """For every class the solved one it takes its transform from: itself, the same kind at the nearest level, else a flat
    one of the nearest level."""
    _, level, kind = rule.split(np.arange(filled.size))
    known = np.flatnonzero(filled)
    source = np.arange(filled.size)
    for index in np.flatnonzero(~filled):
        far = np.abs(level[known] - level[index]) + (kind[known] != kind[index]) * 1000 + (kind[known] > 0) * 100.0
        source[index] = known[np.argmin(far)]
    return source
