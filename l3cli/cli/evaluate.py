"""l3 evaluate: a table's quality on frames with known targets."""

import dataclasses
import json
from pathlib import Path

import click
import numpy as np

from l3cli.cli import options


@click.command()
@click.argument("table", type=options.FILE, metavar="TABLE.h5")
@click.argument("frames", type=options.FILE, metavar="TRAINING.h5")
@click.option("--backend", default="opencl", show_default=True, help="Renderer: opencl or reference.")
@options.as_json
@options.quiet
def evaluate(table: Path, frames: Path, backend: str, as_json: bool, quiet: bool) -> None:
    """Render the raw frames of a training set that TABLE was not trained on and compare them with their targets.

    Pictures are compared as displayed: adapted to D65, the 99th percentile of the target's luminance shown as white.

    Example: l3 evaluate table.h5 unseen.h5 --json
    """
    from l3cli.artifacts.base import load
    from l3cli.artifacts.table import TransformTable
    from l3cli.artifacts.training_set import open_training_set
    from l3cli.errors import InputFileError
    from l3cli.evaluate.quality import quality
    from l3cli.frame import RawFrame
    from l3cli.render.renderer import make_renderer

    transforms = load(TransformTable, table)
    results = []
    with open_training_set(frames) as reader:
        camera = reader.head.camera
        if camera.channels != transforms.channels or not np.array_equal(camera.cfa, transforms.cfa):
            raise InputFileError(f"{frames} is of a camera with another CFA than {table}; evaluate a matching pair")
        if transforms.outputs != ("X", "Y", "Z") or reader.head.outputs != ("X", "Y", "Z"):
            raise InputFileError(f"{table} or {frames} is not of CIE XYZ; other outputs cannot be compared yet")
        renderer = make_renderer(backend, transforms)
        for frame in options.progress(reader, len(reader), "frames", quiet):
            rendered = renderer.outputs(RawFrame(frame.scene, frame.raw, camera.black, camera.white))
            unit = transforms.output_unit / frame.exposure
            found = quality(rendered * unit, frame.target, frame.white, transforms.rule.radius)
            level = float(frame.raw.mean() - camera.black) / (camera.white - camera.black)
            about = {"scene": frame.scene, "illuminant": frame.illuminant, "luminance": frame.luminance, "level": level}
            results.append({**about, **dataclasses.asdict(found)})
    figures = [field for field in results[0] if field.endswith("delta_e") or field == "psnr"]
    mean = {figure: float(np.mean([result[figure] for result in results])) for figure in figures}
    if as_json:
        click.echo(json.dumps({"frames": results, "mean": mean}, indent=2))
        return
    click.echo(f"{'scene':28} {'light':>8} {'level':>6} {'ΔE00 mean':>10} {'median':>7} {'95 %':>6} {'PSNR dB':>8}")
    for result in results:
        click.echo(f"{result['scene'][:28]:28} {result['illuminant']:>8} {result['level']:6.3f} {_figures(result)}")
    click.echo(f"{'mean':28} {'':>8} {'':>6} {_figures(mean)}")


def _figures(of: dict) -> str:
    return f"{of['mean_delta_e']:10.2f} {of['median_delta_e']:7.2f} {of['p95_delta_e']:6.2f} {of['psnr']:8.2f}"
