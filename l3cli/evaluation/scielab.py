"""S-CIELAB: colour difference as an eye sees it at a distance (Zhang and Wandell 1996), as ISETCam computes it.

Each picture goes to opponent colours (Poirson and Wandell), each of them is blurred by a sum of Gaussians, and CIEDE2000 is
taken of what comes back. The constants are ISETCam's defaults: the transform of the 10° observer and the "distribution"
widths of Johnson and Fairchild. ISETCam wraps pictures around, drops a row and a column where that makes them odd, and
returns maps displaced by a pixel; here pictures are mirrored at their edges and stay in place.
"""

import numpy as np
from numpy.typing import NDArray

from l3cli.physics.display import delta_e_2000, lab

Array = NDArray[np.floating]
VIEWING = 50.0  # samples a degree: a monitor of 110 dots an inch at 66 cm
OPPONENT_FROM_XYZ = np.array(
    [[0.2885613, 0.6597617, -0.1305654], [-0.4648864, 0.3262702, 0.0624200], [0.0798787, -0.5547976, 0.4814746]]
)
FILTERS = (  # (half width at half maximum in degrees, weight) of the Gaussians of light–dark, red–green, blue–yellow
    ((0.05, 1.00327), (0.225, 0.114416), (7.0, -0.117686)),
    ((0.0685, 0.616725), (0.826, 0.383275)),
    ((0.0920, 0.567885), (0.6451, 0.432115)),
)


def scielab(one: Array, other: Array, white: Array, viewing: float = VIEWING) -> Array:
    """CIEDE2000 (row, col) of two pictures of XYZ (row, col, 3) seen at `viewing` samples a degree under `white` (3)."""
    labs = [lab(np.maximum(blurred(picture, viewing), 0.0), white) for picture in (one, other)]
    return delta_e_2000(*labs)


def blurred(xyz: Array, viewing: float) -> Array:
    """Return XYZ (row, col, 3) as blurred by the eye's three opponent filters, each a degree wide in all."""
    from scipy.ndimage import correlate1d

    opponent = np.einsum("oc,rkc->ork", OPPONENT_FROM_XYZ, xyz)
    reach = np.arange(-half_size(viewing), half_size(viewing) + 1)
    total = np.zeros_like(opponent)
    for plane, seen, terms in zip(opponent, total, FILTERS, strict=True):
        for half_width, weight in terms:
            sigma = half_width * viewing / np.sqrt(2.0 * np.log(2.0))
            kernel = np.exp(-0.5 * (reach / sigma) ** 2)
            kernel /= kernel.sum()
            seen += weight * correlate1d(correlate1d(plane, kernel, axis=0), kernel, axis=1)
    return np.einsum("co,ork->rkc", np.linalg.inv(OPPONENT_FROM_XYZ), total)


def half_size(viewing: float) -> int:
    """Return the samples from the centre to the end of a filter: a degree in all, made odd downwards as in ISETCam."""
    return (int(np.ceil(viewing)) - 1) // 2
