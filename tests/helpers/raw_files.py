"""A table that matches the mosaics in the raw test files, and frames of one mosaic in files of different types."""

import dataclasses
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.frames.frame import RawFrame
from l3cli.io.raw.files import RawOverrides, frame_of, read_raw, read_stack
from tests.helpers.cameras import BAYER
from tests.helpers.tables import random_table

RGGB = dataclasses.replace(random_table(BAYER, bits=12, black_level=64.0), camera_name="RGGB", rows=32, cols=40)


def read_in_every_way(values: NDArray[np.uint16], camera: CameraModel, folder: Path) -> tuple[RawFrame, ...]:
    """Write a mosaic as a .npy file, a headerless file and a stack, and read it from each of them for a camera."""
    np.save(folder / "one.npy", values)
    values.tofile(folder / "one.raw")
    np.save(folder / "several.npy", np.array([values, values]))
    stack = read_stack(folder / "several.npy", camera, RawOverrides())
    assert stack is not None
    content = stack.read(1)
    assert content is not None
    page = frame_of("page", content, camera, RawOverrides())
    return read_raw(folder / "one.npy", camera), read_raw(folder / "one.raw", camera), page
