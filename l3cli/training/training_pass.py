"""One pass over the training frames. A table takes two: the first shows how visible errors are, the second weighs them.

A pass holds everything that its work has in common. Its work is divided into blocks of frames, which are divided among
processes. The sums do not depend on that division.
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
from l3cli.training.goal import Goal, goal_of
from l3cli.training.recipe import LearningRecipe
from l3cli.training.sums import empty_sums
from l3cli.training.symmetry import site_maps, stabilisers

FIRST, LAST = 1, 2  # errors of the first pass weight the samples of the last (docs/method.md#second-pass)


@dataclass(frozen=True)
class TrainingPass:
    """What a pass learns: from how many patches of which frames, by which class rule and recipe."""

    head: TrainingSet
    patches: tuple[int, ...]  # (frame) patches of a canonical site, before they are divided by `divisors`
    rule: ClassRule
    recipe: LearningRecipe
    white_point: NDArray[np.float64]  # (output) perfect white under the training illuminant, Y = 1
    seed: int
    number: int  # FIRST or LAST
    exposure: float = 0.0  # s; mean exposure time of the simulated frames
    light: LightSpectrum | None = None  # mean illuminant of the frames, or None if the illuminant of any frame is unknown

    @property
    def dark(self) -> float:
        """Mean dark signal, in DN above black, of a frame that the table is made for."""
        return self.head.camera.dark_signal(self.exposure)

    @functools.cached_property
    def goal(self) -> Goal:
        """The goal of the transforms, made once for all sites.

        Computing the surfaces under a light takes as long as solving one site's systems of a few channels.
        """
        return goal_of(self.head, self.white_point, self.light)

    @functools.cached_property
    def divisors(self) -> dict[int, int]:
        """The number by which the patches of each canonical site are divided (docs/method.md#symmetry).

        Each rotation or reflection that leaves the window of a site unchanged makes another patch from a patch, although not
        quite an independent one. Sites with more such symmetries therefore need fewer patches.
        """
        camera, allowed = self.head.camera, self.recipe.orientations
        channel = neighbourhoods(camera.cfa, self.rule.patch, len(camera.channels)).channel
        sites = sorted({one.canonical for one in site_maps(channel, self.rule.patch, allowed)})
        turns = [len(stabilisers(channel[site], self.rule.patch, allowed)) for site in sites]
        return {site: math.isqrt(count // min(turns)) for site, count in zip(sites, turns, strict=True)}

    @property
    def draws(self) -> int:
        """Number of levels to which each patch is rescaled."""
        return self.recipe.first_draws if self.number == FIRST else self.recipe.draws

    def brightness(self, target: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the brightness (patch) that errors are relative to.

        It is the Y of targets (patch, output), or their mean if no output is called Y, and never negative.
        """
        return np.maximum(brightness_of(target, self.head.outputs), np.float32(0.0))


def at_noise(pass_: TrainingPass, noise: NoiseScale, classes: ClassRecipe) -> TrainingPass:
    """Return a pass for frames whose temporal noise differs (docs/method.md#noise-sets).

    Parameters
    ----------
    pass_ : TrainingPass
        The pass at the noise of the camera model.
    noise : NoiseScale
        The other noise.
    classes : ClassRecipe
        Class recipe of the table, from which the class edges that depend on noise are made again.

    Returns
    -------
    TrainingPass
        The same pass with the camera and the class rule at that noise.
    """
    camera = pass_.head.camera.under(noise)
    made = make_rule(classes, camera, pass_.rule.case_of_code, dark=camera.dark_signal(pass_.exposure))
    rule = replace(pass_.rule, contrast_edges=made.contrast_edges, features=made.features)
    return replace(pass_, head=replace(pass_.head, camera=camera), rule=rule)


def spread_patches(patches: int, frames: Sequence[int], shares: Sequence[Fraction] | None) -> tuple[int, ...]:
    """Return the number of patches to take from each frame of several training sets (docs/method.md#patches).

    Parameters
    ----------
    patches : int
        Number of patches in total. The result is rounded up, frame by frame.
    frames : sequence of int, (set)
        Number of frames in each set.
    shares : sequence of Fraction, (set), or None
        Relative number of patches from each set, spread evenly over its frames. None: evenly over all frames.

    Returns
    -------
    tuple of int, (frame)
        Patches per frame, set after set.
    """
    parts = shares if shares is not None else [Fraction(count) for count in frames]
    each = [math.ceil(patches * part / sum(parts) / count) for part, count in zip(parts, frames, strict=True)]
    return tuple(value for value, count in zip(each, frames, strict=True) for _ in range(count))


def brightness_of(target: NDArray, outputs: tuple[str, ...]) -> NDArray:
    """Return the Y of targets (…, output), or their mean over the outputs if no output is called Y."""
    return target[..., outputs.index("Y")] if "Y" in outputs else target.mean(axis=-1)


def has_two_passes(head: TrainingSet, recipe: LearningRecipe) -> bool:
    """Return whether the errors of a first pass weight the samples of the last pass.

    Errors are measured in CIELAB or as spectral angles, so only tables of X, Y, Z and of spectra have two passes.
    """
    return recipe.first_draws > 0 and (head.outputs == XYZ or is_spectrum(head.outputs, head.camera.channels))


BATCH_PATCHES = 50_000  # patches sorted together: few enough for the memory, many enough for fast products per class
LAYER_SAMPLES = 300_000  # samples of a refinement layer that are sorted together
SUM_BYTES = 200 << 20  # memory for the sums that one process fills at a time; at least two sites are


@dataclass(frozen=True)
class WorkShare:
    """The blocks and sites whose sums one process adds up during one reading of the frames."""

    blocks: tuple[tuple[range, tuple[int, ...]], ...]  # frames, and the canonical sites that use them
    whole: tuple[int, ...]  # sites that belong to this share alone

    @property
    def sites(self) -> tuple[int, ...]:
        return tuple(sorted({site for _, sites in self.blocks for site in sites}))


def frame_blocks(patches: Sequence[int], most: int | None = None) -> list[range]:
    """Divide the frames into runs whose patches are sorted together.

    Shards and processes receive whole blocks. The blocks are nearly equal, so that no process waits for the largest.

    Parameters
    ----------
    patches : sequence of int, (frame)
        Patches per frame.
    most : int, optional
        Number of patches per block that is aimed at. [default: BATCH]

    Returns
    -------
    list of range
        Frames of each block.
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
    """Divide all blocks of all sites into nearly equal shares for `jobs` processes.

    Parameters
    ----------
    pass_ : TrainingPass
    divisors : mapping of int to int
        Canonical sites, and the number by which the patches of each are divided.
    blocks : list of range
        Blocks of frames from `frame_blocks`.
    jobs : int
        Number of processes.

    Returns
    -------
    list of WorkShare
        Shares, each with as few sites as possible.
    """
    one = empty_sums(pass_.rule, len(pass_.head.outputs))
    most = max(2, SUM_BYTES // one.moments.nbytes)  # number of sites at a time
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
