"""The training set: simulated frames with what the sensor saw and what the picture should be."""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import h5py
import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.base import (
    Artifact,
    check,
    data,
    group,
    new_artifact,
    open_artifact,
    read_fields,
    read_history,
    write_fields,
)
from l3cli.artifacts.camera import CameraModel
from l3cli.errors import InputFileError


@dataclass(frozen=True)
class TrainingFrame:
    """One exposure of one scene.

    `electrons` are full-resolution: every channel at every pixel, so that training may place the mosaic at any offset and
    in any of its eight orientations (METHOD 4.8). `raw` is the mosaic the camera would have given.
    """

    electrons: NDArray[np.float32] = data(
        "float32",
        "channel",
        "row",
        "col",
        unit="e-",
        doc="mean photo-electrons of every channel, noise-free, unclipped",
    )
    raw: NDArray[np.uint16] = data("uint16", "row", "col", unit="DN", doc="one noisy mosaic, CFA phase (0, 0)")
    target: NDArray[np.float32] = data(
        "float32", "output", "row", "col", unit="cd/m^2 (XYZ)", doc="wanted output, registered with the sensor"
    )
    white: NDArray[np.float64] = data(
        "float64", "output", unit="cd/m^2 (XYZ)", doc="target of a perfect white under this light"
    )
    scene: str = data("str", doc="name of the scene")
    illuminant: str = data("str", doc="name of the illuminant")
    luminance: float = data("float64", unit="cd/m^2", doc="luminance of a perfect white")
    exposure: float = data("float64", unit="s", doc="exposure time")
    seed: tuple[int, ...] = data("int64", "seed_word", doc="seed of this frame's noise")

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True)
class TrainingSet(Artifact):
    """Head of a training set; its frames lie in the groups frames/00000, frames/00001… and are read one by one."""

    kind: ClassVar[str] = "training set"
    version: ClassVar[int] = 1
    made_by: ClassVar[str] = '"l3 simulate"'

    camera: CameraModel = group()
    outputs: tuple[str, ...] = data("str", "output", doc="names of the outputs")
    target_description: str = data("str", doc="what the target is")


class TrainingSetReader:
    """An open training set: `head`, `len()`, `frame(i)`, iteration in order. Memory holds one frame at a time."""

    def __init__(self, root: h5py.File, path: Path) -> None:
        self._root, self._path = root, path
        self.head: TrainingSet = read_fields(root, TrainingSet, path, history=read_history(root, path))
        if not isinstance(root.get("frames"), h5py.Group) or not len(root["frames"]):
            raise InputFileError(f'{path} holds no frames; make it again with "l3 simulate"')
        self._names = sorted(root["frames"])

    def __len__(self) -> int:
        return len(self._names)

    def frame(self, index: int) -> TrainingFrame:
        name = f"frames/{self._names[index]}"
        return read_fields(self._root[name], TrainingFrame, self._path)

    def __iter__(self) -> Iterator[TrainingFrame]:
        for index in range(len(self)):
            yield self.frame(index)


@contextlib.contextmanager
def open_training_set(path: Path) -> Iterator[TrainingSetReader]:
    """A reader of the training set at `path`; InputFileError if it is none or damaged."""
    with open_artifact(path, TrainingSet) as root:
        yield TrainingSetReader(root, path)


class TrainingSetWriter:
    """Appends frames to a training set being written."""

    def __init__(self, root: h5py.File) -> None:
        self._frames = root.create_group("frames")
        self._count = 0

    def append(self, frame: TrainingFrame) -> None:
        write_fields(self._frames.create_group(f"{self._count:05d}"), frame)
        self._count += 1


@contextlib.contextmanager
def write_training_set(path: Path, head: TrainingSet) -> Iterator[TrainingSetWriter]:
    """A writer for a training set that appears at `path` when the block ends without an error."""
    with new_artifact(path, head.kind, head.version, head.history) as root:
        write_fields(root, head)
        yield TrainingSetWriter(root)
