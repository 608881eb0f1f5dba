"""Figures of the difference between a rendered frame and its target: of pictures for CIE XYZ, of spectra for other
outputs."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.evaluation.scielab import VIEWING, scielab
from l3cli.evaluation.similarity import psnr, spectral_angle, ssim
from l3cli.physics.display import (
    LUMA,
    daylight,
    displayed,
    displayed_delta_e,
    displayed_xyz,
    srgb_curve,
    white_luminance,
)

Array = NDArray[np.floating]
CODES = 255  # of a white, in PSNR of codes


@dataclass(frozen=True)
class Quality:
    """Figures of one XYZ frame, both pictures shown on the whole target's scale and clipped to the sRGB gamut."""

    mean_delta_e: float  # CIEDE2000
    median_delta_e: float
    p95_delta_e: float
    scielab: float  # mean CIEDE2000 after the eye's blur
    psnr: float  # dB, of non-linear sRGB in 0…1
    output_psnr: float  # dB, of XYZ before clipping; 1 is the luminance shown white, times each output's share in the white
    ssim: float  # of the luma of non-linear sRGB


@dataclass(frozen=True)
class BandQuality:
    """Figures of one frame of bands, or of any outputs that are not XYZ."""

    mean_angle: float  # degrees, of the spectral angles of all pixels whose target has one; 0 of a single output
    median_angle: float
    p95_angle: float
    psnr: float  # dB over all outputs, of 8-bit codes linear in them: the frame's white is 255, what is brighter is cut
    output_psnr: float  # dB; 1 is the 99th percentile of the target's mean output, times each output's share in the white
    ssim: float  # mean over the outputs, each as for psnr before rounding


def quality(rendered: Array, target: Array, white: Array, border: int = 0, viewing: float = VIEWING) -> Quality:
    """Compare XYZ planes (3, row, col) in one unit; `white` (3) is the frame's light; a margin of `border` is left out.

    `viewing` is the samples a degree of S-CIELAB.
    """
    scale = white_luminance(target[1])
    rendered, target = cropped(rendered, border), cropped(target, border)
    ours, ideal = (displayed(planes, white, scale) for planes in (rendered, target))
    difference = displayed_delta_e(ours, ideal)
    seen = scielab(displayed_xyz(ours), displayed_xyz(ideal), daylight(), viewing)
    our_curve, ideal_curve = srgb_curve(ours), srgb_curve(ideal)
    peaks = scale * np.where(white > 0, white, white[1])[:, None, None] / white[1]  # deep red has no Z at all
    return Quality(
        mean_delta_e=float(difference.mean()),
        median_delta_e=float(np.median(difference)),
        p95_delta_e=float(np.percentile(difference, 95)),
        scielab=float(seen.mean()),
        psnr=psnr(our_curve, ideal_curve),
        output_psnr=psnr(rendered / peaks, target / peaks),
        ssim=ssim(our_curve @ LUMA, ideal_curve @ LUMA),
    )


def band_quality(rendered: Array, target: Array, white: Array, border: int = 0) -> BandQuality:
    """Compare planes of any outputs (output, row, col) in one unit; `white` (output) and `border` as in `quality`."""
    peaks = _peaks(target, white)
    rendered, target = cropped(rendered, border), cropped(target, border)
    angle = spectral_angle(rendered, target)
    angle = angle[np.isfinite(angle)] if np.isfinite(angle).any() else np.zeros(1)  # all of the target is black
    shares = [_shares(planes, white) for planes in (rendered, target)]
    return BandQuality(
        mean_angle=float(angle.mean()),
        median_angle=float(np.median(angle)),
        p95_angle=float(np.percentile(angle, 95)),
        psnr=psnr(*map(_rounded, shares)),
        output_psnr=psnr(rendered / peaks, target / peaks),
        ssim=float(np.mean([ssim(*of_band) for of_band in zip(*shares, strict=True)])),
    )


def band_figures(rendered: Array, target: Array, white: Array, border: int = 0) -> list[dict[str, float]]:
    """psnr, output_psnr and ssim of each output, as in BandQuality; arguments as in `band_quality`."""
    peaks = _peaks(target, white)
    rendered, target = cropped(rendered, border), cropped(target, border)
    linear = zip(rendered / peaks, target / peaks, strict=True)
    shares = zip(*(_shares(planes, white) for planes in (rendered, target)), strict=True)
    return [
        {"psnr": psnr(*map(_rounded, share)), "output_psnr": psnr(*of_band), "ssim": ssim(*share)}
        for of_band, share in zip(linear, shares, strict=True)
    ]


def _peaks(target: Array, white: Array) -> Array:
    """Return the value of each output (output, 1, 1) that a linear PSNR takes for 1."""
    return white_luminance(target.mean(axis=0)) * (_positive(white) / white.mean())[:, None, None]


def _shares(planes: Array, white: Array) -> Array:
    """Return the outputs as shares of white, cut to 0…1."""
    return np.clip(planes / _positive(white)[:, None, None], 0.0, 1.0)


def _positive(white: Array) -> Array:
    return np.where(white > 0, white, white.max())


def _rounded(share: Array) -> Array:
    return np.rint(share * CODES) / CODES


def cropped(planes: NDArray[Any], border: int) -> NDArray[Any]:
    """Return the planes (…, row, col) without a margin of `border` pixels."""
    return planes[..., border : planes.shape[-2] - border, border : planes.shape[-1] - border]
