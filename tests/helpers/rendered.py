"""Tables of every kind, ways to render them, and the comparison with the reference renderer."""

from typing import Any

import numpy as np

from l3cli.classes.direction import DirectionKeys
from l3cli.frames.frame import RawFrame
from l3cli.physics.stokes import COLOUR_STOKES
from l3cli.rendering.display import encode, make_display
from l3cli.rendering.opencl.renderer import OpenCLRenderer
from l3cli.rendering.reference import ReferenceRenderer
from tests.helpers.cameras import BAYER, FIVE_BAND, X_TRANS
from tests.helpers.tables import (
    XYZ,
    random_table,
    with_clipped_white,
    with_clipping,
    with_coarse_chroma,
    with_components,
    with_low_noise,
    with_refinement,
    with_stokes_layer,
    with_tree,
)

# Outputs are float32 sums of up to 225 products below 1. Each product is rounded to 6e-8, so the error is at most
# 225 · 6e-8 = 1.4e-5. Real errors are ten times smaller.
OUTPUT_TOLERANCE = 1e-5
STRIPES = [[0, 1, 2, 0, 1], [1, 2, 0, 1, 2], [2, 0, 1, 2, 0]]
SIXTEEN = np.arange(16).reshape(4, 4)
TABLES = {
    "bayer": lambda: random_table(BAYER, bits=12, black_level=64.0),  # as in many tests of commands
    "five-band": lambda: random_table(
        FIVE_BAND, bits=12, black_level=108.93, patch=9, contrasts=(1.1, 2.0), chroma_dither=True
    ),
    "x-trans": lambda: random_table(X_TRANS, bits=16, black_level=2048.0, patch=7, contrasts=(1.2, 2.0, 5.0), wild=True),
    "white": lambda: random_table(
        [[0, 3, 1, 3], [3, 0, 3, 1], [1, 3, 2, 3], [3, 1, 3, 2]], bits=14, black_level=512.5, patch=9
    ),
    "stripes": lambda: random_table(STRIPES, bits=8, patch=3, outputs=XYZ + ("N", "U"), contrasts=()),
    "sixteen": lambda: random_table(SIXTEEN, bits=13, patch=15, outputs=("a",), contrasts=(1.4, 3.0), wild=True),
    "four outputs": lambda: random_table(BAYER, bits=12, black_level=64.0, patch=5, outputs=XYZ + ("N",)),
    "mono": lambda: random_table([[0]], bits=16, patch=11, outputs=tuple("abcdefghijklmnop"), wild=True),
    "directions": lambda: random_table(BAYER, bits=14, black_level=256.0, patch=9, direction=DirectionKeys()),
    "directions of a large array": lambda: random_table(
        np.arange(36).reshape(6, 6) % 5, patch=9, direction=DirectionKeys(strengths=(2.0,))
    ),
    "8 directions": lambda: random_table(
        FIVE_BAND, black_level=100.0, direction=DirectionKeys(orientations=8, strengths=(1.5, 6.0), coherence=0.4)
    ),
    "two layers": lambda: with_refinement(
        random_table(FIVE_BAND, black_level=100.0, patch=9, chroma_dither=True), 5, ratios=1
    ),
    "two layers of 16 bits": lambda: with_refinement(
        random_table(X_TRANS, bits=16, black_level=2048.0, patch=7, chroma_dither=True), 3
    ),
    "three layers": lambda: with_refinement(random_table(FIVE_BAND, black_level=100.0, patch=7), 5, 3, seed=2),
    "four layers": lambda: with_refinement(random_table(X_TRANS, bits=14, patch=5), 3, 5, 7, seed=4, ratios=2),
    "a layer of single pixels": lambda: with_refinement(random_table(BAYER, patch=5), 1, seed=6, ratios=2),
    "two wide layers": lambda: with_refinement(random_table(BAYER, bits=8, patch=5), 7, seed=3, ratios=1),
    "coarse chroma": lambda: with_clipping(
        with_coarse_chroma(with_refinement(random_table(BAYER, black_level=64.0), 5, ratios=1))
    ),
    "coarse chroma of three layers": lambda: with_clipping(
        with_coarse_chroma(with_refinement(random_table(FIVE_BAND, patch=5), 5, 3), 0.4)
    ),
    "coarse chroma of a tree": lambda: with_coarse_chroma(
        with_tree(random_table(STRIPES, bits=14, black_level=512.5, patch=5, seed=11), 7, seed=4), 0.01
    ),
    "tree of 8 bits": lambda: with_tree(random_table(BAYER, bits=8, patch=5, seed=11), 5, leaves=100),
    "tree of five bands": lambda: with_tree(random_table(FIVE_BAND, black_level=108.93, patch=9, seed=11), seed=2, ratios=2),
    "tree of 16 bits": lambda: with_tree(
        random_table(X_TRANS, bits=16, black_level=2048.0, patch=7, seed=14), leaves=400, seed=3
    ),
    "tree of stripes": lambda: with_tree(random_table(STRIPES, bits=14, black_level=512.5, patch=5, seed=11), 7, seed=4),
    "tree of one leaf": lambda: with_tree(random_table(BAYER, patch=3), leaves=1, seed=5),
    "corrected bands": lambda: with_components(random_table(SIXTEEN, black_level=100.0, outputs=tuple("abcdefghijklmnop"))),
    "colours and polarisation": lambda: with_clipped_white(
        with_stokes_layer(random_table(BAYER, black_level=64.0, outputs=COLOUR_STOKES)), 0.5
    ),
    "two sets of corrected bands": lambda: with_low_noise(
        with_components(random_table(STRIPES, bits=14, patch=5, outputs=tuple("abcdef"), contrasts=(1.2,)), 3)
    ),
    "two sets": lambda: with_low_noise(
        random_table(FIVE_BAND, contrasts=(1.1, 2.0), direction=DirectionKeys(orientations=8, strengths=(1.5, 6.0)))
    ),
    "two sets of three layers": lambda: with_low_noise(
        with_refinement(random_table(BAYER, black_level=64.0, patch=9, direction=DirectionKeys()), 5, 3, ratios=1)
    ),
    "three sets of a tree": lambda: with_low_noise(
        with_tree(random_table(X_TRANS, bits=14, patch=5, seed=11), seed=2), 0.25, 0.03
    ),
}
KINDS: dict[str, dict[str, Any]] = {  # how a table is rendered: arguments of OpenCLRenderer
    "processor": {"variant": "processor"},
    "8 lanes": {"variant": "processor", "lanes": 8},
    "16 lanes": {"variant": "processor", "lanes": 16},
    "graphics": {"variant": "graphics"},
}


def assert_equal_to_reference(reference: ReferenceRenderer, device: OpenCLRenderer, frame: RawFrame) -> None:
    exact, labels = reference.exact_classified(frame)
    assert len(labels) == len(reference.table.layers)
    for layer, expected in enumerate(labels):
        np.testing.assert_array_equal(device.labels(frame, layer), expected)
    rendered = device.outputs(frame)
    assert rendered.dtype == np.float32
    np.testing.assert_allclose(rendered, exact, rtol=0, atol=OUTPUT_TOLERANCE * max(1.0, np.abs(exact).max()))
    if reference.table.outputs[:3] == XYZ:
        display = make_display(reference.table.white_point[:3], 1.0, 8)
        shown, truth = device.picture(frame, display), encode(exact, display)
        assert shown.dtype == truth.dtype == display.dtype
        assert np.abs(shown.astype(int) - truth).max() <= 1
