"""Convert Stokes parameters to planes for output files, and to pictures for display (docs/polarisation.md#pictures)."""

import numpy as np
from numpy.typing import NDArray

from l3cli.frames.frame import upright
from l3cli.physics.display import codes, srgb_curve
from l3cli.physics.polarisation_colours import DIVERGING, VIRIDIS, angle_colours, coloured, degree_colours, hues
from l3cli.physics.stokes import DARKEST, FEATURES, IN_ORDER, STOKES, aolp, dolp, has_stokes, stokes_of

Floats = NDArray[np.floating]

SHOWN = ("dolp", "aolp", "stokes")  # kinds of polarisation pictures
BAR_FRACTION, MIN_BAR_PIXELS = 0.03, 6  # width of the colour bar, and of the gap before it, relative to the picture width
TICKS = 4  # intervals into which the ticks divide a colour bar


def in_upright_frame(planes: Floats, outputs: tuple[str, ...], orientation: int) -> Floats:
    """Rotate the outputs (output, row, col) upright. `orientation` is a LibRaw flip code.

    S1 and S2 are converted so that the angle of polarisation is measured from the horizontal axis of the upright picture: if
    the picture is mirrored, S2 changes its sign, and if it is transposed, S1 changes its sign.
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
    """Return the plane names for a file with linear outputs.

    If the outputs contain S1 and S2, the names of DoLP and AoLP are appended. For monochrome polarisation cameras, the
    outputs are reordered to S0, S1, S2.
    """
    if not has_stokes(outputs):
        return outputs
    return (IN_ORDER if outputs == STOKES else outputs) + FEATURES


def planes_in_files(planes: Floats, outputs: tuple[str, ...]) -> Floats:
    """Return the planes (value, row, col) for a file with linear outputs, in the order of `names_in_files`.

    `planes` (output, row, col) contains a table's outputs. If they contain S1 and S2, DoLP (0 to 1) and AoLP (degrees) are
    appended.
    """
    if not has_stokes(outputs):
        return planes
    stokes = stokes_of(planes, outputs)
    own = stokes if outputs == STOKES else planes
    return np.concatenate([own, [dolp(stokes), aolp(stokes)]]).astype(planes.dtype)


def picture_of(planes: Floats, outputs: tuple[str, ...], shown: str, bits: int) -> NDArray:
    """Show Stokes parameters as a picture with a colour bar on its right.

    Parameters
    ----------
    planes : ndarray, (output, row, col)
        Outputs of a table.
    outputs : tuple of str
        Names of the outputs.
    shown : str
        "dolp": the degree of polarisation from 0 to 1, in viridis colours. "aolp": the angle as hue from 0° (red) to 180°,
        and the degree as brightness. "stokes": side by side, S0 in grey, and S1/S0 and S2/S0 in colours from −1 (blue) to 1
        (red).
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
        picture, bar = degree_colours(stokes), coloured(scale, VIRIDIS)
    elif shown == "aolp":
        picture, bar = angle_colours(stokes), hues(scale)
    else:
        bright = np.percentile(stokes[0], 99)
        grey = srgb_curve(stokes[0] / max(bright, DARKEST))
        ratios = stokes[1:] / np.maximum(stokes[0], DARKEST)
        panels = [np.repeat(grey[..., None], 3, axis=2), *(coloured((ratio + 1) / 2, DIVERGING) for ratio in ratios)]
        picture, bar = np.concatenate(panels, axis=1), coloured(scale, DIVERGING)
    return codes(_with_bar(picture, bar), bits)


def _with_bar(picture: Floats, bar: Floats) -> Floats:
    """Add a vertical colour bar with ticks to the right of a picture, separated by a gap."""
    rows, cols = picture.shape[:2]
    width = max(round(BAR_FRACTION * cols), MIN_BAR_PIXELS)
    column = np.repeat(bar, width, axis=1)
    for tick in range(1, TICKS):
        column[round(tick * (rows - 1) / TICKS), : width // 3] = 0
    return np.concatenate([picture, np.ones((rows, width, 3)), column], axis=1)
