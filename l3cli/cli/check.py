"""l3 check: checks recipes and explains what they mean."""

from typing import Any

import click

from l3cli.cli import options as declared
from l3cli.cli import terminal
from l3cli.cli.results import Result
from l3cli.cli.terminal import show
from l3cli.errors import InputFileError
from l3cli.options.commands import CheckOptions
from l3cli.system.files import files_to_read


class AnyRecipe(declared.RecipeFile):
    """Parameter type for a recipe of any type, or for a folder of recipes.

    Recipe names are left to the stage, because recipes of different types may have the same name.
    """

    def __init__(self) -> None:
        super().__init__("")

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return value

    def names(self) -> list[str]:
        from l3cli.recipes.builtin import KIND_OF_FOLDER, known_recipes

        return list(dict.fromkeys(name for kind in KIND_OF_FOLDER for name in known_recipes(kind)))


@click.command()
@click.argument("recipes", type=AnyRecipe(), nargs=-1, required=True, metavar="RECIPE…")
@declared.of(CheckOptions)
def check(recipes: tuple[str, ...], options: CheckOptions) -> Result:
    """Check recipes (camera, lab, scenes, classes) and measurement files, including all files to which they refer. Print
    every error as FILE:LINE: MESSAGE (exit code 3). If a recipe has no errors, explain what it means.

    RECIPE is a file, the name of a recipe that comes with l3, or a folder of recipes. If one of the recipes is a camera
    recipe, the remaining recipes are checked for this camera.

    \b
    Example: l3 check camera.toml scenes.toml
    """
    from l3cli.stages.check import as_text
    from l3cli.stages.check import check as stage

    judged = stage(recipes)
    files = files_to_read({"recipes": [file for judgement in judged for file in (judgement.path, *judgement.files)]})
    fault, faulty = None, [judgement for judgement in judged if judgement.findings]
    if faulty:
        count = sum(len(judgement.findings) + judgement.more for judgement in faulty)
        fault = InputFileError(
            f"{count} fault{'s' if count > 1 else ''} in {len(faulty)} of {len(judged)} files; correct the files"
        )
    elif options.plot is not None:
        from l3cli.stages.report import plot

        plot(judged, options.plot, options)
        files = files.and_wrote(options.plot)
    lines = [line for judgement in judged for line in as_text(judgement, terminal.width())]
    return Result({"files": [judgement.document() for judgement in judged]}, lambda: show(*lines), fault, files=files)
