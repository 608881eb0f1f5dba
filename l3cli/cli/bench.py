"""l3 bench: which devices there are, and how fast frames are rendered, simulated and learned from."""

import json
from typing import Any

import click

from l3cli.cli import options


@click.command()
@options.device
@options.variant
@click.option("--list", "list_only", is_flag=True, help="List the OpenCL devices, or why there are none, and end.")
@options.as_json
@options.quiet
def bench(device: str | None, variant: str | None, list_only: bool, as_json: bool, quiet: bool) -> None:
    """Time the rendering of made-up frames on an OpenCL device, uint16 in host memory to sRGB in host memory, and on
    one core of the processor their simulation and training.

    Rendering: medians of 20 frames. With a C compiler (CC or cc) each frame is timed in turn with the bare multiply-adds of
    its transforms on all cores, hand-vectorised: "limit" is the median of their ratio. The variant that is not made for the
    device and the numpy reference get small frames. Simulation: the fastest of 5
    frames. Training: the faster of 2 runs, both passes.

    Example: l3 bench --device 0 --json
    """
    from l3cli.parallel import alone
    from l3cli.render import benchmark as rendering
    from l3cli.render.opencl_devices import survey
    from l3cli.simulate import benchmark as simulation
    from l3cli.train import benchmark as training

    found = survey()
    if list_only:
        click.echo(json.dumps({"devices": found}, indent=2) if as_json else "\n".join(found))
        return
    jobs = rendering.jobs(device, variant)
    results: list[dict[str, Any]] = [job() for job in options.progress(jobs, len(jobs), "cases", quiet)]
    simulated: list[dict[str, Any]] = []
    for case in options.progress(simulation.CASES, len(simulation.CASES), "simulations", quiet):
        simulated.append(alone(simulation.measure, case))
    trained = [
        alone(training.measure, case) for case in options.progress(training.CASES, len(training.CASES), "trainings", quiet)
    ]
    if as_json:
        document = {"devices": found, "results": results, "simulate": simulated, "train": trained}
        click.echo(json.dumps(document, indent=2))
        return
    click.echo("\n".join(found))
    _rendering(results)
    _simulation(simulated)
    _training(trained)


def _rendering(results: list[dict[str, Any]]) -> None:
    stages = list(results[0]["stages_ms"])
    click.echo("\nrendering, milliseconds a frame; limit: times the bare multiply-adds")
    click.echo(
        f"{'frame':>9} {'patch':>5} {'classes':>7} {'outputs':>7} {'variant':>9} "
        + " ".join(f"{stage:>10}" for stage in stages)
        + f" {'whole':>8} {'MP/s':>6} {'limit':>5}"
    )
    for result in results:
        what = f"{result['width']}×{result['height']}"
        times = " ".join(f"{result['stages_ms'][stage]:10.2f}" for stage in stages)
        limit = f"{result['limit_ratio']:5.2f}" if "limit_ratio" in result else f"{'':>5}"
        click.echo(
            f"{what:>9} {result['patch']:>5} {result['classes']:>7} {result['outputs']:>7} {result['variant']:>9} {times} "
            f"{result['frame_ms']:8.2f} {result['mp_per_s']:6.1f} {limit}"
        )


def _simulation(results: list[dict[str, Any]]) -> None:
    click.echo("\nsimulation on one core, 31 bands, noise and targets")
    click.echo(f"{'frame':>10} {'channels':>8} {'optics':>6} {'whole ms':>9} {'MP/s':>6} {'peak MB':>8}")
    for result in results:
        size, optics = f"{result['width']}×{result['height']}", "on" if result["optics"] else "off"
        figures = f"{result['frame_ms']:9.1f} {result['mp_per_s']:6.2f} {result['peak_mb']:8.0f}"
        click.echo(f"{size:>10} {result['channels']:>8} {optics:>6} {figures}")


def _training(results: list[dict[str, Any]]) -> None:
    if not results:
        return
    stages = list(results[0]["stages_ns"])
    click.echo("\ntraining on one core, both passes; stages: nanoseconds a row (a patch at one of its levels)")
    click.echo(
        f"{'patches':>8} {'channels':>8} {'rows':>9} {'CPU s':>6} {'rows/s':>9} "
        + " ".join(f"{stage:>8}" for stage in stages)
        + f" {'peak MB':>8}"
    )
    for result in results:
        times = " ".join(f"{result['stages_ns'][stage]:8.0f}" for stage in stages)
        click.echo(
            f"{result['patches']:>8} {result['channels']:>8} {result['rows']:>9} {result['cpu_s']:6.1f} "
            f"{result['rows_per_s']:9.0f} {times} {result['peak_mb']:8.0f}"
        )
