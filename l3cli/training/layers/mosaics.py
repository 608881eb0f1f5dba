"""Training mosaics: pieces of a frame as the camera sees them at some level, noisy and noise-free (docs/method.md#layers)."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import TrainingFrame, TrainingSet
from l3cli.training.patches import expose_patches
from l3cli.training.recipe import LearningRecipe

Floats = NDArray[np.float32]
LARGEST_SIDE = 156  # pixels


@dataclass(frozen=True)
class Mosaic:
    """A piece of a frame, CFA phase (0, 0)."""

    values: NDArray[np.uint16]  # (row, col) DN, noisy
    clean: Floats  # (row, col) DN without noise, clipped at white
    target: Floats  # (output, row, col) in the table's output unit


@dataclass(frozen=True)
class White:
    """The white of the training light at Y = 1."""

    signal: NDArray[np.float64]  # (channel) share of full scale
    output: NDArray[np.float64]  # (output)


def mosaics(
    frame: TrainingFrame, head: TrainingSet, recipe: LearningRecipe, layer: Any, white: White, dark: float,
    rng: np.random.Generator,
) -> Iterator[Mosaic]:  # fmt: skip
    """Mosaics of a frame, turned and mirrored at random, at drawn levels; the last of them show the scene without colour."""
    camera = head.camera
    signal = frame.electrons / np.float32(camera.full_scale)
    target = frame.target * np.float32(frame.exposure / camera.white_dose)
    for number in range(layer.mosaics + layer.grey_mosaics):
        place = _place(signal.shape[1:], rng)
        seen, wanted = _turned(signal, place), _turned(target, place)
        if number >= layer.mosaics:  # luminance alone
            luminance = wanted[1]
            seen = white.signal.astype(np.float32)[:, None, None] * luminance
            wanted = white.output.astype(np.float32)[:, None, None] * luminance
        scale = _scale(recipe, rng) / max(float(seen.mean()), 1e-3)
        mosaic = np.float32(scale) * _through_cfa(seen, camera)
        values = expose_patches(mosaic, camera, rng, dark=dark).astype(np.uint16)
        clean = np.minimum(mosaic, 1.0) * np.float32(camera.white - camera.black) + np.float32(camera.black)
        yield Mosaic(values, clean, wanted * np.float32(scale))


def _place(shape: tuple[int, ...], rng: np.random.Generator) -> tuple[int, bool, slice, slice]:
    """Quarter turns, whether mirrored, and rows and columns of the turned frame."""
    turns, mirrored = int(rng.integers(4)), bool(rng.integers(2))
    rows, cols = shape[::-1] if turns % 2 else shape
    side = min(rows, cols, LARGEST_SIDE)
    row, col = rng.integers(rows - side + 1), rng.integers(cols - side + 1)
    return turns, mirrored, slice(row, row + side), slice(col, col + side)


def _turned(planes: Floats, place: tuple[int, bool, slice, slice]) -> Floats:
    turns, mirrored, rows, cols = place
    turned = np.rot90(planes, turns, (1, 2))
    return (turned[:, :, ::-1] if mirrored else turned)[:, rows, cols]


def _scale(recipe: LearningRecipe, rng: np.random.Generator) -> float:
    low = recipe.highlight_from if rng.random() < recipe.highlight_share else recipe.darkest
    return float(low * (recipe.brightest / low) ** rng.random())


def _through_cfa(planes: Floats, camera: CameraModel) -> Floats:
    rows, cols = planes.shape[1:]
    period = camera.cfa.shape
    channel = camera.cfa[np.ix_(np.arange(rows) % period[0], np.arange(cols) % period[1])]
    return np.take_along_axis(planes, channel[None].astype(np.intp), 0)[0]
