"""Metrics of sequences detect known noise, jumps, motion and ghosts (docs/method.md#quality-of-sequences)."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter, map_coordinates

from l3cli.evaluation.sequence import SequenceEvaluation, SequenceFigures, estimated_motion
from l3cli.physics.display import daylight, displayed_xyz, lab, lightness

SHAPE = (64, 96)


def grey(light: np.ndarray) -> np.ndarray:
    """A picture (row, col, 3) of greys of that L*."""
    above = ((light + 16) / 116) ** 3
    linear = np.where(light > 8, above, light / 903.2962962)
    return np.repeat(linear[..., None], 3, axis=2)


def scene(shape: tuple[int, int] = SHAPE, seed: int = 0) -> np.ndarray:
    """L* of plain areas of 16 pixels."""
    rng = np.random.default_rng(seed)
    return rng.uniform(30, 80, (shape[0] // 16 + 1, shape[1] // 16 + 1)).repeat(16, 0).repeat(16, 1)[: shape[0], : shape[1]]


def noisy(light: np.ndarray, sigma: float, frames: int, seed: int = 1) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [light + sigma * rng.standard_normal(light.shape) for _ in range(frames)]


def figures(
    rendered: list[np.ndarray], ideal: list[np.ndarray] | None = None, motion: list[np.ndarray] | None = None,
    estimated: bool = False,
) -> SequenceFigures:  # fmt: skip
    """Figures of L*; a `motion` that is neither given nor `estimated` is none."""
    motion = motion or [moved((0, 0))] * len(rendered)
    evaluation = SequenceEvaluation("ours", ideal and "ideal")  # type: ignore[arg-type]
    for number, light in enumerate(rendered):
        evaluation.add(grey(light), grey(ideal[number]) if ideal else None, None if estimated else motion[number])
    return evaluation.figures()


def moved(by: tuple[float, float], shape: tuple[int, int] = SHAPE) -> np.ndarray:
    """A motion (3, row, col) by so many pixels down and right, seen where it does not come from outside."""
    row, col = np.indices(shape)
    source = np.stack([row - by[0], col - by[1]])
    seen = (source >= 0).all(axis=0) & (source[0] <= shape[0] - 1) & (source[1] <= shape[1] - 1)
    return np.stack([np.full(shape, by[0]), np.full(shape, by[1]), seen]).astype(np.float32)


# ------------------------------------------------------------------------------------------------------------ noise


def test_lightness_is_that_of_lab() -> None:
    picture = np.random.default_rng(0).random((5, 7, 3))
    assert np.allclose(lightness(picture), lab(displayed_xyz(picture), daylight())[..., 0], atol=0.01)


@given(st.floats(0.2, 3.0))
@settings(max_examples=5, deadline=None)
@pytest.mark.parametrize("with_ideal", [True, False])
def test_the_noise_put_in_is_found(with_ideal: bool, sigma: float) -> None:
    found = figures(noisy(scene(), sigma, 12), [scene()] * 12 if with_ideal else None)
    assert found.still_share > 0.9
    assert found.temporal_sigma == pytest.approx(sigma, rel=0.03)
    assert found.patch_sigma == pytest.approx(sigma / 8, rel=0.12)
    assert np.mean([frame.step_sigma for frame in found.frames[1:]]) == pytest.approx(sigma, rel=0.03)


def test_a_still_sequence_has_no_noise_and_no_jump() -> None:
    found = figures([scene()] * 3, [scene()] * 3, [moved((0, 0))] * 3)
    assert found.patch_sigma == found.largest_jump == found.warped_error == 0
    assert found.temporal_sigma == pytest.approx(0, abs=1e-5)
    assert found.still_share == 1
    assert found.psnr == 120


# ------------------------------------------------------------------------------------------------------------ jumps


@given(st.floats(-5, 5).filter(lambda by: abs(by) > 0.1), st.integers(1, 5))
@settings(max_examples=10, deadline=None)
def test_a_jump_put_in_is_found_where_it_is(by: float, at: int) -> None:
    rendered = [scene() + (by if number == at else 0.0) for number in range(7)]
    for ideal in (None, [scene()] * 7):
        found = figures(rendered, ideal)
        assert found.largest_jump_frame in (at, at + 1)
        assert abs(found.largest_jump or 0) == pytest.approx(abs(by), rel=1e-3)
        assert found.frames[at].jump == pytest.approx(by, rel=1e-3)


def test_what_the_ideal_does_is_no_jump() -> None:
    ideal = [scene() + step for step in (0, 0, 9, 9)]
    assert figures(ideal, ideal).largest_jump == 0
    assert figures(ideal).largest_jump == pytest.approx(9, rel=1e-3)


# ----------------------------------------------------------------------------------------------------------- motion


def pan(by: tuple[int, int], frames: int) -> list[np.ndarray]:
    wide = scene((SHAPE[0] + 64, SHAPE[1] + 64))
    starts = [(32 - by[0] * number, 32 - by[1] * number) for number in range(frames)]
    return [wide[top : top + SHAPE[0], left : left + SHAPE[1]] for top, left in starts]


@given(st.tuples(st.integers(-5, 5), st.integers(-5, 5)))
@settings(max_examples=8, deadline=None)
def test_a_pan_of_known_shift_has_no_warped_error(by: tuple[int, int]) -> None:
    """Neither as it is nor if the same is wrong with the same thing all the time; noise has √2 of its deviation."""
    ideal, motion = pan(by, 4), [moved(by)] * 4
    assert figures(ideal, ideal, motion).warped_error == 0
    faulty = [light + 0.1 * (light - 50) for light in ideal]
    found = figures(faulty, ideal, motion)
    assert found.warped_error == pytest.approx(0, abs=1e-3)
    assert found.mean_delta_e is not None
    assert found.mean_delta_e > 0.5
    noise = figures([light + each for light, each in zip(ideal, noisy(0 * ideal[0], 1.0, 4), strict=True)], ideal, motion)
    assert noise.warped_error == pytest.approx(np.sqrt(2), rel=0.03)


def test_a_ghost_behind_what_moves_is_seen() -> None:
    """A mean over past frames trails what moves: still patches are quieter, the error along the motion is larger."""
    ideal, motion = pan((0, 3), 6), [moved((0, 3))] * 6
    noise = noisy(0 * ideal[0], 0.5, 6)
    plain = [light + each for light, each in zip(ideal, noise, strict=True)]
    ghost = [plain[0]]
    for light in plain[1:]:
        ghost.append(0.5 * light + 0.5 * ghost[-1])
    assert (figures(ghost, ideal, motion).warped_error or 0) > 2 * (figures(plain, ideal, motion).warped_error or 9)
    assert (figures(ghost, ideal, motion).psnr or 99) < (figures(plain, ideal, motion).psnr or 0)


def test_where_the_motion_is_not_known_nothing_is_judged() -> None:
    ideal = pan((0, 3), 3)
    motion = [np.zeros((3, *SHAPE), np.float32)] * 3
    assert figures(ideal, ideal, motion).warped_error is None
    half = [np.stack([*each[:2], each[2] * (np.arange(SHAPE[1]) < 40)]) for each in [moved((0, 3))] * 3]
    wrong = [light + 20 * (np.arange(SHAPE[1]) >= 40) * number for number, light in enumerate(ideal)]
    assert figures(wrong, ideal, half).warped_error == pytest.approx(0, abs=0.35)  # a spline reaches a few pixels far


def textured(shape: tuple[int, int], seed: int = 3) -> np.ndarray:
    """L* of blobs a few pixels wide."""
    blobs = gaussian_filter(np.random.default_rng(seed).standard_normal(shape), 2.0)
    return 50 + 12 * blobs / blobs.std()


def shifted(whole: np.ndarray, by: tuple[float, float]) -> np.ndarray:
    """The middle of a picture that has moved by so many pixels down and right."""
    place = np.indices(SHAPE) + 32.0 - np.array(by)[:, None, None]
    return map_coordinates(whole, place, order=3)


@given(st.tuples(st.floats(-13, 13), st.floats(-13, 13)))  # farther, the inner part leaves the other frame at two corners
@settings(max_examples=8, deadline=None)
def test_a_motion_that_is_not_known_is_estimated(by: tuple[float, float]) -> None:
    whole = textured((SHAPE[0] + 64, SHAPE[1] + 64))
    down, right, seen = estimated_motion(shifted(whole, by), shifted(whole, (0, 0)))
    inner = (slice(24, -24), slice(24, -24))
    assert np.median(np.hypot(down - by[0], right - by[1])[inner]) < 0.1
    assert seen[inner].mean() > 0.95


def test_things_that_move_separately_are_followed_separately() -> None:
    wide, thing = textured((128, 160)), textured((128, 160), seed=4)
    frames = [shifted(wide, (0, 0)), shifted(wide, (0, 1))]
    for number, frame in enumerate(frames):
        frame[16 + 3 * number : 48 + 3 * number, 20:60] = thing[16:48, 20:60]
    down, right, seen = estimated_motion(frames[1], frames[0])
    assert np.median(down[28:42, 30:50]) == pytest.approx(3, abs=0.1)
    assert np.median(right[28:42, 30:50]) == pytest.approx(0, abs=0.1)
    assert np.median(right[:, 76:90]) == pytest.approx(1, abs=0.1)
    assert seen[28:42, 30:50].mean() > 0.95


def test_after_a_cut_nothing_was_seen_before() -> None:
    frames = [textured(SHAPE, seed) for seed in (5, 6)]
    assert estimated_motion(*frames)[2].mean() < 0.15
    assert abs(estimated_motion(frames[0], frames[0])[:2]).max() < 1e-9
    assert estimated_motion(frames[0], frames[0])[2].all()


def test_errors_along_an_estimated_motion_are_those_along_the_known_one() -> None:
    whole = textured((SHAPE[0] + 64, SHAPE[1] + 64))
    ideal = [shifted(whole, (0.4 * number, 2.3 * number)) for number in range(3)]
    noise = [light + each for light, each in zip(ideal, noisy(0 * ideal[0], 1.0, 3), strict=True)]
    known, estimated = figures(noise, ideal, [moved((0.4, 2.3))] * 3), figures(noise, ideal, estimated=True)
    assert (known.motion, estimated.motion) == ("known", "estimated")
    assert estimated.warped_error == pytest.approx(known.warped_error, rel=0.03)
    assert figures(ideal, ideal, estimated=True).warped_error == 0


def test_without_an_ideal_what_moves_is_not_taken_for_noise() -> None:
    still = scene()
    rendered = noisy(still, 1.0, 12)
    texture = np.random.default_rng(5).uniform(20, 90, (32, 200)).repeat(2, 0)
    for number, light in enumerate(rendered):
        light[:, 48:] += texture[:, 3 * number : 3 * number + 48] - still[:, 48:]
    found = figures(rendered)
    assert found.still_share == pytest.approx(0.5, abs=0.05)
    assert found.temporal_sigma == pytest.approx(1.0, rel=0.05)


def test_a_border_is_left_out() -> None:
    rendered = noisy(scene(), 1.0, 4)
    for number, light in enumerate(rendered):
        light[:8] += 20 * number
    evaluation = SequenceEvaluation("a", "b", border=8)
    for light in rendered:
        evaluation.add(grey(light), grey(scene()), moved((0, 0)))
    found = evaluation.figures()
    assert found.temporal_sigma == pytest.approx(1.0, rel=0.05)
    assert abs(found.largest_jump or 0) < 0.1
    assert found.warped_error == pytest.approx(np.sqrt(2), rel=0.05)


def test_one_frame_is_no_sequence() -> None:
    with pytest.raises(ValueError, match="two frames"):
        figures([scene()])
