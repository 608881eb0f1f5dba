"""Times of frames on this machine."""

from typing import Any

from l3cli.options.tools import BenchOptions
from l3cli.rendering import benchmark
from l3cli.rendering.opencl.devices import cache_warning, survey


def measure(options: BenchOptions) -> dict[str, Any]:
    """Return the document of `l3 bench --json`: the OpenCL devices and the times of rendering, case by case ("results").

    With a `variant` it is the only one to time. DeviceError if there is no such device.
    """
    devices = survey()
    jobs = benchmark.jobs(options.device, options.variant)
    results = [job() for job in options.console.progress(jobs, len(jobs), "cases")]
    if reason := cache_warning():
        options.console.warn(reason)
    return {"devices": devices, "results": results}
