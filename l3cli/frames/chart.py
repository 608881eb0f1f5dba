"""Find a colour chart in a mosaic, and measure its patches (docs/method.md#charts-in-photographs).

A chart is recognised as a grid of uniform regions with values that are consistent with the patch reflectances. The camera's
responsivities are unknown. l3 therefore tests whether the values of each channel are a linear combination of a constant and
the principal components of the reflectances. This test also determines the orientation of the chart.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from l3cli.physics.mosaic import tiled

# A cell is a square of the grid that contains one patch. x and y are measured in cells from the corner of the first patch.
CORE = 0.25  # half the side of a patch's measured area, in cells; the area excludes borders and blurred edges
# A pixel is an outlier, such as dust, if it differs from the median by more than this number of robust standard deviations.
OUTLIER = 5.0
DUSTY = 0.2  # maximum fraction of outliers in a usable patch
CLIPPED = 1e-3  # maximum fraction of saturated pixels in a usable patch
MIN_PIXELS = 12  # minimum number of pixels per channel in a patch
PRECISION = 0.002  # relative error of patch means due to texture and gloss, which does not decrease with more pixels
MIN_POINTS = 6  # minimum number of points, one per patch and channel, for fitting a photon transfer line
MAD = 1.4826  # standard deviation of a normal distribution, divided by its median absolute deviation
Array = NDArray[np.floating]
SEARCHED = 480  # maximum side, in pixels, of the reduced picture in which l3 searches for a chart
SLOPES = (0.02, 0.04, 0.08, 0.15)  # maximum relative gradients, per pixel, of uniform regions; all of them are tried
# Relative gradients are divided by the signal plus this fraction of its 99th percentile, to suppress noise in dark areas.
DARK_FRACTION = 0.02
MIN_AREA, MAX_SHARE = 9, 0.03  # minimum area of a patch in pixels, and maximum area as a fraction of the picture
# Maximum aspect ratio of a patch, and range of its area relative to a parallelogram with the same moments.
LONG, FILLED = 2.2, (0.75, 1.25)
# Number of nearest regions that may define the basis vectors of a grid, and number of regions from which grids are built.
NEIGHBOURS, SEEDS = 8, 160
PAIRS = np.array(list(itertools.permutations(range(NEIGHBOURS), 2)))
# Basis vectors of a grid: maximum cosine of the angle between them, and maximum ratio of their lengths.
ASKEW, UNEQUAL = 0.5, 1.8
OFF = 0.22  # maximum distance between a region and a grid point, in units of the grid spacing
REFINED = (0.25, 0.15, 0.1, 0.1)  # maximum distance, in cells, between a region and a patch centre in each refinement
MIN_SHARE, MIN_REGIONS = 0.4, 5  # minimum fraction and minimum number of patches that must be found as uniform regions
GROWN, TRIED = 200, 20  # number of grids that are extended, and number of these that are compared with the reflectances
COMPONENTS = 6  # number of principal components of the reflectances, which describe any channel to within a few percent
MIN_FIT = 0.9  # minimum R² when the principal components are fitted to a chart's values


def homography(cells: Array, pixels: Array) -> Array:
    """Fit the homography from chart cells to pixels by least squares.

    Parameters
    ----------
    cells : ndarray, (point, 2)
        x and y of at least four points, in cells.
    pixels : ndarray, (point, 2)
        Column and row of each point, in pixels.

    Returns
    -------
    ndarray, (3, 3)
        Homography. Its product with (x, y, 1) is proportional to (column, row, 1).

    Raises
    ------
    LinAlgError
        If there are exactly four points and three of them are collinear, so that the homography is not unique.
    """
    scale, shift = float(np.ptp(pixels, axis=0).max()) or 1.0, pixels.mean(axis=0)
    right = (pixels - shift) / scale
    system, right = _equations(cells, right), right.ravel()
    solved = np.linalg.solve(system, right) if len(cells) == 4 else np.linalg.lstsq(system, right, rcond=None)[0]
    normalised = np.append(solved, 1.0).reshape(3, 3)
    back = np.array([[scale, 0.0, shift[0]], [0.0, scale, shift[1]], [0.0, 0.0, 1.0]])
    return back @ normalised


def _equations(cells: Array, pixels: Array) -> Array:
    """Return the matrix, (…, 2 · point, 8), of the linear equations for the first eight elements of a homography.

    The ninth element is 1. The right-hand side consists of each point's column and row.
    """
    place = np.concatenate([cells, np.ones_like(cells[..., :1])], axis=-1)
    along = [np.concatenate(parts, axis=-1) for parts in ((place, 0 * place), (0 * place, place))]
    system = np.concatenate([np.stack(along, axis=-2), -pixels[..., None] * cells[..., None, :]], axis=-1)
    return system.reshape(*cells.shape[:-2], -1, 8)


def corner_cells(rows: int, cols: int) -> Array:
    """Return x and y, (4, 2), of a grid's outer corners in cells, clockwise from the corner of the first patch."""
    return np.array([[0, 0], [cols, 0], [cols, rows], [0, rows]], dtype=np.float64)


def through(matrix: Array, points: Array) -> Array:
    """Transform points by one or several homographies.

    Parameters
    ----------
    matrix : ndarray, (3, 3) or (grid, 3, 3)
        One homography, or several. Each of several homographies transforms all points.
    points : ndarray, (…, 2) or (point, 2)
        x and y of the points. For several homographies, the shape must be (point, 2).

    Returns
    -------
    ndarray, (…, 2) or (grid, point, 2)
        Transformed points. Points at infinity have infinite coordinates or NaN.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = points @ matrix[..., :2].swapaxes(-1, -2) + matrix[..., None, :, 2]
        return np.asarray(moved[..., :2] / moved[..., 2:])


def patch_map(to_pixels: Array, grid: tuple[int, int], shape: tuple[int, int], core: float) -> NDArray[np.int64]:
    """Return the index of the patch at each pixel, (row, col).

    A patch's index is assigned only in its core, a square at its centre. The index of all other pixels is the number of
    patches.

    Parameters
    ----------
    to_pixels : ndarray, (3, 3)
        Homography from cells to pixels.
    grid : tuple of int
        Number of rows and columns of patches.
    shape : tuple of int
        Number of rows and columns in the result.
    core : float
        Half the side of a core, in cells.
    """
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
    """Measured values of a chart's patches."""

    mean: Array  # (patch, channel) DN above black
    deviation: Array  # (patch, channel) DN; standard deviation of the mean
    variance: Array  # (patch, channel) DN²; noise variance of a pixel, without texture and gradients
    used: NDArray[np.bool_]  # (patch, channel) whether the mean is usable
    left_out: tuple[tuple[int, int, str], ...]  # patch index, channel and reason for each unusable mean


def patch_values(
    frames: Sequence[Array], cfa: NDArray[np.uint8], to_pixels: Array, grid: tuple[int, int], saturation: float
) -> PatchValues:
    """Measure the mean and the noise of each patch on a chart.

    Parameters
    ----------
    frames : sequence of ndarray, (row, col)
        One or more frames of the same scene, in DN above black. The first pixel is at CFA site (0, 0).
    cfa : ndarray, (cfa_row, cfa_col)
        Channel of each site.
    to_pixels : ndarray, (3, 3)
        Homography from cells to pixels.
    grid : tuple of int
        Number of rows and columns of patches.
    saturation : float
        Value in DN above black from which a pixel counts as clipped.

    Raises
    ------
    ValueError
        If a patch contains too few pixels of a channel.
    """
    mean_frame = np.mean(frames, axis=0, dtype=np.float64)
    shape, channels, patches = mean_frame.shape, int(cfa.max()) + 1, grid[0] * grid[1]
    patch = patch_map(to_pixels, grid, (shape[0], shape[1]), CORE)
    clipped = np.max(frames, axis=0) >= saturation
    differences = _differences(frames, cfa)
    mean, deviation, variance = (np.zeros((patches, channels)) for _ in range(3))
    used, left_out = np.ones((patches, channels), dtype=bool), []
    for (index, channel), part in _pixels(patch, patches, cfa):
        if part.size < MIN_PIXELS:
            raise ValueError(f"patch {index + 1} contains only {part.size} pixels of channel {channel}")
        values = mean_frame.ravel()[part]
        clean = _typical(values, 0.5)
        mean[index, channel] = values[clean].mean()
        variance[index, channel] = _robust_variance(differences.ravel()[part])
        noise = np.sqrt(variance[index, channel] / len(frames) / clean.sum())
        deviation[index, channel] = np.hypot(noise, PRECISION * mean[index, channel])
        if clipped.ravel()[part].mean() > CLIPPED:
            left_out.append((index, channel, "clipped"))
        elif clean.mean() < 1 - DUSTY:
            left_out.append((index, channel, "dusty or not uniform"))
    for index, channel, _ in left_out:
        used[index, channel] = False
    return PatchValues(mean, deviation, variance, used, tuple(left_out))


def _pixels(patch: NDArray[np.int64], patches: int, cfa: NDArray[np.uint8]) -> Iterator[tuple[tuple[int, int], NDArray]]:
    """Yield ((patch, channel), flat indices of the channel's pixels in the patch) for all patches and channels.

    `patch` is the result of `patch_map`, and `patches` is the number of patches.
    """
    channels = int(cfa.max()) + 1
    label = np.where(patch < patches, patch * channels + tiled(cfa, patch.shape), patches * channels).ravel()
    order = np.argsort(label, kind="stable")
    bounds = np.searchsorted(label[order], np.arange(patches * channels + 1))
    for index, channel in np.ndindex(patches, channels):
        at = index * channels + channel
        yield (index, channel), order[bounds[at] : bounds[at + 1]]


def _typical(values: Array, least: float) -> NDArray[np.bool_]:
    """Return a mask that is False for outliers, such as dust or hot pixels.

    The robust standard deviation from which outliers are determined is at least `least`.
    """
    off = np.abs(values - np.median(values))
    return np.asarray(off <= OUTLIER * max(MAD * float(np.median(off)), least))


def _differences(frames: Sequence[Array], cfa: NDArray[np.uint8]) -> Array:
    """Return differences between pixels, (row, col), scaled so that their variance is the noise variance of a pixel.

    If there are several frames, the result is the difference between the first two, divided by √2. If there is only one, it
    is the mixed second difference of four neighbouring pixels at the same CFA site, divided by 2. Linear gradients cancel in
    this difference. At the lower and right edges of a single frame, the result is NaN.
    """
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
    if values.size < MIN_PIXELS:
        return 0.0
    return float(values[_typical(values, 1e-3)].var())


def photon_transfer(values: Sequence[PatchValues]) -> tuple[float, float] | None:
    """Estimate the conversion gain (DN/e-) and the dark noise (DN) by fitting a photon transfer line.

    The line is fitted to the usable patches and channels in `values`. The dark noise excludes quantisation noise. Returns
    None if there are too few points, or if the slope is not positive. The slope may be zero or negative if the files were
    processed, or if they contain almost no noise.
    """
    mean = np.concatenate([each.mean[each.used] for each in values])
    variance = np.concatenate([each.variance[each.used] for each in values])
    real = (variance > 0) & (mean > 0)
    if real.sum() < MIN_POINTS:
        return None
    mean, variance = mean[real], variance[real]
    weight = 1.0 / variance
    for _ in range(3):  # the weights are the inverse variances on the fitted line itself
        slope, constant = np.polyfit(mean, variance, 1, w=weight)
        weight = 1.0 / np.maximum(slope * mean + constant, 0.1 * np.median(variance))
    if slope <= 0:
        return None
    return float(slope), float(np.sqrt(max(constant - 1.0 / 12.0, 0.0)))


@dataclass(frozen=True)
class Located:
    """Position of a chart in a picture."""

    to_pixels: Array  # (3, 3) homography from cells (x, y) to pixels (column, row)
    fit: float  # R² when the reflectances are fitted to the values, averaged over the channels


def superpixels(mosaic: Array, cfa: NDArray[np.uint8]) -> Array:
    """Return the mean of each channel in each complete CFA period, (row, col, channel).

    The first pixel of the mosaic must be at CFA site (0, 0).
    """
    rows, cols = cfa.shape
    height, width = mosaic.shape[0] // rows, mosaic.shape[1] // cols
    blocks = mosaic[: height * rows, : width * cols].reshape(height, rows, width, cols).astype(np.float64)
    channels = range(int(cfa.max()) + 1)
    weights = np.array([(cfa == channel) / np.count_nonzero(cfa == channel) for channel in channels])
    return np.einsum("hrwc,krc->hwk", blocks, weights)


def locate(mosaic: Array, cfa: NDArray[np.uint8], reflectance: Array, grid: tuple[int, int]) -> Located | None:
    """Find a chart in a mosaic.

    Parameters
    ----------
    mosaic : ndarray, (row, col)
        Mosaic in DN above black. The first pixel is at CFA site (0, 0).
    cfa : ndarray, (cfa_row, cfa_col)
        Channel of each site.
    reflectance : ndarray, (patch, wavelength)
        Reflectances of the patches, row by row.
    grid : tuple of int
        Number of rows and columns of patches.

    Returns
    -------
    Located or None
        Position of the chart, or None if no chart is found.
    """
    from scipy import ndimage

    picture = superpixels(mosaic, cfa)
    if min(picture.shape[:2]) < min(grid):
        return None
    step = max(1, -(-max(picture.shape[:2]) // SEARCHED))
    height, width = (length // step for length in picture.shape[:2])
    small = picture[: height * step, : width * step].reshape(height, step, width, step, -1).mean(axis=(1, 3))
    basis = components(reflectance)
    steepest, smooth = _steepest(small), ndimage.uniform_filter(small, (3, 3, 1))
    regions = [_plain_regions(steepest, slope) for slope in SLOPES]
    placements = [_placed(matrix, smooth, basis, grid) for region in regions for matrix in _grids(*region, grid)]
    best = max(filter(None, placements), key=lambda each: each.fit, default=None)
    if best is None or best.fit < MIN_FIT:
        return None
    best = _refined(best, np.concatenate([centres for centres, _ in regions]), grid)
    scale = np.array([cfa.shape[1] * step, cfa.shape[0] * step], dtype=np.float64)
    shift = (scale - 1) / 2  # centre of the reduced picture's first pixel, in mosaic pixels
    return Located(np.array([[scale[0], 0, shift[0]], [0, scale[1], shift[1]], [0, 0, 1]]) @ best.to_pixels, best.fit)


def components(reflectance: Array) -> Array:
    """Return an orthonormal basis, (patch, component), for the patch values in any channel.

    It spans a constant, which represents glare, and the principal components of the reflectances.
    """
    left, _, _ = np.linalg.svd(reflectance, full_matrices=False)
    basis, _ = np.linalg.qr(np.column_stack([np.ones(len(reflectance)), left[:, :COMPONENTS]]))
    return np.asarray(basis)


# ---------------------------------------------------------------------------------------------------------- regions


def _steepest(picture: Array) -> Array:
    """Return the relative gradient, (row, col), of a picture, (row, col, channel): the maximum over the channels."""
    from scipy import ndimage

    steepest = np.zeros(picture.shape[:2])
    for channel in range(picture.shape[2]):
        plane = picture[..., channel]
        floor = max(DARK_FRACTION * float(np.percentile(plane, 99)), 1e-9)  # positive even if the frame is black
        change = ndimage.gaussian_gradient_magnitude(plane, 1.0)
        steepest = np.maximum(steepest, change / (np.maximum(ndimage.gaussian_filter(plane, 1.0), 0.0) + floor))
    return steepest


def _plain_regions(steepest: Array, slope: float) -> tuple[Array, Array]:
    """Find uniform regions that may be patches, and return their centres, (region, 2), and their areas in pixels.

    A centre is (column, row). A region consists of connected pixels with relative gradients below `slope`. It may be a patch
    if it is neither too small nor too large, if it is not elongated, and if its area is close to that of a parallelogram
    with the same moments.
    """
    from scipy import ndimage

    label, count = ndimage.label(steepest < slope)
    if not count:
        return np.zeros((0, 2)), np.zeros(0)
    area = np.bincount(label.ravel(), minlength=count + 1)[1:].astype(np.float64)
    row, col = np.indices(label.shape)

    def mean(values: Array) -> Array:
        return np.bincount(label.ravel(), weights=values.ravel(), minlength=count + 1)[1:] / area

    y, x = mean(row), mean(col)
    yy, xx, xy = mean(row * row) - y * y, mean(col * col) - x * x, mean(row * col) - x * y
    spread, tilt = (yy + xx) / 2 + 1 / 12, np.hypot((yy - xx) / 2, xy)
    long, short = spread + tilt, np.maximum(spread - tilt, 1e-9)
    filled = area / (12 * np.sqrt(long * short))
    fits = (area >= MIN_AREA) & (area <= MAX_SHARE * label.size) & (long < LONG**2 * short)
    fits &= (filled > FILLED[0]) & (filled < FILLED[1])
    return np.stack([x, y], axis=1)[fits], area[fits]


# ------------------------------------------------------------------------------------------------------------ grids


def _grids(centres: Array, areas: Array, grid: tuple[int, int]) -> list[Array]:
    """Find the grids that contain the most regions, and return their homographies from grid points to pixels.

    Each grid is built outwards from one region, which becomes grid point (0, 0). If there are too few regions, the result is
    empty.
    """
    least = max(MIN_REGIONS, round(MIN_SHARE * grid[0] * grid[1]))
    if len(centres) < least:
        return []
    reach, found = max(grid), []
    for seed in np.argsort(-areas)[:SEEDS]:
        alike = (areas > areas[seed] / 3) & (areas < areas[seed] * 3)
        offsets = centres[alike] - centres[seed]
        close = offsets[np.argsort(np.hypot(*offsets.T))[1 : NEIGHBOURS + 1]]
        steps = close[PAIRS[(len(close) > PAIRS).all(axis=1)]]
        steps = steps[_may_be_steps(steps)]
        count = (_on_grid(offsets @ np.linalg.inv(steps), reach) >= 0).sum(axis=(1, 2))
        first = np.tile(np.eye(3), (len(steps), 1, 1))
        first[:, :2] = np.concatenate([steps.swapaxes(1, 2), np.tile(centres[seed][:, None], (len(steps), 1, 1))], axis=2)
        found += [each for each in zip(count, first, strict=True) if each[0] >= MIN_REGIONS]
    found.sort(key=lambda each: -each[0])
    if not found:
        return []
    counts, grown = _grown(centres, np.array([matrix for _, matrix in found[:GROWN]]), reach)
    best = np.argsort(-counts, kind="stable")[:TRIED]
    return list(grown[best[counts[best] >= least]])


def _may_be_steps(steps: Array) -> NDArray[np.bool_]:
    """Return which pairs of offsets, (pair, 2, 2), may be the basis vectors of a chart's grid: (pair,).

    The two offsets must have similar lengths and be roughly perpendicular. They must not form a mirrored grid, because the
    camera records the front of the chart.
    """
    one, other = np.hypot(*steps.T)
    turn = np.linalg.det(steps)  # positive unless the grid is mirrored
    aslant = np.abs((steps[:, 0] * steps[:, 1]).sum(axis=1))
    equal = np.maximum(one, other) <= UNEQUAL * np.minimum(one, other)
    return np.asarray(equal & (turn > 0) & (aslant < ASKEW * one * other))


def _on_grid(coordinates: Array, reach: int) -> NDArray[np.int64]:
    """Return the index of the region nearest to each grid point, or -1 if there is no region nearby: (grid, y, x).

    Grid points have x and y from −`reach` to `reach`. `coordinates`, (grid, region, 2), contains x and y of every region in
    each grid.
    """
    places = np.rint(coordinates)
    off = np.abs(coordinates - places).max(axis=-1)
    close = (off < OFF) & (np.abs(places).max(axis=-1) <= reach)
    order = np.argsort(off[close], kind="stable")[::-1]
    grids, regions = (index[order] for index in np.nonzero(close))
    x, y = places[close][order].astype(np.int64).T + reach
    on = np.full((len(coordinates), 2 * reach + 1, 2 * reach + 1), -1)
    on[grids, y, x] = regions  # sorted by decreasing distance, so that the nearest region overwrites all others
    return on


def _grown(centres: Array, matrices: Array, reach: int) -> tuple[NDArray[np.int64], Array]:
    """Extend grids outwards in several steps. Return the number of regions in each grid, and the fitted homographies."""
    counts, growing = np.zeros(len(matrices), dtype=np.int64), np.arange(len(matrices))
    for radius in (2, 3, 5, reach, reach):
        growing = growing[np.linalg.det(matrices[growing]) != 0]
        coordinates = through(np.linalg.inv(matrices[growing]), centres)
        on = _on_grid(np.where(np.isfinite(coordinates), coordinates, 1e6), radius)
        taken = on >= 0
        count, cols, rows = taken.sum(axis=(1, 2)), taken.any(axis=1).sum(axis=1), taken.any(axis=2).sum(axis=1)
        enough = (count >= MIN_REGIONS) & (cols > 1) & (rows > 1)
        growing, on = growing[enough], on[enough]
        counts[growing], matrices[growing] = count[enough], _fitted(centres, on)
    return counts, matrices


def _fitted(centres: Array, on: NDArray[np.int64]) -> Array:
    """Fit a homography, from grid points to pixels, to each grid, (grid, 3, 3). `on` is the result of `_on_grid`."""
    used = (on >= 0).reshape(len(on), -1, 1)
    pixels = centres[on.reshape(len(on), -1)]
    shift = (used * pixels).sum(axis=1, keepdims=True) / used.sum(axis=1, keepdims=True)
    pixels = used * (pixels - shift)
    scale = np.abs(pixels).max(axis=(1, 2))
    reach = on.shape[1] // 2
    cells = np.stack(np.meshgrid(*2 * [np.arange(-reach, reach + 1.0)]), axis=-1).reshape(-1, 2)
    right = pixels / scale[:, None, None]
    system = np.repeat(used, 2, axis=1) * _equations(np.tile(cells, (len(on), 1, 1)), right)
    turned = system.swapaxes(1, 2)
    solved = np.linalg.pinv(turned @ system, 1e-12, hermitian=True) @ (turned @ right.reshape(len(on), -1, 1))
    result = np.concatenate([solved, np.ones((len(on), 1, 1))], axis=1).reshape(-1, 3, 3)
    result[:, :2] *= scale[:, None, None]
    result[:, :2] += shift.swapaxes(1, 2) * result[:, 2:]
    return result


def _refined(located: Located, centres: Array, grid: tuple[int, int]) -> Located:
    """Refine the position of a chart by fitting it to all regions that are close to a patch centre."""
    matrix = located.to_pixels
    for tolerance in REFINED:
        cells = through(np.linalg.inv(matrix), centres)
        places = np.floor(np.where(np.isfinite(cells), cells, -1.0)) + 0.5
        close = (
            (np.abs(cells - places) < tolerance).all(axis=1) & (places > 0).all(axis=1) & (places < grid[::-1]).all(axis=1)
        )
        if len(np.unique(places[close], axis=0)) < MIN_REGIONS:
            break
        matrix = homography(places[close], centres[close])
    return Located(matrix, located.fit)


# -------------------------------------------------------------------------------------------------------- placement


def _placed(matrix: Array, smooth: Array, basis: Array, grid: tuple[int, int]) -> Located | None:
    """Try all positions and orientations of the chart on a grid, and return the best fit to the reflectances.

    Returns None if no position is completely inside the picture.
    """
    rows, cols = grid
    places = np.arange(-max(grid), max(grid) + 1.0)
    index = np.stack(np.meshgrid(places, places), axis=-1)  # (y, x, 2)
    values = _sampled(smooth, through(matrix, index))  # (y, x, channel)
    turns = np.stack([np.rot90(values, turn) for turn in range(4)])
    patches = sliding_window_view(turns, grid, axis=(1, 2)).reshape(-1, values.shape[2], rows * cols).swapaxes(1, 2)
    whole = np.flatnonzero(~np.isnan(patches).any(axis=(1, 2)))
    if not whole.size:
        return None
    shares = fit(patches[whole], basis)
    best = int(np.argmax(shares))
    turn, y, x = np.unravel_index(whole[best], (4, len(places) - rows + 1, len(places) - cols + 1))
    corners = np.rot90(index, turn)[y : y + rows, x : x + cols]
    centres = np.stack(np.meshgrid(np.arange(cols), np.arange(rows)), axis=-1) + 0.5
    return Located(homography(centres.reshape(-1, 2), through(matrix, corners).reshape(-1, 2)), float(shares[best]))


def _sampled(picture: Array, points: Array) -> Array:
    """Return the values, (…, channel), of the pixels nearest to `points`, (…, 2), or NaN outside the picture.

    A point is (column, row).
    """
    inside: NDArray[np.bool_] = np.asarray(np.isfinite(points).all(axis=-1))
    index = np.rint(np.where(inside[..., None], points, -1)).astype(np.int64)
    height, width = picture.shape[:2]
    inside &= (index >= 0).all(axis=-1) & (index[..., 0] < width) & (index[..., 1] < height)
    col, row = np.where(inside, index[..., 0], 0), np.where(inside, index[..., 1], 0)
    return np.where(inside[..., None], picture[row, col], np.nan)


def fit(patches: Array, basis: Array) -> Array:
    """Fit the basis from `components` to patch values, (…, patch, channel), and return R², the mean over the channels."""
    centred = patches - patches.mean(axis=-2, keepdims=True)
    left = patches - basis @ (basis.T @ patches)
    return np.asarray(np.mean(1.0 - (left**2).sum(axis=-2) / np.maximum((centred**2).sum(axis=-2), 1e-12), axis=-1))
