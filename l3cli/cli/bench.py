"""l3 bench: lists OpenCL devices, and measures the time that each stage of rendering takes per frame."""

from typing import Any

import click

from l3cli.cli import options as declared
from l3cli.cli.results import Result
from l3cli.cli.terminal import show, show_table
from l3cli.options.commands import BenchOptions


@click.command()
@declared.of(BenchOptions)
def bench(options: BenchOptions) -> Result:
    """Measure how long an OpenCL device takes to render synthetic frames from uint16 raw values to sRGB. The times include
    the transfers from and to host memory. Each time is the median over 40 frames. The numpy reference is also measured, on
    tiny frames.

    \b
    Example: l3 bench --device 0 --json
    """
    if options.list:
        from l3cli.rendering.opencl.devices import survey

        devices = survey()
        return Result({"devices": devices}, lambda: show(*devices))
    from l3cli.stages.information import measure

    document = measure(options)
    return Result(document, lambda: _text(document))


def _text(document: dict[str, Any]) -> None:
    show(*document["devices"])
    longest = max(document["results"], key=lambda result: len(result["stages_ms"]))
    stages, rows = list(longest["stages_ms"]), []
    for number, result in enumerate(document["results"], 1):
        times = [f"{result['stages_ms'][stage]:.2f}" if stage in result["stages_ms"] else "" for stage in stages]
        what = [
            str(number),  # identifies the row after a narrow terminal has split the table
            f"{result['width']}×{result['height']}",
            *(str(result[key]) for key in ("channels", "patch", "classes", "outputs", "variant")),
        ]
        rows.append([*what, *times, f"{result['frame_ms']:.2f}", f"{result['mp_per_s']:.1f}"])
    headings = ["", "frame", "channels", "patch", "classes", "outputs", "variant", *stages, "whole", "MP/s"]
    show_table(["", "rendering, median in ms per frame"], headings, rows)
