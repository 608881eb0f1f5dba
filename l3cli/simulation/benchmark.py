"""How long one core takes for a frame, on a made-up cube of the usual size."""

import resource
import sys
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from l3cli.artifacts.camera import CameraModel
from l3cli.scene import NO_ILLUMINANT, Scene
from l3cli.simulation import light
from l3cli.simulation.frame import simulate
from l3cli.simulation.optics import LOW_RANK_ERROR
from l3cli.simulation.recipe import Lens

FRAMES = 5  # of which the fastest counts: other work on the machine only slows
BANDS = np.arange(400.0, 701.0, 10.0)


@dataclass(frozen=True)
class Case:
    """One line of the benchmark: 31 bands, noise on, XYZ targets."""

    width: int
    height: int
    diffraction: bool


CASES = (Case(1280, 720, True), Case(1280, 720, False))


def measure(camera: CameraModel, case: Case) -> dict[str, Any]:
    """The fastest of FRAMES frames from a cube in memory to raw mosaic, electrons and target, and the peak memory of this
    process, which parallel.alone keeps to one thread."""
    camera = replace(camera, rows=case.height, cols=case.width)
    rng = np.random.default_rng(0)
    cube = rng.random((case.height, case.width, BANDS.size), dtype=np.float32)
    scene = Scene("made up", BANDS, cube, NO_ILLUMINANT)
    falling = light.make_light("D65", {}, camera.wavelength).at(100.0)
    exposure = light.automatic_exposure(camera, falling, 0.9)
    lens = Lens(diffraction=case.diffraction)
    times = []
    for index in range(FRAMES):
        start = time.perf_counter()
        simulate(camera, scene, falling, exposure, lens, (0, index))
        times.append(time.perf_counter() - start)
    kib = 1 if sys.platform != "darwin" else 1024  # what getrusage counts in
    return {
        "width": case.width,
        "height": case.height,
        "bands": BANDS.size,
        "channels": len(camera.channels),
        "optics": case.diffraction,
        "blur_error": LOW_RANK_ERROR if case.diffraction else 0.0,
        "frame_ms": min(times) * 1e3,
        "mp_per_s": case.width * case.height / min(times) / 1e6,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / kib / 1e3,
    }
