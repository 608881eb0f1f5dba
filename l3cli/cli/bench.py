"""l3 bench: how fast frames are rendered here."""

import json
from typing import Any

import click

from l3cli.cli import options


@click.command()
@options.as_json
@options.quiet
def bench(as_json: bool, quiet: bool) -> None:
    """Time the rendering of made-up frames on the OpenCL device, uint16 in host memory to sRGB in host memory.

    Medians of 20 frames. L3_DEVICE names another device by a part of its name or its number.

    Example: l3 bench --json
    """
    from l3cli.render.benchmark import CASES, measure

    results: list[dict[str, Any]] = [measure(case) for case in options.progress(CASES, len(CASES), "cases", quiet)]
    if as_json:
        click.echo(json.dumps({"results": results}, indent=2))
        return
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
