"""Flicker of a rendered sequence, and its difference from the ideal one (docs/method.md#quality-of-sequences); motion
between two clean frames where it is not known, by matching windows from coarse to fine.

Pictures are linear sRGB (row, col, 3), 1 being display white; lightness is CIE L*, from 0 to 100.
"""

import itertools
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.evaluation.quality import cropped, psnr
from l3cli.physics.display import displayed_delta_e, lightness, srgb_curve
from l3cli.system.limits import read_bounded

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


GIVE = 'give what "l3 evaluate --sequence … --json" prints'
CELL = 8  # pixels, side of a patch
STILL = 0.5  # L*, of an ideal pixel over the whole sequence: a code of 8 bits more or less
DRIFT = 1.0  # L*, between the means of a patch over both halves of a sequence, where there is no ideal
UNCERTAIN = 3.0  # standard deviations that noise may be taken for a drift by
QUIETEST, RESTLESS = 0.1, 3.0  # share of the patches whose changes are noise; so many times as much is something else
ROUNDING = 0.1  # L*, that the pixels of a patch may change by


class FrameFigures(msgspec.Struct, forbid_unknown_fields=True):
    """Figures of one frame; None: there is nothing that it could be computed from."""

    frame: int
    mean_lightness: float  # L*
    jump: float | None  # L*, of the mean since the frame before, that of the ideal taken off
    step_sigma: float | None  # L*, of the change since the frame before on still patches, divided by √2
    warped_error: float | None  # L*, root mean square of what the error has changed by along the motion
    psnr: float | None  # dB, of non-linear sRGB
    mean_delta_e: float | None  # CIEDE2000


class SequenceFigures(msgspec.Struct, forbid_unknown_fields=True, tag_field="kind", tag="sequence"):
    """Figures of a rendered sequence, as `l3 evaluate` prints them in JSON."""

    rendered: str
    ideal: str | None
    motion: Literal["known", "estimated"] | None  # that errors are followed along
    frames: list[FrameFigures]
    still_share: float  # of the patches that show the same all the time
    temporal_sigma: float | None  # L*, of a pixel over time, root mean square over still patches
    patch_sigma: float | None  # L*, of the mean of a still patch over time, root mean square
    largest_jump: float | None  # L*
    largest_jump_frame: int | None
    warped_error: float | None  # L*, root mean square over the frames
    psnr: float | None  # mean over the frames
    mean_delta_e: float | None  # mean over the frames

    def document(self) -> dict[str, Any]:
        """Return the figures, ready for JSON."""
        return dict(msgspec.to_builtins(self))


class SequenceEvaluation:
    """Frames counted one by one, in their order; memory grows by a few values for each patch and frame."""

    def __init__(self, rendered: str, ideal: str | None, border: int = 0) -> None:
        self._names, self._border = (rendered, ideal), border
        self._frames: list[FrameFigures] = []
        self._cells: list[Array] = []  # of each frame the mean L* of every patch
        self._steps: list[Array] = []  # of each frame but the first the mean square of its change
        self._motion: Literal["known", "estimated"] | None = None
        self._last: Array | None = None  # L* of the last frame
        self._ideal: tuple[Array, Array] | None = None  # of the last frame: L* of its ideal, and its difference from that
        self._offset = 0.0  # of the last frame's mean L* from the ideal's, or from 0
        self._sum: Array | float = 0.0
        self._squares: Array | float = 0.0
        self._range: tuple[Array, Array] | None = None  # lowest and highest L* of the ideal

    def add(self, rendered: Array, ideal: Array | None = None, motion: Array | None = None) -> None:
        """Count the next frame; `motion` (3, row, col): what it has moved by since the last one, pixels down and right, and
        where that is known. Without it the motion is estimated of the ideal pictures."""
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
        """Return the figures of the newest frame that are known before the end."""
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
        """Return the figures of all frames counted; ValueError unless there are two."""
        count = len(self._frames)
        if count < 2:
            raise ValueError("a sequence has two frames or more")
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
        """Return the patches (row, col) that show the same all the time: by the ideal, or else as far as noise explains it,
        such as that of the patches that change least."""
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
    """Return the root mean square of changes of the error (row, col) where the same was seen; None if nothing was.

    Errors are warped, not pictures: the differences of two warped pictures less those of the ideal ones, since warping is
    linear, and what the interpolation spoils at edges is in both.
    """
    from scipy.ndimage import map_coordinates

    row, col = np.indices(error.shape)
    seen = cropped(motion[2], border) > 0
    if not seen.any():
        return None
    before = map_coordinates(last, [row - motion[0], col - motion[1]], order=3, mode="nearest")
    return float(np.sqrt(np.mean(np.square(cropped(error - before, border)[seen]))))


def _cells(plane: Array) -> Array:
    """Return a plane (row, col) as (row of patches, row, column of patches, col); what does not fill a patch is cut off."""
    rows, cols = (length // CELL for length in plane.shape)
    return plane[: rows * CELL, : cols * CELL].reshape(rows, CELL, cols, CELL)


def _cell_means(plane: Array) -> Array:
    return np.asarray(_cells(plane).mean(axis=(1, 3)), np.float32)


def _deviation(series: Array) -> float:
    """Return root mean square over series (time, …) of their standard deviation."""
    return float(np.sqrt(series.var(axis=0, ddof=1, dtype=np.float64).mean()))


def _cropped(picture: Array, border: int) -> Array:
    return np.moveaxis(cropped(np.moveaxis(picture, -1, 0), border), 0, -1)


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def read_sequence_figures(path: Path) -> SequenceFigures:
    """Return the figures that `l3 evaluate --sequence` printed as JSON; InputFileError if a file holds something else."""
    try:
        printed = msgspec.json.decode(read_bounded(path, GIVE), type=dict[str, Any])
        printed.pop("run", None)  # how the command ran
        figures = msgspec.convert(printed, SequenceFigures)
    except (OSError, msgspec.MsgspecError, RecursionError) as error:
        raise InputFileError(f"{path} is not an evaluation of a sequence; {GIVE}") from error
    if len(figures.frames) < 2:
        raise InputFileError(f"{path} holds fewer than two frames; {GIVE}")
    return figures
