"""The calibration stage: lab measurements → camera model."""

import itertools
import shlex
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import camera_files, load_camera
from l3cli.artifacts.store import save
from l3cli.calibration import figures, model
from l3cli.errors import L3Error, RecipeError
from l3cli.export.profiles import ALWAYS, file_names
from l3cli.frames.measurement import FinishedCurves, SweepTable
from l3cli.io.measurements import inputs_of, inputs_of_photos, load_measurements, photo_measurements
from l3cli.io.photos import export_offsets, offset_paths
from l3cli.options.pipeline import CalibrateOptions
from l3cli.parallel import ordered_map
from l3cli.stages.export import write
from l3cli.system.output_guard import OutputGuard
from l3cli.system.plan import Made, before_work


def calibrate(measurements: Path | None, output: Path, options: CalibrateOptions) -> tuple[CameraModel, dict[str, Any]]:
    """Write the camera model of a measurement file, or of raw photos of a chart; the model, and its figures, ready for JSON.

    InputFileError or RecipeError if the measurements cannot be used, L3Error if they give a model that predicts its charts
    badly and is not accepted, or if an output cannot be written.
    """
    photos, light, truth, export = options.photos, options.light, options.truth, options.export
    console, force = options.console, options.force
    if (measurements is None) == (not photos):
        raise RecipeError("give either a measurement file or raw photos of a chart, as ‹photo›")
    if light is not None and measurements is not None:
        raise RecipeError("a measurement file names the light of its photos itself, as light; leave ‹light› out")
    with OutputGuard(console) as claims:
        claims.protect(*photos, *filter(None, [measurements, truth]))
        exports = [export / name for name in ALWAYS] if export else []
        for path in (output, *exports):
            claims.claim_file(path, force)
        inputs = inputs_of_photos(photos) if measurements is None else inputs_of(measurements)
        claims.protect(*itertools.chain(*inputs.files.values()), *(camera_files(truth) if truth else ()))
        true = load_camera(truth) if truth else None
        measured = photo_measurements(photos, light) if measurements is None else load_measurements(measurements)
        if export:
            exports = [export / name for name in file_names(measured.body.channels, measured.body.cfa)]
            exports += offset_paths(export, measured.photos)
            for path in exports[len(ALWAYS) :]:
                claims.claim_file(path, force)
        before_work(
            inputs.files | {"camera to compare with": camera_files(truth) if truth else []},
            Made(output, f"camera model of {len(measured.body.channels)} channels"),
            *(Made(path, "export") for path in exports),
        )

        def each(function: Callable[[Any], Any], captures: Iterable[Any]) -> Iterator[Any]:
            captures = list(captures)
            return console.progress(ordered_map(function, captures, options.jobs), len(captures), "captures")

        camera = model.calibrate(measured, each)
        earlier = measured.base.history if measured.base else ()
        shortfall = None if measured.base else figures.shortfall(camera)
        if shortfall and not options.accept:
            culprit = "" if measurements is None else f"{measurements}: "
            raise L3Error(f"{culprit}{shortfall}, or add ‹accept›")
        history = inputs.history(({"light": None} if photos else {}) | options.chosen())
        camera = replace(camera, history=(*earlier, history))
        result: dict[str, Any] = figures.figures(camera)
        if true is not None:
            result["truth"] = figures.compare(camera, true)
        save(camera, output)
        result["curves"] |= {"file": str(output), "csv": None}
        if export:
            result["curves"]["csv"] = str(exports[0])
            result["matrices"] = write(camera, export, console)
            if measured.photos:
                export_offsets(camera, measured.photos, export)
        if shortfall:
            console.info(f"accepted although {shortfall.partition(';')[0]}")
        if result["saturation reached"] is False:
            console.info("no white frame saturates: the converter's last value is taken for it; add one exposed longer")
        if isinstance(measured.curve, FinishedCurves) and measured.curve.note:
            console.info(measured.curve.note)
        if measured.curve is not None and not camera.responsivity_band.any():
            light = "photodiode" if isinstance(measured.curve, SweepTable) else "lamp_drift"
            console.info(f"no confidence band: to have one, state [uncertainty] {light} and wavelength_nm")
        csv = result["curves"]["csv"] or f"l3 export {shlex.quote(str(output))} -o DIR"
        console.info(f"{output}: written, with the curves as dataset responsivity; as CSV: {csv}")
        return camera, result
