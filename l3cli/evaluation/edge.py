"""Sharpness by a slanted edge, as ISO 12233 (e-SFR) takes it (docs/measurement.md#sharpness)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
BINS = 4  # of the edge profile, a pixel
REACH = 48.0  # pixels of the profile on either side of the edge: a lens spreads light as far
TAPER = 8.0  # pixels at either end within which the profile's slope fades
SEARCHED = 6.0  # pixels on either side of a first line within which each row's edge is sought
TOP = 1.0  # cycles/pixel up to which a curve goes
HALF = 0.5
SIZE = int(2 * REACH * BINS)  # bins
FREQUENCIES = np.fft.rfftfreq(2 * SIZE, 1 / BINS)
FREQUENCIES = FREQUENCIES[FREQUENCIES <= TOP]  # (sample) cycles/pixel of every curve


class EdgeError(ValueError):
    """A plane without an edge that can be measured."""


@dataclass(frozen=True)
class Sharpness:
    """Modulation transfer across an edge."""

    frequency: Array  # (sample) cycles/pixel across the edge, from 0
    transfer: Array  # (sample), 1 at frequency 0
    angle: float  # degrees of the edge from the columns of the plane

    @property
    def mtf50(self) -> float | None:
        """Return the lowest frequency in cycles/pixel at which the transfer is a half; None if it stays above."""
        below = np.flatnonzero(self.transfer < HALF)
        if not below.size:
            return None
        at = np.s_[below[0] - 1 : below[0] + 1]
        return float(np.interp(-HALF, -self.transfer[at], self.frequency[at]))


def edge_sharpness(plane: Array) -> Sharpness:
    """Return the sharpness across a straight edge, 2° to 15° from the vertical, in a plane (row, col) linear in light.

    Each row's edge is the centroid of its slope, and a line through all of them the edge; pixels are averaged in quarters of
    a pixel's distance from it, and the spectrum of that profile's slope, corrected for what bins and differences take, is
    the transfer. EdgeError if the plane holds no such edge.
    """
    plane = np.asarray(plane, np.float64)
    slope = np.abs(np.diff(plane, axis=1))
    rows, place = np.arange(len(plane)), np.arange(slope.shape[1]) + 0.5
    if not slope.sum(axis=1).min() > 0:
        raise EdgeError("no edge crosses every row of the plane")
    line, reach = np.array([0.0, slope.sum(axis=0) @ place / slope.sum()]), np.inf
    for _ in range(4):
        weight = np.where(np.abs(place - np.polyval(line, rows)[:, None]) < reach, slope, 0.0)
        crossed = weight.any(axis=1)
        if crossed.sum() < len(rows) / 2:
            raise EdgeError("no straight edge crosses the rows of the plane")
        at = (weight[crossed] @ place) / weight[crossed].sum(axis=1)
        line, reach = np.polyfit(rows[crossed], at, 1), SEARCHED
    angle = np.arctan(line[0])
    if not 2.0 <= abs(np.degrees(angle)) <= 15.0:
        raise EdgeError(f"the edge is {abs(np.degrees(angle)):.2g}° from the vertical, not 2° to 15°")
    turns = int(len(rows) * abs(line[0]))  # times that the edge passes from one column to the next
    rows = rows[: round(turns / abs(line[0]))]  # in as many rows all phases occur alike
    distance = (np.arange(plane.shape[1]) - np.polyval(line, rows)[:, None]) * np.cos(angle)
    inside = np.abs(distance) < REACH
    number = np.floor((distance[inside] + REACH) * BINS).astype(int)
    count = np.bincount(number, minlength=SIZE)
    if not count.min():
        raise EdgeError(f"the plane does not reach {REACH:g} pixels beyond the edge on both sides in every phase")
    profile = np.bincount(number, plane[: len(rows)][inside], SIZE) / count
    ends = np.minimum(np.arange(1, SIZE), np.arange(1, SIZE)[::-1]) / (TAPER * BINS)
    spread = np.diff(profile) * np.sin(np.pi / 2 * np.minimum(ends, 1.0)) ** 2
    spectrum = np.abs(np.fft.rfft(spread, 2 * SIZE))[: FREQUENCIES.size]
    return Sharpness(FREQUENCIES, spectrum / spectrum[0] / np.sinc(FREQUENCIES / BINS) ** 2, float(np.degrees(angle)))
