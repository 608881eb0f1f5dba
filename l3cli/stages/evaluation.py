"""The evaluation stage: a table and frames with known targets → figures, and pictures if they are wanted."""

import contextlib
import itertools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli import __version__
from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingPair, TrainingSetReader, open_training_set
from l3cli.errors import InputFileError, RecipeError
from l3cli.evaluation.evaluation import Evaluation
from l3cli.evaluation.pictures import frame_pictures, planes_of
from l3cli.frames.frame import RawFrame
from l3cli.io.picture_sequences import picture_files
from l3cli.io.pictures.registry import write_picture
from l3cli.io.scenes import rgb
from l3cli.rendering.display import require_xyz
from l3cli.stages.claims import OutputGuard
from l3cli.stages.console import Console
from l3cli.stages.frame_names import frame_name
from l3cli.stages.frame_renderers import FrameRenderers
from l3cli.stages.input_warnings import warn_if_trained_on, warn_if_unlike, warn_of_kernels
from l3cli.stages.plan import Made, before_work
from l3cli.system.files import sha256
from l3cli.system.locks import finished_together, refuse_other_run


def evaluate(
    table: Path, frames: Path, console: Console, *, backend: str = "opencl", viewing: float = 50.0,
    border: int | None = None, pictures: Path | None = None, rivals: Sequence[Path] = (), force: bool = False,
) -> dict[str, Any]:  # fmt: skip
    """The document of `l3 evaluate` on the frames of a training set: figures of the table, its baselines and its rivals.

    `viewing`: samples a degree that S-CIELAB sees the pictures at. `border`: pixels left out at each edge of a frame; None:
    those whose patch is not inside it. `pictures`: folder for those of every frame, which with `force` may hold something.
    `rivals`: folders, patterns or globs of sRGB pictures of the same frames by other pipelines, in the frames' order.
    InputFileError or RecipeError if table, frames and rivals cannot be
    compared, L3Error if the folder cannot be written.
    """
    transforms = load(TransformTable, table)
    others = {_name_of(path): (path, picture_files(path)) for path in rivals}
    if len(others) < len(rivals):
        raise RecipeError("two rivals have one name, that of their folder; rename one")
    with OutputGuard(console) as claims:
        if pictures is not None:
            require_xyz(transforms.outputs)
            claims.protect(table, frames, *itertools.chain(*(files for _, files in others.values())))
            claims.hold_folder(pictures, "*.png")
        with open_training_set(frames) as reader, contextlib.ExitStack() as unfinished:
            evaluation = Evaluation(transforms, reader.head, viewing, border, tuple(others))
            for path, files in others.values():
                if len(files) != len(reader):
                    raise InputFileError(
                        f"{path} holds {len(files)} pictures, {frames} {len(reader)} frames; give one of each"
                    )
            made = []
            if pictures is not None:
                sums = {name: [sha256(file) for file in files] for name, (_, files) in others.items()}
                key = json.dumps([__version__, sha256(table), sha256(frames), backend, viewing, *([sums] if sums else [])])
                refuse_other_run(pictures, key, force)
                made = [Made(pictures, f"pictures of {len(reader)} frames")]
            theirs = {f"pictures of {name}": files for name, (_, files) in others.items()}
            before_work({"table": [table], "frames": [frames], **theirs}, *made)
            if pictures is not None:
                unfinished.enter_context(finished_together(pictures, key, force))
            warn_if_trained_on(transforms, table, frames, console)
            warn_if_unlike((table, transforms), (frames, reader.head.camera), console)
            renderers = FrameRenderers(backend, transforms, console)
            for index in console.progress(range(len(reader)), len(reader), "frames"):
                shown = {name: files[index] for name, (_, files) in others.items()}
                frame, planes = evaluate_frame(evaluation, renderers, reader, index, shown)
                if pictures is not None:
                    for name, picture in frame_pictures(frame, planes).items():
                        write_picture(pictures / f"{frame_name(index, frame.scene)}_{name}.png", picture)
        warn_of_kernels(console)
        return evaluation.document()


def evaluate_frame(
    evaluation: Evaluation,
    renderers: FrameRenderers,
    reader: TrainingSetReader,
    index: int,
    rivals: Mapping[str, Path] | None = None,
) -> tuple[TrainingPair, dict[str, NDArray]]:
    """Count a frame of a training set and the pictures of it by `rivals`; the frame and the planes of every pipeline, as
    `Evaluation.add` gives them."""
    frame = reader.frame(index)
    theirs = {name: _planes(path, frame) for name, path in (rivals or {}).items()}
    raw = raw_of(frame, index, reader.head.camera)
    renderer = renderers.of(frame)
    return frame, evaluation.add(frame, renderer.outputs(raw), renderer.labels(raw), theirs)


def _planes(path: Path, frame: TrainingPair) -> NDArray[np.floating]:
    """XYZ planes (3, row, col) in the target's unit of a rival's picture; InputFileError if its size is not the frame's."""
    picture = rgb.read(path)
    if picture.shape[:2] != frame.raw.shape:
        sizes = "×".join(map(str, picture.shape[:2])), "×".join(map(str, frame.raw.shape))
        raise InputFileError(f"{path} is {sizes[0]}, its frame {frame.scene} {sizes[1]}; give pictures of the whole frames")
    return planes_of(picture, frame)


def _name_of(rival: Path) -> str:
    """The name of a folder of pictures, or of that which a pattern or glob leads into."""
    return (rival if rival.is_dir() else rival.parent).absolute().name


def raw_of(frame: TrainingPair, index: int, camera: CameraModel) -> RawFrame:
    """Frame number `index` of a training set as its camera gave it; InputFileError if it is none that a camera gives."""
    try:
        return RawFrame(
            frame.scene, frame.raw, camera.black_level, camera.white_level, dark=camera.dark_signal(frame.dark_time)
        )
    except ValueError as error:
        raise InputFileError(f"frame {index} of the training set, {error}; make the training set again") from error
