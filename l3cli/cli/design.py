"""The commands `l3 design` and `l3 design moments`.

`l3 design` ranks colour filter arrays by their predicted error. `l3 design moments` computes the scene statistics that the
prediction needs.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from l3cli.cli import options as declared
from l3cli.cli.results import Result
from l3cli.cli.terminal import show_table
from l3cli.options.commands import DesignOptions, MomentsOptions

if TYPE_CHECKING:
    from l3cli.artifacts.design import Design

SHOWN = 20  # maximum number of arrays that are printed


@click.command()
@click.argument("scenes", type=declared.RecipeFile("scenes"), metavar="SCENES.toml")
@click.option(
    "--camera",
    type=declared.CAMERA,
    required=True,
    metavar="CAMERA|DESIGN.toml",
    help="Camera model, camera recipe, name of a recipe, or design recipe. Only its lens and its pixel are used.",
)
@declared.output("Scene moments to write")
@declared.of(MomentsOptions, declared.trust)
def moments(scenes: Path, camera: Path, output: Path, options: MomentsOptions) -> Result:
    """Compute statistics of scenes (second moments of the spectra behind a lens and a pixel). "l3 design" predicts the error
    of any colour filter array from these statistics.

    \b
    Example: l3 design moments default --camera bayer -o scenes.h5
    """
    from l3cli.stages.design import gather_moments

    made, files = gather_moments(scenes, camera, output, options)
    lights = {each.illuminant: each.terms for each in made.light}
    document = {"moments": str(output), "patches": int(made.light[0].patches.sum()), "spectra": lights}
    return Result(document, files=files)


class _WithMoments(click.Command):
    """Command that runs the command `moments` instead if its first argument is "moments"."""

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        if args[:1] == ["moments"]:
            return moments.make_context(f"{info_name} moments", args[1:], parent, **extra)
        return super().make_context(info_name, args, parent, **extra)


@click.command(cls=_WithMoments)
@click.argument("recipe", type=declared.RecipeFile("designs"), metavar="DESIGN.toml")
@declared.output("Design to write")
@declared.of(DesignOptions)
def design(recipe: Path, output: Path, options: DesignOptions) -> Result:
    """Rank colour filter arrays by their predicted error, without training. DESIGN.toml is a recipe, or the name of a recipe
    that comes with l3. It describes the pixel, the filters, the arrays and the illuminants.

    First compute the statistics of scenes behind this lens and this pixel, once for all designs:
    "l3 design moments SCENES.toml --camera CAMERA -o SCENES.h5".

    \b
    Example: l3 design dyes --moments scenes.h5 -o design.h5
    """
    from l3cli.stages.design import design as stage

    made, files = stage(recipe, output, options)
    return Result({"design": str(output), **_document(made)}, lambda: _text(made), files=files)


def _document(made: "Design") -> dict[str, Any]:
    arrays = [
        {"array": pattern, "error": error.tolist(), "bayer_of_its_filters": own.tolist()}
        for pattern, error, own in zip(made.patterns, made.predicted, made.dyes, strict=True)
    ]
    facts = {"tried": made.tried, "levels": list(made.levels), "unit": made.unit, "bayer": made.bayer}
    return {**facts, "arrays": arrays, "verdict": made.verdict}


def _text(made: "Design") -> None:
    tuned = made.tuned.words(made.levels) if made.tuned else []
    show_table([made.caption], *made.table(SHOWN), *made.verdict, *made.crossings, *tuned)
    if truth := made.truth:
        show_table(
            ["trained arrays, evaluated on the same unseen scenes"], *truth.table(made.levels), *truth.agreement(made.levels)
        )
