"""Speed of rendering, compared with lower limits and with other software, and speed of simulation on one core.

python -m pytest -m slow -s tests/studies/test_speed_study.py      (two minutes; `make bench` runs it after `l3 bench`)

Because machines are shared and noisy, alternatives are timed in turn, and the times are printed but not tested.
"""

import contextlib
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.evaluation.demosaic import menon
from l3cli.frames.scene import NO_ILLUMINANT, Scene
from l3cli.physics import spectra
from l3cli.rendering.benchmark import CFAS, FULL, WARM_UP, Case, synthetic_frame, synthetic_table
from l3cli.rendering.display import make_display
from l3cli.rendering.opencl.renderer import OpenCLRenderer
from l3cli.simulation import light
from l3cli.simulation.frame import simulate
from l3cli.simulation.recipe import Lens

FRAMES = 40  # timed frames of each case
SIMULATED = 5  # frames, of which the fastest counts
BANDS = np.arange(400.0, 701.0, 10.0)  # nm
FOLDER_HERE = Path(__file__).parent
pytestmark = pytest.mark.slow


@contextlib.contextmanager
def multiply_adds(case: Case, folder: Path) -> Iterator[Callable[[], float]]:
    """Give a function that runs the bare multiply-adds of a case once (limit.c), on all cores, and returns milliseconds."""
    compiler = shutil.which(os.environ.get("CC", "cc"))
    if compiler is None:
        pytest.skip("no C compiler (CC or cc)")
    program = folder / f"limit{case.patch}"
    flags = ["-O3", "-march=native", "-fopenmp", f"-DPATCH={case.patch}"]
    subprocess.run([compiler, *flags, FOLDER_HERE / "limit.c", "-o", program, "-lm"], check=True)
    # passive: threads that spin between frames would take the processor from what is timed in turn with them
    environment = {**os.environ, "OMP_WAIT_POLICY": "passive", "OMP_NUM_THREADS": str(len(os.sched_getaffinity(0)))}
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

        yield once


def milliseconds(render: Callable[[], object]) -> float:
    start = time.perf_counter()
    render()
    return (time.perf_counter() - start) * 1e3


def test_frames_next_to_bare_multiply_adds(tmp_path: Path) -> None:
    fastest = {}
    for case in (case for case in FULL if case.outputs == 3):
        rng = np.random.default_rng(0)
        renderer = OpenCLRenderer(synthetic_table(case, rng))
        frame, display = synthetic_frame(case, rng), make_display(spectra.white_point("D65"), 1.0, 8)
        with multiply_adds(case, tmp_path) as bare:
            turns = [
                (bare(), milliseconds(lambda: renderer.picture(frame, display)))  # noqa: B023
                for _ in range(WARM_UP + FRAMES)
            ][WARM_UP:]
        limit, ours = (min(times) for times in zip(*turns, strict=True))
        middle = np.median([each[1] for each in turns])
        print(
            f"{case.width}×{case.height} {case.cfa} {case.patch}×{case.patch} {case.classes}: "
            f"median {middle:.1f} ms; fastest {ours:.2f} ms, {ours / limit:.2f} × the bare multiply-adds ({limit:.2f} ms)"
        )
        fastest[case] = ours
        assert ours > limit / 2  # else one of them does not do its work
    for case, ours in fastest.items():
        if case.patch == 5 and (nine := fastest.get(replace(case, patch=9))):
            print(f"{case.width}×{case.height} {case.cfa} {case.classes}: 5×5 {nine / ours:.2f} times as fast as 9×9")


def test_a_frame_next_to_menon() -> None:
    pytest.importorskip("colour_demosaicing")
    case, rng = Case(1280, 720, 9, "bayer", "fast"), np.random.default_rng(0)
    renderer = OpenCLRenderer(synthetic_table(case, rng))
    frame, display = synthetic_frame(case, rng), make_display(spectra.white_point("D65"), 1.0, 8)
    renderer.picture(frame, display)
    ours = min(milliseconds(lambda: renderer.picture(frame, display)) for _ in range(FRAMES))
    mosaic = rng.random((case.height, case.width))
    theirs = min(milliseconds(lambda: menon(mosaic, CFAS["bayer"])) for _ in range(2))
    print(f"Menon (one thread) {theirs / 921.6:.2f} s/MP, ours {ours / 921.6:.4f}: {theirs / ours:.0f} times as long")
    assert theirs > ours


@pytest.mark.parametrize("diffraction", [True, False])
def test_simulation(fiveband: CameraModel, diffraction: bool) -> None:
    camera = replace(fiveband, rows=720, cols=1280)
    cube = np.random.default_rng(0).random((camera.rows, camera.cols, BANDS.size), dtype=np.float32)
    scene = Scene("synthetic", BANDS, cube, NO_ILLUMINANT)
    falling = light.make_light("D65", {}, camera.wavelength).at(100.0)
    exposure = light.automatic_exposure(camera, falling, 0.9)
    lens, times = Lens(diffraction=diffraction), []
    for index in range(SIMULATED):
        start = time.process_time()
        simulate(camera, scene, falling, exposure, lens, (0, index))
        times.append(time.process_time() - start)
    size = camera.rows * camera.cols / 1e6
    print(f"1280×720, 31 bands, diffraction {'on' if diffraction else 'off'}: {size / min(times):.2f} MP/s of a core")
