"""Converts XYZ to pictures in a colour space (docs/method.md#display).

The steps are matrix, gamut mapping, tone curve, transfer curve and rounding.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import GREY, TransformTable
from l3cli.errors import RecipeError
from l3cli.physics.display import CODES, Tone, codes, display_white
from l3cli.physics.gamut import gamut_of, into_gamut
from l3cli.physics.spaces import SRGB, Curve, Space, adaptation_matrix

MAX_LAYERS = 4  # largest number of layers that the renderers support


@dataclass(frozen=True)
class Display:
    """The last stage of rendering: conversion of XYZ to the codes of a picture.

    code = top · curve(clip(tone(gamut(matrix @ XYZ)), 0, 1)), rounded
    """

    matrix: NDArray[np.float64]  # (3, 3) from XYZ to linear values, including adaptation and exposure scale
    bits: int  # bits per code; a key of CODES
    space: Space = SRGB  # a colour space with a transfer curve
    tone: Tone | None = None  # None means no tone curve

    def __post_init__(self) -> None:
        if self.matrix.shape != (3, 3) or not np.isfinite(self.matrix).all() or self.bits not in CODES:
            raise ValueError("a display needs a finite 3×3 matrix and 8 or 16 bits")
        if self.space.curve is None:
            raise ValueError(f"{self.space.title} is linear and has no codes")

    @property
    def curve(self) -> Curve:
        """Transfer curve of the space."""
        assert self.space.curve is not None
        return self.space.curve

    @property
    def top(self) -> int:
        """The highest code."""
        return 2**self.bits - 1

    @property
    def dtype(self) -> np.dtype:
        return np.dtype(CODES[self.bits])


def make_display(white: NDArray[np.floating], scale: float, bits: int, space: Space = SRGB) -> Display:
    """Return a display for scenes with a given white.

    Parameters
    ----------
    white : ndarray, (3,)
        XYZ of the scene's white, which becomes the white of the space.
    scale : float
        Exposure scale, a factor on XYZ.
    bits : int
        8 or 16.
    space : Space
        A colour space with a transfer curve.

    Raises
    ------
    RecipeError
        If white or scale is not positive.
    """
    if not np.all(np.asarray(white) > 0):
        raise RecipeError("scene white and exposure must be positive")
    return adapted_display(adaptation_matrix(white, display_white()), scale, bits, space)


def adapted_display(
    adaptation: NDArray[np.floating], scale: float, bits: int, space: Space = SRGB, tone: Tone | None = None
) -> Display:
    """Return a display that shows `scale` · `adaptation` @ XYZ. The adaptation (3, 3) converts the scene white to D65.

    Raises RecipeError if the scale is not positive.
    """
    return Display(linear_matrix(adaptation, scale, space), bits, space, tone)


def linear_matrix(adaptation: NDArray[np.floating], scale: float, space: Space) -> NDArray[np.float64]:
    """Return the matrix M (3, 3) that converts XYZ to linear values of a colour space: values = M @ XYZ.

    It includes the factor `scale`, the `adaptation` (3, 3) to D65, and the adaptation from D65 to the white of the space.
    Raises RecipeError if the scale is not positive.
    """
    if not (np.isfinite(scale) and scale > 0):
        raise RecipeError("scene white and exposure must be positive")
    daylight, neutral = display_white(), space.neutral_xyz
    own = np.eye(3) if np.array_equal(daylight, neutral) else adaptation_matrix(daylight, neutral)
    return np.asarray(space.from_xyz @ (own @ (scale * adaptation)), np.float64)


def require_xyz(outputs: tuple[str, ...]) -> None:
    """Raise RecipeError unless the outputs are X, Y, Z or GREY, from which pictures can be made."""
    if outputs not in (("X", "Y", "Z"), GREY):
        raise RecipeError(
            f"pictures need the outputs X, Y, Z, or Y alone, this table has {', '.join(outputs)}; write an .exr file"
        )


def shown_adaptation(table: TransformTable, adaptation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the matrix that adapts the outputs of a table to D65.

    Parameters
    ----------
    table : TransformTable
    adaptation : ndarray, (3, 3)
        Matrix from the table's X, Y, Z under the white of the scene to XYZ under D65.

    Returns
    -------
    ndarray, (3, 3)
        `adaptation`. If the table renders grey pictures, the matrix returns Y times the D65 white instead, so that R, G and
        B are exactly equal.
    """
    return np.outer(display_white(), [0.0, 1.0, 0.0]) if table.shows_grey else adaptation


def require_known_layers(table: TransformTable) -> None:
    """Raise RecipeError if a table has more layers than renderers support."""
    if len(table.layers) > MAX_LAYERS:
        raise RecipeError(f"this table has {len(table.layers)} layers; train it again with at most {MAX_LAYERS}")


def encode(planes: NDArray, display: Display) -> NDArray:
    """Return XYZ planes (output, row, col) as codes (row, col, 3), computed in float64."""
    linear = np.einsum("po,orc->rcp", display.matrix, planes.astype(np.float64))
    within = into_gamut(linear, gamut_of(display.space), bounded=display.tone is None)
    shown = within if display.tone is None else display.tone.toned(within)
    return codes(display.curve.encoded(shown), display.bits)
