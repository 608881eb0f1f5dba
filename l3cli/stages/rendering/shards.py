"""Shards of a sequence: runs on several machines that render parts of it, each for itself, to the pictures of one run."""

from l3cli.errors import RecipeError
from l3cli.io.sequences import FrameSequence
from l3cli.rendering.temporal.chunks import CHUNK


def part_of(sequence: FrameSequence, shard: tuple[int, int], temporal: bool) -> range:
    """The places, from 0, of the frames that a shard (number from 1, of how many) renders; of a sequence that is filtered in
    time whole chunks, where each shard has one. RecipeError if nobody knows how many frames there are, or they are too
    few."""
    number, shards = shard
    if sequence.count is None:
        raise RecipeError(f"{sequence.what} does not say how many frames it has; choose those of all shards with ‹frames›")
    count = sequence.count - sequence.lost
    if count < shards:
        raise RecipeError(f"{sequence.what} has {count} frames, too few for {shards} shards")
    # A shard that begins within a chunk filters what lies before it there, too.
    grid = CHUNK if temporal and count >= shards * CHUNK else 1
    first, last = (count * index // shards for index in (number - 1, number))
    return range(_nearest(first, grid), count if number == shards else _nearest(last, grid))


def _nearest(place: int, grid: int) -> int:
    """Halves go up, so that places at least `grid` apart stay apart."""
    return (place + grid // 2) // grid * grid
