"""Geometry of dead-leaves scenes: shapes of many sizes that occlude each other (docs/method.md#procedural-scenes).

Natural images are scale invariant because objects of all sizes occlude each other. If the density of the leaf radii is
proportional to r⁻³, dead leaves have the edges, the power spectrum and the contrast statistics of natural images (Lee,
Mumford and Huang, 2001).
"""

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float32]
Size = float | Field

EXPONENT = 2.0  # the density of the radii is proportional to r^-(EXPONENT + 1)
UNCOVERED = 0.003  # fraction of the picture that may stay uncovered, because it takes too long to cover the last pixels
BATCH_AREA = 1.5  # total area of the bounding squares in a batch, relative to the area of the picture
BLOCK = 8  # side in pixels of the blocks that are tested for uncovered pixels; each row of a block is one 64-bit word
SMALL = 40.0  # leaves up to this radius, in pixels, are drawn in groups
WINDOW_RATIO = 1.15  # ratio of successive window sizes for small leaves
CHUNK = 1 << 16  # samples per batch; small enough that a batch fits in the processor cache
SPARSE_FRACTION = 0.2  # if less than this fraction of a leaf's window is uncovered, only the uncovered pixels are tested
FREE = np.iinfo(np.int32).max  # label of uncovered pixels, higher than that of any leaf
OUTSIDE_LABEL = -1  # label of pixels outside the picture, lower than that of any leaf


@dataclass(frozen=True)
class Leaves:
    """The visible leaves of a scene, and the leaf at each pixel. The background is the last leaf."""

    label: NDArray[np.int32]  # (row, col), index of the leaf
    row: Field  # (leaf,), row of the centre, in pixels
    col: Field  # (leaf,), column of the centre, in pixels
    radius: Field  # (leaf,), pixels


@dataclass(frozen=True)
class Drawn:
    """A batch of leaves, ordered from front to back. Each array has one value per leaf."""

    number: NDArray[np.int32]  # increases from front to back
    row: NDArray[np.float64]  # row of the centre, in pixels
    col: NDArray[np.float64]
    radius: NDArray[np.float64]  # pixels
    shape: NDArray[np.int64]  # 0…4, as in `inside`
    angle: NDArray[np.float64]  # radians
    slimness: NDArray[np.float64]  # ratio of width to length

    def of(self, which: NDArray[Any]) -> "Drawn":
        """Select leaves with an index array or a mask."""
        return Drawn(**{name: values[which] for name, values in vars(self).items()})


def dead_leaves(rng: np.random.Generator, shape: tuple[int, int], smallest: float, largest: float) -> Leaves:
    """Draw overlapping leaves of five shapes until they cover the picture.

    Parameters
    ----------
    rng : Generator
        Source of the random numbers.
    shape : tuple of int
        Rows and columns of the picture.
    smallest, largest : float
        Range of the radii, in pixels.

    Returns
    -------
    Leaves
        The leaves that are visible in at least one pixel.

    Notes
    -----
    A pixel shows the leaf with the lowest number of all leaves that cover it. The result therefore does not depend on the
    order in which leaves are drawn, and many leaves can be drawn together.
    """
    room = int(2 * min(SMALL, largest) * WINDOW_RATIO) + 3  # margin in pixels, for windows that extend beyond the picture
    canvas = np.full([-(-(length + 2 * room) // BLOCK) * BLOCK for length in shape], OUTSIDE_LABEL, np.int32)
    label = canvas[room : room + shape[0], room : room + shape[1]]
    label[:] = FREE
    count = max(1, int(BATCH_AREA * label.size / (4 * _mean_square(smallest, largest))))
    batches: list[Drawn] = []
    while np.count_nonzero(label == FREE) > UNCOVERED * label.size:
        drawn = _drawn(rng, count * len(batches), count, shape, smallest, largest)
        batches.append(drawn)
        visible = drawn.of(_may_show(canvas, room, drawn))
        for leaf in np.flatnonzero(visible.radius > SMALL).tolist():
            _lay(label, visible, leaf)
        _lay_small(canvas, room, visible.of(visible.radius <= SMALL))
    return _seen(label, batches)


def _mean_square(smallest: float, largest: float) -> float:
    """Return the mean of r², in pixels², if the density of the radii is proportional to r⁻³."""
    return float(2 * np.log(largest / smallest) / (smallest**-EXPONENT - largest**-EXPONENT)) or smallest**2


def _drawn(
    rng: np.random.Generator, first: int, count: int, shape: tuple[int, int], smallest: float, largest: float
) -> Drawn:
    """Draw `count` leaves at positions in or near a picture of `shape` (rows, cols), numbered from `first`."""
    radius = _radii(rng, count, smallest, largest)
    return Drawn(
        number=np.arange(first, first + count, dtype=np.int32),
        row=rng.uniform(-radius, shape[0] + radius),
        col=rng.uniform(-radius, shape[1] + radius),
        radius=radius,
        shape=rng.integers(5, size=count),
        angle=rng.uniform(0, np.pi, count),
        slimness=rng.uniform(0.2, 1.0, count),
    )


def _radii(rng: np.random.Generator, count: int, smallest: float, largest: float) -> NDArray[np.float64]:
    """Draw `count` radii between `smallest` and `largest`, with a density proportional to r⁻³."""
    share = rng.random(count)
    most, least = smallest**-EXPONENT, largest**-EXPONENT
    return (most + share * (least - most)) ** (-1.0 / EXPONENT)


def _may_show(canvas: NDArray[np.int32], room: int, drawn: Drawn) -> NDArray[np.bool_]:
    """Return whether each leaf's bounding square touches a block with an uncovered pixel.

    All other leaves are hidden and need not be drawn, which saves most of the work when the picture is nearly covered. The
    canvas has a margin of `room` pixels around the picture.
    """
    free = (canvas == FREE).view(np.uint64)  # each word contains BLOCK pixels of a row
    blocks = functools.reduce(np.bitwise_or, (free[row::BLOCK] for row in range(BLOCK))) != 0
    count = np.zeros((blocks.shape[0] + 1, blocks.shape[1] + 1), np.int32)
    count[1:, 1:] = blocks.cumsum(axis=0, dtype=np.int32).cumsum(axis=1)
    top, bottom = _span(drawn.row + room, drawn.radius, blocks.shape[0])
    left, right = _span(drawn.col + room, drawn.radius, blocks.shape[1])
    return count[bottom, right] - count[top, right] - count[bottom, left] + count[top, left] > 0


def _span(centre: NDArray, radius: NDArray, blocks: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the range of blocks that each leaf's bounding square touches along one axis.

    The arrays contain the index of the first block, and the index after the last block.
    """
    first = np.clip((centre - radius) // BLOCK, 0, blocks).astype(np.intp)
    last = np.clip((centre + radius) // BLOCK + 1, 0, blocks).astype(np.intp)
    return first, last


def _lay(label: NDArray[np.int32], drawn: Drawn, leaf: int) -> None:
    """Draw one leaf into the label image, behind the leaves with lower numbers."""
    row, col, radius = float(drawn.row[leaf]), float(drawn.col[leaf]), float(drawn.radius[leaf])
    top, left = max(0, int(row - radius)), max(0, int(col - radius))
    window = label[top : max(0, int(row + radius + 1)), left : max(0, int(col + radius + 1))]
    y = np.arange(top, top + window.shape[0], dtype=np.float32)[:, None] - np.float32(row)
    x = np.arange(left, left + window.shape[1], dtype=np.float32) - np.float32(col)
    look = radius, float(drawn.angle[leaf]), float(drawn.slimness[leaf])
    free = window > drawn.number[leaf]
    if np.count_nonzero(free) > SPARSE_FRACTION * free.size:
        window[free & inside(int(drawn.shape[leaf]), y, x, *look)] = drawn.number[leaf]
        return
    rows, cols = np.divmod(np.flatnonzero(free), free.shape[1])
    covered = inside(int(drawn.shape[leaf]), y[rows, 0], x[cols], *look)
    window[rows[covered], cols[covered]] = drawn.number[leaf]


def _lay_small(canvas: NDArray[np.int32], room: int, drawn: Drawn) -> None:
    """Draw many small leaves into the canvas, which has a margin of `room` pixels around the picture.

    Leaves with the same shape and similar sizes are drawn together, in windows of the same size.
    """
    if not drawn.number.size:
        return
    smallest = drawn.radius.min()
    step = np.ceil(np.log(drawn.radius / smallest) / np.log(WINDOW_RATIO))
    side = np.ceil(2 * smallest * WINDOW_RATIO**step).astype(int) + 1
    order = np.lexsort((side, drawn.shape))
    ends = np.flatnonzero(np.diff(side[order]) | np.diff(drawn.shape[order])) + 1
    for group in np.split(order, ends):
        most = max(1, CHUNK // int(side[group[0]]) ** 2)
        for first in range(0, len(group), most):
            _lay_alike(canvas, room, drawn.of(group[first : first + most]), int(side[group[0]]))


def _lay_alike(canvas: NDArray[np.int32], room: int, drawn: Drawn, side: int) -> None:
    """Draw leaves of the same shape in windows of `side` × `side` pixels."""

    def each(values: NDArray[Any]) -> Field:
        return values.astype(np.float32)[:, None, None]

    top, left = np.ceil(drawn.row - drawn.radius), np.ceil(drawn.col - drawn.radius)
    steps = np.arange(side, dtype=np.float32)
    y, x = each(top - drawn.row) + steps[:, None], each(left - drawn.col) + steps
    radius, angle, slimness = each(drawn.radius), each(drawn.angle), each(drawn.slimness)
    covered = np.flatnonzero(inside(int(drawn.shape[0]), y, x, radius, angle, slimness))
    first = np.arange(len(top) + 1) * side**2  # index of the first sample of each leaf's window
    samples = np.diff(np.searchsorted(covered, first))
    covered -= np.repeat(first[:-1], samples)
    window = np.arange(side)[:, None] * canvas.shape[1] + np.arange(side)
    corner = ((top + room) * canvas.shape[1] + left + room).astype(np.intp)
    places = window.reshape(-1)[covered] + np.repeat(corner, samples)
    np.minimum.at(canvas.reshape(-1), places, np.repeat(drawn.number, samples))


def _seen(label: NDArray[np.int32], batches: list[Drawn]) -> Leaves:
    """Renumber the visible leaves consecutively and add the background as the last leaf."""
    row, col, radius = (np.concatenate([getattr(one, name) for one in batches]) for name in ("row", "col", "radius"))
    ground = len(radius)
    label = np.where(label == FREE, np.int32(ground), label)
    shows = np.zeros(ground + 1, bool)
    shows[label] = True
    shows[ground] = True
    leaf = (np.cumsum(shows) - 1).astype(np.int32)
    rows, cols = label.shape
    places = np.array([row, col, radius])[:, shows[:-1]]
    whole = np.array([rows / 2, cols / 2, max(rows, cols) / 2])
    return Leaves(leaf[label], *np.column_stack([places, whole]).astype(np.float32))


def inside(shape: int, y: Field, x: Field, radius: Size, angle: Size, slimness: Size) -> NDArray[np.bool_]:
    """Return which points are inside a leaf that is centred at (0, 0).

    Parameters
    ----------
    shape : int
        0: disc; 1: ellipse; 2: rectangle; 3: triangle; 4: lobed leaf.
    y, x : ndarray
        Coordinates of the points, down and across, in pixels.
    radius : float or ndarray
        Radius of the circle that encloses the leaf, in pixels.
    angle : float or ndarray
        Orientation in radians.
    slimness : float or ndarray
        Ratio of width to length. It is ignored for discs and lobed leaves.
    """
    if shape == 0:
        return x**2 + y**2 < radius**2
    cosine, sine = np.cos(angle, dtype=np.float32), np.sin(angle, dtype=np.float32)
    along, across = x * cosine + y * sine, y * cosine - x * sine
    if shape == 1:
        across /= slimness
        return along**2 + across**2 < radius**2
    if shape == 2:
        return (abs(along) < 0.7 * radius) & (abs(across) < 0.7 * radius * slimness)
    if shape == 3:
        half = 0.5 * radius
        return (along > -half) & (abs(across) < half * slimness - 0.5 * along)
    return _lobed(along, across, radius, angle)


def _lobed(along: Field, across: Field, radius: Size, angle: Size) -> NDArray[np.bool_]:
    """Return the mask of a lobed leaf.

    In direction θ, the edge is at the distance radius · (0.7 + 0.15 sin(3θ + angle) + 0.12 sin(5θ + 9 · angle)) from the
    centre. The sines are computed from powers of along + i · across, to avoid an arctangent per pixel.
    """
    squared = along * along + across * across
    squared += np.float32(1e-12)  # avoids a division by zero at the centre
    re, im = along * along - across * across, np.float32(2) * along * across  # real and imaginary parts of the square
    third = re * along - im * across, re * across + im * along
    fifth = third[0] * re - third[1] * im, third[0] * im + third[1] * re
    distance = np.sqrt(squared)
    edge = third[1] * np.cos(angle, dtype=np.float32) + third[0] * np.sin(angle, dtype=np.float32)
    edge *= np.float32(0.15)
    more = fifth[1] * np.cos(9 * angle, dtype=np.float32) + fifth[0] * np.sin(9 * angle, dtype=np.float32)
    more *= np.float32(0.12)
    more /= squared
    edge += more
    edge /= squared * distance
    edge += np.float32(0.7)
    edge *= radius
    return distance < edge
