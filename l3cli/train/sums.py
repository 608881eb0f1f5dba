"""Additive sums of one canonical site: all that a class's transform depends on (METHOD 4, 4.6)."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.table import ClassRule
from l3cli.classify import Neighbourhoods, label_patches
from l3cli.train.patches import Patches, draw_levels, expose_patches
from l3cli.train.recipe import LearningRecipe
from l3cli.train.weighing import Judge

CHUNK = 25_000  # patches handled at once: their arrays stay near the caches
TARGET_FLOOR = 0.05  # of the level: rows of darker targets get no more weight (METHOD 4.2)


@dataclass
class Sums:
    """Per class: moments of [taps, 1, outputs], noise variance of the taps, number of patches. Rows are weighted."""

    moments: NDArray[np.float64]  # (class, tap + 1 + output, tap + 1 + output)
    noise: NDArray[np.float64]  # (class, tap)
    count: NDArray[np.float64]  # (class)

    @classmethod
    def empty(cls, classes: int, taps: int, outputs: int) -> "Sums":
        width = taps + 1 + outputs
        return cls(np.zeros((classes, width, width)), np.zeros((classes, taps)), np.zeros(classes))


def accumulate(
    sums: Sums,
    patches: Patches,
    camera: CameraModel,
    rule: ClassRule,
    near: Neighbourhoods,
    site: int,
    recipe: LearningRecipe,
    draws: int,
    judge: Judge | None,
    rng: np.random.Generator,
) -> None:
    """Add `patches`, each rescaled to `draws` levels and sorted into its class, to `sums` (METHOD 4.1, 4.2); rows are
    weighed by the luminance of their target and, if there is a `judge`, by the error it expects (METHOD 4.4)."""
    member = (near.channel[site][:, None] == np.arange(near.count.shape[1])) / near.count[site]
    tap_share = member.mean(axis=1).astype(np.float32)  # level = mean over channels of the channel means
    for signal, target, carried in _rescaled(patches, tap_share, recipe, draws, rng):
        values, clean, variance = expose_patches(signal, camera, rng, carried)
        label = label_patches(values, rule, near, site)
        span = np.float32(camera.white - camera.black)
        level = np.maximum((values.astype(np.float32) - np.float32(camera.black)) @ tap_share / span, 1e-4)
        weight = 1.0 / (level * np.sqrt(_weighing(target) / level + TARGET_FLOOR))
        if judge is not None:
            weight = weight * judge.weight(clean, variance, target, level, label)
        rows = np.concatenate([clean, np.ones((len(clean), 1), np.float32), target], axis=1) * weight[:, None]
        _add_by_class(sums, label, rows.astype(np.float32), variance * (weight**2)[:, None])


def _rescaled(
    patches: Patches, tap_share: NDArray[np.float32], recipe: LearningRecipe, draws: int, rng: np.random.Generator
) -> Iterator[tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32] | None]]:
    """Chunks of (signal, target, noise variance carried) at freshly drawn levels, as far as the patches can follow;
    brightness is only exposure, so signal and target scale alike."""
    own_level = np.maximum(patches.signal @ tap_share, 1e-3)
    for _ in range(draws):
        scale = patches.possible(draw_levels(recipe, len(own_level), rng) / own_level).astype(np.float32)[:, None]
        for start in range(0, len(own_level), CHUNK):
            part = slice(start, start + CHUNK)
            carried = None if patches.carried is None else patches.carried[part] * scale[part] ** 2
            yield patches.signal[part] * scale[part], patches.target[part] * scale[part], carried


def _weighing(target: NDArray[np.float32]) -> NDArray[np.float32]:
    """What errors are relative to (patch): the luminance of XYZ, the mean of any other set of outputs."""
    return np.maximum(target[:, 1] if target.shape[1] == 3 else target.mean(axis=1), 0.0)


def _add_by_class(sums: Sums, label: NDArray[np.int64], rows: NDArray[np.float32], variance: NDArray[np.float32]) -> None:
    order = np.argsort(label, kind="stable")
    rows, variance = rows[order], variance[order]
    classes, start = np.unique(label[order], return_index=True)
    sums.noise[classes] += np.add.reduceat(variance, start, axis=0, dtype=np.float64)
    stop = np.append(start[1:], len(label))
    sums.count[classes] += stop - start
    for index, first, last in zip(classes, start, stop, strict=True):
        block = rows[first:last]
        sums.moments[index] += block.T @ block


def symmetrise(sums: Sums, stabilisers: list[NDArray[np.int64]]) -> Sums:
    """The mean of the sums over the orientations that leave the site's window as it is: more data for every class."""
    taps = sums.noise.shape[1]
    moments, noise = np.zeros_like(sums.moments), np.zeros_like(sums.noise)
    rest = np.arange(taps, sums.moments.shape[1])
    for permutation in stabilisers:
        everything = np.concatenate([permutation, rest])
        moments += sums.moments[:, everything[:, None], everything[None]]
        noise += sums.noise[:, permutation]
    return Sums(moments / len(stabilisers), noise / len(stabilisers), sums.count)
