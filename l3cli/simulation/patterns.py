"""Fine patterns on leaves: gratings, lattices and lettering of two reflectances (docs/method.md#procedural-scenes).

Fences, windows, blinds, cloth and print repeat with a few pixels a period, where a colour filter array cannot tell light
from colour; dead leaves alone have next to none of it.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.physics.paint import with_saturation

Array = NDArray[np.floating]

KINDS = {"grating": 0.4, "lattice": 0.35, "lettering": 0.25}  # share of each
PERIODS = (2.0, 16.0)  # pixels of the scene, log-uniform
DUTIES = (0.15, 0.6)  # share of a period that the second reflectance covers
NEUTRAL, PALE = 0.5, 0.2  # share of patterns of near-neutral reflectances; the highest saturation of these
CONTRAST = 0.5  # standard deviation of the logarithm by which the second reflectance is scaled
LINES = (2.0, 3.5)  # distance of lines of lettering, in strokes


@dataclass(frozen=True)
class Patterns:
    """Patterns that cover shares of each leaf; lengths in samples. Arrays of one value a leaf but where said."""

    present: NDArray[np.bool_]  # whether a leaf has a pattern
    first: NDArray[np.float32]  # (leaf, band) reflectance between the strokes, or all over
    second: NDArray[np.float32]  # (leaf, band) reflectance of the strokes
    kind: NDArray[np.intp]  # index into KINDS
    angle: NDArray[np.float32]  # radians, of the direction across the strokes
    period: NDArray[np.float32]  # (2, leaf) across and along the strokes
    width: NDArray[np.float32]  # (2, leaf) of the strokes across, of the bars along
    phase: NDArray[np.float32]  # (2, leaf) shares of a period


def draw_patterns(
    rng: np.random.Generator,
    share: float,
    materials: Array,
    reflectance: Array,
    oversampling: int,
    drawn: NDArray[np.bool_] | slice = slice(None),
) -> Patterns:
    """Draw patterns on `share` of the leaves of `reflectance` (leaf, band), their second colours from `materials` (material,
    band), whose bands `drawn` say how saturated they are; scenes are drawn with `oversampling` samples a pixel."""
    count = len(reflectance)
    first, second = reflectance.copy(), materials[rng.integers(len(materials), size=count)]
    present = rng.random(count) < share
    pale = present & (rng.random(count) < NEUTRAL)
    saturation = rng.uniform(0.0, PALE, count)
    for leaf in np.flatnonzero(pale):
        first[leaf] = with_saturation(first[leaf], saturation[leaf], drawn)
        second[leaf] = with_saturation(second[leaf], saturation[leaf], drawn)
    second = np.minimum(second * np.exp(CONTRAST * rng.standard_normal(count))[:, None], 1.0)
    across = oversampling * np.exp(rng.uniform(math.log(PERIODS[0]), math.log(PERIODS[1]), count))
    kind = rng.choice(len(KINDS), size=count, p=list(KINDS.values()))
    along = across * np.where(kind == 2, rng.uniform(*LINES, count), np.exp(rng.uniform(np.log(0.5), np.log(3.0), count)))
    period = np.maximum([across, along], oversampling * PERIODS[0])
    duty = rng.uniform(*DUTIES, (2, count))
    duty[1] = np.where(kind == 2, 1.5 / (along / across), duty[1])  # lettering is blank between its lines
    return Patterns(
        present=present,
        first=first.astype(np.float32),
        second=second.astype(np.float32),
        kind=kind,
        angle=rng.uniform(0, np.pi, count).astype(np.float32),
        period=period.astype(np.float32),
        width=(np.minimum(duty, 0.85) * period).astype(np.float32),
        phase=rng.random((2, count)).astype(np.float32),
    )


def coverage(patterns: Patterns, label: NDArray[np.integer], down: Array, across: Array) -> NDArray[np.float32]:
    """Return the share of each sample (row, col) that the strokes on its leaf `label` cover: 0…1, 0 on leaves without a
    pattern. `down` (row, 1) and `across` (col) are the samples' positions."""
    cosine, sine = np.cos(patterns.angle)[label], np.sin(patterns.angle)[label]
    u, v = across * cosine + down * sine, down * cosine - across * sine
    stroke, place = _strokes(patterns, 0, label, u)
    bar, line = _strokes(patterns, 1, label, v)
    kind = patterns.kind[label]
    lattice = np.maximum(stroke, bar)
    lettering = bar * np.where(_coin(place, line, label), stroke, _coin(line, place, label))
    covered = np.choose(kind, [stroke, lattice, lettering])
    return np.where(patterns.present[label], covered, np.float32(0.0)).astype(np.float32)


def _strokes(
    patterns: Patterns, axis: int, label: NDArray[np.integer], position: Array
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Return the share of each sample that strokes across `axis` cover, as if these lay along the samples, and their
    numbers."""
    period, width = patterns.period[axis][label], patterns.width[axis][label]
    turns = position / period + patterns.phase[axis][label]
    number = np.floor(turns)
    distance = abs(turns - number - 0.5) * period  # from the middle of a stroke, samples
    covered = np.clip(0.5 + 0.5 * width - distance, 0.0, np.minimum(width, 1.0))
    return covered.astype(np.float32), number.astype(np.int64)


def _coin(one: NDArray[np.int64], other: NDArray[np.int64], label: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Return heads or tails for each pair of numbers on a leaf, without a generator: a multiplicative hash."""
    mixed = (one * 73856093) ^ (other * 19349663) ^ (label.astype(np.int64) * 83492791)
    return ((mixed * 2654435761) >> 16) & 1 == 1
