"""Chroma as shading would make it: two further taps of a table's last layer (docs/method.md#colour-ratios)."""

import numpy as np
from numpy.typing import NDArray

from l3cli.classes.planes import LUMINANCE
from l3cli.classes.refinement import mirrored, window_means

RATIO_DARKEST = 2**9  # steps of a plane: the least mean luminance that a ratio is taken to


def shaded_chroma(planes: NDArray, side: int) -> NDArray[np.float64]:
    """Return the distance of the two chroma planes of a pixel from their means over side × side if all of the window had one
    colour and only light and shade: (chroma, row, col) of planes (plane, row, col), in their steps.

        C̄ · ρ        ρ = clamp((Y − Ȳ) / max(Ȳ, RATIO_DARKEST), ±1)

    """
    exact = planes.astype(np.float64)
    first, luminance, second = window_means(mirrored(exact, side // 2), side)
    share = np.clip((exact[LUMINANCE] - luminance) / np.maximum(luminance, RATIO_DARKEST), -1, 1)
    return np.stack([first * share, second * share])
