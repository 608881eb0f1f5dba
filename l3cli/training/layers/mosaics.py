"""Training mosaics: pieces of frames as the camera sees them at some level, noisy and noise-free (docs/method.md#layers)."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import TrainingFrame, TrainingPair
from l3cli.training.patches import even_places, expose_patches, levels_at, without_colour
from l3cli.training.recipe import LearningRecipe

Floats = NDArray[np.float32]
LARGEST_SIDE = 156  # pixels, of the part of a frame whose mean is at the level that is drawn
SHEET = 1 << 17  # pixels that layers see together: the more there are of a class, the less each takes


@dataclass(frozen=True)
class Mosaics:
    """Pieces of frames of one size below one another, each with CFA phase (0, 0)."""

    count: int
    values: NDArray[np.uint16]  # (row, col) DN, noisy
    clean: Floats  # (row, col) DN without noise, clipped at the white level
    target: Floats  # (output, row, col) in the table's output unit

    @classmethod
    def joined(cls, parts: list["Mosaics"]) -> "Mosaics":
        """The mosaics of all parts, of one width."""
        arrays = [np.concatenate([getattr(part, name) for part in parts], axis=-2) for name in ("values", "clean", "target")]
        return cls(sum(part.count for part in parts), *arrays)


@dataclass(frozen=True)
class Exposed:
    """Recipe by which frames become mosaics."""

    camera: CameraModel
    recipe: LearningRecipe
    dark: float  # DN of dark current in frames that the table is for
    achromatic: float  # share of the mosaics that show their scene without colour
    noisy: bool  # whether the camera's noise is added
    inner: int  # pixels, side of the square that is learned from, in frames that are large enough …
    margin: int  # … and of what is read beyond it

    def shape(self, frame: tuple[int, int]) -> tuple[int, int]:
        """Rows and columns of the mosaics of a frame: periods of the array, unless the frame has less than one."""
        most = min(*frame, LARGEST_SIDE)
        wanted = min(self.inner + 2 * self.margin, most)
        rows, cols = (min(-(-wanted // period), most // period) * period or most for period in self.camera.cfa.shape)
        return rows, cols


def mosaics_of(frame: TrainingPair, count: int, exposed: Exposed, rng: np.random.Generator) -> Iterator[Mosaics]:
    """`count` mosaics of a frame, one by one. Simulated ones are turned and mirrored at random and shown at drawn levels,
    the last of them without colour; real pairs, whose noise cannot be told from the scene, as they are. None of a frame with
    nothing to learn from within the margin."""
    camera, shape = exposed.camera, exposed.shape(frame.raw.shape)
    if min(shape) <= 2 * exposed.margin:
        return
    if not isinstance(frame, TrainingFrame):
        yield from (_piece_of_pair(frame, shape, camera, rng) for _ in range(count))
        return
    colourless = 0 if frame.light is None else round(exposed.achromatic * count)
    yield from _shown(frame, count - colourless, shape, exposed, rng)
    if colourless:
        yield from _shown(without_colour(frame, camera), colourless, shape, exposed, rng)


def _shown(
    frame: TrainingFrame, count: int, shape: tuple[int, int], exposed: Exposed, rng: np.random.Generator
) -> Iterator[Mosaics]:
    """Mosaics of a simulated frame."""
    camera = exposed.camera
    channel = camera.channel_map(shape)
    gains = (camera.channel_gains / camera.full_scale).astype(np.float32)
    mean = np.tensordot(gains / np.float32(gains.size), frame.electrons, 1)[None]
    places = even_places(count, 3, rng)
    levels = levels_at(exposed.recipe, places[:, 2])
    for place, level in zip(places[:, :2].tolist(), levels.tolist(), strict=True):
        part, piece = _drawn_turn(frame.raw.shape, shape, place, rng)
        scale = np.float32(level / max(float(_turned(mean, part).mean()), 1e-3) if exposed.recipe.rescale else 1)
        seen = np.take_along_axis(_turned(frame.electrons, piece), channel[None].astype(np.intp), 0)[0]
        mosaic = seen * (gains * scale)[channel]
        clean = np.minimum(mosaic, 1.0) * np.float32(camera.white_level - camera.black_level) + np.float32(
            camera.black_level
        )
        values = expose_patches(mosaic, camera, rng, None, exposed.dark, channel) if exposed.noisy else np.rint(clean)
        target = _turned(frame.target, piece) * np.float32(scale * frame.exposure / camera.output_unit)
        yield Mosaics(1, values.astype(np.uint16), clean, target)


def sheets_of(mosaics: Iterable[Mosaics], period: int) -> Iterator[Mosaics]:
    """Mosaics that follow one another and are of one size together, up to SHEET pixels; those of other than whole periods
    one by one."""
    parts: list[Mosaics] = []
    for each in mosaics:
        if parts and (
            (len(parts) + 1) * each.values.size > SHEET
            or parts[0].values.shape != each.values.shape
            or each.values.shape[0] % period
        ):
            yield Mosaics.joined(parts)
            parts = []
        parts.append(each)
    if parts:
        yield Mosaics.joined(parts)


def _piece_of_pair(pair: TrainingPair, shape: tuple[int, int], camera: CameraModel, rng: np.random.Generator) -> Mosaics:
    starts = [
        int(rng.integers((length - side) // period + 1)) * period
        for length, side, period in zip(pair.raw.shape, shape, camera.cfa.shape, strict=True)
    ]
    rows, cols = (slice(start, start + side) for start, side in zip(starts, shape, strict=True))
    values = pair.raw[rows, cols]
    target = pair.target[:, rows, cols] * np.float32(pair.exposure / camera.output_unit)
    return Mosaics(1, values, np.minimum(values.astype(np.float32), np.float32(camera.white_level)), target)


Turn = tuple[int, bool, slice, slice]  # quarter turns, whether mirrored, and rows and columns of the turned frame


def _drawn_turn(
    frame: tuple[int, ...], shape: tuple[int, int], place: list[float], rng: np.random.Generator
) -> tuple[Turn, Turn]:
    """A piece of this `shape` of a turned frame, at `place` from 0 to 1 along each axis, and the part about it whose level
    is drawn."""
    turns, mirrored = int(rng.integers(4)), bool(rng.integers(2))
    parts, pieces = [], []
    for length, side, share in zip(frame[::-1] if turns % 2 else frame, shape, place, strict=True):
        most = min(length, LARGEST_SIDE)
        piece = int(share * (length - side + 1))
        part = min(max(piece - (most - side) // 2, 0), length - most)
        parts.append(slice(part, part + most))
        pieces.append(slice(piece, piece + side))
    return (turns, mirrored, parts[0], parts[1]), (turns, mirrored, pieces[0], pieces[1])


def _turned(planes: Floats, turn: Turn) -> Floats:
    turns, mirrored, rows, cols = turn
    turned = np.rot90(planes, turns, (1, 2))
    return (turned[:, :, ::-1] if mirrored else turned)[:, rows, cols]
