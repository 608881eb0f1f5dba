"""Compute statistics of frames, and find defective pixels.

Histograms, means and temporal variances are computed per channel, without defective pixels. The parameter `each` is the
built-in `map`, or a parallel replacement for it.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import DefectMap
from l3cli.errors import InputFileError
from l3cli.frames.measurement import Body, Capture

# Limit in robust standard deviations. Normally distributed pixels exceed it with a probability below 10⁻⁸.
OUTLIER = 6.0
LEAST_LOSS = 0.1  # pixels with a smaller relative deviation from their neighbours are not defective
WHOLE_LINE = 0.9  # if at least this fraction of a row or column is defective, the whole line is marked as defective
Defects = NDArray[np.int64]  # (defect, 2): row and column of each defective pixel
Array = NDArray[np.float64]
Counts = NDArray[np.int64]  # (channel, value): number of pixels with each raw value
Each = Callable[[Callable, Iterable], Iterator]  # the built-in `map`, or a replacement that uses several processes


def no_defects() -> Defects:
    return np.zeros((0, 2), dtype=np.int64)


def outliers(picture: Array, cfa: NDArray[np.uint8], least: float = 0.0) -> Defects:
    """Find defective pixels, rows and columns by their deviation from other pixels at the same CFA site.

    A pixel is an outlier if its deviation from the site's median exceeds both OUTLIER standard deviations and `least`. A row
    is an outlier if its median deviates from the typical row median by more than three limits: OUTLIER standard deviations
    of the row medians, one standard deviation of the pixels, and `least`. Columns are tested in the same way.
    """
    rows, cols = cfa.shape
    defects = []
    for row, col in np.ndindex(rows, cols):
        site = picture[row::rows, col::cols]
        middle, spread = _middle_and_spread(site)
        far = np.abs(site - middle) > max(OUTLIER * spread, least)
        for axis in (0, 1):
            lines = np.median(site, axis=axis)
            centre, between = _middle_and_spread(lines)
            odd = np.abs(lines - centre) > max(OUTLIER * between, spread, least)
            far |= odd if axis == 0 else odd[:, None]
        defects.append(np.argwhere(far) * (rows, cols) + (row, col))
    return joined_defects(*defects)


def _middle_and_spread(values: Array) -> tuple[float, float]:
    """Return the median and a robust standard deviation, which is half the distance between the 16 % and 84 % quantiles."""
    low, middle, high = np.percentile(values, (15.87, 50.0, 84.13))
    return float(middle), float((high - low) / 2 or values.std())


def joined_defects(*parts: Defects) -> Defects:
    """Merge lists of defective pixels, without duplicates and sorted by row and column."""
    return np.unique(np.concatenate(parts), axis=0).astype(np.int64)


def patched(picture: Array, cfa: NDArray[np.uint8], defects: Defects) -> Array:
    """Replace each defective pixel with the median of neighbouring pixels at the same CFA site."""
    rows, cols = cfa.shape
    result = picture.copy()
    for row, col in defects:
        first_row = row - 2 * rows if row >= 2 * rows else row % rows
        first_col = col - 2 * cols if col >= 2 * cols else col % cols
        result[row, col] = np.median(picture[first_row : row + 2 * rows + 1 : rows, first_col : col + 2 * cols + 1 : cols])
    return result


def defect_map(defects: Defects, hot: Defects, shape: tuple[int, int], blinking: Defects | None = None) -> DefectMap:
    """Build the defect map of a sensor.

    If nearly all pixels of a row or column are defective (WHOLE_LINE), the whole line is marked.

    Parameters
    ----------
    defects : ndarray, (defect, 2)
        Row and column of every defective pixel.
    hot : ndarray, (defect, 2)
        Row and column of the defective pixels that were found in dark frames.
    shape : tuple of int
        Rows and columns of the sensor.
    blinking : ndarray, (defect, 2), optional
        Row and column of the blinking pixels. They get the type "blinking" even if they are also hot.
    """
    bad, named = np.zeros(shape, bool), np.full(shape, "dead", dtype="<U8")
    bad[tuple(defects.T)] = True
    named[tuple(hot.T)] = "hot"
    if blinking is not None:
        named[tuple(blinking.T)] = "blinking"
    whole_cols, whole_rows = bad.mean(axis=0) >= WHOLE_LINE, bad.mean(axis=1) >= WHOLE_LINE
    lined = whole_cols | whole_rows[:, None]
    position = np.argwhere(bad | lined)
    row, col = position.T
    kinds = np.where(whole_cols[col], "column", np.where(whole_rows[row], "row", named[row, col]))
    return DefectMap(position.astype(np.int64), tuple(map(str, kinds)))


def defect_counts(defects: DefectMap, shape: tuple[int, int]) -> dict[str, int]:
    """Count the defects of each type in a defect map, and the clusters of adjacent single-pixel defects."""
    from scipy.ndimage import label

    kind, (row, col) = np.array(defects.pixel_kind, dtype=str), defects.position.T
    single = np.isin(kind, ("hot", "dead", "blinking"))
    alone = np.zeros(shape, bool)
    alone[row[single], col[single]] = True
    groups, _ = label(alone, np.ones((3, 3)))
    sizes = np.bincount(groups.ravel())[1:]
    return {
        "hot": int((kind == "hot").sum()),
        "dead": int((kind == "dead").sum()),
        **({"blinking": int((kind == "blinking").sum())} if "blinking" in kind else {}),
        "rows": len(np.unique(row[kind == "row"])),
        "columns": len(np.unique(col[kind == "column"])),
        "clusters": int((sizes > 1).sum()),
    }


@dataclass(frozen=True)
class Level:
    """Statistics of a capture, which is a set of frames with the same exposure time."""

    exposure: float  # s
    lit: float  # s; exposure time, corrected for the brightness of the lamp
    trials: int  # number of frames
    counts: Counts  # sum of the histograms of all frames
    variance: Array  # (channel,): temporal variance in DN², including row and column noise
    pixel_variance: Array  # (channel,): temporal variance in DN², without row and column noise
    lines: "LineSquares"  # temporal variance, split into rows, columns and pixels


@dataclass(frozen=True)
class LineSquares:
    """Mean squares from a picture's two-way analysis of variance, into rows, columns and pixels.

    Without row noise, `rows` and `pixels` have the same expected value. Row noise increases the expected value of `rows` by
    its variance times the number of pixels in a row. The same applies to columns. For temporal noise, the picture is the
    difference between two frames, and the mean squares are halved.
    """

    rows: float  # DN²
    columns: float  # DN²
    pixels: float  # DN²
    row_freedom: int  # degrees of freedom of `rows`
    column_freedom: int  # degrees of freedom of `columns`


def line_squares(picture: NDArray[Any], body: Body) -> Array:
    """Return a picture's sums of squares for rows, columns and pixels, the input of `mean_squares`.

    First, each CFA site's mean is subtracted, and the pixels are divided by their channel's relative gain.
    """
    scaled = np.empty(picture.shape)
    for (channel, site), (_, target) in zip(by_site(picture, body.cfa), by_site(scaled, body.cfa), strict=True):
        target[...] = (site - site.mean()) / body.channel_gains[channel]
    rows, columns = (scaled.shape[1 - axis] * (scaled.mean(axis=1 - axis) ** 2).sum() for axis in (0, 1))
    return np.array([rows, columns, (scaled**2).sum() - rows - columns])


def mean_squares(sums: Sequence[Array], body: Body) -> LineSquares:
    """Convert the sums of squares from `line_squares` to mean squares, averaged over several pictures.

    The pictures must have the same noise. For temporal noise, each picture is the difference between two frames.
    """
    (down, across), pairs = body.cfa.shape, len(sums)
    rows, columns = body.rows - down, body.cols - across
    means = np.mean(sums, axis=0) / np.maximum([rows, columns, rows * columns], 1)
    of_rows, of_columns, of_pixels = means.tolist()
    return LineSquares(of_rows, of_columns, of_pixels, rows * pairs, columns * pairs)


def by_site(values: NDArray, cfa: NDArray[np.uint8]) -> Iterator[tuple[int, NDArray]]:
    """Yield the channel of each CFA site, row by row, and a view of the site's pixels (row, col)."""
    rows, cols = cfa.shape
    for row, col in np.ndindex(rows, cols):
        yield int(cfa[row, col]), values[row::rows, col::cols]


def pooled(per_site: Sequence[float], cfa: NDArray[np.uint8]) -> Array:
    """Average one number per CFA site, in the order of `by_site`, over the sites of each channel."""
    count = np.bincount(cfa.ravel())
    return np.bincount(cfa.ravel(), weights=np.asarray(per_site, dtype=np.float64)) / count


def histogram(values: NDArray[np.uint16], body: Body, defects: Defects) -> Counts:
    """Return the histogram of each channel in a frame, without defective pixels: (channel, value)."""
    counts = np.zeros((len(body.channels), 2**body.bits), dtype=np.int64)
    for channel, site in by_site(values, body.cfa):
        counts[channel] += np.bincount(site.ravel(), minlength=2**body.bits)
    row, col = defects.T
    channels = body.cfa[row % body.cfa.shape[0], col % body.cfa.shape[1]]
    np.subtract.at(counts, (channels, values[row, col]), 1)
    return counts


def count_values(capture: Capture, body: Body, defects: Defects) -> Counts:
    """Sum the histograms of all frames of a capture, without defective pixels: (channel, value)."""
    counts = np.zeros((len(body.channels), 2**body.bits), dtype=np.int64)
    for frame in capture.frames:
        counts += histogram(frame, body, defects)
    return counts


def mean_value(counts: Counts) -> Array:
    """Compute each channel's mean value in DN from its histogram."""
    return counts @ np.arange(counts.shape[1]) / counts.sum(axis=1)


def share_from(counts: Counts, value: float) -> Array:
    """Compute, from each channel's histogram, the fraction of pixels with at least `value` DN."""
    return counts[:, int(np.ceil(value)) :].sum(axis=1) / counts.sum(axis=1)


def measure_level(capture: Capture, body: Body, defects: Defects) -> Level:
    """Measure the histogram and the temporal variance of a capture in uniform light or in the dark.

    The temporal variance is half the variance of the difference between two consecutive frames, averaged over pairs (frames
    1 and 2, frames 3 and 4…). Fixed-pattern noise cancels in the difference. Lamp and black level hardly drift between
    consecutive frames. Raises InputFileError if the capture contains only one frame.
    """
    counts = np.zeros((len(body.channels), 2**body.bits), dtype=np.int64)
    variances, pixel_variances, squares, trials = [], [], [], 0
    previous = None
    for frame in capture.frames:
        counts += histogram(frame, body, defects)
        trials += 1
        if previous is None:
            previous = frame.astype(np.int32)
            continue
        difference = previous - frame
        difference[defects[:, 0], defects[:, 1]] = 0
        sites = [site for _, site in by_site(difference, body.cfa)]
        variances.append(pooled([site.var(dtype=np.float64) / 2 for site in sites], body.cfa))
        pixel_variances.append(pooled([pixel_variance(site) / 2 for site in sites], body.cfa))
        squares.append(line_squares(difference, body) / 2)
        previous = None
    if not variances:
        raise InputFileError(
            f"{capture.name} is a single frame, from which noise cannot be measured; capture two or more frames with each "
            "exposure time"
        )
    variance, of_pixels = np.mean(variances, axis=0), np.mean(pixel_variances, axis=0)
    lines = mean_squares(squares, body)
    return Level(capture.exposure, capture.lit, trials, counts, variance, of_pixels, lines)


def pixel_variance(picture: NDArray[Any]) -> float:
    """Return a picture's variance without the part that rows and columns share.

    The estimate is unbiased: without row and column noise, its expected value is the variance of the pixels.
    """
    rows, cols = picture.shape
    lines = [picture.mean(axis=axis, dtype=np.float64).var() for axis in (0, 1)]
    left = picture.var(dtype=np.float64) - sum(lines)
    return float(left * rows * cols / max((rows - 1) * (cols - 1), 1))


def weighted_sums(captures: Sequence[Capture], weights: Array, body: Body, each: Each = map) -> Array:
    """Return weighted sums of the captures' mean frames.

    Captures with a weight of 0 in all sums are not read.

    Parameters
    ----------
    captures : sequence of Capture
        The captures.
    weights : ndarray, (sum, capture, channel)
        Weight of each capture in each sum, for each channel.
    body : Body
        Size, CFA and channels of the camera.
    each : callable
        The built-in `map`, or a parallel replacement for it.

    Returns
    -------
    ndarray, (sum, row, col)
    """
    total = np.zeros((len(weights), body.rows, body.cols))
    used = [index for index in range(len(captures)) if weights[:, index].any()]
    means = each(mean_frame, [captures[index] for index in used])
    rows, cols = body.cfa.shape
    for index, mean in zip(used, means, strict=True):
        for (row, col), (channel, site) in zip(np.ndindex(rows, cols), by_site(mean, body.cfa), strict=True):
            total[:, row::rows, col::cols] += weights[:, index, channel, None, None] * site
    return total


def mean_frame(capture: Capture) -> NDArray[np.float32]:
    """Average all frames of a capture: (row, col), in DN."""
    total: NDArray | None = None
    trials = 0
    for frame in capture.frames:
        total = frame.astype(np.uint32) if total is None else total + frame
        trials += 1
    assert total is not None
    return (total / trials).astype(np.float32)


def channel_shares(body: Body) -> Array:
    """Return each channel's fraction of the pixels: (channel,)."""
    return np.bincount(body.cfa.ravel(), minlength=len(body.channels)) / body.cfa.size
