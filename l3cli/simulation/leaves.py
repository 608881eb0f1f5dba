"""Geometry of procedural scenes: leaves that cover each other, random fields (docs/method.md#procedural-scenes).

Natural pictures are scale invariant because objects of every size occlude each other: "dead leaves" of density r⁻³ have
their edges, their power spectrum and their contrast statistics (Lee, Mumford and Huang, 2001).
"""

import functools
import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float32]

EXPONENT = 2.0  # of the cumulative distribution: density r^-3
UNCOVERED = 0.003  # share of the picture left to the ground, which would take long to cover
BATCH = 400  # pixels for each leaf that is drawn before what is still uncovered is counted anew


@dataclass(frozen=True)
class Leaves:
    """Which leaf is seen at each pixel, and where the leaves lie; the last one is the ground."""

    label: NDArray[np.int32]  # (row, col) index of the leaf
    row: Field  # (leaf) centre, pixels
    col: Field  # (leaf)
    radius: Field  # (leaf) pixels


def dead_leaves(rng: np.random.Generator, shape: tuple[int, int], smallest: float, largest: float) -> Leaves:
    """Leaves of five shapes with radii in `smallest`…`largest` pixels laid from front to back over `shape` (rows, cols)."""
    label = np.full(shape, -1, np.int32)
    seen: list[tuple[float, float, float]] = []
    free = label.size
    while free > UNCOVERED * label.size:
        radius = _radii(rng, max(1, label.size // BATCH), smallest, largest)
        row = rng.uniform(-radius, shape[0] + radius)
        col = rng.uniform(-radius, shape[1] + radius)
        for leaf in np.flatnonzero(_may_show(label, row, col, radius)):
            covered = _lay(rng, label, len(seen), row[leaf], col[leaf], radius[leaf])
            if covered:
                seen.append((row[leaf], col[leaf], radius[leaf]))
                free -= covered
    label[label < 0] = len(seen)
    seen.append((shape[0] / 2, shape[1] / 2, max(shape) / 2))
    rows, cols, radii = np.array(seen, np.float32).T
    return Leaves(label, rows, cols, radii)


def _radii(rng: np.random.Generator, count: int, smallest: float, largest: float) -> NDArray[np.float64]:
    """`count` radii of density ∝ r^-3 between `smallest` and `largest`."""
    share = rng.random(count)
    near, far = smallest**-EXPONENT, largest**-EXPONENT
    return (near + share * (far - near)) ** (-1.0 / EXPONENT)


def _may_show(
    label: NDArray[np.int32], row: NDArray[np.float64], col: NDArray[np.float64], radius: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Whether the square about each leaf still holds an uncovered pixel: most leaves drawn late are hidden."""
    count = np.zeros((label.shape[0] + 1, label.shape[1] + 1), np.int32)
    np.cumsum(label < 0, axis=1, out=count[1:, 1:])
    for above, below in itertools.pairwise(count[1:]):  # a tenth of the time of cumsum down the columns
        below += above
    top, bottom = _span(row, radius, label.shape[0])
    left, right = _span(col, radius, label.shape[1])
    return count[bottom, right] - count[top, right] - count[bottom, left] + count[top, left] > 0


def _span(centre: NDArray, radius: NDArray, length: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First pixel and one past the last of each leaf, clipped to the picture."""
    first = np.clip(centre - radius, 0, length).astype(np.intp)
    last = np.clip(centre + radius + 1, 0, length).astype(np.intp)
    return first, last


def _lay(rng: np.random.Generator, label: NDArray[np.int32], leaf: int, row: float, col: float, radius: float) -> int:
    """Put one leaf of random shape and direction under those that lie there; the number of pixels it shows."""
    shape, angle, slimness = int(rng.integers(5)), rng.uniform(0, np.pi), rng.uniform(0.2, 1.0)
    top, left = max(0, int(row - radius)), max(0, int(col - radius))
    window = label[top : max(0, int(row + radius + 1)), left : max(0, int(col + radius + 1))]
    if not (window < 0).any():
        return 0
    y = np.arange(top, top + window.shape[0], dtype=np.float32)[:, None] - np.float32(row)
    x = np.arange(left, left + window.shape[1], dtype=np.float32) - np.float32(col)
    shown = inside(shape, y, x, radius, angle, slimness) & (window < 0)
    window[shown] = leaf
    return int(np.count_nonzero(shown))


def inside(shape: int, y: Field, x: Field, radius: float, angle: float, slimness: float) -> NDArray[np.bool_]:
    """Mask of a disc, an ellipse, a rectangle, a triangle or a lobed leaf about (0, 0) within `radius`."""
    if shape == 0:
        return x**2 + y**2 < radius**2
    along = x * np.float32(np.cos(angle)) + y * np.float32(np.sin(angle))
    across = y * np.float32(np.cos(angle)) - x * np.float32(np.sin(angle))
    if shape == 1:
        return along**2 + (across / slimness) ** 2 < radius**2
    if shape == 2:
        return (abs(along) < 0.7 * radius) & (abs(across) < 0.7 * radius * slimness)
    if shape == 3:
        half = 0.5 * radius
        return (along > -half) & (abs(across) < half * slimness - 0.5 * along)
    turn = np.arctan2(across, along)
    edge = 0.7 + 0.15 * np.sin(3 * turn + angle) + 0.12 * np.sin(5 * turn + 9 * angle)
    return np.hypot(along, across) < radius * edge


def pink(rng: np.random.Generator, shape: tuple[int, int], exponent: float, stretch: float = 1.0) -> Field:
    """A random field (row, col) with amplitude ∝ 1/frequency^exponent, mean 0 and variance 1; `stretch` > 1 draws it out
    in a random direction."""
    from scipy import fft

    angle = rng.uniform(0, np.pi) if stretch != 1.0 else 0.0
    spectrum = fft.rfft2(rng.standard_normal(shape, dtype=np.float32))
    spectrum *= np.exp(_log_frequencies(shape, stretch, angle) * np.float32(-exponent))
    spectrum[0, 0] = 0.0
    field: Field = fft.irfft2(spectrum, s=shape)
    field /= field.std()
    return field


@functools.lru_cache(maxsize=1)  # most fields of a frame have no direction
def _log_frequencies(shape: tuple[int, int], stretch: float, angle: float) -> Field:
    """Logarithm of the frequency (cycles a pixel) of each coefficient of a real transform, `stretch` times as high at
    `angle`; at least one period a picture."""
    from scipy import fft

    down = fft.fftfreq(shape[0])[:, None].astype(np.float32)
    across = fft.rfftfreq(shape[1])[None].astype(np.float32)
    cosine, sine = np.float32(np.cos(angle)), np.float32(np.sin(angle))
    along = (down * cosine + across * sine) * np.float32(stretch)
    power = along**2 + (across * cosine - down * sine) ** 2
    return np.float32(0.5) * np.log(np.maximum(power, np.float32(1.0 / max(shape) ** 2)))
