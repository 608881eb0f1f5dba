"""Patches → sums of their classes (METHOD 4.1–4.4). What each step costs decides its order:

a patch is rescaled, exposed and labelled in pieces that stay in the caches, of which only label, level and scale are kept;
then all are sorted by class, made again without noise in pieces, weighed, and multiplied class by class.
"""

import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.partial_sums import ClassSums
from l3cli.artifacts.training_set import TrainingPair
from l3cli.classify import Neighbourhoods, label_patches, neighbourhoods
from l3cli.train.lesson import Lesson
from l3cli.train.patches import Floats, Patches, draw_levels, expose_patches, noise_share, patches_of
from l3cli.train.sums import empty_sums, grid_steps, pairs
from l3cli.train.weighing import Judge

GROUP_BYTES = 200 << 20  # of sums that a process fills at a time: sites of one group read the frames together
BATCH = 50_000  # patches that are sorted together: bounds memory, and makes a class's product large enough to be fast
PIECE = 2048  # patches handled at once: their arrays stay in the caches
DARKEST_LEVEL = 1e-4  # share of full scale: rows of darker patches get no more weight
TARGET_FLOOR = 0.05  # of the level: rows of darker targets get no more weight (METHOD 4.2)


def frame_blocks(lesson: Lesson) -> list[range]:
    """The frames in runs whose patches are sorted together; shards and processes are dealt whole blocks."""
    starts, together = [0], 0
    for index, patches in enumerate(lesson.patches):
        together += patches
        if together > BATCH and index > starts[-1]:
            starts.append(index)
            together = patches
    return [range(first, last) for first, last in itertools.pairwise([*starts, len(lesson.patches)])]


def site_groups(lesson: Lesson, sites: list[int], at_least: int) -> list[tuple[int, ...]]:
    """Sites in groups whose sums fit into GROUP_BYTES, `at_least` so many if there are as many sites."""
    one = empty_sums(lesson.rule, len(lesson.head.outputs))
    size = max(1, min(GROUP_BYTES // one.moments.nbytes, -(-len(sites) // at_least)))
    return [tuple(sites[first : first + size]) for first in range(0, len(sites), size)]


def sum_sites(
    lesson: Lesson,
    blocks: Iterator[tuple[int, Iterator[TrainingPair]]],
    sites: tuple[int, ...],
    judges: tuple[Judge | None, ...],
) -> list[ClassSums]:
    """Sums of canonical `sites`, whose rows `judges` weigh, over blocks (index of the first frame, frames); a frame is read
    once and let go."""
    near = neighbourhoods(lesson.head.camera.cfa, lesson.rule.patch, len(lesson.head.camera.channels))
    sums = {site: empty_sums(lesson.rule, len(lesson.head.outputs)) for site in sites}
    for first, frames in blocks:
        rngs = {site: np.random.default_rng([lesson.seed, lesson.number, first, site]) for site in sites}
        for site, patches in _batches(lesson, first, frames, near, rngs):
            judge = judges[sites.index(site)]
            _Batch(lesson, patches, near, site, judge).add_to(sums[site], rngs[site])
    return list(sums.values())


def _batches(
    lesson: Lesson, first: int, frames: Iterator[TrainingPair], near: Neighbourhoods, rngs: dict[int, np.random.Generator]
) -> Iterator[tuple[int, Patches]]:
    """The patches of a block, frames from `first`, for each site: together or, where one frame has more than BATCH, a part
    of it at a time."""
    waiting: dict[int, list[Patches]] = {site: [] for site in rngs}
    for index, frame in enumerate(frames, first):
        for site, rng in rngs.items():
            rest = lesson.patches[index]
            while rest:
                count = min(rest, BATCH)
                rest -= count
                waiting[site].append(patches_of(frame, lesson.head, near, site, count, rng, lesson.recipe.symmetry))
                if rest:
                    yield site, waiting[site].pop()
    for site, patches in waiting.items():
        yield site, Patches.together(patches)
        patches.clear()


class _Batch:
    """Patches of one site on their way into the sums."""

    def __init__(self, lesson: Lesson, patches: Patches, near: Neighbourhoods, site: int, judge: Judge | None) -> None:
        self.lesson, self.patches, self.near, self.site, self.judge = lesson, patches, near, site, judge
        member = (near.channel[site][:, None] == np.arange(near.count.shape[1])) / near.count[site]
        self.tap_share = member.mean(axis=1).astype(np.float32)  # level = mean over channels of the channel means

    def add_to(self, sums: ClassSums, rng: np.random.Generator) -> None:
        """Draw levels, decide classes and add everything to `sums`."""
        label, level, scale = self._exposed(rng)
        order = np.argsort(label, kind="stable")
        steps = grid_steps(self.lesson.rule, self.lesson.head.camera, self.patches.target.shape[1])
        for start in range(0, len(order), PIECE):
            piece = order[start : start + PIECE]
            patch = piece % len(self.patches.signal)
            self._add_piece(sums, steps, label[piece], level[piece], scale[piece], patch, rng)

    def _exposed(self, rng: np.random.Generator) -> tuple[NDArray[np.unsignedinteger], Floats, Floats]:
        """Class, level as the camera sees it and scale of every draw of every patch (draw · patch)."""
        lesson, signal = self.lesson, self.patches.signal
        camera, count = lesson.head.camera, len(signal)
        own_level = np.maximum(signal @ self.tap_share, 1e-3)
        label = np.empty(lesson.draws * count, dtype=np.min_scalar_type(lesson.rule.classes_per_site))
        level, scale = np.empty(label.size, np.float32), np.empty(label.size, np.float32)
        share = self.tap_share / np.float32(camera.white - camera.black)
        dark = np.float32(camera.black) * share.sum()
        for draw in range(lesson.draws):
            drawn = draw_levels(lesson.recipe, count, rng) / own_level if lesson.recipe.rescale else np.ones(count)
            scale[draw * count : (draw + 1) * count] = self.patches.possible(drawn)
            for first in range(0, count, PIECE):
                part = signal[first : first + PIECE]
                here = slice(draw * count + first, draw * count + first + len(part))
                carried = self._carried(slice(first, first + len(part)), scale[here])
                values = expose_patches(part * scale[here, None], camera, rng, carried)
                label[here] = label_patches(values, lesson.rule, self.near, self.site)
                level[here] = values.astype(np.float32) @ share - dark
        return label, np.maximum(level, np.float32(DARKEST_LEVEL)), scale

    def _carried(self, patch: slice | NDArray[np.int64], scale: Floats) -> Floats | None:
        """Noise variance that patches `patch` carry when rescaled by `scale`."""
        return None if self.patches.carried is None else self.patches.carried[patch] * scale[:, None] ** 2

    def _add_piece(
        self,
        sums: ClassSums,
        steps: NDArray[np.float64],
        label: NDArray[np.unsignedinteger],
        level: Floats,
        scale: Floats,
        patch: NDArray[np.int64],
        rng: np.random.Generator,
    ) -> None:
        """Add rows of non-decreasing class: patches `patch` rescaled by `scale`, seen at `level`."""
        signal = self.patches.signal[patch] * scale[:, None]
        target = self.patches.target[patch] * scale[:, None]
        variance = noise_share(signal, self.lesson.head.camera, self._carried(patch, scale))
        if self.lesson.recipe.noise == "sampled":
            signal += np.sqrt(variance) * rng.standard_normal(signal.shape, dtype=np.float32)
            variance[:] = 0
        clean = np.minimum(signal, np.float32(1.0))
        start = np.flatnonzero(np.diff(label, prepend=label[0] + 1))  # a class begins where the label changes
        runs = list(zip(label[start].tolist(), start.tolist(), [*start[1:].tolist(), len(label)], strict=True))
        brightness = self.lesson.brightness(target) / level + np.float32(TARGET_FLOOR)
        weight = brightness ** np.float32(-self.lesson.recipe.brightness_power) / level
        if self.judge is not None:
            weight *= self.judge.weight(clean, variance, target, level, runs)
        taps = signal.shape[1]
        rows = np.empty((len(label), taps + 1 + target.shape[1]), np.float32)
        np.multiply(clean, weight[:, None], out=rows[:, :taps])
        rows[:, taps] = weight
        np.multiply(target, weight[:, None], out=rows[:, taps + 1 :])
        _add_runs(sums, steps, rows, variance, weight**2, runs)


def _add_runs(
    sums: ClassSums, steps: NDArray[np.float64], rows: Floats, variance: Floats, weight: Floats, runs: list
) -> None:
    """Add the products of the rows, and the noise variance by `weight`, of each class, first and last row of `runs`,
    rounded to the grid."""
    width = rows.shape[1]
    row, col = pairs(width)
    place = row * width + col
    per_level = len(sums.count) // len(steps)
    for index, first, last in runs:
        block = rows[first:last]
        step = steps[index // per_level]
        product = (block.T @ block).reshape(-1)[place] / step
        np.rint(product, out=product)
        product *= step
        sums.moments[index] += product
        noise = (weight[first:last] @ variance[first:last]).astype(np.float64)
        sums.noise[index] += np.rint(noise * (1 / steps[0, 0])) * steps[0, 0]
        sums.count[index] += last - first
