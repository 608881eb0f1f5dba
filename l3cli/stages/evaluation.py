"""The evaluation stage: a table and frames with known targets → figures, and pictures if they are wanted."""

import contextlib
import json
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from l3cli import __version__
from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingPair, TrainingSetReader, open_training_set
from l3cli.errors import InputFileError
from l3cli.evaluation.evaluation import Evaluation
from l3cli.evaluation.pictures import frame_pictures
from l3cli.files import sha256
from l3cli.frame import RawFrame
from l3cli.io import images
from l3cli.locks import finished_together, refuse_other_run
from l3cli.rendering.display import require_xyz
from l3cli.stages.claims import Claims
from l3cli.stages.console import Console
from l3cli.stages.frame_names import frame_name
from l3cli.stages.frame_renderers import FrameRenderers
from l3cli.stages.input_warnings import warn_if_trained_on, warn_if_unlike, warn_of_kernels
from l3cli.stages.plan import Made, before_work


def evaluate(
    table: Path, frames: Path, console: Console, *, backend: str = "opencl", viewing: float = 50.0,
    border: int | None = None, pictures: Path | None = None, force: bool = False,
) -> dict[str, Any]:  # fmt: skip
    """The document of `l3 evaluate` on the frames of a training set: figures of the table and of its baselines.

    `viewing`: samples a degree that S-CIELAB sees the pictures at. `border`: pixels left out at each edge of a frame; None:
    those whose patch is not inside it. `pictures`: folder for those of every frame, which with
    `force` may hold something. InputFileError or RecipeError if table and frames cannot be compared, L3Error if the folder
    cannot be written.
    """
    transforms = load(TransformTable, table)
    with Claims(console) as claims:
        if pictures is not None:
            require_xyz(transforms.outputs)
            claims.spare(table, frames)
            claims.hold_folder(pictures, "*.png")
        with open_training_set(frames) as reader, contextlib.ExitStack() as unfinished:
            evaluation = Evaluation(transforms, reader.head, viewing, border)
            made = []
            if pictures is not None:
                key = json.dumps([__version__, sha256(table), sha256(frames), backend, viewing])
                refuse_other_run(pictures, key, force)
                made = [Made(pictures, f"pictures of {len(reader)} frames")]
            before_work({"table": [table], "frames": [frames]}, *made)
            if pictures is not None:
                unfinished.enter_context(finished_together(pictures, key, force))
            warn_if_trained_on(transforms, table, frames, console)
            warn_if_unlike((table, transforms), (frames, reader.head.camera), console)
            renderers = FrameRenderers(backend, transforms, console)
            for index in console.progress(range(len(reader)), len(reader), "frames"):
                frame, planes = evaluate_frame(evaluation, renderers, reader, index)
                if pictures is not None:
                    for name, picture in frame_pictures(frame, planes).items():
                        images.write_picture(pictures / f"{frame_name(index, frame.scene)}_{name}.png", picture)
        warn_of_kernels(console)
        return evaluation.document()


def evaluate_frame(
    evaluation: Evaluation, renderers: FrameRenderers, reader: TrainingSetReader, index: int
) -> tuple[TrainingPair, dict[str, NDArray]]:
    """Count a frame of a training set; the frame and the planes of every pipeline, as `Evaluation.add` gives them."""
    frame = reader.frame(index)
    raw = raw_of(frame, index, reader.head.camera)
    renderer = renderers.of(frame)
    return frame, evaluation.add(frame, renderer.outputs(raw), renderer.labels(raw))


def raw_of(frame: TrainingPair, index: int, camera: CameraModel) -> RawFrame:
    """Frame number `index` of a training set as its camera gave it; InputFileError if it is none that a camera gives."""
    try:
        return RawFrame(
            frame.scene, frame.raw, camera.black_level, camera.white_level, dark=camera.dark_signal(frame.dark_time)
        )
    except ValueError as error:
        raise InputFileError(f"frame {index} of the training set, {error}; make the training set again") from error
