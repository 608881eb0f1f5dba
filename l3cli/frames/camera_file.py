"""Camera models whose defects and flat field a run corrects: checked against the table, and found again by workers."""

import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.table import TransformTable
from l3cli.errors import InputFileError, RecipeError
from l3cli.frames.correction import Correction, HotTest, correction_of
from l3cli.system.files import require_same


@dataclass(frozen=True)
class CameraFile:
    """The file of a camera model."""

    path: Path  # absolute: workers open it
    digest: str  # SHA-256


def correction_in(file: CameraFile, table: TransformTable) -> Correction:
    """The correction that a camera model knows; InputFileError if it knows none, or its array is not the table's."""
    camera = _camera_of(file)
    if camera.channels != table.channels or not np.array_equal(camera.cfa, table.cfa):
        theirs, ours = (_written(each.cfa, each.channels) for each in (camera, table))
        raise InputFileError(
            f"{file.path.name} is a camera with the array {theirs}, the table is for {ours}; give its camera"
        )
    return correction_of(camera)


@functools.lru_cache(1)
def correction_again(file: CameraFile) -> Correction:
    """In a worker: the correction of a run, made once."""
    require_same(file.path, file.digest)
    return correction_of(_camera_of(file))


def _camera_of(file: CameraFile) -> CameraModel:
    """The camera model in a file, or that of a table."""
    from l3cli.artifacts.store import load, open_artifact

    with open_artifact(file.path, CameraModel, TransformTable) as root:
        kind = str(root.attrs["kind"])
    if kind == CameraModel.kind:
        return load(CameraModel, file.path)
    camera = load(TransformTable, file.path).camera
    if camera is None:
        raise InputFileError(f"{file.path} is a table of an older version, without its camera; give a camera model")
    return camera


def hot_test(table: TransformTable) -> HotTest:
    """By the noise of the table's camera; RecipeError if an older table does not have it."""
    if table.camera is None:
        raise RecipeError(
            "‹hot› needs the camera's noise, which tables of older versions do not hold; train the table again"
        )
    return HotTest.of(table.camera)


def _written(cfa: np.ndarray, channels: tuple[str, ...]) -> str:
    return "/".join(" ".join(channels[site] for site in row) for row in cfa)
