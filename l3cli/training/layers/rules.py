"""Class rules of a plane layer: by structure, or by a tree grown for it (docs/method.md#structure, docs/method.md#trees)."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.plane_rules import FACTORS, MOST_SHIFT, GradientScale, StructureRule, TreeRule
from l3cli.artifacts.table import PLANE_STEP
from l3cli.artifacts.training_set import TrainingPair
from l3cli.classes import structure
from l3cli.classes.planes import LUMINANCE
from l3cli.classes.refinement import plane_evidence
from l3cli.training.layers.learn import LayerPass
from l3cli.training.layers.mosaics import LARGEST_SIDE, mosaics_of
from l3cli.training.layers.rows import row_weights
from l3cli.training.layers.tree import TreeSample, grow, turned_evidence
from l3cli.training.symmetry import orientations

PILOT_MOSAICS = 48  # over all frames, that tell how noisy the first layer's luminance is
BRIGHTEST = 0.8  # share of full scale up to which they tell
FEWEST = 1000  # pixels of a level that tell
LAB_SLOPES = (500.0, 116.0, 200.0)  # of a*, L* and b* with the planes of a white of 1


def luminance_noise(layer: LayerPass, frames: Iterable[TrainingPair], first: int, every: int) -> list[NDArray[np.float64]]:
    """Return, for every frame whose index, `first` being that of the first, is a multiple of `every`, sums of squared
    differences that noise makes between pixels two apart of the luminance, and their number (2, level)."""
    see, noisy, measured = layer.seer(), replace(layer.exposed, noisy=True, inner=LARGEST_SIDE), []
    brightest = BRIGHTEST * layer.camera.sensitivity.mean() / layer.camera.sensitivity.min()
    for index, frame in enumerate(frames, first):
        if index % every:
            continue
        total = np.zeros((2, layer.rule.levels))
        rng = layer.rng(index, 0)
        for mosaic in mosaics_of(frame, 1, noisy, rng):
            seen = see(mosaic)
            noise = seen.noisy[LUMINANCE] - seen.clean[LUMINANCE]
            across, down = noise[1:-1, 2:] - noise[1:-1, :-2], noise[2:, 1:-1] - noise[:-2, 1:-1]
            place = layer.rule.split(seen.label)
            tells = ((layer.rule.lost(place.kind) == 0) & (seen.brightness < brightest))[1:-1, 1:-1]
            level = place.level[1:-1, 1:-1][tells]
            total[0] += np.bincount(level, ((across**2 + down**2) / 2)[tells], layer.rule.levels)
            total[1] += np.bincount(level, minlength=layer.rule.levels)
        measured.append(total)
    return measured


def gradient_scale(layer: LayerPass, noise: Iterable[NDArray[np.float64]]) -> GradientScale:
    """The scale at which noise has a standard deviation of SIGMA, from `luminance_noise` of all frames in order."""
    squares, count = np.sum([np.zeros((2, layer.rule.levels)), *noise], axis=0)
    known = np.flatnonzero((count >= min(FEWEST, count.max())) & (squares > 0))
    deviation = np.ones(layer.rule.levels)
    if known.size:
        spread = np.log(squares[known] / count[known]) / 2
        deviation = np.exp(np.interp(np.arange(layer.rule.levels), known, spread))
    scale = structure.SIGMA / deviation  # = factor / 2^shift, with a factor of 7 bits
    shift = np.clip(np.ceil(np.log2(FACTORS[0] / scale)), 0, MOST_SHIFT)
    factor = np.clip(np.rint(scale * 2**shift), 1, FACTORS[1])
    return GradientScale(factor.astype(np.uint8), shift.astype(np.uint8))


def structure_rule(layer: LayerPass, scale: GradientScale) -> StructureRule:
    """Classes by level and structure."""
    return StructureRule(
        **vars(scale),
        level_step=layer.recipe.level_step,
        strength_edges=np.rint(np.array(layer.recipe.strengths) * structure.NOISE_TRACE).astype(np.uint32),
        coherence=round(64 * layer.recipe.coherence),
        turns=np.array([structure.turn_signs(orientations(3)[turn]) for turn in layer.turns], np.int8),
        cases=layer.rule.lost_cases,
    )


def sample_tree(
    layer: LayerPass, scale: GradientScale, frames: Iterable[TrainingPair], first: int
) -> list[dict[int, TreeSample]]:
    """Return, for every frame, the first of which has the index `first`, rows of each canonical site that a tree is grown
    on."""
    see, reading, sampled = layer.seer(), layer.reading(layer.recipe.side), []
    judged, turns = _judged(layer), layer.turns
    rows = -(-layer.recipe.tree_rows // sum(layer.mosaics))
    for index, frame in enumerate(frames, first):
        rng = layer.rng(index, 2)
        parts: dict[int, list[TreeSample]] = {}
        for mosaic in mosaics_of(frame, layer.mosaics[index], layer.exposed, rng):
            seen = see(mosaic)
            place = layer.rule.split(seen.label)
            site = np.broadcast_to(place.site, seen.label.shape).ravel()
            weight = row_weights(seen, layer.basis, layer.white_point, layer.learning, layer.pictures).ravel()
            target = seen.target.reshape(-1, seen.target.shape[-1]) @ judged
            evidence = plane_evidence(seen.noisy, place.level, scale.gradient_factor, scale.gradient_shift)
            inner = seen.inner_pixels(layer.margin)
            free = inner[(layer.rule.lost(place.kind) == 0).ravel()[inner]]
            for canonical in np.unique(reading.canonical).tolist():
                of_site = free[reading.canonical[site[free]] == canonical]
                chosen = rng.choice(of_site, min(rows, of_site.size), replace=False)
                for one in np.unique(site[chosen]).tolist():
                    pixels = chosen[site[chosen] == one]
                    places = pixels[:, None] + reading.offsets(seen.label.shape[1])[one]
                    taps = np.concatenate([plane.take(places) for plane in seen.noisy], axis=1) * np.float32(PLANE_STEP)
                    weights = weight[pixels, None]
                    parts.setdefault(canonical, []).append(
                        TreeSample(taps * weights, target[pixels] * weights, *turned_evidence(evidence, turns[one], pixels))
                    )
        sampled.append({site: TreeSample.concatenated(several) for site, several in parts.items()})
    return sampled


def tree_rule(layer: LayerPass, scale: GradientScale, samples: Sequence[dict[int, TreeSample]]) -> TreeRule:
    """Classes by the leaves of a tree grown on the samples of all frames in order."""
    sites = sorted({site for sample in samples for site in sample})
    tree = grow(
        [TreeSample.concatenated([one[site] for one in samples if site in one]) for site in sites], layer.recipe.leaves
    )
    return TreeRule(**vars(scale), **tree._asdict(), turns=np.array(layer.turns, np.uint8), cases=layer.rule.lost_cases)


def _judged(layer: LayerPass) -> NDArray[np.float32]:
    """Return the matrix (judged, output) that brings errors of the outputs into the space in which they are judged: of X,
    Y, Z steps of L*a*b* near white."""
    if not layer.pictures:
        return np.eye(3, dtype=np.float32)
    white = layer.white_point / layer.white_point[LUMINANCE]
    return np.asarray(layer.basis * (np.array(LAB_SLOPES) / white), np.float32)
