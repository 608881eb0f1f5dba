"""Settings and training sets that all passes and shards of a training run share, and a cache of frames."""

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
from l3cli.physics.stokes import has_stokes
from l3cli.recipes.builtin import known_recipes
from l3cli.recipes.load import load_recipe
from l3cli.recipes.toml import read_text
from l3cli.system.files import require_same, sha256, stamp
from l3cli.system.text import counted
from l3cli.training.goal import has_components
from l3cli.training.recipe import TrainingRecipe, draft_of, for_camera
from l3cli.training.training_pass import FIRST, SUM_BYTES, spread_patches


class FrameCache:
    """A cache of frames, which are identified by the digest of their training set and their index in it.

    When the cache is full, no frames are added. It then contains the first frames of a pass, and every later pass also reads
    these frames first.

    Parameters
    ----------
    most : int
        Size of the cache in bytes. By default, the cache may be as large as the sums of a process.
    """

    def __init__(self, most: int = SUM_BYTES) -> None:
        self.most, self.bytes = most, 0
        self._frames: dict[tuple[str, int], TrainingPair] = {}

    def get(self, digest: str, index: int) -> TrainingPair | None:
        """Return a frame, or None if it is not in the cache."""
        return self._frames.get((digest, index))

    def add(self, digest: str, index: int, frame: TrainingPair) -> None:
        """Add a frame, unless the cache is full."""
        size = sum(value.nbytes for value in vars(frame).values() if isinstance(value, np.ndarray))
        if self.bytes + size <= self.most:
            self._frames[digest, index] = frame
            self.bytes += size

    def clear(self) -> None:
        self._frames.clear()
        self.bytes = 0


FRAMES = FrameCache()  # shared by all passes in this process


@contextlib.contextmanager
def cached_for_a_run() -> Iterator[None]:
    """Keep the frame cache during a `with` block, and clear it at the end."""
    try:
        yield
    finally:
        FRAMES.clear()


# The history of an intermediate table contains FIRST_PASS after the first pass, or an entry of LAYERS after a layer.
FIRST_PASS = "first"
LAYERS = ("first layer", "second layer", "third layer", "fourth layer")


@dataclass(frozen=True)
class TrainingSource:
    """A training set file, with the indices of the frames that the run uses."""

    path: Path
    frames: int  # number of frames
    digest: str  # SHA-256
    stamp: tuple[int, ...]  # file state, which changes if the file is replaced
    chosen: tuple[int, ...] | None = None  # indices of the frames to use; None for all frames in the file

    def places(self, frames: range) -> Iterable[int]:
        """Convert numbers of frames in the run, which skip unused frames, to indices in the file."""
        return frames if self.chosen is None else self.chosen[frames.start : frames.stop]


@dataclass(frozen=True)
class TrainingRun:
    """The training sets and settings of a run, which all shards share."""

    training: tuple[TrainingSource, ...]
    head: TrainingSet
    patches: tuple[int, ...]  # number of patches to sample from each frame
    given: TrainingRecipe  # the class recipe of the user
    recipe: TrainingRecipe  # the class recipe, completed with values that depend on the camera
    shares: tuple[Fraction, ...] | None  # proportion of patches for each set; None: proportional to the number of frames
    seed: int
    stage: Stage

    @property
    def has_refinement_layers(self) -> bool:
        """Whether refinement layers can be trained for the outputs.

        Tables with three outputs can have any number of refinement layers. Tables with spectral outputs can have one, with
        structure classes, which refines the leading components of the spectra. Tables with colours and Stokes parameters can
        have one, with or without coarse chroma.
        """
        layers = self.recipe.layer
        corrects = len(layers) == 1 and has_components(self.head) and not layers[0].leaves
        corrects = corrects and (has_stokes(self.head.outputs) or not layers[0].coarse_chroma)
        return bool(layers) and (len(self.head.outputs) == PLANES or corrects)

    def history_of_pass(self, number: int) -> tuple[Stage, ...]:
        """Return the history of the table after a pass of the first layer."""
        return self.history(FIRST_PASS) if number == FIRST else self.history_of_layers(1)

    def history_of_layers(self, count: int) -> tuple[Stage, ...]:
        """Return the history of a table with `count` layers."""
        whole = 1 + len(self.recipe.layer) if self.has_refinement_layers else 1
        return self.history(LAYERS[count - 1] if count < whole else "")

    def history(self, before: str = "") -> tuple[Stage, ...]:
        """Return the history of the final table, or of the intermediate table after the pass `before`."""
        stage = replace(self.stage, options={**self.stage.options, "pass": before}) if before else self.stage
        return (*self.head.history, stage)


def open_run(training: tuple[Path, ...], options: TrainOptions) -> TrainingRun:
    """Set up a training run: read the class recipe and the training set headers, and verify the training sets.

    Training sets with a share of zero are ignored. If `options.draft` is set, the recipe is replaced by its draft version.

    Raises
    ------
    InputFileError, RecipeError
        If a training set or the recipe is unsuitable.
    """
    classes, shares = options.classes or known_recipes("classes")["default"], options.shares
    if shares is not None and len(shares) != len(training):
        raise RecipeError(
            f"‹shares› contains {counted(len(shares), 'value')}, but the number of training sets is {len(training)}; "
            "set one share per training set"
        )
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
    """Yield a range of frames from the concatenated training sets.

    Parameters
    ----------
    training : tuple of TrainingSource
        The training sets.
    wanted : range
        Indices of the frames in the concatenated training sets.
    remote : bool
        Whether this process is a worker on another machine. Such workers verify the SHA-256 of each file and cache no
        frames.

    Raises
    ------
    InputFileError
        If a training set has changed since the run began.
    """
    before = 0
    for source in training:
        part = range(max(0, wanted.start - before), min(source.frames, wanted.stop - before))
        before += source.frames
        if not part:
            continue
        if remote:  # no cache, because a worker may serve any number of runs
            require_same(source.path, source.digest)
            with open_training_set(source.path, unchanged=True) as reader:
                yield from map(reader.frame, source.places(part))
            continue
        _require_in_place(source)
        yield from _cached_or_read(source, source.places(part))


def _require_in_place(source: TrainingSource) -> None:
    if stamp(source.path) != source.stamp:
        raise InputFileError(f"{source.path} has changed during training; start the training again")


def _cached_or_read(source: TrainingSource, wanted: Iterable[int]) -> Iterator[TrainingPair]:
    with contextlib.ExitStack() as opened:
        reader = None
        for index in wanted:
            frame = FRAMES.get(source.digest, index)
            if frame is None:
                if reader is None:
                    # The digest has already been verified by _common_head.
                    reader = opened.enter_context(open_training_set(source.path, unchanged=True))
                    _require_in_place(source)
                frame = reader.frame(index)
                FRAMES.add(source.digest, index, frame)
            yield frame


def _common_head(training: tuple[Path, ...], noisy: bool) -> tuple[TrainingSet, tuple[int, ...]]:
    """Return the header that all training sets share, and the number of frames in each set.

    Parameters
    ----------
    training : tuple of Path
        Files of the training sets.
    noisy : bool
        Whether the class recipe keeps the full noise of the frames. If False, the noise is reduced, which is possible only
        for simulated frames.

    Raises
    ------
    InputFileError
        If the sets are for different cameras or outputs, or if `noisy` is False and a set contains real pairs, whose raw
        frames were captured with a camera.
    """
    frames, head = [], None
    for path in training:
        with open_training_set(path) as reader:
            frames.append(len(reader))
            if reader.has_pairs and not noisy:
                raise InputFileError(
                    f"{path} contains real pairs, whose noise cannot be reduced; remove learning.noise_left from the class "
                    "recipe"
                )
            if head is None:
                head = reader.head
            elif not equal(head, reader.head):
                raise InputFileError(
                    f"{path} is for another camera or other outputs than {training[0]}; train a separate table on each"
                )
    assert head is not None  # there is at least one file
    return head, tuple(frames)
