"""The demosaicing methods of LibRaw, called with rawpy."""

import functools
from pathlib import Path
from typing import Any

import numpy as np
import rawpy
from raw_file import through_file
from rivals import CFA, PLAIN, Array, Rival, installed

BAYER = ("LINEAR", "VNG", "PPG", "AHD", "DCB", "DHT", "AAHD")
XTRANS = {"VNG": "VNG", "PPG": "1 pass", "AHD": "3 passes"}  # rawpy calls the X-Trans methods by these names
# FBDD filters the mosaic, and medians filter channel differences. Wavelets (noise_thr) are not used, because they crash.
DENOISING: dict[str, dict[str, Any]] = {
    "FBDD full": {"fbdd_noise_reduction": rawpy.FBDDNoiseReductionMode.Full},
    "medians": {"median_filter_passes": 2},
}


def bayer(noisy: bool) -> list[Rival]:
    """Return the methods for Bayer arrays. If `noisy`, the settings include noise reduction."""
    program = _program()
    options: dict[str, dict[str, Any]] = {PLAIN: {}} | (DENOISING if noisy else {})
    rivals = []
    for name in BAYER:
        settings = {each: functools.partial(_developed, name, more) for each, more in options.items()}
        rivals.append(Rival(name if name != "LINEAR" else "linear", program, settings))
    return rivals


def xtrans() -> list[Rival]:
    """Return the methods for X-Trans arrays."""
    program = _program()
    return [Rival(shown, program, {PLAIN: functools.partial(_developed, name, {})}) for name, shown in XTRANS.items()]


def _program() -> str:
    return f"LibRaw {'.'.join(map(str, rawpy.libraw_version))} ({installed('rawpy')})"


def _developed(method: str, options: dict[str, Any], mosaic: Array, cfa: CFA) -> Array:
    """Demosaic a mosaic (see `rivals.Demosaic`)."""
    return through_file(functools.partial(_planes, method, options), mosaic, cfa)


def _planes(method: str, options: dict[str, Any], path: Path) -> Array:
    with rawpy.imread(str(path)) as raw:
        picture = raw.postprocess(
            demosaic_algorithm=rawpy.DemosaicAlgorithm[method],
            output_color=rawpy.ColorSpace.raw,
            output_bps=16,
            gamma=(1, 1),
            no_auto_bright=True,
            adjust_maximum_thr=0.0,  # keep the full scale of the file
            user_wb=[1.0, 1.0, 1.0, 1.0],
            user_flip=0,
            **options,
        )
    return np.moveaxis(picture, -1, 0) / 65535.0
