"""l3 design: which array? Filters × scenes × lights → arrays by predicted error; and the moments of scenes that it needs."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from l3cli.cli import options as declared
from l3cli.cli.results import Result
from l3cli.cli.terminal import show_table
from l3cli.options.commands import DesignOptions, MomentsOptions

if TYPE_CHECKING:
    from l3cli.artifacts.design import Design

SHOWN = 20  # arrays that are printed


@click.command()
@click.argument("scenes", type=declared.RecipeFile("scenes"), metavar="SCENES.toml")
@click.option(
    "--camera",
    type=declared.CAMERA,
    required=True,
    metavar="CAMERA|DESIGN.toml",
    help="Camera model or recipe, its name, or design recipe: lens and pixel count, its filters do not.",
)
@declared.output("Moments to write")
@declared.of(MomentsOptions, declared.trust, declared.dry_run)
def moments(scenes: Path, camera: Path, output: Path, options: MomentsOptions) -> Result:
    """Gather what the error of any array follows from: second moments of the spectra of scenes behind a lens and pixel.

    \b
    Example: l3 design moments default --camera bayer -o scenes.h5
    """
    from l3cli.stages.design.moments import gather_moments

    made = gather_moments(scenes, camera, output, options)
    lights = {each.illuminant: {"spectra": each.terms, "lost": each.lost} for each in made.light}
    return Result({"moments": str(output), "patches": int(made.light[0].patches.sum()), "lights": lights})


class _WithMoments(click.Command):
    """A command whose first word may be `moments`, another command."""

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        if args[:1] == ["moments"]:
            return moments.make_context(f"{info_name} moments", args[1:], parent, **extra)
        return super().make_context(info_name, args, parent, **extra)


@click.command(cls=_WithMoments)
@click.argument("recipe", type=declared.RecipeFile("designs"), metavar="DESIGN.toml")
@declared.output("Design to write")
@declared.of(DesignOptions, declared.dry_run)
def design(recipe: Path, output: Path, options: DesignOptions) -> Result:
    """Judge colour filter arrays by the error that they will reach, without training them. DESIGN.toml is a recipe or the
    name of one that comes with l3: pixel, filters, arrays to try, lights. "l3 design moments SCENES.toml --camera CAMERA -o
    SCENES.h5" gathers, once, what scenes are behind that lens and pixel.

    \b
    Example: l3 design dyes --moments scenes.h5 -o design.h5
    """
    from l3cli.stages.design.run import design as stage

    made = stage(recipe, output, options)
    return Result({"design": str(output), **_document(made)}, lambda: _text(made))


def _document(made: "Design") -> dict[str, Any]:
    predicted, dyes = made.predicted, made.dyes
    arrays = [
        {"array": pattern, "error": predicted[place].tolist(), "bayer_of_its_filters": dyes[place].tolist()}
        for place, pattern in enumerate(made.patterns)
    ]
    return {
        "tried": made.tried,
        "levels": list(made.levels),
        "unit": made.unit,
        "bayer": made.bayer,
        "arrays": arrays,
        "verdict": made.verdict,
    }


def _text(made: "Design") -> None:
    from l3cli.artifacts.design import TIE, overall

    predicted, score, rows = made.predicted, made.score, []
    places = [*range(min(SHOWN, len(score))), *([made.bayer] if made.bayer >= SHOWN else [])]
    for place in places:
        dyes = made.dyes[place]
        to_bayer = "–" if dyes.min() <= 0 else f"{100 * (score[place] / overall(dyes) - 1):+.1f} %"
        name = f"{made.patterns[place]}{' (Bayer)' if place == made.bayer else ''}"
        rank = f"{place + 1}{'=' if made.ties[place] else ''}"
        rows.append([rank, *(f"{error:.3f}" for error in predicted[place]), to_bayer, name])
    title = [f"{made.tried} arrays, predicted error ({made.unit}); =: within {TIE:.0%} of the best"]
    show_table(title, ["", *made.levels, "to Bayer", "array"], rows, *made.verdict, *made.crossings)
    _more(made)


def _more(made: "Design") -> None:
    """Print the tuned filters, and the arrays that were trained."""
    if tuned := made.tuned:
        named = zip(tuned.tuned_filters, tuned.parameters, strict=True)
        rows = [[name, *(f"{each:.3g}" for each in row)] for name, row in named]
        errors = [
            f"{level}: {before:.3f} → {after:.3f}; Bayer of the tuned filters {bayer:.3f}"
            for level, before, after, bayer in zip(made.levels, tuned.before, tuned.after, tuned.bayer, strict=True)
        ]
        show_table([f"filters of {tuned.pattern}, tuned"], ["", "centre nm", "σ nm", "peak"], rows, *errors)
    if truth := made.truth:
        headings = [f"{level}\n{what}" for level in made.levels for what in ("predicted", "ΔE00")]
        rows = [
            [*(f"{value:.2f}" for pair in zip(expected, measured[:, 0], strict=True) for value in pair), name]
            for name, expected, measured in zip(truth.trained, truth.expected, truth.measured, strict=True)
        ]
        ranks = []
        for place, level in enumerate(made.levels):
            each = [f"{figure} {truth.in_words(place, number)}" for number, figure in enumerate(truth.figures)]
            ranks.append(f"{level}: rank correlation with {'; '.join(each)}")
        show_table(["trained and judged on the same unseen scenes"], [*headings, "array"], rows, *ranks)
