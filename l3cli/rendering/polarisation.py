"""Converts the outputs of polarisation cameras to values in files and to pictures (docs/polarisation.md#pictures)."""

import numpy as np
from numpy.typing import NDArray

from l3cli.frames.frame import upright
from l3cli.physics.display import codes, srgb_curve
from l3cli.physics.stokes import DARKEST, FEATURES, IN_ORDER, STOKES, aolp, dolp, has_stokes, stokes_of

Floats = NDArray[np.floating]

SHOWN = ("dolp", "aolp", "stokes")  # pictures that l3 can make of Stokes parameters
FULL_BRIGHTNESS = 0.5  # smallest degree of polarisation with full brightness in a picture of the angle
BAR_FRACTION, MIN_BAR_PIXELS = 0.03, 6  # width of the colour bar and of the gap beside it, relative to the picture's width
TICKS = 4  # number of intervals into which ticks divide a colour bar
# sRGB values of the colour map viridis (CC0, Smith and van der Walt, 2015) at equal distances
VIRIDIS = np.array(
    [(68, 1, 84), (71, 44, 122), (59, 81, 139), (44, 113, 142), (33, 144, 141), (39, 173, 129), (92, 200, 99),
     (170, 220, 50), (253, 231, 37)]
) / 255.0  # fmt: skip
# sRGB values of a map for signed values: blue, white for 0, red
DIVERGING = np.array([(33, 102, 172), (146, 197, 222), (247, 247, 247), (244, 165, 130), (178, 24, 43)]) / 255.0


def in_upright_frame(planes: Floats, outputs: tuple[str, ...], orientation: int) -> Floats:
    """Turn outputs (output, row, col) upright, according to a flip code of LibRaw (`frames.frame.upright`).

    Angles of polarisation become relative to the horizontal axis of the upright picture. Mirroring a picture changes the
    sign of S2, and transposing a picture changes the sign of S1.
    """
    turned = np.moveaxis(upright(np.moveaxis(planes, 0, -1), orientation), -1, 0)
    if has_stokes(outputs) and orientation:
        turned = turned.copy()
        if (orientation & 1) != (orientation >> 1 & 1):
            turned[outputs.index("S2")] *= -1
        if orientation & 4:
            turned[outputs.index("S1")] *= -1
    return turned


def names_in_files(outputs: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the values in a linear file: S0, S1 and S2, followed by DoLP and AoLP.

    The names are `outputs` if the outputs are not Stokes parameters.
    """
    if not has_stokes(outputs):
        return outputs
    return (IN_ORDER if outputs == STOKES else outputs) + FEATURES


def planes_in_files(planes: Floats, outputs: tuple[str, ...]) -> Floats:
    """Return the values (value, row, col) of a linear file, in the order of `names_in_files`.

    `planes` (output, row, col) are the outputs of a table. DoLP is between 0 and 1, and AoLP is in degrees.
    """
    if not has_stokes(outputs):
        return planes
    stokes = stokes_of(planes, outputs)
    own = stokes if outputs == STOKES else planes
    return np.concatenate([own, [dolp(stokes), aolp(stokes)]]).astype(planes.dtype)


def picture_of(planes: Floats, outputs: tuple[str, ...], shown: str, bits: int) -> NDArray:
    """Return a picture of the Stokes parameters, with a colour bar at its right side.

    Parameters
    ----------
    planes : ndarray, (output, row, col)
        Outputs of a table.
    outputs : tuple of str
        Names of the outputs.
    shown : str
        "dolp": the degree of polarisation from 0 to 1, in the colours of viridis. "aolp": the angle as the hue, from 0°
        (red) to 180°, and the degree as the brightness. "stokes": S0 in greys, and beside it S1/S0 and S2/S0 from −1 (blue)
        to 1 (red).
    bits : int
        Bits per value, 8 or 16.

    Returns
    -------
    ndarray, (row, col, 3)
        sRGB codes.
    """
    stokes = stokes_of(planes, outputs).astype(np.float64)
    rows = stokes.shape[1]
    scale = np.linspace(1, 0, rows)[:, None]
    if shown == "dolp":
        picture, bar = coloured(dolp(stokes), VIRIDIS), coloured(scale, VIRIDIS)
    elif shown == "aolp":
        picture = _hues(aolp(stokes) / 180) * np.minimum(dolp(stokes) / FULL_BRIGHTNESS, 1)[..., None]
        bar = _hues(scale)
    else:
        bright = np.percentile(stokes[0], 99)
        grey = srgb_curve(stokes[0] / max(bright, DARKEST))
        ratios = stokes[1:] / np.maximum(stokes[0], DARKEST)
        panels = [np.repeat(grey[..., None], 3, axis=2), *(coloured((ratio + 1) / 2, DIVERGING) for ratio in ratios)]
        picture, bar = np.concatenate(panels, axis=1), coloured(scale, DIVERGING)
    return codes(_with_bar(picture, bar), bits)


def coloured(values: Floats, colours: Floats) -> Floats:
    """Map values from 0 to 1 to a colour scale.

    The scale interpolates linearly between the equidistant `colours` (colour, 3). The result has an additional last axis for
    R, G and B.
    """
    at = np.linspace(0, 1, len(colours))
    return np.stack([np.interp(values, at, channel) for channel in colours.T], axis=-1)


def _hues(share: Floats) -> Floats:
    """Return fully saturated R, G and B for hues on a circle from 0 (red) to 1 (red again)."""
    sector = (share[..., None] * 6 + np.array([0.0, 4.0, 2.0])) % 6
    return np.clip(np.abs(sector - 3) - 1, 0, 1)


def _with_bar(picture: Floats, bar: Floats) -> Floats:
    """Append a colour bar (row, 1, 3) to the right side of a picture (row, col, 3), with a gap and ticks."""
    rows, cols = picture.shape[:2]
    width = max(round(BAR_FRACTION * cols), MIN_BAR_PIXELS)
    column = np.repeat(bar, width, axis=1)
    for tick in range(1, TICKS):
        column[round(tick * (rows - 1) / TICKS), : width // 3] = 0
    return np.concatenate([picture, np.ones((rows, width, 3)), column], axis=1)
