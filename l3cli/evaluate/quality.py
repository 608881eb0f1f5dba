"""How near a rendered picture comes to its target: CIEDE2000 and PSNR of the displayed pictures (METHOD 7)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli import spectra

Array = NDArray[np.floating]
DISPLAY_PERCENTILE = 99.0  # of the target's luminance becomes display white, as the authors show their pictures


@dataclass(frozen=True)
class Quality:
    """Figures of one frame, both pictures shown on the target's own scale and clipped to the sRGB gamut."""

    mean_delta_e: float  # CIEDE2000
    median_delta_e: float
    p95_delta_e: float
    psnr: float  # dB, of non-linear sRGB in 0…1


def displayed(xyz: Array, white: Array, scale: float) -> Array:
    """Linear sRGB (row, col, 3) in 0…1 of XYZ planes (3, row, col): `white` (3) adapted to D65, Y = `scale` shown as 1."""
    matrix = spectra.srgb_from_xyz_matrix() @ spectra.adaptation_matrix(white, spectra.white_point("D65")) / scale
    return np.clip(np.einsum("oc,crk->rko", matrix, xyz), 0.0, 1.0)


def quality(rendered: Array, target: Array, white: Array, border: int = 0) -> Quality:
    """Compare XYZ planes (3, row, col) in one unit; `white` (3) is the frame's light; a margin of `border` is left out."""
    inside = (slice(None), slice(border, target.shape[1] - border), slice(border, target.shape[2] - border))
    scale = float(np.percentile(target[1], DISPLAY_PERCENTILE))
    ours, ideal = displayed(rendered[inside], white, scale), displayed(target[inside], white, scale)
    to_xyz = np.linalg.inv(spectra.srgb_from_xyz_matrix())
    d65 = spectra.white_point("D65")
    difference = spectra.delta_e_2000(spectra.lab(ours @ to_xyz.T, d65), spectra.lab(ideal @ to_xyz.T, d65))
    error = float(np.mean((spectra.srgb_curve(ours) - spectra.srgb_curve(ideal)) ** 2))
    return Quality(
        mean_delta_e=float(difference.mean()),
        median_delta_e=float(np.median(difference)),
        p95_delta_e=float(np.percentile(difference, 95)),
        psnr=float(-10.0 * np.log10(max(error, 1e-12))),
    )
