"""Clips: moving objects are at the expected positions, and agree with the stored true motion (docs/method.md#motion)."""

import dataclasses
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import binary_dilation, binary_erosion, map_coordinates

from l3cli.simulation import clip
from l3cli.simulation.motion import Course, Motion, MovingLeaves, course, room

SIZE = (20, 30)
CANVAS = (120, 160)
SCALE = 0.5
pans = st.tuples(st.floats(-2, 2), st.floats(-2, 2))


def a_course(seed: int = 0, **keys: Any) -> Course:
    return course(Motion(**{"frames": 3, "size": SIZE, **keys}), (seed,))


def frames(canvas: np.ndarray, of: Course, things: list[clip.Sprite] | None = None) -> list[np.ndarray]:
    cube = canvas.astype(np.float32)[..., None]
    return [clip.frame(cube, SCALE, of, things or [], number)[..., 0] for number in range(of.motion.frames)]


def noise(shape: tuple[int, int] = CANVAS) -> np.ndarray:
    return np.random.default_rng(1).random(shape)


# ---------------------------------------------------------------------------------------------------------- frames


@given(st.tuples(st.integers(-3, 3), st.integers(-3, 3)))
@settings(max_examples=10, deadline=None)
def test_a_pan_by_whole_pixels_only_shifts(pan: tuple[int, int]) -> None:
    """The same values to the last bit but for rounding: up and left, where the camera goes down and right."""
    of = a_course(pan_pixels_per_frame=tuple(map(float, pan)))
    first, second, _ = frames(noise(), of)
    down, right = pan
    rows, cols = (slice(max(0, by), length + min(0, by)) for by, length in zip(pan, SIZE, strict=True))
    back = (slice(rows.start - down, rows.stop - down), slice(cols.start - right, cols.stop - right))
    assert np.allclose(first[rows, cols], second[back], atol=1e-6)


@given(pans, st.floats(0.97, 1.03))
@settings(max_examples=15, deadline=None)
def test_a_wave_lies_where_the_camera_sees_it(pan: tuple[float, float], zoom: float) -> None:
    """A wave averaged over straight lines between samples and over pixels is the wave, weaker by sinc³."""
    of = a_course(pan_pixels_per_frame=pan, zoom_per_frame=zoom)
    frequency = 0.03  # cycles a sample
    canvas = np.cos(2 * np.pi * frequency * (np.arange(CANVAS[1]) + 0.5 - CANVAS[1] / 2)) * np.ones(CANVAS)
    for number, frame in enumerate(frames(canvas, of)):
        view = of.view(number)
        place = (np.arange(SIZE[1]) - (SIZE[1] - 1) / 2) / view.zoom + view.centre[1]
        weaker = np.sinc(frequency) ** 2 * np.sinc(frequency / SCALE / view.zoom)
        assert np.allclose(frame, weaker * np.cos(2 * np.pi * frequency * place / SCALE), atol=2e-3)


@given(st.floats(0, 1), st.floats(0.6, 3.0))
@settings(max_examples=20, deadline=None)
def test_light_is_kept_wherever_a_pixel_begins(first: float, step: float) -> None:
    matrix = clip._resampling(200, 40, 10 + first, step)
    assert np.allclose(matrix.sum(axis=1), 1, atol=1e-5)
    assert np.allclose(matrix @ (np.arange(200) + 0.5), 10 + first + step * (np.arange(40) + 0.5), rtol=1e-5)


def test_an_open_shutter_blurs_what_moves_and_nothing_else() -> None:
    edge = np.repeat((np.arange(CANVAS[1]) >= CANVAS[1] / 2)[None], CANVAS[0], 0)
    still, sharp = (frames(edge, a_course(shutter=share))[1] for share in (0.5, 0.0))
    assert np.allclose(still, sharp, atol=1e-6)
    blurred = frames(edge, a_course(shutter=0.5, pan_pixels_per_frame=(0.0, 8.0)))[1]
    assert ((sharp > 0.05) & (sharp < 0.95)).sum(axis=1).max() <= 2
    assert ((blurred > 0.05) & (blurred < 0.95)).sum(axis=1).min() == pytest.approx(4, abs=1)
    assert blurred.mean() == pytest.approx(sharp.mean(), abs=0.01)


@given(pans, st.floats(0.9, 1.1), st.floats(0, 1), st.floats(0, 1), st.integers(0, 99))
@settings(max_examples=30, deadline=None)
def test_no_frame_sees_more_than_the_room(
    pan: tuple[float, float], zoom: float, shake: float, shutter: float, seed: int
) -> None:
    of = a_course(seed, pan_pixels_per_frame=pan, zoom_per_frame=zoom, shake_pixels=shake, shutter=shutter, frames=7)
    views = [of.view(number, moment) for number in range(7) for moment in of.moments()]
    for axis, whole in enumerate(room(of.motion)):
        seen = max(abs(view.centre[axis]) + SIZE[axis] / 2 / view.zoom for view in views)
        assert seen <= whole / 2 + 1e-9


def test_shake_has_its_deviation_and_is_bounded() -> None:
    shake = a_course(frames=4000, shake_pixels=0.5).shake
    assert shake.std() == pytest.approx(0.5, rel=0.03)
    assert abs(shake).max() <= 1.5
    leaves = MovingLeaves(count=4)
    assert np.array_equal(
        a_course(frames=9, shake_pixels=0.5, leaves=leaves).shake, a_course(frames=9, shake_pixels=0.5).shake
    )


# ---------------------------------------------------------------------------------------------------------- leaves


def leafy(speed: float = 2.5, **keys: Any) -> tuple[Course, list[clip.Sprite]]:
    leaves = MovingLeaves(count=1, radius_pixels=(9.0, 9.0), speed_pixels_per_frame=(speed, speed))
    of = a_course(frames=4, leaves=leaves, **keys)
    return of, clip.sprites(of, np.full((1, 1), 0.5), (0,))


def middle_of(frame: np.ndarray) -> np.ndarray:
    """Centre of mass (2) of what is brighter than nothing, in pixels from the frame's middle."""
    return np.array(
        [(frame * (at - (length - 1) / 2)).sum() / frame.sum() for at, length in zip(np.indices(SIZE), SIZE, strict=True)]
    )


def test_a_leaf_moves_as_fast_as_it_states_over_a_scene_that_stays() -> None:
    of, things = leafy()
    of.start[:] = 0
    seen = frames(np.zeros(CANVAS), of, things)
    moved = np.diff([middle_of(frame) for frame in seen], axis=0)
    assert np.allclose(moved, of.velocity[0], atol=0.02)
    assert np.hypot(*of.velocity[0]) == pytest.approx(2.5)
    over = frames(np.full(CANVAS, 0.2), of, things)
    assert all(frame[0, 0] == pytest.approx(0.2) for frame in over)
    assert all(frame.max() <= 1 for frame in over)


def test_a_leaf_that_the_camera_follows_is_sharp_under_an_open_shutter() -> None:
    of, things = leafy(speed=6.0)
    of.start[:] = 0
    pan = (float(of.velocity[0, 0]), float(of.velocity[0, 1]))

    def first(shutter: float, pan: tuple[float, float], velocity: np.ndarray) -> np.ndarray:
        motion = msgspec.structs.replace(of.motion, shutter=shutter, pan_pixels_per_frame=pan)
        return frames(np.zeros(CANVAS), dataclasses.replace(of, motion=motion, velocity=velocity), things)[0]

    sharp = first(0.0, (0.0, 0.0), 0 * of.velocity)
    assert np.allclose(first(1.0, pan, of.velocity), sharp, atol=1e-4)
    assert not np.allclose(first(1.0, pan, 0 * of.velocity), first(0.0, pan, 0 * of.velocity), atol=0.1)


def test_a_leaf_outside_the_frame_is_not_seen() -> None:
    of, things = leafy()
    of.start[:] = 100
    assert all((frame == 0).all() for frame in frames(np.zeros(CANVAS), of, things))


# ---------------------------------------------------------------------------------------------------- known motion


@given(pans, st.floats(0.97, 1.03), st.floats(0, 0.5), st.integers(0, 99))
@settings(max_examples=15, deadline=None)
def test_the_known_motion_leads_back_to_the_same_place(
    pan: tuple[float, float], zoom: float, shake: float, seed: int
) -> None:
    """On slopes, which no interpolation spoils, the frame before has the same value at the place that the motion names."""
    of = a_course(seed, pan_pixels_per_frame=pan, zoom_per_frame=zoom, shake_pixels=shake)
    assert not clip.motion_between(of, [], 0).any()  # no frame is before the first
    for axis in (0, 1):
        seen = frames(np.indices(CANVAS)[axis] * SCALE, of)
        down, right, sure = clip.motion_between(of, [], 1)
        row, col = np.indices(SIZE)
        warped = map_coordinates(seen[0].astype(float), [row - down, col - right], order=1, mode="nearest")
        assert sure.mean() > 0.6
        assert np.allclose(warped[sure > 0], seen[1][sure > 0], atol=1e-3)


def test_leaves_move_on_their_own_and_what_they_uncover_was_not_seen() -> None:
    of, things = leafy(pan_pixels_per_frame=(0.0, 1.0))
    of.start[:] = 0
    down, right, seen = clip.motion_between(of, things, 2)
    cover = [clip._shown(of, things, number) == 0 for number in (1, 2)]
    inside = cover[1] & (seen > 0)
    assert inside.sum() > 10
    assert np.allclose([down[inside], right[inside]], (of.velocity[0] - (0, 1))[:, None], atol=1e-5)
    outside = ~cover[1] & (seen > 0)
    assert np.allclose([down[outside], right[outside]], [[0], [-1]], atol=1e-5)
    freed = np.roll(cover[0], -1, axis=1) & ~cover[1]  # the scene moves left by one
    assert freed.sum() > 5
    assert not seen[freed].any()


def test_what_a_fast_leaf_uncovers_or_nears_is_not_taken_for_what_was_there() -> None:
    of, things = leafy(speed=11.0)
    of.start[:] = 0
    seen = clip.motion_between(of, things, 2)[2] > 0
    was, now = (clip._shown(of, things, number) == 0 for number in (1, 2))
    assert (was & ~now).sum() > 40
    assert not seen[was & ~now].any()  # uncovered
    rim = binary_dilation(now, iterations=2) & ~binary_erosion(now, iterations=2)
    assert not seen[rim].any()
    assert seen.mean() > 0.3
