"""Pictures of XYZ in a colour space: matrix, gamut, curve and rounding (docs/method.md#display)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import GREY, TransformTable
from l3cli.errors import RecipeError
from l3cli.physics.display import CODES, Tone, codes, display_white
from l3cli.physics.gamut import gamut_of, into_gamut
from l3cli.physics.spaces import SRGB, Curve, Space, adaptation_matrix

MOST_LAYERS = 4


@dataclass(frozen=True)
class Display:
    """Everything between XYZ and the picture, the last stage of rendering.

    code = top · curve(clip(tone(gamut(matrix @ XYZ)), 0, 1)), rounded.
    """

    matrix: NDArray[np.float64]  # (3, 3) linear values from XYZ, adaptation and exposure scale folded in
    bits: int  # of a code, a key of CODES
    space: Space = SRGB  # with a curve
    tone: Tone | None = None  # None: linear values as they are

    def __post_init__(self) -> None:
        if self.matrix.shape != (3, 3) or not np.isfinite(self.matrix).all() or self.bits not in CODES:
            raise ValueError("a display has a finite 3×3 matrix and 8 or 16 bits")
        if self.space.curve is None:
            raise ValueError(f"{self.space.title} is linear and has no codes")

    @property
    def curve(self) -> Curve:
        """Return the transfer curve of the space."""
        assert self.space.curve is not None
        return self.space.curve

    @property
    def top(self) -> int:
        """Return the code of 1."""
        return 2**self.bits - 1

    @property
    def dtype(self) -> np.dtype:
        return np.dtype(CODES[self.bits])


def make_display(white: NDArray[np.floating], scale: float, bits: int, space: Space = SRGB) -> Display:
    """Return a display that shows `scale` · XYZ of a scene whose white is `white` (3) in a space that has a curve, adapted
    so that this white becomes that of the space; RecipeError if white or scale is not positive."""
    if not np.all(np.asarray(white) > 0):
        raise RecipeError("scene white and exposure must be positive")
    return adapted_display(adaptation_matrix(white, display_white()), scale, bits, space)


def adapted_display(
    adaptation: NDArray[np.floating], scale: float, bits: int, space: Space = SRGB, tone: Tone | None = None
) -> Display:
    """Return a display that shows `scale` · `adaptation` (3, 3) @ XYZ of a scene, adapted to D65, in a space that has a
    curve, through a tone curve; RecipeError if the scale is not positive."""
    return Display(linear_matrix(adaptation, scale, space), bits, space, tone)


def linear_matrix(adaptation: NDArray[np.floating], scale: float, space: Space) -> NDArray[np.float64]:
    """Return linear values of a space = M (3, 3) @ XYZ of a scene: `scale` · `adaptation` (3, 3) to D65, and from there to
    what the space shows as white; RecipeError if the scale is not positive."""
    if not (np.isfinite(scale) and scale > 0):
        raise RecipeError("scene white and exposure must be positive")
    daylight, neutral = display_white(), space.neutral_xyz
    own = np.eye(3) if np.array_equal(daylight, neutral) else adaptation_matrix(daylight, neutral)
    return np.asarray(space.from_xyz @ (own @ (scale * adaptation)), np.float64)


def require_xyz(outputs: tuple[str, ...]) -> None:
    """Raise RecipeError unless a table's outputs are what a picture is made from: X, Y, Z, or GREY."""
    if outputs not in (("X", "Y", "Z"), GREY):
        raise RecipeError(
            f"pictures need the outputs X, Y, Z, or Y alone, this table has {', '.join(outputs)}; write an .exr file"
        )


def shown_adaptation(table: TransformTable, adaptation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how the outputs of a table are adapted to D65.

    Parameters
    ----------
    table : TransformTable
        The table.
    adaptation : ndarray, (3, 3)
        XYZ under D65 of the table's X, Y, Z, by the white of the scene.

    Returns
    -------
    ndarray, (3, 3)
        `adaptation`; of a table that shows grey, the white of D65 times the second output, Y. Values of a picture are then
        equal, to the bit.
    """
    return np.outer(display_white(), [0.0, 1.0, 0.0]) if table.shows_grey else adaptation


def require_known_layers(table: TransformTable) -> None:
    """Raise RecipeError for a table of more layers than renderers know."""
    if len(table.layers) > MOST_LAYERS:
        raise RecipeError(
            f"this table has {len(table.layers)} layers, and {MOST_LAYERS} at most can be rendered; train it again"
        )


def encode(planes: NDArray, display: Display) -> NDArray:
    """Return XYZ planes (output, row, col) as the display's codes (row, col, 3), computed in float64."""
    linear = np.einsum("po,orc->rcp", display.matrix, planes.astype(np.float64))
    within = into_gamut(linear, gamut_of(display.space), bounded=display.tone is None)
    shown = within if display.tone is None else display.tone.toned(within)
    return codes(display.curve.encoded(shown), display.bits)
