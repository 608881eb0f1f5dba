"""A chart's patches in mosaics: where they lie, their values, the sensor's noise (docs/method.md#charts-in-photographs)."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CORE = 0.25  # half the side of a patch's core, in cells: frames of patches, and blurred edges, stay out
FAR = 5.0  # robust standard deviations: dust, scratches, hot pixels
DUSTY = 0.2  # share of a patch's pixels that may be left out
CLIPPED = 1e-3  # share of saturated pixels from which a value is no mean of the light
LEAST_PIXELS = 12  # of a channel in a patch
PRECISION = 0.002  # of a value: what texture and gloss leave of it however many pixels there are
LEAST_POINTS = 6  # patches and channels for a line of variance over signal
MAD = 1.4826  # standard deviations of a Gaussian in its median absolute deviation
Array = NDArray[np.floating]


def homography(cells: Array, pixels: Array) -> Array:
    """(3, 3) from chart cells (point, 2) x, y to pixels (point, 2) col, row, four points or more, by least squares; applied
    to (x, y, 1) it gives col, row times a scale. LinAlgError if four points lie on a line."""
    scale, shift = float(np.ptp(pixels, axis=0).max()) or 1.0, pixels.mean(axis=0)
    equations, right_side = [], []
    for (x, y), (u, v) in zip(cells, (pixels - shift) / scale, strict=True):
        equations += [[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]
        right_side += [u, v]
    system, right = np.array(equations, dtype=np.float64), np.array(right_side)
    solved = np.linalg.solve(system, right) if len(cells) == 4 else np.linalg.lstsq(system, right, rcond=None)[0]
    normalised = np.append(solved, 1.0).reshape(3, 3)
    back = np.array([[scale, 0.0, shift[0]], [0.0, scale, shift[1]], [0.0, 0.0, 1.0]])
    return back @ normalised


def corner_cells(rows: int, cols: int) -> Array:
    """(4, 2) x, y of the outer corners of a grid of patches, clockwise from the first patch."""
    return np.array([[0, 0], [cols, 0], [cols, rows], [0, rows]], dtype=np.float64)


def through(matrix: Array, points: Array) -> Array:
    """Return the points (…, 2) through a homography; infinite where it has none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = points @ matrix[:, :2].T + matrix[:, 2]
        return np.asarray(moved[..., :2] / moved[..., 2:])


def patch_map(to_pixels: Array, grid: tuple[int, int], shape: tuple[int, int], core: float) -> NDArray[np.int64]:
    """Return the index (row, col) of the patch whose core a pixel lies in, rows · cols of the grid elsewhere.

    `to_pixels`: homography of a grid (rows, cols) of cells; `core`: half the side of a core in cells."""
    rows, cols = grid
    col, row = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    cells = through(np.linalg.inv(to_pixels), np.stack([col, row], axis=-1))
    x, y = cells[..., 0], cells[..., 1]
    with np.errstate(invalid="ignore"):
        inside = (x >= 0) & (x < cols) & (y >= 0) & (y < rows) & (np.abs(x % 1 - 0.5) < core) & (np.abs(y % 1 - 0.5) < core)
    index = np.full(shape, rows * cols)
    index[inside] = y[inside].astype(np.int64) * cols + x[inside].astype(np.int64)
    return index


@dataclass(frozen=True)
class PatchValues:
    """Values of each patch in a mosaic."""

    mean: Array  # (patch, channel) DN above black
    deviation: Array  # (patch, channel) DN, standard deviation of the mean
    variance: Array  # (patch, channel) DN² of a pixel, by its neighbours of the same site: no texture, no uneven light
    used: NDArray[np.bool_]  # (patch, channel)
    left_out: tuple[tuple[int, int, str], ...]  # patch, channel, why


def patch_values(
    frames: Sequence[Array], cfa: NDArray[np.uint8], to_pixels: Array, grid: tuple[int, int], saturation: float
) -> PatchValues:
    """Return the values of frames (row, col) of one scene, DN above black, whose first pixel is the CFA's.

    `to_pixels`: homography of the grid (rows, cols); `saturation`: DN above black from which a pixel is clipped.
    ValueError if a patch holds too few pixels of a channel.
    """
    mean_frame = np.mean(frames, axis=0, dtype=np.float64)
    shape, channels, patches = mean_frame.shape, int(cfa.max()) + 1, grid[0] * grid[1]
    patch = patch_map(to_pixels, grid, (shape[0], shape[1]), CORE)
    clipped = np.max(frames, axis=0) >= saturation
    differences = _differences(frames, cfa)
    mean, deviation, variance = (np.zeros((patches, channels)) for _ in range(3))
    used, left_out = np.ones((patches, channels), dtype=bool), []
    for (index, channel), part in _pixels(patch, patches, cfa):
        if part.size < LEAST_PIXELS:
            raise ValueError(f"patch {index + 1} holds {part.size} pixels of channel {channel}")
        values = mean_frame.ravel()[part]
        clean = _clean(values)
        mean[index, channel] = values[clean].mean()
        variance[index, channel] = _robust_variance(differences.ravel()[part])
        noise = np.sqrt(variance[index, channel] / len(frames) / clean.sum())
        deviation[index, channel] = np.hypot(noise, PRECISION * mean[index, channel])
        why = (
            "clipped"
            if clipped.ravel()[part].mean() > CLIPPED
            else "dusty or not plain"
            if clean.mean() < 1 - DUSTY
            else None
        )
        if why:
            used[index, channel] = False
            left_out.append((index, channel, why))
    return PatchValues(mean, deviation, variance, used, tuple(left_out))


def _pixels(patch: NDArray[np.int64], patches: int, cfa: NDArray[np.uint8]) -> Iterator[tuple[tuple[int, int], NDArray]]:
    """((patch, channel), flat indices of its pixels) of a map (row, col) of patches."""
    shape, channels = patch.shape, int(cfa.max()) + 1
    channel_of = np.tile(cfa, [-(-length // period) for length, period in zip(shape, cfa.shape, strict=True)])
    channel_of = channel_of[: shape[0], : shape[1]]
    label = np.where(patch < patches, patch * channels + channel_of, patches * channels).ravel()
    order = np.argsort(label, kind="stable")
    bounds = np.searchsorted(label[order], np.arange(patches * channels + 1))
    for index, channel in np.ndindex(patches, channels):
        at = index * channels + channel
        yield (index, channel), order[bounds[at] : bounds[at + 1]]


def _clean(values: Array) -> NDArray[np.bool_]:
    """Which values are no dust, scratch or hot pixel."""
    middle = np.median(values)
    spread = max(MAD * float(np.median(np.abs(values - middle))), 0.5)
    return np.asarray(np.abs(values - middle) <= FAR * spread)


def _differences(frames: Sequence[Array], cfa: NDArray[np.uint8]) -> Array:
    """(row, col) differences whose variance is a pixel's noise: of two frames or, in a single one, of neighbours of one site
    in a row and below, so that neither slopes nor patches that differ enter; NaN at the edge."""
    if len(frames) > 1:
        return np.asarray((frames[0].astype(np.float64) - frames[1]) / np.sqrt(2.0))
    rows, cols = cfa.shape
    frame = frames[0].astype(np.float64)
    result = np.full(frame.shape, np.nan)
    crossed = frame[:-rows, :-cols] - frame[rows:, :-cols] - frame[:-rows, cols:] + frame[rows:, cols:]
    result[:-rows, :-cols] = crossed / 2.0
    return result


def _robust_variance(values: Array) -> float:
    values = values[np.isfinite(values)]
    if values.size < LEAST_PIXELS:
        return 0.0
    spread = max(MAD * float(np.median(np.abs(values - np.median(values)))), 1e-3)
    typical = values[np.abs(values - np.median(values)) <= FAR * spread]
    return float(typical.var())


def photon_transfer(values: Sequence[PatchValues]) -> tuple[float, float] | None:
    """Conversion gain (DN/e-) and dark noise (DN) of the line of variance over signal, patches and channels of all shots;
    None if there is no such line: of processed files, or with next to no noise."""
    mean = np.concatenate([each.mean[each.used] for each in values])
    variance = np.concatenate([each.variance[each.used] for each in values])
    real = (variance > 0) & (mean > 0)
    if real.sum() < LEAST_POINTS:
        return None
    mean, variance = mean[real], variance[real]
    weight = 1.0 / variance
    for _ in range(3):  # a variance is known in proportion to itself
        slope, constant = np.polyfit(mean, variance, 1, w=weight)
        weight = 1.0 / np.maximum(slope * mean + constant, 0.1 * np.median(variance))
    if slope <= 0:
        return None
    return float(slope), float(np.sqrt(max(constant - 1.0 / 12.0, 0.0)))
