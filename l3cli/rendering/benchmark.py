"""How long a frame takes, stage by stage, on made-up frames through made-up tables of real size.

A frame is timed from uint16 in host memory to the result in host memory, everything included. Where a C compiler is at
hand, the bare multiply-adds of as many transforms (limit.c) are timed in turn with it, frame by frame, so that both meet the
same moods of the machine.
"""

import contextlib
import functools
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from l3cli.physics import spectra
from l3cli.rendering.display import make_display
from l3cli.rendering.layout import VARIANTS
from l3cli.rendering.made_up import CFAS, Case, made_up_frame, made_up_table
from l3cli.rendering.naive import NaiveTransforms
from l3cli.rendering.opencl import OpenCLRenderer
from l3cli.rendering.reference import ReferenceRenderer

FRAMES = 40  # timed frames of each case, after WARM_UP more
WARM_UP = 3
NAIVE_FRAMES = 7  # a naive kernel takes its time
LIMIT_OUTPUTS = 3  # of limit.c


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
PEER = Case(1280, 720, 9, "five-band", "fast")  # that is rendered by others, too
TINY = (Case(64, 48, 9, "five-band", "fast"),)
BAYER_CHANNELS = 3


def jobs(device: str | None, variant: str | None) -> list[Callable[[], dict[str, Any]]]:
    """All measurements for a device, or those of one variant: full frames with the variant made for it, small ones with the
    other, tiny ones with the reference."""
    usual = OpenCLRenderer(made_up_table(TINY[0], np.random.default_rng(0)), device).variant
    planned: list[Callable[[], dict[str, Any]]] = []
    for name in VARIANTS if variant is None else (variant,):
        planned += [functools.partial(measure, case, device, name) for case in (FULL if name == usual else SMALL)]
    return planned + [functools.partial(measure_reference, case) for case in TINY if variant is None]


def five_against_nine(results: list[dict[str, Any]]) -> dict[str, float]:
    """How many times faster patches of 5×5 are than of 9×9, by what else is the same: {"1280×720 fast": 1.6}."""
    times = {
        (
            result["width"],
            result["height"],
            result["channels"],
            result["classes"],
            result["variant"],
            result["patch"],
        ): result
        for result in results
        if result["backend"] == "opencl" and result["channels"] == BAYER_CHANNELS
    }
    pairs = [(key, result, times.get((*key[:-1], 9))) for key, result in times.items() if key[-1] == 5]
    return {
        f"{key[0]}×{key[1]} {key[3]}": nine["frame_ms"] / five["frame_ms"] for key, five, nine in pairs if nine is not None
    }


def measure(case: Case, device: str | None = None, variant: str | None = None) -> dict[str, Any]:
    """Medians over FRAMES frames on an OpenCL device: frame_ms as the caller waits, stages_ms as the device counts them
    (OpenCLRenderer.stage_times), stages_sum_ms. With a compiler also limit_ms, the least of as many runs of the limit in
    turn with the frames, and limit_ratio, the least of the frames over it; else no_limit, the reason."""
    rng = np.random.default_rng(0)
    renderer = OpenCLRenderer(made_up_table(case, rng), device, variant)
    frame, display = made_up_frame(case, rng), make_display(spectra.white_point("D65"), 1.0, 8)
    shown = display if case.outputs == 3 else None

    def render() -> None:
        renderer.outputs(frame) if shown is None else renderer.picture(frame, shown)

    with _limit(case) as (limit, no_limit):
        waits, limits = _times(render, limit)
    stages = [renderer.stage_times(frame, shown) for _ in range(FRAMES)]
    result = _result(case, "opencl", renderer.variant, renderer.device.name.strip(), waits)
    result["stages_ms"] = {stage: float(np.median([times[stage] for times in stages])) for stage in stages[0]}
    result["stages_sum_ms"] = float(np.median([sum(times.values()) for times in stages]))
    if limits:
        result["limit_ms"] = min(limits)
        result["limit_ratio"] = min(waits) / min(limits)
    else:
        result["no_limit"] = no_limit
    return result


def measure_naive(case: Case, device: str | None = None, variant: str | None = None) -> dict[str, Any]:
    """The transforms of a case by a naive kernel in turn with the renderer's, on one device and with the same labels:
    medians of milliseconds that the device spends in the kernel."""
    rng = np.random.default_rng(0)
    table, frame = made_up_table(case, rng), made_up_frame(case, rng)
    renderer = OpenCLRenderer(table, device, variant)
    wanted = os.environ.get("L3_DEVICE", "") if device is None else device
    naive = NaiveTransforms(table, wanted, frame, renderer.labels(frame))
    renderer.stage_times(frame, None)
    naive.milliseconds()
    turns = [(naive.milliseconds(), renderer.stage_times(frame, None)["transforms"]) for _ in range(NAIVE_FRAMES)]
    peer, ours = (float(np.median(times)) for times in zip(*turns, strict=True))
    what = {"peer": "naive kernel", "width": case.width, "height": case.height, "patch": case.patch, "unit": "ms a frame"}
    return {**what, "theirs": peer, "ours": ours, "ratio": peer / ours}


def measure_reference(case: Case) -> dict[str, Any]:
    """The same of the numpy reference, which has no stages to speak of."""
    rng = np.random.default_rng(0)
    renderer = ReferenceRenderer(made_up_table(case, rng))
    frame, display = made_up_frame(case, rng), make_display(spectra.white_point("D65"), 1.0, 8)
    classes, _ = _times(lambda: renderer.labels(frame), None)
    outputs, _ = _times(lambda: renderer.outputs(frame), None)
    waits, _ = _times(lambda: renderer.picture(frame, display), None)
    until = [0.0, float(np.median(classes)), float(np.median(outputs)), float(np.median(waits))]
    stages = dict(zip(("classes", "transforms", "encode"), np.maximum(np.diff(until), 0).tolist(), strict=True))
    return {
        **_result(case, "reference", "reference", "numpy", waits),
        "stages_ms": {"upload": 0.0, **stages, "download": 0.0},
    }


def _times(render: Callable[[], object], limit: Callable[[], float] | None) -> tuple[list[float], list[float]]:
    """Milliseconds of FRAMES calls of `render`, and of the limit before each."""
    waits, limits = [], []
    for turn in range(WARM_UP + FRAMES):
        bare = limit() if limit else 0.0
        start = time.perf_counter()
        render()
        if turn >= WARM_UP:
            waits.append((time.perf_counter() - start) * 1e3)
            limits.append(bare)
    return waits, limits if limit else []


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


@contextlib.contextmanager
def _limit(case: Case) -> Iterator[tuple[Callable[[], float] | None, str]]:
    """A function that runs the bare multiply-adds of a case once and returns the milliseconds; None, and why, without a
    compiler, or where limit.c does not compute the like."""
    compiler = shutil.which(os.environ.get("CC", "cc"))
    if compiler is None or case.outputs != LIMIT_OUTPUTS:
        yield None, "no C compiler (CC or cc)" if compiler is None else f"of {LIMIT_OUTPUTS} outputs only"
        return
    with tempfile.TemporaryDirectory(prefix="l3-limit-") as folder:
        program = Path(folder, "limit")
        source = Path(__file__).with_name("limit.c")
        flags = ["-O3", "-march=native", "-fopenmp", f"-DPATCH={case.patch}"]
        built = subprocess.run([compiler, *flags, source, "-o", program, "-lm"], capture_output=True, check=False)
        if built.returncode:
            yield None, f"{compiler} does not compile it"
            return
        # passive: threads that spin between frames would take the processor from what is timed in turn with them
        cores = str(len(os.sched_getaffinity(0)))  # which l3 itself leaves to OpenCL
        environment = {**os.environ, "OMP_WAIT_POLICY": "passive", "OMP_NUM_THREADS": cores}
        arguments = [str(program), str(case.width), str(case.height)]
        with subprocess.Popen(
            arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1, env=environment
        ) as process:
            assert process.stdin is not None
            assert process.stdout is not None
            ask, answer = process.stdin, process.stdout

            def once() -> float:
                ask.write("\n")
                ask.flush()
                return float(answer.readline())

            yield once, ""
