"""Times of frames on this machine."""

from typing import Any

from l3cli.rendering import benchmark
from l3cli.rendering.opencl.devices import survey
from l3cli.stages.console import Console
from l3cli.stages.input_warnings import warn_of_kernels


def measure(console: Console, *, device: str | None = None, variant: str | None = None) -> dict[str, Any]:
    """Return the document of `l3 bench --json`: the OpenCL devices and the times of rendering, case by case ("results").

    `device`: that renders, by part of its name or its number; `variant`: the only one to time. DeviceError if there is no
    such device.
    """
    devices = survey()
    jobs = benchmark.jobs(device, variant)
    results = [job() for job in console.progress(jobs, len(jobs), "cases")]
    warn_of_kernels(console)
    return {"devices": devices, "results": results}
