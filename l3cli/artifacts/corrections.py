"""Corrections of a camera's frames that no table learns: the map of defective pixels, and the light that the lens loses
towards the corners (docs/method.md#corrections)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.schema import data

KINDS = ("hot", "dead", "row", "column")  # of a defective pixel; the last two: all of its line is defective
MOST_GAIN = 16.0  # of a pixel that gets a sixteenth of the light in the middle
MOST_COLOUR_SHADING = 0.5  # by which a channel's gain may differ from the mean of all, relative


@dataclass(frozen=True)
class DefectMap:
    """Pixels whose values say nothing of the light."""

    position: NDArray[np.int64] = data("int64", "bad_pixel", "coordinate", unit="pixel", doc="row, col, each pixel once")
    pixel_kind: tuple[str, ...] = data("str", "bad_pixel", doc="hot, dead, or of a line that is: row, column")

    def __post_init__(self) -> None:
        if self.position.ndim != 2 or self.position.shape[1] != 2 or self.position.min(initial=0) < 0:
            raise ValueError("defects: position must be rows and columns from 0")
        if len(np.unique(self.position, axis=0)) < len(self.position):
            raise ValueError("defects: a pixel is listed twice")
        if odd := sorted(set(self.pixel_kind) - set(KINDS)):
            raise ValueError(f'defects: "{odd[0]}" is no kind of pixel; known are {", ".join(KINDS)}')


@dataclass(frozen=True)
class FlatField:
    """Gain that makes an even white even, relative to the middle of the frame, channel by channel; linear between the
    lines of a grid that covers the whole sensor."""

    grid_row: NDArray[np.float64] = data("float64", "grid_row", unit="pixel", doc="row of each line", coordinate=True)
    grid_col: NDArray[np.float64] = data("float64", "grid_col", unit="pixel", doc="column of each line", coordinate=True)
    shading_gain: NDArray[np.float64] = data(
        "float64", "channel", "grid_row", "grid_col", doc="gain over that in the middle of the frame"
    )

    def __post_init__(self) -> None:
        for name, lines in (("grid_row", self.grid_row), ("grid_col", self.grid_col)):
            if not (lines.size > 1 and (np.diff(lines) > 0).all()):
                raise ValueError(f"flat field: {name} must be two lines or more that increase")
        gain = self.shading_gain
        if not (gain.size and gain.min() >= 1 / MOST_GAIN and gain.max() <= MOST_GAIN):
            raise ValueError(f"flat field: gains must lie in {1 / MOST_GAIN:g}…{MOST_GAIN:g}; are the whites even?")
        if np.abs(gain / gain.mean(axis=0) - 1.0).max() > MOST_COLOUR_SHADING:
            raise ValueError(
                f"flat field: a channel differs by more than {MOST_COLOUR_SHADING:.0%} from the others; are the whites even?"
            )

    def covers(self, rows: int, cols: int) -> bool:
        """Return whether the grid goes from the first to the last pixel of a sensor."""
        ends = (*self.grid_row[[0, -1]], *self.grid_col[[0, -1]])
        return bool(np.allclose(ends, (0, rows - 1, 0, cols - 1), rtol=0, atol=0.5))
