"""What the processes of l3 train do: look at all frames for a pilot, sum up the patches of a pass, learn from whole sums."""

import collections
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from l3cli.artifacts.partial_sums import ClassSums
from l3cli.artifacts.schema import Stage, equal
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingPair, TrainingSet, open_training_set
from l3cli.cli import options
from l3cli.config import load_recipe, read_text
from l3cli.errors import InputFileError
from l3cli.files import require_same, sha256, stamp
from l3cli.parallel import Crew
from l3cli.train.accumulate import sum_sites
from l3cli.train.division import Portion, portions
from l3cli.train.lesson import FIRST, LAST, Lesson, has_two_passes, spread_patches
from l3cli.train.recipe import TrainingRecipe, check_learning
from l3cli.train.solve import Solution
from l3cli.train.sums import add
from l3cli.train.table import Pilot, canonical_sites, learn_site, look_at, pilot_patches, survey
from l3cli.train.weighing import Judge, judge_of

MOST_GLANCED = 256  # frames that a worker looks at in one go before the passes


@dataclass(frozen=True)
class Work:
    """Who does the work, and how much is said of it."""

    crew: Crew
    elsewhere: bool  # on other machines, which have to see the same files
    quiet: bool


@dataclass(frozen=True)
class Source:
    """A training set of the run."""

    path: Path
    frames: int
    digest: str  # SHA-256
    stamp: tuple[int, ...]  # of the file that has it


@dataclass(frozen=True)
class Course:
    """A training run as it is asked for: what every shard of it has in common."""

    training: tuple[Source, ...]
    head: TrainingSet
    patches: tuple[int, ...]  # (frame)
    recipe: TrainingRecipe
    seed: int
    stage: Stage

    def history(self, number: int) -> tuple[Stage, ...]:
        """History of what comes from pass `number`."""
        stage = replace(self.stage, options={**self.stage.options, "pass": "first"}) if number == FIRST else self.stage
        return (*self.head.history, stage)


def open_course(training: tuple[Path, ...], classes: Path | None, shares: tuple[Fraction, ...] | None, seed: int) -> Course:
    """The run of these training sets; InputFileError or RecipeError if they or the recipe cannot be used. A set whose share
    is zero is as if it were not given."""
    recipe = load_recipe(classes, TrainingRecipe) if classes else TrainingRecipe()
    stamps = {path: stamp(path) for path in training}
    head, frames = _common_head(training)
    chosen: dict[str, Any] = {"seed": seed}
    if shares is not None:
        training, frames, shares = zip(
            *(each for each in zip(training, frames, shares, strict=True) if each[2]), strict=True
        )
        chosen["shares"] = ",".join(f"{float(share):.12g}" for share in shares)
    patches = spread_patches(recipe.learning.patches, frames, shares)
    inputs = {"training set": [sha256(path) for path in training]}
    stage = Stage("train", chosen, read_text(classes) if classes else "", inputs)
    sources = tuple(map(Source, training, frames, inputs["training set"], map(stamps.__getitem__, training)))
    return Course(sources, head, patches, recipe, seed, stage)


def first_lesson(course: Course, work: Work) -> Lesson:
    """The first pass, or the only one, with the class rule that a pilot over all frames has found."""
    learning = course.recipe.learning
    check_learning(learning)
    patches = pilot_patches(course.patches)
    size = max(1, min(MOST_GLANCED, len(patches) // (4 * work.crew.size)))
    runs = (range(first, min(first + size, len(patches))) for first in range(0, len(patches), size))
    about = (course.training, work.elsewhere, course.head, course.recipe, course.seed)
    glances = [Glance(*about, run, patches[run.start : run.stop]) for run in runs]
    pilots = options.progress(work.crew(_glance, glances), len(glances), "pilot", work.quiet)
    rule, white, exposure = survey(pilots, course.patches, course.head, course.recipe, course.seed)
    kinds = f"({rule.chromas} chromas + {rule.cases - 1} saturation cases)"
    options.say(
        f"{len(course.patches)} frames, {rule.levels} levels × {rule.contrasts} contrasts × {kinds} a site", work.quiet
    )
    number = FIRST if has_two_passes(course.head, learning) else LAST
    return Lesson(course.head, course.patches, rule, learning, white, course.seed, number, exposure)


@dataclass(frozen=True)
class Glance:
    """A worker's share of the pilot."""

    training: tuple[Source, ...]
    elsewhere: bool  # as of Part
    head: TrainingSet
    recipe: TrainingRecipe
    seed: int
    frames: range
    patches: list[int]  # (frame)


def _glance(part: Glance) -> Pilot:
    frames = _frames(part.training, part.frames, part.elsewhere)
    return look_at(frames, part.frames.start, part.patches, part.head, part.recipe, part.seed)


@dataclass(frozen=True)
class Part:
    """A worker's share of a pass."""

    training: tuple[Source, ...]
    elsewhere: bool  # on another machine: its files are to be compared with ours
    lesson: Lesson
    portion: Portion
    judges: dict[int, Judge | None]


def summed(
    function: Callable[[Part], dict[int, Any]], course: Course, lesson: Lesson, first: TransformTable | None,
    blocks: list[range], work: Work,
) -> Iterator[tuple[int, Any]]:  # fmt: skip
    """What `function` makes of the parts, for each canonical site in order: its sums over `blocks`, added up where several
    processes share a site, or what has been learned from them already."""
    parts = []
    for portion in portions(lesson, canonical_sites(lesson.head, lesson.rule, lesson.recipe), blocks, work.crew.size):
        judges = {
            site: judge_of(first, site, lesson.recipe.error_power) if first is not None else None for site in portion.sites
        }
        parts.append(Part(course.training, work.elsewhere, lesson, portion, judges))
    left = collections.Counter(site for part in parts for site in part.judges)
    waiting: dict[int, ClassSums] = {}
    for found in options.progress(work.crew(function, parts), len(parts), "sums", work.quiet):
        for site, result in found.items():
            left[site] -= 1
            if site in waiting:
                add(waiting[site], result)
            else:
                waiting[site] = result
            if not left[site]:
                yield site, waiting.pop(site)


def sum_part(part: Part) -> dict[int, ClassSums]:
    """Sums of every site."""
    training = part.training
    blocks = ((block[0], sites, _frames(training, block, part.elsewhere)) for block, sites in part.portion.blocks)
    return sum_sites(part.lesson, blocks, part.judges)


def learn_part(part: Part) -> dict[int, ClassSums | Solution]:
    """Solutions of the sites whose sums are whole, which then need not travel; sums of the others."""
    found: dict[int, Any] = dict(sum_part(part))
    for site in part.portion.whole:
        found[site] = learn_site(part.lesson, [found[site]], site)
    return found


def _frames(training: tuple[Source, ...], wanted: range | None = None, elsewhere: bool = False) -> Iterator[TrainingPair]:
    """The frames of all training sets in order, or those whose index among all of them is `wanted`. InputFileError if a set
    is not the one that the run began with; `elsewhere` its bytes are compared with those of the machine that asks."""
    before = 0
    for source in training:
        here = range(source.frames)
        if wanted is not None:
            here = range(max(0, wanted.start - before), min(source.frames, wanted.stop - before))
        before += source.frames
        if not here:
            continue
        if elsewhere:
            require_same(source.path, source.digest)
        with open_training_set(source.path, unchanged=True) as reader:  # since _common_head looked at it
            if not elsewhere and stamp(source.path) != source.stamp:
                raise InputFileError(f"{source.path} has been replaced while it was trained on; train again")
            yield from map(reader.frame, here)


def _common_head(training: tuple[Path, ...]) -> tuple[TrainingSet, tuple[int, ...]]:
    """The head that all sets share and the frames of each; InputFileError if they are of different cameras."""
    frames, head = [], None
    for path in training:
        with open_training_set(path) as reader:
            frames.append(len(reader))
            if head is None:
                head = reader.head
            elif not equal(head, reader.head):
                raise InputFileError(f"{path} and {training[0]} have different cameras or targets; train them apart")
    assert head is not None  # click asks for at least one file
    return head, tuple(frames)
