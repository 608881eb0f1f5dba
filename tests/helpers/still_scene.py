"""Noisy frames of a still scene for the temporal filter, and a table of their camera."""

import dataclasses
from pathlib import Path

import numpy as np

from l3cli.io.pictures.openimageio import write_mosaic
from tests.helpers.cameras import BAYER, random_camera
from tests.helpers.tables import random_table

ROWS, COLS, COUNT, BLACK = 40, 52, 9, 64.0
CAMERA = random_camera(BAYER, 3, 12, BLACK)
TABLE = dataclasses.replace(random_table(BAYER, 12, BLACK), camera=CAMERA)


def mosaics(rows: int = ROWS) -> np.ndarray:
    """Return mosaics (frame, row, col) of a still scene."""
    rng = np.random.default_rng(0)
    light = rng.uniform(200, 2000, (rows // 10 + 1, COLS // 10 + 1)).repeat(10, 0).repeat(10, 1)[:rows, :COLS]
    noisy = rng.poisson(np.broadcast_to(light, (COUNT, rows, COLS))) + rng.normal(0, 5, (COUNT, rows, COLS))
    return np.clip(np.rint(noisy * CAMERA.gain + BLACK), 0, 4095).astype(np.uint16)


def write_frames(folder: Path) -> Path:
    """Write frame_0.tif to frame_8.tif in a new folder."""
    folder.mkdir()
    for number, mosaic in enumerate(mosaics()):
        write_mosaic(folder / f"frame_{number}.tif", mosaic)
    return folder
