"""Tables judged on frames that they have not seen: figures, and pictures of a few frames."""

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingPair, TrainingSet, TrainingSetReader, open_training_set
from l3cli.io.images import jpeg
from l3cli.report.front import Pictures, front_section, shown_frames
from l3cli.report.parts import Figures, Section, Subsection
from l3cli.report.patches import patches_figure, patches_table
from l3cli.report.pixels import picker
from l3cli.simulation.procedural import chart_places
from l3cli.stages.console import Console
from l3cli.stages.evaluation import evaluate_frame, raw_of
from l3cli.stages.frame_renderers import FrameRenderers
from l3cli.stages.input_warnings import warn_if_unlike
from l3cli.stages.reporting.artifacts import Entry
from l3cli.stages.reporting.pixels import crop_of

CROPPED = ("ours", "ideal", "basic")  # pictures whose pixels can be looked at


@dataclass(frozen=True)
class Judged:
    """A table on frames that it has not seen; `document` is that of `l3 evaluate --json`."""

    table: tuple[Entry, TransformTable]
    frames: tuple[Entry, TrainingSet]
    document: dict[str, Any]
    front: Section | None  # None: the outputs are no picture
    warning: str | None  # why not to trust it


def judge(
    table: tuple[Entry, TransformTable],
    frames: tuple[Entry, TrainingSet],
    anchor: str,
    limits: tuple[int, int, int],
    backend: str,
    console: Console,
) -> Judged:
    """Evaluate a table; `limits` in bytes are those of its pictures, of pixels that can be looked into, of other classes."""
    from l3cli.evaluation.evaluation import Evaluation
    from l3cli.physics.display import XYZ

    (given, transforms), (seen, head) = table, frames
    warning = warn_if_unlike((given.name, transforms), (seen.name, head.camera), console)
    renderers = FrameRenderers(backend, transforms, console)
    with open_training_set(seen.path, unchanged=True) as reader:
        evaluation = Evaluation(transforms, reader.head)
        pictures, chart = transforms.outputs == XYZ, None
        for index in console.progress(range(len(reader)), len(reader), "frames"):
            frame, planes = evaluate_frame(evaluation, renderers, reader, index)
            if pictures and chart is None:
                chart = chart_subsection(frame, index, planes, head)
        document = evaluation.document()
        front = _front(table, seen, document, reader, renderers, anchor, limits, chart) if pictures else None
    return Judged(table, frames, document, front, warning)


def _front(
    table: tuple[Entry, TransformTable],
    seen: Entry,
    document: dict[str, Any],
    reader: TrainingSetReader,
    renderers: FrameRenderers,
    anchor: str,
    limits: tuple[int, int, int],
    chart: Subsection | None,
) -> Section:
    from l3cli.evaluation.evaluation import Evaluation
    from l3cli.evaluation.pictures import frame_pictures

    again, pictures = Evaluation(table[1], reader.head), Pictures()
    for index in shown_frames(document):
        pictures[index] = frame_pictures(*evaluate_frame(again, renderers, reader, index))
    first = next(iter(pictures))
    frame = reader.frame(first)
    raw = raw_of(frame, first, reader.head.camera)
    renderer = renderers.of(frame)
    crop, text = crop_of(renderer.table, reader.head.camera, renderer, raw, *limits[1:])
    cropped = {name: pictures[first][name] for name in CROPPED if name in pictures[first]}
    looked_into = picker(f"{anchor}-{first}", crop, text, cropped, frame.scene, jpeg)
    title = f"Pictures: {table[0].name} on {seen.name}"
    below = (*([chart] if chart else []), Subsection("Pixels", (looked_into,)))
    return front_section(document, pictures, title, anchor, limits[0], jpeg, below)


def chart_subsection(frame: TrainingPair, number: int, planes: dict[str, NDArray], head: TrainingSet) -> Subsection | None:
    """Return the patches of the ColorChecker in frame `number` of a training set and in `planes`, those of every pipeline;
    None where its target shows none."""
    from l3cli.evaluation.patches import holds_chart, patch_colours

    light = head.target_light or frame.light
    size = frame.raw.shape[0], frame.raw.shape[1]
    places = (regions for regions in chart_places(size) if holds_chart(frame, light, regions))
    regions = next(places, None)
    if regions is None:
        return None
    colours = patch_colours(frame, planes, regions)
    ours = next(iter(planes))
    title = f"Patches in frame {number + 1}, {frame.scene}, {frame.illuminant}"
    figure = patches_figure(title, ("ideal", ours), (colours.ideal, colours.shown[ours]), colours.delta_e)
    return Subsection("Colour chart", (Figures((figure,)), patches_table(colours.delta_e)))
