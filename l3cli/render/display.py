"""From XYZ to what a screen shows: adaptation to D65, exposure scale, sRGB primaries, clip, sRGB curve (METHOD 5)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli import spectra
from l3cli.errors import RecipeError

WHITE_PERCENTILE = 99  # of Y, that automatic exposure maps to display white, as the authors did
BITS = (8, 16)


@dataclass(frozen=True)
class Display:
    """Everything between XYZ and encoded sRGB: value = round((2^bits − 1) · curve(clip(matrix @ XYZ, 0, 1)))."""

    matrix: NDArray[np.float64]  # (3, 3) linear sRGB from XYZ, adaptation and exposure scale folded in
    bits: int  # of each encoded value

    def __post_init__(self) -> None:
        if self.matrix.shape != (3, 3) or not np.isfinite(self.matrix).all() or self.bits not in BITS:
            raise ValueError("a display has a finite 3×3 matrix and 8 or 16 bits")

    @property
    def top(self) -> int:
        return 2**self.bits - 1

    @property
    def dtype(self) -> np.dtype:
        return np.dtype(np.uint8 if self.bits == 8 else np.uint16)


def make_display(white: NDArray[np.floating], scale: float, bits: int) -> Display:
    """A display that shows `scale` · XYZ of a scene whose white is `white` (3), so that this white becomes neutral.

    RecipeError if white or scale is not positive.
    """
    if not (np.all(np.asarray(white) > 0) and np.isfinite(scale) and scale > 0):
        raise RecipeError("scene white and exposure must be positive")
    primaries = spectra.srgb_from_xyz_matrix()
    display_white = np.linalg.solve(primaries, np.ones(3))
    matrix = scale * primaries @ spectra.adaptation_matrix(white, display_white)
    return Display(np.asarray(matrix, np.float64), bits)


def automatic_exposure(luminance: NDArray) -> float:
    """Scale that brings the 99th percentile of Y (row, col) to display white; 1 where all is dark."""
    bright = float(np.percentile(luminance, WHITE_PERCENTILE))
    return 1.0 / bright if bright > 0 else 1.0


def scene_white(text: str) -> NDArray[np.float64]:
    """XYZ (3), Y = 1, of a white given as "x,y" chromaticity or by the name of an illuminant; RecipeError if neither."""
    if "," not in text:
        return np.asarray(spectra.white_point(text), np.float64)
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise RecipeError(f'white "{text}" is not a chromaticity; give it as x,y such as 0.3127,0.3290') from None
    if not (x > 0 and y > 0 and x + y < 1):
        raise RecipeError(f"white {text} is no chromaticity: x and y must be positive and x + y below 1")
    return np.array([x, y, 1 - x - y]) / y


def require_xyz(outputs: tuple[str, ...]) -> None:
    """RecipeError unless a table's outputs are X, Y, Z, which is what a picture is made from."""
    if outputs != ("X", "Y", "Z"):
        raise RecipeError(f"pictures need the outputs X, Y, Z, this table has {', '.join(outputs)}; write an .exr file")


def encode(planes: NDArray, display: Display) -> NDArray:
    """XYZ planes (output, row, col) as sRGB (row, col, 3) of the display's depth, in float64."""
    linear = np.einsum("po,orc->rcp", display.matrix, planes.astype(np.float64))
    return np.floor(spectra.srgb_curve(linear) * display.top + 0.5).astype(display.dtype)
