"""The temporal filter: kernels equal the reference exactly, motion is found, and different scenes are not blended."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray

from l3cli.errors import InputFileError
from l3cli.frames.frame import RawFrame
from l3cli.rendering.temporal import chunks
from l3cli.rendering.temporal.chunks import CHUNK, LEAD, AnyOrder, Chunks, chunks_of, needed
from l3cli.rendering.temporal.noise import ONE, Grid
from l3cli.rendering.temporal.opencl import opencl_filters
from l3cli.rendering.temporal.reference import LEAST_WEIGHT, ReferenceFilter
from tests.helpers.cameras import BAYER, FIVE_BAND, X_TRANS, random_camera

BLACK = 64.0


def landscape(rng: np.random.Generator, rows: int, cols: int) -> NDArray[np.float64]:
    """Mean signal (row, col), e-, of steps and slopes."""
    coarse = rng.uniform(100, 900, (rows // 12 + 1, cols // 12 + 1)).repeat(12, 0).repeat(12, 1)[:rows, :cols]
    return coarse * np.linspace(1, 1.5, cols)


def exposed(rng: np.random.Generator, light: NDArray[np.float64], gain: float, bits: int) -> RawFrame:
    """A frame of a light (row, col) in e-, with its noise."""
    signal = rng.poisson(light) + rng.normal(0, 5.0, light.shape)
    values = np.clip(np.rint(signal * gain + BLACK), 0, 2**bits - 1).astype(np.uint16)
    return RawFrame("frame", values, BLACK, float(2**bits - 1))


@pytest.mark.parametrize(
    ("cfa", "bits", "variant", "row_noise"),
    [
        (BAYER, 12, "graphics", 4.0),
        pytest.param(FIVE_BAND, 10, "processor", 0.0, marks=pytest.mark.soak),
        (X_TRANS, 16, "processor", 0.0),
        (np.arange(10).reshape(2, 5), 12, "processor", 4.0),
    ],
)
def test_kernels_agree_with_the_reference_on_every_value(cfa: ArrayLike, bits: int, variant: str, row_noise: float) -> None:
    camera = random_camera(cfa, int(np.max(cfa)) + 1, bits, BLACK)
    camera = replace(camera, noise=replace(camera.noise, row_temporal_noise=row_noise), lines_corrected=True)
    rng, reference = np.random.default_rng(3), ReferenceFilter(camera.cfa.shape, camera)
    kernels = opencl_filters(camera.cfa.shape, camera, variant=variant)()
    light = landscape(rng, 150, 170)
    weights = []
    for number in range(5):
        seen = light[2 * number : 2 * number + 101, 5 * number : 5 * number + 123].copy()
        seen[24:] = light[24:101, :123]  # below nothing moves but a square
        seen[50:80, 12 * number : 12 * number + 30] = 400 + 200 * rng.random()
        frame = exposed(rng, seen[::-1] if number == 4 else seen, camera.gain, bits)
        ours, theirs = reference.filtered(frame), kernels.filtered(frame)
        assert reference.history is not None
        assert np.array_equal(reference.history.values, kernels.history())
        assert np.array_equal(ours.values, theirs.values)
        assert ours.noise_share == theirs.noise_share
        assert ours.noise_left is not None
        assert theirs.noise_left is not None
        assert np.array_equal(ours.noise_left.shares, theirs.noise_left.shares)
        weights.append(reference.history.left.mean() / ONE)
    assert min(weights) < 0.7  # much was blended
    assert reference.vectors is not None
    assert reference.vectors.any()
    assert np.array_equal(kernels.filtered(frame).values, reference.filtered(frame).values)


def test_noise_falls_by_what_the_recursion_leaves() -> None:
    camera = random_camera(BAYER, 3, 12, BLACK)
    rng, filtered = np.random.default_rng(1), ReferenceFilter((2, 2), camera)
    light = landscape(rng, 64, 64)
    made = [(exposed(rng, light, camera.gain, 12)) for _ in range(40)]
    left = np.array([filtered.filtered(frame).values - light * camera.gain - BLACK for frame in made])[30:]
    alone = np.array([frame.values - light * camera.gain - BLACK for frame in made])[30:]
    share = LEAST_WEIGHT / ONE
    assert filtered.history is not None
    known = filtered.history.left.mean() / ONE
    assert share / (2 - share) <= known < 0.12  # more where noise looked like motion
    assert np.mean(left**2) == pytest.approx(np.mean(alone**2) * known + 1 / 12, rel=0.15)  # and rounding to DN


@pytest.mark.parametrize(("cfa", "moved"), [(BAYER, (6, -10)), (FIVE_BAND, (-4, 12)), (X_TRANS, (6, 12))])
def test_vectors_are_those_of_a_scene_that_moves_by_whole_periods(cfa: ArrayLike, moved: tuple[int, int]) -> None:
    camera = random_camera(cfa, 3 if cfa is not FIVE_BAND else 5, 12, BLACK)
    rng, filtered = np.random.default_rng(2), ReferenceFilter(camera.cfa.shape, camera)
    light = landscape(rng, 240, 240)
    for place in ((60, 60), (60 + moved[0], 60 + moved[1])):
        filtered.filtered(exposed(rng, light[place[0] :, place[1] :][:144, :144], camera.gain, 12))
    assert filtered.vectors is not None
    inner = filtered.vectors[1:-1, 1:-1]
    assert np.mean((inner == moved).all(axis=-1)) > 0.8  # of plain blocks nobody knows
    assert np.array_equal(np.unique(filtered.vectors % np.array(camera.cfa.shape)), [0])


def test_nothing_of_another_scene_is_left() -> None:
    camera = random_camera(BAYER, 3, 12, BLACK)
    rng, filtered = np.random.default_rng(5), ReferenceFilter((2, 2), camera)
    for light in (landscape(rng, 64, 64), landscape(rng, 64, 64)[::-1]):
        frame = exposed(rng, light, camera.gain, 12)
        made = filtered.filtered(frame)
    assert np.array_equal(made.values, frame.values)
    wider = exposed(rng, landscape(rng, 64, 80), camera.gain, 12)
    assert np.array_equal(filtered.filtered(wider).values, wider.values)


def test_blocks_are_whole_cells_and_cells_whole_periods() -> None:
    for period in ((1, 1), (2, 2), (3, 3), (4, 4), (6, 6), (7, 5), (8, 8), (2, 4)):
        grid = Grid.of((101, 203), period)
        for axis in (0, 1):
            assert grid.block[axis] % grid.cell[axis] == grid.cell[axis] % grid.period[axis] == 0
            assert grid.cell[axis] >= 4
            assert grid.block[axis] >= 16
        padded = grid.padded(np.arange(101 * 203, dtype=np.uint16).reshape(101, 203))
        assert padded.shape == grid.shape
        assert grid.shape[0] - 101 < grid.block[0]
        assert padded[101 if grid.shape[0] > 101 else 100, 0] == padded[101 - period[0] if grid.shape[0] > 101 else 100, 0]


class Recorded:
    """A filter that gives the numbers of the frames that it has taken, as values."""

    def __init__(self) -> None:
        self.taken: list[int] = []

    def filtered(self, frame: RawFrame) -> RawFrame:
        self.taken.append(int(frame.values[0, 0]))
        return RawFrame("frames", np.array([self.taken], np.uint16), 0.0, 60000.0)


def numbered(place: int) -> RawFrame:
    return RawFrame("frame", np.array([[place]], np.uint16), 0.0, 60000.0)


def test_a_frame_depends_on_its_chunk_and_lead_in_alone() -> None:
    whole, late = Chunks(Recorded), Chunks(Recorded)
    for place in range(2 * CHUNK + 5):
        made = whole.filtered(place, numbered(place)).values[0].tolist()
        first = max(0, place // CHUNK * CHUNK - LEAD)
        assert made == [*range(first, place + 1)]
    for place in range(2 * CHUNK - LEAD, 2 * CHUNK + 5):
        again = late.filtered(place, numbered(place)).values[0].tolist()
    assert again == made


@pytest.mark.parametrize("wanted", [{0}, {CHUNK - 1}, {CHUNK}, {CHUNK + 3, 2 * CHUNK + 7}, set(), {3 * CHUNK - 1}])
def test_what_nothing_depends_on_is_not_needed(wanted: set[int]) -> None:
    count = 3 * CHUNK
    needs = [*needed((place, place in wanted) for place in range(count))]
    for place in range(count):
        depending = {each for each in wanted if each >= place and each // CHUNK in chunks_of(place)}
        assert needs[place] == bool(depending)


def test_a_faint_edge_leaves_little_behind() -> None:
    """A plain area that is brighter by 0.6 standard deviations of the noise, and uncovers 3 pixels a frame."""
    camera = random_camera(BAYER, 3, 12, BLACK)
    left = []
    for seed in range(3):
        rng, filtered = np.random.default_rng(seed), ReferenceFilter((2, 2), camera)
        for number in range(14):
            light = np.full((48, 128), 260.0)
            light[:, 3 * number + 20 :] += 10.4
            made = filtered.filtered(exposed(rng, light, camera.gain, 12))
        after = made.values[:, 3 * 13 + 20 - 12 : 3 * 13 + 20]
        left.append((after.mean() - BLACK) / camera.gain - 260)
    assert np.mean(left) / 10.4 < 0.2


class Remembering:
    """A filter whose frames are called by all that it has taken."""

    def __init__(self) -> None:
        self.taken = ""

    def filtered(self, frame: RawFrame) -> RawFrame:
        self.taken += frame.name
        return replace(frame, name=self.taken)


def of_place(place: int) -> RawFrame:
    return RawFrame(chr(ord("a") + place), np.zeros((2, 2), np.uint16), 0.0, 1.0)


@given(st.lists(st.integers(0, 19), min_size=1, max_size=40), st.integers(1, 6))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_frames_in_any_order_are_those_in_order(monkeypatch: pytest.MonkeyPatch, places: list[int], keep: int) -> None:
    monkeypatch.setattr(chunks, "CHUNK", 5)
    monkeypatch.setattr(chunks, "LEAD", 2)
    in_order = Chunks(Remembering)
    expected = [in_order.filtered(place, of_place(place)).name for place in range(20)]
    asked = AnyOrder(Remembering, of_place, keep)
    assert [asked.filtered(place, of_place(place)).name for place in places] == [expected[place] for place in places]


def test_frames_in_nearly_any_order_are_read_once_and_jumps_from_the_lead_in_on() -> None:
    read: list[int] = []

    def noted(place: int) -> RawFrame:
        read.append(place)
        return RawFrame("a", np.zeros((2, 2), np.uint16), 0.0, 1.0)

    asked = AnyOrder(Remembering, noted, most=4)
    for place in (1, 0, 3, 2, 4, 7, 5, 6):
        asked.filtered(place, of_place(0))
    assert read == [0, 2, 5, 6]
    read.clear()
    asked.filtered(3 * CHUNK + 2, of_place(0))
    assert read == [*range(3 * CHUNK - LEAD, 3 * CHUNK + 2)]
    read.clear()
    asked.filtered(3 * CHUNK - 1, of_place(0))
    assert read == [*range(2 * CHUNK - LEAD, 3 * CHUNK - 1)]


def test_after_a_broken_frame_the_others_are_what_they_were() -> None:
    broken = {2}

    def read(place: int) -> RawFrame:
        if place in broken:
            raise InputFileError("broken")
        return of_place(place)

    asked = AnyOrder(Remembering, read, most=4)
    with pytest.raises(InputFileError):
        asked.filtered(4, of_place(4))
    assert asked.filtered(1, of_place(1)).name == "ab"
    broken.clear()
    assert asked.filtered(4, of_place(4)).name == "abcde"
