"""Accumulate the normal equations of each class from patches (docs/method.md#training).

Patches are added in two steps, so that intermediate arrays fit into the processor caches:

1. Small groups of patches are scaled to random levels, noise is added, and each patch is assigned to a class. Only its
   class, level and scale factor are kept.
2. The patches are sorted by class, scaled again without noise, and weighted. Each patch's taps, intercept and outputs are
   multiplied pairwise, and the products are added to the sums of its class.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.partial_sums import ClassSums
from l3cli.artifacts.training_set import TrainingPair
from l3cli.classes.decide import label_sums
from l3cli.classes.level import unclipped_level
from l3cli.classes.statistics import patch_statistics, truncation
from l3cli.classes.windows import Neighbourhoods, TapOrder, neighbourhoods, tap_order
from l3cli.training.lines import LineNoise, Offsets, SharedNoise
from l3cli.training.patches import Floats, Patches, colourless_frame, expose_patches, lacking_variance, levels_at, patches_of
from l3cli.training.sample_weighting import TARGET_FLOOR, SampleWeighting
from l3cli.training.sums import add_products, add_rounded, empty_sums, grid_steps, pieces_of, rounding_number, runs_of
from l3cli.training.training_pass import BATCH_PATCHES, TrainingPass

EXPOSED_PATCHES = 4096  # number of patches per group in step 1, small enough for the processor caches
CLIPPED_GREY_EDGES = 8.0  # weight of grey patches at edges of clipped areas, such as text on over-exposed paper
DARKEST_LEVEL = 1e-4  # lower limit of the level in a patch's training weight, as a fraction of full scale


def sum_sites(
    pass_: TrainingPass,
    blocks: Iterable[tuple[int, tuple[int, ...], Iterator[TrainingPair]]],
    weightings: Mapping[int, SampleWeighting | None],
) -> dict[int, ClassSums]:
    """Draw training patches from frames, and accumulate each class's sums at each site.

    Parameters
    ----------
    pass_ : TrainingPass
        Settings of the pass.
    blocks : iterable of (int, tuple of int, iterator of TrainingPair)
        For each block of frames: the index of its first frame, the sites to sum, and its frames.
    weightings : mapping of int to SampleWeighting or None
        For each site, the object that computes weights from the errors of the first pass, or None in the first pass.

    Returns
    -------
    dict of int to ClassSums
        Sums by site.
    """
    neighbours = neighbourhoods(pass_.head.camera.cfa, pass_.rule.patch, len(pass_.head.camera.channels))
    sums = {site: empty_sums(pass_.rule, len(pass_.head.outputs), pass_.head.camera) for site in weightings}
    for first, sites, frames in blocks:
        rngs = {site: np.random.default_rng([pass_.seed, pass_.number, first, site]) for site in sites}
        for site, patches in _batches(pass_, first, frames, neighbours, rngs):
            _Batch(pass_, patches, neighbours, site, weightings[site]).add_to(sums[site], rngs[site])
    return sums


def _batches(
    pass_: TrainingPass,
    first: int,
    frames: Iterator[TrainingPair],
    neighbours: Neighbourhoods,
    rngs: dict[int, np.random.Generator],
) -> Iterator[tuple[int, Patches]]:
    """Draw patches from a block of frames, and yield them in batches (site, patches).

    `first` is the index of the block's first frame. A site's patches from the whole block form one batch, unless a single
    frame has more than `BATCH_PATCHES` patches.
    """
    waiting: dict[int, list[Patches]] = {site: [] for site in rngs}
    for index, frame in enumerate(frames, first):
        colourless = colourless_frame(frame, pass_.head) if pass_.recipe.achromatic else None
        for site, rng in rngs.items():
            rest = -(-pass_.patches[index] // pass_.divisors[site])
            while rest:
                count = min(rest, BATCH_PATCHES)
                rest -= count
                how = pass_.recipe.orientations(pass_.head.camera), pass_.recipe.achromatic, colourless
                waiting[site].append(patches_of(frame, pass_.head, neighbours, site, count, rng, *how))
                if rest:
                    yield site, waiting[site].pop()
    for site, patches in waiting.items():
        yield site, Patches.concatenated(patches)
        patches.clear()


class _Batch:
    """A batch of patches for one site."""

    def __init__(
        self, pass_: TrainingPass, patches: Patches, neighbours: Neighbourhoods, site: int, weighting: SampleWeighting | None
    ) -> None:
        self.pass_, self.patches, self.neighbours, self.site, self.weighting = pass_, patches, neighbours, site, weighting
        self.lines = LineNoise.of(pass_.head.camera, pass_.dark)
        member = (neighbours.channel[site][:, None] == np.arange(neighbours.count.shape[1])) / neighbours.count[site]
        # weights of the taps in a patch's level, which is the mean of its channel means
        self.tap_share = member.mean(axis=1).astype(np.float32)

    def add_to(self, sums: ClassSums, rng: np.random.Generator) -> None:
        """Scale the patches to random levels, assign them to classes, and add them to `sums`."""
        label, level, scale = self._exposed(rng)
        order = np.argsort(label, kind="stable")
        label = label[order]
        large = rounding_number(grid_steps(self.pass_.rule, self.pass_.head.camera, self.patches.target.shape[1]))
        for piece in pieces_of(label):
            draw = order[piece]
            patch = draw % len(self.patches.signal)
            self._add_piece(sums, large, label[piece], level[draw], scale[draw], patch, rng)

    def _exposed(self, rng: np.random.Generator) -> tuple[NDArray[np.unsignedinteger], Floats, Floats]:
        """Scale each patch to several levels, add noise, and assign the results to classes.

        Returns three flat arrays, sorted by draw and then by patch: the classes, the levels of the noisy and clipped
        patches, and the scale factors.
        """
        pass_, signal = self.pass_, self.patches.signal
        patch_level = np.maximum(signal @ self.tap_share, 1e-3)
        start = rng.random(patch_level.size)
        scales = [self._scale(patch_level, (start + draw / pass_.draws) % 1) for draw in range(pass_.draws)]
        scale: Floats = np.array([self.patches.possible(one) for one in scales], np.float32)
        label = np.empty(scale.shape, dtype=np.min_scalar_type(pass_.rule.classes_per_site))
        level = np.empty_like(scale)
        order = tap_order(pass_.rule, self.neighbours, self.site)
        for first in range(0, len(signal), EXPOSED_PATCHES):
            batch = slice(first, first + EXPOSED_PATCHES)
            for draw, seen in enumerate(self._seen(batch, scale[:, batch], order, rng)):
                label[draw, batch], level[draw, batch] = seen
        return label.reshape(-1), np.maximum(level, np.float32(DARKEST_LEVEL)).reshape(-1), scale.reshape(-1)

    def _scale(self, patch_level: Floats, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the factors that scale the patches to the levels from `levels_at`."""
        if not self.pass_.recipe.rescale:
            return np.ones(patch_level.size)
        return levels_at(self.pass_.recipe, places) / patch_level

    def _seen(
        self, batch: slice, scale: Floats, order: TapOrder, rng: np.random.Generator
    ) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float64]]]:
        """Scale the patches in `batch` by each row of `scale` (draw, patch), add noise, and yield classes and levels."""
        pass_, patches = self.pass_, self.patches
        signal: Floats = np.ascontiguousarray(patches.signal[batch].T)[order.taps]
        channel = self.neighbours.channel[self.site][order.taps][:, None]
        carried: Floats | None = None if patches.carried is None else patches.carried[batch].T[order.taps]
        part = Patches(patches.signal[batch], patches.target[batch], None if carried is None else carried.T)
        for factor in scale:
            left = None if carried is None else carried * factor**2
            offsets = None
            if self.lines is not None and pass_.recipe.noise != "none":
                offsets = self.lines.drawn_for_taps(order.taps, pass_.rule.patch, part.lacking_share(factor), rng)
            values = self._exposed_values(signal * factor, rng, left, channel, offsets)
            seen = patch_statistics(values, pass_.rule, order)
            yield label_sums(seen, pass_.rule, self.neighbours, self.site), self._level(seen.sums)

    def _exposed_values(
        self, signal: Floats, rng: np.random.Generator, carried: Floats | None, channel: NDArray[np.int64],
        offsets: Offsets | None,
    ) -> NDArray[np.uint32]:  # fmt: skip
        """Convert signals to raw values with noise or, if the recipe sets noise = "none", without noise."""
        camera = self.pass_.head.camera
        if self.pass_.recipe.noise != "none":
            return expose_patches(signal, camera, rng, carried, self.pass_.dark, channel, offsets)
        values = signal * np.float32(camera.white_level - camera.black_level) + np.float32(camera.black_level)
        return np.clip(np.rint(values), 0.0, np.floor(camera.white_level)).astype(np.uint32)

    def _level(self, sums: NDArray[np.uint32]) -> NDArray[np.float64]:
        """Compute each patch's level, as a fraction of full scale, from its channel sums (channel, patch)."""
        camera, shift = self.pass_.head.camera, self.pass_.rule.shift
        mean = (1 / (self.neighbours.count[self.site] * len(sums))) @ sums
        seen = (mean * 2**shift + (truncation(shift) - camera.black_level)) / (camera.white_level - camera.black_level)
        return np.asarray(unclipped_level(seen, camera.sensitivity), np.float64)

    def _add_piece(
        self,
        sums: ClassSums,
        large: NDArray[np.float64],
        label: NDArray[np.unsignedinteger],
        level: Floats,
        scale: Floats,
        patch: NDArray[np.int64],
        rng: np.random.Generator,
    ) -> None:
        """Scale and weight patches, and add the pairwise products of their columns to the sums.

        Parameters
        ----------
        sums : ClassSums
            Sums of the site, changed in place.
        large : ndarray, (level, pair)
            Results of `rounding_number`, used to round the products to grid steps.
        label : ndarray, (patch)
            Class of each patch. The patches are sorted by class.
        level : ndarray, (patch)
            Level of each noisy patch, as a fraction of full scale.
        scale : ndarray, (patch)
            Scale factor of each patch.
        patch : ndarray, (patch)
            Index of each patch in the batch.
        rng : Generator
            Random number generator.
        """
        clean = self.patches.signal.take(patch, axis=0)
        clean *= scale[:, None]
        target = self.patches.target[patch] * scale[:, None]
        carried = None if self.patches.carried is None else self.patches.carried[patch] * scale[:, None] ** 2
        window = self.neighbours.channel[self.site]
        variance = lacking_variance(clean, self.pass_.head.camera, carried, self.pass_.dark, window)
        shared = None if self.lines is None else self._shared(self.lines, clean, patch, scale)
        if self.pass_.recipe.noise == "none":
            variance[:] = 0
        if self.pass_.recipe.noise == "sampled":
            if shared is not None:
                every, one = np.arange(clean.shape[1]), np.ones(len(clean))
                clean += shared.shares * shared.noise.drawn_for_taps(every, self.pass_.rule.patch, one, rng).values.T
                variance = np.maximum(variance - np.float32(shared.noise.total) * shared.shares**2, 0)
            clean += np.sqrt(variance) * rng.standard_normal(clean.shape, dtype=np.float32)
            variance[:] = 0
        if self.pass_.recipe.noise != "analytic":
            shared = None
        np.clip(clean, -np.inf, 1.0, out=clean)
        runs = runs_of(label)
        brightness = self.pass_.brightness(target) / level + np.float32(TARGET_FLOOR)
        weight = brightness ** np.float32(-self.pass_.recipe.brightness_power) / level ** np.float32(
            self.pass_.recipe.level_power
        )
        if self.patches.colourless is not None:
            edges = self.pass_.rule.split(label).combination > 0
            greys = self.patches.colourless[patch] & edges & (clean >= 1).any(axis=1)
            weight[greys] *= np.float32(math.sqrt(CLIPPED_GREY_EDGES))
        if self.weighting is not None:
            weight *= self.weighting.weight(clean, variance, target, level, runs, shared)
        taps = clean.shape[1]
        samples = np.empty((len(label), taps + 1 + target.shape[1]), np.float32)
        np.multiply(clean, weight[:, None], out=samples[:, :taps])
        samples[:, taps] = weight
        np.multiply(target, weight[:, None], out=samples[:, taps + 1 :])
        levels = self.pass_.rule.split(np.array([index for index, _, _ in runs])).level.tolist()
        add_products(sums.moments, samples, runs, [large[level] for level in levels])
        weighted = None if shared is None else replace(shared, shares=shared.shares * weight[:, None])
        weight = weight**2
        for index, first, last in runs:
            noise = weight[first:last] @ variance[first:last]
            if weighted is not None:
                noise = np.concatenate([noise, weighted.of(first, last).covariances()])
            add_rounded(sums.noise[index, : noise.size], noise, large[0, 0])
            sums.count[index] += last - first

    def _shared(self, lines: LineNoise, clean: Floats, patch: NDArray[np.int64], scale: Floats) -> SharedNoise:
        """Return the row and column noise that must be added to scaled patches.

        Parameters
        ----------
        lines : LineNoise
            Line noise of the camera.
        clean : ndarray, (patch, tap)
            Signals of the scaled patches, as fractions of full scale.
        patch : ndarray, (patch)
            Index of each patch in the batch.
        scale : ndarray, (patch)
            Scale factor of each patch.

        Returns
        -------
        SharedNoise
            The camera's line noise, and the factor by which it is multiplied at each tap. The factor is lower for patches
            that already contain noise.
        """
        pass_, chosen = self.pass_, self.patches
        gain = pass_.head.camera.channel_gains.astype(np.float32)[self.neighbours.channel[self.site]]
        carried = None if chosen.carried is None else chosen.carried[patch]
        lacking = Patches(clean, chosen.target[patch], carried).lacking_share(scale)
        return SharedNoise(lines, (clean < 1) * gain * np.sqrt(lacking, dtype=np.float32)[:, None])
