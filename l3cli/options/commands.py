"""Options of all commands except l3 render, in the order of the pipeline."""

import math
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar, Literal

from l3cli.errors import shortened
from l3cli.options.option import (
    LEVEL,
    PAIR,
    SITE,
    BackendOptions,
    DeviceOptions,
    ForceOptions,
    Given,
    JobsOptions,
    Name,
    Number,
    OnePath,
    Options,
    Output,
    Reader,
    Recipe,
    SeedOptions,
    Shard,
    WorkerOptions,
    option,
    options,
)

Paths = Given[Name | Sequence[Name], tuple[Path, ...]]


@options
class CalibrateOptions(ForceOptions, JobsOptions):
    """Options for calibrating a camera from a measurement file or from photos."""

    photos: Paths = option(
        (),
        "Raw photo of a ColorChecker, instead of MEASUREMENTS.toml. May be repeated.",
        flag="photo",
        metavar="RAW",
        several=True,
    )
    light: str | None = option(
        None, 'Photos only: illuminant of the ColorChecker, such as "D65" or "3200K" [default: estimated].', metavar="LIGHT"
    )
    truth: OnePath = option(
        None,
        "Virtual labs only: recipe of the simulated camera. l3 compares the calibrated model with this camera.",
        Recipe("cameras"),
        metavar="CAMERA",
        bytes=False,
    )
    accept: bool = option(
        False, "Write the model even if it fails a check, for example if its predictions of the test charts are poor."
    )


@options
class DraftOptions(CalibrateOptions):
    """Options for l3 calibrate, including those for drafting a measurement file."""

    draft: OnePath = option(
        None, "Do not calibrate. Write a measurement file for the captures or tables in FOLDER.", metavar="FOLDER"
    )
    camera: OnePath = option(
        None,
        "With ‹draft› only: camera recipe from which the sensor, filter array and optics are copied into the measurement "
        "file.",
        Recipe("cameras"),
        metavar="CAMERA",
    )


@options
class SimulateOptions(ForceOptions, WorkerOptions, SeedOptions):
    """Options for l3 simulate."""

    pictures: OnePath = option(
        None, "Also write each raw frame (TIFF) and its ideal picture (PNG) to this folder.", Output(), metavar="DIR"
    )
    dng: OnePath = option(
        None, "Also write each raw frame as DNG, for other raw converters, to this folder.", Output(), metavar="DIR"
    )
    resume: bool = option(
        False, "Continue with the frames in OUTPUT.parts, or write the pictures of a finished training set.", bytes=False
    )
    skip_bad: bool = option(
        False,
        "Skip scene files that have no readable header or do not fit the sensor, and list them.",
        bytes=False,
    )


class Shares(Reader):
    """Proportions of training patches from several training sets, as text such as "1,0.7,0.4" or as a sequence of numbers.

    At least one proportion must be above zero. They need not add up to 1.
    """

    number = Number(0, 1e6)

    def read(self, given: Any) -> tuple[Fraction, ...]:
        try:
            shares = tuple(map(self._share, given.split(",") if isinstance(given, str) else given))
        except ValueError as error:
            raise ValueError(f"{error}; separate the numbers by commas, for example 1,0.7,0.4") from None
        if not any(shares):
            raise ValueError(f"all proportions in {shortened(str(given))} are zero; set at least one above zero")
        return shares

    def _share(self, given: Any) -> Fraction:
        number = self.number.read(float(given) if isinstance(given, Fraction) else given)
        return Fraction(given if isinstance(given, Fraction) else number).limit_denominator(10**12)

    def written(self, stored: tuple[Fraction, ...]) -> str:
        return ",".join(f"{float(share):.12g}" for share in stored)


@options
class TrainOptions(ForceOptions, WorkerOptions, SeedOptions):
    """Options for training a table in a single run."""

    classes: OnePath = option(
        None,
        "Class recipe: a file, or the name of an included recipe, such as best [default: default].",
        Recipe("classes"),
        metavar="TOML",
    )
    shares: Given[Sequence[float | Fraction] | str | None, tuple[Fraction, ...] | None] = option(
        None,
        "Several training sets only: relative number of patches from each set [default: its number of frames].",
        Shares(),
        metavar="A,B…",
    )
    draft: bool = option(
        False,
        "Train in seconds, to try a CFA, with one layer and a ninth of the samples. The error of the pictures is 0.7 to 1.4 "
        "ΔE00 larger than with the recipe default.",
    )


@options
class ShardOptions(TrainOptions):
    """Options for l3 train, including those for training in shards."""

    shard: Given[PAIR | str | None, PAIR | None] = option(
        None, "Compute only the partial sums of shard I (1 to N), for ‹merge›.", Shard(), metavar="I/N", bytes=False
    )
    first: OnePath = option(None, "Shards only: table of the previous pass.", metavar="FIRST.h5")
    merge: bool = option(
        False, "Combine the partial sums of all shards of a pass, and write the table of the pass.", bytes=False
    )


@options
class EvaluateOptions(ForceOptions, BackendOptions):
    """Options for evaluating a table on a training set."""

    viewing: float = option(
        50.0, "Pixels per degree of visual angle, for S-CIELAB.", Number(2, 1000, "samples/degree"), metavar="2…1000"
    )
    border: int | None = option(
        None,
        "Number of pixels to ignore at each edge of a frame [default: all pixels whose neighbourhood extends beyond the "
        "frame].",
        Number(0, 1000, "pixels", whole=True),
        metavar="0…1000",
    )
    pictures: OnePath = option(
        None,
        "Also write four PNG files per frame to this folder: the rendered picture, the ideal picture, the picture of basic "
        "demosaicing, and an error map (black: ΔE00 0, white: ΔE00 10).",
        Output(),
        metavar="DIR",
    )
    rivals: Paths = option(
        (),
        "sRGB pictures of the same frames, in the same order, from another pipeline: a folder, pattern or glob. May be "
        "repeated.",
        flag="rival",
        metavar="PICTURES",
        several=True,
    )
    force: bool = option(False, "Write pictures even if the folder is not empty.", bytes=False, shared=True)


@options
class SequenceOptions(EvaluateOptions):
    """Options for l3 evaluate, including those for evaluating a sequence."""

    sequence: OnePath = option(
        None,
        "Evaluate rendered pictures (folder, pattern, glob or video) over time, instead of a table.",
        metavar="PICTURES",
    )
    ideal: OnePath = option(
        None,
        'Sequences only: ideal pictures, such as the folder that "l3 simulate --pictures" wrote.',
        metavar="PICTURES",
    )


class Brightness(Reader):
    """An illuminance such as "5 lux", or the luminance of a perfect white such as "20 cd/m2".

    The value is stored as the luminance of a perfect white in cd/m². A Python number without a unit is interpreted as this
    luminance.
    """

    number = Number(1e-9, 1e9)
    units: ClassVar = {"lux": 1 / math.pi, "lx": 1 / math.pi, "cd/m2": 1.0, "cd/m²": 1.0}

    def read(self, given: Any) -> float:
        text = given.strip() if isinstance(given, str) else f"{given} cd/m2"
        unit = next((unit for unit in self.units if text.endswith(unit)), None)
        if unit is None:
            raise ValueError(f'"{shortened(text)}" has no unit; add lux or cd/m2, as in "5 lux"')
        return float(self.number.read(text.removesuffix(unit).strip())) * self.units[unit]


@options
class ReportOptions(ForceOptions, BackendOptions):
    """Options for l3 report."""

    at: Given[str | float | None, float | None] = option(
        None,
        'Show only frames at this illuminance or at this luminance of a perfect white, such as "5 lux" or "20 cd/m2".',
        Brightness(),
        metavar="LIGHT",
    )


@options
class CompareOptions(ForceOptions):
    """Options for l3 compare."""

    figures: Given[str | Sequence[str], tuple[str, ...]] = option(
        ("scielab",),
        "Metric to compare, such as mean_delta_e or psnr. May be repeated.",
        flag="figure",
        metavar="NAME",
        several=True,
    )


@options
class InfoOptions(Options):
    """Options for l3 info."""

    verify: bool = option(False, "Verify every byte of FILE, and that l3 made FILE from these INPUTs.")
    version: bool = option(
        False, "Without FILE: list the OpenCL devices and the versions of l3, Python, its libraries and the decoder."
    )


@options
class ExportOptions(ForceOptions):
    """Options for l3 export. All of them except `force` apply only to transform tables."""

    form: Literal["c", "folder"] | None = option(
        None, "Tables only: write C99 source (c), or arrays with a JSON description (folder) [default: c].", flag="to"
    )
    words: Literal["float32", "int16"] | None = option(
        None,
        "C source only: type of the outputs: float32, or int16 in steps of 2^-12, or of 2^-11 for tables with a wide "
        "range [default: float32].",
    )
    white: str | None = option(
        None,
        "C source only: white of the scene, which becomes neutral. If the table has transforms for several illuminants, l3 "
        "interpolates between them for this white [default: the white of the table].",
        metavar="LIGHT|X,Y|R,G,B",
    )
    gain: float | None = option(
        None, "Tables only: analog gain of the frames to render, relative to the camera's gain [default: 1].",
        Number(1 / 1024, 1024, "times"),
        metavar="TIMES",
    )  # fmt: skip
    prefix: str | None = option(None, "C source only: prefix of all symbols and file names [default: l3].", metavar="NAME")
    which: Literal["usual", "low-noise"] | None = option(
        None, "C source only: the set of transforms to write, if the table has two sets [default: usual].", flag="set"
    )


@options
class BenchOptions(DeviceOptions):
    """Options for l3 bench."""

    list: bool = option(False, "Only list the OpenCL devices, or explain why l3 finds none.")


@options
class CheckOptions(ForceOptions):
    """Options for l3 check."""

    plot: OnePath = option(
        None, "Cameras only: also plot the filter array, curves and noise to this file (.html).", Output(), metavar="FILE"
    )


@options
class LabOptions(ForceOptions, JobsOptions, SeedOptions):
    """Options for l3 lab."""

    recipe: OnePath = option(
        None, "Lab recipe: a file, or the name of an included recipe [default: default].", Recipe("lab"), metavar="LAB.toml"
    )


@options
class PartsOptions(ForceOptions, JobsOptions):
    """Options of commands that can resume an interrupted run."""

    resume: bool = option(
        False, "Continue an interrupted run with the finished parts in OUTPUT.parts.", bytes=False, shared=True
    )


@options
class MomentsOptions(PartsOptions, SeedOptions):
    """Options for l3 design moments."""

    patches: int = option(4000, "Patches per scene.", Number(100, 1_000_000, "patches", whole=True), metavar="N")


@options
class DesignOptions(PartsOptions, SeedOptions):
    """Options for l3 design."""

    truth: int | None = option(
        None,
        "Train tables for this many of the best arrays and for a Bayer array, and evaluate the tables on the same unseen "
        "scenes. This takes minutes per array.",
        Number(1, 100, "arrays", whole=True),
        metavar="1…100",
    )

    moments: OnePath = option(None, 'Statistics of scenes that "l3 design moments" wrote.', metavar="SCENES.h5")


@options
class InitOptions(ForceOptions):
    """Options for l3 init."""

    photos: Paths = option(
        (),
        "Derive the camera from a raw file (DNG, CR2, NEF…), a folder of raw files, a design (.h5) or a camera recipe "
        "(.toml). May be repeated.",
        flag="from",
        metavar="RAW",
        several=True,
    )
    named: bool = option(False, "List the included cameras. RECIPE is then a word in their names.", flag="list")
    light: str | None = option(
        None,
        'Raw files only: illuminant of the ColorChecker, such as "D65" or "3200K" [default: estimated].',
        metavar="LIGHT",
    )
    phase: Given[PAIR | str | None, PAIR | None] = option(
        None,
        "Raw files only: row and column, from 0, of the first pixel within the filter array in the file. Set 0,0 "
        "to confirm that the array starts at the first pixel.",
        SITE,
        metavar="ROW,COL",
    )
    black_level: float | None = option(
        None, "Raw files only: black level, if the value in the file is wrong.", LEVEL, metavar="DN"
    )
    pattern: str | None = option(
        None,
        "Raw files only: filter array, if the array in the file is wrong. Write its rows, starting at the first pixel, such "
        'as "gg rr/gg rr/bb gg/bb gg", or the name of a camera recipe.',
        metavar="ROWS|RECIPE",
    )
    white_level: float | None = option(
        None, "Raw files only: white level, if the value in the file is wrong.", LEVEL, metavar="DN"
    )
    opcodes: Literal["leave"] | None = option(
        None, "DNG files only: ignore lens warps, and required opcodes that l3 does not support."
    )
