"""From XYZ to what a screen shows: adaptation to D65, exposure scale, sRGB primaries, clip, sRGB curve (METHOD 5)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import RecipeError, suggestion
from l3cli.physics.display import adaptation_matrix, srgb_curve, srgb_from_xyz_matrix

CODES = {8: np.uint8, 16: np.uint16, "half": np.float16, "float": np.float32}  # what a value is written as
SPACES = ("srgb", "linear", "xyz")


@dataclass(frozen=True)
class Display:
    """Everything between XYZ and what is written, the last stage of rendering.

    With the curve, or as integers: value = top · curve(clip(matrix @ XYZ, 0, 1)), integers rounded. Linear half and float
    keep what lies outside 0…1.
    """

    matrix: NDArray[np.float64]  # (3, 3) values from XYZ, adaptation and exposure scale folded in
    bits: int | str  # 8 or 16 of an integer; "half" or "float"
    curved: bool = True  # by the sRGB curve

    def __post_init__(self) -> None:
        if self.matrix.shape != (3, 3) or not np.isfinite(self.matrix).all() or self.bits not in CODES:
            raise ValueError("a display has a finite 3×3 matrix and 8 or 16 bits, half or float")

    @property
    def top(self) -> int:
        """The integer that stands for 1; 0 where values are written as they are."""
        return 2**self.bits - 1 if isinstance(self.bits, int) else 0

    @property
    def dtype(self) -> np.dtype:
        return np.dtype(CODES[self.bits])


def make_display(white: NDArray[np.floating], scale: float, bits: int | str, space: str = "srgb") -> Display:
    """A display that shows `scale` · XYZ of a scene whose white is `white` (3), adapted so that this white becomes that of
    sRGB, D65; in one of SPACES: sRGB, its linear values, or XYZ.

    RecipeError if white or scale is not positive, or the space is none of these.
    """
    if not (np.all(np.asarray(white) > 0) and np.isfinite(scale) and scale > 0):
        raise RecipeError("scene white and exposure must be positive")
    if space not in SPACES:
        raise RecipeError(f'colour space "{space}" is unknown; {suggestion(space, SPACES)}')
    primaries = srgb_from_xyz_matrix()
    display_white = np.linalg.solve(primaries, np.ones(3))
    adapted = scale * adaptation_matrix(white, display_white)
    matrix = adapted if space == "xyz" else primaries @ adapted
    return Display(np.asarray(matrix, np.float64), bits, space == "srgb")


def require_xyz(outputs: tuple[str, ...]) -> None:
    """RecipeError unless a table's outputs are X, Y, Z, which is what a picture is made from."""
    if outputs != ("X", "Y", "Z"):
        raise RecipeError(f"pictures need the outputs X, Y, Z, this table has {', '.join(outputs)}; write an .exr file")


def encode(planes: NDArray, display: Display) -> NDArray:
    """XYZ planes (output, row, col) as the display's values (row, col, 3), in float64."""
    values = np.einsum("po,orc->rcp", display.matrix, planes.astype(np.float64))
    if display.curved:
        values = srgb_curve(values)
    if display.top:
        values = np.floor(np.clip(values, 0.0, 1.0) * display.top + 0.5)
    return values.astype(display.dtype)
