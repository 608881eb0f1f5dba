"""Options of the commands from measurements to figures: l3 calibrate, simulate, train, evaluate."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

from l3cli.errors import shortened
from l3cli.options.option import Given, Name, Number, Output, Reader, Recipe, option, options
from l3cli.options.shared import (
    PAIR,
    BackendOptions,
    ForceOptions,
    JobsOptions,
    OnePath,
    SeedOptions,
    Shard,
    WorkerOptions,
)

Paths = Given[Name | Sequence[Name], tuple[Path, ...]]


@options
class CalibrateOptions(ForceOptions, JobsOptions):
    """Options of a calibration."""

    photos: Paths = option((), "Raw photo of a ColorChecker instead.", flag="photo", metavar="RAW", several=True)
    light: str | None = option(None, 'Its light: "D65", "3200K"…; without, it is guessed.', metavar="LIGHT")
    truth: OnePath = option(
        None, "Camera that a virtual lab measured, to compare with.", Recipe("cameras"), metavar="CAMERA", bytes=False
    )
    export: OnePath = option(None, 'Also write there what "l3 export" writes.', Output(), metavar="DIR")
    accept: bool = option(False, "Write the model even if it fails its checks, such as predicting its charts badly.")


@options
class DraftOptions(CalibrateOptions):
    """Options of l3 calibrate, which may draft a measurement file instead."""

    draft: OnePath = option(None, "Write a measurement file of the captures or tables in FOLDER instead.", metavar="FOLDER")
    camera: OnePath = option(None, "Sensor, array and optics of the draft.", Recipe("cameras"), metavar="CAMERA")


@options
class SimulateOptions(ForceOptions, WorkerOptions, SeedOptions):
    """Options of l3 simulate."""

    pictures: OnePath = option(None, "Also write each raw frame (TIFF) and ideal picture (PNG).", Output(), metavar="DIR")
    dng: OnePath = option(None, "Also write each raw frame as DNG, for other raw developers.", Output(), metavar="DIR")
    resume: bool = option(
        False, "Continue with the frames in OUTPUT.parts, or make the pictures of an existing set.", bytes=False
    )
    skip_bad: bool = option(
        False,
        "Leave out scenes whose files have no readable header or do not fit the sensor; exit code 1 if there were any.",
        bytes=False,
    )


class Shares(Reader):
    """Numbers that are not all zero."""

    number = Number(0, 1e6)

    def read(self, given: Any) -> tuple[Fraction, ...]:
        try:
            shares = tuple(map(self._share, given.split(",") if isinstance(given, str) else given))
        except ValueError as error:
            raise ValueError(f"{error}, in a list such as 1,0.7,0.4") from None
        if not any(shares):
            raise ValueError(f"{shortened(str(given))}: one share must be above zero")
        return shares

    def _share(self, given: Any) -> Fraction:
        number = self.number.read(float(given) if isinstance(given, Fraction) else given)
        return Fraction(given if isinstance(given, Fraction) else number).limit_denominator(10**12)

    def written(self, held: tuple[Fraction, ...]) -> str:
        return ",".join(f"{float(share):.12g}" for share in held)


@options
class TrainOptions(ForceOptions, WorkerOptions, SeedOptions):
    """Options of a training in one go."""

    classes: OnePath = option(
        None, "Class recipe or its name, such as best; without it the built-in default.", Recipe("classes"), metavar="TOML"
    )
    shares: Given[Sequence[float | Fraction] | str | None, tuple[Fraction, ...] | None] = option(
        None, "Proportion of patches from each training set, not by frames.", Shares(), metavar="A,B…"
    )
    draft: bool = option(
        False,
        "A draft in seconds, to try arrays: one layer, a tenth of the patches; 0.7 to 1.4 ΔE00 worse than default.",
    )


@options
class ShardOptions(TrainOptions):
    """Options of l3 train, which may work in shards."""

    shard: Given[PAIR | str | None, PAIR | None] = option(
        None, "Only compute the partial sums of part I of N, from 1, for ‹merge›.", Shard(), metavar="I/N", bytes=False
    )
    first: OnePath = option(None, "Table of the pass before, for the shards of the next.", metavar="FIRST.h5")
    merge: bool = option(False, "Make the table of a pass from its partial sums, all of which must be given.", bytes=False)


@options
class EvaluateOptions(ForceOptions, BackendOptions):
    """Options of the evaluation of a table."""

    viewing: float = option(
        50.0, "Samples a degree of visual angle, for S-CIELAB.", Number(2, 1000, "samples/degree"), metavar="2…1000"
    )
    border: int | None = option(
        None,
        "Pixels left out at each edge of a frame; without it those whose patch is not inside the frame.",
        Number(0, 1000, "pixels", whole=True),
        metavar="0…1000",
    )
    pictures: OnePath = option(
        None,
        "Write the table's, ideal and basic picture and an error map (black: ΔE00 0, white: 10) of every frame as PNG.",
        Output(),
        metavar="DIR",
    )
    rivals: Paths = option(
        (),
        "sRGB pictures of the frames by another pipeline (folder, pattern, glob), in their order.",
        flag="rival",
        metavar="PICTURES",
        several=True,
    )
    force: bool = option(False, "Write pictures into a folder that is not empty.", bytes=False, shared=True)


@options
class SequenceOptions(EvaluateOptions):
    """Options of l3 evaluate, which may judge a sequence instead."""

    sequence: OnePath = option(
        None,
        "Instead of a table: rendered pictures (folder, pattern, glob, video) to be judged over time.",
        metavar="PICTURES",
    )
    ideal: OnePath = option(
        None, 'What the sequence should be, such as the folder of "l3 simulate --pictures".', metavar="PICTURES"
    )
