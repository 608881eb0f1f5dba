"""Metrics for rendered sequences: temporal noise, flicker and errors (docs/method.md#quality-of-sequences).

If the motion between frames is unknown, it is estimated from the ideal frames by window matching on an image pyramid.
Pictures are linear sRGB (row, col, 3), where 1 is display white. Lightness is CIE L*, from 0 to 100.
"""

import itertools
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, median_filter, spline_filter, uniform_filter

from l3cli.errors import InputFileError
from l3cli.evaluation.quality import cropped, psnr
from l3cli.physics.display import displayed_delta_e, lightness, srgb_curve
from l3cli.system.limits import read_bounded

Array = NDArray[np.floating]
PYRAMID_LEVELS = 3  # the coarsest level has a quarter of the frame's width and height
SEARCH_PIXELS = 5  # search range in each direction at the coarsest level
WINDOW = 15  # pixels; side of the matched windows
GRID_PIXELS = 4  # the motion is median-filtered on a grid of pixels with this spacing
PENALTY = 0.1  # L*² per pixel of displacement, added to the mismatch so that uniform areas move with their surroundings
MISMATCH = 3.0  # L*; windows with a larger mean absolute difference show different objects
MISMATCH_WINDOW = 5  # pixels; side of the windows for this mean absolute difference
SUBPIXEL_ITERATIONS = 4  # Lucas–Kanade iterations
ROUNDING_PIXELS = 1e-6  # tolerance for rounding errors of positions
FLAT = 0.1  # L*² per pixel², added to mean square gradients so that the motion of uniform windows is hardly refined


def estimated_motion(light: Array, last: Array) -> NDArray[np.float32]:
    """Estimate the motion between two frames with subpixel precision.

    The search range is about SEARCH_PIXELS · 2^(PYRAMID_LEVELS − 1) pixels in each direction. For small frames, the pyramid
    has fewer levels, so the search range is smaller.

    Parameters
    ----------
    light : ndarray, (row, col)
        L* of the current frame.
    last : ndarray, (row, col)
        L* of the previous frame.

    Returns
    -------
    ndarray, (3, row, col)
        Downward and rightward motion since the previous frame, in pixels, and validity: 1 if both frames show the same
        object, otherwise 0.
    """
    pairs: list[tuple[Array, Array]] = [(np.asarray(light, np.float64), np.asarray(last, np.float64))]
    while len(pairs) < PYRAMID_LEVELS and min(pairs[-1][0].shape) >= 2 * WINDOW:
        pairs.append((_halved(pairs[-1][0]), _halved(pairs[-1][1])))
    vector = np.zeros((2, *pairs[-1][0].shape), int)
    for level, (frame, before) in enumerate(reversed(pairs)):
        if level:
            vector = _doubled(vector, frame.shape)
        vector = _refined(frame, before, vector, SEARCH_PIXELS if level == 0 else 1)
    fine = _exact(*pairs[0], vector)
    return np.concatenate([fine, _seen(light, last, fine)[None]]).astype(np.float32)


def _refined(frame: Array, before: Array, vector: NDArray[np.intp], reach: int) -> NDArray[np.intp]:
    """Refine a displacement field (2, row, col) by searching within `reach` pixels of each displacement."""
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
    """Return the mean square difference (row, col) between the window around each pixel and its source window in `before`.

    `vector` (2, row, col) is the displacement of each pixel since the frame `before`.
    """
    place = [
        np.clip(at - by, 0, length - 1) for at, by, length in zip(np.indices(frame.shape), vector, frame.shape, strict=True)
    ]
    return np.asarray(uniform_filter(np.square(frame - before[place[0], place[1]]), WINDOW))


def _exact(frame: Array, before: Array, motion: Array) -> Array:
    """Refine displacements (2, row, col) to subpixel precision, by least-squares fits over windows.

    The method is by Lucas and Kanade ("An iterative image registration technique", 1981).
    """
    place, spline = np.indices(frame.shape), spline_filter(before)
    for _ in range(SUBPIXEL_ITERATIONS):
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
    """Remove outliers with a median filter, and smooth the result.

    To save time, the median filter is applied only to every GRID_PIXELS-th row and column.
    """
    side = -(-WINDOW // GRID_PIXELS) | 1
    whole = (
        median_filter(plane[::GRID_PIXELS, ::GRID_PIXELS], side, mode="nearest")
        .repeat(GRID_PIXELS, axis=0)
        .repeat(GRID_PIXELS, axis=1)
    )
    return np.asarray(uniform_filter(whole[: plane.shape[0], : plane.shape[1]], GRID_PIXELS, mode="nearest"))


def _seen(light: Array, last: Array, motion: Array) -> NDArray[np.bool_]:
    """Return a mask (row, col) of the pixels that show the same object as their origin in the previous frame.

    Pixels with an origin outside the frame are excluded.
    """
    source = np.indices(light.shape) - motion
    inside = np.logical_and.reduce(
        [
            (at > -ROUNDING_PIXELS) & (at < length - 1 + ROUNDING_PIXELS)
            for at, length in zip(source, light.shape, strict=True)
        ]
    )
    wrong = uniform_filter(abs(light - map_coordinates(last, source, order=3, mode="mirror")), MISMATCH_WINDOW)
    return np.asarray(inside & (wrong < MISMATCH))


def _halved(plane: Array) -> Array:
    rows, cols = (length // 2 * 2 for length in plane.shape)
    return plane[:rows, :cols].reshape(rows // 2, 2, cols // 2, 2).mean(axis=(1, 3))


def _doubled(vector: NDArray[np.intp], shape: tuple[int, ...]) -> NDArray[np.intp]:
    """Double the size and values of a displacement field (2, row, col), for the next finer pyramid level.

    If the new size `shape` is odd, the last row or column is repeated.
    """
    whole = 2 * vector.repeat(2, axis=1).repeat(2, axis=2)
    return np.pad(
        whole, [(0, 0), *((0, length - have) for length, have in zip(shape, whole.shape[1:], strict=True))], mode="edge"
    )


GIVE = 'use the output of "l3 evaluate --sequence … --json"'
CELL = 8  # pixels; side of a patch
# A patch is still if the L* of each pixel varies by at most this value over the ideal sequence, about one 8-bit step.
STILL = 0.5
# Without an ideal sequence, the following constants define still patches.
DRIFT = 1.0  # L*; maximum change of a still patch's mean from the first to the second half of the sequence
UNCERTAIN = 3.0  # standard deviations; noise may cause smaller changes
# The fraction QUIETEST of the patches with the smallest changes is assumed to show only noise. Still patches change at most
# RESTLESS times as much.
QUIETEST, RESTLESS = 0.1, 3.0
ROUNDING = 0.1  # L*; maximum change of a pixel due to rounding


class FrameFigures(msgspec.Struct, forbid_unknown_fields=True):
    """Metrics of one frame in a sequence.

    `jump`, `step_sigma` and `warped_error` are None in the first frame. `warped_error`, `psnr` and `mean_delta_e` are None
    without an ideal sequence. `step_sigma` is also None if there are no still patches, and `warped_error` if no pixel is
    visible in both frames.
    """

    frame: int
    mean_lightness: float  # L*
    jump: float | None  # L*; change in mean lightness since the previous frame, minus the ideal sequence's change, if any
    step_sigma: float | None  # L*; RMS change of pixels in still patches since the previous frame, divided by √2
    warped_error: float | None  # L*; RMS change of the error since the previous frame, along the motion of objects
    psnr: float | None  # dB; from non-linear sRGB
    mean_delta_e: float | None  # mean CIEDE2000 difference from the ideal frame


class SequenceFigures(msgspec.Struct, forbid_unknown_fields=True, tag_field="kind", tag="sequence"):
    """Metrics of a rendered sequence, with the JSON keys of `l3 evaluate --sequence`."""

    rendered: str
    ideal: str | None
    motion: Literal["known", "estimated"] | None  # how the motion for `warped_error` was obtained, if at all
    frames: list[FrameFigures]
    still_share: float  # fraction of patches that are still
    temporal_sigma: float | None  # L*; temporal standard deviation of pixels, RMS over still patches
    patch_sigma: float | None  # L*; temporal standard deviation of patch means, RMS over still patches
    largest_jump: float | None  # L*; `jump` with the largest absolute value
    largest_jump_frame: int | None  # index of this frame, from 0
    warped_error: float | None  # L*; RMS over the frames
    psnr: float | None  # mean over the frames
    mean_delta_e: float | None  # mean over the frames

    def document(self) -> dict[str, Any]:
        """Return the metrics as a dictionary for JSON."""
        return dict(msgspec.to_builtins(self))


class SequenceEvaluation:
    """Evaluates a rendered sequence frame by frame, alone or in comparison with an ideal sequence.

    Only a few values per patch and frame remain in memory.

    Parameters
    ----------
    rendered : str
        Name of the rendered sequence.
    ideal : str or None
        Name of the ideal sequence, if any.
    border : int
        Margin that is not evaluated, in pixels.
    """

    def __init__(self, rendered: str, ideal: str | None, border: int = 0) -> None:
        self._names, self._border = (rendered, ideal), border
        self._frames: list[FrameFigures] = []
        self._cells: list[Array] = []  # for each frame, the mean L* of every patch
        self._steps: list[Array] = []  # for each frame after the first, the mean square change of pixels in every patch
        self._motion: Literal["known", "estimated"] | None = None
        self._last: Array | None = None  # L* of the previous frame
        self._ideal: tuple[Array, Array] | None = None  # previous frame: L* of the ideal picture, and the error
        self._offset = 0.0  # mean L* of the previous frame, minus the mean L* of its ideal picture, if any
        self._sum: Array | float = 0.0  # sum of each pixel's L* over all frames
        self._squares: Array | float = 0.0  # sum of each pixel's squared L* over all frames
        self._range: tuple[Array, Array] | None = None  # lowest and highest L* of each pixel in the ideal sequence

    def add(self, rendered: Array, ideal: Array | None = None, motion: Array | None = None) -> None:
        """Add the next frame. All pictures in a sequence must have the same size.

        Parameters
        ----------
        rendered : ndarray, (row, col, 3)
            Rendered picture in linear sRGB. Values are clipped to 0…1.
        ideal : ndarray, (row, col, 3), optional
            Ideal picture in linear sRGB, for every frame or for none. Values are clipped to 0…1.
        motion : ndarray, (3, row, col), optional
            Downward and rightward motion since the previous frame, in pixels, and validity (1 or 0). Ignored for the first
            frame and without an ideal picture. [default: motion estimated from the ideal pictures]
        """
        light = lightness(np.clip(rendered, 0.0, 1.0))
        wanted = None if ideal is None else lightness(np.clip(ideal, 0.0, 1.0))
        warped = None
        if wanted is not None:
            error = light - wanted
            if self._ideal is not None:
                self._motion = "estimated" if motion is None else "known"
                motion = estimated_motion(wanted, self._ideal[0]) if motion is None else motion
                warped = _warped_error(error, self._ideal[1], motion, self._border)
            self._ideal = wanted, error
        light = cropped(light, self._border)
        step = None if self._last is None else light - self._last
        self._last = light
        self._sum, self._squares = self._sum + light, self._squares + light**2
        self._cells.append(_cell_means(light))
        if step is not None:
            self._steps.append(_cell_means(step**2))
        if wanted is not None:
            wanted = cropped(wanted, self._border)
            low, high = self._range or (wanted, wanted)
            self._range = np.minimum(low, wanted), np.maximum(high, wanted)
        self._frames.append(self._figures(rendered, ideal, step, wanted, warped))

    def _figures(
        self, rendered: Array, ideal: Array | None, step: Array | None, wanted: Array | None, warped: float | None
    ) -> FrameFigures:
        """Return the metrics of the latest frame, without `step_sigma`, because still patches are not known yet."""
        assert self._last is not None
        quality, difference = None, None
        if ideal is not None:
            pictures = [np.clip(_cropped(each, self._border), 0.0, 1.0) for each in (rendered, ideal)]
            quality = psnr(*map(srgb_curve, pictures))
            difference = float(displayed_delta_e(*pictures).mean())
        mean = float(self._last.mean())
        offset = mean - (0.0 if wanted is None else float(wanted.mean()))
        jump = None if step is None else offset - self._offset
        self._offset = offset
        return FrameFigures(len(self._frames), mean, jump, None, warped, quality, difference)

    def figures(self) -> SequenceFigures:
        """Return the metrics of the frames added so far, including the temporal noise of still patches.

        Raises ValueError if there are fewer than two frames.
        """
        count = len(self._frames)
        if count < 2:
            raise ValueError("a sequence needs at least two frames")
        still = self._still()
        for frame, steps in zip(self._frames[1:], self._steps, strict=True):
            frame.step_sigma = float(np.sqrt(steps[still].mean() / 2)) if still.any() else None
        largest = max(self._frames[1:], key=lambda frame: abs(frame.jump or 0.0))
        warped = [frame.warped_error for frame in self._frames if frame.warped_error is not None]
        return SequenceFigures(
            *self._names,
            self._motion,
            self._frames,
            still_share=float(still.mean()),
            temporal_sigma=self._temporal_sigma(still),
            patch_sigma=_deviation(np.stack(self._cells)[:, still]) if still.any() else None,
            largest_jump=largest.jump,
            largest_jump_frame=largest.frame,
            warped_error=float(np.sqrt(np.mean(np.square(warped)))) if warped else None,
            psnr=_mean([frame.psnr for frame in self._frames]),
            mean_delta_e=_mean([frame.mean_delta_e for frame in self._frames]),
        )

    def _temporal_sigma(self, still: NDArray[np.bool_]) -> float | None:
        if not still.any():
            return None
        count = len(self._frames)
        variance = np.maximum(self._squares - np.square(self._sum) / count, 0.0) / (count - 1)
        return float(np.sqrt(_cell_means(variance)[still].mean()))

    def _still(self) -> NDArray[np.bool_]:
        """Return a mask (patch row, patch column) of still patches.

        With an ideal sequence, a patch is still if its pixels hardly change there. Otherwise, it is still if noise can
        explain its changes. The noise is estimated from the patches that change least.
        """
        if self._range is not None:
            low, high = self._range
            return np.asarray(_cells(high - low).max(axis=(1, 3)) <= STILL)
        cells, half = np.stack(self._cells), len(self._cells) // 2
        change = np.sqrt(np.mean(np.square(np.diff(cells, axis=0)), axis=0) / 2)
        drift = abs(cells[:half].mean(axis=0) - cells[-half:].mean(axis=0))
        by_chance = UNCERTAIN * change * np.sqrt(2 / half)
        restless = np.sqrt(np.mean(self._steps, axis=0) / 2)
        calm = restless <= max(RESTLESS * float(np.quantile(restless, QUIETEST)), ROUNDING)
        return np.asarray((drift <= np.maximum(DRIFT, by_chance)) & calm)


def _warped_error(error: Array, last: Array, motion: Array, border: int) -> float | None:
    """Return the RMS change of the error (row, col) along the motion, or None if no pixel is visible in both frames.

    The error `last` of the previous frame is displaced by the motion and subtracted from the current error. The error is
    displaced instead of the pictures, because interpolation artefacts at edges cancel in the error.
    """
    row, col = np.indices(error.shape)
    seen = cropped(motion[2], border) > 0
    if not seen.any():
        return None
    before = map_coordinates(last, [row - motion[0], col - motion[1]], order=3, mode="nearest")
    return float(np.sqrt(np.mean(np.square(cropped(error - before, border)[seen]))))


def _cells(plane: Array) -> Array:
    """Divide a plane (row, col) into patches (patch row, row, patch column, column), without incomplete patches."""
    rows, cols = (length // CELL for length in plane.shape)
    return plane[: rows * CELL, : cols * CELL].reshape(rows, CELL, cols, CELL)


def _cell_means(plane: Array) -> Array:
    return np.asarray(_cells(plane).mean(axis=(1, 3)), np.float32)


def _deviation(series: Array) -> float:
    """Return the RMS, over all series (time, …), of the standard deviation over time."""
    return float(np.sqrt(series.var(axis=0, ddof=1, dtype=np.float64).mean()))


def _cropped(picture: Array, border: int) -> Array:
    return np.moveaxis(cropped(np.moveaxis(picture, -1, 0), border), 0, -1)


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def read_sequence_figures(path: Path) -> SequenceFigures:
    """Read a file from `l3 evaluate --sequence --json`.

    Raises InputFileError if the file cannot be read, has other content, or contains metrics of fewer than two frames.
    """
    try:
        printed = msgspec.json.decode(read_bounded(path, GIVE), type=dict[str, Any])
        printed.pop("run", None)  # describes the run of the command, not the sequence
        figures = msgspec.convert(printed, SequenceFigures)
    except (OSError, msgspec.MsgspecError, RecursionError) as error:
        raise InputFileError(f"{path} does not contain the evaluation of a sequence; {GIVE}") from error
    if len(figures.frames) < 2:
        raise InputFileError(f"{path} contains the metrics of fewer than two frames; {GIVE}")
    return figures
