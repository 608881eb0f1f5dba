"""l3 bench: the OpenCL devices, and the times of frames by stage."""

from typing import TYPE_CHECKING, Any

import click

from l3cli.cli import options
from l3cli.cli.results import Result
from l3cli.cli.terminal import show, show_table

if TYPE_CHECKING:
    from l3cli.stages.console import Console


@click.command()
@options.device
@options.variant
@click.option("--list", "list_only", is_flag=True, help="Only list the OpenCL devices, or say why there are none.")
@options.quiet
def bench(device: str | None, variant: str | None, list_only: bool, console: "Console") -> Result:
    """Time the rendering of synthetic frames on an OpenCL device by stage, uint16 in host memory to sRGB in host memory:
    medians of 40 frames. The variant for the other type of device and the numpy reference get small frames.

    \b
    Example: l3 bench --device 0 --json
    """
    if list_only:
        from l3cli.rendering.opencl.devices import survey

        devices = survey()
        return Result({"devices": devices}, lambda: show(*devices))
    from l3cli.stages.benchmark import measure

    document = measure(console, device=device, variant=variant)
    return Result(document, lambda: _text(document))


def _text(document: dict[str, Any]) -> None:
    show(*document["devices"])
    longest = max(document["results"], key=lambda result: len(result["stages_ms"]))
    stages, rows = list(longest["stages_ms"]), []
    for number, result in enumerate(document["results"], 1):
        times = [f"{result['stages_ms'][stage]:.2f}" if stage in result["stages_ms"] else "" for stage in stages]
        what = [
            str(number),  # identifies rows where the table is divided
            f"{result['width']}×{result['height']}",
            *(str(result[key]) for key in ("channels", "patch", "classes", "outputs", "variant")),
        ]
        rows.append([*what, *times, f"{result['frame_ms']:.2f}", f"{result['mp_per_s']:.1f}"])
    headings = ["", "frame", "channels", "patch", "classes", "outputs", "variant", *stages, "whole", "MP/s"]
    show_table(["", "rendering, medians in ms a frame"], headings, rows)
