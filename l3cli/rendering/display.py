"""Convert XYZ to pictures in a colour space (docs/method.md#display).

The steps are a matrix, gamut mapping, an optional tone curve, the transfer curve, and rounding to integer codes.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import GREY, TransformTable
from l3cli.errors import RecipeError
from l3cli.physics.display import CODES, Tone, codes, display_white
from l3cli.physics.gamut import gamut_of, into_gamut
from l3cli.physics.spaces import SRGB, Curve, Space, adaptation_matrix
from l3cli.physics.stokes import STOKES

MAX_LAYERS = 4  # the renderers support at most this number of layers


@dataclass(frozen=True)
class Display:
    """Settings for converting XYZ to the integer codes of a picture.

    code = round(top · curve(clip(tone(gamut(matrix @ XYZ)), 0, 1)))
    """

    matrix: NDArray[np.float64]  # (3, 3) converts XYZ to linear values; includes chromatic adaptation and exposure
    bits: int  # bits per code, 8 or 16
    space: Space = SRGB  # must have a transfer curve
    tone: Tone | None = None

    def __post_init__(self) -> None:
        if self.matrix.shape != (3, 3) or not np.isfinite(self.matrix).all() or self.bits not in CODES:
            raise ValueError("a display needs a finite 3×3 matrix and 8 or 16 bits")
        if self.space.curve is None:
            raise ValueError(f"{self.space.title} is a linear colour space and cannot be stored as integers")

    @property
    def curve(self) -> Curve:
        """Transfer curve of the colour space."""
        assert self.space.curve is not None
        return self.space.curve

    @property
    def top(self) -> int:
        """Highest code."""
        return 2**self.bits - 1

    @property
    def dtype(self) -> np.dtype:
        return np.dtype(CODES[self.bits])


def make_display(white: NDArray[np.floating], scale: float, bits: int, space: Space = SRGB) -> Display:
    """Return display settings that map a scene's white to the white of a colour space.

    Parameters
    ----------
    white : ndarray, (3,)
        XYZ of the scene's white.
    scale : float
        Exposure scale, by which XYZ is multiplied.
    bits : int
        Bits per code, 8 or 16.
    space : Space
        Colour space with a transfer curve.

    Returns
    -------
    Display

    Raises
    ------
    RecipeError
        If the white or the exposure scale is not positive.
    """
    if not np.all(np.asarray(white) > 0):
        shown = ", ".join(f"{each:.4g}" for each in white)
        raise RecipeError(f"the scene white has the XYZ {shown}; use a white with positive X, Y and Z")
    return adapted_display(adaptation_matrix(white, display_white()), scale, bits, space)


def adapted_display(
    adaptation: NDArray[np.floating], scale: float, bits: int, space: Space = SRGB, tone: Tone | None = None
) -> Display:
    """Return display settings that include a given chromatic adaptation.

    Parameters
    ----------
    adaptation : ndarray, (3, 3)
        Converts XYZ under the scene illuminant to XYZ under D65.
    scale : float
        Exposure scale, by which XYZ is multiplied.
    bits : int
        Bits per code, 8 or 16.
    space : Space
        Colour space with a transfer curve.
    tone : Tone or None
        Tone curve, if any.

    Returns
    -------
    Display

    Raises
    ------
    RecipeError
        If the exposure scale is not positive.
    """
    return Display(linear_matrix(adaptation, scale, space), bits, space, tone)


def linear_matrix(adaptation: NDArray[np.floating], scale: float, space: Space) -> NDArray[np.float64]:
    """Return the matrix (3, 3) from scene XYZ to linear values of a colour space.

    It combines the exposure `scale`, the `adaptation` to D65, and the adaptation from D65 to the white of the colour space.
    Raises RecipeError if the scale is not positive.
    """
    if not (np.isfinite(scale) and scale > 0):
        raise RecipeError(f"the exposure is {scale:g}, but must be positive; use a positive number")
    daylight, neutral = display_white(), space.neutral_xyz
    own = np.eye(3) if np.array_equal(daylight, neutral) else adaptation_matrix(daylight, neutral)
    return np.asarray(space.from_xyz @ (own @ (scale * adaptation)), np.float64)


def require_xyz(outputs: tuple[str, ...]) -> None:
    """Raise a RecipeError unless the outputs can be shown as a picture.

    This is possible for X, Y and Z (optionally followed by other outputs), for Y alone, and for Stokes parameters.
    """
    if outputs[:3] not in (("X", "Y", "Z"), GREY, STOKES):
        raise RecipeError(
            f"the table has the outputs {', '.join(outputs)}, but pictures need X, Y and Z, or Y alone; write an .exr file"
        )


def shown_adaptation(table: TransformTable, adaptation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the matrix from the outputs of a table to XYZ under D65.

    Parameters
    ----------
    table : TransformTable
        Table that renders the outputs.
    adaptation : ndarray, (3, 3)
        Converts XYZ under the scene illuminant to XYZ under D65.

    Returns
    -------
    ndarray, (3, 3)
        For colour tables, `adaptation`. For monochrome tables, a matrix that converts Y (or S0) to a grey of this luminance,
        with exactly equal R, G and B.
    """
    return np.outer(display_white(), [0.0, 1.0, 0.0]) if table.shows_grey else adaptation


def require_known_layers(table: TransformTable) -> None:
    """Raise a RecipeError if a table has more layers than the renderers support."""
    if len(table.layers) > MAX_LAYERS:
        raise RecipeError(f"the table has {len(table.layers)} layers; train a table with at most {MAX_LAYERS} layers")


def encode(planes: NDArray, display: Display) -> NDArray:
    """Encode X, Y and Z as a picture.

    All steps before rounding are computed in float64.
    """
    linear = np.einsum("po,orc->rcp", display.matrix, planes[:3].astype(np.float64))
    within = into_gamut(linear, gamut_of(display.space), bounded=display.tone is None)
    shown = within if display.tone is None else display.tone.toned(within)
    return codes(display.curve.encoded(shown), display.bits)
