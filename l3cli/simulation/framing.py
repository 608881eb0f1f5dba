"""Framing of a scene on the sensor: cropped, mirrored, turned, scaled."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.simulation.motion import Motion, room
from l3cli.simulation.sources import Framing


def framed(cube: NDArray[np.float32], framing: Framing, camera: CameraModel) -> NDArray[np.float32]:
    """Return the samples (row, col, band) of a scene as `framing` lays them on the sensor; ValueError if the crop
    reaches beyond the scene."""
    cube = turned(cube, framing)
    scale = scale_of(framing, camera, cube.shape[1])
    if scale is not None:
        cube = _scaled(cube, scale, (camera.rows, camera.cols))
    return np.ascontiguousarray(cube)


def turned(cube: NDArray[np.float32], framing: Framing) -> NDArray[np.float32]:
    """Return the samples (row, col, band) of what is used of a scene, the right way up; ValueError if the crop reaches
    beyond it."""
    top, left, rows, cols = _cropped(cube.shape, framing)
    cube = cube[top : top + rows, left : left + cols]
    if framing.flip is not None:
        cube = np.flip(cube, axis=("rows", "cols").index(framing.flip))
    return np.rot90(cube, framing.rotate // 90)


def framed_size(size: tuple[int, int], framing: Framing, camera: CameraModel) -> tuple[int, int]:
    """Return the size (rows, cols) that `framed` makes of a scene of `size`, or of each frame of its clip; ValueError if the
    crop reaches beyond the scene, or the camera moves beyond it."""
    _, _, rows, cols = _cropped(size, framing)
    if framing.rotate % 180:
        rows, cols = cols, rows
    scale = scale_of(framing, camera, cols)
    if framing.motion is not None:
        _require_room(framing.motion, (rows, cols), scale or 1.0)
        return framing.motion.size
    if scale is not None:
        rows, cols = min(_pixels(rows, scale), camera.rows), min(_pixels(cols, scale), camera.cols)
    return rows, cols


def _cropped(size: tuple[int, ...], framing: Framing) -> tuple[int, int, int, int]:
    """Return the first row, first column, rows and columns of what is used of a scene."""
    if framing.crop is None:
        return 0, 0, size[0], size[1]
    top, left, rows, cols = framing.crop
    if top + rows > size[0] or left + cols > size[1]:
        raise ValueError(f"crop {list(framing.crop)} reaches beyond the scene of {size[0]}×{size[1]}")
    return framing.crop


def _require_room(motion: Motion, size: tuple[int, int], scale: float) -> None:
    """Raise ValueError unless the camera sees nothing beyond a scene of `size` at `scale` pixels a sample."""
    rows, cols = (math.ceil(min(length / scale - 1e-6, 1e9)) for length in room(motion))
    if rows > size[0] or cols > size[1]:
        raise ValueError(
            f"the camera sees {rows}×{cols} samples in the {motion.frames} frames of its motion, more than the "
            f"{size[0]}×{size[1]} of the scene; make the scene larger, or motion.size or the motion smaller"
        )


def scale_of(framing: Framing, camera: CameraModel, cols: int) -> float | None:
    """Return the pixels a sample of a scene that is `cols` wide; None: as many."""
    if framing.field_of_view_deg is None:
        return framing.scale
    width = 2.0 * camera.optics.image_distance * np.tan(np.radians(framing.field_of_view_deg) / 2.0)
    return float(width / camera.pixel_pitch / cols)


def _pixels(length: int, scale: float) -> int:
    return max(1, round(length * scale))


def _scaled(cube: NDArray[np.float32], scale: float, most: tuple[int, int]) -> NDArray[np.float32]:
    """cube (row, col, band) with `scale` pixels a sample, its middle cut out where it exceeds `most` (rows, cols)."""
    down, across = (_resampling(length, scale, limit) for length, limit in zip(cube.shape, most, strict=False))
    return resampled(cube, down, across)


def resampled(cube: NDArray[np.float32], down: Any, across: Any) -> NDArray[np.float32]:
    """cube (row, col, band) by sparse matrices (pixel, sample) for its rows and its columns, row by row: bounded memory."""
    rows, cols, bands = cube.shape
    tall = (down @ cube.reshape(rows, cols * bands)).reshape(-1, cols, bands)
    made = np.empty((tall.shape[0], across.shape[0], bands), np.float32)
    for row, line in enumerate(tall):
        made[row] = across @ line
    return made


def _resampling(length: int, scale: float, most: int) -> Any:
    """Return sparse M (pixel, sample): linear interpolation of samples at their centres, averaged over pixels larger than a
    sample."""
    from scipy.sparse import csr_array

    whole = _pixels(length, scale)
    pixels, step = min(whole, most), length / whole
    points = max(1, round(4 * step)) if step > 1 else 1
    inside = (np.arange(points) + 0.5) / points
    position = (np.arange(pixels)[:, None] + (whole - pixels) / 2 + inside) * step - 0.5  # in samples
    first = np.floor(position).astype(int)
    either = np.clip(np.stack([first, first + 1]), 0, length - 1)
    weight = np.stack([1 - (position - first), position - first]).astype(np.float32) / points
    row = np.broadcast_to(np.arange(pixels)[:, None], either.shape)
    return csr_array((weight.ravel(), (row.ravel(), either.ravel())), shape=(pixels, length))
