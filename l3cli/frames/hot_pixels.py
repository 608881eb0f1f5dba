"""Hot pixels that no map lists, found in a frame by their neighbours and the noise model (docs/method.md#corrections)."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.frames.correction import plan_correction
from l3cli.frames.frame import RawFrame

LEAST = 8.0  # standard deviations by which a hot pixel is above the brightest of its neighbours
RANGE = 2.0  # times the range of its neighbours by which it is above the brightest
NEXT_SIGMAS, NEXT_SHARE = 2.0, 0.1  # how much brighter the pixels next to it may be: noise, share of its excess
AROUND = [(row, col) for row in (-1, 0, 1) for col in (-1, 0, 1) if (row, col) != (0, 0)]
Array = NDArray[np.float64]


@dataclass(frozen=True)
class HotTest:
    """The noise of a camera: variance = constant + (linear + quadratic · signal) · signal, in DN above black."""

    constant: float  # DN²
    linear: float  # DN
    quadratic: float
    span: float  # DN from black to white level
    period: tuple[int, int]  # rows, columns of the array

    @classmethod
    def of(cls, camera: CameraModel) -> "HotTest":
        """By the noise model of a camera."""
        rows, cols = camera.cfa.shape
        constant, linear, quadratic = camera.noise_terms(channel=np.arange(len(camera.channels)))
        noisiest = float(np.max(constant)), float(np.max(linear))  # of channels of different gains
        return cls(*noisiest, quadratic, camera.white_level - camera.black_level, (rows, cols))

    def without_hot(self, frame: RawFrame, cfa: NDArray[np.uint8]) -> RawFrame:
        """Return the frame with its hot pixels corrected; `cfa` is the array from its first pixel on.

        A hot pixel is far above the eight nearest pixels of its CFA site, and its neighbours of any channel are not: a star
        or another detail that a lens has drawn brightens those, too.
        """
        if min(frame.values.shape) <= 2 * max(self.period):
            return frame  # too few neighbours
        row, col = self._suspects(frame)
        if row.size:
            row, col = self._isolated(frame, row, col)
        if not row.size:
            return frame
        hot = np.zeros(frame.values.shape, bool)
        hot[row, col] = True
        return replace(frame, values=plan_correction(hot, cfa).corrected(frame.values))

    def _suspects(self, frame: RawFrame) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the rows and columns of pixels above all their neighbours by more than the least noise allows."""
        values, (down, across) = frame.values, self.period
        brightest = np.zeros_like(values)  # the brightest to the left and right
        np.maximum(brightest[:, across:], values[:, :-across], out=brightest[:, across:])
        np.maximum(brightest[:, :-across], values[:, across:], out=brightest[:, :-across])
        line = np.maximum(brightest, values)
        np.maximum(brightest[down:], line[:-down], out=brightest[down:])
        np.maximum(brightest[:-down], line[down:], out=brightest[:-down])
        least = int(LEAST * np.sqrt(self._variance(frame, np.zeros(1))[0]))
        np.minimum(brightest, np.uint16(65535 - least), out=brightest)
        brightest += np.uint16(least)
        row, col = np.divmod(np.flatnonzero(values > brightest), values.shape[1])
        return row, col

    def _isolated(
        self, frame: RawFrame, row: NDArray[np.intp], col: NDArray[np.intp]
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return those of the suspects that are hot."""
        neighbours = self._neighbours(frame, row, col)
        brightest, darkest = neighbours.max(axis=0), neighbours.min(axis=0)
        excess = frame.values[row, col] - brightest
        isolated = excess > np.maximum(LEAST * np.sqrt(self._variance(frame, brightest)), RANGE * (brightest - darkest))
        row, col, excess = row[isolated], col[isolated], excess[isolated]
        rows, cols = frame.values.shape
        brighter, variance = np.zeros(row.size), np.zeros(row.size)
        for down, across in AROUND:
            place = np.clip(row + down, 0, rows - 1), np.clip(col + across, 0, cols - 1)
            usual = np.median(self._neighbours(frame, *place), axis=0)
            inside = (place[0] != row) | (place[1] != col)
            brighter += np.where(inside, frame.values[place] - usual, 0.0)
            variance += np.where(inside, 1.2 * self._variance(frame, usual), 0.0)  # 0.2: of a median of eight
        hot = brighter < np.maximum(NEXT_SIGMAS * np.sqrt(variance), NEXT_SHARE * excess)
        return row[hot], col[hot]

    def _neighbours(self, frame: RawFrame, row: NDArray[np.intp], col: NDArray[np.intp]) -> Array:
        """Return the DN (neighbour, pixel) of the eight nearest pixels of each pixel's CFA site; past an edge those on
        the other side."""
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
        """DN² of pixels at `level` DN."""
        scale = self.span / (frame.white_level - frame.black_level)
        signal = np.maximum((level - frame.black_level) * scale, 0.0)
        return np.asarray((self.constant + (self.linear + self.quadratic * signal) * signal) / scale**2)
