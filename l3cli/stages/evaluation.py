"""The `l3 evaluate` stage, which evaluates a table on frames with known targets, or a rendered video over time."""

import contextlib
import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import (
    TrainingFrame,
    TrainingPair,
    TrainingSet,
    TrainingSetReader,
    frame_name,
    open_training_set,
)
from l3cli.errors import InputFileError, RecipeError, listed, raised_as
from l3cli.evaluation import standards
from l3cli.evaluation.camera_match import camera_differences
from l3cli.evaluation.evaluation import OURS, Evaluation, raw_of, require_cfa, white_of
from l3cli.evaluation.pictures import frame_pictures, planes_of
from l3cli.evaluation.quality import VIEWING
from l3cli.evaluation.sequence import CELL, SequenceEvaluation, SequenceFigures
from l3cli.frames.scene import NO_ILLUMINANT, SHOWN, Scene
from l3cli.io.pictures.registry import write_picture
from l3cli.io.scenes import rgb
from l3cli.io.sequences import find_pictures, paired, picture_files, require_alike
from l3cli.options.commands import EvaluateOptions, SequenceOptions
from l3cli.physics import spectra
from l3cli.physics.correlated_lights import uv
from l3cli.physics.display import XYZ
from l3cli.rendering.conditions import Mix, at_gain, described, gain_of_frames, known_gains, mix_for, mixed
from l3cli.rendering.display import require_xyz
from l3cli.rendering.opencl.devices import cache_warning
from l3cli.rendering.renderer import Renderer, make_renderer
from l3cli.simulation.frame import AtGain, frames_like, simulate, target_of
from l3cli.simulation.light import Light, Target, automatic_exposure, make_light, named_beyond_known
from l3cli.simulation.procedural import slanted_edge, surface_patches
from l3cli.simulation.recipe import Lens
from l3cli.simulation.sensor import expose
from l3cli.system.checkpoint import incomplete_folder, refuse_other_run
from l3cli.system.console import Console, Silent
from l3cli.system.files import FilesUsed, files_to_read, sha256
from l3cli.system.outputs import OutputGuard
from l3cli.system.text import counted

PlanesOf = Callable[[TrainingFrame], dict[str, NDArray[np.floating]]]  # frame → outputs of each pipeline
CHART_LUMINANCE = 1e4  # cd/m², luminance of white on the charts, so high that dark current is negligible
LUX = 1e-9, 1e9  # range of plausible illuminances in lux
# Wavelengths of the simulated charts in nm, so close together that diffraction hardly changes from one to the next.
CHART_BANDS = np.array([*np.arange(SHOWN[0], SHOWN[1], 20.0), SHOWN[1]])


def standard_figures(head: TrainingSet, planes: PlanesOf) -> dict[str, Any]:
    """Compute the sharpness, signal-to-noise ratio and colour uncertainty of pipelines on simulated charts.

    The signal-to-noise ratio is None for cameras with relative responsivities. The colour uncertainty is None for outputs
    other than X, Y, Z, and for cameras without confidence bands.

    Parameters
    ----------
    head : TrainingSet
        Header of a training set, which defines the camera and the outputs for the simulation of the charts.
    planes : callable
        Function that returns the output planes (output, row, col) of a frame for each pipeline, by pipeline name.

    Returns
    -------
    dict
        The entry "standards" in the output of `l3 evaluate --json`, which docs/measurement.md describes.
    """
    camera, outputs = head.camera, head.outputs
    camera = camera.resized(standards.SIDE, standards.SIDE)
    target = target_of(head)
    light = make_light(standards.LIGHT, {}, camera.wavelength).at(CHART_LUMINANCE)
    document: dict[str, Any] = {"edge": {}, "grey": None, "chart": None}
    eye = spectra.xyz_weights(light.wavelength)[1] * light.radiance
    for across in ("rows", "columns"):
        frame = edge_frame(camera, light, across, target)
        made = {name: standards.brightness(each, outputs) for name, each in planes(frame).items()}
        document["edge"][across] = standards.edge_document(made, (camera, light.wavelength, eye), across)
    if camera.absolute:
        document["grey"] = _greys(camera, light, target, outputs, planes)
    if outputs == XYZ and camera.responsivity_band.any():
        document["chart"] = _chart(camera, light, target, planes)
    document["figures"] = standards.figures_of(document)
    return document


def edge_frame(camera: CameraModel, light: Light, across: str, target: Target) -> TrainingFrame:
    """Simulate a noise-free frame of a slanted edge, with automatic exposure.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    light : Light
        The illuminant.
    across : str
        "rows" for a nearly vertical edge, "columns" for a nearly horizontal edge.
    target : Target
        The outputs.
    """
    size = standards.SIDE, standards.SIDE
    cube = slanted_edge(size, CHART_BANDS, standards.ANGLE, standards.DARK_SIDE, standards.BRIGHT_SIDE)
    scene = Scene("edge", CHART_BANDS, cube if across == "rows" else cube.swapaxes(0, 1), NO_ILLUMINANT)
    seconds = automatic_exposure(camera, light, standards.EDGE_FRAME_WHITE)
    return simulate(camera, scene, light, seconds, Lens(), (0,), target, noises="none")


def _chart(camera: CameraModel, light: Light, target: Target, planes: PlanesOf) -> dict[str, Any]:
    """Return the mean colour difference in each pipeline that is due to uncertain responsivities.

    A chart is simulated without noise for `camera`, and for cameras with random responsivities within its confidence bands.
    The pipelines process all frames as if they came from `camera`, and the colours are compared with the colours of the
    frame from `camera`.
    """
    size = standards.SIDE, standards.SIDE
    cube = surface_patches(np.random.default_rng(0), standards.PATCHES, size, CHART_BANDS)
    scene, seconds = (
        Scene("chart", CHART_BANDS, cube, NO_ILLUMINANT),
        automatic_exposure(camera, light, standards.EDGE_FRAME_WHITE),
    )
    seen: dict[str, list[NDArray[np.floating]]] = {}
    for each in (camera, *standards.drawn_cameras(camera, np.random.default_rng(0))):
        frame = simulate(each, scene, light, seconds, Lens(), (0,), target, noises="none")
        for name, made in planes(frame).items():
            seen.setdefault(name, []).append(standards.patch_means(made))
    different = {
        name: [standards.colour_differences(one, first, frame.white) for one in rest]
        for name, (first, *rest) in seen.items()
    }
    return {"cameras": standards.DRAWN, "delta_e": {name: float(np.mean(each)) for name, each in different.items()}}


def _greys(
    camera: CameraModel, light: Light, target: Target, outputs: tuple[str, ...], planes: PlanesOf
) -> dict[str, Any] | None:
    """Measure the signal-to-noise ratio of grey patches at several illuminances.

    Returns None if no channel reaches the reference ratio, or if the dark current alone saturates the pixels.
    """
    side, part = (standards.RAW_SIDE,) * 2, np.s_[: standards.GREY_SIDE, : standards.GREY_SIDE]
    camera, channel = camera.resized(*side), camera.channel_map(side)
    cube = np.full((standards.GREY_SIDE, standards.GREY_SIDE, 2), standards.GREY, np.float32)
    scene = Scene("grey", np.array(SHOWN), cube, NO_ILLUMINANT)
    seconds, lens = standards.EXPOSURE, Lens(diffraction=False)
    frame = simulate(camera, scene, light.at(1 / np.pi), seconds, lens, (0,), target, noises="none")
    if camera.dark_signal(frame.exposure) >= camera.white_level - camera.black_level:
        return None
    noise = standards.GreyNoise.of(camera, frame)
    known = [lux for lux in noise.lux() if lux is not None and LUX[0] < lux < LUX[1]]
    if not known:
        return None
    lux = min(known) * 2.0**standards.OCTAVES
    raw, snr = np.zeros((lux.size, len(camera.channels))), dict[str, NDArray[np.floating]]()
    one_lux, black = frame.electrons[:, 0, 0][channel], camera.black_level + camera.dark_signal(frame.exposure)
    for index, each in enumerate(lux.tolist()):
        values = expose(camera, one_lux * np.float32(each), frame.exposure, np.random.default_rng([1, index]))
        raw[index] = [standards.measured_snr(values[channel == one] - black) for one in range(len(camera.channels))]
        of_lux = dataclasses.replace(frame, raw=values[part], luminance=each / np.pi, white=frame.white * each)
        for name, made in planes(of_lux).items():
            snr.setdefault(name, np.zeros(lux.size))[index] = standards.measured_snr(standards.brightness(made, outputs))
    return standards.grey_document(camera, noise, lux, raw, snr)


FRAMES_PER_LIGHT = 2  # number of frames per illuminant that are evaluated at several gains
MAX_RENDERERS = 8  # size of the cache; consecutive frames have different illuminants and thus different renderers
DECIDING_METRIC = "mean_delta_e"  # a baseline counts as better than the table if this metric is smaller
OTHER_LIGHT = 0.005  # CIE 1960 uv; whites at a larger distance count as different illuminants
ONE_LIGHT = 0.001  # CIE 1960 uv; a training set with a smaller spread of whites has a single illuminant
# if two sequences differ in brightness by more than this factor, the exposure difference dominates the lightness error
DIFFERENT_BRIGHTNESS = 1.05


def evaluate(table: Path, frames: Path, options: EvaluateOptions) -> tuple[dict[str, Any], FilesUsed]:
    """Evaluate a table, untrained baselines and pictures from other programs on the frames of a training set.

    The pictures of all pipelines are written into the folder `options.pictures`, if it is set. Warnings are printed on the
    console, for example if the table was trained on these frames or for another camera.

    Parameters
    ----------
    table, frames : Path
        Transform table and training set.
    options : EvaluateOptions
        Options of `l3 evaluate`.

    Returns
    -------
    dict
        The output of `l3 evaluate --json`.
    FilesUsed
        The files that were read and written.

    Raises
    ------
    InputFileError, RecipeError
        If the table, the frames and the pictures of the rivals do not match.
    L3Error
        If the folder of pictures cannot be written.
    """
    pictures, rivals, console = options.pictures, options.rivals, options.console
    transforms = load(TransformTable, table)
    others = {_name_of(path): (path, picture_files(path)) for path in rivals}
    if len(others) < len(rivals):
        raise RecipeError(
            "two folders of ‹rival› have the same name, but results are listed by the name of the folder; rename one folder"
        )
    with OutputGuard(console) as guard:
        if pictures is not None:
            require_xyz(transforms.outputs)
            guard.protect(table, frames, *itertools.chain(*(files for _, files in others.values())))
            guard.hold_folder(pictures, "*.png")
        with open_training_set(frames) as reader, contextlib.ExitStack() as unfinished:
            at_own, _ = for_frames((table, transforms), (frames, reader.head.camera), console)
            evaluation = Evaluation(
                at_own, reader.head, options.viewing, options.border, tuple(others), frames_like(reader.head)
            )
            for path, files in others.values():
                if len(files) != len(reader):
                    raise InputFileError(
                        f"{path} contains {counted(len(files), 'picture')}, but {frames} contains "
                        f"{counted(len(reader), 'frame')}; provide one picture per frame"
                    )
            if pictures is not None:
                key = options.run_key(sha256(table), sha256(frames), files=picture_files)
                refuse_other_run(pictures, key, options.force)
            theirs = {f"pictures of {name}": files for name, (_, files) in others.items()}
            used, written = files_to_read({"table": [table], "frames": [frames], **theirs}), list[Path]()
            if pictures is not None:
                unfinished.enter_context(incomplete_folder(pictures, key, options.force))
            if any(sha256(frames) in digests for stage in transforms.history for digests in stage.inputs.values()):
                text = "so the metrics are too good; simulate other scenes, or the same scenes with another ‹seed›"
                console.warn(f"{table} was trained on {frames}, {text}")
            renderers = FrameRenderers(options.backend, at_own, console)
            for index in console.progress(range(len(reader)), len(reader), "frames"):
                shown = {name: files[index] for name, (_, files) in others.items()}
                frame, planes = evaluate_frame(evaluation, renderers, reader, index, shown)
                if pictures is not None:
                    for name, picture in frame_pictures(frame, planes).items():
                        written.append(pictures / f"{frame_name(index, frame.scene)}_{name}.png")
                        write_picture(written[-1], picture)
            by_gain = figures_by_gain(transforms, reader, options.backend, console, options.viewing, options.border)
            document = document_of(evaluation, renderers, reader.head, by_gain)
            frames_lights = map(reader.light, range(len(reader)))
            lights = [reader.light(index).illuminant for index in range(reader.simulated)]
            for unknown in named_beyond_known((*lights, standards.LIGHT), reader.head.camera):
                console.warn(unknown)
            warn_of_other_lights(at_own, document, {each.illuminant: each.white for each in frames_lights}, console)
        if reason := cache_warning():
            console.warn(reason)
        return document, used.and_wrote(*written)


def document_of(
    evaluation: Evaluation, renderers: "FrameRenderers", head: TrainingSet, by_gain: Sequence[dict[str, Any]]
) -> dict[str, Any]:
    """Compose the output of `l3 evaluate --json`: metrics of all frames, at several gains, and on simulated charts.

    The metrics on charts are computed here.
    """

    def planes(frame: TrainingPair) -> dict[str, NDArray]:
        return evaluation.developed(frame, renderers.of(frame).outputs(raw_of(frame, 0, head.camera)))

    return evaluation.document(by_gain) | {"standards": standard_figures(head, planes)}


def warn_of_other_lights(
    table: TransformTable, document: dict[str, Any], whites: Mapping[str, NDArray[np.float64]], console: Console
) -> None:
    """Warn if a baseline is better than a table under an illuminant for which the table was not trained.

    Tables with outputs other than XYZ are not checked. Tables that were trained under several illuminants, but have a single
    set of transforms, are not checked either, because they do not store their illuminants.

    Parameters
    ----------
    table : TransformTable
        The table.
    document : dict
        Output of `l3 evaluate --json`. A smaller mean ΔE00 is better.
    whites : mapping of str to ndarray, (output,)
        Outputs of a perfect white under each illuminant of the frames, by illuminant name.
    console : Console
        Receives the warning.
    """
    several = table.light is not None and table.light.spread > ONE_LIGHT
    if table.outputs != XYZ or (several and not table.lights):
        return
    trained = [light.white_point for light in table.lights] or [table.white_point]
    lost: list[str] = []
    for group in document["by_illuminant"]:
        white = uv(whites[group["illuminant"]])
        ours = group[OURS][DECIDING_METRIC]
        better = [name for name in document["pipelines"][1:] if group[name][DECIDING_METRIC] < ours]
        if better and all(np.hypot(*(uv(each) - white)) > OTHER_LIGHT for each in trained):
            lost.append(f"{', '.join(better)} under {group['illuminant']}")
    if lost:
        console.warn(
            f"the table is worse than {listed(lost)}, because it was not trained for this illuminant; add the illuminant to "
            "illuminants in SCENES.toml and to learning.lights in CLASSES.toml"
        )


GAINS = (1.0, 4.0, 16.0, 64.0)  # analog gains at which a table is evaluated


def for_frames(
    table: tuple[object, TransformTable], frames: tuple[object, CameraModel], console: Console
) -> tuple[TransformTable, str]:
    """Adapt a table to the analog gain of a training set, and warn if the table was trained for another camera.

    Parameters
    ----------
    table : (object, TransformTable)
        File name of the table, and the table.
    frames : (object, CameraModel)
        File name of the training set, and its camera.
    console : Console
        Receives the warning.

    Returns
    -------
    TransformTable
        The table with the transforms for the gain of the frames.
    str
        The warning, or "" if there is none.

    Raises
    ------
    InputFileError
        If the CFA of the frames differs from the CFA of the table.
    """
    (name, transforms), (other, camera) = table, frames
    require_cfa(transforms, camera)
    made = at_gain(transforms, gain_of_frames(transforms, camera))
    if not (differences := camera_differences(made, camera)):
        return made, ""
    text = (
        f"{name} was trained for camera {transforms.camera_name}, but {other} contains frames of camera {camera.name}: the "
        f"cameras differ in {differences}; evaluate a table on frames of its own camera"
    )
    console.warn(text)
    return made, text


def figures_by_gain(
    table: TransformTable,
    reader: TrainingSetReader,
    backend: str,
    console: Console,
    viewing: float = VIEWING,
    border: int | None = None,
) -> list[dict[str, Any]]:
    """Evaluate a table on a few frames per illuminant at several analog gains.

    The frames are re-simulated at the gains 1, 4, 16 and 64, as far as the camera's noise is known at these gains.

    Parameters
    ----------
    table : TransformTable
        The table, not adapted to a gain.
    reader : TrainingSetReader
        The training set. Real pairs are ignored.
    backend : str
        Name of the renderer.
    console : Console
        Shows the progress.
    viewing : float
        Samples per degree for S-CIELAB.
    border : int, optional
        Number of pixels that are ignored at each side of the frames.

    Returns
    -------
    list of dict
        Metrics for each gain and illuminant, as in `Evaluation.document`. The list is empty if the noise is known at only
        one gain, or if all frames are real.
    """
    least, most = known_gains(table)
    gains, lights = [gain for gain in GAINS if least <= gain <= most], dict[str, list[int]]()
    for index in range(reader.simulated if len(gains) > 1 else 0):
        lights.setdefault(reader.light(index).illuminant, []).append(index)
    chosen = [index for indices in lights.values() for index in indices[:: -(-len(indices) // FRAMES_PER_LIGHT)]]
    entries: list[dict[str, Any]] = []
    for gain in console.progress(gains, len(gains), "gains") if chosen else ():
        again = AtGain(reader, gain / gain_of_frames(table, reader.head.camera))
        transforms = at_gain(table, gain)
        evaluation = Evaluation(transforms, again.head, viewing, border, drawn=frames_like(again.head))
        renderers = FrameRenderers(backend, transforms, Silent())
        for index in chosen:
            evaluate_frame(evaluation, renderers, again, index)
        entries += ({"gain": gain} | group for group in evaluation.document()["by_illuminant"])
    return entries


class FrameRenderers:
    """A cache of renderers for the frames of a training set.

    If the table has transforms for several illuminants, they are interpolated for each frame's illuminant
    (docs/method.md#several-illuminants). The weights are reported once per illuminant.
    """

    def __init__(self, backend: str, table: TransformTable, console: Console) -> None:
        self._backend, self._table, self._console = backend, table, console
        self._made: dict[Mix | None, Renderer] = {}
        self._reported: set[str] = set()

    def of(self, frame: TrainingPair) -> Renderer:
        """Return the renderer for a frame. If the illuminant is new, report the weights of the interpolation."""
        mix = mix_for(self._table, white_of(frame)) if self._table.lights else None
        if mix and frame.illuminant not in self._reported:
            self._reported.add(frame.illuminant)
            self._console.info(f"frames under {frame.illuminant}: using the transforms for {described(self._table, mix)}")
        if mix not in self._made:
            if len(self._made) == MAX_RENDERERS:
                del self._made[next(iter(self._made))]
            self._made[mix] = make_renderer(self._backend, mixed(self._table, mix))
        return self._made[mix]


def evaluate_frame(
    evaluation: Evaluation,
    renderers: FrameRenderers,
    reader: TrainingSetReader | AtGain,
    index: int,
    rivals: Mapping[str, Path] | None = None,
    counted: bool = True,
) -> tuple[TrainingPair, dict[str, NDArray]]:
    """Render a frame of a training set with every pipeline.

    Parameters
    ----------
    evaluation : Evaluation
        Receives the frame, if `counted` is True.
    renderers : FrameRenderers
        Renderers of the table.
    reader : TrainingSetReader or AtGain
        The training set.
    index : int
        Index of the frame.
    rivals : mapping of str to Path, optional
        Picture file of this frame from each rival pipeline.
    counted : bool
        Whether to add the metrics of the frame to the evaluation.

    Returns
    -------
    TrainingPair
        The frame, with its target converted by `Evaluation.wanted`.
    dict
        Output planes of each pipeline and rival, as in `Evaluation.planes`.
    """
    frame = evaluation.wanted(reader.frame(index))
    theirs = {name: _planes(path, frame) for name, path in (rivals or {}).items()}
    raw, renderer = raw_of(frame, index, reader.head.camera), renderers.of(frame)
    planes = evaluation.planes(frame, renderer.outputs(raw), theirs)
    if counted:
        evaluation.add(frame, planes, renderer.labels(raw))
    return frame, planes


def _planes(path: Path, frame: TrainingPair) -> NDArray[np.floating]:
    """Read the picture that another program (a rival) rendered from a frame.

    Returns
    -------
    ndarray, (3, row, col)
        X, Y and Z in the unit of the target.

    Raises
    ------
    InputFileError
        If the picture and the frame differ in size.
    """
    picture = rgb.read(path)
    if picture.shape[:2] != frame.raw.shape:
        sizes = "×".join(map(str, picture.shape[:2])), "×".join(map(str, frame.raw.shape))
        raise InputFileError(
            f"{path} has {sizes[0]} pixels, but the frame {frame.scene} has {sizes[1]}; provide a picture of the whole frame"
        )
    return planes_of(picture, frame)


def _name_of(rival: Path) -> str:
    """Return the name of a rival pipeline: the name of the folder with its pictures."""
    return (rival if rival.is_dir() else rival.parent).absolute().name


# ------------------------------------------------------------------------------------------------------ sequences


def evaluate_sequence(rendered: Path, options: SequenceOptions) -> tuple[SequenceFigures, FilesUsed]:
    """Evaluate a rendered sequence over time and, optionally, against an ideal sequence with known motion.

    If the sequences differ in brightness, a warning suggests another exposure.

    Parameters
    ----------
    rendered : Path
        Folder of pictures, pattern of file names, or video.
    options : SequenceOptions
        Options of `l3 evaluate`. If `border` is not set, all pixels are evaluated.

    Returns
    -------
    SequenceFigures
        The metrics.
    FilesUsed
        The files that were read.

    Raises
    ------
    InputFileError
        If a sequence cannot be read, or if the sequences differ in frame size or number of frames.
    RecipeError
        If the pictures are too small after the border is removed.
    """
    ideal, console = options.ideal, options.console
    ours = find_pictures(rendered)
    wanted = None if ideal is None else find_pictures(ideal)
    require_alike(ours, wanted)
    margin = options.border or 0
    if min(ours.shape) - 2 * margin < CELL:
        rows, cols = ours.shape
        raise RecipeError(
            f"{rendered} has {rows}×{cols} pixels, so ‹border› {margin} leaves no area of {CELL}×{CELL} pixels; set a "
            "smaller border"
        )
    roles = {"pictures": ours.files, "ideal": wanted.files if wanted else (), "motion": wanted.motion if wanted else ()}
    used = files_to_read(roles)
    evaluation = SequenceEvaluation(str(rendered), None if ideal is None else str(ideal), margin)
    light = np.zeros(2)
    for ours_now, ideal_now, motion in console.progress(paired(ours, wanted), ours.count, "frames"):
        evaluation.add(ours_now, ideal_now, motion)
        light += [ours_now.mean(), 0.0 if ideal_now is None else ideal_now.mean()]
    ratio = light[0] / max(light[1], 1e-9)
    if wanted is not None and not 1 / DIFFERENT_BRIGHTNESS <= ratio <= DIFFERENT_BRIGHTNESS:
        console.warn(
            f"{rendered} is {ratio:.3g} times as bright as {ideal}; multiply ‹exposure› by {1 / ratio:.3g} and render again"
        )
    with raised_as(InputFileError, rendered):
        return evaluation.figures(), used
