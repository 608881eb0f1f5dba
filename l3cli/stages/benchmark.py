"""How fast frames are rendered, simulated and learned from on this machine."""

import functools
import importlib.util
import time
from typing import Any

import numpy as np

from l3cli.artifacts.camera_recipe import load_camera
from l3cli.evaluation.demosaic import menon
from l3cli.parallel import alone
from l3cli.recipes import known_recipes
from l3cli.rendering import benchmark as rendering
from l3cli.rendering.opencl_devices import survey
from l3cli.simulation import benchmark as simulation
from l3cli.stages.console import Console
from l3cli.stages.input_warnings import warn_of_kernels
from l3cli.training import benchmark as training


def measure(console: Console, *, device: str | None = None, variant: str | None = None) -> dict[str, Any]:
    """The document of `l3 bench --json`: devices, the cases of rendering ("results"), simulation and training, and how long
    others take ("peers", those that are present).

    `device`: that renders, by part of its name or its number; `variant`: the only one to time. DeviceError if there is no
    such device.
    """
    devices = survey()
    jobs = rendering.jobs(device, variant)
    results = [job() for job in console.progress(jobs, len(jobs), "cases")]
    peers = [rendering.measure_naive(rendering.PEER, device, variant), *_menon(results)]
    warn_of_kernels(console)
    camera = load_camera(known_recipes("cameras")["fiveband"])
    simulated, trained = (
        [
            alone(functools.partial(room.measure, camera), case)
            for case in console.progress(room.CASES, len(room.CASES), what)
        ]
        for room, what in ((simulation, "simulations"), (training, "trainings"))
    )
    compared = {"peers": peers, "five_against_nine": rendering.five_against_nine(results)}
    return {"devices": devices, "results": results, **compared, "simulate": simulated, "train": trained}


def _menon(results: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Menon's demosaicing (colour-demosaicing, one thread), where it is installed, against the first frame that was rendered
    of a Bayer array: seconds a megapixel, the faster of two."""
    if importlib.util.find_spec("colour_demosaicing") is None:
        return []
    (ours, *_) = [each for each in results if each["channels"] == rendering.BAYER_CHANNELS]
    rows, cols = ours["height"], ours["width"]
    mosaic, times = np.random.default_rng(0).random((rows, cols)), []
    for _ in range(2):
        start = time.perf_counter()
        menon(mosaic, rendering.CFAS["bayer"])
        times.append(time.perf_counter() - start)
    per_megapixel = {"theirs": min(times) / (rows * cols / 1e6), "ours": 1 / ours["mp_per_s"]}
    what = {"peer": "Menon (colour-demosaicing)", "width": cols, "height": rows, "patch": ours["patch"], "unit": "s/MP"}
    return [{**what, **per_megapixel, "ratio": per_megapixel["theirs"] / per_megapixel["ours"]}]
