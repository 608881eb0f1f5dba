"""Frames that a process keeps from one pass of a training run to the next: those of small sets are read once."""

import contextlib
from collections.abc import Iterator

import numpy as np

from l3cli.artifacts.training_set import TrainingPair
from l3cli.training.division import SUM_BYTES


class HeldFrames:
    """Frames by the digest of their set and their index in it, as many as fit into the bytes that sums may take. The first
    stay: a pass begins again with them."""

    def __init__(self, most: int = SUM_BYTES) -> None:
        self.most, self.bytes = most, 0
        self._frames: dict[tuple[str, int], TrainingPair] = {}

    def get(self, digest: str, index: int) -> TrainingPair | None:
        """The frame, if it is held."""
        return self._frames.get((digest, index))

    def add(self, digest: str, index: int, frame: TrainingPair) -> None:
        """Hold a frame, if there is room for it."""
        size = sum(value.nbytes for value in vars(frame).values() if isinstance(value, np.ndarray))
        if self.bytes + size <= self.most:
            self._frames[digest, index] = frame
            self.bytes += size

    def clear(self) -> None:
        """Hold nothing."""
        self._frames.clear()
        self.bytes = 0


FRAMES = HeldFrames()  # of this process


@contextlib.contextmanager
def held_for_a_run() -> Iterator[None]:
    """Frames that this process reads within are held until the end."""
    try:
        yield
    finally:
        FRAMES.clear()
