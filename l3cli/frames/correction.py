"""Correct bad pixels, hot pixels and shading in raw frames, and subtract dark frames (docs/method.md#corrections).

This module also reads corrections from a camera model file, and checks that they match a transform table.
"""

import functools
import hashlib
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.store import load, open_artifact
from l3cli.artifacts.table import TransformTable
from l3cli.errors import InputFileError, RecipeError
from l3cli.frames.frame import RawFrame
from l3cli.frames.shading import CLIPPED, Shading, shading_of
from l3cli.frames.super_pixels import SuperPixelCorrection, plan_super_pixels
from l3cli.physics.mosaic import array_rows
from l3cli.system.files import require_same

if TYPE_CHECKING:
    from l3cli.artifacts.table import TransformTable

NEIGHBOURS = 4  # number of neighbours from which a bad pixel's value is computed
SEARCH_PIXELS = 16  # maximum distance between a bad pixel and its neighbours, in rows and in columns
MAX_BAD = 0.1  # maximum fraction of bad pixels; a mask with more of them is probably not a defect map
MIN_EXCESS = 8.0  # minimum excess of a hot pixel over its brightest neighbour, in noise standard deviations
RANGE = 2.0  # minimum excess of a hot pixel over its brightest neighbour, as a multiple of the neighbours' range
# The pixels adjacent to a hot pixel may be brighter than usual by at most this number of standard deviations, or by at most
# this fraction of the hot pixel's excess.
NEXT_SIGMAS, NEXT_SHARE = 2.0, 0.1
AROUND = [(row, col) for row in (-1, 0, 1) for col in (-1, 0, 1) if (row, col) != (0, 0)]
Array = NDArray[np.float64]
# Pixels that deviate by more standard deviations are excluded from the mean level of a dark frame.
HOT = 5.0
MAD = 1.4826  # standard deviation of a normal distribution, divided by its median absolute deviation


@dataclass(frozen=True, eq=False)
class BadPixelCorrection:
    """A sensor's bad pixels, and the good pixels from which their values are computed."""

    target: NDArray[np.int64]  # (defect) flat index in a frame
    source: NDArray[np.int64]  # (defect, NEIGHBOURS) flat indices of good pixels

    def corrected(self, values: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Return a copy of a frame, (row, col), with the bad pixels replaced.

        The new value of a bad pixel is the mean of the two middle values of its four neighbours, with halves rounded up.
        """
        result = values.copy()
        neighbours = values.ravel()[self.source].astype(np.int32)
        result.ravel()[self.target] = (neighbours.sum(axis=1) - neighbours.max(axis=1) - neighbours.min(axis=1) + 1) >> 1
        return result


def plan_correction(bad: NDArray[np.bool_], cfa: NDArray[np.integer]) -> BadPixelCorrection:
    """Select the good pixels from which bad pixels are computed: the nearest ones of the same channel.

    Parameters
    ----------
    bad : ndarray of bool, (row, col)
        Mask of bad pixels.
    cfa : ndarray, (cfa_row, cfa_col)
        Channel of each site.

    Raises
    ------
    InputFileError
        If a bad pixel has no good neighbour within SEARCH_PIXELS, or if too many pixels are bad.
    """
    if bad.mean() > MAX_BAD:
        raise InputFileError(f"{bad.mean():.0%} of the pixels are marked as defective; mark at most {MAX_BAD:.0%}")
    shape, period = bad.shape, cfa.shape
    targets, sources = [], []
    places = np.argwhere(bad)
    for site in np.ndindex(period):
        defects = places[((places % period) == site).all(axis=1)]
        if not defects.size:
            continue
        nearest = np.full((len(defects), NEIGHBOURS), -1, np.int64)
        count = np.zeros(len(defects), np.int64)
        for offset in _offsets(cfa, site):
            open_ones = np.flatnonzero(count < NEIGHBOURS)
            if not open_ones.size:
                break
            place = defects[open_ones] + offset
            inside = ((place >= 0) & (place < shape)).all(axis=1)
            row, col = place[inside].T
            sound = ~bad[row, col]
            found = open_ones[inside][sound]
            nearest[found, count[found]] = row[sound] * shape[1] + col[sound]
            count[found] += 1
        if not count.all():
            row, col = defects[int(count.argmin())]
            raise InputFileError(
                f"the defective pixel in row {row}, column {col} has no good neighbour of the same channel within "
                f"{SEARCH_PIXELS} pixels; mark fewer pixels as defective"
            )
        # If a bad pixel has fewer than NEIGHBOURS good neighbours, some of them are used repeatedly.
        again = np.arange(NEIGHBOURS) % count[:, None]
        targets.append(defects[:, 0] * shape[1] + defects[:, 1])
        sources.append(np.take_along_axis(nearest, again, axis=1))
    if not targets:
        return BadPixelCorrection(np.zeros(0, np.int64), np.zeros((0, NEIGHBOURS), np.int64))
    return BadPixelCorrection(np.concatenate(targets), np.concatenate(sources))


def _offsets(cfa: NDArray[np.integer], site: tuple[int, ...]) -> NDArray[np.int64]:
    """Return the offsets, (offset, 2), from a CFA site to other pixels of the same channel, sorted by distance.

    At equal distances, each offset is followed by the opposite offset.
    """
    down, across = np.mgrid[-SEARCH_PIXELS : SEARCH_PIXELS + 1, -SEARCH_PIXELS : SEARCH_PIXELS + 1].reshape(2, -1)
    same = cfa[(site[0] + down) % cfa.shape[0], (site[1] + across) % cfa.shape[1]] == cfa[site]
    distance = down**2 + across**2
    same &= distance > 0
    down, across, distance = down[same], across[same], distance[same]
    half = (down < 0) | ((down == 0) & (across < 0))
    first_down, first_across = np.where(half, down, -down), np.where(half, across, -across)
    order = np.lexsort((half, first_across, first_down, distance))
    return np.stack([down, across], axis=1)[order].astype(np.int64)


@dataclass(frozen=True, eq=False)
class Correction:
    """The corrections for one camera's frames."""

    camera: str  # name of the camera
    shape: tuple[int, int]  # rows and columns of the camera's frames
    bad_pixels: BadPixelCorrection | None
    shading: Shading | None
    super_pixels: SuperPixelCorrection | None = None

    @property
    def digest(self) -> str:
        """SHA-256 digest of all data in the correction that affect pictures."""
        parts = (self.bad_pixels.target, self.bad_pixels.source) if self.bad_pixels else ()
        gains = (self.shading.gain, self.shading.colour) if self.shading else ()
        coefficients = (self.super_pixels.coefficients,) if self.super_pixels else ()
        content = [each.tobytes() for each in (*parts, *gains, *coefficients) if each is not None]
        return hashlib.sha256(repr(self.shape).encode() + b"".join(content)).hexdigest()

    def corrected(self, frame: RawFrame) -> RawFrame:
        """Return the frame with bad pixels replaced, polarisers of single pixels corrected, and the shading gain added.

        The flat field takes precedence over a shading correction in the raw file. Raises InputFileError if the frame is not
        a full frame from this camera.
        """
        if frame.values.shape != self.shape or frame.phase != (0, 0):
            raise InputFileError(
                f"{frame.name} has {_size(frame.values.shape)} pixels and starts at CFA site "
                f"{frame.phase[0]},{frame.phase[1]}, but a full frame from camera {self.camera} has {_size(self.shape)} "
                "pixels and starts at CFA site 0,0; set ‹camera› to the camera that took the frame"
            )
        values = frame.values if self.bad_pixels is None else self.bad_pixels.corrected(frame.values)
        if self.super_pixels is not None:
            values = self.super_pixels.corrected(values, frame.black_level + frame.dark, frame.white_level)
        return replace(frame, values=values, shading=self.shading or frame.shading)


def correction_of(camera: CameraModel) -> Correction:
    """Return the corrections for a camera's frames.

    Raises InputFileError if the camera has no defect map, no flat field and no polariser field, or if too many
    pixels are defective.
    """
    if camera.defects is None and camera.flat_field is None and camera.polariser_field is None:
        raise InputFileError(
            f"camera {camera.name} has no defect map, no flat field and no polariser field; calibrate the camera with dark "
            "frames, white frames or, if its pixels have polarisers, frames of a rotating polariser"
        )
    shape, bad_pixels = (camera.rows, camera.cols), None
    if camera.defects is not None and camera.defects.position.size:
        bad = np.zeros(shape, bool)
        bad[tuple(camera.defects.position.T)] = True
        bad_pixels = plan_correction(bad, camera.cfa)
    shading = None if camera.flat_field is None else shading_of(camera.flat_field, shape, camera.cfa)
    return Correction(camera.name, shape, bad_pixels, shading, plan_super_pixels(camera))


def _size(shape: tuple[int, ...]) -> str:
    return "×".join(map(str, shape))


@dataclass(frozen=True)
class HotTest:
    """Finds and replaces hot pixels in a frame, based on the camera's noise model.

    The noise variance is constant + (linear + quadratic · signal) · signal, with the signal in DN above black.
    """

    constant: float  # DN²
    linear: float  # DN
    quadratic: float
    span: float  # DN; difference between white and black level
    period: tuple[int, int]  # rows and columns of the CFA

    @classmethod
    def of(cls, camera: CameraModel) -> "HotTest":
        """Return the test for a camera. The noise of the noisiest channel is assumed for all channels."""
        rows, cols = camera.cfa.shape
        constant, linear, quadratic = camera.noise_terms(channel=np.arange(len(camera.channels)))
        noisiest = float(np.max(constant)), float(np.max(linear))  # the terms differ between channels with different gains
        return cls(*noisiest, quadratic, camera.white_level - camera.black_level, (rows, cols))

    def without_hot(self, frame: RawFrame, cfa: NDArray[np.uint8]) -> RawFrame:
        """Return the frame with hot pixels replaced.

        A hot pixel is far brighter than the eight nearest pixels at the same CFA site, but its adjacent pixels are not
        brighter than usual. In contrast, a star or any other small detail also brightens adjacent pixels. Frames with a
        height or width of at most two CFA periods are returned unchanged.

        Parameters
        ----------
        frame : RawFrame
            Frame of the camera.
        cfa : ndarray, (cfa_row, cfa_col)
            Channel of each site, starting with the site of the frame's first pixel.
        """
        if min(frame.values.shape) <= 2 * max(self.period):
            return frame
        row, col = self._suspects(frame)
        if row.size:
            row, col = self._isolated(frame, row, col)
        if not row.size:
            return frame
        hot = np.zeros(frame.values.shape, bool)
        hot[row, col] = True
        return replace(frame, values=plan_correction(hot, cfa).corrected(frame.values))

    def _suspects(self, frame: RawFrame) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the rows and columns of pixels that are much brighter than all eight neighbours of the same CFA site.

        The difference exceeds MIN_EXCESS times the standard deviation of the dark noise.
        """
        values, (down, across) = frame.values, self.period
        brightest = np.zeros_like(values)  # maximum of the left and right neighbours
        np.maximum(brightest[:, across:], values[:, :-across], out=brightest[:, across:])
        np.maximum(brightest[:, :-across], values[:, across:], out=brightest[:, :-across])
        line = np.maximum(brightest, values)
        np.maximum(brightest[down:], line[:-down], out=brightest[down:])
        np.maximum(brightest[:-down], line[down:], out=brightest[:-down])
        least = int(MIN_EXCESS * np.sqrt(self._variance(frame, np.zeros(1))[0]))
        np.minimum(brightest, np.uint16(65535 - least), out=brightest)
        brightest += np.uint16(least)
        row, col = np.divmod(np.flatnonzero(values > brightest), values.shape[1])
        return row, col

    def _isolated(
        self, frame: RawFrame, row: NDArray[np.intp], col: NDArray[np.intp]
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the rows and columns of the hot pixels among the suspects at `row` and `col`."""
        neighbours = self._neighbours(frame, row, col)
        brightest, darkest = neighbours.max(axis=0), neighbours.min(axis=0)
        excess = frame.values[row, col] - brightest
        isolated = excess > np.maximum(MIN_EXCESS * np.sqrt(self._variance(frame, brightest)), RANGE * (brightest - darkest))
        row, col, excess = row[isolated], col[isolated], excess[isolated]
        rows, cols = frame.values.shape
        brighter, variance = np.zeros(row.size), np.zeros(row.size)
        for down, across in AROUND:
            place = np.clip(row + down, 0, rows - 1), np.clip(col + across, 0, cols - 1)
            usual = np.median(self._neighbours(frame, *place), axis=0)
            inside = (place[0] != row) | (place[1] != col)
            brighter += np.where(inside, frame.values[place] - usual, 0.0)
            # The variance of the median of eight pixels is about 0.2 times the variance of a pixel.
            variance += np.where(inside, 1.2 * self._variance(frame, usual), 0.0)
        hot = brighter < np.maximum(NEXT_SIGMAS * np.sqrt(variance), NEXT_SHARE * excess)
        return row[hot], col[hot]

    def _neighbours(self, frame: RawFrame, row: NDArray[np.intp], col: NDArray[np.intp]) -> Array:
        """Return the values, (neighbour, pixel), in DN, of the eight nearest pixels at the same CFA site.

        Neighbours outside the frame are replaced by pixels at twice the distance on the opposite side.
        """
        rows, cols = frame.values.shape
        down, across = self.period
        values = []
        for by_row, by_col in AROUND:
            other_row, other_col = row + by_row * down, col + by_col * across
            other_row = np.where((other_row < 0) | (other_row >= rows), row - 2 * by_row * down, other_row)
            other_col = np.where((other_col < 0) | (other_col >= cols), col - 2 * by_col * across, other_col)
            values.append(frame.values[other_row, other_col].astype(np.float64))
        return np.array(values)

    def _variance(self, frame: RawFrame, level: Array) -> Array:
        """Return the noise variance, in DN², of pixels with a mean value of `level` DN."""
        scale = self.span / (frame.white_level - frame.black_level)
        signal = np.maximum((level - frame.black_level) * scale, 0.0)
        return np.asarray((self.constant + (self.linear + self.quadratic * signal) * signal) / scale**2)


@dataclass(frozen=True)
class DarkFrame:
    """The mean of several raw frames that were exposed without light."""

    name: str
    level: float  # DN; mean over all pixels except hot pixels
    offset: NDArray[np.int32]  # (row, col) DN; difference between each pixel and `level`, shrunk because of noise
    phase: tuple[int, int]  # CFA row and column of the first pixel
    orientation: int  # as in RawFrame
    exposure: float | None  # exposure time in s; None if unknown

    @property
    def digest(self) -> str:
        """SHA-256 digest of all data in the dark frame that affect pictures."""
        return hashlib.sha256(repr(self.level).encode() + self.offset.tobytes()).hexdigest()


def average_dark(frames: Iterable[RawFrame]) -> DarkFrame:
    """Average dark frames, which must have the same size, phase, orientation and exposure time.

    The noise in the mean of n frames is 1/√n of one frame's noise, and would be added to every picture. The difference d
    between a pixel and the mean level is therefore shrunk to d · max(0, 1 − σ²/d²), where σ is the standard deviation of
    the noise in the mean (non-negative garrote, Breiman 1995). A few dark frames are then enough to remove hot pixels almost
    completely. Weak patterns are removed better with more frames. σ is estimated from the differences between consecutive
    frames or, if there is only one frame, from the spread of its pixels.

    Raises
    ------
    InputFileError
        If the frames differ in size, phase, orientation or exposure time, if the mean level is clipped, or if there are no
        frames.
    """
    kind: tuple[object, ...] = ()
    first, total, squares, count = None, np.zeros(1), 0.0, 0
    for frame in frames:
        values = frame.values.astype(np.float64)
        of_kind = values.shape, frame.phase, frame.orientation, frame.exposure
        if first is None:
            first, kind, total = frame, of_kind, np.zeros_like(values)
            earlier = values
        elif of_kind != kind:
            raise InputFileError(
                f"the dark frames {frame.name} and {first.name} differ in size, CFA phase, orientation or exposure time; "
                "use dark frames from one series"
            )
        else:
            squares += _spread(values - earlier) ** 2 / 2  # noise variance of one frame
            earlier = values
        total += values
        count += 1
    if first is None:
        raise InputFileError("‹dark› contains no frames; set it to at least one dark frame")
    mean = total / count
    middle, spread = float(np.median(mean)), _spread(mean)
    level = float(mean[np.abs(mean - middle) <= HOT * spread + 0.5].mean())
    if not level < first.black_level + CLIPPED * (first.white_level - first.black_level):
        raise InputFileError(
            f"nearly all pixels of the dark frame {first.name} are clipped; set ‹dark› to frames that were taken without "
            "light"
        )
    variance = squares / (count - 1) / count if count > 1 else spread**2
    deviation = mean - level
    with np.errstate(divide="ignore", invalid="ignore"):
        remaining = np.where(deviation**2 > variance, deviation - variance / deviation, 0.0)
    offset = np.rint(remaining).astype(np.int32)
    return DarkFrame(first.name, level, offset, first.phase, first.orientation, first.exposure)


def without_dark(frame: RawFrame, dark: DarkFrame) -> RawFrame:
    """Subtract the pattern of a dark frame from a frame.

    Only the differences from the dark frame's mean level are subtracted. The mean level above black is stored as
    `RawFrame.dark`. Clipped pixels stay unchanged. The exposure times must agree within 2 %, unless one of them is unknown.

    Raises
    ------
    InputFileError
        If the frames differ in size, phase, orientation or exposure time, or if the dark level reaches the white level.
    """
    if dark.offset.shape != frame.values.shape or (dark.phase, dark.orientation) != (frame.phase, frame.orientation):
        raise InputFileError(
            f"the dark frame {dark.name} ({_size(dark.offset.shape)} pixels) does not match {frame.name} "
            f"({_size(frame.values.shape)} pixels); use a dark frame from the same camera, with the same size, CFA phase "
            "and orientation"
        )
    if dark.exposure and frame.exposure and not math.isclose(dark.exposure, frame.exposure, rel_tol=0.02):
        raise InputFileError(
            f"the dark frame {dark.name} has an exposure time of {dark.exposure:.4g} s, but {frame.name} has "
            f"{frame.exposure:.4g} s; use dark frames with the same exposure time"
        )
    span = frame.white_level - frame.black_level
    mean = dark.level - frame.black_level
    if not mean < span:
        raise InputFileError(
            f"the mean level of the dark frame {dark.name} reaches the white level {frame.white_level:g} of {frame.name}; "
            "use a dark frame with the same black and white levels"
        )
    clipped = frame.values >= frame.black_level + CLIPPED * span
    values = np.clip(frame.values.astype(np.int32) - dark.offset, 0, np.iinfo(np.uint16).max).astype(np.uint16)
    return replace(frame, values=np.where(clipped, frame.values, values), dark=mean, dark_measured=True)


def _spread(values: NDArray[np.float64]) -> float:
    """Estimate the standard deviation robustly, so that hot pixels do not affect it."""
    return MAD * float(np.median(np.abs(values - np.median(values))))


@dataclass(frozen=True)
class CameraFile:
    """A file that contains a camera model."""

    path: Path  # absolute, because workers may have a different working directory
    digest: str  # SHA-256


def correction_in(file: CameraFile, table: "TransformTable") -> Correction:
    """Read the corrections from a camera model file.

    Raises InputFileError if the file contains no corrections, or if the camera's CFA differs from the table's.
    """
    camera = _camera_of(file)
    if camera.channels != table.channels or not np.array_equal(camera.cfa, table.cfa):
        theirs, ours = ("/".join(array_rows(each.channels, each.cfa)) for each in (camera, table))
        raise InputFileError(
            f"{file.path.name} has the colour filter array {theirs}, but the table has {ours}; use the camera for which the "
            "table was trained"
        )
    return correction_of(camera)


@functools.lru_cache(1)
def correction_again(file: CameraFile) -> Correction:
    """Read the corrections again in a worker process. The result is cached for all frames in a run.

    Raises InputFileError if the file has changed since the main process read it.
    """
    require_same(file.path, file.digest)
    return correction_of(_camera_of(file))


def _camera_of(file: CameraFile) -> CameraModel:
    """Load the camera model from a file that is either a camera model or a transform table.

    Raises InputFileError if the file is a table that does not contain its camera model.
    """
    with open_artifact(file.path, CameraModel, TransformTable) as root:
        kind = str(root.attrs["kind"])
    if kind == CameraModel.kind:
        return load(CameraModel, file.path)
    camera = load(TransformTable, file.path).camera
    if camera is None:
        raise InputFileError(f"the transform table {file.path} does not contain a camera model; use a camera model instead")
    return camera


def hot_test(table: "TransformTable") -> HotTest:
    """Return the hot-pixel test for a table's camera. Raises RecipeError if the table contains no camera model."""
    if table.camera is None:
        raise RecipeError("‹hot› needs the camera's noise model, which this table does not contain; train the table again")
    return HotTest.of(table.camera)
