"""Motion between two clean frames, where it is not known: matching of windows from coarse to fine
(docs/method.md#quality-of-sequences)."""

import itertools

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
LEVELS = 3  # the coarsest at a quarter of the size
REACH = 5  # pixels, of the search at the coarsest level
WINDOW = 15  # pixels, side of what is matched
BLOCK = 4  # pixels, between medians of the motion
PENALTY = 0.1  # L*², of a pixel of displacement, so that plain areas move with what is about them
MISMATCH = 3.0  # L*, mean over a few pixels, from which on another thing is seen
MISMATCH_WINDOW = 5  # pixels, side of the square that this is a mean of
STEPS = 4  # towards parts of a pixel
TINY = 1e-6  # pixels
FLAT = 0.1  # L*² a pixel², mean square slope below which a window tells little of parts of a pixel


def estimated_motion(light: Array, last: Array) -> NDArray[np.float32]:
    """Return the motion of a frame of L* (row, col) since the last one (3, row, col): pixels down and right, to fractions
    of a pixel, and 1 where the same is seen; as far as REACH · 2^(LEVELS − 1) pixels."""
    pairs: list[tuple[Array, Array]] = [(np.asarray(light, np.float64), np.asarray(last, np.float64))]
    while len(pairs) < LEVELS and min(pairs[-1][0].shape) >= 2 * WINDOW:
        pairs.append((_halved(pairs[-1][0]), _halved(pairs[-1][1])))
    vector = np.zeros((2, *pairs[-1][0].shape), int)
    for level, (frame, before) in enumerate(reversed(pairs)):
        if level:
            vector = _doubled(vector, frame.shape)
        vector = _refined(frame, before, vector, REACH if level == 0 else 1)
    fine = _exact(*pairs[0], vector)
    return np.concatenate([fine, _seen(light, last, fine)[None]]).astype(np.float32)


def _refined(frame: Array, before: Array, vector: NDArray[np.intp], reach: int) -> NDArray[np.intp]:
    """Return the best of the displacements within `reach` of a field of them (2, row, col)."""
    from scipy.ndimage import median_filter

    offsets = np.array(list(itertools.product(range(-reach, reach + 1), repeat=2)))
    best, least = vector, np.full(frame.shape, np.inf)
    for offset in offsets[np.argsort(np.hypot(*offsets.T), kind="stable")]:
        tried = vector + offset[:, None, None]
        cost = _mismatch(frame, before, tried) + PENALTY * float(np.hypot(*offset))
        better = cost < least
        least = np.where(better, cost, least)
        best = np.where(better, tried, best)
    return np.stack([median_filter(each, WINDOW, mode="nearest") for each in best])


def _mismatch(frame: Array, before: Array, vector: NDArray[np.intp]) -> Array:
    """Return the mean square difference (row, col) of windows from those that lie a displacement (2, row, col) back."""
    from scipy.ndimage import uniform_filter

    place = [
        np.clip(at - by, 0, length - 1) for at, by, length in zip(np.indices(frame.shape), vector, frame.shape, strict=True)
    ]
    return np.asarray(uniform_filter(np.square(frame - before[place[0], place[1]]), WINDOW))


def _exact(frame: Array, before: Array, motion: Array) -> Array:
    """Return the displacements (2, row, col) to parts of a pixel: least squares over windows of what slopes of the frame,
    brought along, say of the difference (Lucas and Kanade, "An iterative image registration technique", 1981)."""
    from scipy.ndimage import map_coordinates, spline_filter, uniform_filter

    place, spline = np.indices(frame.shape), spline_filter(before)
    for _ in range(STEPS):
        warped = map_coordinates(spline, place - motion, order=3, mode="mirror", prefilter=False)
        down, right = np.gradient(warped)
        rest = frame - warped
        dd, rr, dr, d, r = (
            uniform_filter(each, WINDOW) for each in (down * down, right * right, down * right, down * rest, right * rest)
        )
        dd, rr = dd + FLAT, rr + FLAT
        change = np.stack([dr * r - rr * d, dr * d - dd * r]) / (dd * rr - dr * dr)
        motion = np.stack([_without_outliers(each) for each in motion + np.clip(change, -1.0, 1.0)])
    return motion


def _without_outliers(plane: Array) -> Array:
    """Return medians (row, col) of every BLOCK-th value over a window, smoothed between blocks."""
    from scipy.ndimage import median_filter, uniform_filter

    side = -(-WINDOW // BLOCK) | 1
    whole = median_filter(plane[::BLOCK, ::BLOCK], side, mode="nearest").repeat(BLOCK, axis=0).repeat(BLOCK, axis=1)
    return np.asarray(uniform_filter(whole[: plane.shape[0], : plane.shape[1]], BLOCK, mode="nearest"))


def _seen(light: Array, last: Array, motion: Array) -> NDArray[np.bool_]:
    """Return the mask (row, col) of pixels where the last frame, moved along, looks the same."""
    from scipy.ndimage import map_coordinates, uniform_filter

    source = np.indices(light.shape) - motion
    inside = np.logical_and.reduce(
        [(at > -TINY) & (at < length - 1 + TINY) for at, length in zip(source, light.shape, strict=True)]
    )
    wrong = uniform_filter(abs(light - map_coordinates(last, source, order=3, mode="mirror")), MISMATCH_WINDOW)
    return np.asarray(inside & (wrong < MISMATCH))


def _halved(plane: Array) -> Array:
    rows, cols = (length // 2 * 2 for length in plane.shape)
    return plane[:rows, :cols].reshape(rows // 2, 2, cols // 2, 2).mean(axis=(1, 3))


def _doubled(vector: NDArray[np.intp], shape: tuple[int, ...]) -> NDArray[np.intp]:
    """Return a field of displacements (2, row, col) at twice the size, its last row and column once more where that is
    odd."""
    whole = 2 * vector.repeat(2, axis=1).repeat(2, axis=2)
    return np.pad(
        whole, [(0, 0), *((0, length - have) for length, have in zip(shape, whole.shape[1:], strict=True))], mode="edge"
    )
