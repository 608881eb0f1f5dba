"""l3 evaluate: evaluates a table on frames with known targets."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from l3cli.cli import options as declared
from l3cli.cli import terminal
from l3cli.cli.results import Result
from l3cli.cli.terminal import show, show_table
from l3cli.options.commands import SequenceOptions
from l3cli.physics.figures import FIGURES, figure_text
from l3cli.system.text import figure as number

if TYPE_CHECKING:
    from l3cli.evaluation.sequence import SequenceFigures


@click.command()
@click.argument("table", type=declared.FILE, required=False, metavar="TABLE.h5")
@click.argument("frames", type=declared.FILE, required=False, metavar="TRAINING.h5")
@declared.of(SequenceOptions)
def evaluate(table: Path | None, frames: Path | None, options: SequenceOptions) -> Result:
    """Render the raw frames of a training set that was not used to train TABLE, and compare the pictures with the targets.

    Pictures are compared as displayed: adapted to D65, with the 99th percentile of the target's luminance as white. The
    baselines are a basic pipeline without training (interpolation, white balance, colour matrix) and, for Bayer arrays if
    colour-demosaicing is installed, Malvar's and Menon's methods with the same matrix.

    If the outputs are the bands of the camera, they are compared as spectra (angle), as linear values, and as 8-bit values
    with white at 255. The baselines are bilinear interpolation, Malvar and Menon for Bayer arrays, and spectral differences
    (sd) and pseudo-panchromatic image difference (ppid) for arrays in which every band occurs once per period.

    If the outputs are reflectances or radiances, they are also compared as spectra. Reflectances are also compared as
    colours (mean ΔE00) under A, D65 and F11. The baselines are two linear estimates from the demosaicked bands of each pixel
    (wiener, pinv). They are computed from synthetic scenes under the illuminant of the frame.

    With --rival, pictures from a different pipeline are also evaluated, under the name of their folder. Their brightness
    does not matter, because l3 fits one factor per picture.

    With --sequence, l3 evaluates rendered pictures over time: the noise and flicker of CIE L* on patches without motion, and
    the largest jump in the mean of a frame. With --ideal, it also evaluates PSNR, ΔE00, and how the error changes along the
    known motion.

    \b
    Example: l3 evaluate table.h5 unseen.h5 --json
    """
    if options.sequence is not None:
        return _sequence(options.sequence, table, options)
    if table is None or frames is None or options.ideal is not None:
        raise click.UsageError("specify TABLE.h5 and TRAINING.h5, or --sequence PICTURES and optionally --ideal")
    from l3cli.stages.evaluation import evaluate as stage

    document, files = stage(table, frames, options)
    return Result(document, lambda: print_tables(document), files=files)


def _sequence(sequence: Path, table: Path | None, options: SequenceOptions) -> Result:
    if table is not None or options.pictures is not None or options.rivals:
        raise click.UsageError(
            "--sequence cannot be combined with TABLE.h5, TRAINING.h5, --pictures or --rival; remove them"
        )
    for name in ("backend", "viewing", "force"):
        if click.get_current_context().get_parameter_source(name) is not ParameterSource.DEFAULT:
            raise click.UsageError(f"--{name} cannot be used with --sequence; remove --{name}")
    from l3cli.stages.evaluation import evaluate_sequence

    figures, files = evaluate_sequence(sequence, options)
    return Result(figures.document(), lambda: print_sequence(figures), files=files)


WIDE = 110  # characters; narrower terminals do not show the metrics in LESS_NEEDED
LESS_NEEDED = ("median_delta_e", "output_psnr", "ssim")
NOT_SHOWN = ("visual_noise", "gfc", "delta_e_a", "delta_e_f11")  # metrics that are only in the JSON and in the report


def print_tables(document: dict[str, Any]) -> None:
    """Print the results of an evaluation as tables.

    The tables contain the metrics of each frame, their mean, the metrics by brightness and by illuminant, and the metrics
    defined by standards. For baselines, only the main metrics are printed. Results for classes, patches, bands and gains
    appear only in the JSON and in the report.
    """
    width = terminal.width()
    wide = width is None or width >= WIDE
    figures = [
        figure for figure in document["frames"][0]["ours"] if figure not in (NOT_SHOWN if wide else LESS_NEEDED + NOT_SHOWN)
    ]
    baselines = document["pipelines"][1:]
    second = next(each for each in ("psnr_s0", "delta_e_d65", "psnr") if each in figures)
    second = "rmse" if second == "delta_e_d65" else second
    main = [figures[0]] + [figure for figure in figures if figure == second and wide]
    shown = [("ours", figure) for figure in figures] + [(baseline, figure) for baseline in baselines for figure in main]
    named = [FIGURES[figure].short if owner == "ours" else f"{owner}\n{FIGURES[figure].short}" for owner, figure in shown]

    def values(row: dict[str, Any]) -> list[str]:
        return [figure_text(figure, row[owner][figure]) for owner, figure in shown]

    rows = [[f["scene"], f["illuminant"], f"{f['level']:.3f}", *values(f)] for f in document["frames"]]
    rows.append(["mean", "", "", *values(document["mean"])])
    show_table([], ["scene", "light", "level", *named], rows)
    levels = [[f"{g['from']:.3f}–{g['to']:.3f}", str(g["frames"]), *values(g)] for g in document["by_level"]]
    show_table(["", "by brightness (mean signal as a fraction of full scale)"], ["level", "frames", *named], levels)
    if len(document["by_illuminant"]) > 1:
        lights = [[g["illuminant"], str(g["frames"]), *values(g)] for g in document["by_illuminant"]]
        show_table(["", "by illuminant"], ["light", "frames", *named], lights)
    _print_standards(document["standards"]["figures"])
    for baseline, counts in document["better"].items():
        shares = ", ".join(f"{FIGURES[figure].short} {counts[figure]}" for figure in main)
        show(f"frames (of {len(document['frames'])}) in which the table is better than {baseline}: {shares}")


def _print_standards(figures: dict[str, dict[str, float | None]]) -> None:
    """Print each pipeline's sharpness in cycles/pixel and lowest usable luminance (docs/measurement.md)."""
    names = list(next(iter(figures.values())))
    rows = [[owner, *(figure_text(name, of[name]) for name in names)] for owner, of in figures.items()]
    show_table(["", "by standards"], ["pipeline", *(FIGURES[name].short for name in names)], rows)


def print_sequence(figures: "SequenceFigures") -> None:
    """Print the metrics of each frame, and then the metrics of the whole sequence."""
    named = ["frame", "mean L*", "jump", "step σ", "warped\nerror", "PSNR dB", "ΔE00 mean"]
    rows = []
    for each in figures.frames:
        brightness = each.mean_lightness, each.jump, each.step_sigma
        rows.append([str(each.frame), *map(_known, (*brightness, each.warped_error, each.psnr, each.mean_delta_e))])
    whole = [
        ["temporal σ of L*, still patches", _known(figures.temporal_sigma)],
        ["temporal σ of the mean L* of still patches", _known(figures.patch_sigma)],
        ["fraction of still patches", f"{figures.still_share:.1%}"],
        [f"largest jump of mean L* (frame {figures.largest_jump_frame})", _known(figures.largest_jump)],
        [f"warped error of L* ({figures.motion or 'no'} motion)", _known(figures.warped_error)],
        ["PSNR dB", _known(figures.psnr)],
        ["ΔE00 mean", _known(figures.mean_delta_e)],
    ]
    show_table([], named, rows)
    show_table([""], ["whole sequence", ""], whole)


def _known(value: float | None) -> str:
    return "–" if value is None else number(value, ".3f")
