"""A picture of outputs that the device still holds is that of the frame rendered to it at once, byte for byte."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from l3cli.artifacts.table import TransformTable
from l3cli.frame import RawFrame
from l3cli.physics import spectra
from l3cli.rendering import opencl_bands
from l3cli.rendering.display import Display, make_display
from l3cli.rendering.opencl import OpenCLRenderer
from tests.helpers.cameras import BAYER
from tests.helpers.tables import random_table, with_later

ONE_LAYER = random_table(BAYER, bits=12, black_level=64.0, patch=3)
TWO_LAYERS = with_later(ONE_LAYER, 3)


def noise(rows: int = 61, cols: int = 301, seed: int = 1) -> RawFrame:
    values = np.random.default_rng(seed).integers(0, 4096, (rows, cols), np.uint16)
    return RawFrame("noise", values, 64, 4095, dark=400.25)


def display(bits: int) -> Display:
    return make_display(spectra.white_point("A"), 1.7, bits)


@pytest.mark.parametrize(
    ("table", "engine", "bits"),
    [(TWO_LAYERS, {}, 8), (ONE_LAYER, {"lanes": 8}, 16), (ONE_LAYER, {"variant": "graphics"}, 8)],
    ids=["two layers", "8 lanes", "graphics"],
)
def test_encoded_afterwards_or_with_the_transforms(table: TransformTable, engine: dict[str, Any], bits: int) -> None:
    renderer, frame, shown = OpenCLRenderer(table, **engine), noise(), display(bits)
    at_once = renderer.picture(frame, shown)
    renderer.outputs(frame)
    np.testing.assert_array_equal(renderer.picture(frame, shown), at_once)


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
    monkeypatch.setattr(opencl_bands, "BAND_PIXELS", 301 * 20)  # more than one band: nothing is held
    banded = OpenCLRenderer(ONE_LAYER)
    banded.outputs(other)
    np.testing.assert_array_equal(banded.picture(other, display(8)), expected)
