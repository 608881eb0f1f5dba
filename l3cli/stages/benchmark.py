"""How fast frames are rendered, simulated and learned from on this machine."""

import functools
from typing import Any

from l3cli.artifacts.camera_recipe import load_camera
from l3cli.parallel import alone
from l3cli.recipes import known_recipes
from l3cli.rendering import benchmark as rendering
from l3cli.rendering.opencl_devices import survey
from l3cli.simulation import benchmark as simulation
from l3cli.stages.console import Console
from l3cli.stages.input_warnings import warn_of_kernels
from l3cli.training import benchmark as training


def measure(console: Console, *, device: str | None = None, variant: str | None = None) -> dict[str, Any]:
    """The document of `l3 bench --json`: devices, and the cases of rendering ("results"), simulation and training.

    `device`: that renders, by part of its name or its number; `variant`: the only one to time. DeviceError if there is no
    such device.
    """
    devices = survey()
    jobs = rendering.jobs(device, variant)
    results = [job() for job in console.progress(jobs, len(jobs), "cases")]
    warn_of_kernels(console)
    camera = load_camera(known_recipes("cameras")["fiveband"])
    simulated, trained = (
        [
            alone(functools.partial(room.measure, camera), case)
            for case in console.progress(room.CASES, len(room.CASES), what)
        ]
        for room, what in ((simulation, "simulations"), (training, "trainings"))
    )
    return {"devices": devices, "results": results, "simulate": simulated, "train": trained}
