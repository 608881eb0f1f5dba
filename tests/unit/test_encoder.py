"""Pictures encoded from outputs that are still on the device equal pictures that are rendered directly."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from l3cli.artifacts.table import TransformTable
from l3cli.frames.frame import RawFrame
from l3cli.physics import spectra
from l3cli.rendering.display import Display, make_display
from l3cli.rendering.opencl import renderer as opencl
from l3cli.rendering.opencl import work
from l3cli.rendering.opencl.renderer import OpenCLRenderer
from tests.helpers.rendered import TABLES

# Other tests compile the kernels of these tables, too.
ONE_LAYER, TWO_LAYERS = TABLES["bayer"](), TABLES["two layers"]()
FOUR_OUTPUTS, STRIPES = TABLES["four outputs"](), TABLES["stripes"]()


def noise(rows: int = 61, cols: int = 301, seed: int = 1) -> RawFrame:
    values = np.random.default_rng(seed).integers(0, 4096, (rows, cols), np.uint16)
    return RawFrame("noise", values, 64, 4095, dark=400.25)


def display(bits: int) -> Display:
    return make_display(spectra.white_point("A"), 1.7, bits)


@pytest.mark.parametrize(
    ("table", "engine", "bits"),
    [(TWO_LAYERS, {}, 8), (FOUR_OUTPUTS, {"lanes": 8}, 16), (STRIPES, {"variant": "graphics"}, 8)],
    ids=["two layers", "8 lanes", "graphics"],
)
def test_encoded_afterwards_or_with_the_transforms(table: TransformTable, engine: dict[str, Any], bits: int) -> None:
    renderer, frame, shown = OpenCLRenderer(table, **engine), noise(), display(bits)
    at_once = renderer.picture(frame, shown)
    renderer.outputs(frame)
    np.testing.assert_array_equal(renderer.picture(frame, shown), at_once)


@pytest.mark.parametrize("table", [ONE_LAYER, TWO_LAYERS], ids=["one layer", "two layers"])
def test_copied_or_in_the_memory_of_the_host(table: TransformTable, monkeypatch: pytest.MonkeyPatch) -> None:
    """A device that shares the host's memory computes on the arrays themselves, others on copies."""
    frame, shown, made = noise(), display(8), []
    monkeypatch.setattr(work, "BAND_PIXELS", 301 * 20)
    for shares in (True, False):
        monkeypatch.setattr(opencl, "shares_memory", lambda device, shares=shares: shares)
        renderer = OpenCLRenderer(table)
        stages = renderer.stage_times(frame, shown)
        assert (stages["upload"] > 0) != shares
        made.append([renderer.picture(frame, shown), renderer.outputs(frame), renderer.labels(frame), *renderer.pictures(
            [(noise(seed=seed), shown) for seed in range(4)]
        )])  # fmt: skip
    for one, other in zip(*made, strict=True):
        np.testing.assert_array_equal(one, other)
    monkeypatch.undo()
    one_band = OpenCLRenderer(table)  # outputs encoded on a device that copies
    one_band._in_place = False
    one_band.outputs(frame)
    np.testing.assert_array_equal(one_band.picture(frame, shown), made[0][0])


def test_frames_of_a_sequence_may_share_an_array() -> None:
    """As a grabber fills it anew for every frame: each is read before the next is asked for."""
    renderer, shown, array = OpenCLRenderer(ONE_LAYER), display(8), noise(600, 800).values.copy()

    def grabbed() -> Any:
        for seed in range(6):
            array[:] = noise(600, 800, seed).values
            yield dataclasses.replace(noise(600, 800), values=array), shown

    expected = [renderer.picture(noise(600, 800, seed), shown) for seed in range(6)]
    for made, wanted in zip(renderer.pictures(grabbed()), expected, strict=True):
        np.testing.assert_array_equal(made, wanted)


def test_work_that_is_left_ends_before_its_arrays_go() -> None:
    """An interrupt may leave frames behind that the device still reads and writes."""
    renderer, shown = OpenCLRenderer(ONE_LAYER), display(8)
    for seed in range(20):
        renderer._start_picture(noise(600, 800, seed), shown)
    expected = OpenCLRenderer(ONE_LAYER).picture(noise(), shown)
    np.testing.assert_array_equal(renderer.picture(noise(), shown), expected)


def test_a_sequence_of_stills_encodes_each_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each frame's outputs are asked for, to measure its exposure, while the picture before is still at work."""
    renderer, frames = OpenCLRenderer(ONE_LAYER), [noise(seed=seed) for seed in range(4)]
    expected = [renderer.picture(frame, display(8)) for frame in frames]
    transformed: list[object] = []
    start = OpenCLRenderer._start

    def counted(self: OpenCLRenderer, *arguments: Any, **named: Any) -> Any:
        transformed.append(arguments)
        return start(self, *arguments, **named)

    monkeypatch.setattr(OpenCLRenderer, "_start", counted)

    def exposed() -> Any:
        for frame in frames:
            renderer.outputs(frame)
            yield frame, display(8)

    made = list(renderer.pictures(exposed()))
    np.testing.assert_array_equal(made, expected)
    assert len(transformed) == len(frames)


def test_what_is_held_is_of_the_same_frame_and_of_its_values_now(monkeypatch: pytest.MonkeyPatch) -> None:
    renderer, frame, other = OpenCLRenderer(ONE_LAYER), noise(), noise(seed=2)
    expected = renderer.picture(other, display(8))
    renderer.outputs(frame)
    np.testing.assert_array_equal(renderer.picture(other, display(8)), expected)  # another frame
    renderer.outputs(frame)
    frame.values[:] = other.values  # written to since
    np.testing.assert_array_equal(renderer.picture(frame, display(8)), expected)
    renderer.outputs(other)
    renderer.labels(frame)  # the tracks have been used
    np.testing.assert_array_equal(renderer.picture(other, display(8)), expected)
    darker = dataclasses.replace(other, dark=100.0)  # the same values, another signal
    renderer.outputs(other)
    assert (renderer.picture(darker, display(8)) != expected).any()
    monkeypatch.setattr(work, "BAND_PIXELS", 301 * 20)  # more than one band: nothing is held
    banded = OpenCLRenderer(ONE_LAYER)
    banded.outputs(other)
    np.testing.assert_array_equal(banded.picture(other, display(8)), expected)
