"""The report stage: any set of artifacts → one page. Rooms are called here, since they do not know one another."""

import functools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.schema import equal
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import open_training_set
from l3cli.errors import RecipeError
from l3cli.io.images import jpeg
from l3cli.report.camera import camera_section
from l3cli.report.colours import channel_light
from l3cli.report.evaluation import evaluation_section
from l3cli.report.page import LIMIT, history_section, render_page
from l3cli.report.parts import Section, counted
from l3cli.report.pictures import Pixels
from l3cli.report.sequence import sequence_section
from l3cli.report.sequence import summary as sequence_summary
from l3cli.report.side_by_side import Side, shared_frame, side_by_side_section
from l3cli.report.training import training_section
from l3cli.report.transforms import transform_section
from l3cli.stages.claims import OutputGuard
from l3cli.stages.console import Console, Silent
from l3cli.stages.evaluation import evaluate_frame
from l3cli.stages.frame_renderers import FrameRenderers
from l3cli.stages.input_warnings import warn_of_kernels
from l3cli.stages.plan import Made, before_work
from l3cli.stages.reporting.artifacts import Entry, Given, by_kind, trained_on
from l3cli.stages.reporting.judged import Judged, judge
from l3cli.system.files import write_whole

# of all evaluated frames, of all pixels that can be looked into, of classes elsewhere, of all training sets: see page.LIMIT
PICTURE_BYTES, PIXEL_BYTES, CLASS_BYTES, THUMBNAIL_BYTES = 5_500_000, 1_000_000, 300_000, 2_000_000


def report(
    artifacts: tuple[Path, ...], output: Path, console: Console, *, backend: str = "opencl", force: bool = False
) -> None:
    """Write a page on camera models, training sets and transform tables; InputFileError if one is none of these, is damaged,
    or does not fit the others, RecipeError or L3Error if the output cannot be written."""
    if output.suffix != ".html":
        raise RecipeError(f"{output}: a report is a page; name a file that ends in .html")
    with OutputGuard(console) as claims:
        claims.protect(*artifacts)
        claims.claim_file(output, force)
        kinds = by_kind(artifacts)
        before_work({"artifacts": artifacts}, Made(output, "page"))
        title, lead, sections = _compose(kinds, backend, console)
        page = render_page(title, lead, sections).encode()
        write_whole(output, page)
        warn_of_kernels(console)
        much = "; fewer files would make a lighter page" if len(page) > LIMIT else ""
        console.info(f"{output}: {len(page) / 1e6:.2f} MB, {len(sections)} sections{much}")


def _compose(given: Given, backend: str, console: Console) -> tuple[str, str, list[Section]]:
    """Return title, lead and sections of the page: pictures first, then what was given, array by array."""
    arrays = given.arrays
    _warn_of_arrays(given, console)
    pairs = len(given.pairs)
    shares = PICTURE_BYTES // (pairs + (pairs > 1) or 1), PIXEL_BYTES // (pairs or 1), CLASS_BYTES // (pairs or 1)
    judged: list[Judged] = []
    cameras: list[tuple[str, CameraModel]] = []
    sections: list[Section] = []
    held_by = [[(entry.name, camera) for entry, camera in array.cameras] or _cameras_within(array) for array in arrays]
    called = [camera.name for held in held_by for _, camera in held]
    for array, held in zip(arrays, held_by, strict=True):
        _warn_of_cameras(array, console)
        here = [judge(*pair, str(len(judged) + number), shares, backend, console) for number, pair in enumerate(array.pairs)]
        sections += _array_sections(array, held, called, THUMBNAIL_BYTES // max(len(given.training), 1))
        sections += [_evaluation(each) for each in here]
        judged += here
        cameras += held
    first = [each.front for each in judged if each.front is not None]
    if len(judged) > 1:
        first.insert(0, _side_by_side(judged, shares[0], backend))
    files = [(entry.name, entry.artifact.kind, entry.sha256, entry.artifact.history) for entry in given.entries]
    if given.sequences:
        sections.append(sequence_section(given.sequences))
        files += [(name, "evaluation of a sequence", digest, ()) for name, digest in given.sequence_sums.items()]
    sections.append(history_section(files))
    names = [camera.name for _, camera in cameras] or [table.camera_name for _, table in given.tables]
    names = names or [*given.sequences]
    doubts = (f"But {each.warning}." for each in judged if each.warning)
    lead = (
        " ".join((first[0].lead, *doubts)) if len(judged) > 1 else _lead(given, [_evaluation(each).lead for each in judged])
    )
    return f"{', '.join(dict.fromkeys(names))}: report", lead, [*first, *sections]


def _array_sections(given: Given, cameras: list[tuple[str, CameraModel]], called: list[str], limit: int) -> list[Section]:
    """Return cameras, training sets and tables of one array; `called` are the names of the cameras of all arrays, `limit`
    bytes is what the pictures of a set may take."""
    sections = [camera_section(camera, figures_of_camera(camera), name) for name, camera in cameras]
    for number, (name, camera) in enumerate(cameras):
        if called.count(camera.name) > 1:
            sections[number] = replace(sections[number], title=f"{sections[number].title} ({name})")
    for entry, _ in given.training:
        with open_training_set(entry.path, unchanged=True) as reader:
            sections.append(training_section(reader, entry.name, _role(given, entry), limit, jpeg))
    light = channel_light(cameras[0][1].responsivity, cameras[0][1].wavelength) if cameras else None
    return sections + [_transforms(entry.name, table, light) for entry, table in given.tables]


def _warn_of_arrays(given: Given, console: Console) -> None:
    """Warn of every training set of another array than all tables."""
    if not given.tables:
        return
    for array in given.arrays:
        if not array.tables:
            for entry, _ in array.training:
                tables = ", ".join(table.name for table, _ in given.tables)
                console.warn(f"{entry.name} is of another colour filter array than {tables}: nothing is evaluated on it")


def _warn_of_cameras(given: Given, console: Console) -> None:
    """Warn of every camera model that is unlike the first table's camera or, without one, unlike the first artifact's."""
    from l3cli.evaluation.likeness import unlike

    held = [(entry, head.camera) for entry, head in given.training]
    known: list[tuple[Entry, Any]] = [*given.tables, *given.cameras, *held]
    for entry, camera in given.cameras if given.tables else [*given.cameras, *held]:
        if entry is not known[0][0] and (differences := unlike(known[0][1], camera)):
            text = f"they differ in {differences}; report on each camera alone"
            console.warn(f"{entry.name} is of another camera than {known[0][0].name}: {text}")


def _lead(given: Given, leads: list[str]) -> str:
    if given.sequences and not leads:
        return sequence_summary(given.sequences)
    if leads:
        return leads[0]
    if given.tables and len(given.arrays) > 1:
        return "Add, for each table, frames of its colour filter array that it has not seen to have it evaluated."
    if given.tables and given.training:
        return "The table was trained on every training set given: add frames that it has not seen to have it evaluated."
    if given.tables:
        return "Add a training set that the table was not trained on to have it evaluated."
    return f"{counted(len(given.entries), 'artifact')}, without a transform table: nothing is evaluated."


def _cameras_within(given: Given) -> list[tuple[str, CameraModel]]:
    """Return the different cameras of the training sets."""
    cameras: list[tuple[str, CameraModel]] = []
    for entry, head in given.training:
        if not any(equal(head.camera, camera) for _, camera in cameras):
            cameras.append((entry.name, head.camera))
    return cameras


def figures_of_camera(camera: CameraModel) -> dict[str, Any]:
    from l3cli.calibration.acceptance import shortfall
    from l3cli.calibration.figures import camera_figures, figures

    if camera.fit is not None:
        return figures(camera) | {"shortfall": (shortfall(camera) or "").partition(";")[0]}
    plain = {name: {"value": value, "unit": unit} for name, (value, unit) in camera_figures(camera).items()}
    nothing: dict[str, Any] = {"channels": {}, "lights": {}, "bands": {}, "photos": {}, "left out": [], "defects": []}
    return {"camera": plain, **nothing, "saturation reached": None, "shortfall": ""}


def _transforms(name: str, table: TransformTable, light: NDArray[np.float64] | None) -> Section:
    from l3cli.classes.names import class_name
    from l3cli.training.insight import insight

    return transform_section(table, light, insight(table), functools.partial(class_name, table), name)


def _role(given: Given, frames: Entry) -> str:
    """Return the relation of the report's tables to a training set."""
    learned = [entry.name for entry, table in given.tables if trained_on(table, frames)]
    judged = [entry.name for entry, table in given.tables if not trained_on(table, frames)]
    roles = [f"Trained on it: {', '.join(learned)}."] if learned else []
    roles += [f"Evaluated on it: {', '.join(judged)}."] if judged else []
    return " ".join(roles)


def _evaluation(judged: Judged) -> Section:
    section = evaluation_section(judged.document, (judged.table[0].name, judged.frames[0].name))
    return replace(section, lead=f"{section.lead} But {judged.warning}.") if judged.warning else section


def _side_by_side(judged: list[Judged], limit: int, backend: str) -> Section:
    """Return all judged tables in one section, whose pictures may take `limit` bytes."""
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
