"""l3 bench: the OpenCL devices, and the times of rendering, simulation and training."""

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
    """Time the rendering of synthetic frames on an OpenCL device, uint16 in host memory to sRGB in host memory, and
    simulation and training on one core of the processor.

    Rendering: medians of 20 frames. With a C compiler (CC or cc) each frame is timed in turn with the bare multiply-adds of
    its transforms on all cores, hand-vectorised: "limit" is the median of their ratio. The variant for the other type of
    device and the numpy reference get small frames. Peers: the same transforms by a naive kernel, a work-item a pixel;
    Menon's demosaicing, where colour-demosaicing is installed. Simulation: the fastest of 5 frames. Training:
    the faster of 2 runs, both passes.

    \b
    Example: l3 bench --device 0 --json
    """
    if list_only:
        from l3cli.rendering.opencl_devices import survey

        devices = survey()
        return Result({"devices": devices}, lambda: show(*devices))
    from l3cli.stages.benchmark import measure

    document = measure(console, device=device, variant=variant)
    return Result(document, lambda: _text(document))


def _text(document: dict[str, Any]) -> None:
    show(*document["devices"])
    _rendering(document["results"])
    _comparison(document)
    _simulation(document["simulate"])
    _training(document["train"])


def _rendering(results: list[dict[str, Any]]) -> None:
    longest = max(results, key=lambda result: len(result["stages_ms"]))
    stages, rows = list(longest["stages_ms"]), []
    for number, result in enumerate(results, 1):
        times = [f"{result['stages_ms'][stage]:.2f}" if stage in result["stages_ms"] else "" for stage in stages]
        limit = f"{result['limit_ratio']:.2f}" if "limit_ratio" in result else ""
        what = [
            str(number),  # identifies rows where the table is divided
            f"{result['width']}×{result['height']}",
            *(str(result[key]) for key in ("patch", "classes", "outputs", "variant")),
        ]
        rows.append([*what, *times, f"{result['frame_ms']:.2f}", f"{result['mp_per_s']:.1f}", limit])
    headings = ["", "frame", "patch", "classes", "outputs", "variant", *stages, "whole", "MP/s", "limit"]
    show_table(
        ["", "rendering, ms a frame; limit: fastest, times the fastest bare multiply-adds"],
        headings,
        rows,
    )


def _comparison(document: dict[str, Any]) -> None:
    rows = []
    for result in document["results"]:
        if "stages_sum_ms" in result:
            what = [
                f"{result['width']}×{result['height']}",
                *(str(result[key]) for key in ("channels", "patch", "classes", "variant")),
            ]
            limit = [f"{result[key]:.2f}" for key in ("limit_ms", "limit_ratio") if key in result] or [
                result["no_limit"],
                "",
            ]
            rows.append([*what, f"{result['frame_ms']:.2f}", f"{result['stages_sum_ms']:.2f}", *limit])
    headings = ["case", "channels", "patch", "classes", "variant", "frame", "sum of stages", "limit", "ratio"]
    show_table(
        [
            "",
            "a frame, the sum of its stages: medians, ms; limit and ratio: of the fastest",
        ],
        headings,
        rows,
    )
    rows = []
    for peer in document["peers"]:
        size = f"{peer['width']}×{peer['height']}"
        rows.append([peer["peer"], size, str(peer["patch"]), f"{peer['theirs']:.3g}", f"{peer['ours']:.3g}", peer["unit"]])
        rows[-1].append(f"{peer['ratio']:.1f}")
    show_table(["", "peers"], ["peer", "case", "patch", "theirs", "l3", "unit", "ratio"], rows)
    for what, ratio in document["five_against_nine"].items():
        show(f"{what} of a Bayer array: 5×5 {ratio:.2f} times as fast as 9×9")


def _simulation(results: list[dict[str, Any]]) -> None:
    rows = []
    for result in results:
        what = [f"{result['width']}×{result['height']}", str(result["channels"]), "on" if result["optics"] else "off"]
        rows.append([*what, f"{result['frame_ms']:.1f}", f"{result['mp_per_s']:.2f}", f"{result['peak_mb']:.0f}"])
    headings = ["frame", "channels", "optics", "whole ms", "MP/s", "peak MB"]
    show_table(["", "simulation on one core, 31 bands, noise and targets"], headings, rows)


def _training(results: list[dict[str, Any]]) -> None:
    if not results:
        return
    stages = list(results[0]["stages_ns"])
    rows = []
    for result in results:
        what = [str(result[key]) for key in ("patches", "channels", "rows")]
        times = [f"{result['stages_ns'][stage]:.0f}" for stage in stages]
        rows.append([*what, f"{result['cpu_s']:.1f}", f"{result['rows_per_s']:.0f}", *times, f"{result['peak_mb']:.0f}"])
    headings = ["patches", "channels", "rows", "CPU s", "rows/s", *stages, "peak MB"]
    show_table(["", "training on one core, both passes; stages: nanoseconds a patch and level"], headings, rows)
