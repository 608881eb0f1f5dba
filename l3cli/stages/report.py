"""The `l3 report` stage, which writes an HTML page about any combination of artifacts."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import camera_files, load_camera
from l3cli.artifacts.design import Design
from l3cli.artifacts.schema import Artifact
from l3cli.artifacts.store import load, open_artifact
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingPair, TrainingSet, TrainingSetReader, open_training_set
from l3cli.calibration.figures import figures, shortfall
from l3cli.classes.names import class_name
from l3cli.errors import InputFileError, RecipeError
from l3cli.evaluation.camera_match import camera_differences
from l3cli.evaluation.evaluation import Evaluation, raw_of
from l3cli.evaluation.pictures import frame_pictures, holds_chart, patch_colours
from l3cli.evaluation.sequence import read_sequence_figures
from l3cli.io.pictures.openimageio import jpeg
from l3cli.options.commands import CheckOptions, ReportOptions
from l3cli.physics.display import XYZ
from l3cli.physics.stokes import has_stokes
from l3cli.rendering.opencl.devices import cache_warning
from l3cli.report.camera import camera_section
from l3cli.report.colours import channel_light
from l3cli.report.design import design_section
from l3cli.report.evaluation import evaluation_section, front_section, lit_as, shown_frames
from l3cli.report.given import Entry, Given, Pair, cameras_within, lead_without_evaluation, role_of
from l3cli.report.parts import MAX_PAGE_BYTES, Figures, Pixels, Section, Subsection, history_section, render_page
from l3cli.report.pixels import crop_of, picker
from l3cli.report.polarisation import polarisation_maps, polarisation_section
from l3cli.report.sequence import sequence_section
from l3cli.report.side_by_side import Side, shared_frame, side_by_side_section
from l3cli.report.training import training_section
from l3cli.report.transforms import transform_section
from l3cli.report.validation import patches_figure, patches_table
from l3cli.simulation.frame import frames_like
from l3cli.simulation.procedural import chart_places
from l3cli.stages.check import CAMERA, Judgement
from l3cli.stages.evaluation import FrameRenderers, document_of, evaluate_frame, figures_by_gain, for_frames
from l3cli.system.console import Console, Silent
from l3cli.system.files import FilesUsed, files_to_read, sha256, write_whole
from l3cli.system.outputs import OutputGuard
from l3cli.system.text import a, short_names, tidy
from l3cli.training.summary import insight

# limits, in bytes, that keep the page smaller than parts.MAX_PAGE_BYTES
PICTURE_BYTES = 5_500_000  # maximum size of the pictures of all evaluated frames
PIXEL_BYTES = 1_000_000  # maximum size of all pixel viewers, which show the class, filter and values of single pixels
CLASS_BYTES = 300_000  # maximum size of the filters of classes that do not occur in the crops of the pixel viewers
THUMBNAIL_BYTES = 2_000_000  # maximum size of the thumbnails of all training sets
KINDS: dict[str, type[Artifact]] = {kind.kind: kind for kind in (CameraModel, TrainingSet, TransformTable, Design)}
SEQUENCE_SUFFIX = ".json"  # suffix of the files that `l3 evaluate` writes for sequences
CROPPED = ("ours", "ideal", "basic")  # names of the pictures that the pixel viewer shows


def report(artifacts: tuple[Path, ...], output: Path, options: ReportOptions) -> FilesUsed:
    """Write an HTML page about camera models, training sets, transform tables, designs and evaluations of sequences.

    The page includes an evaluation of each table on all training sets with the same CFA, except those that were used to
    train the table.

    Parameters
    ----------
    artifacts : tuple of Path
        Artifacts, and JSON files from `l3 evaluate --sequence`.
    output : Path
        The page. Its file name must end in .html.
    options : ReportOptions
        Options of `l3 report`.

    Returns
    -------
    FilesUsed
        The files that were read and written.

    Raises
    ------
    InputFileError
        If a file is damaged, is not supported in reports, or does not match the other files.
    RecipeError
        If the file name of the output does not end in .html, or if no frame has the luminance `options.at`.
    L3Error
        If the page cannot be written.
    """
    if output.suffix != ".html":
        raise RecipeError(f"{output} is not the name of an HTML page; use a file name that ends in .html")
    console = options.console
    with OutputGuard(console) as guard:
        guard.protect(*artifacts)
        guard.guard_file(output, options.force)
        given = _read(artifacts)
        files = files_to_read({"artifacts": artifacts})
        _require_luminance(given, options.at)
        title, lead, sections = _compose(given, options, console)
        page = render_page(title, lead, sections).encode()
        write_whole(output, page)
        if reason := cache_warning():
            console.warn(reason)
        much = "; report on fewer files to make the page smaller" if len(page) > MAX_PAGE_BYTES else ""
        console.info(f"{output}: {len(page) / 1e6:.2f} MB, {len(sections)} sections{much}")
        return files.and_wrote(output)


# --------------------------------------------------------------------------------------------------------- the files


def _read(paths: tuple[Path, ...]) -> Given:
    """Read all files. Files with the same content are read as one.

    Raises InputFileError if a table and a training set for its evaluation have different outputs.
    """
    entries: dict[str, Entry] = {}
    sequences: dict[str, dict[str, Any]] = {}
    sums: dict[str, str] = {}
    for path, name in zip(paths, short_names(paths), strict=True):
        if path.suffix.lower() == SEQUENCE_SUFFIX:
            sequences[name], sums[name] = read_sequence_figures(path).document(), sha256(path)
            continue
        artifact, digest = _artifact(path), sha256(path)
        entries.setdefault(digest, Entry(name, path, digest, artifact))
    given = Given(list(entries.values()), sequences, sums)
    for pair in given.pairs:
        if pair.transforms.outputs != pair.head.outputs:
            raise InputFileError(
                f"{pair.table.path} and {pair.frames.path} have different outputs; use a table and a training set with the "
                "same outputs"
            )
    return given


def _artifact(path: Path) -> Artifact:
    with open_artifact(path) as root:
        kind = str(root.attrs["kind"])
    if kind not in KINDS:
        raise InputFileError(
            f"{path} is {a(kind)}, which a report cannot show; use camera models, training sets, transform tables or designs"
        )
    if KINDS[kind] is not TrainingSet:
        return load(KINDS[kind], path)
    with open_training_set(path, unchanged=True) as reader:
        return reader.head


# ------------------------------------------------------------------------------------------------------- the page


def _require_luminance(given: Given, at: float | None) -> None:
    """Raise RecipeError if a training set for an evaluation has no frame at the luminance `at`, in cd/m²."""
    if at is None:
        return
    for path in dict.fromkeys(pair.frames.path for pair in given.pairs):
        with open_training_set(path, unchanged=True) as reader:
            known = sorted({reader.light(index).luminance for index in range(len(reader))})
        if not any(lit_as(luminance, at) for luminance in known):
            held = ", ".join(tidy(np.pi * luminance) for luminance in known)
            raise RecipeError(
                f"{path} has no frame at ‹at› {tidy(np.pi * at)} lux; choose one of its illuminances: {held} lux"
            )


def _compose(given: Given, options: ReportOptions, console: Console) -> tuple[str, str, list[Section]]:
    """Evaluate the tables, and return the title, lead and sections of the page.

    The order of the sections is: pictures, artifacts grouped by CFA, sequences, designs, and the history of all files.
    """
    arrays, tables = given.arrays, given.of(TransformTable)
    _warn_of_arrays(given, console)
    pairs = len(given.pairs)
    shares = PICTURE_BYTES // (pairs + (pairs > 1) or 1), PIXEL_BYTES // (pairs or 1), CLASS_BYTES // (pairs or 1)
    judged: list[Judged] = []
    sections: list[Section] = []
    cameras_of = [
        [(entry.name, camera) for entry, camera in array.of(CameraModel)] or cameras_within(array) for array in arrays
    ]
    cameras = [camera for each in cameras_of for _, camera in each]
    called = [camera.name for camera in cameras]
    for array, held in zip(arrays, cameras_of, strict=True):
        _warn_of_cameras(array, console)
        judged_pairs = [
            _judge(pair, str(len(judged) + number), shares, options, console) for number, pair in enumerate(array.pairs)
        ]
        sections += _array_sections(array, held, called, THUMBNAIL_BYTES // max(len(given.of(TrainingSet)), 1))
        sections += [each.section for each in judged_pairs]
        judged += judged_pairs
    first = [each.front for each in judged if each.front is not None]
    if len(judged) > 1:
        first.insert(0, _side_by_side(judged, shares[0], options))
    files = [(entry.name, entry.artifact.kind, entry.sha256, entry.artifact.history) for entry in given.entries]
    if given.sequences:
        sections.append(sequence_section(given.sequences))
        files += [(name, "evaluation of a sequence", digest, ()) for name, digest in given.sequence_sums.items()]
    designs = given.of(Design)
    sections += [design_section(design, entry.name, jpeg) for entry, design in designs]
    sections.append(history_section(files))
    if designs and not judged:
        return f"{', '.join(design.name for _, design in designs)}: report", " ".join(designs[0][1].verdict), sections
    names = called or [table.camera_name for _, table in tables] or [*given.sequences]
    if len(judged) > 1:
        lead = " ".join((first[0].lead, *(f"But {each.warning}." for each in judged if each.warning)))
    else:
        lead = judged[0].section.lead if judged else lead_without_evaluation(given)
    return f"{', '.join(dict.fromkeys(names))}: report", lead, [*first, *sections]


def _array_sections(given: Given, cameras: list[tuple[str, CameraModel]], called: list[str], limit: int) -> list[Section]:
    """Return the sections about cameras, training sets and tables with the same CFA.

    Parameters
    ----------
    given : Given
        The artifacts with this CFA.
    cameras : list of (str, CameraModel)
        File name and camera of each camera with this CFA.
    called : list of str
        Names of all cameras on the page. Headings of cameras with the same name also contain the file names.
    limit : int
        Maximum size of each training set's pictures, in bytes.
    """
    sections = [camera_section(camera, figures_of_camera(camera), name) for name, camera in cameras]
    for number, (name, camera) in enumerate(cameras):
        if called.count(camera.name) > 1:
            sections[number] = replace(sections[number], title=f"{sections[number].title} ({name})")
    for entry, _ in given.of(TrainingSet):
        with open_training_set(entry.path, unchanged=True) as reader:
            sections.append(training_section(reader, entry.name, role_of(given, entry), limit, jpeg))
    light = channel_light(cameras[0][1]) if cameras else None
    return sections + [
        transform_section(table, light, insight(table), functools.partial(class_name, table), entry.name)
        for entry, table in given.of(TransformTable)
    ]


def figures_of_camera(camera: CameraModel) -> dict[str, Any]:
    """Return the output of `l3 calibrate --json` for a camera, with the additional entry "shortfall".

    This entry states why a calibration should not be used. It is "" if the calibration is usable or the camera was not
    calibrated.
    """
    doubt = shortfall(camera) if camera.fit else None
    return figures(camera) | {"shortfall": (doubt or "").partition(";")[0]}


def _warn_of_arrays(given: Given, console: Console) -> None:
    """Warn about training sets that cannot be evaluated, because no table has the same CFA."""
    tables = [entry for entry, _ in given.of(TransformTable)]
    for entry, _ in given.of(TrainingSet) if tables else ():
        if all(entry.array != table.array for table in tables):
            names = ", ".join(table.name for table in tables)
            console.warn(
                f"{entry.name} has a different colour filter array from {names}, so it is not used for evaluation; add a "
                "table for this array"
            )


def _warn_of_cameras(given: Given, console: Console) -> None:
    """Warn about cameras that differ from the camera of the first table or, without tables, of the first file."""
    tables, cameras = given.of(TransformTable), given.of(CameraModel)
    held = [(entry, head.camera) for entry, head in given.of(TrainingSet)]
    known: Sequence[tuple[Entry, Any]] = [*tables, *cameras, *held]
    for entry, camera in cameras if tables else [*cameras, *held]:
        if entry is not known[0][0] and (differences := camera_differences(known[0][1], camera)):
            text = f"the cameras differ in {differences}; make a separate report for each camera"
            console.warn(f"{entry.name} and {known[0][0].name} are for different cameras: {text}")


# ------------------------------------------------------------------------------------------------------ evaluation


@dataclass(frozen=True)
class Judged:
    """Result of the evaluation of a table on a training set."""

    pair: Pair
    document: dict[str, Any]  # output of `l3 evaluate --json`
    front: Section | None  # section with pictures; None if the outputs are neither colours nor Stokes parameters
    warning: str | None  # reason to distrust the evaluation

    @property
    def section(self) -> Section:
        """Section with the metrics of the evaluation."""
        section = evaluation_section(
            self.document, (self.pair.table.name, self.pair.frames.name), self.pair.head.camera.rows
        )
        return replace(section, lead=f"{section.lead} But {self.warning}.") if self.warning else section


def _judge(pair: Pair, anchor: str, limits: tuple[int, int, int], options: ReportOptions, console: Console) -> Judged:
    """Evaluate a table on the frames of a training set, and create the section with pictures.

    Pictures are shown only if the outputs are X, Y, Z or include Stokes parameters.

    Parameters
    ----------
    pair : Pair
        The table and the training set.
    anchor : str
        Identifier of this pair, unique on the page.
    limits : (int, int, int)
        Maximum sizes in bytes of the pictures, the pixel viewer, and the filters of additional classes.
    options : ReportOptions
        Options of `l3 report`.
    console : Console
        Receives warnings and progress.
    """
    table = (pair.table.name, pair.transforms)
    transforms, warning = for_frames(table, (pair.frames.name, pair.head.camera), console)
    renderers = FrameRenderers(options.backend, transforms, console)
    with open_training_set(pair.frames.path, unchanged=True) as reader:
        judgement = Evaluation(transforms, reader.head, drawn=frames_like(reader.head))
        pictures, chart, front = transforms.outputs == XYZ, None, None
        for index in console.progress(range(len(reader)), len(reader), "frames"):
            frame, planes = evaluate_frame(judgement, renderers, reader, index)
            if pictures and chart is None:
                chart = chart_subsection(frame, index, planes, pair.head)
        by_gain = figures_by_gain(pair.transforms, reader, options.backend, console)
        figures = document_of(judgement, renderers, reader.head, by_gain)
        if pictures:
            last = {len(reader) - 1: frame_pictures(frame, planes)}
            shown = {
                index: last[index] if index in last else _pictures(judgement, renderers, reader, index)
                for index in shown_frames(figures, options.at)
            }
            pixels = _pixels(reader, renderers, anchor, *next(iter(shown.items())), limits)
            below = (*([chart] if chart else []), pixels)
            title = f"Pictures: {pair.table.name} on {pair.frames.name}"
            front = front_section(figures, shown, title, anchor, limits[0], jpeg, below, options.at)
        elif has_stokes(transforms.outputs):
            maps = {}
            for index in shown_frames(figures, options.at):
                frame, planes = evaluate_frame(judgement, renderers, reader, index, counted=False)
                maps[index] = polarisation_maps(frame.target, planes, transforms.outputs)
            title = f"Polarisation: {pair.table.name} on {pair.frames.name}"
            front = polarisation_section(figures, maps, title, anchor, limits[0], jpeg)
    return Judged(pair._replace(transforms=transforms), figures, front, warning)


def _pictures(evaluation: Evaluation, renderers: FrameRenderers, reader: TrainingSetReader, index: int) -> dict[str, Pixels]:
    return frame_pictures(*evaluate_frame(evaluation, renderers, reader, index, counted=False))


def _pixels(
    reader: TrainingSetReader,
    renderers: FrameRenderers,
    anchor: str,
    index: int,
    pictures: dict[str, Pixels],
    limits: tuple[int, int, int],
) -> Subsection:
    """Create the pixel viewer, which shows the class, filter and values of each pixel in a crop of a frame."""
    frame = reader.frame(index)
    renderer, raw = renderers.of(frame), raw_of(frame, index, reader.head.camera)
    table = renderer.table
    labels = [renderer.labels(raw, number) for number in range(len(table.layers))]
    crop, text = crop_of(table, reader.head.camera, labels, *limits[1:])
    cropped = {name: pictures[name] for name in CROPPED if name in pictures}
    return Subsection("Pixels", (picker(f"{anchor}-{index}", crop, text, cropped, frame.scene, jpeg),))


def chart_subsection(frame: TrainingPair, number: int, planes: dict[str, NDArray], head: TrainingSet) -> Subsection | None:
    """Create a figure and a table of the colour errors on a frame's ColorChecker. Returns None without a chart.

    Parameters
    ----------
    frame : TrainingPair
        A frame of the training set.
    number : int
        Index of the frame in the training set.
    planes : dict of str to ndarray, (output, row, col)
        Outputs of each pipeline for this frame. The first pipeline is the transform table.
    head : TrainingSet
        Header of the training set.
    """
    light = head.target_light or frame.light
    size = frame.raw.shape[0], frame.raw.shape[1]
    regions = next((each for each in chart_places(size) if holds_chart(frame, light, each)), None)
    if regions is None:
        return None
    colours = patch_colours(frame, planes, regions)
    ours = next(iter(planes))
    luminance = f", {tidy(frame.luminance)} cd/m²" if frame.shown else ""
    title = f"Patches in frame {number + 1}, {frame.scene}, {frame.illuminant}{luminance}"
    figure = patches_figure(title, ("ideal", ours), (colours.ideal, colours.shown[ours]), colours.delta_e)
    return Subsection("Colour chart", (Figures((figure,)), patches_table(colours.delta_e)))


def _side_by_side(judged: list[Judged], limit: int, options: ReportOptions) -> Section:
    """Create the section that compares all tables, with pictures of at most `limit` bytes."""
    sides = [Side(each.pair.table.name, each.pair.frames.name, each.pair.head.camera, each.document) for each in judged]
    pictures, chosen = [], shared_frame(sides, options.at)
    for each, index in zip(judged, chosen, strict=False):
        with open_training_set(each.pair.frames.path, unchanged=True) as reader:
            renderers = FrameRenderers(options.backend, each.pair.transforms, Silent())  # messages were already printed
            pictures.append(_pictures(Evaluation(each.pair.transforms, reader.head), renderers, reader, index))
    return side_by_side_section(sides, chosen, pictures, limit, jpeg)


# ------------------------------------------------------------------------------------------------- camera recipes


def plot(judged: Sequence[Judgement], output: Path, options: CheckOptions) -> None:
    """Write a page with the CFA, responsivities and noise of each camera recipe that has no faults.

    Parameters
    ----------
    judged : sequence of Judgement
        Results of `l3 check`. Camera recipes with faults, and recipes of other types, are skipped.
    output : Path
        The page. Its file name must end in .html.
    options : CheckOptions
        Options of `l3 check`.

    Raises
    ------
    RecipeError
        If there is no camera recipe without faults, or if the file name of the output does not end in .html.
    L3Error
        If the page cannot be written.
    """
    paths = [judgement.path for judgement in judged if judgement.kind == CAMERA and not judgement.findings]
    if output.suffix != ".html":
        raise RecipeError(f"‹plot› {output} is not the name of an HTML page; use a file name that ends in .html")
    if not paths:
        raise RecipeError(f"‹plot› {output} needs a camera recipe without faults; correct the recipe, or remove ‹plot›")
    with OutputGuard(options.console) as guard:
        guard.protect(*(file for each in judged for file in (each.path, *each.files)))
        guard.protect(*(file for path in paths for file in camera_files(path)))
        guard.guard_file(output, options.force)
        cameras = [(path, load_camera(path)) for path in paths]
        sections = [camera_section(camera, figures_of_camera(camera), path.name) for path, camera in cameras]
        title = ", ".join(camera.name for _, camera in cameras)
        write_whole(output, render_page(title, "Described by recipes, not measured.", sections).encode())
        options.console.info(f"{output}: {len(cameras)} camera{'s' if len(cameras) > 1 else ''}")
