"""Options of the commands but l3 render: those from measurements to figures, then those beside the pipeline."""

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
    Choice,
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
    """Options of a calibration."""

    photos: Paths = option((), "Raw photo of a ColorChecker instead.", flag="photo", metavar="RAW", several=True)
    light: str | None = option(None, 'Its light: "D65", "3200K"…; without, it is guessed.', metavar="LIGHT")
    truth: OnePath = option(
        None, "Camera that a virtual lab measured, to compare with.", Recipe("cameras"), metavar="CAMERA", bytes=False
    )
    export: OnePath = option(None, 'Also write there what "l3 export" writes.', Output(), metavar="DIR")
    sheet: OnePath = option(
        None, "Also write there the EMVA 1288 data sheet of dark and white frames (.html).", Output(), metavar="FILE",
        bytes=False,
    )  # fmt: skip
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
        False, "A draft in seconds, to try arrays: one layer, a ninth of the rows; 0.7 to 1.4 ΔE00 worse than default."
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


ONNX = "ONNX graphs are no longer written; give ‹to› c (C99 source, with a test) or ‹to› folder (plain arrays)"


class Brightness(Reader):
    """An illuminance or luminance with its unit, held as the luminance of a perfect white in cd/m².

    A Python number is a luminance in cd/m².
    """

    number = Number(1e-9, 1e9)
    units: ClassVar = {"lux": 1 / math.pi, "lx": 1 / math.pi, "cd/m2": 1.0, "cd/m²": 1.0}

    def read(self, given: Any) -> float:
        text = given.strip() if isinstance(given, str) else f"{given} cd/m2"
        unit = next((unit for unit in self.units if text.endswith(unit)), None)
        if unit is None:
            raise ValueError(f'"{shortened(text)}" has no unit; give it in lux or cd/m2, such as "5 lux"')
        return float(self.number.read(text.removesuffix(unit).strip())) * self.units[unit]


@options
class ReportOptions(ForceOptions, BackendOptions):
    """Options of l3 report."""

    at: Given[str | float | None, float | None] = option(
        None,
        'Show pictures of frames at this illuminance or luminance of a perfect white: "5 lux", "20 cd/m2".',
        Brightness(),
        metavar="LIGHT",
    )


@options
class CompareOptions(ForceOptions):
    """Options of l3 compare."""

    figures: Given[str | Sequence[str], tuple[str, ...]] = option(
        ("scielab",),
        "Figure of the evaluations, such as mean_delta_e or psnr. May be repeated.",
        flag="figure",
        metavar="NAME",
        several=True,
    )


@options
class InfoOptions(Options):
    """Options of l3 info."""

    verify: bool = option(False, "Verify every byte of FILE, and that it was made from the INPUTs.")
    version: bool = option(False, "Versions of l3, Python and libraries, OpenCL devices, decoder; no FILE.")


@options
class ExportOptions(ForceOptions):
    """Options of l3 export; all but `force` are for tables."""

    form: Literal["c", "folder"] | None = option(
        None, "Of a table: C99 source (as without it), or arrays with a JSON.", Choice("c", "folder", gone={"onnx": ONNX}),
        flag="to",
    )  # fmt: skip
    words: Literal["float32", "int16"] | None = option(
        None, "Of C source: outputs as floats, or in steps of 2^-12. [float32]"
    )
    white: str | None = option(
        None,
        "Of a table: C source shows this white neutral; transforms of several lights are mixed for it. [the table's]",
        metavar="LIGHT|X,Y|R,G,B",
    )
    gain: float | None = option(
        None, "Of a table: analog gain, over its camera's, that transforms are for. [1]", Number(1 / 1024, 1024, "times"),
        metavar="TIMES",
    )  # fmt: skip
    prefix: str | None = option(None, "Of C source: what its symbols and files begin with. [l3]", metavar="NAME")
    which: Literal["usual", "low-noise"] | None = option(
        None, "Of a table of two sets of transforms: the one that C source holds. [usual]",
        Choice("usual", "low-noise", gone={"quiet": "the quiet set is called ‹set› low-noise now"}), flag="set",
    )  # fmt: skip


@options
class BenchOptions(DeviceOptions):
    """Options of l3 bench."""

    list: bool = option(False, "Only list the OpenCL devices, or say why there are none.")


@options
class CheckOptions(ForceOptions):
    """Options of l3 check."""

    plot: OnePath = option(None, "Also draw array, curves and noise of cameras (.html).", Output(), metavar="FILE")


@options
class LabOptions(ForceOptions, JobsOptions, SeedOptions):
    """Options of l3 lab."""

    recipe: OnePath = option(
        None, "Lab recipe or its name; without it the built-in default.", Recipe("lab"), metavar="LAB.toml"
    )


@options
class PartsOptions(ForceOptions, JobsOptions):
    """Choice of what is done with the parts of an earlier run."""

    resume: bool = option(False, "Continue with what is finished in OUTPUT.parts.", bytes=False, shared=True)


@options
class MomentsOptions(PartsOptions, SeedOptions):
    """Options of l3 design moments."""

    patches: int = option(4000, "Patches of a scene.", Number(100, 1_000_000, "patches", whole=True), metavar="N")


@options
class DesignOptions(PartsOptions, SeedOptions):
    """Options of l3 design."""

    truth: int | None = option(
        None,
        "Train and judge so many of the best arrays, and Bayer's, on the same unseen scenes; minutes each.",
        Number(1, 100, "arrays", whole=True),
        metavar="1…100",
    )

    moments: OnePath = option(None, 'Moments of scenes, which "l3 design moments" writes.', metavar="SCENES.h5")


@options
class InitOptions(ForceOptions):
    """Options of l3 init."""

    photos: Paths = option(
        (),
        "The camera that took a raw file (DNG, CR2, NEF…), or those of a folder; may be given several times. Or a design, "
        "or a camera recipe (.toml).",
        flag="from",
        metavar="RAW",
        several=True,
    )
    named: bool = option(False, "List the cameras by name, of RECIPE as words to look for only those.", flag="list")
    light: str | None = option(
        None, 'Light of a ColorChecker in them: "D65", "3200K"…; without, it is guessed.', metavar="LIGHT"
    )
    phase: Given[PAIR | str | None, PAIR | None] = option(
        None,
        "Site of the array they state, from 0, that their first pixel has; 0,0: the array lies as they state.",
        SITE,
        metavar="ROW,COL",
    )
    black_level: float | None = option(None, "Black level of the raw files, where they misstate it.", LEVEL, metavar="DN")
    pattern: str | None = option(
        None,
        'Their array, if they state a wrong one: rows from the first pixel on, "gg rr/gg rr/bb gg/bb gg", or the name of a '
        "recipe.",
        metavar="ROWS|RECIPE",
    )
    white_level: float | None = option(None, "White level of the raw files, where they misstate it.", LEVEL, metavar="DN")
    opcodes: Literal["leave"] | None = option(
        None, "Of a DNG: leave out the opcodes, such as a lens warp, that it demands and l3 does not carry out."
    )
