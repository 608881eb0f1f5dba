"""How long a frame takes, stage by stage, on made-up frames through made-up tables of real size."""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from l3cli import spectra
from l3cli.artifacts.table import ClassRule, TransformTable
from l3cli.classify import chroma_weights
from l3cli.frame import RawFrame
from l3cli.render.display import make_display
from l3cli.render.opencl import OpenCLRenderer

FRAMES = 20  # timed frames of each case, after WARM_UP more
WARM_UP = 3


@dataclass(frozen=True)
class Case:
    """One line of the benchmark."""

    width: int
    height: int
    patch: int
    cfa: str  # key of CFAS
    classes: str  # key of CLASSES
    outputs: int = 3


CFAS = {
    "five-band": np.array([[2, 1, 4, 1], [1, 3, 1, 0], [4, 1, 2, 1], [1, 0, 1, 3]], np.uint8),
    "bayer": np.array([[0, 1], [1, 2]], np.uint8),
}
CLASSES = {"fast": (10, 1), "default": (20, 8)}  # levels and chromas of the recipes in configs/classes
CASES = (
    Case(1280, 720, 9, "five-band", "fast"),
    Case(1280, 720, 9, "five-band", "default"),
    Case(2048, 1164, 9, "five-band", "default"),
    Case(1280, 720, 5, "bayer", "default"),
)
BITS, BLACK, WHITE, CASE_COUNT = 12, 109, 4095, 10


def measure(case: Case) -> dict[str, Any]:
    """Medians over FRAMES frames, uint16 in host memory to sRGB8 in host memory: stages_ms as the device counts them,
    frame_ms as the caller waits."""
    rng = np.random.default_rng(0)
    renderer = OpenCLRenderer(made_up_table(case, rng))
    frame = made_up_frame(case, rng)
    display = make_display(spectra.white_point("D65"), 1.0, 8)
    for _ in range(WARM_UP):
        renderer.picture(frame, display)
    waits, stages = [], []
    for _ in range(FRAMES):
        start = time.perf_counter()
        renderer.picture(frame, display)
        waits.append((time.perf_counter() - start) * 1e3)
        stages.append(renderer.stage_times(frame, display))
    frame_ms = float(np.median(waits))
    return {
        "width": case.width,
        "height": case.height,
        "patch": case.patch,
        "channels": int(CFAS[case.cfa].max()) + 1,
        "classes": case.classes,
        "outputs": case.outputs,
        "backend": "opencl",
        "variant": "processor",
        "device": renderer.device.name.strip(),
        "stages_ms": {stage: float(np.median([times[stage] for times in stages])) for stage in stages[0]},
        "frame_ms": frame_ms,
        "mp_per_s": case.width * case.height / frame_ms / 1e3,
    }


def made_up_table(case: Case, rng: np.random.Generator) -> TransformTable:
    """Random weights for as many classes as a trained table has: the recipe's levels and chromas, two contrasts, ten
    saturation cases; chroma centres about the grey of `made_up_frame`, so that its pixels change between them."""
    cfa = CFAS[case.cfa]
    channels = int(cfa.max()) + 1
    level_count, chromas = CLASSES[case.classes]
    levels = BLACK + np.geomspace(0.001, 0.95, level_count - 1) * (WHITE - BLACK)
    centres = 1 - 0.08 * np.arange(channels) + 0.1 * rng.standard_normal((chromas, channels))
    centres /= centres.sum(axis=1, keepdims=True)
    case_of_code = rng.permutation(np.arange(2**channels) % CASE_COUNT).astype(np.uint16)
    case_of_code[0] = 0
    rule = ClassRule(
        patch=case.patch,
        shift=0,
        level_edges=np.rint(levels * 256 * channels).astype(np.uint32),
        contrast_edges=np.rint(2 * 512 * channels * (30 + 0.4 * np.append(levels, WHITE)))[None].astype(np.uint32),
        saturation=4036,
        saturation_radius=2,
        case_of_code=case_of_code,
        chroma_black=BLACK * 16,
        chroma_weights=chroma_weights(centres),
    )
    classes = cfa.size * rule.classes_per_site
    return TransformTable(
        camera_name="made up",
        rows=case.height,
        cols=case.width,
        channels=tuple("abcdefgh"[:channels]),
        cfa=cfa,
        bits=BITS,
        black=float(BLACK),
        white=float(WHITE),
        outputs=("X", "Y", "Z"),
        target_description="",
        output_unit=1.0,
        white_point=spectra.white_point("D65"),
        rule=rule,
        weights=(rng.standard_normal((classes, case.outputs, case.patch**2)) / case.patch).astype(np.float32),
        intercept=np.zeros((classes, case.outputs), np.float32),
        samples=np.ones(classes),
        condition=np.ones(classes, np.float32),
    )


def made_up_frame(case: Case, rng: np.random.Generator) -> RawFrame:
    """A smooth scene over all levels with noise and some texture: neighbouring pixels change class as real ones do."""
    cfa = CFAS[case.cfa]
    row, col = np.mgrid[: case.height, : case.width]
    channel = cfa[row % cfa.shape[0], col % cfa.shape[1]]
    level = 0.5 + 0.3 * np.sin(col * 0.01) + 0.29 * np.cos(row * 0.013)
    texture = 1 + 0.25 * np.sign(np.sin(col * 0.9) * np.sin(row * 0.7)) * ((col // 160 + row // 120) % 4 == 0)
    mean = level * texture * (1 - 0.08 * channel) * (WHITE - BLACK)
    values = BLACK + mean + rng.standard_normal(mean.shape) * np.sqrt(30 + 0.4 * np.maximum(mean, 0))
    return RawFrame("made up", np.clip(np.rint(values), 0, WHITE).astype(np.uint16), BLACK, WHITE)
