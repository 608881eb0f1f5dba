"""A training run: what all its passes and shards share, and a cache of the frames of its training sets."""

import contextlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from l3cli.artifacts.layers import PLANES
from l3cli.artifacts.schema import Stage, equal
from l3cli.artifacts.training_set import TrainingPair, TrainingSet, open_training_set
from l3cli.errors import InputFileError, RecipeError
from l3cli.options.commands import TrainOptions
from l3cli.recipes.builtin import known_recipes
from l3cli.recipes.load import load_recipe
from l3cli.recipes.toml import read_text
from l3cli.system.files import require_same, sha256, stamp
from l3cli.training.goal import has_components
from l3cli.training.recipe import TrainingRecipe, draft_of, for_camera
from l3cli.training.training_pass import FIRST, SUM_BYTES, spread_patches


class FrameCache:
    """Cache of frames, by the digest of their set and their index in it, up to the memory that sums may take.

    When the cache is full, the first frames stay, because every pass starts with them.
    """

    def __init__(self, most: int = SUM_BYTES) -> None:
        self.most, self.bytes = most, 0
        self._frames: dict[tuple[str, int], TrainingPair] = {}

    def get(self, digest: str, index: int) -> TrainingPair | None:
        """Return the frame, if it is cached."""
        return self._frames.get((digest, index))

    def add(self, digest: str, index: int, frame: TrainingPair) -> None:
        """Cache a frame, if there is room for it."""
        size = sum(value.nbytes for value in vars(frame).values() if isinstance(value, np.ndarray))
        if self.bytes + size <= self.most:
            self._frames[digest, index] = frame
            self.bytes += size

    def clear(self) -> None:
        """Drop all frames."""
        self._frames.clear()
        self.bytes = 0


FRAMES = FrameCache()  # shared by all passes in this process


@contextlib.contextmanager
def cached_for_a_run() -> Iterator[None]:
    """Keep the frame cache until the end of the block, then clear it."""
    try:
        yield
    finally:
        FRAMES.clear()


FIRST_PASS = "first"  # marks the table of a first pass, from which a run continues, as LAYERS do for intermediate layers
LAYERS = ("first layer", "second layer", "third layer", "fourth layer")


@dataclass(frozen=True)
class TrainingSource:
    """A training set of the run."""

    path: Path
    frames: int
    digest: str  # SHA-256
    stamp: tuple[int, ...]  # of the file, to notice when it is replaced
    chosen: tuple[int, ...] | None = None  # indices of the frames to use; None: all of the file

    def places(self, frames: range) -> Iterable[int]:
        """Return the indices in the file of a range of frames."""
        return frames if self.chosen is None else self.chosen[frames.start : frames.stop]


@dataclass(frozen=True)
class TrainingRun:
    """A training run as requested, the same for every shard."""

    training: tuple[TrainingSource, ...]
    head: TrainingSet
    patches: tuple[int, ...]  # (frame) patches to take
    given: TrainingRecipe  # as the file states it
    recipe: TrainingRecipe  # completed with values that depend on the camera
    shares: tuple[Fraction, ...] | None  # (set) proportions of patches; None: in proportion to frames
    seed: int
    stage: Stage

    @property
    def has_refinement_layers(self) -> bool:
        """Whether refinement layers apply.

        Three-output tables take any number of layers. Spectral tables take exactly one structure layer, which refines the
        leading components.
        """
        layers = self.recipe.layer
        corrects = len(layers) == 1 and not (layers[0].leaves or layers[0].coarse_chroma) and has_components(self.head)
        return bool(layers) and (len(self.head.outputs) == PLANES or corrects)

    def history_of_pass(self, number: int) -> tuple[Stage, ...]:
        """Return the history of the table of a pass of the first layer."""
        return self.history(FIRST_PASS) if number == FIRST else self.history_of_layers(1)

    def history_of_layers(self, count: int) -> tuple[Stage, ...]:
        """Return the history of a table with `count` layers."""
        whole = 1 + len(self.recipe.layer) if self.has_refinement_layers else 1
        return self.history(LAYERS[count - 1] if count < whole else "")

    def history(self, before: str = "") -> tuple[Stage, ...]:
        """Return the history of the final table, or of the intermediate table that is called `before`."""
        stage = replace(self.stage, options={**self.stage.options, "pass": before}) if before else self.stage
        return (*self.head.history, stage)


def open_run(training: tuple[Path, ...], options: TrainOptions) -> TrainingRun:
    """Return the run over some training sets. A set whose share is zero is ignored.

    Raises
    ------
    InputFileError, RecipeError
        If training sets or recipe cannot be used.
    """
    classes, shares = options.classes or known_recipes("classes")["default"], options.shares
    if shares is not None and len(shares) != len(training):
        raise RecipeError(f"‹shares› has {len(shares)} shares for {len(training)} training sets; give one for each")
    recipe = load_recipe(classes, TrainingRecipe)
    recipe = draft_of(recipe) if options.draft else recipe
    stamps = {path: stamp(path) for path in training}
    head, frames = _common_head(training, noisy=not recipe.learning.noises)
    chosen = options.chosen()
    if shares is not None:
        training, frames, shares = zip(
            *(each for each in zip(training, frames, shares, strict=True) if each[2]), strict=True
        )
        chosen = replace(options, shares=shares).chosen()
    patches = spread_patches(recipe.learning.patches, frames, shares)
    inputs = {"training set": [sha256(path) for path in training]}
    stage = Stage("train", chosen, read_text(classes), inputs)
    sources = tuple(map(TrainingSource, training, frames, inputs["training set"], map(stamps.__getitem__, training)))
    return TrainingRun(sources, head, patches, recipe, for_camera(recipe, head.camera), shares, options.seed, stage)


def frames_of(training: tuple[TrainingSource, ...], wanted: range, remote: bool) -> Iterator[TrainingPair]:
    """Yield the frames with the indices `wanted` among those of all training sets, in order.

    Raises
    ------
    InputFileError
        If a set has changed since the run began. On a worker (`remote`), the bytes of the file are compared.
    """
    before = 0
    for source in training:
        part = range(max(0, wanted.start - before), min(source.frames, wanted.stop - before))
        before += source.frames
        if not part:
            continue
        if remote:  # for who knows how many runs: nothing is held
            require_same(source.path, source.digest)
            with open_training_set(source.path, unchanged=True) as reader:
                yield from map(reader.frame, source.places(part))
            continue
        _require_in_place(source)
        yield from _held_or_read(source, source.places(part))


def _require_in_place(source: TrainingSource) -> None:
    if stamp(source.path) != source.stamp:
        raise InputFileError(f"{source.path} was replaced during training; train again")


def _held_or_read(source: TrainingSource, wanted: Iterable[int]) -> Iterator[TrainingPair]:
    with contextlib.ExitStack() as opened:
        reader = None
        for index in wanted:
            frame = FRAMES.get(source.digest, index)
            if frame is None:
                if reader is None:
                    # unchanged since _common_head read it
                    reader = opened.enter_context(open_training_set(source.path, unchanged=True))
                    _require_in_place(source)
                frame = reader.frame(index)
                FRAMES.add(source.digest, index, frame)
            yield frame


def _common_head(training: tuple[Path, ...], noisy: bool) -> tuple[TrainingSet, tuple[int, ...]]:
    """Return the head that all sets share, and the number of frames of each.

    Raises
    ------
    InputFileError
        If the sets have different cameras, or if some frames are real and the recipe needs other noise than they have.
    """
    frames, head = [], None
    for path in training:
        with open_training_set(path) as reader:
            frames.append(len(reader))
            if reader.has_pairs and not noisy:
                raise InputFileError(f"{path} holds real pairs, whose noise is what it is; leave out learning.noise_left")
            if head is None:
                head = reader.head
            elif not equal(head, reader.head):
                raise InputFileError(f"{path} and {training[0]} have different cameras or targets; train them apart")
    assert head is not None  # there is at least one file
    return head, tuple(frames)
