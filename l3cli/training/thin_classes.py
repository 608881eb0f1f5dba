"""Help for classes with few patches: their neighbours in level, and pseudo-patches of a parent
(docs/method.md#thin-classes)."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.partial_sums import ClassSums
from l3cli.training.recipe import LearningRecipe

Array = NDArray[np.float64]
CASE_SHARE = 0.1  # of the pseudo-patches come from all levels of a case …
THIN_PARENT = 100.0  # … and half of the others, where a level of the case has so few patches


def shrunk(
    sums: ClassSums, parents: ClassSums, classes: NDArray[np.intp], rule: ClassRule, recipe: LearningRecipe
) -> tuple[Array, Array]:
    """Moments (class, pair) and noise (class, tap) of `classes`, all of them saturated or none, with help
    (docs/method.md#thin-classes): unsaturated, sums of the levels beside each, which add since sums are relative to the
    level; and pseudo-patches of its parent."""
    _, level, contrast, further, kind = rule.split(classes)
    moments, noise, count = sums.moments[classes], sums.noise[classes], sums.count[classes]
    own = np.maximum(count, 1e-9)
    for distance, weight in enumerate(() if rule.case(kind).any() else recipe.level_pool, start=1):
        for other in (level - distance, level + distance):
            helped = np.flatnonzero((own >= 1) & (other >= 0) & (other < rule.levels))
            neighbour = rule.join(other, contrast, kind, further=further)[helped]
            moments[helped] += weight * sums.moments[neighbour]
            count[helped] += weight * sums.count[neighbour]
    noise *= (count / own)[:, None]  # of the class, scaled to the new number of patches
    parent = parent_of(classes, rule)
    moments += recipe.parent_patches * parents.moments[parent]
    noise += recipe.parent_patches * parents.noise[parent]
    return moments, noise


def parents_of(sums: ClassSums, rule: ClassRule) -> ClassSums:
    """Mean sums of a patch of each parent: the classes of its level, contrast and saturation case, whatever their chroma
    and further features, or where none of them has patches those of any contrast; and a share of its case's,
    the larger the fewer patches there are (docs/method.md#thin-classes). A parent's count is that of its level and case."""
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
    """The parent of classes `index`, which tells saturation cases but neither chromas nor further features apart."""
    place = rule.split(index)
    return rule.join_cases(place.level, place.contrast, rule.case(place.kind))
