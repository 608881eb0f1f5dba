"""Settings of a pass over the training frames, and its division among processes.

Training usually has two passes. In the second pass, the weight of a sample depends on the visibility of its error in the
first pass. Each pass is divided into blocks of frames, which are distributed over processes. The sums do not depend on the
number of processes.
"""

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
from l3cli.classes.features import ClassRecipe
from l3cli.classes.rule import make_rule
from l3cli.classes.windows import neighbourhoods
from l3cli.physics.display import XYZ
from l3cli.physics.spectra import is_spectrum
from l3cli.physics.stokes import luminance_name
from l3cli.training.goal import Goal, goal_of
from l3cli.training.recipe import LearningRecipe
from l3cli.training.sums import empty_sums
from l3cli.training.symmetry import site_maps, stabilisers

FIRST, LAST = 1, 2  # pass numbers (docs/method.md#second-pass)


@dataclass(frozen=True)
class TrainingPass:
    """Settings of one pass, common to all frames, sites and processes."""

    head: TrainingSet
    patches: tuple[int, ...]  # (frame) number of patches per canonical site, before division by `divisors`
    rule: ClassRule
    recipe: LearningRecipe
    white_point: NDArray[np.float64]  # (output) outputs of a perfect white under the training illuminant, with Y = 1
    seed: int
    number: int  # FIRST or LAST
    exposure: float = 0.0  # mean exposure time of the simulated frames, in s
    light: LightSpectrum | None = None  # mean illuminant of the frames, or None if any frame's illuminant is unknown

    @property
    def dark(self) -> float:
        """Dark signal at the mean exposure time of the training frames, in DN above the black level."""
        return self.head.camera.dark_signal(self.exposure)

    @functools.cached_property
    def goal(self) -> Goal:
        """The training goal. It is cached, because computing it can take as long as solving one site's equations."""
        return goal_of(self.head, self.white_point, self.light)

    @functools.cached_property
    def divisors(self) -> dict[int, int]:
        """Divisor of the number of patches for each canonical site (docs/method.md#symmetry).

        If a rotation or reflection leaves the CFA around a site unchanged, the turned patch is an additional patch. Sites
        with more symmetries therefore need fewer patches.
        """
        camera, allowed = self.head.camera, self.recipe.orientations(self.head.camera)
        channel = neighbourhoods(camera.cfa, self.rule.patch, len(camera.channels)).channel
        sites = sorted({one.canonical for one in site_maps(channel, self.rule.patch, allowed)})
        turns = [len(stabilisers(channel[site], self.rule.patch, allowed)) for site in sites]
        return {site: math.isqrt(count // min(turns)) for site, count in zip(sites, turns, strict=True)}

    @property
    def draws(self) -> int:
        """Number of random levels per patch."""
        return self.recipe.first_draws if self.number == FIRST else self.recipe.draws

    def brightness(self, target: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return each target's brightness from `brightness_of`, or 0 if it is negative."""
        return np.maximum(brightness_of(target, self.head.outputs), np.float32(0.0))


def at_noise(pass_: TrainingPass, noise: NoiseScale, classes: ClassRecipe) -> TrainingPass:
    """Adapt a pass to frames with another amount of noise (docs/method.md#noise-sets).

    Parameters
    ----------
    pass_ : TrainingPass
        Pass for the camera model's noise.
    noise : NoiseScale
        Noise of the frames, relative to the camera model.
    classes : ClassRecipe
        Class recipe of the table, for recomputing the class edges that depend on noise.

    Returns
    -------
    TrainingPass
        Copy of the pass with another camera noise and class rule.
    """
    camera = pass_.head.camera.under(noise)
    made = make_rule(classes, camera, pass_.rule.case_of_code, dark=camera.dark_signal(pass_.exposure))
    rule = replace(pass_.rule, contrast_edges=made.contrast_edges, features=made.features)
    return replace(pass_, head=replace(pass_.head, camera=camera), rule=rule)


def spread_patches(patches: int, frames: Sequence[int], shares: Sequence[Fraction] | None) -> tuple[int, ...]:
    """Distribute patches over the frames of several training sets (docs/method.md#patches).

    Parameters
    ----------
    patches : int
        Total number of patches. Numbers per frame are rounded up.
    frames : sequence of int
        Number of frames in each set.
    shares : sequence of Fraction, or None
        Relative number of patches for each set, or None for the same number of patches for every frame.

    Returns
    -------
    tuple of int
        Number of patches for each frame of the first set, then for each frame of the second set, and so on.
    """
    parts = shares if shares is not None else [Fraction(count) for count in frames]
    each = [math.ceil(patches * part / sum(parts) / count) for part, count in zip(parts, frames, strict=True)]
    return tuple(value for value, count in zip(each, frames, strict=True) for _ in range(count))


def brightness_of(target: NDArray, outputs: tuple[str, ...]) -> NDArray:
    """Return each target's brightness: Y, S0, or the mean of all outputs if there is neither Y nor S0.

    The last axis of `target` contains the outputs.
    """
    name = luminance_name(outputs)
    return target[..., outputs.index(name)] if name in outputs else target.mean(axis=-1)


def has_two_passes(head: TrainingSet, recipe: LearningRecipe) -> bool:
    """Whether training has two passes.

    The second pass needs CIELAB errors or spectral angles, so the outputs must be X, Y, Z or a spectrum.
    """
    return recipe.first_draws > 0 and (head.outputs == XYZ or is_spectrum(head.outputs, head.camera.channels))


# Number of patches that are sorted by class and multiplied together. More patches would need more memory. Fewer patches
# would slow down the matrix products.
BATCH_PATCHES = 50_000
LAYER_SAMPLES = 300_000  # like BATCH_PATCHES, for the samples of refinement layers
SUM_BYTES = 200 << 20  # limit of the memory for one process's sums, in bytes; the sums of two sites may exceed it


@dataclass(frozen=True)
class WorkShare:
    """A process's part of a pass: blocks of frames, and the sites to sum in each block."""

    blocks: tuple[tuple[range, tuple[int, ...]], ...]  # frames of each block, and the canonical sites to sum
    whole: tuple[int, ...]  # sites for which this share contains all blocks, so that their sums are complete

    @property
    def sites(self) -> tuple[int, ...]:
        return tuple(sorted({site for _, sites in self.blocks for site in sites}))


def frame_blocks(patches: Sequence[int], most: int | None = None) -> list[range]:
    """Divide the frames into blocks with about equal numbers of patches.

    All patches of a block are sorted by class at once. Shards and processes receive whole blocks. Blocks have similar sizes,
    so that processes do not wait for each other.

    Parameters
    ----------
    patches : sequence of int
        Number of patches from each frame.
    most : int, optional
        Approximate number of patches per block. [default: BATCH_PATCHES]

    Returns
    -------
    list of range
        Indices of the frames in each block.
    """
    total, before = sum(patches), 0
    blocks = -(-total // (most or BATCH_PATCHES))
    starts: list[int] = []
    for index, count in enumerate(patches):
        if before * blocks // total >= len(starts):
            starts.append(index)
        before += count
    return [range(first, last) for first, last in itertools.pairwise([*starts, len(patches)])]


def work_shares(pass_: TrainingPass, divisors: Mapping[int, int], blocks: list[range], jobs: int) -> list[WorkShare]:
    """Divide the work of a pass into nearly equal shares for `jobs` processes.

    Parameters
    ----------
    pass_ : TrainingPass
        Settings of the pass.
    divisors : mapping of int to int
        Canonical sites to process, and the divisor of each site's number of patches.
    blocks : list of range
        Blocks of frames, from `frame_blocks`.
    jobs : int
        Number of processes.

    Returns
    -------
    list of WorkShare
        The shares. The work is divided into a multiple of `jobs` nearly equal parts, so that the sums of all sites in a part
        fit into SUM_BYTES. Empty parts are omitted.
    """
    one = empty_sums(pass_.rule, len(pass_.head.outputs), pass_.head.camera)
    most = max(2, SUM_BYTES // one.moments.nbytes)  # largest number of sites per share
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
