"""l3 bench: how fast frames are rendered and simulated here."""

import json
from typing import Any

import click

from l3cli.cli import options


@click.command()
@options.as_json
@options.quiet
def bench(as_json: bool, quiet: bool) -> None:
    """Time the rendering of made-up frames on the OpenCL device, uint16 in host memory to sRGB in host memory, and their
    simulation on one core of the processor.

    Rendering: medians of 20 frames; L3_DEVICE names another device by a part of its name or its number. Simulation: the
    fastest of 5 frames.

    Example: l3 bench --json
    """
    from l3cli.parallel import alone
    from l3cli.render.benchmark import CASES, measure
    from l3cli.simulate import benchmark

    results: list[dict[str, Any]] = [measure(case) for case in options.progress(CASES, len(CASES), "cases", quiet)]
    simulated: list[dict[str, Any]] = []
    for case in options.progress(benchmark.CASES, len(benchmark.CASES), "simulations", quiet):
        simulated.append(alone(benchmark.measure, case))
    if as_json:
        click.echo(json.dumps({"results": results, "simulate": simulated}, indent=2))
        return
    _rendering(results)
    click.echo("\nsimulation on one core, 31 bands, noise and targets")
    click.echo(f"{'frame':>10} {'channels':>8} {'optics':>6} {'whole ms':>9} {'MP/s':>6} {'peak MB':>8}")
    for result in simulated:
        size, optics = f"{result['width']}×{result['height']}", "on" if result["optics"] else "off"
        figures = f"{result['frame_ms']:9.1f} {result['mp_per_s']:6.2f} {result['peak_mb']:8.0f}"
        click.echo(f"{size:>10} {result['channels']:>8} {optics:>6} {figures}")


def _rendering(results: list[dict[str, Any]]) -> None:
    stages = list(results[0]["stages_ms"])
    click.echo(f"{results[0]['device']}; milliseconds a frame")
    click.echo(
        f"{'frame':>10} {'patch':>5} {'classes':>8} "
        + " ".join(f"{stage:>9}" for stage in stages)
        + f" {'whole':>8} {'MP/s':>6}"
    )
    for result in results:
        times = " ".join(f"{result['stages_ms'][stage]:9.2f}" for stage in stages)
        size = f"{result['width']}×{result['height']}"
        speed = f"{result['frame_ms']:8.2f} {result['mp_per_s']:6.1f}"
        click.echo(f"{size:>10} {result['patch']:>5} {result['classes']:>8} {times} {speed}")
