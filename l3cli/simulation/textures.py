"""Textures of leaves: sand to clouds, brushed metal, blotches and stripes (docs/method.md#procedural-scenes).

A leaf shows a random part of a periodic piece of a random field, which is wider than it: fields as large as the picture
would cost four times as much, and seven eighths of each would lie under leaves of another texture.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.simulation.fields import piece

# Exponent range of the amplitude spectrum and stretch of the pink textures: from sand to clouds, and a brushed one.
PINK = ((0.3, 0.9, 1.0), (0.8, 1.3, 1.0), (1.6, 1.6, 1.0), (1.0, 1.0, 1.0), (0.6, 0.6, 1.0), (1.1, 1.1, 4.0))
BLOTCHES, STRIPES = len(PINK), len(PINK) + 1  # beside them
TEXTURES = len(PINK) + 2
WIDEST = 1024  # samples of a piece down and across, a power of two; leaves are up to 400 wide


@dataclass(frozen=True)
class Textures:
    """The textures of a frame, each with a variance of about 1, and which part of which one each leaf shows."""

    pieces: NDArray[np.float32]  # (texture, row, col), periodic
    texture: NDArray[np.intp]  # (leaf)
    start: NDArray[np.int32]  # (leaf) index in the pieces of where the leaf's own begins
    shift: NDArray[np.int32]  # (2, leaf) samples down and across
    level: NDArray[np.float32]  # (leaf) what is added to the piece: its slower changes
    direction: tuple[float, float]  # stripes a sample, down and across
    waver: float  # stripes
    duty: float  # share of a period


def draw_textures(
    rng: np.random.Generator, shape: tuple[int, int], texture: NDArray[np.intp], oversampling: int
) -> Textures:
    """Draw textures for a picture of `shape` (rows, cols) in samples, for leaves that show these of them, (leaf)."""
    side = min(WIDEST, 1 << (max(shape) - 1).bit_length())
    pieces = np.empty((TEXTURES, side, side), np.float32)
    level = np.empty(TEXTURES)
    fields = [(rng.uniform(low, high), stretch) for low, high, stretch in PINK]
    fields.append((rng.uniform(0.8, 1.8), np.exp(rng.uniform(0.0, 2.0))))  # of the blotches
    fields.append((1.8, 1.0))  # by which stripes waver
    for number, (exponent, stretch) in enumerate(fields):
        pieces[number], level[number] = piece(rng, side, shape, exponent, stretch)
    angle, period = rng.uniform(0, np.pi), oversampling * np.exp(rng.uniform(np.log(2.0), np.log(14.0)))
    return Textures(
        pieces=pieces,
        texture=texture,
        start=(texture * side**2).astype(np.int32),
        shift=rng.integers(side, size=(2, len(texture)), dtype=np.int32),
        level=(level[texture] * rng.standard_normal(len(texture))).astype(np.float32),
        direction=(np.sin(angle) / period, np.cos(angle) / period),
        waver=rng.uniform(0, 1),
        duty=rng.uniform(0.3, 0.7),
    )


def sampled(textures: Textures, label: NDArray[np.integer], down: NDArray, across: NDArray) -> NDArray[np.float32]:
    """Return the texture of the leaf `label` (row, col) at samples `down` (row, 1) and `across` (col)."""
    side = textures.pieces.shape[1]
    row = (textures.shift[0].take(label) + down.astype(np.int32)) & np.int32(side - 1)
    row *= np.int32(side)
    row += (textures.shift[1].take(label) + across.astype(np.int32)) & np.int32(side - 1)
    row += textures.start.take(label)
    value = textures.pieces.reshape(-1).take(row)
    value += textures.level.take(label)
    _set_contrast(value, textures, label, down, across)
    return value


def _set_contrast(
    value: NDArray[np.float32], textures: Textures, label: NDArray[np.integer], down: NDArray, across: NDArray
) -> None:
    """Make two tones of the values of blotches, with sharp borders as on fur, bark and prints, and of stripes, as on cloth,
    blinds and letters."""
    texture = textures.texture.astype(np.uint8).take(label)
    blotched = np.nonzero(texture == BLOTCHES)
    value[blotched] = np.tanh(np.float32(8) * value[blotched])
    striped = np.nonzero(texture == STRIPES)
    position = np.float32(textures.waver) * value[striped]
    position += down[striped[0], 0] * np.float32(textures.direction[0])
    position += across[striped[1]] * np.float32(textures.direction[1])
    position -= np.floor(position)
    value[striped] = np.where(position < textures.duty, np.float32(1.0), np.float32(-1.0))
