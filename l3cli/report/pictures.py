"""Pictures inside a page: targets as sRGB, small enough, as data URIs."""

import base64
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from l3cli.physics.display import displayed, srgb_codes, white_luminance

Array = NDArray[np.floating]
Pixels = NDArray[np.uint8]
Jpeg = Callable[[Pixels, int], bytes]  # (row, col, 3) encoded sRGB and quality 1…100 → a JPEG file
TRIED = ((1, 92), (1, 85), (1, 75), (2, 90), (2, 75), (4, 85), (8, 80), (16, 75))  # reduction and quality, best first
THUMBNAIL = 160  # px, longest side


def thumbnail(target: Array, white: Array) -> Pixels:
    """Return sRGB (row, col, 3), at most THUMBNAIL long, of XYZ planes (3, row, col), `white` (3) adapted to D65."""
    step = max(1, -(-max(target.shape[1:]) // THUMBNAIL))
    small = reduced(np.moveaxis(target, 0, -1), step)
    return srgb_codes(displayed(np.moveaxis(np.asarray(small, np.float64), -1, 0), white, white_luminance(target[1])))


def reduced(pixels: Array | Pixels, step: int) -> Array | Pixels:
    """Return the means (row, col, channel) of squares of `step` pixels; what does not fill a square is cut off."""
    rows, cols = (max(1, length // step) for length in pixels.shape[:2])
    if step == 1 or min(pixels.shape[:2]) < step:
        return pixels
    return pixels[: rows * step, : cols * step].reshape(rows, step, cols, step, -1).mean(axis=(1, 3))


def fitted(pixels: Pixels, limit: int, jpeg: Jpeg) -> tuple[str, tuple[int, int]]:
    """Return a data URI of at most about `limit` bytes and the size (rows, cols) of its picture."""
    for step, quality in TRIED:
        small = np.rint(reduced(pixels, step)).astype(np.uint8)
        coded = base64.b64encode(jpeg(small, quality))
        if len(coded) <= limit:
            break
    return "data:image/jpeg;base64," + coded.decode(), (small.shape[0], small.shape[1])
