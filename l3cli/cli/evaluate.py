"""l3 evaluate: a table's quality on frames with known targets."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from l3cli.cli import options
from l3cli.cli.terminal import show_json

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from l3cli.artifacts.training_set import TrainingPair, TrainingSetReader
    from l3cli.evaluate.evaluation import Evaluation
    from l3cli.render.renderer import Renderer


@click.command()
@click.argument("table", type=options.FILE, metavar="TABLE.h5")
@click.argument("frames", type=options.FILE, metavar="TRAINING.h5")
@options.backend
@click.option(
    "--viewing",
    type=options.Number(2, 1000, "samples/degree"),
    default=50.0,
    show_default=True,
    metavar="2…1000",
    help="Samples a degree that S-CIELAB sees the pictures at.",
)
@click.option(
    "--pictures",
    type=options.FILE,
    metavar="DIR",
    help="Write ours, ideal, basic and an error map (black: ΔE00 0, white: 10) of every frame as PNG.",
)
@click.option("--force", is_flag=True, help="Write pictures into a folder that is not empty.")
@options.as_json
@options.quiet
def evaluate(
    table: Path, frames: Path, backend: str, viewing: float, pictures: Path | None, force: bool, as_json: bool, quiet: bool
) -> None:
    """Render the raw frames of a training set that TABLE was not trained on and compare them with their targets.

    Pictures are compared as displayed: adapted to D65, the 99th percentile of the target's luminance shown as white.
    Beside the table stands a basic pipeline that learns nothing (interpolation, white balance, colour matrix) and, for
    a Bayer array where colour-demosaicing is installed, Malvar's and Menon's demosaicking with the same matrix.

    \b
    Example: l3 evaluate table.h5 unseen.h5 --json
    """
    import contextlib
    import json

    from l3cli import __version__
    from l3cli.artifacts.store import load
    from l3cli.artifacts.table import TransformTable
    from l3cli.artifacts.training_set import open_training_set
    from l3cli.cli.cautions import caution_kernels, caution_trained, caution_unlike
    from l3cli.evaluate.evaluation import Evaluation
    from l3cli.evaluate.pictures import frame_pictures
    from l3cli.files import finished_together, sha256
    from l3cli.io.images import write_picture
    from l3cli.render.display import require_xyz
    from l3cli.render.renderer import make_renderer

    transforms = load(TransformTable, table)
    if pictures is not None:
        require_xyz(transforms.outputs)
        options.spare(table, frames)
        options.hold_folder(pictures, "*.png")
    with open_training_set(frames) as reader, contextlib.ExitStack() as unfinished:
        if pictures is not None:
            key = json.dumps([__version__, sha256(table), sha256(frames), backend, viewing])
            unfinished.enter_context(finished_together(pictures, key, force))
        evaluation = Evaluation(transforms, reader.head, viewing)
        caution_trained(transforms, table, frames, quiet)
        caution_unlike((table, transforms), (frames, reader.head.camera), quiet)
        renderer = make_renderer(backend, transforms)
        for index in options.progress(range(len(reader)), len(reader), "frames", quiet):
            frame, planes = judge(evaluation, renderer, reader, index)
            if pictures is not None:
                for name, picture in frame_pictures(frame, planes).items():
                    write_picture(pictures / f"{options.frame_name(index, frame.scene)}_{name}.png", picture)
    caution_kernels(quiet)
    if as_json:
        show_json(evaluation.document(), quiet)
        return
    from l3cli.cli.quality_tables import print_tables

    print_tables(evaluation.document())


def judge(
    evaluation: "Evaluation", renderer: "Renderer", reader: "TrainingSetReader", index: int
) -> tuple["TrainingPair", dict[str, "NDArray"]]:
    """Count a frame of a training set; the frame and the planes of every pipeline, as `Evaluation.add` gives them."""
    from l3cli.frame import RawFrame

    frame, camera = reader.frame(index), reader.head.camera
    raw = RawFrame(frame.scene, frame.raw, camera.black, camera.white, dark=camera.dark_signal(frame.dark_time))
    return frame, evaluation.add(frame, renderer.outputs(raw), renderer.labels(raw))
