"""l3 calibrate: lab measurements → camera model."""

import itertools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from l3cli.cli import options, terminal
from l3cli.cli.terminal import show, show_json

if TYPE_CHECKING:
    from l3cli.stages.console import Console


@click.command()
@click.argument("measurements", type=options.FILE, metavar="MEASUREMENTS.toml")
@options.output("Camera model to write")
@click.option("--truth", type=options.CAMERA, metavar="CAMERA", help="The camera behind a virtual lab, to compare with.")
@click.option("--export", type=options.FILE, metavar="DIR", help="Also write the curves as CSV and as rawtoaces JSON there.")
@click.option("--accept", is_flag=True, help="Write the model even if it predicts its own charts badly.")
@options.jobs
@options.trust
@options.force
@options.quiet
@options.as_json
def calibrate(
    measurements: Path,
    output: Path,
    truth: Path | None,
    export: Path | None,
    accept: bool,
    jobs: int,
    force: bool,
    console: "Console",
    as_json: bool,
) -> None:
    """Find responsivities, gain and noise of a camera from its lab measurements.

    \b
    Example: l3 calibrate lab/MEASUREMENTS.toml -o camera.h5
    """
    from l3cli.artifacts.camera_recipe import camera_files, load_camera
    from l3cli.artifacts.store import save
    from l3cli.calibrate import acceptance, figures, model, text
    from l3cli.errors import L3Error
    from l3cli.io.curves import export_curves, export_paths
    from l3cli.io.measurements import inputs_of, load_measurements
    from l3cli.parallel import ordered_map

    claims = options.claims(console)
    claims.spare(measurements, *filter(None, [truth]))
    for path in (output, *(export_paths(export) if export else ())):
        claims.claim_file(path, force)
    inputs = inputs_of(measurements)
    claims.spare(*itertools.chain(*inputs.files.values()), *(camera_files(truth) if truth else ()))
    true = load_camera(truth) if truth else None
    measured = load_measurements(measurements)

    def each(function: Callable[[Any], Any], captures: Iterable[Any]) -> Iterator[Any]:
        captures = list(captures)
        return console.progress(ordered_map(function, captures, jobs), len(captures), "captures")

    camera = model.calibrate(measured, each)
    if (shortfall := acceptance.shortfall(camera)) and not accept:
        raise L3Error(f"{measurements}: {shortfall}, or add --accept")
    camera = replace(camera, history=(inputs.history({"accept": True} if accept else {}),))
    result: dict[str, Any] = figures.figures(camera)
    if true is not None:
        result["truth"] = figures.compare(camera, true)
    save(camera, output)
    if export:
        export_curves(camera, export)
    if as_json:
        show_json(result, console)
    else:
        show(*text.as_text(result, terminal.width()))
    if shortfall:
        console.say(f"accepted although {shortfall.partition(';')[0]}")
    if result["saturation reached"] is False:
        console.say("no white frame saturates: the converter's last value is taken for it; add one exposed longer")
    console.say(f"{output}: written")
