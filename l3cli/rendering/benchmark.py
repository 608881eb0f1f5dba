"""Time of a frame, stage by stage, on synthetic frames through synthetic tables of real size.

A frame is timed from uint16 in host memory to the result in host memory, everything included.
"""

import functools
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from l3cli.physics import spectra
from l3cli.rendering.display import make_display
from l3cli.rendering.opencl.layout import VARIANTS
from l3cli.rendering.opencl.renderer import OpenCLRenderer
from l3cli.rendering.reference import ReferenceRenderer
from l3cli.rendering.synthetic import CFAS, Case, synthetic_frame, synthetic_table

FRAMES = 40  # timed frames of each case, after WARM_UP more
WARM_UP = 3

FULL = (
    Case(1280, 720, 9, "five-band", "fast"),
    Case(1280, 720, 9, "five-band", "single"),
    Case(1280, 720, 9, "five-band", "default"),
    Case(2048, 1164, 9, "five-band", "fast"),
    Case(2048, 1164, 9, "five-band", "single"),
    Case(2048, 1164, 9, "five-band", "default"),
    Case(1280, 720, 5, "bayer", "fast"),
    Case(1280, 720, 5, "bayer", "single"),
    Case(1280, 720, 9, "bayer", "fast"),
    Case(1280, 720, 9, "five-band", "fast", 1),
    Case(1280, 720, 9, "five-band", "fast", 8),
)
SMALL = (Case(320, 240, 9, "five-band", "fast"), Case(320, 240, 5, "bayer", "fast"))  # for what is not made for speed here
TINY = (Case(64, 48, 9, "five-band", "fast"),)


def jobs(device: str | None, variant: str | None) -> list[Callable[[], dict[str, Any]]]:
    """All measurements for a device, or those of one variant: full frames with the variant made for it, small ones with the
    other, tiny ones with the reference."""
    usual = OpenCLRenderer(synthetic_table(TINY[0], np.random.default_rng(0)), device).variant
    planned: list[Callable[[], dict[str, Any]]] = []
    for name in VARIANTS if variant is None else (variant,):
        planned += [functools.partial(measure, case, device, name) for case in (FULL if name == usual else SMALL)]
    return planned + [functools.partial(measure_reference, case) for case in TINY if variant is None]


def measure(case: Case, device: str | None = None, variant: str | None = None) -> dict[str, Any]:
    """Medians over FRAMES frames on an OpenCL device: frame_ms as the caller waits, stages_ms as the device counts them
    (OpenCLRenderer.stage_times), stages_sum_ms."""
    rng = np.random.default_rng(0)
    renderer = OpenCLRenderer(synthetic_table(case, rng), device, variant)
    frame, display = synthetic_frame(case, rng), make_display(spectra.white_point("D65"), 1.0, 8)
    shown = display if case.outputs == 3 else None

    def render() -> None:
        renderer.outputs(frame) if shown is None else renderer.picture(frame, shown)

    waits = _times(render)
    stages = [renderer.stage_times(frame, shown) for _ in range(FRAMES)]
    result = _result(case, "opencl", renderer.variant, renderer.device.name.strip(), waits)
    result["stages_ms"] = {stage: float(np.median([times[stage] for times in stages])) for stage in stages[0]}
    result["stages_sum_ms"] = float(np.median([sum(times.values()) for times in stages]))
    return result


def measure_reference(case: Case) -> dict[str, Any]:
    """The same of the numpy reference, which has no stages to speak of."""
    rng = np.random.default_rng(0)
    renderer = ReferenceRenderer(synthetic_table(case, rng))
    frame, display = synthetic_frame(case, rng), make_display(spectra.white_point("D65"), 1.0, 8)
    classes = _times(lambda: renderer.labels(frame))
    outputs = _times(lambda: renderer.outputs(frame))
    waits = _times(lambda: renderer.picture(frame, display))
    until = [0.0, float(np.median(classes)), float(np.median(outputs)), float(np.median(waits))]
    stages = dict(zip(("classes", "transforms", "encode"), np.maximum(np.diff(until), 0).tolist(), strict=True))
    return {
        **_result(case, "reference", "reference", "numpy", waits),
        "stages_ms": {"upload": 0.0, **stages, "download": 0.0},
    }


def _times(render: Callable[[], object]) -> list[float]:
    """Return the milliseconds of FRAMES calls of `render`."""
    waits = []
    for turn in range(WARM_UP + FRAMES):
        start = time.perf_counter()
        render()
        if turn >= WARM_UP:
            waits.append((time.perf_counter() - start) * 1e3)
    return waits


def _result(case: Case, backend: str, variant: str, device: str, waits: list[float]) -> dict[str, Any]:
    frame_ms = float(np.median(waits))
    return {
        "width": case.width,
        "height": case.height,
        "patch": case.patch,
        "channels": int(CFAS[case.cfa].max()) + 1,
        "classes": case.classes,
        "outputs": case.outputs,
        "backend": backend,
        "variant": variant,
        "device": device,
        "stages_ms": {},
        "frame_ms": frame_ms,
        "mp_per_s": case.width * case.height / frame_ms / 1e3,
    }
