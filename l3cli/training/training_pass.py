"""One pass over the training frames: all that its work has in common, and its division into blocks of frames and shares of
processes, on which no sum depends."""

import functools
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import NoiseScale
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.training_set import LightSpectrum, TrainingSet
from l3cli.classes.rule import ClassRecipe, make_rule
from l3cli.classes.windows import neighbourhoods
from l3cli.physics.display import XYZ
from l3cli.physics.spectra import is_spectrum
from l3cli.training.goal import Goal, goal_of
from l3cli.training.recipe import LearningRecipe
from l3cli.training.sums import empty_sums
from l3cli.training.symmetry import site_maps, stabilisers

FIRST, LAST = 1, 2  # the passes: errors of the first weigh the rows of the last (docs/method.md#second-pass)


@dataclass(frozen=True)
class TrainingPass:
    """A pass: what is learned, from how many patches of which frames, by which rule and recipe."""

    head: TrainingSet
    patches: tuple[int, ...]  # (frame) patches of a canonical site, before they are divided by `divisors`
    rule: ClassRule
    recipe: LearningRecipe
    white_point: NDArray[np.float64]  # (output) a perfect white under the training light, Y = 1
    seed: int
    number: int  # FIRST or LAST
    exposure: float = 0.0  # s, mean of the simulated frames
    light: LightSpectrum | None = None  # mean of the frames' lights; None: that of some is not known

    @property
    def dark(self) -> float:
        """Return the DN above black that dark current makes, on average, in a frame that the table is for."""
        return self.head.camera.dark_signal(self.exposure)

    @functools.cached_property
    def goal(self) -> Goal:
        """Return the goal of the transforms, made once for all sites, since surfaces under a light take as long as a
        site's systems of a few channels."""
        return goal_of(self.head, self.white_point, self.light)

    @functools.cached_property
    def divisors(self) -> dict[int, int]:
        """Return the number by which the patches of each canonical site are divided: each turn that leaves its window as it
        is makes another of a patch, not quite a new one, so that sites of more turns need fewer
        (docs/method.md#symmetry)."""
        camera, shared = self.head.camera, self.recipe.symmetry
        channel = neighbourhoods(camera.cfa, self.rule.patch, len(camera.channels)).channel
        sites = sorted({one.canonical for one in site_maps(channel, self.rule.patch, shared)})
        turns = [len(stabilisers(channel[site], self.rule.patch)) if shared else 1 for site in sites]
        return {site: math.isqrt(count // min(turns)) for site, count in zip(sites, turns, strict=True)}

    @property
    def draws(self) -> int:
        """Return the levels a patch is rescaled to."""
        return self.recipe.first_draws if self.number == FIRST else self.recipe.draws

    def brightness(self, target: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the brightness (patch) that errors are relative to, from targets (patch, output): Y if there is one,
        else the mean."""
        return np.maximum(brightness_of(target, self.head.outputs), np.float32(0.0))


def at_noise(pass_: TrainingPass, noise: NoiseScale, classes: ClassRecipe) -> TrainingPass:
    """Return the pass for frames of other noise over time, by the class edges that follow it (docs/method.md#noise-sets)."""
    camera = pass_.head.camera.under(noise)
    made = make_rule(classes, camera, pass_.rule.case_of_code, dark=camera.dark_signal(pass_.exposure))
    rule = replace(pass_.rule, contrast_edges=made.contrast_edges, features=made.features)
    return replace(pass_, head=replace(pass_.head, camera=camera), rule=rule)


def spread_patches(patches: int, frames: Sequence[int], shares: Sequence[Fraction] | None) -> tuple[int, ...]:
    """Return the patches (frame) of training sets with so many `frames` (set): evenly over all frames or, with `shares`
    (set), in their proportion over the sets and evenly over the frames of each, rounded up (docs/method.md#patches)."""
    parts = shares if shares is not None else [Fraction(count) for count in frames]
    each = [math.ceil(patches * part / sum(parts) / count) for part, count in zip(parts, frames, strict=True)]
    return tuple(value for value, count in zip(each, frames, strict=True) for _ in range(count))


def brightness_of(target: NDArray, outputs: tuple[str, ...]) -> NDArray:
    """Return Y of targets (…, output), or their mean where no output is called Y."""
    return target[..., outputs.index("Y")] if "Y" in outputs else target.mean(axis=-1)


def has_two_passes(head: TrainingSet, recipe: LearningRecipe) -> bool:
    """Return whether a first pass weighs the rows of the last: errors are judged in Lab or as spectral angles, so for XYZ
    and spectra only."""
    return recipe.first_draws > 0 and (head.outputs == XYZ or is_spectrum(head.outputs, head.camera.channels))


BATCH = 50_000  # patches that are sorted together: bounds memory, and makes a class's product large enough to be fast
LAYER_ROWS = 300_000  # of a refinement layer that are sorted together
SUM_BYTES = 200 << 20  # of sums that a process fills at a time, if it is more than those of two sites


@dataclass(frozen=True)
class WorkShare:
    """Blocks and sites that one process sums up in one go over the frames."""

    blocks: tuple[tuple[range, tuple[int, ...]], ...]  # frames, and the canonical sites that take patches from them
    whole: tuple[int, ...]  # the sites that no other share takes part in

    @property
    def sites(self) -> tuple[int, ...]:
        return tuple(sorted({site for _, sites in self.blocks for site in sites}))


def frame_blocks(patches: Sequence[int], most: int | None = None) -> list[range]:
    """Return the frames, with so many `patches` (frame), in runs of about `most`, BATCH if not given, or less, which are
    sorted together; whole blocks are dealt to shards and processes. Blocks are nearly equal, so that nobody waits for the
    largest."""
    total, before = sum(patches), 0
    blocks = -(-total // (most or BATCH))
    starts: list[int] = []
    for index, count in enumerate(patches):
        if before * blocks // total >= len(starts):
            starts.append(index)
        before += count
    return [range(first, last) for first, last in itertools.pairwise([*starts, len(patches)])]


def work_shares(pass_: TrainingPass, divisors: Mapping[int, int], blocks: list[range], jobs: int) -> list[WorkShare]:
    """Return all blocks of all sites, whose patches are divided by `divisors`, in nearly equal shares for `jobs` processes,
    each of as few sites as can be."""
    one = empty_sums(pass_.rule, len(pass_.head.outputs))
    most = max(2, SUM_BYTES // one.moments.nbytes)  # sites at a time
    units = [(site, block) for site in divisors for block in blocks]
    work = np.cumsum([0.0, *(1 / divisors[site] for site, _ in units)])
    for count in itertools.count(jobs, jobs):
        edges = np.searchsorted(work, work[-1] * np.arange(count + 1) / count - 1e-9).tolist()
        parts = [units[first:last] for first, last in itertools.pairwise(edges) if last > first]
        if max((len({site for site, _ in part}) for part in parts), default=0) <= most:
            break
    return [
        WorkShare(
            tuple(
                (block, tuple(site for site, frames in part if frames == block))
                for block in blocks
                if block in {frames for _, frames in part}
            ),
            tuple(site for site in divisors if all((site, block) in part for block in blocks)),
        )
        for part in parts
    ]
