"""Spectral cubes as numpy's .npy files, which name no wavelengths."""

from pathlib import Path

from l3cli.io.arrays import map_array
from l3cli.io.scenes.cube import cube_in, size_in
from l3cli.scene import SpectralCube


def read(path: Path, variable: str | None, axes: str) -> SpectralCube:
    """The cube whose axes are those named by `axes`."""
    return cube_in(path, {"values": map_array(path)}, variable, axes)


def size(path: Path, variable: str | None, axes: str) -> tuple[int, int]:
    """(rows, cols) of what `read` reads; InputFileError as there."""
    shape = size_in({"values": map_array(path).shape}, variable, axes)
    if shape is None:
        rows, cols, _ = read(path, variable, axes).values.shape  # which says what is wrong
        return rows, cols
    return shape
