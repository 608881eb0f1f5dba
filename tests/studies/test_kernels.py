"""Kernels in Oclgrind, which checks all memory accesses: none is out of bounds, and work-items of a group do not race.

Small frames are rendered by all variants and types of layer, and are compared with the reference.

make kernels      sets the environment in which Oclgrind is an OpenCL device; otherwise these tests are skipped
"""

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import FlatField
from l3cli.artifacts.table import TransformTable
from l3cli.frames.frame import RawFrame
from l3cli.frames.shading import shading_of
from l3cli.rendering.display import make_display
from l3cli.rendering.opencl import work
from l3cli.rendering.opencl.renderer import OpenCLRenderer
from l3cli.rendering.reference import ReferenceRenderer
from l3cli.rendering.temporal.opencl import opencl_filters
from l3cli.rendering.temporal.reference import ReferenceFilter
from tests.helpers.cameras import BAYER, FIVE_BAND, random_camera
from tests.helpers.rendered import KINDS, TABLES, assert_equal_to_reference
from tests.helpers.tables import frame_of_all_levels, random_table, with_refinement, with_spectra

LOG = os.environ.get("OCLGRIND_LOG")
SHAPE = (5, 19)
pytestmark = [pytest.mark.slow, pytest.mark.skipif(not LOG, reason="Oclgrind is no device here; run make kernels")]


@pytest.fixture(autouse=True)
def nothing_is_reported() -> Iterator[None]:
    """Whatever Oclgrind has said by the end of a test fails it."""
    log = Path(str(LOG))
    before = log.stat().st_size if log.exists() else 0
    yield
    words = log.read_text()[before:] if log.exists() else ""
    assert not words, words[:4000]


def a_frame(table: TransformTable, shape: tuple[int, int] = SHAPE) -> RawFrame:
    phase = (1 % table.cfa.shape[0], 1 % table.cfa.shape[1])
    return frame_of_all_levels(table, np.random.default_rng(0), shape, phase=phase)


@pytest.mark.parametrize("kind", ["8 lanes", "16 lanes", "graphics"])
@pytest.mark.parametrize("name", TABLES)
def test_every_table(name: str, kind: str) -> None:
    table = TABLES[name]()
    by_noise = bool(table.conditions)
    device = OpenCLRenderer(table, by_noise=by_noise, **KINDS[kind])
    assert "Oclgrind" in device.device.name
    assert_equal_to_reference(ReferenceRenderer(table, by_noise), device, a_frame(table))


@pytest.mark.parametrize("variant", ["processor", "graphics"])
def test_tiles_bands_shading_and_pictures(variant: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames of more than a tile, in one band and in several, shaded, encoded with the transforms and afterwards."""
    shape = (13, 261)
    table = with_refinement(random_table(BAYER, black_level=64.0, patch=3), 3, ratios=1)
    field = FlatField(np.array([0.0, 6, 12]), np.array([0.0, 130, 260]), np.linspace(1, 1.6, 27).reshape(3, 3, 3))
    shading = shading_of(field, shape, table.cfa)
    reference, device = ReferenceRenderer(table), OpenCLRenderer(table, variant=variant)
    for rows, frame in ((13, a_frame(table, shape)), (6, replace(a_frame(table, shape), shading=shading, dark=1.3))):
        monkeypatch.setattr(work, "BAND_PIXELS", rows * shape[1])
        device._frame_bands = None
        np.testing.assert_allclose(device.outputs(frame), reference.exact_outputs(frame), atol=2e-5)
        for bits in (8, 16):
            display = make_display(table.white_point, 1.0, bits)
            assert np.abs(device.picture(frame, display).astype(int) - reference.picture(frame, display)).max() <= 2


@pytest.mark.parametrize(("variant", "window"), [("processor", 3), ("graphics", 3), ("graphics", 9)])
def test_smoothed_spectra(variant: str, window: int) -> None:
    table = with_spectra(random_table(BAYER, black_level=64.0, patch=3, outputs=tuple("abcd")), window, 0.4)
    expected, made = (
        each.outputs(a_frame(table)) for each in (ReferenceRenderer(table), OpenCLRenderer(table, variant=variant))
    )
    np.testing.assert_allclose(made, expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize(("cfa", "variant"), [(BAYER, "graphics"), (FIVE_BAND, "processor")])
def test_the_filter_in_time(cfa: list[list[int]], variant: str) -> None:
    camera = random_camera(cfa, int(np.max(cfa)) + 1, 12, 64.0)
    rng, reference = np.random.default_rng(3), ReferenceFilter(camera.cfa.shape, camera)
    kernels, blocks = opencl_filters(camera.cfa.shape, camera, variant=variant)(), rng.uniform(100, 900, (4, 6))
    light = blocks.repeat(12, 0).repeat(12, 1)
    for number in range(3):
        seen = light[2 * number : 2 * number + 29, 4 * number : 4 * number + 37]
        values = np.rint(rng.poisson(seen) * camera.gain + 64).astype(np.uint16)
        frame = RawFrame("drawn", values, 64.0, 4095.0)
        np.testing.assert_array_equal(kernels.filtered(frame).values, reference.filtered(frame).values)
