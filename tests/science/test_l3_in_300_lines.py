"""docs/l3_in_300_lines.py learns a table and renders the same outputs as the reference backend."""

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numpy.typing import NDArray

from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.layers import MosaicLayer
from l3cli.artifacts.table import TransformTable
from l3cli.frames.frame import RawFrame
from l3cli.rendering.reference import ReferenceRenderer

SCRIPT = Path(__file__).parents[2] / "docs/l3_in_300_lines.py"


@pytest.fixture(scope="module")
def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("l3_in_300_lines", SCRIPT)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def learned(script: ModuleType) -> tuple[NDArray, NDArray]:
    rng = np.random.default_rng(1)
    return script.learn([script.draw_scene(96, rng) for _ in range(6)], (0.02, 0.1, 0.4, 0.8, 1.5), rng)


def table_of(script: ModuleType, learned: tuple[NDArray, NDArray]) -> TransformTable:
    """Return the transform table of what the script has learned."""
    edges = script.CONTRAST_EDGES.astype(np.uint32)[None]
    cases, channels = np.arange(script.CASES, dtype=np.uint16), script.CHANNELS
    rule = ClassRule(
        patch=script.PATCH,
        shift=0,
        level_edges=script.LEVEL_EDGES.astype(np.uint32),
        contrast_edges=edges,
        saturation=script.SATURATION,
        saturation_radius=script.SATURATION_RADIUS,
        case_of_code=cases,
        chroma_black_level=0,
        chroma_weights=np.zeros((1, channels), np.int32),
    )
    classes = np.zeros(script.CLASSES)
    return TransformTable(
        history=(),
        camera_name="three Gaussian filters",
        rows=1000,
        cols=1000,
        channels=("r", "g", "b"),
        cfa=script.CFA.astype(np.uint8),
        bits=12,
        black_level=float(script.BLACK_LEVEL),
        white_level=float(script.WHITE_LEVEL),
        outputs=("X", "Y", "Z"),
        target_description="XYZ",
        output_unit=1.0,
        white_point=script.TO_XYZ.sum(axis=1),
        first=MosaicLayer(rule, *learned, classes, classes.astype(np.float32)),
    )


@pytest.mark.parametrize("brightness", [0.03, 0.6, 1.6])
def test_renders_as_the_reference_backend_does(
    script: ModuleType, learned: tuple[NDArray, NDArray], brightness: float
) -> None:
    rng = np.random.default_rng(2)
    values = script.expose(script.mosaic_of(script.draw_scene(61, rng).signal * brightness), rng)
    table = table_of(script, learned)
    renderer, frame = ReferenceRenderer(table), RawFrame("drawn", values, table.black_level, table.white_level)
    labels, _ = script.classify(values)
    assert np.unique(labels).size >= 12
    np.testing.assert_array_equal(labels, renderer.labels(frame))
    expected = renderer.exact_outputs(frame).transpose(1, 2, 0)
    np.testing.assert_allclose(script.render(values, *learned), expected, rtol=0, atol=1e-6)


def test_learns_a_scene_it_has_not_seen(script: ModuleType, learned: tuple[NDArray, NDArray]) -> None:
    rng = np.random.default_rng(3)
    unseen = script.draw_scene(96, rng)
    picture = script.render(script.expose(script.mosaic_of(unseen.signal), rng), *learned)
    psnr = -10 * np.log10(np.mean((np.clip(picture, 0, 1) - np.clip(unseen.target, 0, 1)) ** 2))
    assert psnr > 30  # the mean of the scene itself: 11


def test_has_at_most_300_lines_and_numpy_alone(script: ModuleType) -> None:
    text = SCRIPT.read_text(encoding="utf-8")
    assert text.count("\n") <= 300
    imported = [line.split()[1] for line in text.splitlines() if line.startswith(("import", "from"))]
    assert set(imported) == {"struct", "sys", "zlib", "typing", "numpy"}
