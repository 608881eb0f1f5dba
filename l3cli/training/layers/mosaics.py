"""Training mosaics: pieces of frames as the camera sees them at some level, noisy and noise-free (docs/method.md#layers)."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import TrainingFrame, TrainingPair
from l3cli.training.patches import expose_patches, without_colour
from l3cli.training.recipe import LearningRecipe

Floats = NDArray[np.float32]
LARGEST_SIDE = 156  # pixels


@dataclass(frozen=True)
class Mosaic:
    """A piece of a frame, CFA phase (0, 0)."""

    values: NDArray[np.uint16]  # (row, col) DN, noisy
    clean: Floats  # (row, col) DN without noise, clipped at the white level
    target: Floats  # (output, row, col) in the table's output unit


@dataclass(frozen=True)
class Exposed:
    """Recipe by which frames become mosaics."""

    camera: CameraModel
    recipe: LearningRecipe
    dark: float  # DN of dark current in frames that the table is for
    achromatic: float  # share of the mosaics that show their scene without colour
    noisy: bool  # whether the camera's noise is added


def mosaics_of(frame: TrainingPair, count: int, exposed: Exposed, rng: np.random.Generator) -> Iterator[Mosaic]:
    """`count` mosaics of a frame. Simulated ones are turned and mirrored at random and shown at drawn levels, the last of
    them without colour; real pairs, whose noise cannot be told from the scene, as they are."""
    if not isinstance(frame, TrainingFrame):
        yield from (_piece_of_pair(frame, exposed.camera, rng) for _ in range(count))
        return
    camera = exposed.camera
    coloured = count if frame.light is None else count - round(exposed.achromatic * count)
    for number in range(count):
        if number == coloured:
            frame = without_colour(frame, camera)
        turn = _drawn_turn(frame.raw.shape, rng)
        seen = _turned(frame.electrons, turn) * (camera.channel_gains / camera.full_scale).astype(np.float32)[:, None, None]
        wanted = _turned(frame.target, turn) * np.float32(frame.exposure / camera.output_unit)
        scale = np.float32(
            _drawn_level(exposed.recipe, rng) / max(float(seen.mean()), 1e-3) if exposed.recipe.rescale else 1
        )
        mosaic = scale * _through_cfa(seen, camera)
        clean = np.minimum(mosaic, 1.0) * np.float32(camera.white_level - camera.black_level) + np.float32(
            camera.black_level
        )
        channel = camera.channel_map(mosaic.shape)
        values = expose_patches(mosaic, camera, rng, None, exposed.dark, channel) if exposed.noisy else np.rint(clean)
        yield Mosaic(values.astype(np.uint16), clean, wanted * scale)


def _piece_of_pair(pair: TrainingPair, camera: CameraModel, rng: np.random.Generator) -> Mosaic:
    starts = [
        int(rng.integers((length - min(length, LARGEST_SIDE)) // period + 1)) * period
        for length, period in zip(pair.raw.shape, camera.cfa.shape, strict=True)
    ]
    rows, cols = (slice(start, start + LARGEST_SIDE) for start in starts)
    values = pair.raw[rows, cols]
    target = pair.target[:, rows, cols] * np.float32(pair.exposure / camera.output_unit)
    return Mosaic(values, np.minimum(values.astype(np.float32), np.float32(camera.white_level)), target)


def _drawn_turn(shape: tuple[int, ...], rng: np.random.Generator) -> tuple[int, bool, slice, slice]:
    """Quarter turns, whether mirrored, and rows and columns of the turned frame."""
    turns, mirrored = int(rng.integers(4)), bool(rng.integers(2))
    rows, cols = shape[::-1] if turns % 2 else shape
    height, width = min(rows, LARGEST_SIDE), min(cols, LARGEST_SIDE)
    row, col = int(rng.integers(rows - height + 1)), int(rng.integers(cols - width + 1))
    return turns, mirrored, slice(row, row + height), slice(col, col + width)


def _turned(planes: Floats, turn: tuple[int, bool, slice, slice]) -> Floats:
    turns, mirrored, rows, cols = turn
    turned = np.rot90(planes, turns, (1, 2))
    return (turned[:, :, ::-1] if mirrored else turned)[:, rows, cols]


def _drawn_level(recipe: LearningRecipe, rng: np.random.Generator) -> float:
    low = recipe.highlight_from if rng.random() < recipe.highlight_share else recipe.darkest
    return float(low * (recipe.brightest / low) ** rng.random())


def _through_cfa(planes: Floats, camera: CameraModel) -> Floats:
    return np.take_along_axis(planes, camera.channel_map(planes.shape[1:])[None].astype(np.intp), 0)[0]
