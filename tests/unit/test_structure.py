"""Structure classes: directions of edges, in whatever orientation a site is learned."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from l3cli.artifacts.plane_rules import DIRECTIONS, StructureRule
from l3cli.classes import structure
from l3cli.training.symmetry import orientations

SIZE = 33


def rule_of(signs: list[tuple[int, int]]) -> StructureRule:
    return StructureRule(
        level_step=1,
        gradient_factor=np.array([64], np.uint8),
        gradient_shift=np.array([6], np.uint8),
        strength_edges=np.array([2 * structure.NOISE_TRACE], np.uint32),
        coherence=31,
        turns=np.array(signs, np.int8),
        cases=1,
    )


def structure_at_centre(picture: np.ndarray, signs: tuple[int, int] = (1, 1)) -> int:
    rows, cols = picture.shape
    level = np.zeros((rows - 2, cols - 2), np.int64)
    labels = structure.structures(
        picture.astype(np.int64), level, np.zeros((rows - 6, cols - 6), np.int64), rule_of([signs])
    )
    return int(labels[rows // 2 - 3, cols // 2 - 3])


def grating(angle: float, amplitude: float = 2000.0) -> np.ndarray:
    """Stripes across `angle` in radians, the direction of the gradient from the columns towards the rows."""
    row, col = np.mgrid[:SIZE, :SIZE] - SIZE // 2
    return np.rint(amplitude * np.sin((col * np.cos(angle) + row * np.sin(angle)) * 0.5))


@pytest.mark.parametrize("number", range(DIRECTIONS))
def test_each_direction_of_an_edge_is_another_class(number: int) -> None:
    assert structure_at_centre(grating(np.pi * number / DIRECTIONS)) == 2 + number


def test_noise_of_its_level_is_flat_and_corners_have_no_direction() -> None:
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((200, 200)) * structure.SIGMA / np.sqrt(2)  # differences have twice the variance
    level, site = np.zeros((198, 198), np.int64), np.zeros((194, 194), np.int64)
    labels = structure.structures(np.rint(noise).astype(np.int64), level, site, rule_of([(1, 1)]))
    assert np.mean(labels == 0) > 0.97
    dot = np.zeros((SIZE, SIZE))
    dot[SIZE // 2, SIZE // 2] = 30000
    assert structure_at_centre(dot) == 1


@given(st.integers(0, 7), st.floats(0, np.pi), st.integers(0, 2**32 - 1))
def test_a_turned_picture_has_the_class_of_the_unturned_one_where_the_turn_is_known(
    turn: int, angle: float, seed: int
) -> None:
    """A site whose window is read in the order orientations()[turn] sees its neighbourhood as its canonical site does."""
    noise = np.random.default_rng(seed).standard_normal((SIZE, SIZE)) * 100
    canonical = grating(angle) + np.rint(noise)
    seen = np.empty(SIZE * SIZE)
    seen[orientations(SIZE)[turn]] = canonical.ravel()
    signs = structure.turn_signs(orientations(3)[turn])
    assert structure_at_centre(seen.reshape(SIZE, SIZE), signs) == pytest.approx(structure_at_centre(canonical), abs=0)
