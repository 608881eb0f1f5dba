"""Judged tables side by side: the frame that all of them have, rendered by each."""

from l3cli.artifacts.training_set import open_training_set
from l3cli.io.embedded import jpeg
from l3cli.report.parts import Section
from l3cli.report.pictures import Pixels
from l3cli.report.side_by_side import Side, shared_frame, side_by_side_section
from l3cli.stages.console import Silent
from l3cli.stages.evaluation import evaluate_frame
from l3cli.stages.frame_renderers import FrameRenderers
from l3cli.stages.reporting.judged import Judged


def side_by_side(judged: list[Judged], limit: int, backend: str) -> Section:
    """All judged tables in one section, whose pictures may take `limit` bytes."""
    sides = [Side(each.table[0].name, each.frames[0].name, each.frames[1].camera, each.document) for each in judged]
    indices = shared_frame(sides)
    pictures = [_pictures(each, index, backend) for each, index in zip(judged, indices, strict=True)] if indices else []
    return side_by_side_section(sides, pictures, limit, jpeg)


def _pictures(judged: Judged, index: int, backend: str) -> dict[str, Pixels]:
    from l3cli.evaluation.evaluation import Evaluation
    from l3cli.evaluation.pictures import frame_pictures

    (_, table), (frames, head) = judged.table, judged.frames
    with open_training_set(frames.path, unchanged=True) as reader:
        renderers = FrameRenderers(backend, table, Silent())  # each has been judged before
        return frame_pictures(*evaluate_frame(Evaluation(table, head), renderers, reader, index))
