"""Geometry of dead-leaves scenes: shapes of many sizes that occlude each other (docs/method.md#procedural-scenes).

Natural pictures are scale invariant because objects of every size occlude each other. Dead leaves whose radii have the
density r⁻³ share the edges, the power spectrum and the contrast statistics of natural pictures (Lee, Mumford and Huang,
2001).
"""

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float32]
Size = float | Field

EXPONENT = 2.0  # of the cumulative distribution of the radii; their density is then r^-3
UNCOVERED = 0.003  # fraction of the picture that the background fills, because covering the rest would take long
BATCH = 1.5  # total area of the bounding squares of a batch of leaves, in areas of the picture
BLOCK = 8  # pixels; side of the blocks tested for uncovered pixels, so that a row of a block is one 64-bit word
SMALL = 40.0  # pixels; leaves up to this radius are drawn many at once
WIDER = 1.15  # ratio of successive window sizes for small leaves
CHUNK = 1 << 16  # samples drawn at once, few enough to stay in the processor cache
FEW = 0.2  # if a smaller fraction of the window of a leaf is uncovered, only the uncovered pixels are tested
FREE = np.iinfo(np.int32).max  # label of uncovered pixels, higher than every leaf
BEYOND = -1  # label of pixels outside the picture, lower than every leaf


@dataclass(frozen=True)
class Leaves:
    """The visible leaves of a scene, and which of them each pixel shows. The last leaf is the background."""

    label: NDArray[np.int32]  # (row, col) index of the leaf
    row: Field  # (leaf) centre, pixels
    col: Field  # (leaf)
    radius: Field  # (leaf) pixels


@dataclass(frozen=True)
class Drawn:
    """A batch of leaves from front to back, with one value per leaf in each array."""

    number: NDArray[np.int32]  # rising from front to back
    row: NDArray[np.float64]  # centre, pixels
    col: NDArray[np.float64]
    radius: NDArray[np.float64]  # pixels
    shape: NDArray[np.int64]  # 0…4, as in `inside`
    angle: NDArray[np.float64]  # radians
    slimness: NDArray[np.float64]  # ratio of width to length

    def of(self, which: NDArray[Any]) -> "Drawn":
        """Return the leaves that an index array or a mask selects."""
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
        The leaves that show in at least one pixel.

    Notes
    -----
    Each pixel shows the leaf with the lowest number among the leaves that cover it. The order in which leaves are laid
    therefore does not matter, and many can be laid at once.
    """
    room = int(2 * min(SMALL, largest) * WIDER) + 3  # margin around the picture, for windows that extend beyond it
    canvas = np.full([-(-(length + 2 * room) // BLOCK) * BLOCK for length in shape], BEYOND, np.int32)
    label = canvas[room : room + shape[0], room : room + shape[1]]
    label[:] = FREE
    count = max(1, int(BATCH * label.size / (4 * _mean_square(smallest, largest))))
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
    """Return the mean of r², in pixels², for radii of density r⁻³."""
    return float(2 * np.log(largest / smallest) / (smallest**-EXPONENT - largest**-EXPONENT)) or smallest**2


def _drawn(
    rng: np.random.Generator, first: int, count: int, shape: tuple[int, int], smallest: float, largest: float
) -> Drawn:
    """Draw `count` leaves that touch a picture of `shape` (rows, cols), numbered from `first` on."""
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
    """Draw `count` radii of density r⁻³ between `smallest` and `largest`."""
    share = rng.random(count)
    most, least = smallest**-EXPONENT, largest**-EXPONENT
    return (most + share * (least - most)) ** (-1.0 / EXPONENT)


def _may_show(canvas: NDArray[np.int32], room: int, drawn: Drawn) -> NDArray[np.bool_]:
    """Return, per leaf, whether the bounding square of the leaf touches a block with an uncovered pixel.

    Leaves that fail this test are hidden and need no drawing, as most of the last ones do. The canvas extends `room` pixels
    beyond the picture on each side.
    """
    free = (canvas == FREE).view(np.uint64)  # each word holds BLOCK pixels of a row
    blocks = functools.reduce(np.bitwise_or, (free[row::BLOCK] for row in range(BLOCK))) != 0
    count = np.zeros((blocks.shape[0] + 1, blocks.shape[1] + 1), np.int32)
    count[1:, 1:] = blocks.cumsum(axis=0, dtype=np.int32).cumsum(axis=1)
    top, bottom = _span(drawn.row + room, drawn.radius, blocks.shape[0])
    left, right = _span(drawn.col + room, drawn.radius, blocks.shape[1])
    return count[bottom, right] - count[top, right] - count[bottom, left] + count[top, left] > 0


def _span(centre: NDArray, radius: NDArray, blocks: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the first block that the bounding square of each leaf touches, and the one after the last."""
    first = np.clip((centre - radius) // BLOCK, 0, blocks).astype(np.intp)
    last = np.clip((centre + radius) // BLOCK + 1, 0, blocks).astype(np.intp)
    return first, last


def _lay(label: NDArray[np.int32], drawn: Drawn, leaf: int) -> None:
    """Draw one leaf into the picture of labels, behind the leaves of lower numbers."""
    row, col, radius = float(drawn.row[leaf]), float(drawn.col[leaf]), float(drawn.radius[leaf])
    top, left = max(0, int(row - radius)), max(0, int(col - radius))
    window = label[top : max(0, int(row + radius + 1)), left : max(0, int(col + radius + 1))]
    y = np.arange(top, top + window.shape[0], dtype=np.float32)[:, None] - np.float32(row)
    x = np.arange(left, left + window.shape[1], dtype=np.float32) - np.float32(col)
    look = radius, float(drawn.angle[leaf]), float(drawn.slimness[leaf])
    free = window > drawn.number[leaf]
    if np.count_nonzero(free) > FEW * free.size:
        window[free & inside(int(drawn.shape[leaf]), y, x, *look)] = drawn.number[leaf]
        return
    rows, cols = np.divmod(np.flatnonzero(free), free.shape[1])
    covered = inside(int(drawn.shape[leaf]), y[rows, 0], x[cols], *look)
    window[rows[covered], cols[covered]] = drawn.number[leaf]


def _lay_small(canvas: NDArray[np.int32], room: int, drawn: Drawn) -> None:
    """Draw many small leaves.

    Leaves of one shape and of similar size have windows of one size and are drawn together. The canvas extends `room` pixels
    beyond the picture on each side.
    """
    if not drawn.number.size:
        return
    smallest = drawn.radius.min()
    step = np.ceil(np.log(drawn.radius / smallest) / np.log(WIDER))
    side = np.ceil(2 * smallest * WIDER**step).astype(int) + 1
    order = np.lexsort((side, drawn.shape))
    ends = np.flatnonzero(np.diff(side[order]) | np.diff(drawn.shape[order])) + 1
    for group in np.split(order, ends):
        most = max(1, CHUNK // int(side[group[0]]) ** 2)
        for first in range(0, len(group), most):
            _lay_alike(canvas, room, drawn.of(group[first : first + most]), int(side[group[0]]))


def _lay_alike(canvas: NDArray[np.int32], room: int, drawn: Drawn, side: int) -> None:
    """Draw leaves of one shape that fit into windows of `side` × `side` pixels."""

    def each(values: NDArray[Any]) -> Field:
        return values.astype(np.float32)[:, None, None]

    top, left = np.ceil(drawn.row - drawn.radius), np.ceil(drawn.col - drawn.radius)
    steps = np.arange(side, dtype=np.float32)
    y, x = each(top - drawn.row) + steps[:, None], each(left - drawn.col) + steps
    radius, angle, slimness = each(drawn.radius), each(drawn.angle), each(drawn.slimness)
    covered = np.flatnonzero(inside(int(drawn.shape[0]), y, x, radius, angle, slimness))
    first = np.arange(len(top) + 1) * side**2  # index of each leaf's window among the samples
    samples = np.diff(np.searchsorted(covered, first))
    covered -= np.repeat(first[:-1], samples)
    window = np.arange(side)[:, None] * canvas.shape[1] + np.arange(side)
    corner = ((top + room) * canvas.shape[1] + left + room).astype(np.intp)
    places = window.reshape(-1)[covered] + np.repeat(corner, samples)
    np.minimum.at(canvas.reshape(-1), places, np.repeat(drawn.number, samples))


def _seen(label: NDArray[np.int32], batches: list[Drawn]) -> Leaves:
    """Number the visible leaves anew and add the background after them."""
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
    """Return the mask of the points inside a leaf that is centred at (0, 0).

    Parameters
    ----------
    shape : int
        0 disc, 1 ellipse, 2 rectangle, 3 triangle, 4 lobed leaf.
    y, x : ndarray
        Coordinates of the points, down and across, in pixels.
    radius : float or ndarray
        Radius within which the leaf lies, in pixels.
    angle : float or ndarray
        Orientation in radians.
    slimness : float or ndarray
        Ratio of width to length. Discs and lobed leaves ignore it.
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
    """Return the mask of a lobed leaf, whose edge in direction θ has the distance
    radius · (0.7 + 0.15 sin(3θ + angle) + 0.12 sin(5θ + 9 angle)) from the centre.

    The sines are computed from powers of along + i · across, which saves an arc tangent per pixel.
    """
    squared = along * along + across * across
    squared += np.float32(1e-12)  # avoids a division by zero at the centre
    re, im = along * along - across * across, np.float32(2) * along * across  # real and imaginary part of the square
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
