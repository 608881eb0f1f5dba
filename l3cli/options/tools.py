"""Options of the commands beside the pipeline."""

from collections.abc import Sequence
from typing import Literal

from l3cli.options.option import Choice, Given, Options, Output, Recipe, option, options
from l3cli.options.pipeline import Paths
from l3cli.options.shared import BackendOptions, DeviceOptions, ForceOptions, JobsOptions, OnePath, SeedOptions

ONNX = "ONNX graphs are no longer written; give ‹to› c (C99 source, with a test) or ‹to› folder (plain arrays)"


@options
class ReportOptions(ForceOptions, BackendOptions):
    """Options of l3 report."""


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
        metavar="LIGHT|X,Y",
    )
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
class InitOptions(ForceOptions):
    """Options of l3 init."""

    photos: Paths = option(
        (),
        "The camera that took a raw file (DNG, CR2, NEF…), or those of a folder; may be given several times.",
        flag="from",
        metavar="RAW",
        several=True,
    )
    light: str | None = option(
        None, 'Light of a ColorChecker in them: "D65", "3200K"…; without, it is guessed.', metavar="LIGHT"
    )
