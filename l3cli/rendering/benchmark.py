"""Measure the rendering time per frame, in total and per stage.

Frames and tables are synthetic, with realistic sizes. The time includes all transfers, from uint16 values in host memory to
the result in host memory.
"""

import functools
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.class_rule import ClassRule, Feature, StoredFeatures
from l3cli.artifacts.layers import COMPARED, PLANE_STEP, RATIO_TAPS, Clipping, CoarseChroma, MosaicLayer, PlaneLayer
from l3cli.artifacts.plane_rules import StructureRule
from l3cli.artifacts.table import ChromaSmoothing, TransformTable
from l3cli.classes import direction
from l3cli.classes.chroma import CHROMA_FRACTION, chroma_weights
from l3cli.classes.level import LEVEL_FRACTION
from l3cli.classes.structure import NOISE_TRACE, SIGMA
from l3cli.classes.windows import VARIANCE_FRACTION
from l3cli.frames.frame import RawFrame
from l3cli.physics import spectra
from l3cli.rendering.display import Display, make_display
from l3cli.rendering.opencl.renderer import OpenCLRenderer
from l3cli.rendering.reference import ReferenceRenderer

WINDOW_SIDE_PIXELS = 5  # window side of the second layer
TWO_LAYERS = ("default",)  # class recipes with a second layer
STRENGTHS, COHERENCE, DIRECTED = (1.7, 8.0, 40.0), 31, 2.0  # class thresholds from configs/classes/default.toml
BITS, BLACK_LEVEL, WHITE_LEVEL, CASE_COUNT = 12, 109, 4095, 10
FRAMES = 40  # number of timed frames
WARM_UP = 3  # number of frames rendered before the timing starts


@dataclass(frozen=True)
class Case:
    """One benchmark case, printed as one line."""

    width: int
    height: int
    patch: int  # side of the first layer's window, in pixels
    cfa: str  # key of CFAS
    classes: str  # key of CLASSES
    outputs: int = 3  # 3 outputs are encoded as 8-bit sRGB, any other number is returned as float32


CFAS = {
    "five-band": np.array([[2, 1, 4, 1], [1, 3, 1, 0], [4, 1, 2, 1], [1, 0, 1, 3]], np.uint8),
    "bayer": np.array([[0, 1], [1, 2]], np.uint8),
}
CLASSES = {"fast": (10, 1), "single": (20, 8), "default": (10, 9)}  # class recipe → number of levels, number of chromas


def synthetic_table(case: Case, rng: np.random.Generator) -> TransformTable:
    """Return a table with random transforms. Rendering with this table is as fast as with a trained table.

    The table has ten saturation cases, and the numbers of levels and chromas that `CLASSES` lists for the class recipe. A
    single-layer table also has two contrast classes. A two-layer table has the same direction classes, colour ratios, coarse
    chroma, replacement of clipped areas and chroma smoothing as the class recipe `default`.

    The chroma centres surround the grey of `synthetic_frame`, so that its pixels have different chromas. Each transform is
    the mean of the window plus small random deviations. The pictures are therefore nearly grey, and most of their pixels are
    inside the sRGB gamut, as in real pictures.
    """
    cfa = CFAS[case.cfa]
    channels = int(cfa.max()) + 1
    level_count, chromas = CLASSES[case.classes]
    levels = BLACK_LEVEL + np.geomspace(0.001, 0.95, level_count - 1) * (WHITE_LEVEL - BLACK_LEVEL)
    centres = 1 - 0.08 * np.arange(channels) + 0.1 * rng.standard_normal((chromas, channels))
    centres /= centres.sum(axis=1, keepdims=True)
    case_of_code = rng.permutation(np.arange(2**channels) % CASE_COUNT).astype(np.uint16)
    case_of_code[0] = 0
    two_layers = case.classes in TWO_LAYERS
    contrast_edges = 2 * 2**VARIANCE_FRACTION * channels * _variance(np.append(levels, WHITE_LEVEL))[None]
    rule = ClassRule(
        patch=case.patch,
        shift=0,
        level_edges=np.rint(levels * 2**LEVEL_FRACTION * channels).astype(np.uint32),
        contrast_edges=np.rint(contrast_edges[: 0 if two_layers else 1]).astype(np.uint32),
        saturation=4036,
        saturation_radius=2,
        case_of_code=case_of_code,
        chroma_black_level=BLACK_LEVEL * 2**CHROMA_FRACTION,
        chroma_weights=chroma_weights(centres),
        features=StoredFeatures.of((_directions(case, levels),)) if two_layers else None,
    )
    classes = cfa.size * rule.classes_per_site
    white = spectra.white_point("D65") if case.outputs == 3 else np.ones(case.outputs)
    deviations = rng.standard_normal((classes, case.outputs, case.patch**2)) / case.patch
    weights = white[:, None] * (1 + 0.1 * deviations) / case.patch**2
    return TransformTable(
        camera_name="synthetic",
        rows=case.height,
        cols=case.width,
        channels=tuple("abcdefgh"[:channels]),
        cfa=cfa,
        bits=BITS,
        black_level=float(BLACK_LEVEL),
        white_level=float(WHITE_LEVEL),
        outputs=("X", "Y", "Z") if case.outputs == 3 else tuple(f"o{index}" for index in range(case.outputs)),
        target_description="",
        output_unit=1.0,
        white_point=white,
        first=MosaicLayer(
            rule=rule,
            weights=weights.astype(np.float32),
            intercept=np.zeros((classes, case.outputs), np.float32),
            samples=np.ones(classes),
            condition=np.ones(classes, np.float32),
        ),
        later=(_second_layer(rule, cfa.size, white, levels, rng),) if two_layers else (),
        chroma_smoothing=ChromaSmoothing(reach=0.6, likeness=0.4) if two_layers else None,
    )


def _directions(case: Case, level_edges: NDArray[np.float64]) -> Feature:
    """Return the direction feature that the class recipe `default` uses in the first layer."""
    period = max(CFAS[case.cfa].shape)
    span = case.patch - period
    noise = np.sqrt(
        2 * period**2 * _variance(np.append(level_edges, WHITE_LEVEL))
    )  # standard deviation of the difference between two box sums, in DN
    constants = [direction.SCALE, direction.SCALE, 4, 1, 0, *np.rint(DIRECTED * direction.SCALE * noise).tolist()]
    windows = direction.boxes(case.patch, period, direction.inner_span(span))
    return Feature("direction", 5, windows, np.array(constants, np.int32))


def _second_layer(
    first: ClassRule, sites: int, white: NDArray[np.float64], level_edges: NDArray[np.float64], rng: np.random.Generator
) -> PlaneLayer:
    """Return a refinement layer with structure thresholds for the noise of `synthetic_frame`.

    Each transform returns a grey with the window's mean luminance, plus small random deviations.
    """
    noise = np.sqrt(
        2 * _variance(np.append(level_edges, WHITE_LEVEL)) / first.patch**3
    )  # standard deviation of luminance differences, in DN
    scale = SIGMA * (WHITE_LEVEL - BLACK_LEVEL) * PLANE_STEP / noise
    mantissa, exponent = np.frexp(scale)
    rule = StructureRule(
        level_step=1,
        gradient_factor=np.minimum(np.rint(mantissa * 128), 127).astype(np.uint8),
        gradient_shift=(7 - exponent).astype(np.uint8),
        strength_edges=np.rint(np.array(STRENGTHS) * NOISE_TRACE).astype(np.uint32),
        coherence=COHERENCE,
        turns=rng.choice([-1, 1], (sites, 2)).astype(np.int8),
        cases=first.cases,
    )
    classes = sites * rule.classes_per_site
    weights = 0.02 * rng.standard_normal((classes, white.size, 3, WINDOW_SIDE_PIXELS**2)) / WINDOW_SIDE_PIXELS
    weights[:, :, 1] += white[:, None] / WINDOW_SIDE_PIXELS**2  # plane 1 is luminance
    ratios = 0.02 * rng.standard_normal((classes, white.size, RATIO_TAPS[1])) / WINDOW_SIDE_PIXELS
    channels = int(first.case_of_code.size).bit_length() - 1
    response = np.zeros((channels + 1, channels + 1, white.size))
    response[0, :-1] = white / channels  # grey with the mean over all channels as its luminance
    return PlaneLayer(
        WINDOW_SIDE_PIXELS,
        np.concatenate([weights.reshape(classes, white.size, -1), ratios], axis=2).astype(np.float32),
        np.zeros((classes, white.size), np.float32),
        np.ones(classes),
        rule,
        coarse_chroma=CoarseChroma(np.full(COMPARED, 1e-7)),
        clipping=Clipping(response, np.full(channels, 0.8)),
    )


def _variance(level: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the approximate noise variance of `synthetic_frame` in DN²."""
    return 30 + 0.4 * level


def synthetic_frame(case: Case, rng: np.random.Generator) -> RawFrame:
    """Return a smooth scene that covers all levels, with noise and some texture.

    Because of the noise and texture, the class changes from pixel to pixel as often as in real frames.
    """
    cfa = CFAS[case.cfa]
    row, col = np.mgrid[: case.height, : case.width]
    channel = cfa[row % cfa.shape[0], col % cfa.shape[1]]
    level = 0.5 + 0.3 * np.sin(col * 0.01) + 0.29 * np.cos(row * 0.013)
    texture = 1 + 0.25 * np.sign(np.sin(col * 0.9) * np.sin(row * 0.7)) * ((col // 160 + row // 120) % 4 == 0)
    if case.classes in TWO_LAYERS:
        texture = texture * _detail(case, rng)
    mean = level * texture * (1 - 0.08 * channel) * (WHITE_LEVEL - BLACK_LEVEL)
    values = BLACK_LEVEL + mean + rng.standard_normal(mean.shape) * np.sqrt(30 + 0.4 * np.maximum(mean, 0))
    return RawFrame("synthetic", np.clip(np.rint(values), 0, WHITE_LEVEL).astype(np.uint16), BLACK_LEVEL, WHITE_LEVEL)


def _detail(case: Case, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return a random texture, as a brightness factor per pixel (row, col).

    As in a busy scene, most pixels have another structure class than the nearest pixels at the same CFA site.
    """
    blocks = np.zeros((case.height, case.width))
    for side in (3, 7, 15):
        drawn = rng.standard_normal((case.height // side + 1, case.width // side + 1))
        blocks += drawn.repeat(side, 0).repeat(side, 1)[: case.height, : case.width]
    return np.exp(0.1 * blocks)


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
SMALL_CASES = (Case(64, 48, 9, "five-band", "fast"),)


def jobs(device: str | None, variant: str | None) -> list[Callable[[], dict[str, Any]]]:
    """Return one function per benchmark case. Each function runs its case and returns the result.

    If `variant` is None, the default kernel variant and the reference renderer are measured.
    """
    planned: list[Callable[[], dict[str, Any]]] = [functools.partial(measure, case, device, variant) for case in FULL]
    return planned + [functools.partial(measure_reference, case) for case in SMALL_CASES if variant is None]


def measure(case: Case, device: str | None = None, variant: str | None = None) -> dict[str, Any]:
    """Measure how long an OpenCL device takes to render a frame.

    Returns
    -------
    dict
        Parameters of the benchmark case, and medians over `FRAMES` frames in ms:

        * "frame_ms": time from the call until the result is in host memory
        * "stages_ms": time per stage, measured by the device (see `OpenCLRenderer.stage_times`)
        * "stages_sum_ms": sum of the stage times
    """
    table, frame, display = _synthetic(case)
    renderer = OpenCLRenderer(table, device, variant)
    shown = display if case.outputs == 3 else None

    def render() -> None:
        renderer.outputs(frame) if shown is None else renderer.picture(frame, shown)

    waits = _times(render)
    stages = [renderer.stage_times(frame, shown) for _ in range(FRAMES)]
    medians = {stage: float(np.median([times[stage] for times in stages])) for stage in stages[0]}
    result = _result(case, "opencl", renderer.variant, renderer.device.name.strip(), waits, medians)
    return result | {"stages_sum_ms": float(np.median([sum(times.values()) for times in stages]))}


def measure_reference(case: Case) -> dict[str, Any]:
    """Measure how long the reference renderer takes to render a frame. Return a dict with the same keys as `measure`."""
    table, frame, display = _synthetic(case)
    renderer = ReferenceRenderer(table)
    classes = _times(lambda: renderer.labels(frame))
    outputs = _times(lambda: renderer.outputs(frame))
    waits = _times(lambda: renderer.picture(frame, display))
    until = [0.0, float(np.median(classes)), float(np.median(outputs)), float(np.median(waits))]
    stages = dict(zip(("classes", "transforms", "encode"), np.maximum(np.diff(until), 0).tolist(), strict=True))
    return _result(case, "reference", "reference", "numpy", waits, {"upload": 0.0, **stages, "download": 0.0})


def _synthetic(case: Case) -> tuple[TransformTable, RawFrame, Display]:
    rng = np.random.default_rng(0)
    return synthetic_table(case, rng), synthetic_frame(case, rng), make_display(spectra.white_point("D65"), 1.0, 8)


def _times(render: Callable[[], object]) -> list[float]:
    """Return the durations of `FRAMES` calls of `render`, in ms, after `WARM_UP` calls that are not timed."""
    waits = []
    for turn in range(WARM_UP + FRAMES):
        start = time.perf_counter()
        render()
        if turn >= WARM_UP:
            waits.append((time.perf_counter() - start) * 1e3)
    return waits


def _result(
    case: Case, backend: str, variant: str, device: str, waits: list[float], stages: dict[str, float]
) -> dict[str, Any]:
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
        "stages_ms": stages,
        "frame_ms": frame_ms,
        "mp_per_s": case.width * case.height / frame_ms / 1e3,
    }
