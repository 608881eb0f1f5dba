"""Rendering: the float64 reference compared with hand-made results, and OpenCL kernels compared with the reference."""

import dataclasses
import math
import threading

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from l3cli.artifacts.table import TransformTable
from l3cli.classes.windows import neighbourhoods
from l3cli.errors import RecipeError
from l3cli.frames.frame import NoiseLeft, RawFrame
from l3cli.physics.display import TONES, Tone
from l3cli.physics.spaces import SRGB_CURVE
from l3cli.rendering.display import Display, make_display
from l3cli.rendering.opencl import work
from l3cli.rendering.opencl.renderer import OpenCLRenderer
from l3cli.rendering.reference import ReferenceRenderer
from l3cli.rendering.renderer import BACKENDS, make_renderer
from l3cli.rendering.rendition import Rendition, rendered
from l3cli.rendering.white.source import usual_balance
from tests.helpers.cameras import BAYER
from tests.helpers.hostile import HANGS, timed
from tests.helpers.rendered import KINDS, OUTPUT_TOLERANCE, TABLES, assert_equal_to_reference
from tests.helpers.tables import (
    XYZ,
    frame_of_all_levels,
    random_table,
    with_first,
)

TREES = [name for name in TABLES if name.startswith("tree")][:-1]  # of several leaves


RENDERED = [(name, "processor") for name in TABLES]
RENDERED += [("five-band", "8 lanes"), ("five-band", "16 lanes"), ("four outputs", "8 lanes")]
RENDERED += [("five-band", "graphics"), ("x-trans", "graphics"), ("stripes", "graphics")]
RENDERED += [("8 directions", "8 lanes"), ("8 directions", "16 lanes")]
RENDERED += [("directions", "graphics"), ("8 directions", "graphics")]
RENDERED += [("two layers", "8 lanes"), ("two layers", "graphics"), ("two layers of 16 bits", "graphics")]
RENDERED += [("two sets of three layers", "graphics"), ("corrected bands", "8 lanes"), ("corrected bands", "graphics")]
RENDERED += [("coarse chroma", "8 lanes"), ("coarse chroma", "16 lanes"), ("coarse chroma", "graphics")]
RENDERED += [("colours and polarisation", "8 lanes"), ("colours and polarisation", "graphics")]
RENDERED += [("tree of five bands", "graphics"), ("tree of stripes", "graphics"), ("tree of one leaf", "graphics")]
# Each part of these kernels is also in the kernels of other cases, so that only `make soak` compiles them.
REPEATED = [
    ("white", "processor"),  # arrays and depths: five-band, x-trans
    ("two layers of 16 bits", "processor"),  # two layers, x-trans
    ("three layers", "processor"),  # four layers
    ("two wide layers", "processor"),  # four layers
    ("coarse chroma of three layers", "processor"),  # coarse chroma, four layers
    ("two sets of three layers", "processor"),  # two sets, three sets of a tree
    ("tree of 8 bits", "processor"),  # test_leaves_of_a_frame_that_falls_into_most_of_them
    ("tree of one leaf", "graphics"),  # tree of one leaf on the processor, tree of stripes
]


@pytest.fixture(
    scope="module",
    params=[pytest.param(each, marks=[pytest.mark.soak] * (each in REPEATED), id="-".join(each)) for each in RENDERED],
)
def renderers(request: pytest.FixtureRequest) -> tuple[ReferenceRenderer, OpenCLRenderer]:
    name, kind = request.param
    table = TABLES[name]()
    by_noise = bool(table.conditions)
    return ReferenceRenderer(table, by_noise), OpenCLRenderer(table, by_noise=by_noise, **KINDS[kind])


LENGTHS = st.integers(1, 24) | st.sampled_from([47, 48, 49, 66])
WIDTHS = st.integers(1, 40) | st.sampled_from([255, 256, 257, 300])


@st.composite
def frames(draw: st.DrawFn, table: TransformTable) -> RawFrame:
    """Mosaics of the table's depth and beyond: noise about any level, textures, areas of black and of saturation."""
    rows, cols = draw(LENGTHS), draw(WIDTHS)
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    top = 2 ** draw(st.sampled_from([table.bits, table.bits, 16])) - 1
    level, spread = draw(st.floats(0, 1.1)), draw(st.sampled_from([0.0, 0.001, 0.05, 0.5, 2.0]))
    values = table.black_level + top * level * rng.uniform(0.3, 1.0) * (1 + spread * rng.normal(size=(rows, cols)))
    for value in draw(
        st.lists(st.sampled_from([0.0, table.black_level, float(table.first.rule.saturation), top]), max_size=3)
    ):
        row, col = rng.integers(0, rows), rng.integers(0, cols)
        values[row : row + rng.integers(1, 9), col : col + rng.integers(1, 9)] = value
    phase = (draw(st.integers(0, table.cfa.shape[0] - 1)), draw(st.integers(0, table.cfa.shape[1] - 1)))
    raw = np.clip(values, 0, top).astype(np.uint16)
    return RawFrame("drawn", raw, table.black_level, table.white_level, phase, noise_left=some_left(rng, rows, cols))


def some_left(rng: np.random.Generator, rows: int, cols: int) -> NoiseLeft:
    """Noise that a filter has left in cells of 4 × 6 pixels: little, much, or just the limit of 0.125."""
    limit = math.isqrt(1024**2 // 8)
    return NoiseLeft(
        rng.choice(np.array([44, limit, limit + 1, 1024], np.uint16), (-(-rows // 4), -(-cols // 6))), 1024, (4, 6)
    )


@pytest.mark.parametrize("count", [6, pytest.param(60, marks=pytest.mark.soak)])
def test_opencl_meets_the_reference(renderers: tuple[ReferenceRenderer, OpenCLRenderer], count: int) -> None:
    reference, device = renderers

    @settings(max_examples=count, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
    @given(frame=frames(reference.table))
    def judge(frame: RawFrame) -> None:
        assert_equal_to_reference(reference, device, frame)

    judge()


def test_frames_of_one_value_and_of_one_line(renderers: tuple[ReferenceRenderer, OpenCLRenderer]) -> None:
    """Black and full scale in lines, the level of black and that of saturation in others: each shape has two values."""
    reference, device = renderers
    table = reference.table
    values = 0, int(table.black_level), table.first.rule.saturation, 2**table.bits - 1
    for at, shape in enumerate(((1, 1), (1, 70), (70, 1), (17, 33))):
        for value in values[at % 2 :: 2]:
            frame = RawFrame("f", np.full(shape, value, np.uint16), table.black_level, table.white_level)
            np.testing.assert_array_equal(device.labels(frame), reference.labels(frame))
            exact = reference.exact_outputs(frame)
            np.testing.assert_allclose(
                device.outputs(frame), exact, rtol=0, atol=OUTPUT_TOLERANCE * max(1, np.abs(exact).max())
            )


@pytest.mark.parametrize("name", TREES)
@pytest.mark.parametrize("kind", [pytest.param("8 lanes", marks=pytest.mark.soak), "16 lanes", "graphics"])
def test_leaves_of_a_frame_that_falls_into_most_of_them(name: str, kind: str) -> None:
    table = TABLES[name]()
    rule = table.later[0].rule
    frame = frame_of_all_levels(table, np.random.default_rng(0), (157, 190), phase=(1, 1))
    reference, device = ReferenceRenderer(table), OpenCLRenderer(table, **KINDS[kind])
    assert_equal_to_reference(reference, device, frame)
    fallen = rule.split(reference.labels(frame, 1)).kind
    assert np.unique(fallen[rule.case(fallen) == 0]).size > 0.8 * rule.structures
    assert 0.02 < (rule.case(fallen) > 0).mean() < 0.5


@settings(max_examples=4, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_any_colour_filter_array(data: st.DataObject) -> None:
    """Whatever the array, patch, outputs and depth, for every variant; few, since each is compiled."""
    rows, cols = data.draw(st.integers(1, 8)), data.draw(st.integers(1, 8))
    patch = data.draw(st.sampled_from([3, 5, 7, 9, 11, 13, 15]))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    channels = int(rng.integers(1, min(rows, patch) * min(cols, patch) // 2 + 2))
    cfa = rng.integers(0, min(channels, 16), (rows, cols))
    present, cfa = np.unique(cfa, return_inverse=True)
    cfa = cfa.reshape(rows, cols)
    try:
        neighbourhoods(cfa.astype(np.uint8), patch, len(present))
    except RecipeError:
        cfa = np.zeros((rows, cols), int)
    outputs = data.draw(st.sampled_from([XYZ, XYZ, ("Y",), tuple("abcdefg"), tuple("abcdefghijklmnop")]))
    table = random_table(cfa, data.draw(st.integers(8, 16)), 30.0, patch, outputs, wild=True, seed=int(rng.integers(99)))
    device = OpenCLRenderer(table, **KINDS[data.draw(st.sampled_from(list(KINDS)))])
    for _ in range(2):
        assert_equal_to_reference(ReferenceRenderer(table), device, data.draw(frames(table)))


# Tables whose kernels other tests compile, too.
BANDED = ["stripes", "two layers", "tree of stripes", "coarse chroma", "corrected bands", "colours and polarisation"]
BANDED_ON = [(name, kind) for name in BANDED for kind in ("processor", "graphics")]
BANDED_ON += [("four layers", "processor"), ("two sets of three layers", "graphics")]


@pytest.mark.parametrize(("name", "kind"), BANDED_ON)
def test_bands_change_nothing(monkeypatch: pytest.MonkeyPatch, name: str, kind: str) -> None:
    table = TABLES[name]()
    values = np.random.default_rng(0).integers(0, 2**table.bits, (61, 83)).astype(np.uint16)
    left = some_left(np.random.default_rng(1), *values.shape) if table.conditions else None
    frame = RawFrame("f", values, table.black_level, table.white_level, (1, 1), noise_left=left)
    if table.later and table.later[-1].coarse_chroma:  # farther than a band reads
        frame = dataclasses.replace(frame, values=np.tile(frame.values, (4, 1)))
    display = make_display(table.white_point[:3], 1.0, 8)
    whole = OpenCLRenderer(table, by_noise=bool(table.conditions), **KINDS[kind])
    labels = [whole.labels(frame, layer) for layer in range(len(table.layers))]
    planes = whole.outputs(frame)
    picture = whole.picture(frame, display) if table.outputs[:3] == XYZ else None
    for rows in (1, 30):
        monkeypatch.setattr(work, "BAND_PIXELS", rows * 83)
        banded = OpenCLRenderer(table, by_noise=bool(table.conditions), **KINDS[kind])
        for layer, expected in enumerate(labels):
            np.testing.assert_array_equal(banded.labels(frame, layer), expected)
        np.testing.assert_array_equal(banded.outputs(frame), planes)
        if picture is not None:
            np.testing.assert_array_equal(banded.picture(frame, display), picture)
        outputs, classes = banded.classified(frame)
        np.testing.assert_array_equal(outputs, planes)
        np.testing.assert_array_equal(classes, [labels[0], *labels[1:][-1:]])


def test_sequences_are_rendered_in_order() -> None:
    table = random_table(BAYER, patch=3)
    rng = np.random.default_rng(0)
    shapes = [(20, 30)] * 5 + [(31, 17), (20, 30)]
    sequence = [RawFrame("f", rng.integers(0, 4096, shape).astype(np.uint16), 0.0, table.white_level) for shape in shapes]
    displays = [make_display(table.white_point, 1.0 + index / 3, 8) for index in range(len(sequence))]
    device = OpenCLRenderer(table)
    pictures = list(device.pictures(zip(sequence, displays, strict=True)))
    assert len(pictures) == len(sequence)
    for frame, display, picture in zip(sequence, displays, pictures, strict=True):
        np.testing.assert_array_equal(picture, device.picture(frame, display))
    assert list(device.pictures([])) == []


def test_other_threads_run_while_a_frame_is_rendered() -> None:
    """As decoding and encoding do beside the rendering of a video. A thread that is only let in between two frames counts
    one tick a frame."""
    table = random_table(BAYER, patch=3)
    device, display = OpenCLRenderer(table), make_display(table.white_point, 1.0, 8)
    frame = RawFrame("f", np.zeros((2000, 4000), np.uint16), table.black_level, table.white_level)
    device.picture(frame, display)
    ticks, done = 0, threading.Event()

    def tick() -> None:
        nonlocal ticks
        while not done.wait(0.001):
            ticks += 1

    thread = threading.Thread(target=tick)
    thread.start()
    pictures = 0
    try:
        with timed(HANGS):
            while ticks < 20 + 2 * pictures:
                device.picture(frame, display)
                pictures += 1
    finally:
        done.set()
        thread.join()


def test_a_value_on_an_edge_falls_on_the_same_side() -> None:
    """Nine values of 0 or 1 with four ones have the variance 4 · round(512 / 9) and the level sum 4 · 7282 >> 8."""
    table = random_table([[0]], patch=3)
    level_edges = np.array([113, 200, 300], np.uint32)
    rule = dataclasses.replace(table.first.rule, level_edges=level_edges, contrast_edges=np.full((1, 4), 4 * 57, np.uint32))
    classes = rule.classes_per_site
    table = with_first(
        table,
        rule=rule,
        weights=np.zeros((classes, 3, 9), np.float32),
        intercept=np.zeros((classes, 3), np.float32),
        samples=np.ones(classes),
        condition=np.ones(classes, np.float32),
    )
    frame = RawFrame("f", np.random.default_rng(0).integers(0, 2, (50, 50)).astype(np.uint16), 0.0, 4095.0)
    labels = ReferenceRenderer(table).labels(frame)
    np.testing.assert_array_equal(OpenCLRenderer(table).labels(frame), labels)
    four = np.zeros((3, 3), np.uint16)
    four[0, :] = four[1, 1] = 1
    frame = RawFrame("f", four, 0.0, 4095.0)
    centre = OpenCLRenderer(table).labels(frame)[1, 1] // rule.kinds
    assert centre == rule.contrasts  # on the level edge: the level above; on the contrast edge: the contrast below


# Bits, and the share of codes that may differ by one, where float32 falls on the other side of a rounding; 8 bits come by a
# shorter polynomial.
ENCODINGS = [(8, 0.01), (16, 0.05)]


@pytest.mark.parametrize("tone", [None, TONES["aces"]], ids=["plain", "aces"])
@pytest.mark.parametrize("kind", ["processor", "16 lanes", "graphics"])
def test_encodings_on_the_device(kind: str, tone: Tone | None) -> None:
    """The whole range, below black and beyond white, in both depths."""
    table = random_table([[0]], bits=16, patch=3)
    centre = np.zeros_like(table.first.weights)
    centre[:, :, 4] = 1.0
    table = with_first(table, weights=centre, intercept=np.full_like(table.first.intercept, -0.01))
    frame = RawFrame("ramp", np.arange(65536, dtype=np.uint16).reshape(256, 256), table.black_level, table.white_level)
    device, reference = OpenCLRenderer(table, **KINDS[kind]), ReferenceRenderer(table)
    for bits, share in ENCODINGS:
        display = Display(np.diag([1.0, 1.7, 0.01]) * (5 if tone else 1), bits, tone=tone)
        shown, truth = device.picture(frame, display), reference.picture(frame, display)
        assert shown.dtype == truth.dtype == display.dtype
        error = np.abs(shown.astype(int) - truth)
        assert error.max() <= 1
        assert error.mean() <= share
        assert (shown[..., 1].ravel()[-1], shown[0, 0].tolist()) == (display.top, [0, 0, 0])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("outputs", [("Y",), ("X", "Y", "Z")])
def test_a_table_without_colours_shows_luminance_in_equal_values(kind: str, outputs: tuple[str, ...]) -> None:
    """Code = 255 · curve of luminance, whatever X and Z are; of a Bayer array with Y alone, and of one channel."""
    table = random_table([[0]] if len(outputs) == 3 else BAYER, bits=10, outputs=outputs).pictured()
    assert table.shows_grey
    values = np.random.default_rng(2).integers(0, 1024, (40, 48)).astype(np.uint16)
    frame = RawFrame("f", values, table.black_level, table.white_level)
    device, reference = OpenCLRenderer(table, **KINDS[kind]), ReferenceRenderer(table)
    rendition = Rendition(usual_balance(table), 0.5, 8)
    pictures = [rendered(each, frame, rendition, 0.5)[0].astype(int) for each in (device, reference)]
    assert all(np.ptp(picture, axis=2).max() == 0 for picture in pictures)
    assert np.abs(pictures[0] - pictures[1]).max() <= 1
    luminance = reference.exact_outputs(frame)[1]
    wanted = np.rint(255 * SRGB_CURVE.encoded(np.clip(0.5 * luminance, 0, 1)))
    assert np.ptp(wanted) > 40
    assert np.abs(pictures[1][..., 0] - wanted).max() <= 1


def test_centre_tap_of_the_reference_gives_the_signal_back() -> None:
    table = random_table(BAYER, bits=10, black_level=64.0)
    centre = np.zeros_like(table.first.weights)
    centre[:, 1, 12] = 1.0
    table = with_first(table, weights=centre, intercept=np.zeros_like(table.first.intercept))
    values = np.random.default_rng(0).integers(0, 1024, (7, 9)).astype(np.uint16)
    planes = ReferenceRenderer(table).exact_outputs(RawFrame("f", values, 64.0, 1023.0, (1, 0)))
    np.testing.assert_allclose(planes[1], (values - 64.0) / 959.0, atol=1e-12)
    assert not planes[[0, 2]].any()


@pytest.mark.parametrize("backend", list(BACKENDS))
def test_weights_follow_class_tap_and_phase(backend: str) -> None:
    """Tap order, class order and the phase, seen through a table whose weights are 1 for one tap of one site."""
    table = random_table(BAYER, bits=10)
    weights = np.zeros_like(table.first.weights)
    per_site = table.first.rule.classes_per_site
    weights[3 * per_site :, 0, 5 * 1 + 4] = 1.0  # site (1, 1): one row up, two columns to the right
    table = with_first(table, weights=weights, intercept=np.zeros_like(table.first.intercept))
    values = np.random.default_rng(0).integers(0, 1024, (6, 8)).astype(np.uint16)
    plane = make_renderer(backend, table).outputs(RawFrame("f", values, 0.0, 1023.0, (0, 1)))[0]
    expected = np.zeros((6, 8))
    expected[1::2, 0:6:2] = values[0:5:2, 2::2]  # phase (0, 1): site (1, 1) lies at odd rows and even columns
    expected[1::2, 6] = values[0:5:2, 6]  # column 8 mirrors to column 6
    np.testing.assert_allclose(plane * 1023.0, expected, atol=1e-3)


@pytest.mark.parametrize("backend", list(BACKENDS))
def test_frames_on_other_levels_are_rescaled(backend: str) -> None:
    table = random_table(BAYER, bits=10, black_level=64.0)
    renderer = make_renderer(backend, table)
    values = np.random.default_rng(0).integers(64, 1024, (6, 8)).astype(np.uint16)
    wide = ((values.astype(int) - 64) * 16 + 2000).astype(np.uint16)
    expected = renderer.outputs(RawFrame("f", values, 64.0, 1023.0))
    np.testing.assert_array_equal(renderer.outputs(RawFrame("f", wide, 2000.0, 2000.0 + 959 * 16)), expected)


def test_renderer_is_made_once_for_frames_of_changing_size() -> None:
    table = random_table(BAYER)
    device, reference = OpenCLRenderer(table), ReferenceRenderer(table)
    rng = np.random.default_rng(0)
    for shape in ((5, 300), (1, 1), (70, 3), (5, 300)):
        frame = RawFrame("f", rng.integers(0, 4096, shape).astype(np.uint16), table.black_level, table.white_level)
        np.testing.assert_array_equal(device.labels(frame), reference.labels(frame))
    times = device.stage_times(frame, make_display(table.white_point, 1.0, 8))
    assert list(times) == ["upload", "classes", "transforms", "encode", "download"]
    assert all(time >= 0 for time in times.values())
