"""Artifacts: read, written, and handed to stages, which take files."""

import contextlib
import tempfile
from collections.abc import Iterator
from os import PathLike
from pathlib import Path

from l3cli.artifacts import camera_recipe, store
from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.schema import Artifact
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingSet
from l3cli.errors import InputFileError
from l3cli.recipes.builtin import find_recipe

Name = str | PathLike[str]
KINDS: tuple[type[Artifact], ...] = (CameraModel, TrainingSet, TransformTable)


def load(path: Name) -> CameraModel | TransformTable | TrainingSet:
    """Return the artifact in a file of any kind: a camera model, a transform table, or the head of a training set. Where the
    kind is known, `load_camera`, `load_table` and `load_training_set` give its type. InputFileError if the file holds no
    artifact, or a byte has changed."""
    with store.open_artifact(Path(path)) as root:
        kind = str(root.attrs["kind"])
    for cls in KINDS:
        if cls.kind == kind:
            return store.load(cls, Path(path))  # type: ignore[return-value]
    raise InputFileError(
        f"{path} holds {kind}, which only l3 train --merge reads; give a camera model, training set or table"
    )


def load_camera(camera: Name) -> CameraModel:
    """Return the camera model in a file, or of a camera recipe: its file (.toml), or the name of one that comes with l3.

    InputFileError if the file holds none or a byte has changed, RecipeError if the recipe cannot be.
    """
    return camera_recipe.load_camera(find_recipe(str(camera), "cameras"))


def load_table(path: Name) -> TransformTable:
    """Return the transform table in a file. InputFileError if it holds none, or a byte has changed."""
    return store.load(TransformTable, Path(path))


def load_training_set(path: Name) -> TrainingSet:
    """Return the head of the training set in a file: its camera, outputs and history. InputFileError if it holds none, or a
    byte has changed. Frames are read one by one through `l3cli.artifacts.training_set.open_training_set`."""
    return store.load(TrainingSet, Path(path))


def save(artifact: CameraModel | TransformTable, path: Name) -> None:
    """Write a camera model or a transform table, whole or not at all. L3Error if `path` cannot be written."""
    store.save(artifact, Path(path))


@contextlib.contextmanager
def file_of(given: Name | Artifact, kind: str | None = None) -> Iterator[Path]:
    """Yield the file of an artifact: the one that is named (a recipe of a `kind` also by its name), or one made for the
    while."""
    if not isinstance(given, Artifact):
        yield Path(given) if kind is None else find_recipe(str(given), kind)
        return
    with tempfile.TemporaryDirectory(prefix="l3-") as folder:
        path = Path(folder, "artifact.h5")
        store.save(given, path)
        yield path
